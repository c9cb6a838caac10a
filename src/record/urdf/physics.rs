//! Masses, inertias and limits of an arm for its URDF. They are those of the simulated plant.
//!
//! - in: the kinematics and the gripper of an arm; the plant's model of links, motors and jaws
//! - out: an [`Inertial`] for each moving link, in the frames of [`super::model`]; effort and speed
//!   of each drive
//!
//! The plant has one body for all parts that turn with the last axis. Here flange, sensor, tool,
//! fingers and camera each get a share of this body, so that the total stays the plant's. The
//! inertia of the jaw's motor, which equals 41 kg at the pads, is left out: it acts on the motion
//! of the fingers only, not on that of the arm.
//!
//! The ratio of a ball screw changes with the position of its joint. URDF has one number for each
//! limit, so each limit is that of the worst position.

use super::solid::{Shape, Solid};
use crate::cell::Gripper;
use crate::hw::plant::dynamics::{Link, link_frames};
use crate::hw::plant::{ArmDynamics, Jaws};
use crate::kinematics::ArmModel;
use crate::motion::{AXES, JointPositions};
use crate::spatial::Pose;
use nalgebra::{Matrix3, Translation3, Vector3};
use std::f64::consts::PI;
use std::iter::Sum;

/// Density of the links that share the last body of an arm (kg/m3). Other programs assume the same
/// density for links without a mass.
const DENSITY: f64 = 1000.0;
/// Number of densities that are tried, each half of the one before.
const ATTEMPTS: u32 = 20;
/// Number of steps from the lower to the upper limit of a joint in the search for its worst
/// position.
const POSITIONS: u32 = 16;
/// Step of a joint to each side over which a gear ratio is measured (m or rad).
const STEP: f64 = 1e-5;

/// Mass, centre and inertia of a link, in the frame of the link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertial {
    /// Mass (kg).
    pub mass: f64,
    /// Centre of mass (m).
    pub centre: Vector3<f64>,
    /// Inertia about the centre of mass, along the axes of the link (kg m2).
    pub inertia: Matrix3<f64>,
}

/// Greatest effort (N or Nm) and speed (m/s or rad/s) of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Strength {
    /// Effort.
    pub effort: f64,
    /// Speed.
    pub speed: f64,
}

impl Inertial {
    /// Makes the body of a box with this mass (kg) and these edges (m): even density, centre in the
    /// origin.
    pub(super) fn of_box(mass: f64, edges: [f64; 3]) -> Self {
        let [x, y, z] = edges.map(|edge| edge * edge);
        let inertia = Matrix3::from_diagonal(&(Vector3::new(y + z, x + z, x + y) * (mass / 12.0)));
        Self { mass, centre: Vector3::zeros(), inertia }
    }

    /// Makes the body of a solid with this density (kg/m3).
    pub(super) fn of_solid(solid: &Solid, density: f64) -> Self {
        let body = match solid.shape {
            Shape::Box(edges) => Self::of_box(density * edges.iter().product::<f64>(), edges),
            Shape::Cylinder(radius, length) => {
                let mass = density * PI * radius * radius * length;
                let (about_z, across) = (0.5 * radius * radius, radius * radius / 4.0);
                let across = across + length * length / 12.0;
                let moments = Vector3::new(across, across, about_z) * mass;
                Self { mass, centre: Vector3::zeros(), inertia: Matrix3::from_diagonal(&moments) }
            }
        };
        body.moved(&solid.link_from_solid)
    }

    /// Converts this body to another frame; `pose` is the pose of its present frame in the other
    /// one.
    fn moved(&self, pose: &Pose) -> Self {
        let rotation = *pose.rotation.to_rotation_matrix().matrix();
        let centre = rotation * self.centre + pose.translation.vector;
        Self { centre, inertia: rotation * self.inertia * rotation.transpose(), ..*self }
    }

    /// Returns the inertia about the origin of the frame (kg m2).
    fn about_origin(&self) -> Matrix3<f64> {
        let c = self.centre;
        let steiner = Matrix3::from_diagonal_element(c.norm_squared()) - c * c.transpose();
        self.inertia + steiner * self.mass
    }

    /// Returns this body without its part `other`. All are in the same frame.
    fn without(&self, other: &Self) -> Self {
        self.combined(other, -1.0)
    }

    /// Returns this body together with `share` times the body `other`, in the same frame. A
    /// negative share takes the other body away.
    fn combined(&self, other: &Self, share: f64) -> Self {
        let mass = self.mass + share * other.mass;
        let first = self.centre * self.mass + other.centre * (share * other.mass);
        // Two bodies without a mass have no centre.
        let centre = if mass == 0.0 { Vector3::zeros() } else { first / mass };
        let both = Self { mass, centre, inertia: Matrix3::zeros() };
        let inertia = self.about_origin() + other.about_origin() * share - both.about_origin();
        Self { inertia, ..both }
    }

