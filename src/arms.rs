//! Profiles of arms that are built into the program, so that it runs without their files.
//!
//! - in: the name of a profile, which is a file of `scenarios/arms` without `.toml`
//! - out: the text of the profile, or the [`ArmModel`] that it describes

use crate::kinematics::ArmModel;

/// Names and texts of the profiles.
const PROFILES: [(&str, &str); 4] = [
    ("irp6_track", include_str!("../scenarios/arms/irp6_track.toml")),
    ("irp6_postument", include_str!("../scenarios/arms/irp6_postument.toml")),
    ("irp6_track_2008", include_str!("../scenarios/arms/irp6_track_2008.toml")),
    ("irp6_postument_2008", include_str!("../scenarios/arms/irp6_postument_2008.toml")),
];

/// Names of the built-in profiles, without `.toml`.
pub const BUILTIN: [&str; 4] = [PROFILES[0].0, PROFILES[1].0, PROFILES[2].0, PROFILES[3].0];

/// Returns the text of the built-in profile `name`; `None` if no profile has that name.
#[must_use]
pub fn builtin_text(name: &str) -> Option<&'static str> {
    PROFILES.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// Returns the model of the built-in profile `name`, one of [`BUILTIN`]; `None` if no profile has
/// that name.
///
/// ```
/// use rubik_robot::arms::{BUILTIN, builtin};
///
/// let model = builtin("irp6_postument").ok_or("no profile")?;
/// // The postument stands on a fixed base; its motors reach 250 rad/s.
/// assert_eq!((model.has_track, model.motor_speed_limit), (false, 250.0));
/// assert!(BUILTIN.iter().all(|name| builtin(name).is_some()));
/// # Ok::<(), &str>(())
/// ```
#[must_use]
pub fn builtin(name: &str) -> Option<ArmModel> {
    // A text that cannot be parsed would look like an unknown name, but the tests below parse all
    // texts.
    builtin_text(name).and_then(|text| toml::from_str(text).ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::AXES;

    #[test]
    fn builtin_arm_profiles_have_lower_limits_below_upper() {
        for name in BUILTIN {
            let model: ArmModel = toml::from_str(builtin_text(name).unwrap()).unwrap();

            for axis in 0..AXES {
                let (joint, motor) = (model.joint_limits[axis], model.motor_limits[axis]);
                // An arm without a track has no axis 0.
                let is_there = axis > 0 || model.has_track;
                let ordered = joint.0 < joint.1 && motor.0 < motor.1;
                assert_eq!(ordered, is_there, "{name}, axis {axis}");
            }
            assert_eq!(model.has_track, name.contains("track"));
            assert_eq!(builtin(name), Some(model));
        }
        assert_eq!(builtin("irp7"), None);
    }

    #[test]
    fn profile_with_an_unknown_key_is_refused() {
        let text = format!("{}\nelbow = 3\n", builtin_text("irp6_postument").unwrap());

        let error = toml::from_str::<ArmModel>(&text).unwrap_err().to_string();

        assert!(error.contains("elbow"), "{error}");
    }
}
