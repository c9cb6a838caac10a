//! The cube in the hands: where it is when all forces on it balance.
//!
//! The cube has so little mass against the stiffness of its contacts that it is quasi-static: in each substep
//! its pose is the one where pads, palms, the operator's hand, weight, and the springs inside it cancel.
//! When two grippers hold different layers of one axis it is two bodies, joined by an interface with play,
//! whose turning part slips like friction; otherwise it is one.
//!
//! - in: poses of tools, openings of jaws, the operator's hold, the table's height
//! - out: poses of the bodies, the wrench of each gripper on the cube, slip of layers and of grips
//! - method: Newton with the elastic stiffness (always positive definite) and return mapping of every
//!   friction at each evaluation; states are committed once a substep

use super::cube::{InterfaceLoad, Layers, MIDDLE, Puzzle};
use super::frame::{Frame, about, rotation_vector, skew, solve};
use super::grasp::{Grasp, Hands, Touch};
use super::rest::{Bearing, Rest};
use crate::cube::Axis;
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use std::ops::{AddAssign, SubAssign};

/// Newton rounds a substep; what little is left over is taken up in the next one.
const ROUNDS: usize = 3;
/// Rounds of a substep that ends far out of balance: one-sided contacts can throw a light layer to and fro.
const MOST_ROUNDS: usize = 15;
/// So many rounds in a row that change next to nothing are the last ones: what slips on both sides finds no balance, and how
/// fast it slips is not to come from how long a balance is sought.
const STALLED: usize = 2;
/// Further out of balance than this many tolerances (0.1 N, 2 mNm) is far: a wrist would feel what nothing bears.
const FAR: f64 = 20.0;
/// A round that leaves this many times more out of balance went too far. Where friction slips it may grow a little.
const OVERSHOT: f64 = 1.2;
/// A balance within this is good (N, Nm).
const TOLERANCE: (f64, f64) = (5e-3, 1e-4);
/// Elastic stiffness of a layer that is not turning (Nm/rad).
const LAYER_STIFFNESS: f64 = 200.0;
/// A corner that stands in the way (Nm/rad).
const CORNER_STIFFNESS: f64 = 50.0;
/// Stiffness inside the play, as a share of that beyond it: the springs of the core's screws.
const INSIDE_PLAY: f64 = 0.05;

/// The operator's hold on the cube: a spring and a damper to a moving pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct HandHold {
    /// Where it wants the cube.
    pub(super) world_from_cube: Frame,
    /// (N/m), a hundredth of a metre squared of it is the rotation's (Nm/rad).
    pub(super) stiffness: f64,
    /// (Ns/m)
    pub(super) damping: f64,
}

/// Two bodies: which axis turns between them, and which layers each has.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Split {
    pub(super) axis: usize,
    pub(super) layers: [Layers; 2],
}

/// What an interface transmits, and how far it slipped in the last substep.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Interface {
    /// About the axis, on the first body (Nm).
    pub(super) torque: f64,
    /// Torque at which it slips (Nm).
    pub(super) limit: f64,
    /// (Nm)
    pub(super) tilt: f64,
    /// (N)
    pub(super) axial: f64,
    slip: f64,
    /// Interface that gives way: which body's layer turns against the core.
    slipping: usize,
}

/// What acts on the cube.
pub(super) struct Surroundings<'a> {
    /// `world_from_tool` of the arms.
    pub(super) tools: [Frame; 2],
    /// Grippers that are near.
    pub(super) hands: [Option<Hands<'a>>; 2],
    /// The operator's hold.
    pub(super) hold: Option<HandHold>,
    /// In the world (N).
    pub(super) weight: Vector3<f64>,
    /// Time of the substep (s).
    pub(super) dt: f64,
}

#[derive(Debug, Clone)]
pub(super) struct Balance {
    /// Poses of the bodies in the world; the second only counts when split.
    pub(super) nodes: [Frame; 2],
    pub(super) split: Option<Split>,
    pub(super) interface: Interface,
    /// Of the last substep.
    pub(super) touches: [Touch; 2],
    /// Force of the operator's hand on the cube (N), in the world.
    pub(super) hand_force: Vector3<f64>,
    before: Frame,
    hand_before: Frame,
    /// Tools of the last substep.
    tools_before: Option<[Frame; 2]>,
    edge: f64,
    /// The table under a cube of one piece; in two pieces it is held between two hands, far above.
    rest: Rest,
}

