//! Choice of the points of a way: few of the recorded ones, so that the path through them is the
//! way that the arm was led.
//!
//! - in: the recorded places, the kind of the path, the tolerance
//! - out: points. The path through them stays within the tolerance of each recorded place
//!
//! It begins with both ends, and adds the recorded place that is farthest from its piece of the
//! path until none is too far. Only the place of the tool is compared, not its turn.

use super::keys::Play;
use super::way::{Point, bends, distance};
use crate::generators::paths::Polynomial;
use crate::motion::{AXES, JointPositions};
use crate::spatial::Pose;
use nalgebra::Vector3;

/// Distance below which neighbouring records are one place (m).
const SAME: f64 = 5e-4;
/// Number of places at which a piece of a curve is looked at.
const PARTS: u32 = 16;

/// Piece of a path, as places of the tool (m).
type Piece = Vec<Vector3<f64>>;

/// Returns the records without those at which the arm rested.
pub(super) fn moving(records: &[Point]) -> Vec<Point> {
    let mut kept: Vec<Point> = Vec::new();
    for record in records {
        let near = |last: &Point| (last.place() - record.place()).norm() < SAME;
        if !kept.last().is_some_and(near) {
            kept.push(*record);
        }
    }
    // The end is where the arm was at last.
    if kept.len() > 1
        && let (Some(last), Some(end)) = (kept.last_mut(), records.last())
    {
        *last = *end;
    }
    kept
}

/// Chooses points from the records of a moving arm. `forward` gives the pose of the tool at joint
/// positions.
pub(super) fn choose(
    records: &[Point],
    by: Play,
    tolerance: f64,
    forward: &dyn Fn(&JointPositions) -> Pose,
) -> Vec<Point> {
    let mut ends = vec![0, records.len().saturating_sub(1)];
    while let Some(worst) = worst(records, &ends, &pieces(records, &ends, by, forward), tolerance) {
        let before = ends.partition_point(|end| *end < worst);
        ends.insert(before, worst);
    }
    if by != Play::Circle {
        return ends.iter().map(|end| records[*end]).collect();
    }
    let mut points = vec![records[0]];
    for pair in ends.windows(2) {
        points.extend([via(records, pair[0], pair[1]), records[pair[1]]]);
    }
    points
}

/// Returns the record that is farthest from its piece of the path; `None` if none is beyond the
/// tolerance (m).
fn worst(records: &[Point], ends: &[usize], pieces: &[Piece], tolerance: f64) -> Option<usize> {
    let inner = ends.windows(2).zip(pieces).flat_map(|(pair, piece)| {
        (pair[0] + 1..pair[1]).map(move |i| (i, distance(&records[i].place(), piece)))
    });
    let worst = inner.max_by(|a, b| a.1.total_cmp(&b.1))?;
    (worst.1 > tolerance).then_some(worst.0)
}

/// Returns the pieces of the path from each end to the next.
fn pieces(
    records: &[Point],
    ends: &[usize],
    by: Play,
    forward: &dyn Fn(&JointPositions) -> Pose,
) -> Vec<Piece> {
    let points: Vec<Point> = ends.iter().map(|end| records[*end]).collect();
    match by {
        Play::Line => points.windows(2).map(|p| vec![p[0].place(), p[1].place()]).collect(),
        Play::Circle => {
            let arc = |pair: &[usize]| {
                let via = via(records, pair[0], pair[1]);
                arc([records[pair[0]].place(), via.place(), records[pair[1]].place()])
            };
            ends.windows(2).map(arc).collect()
        }
        Play::Spline => {
            let places: Vec<[f64; 3]> = points.iter().map(|p| p.place().into()).collect();
            let apart = |p: &[Point]| (p[1].place() - p[0].place()).norm();
            let lengths = points.windows(2).map(|p| apart(p).max(1e-6)).collect();
            curve(&places, lengths, |at| Vector3::from(at))
        }
        Play::JointSpline => {
            let places: Vec<[f64; AXES]> = points.iter().map(|p| p.joints.0).collect();
            let apart = |p: &[Point]| {
                let by = p[0].joints.0.iter().zip(p[1].joints.0).map(|(a, b)| (a - b).abs());
                by.fold(0.0, f64::max)
            };
            let lengths = points.windows(2).map(|p| apart(p).max(1e-6)).collect();
            curve(&places, lengths, |at| forward(&JointPositions(at)).translation.vector)
        }
    }
}

