//! A layer that a failed turn left misaligned is brought back into line, before anything else is
//! done with the cube.
//!
//! Flat jaws know how a layer stands: between pads that lie flat it is where the roll of the hand
//! is, to the nearest quarter; what stands misaligned between them forces them apart, by an angle
//! that their distance tells. So the hand turns back by its own roll, less what the whole cube has
//! turned along in the partner's jaws.
//!
//! - in: rolls, jaw distances and forces of both hands, the turn that failed
//! - out: the hand that is to let go of an aligned layer; a failure where the layer stays misaligned
//! - source: own work
//!
//! | situation | decision |
//! |---|---|
//! | before each try | both hands give way, since what strains a layer may pass |
//! | the forces of both hands contradict each other ([`CONTRADICTION`]) | both hands stand once ([`STAND`]); then the sensors are doubted and the layer is taken anew |
//! | in line within [`IN_LINE`] | the partner lets go if it holds badly, else the turner |
//! | misaligned | the hand turns back, gently ([`GENTLE`]) |
//! | still misaligned after [`BEFORE_ANEW`] tries, or lost | the hand lets go, zeroes its force in free air, and closes at the roll at which the layer stands |
//! | still misaligned after [`MOST_TRIES`] tries | the layer stays as it is, and the cube goes back with the reason |

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

/// A layer that stands off by less is in line (rad).
const IN_LINE: f64 = 0.03;
/// How long the hands give way while the cube stands misaligned in one: a weak grip that turns back
/// slips on (s).
const WEAK: f64 = 5.0;
/// What turns between pads by less does not force them apart: their rubber gives (rad). Half and
/// nearly twice as much were tried; slips are undone with them as well.
const PAD_GIVE: f64 = 0.015;
/// The torque at which a turn back stands still: less than pads of rubber carry about any axis (Nm).
const GENTLE: f64 = 1.0;
/// A force from which on what only one of two hands feels is not the cube's (N).
const CONTRADICTION: f64 = 8.0;
/// How long both hands stand and wait for a contradiction to pass (s).
const STAND: f64 = 1.5;
/// Jaws at rest that are farther apart than they were do not lie flat (m).
const MISALIGNED: f64 = 0.00025;
/// Tries to turn back before the hand lets go and takes the layer anew, and in all.
const BEFORE_ANEW: u32 = 2;
const MOST_TRIES: u32 = 6;
/// How long the hands give way before a try (s): at first as a push lasts, then as a jam may.
const WAITS: [f64; MOST_TRIES as usize] = [1.5, 3.0, 1.0, 3.0, 4.0, 4.0];

/// What is done in one try.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Move {
    /// The layer is in line: this hand lets go.
    Done(Hand),
    /// The layer stays as it is.
    Stay { contradict: bool },
    /// Both hands stand until a contradiction of the sensors passes.
    Stand,
    /// Both hands give way (s).
    Ease(f64),
    /// The hand turns the layer back (rad).
    TurnBack(f64),
    /// The hand takes the layer anew.
    TakeAnew { doubt: bool },
}

/// Where the tries stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Try {
    /// Number of the try, from 1.
    number: u32,
    /// Both hands have given way already.
    eased: bool,
}

/// Brings the turner's layer back into line. Returns the hand that is to let go then.
pub(super) async fn bring_into_line(robot: &mut Robot, turner: Hand) -> Result<Hand, Failure> {
    let mut now = Try { number: 1, eased: false };
    loop {
        if let Err(failure) = robot.check_hold() {
            now = retry(robot, turner, now, failure).await?;
            continue;
        }
        robot.find_layer(turner)?;
        let step = robot.decide(turner, now);
        let next = match step {
            Move::Ease(_) => Try { number: now.number, eased: true },
            _ => Try { number: now.number + 1, eased: false },
        };
        let done = match step {
            Move::Done(leaves) => return Ok(leaves),
            Move::Stay { contradict } => return Err(leave_misaligned(robot, contradict)),
            Move::Stand => {
                robot.note("the force sensors contradict each other: both hands stand");
                robot.stand(STAND).await
            }
            Move::Ease(seconds) => ease(robot, turner, seconds).await,
            Move::TurnBack(angle) => turn_back(robot, turner, angle, now.number).await,
            Move::TakeAnew { doubt } => take_anew(robot, turner, doubt).await,
        };
        now = match done {
            Ok(()) => next,
            Err(failure) => retry(robot, turner, next, failure).await?,
        };
    }
}

