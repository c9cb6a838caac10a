//! The operator's hand: it brings the cube, holds it nearly still, lets go, and takes it back at
//! the end.
//!
//! The hand sees what a person sees: jaws on the cube, a cube at rest in front of it, a solved
//! cube. It senses the load on the cube. It knows nothing of the controller.
//!
//! - in: time, what the person sees and senses
//! - out: the pose at which it wants the cube while it holds it, and the pose of the hand
//! - the path is a minimum-jerk motion with sway and tremor, which calm down after the arrival

use super::config::HandScript;
use super::frame::{Frame, rotation};
use crate::cell::HandZone;
use nalgebra::Vector3;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Number of sines per axis that make up the sway.
const SWAYS: usize = 3;
/// Number of sines per axis that make up the tremor.
const TREMORS: usize = 2;
/// Share of sway and tremor that remains in a calm hand: 0.3 mm and 0.02 mm.
const CALM: f64 = 0.1;
/// Time in which the hand comes or leaves without the cube (s).
const EMPTY_TRIP: f64 = 1.5;
/// Speed below which a cube is nearly still (m/s), and the time for which it must be (s).
const STILL: (f64, f64) = (0.005, 1.0);
/// Time for which a cube that never left the zone must be still there to be meant for the hand (s).
/// A cube that was carried away and is back needs only [`STILL`].
const HELD_OUT: f64 = 5.0;
/// Time for which the load must last before the hand lets go (s).
const LOAD_TIME: f64 = 0.3;
/// Time between two attempts to hand over the cube (s).
const AWAY: f64 = 2.0;

/// Activity of the hand. `since` is the time of its start (s), `from` and `to` are poses of the
/// cube in the world.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
enum Phase {
    /// Waits outside with the cube.
    Outside,
    /// Brings the cube and holds it.
    Bringing { since: f64 },
    /// Withdraws the cube and comes again. `apart` is the displacement by which the path of the
    /// withdrawal and the cube's pose differ at the start, in the world (m). It fades on the way
    /// back: a hand that is still on its way does not come nearer to withdraw.
    DrawingBack {
        since: f64,
        #[serde(default)]
        apart: Vector3<f64>,
    },
    /// Leaves without the cube.
    Leaving { since: f64, from: Frame },
    /// Out of the cell, empty.
    Gone,
    /// Comes to take the cube.
    Coming { since: f64, to: Frame },
    /// Holds the cube and pulls gently.
    Taking { since: f64, from: Frame },
    /// Carries the cube away.
    Carrying { since: f64, from: Frame },
    /// Has the cube.
    Done,
    /// No person is in the cell.
    Absent,
}

/// View of the cube that the operator has in a period, with the load on it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    /// Pose of the cube in the world.
    pub(super) cube: Frame,
    /// Speed of its centre (m/s).
    pub(super) speed: f64,
    /// Number of grippers that hold the cube.
    pub(super) grippers: usize,
    /// Greatest force of a gripper on the cube (N).
    pub(super) load: f64,
    /// Whether the cube looks solved.
    pub(super) solved: bool,
    /// Whether the cube lies on the tray.
    pub(super) fallen: bool,
}

/// Times for which the operator has perceived certain conditions (s); negative for a condition that
/// is not met now.
struct Durations {
    /// Jaws hold the cube.
    closed: f64,
    /// A gripper loads the cube by more than [`HandScript::release_load`].
    loaded: f64,
    /// The cube is nearly still, see [`STILL`].
    still: f64,
}

/// State of a hand in the plant's file; its times count from the moment of saving (s).
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct Saved {
    phase: Phase,
    withdrawals_left: u32,
    let_go_at: f64,
    cube_left_zone: bool,
}

