//! The state file of a campaign: its header, then one line of JSON for each run that has ended.
//!
//! - in: the file of an earlier campaign, whose last line may be cut off
//! - out: the [`Header`], the results by seed, the length of the valid part of the file
//!
//! The campaign appends a line when a run ends, so a campaign that was killed continues where it
//! stopped. A campaign that is extended to more runs appends a second header.
//!
//! The lock of the file keeps a second campaign away. On a network file system whose locks do not
//! reach other hosts, two processes may write one file. The reader then relies on three facts: a
//! run repeats to the bit, so that its second result is equal to its first; an append that hits
//! another one makes a line that is no JSON, and is left out; a seed without a result is run again.

use super::result::RunResult;
use crate::scenario::maker::Maker;
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{BufRead, Read};

/// Longest line that is read (bytes): enough for a header with a long `--vary` file, or for a
/// result with a thousand drawn keys.
const LONGEST: u64 = 1 << 20;
/// Largest number of runs of a campaign, and of its shards: a campaign keeps a list of its runs.
pub(crate) const MOST_RUNS: u64 = 10_000_000;
/// Build of a campaign whose shards were performed by different builds of one version.
pub(crate) const SEVERAL: &str = "several";
/// Largest number of missing shards that are named; further ones are only counted.
pub(crate) const NAMED: usize = 20;

/// Identity of a campaign. Two files belong together if [`Header::differs`] finds no difference.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// Version of the program.
    pub version: String,
    /// Checksum of the program, since two builds of one version may differ. It is "several" after
    /// a merge of shards from different builds.
    pub build: String,
    /// Program, and its tasks; `None` in the file of a version that did not name them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<Maker>,
    /// Task of the runs; empty in the file of a version that did not name it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub task: String,
    /// Path of the scenario, as given.
    pub scenario: String,
    /// Checksum over the scenario's text, and over the scenario as read with the files that it
    /// names.
    pub scenario_sum: String,
    /// Overrides of all runs, in the form `KEY=VALUE` of `--set`.
    pub set: Vec<String>,
    /// Text of the `--vary` file; empty without one.
    pub vary: String,
    /// Seed of the first run; the other runs have the seeds that follow.
    pub seed: u64,
    /// Number of runs of the whole campaign.
    pub runs: u64,
    /// Part of the campaign that the file holds.
    pub shard: Shard,
    /// Time that a run may take by the wall clock (s).
    pub limit_s: u64,
}

/// A part of a campaign, K/N: each N-th run, beginning with run K (from 1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "(u64, u64)", into = "(u64, u64)")]
pub struct Shard {
    number: u64,
    of: u64,
}

impl Default for Shard {
    fn default() -> Self {
        Self { number: 1, of: 1 }
    }
}

impl TryFrom<(u64, u64)> for Shard {
    type Error = String;

    fn try_from((number, of): (u64, u64)) -> Result<Self, String> {
        if number >= 1 && number <= of {
            return Ok(Self { number, of });
        }
        Err(format!("{number}/{of} is not a shard: expected K/N with K from 1 to N"))
    }
}

