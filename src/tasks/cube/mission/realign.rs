//! Realignment of a layer that a failed turn left misaligned, before any other use of the cube.
//!
//! Jaws measure the angle of a layer. Between pads that lie flat, the layer's angle is the roll of
//! the hand, to the nearest quarter turn. A misaligned layer forces the pads apart, and their
//! distance gives the angle. So the hand turns back by its own roll, less the angle by which the
//! whole cube has turned along in the partner's jaws.
//!
//! - in: rolls, jaw distances and forces of both hands, the turn that failed
//! - out: the hand that lets go of the aligned layer; a failure if the layer stays misaligned
//! - source: own work
//!
//! | situation | threshold | decision |
//! |---|---|---|
//! | before each try | [`WAITS`], [`WEAK_GRIP_WAIT`] | both hands yield, since a strain may pass |
//! | the hands' forces contradict | [`CONTRADICTION`] | both hold still once ([`STAND_SECONDS`]) |
//! | the forces contradict again | from the second try on | the hand regrasps with new zeros |
//! | the layer is in line | [`IN_LINE`] | a partner with a bad grip lets go, else the turner |
//! | the layer is misaligned | | the hand turns back with little torque ([`GENTLE`]) |
//! | still misaligned | [`EARLY_TRIES`] tries | the hand regrasps the layer at its roll |
//! | the turner lost the layer | | the hand regrasps the layer at its last known roll |
//! | still misaligned | [`MOST_TRIES`] tries | the cube goes back with the reason |
//!
//! A regrasp opens the hand, zeroes the forces in free air, and closes at the roll of the layer.

use super::actions::Closing;
use super::failure::{Alarm, Failure, alarm};
use super::regrasp::{self, let_go};
use super::robot::{Robot, Trust};
use super::shared::Doing;
use super::turn_in_progress::TurnInProgress;
use crate::generators::Outcome;
use crate::motion::Depth;
use crate::tasks::cube::hold::{Grip, Hand};
use std::f64::consts::FRAC_PI_4;

/// Angle below which a layer is in line (rad).
const IN_LINE: f64 = 0.03;
/// Time in which the hands yield while the cube is misaligned in one of them: a weak grip that
/// turns back at once slips on (s).
const WEAK_GRIP_WAIT: f64 = 5.0;
/// Angle that the rubber of the pads absorbs before it forces the jaws apart (rad). Layers are
/// realigned as well with half of this value, and with nearly twice as much.
const PAD_GIVE: f64 = 0.015;
/// Torque at which a turn back stalls (Nm): less than rubber pads transmit about any axis.
const GENTLE: f64 = 1.0;
/// Least sum of both hands' forces that the cube between them cannot explain (N).
const CONTRADICTION: f64 = 8.0;
/// Time in which both hands hold still, for a contradiction to pass (s).
const STAND_SECONDS: f64 = 1.5;
/// Increase of the jaw distance from which on jaws at rest do not lie flat (m).
const MISALIGNED: f64 = 0.00025;
/// Number of tries to turn back before the hand regrasps the layer, and of all tries.
const EARLY_TRIES: u32 = 2;
const MOST_TRIES: u32 = 6;
/// Times in which the hands yield before each try (s): first the length of a push, later of a jam.
const WAITS: [f64; MOST_TRIES as usize] = [1.5, 3.0, 1.0, 3.0, 4.0, 4.0];

/// Move of one try.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Move {
    /// End of the tries: the layer is in line, and this hand lets go.
    Done(Hand),
    /// End of the tries: the layer stays misaligned.
    Stay { contradict: bool },
    /// Wait of both hands, stiff, until a contradiction of the sensors passes.
    HoldStill,
    /// Yielding of both hands for this time (s).
    Ease(f64),
    /// Turn of the layer back by this angle (rad).
    TurnBack(f64),
    /// Regrasp of the layer. With `doubt` no force is believed until the new zero.
    Regrasp { doubt: bool },
}

/// State of the tries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Try {
    /// Number of the try, from 1.
    number: u32,
    /// Whether both hands have yielded already in this try.
    eased: bool,
}

