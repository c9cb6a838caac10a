//! A campaign's state file: what it is, then one line of JSON for each run that has ended.
//!
//! - in: a file as an earlier campaign left it, perhaps cut off in its last line
//! - out: the [`Header`], the results by seed, and how much of the file is whole
//!
//! A line is appended when its run has ended, so that a campaign that was killed goes on where it
//! was. One that is to have more runs than before says what it is once more.

use super::result::RunResult;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{BufRead, Read};

/// The longest line (bytes): a header with a large scenario, a result with a thousand drawn keys.
const LONGEST: u64 = 1 << 20;
/// The most runs of a campaign, and the most shards: seeds are numbers, and a list of them is kept.
pub(crate) const MOST_RUNS: u64 = 10_000_000;
/// The build of a campaign whose shards were performed by different builds of one version.
pub(crate) const SEVERAL: &str = "several";
/// Missing shards that are named.
const NAMED: usize = 20;

/// What a campaign is; two files belong together when theirs agree but for the shard and the build.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// Version of the program.
    pub version: String,
    /// Sum over the program: two builds of one version may differ. `SEVERAL` of shards that had
    /// not the same.
    pub build: String,
    /// Path of the scenario, as given.
    pub scenario: String,
    /// Sum over its text, and over what came of it with the files that it names.
    pub scenario_sum: String,
    /// What overrules it in all runs, as behind `--set`.
    pub set: Vec<String>,
    /// Text of the file that says what is drawn; empty without one.
    pub vary: String,
    /// Seed of the first run; the others have those that follow.
    pub seed: u64,
    /// Number of runs of the whole campaign.
    pub runs: u64,
    /// Which part of it: number, from 1, and of how many.
    pub shard: Shard,
    /// Time that a run may take by the wall clock (s).
    pub limit_s: u64,
}

/// A part of a campaign.
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
        Err(format!("{number}/{of} is no shard: wanted K/N with K from 1 to N"))
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
        parts.ok_or_else(|| format!("`{text}` is no shard: write K/N, as in 2/4"))?.try_into()
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl Header {
    /// The seeds of this shard.
    pub fn seeds(&self) -> impl Iterator<Item = u64> + use<> {
        let (first, step) = (self.shard.number - 1, self.shard.of);
        let (seed, runs) = (self.seed, self.runs);
        let index = move |k: u64| first.checked_add(k.checked_mul(step)?).filter(|i| *i < runs);
        (0..).map_while(index).map_while(move |i| seed.checked_add(i))
    }

    /// How many seeds this shard has.
    #[must_use]
    pub fn asked(&self) -> u64 {
        let (first, step) = (self.shard.number - 1, self.shard.of);
        // Behind the last number there are no seeds.
        let runs = self.runs.min((u64::MAX - self.seed).saturating_add(1));
        runs.checked_sub(first + 1).map_or(0, |others| others / step + 1)
    }

    /// Whether it is beyond what any campaign can be, and how.
    fn excess(&self) -> Option<String> {
        let most = |what: &str, count| {
            (count > MOST_RUNS).then(|| format!("{count} {what} are more than {MOST_RUNS}"))
        };
        most("runs", self.runs).or_else(|| most("shards", self.shard.of))
    }

    /// Whether a seed is one of this shard's.
    #[must_use]
    pub fn holds(&self, seed: u64) -> bool {
        seed.checked_sub(self.seed)
            .is_some_and(|i| i < self.runs && i % self.shard.of == self.shard.number - 1)
    }

    /// Whether the other is the same campaign, or shard of it, with as many runs or more.
    #[must_use]
    pub fn begins(&self, other: &Self) -> bool {
        let same = Self { runs: other.runs, ..self.clone() };
        same.differs(other).is_none() && self.shard == other.shard && self.runs <= other.runs
    }

    /// What hinders both from being parts of one campaign.
    #[must_use]
    pub fn differs(&self, other: &Self) -> Option<String> {
        let told = |what: &str, a: &dyn std::fmt::Display, b: &dyn std::fmt::Display| {
            Some(format!("{what}: {a} and {b}"))
        };
        if self.version != other.version {
            return told("versions of the program", &self.version, &other.version);
        }
        // First, since it is part of what the scenario's sum is over.
        if self.set != other.set {
            return told("--set", &self.set.join(" "), &other.set.join(" "));
        }
        if self.scenario_sum != other.scenario_sum {
            return told("scenarios", &self.scenario, &other.scenario)
                .map(|t| format!("{t}, whose contents differ"));
        }
        if self.vary != other.vary {
            return Some("what is drawn (--vary)".to_owned());
        }
        if self.seed != other.seed {
            return told("first seeds", &self.seed, &other.seed);
        }
        if self.runs != other.runs {
            return told("numbers of runs", &self.runs, &other.runs);
        }
        if self.limit_s != other.limit_s {
            return told("time limits", &self.limit_s, &other.limit_s);
        }
        None
    }
}

