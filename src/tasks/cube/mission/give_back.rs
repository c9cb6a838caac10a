//! The cube goes back: to the operator's hand, or onto the table.
//!
//! - in: pulls at the cube, what is met on the way out, the table's touch
//! - out: the cube let go, and the end of the mission
//! - source: Zieliński et al. (2007), p. 374; the pulls that tell who holds the cube: own work
//!
//! | situation | decision |
//! |---|---|
//! | a contact on the way out or back | the hand gives way, then a small pull tells whether somebody holds the cube; the force of a bump does not |
//! | somebody holds it | the jaws let go |
//! | nobody takes it for 20 s | a pull tells whether somebody holds it; if not, it is drawn back and held out once more ([`PRESENTED`] times in all) |

use super::actions::GIVE_WAY_SECONDS;
use super::failure::{Alarm, Failure, alarm};
use super::regrasp;
use super::robot::{Robot, UNSURE};
use super::shared::Doing;
use super::steps;
use crate::cube::Keeper;
use crate::generators::{Behaviour, Outcome};
use crate::spatial::Pose;
use crate::tasks::Finish;
use crate::tasks::cube::hold::Hand;
use crate::tasks::cube::plan::Planner;

/// How often the cube is held out.
const PRESENTED: u32 = 2;
/// What is known of a cube that an earlier run was handing back, and that nobody holds out again.
pub(super) const UNSEEN: &str = "by the other run's journal the cube was being handed back, no hand \
                                 of the robot holds it, and nobody has held it out since: the \
                                 operator has it";

/// Who holds the cube that is handed back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Holder {
    /// The track hand alone.
    Robot,
    /// Somebody has taken hold of it: the jaws are to let go.
    Somebody,
}

/// Gives the cube back solved, or as the task wants it.
pub(super) async fn solved(robot: &mut Robot) -> Result<Finish, Failure> {
    hand_back(robot).await?;
    finish(robot, true)
}

/// Gives the cube back as it is, with the reason.
pub(super) async fn unsolved(robot: &mut Robot, why: String) -> Result<Finish, Failure> {
    robot.note(format!("{why}: the cube {}", robot.goes_back()));
    robot.log.grasps = 0;
    let holder = robot.held_alone()?;
    let way = Planner::new(&robot.settings).of(&[Vec::new()], holder);
    let steps = way.map_err(|e| format!("{why}; {e}"))?.steps;
    robot.failure = Some(why);
    steps::carry_out(robot, &steps).await?;
    hand_back(robot).await?;
    finish(robot, false)
}

/// Ends the mission with the cube out of its hands.
pub(super) fn finish(robot: &mut Robot, achieved: bool) -> Result<Finish, Failure> {
    robot.check_hold()?;
    robot.publish(Doing::Over);
    let sought = robot.seeks.is_some();
    let back = match robot.settings.keeper {
        Keeper::Person if sought => UNSEEN,
        Keeper::Person => "the cube was handed back",
        Keeper::Table => "the cube was laid on the table",
    };
    let reason = match &robot.failure {
        Some(failure) if sought => format!("{failure}; {back}"),
        Some(failure) => format!("{failure}; {back} as it is"),
        None => back.to_owned(),
    };
    Ok(Finish { achieved, reason })
}

/// Brings the cube to where it was taken, and leaves it there.
async fn hand_back(robot: &mut Robot) -> Result<(), Failure> {
    robot.check_hold()?;
    let place = robot.hand_over.ok_or("the place of the hand-over is not known")?;
    match robot.settings.keeper {
        Keeper::Person => {
            robot.phase("hand back").await?;
            regrasp::return_to(robot, place).await?;
            offer(robot).await?;
        }
        Keeper::Table => {
            robot.phase("lay down").await?;
            regrasp::return_to(robot, place).await?;
            robot.along(Hand::Track, robot.way_back() - before_the_table(robot)).await?;
            robot.zero_forces([true, false]).await?;
            lay_down(robot).await?;
        }
    }
    regrasp::let_go(robot, Hand::Track).await
}

