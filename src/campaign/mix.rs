//! Mixes of faults: random combinations for missions, the rules that no run may break, and the
//! smallest mix that still breaks one.
//!
//! - in: a seed, the names of arms and cameras; the result of a run
//! - out: a mix, which depends on nothing but the seed and the names; a broken rule; a smaller mix
//!
//! | rule | limit | reason |
//! |---|---|---|
//! | the process ends by itself, with a summary | | a panic leaves the arms without control |
//! | success is true | the plant's cube | the controller's belief may be wrong |
//! | no fallen cube is unnoticed | | a person or a later grasp could hit it |
//! | contacts stay below a force | [`MOST_FORCE`] | two thirds of what crushes the cube |
//! | the cube is neither crushed nor pulled apart | | |
//! | no hand opens on a cube that nothing else holds | | it would fall |
//! | after a stop no drive goes on, and no arm moves | 0.55 s | only a person may end a stop |
//! | the mission ends | [`LONGEST`] | the last fault ends long before |

use super::result::{RunResult, Verdict};
use crate::record::summary::Summary;
use crate::scenario::injected::FaultKind;
use rand::seq::IndexedRandom as _;
use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64;
use std::fmt;

/// Greatest contact force at a tool (N). A hand that is pushed by 24 N into the other one, which
/// passes it at full speed, takes a blow of 83 N.
pub const MOST_FORCE: f64 = 100.0;
/// Longest simulated time of a mission with faults (s).
pub const LONGEST: f64 = 1800.0;
/// Least and greatest number of faults in a mix.
const FAULTS: (usize, usize) = (2, 4);
/// Span of simulated time in which a fault begins that waits for no event (s). Missions take about
/// 210 s.
const BEGIN: (f64, f64) = (1.0, 230.0);

/// Kind of a fault in a mix, with the ranges from which its keys are drawn.
struct Sort {
    kind: FaultKind,
    /// Range of the magnitude, in the unit of the kind.
    magnitude: Option<(f64, f64)>,
    /// Range of the duration (s); `None` for faults that stay.
    duration: Option<(f64, f64)>,
    part: Part,
}

/// Part that fails.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Part {
    /// No single part.
    None,
    Arm,
    /// One axis of an arm, 1 to 6.
    Axis,
    /// One direction of an arm's force sensor.
    Direction,
    Camera,
    Sticker,
    /// An actor of an arm.
    Actor,
    /// A file that the run writes.
    File,
}

/// Kinds of faults that a mix may have. An actor that blocks all others is left out: it ends the
/// process at once, and would hide the other faults. After a power cut the run is resumed.
const SORTS: [Sort; 29] = {
    use FaultKind as K;
    /// Makes a kind with its ranges: a function, so that the list below has a line for each kind.
    const fn sort(
        kind: FaultKind,
        magnitude: Option<(f64, f64)>,
        duration: Option<(f64, f64)>,
        part: Part,
    ) -> Sort {
        Sort { kind, magnitude, duration, part }
    }
    [
        sort(K::EncoderFreeze, None, Some((0.01, 1.0)), Part::Axis),
        sort(K::EncoderJump, Some((-50.0, 50.0)), Some((0.01, 1.0)), Part::Axis),
        sort(K::OverCurrent, Some((1.0, 30.0)), Some((0.01, 0.5)), Part::Axis),
        sort(K::LimitSwitch, None, Some((0.01, 1.0)), Part::Axis),
        sort(K::ForceDropout, None, Some((0.01, 3.0)), Part::Arm),
        sort(K::ForceNan, None, Some((0.01, 3.0)), Part::Direction),
        sort(K::ForceSaturation, None, Some((0.01, 3.0)), Part::Direction),
        sort(K::ForceBias, Some((-40.0, 40.0)), Some((0.1, 60.0)), Part::Direction),
        sort(K::MissedPeriods, Some((1.0, 60.0)), None, Part::None),
        sort(K::CameraBlackout, None, Some((0.1, 30.0)), Part::Camera),
        sort(K::CameraSilent, None, Some((0.1, 30.0)), Part::Camera),
        sort(K::LateFrames, Some((10.0, 500.0)), Some((0.1, 30.0)), Part::Camera),
        // Some friction is left: without any, the quasi-static model has no place for the cube.
        sort(K::Slip, Some((0.05, 0.6)), Some((0.1, 3.0)), Part::Arm),
        sort(K::Drop, None, None, Part::Arm),
        sort(K::Jam, Some((0.5, 5.0)), Some((0.5, 8.0)), Part::None),
        sort(K::TurnUndone, Some((0.2, 2.0)), None, Part::None),
        sort(K::Push, Some((-25.0, 25.0)), Some((0.1, 2.0)), Part::Direction),
        sort(K::Withdraw, None, None, Part::None),
        sort(K::Misread, None, None, Part::Sticker),
        sort(K::LateMessage, Some((1.0, 60.0)), None, Part::Arm),
        sort(K::DuplicatedMessage, None, None, Part::Arm),
        sort(K::ActorHang, None, None, Part::Actor),
        sort(K::ClockJump, Some((10.0, 5000.0)), None, Part::None),
        sort(K::EmergencyStop, None, None, Part::None),
        sort(K::DiskFull, None, Some((0.1, 60.0)), Part::File),
        sort(K::DiskError, None, Some((0.1, 60.0)), Part::File),
        sort(K::TornWrite, None, Some((0.1, 60.0)), Part::File),
        sort(K::LostWrite, None, Some((0.1, 60.0)), Part::File),
        sort(K::PowerCut, None, None, Part::None),
    ]
};

