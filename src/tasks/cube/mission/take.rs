//! Acquisition of the cube from the operator's hand, or from the table.
//!
//! - in: the visual servo's outcome, the width between the jaws, small pulls at the cube
//! - out: the cube in the retracted track hand; or the failure that leaves the cube in its place
//! - source: Zieliński et al. (2007), pp. 371-372
//!
//! | limit | value | reason |
//! |---|---|---|
//! | [`TAKE_TRIES`] | 3 | approaches, and closings of the jaws |
//! | [`RELEASE_TRIES`] | 20 | pulls of 20 mm, 1.2 s apart: half a minute in which to let go |
//! | [`CLEAR`] | 2/3 of the retraction | the operator's fingers do not reach farther |

use super::failure::Failure;
use super::questions;
use super::robot::{LEAST_WIDTH, MOST_WIDER, Robot};
use super::shared::Doing;
use crate::cube::{Axis, Face, Keeper};
use crate::generators::Outcome;
use crate::motion::Depth;
use crate::tasks::cube::hold::{Hand, Hold};
use nalgebra::Vector3;

/// Number of approaches to the cube, and of closings of the jaws on it.
const TAKE_TRIES: u32 = 3;
/// Time between two small pulls (s), and the number of pulls.
pub(super) const RELEASE_WAIT: f64 = 1.2;
pub(super) const RELEASE_TRIES: u32 = 20;
/// Share of the retraction after which the hand is clear of the place of the grasp.
pub(super) const CLEAR: f64 = 2.0 / 3.0;

/// Takes the cube and retracts with it.
pub(super) async fn acquire(robot: &mut Robot) -> Result<(), Failure> {
    robot.phase("acquire").await?;
    robot.open(Hand::Track, Depth::One).await?;
    robot.watch(true).await?;
    robot.zero_forces([true, true]).await?;
    for tries in 1.. {
        approach(robot).await?;
        let Some(why) = close(robot).await? else { break };
        if tries >= TAKE_TRIES {
            return Err(leave(robot, format!("the jaws do not hold the cube: {why}")));
        }
        robot.note(format!("the jaws did not hold the cube ({why}), try {tries}"));
        robot.open(Hand::Track, Depth::One).await?;
        retract(robot, robot.settings.back).await?;
        robot.zero_forces([true, false]).await?;
    }
    retract_with_cube(robot, robot.settings.back).await
}

/// Lets the visual servo lead the open hand onto the cube until the palm touches it, in up to
/// [`TAKE_TRIES`] tries. The count of the tries begins again after the operator has shown a cube
/// that was not in reach.
///
/// # Errors
/// [`Failure::Left`] after the last try, or if a retry is of no use; [`Failure::Final`] if no cube
/// is in reach and the operator does not show it; [`Failure::NotHeldOut`] if an earlier run was
/// handing the cube back and no person holds it out again; any failure of the hand.
async fn approach(robot: &mut Robot) -> Result<(), Failure> {
    let mut tries = 1;
    loop {
        let servo = robot.servo_to_cube();
        let outcomes = robot.behave_alone(Hand::Track, servo, Doing::Approaching).await?;
        let outcome = outcomes[Hand::Track.index()].clone();
        match outcome {
            // The palm is at the cube. A cube that an earlier run was handing back is in the
            // operator's hand, who wants it solved after all.
            Some(Outcome::Touched(_)) => {
                if robot.seek_time.take().is_some() {
                    robot.note("a person holds the cube out again: the robot takes it");
                    (robot.given_back, robot.failure) = (false, None);
                    robot.maybe_offered = None;
                }
                return Ok(());
            }
            // The operator keeps the cube that an earlier run was handing back.
            Some(Outcome::LostSight(_) | Outcome::OutOfZone(_) | Outcome::TimedOut(_))
                if robot.seek_time.is_some() =>
            {
                return Err(Failure::NotHeldOut);
            }
            // The camera sees no cube in reach: only the operator can change that.
            Some(unseen @ (Outcome::LostSight(_) | Outcome::OutOfZone(_))) => {
                let why = not_in_reach(robot.settings.keeper, unseen);
                questions::ask_to_show_the_cube(robot, why).await?;
                tries = 1;
            }
            // The hand missed the cube or hit an obstacle: it retracts and retries.
            Some(Outcome::NotTouched | Outcome::OverForce(..)) if tries < TAKE_TRIES => {
                let why = match outcome {
                    Some(met @ Outcome::OverForce(..)) => {
                        format!("{met}, while approaching: the hand retracts, try {tries}")
                    }
                    _ => format!("the cube was not where it was seen, try {tries}"),
                };
                robot.note(why);
                retract(robot, robot.settings.back).await?;
                // The last zero may include the push of an obstacle.
                robot.zero_forces([true, false]).await?;
                tries += 1;
            }
            // The approach has failed too often, or in a way that a retry does not solve.
            other => {
                let found = Outcome::words(other);
                return Err(leave(robot, format!("the cube could not be approached: {found}")));
            }
        }
    }
}

