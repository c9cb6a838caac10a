//! The simulated plant: arms, jaws, cube, operator's hand and sensors behind the same port as real hardware.
//!
//! - in: drives, once a servo period
//! - out: readings at the period's end; beside the port a [`Scene`] for the cameras and a [`Verdict`] for
//!   summaries, neither of which a controller may see
//! - 4 substeps of 0.5 ms a period; no allocation in a period; one seeded generator per source of chance,
//!   sines from `libm`: the same bits in every run
//! - it knows nothing of the task or the controller, and only the true values of the cell

mod arm;
mod balance;
mod collision;
pub mod config;
mod cube;
pub mod dynamics;
mod frame;
mod grasp;
mod hand;
mod jaw;
pub mod render;
mod sensor;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
pub mod truth;
pub mod verdict;

pub use config::{
    ArmDynamics, CubeMechanics, HandScript, Jaws, MotorDynamics, PlantConfig, SensorNoise, Start,
};
pub use verdict::{Counts, Event, Incident, Part, Verdict, Whereabouts};

use self::arm::PlantArm;
use self::balance::{Balance, HandHold, Split, layer_angle, moved};
use self::collision::{Collisions, HeldCube};
use self::cube::{Layers, Puzzle};
use self::frame::{Frame, about, nearest_alignment, rotation_vector};
use self::grasp::{Grasp, Hands, Touch};
use self::hand::{OperatorHand, Sight};
use self::jaw::PlantJaw;
use self::sensor::WristSensor;
use super::port::{Port, PortFault};
use super::scene::{Scene, SceneArm, SceneCube};
use crate::cell::{Cell, Gripper};
use crate::cube::{Axis, Face};
use crate::motion::{AXES, Depth, PERIOD};
use crate::servo::io::{ArmDrive, ArmReading};
use crate::spatial::Twist;
use nalgebra::{Point3, Vector3};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// Pads that press more than this are on the cube [N].
const CLOSED: f64 = 0.2;
/// Pads farther from the cube than this have let go [m].
const OPEN_GAP: f64 = 1e-4;
/// Overlap of a pad with a layer from which on it holds the layer [m].
const OVERLAP: f64 = 1e-3;
/// What is left of a layer's misalignment when pads close over it and its neighbour.
const FLUSH: f64 = 0.1;

/// Where the cube is, as a state.
#[derive(Debug, Clone, Copy, PartialEq)]
enum State {
    Held,
    Falling { velocity: Vector3<f64> },
    Tray { down: Face },
}

/// The simulated cell. See the module.
#[derive(Clone)]
pub struct Plant {
    config: PlantConfig,
    arms: Vec<PlantArm>,
    jaws: Vec<PlantJaw>,
    sensors: Vec<WristSensor>,
    stops: [Depth; 2],
    puzzle: Puzzle,
    balance: Balance,
    grasps: [Grasp; 2],
    hand: OperatorHand,
    state: State,
    last_holder: Option<usize>,
    period: u64,
    core: Frame,
    velocity: Twist,
    watch: JamWatch,
    collisions: Collisions,
    fronts: [bool; 2],
    popped: bool,
    crushed: [bool; 2],
    saturated: [bool; 2],
    operator_has: bool,
    /// Relative angle of the two bodies when they were formed [rad].
    angle_at_split: f64,
    verdict: Verdict,
}

/// Looks for a loaded layer that does not move.
#[derive(Debug, Clone, Copy, Default)]
struct JamWatch {
    angle: f64,
    since: u64,
    reported: bool,
}

