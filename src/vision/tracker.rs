//! Tracker of the cube over time: a constant-velocity Kalman filter with gates.
//!
//! The track is the filtered state of the cube. Its centre moves at a velocity that changes slowly.
//! Its orientation is a random walk, whose error is a small rotation. Gates reject measurements
//! whose centre or orientation is too far from the prediction. Two poses fit a single face. Their
//! centres are nearly the same, so only the orientation shows that a measurement is the wrong one.
//!
//! | case | threshold (default) | reason |
//! |---|---|---|
//! | outlier | `gate`: 4.5 deviations | rejects the wrong pose of a single face |
//! | cube has jumped | `patience`: 3 outliers in a row | outliers are single measurements |
//! | track is lost | `lost_after`: 1 s | a hand may be anywhere by then |
//! | measurement is old | not newer than the last one | no picture may count twice |
//!
//! - in: measured poses with their time and covariance, in one fixed frame (of the world, or of a
//!   fixed camera)
//! - out: predicted pose, velocity, covariance, the window to search, the age of the last
//!   measurement
//! - source: Kalman (1960) with white-noise acceleration; Bar-Shalom et al. (2001), ch. 6; rotation
//!   errors as in Markley, "Attitude error representations for Kalman filtering" (2003)

use super::Rect;
use super::detect::window_around;
use super::pose::nearest_of_24;
use crate::cell::Intrinsics;
use crate::spatial::Pose;
use nalgebra::{
    Matrix3, Matrix3x6, Matrix6, Point3, Translation3, UnitQuaternion, Vector3, Vector6,
};

/// Settings of the tracker: a model of the motion, and its gates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackerSettings {
    /// Spectral density of the acceleration noise (m^2/s^3). A hand that starts and stops at 0.2
    /// m/s within 0.3 s has about 0.1.
    pub acceleration: f64,
    /// Spectral density of the rotation as a random walk (rad^2/s). The default, 0.01, is that of a
    /// hand which unintentionally turns the cube by 0.1 rad in a second.
    pub turning: f64,
    /// Greatest distance of an accepted measurement from its prediction, in standard deviations of
    /// the centre or of the orientation.
    pub gate: f64,
    /// Number of outliers in a row at which the track restarts.
    pub patience: u32,
    /// Age of the last accepted measurement above which the track is lost (s).
    pub lost_after: f64,
}

impl Default for TrackerSettings {
    fn default() -> Self {
        Self { acceleration: 0.05, turning: 0.01, gate: 4.5, patience: 3, lost_after: 1.0 }
    }
}

/// Result of a measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Update {
    /// The track starts with the measurement, or restarts after too many rejected ones.
    Started,
    /// The measurement is accepted. The value is its distance from the prediction in standard
    /// deviations, of the centre or of the orientation, whichever is larger.
    Accepted(f64),
    /// The measurement is rejected. The value is its distance as in [`Update::Accepted`].
    Gated(f64),
    /// The measurement is not newer than an earlier one. It is ignored, so that no picture counts
    /// twice.
    Old,
}

/// Predicted state of the cube at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// Predicted pose of the cube in the fixed frame. The orientation is the filtered one, without
    /// a rotation since the last measurement.
    pub pose: Pose,
    /// Velocity of the centre (m/s).
    pub velocity: Vector3<f64>,
    /// Covariance of the centre (m^2).
    pub covariance: Matrix3<f64>,
    /// Covariance of the velocity (m^2/s^2).
    pub velocity_covariance: Matrix3<f64>,
    /// Time since the last accepted measurement (s).
    pub age: f64,
}

impl Prediction {
    /// Returns the speed of the centre (m/s).
    #[must_use]
    pub fn speed(&self) -> f64 {
        self.velocity.norm()
    }
}

