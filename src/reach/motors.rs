//! The turns of the motors along a path of their arm, from which their speeds follow.
//!
//! - in: the arm's model, its joint positions along the path
//! - out: the largest angle by which a motor turns from one moment to the next (rad)

use crate::kinematics::ArmModel;
use crate::motion::JointPositions;

/// Number of intervals of equal time at whose ends (the moments) a path is checked.
pub(super) const MOMENTS: u32 = 60;
/// Share of the motors' speed limit that a path uses at most. The servo refuses set values beyond
/// the limit, and corrections add to the speed of a path.
pub(super) const MOTORS: f64 = 0.95;

/// Returns the largest angle by which any motor turns in one of the [`MOMENTS`] equal intervals of
/// a path's time (rad). The path begins at `from`, and `at` returns its joint positions after a
/// share of its time (0..=1).
pub(super) fn farthest_turn(
    model: &ArmModel,
    from: &JointPositions,
    mut at: impl FnMut(f64) -> JointPositions,
) -> f64 {
    // The wrist's motors are coupled, so the joints' speeds do not show those of the motors.
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
