//! The verdict on the task `carry_bar`: the way and the internal force of the plant's bar.

use super::super::patrol::Courses;
use super::door::CarryBar;
use super::keys::Keys;
use super::{CARRIERS, upright};
use crate::hw::plant::{ObjectState, ObjectTruth, Plant};
use crate::registry::{Judgement, Truth, Verdict};
use nalgebra::Vector3;

/// Name of the bar in the scenario's list of objects.
const BAR: &str = "bar";
/// Distance and turn from its place within which the bar must lie at the end (m, rad).
const PLACED: (f64, f64) = (0.012, 0.035);
/// Share of the ordered lift by which the bar must have been lifted.
const LIFTED: f64 = 0.8;

/// Height above its start from which a bar that is let go falls (m); below it is laid down.
const FALLS: f64 = 0.003;

/// Distance beyond the radius of the corners within which the bar must pass each point (m).
const PASSES: f64 = 0.01;
/// Periods between two looks at the way of the bar.
const LOOK: u64 = 20;

/// Judge of the task.
#[derive(Debug, Default)]
pub struct BarCarried {
    /// Place of the bar's centre before the first period (m).
    start: Option<Vector3<f64>>,
    /// Greatest height above it (m).
    lifted: f64,
    /// Places of the bar's centre beside its start, each [`LOOK`] periods (m).
    track: Vec<Vector3<f64>>,
    /// Height above it in the period before (m).
    before: f64,
    /// Number of times that the hands had let the bar go until then, and of its falls.
    drops: (u32, u32),
    /// Rounds of the arms that do not carry.
    alone: Courses,
}

impl Verdict for BarCarried {
    type Task = CarryBar;

    fn watch(&mut self, tick: u64, plant: &Plant) {
        self.alone.follow(tick, plant, CARRIERS);
        let Some(bar) = plant.objects().find(|object| &*object.name == BAR) else { return };
        let place = bar.world_from_object.translation.vector;
        let start = *self.start.get_or_insert(place);
        let height = place.z - start.z;
        self.lifted = self.lifted.max(height);
        if bar.drops > self.drops.0 {
            self.drops.0 = bar.drops;
            self.drops.1 += u32::from(self.before > FALLS);
        }
        self.before = height;
        if tick.is_multiple_of(LOOK) {
            self.track.push(place - start);
        }
    }

    fn judge(&self, keys: &Keys, truth: &Truth) -> Judgement {
        let bar = truth.verdict.objects.iter().find(|object| &*object.name == BAR);
        let (Some(bar), Some(start)) = (bar, self.start) else {
            return Judgement::new(false, "the plant has no object named \"bar\"");
        };
        let mut judgement = self.judge_bar(bar, &start, keys);
        if keys.rounds == 0 {
            return judgement;
        }
        let rounds = self.alone.rounds();
        if rounds.iter().any(|done| *done != keys.rounds) {
            judgement.right = false;
            let words = judgement.words;
            judgement.words =
                format!("{words}; the other arms went {rounds:?} of {} rounds", keys.rounds);
        }
        judgement.with("rounds", rounds).with("ended_s", self.alone.ended())
    }
}

impl BarCarried {
    /// Returns the number of points of the way that the bar did not pass.
    fn missed(&self, keys: &Keys) -> usize {
        let passed = |[x, y]: &&[f64; 2]| {
            let point = Vector3::new(*x, *y, keys.lift);
            self.track.iter().any(|place| (place - point).norm() < keys.radius + PASSES)
        };
        keys.way.len() - keys.way.iter().filter(passed).count()
    }

