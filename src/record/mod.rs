//! Results of a run: its hashes ([`run_hash`]), the summary, the journal, and the recording, which
//! is an MCAP file with ROS 2 messages.
//!
//! - writing a recording: [`about`] (the description of the run), [`recorder`] (the thread),
//!   `place` (the path of the file), [`sheet`] (the topics), `file` (MCAP); the messages are in
//!   `cdr`, `schema`, `standard`, [`tick`], `sensed`, `belief`, `calibration` and [`urdf`];
//!   [`last_second`] writes a short recording after an error, also if the run is not recorded
//! - reading a recording: [`reading`] (whole, cut off or damaged) with `framing` (records),
//!   `chunk` and `closing` (the index), [`recover_file`], `merge` (of all nodes of a run),
//!   `playback` (as port and sensors of a run), [`report`]

pub mod about;
pub(crate) mod belief;
pub(crate) mod calibration;
pub(crate) mod cdr;
mod chunk;
mod closing;
pub(crate) mod entry;
pub mod feed;
pub(crate) mod file;
mod framing;
pub mod journal;
pub mod last_second;
pub(crate) mod merge;
pub(crate) mod place;
pub(crate) mod playback;
pub mod reading;
pub mod recorder;
pub mod recover_file;
pub mod report;
pub mod run_hash;
pub(crate) mod schema;
pub(crate) mod sensed;
pub mod sheet;
pub(crate) mod standard;
pub mod summary;
pub mod tick;
pub mod urdf;

/// Returns a path to the running program, to start it again, to read it or to identify it. Under
/// Linux the path is a link to the running program itself, even if another file has replaced it on
/// disk. A forked child follows the link while it is still a copy of this process, so it starts the
/// same program.
///
/// # Errors
/// Error of the operating system if it does not know the path.
pub(crate) fn running_program() -> std::io::Result<std::path::PathBuf> {
    // By now, the path on disk may lead to another build, so the link is preferred.
    let own = std::path::Path::new("/proc/self/exe");
    if own.exists() { Ok(own.to_owned()) } else { std::env::current_exe() }
}

/// Returns the checksum of the running program in hexadecimal, since two builds of one version may
/// differ; "unknown" if the program cannot be read.
pub(crate) fn build() -> String {
    let program = running_program().and_then(std::fs::read);
    program
        .map_or_else(|_| "unknown".to_owned(), |bytes| format!("{:08x}", crc32fast::hash(&bytes)))
}
