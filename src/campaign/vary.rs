//! Variations of a campaign: keys of a scenario whose values are drawn by the seed of each run.
//!
//! - in: a TOML file in the form of a scenario, with a distribution in place of each value
//! - out: for a seed, overrides `KEY=VALUE`, as `run --set` takes them. The draws of a key do not
//!   depend on the other keys of the file
//!
//! ```toml
//! plant.errors.base_mm = { uniform = [0, 2] }
//! plant.cube_kind = { one_of = ["2007", "modern"] }
//! control.grip_n = { normal = [26, 1.5], within = [22, 30] }
//! planner.node_budget = { whole = [100, 200] }
//! fault = { one_of = [[], [{ kind = "jam", magnitude = 3, event = "turned", turned_deg = 30 }]] }
//! ```
//!
//! A value of `one_of` may be a whole list, such as the list of faults. It is written in one line
//! as the value of `--set`, and replaces the list of the scenario.

use crate::scenario::fault::{Faults, Source};
use crate::scenario::tree::{self, Entry, Node, Value};
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64;
use std::path::Path;
use std::rc::Rc;

/// Keywords of the distributions.
const WORDS: [&str; 4] = ["uniform", "whole", "normal", "one_of"];
/// Largest number of draws from a normal distribution that may miss its range. After them the value
/// is the mean.
const TRIES: usize = 1000;
/// Largest number of keys that a file may vary.
const MOST: usize = 1000;
/// Longest list of values that is spelled out for people (characters).
const LISTED: usize = 120;

/// Keys that a campaign draws.
///
/// ```
/// use rubik_robot::campaign::vary::Variations;
/// use std::path::Path;
///
/// let text = "control.grip_n = { uniform = [22, 30] }\nseed_of_hand = { whole = [1, 3] }\n";
/// let vary = Variations::read(Path::new("vary.toml"), text)?;
/// // Equal seeds draw equal values, each as an argument of `--set`.
/// let options: Vec<String> = vary.draw(7).iter().map(|drawn| drawn.option()).collect();
/// assert!(options[0].starts_with("control.grip_n=2"));
/// assert_eq!(options, vary.draw(7).iter().map(|drawn| drawn.option()).collect::<Vec<_>>());
/// # Ok::<(), rubik_robot::scenario::fault::Faults>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Variations {
    keys: Vec<Key>,
}

/// Key that is drawn.
#[derive(Debug, Clone, PartialEq)]
struct Key {
    name: String,
    distribution: Distribution,
    /// Place of the distribution, `file:line:column`.
    place: String,
}

/// Distribution from which a key is drawn.
#[derive(Debug, Clone, PartialEq)]
pub enum Distribution {
    /// Uniform distribution over a range.
    Uniform(f64, f64),
    /// Uniform distribution over whole numbers, both ends included.
    Whole(i64, i64),
    /// Normal distribution within a range.
    Normal {
        /// Mean.
        mean: f64,
        /// Standard deviation.
        deviation: f64,
        /// Range; a value outside is drawn again.
        within: (f64, f64),
    },
    /// List of values, all equally probable.
    OneOf(Vec<Choice>),
}

/// Value that a key may have.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Choice {
    /// Value in the syntax of TOML, in one line.
    pub text: String,
    /// Place of the value, `file:line:column`.
    pub place: String,
}

/// Key and its value of one run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Drawn {
    /// Dotted key.
    pub key: String,
    /// Value in the syntax of TOML.
    pub value: String,
    /// Place of the distribution or value, for messages: `file:line:column`.
    pub from: String,
}

impl Drawn {
    /// Returns the key with its drawn value, as an argument of `--set`: `KEY=VALUE`.
    #[must_use]
    pub fn option(&self) -> String {
        format!("{}={}", self.key, self.value)
    }
}

impl Variations {
    /// Reads the text of a `--vary` file. `path` names the file in messages.
    ///
    /// # Errors
    /// All faults of the text. The scenario checks later whether the keys exist.
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
        // The keys are sorted, so that their order in the file does not matter.
        keys.sort_by(|a: &Key, b| a.name.cmp(&b.name));
        if faults.0.is_empty() { Ok(Self { keys }) } else { Err(faults.sorted()) }
    }

    /// Returns the keys in the order of their names, with their distributions.
    pub fn keys(&self) -> impl Iterator<Item = (&str, &Distribution)> {
        self.keys.iter().map(|key| (key.name.as_str(), &key.distribution))
    }

    /// Draws the values of the run with this seed.
    #[must_use]
    pub fn draw(&self, seed: u64) -> Vec<Drawn> {
        // Each key has a random stream of its own, so that adding or removing a key does not change
        // the draws of the others.
        let of = |key: &Key| {
            let (value, from) =
                key.distribution.draw(&mut Pcg64::seed_from_u64(mixed(&key.name, seed)));
            let from = from.unwrap_or(&key.place).to_owned();
            Drawn { key: key.name.clone(), value, from }
        };
        self.keys.iter().map(of).collect()
    }
}

