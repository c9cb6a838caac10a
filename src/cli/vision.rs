//! `rubik-robot vision face`: picture files in, faces as text or JSON lines out.

use crate::vision::colours::LETTERS;
use crate::vision::{DetectorSettings, FaceSighting, detect};
use anyhow::{Context, Result, anyhow};
use image::{ImageReader, RgbImage};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// A picture file as RGB; the format is judged by its bytes, and its size is bounded.
///
/// # Errors
/// What is wrong with the file.
pub fn load(path: &Path) -> Result<RgbImage> {
    let mut reader = ImageReader::open(path)
        .and_then(ImageReader::with_guessed_format)
        .with_context(|| format!("{}", path.display()))?;
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(10_000);
    limits.max_image_height = Some(10_000);
    limits.max_alloc = Some(400 << 20);
    reader.limits(limits);
    let picture = reader.decode().with_context(|| format!("{}", path.display()))?;
    Ok(picture.into_rgb8())
}

/// Two decimals are finer than any detector.
fn rounded(points: &[(f64, f64)]) -> Value {
    let two = |v: f64| (v * 100.0).round() / 100.0;
    points.iter().map(|p| json!([two(p.0), two(p.1)])).collect()
}

/// Nine letters in reading order.
pub(super) fn letters(face: &FaceSighting) -> String {
    face.colours.iter().map(|&c| LETTERS[usize::from(c)]).collect()
}

fn face_json(face: &FaceSighting) -> Value {
    let share = |v: f64| (v * 1000.0).round() / 1000.0;
    let c = &face.centres;
    json!({
        "corners": rounded(&[c[0], c[2], c[8], c[6]]),
        "centres": rounded(c),
        "outline": rounded(&face.corners),
        "colours": letters(face),
        "confidence": share(face.confidence),
        "tile_confidence": face.confidences.map(share),
    })
}

/// `vision face IMAGE...`: the faces of each picture, or why there are none; one line a picture with `json`.
/// A file that is no picture gets its line too; the flag is false when any picture showed no face.
#[must_use]
pub fn face(images: &[impl AsRef<Path>], json: bool) -> (String, bool) {
    let (mut text, mut all) = (String::new(), true);
    for path in images {
        let name = path.as_ref().display().to_string();
        let found = load(path.as_ref()).and_then(|image| {
            detect(&image, None, &DetectorSettings::default()).map_err(|refusal| anyhow!(refusal))
        });
        all &= found.is_ok();
        // Writing to a string cannot fail.
        let _ = match (&found, json) {
            (Ok(faces), true) => {
                let faces: Vec<Value> = faces.iter().map(face_json).collect();
                writeln!(text, "{}", json!({ "image": name, "faces": faces }))
            }
            (Err(reason), true) => {
                let reason = format!("{reason:#}");
                writeln!(text, "{}", json!({ "image": name, "faces": [], "reason": reason }))
            }
            (Err(reason), false) => writeln!(text, "{name}: {reason:#}"),
            (Ok(faces), false) => faces.iter().enumerate().try_for_each(|(i, f)| {
                let c = letters(f);
                let weakest = f.confidences.iter().copied().fold(1.0, f64::min);
                let at = f.centres[4];
                writeln!(
                    text,
                    "{name}: face {} of {}: {} / {} / {}  centre {:.0},{:.0} px, width {:.0} px, confidence {:.2}, least certain tile {weakest:.2}",
                    i + 1,
                    faces.len(),
                    &c[0..3],
                    &c[3..6],
                    &c[6..9],
                    at.0,
                    at.1,
                    f.width_px(),
                    f.confidence,
                )
            }),
        };
    }
    (text, all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_no_picture_gets_a_line_with_the_reason() {
        let (text, all) = face(&["Cargo.toml", "no/such.png"], true);

        let lines: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        assert!(!all);
        assert_eq!(lines.len(), 2);
        assert!(lines.iter().all(|l| l["reason"].is_string()), "{text}");
    }
}
