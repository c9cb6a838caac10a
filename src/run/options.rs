//! Options of a run's start, and its surroundings: desk, recordings, files.

use crate::desk::RunEnd;
use crate::error::Error;
use crate::hw::plant::Plant;
use crate::record::last_second::LastSecond;
use crate::record::playback::Playback;
use crate::record::recorder::Recorder;
use crate::record::summary::Summary;
use std::path::PathBuf;

/// Options of a run's start.
#[derive(Debug, Clone, Copy, Default)]
#[allow(
    clippy::struct_excessive_bools,
    reason = "switches of the command line, independent of each other"
)]
pub struct RunOptions {
    /// Whether to ask nothing and to read no keys. Otherwise the keys p, r and t on stdin pause,
    /// resume and terminate.
    pub automatic: bool,
    /// Whether to wait for the operator's start. The end of stdin counts as a start.
    pub wait: bool,
    /// Whether to write nothing to stderr.
    pub quiet: bool,
    /// Whether to refuse to run under the wall clock unless every real-time right is granted.
    pub require_real_time: bool,
    /// Whether signals to the process terminate the run, as the operator can.
    pub interruptible: bool,
    /// Initial limit of virtual time, in multiples of real time; 0 for as fast as it computes.
    pub speed: f64,
    /// Function that is called from a thread outside the runtime when an actor blocks all others.
    /// The run cannot end by itself then. Its summary has the error, but no figures.
    pub stuck: Option<fn(Error, Summary)>,
}

/// Surroundings of a run, which its caller owns and which outlive it.
#[derive(Default)]
pub struct RunContext {
    /// Run's end of the desk, at whose other end are the UIs.
    pub desk: Option<RunEnd>,
    /// Whether the UIs at the desk only show the run, so that no operator can be asked there.
    pub watched: bool,
    /// Recorder of the run; the caller that created it finishes it.
    pub recorder: Recorder,
    /// Recording in place of the plant, the sensors and the operator, and whether an operator could
    /// be asked in that run.
    pub playback: Option<(Playback, bool)>,
    /// Keeper of the last second, which is written after a fatal or a system error.
    pub last_second: Option<LastSecond>,
    /// Files that outlive a run.
    pub saved: SavedFiles,
    /// Probe that sees the plant after each period, under virtual time. It is for a judge of the
    /// run, not for any part of it.
    pub probe: Option<PlantProbe>,
}

/// Files that outlive a run.
#[derive(Debug, Clone, Default)]
pub struct SavedFiles {
    /// File of the simulated plant's state, which the controller does not know.
    pub world: Option<PathBuf>,
    /// Journal of the controller, from which another run resumes.
    pub journal: Option<PathBuf>,
    /// Whether to resume the interrupted run that left them.
    pub resume: bool,
    /// Whether no user named these files. The run then goes on without a file that cannot be
    /// written, and does not wait for the disk at each state of the plant.
    pub unasked: bool,
}

/// Function that is called after each period with its number and the plant.
pub type PlantProbe = Box<dyn FnMut(u64, &Plant) + Send>;