/// The operator's hand: its script, its present activity, and what the operator has seen.
#[derive(Debug, Clone)]
pub(super) struct OperatorHand {
    script: HandScript,
    zone: HandZone,
    phase: Phase,
    /// Place of the cube in a calm hand.
    place: Frame,
    /// Sines of the sway along each axis: amplitude (m), angular frequency (rad/s), phase (rad).
    sways: [[(f64, f64, f64); SWAYS]; 3],
    /// Sines of the tremor along each axis, as for the sway.
    tremors: [[(f64, f64, f64); TREMORS]; 3],
    withdrawals_left: u32,
    /// Time since which jaws have held the cube (s); `None` while no jaws hold it.
    closed_since: Option<f64>,
    /// Time since which a gripper has loaded the cube (s), as in [`Durations`].
    loaded_since: Option<f64>,
    /// Time since which the cube has been nearly still (s).
    still_since: Option<f64>,
    /// Time since which the cube has lain on the tray (s).
    fallen_since: Option<f64>,
    /// Time at which the hand last let go of the cube, or gave up taking it (s).
    let_go_at: f64,
    /// Whether the cube has been out of the zone since the hand let go of it.
    cube_left_zone: bool,
    /// Offset of the hand from the cube's centre, in the world (m).
    grip: Vector3<f64>,
}

impl OperatorHand {
    /// Makes a hand that waits outside of the cell with a cube of this `edge` (m). `rng` draws
    /// where and in which orientation it will hold the cube, and its sway and tremor.
    pub(super) fn new(script: &HandScript, zone: &HandZone, edge: f64, rng: &mut Pcg64) -> Self {
        let mut normal = |spread: f64| -> f64 {
            let x: f64 = StandardNormal.sample(rng);
            x.clamp(-3.0, 3.0) * spread
        };
        let zone_frame = Frame::from_pose(&zone.world_from_cube);
        let offset = Vector3::from_fn(|i, _| {
            normal(script.place_spread).clamp(-zone.half_extent[i], zone.half_extent[i])
        });
        let tilt = Vector3::from_fn(|_, _| normal(script.tilt_spread));
        let mut turned = nalgebra::Matrix3::identity();
        if script.any_orientation {
            // One of 24: which face is up, then which of four looks to the front.
            let up = rng.random_range(0..6_u8);
            let front = f64::from(rng.random_range(0..4_u8)) * FRAC_PI_2;
            let (x, z) = (Vector3::x(), Vector3::z());
            let first = match up {
                0..4 => rotation(&(x * (f64::from(up) * FRAC_PI_2))),
                4 => rotation(&(Vector3::y() * FRAC_PI_2)),
                _ => rotation(&(Vector3::y() * -FRAC_PI_2)),
            };
            turned = super::frame::nearest_alignment(&(rotation(&(z * front)) * first));
        }
        let place =
            Frame { r: rotation(&tilt) * zone_frame.r * turned, p: zone_frame.point(&offset) };
        // Sines of equal strength: amplitude a each gives an r.m.s. of a sqrt(n / 2).
        let amplitude = script.sway * (2.0 / SWAYS as f64).sqrt();
        let sways = std::array::from_fn(|_| {
            std::array::from_fn(|_| {
                let omega = TAU / (script.sway_time * rng.random_range(3.0..9.0));
                (amplitude, omega, rng.random_range(0.0..TAU))
            })
        });
        let tremors = std::array::from_fn(|_| {
            std::array::from_fn(|_| {
                let omega = TAU * rng.random_range(8.0..10.0);
                (script.tremor / TREMORS as f64, omega, rng.random_range(0.0..TAU))
            })
        });
        Self {
            script: *script,
            zone: *zone,
            phase: Phase::Outside,
            place,
            sways,
            tremors,
            withdrawals_left: script.withdrawals,
            closed_since: None,
            loaded_since: None,
            still_since: None,
            fallen_since: None,
            let_go_at: 0.0,
            cube_left_zone: false,
            grip: zone_frame.r * Vector3::new(0.5 * edge, 0.0, 0.0),
        }
    }