/// Tracker of one cube.
///
/// ```
/// use nalgebra::Matrix6;
/// use rubik_robot_vision::spatial::Pose;
/// use rubik_robot_vision::{Tracker, TrackerSettings};
///
/// // A hand moves the cube at 50 mm/s along x; the camera measures it every 40 ms.
/// let mut tracker = Tracker::new(TrackerSettings::default());
/// let spread = Matrix6::identity() * 1e-7;
/// for picture in 0..25 {
///     let time = 0.04 * f64::from(picture);
///     tracker.update(time, &Pose::translation(0.05 * time, 0.0, 0.7), &spread);
/// }
/// let soon = tracker.predict(1.0).ok_or("lost")?;
/// assert!((soon.speed() - 0.05).abs() < 0.005);
/// assert!((soon.pose.translation.x - 0.05).abs() < 1e-3);
/// // After a second without a measurement the hand may be anywhere.
/// assert!(tracker.predict(2.0).is_none());
/// # Ok::<(), &str>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Tracker {
    settings: TrackerSettings,
    /// State of the filter; `None` before the first measurement.
    track: Option<Track>,
    /// Number of rejected measurements in a row.
    refused: u32,
    /// Time of the newest measurement, accepted or not (s).
    newest: f64,
}

/// State of the filter.
#[derive(Debug, Clone, PartialEq)]
struct Track {
    /// Time of the state (s).
    time: f64,
    /// Time of the last accepted measurement (s).
    measured: f64,
    /// Centre (m) and its velocity (m/s).
    state: Vector6<f64>,
    /// Covariance of `state`.
    covariance: Matrix6<f64>,
    /// Orientation of the cube in the fixed frame.
    orientation: UnitQuaternion<f64>,
    /// Covariance of the orientation's error, a small rotation in the axes of the fixed frame
    /// (rad^2).
    turn_covariance: Matrix3<f64>,
}

/// Standard deviation of the unknown velocity of a new track (m/s).
const STARTING_SPEED: f64 = 0.3;

impl Tracker {
    /// Makes a tracker without a track.
    #[must_use]
    pub fn new(settings: TrackerSettings) -> Self {
        Self { settings, track: None, refused: 0, newest: f64::NEG_INFINITY }
    }

    /// Forgets the track.
    pub fn reset(&mut self) {
        *self = Self::new(self.settings);
    }

    /// Updates the track with the pose of the cube that was measured at `time` (s), in a fixed
    /// frame: that of the world or of a fixed camera. `spread` is the covariance of the error of
    /// `measured` in the axes of this frame: of the centre (m), then of the rotation about it
    /// (rad).
    pub fn update(&mut self, time: f64, measured: &Pose, spread: &Matrix6<f64>) -> Update {
        if time <= self.newest {
            return Update::Old;
        }
        self.newest = time;
        let lost = self.track.as_ref().is_none_or(|t| time - t.measured > self.settings.lost_after);
        let (Some(track), false) = (&mut self.track, lost) else {
            return self.start(time, measured, spread);
        };
        let (place_spread, turn_spread) = parts(spread);
        // The centre and the orientation have a filter each. The track changes only if both pass
        // their gates.
        let (state, covariance) = track.at(time, self.settings.acceleration);
        let walked = self.settings.turning * (time - track.time);
        let turn_covariance = track.turn_covariance + Matrix3::identity() * walked;
        let innovation: Vector3<f64> =
            measured.translation.vector - state.fixed_rows::<3>(0).into_owned();
        // A cube looks the same in 24 orientations, of which the one nearest to the track is taken.
        let relative = track.orientation.inverse() * measured.rotation;
        let named_alike = measured.rotation * nearest_of_24(&relative).inverse();
        let turn = (named_alike * track.orientation.inverse()).scaled_axis();
        let innovation_covariance: Matrix3<f64> =
            covariance.fixed_view::<3, 3>(0, 0).into_owned() + place_spread;
        let (Some(factor), Some(turn_factor)) =
            (innovation_covariance.cholesky(), (turn_covariance + turn_spread).cholesky())
        else {
            return Update::Gated(f64::INFINITY);
        };
        // Mahalanobis distances: an innovation d with the covariance S has d^T S^-1 d.
        let place_distance = innovation.dot(&factor.solve(&innovation)).sqrt();
        let distance = place_distance.max(turn.dot(&turn_factor.solve(&turn)).sqrt());
        if !distance.is_finite() || distance > self.settings.gate {
            self.refused += 1;
            // Outliers are single measurements, so several in a row mean that the cube has jumped.
            // An infinite distance is a broken measurement and starts no track.
            if self.refused >= self.settings.patience && distance.is_finite() {
                return self.start(time, measured, spread);
            }
            return Update::Gated(distance);
        }
        self.refused = 0;
        // The gain of the centre's filter is P H^T S^-1 with H = [1 0].
        let pht = covariance.fixed_view::<6, 3>(0, 0).into_owned();
        let gain = factor.solve(&pht.transpose()).transpose();
        let mut h = Matrix3x6::zeros();
        h.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        let keep = Matrix6::identity() - gain * h;
        track.state = state + gain * innovation;
        // Joseph's form of the covariance stays positive for any gain.
        track.covariance =
            keep * covariance * keep.transpose() + gain * place_spread * gain.transpose();
        // The orientation has the gain P S^-1, because its error is measured directly (H = 1).
        let gain = turn_factor.solve(&turn_covariance).transpose();
        let keep = Matrix3::identity() - gain;
        track.orientation = UnitQuaternion::from_scaled_axis(gain * turn) * track.orientation;
        track.turn_covariance =
            keep * turn_covariance * keep.transpose() + gain * turn_spread * gain.transpose();
        (track.time, track.measured) = (time, time);
        Update::Accepted(distance)
    }

