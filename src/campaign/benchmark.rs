//! The trials of the benchmark and their scores.
//!
//! - in: a tier and seeds, or the tally of the trials
//! - out: scrambles; accuracy and speed
//! - source: B. Yang, P. Lancaster, S. Srinivasa, J. Smith, "Benchmarking robot manipulation with
//!   the Rubik's cube", RA-L 2020 (arXiv 2202.07074): M consecutive trials of N moves, accuracy and
//!   speed. This project adds the clearance and the time limit. Its moves scramble the cube, and
//!   the robot solves the cube by a plan of its own

use super::result::{RunResult, Verdict};
use super::statistics::Spread;
use super::tally::Tally;
use crate::cube::{Facelets, Turn};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::{Value, json};

/// Kind of trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Whole missions with cubes drawn from all states.
    Mission {
        /// Number of trials.
        trials: u64,
    },
    /// Missions with cubes that a given number of moves has scrambled.
    Tier {
        /// Number M of consecutive trials.
        trials: u64,
        /// Number N of moves in a trial.
        moves: u64,
    },
}

impl Kind {
    /// Returns the number of trials in the benchmark.
    #[must_use]
    pub fn trials(self) -> u64 {
        match self {
            Self::Mission { trials } | Self::Tier { trials, .. } => trials,
        }
    }

    /// Returns the name of the benchmark for people: "Rubiks-5-20" for 5 trials of 20 moves each,
    /// or "100 missions".
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Mission { trials } => format!("{trials} missions"),
            Self::Tier { trials, moves } => format!("Rubiks-{trials}-{moves}"),
        }
    }
}

/// Largest number of trials; a larger one is taken for a typing error.
const MOST: u64 = 1_000_000;
/// Largest number of moves in a trial.
const MOST_MOVES: u64 = 1000;

/// Parses a tier `M-N`, as in `5-20`: M consecutive trials, each with a cube scrambled by N moves.
///
/// # Errors
/// A message, if the text is not a tier.
pub fn tier(text: &str) -> Result<Kind, String> {
    let numbers = text.split_once('-').and_then(|(m, n)| Some((m.parse().ok()?, n.parse().ok()?)));
    match numbers {
        Some((trials @ 1..=MOST, moves @ 1..=MOST_MOVES)) => Ok(Kind::Tier { trials, moves }),
        _ => Err(format!("`{text}` is not a tier: write TRIALS-MOVES, as in 5-20")),
    }
}

/// Returns the moves with which a seed scrambles a cube. No two of them could be joined into one: a
/// face does not turn twice in a row, nor with only a turn of the opposite face between.
#[must_use]
pub fn scramble(moves: u64, seed: u64) -> Vec<Turn> {
    // Cubes, hands and cells are drawn from the plain seed; the moves must not depend on them.
    let mut random = Pcg64::seed_from_u64(seed ^ 0x5ca4_b1e5_0000_0000);
    let mut turns: Vec<Turn> = Vec::new();
    while (turns.len() as u64) < moves {
        let turn = Turn::from_index(random.random_range(0..18));
        // Opposite faces commute: U D U is U2 D, one move less than it seems.
        let redundant = match turns.as_slice() {
            [.., last] if last.face == turn.face => true,
            [.., before, last] => last.face.opposite() == turn.face && before.face == turn.face,
            _ => false,
        };
        if !redundant {
            turns.push(turn);
        }
    }
    turns
}

/// Returns the cube after a scramble.
#[must_use]
pub fn scrambled(turns: &[Turn]) -> Facelets {
    turns.iter().fold(Facelets::solved(), |cube, turn| cube.turned(*turn))
}

/// Accuracy and speed of a benchmark.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// Number of trials that were solved within the time limit.
    pub passed: u64,
    /// Number of trials that were asked for.
    pub trials: u64,
    /// Number of trials in the longest row of consecutive passed trials.
    pub longest_row: u64,
    /// Simulated time of a trial that passed, from the start to the hand-back (s).
    pub trial_s: Spread,
    /// Simulated time for each face turn of a trial that passed (s).
    pub turn_s: Spread,
}