/// Returns the message that no cube is in reach, from the outcome `unseen` of the visual servo.
fn not_in_reach(keeper: Keeper, unseen: Outcome) -> String {
    match (unseen, keeper) {
        (Outcome::OutOfZone(seconds), Keeper::Person) => format!(
            "no cube in reach: it was seen, but outside the place of hand-over for {seconds:.1} s"
        ),
        (Outcome::OutOfZone(seconds), Keeper::Table) => format!(
            "no cube in reach: it was seen, but outside the part of the table where it must lie, \
             for {seconds:.1} s"
        ),
        (Outcome::LostSight(seconds), _) => {
            format!("no cube in sight of the stand-alone camera for {seconds:.1} s")
        }
        (other, _) => other.to_string(),
    }
}

/// Closes the jaws of the track hand on the cube that is held out or lies on the table; returns the
/// reason if they do not hold it.
async fn close(robot: &mut Robot) -> Result<Option<String>, Failure> {
    robot.check_hold()?;
    robot.stops[Hand::Track.index()] = Depth::One;
    let grasp = robot.jaws_close(Depth::One);
    let outcomes = robot.behave_alone(Hand::Track, grasp, Doing::ClosingJaws).await?;
    let edge = robot.settings.edge;
    match outcomes[Hand::Track.index()].clone() {
        // A greater width is a cube with a person's finger beside it.
        Some(Outcome::Grasped(width))
            if width > LEAST_WIDTH * edge && width < edge + MOST_WIDER =>
        {
            // This hold defines the cube frame: the faces get their names only after all are read.
            let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
            robot.belief.taken(Hand::Track, hold, false);
            robot.widths[Hand::Track.index()] = Some(width);
            (robot.taken_at, robot.retract_shortfall) = (Some(robot.track_place().into()), 0.0);
            (robot.untouched, robot.drop_site) = (false, None);
            Ok(None)
        }
        other => Ok(Some(Outcome::words(other))),
    }
}

/// Leaves the cube to the operator, and returns the failure that ends the mission.
pub(super) fn leave(robot: &mut Robot, why: String) -> Failure {
    robot.belief.released(Hand::Track);
    robot.failure = Some(why.clone());
    Failure::Left(why)
}

/// Retracts the track hand with the cube by `distance` (m), after the operator has let go of it. If
/// the cube was taken from the table, there is no wait.
pub(super) async fn retract_with_cube(robot: &mut Robot, distance: f64) -> Result<(), Failure> {
    if robot.settings.keeper == Keeper::Person {
        wait_for_release(robot).await?;
    }
    robot.watch(false).await?;
    retract(robot, distance).await?;
    robot.check_hold()?;
    robot.hand_over = Some(robot.arms[Hand::Track.index()].desired_joints);
    Ok(())
}

