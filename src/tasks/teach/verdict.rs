//! The verdict on the task `teach`: the way of the tool in playback against the way on which the
//! person led it, both from the plant.
//!
//! - in: the place of the tool in each period, and whether a person leads a tool
//! - out: the distances between both ways; without a person those of the points of the file, seen
//!   from the true base of the arm, from the way of the tool; without a playback those of the path
//!   through the points of the taught file from the way on which the person led the tool
//! - ways are matched in order: on a way out and back, the way back counts as well
//!
//! Playback begins where the tool leaves the beginning of the way. It may have begun several times,
//! for instance after a push: the beginning with the smallest error counts, and all that follows.

use super::door::Teach;
use super::file_keys;
use super::fit;
use super::keys::{Keys, Mode, Play};
use super::order;
use super::way::{distance, length};
use crate::cell::{Arm, Cell};
use crate::hw::plant::Plant;
use crate::kernel::Document;
use crate::motion::{JointPositions, PERIOD};
use crate::registry::{Judgement, Truth, Verdict};
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// Time between two looks at the tools (ticks of 2 ms).
const LOOK: u64 = 5;
/// Distance below which a tool is at the same place (m).
const SAME: f64 = 2e-4;
/// Least length of a way (m).
const LEAST: f64 = 0.05;
/// Distance of both ways that is allowed beyond the tolerance of the chosen points (m): arms
/// repeat a place with backlash and sag.
const ARM: f64 = 2e-3;
/// As [`ARM`], for the points of a file (m): the sag of the arm, 3 to 4 mm at the postument, does
/// not cancel as between two ways of the same arm.
const SAG: f64 = 6e-3;
/// Most beginnings of a playback that are tried.
const BEGINNINGS: usize = 20;

/// Judge of the task.
#[derive(Debug, Default)]
pub struct PlayedBack {
    /// True cell.
    cell: Option<Cell>,
    /// One entry an arm.
    arms: Vec<Course>,
    /// Greatest force of a person (N).
    force: f64,
}

/// Course of one tool in the world (m).
#[derive(Debug, Default)]
struct Course {
    /// Places while a person led a tool.
    led: Vec<Vector3<f64>>,
    /// Times (ticks) and places afterwards.
    after: Vec<(u64, Vector3<f64>)>,
}

/// Errors of a playback.
#[derive(Debug, Clone, Copy)]
struct Errors {
    /// Root of the mean square (m).
    rms: f64,
    /// Greatest (m).
    greatest: f64,
    /// Duration (s).
    seconds: f64,
    /// Length of the way (m).
    length: f64,
}

impl Verdict for PlayedBack {
    type Task = Teach;

    fn watch(&mut self, tick: u64, plant: &Plant) {
        if !tick.is_multiple_of(LOOK) {
            return;
        }
        if self.cell.is_none() {
            self.cell = Some(plant.cell().clone());
        }
        let forces: Vec<f64> = plant.lead_forces().collect();
        self.force = forces.iter().copied().fold(self.force, f64::max);
        let done = plant.leads_done() == forces.len();
        let begun = self.force > 0.0;
        let scene = plant.scene();
        self.arms.resize_with(scene.arm_count, Course::default);
        for (course, tool) in self.arms.iter_mut().zip(&scene.arms) {
            let place = tool.world_from_tool.translation.vector;
            if done {
                course.follow(tick, place);
            } else if begun && !course.led.last().is_some_and(|last| is_same(last, &place)) {
                course.led.push(place);
            }
        }
    }

    fn judge(&self, keys: &Keys, truth: &Truth) -> Judgement {
        let (Some(cell), true) = (&self.cell, !self.arms.is_empty()) else {
            return Judgement::new(false, "the plant did not run");
        };
        let index = cell.arms.iter().position(|arm| arm.name == keys.arm).unwrap_or_default();
        let Some(course) = self.arms.get(index) else {
            return Judgement::new(false, "the plant has no such arm");
        };
        if keys.mode == Mode::Play {
            return match file_keys::load(Path::new(&keys.file), &cell.arms[index]) {
                Err(faults) => Judgement::new(false, faults.to_string()),
                Ok(way) => {
                    let base = cell.arms[index].world_from_base;
                    let places = way.points.iter().map(|point| base * point.pose);
                    let places: Vec<_> = places.map(|pose| pose.translation.vector).collect();
                    let within = keys.tolerance + SAG;
                    compared(course, &places, keys.play == Play::Line, within)
                }
            };
        }
        let led = length(&course.led);
        let judgement = if led < LEAST {
            Judgement::new(false, format!("the person led the tool by {:.1} mm only", led * 1e3))
        } else if keys.mode == Mode::Teach {
            taught(&course.led, truth.documents.first(), &cell.arms[index], keys)
        } else {
            compared(course, &course.led, true, keys.tolerance + ARM)
        };
        judgement.with("led_mm", round(led * 1e3)).with("lead_force_n", round(self.force))
    }
}

