//! Balance of forces on the cube: the pose of the cube in the hands.
//!
//! The cube is quasi-static, because its mass is small against the stiffness of its contacts: in
//! each substep it is where pads, palms, the operator's hand, weight and its inner springs cancel.
//! While two grippers hold different layers of one axis the cube is two bodies, joined by an
//! interface with play whose turning part slips like friction. Otherwise it is one body.
//!
//! - in: poses of the tools, openings of the jaws, the operator's hold, the table's height
//! - out: poses of the bodies, wrench of each gripper on the cube, slip of layers and of grips
//! - method: Newton with the elastic stiffness (always positive definite) and return mapping of
//!   each friction at each evaluation. States are committed once a substep.
//!
//! | a round of the search | threshold | reason |
//! |---|---|---|
//! | ends the search early | `TOLERANCE` | the next substep takes up the rest |
//! | ends it from round `ROUNDS` on | `FAR` tolerances | more would show in a wrist sensor |
//! | ends it without a balance | `STALLED`, `MOST_ROUNDS` | slip on both sides has no balance |
//! | repeats half of its step | `OVERSHOT` | the step met or left a contact |

use super::cube::{InterfaceLoad, Layers, MIDDLE, Puzzle};
use super::frame::{Frame, about, rotation_vector, skew, solve};
use super::grasp::{Grasp, Hands, Touch, only};
use super::rest::{Bearing, Rest};

use crate::cell::{MOST_ARMS, PerArm};
use crate::cube::Axis;
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use std::ops::{AddAssign, SubAssign};

/// Newton rounds of a usual substep; the next substep takes up the small rest.
const ROUNDS: usize = 3;
/// Most rounds of a substep that is far out of balance: one-sided contacts can throw a light layer
/// to and fro.
const MOST_ROUNDS: usize = 15;
/// Rounds in a row without progress that end the search. A cube that slips on both sides finds no
/// balance, and the speed of its slip must not depend on the number of rounds.
const STALLED: usize = 2;
/// Imbalance that is far (tolerances): 0.1 N and 2 mNm, a load without a cause that a wrist sensor
/// would show.
const FAR: f64 = 20.0;
/// Growth of the imbalance in one round from which on the step was too long. Where friction slips,
/// a little growth is normal.
const OVERSHOT: f64 = 1.2;
/// Imbalance that counts as none (N, Nm).
const TOLERANCE: (f64, f64) = (5e-3, 1e-4);
/// Elastic stiffness of a layer that does not turn (Nm/rad).
const LAYER_STIFFNESS: f64 = 200.0;
/// Stiffness of another layer's corner in the way of a turn (Nm/rad).
const CORNER_STIFFNESS: f64 = 50.0;
/// Stiffness inside the play, as a share of that beyond it: the springs of the core's screws.
const INSIDE_PLAY: f64 = 0.05;

/// The operator's hold on the cube: a spring and a damper to a moving pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct HandHold {
    /// Pose at which the hand wants the cube.
    pub(super) world_from_cube: Frame,
    /// Stiffness (N/m); times 0.01 m2 it is that of the rotation (Nm/rad).
    pub(super) stiffness: f64,
    /// Damping (Ns/m); times 0.01 m2 it is that of the rotation (Nms/rad).
    pub(super) damping: f64,
}

/// Division into two bodies: the axis that turns between them, and the layers of each.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Split {
    /// Index of the axis, 0 to 2.
    pub(super) axis: usize,
    /// Layers of the first and of the second body along this axis.
    pub(super) layers: [Layers; 2],
    /// Arms whose grippers hold the first and the second body.
    #[serde(default = "first_two", skip_serializing_if = "are_first_two")]
    pub(super) hands: [usize; 2],
}

/// Returns the first two arms: files of cells with two arms do not name the hands of a split.
fn first_two() -> [usize; 2] {
    [0, 1]
}

