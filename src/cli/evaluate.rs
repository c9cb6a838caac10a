//! `rubik-robot vision eval`: compares the detector with photographs of known truth.
//!
//! - in: a manifest with a JSON object for each face: `image` (path from the manifest's folder),
//!   `face` (nine letters in reading order), `all_centres` (nine pixels), and optionally `tier` and
//!   `source` to group by
//! - out: shares of faces and tiles that are found and read, and the time of a picture
//!
//! | result | condition | reason |
//! |---|---|---|
//! | found | each centre is within a quarter of the smallest tile pitch | it is on its tile |
//! | read | found, and all nine colours are right | |
//! | wrong report | no face of the manifest fits | the detector sees a face where none is |
//!
//! All four reading orders of a face count as right: after a roll of 45 deg none is the upright
//! one.

use super::faces::letters;
use super::image_file::load;
use super::output::save;
use super::reliability::Reliability;
use crate::hw::text;
use crate::vision::homography::{distance, smallest_pitch};
use crate::vision::{DetectorSettings, FaceSighting, detect};
use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

/// Least confidence of a wrong report that counts as confident.
const CONFIDENT: f64 = 0.8;

/// True face of a picture: a line of a manifest.
#[derive(Debug, Clone, Deserialize)]
struct Truth {
    /// Path of the picture from the manifest's folder.
    image: String,
    /// Nine letters of colours in reading order.
    face: String,
    /// Centres of the tiles in reading order (px).
    all_centres: [(f64, f64); 9],
    /// Class of difficulty, by which faces are grouped.
    #[serde(default)]
    tier: String,
    /// Origin of the picture, by which faces are grouped.
    #[serde(default)]
    source: String,
}

/// Counts of one group of faces.
#[derive(Debug, Clone, Copy, Default, Serialize)]
struct Tally {
    faces: usize,
    /// Faces with all nine centres within a quarter of the tile pitch.
    found: usize,
    /// Faces that are found, with nine right colours.
    read: usize,
    /// Tiles of all faces, also of those that are not found.
    tiles: usize,
    /// Tiles of found faces with the right colour.
    tiles_right: usize,
}

impl Tally {
    /// Adds the counts of another group of faces.
    fn add(&mut self, other: &Self) {
        self.faces += other.faces;
        self.found += other.found;
        self.read += other.read;
        self.tiles += other.tiles;
        self.tiles_right += other.tiles_right;
    }
}

/// Counts of a whole manifest.
#[derive(Debug, Default)]
struct Evaluation {
    /// Counts by tier and source.
    groups: BTreeMap<(String, String), Tally>,
    images: usize,
    /// Faces that the detector reported.
    reports: usize,
    /// Reports that fit no face of the manifest. They are wrong, or the manifest lacks the face.
    wrong: usize,
    /// Wrong reports with a confidence of [`CONFIDENT`] or more.
    wrong_confident: usize,
    /// Time of each picture, without reading the file (ms), sorted.
    times: Vec<f64>,
    /// Texts about missed faces, misread faces and wrong reports.
    misses: Vec<String>,
    /// Confidences of the tiles of found faces, by source.
    reliability: Reliability,
}

/// Detects the faces in the pictures of a manifest and compares them with the true faces, which the
/// manifest lists. Returns the counts as a table, or one JSON object. With `misses` the table is
/// followed by each face that was missed or misread, and by each report of a face where none is.
/// `plot` is the file that the plot of the confidences goes to, if any.
///
/// # Errors
/// Unreadable manifest or picture, or a plot that cannot be written.
pub fn evaluate(manifest: &Path, json: bool, misses: bool, plot: Option<&Path>) -> Result<String> {
    let evaluation = Evaluation::run(manifest)?;
    if let Some(plot) = plot {
        save(plot, evaluation.reliability.plot().as_bytes())?;
    }
    Ok(if json { evaluation.json() } else { evaluation.text(misses) })
}

/// Reads a manifest; returns the true faces of each picture by the picture's name.
fn truths(manifest: &Path) -> Result<BTreeMap<String, Vec<Truth>>> {
    let text = text::read(manifest, text::LIST)?;
    let mut by_image: BTreeMap<String, Vec<Truth>> = BTreeMap::new();
    for (number, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let at = || format!("{}:{}", manifest.display(), number + 1);
        let truth: Truth = serde_json::from_str(line).with_context(at)?;
        // A wrong manifest would count as an error of the detector.
        if truth.face.chars().count() != 9 {
            bail!("{}: face {:?} does not have nine letters", at(), truth.face);
        }
        by_image.entry(truth.image.clone()).or_default().push(truth);
    }
    if by_image.is_empty() {
        bail!("{}: the file names no picture", manifest.display());
    }
    Ok(by_image)
}

