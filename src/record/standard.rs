//! Standard messages of ROS 2, encoded from the types of this program.
//!
//! - in: poses, wrenches, joint values, pictures, texts, and their stamps (ns)
//! - out: fields in a [`Writer`], in the order of [`super::schema`]

use super::cdr::{self, Malformed, Reader, Writer};
use crate::cell::Intrinsics;
use crate::operator::Class;
use crate::spatial::{Pose, Wrench, is_rigid};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Writes a `std_msgs/String`.
pub(crate) fn text(to: &mut Writer, text: &str) {
    to.string(text);
}

/// Writes a `sensor_msgs/JointState` with positions (rad or m), without velocities and efforts.
pub(crate) fn joint_state(to: &mut Writer, stamp: u64, names: &[String], positions: &[f64]) {
    to.header(stamp, "");
    to.string_sequence(names);
    to.f64_sequence(positions);
    to.f64_sequence(&[]);
    to.f64_sequence(&[]);
}

/// Writes a `tf2_msgs/TFMessage`. Each transform has the frames parent and child, and the pose
/// `parent_from_child` (m).
pub(crate) fn transforms<'a>(
    to: &mut Writer,
    stamp: u64,
    transforms: impl ExactSizeIterator<Item = (&'a str, &'a str, Pose)>,
) {
    to.u32(transforms.len() as u32);
    for (parent, child, pose) in transforms {
        to.header(stamp, parent);
        to.string(child);
        vector(to, &pose.translation.vector);
        to.f64s(pose.rotation.coords.as_slice());
    }
}

/// Reads the pose of each transform of a `tf2_msgs/TFMessage` whose child begins with `prefix`, and
/// the rest of the child's name.
///
/// # Errors
/// [`Malformed`].
pub(crate) fn read_transforms(
    from: &mut Reader<'_>,
    prefix: &str,
) -> Result<Vec<(String, Pose)>, Malformed> {
    let mut found = Vec::new();
    for _ in 0..from.u32()? {
        from.header()?;
        let child = from.string()?.strip_prefix(prefix).map(str::to_owned);
        let place: [f64; 3] = from.f64s()?;
        let [x, y, z, w] = from.f64s()?;
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
        let pose = Pose::from_parts(place.into(), rotation);
        found.extend(child.filter(|_| is_rigid(&pose)).map(|child| (child, pose)));
    }
    Ok(found)
}

/// Replaces the stamps of all transforms of an encoded `tf2_msgs/TFMessage`.
///
/// # Errors
/// [`Malformed`] if the bytes are no such message.
pub(crate) fn restamp_transforms(message: &mut [u8], stamp: u64) -> Result<(), Malformed> {
    let mut stamps = Vec::new();
    let mut from = Reader::new(message)?;
    for _ in 0..from.u32()? {
        stamps.push(from.place_of_time());
        from.header()?;
        from.string()?;
        from.f64s::<7>()?;
    }
    stamps.into_iter().try_for_each(|at| cdr::restamp(message, at, stamp))
}

/// Writes a `geometry_msgs/WrenchStamped` in the axes of `frame` (N, Nm).
pub(crate) fn wrench(to: &mut Writer, stamp: u64, frame: &str, wrench: &Wrench) {
    to.header(stamp, frame);
    vector(to, &wrench.force);
    vector(to, &wrench.torque);
}

/// Writes a `geometry_msgs/PoseStamped` relative to `frame` (m).
pub(crate) fn pose(to: &mut Writer, stamp: u64, frame: &str, pose: &Pose) {
    to.header(stamp, frame);
    vector(to, &pose.translation.vector);
    // nalgebra stores a quaternion as x y z w, the order of the message.
    to.f64s(pose.rotation.coords.as_slice());
}

/// Writes a `sensor_msgs/CompressedImage` of a JPEG picture; `frame` is that of the camera.
pub(crate) fn picture(to: &mut Writer, stamp: u64, frame: &str, jpeg: &[u8]) {
    to.header(stamp, frame);
    to.string("jpeg");
    to.u8_sequence(jpeg);
}

/// Writes a `sensor_msgs/CameraInfo`: a pinhole camera with two radial coefficients.
pub(crate) fn camera_info(to: &mut Writer, stamp: u64, frame: &str, camera: &Intrinsics) {
    let ((fx, fy), (cx, cy)) = (camera.focal, camera.centre);
    to.header(stamp, frame);
    to.u32(camera.height);
    to.u32(camera.width);
    to.string("plumb_bob");
    // d: k1, k2, the tangential p1 and p2, k3.
    to.f64_sequence(&[camera.distortion.0, camera.distortion.1, 0.0, 0.0, 0.0]);
    // k, r and p by rows: the camera matrix, no rectification, the projection without a baseline.
    to.f64s(&[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    to.f64s(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    to.f64s(&[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    // No binning, and as region of interest the whole picture.
    to.u32(0);
    to.u32(0);
    for _ in 0..4 {
        to.u32(0);
    }
    to.bool(false);
}

/// Writes a `rcl_interfaces/Log` with the text `message` of the actor `name`. Its levels are 20
/// info, 30 warn, 40 error and 50 fatal. [`Class`] has two kinds of errors between warning and
/// fatal, non-fatal and system errors. Both get the level 40, and the field `function` tells them
/// apart.
pub(crate) fn log(to: &mut Writer, stamp: u64, class: Class, name: &str, message: &str) {
    let (level, function) = match class {
        Class::Info => (20, ""),
        Class::Warning => (30, ""),
        Class::NonFatal => (40, NON_FATAL),
        Class::System => (40, ""),
        Class::Fatal => (50, ""),
    };
    to.time(stamp);
    to.u8(level);
    to.string(name);
    to.string(message);
    // The name of the source file is empty, and the line number 0.
    to.string("");
    to.string(function);
    to.u32(0);
}

/// Text of the field `function` for a non-fatal error.
const NON_FATAL: &str = "non_fatal";

/// Decodes an `rcl_interfaces/Log` as [`log()`] writes it. Returns class, name of the actor and
/// text.
///
/// # Errors
/// [`Malformed`] if the bytes are no such message.
pub(crate) fn read_log<'a>(from: &mut Reader<'a>) -> Result<(Class, &'a str, &'a str), Malformed> {
    from.time()?;
    let level = from.u8()?;
    let (name, message) = (from.string()?, from.string()?);
    from.string()?;
    // Other programs use levels between those of the standard, so each class has a range.
    let class = match (level, from.string()?) {
        (0..=20, _) => Class::Info,
        (21..=30, _) => Class::Warning,
        (31..=40, NON_FATAL) => Class::NonFatal,
        (31..=40, _) => Class::System,
        _ => Class::Fatal,
    };
    Ok((class, name, message))
}

fn vector(to: &mut Writer, v: &Vector3<f64>) {
    to.f64s(&[v.x, v.y, v.z]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decoded_log_message_keeps_its_severity_class() {
        let all = [Class::Info, Class::Warning, Class::NonFatal, Class::System, Class::Fatal];
        for class in all {
            let mut to = Writer::new(Vec::new());
            log(&mut to, 5, class, "mp", "a word");
            let bytes = to.bytes();

            let read = read_log(&mut Reader::new(&bytes).unwrap()).unwrap();

            assert_eq!(read, (class, "mp", "a word"));
        }
    }
}
