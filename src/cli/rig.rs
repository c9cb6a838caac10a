//! `rubik-robot vision rig` and `vision learn`: whole cubes in a rig whose cameras never move.
//!
//! A boxes file has one line a facelet (order URFDLB, reading order), each with one or more boxes
//! `x y width height` (px) in which that facelet shows. Boxes of one facelet are pooled.

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

/// Where each facelet shows: boxes `[x, y, width, height]`.
pub(crate) type Boxes = [Vec<[u32; 4]>; 54];

/// Reads a boxes file.
///
/// # Errors
/// The line that is wrong.
pub(crate) fn parse_boxes(text: &str) -> Result<Boxes> {
    let lines: Vec<&str> = text.lines().filter(|l| !l.trim().is_empty()).collect();
    if lines.len() != 54 {
        bail!("expected 54 lines of boxes, one a facelet, found {}", lines.len());
    }
    let mut boxes: Boxes = std::array::from_fn(|_| Vec::new());
    for (i, line) in lines.iter().enumerate() {
        let numbers = line
            .split_whitespace()
            .map(str::parse)
            .collect::<std::result::Result<Vec<u32>, _>>()
            .with_context(|| format!("line {}: {line:?}", i + 1))?;
        let (chunks, rest) = numbers.as_chunks::<4>();
        if chunks.is_empty() || !rest.is_empty() || chunks.iter().any(|b| b[2] == 0 || b[3] == 0) {
            bail!("line {}: expected boxes of x y width height: {line:?}", i + 1);
        }
        boxes[i] = chunks.to_vec();
    }
    Ok(boxes)
}

/// The colours of the pixels of each facelet's boxes.
///
/// # Errors
/// A box that is not inside the picture.
pub(crate) fn measure(image: &RgbImage, boxes: &Boxes) -> Result<[Vec<[u8; 3]>; 54]> {
    let mut pixels: [Vec<[u8; 3]>; 54] = std::array::from_fn(|_| Vec::new());
    for (facelet, (pixels, boxes)) in pixels.iter_mut().zip(boxes).enumerate() {
        for &[x, y, width, height] in boxes {
            let inside = |start: u32, length: u32, all: u32| {
                start.checked_add(length).is_some_and(|end| end <= all)
            };
            if !inside(x, width, image.width()) || !inside(y, height, image.height()) {
                bail!(
                    "facelet {facelet}: box {x} {y} {width} {height} is not inside the picture of {} x {}",
                    image.width(),
                    image.height()
                );
            }
            for row in y..y + height {
                pixels.extend((x..x + width).map(|column| image.get_pixel(column, row).0));
            }
        }
    }
    Ok(pixels)
}

/// Mean colour of the middle half of the pixels by brightness: neither glare nor a groove.
fn trimmed(pixels: &mut [[u8; 3]]) -> [f64; 3] {
    pixels.sort_by_key(|p| p.iter().map(|&v| u32::from(v)).sum::<u32>());
    let middle = &pixels[pixels.len() / 4..(3 * pixels.len()).div_ceil(4)];
    std::array::from_fn(|c| {
        middle.iter().map(|p| f64::from(p[c])).sum::<f64>() / middle.len() as f64
    })
}

fn facelet_colours(image: &Path, boxes: &Boxes) -> Result<[[f64; 3]; 54]> {
    let picture = load(image)?;
    let mut pixels = measure(&picture, boxes).with_context(|| format!("{}", image.display()))?;
    Ok(std::array::from_fn(|i| trimmed(&mut pixels[i])))
}

fn read_boxes(path: &Path) -> Result<Boxes> {
    let text = text::read(path, text::SCENARIO).with_context(|| format!("{}", path.display()))?;
    parse_boxes(&text).with_context(|| format!("{}", path.display()))
}

/// Reads and checks a table that [`learn`] wrote.
///
/// # Errors
/// What is wrong with the file.
fn read_table(path: &Path) -> Result<ColourTable> {
    let name = || format!("{}", path.display());
    let text = text::read(path, text::LIST).with_context(name)?;
    let table: ColourTable = serde_json::from_str(&text).with_context(name)?;
    table.check().with_context(name)?;
    Ok(table)
}

