//! Hashes of message types (RIHS01): SHA-256 over the description of a type and of all types in it.
//!
//! - in: a type of [`Kind`], whose schema has the definitions
//! - out: `RIHS01_` and 64 hexadecimal digits
//!
//! Constants, comments and default values are no part of a type. The description is JSON whose
//! spaces count.

use crate::record::schema::Kind;
use sha2::{Digest as _, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

/// Number of a nested type.
const NESTED: u32 = 1;
/// Numbers of the primitive types.
const PRIMITIVES: [(&str, u32); 14] = [
    ("int8", 2),
    ("uint8", 3),
    ("int16", 4),
    ("uint16", 5),
    ("int32", 6),
    ("uint32", 7),
    ("int64", 8),
    ("uint64", 9),
    ("float32", 10),
    ("float64", 11),
    ("char", 3),
    ("bool", 15),
    ("byte", 16),
    ("string", 17),
];
/// Additions to the number of a type: for an array of fixed length, and for a sequence.
const ARRAY: u32 = 48;
const SEQUENCE: u32 = 144;

/// Field of a type.
struct Field {
    name: String,
    number: u32,
    /// Length of an array; 0 for a single value and a sequence.
    capacity: u32,
    /// Name of a nested type; empty for a primitive one.
    nested: String,
}

/// Returns the hash of a message type.
#[must_use]
pub fn type_hash(kind: Kind) -> String {
    let mut types = BTreeMap::new();
    let (schema, line) = (kind.schema(), "=".repeat(80));
    let mut parts = schema.split(&line);
    types.insert(kind.name().to_owned(), fields(parts.next().unwrap_or_default()));
    for part in parts {
        let part = part.trim_start_matches('\n');
        if let Some((name, definition)) =
            part.strip_prefix("MSG: ").and_then(|part| part.split_once('\n'))
        {
            types.insert(full_name(name), fields(definition));
        }
    }
    let own = types.get(kind.name()).map(Vec::as_slice).unwrap_or_default();
    let parts: Vec<_> =
        parts_of(own, &types).iter().map(|name| described(name, &types[name])).collect();
    let text = format!(
        "{{\"type_description\": {}, \"referenced_type_descriptions\": [{}]}}",
        described(kind.name(), own),
        parts.join(", ")
    );
    Sha256::digest(text).iter().fold("RIHS01_".to_owned(), |mut hash, byte| {
        // A string takes any text.
        let _ = write!(hash, "{byte:02x}");
        hash
    })
}

/// Returns the name of a type with its middle part: `std_msgs/msg/Header` for `std_msgs/Header`.
fn full_name(name: &str) -> String {
    match name.split_once('/') {
        Some((package, name)) if !name.contains('/') => format!("{package}/msg/{name}"),
        _ => name.to_owned(),
    }
}

/// Reads the fields of a definition.
fn fields(definition: &str) -> Vec<Field> {
    let lines = definition.lines().map(|line| line.split('#').next().unwrap_or_default());
    lines.filter_map(field).collect()
}

/// Reads the field of a line; `None` for an empty line and a constant.
fn field(line: &str) -> Option<Field> {
    let mut words = line.split_whitespace();
    let (kind, name) = (words.next()?, words.next()?);
    if name.contains('=') || words.next() == Some("=") {
        return None;
    }
    let (element, length) = match kind.split_once('[') {
        None => (kind, None),
        Some((element, length)) => (element, Some(length.trim_end_matches(']'))),
    };
    let primitive = PRIMITIVES.iter().find(|(word, _)| *word == element).map(|(_, n)| *n);
    let capacity = length.and_then(|length| length.parse().ok()).unwrap_or(0);
    let addition = match length {
        None => 0,
        Some("") => SEQUENCE,
        Some(_) => ARRAY,
    };
    let nested = if primitive.is_none() { full_name(element) } else { String::new() };
    let number = primitive.unwrap_or(NESTED) + addition;
    Some(Field { name: name.to_owned(), number, capacity, nested })
}

/// Returns the names of all types in a type, also indirectly.
fn parts_of(fields: &[Field], types: &BTreeMap<String, Vec<Field>>) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut waiting: Vec<_> = fields.iter().map(|field| &field.nested).collect();
    while let Some(name) = waiting.pop() {
        if let Some(fields) = types.get(name)
            && found.insert(name.clone())
        {
            waiting.extend(fields.iter().map(|field| &field.nested));
        }
    }
    found
}

/// Returns the description of a type.
fn described(name: &str, fields: &[Field]) -> String {
    let fields: Vec<_> = fields
        .iter()
        .map(|field| {
            format!(
                "{{\"name\": \"{}\", \"type\": {{\"type_id\": {}, \"capacity\": {}, \
                 \"string_capacity\": 0, \"nested_type_name\": \"{}\"}}}}",
                field.name, field.number, field.capacity, field.nested
            )
        })
        .collect();
    format!("{{\"type_name\": \"{name}\", \"fields\": [{}]}}", fields.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hashes by the package `rosbags`, of the definitions of ROS 2 Jazzy.
    #[test]
    fn hashes_of_standard_types_are_those_of_ros() {
        for (kind, hash) in [
            (Kind::Text, "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
            (Kind::JointState, "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"),
            (Kind::Transforms, "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"),
            (Kind::Wrench, "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77"),
            (Kind::Pose, "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"),
            (Kind::Picture, "15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a"),
            (Kind::CameraInfo, "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275"),
            (Kind::Log, "e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac"),
        ] {
            assert_eq!(type_hash(kind), format!("RIHS01_{hash}"), "{kind:?}");
        }
    }

    #[test]
    fn constants_and_comments_are_no_fields() {
        let fields = fields("byte WARN=30\nbyte INFO = 20\n# a comment\nuint8[7] counts # axes\n");
        let found: Vec<_> =
            fields.iter().map(|f| (f.name.as_str(), f.number, f.capacity)).collect();
        assert_eq!(found, [("counts", 3 + ARRAY, 7)]);
    }
}