impl Balance {
    pub(super) fn new(world_from_cube: Frame, edge: f64, table: f64) -> Self {
        Self {
            edge,
            nodes: [world_from_cube; 2],
            split: None,
            interface: Interface::default(),
            touches: [Touch::NONE; 2],
            hand_force: Vector3::zeros(),
            before: world_from_cube,
            hand_before: world_from_cube,
            tools_before: None,
            rest: Rest::new(table, edge),
        }
    }

    /// With what the table bore the cube in the last substep (N).
    pub(super) fn borne(&self) -> f64 {
        self.rest.borne
    }

    /// Whether a gripper alone holds the cube, which then goes where its tool goes.
    pub(super) fn hangs_on(&self, gripper: usize) -> bool {
        let others = (0..2).any(|i| i != gripper && self.touches[i].any());
        !others && self.hand_force == Vector3::zeros() && self.borne() == 0.0
    }

    /// At rest with bodies that were kept.
    pub(super) fn restore(&mut self, nodes: [Frame; 2], split: Option<Split>) {
        *self = Self { nodes, split, ..Self::new(nodes[0], self.edge, self.rest.height) };
    }

    /// The middle layer's frame in the world.
    pub(super) fn core(&self, puzzle: &Puzzle) -> Frame {
        match self.split {
            None => self.nodes[0],
            Some(s) => {
                let body = usize::from(s.layers[0] & MIDDLE == 0);
                if s.layers[body] & MIDDLE == 0 {
                    self.unturned(0, s, puzzle)
                } else {
                    self.nodes[body]
                }
            }
        }
    }

    /// A body's frame with its layer turned back to the core.
    fn unturned(&self, body: usize, split: Split, puzzle: &Puzzle) -> Frame {
        let angle = layer_angle(puzzle, split.axis, split.layers[body]);
        let back = about(&Axis::ALL[split.axis].unit(), -angle);
        self.nodes[body].times(&Frame::rotated(back))
    }

    /// Makes one body of the cube or two, without moving anything but a layer that becomes a body again while it is still
    /// held: it lies as far off the core as before. Without that its play would begin anew each time, and what a hand
    /// holds would lean over by as much more.
    pub(super) fn regroup(
        &mut self,
        split: Option<Split>,
        puzzle: &mut Puzzle,
        grasps: &mut [Grasp; 2],
    ) {
        if split == self.split {
            return;
        }
        let core = self.core(puzzle);
        if let Some(old) = self.split {
            for grasp in grasps.iter_mut().filter(|grasp| grasp.attached()) {
                grasp.off[old.axis] = core.to_local(&self.unturned(grasp.node, old, puzzle));
            }
        }
        if let Some(old) = self.split
            && split.is_none_or(|s| s.axis != old.axis)
        {
            // Nothing but the description changes: the core's frame stays where it is.
            puzzle.settle(old.axis);
        }
        let mut nodes = [core; 2];
        if let Some(s) = split {
            for (body, node) in nodes.iter_mut().enumerate() {
                let angle = layer_angle(puzzle, s.axis, s.layers[body]);
                let turned = Frame::rotated(about(&Axis::ALL[s.axis].unit(), angle));
                let layer = s.layers[body] & MIDDLE == 0 && grasps[body].attached();
                let off = if layer { grasps[body].off[s.axis] } else { Frame::IDENTITY };
                *node = core.times(&off).times(&turned);
            }
        }
        for (i, grasp) in grasps.iter_mut().enumerate() {
            if grasp.attached() {
                let node = if split.is_some() { i } else { 0 };
                let old_from_new = self.nodes[grasp.node].to_local(&nodes[node]);
                grasp.rename(node, &old_from_new);
            }
        }
        self.nodes = nodes;
        self.before = nodes[0];
        self.split = split;
        self.interface = Interface::default();
    }

    /// Takes one substep: finds where all forces balance, and commits the slip of grips and layers.
    pub(super) fn step(
        &mut self,
        puzzle: &mut Puzzle,
        grasps: &mut [Grasp; 2],
        around: &Surroundings,
    ) {
        if around.hold.is_none() {
            self.carry(grasps, &around.tools);
        }
        self.tools_before = Some(around.tools);
        let borne = self.find_balance(puzzle, grasps, around);
        self.rest.commit(borne);
        if around.hold.is_none() {
            self.hand_force = Vector3::zeros();
        }
        for (grasp, touch) in grasps.iter_mut().zip(&self.touches) {
            grasp.commit(touch, around.dt);
        }
        self.slip_layers(puzzle);
        self.before = self.nodes[0];
        if let Some(hold) = &around.hold {
            self.hand_before = hold.world_from_cube;
        }
    }