/// Checks whether these are the first two arms.
fn are_first_two(hands: &[usize; 2]) -> bool {
    *hands == first_two()
}

/// Load on the interface between two bodies, and its slip in the last substep.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Interface {
    /// Torque about the axis, on the first body (Nm).
    pub(super) torque: f64,
    /// Torque at which it slips (Nm).
    pub(super) limit: f64,
    /// Torque across the axis, beyond the play (Nm).
    pub(super) tilt: f64,
    /// Force along the axis, on the first body (N).
    pub(super) axial: f64,
    /// Slip of the first body against the second (rad).
    slip: f64,
    /// Index of the body whose layer turns against the core.
    slipping: usize,
}

/// Everything around the cube that acts on it.
pub(super) struct Surroundings<'a> {
    /// `world_from_tool` of the arms.
    pub(super) tools: PerArm<Frame>,
    /// Grippers near the cube.
    pub(super) hands: PerArm<Option<Hands<'a>>>,
    /// Hold of the operator's hand.
    pub(super) hold: Option<HandHold>,
    /// Weight of the cube, with the force of inertia while one hand carries it, in the world (N).
    pub(super) weight: Vector3<f64>,
    /// Time of the substep (s).
    pub(super) dt: f64,
}

/// Poses of the cube's one or two bodies, and the contacts that hold them.
#[derive(Debug, Clone)]
pub(super) struct Balance {
    /// Poses of the bodies in the world; the second only counts when split.
    pub(super) nodes: [Frame; 2],
    /// Division into two bodies; `None` for one body.
    pub(super) split: Option<Split>,
    /// Load on the interface between the bodies.
    pub(super) interface: Interface,
    /// Contacts of the grippers in the last substep.
    pub(super) touches: PerArm<Touch>,
    /// Force of the operator's hand on the cube (N), in the world.
    pub(super) hand_force: Vector3<f64>,
    /// Pose of the first body in the last substep.
    before: Frame,
    /// Pose at which the operator's hand wanted the cube in the last substep.
    hand_before: Frame,
    /// Tools of the last substep.
    tools_before: Option<PerArm<Frame>>,
    /// Edge of the cube (m).
    edge: f64,
    /// Table under a cube of one body. A cube of two bodies is between two hands, far above it.
    rest: Rest,
}

impl Balance {
    /// Makes a cube of one body at rest, without contacts, with this edge (m). `table` is the
    /// height of the table (m).
    pub(super) fn new(world_from_cube: Frame, edge: f64, table: f64) -> Self {
        Self {
            edge,
            nodes: [world_from_cube; 2],
            split: None,
            interface: Interface::default(),
            touches: [Touch::NONE; MOST_ARMS],
            hand_force: Vector3::zeros(),
            before: world_from_cube,
            hand_before: world_from_cube,
            tools_before: None,
            rest: Rest::new(table, edge),
        }
    }

    /// Returns the force with which the table carried the cube in the last substep (N).
    pub(super) fn table_load(&self) -> f64 {
        self.rest.table_load
    }

    /// Checks that neither another gripper, the operator's hand nor the table acts on the cube, so
    /// that the cube moves along with the tool of `gripper`.
    pub(super) fn hangs_on(&self, gripper: usize) -> bool {
        let others = (0..MOST_ARMS).any(|i| i != gripper && self.touches[i].any());
        !others && self.hand_force == Vector3::zeros() && self.table_load() == 0.0
    }

    /// Sets the cube to saved poses of its bodies, at rest and without contacts.
    pub(super) fn restore(&mut self, nodes: [Frame; 2], split: Option<Split>) {
        *self = Self { nodes, split, ..Self::new(nodes[0], self.edge, self.rest.height) };
    }

