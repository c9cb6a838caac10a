//! Turn of one layer, while the partner's arm yields.
//!
//! - in: a turn of the plan, or an angle
//! - out: the turned layer; after a jam or a slip a [`Failure::TurnFailed`] in a mission that
//!   solves, a [`Failure::Final`] in the task `face_turn`
//! - source: Zieliński et al. (2007), p. 373
//!
//! | limit | value | reason |
//! |---|---|---|
//! | [`TURN_TRIES`] | 2 | retries of a layer that stalls, each after it was eased back |
//! | [`EASE_BACK`] | 0.09 rad | the most by which a stalled layer is turned back |

use super::actions::Closing;
use super::assignment::Goal;
use super::failure::{Failure, alarm};
use super::regrasp;
use super::robot::Robot;
use super::shared::Doing;
use super::turn_in_progress::TurnInProgress;
use crate::cube::{Face, Turn};
use crate::generators::Outcome;
use crate::kernel::Finish;
use crate::motion::Depth;
use crate::tasks::cube::hold::{Grip, Hand, Hold};
use std::f64::consts::{FRAC_PI_2, PI};

/// Number of retries of a stalled turn.
const TURN_TRIES: u32 = 2;
/// Greatest angle by which a stalled layer is eased back (rad).
const EASE_BACK: f64 = 0.09;

/// Makes a turn of the plan. The belief gets the hold after the turn before the hand moves, because
/// the realignment after a failed turn starts from that hold.
pub(super) async fn turn_layer(robot: &mut Robot, turner: Hand, turn: Turn) -> Result<(), Failure> {
    robot.straight = robot.straight_now(turner);
    let angle = turn_angle(robot, turner, turn.quarters)?;
    robot.turning = Some(turn);
    let held = robot.belief.held[turner.index()].ok_or("the turning hand holds no cube")?;
    let grip = Grip { hold: held.hold, half_roll: held.half_roll };
    let roll = robot.arms[turner.index()].desired_joints.0[6];
    robot.turn_in_progress = Some(TurnInProgress::new(turner, grip, roll, angle.signum()));
    let (hold, half_roll) = held.hold.after_turn(held.half_roll, turn.quarters);
    robot.belief.turned(turner, hold, half_roll);
    turn_through(robot, turner, angle).await.map(drop)
}

/// Turns the layer under the turner's palm by `angle` (rad), with retries after stalls, and returns
/// the sum of the angles turned (rad).
pub(super) async fn turn_through(
    robot: &mut Robot,
    turner: Hand,
    angle: f64,
) -> Result<f64, Failure> {
    let mut turned = 0.0;
    // A stack of the remaining angles (rad), the next one last, each with the number of its try.
    let mut angles_left = vec![(angle, 1)];
    while let Some((angle, tries)) = angles_left.pop() {
        let outcomes = robot.turn(turner, angle, robot.settings.turn_torque).await?;
        if let Some(met) = alarm(&outcomes, Doing::Turning) {
            return Err(failed(robot, turner, &met.why));
        }
        match outcomes[turner.index()].clone() {
            Some(Outcome::Turned(by)) => turned += by,
            // An early stall: a small turn back frees the layer, then the rest follows.
            Some(Outcome::Stalled(by, torque)) if tries <= TURN_TRIES => {
                let (done, all) = (by.to_degrees(), angle.to_degrees());
                robot.note(format!(
                    "the face stalled after {done:.0} deg of {all:.0} under {torque:.1} Nm: eased \
                     back, try {tries}"
                ));
                turned += by;
                robot.stalled = robot.turning.or(robot.stalled);
                let ease = -angle.signum() * EASE_BACK.min(by.abs());
                // A stall of the turn back counts as a try of the whole turn.
                angles_left.push((angle - by - ease, tries + 1));
                angles_left.push((ease, tries + 1));
            }
            // The layer has stalled too often: it is jammed.
            Some(Outcome::Stalled(by, torque)) => {
                let degrees = (turned + by).to_degrees();
                let why =
                    format!("jam: the face stalled after {degrees:.0} deg under {torque:.1} Nm");
                return Err(failed(robot, turner, &why));
            }
            // The grip slipped over the layer, which lags behind the hand by an unknown angle.
            Some(slipped @ Outcome::Slipped(..)) => {
                return Err(failed(robot, turner, &slipped.to_string()));
            }
            other => {
                let why = format!("the turn ended unexpectedly: {}", Outcome::words(other));
                return Err(Failure::Final(why));
            }
        }
    }
    if let Some(turn) = robot.turning.take() {
        robot.shown.facelets = robot.shown.facelets.map(|facelets| facelets.turned(turn));
        robot.log.executed.push(turn);
        (robot.straight, robot.turn_in_progress) = (None, None);
    }
    Ok(turned)
}

