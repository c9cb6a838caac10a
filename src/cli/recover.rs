//! `rubik-robot recover`: repairs a recording that was cut off or damaged.
//!
//! - in: a recording
//! - out: a recording of all that is not damaged, with an index
//! - exit code: 1 if no message can be read

use super::output::{clash, complain, inform, refuse};
use crate::hw::text;
use crate::record::place::Place;
use crate::record::recover_file::recover_file;
use clap::Args;
use std::io::{BufReader, BufWriter};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot recover cut.mcap -o whole.mcap
  rubik-robot report whole.mcap -o report.html

The new file has everything that is not damaged, up to the cut if there is one, and an index, so
that any tool opens it. A damaged chunk, about a second of the run, is left out. A line on stderr
has the number of messages, their duration by the time of the recording (s), and the damage.
Exit codes: 0 repaired, 1 no message can be read, 2 wrong usage, or a file cannot be opened or
written, 4 system error.")]
pub(super) struct RecoverArgs {
    /// Recording (MCAP)
    recording: PathBuf,
    /// Write the repaired recording to FILE (MCAP)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

/// Writes the messages of a damaged recording that can be read to a new one; returns the exit code.
pub(super) fn run(args: &RecoverArgs) -> anyhow::Result<u8> {
    clash(&[("the recording", Some(&args.recording))], &[("-o", Some(&args.output))])?;
    let from = BufReader::new(text::open_any(&args.recording).map_err(refuse)?);
    // The new file gets its name only when it is complete.
    let (to, mut place) = Place::create(&args.output)
        .map_err(|error| refuse(format!("{}: {error}", args.output.display())))?;
    let saved = match recover_file(from, BufWriter::new(to)) {
        Ok(saved) => saved,
        Err(error) => {
            place.discard()?;
            return Err(refuse(format!("{}: {error}", args.output.display())));
        }
    };
    let end = match saved.end.flaw() {
        None => "the recording was complete".to_owned(),
        Some(flaw) => format!("it was {flaw}"),
    };
    // An empty recording must not replace a file that exists.
    if saved.messages == 0 {
        place.discard()?;
        let path = args.recording.display();
        complain(&format!("{path}: no message can be read, so nothing is written; {end}"));
        return Ok(1);
    }
    place.sync().and_then(|()| place.rename_to_final()).inspect_err(|_| {
        complain(&format!("{}: the recording is not complete", place.at().display()));
    })?;
    let (count, seconds) = (saved.messages, saved.span as f64 * 1e-9);
    inform(&format!("{}: {count} messages, {seconds:.2} s; {end}", args.output.display()));
    Ok(0)
}