/// The first line of a file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct First {
    campaign: Header,
}

/// What a file holds.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// What the campaign is.
    pub header: Header,
    /// Results by seed.
    pub results: BTreeMap<u64, RunResult>,
    /// Bytes up to the end of the last whole line.
    pub whole: u64,
    /// Whether something follows them, which is not used.
    pub torn: bool,
}

/// Why a file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Unusable {
    /// The file.
    #[error("{0}")]
    File(#[from] std::io::Error),
    /// It is empty, or its first line is cut off: nothing is lost by beginning anew.
    #[error("empty")]
    Empty,
    /// A line is none of a campaign.
    #[error("line {line}: {why}")]
    Line {
        /// Which, from 1.
        line: u64,
        /// Why not.
        why: String,
    },
}

/// The first line of a new file, with its end.
#[must_use]
pub(crate) fn first_line(header: &Header) -> String {
    let first = First { campaign: header.clone() };
    serde_json::to_string(&first).map_or_else(|_| String::new(), |line| line + "\n")
}

/// The line of a result, with its end.
#[must_use]
pub fn line(result: &RunResult) -> String {
    serde_json::to_string(result).map_or_else(|_| String::new(), |line| line + "\n")
}

impl State {
    /// Reads a file. What stands in a last line that is cut off, or is no result, is left out.
    ///
    /// # Errors
    /// [`Unusable`].
    pub fn read(mut from: impl BufRead) -> Result<Self, Unusable> {
        let mut bytes = Vec::new();
        let Some(first) = next(&mut from, &mut bytes, 1)? else { return Err(Unusable::Empty) };
        let wrong = |line, why: String| Unusable::Line { line, why };
        let header = match serde_json::from_slice::<First>(&bytes) {
            Ok(first) => first.campaign,
            // A line without an end that begins as ours was cut off in its first moment.
            Err(_) if !first && b"{\"campaign\":".starts_with(&bytes[..bytes.len().min(12)]) => {
                return Err(Unusable::Empty);
            }
            Err(why) => return Err(wrong(1, format!("no campaign's state: {why}"))),
        };
        if !first {
            return Err(Unusable::Empty);
        }
        if let Some(why) = header.excess() {
            return Err(wrong(1, why));
        }
        let mut whole = bytes.len() as u64;
        let mut state = Self { header, results: BTreeMap::new(), whole, torn: false };
        let mut number = 1;
        while let Some(ended) = next(&mut from, &mut bytes, number + 1)? {
            number += 1;
            let read = serde_json::from_slice::<RunResult>(&bytes);
            if !ended {
                state.torn = true;
                break;
            }
            match read {
                Ok(result) => state.take(result).map_err(|why| wrong(number, why))?,
                Err(_) if state.is_extended(&bytes) => {}
                // A power cut may leave a last line of anything.
                Err(_) if from.fill_buf()?.is_empty() => {
                    state.torn = true;
                    break;
                }
                Err(why) => return Err(wrong(number, why.to_string())),
            }
            whole += bytes.len() as u64;
            state.whole = whole;
        }
        Ok(state)
    }

    /// Takes up a line that says that the same campaign has more runs; whether it was one.
    fn is_extended(&mut self, line: &[u8]) -> bool {
        let Ok(First { campaign: later }) = serde_json::from_slice(line) else { return false };
        let is = self.header.begins(&later) && later.excess().is_none();
        if is {
            self.header.runs = later.runs;
        }
        is
    }

