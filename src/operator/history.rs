//! History of a run for a user interface that comes late: the course of each arm's values, and the
//! spans of time in which something was so.
//!
//! - in: the snapshots, one after the other
//! - out: [`Point`]s, at most [`POINTS`], with the peaks of all snapshots; [`Span`]s, of which a
//!   user interface asks for those that have changed

use super::{ArmView, Class, ControlView, Snapshot};
use crate::motion::AXES;
use serde::Serialize;

/// Most points that are kept. When they are full, two neighbours become one.
const POINTS: usize = 2048;
/// Time that a point covers at first (s).
const WIDTH: f64 = 0.1;
/// Most spans that are kept; a run of hours has fewer.
const SPANS: usize = 16_384;

/// Values of all arms over a short time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Point {
    /// Time of the last snapshot in the point (s).
    pub time: f64,
    /// Values of each arm, in the order of the snapshots.
    pub arms: Vec<ArmPoint>,
}

/// Values of an arm over a short time, named as in [`ArmView`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ArmPoint {
    /// Largest norms of force (N) and torque (Nm).
    pub peak: (f64, f64),
    /// Largest distance between set and measured place of the tool (m).
    pub following: f64,
    /// Last wrench on the surroundings: force (N), torque (Nm).
    pub wrench: [f64; 6],
    /// Last gripping force (N).
    pub grip: f64,
    /// Last distance between the pads (m).
    pub opening: f64,
    /// Last joints (m, rad).
    pub joints: [f64; AXES],
}

/// Row of a timeline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Lane {
    /// Phase of the task.
    Phase,
    /// Step of the plan.
    Step,
    /// Holder of the cube.
    Holder,
    /// Pause by the operator.
    Pause,
    /// Question to the operator.
    Question,
    /// Message; it has no length.
    Message,
}

/// A time in which something was so.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Span {
    /// Row of the timeline.
    pub lane: Lane,
    /// Beginning (s).
    pub from: f64,
    /// End (s); `None` while it goes on.
    pub to: Option<f64>,
    /// Phase, step, holder, question or message in words.
    pub words: String,
    /// Severity of a message.
    pub class: Option<Class>,
    /// Number of the change that has made or ended the span.
    #[serde(skip)]
    changed: u64,
}

/// The history of one run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct History {
    points: Vec<Point>,
    /// Number of the last point in steps of the present width.
    last: i64,
    /// How often two neighbours became one.
    halved: i32,
    spans: Vec<Span>,
    /// Index of the open span of each lane.
    open: [Option<usize>; 6],
    /// Number of the last change of the spans.
    changes: u64,
    /// Number of phases, and of the last message, that were seen.
    seen: (usize, u64),
    /// Whether this is the history of a whole recording, which no snapshot changes.
    whole: bool,
}

impl History {
    /// Takes a snapshot into the history.
    pub fn take(&mut self, snapshot: &Snapshot) {
        if self.whole {
            return;
        }
        self.take_point(snapshot);
        self.take_phases(snapshot);
        let time = snapshot.time;
        let ended = snapshot.control == ControlView::Ended;
        let step = snapshot.step.and_then(|step| snapshot.plan.get(step));
        let question = snapshot.question.as_ref().map(|question| question.text.as_str());
        let paused = (snapshot.control == ControlView::Paused).then_some("paused");
        let with = Some(snapshot.cube.with.as_str()).filter(|with| !with.is_empty());
        for (lane, words) in [
            (Lane::Step, step.map(|step| step.what.as_str())),
            (Lane::Holder, with),
            (Lane::Pause, paused),
            (Lane::Question, question),
        ] {
            self.is(lane, words.filter(|_| !ended), time);
        }
        if ended {
            self.is(Lane::Phase, None, time);
        }
        self.take_messages(snapshot);
    }

    /// Returns the history as that of a whole recording: later snapshots do not change it.
    #[must_use]
    pub fn finished(self) -> Self {
        Self { whole: true, ..self }
    }

