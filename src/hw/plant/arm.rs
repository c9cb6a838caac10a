//! One arm of the plant: motors behind elastic joints, encoders, currents and limit switches.
//!
//! - in: drives, the wrench that the cube or an obstacle exerts on the arm
//! - out: joint positions, readings
//! - equations: `M q'' + h = K (f(m) - q) + D (f'(m) m' - q') + J^T w` on the links' side, motor inertia,
//!   pulse width, back-EMF and friction on the motors' side; one linearly implicit Euler step for both
//!   sides together (springs, dampers and back-EMF at the end of the step), so that 8 kNm/rad on a wrist of
//!   0.04 kg m2 stays stable at 0.5 ms. The motors' side is eliminated (4 x 4 and scalars), 7 x 7 remains.

use super::config::{ArmDynamics, MotorDynamics};
use super::dynamics::{Placement, Screw};
use super::encoder::Encoder;
use super::frame::{Frame, solve};
use super::plausible::Wrong;
use super::verdict::Exertion;
use crate::cell::Arm;
use crate::kinematics::ArmModel;
use crate::motion::{AXES, JointPositions, MotorPositions};
use crate::servo::io::{ArmDrive, ArmReading};
use crate::spatial::{GRAVITY, Pose};
use nalgebra::{Matrix6, Vector3};
use serde::{Deserialize, Serialize};

/// Presliding of a motor's friction (rad of the shaft): below it friction is a spring.
const PRESLIDING: f64 = 0.005;
/// Beyond the limits that the software keeps, its set values in the period that reaches them included, the switches
/// open (rad of the shaft).
const SWITCH: f64 = 1.0;
/// Beyond the limit switches an axis has this far to its hard stop (rad of the shaft).
const OVERTRAVEL: f64 = 3.0;

/// No joint's spring stretches so far (m, rad).
const STRETCHED: f64 = 0.3;
/// What a kept number may be beyond its limit (rad).
const NEARLY: f64 = 1e-6;

/// State and constants of an arm.
#[derive(Clone)]
pub(super) struct PlantArm {
    model: ArmModel,
    dynamics: ArmDynamics,
    world_from_base: Frame,
    flange_from_tool: Frame,
    gravity: Vector3<f64>,
    /// Joints and their velocities.
    pub(super) q: [f64; AXES],
    pub(super) v: [f64; AXES],
    /// Motors and their velocities (rad, rad/s).
    pub(super) m: [f64; AXES],
    pub(super) vm: [f64; AXES],
    /// Stretch of the friction's bristles (rad of the shaft).
    bristles: [f64; AXES],
    /// Torque of the counterbalance springs at the motors (Nm).
    counterbalance: [f64; AXES],
    /// Mean squares of the currents over the motors' thermal time, of the rated ones'.
    heat: [f64; AXES],
    currents: [f64; AXES],
    encoders: [Encoder; AXES],
    /// Mass matrix and bias, of the period's beginning: in 2 ms they change by parts in a thousand.
    mass: [[f64; AXES]; AXES],
    bias: [f64; AXES],
    /// For the present `q`.
    pub(super) placement: Placement,
    pub(super) world_from_flange: Frame,
    pub(super) world_from_tool: Frame,
}

/// What a file keeps of an arm.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct SavedArm {
    joints: [f64; AXES],
    motors: [f64; AXES],
    bristles: [f64; AXES],
    counterbalance: [f64; AXES],
    pub(super) encoders: Vec<Encoder>,
}