/// Returns the sighting in the one of its four reading orders whose tile centres are near those of
/// a true face (a quarter of the tile pitch); `None` if there is no such order.
fn fitting(sighting: &FaceSighting, truth: &Truth) -> Option<FaceSighting> {
    let reach = 0.25 * smallest_pitch(&truth.all_centres);
    let near = |s: &FaceSighting| {
        s.centres.iter().zip(&truth.all_centres).all(|(a, b)| distance(*a, *b) <= reach)
    };
    (0..4).map(|k| sighting.turned(k)).find(near)
}

impl Evaluation {
    /// Detects the faces in all pictures of a manifest and counts them.
    fn run(manifest: &Path) -> Result<Self> {
        let folder = manifest.parent().unwrap_or(Path::new(""));
        let by_image = truths(manifest)?;
        let mut all = Self { images: by_image.len(), ..Self::default() };
        for (name, truths) in &by_image {
            let image = load(&folder.join(name))?;
            // The time of reading the file depends on the disk, not on the detector.
            let start = Instant::now();
            // A refusal of the detector is a picture without a report, and no error.
            let sightings = detect(&image, None, &DetectorSettings::default()).unwrap_or_default();
            all.times.push(start.elapsed().as_secs_f64() * 1e3);
            all.count(name, &sightings, truths);
        }
        all.times.sort_by(f64::total_cmp);
        Ok(all)
    }

    /// Compares the detected faces of one picture with its true faces, and counts both.
    fn count(&mut self, name: &str, sightings: &[FaceSighting], truths: &[Truth]) {
        self.reports += sightings.len();
        for sighting in sightings {
            // A report that fits any face of the manifest is right.
            if !truths.iter().any(|t| fitting(sighting, t).is_some()) {
                self.wrong += 1;
                self.wrong_confident += usize::from(sighting.confidence >= CONFIDENT);
                let at = sighting.centres[4];
                self.misses.push(format!(
                    "{name}: {} at {:.0},{:.0} with confidence {:.2} is no face of the manifest",
                    letters(sighting),
                    at.0,
                    at.1,
                    sighting.confidence
                ));
            }
        }
        for truth in truths {
            let source = match truth.source.as_str() {
                // A face without a source is counted under the first folder of its path.
                "" => name.split('/').next().unwrap_or_default().to_owned(),
                source => source.to_owned(),
            };
            let tally = self.groups.entry((truth.tier.clone(), source.clone())).or_default();
            tally.faces += 1;
            // The tiles of a missed face count as wrong ones.
            tally.tiles += 9;
            let Some(found) = sightings.iter().find_map(|s| fitting(s, truth)) else {
                self.misses.push(format!("{name}: {} not found", truth.face));
                continue;
            };
            tally.found += 1;
            let read = letters(&found);
            let right = read.chars().zip(truth.face.chars()).filter(|(a, b)| a == b).count();
            tally.tiles_right += right;
            for ((a, b), confidence) in read.chars().zip(truth.face.chars()).zip(found.confidences)
            {
                self.reliability.add(&source, confidence, a == b);
            }
            if right == 9 {
                tally.read += 1;
            } else {
                self.misses.push(format!("{name}: {} read as {read}", truth.face));
            }
        }
    }

    /// Returns the sums of the counts over all groups of faces.
    fn total(&self) -> Tally {
        self.groups.values().fold(Tally::default(), |mut sum, t| {
            sum.add(t);
            sum
        })
    }

    /// Returns the quantile `p` (0 to 1) of the detection times of the pictures (ms).
    fn time(&self, p: f64) -> f64 {
        // The times are sorted, so a quantile is an element.
        let last = self.times.len().saturating_sub(1);
        self.times.get((last as f64 * p).round() as usize).copied().unwrap_or(0.0)
    }

