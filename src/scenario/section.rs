//! The sections of keys, and the macros that declare them.
//!
//! A call of `section!` declares each key by its name, unit, type, default, range and meaning. From
//! this follow a struct in SI units, its default, the reader with its faults, and the list that
//! `rubik-robot keys` prints. The key is the name of the field followed by the unit: `edge [mm]:
//! f64 = 57.0` is the key `edge_mm` and the field `edge` in metres.

use super::fault::{Faults, Place, nearest};
use super::tree::{Entry, Node, Value};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// Factors from the units of keys to SI, named as in the keys.
#[allow(non_upper_case_globals, reason = "each constant is named like a unit in keys, as mm_s")]
pub mod units {
    /// Millimetres.
    pub const mm: f64 = 1e-3;
    /// Radians.
    pub const rad: f64 = 1.0;
    /// Degrees.
    pub const deg: f64 = std::f64::consts::PI / 180.0;
    /// Milliseconds.
    pub const ms: f64 = 1e-3;
    /// Microseconds.
    pub const us: f64 = 1e-6;
    /// Seconds.
    pub const s: f64 = 1.0;
    /// Newtons.
    pub const n: f64 = 1.0;
    /// Newton metres.
    pub const nm: f64 = 1.0;
    /// Amperes.
    pub const a: f64 = 1.0;
    /// Milliamperes per newton.
    pub const ma_n: f64 = 1e-3;
    /// Grams.
    pub const g: f64 = 1e-3;
    /// Kilograms.
    pub const kg: f64 = 1.0;
    /// Kilograms times square metres.
    pub const kgm2: f64 = 1.0;
    /// Pixels.
    pub const px: f64 = 1.0;
    /// Kelvins.
    pub const k: f64 = 1.0;
    /// Hundredths.
    pub const percent: f64 = 0.01;
    /// Millimetres per second.
    pub const mm_s: f64 = 1e-3;
    /// Millimetres per square second.
    pub const mm_s2: f64 = 1e-3;
    /// Degrees per second.
    pub const deg_s: f64 = deg;
    /// Degrees per square second.
    pub const deg_s2: f64 = deg;
    /// Millimetres per newton second: reciprocal damping.
    pub const mm_sn: f64 = 1e-3;
    /// Radians per newton metre second: reciprocal damping.
    pub const rad_snm: f64 = 1.0;
    /// Hertz.
    pub const hz: f64 = 1.0;
    /// Newtons per millimetre.
    pub const n_mm: f64 = 1e3;
    /// Newtons per metre.
    pub const n_m: f64 = 1.0;
    /// Newton seconds per metre.
    pub const ns_m: f64 = 1.0;
}

/// Key, as listed for the operator.
#[derive(Debug, Clone, PartialEq)]
pub struct Key {
    /// Dotted name: `cube.edge_mm`.
    pub path: String,
    /// Type in words: `number`, `3 times number`, `"a" | "b"`.
    pub kind: String,
    /// Default as written in TOML.
    pub default: String,
    /// Smallest and largest value, in the unit of the key.
    pub range: Option<RangeInclusive<f64>>,
    /// Meaning in one sentence.
    pub meaning: String,
}

/// Declaration of a key as far as it concerns numbers.
#[derive(Debug, Clone)]
pub struct Declared {
    /// Factor from the unit of the key to SI.
    pub factor: f64,
    /// Smallest and largest value, in the unit of the key.
    pub range: Option<RangeInclusive<f64>>,
}

/// Collector of faults, and of the places at which keys were given.
#[derive(Debug, Default)]
pub struct Reader {
    /// Faults until now.
    pub faults: Faults,
    /// Place of the value of each key that was given, by dotted name.
    pub places: BTreeMap<String, Place>,
    /// Dotted names of all keys of a scenario, to find a key that is in the wrong section; empty if
    /// there are no others.
    pub everywhere: Vec<String>,
    /// Names of the tasks' sections, which the top level has beside its own.
    pub tasks: Vec<&'static str>,
    /// Whether the scenario is that of a recording: the run is over, and writes no file.
    pub replays: bool,
}