/// Pulls at the cube a little, again and again, until no person holds it.
pub(super) async fn wait_for_release(robot: &mut Robot) -> Result<(), Failure> {
    for tries in 1..=RELEASE_TRIES {
        // A person who still pulls may cause an alarm in this wait, which ends no try.
        robot.wait(Hand::Track, RELEASE_WAIT).await?;
        // With a fixed wait of 2.6 s instead of pulls, the arm retracted against a holder with up
        // to 35 N.
        match robot.pull(0.5, Doing::Adjusting).await? {
            Some(Outcome::Touched(_) | Outcome::OverForce(..)) => {
                if tries == 1 {
                    robot.note("the operator still holds the cube");
                }
            }
            other => return released(robot, other),
        }
    }
    // With a new zero a holder still resists the pull, while a wrong sensor does not.
    robot.zero_forces([true, false]).await?;
    let last = robot.pull(0.5, Doing::Adjusting).await?;
    released(robot, last)?;
    // That zero may include the operator's hand, so the force is zeroed again without it.
    robot.zero_forces([true, false]).await
}

/// Checks the outcome of a pull: `Ok` means that no person holds the cube.
fn released(robot: &mut Robot, pull: Option<Outcome>) -> Result<(), Failure> {
    let why = match pull {
        // The cube came along: the hand holds it alone.
        Some(Outcome::NotTouched) => {
            robot.maybe_offered = None;
            return Ok(());
        }
        // An earlier run was handing this cube back, so its holder keeps it.
        Some(Outcome::Touched(_) | Outcome::OverForce(..)) if robot.maybe_offered.is_some() => {
            return Err(Failure::WithOperator("a person holds the cube".to_owned()));
        }
        Some(Outcome::Touched(_)) => "the operator does not let go of the cube".to_owned(),
        other => format!("the cube could not be taken away: {}", Outcome::words(other)),
    };
    Err(leave(robot, why))
}

/// Retracts the track hand by `distance`, or as far as its joints allow (m).
pub(super) async fn retract(robot: &mut Robot, distance: f64) -> Result<(), Failure> {
    robot.check_hold()?;
    let goes = robot.track_retraction(distance);
    // The shortfall is one of the retraction with the cube from the grasp, so it counts only with a
    // cube. A resumed run may not know the place of the grasp, which is not needed here.
    if robot.belief.held[Hand::Track.index()].is_some() {
        robot.retract_shortfall += distance - goes;
    }
    robot.along_gently(Hand::Track, -goes).await
}

impl Robot {
    /// Returns the distance by which an arm retracts (m): `distance`, or less if its joints allow
    /// less but at least `least`. Below `least` it returns `distance`, so that MP refuses the
    /// motion and names the limit.
    pub(super) fn retraction(&mut self, hand: Hand, distance: f64, least: f64) -> f64 {
        let goes = self.free_retraction(hand, distance);
        if goes >= distance || goes < least {
            return distance;
        }
        let (short, all) = (goes * 1e3, distance * 1e3);
        self.note(format!(
            "the joints of the {} arm limit its retraction to {short:.0} of {all:.0} mm",
            hand.name()
        ));
        goes
    }

    /// Returns the part of the retraction `distance` that an arm's joints allow (m).
    pub(super) fn free_retraction(&self, hand: Hand, distance: f64) -> f64 {
        let (fold, arm) = (&self.settings.folds[hand.index()], &self.arms[hand.index()]);
        fold.retractable(&arm.desired_base_from_tool, &arm.desired_joints, distance)
    }