    /// Returns the state of the hand for the plant's file; its times count from `t` (s).
    pub(super) fn saved(&self, t: f64) -> Saved {
        let mut phase = self.phase;
        match &mut phase {
            Phase::Bringing { since }
            | Phase::DrawingBack { since, .. }
            | Phase::Leaving { since, .. }
            | Phase::Coming { since, .. }
            | Phase::Taking { since, .. }
            | Phase::Carrying { since, .. } => *since -= t,
            Phase::Outside | Phase::Gone | Phase::Done | Phase::Absent => {}
        }
        Saved {
            phase,
            withdrawals_left: self.withdrawals_left,
            let_go_at: self.let_go_at - t,
            cube_left_zone: self.cube_left_zone,
        }
    }

    /// Sets the hand to a saved state, whose moment is time 0 of this run.
    pub(super) fn restore(&mut self, saved: &Saved) {
        self.phase = saved.phase;
        self.withdrawals_left = saved.withdrawals_left;
        self.let_go_at = saved.let_go_at;
        self.cube_left_zone = saved.cube_left_zone;
    }

    /// Keeps the hand out of the cell until the cube is handed back.
    pub(super) fn stay_away(&mut self) {
        self.phase = Phase::Gone;
    }

    /// Removes the person from the cell for good.
    pub(super) fn keep_out(&mut self) {
        self.phase = Phase::Absent;
    }

    /// Returns the pose, in the world, to which the hand pulls the cube at `t` (s), or `None` when
    /// it does not hold the cube.
    pub(super) fn hold(&self, t: f64) -> Option<Frame> {
        let s = &self.script;
        let out = s.start_offset;
        let moved = |frame: &Frame, by: Vector3<f64>| Frame { r: frame.r, p: frame.p + by };
        match self.phase {
            Phase::Outside => Some(moved(&self.place, out)),
            Phase::Bringing { since } => {
                let left = 1.0 - minimum_jerk((t - since) / s.arrival);
                Some(moved(&self.place, out * left + self.sway_and_tremor(t, since + s.arrival)))
            }
            Phase::DrawingBack { since, apart } => {
                // The path begins where the cube is, at rest.
                let apart = apart * (1.0 - minimum_jerk(t - since - 1.0 - AWAY));
                Some(moved(&self.place, apart + self.withdrawn(t, since)))
            }
            Phase::Taking { since, from } => {
                // The aim moves away by pull / stiffness: the spring of the hold makes the force.
                let pull = out.normalize() * (s.pull / s.stiffness);
                Some(moved(&from, pull * minimum_jerk(t - since)))
            }
            Phase::Carrying { since, from } => {
                Some(moved(&from, out * minimum_jerk((t - since) / 2.0)))
            }
            Phase::Leaving { .. }
            | Phase::Gone
            | Phase::Coming { .. }
            | Phase::Done
            | Phase::Absent => None,
        }
    }

    /// Returns the pose of the hand in the world at `t` (s), or `None` when it is out of the cell.
    /// Its origin is on the side of the cube away from the robot.
    pub(super) fn pose(&self, t: f64) -> Option<Frame> {
        let empty = |frame: Frame, away: f64| Frame {
            r: nalgebra::Matrix3::identity(),
            p: frame.p + self.grip + self.script.start_offset * away,
        };
        match self.phase {
            Phase::Leaving { since, from } => {
                Some(empty(from, minimum_jerk((t - since) / EMPTY_TRIP)))
            }
            Phase::Coming { since, to } => {
                Some(empty(to, 1.0 - minimum_jerk((t - since) / EMPTY_TRIP)))
            }
            Phase::Outside | Phase::Gone | Phase::Done | Phase::Absent => None,
            _ => self.hold(t).map(|cube| empty(cube, 0.0)),
        }
    }

    /// Checks whether the hand carries the cube away.
    pub(super) fn carries(&self) -> bool {
        matches!(self.phase, Phase::Carrying { .. })
    }

    /// Checks whether the hand has taken the cube back and carried it out of the cell.
    pub(super) fn has_it_back(&self) -> bool {
        self.phase == Phase::Done
    }