impl Reader {
    /// Reads one key of the section `path` into `target`, which keeps its value after a fault.
    pub fn item<T: Item>(&mut self, target: &mut T, declared: Declared, entry: &Entry, path: &str) {
        let path = join(path, &entry.key);
        // Checks that compare keys report their faults at this place, so it is stored even if the
        // value is wrong.
        self.places.insert(path.clone(), entry.node.place.clone());
        let value = match T::read(&entry.node) {
            Ok(value) => value,
            Err(wrong) => {
                let place = wrong.place.unwrap_or_else(|| entry.node.place.clone());
                let reason = format!("`{path}`: {}", wrong.reason);
                match wrong.help {
                    Some(help) => self.faults.add_with_help(Some(&place), reason, help),
                    None => self.faults.add(Some(&place), reason),
                }
                return;
            }
        };
        // The range is in the unit of the key, as the user wrote it, so the check comes before the
        // conversion to SI. It also refuses NaN and infinities.
        let (low, high) = declared.range.map_or((f64::MIN, f64::MAX), RangeInclusive::into_inner);
        for number in value.numbers() {
            if !(low..=high).contains(&number) {
                let reason = if number.is_finite() {
                    format!("`{path}`: {number} is outside {low}..{high}")
                } else {
                    format!("`{path}`: {number} is not a finite number")
                };
                self.faults.add(Some(&entry.node.place), reason);
                return;
            }
        }
        *target = value.scaled(declared.factor);
    }

    /// Returns the entries of the table that the section `path` must be. Any other value is a fault
    /// and has no entries.
    pub fn table<'n>(&mut self, node: &'n Node, path: &str) -> &'n [Entry] {
        if let Value::Table(entries) = &node.value {
            return entries;
        }
        let reason = format!("`{path}` must be a section, not {}", node.describe());
        self.faults.add_with_help(
            Some(&node.place),
            reason,
            format!("write [{path}] and its keys below"),
        );
        &[]
    }

    /// Adds a fault for the key of `entry`, which does not exist in the section `path`. `known` are
    /// the keys of this section. The advice names the key that the user probably meant.
    pub fn unknown(&mut self, entry: &Entry, path: &str, known: &[&str]) {
        // The search for advice would take too long in a file with thousands of unknown keys.
        if self.faults.is_full() {
            return;
        }
        let section = if path.is_empty() { String::new() } else { format!(" in [{path}]") };
        let reason = format!("unknown key `{}`{section}", entry.key);
        let all = &self.everywhere;
        let tasks = if path.is_empty() { &self.tasks[..] } else { &[] };
        let known = &[known, tasks].concat()[..];
        let help = match (nearest(&entry.key, known), elsewhere(&entry.key, all)) {
            // The same name in another section is the likelier one: it is not misspelt.
            (None, Some(help)) => help,
            (Some(word), Some(help)) => format!("{help}; or `{word}`?"),
            (Some(word), None) => format!("did you mean `{word}`?"),
            // A long list helps less than the command that prints all keys with their meanings.
            (None, None) => match (known.len() <= 12, nearest_elsewhere(&entry.key, all)) {
                (_, Some(help)) => help,
                (true, None) => format!("known keys: {}", known.join(", ")),
                (false, None) => "`rubik-robot keys` lists all keys".to_owned(),
            },
        };
        self.faults.add_with_help(Some(&entry.key_place), reason, help);
    }

    /// Returns whether the user gave the key, section or element with the dotted name `path`.
    #[must_use]
    pub fn is_given(&self, path: &str) -> bool {
        self.places.contains_key(path)
    }

    /// Adds a fault at a key, or at the nearest section above it that was given. A reason that does
    /// not name a key without a place of its own begins with its name.
    pub fn fault(&mut self, path: &str, reason: impl Into<String>) {
        let (place, reason) = (self.nearest_place(path), reason.into());
        let reason = if self.is_given(path) || reason.contains(&format!("`{path}`")) {
            reason
        } else {
            format!("`{path}`: {reason}")
        };
        self.faults.add(place.as_ref(), reason);
    }

    /// Adds a fault with advice at a key, or at the nearest section above it that was given.
    pub fn fault_with_help(
        &mut self,
        path: &str,
        reason: impl Into<String>,
        help: impl Into<String>,
    ) {
        let place = self.nearest_place(path);
        self.faults.add_with_help(place.as_ref(), reason, help);
    }

    /// Returns the place of the key `path`, or else of the nearest section above it that was given.
    fn nearest_place(&self, path: &str) -> Option<Place> {
        // A key that the document does not contain has no place, but the section above it may have
        // one.
        let mut here = path;
        loop {
            if let Some(place) = self.places.get(here) {
                return Some(place.clone());
            }
            here = here.rsplit_once('.')?.0;
        }
    }
}