/// Mends a failure of one try, and returns the try that follows.
async fn retry(
    robot: &mut Robot,
    turner: Hand,
    next: Try,
    failure: Failure,
) -> Result<Try, Failure> {
    match failure {
        // The layer is taken anew where it stood last.
        Failure::Lost(hand)
            if hand == turner && robot.belief.held[turner.other().index()].is_some() =>
        {
            robot.remember_layer(turner);
            robot.belief.released(hand);
            robot.note(format!(
                "the cube has slipped out of the {} hand: the layer is taken anew",
                hand.name()
            ));
            release(robot, hand).await?;
            Ok(Try { number: next.number + 1, eased: true })
        }
        Failure::NotGrasped { hand, why } => {
            robot.note(why);
            release(robot, hand).await?;
            Ok(next)
        }
        Failure::Strained(why) => {
            robot.note(why);
            Ok(next)
        }
        other => Err(other),
    }
}

/// Lets go; a strain that does not pass is left to the next try.
async fn release(robot: &mut Robot, hand: Hand) -> Result<(), Failure> {
    match let_go(robot, hand).await {
        Err(Failure::Strained(why)) => {
            robot.note(why);
            Ok(())
        }
        released => released,
    }
}

/// Lets both hands give way: what is strained would seem to stand misaligned.
async fn ease(robot: &mut Robot, turner: Hand, seconds: f64) -> Result<(), Failure> {
    let outcomes = robot.wait(turner.other(), seconds).await?;
    unstrained(alarm(&outcomes, Doing::GivingWay))?;
    let outcomes = robot.ease(turner).await?;
    unstrained(alarm(&outcomes, Doing::GivingWay))
}

fn unstrained(met: Option<Alarm>) -> Result<(), Failure> {
    met.map_or(Ok(()), |met| Err(Failure::Strained(met.why)))
}

/// Turns the hand back (rad), gently, with the layer or without.
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
            // What it turned lags behind it the other way now.
            turn.sense = angle.signum();
        }
        return Err(Failure::Strained(met.why));
    }
    match outcomes[turner.index()] {
        Some(ended @ (Outcome::Turned(_) | Outcome::Stalled(..) | Outcome::Slipped(..))) => {
            if let Some(turn) = &mut robot.turn_in_progress {
                turn.alone = matches!(ended, Outcome::Slipped(..));
            }
            Ok(())
        }
        other => Err(format!("the turn ended otherwise: {}", Outcome::words(other)).into()),
    }
}

/// Has the turner let go, zero its force in free air, and close at the roll at which the layer
/// stands.
async fn take_anew(robot: &mut Robot, turner: Hand, doubt: bool) -> Result<(), Failure> {
    if doubt {
        robot.trust = Trust::Doubted;
    }
    robot.note(format!("the {} hand takes the layer anew", turner.name()));
    let turn = robot.turn_in_progress.as_ref().ok_or("no turn is in progress")?;
    let (grip, off) = turn.stood;
    regrasp::free(robot, turner).await?;
    robot.zero_forces([true, true]).await?;
    robot.pre_grasp(turner, grip).await?;
    robot.roll(turner, off).await?;
    robot.approach(turner, grip).await?;
    robot.close(turner, grip.hold, Closing::OnLayer).await?;
    robot.check_hold()?;
    robot.belief.turned(turner, grip.hold, grip.half_roll);
    Ok(())
}

