//! `rubik-robot report`: writes a report of a recorded run as one HTML page.
//!
//! - in: a recording
//! - out: a page with verdict, figures, curves, pictures and plan, without other files

use super::output::{clash, inform, refuse, save, warn};
use super::progress::{Bar, Waiting};
use super::{picture, replay};
use crate::hw::text;
use crate::operator::Snapshot;
use crate::record::reading::{End, Label};
use crate::record::report::{gather, page};
use clap::Args;
use image::codecs::jpeg::JpegEncoder;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot run scenarios/solve.toml --record run.mcap
  rubik-robot report run.mcap -o report.html

The page has the verdict, figures, curves, pictures and the plan. It needs no other files: it can be
mailed, printed and archived. If the recording is damaged, it covers the part that can be read, and
a message on stderr says so.
Exit codes: 0 written, 2 wrong usage, the recording cannot be used, or FILE cannot be written.")]
pub(super) struct ReportArgs {
    /// Recording of `run --record` (MCAP)
    pub(super) recording: PathBuf,
    /// Write the report to FILE (HTML)
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: PathBuf,
}

/// Writes the report of the recording; returns the exit code.
pub(super) fn run(args: &ReportArgs) -> anyhow::Result<u8> {
    let unread =
        |why: &dyn std::fmt::Display| refuse(format!("{}: {why}", args.recording.display()));
    clash(&[("the recording", Some(&args.recording))], &[("-o", Some(&args.output))])?;
    let file = text::open_any(&args.recording).map_err(refuse)?;
    let bar = Bar::of_long_work(&args.recording.display().to_string());
    let length = file.metadata().map_or(0, |data| data.len());
    let metered = Metered { file, at: 0, length, bar: &bar };
    let story = gather(BufReader::with_capacity(1 << 20, metered));
    drop(bar);
    let mut story = story.map_err(|why| unread(&why))?;
    // Drawings need a scenario that is valid in this version; a report can do without them.
    if !story.plans.is_empty() {
        let _waiting = Waiting::begin("drawing the plan");
        story.drawn = drawn(&args.recording, &story.label).unwrap_or_else(|why| {
            warn(&format!("the report has no drawings of the plan: {why}"));
            Vec::new()
        });
    }
    // The page is written before the warnings: they say what it lacks.
    save(&args.output, page(&story).as_bytes()).map_err(|why| refuse(format!("{why:#}")))?;
    if let Some(flaw) = story.file_end.as_ref().and_then(End::flaw) {
        let path = args.recording.display();
        let consequence = match flaw {
            End::Index(_) => "the report covers all; `rubik-robot recover` writes a new index",
            _ => "the report covers the part that could be read",
        };
        warn(&format!("{path}: {flaw}; {consequence}"));
    }
    inform(&format!(
        "{}: written, the report of {} recorded messages",
        args.output.display(),
        story.count
    ));
    Ok(0)
}

/// File whose bar shows the share of it that is read.
struct Metered<'a> {
    file: File,
    /// Place of the next byte.
    at: u64,
    /// Number of bytes; 0 for a pipe.
    length: u64,
    bar: &'a Bar,
}

impl Read for Metered<'_> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(to)?;
        self.at += count as u64;
        if self.length > 0 {
            self.bar.show((self.at as f64 / self.length as f64).min(1.0));
        }
        Ok(count)
    }
}

impl Seek for Metered<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.at = self.file.seek(to)?;
        Ok(self.at)
    }
}

/// Number of steps of the plan that are drawn.
const DRAWINGS: usize = 9;
/// Size of a drawing (px).
const SIZE: (u32, u32) = (480, 360);
/// Quality of the file of a drawing, of 100.
const QUALITY: u8 = 75;

/// Time of a drawing (s), the step of the plan in words, and the JPEG file.
type Drawing = (f64, String, Vec<u8>);

/// Draws the cell in up to [`DRAWINGS`] steps of the plan. Reads the recording a second time;
/// `label` is its label, which was read the first time.
///
/// # Errors
/// Reason why there are no drawings.
fn drawn(recording: &Path, label: &Label) -> Result<Vec<Drawing>, String> {
    let scenario = replay::scenario_of(label, recording)?;
    let show = replay::read(recording, &scenario)?;
    // A step has no drawing if the controller did not know where the cube was.
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
    fn metered_file_counts_bytes_after_seek() {
        let bar = Bar::of_long_work("");
        let file = File::open(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml")).unwrap();
        let mut metered = Metered { file, at: 0, length: 100, bar: &bar };

        metered.seek(SeekFrom::Start(10)).unwrap();
        metered.read_exact(&mut [0; 7]).unwrap();

        assert_eq!(metered.at, 17);
    }

    #[test]
    fn error_says_why_recording_cannot_be_drawn() {
        let nowhere = Path::new("/nowhere/run.mcap");
        let why = |scenario: &str| {
            let facts = [("version".to_owned(), "0".to_owned())].into();
            let metadata = [("rubik_robot".to_owned(), facts)].into();
            let label = Label { metadata, scenario: scenario.to_owned() };
            drawn(nowhere, &label).unwrap_err()
        };

        assert!(why("").contains("/nowhere/run.mcap: not a recording"), "{}", why(""));
        let broken = why("taks = 1");
        assert!(broken.contains("its scenario is not valid") && broken.contains("taks"));
        let gone = why("task = \"idle\"");
        assert!(gone.starts_with("cannot read /nowhere/run.mcap: there is no"), "{gone}");
    }
}
