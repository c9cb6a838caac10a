//! The check of joint and motor positions against the limits of an arm.

use super::ArmModel;
use crate::motion::{AXES, JointPositions, MotorPositions, MoveRefused};

impl ArmModel {
    /// Checks that all joints are inside their limits.
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
    /// let mut joints = JointPositions([0.4, 0.1, -1.5, 0.1, 0.2, 1.5, 0.3]);
    /// assert_eq!(arm.check_joints(&joints), Ok(()));
    /// // The track is 1.21 m long.
    /// joints.0[0] = 1.3;
    /// let refused = arm.check_joints(&joints).unwrap_err();
    /// assert_eq!(refused.to_string(), "joint 0: 1.3000 m is outside -0.1250..1.2100");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// The first joint that is not: [`MoveRefused::JointLimit`], or [`MoveRefused::NotANumber`].
    pub fn check_joints(&self, joints: &JointPositions) -> Result<(), MoveRefused> {
        self.joint_excesses(joints).next().map_or(Ok(()), Err)
    }

    /// Checks that all motors are inside their limits.
    ///
    /// # Errors
    /// The first motor that is not: [`MoveRefused::MotorLimit`], or [`MoveRefused::NotANumber`].
    pub fn check_motors(&self, motors: &MotorPositions) -> Result<(), MoveRefused> {
        self.motor_excesses(motors).next().map_or(Ok(()), Err)
    }

    /// Checks that the joints and their motors are inside their limits.
    ///
    /// # Errors
    /// The error of [`ArmModel::check_joints`], else that of [`ArmModel::check_motors`].
    pub fn check(&self, joints: &JointPositions) -> Result<(), MoveRefused> {
        self.check_joints(joints)?;
        self.check_motors(&self.motors(joints))
    }

    /// Returns an error for each joint that is outside its limits or not a finite number.
    pub fn joint_excesses(&self, joints: &JointPositions) -> impl Iterator<Item = MoveRefused> {
        excesses(self.first_axis(), joints.0, self.joint_limits).map(|(axis, value, low, high)| {
            if value.is_finite() {
                MoveRefused::JointLimit { axis, value, low, high }
            } else {
                MoveRefused::NotANumber
            }
        })
    }

    /// Returns an error for each motor that is outside its limits or not a finite number.
    pub fn motor_excesses(&self, motors: &MotorPositions) -> impl Iterator<Item = MoveRefused> {
        excesses(self.first_axis(), motors.0, self.motor_limits).map(|(axis, value, low, high)| {
            if value.is_finite() {
                MoveRefused::MotorLimit { axis, value, low, high }
            } else {
                MoveRefused::NotANumber
            }
        })
    }

    /// Returns the greatest speed of an axis whose motor moves no other joint (rad/s; m/s of the
    /// track): track, waist and tool roll. For the other axes it returns infinity: their motors
    /// move several joints, so their greatest speeds depend on the posture and on those joints.
    #[must_use]
    pub fn uncoupled_speed(&self, axis: usize) -> f64 {
        match axis {
            0 if self.has_track => self.motor_speed_limit / self.gears[0].abs(),
            1 | 6 => self.motor_speed_limit / self.gears[axis].abs(),
            _ => f64::INFINITY,
        }
    }

    /// Returns whether `value` (m or rad) is inside the limits of a joint. A NaN is not.
    pub(super) fn allows(&self, axis: usize, value: f64) -> bool {
        let (low, high) = self.joint_limits[axis];
        (low..=high).contains(&value)
    }

    /// Returns the index of the first axis: 1 for an arm without a track, else 0.
    pub(super) fn first_axis(&self) -> usize {
        usize::from(!self.has_track)
    }
}

/// Returns axis, value, low and high limit of each value that is outside its limits or NaN, from
/// the axis `first` on.
fn excesses(
    first: usize,
    values: [f64; AXES],
    limits: [(f64, f64); AXES],
) -> impl Iterator<Item = (usize, f64, f64, f64)> {
    (first..AXES)
        .map(move |axis| (axis, values[axis], limits[axis].0, limits[axis].1))
        // The negated range is also true for a NaN, which two comparisons would let pass.
        .filter(|(_, value, low, high)| !(low..=high).contains(&value))
}

#[cfg(test)]
mod tests {
    use super::super::builtin;
    use super::*;

