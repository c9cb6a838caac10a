//! The kernel of the task `teach`: guidance by hand, then playback.
//!
//! - in: the assignment, with the geometry of the arm as functions
//! - out: the behaviour `guide`, then motions through the points
//!
//! | case | threshold | reaction |
//! |---|---|---|
//! | a way too long for a file | [`MOST`] points | fewer points, with a message |
//! | the arm was not led | less than [`LEAST`] until the patience ends | failure |
//! | the person pulls too strongly | force limit of the arm, 0.5 s | failure |
//! | an obstacle or a push in playback | [`TRIES`] | wait [`AGAIN`], then from the first point |

use super::fit;
use super::keys::Play;
use super::way::{MOST, Point, Way, bends};
use crate::generators::Behaviour;
use crate::generators::contact::{Guide, GuideOrder, Guided};
use crate::generators::own::MotionGenerator as _;
use crate::generators::paths::{Along, Arc as Circle, JointSpline, Line, Spline};
use crate::kernel::robot::{Hindrance, Robot, RobotKernel};
use crate::motion::JointPositions;
use crate::spatial::Pose;
use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;

/// Time between two records of the way (s).
const INTERVAL: f64 = 0.08;
/// Least distance from the first place that counts as led (m).
const LEAST: f64 = 0.02;
/// Share of the full speed on the way to the first point.
const APPROACH: f64 = 0.2;
/// Number of tries to play the way back.
const TRIES: u32 = 4;
/// Time after which an arm that something stopped tries again (s).
const AGAIN: f64 = 1.0;

/// Reads the text of a way, or returns its faults.
type ReadWay = dyn Fn(&str) -> Result<Way, String> + Send + Sync;

/// Geometry of the arm, which a kernel gets as functions.
#[derive(Clone)]
pub struct Geometry {
    /// Returns the pose `base_from_tool` at joint positions.
    pub forward: Arc<dyn Fn(&JointPositions) -> Pose + Send + Sync>,
    /// Reads the text of a way, or returns its faults.
    pub read: Arc<ReadWay>,
}

impl fmt::Debug for Geometry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Geometry").finish_non_exhaustive()
    }
}

/// Assignment of the task.
#[derive(Debug, Clone)]
pub struct Lesson {
    /// Index and name of the arm.
    pub arm: (usize, String),
    /// Way of a file; `None` if the arm is led.
    pub given: Option<Way>,
    /// File for a taught way.
    pub file: Option<PathBuf>,
    /// Whether the way is played back.
    pub plays: bool,
    /// Path through the points.
    pub by: Play,
    /// Share of the full speed.
    pub speed: f64,
    /// Greatest distance of the recorded way from the path through the points (m).
    pub tolerance: f64,
    /// Time of rest after which the way is complete (s).
    pub still: f64,
    /// Time for which the arm waits to be led (s).
    pub patience: f64,
    /// Geometry of the arm.
    pub geometry: Geometry,
}

/// Makes the kernel of MP.
#[must_use]
pub fn teach(lesson: Lesson) -> RobotKernel {
    Robot::kernel(move |robot| async move {
        let way = match &lesson.given {
            Some(way) => way.clone(),
            None => taught(&robot, &lesson).await?,
        };
        robot.report("points", way.points.len());
        if lesson.plays {
            play(&robot, &lesson, &way).await?;
            return Ok(format!("a way of {} points was played back", way.points.len()));
        }
        Ok(format!("a way of {} points was taught", way.points.len()))
    })
}

/// Lets a person lead the arm, and returns the way as it reads in its file.
async fn taught(robot: &Robot, lesson: &Lesson) -> Result<Way, Hindrance> {
    robot.phase("teach").await?;
    let (arm, name) = &lesson.arm;
    robot.bias((0..robot.arms().len()).map(|other| other == *arm).collect()).await?;
    let order = GuideOrder { still: Some(lesson.still), interval: INTERVAL };
    let order = Guide::behaviour("guide", &order)?;
    robot.tell(format!("lead the arm {name} by hand; {} s of rest end the way", lesson.still));
    let until = robot.now() + lesson.patience;
    let records = loop {
        let outcome = robot.behave(*arm, order.clone()).await?;
        let guided: Option<Guided> = outcome.result();
        let guided = guided.ok_or_else(|| Hindrance(format!("guidance ended: {outcome}")))?;
        let records = records(&guided);
        if extent(&records) >= LEAST {
            break records;
        }
        if robot.now() >= until {
            return Err(Hindrance(format!("no person led the arm {name} by hand")));
        }
    };
    let records = fit::moving(&records);
    let forward = lesson.geometry.forward.as_ref();
    let mut choice = fit::Choice::new(&records, lesson.by, lesson.tolerance, MOST, forward);
    let fit::Chosen { points, off } = loop {
        // The shell gets the turn between two rounds of the work.
        robot.pause(0.0).await?;
        if let Some(chosen) = choice.round() {
            break chosen;
        }
    };
    if off > lesson.tolerance {
        robot.warn(format!(
            "the way is too long for {MOST} points within {:.1} mm: the path through them is up to \
             {:.1} mm off",
            lesson.tolerance * 1e3,
            off * 1e3
        ));
    }
    robot.pause(0.0).await?;
    let (way, text) = readable(&Way { arm: name.clone(), points }, lesson)?;
    if let Some(file) = &lesson.file {
        robot.keep(file, text);
    }
    Ok(way)
}

