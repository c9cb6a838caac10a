//! Choice of the points of a way: few of the recorded ones, so that the path through them is the
//! way that the arm was led.
//!
//! - in: the recorded places, the kind of the path, the tolerance
//! - out: points. The path through them stays within the tolerance of each recorded place
//!
//! It begins with both ends. Each round adds the recorded place that is farthest from its piece of
//! the path, of each piece that is too far off. A kernel must not compute for long, so it gives way
//! between two rounds, and the number of rounds grows with the logarithm of the number of records.
//! Only the place of the tool is compared, not its turn.
//!
//! | case | reaction |
//! |---|---|
//! | more points than a file may have | the worst places are added first; the rest is left out |

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

/// Number of rounds after which a piece is also divided in its middle, so that the number of
/// further rounds grows with the logarithm of the number of records.
const EVENLY: usize = 16;
/// Share of the greatest error above which a round adds a point.
const SHARE: f64 = 0.5;

/// Piece of a path, as places of the tool (m).
type Piece = Vec<Vector3<f64>>;
/// Function that returns the pose of the tool at joint positions.
type Forward<'a> = dyn Fn(&JointPositions) -> Pose + Send + Sync + 'a;

/// Returns the records without those at which the arm rested.
#[must_use]
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

/// Chosen points of a way.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Chosen {
    /// The points.
    pub(super) points: Vec<Point>,
    /// Greatest distance of a record from the path through the points (m).
    pub(super) off: f64,
}

/// Choice of points, which goes on round by round: each round takes a few milliseconds.
pub(super) struct Choice<'a> {
    records: &'a [Point],
    by: Play,
    tolerance: f64,
    /// Most ends of pieces.
    most: usize,
    forward: &'a Forward<'a>,
    /// Records between which the pieces of the path lie.
    ends: Vec<usize>,
    rounds: usize,
}

impl<'a> Choice<'a> {
    /// Begins the choice of at most `most` points from the records of a moving arm. `forward` gives
    /// the pose of the tool at joint positions.
    #[must_use]
    pub(super) fn new(
        records: &'a [Point],
        by: Play,
        tolerance: f64,
        most: usize,
        forward: &'a Forward<'a>,
    ) -> Self {
        // A circle has a point between each two ends.
        let most = if by == Play::Circle { most.div_ceil(2) } else { most };
        let ends = vec![0, records.len().saturating_sub(1)];
        Self { records, by, tolerance, most, forward, ends, rounds: 0 }
    }

    /// Adds the points of one round. Returns the choice once it is complete.
    #[must_use]
    pub(super) fn round(&mut self) -> Option<Chosen> {
        let pieces = pieces(self.records, &self.ends, self.by, self.forward);
        let mut worst = worst(self.records, &self.ends, &pieces);
        let greatest = worst.iter().map(|(_, off, _)| *off).fold(0.0, f64::max);
        if greatest <= self.tolerance || self.ends.len() >= self.most {
            return Some(self.chosen(greatest));
        }
        // A point changes a spline beside its own piece too, so smaller errors may fade by
        // themselves.
        worst.retain(|(_, off, _)| *off > self.tolerance.max(SHARE * greatest));
        worst.sort_by(|a, b| b.1.total_cmp(&a.1));
        self.rounds += 1;
        let mut new: Vec<usize> = worst.iter().map(|(record, ..)| *record).collect();
        if self.rounds > EVENLY {
            // In a zigzag the worst place is mostly beside an end, so the piece stays long.
            new.extend(worst.iter().map(|(_, _, middle)| *middle));
        }
        new.truncate(self.most - self.ends.len());
        self.ends.extend(new);
        self.ends.sort_unstable();
        self.ends.dedup();
        None
    }

    /// Returns the points that are chosen. `off` is the greatest error (m).
    fn chosen(&self, off: f64) -> Chosen {
        let records = self.records;
        let mut points: Vec<Point> = records.iter().take(1).copied().collect();
        for pair in self.ends.windows(2) {
            if self.by == Play::Circle {
                points.push(via(records, pair[0], pair[1]));
            }
            points.push(records[pair[1]]);
        }
        Chosen { points, off }
    }
}

/// Returns the path through the points of a way, as places of the tool.
#[must_use]
pub(super) fn path(points: &[Point], by: Play, forward: &Forward<'_>) -> Vec<Vector3<f64>> {
    if by != Play::Circle {
        let ends: Vec<usize> = (0..points.len()).collect();
        return pieces(points, &ends, by, forward).concat();
    }
    let mut path: Piece = points.iter().take(1).map(Point::place).collect();
    for pair in points.get(1..).unwrap_or_default().chunks(2) {
        match (path.last(), pair) {
            (Some(at), [via, to]) => path.extend(arc([*at, via.place(), to.place()])),
            _ => path.extend(pair.iter().map(Point::place)),
        }
    }
    path
}

/// Returns the record of each piece that is farthest from it, with its distance (m) and the record
/// in the middle of the piece.
fn worst(records: &[Point], ends: &[usize], pieces: &[Piece]) -> Vec<(usize, f64, usize)> {
    let worst = |(pair, piece): (&[usize], &Piece)| {
        let middle = usize::midpoint(pair[0], pair[1]);
        let off = |i: usize| distance(&records[i].place(), piece);
        let inner = (pair[0] + 1..pair[1]).map(|i| (i, off(i), middle));
        inner.max_by(|a, b| a.1.total_cmp(&b.1))
    };
    ends.windows(2).zip(pieces).filter_map(worst).collect()
}

