//! Motor <-> joint <-> pose of an IRp-6.

use crate::motion::AXES;
use serde::{Deserialize, Serialize};

/// Geometry, transmissions and limits of an IRp-6 arm, as data (irp6 profile of the scenario).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ArmModel {
    /// Lower arm a2, upper arm a3, wrist d5 [m].
    pub links: [f64; 3],
    /// Height of the shoulder above the base frame [m].
    pub shoulder_height: f64,
    /// Whether the arm stands on a track along the base's y.
    pub has_track: bool,
    /// Joint limits, low and high [m or rad].
    pub joint_limits: [(f64, f64); AXES],
    /// Motor limits, low and high [rad].
    pub motor_limits: [(f64, f64); AXES],
    /// Encoder increments per motor revolution.
    pub increments: [f64; AXES],
    /// Motor angle per joint variable of the geared axes [rad/m or rad/rad]; entries of the screw axes 2, 3
    /// are per mm of screw length.
    pub gears: [f64; AXES],
    /// Motor position at the synchronisation pose [rad].
    pub sync: [f64; AXES],
    /// Joint offsets th1..th6 of the calibrated models; 0 in the nominal one [rad].
    pub offsets: [f64; AXES],
    /// Lower-arm screw: sl [mm2], mi [mm2], ni [mm2], l0 [mm].
    pub lower_screw: [f64; 4],
    /// Upper-arm screw, the same.
    pub upper_screw: [f64; 4],
    /// Largest speed of a set value [rad/s of motor].
    pub motor_speed_limit: f64,
}