/// Computes accuracy and speed of the trials. A trial passes if its cube is solved within `limit`
/// of simulated time (s).
#[must_use]
pub fn score(tally: &Tally, limit: f64) -> Score {
    let passed = |run: &RunResult| {
        run.verdict == Verdict::Solved
            && run.figures.as_ref().is_some_and(|f| f.sim_time_s <= limit)
    };
    let (mut longest_row, mut row) = (0, 0);
    // Seeds are walked, not results: a missing trial ends a row as a failed one does. Otherwise
    // results of the trials 5, 7 and 9 would count as three consecutive ones.
    let mut results = tally.results.iter().peekable();
    for seed in tally.header.seeds() {
        let run = results.next_if(|run| run.seed == seed);
        row = if run.is_some_and(passed) { row + 1 } else { 0 };
        longest_row = longest_row.max(row);
    }
    let good = || tally.results.iter().filter(|r| passed(r)).filter_map(|r| r.figures.as_ref());
    Score {
        passed: good().count() as u64,
        trials: tally.asked,
        longest_row,
        trial_s: Spread::of(good().map(|f| f.sim_time_s)),
        // A cube that is solved at the start is a passed trial without a turn.
        turn_s: Spread::of(
            good().filter(|f| f.turns > 0).map(|f| f.sim_time_s / f64::from(f.turns)),
        ),
    }
}

/// Returns for each trial the seed and the true distance (mm) between the cube and the nearest tool
/// at the start.
pub fn clearances(tally: &Tally) -> impl Iterator<Item = (u64, f64)> {
    tally.results.iter().filter_map(|r| Some((r.seed, r.figures.as_ref()?.clearance_mm?)))
}

impl Score {
    /// Returns whether every trial passed.
    #[must_use]
    pub(crate) fn is_whole(&self) -> bool {
        self.trials > 0 && self.passed == self.trials
    }

    /// Returns the score as a part of the benchmark's JSON object.
    #[must_use]
    pub fn json(&self) -> Value {
        json!({
            "accuracy": self.passed as f64 / self.trials.max(1) as f64,
            "trials_passed": self.passed, "trials": self.trials,
            "longest_row": self.longest_row, "passed": self.is_whole(),
            "trial_s": self.trial_s, "turn_s": self.turn_s,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::result::tests::result;
    use super::super::state::State;
    use super::super::state::tests::header;
    use super::*;
    use crate::cube::Cube;

    #[test]
    fn scramble_has_no_redundant_moves() {
        for seed in 0..200 {
            let turns = scramble(20, seed);
            assert_eq!(turns.len(), 20);
            for pair in turns.windows(2) {
                assert_ne!(pair[0].face, pair[1].face);
            }
            for three in turns.windows(3) {
                let axis = three[0].face.axis();
                assert!(three.iter().any(|t| t.face.axis() != axis));
            }
            assert!(Cube::try_from(scrambled(&turns)).is_ok());
        }
        assert_eq!(scramble(20, 3), scramble(20, 3));
        assert_ne!(scramble(20, 3), scramble(20, 4));
        // A short scramble is the beginning of a longer one.
        assert_eq!(scramble(5, 3), scramble(20, 3)[..5]);
    }

    #[test]
    fn inverse_moves_undo_a_short_scramble() {
        let turns = scramble(5, 1);
        let back = turns.iter().rev().fold(scrambled(&turns), |c, t| c.turned(t.inverse()));
        assert_eq!(back, Facelets::solved());
    }

    #[test]
    fn tier_text_needs_trials_and_moves_in_range() {
        assert_eq!(tier("5-20"), Ok(Kind::Tier { trials: 5, moves: 20 }));
        let most = Kind::Tier { trials: 1_000_000, moves: 1000 };
        assert_eq!((tier("1-1").is_ok(), tier("1000000-1000")), (true, Ok(most)));
        for wrong in ["", "5", "0-20", "5-0", "5-", "-5-20", "5-20-1", "5-1001", "1000001-1"] {
            assert!(tier(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn failed_late_or_missing_trial_fails_the_tier() {
        let header = header(5, "1/1");
        let results = header.seeds().map(|s| (s, result(s, Verdict::Solved, s as f64))).collect();
        let mut state = State { header, results, whole: 0, damaged: 0, torn: false };
        // A trial takes 400 s + its seed, and the seeds are 5 to 9.
        let all = score(&Tally::of(&state), 1000.0);
        assert!(all.is_whole() && all.longest_row == 5 && all.trial_s.max == 409.0);

        // Only the last trial, which takes 409 s, is late.
        let late = score(&Tally::of(&state), 408.5);
        assert_eq!((late.is_whole(), late.passed, late.longest_row), (false, 4, 4));
        state.results.insert(6, result(6, Verdict::Failed, 6.0));
        let failed = score(&Tally::of(&state), 1000.0);
        assert_eq!((failed.passed, failed.longest_row), (4, 3));
        state.results.remove(&8);
        let missing = score(&Tally::of(&state), 1000.0);
        assert!(!missing.is_whole(), "a trial is missing");
        // Seeds 5, 7 and 9 are left, and no two of them are consecutive.
        assert_eq!((missing.passed, missing.longest_row), (3, 1));
    }
}
