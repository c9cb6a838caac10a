//! Model of the cell as links and joints, for URDF and for transforms. It uses the dimensions of
//! the kinematics.
//!
//! - in: a [`Cell`] (arms with their lengths, limits, tools, sensors, cameras), joint positions,
//!   jaw openings
//! - out: a [`Model`]; its joints give [`Model::moving`] and [`Model::fixed`] transforms, and `xml`
//!   writes it as URDF; masses, efforts and speeds come from `physics`
//! - source: the axes of [`crate::kinematics`]. If all variables are zero, the lower arm points
//!   along the base's x, and the upper arm hangs down with the wrist below it
//!
//! Frames: `world`, per arm `NAME_base`, `NAME_link0` (the carriage, on a track), `NAME_link1..6`,
//! `NAME_flange`, `NAME_sensor`, `NAME_tool`, `NAME_finger_left/right`; per camera `NAME_optical`;
//! `cube`.

use super::physics::{Inertial, Strength, divided, inertials, strength_of_finger, strengths};
use super::solid::{Shape, Solid};
use crate::cell::{Arm, Cell, CubeSpec, Mount};
use crate::motion::{AXES, JointPositions};
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::{Point3, Translation3, Unit, UnitQuaternion, Vector3};

/// Bodies and joints of a cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Name of the model.
    pub name: String,
    /// Links, the root first.
    pub links: Vec<Link>,
    /// Joints, parents before children.
    pub joints: Vec<Joint>,
}

/// Rigid body with a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    /// Name of the link and of its frame.
    pub name: String,
    /// Solids of the link; none for a frame without a body.
    pub solids: Vec<Solid>,
    /// Mass and inertia; `None` for a link that no joint moves by itself.
    pub inertial: Option<Inertial>,
}

/// Joint between two links.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Name.
    pub name: String,
    /// Frame to which the joint is attached.
    pub parent: String,
    /// Frame that the joint moves.
    pub child: String,
    /// `parent_from_child` if the variable is zero.
    pub origin: Pose,
    /// Kind of motion.
    pub kind: JointKind,
}

/// Motion that a joint allows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JointKind {
    /// No motion.
    Fixed,
    /// Any motion; the joint of the cube.
    Floating,
    /// Rotation about an axis of the child's frame (rad).
    Turns(Drive),
    /// Translation along an axis of the child's frame (m).
    Slides(Drive),
}

/// Axis of a moving joint, and the variable that moves it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// Axis of the motion: a unit vector in the child's frame.
    pub axis: [f64; 3],
    /// Smallest and largest value of the variable (rad or m).
    pub limits: (f64, f64),
    /// Greatest effort and speed of the joint.
    pub strength: Strength,
    /// Variable that moves the joint: index of the arm in the cell, and variable of this arm.
    pub by: (usize, Variable),
}

/// Variable of an arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variable {
    /// Entry of [`JointPositions`] with this index (m or rad).
    Joint(usize),
    /// Half of the opening of the jaws: the way of one finger (m).
    HalfOpening,
}

// Colours of the solids: red, green, blue, each 0 to 1.
const PAINT: [f64; 3] = [0.93, 0.55, 0.14];
const STEEL: [f64; 3] = [0.62, 0.65, 0.68];
const DARK: [f64; 3] = [0.18, 0.19, 0.21];
const TABLE: [f64; 3] = [0.80, 0.77, 0.70];
/// Colours of the stickers on the faces U R F D L B: white, red, green, yellow, orange, blue.
const STICKERS: [[f64; 3]; 6] = [
    [0.95, 0.95, 0.95],
    [0.80, 0.08, 0.10],
    [0.05, 0.60, 0.25],
    [0.98, 0.82, 0.05],
    [0.98, 0.45, 0.05],
    [0.05, 0.25, 0.70],
];