/// Events that may begin a fault.
const EVENTS: [&str; 4] = ["grasped", "released", "turn_begins", "turned"];

/// Faults of one run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Mix {
    /// Each fault as the keys of a `[[fault]]`, in the form `key = value`.
    faults: Vec<Vec<String>>,
}

impl Mix {
    /// Draws the mix of a seed for a cell with these arms and cameras.
    pub(crate) fn draw(seed: u64, arms: &[&str], cameras: &[&str]) -> Self {
        // The constant separates this random stream from those of the run's cube and noise, which
        // have the same seed.
        let mut random = Pcg64::seed_from_u64(seed ^ 0x6d69_785f_6661_756c);
        let count = random.random_range(FAULTS.0..=FAULTS.1);
        let faults = (0..count).filter_map(|number| {
            let sort = SORTS.choose(&mut random)?;
            Some(keys(number, sort, arms, cameras, &mut random))
        });
        Self { faults: faults.collect() }
    }

    /// Returns the number of faults.
    pub(crate) fn len(&self) -> usize {
        self.faults.len()
    }

    /// Returns the mix without the fault with this number (from 0).
    pub(crate) fn without(&self, number: usize) -> Self {
        let mut faults = self.faults.clone();
        faults.remove(number);
        Self { faults }
    }

    /// Returns the mix for the run that resumes this one after a power cut: the same mix without
    /// power cuts.
    pub(crate) fn after_cut(&self) -> Self {
        let cut = format!("kind = \"{}\"", FaultKind::PowerCut.word());
        let faults = self.faults.iter().filter(|keys| !keys.contains(&cut)).cloned();
        Self { faults: faults.collect() }
    }

    /// Returns the override that injects the mix, in the form `KEY=VALUE` of `--set`.
    pub(crate) fn set(&self) -> String {
        let tables = self.faults.iter().map(|keys| format!("{{ {} }}", keys.join(", ")));
        format!("fault=[{}]", tables.collect::<Vec<_>>().join(", "))
    }
}

/// Text of the mix: lines that inject it if they are appended to a scenario.
impl fmt::Display for Mix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for keys in &self.faults {
            writeln!(f, "[[fault]]\n{}\n", keys.join("\n"))?;
        }
        Ok(())
    }
}

