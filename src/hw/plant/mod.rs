//! The simulated plant: arms, jaws, cube, operator's hand and sensors behind the same port as real hardware.
//!
//! - in: drives, once a servo period
//! - out: readings at the period's end; beside the port a [`Scene`] for the cameras and a [`Verdict`] for
//!   summaries, neither of which a controller may see
//! - 4 substeps of 0.5 ms a period; no allocation in a period; one seeded generator per source of chance,
//!   sines from `libm`: the same bits in every run
//! - it knows nothing of the task or the controller, and only the true values of the cell

mod account;
mod arm;
mod balance;
mod collision;
pub mod config;
mod cube;
pub mod dynamics;
mod encoder;
pub mod fault;
mod frame;
mod grasp;
mod hand;
mod holding;
mod identity;
mod jaw;
mod plausible;
pub mod render;
mod rest;
pub mod saved;
mod sensor;
mod start;
#[cfg(test)]
pub(in crate::hw) mod testing;
#[cfg(test)]
mod tests;
pub mod truth;
mod undoing;
pub mod verdict;

pub use arm::sagging;
pub use config::{
    ArmDynamics, CubeMechanics, HandScript, Jaws, Lying, MotorDynamics, PlantConfig, SensorNoise,
    Start,
};
pub use identity::Identity;
pub use verdict::{Counts, Event, Exertion, Incident, Part, Verdict, Whereabouts};

use self::arm::PlantArm;
use self::balance::{Balance, HandHold, Surroundings, moved};
use self::collision::Collisions;
use self::cube::Puzzle;
use self::fault::{Faults, Upset};
use self::frame::{Frame, about};
use self::grasp::{Grasp, Hands, Touch};
use self::hand::OperatorHand;
use self::jaw::PlantJaw;
use self::sensor::{Load, WristSensor};
use self::undoing::Undoing;
use super::port::{Port, PortFault};
use super::scene::{Scene, SceneArm, SceneCube};
use crate::cell::{Cell, Gripper};
use crate::cube::{Axis, Face, Keeper};
use crate::motion::{AXES, Depth};
use crate::servo::io::{ArmDrive, ArmReading, JAW};
use crate::spatial::{GRAVITY, Twist};
use nalgebra::{Point3, Vector3};

/// Where the cube is, as a state.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
enum State {
    Held,
    Falling {
        velocity: Vector3<f64>,
    },
    /// On the table; `fell`: it was not laid there.
    Tray {
        down: Face,
        fell: bool,
    },
}

/// Watches for a loaded layer that does not move.
#[derive(Debug, Clone, Copy, Default)]
struct StillWatch {
    /// The layer's angle when it last moved (rad), and the period.
    angle: f64,
    since: u64,
    reported: bool,
}

/// The simulated cell. See the module.
#[derive(Clone)]
pub struct Plant {
    config: PlantConfig,
    identity: Identity,
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
    watch: StillWatch,
    collisions: Collisions,
    fronts: [bool; 2],
    popped: bool,
    crushed: [bool; 2],
    saturated: [bool; 2],
    /// Power stages that were on in the last period.
    powered: [bool; 2],
    /// What is made to go wrong.
    faults: Faults,
    operator_has: bool,
    /// Relative angle of the two bodies when they were formed (rad).
    angle_at_split: f64,
    undoing: Undoing,
    verdict: Verdict,
}

impl Plant {
    /// Makes a plant at rest.
    ///
    /// # Errors
    /// [`PortFault`] when the cell has no arm or more than two, or the lists of the configuration do not fit.
    pub fn new(config: PlantConfig, seed: u64) -> Result<Self, PortFault> {
        let count = config.cell.arms.len();
        if !(1..=2).contains(&count) || config.arms.len() != count {
            let reason = format!("the plant needs 1 or 2 arms with dynamics, not {count}");
            return Err(PortFault { effector: 0, reason });
        }
        let mut this = Self::at_start(config, seed)?;
        if let Start::Held { arm, .. } = this.config.start {
            if this.in_the_way_of_stops(arm) {
                this.stops[arm] = Depth::Two;
            }
            this.close(arm);
        }
        this.account();
        // How it begins is no event.
        this.faults = Faults::new(&this.config.faults);
        Ok(this)
    }

