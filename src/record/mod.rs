//! Results of a run: its hashes ([`run_hash`]), the summary, the journal, and the recording.
//!
//! - written: [`recorder`] (the thread), `place` (the file and its name), [`sheet`] (what goes
//!   where), `file` (MCAP), made of `cdr`, `schema`, `standard`, [`tick`],
//!   `sensed`, `belief`, `calibration`, [`urdf`]
//! - read: [`reading`] (whole, cut off or damaged), [`recover_file`], `playback` (as a port and
//!   as sensors), [`report`]

pub(crate) mod belief;
pub(crate) mod calibration;
pub(crate) mod cdr;
pub(crate) mod entry;
pub(crate) mod file;
pub mod journal;
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

/// The file of the program that runs here. Under Linux that is itself, whatever stands at its path
/// by now; a process that is to become it follows the link while it is still a copy of this one.
///
/// # Errors
/// What the operating system says.
pub(crate) fn running_program() -> std::io::Result<std::path::PathBuf> {
    let own = std::path::Path::new("/proc/self/exe");
    if own.exists() { Ok(own.to_owned()) } else { std::env::current_exe() }
}
