//! Decisions after a failure: the hand that lets go of the cube, and the station that follows.
//!
//! - in: the failure that ended a procedure, the holds of both hands
//! - out: the station at which the mission continues, or the failure that replaces the first one
//!
//! | failure | decision |
//! |---|---|
//! | a hand lost the cube, the partner holds it | the cube is read again, or goes back |
//! | the cube fell | the hand moves to the place of hand-over, and takes it again |
//! | a grasp failed, the partner holds the cube | the cube is read again, or goes back |
//! | the cube lies tilted in a hand | the track gives it back; a person takes it out of the other |
//! | a turn failed | the layer is brought back into line, then the cube is read again |
//! | [`MOST_RECOVERIES`] recoveries failed | the cube goes back as it is |
//! | the operator does not let go | the operator keeps the cube, and the mission ends |
//! | a person has a cube that an earlier run held out | the person keeps it, and it is looked for |
//! | a hand is pressed beyond its limits | the mission ends without a motion |
//!
//! After a failure the mission trusts the jaws and the cameras alone. So a mission that another run
//! left unfinished continues with the same stations: see [`super::resume`].

use super::assignment::Goal;
use super::failure::Failure;
use super::robot::{MOST_RECOVERIES, Robot};
use super::station::Station;
use super::take::retract;
use super::turn_in_progress::TurnInProgress;
use super::{give_back, realign, regrasp, resume};
use crate::motion::{Depth, JointPositions};
use crate::tasks::cube::hold::Hand;

/// Recovers from a failure. Returns the station at which the mission continues, or the failure that
/// replaces this one and is handled next.
pub(super) async fn recover(robot: &mut Robot, failure: Failure) -> Result<Station, Failure> {
    // The loss of the cube takes precedence over most failures. Exceptions are failures that end
    // the mission anyhow: a hand that is pressed beyond its limits must not move on to look for the
    // cube. Another one is a failed turn, since the realignment itself regrasps a lost layer.
    let looks_at_hold = !matches!(
        failure,
        Failure::Final(_) | Failure::Lost(_) | Failure::Strained(_) | Failure::TurnFailed { .. }
    );
    if looks_at_hold {
        robot.check_hold()?;
    }
    match failure {
        // No rule recovers from these failures: the mission ends.
        Failure::Final(why) | Failure::Strained(why) | Failure::Hidden { why, .. } => {
            Ok(Station::Over(robot.failed(why)))
        }
        Failure::Lost(hand) => lost(robot, hand).await,
        Failure::NotGrasped { hand, why, .. } => Err(not_grasped(robot, hand, why)),
        // Even the last recovery realigns, since a misaligned layer cannot be grasped.
        Failure::TurnFailed { turner } => {
            let release = Some(realign::bring_into_line(robot, turner).await?);
            Err(if robot.recoveries < MOST_RECOVERIES {
                Failure::ReadAgain { release }
            } else {
                Failure::GiveUp { release }
            })
        }
        // A recovery: one hand holds the cube, and all six faces are read again.
        Failure::ReadAgain { release } => {
            if let Some(hand) = release {
                regrasp::let_go(robot, hand).await?;
            }
            robot.check_hold()?;
            robot.forget_cube();
            Ok(Station::Read { phase: "identify again" })
        }
        // The recoveries are used up.
        Failure::GiveUp { release } => {
            if let Some(hand) = release {
                regrasp::let_go(robot, hand).await?;
            }
            robot.check_hold()?;
            Ok(Station::Unsolved(robot.reason_to_give_up()))
        }
        Failure::GiveBack(why) => Ok(Station::Unsolved(why)),
        // The operator keeps the cube, so no strain of the pull may stop the jaws.
        Failure::Left(why) => {
            robot.open_to(Hand::Track, Depth::One, true).await?;
            retract(robot, robot.settings.back).await?;
            robot.failure = None;
            Ok(Station::Over(robot.failed(why)))
        }
        Failure::WithOperator(why) => resume::leave_to_the_operator(robot, why).await,
        // The operator has the cube back, solved unless the other run says otherwise.
        Failure::NotHeldOut => {
            let achieved = robot.failure.is_none();
            robot.watch(false).await?;
            give_back::finish(robot, achieved).map(Station::Over)
        }
    }
}

/// Returns the station or the failure that follows after `hand` has lost the cube.
async fn lost(robot: &mut Robot, hand: Hand) -> Result<Station, Failure> {
    let lost = format!("the cube has slipped out of the {} hand", hand.name());
    robot.belief.released(hand);
    // A cube that may have been held out was pulled out of the jaws.
    if hand == Hand::Track && robot.maybe_offered.is_some() {
        return Err(Failure::WithOperator(lost));
    }
    // No other hand holds it, so it fell.
    if robot.belief.held[hand.other().index()].is_none() {
        return fallen(robot, hand, lost).await;
    }
    if !robot.may_recover() {
        return Err(returned_by_partner(robot, hand, lost));
    }
    robot.note(format!("{lost}: the cube is read again"));
    Err(Failure::ReadAgain { release: Some(hand) })
}

