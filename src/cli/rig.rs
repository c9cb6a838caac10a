//! `rubik-robot vision rig` and `vision learn`: whole cubes in a rig whose cameras never move.
//!
//! A boxes file has one line a facelet (order URFDLB, reading order), each with one or more boxes
//! `x y width height` [px] in which that facelet shows. Boxes of one facelet are pooled.

use anyhow::{Context, Result, bail};
use image::RgbImage;

/// Where each facelet shows: boxes `[x, y, width, height]`.
pub type Boxes = [Vec<[u32; 4]>; 54];

/// Reads a boxes file.
///
/// # Errors
/// The line that is wrong.
pub fn parse_boxes(text: &str) -> Result<Boxes> {
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
pub fn measure(image: &RgbImage, boxes: &Boxes) -> Result<[Vec<[u8; 3]>; 54]> {
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
