//! A turn that did not go through: the layer is brought back into line before anything else is done with the cube.
//!
//! - flat jaws know how a layer stands: between pads that lie flat it is where the roll of the hand is, to the nearest
//!   quarter; what stands askew between them forces them apart, by an angle that their distance tells
//! - so the hand turns back by its own roll, but for what the whole cube has turned along in the partner's jaws. What
//!   strains it may pass: it gives way and tries again; then it lets go, zeroes its force in free air, closes at the
//!   roll at which the layer stands, and tries again
//! - then the hand in which the cube stands askew lets go, or else the one that turned, and all faces are read anew
//! - a layer that does not come into line is left as it is, and the cube goes back with the reason
//! - source: own work

use super::recover::MOST_RECOVERIES;
use super::{Job, Mission, Trust, name};
use crate::generators::Outcome;
use crate::motion::{ArmState, Depth};
use crate::tasks::cube::hold::{Grip, Hand};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

/// A layer that stands off by less is in line [rad].
const IN_LINE: f64 = 0.03;
/// How long they do while the cube stands askew in one: a weak grip that turns back slips on.
const WEAK: f64 = 5.0;
/// What turns between pads by less does not force them apart: their rubber gives [rad]. Tried with half and with nearly twice
/// as much: slips are undone as well.
const PAD_GIVE: f64 = 0.015;
/// The torque at which a turn back stands still: less than pads of rubber carry about any axis [Nm].
pub(super) const GENTLE: f64 = 1.0;
/// What only one of two hands feels of the cube between them is not the cube's, from this on [N].
const CONTRADICTION: f64 = 8.0;
/// How long both hands stand and wait for it to pass [s].
const STAND: f64 = 1.5;
/// Jaws at rest that are farther apart than they were do not lie flat [m].
const ASKEW: f64 = 0.00025;
/// Tries to turn back before the hand lets go and takes the layer anew, and in all.
const BEFORE_ANEW: u32 = 2;
const MOST_TRIES: u32 = 6;
/// How long the hands give way before a try [s]: at first as a push lasts, then as a jam may.
const WAITS: [f64; MOST_TRIES as usize] = [1.5, 3.0, 1.0, 3.0, 4.0, 4.0];

/// A turn that has begun.
#[derive(Debug, Clone)]
pub(super) struct Begun {
    /// Who turns.
    turner: Hand,
    /// How it held the cube while the layer was in line,
    grip: Grip,
    /// and where its last joint stood then [rad].
    roll: f64,
    /// The sense in which what the jaws hold lags behind the hand that turns, 1 or -1.
    sense: f64,
    /// The grip at the quarter that was nearest to the layer when the turner last had it, and how far off it the layer
    /// stood [rad].
    stood: (Grip, f64),
    /// The turner has gone on since without the layer.
    alone: bool,
    /// Why it is being turned back.
    why: Option<String>,
}

impl Begun {
    /// The layer is in line when the roll of the turner's last joint is `roll` [rad].
    pub(super) fn new(turner: Hand, grip: Grip, roll: f64, sense: f64) -> Self {
        Self { turner, grip, roll, sense, stood: (grip, 0.0), alone: false, why: None }
    }

    /// The grip at the quarter that is nearest to a roll, and how far the roll is off it [rad]. The hand may have turned by so
    /// much in vain, since what it or its partner holds stands askew [rad].
    fn nearest(&self, roll: f64, in_vain: f64) -> (Grip, f64) {
        let off = roll - self.roll - self.sense * in_vain;
        let quarters = (off / FRAC_PI_2).round();
        let clockwise = (quarters as i64).rem_euclid(4);
        (self.grip.after_turn(clockwise as u8), off - quarters * FRAC_PI_2)
    }
}

/// By how much a square of a side [m] stands askew between fingers of a width, that it holds so far apart [m, rad].
fn askew_between(opening: f64, side: f64, finger: f64) -> f64 {
    // (side + finger sin a) / cos a = opening
    let (reach, slant) = (opening.hypot(finger), libm::atan2(finger, opening));
    (libm::acos((side / reach).min(1.0)) - slant).clamp(0.0, FRAC_PI_4)
}

