//! Rigid body in the cell: in one hand or in two, on the table, or in the air.
//!
//! The body is quasi-static, as the cube is: in each substep it is where the springs of the grips,
//! the table and its weight balance. A gripper that closes on it gets a fixed contact frame on the
//! body. From then on the pads feel stiffness times displacement from this frame, in all six
//! directions, and slip beyond the friction of the grip, by the law of the cube's grasp.
//!
//! - in: the tools with their jaws, once a substep
//! - out: the pose of the body, the load on each tool
//! - inertia: the mass times the acceleration of the holding hands at the body's centre, the mean
//!   of the last period with a lag of 10 ms. Without the lag, a body heavier than a wrist would
//!   make the wrist tremble. The inertia of the body's rotation is left out

use super::super::balance::{Round, Rounds, System, moved};
use super::super::carried::Carried;
use super::super::config::Jaws;
use super::super::frame::{Frame, orthonormal, rotation_vector};
use super::super::grasp::{CLOSED, Grasp, Hands, Touch};
use super::super::rest::{Bearing, Rest, Resting, Support};
use super::solid::Solid;
use super::spec::ObjectConfig;
use super::tool::{Load, Tool};
use super::truth::{History, Internal, ObjectState, ObjectTruth, TouchTruth};
use crate::cell::{MOST_ARMS, PerArm};
use crate::spatial::GRAVITY;
use nalgebra::{Matrix3, Vector3};
use std::ops::AddAssign;
use std::sync::Arc;

/// Time constant of the inertial force (s).
const INERTIA: f64 = 0.01;
/// Distance beyond the body's corners at which a tool is near it (m).
const NEAR: f64 = 0.15;
/// Motion in a substep below which a body on the table counts as still (m), and the number of such
/// substeps after which its balance rests.
const STILL: (f64, u32) = (1e-8, 200);
/// Damping of a body of 1 kg near the table (Ns/m), and the speed at which a tilted one falls flat
/// (rad/s): those of the cube.
const DAMPING: (f64, f64) = (200.0, 1.0);

/// Contact of a gripper with the body.
#[derive(Debug, Clone, Copy)]
struct Grip {
    grasp: Grasp,
    /// Turn of the body about its own axis, after which the pads meet its sides.
    turn: Matrix3<f64>,
    /// Sizes of the body along the tool's axes (m).
    size: Vector3<f64>,
    /// Contact in the last substep.
    touch: Touch,
}

impl Grip {
    const OPEN: Self = Self {
        grasp: Grasp::OPEN,
        turn: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        size: Vector3::new(0.0, 0.0, 0.0),
        touch: Touch::NONE,
    };
}

/// State of a body in the plant's file.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(in crate::hw::plant) struct SavedObject {
    name: String,
    frame: Frame,
    state: ObjectState,
    velocity: Vector3<f64>,
    grips: Vec<(Grasp, Frame, Vector3<f64>)>,
    closed: Vec<u32>,
    drops: u32,
    slips: u32,
}

/// Rigid body.
#[derive(Debug, Clone)]
pub(super) struct Body {
    pub(super) spec: ObjectConfig,
    name: Arc<str>,
    pub(super) solid: Solid,
    pub(super) frame: Frame,
    pub(super) state: ObjectState,
    grips: PerArm<Grip>,
    rest: Rest,
    /// Velocity of the centre over the last period (m/s).
    velocity: Vector3<f64>,
    /// Frame at the end of the last period.
    before: Frame,
    /// Frames of the tools in the last substep.
    tools_before: PerArm<Option<Frame>>,
    carried: Carried,
    /// Inertial force (N), in the world.
    inertial: Vector3<f64>,
    /// Substeps for which a body on the table has been still.
    still: u32,
    /// Number of closings, per arm, of falls and of slips.
    closed: PerArm<u32>,
    drops: u32,
    slips: u32,
    most_force: f64,
    internal: Internal,
    history: History,
    pub(super) touched: TouchTruth,
}