/// Leaves a layer misaligned. The track, which hands back, keeps the cube as it holds it, since no
/// jaws may close over such a layer. Where it has none of it, or holds badly, no hand lets go, and
/// somebody must help.
fn leave_misaligned(robot: &mut Robot, contradict: bool) -> Failure {
    robot.note("the layer could not be brought back into line");
    if contradict {
        // A hand that gives way while it lets go must not follow a sensor that lies.
        robot.trust = Trust::Doubted;
    }
    let held = |robot: &Robot, hand: Hand| robot.belief.held[hand.index()].is_some();
    if held(robot, Hand::Track) && robot.forced_apart(Hand::Track) <= MISALIGNED {
        let release = held(robot, Hand::Postument).then_some(Hand::Postument);
        return Failure::GiveUp { release };
    }
    let why = robot.turn_in_progress.take().and_then(TurnInProgress::into_why);
    let why = why.unwrap_or_else(|| "a layer stands askew".to_owned());
    robot.failure = None;
    Failure::Final(format!("{why}; the layer is still askew"))
}

/// Returns by how much a square of a side (m) stands misaligned between fingers of a width that it
/// holds `opening` apart (m, rad).
fn misaligned_between(opening: f64, side: f64, finger: f64) -> f64 {
    // (side + finger sin a) / cos a = opening
    let (reach, slant) = (opening.hypot(finger), libm::atan2(finger, opening));
    (libm::acos((side / reach).min(1.0)) - slant).clamp(0.0, FRAC_PI_4)
}

impl Robot {
    /// Finds out where the layer stands while the turner has it, and believes that grip.
    fn find_layer(&mut self, turner: Hand) -> Result<(), Failure> {
        let turn = self.turn_in_progress.as_ref().ok_or("no turn is in progress")?;
        if self.belief.held[turner.index()].is_some() {
            let stood = self.layer(turner, turn);
            self.belief.turned(turner, stood.0.hold, stood.0.half_roll);
            if let Some(turn) = &mut self.turn_in_progress {
                (turn.stood, turn.alone) = (stood, false);
            }
        }
        Ok(())
    }

    /// Keeps where the layer stood when the turner lost it, unless it stayed behind before.
    fn remember_layer(&mut self, turner: Hand) {
        let stood = self.turn_in_progress.as_ref().map(|turn| self.layer(turner, turn));
        if let (Some(turn), Some(stood)) = (&mut self.turn_in_progress, stood)
            && !turn.alone
        {
            turn.stood = stood;
        }
    }

    /// Decides what a try does.
    fn decide(&self, turner: Hand, now: Try) -> Move {
        let Try { number, eased } = now;
        let body = turner.other();
        let holds = self.belief.held[turner.index()].is_some();
        let off = self.turn_in_progress.as_ref().map_or(0.0, |turn| turn.stood.1);
        let in_line = holds && off.abs() < IN_LINE;
        let contradict = self.contradiction() > CONTRADICTION;
        let holds_badly = |hand: Hand| self.forced_apart(hand) > MISALIGNED;
        if number > MOST_TRIES && (!holds || contradict || eased && !in_line) {
            return Move::Stay { contradict };
        }
        if !eased && contradict {
            // Neither hand gives way to a force that only one of them feels: something pushes, or a
            // sensor lies.
            return if number == 1 { Move::Stand } else { Move::TakeAnew { doubt: true } };
        }
        if !eased {
            let slips = [turner, body]
                .into_iter()
                .any(|hand| self.belief.held[hand.index()].is_some() && holds_badly(hand));
            let wait = WAITS[(number as usize - 1).min(WAITS.len() - 1)];
            return Move::Ease(if slips { WEAK } else { wait });
        }
        if in_line {
            return Move::Done(if holds_badly(body) { body } else { turner });
        }
        // A hand that holds badly is not left alone with the cube.
        if holds && (holds_badly(body) || number != BEFORE_ANEW + 1) {
            return Move::TurnBack(-off);
        }
        Move::TakeAnew { doubt: false }
    }

