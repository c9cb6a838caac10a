//! Return of the cube to the operator's hand, or onto the table.
//!
//! - in: pulls at the cube, contacts on the way out, the touch of the table
//! - out: the cube released, and the end of the mission
//! - source: Zieliński et al. (2007), p. 374; pulls that detect a holder: own work
//!
//! A small pull detects a person who holds the cube. The force of a contact does not: an obstacle
//! has the same force.
//!
//! | situation | threshold | decision |
//! |---|---|---|
//! | a contact on the path | `control.hand_force_n` | the hand yields, then pulls a little |
//! | a person holds the cube | the pull is resisted | the jaws let go |
//! | no person takes it | 20 s | the hand pulls; if no person holds it, it retracts and retries |
//! | no person takes it again | [`MOST_OFFERS`] | the mission ends with the cube in the hand |

use super::actions::GIVE_WAY_SECONDS;
use super::failure::{Alarm, Failure, alarm};
use super::regrasp;
use super::robot::{Robot, UNSURE};
use super::shared::Doing;
use super::steps;
use crate::cube::Keeper;
use crate::generators::{Behaviour, Outcome};
use crate::kernel::Finish;
use crate::spatial::Pose;
use crate::tasks::cube::hold::Hand;
use crate::tasks::cube::plan::Planner;

/// Number of times that the cube is held out.
const MOST_OFFERS: u32 = 2;
/// Reason for the end of a mission in which no person holds out again the cube that an earlier run
/// was handing back.
pub(super) const UNSEEN: &str = "by the journal of the earlier run the cube was being handed back, \
                                 no hand of the robot holds it, and no person has held it out \
                                 again: the operator has it";

/// Holder of the cube that is handed back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Holder {
    /// The track hand alone.
    Robot,
    /// A person, who has taken hold of the cube: the jaws must let go.
    Person,
}

/// Gives the cube back in the state that the task wants, and ends the mission with success.
pub(super) async fn solved(robot: &mut Robot) -> Result<Finish, Failure> {
    hand_back(robot).await?;
    finish(robot, true)
}

/// Gives the cube back as it is, for the reason `why`, and ends the mission without success.
pub(super) async fn unsolved(robot: &mut Robot, why: String) -> Result<Finish, Failure> {
    robot.note(format!("{why}: the cube {goes_back}", goes_back = robot.goes_back()));
    robot.log.grasps = 0;
    let holder = robot.held_alone()?;
    // A plan without turns has only the grasps that bring the cube into the track hand.
    let way = Planner::new(&robot.settings).of(&[Vec::new()], holder);
    let steps = way.map_err(|e| format!("{why}; {e}"))?.steps;
    robot.failure = Some(why);
    steps::carry_out(robot, &steps).await?;
    hand_back(robot).await?;
    finish(robot, false)
}

/// Publishes and returns the end of a mission that has released the cube. `achieved` says whether
/// the cube is in the state that the task wants.
pub(super) fn finish(robot: &mut Robot, achieved: bool) -> Result<Finish, Failure> {
    robot.check_hold()?;
    robot.publish(Doing::Over);
    let sought = robot.seek_time.is_some();
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

/// Brings the cube to the place of hand-over, and releases it there.
async fn hand_back(robot: &mut Robot) -> Result<(), Failure> {
    robot.check_hold()?;
    let place = robot.hand_over.ok_or("the place of hand-over is unknown")?;
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
            // The zero is taken after the free motion and before the contact.
            robot.zero_forces([true, false]).await?;
            lay_down(robot).await?;
        }
    }
    regrasp::let_go(robot, Hand::Track).await
}

/// Returns the height above the table below which the cube is lowered by touch (m).
fn before_the_table(robot: &Robot) -> f64 {
    robot.settings.pre_grasp.max(UNSURE)
}

/// Lowers the cube until it touches the table.
async fn lay_down(robot: &mut Robot) -> Result<(), Failure> {
    robot.check_hold()?;
    robot.given_back = true;
    let s = &robot.settings;
    // Without a contact by this distance there is no table.
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
    match outcomes[Hand::Track.index()].clone() {
        Some(Outcome::Touched(_)) => Ok(()),
        other => {
            let felt = Outcome::words(other);
            Err(format!("the cube could not be laid down, no contact with the table: {felt}")
                .into())
        }
    }
}