impl Mission {
    /// The turn did not go as it should: the layer is brought into line, and the cube read anew.
    pub(super) fn turn_failed(&mut self, turner: Hand, why: &str) -> Result<(), String> {
        let solves = self.goal == super::Goal::Solve;
        let Some(begun) = self.begun.as_mut().filter(|b| solves && b.turner == turner) else {
            return Err(why.to_owned());
        };
        self.log.notes.push(format!("{why}: the layer is brought back into line"));
        begun.why = Some(why.to_owned());
        (self.turning, self.straight) = (None, None);
        self.queue.clear();
        self.queue.push_back(Job::Unwind { turner, tries: 1, eased: false });
        Ok(())
    }

    /// Whether a layer is being brought back into line: what fails then is tried again.
    pub(super) fn unwinds(&self) -> bool {
        self.queue.iter().any(|job| matches!(job, Job::Unwind { .. }))
    }

    /// A step of it failed: the next try begins.
    pub(super) fn try_again(&mut self) {
        while self.queue.front().is_some_and(|job| !matches!(job, Job::Unwind { .. })) {
            self.queue.pop_front();
        }
    }

    /// One try to bring the layer back into line.
    pub(super) fn unwind(&mut self, turner: Hand, tries: u32, eased: bool, arms: &[ArmState]) {
        let Some(mut begun) = self.begun.take() else { return };
        let holds = self.belief.held[turner.index()].is_some();
        if holds {
            (begun.stood, begun.alone) = (self.stands(turner, arms, &begun), false);
            self.belief.turned(turner, begun.stood.0.hold, begun.stood.0.half_roll);
        }
        let (_, off) = begun.stood;
        self.begun = Some(begun.clone());
        let body = turner.other();
        let in_line = holds && off.abs() < IN_LINE;
        let contradict = self.contradiction(arms) > CONTRADICTION;
        if tries > MOST_TRIES && (!holds || contradict || eased && !in_line) {
            self.log.notes.push("the layer could not be brought back into line".to_owned());
            if contradict {
                // Whoever gives way while it lets go must not follow a sensor that lies.
                self.forces = Trust::Doubted;
            }
            self.leave_askew(arms);
            return;
        }
        if !eased && contradict {
            // Nobody gives way to a force that only one of them feels: something pushes, or a sensor lies.
            if tries == 1 {
                self.log
                    .notes
                    .push("the force sensors contradict each other: both hands stand".to_owned());
                let next = Job::Unwind { turner, tries: tries + 1, eased };
                self.push_front(&[Job::Stand(STAND), next]);
            } else {
                self.forces = Trust::Doubted;
                self.take_anew(turner, tries, &begun);
            }
            return;
        }
        if !eased {
            // What is strained would seem to stand askew, and what strains it may pass.
            let slips = [turner, body].into_iter().any(|hand| {
                self.belief.held[hand.index()].is_some() && self.apart(hand, arms) > ASKEW
            });
            let wait = if slips { WEAK } else { WAITS[(tries as usize - 1).min(WAITS.len() - 1)] };
            self.push_front(&[
                Job::Wait(turner.other(), wait),
                Job::Ease(turner),
                Job::Unwind { turner, tries, eased: true },
            ]);
            return;
        }
        if in_line {
            // Who has the better grip keeps the cube.
            let leaves = if self.apart(body, arms) > ASKEW { body } else { turner };
            self.queue.clear();
            self.queue.push_back(Job::LetGo(leaves));
            self.queue.push_back(if self.recoveries < MOST_RECOVERIES {
                Job::Anew
            } else {
                Job::GiveUp
            });
            return;
        }
        let next = Job::Unwind { turner, tries: tries + 1, eased: false };
        // A hand that holds badly is not left alone with the cube.
        let stays = self.apart(body, arms) > ASKEW || tries != BEFORE_ANEW + 1;
        if holds && stays {
            let degrees = off.to_degrees();
            self.log.notes.push(format!(
                "the {} hand turns back by {degrees:.0} deg, try {tries}",
                name(turner)
            ));
            self.push_front(&[Job::Turn { turner, angle: -off, tries: u32::MAX }, next]);
            return;
        }
        self.take_anew(turner, tries, &begun);
    }

    /// A layer stays askew: the track, which hands back, keeps the cube as it holds it, since no jaws may close over such a
    /// layer. Where it has none of it, or holds badly, nobody lets go, and somebody must help.
    fn leave_askew(&mut self, arms: &[ArmState]) {
        let keeps = self.belief.held[Hand::Track.index()].is_some()
            && self.apart(Hand::Track, arms) <= ASKEW;
        self.queue.clear();
        if keeps {
            if self.belief.held[Hand::Postument.index()].is_some() {
                self.queue.push_back(Job::LetGo(Hand::Postument));
            }
            self.queue.push_back(Job::GiveUp);
        } else {
            let why = self.begun.take().and_then(|begun| begun.why);
            let why = why.unwrap_or_else(|| "a layer stands askew".to_owned());
            self.failure = Some(format!("{why}; the layer is still askew"));
            self.queue.push_back(Job::Leave);
        }
    }