/// Joints of links at rest whose weight stretches the springs behind the encoders, and their weight
/// there (Nm, N).
fn at_rest(
    model: &ArmModel,
    dynamics: &ArmDynamics,
    gravity: &Vector3<f64>,
    encoders: &[f64; AXES],
) -> ([f64; AXES], [f64; AXES]) {
    let mut q = *encoders;
    let mut weight = [0.0; AXES];
    // A sag of milliradians changes the weight by thousandths: converged after two rounds.
    for _ in 0..3 {
        (_, weight) = Placement::new(model, &q).dynamics(&dynamics.links, &[0.0; AXES], gravity);
        q = std::array::from_fn(|j| {
            let side = if weight[j] == 0.0 { 0.0 } else { weight[j].signum() };
            encoders[j] - weight[j] / dynamics.stiffness[j] - side * dynamics.play[j]
        });
    }
    (q, weight)
}

/// `world_from_tool` of an arm at rest with its encoders at `joints`: what it sags by is where a workshop sees it.
#[must_use]
pub fn sagging(arm: &Arm, dynamics: &ArmDynamics, joints: &JointPositions) -> Pose {
    let world_from_base = Frame::from_pose(&arm.world_from_base);
    let gravity = world_from_base.r.tr_mul(&Vector3::new(0.0, 0.0, -GRAVITY)) * dynamics.gravity;
    let (q, _) = at_rest(&arm.model, dynamics, &gravity, &joints.0);
    arm.world_from_base * arm.model.base_from_flange(&JointPositions(q)) * arm.flange_from_tool
}

impl PlantArm {
    /// An arm at rest, its encoders in the start pose: springs stretched and motors loaded by its weight.
    pub(super) fn new(arm: &Arm, dynamics: &ArmDynamics, synchronised: bool) -> Self {
        let world_from_base = Frame::from_pose(&arm.world_from_base);
        let gravity =
            world_from_base.r.tr_mul(&Vector3::new(0.0, 0.0, -GRAVITY)) * dynamics.gravity;
        let stretched = arm.start.0;
        let (q, weight) = at_rest(&arm.model, dynamics, &gravity, &stretched);
        let placement = Placement::new(&arm.model, &q);
        let m = arm.model.motors(&arm.start).0;
        let mut this = Self {
            encoders: std::array::from_fn(|j| {
                // There is no axis 0 to look for without a track.
                let known = synchronised || (j == 0 && !arm.model.has_track);
                Encoder::new(arm.model.increments[j], m[j], known)
            }),
            model: arm.model.clone(),
            dynamics: *dynamics,
            world_from_base,
            flange_from_tool: Frame::from_pose(&arm.flange_from_tool),
            gravity,
            q,
            v: [0.0; AXES],
            m,
            vm: [0.0; AXES],
            bristles: [0.0; AXES],
            counterbalance: [0.0; AXES],
            heat: [0.0; AXES],
            currents: [0.0; AXES],
            mass: [[0.0; AXES]; AXES],
            bias: [0.0; AXES],
            placement,
            world_from_flange: Frame::IDENTITY,
            world_from_tool: Frame::IDENTITY,
        };
        let ratios = this.motors_per_joint(&stretched);
        // Joint torques t reach the motors as H^-T t; H is lower triangular, so solve from the end.
        let mut at_motors = [0.0; AXES];
        for j in (0..AXES).rev() {
            let later: f64 = (j + 1..AXES).map(|k| ratios[k][j] * at_motors[k]).sum();
            at_motors[j] = (weight[j] - later) / ratios[j][j];
        }
        for j in [2, 3] {
            this.counterbalance[j] = at_motors[j] * dynamics.counterbalance;
        }
        // The rest is borne by the friction's presliding where friction suffices.
        for (j, load) in at_motors.iter().enumerate() {
            let motor = &dynamics.motors[j];
            let coulomb = motor.coulomb / ratios[j][j].abs();
            let rest = load - this.counterbalance[j];
            this.bristles[j] = -(rest / coulomb).clamp(-0.9, 0.9) * PRESLIDING;
        }
        this.place();
        this.begin_period();
        this
    }

    /// What is kept of it.
    pub(super) fn saved(&self) -> SavedArm {
        SavedArm {
            joints: self.q,
            motors: self.m,
            bristles: self.bristles,
            counterbalance: self.counterbalance,
            encoders: self.encoders.to_vec(),
        }
    }