    /// Returns the turner's grip at the quarter nearest to which the layer stands, and how far off
    /// it (rad).
    fn layer(&self, turner: Hand, turn: &TurnInProgress) -> (Grip, f64) {
        let roll = self.arms[turner.index()].desired_joints.0[6];
        let along = self.turned_along(turner, self.forced_apart(turner.other()));
        // Where the layer stands misaligned between the turner's jaws, it lags behind the hand.
        let lag = self.misaligned_about_palm(turner, self.forced_apart(turner));
        turn.nearest(roll, along + lag)
    }

    /// Returns how far what a hand holds stands misaligned about the palm's axis, when it has forced
    /// the jaws apart by this much (m, rad).
    fn misaligned_about_palm(&self, hand: Hand, apart: f64) -> f64 {
        if apart <= MISALIGNED {
            return 0.0;
        }
        let width = self.widths[hand.index()].unwrap_or(self.settings.edge);
        misaligned_between(width + apart, width, self.settings.finger_width) + PAD_GIVE
    }

    /// Returns by how much jaws are farther apart than when they closed (m).
    fn forced_apart(&self, hand: Hand) -> f64 {
        let width = self.widths[hand.index()].unwrap_or(self.settings.edge);
        self.arms[hand.index()].jaw_opening - width
    }

    /// Returns what both hands feel of the cube between them, together (N): nothing but its weight,
    /// where both sensors are right and nobody else is there.
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

    /// Returns how far the cube has turned in the jaws of the body's hand, which it has forced apart
    /// by this much (m, rad).
    fn turned_along(&self, turner: Hand, apart: f64) -> f64 {
        let body = turner.other();
        let Some(held) = self.belief.held[body.index()].filter(|_| apart > MISALIGNED) else {
            return 0.0;
        };
        match self.belief.turn_axis(turner) {
            // Along the fingers' width: the pads lie on it as deep as the fingers reach.
            Some(0) => {
                let depth = self.settings.finger_depth[usize::from(held.hold.depth == Depth::Two)];
                libm::asin((apart / depth).min(1.0)) + PAD_GIVE
            }
            Some(2) => self.misaligned_about_palm(body, apart),
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::assignment::Goal;
    use super::super::robot::MOST_RECOVERIES;
    use super::super::testing::{Stage, goes_well, order, settings, words};
    use super::super::{mend, turn};
    use super::*;
    use crate::cube::{Axis, Face, Turn};
    use crate::generators::Behaviour;
    use crate::motion::{ArmState, JointPositions};
    use crate::spatial::Wrench;
    use crate::tasks::cube::hold::Hold;
    use crate::tasks::cube::think::Thought;
    use crate::tasks::{Action, Event};
    use std::f64::consts::FRAC_PI_2;

    const WIDTH: f64 = 0.0567;
    const TURN: Turn = Turn { face: Face::U, quarters: 3 };

    /// Both hands hold the cube, and the track hand's quarter turn against the clock has slipped
    /// after `rolled` (rad).
    fn failed(rolled: f64) -> Stage {
        let mut stage = Stage::new(settings());
        let robot = &mut stage.robot;
        let hold = |palm: Face| Hold { palm, jaws: Axis::X, depth: Depth::One };
        robot.belief.taken(Hand::Track, hold(Face::U), false);
        // The turn's axis is along the fingers' width of the hand that holds the body.
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
            Event::Behaved([Some(Outcome::Slipped(rolled, 0.01)), Some(Outcome::Ended)])
        });
        assert_eq!(end, Err(Failure::TurnFailed { turner: Hand::Track }));
        stage
    }

    /// Returns what a try decides, from the layer as it stands.
    fn decides(stage: &mut Stage, number: u32, eased: bool) -> Move {
        stage.robot.find_layer(Hand::Track).unwrap();
        stage.robot.decide(Hand::Track, Try { number, eased })
    }

    fn jaws_forced_apart(angle: f64) -> f64 {
        (WIDTH + 0.012 * libm::sin(angle)) / libm::cos(angle)
    }

    fn back(step: Move) -> f64 {
        if let Move::TurnBack(angle) = step { angle } else { panic!("{step:?}") }
    }