/// Hashes a key and the seed of a run into the seed of the key's random stream (FNV-1a).
fn mixed(key: &str, seed: u64) -> u64 {
    let bytes = key.bytes().chain(seed.to_le_bytes());
    bytes.fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

impl Distribution {
    /// Draws a value. Returns it as text; a value that was chosen from a list comes with the place
    /// in the file where the list has it.
    fn draw(&self, random: &mut Pcg64) -> (String, Option<&str>) {
        let value = match self {
            Self::Uniform(low, high) => number(random.random_range(*low..=*high), (*low, *high)),
            Self::Whole(low, high) => random.random_range(*low..=*high).to_string(),
            Self::Normal { mean, deviation, within } => {
                let range = within.0..=within.1;
                let drawn = Normal::new(*mean, *deviation)
                    .ok()
                    .and_then(|n| n.sample_iter(random).take(TRIES).find(|x| range.contains(x)));
                // The mean replaces a value after too many misses: the reader checks that it lies
                // within the range.
                number(drawn.unwrap_or(*mean).clamp(within.0, within.1), *within)
            }
            Self::OneOf(values) => {
                let drawn = &values[random.random_range(0..values.len())];
                return (drawn.text.clone(), Some(&drawn.place));
            }
        };
        (value, None)
    }

    /// Describes the distribution for people.
    #[must_use]
    pub fn words(&self) -> String {
        match self {
            Self::Uniform(low, high) => format!("uniform from {low} to {high}"),
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

/// Formats a value with six digits, so that people can read the command that repeats a run.
/// Rounding does not leave the range from `low` to `high`.
fn number(value: f64, (low, high): (f64, f64)) -> String {
    let short: f64 = format!("{value:.5e}").parse().unwrap_or(value);
    let text = format!("{}", short.clamp(low, high));
    // TOML reads a number without a point or an exponent as an integer.
    if text.contains(['.', 'e']) { text } else { format!("{text}.0") }
}

/// Collects the keys with their distributions from the table `path` and its subtables; adds what is
/// wrong to `faults`.
fn gather(node: &Node, path: &str, keys: &mut Vec<Key>, faults: &mut Faults) {
    let Value::Table(entries) = &node.value else {
        let reason = format!("`{path}` is {}, not a distribution", node.describe());
        let help = "write { uniform = [LOW, HIGH] }, { whole = [LOW, HIGH] }, \
                    { normal = [MEAN, DEVIATION] } or { one_of = [A, B] }; a value that is the \
                    same in all runs belongs in the scenario or in --set";
        faults.add_with_help(Some(&node.place), reason, help);
        return;
    };
    // A table with a keyword is a distribution; any other one is a section of the scenario. The top
    // level of the file is always a section.
    if entries.iter().any(|e| WORDS.contains(&e.key.as_str())) && !path.is_empty() {
        if let Some(distribution) = distribution(node, path, faults) {
            keys.push(Key { name: path.to_owned(), distribution, place: node.place.label() });
        }
        return;
    }
    for entry in entries {
        let at = if path.is_empty() { entry.key.clone() } else { format!("{path}.{}", entry.key) };
        if at == "seed" {
            faults
                .add(Some(&entry.key_place), "`seed` differs from run to run and cannot be varied");
        } else {
            gather(&entry.node, &at, keys, faults);
        }
    }
}

/// Reads the distribution of the key `path` from its table, and adds what is wrong to `faults`;
/// `None` if the table has no valid distribution.
fn distribution(node: &Node, path: &str, faults: &mut Faults) -> Option<Distribution> {
    let Value::Table(entries) = &node.value else { return None };
    let (mut distribution, mut within) = (None, None);
    for entry in entries {
        // Faults are collected and the loop goes on: the author wants to see all of them at once.
        let mut wrong = |reason: &str| {
            faults.add(Some(&entry.node.place), format!("`{path}`: {reason}"));
        };
        let pair = pair(&entry.node);
        // `within` is kept until the end, since it may precede `normal`.
        let drawn = match entry.key.as_str() {
            "within" => {
                match pair.filter(|(low, high)| low < high) {
                    None => wrong("`within` needs two numbers, the smaller first"),
                    range => within = range,
                }
                continue;
            }
            "uniform" => pair.filter(|(a, b)| a <= b && (b - a).is_finite()).map_or_else(
                || Err("`uniform` needs two numbers, the smaller first"),
                |(a, b)| Ok(Distribution::Uniform(a, b)),
            ),
            "whole" => whole_pair(&entry.node).map_or_else(
                || Err("`whole` needs two whole numbers, the smaller first"),
                |(a, b)| Ok(Distribution::Whole(a, b)),
            ),
            "normal" => pair.filter(|(_, deviation)| *deviation >= 0.0).map_or_else(
                || Err("`normal` needs a mean and a standard deviation that is not negative"),
                |(mean, deviation)| {
                    let within = (f64::NEG_INFINITY, f64::INFINITY);
                    Ok(Distribution::Normal { mean, deviation, within })
                },
            ),
            "one_of" => match choices(&entry.node) {
                Some(values) if !values.is_empty() => Ok(Distribution::OneOf(values)),
                _ => Err("`one_of` needs a list of values, none of them a table"),
            },
            _ => Err("expected one of uniform, whole, normal, one_of, and `within` beside normal"),
        };
        match drawn {
            Err(reason) => wrong(reason),
            Ok(_) if distribution.is_some() => wrong("more than one distribution"),
            Ok(drawn) => distribution = Some(drawn),
        }
    }
    match (&mut distribution, within) {
        (Some(Distribution::Normal { within, mean, .. }), Some(range)) => {
            if *mean < range.0 || *mean > range.1 {
                faults.add(Some(&node.place), format!("`{path}`: the mean lies outside `within`"));
            }
            *within = range;
        }
        (_, Some(_)) => {
            faults
                .add(Some(&node.place), format!("`{path}`: `within` is allowed with normal only"));
        }
        (_, None) => {}
    }
    distribution
}

/// Reads a list of two finite numbers; `None` if the value is anything else.
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

/// Reads a list of two whole numbers, the smaller first; `None` if the value is anything else.
fn whole_pair(node: &Node) -> Option<(i64, i64)> {
    let Value::Array(items) = &node.value else { return None };
    match items.iter().map(|i| &i.value).collect::<Vec<_>>()[..] {
        [Value::Integer(a), Value::Integer(b)] if a <= b => Some((*a, *b)),
        _ => None,
    }
}

/// Reads the values of a list; `None` if it is no list or a value is a table or a date.
fn choices(node: &Node) -> Option<Vec<Choice>> {
    let Value::Array(items) = &node.value else { return None };
    let choice = |item: &Node| {
        let fits = !matches!(item.value, Value::Table(_) | Value::Date);
        fits.then_some(Choice { text: in_a_line(item)?, place: item.place.label() })
    };
    items.iter().map(choice).collect()
}

/// Returns a value as TOML in one line: numbers and texts as in the file, lists and tables without
/// comments.
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
                // A text of several lines is written again on one; TOML knows the escapes of JSON.
                Value::Text(text) if written.contains('\n') => serde_json::to_string(text).ok(),
                _ => Some(written.to_owned()),
            }
        }
    }
}