    /// Makes a hand that brings or offers the cube withdraw it at `t` (s) and offer it again. A
    /// hand that comes for the cube or takes it leaves without it.
    pub(super) fn draw_back(&mut self, t: f64) {
        match self.phase {
            Phase::Bringing { .. } | Phase::DrawingBack { .. } => self.withdraw(t),
            Phase::Coming { to: from, .. } | Phase::Taking { from, .. } => {
                self.phase = Phase::Leaving { since: t, from };
                self.let_go_at = t;
            }
            Phase::Outside
            | Phase::Leaving { .. }
            | Phase::Gone
            | Phase::Carrying { .. }
            | Phase::Done
            | Phase::Absent => {}
        }
    }

    /// Begins to withdraw the cube at `t` (s), from where the hand holds it.
    fn withdraw(&mut self, t: f64) {
        let Some(held) = self.hold(t) else { return };
        let apart = held.p - self.place.p - self.withdrawn(t, t);
        self.phase = Phase::DrawingBack { since: t, apart };
    }

    /// Returns the displacement of the cube from its place at `t` (s), in m, in a withdrawal that
    /// began at `since` (s): one second away, [`AWAY`] of rest, and one second back.
    fn withdrawn(&self, t: f64, since: f64) -> Vector3<f64> {
        let x = t - since;
        let there = minimum_jerk(x) - minimum_jerk(x - 1.0 - AWAY);
        let back = self.script.start_offset.normalize() * (self.script.withdrawal * there);
        back + self.sway_and_tremor(t, since + 2.0 + AWAY)
    }

    /// Chooses the hand's activity at the end of a period, at `t` (s), from what the operator sees.
    pub(super) fn decide(&mut self, t: f64, sight: &Sight) {
        let s = self.script;
        let since = |slot: &mut Option<f64>, yes: bool| -> f64 {
            if yes {
                t - *slot.get_or_insert(t)
            } else {
                *slot = None;
                -1.0
            }
        };
        let lasting = Durations {
            closed: since(&mut self.closed_since, sight.grippers > 0),
            loaded: since(&mut self.loaded_since, sight.load > s.release_load),
            still: since(&mut self.still_since, sight.speed < STILL.0),
        };
        let fallen = since(&mut self.fallen_since, sight.fallen);
        match self.phase {
            // The path counts from the script's time, not from this period.
            Phase::Outside if t >= s.appears => self.phase = Phase::Bringing { since: s.appears },
            Phase::Bringing { since } => self.offer(t, since + s.arrival, sight, &lasting),
            // A withdrawal takes 1 s out, `AWAY`, and 1 s back.
            Phase::DrawingBack { since, .. } => {
                self.offer(t, since + (2.0 + AWAY), sight, &lasting);
            }
            Phase::Leaving { since, .. } if t > since + EMPTY_TRIP => self.phase = Phase::Gone,
            // A cube that fell is brought once more, as at first.
            Phase::Gone if fallen >= s.picks_up_after => {
                self.cube_left_zone = false;
                self.phase = Phase::Bringing { since: t };
            }
            // The hand waits for the cube to be handed back.
            Phase::Gone => self.wait_for_return(t, sight, &lasting),
            Phase::Coming { since, to } => {
                // A cube that moves away now is not meant for the hand. The hand may come again at
                // once.
                if (sight.cube.p - to.p).norm() > 0.03 {
                    self.phase = Phase::Leaving { since: t, from: to };
                    self.let_go_at = t - s.return_after;
                } else if t > since + EMPTY_TRIP {
                    self.phase = Phase::Taking { since: t, from: sight.cube };
                }
            }
            Phase::Taking { from, .. } => {
                // The jaws have opened: the cube is the person's.
                if sight.grippers == 0 {
                    self.phase = Phase::Carrying { since: t, from: sight.cube };
                } else if (sight.cube.p - from.p).norm() > 0.1 {
                    // The arm takes the cube away: the hand does not wrestle with it.
                    self.leave(t, sight);
                }
            }
            Phase::Carrying { since, .. } if t > since + 2.0 => self.phase = Phase::Done,
            _ => {}
        }
    }