/// Draws the keys of one fault of the kind `sort`, in the form `key = value`. `number` is its place
/// in the mix (from 0).
fn keys(
    number: usize,
    sort: &Sort,
    arms: &[&str],
    cameras: &[&str],
    random: &mut Pcg64,
) -> Vec<String> {
    let mut keys =
        vec![format!("name = \"mix{}\"", number + 1), format!("kind = \"{}\"", sort.kind.word())];
    let arm = |random: &mut Pcg64| arms.choose(random).map(|arm| format!("arm = \"{arm}\""));
    match sort.part {
        Part::None => {}
        Part::Arm => keys.extend(arm(random)),
        Part::Axis => {
            keys.extend(arm(random));
            keys.push(format!("axis = {}", random.random_range(1..=6)));
        }
        Part::Direction => {
            keys.extend(arm(random));
            // A push is a force: directions 0 to 2. A sensor also has torques: 3 to 5.
            let most = if sort.kind == FaultKind::Push { 2 } else { 5 };
            keys.push(format!("direction = {}", random.random_range(0..=most)));
        }
        Part::Camera => {
            keys.extend(cameras.choose(random).map(|camera| format!("camera = \"{camera}\"")));
        }
        Part::File => {
            // The world's state stands for the real cell, which loses nothing.
            let all = ["recording", "journal", "world"];
            let files = if sort.kind == FaultKind::LostWrite { &all[..2] } else { &all[..] };
            keys.extend(files.choose(random).map(|file| format!("file = \"{file}\"")));
        }
        Part::Sticker => {
            let letters = ['U', 'R', 'F', 'D', 'L', 'B'];
            let letter = |random: &mut Pcg64| letters[random.random_range(0..6)];
            let (face, place) = (letter(random), random.random_range(1..=9));
            keys.push(format!("sticker = \"{face}{place}\""));
            keys.push(format!("colour = \"{}\"", letter(random)));
        }
        Part::Actor => {
            let actor = if random.random_bool(0.5) { "ecp" } else { "edp" };
            keys.push(format!("actor = \"{actor}\""));
            keys.extend(arm(random));
        }
    }
    // Half of the faults wait for an event, the others begin at a time.
    if random.random_bool(0.5) {
        let event = EVENTS.choose(random).copied().unwrap_or(EVENTS[0]);
        keys.push(format!("event = \"{event}\""));
        keys.push(format!("nth = {}", random.random_range(1..=12)));
        if event == "turned" {
            keys.push(format!("turned_deg = {:.1}", random.random_range(5.0..85.0)));
        }
        keys.push(format!("delay_s = {:.2}", random.random_range(0.0..2.0)));
    } else {
        keys.push(format!("at_s = {:.2}", random.random_range(BEGIN.0..BEGIN.1)));
    }
    let drawn = |(low, high): (f64, f64), random: &mut Pcg64| random.random_range(low..=high);
    if let Some(range) = sort.magnitude {
        let magnitude = drawn(range, random);
        let digits = if sort.kind == FaultKind::MissedPeriods { 0 } else { 2 };
        keys.push(format!("magnitude = {magnitude:.digits$}"));
    }
    if let Some(range) = sort.duration {
        keys.push(format!("duration_s = {:.2}", drawn(range, random)));
    }
    keys
}

/// Rule that a run has broken.
#[derive(Debug, Clone, PartialEq)]
pub enum Broken {
    /// The process ended without a valid summary, with the reason.
    Died(String),
    /// The run did not end within its time by the wall clock.
    Endless,
    /// The run reported a success, but the plant's cube is not solved; with the reason.
    Untrue(String),
    /// The cube fell more often than the controller noticed.
    UnnoticedDrop,
    /// Contact force at a tool (N).
    Force(f64),
    /// The cube was crushed or pulled apart.
    Damaged,
    /// The last hand that held the cube opened its jaws in the air.
    LetFall,
    /// An arm moved, or its drives went on, after a stop.
    MovedAfterStop,
    /// Simulated time of the mission (s).
    TooLong(f64),
}

impl Broken {
    /// Returns the first rule that a run with this summary has broken.
    #[must_use]
    pub fn of_summary(summary: &Summary) -> Option<Self> {
        Self::by(&RunResult::of_summary(summary, Vec::new()))
    }

