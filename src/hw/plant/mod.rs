//! The simulated plant: arms, jaws, cube, operator's hand and sensors behind the same port as real
//! hardware.
//!
//! - in: drives, once a servo period
//! - out: readings at the period's end. Beside the port there is a [`Scene`] for the cameras and a
//!   [`Verdict`] for summaries; a controller may see neither
//! - 4 substeps of 0.5 ms a period, without any allocation. One seeded generator per source of
//!   chance and sines from `libm` give the same bits in every run
//! - it knows nothing of the task and the controller. Its cell has the true values, not those that
//!   the controller believes

mod account;
mod arm;
mod balance;
mod carried;
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
mod objects;
mod plausible;
pub mod render;
mod rest;
pub mod saved;
mod sensor;
mod start;
mod stop_watch;
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
pub use objects::spec::{LeadConfig, ObjectConfig, ObjectShape, Probe, Profile};
pub use objects::truth::{Internal, ObjectState, ObjectTruth, TouchTruth};
pub use verdict::{Counts, Event, Exertion, Incident, Part, Verdict, Whereabouts};

use self::arm::PlantArm;
use self::balance::{Balance, HandHold, Surroundings, moved};
use self::carried::Carried;
use self::collision::Collisions;
use self::cube::Puzzle;
use self::fault::{Faults, OutsideFault};
use self::frame::{Frame, about};
use self::grasp::{Grasp, Hands, Touch, only};
use self::hand::OperatorHand;
use self::jaw::PlantJaw;
use self::objects::{Objects, Tool};
use self::sensor::{Load, WristSensor};
use self::stop_watch::StopWatch;
use self::undoing::Undoing;
use super::port::{Port, PortFault};
use super::scene::{Scene, SceneArm, SceneCube};
use crate::cell::{Cell, Gripper, MOST_ARMS, PerArm};
use crate::cube::{Axis, Face, Keeper};
use crate::motion::{AXES, Depth};
use crate::servo::io::{ArmDrive, ArmReading, JAW};
use crate::spatial::{GRAVITY, Twist};
use nalgebra::{Point3, Vector3};

/// Place of the cube, as a state.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
enum State {
    /// In a gripper, in the operator's hand, or in both.
    Held,
    /// In the air, with this velocity in the world (m/s).
    Falling { velocity: Vector3<f64> },
    /// On the table, with the face `down` below. `fell` is whether the cube came there by a fall;
    /// otherwise an arm laid it down, or it lay there at the start.
    Tray { down: Face, fell: bool },
}

/// Watch for a loaded layer that does not move.
#[derive(Debug, Clone, Copy, Default)]
struct StillWatch {
    /// Angle of the layer when it last moved (rad).
    angle: f64,
    /// Servo period since which the layer has stood still under load, off a quarter turn.
    since: u64,
    /// Whether this standstill has been reported.
    reported: bool,
}

