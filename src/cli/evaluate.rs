//! `rubik-robot vision eval`: the detector against photographs with a known truth.
//!
//! A manifest has one JSON object a line, a face each: `image` (path from the manifest's folder), `face` (nine
//! letters in reading order), `all_centres` (nine pixels), and optionally `tier` and `source` to group by.
//! A face is *found* when all nine reported centres lie within a quarter of its smallest tile pitch, in any of
//! the four reading orders (a roll of 45 deg has no upright), and *read* when its nine colours are right too.

use super::faces::letters;
use super::image_file::load;
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

/// Confidence from which a report that is wrong counts as a confident one.
const CONFIDENT: f64 = 0.8;

/// One face of a manifest.
#[derive(Debug, Clone, Deserialize)]
struct Truth {
    image: String,
    face: String,
    all_centres: [(f64, f64); 9],
    #[serde(default)]
    tier: String,
    #[serde(default)]
    source: String,
}

/// Counts of one group of faces.
#[derive(Debug, Clone, Copy, Default, Serialize)]
struct Tally {
    faces: usize,
    /// All nine centres within a quarter of the tile pitch.
    found: usize,
    /// Found, and all nine colours right.
    read: usize,
    /// Tiles of all faces, found or not.
    tiles: usize,
    /// Tiles of found faces with the right colour.
    tiles_right: usize,
}

impl Tally {
    fn add(&mut self, other: &Self) {
        self.faces += other.faces;
        self.found += other.found;
        self.read += other.read;
        self.tiles += other.tiles;
        self.tiles_right += other.tiles_right;
    }
}

/// Everything that one run over a manifest counted.
#[derive(Debug, Default)]
struct Evaluation {
    /// By tier and source.
    groups: BTreeMap<(String, String), Tally>,
    images: usize,
    reports: usize,
    /// Reports that are on no annotated face: wrong, or on a face that the manifest leaves out.
    wrong: usize,
    /// Of these, those with [`CONFIDENT`] or more.
    wrong_confident: usize,
    /// Time of each picture without reading its file, sorted (ms).
    times: Vec<f64>,
    misses: Vec<String>,
}

/// The table of a manifest as text, or one JSON object; `misses` names each face that was not read right.
///
/// # Errors
/// A manifest or picture that cannot be read.
pub fn evaluate(manifest: &Path, json: bool, misses: bool) -> Result<String> {
    let evaluation = Evaluation::run(manifest)?;
    Ok(if json { evaluation.json() } else { evaluation.text(misses) })
}

/// Faces by picture.
fn truths(manifest: &Path) -> Result<BTreeMap<String, Vec<Truth>>> {
    let text =
        text::read(manifest, text::LIST).with_context(|| format!("{}", manifest.display()))?;
    let mut by_image: BTreeMap<String, Vec<Truth>> = BTreeMap::new();
    for (number, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let at = || format!("{}:{}", manifest.display(), number + 1);
        let truth: Truth = serde_json::from_str(line).with_context(at)?;
        if truth.face.chars().count() != 9 {
            bail!("{}: face {:?} has not nine letters", at(), truth.face);
        }
        by_image.entry(truth.image.clone()).or_default().push(truth);
    }
    if by_image.is_empty() {
        bail!("{}: it names no picture", manifest.display());
    }
    Ok(by_image)
}

/// The sighting in the reading order in which it fits a face of the manifest.
fn fitting(sighting: &FaceSighting, truth: &Truth) -> Option<FaceSighting> {
    let reach = 0.25 * smallest_pitch(&truth.all_centres);
    let near = |s: &FaceSighting| {
        s.centres.iter().zip(&truth.all_centres).all(|(a, b)| distance(*a, *b) <= reach)
    };
    (0..4).map(|k| sighting.turned(k)).find(near)
}