    /// Moves the bodies, round by round, to where all forces on them balance; returns what the
    /// table bears there.
    fn find_balance(
        &mut self,
        puzzle: &Puzzle,
        grasps: &[Grasp; 2],
        around: &Surroundings,
    ) -> Option<Bearing> {
        let bodies = self.bodies();
        let mut step: Option<Step> = None;
        let mut stalled = 0;
        let mut system = System::new();
        for round in 0..=MOST_ROUNDS {
            system.clear(bodies);
            let load = self.load(&mut system, puzzle, grasps, around);
            let left = system.imbalance(bodies);
            let enough = if round < ROUNDS { 1.0 } else { FAR };
            let before = step.as_ref().map_or(f64::INFINITY, |s| s.imbalance);
            let overshot = round > ROUNDS && left > OVERSHOT * before;
            let stalls = round > ROUNDS && left > 0.97 * before && !overshot;
            stalled = if stalls { stalled + 1 } else { 0 };
            if left < enough || round == MOST_ROUNDS || stalled == STALLED {
                return load.borne;
            }
            // Too far: it met a contact, or left one, that the stiffness did not know.
            if overshot && let Some(step) = &mut step {
                step.moves = step.moves.map(|m| 0.5 * m);
                step.go(&mut self.nodes[..bodies]);
                continue;
            }
            self.stiffen(&mut system, &load, grasps, &around.tools);
            let moves = system.solve(bodies);
            let step = step.insert(Step { from: self.nodes, moves, imbalance: left });
            step.go(&mut self.nodes[..bodies]);
        }
        // The last round has returned above.
        None
    }

    /// Adds all forces on the bodies where they are now to an empty system: grippers, weight, the
    /// operator's hand, the table, and the interface between two bodies.
    fn load(
        &mut self,
        system: &mut System,
        puzzle: &Puzzle,
        grasps: &[Grasp; 2],
        around: &Surroundings,
    ) -> Load {
        let Surroundings { tools, hands, hold, weight, dt } = around;
        let bodies = self.bodies();
        for (i, hands) in hands.iter().enumerate() {
            let Some(hands) = hands else {
                self.touches[i] = Touch::NONE;
                continue;
            };
            let body = &self.nodes[self.body_of(&grasps[i])];
            self.touches[i] = grasps[i].touch(&tools[i], body, hands);
            system.load(self.body_of(&grasps[i]), &tools[i], body, &self.touches[i]);
        }
        for residual in system.residual.iter_mut().take(bodies) {
            residual.fixed_rows_mut::<3>(0).add_assign(&(weight / bodies as f64));
        }
        if let Some(hold) = hold {
            self.hand_force = self.add_hold(system, hold, *dt);
            // The hand carries the cube's weight without sinking.
            system.residual[0].fixed_rows_mut::<3>(0).sub_assign(weight);
        }
        let borne = if bodies == 1 { self.rest.bear(&self.nodes[0], *dt) } else { None };
        if let Some(borne) = &borne {
            system.residual[0].fixed_rows_mut::<3>(0).add_assign(&borne.force);
            system.residual[0].fixed_rows_mut::<3>(3).add_assign(&borne.torque);
        }
        let joint = self.split.map(|split| {
            let (interface, joint) = self.join(split, puzzle);
            self.interface = interface;
            system.load_joint(&joint, &self.nodes);
            joint
        });
        Load { borne, joint }
    }

    /// Adds the wrench of the operator's hold on the first body, and its stiffness; returns its
    /// force.
    fn add_hold(&self, system: &mut System, hold: &HandHold, dt: f64) -> Vector3<f64> {
        let (body, before, hand_before) = (&self.nodes[0], &self.before, &self.hand_before);
        let target = &hold.world_from_cube;
        let offset = target.p - body.p;
        let speed = ((target.p - hand_before.p) - (body.p - before.p)) / dt;
        let force = offset * hold.stiffness + speed * hold.damping;
        // A hand's grip is about 0.1 m wide: K times 0.01 m2 in rotation.
        let k_turn = hold.stiffness * 0.01;
        let c_turn = hold.damping * 0.01;
        let twist = rotation_vector(&(target.r * body.r.transpose()));
        let turned = rotation_vector(&(body.r * before.r.transpose()));
        let torque = twist * k_turn - turned * (c_turn / dt);
        let r = &mut system.residual[0];
        r.fixed_rows_mut::<3>(0).add_assign(&force);
        r.fixed_rows_mut::<3>(3).add_assign(&torque);
        let k = &mut system.stiffness[0][0];
        for i in 0..3 {
            k[(i, i)] += hold.stiffness + hold.damping / dt;
            k[(3 + i, 3 + i)] += k_turn + c_turn / dt;
        }
        force
    }