/// Simulated cell, with its state and history.
///
/// ```
/// use rubik_robot::cube::Facelets;
/// use rubik_robot::hw::plant::{Plant, PlantConfig};
/// use rubik_robot::hw::port::Port;
/// use rubik_robot::servo::io::{ArmDrive, ArmReading};
/// use rubik_robot::tasks;
/// use std::path::Path;
///
/// let cell = tasks::read(Path::new("cell"), "task = \"idle\"\n", &[])?.controller.cell;
/// let mut plant = Plant::new(PlantConfig::new(cell), 1)?;
/// let before = plant.scene();
/// let mut readings = [ArmReading::default(); 2];
/// for period in 0..50 {
///     plant.exchange(period, &[ArmDrive::OFF; 2], &mut readings)?;
/// }
/// // The brakes hold the arms, and a person has the solved cube.
/// let moved = before.arms[0].world_from_tool.inverse() * plant.scene().arms[0].world_from_tool;
/// assert!(moved.translation.vector.norm() < 1e-4);
/// assert_eq!(plant.verdict().facelets, *Facelets::solved().colours());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct Plant {
    config: PlantConfig,
    identity: Identity,
    arms: Vec<PlantArm>,
    jaws: Vec<PlantJaw>,
    sensors: Vec<WristSensor>,
    /// Positions of the palms' stops, per arm.
    stops: PerArm<Depth>,
    /// Stickers and layers of the cube.
    puzzle: Puzzle,
    /// Poses of the cube's bodies, from the balance of forces on them.
    balance: Balance,
    grasps: PerArm<Grasp>,
    /// Inertia of a cube that one arm alone carries.
    carried: Carried,
    hand: OperatorHand,
    state: State,
    /// Index of the arm whose jaws were the last to close on the cube.
    last_holder: Option<usize>,
    /// Servo periods done.
    period: u64,
    /// Frame of the cube's core in the world at the end of the last period.
    core: Frame,
    /// Mean velocity of the core over the last period, in the world.
    velocity: Twist,
    watch: StillWatch,
    collisions: Collisions,
    /// Rigid objects beside the cube.
    objects: Objects,
    /// Whether the cube met the ends or edges of the fingers in the last period, per arm.
    fronts: PerArm<bool>,
    /// Whether a pop of the cube has been reported.
    popped: bool,
    /// Whether a crush of the cube has been reported, per arm.
    crushed: PerArm<bool>,
    /// Whether each wrist sensor was at the end of its range in the last period.
    saturated: PerArm<bool>,
    /// Watch for acts after a stop, with the state of the power stages.
    stop_watch: StopWatch,
    /// Faults to inject.
    faults: Faults,
    /// Whether the operator has the cube.
    operator_has: bool,
    /// Angle of the second body's layer against the first's when the cube was last divided (rad).
    angle_at_split: f64,
    /// State of a fault that undoes a turn.
    undoing: Undoing,
    verdict: Verdict,
}

impl Plant {
    /// Makes a plant at rest.
    ///
    /// # Errors
    /// [`PortFault`] when the cell has no arm or more than [`MOST_ARMS`], when the configuration
    /// lacks the dynamics of an arm, or when an arm that does not exist is to hold the cube.
    pub fn new(config: PlantConfig, seed: u64) -> Result<Self, PortFault> {
        let count = config.cell.arms.len();
        if !(1..=MOST_ARMS).contains(&count) || config.arms.len() != count {
            let given = config.arms.len();
            let needs = format!("the plant needs 1 to {MOST_ARMS} arms and the dynamics of each");
            let reason = format!("{needs}, not {count} arms and the dynamics of {given}");
            return Err(PortFault { effector: 0, reason });
        }
        let mut this = Self::at_start(config, seed)?;
        if let Start::Held { arm, .. } = this.config.start {
            // A cube deep in the hand can only be there with the stops retracted.
            if this.in_the_way_of_stops(arm) {
                this.stops[arm] = Depth::Two;
            }
            this.close(arm);
        }
        this.record_period();
        // The start of a run is no event that could begin a fault.
        this.faults = Faults::new(&this.config.faults);
        Ok(this)
    }