/// Returns how far above the table a cube that is laid down is lowered by touch alone (m).
fn before_the_table(robot: &Robot) -> f64 {
    robot.settings.pre_grasp.max(UNSURE)
}

/// Lowers the cube until it touches the table.
async fn lay_down(robot: &mut Robot) -> Result<(), Failure> {
    robot.check_hold()?;
    robot.given_back = true;
    let s = &robot.settings;
    // A table that was not touched by then is not there.
    let distance = before_the_table(robot) + s.edge / 3.0 + 0.01;
    let order = Behaviour::Approach {
        speed: s.approach_speed,
        distance,
        force: s.touch,
        selector: [false; 6],
    };
    let outcomes = robot.behave_alone(Hand::Track, order, Doing::LayingDown).await?;
    if let Some(met) = alarm(&outcomes, Doing::LayingDown) {
        return Err(Failure::Final(met.why));
    }
    match outcomes[Hand::Track.index()] {
        Some(Outcome::Touched(_)) => Ok(()),
        other => {
            let felt = Outcome::words(other);
            Err(format!("the cube could not be laid down, no table was felt: {felt}").into())
        }
    }
}

/// The way on which the cube is held out: `base_from_tool` of the track at its beginning and end.
#[derive(Debug, Clone, Copy)]
struct WayOut {
    begin: Pose,
    end: Pose,
}

/// Holds the cube out to the operator until somebody has hold of it.
async fn offer(robot: &mut Robot) -> Result<(), Failure> {
    let begin = robot.arms[Hand::Track.index()].desired_base_from_tool;
    let end = begin * Pose::translation(0.0, 0.0, robot.way_back());
    let way = WayOut { begin, end };
    if hold_out(robot, way).await? == Holder::Somebody {
        return Ok(());
    }
    robot.zero_forces([true, false]).await?;
    for tries in 1.. {
        if wait_for_a_pull(robot, tries).await? == Holder::Somebody {
            break;
        }
        robot.note("nobody holds it: it is drawn back and held out once more");
        if withdraw(robot).await? == Holder::Somebody
            || hold_out(robot, way).await? == Holder::Somebody
        {
            break;
        }
        robot.zero_forces([true, false]).await?;
    }
    Ok(())
}

/// Presents the cube; where nobody takes it a small pull tells whether somebody holds it.
async fn wait_for_a_pull(robot: &mut Robot, tries: u32) -> Result<Holder, Failure> {
    let outcomes = robot.present().await?;
    match (alarm(&outcomes, Doing::HandingBack), outcomes[Hand::Track.index()]) {
        // Nobody else is there who could strain it.
        (Some(Alarm { outcome: Outcome::OverForce(..), why, .. }), _) => {
            robot.note(format!("{why}: the jaws let go"));
            Ok(Holder::Somebody)
        }
        (Some(met), _) => Err(Failure::Final(met.why)),
        (None, Some(Outcome::Pulled)) => Ok(Holder::Somebody),
        (None, Some(Outcome::TimedOut(seconds))) => {
            robot.note(format!("nobody took the cube for {seconds:.0} s"));
            // The pull is to be felt from here on.
            robot.zero_forces([true, false]).await?;
            match robot.pull(0.5, Doing::HandingBack).await? {
                Some(Outcome::NotTouched) if tries >= PRESENTED => {
                    Err("the cube was not taken back: nobody pulls at it".into())
                }
                Some(Outcome::NotTouched) => Ok(Holder::Robot),
                _ => {
                    robot.note("somebody holds it: the jaws let go");
                    Ok(Holder::Somebody)
                }
            }
        }
        (None, other) => {
            Err(format!("the cube was not taken back: {}", Outcome::words(other)).into())
        }
    }
}

