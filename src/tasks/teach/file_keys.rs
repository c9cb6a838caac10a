//! The keys of the file of a way, and its reader.
//!
//! - in: the text of a file; the arm, for its reach
//! - out: the [`Way`], or all faults with file, line and reason

use super::way::{MOST, Point, Way};
use crate::cell::Arm;
use crate::hw::text;
use crate::motion::JointPositions;
use crate::scenario::fault::{Faults, Source};
use crate::scenario::section::{Reader, Section as _, section};
use crate::scenario::tree::{self, Node, Value, name_of};
use crate::spatial::Pose;
use nalgebra::{Translation3, UnitQuaternion};
use std::collections::BTreeSet;
use std::path::Path;
use std::rc::Rc;

section! {
    /// File of a way, without its points.
    FileKeys {
        /// Arm whose way it is.
        arm: String = String::new();
    } with {
        /// Joints near which the arm reaches the first point.
        posture: PostureKeys,
    }
}

section! {
    /// Joints near which the arm reaches the first point.
    PostureKeys {
        /// Place on the track.
        track [mm]: f64 = 0.0, -20000.0..=20000.0;
        /// Joints 1 to 6.
        joints [deg]: Option<[f64; 6]> = None, -720.0..=720.0;
    }
}

section! {
    /// Point of a way: a pose, or a place of the joints.
    PointKeys {
        /// Name for messages.
        name: String = String::new();
        /// Place of the tool in the base of the arm.
        xyz [mm]: Option<[f64; 3]> = None, -20000.0..=20000.0;
        /// Roll, pitch and yaw of the tool in the base of the arm.
        rpy [deg]: Option<[f64; 3]> = None, -360.0..=360.0;
        /// Place on the track; that of the posture if left out.
        track [mm]: Option<f64> = None, -20000.0..=20000.0;
        /// Joints 1 to 6.
        joints [deg]: Option<[f64; 6]> = None, -720.0..=720.0;
    }
}

/// Reads the file of a way at `path`.
///
/// # Errors
/// That the file cannot be read, or its faults.
pub(super) fn load(path: &Path, arm: &Arm) -> Result<Way, Faults> {
    let text = text::read(path, text::SCENARIO).map_err(|why| {
        let mut faults = Faults::default();
        faults.add(None, why.to_string());
        faults
    })?;
    read(&path.display().to_string(), &text, arm)
}

/// Reads the text of a way, which is called `name` in faults. `arm` must reach all points.
///
/// # Errors
/// All faults of the text.
pub(super) fn read(name: &str, text: &str, arm: &Arm) -> Result<Way, Faults> {
    let source = Source { name: name.to_owned(), text: text.to_owned(), is_file: true };
    let mut reader = Reader::default();
    let document = tree::parse(&Rc::new(source), &mut reader.faults);
    if !reader.faults.0.is_empty() {
        return Err(reader.faults.sorted());
    }
    let (head, points) = split(document);
    let mut file = FileKeys::default();
    file.overlay(&head, "", &mut reader);
    if file.arm != arm.name {
        let reason = format!("`arm`: the way is for \"{}\", not for \"{}\"", file.arm, arm.name);
        reader.fault("arm", reason);
    }
    let points = point_keys(points.as_ref(), &mut reader);
    let points = places(&points, &file.posture, arm, &mut reader);
    if reader.faults.0.is_empty() {
        Ok(Way { arm: file.arm, points })
    } else {
        Err(reader.faults.sorted())
    }
}

/// Splits the list of points from the rest of a document.
fn split(document: Node) -> (Node, Option<Node>) {
    let Node { place, value } = document;
    let Value::Table(entries) = value else { return (Node { place, value }, None) };
    let (points, rest): (Vec<_>, Vec<_>) =
        entries.into_iter().partition(|entry| entry.key == "point");
    let points = points.into_iter().next().map(|entry| entry.node);
    (Node { place, value: Value::Table(rest) }, points)
}

/// Reads the keys of the points, each with its dotted name.
fn point_keys(points: Option<&Node>, reader: &mut Reader) -> Vec<(String, PointKeys)> {
    let items = match points.map(|node| &node.value) {
        Some(Value::Array(items)) => &items[..],
        _ => &[],
    };
    if let Some(node) = points {
        reader.places.insert("point".to_owned(), node.place.clone());
    }
    if items.len() < 2 || items.len() > MOST {
        let reason = format!("a way has 2 to {MOST} [[point]], not {}", items.len());
        reader.fault("point", reason);
        return Vec::new();
    }
    let mut read: Vec<(String, PointKeys)> = Vec::new();
    let mut names = BTreeSet::new();
    for (i, node) in items.iter().enumerate() {
        let path = format!("point.{}", name_of(node).unwrap_or_else(|| (i + 1).to_string()));
        reader.places.insert(path.clone(), node.place.clone());
        let mut keys = PointKeys::default();
        keys.overlay(node, &path, reader);
        if !names.insert(path.clone()) {
            reader.fault(&path, format!("`{path}`: two points have this name"));
        }
        read.push((path, keys));
    }
    read
}