/// Path on which the cube is held out: `base_from_tool` of the track at both ends.
#[derive(Debug, Clone, Copy)]
struct OfferPath {
    begin: Pose,
    end: Pose,
}

/// Holds the cube out to the operator until a person has hold of it.
async fn offer(robot: &mut Robot) -> Result<(), Failure> {
    let begin = robot.arms[Hand::Track.index()].desired_base_from_tool;
    let end = begin * Pose::translation(0.0, 0.0, robot.way_back());
    let way = OfferPath { begin, end };
    if hold_out(robot, way).await? == Holder::Person {
        return Ok(());
    }
    robot.zero_forces([true, false]).await?;
    // The loop ends with a holder, or with the failure of the last try.
    for tries in 1.. {
        if wait_for_a_pull(robot, tries).await? == Holder::Person {
            break;
        }
        robot.note("no person holds the cube yet: it is retracted and held out again");
        if withdraw(robot).await? == Holder::Person || hold_out(robot, way).await? == Holder::Person
        {
            break;
        }
        robot.zero_forces([true, false]).await?;
    }
    Ok(())
}

/// Presents the cube and waits for a pull, in try number `tries`. After a wait in vain a small pull
/// detects a holder.
async fn wait_for_a_pull(robot: &mut Robot, tries: u32) -> Result<Holder, Failure> {
    let outcomes = robot.present().await?;
    match (alarm(&outcomes, Doing::HandingBack), outcomes[Hand::Track.index()].clone()) {
        // Only a person can strain a hand that yields in free air.
        (Some(Alarm { outcome: Outcome::OverForce(..), why, .. }), _) => {
            robot.note(format!("{why}: the jaws let go"));
            Ok(Holder::Person)
        }
        // An oscillation is a fault of the force control and no sign of a person.
        (Some(met), _) => Err(Failure::Final(met.why)),
        // The operator pulls at the cube.
        (None, Some(Outcome::Pulled)) => Ok(Holder::Person),
        // The wait was in vain.
        (None, Some(Outcome::TimedOut(seconds))) => {
            robot.note(format!("the cube was not taken within {seconds:.0} s"));
            // The pull is measured against the force at its beginning.
            robot.zero_forces([true, false]).await?;
            match robot.pull(0.5, Doing::HandingBack).await? {
                Some(Outcome::NotTouched) if tries >= MOST_OFFERS => {
                    Err("the cube was not taken back: no pull detected".into())
                }
                Some(Outcome::NotTouched) => Ok(Holder::Robot),
                _ => {
                    robot.note("a person holds the cube: the jaws let go");
                    Ok(Holder::Person)
                }
            }
        }
        (None, other) => {
            Err(format!("the cube was not taken back: {}", Outcome::words(other)).into())
        }
    }
}

/// Retracts the cube before it is held out again, by twice the usual distance if the joints allow
/// it, so that the operator sees the cube leave and come back.
async fn withdraw(robot: &mut Robot) -> Result<Holder, Failure> {
    let goes = robot.free_retraction(Hand::Track, 2.0 * robot.settings.back);
    let from = robot.arms[Hand::Track.index()].desired_base_from_tool;
    let line = robot.gentle_line(from * Pose::translation(0.0, 0.0, -goes));
    let outcomes = robot.behave_alone(Hand::Track, line, Doing::Travelling).await?;
    // A person who takes hold of a cube that retracts gets it.
    if let Some(met) = alarm(&outcomes, Doing::Travelling) {
        release_to_person(robot, &met.why);
        return Ok(Holder::Person);
    }
    robot.contacts = 0;
    Ok(Holder::Robot)
}

/// Moves the cube out to the end of its path. After an obstacle the cube moves back to the
/// beginning, and the motion is repeated.
async fn hold_out(robot: &mut Robot, way: OfferPath) -> Result<Holder, Failure> {
    loop {
        let Some(met) = move_track(robot, way.end).await? else {
            robot.contacts = 0;
            return Ok(Holder::Robot);
        };
        if !robot.may_give_way() {
            return Err(Failure::Final(met.why));
        }
        robot.note(format!("{contact}: the motion stops", contact = met.why));
        // An obstacle is never pushed: the cube moves back to the beginning before the retry.
        if probe_for_holder(robot).await? == Holder::Person
            || move_in(robot, way).await? == Holder::Person
        {
            return Ok(Holder::Person);
        }
    }
}