impl Evaluation {
    fn run(manifest: &Path) -> Result<Self> {
        let folder = manifest.parent().unwrap_or(Path::new(""));
        let by_image = truths(manifest)?;
        let mut all = Self { images: by_image.len(), ..Self::default() };
        for (name, truths) in &by_image {
            let image = load(&folder.join(name))?;
            let start = Instant::now();
            let sightings = detect(&image, None, &DetectorSettings::default()).unwrap_or_default();
            all.times.push(start.elapsed().as_secs_f64() * 1e3);
            all.count(name, &sightings, truths);
        }
        all.times.sort_by(f64::total_cmp);
        Ok(all)
    }

    fn count(&mut self, name: &str, sightings: &[FaceSighting], truths: &[Truth]) {
        self.reports += sightings.len();
        for sighting in sightings {
            if !truths.iter().any(|t| fitting(sighting, t).is_some()) {
                self.wrong += 1;
                self.wrong_confident += usize::from(sighting.confidence >= CONFIDENT);
                let at = sighting.centres[4];
                self.misses.push(format!(
                    "{name}: {} at {:.0},{:.0} with confidence {:.2} is no annotated face",
                    letters(sighting),
                    at.0,
                    at.1,
                    sighting.confidence
                ));
            }
        }
        for truth in truths {
            let source = match truth.source.as_str() {
                "" => name.split('/').next().unwrap_or_default().to_owned(),
                source => source.to_owned(),
            };
            let tally = self.groups.entry((truth.tier.clone(), source)).or_default();
            tally.faces += 1;
            tally.tiles += 9;
            let Some(found) = sightings.iter().find_map(|s| fitting(s, truth)) else {
                self.misses.push(format!("{name}: {} not found", truth.face));
                continue;
            };
            tally.found += 1;
            let read = letters(&found);
            let right = read.chars().zip(truth.face.chars()).filter(|(a, b)| a == b).count();
            tally.tiles_right += right;
            if right == 9 {
                tally.read += 1;
            } else {
                self.misses.push(format!("{name}: {} read as {read}", truth.face));
            }
        }
    }

    fn total(&self) -> Tally {
        self.groups.values().fold(Tally::default(), |mut sum, t| {
            sum.add(t);
            sum
        })
    }

    /// Time below which the share `p` of the pictures lies (ms).
    fn time(&self, p: f64) -> f64 {
        let last = self.times.len().saturating_sub(1);
        self.times.get((last as f64 * p).round() as usize).copied().unwrap_or(0.0)
    }

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
        });
        format!("{all}\n")
    }

    fn text(&self, misses: bool) -> String {
        let mut out = String::from(
            "tier source             faces  found right      faces read right tiles read right\n",
        );
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
            "{} faces reported, {} of them on no annotated face ({} with a confidence of {CONFIDENT} or more)",
            self.reports, self.wrong, self.wrong_confident
        );
        let _ = writeln!(
            out,
            "{} pictures: median {:.2} ms, 95 % {:.2} ms, slowest {:.2} ms a picture",
            self.images,
            self.time(0.5),
            self.time(0.95),
            self.time(1.0)
        );
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
    fn a_face_counts_in_any_reading_order() {
        let mut all = Evaluation::default();

        all.count("set/a.png", &[sighting().turned(3)], &[truth()]);

        let tally = all.groups[&("A".to_owned(), "set".to_owned())];
        assert_eq!((tally.found, tally.read, tally.tiles_right), (1, 1, 9));
        assert_eq!((all.reports, all.wrong), (1, 0));
    }

    #[test]
    fn a_face_off_by_three_tenths_of_a_pitch_is_a_wrong_report() {
        let mut all = Evaluation::default();
        let mut off = sighting();
        off.centres.iter_mut().for_each(|c| c.0 += 3.0);

        all.count("set/a.png", &[off], &[truth()]);

        assert_eq!((all.total().found, all.wrong, all.wrong_confident), (0, 1, 1));
    }

    #[test]
    fn a_wrong_colour_is_counted_by_tile() {
        let mut all = Evaluation::default();
        let mut face = sighting();
        face.colours[4] = 0;

        all.count("set/a.png", &[face], &[truth()]);

        assert_eq!((all.total().found, all.total().read, all.total().tiles_right), (1, 0, 8));
    }
}