impl Body {
    /// Makes the body of an object at its start pose, at rest. `table` is the height of the table
    /// (m), `supports` are the tops on which it may lie beside.
    pub(super) fn new(
        spec: &ObjectConfig,
        solid: Solid,
        table: f64,
        supports: Vec<Support>,
    ) -> Self {
        let frame = Frame::from_pose(&spec.world_from_object);
        let half = solid.half();
        let (corners, below) = solid.corners();
        // A body that tilts about an edge turns by its weight at the middle of its side.
        let weight = spec.mass * GRAVITY;
        let resting = Resting {
            corners,
            radius: 0.5 * (half.x + half.y),
            reach: 1.01 * half.norm(),
            stiffness: spec.stiffness / below,
            friction: spec.friction,
            damping: (DAMPING.0 * spec.mass, weight * half.amax() / DAMPING.1),
            supports,
        };
        let mut rest = Rest::of(table, resting);
        let state = if spec.fixed {
            ObjectState::Fixed
        } else if rest.contact(&frame, 1.0).is_some() {
            rest.land(&frame);
            ObjectState::Resting
        } else {
            ObjectState::Falling
        };
        Self {
            name: Arc::from(spec.name.as_str()),
            state,
            solid,
            frame,
            grips: [Grip::OPEN; MOST_ARMS],
            rest,
            velocity: Vector3::zeros(),
            before: frame,
            tools_before: [None; MOST_ARMS],
            carried: Carried::default(),
            inertial: Vector3::zeros(),
            still: 0,
            closed: [0; MOST_ARMS],
            drops: 0,
            slips: 0,
            most_force: 0.0,
            internal: Internal::default(),
            history: History::new(),
            touched: TouchTruth::default(),
            spec: spec.clone(),
        }
    }

    /// Checks whether the jaws of an arm are closed on the body.
    pub(super) fn is_in(&self, arm: usize) -> bool {
        self.grips[arm].grasp.attached()
    }

    /// Returns the place of the body's centre and its half sizes, both along a tool's axes (m).
    pub(super) fn place_in(&self, tool: &Frame) -> (Vector3<f64>, Vector3<f64>) {
        let local = tool.to_local(&self.frame);
        (local.p, self.solid.between_pads(&local.r).1 * 0.5)
    }

    /// Moves the body by one substep of `dt` (s). A tool that is `None` meets another body.
    pub(super) fn step(&mut self, tools: PerArm<Option<&Tool<'_>>>, dt: f64) {
        for grip in &mut self.grips {
            grip.touch = Touch::NONE;
        }
        if self.state == ObjectState::Falling {
            self.fall(dt);
            return;
        }
        for (grip, tool) in self.grips.iter_mut().zip(tools) {
            let loses = tool.is_some_and(|tool| tool.loses);
            grip.grasp.lost |= loses && grip.grasp.attached();
        }
        let reach = self.solid.half().norm() + NEAR;
        let near = tools
            .map(|tool| tool.filter(|t| (t.frame.p - self.frame.p).norm_squared() < reach * reach));
        let alone = near.iter().all(Option::is_none);
        if self.state != ObjectState::Fixed {
            if alone && self.still > STILL.1 {
                return;
            }
            if self.state == ObjectState::Held && !self.carries() {
                self.let_fall();
                return;
            }
        } else if alone {
            return;
        }
        self.balance(near, dt);
        self.change_grips(near);
        self.change_state();
    }

    /// Moves the body to where all forces on it balance, and commits the slip of the grips. A fixed
    /// body only takes the forces.
    fn balance(&mut self, tools: PerArm<Option<&Tool<'_>>>, dt: f64) {
        let from = self.frame;
        let fixed = self.state == ObjectState::Fixed;
        let jaws = tools.map(|tool| self.jaws(tool));
        for (grip, tool) in self.grips.iter_mut().zip(tools) {
            let Some(tool) = tool.filter(|_| !grip.grasp.attached()) else { continue };
            let local = tool.frame.to_local(&self.frame);
            (grip.turn, grip.size) = self.solid.between_pads(&local.r);
        }
        if !fixed {
            self.follow(tools);
        }
        let mut rounds = Rounds::default();
        let mut system = System::new();
        let bearing = loop {
            system.clear(1);
            let bearing = self.load(&mut system, tools, &jaws, dt);
            // A body without any contact falls: it has no balance.
            let touched = self.grips.iter().any(|grip| grip.touch.any()) || bearing.is_some();
            if fixed || !touched && rounds.is_first() {
                break None;
            }
            match rounds.judge(system.imbalance(1)) {
                Round::Ends => break bearing,
                Round::Halves => rounds.halve(std::slice::from_mut(&mut self.frame)),
                Round::Returns => rounds.go_back(std::slice::from_mut(&mut self.frame)),
                Round::Steps => {
                    self.stiffen(&mut system, tools, bearing.as_ref());
                    let mut nodes = [self.frame, Frame::IDENTITY];
                    rounds.go(&mut nodes, system.solve(1), 1);
                    self.frame = nodes[0];
                }
            }
        };
        self.rest.commit(bearing);
        for grip in &mut self.grips {
            grip.grasp.commit(&grip.touch, dt);
        }
        let moved = (self.frame.p - from.p).amax() < STILL.0
            && rotation_vector(&(self.frame.r * from.r.transpose())).amax() < STILL.0;
        self.still = if moved { self.still.saturating_add(1) } else { 0 };
    }

