//! What the actors tell a recorder: notices, the operator's will under the wall clock, servo records, timing.

use crate::actors::clock::Clock;
use crate::actors::control::{Control, Word};
use crate::hw::driver::{Histogram, RecordSink, Timing};
use crate::operator::Said;
use crate::record::playback::Playback;
use crate::record::recorder::{Both, Entry, Recorder};
use std::fmt::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::{mpsc, watch};

/// Periods of 2 ms between two views of the plant's cube: the rate of `/tf`.
pub(super) const SCENES: u64 = 20;

/// Keeps the operator's start, for which a run has waited.
pub(super) fn started(recorder: &Recorder) {
    let text = || serde_json::to_string(&Said::Start).unwrap_or_default();
    recorder.note(0, || Entry::Operator(text()));
}

/// Servo records go to the recorder, too.
pub(super) fn kept(sink: Box<dyn RecordSink>, recorder: &Recorder) -> Box<dyn RecordSink> {
    match recorder.ticks() {
        Some(ticks) => Box::new(Both(sink, Box::new(ticks))),
        None => sink,
    }
}

/// They are held against a recording, too.
pub(super) fn with_playback(
    sink: Box<dyn RecordSink>,
    playback: Option<Playback>,
) -> Box<dyn RecordSink> {
    match playback {
        Some(playback) => Box::new(Both(sink, Box::new(playback))),
        None => sink,
    }
}

/// The emergency stop goes past all actors; whoever notes it looks at this interval.
const GLANCE: Duration = Duration::from_millis(4);

/// Keeps what the operator says of a run under the wall clock, in the period in which it was heard; the words go on to
/// whoever takes the end that this returns. When exactly the arms heed them is in their records.
pub(super) fn follow(
    mut will: watch::Receiver<Control>,
    pressed: Arc<AtomicBool>,
    words: Option<mpsc::Receiver<Word>>,
    clock: Clock,
    recorder: Recorder,
) -> Option<mpsc::Receiver<Word>> {
    let heard = move |said: &Said| {
        let text = serde_json::to_string(said).unwrap_or_default();
        recorder.note(clock.period(), || Entry::Operator(text));
    };
    let on = words.map(|mut words| {
        // One at a time: whoever finds the far end full is told that the arms are busy.
        let (to, on) = mpsc::channel(1);
        let heard = heard.clone();
        tokio::spawn(async move {
            while let Ok(place) = to.reserve().await
                && let Some(word) = words.recv().await
            {
                heard(&Said::from(word.clone()));
                place.send(word);
            }
        });
        on
    });
    tokio::spawn(async move {
        let (mut was, mut glance) = (false, tokio::time::interval(GLANCE));
        loop {
            let said = tokio::select! {
                changed = will.changed() => match changed.map(|()| *will.borrow_and_update()) {
                    Ok(Control::Running) => Said::Run,
                    Ok(Control::Paused) => Said::Pause,
                    Ok(Control::Terminated) => Said::Terminate,
                    Ok(Control::Waiting) => continue,
                    Err(_) => break,
                },
                _ = glance.tick() => {
                    let is = pressed.load(Ordering::Acquire);
                    let before = std::mem::replace(&mut was, is);
                    if before || !is {
                        continue;
                    }
                    Said::EmergencyStop
                }
            };
            heard(&said);
        }
    });
    on
}

/// How punctual the servo was: each histogram as `nanoseconds:count` in rising order.
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