    /// Checks whether this is the history of a whole recording.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.whole
    }

    /// Returns the points, oldest first.
    #[must_use]
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// Returns the number of the last change of the spans; 0 before the first.
    #[must_use]
    pub fn changes(&self) -> u64 {
        self.changes
    }

    /// Returns the spans that have changed since the change number `since`, each with its index.
    pub fn spans_since(&self, since: u64) -> impl Iterator<Item = (usize, &Span)> {
        self.spans.iter().enumerate().filter(move |(_, span)| span.changed > since)
    }

    /// Takes the values of the arms into the last point, or into a new one.
    fn take_point(&mut self, snapshot: &Snapshot) {
        let arms: Vec<_> = snapshot.arms.iter().map(ArmPoint::of).collect();
        let point = Point { time: rounded(snapshot.time), arms };
        let place = self.place(point.time);
        match self.points.last_mut() {
            Some(last) if place <= self.last && last.arms.len() == point.arms.len() => {
                last.merge(&point);
            }
            _ => self.points.push(point),
        }
        self.last = place;
        if self.points.len() > POINTS {
            self.halve();
        }
    }

    /// Returns the number of a time in steps of the present width.
    fn place(&self, time: f64) -> i64 {
        (time / (WIDTH * f64::exp2(f64::from(self.halved)))).floor() as i64
    }

    /// Makes each point twice as long.
    fn halve(&mut self) {
        self.halved += 1;
        let all = std::mem::take(&mut self.points);
        let mut last = None;
        for point in all {
            let place = self.place(point.time);
            match self.points.last_mut() {
                Some(kept) if last == Some(place) => kept.merge(&point),
                _ => self.points.push(point),
            }
            last = Some(place);
        }
        self.last = last.unwrap_or_default();
    }

    /// Takes the phases that are new.
    fn take_phases(&mut self, snapshot: &Snapshot) {
        for (name, at) in snapshot.phases.iter().skip(self.seen.0) {
            self.is(Lane::Phase, Some(name), *at);
        }
        self.seen.0 = self.seen.0.max(snapshot.phases.len());
    }

    /// Takes the warnings, the errors and the inputs of the operator that are new.
    fn take_messages(&mut self, snapshot: &Snapshot) {
        let had = self.seen.1;
        for message in snapshot.messages.iter().filter(|message| message.number > had) {
            let told = message.class > Class::Info || message.text.starts_with("operator: ");
            if told {
                self.push(Lane::Message, message.time, &message.text, Some(message.class));
            }
        }
        if let Some(last) = snapshot.messages.last() {
            self.seen.1 = self.seen.1.max(last.number);
        }
    }

    /// Ends the open span of a lane if its words are others, and opens one with these words.
    fn is(&mut self, lane: Lane, words: Option<&str>, time: f64) {
        let open = self.open[lane as usize];
        let had = open.map(|index| self.spans[index].words.as_str());
        if had == words {
            return;
        }
        if let Some(index) = open {
            self.changes += 1;
            let span = &mut self.spans[index];
            span.to = Some(rounded(time));
            span.changed = self.changes;
        }
        self.open[lane as usize] = words.and_then(|words| self.push(lane, time, words, None));
    }

    /// Adds a span and returns its index; `None` if there are too many. One of a message has no
    /// length.
    fn push(&mut self, lane: Lane, from: f64, words: &str, class: Option<Class>) -> Option<usize> {
        if self.spans.len() >= SPANS {
            return None;
        }
        self.changes += 1;
        let from = rounded(from);
        let to = (lane == Lane::Message).then_some(from);
        let words = words.to_owned();
        self.spans.push(Span { lane, from, to, words, class, changed: self.changes });
        Some(self.spans.len() - 1)
    }
}

impl Point {
    /// Takes a later point into this one.
    fn merge(&mut self, later: &Self) {
        self.time = later.time;
        for (arm, later) in self.arms.iter_mut().zip(&later.arms) {
            *arm = ArmPoint {
                peak: (arm.peak.0.max(later.peak.0), arm.peak.1.max(later.peak.1)),
                following: arm.following.max(later.following),
                ..*later
            };
        }
    }
}

impl ArmPoint {
    /// Returns the values of an arm in a snapshot, rounded for a short text.
    fn of(arm: &ArmView) -> Self {
        Self {
            peak: (rounded(arm.peak.0), rounded(arm.peak.1)),
            following: rounded(arm.following * 1e3) * 1e-3,
            wrench: arm.wrench.map(rounded),
            grip: rounded(arm.grip),
            opening: rounded(arm.opening),
            joints: arm.joints.map(rounded),
        }
    }
}

