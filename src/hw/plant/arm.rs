//! One arm of the plant: motors behind elastic joints, encoders, currents and limit switches.
//!
//! - in: drives, the wrench that the cube or an obstacle exerts on the arm
//! - out: joint positions, readings
//! - links: `M q'' + h = K (f(m) - q) + D (f'(m) m' - q') + J^T w`
//! - motors: rotor inertia, pulse width, back-EMF and friction, at the shaft
//! - step: one linearly implicit Euler step for both sides together. Springs, dampers and back-EMF
//!   count at its end, so 8 kNm/rad on a wrist of 0.04 kg m2 stays stable at 0.5 ms. The step
//!   eliminates the motors (a 4 x 4 block and three scalars) and solves the 7 x 7 system of the
//!   links.

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

/// Displacement up to which a motor's friction acts as a spring (rad of the shaft).
const PRESLIDING: f64 = 0.005;
/// Distance of a limit switch beyond the software limit (rad of the shaft). In the period in which
/// the set value passes the limit, it stays short of the switch.
const SWITCH: f64 = 1.0;
/// Distance of the hard stop beyond the limit switch (rad of the shaft).
const OVERTRAVEL: f64 = 3.0;

/// Stretch of a joint's spring at which a saved state is refused (m, rad): no spring stretches so
/// far.
const MOST_STRETCH: f64 = 0.3;
/// Excess over its limit that rounding may give a saved number (rad).
const ROUNDING: f64 = 1e-6;

/// State and constants of an arm.
#[derive(Clone)]
pub(super) struct PlantArm {
    model: ArmModel,
    dynamics: ArmDynamics,
    world_from_base: Frame,
    flange_from_tool: Frame,
    gravity: Vector3<f64>,
    /// Joint positions (m, rad).
    pub(super) q: [f64; AXES],
    /// Joint velocities (m/s, rad/s).
    pub(super) v: [f64; AXES],
    /// Motor positions (rad).
    pub(super) m: [f64; AXES],
    /// Motor velocities (rad/s).
    pub(super) vm: [f64; AXES],
    /// Stretch of the friction's bristles (rad of the shaft).
    bristles: [f64; AXES],
    /// Torque of the counterbalance springs at the motors (Nm).
    counterbalance: [f64; AXES],
    /// Mean square of each current over the motors' thermal time constant, as a share of the rated
    /// current's square.
    heat: [f64; AXES],
    /// Motor currents (A).
    currents: [f64; AXES],
    encoders: [Encoder; AXES],
    /// Mass matrix and bias at the beginning of the period: within 2 ms they change by parts in a
    /// thousand.
    mass: [[f64; AXES]; AXES],
    bias: [f64; AXES],
    /// Frames and screws at the present `q`.
    pub(super) placement: Placement,
    pub(super) world_from_flange: Frame,
    pub(super) world_from_tool: Frame,
}

/// State of an arm in a file.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct SavedArm {
    joints: [f64; AXES],
    motors: [f64; AXES],
    bristles: [f64; AXES],
    counterbalance: [f64; AXES],
    pub(super) encoders: Vec<Encoder>,
}

/// Returns the true joint positions of an arm at rest, and the load of gravity on each joint (N,
/// Nm). `encoders` are the joint positions that the motors' encoders give; gravity stretches the
/// springs between motors and joints.
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
            // The weight also takes up the play of the gear, to the side that it pulls to.
            let side = if weight[j] == 0.0 { 0.0 } else { weight[j].signum() };
            encoders[j] - weight[j] / dynamics.stiffness[j] - side * dynamics.play[j]
        });
    }
    (q, weight)
}

/// Returns the true `world_from_tool` of an arm at rest whose encoders give `joints`. The joints
/// are elastic, so the tool sags below the place that the encoders give.
#[must_use]
pub fn sagging(arm: &Arm, dynamics: &ArmDynamics, joints: &JointPositions) -> Pose {
    let world_from_base = Frame::from_pose(&arm.world_from_base);
    let gravity = world_from_base.r.tr_mul(&Vector3::new(0.0, 0.0, -GRAVITY)) * dynamics.gravity;
    let (q, _) = at_rest(&arm.model, dynamics, &gravity, &joints.0);
    arm.world_from_base * arm.model.base_from_flange(&JointPositions(q)) * arm.flange_from_tool
}

