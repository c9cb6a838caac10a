//! Non-fatal events at the bridge to the arms' hardware, for the log.
//!
//! An exchange with the hardware must not wait for the log. It puts notes into a ring buffer, and
//! another thread makes sentences of them. A note that does not fit into the ring is dropped.

use std::collections::BTreeMap;

/// An event with its period and effector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Note {
    /// Servo period.
    pub period: u64,
    /// Index of the effector.
    pub effector: usize,
    /// Kind of the event.
    pub what: NoteKind,
}

/// Kinds of events.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NoteKind {
    /// Missing answer of an axis.
    Missed {
        /// Index of the axis: 0 is the track, 7 the jaw.
        axis: usize,
    },
    /// Answer of an axis that seems to belong to an earlier order.
    Late {
        /// Index of the axis.
        axis: usize,
    },
    /// Missing answers of several axes, or of all of them, at the same time.
    MissedTogether,
    /// Answer of an axis that cannot be true, and was ignored.
    Impossible {
        /// Index of the axis.
        axis: usize,
    },
    /// Missing interrupt of an ISA card.
    NoInterrupt,
    /// Reading of the force sensor that left its range, and was dropped.
    OverRange {
        /// Index of the direction: 0..=2 force along x, y, z of the sensor, 3..=5 torque about
        /// them.
        direction: usize,
        /// Value (N or Nm).
        reading: f64,
    },
    /// Beginning of a silence of the force sensor.
    ForceSilent,
    /// End of a silence of the force sensor.
    ForceBack,
    /// Fault that the force sensor itself reports.
    ForceStatus {
        /// Status word of the sensor.
        status: u32,
    },
    /// Loss of datagrams of the force sensor.
    Lost {
        /// Number of lost datagrams.
        datagrams: u32,
    },
    /// Datagram of the force sensor that came after a later one, and was ignored.
    Reordered,
}

/// The bridge's end of the ring, which never waits.
#[derive(Debug)]
pub struct Notes(Option<rtrb::Producer<Note>>);

/// Number of notes that fit into the ring.
const ROOM: usize = 1024;

/// Creates a ring buffer of notes; returns its sender and its receiver.
#[must_use]
pub fn notes() -> (Notes, rtrb::Consumer<Note>) {
    let (producer, consumer) = rtrb::RingBuffer::new(ROOM);
    (Notes(Some(producer)), consumer)
}

impl Notes {
    /// Makes a sender without a receiver, which drops all notes.
    #[must_use]
    pub fn none() -> Self {
        Self(None)
    }

    /// Puts a note into the ring.
    pub fn push(&mut self, period: u64, effector: usize, what: NoteKind) {
        if let Some(ring) = &mut self.0 {
            let _ = ring.push(Note { period, effector, what });
        }
    }
}

/// Summary of notes in sentences: the first note of a kind at once, later ones as a count every ten
/// seconds.
#[derive(Debug)]
pub struct Digest {
    /// Names of the effectors.
    effectors: Vec<String>,
    /// Kinds by effector and sentence.
    kinds: BTreeMap<(usize, String), Kind>,
    /// Latest period of any note.
    now: u64,
}

/// Notes of one kind about one effector since the last report.
#[derive(Debug, Default)]
struct Kind {
    /// Period of the first note that was not reported yet.
    first: u64,
    /// Number of notes that were not reported yet.
    times: u32,
    /// Period from which on the kind is reported again.
    next: u64,
}

impl Digest {
    /// Periods until a kind is reported again: 10 s.
    const LULL: u64 = 5000;

    /// Makes an empty digest. `effectors` are the names for its sentences, by the index in a note.
    #[must_use]
    pub fn new(effectors: Vec<String>) -> Self {
        Self { effectors, kinds: BTreeMap::new(), now: 0 }
    }

    /// Takes all notes from the ring and returns the sentences that are due for the log: the first
    /// note of a kind at once, later ones as a count every 10 s. If `last`, it returns everything
    /// not yet reported.
    pub fn sentences(&mut self, ring: &mut rtrb::Consumer<Note>, last: bool) -> Vec<String> {
        while let Ok(note) = ring.pop() {
            self.now = self.now.max(note.period);
            let kind = self.kinds.entry((note.effector, words(&note.what))).or_default();
            if kind.times == 0 {
                kind.first = note.period;
            }
            kind.times += 1;
        }
        let mut sentences = Vec::new();
        // The log would otherwise repeat a lasting fault at each exchange, 500 times a second.
        for ((effector, words), kind) in &mut self.kinds {
            if kind.times == 0 || !last && self.now < kind.next {
                continue;
            }
            let name = self.effectors.get(*effector).map_or("bridge", String::as_str);
            let (times, first) = (std::mem::take(&mut kind.times), kind.first);
            kind.next = self.now + Self::LULL;
            let at = first as f64 * crate::motion::PERIOD;
            let times = if times == 1 { String::new() } else { format!(", {times} times") };
            sentences.push(format!("{name}: {words}{times}, first in period {first} ({at:.3} s)"));
        }
        sentences
    }
}

/// Returns the sentence for a kind of event, without effector, time and number of times.
fn words(what: &NoteKind) -> String {
    match *what {
        NoteKind::Missed { axis } => format!("axis {axis} did not answer in time"),
        NoteKind::Late { axis } => format!("axis {axis} seems to have answered late"),
        NoteKind::MissedTogether => "several axes at once did not answer in time".to_owned(),
        NoteKind::Impossible { axis } => {
            format!("axis {axis} gave an impossible answer, which was ignored")
        }
        NoteKind::NoInterrupt => "no interrupt from the ISA card: check the cabinet".to_owned(),
        NoteKind::OverRange { direction, .. } => {
            let quantity = if direction < 3 { "force" } else { "torque" };
            let axis = ["x", "y", "z"][direction % 3];
            format!("force sensor: {quantity} {axis} is beyond its range, the reading was dropped")
        }
        NoteKind::ForceSilent => "no reading of the force sensor: check its controller".to_owned(),
        NoteKind::ForceBack => "the force sensor answers again".to_owned(),
        NoteKind::ForceStatus { status } => {
            format!("the force sensor reports a fault: status {status:#010x}")
        }
        NoteKind::Lost { .. } => "datagrams of the force sensor were lost".to_owned(),
        NoteKind::Reordered => {
            "a datagram of the force sensor came late and was ignored".to_owned()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_events_are_logged_in_one_sentence() {
        let (mut to, mut from) = notes();
        for period in 500..504 {
            to.push(period, 1, NoteKind::Missed { axis: 3 });
        }
        to.push(600, 0, NoteKind::ForceSilent);

        let mut digest = Digest::new(vec!["track".to_owned(), "postument".to_owned()]);

        let told = digest.sentences(&mut from, false);

        assert_eq!(
            told,
            [
                "track: no reading of the force sensor: check its controller, \
                 first in period 600 (1.200 s)",
                "postument: axis 3 did not answer in time, 4 times, first in period 500 (1.000 s)",
            ]
        );
        assert!(digest.sentences(&mut from, true).is_empty(), "reported once");
        // The report was in period 600, so the next one is due in period 5600.
        to.push(700, 1, NoteKind::Missed { axis: 3 });
        to.push(5599, 1, NoteKind::Missed { axis: 3 });
        assert!(digest.sentences(&mut from, false).is_empty(), "not each time again");
        to.push(5600, 1, NoteKind::Missed { axis: 3 });
        assert_eq!(
            digest.sentences(&mut from, false),
            ["postument: axis 3 did not answer in time, 3 times, first in period 700 (1.400 s)"]
        );
    }
}
