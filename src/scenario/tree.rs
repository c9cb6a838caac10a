//! A TOML document as a tree in which every key and value knows its place.
//!
//! - in: text of a scenario, and `KEY=VALUE` options that overrule parts of it
//! - out: a [`Node`] to read sections from; faults of syntax, all of them at once

use super::fault::{Faults, Place, Source};
use std::rc::Rc;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A value and where it stands.
#[derive(Debug, Clone)]
pub(crate) struct Node {
    /// Where.
    pub place: Place,
    /// What.
    pub value: Value,
}

/// What a node holds.
#[derive(Debug, Clone)]
pub(crate) enum Value {
    /// `true`, `false`.
    Bool(bool),
    /// A whole number.
    Integer(i64),
    /// A number with a point.
    Float(f64),
    /// Text.
    Text(String),
    /// A date or time, which no key takes.
    Date,
    /// Values in brackets, or the tables of `[[name]]`.
    Array(Vec<Node>),
    /// Keys with values.
    Table(Vec<Entry>),
}

/// A key with its value.
#[derive(Debug, Clone)]
pub(crate) struct Entry {
    /// The key.
    pub key: String,
    /// Where the key stands.
    pub key_place: Place,
    /// Its value.
    pub node: Node,
}

impl Node {
    /// What the user would call it.
    #[must_use]
    pub(crate) fn describe(&self) -> String {
        match &self.value {
            Value::Bool(b) => format!("`{b}`"),
            Value::Integer(i) => format!("`{i}`"),
            Value::Float(x) => format!("`{x}`"),
            Value::Text(t) => format!("\"{t}\""),
            Value::Date => "a date".to_owned(),
            Value::Array(a) => format!("an array of {}", a.len()),
            Value::Table(_) => "a table".to_owned(),
        }
    }

    /// The value of a key of a table.
    #[must_use]
    pub(crate) fn get(&self, key: &str) -> Option<&Self> {
        match &self.value {
            Value::Table(entries) => entries.iter().find(|e| e.key == key).map(|e| &e.node),
            _ => None,
        }
    }
}

/// Parses a document; faults of syntax go to `faults`, and what could be read is returned.
#[must_use]
pub(crate) fn parse(source: &Rc<Source>, faults: &mut Faults) -> Node {
    let (table, errors) = DeTable::parse_recoverable(&source.text);
    for error in errors {
        let place = Place { source: Rc::clone(source), span: error.span().unwrap_or(0..0) };
        faults.add(Some(&place), error.message());
    }
    let place = Place { source: Rc::clone(source), span: table.span() };
    Node { place, value: Value::Table(entries(table.get_ref(), source)) }
}

/// Parses one value as in TOML; what is none of TOML's values is taken as a string.
#[must_use]
pub(crate) fn parse_value(source: &Rc<Source>) -> Node {
    match DeValue::parse(&source.text) {
        Ok(value) => node(&value, source),
        Err(_) => Node {
            place: Place { source: Rc::clone(source), span: 0..source.text.len() },
            value: Value::Text(source.text.clone()),
        },
    }
}

fn entries(table: &DeTable<'_>, source: &Rc<Source>) -> Vec<Entry> {
    table
        .iter()
        .map(|(key, value)| Entry {
            key: key.get_ref().to_string(),
            key_place: Place { source: Rc::clone(source), span: key.span() },
            node: node(value, source),
        })
        .collect()
}

fn node(value: &Spanned<DeValue<'_>>, source: &Rc<Source>) -> Node {
    let place = Place { source: Rc::clone(source), span: value.span() };
    let value = match value.get_ref() {
        DeValue::Boolean(b) => Value::Bool(*b),
        DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix())
            .map_or_else(|_| Value::Float(i.as_str().parse().unwrap_or(f64::NAN)), Value::Integer),
        DeValue::Float(x) => Value::Float(x.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::String(s) => Value::Text(s.to_string()),
        DeValue::Datetime(_) => Value::Date,
        DeValue::Array(items) => Value::Array(items.iter().map(|i| node(i, source)).collect()),
        DeValue::Table(table) => Value::Table(entries(table, source)),
    };
    Node { place, value }
}

/// Puts `value` at a dotted key, making tables on the way; elements of an array are named by their
/// `name` or their index. Existing elements only: an option cannot add an effector.
///
/// Returns `false` after a fault.
pub(crate) fn set(root: &mut Node, key: &str, value: Node, faults: &mut Faults) -> bool {
    let place = value.place.clone();
    let parts: Vec<&str> = key.split('.').map(str::trim).collect();
    if parts.iter().any(|p| p.is_empty()) {
        faults.add(Some(&place), format!("`{key}` is not a dotted key"));
        return false;
    }
    let mut at = root;
    for (depth, part) in parts.iter().enumerate() {
        let here = parts[..depth].join(".");
        at = match &mut at.value {
            Value::Array(items) => {
                let Some(index) = element(items, part) else {
                    let names: Vec<String> = items.iter().filter_map(name_of).collect();
                    faults.add_with_help(
                        Some(&place),
                        format!("`{here}` has no element `{part}`"),
                        format!("there are {} elements: {}", items.len(), names.join(", ")),
                    );
                    return false;
                };
                &mut items[index]
            }
            Value::Table(entries) => {
                let index = entries.iter().position(|e| e.key == *part).unwrap_or_else(|| {
                    entries.push(Entry {
                        key: (*part).to_owned(),
                        key_place: place.clone(),
                        node: Node { place: place.clone(), value: Value::Table(Vec::new()) },
                    });
                    entries.len() - 1
                });
                &mut entries[index].node
            }
            _ => {
                faults.add(Some(&place), format!("`{here}` is a value and has no key `{part}`"));
                return false;
            }
        };
    }
    *at = value;
    true
}

fn element(items: &[Node], part: &str) -> Option<usize> {
    items
        .iter()
        .position(|i| name_of(i).as_deref() == Some(part))
        .or_else(|| part.parse().ok().filter(|i| *i < items.len()))
}

/// The `name` of an element of a list of tables.
#[must_use]
pub(crate) fn name_of(node: &Node) -> Option<String> {
    match node.get("name").map(|n| &n.value) {
        Some(Value::Text(name)) => Some(name.clone()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(text: &str) -> Rc<Source> {
        Rc::new(Source { name: "t".into(), text: text.into(), is_file: true })
    }

    #[test]
    fn two_faults_of_syntax_are_both_told() {
        let mut faults = Faults::default();

        let _ = parse(&source("a = \nb = 1\nc = ]\n"), &mut faults);

        assert!(faults.0.len() >= 2, "{faults}");
    }

    #[test]
    fn an_element_is_set_by_name_and_by_index() {
        let mut faults = Faults::default();
        let mut root = parse(&source("[[e]]\nname = \"a\"\n[[e]]\nname = \"b\"\n"), &mut faults);

        assert!(set(&mut root, "e.b.x", parse_value(&source("1")), &mut faults));
        assert!(set(&mut root, "e.0.x", parse_value(&source("word")), &mut faults));
        assert!(!set(&mut root, "e.c.x", parse_value(&source("1")), &mut faults));

        let Some(Value::Array(items)) = root.get("e").map(|n| &n.value) else { panic!("no list") };
        assert!(matches!(items[1].get("x").map(|n| &n.value), Some(Value::Integer(1))));
        assert!(matches!(items[0].get("x").map(|n| &n.value), Some(Value::Text(t)) if t == "word"));
        assert_eq!(faults.0.len(), 1);
    }
}
