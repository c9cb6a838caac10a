//! The keys of the lists `[[object]]`, `[[probe]]` and `[[lead]]`: rigid objects in a simulated
//! cell, balls on the tools that touch them, and persons who lead a tool by hand. Only the side of
//! the plant may read them; a task that must know an object has keys of its own.
//!
//! - in: shape, sizes, mass, contact and pose of an object; arm and way of a lead
//! - out: [`ObjectKeys`], [`ProbeKeys`] and [`LeadKeys`], checked against the cell
//!
//! | check | refused | reason |
//! |---|---|---|
//! | names | a missing name, or two equal ones | verdicts find an object by its name |
//! | table | a body that begins inside the table | the table would throw it out |
//! | surface | a loose one, or one that is too steep | a ball finds no nearest point |
//! | arm | an unknown one, two probes on one | there is no such tool |

use super::lists::Effector;
use super::section::{Reader, section, words};
use crate::hw::scene::MOST_OBJECTS;
use crate::spatial::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};

/// Beginning of the name of an object's link.
pub(crate) const LINK: &str = "object_";
/// Depth to which an object may begin in the table (m): the table carries it by sinking in.
const SINKS: f64 = 5e-4;
/// Steepest slope of a drawn contour.
const STEEPEST: f64 = 1.5;

words! {
    /// Shape of an object.
    pub ObjectKind {
        /// Box.
        Box = "box",
        /// Cylinder, with its axis along z.
        Cylinder = "cylinder",
        /// Long box, with its length along x, which two grippers can hold.
        Bar = "bar",
        /// Fixed body with a curved upper side along x.
        Surface = "surface",
    }
}

section! {
    /// Rigid object.
    pub ObjectKeys {
        /// Name for verdicts, messages and `--set object.NAME.key`.
        name: String = String::new();
        /// Shape of the object.
        shape: ObjectKind = ObjectKind::Box;
        /// Sizes along x, y, z; a cylinder has its diameter along x and y. A surface has its length
        /// along x, its width along y, and along z the height of the contour's middle.
        size [mm]: [f64; 3] = [60.0; 3], 1.0..=3000.0;
        /// Mass of the object.
        mass [kg]: f64 = 0.2, 0.001..=20.0;
        /// Coefficient of friction with pads, fingers, probes and the table.
        friction: f64 = 0.5, 0.0..=2.0;
        /// Stiffness of its contact with finger tips, probes and the table. Between pads the object
        /// is rigid: the pads yield.
        stiffness [n_mm]: f64 = 200.0, 0.1..=10000.0;
        /// Position of its centre in the world at the start; for a surface, of the middle of its
        /// base.
        xyz [mm]: [f64; 3] = [0.0; 3], -20000.0..=20000.0;
        /// Roll, pitch and yaw at the start.
        rpy [deg]: [f64; 3] = [0.0; 3], -180.0..=180.0;
        /// Whether the object is fixed to the cell; a surface always is.
        fixed: bool = false;
        /// Greatest height of a drawn contour above its middle, and depth below it.
        amplitude [mm]: f64 = 8.0, 0.0..=200.0;
        /// Typical length of a wave of a drawn contour.
        wavelength [mm]: f64 = 150.0, 10.0..=5000.0;
        /// Points of the contour: place along x, and height above the middle. Without them the seed
        /// draws the contour.
        points [mm]: Option<Vec<[f64; 2]>> = None, -3000.0..=3000.0;
    }
}

section! {
    /// Ball at the end of a thin pin on a tool, which can touch fixed objects.
    pub ProbeKeys {
        /// Name for messages and `--set probe.NAME.key`.
        name: String = String::new();
        /// Arm that has the probe.
        arm: String = String::new();
        /// Centre of the ball in the tool frame.
        xyz [mm]: [f64; 3] = [0.0, 0.0, 60.0], -500.0..=500.0;
        /// Radius of the ball.
        radius [mm]: f64 = 3.0, 0.1..=50.0;
    }
}

section! {
    /// Person who takes a tool by hand and pulls it along a way through a spring.
    pub LeadKeys {
        /// Name for messages and `--set lead.NAME.key`.
        name: String = String::new();
        /// Arm whose tool the person leads.
        arm: String = String::new();
        /// Points of the way, in axes of the world.
        points [mm]: Vec<[f64; 3]> = Vec::new(), -20000.0..=20000.0;
        /// Whether the points count from the place of the tool when the person takes it; otherwise
        /// from the origin of the world.
        relative: bool = true;
        /// Mean speed of the person's hand between two points.
        speed [mm_s]: f64 = 50.0, 1.0..=500.0;
        /// Rest at each point.
        rest [s]: f64 = 0.5, 0.0..=600.0;
        /// Stiffness of the person's hold.
        stiffness [n_mm]: f64 = 0.5, 0.01..=10.0;
        /// Damping of the person's hold.
        damping [ns_m]: f64 = 20.0, 0.0..=500.0;
        /// Greatest force of the person.
        force [n]: f64 = 40.0, 1.0..=200.0;
        /// Time in the plant at which the person takes the tool.
        at [s]: f64 = 1.0, 0.0..=86400.0;
    }
}