impl Model {
    /// Makes the model of the whole cell, with the cube if `cube` is true. If `arm` is the index of
    /// an arm, makes the model of this arm alone on its own base, without a cube.
    #[must_use]
    pub fn of(cell: &Cell, arm: Option<usize>, cube: bool) -> Self {
        // The first link is the root: the world, or the base of the only arm.
        let mut model = Self { name: "rubik_robot".to_owned(), links: vec![], joints: vec![] };
        if let Some((index, arm)) = arm.and_then(|i| Some((i, cell.arms.get(i)?))) {
            model.name.clone_from(&arm.name);
            model.arm(index, arm);
        } else {
            model.link("world", vec![]);
            model.table(cell);
            for (index, arm) in cell.arms.iter().enumerate() {
                model.arm(index, arm);
                let base = format!("{}_base", arm.name);
                model.fix("world", &base, arm.world_from_base);
            }
        }
        for camera in &cell.cameras {
            let name = format!("{}_optical", camera.name);
            // The model of one arm has the cameras on its flange only.
            let (parent, place) = match camera.mount {
                Mount::World { world_from_camera } if arm.is_none() => {
                    ("world".to_owned(), world_from_camera)
                }
                Mount::Flange { arm: on, flange_from_camera }
                    if arm.is_none_or(|only| only == on) && on < cell.arms.len() =>
                {
                    (format!("{}_flange", cell.arms[on].name), flange_from_camera)
                }
                Mount::World { .. } | Mount::Flange { .. } => continue,
            };
            // The origin of the frame is in the lens and z points forward, so the body is behind.
            let body = solid([0.0, 0.0, -0.015], Shape::Box([0.03, 0.03, 0.03]), DARK);
            let lens = solid([0.0, 0.0, 0.004], Shape::Cylinder(0.009, 0.008), STEEL);
            model.link(&name, vec![body, lens]);
            model.fix(&parent, &name, place);
        }
        for (index, own) in cell.arms.iter().enumerate() {
            model.divide_last_body(index, own);
        }
        if cube && arm.is_none() {
            model.cube(&cell.cube);
        }
        model
    }

    /// Returns parent, child and `parent_from_child` of each fixed joint.
    pub fn fixed(&self) -> impl Iterator<Item = (&str, &str, Pose)> {
        let fixed = self.joints.iter().filter(|j| j.kind == JointKind::Fixed);
        fixed.map(|j| (j.parent.as_str(), j.child.as_str(), j.origin))
    }