    /// Adds the stiffness of the contacts that bear the load.
    fn stiffen(
        &self,
        system: &mut System,
        Load { borne, joint }: &Load,
        grasps: &[Grasp; 2],
        tools: &[Frame; 2],
    ) {
        for (i, touch) in self.touches.iter().enumerate() {
            if touch.any() || grasps[i].attached() {
                let body = self.body_of(&grasps[i]);
                let lever = tools[i].p - self.nodes[body].p;
                system.stiffness[body][body] +=
                    moved(&touch.stiffness, &tools[i].r, &lever, &lever);
            }
        }
        if let Some(borne) = borne {
            system.stiffness[0][0] += borne.stiffness;
        }
        if let Some(joint) = joint {
            system.stiffen_joint(joint, &self.nodes);
        }
    }

    /// Turns the layers of the body that gives way by what the interface slipped.
    fn slip_layers(&self, puzzle: &mut Puzzle) {
        let Some(split) = self.split else { return };
        let body = self.interface.slipping;
        let slip = if body == 0 { self.interface.slip } else { -self.interface.slip };
        for side in 0..2 {
            if split.layers[body] & (1 << (2 * side)) != 0 {
                puzzle.angles[split.axis][side] += slip;
            }
        }
    }

    /// Returns the number of bodies.
    fn bodies(&self) -> usize {
        if self.split.is_some() { 2 } else { 1 }
    }

    /// First guess: a cube that one gripper alone holds goes with its tool. From where it was, a tool at 0.5 m/s would
    /// seem to strain the pads beyond their friction, and the cube would slip by the solver's fault.
    fn carry(&mut self, grasps: &[Grasp; 2], tools: &[Frame; 2]) {
        let alone = match (grasps[0].attached(), grasps[1].attached()) {
            (true, false) => 0,
            (false, true) => 1,
            _ => return,
        };
        let Some(before) = self.tools_before else { return };
        let moved = tools[alone].times(&before[alone].inverse());
        for node in &mut self.nodes {
            *node = moved.times(node);
        }
    }

    /// Which body a gripper touches.
    fn body_of(&self, grasp: &Grasp) -> usize {
        if grasp.attached() && self.split.is_some() { grasp.node } else { 0 }
    }

    /// The hand took hold anew.
    pub(super) fn hand_comes(&mut self, hold: &Frame) {
        self.hand_before = *hold;
    }

    /// Puts everything elsewhere: a cube that is carried or falls.
    pub(super) fn place(&mut self, world_from_cube: Frame) {
        self.nodes = [world_from_cube; 2];
        self.before = world_from_cube;
    }

    /// The springs between the two bodies.
    fn join(&self, split: Split, puzzle: &Puzzle) -> (Interface, Joint) {
        let m = &puzzle.mechanics;
        let unit = Axis::ALL[split.axis].unit();
        let ours = self.unturned(0, split, puzzle);
        let theirs = self.unturned(1, split, puzzle);
        let e = theirs.to_local(&ours);
        let w = rotation_vector(&e.r);
        // The plane between the layers: a sixth of the edge off the centre, towards the lone outer layer.
        let outwards = |layers: Layers| f64::from(layers >> 2 & 1) - f64::from(layers & 1);
        let middle = split.layers.iter().position(|l| l & MIDDLE != 0);
        let at = match middle {
            Some(body) => unit * (outwards(split.layers[1 - body]) * self.edge / 6.0),
            None => Vector3::zeros(),
        };
        let shift = e.p + w.cross(&at);
        let axial = unit.dot(&shift);
        let across = shift - unit * axial;
        let twist = unit.dot(&w);
        let tilt = w - unit * twist;

        let (f_across, k_across, lateral) = with_play(&across, m.play, m.stiffness);
        let (f_axial, k_axial, axial_load) = with_play(&(unit * axial), 0.5 * m.play, m.stiffness);
        let (t_tilt, k_tilt, tilt_load) = with_play(&tilt, m.tilt_play, m.tilt_stiffness);
        let load = InterfaceLoad { lateral, tilt: tilt_load, axial: axial_load };
        let limit = |body: usize| -> f64 {
            (0..2)
                .filter(|side| split.layers[body] & (1 << (2 * side)) != 0)
                .map(|side| puzzle.turning_torque(split.axis, side, load))
                .sum()
        };
        let (slipping, limit) = if let Some(body) = middle {
            (1 - body, limit(1 - body))
        } else {
            // The middle layer turns along with whichever neighbour holds it better.
            let (a, b) = (limit(0), limit(1));
            if a <= b { (0, a) } else { (1, b) }
        };
        let blocked = puzzle.blocked(split.axis);
        let k = if blocked { CORNER_STIFFNESS } else { LAYER_STIFFNESS };
        let trial = -k * twist;
        let (torque, slip, k_twist) = if blocked || trial.abs() <= limit {
            (trial, 0.0, k)
        } else {
            (limit.copysign(trial), -(trial - limit.copysign(trial)) / k, 0.02 * k)
        };

        let along = unit * unit.transpose();
        let plane = Matrix3::identity() - along;
        let mut stiffness = Matrix6::zeros();
        stiffness.fixed_view_mut::<3, 3>(0, 0).copy_from(&(plane * k_across + along * k_axial));
        stiffness.fixed_view_mut::<3, 3>(3, 3).copy_from(&(plane * k_tilt + along * k_twist));
        let force = f_across + f_axial;
        let moment = t_tilt + unit * torque;
        let joint = Joint { frame: theirs, at, force, moment, stiffness };
        let interface =
            Interface { torque, limit, tilt: tilt_load, axial: unit.dot(&f_axial), slip, slipping };
        (interface, joint)
    }
}

