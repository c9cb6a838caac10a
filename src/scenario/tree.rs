//! A TOML document as a tree in which every key and value has its place.
//!
//! - in: text of a scenario, and `KEY=VALUE` options that override parts of it
//! - out: a [`Node`] from which sections are read; all faults of syntax at once

use super::fault::{Faults, Place, Source};
use crate::hw::text::{self, MOST_PARTS};
use std::rc::Rc;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Longest text that is shown whole in a message (characters).
const LONGEST: usize = 200;

/// Value and its place.
#[derive(Debug, Clone)]
pub struct Node {
    /// Place of the value.
    pub place: Place,
    /// Value itself.
    pub value: Value,
}

/// Content of a node.
#[derive(Debug, Clone)]
pub enum Value {
    /// `true`, `false`.
    Bool(bool),
    /// Whole number.
    Integer(i64),
    /// Number with a point.
    Float(f64),
    /// Text.
    Text(String),
    /// Date or time, which no key accepts.
    Date,
    /// Values in brackets, or the tables of `[[name]]`.
    Array(Vec<Node>),
    /// Keys with their values.
    Table(Vec<Entry>),
}

/// Key with its value.
#[derive(Debug, Clone)]
pub struct Entry {
    /// Name of the key.
    pub key: String,
    /// Place of the key.
    pub key_place: Place,
    /// Value of the key.
    pub node: Node,
}

impl Node {
    /// Returns the value as text for the message that it is wrong; for a table, an array or a date,
    /// its type in words.
    #[must_use]
    pub fn describe(&self) -> String {
        match &self.value {
            Value::Bool(b) => format!("`{b}`"),
            Value::Integer(i) => format!("`{i}`"),
            Value::Float(x) => format!("`{x}`"),
            Value::Text(t) if t.chars().nth(LONGEST).is_some() => {
                format!("\"{}...\"", t.chars().take(LONGEST).collect::<String>())
            }
            Value::Text(t) => format!("\"{t}\""),
            Value::Date => "a date".to_owned(),
            Value::Array(a) => format!("an array of {}", a.len()),
            Value::Table(_) => "a table".to_owned(),
        }
    }

    /// Returns the value of `key` in a table; `None` if the key is missing or the node is no table.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<&Self> {
        match &self.value {
            Value::Table(entries) => entries.iter().find(|e| e.key == key).map(|e| &e.node),
            _ => None,
        }
    }
}

/// Parses a document. Adds faults of syntax to `faults` and returns what could be parsed.
#[must_use]
pub fn parse(source: &Rc<Source>, faults: &mut Faults) -> Node {
    if let Some(line) = text::deep_line(&source.text) {
        let start = source.text.split_inclusive('\n').take(line - 1).map(str::len).sum();
        let place = Place { source: Rc::clone(source), span: start..start };
        faults.add(Some(&place), format!("a key has more than {MOST_PARTS} parts"));
        return Node { place, value: Value::Table(Vec::new()) };
    }
    // The parser recovers after a fault, so a user sees all faults of syntax at once.
    let (table, errors) = DeTable::parse_recoverable(&source.text);
    for error in errors {
        let place = Place { source: Rc::clone(source), span: error.span().unwrap_or(0..0) };
        faults.add(Some(&place), error.message());
    }
    let place = Place { source: Rc::clone(source), span: table.span() };
    Node { place, value: Value::Table(entries(table.get_ref(), source)) }
}

/// Parses one value as in TOML. A text that is not a value of TOML becomes a string, so that a word
/// needs no quotes on the command line.
#[must_use]
pub(crate) fn parse_value(source: &Rc<Source>) -> Node {
    let deep = text::deep_line(&source.text).is_some();
    match (!deep).then(|| DeValue::parse(&source.text)) {
        Some(Ok(value)) => node(&value, source),
        _ => Node {
            place: Place { source: Rc::clone(source), span: 0..source.text.len() },
            value: Value::Text(source.text.clone()),
        },
    }
}

/// Converts a table of the TOML parser to entries with their places.
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

/// Converts a value of the TOML parser to a node with its place.
fn node(value: &Spanned<DeValue<'_>>, source: &Rc<Source>) -> Node {
    let place = Place { source: Rc::clone(source), span: value.span() };
    let value = match value.get_ref() {
        DeValue::Boolean(b) => Value::Bool(*b),
        // An integer beyond 64 bits becomes a float, so that its key refuses it, with its place.
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

/// Sets a dotted key to `value` and makes missing tables on the way. An element of an array is
/// named by its `name` or its index and must exist: an option cannot add an effector.
///
/// Returns `false` after a fault.
pub(crate) fn set(root: &mut Node, key: &str, value: Node, faults: &mut Faults) -> bool {
    let place = value.place.clone();
    let parts: Vec<&str> = key.split('.').map(str::trim).collect();
    if parts.iter().any(|p| p.is_empty()) {
        faults
            .add(Some(&place), format!("`{key}` has an empty part before, between or after dots"));
        return false;
    }
    if parts.len() > MOST_PARTS {
        let reason = format!("a key has {} parts, more than {MOST_PARTS}", parts.len());
        faults.add(Some(&place), reason);
        return false;
    }
    let mut at = root;
    for (depth, part) in parts.iter().enumerate() {
        let here = parts[..depth].join(".");
        at = match &mut at.value {
            // An element of a list.
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
            // A key of a table. A misspelt key is added as well: the reader of the section reports
            // it.
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
            // A value in the middle of the dotted key.
            _ => {
                faults.add(Some(&place), format!("`{here}` is a value and has no key `{part}`"));
                return false;
            }
        };
    }
    *at = value;
    true
}

/// Returns the index of the list element that `part` of a dotted key names, by its `name` or else
/// by its index.
fn element(items: &[Node], part: &str) -> Option<usize> {
    items
        .iter()
        .position(|i| name_of(i).as_deref() == Some(part))
        .or_else(|| part.parse().ok().filter(|i| *i < items.len()))
}

/// Returns the text of the key `name` in an element of a list; `None` if it has no such text.
#[must_use]
pub fn name_of(node: &Node) -> Option<String> {
    match node.get("name").map(|n| &n.value) {
        Some(Value::Text(name)) => Some(name.clone()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a source with this text, as from a file named `t`.
    fn source(text: &str) -> Rc<Source> {
        Rc::new(Source { name: "t".into(), text: text.into(), is_file: true })
    }

    #[test]
    fn parse_reports_more_than_one_syntax_error() {
        let mut faults = Faults::default();

        let _ = parse(&source("a = \nb = 1\nc = ]\n"), &mut faults);

        assert!(faults.0.len() >= 2, "{faults}");
    }

    /// Tables that are nested so deeply overflow the stack when they are dropped.
    #[test]
    fn key_of_many_parts_is_refused_everywhere() {
        let key = vec!["a"; 30_000].join(".");
        let mut faults = Faults::default();
        let mut root = parse(&source("x = 1\n"), &mut faults);
        assert!(!set(&mut root, &key, parse_value(&source("1")), &mut faults));
        let _ = parse(&source(&format!("x = 1\n{key} = 1\n")), &mut faults);
        let value = parse_value(&source(&format!("{{ {key} = 1 }}")));

        let told = faults.to_string();
        assert!(told.contains("a key has 30000 parts, more than 16"), "{}", &told[..200]);
        assert!(told.contains("t:2:1: a key has more than 16 parts"), "{}", &told[..200]);
        assert!(value.describe().len() < 300);
    }

    #[test]
    fn set_finds_list_elements_by_name_and_index() {
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