    #[test]
    fn uncoupled_speed_turns_one_motor_at_its_limit() {
        for name in ["irp6_track", "irp6_postument"] {
            let model = builtin(name).unwrap();
            let from = JointPositions([0.5, 0.1, -1.5, 0.1, 0.5, 1.0, 0.5]);
            for axis in [0, 1, 6] {
                let (speed, mut to) = (model.uncoupled_speed(axis), from);
                if axis == 0 && !model.has_track {
                    assert_eq!(speed, f64::INFINITY);
                    continue;
                }
                to.0[axis] += speed;
                let (before, after) = (model.motors(&from), model.motors(&to));
                for motor in 0..7 {
                    let moved = (after.0[motor] - before.0[motor]).abs();
                    let wanted = if motor == axis { model.motor_speed_limit } else { 0.0 };
                    assert!((moved - wanted).abs() < 1e-9, "{name} {axis} {motor}: {moved}");
                }
            }
            assert!([2, 3, 4, 5].iter().all(|&axis| model.uncoupled_speed(axis).is_infinite()));
        }
    }

    /// Each joint and each motor is tried at both of its limits, and just outside of them.
    #[test]
    fn each_exceeded_limit_is_refused_on_both_sides() {
        let model = builtin("irp6_track").unwrap();
        let middle =
            |limits: [(f64, f64); AXES]| limits.map(|(low, high)| f64::midpoint(low, high));
        let tried = |(low, high): (f64, f64)| {
            [(low, false), (high, false), (low - 1e-6, true), (high + 1e-6, true)]
        };
        for axis in 0..AXES {
            let (low, high) = model.joint_limits[axis];
            for (value, outside) in tried((low, high)) {
                let mut joints = JointPositions(middle(model.joint_limits));
                joints.0[axis] = value;
                let error = outside.then_some(MoveRefused::JointLimit { axis, value, low, high });
                assert_eq!(model.check_joints(&joints), error.map_or(Ok(()), Err));
                assert!(model.joint_excesses(&joints).eq(error));
            }
            let (low, high) = model.motor_limits[axis];
            for (value, outside) in tried((low, high)) {
                let mut motors = MotorPositions(middle(model.motor_limits));
                motors.0[axis] = value;
                let error = outside.then_some(MoveRefused::MotorLimit { axis, value, low, high });
                assert_eq!(model.check_motors(&motors), error.map_or(Ok(()), Err));
                assert!(model.motor_excesses(&motors).eq(error));
            }
        }
    }

    #[test]
    fn excesses_contain_every_exceeded_limit() {
        let model = builtin("irp6_track").unwrap();
        let q = JointPositions([2.0, 0.0, -1.57, 0.0, 1.0, 1.0, 3.5]);

        let axes: Vec<_> = model.joint_excesses(&q).collect();

        assert_eq!(axes.len(), 2);
        assert!(matches!(axes[0], MoveRefused::JointLimit { axis: 0, value: 2.0, .. }));
        assert!(matches!(axes[1], MoveRefused::JointLimit { axis: 6, value: 3.5, .. }));
        assert_eq!(model.check_joints(&q), Err(axes[0]));
        // An arm without a track has no axis 0.
        let fixed = builtin("irp6_postument").unwrap();
        assert_eq!(fixed.joint_excesses(&q).count(), 1);
        let motors = MotorPositions([1e6; AXES]);
        assert_eq!(model.motor_excesses(&motors).count(), AXES);
        assert_eq!(fixed.motor_excesses(&motors).count(), AXES - 1);
    }

    #[test]
    fn check_refuses_exceeded_motor_limit_within_joint_limits() {
        let model = builtin("irp6_postument").unwrap();
        let q = JointPositions([0.0, 0.5, -1.2, 0.3, 0.4, 1.0, -0.5]);

        assert_eq!(model.check_joints(&q), Ok(()));
        assert!(matches!(model.check(&q), Err(MoveRefused::MotorLimit { axis: 3, .. })));
    }

    #[test]
    fn check_refuses_nan_and_infinite_positions() {
        let model = builtin("irp6_postument").unwrap();
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut q = JointPositions([0.0, 0.0, -1.57, 0.0, 1.0, 1.0, 0.0]);
            let mut motors = model.motors(&q);
            assert_eq!((model.check(&q), model.check_motors(&motors)), (Ok(()), Ok(())));
            q.0[4] = wrong;
            motors.0[4] = wrong;

            assert_eq!(model.check_joints(&q), Err(MoveRefused::NotANumber));
            assert_eq!(model.check_motors(&motors), Err(MoveRefused::NotANumber));
        }
    }
}
