//! How fast motors turn along a way of their arm.
//!
//! - in: the arm's model, its joint positions along the way
//! - out: how far its fastest motor turns from one moment to the next

use crate::kinematics::ArmModel;
use crate::motion::JointPositions;

/// Moments at which a way is looked at.
pub(super) const MOMENTS: u32 = 60;
/// Share of the motors' speed limit that a way uses at most: the servo refuses set values beyond
/// the limit, and corrections come on top of a way.
pub(super) const MOTORS: f64 = 0.95;

/// Returns the farthest that any motor turns from one of [`MOMENTS`] to the next (rad) on a way
/// that begins at `from` and is `at` there after a share of its time.
pub(super) fn farthest_turn(
    model: &ArmModel,
    from: &JointPositions,
    mut at: impl FnMut(f64) -> JointPositions,
) -> f64 {
    let mut last = model.motors(from);
    (1..=MOMENTS)
        .map(|moment| {
            let here = model.motors(&at(f64::from(moment) / f64::from(MOMENTS)));
            let turns = here.0.iter().zip(last.0).map(|(here, last)| (here - last).abs());
            let farthest = turns.fold(0.0, f64::max);
            last = here;
            farthest
        })
        .fold(0.0, f64::max)
}
