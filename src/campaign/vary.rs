//! What differs from run to run: keys of a scenario, and how each is drawn by the run's seed.
//!
//! - in: a TOML file in the form of a scenario, with a way of drawing in place of each value
//! - out: for a seed, `KEY=VALUE` as for `run --set`; another key in the file changes no draw of the others
//!
//! ```toml
//! plant.errors.base_mm = { uniform = [0, 2] }
//! plant.cube_kind = { one_of = ["2007", "modern"] }
//! control.grip_n = { normal = [26, 1.5], within = [22, 30] }
//! planner.node_budget = { whole = [100, 200] }
//! fault = { one_of = [[], [{ kind = "jam", magnitude = 3, event = "turned", turned_deg = 30 }]] }
//! ```
//!
//! A value of `one_of` may be a whole list, as that of the faults; an option takes it in one line, and in the place of the
//! scenario's own.

use crate::scenario::fault::{Faults, Source};
use crate::scenario::tree::{self, Entry, Node, Value};
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;
use std::path::Path;
use std::rc::Rc;

/// The words that say how a key is drawn.
const WORDS: [&str; 4] = ["uniform", "whole", "normal", "one_of"];
/// Draws of a normal distribution that may miss its range; after them the nearest end is taken.
const TRIES: usize = 1000;
/// Keys that a file may vary.
const MOST: usize = 1000;
/// Longer lists of values are told by their number (characters).
const LISTED: usize = 120;

/// All that is drawn.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Vary {
    keys: Vec<Key>,
}

/// A key that is drawn.
#[derive(Debug, Clone, PartialEq)]
struct Key {
    name: String,
    way: Way,
    /// `file:line:column` of the way.
    place: String,
}

/// How a key is drawn.
#[derive(Debug, Clone, PartialEq)]
pub enum Way {
    /// Evenly from a range.
    Uniform(f64, f64),
    /// Evenly from whole numbers, both ends among them.
    Whole(i64, i64),
    /// From a normal distribution within a range.
    Normal {
        /// Mean.
        mean: f64,
        /// Standard deviation.
        deviation: f64,
        /// What lies outside is drawn anew.
        within: (f64, f64),
    },
    /// One of some values.
    OneOf(Vec<Choice>),
}

/// One of the values that a key may have.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Choice {
    /// As TOML writes it, in one line.
    pub text: String,
    /// `file:line:column`.
    pub place: String,
}

/// A key and its value of one run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Drawn {
    /// Dotted key.
    pub key: String,
    /// Value as TOML writes it.
    pub value: String,
    /// Where it is from, for faults: `file:line:column`, or an option.
    pub from: String,
}

impl Drawn {
    /// As behind `--set`.
    #[must_use]
    pub fn option(&self) -> String {
        format!("{}={}", self.key, self.value)
    }
}

impl Vary {
    /// Reads a file's text; `path` names it in faults.
    ///
    /// # Errors
    /// All that is wrong with it. Whether the keys exist, a scenario must say.
    pub fn read(path: &Path, text: &str) -> Result<Self, Faults> {
        let mut faults = Faults::default();
        let name = path.display().to_string();
        let source = Rc::new(Source { name, text: text.to_owned(), is_file: true });
        let document = tree::parse(&source, &mut faults);
        let mut keys = Vec::new();
        if faults.0.is_empty() {
            gather(&document, "", &mut keys, &mut faults);
        }
        if keys.len() > MOST {
            faults.add(None, format!("{}: {} keys; {MOST} at most", path.display(), keys.len()));
        } else if keys.is_empty() && faults.0.is_empty() {
            faults.add(None, format!("{}: no key is varied", path.display()));
        }
        keys.sort_by(|a: &Key, b| a.name.cmp(&b.name));
        if faults.0.is_empty() { Ok(Self { keys }) } else { Err(faults.sorted()) }
    }

    /// The keys in their order, and how each is drawn.
    pub fn keys(&self) -> impl Iterator<Item = (&str, &Way)> {
        self.keys.iter().map(|key| (key.name.as_str(), &key.way))
    }

    /// The values of the run with this seed.
    #[must_use]
    pub fn draw(&self, seed: u64) -> Vec<Drawn> {
        let of = |key: &Key| {
            let (value, from) = key.way.draw(&mut Pcg64::seed_from_u64(mixed(&key.name, seed)));
            let from = from.unwrap_or(&key.place).to_owned();
            Drawn { key: key.name.clone(), value, from }
        };
        self.keys.iter().map(of).collect()
    }
}

