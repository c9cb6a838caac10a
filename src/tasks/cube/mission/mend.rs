//! Decisions after a failure: which hand lets go of the cube, and where the mission goes on.
//!
//! - in: the failure that ended a procedure, what both hands hold
//! - out: the station at which the mission goes on, or the failure that takes its place
//!
//! | failure | decision |
//! |---|---|
//! | a hand lost the cube, the partner holds it | read anew, or given back by the partner |
//! | the cube fell | the hand goes to the place of hand-over, and takes it again |
//! | a grasp failed | the partner, who holds the cube, has it read anew |
//! | a turn failed | the layer is brought back into line, then the cube is read anew |
//! | [`MOST_RECOVERIES`] were not enough | the cube goes back as it is |
//! | the operator does not let go | the cube is left to the operator, and the mission ends |
//! | somebody has a cube that an earlier run held out | it is left to that person, and looked for |
//!
//! So little is believed after a failure that a mission which was broken off anywhere goes on in the
//! same way: see [`super::resume`].

use super::assignment::Goal;
use super::failure::Failure;
use super::robot::{MOST_RECOVERIES, Robot};
use super::station::Station;
use super::take::draw_back;
use super::turn_in_progress::TurnInProgress;
use super::{give_back, realign, regrasp, resume};
use crate::cube::Keeper;
use crate::motion::{Depth, JointPositions};
use crate::tasks::cube::hold::Hand;

/// Mends a failure, or replaces it by another one.
pub(super) async fn mend(robot: &mut Robot, failure: Failure) -> Result<Station, Failure> {
    // A hand that has lost the cube meanwhile matters more, unless the mission ends anyhow: a hand
    // that is pressed beyond its limits stays where it is. A turner that has lost its layer in a
    // turn that failed takes it anew: the realignment checks for that.
    let looks_at_hold = !matches!(
        failure,
        Failure::Final(_) | Failure::Lost(_) | Failure::Strained(_) | Failure::TurnFailed { .. }
    );
    if looks_at_hold {
        robot.check_hold()?;
    }
    match failure {
        Failure::Final(why) | Failure::Strained(why) | Failure::Hidden { why, .. } => {
            Ok(Station::Over(robot.failed(why)))
        }
        Failure::Lost(hand) => lost(robot, hand).await,
        Failure::NotGrasped { hand, why } => Err(not_grasped(robot, hand, why)),
        Failure::TurnFailed { turner } => {
            let release = Some(realign::bring_into_line(robot, turner).await?);
            Err(if robot.recoveries < MOST_RECOVERIES {
                Failure::ReadAnew { release }
            } else {
                Failure::GiveUp { release }
            })
        }
        Failure::ReadAnew { release } => {
            if let Some(hand) = release {
                regrasp::let_go(robot, hand).await?;
            }
            robot.check_hold()?;
            robot.forget_cube();
            Ok(Station::Read { phase: "identify again" })
        }
        Failure::GiveUp { release } => {
            if let Some(hand) = release {
                regrasp::let_go(robot, hand).await?;
            }
            robot.check_hold()?;
            Ok(Station::Unsolved(robot.reason_to_give_up()))
        }
        Failure::GiveBack(why) => Ok(Station::Unsolved(why)),
        Failure::Left(why) => {
            // The hand opens, whatever strains it.
            robot.open_to(Hand::Track, Depth::One, true).await?;
            draw_back(robot, robot.settings.back).await?;
            robot.failure = None;
            Ok(Station::Over(robot.failed(why)))
        }
        Failure::WithOperator(why) => resume::leave_to_the_operator(robot, why).await,
        Failure::NotHeldOut => {
            let achieved = robot.failure.is_none();
            robot.watch(false).await?;
            give_back::finish(robot, achieved).map(Station::Over)
        }
    }
}

