//! Layers that each gripper holds, and so the division of the cube into one body or two.
//!
//! - in: contacts of the pads
//! - out: grasps that close and open, the split of the cube
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | pads are on the cube | grip above `CLOSED` | one pad alone may only push it |
//! | jaws have let go | wider than the cube by `OPEN_GAP` | a loose layer is clear of both pads |
//! | a released layer joins the core | palm beyond `PALM_GAP` | it would jump against the stops |
//! | a pad holds a layer | overlap above `OVERLAP` | the mere edge of a pad holds nothing |

use super::StillWatch;
use super::balance::{Split, layer_angle};
use super::cube::{InterfaceLoad, Layers, MIDDLE};
use super::frame::{Frame, about, nearest_alignment};
use super::grasp::{CLOSED, GIVE, Grasp, Hands, Hold};
use super::undoing::Undoing;
use super::{Incident, Plant, State};
use crate::cube::Axis;
use nalgebra::Vector3;

/// Distance of the palm's stops from a released layer that keeps them clear once the layer lies on
/// the core again (m).
const PALM_GAP: f64 = 1e-3;
/// Overlap of a pad with a layer from which on the pad holds the layer (m).
const OVERLAP: f64 = 1e-3;
/// Share of a layer's misalignment that remains when pads close over it and its neighbour.
const FLUSH: f64 = 0.1;

impl Plant {
    /// Begins the grasps of jaws that have closed on the cube, and ends those of jaws that have let
    /// go of it.
    pub(super) fn change_grasps(&mut self) {
        let edge = self.config.cell.cube.edge;
        for i in 0..self.arms.len() {
            let touch = self.balance.touches[i];
            let (attached, grip) = (self.grasps[i].attached(), touch.grip());
            // A falling cube is not caught: it ends on the tray.
            let closes = grip > CLOSED && !matches!(self.state, State::Falling { .. });
            if !attached && closes {
                self.state = State::Held;
                self.close(i);
            } else if self.grasps[i].hold == Hold::LetGo {
                // A layer that joins the core while the palm presses it would jump by its play,
                // against the stops. So the grasp ends only once the palm is away. Fingers that
                // still lie at a tilted layer would be 1 mm deep in it at once if they counted as
                // open (154 N).
                let palm_is_away = self.balance.split.is_none() || touch.gap > PALM_GAP;
                if palm_is_away && !self.touches_when_open(i) {
                    self.end_grasp(i);
                } else if closes {
                    self.grasps[i].close_again();
                    self.closed(i);
                }
            } else if self.grasps[i].lets_go(&touch, self.jaws[i].opening(), edge) {
                if matches!(self.undoing, Undoing::Turn(_)) {
                    self.end_undoing();
                }
                // The layer stays a body of its own until the palm is away as well.
                self.grasps[i].hold = Hold::LetGo;
                self.record(Incident::Released { arm: i });
            }
        }
    }

    /// Begins the grasp of arm `i` on the cube: its pads align the layers that they press on. Then
    /// decides again whether the cube is one body or two.
    pub(super) fn close(&mut self, i: usize) {
        let core = self.balance.core(&self.puzzle);
        let tool = self.tool(i);
        let held = self.layers_held(i, &core);
        for (axis, layers) in held.iter().enumerate() {
            for side in 0..2 {
                let outer = 1 << (2 * side);
                if layers & outer != 0 && layers & MIDDLE != 0 {
                    // Pads over both layers press them flush, but for the give of the rubber.
                    self.puzzle.settle(axis);
                    self.puzzle.angles[axis][side] *= FLUSH;
                }
            }
        }
        let touched = core.times(&self.lone_layer(held));
        // A lone layer is what the pads align with; the body's strain-free frame follows from it.
        let flat = Grasp::flat(&tool.to_local(&touched), false);
        let body = self.balance.nodes[0];
        let reference = flat.times(&touched.to_local(&body));
        self.grasps[i].close(0, &tool.to_local(&body), reference);
        self.closed(i);
        self.regroup();
    }

    /// Returns the frame, in the core's, of an outer layer that a gripper holds without its
    /// neighbour: the core's frame turned by the angle of that layer. `held` are the layers that
    /// the gripper holds, by axis.
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

    /// Returns the frame, in the first body's, of the layer that the open gripper of arm `i` is
    /// about to touch; the identity for straight layers or closed jaws.
    pub(super) fn layer_ahead(&self, i: usize) -> Frame {
        // Layers that are off by less than the rubber gives count as straight.
        let straight = self.puzzle.angles.as_flattened().iter().all(|angle| angle.abs() < GIVE);
        if straight || self.grasps[i].attached() {
            return Frame::IDENTITY;
        }
        self.balance.nodes[0].to_local(&self.layer_at(i))
    }

    /// Returns the frame in the world of the layer that the gripper of arm `i` meets: that of a
    /// lone outer layer, or of the core.
    fn layer_at(&self, i: usize) -> Frame {
        let core = self.balance.core(&self.puzzle);
        core.times(&self.lone_layer(self.layers_held(i, &core)))
    }

    /// Checks whether the gripper of arm `i` would touch the cube where it is now if its grasp had
    /// ended.
    fn touches_when_open(&self, i: usize) -> bool {
        let (opening, stops) = (self.jaws[i].opening(), self.stops[i]);
        let hands = Hands::at_cube(&self.config.cell, i, &self.config.jaws, opening, stops);
        self.grasps[i].ended().touch(&self.tool(i), &self.layer_at(i), &hands).any()
    }

