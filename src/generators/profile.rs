//! The course of a motion over its time: the share of its distance that is done, with bounded jerk.
//!
//! A short motion is a minimum-jerk motion, `s(u) = 10u^3 - 15u^4 + 6u^5` (Flash and Hogan 1985). A
//! long one rises to its full speed as the first half of a minimum-jerk motion does, keeps it, and
//! falls as the second half does. These ramps take the same time in all motions, so the shape
//! depends on the duration alone. Two arms, or all axes of one, that begin and end together have
//! therefore done the same share of any distance at each moment.
//!
//! - in: the duration of a motion, or its distance with the greatest speed and acceleration
//! - out: the share of the distance that is done; the shortest duration
//! - equations: with a duration T and ramps of r the greatest speed is `1 / (T - 14 r / 15)` of the
//!   distance, the greatest acceleration 1.54 times that over r; with r = T / 2 they are 1.875 / T
//!   and 5.774 / T^2

use serde::{Deserialize, Serialize};

/// Greatest speed and acceleration of a minimum-jerk motion, as multiples of its mean speed and of
/// its distance over the square of its time.
const PEAK_SPEED: f64 = 1.875;
const PEAK_ACCELERATION: f64 = 5.774;
/// Greatest acceleration of a ramp, as a multiple of its mean.
const STEEPEST: f64 = 0.5 * PEAK_ACCELERATION / PEAK_SPEED;
/// Time that a ramp loses against a motion at full speed, as a share of the ramp's time.
const LOST: f64 = 7.0 / 15.0;

/// Family of motion profiles whose ramps take the same time.
///
/// ```
/// use rubik_robot::generators::profile::Profile;
///
/// let profile = Profile { ramp: 0.35 };
/// // Half of the time is half of the distance, and the motion begins and ends at rest.
/// assert!((profile.share(0.5, 2.0) - 0.5).abs() < 1e-12);
/// assert!(profile.share(0.01, 2.0) < 1e-3 && profile.share(0.99, 2.0) > 0.999);
/// // 1.2 m at 0.3 m/s and 2 m/s2 take the time at full speed and a part of both ramps.
/// let seconds = profile.seconds(1.2, 0.3, 2.0);
/// assert!(seconds > 4.0 && seconds < 4.0 + 2.0 * profile.ramp);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// Time of a ramp (s).
    pub ramp: f64,
}

impl Profile {
    /// Returns the share of its distance, 0..=1, that a motion of `duration` (s) has covered after
    /// the share `part` of its time (0..=1).
    #[must_use]
    pub fn share(&self, part: f64, duration: f64) -> f64 {
        if duration <= 2.0 * self.ramp {
            return minimum_jerk(part);
        }
        let (time, speed) = (part * duration, 1.0 / (duration - 2.0 * LOST * self.ramp));
        // The second half is the first half backwards.
        let near = time.min(duration - time).max(0.0);
        let done = if near < self.ramp {
            // A minimum-jerk motion over two ramps does this share of `2 r / 1.875` at full speed.
            minimum_jerk(0.5 * near / self.ramp) * 2.0 * self.ramp / PEAK_SPEED
        } else {
            near - LOST * self.ramp
        };
        if 2.0 * time > duration { 1.0 - speed * done } else { speed * done }
    }

    /// Returns the shortest duration (s) in which a motion covers `distance` (m, rad) within the
    /// limits `speed` and `acceleration`.
    #[must_use]
    pub fn seconds(&self, distance: f64, speed: f64, acceleration: f64) -> f64 {
        let by_speed = PEAK_SPEED * distance.abs() / speed;
        let by_acceleration = (PEAK_ACCELERATION * distance.abs() / acceleration).sqrt();
        let short = by_speed.max(by_acceleration);
        // A motion with two complete ramps takes at least their time.
        if short <= 2.0 * self.ramp {
            return short;
        }
        let ramp = self.ramp;
        2.0 * LOST * ramp
            + (distance.abs() / speed).max(STEEPEST * distance.abs() / (acceleration * ramp))
    }

