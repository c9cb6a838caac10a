//! Contact between a gripper and the cube: two pads with friction that may slip, and the palm's
//! stops.
//!
//! All quantities are at the tool point in tool axes: z approaches, the jaws move along y.
//!
//! - pads: two one-sided springs on the true faces. The jaws are coupled, so together they centre
//!   the cube along y, with a deadband of half the clearance. The grip is the lesser force of the
//!   two
//! - friction: x, z and the rotation about y start without stress where the pads close. Flat pads
//!   align the rotations about x and z, so geometry strains these while the grip grows. From then
//!   on friction holds all five
//! - slip surface: `(F_xz / 2 mu N)^2 + (M_xy / 0.6 Ts)^2 + (M_z / Ts)^2 <= 1` with
//!   `Ts = 2 mu N edge/2`. Outside, strains slide back to it: tilts first (pads rock before they
//!   slide), then force and torsion in proportion. If all slid in proportion, two degrees of tilt
//!   would leave no friction for a lateral force
//! - tilt: a cube that turns about x or z beyond the give of the rubber forces the jaws apart.
//!   About z a square between fingers of width w opens them to `(edge + w sin a) / cos a`, or to
//!   its corners; about x it opens them by the depth of the fingers times `sin a`. The grip drives
//!   the cube back with `N w` and `N depth`. That is the work of the opening at small angles, and
//!   less than half of it at 15 deg about z
//! - palm: four one-sided points of the two-position stops
//! - out: the wrench on the cube and its stiffness; a state that the caller commits once a substep

use super::config::Jaws;
use super::frame::{Frame, nearest_alignment, rotation_vector};
use crate::cell::{Cell, Gripper, PerArm};
use crate::motion::Depth;
use nalgebra::{Matrix6, Vector3};
use std::f64::consts::FRAC_PI_2;

/// Grip above which the pads are on a body (N).
pub(super) const CLOSED: f64 = 0.2;
/// Excess of the opening over the cube at which the jaws have let go (m). The layer between them
/// may be tilted by its play, and must be clear of both pads before it counts as part of the cube
/// again.
const OPEN_GAP: f64 = 1.5e-3;
/// Share of the pads' stiffness that remains where they do not press, so that the solver's matrix
/// stays regular.
const FREE: f64 = 1e-3;
/// Distance of the palm's stops from the tool axis along x and along y (m).
const STOP_SPACING: f64 = 0.020;
/// Stiffness of a finger's end on the cube's face from the front, or of its edge on another face
/// (N/m).
pub(super) const FRONT_STIFFNESS: f64 = 5e4;
/// Time without growth after which a grip has settled (s).
const SETTLING: f64 = 0.02;
/// Turn between the pads that does not force them apart, because the rubber gives (rad).
pub(super) const GIVE: f64 = 0.015;
/// Time constant with which the pads follow a tilt (s).
const FOLLOWS: f64 = 0.02;
/// Slip beyond which the grasp is lost (m, rad).
const LOST: (f64, f64) = (5e-3, 0.349);

/// Hold of a gripper's jaws on the cube.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(super) enum Hold {
    /// The jaws hold nothing.
    Open,
    /// The pads closed on the cube, and it has not left the hand.
    Closed,
    /// The pads have let go: they hold nothing, but a layer may still lean on the palm.
    LetGo,
}

/// State of a gripper's grasp.
#[derive(Debug, Clone, Copy, serde::Serialize, serde::Deserialize)]
pub(super) struct Grasp {
    /// Hold of the jaws.
    pub(super) hold: Hold,
    /// Whether the cube slipped too far: the grasp then holds nothing until the jaws have opened.
    pub(super) lost: bool,
    /// Index of the cube's body that the gripper touches, 0 or 1.
    pub(super) node: usize,
    /// `tool_from_body` without strain, of the grasp as closed.
    pub(super) reference: Frame,
    /// Offset of a layer in the hand from the core through its play, by axis, in the core's axes.
    /// It dates from the time when the layer was last a body of its own.
    pub(super) off: [Frame; 3],
    /// Slip of x, z (m), and of the rotations about x, y, z (rad).
    slid: [f64; 5],
    /// Rotations about x and z when the pads closed (rad).
    closed_tilt: [f64; 2],
    /// Tilt of the cube about x and z beyond the give, as the rubber follows it (rad).
    askew: [f64; 2],
    /// Greatest grip (N), and time since it last grew (s).
    grown: (f64, f64),
    /// Slip since closing (m, rad).
    pub(super) slip: (f64, f64),
    /// Whether this grasp's slip has been reported.
    pub(super) reported: bool,
}