/// Largest number of keys that advice names.
const NAMED: usize = 3;

/// Returns the advice to use a key or section of this name in another section, from the dotted
/// names of all keys; `None` if there is none.
fn elsewhere(key: &str, all: &[String]) -> Option<String> {
    let mut found: Vec<&str> = Vec::new();
    for name in all {
        // Each part of a dotted name but the last is a section.
        let mut ends = name.match_indices('.').map(|(at, _)| at).chain([name.len()]);
        let named = |end: &usize| name[..*end].rsplit('.').next() == Some(key);
        if let Some(path) = ends.find(named).map(|end| &name[..end])
            && !found.contains(&path)
        {
            found.push(path);
        }
    }
    let names = |found: &[&str]| found.iter().map(|n| format!("`{n}`")).collect::<Vec<_>>();
    match &found[..] {
        [] => None,
        [one] => Some(format!("did you mean `{one}`? {}", home(one, all))),
        few if few.len() <= NAMED => Some(format!("did you mean {}?", names(few).join(" or "))),
        many => Some(format!(
            "did you mean {} or one of {} more? `rubik-robot keys` lists them",
            names(&many[..NAMED]).join(", "),
            many.len() - NAMED
        )),
    }
}

/// Returns in words where the key or section of a dotted name belongs.
fn home(path: &str, all: &[String]) -> String {
    // The names in the list are those of keys, so any other one is a section.
    let is_section = !all.iter().any(|name| name == path);
    match path.rsplit_once('.') {
        None if is_section => format!("it is a section of its own, [{path}]"),
        None => "it belongs before the first section".to_owned(),
        Some((section, _)) => match section.split_once(".NAME") {
            Some((list, _)) => format!("it belongs to an element of [[{list}]]"),
            None => format!("it belongs to [{section}]"),
        },
    }
}

/// Returns the advice of [`elsewhere`] for the name that is nearest to a misspelt one.
fn nearest_elsewhere(key: &str, all: &[String]) -> Option<String> {
    let last: Vec<&str> = all.iter().filter_map(|name| name.rsplit('.').next()).collect();
    elsewhere(nearest(key, &last)?, all)
}

/// Joins a path and a key to a dotted name. A key at the top level, where the path is empty, gets
/// no dot.
#[must_use]
pub fn join(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}

/// Reason why a value is refused.
#[derive(Debug, Clone, PartialEq)]
pub struct Wrong {
    /// Place, if it is a part of the value.
    pub place: Option<Place>,
    /// Reason for the user.
    pub reason: String,
    /// Possible values, or the one that was probably meant.
    pub help: Option<String>,
}

impl Wrong {
    /// Makes the reason for a value of a wrong type; `wanted` names the expected type in words.
    fn kind(wanted: &str, node: &Node) -> Self {
        Self {
            place: Some(node.place.clone()),
            reason: format!("expected {wanted}, found {}", node.describe()),
            help: None,
        }
    }
}