    /// Looks at the results as at those of the whole campaign. Returns what it lacks of these
    /// shards' fellows: those that no result is of, and those that miss some; nothing where the
    /// campaign was shared out in several ways.
    #[must_use]
    pub fn whole_of(&mut self, shards: &[Shard]) -> Lacking {
        self.header.shard = Shard::default();
        let of = shards.first().map_or(1, |shard| shard.of);
        if shards.iter().any(|shard| shard.of != of) {
            return Lacking::default();
        }
        let mut there: BTreeMap<u64, u64> = BTreeMap::new();
        for seed in self.results.keys() {
            *there.entry((seed - self.header.seed) % of + 1).or_default() += 1;
        }
        // The last shards of a small campaign have no runs.
        let of_each =
            |number| Header { shard: Shard { number, of }, ..self.header.clone() }.asked();
        let some = there.iter().filter(|(number, some)| **some < of_each(**number)).count();
        let all = of.min(self.header.runs);
        let lacks = |number: u64| {
            let asked = of_each(number);
            match there.get(&number) {
                None => Some(format!("{number}/{of}")),
                Some(some) if *some < asked => {
                    Some(format!("{number}/{of} ({some} of {asked} runs)"))
                }
                Some(_) => None,
            }
        };
        Lacking {
            named: (1..=all).filter_map(lacks).take(NAMED).collect(),
            count: all - there.len() as u64 + some as u64,
        }
    }

    fn take(&mut self, result: RunResult) -> Result<(), String> {
        let seed = result.seed;
        if !self.header.holds(seed) {
            return Err(format!("seed {seed} is none of this campaign's"));
        }
        match self.results.get(&seed) {
            Some(before) if !before.agrees(&result) => Err(told_twice(seed)),
            _ => {
                self.results.entry(seed).or_insert(result);
                Ok(())
            }
        }
    }

    /// Takes another file's results in: of another shard of the same campaign, or of the same.
    ///
    /// # Errors
    /// What hinders both from being one.
    pub fn merge(&mut self, other: Self) -> Result<(), String> {
        if let Some(difference) = self.header.differs(&other.header) {
            return Err(format!("not of one campaign: they differ in {difference}"));
        }
        self.header.shard = Shard::default();
        if self.header.build != other.header.build {
            SEVERAL.clone_into(&mut self.header.build);
        }
        other.results.into_values().try_for_each(|result| self.take(result))
    }
}

/// The shards that a campaign lacks.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Lacking {
    /// The first of them, in words.
    pub named: Vec<String>,
    /// How many there are.
    pub count: u64,
}

impl std::fmt::Display for Lacking {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.named.join(", "))?;
        match self.count - self.named.len() as u64 {
            0 => Ok(()),
            more => write!(f, " and {more} more"),
        }
    }
}

fn told_twice(seed: u64) -> String {
    format!("seed {seed} has come out in two ways; were the programs different?")
}