    #[test]
    fn hand_turns_back_to_the_nearest_quarter() {
        for (rolled, expected) in [(-0.5, 0.5), (-1.2, -(FRAC_PI_2 - 1.2)), (0.1, -0.1)] {
            let step = decides(&mut failed(rolled), 1, true);
            assert!((back(step) - expected).abs() < 1e-9, "{rolled} {step:?}");
        }
        assert_eq!(decides(&mut failed(0.0), 1, true), Move::Done(Hand::Track));
    }

    #[test]
    fn cube_turned_along_is_not_turned_back() {
        let tilted = 0.1;
        let stands = |rolled: f64| {
            let mut stage = failed(rolled);
            assert_eq!(stage.robot.belief.turn_axis(Hand::Track), Some(0));
            stage.robot.arms[1].jaw_opening = WIDTH + 0.017 * libm::sin(tilted - PAD_GIVE);
            decides(&mut stage, 1, true)
        };

        let step = stands(-0.5);
        assert!((back(step) - (0.5 - tilted)).abs() < 1e-6, "{step:?}");
        // The partner, whose grip is worse, lets go.
        assert_eq!(stands(-tilted), Move::Done(Hand::Postument));
    }

    #[test]
    fn stubborn_layer_is_taken_anew_where_it_stands() {
        let mut stage = failed(-0.5);
        assert_eq!(decides(&mut stage, BEFORE_ANEW + 1, true), Move::TakeAnew { doubt: false });
        assert!((stage.robot.turn_in_progress.as_ref().unwrap().stood.1 + 0.5).abs() < 1e-9);

        // The layer lags behind a hand whose jaws it has forced apart.
        let mut stage = failed(-0.5);
        stage.robot.arms[0].jaw_opening = jaws_forced_apart(0.2);
        decides(&mut stage, BEFORE_ANEW + 1, true);
        let off = stage.robot.turn_in_progress.as_ref().unwrap().stood.1;
        assert!((off - (-0.5 + 0.2 + PAD_GIVE)).abs() < 1e-9, "{off}");
    }

    #[test]
    fn layer_taken_anew_is_closed_upon_at_its_roll() {
        let mut stage = failed(-0.5);
        decides(&mut stage, 1, true);

        let takes = async |robot: &mut Robot| take_anew(robot, Hand::Track, false).await;
        let (end, actions) = stage.play(takes, &mut goes_well);

        assert_eq!(end, Ok(()));
        let lets_go = ["open", "line"];
        let closes = ["zero", "line", "line", "approach", "close"];
        assert_eq!(words(&actions), [&lets_go[..], &closes].concat());
        let target = |action: &Action<Thought>| match order(action) {
            Some(Behaviour::Line { target, .. }) => *target,
            _ => panic!("{action:?}"),
        };
        let roll = target(&actions[4]).rotation.angle();
        assert!((roll - 0.5).abs() < 1e-9, "{roll}");
        assert!(stage.robot.belief.held[0].is_some());
    }

    #[test]
    fn hopeless_layer_goes_back_with_the_track() {
        let mut stage = failed(-0.5);
        let last = decides(&mut stage, MOST_TRIES + 1, true);
        assert_eq!(last, Move::Stay { contradict: false });
        let leaves = leave_misaligned(&mut stage.robot, false);
        assert_eq!(leaves, Failure::GiveUp { release: Some(Hand::Postument) });

        // A hand that holds badly is not left alone with it, and none closes over such a layer.
        let mut stage = failed(-0.5);
        stage.robot.arms[0].jaw_opening = jaws_forced_apart(0.2);
        let Failure::Final(why) = leave_misaligned(&mut stage.robot, false) else { panic!() };
        assert!(why.ends_with("the layer is still askew"), "{why}");
    }

    #[test]
    fn last_try_counts_after_easing() {
        let mut stage = failed(-0.5);
        assert!(matches!(decides(&mut stage, MOST_TRIES + 1, false), Move::Ease(_)));
    }

