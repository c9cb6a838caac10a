//! `vision colours` and `vision scan`: reads whole cubes; and the line about a cube.
//!
//! - in: files of 54 measured colours, or pictures of the six faces
//! - out: a line of text or of JSON for each cube
//!
//! Facelets are named by face and number in reading order: U1..U9, R1.., F, D, L, B.

use super::image_file::load;
use crate::hw::text;
use crate::vision::colours::{Decision, LETTERS, Undecided, decide_cube, face_letter};
use crate::vision::{DetectorSettings, FaceSighting, detect};
use anyhow::{Context, Result, anyhow, bail};
use serde_json::json;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// Reason why a cube was not read.
#[derive(Debug)]
pub(super) enum Refused {
    /// Colours that decide no cube.
    Colours(Undecided),
    /// Unusable file or picture.
    Input(anyhow::Error),
}

impl From<Undecided> for Refused {
    fn from(reason: Undecided) -> Self {
        Self::Colours(reason)
    }
}

impl From<anyhow::Error> for Refused {
    fn from(reason: anyhow::Error) -> Self {
        Self::Input(reason)
    }
}

/// Returns the name of a facelet: `U1`.
fn facelet_name(facelet: usize) -> String {
    format!("{}{}", face_letter(facelet / 9), facelet % 9 + 1)
}

/// Returns the names of facelets.
fn names(facelets: &[usize]) -> Vec<String> {
    facelets.iter().map(|&f| facelet_name(f)).collect()
}

/// Returns the 54 letters of a cube.
pub(super) fn face_letters(facelets: &[u8; 54]) -> String {
    facelets.iter().map(|&f| face_letter(usize::from(f))).collect()
}

/// Returns the name of an error's variant as one word for programs: `CornerTwisted` becomes
/// `corner-twisted`.
fn kind(reason: &impl std::fmt::Debug) -> String {
    // The word follows from the name of the variant, so it needs no table that could lack one.
    let name = format!("{reason:?}");
    let mut word = String::new();
    for (i, c) in name.chars().take_while(|c| c.is_alphanumeric()).enumerate() {
        if c.is_uppercase() && i > 0 {
            word.push('-');
        }
        word.extend(c.to_lowercase());
    }
    word
}

/// Returns the line about a cube, and whether the cube was read.
pub(super) fn report(
    name: &str,
    decided: std::result::Result<Decision, Refused>,
    json: bool,
) -> (String, bool) {
    // Three decimals are more than the margins are worth.
    let round = |v: f64| (v * 1000.0).round() / 1000.0;
    let (line, read) = match decided {
        Ok(decision) => {
            let facelets = face_letters(&decision.facelets);
            let weakest = decision.margins.iter().copied().fold(1.0, f64::min);
            let doubtful = names(&decision.doubtful);
            let line = if json {
                let colours: String =
                    decision.colours.iter().map(|&c| LETTERS[usize::from(c)]).collect();
                json!({ "file": name, "facelets": facelets, "colours": colours,
                    "margins": decision.margins.map(round).to_vec(), "doubtful": doubtful })
                .to_string()
            } else if doubtful.is_empty() {
                format!("{name}: {facelets}  least margin {weakest:.2}")
            } else {
                let doubtful = doubtful.join(" ");
                format!("{name}: {facelets}  least margin {weakest:.2}, doubtful: {doubtful}")
            };
            (line, true)
        }
        // Rule 1: a file or picture without a cube has no facelets to print.
        Err(Refused::Input(reason)) => {
            let line = if json {
                json!({ "file": name, "reason": format!("{reason:#}"), "refusal": "input" })
                    .to_string()
            } else {
                format!("{name}: {reason:#}")
            };
            (line, false)
        }
        // Rule 2: an impossible cube prints what was read, so that the wrong sticker can be found.
        Err(Refused::Colours(Undecided::Impossible { reason, facelets, doubtful })) => {
            let (read, doubtful) = (face_letters(&facelets), names(&doubtful));
            let line = if json {
                json!({ "file": name, "reason": format!("this cube cannot exist: {reason}"),
                    "refusal": kind(&reason), "read": read, "doubtful": doubtful })
                .to_string()
            } else {
                format!(
                    "{name}: this cube cannot exist: {reason}; read {read}; check {}",
                    doubtful.join(" ")
                )
            };
            (line, false)
        }
        // Rule 3: any other refusal has only its reason.
        Err(Refused::Colours(reason)) => {
            let line = if json {
                json!({ "file": name, "reason": reason.to_string(), "refusal": kind(&reason) })
                    .to_string()
            } else {
                format!("{name}: {reason}")
            };
            (line, false)
        }
    };
    (line + "\n", read)
}

/// Number of the first square of each face, in the order URFDLB. A file of measured squares has the
/// order U, L, F, R, B, D.
const FIRST_SQUARE: [usize; 6] = [1, 28, 19, 46, 10, 37];

/// Parses the 54 colours of a file; returns them in the order URFDLB.
///
/// # Errors
/// Missing or wrong square.
pub fn measured_squares(text: &str) -> Result<[[f64; 3]; 54]> {
    let squares: BTreeMap<String, [f64; 3]> =
        serde_json::from_str(text).context("must be {\"1\": [r, g, b], ... \"54\": [r, g, b]}")?;
    // A missing square would be found below, but not a surplus one.
    if squares.len() != 54 {
        bail!("the file has {} squares instead of 54", squares.len());
    }
    let mut rgb = [[0.0; 3]; 54];
    for (i, value) in rgb.iter_mut().enumerate() {
        let key = (FIRST_SQUARE[i / 9] + i % 9).to_string();
        *value = *squares.get(&key).ok_or_else(|| anyhow!("colour of square {key} is missing"))?;
        if value.iter().any(|v| !(0.0..=255.0).contains(v)) {
            bail!("colour of square {key}: {value:?} must be from 0 to 255");
        }
    }
    Ok(rgb)
}