    /// Returns the pads of a gripper on this body: a fault may take a share of their friction.
    fn jaws(&self, tool: Option<&Tool<'_>>) -> Jaws {
        tool.map_or_else(Jaws::rubber, |tool| Jaws {
            friction: tool.friction * self.spec.friction,
            ..*tool.jaws
        })
    }

    /// Moves a held body along with the first tool that holds it, the first guess of the balance.
    fn follow(&mut self, tools: PerArm<Option<&Tool<'_>>>) {
        let mut done = false;
        for (i, tool) in tools.into_iter().enumerate() {
            let now = tool.filter(|_| self.is_in(i)).map(|tool| tool.frame);
            if let (Some(now), Some(before), false) = (now, self.tools_before[i], done) {
                let moved = now.times(&before.inverse()).times(&self.frame);
                self.frame = Frame { r: orthonormal(&moved.r), p: moved.p };
                done = true;
            }
            self.tools_before[i] = now;
        }
    }

    /// Adds to the empty `system` the forces on the body at its present pose. Returns how the table
    /// acts on it.
    fn load(
        &mut self,
        system: &mut System,
        tools: PerArm<Option<&Tool<'_>>>,
        jaws: &PerArm<Jaws>,
        dt: f64,
    ) -> Option<Bearing> {
        for ((grip, tool), jaws) in self.grips.iter_mut().zip(tools).zip(jaws) {
            // A hand with the cube in it touches nothing else.
            let Some(tool) = tool.filter(|tool| !tool.busy) else { continue };
            let hands = Hands {
                gripper: tool.gripper,
                jaws,
                size: grip.size,
                anywhere: true,
                opening: tool.opening,
                stops: tool.stops,
                hold: tool.friction,
                layer: Frame::IDENTITY,
            };
            let turned = self.frame.times(&Frame::rotated(grip.turn));
            grip.touch = grip.grasp.touch(&tool.frame, &turned, &hands);
            system.load(0, &tool.frame, &self.frame, &grip.touch);
        }
        let weight = Vector3::z() * (-GRAVITY * self.spec.mass) + self.inertial;
        let residual = &mut system.residual[0];
        residual.fixed_rows_mut::<3>(0).add_assign(&weight);
        let bearing = self.rest.contact(&self.frame, dt);
        if let Some(bearing) = &bearing {
            residual.fixed_rows_mut::<3>(0).add_assign(&bearing.force);
            residual.fixed_rows_mut::<3>(3).add_assign(&bearing.torque);
        }
        bearing
    }

    /// Adds to `system` the stiffness of grips and table.
    fn stiffen(
        &self,
        system: &mut System,
        tools: PerArm<Option<&Tool<'_>>>,
        bearing: Option<&Bearing>,
    ) {
        for (grip, tool) in self.grips.iter().zip(tools) {
            if let Some(tool) = tool
                && (grip.touch.any() || grip.grasp.attached())
            {
                let lever = tool.frame.p - self.frame.p;
                system.stiffness[0][0] +=
                    moved(&grip.touch.stiffness, &tool.frame.r, &lever, &lever);
            }
        }
        if let Some(bearing) = bearing {
            system.stiffness[0][0] += bearing.stiffness;
        }
    }

    /// Begins the grips of jaws that have closed on the body, and ends those of jaws that have let
    /// go. Jaws that close on a fixed body hold it as well.
    fn change_grips(&mut self, tools: PerArm<Option<&Tool<'_>>>) {
        for (i, tool) in tools.into_iter().enumerate() {
            let Some(tool) = tool.filter(|tool| !tool.busy) else { continue };
            let grip = &mut self.grips[i];
            if !grip.grasp.attached() {
                if grip.touch.grip() > CLOSED {
                    let turned = self.frame.times(&Frame::rotated(grip.turn));
                    let local = tool.frame.to_local(&turned);
                    grip.grasp.close(0, &local, Grasp::flat(&local, true));
                    self.closed[i] += 1;
                    self.tools_before[i] = Some(tool.frame);
                }
            } else if grip.grasp.lets_go(&grip.touch, tool.opening, grip.size.y) {
                grip.grasp = Grasp::OPEN;
            } else if !tool.opens && !grip.grasp.reported && grip.grasp.slipped() {
                grip.grasp.reported = true;
                self.slips += 1;
            }
        }
    }

