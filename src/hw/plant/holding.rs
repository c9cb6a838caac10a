//! Which gripper holds which layers, and so whether the cube is one body or two.
//!
//! - in: the pads' contacts
//! - out: grasps that close and open, the split of the cube

use super::StillWatch;
use super::balance::{Split, layer_angle};
use super::cube::{InterfaceLoad, Layers, MIDDLE};
use super::frame::{Frame, about, nearest_alignment};
use super::grasp::{GIVE, Grasp, Hold};
use super::{Incident, Plant, State};
use crate::cube::Axis;
use nalgebra::Vector3;

/// Pads that press more than this are on the cube (N).
const CLOSED: f64 = 0.2;
/// Jaws wider than the cube by this have let go (m): the layer between them may lie askew by its
/// play, and must be clear of both pads before it counts as part of the cube again.
const OPEN_GAP: f64 = 1.5e-3;
/// Stops nearer than this to the layer that the jaws have left may touch it once it lies on the
/// core again (m).
const PALM_GAP: f64 = 1e-3;
/// Overlap of a pad with a layer from which on it holds the layer (m).
const OVERLAP: f64 = 1e-3;
/// What is left of a layer's misalignment when pads close over it and its neighbour.
const FLUSH: f64 = 0.1;

impl Plant {
    /// Pads that met the cube or left it.
    pub(super) fn change_grasps(&mut self) {
        let edge = self.config.cell.cube.edge;
        for i in 0..self.arms.len() {
            let touch = self.balance.touches[i];
            let (attached, grip) = (self.grasps[i].attached(), touch.grip());
            let closes = grip > CLOSED && !matches!(self.state, State::Falling { .. });
            if !attached && closes {
                self.state = State::Held;
                self.close(i);
            } else if self.grasps[i].hold == Hold::LetGo {
                // A layer that joins the core while the palm presses it would jump by its play, against the stops.
                if self.balance.split.is_none() || touch.gap > PALM_GAP {
                    self.part(i);
                } else if closes {
                    self.grasps[i].close_again();
                    self.closed(i);
                }
            } else if attached
                && touch.pads == [0.0; 2]
                && self.jaws[i].opening() > edge.max(touch.width) + OPEN_GAP
            {
                self.grasps[i].hold = Hold::LetGo;
                self.record(Incident::Released { arm: i });
            }
        }
    }

    pub(super) fn close(&mut self, i: usize) {
        let core = self.balance.core(&self.puzzle);
        let tool = self.tool(i);
        let held = self.layers_held(i, &core);
        for (axis, layers) in held.iter().enumerate() {
            for side in 0..2 {
                let outer = 1 << (2 * side);
                if layers & outer != 0 && layers & MIDDLE != 0 {
                    // Pads over both layers press them flush, but for what the rubber gives.
                    self.puzzle.settle(axis);
                    self.puzzle.angles[axis][side] *= FLUSH;
                }
            }
        }
        let touched = core.times(&self.lone_layer(held));
        let flat = Grasp::flat(&tool.to_local(&touched));
        let body = self.balance.nodes[0];
        let reference = flat.times(&touched.to_local(&body));
        self.grasps[i].close(0, &tool.to_local(&body), reference);
        self.closed(i);
        self.regroup();
    }

    /// The layer that pads touch alone, in the core: it stands off by its misalignment.
    fn lone_layer(&self, held: [Layers; 3]) -> Frame {
        let mut touched = Frame::IDENTITY;
        for (axis, layers) in held.iter().enumerate() {
            let angle = layer_angle(&self.puzzle, axis, *layers);
            if matches!(layers, 1 | 4) {
                touched = touched.times(&Frame::rotated(about(&Axis::ALL[axis].unit(), angle)));
            }
        }
        touched
    }

    /// What an open hand is about to touch, in the body that it would touch first.
    pub(super) fn layer_ahead(&self, i: usize) -> Frame {
        let straight = self.puzzle.angles.as_flattened().iter().all(|angle| angle.abs() < GIVE);
        if straight || self.grasps[i].attached() {
            return Frame::IDENTITY;
        }
        let core = self.balance.core(&self.puzzle);
        let held = self.layers_held(i, &core);
        self.balance.nodes[0].to_local(&core.times(&self.lone_layer(held)))
    }

    fn closed(&mut self, i: usize) {
        self.last_holder = Some(i);
        self.verdict.grasps[i] += 1;
        self.record(Incident::Grasped { arm: i });
    }

