//! Inertia of a cube that one hand alone carries.
//!
//! - in: the holder and its velocity at the centre of the cube, once a period
//! - out: the inertial force on the cube, which the pads pass on to the hand and its wrist sensor
//!
//! The balance of forces on the cube has no masses. The cube follows its hand, so the acceleration
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
    /// Takes over the motion of a period of `seconds` at its end. `now` is the hand that holds the
    /// cube of `mass` (kg) alone, with its velocity at the centre of the cube (m/s).
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
    fn cube_resists_only_while_one_hand_carries_it() {
        let mut carried = Carried::default();
        let mut advance = |now: Option<(usize, f64)>| {
            let now = now.map(|(hand, speed)| (hand, Vector3::x() * speed));
            carried.advance(now, 0.1, 0.002);
            carried.force.x
        };

        assert_eq!(advance(Some((0, 1.0))), 0.0, "taken at speed");
        assert!((advance(Some((0, 1.004))) + 0.2).abs() < 1e-9, "0.1 kg at 2 m/s2");
        assert_eq!(advance(Some((1, 0.5))), 0.0, "passed on");
        assert_eq!(advance(None), 0.0, "between two hands");
        assert_eq!(advance(Some((1, 0.2))), 0.0);
    }
}