    /// Checks whether a gripper carries the body.
    fn carries(&self) -> bool {
        self.grips.iter().any(|grip| grip.grasp.holds())
    }

    /// Decides whether hands, the table or nothing carries the body after a substep.
    fn change_state(&mut self) {
        if self.state == ObjectState::Fixed {
            return;
        }
        let carried = self.grips.iter().any(|g| g.grasp.holds() && g.touch.any());
        if carried {
            self.state = ObjectState::Held;
        } else if self.rest.is_near() {
            self.state = ObjectState::Resting;
        } else if self.state == ObjectState::Held {
            self.let_fall();
        } else {
            // It was pushed off its support, or began in the air.
            self.state = ObjectState::Falling;
            self.velocity = Vector3::zeros();
        }
    }

    /// Lets the body fall out of the hands, with its last velocity.
    fn let_fall(&mut self) {
        for grip in &mut self.grips {
            *grip = Grip::OPEN;
        }
        self.rest.commit(None);
        if self.rest.contact(&self.frame, 1.0).is_some() {
            // On the table it is laid down, not dropped.
            self.rest.land(&self.frame);
            self.state = ObjectState::Resting;
            return;
        }
        self.drops += 1;
        self.state = ObjectState::Falling;
    }

    /// Moves a falling body by a substep of `dt` (s): it keeps its orientation until it lands.
    fn fall(&mut self, dt: f64) {
        self.velocity.z -= GRAVITY * dt;
        self.frame.p += self.velocity * dt;
        self.rest.commit(None);
        if self.rest.contact(&self.frame, dt).is_some() {
            self.velocity = Vector3::zeros();
            self.rest.land(&self.frame);
            (self.state, self.still) = (ObjectState::Resting, 0);
        }
    }

    /// Adds the load of the body on the tool of an arm to `load`.
    pub(super) fn load_tool(&self, arm: usize, tool: &Frame, load: &mut Load) {
        let touch = &self.grips[arm].touch;
        if !touch.any() {
            return;
        }
        load.force -= tool.r * touch.force;
        load.torque -= tool.r * touch.torque;
        for (sum, pad) in load.pads.iter_mut().zip(touch.pads) {
            *sum += pad;
        }
        // A body that hangs on this hand alone moves along and adds no stiffness.
        let other = (0..MOST_ARMS).any(|i| i != arm && self.grips[i].touch.any());
        if other || self.rest.table_load > 0.0 || self.state == ObjectState::Fixed {
            load.stiffness += touch.stiffness;
        }
    }

    /// Records the forces of a period of `seconds`, and computes the inertial force of the next
    /// one.
    pub(super) fn end_period(&mut self, tools: PerArm<Option<&Tool<'_>>>, seconds: f64) {
        if self.state != ObjectState::Falling {
            self.velocity = (self.frame.p - self.before.p) / seconds;
        }
        self.before = self.frame;
        let (mut sum, mut holders, mut who) = (Vector3::zeros(), 0.0, 0);
        for (i, tool) in tools.into_iter().enumerate() {
            let force = self.grips[i].touch.force.norm();
            self.most_force = self.most_force.max(force);
            if let Some(tool) = tool.filter(|_| self.grips[i].grasp.holds()) {
                sum += tool.velocity_at(&self.frame.p);
                (holders, who) = (holders + 1.0, who | 1 << i);
            }
        }
        // On the table the body hardly accelerates.
        let carried = holders > 0.0 && self.rest.table_load == 0.0;
        let now = carried.then(|| (who, sum / holders));
        self.carried.advance(now, self.spec.mass, seconds);
        let share = if carried { seconds / (seconds + INERTIA) } else { 1.0 };
        self.inertial += (self.carried.force - self.inertial) * share;
        let mut holders = (0..MOST_ARMS).filter(|i| who >> i & 1 != 0);
        if let (Some(first), Some(second)) = (holders.next(), holders.next()) {
            self.measure_internal(tools, (first, second));
        } else {
            let i = &mut self.internal;
            (i.force, i.pull, i.torque) = (0.0, 0.0, 0.0);
        }
    }