/// Brings the layer of the hand `turner` back into line with the cube. Returns the hand that must
/// let go then.
pub(super) async fn bring_into_line(robot: &mut Robot, turner: Hand) -> Result<Hand, Failure> {
    let mut now = Try { number: 1, eased: false };
    loop {
        // The failed turn may have torn the layer out of the turner: a regrasp recovers it.
        if let Err(failure) = robot.check_hold() {
            now = retry(robot, turner, now, failure).await?;
            continue;
        }
        robot.find_layer(turner)?;
        let step = robot.decide(turner, now);
        // Yielding prepares a move and is no try of its own.
        let next = match step {
            Move::Ease(_) => Try { number: now.number, eased: true },
            _ => Try { number: now.number + 1, eased: false },
        };
        let done = match step {
            Move::Done(leaves) => return Ok(leaves),
            Move::Stay { contradict } => return Err(leave_misaligned(robot, contradict)),
            Move::HoldStill => {
                robot.note("the force sensors contradict each other: both hands wait");
                robot.hold_still(STAND_SECONDS).await
            }
            Move::Ease(seconds) => yield_both(robot, turner, seconds).await,
            Move::TurnBack(angle) => turn_back(robot, turner, angle, now.number).await,
            Move::Regrasp { doubt } => regrasp_layer(robot, turner, doubt).await,
        };
        now = match done {
            Ok(()) => next,
            Err(failure) => retry(robot, turner, next, failure).await?,
        };
    }
}

/// Prepares the next try after a failure: the hand lets go of a layer that it lost or failed to
/// grasp. Returns the next try, which is `next` unless the layer was lost. A failure that ends the
/// realignment is returned as it is.
async fn retry(
    robot: &mut Robot,
    turner: Hand,
    next: Try,
    failure: Failure,
) -> Result<Try, Failure> {
    match failure {
        // A lost layer is regrasped at its last known roll. One hand alone strains no layer, so
        // there is no wait before that.
        Failure::Lost(hand)
            if hand == turner && robot.belief.held[turner.other().index()].is_some() =>
        {
            robot.remember_layer(turner);
            robot.belief.released(hand);
            robot.note(format!(
                "the cube has slipped out of the {} hand: the layer is regrasped",
                hand.name()
            ));
            release(robot, hand).await?;
            Ok(Try { number: next.number + 1, eased: true })
        }
        // The partner still holds the cube: the hand opens for the next try.
        Failure::NotGrasped { hand, why, .. } => {
            robot.note(why);
            release(robot, hand).await?;
            Ok(next)
        }
        // The tries go on: the cause of the strain may be gone by the next one.
        Failure::Strained(why) => {
            robot.note(why);
            Ok(next)
        }
        // A cube that the partner lost, and a trouble of the shell, end the realignment.
        other => Err(other),
    }
}

/// Makes the hand let go of the layer. A strain that yielding did not relieve becomes a note, and
/// the next try goes on.
async fn release(robot: &mut Robot, hand: Hand) -> Result<(), Failure> {
    match let_go(robot, hand).await {
        Err(Failure::Strained(why)) => {
            robot.note(why);
            Ok(())
        }
        released => released,
    }
}

/// Lets first the partner of `turner` yield for `seconds`, then `turner`: a strained layer would
/// measure as misaligned.
async fn yield_both(robot: &mut Robot, turner: Hand, seconds: f64) -> Result<(), Failure> {
    let outcomes = robot.wait(turner.other(), seconds).await?;
    fail_if_strained(alarm(&outcomes, Doing::GivingWay))?;
    let outcomes = robot.yield_torque(turner).await?;
    fail_if_strained(alarm(&outcomes, Doing::GivingWay))
}

/// Returns [`Failure::Strained`] if an alarm ended the yielding of a hand.
fn fail_if_strained(met: Option<Alarm>) -> Result<(), Failure> {
    met.map_or(Ok(()), |met| Err(Failure::Strained(met.why)))
}

/// Turns the hand back by `angle` (rad) with little torque, whether the layer follows or not.
/// `number` is that of the try, for the note.
async fn turn_back(
    robot: &mut Robot,
    turner: Hand,
    angle: f64,
    number: u32,
) -> Result<(), Failure> {
    let degrees = -angle.to_degrees();
    robot.note(format!("the {} hand turns back by {degrees:.0} deg, try {number}", turner.name()));
    let torque = robot.settings.turn_torque.min(GENTLE);
    let outcomes = robot.turn(turner, angle, torque).await?;
    if let Some(met) = alarm(&outcomes, Doing::Turning) {
        if let (Outcome::ForcedApart(_), Some(turn)) = (met.outcome, &mut robot.turn_in_progress) {
            // The layer now lags behind the hand in the sense of the turn back.
            turn.sense = angle.signum();
        }
        return Err(Failure::Strained(met.why));
    }
    match outcomes[turner.index()].clone() {
        // None of the three fails the try: the jaws measure afterwards how far the layer followed.
        Some(ended @ (Outcome::Turned(_) | Outcome::Stalled(..) | Outcome::Slipped(..))) => {
            if let Some(turn) = &mut robot.turn_in_progress {
                // A slip says already that the layer stayed behind, should it be lost next.
                turn.layer_left_behind = matches!(ended, Outcome::Slipped(..));
            }
            Ok(())
        }
        other => Err(format!("the turn ended unexpectedly: {}", Outcome::words(other)).into()),
    }
}