    /// Returns all counts as one JSON object.
    fn json(&self) -> String {
        let groups: Vec<_> = self
            .groups
            .iter()
            .map(|((tier, source), t)| json!({ "tier": tier, "source": source, "count": t }))
            .collect();
        let all = json!({
            "images": self.images, "all": self.total(), "groups": groups, "reports": self.reports,
            "wrong_reports": self.wrong, "wrong_reports_confident": self.wrong_confident,
            "confident_from": CONFIDENT, "median_ms": self.time(0.5), "p95_ms": self.time(0.95),
            "slowest_ms": self.time(1.0), "misses": self.misses,
            "confidences": self.reliability.json(),
        });
        format!("{all}\n")
    }

    /// Returns all counts as a table.
    fn text(&self, misses: bool) -> String {
        let mut out = String::from(
            "tier source             faces  found right      faces read right tiles read right\n",
        );
        // A group without a face has the share 0.
        let share =
            |n: usize, of: usize| format!("{n:5} ({:5.1} %)", 100.0 * n as f64 / of.max(1) as f64);
        let mut row = |tier: &str, source: &str, t: &Tally| {
            // Writing to a string cannot fail.
            let _ = writeln!(
                out,
                "{tier:<4} {source:<18} {:5} {:>15} {:>15} {:>15}",
                t.faces,
                share(t.found, t.faces),
                share(t.read, t.faces),
                share(t.tiles_right, t.tiles)
            );
        };
        for ((tier, source), t) in &self.groups {
            row(tier, source, t);
        }
        row("all", "", &self.total());
        let _ = writeln!(
            out,
            "{} faces reported, {} of them no face of the manifest ({} with a confidence of \
             {CONFIDENT} or more)",
            self.reports, self.wrong, self.wrong_confident
        );
        let _ = writeln!(
            out,
            "{} pictures: median {:.2} ms, 95 % {:.2} ms, slowest {:.2} ms",
            self.images,
            self.time(0.5),
            self.time(0.95),
            self.time(1.0)
        );
        let _ = write!(out, "\n{}", self.reliability.text());
        if misses {
            for miss in &self.misses {
                let _ = writeln!(out, "  {miss}");
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a true face with a tile pitch of 10 px.
    fn truth() -> Truth {
        Truth {
            image: "a.png".into(),
            face: "WRGYOBOYG".into(),
            all_centres: std::array::from_fn(|i| {
                (20.0 + 10.0 * (i % 3) as f64, 30.0 + 10.0 * (i / 3) as f64)
            }),
            tier: "A".into(),
            source: String::new(),
        }
    }

    /// Returns the sighting that agrees with [`truth`].
    fn sighting() -> FaceSighting {
        FaceSighting {
            corners: [(15.0, 25.0), (45.0, 25.0), (45.0, 55.0), (15.0, 55.0)],
            centres: truth().all_centres,
            seen: [true; 9],
            sticker: 0.8,
            rgb: [[0.0; 3]; 9],
            colours: [0, 1, 2, 3, 4, 5, 4, 3, 2],
            confidences: [1.0; 9],
            confidence: 0.9,
        }
    }

    #[test]
    fn rotated_reading_of_a_face_counts_as_correct() {
        let mut all = Evaluation::default();

        all.count("set/a.png", &[sighting().turned(3)], &[truth()]);

        let tally = all.groups[&("A".to_owned(), "set".to_owned())];
        assert_eq!((tally.found, tally.read, tally.tiles_right), (1, 1, 9));
        assert_eq!((all.reports, all.wrong), (1, 0));
    }

    /// Only a wrong report with a confidence of [`CONFIDENT`] or more counts as confident.
    #[test]
    fn face_off_by_quarter_of_pitch_is_wrong() {
        for (off, confidence, counts) in
            [(2.4, 0.9, (1, 0, 0)), (2.6, 0.8, (0, 1, 1)), (-2.6, 0.79, (0, 1, 0))]
        {
            let mut all = Evaluation::default();
            let mut face = FaceSighting { confidence, ..sighting() };
            // One tile that is off is enough.
            face.centres[7].1 += off;

            all.count("set/a.png", &[face], &[truth()]);

            assert_eq!((all.total().found, all.wrong, all.wrong_confident), counts, "{off} px");
        }
    }

    #[test]
    fn face_with_wrong_tile_is_found_not_read() {
        let mut all = Evaluation::default();
        let mut face = sighting();
        face.colours[4] = 0;

        all.count("set/a.png", &[face], &[truth()]);

        assert_eq!((all.total().found, all.total().read, all.total().tiles_right), (1, 0, 8));
    }
}