impl Course {
    /// Follows the tool after the lead.
    fn follow(&mut self, tick: u64, place: Vector3<f64>) {
        if !self.after.last().is_some_and(|(_, last)| is_same(last, &place)) {
            self.after.push((tick, place));
        }
    }
}

/// Returns whether two places are the same.
fn is_same(a: &Vector3<f64>, b: &Vector3<f64>) -> bool {
    (a - b).norm() < SAME
}

/// Returns a figure with three digits after the point.
fn round(figure: f64) -> f64 {
    (figure * 1e3).round() / 1e3
}

/// Judges the file of a lesson by the places `led` on which the person led the tool (m).
fn taught(led: &[Vector3<f64>], file: Option<&Document>, arm: &Arm, keys: &Keys) -> Judgement {
    let words = format!("the person led the tool by {:.1} mm", length(led) * 1e3);
    let Some(file) = file else {
        // Without a file the lesson has no result to judge.
        return Judgement::new(keys.file.is_empty(), words);
    };
    let name = file.path.display().to_string();
    let way = match file_keys::read(&name, &file.text, arm) {
        Ok(way) => way,
        Err(faults) => return Judgement::new(false, format!("{words}; {faults}")),
    };
    let forward =
        |joints: &JointPositions| arm.model.base_from_flange(joints) * arm.flange_from_tool;
    let in_world = |place: Vector3<f64>| (arm.world_from_base * Point3::from(place)).coords;
    let path = fit::path(&way.points, keys.play, &forward).into_iter().map(in_world);
    let path: Vec<Vector3<f64>> = path.collect();
    let off = led.iter().map(|place| distance(place, &path));
    let off = off.chain(path.iter().map(|place| distance(place, led))).fold(0.0, f64::max);
    let within = keys.tolerance + SAG;
    let off = order::greatest(led, &path, off, within);
    let words = format!("{words}; the points of the file are within {:.1} mm of it", off * 1e3);
    Judgement::new(off <= within, words).with("file_off_mm", round(off * 1e3))
}

/// Judges the course after the lead by the wanted way. `is_line` is whether the tool must stay on
/// the polyline of `wanted`, and not only pass its points; `within` is the greatest error (m).
fn compared(course: &Course, wanted: &[Vector3<f64>], is_line: bool, within: f64) -> Judgement {
    let begins = beginnings(&course.after, wanted, within);
    let errors =
        begins.iter().map(|begin| errors(&course.after[*begin..], wanted, is_line, within));
    let Some(best) = errors.min_by(|a, b| a.greatest.total_cmp(&b.greatest)) else {
        return Judgement::new(false, "the tool did not come to the beginning of the way");
    };
    let words = format!(
        "the tool played {:.1} mm back within {:.2} mm of the way, {:.2} mm r.m.s.",
        best.length * 1e3,
        best.greatest * 1e3,
        best.rms * 1e3
    );
    Judgement::new(best.greatest <= within, words)
        .with("error_rms_mm", round(best.rms * 1e3))
        .with("error_greatest_mm", round(best.greatest * 1e3))
        .with("played_mm", round(best.length * 1e3))
        .with("played_s", round(best.seconds))
}

/// Returns the last places at which the tool may have begun the way: for each stay at its beginning
/// the nearest place.
fn beginnings(after: &[(u64, Vector3<f64>)], wanted: &[Vector3<f64>], within: f64) -> Vec<usize> {
    let Some(first) = wanted.first() else { return Vec::new() };
    let mut found = Vec::new();
    let mut stay: Option<(usize, f64)> = None;
    for (i, (_, place)) in after.iter().enumerate() {
        let away = (place - first).norm();
        if away > within {
            found.extend(stay.take().map(|(nearest, _)| nearest));
        } else if stay.is_none_or(|(_, least)| away <= least) {
            stay = Some((i, away));
        }
    }
    let surplus = found.len().saturating_sub(BEGINNINGS);
    found.split_off(surplus)
}

/// Returns the errors of a playback against the wanted way; see [`compared`].
fn errors(
    played: &[(u64, Vector3<f64>)],
    wanted: &[Vector3<f64>],
    is_line: bool,
    within: f64,
) -> Errors {
    let places: Vec<Vector3<f64>> = played.iter().map(|(_, place)| *place).collect();
    // The tool must pass all of the way, and stay on it.
    let passed: Vec<f64> = wanted.iter().map(|place| distance(place, &places)).collect();
    let stayed: Vec<f64> = if is_line {
        places.iter().map(|place| distance(place, wanted)).collect()
    } else {
        passed.clone()
    };
    let greatest = passed.iter().chain(&stayed).copied().fold(0.0, f64::max);
    let greatest = if is_line {
        order::greatest(&places, wanted, greatest, within)
    } else {
        greatest.max(order::passes(wanted, &places))
    };
    let squares: f64 = stayed.iter().map(|error| error * error).sum();
    let ticks = match played {
        [first, .., last] => last.0 - first.0,
        _ => 0,
    };
    Errors {
        rms: (squares / stayed.len().max(1) as f64).sqrt(),
        greatest,
        seconds: ticks as f64 * PERIOD,
        length: length(&places),
    }
}

