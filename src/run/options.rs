//! How a run is started, and what surrounds it: switches, UI, recordings, files.

use crate::desk::RunEnd;
use crate::error::Error;
use crate::hw::plant::Plant;
use crate::record::playback::Playback;
use crate::record::recorder::Recorder;
use std::path::PathBuf;

/// How a run is started.
#[derive(Debug, Clone, Copy, Default)]
#[allow(
    clippy::struct_excessive_bools,
    reason = "switches of the command line, independent of each other"
)]
pub struct RunOptions {
    /// Asks nothing and listens to no keys; otherwise p, r and t on stdin pause, resume and
    /// terminate.
    pub automatic: bool,
    /// Waits for the operator's start; the end of input is one, too.
    pub wait: bool,
    /// Writes nothing to stderr.
    pub quiet: bool,
    /// Under the wall clock: refuses to run unless every real-time right is granted.
    pub require_real_time: bool,
    /// Takes the process's SIGINT and SIGTERM as the operator's terminate.
    pub interruptible: bool,
    /// Under virtual time: how fast time may go at first, in times of real time; 0 for as fast as
    /// it computes.
    pub speed: f64,
    /// Called from a thread beside the runtime when an actor blocks all others. Such a run never
    /// ends by itself.
    pub stuck: Option<fn(Error)>,
}

/// The surroundings of a run, which its caller owns and which outlive it.
#[derive(Default)]
pub struct RunContext {
    /// The run's end of the desk at which UIs are.
    pub desk: Option<RunEnd>,
    /// The recorder of the run; the caller that made it finishes it.
    pub recorder: Recorder,
    /// A recording in place of the plant, the sensors and the operator, and whether an operator
    /// was there.
    pub playback: Option<(Playback, bool)>,
    /// Files that outlive a run.
    pub saved: SavedFiles,
    /// Sees the plant after each period, under virtual time: for a judge of the run, never for
    /// anything in it.
    pub probe: Option<PlantProbe>,
}

/// Files that outlive a run.
#[derive(Debug, Clone, Default)]
pub struct SavedFiles {
    /// The state of the simulated plant; the controller does not know it.
    pub world: Option<PathBuf>,
    /// The journal, from which another run goes on.
    pub journal: Option<PathBuf>,
    /// Goes on where the run that left them was broken off.
    pub resume: bool,
}

/// A function that is called after each period with its number and the plant.
pub type PlantProbe = Box<dyn FnMut(u64, &Plant) + Send>;