    /// Returns the distance by which the track arm retracts when asked for `distance` (m): see
    /// [`Robot::retraction`]. With the cube, at least two thirds of the usual retraction must be
    /// possible, counted from the place of the grasp, so that the cube leaves the operator's hand.
    /// After the cube was released the length of its edge is enough for the fingers to be clear of
    /// it.
    pub(super) fn track_retraction(&mut self, distance: f64) -> f64 {
        let holds = self.belief.held[Hand::Track.index()].is_some();
        let least = if self.given_back && !holds {
            self.settings.edge
        } else {
            // An earlier try may have retracted by a part already.
            let gone = self.distance_from_grasp().filter(|_| holds).unwrap_or(0.0);
            CLEAR * self.settings.back - gone
        };
        self.retraction(Hand::Track, distance, least)
    }

    /// Returns the distance by which the track retracts with the cube from the place of the grasp
    /// (m): the usual one less the part that its joints did not allow.
    pub(super) fn way_back(&self) -> f64 {
        self.settings.back - self.retract_shortfall
    }

    /// Returns the distance of the track's tool from the place where it grasped the cube (m).
    pub(super) fn distance_from_grasp(&self) -> Option<f64> {
        let from = Vector3::from(self.taken_at?);
        Some((self.track_place() - from).norm())
    }

    /// Returns how much of the retraction with the cube is still to do (m); `None` if the place of
    /// the grasp is unknown.
    pub(super) fn way_back_left(&self) -> Option<f64> {
        self.distance_from_grasp().map(|gone| (self.way_back() - gone).max(0.0))
    }

    /// Returns the set position of the track's tool, in its base (m).
    pub(super) fn track_place(&self) -> Vector3<f64> {
        self.arms[Hand::Track.index()].desired_base_from_tool.translation.vector
    }
}

#[cfg(test)]
mod tests {
    use super::super::assignment::{Assignment, Goal};
    use super::super::robot::MaybeOffered;
    use super::super::testing::{
        EMPTY, Stage, WIDTH, count, goes_well, met, order, play_mission, settings, track, words,
    };
    use super::super::{Mission, recover};
    use super::*;
    use crate::generators::Behaviour;
    use crate::kernel::{Action, Event};
    use crate::motion::ArmState;
    use crate::operator::Answer;
    use crate::reach::Fold;
    use crate::tasks::cube::settings::CubeSettings;

    /// Returns whether an order is one for the visual servo.
    fn is_servo(order: &Behaviour) -> bool {
        matches!(order, Behaviour::VisualServo(_))
    }

    #[test]
    fn blocked_approach_is_retried_then_cube_is_left() {
        let mut stage = Stage::new(settings());

        let (end, actions) =
            stage.play(
                async |robot| acquire(robot).await,
                &mut |action, arms| match order(action) {
                    Some(order) if is_servo(order) => met(),
                    _ => goes_well(action, arms),
                },
            );

        let way = ["acquire", "open", "watch", "zero", "servo"];
        let again = ["line", "zero", "servo"];
        assert_eq!(words(&actions), [&way[..], &again, &again].concat());
        let Err(failure) = end else { panic!("{end:?}") };
        let recover = async |robot: &mut Robot| recover::recover(robot, failure).await;
        let (end, actions) = stage.play(recover, &mut goes_well);
        assert_eq!(words(&actions), ["open", "line"]);
        let Some(Behaviour::Line { target, .. }) = order(&actions[1]) else { panic!() };
        assert!(target.translation.vector.z < 0.0, "{target:?}");
        let told = format!("{end:?}");
        assert!(told.contains("over-force of 31.0 N"), "{told}");
        assert_eq!(stage.robot.whereabouts(), "the operator has the cube");
    }

    #[test]
    fn hand_retracts_from_the_operator_slowly() {
        let mut stage = Stage::new(settings());
        let (gentle, full) = (stage.robot.settings.gentle, stage.robot.settings.speed);

        let draws_back = async |robot: &mut Robot| {
            retract(robot, 0.05).await?;
            robot.along(Hand::Track, -0.05).await
        };
        let (end, actions) = stage.play(draws_back, &mut goes_well);

        let speed = |action| match order(action) {
            Some(Behaviour::Line { speed, .. }) => *speed,
            other => panic!("{other:?}"),
        };
        assert!(end.is_ok(), "{end:?}");
        assert_eq!(actions.iter().map(speed).collect::<Vec<_>>(), [gentle, full]);
    }