impl From<Shard> for (u64, u64) {
    fn from(shard: Shard) -> Self {
        (shard.number, shard.of)
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts =
            text.split_once('/').and_then(|(k, n)| Some((k.parse().ok()?, n.parse().ok()?)));
        parts.ok_or_else(|| format!("`{text}` is not a shard: write K/N, as in 2/4"))?.try_into()
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl Header {
    /// Returns the name of the program that performed the campaign.
    #[must_use]
    pub fn program_name(&self) -> &str {
        self.program.as_ref().map_or("rubik-robot", |maker| &maker.program)
    }

    /// Returns the seeds of this shard.
    pub fn seeds(&self) -> impl Iterator<Item = u64> + use<> {
        let (first, step) = (self.shard.number - 1, self.shard.of);
        let (seed, runs) = (self.seed, self.runs);
        // Checked, because the numbers of a state file may be anything up to 2^64 - 1.
        let index = move |k: u64| first.checked_add(k.checked_mul(step)?).filter(|i| *i < runs);
        (0..).map_while(index).map_while(move |i| seed.checked_add(i))
    }

    /// Returns the number of seeds of this shard.
    #[must_use]
    pub fn asked(&self) -> u64 {
        let (first, step) = (self.shard.number - 1, self.shard.of);
        // Computed, since counting the seeds of a state file with 2^64 runs would not end. Seeds
        // end at 2^64 - 1.
        let runs = self.runs.min((u64::MAX - self.seed).saturating_add(1));
        runs.checked_sub(first + 1).map_or(0, |others| others / step + 1)
    }

    /// Returns a message if the campaign has more runs or shards than [`MOST_RUNS`].
    fn excess(&self) -> Option<String> {
        let most = |what: &str, count| {
            (count > MOST_RUNS).then(|| format!("{count} {what} exceed the limit of {MOST_RUNS}"))
        };
        most("runs", self.runs).or_else(|| most("shards", self.shard.of))
    }

    /// Returns whether a seed belongs to this shard.
    #[must_use]
    pub fn holds(&self, seed: u64) -> bool {
        seed.checked_sub(self.seed)
            .is_some_and(|i| i < self.runs && i % self.shard.of == self.shard.number - 1)
    }

    /// Returns whether the other header is of the same campaign and shard, with as many runs or
    /// more.
    #[must_use]
    pub fn is_extended_by(&self, other: &Self) -> bool {
        let same = Self { runs: other.runs, ..self.clone() };
        same.differs(other).is_none() && self.shard == other.shard && self.runs <= other.runs
    }

    /// Finds the first difference that keeps two files from being parts of one campaign. The path
    /// of the scenario, the build and the shard may differ.
    #[must_use]
    pub fn differs(&self, other: &Self) -> Option<String> {
        let difference = |what: &str, a: &dyn std::fmt::Display, b: &dyn std::fmt::Display| {
            Some(format!("{what}: {a} and {b}"))
        };
        if self.version != other.version {
            return difference("versions of the program", &self.version, &other.version);
        }
        // A file without a program may belong to any.
        if let (Some(a), Some(b)) = (&self.program, &other.program)
            && (&a.program, &a.version) != (&b.program, &b.version)
        {
            return difference("programs", a, b);
        }
        // Before the checksum of the scenario, which covers `--set` as well: this reason says more.
        if self.set != other.set {
            return difference("--set", &self.set.join(" "), &other.set.join(" "));
        }
        if self.scenario_sum != other.scenario_sum {
            return difference("scenarios", &self.scenario, &other.scenario)
                .map(|t| format!("{t}, whose contents differ"));
        }
        if self.vary != other.vary {
            return Some("varied keys (--vary)".to_owned());
        }
        if self.seed != other.seed {
            return difference("first seeds", &self.seed, &other.seed);
        }
        if self.runs != other.runs {
            return difference("numbers of runs", &self.runs, &other.runs);
        }
        if self.limit_s != other.limit_s {
            return difference("time limits", &self.limit_s, &other.limit_s);
        }
        None
    }
}

/// First line of a file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct First {
    campaign: Header,
}

/// Contents of a state file.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Header of the campaign.
    pub header: Header,
    /// Results by seed.
    pub results: BTreeMap<u64, RunResult>,
    /// Length of the file up to the end of its last valid line (bytes).
    pub whole: u64,
    /// Number of lines before that end that are no JSON and are left out. The runs of their
    /// results count as not performed.
    pub damaged: u64,
    /// Whether further bytes follow, which are not used.
    pub torn: bool,
}

/// Reason why a file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Unusable {
    /// The file cannot be read.
    #[error("{0}")]
    File(#[from] std::io::Error),
    /// The file is empty or its first line is cut off. It holds no result and may be overwritten.
    #[error("empty")]
    Empty,
    /// A line does not belong to a campaign.
    #[error("line {line}: {why}")]
    Line {
        /// Number of the line, from 1.
        line: u64,
        /// Reason.
        why: String,
    },
}

/// Returns the header as the first line of a new state file, with its line break.
#[must_use]
pub(crate) fn first_line(header: &Header) -> String {
    let first = First { campaign: header.clone() };
    serde_json::to_string(&first).map_or_else(|_| String::new(), |line| line + "\n")
}

