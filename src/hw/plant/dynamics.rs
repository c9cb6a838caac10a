//! Rigid-body dynamics of an `IRp-6`: kinematics, mass matrix and bias, all in the base frame.
//!
//! Each spatial quantity is about the base frame's origin and in its axes, so there are no
//! transforms from link to link: composite bodies are sums, a column of the mass matrix is
//! `s_i . I_c s_j`, and a wrench reaches the joints by six products for each axis.
//!
//! - in: joint positions and velocities, gravity in base axes
//! - out: `base_from_flange`, joint screws, mass matrix (kg, kg m, kg m2), bias (N, Nm)
//! - source: composite rigid bodies and recursive Newton-Euler (Featherstone 2008, chapters 5 and
//!   6)

use super::frame::Frame;
use crate::kinematics::ArmModel;
use crate::motion::{AXES, JointPositions};
use crate::spatial::Pose;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::FRAC_PI_2;

/// Mass properties of a link in its own frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    /// Mass (kg).
    pub mass: f64,
    /// Centre of mass in the link frame (m).
    pub centre: [f64; 3],
    /// Principal moments about the centre of mass, along the link's axes (kg m2).
    pub inertia: [f64; 3],
}

/// Returns `base_from_link` of the carriage and the six links at the joint positions `q`. In these
/// frames the mass properties of [`LINKS`] are given.
#[must_use]
pub fn link_frames(model: &ArmModel, q: &JointPositions) -> [Pose; AXES] {
    Placement::new(model, &q.0).frames.map(Frame::to_pose)
}

/// Twist or wrench about the base's origin: angular part first.
#[derive(Debug, Clone, Copy)]
pub(super) struct Screw {
    pub(super) a: Vector3<f64>,
    pub(super) l: Vector3<f64>,
}

impl Screw {
    pub(super) const ZERO: Self =
        Self { a: Vector3::new(0.0, 0.0, 0.0), l: Vector3::new(0.0, 0.0, 0.0) };

    /// Returns the power of the wrench `self` on the twist `other`.
    pub(super) fn dot(&self, other: &Self) -> f64 {
        self.a.dot(&other.a) + self.l.dot(&other.l)
    }

    /// Returns `self + factor * other`.
    fn plus(&self, other: &Self, factor: f64) -> Self {
        Self { a: self.a + other.a * factor, l: self.l + other.l * factor }
    }
}

/// Rigid body: its mass, and its first and second moments about the base's origin.
#[derive(Clone, Copy)]
struct Body {
    /// Mass (kg).
    m: f64,
    /// Mass times the centre of mass (kg m).
    h: Vector3<f64>,
    /// Inertia about the base's origin, in base axes (kg m2).
    i: Matrix3<f64>,
}