/// Returns the pieces of the path from each end to the next.
fn pieces(records: &[Point], ends: &[usize], by: Play, forward: &Forward<'_>) -> Vec<Piece> {
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
            let lengths: Vec<f64> = points.windows(2).map(|p| apart(p).max(1e-6)).collect();
            curve(&places, &lengths, Vector3::from)
        }
        Play::JointSpline => {
            let places: Vec<[f64; AXES]> = points.iter().map(|p| p.joints.0).collect();
            let apart = |p: &[Point]| {
                let by = p[0].joints.0.iter().zip(p[1].joints.0).map(|(a, b)| (a - b).abs());
                by.fold(0.0, f64::max)
            };
            let lengths: Vec<f64> = points.windows(2).map(|p| apart(p).max(1e-6)).collect();
            curve(&places, &lengths, |at| forward(&JointPositions(at)).translation.vector)
        }
    }
}

/// Returns the pieces of a spline through `points`, as places of the tool.
fn curve<const D: usize>(
    points: &[[f64; D]],
    lengths: &[f64],
    place: impl Fn([f64; D]) -> Vector3<f64>,
) -> Vec<Piece> {
    let spline = Polynomial::spline(points, lengths);
    let at = |piece: usize, i: u32| place(spline.within(piece, f64::from(i) / f64::from(PARTS)));
    (0..lengths.len()).map(|piece| (0..=PARTS).map(|i| at(piece, i)).collect()).collect()
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

    /// Chooses points in as many rounds as it takes.
    fn choose(
        records: &[Point],
        by: Play,
        tolerance: f64,
        most: usize,
        forward: &Forward<'_>,
    ) -> Chosen {
        let mut choice = Choice::new(records, by, tolerance, most, forward);
        std::iter::repeat_with(|| choice.round()).find_map(|chosen| chosen).unwrap()
    }

    #[test]
    fn line_needs_corners_and_circle_one_arc() {
        let corner = records(|s| {
            let at = 0.2 * s;
            Vector3::new(at.min(0.1), (at - 0.1).max(0.0), 0.0)
        });
        let circle = records(|s| Vector3::new(0.1 * (2.0 * s).cos(), 0.1 * (2.0 * s).sin(), 0.0));
        let chosen = |records: &[Point], by| choose(records, by, 1e-3, usize::MAX, &forward).points;

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

    /// A file has a greatest number of points. The worst places get them.
    #[test]
    fn long_way_is_thinned_to_most_points() {
        let waves = records(|s| Vector3::new(s, 0.05 * (60.0 * s).sin(), 0.0));
        for by in [Play::Line, Play::Spline, Play::JointSpline, Play::Circle] {
            let all = choose(&waves, by, 1e-4, usize::MAX, &forward);
            let thinned = choose(&waves, by, 1e-4, 21, &forward);

            assert!(all.points.len() > 21 && all.off <= 1e-4, "{by:?} {}", all.points.len());
            assert!(thinned.points.len() <= 21 && thinned.off > 1e-3, "{by:?} {}", thinned.off);
            assert_eq!(thinned.points.last(), waves.last());
        }
    }

    /// The path of a file is the one by which the points were chosen.
    #[test]
    fn path_stays_within_tolerance_of_records() {
        let waves = records(|s| Vector3::new(s, 0.05 * (9.0 * s).sin(), 0.0));
        for by in [Play::Line, Play::Spline, Play::JointSpline, Play::Circle] {
            let chosen = choose(&waves, by, 1e-3, usize::MAX, &forward);
            let path = path(&chosen.points, by, &forward);

            let off = |record: &Point| distance(&record.place(), &path);
            let most = waves.iter().map(off).fold(0.0, f64::max);
            assert!(most <= 1e-3 && most > 1e-4, "{by:?} {most}");
        }
    }

    /// A kernel has 80 ms before the watchdog reports it, and gives way between two rounds. In a
    /// zigzag of 4096 records the worst place is always beside an end of its piece.
    #[test]
    fn rounds_of_longest_zigzag_are_few() {
        let at = |i: u32| {
            let y = 0.02 * libm::sin(0.7 * f64::from(i));
            let place = Vector3::new(2e-3 * f64::from(i), y, 0.0);
            let mut joints = JointPositions::default();
            joints.0[..3].copy_from_slice(place.as_slice());
            Point { joints, pose: Pose::from_parts(place.into(), UnitQuaternion::identity()) }
        };
        let long: Vec<Point> = (0..4096).map(at).collect();
        for by in [Play::Line, Play::Spline, Play::JointSpline, Play::Circle] {
            let mut choice = Choice::new(&long, by, 1e-4, 2000, &forward);
            let (mut rounds, mut longest) = (0, std::time::Duration::ZERO);
            let chosen = loop {
                let begun = std::time::Instant::now();
                let chosen = choice.round();
                (rounds, longest) = (rounds + 1, longest.max(begun.elapsed()));
                if let Some(chosen) = chosen {
                    break chosen;
                }
            };
            println!("{by:?}: {} points, {rounds} rounds, {longest:?}", chosen.points.len());
            assert!((1900..=2000).contains(&chosen.points.len()), "{}", chosen.points.len());
            assert!(rounds <= 3 * EVENLY, "{by:?}: {rounds} rounds");
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