    /// Returns parent, child and `parent_from_child` of each joint that a drive moves. `joints` and
    /// `openings` (of the jaws, m) have an entry for each arm of the cell.
    pub fn moving<'a>(
        &'a self,
        joints: &'a [JointPositions],
        openings: &'a [f64],
    ) -> impl Iterator<Item = (&'a str, &'a str, Pose)> {
        self.joints.iter().filter_map(move |joint| {
            let pose = joint.origin * joint.kind.displacement(joints, openings)?;
            Some((joint.parent.as_str(), joint.child.as_str(), pose))
        })
    }

    /// Adds a link with this name and these solids.
    pub(super) fn link(&mut self, name: &str, solids: Vec<Solid>) {
        self.links.push(Link { name: name.to_owned(), solids, inertial: None });
    }

    /// Gives a link a mass and an inertia; does nothing if there is no link of this name.
    pub(super) fn weigh(&mut self, name: &str, inertial: Inertial) {
        if let Some(link) = self.links.iter_mut().find(|link| link.name == name) {
            link.inertial = Some(inertial);
        }
    }

    /// Divides the mass and inertia of an arm's last link among the links that it carries: flange,
    /// sensor, gripper and camera, with the jaws half open. Does nothing if the model does not have
    /// this arm.
    fn divide_last_body(&mut self, index: usize, arm: &Arm) {
        let last = format!("{}_link{}", arm.name, AXES - 1);
        let Some(body) = self.links.iter().find(|link| link.name == last) else { return };
        let Some(body) = body.inertial else { return };
        let (low, high) = arm.gripper.opening;
        let openings = vec![f64::midpoint(low, high); index + 1];
        // Parents are before children, so one pass finds all links that the last link carries.
        let mut places = vec![(last.clone(), Pose::identity())];
        for joint in &self.joints {
            let parent = places.iter().find(|(name, _)| *name == joint.parent);
            if let Some((_, place)) = parent {
                places.push((joint.child.clone(), place * joint.place(&[], &openings)));
            }
        }
        let solids = |name: &str| {
            let link = self.links.iter().find(|link| link.name == name);
            link.map_or(&[][..], |link| link.solids.as_slice())
        };
        // A frame without a solid has no mass.
        places.retain(|(name, _)| *name != last && !solids(name).is_empty());
        let parts: Vec<_> = places.iter().map(|(name, at)| (*at, solids(name))).collect();
        let (rest, bodies) = divided(&body, &parts);
        self.weigh(&last, rest);
        for ((name, _), body) in places.iter().zip(bodies) {
            self.weigh(name, body);
        }
    }

    /// Adds a fixed joint; `origin` is `parent_from_child`.
    fn fix(&mut self, parent: &str, child: &str, origin: Pose) {
        self.joint(parent, child, origin, JointKind::Fixed);
    }

    /// Adds a joint, named after its child; `origin` is `parent_from_child` if the joint's variable
    /// is zero.
    pub(super) fn joint(&mut self, parent: &str, child: &str, origin: Pose, kind: JointKind) {
        self.joints.push(Joint {
            name: format!("{child}_joint"),
            parent: parent.to_owned(),
            child: child.to_owned(),
            origin,
            kind,
        });
    }

    /// Adds the cell's table as a plate, 3 cm thick.
    fn table(&mut self, cell: &Cell) {
        // The scenario gives the height of the table only. The plate is drawn beside the place
        // where the hand holds the cube.
        let centre = cell.hand.world_from_cube.translation.vector;
        let top = 0.03;
        let place = [centre.x - 0.15, centre.y + 0.6, cell.table_height - 0.5 * top];
        self.link("table", vec![solid([0.0; 3], Shape::Box([0.6, 0.6, top]), TABLE)]);
        self.fix("world", "table", Pose::translation(place[0], place[1], place[2]));
    }

    /// Adds a solved cube. Its stickers do not follow the turns: colours in URDF are fixed.
    fn cube(&mut self, cube: &CubeSpec) {
        let edge = cube.edge;
        let mut solids = vec![solid([0.0; 3], Shape::Box([edge; 3]), DARK)];
        // Normals of U R F D L B in the cube's frame: R +x, B +y, U +z.
        let normals: [[f64; 3]; 6] = [
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.0, 0.0, -1.0],
            [-1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
        ];
        for (normal, colour) in normals.iter().zip(STICKERS) {
            // A sticker is a thin plate across its normal, smaller than the face, so that the dark
            // body is visible between two of them.
            let plate = normal.map(|n: f64| if n == 0.0 { 0.92 * edge } else { 0.0006 });
            solids.push(solid(normal.map(|n| 0.5 * edge * n), Shape::Box(plate), colour));
        }
        self.link("cube", solids);
        self.weigh("cube", Inertial::of_box(cube.mass, [edge; 3]));
        self.joint("world", "cube", Pose::identity(), JointKind::Floating);
    }

    /// Adds the arm with this index in the cell: from its base to its flange, then its gripper. The
    /// bodies are simple boxes and cylinders; only lengths, axes and limits are those of the arm.
    fn arm(&mut self, index: usize, arm: &Arm) {
        let [a2, a3, d5] = arm.model.links;
        let h = arm.model.shoulder_height;
        let limits = &arm.model.joint_limits;
        let bodies = inertials(&arm.model);
        let strengths = strengths(&arm.model);
        let name = |part: &str| format!("{}_{part}", arm.name);
        let turns = |axis: [f64; 3], variable: usize| {
            let by = (index, Variable::Joint(variable));
            let strength = strengths[variable];
            JointKind::Turns(Drive { axis, limits: limits[variable], strength, by })
        };
        let up = |length: f64, z: f64| solid([0.0, 0.0, z], Shape::Cylinder(0.07, length), PAINT);
        let along_x = |length: f64, x: f64, size: f64| {
            solid([x, 0.0, 0.0], Shape::Box([length, size, size]), PAINT)
        };
        // The hub of an axis about y: a cylinder is about z, so it is turned by 90 degrees about x.
        let hub = |radius: f64, length: f64| Solid {
            link_from_solid: Pose::rotation(Vector3::new(std::f64::consts::FRAC_PI_2, 0.0, 0.0)),
            shape: Shape::Cylinder(radius, length),
            colour: STEEL,
        };

        let foot = 0.25;
        let below = self.base(index, arm, foot, strengths[0]);
        // Link 1: the column, from the foot up to the shoulder. It turns about z.
        let column = h - foot;
        self.link(&name("link1"), vec![up(column, foot + 0.5 * column)]);
        self.joint(&below, &name("link1"), Pose::identity(), turns([0.0, 0.0, 1.0], 1));
        // Links 2 to 4: lower arm, upper arm, wrist. They turn about parallel axes y.
        self.link(&name("link2"), vec![hub(0.085, 0.24), along_x(a2, 0.5 * a2, 0.10)]);
        let shoulder = Pose::translation(0.0, 0.0, h);
        self.joint(&name("link1"), &name("link2"), shoulder, turns([0.0, 1.0, 0.0], 2));
        let upper = solid([0.0, 0.0, -0.5 * a3], Shape::Box([0.09, 0.09, a3]), PAINT);
        self.link(&name("link3"), vec![hub(0.07, 0.18), upper]);
        let elbow = Pose::translation(a2, 0.0, 0.0);
        self.joint(&name("link2"), &name("link3"), elbow, turns([0.0, 1.0, 0.0], 3));
        self.link(&name("link4"), vec![hub(0.05, 0.13)]);
        let wrist = Pose::translation(0.0, 0.0, -a3);
        self.joint(&name("link3"), &name("link4"), wrist, turns([0.0, 1.0, 0.0], 4));
        // Links 5 and 6: the hand hangs down from the wrist, so its axis is -z. Link 6 is a frame
        // only: the body at its end is the flange.
        let hand = solid([0.0, 0.0, -0.5 * d5], Shape::Cylinder(0.045, d5), PAINT);
        self.link(&name("link5"), vec![hand]);
        self.joint(&name("link4"), &name("link5"), Pose::identity(), turns([0.0, 0.0, -1.0], 5));
        self.link(&name("link6"), vec![]);
        let roll = Pose::translation(0.0, 0.0, -d5);
        self.joint(&name("link5"), &name("link6"), roll, turns([0.0, 1.0, 0.0], 6));

        // If all variables are zero, the flange's x points along the base's x, its y down and its z
        // along the base's y.
        let flange = pose_from_axes(Vector3::x(), -Vector3::z(), Vector3::y(), Point3::origin());
        let plate = solid([0.0, 0.0, 0.01], Shape::Cylinder(0.04, 0.02), STEEL);
        self.link(&name("flange"), vec![plate]);
        self.fix(&name("link6"), &name("flange"), flange);
        for (axis, body) in bodies.into_iter().enumerate() {
            self.weigh(&name(&format!("link{axis}")), body);
        }
        self.gripper(index, arm);
    }

    /// Adds the base of an arm, which is its root, and returns the name of the link that carries
    /// the column. On a track the base is the rail, which reaches 0.2 m beyond the travel at both
    /// ends, and link 0 is the carriage; `strength` is that of its drive, `foot` the height of its
    /// stand (m).
    fn base(&mut self, index: usize, arm: &Arm, foot: f64, strength: Strength) -> String {
        let name = |part: &str| format!("{}_{part}", arm.name);
        let (below, limits) = (name("base"), arm.model.joint_limits[0]);
        let stand = solid([0.0, 0.0, 0.5 * foot], Shape::Box([0.34, 0.34, foot]), DARK);
        if !arm.model.has_track {
            self.link(&below, vec![stand]);
            return below;
        }
        let (low, high) = limits;
        let rail = Shape::Box([0.30, high - low + 0.4, 0.06]);
        self.link(&below, vec![solid([0.0, 0.5 * (low + high), 0.03], rail, STEEL)]);
        let carriage = name("link0");
        self.link(&carriage, vec![stand]);
        let by = (index, Variable::Joint(0));
        let slides = Drive { axis: [0.0, 1.0, 0.0], limits, strength, by };
        self.joint(&below, &carriage, Pose::identity(), JointKind::Slides(slides));
        carriage
    }

    /// Adds the force sensor, the palm with its neck, and the two fingers.
    fn gripper(&mut self, index: usize, arm: &Arm) {
        let name = |part: &str| format!("{}_{part}", arm.name);
        let sensor = arm.sensor.flange_from_sensor;
        let disc = solid([0.0; 3], Shape::Cylinder(0.035, 0.035), STEEL);
        self.link(&name("sensor"), vec![disc]);
        self.fix(&name("flange"), &name("sensor"), sensor);
        let g = &arm.gripper;
        // The frame of the tool is between the pads with z forward, so the palm is at negative z.
        let palm_at = -(g.palm + 0.01);
        let reach = arm.flange_from_tool.translation.vector.z;
        let plate = Shape::Box([2.0 * g.palm_half_width, 2.0 * g.palm_half_width, 0.02]);
        // The neck fills the gap from the flange to the palm. A box must have a positive length.
        let neck = (reach - g.palm - 0.02).max(0.02);
        let tool = vec![
            solid([0.0, 0.0, palm_at], plate, DARK),
            solid([0.0, 0.0, palm_at - 0.5 * neck], Shape::Box([0.05, 0.05, neck]), DARK),
        ];
        self.link(&name("tool"), tool);
        self.fix(&name("flange"), &name("tool"), arm.flange_from_tool);
        // A finger reaches from the palm to its tip. Its inner side is at y = 0, so that the pads
        // meet at an opening of 0.
        let length = g.palm + g.finger_tip;
        let limits = (0.5 * g.opening.0, 0.5 * g.opening.1);
        let strength = strength_of_finger(g);
        for (side, sign) in [("left", 1.0), ("right", -1.0)] {
            let child = name(&format!("finger_{side}"));
            let centre = [0.0, sign * 0.5 * g.finger_thickness, 0.5 * (g.finger_tip - g.palm)];
            let shape = Shape::Box([g.finger_width, g.finger_thickness, length]);
            self.link(&child, vec![solid(centre, shape, STEEL)]);
            let by = (index, Variable::HalfOpening);
            let slides = JointKind::Slides(Drive { axis: [0.0, sign, 0.0], limits, strength, by });
            self.joint(&name("tool"), &child, Pose::identity(), slides);
        }
    }
}