/// Objects, probes and leads of a scenario, each with its dotted name.
#[derive(Debug, Clone, Default)]
pub(super) struct ObjectLists {
    pub(super) objects: Vec<(String, ObjectKeys)>,
    pub(super) probes: Vec<(String, ProbeKeys)>,
    pub(super) leads: Vec<(String, LeadKeys)>,
}

impl ObjectKeys {
    /// Returns the pose of the object at the start.
    #[must_use]
    pub fn pose(&self) -> Pose {
        let [roll, pitch, yaw] = self.rpy;
        let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        Pose::from_parts(Translation3::from(self.xyz), rotation)
    }

    /// Returns whether the object never moves.
    #[must_use]
    pub fn is_fixed(&self) -> bool {
        self.fixed || self.shape == ObjectKind::Surface
    }

    /// Returns the name of the object's link in URDF and of its frame in recordings. The names of
    /// arms, cameras and objects are three lists of their own.
    #[must_use]
    pub fn link(&self) -> String {
        format!("{LINK}{}", self.name)
    }

    /// Returns the height of the object's lowest point at the start (m).
    fn lowest(&self) -> f64 {
        let half = Vector3::from(self.size) * 0.5;
        let pose = self.pose();
        // Row of the rotation that gives the world's z.
        let up = pose.rotation.inverse() * Vector3::z();
        let below = match self.shape {
            ObjectKind::Cylinder => half.x * up.x.hypot(up.y) + half.z * up.z.abs(),
            _ => up.map(f64::abs).dot(&half),
        };
        let centre = if self.shape == ObjectKind::Surface { up.z * half.z } else { 0.0 };
        pose.translation.z + centre - below
    }
}

/// Checks objects, probes and leads against each other, the table's height `table` (m), and the
/// effectors. With `hardware` none of them may exist.
pub(super) fn check(
    lists: &ObjectLists,
    effectors: &[Effector],
    table: f64,
    hardware: bool,
    reader: &mut Reader,
) {
    for (i, (path, keys)) in lists.objects.iter().enumerate() {
        if i == MOST_OBJECTS {
            let reason = format!("there are more than {MOST_OBJECTS} objects");
            reader.fault(path, reason);
        }
        for (key, reason) in object_faults(keys, path, table, reader) {
            reader.fault(&format!("{path}.{key}"), format!("`{path}.{key}`: {reason}"));
        }
    }
    let arms = |name: &str| effectors.iter().any(|effector| effector.name == name);
    for (i, (path, keys)) in lists.probes.iter().enumerate() {
        check_arm(&keys.arm, path, arms(&keys.arm), reader);
        if lists.probes[..i].iter().any(|(_, other)| other.arm == keys.arm) {
            let reason = format!("`{path}.arm`: \"{}\" has a probe already", keys.arm);
            reader.fault(&format!("{path}.arm"), reason);
        }
    }
    for (path, keys) in &lists.leads {
        check_arm(&keys.arm, path, arms(&keys.arm), reader);
        if keys.points.is_empty() {
            let reason = format!("`{path}.points_mm`: a lead needs at least one point");
            reader.fault(&format!("{path}.points_mm"), reason);
        }
    }
    if hardware {
        let paths = (lists.objects.iter().map(|(path, _)| path))
            .chain(lists.probes.iter().map(|(path, _)| path))
            .chain(lists.leads.iter().map(|(path, _)| path));
        for path in paths {
            reader.fault(path, format!("`{path}`: only the simulated plant has it"));
        }
    }
}

/// Checks that an element of a list names an arm that exists.
fn check_arm(arm: &str, path: &str, exists: bool, reader: &mut Reader) {
    if !exists {
        let reason = if arm.is_empty() {
            format!("`{path}.arm` is missing")
        } else {
            format!("`{path}.arm`: there is no effector \"{arm}\"")
        };
        reader.fault(&format!("{path}.arm"), reason);
    }
}

/// Returns the wrong keys of an object, with the reasons.
fn object_faults(
    keys: &ObjectKeys,
    path: &str,
    table: f64,
    reader: &Reader,
) -> Vec<(&'static str, String)> {
    let mut wrong = Vec::new();
    let [x, y, z] = keys.size;
    let millimetres = |metres: f64| (metres * 1e5).round() / 100.0;
    match keys.shape {
        ObjectKind::Bar if x < 2.0 * y.max(z) => {
            wrong.push(("size_mm", "a bar is at least twice as long, along x, as wide".to_owned()));
        }
        ObjectKind::Cylinder if x != y => {
            wrong.push(("size_mm", "the diameter of a cylinder along x and y differs".to_owned()));
        }
        ObjectKind::Box | ObjectKind::Bar | ObjectKind::Cylinder => {}
        ObjectKind::Surface => {
            if !keys.fixed && reader.is_given(&format!("{path}.fixed")) {
                wrong.push(("fixed", "a surface is always fixed".to_owned()));
            }
            wrong.extend(contour_faults(keys));
        }
    }
    let below = table - keys.lowest();
    if below > SINKS {
        let by = millimetres(below);
        wrong.push(("xyz_mm", format!("the object begins {by} mm deep in the table")));
    }
    wrong
}

