//! `rubik-robot vision stages`: shows the stages of the paper's detector, as in its figure 4.
//!
//! - in: pictures; optionally the optics of the camera
//! - out: a picture of each stage of [`crate::vision::paper`], with the remaining regions in their
//!   colours on the dimmed picture; a picture of the result, with the paper's square and the faces
//!   of the default detector; with optics also the pose from the square's four corner tiles

use super::arguments::{check_centre, finite, positive};
use super::image_file::load;
use super::output::{code_of, line_about, save_picture};
use crate::spatial::Pose;
use crate::vision::homography::Point;
use crate::vision::paper::{Filters, Square, Stages, classes};
use crate::vision::{CubeSighting, DetectorSettings, FaceSighting, Lens, Refusal, detect, pose};
use anyhow::{Context, Result};
use clap::Args;
use image::{Rgb, RgbImage};
use nalgebra::Vector3;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Colours in which the six colour classes of the detector are drawn.
const SHADES: [[u8; 3]; 6] =
    [[255, 255, 255], [220, 20, 40], [0, 170, 70], [255, 220, 0], [255, 120, 0], [30, 90, 230]];

#[derive(Debug, Default, Args)]
pub(super) struct StagesArgs {
    /// Picture files (PNG, JPEG)
    #[arg(required = true)]
    images: Vec<PathBuf>,
    /// Write a picture of each stage to FOLDER (PNG), which is created
    #[arg(short, long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Focal length along x (px), for the pose of the face [default: no pose]
    #[arg(long, value_parser = positive)]
    fx: Option<f64>,
    /// Focal length along y (px) [default: that along x]
    #[arg(long, value_parser = positive, requires = "fx")]
    fy: Option<f64>,
    /// Principal point, x (px, centre of pixel 0 is 0) [default: the middle]
    #[arg(long, allow_hyphen_values = true, requires = "fx", value_parser = finite)]
    cx: Option<f64>,
    /// Principal point, y (px) [default: the middle]
    #[arg(long, allow_hyphen_values = true, requires = "fx", value_parser = finite)]
    cy: Option<f64>,
    /// Length of the cube's edge (mm)
    #[arg(long, default_value_t = 57.0, value_parser = positive)]
    cube_mm: f64,
    /// Print one line of JSON for each picture
    #[arg(long)]
    json: bool,
}

impl StagesArgs {
    /// Returns the lens for a picture, without distortion; `None` without optics.
    ///
    /// # Errors
    /// Reason why the lens is not that of this picture.
    fn lens(&self, image: &RgbImage) -> Result<Option<Lens>> {
        let middle = |n: u32| 0.5 * (f64::from(n) - 1.0);
        let Some(fx) = self.fx else { return Ok(None) };
        let lens = Lens {
            focal: (fx, self.fy.unwrap_or(fx)),
            centre: (
                self.cx.unwrap_or(middle(image.width())),
                self.cy.unwrap_or(middle(image.height())),
            ),
            radial: [0.0; 3],
            tangential: [0.0; 2],
        };
        check_centre(&lens, image.width(), image.height()).map_err(anyhow::Error::msg)?;
        Ok(Some(lens))
    }
}

/// Computes the stages of each picture and writes them to the folder, if one is given. Returns a
/// line of JSON or a table for each picture, and the exit code.
///
/// # Errors
/// A folder or file that cannot be written.
pub(super) fn stages(args: &StagesArgs) -> Result<(String, u8)> {
    let (mut text, mut code) = (String::new(), 0);
    let StagesArgs { images, json, .. } = args;
    let (folder, json) = (args.out.as_deref(), *json);
    if let Some(folder) = folder {
        std::fs::create_dir_all(folder).with_context(|| format!("{}", folder.display()))?;
    }
    for path in images {
        let name = path.display().to_string();
        // A picture that cannot be read, or does not fit the optics, gets a line with the reason,
        // and the next pictures follow.
        let read = load(path)
            .map_err(anyhow::Error::from)
            .and_then(|image| Ok((args.lens(&image)?, image)));
        let (lens, image) = match read {
            Ok(read) => read,
            Err(reason) => {
                code = code.max(code_of(&reason));
                let _ = if json {
                    let reason = format!("{reason:#}");
                    writeln!(text, "{}", json!({ "image": name, "reason": reason }))
                } else {
                    writeln!(text, "{}", line_about(&name, &reason))
                };
                continue;
            }
        };
        let (width, height) = (image.width() as usize, image.height() as usize);
        let stages = Stages::run(image.as_raw(), width, height, &Filters::default());
        let square = stages.square();
        // Without optics a square has no pose.
        let pose = square.as_ref().ok().zip(lens).and_then(|(square, lens)| {
            let pose = pose::locate(&square.face()?, lens, args.cube_mm * 1e-3);
            pose.residual_px.is_finite().then_some(pose)
        });
        let faces = detect(&image, None, &DetectorSettings::default());
        let mut found = Found { stages, square, pose, faces, files: Vec::new() };
        if let Some(folder) = folder {
            found.files = found.write(image, path, folder)?;
        }
        text += &if json { found.json(&name) } else { found.words(&name) };
    }
    Ok((text, code))
}

