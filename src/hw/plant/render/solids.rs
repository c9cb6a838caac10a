//! Visible bodies of the cell, as flat plates and round rods in the world frame.
//!
//! - in: a [`Scene`], the [`Setting`] that does not move, the [`Look`] of the cube and the hand
//! - out: [`Solids`]; a box is six plates, the cube is one box, or three slabs while a layer is
//!   turned

use super::look::{CubeLook, HandLook, Look, Rgb};
use crate::cell::{Cell, Gripper, MOST_ARMS, PerArm, TABLE_TOP};
use crate::cube::{Axis, Face, Keeper};
use crate::hw::scene::{Scene, SceneArm, SceneCube, SceneObject, SceneShape};
use crate::spatial::Pose;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

/// Fixed bodies of the cell, and the sizes of the grippers.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    /// True sizes of the grippers, in the order of effectors.
    pub grippers: PerArm<Gripper>,
    /// Centre of the table top, in the world (m).
    pub table: Point3<f64>,
    /// Size of the table top along x and y (m).
    pub table_size: (f64, f64),
    /// Inner size of the tray along x and y (m); it lies in the middle of the table.
    pub tray_size: (f64, f64),
    /// Height of the tray's felt above the table top (m); the felt is sunk into the table if the
    /// cube lies on it.
    pub felt: f64,
    /// Inner corners of the room with the lowest and the highest coordinates, in the world (m); the
    /// floor is z = 0.
    pub room: (Point3<f64>, Point3<f64>),
    /// Optical frames of the fixed cameras, which only the overview draws.
    pub cameras: Vec<Pose>,
}

impl Default for Setting {
    fn default() -> Self {
        let gripper = Gripper {
            finger_width: 0.014,
            finger_thickness: 0.012,
            finger_tip: 0.0095,
            palm: 0.040,
            palm_half_width: 0.030,
            opening: (0.053, 0.091),
            opening_of_motor: [0.074, -1.451_910_074e-5, -2.8313e-9],
            opening_offset: 0.0,
            increments: 128.0,
            amperes_per_newton: 0.004,
        };
        Self {
            grippers: [gripper; MOST_ARMS],
            table: Point3::new(0.9, 1.05, 0.70),
            table_size: TABLE_TOP,
            tray_size: (0.5, 0.7),
            felt: 0.002,
            room: (Point3::new(-2.6, -2.6, 0.0), Point3::new(3.2, 4.4, 3.2)),
            cameras: Vec::new(),
        }
    }
}

impl Setting {
    /// Makes the setting of a cell: its grippers, the table under the place of the hand-over, and
    /// its fixed cameras.
    #[must_use]
    pub fn of(cell: &Cell) -> Self {
        let mut setting = Self::default();
        for (mine, arm) in setting.grippers.iter_mut().zip(&cell.arms) {
            *mine = arm.gripper;
        }
        let hand = cell.hand.world_from_cube.translation.vector;
        setting.table = Point3::new(hand.x, hand.y, cell.table_height);
        // The plant carries the cube at the table top, so the felt must not hide the cube's lower
        // edge. It keeps 0.2 mm, because rounding would decide between two surfaces at one height.
        if cell.keeper == Keeper::Table {
            setting.felt = 2e-4;
        }
        // The walls keep 3 m from both bases, so that no arm reaches through them.
        let reach = Vector3::new(3.0, 3.0, 0.0);
        for base in cell.arms.iter().map(|arm| arm.world_from_base.translation.vector) {
            let (low, high) = &mut setting.room;
            *low = Point3::from(low.coords.inf(&(base - reach)));
            *high = Point3::from(high.coords.sup(&(base + reach)));
        }
        setting.room.0.z = 0.0;
        for camera in &cell.cameras {
            if let crate::cell::Mount::World { world_from_camera } = camera.mount {
                setting.cameras.push(world_from_camera);
            }
        }
        setting
    }
}