    /// Starts a track at a measurement, with an unknown velocity.
    fn start(&mut self, time: f64, measured: &Pose, spread: &Matrix6<f64>) -> Update {
        let (place_spread, turn_covariance) = parts(spread);
        let mut state = Vector6::zeros();
        state.fixed_rows_mut::<3>(0).copy_from(&measured.translation.vector);
        let mut covariance = Matrix6::identity() * STARTING_SPEED.powi(2);
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&place_spread);
        // Among the 24 orientations a restarted track takes the one nearest to its last, so that
        // the cube's axes do not jump.
        let orientation = self.track.as_ref().map_or(measured.rotation, |old| {
            let relative = old.orientation.inverse() * measured.rotation;
            measured.rotation * nearest_of_24(&relative).inverse()
        });
        self.track =
            Some(Track { time, measured: time, state, covariance, orientation, turn_covariance });
        self.refused = 0;
        Update::Started
    }

    /// Predicts the pose and the velocity of the cube at `time` (s). Returns `None` without a
    /// track, or if the track is lost.
    #[must_use]
    pub fn predict(&self, time: f64) -> Option<Prediction> {
        let track = self.track.as_ref()?;
        let age = (time - track.measured).max(0.0);
        if age > self.settings.lost_after {
            return None;
        }
        let (state, covariance) = track.at(time, self.settings.acceleration);
        Some(Prediction {
            pose: Pose::from_parts(
                Translation3::from(state.fixed_rows::<3>(0).into_owned()),
                track.orientation,
            ),
            velocity: state.fixed_rows::<3>(3).into_owned(),
            covariance: covariance.fixed_view::<3, 3>(0, 0).into_owned(),
            velocity_covariance: covariance.fixed_view::<3, 3>(3, 3).into_owned(),
            age,
        })
    }

    /// Returns the time from the last accepted measurement to `time` (s), which is infinite without
    /// one.
    #[must_use]
    pub fn age(&self, time: f64) -> f64 {
        self.track.as_ref().map_or(f64::INFINITY, |t| (time - t.measured).max(0.0))
    }

    /// Returns the part of the image to search for the cube at `time` (s): it contains the cube's
    /// corners with a margin of three standard deviations and a sixth of the cube. `edge` is the
    /// edge of the cube (m). Returns `None` without a track, or if the cube is outside the picture
    /// or not in front of the camera.
    #[must_use]
    pub fn window(
        &self,
        time: f64,
        camera_from_frame: &Pose,
        camera: &Intrinsics,
        edge: f64,
    ) -> Option<Rect> {
        let prediction = self.predict(time)?;
        let camera_from_cube = camera_from_frame * prediction.pose;
        let half = 0.5 * edge;
        let spread = 3.0 * prediction.covariance.diagonal().max().sqrt();
        let mut corners = Vec::with_capacity(16);
        for i in 0..8 {
            let sign = |bit: usize| if i & bit == 0 { -half } else { half };
            let corner = camera_from_cube * Point3::new(sign(1), sign(2), sign(4));
            if corner.z < 0.02 {
                return None;
            }
            // The axes of the frame are not those of the camera, so the largest deviation along any
            // axis is taken in both directions of the picture.
            for s in [-spread, spread] {
                corners.push(camera.project(&Point3::new(corner.x + s, corner.y + s, corner.z)));
            }
        }
        window_around(&corners, 1.0 / 6.0)?.inside(camera.width, camera.height)
    }
}