    /// Returns the share of the limits that a motion needs to cover `distance` (m, rad) in
    /// `duration` (s): the larger one of the shares of `speed` and `acceleration`.
    #[must_use]
    pub fn fraction(&self, distance: f64, speed: f64, acceleration: f64, duration: f64) -> f64 {
        if duration <= 2.0 * self.ramp {
            let by_speed = PEAK_SPEED * distance.abs() / (speed * duration);
            let by_acceleration = PEAK_ACCELERATION * distance.abs();
            return by_speed.max(by_acceleration / (acceleration * duration * duration));
        }
        // The full speed covers the distance in the duration less the time that both ramps lose.
        let fastest = distance.abs() / (duration - 2.0 * LOST * self.ramp);
        (fastest / speed).max(STEEPEST * fastest / (acceleration * self.ramp))
    }
}

/// Returns the share of its distance that a minimum-jerk motion has covered after the share `u` of
/// its time.
fn minimum_jerk(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * u * (10.0 + u * (6.0 * u - 15.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn short_motion_follows_minimum_jerk_profile() {
        for part in [0.0_f64, 0.1, 0.5, 0.9, 1.0] {
            let wanted = 10.0 * part.powi(3) - 15.0 * part.powi(4) + 6.0 * part.powi(5);
            let share = Profile { ramp: 0.35 }.share(part, 0.7);
            assert!((share - wanted).abs() < 1e-12, "{part}: {share}");
            // A motion that is slightly longer has almost the same course.
            let longer = Profile { ramp: 0.35 }.share(part, 0.7001);
            assert!((longer - wanted).abs() < 1e-3, "{part}: {longer}");
        }
    }

    proptest! {
        #[test]
        fn profile_keeps_speed_acceleration_and_jerk_bounds(
            ramp in 0.05..1.0f64,
            duration in 0.02..20.0f64,
        ) {
            let profile = Profile { ramp };
            let r = ramp.min(0.5 * duration);
            let peak = 1.0 / (duration - 2.0 * LOST * r);
            let h = duration * 1e-3;
            let at = |k: i32| profile.share(f64::from(k) * 1e-3, duration);
            prop_assert_eq!(at(0), 0.0);
            prop_assert!((at(1000) - 1.0).abs() < 1e-12);
            for k in 1..1000 {
                let speed = (at(k + 1) - at(k - 1)) / (2.0 * h);
                let acceleration = (at(k + 1) - 2.0 * at(k) + at(k - 1)) / (h * h);
                prop_assert!(speed >= -1e-9 && speed <= peak * (1.0 + 1e-9));
                // Second differences of numbers near 1 are wrong by 4e-16 / h^2.
                let bound = STEEPEST * peak / r * (1.0 + 1e-3) + 1e-15 / (h * h);
                prop_assert!(acceleration.abs() <= bound, "{} {}", acceleration, bound);
                if k > 1 && k < 999 {
                    let jerk = (at(k + 2) - 2.0 * at(k + 1) + 2.0 * at(k - 1) - at(k - 2))
                        / (2.0 * h * h * h);
                    // The speed of a ramp, x^2 (2 - x)^2, has the second derivative 8 at x = 0.
                    let bound = 8.0 * peak / (r * r) * 1.01 + 2e-15 / (h * h * h);
                    prop_assert!(jerk.abs() <= bound, "{} {}", jerk, bound);
                }
            }
        }

        #[test]
        fn shortest_duration_reaches_speed_or_acceleration_limit(
            ramp in 0.05..5.0f64,
            distance in 1e-4..10.0f64,
            speed in 0.01..5.0f64,
            acceleration in 0.05..20.0f64,
        ) {
            let profile = Profile { ramp };
            let duration = profile.seconds(distance, speed, acceleration);
            let fraction = profile.fraction(distance, speed, acceleration, duration);
            prop_assert!((fraction - 1.0).abs() < 1e-9, "{}", fraction);
            let longer = profile.fraction(distance, speed, acceleration, 1.1 * duration);
            prop_assert!(longer < fraction);
            // The course itself reaches one of the limits in its first ramp, and exceeds none.
            let h = ramp.min(0.5 * duration) * 1e-3;
            let at = |k: u32| distance * profile.share(f64::from(k) * h / duration, duration);
            let shares = (1..=1000).map(|k| {
                let fast = (at(k + 1) - at(k - 1)) / (2.0 * h * speed);
                let steep = (at(k + 1) - 2.0 * at(k) + at(k - 1)) / (h * h * acceleration);
                fast.max(steep)
            });
            let fullest = shares.fold(0.0, f64::max);
            prop_assert!((fullest - 1.0).abs() < 2e-3, "{}", fullest);
        }
    }
}
