//! Faults of lines, as an emulator makes them: at random by a seeded generator, or at a set time.

use crate::motion::PERIOD;
use rand::Rng;
use rand_pcg::Pcg64;

/// An axis of an effector at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct At {
    /// Index of the effector.
    pub effector: usize,
    /// 0 the track, 7 the jaw.
    pub axis: usize,
    /// Since the first order came (s), not negative.
    pub time: f64,
}

/// What goes wrong.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LineFaults {
    /// Share of the axes' answers that never come.
    pub missed: f64,
    /// Share of the axes' answers of which one bit is wrong.
    pub corrupt: f64,
    /// Share of the force sensors' datagrams that are lost.
    pub lost: f64,
    /// Share of the force sensors' datagrams that come after their successor.
    pub reordered: f64,
    /// Share of the periods in which an arm's axes fall silent together, both ways.
    pub stalled: f64,
    /// For how many periods they do.
    pub stall: u32,
    /// Axis controllers that are reset.
    pub resets: Vec<At>,
    /// Lines that are pulled out.
    pub unplugged: Vec<At>,
    /// Force sensors that fall silent; the axis does not count.
    pub silenced: Vec<At>,
}

/// Faults with their chance.
#[derive(Debug)]
pub(super) struct Chance {
    pub(super) faults: LineFaults,
    random: Pcg64,
}

/// Takes out what is due so long after the first order (periods): each happens once, and none is
/// passed over.
pub(super) fn due(faults: &mut Vec<At>, now: u64) -> impl Iterator<Item = At> {
    faults.extract_if(.., move |at| (at.time / PERIOD) as u64 <= now)
}

impl Chance {
    pub(super) fn new(faults: LineFaults, seed: u64) -> Self {
        Self { faults, random: Pcg64::new(u128::from(seed), 0x006c_696e_6573) }
    }

    fn happens(&mut self, share: f64) -> bool {
        share > 0.0 && self.random.random::<f64>() < share
    }

    /// An answer as it arrives: whole, with a wrong bit, or not at all.
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

    /// For how many periods the axes of an arm are silent from now on.
    pub(super) fn stalls(&mut self) -> u32 {
        if self.happens(self.faults.stalled) { self.faults.stall } else { 0 }
    }

    pub(super) fn loses(&mut self) -> bool {
        self.happens(self.faults.lost)
    }

    pub(super) fn reorders(&mut self) -> bool {
        self.happens(self.faults.reordered)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_happens_once_and_those_of_the_very_beginning_too() {
        let at = |axis, time| At { effector: 0, axis, time };
        let mut faults = vec![at(1, 0.0), at(2, 0.1), at(3, 0.004)];

        let mut axes = |now| due(&mut faults, now).map(|at| at.axis).collect::<Vec<_>>();

        // The first order is a period old when it is asked first.
        assert_eq!(axes(1), [1]);
        assert_eq!(axes(49), [3]);
        assert_eq!(axes(50), [2]);
        assert!(axes(51).is_empty());
    }

    #[test]
    fn shares_are_kept_and_a_corrupt_answer_has_one_wrong_bit() {
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

        assert!((900..1100).contains(&missed), "{missed}");
        assert!((1600..2000).contains(&wrong), "{wrong}");
    }
}