impl PlantArm {
    /// Makes an arm at rest whose encoders give the start pose. Its weight stretches the springs of
    /// the joints and loads the motors. With `synchronised` its counters are homed already.
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
                // Without a track there is no axis 0 to home.
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
        // Joint torques t load the motors with H^-T t; H is lower triangular, so substitution from
        // the last axis solves it.
        let mut at_motors = [0.0; AXES];
        for j in (0..AXES).rev() {
            let later: f64 = (j + 1..AXES).map(|k| ratios[k][j] * at_motors[k]).sum();
            at_motors[j] = (weight[j] - later) / ratios[j][j];
        }
        // The counterbalance springs are set for the start pose and stay so over the workspace.
        for j in [2, 3] {
            this.counterbalance[j] = at_motors[j] * dynamics.counterbalance;
        }
        // The presliding of the friction carries the rest, up to 0.9 of the Coulomb friction.
        // Unstretched bristles would let each axis sink when the run begins.
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

    /// Returns the state of the arm for the plant's file.
    pub(super) fn saved(&self) -> SavedArm {
        SavedArm {
            joints: self.q,
            motors: self.m,
            bristles: self.bristles,
            counterbalance: self.counterbalance,
            encoders: self.encoders.to_vec(),
        }
    }

    /// Checks that this arm can be in the saved state: motors between their hard stops, springs of
    /// the joints within their greatest stretch, encoders that fit these motors. The error names
    /// the wrong entry and the reason.
    pub(super) fn check_saved(&self, saved: &SavedArm) -> Result<(), Wrong> {
        let wrong =
            |place: &str, j: usize, why: &str| Err((format!("{place}[{j}]"), why.to_owned()));
        for j in 0..AXES {
            let (low, high) = self.model.motor_limits[j];
            let (beyond, motor) = (SWITCH + OVERTRAVEL + ROUNDING, saved.motors[j]);
            if !(low - beyond..=high + beyond).contains(&motor) {
                return wrong("motors", j, "beyond the hard stop");
            }
        }
        // Beyond their stops the motors have no joints: a ball screw has an end. So all motors are
        // checked first.
        let theta = self.model.joints_unchecked(&MotorPositions(saved.motors)).0;
        for (j, theta) in theta.iter().enumerate() {
            let off = (theta - saved.joints[j]).abs();
            if off.is_nan() || off >= MOST_STRETCH {
                return wrong("joints", j, "farther from its motor than its spring can stretch");
            }
            if saved.bristles[j].abs() > PRESLIDING + ROUNDING {
                return wrong("bristles", j, "stretched beyond the limit of the friction");
            }
            if !saved.encoders[j].fits(&self.encoders[j], saved.motors[j]) {
                return wrong("encoders", j, "not the encoder of this motor");
            }
        }
        Ok(())
    }

    /// Sets the arm to a saved state, at rest; `saved` has one encoder for each axis.
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

    /// Recomputes the frames of links, flange and tool from the joint positions `q`.
    pub(super) fn place(&mut self) {
        self.placement = Placement::new(&self.model, &self.q);
        self.world_from_flange = self.world_from_base.times(&self.placement.frames[6]);
        self.world_from_tool = self.world_from_flange.times(&self.flange_from_tool);
    }

    /// Returns the origins of base, shoulder, elbow, wrist pitch centre and flange in the world.
    pub(super) fn points(&self) -> [Vector3<f64>; 5] {
        let f = &self.placement.frames;
        // The base's origin lies on the floor below the shoulder; on a track it moves with the
        // carriage.
        let floor = Vector3::new(f[1].p.x, f[1].p.y, 0.0);
        [floor, f[1].p, f[3].p, f[4].p, f[6].p].map(|p| self.world_from_base.point(&p))
    }

    /// Returns the velocity of a point fixed to the last link and the link's angular velocity, in
    /// the world (m/s, rad/s).
    pub(super) fn velocity_at(&self, point: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        self.velocity_of(AXES - 1, point)
    }

    /// Returns the velocity of a point fixed to a link and the link's angular velocity, in the
    /// world (m/s, rad/s).
    fn velocity_of(&self, link: usize, point: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let twist = self.placement.twist_of(link, &self.v);
        let local = self.world_from_base.r.tr_mul(&(point - self.world_from_base.p));
        let r = &self.world_from_base.r;
        (r * (twist.l + twist.a.cross(&local)), r * twist.a)
    }

    /// Returns the speed of the fastest point of forearm, wrist and hand for which `is_near` holds
    /// (m/s); 0 if there is none. `fingers` is the distance of the finger tips beyond the tool (m).
    pub(super) fn fastest(&self, fingers: f64, is_near: impl Fn(&Vector3<f64>) -> bool) -> f64 {
        /// Number of sections into which each part is divided.
        const POINTS: u32 = 6;
        let [_, _, elbow, pitch, flange] = self.points();
        let tool = &self.world_from_tool;
        let tips = tool.p + tool.r.column(2) * fingers;
        // Each part with the link that carries it.
        let parts = [(3, elbow, pitch), (4, pitch, flange), (6, flange, tool.p), (6, tool.p, tips)];
        let mut fastest = 0.0_f64;
        for (link, from, to) in parts {
            for point in 0..=POINTS {
                let at = from.lerp(&to, f64::from(point) / f64::from(POINTS));
                if is_near(&at) {
                    fastest = fastest.max(self.velocity_of(link, &at).0.norm());
                }
            }
        }
        fastest
    }