    /// The hand has turned back, with the layer or without.
    pub(super) fn went_back(&mut self, without: bool) {
        if let Some(begun) = &mut self.begun {
            begun.alone = without;
        }
    }

    /// The turner has lost the layer while it was to be turned back: it is taken anew where it stood last.
    pub(super) fn lost_layer(&mut self, hand: Hand, arms: &[ArmState]) -> bool {
        let tries = self.queue.iter().find_map(|job| match job {
            Job::Unwind { turner, tries, .. } if *turner == hand => Some(*tries),
            _ => None,
        });
        let (Some(tries), Some(mut begun)) = (tries, self.begun.take()) else { return false };
        if !begun.alone {
            begun.stood = self.stands(hand, arms, &begun);
        }
        self.begun = Some(begun);
        self.queue.clear();
        let next = Job::Unwind { turner: hand, tries: tries + 1, eased: true };
        self.queue.extend([Job::LetGo(hand), next]);
        true
    }

    /// The turner lets go, zeroes its force in free air, and closes at the roll at which the layer stands.
    fn take_anew(&mut self, turner: Hand, tries: u32, begun: &Begun) {
        let (grip, off) = begun.stood;
        let holds = self.belief.held[turner.index()].is_some();
        self.log.notes.push(format!("the {} hand takes the layer anew", name(turner)));
        let Grip { hold, half_roll } = grip;
        let mut jobs = vec![
            Job::Bias([true, true]),
            Job::PreGrasp { hand: turner, hold, half_roll },
            Job::Roll(turner, off),
            Job::Approach { hand: turner, hold, half_roll },
            Job::Close { hand: turner, hold },
            Job::Holds { hand: turner, hold, half_roll },
            Job::Unwind { turner, tries: tries + 1, eased: false },
        ];
        if holds {
            jobs.insert(0, Job::LetGo(turner));
        }
        self.push_front(&jobs);
    }

    /// The grip of the turner at the quarter nearest to which the layer stands, and how far off it [rad].
    fn stands(&self, turner: Hand, arms: &[ArmState], begun: &Begun) -> (Grip, f64) {
        let roll = arms[turner.index()].desired_joints.0[6];
        let along = self.turned_along(turner, self.apart(turner.other(), arms));
        // Where the layer stands askew between the turner's jaws, it lags behind the hand.
        begun.nearest(roll, along + self.askew_about_palm(turner, self.apart(turner, arms)))
    }

    /// How far what a hand holds stands askew about the palm's axis, when it has forced the jaws apart by so much [m, rad].
    fn askew_about_palm(&self, hand: Hand, apart: f64) -> f64 {
        if apart <= ASKEW {
            return 0.0;
        }
        let width = self.widths[hand.index()].unwrap_or(self.settings.edge);
        askew_between(width + apart, width, self.settings.finger_width) + PAD_GIVE
    }

    /// By how much jaws are farther apart than when they closed [m].
    fn apart(&self, hand: Hand, arms: &[ArmState]) -> f64 {
        let width = self.widths[hand.index()].unwrap_or(self.settings.edge);
        arms[hand.index()].jaw_opening - width
    }

    /// What both hands feel of the cube between them, together: nothing but its weight, where both sensors are right and
    /// nobody else is there [N].
    fn contradiction(&self, arms: &[ArmState]) -> f64 {
        let felt = |hand: Hand| {
            let arm = &arms[hand.index()];
            let world_from_tool =
                self.belief.world_from_base(hand).rotation * arm.base_from_tool.rotation;
            world_from_tool * arm.wrench_in_tool.force
        };
        let both = self.belief.held.iter().all(Option::is_some);
        if both { (felt(Hand::Track) + felt(Hand::Postument)).norm() } else { 0.0 }
    }