/// Returns a line about the cube of each file of 54 measured colours, and whether all cubes were
/// read.
#[must_use]
pub fn colours(files: &[impl AsRef<Path>], json: bool) -> (String, bool) {
    let (mut text, mut all) = (String::new(), true);
    for path in files {
        let decided = || -> std::result::Result<Decision, Refused> {
            let text = text::read(path.as_ref(), text::SCENARIO).map_err(anyhow::Error::from)?;
            Ok(decide_cube(&measured_squares(&text)?)?)
        };
        let (line, read) = report(&path.as_ref().display().to_string(), decided(), json);
        text += &line;
        all &= read;
    }
    (text, all)
}

/// Returns the main face of a picture: the widest of those with at least 0.8 times the best
/// confidence.
fn dominant(mut faces: Vec<FaceSighting>) -> Option<FaceSighting> {
    let best = faces.first()?.confidence;
    // A face in the background may be nearly as certain, but it is smaller.
    faces.retain(|f| f.confidence >= 0.8 * best);
    faces.into_iter().max_by(|a, b| a.width_px().total_cmp(&b.width_px()))
}

/// Returns the line about a cube from pictures of its faces U, R, F, D, L, B, and whether the cube
/// was read. Each face is upright, as in the usual net.
#[must_use]
pub(crate) fn scan(images: &[impl AsRef<Path>], json: bool) -> (String, bool) {
    let mut faults = String::new();
    let decided = || -> std::result::Result<Decision, Refused> {
        if images.len() != 6 {
            return Err(anyhow!("{} pictures instead of six, U R F D L B", images.len()).into());
        }
        let mut rgb = [[0.0; 3]; 54];
        for (face, path) in images.iter().enumerate() {
            let path = path.as_ref();
            let sighting = load(path).and_then(|image| {
                let faces = detect(&image, None, &DetectorSettings::default());
                let face = faces.map_err(|r| anyhow!("{}: {r}", path.display()))?;
                dominant(face).ok_or_else(|| anyhow!("{}: no face was found", path.display()))
            });
            match sighting {
                Ok(sighting) => rgb[9 * face..9 * face + 9].copy_from_slice(&sighting.rgb),
                // All pictures are read, so that the error names each one that must be taken
                // again.
                Err(reason) => {
                    let between = if faults.is_empty() { "" } else { "; " };
                    let _ = write!(faults, "{between}face {}: {reason:#}", face_letter(face));
                }
            }
        }
        if !faults.is_empty() {
            return Err(anyhow!(faults).into());
        }
        Ok(decide_cube(&rgb)?)
    };
    let decided = decided();
    let names: Vec<String> = images.iter().map(|p| p.as_ref().display().to_string()).collect();
    report(&names.join(" "), decided, json)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::{Cube, Facelets};
    use serde_json::Value;

    /// Returns the file of a cube with these facelets, in even light.
    fn file(facelets: &[u8; 54]) -> String {
        const STICKERS: [[f64; 3]; 6] = [
            [235.0, 235.0, 235.0],
            [183.0, 18.0, 52.0],
            [0.0, 155.0, 72.0],
            [255.0, 213.0, 0.0],
            [255.0, 88.0, 0.0],
            [0.0, 70.0, 173.0],
        ];
        let squares: BTreeMap<String, [f64; 3]> = (0..54)
            .map(|i| {
                let key = FIRST_SQUARE[i / 9] + i % 9;
                (key.to_string(), STICKERS[usize::from(facelets[i])])
            })
            .collect();
        serde_json::to_string(&squares).unwrap()
    }

    #[test]
    fn measured_squares_follow_the_order_of_faces() {
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
    fn error_names_the_missing_square() {
        let mut squares: BTreeMap<String, [f64; 3]> =
            (1..=53).map(|k| (k.to_string(), [0.0; 3])).collect();
        squares.insert("x".into(), [0.0; 3]);

        let error = measured_squares(&serde_json::to_string(&squares).unwrap()).unwrap_err();

        assert_eq!(error.to_string(), "colour of square 54 is missing");
    }

    /// A possible cube gives its facelets, an impossible one gives the reason as one word.
    #[test]
    fn report_names_facelets_or_the_refusal() {
        let truth = *Facelets::from(&Cube::scrambled(4)).colours();
        let mut flipped = truth;
        flipped.swap(5, 10);

        let read = |facelets| {
            let rgb = measured_squares(&file(facelets)).unwrap();
            report("x.json", decide_cube(&rgb).map_err(Refused::from), true)
        };

        let (line, ok) = read(&truth);
        let line: Value = serde_json::from_str(&line).unwrap();
        assert!(ok);
        assert_eq!(line["facelets"], face_letters(&truth));
        let (line, ok) = read(&flipped);
        let line: Value = serde_json::from_str(&line).unwrap();
        assert!(!ok);
        assert_eq!(line["refusal"], "edge-flipped");
    }

    #[test]
    fn scan_names_every_unreadable_picture() {
        let (text, ok) = scan(&["a.png", "b.png", "c.png", "d.png", "e.png", "f.png"], false);

        assert!(!ok);
        for face in ["face U", "face R", "face F", "face D", "face L", "face B"] {
            assert!(text.contains(face), "{text}");
        }
        assert!(!scan(&["a.png"], false).1);
    }
}
