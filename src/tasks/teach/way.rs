//! A way: points through which an arm is to go, and their text.
//!
//! - in: joint positions and poses of the tool
//! - out: the text of a file that a person can read and edit; whether three points make an arc

use crate::motion::JointPositions;
use crate::spatial::Pose;
use nalgebra::Vector3;
use std::fmt::Write as _;

/// Most points of a way.
pub(super) const MOST: usize = 2000;
/// Least sine of the angle at which three points make an arc.
const BENT: f64 = 1e-2;

/// Point of a way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Joint positions (m, rad).
    pub joints: JointPositions,
    /// `base_from_tool`.
    pub pose: Pose,
}

/// Way of an arm.
#[derive(Debug, Clone, PartialEq)]
pub struct Way {
    /// Name of the arm.
    pub arm: String,
    /// Points, two or more.
    pub points: Vec<Point>,
}

impl Point {
    /// Returns the place of the tool in the base (m).
    #[must_use]
    pub fn place(&self) -> Vector3<f64> {
        self.pose.translation.vector
    }

    /// Returns the point half way to another one.
    #[must_use]
    pub fn middle(&self, to: &Self) -> Self {
        let turned = self.pose.rotation.try_slerp(&to.pose.rotation, 0.5, 0.0);
        let place = self.place().lerp(&to.place(), 0.5);
        let pose = Pose::from_parts(place.into(), turned.unwrap_or(to.pose.rotation));
        Self { joints: self.joints.towards(&to.joints, 0.5), pose }
    }
}

impl Way {
    /// Returns the text of the file: each point by its joints, or by the pose of the tool.
    #[must_use]
    pub fn text(&self, by_joints: bool) -> String {
        let mut text = format!(
            "# Way of an arm that was led by hand. The tool goes through the points in their \
             order.\n\
             # A point is a pose of the tool in the base of the arm (xyz_mm, rpy_deg), or a \
             place of\n\
             # the joints (track_mm, joints_deg). Points may be moved, added and removed.\n\
             arm = {:?}\n",
            self.arm
        );
        if let Some(first) = self.points.first() {
            text.push_str("\n# Joints near which the arm reaches the first point.\n[posture]\n");
            text.push_str(&joints(&first.joints));
        }
        for (i, point) in self.points.iter().enumerate() {
            let _ = write!(text, "\n[[point]]\nname = \"p{}\"\n", i + 1);
            text.push_str(&if by_joints { joints(&point.joints) } else { pose(&point.pose) });
        }
        text
    }
}

/// Returns the keys of joint positions.
fn joints(JointPositions([track, angles @ ..]): &JointPositions) -> String {
    let angles = list(&angles.map(f64::to_degrees), 5);
    format!("track_mm = {}\njoints_deg = {angles}\n", number(track * 1e3, 3))
}

/// Returns the keys of a pose.
fn pose(pose: &Pose) -> String {
    let (roll, pitch, yaw) = pose.rotation.euler_angles();
    let xyz: [f64; 3] = (pose.translation.vector * 1e3).into();
    let rpy = [roll, pitch, yaw].map(f64::to_degrees);
    format!("xyz_mm = {}\nrpy_deg = {}\n", list(&xyz, 3), list(&rpy, 4))
}

/// Returns numbers as a list.
fn list(numbers: &[f64], digits: usize) -> String {
    let numbers: Vec<String> = numbers.iter().map(|x| number(*x, digits)).collect();
    format!("[{}]", numbers.join(", "))
}

/// Returns a number with at most this many digits after its point.
fn number(x: f64, digits: usize) -> String {
    let text = format!("{x:.digits$}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Returns whether three points make an arc, and not a line.
#[must_use]
pub(super) fn bends([a, b, c]: [Vector3<f64>; 3]) -> bool {
    let (first, second) = (b - a, c - a);
    let apart = (c - b).norm() > BENT * first.norm();
    apart && first.cross(&second).norm() > BENT * first.norm() * second.norm()
}

/// Returns the length of a polyline (m).
#[must_use]
pub(super) fn length(places: &[Vector3<f64>]) -> f64 {
    places.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
}

/// Returns the distance of a place from a polyline (m); infinite if that is empty.
#[must_use]
pub(super) fn distance(place: &Vector3<f64>, line: &[Vector3<f64>]) -> f64 {
    let alone = line.first().map_or(f64::INFINITY, |only| (place - only).norm());
    let from_leg = |pair: &[Vector3<f64>]| {
        let leg = pair[1] - pair[0];
        let share = (place - pair[0]).dot(&leg) / leg.norm_squared().max(1e-18);
        (place - pair[0] - leg * share.clamp(0.0, 1.0)).norm()
    };
    line.windows(2).map(from_leg).fold(alone, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_rounded() {
        assert_eq!(list(&[1.0, -0.00001, 2.345_678, 100.0], 3), "[1, 0, 2.346, 100]");
    }

    #[test]
    fn distance_is_to_nearest_leg() {
        let at = |x: f64, y: f64| Vector3::new(x, y, 0.0);
        let line = [at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0)];
        assert!((distance(&at(0.5, 0.2), &line) - 0.2).abs() < 1e-12);
        assert!((distance(&at(1.3, 0.5), &line) - 0.3).abs() < 1e-12);
        assert!((distance(&at(-1.0, 0.0), &line) - 1.0).abs() < 1e-12);
        assert!((length(&line) - 2.0).abs() < 1e-12);
    }
}