/// Opens the turner, zeroes the forces in free air, and closes the turner at the roll of the layer.
/// With `doubt` no arm follows its force sensor until the zeroing.
async fn regrasp_layer(robot: &mut Robot, turner: Hand, doubt: bool) -> Result<(), Failure> {
    if doubt {
        robot.trust = Trust::Doubted;
    }
    robot.note(format!("the {} hand regrasps the layer", turner.name()));
    let turn = robot.turn_in_progress.as_ref().ok_or("no turn is in progress")?;
    let (grip, off) = turn.last_seen;
    regrasp::free(robot, turner).await?;
    robot.zero_forces([true, true]).await?;
    robot.pre_grasp(turner, grip).await?;
    // Jaws that closed at the quarter over a layer of unknown angle dropped the cube, or pressed it
    // with up to 800 N.
    robot.roll(turner, off).await?;
    robot.approach(turner, grip).await?;
    robot.close(turner, grip.hold, Closing::OnLayer).await?;
    robot.check_hold()?;
    robot.belief.turned(turner, grip.hold, grip.half_roll);
    Ok(())
}

/// Leaves a layer misaligned, and returns the failure that follows. The track keeps the cube and
/// hands it back, since no jaws may close over a misaligned layer. If the track does not hold the
/// cube, or holds it badly, no hand lets go, and a person must help. With `contradict` the force
/// sensors contradict each other, and no arm follows them any more.
fn leave_misaligned(robot: &mut Robot, contradict: bool) -> Failure {
    robot.note("the layer could not be realigned");
    if contradict {
        // A compliant hand that lets go must not follow a wrong sensor.
        robot.trust = Trust::Doubted;
    }
    let held = |robot: &Robot, hand: Hand| robot.belief.held[hand.index()].is_some();
    if held(robot, Hand::Track) && robot.forced_apart(Hand::Track) <= MISALIGNED {
        let release = held(robot, Hand::Postument).then_some(Hand::Postument);
        return Failure::GiveUp { release };
    }
    let why = robot.turn_in_progress.take().and_then(TurnInProgress::into_why);
    let why = why.unwrap_or_else(|| "a layer is misaligned".to_owned());
    robot.failure = None;
    Failure::Final(format!("{why}; the layer is still misaligned"))
}

/// Returns the angle (rad) by which a square with this side (m) is turned between two parallel
/// fingers of width `finger` (m), if the square holds them `opening` apart (m).
fn misaligned_between(opening: f64, side: f64, finger: f64) -> f64 {
    // The sides of a square tilted by a touch the fingers at opposite edges of their width:
    //     (side + finger sin a) / cos a = opening
    // so that side = reach cos(a + slant), which is solved for a.
    let (reach, slant) = (opening.hypot(finger), libm::atan2(finger, opening));
    (libm::acos((side / reach).min(1.0)) - slant).clamp(0.0, FRAC_PI_4)
}

impl Robot {
    /// Measures the angle of the layer while the turner holds it, and stores it with the grip that
    /// the turner has at the nearest quarter turn.
    fn find_layer(&mut self, turner: Hand) -> Result<(), Failure> {
        let turn = self.turn_in_progress.as_ref().ok_or("no turn is in progress")?;
        if self.belief.held[turner.index()].is_some() {
            let seen = self.layer(turner, turn);
            self.belief.turned(turner, seen.0.hold, seen.0.half_roll);
            if let Some(turn) = &mut self.turn_in_progress {
                (turn.last_seen, turn.layer_left_behind) = (seen, false);
            }
        }
        Ok(())
    }

    /// Stores the angle that the layer had when the turner lost it.
    fn remember_layer(&mut self, turner: Hand) {
        let seen = self.turn_in_progress.as_ref().map(|turn| self.layer(turner, turn));
        // A layer that stayed behind the hand is where it was measured before.
        if let (Some(turn), Some(seen)) = (&mut self.turn_in_progress, seen)
            && !turn.layer_left_behind
        {
            turn.last_seen = seen;
        }
    }