/// Decides what follows when a hand has lost what it held.
async fn lost(robot: &mut Robot, hand: Hand) -> Result<Station, Failure> {
    let lost = format!("the cube has slipped out of the {} hand", hand.name());
    robot.belief.released(hand);
    if hand == Hand::Track && robot.maybe_offered.is_some() {
        return Err(Failure::WithOperator(lost));
    }
    if robot.belief.held[hand.other().index()].is_none() {
        return fallen(robot, hand, lost).await;
    }
    if !robot.may_recover() {
        return Err(returned_by_partner(robot, hand, lost));
    }
    robot.note(format!("{lost}: the cube is read anew"));
    Err(Failure::ReadAnew { release: Some(hand) })
}

/// Notes where the cube fell, and takes it again where it is held out once more.
async fn fallen(robot: &mut Robot, hand: Hand, lost: String) -> Result<Station, Failure> {
    robot.log.drops += 1;
    let tool = robot.belief.world_from_base(hand) * robot.arms[hand.index()].base_from_tool;
    let [x, y, _] = tool.translation.vector.map(|place| place * 1e3).into();
    robot.drop_site = Some(format!(
        "it fell from the {} hand and lies below where that was, at x {x:.0} mm, y {y:.0} mm of \
         the world",
        hand.name()
    ));
    let Some(hand_over) = robot.hand_over.filter(|_| robot.may_recover()) else {
        return Err(Failure::Final(lost));
    };
    let next = match robot.settings.keeper {
        Keeper::Person => "pick it up and hold it out again, please",
        Keeper::Table => "it is looked for on the table",
    };
    robot.note(format!("{lost} and lies below it: {next}"));
    robot.forget_cube();
    robot.forget_hand_over();
    wait_for_the_cube(robot, hand, hand_over).await?;
    Ok(Station::Take)
}

/// Opens the hand that lost the cube, and brings the track to where it took it.
async fn wait_for_the_cube(
    robot: &mut Robot,
    hand: Hand,
    hand_over: JointPositions,
) -> Result<(), Failure> {
    robot.phase("wait for the cube").await?;
    robot.open(hand, Depth::One).await?;
    regrasp::return_to(robot, hand_over).await
}

/// Decides what follows when a hand did not get hold of the cube.
fn not_grasped(robot: &mut Robot, hand: Hand, why: String) -> Failure {
    if robot.belief.held[hand.other().index()].is_none() {
        return Failure::Final(why);
    }
    if !robot.may_recover() {
        return returned_by_partner(robot, hand, why);
    }
    robot.note(format!("{why}: the cube is read anew"));
    Failure::ReadAnew { release: Some(hand) }
}

/// Decides that the partner gives the cube back as it is, since it was read anew too often. What
/// fails on that way ends the mission.
fn returned_by_partner(robot: &mut Robot, hand: Hand, why: String) -> Failure {
    if robot.goal != Goal::Solve || robot.failure.is_some() {
        return Failure::Final(why);
    }
    robot.failure = Some(why);
    Failure::GiveUp { release: Some(hand) }
}