/// Returns a result as a line of the state file, with its line break.
#[must_use]
pub fn line(result: &RunResult) -> String {
    serde_json::to_string(result).map_or_else(|_| String::new(), |line| line + "\n")
}

impl State {
    /// Reads a state file. Damaged lines are left out: a last line that is cut off or holds no
    /// result, and any line that is no JSON.
    ///
    /// # Errors
    /// [`Unusable`], if the file cannot be read, has no header, or has a line of JSON before the
    /// last one that is no result of this campaign.
    pub fn read(mut from: impl BufRead) -> Result<Self, Unusable> {
        let mut bytes = Vec::new();
        let Some(first) = next(&mut from, &mut bytes, 1)? else { return Err(Unusable::Empty) };
        let wrong = |line, why: String| Unusable::Line { line, why };
        let header = match serde_json::from_slice::<First>(&bytes) {
            Ok(first) => first.campaign,
            // The campaign was killed while it wrote the header. Any other text is a file of
            // another kind, which must not be overwritten.
            Err(_) if !first && b"{\"campaign\":".starts_with(&bytes[..bytes.len().min(12)]) => {
                return Err(Unusable::Empty);
            }
            Err(why) => return Err(wrong(1, format!("not the state file of a campaign: {why}"))),
        };
        // Only the line break is missing. The file holds no result, so it may be written again.
        if !first {
            return Err(Unusable::Empty);
        }
        if let Some(why) = header.excess() {
            return Err(wrong(1, why));
        }
        let mut whole = bytes.len() as u64;
        let mut state = Self { header, results: BTreeMap::new(), whole, damaged: 0, torn: false };
        let (mut number, mut damaged) = (1, 0);
        while let Some(ended) = next(&mut from, &mut bytes, number + 1)? {
            number += 1;
            let read = serde_json::from_slice::<RunResult>(&bytes);
            // Without a line break the line may be cut off, even where it reads as a result.
            if !ended {
                state.torn = true;
                break;
            }
            match read {
                Ok(result) => state.take(result).map_err(|why| wrong(number, why))?,
                Err(_) if state.extend(&bytes) => {}
                // A power cut may leave any bytes in the last line, but not in one before it.
                Err(_) if from.fill_buf()?.is_empty() => {
                    state.torn = true;
                    break;
                }
                // A second writer on another host has cut this line, or its end is lost. A line of
                // a later build would be valid JSON, and its result must not get lost.
                Err(_) if serde_json::from_slice::<IgnoredAny>(&bytes).is_err() => {
                    damaged += 1;
                    whole += bytes.len() as u64;
                    continue;
                }
                Err(why) => return Err(wrong(number, why.to_string())),
            }
            whole += bytes.len() as u64;
            (state.whole, state.damaged) = (whole, damaged);
        }
        Ok(state)
    }

    /// Takes the number of runs from a line that is a later header of the same campaign, with as
    /// many runs or more. Returns `false` for any other line, which changes nothing.
    fn extend(&mut self, line: &[u8]) -> bool {
        let Ok(First { campaign: later }) = serde_json::from_slice(line) else { return false };
        let extends = self.header.is_extended_by(&later) && later.excess().is_none();
        if extends {
            self.header.runs = later.runs;
        }
        extends
    }

    /// Makes this the state of the whole campaign. Returns the shards that lack all or some of
    /// their results. `shards` are those of the merged files. If they divide the campaign into
    /// different numbers of parts, as 1/2 and 1/3 do, no shard is returned.
    #[must_use]
    pub fn missing_shards(&mut self, shards: &[Shard]) -> MissingShards {
        self.header.shard = Shard::default();
        let of = shards.first().map_or(1, |shard| shard.of);
        if shards.iter().any(|shard| shard.of != of) {
            return MissingShards::default();
        }
        // Shards take the seeds in turn, so the offset of a seed gives its shard.
        let mut present: BTreeMap<u64, u64> = BTreeMap::new();
        for seed in self.results.keys() {
            *present.entry((seed - self.header.seed) % of + 1).or_default() += 1;
        }
        // The last shards of a small campaign have no runs.
        let asked_of =
            |number| Header { shard: Shard { number, of }, ..self.header.clone() }.asked();
        let some = present.iter().filter(|(number, some)| **some < asked_of(**number)).count();
        let all = of.min(self.header.runs);
        let lacks = |number: u64| {
            let asked = asked_of(number);
            match present.get(&number) {
                None => Some(format!("{number}/{of}")),
                Some(some) if *some < asked => {
                    Some(format!("{number}/{of} ({some} of {asked} runs)"))
                }
                Some(_) => None,
            }
        };
        // A header may claim ten million shards: the first are named, the others only counted.
        MissingShards {
            named: (1..=all).filter_map(lacks).take(NAMED).collect(),
            count: all - present.len() as u64 + some as u64,
        }
    }