/// Returns the pieces of a spline through `points`, as places of the tool.
fn curve<const D: usize>(
    points: &[[f64; D]],
    lengths: Vec<f64>,
    place: impl Fn([f64; D]) -> Vector3<f64>,
) -> Vec<Piece> {
    let spline = Polynomial::spline(points, &lengths);
    let mut begin = 0.0;
    let mut pieces = Vec::new();
    for length in lengths {
        let at = |i: u32| place(spline.at(begin + length * f64::from(i) / f64::from(PARTS)));
        pieces.push((0..=PARTS).map(at).collect());
        begin += length;
    }
    pieces
}

/// Returns the point through which an arc leads from one record to another.
fn via(records: &[Point], from: usize, to: usize) -> Point {
    let middle = usize::midpoint(from, to);
    if middle > from { records[middle] } else { records[from].middle(&records[to]) }
}

/// Returns the arc through three points, or the lines between them if they do not bend.
fn arc([a, b, c]: [Vector3<f64>; 3]) -> Piece {
    if !bends([a, b, c]) {
        return vec![a, b, c];
    }
    let (first, second) = (b - a, c - a);
    let normal = first.cross(&second);
    let centre = a
        + (normal.cross(&first) * second.norm_squared()
            + second.cross(&normal) * first.norm_squared())
            / (2.0 * normal.norm_squared());
    let arm = a - centre;
    let across = normal.normalize().cross(&arm);
    let end = c - centre;
    let angle = libm::atan2(end.dot(&across), end.dot(&arm)).rem_euclid(std::f64::consts::TAU);
    let at = |i: u32| {
        let angle = angle * f64::from(i) / f64::from(2 * PARTS);
        centre + arm * libm::cos(angle) + across * libm::sin(angle)
    };
    (0..=2 * PARTS).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    /// Returns records along `place`, whose parameter is 0..=1.
    fn records(place: impl Fn(f64) -> Vector3<f64>) -> Vec<Point> {
        let at = |i: u32| {
            let pose =
                Pose::from_parts(place(f64::from(i) / 100.0).into(), UnitQuaternion::identity());
            let mut joints = JointPositions::default();
            joints.0[..3].copy_from_slice(pose.translation.vector.as_slice());
            Point { joints, pose }
        };
        (0..=100).map(at).collect()
    }

    /// Returns the pose of an arm whose first three joints are the place of its tool.
    fn forward(joints: &JointPositions) -> Pose {
        Pose::from_parts(
            Vector3::from_column_slice(&joints.0[..3]).into(),
            UnitQuaternion::identity(),
        )
    }

    #[test]
    fn line_needs_corners_and_circle_one_arc() {
        let corner = records(|s| {
            let at = 0.2 * s;
            Vector3::new(at.min(0.1), (at - 0.1).max(0.0), 0.0)
        });
        let circle = records(|s| Vector3::new(0.1 * (2.0 * s).cos(), 0.1 * (2.0 * s).sin(), 0.0));
        let chosen = |records: &[Point], by| choose(records, by, 1e-3, &forward);

        let line = chosen(&corner, Play::Line);
        assert_eq!(line, [corner[0], corner[50], corner[100]]);
        assert_eq!(chosen(&circle, Play::Circle), [circle[0], circle[50], circle[100]]);
        assert!(chosen(&circle, Play::Line).len() > 5);
        for by in [Play::Spline, Play::JointSpline] {
            let few = chosen(&circle, by).len();
            assert!((4..=9).contains(&few), "{few}");
            assert!(chosen(&corner, by).len() > few);
        }
    }

    #[test]
    fn rests_are_left_out_and_end_kept() {
        let rests = records(|s| Vector3::new(0.1 * (2.0 * s).min(1.0), 0.0, 0.0));
        let moving = moving(&rests);
        assert_eq!(moving.len(), 51);
        assert_eq!(moving[50], rests[100]);
    }
}