    #[test]
    fn missed_cube_is_approached_again_after_force_zeroing() {
        let mut tries = 0;
        let mut stage = Stage::new(settings());

        let (end, actions) = stage.play(
            async |robot| approach(robot).await,
            &mut |action, arms| match order(action) {
                Some(order) if is_servo(order) => {
                    tries += 1;
                    track(if tries == 1 { Outcome::NotTouched } else { Outcome::Touched(0.0) })
                }
                _ => goes_well(action, arms),
            },
        );

        assert_eq!((end, words(&actions)), (Ok(()), vec!["servo", "line", "zero", "servo"]));
    }

    /// An operator who holds out again a cube that an earlier run was handing back wants it solved.
    #[test]
    fn cube_held_out_again_counts_as_not_returned() {
        let mut stage = Stage::new(settings());
        let robot = &mut stage.robot;
        (robot.seek_time, robot.given_back) = (Some(5.0), true);
        robot.failure = Some("a layer is misaligned".to_owned());
        robot.maybe_offered = Some(MaybeOffered { opening: false });

        let (end, _) = stage.play(async |robot| approach(robot).await, &mut goes_well);

        let robot = &stage.robot;
        assert_eq!((end, robot.failure.as_ref()), (Ok(()), None));
        assert_eq!((robot.seek_time, robot.given_back, robot.maybe_offered), (None, false, None));
    }

    /// Waits for the release of the cube while a person holds on to [`RELEASE_TRIES`] pulls; the
    /// pull after them ends with the outcome `last`. Returns the result, the words of the actions,
    /// and the stage.
    fn release(last: &Outcome) -> (Result<(), Failure>, Vec<&'static str>, Stage) {
        let mut stage = Stage::holding(settings());
        let mut pulls = 0;
        let (end, actions) = stage.play(
            async |robot| wait_for_release(robot).await,
            &mut |action, arms| match order(action) {
                Some(Behaviour::Withdraw { .. }) => {
                    pulls += 1;
                    track(if pulls <= RELEASE_TRIES { Outcome::Touched(3.0) } else { last.clone() })
                }
                _ => goes_well(action, arms),
            },
        );
        (end, words(&actions), stage)
    }

    /// Each pull measures a force, until the sensor is zeroed before the last one: no person holds
    /// the cube, and the force was an error of the zero.
    #[test]
    fn force_sensor_is_zeroed_before_last_pull() {
        let (end, words, mut stage) = release(&Outcome::NotTouched);

        assert_eq!(end, Ok(()));
        let pulls = ["yield", "pull"].repeat(RELEASE_TRIES as usize);
        // The force is zeroed again in free air.
        assert_eq!(words, [&pulls[..], &["zero", "pull", "zero"]].concat());
        assert_eq!(stage.robot.whereabouts(), "the track hand holds the cube");
        assert_eq!(stage.notes(), ["the operator still holds the cube"]);
    }

    #[test]
    fn operator_who_holds_on_keeps_the_cube() {
        let (end, _, mut stage) = release(&Outcome::Touched(3.0));

        let Err(failure) = end else { panic!() };
        let recover = async |robot: &mut Robot| recover::recover(robot, failure).await;
        let (_, actions) = stage.play(recover, &mut goes_well);
        let Some(Behaviour::Jaw { strained, jaw, .. }) = order(&actions[0]) else { panic!() };
        assert!(*strained && jaw.opening > 0.08, "the jaws open under any strain");
        assert!(stage.robot.whereabouts().contains("unknown"));
    }