impl Plant {
    /// A plant at rest.
    ///
    /// # Errors
    /// [`PortFault`] when the cell has no arm or more than two, or the lists of the configuration do not fit.
    pub fn new(config: PlantConfig, seed: u64) -> Result<Self, PortFault> {
        let count = config.cell.arms.len();
        if !(1..=2).contains(&count) || config.arms.len() != count {
            let reason = format!("the plant needs 1 or 2 arms with dynamics, not {count}");
            return Err(PortFault { effector: 0, reason });
        }
        let stream = |which: u64| Pcg64::new(u128::from(seed), 0xcafe_f00d + u128::from(which));
        let cell = &config.cell;
        let edge = cell.cube.edge;
        let arms: Vec<PlantArm> =
            cell.arms.iter().zip(&config.arms).map(|(a, d)| PlantArm::new(a, d)).collect();
        let pad = 0.5 * config.jaws.stiffness[1];
        let closed = edge - 2.0 * config.start_grip / pad;
        let jaws = cell.arms.iter().enumerate().map(|(i, a)| {
            let opening = match config.start {
                Start::Hand => a.gripper.opening_of_motor[0] + a.gripper.opening_offset,
                Start::Held { arm, .. } if arm == i => closed,
                Start::Held { .. } => a.gripper.opening.1 - 0.005,
            };
            PlantJaw::new(&a.gripper, &config.jaws, opening)
        });
        let jaws = jaws.collect();
        let sensors = cell
            .arms
            .iter()
            .enumerate()
            .map(|(i, a)| WristSensor::new(&a.sensor, &config.noise, stream(10 + i as u64)))
            .collect();
        let mut friction = stream(1);
        let spread = config.cube.spread;
        let factors = std::array::from_fn(|_| {
            std::array::from_fn(|_| {
                let x: f64 = StandardNormal.sample(&mut friction);
                1.0 + spread * x.clamp(-2.0, 2.0)
            })
        });
        let puzzle = Puzzle::new(config.facelets, config.cube, factors);
        let mut hand = OperatorHand::new(&config.hand, &cell.hand, edge, &mut stream(2));
        let world_from_cube = match config.start {
            Start::Hand => hand.hold(0.0).unwrap_or_else(Frame::identity),
            Start::Held { arm, tool_from_cube } => {
                let Some(arm) = arms.get(arm) else {
                    let reason = "the cube is held by an arm that is not there".to_owned();
                    return Err(PortFault { effector: arm, reason });
                };
                hand.stay_away();
                arm.world_from_tool.times(&Frame::from_pose(&tool_from_cube))
            }
        };
        let mut this = Self {
            arms,
            jaws,
            sensors,
            stops: [Depth::One; 2],
            puzzle,
            balance: Balance::new(world_from_cube, edge),
            grasps: [Grasp::OPEN; 2],
            hand,
            state: State::Held,
            last_holder: None,
            period: 0,
            core: world_from_cube,
            velocity: Twist::default(),
            watch: JamWatch::default(),
            collisions: Collisions::default(),
            fronts: [false; 2],
            popped: false,
            crushed: [false; 2],
            saturated: [false; 2],
            operator_has: config.start == Start::Hand,
            angle_at_split: 0.0,
            verdict: Verdict::empty(&world_from_cube.to_pose()),
            config,
        };
        if let Start::Held { arm, .. } = this.config.start {
            if this.in_the_way_of_stops(arm) {
                this.stops[arm] = Depth::Two;
            }
            this.close(arm);
        }
        this.account();
        Ok(this)
    }

    /// What there is to be seen now.
    #[must_use]
    pub fn scene(&self) -> Scene {
        let axis = self.puzzle.turned_axis();
        let [negative, positive] = self.puzzle.angles[axis];
        let scene_arm = |i: usize| {
            let i = i.min(self.arms.len() - 1);
            let arm = &self.arms[i];
            SceneArm {
                points: arm.points().map(Point3::from),
                world_from_tool: arm.world_from_tool.to_pose(),
                world_from_flange: arm.world_from_flange.to_pose(),
                opening: self.jaws[i].opening(),
            }
        };
        Scene {
            period: self.period,
            cube: SceneCube {
                world_from_cube: self.core.to_pose(),
                velocity: self.velocity,
                edge: self.config.cell.cube.edge,
                facelets: *self.puzzle.stickers(),
                turned: (Axis::ALL[axis], negative, positive),
            },
            arms: [scene_arm(0), scene_arm(1)],
            arm_count: self.arms.len(),
            hand: self.hand.pose(self.time()).map(Frame::to_pose),
        }
    }