impl Joint {
    /// Returns `parent_from_child` of the joint for the given positions of all arms. `joints` and
    /// `openings` (of the jaws, m) have an entry for each arm of the cell.
    #[must_use]
    pub fn place(&self, joints: &[JointPositions], openings: &[f64]) -> Pose {
        self.kind.displacement(joints, openings).map_or(self.origin, |moved| self.origin * moved)
    }
}

impl JointKind {
    /// Returns the axis, the limits and the variable of the joint; `None` if no drive moves it.
    #[must_use]
    pub fn drive(&self) -> Option<&Drive> {
        match self {
            Self::Turns(drive) | Self::Slides(drive) => Some(drive),
            Self::Fixed | Self::Floating => None,
        }
    }

    /// Returns the displacement of the child's frame from its place at the variable's zero, for
    /// positions as in [`Joint::place`]; `None` if no drive moves the joint or its arm has no
    /// entry.
    fn displacement(&self, joints: &[JointPositions], openings: &[f64]) -> Option<Pose> {
        let drive = self.drive()?;
        let (arm, variable) = drive.by;
        let value = match variable {
            Variable::Joint(index) => joints.get(arm)?.0[index],
            Variable::HalfOpening => 0.5 * openings.get(arm)?,
        };
        let axis = Vector3::from(drive.axis);
        Some(match self {
            Self::Slides(_) => {
                Pose::from_parts(Translation3::from(value * axis), UnitQuaternion::identity())
            }
            _ => Pose::from_parts(
                Translation3::identity(),
                UnitQuaternion::from_axis_angle(&Unit::new_unchecked(axis), value),
            ),
        })
    }
}