/// Moves the cube back to the beginning of its path.
async fn move_in(robot: &mut Robot, way: OfferPath) -> Result<Holder, Failure> {
    loop {
        let Some(met) = move_track(robot, way.begin).await? else { return Ok(Holder::Robot) };
        if !robot.may_give_way() {
            return Err(Failure::Final(met.why));
        }
        robot.note(format!("{contact}: the hand yields", contact = met.why));
        if probe_for_holder(robot).await? == Holder::Person {
            return Ok(Holder::Person);
        }
    }
}

/// Moves the track along a line, and returns the obstacle that it met.
async fn move_track(robot: &mut Robot, target: Pose) -> Result<Option<Alarm>, Failure> {
    let line = robot.gentle_line(target);
    let outcomes = robot.behave_alone(Hand::Track, line, Doing::Travelling).await?;
    Ok(alarm(&outcomes, Doing::Travelling))
}

/// Yields after a contact until the cube no longer presses the obstacle, then detects a holder by a
/// small pull.
async fn probe_for_holder(robot: &mut Robot) -> Result<Holder, Failure> {
    loop {
        robot.contacts += 1;
        // An alarm of this wait is not looked at, since the pull measures what follows.
        robot.wait(Hand::Track, GIVE_WAY_SECONDS).await?;
        // The hand may still press the obstacle, and its last zero is old. So the pull counts from
        // twice the force of a pull with a fresh zero.
        match robot.pull(1.0, Doing::HandingBack).await? {
            // The cube comes along freely.
            Some(Outcome::NotTouched) => {
                robot.note("no person holds the cube yet: it is retracted and held out again");
                return Ok(Holder::Robot);
            }
            // A person holds it.
            Some(Outcome::Touched(_)) => {
                release_to_person(robot, "a person holds the cube");
                return Ok(Holder::Person);
            }
            // The obstacle still presses, so that no pull is possible: the hand yields again.
            Some(Outcome::OverForce(..)) if robot.may_give_way() => {}
            // An obstacle that stays keeps the jaws closed: they once opened here, and the cube
            // fell.
            other => {
                let felt = Outcome::words(other);
                return Err(format!("an obstacle blocks the hand-back of the cube: {felt}").into());
            }
        }
    }
}

/// Marks the cube as given back to a person who has taken hold of it on its path.
fn release_to_person(robot: &mut Robot, why: &str) {
    robot.note(format!("{why}: the jaws let go"));
    robot.given_back = true;
}

#[cfg(test)]
mod tests {
    use super::super::testing::{
        Stage, goes_well, met, order, play_mission, settings, track, words,
    };
    use super::*;
    use crate::kernel::Action;
    use crate::motion::JointPositions;
    use crate::tasks::cube::mission::recover;
    use crate::tasks::cube::think::Thought;

    /// Makes a stage with the cube in the track hand, and a known place of hand-over.
    fn stage() -> Stage {
        let mut stage = Stage::holding(settings());
        stage.robot.hand_over = Some(JointPositions([0.3; 7]));
        stage
    }

    #[test]
    fn cube_nobody_takes_is_offered_twice_and_kept() {
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
        let recover = async |robot: &mut Robot| recover::recover(robot, failure).await;
        let (end, _) = stage.play(recover, &mut goes_well);
        let told = format!("{end:?}");
        assert!(told.contains("no pull detected; the track hand holds"), "{told}");
    }

