//! Watch for what no arm may do after a stop.
//!
//! - in: power stages of all arms in each period, and the joints that their motors hold
//! - out: counts of [`Violations`]
//!
//! | rule | threshold | reason |
//! |---|---|---|
//! | drives that went off stay off | | only a person may end a stop |
//! | arms rest after drives went off | [`SETTLED`], [`MOVING`] | the other arm yields for 0.5 s |
//!
//! An arm that brakes stop at full speed swings in its springs for longer: once at 0.11 rad/s after
//! 0.56 s. No controller can end that, so the motors count and not the links.

use super::verdict::Violations;
use crate::cell::PerArm;
use crate::motion::AXES;

/// Time from the stop to the rest of all arms (s). A run ends some 0.6 s after its stop.
const SETTLED: f64 = 0.55;
/// Speed of a joint that counts as motion (rad/s or m/s). An arm that has yielded still does half
/// of it then.
const MOVING: f64 = 0.1;

/// State of the watch.
#[derive(Debug, Clone, Default)]
pub(super) struct StopWatch {
    /// Whether each arm's drives were on in the last period.
    on: PerArm<bool>,
    /// Joints that the motors of each arm hold, in the last period after a stop (rad or m).
    joints: PerArm<[f64; AXES]>,
    /// Time of the first stop (s).
    stopped: Option<f64>,
    /// Whether a motion after it is counted.
    counted: bool,
}

impl StopWatch {
    /// Returns whether the drives of each arm were on in the last period.
    pub(super) fn on(&self) -> PerArm<bool> {
        self.on
    }

    /// Compares the arms with the rules at `time` (s), `dt` (s) after the last call: whether the
    /// drives of each are `on`, and the `joints` that its motors hold (rad or m). Adds each broken
    /// rule to `violations`.
    pub(super) fn watch(
        &mut self,
        (time, dt): (f64, f64),
        on: PerArm<bool>,
        joints: impl FnOnce() -> PerArm<[f64; AXES]>,
        violations: &mut Violations,
    ) {
        let was_on = std::mem::replace(&mut self.on, on);
        for (was, is) in was_on.into_iter().zip(on) {
            if was && !is {
                self.stopped.get_or_insert(time);
            }
            if !was && is && self.stopped.is_some() {
                violations.restarts += 1;
            }
        }
        // Nearly all periods of a run come before any stop.
        let Some(stopped) = self.stopped.filter(|_| !self.counted) else { return };
        let joints = joints();
        let from = std::mem::replace(&mut self.joints, joints);
        if time <= stopped + SETTLED {
            return;
        }
        let steps = from.as_flattened().iter().zip(joints.as_flattened());
        let speeds = steps.map(|(from, to)| (to - from).abs() / dt).enumerate();
        let fastest = speeds.max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((joint, speed)) = fastest.filter(|(_, speed)| *speed > MOVING) {
            tracing::debug!(
                target: "rubik_robot::truth",
                arm = joint / AXES, joint = joint % AXES, speed, time, stopped,
                "motion after a stop"
            );
            self.counted = true;
            violations.moved_after_stop += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::MOST_ARMS;

    /// Returns what a watch counts at these moments, 2 ms after each other from `begin` (s) on: the
    /// drives that are on, and the first joint of the second arm (rad).
    fn counted(begin: f64, moments: &[(PerArm<bool>, f64)]) -> Violations {
        let (mut watch, mut violations) = (StopWatch::default(), Violations::default());
        for (period, &(on, joint)) in moments.iter().enumerate() {
            let mut joints = [[0.0; AXES]; MOST_ARMS];
            joints[1][0] = joint;
            let time = begin + 2e-3 * period as f64;
            watch.watch((time, 2e-3), on, || joints, &mut violations);
        }
        violations
    }

    #[test]
    fn arm_may_yield_but_not_move_after_stop() {
        let (on, held) = ([true; MOST_ARMS], [false, true, true, true]);
        // Returns what is counted if the arm moves at `speed` (rad/s) this many periods after the
        // stop. The arm may yield for 275 periods, `SETTLED`.
        let after = |periods: usize, speed: f64| {
            let mut moments = vec![(on, 0.0), (held, 0.1)];
            moments.resize(periods, (held, 0.1));
            moments.push((held, 0.1 - 2e-3 * speed));
            counted(1.0, &moments)
        };
        // A joint moves above 0.1 rad/s, `MOVING`.
        let none = Violations::default();

        assert_eq!(after(270, 2.0), none, "yields");
        assert_eq!(after(280, 0.09), none, "rests");
        assert_eq!(after(280, 0.11), Violations { moved_after_stop: 1, ..none });
        assert_eq!(
            counted(0.0, &[(on, 0.0), (held, 0.0), (on, 0.0)]),
            Violations { restarts: 1, ..none }
        );
        // Drives that go on at the beginning break no rule, and neither does motion without a stop.
        assert_eq!(counted(0.0, &[([false; MOST_ARMS], 0.0), (on, 0.0), (on, 9.0)]), none);
    }
}