    /// What really happened so far. Allocates: not for the servo's loop.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let mut verdict = self.verdict.clone();
        verdict.facelets = self.puzzle.facelets();
        verdict.world_from_cube = self.core.to_pose();
        let axis = self.balance.split.map_or_else(|| self.puzzle.turned_axis(), |s| s.axis);
        verdict.turning = Axis::ALL[axis];
        verdict.layer_angles = self.puzzle.angles[axis];
        verdict.returned = self.hand.has_it_back();
        verdict.both_hold = self.both_hold();
        verdict.cube = match self.state {
            State::Tray { down } => Whereabouts::Tray { down },
            State::Falling { .. } => Whereabouts::Falling,
            State::Held if self.grasps.iter().any(Grasp::holds) => {
                Whereabouts::Arms(self.grasps.map(|g| g.holds()))
            }
            State::Held => Whereabouts::Hand,
        };
        verdict
    }

    /// The true values of the cell.
    #[must_use]
    pub fn cell(&self) -> &Cell {
        &self.config.cell
    }

    fn time(&self) -> f64 {
        self.period as f64 * PERIOD
    }

    fn both_hold(&self) -> bool {
        self.grasps.iter().all(Grasp::holds)
    }

    fn step(&mut self, drives: &[ArmDrive], t: f64, dt: f64) {
        for (i, drive) in drives.iter().enumerate() {
            if drive.enabled && !self.in_the_way_of_stops(i) {
                self.stops[i] = drive.stops;
            }
        }
        self.step_cube(t, dt);
        let touches = self.balance.touches;
        for (i, arm) in self.arms.iter_mut().enumerate() {
            let touch = &touches[i];
            let tool = arm.world_from_tool;
            if touch.any() {
                let (force, torque) = (tool.r * -touch.force, tool.r * -touch.torque);
                let mut outside = arm.torques(&force, &torque, &tool.p);
                for (sum, more) in outside.iter_mut().zip(&self.collisions.torques[i]) {
                    *sum += more;
                }
                let local = arm.world_from_base().to_local(&tool);
                let grip = moved(&touch.stiffness, &local.r, &local.p, &local.p);
                arm.step(&drives[i], &outside, Some(&grip), dt);
            } else {
                arm.step(&drives[i], &self.collisions.torques[i], None, dt);
            }
            let push = 0.5 * (touch.pads[0] + touch.pads[1]);
            let sides = f64::from(u8::from(touch.pads[0] > 0.0) + u8::from(touch.pads[1] > 0.0));
            let slope = 0.125 * self.config.jaws.stiffness[1] * sides;
            self.jaws[i].step(&drives[i], push, slope, dt);
        }
        self.change_grasps();
    }

    /// Whether a cube lies so deep in the hand that the stops cannot come forward.
    fn in_the_way_of_stops(&self, i: usize) -> bool {
        let cube = self.tool(i).to_local(&self.balance.nodes[0]).p;
        let half = 0.5 * self.config.cell.cube.edge;
        let between = -0.5 * (Gripper::FACE_BEHIND_TOOL_ONE + Gripper::FACE_BEHIND_TOOL_TWO);
        cube.x.abs() < half
            && cube.y.abs() < half
            && cube.z.abs() < 2.0 * half
            && cube.z - half < between
    }

    /// The cube's part of a substep.
    fn step_cube(&mut self, t: f64, dt: f64) {
        let edge = self.config.cell.cube.edge;
        self.balance.touches = [Touch::NONE; 2];
        match self.state {
            State::Held => {}
            State::Falling { mut velocity } => {
                velocity.z -= 9.81 * dt;
                let mut cube = self.balance.nodes[0];
                cube.p += velocity * dt;
                self.state = State::Falling { velocity };
                let lowest: f64 = (0..3).map(|i| cube.r[(2, i)].abs() * 0.5 * edge).sum();
                if cube.p.z - lowest <= self.config.cell.table_height {
                    self.land(&mut cube);
                }
                self.balance.place(cube);
                return;
            }
            State::Tray { .. } => {}
        }
        let hold = self.hand.hold(t).map(|world_from_cube| HandHold {
            world_from_cube,
            stiffness: self.config.hand.stiffness,
            damping: self.config.hand.damping,
        });
        let tools = [self.tool(0), self.tool(1)];
        let near = |i: usize| {
            i < self.arms.len() && (tools[i].p - self.balance.nodes[0].p).norm_squared() < 0.04
        };
        if !near(0) && !near(1) && !self.grasps.iter().any(|g| g.attached) {
            if let (Some(hold), State::Held) = (&hold, self.state) {
                self.balance.place(hold.world_from_cube);
                self.balance.hand_comes(&hold.world_from_cube);
            }
            return;
        }
        let hands: [Option<Hands>; 2] = std::array::from_fn(|i| {
            near(i).then(|| Hands {
                gripper: &self.config.cell.arms[i].gripper,
                jaws: &self.config.jaws,
                edge,
                opening: self.jaws[i].opening(),
                stops: self.stops[i],
            })
        });
        if let State::Tray { .. } = self.state {
            // The tray holds it: the grippers feel it, it stays where it is until pads close.
            for (i, hands) in hands.iter().enumerate() {
                if let Some(hands) = hands {
                    self.balance.touches[i] =
                        self.grasps[i].touch(&tools[i], &self.balance.nodes[0], hands);
                }
            }
            return;
        }
        let weight = Vector3::new(0.0, 0.0, -9.81 * self.config.cell.cube.mass);
        self.balance.step(
            &mut self.puzzle,
            &mut self.grasps,
            &tools,
            &hands,
            hold.as_ref(),
            &weight,
            dt,
        );
    }

    fn tool(&self, i: usize) -> Frame {
        self.arms[i.min(self.arms.len() - 1)].world_from_tool
    }

    /// A falling cube meets the tray: it topples onto the face that is lowest.
    fn land(&mut self, cube: &mut Frame) {
        let edge = self.config.cell.cube.edge;
        let lowest = |face: &Face| (cube.r * face.normal()).z;
        let down =
            Face::ALL.into_iter().min_by(|a, b| lowest(a).total_cmp(&lowest(b))).unwrap_or(Face::D);
        let out = cube.r * down.normal();
        let axis = out.cross(&-Vector3::z());
        let sine = axis.norm();
        if sine > 1e-9 {
            let angle = libm::atan2(sine, -out.z);
            cube.r = about(&(axis / sine), angle) * cube.r;
        }
        cube.p.z = self.config.cell.table_height + 0.5 * edge;
        self.state = State::Tray { down };
        self.record(Incident::Landed { down });
    }

    /// Pads that met the cube or left it.
    fn change_grasps(&mut self) {
        let edge = self.config.cell.cube.edge;
        for i in 0..self.arms.len() {
            let touch = self.balance.touches[i];
            let (attached, grip) = (self.grasps[i].attached, touch.grip());
            if !attached && grip > CLOSED && !matches!(self.state, State::Falling { .. }) {
                self.state = State::Held;
                self.close(i);
            } else if attached {
                let gone = touch.pads == [0.0; 2] && self.jaws[i].opening() > edge + OPEN_GAP;
                if gone {
                    self.open(i);
                } else if self.grasps[i].lost && !self.popped {
                    // A lost grasp has no friction; its pads may still be there.
                }
            }
        }
    }

    fn close(&mut self, i: usize) {
        let core = self.balance.core(&self.puzzle);
        let tool = self.tool(i);
        let held = self.layers_held(i, &core);
        for (axis, layers) in held.iter().enumerate() {
            for side in 0..2 {
                let outer = 1 << (2 * side);
                if layers & outer != 0 && layers & cube::MIDDLE != 0 {
                    // Pads over both layers press them flush, but for what the rubber gives.
                    self.puzzle.settle(axis);
                    self.puzzle.angles[axis][side] *= FLUSH;
                }
            }
        }
        // The layer that the pads touch stands by its misalignment off the core.
        let mut touched = core;
        for (axis, layers) in held.iter().enumerate() {
            let angle = layer_angle(&self.puzzle, axis, *layers);
            if matches!(layers, 1 | 4) {
                touched = touched.times(&Frame::rotated(about(&Axis::ALL[axis].unit(), angle)));
            }
        }
        let flat = Grasp::flat(&tool.to_local(&touched));
        let body = self.balance.nodes[0];
        let reference = flat.times(&touched.to_local(&body));
        self.grasps[i].close(0, &tool.to_local(&body), reference);
        self.last_holder = Some(i);
        self.verdict.grasps[i] += 1;
        self.record(Incident::Grasped { arm: i });
        self.regroup();
    }

    fn open(&mut self, i: usize) {
        self.grasps[i].attached = false;
        self.regroup();
        self.grasps[i] = Grasp::OPEN;
        self.record(Incident::Released { arm: i });
    }

    /// Decides whether the cube is one body or two.
    fn regroup(&mut self) {
        let split = self.find_split();
        let before = self.balance.split;
        self.balance.regroup(split, &mut self.puzzle, &mut self.grasps);
        if split != before {
            self.angle_at_split = self.relative_angle();
            self.watch = JamWatch { since: self.period, ..JamWatch::default() };
            self.verdict.turned = 0.0;
        }
    }

    fn find_split(&self) -> Option<Split> {
        if !self.grasps.iter().all(|g| g.attached) {
            return None;
        }
        let core = self.balance.core(&self.puzzle);
        let held = [self.layers_held(0, &core), self.layers_held(1, &core)];
        // Among axes that could turn: the one that is turned already, else that under a palm's lone layer.
        let palms = |axis: usize| {
            (0..2).any(|i| {
                let local = self.tool(i).to_local(&core);
                let along = nearest_alignment(&local.r)[(2, axis)] != 0.0;
                along && matches!(held[i][axis], 1 | 4)
            })
        };
        (0..3)
            .filter(|a| held[0][*a] & held[1][*a] == 0 && held[0][*a] != 0 && held[1][*a] != 0)
            .filter(|a| palms(*a))
            .max_by(|a, b| self.puzzle.misalignment(*a).total_cmp(&self.puzzle.misalignment(*b)))
            .map(|axis| Split { axis, layers: [held[0][axis], held[1][axis]] })
    }

    /// Layers of each axis that a gripper's pads hold: along the palm's axis by depth, across it by the pads'
    /// width, along the jaws the two outer ones by friction on their faces.
    fn layers_held(&self, i: usize, core: &Frame) -> [Layers; 3] {
        let g = &self.config.cell.arms[i].gripper;
        let third = self.config.cell.cube.edge / 3.0;
        let local = self.tool(i).to_local(core);
        let aligned = nearest_alignment(&local.r);
        let overlapping = |centre: f64, sense: f64, low: f64, high: f64| -> Layers {
            (0..3).fold(0, |set, layer| {
                let at = centre + sense * (f64::from(layer) - 1.0) * third;
                let overlap = (at + 0.5 * third).min(high) - (at - 0.5 * third).max(low);
                if overlap > OVERLAP { set | 1 << layer } else { set }
            })
        };
        std::array::from_fn(|axis| {
            let direction: Vector3<f64> = aligned.column(axis).into_owned();
            if direction.z != 0.0 {
                overlapping(local.p.z, direction.z, -g.palm, g.finger_tip)
            } else if direction.y != 0.0 {
                5
            } else {
                let half = 0.5 * g.finger_width;
                overlapping(local.p.x, direction.x, -half, half)
            }
        })
    }

    /// Angle of the second body's layer against the first's [rad].
    fn relative_angle(&self) -> f64 {
        self.balance.split.map_or(0.0, |s| {
            layer_angle(&self.puzzle, s.axis, s.layers[1])
                - layer_angle(&self.puzzle, s.axis, s.layers[0])
        })
    }

    /// The end of a period: what happened.
    fn account(&mut self) {
        let core = self.balance.core(&self.puzzle);
        let moved = (core.p - self.core.p) / PERIOD;
        let turned = rotation_vector(&(core.r * self.core.r.transpose())) / PERIOD;
        self.velocity = Twist { linear: moved, angular: turned };
        self.core = core;
        let both = self.both_hold();
        for i in 0..self.arms.len() {
            let touch = self.balance.touches[i];
            let (force, torque) = (touch.force.norm(), touch.torque.norm());
            let v = &mut self.verdict;
            v.arm_peak_force[i] = v.arm_peak_force[i].max(force);
            v.arm_peak_torque[i] = v.arm_peak_torque[i].max(torque);
            if both {
                v.peak_force = v.peak_force.max(force);
                v.peak_torque = v.peak_torque.max(torque);
            }
            let grasp = self.grasps[i];
            let (distance, angle) = grasp.slip;
            if grasp.attached && !grasp.reported && (distance > 1e-3 || angle > 3_f64.to_radians())
            {
                self.grasps[i].reported = true;
                self.verdict.counts.slips += 1;
                self.record(Incident::Slip { arm: i, distance, angle });
            }
            let squeeze = touch.pads[0].max(touch.pads[1]);
            if squeeze > 150.0 && !self.crushed[i] {
                self.crushed[i] = true;
                self.verdict.counts.crushed += 1;
                self.record(Incident::Crush { arm: i, squeeze });
            }
        }
        self.look_for_drop();
        self.look_for_pop_and_jam();
        let sight = Sight {
            cube: self.core,
            speed: self.velocity.linear.norm(),
            grippers: self.grasps.iter().filter(|g| g.holds()).count(),
            load: self.balance.touches.iter().map(|t| t.force.norm()).fold(0.0, f64::max),
            solved: self.looks_solved(),
        };
        let t = self.time();
        self.hand.decide(t, &sight);
        let has = self.hand.hold(t).is_some() || self.hand.has_it_back();
        if has != self.operator_has {
            self.operator_has = has;
            if has {
                self.balance.hand_comes(&self.core);
            }
            self.record(Incident::Operator { has_cube: has });
        }
    }

    fn look_for_collisions(&mut self) {
        let openings = [self.jaws[0].opening(), self.jaws[self.jaws.len() - 1].opening()];
        let holds = self.grasps.map(|g| g.holds());
        let cube = HeldCube {
            frame: self.balance.nodes[0],
            edge: self.config.cell.cube.edge,
            holder: (holds[0] != holds[1]).then(|| usize::from(holds[1])),
        };
        let arms = &self.config.cell.arms;
        let grippers = [&arms[0].gripper, &arms[arms.len() - 1].gripper];
        let (events, counts) = (&mut self.verdict.events, &mut self.verdict.counts);
        let period = self.period;
        let mut found = |what: Incident| {
            counts.collisions += 1;
            if events.len() < verdict::MOST_EVENTS {
                events.push(Event { period, what });
            }
        };
        for (i, was) in self.fronts.iter_mut().enumerate() {
            let touch = &self.balance.touches[i];
            let is = touch.front > 0.0;
            if is && !*was {
                let (what, with) = (Part::Finger(i), Part::Cube);
                found(Incident::Collision {
                    what,
                    with,
                    depth: touch.front / grasp::FRONT_STIFFNESS,
                });
            }
            *was = is;
        }
        let table = self.config.cell.table_height;
        self.collisions.look(&self.arms, &openings, grippers, &cube, table, found);
    }

    fn looks_solved(&self) -> bool {
        let stickers = self.puzzle.stickers();
        (0..54).all(|i| stickers[i] == stickers[i / 9 * 9 + 4])
            && (0..3).all(|a| self.puzzle.misalignment(a) < 0.1)
    }

    fn look_for_drop(&mut self) {
        if self.state != State::Held || self.hand.has_it_back() {
            return;
        }
        let carried = self.hand.hold(self.time()).is_some() || self.grasps.iter().any(Grasp::holds);
        if carried {
            return;
        }
        for i in 0..self.arms.len() {
            if self.grasps[i].lost {
                self.record(Incident::GraspLost { arm: i });
            }
        }
        self.grasps = [Grasp::OPEN; 2];
        self.regroup();
        self.state = State::Falling { velocity: self.velocity.linear };
        self.verdict.counts.drops += 1;
        self.record(Incident::Drop { arm: self.last_holder });
    }

    fn look_for_pop_and_jam(&mut self) {
        let Some(split) = self.balance.split else { return };
        let interface = self.balance.interface;
        self.verdict.turned = self.relative_angle() - self.angle_at_split;
        if !self.popped && (interface.tilt > 3.0 || interface.axial.abs() > 50.0) {
            self.popped = true;
            self.verdict.counts.pops += 1;
            self.record(Incident::Pop { tilt: interface.tilt, pull: interface.axial });
        }
        let angle = self.relative_angle();
        let off = self.puzzle.misalignment(split.axis);
        let loaded = interface.torque.abs() > 0.5 * interface.limit;
        if (angle - self.watch.angle).abs() > 1_f64.to_radians() {
            self.watch = JamWatch { angle, since: self.period, reported: false };
        } else if !loaded || off < 3_f64.to_radians() {
            self.watch.since = self.period;
        } else if !self.watch.reported && (self.period - self.watch.since) as f64 * PERIOD > 3.0 {
            self.watch.reported = true;
            self.verdict.counts.jams += 1;
            self.record(Incident::Jam {
                axis: Axis::ALL[split.axis],
                angle: off,
                torque: interface.torque,
            });
        }
    }

    fn record(&mut self, what: Incident) {
        if self.verdict.events.len() < verdict::MOST_EVENTS {
            self.verdict.events.push(Event { period: self.period, what });
        }
    }
}

