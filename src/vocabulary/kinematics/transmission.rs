//! The transmissions between motor shafts and joints: gears, ball screws and the coupled wrist.
//!
//! The linkage keeps the pitch of the upper arm and of the wrist in space while the joints before
//! them move. So motors 3 and 4 drive the absolute pitches t3 and t4. Motor 5 is coupled behind
//! motor 4 and turns with it.

use super::ArmModel;
use crate::motion::{JointPositions, MotorPositions, MoveRefused};
use std::f64::consts::{FRAC_PI_2, TAU};

impl ArmModel {
    /// Computes the motor positions (rad) of joint positions. It does not check limits.
    ///
    /// ```
    /// use rubik_robot_vocabulary::motion::JointPositions;
    ///
    /// # let text = std::fs::read_to_string(concat!(
    /// #     env!("CARGO_MANIFEST_DIR"),
    /// #     "/../../scenarios/arms/irp6_track.toml"
    /// # ))?;
    /// # let arm: rubik_robot_vocabulary::kinematics::ArmModel = toml::from_str(&text)?;
    ///
    /// let joints = JointPositions([0.4, 0.1, -1.5, 0.1, 0.2, 1.5, 0.3]);
    /// let motors = arm.motors(&joints);
    /// let back = arm.joints(&motors)?;
    /// assert!(back.0.iter().zip(&joints.0).all(|(a, b)| (a - b).abs() < 1e-9));
    ///
    /// // The wrist is coupled: motor 5 must turn along with motor 4, so that q5 stays.
    /// let mut bent = joints;
    /// bent.0[4] += 0.1;
    /// let turned = arm.motors(&bent);
    /// let [fourth, fifth] = [4, 5].map(|axis: usize| turned.0[axis] - motors.0[axis]);
    /// assert!((fourth - 0.1 * arm.gears[4]).abs() < 1e-9 && (fourth - fifth).abs() < 1e-9);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn motors(&self, joints: &JointPositions) -> MotorPositions {
        let (q, g, sync, th) = (&joints.0, &self.gears, &self.sync, &self.offsets);
        let t3 = q[2] + q[3] + FRAC_PI_2;
        let t4 = t3 + q[4];
        let geared = |axis: usize, angle: f64| g[axis] * (angle - th[axis]) + sync[axis];
        let m0 = if self.has_track { geared(0, q[0]) } else { 0.0 };
        // The ball screws drive the lower arm at q2 and the upper arm at t3.
        let m2 = g[2] * screw_length(&self.lower_screw, q[2] - th[2]) + sync[2];
        let m3 = g[3] * screw_length(&self.upper_screw, t3 - th[3]) + sync[3];
        let m4 = geared(4, t4);
        // The travel of motor 4 from its synchronisation position, m4 - sync[4], adds to motor 5.
        let m5 = geared(5, q[5]) - sync[4] + m4;
        MotorPositions([m0, geared(1, q[1]), m2, m3, m4, m5, geared(6, q[6])])
    }

    /// Computes the joint positions of motor positions.
    ///
    /// # Errors
    /// [`MoveRefused::MotorLimit`] outside the motor limits, where a screw has a second, wrong
    /// solution; [`MoveRefused::NotANumber`].
    pub fn joints(&self, motors: &MotorPositions) -> Result<JointPositions, MoveRefused> {
        self.check_motors(motors)?;
        let joints = self.joints_unchecked(motors);
        if joints.0.iter().all(|q| q.is_finite()) {
            Ok(joints)
        } else {
            Err(MoveRefused::NotANumber)
        }
    }

    /// Computes the joint positions like [`ArmModel::joints`], but without a check of limits, for
    /// arms that are a little outside them. The result is right within 6 rad of the limits of the
    /// screw motors. Further outside, it may be the wrong one of the two angles that belong to the
    /// length of a screw. It is not finite if the linkage cannot have this length.
    #[must_use]
    pub fn joints_unchecked(&self, motors: &MotorPositions) -> JointPositions {
        let (m, g, sync, th) = (&motors.0, &self.gears, &self.sync, &self.offsets);
        let angle = |axis: usize, motor: f64| (motor - sync[axis]) / g[axis] + th[axis];
        let d0 = if self.has_track { angle(0, m[0]) } else { 0.0 };
        let q2 = screw_angle(&self.lower_screw, (m[2] - sync[2]) / g[2]) + th[2];
        let t3 = screw_angle(&self.upper_screw, (m[3] - sync[3]) / g[3]) + th[3];
        let t4 = angle(4, m[4]);
        // The linkage gives absolute pitches; q3 and q4 are relative.
        let q3 = t3 - q2 - FRAC_PI_2;
        JointPositions([
            d0,
            angle(1, m[1]),
            q2,
            q3,
            t4 - t3,
            angle(5, m[5] - m[4] + sync[4]),
            angle(6, m[6]),
        ])
    }
}