    /// Returns the joint forces and torques (N, Nm) that a force (N) at `point` and a torque (Nm)
    /// on the last link cause. All arguments are in the world.
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

    /// Returns the matrix H = dm/dq at the joint positions `q`, which takes joint velocities to
    /// motor velocities. It is lower triangular.
    fn motors_per_joint(&self, q: &[f64; AXES]) -> [[f64; AXES]; AXES] {
        let model = &self.model;
        // Slope of a ball screw's length sqrt(sl + mi cos a - ni sin a) over the link angle a
        // (cosine rule).
        let screw = |&[sl, mi, ni, _]: &[f64; 4], angle: f64| {
            let (s, c) = libm::sincos(angle);
            -(mi * s + ni * c) / (2.0 * (sl + mi * c - ni * s).sqrt())
        };
        let g = &model.gears;
        // The screw of the upper arm acts on the arm's absolute angle t3, so its motor follows
        // joint 2 as well.
        let t3 = q[2] + q[3] + std::f64::consts::FRAC_PI_2;
        let h3 = g[3] * screw(&model.upper_screw, t3 - model.offsets[3]);
        let mut h = [[0.0; AXES]; AXES];
        // Without a track a 1 keeps the matrix regular.
        h[0][0] = if model.has_track { g[0] } else { 1.0 };
        h[1][1] = g[1];
        h[2][2] = g[2] * screw(&model.lower_screw, q[2] - model.offsets[2]);
        h[3][2] = h3;
        h[3][3] = h3;
        // Both wrist motors follow the absolute pitch q2 + q3 + q4; the second one adds the roll.
        h[4][2..5].fill(g[4]);
        h[5][2..5].fill(g[4]);
        h[5][5] = g[5];
        h[6][6] = g[6];
        h
    }

    /// Computes the mass matrix and the bias torques (Coriolis, centrifugal, gravity) at the
    /// present joint positions and velocities.
    pub(super) fn begin_period(&mut self) {
        (self.mass, self.bias) =
            self.placement.dynamics(&self.dynamics.links, &self.v, &self.gravity);
    }

    /// Performs one substep of `dt` (s). `outside` are the joint torques of contacts. `grip` is the
    /// stiffness of a contact between the tool and a body that does not move, about the base's
    /// origin in base axes; the integration treats it implicitly.
    pub(super) fn step(
        &mut self,
        drive: &ArmDrive,
        outside: &[f64; AXES],
        grip: Option<&Matrix6<f64>>,
        dt: f64,
    ) {
        let theta = self.held_joints();
        let ratios = self.motors_per_joint(&theta);
        let (inertia, impulse) = self.motor_loads(drive, &ratios, dt);
        let springs = self.springs(&theta, dt);
        let motors = MotorSide::new(&ratios, &inertia, &springs.implicit);
        // H^T takes the impulses at the shafts to the joints.
        let mut bw: [f64; AXES] = std::array::from_fn(|j| {
            (j..AXES).map(|k| ratios[k][j] * impulse[k]).sum::<f64>() - dt * springs.force[j]
        });
        let at_rest = motors.solve(&bw);
        let (mut a, mut v) = self.link_side((&motors, &at_rest), &springs, outside, dt);
        // At the end of the step the contact's force is smaller by K dt v: an impulse of dt^2 K v.
        if let Some(grip) = grip {
            self.add_grip(&mut a, grip, dt * dt);
        }
        if !self.model.has_track {
            hold_track(&mut a, &mut v);
        }
        solve(&mut a, &mut v);
        for j in 0..AXES {
            // Back substitution: the links' new velocities drive the motors through the springs.
            bw[j] += springs.implicit[j] * v[j];
        }
        let w = motors.solve(&bw);
        self.advance(&v, &w, &ratios, dt);
        self.measure_currents(drive, dt);
        debug_assert!(self.q.iter().all(|q| q.is_finite()), "joints: {:?}", self.q);
        self.place();
    }

