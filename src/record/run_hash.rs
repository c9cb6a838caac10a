//! Two running hashes of a run: one over every servo record and message, one over servo records
//! alone.
//!
//! Two runs of one seed must give the same two hashes. A hash is `SipHash` with fixed keys, as
//! `std` ships it: equal for the same binary on the same machine. The text of a message is its
//! `Debug` form, so a renamed type changes the run's hash although nothing moves differently; the
//! servo hash changes with the motion only.

use crate::hw::driver::{RecordSink, ServoRecord};
use std::fmt::{Debug, Write};
use std::hash::{DefaultHasher, Hasher};
use std::sync::{Arc, Mutex, PoisonError};

/// A handle on the hashes of a run; clones feed the same ones.
#[derive(Debug, Clone, Default)]
pub struct RunHash(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    hasher: DefaultHasher,
    servo: DefaultHasher,
    text: String,
    /// Bytes of one record: hashed in one piece, which costs half of word by word.
    bytes: Vec<u8>,
}

/// The virtual driver calls it inline; the real-time thread writes to a ring instead.
impl RecordSink for RunHash {
    fn record(&mut self, record: &ServoRecord) {
        RunHash::record(self, record);
    }
}

impl RunHash {
    /// Adds a message from one actor to another.
    pub fn message(&self, from: &str, to: &str, message: &impl Debug) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let state = &mut *state;
        state.text.clear();
        // Writing to a string cannot fail.
        let _ = write!(state.text, "{from}>{to}:{message:?}");
        state.hasher.write(state.text.as_bytes());
        tracing::trace!(target: "rubik_robot::run_hash", "{}", state.text);
    }

    /// Adds a servo record.
    pub fn record(&self, record: &ServoRecord) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let State { hasher, servo, bytes, .. } = &mut *state;
        bytes.clear();
        record.feed(&mut |word| bytes.extend_from_slice(word));
        hasher.write(bytes);
        servo.write(bytes);
    }

    /// Returns the hash over servo records and messages so far, as 16 hexadecimal digits.
    #[must_use]
    pub fn hash(&self) -> String {
        let state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        format!("{:016x}", state.hasher.finish())
    }

    /// Returns the hash over the servo records so far, as 16 hexadecimal digits.
    #[must_use]
    pub(crate) fn servo_hash(&self) -> String {
        let state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        format!("{:016x}", state.servo.finish())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::ArmState;
    use crate::servo::io::{ArmDrive, ArmReading, Outside};

    fn record() -> ServoRecord {
        ServoRecord {
            period: 1,
            arm: 0,
            reading: ArmReading::default(),
            outside: Outside::default(),
            command: None,
            drive: ArmDrive::OFF,
            state: ArmState::default(),
        }
    }

    #[test]
    fn record_counts_as_its_words_do() {
        let (hash, mut words) = (RunHash::default(), DefaultHasher::default());
        // A message of odd length, so that no later word begins where a word of the hash does.
        hash.message("mp", "ecp", &1.0_f64);
        words.write(b"mp>ecp:1.0");
        for _ in 0..3 {
            hash.record(&record());
            record().feed(&mut |word| words.write(word));
        }

        assert_eq!(hash.hash(), format!("{:016x}", words.finish()));
    }

    #[test]
    fn one_increment_of_one_record_changes_both_hashes() {
        let (a, b) = (RunHash::default(), RunHash::default());
        a.message("mp", "ecp", &1.0_f64);
        b.message("mp", "ecp", &1.0_f64);
        assert_eq!(a.hash(), b.hash());

        let record = record();
        let mut other = record;
        other.reading.counts[3] = 1;
        a.record(&record);
        b.record(&other);
        assert_ne!(a.hash(), b.hash());
        assert_ne!(a.servo_hash(), b.servo_hash());
    }

    #[test]
    fn a_message_changes_the_run_hash_alone() {
        let (a, b) = (RunHash::default(), RunHash::default());
        let before = b.servo_hash();

        a.message("mp", "ecp", &1.0_f64);
        b.message("mp", "ecp", &2.0_f64);

        assert_ne!(a.hash(), b.hash());
        assert_eq!([a.servo_hash(), b.servo_hash()], [before.clone(), before]);
    }
}