    /// Returns the frame of the cube's core in the world. The core has the six centres and goes
    /// with the middle layer of a turn.
    pub(super) fn core(&self, puzzle: &Puzzle) -> Frame {
        match self.split {
            None => self.nodes[0],
            Some(s) => {
                // The core goes with the body that has the middle layer. If both hands hold outer
                // layers alone, it is the first body with its layer turned back.
                let body = usize::from(s.layers[0] & MIDDLE == 0);
                if s.layers[body] & MIDDLE == 0 {
                    self.unturned(0, s, puzzle)
                } else {
                    self.nodes[body]
                }
            }
        }
    }

    /// Returns a body's frame in the world with the turn of its layer taken back. Without play and
    /// strain this is the frame of the core.
    fn unturned(&self, body: usize, split: Split, puzzle: &Puzzle) -> Frame {
        let angle = layer_angle(puzzle, split.axis, split.layers[body]);
        let back = about(&Axis::ALL[split.axis].unit(), -angle);
        self.nodes[body].times(&Frame::rotated(back))
    }

    /// Makes the cube two rigid bodies with `split`, or one body with `None`. The bodies stay in
    /// place, except a layer that becomes a body of its own again while a gripper still holds it:
    /// this layer returns to its former offset from the core. Otherwise it would run through its
    /// play once more at each split, and a held layer would lean over by 9 mrad more each time. In
    /// the run with seed 20236 it did so, until the opening jaws met 35 N.
    pub(super) fn regroup(
        &mut self,
        split: Option<Split>,
        puzzle: &mut Puzzle,
        grasps: &mut PerArm<Grasp>,
    ) {
        if split == self.split {
            return;
        }
        let core = self.core(puzzle);
        if let Some(old) = self.split {
            // The offset is kept for the next split about the same axis.
            for grasp in grasps.iter_mut().filter(|grasp| grasp.attached()) {
                grasp.off[old.axis] = core.to_local(&self.unturned(grasp.node, old, puzzle));
            }
        }
        if let Some(old) = self.split
            && split.is_none_or(|s| s.axis != old.axis)
        {
            // Whole quarters become a permutation of the stickers: another description of the same
            // cube.
            puzzle.settle(old.axis);
        }
        let mut nodes = [core; 2];
        if let Some(s) = split {
            for (body, node) in nodes.iter_mut().enumerate() {
                let angle = layer_angle(puzzle, s.axis, s.layers[body]);
                let turned = Frame::rotated(about(&Axis::ALL[s.axis].unit(), angle));
                // Only an outer layer in a hand has an offset: the core defines the frame.
                let grasp = &grasps[s.hands[body]];
                let layer = s.layers[body] & MIDDLE == 0 && grasp.attached();
                let off = if layer { grasp.off[s.axis] } else { Frame::IDENTITY };
                *node = core.times(&off).times(&turned);
            }
        }
        for (i, grasp) in grasps.iter_mut().enumerate() {
            // A grasp stays where it is in the world: its reference is expressed in the new body.
            if grasp.attached() {
                let node = usize::from(split.is_some_and(|s| s.hands[1] == i));
                let old_from_new = self.nodes[grasp.node].to_local(&nodes[node]);
                grasp.rename(node, &old_from_new);
            }
        }
        self.nodes = nodes;
        self.before = nodes[0];
        self.split = split;
        self.interface = Interface::default();
    }