/// Returns the wrong keys of a contour, with the reasons.
fn contour_faults(keys: &ObjectKeys) -> Vec<(&'static str, String)> {
    let mut wrong = Vec::new();
    let [x, _, z] = keys.size;
    if let Some(points) = &keys.points {
        let rise = points.windows(2).all(|pair| pair[0][0] < pair[1][0]);
        if points.len() < 2 || !rise {
            wrong.push(("points_mm", "needs two points or more, with rising places".to_owned()));
        }
        if points.iter().any(|[place, height]| place.abs() > 0.5 * x || -height >= z) {
            let reason = "a point is beyond the ends of the surface, or below its base";
            wrong.push(("points_mm", reason.to_owned()));
        }
        return wrong;
    }
    if keys.amplitude >= z {
        wrong.push(("amplitude_mm", "the contour would be below the base".to_owned()));
    }
    // The shortest wave that can be drawn has 0.75 of the wavelength.
    let slope = keys.amplitude * std::f64::consts::TAU / (0.75 * keys.wavelength);
    if slope > STEEPEST {
        let reason = format!(
            "with this wavelength the contour may be as steep as {slope:.1}, above {STEEPEST}"
        );
        wrong.push(("amplitude_mm", reason));
    }
    wrong
}

#[cfg(test)]
mod tests {
    use crate::tasks::read;
    use std::path::Path;

    /// Returns the faults of a scenario with this text; empty if there are none.
    fn faults(text: &str) -> String {
        match read(Path::new("t.toml"), text, &[]) {
            Ok(_) => String::new(),
            Err(faults) => faults.to_string(),
        }
    }

    /// Returns an object of this shape that lies on the table at 0.7 m, with more keys.
    fn object(shape: &str, more: &str) -> String {
        let size = "size_mm = [200, 57, 57]\nxyz_mm = [900, 1100, 1500]\n";
        format!("[[object]]\nname = \"a\"\nshape = \"{shape}\"\n{size}{more}")
    }

    #[test]
    fn objects_are_read_in_si() {
        let points = "points_mm = [[-50, 0], [50, 8]]\n";
        let lead = "[[lead]]\narm = \"postument\"\npoints_mm = [[0, 0, 50]]\n";
        let text = format!("{}[[probe]]\narm = \"track\"\n{lead}", object("surface", points));
        assert_eq!(faults(&text), "");
        let plant = read(Path::new("t.toml"), &text, &[]).unwrap().plant;
        let object = &plant.objects[0];
        assert_eq!(object.name, "a");
        assert!((object.stiffness - 2e5).abs() < 1e-6);
        assert!((object.points.as_ref().unwrap()[1][1] - 8e-3).abs() < 1e-12);
        assert!((plant.probes[0].radius - 3e-3).abs() < 1e-12);
        assert_eq!(plant.leads[0].points, vec![[0.0, 0.0, 0.05]]);
    }

    #[test]
    fn wrong_object_is_named_with_line_and_column() {
        for (text, wanted) in [
            ("[[object]]\nshape = \"box\"\n".to_owned(), "t.toml:1:"),
            (object("ball", ""), "t.toml:3:9: `object.a.shape`: \"ball\" is not a possible value"),
            (object("box", "mass_kg = 0\n"), "t.toml:6:11: `object.a.mass_kg`: 0 is outside"),
            (object("box", "mas_kg = 1\n"), "t.toml:6:1: unknown key `mas_kg`"),
            (
                object("bar", "").replace("200, 57", "100, 57"),
                "t.toml:4:11: `object.a.size_mm`: a bar is at least twice as long",
            ),
            (object("cylinder", ""), "`object.a.size_mm`: the diameter of a cylinder"),
            (object("surface", "fixed = false\n"), "t.toml:6:9: `object.a.fixed`: a surface is"),
            (object("surface", "points_mm = [[0, 0]]\n"), "`object.a.points_mm`: needs two points"),
            (object("surface", "amplitude_mm = 50\n"), "t.toml:6:16: `object.a.amplitude_mm`"),
            (
                object("box", "").replace("1500]", "-400]"),
                "t.toml:5:10: `object.a.xyz_mm`: the object begins",
            ),
            (object("box", "") + &object("box", ""), "[[object]] has two elements named \"a\""),
            ("[[probe]]\narm = \"left\"\n".to_owned(), "there is no effector \"left\""),
            ("[[lead]]\narm = \"track\"\n".to_owned(), "a lead needs at least one point"),
            ("[[objekt]]\nname = \"a\"\n".to_owned(), "did you mean [[object]]?"),
        ] {
            let message = faults(&text);
            assert!(message.contains(wanted), "no `{wanted}` in:\n{message}");
        }
        assert_eq!(faults(&object("box", "")), "");
        let hardware = "pace = \"real-time\"\n[bridge]\nkind = \"serial\"\n";
        let message = faults(&format!("{hardware}{}", object("box", "")));
        assert!(message.contains("`object.a`: only the simulated plant has it"), "{message}");
    }
}
