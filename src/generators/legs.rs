//! A motion of joints in legs that overlap: a leg may begin while the previous one still moves.
//!
//! - in: the ends of the legs, and their windows: shares of the time of the motion
//! - out: the joint positions after a share of that time
//! - The joints are displaced by the sum of all legs, each by the share that [`Profile`] gives it
//!   in its window. Windows and ramps are shares of the whole time, so a slower motion follows the
//!   same path, and so do two arms with the same windows.
//! - The roll of the tool brings no part of an arm nearer to anything, so it takes the whole time
//!   for the sum of its legs.

use super::profile::Profile;
use crate::motion::{AXES, JointPositions, ROLL};
use serde::{Deserialize, Serialize};

/// Number of legs of a motion.
const LEGS: usize = 3;

/// One leg of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Leg {
    /// Joint positions at the end of the leg.
    pub to: JointPositions,
    /// Shares of the time of the motion at which the leg begins and ends, 0..=1.
    pub window: (f64, f64),
}

/// All legs of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Legs {
    /// Legs in the order in which they begin.
    pub legs: [Leg; LEGS],
    /// Course of each leg. The ramp is a share of the whole time.
    pub profile: Profile,
    /// Course of the tool's roll.
    pub roll: Profile,
}

impl Legs {
    /// Returns the joint positions after the share `part` of the time (0..=1), in a motion that
    /// begins at `start`.
    #[must_use]
    pub fn at(&self, start: &JointPositions, part: f64) -> JointPositions {
        self.displaced(start, &self.moves(start), part)
    }

    /// Returns by how much each leg displaces the joints of a motion that begins at `start` (m,
    /// rad).
    fn moves(&self, start: &JointPositions) -> [[f64; AXES]; LEGS] {
        let mut last = start;
        self.legs.each_ref().map(|leg| {
            let from = std::mem::replace(&mut last, &leg.to);
            std::array::from_fn(|axis| leg.to.0[axis] - from.0[axis])
        })
    }

    /// Returns the joint positions after the share `part` of the time (0..=1), from the
    /// displacements that [`Legs::moves`] returns (m, rad).
    fn displaced(
        &self,
        start: &JointPositions,
        moves: &[[f64; AXES]; LEGS],
        part: f64,
    ) -> JointPositions {
        // The legs are added up, so that overlapping ones blend.
        let mut at = *start;
        let roll = self.roll.share(part, 1.0);
        for (Leg { window: (begins, ends), .. }, by) in self.legs.iter().zip(moves) {
            let lasts = ends - begins;
            let own = if lasts > 0.0 { ((part - begins) / lasts).clamp(0.0, 1.0) } else { 1.0 };
            // All axes of a leg move evenly, except the roll.
            let mut shares = [self.profile.share(own, lasts); AXES];
            shares[ROLL] = roll;
            for axis in 0..AXES {
                at.0[axis] += shares[axis] * by[axis];
            }
        }
        at
    }

    /// Returns the joint positions at the end of the motion.
    #[must_use]
    pub fn end(&self) -> &JointPositions {
        &self.legs[LEGS - 1].to
    }

    /// Returns the shortest time in which a motion from `start` keeps the limits of each joint (s):
    /// speeds (m/s, rad/s) and accelerations (m/s2, rad/s2).
    #[must_use]
    pub fn seconds(
        &self,
        start: &JointPositions,
        speeds: &[f64; AXES],
        accelerations: &[f64; AXES],
    ) -> f64 {
        let step = 1.0 / f64::from(MOMENTS);
        let moves = self.moves(start);
        let at = |moment: u32| self.displaced(start, &moves, f64::from(moment) * step);
        let (mut before, mut now) = (*start, at(1));
        // Each limit divides one number per axis, the greatest of all moments, because the search
        // of paths computes this time for each candidate.
        let (mut fastest, mut steepest) = ([0.0_f64; AXES], [0.0_f64; AXES]);
        for moment in 2..=MOMENTS + 1 {
            // The motion is at rest after its end, so the last moment is repeated.
            let next = at(moment.min(MOMENTS));
            for i in 0..AXES {
                fastest[i] = fastest[i].max((now.0[i] - before.0[i]).abs());
                let bend = (next.0[i] - 2.0 * now.0[i] + before.0[i]).abs();
                steepest[i] = steepest[i].max(bend);
            }
            (before, now) = (now, next);
        }
        (0..AXES).fold(0.0, |seconds: f64, i| {
            // Speeds fall with the time of the motion, accelerations with its square.
            let by_speed = fastest[i] / step / speeds[i];
            let by_acceleration = steepest[i] / (step * step) / accelerations[i];
            seconds.max(by_speed).max(by_acceleration.sqrt())
        })
    }
}

