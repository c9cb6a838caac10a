//! `run --record FILE`: starts a recording, and reports it at the end of the run.

use crate::record::about::Begun;
use crate::record::feed::Feed;
use crate::record::last_second::LastSecond;
use crate::record::place::Place;
use crate::record::recorder::{Patience, Recorder, Written};
use crate::record::sheet::RunInfo;
use crate::scenario::keys::Pace;
use crate::scenario::{Override, Scenario};
use std::fs::File;
use std::path::{Path, PathBuf};

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
    let about = RunInfo::of(scenario, overrides, begun).with_build();
    Recorder::begin_at(Some((file, Some(place))), feed, about, patience)
}

/// Starts a recorder without a file: only the `feed` gets the messages of the run.
pub(super) fn begin_feed(
    feed: Feed,
    scenario: &Scenario,
    overrides: &[Override],
    begun: Begun,
) -> std::io::Result<Recorder> {
    Recorder::begin_feed(feed, RunInfo::of(scenario, overrides, begun))
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
    Some(LastSecond::new(states_folder()?, RunInfo::of(scenario, overrides, begun)))
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
