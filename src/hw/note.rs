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
    /// No axis at all answered in time.
    MissedAll,
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
        /// [N or Nm]
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

/// Takes what waits and puts it into sentences, one for each kind: "track: axis 3 did not answer, 4 times since ...".
#[must_use]
pub fn sentences(ring: &mut rtrb::Consumer<Note>, effectors: &[String]) -> Vec<String> {
    // In the order of effector and words; the first and the number of each.
    let mut kinds: BTreeMap<(usize, String), (Note, u32)> = BTreeMap::new();
    while let Ok(note) = ring.pop() {
        kinds.entry((note.effector, words(&note.what))).or_insert((note, 0)).1 += 1;
    }
    kinds
        .into_iter()
        .map(|((effector, words), (first, times))| {
            let name = effectors.get(effector).map_or("bridge", String::as_str);
            let at = first.period as f64 * crate::motion::PERIOD;
            let times = if times == 1 { String::new() } else { format!(", {times} times") };
            format!("{name}: {words}{times}, first in period {} ({at:.3} s)", first.period)
        })
        .collect()
}

fn words(what: &What) -> String {
    match *what {
        What::Missed { axis } => format!("axis {axis} did not answer in time"),
        What::MissedAll => "no axis at all answered in time".to_owned(),
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

        let told = sentences(&mut from, &["track".to_owned(), "postument".to_owned()]);

        assert_eq!(
            told,
            [
                "track: no reading of the force sensor: check its controller, first in period 600 (1.200 s)",
                "postument: axis 3 did not answer in time, 4 times, first in period 500 (1.000 s)",
            ]
        );
        assert!(sentences(&mut from, &[]).is_empty());
    }
}
