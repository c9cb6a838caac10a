//! Entries of a run in its recording: the operator's inputs under the wall clock, servo records,
//! timing.
//!
//! - in: the operator's channels, the sinks of the servo records, the timing of a wall driver
//! - out: entries for the [`Recorder`], and the same inputs for MP

use super::gate::Outer;
use crate::actors::clock::Clock;
use crate::actors::control::Control;
use crate::actors::remote::Introduction;
use crate::emergency_stop::StopSignal;
use crate::hw::driver::{Histogram, RecordSink, Timing};
use crate::operator::Input;
use crate::record::merge;
use crate::record::recorder::{Both, Entry, Recorder};
use std::fmt::Write;
use std::time::Duration;
use tokio::sync::{mpsc, watch};

/// Number of periods of 2 ms between two recorded scenes of the plant: 25 Hz, the rate of `/tf`.
pub(super) const SCENES: u64 = 20;

/// Records that the operator started a run that had waited for this.
pub(super) fn started(recorder: &Recorder) {
    recorder.record(0, || Entry::input(&Input::Start));
}

/// Returns a sink of servo records that passes them to `sink`, and also to `other` if there is one.
pub(super) fn with(
    sink: Box<dyn RecordSink>,
    other: Option<impl RecordSink + 'static>,
) -> Box<dyn RecordSink> {
    match other {
        Some(other) => Box::new(Both(sink, Box::new(other))),
        None => sink,
    }
}

/// Interval at which the emergency stop is read. The stop bypasses all actors, so no actor reports
/// it.
const GLANCE: Duration = Duration::from_millis(4);

/// Records the operator's inputs to a run under the wall clock, each with the period of 2 ms in
/// which it arrived. Takes answers and orders out of `outer` and passes them on to the returned
/// receiver.
pub(super) fn follow(
    outer: Outer,
    clock: Clock,
    recorder: Recorder,
) -> Option<mpsc::Receiver<Input>> {
    let record = move |input: &Input| recorder.record(clock.period(), || Entry::input(input));
    let passed_on = outer.to_task.map(|mut inputs| {
        // One at a time: this task reserves room before it takes an input. So the operator's
        // channel fills up as without it, and the UI refuses further inputs ("the arms are busy").
        let (to, passed_on) = mpsc::channel(1);
        let record = record.clone();
        tokio::spawn(async move {
            while let Ok(place) = to.reserve().await
                && let Some(input) = inputs.recv().await
            {
                record(&input);
                place.send(input);
            }
        });
        passed_on
    });
    tokio::spawn(follow_control(outer.control, outer.stop, record));
    passed_on
}

/// Records each change of the operator's control, and the emergency stop when it is pressed.
async fn follow_control(
    mut control: watch::Receiver<Control>,
    stop: StopSignal,
    record: impl Fn(&Input),
) {
    let (mut was, mut glance) = (false, tokio::time::interval(GLANCE));
    loop {
        let input = tokio::select! {
            changed = control.changed() => match changed {
                Ok(()) => control.borrow_and_update().input(),
                Err(_) => return,
            },
            _ = glance.tick() => {
                // Once for each press: the flag stays until its owner releases it.
                let is = stop.is_pressed();
                let newly = !std::mem::replace(&mut was, is) && is;
                newly.then_some(Input::EmergencyStop)
            }
        };
        if let Some(input) = &input {
            record(input);
        }
    }
}

/// Returns the entry by which the recordings of all nodes of a run belong together. `name` is that
/// of the node, empty for MP's.
pub(super) fn node(name: &str, introduction: &Introduction) -> Entry {
    let Introduction { run, scenario, .. } = introduction;
    let facts = [
        (merge::NODE, name.to_owned()),
        (merge::RUN, format!("{run:016x}")),
        (merge::SCENARIO, format!("{scenario:08x}")),
    ];
    Entry::Facts(merge::OF_NODE, facts.map(|(name, value)| (name.to_owned(), value)).to_vec())
}

/// Returns the timing of the servo as an entry of the recording: each histogram as words
/// `nanoseconds:count` in rising order.
pub(super) fn timing(timing: &Timing) -> Entry {
    let classes = |histogram: &Histogram| {
        let mut text = String::new();
        for (nanos, count) in histogram.classes() {
            // Writing to a string cannot fail.
            let _ = write!(text, "{nanos}:{count} ");
        }
        text
    };
    let facts = [
        ("wake_up_ns", classes(&timing.wake_up)),
        ("jitter_ns", classes(&timing.jitter)),
        ("work_ns", classes(&timing.work)),
        ("missed", timing.missed.to_string()),
        ("missed_in_a_row", timing.missed_in_a_row.to_string()),
        ("late_readings", timing.late_readings.to_string()),
    ];
    Entry::Facts("timing", facts.map(|(name, value)| (name.to_owned(), value)).to_vec())
}
