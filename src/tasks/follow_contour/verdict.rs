//! The verdict on the task `follow_contour`, by the objects of the plant: the force on the contour
//! and its length, the parts at their places, and the hand-over.
//!
//! The contour is the first fixed object with a curve; the parts are the loose objects, in the
//! order of the keys.

use super::door::FollowContour;
use super::keys::Keys;
use crate::cell::{MOST_ARMS, PerArm};
use crate::hw::plant::{ObjectState, Plant};
use crate::registry::{Judgement, Truth, Verdict};
use nalgebra::Vector3;

/// Distance from its place within which a part must lie (m): the errors of two bases.
const PLACE: f64 = 0.05;
/// Share of the ordered length that must be covered: the ball's place may be wrong by some mm.
const COVERED: f64 = 0.95;
/// Greatest force error, as a share of the wanted force (r.m.s.).
const ERROR: f64 = 0.3;
/// Time between two looks at the plant (ticks of 2 ms).
const LOOK: u64 = 5;

/// Judge of the task.
#[derive(Debug, Default)]
pub struct Done {
    /// One entry an object: whether each hand held it when it was last seen.
    held: Vec<PerArm<bool>>,
    /// Number of times that the first hand was left alone with a part that both had held.
    handed: u32,
}

impl Done {
    /// Notes the hands at an object.
    fn note(&mut self, object: usize, now: PerArm<bool>) {
        if self.held.len() <= object {
            self.held.resize(object + 1, [false; MOST_ARMS]);
        }
        let before = std::mem::replace(&mut self.held[object], now);
        self.handed += u32::from(before[..2] == [true; 2] && now[..2] == [true, false]);
    }
}

impl Verdict for Done {
    type Task = FollowContour;

    fn watch(&mut self, tick: u64, plant: &Plant) {
        if tick.is_multiple_of(LOOK) {
            for (i, object) in plant.objects().enumerate() {
                self.note(i, object.held_by);
            }
        }
    }

    fn judge(&self, keys: &Keys, truth: &Truth) -> Judgement {
        let objects = &truth.verdict.objects;
        let contour = objects.iter().map(|object| &object.touch).find(|touch| touch.length > 0.0);
        let error = contour.map_or(f64::NAN, |touch| touch.force_error(keys.force));
        let covered = contour.map_or(0.0, |touch| touch.covered);
        let loose = objects.iter().filter(|o| o.state != ObjectState::Fixed);
        let off: Vec<f64> = loose
            .clone()
            .zip(&keys.goals_xyz)
            .map(|(o, goal)| match o.state {
                ObjectState::Resting => {
                    (o.world_from_object.translation.vector - Vector3::from(*goal)).norm()
                }
                _ => f64::INFINITY,
            })
            .collect();
        let drops: u32 = loose.map(|object| object.drops).sum();
        let placed = off.iter().filter(|off| **off < PLACE).count();
        let right = error < ERROR * keys.force
            && covered > COVERED * keys.length
            && (placed, self.handed, drops) == (keys.goals_xyz.len(), 1, 0);
        let words = format!(
            "the force on the contour had an error of {error:.1} N r.m.s. over {:.0} mm, {placed} \
             of {} parts are at their places, hand-overs: {}, drops: {drops}",
            covered * 1e3,
            keys.goals_xyz.len(),
            self.handed
        );
        let off: Vec<f64> = off.iter().map(|off| off * 1e3).collect();
        Judgement::new(right, words)
            .with("force_error_n", error)
            .with("most_force_n", contour.map(|touch| touch.most_force))
            .with("contacts", contour.map(|touch| touch.contacts))
            .with("covered_mm", covered * 1e3)
            .with("parts_off_mm", off)
            .with("hand_overs", self.handed)
            .with("part_drops", drops)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hand_over_counts_only_from_both_hands() {
        let mut done = Done::default();
        let mut after = |[first, second]: [bool; 2]| {
            done.note(3, [first, second, false, false]);
            done.handed
        };

        assert_eq!(after([false, true]), 0);
        assert_eq!(after([true, false]), 0, "thrown from hand to hand");
        assert_eq!(after([true, true]), 0);
        assert_eq!(after([false, true]), 0, "the first hand has let go");
        assert_eq!(after([true, true]), 0);
        assert_eq!(after([true, false]), 1);
    }
}