    /// Checks whether a real body can have this inertia: mass and principal moments are positive,
    /// and no moment is greater than the sum of the other two.
    #[must_use]
    pub fn is_possible(&self) -> bool {
        let moments = self.inertia.symmetric_eigenvalues();
        let sum: f64 = moments.iter().sum();
        self.mass > 0.0 && moments.iter().all(|moment| *moment > 0.0 && 2.0 * moment <= sum)
    }
}

impl Sum for Inertial {
    fn sum<I: Iterator<Item = Self>>(bodies: I) -> Self {
        let none = Self { mass: 0.0, centre: Vector3::zeros(), inertia: Matrix3::zeros() };
        bodies.fold(none, |sum, body| sum.combined(&body, 1.0))
    }
}

/// Returns the bodies of the carriage and the links 1 to 6 of an arm, each in the frame of its link
/// of the model. An arm without a track has no carriage; the first body is then its base.
pub(super) fn inertials(model: &ArmModel) -> [Inertial; AXES] {
    let links = ArmDynamics::irp6().links;
    let places = link_frames(model, &JointPositions([0.0; AXES]));
    let origins = origins(model);
    // All frames of the model are parallel to the base if all variables are zero.
    std::array::from_fn(|j| {
        let Link { mass, centre, inertia } = links[j];
        let inertia = Matrix3::from_diagonal(&Vector3::from(inertia));
        let own = Inertial { mass, centre: Vector3::from(centre), inertia };
        own.moved(&(Translation3::from(-origins[j]) * places[j]))
    })
}

/// Returns the origins of the links' frames in the base if all variables are zero (m).
fn origins(model: &ArmModel) -> [Vector3<f64>; AXES] {
    let [a2, a3, d5] = model.links;
    let h = model.shoulder_height;
    let at = |x, z| Vector3::new(x, 0.0, z);
    let wrist = at(a2, h - a3);
    [at(0.0, 0.0), at(0.0, 0.0), at(0.0, h), at(a2, h), wrist, wrist, at(a2, h - a3 - d5)]
}

/// Divides the body `last` of an arm's last link among the links that this link carries: each of
/// `parts` has the pose of such a link in the frame of the last link, and its solids. Returns the
/// body that is left for the last link, and those of the parts, each in the frame of its link. If
/// no density leaves a possible body, nothing is divided, and the list of parts is empty.
pub(super) fn divided(last: &Inertial, parts: &[(Pose, &[Solid])]) -> (Inertial, Vec<Inertial>) {
    let mut density = DENSITY;
    // Solids that are too heavy or far from the body would leave a body that cannot exist.
    for _ in 0..ATTEMPTS {
        let of = |solids: &[Solid]| solids.iter().map(|s| Inertial::of_solid(s, density)).sum();
        let bodies: Vec<Inertial> = parts.iter().map(|(_, solids)| of(solids)).collect();
        let placed = parts.iter().zip(&bodies).map(|((pose, _), body)| body.moved(pose));
        let rest = placed.fold(*last, |rest, body| rest.without(&body));
        if rest.is_possible() {
            return (rest, bodies);
        }
        density *= 0.5;
    }
    (*last, Vec::new())
}

/// Returns the greatest effort and speed of each joint of an arm, in its worst position. The speed
/// is the one at which the fastest motor reaches its limit while this joint moves alone; coupled
/// motors move as well. The effort is that of the joint's own motor at the current at which its
/// power stage trips.
pub(super) fn strengths(model: &ArmModel) -> [Strength; AXES] {
    let motors = ArmDynamics::irp6().motors;
    // For each joint, the least ratio of its own motor and the greatest ratio of any motor.
    let mut worst = [(f64::INFINITY, 0.0_f64); AXES];
    // Only the positions of the two screws change the ratios.
    let at = |joint: usize, step: u32| {
        let (low, high) = model.joint_limits[joint];
        low + (high - low) * f64::from(step) / f64::from(POSITIONS)
    };
    for (lower, upper) in (0..=POSITIONS).flat_map(|i| (0..=POSITIONS).map(move |k| (i, k))) {
        let mut q = JointPositions([0.0; AXES]);
        (q.0[2], q.0[3]) = (at(2, lower), at(3, upper));
        // The motors of the screws cannot reach all positions within the limits of the joints.
        let motors = model.motors(&q).0;
        let reached = |axis: usize| {
            let (low, high) = model.motor_limits[axis];
            (low..=high).contains(&motors[axis])
        };
        if !(reached(2) && reached(3)) {
            continue;
        }
        for (joint, (own, any)) in worst.iter_mut().enumerate() {
            let ratios = ratios(model, &q, joint);
            *own = own.min(ratios[joint].abs());
            *any = ratios.iter().fold(*any, |most, ratio| most.max(ratio.abs()));
        }
    }
    std::array::from_fn(|joint| {
        let (own, any) = worst[joint];
        let motor = &motors[joint];
        let torque = motor.stall_torque * motor.trip_current / motor.stall_current;
        Strength { effort: rounded(torque * own), speed: rounded(model.motor_speed_limit / any) }
    })
}

/// Rounds a limit to six decimals: its ratio is measured over a step, so more would be noise.
fn rounded(limit: f64) -> f64 {
    (limit * 1e6).round() / 1e6
}