/// Cover of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Skin {
    /// One paint with its reflectance and its gloss.
    Plain(Rgb, f32),
    /// Nine stickers in reading order, by colours 0..=5, and the side of a cubie (m).
    Stickers([u8; 9], f64),
}

/// Flat rectangle that is visible from its front.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plate {
    /// Origin of the plate coordinates u and v.
    pub(super) origin: Point3<f64>,
    /// Unit vector to the right.
    pub(super) u: Vector3<f64>,
    /// Unit vector down.
    pub(super) v: Vector3<f64>,
    /// Outward normal.
    pub(super) normal: Vector3<f64>,
    /// Lower and upper bound of u, then of v (m).
    pub(super) bounds: [f64; 4],
    /// Cover of the plate.
    pub(super) skin: Skin,
}

impl Plate {
    /// Returns the point at the plate coordinates (u, v).
    pub(super) fn at(&self, u: f64, v: f64) -> Point3<f64> {
        self.origin + self.u * u + self.v * v
    }

    /// Returns the four corners, in order around the plate.
    pub(super) fn corners(&self) -> [Point3<f64>; 4] {
        let [u0, u1, v0, v1] = self.bounds;
        [self.at(u0, v0), self.at(u1, v0), self.at(u1, v1), self.at(u0, v1)]
    }

    /// Transforms the plate into another frame.
    fn moved(mut self, to_from: &Pose) -> Self {
        self.origin = to_from * self.origin;
        self.u = to_from.rotation * self.u;
        self.v = to_from.rotation * self.v;
        self.normal = to_from.rotation * self.normal;
        self
    }
}

/// Cylinder with hemispheres as ends.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rod {
    /// Centre of the sphere at one end.
    pub(super) a: Point3<f64>,
    /// Centre of the sphere at the other end.
    pub(super) b: Point3<f64>,
    /// Radius (m).
    pub(super) radius: f64,
    /// Reflectance.
    pub(super) paint: Rgb,
    /// Gloss.
    pub(super) gloss: f32,
}

/// Bodies of a picture, in the world frame.
#[derive(Debug, Clone, Default)]
pub(super) struct Solids {
    pub(super) plates: Vec<Plate>,
    pub(super) rods: Vec<Rod>,
}

/// Reflectance of fingers, flange and rims.
const STEEL: Rgb = [0.30, 0.31, 0.33];
/// Reflectance of axles, palms, legs and rails.
const DARK: Rgb = [0.045, 0.047, 0.05];
/// Reflectance of the pads.
const RUBBER: Rgb = [0.03, 0.03, 0.03];
/// Reflectance of the table top.
const WOOD: Rgb = [0.42, 0.33, 0.24];
/// Reflectances of the objects, in the order of the scene: dull paints, unlike stickers.
const PAINTS: [Rgb; 4] =
    [[0.20, 0.24, 0.28], [0.30, 0.25, 0.20], [0.22, 0.27, 0.22], [0.28, 0.22, 0.27]];
/// Boxes of which a round body consists: together they have four times as many sides.
const PRISM: u32 = 6;
/// Reflectance of the tray's bottom.
const FELT: Rgb = [0.12, 0.14, 0.15];

impl Solids {
    /// Empties the lists and keeps their memory.
    pub(super) fn clear(&mut self) {
        self.plates.clear();
        self.rods.clear();
    }

    /// Adds the bodies that move. `own` is the arm that carries the camera, of which only the
    /// gripper is added: its links are behind the camera.
    pub(super) fn add_moving(
        &mut self,
        scene: &Scene,
        setting: &Setting,
        look: &Look,
        own: Option<usize>,
    ) {
        self.add_cube(&scene.cube, &look.cube);
        for (index, arm) in scene.arms.iter().enumerate().take(scene.arm_count) {
            self.add_gripper(arm, &setting.grippers[index]);
            if own != Some(index) {
                self.add_links(arm, &setting.grippers[index], look.arm);
            }
        }
        for (index, object) in scene.objects.iter().enumerate() {
            if let Some(object) = object {
                self.add_object(object, index);
            }
        }
        if let Some(world_from_hand) = scene.hand {
            self.add_hand(&world_from_hand, &look.hand, scene.cube.edge);
        }
    }

