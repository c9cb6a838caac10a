//! Questions to the operator: colours that cannot be read, a cube that cannot be seen.
//!
//! - in: the reason, and what the operator can do about it
//! - out: `Ok` to try again, or the failure that follows without a helpful answer
//!
//! After a question without an answer the operator counts as absent.

use super::failure::Failure;
use super::robot::Robot;
use crate::cube::{Face, Keeper};
use crate::operator::{Answer, Question, Subject};
use crate::tasks::cube::think::Doubt;

/// Text and index of the first option of a choice.
const AGAIN: &str = "look again";
pub(super) const LOOK_AGAIN: usize = 0;

/// Words of a question that the operator answers after a look at the cell.
struct Choice<'a> {
    /// Reason for the question.
    why: &'a str,
    /// Question about the things that the operator must check.
    see: &'a str,
    /// Consequence of no answer.
    otherwise: String,
    /// Text of the option that ends the attempt.
    end: &'a str,
}

/// Asks the operator to show the cube, since none can be seen or reached. Without an answer the
/// mission ends.
pub(super) async fn ask_to_show_the_cube(robot: &mut Robot, why: String) -> Result<(), Failure> {
    let Some(seconds) = robot.patience else { return Err(Failure::Final(why)) };
    let choice = Choice {
        why: &why,
        see: "Is the camera's view free and lit, and the cube where the hand can take it?",
        otherwise: "without an answer the run ends".to_owned(),
        end: "end the run",
    };
    if ask_to_look_again(robot, choice, seconds).await? { Ok(()) } else { Err(Failure::Final(why)) }
}

/// Asks the operator to free the cameras' view, since the cube cannot be inspected. Without an
/// answer the cube goes back as it is.
pub(super) async fn ask_for_inspection(robot: &mut Robot, why: String) -> Result<(), Failure> {
    let Some(seconds) = robot.patience else { return Err(Failure::GiveBack(why)) };
    let choice = Choice {
        why: &why,
        see: "Are the views of the cameras in the hands free and lit?",
        otherwise: format!("without an answer the cube {} as it is", robot.goes_back()),
        end: match robot.settings.keeper {
            Keeper::Person => "hand it back as it is",
            Keeper::Table => "lay it down as it is",
        },
    };
    if ask_to_look_again(robot, choice, seconds).await? {
        Ok(())
    } else {
        Err(Failure::GiveBack(why))
    }
}

/// Asks the operator to check the cell, for at most `seconds`, and returns whether the answer is to
/// look again. After any other answer, or none, the operator counts as absent.
async fn ask_to_look_again(
    robot: &mut Robot,
    choice: Choice<'_>,
    seconds: f64,
) -> Result<bool, Failure> {
    let Choice { why, see, otherwise, end } = choice;
    robot.questions += 1;
    let question = Question {
        number: robot.questions,
        text: format!("{why}. {see}"),
        otherwise,
        seconds,
        until: 0.0,
        subject: Subject::Choice { options: [AGAIN, end].map(str::to_owned).to_vec() },
    };
    robot.note(format!("{why}: the operator is asked"));
    let answer = robot.ask(question).await?;
    let again = answer == Some(Answer::Choice { option: LOOK_AGAIN });
    // An operator who is away would cost each further question its whole time.
    if !again {
        robot.patience = None;
    }
    Ok(again)
}

/// Asks for the colours that the cameras cannot decide, if an operator is there. Without an answer
/// the cube goes back as it is.
pub(super) async fn ask_for_colours(robot: &mut Robot, doubt: Doubt) -> Result<(), Failure> {
    let Some(seconds) = robot.patience else { return Err(Failure::GiveBack(doubt.reason)) };
    robot.questions += 1;
    let question = Question {
        number: robot.questions,
        text: format!("{}. What are the colours?", doubt.reason),
        otherwise: format!("without an answer the cube {} as it is", robot.goes_back()),
        seconds,
        until: 0.0,
        subject: Subject::Stickers {
            read: likely_colours(robot, &doubt),
            doubtful: doubt.doubtful.clone(),
        },
    };
    robot.note(format!("{doubt}: the operator is asked", doubt = doubt.reason));
    if let Some(Answer::Stickers { stickers }) = robot.ask(question).await? {
        robot.note("the operator has given the colours");
        robot.given = Some(stickers);
        return Ok(());
    }
    robot.patience = None;
    Err(Failure::GiveBack(doubt.reason))
}

/// Returns the 54 letters that the question shows as the likely colours, `-` for a sticker that was
/// not seen.
fn likely_colours(robot: &Robot, doubt: &Doubt) -> String {
    let net = |i: usize| robot.shown.net.facelets.get(i).copied().flatten();
    // The letters of an impossible cube name positions of centres. The operator sees colours, so
    // each letter becomes the colour that the centre in that position has.
    let names: Vec<usize> =
        (0..6).filter_map(|f| net(f * 9 + 4)).map(|r| usize::from(r.colour.min(5))).collect();
    let mut sorted = names.clone();
    sorted.sort_unstable();
    let permuted = sorted == [0, 1, 2, 3, 4, 5] && robot.given.is_none();
    let letter = |i: usize| match doubt.read {
        Some(read) if doubt.possible || !permuted => read.colour(i).letter(),
        Some(read) => Face::ALL[names[read.colour(i).index()]].letter(),
        None => net(i).map_or('-', |r| Face::ALL[usize::from(r.colour.min(5))].letter()),
    };
    (0..54).map(letter).collect()
}