/// Draws the cube back farther than it was held out: an operator who has not seen it leave may not
/// see that it is there again.
async fn withdraw(robot: &mut Robot) -> Result<Holder, Failure> {
    let goes = robot.free_way(Hand::Track, 2.0 * robot.settings.back);
    let from = robot.arms[Hand::Track.index()].desired_base_from_tool;
    let line = robot.gentle_line(from * Pose::translation(0.0, 0.0, -goes));
    let outcomes = robot.behave_alone(Hand::Track, line, Doing::Travelling).await?;
    // A person who takes hold of a cube that is drawn back is to have it.
    if let Some(met) = alarm(&outcomes, Doing::Travelling) {
        somebody_has_hold(robot, &met.why);
        return Ok(Holder::Somebody);
    }
    robot.contacts = 0;
    Ok(Holder::Robot)
}

/// Moves the cube to where it is held out.
async fn hold_out(robot: &mut Robot, way: WayOut) -> Result<Holder, Failure> {
    loop {
        let Some(met) = move_track(robot, way.end).await? else {
            robot.contacts = 0;
            return Ok(Holder::Robot);
        };
        if !robot.may_give_way() {
            return Err(Failure::Final(met.why));
        }
        robot.note(format!("{}: it goes no farther", met.why));
        if feel_for_a_holder(robot).await? == Holder::Somebody
            || draw_in(robot, way).await? == Holder::Somebody
        {
            return Ok(Holder::Somebody);
        }
    }
}

/// Moves the cube back to where the way out begins.
async fn draw_in(robot: &mut Robot, way: WayOut) -> Result<Holder, Failure> {
    loop {
        let Some(met) = move_track(robot, way.begin).await? else { return Ok(Holder::Robot) };
        if !robot.may_give_way() {
            return Err(Failure::Final(met.why));
        }
        robot.note(format!("{}: it gives way", met.why));
        if feel_for_a_holder(robot).await? == Holder::Somebody {
            return Ok(Holder::Somebody);
        }
    }
}

/// Moves the track along a line, and returns what it met.
async fn move_track(robot: &mut Robot, target: Pose) -> Result<Option<Alarm>, Failure> {
    let line = robot.gentle_line(target);
    let outcomes = robot.behave_alone(Hand::Track, line, Doing::Travelling).await?;
    Ok(alarm(&outcomes, Doing::Travelling))
}

/// Finds out whether somebody holds a cube that met something on its way: once it presses no more,
/// a small pull tells.
async fn feel_for_a_holder(robot: &mut Robot) -> Result<Holder, Failure> {
    loop {
        robot.contacts += 1;
        // The pull tells, whatever alarm ends the wait.
        robot.wait(Hand::Track, GIVE_WAY_SECONDS).await?;
        // The hand presses perhaps what it met, and its force was zeroed a while ago.
        match robot.pull(1.0, Doing::HandingBack).await? {
            Some(Outcome::NotTouched) => {
                robot.note("nobody has hold of it: it is drawn back and held out once more");
                return Ok(Holder::Robot);
            }
            Some(Outcome::Touched(_)) => {
                somebody_has_hold(robot, "somebody has hold of it");
                return Ok(Holder::Somebody);
            }
            Some(Outcome::OverForce(..)) if robot.may_give_way() => {}
            other => {
                let felt = Outcome::words(other);
                return Err(format!(
                    "something is in the way of the cube that is handed back: {felt}"
                )
                .into());
            }
        }
    }
}

/// Notes that somebody has hold of a cube on its way: that person is to have it.
fn somebody_has_hold(robot: &mut Robot, why: &str) {
    robot.note(format!("{why}: the jaws let go"));
    robot.given_back = true;
}

#[cfg(test)]
mod tests {
    use super::super::testing::{
        Stage, goes_well, met, order, play_mission, settings, track, words,
    };
    use super::*;
    use crate::motion::JointPositions;
    use crate::tasks::Action;
    use crate::tasks::cube::mission::mend;
    use crate::tasks::cube::think::Thought;