/// Returns the failure of a turn that did not reach its angle for the reason `why`. In a mission
/// that solves, its layer is realigned next.
fn failed(robot: &mut Robot, turner: Hand, why: &str) -> Failure {
    // The task `face_turn` has no plan to go back to, so its failure is final.
    let solves = robot.goal == Goal::Solve;
    let Some(turn) = robot.turn_in_progress.as_mut().filter(|turn| solves && turn.is_of(turner))
    else {
        return Failure::Final(why.to_owned());
    };
    turn.failed(why);
    robot.note(format!("{why}: the layer is realigned"));
    (robot.turning, robot.straight) = (None, None);
    Failure::TurnFailed { turner }
}

/// Returns the angle by which the turner's tool must roll to turn its layer by a number of
/// clockwise quarter turns (rad). The tool's z points into the cube, so clockwise seen from outside
/// is positive about it.
fn turn_angle(robot: &Robot, turner: Hand, quarters: u8) -> Result<f64, String> {
    let meeting = robot.meeting.ok_or("the arms have not met")?;
    let room = match turner {
        Hand::Track => meeting.track_roll,
        Hand::Postument => meeting.postument_roll,
    };
    Ok(match quarters {
        1 => FRAC_PI_2,
        3 => -FRAC_PI_2,
        _ => half_turn(room),
    })
}

/// Returns a half turn, pi or -pi, in the sense in which the wrist has more `room` to roll (rad).
fn half_turn(room: (f64, f64)) -> f64 {
    if room.1 > -room.0 { PI } else { -PI }
}

/// Grasps the cube in the postument's hand, turns the layer under the track's palm by an angle, and
/// lets go: the task `face_turn`.
pub(super) async fn turn_face(robot: &mut Robot, angle: f64) -> Result<Finish, Failure> {
    let held = robot.belief.held[Hand::Postument.index()].ok_or("no hand holds the cube")?;
    // The track grasps and turns the outer layer opposite the postument's palm.
    let hold = Hold { palm: held.hold.palm.opposite(), depth: Depth::One, ..held.hold };
    let grip = Grip { hold, half_roll: false };
    robot.apart = false;
    robot.phase("grasp").await?;
    // The postument has held the cube from the start, so its jaw distance on the cube is unknown.
    robot.close(Hand::Postument, held.hold, Closing::Straight).await?;
    robot.open(Hand::Track, Depth::One).await?;
    robot.zero_forces([true, true]).await?;
    regrasp::close_on(robot, Hand::Track, grip).await?;
    robot.secure(Hand::Track, grip).await?;
    robot.phase("turn").await?;
    let turned = turn_through(robot, Hand::Track, angle).await?;
    robot.phase("release").await?;
    regrasp::let_go(robot, Hand::Track).await?;
    robot.check_hold()?;

    let quarters = (turned / FRAC_PI_2).round() as i32;
    robot.log.executed.extend(Turn::new(Face::U, quarters.rem_euclid(4) as u8));
    robot.publish(Doing::Nothing);
    let achieved = (turned - angle).abs() < 0.05;
    Ok(Finish {
        achieved,
        reason: format!("the face was turned by {:.1} deg", turned.to_degrees()),
    })
}

#[cfg(test)]
mod tests {
    use super::super::assignment::Assignment;
    use super::super::testing::{Stage, count, goes_well, order, settings, taken, words};
    use super::*;
    use crate::generators::Behaviour;
    use crate::kernel::Event;
    use crate::tasks::cube::settings::CubeSettings;

    /// Turns the layer of the track hand by a quarter while both hands hold the cube. The turns end
    /// with these outcomes in order, and with success afterwards. Returns the result, and the
    /// ordered angles (rad).
    fn turns(ends: &[Outcome]) -> (Result<f64, Failure>, Vec<f64>) {
        let mut stage = Stage::holding(settings());
        stage.robot.hold(Hand::Postument);
        let (mut ends, mut angles) = (ends.iter(), Vec::new());
        let turns = async |robot: &mut Robot| turn_through(robot, Hand::Track, FRAC_PI_2).await;
        let (end, _) = stage.play(turns, &mut |action, arms| match order(action) {
            Some(Behaviour::Turn { angle, .. }) => {
                angles.push(*angle);
                let outcome = ends.next().cloned().unwrap_or(Outcome::Turned(*angle));
                Event::Behaved(vec![Some(outcome), Some(Outcome::Ended)])
            }
            _ => goes_well(action, arms),
        });
        (end, angles)
    }

