//! The forward kinematics: from joint positions to poses, link points and the Jacobian.

use super::ArmModel;
use crate::motion::JointPositions;
use crate::spatial::Pose;
use nalgebra::{OMatrix, Point3, Quaternion, Translation3, U6, U7, UnitQuaternion, Vector3};
use std::f64::consts::FRAC_PI_2;

/// Jacobian of the tool point: its linear, then its angular velocity per joint velocity d0, q1..q6.
pub type Matrix6x7 = OMatrix<f64, U6, U7>;

/// Sines and cosines of the angles in which the closed form is written.
struct Angles {
    /// Sine and cosine of q1.
    one: (f64, f64),
    /// Sine and cosine of q2, the pitch of the lower arm.
    two: (f64, f64),
    /// Sine and cosine of t3, the pitch of the upper arm in space.
    three: (f64, f64),
    /// Sine and cosine of t4, the pitch of the wrist in space.
    four: (f64, f64),
}

impl Angles {
    /// Computes the sines and cosines at these joint positions.
    fn of(q: &JointPositions) -> Self {
        let t3 = q.0[2] + q.0[3] + FRAC_PI_2;
        Self {
            one: libm::sincos(q.0[1]),
            two: libm::sincos(q.0[2]),
            three: libm::sincos(t3),
            four: libm::sincos(t3 + q.0[4]),
        }
    }
}

impl ArmModel {
    /// Computes the pose of the flange in the base frame. An arm without a track ignores d0.
    ///
    /// ```
    /// use rubik_robot_vocabulary::motion::JointPositions;
    /// use std::f64::consts::FRAC_PI_2;
    ///
    /// # let text = std::fs::read_to_string(concat!(
    /// #     env!("CARGO_MANIFEST_DIR"),
    /// #     "/../../scenarios/arms/irp6_track.toml"
    /// # ))?;
    /// # let arm: rubik_robot_vocabulary::kinematics::ArmModel = toml::from_str(&text)?;
    ///
    /// // The lower arm is upright, upper arm and wrist point forwards.
    /// let joints = JointPositions([0.0, 0.0, -FRAC_PI_2, 0.0, 0.0, 0.0, 0.0]);
    /// let at = arm.base_from_flange(&joints).translation;
    /// let [lower, upper, wrist] = arm.links;
    /// assert!((at.x - (upper + wrist)).abs() < 1e-12);
    /// assert!((at.z - (arm.shoulder_height + lower)).abs() < 1e-12);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn base_from_flange(&self, joints: &JointPositions) -> Pose {
        let q = &joints.0;
        let t3 = q[2] + q[3] + FRAC_PI_2;
        // Half angles give the quaternion directly, instead of by a rotation matrix.
        let (sa, ca) = libm::sincos(0.5 * q[1]);
        let (sb, cb) = libm::sincos(0.5 * (t3 + q[4]));
        let (sc, cc) = libm::sincos(0.5 * q[5]);
        let (sd, cd) = libm::sincos(0.5 * q[6]);
        // Rz(q1) Ry(t4) Rx(q5), then the constant axes of the flange (x -> z, y -> x, z -> y), then
        // Rz(q6).
        let arm = Quaternion::new(ca, 0.0, 0.0, sa)
            * Quaternion::new(cb, 0.0, sb, 0.0)
            * Quaternion::new(cc, sc, 0.0, 0.0);
        let flange = Quaternion::new(0.5, -0.5, -0.5, -0.5) * Quaternion::new(cd, 0.0, 0.0, sd);
        let rotation = UnitQuaternion::new_normalize(arm * flange);

