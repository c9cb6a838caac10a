//! The latest values at the moment at which a snapshot is made.

use crate::actors::latest::{ArmLatest, Latest};
use crate::operator::{Question, ServoTiming};
use crate::tasks::Picture;

/// The latest values at one moment.
pub(super) struct Moment {
    /// Time of the run (s).
    pub(super) time: f64,
    /// Each arm's state, with its peaks since the moment before.
    pub(super) arms: Vec<ArmLatest>,
    /// The punctuality of a servo under the wall clock since the moment before.
    pub(super) servo: Option<ServoTiming>,
    /// The kernel's belief.
    pub(super) picture: Option<Picture>,
    /// MP's activity.
    pub(super) mp: &'static str,
    /// Arms may be moved by hand.
    pub(super) manual: bool,
    /// The order of each ECP; `None` in a replay, which has none recorded.
    pub(super) orders: Option<[Option<&'static str>; 2]>,
    /// The open question.
    pub(super) question: Option<Question>,
}

impl Moment {
    /// Reads the latest values. Peaks and punctuality begin anew with this.
    pub(super) fn of(latest: &mut Latest, time: f64) -> Self {
        let read = |arm: &mut ArmLatest| ArmLatest {
            state: arm.state,
            peaks: std::mem::take(&mut arm.peaks),
        };
        let servo = latest.punctual.as_ref().map(|(switches, period)| {
            let (late, work, missed) = switches.punctual.take();
            let (late, work) = (late as f64 * 1e-9, work as f64 * 1e-9);
            ServoTiming { period: *period, late, work, missed }
        });
        Self {
            time,
            arms: latest.arms.iter_mut().map(read).collect(),
            servo,
            picture: latest.picture.clone(),
            mp: latest.mp,
            manual: latest.manual,
            orders: (!latest.replayed).then_some(latest.orders),
            question: latest.question.clone(),
        }
    }
}
