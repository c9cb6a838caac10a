//! The operator's hand: it brings the cube, holds it nearly still, lets go, and takes it back at the end.
//!
//! It sees what a person sees: whether jaws are on the cube, whether the cube stands still in front of it,
//! whether it is solved; and it feels the load on the cube. It knows nothing of the controller.
//!
//! - in: time, what it sees and feels
//! - out: where it wants the cube while it holds it, and where the hand is
//! - the path is a minimum-jerk motion with sway and tremor, which calm down after the arrival

use super::config::HandScript;
use super::frame::{Frame, rotation};
use crate::cell::HandZone;
use nalgebra::Vector3;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Sines per axis that make up the sway, and those of the tremor.
const SWAYS: usize = 3;
const TREMORS: usize = 2;
/// What is left of sway and tremor when it has calmed down: 0.3 mm and 0.02 mm.
const CALM: f64 = 0.1;
/// How long it takes to come or to go without the cube (s).
const EMPTY_TRIP: f64 = 1.5;
/// A cube slower than this is nearly still (m/s), for this long (s).
const STILL: (f64, f64) = (0.005, 1.0);
/// A cube that was never carried away is meant for it when it stands still in front of it for so
/// long after it might be (s).
const HELD_OUT: f64 = 5.0;
/// How long the load must last before it lets go (s).
const LOAD_TIME: f64 = 0.3;
/// How long it stays away between two attempts (s).
const AWAY: f64 = 2.0;

/// What it is doing.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
enum Phase {
    /// Waits outside with the cube.
    Outside,
    /// Brings it, holds it.
    Bringing { since: f64 },
    /// Draws back with the cube and comes again.
    DrawingBack { since: f64 },
    /// Goes away empty.
    Leaving { since: f64, from: Frame },
    /// Out of the cell, empty.
    Gone,
    /// Comes to take the cube.
    Coming { since: f64, to: Frame },
    /// Has hold of it and pulls gently.
    Taking { since: f64, from: Frame },
    /// Carries it away.
    Carrying { since: f64, from: Frame },
    /// Has it.
    Done,
    /// Nobody is in the cell.
    Absent,
}

/// What the operator sees and feels of the cube in a period.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    pub(super) cube: Frame,
    /// Speed of its centre (m/s).
    pub(super) speed: f64,
    /// Grippers that hold it.
    pub(super) grippers: usize,
    /// Greatest force of a gripper on it (N).
    pub(super) load: f64,
    pub(super) solved: bool,
    /// It lies on the tray.
    pub(super) fallen: bool,
}

/// For how long something has been so (s); negative if it is not.
struct Felt {
    /// Jaws hold the cube.
    closed: f64,
    /// A gripper pulls at it.
    loaded: f64,
    /// It stands still.
    still: f64,
}

/// What is kept of a hand; times count from the moment at which it was kept (s).
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct Saved {
    phase: Phase,
    withdrawals_left: u32,
    let_go_at: f64,
    cube_left_zone: bool,
}

#[derive(Debug, Clone)]
pub(super) struct OperatorHand {
    script: HandScript,
    zone: HandZone,
    phase: Phase,
    /// Where it holds the cube when still.
    place: Frame,
    sways: [[(f64, f64, f64); SWAYS]; 3],
    tremors: [[(f64, f64, f64); TREMORS]; 3],
    withdrawals_left: u32,
    closed_since: Option<f64>,
    loaded_since: Option<f64>,
    still_since: Option<f64>,
    fallen_since: Option<f64>,
    let_go_at: f64,
    cube_left_zone: bool,
    /// Offset of the hand from the cube's centre, in the world (m).
    grip: Vector3<f64>,
}

impl OperatorHand {
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