/// Gripper and its surroundings in one evaluation.
pub(super) struct Hands<'a> {
    /// Sizes of the gripper.
    pub(super) gripper: &'a Gripper,
    /// Pads of the gripper.
    pub(super) jaws: &'a Jaws,
    /// Sizes of the body along the tool's axes, once it is aligned with them (m): three edges of a
    /// cube.
    pub(super) size: Vector3<f64>,
    /// Whether the pads may close anywhere along the body, as on a bar; a cube is expected with its
    /// centre on the tool's axis.
    pub(super) anywhere: bool,
    /// Distance between the pads (m).
    pub(super) opening: f64,
    /// Position of the palm's stops.
    pub(super) stops: Depth,
    /// Share that a fault leaves of the torque that turns a tilted cube back, 0 to 1.
    pub(super) hold: f64,
    /// Frame, in the body's, of the layer that open pads are about to touch: a lone layer may be
    /// turned against the body.
    pub(super) layer: Frame,
}

impl<'a> Hands<'a> {
    /// Makes the hand of an arm with full friction at a straight cube. Its pads are `jaws`, which
    /// are `opening` (m) apart.
    pub(super) fn at_cube(
        cell: &'a Cell,
        arm: usize,
        jaws: &'a Jaws,
        opening: f64,
        stops: Depth,
    ) -> Self {
        Self {
            gripper: &cell.arms[arm].gripper,
            jaws,
            size: Vector3::repeat(cell.cube.edge),
            anywhere: false,
            opening,
            stops,
            hold: 1.0,
            layer: Frame::IDENTITY,
        }
    }

    /// Checks whether an object whose nearer side is at `nearest` along the jaws (m) lies beside
    /// the hand, beyond the back of the finger on this side. The cube never lies there.
    fn is_behind(&self, nearest: f64) -> bool {
        self.anywhere && nearest >= 0.5 * self.opening + self.gripper.finger_thickness
    }
}

/// Contact of a gripper in one evaluation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Touch {
    /// Force on the cube at the tool point, in tool axes (N).
    pub(super) force: Vector3<f64>,
    /// Torque on the cube about the tool point, in tool axes (Nm).
    pub(super) torque: Vector3<f64>,
    /// Negated derivative of the wrench by displacement and rotation of the cube.
    pub(super) stiffness: Matrix6<f64>,
    /// Force of the pads at +y and -y (N).
    pub(super) pads: [f64; 2],
    /// Force of the palm's stops (N).
    pub(super) palm: f64,
    /// Distance of the palm's nearest stop from the face (m), below 0 where it presses; infinite
    /// far from it.
    pub(super) gap: f64,
    /// Force on the ends and edges of the fingers (N).
    pub(super) front: f64,
    /// Distance to which the cube forces the pads apart (m): the edge, or more where the cube is
    /// tilted.
    pub(super) width: f64,
    /// Tilt about x and z beyond the give of the rubber (rad).
    askew: [f64; 2],
    /// Slip after this evaluation, as in [`Grasp`].
    slid: [f64; 5],
    /// Slip in the plane of the pads in this evaluation (m).
    slip_step: f64,
}

impl Touch {
    pub(super) const NONE: Self = Self {
        force: Vector3::new(0.0, 0.0, 0.0),
        torque: Vector3::new(0.0, 0.0, 0.0),
        stiffness: Matrix6::new(
            0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0.,
            0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0.,
        ),
        pads: [0.0; 2],
        palm: 0.0,
        gap: f64::INFINITY,
        front: 0.0,
        width: 0.0,
        askew: [0.0; 2],
        slid: [0.0; 5],
        slip_step: 0.0,
    };

    /// Returns the grip, which is the smaller of the two pads' forces on the cube (N).
    pub(super) fn grip(&self) -> f64 {
        self.pads[0].min(self.pads[1])
    }

    /// Checks whether any part of the gripper (pad, palm or finger) touches the cube.
    pub(super) fn any(&self) -> bool {
        self.pads[0] + self.pads[1] + self.palm + self.front > 0.0
    }
}