    /// Decides for a hand that offers the cube and arrives at `arrived` (s): it lets go when jaws
    /// hold the cube long or firmly enough, and withdraws the cube when no jaws take it.
    fn offer(&mut self, t: f64, arrived: f64, sight: &Sight, lasting: &Durations) {
        let s = self.script;
        let Durations { closed, loaded, .. } = *lasting;
        if closed >= s.release_time || (closed >= 0.0 && loaded >= LOAD_TIME) {
            self.leave(t, sight);
        } else if t > arrived
            && self.withdrawals_left > 0
            && sight.grippers == 0
            && t > arrived + 0.5 * s.stills
        {
            self.withdrawals_left -= 1;
            self.withdraw(t);
        }
    }

    /// Lets go of the cube and leaves, at `t` (s).
    fn leave(&mut self, t: f64, sight: &Sight) {
        self.phase = Phase::Leaving { since: t, from: sight.cube };
        self.let_go_at = t;
    }

    /// Sends the hand for the cube once exactly one gripper has held it still in the hand-over zone
    /// for long enough.
    fn wait_for_return(&mut self, t: f64, sight: &Sight, lasting: &Durations) {
        let s = self.script;
        let inside = self.in_zone(&sight.cube);
        self.cube_left_zone |= !inside;
        // A gripper that reached deep into the zone need not leave it to give the cube back.
        let early = if self.cube_left_zone { 0.0 } else { HELD_OUT };
        if inside
            && t > self.let_go_at + s.return_after + early
            && sight.grippers == 1
            && lasting.still >= early.max(STILL.1)
            && (sight.solved || !s.return_solved_only)
        {
            self.phase = Phase::Coming { since: t, to: sight.cube };
        }
    }

    /// Checks whether the cube's centre is in the hand-over zone, widened by 5 cm because a person
    /// reaches a little farther.
    fn in_zone(&self, cube: &Frame) -> bool {
        let local = Frame::from_pose(&self.zone.world_from_cube).to_local(cube).p;
        (0..3).all(|i| local[i].abs() <= self.zone.half_extent[i] + 0.05)
    }

    /// Returns the displacement of the hand by sway and tremor at `t` (s), in m. Both calm down
    /// after `arrival` (s).
    fn sway_and_tremor(&self, t: f64, arrival: f64) -> Vector3<f64> {
        let calmed = minimum_jerk((t - arrival) / self.script.stills.max(0.1));
        let strength = 1.0 - (1.0 - CALM) * calmed;
        let sum = |waves: &[(f64, f64, f64)]| -> f64 {
            waves.iter().map(|(a, omega, phase)| a * libm::sin(omega * t + phase)).sum()
        };
        Vector3::from_fn(|i, _| strength * (sum(&self.sways[i]) + sum(&self.tremors[i])))
    }
}