    /// What is kept of it at `t`.
    pub(super) fn saved(&self, t: f64) -> Saved {
        let mut phase = self.phase;
        match &mut phase {
            Phase::Bringing { since }
            | Phase::DrawingBack { since }
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

    /// Goes on at time 0 with what was kept.
    pub(super) fn restore(&mut self, saved: &Saved) {
        self.phase = saved.phase;
        self.withdrawals_left = saved.withdrawals_left;
        self.let_go_at = saved.let_go_at;
        self.cube_left_zone = saved.cube_left_zone;
    }

    /// A hand that has nothing to do until the cube is handed back.
    pub(super) fn stay_away(&mut self) {
        self.phase = Phase::Gone;
    }

    /// Nobody is in the cell, and nobody comes.
    pub(super) fn keep_out(&mut self) {
        self.phase = Phase::Absent;
    }

    /// Where it wants the cube at `t` seconds; `None` when it does not hold it.
    pub(super) fn hold(&self, t: f64) -> Option<Frame> {
        let s = &self.script;
        let out = s.start_offset;
        let moved = |frame: &Frame, by: Vector3<f64>| Frame { r: frame.r, p: frame.p + by };
        match self.phase {
            Phase::Outside => Some(moved(&self.place, out)),
            Phase::Bringing { since } => {
                let left = 1.0 - minimum_jerk((t - since) / s.arrival);
                Some(moved(&self.place, out * left + self.unrest(t, since + s.arrival)))
            }
            Phase::DrawingBack { since } => {
                let x = t - since;
                let there = minimum_jerk(x) - minimum_jerk(x - 1.0 - AWAY);
                let back = out.normalize() * (s.withdrawal * there);
                Some(moved(&self.place, back + self.unrest(t, since + 2.0 + AWAY)))
            }
            Phase::Taking { since, from } => {
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

    /// Where the hand is at `t`: its origin on the cube's far side; `None` when out of the cell.
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

    /// Whether it carries the cube away.
    pub(super) fn carries(&self) -> bool {
        matches!(self.phase, Phase::Carrying { .. })
    }

    /// Whether it has the cube for good.
    pub(super) fn has_it_back(&self) -> bool {
        self.phase == Phase::Done
    }

    /// Draws the cube back at once, as at each of its withdrawals; a hand that comes for it turns round.
    pub(super) fn draw_back(&mut self, t: f64) {
        match self.phase {
            Phase::Outside | Phase::Bringing { .. } | Phase::DrawingBack { .. } => {
                self.phase = Phase::DrawingBack { since: t };
            }
            Phase::Coming { to: from, .. } | Phase::Taking { from, .. } => {
                self.phase = Phase::Leaving { since: t, from };
                self.let_go_at = t;
            }
            Phase::Leaving { .. }
            | Phase::Gone
            | Phase::Carrying { .. }
            | Phase::Done
            | Phase::Absent => {}
        }
    }

    /// Looks, feels and decides at the end of a period.
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
        let felt = Felt {
            closed: since(&mut self.closed_since, sight.grippers > 0),
            loaded: since(&mut self.loaded_since, sight.load > s.release_load),
            still: since(&mut self.still_since, sight.speed < STILL.0),
        };
        let fallen = since(&mut self.fallen_since, sight.fallen);
        match self.phase {
            Phase::Outside if t >= s.appears => self.phase = Phase::Bringing { since: s.appears },
            Phase::Bringing { since } => self.offer(t, since + s.arrival, sight, &felt),
            Phase::DrawingBack { since } => self.offer(t, since + (2.0 + AWAY), sight, &felt),
            Phase::Leaving { since, .. } if t > since + EMPTY_TRIP => self.phase = Phase::Gone,
            Phase::Gone if fallen >= s.picks_up_after => {
                self.cube_left_zone = false;
                self.phase = Phase::Bringing { since: t };
            }
            Phase::Gone => self.wait_for_return(t, sight, &felt),
            Phase::Coming { since, to } => {
                // A cube that is moved away now is not meant for the hand.
                if (sight.cube.p - to.p).norm() > 0.03 {
                    self.phase = Phase::Leaving { since: t, from: to };
                    self.let_go_at = t - s.return_after;
                } else if t > since + EMPTY_TRIP {
                    self.phase = Phase::Taking { since: t, from: sight.cube };
                }
            }
            Phase::Taking { from, .. } => {
                if sight.grippers == 0 {
                    self.phase = Phase::Carrying { since: t, from: sight.cube };
                } else if (sight.cube.p - from.p).norm() > 0.1 {
                    self.leave(t, sight);
                }
            }
            Phase::Carrying { since, .. } if t > since + 2.0 => self.phase = Phase::Done,
            _ => {}
        }
    }

    /// Offers the cube: lets go when jaws hold it long or firmly enough, draws it back when it is
    /// not taken. The hand has arrived at `arrived` (s).
    fn offer(&mut self, t: f64, arrived: f64, sight: &Sight, felt: &Felt) {
        let s = self.script;
        let Felt { closed, loaded, .. } = *felt;
        if closed >= s.release_time || (closed >= 0.0 && loaded >= LOAD_TIME) {
            self.leave(t, sight);
        } else if t > arrived
            && self.withdrawals_left > 0
            && sight.grippers == 0
            && t > arrived + 0.5 * s.stills
        {
            self.withdrawals_left -= 1;
            self.phase = Phase::DrawingBack { since: t };
        }
    }

    /// Lets go of the cube and leaves.
    fn leave(&mut self, t: f64, sight: &Sight) {
        self.phase = Phase::Leaving { since: t, from: sight.cube };
        self.let_go_at = t;
    }

    /// Comes for a cube that one hand holds still in the zone.
    fn wait_for_return(&mut self, t: f64, sight: &Sight, felt: &Felt) {
        let s = self.script;
        let inside = self.in_zone(&sight.cube);
        self.cube_left_zone |= !inside;
        // A hand that reached deep into the zone need not leave it again to give the cube back.
        let early = if self.cube_left_zone { 0.0 } else { HELD_OUT };
        if inside
            && t > self.let_go_at + s.return_after + early
            && sight.grippers == 1
            && felt.still >= early.max(STILL.1)
            && (sight.solved || !s.return_solved_only)
        {
            self.phase = Phase::Coming { since: t, to: sight.cube };
        }
    }

    /// The zone with a hand's width around it: a person reaches a little farther.
    fn in_zone(&self, cube: &Frame) -> bool {
        let local = Frame::from_pose(&self.zone.world_from_cube).to_local(cube).p;
        (0..3).all(|i| local[i].abs() <= self.zone.half_extent[i] + 0.05)
    }

    /// Sway and tremor at `t`, calming down after `arrival`.
    fn unrest(&self, t: f64, arrival: f64) -> Vector3<f64> {
        let calmed = minimum_jerk((t - arrival) / self.script.stills.max(0.1));
        let strength = 1.0 - (1.0 - CALM) * calmed;
        let sum = |waves: &[(f64, f64, f64)]| -> f64 {
            waves.iter().map(|(a, omega, phase)| a * libm::sin(omega * t + phase)).sum()
        };
        Vector3::from_fn(|i, _| strength * (sum(&self.sways[i]) + sum(&self.tremors[i])))
    }
}

/// 0 to 1 with the least jerk, for x in 0..1; held outside.
fn minimum_jerk(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 + x * (6.0 * x - 15.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spatial::Pose;
    use rand::SeedableRng;

    fn hand(seed: u64) -> OperatorHand {
        let zone = HandZone {
            world_from_cube: Pose::translation(0.9, 0.0, 1.2),
            half_extent: Vector3::repeat(0.05),
        };
        let mut rng = Pcg64::seed_from_u64(seed);
        OperatorHand::new(&HandScript::default(), &zone, 0.057, &mut rng)
    }

    #[test]
    fn the_hand_calms_down_to_half_a_millimetre_after_its_arrival() {
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

            assert!(calm.sqrt() < 0.5e-3 * 3_f64.sqrt(), "{}", calm.sqrt());
            assert!(moving > 4.0 * calm);
        }
    }

    /// When it comes for a cube that is held still in front of it from the beginning (s); `None` if
    /// it does not.
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
    fn it_comes_for_a_cube_that_stands_still_sooner_if_that_had_been_carried_away() {
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
        // One that was taken deep in the zone may be offered there without ever having left it.
        assert!(about(HELD_OUT, comes_for(&held, false, long_ago)));
        assert_eq!(comes_for(&Sight { speed: 0.01, ..held }, false, long_ago), None);
        assert_eq!(comes_for(&Sight { grippers: 2, ..held }, false, long_ago), None);
        assert_eq!(comes_for(&Sight { grippers: 0, ..held }, true, long_ago), None);
        // How long it stood still before it could have been meant for anybody does not count.
        assert!(about(waits, comes_for(&held, true, now)));
        assert!(about(waits + HELD_OUT, comes_for(&held, false, now)));
    }
}
