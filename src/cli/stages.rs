//! `rubik-robot vision stages`: the paper's figure 4 of any picture.
//!
//! One picture a stage of [`crate::vision::paper`], with the regions that it left in their colours on the dimmed
//! picture, and one with the result: the paper's square, and the faces that the default detector reports.

use super::vision::load;
use crate::vision::homography::Point;
use crate::vision::paper::{Filters, Square, Stages};
use crate::vision::{DetectorSettings, FaceSighting, Refusal, detect};
use anyhow::{Context, Result};
use image::{Rgb, RgbImage};
use serde_json::json;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Colours of the six classes in the pictures.
const SHADES: [[u8; 3]; 6] =
    [[255, 255, 255], [220, 20, 40], [0, 170, 70], [255, 220, 0], [255, 120, 0], [30, 90, 230]];

/// A picture's stages: files in `folder` when there is one, one line of JSON or a short table. The flag is false
/// when a picture could not be read.
///
/// # Errors
/// A folder or file that cannot be written.
pub fn stages(images: &[PathBuf], folder: Option<&Path>, json: bool) -> Result<(String, bool)> {
    let (mut text, mut all) = (String::new(), true);
    if let Some(folder) = folder {
        std::fs::create_dir_all(folder).with_context(|| format!("{}", folder.display()))?;
    }
    for path in images {
        let name = path.display().to_string();
        let image = match load(path) {
            Ok(image) => image,
            Err(reason) => {
                all = false;
                let reason = format!("{reason:#}");
                let line = json!({ "image": name, "reason": reason });
                let _ = if json {
                    writeln!(text, "{line}")
                } else {
                    writeln!(text, "{name}: {reason}")
                };
                continue;
            }
        };
        let (width, height) = (image.width() as usize, image.height() as usize);
        let stages = Stages::run(image.as_raw(), width, height, &Filters::default());
        let square = stages.square();
        let faces = detect(&image, None, &DetectorSettings::default());
        let files = match folder {
            Some(folder) => write(&image, path, folder, &stages, &square, &faces)?,
            None => Vec::new(),
        };
        text += &summary(&name, &stages, &square, &faces, &files, json);
    }
    Ok((text, all))
}

fn summary(
    name: &str,
    stages: &Stages,
    square: &Result<Square, Refusal>,
    faces: &Result<Vec<FaceSighting>, Refusal>,
    files: &[String],
    json: bool,
) -> String {
    let corners = square.as_ref().map(|s| s.corners);
    if json {
        let counts: Vec<_> = stages
            .stages
            .iter()
            .map(|s| json!({ "stage": s.name, "regions": s.left.len() }))
            .collect();
        let square = match corners {
            Ok(corners) => json!({ "corners": corners }),
            Err(reason) => json!({ "reason": reason.to_string() }),
        };
        let faces = match faces {
            Ok(faces) => json!(faces.len()),
            Err(reason) => json!(reason.to_string()),
        };
        let line = json!({ "image": name, "stages": counts, "square": square, "detector": faces, "files": files });
        return format!("{line}\n");
    }
    let mut text = format!("{name}\n");
    for stage in &stages.stages {
        let _ = writeln!(text, "  {:<15} {:6} regions", stage.name, stage.left.len());
    }
    let _ = match corners {
        Ok(c) => writeln!(
            text,
            "  biggest square  corner centroids {}",
            c.map(|p| format!("{:.1},{:.1}", p.0, p.1)).join("  ")
        ),
        Err(reason) => writeln!(text, "  no square       {reason}"),
    };
    let _ = match faces {
        Ok(faces) => writeln!(text, "  the default detector reports {} face(s)", faces.len()),
        Err(reason) => writeln!(text, "  the default detector: {reason}"),
    };
    for file in files {
        let _ = writeln!(text, "  {file}");
    }
    text
}