    #[test]
    fn cube_seized_in_retraction_is_released() {
        let mut stage = stage();
        let mut lines = 0;

        let (end, actions) =
            stage.play(async |robot| hand_back(robot).await, &mut |action, arms| {
                lines += i32::from(matches!(order(action), Some(Behaviour::Line { .. })));
                match order(action) {
                    Some(Behaviour::Present { .. }) => track(Outcome::TimedOut(20.0)),
                    // The first line holds the cube out, the second one retracts it.
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

    /// Returns whether the jaws open under any strain.
    fn opens_strained(actions: &[Action<Thought>]) -> bool {
        let opens = |action| matches!(order(action), Some(Behaviour::Jaw { strained: true, .. }));
        actions.iter().any(opens)
    }

    /// Hands the cube back. The lines and the pulls end with these outcomes in order, and with
    /// success afterwards. Returns the result, the words of the actions and the targets of the
    /// lines. Checks that jaws which let go open under any strain.
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
                track(lines.next().cloned().unwrap_or(Outcome::Reached))
            }
            Some(Behaviour::Withdraw { .. }) => {
                track(pulls.next().cloned().unwrap_or(Outcome::NotTouched))
            }
            _ => goes_well(action, arms),
        });
        assert_eq!(opens_strained(&actions), end.is_ok(), "{actions:?}");
        let mut words = words(&actions);
        assert_eq!(words.drain(..2).as_slice(), ["hand back", "joints"]);
        (end, words, targets)
    }

    /// Outcome of a motion that met an obstacle or a person's hand.
    const MET: Outcome = Outcome::OverForce(2, 31.0);

    /// A contact while the cube is held out may be a person who takes it.
    #[test]
    fn pull_after_contact_in_offer_detects_person() {
        // The hand yields once more to an obstacle that still presses after a while.
        let (end, words, _) = held_out(&[MET], &[MET, Outcome::Touched(0.003)]);

        assert_eq!(end, Ok(()));
        let felt = ["line", "yield", "pull", "yield", "pull"];
        assert_eq!(words, [&felt[..], &["open", "line"]].concat());
    }

    #[test]
    fn hand_back_succeeds_after_obstacle_leaves() {
        let (end, words, targets) = held_out(&[MET], &[Outcome::NotTouched]);

        assert_eq!(end, Ok(()));
        let drawn_in = ["line", "yield", "pull", "line", "line", "zero", "present"];
        assert_eq!(words, [&drawn_in[..], &["open", "line"]].concat());
        // The cube moves out, back to the beginning, and out again.
        let stands = Pose::identity();
        let out = stands * Pose::translation(0.0, 0.0, settings().back);
        assert_eq!(targets[..3], [out, stands, out]);
    }

    #[test]
    fn pull_after_contact_in_retraction_detects_person() {
        let (end, words, _) = held_out(&[MET, MET], &[Outcome::NotTouched, Outcome::Touched(0.0)]);

        assert_eq!(end, Ok(()));
        let felt = ["line", "yield", "pull", "line", "yield", "pull"];
        assert_eq!(words, [&felt[..], &["open", "line"]].concat());
    }

    #[test]
    fn persistent_obstacle_leaves_cube_in_hand() {
        let lines: Vec<_> = (0..5).flat_map(|_| [MET, Outcome::Reached]).collect();
        let (end, ..) = held_out(&lines, &[]);

        let Err(Failure::Final(why)) = end else { panic!("{end:?}") };
        assert!(why.contains("over-force"), "{why}");
        // The mission ends with the cube in the track hand.
        let mut stage = stage();
        let recover = async |robot: &mut Robot| recover::recover(robot, Failure::Final(why)).await;
        let (end, actions) = stage.play(recover, &mut goes_well);
        assert!(actions.is_empty(), "{actions:?}");
        assert!(format!("{end:?}").contains("the track hand holds the cube"), "{end:?}");
    }

    #[test]
    fn overforce_while_presenting_cube_opens_jaws_under_strain() {
        let presents = |outcome: Outcome| {
            let mut stage = stage();
            let waits = async |robot: &mut Robot| wait_for_a_pull(robot, 1).await;
            let (end, _) = stage.play(waits, &mut |_, _| track(outcome.clone()));
            (end, stage)
        };

        let (end, mut stage) = presents(Outcome::OverForce(0, 60.0));
        assert_eq!(end, Ok(Holder::Person));
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

        assert_eq!(end, Err("the place of hand-over is unknown".into()));
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
        let release = ["yield", "pull", "watch", "line"];
        let back = ["hand back", "joints", "line", "zero", "present", "open", "line"];
        assert_eq!(words(&actions), [&take[..], &release, &back].concat());
        assert_eq!(mission.whereabouts(), "the operator has the cube");
    }
}