/// Results of one picture.
struct Found {
    stages: Stages,
    /// Square that the paper's detector found.
    square: Result<Square, Refusal>,
    /// Pose of the square, if the optics are known.
    pose: Option<CubeSighting>,
    /// Faces that the default detector found.
    faces: Result<Vec<FaceSighting>, Refusal>,
    /// Names of the pictures that were written.
    files: Vec<String>,
}

/// Returns a pose as the upper three rows of its homogeneous matrix (m).
fn rows(pose: &Pose) -> Value {
    let matrix = pose.to_homogeneous();
    (0..3).map(|r| json!((0..4).map(|c| matrix[(r, c)]).collect::<Vec<f64>>())).collect()
}

impl Found {
    /// Returns the results as a line of JSON.
    fn json(&self, name: &str) -> String {
        let counts: Vec<_> = self
            .stages
            .stages
            .iter()
            .map(|s| json!({ "stage": s.name, "regions": s.count }))
            .collect();
        let mut square = match &self.square {
            Ok(square) => json!({ "corners": square.corners }),
            Err(reason) => json!({ "reason": reason.to_string() }),
        };
        if let Some(pose) = &self.pose {
            square["camera_from_face"] = rows(&pose.camera_from_face);
            square["residual_px"] = json!(pose.residual_px);
            square["other"] = rows(&pose.other.0);
            square["other_residual_px"] = json!(pose.other.1);
        }
        let faces = match &self.faces {
            Ok(faces) => json!(faces.len()),
            Err(reason) => json!(reason.to_string()),
        };
        let line = json!({ "image": name, "stages": counts, "square": square, "detector": faces,
            "files": self.files });
        format!("{line}\n")
    }

    /// Returns the results as a table.
    fn words(&self, name: &str) -> String {
        let mut text = format!("{name}\n");
        for stage in &self.stages.stages {
            let _ = writeln!(text, "  {:<15} {:6} regions", stage.name, stage.count);
        }
        let _ = match &self.square {
            Ok(square) => writeln!(
                text,
                "  largest square  corner centroids {}",
                square.corners.map(|p| format!("{:.1},{:.1}", p.0, p.1)).join("  ")
            ),
            Err(reason) => writeln!(text, "  no square       {reason}"),
        };
        if let Some(pose) = &self.pose {
            let place = pose.camera_from_face.translation.vector * 1e3;
            let tilt = |pose: &Pose| (pose.rotation * Vector3::z()).z.clamp(-1.0, 1.0).acos();
            let (tilt, other) = (tilt(&pose.camera_from_face), tilt(&pose.other.0));
            let _ = writeln!(
                text,
                "  four-point pose face's centre at {:.1}, {:.1}, {:.1} mm, tilt {:.1} deg, \
                 corners {:.2} px off; the other pose has {:.1} deg, {:.2} px",
                place.x,
                place.y,
                place.z,
                tilt.to_degrees(),
                pose.residual_px,
                other.to_degrees(),
                pose.other.1,
            );
        }
        let _ = match &self.faces {
            Ok(faces) => writeln!(text, "  the default detector reports {} face(s)", faces.len()),
            Err(reason) => writeln!(text, "  the default detector: {reason}"),
        };
        for file in &self.files {
            let _ = writeln!(text, "  {file}");
        }
        text
    }