/// A seed for a key of a run (FNV-1a over both).
fn mixed(key: &str, seed: u64) -> u64 {
    let bytes = key.bytes().chain(seed.to_le_bytes());
    bytes.fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

impl Way {
    /// A value, and its own place where it has one.
    fn draw(&self, random: &mut Pcg64) -> (String, Option<&str>) {
        let value = match self {
            Self::Uniform(low, high) => number(random.random_range(*low..=*high), (*low, *high)),
            Self::Whole(low, high) => random.random_range(*low..=*high).to_string(),
            Self::Normal { mean, deviation, within } => {
                let range = within.0..=within.1;
                let drawn = Normal::new(*mean, *deviation)
                    .ok()
                    .and_then(|n| n.sample_iter(random).take(TRIES).find(|x| range.contains(x)));
                number(drawn.unwrap_or(*mean).clamp(within.0, within.1), *within)
            }
            Self::OneOf(values) => {
                let drawn = &values[random.random_range(0..values.len())];
                return (drawn.text.clone(), Some(&drawn.place));
            }
        };
        (value, None)
    }

    /// For people.
    #[must_use]
    pub fn words(&self) -> String {
        match self {
            Self::Uniform(low, high) => format!("evenly from {low} to {high}"),
            Self::Whole(low, high) => format!("whole numbers from {low} to {high}"),
            Self::Normal { mean, deviation, within: (low, high) } => {
                let range = if low.is_finite() && high.is_finite() {
                    format!(", within {low} to {high}")
                } else {
                    String::new()
                };
                format!("normal, {mean} with a standard deviation of {deviation}{range}")
            }
            Self::OneOf(values) => {
                let texts: Vec<&str> = values.iter().map(|v| v.text.as_str()).collect();
                let list = texts.join(", ");
                if list.chars().count() <= LISTED {
                    return format!("one of {list}");
                }
                format!("one of {} values", values.len())
            }
        }
    }
}

/// Six digits, so that the command that repeats a run can be read; not beyond the range's ends.
fn number(value: f64, (low, high): (f64, f64)) -> String {
    let short: f64 = format!("{value:.5e}").parse().unwrap_or(value);
    let text = format!("{}", short.clamp(low, high));
    // TOML wants a point or an exponent in a number that is none of the whole ones.
    if text.contains(['.', 'e']) { text } else { format!("{text}.0") }
}

fn gather(node: &Node, path: &str, keys: &mut Vec<Key>, faults: &mut Faults) {
    let Value::Table(entries) = &node.value else {
        let reason = format!("`{path}` is {}, and nothing is drawn", node.describe());
        let help = "write { uniform = [LOW, HIGH] }, { whole = [LOW, HIGH] }, { normal = [MEAN, DEVIATION] } or { one_of = [A, B] }; what is the same in all runs belongs into the scenario or behind --set";
        faults.add_with_help(Some(&node.place), reason, help);
        return;
    };
    if entries.iter().any(|e| WORDS.contains(&e.key.as_str())) && !path.is_empty() {
        if let Some(way) = way(node, path, faults) {
            keys.push(Key { name: path.to_owned(), way, place: node.place.label() });
        }
        return;
    }
    for entry in entries {
        let at = if path.is_empty() { entry.key.clone() } else { format!("{path}.{}", entry.key) };
        if at == "seed" {
            faults.add(Some(&entry.key_place), "`seed` is each run's own, and cannot be drawn");
        } else {
            gather(&entry.node, &at, keys, faults);
        }
    }
}

fn way(node: &Node, path: &str, faults: &mut Faults) -> Option<Way> {
    let Value::Table(entries) = &node.value else { return None };
    let (mut way, mut within) = (None, None);
    for entry in entries {
        let mut wrong = |reason: &str| {
            faults.add(Some(&entry.node.place), format!("`{path}`: {reason}"));
        };
        let pair = pair(&entry.node);
        let drawn = match entry.key.as_str() {
            "within" => {
                match pair.filter(|(low, high)| low < high) {
                    None => wrong("`within` wants two numbers, the smaller first"),
                    range => within = range,
                }
                continue;
            }
            "uniform" => pair.filter(|(a, b)| a <= b && (b - a).is_finite()).map_or_else(
                || Err("`uniform` wants two numbers, the smaller first"),
                |(a, b)| Ok(Way::Uniform(a, b)),
            ),
            "whole" => whole_pair(&entry.node).map_or_else(
                || Err("`whole` wants two whole numbers, the smaller first"),
                |(a, b)| Ok(Way::Whole(a, b)),
            ),
            "normal" => pair.filter(|(_, deviation)| *deviation >= 0.0).map_or_else(
                || Err("`normal` wants a mean and a standard deviation that is not negative"),
                |(mean, deviation)| {
                    let within = (f64::NEG_INFINITY, f64::INFINITY);
                    Ok(Way::Normal { mean, deviation, within })
                },
            ),
            "one_of" => match choices(&entry.node) {
                Some(values) if !values.is_empty() => Ok(Way::OneOf(values)),
                _ => Err("`one_of` wants a list of values, none of them a table"),
            },
            _ => Err("wanted one of uniform, whole, normal, one_of, and `within` beside normal"),
        };
        match drawn {
            Err(reason) => wrong(reason),
            Ok(_) if way.is_some() => wrong("is drawn in two ways"),
            Ok(drawn) => way = Some(drawn),
        }
    }
    match (&mut way, within) {
        (Some(Way::Normal { within, mean, .. }), Some(range)) => {
            if *mean < range.0 || *mean > range.1 {
                faults.add(Some(&node.place), format!("`{path}`: the mean lies outside `within`"));
            }
            *within = range;
        }
        (_, Some(_)) => {
            faults.add(Some(&node.place), format!("`{path}`: `within` goes with normal only"));
        }
        (_, None) => {}
    }
    way
}

fn pair(node: &Node) -> Option<(f64, f64)> {
    let Value::Array(items) = &node.value else { return None };
    let number = |node: &Node| match node.value {
        Value::Integer(i) => Some(i as f64),
        Value::Float(x) => Some(x).filter(|x| x.is_finite()),
        _ => None,
    };
    match items.as_slice() {
        [a, b] => number(a).zip(number(b)),
        _ => None,
    }
}

fn whole_pair(node: &Node) -> Option<(i64, i64)> {
    let Value::Array(items) = &node.value else { return None };
    match items.iter().map(|i| &i.value).collect::<Vec<_>>()[..] {
        [Value::Integer(a), Value::Integer(b)] if a <= b => Some((*a, *b)),
        _ => None,
    }
}

/// The values of a list.
fn choices(node: &Node) -> Option<Vec<Choice>> {
    let Value::Array(items) = &node.value else { return None };
    let choice = |item: &Node| {
        let fits = !matches!(item.value, Value::Table(_) | Value::Date);
        fits.then_some(Choice { text: in_a_line(item)?, place: item.place.label() })
    };
    items.iter().map(choice).collect()
}

/// A value in one line: numbers and words as they are written in the file, lists and tables without their comments.
fn in_a_line(node: &Node) -> Option<String> {
    let list = |texts: Option<Vec<String>>| texts.map(|texts| texts.join(","));
    match &node.value {
        Value::Array(items) => Some(format!("[{}]", list(items.iter().map(in_a_line).collect())?)),
        Value::Table(entries) => {
            let entry = |e: &Entry| Some(format!("{}={}", key(&e.key), in_a_line(&e.node)?));
            Some(format!("{{{}}}", list(entries.iter().map(entry).collect())?))
        }
        value => {
            let written = node.place.source.text.get(node.place.span.clone())?;
            match value {
                // JSON's escapes are TOML's.
                Value::Text(text) if written.contains('\n') => serde_json::to_string(text).ok(),
                _ => Some(written.to_owned()),
            }
        }
    }
}

/// A key as TOML writes it.
fn key(name: &str) -> String {
    let bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let quoted = || serde_json::to_string(name).unwrap_or_default();
    if !name.is_empty() && name.chars().all(bare) { name.to_owned() } else { quoted() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vary, Faults> {
        Vary::read(Path::new("v.toml"), text)
    }

    const FOUR: &str = "plant.errors.base_mm = { uniform = [0, 2] }\n\
                        plant.cube_kind = { one_of = [\"2007\", \"modern\"] }\n\
                        [control]\ngrip_n = { normal = [26, 1.5], within = [25, 27] }\n\
                        [planner]\nnode_budget = { whole = [3, 5] }\n";

    fn of(vary: &Vary, seed: u64, key: &str) -> String {
        vary.draw(seed).into_iter().find(|d| d.key == key).unwrap().value
    }

    #[test]
    fn keys_that_are_drawn_in_one_way_are_drawn_one_apart_from_the_other() {
        let two =
            "cube.mass_g = { uniform = [0, 2] }\nplant.errors.base_mm = { uniform = [0, 2] }\n";
        let vary = read(two).unwrap();
        let alike = |seed: &u64| {
            of(&vary, *seed, "cube.mass_g") == of(&vary, *seed, "plant.errors.base_mm")
        };
        assert_eq!((0..100).filter(alike).count(), 0, "one would follow the other");
    }

    #[test]
    fn each_key_is_drawn_in_its_way() {
        let vary = read(FOUR).unwrap();
        let mut kinds = std::collections::BTreeSet::new();
        let mut base = Vec::new();
        for seed in 0..400 {
            let mm: f64 = of(&vary, seed, "plant.errors.base_mm").parse().unwrap();
            assert!((0.0..=2.0).contains(&mm));
            base.push(mm);
            let grip: f64 = of(&vary, seed, "control.grip_n").parse().unwrap();
            assert!((25.0..=27.0).contains(&grip));
            assert!(["3", "4", "5"].contains(&of(&vary, seed, "planner.node_budget").as_str()));
            kinds.insert(of(&vary, seed, "plant.cube_kind"));
        }
        assert_eq!(kinds.into_iter().collect::<Vec<_>>(), ["\"2007\"", "\"modern\""]);
        let mean = base.iter().sum::<f64>() / base.len() as f64;
        // Standard error of the mean of 400: 2 / sqrt(12) / 20 = 0.029.
        assert!((mean - 1.0).abs() < 0.12, "{mean}");
    }

    #[test]
    fn a_seed_draws_the_same_whatever_else_is_drawn() {
        let vary = read(FOUR).unwrap();
        let fewer = read("plant.errors.base_mm = { uniform = [0, 2] }").unwrap();

        assert_eq!(vary.draw(7), vary.draw(7));
        assert_ne!(vary.draw(7), vary.draw(8));
        assert_eq!(of(&fewer, 7, "plant.errors.base_mm"), of(&vary, 7, "plant.errors.base_mm"));
    }

    #[test]
    fn a_whole_list_of_faults_is_drawn_in_one_line_and_knows_its_place() {
        let text = "fault = { one_of = [[],\n  [ # mended\n    { kind = \"jam\", magnitude = 3, event = \"turned\",\n      \
                    turned_deg = 30 },\n  ],\n  [{ kind = \"slip\", arm = \"\"\"\ntrack\"\"\", magnitude = 0.1, at_s = 9 }],\n] }\n";
        let vary = read(text).unwrap();
        let mut kinds = std::collections::BTreeSet::new();
        for seed in 0..40 {
            let [drawn] = &vary.draw(seed)[..] else { panic!("one key") };
            let place = ["v.toml:1:21", "v.toml:2:3", "v.toml:6:3"];
            assert!(!drawn.value.contains(['\n', '#']) && place.contains(&drawn.from.as_str()));
            let set = crate::scenario::Override::parse(&drawn.option()).unwrap();
            let scenario = crate::scenario::read(Path::new("t.toml"), "", &[set]).unwrap();
            kinds.insert(format!("{:?}", scenario.plant.faults.first().map(|f| f.kind)));
        }
        assert_eq!(kinds.len(), 3, "{kinds:?}");
    }

    #[test]
    fn what_is_drawn_can_be_read_by_a_scenario() {
        let vary = read(FOUR.split("[planner]").next().unwrap()).unwrap();
        for seed in 0..20 {
            let overrides: Vec<_> = vary
                .draw(seed)
                .iter()
                .map(|d| crate::scenario::Override::parse(&d.option()).unwrap())
                .collect();
            crate::scenario::read(Path::new("t.toml"), "", &overrides).unwrap();
        }
    }

    #[test]
    fn faults_are_told_all_at_once_with_their_places() {
        let wrong = read(
            "seed = { uniform = [1, 2] }\ncontrol.grip_n = 30\na.b = { uniform = [2, 1] }\n\
             c = { normal = [1, -1] }\nd = { one_of = [] }\ne = { uniform = [0, 1], whole = [0, 1] }\n\
             f = { uniform = [0, 1], within = [0, 1] }\ng = { normal = [5, 1], within = [0, 1] }\n\
             h = { uniform = [0, inf] }\n",
        )
        .unwrap_err()
        .to_string();

        for part in [
            "v.toml:1:1: `seed` is each run's own",
            "v.toml:2:18: `control.grip_n` is `30`, and nothing is drawn",
            "v.toml:3:19: `a.b`: `uniform` wants two numbers",
            "`c`: `normal` wants a mean",
            "`d`: `one_of` wants a list",
            "`e`: is drawn in two ways",
            "`f`: `within` goes with normal only",
            "`g`: the mean lies outside",
            "`h`: `uniform` wants two numbers",
        ] {
            assert!(wrong.contains(part), "no `{part}` in\n{wrong}");
        }
        assert!(read("").unwrap_err().to_string().contains("no key is varied"));
    }

    #[test]
    fn an_improbable_range_ends_at_its_nearer_end() {
        let vary = read("a = { normal = [0, 1e-9], within = [0, 1] }").unwrap();
        for seed in 0..50 {
            let value: f64 = of(&vary, seed, "a").parse().unwrap();
            assert!((0.0..=1.0).contains(&value));
        }
    }
}