        // The double angle formulas save two calls of sincos.
        let (s1, c1) = (2.0 * sa * ca, 1.0 - 2.0 * sa * sa);
        let (s4, c4) = (2.0 * sb * cb, 1.0 - 2.0 * sb * sb);
        let ((s2, c2), (s3, c3)) = (libm::sincos(q[2]), libm::sincos(t3));
        let [a2, a3, d5] = self.links;
        // A link at pitch t points along (cos t, -sin t): a positive pitch points downwards.
        let r = a2 * c2 + a3 * c3 + d5 * c4;
        let z = self.shoulder_height - a2 * s2 - a3 * s3 - d5 * s4;
        Pose::from_parts(Translation3::new(c1 * r, s1 * r + self.track(joints), z), rotation)
    }

    /// Returns five points of the arm in the base frame (m): the floor below the shoulder,
    /// shoulder, elbow, wrist pitch centre, flange.
    #[must_use]
    pub fn points(&self, joints: &JointPositions) -> [Point3<f64>; 5] {
        self.points_at(joints, &Angles::of(joints))
    }

    /// Computes the Jacobian of the tool point: linear (m/s), then angular (rad/s) velocity in base
    /// axes, per d0 (m/s) and q1..q6 (rad/s). The first column of an arm without a track is zero.
    ///
    /// ```
    /// use rubik_robot_vocabulary::motion::JointPositions;
    /// use rubik_robot_vocabulary::spatial::Pose;
    ///
    /// # let text = std::fs::read_to_string(concat!(
    /// #     env!("CARGO_MANIFEST_DIR"),
    /// #     "/../../scenarios/arms/irp6_track.toml"
    /// # ))?;
    /// # let arm: rubik_robot_vocabulary::kinematics::ArmModel = toml::from_str(&text)?;
    ///
    /// let joints = JointPositions([0.4, 0.1, -1.5, 0.1, 0.2, 1.5, 0.0]);
    /// let jacobian = arm.jacobian(&joints, &Pose::translation(0.0, 0.0, 0.25));
    /// // The track moves the tool along y of the base, as fast as itself, and does not turn it.
    /// assert_eq!(jacobian.column(0).as_slice(), [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    /// // The column turns it about z.
    /// assert_eq!(&jacobian.column(1).as_slice()[3..], [0.0, 0.0, 1.0]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn jacobian(&self, joints: &JointPositions, flange_from_tool: &Pose) -> Matrix6x7 {
        let angles = Angles::of(joints);
        let [_, shoulder, elbow, wrist, flange] = self.points_at(joints, &angles);
        let base_from_flange = self.base_from_flange(joints);
        let tool = base_from_flange * Point3::from(flange_from_tool.translation.vector);
        let ((s1, c1), (s4, c4)) = (angles.one, angles.four);
        let pitch = Vector3::new(-s1, c1, 0.0);
        let roll = Vector3::new(c1 * c4, s1 * c4, -s4);
        // Each rotary joint q1..q6 as a unit vector along its axis and a point on the axis. q3 and
        // q4 are relative to the link before, so elbow and wrist have axes of their own.
        let axes = [
            (Vector3::z(), shoulder),
            (pitch, shoulder),
            (pitch, elbow),
            (pitch, wrist),
            (roll, flange),
            (base_from_flange.rotation * Vector3::z(), flange),
        ];

        let mut jacobian = Matrix6x7::zeros();
        if self.has_track {
            // The track moves the whole arm along y.
            jacobian[(1, 0)] = 1.0;
        }
        for (column, (axis, origin)) in axes.iter().enumerate() {
            let linear = axis.cross(&(tool - origin));
            jacobian.fixed_view_mut::<3, 1>(0, column + 1).copy_from(&linear);
            jacobian.fixed_view_mut::<3, 1>(3, column + 1).copy_from(axis);
        }
        jacobian
    }

    /// Returns d0 (m), or 0 for an arm without a track.
    pub(super) fn track(&self, joints: &JointPositions) -> f64 {
        if self.has_track { joints.0[0] } else { 0.0 }
    }

    /// Computes the points of [`ArmModel::points`] from the sines and cosines of the joint angles.
    fn points_at(&self, joints: &JointPositions, angles: &Angles) -> [Point3<f64>; 5] {
        let [a2, a3, d5] = self.links;
        let (s1, c1) = angles.one;
        let d0 = self.track(joints);
        let along = |from: Point3<f64>, length: f64, (s, c): (f64, f64)| {
            from + length * Vector3::new(c1 * c, s1 * c, -s)
        };
        let shoulder = Point3::new(0.0, d0, self.shoulder_height);
        let elbow = along(shoulder, a2, angles.two);
        let wrist = along(elbow, a3, angles.three);
        let flange = along(wrist, d5, angles.four);
        [Point3::new(0.0, d0, 0.0), shoulder, elbow, wrist, flange]
    }
}

#[cfg(test)]
mod tests {
    use super::super::builtin;
    use super::*;
    use crate::motion::AXES;
    use nalgebra::{Matrix3, Unit};
    use proptest::prelude::*;

    /// Generates joint positions inside the joint limits of the arm.
    fn any_joints(model: &ArmModel) -> impl Strategy<Value = JointPositions> + use<> {
        let limits = model.joint_limits;
        prop::array::uniform7(0.0..1.0f64).prop_map(move |u| {
            JointPositions(std::array::from_fn(|i| {
                limits[i].0 + u[i] * (limits[i].1 - limits[i].0)
            }))
        })
    }