/// Number of moments at which the speeds of a motion are computed.
const MOMENTS: u32 = 80;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns joint positions of the track (m) and of joint 1 (rad), the others at 0.
    fn to(track: f64, joint: f64) -> JointPositions {
        JointPositions([track, joint, 0.0, 0.0, 0.0, 0.0, 0.0])
    }

    /// Makes three legs: the track retracts, joint 1 moves, the track advances. The second leg
    /// overlaps each of the others by the share `overlap` of the time.
    fn legs(overlap: f64) -> Legs {
        let leg = |to, window| Leg { to, window };
        Legs {
            legs: [
                leg(to(-0.2, 0.0), (0.0, 0.3)),
                leg(to(-0.2, 1.0), (0.3 - overlap, 0.7 + overlap)),
                leg(to(0.0, 1.0), (0.7, 1.0)),
            ],
            profile: Profile { ramp: 0.1 },
            roll: Profile { ramp: 0.1 },
        }
    }

    #[test]
    fn legs_without_overlap_run_in_sequence() {
        let (legs, start) = (legs(0.0), to(0.0, 0.0));

        assert_eq!(legs.at(&start, 0.0), start);
        assert!((legs.at(&start, 0.3).0[0] + 0.2).abs() < 1e-12);
        assert!(legs.at(&start, 0.3).0[1].abs() < 1e-12);
        assert!((legs.at(&start, 0.5).0[1] - 0.5).abs() < 1e-12);
        assert_eq!(legs.at(&start, 1.0), *legs.end());
    }

    /// Computes the time of [`Legs::seconds`] in the plain way: the share of its limit that each
    /// joint uses at each moment, and the largest of all.
    fn plain_seconds(legs: &Legs, start: &JointPositions, limits: &[[f64; AXES]; 2]) -> f64 {
        let step = 1.0 / f64::from(MOMENTS);
        let at = |moment: u32| legs.at(start, f64::from(moment.min(MOMENTS)) * step).0;
        let mut most = [0.0_f64; 2];
        for moment in 2..=MOMENTS + 1 {
            let before = if moment == 2 { start.0 } else { at(moment - 2) };
            let (now, next) = (at(moment - 1), at(moment));
            for i in 0..AXES {
                let speed = (now[i] - before[i]).abs() / step;
                let acceleration = (next[i] - 2.0 * now[i] + before[i]).abs() / (step * step);
                most[0] = most[0].max(speed / limits[0][i]);
                most[1] = most[1].max(acceleration / limits[1][i]);
            }
        }
        most[0].max(most[1].sqrt())
    }

    proptest! {
        #[test]
        fn optimised_path_time_equals_plain_computation_exactly(
            overlap in 0.0..0.3f64,
            start in prop::array::uniform7(-1.0..1.0f64),
            limits in prop::array::uniform2(prop::array::uniform7(0.1..3.0f64)),
        ) {
            let (legs, start) = (legs(overlap), JointPositions(start));

            let seconds = legs.seconds(&start, &limits[0], &limits[1]);

            prop_assert_eq!(seconds.to_bits(), plain_seconds(&legs, &start, &limits).to_bits());
        }

        #[test]
        fn shortest_path_time_reaches_speed_or_acceleration_limit(
            overlap in 0.0..0.3f64,
            limit in 0.1..2.0f64,
        ) {
            let (legs, start) = (legs(overlap), to(0.0, 0.0));
            let (speeds, accelerations) = ([limit; AXES], [2.0 * limit; AXES]);
            let seconds = legs.seconds(&start, &speeds, &accelerations);
            let step = 1e-3;
            let mut fullest = 0.0_f64;
            for moment in 1..1000 {
                let at = |by: i32| legs.at(&start, f64::from(moment + by) * step);
                for i in 0..AXES {
                    let speed = (at(1).0[i] - at(-1).0[i]).abs() / (2.0 * step * seconds);
                    let change = at(1).0[i] - 2.0 * at(0).0[i] + at(-1).0[i];
                    let acceleration = change.abs() / (step * seconds).powi(2);
                    fullest = fullest.max(speed / speeds[i]).max(acceleration / accelerations[i]);
                }
            }
            // The peaks lie between the moments at which speeds are computed.
            prop_assert!((0.9..1.1).contains(&fullest), "{fullest}");
        }
    }
}