impl Grasp {
    pub(super) const OPEN: Self = Self {
        hold: Hold::Open,
        lost: false,
        node: 0,
        reference: Frame::IDENTITY,
        off: [Frame::IDENTITY; 3],
        slid: [0.0; 5],
        closed_tilt: [0.0; 2],
        askew: [0.0; 2],
        grown: (0.0, 0.0),
        slip: (0.0, 0.0),
        reported: false,
    };

    /// Checks whether the pads have closed on the cube and it has not left the hand since. The pads
    /// may have let go already, with the palm still at the cube.
    pub(super) fn attached(&self) -> bool {
        self.hold != Hold::Open
    }

    /// Checks whether the grasp carries the cube: the pads are closed on it, and it has not slipped
    /// out.
    pub(super) fn holds(&self) -> bool {
        self.hold == Hold::Closed && !self.lost
    }

    /// Returns the `tool_from_body` of flat pads without strain around a body that is nearly
    /// aligned with them: exactly aligned, and centred on the tool's axis. A body that may be held
    /// `anywhere` along x is only centred along y.
    pub(super) fn flat(tool_from_body: &Frame, anywhere: bool) -> Frame {
        let along = if anywhere { tool_from_body.p.x } else { 0.0 };
        Frame {
            r: nearest_alignment(&tool_from_body.r),
            p: Vector3::new(along, 0.0, tool_from_body.p.z),
        }
    }

    /// Checks whether the jaws, `opening` (m) apart, have let go of the body that they held, which
    /// is `width` (m) wide between them.
    pub(super) fn lets_go(&self, touch: &Touch, opening: f64, width: f64) -> bool {
        self.attached() && touch.pads == [0.0; 2] && opening > width.max(touch.width) + OPEN_GAP
    }

    /// Checks whether the grasp has slipped by more than 1 mm or 3 deg since its jaws closed.
    pub(super) fn slipped(&self) -> bool {
        let (distance, angle) = self.slip;
        distance > 1e-3 || angle > 3_f64.to_radians()
    }

    /// Records that the pads have closed on the cube's body `node` (0 or 1), which is at
    /// `tool_from_body`. If it were at `flat`, the layer between the pads would lie flat against
    /// them.
    pub(super) fn close(&mut self, node: usize, tool_from_body: &Frame, flat: Frame) {
        let e = tool_from_body.times(&flat.inverse());
        let w = rotation_vector(&e.r);
        *self = Self {
            hold: Hold::Closed,
            lost: false,
            node,
            reference: flat,
            off: [Frame::IDENTITY; 3],
            // Displacements that flat pads do not align count as slid already: they start without
            // stress.
            slid: [e.p.x, e.p.z, 0.0, w.y, 0.0],
            closed_tilt: [w.x, w.z],
            askew: self.askew,
            grown: (0.0, 0.0),
            slip: (0.0, 0.0),
            reported: false,
        };
    }

    /// Records that the pads close again on a layer that they had let go and that still leans on
    /// the palm. The grasp keeps its strains.
    pub(super) fn close_again(&mut self) {
        self.hold = Hold::Closed;
        self.lost = false;
        self.grown = (0.0, 0.0);
        self.slip = (0.0, 0.0);
        self.reported = false;
    }

    /// Returns what is left of the grasp once it has ended: the pads keep the tilt that they have
    /// followed.
    pub(super) fn ended(&self) -> Self {
        Self { askew: self.askew, ..Self::OPEN }
    }

    /// Makes the grasp refer to the body `node`, whose frame in that of the former body is
    /// `old_from_new`. The pads stay where they are on the cube.
    pub(super) fn rename(&mut self, node: usize, old_from_new: &Frame) {
        self.node = node;
        self.reference = self.reference.times(old_from_new);
    }