    /// Returns the first rule that a run has broken.
    pub(crate) fn by(result: &RunResult) -> Option<Self> {
        match result.verdict {
            Verdict::Died => return Some(Self::Died(result.reason.clone())),
            Verdict::TimedOut => return Some(Self::Endless),
            Verdict::Untrue => return Some(Self::Untrue(result.reason.clone())),
            Verdict::Solved | Verdict::Failed | Verdict::Aborted => {}
        }
        let figures = result.figures.as_ref()?;
        let force = figures.peak_contact_n.unwrap_or(0.0);
        let mishaps = &figures.mishaps;
        let acts = figures.violations.unwrap_or_default();
        let rules = [
            (figures.has_unnoticed_drop() == Some(true), Self::UnnoticedDrop),
            (force > MOST_FORCE, Self::Force(force)),
            (mishaps.crushed + mishaps.pops > 0, Self::Damaged),
            (acts.let_fall > 0, Self::LetFall),
            (acts.restarts + acts.moved_after_stop > 0, Self::MovedAfterStop),
            (figures.sim_time_s > LONGEST, Self::TooLong(figures.sim_time_s)),
        ];
        rules.into_iter().find_map(|(broken, rule)| broken.then_some(rule))
    }

    /// Returns whether two runs break the same rule.
    pub(crate) fn is_like(&self, other: &Self) -> bool {
        std::mem::discriminant(self) == std::mem::discriminant(other)
    }
}

impl fmt::Display for Broken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Died(why) => write!(f, "the process ended without a summary: {why}"),
            Self::Endless => write!(f, "the run did not end"),
            Self::Untrue(why) => write!(f, "the run reported an untrue success: {why}"),
            Self::UnnoticedDrop => write!(f, "the cube fell, and the controller did not notice"),
            Self::Force(n) => write!(f, "a contact of {n:.0} N, more than {MOST_FORCE:.0} N"),
            Self::Damaged => write!(f, "the cube was crushed or pulled apart"),
            Self::LetFall => write!(f, "the last hand that held the cube opened in the air"),
            Self::MovedAfterStop => write!(f, "an arm moved, or its drives went on, after a stop"),
            Self::TooLong(s) => write!(f, "the mission took {s:.0} s, more than {LONGEST:.0} s"),
        }
    }
}

