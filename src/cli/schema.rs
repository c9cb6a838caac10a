//! `rubik-robot schema`: prints the JSON schema of scenarios.
//!
//! A key is declared once (`scenario::section`). The schema, `rubik-robot keys` and the reader of
//! scenarios are derived from the declarations.
//!
//! - in: the keys, each with type, range, meaning and default in words
//! - out: a JSON schema (draft 2020-12) for editors

use super::catalogue;
use super::output::Output;
use crate::scenario::section::Key;
use serde_json::{Map, Value, json};

/// Sections that are lists of tables. The schema allows each element all keys that a built-in
/// element has.
const LISTS: [&str; 4] = ["effector", "camera", "vsp", "fault"];

/// Prints the schema; returns the exit code.
pub(super) fn run(output: &mut Output) -> anyhow::Result<u8> {
    output.line(&serde_json::to_string_pretty(&schema(&catalogue::all_keys()))?)?;
    Ok(0)
}

/// Returns the schema of a scenario with these keys.
fn schema(keys: &[Key]) -> Value {
    let mut root = Map::new();
    for key in keys {
        let parts: Vec<&str> = key.path.split('.').collect();
        match parts.as_slice() {
            // The second part of the path is the name of an element, which a scenario may choose.
            [list, _, within @ ..] if LISTS.contains(list) => {
                let item =
                    root.entry(*list).or_insert_with(|| json!({"type": "array", "items": table()}));
                insert(&mut item["items"], within, key);
            }
            [name] => {
                root.insert((*name).to_owned(), value(key));
            }
            [section, within @ ..] => {
                insert(root.entry(*section).or_insert_with(table), within, key);
            }
            [] => {}
        }
    }
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A scenario of rubik-robot",
        "type": "object",
        "additionalProperties": false,
        "properties": root,
    })
}

/// Returns the schema of a section without keys.
fn table() -> Value {
    json!({"type": "object", "additionalProperties": false, "properties": {}})
}

/// Adds a key to the schema of a section. `path` is the key's path within this section: the names
/// of nested sections, which are added as needed, and the name of the key.
fn insert(table_of: &mut Value, path: &[&str], key: &Key) {
    match path {
        [] => {}
        [name] => table_of["properties"][*name] = value(key),
        [section, within @ ..] => {
            let properties = &mut table_of["properties"];
            if properties.get(*section).is_none() {
                properties[*section] = table();
            }
            insert(&mut properties[*section], within, key);
        }
    }
}

/// Returns the schema of a key. Its type follows from the words for it in the list of keys, see
/// [`kind`].
fn value(key: &Key) -> Value {
    let mut schema = kind(&key.kind);
    if let (Some(range), Some(fields)) = (&key.range, schema.as_object_mut()) {
        let (low, high) = (json!(range.start()), json!(range.end()));
        // The range of a list is that of its elements.
        let holder = match fields.get_mut("items").and_then(Value::as_object_mut) {
            Some(items) => items,
            None => fields,
        };
        if holder.get("type").is_some_and(|t| t == "number" || t == "integer") {
            holder.insert("minimum".to_owned(), low);
            holder.insert("maximum".to_owned(), high);
        }
    }
    schema["description"] = json!(key.meaning);
    if let Some(default) = default(&key.default) {
        schema["default"] = default;
    }
    schema
}

/// Parses a default, which is written as in TOML. Returns `None` for words such as "(not given)",
/// which are no TOML.
fn default(text: &str) -> Option<Value> {
    let document: toml::Table = toml::from_str(&format!("v = {text}")).ok()?;
    serde_json::to_value(document.get("v")?).ok()
}

/// Returns the schema of a type that is described in words: `3 times number`, `"a" | "b"`.
fn kind(words: &str) -> Value {
    let words = words.trim();
    if words.contains('"') {
        // A type with quoted words is a choice of them.
        let options: Vec<_> = words.split('|').map(|w| w.trim().trim_matches('"')).collect();
        return json!({"enum": options});
    }
    if let Some((count, each)) = words.split_once(" times ")
        && let Ok(count) = count.parse::<usize>()
    {
        let item = kind(each);
        return json!({"type": "array", "items": item, "minItems": count, "maxItems": count});
    }
    if let Some(each) = words.strip_prefix("list of ") {
        return json!({"type": "array", "items": kind(each)});
    }
    match words {
        "number" => json!({"type": "number"}),
        "whole number" => json!({"type": "integer"}),
        "text" => json!({"type": "string"}),
        "true | false" => json!({"type": "boolean"}),
        // Other words describe a key of several types, for which the schema allows every value.
        _ => json!({}),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schema_has_every_key_with_a_type() {
        let keys = catalogue::all_keys();
        let schema = schema(&keys);

        for key in &keys {
            let mut at = &schema;
            let parts: Vec<&str> = key.path.split('.').collect();
            let (list, within) = match parts.as_slice() {
                [list, _, within @ ..] if LISTS.contains(list) => (Some(*list), within),
                all => (None, all),
            };
            if let Some(list) = list {
                at = &at["properties"][list]["items"];
            }
            for part in within {
                at = &at["properties"][*part];
            }
            assert!(at["type"].is_string() || at["enum"].is_array(), "{}: {}", key.path, key.kind);
            assert!(!at["description"].as_str().unwrap().is_empty(), "{}", key.path);
        }
    }

    #[test]
    fn schema_has_ranges_and_defaults() {
        let schema = schema(&catalogue::all_keys());

        let grip = &schema["properties"]["control"]["properties"]["grip_n"];
        assert_eq!((grip["minimum"].as_f64(), grip["maximum"].as_f64()), (Some(1.0), Some(100.0)));
        assert_eq!(grip["default"].as_f64(), Some(40.0));
        let centre = &schema["properties"]["hand"]["properties"]["centre_xyz_mm"];
        assert_eq!(centre["minItems"], 3);
        assert!(schema["properties"]["task"]["enum"].as_array().unwrap().contains(&json!("solve")));
    }
}