/// The next line, and whether it has an end; `None` at the file's end.
fn next(from: &mut impl BufRead, into: &mut Vec<u8>, line: u64) -> Result<Option<bool>, Unusable> {
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

    /// A header for tests of what is above.
    pub(in crate::campaign) fn header(runs: u64, shard: &str) -> Header {
        Header {
            version: "1".into(),
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

    fn file(seeds: &[u64]) -> String {
        let lines: String =
            seeds.iter().map(|s| line(&result(*s, Verdict::Solved, *s as f64))).collect();
        first_line(&header(10, "1/1")) + &lines
    }

    #[test]
    fn shards_share_the_seeds_out() {
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
    fn a_file_cut_anywhere_is_read_up_to_its_last_whole_line() {
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
    fn a_campaign_may_get_more_runs_but_not_become_another_one() {
        let longer = first_line(&header(12, "1/1"));
        let text = file(&[5, 6]) + &longer + &line(&result(16, Verdict::Solved, 1.0));
        let state = State::read(text.as_bytes()).unwrap();
        assert_eq!((state.header.runs, state.results.len(), state.torn), (12, 3, false));
        // Cut off in the middle of what says so, it has what it had.
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
    fn the_shards_that_lack_are_named() {
        let shard = |k: &str, seeds: &[u64]| State {
            header: header(10, k),
            results: seeds.iter().map(|s| (*s, result(*s, Verdict::Solved, 1.0))).collect(),
            whole: 0,
            torn: false,
        };
        let lacking = |mut state: State| {
            let shards = [state.header.shard];
            let lacking = state.whole_of(&shards);
            assert_eq!(lacking.count, lacking.named.len() as u64);
            lacking.named
        };
        // Seeds are 5 to 14; the first of three shards has four of them.
        assert_eq!(lacking(shard("1/3", &[5, 8, 11, 14])), ["2/3", "3/3"]);
        assert_eq!(lacking(shard("1/3", &[5, 8, 6, 9, 12])), ["1/3 (2 of 4 runs)", "3/3"]);
        assert_eq!(lacking(shard("1/1", &(5..15).collect::<Vec<_>>())), [""; 0]);
        // The shards behind the tenth of twenty have none.
        assert_eq!(lacking(shard("1/20", &(5..14).collect::<Vec<_>>())), ["10/20"]);
        let several = ["1/2".parse().unwrap(), "1/3".parse().unwrap()];
        assert_eq!(shard("1/2", &[5]).whole_of(&several), Lacking::default());
    }

    #[test]
    fn a_campaign_of_more_runs_or_shards_than_there_can_be_is_refused_and_the_largest_is_looked_at_at_once()
     {
        for (runs, shard, told) in
            [(MOST_RUNS + 1, "1/1", "runs are more"), (3, "1/10000001", "shards are more")]
        {
            let why = State::read(first_line(&header(runs, shard)).as_bytes()).unwrap_err();
            assert!(why.to_string().contains(told), "{why}");
        }
        let text = file(&[5]) + &first_line(&header(MOST_RUNS + 1, "1/1"));
        let kept = State::read(text.as_bytes()).unwrap();
        assert_eq!((kept.header.runs, kept.torn), (10, true));

        let text = first_line(&header(MOST_RUNS, "1/10000000"));
        let mut state = State::read(text.as_bytes()).unwrap();
        let shards = [state.header.shard];
        assert_eq!(state.header.asked(), 1);
        let lacking = state.whole_of(&shards);
        assert_eq!((lacking.count, lacking.named.len()), (MOST_RUNS, NAMED));
        assert!(lacking.to_string().ends_with("20/10000000 and 9999980 more"), "{lacking}");
    }

    #[test]
    fn rubbish_is_dropped_at_the_end_and_told_in_the_middle() {
        let at_end = file(&[5]) + "\0\0\0\0\n";
        let state = State::read(at_end.as_bytes()).unwrap();
        assert!(state.torn && state.results.len() == 1);

        let middle = at_end + &line(&result(6, Verdict::Solved, 1.0));
        let told = State::read(middle.as_bytes()).unwrap_err().to_string();
        assert!(told.starts_with("line 3:"), "{told}");
    }

    #[test]
    fn a_seed_counts_once_and_must_be_the_campaigns() {
        assert_eq!(State::read(file(&[5, 5, 6]).as_bytes()).unwrap().results.len(), 2);
        let told = State::read(file(&[5, 99]).as_bytes()).unwrap_err().to_string();
        assert!(told.contains("seed 99 is none"), "{told}");
        let twice = file(&[5]) + &line(&result(5, Verdict::Failed, 5.0));
        assert!(State::read(twice.as_bytes()).unwrap_err().to_string().contains("two ways"));
    }

    #[test]
    fn what_is_no_state_file_is_told() {
        for text in ["hello\n", "{\"campaign\":3}\n", "[]", "\u{1}\n"] {
            assert!(matches!(State::read(text.as_bytes()), Err(Unusable::Line { line: 1, .. })));
        }
    }

    #[test]
    fn a_line_without_end_is_refused_before_it_fills_the_memory() {
        let endless = std::io::BufReader::new(std::io::repeat(b'x'));
        assert!(State::read(endless).unwrap_err().to_string().contains("longer than"));
    }
}