    #[test]
    fn jaws_accept_only_widths_of_a_cube() {
        // A clenched cube, a cube with a misaligned layer, and one with a finger beside it.
        for (width, kept) in [(0.0565, true), (0.062, true), (0.065, false), (EMPTY, false)] {
            let mut stage = Stage::new(settings());

            let (end, _) = stage
                .play(async |robot| close(robot).await, &mut |_, _| track(Outcome::Grasped(width)));

            assert_eq!(end.unwrap().is_none(), kept, "{width}");
            assert_eq!(stage.robot.belief.held[0].is_some(), kept, "{width}");
        }
    }

    /// Plays a mission that sees no cube. With `patience` an operator is there, who gives `answer`
    /// to the first question and none to others. Returns the words of the actions, and the reason
    /// of the end.
    fn unseen(patience: Option<f64>, answer: Option<Answer>) -> (Vec<&'static str>, String) {
        let assignment = Assignment { patience, ..Assignment::new(Goal::Solve) };
        let mut mission = Mission::new(settings(), assignment);
        let arms = [ArmState { jaw_opening: 0.09, ..ArmState::default() }; 2];
        let mut answers = vec![answer];
        let (end, actions) = play_mission(&mut mission, arms, &mut |action, arms| match action {
            Action::Ask(question) => {
                assert!(question.text.contains("no cube in sight"), "{}", question.text);
                Event::Answered(answers.pop().flatten())
            }
            _ if order(action).is_some_and(is_servo) => track(Outcome::LostSight(60.0)),
            _ => goes_well(action, arms),
        });
        assert!(!end.achieved && end.reason.contains("no cube in sight"), "{}", end.reason);
        (words(&actions), end.reason)
    }

    #[test]
    fn operator_answer_repeats_search_for_unseen_cube() {
        let (words, _) = unseen(Some(30.0), Some(Answer::Choice { option: 0 }));
        assert_eq!(words[4..], ["servo", "ask", "servo", "ask"]);

        for answer in [Some(Answer::Choice { option: 1 }), Some(Answer::Declined), None] {
            let (words, _) = unseen(Some(30.0), answer);
            assert_eq!(words[4..], ["servo", "ask"]);
        }
        let (words, _) = unseen(None, None);
        assert_eq!(words[4..], ["servo"], "no operator is there");
    }

    /// Returns an arm whose joints allow only a part of a retraction by 0.3 m, and that part (m).
    fn folding() -> (ArmState, f64) {
        let (desired_joints, desired_base_from_tool) = Fold::example_stand();
        let goes = settings().folds[0].retractable(&desired_base_from_tool, &desired_joints, 0.3);
        let arm = ArmState { desired_joints, desired_base_from_tool, ..ArmState::default() };
        (arm, goes)
    }

    #[test]
    fn retraction_shortfall_is_stored_only_with_cube() {
        let (arm, goes) = folding();
        for (holds, known) in [(true, true), (true, false), (false, false)] {
            let mut stage = Stage::new(CubeSettings { back: 1.2 * goes, ..settings() });
            stage.robot.arms[0] = arm;
            if holds {
                stage.robot.hold(Hand::Track);
            }
            let place = stage.robot.track_place().into();
            stage.robot.taken_at = known.then_some(place);

            let draws = async |robot: &mut Robot| retract(robot, 1.2 * goes).await;
            let (end, _) = stage.play(draws, &mut goes_well);

            assert_eq!(end, Ok(()));
            let expected = if holds { 0.2 * goes } else { 0.0 };
            assert!((stage.robot.retract_shortfall - expected).abs() < 1e-12, "{holds} {known}");
        }
    }

    #[test]
    fn retraction_counts_the_distance_already_covered() {
        let (arm, goes) = folding();
        // The joints of the arm allow six tenths of the usual retraction.
        let back = goes / 0.6;
        let drawn = |before: f64| {
            let mut stage = Stage::holding(CubeSettings { back, ..settings() });
            stage.robot.arms[0] = arm;
            let taken_at = arm.desired_base_from_tool * nalgebra::Point3::new(0.0, 0.0, before);
            stage.robot.taken_at = Some(taken_at.into());
            stage.robot.track_retraction(back)
        };

        assert_eq!(drawn(0.0), back, "the cube would stay in the operator's hand: the arm refuses");
        assert_eq!(drawn(0.1 * back), goes, "the whole distance is enough");
    }