    /// Adds the table and the tray.
    pub(super) fn add_furniture(&mut self, setting: &Setting) {
        let (top, (w, d)) = (setting.table, setting.table_size);
        let at = |x: f64, y: f64, z: f64| Pose::translation(top.x + x, top.y + y, top.z + z);
        let half = |x: f64, y: f64, z: f64| Vector3::new(x, y, z);
        self.add_box(&at(0.0, 0.0, -0.015), half(w / 2.0, d / 2.0, 0.015), WOOD, 0.0);
        for (sx, sy) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let leg = (top.z - 0.03) / 2.0;
            let place = at(sx * (w / 2.0 - 0.04), sy * (d / 2.0 - 0.04), -0.03 - leg);
            self.add_box(&place, half(0.02, 0.02, leg), DARK, 0.0);
        }
        let (tw, td) = setting.tray_size;
        // A box of 2 mm whose top is the felt; the rest of it lies inside the table.
        self.add_box(
            &at(0.0, 0.0, setting.felt - 0.001),
            half(tw / 2.0, td / 2.0, 0.001),
            FELT,
            0.0,
        );
        for side in [-1.0, 1.0] {
            let rim = 0.006;
            self.add_box(
                &at(side * (tw / 2.0 + rim), 0.0, 0.012),
                half(rim, td / 2.0 + 2.0 * rim, 0.012),
                STEEL,
                0.0,
            );
            self.add_box(
                &at(0.0, side * (td / 2.0 + rim), 0.012),
                half(tw / 2.0, rim, 0.012),
                STEEL,
                0.0,
            );
        }
    }

    /// Adds a box of one paint, given by the pose of its centre and half its sides (m).
    pub(super) fn add_box(
        &mut self,
        world_from_box: &Pose,
        half: Vector3<f64>,
        paint: Rgb,
        gloss: f32,
    ) {
        // The faces of the cube also serve as the six sides of a box.
        for face in Face::ALL {
            let (u, v) = face.reading_axes();
            let normal = face.normal();
            let (hu, hv) = (u.dot(&half).abs(), v.dot(&half).abs());
            let plate = Plate {
                origin: Point3::from(normal * normal.dot(&half).abs()),
                u,
                v,
                normal,
                bounds: [-hu, hu, -hv, hv],
                skin: Skin::Plain(paint, gloss),
            };
            self.plates.push(plate.moved(world_from_box));
        }
    }

    /// Adds a rigid object, the one with this `index` in the scene. A cylinder is a prism, and a
    /// surface is a row of blocks with sloping lids.
    pub(super) fn add_object(&mut self, object: &SceneObject, index: usize) {
        let (pose, paint, gloss) = (&object.world_from_object, PAINTS[index % PAINTS.len()], 0.1);
        match &object.shape {
            SceneShape::Box(half) => self.add_box(pose, Vector3::from(*half), paint, gloss),
            SceneShape::Cylinder { radius, half } => {
                let step = std::f64::consts::FRAC_PI_2 / f64::from(PRISM);
                let (s, c) = libm::sincos(0.5 * step);
                // Crossed boxes cover a polygon: each has two of its sides as its short ones.
                for i in 0..2 * PRISM {
                    let turn = Pose::rotation(Vector3::z() * (step * f64::from(i)));
                    let size = Vector3::new(radius * c, radius * s, *half);
                    self.add_box(&(pose * turn), size, paint, gloss);
                }
            }
            SceneShape::Surface { half: [long, wide], heights } => {
                let step = 2.0 * long / (heights.len() - 1) as f64;
                for (i, pair) in heights.windows(2).enumerate() {
                    let x = (i as f64 + 0.5) * step - long;
                    let (low, mean) = (pair[0].min(pair[1]), f64::midpoint(pair[0], pair[1]));
                    let block = pose * Pose::translation(x, 0.0, 0.5 * low);
                    self.add_box(&block, Vector3::new(0.5 * step, *wide, 0.5 * low), paint, gloss);
                    let rise = pair[1] - pair[0];
                    let tilt = Pose::rotation(Vector3::y() * -libm::atan2(rise, step));
                    let lid = pose * Pose::translation(x, 0.0, mean) * tilt;
                    let size = Vector3::new(0.5 * step.hypot(rise), *wide, 5e-4);
                    self.add_box(&lid, size, paint, gloss);
                }
            }
        }
    }

    /// Adds the cube: one box, or three slabs if a layer is turned.
    pub(super) fn add_cube(&mut self, cube: &SceneCube, look: &CubeLook) {
        let (axis, low, high) = cube.turned;
        let stickers = |face: Face| {
            let first = face as usize * 9;
            // Bounded, because the colours are indices into the look's stickers.
            let colours = std::array::from_fn(|i| cube.facelets[first + i].min(5));
            Skin::Stickers(colours, cube.edge / 3.0)
        };
        let whole = cube.edge / 2.0;
        let side = |face: Face| {
            let (u, v) = face.reading_axes();
            Plate {
                origin: Point3::from(face.normal() * whole),
                u,
                v,
                normal: face.normal(),
                bounds: [-whole, whole, -whole, whole],
                skin: stickers(face),
            }
        };
        if low == 0.0 && high == 0.0 {
            for face in Face::ALL {
                self.plates.push(side(face).moved(&cube.world_from_cube));
            }
            return;
        }
        // Each layer is a slab. The angles of the outer ones are relative to the middle one, whose
        // pose is that of the cube.
        let cut = cube.edge / 6.0;
        let inside = Skin::Plain(look.body, 0.2 * look.gloss);
        for (angle, from, to) in [(low, -whole, -cut), (0.0, -cut, cut), (high, cut, whole)] {
            let turn = UnitQuaternion::from_scaled_axis(axis.unit() * angle);
            let world_from_slab =
                cube.world_from_cube * Pose::from_parts(Translation3::identity(), turn);
            for face in Face::ALL {
                let mut plate = side(face);
                if face.axis() == axis {
                    // The face moves along the axis to the end of its slab. It keeps its stickers
                    // only on the outside of the cube.
                    let along = face.normal().dot(&axis.unit());
                    let out = if along > 0.0 { to } else { -from };
                    plate.origin = Point3::from(face.normal() * out);
                    if out != whole {
                        plate.skin = inside;
                    }
                } else {
                    // The stickers keep their places, so a slab shows a strip of the whole face.
                    plate.bounds = slab_bounds(&plate, axis, from, to);
                }
                self.plates.push(plate.moved(&world_from_slab));
            }
        }
    }

    /// Adds the fingers, pads and palm plate of a gripper.
    pub(super) fn add_gripper(&mut self, arm: &SceneArm, gripper: &Gripper) {
        let pose = &arm.world_from_tool;
        let pad = 0.002;
        let (low, high) = (-gripper.palm, gripper.finger_tip);
        let (w, t) = (gripper.finger_width / 2.0, gripper.finger_thickness);
        for side in [-1.0, 1.0] {
            // The opening is measured between the pads, so a finger begins behind its pad.
            let y = side * (arm.opening / 2.0 + pad + (t - pad) / 2.0);
            let finger = pose * Pose::translation(0.0, y, f64::midpoint(low, high));
            let half = Vector3::new(w, (t - pad) / 2.0, (high - low) / 2.0);
            self.add_box(&finger, half, STEEL, 0.25);
            // A pad reaches 28.5 mm, half an edge of the cube, from the tool point to the palm.
            let length = (high + 0.0285).min(high - low);
            let rubber = pose
                * Pose::translation(0.0, side * (arm.opening + pad) / 2.0, high - length / 2.0);
            self.add_box(&rubber, Vector3::new(w, pad / 2.0, length / 2.0), RUBBER, 0.0);
        }
        let plate = 0.006;
        let p = gripper.palm_half_width;
        // The front of the plate is at `palm`. It is at least as wide as the open fingers.
        let palm = pose * Pose::translation(0.0, 0.0, -gripper.palm - plate);
        self.add_box(&palm, Vector3::new(p, p.max(arm.opening / 2.0 + t), plate), DARK, 0.1);
    }

    /// Adds the column, lower and upper arm, wrist and the gripper's body of an arm.
    pub(super) fn add_links(&mut self, arm: &SceneArm, gripper: &Gripper, paint: Rgb) {
        let [base, shoulder, elbow, wrist, flange] = arm.points;
        let mut rod =
            |a, b, radius, paint| self.rods.push(Rod { a, b, radius, paint, gloss: 0.15 });
        let up = Vector3::z();
        rod(base + up * 0.36, shoulder - up * 0.10, 0.13, paint);
        // The axles of shoulder, elbow and wrist are normal to the plane of the arm. A straight arm
        // spans no plane, and then any direction will do.
        let across = (elbow - shoulder).cross(&(wrist - elbow));
        let across = across.try_normalize(1e-9).unwrap_or_else(Vector3::x);
        rod(shoulder - across * 0.13, shoulder + across * 0.13, 0.09, DARK);
        rod(shoulder, elbow, 0.075, paint);
        rod(elbow - across * 0.08, elbow + across * 0.08, 0.07, DARK);
        rod(elbow, wrist, 0.058, paint);
        rod(wrist - across * 0.05, wrist + across * 0.05, 0.055, DARK);
        rod(wrist, flange, 0.042, STEEL);
        let palm = arm.world_from_tool * Point3::new(0.0, 0.0, -gripper.palm - 0.045);
        rod(flange, palm, 0.034, STEEL);
        // The base is below the shoulder, so `along` is zero up to the tilt of a true base.
        let along = base.xy() - shoulder.xy();
        let foot = Pose::translation(base.x + along.x, base.y + along.y, base.z + 0.18);
        self.add_box(&foot, Vector3::new(0.20, 0.20, 0.18), STEEL, 0.0);
    }

    /// Adds the rails on which the foot of the first arm slides along the world's y.
    pub(super) fn add_track(&mut self, arm: &SceneArm) {
        let base = arm.points[0];
        for side in [-0.13, 0.13] {
            // The rails do not follow the foot, unless it is at a negative y.
            let rail = Pose::translation(base.x + side, base.y.min(0.0) + 0.5, base.z + 0.03);
            self.add_box(&rail, Vector3::new(0.03, 0.95, 0.03), DARK, 0.2);
        }
    }

    /// Adds a camera, which looks along its z, on a tripod.
    pub(super) fn add_camera_stand(&mut self, world_from_camera: &Pose) {
        // The body is behind the optical centre, so it does not hide what the camera sees.
        let behind = world_from_camera * Point3::new(0.0, 0.0, -0.07);
        let lens = world_from_camera * Point3::new(0.0, 0.0, -0.03);
        let body = world_from_camera * Pose::translation(0.0, 0.0, -0.09);
        self.add_box(&body, Vector3::new(0.028, 0.025, 0.045), DARK, 0.2);
        let rod = |a, b, radius, paint| Rod { a, b, radius, paint, gloss: 0.3 };
        self.rods.push(rod(behind, lens, 0.02, RUBBER));
        let foot = Point3::new(behind.x, behind.y, 0.02);
        self.rods.push(rod(foot, behind - Vector3::z() * 0.03, 0.014, STEEL));
        for (x, y) in [(0.22, 0.0), (-0.11, 0.19), (-0.11, -0.19)] {
            let leg = rod(foot + Vector3::new(x, y, 0.0), foot + Vector3::z() * 0.25, 0.01, STEEL);
            self.rods.push(leg);
        }
    }

    /// Adds the operator's hand: fingertips on both sides of the cube, the palm beyond its +x face,
    /// and the forearm. The origin of the hand frame is taken as the centre of the cube.
    pub(super) fn add_hand(&mut self, world_from_hand: &Pose, look: &HandLook, edge: f64) {
        let half = edge / 2.0;
        let mut rod = |a: Vector3<f64>, b: Vector3<f64>, radius: f64, paint: Rgb| {
            let (a, b) = (world_from_hand * Point3::from(a), world_from_hand * Point3::from(b));
            self.rods.push(Rod { a, b, radius, paint, gloss: 0.05 });
        };
        let tip = half - look.reach;
        // A finger lies on the surface from its tip to a knuckle beyond the edge and then bends to
        // the palm. It is pressed flat: its axis is 0.85 of its radius above the surface.
        let mut finger = |side: f64, z: f64, radius: f64, lie: Vector3<f64>| {
            let on = lie * (side * (half + radius * 0.85));
            let across = if lie.y == 0.0 { Vector3::y() } else { Vector3::z() } * z;
            let start = on + across + Vector3::x() * (tip + radius);
            let knuckle = on * 1.12 + across + Vector3::x() * (half + 0.018);
            rod(start, knuckle, radius, look.skin);
            let root = on * 0.55 + across * 0.8 + Vector3::x() * (half + 0.055);
            rod(knuckle, root, radius * 1.15, look.skin);
        };
        let spread: &[f64] = match look.front_fingers {
            0 => &[],
            1 => &[0.0],
            2 => &[-0.011, 0.011],
            _ => &[-0.019, 0.0, 0.019],
        };
        if spread.is_empty() {
            // Fingers above and below the cube leave the front free.
            finger(-1.0, 0.006, 0.0095, Vector3::z());
            for y in [-0.002, 0.016] {
                finger(1.0, y, 0.008, Vector3::z());
            }
        } else {
            // A single fingertip in front is the thumb; two or three are fingers and thinner.
            let thumb = if spread.len() == 1 { 0.0095 } else { 0.0075 };
            for z in spread {
                finger(-1.0, z + look.height, thumb, Vector3::y());
            }
            for z in [-0.018, 0.0, 0.018] {
                finger(1.0, z + look.height, 0.008, Vector3::y());
            }
        }
        // Three rods across the palm, then the wrist and the sleeve, which hangs down a little.
        let z = look.height;
        for dz in [-0.022, 0.0, 0.022] {
            rod(
                Vector3::new(half + 0.062, -0.004, z + dz),
                Vector3::new(half + 0.11, 0.0, z + dz * 0.8),
                0.021,
                look.skin,
            );
        }
        rod(
            Vector3::new(half + 0.12, 0.0, z),
            Vector3::new(half + 0.19, 0.0, z - 0.01),
            0.029,
            look.skin,
        );
        rod(
            Vector3::new(half + 0.20, 0.0, z - 0.01),
            Vector3::new(half + 0.50, 0.02, z - 0.09),
            0.042,
            look.sleeve,
        );
    }
}

/// Returns the bounds, in plate coordinates (m), of the strip of a cube face that lies between
/// `from` and `to` along `axis`.
fn slab_bounds(plate: &Plate, axis: Axis, from: f64, to: f64) -> [f64; 4] {
    let [u0, u1, v0, v1] = plate.bounds;
    let (du, dv) = (plate.u.dot(&axis.unit()), plate.v.dot(&axis.unit()));
    // A plate coordinate that runs against the axis has the bounds with swapped signs.
    let range = |d: f64| if d > 0.0 { (from, to) } else { (-to, -from) };
    if du == 0.0 {
        let (low, high) = range(dv);
        [u0, u1, low, high]
    } else {
        let (low, high) = range(du);
        [low, high, v0, v1]
    }
}
