//! Conversions between motor positions, joint positions and poses of an IRp-6.
//!
//! - in: the constants of an arm ([`ArmModel`], data of `scenarios/arms`), motor or joint
//!   positions, poses
//! - out: poses, joint and motor positions, the Jacobian, and every limit that is exceeded
//! - source: the `IRp-6` kinematics of the original system (Zieliński et al. 2007). The joint
//!   variables are those of its later Denavit-Hartenberg form: q3, q4 relative, `t3 = q2 + q3 +
//!   pi/2`, `t4 = t3 + q4`
//!
//! The base frame is on the floor with z up. On the track it stays at d0 = 0 while the arm moves
//! along y. All functions are in closed form and free of allocation, since the servo calls them in
//! each 2 ms period.

mod forward;
mod inverse;
mod limits;
mod transmission;

pub use forward::Matrix6x7;
pub use inverse::Branches;

use crate::motion::AXES;
use serde::{Deserialize, Serialize};

/// Geometry, transmissions and limits of an IRp-6 arm, as a file of `scenarios/arms` gives them.
///
/// ```
/// use rubik_robot_vocabulary::kinematics::ArmModel;
///
/// let profile = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenarios/arms/irp6_track.toml");
/// let arm: ArmModel = toml::from_str(&std::fs::read_to_string(profile)?)?;
///
/// // Lengths are in metres: lower arm, upper arm, wrist.
/// assert_eq!(arm.links, [0.455, 0.67, 0.19]);
/// assert!(arm.has_track);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmModel {
    /// Lengths of lower arm a2, upper arm a3 and wrist d5 (m).
    pub links: [f64; 3],
    /// Height of the shoulder above the base frame (m).
    pub shoulder_height: f64,
    /// Whether the arm is on a track along y of the base.
    pub has_track: bool,
    /// Joint limits, low and high (m or rad).
    pub joint_limits: [(f64, f64); AXES],
    /// Motor limits, low and high (rad).
    pub motor_limits: [(f64, f64); AXES],
    /// Encoder increments per motor revolution.
    pub increments: [f64; AXES],
    /// Motor angle per joint variable of the geared axes (rad/m or rad/rad). The entries of the
    /// screw axes 2 and 3 are per screw length (rad/mm).
    pub gears: [f64; AXES],
    /// Motor position at the synchronisation pose (rad).
    pub sync: [f64; AXES],
    /// Joint offsets th1..th6 of the calibrated models (rad); 0 in the nominal one.
    pub offsets: [f64; AXES],
    /// Constants of the lower-arm screw: sl (mm2), mi (mm2), ni (mm2), l0 (mm). The screw has the
    /// length `sqrt(sl + mi cos a - ni sin a)` at the link angle a, and l0 at the synchronisation
    /// position.
    pub lower_screw: [f64; 4],
    /// Constants of the upper-arm screw, in the same order.
    pub upper_screw: [f64; 4],
    /// Largest speed of a set value (rad/s of the motor).
    pub motor_speed_limit: f64,
}

/// Returns the arm of `scenarios/arms` with this name, for tests.
#[cfg(test)]
fn builtin(name: &str) -> Option<ArmModel> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenarios/arms");
    let text = std::fs::read_to_string(format!("{folder}/{name}.toml")).ok()?;
    toml::from_str(&text).ok()
}
