//! Reads a recording: phases, largest forces, verdict.
//!
//!     cargo run --release --example read_recording
//!     cargo run --release --example read_recording -- run.mcap
//!
//! Without a path the program records a run first: both hands hold a cube and turn one layer.

use rubik_robot::record::about::Begun;
use rubik_robot::record::recorder::{Patience, Recorder};
use rubik_robot::record::report::{Story, gather};
use rubik_robot::record::sheet::RunInfo;
use rubik_robot::record::summary::Summary;
use rubik_robot::run::{RunContext, RunOptions, run_with};
use rubik_robot::tasks;
use std::error::Error;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Scenario of the run that is recorded.
const TURN: &str = "task = \"face_turn\"\n[plant]\njaws = \"stiff\"\n";

fn main() -> Result<(), Box<dyn Error>> {
    let given = std::env::args_os().nth(1).map(PathBuf::from);
    let path = given.clone().unwrap_or_else(|| std::env::temp_dir().join("face_turn.mcap"));
    if given.is_none() {
        record(&path)?;
    }
    let story = read(&path)?;

    println!("{}: {} messages, {:.1} s", path.display(), story.count, story.end);
    for (begin, name) in &story.phases {
        println!("{begin:8.2} s  {name}");
    }
    for arm in &story.arms {
        println!("largest force at the {} tool: {:.1} N", arm.name, largest(&arm.force));
    }
    match &story.summary {
        Some(Summary { outcome, reason, .. }) => println!("{outcome:?}: {reason}"),
        None => println!("the recording ends before the run does"),
    }
    Ok(())
}

/// Runs [`TURN`] and records it to a file at `path`. Returns the summary of the run.
pub(crate) fn record(path: &Path) -> Result<Summary, Box<dyn Error>> {
    let scenario = tasks::read(Path::new("face_turn"), TURN, &[])?;
    let about = RunInfo::of(&scenario, &[], Begun::default());
    // In simulated time the run can wait for the disk, so that no message is lost.
    let recorder = Recorder::begin(File::create(path)?, about, Patience::Waits)?;
    let context = RunContext { recorder: recorder.clone(), ..RunContext::default() };
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };

    let summary = run_with(&scenario, options, context)?;

    let written = recorder.finish().ok_or("nothing was recorded")?;
    written.failure.map_or(Ok(summary), |why| Err(why.into()))
}

/// Reads the recording at `path`, which may be cut off or damaged.
pub(crate) fn read(path: &Path) -> Result<Story, Box<dyn Error>> {
    Ok(gather(File::open(path)?)?)
}

/// Returns the largest value of a curve.
pub(crate) fn largest(curve: &[f32]) -> f32 {
    curve.iter().copied().fold(0.0, f32::max)
}