/// Reports the place where the cube fell, and waits for it at the place of hand-over. `lost` says
/// which hand lost the cube.
async fn fallen(robot: &mut Robot, hand: Hand, lost: String) -> Result<Station, Failure> {
    robot.note_fall(hand);
    let Some(hand_over) = robot.hand_over.filter(|_| robot.may_recover()) else {
        return Err(Failure::Final(lost));
    };
    robot.note(format!("{lost} and has fallen: {next}", next = robot.after_fall()));
    robot.forget_cube();
    robot.forget_grasp();
    wait_for_the_cube(robot, hand, hand_over).await?;
    // Only now: a mission that is resumed on the way needs the place.
    robot.forget_hand_over();
    Ok(Station::Take)
}

/// Opens the hand that lost the cube, and moves the track to the place of hand-over.
async fn wait_for_the_cube(
    robot: &mut Robot,
    hand: Hand,
    hand_over: JointPositions,
) -> Result<(), Failure> {
    robot.phase("wait for the cube").await?;
    robot.open(hand, Depth::One).await?;
    regrasp::return_to(robot, hand_over).await
}

/// Returns the failure that replaces a failed grasp of `hand`: the cube in the partner's hand is
/// read again, or goes back after the last recovery. The mission ends if the partner does not hold
/// it.
fn not_grasped(robot: &mut Robot, hand: Hand, why: String) -> Failure {
    if robot.belief.held[hand.other().index()].is_none() {
        return Failure::Final(why);
    }
    if !robot.may_recover() {
        return returned_by_partner(robot, hand, why);
    }
    robot.note(format!("{why}: the cube is read again"));
    Failure::ReadAgain { release: Some(hand) }
}

/// Returns the failure with which `hand` lets go and its partner gives the cube back as it is,
/// since the recoveries are used up. A second failure on the way back ends the mission.
fn returned_by_partner(robot: &mut Robot, hand: Hand, why: String) -> Failure {
    if robot.goal != Goal::Solve || robot.failure.is_some() {
        return Failure::Final(why);
    }
    robot.failure = Some(why);
    Failure::GiveUp { release: Some(hand) }
}