    fn part(&mut self, i: usize) {
        self.grasps[i].hold = Hold::Open;
        self.regroup();
        self.grasps[i] = Grasp::OPEN;
    }

    /// Decides whether the cube is one body or two.
    pub(super) fn regroup(&mut self) {
        let split = self.splits().max_by(|a, b| {
            self.puzzle.misalignment(a.axis).total_cmp(&self.puzzle.misalignment(b.axis))
        });
        self.split_as(split);
    }

    fn split_as(&mut self, split: Option<Split>) {
        let before = self.balance.split;
        self.balance.regroup(split, &mut self.puzzle, &mut self.grasps);
        if split != before {
            self.angle_at_split = self.relative_angle();
            self.watch = StillWatch { since: self.period, ..StillWatch::default() };
            if split.is_some() {
                self.verdict.turned = 0.0;
            }
        }
    }

    /// Where the palms stand at right angles the cube can turn about two axes: it turns about the one whose layer
    /// gives way. The axis that turns now is left only near a quarter, where the others are not blocked by it.
    pub(super) fn reconsider_axis(&mut self) {
        let Some(now) = self.balance.split else { return };
        if self.puzzle.misalignment(now.axis) > self.config.cube.corner_cut {
            return;
        }
        let core = self.balance.core(&self.puzzle);
        let tool = self.tool(0);
        let touch = &self.balance.touches[0];
        let force = tool.r * touch.force;
        let torque = tool.r * touch.torque + (tool.p - core.p).cross(&force);
        let load = |split: &Split| {
            let about = core.r.column(split.axis).dot(&torque).abs();
            let side = usize::from(split.layers[0] & 4 != 0 || split.layers[1] & 4 != 0);
            about / self.puzzle.turning_torque(split.axis, side, InterfaceLoad::default())
        };
        let loaded_now = load(&now);
        let other = self
            .splits()
            .filter(|s| s.axis != now.axis && load(s) > 1.0 && load(s) > loaded_now)
            .max_by(|a, b| load(a).total_cmp(&load(b)));
        if other.is_some() {
            self.split_as(other);
        }
    }

    /// The axes that could turn while both hold: those under a palm's lone layer.
    fn splits(&self) -> impl Iterator<Item = Split> + use<> {
        let both = self.grasps.iter().all(Grasp::attached) && self.arms.len() == 2;
        let core = self.balance.core(&self.puzzle);
        let mut found = [None; 3];
        if both {
            let held = [self.layers_held(0, &core), self.layers_held(1, &core)];
            for (axis, split) in found.iter_mut().enumerate() {
                let layers = [held[0][axis], held[1][axis]];
                let apart = layers[0] & layers[1] == 0 && layers[0] != 0 && layers[1] != 0;
                let under_a_palm = (0..2).any(|i| {
                    let local = self.tool(i).to_local(&core);
                    let along = nearest_alignment(&local.r)[(2, axis)] != 0.0;
                    along && matches!(layers[i], 1 | 4)
                });
                *split = (apart && under_a_palm).then_some(Split { axis, layers });
            }
        }
        found.into_iter().flatten()
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

    /// A layer that was turned between two hands slips back under the jaws, by so much at most
    /// (rad): it and what the jaws hold of it go back together, so nobody feels it.
    pub(super) fn undo_turn(&mut self, most: f64) {
        let Some(split) = self.balance.split else { return };
        let turned = self.relative_angle() - self.angle_at_split;
        let back = -turned.clamp(-most, most);
        // The layer that turns is the one without the middle.
        let body = usize::from(split.layers[1] & MIDDLE == 0);
        let by = if body == 1 { back } else { -back };
        for side in 0..2 {
            if split.layers[body] & (1 << (2 * side)) != 0 {
                self.puzzle.angles[split.axis][side] += by;
            }
        }
        let turn = Frame::rotated(about(&Axis::ALL[split.axis].unit(), by));
        self.balance.nodes[body] = self.balance.nodes[body].times(&turn);
        for grasp in self.grasps.iter_mut().filter(|g| g.attached() && g.node == body) {
            grasp.rename(body, &turn);
        }
    }

    /// Angle of the second body's layer against the first's (rad).
    pub(super) fn relative_angle(&self) -> f64 {
        self.balance.split.map_or(0.0, |s| {
            layer_angle(&self.puzzle, s.axis, s.layers[1])
                - layer_angle(&self.puzzle, s.axis, s.layers[0])
        })
    }
}