    /// Performs one substep: moves the bodies to where all forces on the cube balance, then commits
    /// the slip of pads and layers.
    pub(super) fn step(
        &mut self,
        puzzle: &mut Puzzle,
        grasps: &mut PerArm<Grasp>,
        around: &Surroundings,
    ) {
        // While the operator's hand holds the cube, no gripper carries it alone.
        if around.hold.is_none() {
            self.carry(grasps, &around.tools);
        }
        self.tools_before = Some(around.tools);
        let bearing = self.find_balance(puzzle, grasps, around);
        // Newton evaluates each friction several times, so slip is committed here, once.
        self.rest.commit(bearing);
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

    /// Moves the bodies, by Newton rounds, to where all forces on them balance. Returns how the
    /// table acts on the cube there, or `None` away from the table.
    fn find_balance(
        &mut self,
        puzzle: &Puzzle,
        grasps: &PerArm<Grasp>,
        around: &Surroundings,
    ) -> Option<Bearing> {
        let bodies = self.bodies();
        let mut rounds = Rounds::default();
        let mut system = System::new();
        loop {
            system.clear(bodies);
            let load = self.load(&mut system, puzzle, grasps, around);
            match rounds.judge(system.imbalance(bodies)) {
                Round::Ends => return load.bearing,
                Round::Halves => rounds.halve(&mut self.nodes[..bodies]),
                Round::Returns => rounds.go_back(&mut self.nodes[..bodies]),
                Round::Steps => {
                    self.stiffen(&mut system, &load, grasps, &around.tools);
                    rounds.go(&mut self.nodes, system.solve(bodies), bodies);
                }
            }
        }
    }

    /// Adds to the empty `system` the forces on the bodies at their present poses: grippers,
    /// weight, the operator's hand, the table, and the interface between two bodies. Returns table
    /// and interface, whose stiffness is still to be added.
    fn load(
        &mut self,
        system: &mut System,
        puzzle: &Puzzle,
        grasps: &PerArm<Grasp>,
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
        // Each body carries an equal share of the cube's weight.
        for residual in system.residual.iter_mut().take(bodies) {
            residual.fixed_rows_mut::<3>(0).add_assign(&(weight / bodies as f64));
        }
        if let Some(hold) = hold {
            self.hand_force = self.add_hold(system, hold, *dt);
            // A person holds the cube up: its spring of 300 N/m would sag by 3 mm under 1 N.
            system.residual[0].fixed_rows_mut::<3>(0).sub_assign(weight);
        }
        let bearing = if bodies == 1 { self.rest.contact(&self.nodes[0], *dt) } else { None };
        if let Some(bearing) = &bearing {
            system.residual[0].fixed_rows_mut::<3>(0).add_assign(&bearing.force);
            system.residual[0].fixed_rows_mut::<3>(3).add_assign(&bearing.torque);
        }
        let joint = self.split.map(|split| {
            let (interface, joint) = self.join(split, puzzle);
            self.interface = interface;
            system.load_joint(&joint, &self.nodes);
            joint
        });
        Load { bearing, joint }
    }

    /// Adds to `system` the wrench of the operator's hold on the first body, and the stiffness of
    /// the hold. Returns the force of the hold (N).
    fn add_hold(&self, system: &mut System, hold: &HandHold, dt: f64) -> Vector3<f64> {
        let (body, before, hand_before) = (&self.nodes[0], &self.before, &self.hand_before);
        let target = &hold.world_from_cube;
        let offset = target.p - body.p;
        // The damper sees the speed of the cube against the hand: it does not hold back a cube that
        // the hand carries.
        let speed = ((target.p - hand_before.p) - (body.p - before.p)) / dt;
        let force = offset * hold.stiffness + speed * hold.damping;
        // A hand's grip is about 0.1 m wide, so rotation has the stiffness times 0.01 m2.
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

    /// Adds to `system` the stiffness of the contacts with grippers and table, and of the interface
    /// between two bodies.
    fn stiffen(
        &self,
        system: &mut System,
        Load { bearing, joint }: &Load,
        grasps: &PerArm<Grasp>,
        tools: &PerArm<Frame>,
    ) {
        for (i, touch) in self.touches.iter().enumerate() {
            // Attached pads that do not press keep a small stiffness, which keeps the matrix
            // regular.
            if touch.any() || grasps[i].attached() {
                let body = self.body_of(&grasps[i]);
                let lever = tools[i].p - self.nodes[body].p;
                system.stiffness[body][body] +=
                    moved(&touch.stiffness, &tools[i].r, &lever, &lever);
            }
        }
        if let Some(bearing) = bearing {
            system.stiffness[0][0] += bearing.stiffness;
        }
        if let Some(joint) = joint {
            system.stiffen_joint(joint, &self.nodes);
        }
    }

    /// Adds the interface's slip of this substep to the angles of the outer layers of the body that
    /// slips.
    fn slip_layers(&self, puzzle: &mut Puzzle) {
        let Some(split) = self.split else { return };
        let body = self.interface.slipping;
        // The interface counts the slip of the first body; the second one slips the other way.
        let slip = if body == 0 { self.interface.slip } else { -self.interface.slip };
        for side in 0..2 {
            if split.layers[body] & (1 << (2 * side)) != 0 {
                puzzle.angles[split.axis][side] += slip;
            }
        }
    }

    /// Returns the number of bodies that the cube consists of: 2 while it is split, else 1.
    fn bodies(&self) -> usize {
        if self.split.is_some() { 2 } else { 1 }
    }

    /// Moves a cube that only one gripper holds along with its tool, as the solver's first guess.
    /// If the solver began at the cube's last pose, a tool at 0.5 m/s would seem to strain the pads
    /// beyond their friction, and the cube would slip.
    fn carry(&mut self, grasps: &PerArm<Grasp>, tools: &PerArm<Frame>) {
        let alone = only(grasps.each_ref().map(Grasp::attached));
        let (Some(alone), Some(before)) = (alone, self.tools_before) else { return };
        let moved = tools[alone].times(&before[alone].inverse());
        for node in &mut self.nodes {
            *node = moved.times(node);
        }
    }

    /// Returns the index of the body that a gripper touches.
    fn body_of(&self, grasp: &Grasp) -> usize {
        if grasp.attached() && self.split.is_some() { grasp.node } else { 0 }
    }

    /// Sets the previous pose of the operator's hand to `hold` when the hand has just taken hold.
    /// The jump to this pose then counts as no motion, which would be damped.
    pub(super) fn hand_comes(&mut self, hold: &Frame) {
        self.hand_before = *hold;
    }

    /// Sets the pose of the whole cube without a balance of forces: the operator carries the cube,
    /// or it falls.
    pub(super) fn place(&mut self, world_from_cube: Frame) {
        self.nodes = [world_from_cube; 2];
        self.before = world_from_cube;
    }

    /// Returns the load and the slip of the interface between the two bodies of `split`, and the
    /// spring that joins them.
    fn join(&self, split: Split, puzzle: &Puzzle) -> (Interface, Joint) {
        let m = &puzzle.mechanics;
        let unit = Axis::ALL[split.axis].unit();
        // Without their layers' angles both bodies have the core's frame; a difference strains the
        // interface.
        let ours = self.unturned(0, split, puzzle);
        let theirs = self.unturned(1, split, puzzle);
        let e = theirs.to_local(&ours);
        let w = rotation_vector(&e.r);
        // The interface lies between the layers: a sixth of the edge off the centre, towards the
        // lone outer layer.
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

        // Assumption: the play along the axis is half of the play across.
        let (f_across, k_across, lateral) = with_play(&across, m.play, m.stiffness);
        let (f_axial, k_axial, axial_load) = with_play(&(unit * axial), 0.5 * m.play, m.stiffness);
        let (t_tilt, k_tilt, tilt_load) = with_play(&tilt, m.tilt_play, m.tilt_stiffness);
        let load = InterfaceLoad { lateral, tilt: tilt_load, axial: axial_load };
        // A body of both outer layers slips on both sides of the middle one: the torques add.
        let limit = |body: usize| -> f64 {
            (0..2)
                .filter(|side| split.layers[body] & (1 << (2 * side)) != 0)
                .map(|side| puzzle.turning_torque(split.axis, side, load))
                .sum()
        };
        let (slipping, limit) = if let Some(body) = middle {
            (1 - body, limit(1 - body))
        } else {
            // The middle layer turns along with the neighbour that holds it better.
            let (a, b) = (limit(0), limit(1));
            if a <= b { (0, a) } else { (1, b) }
        };
        // A corner of a misaligned layer is a stop: it yields by its stiffness and never slips.
        let blocked = puzzle.blocked(split.axis);
        let k = if blocked { CORNER_STIFFNESS } else { LAYER_STIFFNESS };
        let trial = -k * twist;
        // Return mapping: beyond the limit the torque stays at the limit, and the excess becomes
        // slip. 2 % of the stiffness remain, or Newton would have no slope.
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

/// Returns the angle (rad) about `axis` by which the outer layers in the set `layers` are turned
/// against the core; 0 for a set with the middle layer.
pub(super) fn layer_angle(puzzle: &Puzzle, axis: usize, layers: Layers) -> f64 {
    match layers {
        1 => puzzle.angles[axis][0],
        // Both outer layers of one body turn together: one angle is enough.
        4 | 5 => puzzle.angles[axis][1],
        _ => 0.0,
    }
}

/// Returns, for a spring with play at the displacement `d`, its force, its stiffness, and the size
/// of the force beyond the play. Only this part presses on the layers and causes friction. `k` is
/// the stiffness beyond the play.
fn with_play(d: &Vector3<f64>, play: f64, k: f64) -> (Vector3<f64>, f64, f64) {
    let inside = INSIDE_PLAY * k;
    let size = d.norm();
    if size <= play {
        return (d * -inside, inside, 0.0);
    }
    let beyond = k * (size - play);
    (d * (-(inside + beyond / size)), k, beyond)
}

/// Spring between the bodies at a point of a frame, in the axes of that frame. Force and moment act
/// on the first body.
struct Joint {
    frame: Frame,
    at: Vector3<f64>,
    force: Vector3<f64>,
    moment: Vector3<f64>,
    stiffness: Matrix6<f64>,
}

/// Load of one round, beside grippers and hand, whose stiffness is still to be added.
struct Load {
    /// Load on the table.
    bearing: Option<Bearing>,
    /// Interface between two bodies.
    joint: Option<Joint>,
}

/// Step of one round: its start, its displacements (m, rad), and the imbalance at the start
/// (tolerances).
struct Step {
    from: [Frame; 2],
    moves: [Vector6<f64>; 2],
    imbalance: f64,
}

/// Decision on one round of a search for a balance.
pub(super) enum Round {
    /// The balance is good enough, or the search finds no better one.
    Ends,
    /// The last step was too long.
    Halves,
    /// The last step was too long, and no round is left: its start is the best balance found.
    Returns,
    /// A new step is due.
    Steps,
}

/// Progress of a search for a balance by Newton rounds.
#[derive(Default)]
pub(super) struct Rounds {
    /// Number of rounds done.
    round: usize,
    /// Rounds in a row without progress.
    stalled: usize,
    /// Last step.
    step: Option<Step>,
    /// Imbalance of this round (tolerances).
    left: f64,
}

impl Rounds {
    /// Checks whether no round was judged yet.
    pub(super) fn is_first(&self) -> bool {
        self.round == 0
    }

    /// Decides on a round whose imbalance is `left` (tolerances).
    pub(super) fn judge(&mut self, left: f64) -> Round {
        let round = self.round;
        // The first rounds seek the tolerance. After them an imbalance that is not far off is good
        // enough, and progress of less than 3 % counts as none.
        let enough = if round < ROUNDS { 1.0 } else { FAR };
        let before = self.step.as_ref().map_or(f64::INFINITY, |s| s.imbalance);
        let overshot = round > ROUNDS && left > OVERSHOT * before;
        let stalls = round > ROUNDS && left > 0.97 * before && !overshot;
        self.stalled = if stalls { self.stalled + 1 } else { 0 };
        if left < enough || self.stalled == STALLED {
            return Round::Ends;
        }
        if round == MOST_ROUNDS {
            return if overshot { Round::Returns } else { Round::Ends };
        }
        self.left = left;
        self.round += 1;
        if overshot { Round::Halves } else { Round::Steps }
    }

    /// Repeats half of the last step from the same start: the step met or left a contact that the
    /// stiffness does not contain.
    pub(super) fn halve(&mut self, nodes: &mut [Frame]) {
        if let Some(step) = &mut self.step {
            step.moves = step.moves.map(|m| 0.5 * m);
            step.go(nodes);
        }
    }

    /// Undoes the last step, so that the next round ends: nothing has overshot any more.
    pub(super) fn go_back(&mut self, nodes: &mut [Frame]) {
        if let Some(step) = self.step.take() {
            nodes.copy_from_slice(&step.from[..nodes.len()]);
        }
    }

    /// Moves the first `bodies` of `nodes` by `moves` (m, rad).
    pub(super) fn go(&mut self, nodes: &mut [Frame; 2], moves: [Vector6<f64>; 2], bodies: usize) {
        let step = self.step.insert(Step { from: *nodes, moves, imbalance: self.left });
        step.go(&mut nodes[..bodies]);
    }
}

impl Step {
    /// Places the bodies `nodes` at the end of the step.
    fn go(&self, nodes: &mut [Frame]) {
        for ((node, from), m) in nodes.iter_mut().zip(&self.from).zip(&self.moves) {
            *node = from.nudged(&m.fixed_rows::<3>(0).into(), &m.fixed_rows::<3>(3).into());
        }
    }
}

/// Residual wrenches on the bodies (force, and torque about their origins, in the world), and the
/// stiffness.
pub(super) struct System {
    pub(super) residual: [Vector6<f64>; 2],
    pub(super) stiffness: [[Matrix6<f64>; 2]; 2],
}

impl System {
    /// Makes a system without forces and stiffness.
    pub(super) fn new() -> Self {
        Self { residual: [Vector6::zeros(); 2], stiffness: [[Matrix6::zeros(); 2]; 2] }
    }

    /// Sets residuals and stiffness of the first `bodies` bodies to 0.
    pub(super) fn clear(&mut self, bodies: usize) {
        for i in 0..bodies {
            self.residual[i].fill(0.0);
            for j in 0..bodies {
                self.stiffness[i][j].fill(0.0);
            }
        }
    }

    /// Adds the wrench of a gripper's contact, `touch`, to the body of index `node`. `tool` and
    /// `body` are the frames of both in the world.
    pub(super) fn load(&mut self, node: usize, tool: &Frame, body: &Frame, touch: &Touch) {
        // The torque moves from the tool point to the body's origin.
        let lever = tool.p - body.p;
        let force = tool.r * touch.force;
        let torque = tool.r * touch.torque + lever.cross(&force);
        let r = &mut self.residual[node];
        r.fixed_rows_mut::<3>(0).add_assign(&force);
        r.fixed_rows_mut::<3>(3).add_assign(&torque);
    }

    /// Adds the wrench of the spring between the bodies to both of them. `nodes` are the frames of
    /// the bodies in the world.
    fn load_joint(&mut self, joint: &Joint, nodes: &[Frame; 2]) {
        let point = joint.frame.point(&joint.at);
        let (force, moment) = (joint.frame.r * joint.force, joint.frame.r * joint.moment);
        // The spring acts on both bodies, in opposite directions.
        for (body, sign) in [(0, 1.0), (1, -1.0)] {
            let lever = point - nodes[body].p;
            let r = &mut self.residual[body];
            r.fixed_rows_mut::<3>(0).add_assign(&(force * sign));
            r.fixed_rows_mut::<3>(3).add_assign(&((moment + lever.cross(&force)) * sign));
        }
    }

    /// Adds the stiffness of the spring between the bodies. `nodes` are the frames of the bodies in
    /// the world.
    fn stiffen_joint(&mut self, joint: &Joint, nodes: &[Frame; 2]) {
        let point = joint.frame.point(&joint.at);
        let [a, b] = nodes.map(|n| point - n.p);
        let spring =
            |a: &Vector3<f64>, b: &Vector3<f64>| moved(&joint.stiffness, &joint.frame.r, a, b);
        // The bodies strain the spring by their difference: the blocks off the diagonal are
        // negative.
        self.stiffness[0][0] += spring(&a, &a);
        self.stiffness[1][1] += spring(&b, &b);
        let between = spring(&a, &b);
        self.stiffness[0][1] -= between;
        self.stiffness[1][0] -= between.transpose();
    }

    /// Returns the largest unbalanced force or torque on a body, as a multiple of its tolerance.
    pub(super) fn imbalance(&self, bodies: usize) -> f64 {
        self.residual.iter().take(bodies).fold(0.0, |most, r| {
            let force = r.fixed_rows::<3>(0).amax() / TOLERANCE.0;
            f64::max(most, force.max(r.fixed_rows::<3>(3).amax() / TOLERANCE.1))
        })
    }

    /// Returns the displacement of each body (m, rad, in the world) that balances the residual
    /// under the linear stiffness, shortened to at most 1 mm and 1 deg.
    pub(super) fn solve(&self, bodies: usize) -> [Vector6<f64>; 2] {
        let mut moves = [Vector6::zeros(); 2];
        // Arrays of 6 and 12 unknowns: a period must not allocate.
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
        // At most 1 mm and 1 deg a round: a contact that appears within a round must not throw the
        // cube.
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

/// Adds a weak spring to each diagonal entry (50 N/m, 0.05 Nm/rad). A body that only one pad pushes
/// has no stiffness in some directions, and the matrix would be singular.
fn regularise<const N: usize>(a: &mut [[f64; N]; N]) {
    for (i, row) in a.iter_mut().enumerate() {
        row[i] += if i % 6 < 3 { 50.0 } else { 0.05 };
    }
}

/// Returns the stiffness `k` of a spring, given in its own axes `r`, moved to the origins of two
/// bodies a and b: the wrench about a's origin per displacement of b, in the world. `lever_a` and
/// `lever_b` lead from these origins to the spring.
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
    // Force and rotation are only coupled where the palm's stops or single points press; else two
    // products are saved.
    let coupled = k.fixed_view::<3, 3>(0, 3).iter().any(|k| *k != 0.0);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clear_empties_equations_of_force_balance() {
        for bodies in [1, 2] {
            let mut system = System::new();
            for i in 0..bodies {
                system.residual[i].fill(1.0);
                system.stiffness[i][..bodies].fill(Matrix6::identity());
            }

            system.clear(bodies);

            let empty = System::new();
            assert_eq!(system.residual, empty.residual);
            assert_eq!(system.stiffness, empty.stiffness);
        }
    }

    #[test]
    fn last_round_that_overshoots_is_undone() {
        let (mut rounds, mut nodes) = (Rounds::default(), [Frame::IDENTITY; 2]);
        let step = [Vector6::new(1e-3, 0.0, 0.0, 0.0, 0.0, 0.0), Vector6::zeros()];
        for i in 0..MOST_ROUNDS {
            assert!(matches!(rounds.judge(0.9_f64.powf(i as f64) * 1e4), Round::Steps));
            rounds.go(&mut nodes, step, 1);
        }
        let last = nodes[0].p.x;

        assert!(matches!(rounds.judge(1e6), Round::Returns));
        rounds.go_back(&mut nodes[..1]);
        assert!((nodes[0].p.x - (last - 1e-3)).abs() < 1e-12, "{}", nodes[0].p.x);
        assert!(matches!(rounds.judge(1e6), Round::Ends));
    }
}
