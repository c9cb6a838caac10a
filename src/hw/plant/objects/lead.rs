//! Person who takes a tool by hand and pulls it along a way of points through a spring.
//!
//! - in: time, place and velocity of the tool
//! - out: the force on the tool
//! - the person's hand goes from point to point along straight lines with a minimum-jerk motion,
//!   rests at each point, and lets go after the last one
//! - only a force acts: an arm that does not yield stays where it is, and the force ends at the
//!   person's strength. The person never turns the tool

use super::spec::LeadConfig;
use super::tool::{Load, Tool};
use nalgebra::{Matrix3, Vector3};

/// Time in which the person takes hold, and lets go (s).
const TAKES: f64 = 0.3;

/// Person at a tool.
#[derive(Debug, Clone)]
pub(super) struct Lead {
    spec: LeadConfig,
    /// Place of the tool when the person took it (m).
    from: Option<Vector3<f64>>,
    /// Time since then (s).
    elapsed: f64,
    /// Place of the person's hand in the last substep (m).
    before: Option<Vector3<f64>>,
    /// Greatest force until now (N).
    pub(super) most: f64,
}

/// State of a lead in the plant's file: the place from which it began, and the time since (s).
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(in crate::hw::plant) struct SavedLead {
    from: Option<[f64; 3]>,
    elapsed: f64,
}

impl Lead {
    /// Makes a person who waits.
    pub(super) fn new(spec: &LeadConfig) -> Self {
        Self { spec: spec.clone(), from: None, elapsed: 0.0, before: None, most: 0.0 }
    }

    /// Returns the index of the arm that the person leads.
    pub(super) fn arm(&self) -> usize {
        self.spec.arm
    }

    /// Returns the state for the plant's file.
    pub(super) fn saved(&self) -> SavedLead {
        SavedLead { from: self.from.map(Into::into), elapsed: self.elapsed }
    }

    /// Continues from a saved state.
    pub(super) fn restore(&mut self, saved: &SavedLead) {
        (self.from, self.elapsed) = (saved.from.map(Into::into), saved.elapsed);
    }

    /// Returns the place of the person's hand `elapsed` (s) after it took the tool at `from`, and
    /// whether the hand has rested at its last point.
    fn hand(&self, from: &Vector3<f64>, elapsed: f64) -> (Vector3<f64>, bool) {
        let origin = if self.spec.relative { *from } else { Vector3::zeros() };
        let (mut at, mut left) = (*from, elapsed - TAKES);
        for point in &self.spec.points {
            let to = origin + Vector3::from(*point);
            let takes = (to - at).norm() / self.spec.speed;
            if left < takes {
                let share = (left / takes).clamp(0.0, 1.0);
                let smooth = share.powi(3) * (10.0 - share * (15.0 - 6.0 * share));
                return (at + (to - at) * smooth, false);
            }
            (at, left) = (to, left - takes);
            if left < self.spec.rest {
                return (at, false);
            }
            left -= self.spec.rest;
        }
        (at, true)
    }

    /// Adds to `load` the force of the person on a tool in the substep of `dt` (s) that ends at `t`
    /// (s).
    pub(super) fn pull(&mut self, tool: &Tool<'_>, load: &mut Load, t: f64, dt: f64) {
        let LeadConfig { stiffness, damping, most_force, begins, .. } = self.spec;
        // A lead that a saved state continues has begun already.
        if self.from.is_none() && t < begins {
            return;
        }
        let from = *self.from.get_or_insert(tool.frame.p);
        self.elapsed += dt;
        let (hand, done) = self.hand(&from, self.elapsed);
        if done {
            return;
        }
        let velocity = (hand - self.before.unwrap_or(hand)) / dt;
        self.before = Some(hand);
        let firm = (self.elapsed / TAKES).min(1.0);
        let (k, c) = (firm * stiffness, firm * damping);
        let mut force = (hand - tool.frame.p) * k + (velocity - tool.velocity) * c;
        // At the end of a person's strength the spring gives no more.
        let mut slope = Matrix3::identity() * k;
        if force.norm() > most_force {
            force *= most_force / force.norm();
            slope.fill(0.0);
        }
        self.most = self.most.max(force.norm());
        load.push(&tool.frame, &tool.frame.p, &force, &slope);
    }

    /// Returns whether the person has let go after the last point.
    pub(super) fn is_done(&self) -> bool {
        self.from.is_some_and(|from| self.hand(&from, self.elapsed).1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a person who leads a tool by 100 mm along x and then by 50 mm along z.
    fn lead() -> Lead {
        Lead::new(&LeadConfig {
            arm: 0,
            points: vec![[0.1, 0.0, 0.0], [0.1, 0.0, 0.05]],
            relative: true,
            speed: 0.05,
            rest: 0.5,
            stiffness: 500.0,
            damping: 20.0,
            most_force: 40.0,
            begins: 1.0,
        })
    }

    #[test]
    fn hand_rests_at_each_point_and_lets_go() {
        let lead = lead();
        let from = Vector3::new(1.0, 2.0, 3.0);
        let at = |elapsed: f64| {
            let (hand, done) = lead.hand(&from, elapsed + TAKES);
            (hand - from, done)
        };
        // 100 mm take 2 s, 50 mm take 1 s.
        assert!((at(1.0).0 - Vector3::new(0.05, 0.0, 0.0)).norm() < 1e-12);
        for (elapsed, place, done) in [
            (-0.1, [0.0, 0.0, 0.0], false),
            (2.1, [0.1, 0.0, 0.0], false),
            (3.6, [0.1, 0.0, 0.05], false),
            (4.1, [0.1, 0.0, 0.05], true),
        ] {
            let (hand, is_done) = at(elapsed);
            assert!((hand - Vector3::from(place)).norm() < 1e-12, "{elapsed}: {hand}");
            assert_eq!(is_done, done, "{elapsed}");
        }
    }
}