    /// Whether an arm can be where it was kept: between its hard stops, its springs as stretched as they get.
    pub(super) fn bears(&self, saved: &SavedArm) -> Result<(), Wrong> {
        let wrong =
            |place: &str, j: usize, why: &str| Err((format!("{place}[{j}]"), why.to_owned()));
        for j in 0..AXES {
            let (low, high) = self.model.motor_limits[j];
            let (beyond, motor) = (SWITCH + OVERTRAVEL + NEARLY, saved.motors[j]);
            if !(low - beyond..=high + beyond).contains(&motor) {
                return wrong("motors", j, "beyond the hard stop");
            }
        }
        let theta = self.model.joints_unchecked(&MotorPositions(saved.motors)).0;
        for (j, theta) in theta.iter().enumerate() {
            let off = (theta - saved.joints[j]).abs();
            if off.is_nan() || off >= STRETCHED {
                return wrong("joints", j, "not where its motor holds it");
            }
            if saved.bristles[j].abs() > PRESLIDING + NEARLY {
                return wrong("bristles", j, "beyond their stretch");
            }
            if !saved.encoders[j].fits(&self.encoders[j], saved.motors[j]) {
                return wrong("encoders", j, "not this motor's");
            }
        }
        Ok(())
    }

    /// At rest where it was kept; `saved` has an encoder an axis.
    pub(super) fn restore(&mut self, saved: SavedArm) {
        (self.q, self.m) = (saved.joints, saved.motors);
        (self.bristles, self.counterbalance) = (saved.bristles, saved.counterbalance);
        (self.v, self.vm) = ([0.0; AXES], [0.0; AXES]);
        for (encoder, kept) in self.encoders.iter_mut().zip(saved.encoders) {
            *encoder = kept;
        }
        self.place();
        self.begin_period();
    }

    /// Recomputes the frames from `q`.
    pub(super) fn place(&mut self) {
        self.placement = Placement::new(&self.model, &self.q);
        self.world_from_flange = self.world_from_base.times(&self.placement.frames[6]);
        self.world_from_tool = self.world_from_flange.times(&self.flange_from_tool);
    }

    /// Origins in the world of base, shoulder, elbow, wrist pitch centre, flange.
    pub(super) fn points(&self) -> [Vector3<f64>; 5] {
        let f = &self.placement.frames;
        let floor = Vector3::new(f[1].p.x, f[1].p.y, 0.0);
        [floor, f[1].p, f[3].p, f[4].p, f[6].p].map(|p| self.world_from_base.point(&p))
    }

    /// Velocity of a point fixed to the last link, and of rotation, in the world.
    pub(super) fn velocity_at(&self, point: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let twist = self.placement.twist(&self.v);
        let local = self.world_from_base.r.tr_mul(&(point - self.world_from_base.p));
        let r = &self.world_from_base.r;
        (r * (twist.l + twist.a.cross(&local)), r * twist.a)
    }

    /// Joint torques of a force at a point and a torque, both in the world.
    pub(super) fn torques(
        &self,
        force: &Vector3<f64>,
        torque: &Vector3<f64>,
        point: &Vector3<f64>,
    ) -> [f64; AXES] {
        let r = &self.world_from_base.r;
        let (f, t) = (r.tr_mul(force), r.tr_mul(torque));
        let p = r.tr_mul(&(point - self.world_from_base.p));
        self.placement.torques(&Screw { a: t + p.cross(&f), l: f })
    }