#[cfg(test)]
mod tests {
    use super::super::way::{Point, Way};
    use super::*;

    /// Returns places along x and then along y, each leg 100 mm.
    fn corner(offset: f64) -> Vec<Vector3<f64>> {
        let x = (0..=100).map(|i| Vector3::new(f64::from(i) * 1e-3, offset, 0.0));
        let y = (1..=100).map(|i| Vector3::new(0.1 - offset, f64::from(i) * 1e-3, 0.0));
        x.chain(y).collect()
    }

    /// Returns the judgement on a tool that takes these courses after the lead.
    fn judged(courses: &[&[Vector3<f64>]]) -> Judgement {
        let mut course = Course::default();
        let places = courses.iter().copied().flatten();
        places.zip(0..).for_each(|(place, tick)| course.follow(tick, *place));
        compared(&course, &corner(0.0), true, 3e-3)
    }

    #[test]
    fn same_way_is_right_and_other_wrong() {
        let back: Vec<_> = corner(0.0).into_iter().rev().collect();
        let aside = [Vector3::new(0.2, 0.2, 0.2)];
        let begun = &corner(0.0)[..50];

        let good = judged(&[&back, &corner(0.5e-3)]);
        assert!(good.right, "{}", good.words);
        let greatest = good.figures["error_greatest_mm"].as_f64().unwrap();
        assert!((0.4..0.8).contains(&greatest), "{greatest}");
        let again = judged(&[&back, begun, &aside, &corner(0.0)]);
        assert!(again.right, "interrupted once: {}", again.words);

        for wrong in [
            judged(&[&back, &corner(5e-3)]),
            judged(&[&back, begun]),
            judged(&[&back, &corner(0.0), &aside]),
            judged(&[&aside, &back[..100]]),
        ] {
            assert!(!wrong.right, "{}", wrong.words);
        }
    }

    /// The way goes out and back along one line. A tool that comes back by half way only, or that
    /// goes out only, has been at each place of the way.
    #[test]
    fn way_out_and_back_is_matched_in_order() {
        let out: Vec<_> = (0..=100).map(|i| Vector3::new(f64::from(i) * 1e-3, 0.0, 0.0)).collect();
        let back = |from: usize| out[from..].iter().rev().copied().collect::<Vec<_>>();
        let course = |parts: &[Vec<Vector3<f64>>]| {
            let mut course = Course::default();
            let aside = vec![Vector3::new(0.0, 0.1, 0.0)];
            let places = std::iter::once(&aside).chain(parts).flatten();
            places.zip(0..).for_each(|(place, tick)| course.follow(tick, *place));
            course
        };
        let wanted = [out.clone(), back(0)].concat();
        let points = [out[0], out[50], out[100], out[50], out[0]];
        let right = |parts: &[Vec<Vector3<f64>>]| {
            let course = course(parts);
            let line = compared(&course, &wanted, true, 3e-3);
            [line, compared(&course, &points, false, 3e-3)].map(|judgement| judgement.right)
        };

        assert_eq!(right(&[out.clone(), back(0)]), [true; 2]);
        assert_eq!(right(std::slice::from_ref(&out)), [false; 2]);
        assert_eq!(right(&[out.clone(), back(70)]), [false; 2]);
    }

    /// The file has the path of the tool, but in another order, aside or in part.
    #[test]
    fn file_of_another_way_is_wrong() {
        let scenario = crate::tasks::read(Path::new("t.toml"), "task = \"idle\"\n", &[]).unwrap();
        let arm = scenario.controller.cell.arms[0].clone();
        let forward =
            |joints: &JointPositions| arm.model.base_from_flange(joints) * arm.flange_from_tool;
        let at = |by: f64| {
            let mut joints = arm.start;
            joints.0[1] += by;
            Point { joints, pose: forward(&joints) }
        };
        let points: Vec<Point> = (0..=10).map(|i| at(0.02 * f64::from(i))).collect();
        let led = (0..=100).map(|i| arm.world_from_base * at(2e-3 * f64::from(i)).pose);
        let led: Vec<_> = led.map(|pose| pose.translation.vector).collect();
        let keys = Keys { file: "w.toml".to_owned(), ..Keys::default() };
        let judged = |points: &[Point]| {
            let text = Way { arm: arm.name.clone(), points: points.to_vec() }.text(false);
            taught(&led, Some(&Document { path: "w.toml".into(), text }), &arm, &keys)
        };

        let good = judged(&points);
        assert!(good.right, "{}", good.words);
        let mut reversed = points.clone();
        reversed.reverse();
        let mut aside = points.clone();
        aside[5].pose.translation.vector.z += 0.02;
        for wrong in [&reversed[..], &aside, &points[..8]] {
            let judgement = judged(wrong);
            assert!(!judgement.right, "{}", judgement.words);
        }
        assert!(!taught(&led, None, &arm, &keys).right, "the file is missing");
    }
}