    /// Returns the contact between a gripper and a body of the cube, from the frames of tool and
    /// body in the world. `hands` has sizes and opening of the gripper.
    pub(super) fn touch(&self, tool: &Frame, body: &Frame, hands: &Hands) -> Touch {
        let mut local = tool.to_local(body);
        let reach = hands.size.amax() + hands.gripper.palm;
        if !self.attached() && local.p.norm_squared() > reach * reach {
            return Touch::NONE;
        }
        let reference = if self.attached() {
            self.reference
        } else {
            // Open pads meet the lone layer first, whose tilt decides how they meet it.
            local = local.times(&hands.layer);
            Self::flat(&local, hands.anywhere)
        };
        let e = local.times(&reference.inverse());
        let w = rotation_vector(&e.r);
        let mut t = Touch::NONE;
        let half = hands.size * 0.5;
        let face = reference.p.z + e.p.z - half.z;
        let (g, j) = (hands.gripper, hands.jaws);

        // A finger is beside the cube, in front of it, or edge on. A grasp knows which; otherwise
        // the shortest way out decides. If each overlap counted as beside, a finger that meets an
        // edge would be 4 mm deep at once (387 N).
        let depth = g.finger_tip - face;
        t.askew = [w.x, w.z].map(beyond_give);
        // The pads keep the width of the last substep's tilt: the stiffness has no term that would
        // lead Newton to the present one.
        let [about_x, about_z] = self.askew;
        let (tilt, _) = libm::sincos(about_x.min(FRAC_PI_2));
        t.width = turned_width(&hands.size, g.finger_width, about_z)
            + depth.clamp(0.0, hands.size.z) * tilt;
        let between = 0.5 * t.width;
        let across = half.x + 0.5 * g.finger_width - local.p.x.abs();
        if across > 0.0 && depth > 0.0 && face + hands.size.z > -g.palm {
            for (i, side) in [1.0, -1.0].into_iter().enumerate() {
                let press = between + side * e.p.y - 0.5 * hands.opening;
                if press <= 0.0 || !self.attached() && hands.is_behind(side * e.p.y - between) {
                    continue;
                }
                // Beside: a pad presses along y.
                if self.attached() || press < depth.min(across) {
                    let k = 0.5 * j.stiffness[1];
                    t.pads[i] = (k * press).min(400.0);
                    t.force.y -= side * t.pads[i];
                    t.stiffness[(1, 1)] += k;
                } else if across < depth {
                    // Edge on: the finger pushes the cube out sideways, to the side from which it
                    // came.
                    let f = (FRONT_STIFFNESS * across).min(400.0);
                    t.front += f;
                    t.force.x += local.p.x.signum() * f;
                    t.stiffness[(0, 0)] += FRONT_STIFFNESS;
                } else {
                    // In front: the finger's end pushes the cube away along z.
                    let f = (FRONT_STIFFNESS * depth).min(400.0);
                    t.front += f;
                    let y = side * 0.5 * hands.opening;
                    point_load(&mut t, 0.0, y, f, FRONT_STIFFNESS);
                }
            }
        }
        palm(&mut t, hands, &local, face, &w);
        if self.attached() {
            self.friction(&mut t, hands, &e, &w);
            self.straighten(&mut t, hands, depth, &w);
        }
        t
    }

    /// Adds to `t` the torque with which the pads turn a tilted cube back. The fingers reach
    /// `depth` (m) over the cube, whose tilt is the rotation vector `w` (rad). The torque rises
    /// smoothly over the give of the rubber: with a step or a lag it jerked the cube with 29 N at a
    /// grip of 5 N.
    fn straighten(&self, t: &mut Touch, hands: &Hands, depth: f64, w: &Vector3<f64>) {
        let grip = if self.lost { 0.0 } else { hands.hold * t.grip() };
        let levers = [depth.clamp(0.0, hands.size.z), hands.gripper.finger_width];
        for ((axis, lever), askew) in [0, 2].into_iter().zip(levers).zip(t.askew) {
            t.torque[axis] -= w[axis].signum() * grip * lever * (askew / GIVE).min(1.0);
            if askew > 0.0 && askew < GIVE {
                t.stiffness[(3 + axis, 3 + axis)] += grip * lever / GIVE;
            }
        }
    }