/// Angle of a body's layer against the core (rad).
pub(super) fn layer_angle(puzzle: &Puzzle, axis: usize, layers: Layers) -> f64 {
    match layers {
        1 => puzzle.angles[axis][0],
        4 | 5 => puzzle.angles[axis][1],
        _ => 0.0,
    }
}

/// A spring with play: force, stiffness, and the size of the force beyond the play.
fn with_play(d: &Vector3<f64>, play: f64, k: f64) -> (Vector3<f64>, f64, f64) {
    let inside = INSIDE_PLAY * k;
    let size = d.norm();
    if size <= play {
        return (d * -inside, inside, 0.0);
    }
    let beyond = k * (size - play);
    (d * (-(inside + beyond / size)), k, beyond)
}

/// A spring between the bodies at a point of a frame, in that frame's axes; what it exerts on the first.
struct Joint {
    frame: Frame,
    at: Vector3<f64>,
    force: Vector3<f64>,
    moment: Vector3<f64>,
    stiffness: Matrix6<f64>,
}

/// Forces on the bodies in one round, beside grippers and hand, whose stiffness is to be added.
struct Load {
    /// What the table bears.
    borne: Option<Bearing>,
    /// The interface between two bodies.
    joint: Option<Joint>,
}

/// A round's step: where from, by how much (metres, radians), and what was out of balance there, in tolerances.
struct Step {
    from: [Frame; 2],
    moves: [Vector6<f64>; 2],
    imbalance: f64,
}

impl Step {
    fn go(&self, nodes: &mut [Frame]) {
        for ((node, from), m) in nodes.iter_mut().zip(&self.from).zip(&self.moves) {
            *node = from.nudged(&m.fixed_rows::<3>(0).into(), &m.fixed_rows::<3>(3).into());
        }
    }
}

/// Residual wrenches on the bodies (force, torque about their origins, in the world) and the stiffness.
struct System {
    residual: [Vector6<f64>; 2],
    stiffness: [[Matrix6<f64>; 2]; 2],
}

impl System {
    fn new() -> Self {
        Self { residual: [Vector6::zeros(); 2], stiffness: [[Matrix6::zeros(); 2]; 2] }
    }

    /// Empties what these bodies have of it.
    fn clear(&mut self, bodies: usize) {
        for i in 0..bodies {
            self.residual[i].fill(0.0);
            for j in 0..bodies {
                self.stiffness[i][j].fill(0.0);
            }
        }
    }

    fn load(&mut self, node: usize, tool: &Frame, body: &Frame, touch: &Touch) {
        let lever = tool.p - body.p;
        let force = tool.r * touch.force;
        let torque = tool.r * touch.torque + lever.cross(&force);
        let r = &mut self.residual[node];
        r.fixed_rows_mut::<3>(0).add_assign(&force);
        r.fixed_rows_mut::<3>(3).add_assign(&torque);
    }