impl Robot {
    /// Returns why the cube goes back with a layer that may be misaligned.
    fn reason_to_give_up(&mut self) -> String {
        let turn = self.turn_in_progress.take().and_then(TurnInProgress::into_why);
        let why = turn.or_else(|| self.failure.take());
        why.unwrap_or_else(|| "a layer stands askew".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Stage, goes_well, settings, words};
    use super::*;
    use crate::cube::{Face, Turn};
    use crate::tasks::cube::settings::CubeSettings;

    fn mends(stage: &mut Stage, failure: Failure) -> (Result<Station, Failure>, Vec<&'static str>) {
        let mends = async |robot: &mut Robot| mend(robot, failure).await;
        let (end, actions) = stage.play(mends, &mut goes_well);
        (end, words(&actions))
    }

    #[test]
    fn failed_grasp_has_the_cube_read_anew() {
        let mut stage = Stage::holding(settings());
        let failure = Failure::NotGrasped { hand: Hand::Postument, why: "missed".to_owned() };

        let (end, _) = mends(&mut stage, failure);
        assert_eq!(end, Err(Failure::ReadAnew { release: Some(Hand::Postument) }));
        let (end, words) = mends(&mut stage, end.unwrap_err());

        assert_eq!(end, Ok(Station::Read { phase: "identify again" }));
        assert_eq!((words, stage.robot.recoveries), (vec!["open", "line"], 1));
    }

    #[test]
    fn recoveries_run_out_and_the_partner_returns_the_cube() {
        for holder in [Hand::Track, Hand::Postument] {
            let mut stage = Stage::new(settings());
            stage.robot.hold(holder);
            stage.robot.recoveries = MOST_RECOVERIES;
            let hand = holder.other();
            let failure = || Failure::NotGrasped { hand, why: "missed".to_owned() };

            let (end, _) = mends(&mut stage, failure());
            assert_eq!(end, Err(Failure::GiveUp { release: Some(hand) }));
            let (end, _) = mends(&mut stage, end.unwrap_err());
            assert_eq!(end, Ok(Station::Unsolved("missed".to_owned())));

            // On its way back already, it fails for good.
            stage.robot.failure = Some("a layer stands askew".to_owned());
            let (end, _) = mends(&mut stage, failure());
            let (end, _) = mends(&mut stage, end.unwrap_err());
            let Ok(Station::Over(finish)) = end else { panic!("{end:?}") };
            assert!(!finish.achieved);
            assert!(finish.reason.starts_with("a layer stands askew; missed; the "));
            assert!(finish.reason.ends_with(" hand holds the cube"), "{}", finish.reason);
        }
    }

    #[test]
    fn fallen_cube_is_waited_for_where_it_was_taken() {
        for (keeper, told) in [
            (Keeper::Person, "hold it out again, please"),
            (Keeper::Table, "looked for on the table"),
        ] {
            let mut stage = Stage::holding(CubeSettings { keeper, ..settings() });
            stage.robot.hand_over = Some(JointPositions([0.3; 7]));

            let (end, words) = mends(&mut stage, Failure::Lost(Hand::Track));

            assert_eq!(end, Ok(Station::Take));
            assert_eq!(words, ["wait for the cube", "open", "joints"]);
            assert_eq!(stage.robot.hand_over, None, "it may be held out elsewhere");
            assert_eq!(
                stage.robot.whereabouts(),
                "it fell from the track hand and lies below where that was, at x 0 mm, y 0 mm of \
                 the world"
            );
            assert!(stage.notes().iter().any(|note| note.ends_with(told)));
            assert_eq!((stage.robot.log.drops, stage.robot.recoveries), (1, 1));
        }
    }

    #[test]
    fn fallen_cube_without_a_place_ends_the_mission() {
        let mut stage = Stage::holding(settings());

        let (end, _) = mends(&mut stage, Failure::Lost(Hand::Track));

        let lost = "the cube has slipped out of the track hand";
        assert_eq!(end, Err(Failure::Final(lost.to_owned())));
    }

    #[test]
    fn loss_outweighs_another_failure() {
        let mut stage = Stage::holding(settings());
        stage.robot.arms[0].jaw_opening = 0.053;

        let (end, _) = mends(&mut stage, Failure::GiveBack("no plan".to_owned()));

        assert_eq!(end, Err(Failure::Lost(Hand::Track)));
    }

    /// The arm is pressed beyond its limits: it does not move on to look for the cube.
    #[test]
    fn strained_hand_outweighs_loss() {
        let mut stage = Stage::holding(settings());
        stage.robot.arms[0].jaw_opening = 0.053;

        let (end, words) = mends(&mut stage, Failure::Strained("pressed".to_owned()));

        let Ok(Station::Over(finish)) = end else { panic!("{end:?}") };
        assert!(finish.reason.starts_with("pressed"), "{}", finish.reason);
        assert!(words.is_empty(), "{words:?}");
    }

    #[test]
    fn reading_anew_forgets_what_was_read() {
        let mut stage = Stage::holding(settings());
        let robot = &mut stage.robot;
        robot.failure = Some("face U cannot be read".to_owned());
        (robot.given_back, robot.rounds) = (true, 2);
        robot.stalled = Some(Turn { face: Face::U, quarters: 1 });

        robot.forget_cube();

        assert_eq!((robot.failure.as_ref(), robot.given_back, robot.rounds), (None, false, 1));
        assert_eq!((robot.stalled, robot.sight.missing().len()), (None, 54));
    }
}
