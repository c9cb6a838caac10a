//! `rubik-robot vision face`: finds the faces of cubes in pictures and reads their colours.
//!
//! - in: picture files
//! - out: a line for each face, or a line of JSON for each picture

use super::image_file::load;
use super::output::{code_of, line_about};
use crate::vision::colours::{LETTERS, is_colourless};
use crate::vision::{DetectorSettings, FaceSighting, detect};
use anyhow::anyhow;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// Returns points as JSON with two decimals (px), which is finer than the detector measures.
fn rounded(points: &[(f64, f64)]) -> Value {
    let two = |v: f64| (v * 100.0).round() / 100.0;
    points.iter().map(|p| json!([two(p.0), two(p.1)])).collect()
}

/// Returns the nine letters of a face in reading order.
pub(super) fn letters(face: &FaceSighting) -> String {
    face.colours.iter().map(|&c| LETTERS[usize::from(c)]).collect()
}

/// Returns the reason why the colours of the faces have no meaning, if there is one.
fn no_colour(faces: &[FaceSighting]) -> Option<&'static str> {
    // A picture with a coloured face is not black and white.
    let colourless = !faces.is_empty() && faces.iter().all(|face| is_colourless(&face.rgb));
    colourless.then_some("no colour: the picture is black and white")
}

/// Returns a face as JSON.
fn face_json(face: &FaceSighting) -> Value {
    let share = |v: f64| (v * 1000.0).round() / 1000.0;
    // `corners` are the centres of the corner tiles, as in a manifest; `outline` is the whole face.
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

/// Returns the faces of each picture, or the reason why there are none, and the exit code. A file
/// that is no picture gets a line as well. The faces of a black and white picture come with the
/// reason why their colours have no meaning.
#[must_use]
pub(super) fn face(images: &[impl AsRef<Path>], json: bool) -> (String, u8) {
    let (mut text, mut code) = (String::new(), 0);
    for path in images {
        let name = path.as_ref().display().to_string();
        let found = load(path.as_ref()).map_err(anyhow::Error::from).and_then(|image| {
            detect(&image, None, &DetectorSettings::default()).map_err(|refusal| anyhow!(refusal))
        });
        // After a picture without a face the next ones are still read.
        code = code.max(found.as_ref().err().map_or(0, code_of));
        // Writing to a string cannot fail.
        let _ = match (&found, json) {
            (Ok(faces), true) => {
                let found: Vec<Value> = faces.iter().map(face_json).collect();
                let mut line = json!({ "image": name, "faces": found });
                if let Some(reason) = no_colour(faces) {
                    line["reason"] = reason.into();
                }
                writeln!(text, "{line}")
            }
            (Err(reason), true) => {
                let reason = format!("{reason:#}");
                writeln!(text, "{}", json!({ "image": name, "faces": [], "reason": reason }))
            }
            (Err(reason), false) => writeln!(text, "{}", line_about(&name, reason)),
            (Ok(faces), false) => faces.iter().enumerate().try_for_each(|(i, f)| {
                let c = letters(f);
                let weakest = f.confidences.iter().copied().fold(1.0, f64::min);
                let at = f.centres[4];
                let doubt = no_colour(faces).map(|reason| format!("; {reason}"));
                writeln!(
                    text,
                    "{name}: face {} of {}: {} / {} / {}  centre {:.0},{:.0} px, width {:.0} px, \
                     confidence {:.2}, least certain tile {weakest:.2}{}",
                    i + 1,
                    faces.len(),
                    &c[0..3],
                    &c[3..6],
                    &c[6..9],
                    at.0,
                    at.1,
                    f.width_px(),
                    f.confidence,
                    doubt.unwrap_or_default(),
                )
            }),
        };
    }
    (text, code)
}

#[cfg(test)]
mod tests {
    use super::super::image_file::decode;
    use super::super::image_file::tests::{Written, bytes};
    use super::*;
    use image::imageops::FilterType;
    use image::{DynamicImage, ImageFormat, Rgb, RgbImage};

    #[test]
    fn unreadable_file_gets_a_line_with_reason() {
        let (text, code) = face(&["Cargo.toml", "no/such.png"], true);

        let lines: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        assert_eq!((code, lines.len()), (2, 2));
        assert!(lines.iter().all(|l| l["reason"].is_string()), "{text}");
        let (text, _) = face(&["no/such.png"], false);
        assert_eq!(text, "cannot read no/such.png: there is no such file\n");
    }

    #[test]
    fn a_picture_of_one_pixel_is_too_small() {
        let pixel = bytes(&DynamicImage::new_rgb8(1, 1), ImageFormat::Png);

        let (line, code) = face(&[&Written::new("one.png", &pixel).0], true);

        assert!(code == 1 && line.contains("only 1x1 px"), "{line}");
    }

    #[test]
    fn face_of_a_grey_picture_reports_no_colour() {
        let tiles = include_bytes!("../../tests/corpus/image/nine-tiles.png");
        // At its original size the face without colours is too small to be detected.
        let tiles = DynamicImage::from(decode(tiles).unwrap());
        // Blurred edges, because sharp ones are those of a program's painting.
        let coloured = tiles.resize_exact(160, 160, FilterType::Triangle);
        let grey = DynamicImage::from(coloured.to_luma8());
        let line = |name: &str, picture: &DynamicImage| {
            let file = Written::new(name, &bytes(picture, ImageFormat::Png));
            let (line, code) = face(&[&file.0], true);
            assert_eq!(code, 0, "{line}");
            (serde_json::from_str::<Value>(&line).unwrap(), face(&[&file.0], false).0)
        };

        let (json, text) = line("grey.png", &grey);
        assert!(json["reason"].as_str().unwrap().starts_with("no colour"), "{json}");
        assert_eq!(json["faces"][0]["tile_confidence"], json!(vec![0.0; 9]));
        assert!(text.contains("no colour"), "{text}");
        let (json, text) = line("coloured.png", &coloured);
        assert!(json["reason"].is_null() && !text.contains("no colour"), "{json}");
    }

    proptest::proptest! {
        #![proptest_config(proptest::prelude::ProptestConfig::with_cases(48))]
        #[test]
        fn corrupted_picture_does_not_panic(
            noise in proptest::collection::vec(proptest::prelude::any::<u8>(), 0..200),
            at in 0usize..400, keep in 0usize..800, jpeg in proptest::prelude::any::<bool>(),
        ) {
            let colour = |x: u32, y: u32| Rgb([(x * 9) as u8, (y * 11) as u8, 90]);
            let picture = RgbImage::from_fn(24, 20, colour);
            let format = if jpeg { ImageFormat::Jpeg } else { ImageFormat::Png };
            let mut bytes = bytes(&picture.into(), format);
            let at = at.min(bytes.len());
            let end = (at + noise.len()).min(bytes.len());
            bytes[at..end].copy_from_slice(&noise[..end - at]);
            bytes.truncate(keep);

            let (line, _) = face(&[&Written::new("noise", &bytes).0], true);

            proptest::prop_assert_eq!(line.lines().count(), 1);
        }
    }
}