/// Makes a solid at `centre` (m) that is not rotated against its link.
fn solid(centre: [f64; 3], shape: Shape, colour: [f64; 3]) -> Solid {
    Solid { link_from_solid: Pose::translation(centre[0], centre[1], centre[2]), shape, colour }
}

#[cfg(test)]
mod tests {
    use super::*;

    use std::collections::{BTreeMap, BTreeSet};

    /// Returns the built-in cell.
    fn cell() -> Cell {
        crate::tasks::read(std::path::Path::new("t.toml"), "", &[]).unwrap().controller.cell
    }

    #[test]
    fn link_frames_agree_with_the_kinematics() {
        let cell = cell();
        let model = Model::of(&cell, None, true);
        let joints: Vec<_> = cell.arms.iter().map(|arm| arm.start).collect();
        let openings = [0.06, 0.08];

        let mut placed = BTreeMap::from([("world".to_owned(), Pose::identity())]);
        let all = model.fixed().chain(model.moving(&joints, &openings));
        let mut waiting: Vec<_> = all.collect();
        while !waiting.is_empty() {
            let before = waiting.len();
            waiting.retain(|(parent, child, pose)| {
                let Some(world_from_parent) = placed.get(*parent) else { return true };
                placed.insert((*child).to_owned(), world_from_parent * pose);
                false
            });
            assert!(waiting.len() < before, "{waiting:?}");
        }

        for (arm, q) in cell.arms.iter().zip(&joints) {
            let flange = arm.world_from_base * arm.model.base_from_flange(q);
            let tool = placed[&format!("{}_tool", arm.name)];
            let apart = (flange * arm.flange_from_tool).inverse() * tool;
            assert!(apart.translation.vector.norm() < 1e-12 && apart.rotation.angle() < 1e-7);
        }
        let fingers = [&placed["track_finger_left"], &placed["track_finger_right"]];
        let gap = (fingers[0].translation.vector - fingers[1].translation.vector).norm();
        assert!((gap - 0.06).abs() < 1e-12);
    }

    #[test]
    fn links_and_joints_form_a_tree() {
        let cell = cell();
        for (arm, cube) in [(None, true), (None, false), (Some(0), false), (Some(1), true)] {
            let model = Model::of(&cell, arm, cube);

            let known = |name: &str| model.links.iter().any(|l| l.name == name);
            assert!(model.joints.iter().all(|j| known(&j.parent) && known(&j.child)));
            assert_eq!(model.joints.len() + 1, model.links.len(), "{arm:?}");
            // The joints lead from the root to every link.
            let mut reached = BTreeSet::from([model.links[0].name.as_str()]);
            for _ in &model.joints {
                let from_there =
                    model.joints.iter().filter(|j| reached.contains(j.parent.as_str()));
                let children: Vec<&str> = from_there.map(|j| j.child.as_str()).collect();
                reached.extend(children);
            }
            assert_eq!(reached.len(), model.links.len(), "{arm:?}");
        }
    }
}