/// `vision rig IMAGE... --boxes FILE [--table FILE]`: the cube of each picture. The flag is false
/// when one could not be read.
///
/// # Errors
/// A boxes file or a table that cannot be used.
pub(crate) fn rig(
    images: &[PathBuf],
    boxes: &Path,
    table: Option<&Path>,
    json: bool,
) -> Result<(String, bool)> {
    let boxes = read_boxes(boxes)?;
    let table = table.map(read_table).transpose()?;
    let (mut text, mut all) = (String::new(), true);
    for image in images {
        let decided = || -> std::result::Result<Decision, Refused> {
            let rgb = facelet_colours(image, &boxes)?;
            Ok(match &table {
                Some(table) => table.decide(&rgb)?,
                None => decide_cube(&rgb)?,
            })
        };
        let (line, read) = report(&image.display().to_string(), decided(), json);
        text += &line;
        all &= read;
    }
    Ok((text, all))
}

/// Lines of a picture's file name and its 54 facelets (URFDLB).
fn parse_states(text: &str) -> Result<BTreeMap<String, String>> {
    let mut states = BTreeMap::new();
    for (i, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [name, state] = words[..] else {
            bail!("line {}: expected a picture's name and 54 facelets: {line:?}", i + 1);
        };
        states.insert(name.to_owned(), state.to_owned());
    }
    Ok(states)
}

/// A cube's colours from 54 letters.
fn parse_state(text: &str) -> Result<[u8; 54]> {
    let mut facelets = [0u8; 54];
    if text.chars().count() != 54 {
        bail!("{text:?}: expected 54 letters of URFDLB");
    }
    for (facelet, letter) in facelets.iter_mut().zip(text.chars()) {
        let face = (0..6).find(|&f| face_letter(f) == letter);
        *facelet = face.ok_or_else(|| anyhow!("{text:?}: {letter:?} is none of URFDLB"))? as u8;
    }
    if !Cube::is_possible(&facelets) {
        bail!("{text:?}: no such cube can exist");
    }
    Ok(facelets)
}

/// `vision learn IMAGE... --boxes FILE [--states FILE]`: the colour table of a rig from cubes of
/// known state, as JSON. Without a file of states, each picture's name is its state.
///
/// # Errors
/// A file that cannot be read, a state that is none.
pub(crate) fn learn(images: &[PathBuf], boxes: &Path, states: Option<&Path>) -> Result<String> {
    let boxes = read_boxes(boxes)?;
    let states = match states {
        None => None,
        Some(path) => {
            let text =
                text::read(path, text::LIST).with_context(|| format!("{}", path.display()))?;
            Some(parse_states(&text).with_context(|| format!("{}", path.display()))?)
        }
    };
    let mut known: Vec<KnownCube> = Vec::new();
    for image in images {
        let part = |name: Option<&std::ffi::OsStr>| {
            name.map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
        };
        let state = match &states {
            None => part(image.file_stem()),
            Some(states) => {
                let name = part(image.file_name());
                states
                    .get(&name)
                    .cloned()
                    .ok_or_else(|| anyhow!("{name}: its state is not given"))?
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
    fn boxes_are_54_lines_of_four_numbers_or_more() {
        let good = "1 2 3 4 5 6 7 8\n".repeat(54);
        assert_eq!(parse_boxes(&good).unwrap()[53], [[1, 2, 3, 4], [5, 6, 7, 8]]);

        for bad in [
            "1 2 3 4\n".repeat(53),
            "1 2 3\n".repeat(54),
            "1 2 0 4\n".repeat(54),
            "a b c d\n".repeat(54),
        ] {
            assert!(parse_boxes(&bad).is_err());
        }
    }

    #[test]
    fn a_box_outside_the_picture_is_refused_however_large_its_numbers() {
        let boxes = |line: &str| parse_boxes(&format!("{line}\n").repeat(54)).unwrap();
        let picture = RgbImage::new(20, 10);

        assert!(measure(&picture, &boxes("0 0 20 10")).is_ok());
        for line in ["1 0 20 10", "0 5 1 6", "4294967295 0 2 1", "0 4294967290 1 10"] {
            assert!(measure(&picture, &boxes(line)).is_err(), "{line}");
        }
    }

    #[test]
    fn a_state_must_be_a_cube() {
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