impl Port for Plant {
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        let count = self.arms.len();
        if drives.len() != count || readings.len() != count {
            let reason = format!("{} drives, {} readings", drives.len(), readings.len());
            return Err(PortFault { effector: count, reason });
        }
        let substeps = self.config.substeps.max(1);
        let dt = PERIOD / f64::from(substeps);
        let start = self.time();
        for k in 0..substeps {
            self.step(drives, start + f64::from(k + 1) * dt, dt);
        }
        self.period = period + 1;
        self.verdict.period = self.period;
        for (i, reading) in readings.iter_mut().enumerate() {
            let arm = &self.arms[i];
            arm.read(reading);
            reading.jaw_count = self.jaws[i].count();
            reading.currents[AXES] = self.jaws[i].current();
            let touch = &self.balance.touches[i];
            let tool = &arm.world_from_tool;
            let (force, torque) = (tool.r * -touch.force, tool.r * -touch.torque);
            let sensor = &mut self.sensors[i];
            reading.wrench_on_sensor =
                sensor.read(&arm.world_from_flange, &tool.p, &force, &torque);
            let saturated = sensor.saturated;
            if saturated && !self.saturated[i] {
                self.verdict.counts.saturations += 1;
                self.record(Incident::Saturation { arm: i });
            }
            self.saturated[i] = saturated;
        }
        self.look_for_collisions();
        self.account();
        Ok(())
    }
}