    /// Records the internal load between the tools of two arms that hold the body; of more holders
    /// the first two count.
    fn measure_internal(&mut self, tools: PerArm<Option<&Tool<'_>>>, (one, other): (usize, usize)) {
        let (Some(first), Some(second)) = (tools[one], tools[other]) else { return };
        let wrench = |tool: &Tool<'_>, touch: &Touch| {
            (tool.frame.r * touch.force, tool.frame.r * touch.torque)
        };
        let (f1, t1) = wrench(first, &self.grips[one].touch);
        let (f2, t2) = wrench(second, &self.grips[other].touch);
        let apart = second.frame.p - first.frame.p;
        let half = (f2 - f1) * 0.5;
        let i = &mut self.internal;
        (i.force, i.torque) = (half.norm(), ((t2 - t1) * 0.5).norm());
        i.pull = if apart.norm() > 1e-9 { half.dot(&apart.normalize()) } else { 0.0 };
        (i.most_force, i.most_torque) = (i.most_force.max(i.force), i.most_torque.max(i.torque));
        i.periods += 1;
        self.history.add(i.force);
    }

    /// Returns the true state and history of the body.
    pub(super) fn truth(&self) -> ObjectTruth {
        ObjectTruth {
            name: Arc::clone(&self.name),
            size: self.spec.size,
            world_from_object: self.frame.to_pose(),
            state: self.state,
            held_by: self.grips.map(|grip| grip.grasp.holds()),
            force: self.grips.map(|grip| grip.touch.force.norm()),
            most_force: self.most_force,
            internal: Internal { p99_force: self.history.percentile(0.99), ..self.internal },
            grasps: self.closed,
            drops: self.drops,
            slips: self.slips,
            touch: self.touched,
        }
    }

    /// Returns the state for the plant's file, with the grips of the first `arms` arms.
    pub(super) fn saved(&self, arms: usize) -> SavedObject {
        let grips = self.grips.iter().take(arms);
        SavedObject {
            name: self.spec.name.clone(),
            frame: self.frame,
            state: self.state,
            velocity: self.velocity,
            grips: grips.map(|g| (g.grasp, Frame::rotated(g.turn), g.size)).collect(),
            closed: self.closed[..arms].to_vec(),
            drops: self.drops,
            slips: self.slips,
        }
    }

    /// Checks that this body can be in the saved state. `tools` are the frames of the tools that
    /// exist. The error says why not.
    pub(super) fn check_saved(
        &self,
        saved: &SavedObject,
        tools: PerArm<Option<Frame>>,
    ) -> Result<(), String> {
        if saved.name != self.spec.name {
            return Err(format!("the state of `{}`, not of `{}`", saved.name, self.spec.name));
        }
        if (saved.state == ObjectState::Fixed) != self.spec.fixed {
            return Err("fixed and loose do not agree".to_owned());
        }
        let arms = tools.iter().flatten().count().max(2);
        if [saved.grips.len(), saved.closed.len()] != [arms; 2] {
            return Err("it does not have one grip for each arm".to_owned());
        }
        let reach = self.solid.half().norm() + NEAR;
        for ((grasp, ..), tool) in saved.grips.iter().zip(tools) {
            let near = tool.is_some_and(|tool| (tool.p - saved.frame.p).norm() < reach);
            if grasp.attached() && !near {
                return Err("the object is not at the hand that holds it".to_owned());
            }
        }
        Ok(())
    }

    /// Continues from a saved state, at rest unless it falls.
    pub(super) fn restore(&mut self, saved: &SavedObject) {
        (self.frame, self.before, self.state) = (saved.frame, saved.frame, saved.state);
        self.velocity = saved.velocity;
        for (grip, (grasp, turn, size)) in self.grips.iter_mut().zip(&saved.grips) {
            *grip = Grip { grasp: *grasp, turn: turn.r, size: *size, ..Grip::OPEN };
        }
        for (closed, saved) in self.closed.iter_mut().zip(&saved.closed) {
            *closed = *saved;
        }
        (self.drops, self.slips) = (saved.drops, saved.slips);
        if self.state == ObjectState::Resting {
            self.rest.land(&self.frame);
        }
    }
}
