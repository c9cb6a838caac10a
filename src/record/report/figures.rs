//! Table that compares the figures of a run with those of the paper by Zieliński et al. (2007, pp.
//! 370-375).
//!
//! | figure | source in the recording |
//! |---|---|
//! | servo period | `period_ns`; on the wall clock also the jitter of the timing |
//! | visual servo period | median time between two looks of the stand-alone camera |
//! | localisation | error against the plant that 95 % of looks at a resting cube do not exceed |
//! | reading one face | median of the measured times |
//! | solution and plan | phase "plan" |
//! | grasping and turning one face | phases of manipulation, divided by the turns |
//! | whole run | summary |

use super::classes::{classes, quantile};
use super::story::Story;
use crate::record::calibration;
use nalgebra::{Point3, Vector3};

/// Largest speed of a cube that counts as resting (m/s). It is not 0, since the hand of the person
/// who holds the cube trembles.
const REST: f64 = 0.01;

/// Row of the table.
pub(super) struct Figure {
    /// Name of the figure.
    pub what: &'static str,
    /// Value in the paper.
    pub paper: &'static str,
    /// Value in this run.
    pub here: String,
    /// Remark on how the value of this run was found.
    pub remark: String,
}

/// Returns the rows of the table that compares a run with the paper of 2007. A row for which the
/// recording has no data is left out.
pub(super) fn figures(story: &Story) -> Vec<Figure> {
    [
        Some(servo_period(story)),
        visual_servo_period(story),
        localised(story),
        reading(story),
        planning(story),
        turning(story),
        whole_run(story),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Checks whether the run was paced by the wall clock.
fn is_real_time(story: &Story) -> bool {
    story.label.fact("pace") == "real-time"
}

/// Returns the row of the servo period (ms), with its jitter if the wall clock paced the run.
fn servo_period(story: &Story) -> Figure {
    let label = &story.label;
    let period_ms = number(label.fact("period_ns")) * 1e-6;
    let remark = if is_real_time(story) {
        let jitter = quantile(&classes(label.of("timing", "jitter_ns")), 0.99);
        format!(
            "by the wall clock; 99 % of periods within {:.0} us of it, {} missed",
            jitter as f64 * 1e-3,
            or(label.of("timing", "missed"), "?")
        )
    } else {
        "virtual clock: exact by construction".to_owned()
    };
    Figure { what: "servo period", paper: "2 ms", here: format!("{period_ms} ms"), remark }
}

/// Returns the row of the time between two looks of the stand-alone camera (ms); `None` for fewer
/// than two looks.
fn visual_servo_period(story: &Story) -> Option<Figure> {
    // A median, since the camera pauses between two phases of tracking.
    let mut steps: Vec<u64> = story.looks.windows(2).map(|w| w[1].saturating_sub(w[0])).collect();
    steps.sort_unstable();
    let step = steps.get(steps.len() / 2)?;
    Some(Figure {
        what: "visual servo period",
        paper: "40 ms",
        here: format!("{} ms", step.saturating_mul(2)),
        remark: format!("median of {} looks of the stand-alone camera", story.looks.len()),
    })
}

/// Returns the row of the errors of localisation (mm); `None` if [`localisation`] has too few data.
fn localised(story: &Story) -> Option<Figure> {
    let (count, across, along) = localisation(story)?;
    Some(Figure {
        what: "localisation, across and along the camera's axis",
        paper: "\u{b1}1 mm, \u{b1}5 mm",
        here: format!("\u{b1}{across:.1} mm, \u{b1}{along:.1} mm"),
        remark: format!(
            "95 % of {count} looks at the cube at rest, compared with the plant, about their mean; \
             the paper at 100x100 px"
        ),
    })
}

/// Returns the row of the time to read one face (ms); `None` if no face was read.
fn reading(story: &Story) -> Option<Figure> {
    let read = story.faces.iter().filter(|(_, _, why)| why.is_none()).count();
    if read == 0 {
        return None;
    }
    let label = &story.label;
    // On the virtual clock a reading takes the time that the scenario declares. This is no
    // measurement, so without one the value is a dash.
    let looks = format!("{read} of {} looks read a face", story.faces.len());
    let measured = number(label.of("vision", "face_median_s")) * 1e3;
    let how = match (measured.is_nan(), is_real_time(story)) {
        (true, _) => "not measured in this run".to_owned(),
        (false, true) => "the median, by the wall clock".to_owned(),
        (false, false) => format!(
            "the median, by the wall clock; on the run's own, virtual one {} ms were declared",
            number(label.fact("declared_face_s")) * 1e3
        ),
    };
    Some(Figure {
        what: "reading one face",
        paper: "10 ms",
        here: if measured.is_nan() { "-".to_owned() } else { format!("{measured:.2} ms") },
        remark: format!("{looks}; {how}"),
    })
}

/// Returns the row of the time to solve the cube and to plan (s); `None` if the run did not plan or
/// the recording has no summary.
fn planning(story: &Story) -> Option<Figure> {
    let phases = &story.summary.as_ref()?.phases;
    let plan = phases.iter().find(|p| p.name.starts_with("plan"))?;
    // On the virtual clock planning takes a declared time; the wall-clock time is the measured one.
    let time = if is_real_time(story) { plan.sim_time_s } else { plan.wall_time_s };
    Some(Figure {
        what: "solution and plan",
        paper: "solution 0.1-10 s, planning < 20 s",
        here: format!("{time:.2} s"),
        remark: "both together, on this machine, by the wall clock".to_owned(),
    })
}

/// Returns the row of the time per turn (s); `None` if no turn was made or the recording has no
/// summary.
fn turning(story: &Story) -> Option<Figure> {
    let summary = story.summary.as_ref().filter(|summary| summary.turns > 0)?;
    let manipulates = |name: &str| ["grasp", "solve", "turn", "release"].contains(&name);
    let phases = summary.phases.iter().filter(|p| manipulates(&p.name));
    let time: f64 = phases.map(|p| p.sim_time_s).sum();
    Some(Figure {
        what: "grasping and turning one face",
        paper: "about 120 s",
        here: format!("{:.1} s", time / f64::from(summary.turns)),
        remark: format!(
            "{time:.0} s for {} turns with {} grasps; in the paper in slow motion, for safety",
            summary.turns, summary.grasps
        ),
    })
}

/// Returns the row of the time of the whole run (s); `None` if the recording has no summary.
fn whole_run(story: &Story) -> Option<Figure> {
    let summary = story.summary.as_ref()?;
    Some(Figure {
        what: "whole run",
        paper: "-",
        here: format!("{:.1} s", summary.sim_time_s),
        remark: format!("{:.1} times real time", summary.real_time_factor()),
    })
}

/// Returns `text`, or `otherwise` if it is empty.
fn or<'a>(text: &'a str, otherwise: &'a str) -> &'a str {
    if text.is_empty() { otherwise } else { text }
}

/// Parses a number; NaN if the text is none.
fn number(text: &str) -> f64 {
    text.parse().unwrap_or(f64::NAN)
}

/// Returns the number of looks at a resting cube, and the errors across and along the line of sight
/// that 95 % of them do not exceed (mm). `None` for fewer than 10 looks.
fn localisation(story: &Story) -> Option<(usize, f64, f64)> {
    // Position of the camera as the controller believed it (m): the result of a calibration, or
    // that of the scenario.
    let found = story.label.of(calibration::NAME, "standalone_xyz");
    let eye = or(found, story.label.fact("standalone_xyz"));
    let eye: Vec<f64> = eye.split_whitespace().map(number).collect();
    let eye = Point3::new(*eye.first()?, *eye.get(1)?, *eye.get(2)?);
    let errors: Vec<(Vector3<f64>, Vector3<f64>)> = story
        .seen
        .iter()
        .filter_map(|(time, seen)| {
            let axis = (seen - eye).normalize();
            let (place, speed) = truth(story, *time)?;
            (speed < REST).then_some((seen - place, axis))
        })
        .collect();
    if errors.len() < 10 {
        return None;
    }
    // The mean error is taken off: it comes from the pose of the camera, which the scenario
    // disturbs on purpose.
    let mean = errors.iter().map(|e| e.0).sum::<Vector3<f64>>() / errors.len() as f64;
    let (mut across, mut along): (Vec<f64>, Vec<f64>) = errors
        .iter()
        .map(|(error, axis)| {
            let off = error - mean;
            let depth = off.dot(axis);
            ((off - depth * axis).norm() * 1e3, depth.abs() * 1e3)
        })
        .unzip();
    across.sort_by(f64::total_cmp);
    along.sort_by(f64::total_cmp);
    let at = (errors.len() - 1) * 95 / 100;
    Some((errors.len(), across[at], along[at]))
}

/// Returns the true centre of the cube (m) and its speed (m/s) at a time (s), interpolated between
/// the recorded positions before and after that time. `None` if one of them is missing.
fn truth(story: &Story, time: f64) -> Option<(Point3<f64>, f64)> {
    let after = story.cube.partition_point(|(t, _)| *t < time);
    let (b, a) = (story.cube.get(after)?, story.cube.get(after.checked_sub(1)?)?);
    // Two positions may have equal times. The bound prevents a division by zero.
    let passed = (b.0 - a.0).max(1e-9);
    let way = b.1 - a.1;
    Some((a.1 + (time - a.0) / passed * way, way.norm() / passed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantile_adds_counts_from_shortest_time() {
        let classes = [(10, 98), (20, 1), (900, 1)];

        assert_eq!(quantile(&classes, 0.5), 10);
        assert_eq!(quantile(&classes, 0.99), 20);
        assert_eq!(quantile(&classes, 1.0), 900);
        assert_eq!(quantile(&[], 0.5), 0);
    }

    #[test]
    fn unmeasured_face_reading_time_is_a_dash() {
        let mut story = Story::default();
        story.faces.push((1.0, "vsp gs1".into(), None));
        let here = |story: &Story| {
            let all = figures(story);
            all.into_iter().find(|f| f.what == "reading one face").unwrap().here
        };
        let declared = [("declared_face_s".to_owned(), "0.01".to_owned())].into();
        story.label.metadata.insert("rubik_robot".into(), declared);

        assert_eq!(here(&story), "-", "a declared time is no measurement");
        let measured = [("face_median_s".to_owned(), "0.0042".to_owned())].into();
        story.label.metadata.insert("vision".into(), measured);
        assert_eq!(here(&story), "4.20 ms");
    }

    #[test]
    fn localisation_is_compared_with_the_true_cube() {
        let mut story = Story::default();
        let facts = std::collections::BTreeMap::from([("standalone_xyz".into(), "0 0 0".into())]);
        story.label.metadata.insert("rubik_robot".into(), facts);
        for i in 0..100 {
            let t = f64::from(i) * 0.04;
            let slow = 0.005 * t;
            story.cube.push((t, Point3::new(1.0 + slow, 0.0, 0.0)));
            // The errors alternate by 0.5 mm across and 2 mm along the axis; 10 mm along are
            // constant.
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            let (along, across) = (0.010 + 0.002 * sign, 0.0005 * sign);
            story.seen.push((t + 0.02, Point3::new(1.0001 + slow + along, across, 0.0)));
        }

        let (count, across, along) = localisation(&story).unwrap();

        assert_eq!(count, 99, "the last look comes after the last true position");
        assert!((across - 0.5).abs() < 0.05 && (along - 2.0).abs() < 0.1, "{across} {along}");
        // A cube that moves at 15 mm/s is not at rest.
        story.cube.iter_mut().for_each(|(t, place)| place.x += 0.01 * *t);
        assert_eq!(localisation(&story), None);
    }
}
