//! Difference between the periods of a node and those of MP's node.
//!
//! Each node counts the periods of its own servo. A beat that comes back tells the difference, up
//! to half of its time on the way; the fastest of the last beats counts.
//!
//! - in: the time of a beat of the node on its way there and back, the period of MP's node
//! - out: the difference; periods of one node as those of the other

use crate::motion::{ArmState, PERIOD};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

/// Number of the last beats of which the fastest counts: those of 2 s.
const BEATS: usize = 100;

/// Difference from the present offset that no beat explains, beyond half of its way (periods).
const JUMP: i64 = 5;

/// Difference between the periods of a node and those of MP's node. All clones are the same.
#[derive(Debug, Clone, Default)]
pub(crate) struct Offset(Arc<AtomicI64>);

impl Offset {
    /// Returns the number of periods by which those of MP's node are ahead of those of this node.
    pub(crate) fn periods(&self) -> i64 {
        self.0.load(Ordering::Relaxed)
    }

    /// Returns a period of this node as one of MP's node.
    pub(crate) fn at_home(&self, period: u64) -> u64 {
        period.saturating_add_signed(self.periods())
    }

    /// Returns a period of MP's node as one of this node.
    pub(crate) fn here(&self, period: u64) -> u64 {
        period.saturating_add_signed(-self.periods())
    }

    /// Returns a state of this node with its period as one of MP's node.
    pub(crate) fn state_at_home(&self, state: &ArmState) -> ArmState {
        ArmState { period: self.at_home(state.period), ..*state }
    }

    /// Returns a state from MP's node with its period as one of this node.
    pub(crate) fn state_here(&self, state: &ArmState) -> ArmState {
        ArmState { period: self.here(state.period), ..*state }
    }
}

/// Estimator of an offset from the last beats.
#[derive(Debug, Default)]
pub(crate) struct Estimator {
    offset: Offset,
    /// Time on the way there and back (s), and the difference of the periods, of the last beats.
    last: VecDeque<(f64, i64)>,
}

impl Estimator {
    /// Makes an estimator that sets `offset`.
    pub(crate) fn new(offset: Offset) -> Self {
        Self { offset, last: VecDeque::new() }
    }

    /// Takes a beat into account. It was `trip` (s) on its way there and back, and came back in
    /// the period `here` of this node with the period `home` in which MP's node sent it back.
    pub(crate) fn beat(&mut self, trip: f64, home: u64, here: u64) {
        let back = (trip / 2.0 / PERIOD).round() as i64;
        let offset = home as i64 - (here as i64 - back);
        // A servo that misses periods makes its count fall behind at once: older beats are wrong
        // then, however fast they were.
        let present = self.offset.periods();
        if (offset - present).abs() > back + JUMP {
            self.last.clear();
        }
        if self.last.len() == BEATS {
            self.last.pop_front();
        }
        self.last.push_back((trip, offset));
        let fastest = self.last.iter().min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, offset)) = fastest {
            self.offset.0.store(*offset, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beats of a link with 1 to 41 ms each way: the fastest of them tells the offset.
    #[test]
    fn fastest_beat_gives_the_offset() {
        let offset = Offset::default();
        let mut estimator = Estimator::new(offset.clone());
        for (out, back) in [(0.041, 0.003), (0.001, 0.030), (0.002, 0.001), (0.020, 0.020)] {
            // MP's node is 500 periods ahead.
            let (sent, came) = (1000.0 + out / PERIOD, 1000.0 + (out + back) / PERIOD);
            estimator.beat(out + back, sent as u64 + 500, came as u64);
        }

        assert!((499..=501).contains(&offset.at_home(0)), "{}", offset.at_home(0));
        assert_eq!(offset.here(offset.at_home(10_000)), 10_000);
        assert_eq!(offset.here(3), 0, "before the beginning");
    }

    /// The servo of MP's node has missed 40 periods.
    #[test]
    fn missed_periods_move_the_offset_at_once() {
        let offset = Offset::default();
        let mut estimator = Estimator::new(offset.clone());
        for beat in 0..50 {
            estimator.beat(if beat == 7 { 1e-4 } else { 2e-3 }, 10 * beat + 500, 10 * beat);
        }
        estimator.beat(4e-3, 1000 + 500 - 40, 1000);

        assert!((459..=462).contains(&offset.at_home(0)), "{}", offset.at_home(0));
    }

    #[test]
    fn offset_follows_a_drifting_clock() {
        let offset = Offset::default();
        let mut estimator = Estimator::new(offset.clone());
        for beat in 0..1000 {
            estimator.beat(if beat == 0 { 1e-4 } else { 2e-3 }, 10 * beat + beat / 100, 10 * beat);
        }
        assert!((9..=11).contains(&offset.at_home(0)), "{}", offset.at_home(0));
    }
}