    /// Judges the bar at the end. `start` is its place at the beginning (m).
    fn judge_bar(&self, bar: &ObjectTruth, start: &Vector3<f64>, keys: &Keys) -> Judgement {
        let [x, y] = keys.way.last().copied().unwrap_or_default();
        let turn = keys.turns.last().copied().unwrap_or_default();
        let wanted = upright(start + Vector3::new(x, y, 0.0), keys.bar_yaw + turn);
        let off = (bar.world_from_object.translation.vector - wanted.translation.vector).norm();
        let turned = bar.world_from_object.rotation.angle_to(&wanted.rotation);
        let internal = bar.internal;
        let mut wrong = Vec::new();
        if bar.state != ObjectState::Resting || off > PLACED.0 || turned > PLACED.1 {
            wrong.push(format!(
                "it is {:?}, {:.1} mm and {:.1} deg from its place",
                bar.state,
                off * 1e3,
                turned.to_degrees()
            ));
        }
        if self.lifted < LIFTED * keys.lift {
            wrong.push(format!("it was lifted by {:.0} mm", self.lifted * 1e3));
        }
        let missed = self.missed(keys);
        if missed > 0 {
            wrong.push(format!("it missed {missed} points of its way"));
        }
        if internal.periods == 0 || internal.p99_force >= keys.internal {
            wrong.push(format!("its internal force was {:.1} N", internal.p99_force));
        }
        let falls = self.drops.1;
        if falls + bar.slips > 0 {
            wrong.push(format!("it fell {falls} times and slipped {} times", bar.slips));
        }
        let words = if wrong.is_empty() {
            format!("the bar is at its place; internal force {:.1} N", internal.p99_force)
        } else {
            format!("the bar is not carried as ordered: {}", wrong.join("; "))
        };
        Judgement::new(wrong.is_empty(), words)
            .with("internal_p99_n", internal.p99_force)
            .with("internal_most_n", internal.most_force)
            .with("internal_torque_most_nm", internal.most_torque)
            .with("placed_off_mm", off * 1e3)
            .with("placed_turned_deg", turned.to_degrees())
            .with("lifted_mm", self.lifted * 1e3)
            .with("falls", falls)
            .with("slips", bar.slips)
            .with("carried_s", internal.periods as f64 * crate::motion::PERIOD)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::MOST_ARMS;
    use crate::hw::plant::{Internal, TouchTruth};

    /// The way has two points 100 mm apart, 100 mm above the start.
    #[test]
    fn bar_must_pass_each_point_of_way() {
        let way = vec![[0.1, 0.0], [0.2, 0.0]];
        let keys = Keys { way, lift: 0.1, radius: 0.02, ..Keys::default() };
        let missed = |track: &[[f64; 3]]| {
            let track = track.iter().map(|place| Vector3::from(*place)).collect();
            BarCarried { track, ..BarCarried::default() }.missed(&keys)
        };

        assert_eq!(missed(&[[0.1, 0.02, 0.1], [0.2, 0.0, 0.1]]), 0);
        assert_eq!(missed(&[[0.1, 0.0, 0.1]]), 1);
        assert_eq!(missed(&[[0.1, 0.0, 0.0], [0.2, 0.0, 0.0]]), 2, "never lifted");
    }

    /// A bar at its place that has fallen or slipped on its way is not carried as ordered.
    #[test]
    fn fallen_bar_at_its_place_is_wrong() {
        let keys = Keys { way: vec![[0.1, 0.0]], turns: vec![0.0], ..Keys::default() };
        let start = Vector3::new(0.6, 1.0, 0.9);
        let internal = Internal { periods: 1, ..Internal::default() };
        let bar = |slips| ObjectTruth {
            name: BAR.into(),
            size: Vector3::zeros(),
            world_from_object: upright(start + Vector3::new(0.1, 0.0, 0.0), keys.bar_yaw),
            state: ObjectState::Resting,
            held_by: [false; MOST_ARMS],
            force: [0.0; MOST_ARMS],
            most_force: 0.0,
            internal,
            grasps: [1; MOST_ARMS],
            drops: 1,
            slips,
            touch: TouchTruth::default(),
        };
        let judged = |drops, slips| {
            let track = vec![Vector3::new(0.1, 0.0, keys.lift)];
            let judge = BarCarried { lifted: keys.lift, track, drops, ..BarCarried::default() };
            judge.judge_bar(&bar(slips), &start, &keys)
        };

        let good = judged((1, 0), 0);
        assert!(good.right, "{}", good.words);
        for wrong in [judged((1, 1), 0), judged((1, 0), 1)] {
            assert!(!wrong.right && wrong.words.contains("it fell"), "{}", wrong.words);
        }
    }
}