    /// Writes a picture of each stage and one of the result; returns the names of the files.
    fn write(&self, image: RgbImage, path: &Path, folder: &Path) -> Result<Vec<String>> {
        let stages = &self.stages;
        let stem = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
        let mut files = Vec::new();
        let mut save = |picture: &RgbImage, name: &str| -> Result<()> {
            let file = folder.join(format!("{stem}-{name}.png"));
            save_picture(&file, picture)?;
            files.push(file.display().to_string());
            Ok(())
        };
        let (mut dim, classes) = classes(&image);
        for pixel in dim.pixels_mut() {
            // A quarter of the mean brightness: the coloured regions are brighter.
            let grey = pixel.0.iter().map(|&v| u32::from(v)).sum::<u32>() / 12;
            pixel.0 = [grey as u8; 3];
        }
        for (i, stage) in stages.stages.iter().enumerate() {
            let mut picture = dim.clone();
            // The first picture shows specks as well. Later stages have only regions.
            for (pixel, class) in picture.pixels_mut().zip(&classes).filter(|_| i == 0) {
                if let Some(shade) = SHADES.get(usize::from(*class)) {
                    pixel.0 = *shade;
                }
            }
            // The other pictures show the regions that the stage has left.
            for &region in stage.left.iter().filter(|_| i > 0) {
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
        let result = self.draw_result(image);
        save(&result, &format!("{}-result", stages.stages.len() + 1))?;
        Ok(files)
    }

    /// Draws the faces of the default detector (yellow), and the paper's square with its tiles
    /// (magenta), on the picture.
    fn draw_result(&self, mut picture: RgbImage) -> RgbImage {
        for face in self.faces.as_ref().map_or(&[][..], Vec::as_slice) {
            outline(&mut picture, &face.corners, [255, 255, 0]);
            for (centre, colour) in face.centres.iter().zip(face.colours) {
                blot(&mut picture, *centre, 4.0, [0, 0, 0]);
                blot(&mut picture, *centre, 3.0, SHADES[usize::from(colour)]);
            }
        }
        if let Ok(square) = &self.square {
            outline(&mut picture, &square.corners, [255, 0, 255]);
            for &tile in &square.tiles {
                // The stages work on a picture that is smaller by the factor `step`.
                let whole = |v: f64| (v + 0.5) * self.stages.step as f64 - 0.5;
                let centre = self.stages.regions[tile].centre;
                blot(&mut picture, (whole(centre.0), whole(centre.1)), 1.5, [255, 0, 255]);
            }
        }
        picture
    }
}

/// Draws the outline of a quadrilateral.
fn outline(picture: &mut RgbImage, corners: &[Point; 4], colour: [u8; 3]) {
    for i in 0..4 {
        let (a, b) = (corners[i], corners[(i + 1) % 4]);
        // Wrong corners may be far outside the picture: the limit bounds the time to draw them.
        let steps = (2.0 * (b.0 - a.0).hypot(b.1 - a.1)).clamp(1.0, 20_000.0) as usize;
        for k in 0..=steps {
            let t = k as f64 / steps as f64;
            blot(picture, (a.0 + t * (b.0 - a.0), a.1 + t * (b.1 - a.1)), 0.8, colour);
        }
    }
}

/// Draws the part of a disc that is inside the picture. `at` is its centre, `radius` its radius
/// (px).
fn blot(picture: &mut RgbImage, at: Point, radius: f64, colour: [u8; 3]) {
    let reach = radius.ceil() as i64;
    let (x0, y0) = (at.0.round() as i64, at.1.round() as i64);
    for (dx, dy) in (-reach..=reach).flat_map(|x| (-reach..=reach).map(move |y| (x, y))) {
        let (x, y) = (x0.saturating_add(dx), y0.saturating_add(dy));
        // Coordinates of a wrong square may be infinite or NaN: then no pixel is near.
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
    fn each_vision_stage_and_result_is_saved() {
        let folder = std::env::temp_dir().join(format!("rubik-stages-{}", std::process::id()));
        let picture = folder.join("in.png");
        std::fs::create_dir_all(&folder).unwrap();
        RgbImage::from_fn(64, 48, |x, y| Rgb([(x * 4) as u8, (y * 5) as u8, 40]))
            .save(&picture)
            .unwrap();

        let args = StagesArgs {
            images: vec![picture],
            out: Some(folder.clone()),
            json: true,
            ..StagesArgs::default()
        };
        let (text, code) = stages(&args).unwrap();

        let line: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(code, 0);
        assert_eq!(line["stages"].as_array().unwrap().len(), 7);
        let files = line["files"].as_array().unwrap();
        assert_eq!(files.len(), 8);
        for file in files {
            assert_eq!(load(Path::new(file.as_str().unwrap())).unwrap().dimensions(), (64, 48));
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn drawing_outside_the_picture_does_not_panic() {
        let mut picture = RgbImage::new(5, 5);

        outline(&mut picture, &[(-9.0, -9.0), (9e9, 2.0), (3.0, 3.0), (f64::NAN, 0.0)], [255; 3]);
        blot(&mut picture, (f64::INFINITY, 1.0), 2.0, [255; 3]);
    }
}