/// Returns a smallest part of `mix` that still breaks a rule: leaves out faults one by one as long
/// as the others still break it. `breaks` runs a mix and says whether it breaks the rule.
///
/// # Errors
/// The first error of `breaks`.
pub(crate) fn shrunk<E>(
    mut mix: Mix,
    mut breaks: impl FnMut(&Mix) -> Result<bool, E>,
) -> Result<Mix, E> {
    let mut number = 0;
    while mix.len() > 1 && number < mix.len() {
        let fewer = mix.without(number);
        if breaks(&fewer)? {
            mix = fewer;
        } else {
            number += 1;
        }
    }
    Ok(mix)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::summary::{EndedBy, Outcome, SensorPeak, Violations};
    use crate::scenario::Override;
    use crate::tasks::read;
    use std::collections::BTreeSet;
    use std::path::Path;

    const ARMS: [&str; 2] = ["track", "postument"];
    const CAMERAS: [&str; 3] = ["standalone", "track_hand", "postument_hand"];

    #[test]
    fn every_drawn_mix_is_a_valid_scenario() {
        let mut kinds = BTreeSet::new();
        for seed in 0..400 {
            let mix = Mix::draw(seed, &ARMS, &CAMERAS);
            assert!((FAULTS.0..=FAULTS.1).contains(&mix.len()));
            assert_eq!(mix, Mix::draw(seed, &ARMS, &CAMERAS));

            let by_option = read(Path::new("t.toml"), "", &[Override::parse(&mix.set()).unwrap()]);
            let by_file = read(Path::new("t.toml"), &mix.to_string(), &[]);

            let faults = by_option.map_err(|e| format!("{mix}: {e}")).unwrap().plant.faults;
            assert_eq!(faults.len(), mix.len());
            assert_eq!(by_file.unwrap().plant.faults, faults);
            kinds.extend(faults.iter().filter_map(|fault| fault.kind.map(FaultKind::word)));
        }
        assert_eq!(kinds.len(), SORTS.len(), "every kind is drawn");
    }

    #[test]
    fn each_rule_is_broken_by_its_figure_alone() {
        let summary = || Summary {
            // A run that has begun, so that its figures count.
            hash: "1".to_owned(),
            sim_time_s: 200.0,
            drops: Some(1),
            drops_noticed: Some(1),
            violations: Some(Violations::default()),
            ..Summary::not_started("solve", 1, Some("U"), "a fault", EndedBy::Task)
        };
        let broken = |changed: fn(&mut Summary)| {
            let mut summary = summary();
            changed(&mut summary);
            Broken::of_summary(&summary)
        };
        let acts = |summary: &mut Summary, violations| summary.violations = Some(violations);
        let none = Violations::default();
        let [mut falls, mut restarts, mut moves] = [summary(), summary(), summary()];
        acts(&mut falls, Violations { let_fall: 1, ..none });
        acts(&mut restarts, Violations { restarts: 1, ..none });
        acts(&mut moves, Violations { moved_after_stop: 1, ..none });

        assert_eq!(broken(|_| {}), None);
        assert_eq!(broken(|s| s.drops = Some(2)), Some(Broken::UnnoticedDrop));
        assert_eq!(broken(|s| s.crushed = Some(1)), Some(Broken::Damaged));
        assert_eq!(broken(|s| s.pops = Some(1)), Some(Broken::Damaged));
        assert_eq!(broken(|s| s.sim_time_s = 1801.0), Some(Broken::TooLong(1801.0)));
        assert_eq!(broken(|s| s.sim_time_s = 1799.0), None);
        let touched = |force| {
            let (name, felt) = ("track".to_owned(), 0.0);
            let sensors = vec![SensorPeak {
                effector: name,
                force_n: Some(force),
                torque_nm: None,
                felt_force_n: felt,
                felt_torque_nm: felt,
            }];
            Broken::of_summary(&Summary { sensors, ..summary() })
        };
        assert_eq!([touched(99.0), touched(101.0)], [None, Some(Broken::Force(101.0))]);
        let untrue = |s: &mut Summary| (s.outcome, s.untrue) = (Outcome::Failed, true);
        assert_eq!(broken(untrue), Some(Broken::Untrue("a fault".to_owned())));
        assert_eq!(Broken::of_summary(&falls), Some(Broken::LetFall));
        for moved in [restarts, moves] {
            assert_eq!(Broken::of_summary(&moved), Some(Broken::MovedAfterStop));
        }
    }

    #[test]
    fn shrinking_keeps_only_faults_that_break_rule() {
        let mix = (0..100).map(|seed| Mix::draw(seed, &ARMS, &CAMERAS)).find(|m| m.len() == 4);
        let mix = mix.unwrap();
        let needed = [mix.faults[1].clone(), mix.faults[3].clone()];

        let small = shrunk(mix, |fewer| {
            Ok::<_, ()>(needed.iter().all(|fault| fewer.faults.contains(fault)))
        });

        assert_eq!(small.unwrap().faults, needed);
    }

    #[test]
    fn resumed_run_has_no_power_cut() {
        let mixes = (0..400).map(|seed| Mix::draw(seed, &ARMS, &CAMERAS));
        let cut = mixes.filter(|mix| mix.set().contains("power_cut")).collect::<Vec<_>>();

        assert!(!cut.is_empty());
        for mix in cut {
            let after = mix.after_cut();
            let read = read(Path::new("t.toml"), "", &[Override::parse(&after.set()).unwrap()]);
            let faults = read.unwrap().plant.faults;
            assert_eq!(faults.len(), after.len());
            let cuts = mix.set().matches("\"power_cut\"").count();
            assert_eq!(after.len() + cuts, mix.len(), "the other faults stay");
            assert!(faults.iter().all(|fault| fault.kind != Some(FaultKind::PowerCut)));
        }
    }
}