    /// Adds to `t` the friction of the pads and their slip. The body is displaced by `e` from its
    /// place without strain, in tool axes; `w` is the rotation vector of `e` (rad). Elastic forces
    /// beyond the slip surface are returned to the surface, and the excess strain becomes slip.
    fn friction(&self, t: &mut Touch, hands: &Hands, e: &Frame, w: &Vector3<f64>) {
        let j = hands.jaws;
        let strain: [f64; 5] = [
            e.p.x - self.slid[0],
            e.p.z - self.slid[1],
            w.x - self.slid[2],
            w.y - self.slid[3],
            w.z - self.slid[4],
        ];
        let mut fx = -j.stiffness[0] * strain[0];
        let mut fz = -j.stiffness[2] * strain[1];
        let mut m = Vector3::from_fn(|i, _| -j.rotation[i] * strain[2 + i]);
        let grip = if self.lost { 0.0 } else { t.grip() };
        // Both pads rub, in torsion at half the edge from the axis. The least value avoids a
        // division by 0.
        let plane = (2.0 * j.friction * grip).max(1e-9);
        let torsion = plane * 0.5 * hands.size.y;
        let tilt = 0.6 * torsion;
        // While the grip grows, flat pads align the rotations about x and z; friction has no part
        // in them.
        let growing = self.grown.1 < SETTLING;
        let mut load = (fx * fx + fz * fz) / (plane * plane);
        let mut rocking = m.y * m.y / (tilt * tilt);
        if growing {
            m.x = m.x.clamp(-tilt, tilt);
            m.z = m.z.clamp(-torsion, torsion);
        } else {
            load += m.z * m.z / (torsion * torsion);
            rocking += m.x * m.x / (tilt * tilt);
        }
        let slide = |t: &mut Touch, keep: f64, which: &[usize]| {
            for i in which.iter().filter(|i| !growing || (**i != 2 && **i != 4)) {
                t.slid[*i] += (1.0 - keep) * strain[*i];
            }
        };
        t.slid = self.slid;
        // Return mapping: force and torsion slide back to the surface in proportion.
        if load > 1.0 {
            let keep = 1.0 / load.sqrt();
            fx *= keep;
            fz *= keep;
            if !growing {
                m.z *= keep;
            }
            slide(t, keep, &[0, 1, 4]);
            t.slip_step = (1.0 - keep) * strain[0].hypot(strain[1]);
        }
        // Pads rock before they slide: a tilt has what force and torsion leave of the friction.
        let room = (1.0 - load).max(0.01);
        if rocking > room {
            let keep = (room / rocking).sqrt();
            m.y *= keep;
            if !growing {
                m.x *= keep;
            }
            slide(t, keep, &[2, 3]);
        }
        t.force.x += fx;
        t.force.z += fz;
        t.torque += m;
        // Pads that do not press hold nothing back. With their full stiffness in the solver a layer
        // that the jaws have just left would creep home through its play, and jump the rest when
        // the jaws count as open (19.7 N on seed 13).
        let share = if grip > 0.0 { 1.0 } else { FREE };
        t.stiffness[(0, 0)] += share * j.stiffness[0];
        t.stiffness[(2, 2)] += share * j.stiffness[2];
        for i in 0..3 {
            t.stiffness[(3 + i, 3 + i)] += share * j.rotation[i];
        }
    }

    /// Stores the slip and the tilt of the contact `t`, the last evaluation of this substep of `dt`
    /// (s). A grasp that has slipped too far is lost.
    pub(super) fn commit(&mut self, t: &Touch, dt: f64) {
        for (askew, now) in self.askew.iter_mut().zip(t.askew) {
            *askew += (now - *askew) * dt / (dt + FOLLOWS);
        }
        if !self.attached() {
            return;
        }
        let about_jaws = (t.slid[3] - self.slid[3]).abs();
        self.slid = t.slid;
        self.slip.0 += t.slip_step;
        // A slip of the aligned rotations is only what exceeds the misalignment at closing.
        let beyond = (self.slid[2].abs() - self.closed_tilt[0].abs())
            .max(self.slid[4].abs() - self.closed_tilt[1].abs());
        self.slip.1 = (self.slip.1 + about_jaws).max(beyond);
        let grip = t.grip();
        // Growth of less than 2 % counts as a settled grip.
        if grip > 1.02 * self.grown.0 {
            self.grown = (grip, 0.0);
        } else {
            self.grown.1 += dt;
        }
        if self.slip.0 > LOST.0 || self.slip.1 > LOST.1 {
            self.lost = true;
        }
    }
}

/// Returns by how much the size of an angle exceeds the tilt to which the rubber gives, else 0
/// (rad).
fn beyond_give(angle: f64) -> f64 {
    (angle.abs() - GIVE).max(0.0)
}

