//! `rubik-robot report`: one page that tells a recorded run.

use super::record::same_file;
use super::{WRONG, complain};
use crate::record::report::{gather, page};
use clap::Args;
use std::fs::File;
use std::io::BufReader;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  rubik-robot run scenarios/solve.toml --record run.mcap
  rubik-robot report run.mcap -o report.html
The page holds everything itself: it can be mailed, printed and kept.")]
pub(super) struct ReportArgs {
    /// The recording
    recording: PathBuf,
    /// Where the page goes
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

pub(super) fn run(args: &ReportArgs) -> anyhow::Result<u8> {
    let told = |why: &dyn std::fmt::Display| {
        complain(&format!("{}: {why}", args.recording.display()));
        Ok(WRONG)
    };
    if same_file(&args.recording, &args.output) {
        complain("the page would be written over its own recording: name another file");
        return Ok(WRONG);
    }
    let file = match File::open(&args.recording) {
        Ok(file) => BufReader::with_capacity(1 << 20, file),
        Err(error) => return told(&error),
    };
    let story = match gather(file) {
        Ok(story) => story,
        Err(why) => return told(&why),
    };
    if let Err(error) = std::fs::write(&args.output, page(&story)) {
        complain(&format!("{}: {error}", args.output.display()));
        return Ok(WRONG);
    }
    if let Some((how, why)) = &story.cut {
        complain(&format!(
            "{}: {how}: {why}; the page tells what is there",
            args.recording.display()
        ));
    }
    complain(&format!("{}: {} messages told", args.output.display(), story.count));
    Ok(0)
}
