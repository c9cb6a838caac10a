//! The benchmark's trials and their scores.
//!
//! - in: a tier and seeds, or the tally of the trials
//! - out: scrambles; accuracy and speed
//! - source: B. Yang, P. Lancaster, S. Srinivasa, J. Smith, "Benchmarking robot manipulation with
//!   the Rubik's cube", RA-L 2020 (arXiv 2202.07074): M consecutive trials of N moves, accuracy and
//!   speed. The clearance, the thresholds and that the moves scramble the cube, which the robot
//!   then undoes by its own plan, are this project's

use super::result::{RunResult, Verdict};
use super::statistics::Spread;
use super::tally::Tally;
use crate::cube::{Facelets, Turn};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::{Value, json};

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Whole missions with cubes drawn from all that there are.
    Mission {
        /// Trials.
        trials: u64,
    },
    /// Cubes that are a few moves away from solved.
    Tier {
        /// Consecutive trials, M.
        trials: u64,
        /// Moves of a trial, N.
        moves: u64,
    },
}

impl Kind {
    /// Number of trials.
    #[must_use]
    pub fn trials(self) -> u64 {
        match self {
            Self::Mission { trials } | Self::Tier { trials, .. } => trials,
        }
    }

    /// For people: "Rubiks-5-20".
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Mission { trials } => format!("{trials} missions"),
            Self::Tier { trials, moves } => format!("Rubiks-{trials}-{moves}"),
        }
    }
}

/// The most trials or moves: more would be a slip of the pen.
const MOST: u64 = 1_000_000;
/// The most moves of a trial.
const MOST_MOVES: u64 = 1000;

/// A tier as it is written: `5-20`.
///
/// # Errors
/// A message when it is none.
pub fn tier(text: &str) -> Result<Kind, String> {
    let numbers = text.split_once('-').and_then(|(m, n)| Some((m.parse().ok()?, n.parse().ok()?)));
    match numbers {
        Some((trials @ 1..=MOST, moves @ 1..=MOST_MOVES)) => Ok(Kind::Tier { trials, moves }),
        _ => Err(format!("`{text}` is no tier: write TRIALS-MOVES, as in 5-20")),
    }
}

/// Moves that scramble a cube: none undoes or repeats what the one before did to its face, or to
/// the opposite one.
#[must_use]
pub fn scramble(moves: u64, seed: u64) -> Vec<Turn> {
    // Not the stream that cubes, hands and cells are drawn from.
    let mut random = Pcg64::seed_from_u64(seed ^ 0x5ca4_b1e5_0000_0000);
    let mut turns: Vec<Turn> = Vec::new();
    while (turns.len() as u64) < moves {
        let turn = Turn::from_index(random.random_range(0..18));
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

/// The cube after a scramble.
#[must_use]
pub fn scrambled(turns: &[Turn]) -> Facelets {
    turns.iter().fold(Facelets::solved(), |cube, turn| cube.turned(*turn))
}

/// Accuracy and speed.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// Trials that were solved within the time.
    pub passed: u64,
    /// All of them.
    pub trials: u64,
    /// The longest row of consecutive passed trials.
    pub longest_row: u64,
    /// Simulated time of a trial that passed, from the start to the hand-back (s).
    pub trial_s: Spread,
    /// Simulated time for each face turn of a trial that passed (s).
    pub turn_s: Spread,
}

/// Scores trials; one that takes longer than `limit` (s) of simulated time has not passed.
#[must_use]
pub fn score(tally: &Tally, limit: f64) -> Score {
    let passed = |run: &RunResult| {
        run.verdict == Verdict::Solved
            && run.figures.as_ref().is_some_and(|f| f.sim_time_s <= limit)
    };
    let (mut longest_row, mut row) = (0, 0);
    // A trial that is missing ends a row as one that failed.
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
        turn_s: Spread::of(
            good().filter(|f| f.turns > 0).map(|f| f.sim_time_s / f64::from(f.turns)),
        ),
    }
}

/// Distance of the nearest tool from the cube when each trial began, in the plant, by seed (mm).
pub fn clearances(tally: &Tally) -> impl Iterator<Item = (u64, f64)> {
    tally.results.iter().filter_map(|r| Some((r.seed, r.figures.as_ref()?.clearance_mm?)))
}

impl Score {
    /// Whether every trial passed, one after the other.
    #[must_use]
    pub(crate) fn is_whole(&self) -> bool {
        self.trials > 0 && self.passed == self.trials
    }

    /// As a part of the benchmark's object.
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
    fn a_scramble_has_its_moves_and_none_that_undoes_another() {
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
        // The shorter one begins the longer one.
        assert_eq!(scramble(5, 3), scramble(20, 3)[..5]);
    }

    #[test]
    fn a_few_moves_are_undone_by_their_inverses() {
        let turns = scramble(5, 1);
        let back = turns.iter().rev().fold(scrambled(&turns), |c, t| c.turned(t.inverse()));
        assert_eq!(back, Facelets::solved());
    }

    #[test]
    fn a_tier_is_read_as_it_is_written() {
        assert_eq!(tier("5-20"), Ok(Kind::Tier { trials: 5, moves: 20 }));
        for wrong in ["", "5", "0-20", "5-0", "5-", "-5-20", "5-20-1", "5-1001", "99999999999-1"] {
            assert!(tier(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn one_failure_or_one_late_trial_spoils_a_tier_and_is_counted() {
        let header = header(5, "1/1");
        let results = header.seeds().map(|s| (s, result(s, Verdict::Solved, s as f64))).collect();
        let mut state = State { header, results, whole: 0, torn: false };
        let all = score(&Tally::of(&state), 1000.0);
        assert!(all.is_whole() && all.longest_row == 5 && all.trial_s.max == 409.0);

        // 400 + seed seconds: the last one of 5..=9 is late.
        let late = score(&Tally::of(&state), 408.5);
        assert_eq!((late.is_whole(), late.passed, late.longest_row), (false, 4, 4));
        state.results.insert(6, result(6, Verdict::Failed, 6.0));
        let failed = score(&Tally::of(&state), 1000.0);
        assert_eq!((failed.passed, failed.longest_row), (4, 3));
        state.results.remove(&8);
        let missing = score(&Tally::of(&state), 1000.0);
        assert!(!missing.is_whole(), "a trial that is missing");
        // 5, 7 and 9 are left, none beside another one.
        assert_eq!((missing.passed, missing.longest_row), (3, 1));
    }
}