    /// Records that the jaws of arm `i` have closed on the cube.
    fn closed(&mut self, i: usize) {
        self.last_holder = Some(i);
        self.verdict.grasps[i] += 1;
        self.record(Incident::Grasped { arm: i });
    }

    /// Ends the grasp of arm `i`; the layer that it held joins the core.
    fn end_grasp(&mut self, i: usize) {
        // An open grasp has no part in a split, so the regrouping joins its layer to the core.
        self.grasps[i].hold = Hold::Open;
        self.regroup();
        self.grasps[i] = self.grasps[i].ended();
    }

    /// Decides from the grasps whether the cube is one body, or two that can turn against each
    /// other, and about which axis.
    pub(super) fn regroup(&mut self) {
        // Between two axes the misaligned one turns: it blocks the other.
        let split = self.splits().max_by(|a, b| {
            self.puzzle.misalignment(a.axis).total_cmp(&self.puzzle.misalignment(b.axis))
        });
        self.split_as(split);
    }

    /// Makes the cube two bodies with `split`, or one body with `None`. If this is a change, the
    /// angle of the turn counts from here.
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

    /// Chooses the axis about which a layer turns if the palms are at right angles. The cube could
    /// then turn about two axes; the layer whose friction is overcome first turns. The axis changes
    /// only if the present layer is near a quarter turn, where it does not block the other axis.
    pub(super) fn reconsider_axis(&mut self) {
        let Some(now) = self.balance.split else { return };
        if self.puzzle.misalignment(now.axis) > self.config.cube.corner_cut {
            return;
        }
        // The first gripper's wrench about the core is the load on both axes: the second hand
        // balances it.
        let core = self.balance.core(&self.puzzle);
        let hand = now.hands[0];
        let (tool, touch) = (self.tool(hand), &self.balance.touches[hand]);
        let force = tool.r * touch.force;
        let torque = tool.r * touch.torque + (tool.p - core.p).cross(&force);
        let load = |split: &Split| {
            let about = core.r.column(split.axis).dot(&torque).abs();
            let side = usize::from(split.layers[0] & 4 != 0 || split.layers[1] & 4 != 0);
            // Above 1 the layer would slip, without the load across the axis.
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

    /// Returns the possible divisions of the cube into two bodies while two grippers hold it: one
    /// for each axis along a palm's normal if that gripper holds an outer layer alone, and the
    /// grippers share no layer. A cube in three hands or more is one body.
    fn splits(&self) -> impl Iterator<Item = Split> + use<> {
        let core = self.balance.core(&self.puzzle);
        let mut found = [None; 3];
        let mut attached = (0..self.arms.len()).filter(|&i| self.grasps[i].attached());
        if let (Some(first), Some(second), None) =
            (attached.next(), attached.next(), attached.next())
        {
            let hands = [first, second];
            let held = hands.map(|hand| self.layers_held(hand, &core));
            for (axis, split) in found.iter_mut().enumerate() {
                let layers = [held[0][axis], held[1][axis]];
                // Hands with a common layer hold each other, and a hand without a layer holds
                // nothing to turn.
                let apart = layers[0] & layers[1] == 0 && layers[0] != 0 && layers[1] != 0;
                let under_a_palm = (0..2).any(|i| {
                    let local = self.tool(hands[i]).to_local(&core);
                    let along = nearest_alignment(&local.r)[(2, axis)] != 0.0;
                    along && matches!(layers[i], 1 | 4)
                });
                *split = (apart && under_a_palm).then_some(Split { axis, layers, hands });
            }
        }
        found.into_iter().flatten()
    }

    /// Returns for each axis of the cube the layers that a gripper's pads hold. Along the palm's
    /// axis they are those within the pads' depth, across it those within the pads' width. Along
    /// the jaws' axis they are the two outer layers, which friction holds by their faces.
    fn layers_held(&self, i: usize, core: &Frame) -> [Layers; 3] {
        let g = &self.config.cell.arms[i].gripper;
        let third = self.config.cell.cube.edge / 3.0;
        let local = self.tool(i).to_local(core);
        let aligned = nearest_alignment(&local.r);
        let overlapping = |centre: f64, sense: f64, low: f64, high: f64| -> Layers {
            // `centre` is the cube's place on the tool's axis; `sense` is the direction of its axis
            // there.
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

    /// Turns a layer that two hands have turned back towards its start, by at most `most` (rad),
    /// while the jaws stay closed.
    pub(super) fn undo_turn(&mut self, most: f64) {
        let turned = self.relative_angle() - self.angle_at_split;
        self.slip_layer(-turned.clamp(-most, most));
    }

    /// Turns a layer that has slipped back in its jaws to the nearest quarter turn, forward or
    /// back. A layer at another angle has no room between closed pads, which would meet its corners
    /// as they open.
    pub(super) fn end_undoing(&mut self) {
        let (angle, quarter) = (self.relative_angle(), std::f64::consts::FRAC_PI_2);
        self.slip_layer((angle / quarter).round() * quarter - angle);
    }

    /// Turns the layer that two hands have turned by `back` (rad) in its jaws. The grasp on this
    /// layer turns along, so that no force shows the slip.
    fn slip_layer(&mut self, back: f64) {
        let Some(split) = self.balance.split else { return };
        // The layer without the middle turns.
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

    /// Returns the angle of the second body's layer against that of the first (rad), 0 for one
    /// body.
    pub(super) fn relative_angle(&self) -> f64 {
        self.balance.split.map_or(0.0, |s| {
            layer_angle(&self.puzzle, s.axis, s.layers[1])
                - layer_angle(&self.puzzle, s.axis, s.layers[0])
        })
    }
}