    #[test]
    fn empty_hand_must_retract_at_least_cube_edge() {
        let (arm, goes) = folding();
        let drawn = |edge: f64| {
            let mut stage = Stage::new(CubeSettings { back: 2.0 * goes, edge, ..settings() });
            stage.robot.arms[0] = arm;
            (stage.robot.given_back, stage.robot.taken_at) = (true, Some([0.0; 3]));
            stage.robot.track_retraction(2.0 * goes)
        };

        assert_eq!(drawn(0.9 * goes), goes);
        assert_eq!(drawn(1.1 * goes), 2.0 * goes, "the arm refuses");
    }

    #[test]
    fn blocked_path_is_tried_again_three_times() {
        let mut stage = Stage::new(settings());
        let to = crate::motion::JointPositions([0.4; 7]);
        let goes = async |robot: &mut Robot| robot.joints([Some(to), Some(to)]).await;

        let (end, actions) = stage.play(goes, &mut |action, _| match order(action) {
            Some(Behaviour::Joints { .. }) => met(),
            _ => track(Outcome::TimedOut(1.0)),
        });

        let again = ["yield", "joints"].repeat(3);
        assert_eq!(words(&actions), [&["joints"][..], &again].concat());
        let joints: Vec<_> =
            actions.iter().filter(|a| count(&[(*a).clone()], "joints") == 1).collect();
        let leads_there = |order: &Option<Behaviour>| {
            let Some(Behaviour::Joints { target, .. }) = order else { return false };
            *target == to
        };
        let leads = |action: &Action<_>| {
            let Action::Behave { orders, .. } = action else { return false };
            orders.iter().all(leads_there)
        };
        assert!(joints.iter().all(|action| leads(action)), "{joints:?}");
        assert!(matches!(end, Err(Failure::Final(why)) if why.contains("while moving")));
    }

    #[test]
    fn retry_limit_restarts_at_each_jaw_opening() {
        use super::super::actions::MOST_STRAINED;
        let mut stage = Stage::new(settings());
        let open = |stage: &mut Stage, strained: u32| {
            let mut left = strained;
            let opens = async |robot: &mut Robot| robot.open(Hand::Postument, Depth::One).await;
            let (end, actions) = stage.play(opens, &mut |action, arms| match order(action) {
                Some(Behaviour::Jaw { .. }) if left > 0 => {
                    left -= 1;
                    Event::Behaved(vec![None, Some(Outcome::OverForce(0, 30.0))])
                }
                _ => goes_well(action, arms),
            });
            (end.is_ok(), count(&actions, "open"))
        };

        for _ in 0..2 {
            assert_eq!(open(&mut stage, MOST_STRAINED), (true, MOST_STRAINED as usize + 1));
        }
        assert_eq!(open(&mut stage, MOST_STRAINED + 1), (false, MOST_STRAINED as usize + 1));
    }

    #[test]
    fn lost_cube_stops_the_next_action() {
        for hand in Hand::BOTH {
            // The pads give by 1.2 mm at most.
            for (closed_by, lost) in [(0.0011, false), (0.0013, true)] {
                let mut stage = Stage::new(settings());
                stage.robot.hold(hand);
                stage.robot.arms[hand.index()].jaw_opening = WIDTH - closed_by;

                let waits = async |robot: &mut Robot| robot.wait(Hand::Track, 1.0).await;
                let (end, actions) = stage.play(waits, &mut goes_well);

                let failure = lost.then_some(Failure::Lost(hand));
                assert_eq!((end.err(), actions.is_empty()), (failure, lost), "{hand:?}");
            }
        }
    }
}