/// Returns a key in the syntax of TOML, with quotes where it needs them.
fn key(name: &str) -> String {
    let bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let quoted = || serde_json::to_string(name).unwrap_or_default();
    if !name.is_empty() && name.chars().all(bare) { name.to_owned() } else { quoted() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads the text of a file of distributions named `v.toml`.
    fn read(text: &str) -> Result<Variations, Faults> {
        Variations::read(Path::new("v.toml"), text)
    }

    /// Distributions of four keys, one of each kind.
    const FOUR: &str = "plant.errors.base_mm = { uniform = [0, 2] }\n\
                        plant.cube_kind = { one_of = [\"2007\", \"modern\"] }\n\
                        [control]\ngrip_n = { normal = [26, 0.5], within = [25, 27] }\n\
                        [planner]\nnode_budget = { whole = [3, 5] }\n";

    /// Returns the value that a seed draws for a key.
    fn of(vary: &Variations, seed: u64, key: &str) -> String {
        vary.draw(seed).into_iter().find(|d| d.key == key).unwrap().value
    }

    #[test]
    fn equal_distributions_are_drawn_independently() {
        let two =
            "cube.mass_g = { uniform = [0, 2] }\nplant.errors.base_mm = { uniform = [0, 2] }\n";
        let vary = read(two).unwrap();
        let alike = |seed: &u64| {
            of(&vary, *seed, "cube.mass_g") == of(&vary, *seed, "plant.errors.base_mm")
        };
        assert_eq!((0..100).filter(alike).count(), 0, "one would follow the other");
    }

    #[test]
    fn keys_are_drawn_from_their_distributions() {
        let vary = read(FOUR).unwrap();
        let [mut kinds, mut budgets] = [(); 2].map(|()| std::collections::BTreeSet::new());
        let (mut base, mut grips) = (Vec::new(), Vec::new());
        for seed in 0..400 {
            let mm: f64 = of(&vary, seed, "plant.errors.base_mm").parse().unwrap();
            assert!((0.0..=2.0).contains(&mm));
            base.push(mm);
            let grip: f64 = of(&vary, seed, "control.grip_n").parse().unwrap();
            assert!((25.0..=27.0).contains(&grip));
            grips.push(grip);
            budgets.insert(of(&vary, seed, "planner.node_budget"));
            kinds.insert(of(&vary, seed, "plant.cube_kind"));
        }
        assert_eq!(kinds.into_iter().collect::<Vec<_>>(), ["\"2007\"", "\"modern\""]);
        assert_eq!(budgets.into_iter().collect::<Vec<_>>(), ["3", "4", "5"]);
        let moments = |values: &[f64]| {
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let square = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
            (mean, (square / values.len() as f64).sqrt())
        };
        // The standard error of the mean of 400 is 2 / sqrt(12) / 20 = 0.029.
        let (mean, deviation) = moments(&base);
        assert!(
            (mean - 1.0).abs() < 0.12 && (deviation - 0.577).abs() < 0.06,
            "{mean} {deviation}"
        );
        // A normal distribution that is cut off at two standard deviations has 0.88 of its own.
        let (mean, deviation) = moments(&grips);
        assert!((mean - 26.0).abs() < 0.1 && (deviation - 0.44).abs() < 0.06, "{mean} {deviation}");
    }

    #[test]
    fn other_keys_do_not_change_a_draw() {
        let vary = read(FOUR).unwrap();
        let fewer = read("plant.errors.base_mm = { uniform = [0, 2] }").unwrap();

        assert_eq!(vary.draw(7), vary.draw(7));
        assert_ne!(vary.draw(7), vary.draw(8));
        assert_eq!(of(&fewer, 7, "plant.errors.base_mm"), of(&vary, 7, "plant.errors.base_mm"));
    }

    #[test]
    fn drawn_fault_list_is_written_on_one_line() {
        let text = "fault = { one_of = [[],\n  [ # mended\n    { kind = \"jam\", magnitude = 3, \
                    event = \"turned\",\n      turned_deg = 30 },\n  ],\n  [{ kind = \"slip\", \
                    arm = \"\"\"\ntrack\"\"\", magnitude = 0.1, at_s = 9 }],\n] }\n";
        let vary = read(text).unwrap();
        let mut kinds = std::collections::BTreeSet::new();
        for seed in 0..40 {
            let [drawn] = &vary.draw(seed)[..] else { panic!("one key") };
            let place = ["v.toml:1:21", "v.toml:2:3", "v.toml:6:3"];
            assert!(!drawn.value.contains(['\n', '#']) && place.contains(&drawn.from.as_str()));
            let set = crate::scenario::Override::parse(&drawn.option()).unwrap();
            let scenario = crate::tasks::read(Path::new("t.toml"), "", &[set]).unwrap();
            kinds.insert(format!("{:?}", scenario.plant.faults.first().map(|f| f.kind)));
        }
        assert_eq!(kinds.len(), 3, "{kinds:?}");
    }

    #[test]
    fn scenario_reads_the_drawn_values() {
        let vary = read(FOUR.split("[planner]").next().unwrap()).unwrap();
        for seed in 0..20 {
            let overrides: Vec<_> = vary
                .draw(seed)
                .iter()
                .map(|d| crate::scenario::Override::parse(&d.option()).unwrap())
                .collect();
            crate::tasks::read(Path::new("t.toml"), "", &overrides).unwrap();
        }
    }

    #[test]
    fn read_reports_all_errors_with_line_and_column() {
        let wrong = read(
            "seed = { uniform = [1, 2] }\ncontrol.grip_n = 30\na.b = { uniform = [2, 1] }\n\
             c = { normal = [1, -1] }\nd = { one_of = [] }\n\
             e = { uniform = [0, 1], whole = [0, 1] }\n\
             f = { uniform = [0, 1], within = [0, 1] }\ng = { normal = [5, 1], within = [0, 1] }\n\
             h = { uniform = [0, inf] }\n",
        )
        .unwrap_err()
        .to_string();

        for part in [
            "v.toml:1:1: `seed` differs from run to run",
            "v.toml:2:18: `control.grip_n` is `30`, not a distribution",
            "v.toml:3:19: `a.b`: `uniform` needs two numbers",
            "`c`: `normal` needs a mean",
            "`d`: `one_of` needs a list",
            "`e`: more than one distribution",
            "`f`: `within` is allowed with normal only",
            "`g`: the mean lies outside",
            "`h`: `uniform` needs two numbers",
        ] {
            assert!(wrong.contains(part), "no `{part}` in\n{wrong}");
        }
        assert!(read("").unwrap_err().to_string().contains("no key is varied"));
    }

    #[test]
    fn truncated_normal_draw_stays_within_its_range() {
        let vary = read("a = { normal = [0, 1e-9], within = [0, 1] }").unwrap();
        for seed in 0..50 {
            let value: f64 = of(&vary, seed, "a").parse().unwrap();
            assert!((0.0..=1.0).contains(&value));
        }
    }
}