    /// dm/dq: motor velocities per joint velocity; lower triangular.
    fn motors_per_joint(&self, q: &[f64; AXES]) -> [[f64; AXES]; AXES] {
        let model = &self.model;
        let screw = |&[sl, mi, ni, _]: &[f64; 4], angle: f64| {
            let (s, c) = libm::sincos(angle);
            -(mi * s + ni * c) / (2.0 * (sl + mi * c - ni * s).sqrt())
        };
        let g = &model.gears;
        let t3 = q[2] + q[3] + std::f64::consts::FRAC_PI_2;
        let h3 = g[3] * screw(&model.upper_screw, t3 - model.offsets[3]);
        let mut h = [[0.0; AXES]; AXES];
        h[0][0] = if model.has_track { g[0] } else { 1.0 };
        h[1][1] = g[1];
        h[2][2] = g[2] * screw(&model.lower_screw, q[2] - model.offsets[2]);
        h[3][2] = h3;
        h[3][3] = h3;
        h[4][2..5].fill(g[4]);
        h[5][2..5].fill(g[4]);
        h[5][5] = g[5];
        h[6][6] = g[6];
        h
    }

    /// Takes mass matrix and bias of the present posture and speed.
    pub(super) fn begin_period(&mut self) {
        (self.mass, self.bias) =
            self.placement.dynamics(&self.dynamics.links, &self.v, &self.gravity);
    }

    /// Takes one substep of `dt` seconds under joint torques from outside (contact). `grip` is the
    /// stiffness of a contact with what stands, about the base's origin in base axes, which the
    /// step takes implicitly.
    pub(super) fn step(
        &mut self,
        drive: &ArmDrive,
        outside: &[f64; AXES],
        grip: Option<&Matrix6<f64>>,
        dt: f64,
    ) {
        let theta = self.model.joints_unchecked(&MotorPositions(self.m)).0;
        let ratios = self.motors_per_joint(&theta);
        let (inertia, impulse) = self.motor_loads(drive, &ratios, dt);
        let springs = self.springs(&theta, dt);
        let motors = MotorSide::new(&ratios, &inertia, &springs.implicit);
        let mut bw: [f64; AXES] = std::array::from_fn(|j| {
            (j..AXES).map(|k| ratios[k][j] * impulse[k]).sum::<f64>() - dt * springs.force[j]
        });
        let at_rest = motors.solve(&bw);
        let (mut a, mut v) = self.link_side(&motors, &springs, &at_rest, outside, dt);
        if let Some(grip) = grip {
            self.add_grip(&mut a, grip, dt * dt);
        }
        if !self.model.has_track {
            hold_track(&mut a, &mut v);
        }
        solve(&mut a, &mut v);
        for j in 0..AXES {
            bw[j] += springs.implicit[j] * v[j];
        }
        let w = motors.solve(&bw);
        self.advance(&v, &w, &ratios, dt);
        self.measure_currents(drive, dt);
        debug_assert!(self.q.iter().all(|q| q.is_finite()), "joints: {:?}", self.q);
        self.place();
    }

    /// Returns inertia and impulse of the motors at their shafts: diagonal inertia, linear speed
    /// term, friction as a bristle with a limit.
    fn motor_loads(
        &self,
        drive: &ArmDrive,
        ratios: &[[f64; AXES]; AXES],
        dt: f64,
    ) -> ([f64; AXES], [f64; AXES]) {
        let mut inertia = [0.0; AXES];
        let mut impulse = [0.0; AXES];
        for j in 0..AXES {
            let motor = &self.dynamics.motors[j];
            let coulomb = motor.coulomb / ratios[j][j].abs();
            let bristle = coulomb / PRESLIDING;
            let (torque, back_emf) = if drive.enabled {
                (motor.stall_torque * duty(drive, j), motor.stall_torque / motor.no_load_speed)
            } else {
                // The brake: so stiff that the shaft stands.
                (0.0, 1e6)
            };
            let load = torque + self.counterbalance[j];
            let friction = -bristle * self.bristles[j];
            // Sliding: no stiffness of the bristle, so that the limit is not overshot within the step.
            let sliding =
                self.bristles[j].abs() >= PRESLIDING * 0.999 && self.vm[j] * self.bristles[j] > 0.0;
            let stiffness = if sliding { 0.0 } else { bristle };
            inertia[j] = motor.inertia + dt * (motor.viscous + back_emf) + dt * dt * stiffness;
            impulse[j] = motor.inertia * self.vm[j] + dt * (load + friction);
        }
        (inertia, impulse)
    }