/// Type of value that a key can have.
pub trait Item: Sized {
    /// Returns the type in words for the user: "number", "3 times number".
    fn kind() -> String;
    /// Reads a value of this type, in the unit of the key, from a node of the document.
    ///
    /// # Errors
    /// [`Wrong`] with the reason.
    fn read(node: &Node) -> Result<Self, Wrong>;
    /// Writes the value as in TOML, in the unit of the key; `factor` converts that unit to SI.
    fn show(&self, factor: f64) -> String;
    /// Returns the numbers in the value, for the check of ranges.
    fn numbers(&self) -> Vec<f64> {
        Vec::new()
    }
    /// Converts the value to SI by the factor of the key's unit.
    #[must_use]
    fn scaled(self, factor: f64) -> Self {
        let _ = factor;
        self
    }
}

impl Item for f64 {
    fn kind() -> String {
        "number".to_owned()
    }
    fn read(node: &Node) -> Result<Self, Wrong> {
        match node.value {
            Value::Float(x) => Ok(x),
            // A user who writes 57 means 57.0.
            Value::Integer(i) => Ok(i as f64),
            _ => Err(Wrong::kind("a number", node)),
        }
    }
    fn show(&self, factor: f64) -> String {
        // Twelve digits hide the rounding of the conversion to SI and back.
        let x: f64 = format!("{:.11e}", self / factor).parse().unwrap_or(*self);
        x.to_string()
    }
    fn numbers(&self) -> Vec<f64> {
        vec![*self]
    }
    fn scaled(self, factor: f64) -> Self {
        self * factor
    }
}

/// Implements [`Item`] for types of whole numbers.
macro_rules! whole {
    ($($t:ty),*) => { $(
        impl Item for $t {
            fn kind() -> String {
                "whole number".to_owned()
            }
            fn read(node: &Node) -> Result<Self, Wrong> {
                match node.value {
                    Value::Integer(i) => Self::try_from(i).map_err(|_| Wrong {
                        place: None,
                        reason: if i < 0 && Self::MIN == 0 {
                            format!("{i} is negative")
                        } else {
                            format!("{i} is too large")
                        },
                        help: None,
                    }),
                    _ => Err(Wrong::kind("a whole number", node)),
                }
            }
            fn show(&self, _: f64) -> String {
                self.to_string()
            }
            fn numbers(&self) -> Vec<f64> {
                vec![*self as f64]
            }
        }
    )* };
}
whole!(u32, u64, i32);

impl Item for bool {
    fn kind() -> String {
        "true | false".to_owned()
    }
    fn read(node: &Node) -> Result<Self, Wrong> {
        match node.value {
            Value::Bool(b) => Ok(b),
            _ => Err(Wrong::kind("true or false", node)),
        }
    }
    fn show(&self, _: f64) -> String {
        self.to_string()
    }
}

impl Item for String {
    fn kind() -> String {
        "text".to_owned()
    }
    fn read(node: &Node) -> Result<Self, Wrong> {
        match &node.value {
            Value::Text(t) => Ok(t.clone()),
            _ => Err(Wrong::kind("text", node)),
        }
    }
    fn show(&self, _: f64) -> String {
        format!("\"{self}\"")
    }
}

impl<T: Item, const N: usize> Item for [T; N] {
    fn kind() -> String {
        format!("{N} times {}", T::kind())
    }
    fn read(node: &Node) -> Result<Self, Wrong> {
        let Value::Array(items) = &node.value else {
            return Err(Wrong::kind(&format!("an array of {N}"), node));
        };
        let read = items.iter().map(T::read).collect::<Result<Vec<T>, Wrong>>()?;
        read.try_into().map_err(|_| Wrong::kind(&format!("an array of {N}"), node))
    }
    fn show(&self, factor: f64) -> String {
        let items: Vec<String> = self.iter().map(|i| i.show(factor)).collect();
        format!("[{}]", items.join(", "))
    }
    fn numbers(&self) -> Vec<f64> {
        self.iter().flat_map(Item::numbers).collect()
    }
    fn scaled(self, factor: f64) -> Self {
        self.map(|i| i.scaled(factor))
    }
}