    /// Computes the pose of the flange by a product of exponentials. Each axis is a screw in the
    /// pose in which all variables are zero (`t3 = pi/2`: the upper arm hangs down from the
    /// stretched lower arm). This computation shares only the lengths with the closed form.
    fn by_screws(model: &ArmModel, q: &JointPositions) -> Pose {
        let [a2, a3, d5] = model.links;
        let h = model.shoulder_height;
        let down = h - a3;
        let screws = [
            (Vector3::z(), Point3::new(0.0, 0.0, 0.0)),
            (Vector3::y(), Point3::new(0.0, 0.0, h)),
            (Vector3::y(), Point3::new(a2, 0.0, h)),
            (Vector3::y(), Point3::new(a2, 0.0, down)),
            (-Vector3::z(), Point3::new(a2, 0.0, down)),
            (Vector3::y(), Point3::new(a2, 0.0, down - d5)),
        ];
        let mut pose = Pose::translation(0.0, q.0[0], 0.0);
        for (i, (axis, through)) in screws.iter().enumerate() {
            let rotation = UnitQuaternion::from_axis_angle(&Unit::new_normalize(*axis), q.0[i + 1]);
            let origin = Translation3::from(through.coords);
            pose *= origin * rotation * origin.inverse();
        }
        // In the zero pose the wrist points down. The x of the flange then points along x of the
        // base, its y down, and its z along y of the base.
        let zero = crate::spatial::pose_from_axes(
            Vector3::x(),
            -Vector3::z(),
            Vector3::y(),
            Point3::new(a2, 0.0, down - d5),
        );
        pose * zero
    }

    #[test]
    fn forward_kinematics_reproduces_poses_of_original_controller() {
        // Data of the original system: joints -> flange above the shoulder (rows N, O, A, P).
        let rows: [([f64; 6], [[f64; 3]; 4]); 4] = [
            (
                [0.0, -1.57, 0.0, 1.56, 1.57, -1.57],
                [
                    [-0.009999, -0.000796, 0.999950],
                    [0.000804, -0.999999, -0.000788],
                    [0.999950, 0.000796, 0.010000],
                    [0.672262, 0.0, 0.264476],
                ],
            ),
            (
                [-1.29682, -1.52625, -0.0721613, -0.485755, 3.76995, -0.44999],
                [
                    [0.503842, 0.163550, -0.848171],
                    [0.505118, -0.852314, 0.135707],
                    [-0.700714, -0.496801, -0.512044],
                    [0.231469, -0.823606, 0.566360],
                ],
            ),
            (
                [0.5, -1.2, 0.3, 0.4, 1.0, -0.5],
                [
                    [0.517500, -0.558759, 0.648060],
                    [0.762137, -0.043340, -0.645963],
                    [0.389025, 0.828197, 0.403423],
                    [0.685210, 0.374332, -0.159142],
                ],
            ),
            (
                [-0.8, -1.9, 0.1, -0.6, 2.4, 1.7],
                [
                    [0.480298, -0.369617, 0.795423],
                    [0.044198, 0.915919, 0.398922],
                    [-0.875991, -0.156445, 0.456251],
                    [0.441516, -0.454602, 0.722897],
                ],
            ),
        ];
        let model = builtin("irp6_postument").unwrap();

        for (q, [n, o, a, p]) in rows {
            let pose =
                model.base_from_flange(&JointPositions([0.0, q[0], q[1], q[2], q[3], q[4], q[5]]));

            let wanted = Matrix3::from_columns(&[n.into(), o.into(), a.into()]);
            let rotation = pose.rotation.to_rotation_matrix();
            assert!((rotation.matrix() - wanted).amax() < 2e-6, "{q:?}");
            let above: Vector3<f64> = pose.translation.vector - 0.95 * Vector3::z();
            assert!((above - Vector3::new(p[0], p[1], p[2])).amax() < 2e-6, "{q:?}");
        }
    }

    proptest! {
        #[test]
        fn closed_form_matches_product_of_exponentials(
            q in any_joints(&builtin("irp6_track").unwrap())
        ) {
            let model = builtin("irp6_track").unwrap();

            let (closed, screws) = (model.base_from_flange(&q), by_screws(&model, &q));

            let difference = closed.to_homogeneous() - screws.to_homogeneous();
            prop_assert!(difference.amax() < 1e-12, "{difference}");
            let flange = model.points(&q)[4];
            prop_assert!((flange.coords - closed.translation.vector).amax() < 1e-12);
        }

        #[test]
        fn jacobian_matches_finite_differences(
            q in any_joints(&builtin("irp6_track").unwrap())
        ) {
            let model = builtin("irp6_track").unwrap();
            let tool = Pose::from_parts(
                Translation3::new(0.02, -0.03, 0.25),
                UnitQuaternion::from_euler_angles(0.3, 0.2, 0.1),
            );
            let jacobian = model.jacobian(&q, &tool);
            let step = 1e-6;

            for axis in 0..AXES {
                let (mut more, mut less) = (q, q);
                more.0[axis] += step;
                less.0[axis] -= step;
                let (a, b) =
                    (model.base_from_flange(&less) * tool, model.base_from_flange(&more) * tool);
                let linear = (b.translation.vector - a.translation.vector) / (2.0 * step);
                let angular = (b.rotation * a.rotation.inverse()).scaled_axis() / (2.0 * step);

                let column = jacobian.column(axis);
                prop_assert!((column.fixed_rows::<3>(0) - linear).amax() < 1e-8);
                prop_assert!((column.fixed_rows::<3>(3) - angular).amax() < 1e-8);
            }
        }
    }
}
