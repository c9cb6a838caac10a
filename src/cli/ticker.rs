//! Live line of a run on the terminal: time, phase, step of the plan, time left, force.
//!
//! - in: the snapshots at the desk
//! - out: the live line of the console, drawn at most five times a second
//!
//! The time left is that of the plan's own steps, scaled by how long the steps until now took.

use super::progress::{Drawing, REDRAW};
use crate::desk::UiEnd;
use crate::hw::console;
use crate::hw::text::shortened;
use crate::operator::{ControlView, PlanLine, Snapshot};
use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Instant;

/// Least planned time of the steps that are done before they scale the time left (s).
const SETTLED: f64 = 10.0;
/// Bounds of that scale: a single step that takes long must not decide.
const SCALES: (f64, f64) = (0.5, 3.0);

/// Starts to show the run of `desk` until the drawing is dropped.
pub(super) fn start(desk: UiEnd) -> Drawing {
    let (begun, mut estimate) = (Instant::now(), Estimate::default());
    Drawing::start(REDRAW, move || {
        let snapshot = desk.snapshots.borrow().clone();
        let (waited, seconds) = (begun.elapsed().as_secs_f64(), estimate.left(&snapshot));
        line(&snapshot, seconds, waited, usize::from(console::columns()))
    })
}

/// Estimate of the time left in a plan.
#[derive(Debug, Default)]
struct Estimate {
    plan: Arc<Vec<PlanLine>>,
    /// Step and time (s) at which the plan was first seen.
    first: (usize, f64),
    /// Current step, and the time (s) at which it was first seen.
    current: (usize, f64),
}

impl Estimate {
    /// Returns the time (s) until the end of the plan; `None` while no step of it is carried out.
    fn left(&mut self, snapshot: &Snapshot) -> Option<f64> {
        let step = snapshot.step.filter(|step| *step < snapshot.plan.len())?;
        let now = (step, snapshot.time);
        // After a failure the task makes a new plan.
        if !Arc::ptr_eq(&self.plan, &snapshot.plan) || step < self.current.0 {
            *self = Self { plan: Arc::clone(&snapshot.plan), first: now, current: now };
        } else if step > self.current.0 {
            self.current = now;
        }
        let planned = |lines: &[PlanLine]| lines.iter().map(|line| line.seconds).sum::<f64>();
        let done = planned(&self.plan[self.first.0..step]);
        let took = self.current.1 - self.first.1;
        let scale = if done < SETTLED { 1.0 } else { (took / done).clamp(SCALES.0, SCALES.1) };
        let spent = (snapshot.time - self.current.1).min(scale * self.plan[step].seconds);
        Some((scale * planned(&self.plan[step..]) - spent).max(0.0))
    }
}

/// Returns the line for a snapshot in at most `columns` columns. `left` is the time until the end
/// of the plan (s), `waited` the time since the program began (s).
fn line(snapshot: &Snapshot, left: Option<f64>, waited: f64, columns: usize) -> String {
    // The outcome is told by the summary.
    if snapshot.outcome.is_some() || snapshot.control == ControlView::Ended {
        return String::new();
    }
    // No snapshot is there while tables are read and cameras are calibrated.
    if snapshot.number == 0 {
        return format!("           the run is being prepared, {waited:.0} s");
    }
    let head = format!("{:9.2} s  {}", snapshot.time, state(snapshot));
    let all = snapshot.plan.len();
    let step = snapshot.step.filter(|step| *step < all);
    let what = step
        .map(|step| (format!(", step {} of {all}: ", step + 1), snapshot.plan[step].what.as_str()));
    let mut tail = String::new();
    // Writing to a string cannot fail.
    if let Some(left) = left {
        let _ = write!(tail, "  {left:.0} s left");
    }
    let force = |wrench: &[f64; 6]| wrench[..3].iter().map(|f| f * f).sum::<f64>().sqrt();
    if let Some(force) = snapshot.arms.iter().map(|arm| force(&arm.wrench)).reduce(f64::max) {
        let _ = write!(tail, "  {force:4.1} N");
    }
    // The words of the step are shortened: the numbers after them must stay visible.
    let Some((step, words)) = what else { return head + &tail };
    let room = columns.saturating_sub(head.len() + step.len() + tail.len() + 1);
    format!("{head}{step}{}{tail}", shortened(words, room))
}

