//! The inverse kinematics: from a pose to joint positions, in closed form.
//!
//! The pitch t4 of the wrist in space fixes the wrist centre and the plane of the arm, and these
//! fix all other joints. A pose has at most four solutions with the elbow up: the arm reaches
//! forwards or over its own column (q1, q1 + pi), and the roll q5 of the wrist has either sign (t4
//! and q6 differ by pi). The elbow-down solutions are far outside the limits of q3. The track
//! position d0 is an input.
//!
//! The original controller takes q5 from a root, which loses digits near the singularity sin q5 = 0
//! of the wrist. Here q5 and q6 follow from t4 by arguments of atan2 that are never both small, so
//! the orientation is exact even there. In the singularity itself t4 keeps its old value.

use super::ArmModel;
use crate::motion::{JointPositions, MoveRefused};
use crate::spatial::Pose;
use nalgebra::{Rotation3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Value of |sin q5| below which the pose does not determine the pitch of the wrist. Keeping the
/// old pitch causes an error of the approach axis of at most this angle (rad).
const SINGULAR: f64 = 1e-11;

/// Joint positions inside the joint limits that reach a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Branches {
    found: [JointPositions; Self::MOST],
    count: usize,
}

impl Branches {
    /// Capacity: two shoulders, two wrists, two full turns of q5, two of q6.
    const MOST: usize = 16;

    /// Returns the solutions. Those that differ only in full turns of the wrist stand together, and
    /// the turns nearest to the middle of the limits come first.
    #[must_use]
    pub fn as_slice(&self) -> &[JointPositions] {
        &self.found[..self.count]
    }

    /// Appends a solution. One beyond the capacity, which the limits of an IRp-6 exclude, is
    /// dropped.
    fn push(&mut self, joints: JointPositions) {
        if self.count < Self::MOST {
            self.found[self.count] = joints;
            self.count += 1;
        }
    }
}

/// Pose as seen in the vertical plane of the arm.
struct Plane {
    /// Columns N, O, A of the rotation, with x along the arm, y across it, z up.
    n: Vector3<f64>,
    o: Vector3<f64>,
    a: Vector3<f64>,
    /// Position of the flange along the arm and upwards, from the shoulder (m).
    reach: f64,
    height: f64,
}

/// Wrist angles of one solution (rad).
#[derive(Clone, Copy)]
struct Wrist {
    t4: f64,
    sin_cos_t4: (f64, f64),
    q5: f64,
    q6: f64,
}

impl ArmModel {
    /// Finds the joint positions of `base_from_flange` that are nearest to `near`. d0 is that of
    /// `near`, and q5 and q6 take the full turns nearest to `near`. It does not check limits.
    ///
    /// ```
    /// use rubik_robot_vocabulary::motion::{JointPositions, MoveRefused};
    /// use rubik_robot_vocabulary::spatial::Pose;
    ///
    /// # let text = std::fs::read_to_string(concat!(
    /// #     env!("CARGO_MANIFEST_DIR"),
    /// #     "/../../scenarios/arms/irp6_track.toml"
    /// # ))?;
    /// # let arm: rubik_robot_vocabulary::kinematics::ArmModel = toml::from_str(&text)?;
    ///
    /// let joints = JointPositions([0.4, 0.1, -1.5, 0.1, 0.2, 1.5, 0.3]);
    /// let mut near = joints;
    /// near.0[1] += 0.05;
    /// let found = arm.inverse(&arm.base_from_flange(&joints), &near)?;
    /// assert!(found.0.iter().zip(&joints.0).all(|(a, b)| (a - b).abs() < 1e-9));
    ///
    /// let far = arm.inverse(&Pose::translation(3.0, 0.4, 1.0), &joints);
    /// assert!(matches!(far, Err(MoveRefused::OutOfReach(by)) if by > 1.0));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`MoveRefused::OutOfReach`] if the wrist centre is too far from, or too near to, the
    /// shoulder; [`MoveRefused::NotANumber`] if an input is not finite.
    pub fn inverse(
        &self,
        base_from_flange: &Pose,
        near: &JointPositions,
    ) -> Result<JointPositions, MoveRefused> {
        let position = base_from_flange.translation.vector;
        if !(position.iter().all(|x| x.is_finite())
            && base_from_flange.rotation.coords.iter().all(|x| x.is_finite())
            && near.0.iter().all(|x| x.is_finite()))
        {
            return Err(MoveRefused::NotANumber);
        }
        let d0 = self.track(near);
        // The arm lies in a vertical plane, so q1 is the direction of the flange or the opposite
        // one.
        let forwards = libm::atan2(position.y - d0, position.x);
        let q1 = nearest_turn(forwards, near.0[1]);
        let backwards = nearest_turn(forwards + PI, near.0[1]);
        let q1 =
            if (backwards - near.0[1]).abs() < (q1 - near.0[1]).abs() { backwards } else { q1 };

        let plane = self.plane(base_from_flange, q1, d0);
        // Both wrists give the same pose; the nearer one avoids a flip of the wrist.
        let near_t4 = near.0[2] + near.0[3] + FRAC_PI_2 + near.0[4];
        let distance = |w: &Wrist| {
            (w.t4 - near_t4).abs() + (w.q5 - near.0[5]).abs() + (w.q6 - near.0[6]).abs()
        };
        let [a, b] = plane.wrists(near_t4).map(|wrist| wrist.turned_near(near_t4, near));
        let wrist = if distance(&b) < distance(&a) { b } else { a };
        self.arm(&plane, &wrist, q1, near.0[0])
    }

