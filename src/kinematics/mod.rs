//! Motor <-> joint <-> pose of an IRp-6.
//!
//! - in: an arm's constants ([`ArmModel`], data of `scenarios/arms`), motor or joint positions, poses
//! - out: poses, joint and motor positions, the Jacobian, and every limit that is exceeded
//! - source: the `IRp-6` kinematics of the original system (Zieliński et al. 2007); joint variables as in its
//!   later Denavit-Hartenberg form: q3, q4 relative, `t3 = q2 + q3 + pi/2`, `t4 = t3 + q4`
//!
//! The base frame stands on the floor, z up; on the track it stays at d0 = 0 while the arm moves along y.
//! Everything here is closed form and free of allocation, since the servo calls it in each 2 ms period.

mod forward;
mod inverse;
mod limits;
mod transmission;

pub use forward::Matrix6x7;
pub use inverse::Branches;

use crate::motion::AXES;
use serde::{Deserialize, Serialize};

/// Geometry, transmissions and limits of an IRp-6 arm, as data (irp6 profile of the scenario).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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

/// Profiles that are built into the program, so that it runs anywhere: name and text.
const PROFILES: [(&str, &str); 4] = [
    ("irp6_track", include_str!("../../scenarios/arms/irp6_track.toml")),
    ("irp6_postument", include_str!("../../scenarios/arms/irp6_postument.toml")),
    ("irp6_track_2008", include_str!("../../scenarios/arms/irp6_track_2008.toml")),
    ("irp6_postument_2008", include_str!("../../scenarios/arms/irp6_postument_2008.toml")),
];

/// Names of the built-in profiles, without `.toml`.
pub const BUILTIN: [&str; 4] = [PROFILES[0].0, PROFILES[1].0, PROFILES[2].0, PROFILES[3].0];

/// Text of the built-in profile `name`; `None` when there is none of that name.
#[must_use]
pub fn builtin_text(name: &str) -> Option<&'static str> {
    PROFILES.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// The built-in profile `name`, one of [`BUILTIN`]; `None` when there is none of that name.
#[must_use]
pub fn builtin(name: &str) -> Option<ArmModel> {
    // The texts are part of the program; the tests below parse each of them.
    builtin_text(name).and_then(|text| toml::from_str(text).ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_builtin_profile_parses_and_its_limits_are_in_order() {
        for name in BUILTIN {
            let model: ArmModel = toml::from_str(builtin_text(name).unwrap()).unwrap();

            for axis in 0..AXES {
                let (joint, motor) = (model.joint_limits[axis], model.motor_limits[axis]);
                assert!(joint.0 <= joint.1 && motor.0 <= motor.1, "{name}, axis {axis}");
            }
            assert_eq!(model.has_track, name.contains("track"));
            assert_eq!(builtin(name), Some(model));
        }
        assert_eq!(builtin("irp7"), None);
    }

    #[test]
    fn a_profile_with_an_unknown_key_is_refused() {
        let text = format!("{}\nelbow = 3\n", builtin_text("irp6_postument").unwrap());

        let error = toml::from_str::<ArmModel>(&text).unwrap_err().to_string();

        assert!(error.contains("elbow"), "{error}");
    }
}