    fn load_joint(&mut self, joint: &Joint, nodes: &[Frame; 2]) {
        let point = joint.frame.point(&joint.at);
        let (force, moment) = (joint.frame.r * joint.force, joint.frame.r * joint.moment);
        for (body, sign) in [(0, 1.0), (1, -1.0)] {
            let lever = point - nodes[body].p;
            let r = &mut self.residual[body];
            r.fixed_rows_mut::<3>(0).add_assign(&(force * sign));
            r.fixed_rows_mut::<3>(3).add_assign(&((moment + lever.cross(&force)) * sign));
        }
    }

    fn stiffen_joint(&mut self, joint: &Joint, nodes: &[Frame; 2]) {
        let point = joint.frame.point(&joint.at);
        let [a, b] = nodes.map(|n| point - n.p);
        let spring =
            |a: &Vector3<f64>, b: &Vector3<f64>| moved(&joint.stiffness, &joint.frame.r, a, b);
        self.stiffness[0][0] += spring(&a, &a);
        self.stiffness[1][1] += spring(&b, &b);
        let between = spring(&a, &b);
        self.stiffness[0][1] -= between;
        self.stiffness[1][0] -= between.transpose();
    }

    /// The greatest force or torque that nothing bears, in tolerances.
    fn imbalance(&self, bodies: usize) -> f64 {
        self.residual.iter().take(bodies).fold(0.0, |most, r| {
            let force = r.fixed_rows::<3>(0).amax() / TOLERANCE.0;
            f64::max(most, force.max(r.fixed_rows::<3>(3).amax() / TOLERANCE.1))
        })
    }

    fn solve(&self, bodies: usize) -> [Vector6<f64>; 2] {
        let mut moves = [Vector6::zeros(); 2];
        if bodies == 1 {
            let mut a: [[f64; 6]; 6] =
                std::array::from_fn(|i| std::array::from_fn(|j| self.stiffness[0][0][(i, j)]));
            let mut b: [f64; 6] = std::array::from_fn(|i| self.residual[0][i]);
            regularise(&mut a);
            solve(&mut a, &mut b);
            moves[0] = Vector6::from(b);
        } else {
            let mut a: [[f64; 12]; 12] = std::array::from_fn(|i| {
                std::array::from_fn(|j| self.stiffness[i / 6][j / 6][(i % 6, j % 6)])
            });
            let mut b: [f64; 12] = std::array::from_fn(|i| self.residual[i / 6][i % 6]);
            regularise(&mut a);
            solve(&mut a, &mut b);
            for body in 0..2 {
                moves[body] = Vector6::from_fn(|i, _| b[6 * body + i]);
            }
        }
        // A contact that appears within a round must not throw the cube: 1 mm and 1 deg a round at most.
        for m in &mut moves {
            let size =
                (m.fixed_rows::<3>(0).norm() / 1e-3).max(m.fixed_rows::<3>(3).norm() / 0.0175);
            if size > 1.0 {
                *m /= size;
            }
        }
        moves
    }
}

/// A body that only one pad pushes has directions without any spring.
fn regularise<const N: usize>(a: &mut [[f64; N]; N]) {
    for (i, row) in a.iter_mut().enumerate() {
        row[i] += if i % 6 < 3 { 50.0 } else { 0.05 };
    }
}

/// A stiffness of a frame with axes `r` at `lever_a` from one body's origin and `lever_b` from another's.
pub(super) fn moved(
    k: &Matrix6<f64>,
    r: &Matrix3<f64>,
    lever_a: &Vector3<f64>,
    lever_b: &Vector3<f64>,
) -> Matrix6<f64> {
    let block = |i: usize, j: usize| -> Matrix3<f64> {
        r * k.fixed_view::<3, 3>(i, j).into_owned() * r.transpose()
    };
    let (ff, mm) = (block(0, 0), block(3, 3));
    // Force and rotation are only coupled where the palm's stops press.
    let coupled = k.m34 != 0.0 || k.m35 != 0.0;
    let fm = if coupled { block(0, 3) } else { Matrix3::zeros() };
    let mf = fm.transpose();
    let (a, bt) = (skew(lever_a), skew(lever_b).transpose());
    let mut out = Matrix6::zeros();
    let top = ff * bt + fm;
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(&ff);
    out.fixed_view_mut::<3, 3>(0, 3).copy_from(&top);
    out.fixed_view_mut::<3, 3>(3, 0).copy_from(&(a * ff + mf));
    out.fixed_view_mut::<3, 3>(3, 3).copy_from(&(a * top + mf * bt + mm));
    out
}