    /// Chooses the move of the try `now`.
    fn decide(&self, turner: Hand, now: Try) -> Move {
        let Try { number, eased } = now;
        let body = turner.other();
        let holds = self.belief.held[turner.index()].is_some();
        let off = self.turn_in_progress.as_ref().map_or(0.0, |turn| turn.last_seen.1);
        let in_line = holds && off.abs() < IN_LINE;
        let contradict = self.contradiction() > CONTRADICTION;
        let holds_badly = |hand: Hand| self.forced_apart(hand) > MISALIGNED;
        // The last try counts only after easing, which may have shown the layer in line.
        if number > MOST_TRIES && (!holds || contradict || eased && !in_line) {
            return Move::Stay { contradict };
        }
        if !eased && contradict {
            // No hand yields to a force that only one of them measures: an obstacle pushes, which
            // may pass, or a sensor is wrong, which only a new zero in free air corrects.
            return if number == 1 { Move::HoldStill } else { Move::Regrasp { doubt: true } };
        }
        if !eased {
            let slips = [turner, body]
                .into_iter()
                .any(|hand| self.belief.held[hand.index()].is_some() && holds_badly(hand));
            let wait = WAITS[(number as usize - 1).min(WAITS.len() - 1)];
            return Move::Ease(if slips { WEAK_GRIP_WAIT } else { wait });
        }
        if in_line {
            return Move::Done(if holds_badly(body) { body } else { turner });
        }
        // A hand that holds badly must not hold the cube alone, so the turner keeps it. Otherwise
        // one try is a regrasp, and the tries after it turn back again.
        if holds && (holds_badly(body) || number != EARLY_TRIES + 1) {
            return Move::TurnBack(-off);
        }
        Move::Regrasp { doubt: false }
    }

    /// Returns the turner's grip at the quarter turn nearest to the layer, and the layer's angle
    /// from there (rad).
    fn layer(&self, turner: Hand, turn: &TurnInProgress) -> (Grip, f64) {
        let roll = self.arms[turner.index()].desired_joints.0[6];
        let along = self.turned_along(turner, self.forced_apart(turner.other()));
        // A layer that is misaligned between the turner's jaws lags behind the hand.
        let lag = self.misaligned_about_palm(turner, self.forced_apart(turner));
        turn.nearest(roll, along + lag)
    }

    /// Returns the angle (rad) by which the cube is turned about the palm's axis of a hand, from
    /// the distance `apart` by which it has forced the jaws apart (m).
    fn misaligned_about_palm(&self, hand: Hand, apart: f64) -> f64 {
        if apart <= MISALIGNED {
            return 0.0;
        }
        let width = self.widths[hand.index()].unwrap_or(self.settings.edge);
        misaligned_between(width + apart, width, self.settings.finger_width) + PAD_GIVE
    }

    /// Returns by how much the jaws of a hand are wider than when they closed on the cube (m).
    fn forced_apart(&self, hand: Hand) -> f64 {
        let width = self.widths[hand.index()].unwrap_or(self.settings.edge);
        self.arms[hand.index()].jaw_opening - width
    }

    /// Returns the norm of the sum of both hands' forces on the cube between them (N). It is the
    /// cube's weight if both sensors are right and no other object touches the cube.
    fn contradiction(&self) -> f64 {
        let felt = |hand: Hand| {
            let arm = &self.arms[hand.index()];
            let world_from_tool =
                self.belief.world_from_base(hand).rotation * arm.base_from_tool.rotation;
            world_from_tool * arm.wrench_in_tool.force
        };
        let [track, postument] = Hand::BOTH.map(felt);
        let both = self.belief.held.iter().all(Option::is_some);
        if both { (track + postument).norm() } else { 0.0 }
    }

