//! The speed of the motors along a path of their arm.
//!
//! - in: the arm's model, its joint positions along the path
//! - out: the largest angle of a motor from one moment to the next

use crate::kinematics::ArmModel;
use crate::motion::JointPositions;

/// Number of moments at which a path is checked.
pub(super) const MOMENTS: u32 = 60;
/// Share of the motors' speed limit that a path uses at most. The servo refuses set values beyond
/// the limit, and corrections come on top of a path.
pub(super) const MOTORS: f64 = 0.95;

/// Returns the largest angle that any motor turns from one moment of a path to the next, of
/// [`MOMENTS`] in all (rad). The path begins at `from`, and `at` returns its joint positions after
/// a share of its time.
pub(super) fn farthest_turn(
    model: &ArmModel,
    from: &JointPositions,
    mut at: impl FnMut(f64) -> JointPositions,
) -> f64 {
    // Motors, not joints: the wrist's motors are coupled, so one joint's speed is not one motor's.
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