impl Robot {
    /// Returns the reason for which the cube goes back with a layer that may be misaligned.
    fn reason_to_give_up(&mut self) -> String {
        let turn = self.turn_in_progress.take().and_then(TurnInProgress::into_why);
        let why = turn.or_else(|| self.failure.take());
        why.unwrap_or_else(|| "a layer is misaligned".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::super::robot::{MaybeOffered, UNSURE};
    use super::super::testing::{EMPTY, Stage, goes_well, settings, taken, words};
    use super::*;
    use crate::cube::{Face, Facelets, Keeper, Turn};
    use crate::generators::Behaviour;
    use crate::kernel::Action;
    use crate::spatial::Pose;
    use crate::tasks::cube::hold::Grip;
    use crate::tasks::cube::settings::CubeSettings;
    use crate::tasks::cube::think::Thought;

    /// Recovers from a failure, with all actions successful. Returns the station or the failure
    /// that follows, and the actions.
    fn recovers(
        stage: &mut Stage,
        failure: Failure,
    ) -> (Result<Station, Failure>, Vec<Action<Thought>>) {
        let recovers = async |robot: &mut Robot| recover(robot, failure).await;
        stage.play(recovers, &mut goes_well)
    }

    #[test]
    fn cube_is_read_again_after_failed_grasp() {
        let mut stage = Stage::holding(settings());
        // One recovery is left.
        stage.robot.recoveries = MOST_RECOVERIES - 1;
        let failure =
            Failure::NotGrasped { hand: Hand::Postument, why: "missed".to_owned(), empty: false };

        let (end, _) = recovers(&mut stage, failure);
        assert_eq!(end, Err(Failure::ReadAgain { release: Some(Hand::Postument) }));
        let (end, actions) = recovers(&mut stage, end.unwrap_err());

        assert_eq!(end, Ok(Station::Read { phase: "identify again" }));
        assert_eq!(words(&actions), ["open", "line"]);
        assert_eq!(stage.robot.recoveries, MOST_RECOVERIES);
    }

    #[test]
    fn partner_returns_cube_after_last_recovery() {
        for holder in [Hand::Track, Hand::Postument] {
            let mut stage = Stage::new(settings());
            stage.robot.hold(holder);
            stage.robot.recoveries = MOST_RECOVERIES;
            let hand = holder.other();
            let failure = || Failure::NotGrasped { hand, why: "missed".to_owned(), empty: false };

            let (end, _) = recovers(&mut stage, failure());
            assert_eq!(end, Err(Failure::GiveUp { release: Some(hand) }));
            let (end, _) = recovers(&mut stage, end.unwrap_err());
            assert_eq!(end, Ok(Station::Unsolved("missed".to_owned())));

            // A failure on the way back is final.
            stage.robot.failure = Some("a layer is misaligned".to_owned());
            let (end, _) = recovers(&mut stage, failure());
            let (end, _) = recovers(&mut stage, end.unwrap_err());
            let Ok(Station::Over(finish)) = end else { panic!("{end:?}") };
            assert!(!finish.achieved);
            assert!(finish.reason.starts_with("a layer is misaligned; missed; the "));
            assert!(finish.reason.ends_with(" hand holds the cube"), "{}", finish.reason);
        }
    }

    #[test]
    fn track_arm_awaits_fallen_cube_at_hand_over() {
        for (keeper, told) in [
            (Keeper::Person, "hold it out again, please"),
            (Keeper::Table, "looks for it on the table"),
        ] {
            let mut settings = CubeSettings { keeper, ..settings() };
            settings.arms[0].world_from_base = Pose::translation(0.1, 0.3, 0.0);
            let mut stage = Stage::holding(settings);
            stage.robot.arms[0].base_from_tool = Pose::translation(0.5, -0.2, 0.9);
            let place = JointPositions([0.3; 7]);
            stage.robot.hand_over = Some(place);

            let (end, actions) = recovers(&mut stage, Failure::Lost(Hand::Track));

            assert_eq!(end, Ok(Station::Take));
            assert_eq!(words(&actions), ["wait for the cube", "open", "joints"]);
            let Action::Behave { orders, .. } = &actions[2] else { panic!("{actions:?}") };
            let [Some(Behaviour::Joints { target, .. }), None] = orders[..] else {
                panic!("{orders:?}")
            };
            assert_eq!(target, place);
            assert_eq!(stage.robot.hand_over, None, "the next place of hand-over may differ");
            assert_eq!(
                stage.robot.whereabouts(),
                "it fell from the track hand and lies below the last position of that hand, x 600 \
                 mm, y 100 mm in the world frame"
            );
            assert!(stage.notes().iter().any(|note| note.ends_with(told)));
            assert_eq!((stage.robot.log.drops, stage.robot.recoveries), (1, 1));
        }
    }

    #[test]
    fn fallen_cube_without_known_hand_over_ends_mission() {
        let mut stage = Stage::holding(settings());

        let (end, _) = recovers(&mut stage, Failure::Lost(Hand::Track));

        let lost = "the cube has slipped out of the track hand";
        assert_eq!(end, Err(Failure::Final(lost.to_owned())));
    }

    #[test]
    fn lost_cube_takes_precedence_over_other_failures() {
        let why = || "no plan".to_owned();
        for failure in [
            Failure::GiveBack(why()),
            Failure::Hidden { face: Face::U, why: why() },
            Failure::NotGrasped { hand: Hand::Postument, why: why(), empty: false },
        ] {
            let mut stage = Stage::holding(settings());
            stage.robot.arms[0].jaw_opening = EMPTY;

            let (end, _) = recovers(&mut stage, failure);

            assert_eq!(end, Err(Failure::Lost(Hand::Track)));
        }
    }

    /// An arm that is pressed beyond its limits does not move on to look for the cube.
    #[test]
    fn strained_hand_takes_precedence_over_lost_cube() {
        let mut stage = Stage::holding(settings());
        stage.robot.arms[0].jaw_opening = EMPTY;

        let (end, actions) = recovers(&mut stage, Failure::Strained("pressed".to_owned()));

        let Ok(Station::Over(finish)) = end else { panic!("{end:?}") };
        assert!(finish.reason.starts_with("pressed"), "{}", finish.reason);
        assert!(actions.is_empty(), "{actions:?}");
    }

    #[test]
    fn recovery_forgets_the_last_reading() {
        let mut stage = Stage::holding(settings());
        let robot = &mut stage.robot;
        (0..54).for_each(|facelet| robot.sight.see(facelet, [100.0; 3], 1.0));
        robot.sight.hide(Hand::Track, taken(), Face::U);
        (robot.given, robot.shown.net.decided) = (Some(Facelets::solved()), true);
        robot.failure = Some("face U cannot be read".to_owned());
        (robot.given_back, robot.rounds) = (true, 2);
        robot.maybe_offered = Some(MaybeOffered { opening: true });
        let turn = Some(Turn { face: Face::U, quarters: 1 });
        (robot.stalled, robot.turning) = (turn, turn);
        robot.straight = robot.straight_now(Hand::Track);
        let grip = Grip { hold: taken(), half_roll: false };
        robot.turn_in_progress = Some(TurnInProgress::new(Hand::Track, grip, 0.0, 1.0));
        assert!(robot.straight.is_some() && robot.sight.missing().is_empty());

        robot.forget_cube();

        assert_eq!((robot.sight.missing().len(), robot.sight.wanted().hidden.len()), (54, 0));
        assert!(robot.given.is_none() && !robot.shown.net.decided);
        assert_eq!((robot.failure.as_ref(), robot.given_back, robot.rounds), (None, false, 1));
        assert_eq!((robot.maybe_offered, robot.stalled, robot.turning), (None, None, None));
        assert!(robot.straight.is_none() && robot.turn_in_progress.is_none());
        assert_eq!((robot.miss, robot.log.recoveries), (UNSURE, 1), "the cube may have moved");
    }
}