impl Body {
    const ZERO: Self = Self {
        m: 0.0,
        h: Vector3::new(0.0, 0.0, 0.0),
        i: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    /// Returns the body of a link whose frame in the base is `frame`.
    fn placed(link: &Link, frame: &Frame) -> Self {
        let c = frame.point(&Vector3::from(link.centre));
        // R diag(i) R^T takes the principal moments to base axes; Steiner's term moves them to the
        // base's origin.
        let [ix, iy, iz] = link.inertia;
        let scaled = Matrix3::from_columns(&[
            frame.r.column(0) * ix,
            frame.r.column(1) * iy,
            frame.r.column(2) * iz,
        ]);
        let mut i = scaled * frame.r.transpose();
        let steiner = Matrix3::from_diagonal_element(c.norm_squared()) - c * c.transpose();
        i += steiner * link.mass;
        Self { m: link.mass, h: c * link.mass, i }
    }

    /// Returns the two bodies as one rigid body.
    fn plus(&self, other: &Self) -> Self {
        Self { m: self.m + other.m, h: self.h + other.h, i: self.i + other.i }
    }

    /// Returns the inertia times `v`: the momentum if `v` is a twist, the wrench if it is an
    /// acceleration.
    fn times(&self, v: &Screw) -> Screw {
        Screw { a: self.i * v.a + self.h.cross(&v.l), l: v.l * self.m - self.h.cross(&v.a) }
    }
}

/// Frames and screws of an arm for one set of joint positions.
#[derive(Clone)]
pub(super) struct Placement {
    /// `base_from_link` of the carriage and the six links; the last is the flange.
    pub(super) frames: [Frame; AXES],
    /// Joint screws.
    pub(super) screws: [Screw; AXES],
}

impl Placement {
    /// Computes frames and screws at the joint positions `q` (m, rad).
    pub(super) fn new(model: &ArmModel, q: &[f64; AXES]) -> Self {
        let [a2, a3, d5] = model.links;
        let y = if model.has_track { q[0] } else { 0.0 };
        let shoulder = Vector3::new(0.0, y, model.shoulder_height);
        let t3 = q[2] + q[3] + FRAC_PI_2;
        let t4 = t3 + q[4];
        let (s1, c1) = libm::sincos(q[1]);
        // Rz(q1) Ry(angle): shoulder, elbow and pitch axes are parallel, so their angles add.
        let pitched = |angle: f64| {
            let (s, c) = libm::sincos(angle);
            Matrix3::new(c1 * c, -s1, c1 * s, s1 * c, c1, s1 * s, -s, 0.0, c)
        };
        let r1 = Matrix3::new(c1, -s1, 0.0, s1, c1, 0.0, 0.0, 0.0, 1.0);
        let (r2, r3, r4) = (pitched(q[2]), pitched(t3), pitched(t4));
        let elbow = shoulder + r2.column(0) * a2;
        let pitch = elbow + r3.column(0) * a3;
        let wrist = pitch + r4.column(0) * d5;
        let (s5, c5) = libm::sincos(q[5]);
        let r5 = r4 * Matrix3::new(1.0, 0.0, 0.0, 0.0, c5, -s5, 0.0, s5, c5);
        // The flange's x, y, z at q6 = 0 are the wrist's z, x, y.
        let r50 = Matrix3::from_columns(&[r5.column(2), r5.column(0), r5.column(1)]);
        let (s6, c6) = libm::sincos(q[6]);
        let r6 = r50 * Matrix3::new(c6, -s6, 0.0, s6, c6, 0.0, 0.0, 0.0, 1.0);

        // A revolute joint's screw: the velocity of the origin is `at x axis` per rad/s.
        let turning = |axis: Vector3<f64>, at: &Vector3<f64>| Screw { a: axis, l: at.cross(&axis) };
        let across = Vector3::new(-s1, c1, 0.0);
        let frame = |r: Matrix3<f64>, p: Vector3<f64>| Frame { r, p };
        Self {
            frames: [
                frame(Matrix3::identity(), Vector3::new(0.0, y, 0.0)),
                frame(r1, shoulder),
                frame(r2, shoulder),
                frame(r3, elbow),
                frame(r4, pitch),
                frame(r5, wrist),
                frame(r6, wrist),
            ],
            screws: [
                if model.has_track {
                    Screw { a: Vector3::zeros(), l: Vector3::y() }
                } else {
                    Screw::ZERO
                },
                turning(Vector3::z(), &shoulder),
                turning(across, &shoulder),
                turning(across, &elbow),
                turning(across, &pitch),
                turning(r5.column(0).into_owned(), &wrist),
                turning(r6.column(2).into_owned(), &wrist),
            ],
        }
    }