    /// Adds a result. A seed that is already known counts once. The error is a seed of another
    /// campaign, or a known seed with a different result: a run repeats to the bit.
    fn take(&mut self, result: RunResult) -> Result<(), String> {
        let seed = result.seed;
        if !self.header.holds(seed) {
            return Err(format!("seed {seed} does not belong to this campaign"));
        }
        match self.results.get(&seed) {
            Some(before) if !before.agrees(&result) => Err(contradiction(seed)),
            _ => {
                self.results.entry(seed).or_insert(result);
                Ok(())
            }
        }
    }

    /// Adds the results of another file, of the same shard or of another shard of the campaign.
    ///
    /// # Errors
    /// The difference, if the files are not of one campaign or disagree about a run.
    pub fn merge(&mut self, other: Self) -> Result<(), String> {
        if let Some(difference) = self.header.differs(&other.header) {
            return Err(format!("not of the same campaign: they differ in {difference}"));
        }
        self.header.shard = Shard::default();
        // Different builds are no error here, but `--at-least` does not count them as a success.
        if self.header.build != other.header.build {
            SEVERAL.clone_into(&mut self.header.build);
        }
        self.damaged += other.damaged;
        other.results.into_values().try_for_each(|result| self.take(result))
    }
}

/// Missing and incomplete shards of a campaign.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MissingShards {
    /// Names of the first of them: "2/3", "1/3 (2 of 4 runs)".
    pub named: Vec<String>,
    /// Number of all of them.
    pub count: u64,
}

impl std::fmt::Display for MissingShards {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.named.join(", "))?;
        match self.count - self.named.len() as u64 {
            0 => Ok(()),
            more => write!(f, " and {more} more"),
        }
    }
}

/// Returns the error of a seed with two different results.
fn contradiction(seed: u64) -> String {
    format!("seed {seed} has two different results: were the programs different?")
}