/// Computes the extension of a ball screw beyond l0 (mm) at a link angle (rad), by the cosine rule
/// for the triangle of its two anchors and the joint.
fn screw_length(&[sl, mi, ni, l0]: &[f64; 4], angle: f64) -> f64 {
    let (s, c) = libm::sincos(angle);
    (sl + mi * c - ni * s).sqrt() - l0
}

/// Computes the link angle (rad, -pi..pi) at the extension of a ball screw beyond l0 (mm).
fn screw_angle(&[sl, mi, ni, l0]: &[f64; 4], extension: f64) -> f64 {
    let length = extension + l0;
    // c = mi cos a - ni sin a is a line in (cos a, sin a), which meets the unit circle twice, at
    // the two signs of d. Inside the motor limits the linkage has the solution with this sign.
    let c = length * length - sl;
    let d = (mi * mi + ni * ni - c * c).sqrt();
    let angle = libm::atan2(-(ni * c + mi * d), mi * c - ni * d);
    if angle > std::f64::consts::PI { angle - TAU } else { angle }
}

#[cfg(test)]
mod tests {
    use super::super::builtin;
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn transmission_reproduces_motor_positions_of_original_controller() {
        // Data of the original system, with the synchronisation constants of 2012.
        let rows: [([f64; 6], [f64; 6]); 4] = [
            (
                [0.0, -FRAC_PI_2, 0.0, 0.0, FRAC_PI_2, 0.0],
                [-15.9, -5.0, -8.526944, 151.31, 314.612842, 791.0],
            ),
            (
                [-1.29682, -1.52625, -0.0721613, -0.485755, 3.76995, -0.44999],
                [188.99756, 2.70953, -13.355542, 217.021357, 211.429197, 661.004864],
            ),
            (
                [0.5, -1.2, 0.3, 0.4, 1.0, -0.5],
                [-94.9, 56.735848, 105.066352, 14.24807, 221.38807, 646.55775],
            ),
            (
                [-0.8, -1.9, 0.1, -0.6, 2.4, 1.7],
                [110.5, -62.654722, -47.695583, 257.44807, 357.06807, 1282.10365],
            ),
        ];
        let model = builtin("irp6_postument").unwrap();

        for (q, wanted) in rows {
            let found = model.motors(&JointPositions([0.0, q[0], q[1], q[2], q[3], q[4], q[5]]));
            for (axis, m) in wanted.iter().enumerate() {
                assert!(
                    (found.0[axis + 1] - m).abs() < 1e-4,
                    "{q:?}, motor {}: {found:?}",
                    axis + 1
                );
            }
        }
    }

    /// The constants of 2008 count the motor positions from the home pose.
    #[test]
    fn home_pose_of_2008_has_zero_motor_positions() {
        let model = builtin("irp6_postument_2008").unwrap();
        let q = [0.0, -0.100633, -1.54194, 0.0197377, 1.14914, 2.10098, -2.7312];

        let motors = model.motors(&JointPositions(q));

        assert!(motors.0.iter().all(|m| m.abs() < 2e-3), "{motors:?}");
    }

    #[test]
    fn motor_position_outside_its_limits_is_refused() {
        let model = builtin("irp6_postument").unwrap();
        let mut motors = model.motors(&JointPositions([0.0, 0.0, -1.57, 0.0, 0.0, 1.0, 0.0]));
        motors.0[3] = 105.0;

        let refused = model.joints(&motors);

        assert!(matches!(refused, Err(MoveRefused::MotorLimit { axis: 3, value: 105.0, .. })));
    }

    proptest! {
        #[test]
        fn motors_and_joints_convert_both_ways_inside_limits(
            u in prop::array::uniform7(0.0..1.0f64), track in any::<bool>()
        ) {
            let name = if track { "irp6_track" } else { "irp6_postument" };
            let model = builtin(name).unwrap();
            let motors = MotorPositions(std::array::from_fn(|i| {
                let (low, high) = model.motor_limits[i];
                if i == 0 && !track { 0.0 } else { low + u[i] * (high - low) }
            }));

            let joints = model.joints(&motors).unwrap();
            let again = model.motors(&joints);

            for axis in 0..7 {
                prop_assert!((again.0[axis] - motors.0[axis]).abs() < 1e-9, "{axis}: {again:?}");
            }
        }
    }
}