/// Returns the turn of each motor per motion of one joint at the position `q` (rad/m or rad/rad).
fn ratios(model: &ArmModel, q: &JointPositions, joint: usize) -> [f64; AXES] {
    let motors = |step: f64| {
        let mut q = *q;
        q.0[joint] += step;
        model.motors(&q).0
    };
    let (before, after) = (motors(-STEP), motors(STEP));
    std::array::from_fn(|motor| (after[motor] - before[motor]) / (2.0 * STEP))
}

/// Returns the greatest force of a finger (N), at which the clutch of the jaw slips, and its
/// greatest speed (m/s), half of the speed at which the opening changes without load.
pub(super) fn strength_of_finger(g: &Gripper) -> Strength {
    let jaws = Jaws::rubber();
    let [c0, c1, c2] = g.opening_of_motor;
    // The opening has this slope over the motor (m/rad) at both ends of its range.
    let slope = |opening: f64| (c1 * c1 + 4.0 * c2 * (opening - c0)).max(0.0).sqrt();
    let slope = slope(g.opening.0).min(slope(g.opening.1));
    Strength { effort: jaws.greatest_grip, speed: rounded(0.5 * slope * jaws.no_load_speed) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hw::plant::dynamics::LINKS;

    /// Returns the arms of the built-in cell.
    fn arms() -> Vec<crate::cell::Arm> {
        crate::tasks::read(std::path::Path::new("t.toml"), "", &[]).unwrap().controller.cell.arms
    }

    #[test]
    fn bodies_have_the_plants_masses_and_are_possible() {
        for arm in arms() {
            let bodies = inertials(&arm.model);

            assert!(bodies.iter().all(Inertial::is_possible), "{bodies:?}");
            for (body, link) in bodies.iter().zip(LINKS) {
                assert_eq!(body.mass, link.mass);
                let trace: f64 = link.inertia.iter().sum();
                assert!((body.inertia.trace() - trace).abs() < 1e-12);
            }
        }
    }

    /// The remaining body and the parts add up to the whole body, also if the parts were too heavy
    /// for it and are made lighter.
    #[test]
    fn divided_body_has_mass_and_inertia_of_whole() {
        let whole = inertials(&arms()[0].model)[AXES - 1];
        for edge in [0.05, 0.2] {
            let link_from_solid = Pose::translation(0.01, 0.02, 0.0);
            let shapes = [Shape::Box([0.5 * edge, edge, edge]), Shape::Cylinder(edge, 0.5 * edge)];
            let solids = shapes.map(|shape| Solid { link_from_solid, shape, colour: [0.5; 3] });
            let pose =
                Pose::translation(0.0, 0.09, 0.0) * Pose::rotation(Vector3::new(0.3, 0.0, 0.1));

            let (rest, parts) = divided(&whole, &[(pose, &solids[..1]), (pose, &solids[1..])]);

            assert!(rest.is_possible() && parts.iter().all(Inertial::is_possible), "{rest:?}");
            let again: Inertial = parts.iter().map(|part| part.moved(&pose)).chain([rest]).sum();
            assert!((again.mass - whole.mass).abs() < 1e-12);
            assert!((again.centre - whole.centre).norm() < 1e-12);
            assert!((again.inertia - whole.inertia).amax() < 1e-12);
        }
    }

    #[test]
    fn strengths_follow_from_motors_and_gears() {
        for arm in arms() {
            let (model, motors) = (&arm.model, ArmDynamics::irp6().motors);

            let strengths = strengths(model);

            for joint in [1, 4, 5, 6] {
                let speed = model.motor_speed_limit / model.gears[joint].abs();
                assert!((strengths[joint].speed - speed).abs() < 1e-6 * speed, "{joint}");
                let effort = motors[joint].stall_torque / 1.5 * model.gears[joint].abs();
                assert!((strengths[joint].effort - effort).abs() < 1e-6 * effort, "{joint}");
            }
            if model.has_track {
                // A motor at 250 rad/s with 1570.796 rad for each metre of the track.
                assert!((strengths[0].speed - 250.0 / 1570.796).abs() < 1e-6);
            }
            // No motor exceeds its limit where the screws have their greatest ratios.
            for (joint, strength) in strengths.iter().enumerate().skip(1) {
                for share in [0.0, 0.3, 1.0] {
                    let limits = &model.joint_limits;
                    let at =
                        |axis: usize| limits[axis].0 + share * (limits[axis].1 - limits[axis].0);
                    let q = JointPositions(std::array::from_fn(at));
                    let fastest =
                        ratios(model, &q, joint).iter().fold(0.0_f64, |m, r| m.max(r.abs()));
                    let speed = fastest * strength.speed;
                    assert!(speed <= model.motor_speed_limit * 1.01, "{joint}: {speed}");
                }
            }
            let finger = strength_of_finger(&arm.gripper);
            assert!(finger.speed > 0.01 && finger.speed < 1.0, "{} m/s", finger.speed);
            assert_eq!(finger.effort, 60.0, "the clutch slips at 60 N");
        }
    }
}