    /// How far the cube has turned in the jaws of the body's hand, which it has forced apart by so much [m, rad].
    fn turned_along(&self, turner: Hand, apart: f64) -> f64 {
        let body = turner.other();
        let Some(held) = self.belief.held[body.index()].filter(|_| apart > ASKEW) else {
            return 0.0;
        };
        match self.belief.turn_axis(turner) {
            // Along the fingers' width: the pads lie on it as deep as the fingers reach.
            Some(0) => {
                let depth = self.settings.finger_depth[usize::from(held.hold.depth == Depth::Two)];
                libm::asin((apart / depth).min(1.0)) + PAD_GIVE
            }
            Some(2) => self.askew_about_palm(body, apart),
            _ => 0.0,
        }
    }

    /// The layer does not come into line, or this has happened too often: the cube goes back as it is.
    pub(super) fn give_up(&mut self) -> Result<(), String> {
        let why = self.begun.take().and_then(|begun| begun.why).or_else(|| self.failure.take());
        self.give_back(why.unwrap_or_else(|| "a layer stands askew".to_owned()))
    }

    /// A hand that turned back has forced jaws apart: what it turned lags behind it the other way now.
    pub(super) fn slipped_back(&mut self, angle: f64) {
        if let Some(begun) = &mut self.begun {
            begun.sense = angle.signum();
        }
    }