    /// Returns the mass matrix and the bias torques (Coriolis, centrifugal, gravity) at joint
    /// velocities `v`. `gravity` is in base axes (m/s2). Row and column 0 of an arm without a track
    /// are those of a unit mass without a load.
    pub(super) fn dynamics(
        &self,
        links: &[Link; AXES],
        v: &[f64; AXES],
        gravity: &Vector3<f64>,
    ) -> ([[f64; AXES]; AXES], [f64; AXES]) {
        let mut bodies = [Body::ZERO; AXES];
        let mut forces = [Screw::ZERO; AXES];
        let mut velocity = Screw::ZERO;
        // A base that accelerates upwards acts like gravity: each link then has its weight.
        let mut acceleration = Screw { a: Vector3::zeros(), l: -gravity };
        for j in 0..AXES {
            bodies[j] = Body::placed(&links[j], &self.frames[j]);
            let s = &self.screws[j];
            // The screw of joint j moves with the links before it: its rate is the cross product
            // with their velocity.
            acceleration.a += velocity.a.cross(&s.a) * v[j];
            acceleration.l += (velocity.a.cross(&s.l) + velocity.l.cross(&s.a)) * v[j];
            velocity = velocity.plus(s, v[j]);
            let momentum = bodies[j].times(&velocity);
            let mut force = bodies[j].times(&acceleration);
            // The gyroscopic term v x* (I v).
            force.a += velocity.a.cross(&momentum.a) + velocity.l.cross(&momentum.l);
            force.l += velocity.a.cross(&momentum.l);
            forces[j] = force;
        }
        let mut mass = [[0.0; AXES]; AXES];
        let mut bias = [0.0; AXES];
        let (mut composite, mut total) = (Body::ZERO, Screw::ZERO);
        // From the flange inwards: a joint carries all links beyond it.
        for j in (0..AXES).rev() {
            composite = composite.plus(&bodies[j]);
            total = total.plus(&forces[j], 1.0);
            bias[j] = self.screws[j].dot(&total);
            let column = composite.times(&self.screws[j]);
            for (i, screw) in self.screws.iter().enumerate().take(j + 1) {
                mass[i][j] = screw.dot(&column);
                mass[j][i] = mass[i][j];
            }
        }
        // Without a track a unit mass keeps the matrix regular.
        if self.screws[0].l.y == 0.0 {
            mass[0][0] = 1.0;
        }
        (mass, bias)
    }

    /// Returns the joint forces and torques (N, Nm) that a wrench on the last link causes. The
    /// wrench is about the base's origin, in base axes.
    pub(super) fn torques(&self, wrench: &Screw) -> [f64; AXES] {
        std::array::from_fn(|j| self.screws[j].dot(wrench))
    }

