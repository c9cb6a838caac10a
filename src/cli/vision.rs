//! The vision commands as functions: files in, text or JSON lines out.
//!
//! `vision face`, `vision colours`, `vision score`: what the operator sees of [`crate::vision`].

use crate::cube::{Cube, Facelets};
use crate::vision::colours::{self, LETTERS, decide_cube, face_letter};
use crate::vision::{DetectorSettings, FaceSighting, detect};
use anyhow::{Context, Result, anyhow, bail};
use image::{ImageReader, RgbImage};
use serde_json::{Value, json};
use std::collections::BTreeMap;
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

/// Where the first square of each face is in the files of measured squares: faces U, L, F, R, B, D there,
/// URFDLB here.
const FIRST_SQUARE: [usize; 6] = [1, 28, 19, 46, 10, 37];

/// The 54 triples of a file, in the order URFDLB.
///
/// # Errors
/// What is missing.
pub fn measured_squares(text: &str) -> Result<[[f64; 3]; 54]> {
    let squares: BTreeMap<String, [f64; 3]> =
        serde_json::from_str(text).context("expected {\"1\": [r, g, b], ... \"54\": [r, g, b]}")?;
    if squares.len() != 54 {
        bail!("expected 54 squares, found {}", squares.len());
    }
    let mut rgb = [[0.0; 3]; 54];
    for (i, value) in rgb.iter_mut().enumerate() {
        let key = (FIRST_SQUARE[i / 9] + i % 9).to_string();
        *value = *squares.get(&key).ok_or_else(|| anyhow!("square {key} is missing"))?;
        if value.iter().any(|v| !(0.0..=255.0).contains(v)) {
            bail!("square {key}: {value:?} is not within 0..=255");
        }
    }
    Ok(rgb)
}

/// Whether a cube of these facelets (face 0..=5 = URFDLB each) can exist.
#[must_use]
pub fn can_exist(facelets: &[u8; 54]) -> bool {
    Facelets::try_from(*facelets).is_ok_and(|f| Cube::try_from(f).is_ok())
}

/// `vision colours FILE...`: the facelets (URFDLB) of each file of 54 measured squares. The flag is false when
/// a cube could not be decided.
#[must_use]
pub fn colours(files: &[impl AsRef<Path>], json: bool) -> (String, bool) {
    let (mut text, mut all) = (String::new(), true);
    for path in files {
        let name = path.as_ref().display().to_string();
        let decided = std::fs::read_to_string(path.as_ref())
            .map_err(anyhow::Error::from)
            .and_then(|text| measured_squares(&text))
            .and_then(|rgb| decide_cube(&rgb).map_err(anyhow::Error::from));
        all &= decided.is_ok();
        let _ = match decided {
            Ok(decision) => {
                let facelets: String =
                    decision.facelets.iter().map(|&f| face_letter(usize::from(f))).collect();
                let weakest = decision.margins.iter().copied().fold(1.0, f64::min);
                if json {
                    let names: String =
                        decision.colours.iter().map(|&c| LETTERS[usize::from(c)]).collect();
                    let margins = decision.margins.map(|m| (m * 1000.0).round() / 1000.0);
                    writeln!(
                        text,
                        "{}",
                        json!({ "file": name, "facelets": facelets, "colours": names,
                            "margins": margins.to_vec(), "doubtful": decision.doubtful })
                    )
                } else {
                    writeln!(
                        text,
                        "{name}: {facelets}  least margin {weakest:.2}, doubtful: {}",
                        decision.doubtful.len()
                    )
                }
            }
            Err(reason) if json => {
                writeln!(text, "{}", json!({ "file": name, "reason": format!("{reason:#}") }))
            }
            Err(reason) => writeln!(text, "{name}: {reason:#}"),
        };
    }
    (text, all)
}

/// The names of the six colours, for help texts.
pub const COLOUR_LETTERS: [char; 6] = colours::LETTERS;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_are_taken_in_the_order_of_their_faces() {
        let text = serde_json::to_string(
            &(1..=54)
                .map(|k| (k.to_string(), [f64::from(k), 0.0, 0.0]))
                .collect::<BTreeMap<_, _>>(),
        )
        .unwrap();

        let rgb = measured_squares(&text).unwrap();

        // URFDLB: U is 1.., R is 28.., F is 19.., D is 46.., L is 10.., B is 37...
        assert_eq!([0, 9, 18, 27, 36, 45].map(|i| rgb[i][0]), [1.0, 28.0, 19.0, 46.0, 10.0, 37.0]);
    }

    #[test]
    fn a_missing_square_is_named() {
        let mut squares: BTreeMap<String, [f64; 3]> =
            (1..=53).map(|k| (k.to_string(), [0.0; 3])).collect();
        squares.insert("x".into(), [0.0; 3]);

        let error = measured_squares(&serde_json::to_string(&squares).unwrap()).unwrap_err();

        assert_eq!(error.to_string(), "square 54 is missing");
    }

    #[test]
    fn a_file_that_is_no_picture_gets_a_line_with_the_reason() {
        let (text, all) = face(&["Cargo.toml", "no/such.png"], true);

        let lines: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        assert!(!all);
        assert_eq!(lines.len(), 2);
        assert!(lines.iter().all(|l| l["reason"].is_string()), "{text}");
    }
}