    /// The layer is eased back slowly: at 3 rad/s2 the short turn of a jammed motor made its
    /// encoder look frozen.
    #[test]
    fn stalled_layer_is_eased_back_slowly() {
        let mut stage = Stage::holding(CubeSettings { turn_acceleration: 3.0, ..settings() });
        stage.robot.hold(Hand::Postument);
        let (mut stalls, mut seen) = (true, Vec::new());
        let turns = async |robot: &mut Robot| turn_through(robot, Hand::Track, FRAC_PI_2).await;
        let (end, _) = stage.play(turns, &mut |action, arms| match order(action) {
            Some(Behaviour::Turn { angle, acceleration, .. }) => {
                seen.push((angle.abs() < 0.1, *acceleration));
                let stalled = std::mem::take(&mut stalls).then_some(Outcome::Stalled(1.0, 2.0));
                let outcome = stalled.unwrap_or(Outcome::Turned(*angle));
                Event::Behaved(vec![Some(outcome), Some(Outcome::Ended)])
            }
            _ => goes_well(action, arms),
        });

        assert!(end.is_ok(), "{end:?}");
        assert_eq!(seen, [(false, 3.0), (true, 1.0), (false, 3.0)]);
    }

    #[test]
    fn stalled_turn_is_eased_back_and_finished() {
        // A layer that stalls at once is eased back to where it was, and no farther.
        for (stalled, eased) in [(1.0, 0.09), (0.05, 0.05)] {
            let (end, angles) = turns(&[Outcome::Stalled(stalled, 2.0)]);

            assert!((end.unwrap() - FRAC_PI_2).abs() < 1e-12);
            assert_eq!(angles.len(), 3);
            assert!((angles[1] + eased).abs() < 1e-12, "{angles:?}");
            assert!((angles[2] - (FRAC_PI_2 - stalled + eased)).abs() < 1e-12, "{angles:?}");
        }
    }

    #[test]
    fn layer_counts_as_jammed_after_third_stall() {
        let stall = Outcome::Stalled(0.5, 2.0);

        let (end, angles) = turns(&[stall.clone(), Outcome::Turned(-0.09), stall.clone(), stall]);

        let Err(Failure::Final(why)) = end else { panic!("{end:?}") };
        assert!(why.starts_with("jam: the face stalled"), "{why}");
        assert_eq!(angles.len(), 4, "{angles:?}");
    }

    #[test]
    fn half_turn_takes_direction_with_more_joint_range() {
        assert_eq!((half_turn((-1.0, 3.5)), half_turn((-3.5, 1.0))), (PI, -PI));
    }

    #[test]
    fn face_turn_turns_and_releases_the_face() {
        for (turned, achieved) in [(FRAC_PI_2 - 0.04, true), (FRAC_PI_2 - 0.06, false)] {
            let goal = Goal::FaceTurn(FRAC_PI_2);
            let held = Some((Hand::Postument, taken(), false));
            let mut stage = Stage::with(settings(), Assignment { held, ..Assignment::new(goal) });

            let turns = async |robot: &mut Robot| turn_face(robot, FRAC_PI_2).await;
            let mut angles = Vec::new();
            let (end, actions) = stage.play(turns, &mut |action, arms| match order(action) {
                Some(Behaviour::Turn { angle, .. }) => {
                    angles.push(*angle);
                    Event::Behaved(vec![Some(Outcome::Turned(turned)), Some(Outcome::Ended)])
                }
                _ => goes_well(action, arms),
            });

            assert_eq!(end.unwrap().achieved, achieved, "{turned}");
            assert_eq!((count(&actions, "turn"), angles), (2, vec![FRAC_PI_2]), "with the phase");
            let words = words(&actions);
            assert_eq!(words[words.len() - 3..], ["release", "open", "line"]);
            let held = stage.robot.belief.held.map(|held| held.is_some());
            assert_eq!(held, [false, true], "the track has let go");
        }
    }
}