    /// Finds every solution of `base_from_flange` inside the joint limits at the given d0: both
    /// shoulders, both signs of the wrist, every full turn of q5 and q6. It does not check motor
    /// limits. In the singularity of the wrist, where solutions are not isolated, those with `t4 =
    /// 0` represent all others.
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
    /// let pose = arm.base_from_flange(&joints);
    /// let branches = arm.branches(&pose, 0.4);
    /// assert!(!branches.as_slice().is_empty());
    /// for joints in branches.as_slice() {
    ///     let off = pose.inverse() * arm.base_from_flange(joints);
    ///     assert!(off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-6);
    ///     assert_eq!(arm.check_joints(joints), Ok(()));
    /// }
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn branches(&self, base_from_flange: &Pose, d0: f64) -> Branches {
        let mut branches =
            Branches { found: [JointPositions::default(); Branches::MOST], count: 0 };
        // The turns nearest to the middle of the limits are the most likely to be inside them.
        let middle = JointPositions(std::array::from_fn(|i| match i {
            0 => d0,
            _ => 0.5 * (self.joint_limits[i].0 + self.joint_limits[i].1),
        }));
        let position = base_from_flange.translation.vector;
        let forwards = libm::atan2(position.y - self.track(&middle), position.x);
        for q1 in [forwards, forwards + PI] {
            let q1 = nearest_turn(q1, middle.0[1]);
            let plane = self.plane(base_from_flange, q1, self.track(&middle));
            for wrist in plane.wrists(0.0) {
                let wrist = wrist.turned_near(0.0, &middle);
                // A wrist may be out of reach although the other one is not.
                let Ok(first) = self.arm(&plane, &wrist, q1, d0) else { continue };
                let mut joints = first;
                joints.0[4] = nearest_turn(first.0[4], middle.0[4]);
                // Only the wrist may have more than one full turn inside its limits.
                if !(0..5).all(|axis| axis < self.first_axis() || self.allows(axis, joints.0[axis]))
                {
                    continue;
                }
                for q5 in TURNS.map(|turn| first.0[5] + turn) {
                    for q6 in TURNS.map(|turn| first.0[6] + turn) {
                        if self.allows(5, q5) && self.allows(6, q6) {
                            (joints.0[5], joints.0[6]) = (q5, q6);
                            branches.push(joints);
                        }
                    }
                }
            }
        }
        branches
    }

    /// Expresses a pose in the vertical plane of an arm with this q1 and d0.
    fn plane(&self, base_from_flange: &Pose, q1: f64, d0: f64) -> Plane {
        let (s1, c1) = libm::sincos(q1);
        let turn = |v: Vector3<f64>| Vector3::new(c1 * v.x + s1 * v.y, c1 * v.y - s1 * v.x, v.z);
        let rotation: Rotation3<f64> = base_from_flange.rotation.to_rotation_matrix();
        let matrix = rotation.matrix();
        let p = base_from_flange.translation.vector;
        Plane {
            n: turn(matrix.column(0).into_owned()),
            o: turn(matrix.column(1).into_owned()),
            a: turn(matrix.column(2).into_owned()),
            reach: c1 * p.x + s1 * (p.y - d0),
            height: p.z - self.shoulder_height,
        }
    }