    /// A stage with the cube in the track hand, and a place where it was taken.
    fn stage() -> Stage {
        let mut stage = Stage::holding(settings());
        stage.robot.hand_over = Some(JointPositions([0.3; 7]));
        stage
    }

    #[test]
    fn untaken_cube_is_pulled_each_time_and_kept() {
        let mut stage = stage();

        let (end, actions) =
            stage.play(async |robot| offer(robot).await, &mut |action, arms| match order(action) {
                Some(Behaviour::Present { .. }) => track(Outcome::TimedOut(20.0)),
                _ => goes_well(action, arms),
            });

        let once = ["zero", "present", "zero", "pull"];
        let again = ["line", "line"];
        assert_eq!(words(&actions), [&["line"][..], &once, &again, &once].concat());
        let Err(failure) = end else { panic!() };
        let mend = async |robot: &mut Robot| mend::mend(robot, failure).await;
        let (end, _) = stage.play(mend, &mut goes_well);
        let told = format!("{end:?}");
        assert!(told.contains("nobody pulls at it; the track hand holds"), "{told}");
    }

    #[test]
    fn cube_seized_while_drawn_back_is_let_go() {
        let mut stage = stage();
        let mut lines = 0;

        let (end, actions) =
            stage.play(async |robot| hand_back(robot).await, &mut |action, arms| {
                lines += i32::from(matches!(order(action), Some(Behaviour::Line { .. })));
                match order(action) {
                    Some(Behaviour::Present { .. }) => track(Outcome::TimedOut(20.0)),
                    // The first line holds the cube out, the second one draws it back.
                    Some(Behaviour::Line { .. }) if lines == 2 => met(),
                    _ => goes_well(action, arms),
                }
            });

        assert_eq!(end, Ok(()));
        let way = ["hand back", "joints", "line", "zero", "present", "zero", "pull", "line"];
        assert_eq!(words(&actions), [&way[..], &["open", "line"]].concat());
        assert!(opens_strained(&actions), "{actions:?}");
        assert!(stage.notes().iter().any(|note| note.ends_with("the jaws let go")));
    }

    /// Returns whether the jaws open, whatever strains them.
    fn opens_strained(actions: &[Action<Thought>]) -> bool {
        let opens = |action| matches!(order(action), Some(Behaviour::Jaw { strained: true, .. }));
        actions.iter().any(opens)
    }

    /// Hands the cube back; each line and each pull ends as told, in turn, and well afterwards.
    /// Jaws that let go open whatever strains them.
    fn held_out(
        lines: &[Outcome],
        pulls: &[Outcome],
    ) -> (Result<(), Failure>, Vec<&'static str>, Vec<Pose>) {
        let mut stage = stage();
        let (mut lines, mut pulls) = (lines.iter(), pulls.iter());
        let mut targets = Vec::new();
        let hands_back = async |robot: &mut Robot| hand_back(robot).await;
        let (end, actions) = stage.play(hands_back, &mut |action, arms| match order(action) {
            Some(Behaviour::Line { target, .. }) => {
                targets.push(*target);
                track(*lines.next().unwrap_or(&Outcome::Reached))
            }
            Some(Behaviour::Withdraw { .. }) => {
                track(*pulls.next().unwrap_or(&Outcome::NotTouched))
            }
            _ => goes_well(action, arms),
        });
        assert_eq!(opens_strained(&actions), end.is_ok(), "{actions:?}");
        let mut words = words(&actions);
        assert_eq!(words.drain(..2).as_slice(), ["hand back", "joints"]);
        (end, words, targets)
    }

    const MET: Outcome = Outcome::OverForce(2, 31.0);

    #[test]
    fn obstacle_on_the_way_out_may_hold_the_cube() {
        // What still presses after a while is given way to once more.
        let (end, words, _) = held_out(&[MET], &[MET, Outcome::Touched(0.003)]);

        assert_eq!(end, Ok(()));
        let felt = ["line", "give way", "pull", "give way", "pull"];
        assert_eq!(words, [&felt[..], &["open", "line"]].concat());
    }