/// Returns a way as it reads in its file, and the text of the file. Joints that are rounded with
/// the pose may be out of reach at the edge of the workspace: the text then has the joints.
fn readable(way: &Way, lesson: &Lesson) -> Result<(Way, String), Hindrance> {
    let mut why = String::new();
    for by_joints in [lesson.by == Play::JointSpline, true] {
        let text = way.text(by_joints);
        match (lesson.geometry.read)(&text) {
            Ok(way) => return Ok((way, text)),
            Err(faults) => why = faults,
        }
    }
    Err(Hindrance(format!("the taught way: {why}")))
}

/// Returns the records of a guidance.
fn records(guided: &Guided) -> Vec<Point> {
    let pairs = guided.joints.iter().zip(&guided.poses);
    pairs.map(|(joints, pose)| Point { joints: *joints, pose: *pose }).collect()
}

/// Returns the greatest distance of a record from the first one (m).
fn extent(records: &[Point]) -> f64 {
    let from = |first: &Point| {
        records.iter().map(|at| (at.place() - first.place()).norm()).fold(0.0, f64::max)
    };
    records.first().map_or(0.0, from)
}

/// Plays a way back. An arm that something stopped begins again, a few times.
async fn play(robot: &Robot, lesson: &Lesson, way: &Way) -> Result<(), Hindrance> {
    robot.phase("play").await?;
    let mut tries = 1;
    loop {
        match once(robot, lesson, &way.points).await {
            Ok(()) => break,
            Err(why) if tries == TRIES => return Err(why),
            Err(why) => robot.warn(format!("stopped in playback: {why}; it will try again")),
        }
        tries += 1;
        robot.pause(AGAIN).await?;
    }
    robot.report("tries", tries);
    Ok(())
}

/// Goes to the first point, then through the others.
async fn once(robot: &Robot, lesson: &Lesson, points: &[Point]) -> Result<(), Hindrance> {
    let Some((first, rest)) = points.split_first() else { return Ok(()) };
    let start = Behaviour::Joints { target: first.joints, speed: APPROACH, seconds: 0.0 };
    robot.behave(lesson.arm.0, start).await?;
    for motion in motions(first, rest, lesson.by, lesson.speed)? {
        robot.behave(lesson.arm.0, motion).await?;
    }
    Ok(())
}

/// Returns the motions from the first point through the others.
fn motions(first: &Point, rest: &[Point], by: Play, speed: f64) -> Result<Vec<Behaviour>, String> {
    let line = |to: &Point| Along::<Line>::behaviour("line", &Line { target: to.pose, speed });
    match by {
        Play::Line => rest.iter().map(line).collect(),
        Play::Spline => {
            let through = rest.iter().map(|point| point.pose).collect();
            Ok(vec![Along::<Spline>::behaviour("spline", &Spline { through, speed })?])
        }
        Play::JointSpline => {
            let through = rest.iter().map(|point| point.joints).collect();
            let order = JointSpline { through, speed };
            Ok(vec![Along::<JointSpline>::behaviour("joint_spline", &order)?])
        }
        Play::Circle => {
            let mut at = first;
            let mut motions = Vec::new();
            for pair in rest.chunks(2) {
                match pair {
                    [via, to] if bends([at.place(), via.place(), to.place()]) => {
                        let order = Circle { via: via.place(), target: to.pose, speed };
                        motions.push(Along::<Circle>::behaviour("arc", &order)?);
                    }
                    // Points on a line, or one without a partner at the end.
                    points => {
                        for point in points {
                            motions.push(line(point)?);
                        }
                    }
                }
                at = pair.last().unwrap_or(at);
            }
            Ok(motions)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a point at this place.
    fn point(x: f64, y: f64) -> Point {
        let pose = Pose::translation(x, y, 0.0);
        Point { joints: JointPositions::default(), pose }
    }

    #[test]
    fn circle_has_arcs_and_lines_where_straight() {
        let rest = [(1.0, 1.0), (2.0, 0.0), (3.0, 0.0), (4.0, 0.0), (5.0, 1.0)];
        let rest = rest.map(|(x, y)| point(x, y));

        let motions = motions(&point(0.0, 0.0), &rest, Play::Circle, 0.2).unwrap();

        let names: Vec<&str> = motions
            .iter()
            .map(|motion| match motion {
                Behaviour::Own(order) => order.generator.as_str(),
                _ => "",
            })
            .collect();
        assert_eq!(names, ["arc", "line", "line", "line"]);
        assert!((extent(&rest) - 4.0_f64).abs() < 1e-12);
    }
}