    /// Makes a plant with all parts in their poses at the start of a run, without faults and before
    /// jaws close on the cube.
    fn at_start(config: PlantConfig, seed: u64) -> Result<Self, PortFault> {
        let cell = &config.cell;
        let arms = start::arms(&config);
        let mut hand = start::hand(&config, seed);
        let world_from_cube = start::cube(&config, seed, &mut hand, &arms)?;
        let (keeper, state) = match config.start {
            // A cube that lies on the table at first is to lie there in the end: no person is in
            // the cell.
            Start::Table(_) => {
                (Keeper::Table, State::Tray { down: lowest_face(&world_from_cube), fell: false })
            }
            Start::Hand | Start::Held { .. } => (Keeper::Person, State::Held),
        };
        Ok(Self {
            jaws: start::jaws(&config),
            sensors: start::sensors(&config, seed),
            stops: [Depth::One; MOST_ARMS],
            puzzle: start::puzzle(&config, seed),
            balance: Balance::new(world_from_cube, cell.cube.edge, cell.table_height),
            grasps: [Grasp::OPEN; MOST_ARMS],
            carried: Carried::default(),
            hand,
            state,
            last_holder: None,
            period: 0,
            core: world_from_cube,
            velocity: Twist::default(),
            watch: StillWatch::default(),
            collisions: Collisions::default(),
            objects: start::objects(&config, seed),
            fronts: [false; MOST_ARMS],
            popped: false,
            crushed: [false; MOST_ARMS],
            saturated: [false; MOST_ARMS],
            stop_watch: StopWatch::default(),
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

    /// Returns the checksum over the parameters that limit speed and force, see
    /// [`Identity::bounds`].
    #[must_use]
    pub fn bounds(&self) -> u32 {
        Identity::bounds(&self.config)
    }

    /// Returns the scene that the cameras see now.
    #[must_use]
    pub fn scene(&self) -> Scene {
        let axis = self.puzzle.turned_axis();
        let [negative, positive] = self.puzzle.angles[axis];
        let scene_arm = |i: usize| {
            // The entries beyond `arm_count` repeat the last arm.
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
            arms: std::array::from_fn(scene_arm),
            arm_count: self.arms.len(),
            hand: self.hand.pose(self.time()).map(Frame::to_pose),
            objects: self.objects.scene(),
        }
    }

    /// Returns the true state and history of the plant. Allocates, so the servo's loop must not
    /// call it.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let mut verdict = self.verdict.clone();
        verdict.facelets = self.puzzle.facelets();
        verdict.world_from_cube = self.core.to_pose();
        let axis = self.balance.split.map_or_else(|| self.puzzle.turned_axis(), |s| s.axis);
        verdict.turning = Axis::ALL[axis];
        verdict.layer_angles = self.puzzle.angles[axis];
        let holds = self.grasps.iter().any(Grasp::holds);
        // A hand that carries the cube away has it back as well.
        verdict.returned = self.hand.has_it_back() || self.hand.carries() && !holds;
        verdict.both_hold = self.both_hold();
        verdict.objects = self.objects.truth().collect();
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

    /// Returns the angle by which the two grippers have turned the cube's parts against each other
    /// since both hold it (rad), as in [`Verdict::turned`].
    #[must_use]
    pub fn turned(&self) -> f64 {
        self.verdict.turned
    }

    /// Returns the true state and history of each object, in the order of the configuration.
    pub fn objects(&self) -> impl Iterator<Item = ObjectTruth> {
        self.objects.truth()
    }

    /// Returns the number of persons who have led their tool to the end of the way.
    #[must_use]
    pub fn leads_done(&self) -> usize {
        self.objects.leads_done()
    }

    /// Returns the greatest force on the tool of each person who leads one (N).
    pub fn lead_forces(&self) -> impl Iterator<Item = f64> {
        self.objects.lead_forces()
    }

    /// Returns the true forces of both pads of a gripper, and of its palm, on the cube (N).
    #[must_use]
    pub fn squeeze(&self, arm: usize) -> ([f64; 2], f64) {
        self.balance.touches.get(arm).map_or(([0.0; 2], 0.0), |touch| (touch.pads, touch.palm))
    }

    /// Returns whether an arm's power stages were on in the last period; otherwise its brakes hold.
    #[must_use]
    pub fn is_powered(&self, arm: usize) -> bool {
        self.stop_watch.on().get(arm).is_some_and(|on| *on)
    }

    /// Returns the indices of the faults that have begun, in the order of [`PlantConfig::faults`].
    pub fn begun_faults(&self) -> impl Iterator<Item = usize> {
        self.faults.begun()
    }

    /// Returns the starts and ends, since the last call, of faults that act outside of the plant,
    /// for instance on a camera.
    pub fn outside_faults(&mut self) -> impl Iterator<Item = OutsideFault> {
        self.faults.outside_faults()
    }

    /// Returns the true values of the cell.
    #[must_use]
    pub fn cell(&self) -> &Cell {
        &self.config.cell
    }

    /// Returns the time since the start of the run (s).
    fn time(&self) -> f64 {
        self.period as f64 * self.config.period.seconds()
    }

    /// Checks whether two arms, or more, hold the cube.
    fn both_hold(&self) -> bool {
        self.grasps.iter().filter(|grasp| grasp.holds()).count() >= 2
    }

    /// Counts what an arm does after a stop.
    fn watch_stops(&mut self, drives: &[ArmDrive]) {
        let enabled = |i: usize| drives.get(i).is_some_and(|drive| drive.enabled);
        let on = std::array::from_fn(enabled);
        let time = (self.time(), self.config.period.seconds());
        let arms = &self.arms;
        let held = |i: usize| arms.get(i).map_or([0.0; AXES], PlantArm::held_joints);
        let joints = || std::array::from_fn(held);
        let violations = &mut self.verdict.counts.violations;
        self.stop_watch.watch(time, on, joints, violations);
    }

    /// Moves the plant by one substep of `dt` (s), which ends at `t` (s): stops, cube, arms, jaws
    /// and grasps, in this order.
    fn step(&mut self, drives: &[ArmDrive], t: f64, dt: f64) {
        // A cube in the way of the stops holds them where they are.
        for (i, drive) in drives.iter().enumerate() {
            if drive.enabled && !self.in_the_way_of_stops(i) {
                self.stops[i] = drive.stops;
            }
        }
        // The cube comes first: its balance at the present tools makes the forces that the arms
        // take in this substep.
        self.step_cube(t, dt);
        self.step_objects(t, dt);
        self.record_peaks();
        let pushes = self.faults.acting.push;
        for (i, arm) in self.arms.iter_mut().enumerate() {
            let touch = &self.balance.touches[i];
            let tool = arm.world_from_tool;
            let more = self.objects.load(i).filter(|load| load.any());
            if touch.any() || pushes[i] != Vector3::zeros() || more.is_some() {
                let mut force = tool.r * -touch.force + pushes[i];
                let mut torque = tool.r * -touch.torque;
                let mut stiffness = touch.stiffness;
                if let Some(more) = more {
                    force += more.force;
                    torque += more.torque;
                    stiffness += more.stiffness;
                }
                let mut outside = arm.torques(&force, &torque, &tool.p);
                for (sum, more) in outside.iter_mut().zip(&self.collisions.torques[i]) {
                    *sum += more;
                }
                let local = arm.world_from_base().to_local(&tool);
                // A cube that hangs on this hand alone moves along. Taken as a fixed body it would
                // brake the wrist with 12 Nms/rad and the trunk with 560.
                let grip = (more.is_some() || !self.balance.hangs_on(i))
                    .then(|| moved(&stiffness, &local.r, &local.p, &local.p));
                arm.step(&drives[i], &outside, grip.as_ref(), dt);
            } else {
                arm.step(&drives[i], &self.collisions.torques[i], None, dt);
            }
            // Each pad has half of the stiffness over half of the opening, and the push is the mean
            // of both: an eighth of the stiffness for each pad that touches.
            let pads = more.map_or(touch.pads, |more| {
                [touch.pads[0] + more.pads[0], touch.pads[1] + more.pads[1]]
            });
            let push = 0.5 * (pads[0] + pads[1]);
            let sides = f64::from(u8::from(pads[0] > 0.0) + u8::from(pads[1] > 0.0));
            let slope = 0.125 * self.config.jaws.stiffness[1] * sides;
            self.jaws[i].step(&drives[i], push, slope, dt);
        }
        self.change_grasps();
        // A balance of forces on a cube without a holder would press it against the other hand.
        self.look_for_drop();
    }

    /// Returns force and torque (N, Nm) of all contacts on the tool of arm `i`, about the tool
    /// point and in the world: the reactions of cube and objects, and a fault's push.
    fn contact(&self, i: usize, tool: &Frame) -> (Vector3<f64>, Vector3<f64>) {
        let touch = &self.balance.touches[i];
        let mut force = tool.r * -touch.force + self.faults.acting.push[i];
        let mut torque = tool.r * -touch.torque;
        if let Some(more) = self.objects.load(i).filter(|load| load.any()) {
            force += more.force;
            torque += more.torque;
        }
        (force, torque)
    }

    /// Checks whether the cube lies so deep in the hand of arm `i` that its palm's stops cannot
    /// come forward.
    fn in_the_way_of_stops(&self, i: usize) -> bool {
        let tool = self.tool(i);
        let cube = tool.to_local(&self.balance.nodes[0]).p;
        let half = Vector3::repeat(0.5 * self.config.cell.cube.edge);
        let object = self.objects.held(i, &tool);
        in_the_way(&cube, &half) || object.is_some_and(|(at, half)| in_the_way(&at, &half))
    }

    /// Returns the tools as the objects meet them.
    fn tools(&self) -> PerArm<Option<Tool<'_>>> {
        std::array::from_fn(|i| {
            let arm = self.arms.get(i)?;
            let frame = arm.world_from_tool;
            let (velocity, spin) = arm.velocity_at(&frame.p);
            Some(Tool {
                frame,
                velocity,
                spin,
                gripper: &self.config.cell.arms[i].gripper,
                jaws: &self.config.jaws,
                opening: self.jaws[i].opening(),
                opens: self.jaws[i].opens(),
                stops: self.stops[i],
                friction: self.faults.acting.friction[i],
                loses: self.faults.acting.lost[i],
                busy: self.grasps[i].attached(),
            })
        })
    }

    /// Moves the objects by one substep of `dt` (s), which ends at `t` (s).
    fn step_objects(&mut self, t: f64, dt: f64) {
        if self.objects.is_empty() {
            return;
        }
        // The tools borrow the plant, so the objects leave it meanwhile.
        let mut objects = std::mem::take(&mut self.objects);
        objects.step(&self.tools(), t, dt);
        self.objects = objects;
    }

    /// Records the loads of the objects at the end of a period.
    fn end_period_of_objects(&mut self) {
        if self.objects.is_empty() {
            return;
        }
        let mut objects = std::mem::take(&mut self.objects);
        objects.end_period(&self.tools(), self.config.period.seconds());
        self.objects = objects;
    }

    /// Moves the cube by one substep of `dt` (s), which ends at `t` (s): it falls, follows the
    /// operator's hand, or goes to where all forces on it balance.
    fn step_cube(&mut self, t: f64, dt: f64) {
        let edge = self.config.cell.cube.edge;
        self.balance.touches = [Touch::NONE; MOST_ARMS];
        if let State::Falling { mut velocity } = self.state {
            // Free fall: the cube keeps the velocity and the orientation of its release.
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
        let tools: PerArm<Frame> = std::array::from_fn(|i| self.tool(i));
        let near = |i: usize| {
            i < self.arms.len() && (tools[i].p - self.balance.nodes[0].p).norm_squared() < 0.04
        };
        // With no gripper within 0.2 m the cube follows the hand without a balance of forces.
        if !(0..self.arms.len()).any(near) && !self.grasps.iter().any(grasp::Grasp::attached) {
            if let (Some(hold), State::Held) = (&hold, self.state) {
                self.balance.place(hold.world_from_cube);
                self.balance.hand_comes(&hold.world_from_cube);
            }
            return;
        }
        // A fault takes a share of the pads' friction.
        let pads = self.faults.acting.friction.map(|share| {
            let jaws = self.config.jaws;
            Jaws { friction: share * jaws.friction, ..jaws }
        });
        let layers: PerArm<Frame> =
            std::array::from_fn(|i| if near(i) { self.layer_ahead(i) } else { Frame::IDENTITY });
        let hands: PerArm<Option<Hands>> = std::array::from_fn(|i| {
            near(i).then(|| {
                let (opening, stops) = (self.jaws[i].opening(), self.stops[i]);
                Hands {
                    hold: self.faults.acting.friction[i],
                    layer: layers[i],
                    ..Hands::at_cube(&self.config.cell, i, &pads[i], opening, stops)
                }
            })
        });
        let weight = Vector3::new(0.0, 0.0, -GRAVITY * self.config.cell.cube.mass);
        let weight = weight + self.carried.force;
        let around = Surroundings { tools, hands, hold, weight, dt };
        self.balance.step(&mut self.puzzle, &mut self.grasps, &around);
    }

    /// Computes the inertial force on a cube that one arm alone holds, from the motion of that arm
    /// in this period. The force acts in the next period.
    fn feel_inertia_of_cube(&mut self) {
        let holder = only(self.grasps.each_ref().map(Grasp::holds));
        let centre = self.balance.core(&self.puzzle).p;
        let now = holder.map(|i| (i, self.arms[i].velocity_at(&centre).0));
        self.carried.advance(now, self.config.cell.cube.mass, self.config.period.seconds());
    }

    /// Returns `world_from_tool` of arm `i`, or of the last arm if there is no arm `i`.
    fn tool(&self, i: usize) -> Frame {
        self.arms[i.min(self.arms.len() - 1)].world_from_tool
    }

    /// Lays a falling cube on the tray: it topples onto the face that is lowest.
    fn land(&mut self, cube: &mut Frame) {
        let edge = self.config.cell.cube.edge;
        let down = lowest_face(cube);
        let out = cube.r * down.normal();
        // The shortest rotation that turns this face down.
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

/// Checks whether a body, with its centre at `at` in the tool frame and these half sizes (m), lies
/// so deep in the hand that the palm's stops cannot come forward.
fn in_the_way(at: &Vector3<f64>, half: &Vector3<f64>) -> bool {
    // A face behind the middle of the two stops is in the way of the forward one.
    let between = -0.5 * (Gripper::FACE_BEHIND_TOOL_ONE + Gripper::FACE_BEHIND_TOOL_TWO);
    at.x.abs() < half.x
        && at.y.abs() < half.y
        && at.z.abs() < 2.0 * half.z
        && at.z - half.z < between
}

/// Returns the face that looks down most, on which the cube would come to lie.
fn lowest_face(cube: &Frame) -> Face {
    let lowest = |face: &Face| (cube.r * face.normal()).z;
    Face::ALL.into_iter().min_by(|a, b| lowest(a).total_cmp(&lowest(b))).unwrap_or(Face::D)
}

/// Adds what the controller of a jaw measures to the reading of its arm.
fn read_jaw(jaw: &mut PlantJaw, drive: &ArmDrive, reading: &mut ArmReading) {
    let measured = jaw.read(drive.synchronise & (1 << JAW) != 0);
    reading.jaw_count = measured.count;
    reading.sync_switches |= u8::from(measured.switch) << JAW;
    reading.encoder_zeros |= u8::from(measured.zero) << JAW;
    reading.synchronised |= u8::from(measured.synchronised) << JAW;
    reading.currents[AXES] = jaw.current();
    reading.over_currents |= u8::from(jaw.over_current()) << JAW;
}

impl Port for Plant {
    /// Moves the plant by the servo period `period` under the given drive commands. Writes what the
    /// arms' controllers measure at the end of the period into `readings`. The error is a number of
    /// drive commands or readings that differs from the number of arms.
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        let count = self.arms.len();
        if drives.len() != count || readings.len() != count {
            let reason = format!(
                "the plant has {count} arms, but got drive commands for {} and readings for {}",
                drives.len(),
                readings.len()
            );
            return Err(PortFault { effector: count, reason });
        }
        let length = self.config.period;
        // A longer period has more substeps: none is longer than the 0.5 ms that the tests cover.
        let substeps = (f64::from(self.config.substeps) * length.ratio()).ceil().max(1.0) as u32;
        let dt = length.seconds() / f64::from(substeps);
        let start = self.time();
        // Mass matrix and bias once a period: fresh ones in each substep would change them by parts
        // in a thousand.
        for arm in &mut self.arms {
            arm.begin_period();
        }
        for k in 0..substeps {
            self.step(drives, start + f64::from(k + 1) * dt, dt);
        }
        // The axis changes between periods, so that all substeps of a period see the same bodies.
        self.reconsider_axis();
        self.feel_inertia_of_cube();
        self.end_period_of_objects();
        self.period = period + 1;
        self.verdict.period = self.period;
        for (i, reading) in readings.iter_mut().enumerate() {
            let arm = &mut self.arms[i];
            arm.read(&drives[i], reading);
            read_jaw(&mut self.jaws[i], &drives[i], reading);
            let tool = arm.world_from_tool;
            let (force, torque) = self.contact(i, &tool);
            let (arm, sensor) = (&self.arms[i], &mut self.sensors[i]);
            // The inertia of the body beyond the sensor acts at its centre of mass.
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
            // Faults spoil the report alone: the plant continues from the true values.
            self.faults.spoil(i, reading, &increments, &cell.sensor.range);
        }
        // Forces of collisions and effects of faults act from the next period on. Faults come last,
        // since this period's events may begin them.
        self.look_for_collisions();
        self.record_period();
        self.apply_faults();
        self.watch_stops(drives);
        Ok(())
    }
}