    #[test]
    fn obstacle_that_leaves_lets_the_cube_pass() {
        let (end, words, targets) = held_out(&[MET], &[Outcome::NotTouched]);

        assert_eq!(end, Ok(()));
        let drawn_in = ["line", "give way", "pull", "line", "line", "zero", "present"];
        assert_eq!(words, [&drawn_in[..], &["open", "line"]].concat());
        assert_eq!(targets[0], targets[2], "to the same place");
    }

    #[test]
    fn obstacle_on_the_way_back_is_felt_for() {
        let (end, words, _) = held_out(&[MET, MET], &[Outcome::NotTouched, Outcome::Touched(0.0)]);

        assert_eq!(end, Ok(()));
        let felt = ["line", "give way", "pull", "line", "give way", "pull"];
        assert_eq!(words, [&felt[..], &["open", "line"]].concat());
    }

    #[test]
    fn obstacle_that_stays_leaves_the_cube_held() {
        let (end, ..) = held_out(&[MET, Outcome::Reached].repeat(5), &[]);

        let Err(Failure::Final(why)) = end else { panic!("{end:?}") };
        assert!(why.contains("over-force"), "{why}");
        // The mission ends with the cube in its hand.
        let mut stage = stage();
        let mend = async |robot: &mut Robot| mend::mend(robot, Failure::Final(why)).await;
        let (end, actions) = stage.play(mend, &mut goes_well);
        assert!(actions.is_empty(), "{actions:?}");
        assert!(format!("{end:?}").contains("the track hand holds the cube"), "{end:?}");
    }

    #[test]
    fn overforce_while_presented_opens_strained_jaws() {
        let presents = |outcome: Outcome| {
            let mut stage = stage();
            let waits = async |robot: &mut Robot| wait_for_a_pull(robot, 1).await;
            let (end, _) = stage.play(waits, &mut |_, _| track(outcome));
            (end, stage)
        };

        let (end, mut stage) = presents(Outcome::OverForce(0, 60.0));
        assert_eq!(end, Ok(Holder::Somebody));
        let lets_go = async |robot: &mut Robot| regrasp::let_go(robot, Hand::Track).await;
        let (_, actions) = stage.play(lets_go, &mut goes_well);
        assert!(matches!(order(&actions[0]), Some(Behaviour::Jaw { strained: true, .. })));

        let (end, _) = presents(Outcome::Oscillates(0, 30.0, 4.0));
        assert!(matches!(end, Err(Failure::Final(_))), "{end:?}");
    }

    #[test]
    fn unknown_place_of_hand_over_is_reported() {
        let mut stage = Stage::holding(settings());

        let (end, _) = stage.play(async |robot| hand_back(robot).await, &mut goes_well);

        assert_eq!(end, Err("the place of the hand-over is not known".into()));
    }

    #[test]
    fn acquired_cube_is_handed_back() {
        use super::super::Mission;
        use super::super::assignment::{Assignment, Goal};
        use crate::motion::ArmState;
        let mut mission = Mission::new(settings(), Assignment::new(Goal::Acquire));

        let arms = [ArmState { jaw_opening: 0.09, ..ArmState::default() }; 2];
        let (end, actions) = play_mission(&mut mission, arms, &mut goes_well);

        assert!(end.achieved && end.reason == "the cube was handed back", "{}", end.reason);
        let take = ["acquire", "open", "watch", "zero", "servo", "close"];
        let release = ["give way", "pull", "watch", "line"];
        let back = ["hand back", "joints", "line", "zero", "present", "open", "line"];
        assert_eq!(words(&actions), [&take[..], &release, &back].concat());
        assert_eq!(mission.whereabouts(), "the operator has the cube");
    }
}
