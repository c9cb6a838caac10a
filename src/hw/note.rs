//! What a bridge notices and can live with: non-fatal, for the log.
//!
//! The exchange is no place to write a log, so notes go by a ring to whoever has the time. What does not fit is
//! dropped, and counted.

use std::collections::BTreeMap;

/// What was noticed, in which period, at which effector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Note {
    /// Servo period.
    pub period: u64,
    /// Index of the effector.
    pub effector: usize,
    /// What.
    pub what: What,
}

/// What can be noticed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum What {
    /// An axis did not answer in time.
    Missed {
        /// 0 the track, 7 the jaw.
        axis: usize,
    },
    /// What an axis answered seems to be owed to an earlier order.
    Late {
        /// As above.
        axis: usize,
    },
    /// Several axes at once did not answer in time, or all of them.
    MissedTogether,
    /// An axis's answer cannot be true and was passed over.
    Impossible {
        /// As above.
        axis: usize,
    },
    /// The card did not raise its interrupt.
    NoInterrupt,
    /// A reading of the force sensor left its range and was dropped.
    OverRange {
        /// 0..=5.
        direction: usize,
        /// (N or Nm)
        reading: f64,
    },
    /// The force sensor has fallen silent.
    ForceSilent,
    /// It speaks again.
    ForceBack,
    /// The force sensor's own report.
    ForceStatus {
        /// As it came.
        status: u32,
    },
    /// Datagrams of the force sensor were lost.
    Lost {
        /// How many.
        datagrams: u32,
    },
    /// A datagram of the force sensor came after a later one and was passed over.
    Reordered,
}

/// The bridge's end: it never waits.
#[derive(Debug)]
pub struct Notes(Option<rtrb::Producer<Note>>);

/// Notes that may wait.
const ROOM: usize = 1024;

/// Both ends of the way.
#[must_use]
pub fn notes() -> (Notes, rtrb::Consumer<Note>) {
    let (producer, consumer) = rtrb::RingBuffer::new(ROOM);
    (Notes(Some(producer)), consumer)
}

impl Notes {
    /// Nobody reads them.
    #[must_use]
    pub fn none() -> Self {
        Self(None)
    }

    /// Hands one over.
    pub fn tell(&mut self, period: u64, effector: usize, what: What) {
        if let Some(ring) = &mut self.0 {
            let _ = ring.push(Note { period, effector, what });
        }
    }
}

/// Puts notes into sentences: a kind at its first time at once, and then every ten seconds how often it came since.
#[derive(Debug)]
pub struct Digest {
    effectors: Vec<String>,
    /// In the order of effector and words.
    kinds: BTreeMap<(usize, String), Kind>,
    /// The latest period of any note.
    now: u64,
}

#[derive(Debug, Default)]
struct Kind {
    /// Period of the first that was not told yet.
    first: u64,
    times: u32,
    /// Told again from this period on.
    next: u64,
}

impl Digest {
    /// Periods until a kind is told again.
    const LULL: u64 = 5000;

    /// Of effectors with these names.
    #[must_use]
    pub fn new(effectors: Vec<String>) -> Self {
        Self { effectors, kinds: BTreeMap::new(), now: 0 }
    }

    /// Takes what waits and gives what is to be told now; `last`: everything.
    pub fn sentences(&mut self, ring: &mut rtrb::Consumer<Note>, last: bool) -> Vec<String> {
        while let Ok(note) = ring.pop() {
            self.now = self.now.max(note.period);
            let kind = self.kinds.entry((note.effector, words(&note.what))).or_default();
            if kind.times == 0 {
                kind.first = note.period;
            }
            kind.times += 1;
        }
        let mut told = Vec::new();
        for ((effector, words), kind) in &mut self.kinds {
            if kind.times == 0 || !last && self.now < kind.next {
                continue;
            }
            let name = self.effectors.get(*effector).map_or("bridge", String::as_str);
            let (times, first) = (std::mem::take(&mut kind.times), kind.first);
            kind.next = self.now + Self::LULL;
            let at = first as f64 * crate::motion::PERIOD;
            let times = if times == 1 { String::new() } else { format!(", {times} times") };
            told.push(format!("{name}: {words}{times}, first in period {first} ({at:.3} s)"));
        }
        told
    }
}

fn words(what: &What) -> String {
    match *what {
        What::Missed { axis } => format!("axis {axis} did not answer in time"),
        What::Late { axis } => format!("axis {axis} seems to have answered late"),
        What::MissedTogether => "several axes at once did not answer in time".to_owned(),
        What::Impossible { axis } => format!("axis {axis} gave an impossible answer"),
        What::NoInterrupt => "interrupt not received: check the cabinet".to_owned(),
        What::OverRange { direction, .. } => {
            format!("force sensor beyond its range in direction {direction}: reading dropped")
        }
        What::ForceSilent => "no reading of the force sensor: check its controller".to_owned(),
        What::ForceBack => "the force sensor speaks again".to_owned(),
        What::ForceStatus { status } => format!("the force sensor reports status {status:#010x}"),
        What::Lost { .. } => "datagrams of the force sensor were lost".to_owned(),
        What::Reordered => "a datagram of the force sensor came late".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_of_a_kind_become_one_sentence() {
        let (mut to, mut from) = notes();
        for period in 500..504 {
            to.tell(period, 1, What::Missed { axis: 3 });
        }
        to.tell(600, 0, What::ForceSilent);

        let mut digest = Digest::new(vec!["track".to_owned(), "postument".to_owned()]);

        let told = digest.sentences(&mut from, false);

        assert_eq!(
            told,
            [
                "track: no reading of the force sensor: check its controller, first in period 600 (1.200 s)",
                "postument: axis 3 did not answer in time, 4 times, first in period 500 (1.000 s)",
            ]
        );
        assert!(digest.sentences(&mut from, true).is_empty(), "told once");
        to.tell(700, 1, What::Missed { axis: 3 });
        assert!(digest.sentences(&mut from, false).is_empty(), "not every time anew");
        to.tell(5800, 1, What::Missed { axis: 3 });
        assert_eq!(
            digest.sentences(&mut from, false),
            ["postument: axis 3 did not answer in time, 2 times, first in period 700 (1.400 s)"]
        );
    }
}