    /// Computes the joint positions of the solution that has these wrist angles, q1 (rad) and d0
    /// (m): finds the angles of the lower and the upper arm that reach its wrist centre.
    ///
    /// # Errors
    /// [`MoveRefused::OutOfReach`] if the wrist centre is too far from, or too near to, the
    /// shoulder; [`MoveRefused::NotANumber`] if a result is not finite.
    fn arm(
        &self,
        plane: &Plane,
        wrist: &Wrist,
        q1: f64,
        d0: f64,
    ) -> Result<JointPositions, MoveRefused> {
        let [a2, a3, d5] = self.links;
        let (s4, c4) = wrist.sin_cos_t4;
        // Wrist centre in the plane of the arm: e along it, f downwards.
        let (e, f) = (plane.reach - d5 * c4, -plane.height - d5 * s4);
        let square = e * e + f * f;
        let distance = square.sqrt();
        // The error says by how much the pose is out of reach (m).
        if distance > a2 + a3 {
            return Err(MoveRefused::OutOfReach(distance - a2 - a3));
        }
        if distance < (a3 - a2).abs() || distance == 0.0 {
            return Err(MoveRefused::OutOfReach((a3 - a2).abs() - distance));
        }
        // Angle at the shoulder between the lower arm and the line to the wrist centre, by the
        // cosine rule. The positive sine is the solution with the elbow up.
        let cosine = (square + a2 * a2 - a3 * a3) / (2.0 * a2 * distance);
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let q2 = libm::atan2(f, e) - libm::atan2(sine, cosine);
        let (s2, c2) = libm::sincos(q2);
        let t3 = libm::atan2(f - a2 * s2, e - a2 * c2);
        // The limits of q2 lie around -pi/2, those of q3 and q4 around 0.
        let q2 = nearest_turn(q2, -FRAC_PI_2);
        let q3 = nearest_turn(t3 - q2 - FRAC_PI_2, 0.0);
        let q4 = nearest_turn(wrist.t4 - t3, 0.0);
        let joints = JointPositions([d0, q1, q2, q3, q4, wrist.q5, wrist.q6]);
        if joints.0.iter().all(|q| q.is_finite()) {
            Ok(joints)
        } else {
            Err(MoveRefused::NotANumber)
        }
    }
}

/// Full turns that may be added to q5 and q6 (rad).
const TURNS: [f64; 3] = [0.0, TAU, -TAU];

impl Plane {
    /// Returns both solutions for the wrist's angles. In the singularity, where the pose does not
    /// determine t4, they are the one with the given `t4` (rad) and the one with t4 + pi.
    fn wrists(&self, t4: f64) -> [Wrist; 2] {
        // A = (s4 s5, c5, c4 s5), so its part in the plane has the length |s5| and the direction
        // t4.
        let sine = libm::hypot(self.a.x, self.a.z);
        let t4 = if sine > SINGULAR { libm::atan2(self.a.x, self.a.z) } else { t4 };
        let (s4, c4) = libm::sincos(t4);
        // (c4, 0, -s4) is normal to the wrist in the plane: along it N has the component s6 and O
        // has c6. A has the component s5 along (s4, 0, c4).
        let q5 = libm::atan2(s4 * self.a.x + c4 * self.a.z, self.a.y);
        let q6 = libm::atan2(c4 * self.n.x - s4 * self.n.z, c4 * self.o.x - s4 * self.o.z);
        [
            Wrist { t4, sin_cos_t4: (s4, c4), q5, q6 },
            Wrist { t4: t4 + PI, sin_cos_t4: (-s4, -c4), q5: -q5, q6: q6 + PI },
        ]
    }
}

impl Wrist {
    /// Returns the wrist's angles plus the full turns that bring them nearest to `t4` and to q5, q6
    /// of `near`.
    fn turned_near(self, t4: f64, near: &JointPositions) -> Self {
        Self {
            t4: nearest_turn(self.t4, t4),
            q5: nearest_turn(self.q5, near.0[5]),
            q6: nearest_turn(self.q6, near.0[6]),
            ..self
        }
    }
}

/// Returns `angle` plus the full turns that bring it nearest to `to` (rad).
fn nearest_turn(angle: f64, to: f64) -> f64 {
    let turns = libm::rint((to - angle) / TAU);
    // The skip of 0.0 * TAU keeps -0.0 and costs nothing.
    if turns == 0.0 { angle } else { angle + turns * TAU }
}

#[cfg(test)]
mod tests {
    use super::super::builtin;
    use super::*;
    use nalgebra::{Quaternion, UnitQuaternion};
    use proptest::prelude::*;

    /// Generates joint positions inside the joint limits of the track arm.
    fn any_joints() -> impl Strategy<Value = JointPositions> {
        let limits = builtin("irp6_track").unwrap().joint_limits;
        prop::array::uniform7(0.0..1.0f64).prop_map(move |u| {
            JointPositions(std::array::from_fn(|i| {
                limits[i].0 + u[i] * (limits[i].1 - limits[i].0)
            }))
        })
    }

