//! What the actors tell a recorder: notices, the operator's will under the wall clock, servo records, timing.

use super::control::Control;
use super::ui::{Notice, class};
use crate::hw::driver::{Histogram, RecordSink, Timing};
use crate::motion::PERIOD;
use crate::operator::Class;
use crate::record::playback::Playback;
use crate::record::recorder::{Both, Entry, Recorder};
use std::fmt::Write;
use std::time::Instant;
use tokio::sync::watch;

/// Periods of 2 ms between two views of the plant's cube: the rate of `/tf`.
pub(super) const SCENES: u64 = 20;

/// Keeps a notice.
pub(super) fn note(recorder: &Recorder, notice: &Notice) {
    let at = |seconds: f64| (seconds / PERIOD).round() as u64;
    let log = |seconds: f64, level: u8, who: &str, text: &str| {
        recorder.note(at(seconds), || Entry::Log(level, who.to_owned(), text.to_owned()));
    };
    match notice {
        Notice::Phase(time, name) => {
            recorder.note(at(*time), || Entry::Phase(name.clone(), String::new()));
            log(*time, 20, "mp", &format!("phase: {name}"));
        }
        Notice::Note(time, text) => log(*time, 20, "mp", text),
        Notice::Warning(time, text) => log(*time, 30, "mp", text),
        Notice::Error(time, error) => {
            let (class, actor) = class(error);
            let level = match class {
                Class::Info => 20,
                Class::Warning | Class::NonFatal => 30,
                Class::System => 40,
                Class::Fatal => 50,
            };
            log(*time, level, actor, &error.to_string());
        }
        Notice::Over(_) => {}
    }
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

/// Keeps what the operator wants of a run under the wall clock, when it was heard.
pub(super) fn follow(mut will: watch::Receiver<Control>, recorder: Recorder) {
    let begun = Instant::now();
    tokio::spawn(async move {
        while will.changed().await.is_ok() {
            let word = match *will.borrow_and_update() {
                Control::Running => "\"run\"",
                Control::Paused => "\"pause\"",
                Control::Terminated => "\"terminate\"",
                Control::Waiting => continue,
            };
            let period = (begun.elapsed().as_secs_f64() / PERIOD) as u64;
            recorder.note(period, || Entry::Operator(word.to_owned()));
        }
    });
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