/// Returns a value rounded to four decimals.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operator::{CubeView, Message, OutcomeView, PlanLine};
    use std::sync::Arc;

    /// Returns a snapshot of one arm at a time (s) with this peak of its force (N).
    fn at(time: f64, force: f64) -> Snapshot {
        let arm = ArmView {
            name: "track".to_owned(),
            joints: [time; AXES],
            motors: [0.0; AXES],
            frames: Vec::new(),
            opening: 0.06,
            grip: 40.0,
            wrench: [0.0; 6],
            peak: (force, 0.0),
            following: 0.0,
            synchronised: true,
            fault: None,
            remedy: None,
        };
        Snapshot { time, arms: vec![arm], control: ControlView::Running, ..Snapshot::default() }
    }

    #[test]
    fn long_run_keeps_its_peaks_in_few_points() {
        let mut history = History::default();
        for i in 0..100_000 {
            history.take(&at(f64::from(i) * 0.05, if i == 40_000 { 55.0 } else { 1.0 }));
        }

        let points = history.points();
        assert!((POINTS / 2..=POINTS).contains(&points.len()), "{}", points.len());
        let high: Vec<f64> =
            points.iter().filter(|p| p.arms[0].peak.0 > 2.0).map(|p| p.time).collect();
        assert!(high.len() == 1 && (high[0] - 2000.0).abs() < 5.0, "{high:?}");
        assert!(points.windows(2).all(|pair| pair[0].time < pair[1].time));
        assert!((points[points.len() - 1].time - 4999.95).abs() < 1e-9);
    }

    #[test]
    fn spans_follow_phases_steps_holders_and_pauses() {
        let line = |what: &str| PlanLine { what: what.into(), why: String::new(), seconds: 1.0 };
        let told = |number, class, text: &str| Message {
            number,
            time: 2.5,
            class,
            source: "ui".into(),
            text: text.into(),
        };
        let with = |with: &str| CubeView { with: with.into(), ..CubeView::default() };
        let start = Snapshot {
            phases: vec![("acquire".into(), 0.0)],
            plan: Arc::new(vec![line("turn R"), line("turn U")]),
            cube: with("in the operator's hand"),
            ..at(0.1, 0.0)
        };
        let mut phases = start.phases.clone();
        phases.push(("solve".into(), 1.25));
        let turns = Snapshot {
            time: 2.0,
            phases: phases.clone(),
            step: Some(0),
            cube: with("held by track"),
            ..start.clone()
        };
        let messages = vec![
            told(1, Class::Info, "a note"),
            told(2, Class::Info, "operator: pause"),
            told(3, Class::Warning, "the cube slips"),
        ];
        let paused = Snapshot {
            time: 3.0,
            control: ControlView::Paused,
            step: Some(1),
            messages: Arc::new(messages),
            ..turns.clone()
        };
        let over = OutcomeView {
            verdict: "solved".into(),
            good: true,
            reason: String::new(),
            time: None,
            figures: Vec::new(),
        };
        let ended = Snapshot {
            time: 4.0,
            control: ControlView::Ended,
            outcome: Some(over),
            ..paused.clone()
        };
        let mut history = History::default();
        for snapshot in [&start, &turns, &turns, &paused] {
            history.take(snapshot);
        }
        let before = history.changes();
        history.take(&ended);

        let seen = |lane: Lane| -> Vec<(&str, f64, Option<f64>)> {
            let spans = history.spans_since(0).map(|(_, span)| span).filter(|s| s.lane == lane);
            spans.map(|span| (span.words.as_str(), span.from, span.to)).collect()
        };
        assert_eq!(seen(Lane::Phase), [("acquire", 0.0, Some(1.25)), ("solve", 1.25, Some(4.0))]);
        assert_eq!(seen(Lane::Step), [("turn R", 2.0, Some(3.0)), ("turn U", 3.0, Some(4.0))]);
        let holders =
            [("in the operator's hand", 0.1, Some(2.0)), ("held by track", 2.0, Some(4.0))];
        assert_eq!(seen(Lane::Holder), holders);
        assert_eq!(seen(Lane::Pause), [("paused", 3.0, Some(4.0))]);
        let events = [("operator: pause", 2.5, Some(2.5)), ("the cube slips", 2.5, Some(2.5))];
        assert_eq!(seen(Lane::Message), events);
        let changed: Vec<_> = history.spans_since(before).map(|(_, s)| s.words.clone()).collect();
        assert_eq!(changed, ["solve", "held by track", "turn U", "paused"]);
    }

    #[test]
    fn whole_history_takes_no_snapshot() {
        let mut history = History::default();
        history.take(&at(1.0, 5.0));
        let mut whole = history.finished();

        whole.take(&at(2.0, 9.0));

        assert_eq!(whole.points().len(), 1);
    }
}