impl<T: Item> Item for Vec<T> {
    fn kind() -> String {
        format!("list of {}", T::kind())
    }
    fn read(node: &Node) -> Result<Self, Wrong> {
        let Value::Array(items) = &node.value else { return Err(Wrong::kind("a list", node)) };
        items.iter().map(T::read).collect()
    }
    fn show(&self, factor: f64) -> String {
        let items: Vec<String> = self.iter().map(|i| i.show(factor)).collect();
        format!("[{}]", items.join(", "))
    }
    fn numbers(&self) -> Vec<f64> {
        self.iter().flat_map(Item::numbers).collect()
    }
    fn scaled(self, factor: f64) -> Self {
        self.into_iter().map(|i| i.scaled(factor)).collect()
    }
}

impl<T: Item> Item for Option<T> {
    fn kind() -> String {
        T::kind()
    }
    fn read(node: &Node) -> Result<Self, Wrong> {
        T::read(node).map(Some)
    }
    fn show(&self, factor: f64) -> String {
        self.as_ref().map_or_else(|| "(not given)".to_owned(), |v| v.show(factor))
    }
    fn numbers(&self) -> Vec<f64> {
        self.as_ref().map_or_else(Vec::new, Item::numbers)
    }
    fn scaled(self, factor: f64) -> Self {
        self.map(|v| v.scaled(factor))
    }
}

/// Group of keys.
pub trait Section: Default {
    /// Overwrites the values of the keys that `node` contains; the others keep their values.
    fn overlay(&mut self, node: &Node, path: &str, reader: &mut Reader);
    /// Appends the keys of this section to `into`, with their present values as defaults. `path` is
    /// the dotted name of the section.
    fn keys(&self, path: &str, into: &mut Vec<Key>);
}

