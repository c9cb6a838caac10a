//! Faults of the emulator's lines: at random from a seeded generator, or at set times.
//!
//! - in: [`LineFaults`] and a seed; the time since the first order
//! - out: the fault of each answer, datagram and period

use crate::motion::PERIOD;
use rand::Rng;
use rand_pcg::Pcg64;

/// An axis of an effector, and a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct At {
    /// Index of the effector.
    pub effector: usize,
    /// Index of the axis: 0 is the track, 7 the jaw.
    pub axis: usize,
    /// Time since the first order (s), not negative.
    pub time: f64,
}

/// Faults to make. Each share is in 0..=1.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LineFaults {
    /// Share of the axes' answers that are lost.
    pub missed: f64,
    /// Share of the axes' answers in which one bit is wrong.
    pub corrupt: f64,
    /// Share of the force sensors' datagrams that are lost.
    pub lost: f64,
    /// Share of the force sensors' datagrams that come after their successor.
    pub reordered: f64,
    /// Share of the periods in which a silence of all axes of an arm begins. Orders and answers are
    /// lost during a silence.
    pub stalled: f64,
    /// Length of such a silence (periods).
    pub stall: u32,
    /// Axis controllers that are reset.
    pub resets: Vec<At>,
    /// Lines that are unplugged.
    pub unplugged: Vec<At>,
    /// Force sensors that fall silent. The axis is ignored.
    pub silenced: Vec<At>,
}

/// Faults with the random generator that decides on them.
#[derive(Debug)]
pub(super) struct Chance {
    pub(super) faults: LineFaults,
    random: Pcg64,
}

/// Removes and returns the faults that are due `now`, in periods since the first order. Each fault
/// is returned once.
pub(super) fn due(faults: &mut Vec<At>, now: u64) -> impl Iterator<Item = At> {
    // A fault whose period was skipped is still due, hence `<=`.
    faults.extract_if(.., move |at| (at.time / PERIOD) as u64 <= now)
}

impl Chance {
    /// Makes the generator from a seed. Equal seeds give equal faults.
    pub(super) fn new(faults: LineFaults, seed: u64) -> Self {
        Self { faults, random: Pcg64::new(u128::from(seed), 0x006c_696e_6573) }
    }

    /// Decides at random whether an event of probability `share` happens.
    fn happens(&mut self, share: f64) -> bool {
        // A share of zero draws no number, so one kind of fault leaves the sequence of others
        // alone.
        share > 0.0 && self.random.random::<f64>() < share
    }

    /// Returns the bytes of an answer as they arrive after random faults: unchanged, with one wrong
    /// bit, or `None` for a lost answer.
    pub(super) fn answer<const N: usize>(&mut self, mut bytes: [u8; N]) -> Option<[u8; N]> {
        if self.happens(self.faults.missed) {
            return None;
        }
        if self.happens(self.faults.corrupt) {
            let bit = self.random.random_range(0..N * 8);
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
        Some(bytes)
    }

    /// Decides at random whether the axes of an arm fall silent now. Returns for how many periods;
    /// 0 if they do not.
    pub(super) fn stalls(&mut self) -> u32 {
        if self.happens(self.faults.stalled) { self.faults.stall } else { 0 }
    }

    /// Decides at random whether a datagram is lost.
    pub(super) fn loses(&mut self) -> bool {
        self.happens(self.faults.lost)
    }

    /// Decides at random whether a datagram is sent after its successor.
    pub(super) fn reorders(&mut self) -> bool {
        self.happens(self.faults.reordered)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A fault at time zero is due when it is first asked for, one period after the first order.
    #[test]
    fn each_timed_fault_happens_exactly_once() {
        let at = |axis, time| At { effector: 0, axis, time };
        let mut faults = vec![at(1, 0.0), at(2, 0.1), at(3, 0.004)];

        let mut axes = |now| due(&mut faults, now).map(|at| at.axis).collect::<Vec<_>>();

        // The first order is one period old at the first request.
        assert_eq!(axes(1), [1]);
        assert_eq!(axes(49), [3]);
        assert_eq!(axes(50), [2]);
        assert!(axes(51).is_empty());
    }

    #[test]
    fn answers_are_lost_or_corrupted_at_given_rates() {
        let faults = LineFaults { missed: 0.1, corrupt: 0.2, ..LineFaults::default() };
        let mut chance = Chance::new(faults, 1);
        let (mut missed, mut wrong) = (0, 0);

        for _ in 0..10_000 {
            match chance.answer([0u8; 8]) {
                None => missed += 1,
                Some(bytes) => {
                    let bits: u32 = bytes.iter().map(|b| b.count_ones()).sum();
                    assert!(bits <= 1);
                    wrong += bits;
                }
            }
        }

        // A fifth of the answers that are not missed is corrupt.
        assert!((900..1100).contains(&missed), "{missed}");
        assert!((1600..2000).contains(&wrong), "{wrong}");
    }
}