    /// Returns the twist of one link about the base's origin, at the joint velocities `v`.
    pub(super) fn twist_of(&self, link: usize, v: &[f64; AXES]) -> Screw {
        self.screws.iter().zip(v).take(link + 1).fold(Screw::ZERO, |sum, (s, v)| sum.plus(s, *v))
    }
}

/// Mass properties of the simulated arms' links: the carriage of the track arm, column, lower arm,
/// upper arm, wrist pitch, wrist roll, and tool roll with sensor and gripper. They are assumptions,
/// since the makers do not publish data.
pub const LINKS: [Link; AXES] = [
    Link { mass: 150.0, centre: [0.0, 0.0, 0.3], inertia: [5.0, 5.0, 8.0] },
    Link { mass: 25.0, centre: [0.0, 0.0, -0.3], inertia: [0.6, 0.6, 0.3] },
    Link { mass: 12.0, centre: [0.2275, 0.0, 0.0], inertia: [0.02, 0.25, 0.25] },
    Link { mass: 14.0, centre: [0.335, 0.0, 0.0], inertia: [0.03, 0.6, 0.6] },
    Link { mass: 4.0, centre: [0.095, 0.0, 0.0], inertia: [0.01, 0.02, 0.02] },
    Link { mass: 1.5, centre: [0.0, 0.0, 0.0], inertia: [0.003, 0.003, 0.003] },
    Link { mass: 2.5, centre: [0.0, 0.0, 0.09], inertia: [0.015, 0.015, 0.006] },
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arms::builtin;

    /// Returns 40 pairs of joint positions and joint velocities (m, rad, s), spread by sines.
    fn postures() -> Vec<([f64; AXES], [f64; AXES])> {
        (0..40)
            .map(|k| {
                let at =
                    |i: usize, size: f64| size * libm::sin(1.7 * f64::from(k) + 2.3 * i as f64);
                let v = std::array::from_fn(|i| at(i + 10, 1.0));
                let mid = [0.5, 0.0, -1.57, 0.1, 0.0, 2.5, 0.0];
                let q =
                    std::array::from_fn(|i| mid[i] + at(i, [0.4, 2.5, 0.6, 0.4, 1.2, 2.0, 2.5][i]));
                (q, v)
            })
            .collect()
    }

    /// Gravity in base axes, not quite along z (m/s2).
    const PULL: Vector3<f64> = Vector3::new(0.3, -0.2, -9.8);

    fn model() -> ArmModel {
        builtin("irp6_track").unwrap()
    }

    /// Returns the potential energy of the links at the joint positions `q`, from their frames
    /// alone (J).
    fn potential(q: &[f64; AXES]) -> f64 {
        let place = Placement::new(&model(), q);
        let weigh = |(link, frame): (&Link, &Frame)| {
            -link.mass * PULL.dot(&frame.point(&Vector3::from(link.centre)))
        };
        LINKS.iter().zip(&place.frames).map(weigh).sum()
    }

    /// Returns the kinetic energy of the links (J) from differences of their frames a short time
    /// apart, without screws or a Jacobian.
    fn kinetic(q: &[f64; AXES], v: &[f64; AXES]) -> f64 {
        let h = 1e-5;
        let at = |s: f64| Placement::new(&model(), &std::array::from_fn(|i| q[i] + s * h * v[i]));
        let (before, after) = (at(-1.0), at(1.0));
        let mut sum = 0.0;
        for (i, link) in LINKS.iter().enumerate() {
            let c = Vector3::from(link.centre);
            let speed = (after.frames[i].point(&c) - before.frames[i].point(&c)) / (2.0 * h);
            let turn = before.frames[i].r.transpose() * after.frames[i].r;
            let w = super::super::frame::rotation_vector(&turn) / (2.0 * h);
            sum += 0.5 * link.mass * speed.norm_squared();
            sum += (0..3).map(|k| 0.5 * link.inertia[k] * w[k] * w[k]).sum::<f64>();
        }
        sum
    }

    #[test]
    fn flange_frame_equals_that_of_arm_kinematics() {
        for (q, _) in postures() {
            let mine = Placement::new(&model(), &q).frames[6];
            let theirs = Frame::from_pose(&model().base_from_flange(&JointPositions(q)));

            assert!((mine.r - theirs.r).norm() < 1e-12 && (mine.p - theirs.p).norm() < 1e-12);
        }
    }

    #[test]
    fn mass_matrix_gives_kinetic_energy_of_links() {
        for (q, v) in postures() {
            let (mass, _) = Placement::new(&model(), &q).dynamics(&LINKS, &v, &PULL);

            let quadratic: f64 = (0..AXES)
                .flat_map(|i| (0..AXES).map(move |j| (i, j)))
                .map(|(i, j)| 0.5 * v[i] * mass[i][j] * v[j])
                .sum();

            assert!((quadratic - kinetic(&q, &v)).abs() < 1e-6 * quadratic.abs());
        }
    }

    #[test]
    fn bias_at_rest_equals_gradient_of_potential_energy() {
        for (q, _) in postures() {
            let still = [0.0; AXES];
            let (_, bias) = Placement::new(&model(), &q).dynamics(&LINKS, &still, &PULL);

            for i in 0..AXES {
                let at = |s: f64| {
                    let mut q = q;
                    q[i] += s * 1e-5;
                    potential(&q)
                };
                let slope = (at(1.0) - at(-1.0)) / 2e-5;
                assert!((bias[i] - slope).abs() < 1e-5, "{i}: {} {slope}", bias[i]);
            }
        }
    }

    #[test]
    fn bias_in_motion_satisfies_lagrange_equations() {
        // d/dt (dT/dv_i) - dT/dq_i at constant v, with T from the mass matrix alone.
        let none = Vector3::zeros();
        for (q, v) in postures() {
            let mass = |q: &[f64; AXES]| Placement::new(&model(), q).dynamics(&LINKS, &v, &none).0;
            let moved = |q: &[f64; AXES], i: Option<usize>, h: f64| -> [f64; AXES] {
                std::array::from_fn(|k| match i {
                    None => q[k] + h * v[k],
                    Some(i) => q[k] + if i == k { h } else { 0.0 },
                })
            };
            let (_, bias) = Placement::new(&model(), &q).dynamics(&LINKS, &v, &none);
            let h = 1e-5;
            let (ahead, behind) = (mass(&moved(&q, None, h)), mass(&moved(&q, None, -h)));
            for i in 0..AXES {
                let rate: f64 =
                    (0..AXES).map(|k| (ahead[i][k] - behind[i][k]) / (2.0 * h) * v[k]).sum();
                let (up, down) = (mass(&moved(&q, Some(i), h)), mass(&moved(&q, Some(i), -h)));
                let mut slope = 0.0;
                for a in 0..AXES {
                    for b in 0..AXES {
                        slope += 0.5 * v[a] * (up[a][b] - down[a][b]) / (2.0 * h) * v[b];
                    }
                }
                assert!((bias[i] - (rate - slope)).abs() < 1e-5, "axis {i}");
            }
        }
    }
}
