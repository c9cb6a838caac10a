//! Joint states of all arms in one message.
//!
//! - in: the joint states of a recording, one message for each arm
//! - out: a message with the latest states of all arms
//!
//! A hardware interface of `ros2_control` keeps only the last message between two of its reads, so
//! the states of one arm would hide those of the other.

use super::messages::{JOINTS, joint_state};
use crate::record::cdr::Writer;
use crate::record::standard;

/// Latest joint states of each arm: names with their positions.
#[derive(Debug, Default)]
pub(super) struct AllJoints(Vec<Vec<(String, f64)>>);

impl AllJoints {
    /// Takes the message `data` of one arm, and returns one of all arms with the time `time` (ns).
    /// A message that is malformed is returned as it is.
    pub(super) fn merged(&mut self, data: &[u8], time: u64) -> Vec<u8> {
        let Ok(state) = joint_state(JOINTS, data) else { return data.to_vec() };
        let first = |arm: &[(String, f64)]| arm.first().map(|(name, _)| name.clone());
        let of = first(&state.positions);
        match self.0.iter_mut().find(|arm| first(arm) == of) {
            Some(arm) => *arm = state.positions,
            None => self.0.push(state.positions),
        }
        let (names, positions): (Vec<String>, Vec<f64>) = self.0.iter().flatten().cloned().unzip();
        let mut to = Writer::default();
        standard::joint_state(&mut to, time, &names, &positions);
        to.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Encodes the joint state of an arm with one joint.
    fn one(name: &str, position: f64) -> Vec<u8> {
        let mut to = Writer::default();
        standard::joint_state(&mut to, 1, &[name.to_owned()], &[position]);
        to.bytes()
    }

    #[test]
    fn message_has_latest_states_of_all_arms() {
        let mut all = AllJoints::default();
        all.merged(&one("a", 1.0), 5);
        all.merged(&one("b", 2.0), 6);

        let merged = all.merged(&one("a", 3.0), 7);

        let wanted = vec![("a".to_owned(), 3.0), ("b".to_owned(), 2.0)];
        assert_eq!(joint_state(JOINTS, &merged).unwrap().positions, wanted);
        assert_eq!(all.merged(b"x", 8), b"x");
    }
}
