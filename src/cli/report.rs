//! `rubik-robot report`: one page that tells a recorded run.

use super::output::{clash, complain, refuse, save};
use super::{picture, replay};
use crate::operator::Snapshot;
use crate::record::reading::{End, Label};
use crate::record::report::{gather, page};
use crate::run::show::Show;
use clap::Args;
use image::codecs::jpeg::JpegEncoder;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;

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
    let unread =
        |why: &dyn std::fmt::Display| refuse(format!("{}: {why}", args.recording.display()));
    clash(&[("the recording", Some(&args.recording))], &[("-o", Some(&args.output))])?;
    let file = File::open(&args.recording).map_err(|why| unread(&why))?;
    let mut story = gather(BufReader::with_capacity(1 << 20, file)).map_err(|why| unread(&why))?;
    if !story.plans.is_empty() {
        story.drawn = drawn(&args.recording, &story.label).unwrap_or_else(|why| {
            complain(&format!("no step of the plan is drawn: {why}"));
            Vec::new()
        });
    }
    save(&args.output, page(&story).as_bytes()).map_err(|why| refuse(format!("{why:#}")))?;
    if let Some(flaw) = story.file_end.as_ref().and_then(End::flaw) {
        let path = args.recording.display();
        complain(&format!("{path}: {flaw}; the page tells what is there"));
    }
    complain(&format!("{}: {} messages told", args.output.display(), story.count));
    Ok(0)
}

/// Steps of the plan that are drawn.
const DRAWINGS: usize = 9;
/// Size of a drawing (px), and quality of its file, of 100.
const SIZE: (u32, u32) = (480, 360);
const QUALITY: u8 = 75;

/// When a drawing is of, what it shows, and its file.
type Drawing = (f64, String, Vec<u8>);

/// Drawings of the plan's steps, by a second reading of a recording with this label; or why there can be none.
fn drawn(recording: &Path, label: &Label) -> Result<Vec<Drawing>, String> {
    let told = |why: &dyn std::fmt::Display| format!("{}: {why}", recording.display());
    let scenario = replay::scenario_of(label, recording)?;
    let file = File::open(recording).map_err(|why| told(&why))?;
    let file = BufReader::with_capacity(1 << 20, file);
    let show = Show::read(file, &scenario, "").map_err(|why| told(&why))?;
    let drawing = |(time, words, snapshot): (f64, String, Arc<Snapshot>)| {
        let scene = picture::during(&snapshot, &scenario.controller)?;
        let image = picture::outside(&scene, &scenario.controller, SIZE);
        let mut jpeg = Vec::new();
        let encoder = JpegEncoder::new_with_quality(&mut jpeg, QUALITY);
        image.write_with_encoder(encoder).ok()?;
        Some((time, words, jpeg))
    };
    Ok(show.moments(DRAWINGS).into_iter().filter_map(drawing).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn why_nothing_is_drawn_is_told() {
        let nowhere = Path::new("/nowhere/run.mcap");
        let why = |scenario: &str| {
            let facts = [("version".to_owned(), "0".to_owned())].into();
            let metadata = [("rubik_robot".to_owned(), facts)].into();
            let label = Label { metadata, scenario: scenario.to_owned() };
            drawn(nowhere, &label).unwrap_err()
        };

        assert!(why("").contains("/nowhere/run.mcap: not a recording"), "{}", why(""));
        let broken = why("taks = 1");
        assert!(broken.contains("its scenario is not right here") && broken.contains("taks"));
        let gone = why("task = \"idle\"");
        assert!(gone.starts_with("/nowhere/run.mcap: No such file"), "{gone}");
    }
}