    /// Returns the springs between motors, which take the joints to `theta`, and links. Within the
    /// play of a gear only its damping acts.
    fn springs(&self, theta: &[f64; AXES], dt: f64) -> Springs {
        let d = &self.dynamics;
        let stretch: [f64; AXES] = std::array::from_fn(|j| {
            let (off, play) = (theta[j] - self.q[j], d.play[j]);
            off - off.clamp(-play, play)
        });
        Springs {
            force: std::array::from_fn(|j| d.stiffness[j] * stretch[j]),
            implicit: std::array::from_fn(|j| {
                let free = stretch[j] == 0.0 && d.play[j] > 0.0;
                let stiffness = if free { 0.0 } else { d.stiffness[j] };
                dt * (d.damping[j] + dt * stiffness)
            }),
        }
    }

    /// Returns matrix and right side of the links' equation with the motors eliminated: `(M + S - S
    /// (Mm + S)^-1 S) v = bv + S (Mm + S)^-1 bw`. `at_rest` are the motors' speeds with links that
    /// stand.
    fn link_side(
        &self,
        motors: &MotorSide,
        springs: &Springs,
        at_rest: &[f64; AXES],
        outside: &[f64; AXES],
        dt: f64,
    ) -> ([[f64; AXES]; AXES], [f64; AXES]) {
        let (mass, bias, s) = (&self.mass, &self.bias, &springs.implicit);
        let mut a = *mass;
        let mut b = [0.0; AXES];
        for i in 0..AXES {
            let momentum: f64 = (0..AXES).map(|k| mass[i][k] * self.v[k]).sum();
            b[i] = momentum + dt * (springs.force[i] - bias[i] + outside[i]) + s[i] * at_rest[i];
            a[i][i] += s[i];
        }
        for j in MotorSide::SINGLE {
            a[j][j] -= s[j] * s[j] / motors.single[j];
        }
        for i in 0..4 {
            for k in 0..4 {
                a[i + 2][k + 2] -= s[i + 2] * motors.inverse[i][k] * s[k + 2];
            }
        }
        (a, b)
    }

    /// Moves links with the velocities `v` and motors with those that `w`, in joint coordinates,
    /// makes of them; hard stops hold the motors.
    fn advance(&mut self, v: &[f64; AXES], w: &[f64; AXES], ratios: &[[f64; AXES]; AXES], dt: f64) {
        self.v = *v;
        for j in 0..AXES {
            self.q[j] += dt * v[j];
            let vm: f64 = (0..=j).map(|k| ratios[j][k] * w[k]).sum();
            self.vm[j] = if j == 0 && !self.model.has_track { 0.0 } else { vm };
            self.m[j] += dt * self.vm[j];
            self.bristles[j] = (self.bristles[j] + dt * self.vm[j]).clamp(-PRESLIDING, PRESLIDING);
            let (low, high) = self.model.motor_limits[j];
            let beyond = SWITCH + OVERTRAVEL;
            let stopped = self.m[j].clamp(low - beyond, high + beyond);
            if stopped != self.m[j] {
                self.m[j] = stopped;
                self.vm[j] = 0.0;
            }
        }
    }

    /// Takes the motors' currents at their present speeds, and what heats their windings.
    fn measure_currents(&mut self, drive: &ArmDrive, dt: f64) {
        for j in 0..AXES {
            let motor = &self.dynamics.motors[j];
            self.currents[j] = if drive.enabled {
                motor.stall_current * (duty(drive, j) - self.vm[j] / motor.no_load_speed)
            } else {
                0.0
            };
            let load = (self.currents[j] / motor.rated_current).powi(2);
            self.heat[j] += dt / MotorDynamics::HEATS * (load - self.heat[j]);
        }
    }

