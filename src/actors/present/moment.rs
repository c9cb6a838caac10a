//! The latest values at the moment of a snapshot.

use crate::actors::latest::{ArmLatest, Latest};
use crate::kernel::Picture;
use crate::operator::parameter::Courses;
use crate::operator::{Question, ServoTiming};
use crate::spatial::Pose;
use serde_json::Value;
use std::collections::BTreeMap;

/// The latest values at one moment.
pub(super) struct Moment {
    /// Time of the run (s).
    pub(super) time: f64,
    /// State of each arm, with its peaks since the last snapshot.
    pub(super) arms: Vec<ArmLatest>,
    /// Punctuality of a servo under the wall clock since the last snapshot.
    pub(super) servo: Option<ServoTiming>,
    /// Belief of the kernel.
    pub(super) picture: Option<Picture>,
    /// Latest reading of each sensor of a user's own.
    pub(super) sensors: BTreeMap<String, Value>,
    /// Pose of each loose object in the simulated plant.
    pub(super) objects: BTreeMap<String, Pose>,
    /// Courses of the operator's parameters; `None` before the first order.
    pub(super) courses: Option<Courses>,
    /// Activity of MP.
    pub(super) mp: &'static str,
    /// Whether the operator may move arms by hand.
    pub(super) manual: bool,
    /// Order of each ECP; `None` in a replay, since a recording holds no orders.
    pub(super) orders: Option<Vec<Option<&'static str>>>,
    /// Open question.
    pub(super) question: Option<Question>,
}

impl Moment {
    /// Copies the latest values for a snapshot at `time` (s). Resets those that count between two
    /// snapshots: the peaks of the arms and the punctuality of the servo.
    pub(super) fn of(latest: &mut Latest, time: f64) -> Self {
        // Each peak is shown in one snapshot. Without a new period since the last one, the present
        // state is the peak: an empty one would appear as a force of 0.
        let read = |arm: &mut ArmLatest| {
            let mut peaks = std::mem::take(&mut arm.peaks);
            peaks.take(&arm.state);
            ArmLatest { state: arm.state, peaks }
        };
        let servo = latest.punctual.as_ref().map(|(switches, period)| {
            let (late, work, missed) = switches.punctual.take();
            // The servo measures in nanoseconds; `missed` counts since the beginning of the run.
            let (late, work) = (late as f64 * 1e-9, work as f64 * 1e-9);
            ServoTiming { period: *period, late, work, missed }
        });
        Self {
            time,
            arms: latest.arms.iter_mut().map(read).collect(),
            servo,
            picture: latest.picture.clone(),
            sensors: latest.sensors.clone(),
            objects: latest.objects.clone(),
            courses: latest.courses,
            mp: latest.mp,
            manual: latest.manual,
            orders: (!latest.replayed).then(|| latest.orders.clone()),
            question: latest.question.clone(),
        }
    }
}
