//! `rubik-robot vision rig` and `vision learn`: read whole cubes in a rig with fixed cameras, and
//! learn the colours of the rig.
//!
//! - in: pictures; a file of boxes with a line for each facelet (faces URFDLB, each in reading
//!   order): one or more boxes `x y width height` (px) that show the facelet
//! - out: the facelets of each cube; or a table with the colours of the rig, learnt from cubes of
//!   known state

use super::cubes::{Refused, report};
use super::image_file::load;
use crate::cube::Cube;
use crate::hw::text;
use crate::vision::colours::{Decision, decide_cube, face_letter};
use crate::vision::table::{ColourTable, KnownCube};
use anyhow::{Context, Result, anyhow, bail};
use image::RgbImage;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Places of each facelet in the picture: boxes `[x, y, width, height]` (px).
pub(crate) type Boxes = [Vec<[u32; 4]>; 54];

/// Parses a file of boxes.
///
/// # Errors
/// Number and text of the wrong line.
pub(crate) fn parse_boxes(text: &str) -> Result<Boxes> {
    let lines: Vec<&str> = text.lines().filter(|l| !l.trim().is_empty()).collect();
    if lines.len() != 54 {
        bail!("the file has {} lines instead of 54, one for each facelet", lines.len());
    }
    let mut boxes: Boxes = std::array::from_fn(|_| Vec::new());
    for (i, line) in lines.iter().enumerate() {
        let numbers = line
            .split_whitespace()
            .map(str::parse)
            .collect::<std::result::Result<Vec<u32>, _>>()
            .with_context(|| format!("line {}: {line:?}", i + 1))?;
        // A box without an area would give a facelet without pixels.
        let (chunks, rest) = numbers.as_chunks::<4>();
        if chunks.is_empty() || !rest.is_empty() || chunks.iter().any(|b| b[2] == 0 || b[3] == 0) {
            bail!(
                "line {}: {line:?} is not a list of boxes: write x y width height of each",
                i + 1
            );
        }
        boxes[i] = chunks.to_vec();
    }
    Ok(boxes)
}

/// Returns the RGB values of the pixels in the boxes of each facelet.
///
/// # Errors
/// A box outside the picture.
pub(crate) fn measure(image: &RgbImage, boxes: &Boxes) -> Result<[Vec<[u8; 3]>; 54]> {
    let mut pixels: [Vec<[u8; 3]>; 54] = std::array::from_fn(|_| Vec::new());
    for (facelet, (pixels, boxes)) in pixels.iter_mut().zip(boxes).enumerate() {
        for &[x, y, width, height] in boxes {
            // Numbers of a file may be so large that their sum overflows.
            let inside = |start: u32, length: u32, all: u32| {
                start.checked_add(length).is_some_and(|end| end <= all)
            };
            if !inside(x, width, image.width()) || !inside(y, height, image.height()) {
                bail!(
                    "facelet {facelet}: box {x} {y} {width} {height} is outside the picture of \
                     {} x {} px",
                    image.width(),
                    image.height()
                );
            }
            // Boxes of one facelet are pooled: a sticker may show in several places of the picture.
            for row in y..y + height {
                pixels.extend((x..x + width).map(|column| image.get_pixel(column, row).0));
            }
        }
    }
    Ok(pixels)
}

/// Returns the mean colour of the pixels whose brightness is between the quartiles, which leaves
/// out glare and grooves.
fn trimmed(pixels: &mut [[u8; 3]]) -> [f64; 3] {
    pixels.sort_by_key(|p| p.iter().map(|&v| u32::from(v)).sum::<u32>());
    // Glare makes the brightest pixels, grooves make the darkest.
    let middle = &pixels[pixels.len() / 4..(3 * pixels.len()).div_ceil(4)];
    std::array::from_fn(|c| {
        middle.iter().map(|p| f64::from(p[c])).sum::<f64>() / middle.len() as f64
    })
}

/// Returns the colours of the 54 facelets in a picture.
fn facelet_colours(image: &Path, boxes: &Boxes) -> Result<[[f64; 3]; 54]> {
    let picture = load(image)?;
    let mut pixels = measure(&picture, boxes).with_context(|| format!("{}", image.display()))?;
    Ok(std::array::from_fn(|i| trimmed(&mut pixels[i])))
}

/// Reads a file of boxes.
fn read_boxes(path: &Path) -> Result<Boxes> {
    let text = text::read(path, text::SCENARIO)?;
    parse_boxes(&text).with_context(|| format!("{}", path.display()))
}

/// Reads and checks a table that [`learn`] wrote.
///
/// # Errors
/// Error of the file, with its path.
fn read_table(path: &Path) -> Result<ColourTable> {
    let name = || format!("{}", path.display());
    let text = text::read(path, text::LIST)?;
    let table: ColourTable = serde_json::from_str(&text).with_context(name)?;
    table.check().with_context(name)?;
    Ok(table)
}