    /// Plays the realignment; the first `turns` turns end as told, in turn, and well afterwards. A
    /// turn that ends well brings the layer along.
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
                Event::Behaved([Some(outcome), Some(Outcome::Ended)])
            }
            Some(Behaviour::Jaw { .. }) => {
                arms[0].jaw_opening = 0.09;
                goes_well(action, arms)
            }
            Some(Behaviour::Grasp { .. }) => {
                arms[0].jaw_opening = WIDTH;
                Event::Behaved([Some(Outcome::Grasped(WIDTH)), None])
            }
            Some(Behaviour::Present { .. }) => Event::Behaved([Some(Outcome::TimedOut(1.0)); 2]),
            _ => goes_well(action, arms),
        })
    }

    #[test]
    fn layer_is_turned_back_and_let_go() {
        let (end, actions) = realigns(&mut failed(-0.5), vec![]);

        assert_eq!(end, Ok(Hand::Track));
        let eases = ["give way", "give way"];
        assert_eq!(words(&actions), [&eases[..], &["turn"], &eases].concat());
    }

    #[test]
    fn lost_layer_is_taken_anew_where_it_stood() {
        // A hand that turned back with the layer left it in line, one without left it where it was.
        for (outcome, stood) in [(Outcome::Turned(0.5), 0.0), (Outcome::Slipped(0.5, 0.01), -0.5)] {
            let mut stage = failed(-0.5);
            let (end, actions) = realigns(&mut stage, vec![(outcome, Some(WIDTH - 0.01))]);

            assert_eq!(end, Ok(Hand::Track), "{outcome:?}");
            let words = words(&actions);
            let lost = ["turn", "open", "line", "zero", "line", "line", "approach", "close"];
            assert_eq!(words[2..10], lost, "{words:?}");
            let roll = actions.iter().filter_map(|action| match order(action) {
                Some(Behaviour::Line { target, .. }) => Some(target.rotation.scaled_axis().z),
                _ => None,
            });
            let rolls: Vec<f64> = roll.collect();
            assert!((rolls[2] - stood).abs() < 1e-9, "{rolls:?} {stood}");
        }
    }

    #[test]
    fn alarm_on_the_way_back_is_tried_again() {
        let mut stage = failed(-0.5);

        let (end, actions) = realigns(&mut stage, vec![(Outcome::OverForce(0, 30.0), None)]);

        assert_eq!(end, Ok(Hand::Track));
        assert!(stage.notes().iter().any(|note| note.contains("over-force")));
        assert_eq!(words(&actions).iter().filter(|word| **word == "give way").count(), 4);
    }

    #[test]
    fn slip_on_the_way_back_lags_the_other_way() {
        let mut stage = failed(-0.5);
        decides(&mut stage, 1, true);
        let turns = async |robot: &mut Robot| turn_back(robot, Hand::Track, 0.5, 1).await;

        let (end, _) = stage.play(turns, &mut |_, arms| {
            arms[0].desired_joints.0[6] += 0.3;
            arms[0].jaw_opening = jaws_forced_apart(0.2);
            Event::Behaved([Some(Outcome::ForcedApart(0.001)), None])
        });

        assert!(matches!(end, Err(Failure::Strained(_))), "{end:?}");
        let step = decides(&mut stage, 2, true);
        assert!((back(step) - (0.2 + 0.2 + PAD_GIVE)).abs() < 1e-6, "{step:?}");
    }

    #[test]
    fn released_layer_is_found_where_it_stood() {
        let mut stage = failed(-0.5);
        decides(&mut stage, 1, false);
        stage.robot.belief.released(Hand::Track);
        stage.robot.arms[0].desired_joints.0[6] = 2.0;

        assert_eq!(decides(&mut stage, 4, true), Move::TakeAnew { doubt: false });
        let off = stage.robot.turn_in_progress.as_ref().unwrap().stood.1;
        assert!((off + 0.5).abs() < 1e-9, "{off}");
    }

    #[test]
    fn neither_hand_follows_a_contradicting_force() {
        let begins = |track: f64, postument: f64, number: u32| {
            let mut stage = failed(0.0);
            for (arm, force) in stage.robot.arms.iter_mut().zip([track, postument]) {
                let along = [force, 0.0, 0.0, 0.0, 0.0, 0.0];
                arm.wrench_in_tool = Wrench::from_directions(along);
            }
            decides(&mut stage, number, false)
        };

        // The settings have both tools stand alike.
        assert!(matches!(begins(30.0, -30.0, 1), Move::Ease(_)));
        assert_eq!(begins(30.0, 0.0, 1), Move::Stand);
        assert_eq!(begins(0.0, -30.0, 2), Move::TakeAnew { doubt: true });
        assert_eq!(begins(0.0, -30.0, MOST_TRIES + 1), Move::Stay { contradict: true });
        let mut stage = failed(0.0);
        leave_misaligned(&mut stage.robot, true);
        assert_eq!(stage.robot.trust, Trust::Doubted);
    }

    #[test]
    fn other_tasks_realign_nothing() {
        let mut stage = failed(0.0);
        stage.robot.goal = Goal::FaceTurn(1.0);
        stage.robot.arms = [ArmState { jaw_opening: WIDTH, ..ArmState::default() }; 2];
        let turns = async |robot: &mut Robot| turn::turn_through(robot, Hand::Track, 1.0).await;

        let (end, _) = stage.play(turns, &mut |_, _| {
            Event::Behaved([Some(Outcome::Slipped(0.1, 0.01)), Some(Outcome::Ended)])
        });

        assert!(matches!(end, Err(Failure::Final(_))), "{end:?}");
    }

    #[test]
    fn realigned_cube_is_read_anew_while_recoveries_last() {
        for (recoveries, anew) in [(0, true), (MOST_RECOVERIES, false)] {
            let mut stage = failed(0.0);
            stage.robot.recoveries = recoveries;
            let failure = Failure::TurnFailed { turner: Hand::Track };
            let mends = async |robot: &mut Robot| mend::mend(robot, failure).await;

            let (end, _) = stage.play(mends, &mut |action, arms| match order(action) {
                Some(Behaviour::Present { .. }) => Event::Behaved([None, None]),
                _ => goes_well(action, arms),
            });

            let release = Some(Hand::Track);
            let expected =
                if anew { Failure::ReadAnew { release } } else { Failure::GiveUp { release } };
            assert_eq!(end, Err(expected));
        }
    }

    #[test]
    fn layer_lost_in_failed_turn_is_taken_anew() {
        let mut stage = failed(-0.5);
        stage.robot.arms[0].jaw_opening = WIDTH - 0.01;
        let failure = Failure::TurnFailed { turner: Hand::Track };
        let mends = async |robot: &mut Robot| mend::mend(robot, failure).await;

        let (_, actions) = stage.play(mends, &mut |action, arms| match order(action) {
            Some(Behaviour::Present { .. }) => Event::Behaved([None, None]),
            Some(Behaviour::Grasp { .. }) => {
                arms[0].jaw_opening = WIDTH;
                Event::Behaved([Some(Outcome::Grasped(WIDTH)), None])
            }
            _ => goes_well(action, arms),
        });

        let anew = ["open", "line", "zero", "line", "line", "approach", "close"];
        assert_eq!(words(&actions)[..7], anew);
        assert!(stage.notes().iter().any(|note| note.ends_with("the layer is taken anew")));
    }

    #[test]
    fn jaws_tell_how_a_square_stands() {
        for angle in [0.0, 0.1, 0.5] {
            let opening = (0.057 + 0.012 * libm::sin(angle)) / libm::cos(angle);
            let found = misaligned_between(opening, 0.057, 0.012);
            assert!((found - angle).abs() < 1e-6, "{angle}");
        }
        assert!(misaligned_between(0.05, 0.057, 0.012).abs() < 1e-9, "narrower than any");
    }
}