/// Splits a covariance of a pose into that of the place (m^2) and that of the rotation (rad^2).
fn parts(spread: &Matrix6<f64>) -> (Matrix3<f64>, Matrix3<f64>) {
    (spread.fixed_view::<3, 3>(0, 0).into_owned(), spread.fixed_view::<3, 3>(3, 3).into_owned())
}

impl Track {
    /// Extrapolates state and covariance to a later `time` (s). `acceleration` is the spectral
    /// density of the acceleration noise (m^2/s^3).
    fn at(&self, time: f64, acceleration: f64) -> (Vector6<f64>, Matrix6<f64>) {
        let dt = (time - self.time).max(0.0);
        // White noise of the acceleration with the density q adds q dt^3/3 to the variance of the
        // place, q dt to that of the velocity, and q dt^2/2 to the covariance of the two.
        let mut step = Matrix6::identity();
        let mut noise = Matrix6::zeros();
        for i in 0..3 {
            step[(i, i + 3)] = dt;
            noise[(i, i)] = acceleration * dt.powi(3) / 3.0;
            noise[(i, i + 3)] = acceleration * dt.powi(2) / 2.0;
            noise[(i + 3, i)] = noise[(i, i + 3)];
            noise[(i + 3, i + 3)] = acceleration * dt;
        }
        (step * self.state, step * self.covariance * step.transpose() + noise)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    /// Returns a pose with this x and z (m) and without rotation.
    fn at(x: f64, z: f64) -> Pose {
        Pose::translation(x, 0.1, z)
    }

    /// Returns the covariance of a good measurement.
    fn spread() -> Matrix6<f64> {
        let deviations = Vector6::new(2e-4, 2e-4, 1e-3, 0.01, 0.01, 0.003);
        Matrix6::from_diagonal(&deviations.map(|s: f64| s * s))
    }

    #[test]
    fn tracker_estimates_velocity_within_one_second() {
        let mut tracker = Tracker::new(TrackerSettings::default());
        let mut random = Pcg64::seed_from_u64(1);
        for i in 0..25 {
            let t = 0.04 * f64::from(i);
            let noise = random.random_range(-3e-4..3e-4);

            tracker.update(t, &at(0.05 * t + noise, 0.7), &spread());
        }

        let now = tracker.predict(0.96).unwrap();
        assert!((now.velocity.x - 0.05).abs() < 0.008, "{}", now.velocity);
        assert!((now.pose.translation.x - 0.048).abs() < 5e-4);
        assert_eq!(now.age, 0.0);
    }

    /// A single outlier is gated, but a jump that lasts restarts the track.
    #[test]
    fn outlier_is_gated_but_lasting_jump_followed() {
        let mut tracker = Tracker::new(TrackerSettings::default());
        for i in 0..10 {
            tracker.update(0.04 * f64::from(i), &at(0.0, 0.7), &spread());
        }

        assert!(matches!(tracker.update(0.40, &at(0.3, 0.7), &spread()), Update::Gated(_)));
        assert!(matches!(tracker.update(0.44, &at(0.0, 0.7), &spread()), Update::Accepted(_)));
        for (t, expected) in [(0.48, false), (0.52, false), (0.56, true)] {
            let update = tracker.update(t, &at(0.3, 0.7), &spread());
            assert_eq!(update == Update::Started, expected, "{t}");
        }
    }

    #[test]
    fn age_counts_from_measurement_and_stale_track_ends() {
        let mut tracker = Tracker::new(TrackerSettings::default());
        tracker.update(1.0, &at(0.0, 0.7), &spread());

        assert!((tracker.predict(1.5).unwrap().age - 0.5).abs() < 1e-12);
        assert!(tracker.predict(1.99).is_some() && tracker.predict(2.01).is_none());
        assert!((tracker.age(3.0) - 2.0).abs() < 1e-12);
    }

    /// If a face is read turned by a quarter, the orientation of the track does not change.
    #[test]
    fn quarter_turned_reading_keeps_orientation_of_track() {
        let mut tracker = Tracker::new(TrackerSettings::default());
        let quarter = UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let mut other = at(0.0, 0.7);
        other.rotation = quarter * UnitQuaternion::from_euler_angles(0.02, 0.0, 0.0);
        tracker.update(0.0, &at(0.0, 0.7), &spread());

        let update = tracker.update(0.04, &other, &spread());

        // The reading counts: the orientation follows it by a part of its 0.02 rad.
        assert!(matches!(update, Update::Accepted(_)), "{update:?}");
        let turned = tracker.predict(0.04).unwrap().pose.rotation.angle();
        assert!((0.005..0.02).contains(&turned), "{turned}");
    }

    /// The wrong one of the two poses that fit a single face is gated by its angle. A cube that
    /// really turns is followed.
    #[test]
    fn mirrored_pose_is_gated_but_turning_cube_followed() {
        let leaning = |x: f64| {
            let mut pose = at(0.0, 0.7);
            pose.rotation = UnitQuaternion::from_euler_angles(x, 0.0, 0.0);
            pose
        };
        let mut tracker = Tracker::new(TrackerSettings::default());
        for i in 0..10 {
            tracker.update(0.04 * f64::from(i), &leaning(0.15), &spread());
        }

        let mirrored = tracker.update(0.40, &leaning(-0.15), &spread());

        assert!(matches!(mirrored, Update::Gated(_)), "{mirrored:?}");
        assert!(matches!(tracker.update(0.44, &leaning(0.15), &spread()), Update::Accepted(_)));
        for i in 0..25_i32 {
            // The cube turns at 0.4 rad/s.
            let now = leaning(0.15 + 0.016 * f64::from(i));
            let update = tracker.update(0.48 + 0.04 * f64::from(i), &now, &spread());
            assert!(matches!(update, Update::Accepted(_)), "{i}: {update:?}");
        }
        let orientation = tracker.predict(1.44).unwrap().pose.rotation;
        // The last measurement: 0.15 rad and 24 steps of 0.016 rad.
        assert!((orientation.angle() - 0.534).abs() < 0.03, "{orientation}");
    }

    /// A measurement that is not newer than the last one has no effect.
    #[test]
    fn old_measurement_does_not_change_track() {
        let mut tracker = Tracker::new(TrackerSettings::default());
        for i in 0..5 {
            tracker.update(0.04 * f64::from(i), &at(0.0, 0.7), &spread());
        }
        let before = tracker.predict(0.2);

        let again = tracker.update(0.16, &at(0.001, 0.7), &spread());
        let older = tracker.update(0.10, &at(0.001, 0.7), &spread());
        assert_eq!((again, older), (Update::Old, Update::Old));
        assert_eq!(tracker.predict(0.2), before);

        // One wrong picture that is delivered repeatedly does not restart the track.
        assert!(matches!(tracker.update(0.20, &at(0.3, 0.7), &spread()), Update::Gated(_)));
        for _ in 0..5 {
            assert_eq!(tracker.update(0.20, &at(0.3, 0.7), &spread()), Update::Old);
        }
    }

    #[test]
    fn window_contains_cube_and_little_else() {
        let camera = Intrinsics {
            width: 640,
            height: 480,
            focal: (600.0, 600.0),
            centre: (319.5, 239.5),
            distortion: (0.0, 0.0),
        };
        let mut tracker = Tracker::new(TrackerSettings::default());
        for i in 0..5 {
            tracker.update(0.04 * f64::from(i), &Pose::translation(0.0, 0.0, 0.4), &spread());
        }

        let window = tracker.window(0.2, &Pose::identity(), &camera, 0.057).unwrap();

        // The cube is 92 px wide, in the middle of the picture.
        assert!(window.x < 273 && window.x + window.width > 366, "{window:?}");
        assert!(window.y < 193 && window.y + window.height > 286, "{window:?}");
        assert!(window.width < 200 && window.height < 200, "{window:?}");
    }
}