    /// Returns the effective inertia of each motor shaft and the impulse on it in a step of `dt`
    /// (s). Without the springs of the joints the new motor speed would be the impulse over the
    /// inertia. Back-EMF, brake and friction (a bristle with a limit) are included; `ratios` is the
    /// matrix of `motors_per_joint`.
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
            // Coulomb friction is given at the joint; the present ratio takes it to the shaft.
            let coulomb = motor.coulomb / ratios[j][j].abs();
            let bristle = coulomb / PRESLIDING;
            // A DC motor: its torque falls linearly with speed, from stall to the no-load speed.
            let (torque, back_emf) = if drive.enabled {
                (motor.stall_torque * duty(drive, j), motor.stall_torque / motor.no_load_speed)
            } else {
                // The brake: a damper of 1e6 Nms/rad does not let the shaft turn.
                (0.0, 1e6)
            };
            let load = torque + self.counterbalance[j];
            let friction = -bristle * self.bristles[j];
            // A sliding bristle has no stiffness, or its friction would pass the limit within the
            // step.
            let sliding =
                self.bristles[j].abs() >= PRESLIDING * 0.999 && self.vm[j] * self.bristles[j] > 0.0;
            let stiffness = if sliding { 0.0 } else { bristle };
            // Speed and bristle count at the end of the step, so dt (c + dt k) adds to the inertia.
            inertia[j] = motor.inertia + dt * (motor.viscous + back_emf) + dt * dt * stiffness;
            impulse[j] = motor.inertia * self.vm[j] + dt * (load + friction);
        }
        (inertia, impulse)
    }

    /// Returns the springs between motors and links. `theta` are the joint positions at which the
    /// present motor positions leave the springs unstretched. Within the play of a gear only the
    /// damping acts.
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

    /// Returns the matrix and the right side of the equation for the links' new velocities v, after
    /// the elimination of the motors: `(M + S - S (Mm + S)^-1 S) v = bv + S (Mm + S)^-1 bw`. M and
    /// Mm are the mass matrices of links and motors in joint coordinates, S is the implicit factor
    /// of the springs. `at_rest` is `(Mm + S)^-1 bw`, the motors' velocities if the links did not
    /// move.
    fn link_side(
        &self,
        (motors, at_rest): (&MotorSide, &[f64; AXES]),
        springs: &Springs,
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
        // S (Mm + S)^-1 S is diagonal but for the four coupled axes.
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

    /// Moves the links for `dt` (s) with the joint velocities `v`, and the motors with `w`, the
    /// motors' velocities in joint coordinates. Hard stops hold the motors.
    fn advance(&mut self, v: &[f64; AXES], w: &[f64; AXES], ratios: &[[f64; AXES]; AXES], dt: f64) {
        self.v = *v;
        for j in 0..AXES {
            self.q[j] += dt * v[j];
            let vm: f64 = (0..=j).map(|k| ratios[j][k] * w[k]).sum();
            self.vm[j] = if j == 0 && !self.model.has_track { 0.0 } else { vm };
            self.m[j] += dt * self.vm[j];
            // At its limit the bristle slides along with the shaft: the force stays at Coulomb
            // friction.
            self.bristles[j] = (self.bristles[j] + dt * self.vm[j]).clamp(-PRESLIDING, PRESLIDING);
            let (low, high) = self.model.motor_limits[j];
            let beyond = SWITCH + OVERTRAVEL;
            let stopped = self.m[j].clamp(low - beyond, high + beyond);
            // A hard stop takes up all momentum: there is no rebound.
            if stopped != self.m[j] {
                self.m[j] = stopped;
                self.vm[j] = 0.0;
            }
        }
    }

    /// Computes the currents at the motors' present speeds, and the heat of their windings.
    fn measure_currents(&mut self, drive: &ArmDrive, dt: f64) {
        for j in 0..AXES {
            let motor = &self.dynamics.motors[j];
            self.currents[j] = if drive.enabled {
                motor.stall_current * (duty(drive, j) - self.vm[j] / motor.no_load_speed)
            } else {
                0.0
            };
            // Losses grow with the square of the current; a winding follows them with one time
            // constant.
            let load = (self.currents[j] / motor.rated_current).powi(2);
            self.heat[j] += dt / MotorDynamics::HEATS * (load - self.heat[j]);
        }
    }

    /// Raises the run's greatest current, heat and motor speed in `most` to those of this arm.
    pub(super) fn exert(&self, most: &mut Exertion) {
        for (j, motor) in self.dynamics.motors.iter().enumerate() {
            most.current = most.current.max(self.currents[j].abs() / motor.trip_current);
            most.heat = most.heat.max(self.heat[j]);
            most.motor_speed = most.motor_speed.max(self.vm[j].abs());
        }
    }

    /// Adds `factor J^T K J` to the links' matrix `a`; K is the contact stiffness `grip`, J the
    /// arm's Jacobian.
    fn add_grip(&self, a: &mut [[f64; AXES]; AXES], grip: &Matrix6<f64>, factor: f64) {
        // The stiffness has translations first, a screw has its rotation first.
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

    /// Returns the joint positions at which the springs of the gears are unstretched (rad or m).
    pub(super) fn held_joints(&self) -> [f64; AXES] {
        self.model.joints_unchecked(&MotorPositions(self.m)).0
    }

    /// Returns the base frame in the world.
    pub(super) fn world_from_base(&self) -> &Frame {
        &self.world_from_base
    }

    /// Writes encoder counts and zeros, motor currents, limit and synchronisation switches and
    /// over-current flags into `reading`. `drive` has the orders to synchronise.
    pub(super) fn read(&mut self, drive: &ArmDrive, reading: &mut ArmReading) {
        reading.upper_limits = 0;
        reading.lower_limits = 0;
        reading.over_currents = 0;
        reading.power_faults = 0;
        reading.sync_switches = 0;
        // Only the scenario's list of faults sets an input of the simulated interface.
        reading.inputs = 0;
        reading.encoder_zeros = 0;
        reading.synchronised = 0;
        for j in 0..AXES {
            let bit = 1 << j;
            // Without a track axis 0 reports a synchronised motor at rest.
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
            // A power stage trips on its present current at once, and on its heat after a time.
            if self.currents[j].abs() > self.dynamics.motors[j].trip_current || self.heat[j] > 1.0 {
                reading.over_currents |= bit;
            }
        }
    }

    /// Moves the whole arm, with its base, by a displacement in the world (m).
    #[cfg(test)]
    pub(super) fn shift(&mut self, by: &Vector3<f64>) {
        self.world_from_base.p += by;
        self.place();
    }

    /// Returns the compliance at a point of the last link with locked motors: displacement and
    /// rotation in the world per force and torque there.
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

    /// Returns the sum of the kinetic, elastic and potential energy (J).
    #[cfg(test)]
    pub(super) fn energy(&self) -> f64 {
        let (mass, _) = self.placement.dynamics(&self.dynamics.links, &self.v, &self.gravity);
        let theta = self.held_joints();
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
    /// Force of the springs (N, Nm).
    force: [f64; AXES],
    /// Factor of the relative velocity in an implicit step: `dt (D + dt K)`.
    implicit: [f64; AXES],
}

/// Equation of the motors in joint coordinates, `(Mm + S) w = b`, ready to be solved.
struct MotorSide {
    /// Inverse of the block of axes 2..=5, which are coupled.
    inverse: [[f64; 4]; 4],
    /// Diagonal; an axis of [`MotorSide::SINGLE`] has no other entry.
    single: [f64; AXES],
}

impl MotorSide {
    /// Axes without a coupling to another one.
    const SINGLE: [usize; 3] = [0, 1, 6];

    /// Makes the equation from `ratios`, the matrix of `motors_per_joint`, the effective `inertia`
    /// of each motor shaft (kg m2), and `s`, the implicit factor of the springs.
    fn new(ratios: &[[f64; AXES]; AXES], inertia: &[f64; AXES], s: &[f64; AXES]) -> Self {
        // H^T Mm H + S of axes 2..=5: motors 3 to 5 follow more than one joint.
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

    /// Solves `(Mm + S) w = b` for `w`, the motors' velocities in joint coordinates.
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

/// Returns an axis's pulse width as a share of the full width, -1 to 1.
fn duty(drive: &ArmDrive, axis: usize) -> f64 {
    f64::from(drive.pwm[axis].clamp(-255, 255)) / 255.0
}

/// Replaces the row of axis 0 in the links' equation `a v = b` by v0 = 0, since an arm without a
/// track does not move there.
fn hold_track(a: &mut [[f64; AXES]; AXES], b: &mut [f64; AXES]) {
    a[0] = [0.0; AXES];
    for row in a.iter_mut() {
        row[0] = 0.0;
    }
    a[0][0] = 1.0;
    b[0] = 0.0;
}

/// Returns the inverse of a symmetric positive definite 4 x 4 matrix.
fn inverse4(a: &[[f64; 4]; 4]) -> [[f64; 4]; 4] {
    let m = nalgebra::Matrix4::from_fn(|i, j| a[i][j]);
    // A positive definite matrix has an inverse; the fallback keeps a NaN from becoming a panic.
    let inverse = m.try_inverse().unwrap_or_else(nalgebra::Matrix4::zeros);
    std::array::from_fn(|i| std::array::from_fn(|j| inverse[(i, j)]))
}
