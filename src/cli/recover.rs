//! `rubik-robot recover`: a whole recording of one that was cut off.

use super::output::{WRONG, clash, complain};
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
    if let Some(why) =
        clash(&[("the recording", Some(&args.recording))], &[("-o", Some(&args.output))])
    {
        complain(&why);
        return Ok(WRONG);
    }
    let from = match File::open(&args.recording) {
        Ok(file) => BufReader::new(file),
        Err(error) => {
            complain(&format!("{}: {error}", args.recording.display()));
            return Ok(WRONG);
        }
    };
    let (to, mut place) = match Place::create(&args.output) {
        Ok(created) => created,
        Err(error) => {
            complain(&format!("{}: {error}", args.output.display()));
            return Ok(WRONG);
        }
    };
    let saved = match recover_file(from, BufWriter::new(to)) {
        Ok(saved) => saved,
        Err(error) => {
            place.discard()?;
            complain(&format!("{}: {error}", args.output.display()));
            return Ok(WRONG);
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