/// Declares an enumeration whose variants are words of a scenario, with the visibility before its
/// name.
#[macro_export]
macro_rules! words {
    ($(#[doc = $doc:literal])* $vis:vis $name:ident {
        $( $(#[doc = $vdoc:literal])* $variant:ident = $word:literal ),* $(,)?
    }) => {
        $(#[doc = $doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        $vis enum $name {
            $( $(#[doc = $vdoc])* #[serde(rename = $word)] $variant, )*
        }

        impl $name {
            /// Word of each variant.
            $vis const WORDS: &'static [&'static str] = &[$($word),*];

            /// Returns the word of the variant in a scenario.
            #[must_use]
            $vis fn word(self) -> &'static str {
                match self { $( Self::$variant => $word, )* }
            }
        }

        impl $crate::scenario::section::Item for $name {
            fn kind() -> String {
                let quoted: Vec<String> = Self::WORDS.iter().map(|w| format!("\"{w}\"")).collect();
                quoted.join(" | ")
            }
            fn read(
                node: &$crate::scenario::tree::Node,
            ) -> Result<Self, $crate::scenario::section::Wrong> {
                let text = <String as $crate::scenario::section::Item>::read(node)?;
                match text.as_str() {
                    $( $word => Ok(Self::$variant), )*
                    other => Err($crate::scenario::section::Wrong {
                        place: None,
                        reason: format!("\"{other}\" is not a possible value"),
                        help: Some(match $crate::scenario::fault::nearest(other, Self::WORDS) {
                            Some(word) => format!("did you mean \"{word}\"?"),
                            None => format!("possible: {}", Self::kind()),
                        }),
                    }),
                }
            }
            fn show(&self, _: f64) -> String {
                format!("\"{}\"", self.word())
            }
        }
    };
}
pub use words;

/// Makes the key of a field: its name, or the one given after `as`, followed by the unit.
#[doc(hidden)]
#[macro_export]
macro_rules! key_name {
    ($field:ident, , ) => {
        stringify!($field)
    };
    ($field:ident, , $unit:ident) => {
        concat!(stringify!($field), "_", stringify!($unit))
    };
    ($field:ident, $base:ident, ) => {
        stringify!($base)
    };
    ($field:ident, $base:ident, $unit:ident) => {
        concat!(stringify!($base), "_", stringify!($unit))
    };
}
pub use key_name;

/// Declares a struct of keys, in SI, with defaults in the units of the keys; see the head of the
/// module.
///
/// `field [unit]: type = default, range;` declares a key, and `with { field: Section, ... }` after
/// the keys the sections below. `field as base [unit]` is for two keys that differ only in the
/// unit.
#[macro_export]
macro_rules! section {
    ($(#[doc = $doc:literal])* $vis:vis $name:ident {
        $( $(#[doc = $kdoc:literal])*
           $key:ident $(as $base:ident)? $([$unit:ident])? : $ty:ty = $default:expr
           $(, $range:expr)? ; )*
    } $(with { $( $(#[doc = $sdoc:literal])* $sub:ident : $sty:ty ),* $(,)? })?) => {
        $(#[doc = $doc])*
        #[derive(Debug, Clone, PartialEq)]
        $vis struct $name {
            $( $(#[doc = $kdoc])* pub $key: $ty, )*
            $($( $(#[doc = $sdoc])* pub $sub: $sty, )*)?
        }

        impl Default for $name {
            fn default() -> Self {
                Self {
                    $( $key: {
                        let value: $ty = $default;
                        $crate::scenario::section::Item::scaled(
                            // The default is written in the unit of the key.
                            value, 1.0 $(* $crate::scenario::section::units::$unit)?)
                    }, )*
                    $($( $sub: <$sty>::default(), )*)?
                }
            }
        }

        impl $crate::scenario::section::Section for $name {
            fn overlay(
                &mut self,
                node: &$crate::scenario::tree::Node,
                path: &str,
                reader: &mut $crate::scenario::section::Reader,
            ) {
                const KNOWN: &[&str] = &[
                    $( $crate::scenario::section::key_name!($key, $($base)?, $($unit)?), )*
                    $($( stringify!($sub), )*)?
                ];
                for entry in reader.table(node, path) {
                    match entry.key.as_str() {
                        $( $crate::scenario::section::key_name!(
                            $key, $($base)?, $($unit)?
                        ) => reader.item(
                            &mut self.$key,
                            $crate::scenario::section::Declared {
                                factor: 1.0 $(* $crate::scenario::section::units::$unit)?,
                                range: [$($range)?].into_iter().next(),
                            },
                            entry,
                            path,
                        ), )*
                        $($( stringify!($sub) => self.$sub.overlay(
                            &entry.node,
                            &$crate::scenario::section::join(path, &entry.key),
                            reader,
                        ), )*)?
                        _ => reader.unknown(entry, path, KNOWN),
                    }
                }
            }

            fn keys(&self, path: &str, into: &mut Vec<$crate::scenario::section::Key>) {
                $( into.push($crate::scenario::section::Key {
                    path: $crate::scenario::section::join(
                        path, $crate::scenario::section::key_name!($key, $($base)?, $($unit)?)),
                    kind: <$ty as $crate::scenario::section::Item>::kind(),
                    default: $crate::scenario::section::Item::show(
                        &self.$key, 1.0 $(* $crate::scenario::section::units::$unit)?),
                    range: [$($range)?].into_iter().next(),
                    meaning: concat!($($kdoc),*).trim().to_owned(),
                }); )*
                $($( self.$sub.keys(
                    &$crate::scenario::section::join(path, stringify!($sub)),
                    into
                ); )*)?
            }
        }
    };
}
pub use section;
