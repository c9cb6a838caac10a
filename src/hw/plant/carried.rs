//! Inertia of a cube that one hand alone carries.
//!
//! - in: the holder and its velocity at the centre of the cube, once a period
//! - out: the inertial force on the cube, which the pads pass on to the hand and its wrist sensor
//!
//! The balance of forces on the cube has no masses. The cube follows its hand, so its acceleration
//! is that of the hand, as the mean of the last period: the cube's own place is too coarse for
//! differences. Between two hands the cube hardly accelerates, and there its inertia is left out.
//! Its rotation is left out everywhere: less than 1 mNm.

use nalgebra::Vector3;

/// Motion of the carried cube, from which its inertial force follows.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Carried {
    /// The hand that held the cube alone at the end of the last period, and its velocity there
    /// (m/s).
    last: Option<(usize, Vector3<f64>)>,
    /// Inertial force on the cube (N), in the world.
    pub(super) force: Vector3<f64>,
}

impl Carried {
    /// Computes the inertial force at the end of a period of `seconds`. `now` is the hand that
    /// alone holds the cube of `mass` (kg), with its velocity at the centre of the cube (m/s);
    /// `None` is no hand, or both.
    pub(super) fn advance(&mut self, now: Option<(usize, Vector3<f64>)>, mass: f64, seconds: f64) {
        self.force = match (self.last, now) {
            (Some((before, last)), Some((hand, velocity))) if before == hand => {
                (last - velocity) * (mass / seconds)
            }
            // A cube that was just taken has no acceleration yet.
            _ => Vector3::zeros(),
        };
        self.last = now;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inertia_acts_while_one_hand_carries_cube() {
        let mut carried = Carried::default();
        let mut advance = |now: Option<(usize, f64)>| {
            let now = now.map(|(hand, speed)| (hand, Vector3::x() * speed));
            carried.advance(now, 0.1, 0.002);
            carried.force.x
        };

        assert_eq!(advance(Some((0, 1.0))), 0.0, "a cube just taken has no inertia yet");
        assert!((advance(Some((0, 1.004))) + 0.2).abs() < 1e-9, "0.1 kg at 2 m/s2");
        assert_eq!(advance(Some((1, 0.5))), 0.0, "passed to the other hand");
        assert_eq!(advance(None), 0.0, "between two hands");
        assert_eq!(advance(Some((1, 0.2))), 0.0);
    }
}
