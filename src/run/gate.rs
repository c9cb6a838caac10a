//! The gate between the operator and a run on the virtual clock: what the operator wants counts from the beginning of a
//! period on, and never in the middle of one. So a run is repeatable from its inputs, the operator's among them.
//!
//! - in: the operator's will, words and emergency stop, whenever they come; or those of a recording
//! - out: the same, once a period, called by the driver; and a note of each for the recording

use crate::actors::control::{Control, Word};
use crate::operator::Said;
use crate::record::playback::Playback;
use crate::record::recorder::{Entry, Recorder};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::sync::{mpsc, watch};

/// The gate.
pub(super) struct Gate {
    /// Outside: the operator's.
    will: watch::Receiver<Control>,
    pressed: Arc<AtomicBool>,
    words: Option<mpsc::Receiver<Word>>,
    /// Inside: the run's.
    inner: Inner,
    recorder: Recorder,
    playback: Option<Playback>,
}

/// What the run sees.
pub(super) struct Inner {
    /// The operator's will.
    pub(super) control: Arc<watch::Sender<Control>>,
    /// The emergency stop.
    pub(super) emergency: Arc<AtomicBool>,
    /// Answers and orders.
    pub(super) words: mpsc::Sender<Word>,
}

impl Gate {
    pub(super) fn new(
        will: watch::Receiver<Control>,
        pressed: Arc<AtomicBool>,
        words: Option<mpsc::Receiver<Word>>,
        inner: Inner,
        (recorder, playback): (Recorder, Option<Playback>),
    ) -> Self {
        Self { will, pressed, words, inner, recorder, playback }
    }

    /// At the end of a period, numbered in periods of 2 ms.
    pub(super) fn pass(&mut self, period: u64) {
        let mut passed = Vec::new();
        if let Some(playback) = &self.playback {
            while let Some(text) = playback.operator(period) {
                match serde_json::from_str(&text) {
                    Ok(word) => passed.push(word),
                    Err(error) => tracing::warn!("{text}: {error}"),
                }
            }
            // Whoever watches a replay may still break it off.
            if *self.will.borrow() == Control::Terminated {
                self.inner.control.send_replace(Control::Terminated);
            }
        } else {
            if self.pressed.load(Ordering::Acquire) && !self.inner.emergency.load(Ordering::Relaxed)
            {
                passed.push(Said::EmergencyStop);
            }
            let will = *self.will.borrow();
            if will != *self.inner.control.borrow() {
                passed.extend(match will {
                    Control::Running => Some(Said::Run),
                    Control::Paused => Some(Said::Pause),
                    Control::Terminated => Some(Said::Terminate),
                    Control::Waiting => None,
                });
            }
            while self.inner.words.capacity() > passed.len()
                && let Some(word) = self.words.as_mut().and_then(|words| words.try_recv().ok())
            {
                passed.push(word.into());
            }
        }
        for word in passed {
            self.recorder
                .note(period, || Entry::Operator(serde_json::to_string(&word).unwrap_or_default()));
            self.inner.take(word);
        }
    }
}

impl From<Word> for Said {
    fn from(word: Word) -> Self {
        match word {
            Word::Answer(question, answer) => Self::Answer { question, answer },
            Word::Order(effector, order) => Self::Order { effector, order },
        }
    }
}

impl Inner {
    fn take(&self, word: Said) {
        match word {
            // Whoever hears it has begun: before the start there is no period.
            Said::Start => {}
            Said::Run => drop(self.control.send_replace(Control::Running)),
            Said::Pause => drop(self.control.send_replace(Control::Paused)),
            Said::Terminate => drop(self.control.send_replace(Control::Terminated)),
            Said::EmergencyStop => self.emergency.store(true, Ordering::Release),
            // There is room: it was asked for, and so it was when it was recorded.
            Said::Answer { question, answer } => {
                let _ = self.words.try_send(Word::Answer(question, answer));
            }
            Said::Order { effector, order } => {
                let _ = self.words.try_send(Word::Order(effector, order));
            }
        }
    }
}
