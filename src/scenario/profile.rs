//! The profiles to which keys refer: the geometry of an arm and its regulators, built in by name or
//! from a file.

use super::fault::nearest;
use super::keys::Servo;
use super::section::Reader;
use crate::arms;
use crate::hw::text;
use crate::kinematics::ArmModel;
use crate::servo::regulator::{self, ServoGains};
use std::path::Path;

/// Key that refers to a profile.
struct Reference<'a> {
    /// Dotted key.
    at: String,
    /// Name of a built-in profile, or a path relative to the scenario's folder.
    name: &'a str,
    folder: &'a Path,
}

/// Built-in profiles of one kind.
struct BuiltIn {
    names: &'static [&'static str],
    text: fn(&str) -> Option<&'static str>,
}

/// Reads the geometry of an effector from the profile `name`: a built-in one, or a file in
/// `folder`. `path` is the dotted name of the effector.
pub(super) fn model(
    name: &str,
    path: &str,
    folder: &Path,
    reader: &mut Reader,
) -> Option<ArmModel> {
    let built_in = BuiltIn { names: &arms::BUILTIN, text: arms::builtin_text };
    read(&Reference { at: format!("{path}.profile"), name, folder }, &built_in, reader)
}

/// Reads the gains and limits of an effector's regulators from the profile `name`: the built-in
/// one, or a file in `folder`. `path` is the dotted name of the effector.
pub(super) fn gains(
    name: &str,
    path: &str,
    folder: &Path,
    reader: &mut Reader,
) -> Option<ServoGains> {
    let built_in = BuiltIn {
        names: &["irp6_servo"],
        text: |name| (name == "irp6_servo").then_some(regulator::IRP6),
    };
    let reference = Reference { at: format!("{path}.servo_profile"), name, folder };
    let gains: ServoGains = read(&reference, &built_in, reader)?;
    // A limit of 0, below 0 or NaN would drive an axis instead of stopping it.
    let limits = gains.axes.iter().map(|axis| ("trip_current", axis.trip_current));
    for (key, value) in limits.chain([("pwm_slew", gains.pwm_slew), ("pwm_limit", gains.pwm_limit)])
    {
        if value.is_nan() || value <= 0.0 {
            let at = &reference.at;
            let reason = format!("`{at}`: \"{name}\": {key} is {value}, expected more than 0");
            reader.fault(at, reason);
            return None;
        }
    }
    Some(gains)
}

/// Applies the section `servo` to the gains of an effector.
pub(super) fn adjusted(mut gains: ServoGains, keys: &Servo) -> ServoGains {
    // The factor scales b0 and b1 by their common ratio, and all three gains of the jaw.
    for axis in &mut gains.axes {
        axis.ratio *= keys.gain_factor;
    }
    gains.jaw.position *= keys.gain_factor;
    gains.jaw.integral *= keys.gain_factor;
    gains.jaw.speed *= keys.gain_factor;
    gains.pwm_limit = keys.pwm_limit.unwrap_or(gains.pwm_limit);
    gains.following_error = keys.following_error.unwrap_or(gains.following_error);
    gains
}

/// Reads the profile to which a key refers: one of `built_in`, or a file.
fn read<T: serde::de::DeserializeOwned>(
    reference: &Reference<'_>,
    built_in: &BuiltIn,
    reader: &mut Reader,
) -> Option<T> {
    let Reference { at, name, folder } = reference;
    let file = folder.join(name);
    // A built-in name wins over a file. Only a name that ends in .toml is a path, so a misspelt
    // name gets advice instead of a missing file.
    let (text, source) = if let Some(text) = (built_in.text)(name) {
        (text.to_owned(), (*name).to_owned())
    } else if Path::new(name).extension().is_some_and(|e| e.eq_ignore_ascii_case("toml")) {
        match text::read(&file, text::SCENARIO) {
            Ok(text) => (text, file.display().to_string()),
            Err(error) => {
                reader.fault(at, format!("`{at}`: {error}"));
                return None;
            }
        }
    } else {
        let advice = match nearest(name, built_in.names) {
            Some(word) => format!("did you mean \"{word}\"?"),
            None => format!("possible: {}, or the path of a .toml file", built_in.names.join(", ")),
        };
        reader.fault_with_help(at, format!("`{at}`: there is no profile \"{name}\""), advice);
        return None;
    };
    if let Some(line) = text::deep_line(&text) {
        reader.fault(at, format!("`{at}`: {source}:{line}: a key has too many parts"));
        return None;
    }
    match toml::from_str(&text) {
        Ok(data) => Some(data),
        Err(error) => {
            // The fault is at the key of the scenario. Its text names the line in the profile.
            let line = error.span().map_or(1, |s| text[..s.start].matches('\n').count() + 1);
            reader.fault(at, format!("`{at}`: {source}:{line}: {}", error.message()));
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tasks::read as read_scenario;

    #[test]
    fn servo_profile_with_invalid_limits_is_refused() {
        let folder = std::env::temp_dir().join(format!("rubik-gains-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let of = |from: &str, to: &str| {
            assert!(regulator::IRP6.contains(from));
            std::fs::write(folder.join("own.toml"), regulator::IRP6.replacen(from, to, 1)).unwrap();
            let text =
                "task = \"idle\"\n[[effector]]\nname = \"track\"\nservo_profile = \"own.toml\"\n";
            match read_scenario(&folder.join("t.toml"), text, &[]) {
                Ok(_) => String::new(),
                Err(faults) => faults.to_string(),
            }
        };

        for value in ["nan", "0.0", "-10.0", "-inf"] {
            let message = of("trip_current = 18.0", &format!("trip_current = {value}"));
            assert!(
                message.contains("own.toml") && message.contains("trip_current is"),
                "{message}"
            );
        }
        assert!(of("pwm_slew = 25.0", "pwm_slew = nan").contains("pwm_slew is NaN"));
        assert!(of("pwm_limit = 190.0", "pwm_limit = 0.0").contains("pwm_limit is 0"));
        assert_eq!(of("trip_current = 18.0", "trip_current = inf"), "");
        let without = of("trip_current = 18.0\n", "");
        assert!(without.contains("missing field `trip_current`"), "{without}");
        std::fs::remove_dir_all(folder).unwrap();
    }
}