/// Returns the distance to which a body of this `size` (m), turned by `angle` (rad) about z, forces
/// flat fingers of width `finger` (m) apart. For a body that is no square, the angle is below an
/// eighth of a turn: beyond it the grasp is lost.
fn turned_width(size: &Vector3<f64>, finger: f64, angle: f64) -> f64 {
    // A square repeats every quarter and is symmetric about an eighth.
    let angle = angle % FRAC_PI_2;
    let (s, c) = libm::sincos(angle.min(FRAC_PI_2 - angle));
    let (long, side) = (size.x, size.y);
    let corners = if long == side { side * (c + s) } else { side * c + long * s };
    // Fingers that reach beyond a corner rest on the corners.
    ((side + finger * s) / c).min(corners)
}

/// Adds to `t` the forces of the palm's stops on the cube, which is at `local` in the tool frame.
/// Its face is at z = `face` (m) and tilted by the rotation vector `w` (rad).
fn palm(t: &mut Touch, hands: &Hands, local: &Frame, face: f64, w: &Vector3<f64>) {
    let half = hands.size * 0.5;
    // A cube beside the hand or behind it does not meet the stops.
    if local.p.x.abs() > half.x || local.p.y.abs() > half.y || local.p.z < 0.0 - half.z {
        return;
    }
    let stop = match hands.stops {
        Depth::One => -Gripper::FACE_BEHIND_TOOL_ONE,
        Depth::Two => -Gripper::FACE_BEHIND_TOOL_TWO,
    };
    // A tilted face is nearer at its stops than in the middle. Without this term the stops would
    // press on a cube tilted by 20 deg with 180 N from one period to the next. A face farther away
    // than 5 mm does not count as near.
    let nearer = STOP_SPACING * (w.x.abs() + w.y.abs());
    if face - nearer > stop + 0.005 {
        return;
    }
    let k = 0.25 * hands.jaws.palm;
    for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        let (x, y) = (x * STOP_SPACING, y * STOP_SPACING);
        // The tilt of the face brings it nearer at one stop than at another.
        let press = stop - (face + w.x * y - w.y * x);
        t.gap = t.gap.min(-press);
        if press > 0.0 {
            let f = (k * press).min(400.0);
            t.palm += f;
            point_load(t, x, y, f, k);
        }
    }
}

/// Adds to `t` a force `f` (N) along the tool's +z at (x, y, 0), and its stiffness `k` (N/m).
fn point_load(t: &mut Touch, x: f64, y: f64, f: f64, k: f64) {
    t.force.z += f;
    t.torque.x += y * f;
    t.torque.y -= x * f;
    // The point moves along z by dz + y wx - x wy.
    let n = [(2, 1.0), (3, y), (4, -x)];
    for (i, a) in n {
        for (l, b) in n {
            t.stiffness[(i, l)] += k * a * b;
        }
    }
}

/// Returns the index of the only arm in a set; `None` for a set of none or several.
pub(super) fn only(set: PerArm<bool>) -> Option<usize> {
    let first = set.iter().position(|is| *is)?;
    (!set[first + 1..].contains(&true)).then_some(first)
}

#[cfg(test)]
mod tests {
    use super::super::frame::about;
    use super::super::testing::{EDGE, cell};
    use super::*;

    /// A random mix of faults found a force that rose from nothing to 180 N at a tilted face.
    #[test]
    fn palm_meets_tilted_face_without_a_jump() {
        let gripper = &cell().arms[0].gripper;
        let jaws = &Jaws::rubber();
        let hands = Hands {
            gripper,
            jaws,
            size: Vector3::repeat(EDGE),
            anywhere: false,
            opening: 0.2,
            stops: Depth::One,
            hold: 1.0,
            layer: Frame::IDENTITY,
        };
        for tilt in [0.0, 0.2, 0.35, 0.6] {
            let (mut last, mut most) = (0.0, 0.0_f64);
            // The cube comes from 60 mm to 5 mm from the tool point, in steps of 10 um.
            for step in 0..5500 {
                let p = Vector3::new(0.0, 0.0, 0.06 - 1e-5 * f64::from(step));
                let cube = Frame { r: about(&Vector3::x(), tilt), p };
                let palm = Grasp::OPEN.touch(&Frame::IDENTITY, &cube, &hands).palm;
                most = most.max(palm - last);
                last = palm;
            }
            assert!(last > 100.0 && most < 6.0, "{tilt} rad: {last} N, {most} N in 10 um");
        }
    }
}
