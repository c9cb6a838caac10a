//! `vision colours` and `vision scan`: read whole cubes, and print a line about each.
//!
//! - in: files of 54 measured colours, or pictures of the six faces
//! - out: a line of text or of JSON for each cube
//!
//! Facelets are named by their face and their number in reading order: U1 to U9, R1 to R9, and so
//! on for F, D, L and B.

use super::image_file::load;
use super::output::{WRONG, code_of};
use crate::hw::text;
use crate::vision::colours::{Decision, LETTERS, Undecided, decide_cube, face_letter};
use crate::vision::{DetectorSettings, FaceSighting, detect};
use anyhow::{Context, Result, anyhow, bail};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// Reason why a cube was not read.
#[derive(Debug)]
pub(super) enum Refused {
    /// Colours from which no cube can be decided.
    Colours(Undecided),
    /// Unusable file or picture.
    Input(anyhow::Error),
    /// Unusable pictures of a cube: the reasons with the names of the files, and the exit code.
    Pictures(String, u8),
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

/// Margin ([`Decision::margins`]) of a facelet below which the likeliest cube contradicts the look
/// of its sticker. Right readings of photographs had margins of 0.05 and more, readings of wrongly
/// placed pictures less than 0.01.
const CONTRADICTED: f64 = 0.02;

/// Returns the name of a facelet (0 to 53, in the order URFDLB): 0 is `U1`, 53 is `B9`.
fn facelet_name(facelet: usize) -> String {
    format!("{}{}", face_letter(facelet / 9), facelet % 9 + 1)
}

/// Returns the names of facelets.
fn names(facelets: &[usize]) -> Vec<String> {
    facelets.iter().map(|&f| facelet_name(f)).collect()
}

/// Returns the 54 letters of a cube, from the face (0 to 5 = URFDLB) of each facelet.
pub(super) fn face_letters(facelets: &[u8; 54]) -> String {
    facelets.iter().map(|&f| face_letter(usize::from(f))).collect()
}

/// Returns the variant name of an error as one word for programs: `CornerTwisted` becomes
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

/// Line about a cube, as text and as JSON.
struct Line {
    /// Text after the name of the file.
    text: String,
    /// Same content for programs, without the name of the file.
    json: Value,
    /// Exit code: 0 if the cube was read.
    code: u8,
    /// Whether `text` names the file already.
    names_file: bool,
}

impl Line {
    /// Makes the line of a cube that was read. `correction` says which of its pictures were turned,
    /// exchanged or mirrored, if any.
    fn of_reading(decision: &Decision, correction: Option<&str>) -> Self {
        let facelets = face_letters(&decision.facelets);
        let weakest = decision.margins.iter().copied().fold(1.0, f64::min);
        let doubtful = names(&decision.doubtful);
        let colours: String = decision.colours.iter().map(|&c| LETTERS[usize::from(c)]).collect();
        // The margins mean nothing beyond three decimals.
        let round = |v: f64| (v * 1000.0).round() / 1000.0;
        let mut json = json!({ "facelets": facelets, "colours": colours,
            "margins": decision.margins.map(round).to_vec(), "doubtful": doubtful });
        let mut text = format!("{facelets}  least margin {weakest:.2}");
        if !doubtful.is_empty() {
            let _ = write!(text, ", doubtful: {}", doubtful.join(" "));
        }
        if let Some(correction) = correction {
            json["correction"] = correction.into();
            let _ = write!(text, "; put right: {correction}");
        }
        Self { text, json, code: 0, names_file: false }
    }

    /// Makes the line of a refusal that shows the colours that were read and the `doubtful`
    /// facelets, so that a person can find the wrong stickers. `kind` is the reason as a word for
    /// programs.
    fn of_impossible(reason: &str, kind: &str, facelets: &[u8; 54], doubtful: &[usize]) -> Self {
        let (read, doubtful) = (face_letters(facelets), names(doubtful));
        Self {
            text: format!("{reason}; read {read}; check {}", doubtful.join(" ")),
            json: json!({ "reason": reason, "refusal": kind, "read": read, "doubtful": doubtful }),
            code: 1,
            names_file: false,
        }
    }

    /// Makes the line of a refusal without facelets. `kind` is the reason as a word for programs.
    fn of_refusal(reason: &str, kind: &str) -> Self {
        let json = json!({ "reason": reason, "refusal": kind });
        Self { text: reason.to_owned(), json, code: 1, names_file: false }
    }

