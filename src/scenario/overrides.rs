//! The overrides of a scenario: `KEY=VALUE` of the command line over its keys.

use super::fault::Source;
use super::lists::LISTS;
use super::section::Reader;
use super::tree::{self, Node, Value};
use std::rc::Rc;

/// Override: `KEY=VALUE` of the command line.
///
/// ```
/// use rubik_robot::scenario::Override;
/// use rubik_robot::tasks;
/// use std::path::Path;
///
/// let option = Override::parse("cube.edge_mm=56")?;
/// let scenario = tasks::read(Path::new("t.toml"), "task = \"idle\"\n", &[option])?;
/// assert_eq!(scenario.controller.cell.cube.edge, 0.056);
/// assert!(Override::parse("cube.edge_mm").is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Override {
    /// Name in faults: `--set cube.edge_mm`.
    pub option: String,
    /// Dotted key.
    pub key: String,
    /// Value of TOML; a bare word counts as a string.
    pub value: String,
}

impl Override {
    /// Parses the text after `--set`.
    ///
    /// # Errors
    /// A message if there is no `=`.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (key, value) = text.split_once('=').ok_or_else(|| {
            format!("`{text}` has no `=`; write KEY=VALUE, as in control.grip_n=30")
        })?;
        let key = key.trim().to_owned();
        Ok(Self { option: format!("--set {key}"), key, value: value.trim().to_owned() })
    }

    /// Makes the override of an option with its own name for a key, such as `--seed` for `seed`.
    #[must_use]
    pub fn option(option: &str, key: &str, value: &str) -> Self {
        Self { option: option.to_owned(), key: key.to_owned(), value: value.to_owned() }
    }
}

/// Writes the overrides of the command line into the document of a scenario.
pub(super) fn apply(
    overrides: &[Override],
    document: &mut Node,
    built_in: &Node,
    reader: &mut Reader,
) {
    for over in overrides {
        let name = over.option.clone();
        let source = Rc::new(Source { name, text: over.value.clone(), is_file: false });
        let value = tree::parse_value(&source);
        let parts: Vec<&str> = over.key.split('.').collect();
        if let [list, element, "name"] = parts[..]
            && LISTS.contains(&list)
            && over.value.trim_matches('"') != element
        {
            // A new name would silently lose the built-in values of the element and all references
            // to it.
            let reason = format!("`{}`: an option cannot rename an element", over.key);
            reader.faults.add(Some(&value.place), reason);
            continue;
        }
        adopt_list(document, built_in, &over.key);
        tree::set(document, &over.key, value, &mut reader.faults);
    }
}

/// Adds the list in which `key` lies to the document if it has none, so that an override can change
/// an element. The list has only the names of the built-in elements; their values follow when the
/// list is read.
fn adopt_list(document: &mut Node, built_in: &Node, key: &str) {
    let list = key.split('.').next().unwrap_or_default();
    if !LISTS.contains(&list) || document.get(list).is_some() {
        return;
    }
    let (Some(from), Value::Table(entries)) = (built_in.get(list), &mut document.value) else {
        return;
    };
    let mut node = from.clone();
    if let Value::Array(items) = &mut node.value {
        for item in items {
            if let Value::Table(entries) = &mut item.value {
                // The other values of an element follow from its name when the list is read.
                entries.retain(|e| e.key == "name");
            }
        }
    }
    let key_place = node.place.clone();
    entries.push(tree::Entry { key: list.to_owned(), key_place, node });
}