/// One file a stage, and the result; their names.
fn write(
    image: &RgbImage,
    path: &Path,
    folder: &Path,
    stages: &Stages,
    square: &Result<Square, Refusal>,
    faces: &Result<Vec<FaceSighting>, Refusal>,
) -> Result<Vec<String>> {
    let stem = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    let mut files = Vec::new();
    let mut save = |picture: &RgbImage, name: &str| -> Result<()> {
        let file = folder.join(format!("{stem}-{name}.png"));
        picture.save(&file).with_context(|| format!("{}", file.display()))?;
        files.push(file.display().to_string());
        Ok(())
    };
    let mut dim = image.clone();
    for pixel in dim.pixels_mut() {
        let grey = pixel.0.iter().map(|&v| u32::from(v)).sum::<u32>() / 12;
        pixel.0 = [grey as u8; 3];
    }
    for (i, stage) in stages.stages.iter().enumerate() {
        let mut picture = dim.clone();
        for &region in &stage.left {
            let region = &stages.regions[region];
            for &(row, start, end) in &region.runs {
                for x in start..end {
                    picture.put_pixel(
                        x as u32,
                        row as u32,
                        Rgb(SHADES[usize::from(region.colour)]),
                    );
                }
            }
        }
        save(&picture, &format!("{}-{}", i + 1, stage.name))?;
    }
    let mut picture = image.clone();
    for face in faces.as_ref().map_or(&[][..], Vec::as_slice) {
        outline(&mut picture, &face.corners, [255, 255, 0]);
        for (centre, colour) in face.centres.iter().zip(face.colours) {
            blot(&mut picture, *centre, 4.0, [0, 0, 0]);
            blot(&mut picture, *centre, 3.0, SHADES[usize::from(colour)]);
        }
    }
    if let Ok(square) = square {
        outline(&mut picture, &square.corners, [255, 0, 255]);
        for &tile in &square.tiles {
            blot(&mut picture, stages.regions[tile].centre, 1.5, [255, 0, 255]);
        }
    }
    save(&picture, &format!("{}-result", stages.stages.len() + 1))?;
    Ok(files)
}

fn outline(picture: &mut RgbImage, corners: &[Point; 4], colour: [u8; 3]) {
    for i in 0..4 {
        let (a, b) = (corners[i], corners[(i + 1) % 4]);
        let steps = (2.0 * (b.0 - a.0).hypot(b.1 - a.1)).clamp(1.0, 20_000.0) as usize;
        for k in 0..=steps {
            let t = k as f64 / steps as f64;
            blot(picture, (a.0 + t * (b.0 - a.0), a.1 + t * (b.1 - a.1)), 0.8, colour);
        }
    }
}

/// A disc; what lies outside the picture is left out.
fn blot(picture: &mut RgbImage, at: Point, radius: f64, colour: [u8; 3]) {
    let reach = radius.ceil() as i64;
    let (x0, y0) = (at.0.round() as i64, at.1.round() as i64);
    for (dx, dy) in (-reach..=reach).flat_map(|x| (-reach..=reach).map(move |y| (x, y))) {
        let (x, y) = (x0.saturating_add(dx), y0.saturating_add(dy));
        let near = (x as f64 - at.0).hypot(y as f64 - at.1) <= radius;
        let inside = (0..i64::from(picture.width())).contains(&x)
            && (0..i64::from(picture.height())).contains(&y);
        if near && inside {
            picture.put_pixel(x as u32, y as u32, Rgb(colour));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_stage_and_the_result_become_a_file() {
        let folder = std::env::temp_dir().join(format!("rubik-stages-{}", std::process::id()));
        let picture = folder.join("in.png");
        std::fs::create_dir_all(&folder).unwrap();
        RgbImage::from_fn(64, 48, |x, y| Rgb([(x * 4) as u8, (y * 5) as u8, 40]))
            .save(&picture)
            .unwrap();

        let (text, all) = stages(&[picture], Some(&folder), true).unwrap();

        let line: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert!(all);
        assert_eq!(line["stages"].as_array().unwrap().len(), 6);
        let files = line["files"].as_array().unwrap();
        assert_eq!(files.len(), 7);
        for file in files {
            assert_eq!(load(Path::new(file.as_str().unwrap())).unwrap().dimensions(), (64, 48));
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn marks_beyond_the_border_are_left_out() {
        let mut picture = RgbImage::new(5, 5);

        outline(&mut picture, &[(-9.0, -9.0), (9e9, 2.0), (3.0, 3.0), (f64::NAN, 0.0)], [255; 3]);
        blot(&mut picture, (f64::INFINITY, 1.0), 2.0, [255; 3]);
    }
}