    /// Makes the line about a cube. `decided` has its colours, or the reason why there are none.
    fn of(decided: &std::result::Result<Decision, Refused>) -> Self {
        match decided {
            // Rule 1: a cube that contradicts what a sticker looks like is a guess, not a reading.
            Ok(cube) if cube.margins.iter().any(|&margin| margin < CONTRADICTED) => {
                let contradicted: Vec<usize> =
                    (0..54).filter(|&i| cube.margins[i] < CONTRADICTED).collect();
                let reason = "no cube fits all stickers, this is the likeliest";
                Self::of_impossible(reason, "contradicted", &cube.facelets, &contradicted)
            }
            Ok(cube) => Self::of_reading(cube, None),
            // Rule 2: pictures that were turned, exchanged or mirrored are put right, and rule 1
            // holds for the result.
            Err(Refused::Colours(Undecided::Misplaced { placement, decision })) => {
                match Self::of(&Ok((**decision).clone())) {
                    Self { code: 0, .. } => {
                        Self::of_reading(decision, Some(&placement.to_string()))
                    }
                    refused => refused,
                }
            }
            // Rule 3: the line of an impossible cube shows the colours that were read.
            Err(Refused::Colours(Undecided::Impossible { reason, facelets, doubtful })) => {
                let told = format!("this cube cannot exist: {reason}");
                Self::of_impossible(&told, &kind(reason), facelets, doubtful)
            }
            // Rule 4: a file or picture without a cube has no facelets to print.
            Err(Refused::Input(reason)) => {
                let code = code_of(reason);
                let refusal = Self::of_refusal(&format!("{reason:#}"), "input");
                Self { code, names_file: code == WRONG, ..refusal }
            }
            Err(Refused::Pictures(reasons, code)) => {
                Self { code: *code, names_file: true, ..Self::of_refusal(reasons, "input") }
            }
            Err(Refused::Colours(reason)) => Self::of_refusal(&reason.to_string(), &kind(reason)),
        }
    }
}

/// Returns the line about a cube, as text or JSON, and the exit code. `name` is the name of the
/// cube's file or pictures; `decided` has its colours, or the reason why there are none.
pub(super) fn report(
    name: &str,
    decided: &std::result::Result<Decision, Refused>,
    json: bool,
) -> (String, u8) {
    let mut line = Line::of(decided);
    let text = if json {
        line.json["file"] = name.into();
        line.json.to_string()
    } else if line.names_file {
        line.text
    } else {
        format!("{name}: {}", line.text)
    };
    (text + "\n", line.code)
}

/// Returns whether [`report`] has a cube to tell, and not a reason why there is none.
pub(super) fn is_read(decided: &std::result::Result<Decision, Undecided>) -> bool {
    Line::of(&decided.clone().map_err(Refused::from)).code == 0
}

/// Number of the first square of each face, in the order URFDLB. A file of measured squares has the
/// order U, L, F, R, B, D.
const FIRST_SQUARE: [usize; 6] = [1, 28, 19, 46, 10, 37];

/// Parses a JSON file that maps the numbers of 54 squares to measured colours (RGB, 0 to 255).
/// Returns the colours in the order URFDLB.
///
/// # Errors
/// Missing or wrong square.
pub fn measured_squares(text: &str) -> Result<[[f64; 3]; 54]> {
    let squares: BTreeMap<String, [f64; 3]> =
        serde_json::from_str(text).context("must be {\"1\": [r, g, b], ... \"54\": [r, g, b]}")?;
    // The loop below finds a missing square, but no surplus one.
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

/// Returns a line about the cube of each file of 54 measured colours, and the exit code.
#[must_use]
pub fn colours(files: &[impl AsRef<Path>], json: bool) -> (String, u8) {
    let (mut text, mut code) = (String::new(), 0);
    for path in files {
        let decided = || -> std::result::Result<Decision, Refused> {
            let text = text::read(path.as_ref(), text::SCENARIO).map_err(anyhow::Error::from)?;
            Ok(decide_cube(&measured_squares(&text)?)?)
        };
        let (line, outcome) = report(&path.as_ref().display().to_string(), &decided(), json);
        text += &line;
        code = code.max(outcome);
    }
    (text, code)
}

/// Returns the main face of a picture: the widest of those with at least 0.8 times the best
/// confidence. The faces are sorted, the most certain one first.
pub(super) fn dominant(mut faces: Vec<FaceSighting>) -> Option<FaceSighting> {
    let best = faces.first()?.confidence;
    // A face in the background may be nearly as certain, but it is smaller.
    faces.retain(|f| f.confidence >= 0.8 * best);
    faces.into_iter().max_by(|a, b| a.width_px().total_cmp(&b.width_px()))
}

/// Reads a cube from pictures of its faces U, R, F, D, L, B. Returns the line about it, as text or
/// JSON, and the exit code. Each face is upright, as in the usual net: U above F, D below F.
#[must_use]
pub(crate) fn scan(images: &[impl AsRef<Path>], json: bool) -> (String, u8) {
    let (mut faults, mut code) = (String::new(), 0);
    let mut decided = || -> std::result::Result<Decision, Refused> {
        if images.len() != 6 {
            return Err(anyhow!("{} pictures instead of six, U R F D L B", images.len()).into());
        }
        let mut rgb = [[0.0; 3]; 54];
        for (face, path) in images.iter().enumerate() {
            let path = path.as_ref();
            let sighting = load(path).map_err(anyhow::Error::from).and_then(|image| {
                let faces = detect(&image, None, &DetectorSettings::default());
                let face = faces.map_err(|r| anyhow!("{}: {r}", path.display()))?;
                dominant(face).ok_or_else(|| anyhow!("{}: no face was found", path.display()))
            });
            match sighting {
                Ok(sighting) => rgb[9 * face..9 * face + 9].copy_from_slice(&sighting.rgb),
                // All pictures are read, so that the error names each one that must be taken
                // again.
                Err(reason) => {
                    code = code.max(code_of(&reason));
                    let between = if faults.is_empty() { "" } else { "; " };
                    let _ = write!(faults, "{between}face {}: {reason:#}", face_letter(face));
                }
            }
        }
        if !faults.is_empty() {
            return Err(Refused::Pictures(faults.clone(), code));
        }
        Ok(decide_cube(&rgb)?)
    };
    let decided = decided();
    let names: Vec<String> = images.iter().map(|p| p.as_ref().display().to_string()).collect();
    report(&names.join(" "), &decided, json)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::{Cube, Facelets};

    /// Returns the text of a file of 54 colours, as measured in even light on a cube with these
    /// facelets.
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
    fn measured_squares_are_reordered_to_urfdlb_faces() {
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

    /// The line about a possible cube has its facelets, that about an impossible one the reason as
    /// one word.
    #[test]
    fn report_gives_facelets_or_reason_of_refusal() {
        let truth = *Facelets::from(&Cube::scrambled(4)).colours();
        let mut flipped = truth;
        flipped.swap(5, 10);

        let read = |facelets| {
            let rgb = measured_squares(&file(facelets)).unwrap();
            report("x.json", &decide_cube(&rgb).map_err(Refused::from), true)
        };

        let (line, code) = read(&truth);
        let line: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(code, 0);
        assert_eq!(line["facelets"], face_letters(&truth));
        let (line, code) = read(&flipped);
        let line: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(code, 1);
        assert_eq!(line["refusal"], "edge-flipped");
    }

    /// A turned picture is put right, and the line says so. A cube with a margin below
    /// [`CONTRADICTED`] is refused.
    #[test]
    fn report_names_corrected_pictures_and_contradictions() {
        let truth = *Facelets::from(&Cube::scrambled(4)).colours();
        let mut turned = truth;
        for tile in 0..9 {
            turned[18 + 3 * (tile % 3) + 2 - tile / 3] = truth[18 + tile];
        }
        let rgb = measured_squares(&file(&turned)).unwrap();

        let (line, code) = report("x.json", &decide_cube(&rgb).map_err(Refused::from), false);

        assert_eq!(code, 0, "{line}");
        assert!(line.contains(&face_letters(&truth)), "{line}");
        assert!(line.contains("put right: the picture of face F is turned clockwise"), "{line}");

        let mut guess = decide_cube(&measured_squares(&file(&truth)).unwrap()).unwrap();
        guess.margins[7] = 0.001;
        let (line, code) = report("x.json", &Ok(guess), true);
        let line: Value = serde_json::from_str(&line).unwrap();
        assert!(code == 1 && line.get("facelets").is_none(), "{line}");
        assert_eq!((&line["refusal"], &line["doubtful"]), (&json!("contradicted"), &json!(["U8"])));
    }

    #[test]
    fn scan_names_every_unreadable_picture() {
        let (text, code) = scan(&["a.png", "b.png", "c.png", "d.png", "e.png", "f.png"], false);

        assert_eq!((code, text.matches("a.png").count()), (2, 1), "{text}");
        for face in ["face U", "face R", "face F", "face D", "face L", "face B"] {
            assert!(text.contains(&format!("{face}: cannot read ")), "{text}");
        }
        assert_eq!(scan(&["a.png"], false).1, 1);
    }
}