    /// Raises the greatest current, heat and motor speed of a run to the present ones.
    pub(super) fn exert(&self, most: &mut Exertion) {
        for (j, motor) in self.dynamics.motors.iter().enumerate() {
            most.current = most.current.max(self.currents[j].abs() / motor.trip_current);
            most.heat = most.heat.max(self.heat[j]);
            most.motor_speed = most.motor_speed.max(self.vm[j].abs());
        }
    }

    /// Adds `factor J^T K J` of a contact stiffness.
    fn add_grip(&self, a: &mut [[f64; AXES]; AXES], grip: &Matrix6<f64>, factor: f64) {
        let flat: [[f64; 6]; AXES] = std::array::from_fn(|j| {
            let s = &self.placement.screws[j];
            [s.l.x, s.l.y, s.l.z, s.a.x, s.a.y, s.a.z]
        });
        for j in 0..AXES {
            let ks: [f64; 6] =
                std::array::from_fn(|r| (0..6).map(|c| grip[(r, c)] * flat[j][c]).sum());
            for i in 0..=j {
                let sum: f64 = factor * (0..6).map(|r| flat[i][r] * ks[r]).sum::<f64>();
                a[i][j] += sum;
                if i != j {
                    a[j][i] += sum;
                }
            }
        }
    }

    /// Base frame in the world.
    pub(super) fn world_from_base(&self) -> &Frame {
        &self.world_from_base
    }

    /// Encoders, currents and switches.
    pub(super) fn read(&mut self, drive: &ArmDrive, reading: &mut ArmReading) {
        reading.upper_limits = 0;
        reading.lower_limits = 0;
        reading.over_currents = 0;
        reading.power_faults = 0;
        reading.sync_switches = 0;
        reading.encoder_zeros = 0;
        reading.synchronised = 0;
        for j in 0..AXES {
            let bit = 1 << j;
            if j == 0 && !self.model.has_track {
                reading.counts[0] = 0;
                reading.currents[0] = 0.0;
                reading.synchronised |= bit;
                continue;
            }
            let report = self.encoders[j].read(self.m[j], drive.synchronise & bit != 0);
            reading.counts[j] = report.count;
            reading.sync_switches |= u8::from(report.switch) << j;
            reading.encoder_zeros |= u8::from(report.zero) << j;
            reading.synchronised |= u8::from(report.synchronised) << j;
            reading.currents[j] = self.currents[j];
            let (low, high) = self.model.motor_limits[j];
            if self.m[j] < low - SWITCH {
                reading.lower_limits |= bit;
            } else if self.m[j] > high + SWITCH {
                reading.upper_limits |= bit;
            }
            if self.currents[j].abs() > self.dynamics.motors[j].trip_current || self.heat[j] > 1.0 {
                reading.over_currents |= bit;
            }
        }
    }

    /// Moves the whole arm.
    #[cfg(test)]
    pub(super) fn shift(&mut self, by: &Vector3<f64>) {
        self.world_from_base.p += by;
        self.place();
    }

    /// Compliance at a point of the last link with locked motors: displacement and rotation in the world per
    /// force and torque there.
    #[cfg(test)]
    pub(super) fn compliance(&self, point: &Vector3<f64>) -> Matrix6<f64> {
        let mut sum = Matrix6::zeros();
        let r = &self.world_from_base.r;
        let p = r.tr_mul(&(point - self.world_from_base.p));
        for (s, k) in self.placement.screws.iter().zip(&self.dynamics.stiffness) {
            let (d, w) = (r * (s.l + s.a.cross(&p)), r * s.a);
            let column = nalgebra::Vector6::new(d.x, d.y, d.z, w.x, w.y, w.z);
            sum += column * column.transpose() / *k;
        }
        sum
    }

