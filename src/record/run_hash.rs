//! Two running hashes of a run: the run hash over all servo records and messages, and the servo
//! hash over the servo records alone.
//!
//! Two runs of one binary with the same seed must have equal hashes. A hash is the `SipHash` of
//! `std` with fixed keys, which gives equal results for one binary on one machine. The run hash
//! takes the `Debug` form of each message, so a renamed type changes it although no arm moves
//! differently. The servo hash changes only if the servos read, get or send something else.

use crate::hw::driver::{RecordSink, ServoRecord};
use std::fmt::{Debug, Write};
use std::hash::{DefaultHasher, Hasher};
use std::sync::{Arc, Mutex, PoisonError};

/// Both hashes of a run. All clones feed the same hashes.
#[derive(Debug, Clone, Default)]
pub struct RunHash(Arc<Mutex<State>>);

/// Hashes so far, and reused memory.
#[derive(Debug, Default)]
struct State {
    /// Run hash.
    hasher: DefaultHasher,
    /// Servo hash.
    servo: DefaultHasher,
    /// Buffer for the text of one message.
    text: String,
    /// Buffer for the bytes of one record. To hash them at once takes half the time of word by
    /// word.
    bytes: Vec<u8>,
}

/// On the virtual clock the servos' driver calls this sink directly. On the wall clock its
/// real-time thread must not lock, so it writes to a ring instead.
impl RecordSink for RunHash {
    fn record(&mut self, record: &ServoRecord) {
        RunHash::record(self, record);
    }
}

impl RunHash {
    /// Adds a message from one actor to another to the run hash.
    pub fn message(&self, from: &str, to: &str, message: &impl Debug) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // The fields cannot be borrowed separately through the guard itself.
        let state = &mut *state;
        state.text.clear();
        // Writing to a string cannot fail.
        let _ = write!(state.text, "{from}>{to}:{message:?}");
        state.hasher.write(state.text.as_bytes());
        tracing::trace!(target: "rubik_robot::run_hash", "{}", state.text);
    }

    /// Adds a servo record to both hashes.
    pub fn record(&self, record: &ServoRecord) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let State { hasher, servo, bytes, .. } = &mut *state;
        bytes.clear();
        record.feed(&mut |word| bytes.extend_from_slice(word));
        hasher.write(bytes);
        servo.write(bytes);
    }

    /// Returns the run hash over everything added so far, as 16 hexadecimal digits.
    #[must_use]
    pub fn hash(&self) -> String {
        let state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        format!("{:016x}", state.hasher.finish())
    }

    /// Returns the servo hash over everything added so far, as 16 hexadecimal digits.
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

    /// Returns the record of an arm at rest in period 1.
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

    /// The bytes of a record, hashed at once, give the same hash as its words one by one.
    #[test]
    fn record_hash_equals_hash_of_its_words() {
        let (hash, mut words) = (RunHash::default(), DefaultHasher::default());
        // The message has an odd length, so the words of the records begin in the middle of the
        // words of 8 bytes that the hash takes.
        hash.message("mp", "ecp", &1.0_f64);
        words.write(b"mp>ecp:1.0");
        for _ in 0..3 {
            hash.record(&record());
            record().feed(&mut |word| words.write(word));
        }

        assert_eq!(hash.hash(), format!("{:016x}", words.finish()));
    }

    #[test]
    fn one_encoder_increment_changes_both_hashes() {
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
    fn message_changes_run_hash_but_not_servo_hash() {
        let (a, b) = (RunHash::default(), RunHash::default());
        let before = b.servo_hash();

        a.message("mp", "ecp", &1.0_f64);
        b.message("mp", "ecp", &2.0_f64);

        assert_ne!(a.hash(), b.hash());
        assert_eq!([a.servo_hash(), b.servo_hash()], [before.clone(), before]);
    }
}