    /// The outcome of a turn that belongs to no plan any more.
    pub(super) fn turned_back(outcome: Option<&Outcome>) -> bool {
        matches!(outcome, Some(Outcome::Turned(_) | Outcome::Stalled(..) | Outcome::Slipped(..)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::Goal;
    use super::super::testing::settings;
    use super::*;
    use crate::cube::{Axis, Face, Turn};
    use crate::motion::JointPositions;
    use crate::tasks::cube::hold::{Hold, Step};

    const WIDTH: f64 = 0.0567;

    /// Both hold, and the track hand has begun a quarter turn against the clock.
    fn turning() -> (Mission, [ArmState; 2]) {
        let mut mission = Mission::new(settings(), Goal::Solve, None);
        let hold = |palm: Face, jaws: Axis| Hold { palm, jaws, depth: Depth::One };
        mission.belief.taken(Hand::Track, hold(Face::U, Axis::X), false);
        // The turn's axis is along the fingers' width of the hand that holds the body.
        mission.belief.taken(Hand::Postument, hold(Face::F, Axis::X), false);
        mission.widths = [Some(WIDTH); 2];
        mission.apart = false;
        mission.meeting = settings().meetings.grasps[0];
        let joints = JointPositions([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.4]);
        let arm = ArmState { jaw_opening: WIDTH, desired_joints: joints, ..ArmState::default() };
        let turn = Turn { face: Face::U, quarters: 3 };
        mission.unfold_step(Step::Turn { turner: Hand::Track, turn }, &[arm; 2]).unwrap();
        mission.queue.clear();
        (mission, [arm; 2])
    }

    /// The jobs that follow when the turn fails with the arms like this.
    fn jobs(mut mission: Mission, arms: &[ArmState; 2], tries: u32) -> Vec<Job> {
        mission.turn_failed(Hand::Track, "so it was").unwrap();
        mission.queue.clear();
        mission.unwind(Hand::Track, tries, true, arms);
        mission.queue.into()
    }

    /// By how much the hand turns back [rad].
    fn back(jobs: &[Job]) -> Option<f64> {
        jobs.iter().find_map(|job| match job {
            Job::Turn { angle, tries: u32::MAX, .. } => Some(*angle),
            _ => None,
        })
    }

    #[test]
    fn the_hand_turns_back_to_the_nearest_quarter_by_its_own_roll() {
        for (roll, expected) in
            [(-0.5, Some(0.5)), (-1.2, Some(-(FRAC_PI_2 - 1.2))), (0.1, Some(-0.1)), (0.0, None)]
        {
            let (mission, mut arms) = turning();
            arms[0].desired_joints.0[6] += roll;

            let jobs = jobs(mission, &arms, 1);

            let near = match (back(&jobs), expected) {
                (Some(back), Some(expected)) => (back - expected).abs() < 1e-9,
                (back, expected) => back == expected,
            };
            assert!(near, "{roll} {jobs:?}");
            if expected.is_none() {
                assert_eq!(jobs, [Job::LetGo(Hand::Track), Job::Anew]);
            }
        }
    }

    #[test]
    fn what_turned_along_in_the_partners_jaws_is_not_turned_back_and_the_partner_lets_go() {
        let tilted = 0.1;
        let stands = |roll: f64| {
            let (mission, mut arms) = turning();
            assert_eq!(mission.belief.turn_axis(Hand::Track), Some(0));
            arms[0].desired_joints.0[6] += roll;
            arms[1].jaw_opening = WIDTH + 0.017 * libm::sin(tilted - PAD_GIVE);
            jobs(mission, &arms, 1)
        };

        let back = back(&stands(-0.5)).unwrap();
        assert!((back - (0.5 - tilted)).abs() < 1e-6, "{back}");
        assert_eq!(stands(-tilted), [Job::LetGo(Hand::Postument), Job::Anew]);
    }

    #[test]
    fn a_layer_that_stays_is_taken_anew_where_it_stands_and_in_the_end_goes_back_with_the_cube() {
        let (mission, mut arms) = turning();
        arms[0].desired_joints.0[6] -= 0.5;

        let anew = jobs(mission, &arms, BEFORE_ANEW + 1);
        assert_eq!(anew[0], Job::LetGo(Hand::Track));
        let bias = anew.iter().position(|job| *job == Job::Bias([true, true])).unwrap();
        let roll = anew.iter().position(|job| matches!(job, Job::Roll(..))).unwrap();
        assert!(matches!(anew[roll], Job::Roll(Hand::Track, by) if (by + 0.5).abs() < 1e-9));
        assert!(bias < roll, "{anew:?}");

        // The layer lags behind a hand whose jaws it has forced apart.
        let (mission, _) = turning();
        arms[0].jaw_opening = (WIDTH + 0.012 * libm::sin(0.2)) / libm::cos(0.2);
        let anew = jobs(mission, &arms, BEFORE_ANEW + 1);
        let by = anew.iter().find_map(|job| match job {
            Job::Roll(_, by) => Some(*by),
            _ => None,
        });
        assert!((by.unwrap() - (-0.5 + 0.2 + PAD_GIVE)).abs() < 1e-9, "{by:?}");

        // A hand that holds badly is not left alone with it, and nobody closes over what stands askew.
        let (mission, _) = turning();
        assert_eq!(jobs(mission, &arms, MOST_TRIES + 1), [Job::Leave]);
        arms[0].jaw_opening = WIDTH;
        let (mission, _) = turning();
        let end = [Job::LetGo(Hand::Postument), Job::GiveUp];
        assert_eq!(jobs(mission, &arms, MOST_TRIES + 1), end);
    }

    #[test]
    fn a_layer_that_is_lost_on_the_way_back_is_taken_anew_where_it_stood() {
        let (mut mission, mut arms) = turning();
        arms[0].desired_joints.0[6] -= 0.5;
        mission.turn_failed(Hand::Track, "so it was").unwrap();
        arms[0].jaw_opening = WIDTH - 0.01;

        mission.look_after(&arms).unwrap();

        let next = Job::Unwind { turner: Hand::Track, tries: 2, eased: true };
        assert_eq!(mission.queue, [Job::LetGo(Hand::Track), next]);
        mission.queue.clear();
        mission.unwind(Hand::Track, 2, true, &arms);
        let roll = mission.queue.iter().find(|job| matches!(job, Job::Roll(..)));
        assert!(matches!(roll, Some(Job::Roll(_, by)) if (by + 0.5).abs() < 1e-9), "{roll:?}");

        // A hand that has turned back without the layer left it where it was.
        for (followed, stood) in [(true, 0.0), (false, -0.5)] {
            let (mut mission, mut arms) = turning();
            arms[0].desired_joints.0[6] -= 0.5;
            mission.turn_failed(Hand::Track, "so it was").unwrap();
            mission.queue.clear();
            mission.unwind(Hand::Track, 1, true, &arms);
            let Some(turn) = mission.queue.pop_front() else { panic!() };
            arms[0].desired_joints.0[6] += 0.5;
            let ended = if followed { Outcome::Turned(0.5) } else { Outcome::Slipped(0.5, 0.01) };
            mission.behaved(turn, [Some(ended), None], &arms).unwrap();
            arms[0].jaw_opening = WIDTH - 0.01;

            mission.look_after(&arms).unwrap();

            let (_, off) = mission.begun.unwrap().stood;
            assert!((off - stood).abs() < 1e-9, "{off} {stood}");
        }
    }

    #[test]
    fn what_slips_on_the_way_back_lags_behind_the_other_way() {
        let (mut mission, mut arms) = turning();
        arms[0].desired_joints.0[6] -= 0.5;
        mission.turn_failed(Hand::Track, "so it was").unwrap();
        mission.queue.clear();
        mission.unwind(Hand::Track, 1, true, &arms);
        let Some(turn) = mission.queue.pop_front() else { panic!() };
        arms[0].desired_joints.0[6] += 0.3;
        arms[0].jaw_opening = (WIDTH + 0.012 * libm::sin(0.2)) / libm::cos(0.2);

        mission.behaved(turn, [Some(Outcome::ForcedApart(0.001)), None], &arms).unwrap();

        mission.queue.clear();
        mission.unwind(Hand::Track, 2, true, &arms);
        let expected = 0.2 + 0.2 + PAD_GIVE;
        let back = back(mission.queue.make_contiguous()).unwrap();
        assert!((back - expected).abs() < 1e-6, "{back} {expected}");
    }

    #[test]
    fn the_last_try_counts_and_a_layer_that_was_let_go_is_found_where_it_stood() {
        let (mut mission, mut arms) = turning();
        mission.turn_failed(Hand::Track, "so it was").unwrap();
        mission.queue.clear();
        mission.unwind(Hand::Track, MOST_TRIES + 1, false, &arms);
        let eased = Job::Unwind { turner: Hand::Track, tries: MOST_TRIES + 1, eased: true };
        assert_eq!(mission.queue.back(), Some(&eased));

        arms[0].desired_joints.0[6] -= 0.5;
        let (mut mission, _) = turning();
        mission.turn_failed(Hand::Track, "so it was").unwrap();
        mission.unwind(Hand::Track, 1, false, &arms);
        mission.belief.released(Hand::Track);
        arms[0].desired_joints.0[6] = 2.0;
        mission.queue.clear();
        mission.unwind(Hand::Track, 4, true, &arms);
        let by = mission.queue.iter().find_map(|job| match job {
            Job::Roll(_, by) => Some(*by),
            _ => None,
        });
        assert!((by.unwrap() + 0.5).abs() < 1e-9, "{by:?}");
    }

    #[test]
    fn nobody_gives_way_to_a_force_that_only_one_hand_feels() {
        let begins = |track: f64, postument: f64, tries: u32| {
            let (mut mission, mut arms) = turning();
            for (arm, force) in arms.iter_mut().zip([track, postument]) {
                let along = [force, 0.0, 0.0, 0.0, 0.0, 0.0];
                arm.wrench_in_tool = crate::spatial::Wrench::from_directions(along);
            }
            mission.turn_failed(Hand::Track, "so it was").unwrap();
            mission.queue.clear();
            mission.unwind(Hand::Track, tries, false, &arms);
            let trust = mission.forces;
            (mission.queue.front().copied().unwrap(), trust)
        };

        // The settings have both tools stand alike.
        assert!(matches!(begins(30.0, -30.0, 1).0, Job::Wait(Hand::Postument, _)));
        assert_eq!(begins(30.0, 0.0, 1), (Job::Stand(STAND), Trust::Believed));
        assert_eq!(begins(0.0, -30.0, 2), (Job::LetGo(Hand::Track), Trust::Doubted));
        let end = (Job::LetGo(Hand::Postument), Trust::Doubted);
        assert_eq!(begins(0.0, -30.0, MOST_TRIES + 1), end);
    }

    #[test]
    fn what_fails_on_the_way_back_is_tried_again_and_no_other_task_unwinds() {
        let over = [Some(Outcome::OverForce(0, 30.0)), None];
        let (mut mission, mut arms) = turning();
        arms[0].desired_joints.0[6] -= 0.5;
        mission.turn_failed(Hand::Track, "so it was").unwrap();
        mission.queue.clear();
        mission.unwind(Hand::Track, 1, true, &arms);
        let Some(turn) = mission.queue.pop_front() else { panic!() };

        mission.behaved(turn, over, &arms).unwrap();

        let next = Job::Unwind { turner: Hand::Track, tries: 2, eased: false };
        assert_eq!(mission.queue.front(), Some(&next));

        let (mut mission, _) = turning();
        mission.goal = Goal::FaceTurn(1.0);
        assert_eq!(mission.turn_failed(Hand::Track, "so it was"), Err("so it was".to_owned()));
    }

    #[test]
    fn jaws_tell_how_a_square_stands_between_them() {
        for angle in [0.0, 0.1, 0.5] {
            let opening = (0.057 + 0.012 * libm::sin(angle)) / libm::cos(angle);
            assert!((askew_between(opening, 0.057, 0.012) - angle).abs() < 1e-6, "{angle}");
        }
        assert!(askew_between(0.05, 0.057, 0.012).abs() < 1e-9, "narrower than any");
    }
}
