//! The tape: a running hash over every servo record and every message of a run.
//!
//! Two runs of one seed must give one hash. The hash is `SipHash` with fixed keys, as `std` ships it: equal for
//! the same binary on the same machine, which is what repeatability promises here.

use crate::hw::driver::{RecordSink, ServoRecord};
use std::fmt::{Debug, Write};
use std::hash::{DefaultHasher, Hasher};
use std::sync::{Arc, Mutex, PoisonError};

/// A handle on the tape of a run; clones write to the same one.
#[derive(Debug, Clone, Default)]
pub struct Tape(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    hasher: DefaultHasher,
    text: String,
}

/// For the virtual driver, which calls it inline; the real-time thread writes to a ring instead.
impl RecordSink for Tape {
    fn record(&mut self, record: &ServoRecord) {
        Tape::record(self, record);
    }
}

impl Tape {
    /// Notes a message from one actor to another.
    pub fn message(&self, from: &str, to: &str, message: &impl Debug) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let state = &mut *state;
        state.text.clear();
        // Writing to a string cannot fail.
        let _ = write!(state.text, "{from}>{to}:{message:?}");
        state.hasher.write(state.text.as_bytes());
        tracing::trace!(target: "rubik_robot::tape", "{}", state.text);
    }

    /// Notes a servo record.
    pub fn record(&self, record: &ServoRecord) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        record.feed(&mut |bytes| state.hasher.write(bytes));
    }

    /// The hash so far, as 16 hexadecimal digits.
    #[must_use]
    pub fn hash(&self) -> String {
        let state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        format!("{:016x}", state.hasher.finish())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::ArmState;
    use crate::servo::io::{ArmDrive, ArmReading, Outside};

    #[test]
    fn one_increment_of_one_record_changes_the_hash() {
        let (a, b) = (Tape::default(), Tape::default());
        a.message("mp", "ecp", &1.0_f64);
        b.message("mp", "ecp", &1.0_f64);
        assert_eq!(a.hash(), b.hash());

        let record = ServoRecord {
            period: 1,
            arm: 0,
            reading: ArmReading::default(),
            outside: Outside::default(),
            command: None,
            drive: ArmDrive::OFF,
            state: ArmState::default(),
        };
        let mut other = record;
        other.reading.counts[3] = 1;
        a.record(&record);
        b.record(&other);
        assert_ne!(a.hash(), b.hash());
    }
}