/// Reads the cube of each picture; returns a line for each, and the exit code.
///
/// # Errors
/// Unusable file of boxes, or table.
pub(crate) fn rig(
    images: &[PathBuf],
    boxes: &Path,
    table: Option<&Path>,
    json: bool,
) -> Result<(String, u8)> {
    let boxes = read_boxes(boxes)?;
    let table = table.map(read_table).transpose()?;
    let (mut text, mut code) = (String::new(), 0);
    for image in images {
        // A cube that cannot be read gets a line and does not end the others.
        let decided = || -> std::result::Result<Decision, Refused> {
            let rgb = facelet_colours(image, &boxes)?;
            Ok(match &table {
                Some(table) => table.decide(&rgb)?,
                None => decide_cube(&rgb)?,
            })
        };
        let (line, outcome) = report(&image.display().to_string(), &decided(), json);
        text += &line;
        code = code.max(outcome);
    }
    Ok((text, code))
}

/// Parses lines of a picture's file name and its 54 facelets (URFDLB).
fn parse_states(text: &str) -> Result<BTreeMap<String, String>> {
    let mut states = BTreeMap::new();
    for (i, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [name, state] = words[..] else {
            bail!("line {}: {line:?} is not the name of a picture and 54 facelets", i + 1);
        };
        states.insert(name.to_owned(), state.to_owned());
    }
    Ok(states)
}

/// Parses the 54 letters of a possible cube. Returns the face (0 to 5 = URFDLB) of each facelet.
fn parse_state(text: &str) -> Result<[u8; 54]> {
    let mut facelets = [0u8; 54];
    if text.chars().count() != 54 {
        bail!("{text:?} is not 54 letters of URFDLB");
    }
    for (facelet, letter) in facelets.iter_mut().zip(text.chars()) {
        let face = (0..6).find(|&f| face_letter(f) == letter);
        *facelet = face.ok_or_else(|| anyhow!("{text:?}: {letter:?} is not one of URFDLB"))? as u8;
    }
    // A wrong state would teach wrong colours.
    if !Cube::is_possible(&facelets) {
        bail!("{text:?}: this cube cannot exist");
    }
    Ok(facelets)
}

/// Learns the colours of a rig from cubes of known state; returns the table as JSON. Without a file
/// of states, the name of each picture is its state.
///
/// # Errors
/// Unreadable file, or a state that no cube can have.
pub(crate) fn learn(images: &[PathBuf], boxes: &Path, states: Option<&Path>) -> Result<String> {
    let boxes = read_boxes(boxes)?;
    let states = match states {
        None => None,
        Some(path) => {
            let text = text::read(path, text::LIST)?;
            Some(parse_states(&text).with_context(|| format!("{}", path.display()))?)
        }
    };
    let mut known: Vec<KnownCube> = Vec::new();
    for image in images {
        let part = |name: Option<&std::ffi::OsStr>| {
            name.map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
        };
        // Without a list, the name of a picture is its state.
        let state = match &states {
            None => part(image.file_stem()),
            Some(states) => {
                let name = part(image.file_name());
                states.get(&name).cloned().ok_or_else(|| {
                    anyhow!("{name}: the file of --states has no line for this picture")
                })?
            }
        };
        let truth = parse_state(&state).with_context(|| format!("{}", image.display()))?;
        known.push((facelet_colours(image, &boxes)?, truth));
    }
    let table = ColourTable::learn(&known)?;
    Ok(serde_json::to_string(&table)? + "\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facelet_box_file_needs_54_valid_lines() {
        let good = "1 2 3 4 5 6 7 8\n".repeat(54);
        assert_eq!(parse_boxes(&good).unwrap()[53], [[1, 2, 3, 4], [5, 6, 7, 8]]);

        for bad in [
            "1 2 3 4\n".repeat(53),
            "1 2 3 4\n".repeat(55),
            "1 2 3\n".repeat(54),
            "1 2 3 4 5\n".repeat(54),
            "1 2 0 4\n".repeat(54),
            "1 2 3 0\n".repeat(54),
            "a b c d\n".repeat(54),
        ] {
            assert!(parse_boxes(&bad).is_err());
        }
    }

    #[test]
    fn measure_refuses_boxes_outside_the_picture() {
        let boxes = |line: &str| parse_boxes(&format!("{line}\n").repeat(54)).unwrap();
        let picture = RgbImage::new(20, 10);

        assert!(measure(&picture, &boxes("0 0 20 10")).is_ok());
        for line in ["1 0 20 10", "0 5 1 6", "4294967295 0 2 1", "0 4294967290 1 10"] {
            assert!(measure(&picture, &boxes(line)).is_err(), "{line}");
        }
    }

    #[test]
    fn state_must_be_a_possible_cube() {
        assert!(parse_state("UUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB").is_ok());
        for bad in [
            "",
            "UUU",
            "XUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB",
            "UUUUURUUURUURRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB",
        ] {
            assert!(parse_state(bad).is_err(), "{bad}");
        }
    }
}