    /// Returns the angle (rad) by which the cube has turned in the jaws of the turner's partner,
    /// from the distance `apart` by which it has forced them apart (m).
    fn turned_along(&self, turner: Hand, apart: f64) -> f64 {
        let body = turner.other();
        let Some(held) = self.belief.held[body.index()].filter(|_| apart > MISALIGNED) else {
            return 0.0;
        };
        match self.belief.turn_axis(turner) {
            // About the axis along the fingers' width the pads touch the cube over the depth of the
            // fingers, so the depth is the lever.
            Some(0) => {
                let depth = self.settings.finger_depth[usize::from(held.hold.depth == Depth::Two)];
                libm::asin((apart / depth).min(1.0)) + PAD_GIVE
            }
            // About the palm's axis the fingers' width is the lever.
            Some(2) => self.misaligned_about_palm(body, apart),
            // About the jaws' axis the cube slides between parallel pads and forces none apart.
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::assignment::Goal;
    use super::super::robot::MOST_RECOVERIES;
    use super::super::testing::{Stage, goes_well, order, settings, words};
    use super::super::{recover, turn};
    use super::*;
    use crate::cube::{Axis, Face, Turn};
    use crate::generators::Behaviour;
    use crate::kernel::{Action, Event};
    use crate::motion::{ArmState, JointPositions};
    use crate::spatial::Wrench;
    use crate::tasks::cube::hold::Hold;
    use crate::tasks::cube::think::Thought;
    use nalgebra::{UnitQuaternion, Vector3};
    use std::f64::consts::{FRAC_PI_2, PI};

    /// Distance between jaws that hold the cube flat (m).
    const WIDTH: f64 = 0.0567;
    /// Anticlockwise quarter turn that fails in these tests.
    const TURN: Turn = Turn { face: Face::U, quarters: 3 };

    /// Makes a stage on which both hands hold the cube, and the track hand's anticlockwise quarter
    /// turn has slipped after `rolled` (rad).
    fn failed(rolled: f64) -> Stage {
        let mut stage = Stage::new(settings());
        let robot = &mut stage.robot;
        let hold = |palm: Face| Hold { palm, jaws: Axis::X, depth: Depth::One };
        robot.belief.taken(Hand::Track, hold(Face::U), false);
        // The turn's axis is along the fingers' width of the partner.
        robot.belief.taken(Hand::Postument, hold(Face::F), false);
        robot.widths = [Some(WIDTH); 2];
        robot.apart = false;
        robot.meeting = settings().meetings.grasps[0];
        let joints = JointPositions([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.4]);
        robot.arms =
            [ArmState { jaw_opening: WIDTH, desired_joints: joints, ..ArmState::default() }; 2];
        let turns = async |robot: &mut Robot| turn::turn_layer(robot, Hand::Track, TURN).await;
        let (end, _) = stage.play(turns, &mut |_, arms| {
            arms[0].desired_joints.0[6] += rolled;
            Event::Behaved(vec![Some(Outcome::Slipped(rolled, 0.01)), Some(Outcome::Ended)])
        });
        assert_eq!(end, Err(Failure::TurnFailed { turner: Hand::Track }));
        stage
    }

    /// Returns the move that try `number` chooses from the present angle of the layer. `eased`
    /// means that both hands have yielded in this try.
    fn decides(stage: &mut Stage, number: u32, eased: bool) -> Move {
        stage.robot.find_layer(Hand::Track).unwrap();
        stage.robot.decide(Hand::Track, Try { number, eased })
    }

    /// Returns the distance (m) between pads, 12 mm wide, on a layer that is misaligned by `angle`
    /// (rad).
    fn jaws_forced_apart(angle: f64) -> f64 {
        (WIDTH + 0.012 * libm::sin(angle)) / libm::cos(angle)
    }

    /// Returns the angle of a turn back (rad). Panics at any other move.
    fn back(step: Move) -> f64 {
        if let Move::TurnBack(angle) = step { angle } else { panic!("{step:?}") }
    }

    #[test]
    fn hand_turns_layer_back_to_nearest_quarter_turn() {
        for (rolled, expected) in [(-0.5, 0.5), (-1.2, -(FRAC_PI_2 - 1.2)), (0.1, -0.1)] {
            let step = decides(&mut failed(rolled), 1, true);
            assert!((back(step) - expected).abs() < 1e-9, "{rolled} {step:?}");
        }
        assert_eq!(decides(&mut failed(0.0), 1, true), Move::Done(Hand::Track));
    }

    /// The whole cube has turned by 0.1 rad in the partner's jaws. The hand turns back by that much
    /// less, and if the layer is in line with the cube, the partner lets go.
    #[test]
    fn turn_back_subtracts_rotation_of_cube_in_jaws() {
        let tilted = 0.1;
        let stands = |rolled: f64| {
            let mut stage = failed(rolled);
            assert_eq!(stage.robot.belief.turn_axis(Hand::Track), Some(0));
            // The fingers reach 17 mm deep over one layer.
            stage.robot.arms[1].jaw_opening = WIDTH + 0.017 * libm::sin(tilted - PAD_GIVE);
            decides(&mut stage, 1, true)
        };

        let step = stands(-0.5);
        assert!((back(step) - (0.5 - tilted)).abs() < 1e-6, "{step:?}");
        // The partner has the worse grip and lets go.
        assert_eq!(stands(-tilted), Move::Done(Hand::Postument));
    }

    #[test]
    fn layer_still_misaligned_after_tries_is_regrasped() {
        let mut stage = failed(-0.5);
        // The third of the six tries is a regrasp, and the tries around it turn the layer back.
        for number in 1..=6 {
            let step = decides(&mut stage, number, true);
            match number {
                3 => assert_eq!(step, Move::Regrasp { doubt: false }),
                _ => assert!((back(step) - 0.5).abs() < 1e-9, "{number}: {step:?}"),
            }
        }
        assert!((stage.robot.turn_in_progress.as_ref().unwrap().last_seen.1 + 0.5).abs() < 1e-9);

        // The layer lags behind a hand whose jaws it has forced apart.
        let mut stage = failed(-0.5);
        stage.robot.arms[0].jaw_opening = jaws_forced_apart(0.2);
        decides(&mut stage, EARLY_TRIES + 1, true);
        let off = stage.robot.turn_in_progress.as_ref().unwrap().last_seen.1;
        assert!((off - (-0.5 + 0.2 + PAD_GIVE)).abs() < 1e-9, "{off}");
    }

    /// Fingers with little room would hit the corners of the layer.
    #[test]
    fn jaws_open_wide_beside_misaligned_layer() {
        let mut stage = failed(-0.5);
        stage.robot.settings.regrasp_opening = WIDTH + 0.01;
        let wide = stage.robot.settings.opening;
        decides(&mut stage, 1, true);

        let takes = async |robot: &mut Robot| regrasp_layer(robot, Hand::Track, false).await;
        let (_, actions) = stage.play(takes, &mut goes_well);

        let Some(Behaviour::Jaw { jaw, .. }) = order(&actions[0]) else { panic!("{actions:?}") };
        assert_eq!(jaw.opening, wide);
    }

    #[test]
    fn regrasp_rolls_jaws_to_angle_of_misaligned_layer() {
        let mut stage = failed(-0.5);
        decides(&mut stage, 1, true);

        let takes = async |robot: &mut Robot| regrasp_layer(robot, Hand::Track, false).await;
        let (end, actions) = stage.play(takes, &mut goes_well);

        assert_eq!(end, Ok(()));
        let lets_go = ["open", "line"];
        let closes = ["zero", "line", "line", "approach", "close"];
        assert_eq!(words(&actions), [&lets_go[..], &closes].concat());
        let target = |action: &Action<Thought>| match order(action) {
            Some(Behaviour::Line { target, .. }) => *target,
            _ => panic!("{action:?}"),
        };
        // The layer lags behind the quarter turn, so that the jaws roll back.
        let roll = target(&actions[4]).rotation.scaled_axis();
        assert!((roll.z + 0.5).abs() < 1e-9 && roll.xy().norm() < 1e-9, "{roll}");
        assert!(stage.robot.belief.held[0].is_some());
    }

    #[test]
    fn track_hand_returns_cube_with_misaligned_layer() {
        let mut stage = failed(-0.5);
        let last = decides(&mut stage, MOST_TRIES + 1, true);
        assert_eq!(last, Move::Stay { contradict: false });
        let leaves = leave_misaligned(&mut stage.robot, false);
        assert_eq!(leaves, Failure::GiveUp { release: Some(Hand::Postument) });

        // A hand that holds badly must not hold the cube alone, and no jaws may close over a
        // misaligned layer.
        let mut stage = failed(-0.5);
        stage.robot.arms[0].jaw_opening = jaws_forced_apart(0.2);
        let Failure::Final(why) = leave_misaligned(&mut stage.robot, false) else { panic!() };
        assert!(why.ends_with("the layer is still misaligned"), "{why}");
    }

    #[test]
    fn both_hands_yield_before_realignment_fails() {
        let mut stage = failed(-0.5);
        assert!(matches!(decides(&mut stage, MOST_TRIES + 1, false), Move::Ease(_)));
    }

    /// Plays the realignment of the track hand's layer. Each turn moves the layer along and ends
    /// with the last entry of `turns`, an outcome and the jaw distance then, which is removed. When
    /// none is left, turns succeed.
    fn realigns(
        stage: &mut Stage,
        mut turns: Vec<(Outcome, Option<f64>)>,
    ) -> (Result<Hand, Failure>, Vec<Action<Thought>>) {
        let realigns = async |robot: &mut Robot| bring_into_line(robot, Hand::Track).await;
        stage.play(realigns, &mut |action, arms| match order(action) {
            Some(Behaviour::Turn { angle, .. }) => {
                arms[0].desired_joints.0[6] += angle;
                let (outcome, gap) = turns.pop().unwrap_or((Outcome::Turned(*angle), None));
                arms[0].jaw_opening = gap.unwrap_or(arms[0].jaw_opening);
                Event::Behaved(vec![Some(outcome), Some(Outcome::Ended)])
            }
            Some(Behaviour::Jaw { .. }) => {
                arms[0].jaw_opening = 0.09;
                goes_well(action, arms)
            }
            Some(Behaviour::Grasp { .. }) => {
                arms[0].jaw_opening = WIDTH;
                Event::Behaved(vec![Some(Outcome::Grasped(WIDTH)), None])
            }
            Some(Behaviour::Present { .. }) => {
                Event::Behaved(vec![Some(Outcome::TimedOut(1.0)); 2])
            }
            _ => goes_well(action, arms),
        })
    }

    #[test]
    fn misaligned_layer_is_turned_back_and_released() {
        let (end, actions) = realigns(&mut failed(-0.5), vec![]);

        assert_eq!(end, Ok(Hand::Track));
        let eases = ["yield", "yield"];
        assert_eq!(words(&actions), [&eases[..], &["turn"], &eases].concat());
    }

    #[test]
    fn lost_layer_is_regrasped_at_last_known_angle() {
        // A hand that turned back with the layer left it in line. A hand that slipped did not move
        // it.
        for (outcome, seen) in [(Outcome::Turned(0.5), 0.0), (Outcome::Slipped(0.5, 0.01), -0.5)] {
            let mut stage = failed(-0.5);
            let (end, actions) = realigns(&mut stage, vec![(outcome.clone(), Some(WIDTH - 0.01))]);

            assert_eq!(end, Ok(Hand::Track), "{outcome:?}");
            let words = words(&actions);
            let lost = ["turn", "open", "line", "zero", "line", "line", "approach", "close"];
            assert_eq!(words[2..10], lost, "{words:?}");
            let roll = actions.iter().filter_map(|action| match order(action) {
                Some(Behaviour::Line { target, .. }) => Some(target.rotation.scaled_axis().z),
                _ => None,
            });
            let rolls: Vec<f64> = roll.collect();
            assert!((rolls[2] - seen).abs() < 1e-9, "{rolls:?} {seen}");
        }
    }

    #[test]
    fn alarm_while_turning_back_starts_another_try() {
        let mut stage = failed(-0.5);

        let (end, actions) = realigns(&mut stage, vec![(Outcome::OverForce(0, 30.0), None)]);

        assert_eq!(end, Ok(Hand::Track));
        assert!(stage.notes().iter().any(|note| note.contains("over-force")));
        assert_eq!(words(&actions).iter().filter(|word| **word == "yield").count(), 4);
    }

    #[test]
    fn jaws_forced_apart_lengthen_the_next_turn_back() {
        let mut stage = failed(-0.5);
        decides(&mut stage, 1, true);
        let turns = async |robot: &mut Robot| turn_back(robot, Hand::Track, 0.5, 1).await;

        let (end, _) = stage.play(turns, &mut |_, arms| {
            arms[0].desired_joints.0[6] += 0.3;
            arms[0].jaw_opening = jaws_forced_apart(0.2);
            Event::Behaved(vec![Some(Outcome::ForcedApart(0.001)), None])
        });

        assert!(matches!(end, Err(Failure::Strained(_))), "{end:?}");
        let step = decides(&mut stage, 2, true);
        assert!((back(step) - (0.2 + 0.2 + PAD_GIVE)).abs() < 1e-6, "{step:?}");
    }

    #[test]
    fn stored_layer_angle_ignores_hand_after_release() {
        let mut stage = failed(-0.5);
        decides(&mut stage, 1, false);
        stage.robot.belief.released(Hand::Track);
        stage.robot.arms[0].desired_joints.0[6] = 2.0;

        assert_eq!(decides(&mut stage, 4, true), Move::Regrasp { doubt: false });
        let off = stage.robot.turn_in_progress.as_ref().unwrap().last_seen.1;
        assert!((off + 0.5).abs() < 1e-9, "{off}");
    }

    #[test]
    fn hands_do_not_yield_if_their_forces_disagree() {
        let begins = |track: f64, postument: f64, number: u32| {
            let mut stage = failed(0.0);
            for (arm, force) in stage.robot.arms.iter_mut().zip([track, postument]) {
                let along = [force, 0.0, 0.0, 0.0, 0.0, 0.0];
                arm.wrench_in_tool = Wrench::from_directions(along);
            }
            // The x axes of the tools point towards each other.
            let opposed = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI);
            stage.robot.arms[1].base_from_tool.rotation = opposed;
            decides(&mut stage, number, false)
        };

        assert!(matches!(begins(30.0, 30.0, 1), Move::Ease(_)));
        assert!(matches!(begins(30.0, 22.1, 1), Move::Ease(_)), "the cube has a weight");
        assert_eq!(begins(30.0, 21.9, 1), Move::HoldStill);
        assert_eq!(begins(0.0, 8.1, 2), Move::Regrasp { doubt: true });
        assert_eq!(begins(0.0, 8.1, MOST_TRIES + 1), Move::Stay { contradict: true });
        let mut stage = failed(0.0);
        leave_misaligned(&mut stage.robot, true);
        assert_eq!(stage.robot.trust, Trust::Doubted);
    }

    #[test]
    fn face_turn_task_realigns_no_layer() {
        let mut stage = failed(0.0);
        stage.robot.goal = Goal::FaceTurn(1.0);
        stage.robot.arms = [ArmState { jaw_opening: WIDTH, ..ArmState::default() }; 2];
        let turns = async |robot: &mut Robot| turn::turn_through(robot, Hand::Track, 1.0).await;

        let (end, _) = stage.play(turns, &mut |_, _| {
            Event::Behaved(vec![Some(Outcome::Slipped(0.1, 0.01)), Some(Outcome::Ended)])
        });

        assert!(matches!(end, Err(Failure::Final(_))), "{end:?}");
    }

    #[test]
    fn realigned_cube_is_reread_while_recoveries_remain() {
        for (recoveries, reread) in [(MOST_RECOVERIES - 1, true), (MOST_RECOVERIES, false)] {
            let mut stage = failed(0.0);
            stage.robot.recoveries = recoveries;
            let failure = Failure::TurnFailed { turner: Hand::Track };
            let recovers = async |robot: &mut Robot| recover::recover(robot, failure).await;

            let (end, _) = stage.play(recovers, &mut |action, arms| match order(action) {
                Some(Behaviour::Present { .. }) => Event::Behaved(vec![None, None]),
                _ => goes_well(action, arms),
            });

            let release = Some(Hand::Track);
            let expected =
                if reread { Failure::ReadAgain { release } } else { Failure::GiveUp { release } };
            assert_eq!(end, Err(expected));
        }
    }

    #[test]
    fn layer_lost_in_failed_turn_is_regrasped() {
        let mut stage = failed(-0.5);
        stage.robot.arms[0].jaw_opening = WIDTH - 0.01;
        let failure = Failure::TurnFailed { turner: Hand::Track };
        let recovers = async |robot: &mut Robot| recover::recover(robot, failure).await;

        let (_, actions) = stage.play(recovers, &mut |action, arms| match order(action) {
            Some(Behaviour::Present { .. }) => Event::Behaved(vec![None, None]),
            Some(Behaviour::Grasp { .. }) => {
                arms[0].jaw_opening = WIDTH;
                Event::Behaved(vec![Some(Outcome::Grasped(WIDTH)), None])
            }
            _ => goes_well(action, arms),
        });

        let regrasp = ["open", "line", "zero", "line", "line", "approach", "close"];
        assert_eq!(words(&actions)[..7], regrasp);
        assert!(stage.notes().iter().any(|note| note.ends_with("the layer is regrasped")));
    }

    #[test]
    fn misalignment_angle_follows_from_jaw_opening() {
        // Edge of the square between the jaws, and width of the pads (m).
        let (edge, pad) = (0.057, 0.012);
        for angle in [0.0, 0.1, 0.5] {
            let opening = (edge + pad * libm::sin(angle)) / libm::cos(angle);
            let found = misaligned_between(opening, edge, pad);
            assert!((found - angle).abs() < 1e-6, "{angle}");
        }
        assert!(misaligned_between(0.05, edge, pad).abs() < 1e-9, "jaws narrower than the square");
    }
}
