//! The verdict on the task `patrol`: rounds, counted at the tools of the plant.

use super::door::Patrol;
use super::keys::Keys;
use crate::hw::plant::Plant;
use crate::motion::PERIOD;
use crate::registry::{Judgement, Truth, Verdict};
use nalgebra::Vector3;

/// Distance from its first place at which a tool is away (m).
const AWAY: f64 = 0.02;
/// Distance from its first place within which a tool is back (m).
const BACK: f64 = 0.002;
/// Time for which a tool must be back, so that one that only passes does not count (ticks of 2 ms).
const STAYS: u32 = 50;

/// Judge of the task.
#[derive(Debug, Default)]
pub struct RoundsDone(Courses);

/// Rounds of the tools of arms.
#[derive(Debug, Default)]
pub(in crate::tasks) struct Courses {
    /// One entry an arm.
    arms: Vec<Course>,
}

impl Courses {
    /// Follows the tools of all arms from the arm `first` on, at the time `tick`.
    pub(in crate::tasks) fn follow(&mut self, tick: u64, plant: &Plant, first: usize) {
        let scene = plant.scene();
        let tools = scene.arms.iter().take(scene.arm_count).skip(first);
        for (arm, tool) in tools.enumerate() {
            let place = tool.world_from_tool.translation.vector;
            if self.arms.len() == arm {
                self.arms.push(Course::from(place));
            }
            self.arms[arm].follow(tick, place);
        }
    }

    /// Returns the number of rounds of each arm.
    pub(in crate::tasks) fn rounds(&self) -> Vec<u32> {
        self.arms.iter().map(|arm| arm.rounds).collect()
    }

    /// Returns the time at which the last round of each arm was counted (s).
    pub(in crate::tasks) fn ended(&self) -> Vec<f64> {
        self.arms.iter().map(|arm| arm.counted as f64 * PERIOD).collect()
    }
}

/// Course of one tool.
#[derive(Debug)]
struct Course {
    /// First place of the tool in the world (m).
    home: Vector3<f64>,
    /// Whether the tool has been away since it was last back.
    away: bool,
    /// Number of ticks for which the tool has been back.
    stays: u32,
    rounds: u32,
    /// Time at which the last round was counted (ticks of 2 ms).
    counted: u64,
}

impl Course {
    /// Makes the course of a tool that begins at `home` (m).
    fn from(home: Vector3<f64>) -> Self {
        Self { home, away: false, stays: 0, rounds: 0, counted: 0 }
    }

    /// Follows the tool to its `place` (m) at the time `tick`, and counts a round when it is back.
    fn follow(&mut self, tick: u64, place: Vector3<f64>) {
        let distance = (place - self.home).norm();
        self.away |= distance > AWAY;
        self.stays = if distance < BACK { self.stays + 1 } else { 0 };
        if self.away && self.stays >= STAYS {
            self.away = false;
            self.rounds += 1;
            self.counted = tick;
        }
    }
}

impl Verdict for RoundsDone {
    type Task = Patrol;

    fn watch(&mut self, tick: u64, plant: &Plant) {
        self.0.follow(tick, plant, 0);
    }

    fn judge(&self, keys: &Keys, _: &Truth) -> Judgement {
        let rounds = self.0.rounds();
        let right = !rounds.is_empty() && rounds.iter().all(|done| *done == keys.rounds);
        let words: Vec<String> = rounds.iter().map(u32::to_string).collect();
        let words = format!("the arms went {} of {} rounds", words.join(" and "), keys.rounds);
        Judgement::new(right, words).with("rounds", rounds).with("ended_s", self.0.ended())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_counts_once_and_only_at_rest() {
        let at = |x: f64| Vector3::new(x, 0.0, 0.0);
        let mut course = Course::from(at(0.0));
        let mut go = |x: f64, ticks: u32| {
            (0..ticks).for_each(|tick| course.follow(u64::from(tick), at(x)));
            course.rounds
        };

        assert_eq!(go(0.0, 500), 0, "a tool that never left");
        assert_eq!(go(0.05, 10), 0);
        assert_eq!(go(0.0, STAYS - 1), 0, "a tool that only passes");
        assert_eq!(go(0.05, 10), 0);
        assert_eq!(go(0.0, 500), 1);
        assert_eq!(go(0.01, 10) + go(0.0, 500), 2, "a tool that left too little");
    }
}
