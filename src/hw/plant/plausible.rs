//! Plausibility of a saved plant: a file that was edited or damaged is refused with the place of
//! the error.
//!
//! - in: numbers of a state, as JSON
//! - out: the first number that no plant has, with its place
//! - the bounds are generous, a multiple of the values in the cell: they keep the plant's equations
//!   finite, and do not prove that the state is true

use serde_json::Value;

/// Place in a file, and the reason why it is wrong.
pub(super) type Wrong = (String, String);

/// Returns the largest plausible magnitude of a number under the key `key` of a saved state, in SI
/// units. `in_grasp` is whether the number belongs to a grasp.
fn most(key: &str, in_grasp: bool) -> f64 {
    match key {
        "joints" | "angles" | "closed_tilt" | "askew" | "angle_at_split" => 50.0,
        "motors" | "jaws" | "grown" => 1e5,
        "bristles" | "slid" => 1.0,
        // A cube in a hand is near the tool; elsewhere a place is in the cell.
        "p" if in_grasp => 0.5,
        "slip" | "p" | "apart" => 10.0,
        // Entries of a rotation, which `is_rotation` checks further.
        "r" => 1.1,
        "counterbalance" | "velocity" => 100.0,
        // Motors turn for as long as their counters go.
        "origin" => 1e12,
        _ => 1e9,
    }
}

/// Checks that each number of a saved state is plausible. The error names the first one that is
/// not, and the reason.
pub(super) fn check_numbers(state: &Value) -> Result<(), Wrong> {
    look(state, "", "", false)
}

/// Checks the numbers in `value`, which is at `path` in the state; `key` is the nearest key above
/// it, `in_grasp` whether it belongs to a grasp.
fn look(value: &Value, path: &str, key: &str, in_grasp: bool) -> Result<(), Wrong> {
    match value {
        Value::Number(number) => {
            let (size, most) =
                (number.as_f64().map_or(f64::INFINITY, f64::abs), most(key, in_grasp));
            let why = || format!("{number} is beyond {most}, the largest plausible size");
            if size <= most { Ok(()) } else { Err((path.to_owned(), why())) }
        }
        Value::Array(items) => {
            for (i, item) in items.iter().enumerate() {
                look(item, &format!("{path}[{i}]"), key, in_grasp)?;
            }
            if key == "r" && !is_rotation(items) {
                return Err((path.to_owned(), "not a rotation matrix".to_owned()));
            }
            Ok(())
        }
        Value::Object(fields) => {
            for (name, field) in fields {
                if name == "identity" {
                    // Checksums have any value; they are compared as they are.
                    continue;
                }
                let dot = if path.is_empty() { "" } else { "." };
                let in_grasp = in_grasp || name == "grasps";
                look(field, &format!("{path}{dot}{name}"), name, in_grasp)?;
            }
            Ok(())
        }
        Value::Null | Value::Bool(_) | Value::String(_) => Ok(()),
    }
}

/// Checks that nine numbers are the columns of a rotation: of unit length, at right angles and
/// right-handed.
fn is_rotation(items: &[Value]) -> bool {
    let numbers: Vec<f64> = items.iter().filter_map(Value::as_f64).collect();
    let Ok(numbers) = <[f64; 9]>::try_from(numbers) else { return false };
    let r = nalgebra::Matrix3::from_column_slice(&numbers);
    let off = r.tr_mul(&r) - nalgebra::Matrix3::identity();
    off.iter().all(|e| e.abs() < 1e-6) && r.determinant() > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn implausible_number_is_refused_with_its_json_path() {
        let told = |state: Value| check_numbers(&state).unwrap_err();
        let frame = |r: [f64; 9]| json!({ "r": r, "p": [0.0, 0.0, 0.0] });
        let upright = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        assert_eq!(
            check_numbers(&json!({ "nodes": [frame(upright)], "identity": { "seed": u64::MAX } })),
            Ok(())
        );

        assert_eq!(told(json!({ "arms": [{ "joints": [0.0, 1e20] }] })).0, "arms[0].joints[1]");
        assert_eq!(told(json!({ "nodes": [frame(upright), frame([0.0; 9])] })).0, "nodes[1].r");
        let mirrored = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0];
        assert_eq!(told(frame(mirrored)).1, "not a rotation matrix");
        let counts = json!({ "counts": { "slips": u32::MAX } });
        assert_eq!(
            told(counts),
            (
                "counts.slips".to_owned(),
                "4294967295 is beyond 1000000000, the largest plausible size".to_owned()
            )
        );
    }
}