    /// Returns the largest difference of any joint (m or rad).
    fn largest_difference(a: &JointPositions, b: &JointPositions) -> f64 {
        a.0.iter().zip(&b.0).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn inverse_returns_the_joints_of_the_pose(q in any_joints()) {
            prop_assume!(q.0[5].sin().abs() > 1e-4);
            let model = builtin("irp6_track").unwrap();
            // Above the column the pose does not determine q1.
            let flange = model.points(&q)[4];
            prop_assume!(libm::hypot(flange.x, flange.y - q.0[0]) > 1e-4);

            let found = model.inverse(&model.base_from_flange(&q), &q).unwrap();

            prop_assert!(largest_difference(&found, &q) < 1e-10, "{found:?}");
        }

        #[test]
        fn every_branch_reaches_pose_and_one_recovers_joints(q in any_joints()) {
            prop_assume!(q.0[5].sin().abs() > 1e-4);
            let model = builtin("irp6_track").unwrap();
            let flange = model.points(&q)[4];
            prop_assume!(libm::hypot(flange.x, flange.y - q.0[0]) > 1e-4);
            let pose = model.base_from_flange(&q);

            let branches = model.branches(&pose, q.0[0]);

            prop_assert!(branches.as_slice().iter().any(|b| largest_difference(b, &q) < 1e-10));
            for branch in branches.as_slice() {
                prop_assert!(model.check_joints(branch).is_ok());
                let again = model.base_from_flange(branch).to_homogeneous() - pose.to_homogeneous();
                prop_assert!(again.amax() < 1e-12, "{branch:?}");
                let back = model.inverse(&pose, branch).unwrap();
                prop_assert!(largest_difference(&back, branch) < 1e-10, "{back:?}");
            }
        }

        #[test]
        fn inverse_is_exact_next_to_wrist_singularity(
            q in any_joints(), exponent in -20.0..-3.0f64, half in 0..2i32
        ) {
            let model = builtin("irp6_track").unwrap();
            let mut q = q;
            q.0[5] = f64::from(half) * PI + 10f64.powf(exponent);
            let pose = model.base_from_flange(&q);

            let found = model.inverse(&pose, &q).unwrap();

            let again = model.base_from_flange(&found).to_homogeneous() - pose.to_homogeneous();
            prop_assert!(again.amax() < 1e-10, "{again}");
        }
    }

    #[test]
    fn inverse_keeps_previous_joints_in_wrist_singularity() {
        let model = builtin("irp6_postument").unwrap();
        let q = JointPositions([0.0, 0.3, -1.5, 0.1, 0.4, 0.0, 0.2]);

        let found = model.inverse(&model.base_from_flange(&q), &q).unwrap();

        assert!(largest_difference(&found, &q) < 1e-10, "{found:?}");
    }

    #[test]
    fn inverse_keeps_full_turns_of_the_wrist() {
        let model = builtin("irp6_track").unwrap();
        let q = JointPositions([0.4, 0.3, -1.5, 0.1, 0.4, 0.3 + TAU, 0.2 - TAU]);

        let found = model.inverse(&model.base_from_flange(&q), &q).unwrap();

        assert!(largest_difference(&found, &q) < 1e-10, "{found:?}");
    }

    #[test]
    fn inverse_refuses_unreachable_and_nan_poses() {
        let model = builtin("irp6_postument").unwrap();
        let near = JointPositions([0.0, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]);

        let far = Pose::translation(3.0, 0.0, 0.95);
        assert!(matches!(model.inverse(&far, &near), Err(MoveRefused::OutOfReach(d)) if d > 1.5));
        // The wrist points forwards here, and its centre is at the shoulder.
        let [lower, upper, wrist] = model.links;
        let folded = Pose::translation(wrist, 0.0, model.shoulder_height);
        let level = JointPositions([0.0, 0.0, -1.57, 0.0, 0.0, 1.57, 0.0]);
        let refused = model.inverse(&folded, &level);
        let missing = (upper - lower).abs();
        assert!(
            matches!(refused, Err(MoveRefused::OutOfReach(d)) if (d - missing).abs() < 1e-9),
            "{refused:?}"
        );

        let nan = f64::NAN;
        let unturned = UnitQuaternion::new_unchecked(Quaternion::new(nan, 0.0, 0.0, 0.0));
        let reached = model.base_from_flange(&near);
        assert!(model.inverse(&reached, &near).is_ok());
        let nowhere = JointPositions([0.0, 0.0, -1.57, 0.0, nan, 1.57, -1.57]);
        for (pose, near) in [
            (Pose::translation(nan, 0.0, 0.95), near),
            (Pose::from_parts(reached.translation, unturned), near),
            (reached, nowhere),
        ] {
            assert_eq!(model.inverse(&pose, &near), Err(MoveRefused::NotANumber));
        }
    }
}