    /// Kinetic energy, of springs, and of height (J): for tests.
    #[cfg(test)]
    pub(super) fn energy(&self) -> f64 {
        let (mass, _) = self.placement.dynamics(&self.dynamics.links, &self.v, &self.gravity);
        let theta = self.model.joints_unchecked(&MotorPositions(self.m)).0;
        let mut sum = 0.0;
        for (i, row) in mass.iter().enumerate() {
            sum += 0.5 * self.v[i] * row.iter().zip(&self.v).map(|(m, v)| m * v).sum::<f64>();
            sum += 0.5 * self.dynamics.stiffness[i] * (theta[i] - self.q[i]).powi(2);
            sum += 0.5 * self.dynamics.motors[i].inertia * self.vm[i] * self.vm[i];
            let link = &self.dynamics.links[i];
            let centre = self.placement.frames[i].point(&Vector3::from(link.centre));
            sum -= link.mass * self.gravity.dot(&centre);
        }
        sum
    }
}

/// Springs between motors and links, seen at the joints.
struct Springs {
    /// Their force (N, Nm).
    force: [f64; AXES],
    /// The factor of the relative velocity when the step takes them implicitly: `dt (D + dt K)`.
    implicit: [f64; AXES],
}

/// The motors' equation in joint coordinates, `(Mm + S) w = b`, ready to be solved.
struct MotorSide {
    /// Inverse of the block of axes 2..=5, which are coupled.
    inverse: [[f64; 4]; 4],
    /// The diagonal; of [`MotorSide::SINGLE`] axes it is all there is.
    single: [f64; AXES],
}

impl MotorSide {
    /// Axes that are coupled with no other one.
    const SINGLE: [usize; 3] = [0, 1, 6];

    fn new(ratios: &[[f64; AXES]; AXES], inertia: &[f64; AXES], s: &[f64; AXES]) -> Self {
        let mut coupled = [[0.0; 4]; 4];
        for a in 0..4 {
            for b in 0..=a {
                let sum: f64 = (a.max(b)..4)
                    .map(|k| ratios[k + 2][a + 2] * inertia[k + 2] * ratios[k + 2][b + 2])
                    .sum();
                coupled[a][b] = sum;
                coupled[b][a] = sum;
            }
            coupled[a][a] += s[a + 2];
        }
        let single = std::array::from_fn(|j| inertia[j] * ratios[j][j] * ratios[j][j] + s[j]);
        Self { inverse: inverse4(&coupled), single }
    }

    /// Returns the motors' velocities in joint coordinates for a right side `b`.
    fn solve(&self, b: &[f64; AXES]) -> [f64; AXES] {
        let mut w = [0.0; AXES];
        for j in Self::SINGLE {
            w[j] = b[j] / self.single[j];
        }
        for i in 0..4 {
            w[i + 2] = (0..4).map(|k| self.inverse[i][k] * b[k + 2]).sum();
        }
        w
    }
}

/// Returns an axis's pulse width as a share of the full one.
fn duty(drive: &ArmDrive, axis: usize) -> f64 {
    f64::from(drive.pwm[axis].clamp(-255, 255)) / 255.0
}

/// Takes axis 0 out of the links' equation: an arm without a track does not move there.
fn hold_track(a: &mut [[f64; AXES]; AXES], b: &mut [f64; AXES]) {
    a[0] = [0.0; AXES];
    for row in a.iter_mut() {
        row[0] = 0.0;
    }
    a[0][0] = 1.0;
    b[0] = 0.0;
}

/// Inverse of a symmetric positive definite 4 x 4 matrix.
fn inverse4(a: &[[f64; 4]; 4]) -> [[f64; 4]; 4] {
    let m = nalgebra::Matrix4::from_fn(|i, j| a[i][j]);
    // A positive definite matrix has an inverse; the fallback only keeps a NaN from becoming a panic.
    let inverse = m.try_inverse().unwrap_or_else(nalgebra::Matrix4::zeros);
    std::array::from_fn(|i| std::array::from_fn(|j| inverse[(i, j)]))
}