/// Returns the phase of a run, or the reason why it does not go on.
fn state(snapshot: &Snapshot) -> &str {
    match snapshot.control {
        _ if snapshot.question.is_some() => "the robot asks: answer at its page",
        ControlView::Waiting => "waits for the start: s and Enter",
        ControlView::Paused => "paused: r and Enter resume",
        ControlView::Terminated => "the arms come to rest",
        ControlView::Running | ControlView::Ended => &snapshot.phase,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a snapshot in a step of a plan of four steps of 10 s each.
    fn at(step: usize, time: f64, plan: &Arc<Vec<PlanLine>>) -> Snapshot {
        Snapshot {
            number: 1,
            time,
            step: Some(step),
            plan: Arc::clone(plan),
            control: ControlView::Running,
            phase: "solve".into(),
            ..Snapshot::default()
        }
    }

    /// Returns a plan of four steps of 10 s each.
    fn plan() -> Arc<Vec<PlanLine>> {
        let line = |n| PlanLine { what: format!("turn {n}"), why: String::new(), seconds: 10.0 };
        Arc::new((1..=4).map(line).collect())
    }

    #[test]
    fn time_left_is_scaled_by_steps_done() {
        let (plan, mut estimate) = (plan(), Estimate::default());

        assert_eq!(estimate.left(&at(0, 100.0, &plan)), Some(40.0));
        assert_eq!(estimate.left(&at(0, 104.0, &plan)), Some(36.0));
        // The first step took twice its time, so the three others are expected to.
        assert_eq!(estimate.left(&at(1, 120.0, &plan)), Some(60.0));
        assert_eq!(estimate.left(&at(1, 130.0, &plan)), Some(50.0));
        // A step that takes longer than expected leaves the others.
        assert_eq!(estimate.left(&at(3, 400.0, &plan)), Some(30.0));
        assert_eq!(estimate.left(&at(3, 500.0, &plan)), Some(0.0));
        assert_eq!(estimate.left(&at(4, 510.0, &plan)), None);
    }

    #[test]
    fn new_plan_begins_a_new_estimate() {
        let mut estimate = Estimate::default();
        let first = plan();
        estimate.left(&at(0, 0.0, &first));
        estimate.left(&at(2, 60.0, &first));

        assert_eq!(estimate.left(&at(0, 90.0, &plan())), Some(40.0));
    }

    #[test]
    fn line_shows_step_and_keeps_numbers_when_narrow() {
        let mut plan = (*plan()).clone();
        plan[1].what = "track turns R' while postument holds the cube".to_owned();
        let snapshot = at(1, 83.4, &Arc::new(plan));

        let wide = line(&snapshot, Some(61.6), 0.0, 120);
        let narrow = line(&snapshot, Some(61.6), 0.0, 60);

        let words = "solve, step 2 of 4: track turns R' while postument holds the cube";
        assert_eq!(wide, format!("    83.40 s  {words}  62 s left"));
        assert_eq!(narrow, "    83.40 s  solve, step 2 of 4: track turns R'…  62 s left");
    }

    #[test]
    fn line_names_reason_for_standing_still() {
        let text = |snapshot: &Snapshot| line(snapshot, None, 3.0, 80);
        let mut snapshot = at(0, 1.0, &Arc::default());

        assert_eq!(text(&Snapshot::default()), "           the run is being prepared, 3 s");
        assert_eq!(text(&snapshot), "     1.00 s  solve");
        snapshot.control = ControlView::Paused;
        assert!(text(&snapshot).contains("paused"), "{}", text(&snapshot));
        snapshot.control = ControlView::Ended;
        assert_eq!(text(&snapshot), "");
    }
}