/// Returns the share of its path, 0 to 1, that a minimum-jerk motion has covered at the share `x`
/// of its time. The motion rests before 0 and after 1.
fn minimum_jerk(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 + x * (6.0 * x - 15.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spatial::Pose;
    use rand::SeedableRng;

    /// Returns a hand of the default script in a zone of 100 mm around (0.9, 0, 1.2) m.
    fn hand(seed: u64) -> OperatorHand {
        let zone = HandZone {
            world_from_cube: Pose::translation(0.9, 0.0, 1.2),
            half_extent: Vector3::repeat(0.05),
        };
        let mut rng = Pcg64::seed_from_u64(seed);
        OperatorHand::new(&HandScript::default(), &zone, 0.057, &mut rng)
    }

    #[test]
    fn operator_hand_steadies_to_half_millimetre_after_arrival() {
        for seed in 0..20 {
            let mut hand = hand(seed);
            let cube = |hand: &OperatorHand, t: f64| hand.hold(t).unwrap();
            let sight = |cube| Sight {
                cube,
                speed: 0.0,
                grippers: 0,
                load: 0.0,
                solved: false,
                fallen: false,
            };
            assert!((cube(&hand, 0.0).p - hand.place.p).norm() > 0.2);
            hand.decide(1.1, &sight(cube(&hand, 1.1)));

            let (mut moving, mut calm) = (0.0, 0.0);
            for i in 0..1000 {
                let t = f64::from(i) * 0.02;
                moving += (cube(&hand, 5.0 + 0.0001 * t).p - hand.place.p).norm_squared() / 1e3;
                calm += (cube(&hand, 8.0 + t).p - hand.place.p).norm_squared() / 1e3;
            }

            // Half a millimetre along each axis.
            let each = calm.sqrt() / 3_f64.sqrt();
            assert!((0.2e-3..0.5e-3).contains(&each), "{each}");
            assert!(moving > 4.0 * calm);
        }
    }

    #[test]
    fn withdrawal_begins_without_jump() {
        for seed in 0..20 {
            // In the middle of the way, at the arrival, in a calm hand, and in a withdrawal.
            for begin in [2.5, 5.0, 20.0] {
                let mut hand = hand(seed);
                hand.phase = Phase::Bringing { since: 1.0 };
                let at = |hand: &OperatorHand, t: f64| hand.hold(t).unwrap().p;
                for t in [begin, begin + 0.4, begin + 3.5] {
                    let before = at(&hand, t);
                    hand.draw_back(t);
                    assert!((at(&hand, t) - before).norm() < 1e-12, "{begin}, {t}");

                    let out = |at: Vector3<f64>| at.dot(&hand.script.start_offset.normalize());
                    for i in 0..2000 {
                        let t = t + 0.002 * f64::from(i);
                        let fastest = (at(&hand, t + 0.002) - at(&hand, t)).norm() / 0.002;
                        assert!(fastest < 1.5, "{fastest} m/s, {begin}, {t}");
                    }
                    let gone = out(at(&hand, t + 2.0) - before);
                    assert!((gone - hand.script.withdrawal).abs() < 0.02, "{gone} m");
                }
                let back = (at(&hand, begin + 9.0) - hand.place.p).norm();
                assert!(back < 0.02, "{back} m");
            }
        }
    }

    /// Returns the time at which the hand comes for a cube that is held as in `held` from time 0 on
    /// (s), or `None` if it never comes. The hand let go of the cube at `let_go_at` (s);
    /// `left_zone` is whether the cube has left the zone since.
    fn comes_for(held: &Sight, left_zone: bool, let_go_at: f64) -> Option<f64> {
        let mut hand = hand(1);
        hand.stay_away();
        hand.let_go_at = let_go_at;
        hand.cube_left_zone = left_zone;
        let cube = hand.place;
        let mut times = (0..20_000_u32).map(|k| 0.002 * f64::from(k));
        times.find(|&t| {
            hand.decide(t, &Sight { cube, ..*held });
            matches!(hand.phase, Phase::Coming { .. })
        })
    }

    #[test]
    fn operator_collects_cube_sooner_if_it_left_zone() {
        let held = Sight {
            cube: Frame { r: nalgebra::Matrix3::identity(), p: Vector3::zeros() },
            speed: 0.001,
            grippers: 1,
            load: 0.0,
            solved: false,
            fallen: false,
        };
        let about = |seconds: f64, t: Option<f64>| t.is_some_and(|t| (t - seconds).abs() < 0.01);

        let (long_ago, now, waits) = (-100.0, 0.0, HandScript::default().return_after);
        assert!(about(STILL.1, comes_for(&held, true, long_ago)));
        // A cube that was taken deep in the zone may be offered there without ever having left it.
        assert!(about(HELD_OUT, comes_for(&held, false, long_ago)));
        assert_eq!(comes_for(&Sight { speed: 0.01, ..held }, false, long_ago), None);
        assert_eq!(comes_for(&Sight { grippers: 2, ..held }, false, long_ago), None);
        assert_eq!(comes_for(&Sight { grippers: 0, ..held }, true, long_ago), None);
        // The time at rest before the return was possible does not count.
        assert!(about(waits, comes_for(&held, true, now)));
        assert!(about(waits + HELD_OUT, comes_for(&held, false, now)));
    }
}