/// Reads the next line of a state file into `into`. Returns whether the line ends with a line
/// break, or `None` at the end of the file. `line` is the number of the line, for the error.
fn next(from: &mut impl BufRead, into: &mut Vec<u8>, line: u64) -> Result<Option<bool>, Unusable> {
    // A file without line breaks must not fill the memory.
    into.clear();
    let read = from.by_ref().take(LONGEST).read_until(b'\n', into)?;
    if read as u64 == LONGEST && into.last() != Some(&b'\n') {
        let why = format!("longer than {LONGEST} bytes");
        return Err(Unusable::Line { line, why });
    }
    Ok((read > 0).then(|| into.last() == Some(&b'\n')))
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::result::Verdict;
    use super::super::result::tests::result;
    use super::*;

    /// Returns a header for the tests of this folder.
    pub(in crate::campaign) fn header(runs: u64, shard: &str) -> Header {
        Header {
            version: "1".into(),
            program: None,
            task: String::new(),
            build: "b".into(),
            scenario: "s.toml".into(),
            scenario_sum: "c".into(),
            set: vec![],
            vary: String::new(),
            seed: 5,
            runs,
            shard: shard.parse().unwrap(),
            limit_s: 600,
        }
    }

    /// Returns the state file of a campaign of ten runs, with results of these seeds.
    fn file(seeds: &[u64]) -> String {
        let lines: String =
            seeds.iter().map(|s| line(&result(*s, Verdict::Solved, *s as f64))).collect();
        first_line(&header(10, "1/1")) + &lines
    }

    #[test]
    fn shards_partition_the_campaign_seeds() {
        let mut all: Vec<u64> =
            (1..=3).flat_map(|k| header(10, &format!("{k}/3")).seeds()).collect();
        all.sort_unstable();
        assert_eq!(all, (5..15).collect::<Vec<_>>());
        for seed in 0..20 {
            let own = header(10, "2/3");
            assert_eq!(own.holds(seed), own.seeds().any(|s| s == seed));
        }
        for (runs, shard, seed) in [
            (10, "1/3", 5),
            (10, "2/3", 5),
            (2, "3/3", 5),
            (9, "2/4", u64::MAX - 5),
            (1, "1/1", u64::MAX),
        ] {
            let own = Header { seed, ..header(runs, shard) };
            assert_eq!(own.asked(), own.seeds().count() as u64, "{own:?}");
        }
        for wrong in ["0/3", "4/3", "3", "a/b", "1/0", ""] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn read_ignores_a_line_that_is_cut_off() {
        let text = file(&[5, 6, 7]);
        let ends: Vec<usize> = text.match_indices('\n').map(|(i, _)| i + 1).collect();
        for cut in 0..=text.len() {
            let read = State::read(&text.as_bytes()[..cut]);
            let lines = ends.iter().filter(|end| **end <= cut).count();
            if lines == 0 {
                assert!(matches!(read, Err(Unusable::Empty)), "cut at {cut}: {read:?}");
                continue;
            }
            let state = read.unwrap();
            assert_eq!(state.results.len(), lines - 1, "cut at {cut}");
            assert_eq!(state.whole as usize, ends[lines - 1]);
            assert_eq!(state.torn, cut > ends[lines - 1]);
        }
    }

    #[test]
    fn second_header_extends_only_the_same_campaign() {
        let longer = first_line(&header(12, "1/1"));
        let text = file(&[5, 6]) + &longer + &line(&result(16, Verdict::Solved, 1.0));
        let state = State::read(text.as_bytes()).unwrap();
        assert_eq!((state.header.runs, state.results.len(), state.torn), (12, 3, false));
        // A second header that is cut off changes nothing.
        let cut = &text[..text.find(&longer).unwrap() + 30];
        let state = State::read(cut.as_bytes()).unwrap();
        assert_eq!((state.header.runs, state.results.len(), state.torn), (10, 2, true));
        for other in [header(9, "1/1"), header(12, "1/2"), Header { seed: 6, ..header(12, "1/1") }]
        {
            let text = file(&[5]) + &first_line(&other) + &line(&result(6, Verdict::Solved, 1.0));
            assert!(State::read(text.as_bytes()).is_err());
        }
    }

    #[test]
    fn missing_shards_are_named() {
        let shard = |k: &str, seeds: &[u64]| State {
            header: header(10, k),
            results: seeds.iter().map(|s| (*s, result(*s, Verdict::Solved, 1.0))).collect(),
            whole: 0,
            damaged: 0,
            torn: false,
        };
        let missing = |mut state: State| {
            let shards = [state.header.shard];
            let missing = state.missing_shards(&shards);
            assert_eq!(missing.count, missing.named.len() as u64);
            missing.named
        };
        // Seeds are 5 to 14; the first of three shards has four of them.
        assert_eq!(missing(shard("1/3", &[5, 8, 11, 14])), ["2/3", "3/3"]);
        assert_eq!(missing(shard("1/3", &[5, 8, 6, 9, 12])), ["1/3 (2 of 4 runs)", "3/3"]);
        assert_eq!(missing(shard("1/1", &(5..15).collect::<Vec<_>>())), [""; 0]);
        // Shards 11 to 20 of ten runs have no runs, so they are not missing.
        assert_eq!(missing(shard("1/20", &(5..14).collect::<Vec<_>>())), ["10/20"]);
        let several = ["1/2".parse().unwrap(), "1/3".parse().unwrap()];
        assert_eq!(shard("1/2", &[5]).missing_shards(&several), MissingShards::default());
    }

    /// A header beyond a limit is refused, or ignored if it is a later one. At the limit the
    /// missing shards are counted without a list of ten million.
    #[test]
    fn read_refuses_too_many_runs_or_shards() {
        for (runs, shard, reason) in [
            (MOST_RUNS + 1, "1/1", "runs exceed the limit"),
            (3, "1/10000001", "shards exceed the limit"),
        ] {
            let why = State::read(first_line(&header(runs, shard)).as_bytes()).unwrap_err();
            assert!(why.to_string().contains(reason), "{why}");
        }
        let text = file(&[5]) + &first_line(&header(MOST_RUNS + 1, "1/1"));
        let kept = State::read(text.as_bytes()).unwrap();
        assert_eq!((kept.header.runs, kept.torn), (10, true));

        let text = first_line(&header(MOST_RUNS, "1/10000000"));
        let mut state = State::read(text.as_bytes()).unwrap();
        let shards = [state.header.shard];
        assert_eq!(state.header.asked(), 1);
        let missing = state.missing_shards(&shards);
        assert_eq!((missing.count, missing.named.len()), (MOST_RUNS, NAMED));
        assert!(missing.to_string().ends_with("20/10000000 and 9999980 more"), "{missing}");
    }

    /// A line that is no JSON is left out anywhere: its run is repeated. A line of JSON with
    /// another content is left out only at the end.
    #[test]
    fn damaged_line_is_left_out_and_counted() {
        let six = line(&result(6, Verdict::Solved, 1.0));
        // Zeros of a hole, the begin and the end of a line, a line within another one.
        let cut = format!("{}\n", &six[..80]);
        for damage in ["\0\0\0\0\n", cut.as_str(), &six[80..], "{\"seed\":{\"seed\":6\n"] {
            let at_end = file(&[5]) + damage;
            let state = State::read(at_end.as_bytes()).unwrap();
            assert!(state.torn && state.damaged == 0 && state.results.len() == 1, "{damage}");
            assert_eq!(state.whole as usize, at_end.len() - damage.len());

            let middle = format!("{at_end}{damage}{six}");
            let state = State::read(middle.as_bytes()).unwrap();
            assert!(!state.torn && state.damaged == 2, "{damage}");
            assert!(state.results.keys().eq(&[5, 6]) && state.whole as usize == middle.len());
        }
        let foreign = file(&[5]) + "{\"later\":1}\n";
        assert!(State::read(foreign.as_bytes()).unwrap().torn);
        let error = State::read((foreign + &six).as_bytes()).unwrap_err().to_string();
        assert!(error.starts_with("line 3:"), "{error}");
    }

    #[test]
    fn repeated_seed_counts_once_and_foreign_is_refused() {
        assert_eq!(State::read(file(&[5, 5, 6]).as_bytes()).unwrap().results.len(), 2);
        let error = State::read(file(&[5, 99]).as_bytes()).unwrap_err().to_string();
        assert!(error.contains("seed 99 does not belong"), "{error}");
        let twice = file(&[5]) + &line(&result(5, Verdict::Failed, 5.0));
        assert!(
            State::read(twice.as_bytes())
                .unwrap_err()
                .to_string()
                .contains("two different results")
        );
    }

    #[test]
    fn read_refuses_files_without_campaign_header() {
        for text in ["hello\n", "{\"campaign\":3}\n", "[]", "\u{1}\n"] {
            assert!(matches!(State::read(text.as_bytes()), Err(Unusable::Line { line: 1, .. })));
        }
    }

    #[test]
    fn endless_line_is_refused_before_filling_memory() {
        let endless = std::io::BufReader::new(std::io::repeat(b'x'));
        assert!(State::read(endless).unwrap_err().to_string().contains("longer than"));
    }

    /// A file of an older version names no program, and belongs to any.
    #[test]
    fn campaigns_of_two_programs_differ() {
        let maker = |program: &str| Maker { program: program.to_owned(), ..Maker::default() };
        let of = |program| Header {
            program: Some(maker(program)),
            task: "solve".to_owned(),
            ..header(9, "1/1")
        };
        let (own, other, old) = (of("rubik-robot"), of("own_cell"), header(9, "1/1"));

        let why = own.differs(&other).unwrap_or_default();
        assert!(why.starts_with("programs: rubik-robot") && why.contains("own_cell"), "{why}");
        assert_eq!((own.differs(&own), own.differs(&old)), (None, None));
        for kept in [own, old] {
            assert_eq!(State::read(first_line(&kept).as_bytes()).unwrap().header, kept);
        }
    }
}