    /// Puts all parts where the run begins, without faults and before jaws close.
    fn at_start(config: PlantConfig, seed: u64) -> Result<Self, PortFault> {
        let cell = &config.cell;
        let arms = start::arms(&config);
        let mut hand = start::hand(&config, seed);
        let world_from_cube = start::cube(&config, seed, &mut hand, &arms)?;
        let (keeper, state) = match config.start {
            Start::Table(_) => {
                (Keeper::Table, State::Tray { down: lowest_face(&world_from_cube), fell: false })
            }
            Start::Hand | Start::Held { .. } => (Keeper::Person, State::Held),
        };
        Ok(Self {
            jaws: start::jaws(&config),
            sensors: start::sensors(&config, seed),
            stops: [Depth::One; 2],
            puzzle: start::puzzle(&config, seed),
            balance: Balance::new(world_from_cube, cell.cube.edge, cell.table_height),
            grasps: [Grasp::OPEN; 2],
            hand,
            state,
            last_holder: None,
            period: 0,
            core: world_from_cube,
            velocity: Twist::default(),
            watch: StillWatch::default(),
            collisions: Collisions::default(),
            fronts: [false; 2],
            popped: false,
            crushed: [false; 2],
            saturated: [false; 2],
            powered: [false; 2],
            faults: Faults::new(&[]),
            operator_has: config.start == Start::Hand,
            angle_at_split: 0.0,
            undoing: Undoing::default(),
            verdict: Verdict::empty(&world_from_cube.to_pose(), keeper),
            identity: Identity::of(&config, seed),
            arms,
            config,
        })
    }

    /// Returns the checksum of [`Identity::bounds`].
    #[must_use]
    pub fn bounds(&self) -> u32 {
        Identity::bounds(&self.config)
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
            period: self.config.period.tick(self.period),
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
        let holds = self.grasps.iter().any(Grasp::holds);
        verdict.returned = self.hand.has_it_back() || self.hand.carries() && !holds;
        verdict.both_hold = self.both_hold();
        verdict.cube = match self.state {
            State::Tray { down, fell } => Whereabouts::Tray { down, fell },
            State::Falling { .. } => Whereabouts::Falling,
            State::Held if self.grasps.iter().any(Grasp::holds) => {
                Whereabouts::Arms(self.grasps.map(|g| g.holds()))
            }
            State::Held => Whereabouts::Hand,
        };
        verdict
    }

    /// Relative rotation of the two grasped parts since both hold (rad), as in [`Verdict::turned`].
    #[must_use]
    pub fn turned(&self) -> f64 {
        self.verdict.turned
    }

    /// Whether an arm's power stages were on in the last period; its brakes hold otherwise.
    #[must_use]
    pub fn is_powered(&self, arm: usize) -> bool {
        self.powered.get(arm).is_some_and(|on| *on)
    }

    /// Numbers of the faults that have begun, in the order of [`PlantConfig::faults`].
    pub fn begun_faults(&self) -> impl Iterator<Item = usize> {
        self.faults.begun()
    }

    /// Which faults of others begin and end since the last call.
    pub fn upsets(&mut self) -> impl Iterator<Item = Upset> {
        self.faults.upsets()
    }

    /// The true values of the cell.
    #[must_use]
    pub fn cell(&self) -> &Cell {
        &self.config.cell
    }