/// Finds joints and pose of each point, from the joints of the point before.
fn places(
    points: &[(String, PointKeys)],
    posture: &PostureKeys,
    arm: &Arm,
    reader: &mut Reader,
) -> Vec<Point> {
    let joints = |track: f64, angles: &[f64; 6]| {
        let [a, b, c, d, e, f] = *angles;
        JointPositions([track, a, b, c, d, e, f])
    };
    let mut near = posture.joints.as_ref().map(|angles| joints(posture.track, angles));
    let mut places = Vec::new();
    for (path, keys) in points {
        let found = match (keys.xyz, keys.rpy, &keys.joints) {
            (None, None, Some(angles)) => {
                let at = joints(keys.track.unwrap_or(posture.track), angles);
                let pose = arm.model.base_from_flange(&at) * arm.flange_from_tool;
                Ok(Point { joints: at, pose })
            }
            (Some(xyz), Some([roll, pitch, yaw]), None) if keys.track.is_none() => {
                let turned = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
                let pose = Pose::from_parts(Translation3::from(xyz), turned);
                reached(&pose, near.as_ref(), arm)
            }
            _ => Err("needs either xyz_mm and rpy_deg, or joints_deg".to_owned()),
        };
        let found = found.and_then(|point| {
            let limits = arm.model.check(&point.joints);
            limits.map(|()| point).map_err(|why| format!("is out of reach: {why}"))
        });
        match found {
            Ok(point) => {
                near = Some(point.joints);
                places.push(point);
            }
            Err(why) => reader.fault(path, format!("`{path}`: {why}")),
        }
    }
    places
}

/// Returns the point at a pose, with the joints nearest to `near`.
fn reached(pose: &Pose, near: Option<&JointPositions>, arm: &Arm) -> Result<Point, String> {
    let near = near.ok_or("needs [posture] with joints_deg, or a point with joints before it")?;
    let flange = pose * arm.flange_from_tool.inverse();
    let joints =
        arm.model.inverse(&flange, near).map_err(|why| format!("is out of reach: {why}"))?;
    Ok(Point { joints, pose: *pose })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the arm "track" of the built-in cell.
    fn arm() -> Arm {
        let scenario = crate::tasks::read(Path::new("t.toml"), "task = \"idle\"\n", &[]).unwrap();
        scenario.controller.cell.arms[0].clone()
    }

    /// Returns a way of two points near the start of the arm.
    fn way(arm: &Arm) -> Way {
        let at = |by: f64| {
            let mut joints = arm.start;
            joints.0[1] += by;
            let pose = arm.model.base_from_flange(&joints) * arm.flange_from_tool;
            Point { joints, pose }
        };
        Way { arm: arm.name.clone(), points: vec![at(0.0), at(0.1)] }
    }

    #[test]
    fn written_way_is_read_as_it_was() {
        let arm = arm();
        let way = way(&arm);
        for by_joints in [false, true] {
            let read = read("w.toml", &way.text(by_joints), &arm).unwrap();
            for (read, point) in read.points.iter().zip(&way.points) {
                assert!((read.place() - point.place()).norm() < 2e-6);
                assert!(read.pose.rotation.angle_to(&point.pose.rotation) < 1e-5);
                for (a, b) in read.joints.0.iter().zip(point.joints.0) {
                    assert!((a - b).abs() < 1e-4, "{a} {b}");
                }
            }
        }
    }

    /// The longest way is written and read again. A lesson does both within 80 ms.
    #[test]
    fn longest_way_is_written_and_read() {
        let arm = arm();
        let points = way(&arm).points.into_iter().cycle().take(MOST).collect();
        let way = Way { arm: arm.name.clone(), points };
        for by_joints in [false, true] {
            let begun = std::time::Instant::now();
            let read = read("w.toml", &way.text(by_joints), &arm).unwrap();
            println!("{by_joints}: {:?}", begun.elapsed());
            assert_eq!(read.points.len(), MOST);
            assert!((way.text(by_joints).len() as u64) < text::SCENARIO);
        }
    }

    #[test]
    fn wrong_file_is_refused_with_line_and_name() {
        let arm = arm();
        let text = way(&arm).text(false);
        let changed = |from: &str, to: &str| {
            let text = text.replacen(from, to, 1);
            read("w.toml", &text, &arm).err().map(|faults| faults.to_string()).unwrap_or_default()
        };
        let xyz = text.lines().rfind(|line| line.starts_with("xyz_mm")).unwrap();
        assert_eq!(changed("", ""), "");
        for (from, to, wanted) in [
            (xyz, "xyz_mm = [9000, 0, 0]", "`point.p2`: is out of reach"),
            (xyz, "xyz_mm = [0, 0]", "w.toml:18:10: `point.p2.xyz_mm`: expected an array of 3"),
            (xyz, "xyz_cm = [0, 0, 0]", "w.toml:18:1: unknown key `xyz_cm`"),
            (xyz, "", "`point.p2`: needs either xyz_mm and rpy_deg, or joints_deg"),
            ("\"p2\"", "\"p1\"", "`point.p1`: two points have this name"),
            ("\"track\"", "\"left\"", "w.toml:4:7: `arm`: the way is for \"left\""),
            ("[posture]", "[pasture]", "unknown key `pasture`"),
            ("arm =", "arm ==", "w.toml:4:"),
        ] {
            let message = changed(from, to);
            assert!(message.contains(wanted), "no `{wanted}` in:\n{message}");
        }
        let message = read("w.toml", "arm = \"track\"\n", &arm).unwrap_err().to_string();
        assert!(message.contains("a way has 2 to 2000 [[point]], not 0"), "{message}");
    }
}
