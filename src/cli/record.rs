//! `run --record FILE`: starts a recording, and reports it at the end of the run.

use crate::record::build;
use crate::record::calibration;
use crate::record::feed::Feed;
use crate::record::last_second::LastSecond;
use crate::record::place::Place;
use crate::record::recorder::{Patience, Recorder, Written};
use crate::record::sheet::RunInfo;
use crate::scenario::keys::Pace;
use crate::scenario::{Override, Scenario};
use crate::servo::period::Length;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Circumstances of a recorded run, which its recording names.
#[derive(Debug, Clone, Copy)]
pub(super) struct Begun {
    /// Whether an operator can be asked.
    pub(super) attended: bool,
    /// Whether the run resumes an interrupted one.
    pub(super) resumed: bool,
}

/// Starts a recording in a file, whose messages the `feed` gets as well. `place` has the temporary
/// and the final path of the file, as [`Place::create`] returns them.
pub(super) fn begin(
    (file, place): (File, Place),
    feed: Option<Feed>,
    scenario: &Scenario,
    overrides: &[Override],
    begun: Begun,
) -> std::io::Result<Recorder> {
    // In simulated time the run can wait for the disk; in real time it cannot.
    let patience = match scenario.pace {
        Pace::Virtual => Patience::Waits,
        Pace::RealTime => Patience::Never,
    };
    let mut about = about(scenario, overrides, begun);
    about.facts.insert("build".into(), build());
    Recorder::begin_at(Some((file, Some(place))), feed, about, patience)
}

/// Starts a recorder without a file: only the `feed` gets the messages of the run.
pub(super) fn begin_feed(
    feed: Feed,
    scenario: &Scenario,
    overrides: &[Override],
    begun: Begun,
) -> std::io::Result<Recorder> {
    Recorder::begin_feed(feed, about(scenario, overrides, begun))
}

/// Returns the user's folder of states: `rubik-robot` in `XDG_STATE_HOME`, else in
/// `~/.local/state`. `None` if there is neither.
pub(super) fn states_folder() -> Option<PathBuf> {
    let set = |name: &str| {
        let path = std::env::var_os(name).map(PathBuf::from);
        // The XDG base directory specification ignores relative paths.
        path.filter(|path| path.is_absolute())
    };
    let states = set("XDG_STATE_HOME").or_else(|| Some(set("HOME")?.join(".local/state")))?;
    Some(states.join("rubik-robot"))
}

/// Returns the keeper of the last second of a run, whose file will be in the user's folder of
/// states. `None` if there is no such folder.
pub(super) fn last_second(
    scenario: &Scenario,
    overrides: &[Override],
    begun: Begun,
) -> Option<LastSecond> {
    Some(LastSecond::new(states_folder()?, about(scenario, overrides, begun)))
}

/// Returns the description with which a recording of this scenario begins, without facts about the
/// build of the program.
fn about(scenario: &Scenario, overrides: &[Override], begun: Begun) -> RunInfo {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let config = &scenario.controller;
    let length = Length::of_seconds(scenario.real_time.period);
    let arms: Vec<_> = config.cell.arms.iter().map(|arm| arm.name.as_str()).collect();
    let pace = match scenario.pace {
        Pace::Virtual => "virtual",
        Pace::RealTime => "real-time",
    };
    // Only a simulation knows the true state of the cube.
    let truth = (!scenario.bridge.kind.is_hardware()).then(|| scenario.cube().to_string());
    let program = scenario.task.program();
    let loose = scenario.objects().iter().enumerate().filter(|(_, keys)| !keys.is_fixed());
    // The metadata of MCAP is a map of texts.
    let facts = [
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("program", program.program.clone()),
        ("program_version", program.version.clone()),
        ("tasks", program.tasks.join(" ")),
        ("platform", format!("{} {}", std::env::consts::ARCH, std::env::consts::OS)),
        ("scenario", scenario.path.display().to_string()),
        ("task", config.task.word().to_owned()),
        ("coordination", config.coordination.word().to_owned()),
        ("pace", pace.to_owned()),
        ("seed", scenario.seed.to_string()),
        ("cube_start", truth.unwrap_or_default()),
        ("arms", arms.join(" ")),
        ("period_ns", length.nanos().to_string()),
        ("attended", begun.attended.to_string()),
        ("resumed", begun.resumed.to_string()),
        ("started_unix_s", now.as_secs().to_string()),
        ("declared_face_s", config.vision.face.to_string()),
        ("standalone_xyz", calibration::standalone(&config.cell)),
        ("force_limit_n", config.control.force_limit.to_string()),
        ("torque_limit_nm", config.control.torque_limit.to_string()),
    ];
    // A recording of simulated time begins at 0, so that it is the same in each run.
    let start = match scenario.pace {
        Pace::Virtual => 0,
        Pace::RealTime => now.as_nanos() as u64,
    };
    RunInfo {
        cell: config.cell.clone(),
        scenario: scenario.text.clone(),
        objects: loose.map(|(i, keys)| (i, keys.link())).collect(),
        options: overrides
            .iter()
            .map(|o| (o.option.clone(), o.key.clone(), o.value.clone()))
            .collect(),
        facts: facts
            .map(|(name, value)| (name.to_owned(), value))
            .into_iter()
            .collect::<BTreeMap<_, _>>(),
        start,
        length,
    }
}

/// Returns the message about a recording at the end of its run.
pub(super) fn result_message(path: &Path, written: &Written) -> String {
    // A run that failed before its first period must not destroy an older recording.
    if let Some(aside) = &written.aside {
        let (path, aside) = (path.display(), aside.display());
        if written.failure.is_some() {
            return format!("recorded {aside}: {written}; {path} is as it was");
        }
        return format!(
            "recorded {aside}: {written}; {path} is as it was: a recording without a servo period \
             does not replace another one"
        );
    }
    let size = std::fs::metadata(path).map_or(0, |m| m.len());
    format!("recorded {}: {written}, {:.1} MB", path.display(), size as f64 / 1e6)
}