    fn time(&self) -> f64 {
        self.period as f64 * self.config.period.seconds()
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
        let pushes = self.faults.acting.push;
        for (i, arm) in self.arms.iter_mut().enumerate() {
            let touch = &self.balance.touches[i];
            let tool = arm.world_from_tool;
            if touch.any() || pushes[i] != Vector3::zeros() {
                let force = tool.r * -touch.force + pushes[i];
                let torque = tool.r * -touch.torque;
                let mut outside = arm.torques(&force, &torque, &tool.p);
                for (sum, more) in outside.iter_mut().zip(&self.collisions.torques[i]) {
                    *sum += more;
                }
                let local = arm.world_from_base().to_local(&tool);
                // A cube that goes where the tool goes does not hold it back.
                let grip = (!self.balance.hangs_on(i))
                    .then(|| moved(&touch.stiffness, &local.r, &local.p, &local.p));
                arm.step(&drives[i], &outside, grip.as_ref(), dt);
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
        if let State::Falling { mut velocity } = self.state {
            velocity.z -= GRAVITY * dt;
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
        let hold = self.hand.hold(t).map(|world_from_cube| HandHold {
            world_from_cube,
            stiffness: self.config.hand.stiffness,
            damping: self.config.hand.damping,
        });
        let tools = [self.tool(0), self.tool(1)];
        let near = |i: usize| {
            i < self.arms.len() && (tools[i].p - self.balance.nodes[0].p).norm_squared() < 0.04
        };
        if !near(0) && !near(1) && !self.grasps.iter().any(grasp::Grasp::attached) {
            if let (Some(hold), State::Held) = (&hold, self.state) {
                self.balance.place(hold.world_from_cube);
                self.balance.hand_comes(&hold.world_from_cube);
            }
            return;
        }
        let pads = self.faults.acting.friction.map(|share| {
            let jaws = self.config.jaws;
            Jaws { friction: share * jaws.friction, ..jaws }
        });
        let layers: [Frame; 2] =
            std::array::from_fn(|i| if near(i) { self.layer_ahead(i) } else { Frame::IDENTITY });
        let hands: [Option<Hands>; 2] = std::array::from_fn(|i| {
            near(i).then(|| Hands {
                gripper: &self.config.cell.arms[i].gripper,
                jaws: &pads[i],
                edge,
                opening: self.jaws[i].opening(),
                stops: self.stops[i],
                hold: self.faults.acting.friction[i],
                layer: layers[i],
            })
        });
        let weight = Vector3::new(0.0, 0.0, -GRAVITY * self.config.cell.cube.mass);
        let around = Surroundings { tools, hands, hold, weight, dt };
        self.balance.step(&mut self.puzzle, &mut self.grasps, &around);
    }

    fn tool(&self, i: usize) -> Frame {
        self.arms[i.min(self.arms.len() - 1)].world_from_tool
    }

    /// A falling cube meets the tray: it topples onto the face that is lowest.
    fn land(&mut self, cube: &mut Frame) {
        let edge = self.config.cell.cube.edge;
        let down = lowest_face(cube);
        let out = cube.r * down.normal();
        let axis = out.cross(&-Vector3::z());
        let sine = axis.norm();
        if sine > 1e-9 {
            let angle = libm::atan2(sine, -out.z);
            cube.r = about(&(axis / sine), angle) * cube.r;
        }
        cube.p.z = self.config.cell.table_height + 0.5 * edge;
        self.state = State::Tray { down, fell: true };
        self.record(Incident::Landed { down });
    }
}

/// The face that a cube would come to lie on.
fn lowest_face(cube: &Frame) -> Face {
    let lowest = |face: &Face| (cube.r * face.normal()).z;
    Face::ALL.into_iter().min_by(|a, b| lowest(a).total_cmp(&lowest(b))).unwrap_or(Face::D)
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
        let length = self.config.period;
        let substeps = (f64::from(self.config.substeps) * length.ratio()).ceil().max(1.0) as u32;
        let dt = length.seconds() / f64::from(substeps);
        let start = self.time();
        for arm in &mut self.arms {
            arm.begin_period();
        }
        for k in 0..substeps {
            self.step(drives, start + f64::from(k + 1) * dt, dt);
        }
        self.reconsider_axis();
        self.period = period + 1;
        self.verdict.period = self.period;
        for (i, reading) in readings.iter_mut().enumerate() {
            let arm = &mut self.arms[i];
            arm.read(&drives[i], reading);
            let jaw = self.jaws[i].read(drives[i].synchronise & (1 << JAW) != 0);
            reading.jaw_count = jaw.count;
            reading.sync_switches |= u8::from(jaw.switch) << JAW;
            reading.encoder_zeros |= u8::from(jaw.zero) << JAW;
            reading.synchronised |= u8::from(jaw.synchronised) << JAW;
            reading.currents[AXES] = self.jaws[i].current();
            reading.over_currents |= u8::from(self.jaws[i].over_current()) << JAW;
            let touch = &self.balance.touches[i];
            let tool = &arm.world_from_tool;
            let force = tool.r * -touch.force + self.faults.acting.push[i];
            let torque = tool.r * -touch.torque;
            let sensor = &mut self.sensors[i];
            let (velocity, spin) = arm.velocity_at(&sensor.centre(&arm.world_from_flange));
            let load = Load { at: &tool.p, force: &force, torque: &torque, velocity, spin };
            reading.wrench_on_sensor = sensor.read(&arm.world_from_flange, &load);
            let saturated = sensor.saturated;
            if saturated && !self.saturated[i] {
                self.verdict.counts.saturations += 1;
                self.record(Incident::Saturation { arm: i });
            }
            self.saturated[i] = saturated;
            let cell = &self.config.cell.arms[i];
            let increments = std::array::from_fn(|j| {
                if j < AXES { cell.model.increments[j] } else { cell.gripper.increments }
            });
            self.faults.spoil(i, reading, &increments, &cell.sensor.range);
        }
        self.look_for_collisions();
        self.account();
        self.suffer();
        for (on, drive) in self.powered.iter_mut().zip(drives) {
            *on = drive.enabled;
        }
        Ok(())
    }
}
