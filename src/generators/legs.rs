//! A motion of joints in legs, of which the next one begins before the last has ended.
//!
//! - in: where the legs end, and their windows of the whole time
//! - out: the joint positions after a share of that time
//! - the joints are displaced by the sum of all legs, each by the share that [`Profile`] gives it
//!   in its window. Windows and ramps are shares of the whole time: a motion that takes longer goes
//!   the same way, and so do two arms with the same windows
//! - the tool's roll, which brings no part of an arm nearer to anything, has the whole time for the
//!   sum of its legs

use super::profile::Profile;
use crate::motion::{AXES, JointPositions, ROLL};
use serde::{Deserialize, Serialize};

/// Legs of a motion.
const LEGS: usize = 3;

/// One leg.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Leg {
    /// Where it ends.
    pub to: JointPositions,
    /// The shares of the whole time at which it begins and ends, 0..=1.
    pub window: (f64, f64),
}

/// All legs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Legs {
    /// In turn.
    pub legs: [Leg; LEGS],
    /// How legs begin and end: the ramp is a share of the whole time.
    pub profile: Profile,
    /// How the tool's roll does.
    pub roll: Profile,
}

impl Legs {
    /// Returns the joint positions after a share of the time of a motion that begins at `start`.
    #[must_use]
    pub fn at(&self, start: &JointPositions, part: f64) -> JointPositions {
        let (mut at, mut last) = (*start, start);
        let roll = self.roll.share(part, 1.0);
        for Leg { to, window: (begins, ends) } in &self.legs {
            let lasts = ends - begins;
            let own = if lasts > 0.0 { ((part - begins) / lasts).clamp(0.0, 1.0) } else { 1.0 };
            let share = self.profile.share(own, lasts);
            for (axis, (to, last)) in to.0.iter().zip(last.0).enumerate() {
                at.0[axis] += if axis == ROLL { roll } else { share } * (to - last);
            }
            last = to;
        }
        at
    }

    /// Returns where the motion ends.
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
        let at = |moment: u32| self.at(start, f64::from(moment) * step);
        let (mut before, mut now) = (*start, at(1));
        let (mut fastest, mut steepest) = (0.0_f64, 0.0_f64);
        for moment in 2..=MOMENTS + 1 {
            let next = at(moment.min(MOMENTS));
            for i in 0..AXES {
                let speed = (now.0[i] - before.0[i]).abs() / step;
                let acceleration = (next.0[i] - 2.0 * now.0[i] + before.0[i]).abs() / (step * step);
                fastest = fastest.max(speed / speeds[i]);
                steepest = steepest.max(acceleration / accelerations[i]);
            }
            (before, now) = (now, next);
        }
        fastest.max(steepest.sqrt())
    }
}

/// Moments at which the speeds of a motion are looked at.
const MOMENTS: u32 = 80;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn to(track: f64, joint: f64) -> JointPositions {
        JointPositions([track, joint, 0.0, 0.0, 0.0, 0.0, 0.0])
    }

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
    fn legs_without_overlap_are_gone_in_turn() {
        let (legs, start) = (legs(0.0), to(0.0, 0.0));

        assert_eq!(legs.at(&start, 0.0), start);
        assert!((legs.at(&start, 0.3).0[0] + 0.2).abs() < 1e-12);
        assert!(legs.at(&start, 0.3).0[1].abs() < 1e-12);
        assert!((legs.at(&start, 0.5).0[1] - 0.5).abs() < 1e-12);
        assert_eq!(legs.at(&start, 1.0), *legs.end());
    }

    proptest! {
        #[test]
        fn shortest_time_needs_all_of_a_limit(overlap in 0.0..0.3f64, limit in 0.1..2.0f64) {
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
            // The moments that are looked at miss the very peaks.
            prop_assert!((0.9..1.1).contains(&fullest), "{fullest}");
        }
    }
}
