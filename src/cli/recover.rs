//! `rubik-robot recover`: a whole recording of one that was cut off.

use super::output::{clash, complain, refuse};
use crate::record::place::Place;
use crate::record::recover_file::recover_file;
use clap::Args;
use std::fs::File;
use std::io::{BufReader, BufWriter};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  rubik-robot recover cut.mcap -o whole.mcap
Everything up to the cut, or to the first damage, is kept; an index is written, so that any tool opens the file.")]
pub(super) struct RecoverArgs {
    /// The recording
    recording: PathBuf,
    /// Where the whole one goes
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

pub(super) fn run(args: &RecoverArgs) -> anyhow::Result<u8> {
    clash(&[("the recording", Some(&args.recording))], &[("-o", Some(&args.output))])?;
    let file = File::open(&args.recording)
        .map_err(|error| refuse(format!("{}: {error}", args.recording.display())))?;
    let from = BufReader::new(file);
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
        None => "the recording was whole".to_owned(),
        Some(flaw) => format!("it was {flaw}"),
    };
    if saved.messages == 0 {
        place.discard()?;
        let path = args.recording.display();
        complain(&format!("{path}: no message can be read, nothing is written; {end}"));
        return Ok(1);
    }
    place.take()?;
    let (count, seconds) = (saved.messages, saved.span as f64 * 1e-9);
    complain(&format!("{}: {count} messages, {seconds:.2} s; {end}", args.output.display()));
    Ok(0)
}
