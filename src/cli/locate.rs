//! `vision locate` and `vision accuracy`: pose of the cube in a picture, and errors of that pose.
//!
//! - in: picture files with their optics; or a folder of `vision render`, with its truth
//! - out: a line of JSON or text for each picture; or a table of errors
//!
//! | fault | threshold | reason |
//! |---|---|---|
//! | the face is another object | [`LEAST_CONFIDENCE`] | a wrong face gives a wrong pose |
//! | the edges are not those of a cube | [`RESIDUAL`] | then the pose is wrong |
//! | optics of another resolution | [`check_centre`] | the pose has a small residual and is wrong |
//! | the pose is far from the truth | [`ASTRAY`] | it is that of another object |

use super::arguments::{check_centre, finite, positive};
use super::frames::{FrameTruth, Optics, rows};
use super::image_file::load;
use super::output::{code_of, line_about};
use crate::spatial::Pose;
use crate::vision::colours::LETTERS;
use crate::vision::pose::nearest_of_24;
use crate::vision::{CubeLocation, DetectorSettings, Lens, detect, locate_in};
use anyhow::{Context, Result, bail};
use clap::Args;
use nalgebra::{Matrix6, Point3, Vector3, Vector6};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Instant;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot vision locate photo.png --fx 600 --fy 600 --cx 319.5 --cy 239.5
  rubik-robot vision locate frames/*.png --fx 1150 --k1 -0.08 --k2 0.02 --json

Each picture gets a line: the place of the cube's centre (mm; x right, y down, z forward) with
standard deviations (mm, and deg of rotation), number of faces used, confidence, residual (px); or
the reason why there is no pose.

Keys of a line of --json:
  image              name of the picture
  camera_from_cube   pose, three rows of four (m): takes coordinates of the cube to those of the
                     camera (x right, y down, z forward); the origin is the centre of the cube, the
                     axes are those of the dominant face (one of the 24 ways to name them)
  camera_from_face   pose of the dominant face, the largest in the picture: origin in its centre, x
                     to the next column and y to the next row as read in the picture, z into the
                     cube
  covariance         6 x 6, of a small error of camera_from_cube in the camera's axes: x, y, z (m),
                     then rotation about the centre of the cube (rad); it includes noise and model,
                     but no errors of the given optics
  residual_px        r.m.s. distance of the edges in the picture from those of the pose (px)
  confidence         certainty that the picture shows a cube, 0 to 1
  other              second pose of the cube that fits, if one face alone leaves two; otherwise null
  faces              faces that were used, the dominant one first: camera_from_face, detected
                     (false: only its edges support it); if detected also corners of its outline
                     ([x, y] in px, clockwise from the top left) and colours (nine letters W R G Y O
                     B in reading order: white, red, green, yellow, orange, blue)
If there is no pose, the keys are image and reason.
Exit codes: 0 every picture gives a pose, 1 a picture does not, for example because the principal
point (--cx, --cy) is outside of it, 2 wrong usage, or a picture cannot be read.")]
pub(super) struct LocateArgs {
    /// Picture files (PNG, JPEG)
    #[arg(required = true)]
    images: Vec<PathBuf>,
    #[command(flatten)]
    optics: OpticsArgs,
    /// Length of the cube's edge (mm)
    #[arg(long, default_value_t = 57.0, value_parser = positive)]
    cube_mm: f64,
    /// Print one line of JSON for each picture
    #[arg(long)]
    json: bool,
}

/// Optics of a camera on the command line, with the names that calibration tools use.
#[derive(Debug, Args)]
struct OpticsArgs {
    /// Focal length along x (px)
    #[arg(long, value_parser = positive)]
    fx: f64,
    /// Focal length along y (px) [default: that along x]
    #[arg(long, value_parser = positive)]
    fy: Option<f64>,
    /// Principal point, x (px, centre of pixel 0 is 0) [default: the middle]
    #[arg(long, allow_hyphen_values = true, value_parser = finite)]
    cx: Option<f64>,
    /// Principal point, y (px) [default: the middle]
    #[arg(long, allow_hyphen_values = true, value_parser = finite)]
    cy: Option<f64>,
    /// Radial distortion, coefficient of r^2
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true, value_parser = finite)]
    k1: f64,
    /// Radial distortion, coefficient of r^4
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true, value_parser = finite)]
    k2: f64,
    /// Tangential distortion, first coefficient
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true, value_parser = finite)]
    p1: f64,
    /// Tangential distortion, second coefficient
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true, value_parser = finite)]
    p2: f64,
    /// Radial distortion, coefficient of r^6
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true, value_parser = finite)]
    k3: f64,
}

impl OpticsArgs {
    /// Returns the lens for a picture of this size.
    fn lens(&self, width: u32, height: u32) -> Lens {
        // The default of the principal point is the middle of the picture.
        let middle = |n: u32| 0.5 * (f64::from(n) - 1.0);
        Lens {
            focal: (self.fx, self.fy.unwrap_or(self.fx)),
            centre: (self.cx.unwrap_or(middle(width)), self.cy.unwrap_or(middle(height))),
            radial: [self.k1, self.k2, self.k3],
            tangential: [self.p1, self.p2],
        }
    }
}

/// Least confidence of a face that gives a pose: below it the face may be another object.
const LEAST_CONFIDENCE: f64 = 0.45;
/// Largest mean distance of the edges in the picture from those of the pose (px).
const RESIDUAL: f64 = 2.0;

/// Locates a cube whose edge has the length `edge` (m) in a picture.
///
/// # Errors
/// Reason why there is no pose.
fn find(image: &image::RgbImage, lens: &Lens, edge: f64) -> Result<CubeLocation> {
    check_centre(lens, image.width(), image.height()).map_err(anyhow::Error::msg)?;
    let settings =
        DetectorSettings { least_confidence: LEAST_CONFIDENCE, ..DetectorSettings::default() };
    let faces = detect(image, None, &settings)?;
    let Some(location) = locate_in(image, &faces, lens, edge, None) else {
        bail!("a face was found, but no pose of a cube fits it: check the optics")
    };
    // Optics that are wrong, or another object, leave a large residual.
    if location.residual_px > RESIDUAL {
        let off = location.residual_px;
        bail!("a face was found, but its edges are {off:.1} px off a cube's: check the optics");
    }
    Ok(location)
}

/// Returns the confidence of the surest face that was used, 0..=1.
fn confidence(location: &CubeLocation) -> f64 {
    location.faces.iter().map(|f| f.confidence).fold(0.0, f64::max)
}

/// Locates the cube in each picture. Returns a line of text or of JSON for each, and the exit code.
pub(super) fn locate(args: &LocateArgs) -> (String, u8) {
    let (mut text, mut code) = (String::new(), 0);
    for path in &args.images {
        let name = path.display().to_string();
        let found = load(path).map_err(anyhow::Error::from).and_then(|image| {
            find(&image, &args.optics.lens(image.width(), image.height()), args.cube_mm * 1e-3)
        });
        code = code.max(found.as_ref().err().map_or(0, code_of));
        // Writing to a string cannot fail.
        let _ = match found {
            Ok(location) if args.json => writeln!(text, "{}", answer(&name, &location)),
            Ok(location) => writeln!(text, "{name}: {}", words(&location)),
            Err(reason) if args.json => {
                let reason = format!("{reason:#}");
                writeln!(text, "{}", json!({ "image": name, "reason": reason }))
            }
            Err(reason) => writeln!(text, "{}", line_about(&name, &reason)),
        };
    }
    (text, code)
}

/// Returns a location as JSON.
fn answer(name: &str, location: &CubeLocation) -> Value {
    let covariance: Vec<Vec<f64>> =
        (0..6).map(|i| (0..6).map(|j| location.covariance[(i, j)]).collect()).collect();
    let faces: Vec<Value> = location
        .used
        .iter()
        .enumerate()
        .map(|(i, cube_from_face)| {
            let mut face = json!({
                "camera_from_face": rows(&(location.camera_from_cube * cube_from_face)),
                "detected": location.sighting(i).is_some(),
            });
            if let Some(sighting) = location.sighting(i) {
                face["corners"] = sighting.corners.iter().map(|c| json!([c.0, c.1])).collect();
                let letters = sighting.colours.iter().map(|&c| LETTERS[usize::from(c)]);
                face["colours"] = letters.collect::<String>().into();
            }
            face
        })
        .collect();
    json!({
        "image": name,
        "camera_from_cube": rows(&location.camera_from_cube),
        "camera_from_face": rows(&location.camera_from_face()),
        "covariance": covariance,
        "residual_px": location.residual_px,
        "confidence": confidence(location),
        "other": location.other.as_ref().map(rows),
        "faces": faces,
    })
}

/// Returns a location as text.
fn words(location: &CubeLocation) -> String {
    let at = location.camera_from_cube.translation.vector * 1e3;
    let spread = |i: usize| location.covariance[(i, i)].max(0.0).sqrt();
    // The largest standard deviation of the rotations about the three axes.
    let turn = (3..6).map(spread).fold(0.0, f64::max).to_degrees();
    format!(
        "cube at x {:.2}, y {:.2}, z {:.2} mm (s.d. {:.2}, {:.2}, {:.2} mm, {turn:.2} deg), \
         {} face{}, confidence {:.2}, residual {:.2} px{}",
        at.x,
        at.y,
        at.z,
        spread(0) * 1e3,
        spread(1) * 1e3,
        spread(2) * 1e3,
        location.used.len(),
        if location.used.len() == 1 { "" } else { "s" },
        confidence(location),
        location.residual_px,
        if location.other.is_some() { ", another orientation fits as well" } else { "" },
    )
}

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot vision accuracy frames
  rubik-robot vision accuracy frames --focal-error-percent 1

The command locates the cube in each frame of a folder of `vision render`, as `vision locate` does,
and compares the pose with the truth. The table has the r.m.s. and the 95 % quantile (p95) of errors
of place (mm): lateral ones are across the line of sight, depth errors along it. The dominant face
is the largest in the picture. NEES (normalised estimation error squared) is the squared error over
the reported covariance: 6 on average if the covariance is right (5.3 at the median, 12.6 at 95 %).
Then come the frames without a right pose, each with the reason.

Keys of the object of --json:
  frames (their number), focal_error_percent
  face_centre, cube_centre_one_face, cube_centre_several_faces   errors of the dominant face's
                       centre, and of the cube's in frames of one or of several faces: frames,
                       lateral_rms_mm, lateral_p95_mm, depth_rms_mm, depth_p95_mm
  rotation_rms_deg, nees_mean, nees_median, nees_p95
  median_ms            time of a frame by the wall clock, with detection
  misses               frames without a right pose, each with the reason
Errors without a frame are null.
Exit codes: 0 all frames give a pose, 1 a frame gives none, or one that is wrong by more than 15 mm,
or there is no frame, 2 wrong usage, or the folder cannot be read.")]
pub(super) struct AccuracyArgs {
    /// Folder that `vision render` wrote
    folder: PathBuf,
    /// Error to add to the focal lengths before locating (%)
    #[arg(long, value_name = "PERCENT", default_value_t = 0.0, allow_hyphen_values = true,
          value_parser = finite)]
    focal_error_percent: f64,
    /// Print one object of JSON instead of a table
    #[arg(long)]
    json: bool,
}

/// Errors of a point over many frames (m).
#[derive(Debug, Default)]
struct Errors {
    lateral: Vec<f64>,
    depth: Vec<f64>,
}

impl Errors {
    /// Adds the error of a point, split into the parts across and along the line of sight. Both
    /// points are in the camera's frame (m).
    fn push(&mut self, found: Point3<f64>, truth: Point3<f64>) {
        let sight = truth.coords.normalize();
        let error = found - truth;
        let depth = error.dot(&sight);
        self.depth.push(depth.abs());
        self.lateral.push((error - sight * depth).norm());
    }

    /// Returns r.m.s. and 95 % quantile of the lateral errors, then of the depth errors (mm).
    fn figures(&self) -> [f64; 4] {
        let rms = |v: &[f64]| (v.iter().map(|x| x * x).sum::<f64>() / v.len() as f64).sqrt() * 1e3;
        let p95 = |v: &[f64]| quantile(v, 0.95) * 1e3;
        [rms(&self.lateral), p95(&self.lateral), rms(&self.depth), p95(&self.depth)]
    }

    /// Returns these errors as JSON.
    fn json(&self) -> Value {
        let [a, b, c, d] = self.figures();
        json!({ "frames": self.depth.len(), "lateral_rms_mm": a, "lateral_p95_mm": b,
            "depth_rms_mm": c, "depth_p95_mm": d })
    }

    /// Returns these errors as a line of the table of accuracy, which begins with `name`.
    fn line(&self, name: &str) -> String {
        if self.depth.is_empty() {
            return format!("{name:<38} {:6}\n", 0);
        }
        let [a, b, c, d] = self.figures();
        format!("{name:<38} {:6} {a:10.3} {b:10.3} {c:10.3} {d:10.3}\n", self.depth.len())
    }
}

/// Returns the quantile `share` (0 to 1) of values in any order; NaN if there are none.
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = (values.len() as f64 * share) as usize;
    sorted.get(at.min(values.len().saturating_sub(1))).copied().unwrap_or(f64::NAN)
}

/// Distance of the reported dominant face from the nearest true face beyond which the report is
/// wrong (m).
const ASTRAY: f64 = 0.015;

/// Measures the errors of all frames in a folder. Returns them as a table or JSON, and the exit
/// code, which is 1 unless every frame gave a right pose.
///
/// # Errors
/// Unreadable folder.
pub(super) fn accuracy(args: &AccuracyArgs) -> Result<(String, u8)> {
    let frames = FrameTruth::read_all(&args.folder)?;
    let mut measured = Measured::default();
    for frame in &frames {
        if let Err(miss) = measured.add(frame, args)? {
            measured.misses.push(format!("{}: {miss}", frame.image));
        }
    }
    // An empty folder is no success.
    let all = measured.misses.is_empty() && !frames.is_empty();
    let text = if args.json {
        format!("{}\n", measured.json(frames.len(), args))
    } else {
        measured.table(frames.len())?
    };
    Ok((text, u8::from(!all)))
}

/// Errors over the frames of a folder.
#[derive(Debug, Default)]
struct Measured {
    /// Errors of the centre of the dominant face.
    face: Errors,
    /// Errors of the centre of the cube, in frames of two or three faces.
    several: Errors,
    /// Errors of the centre of the cube, in frames of one face.
    single: Errors,
    /// Normalised squared error of each pose, see [`nees_of`].
    nees: Vec<f64>,
    /// Times of localisation (ms).
    times: Vec<f64>,
    /// Errors of rotation (rad).
    turns: Vec<f64>,
    /// Texts about frames without a pose, or with a wrong one.
    misses: Vec<String>,
}

impl Measured {
    /// Locates the cube in a frame and adds its errors. The inner error is the reason why the frame
    /// gives no pose, or a wrong one.
    fn add(
        &mut self,
        frame: &FrameTruth,
        args: &AccuracyArgs,
    ) -> Result<std::result::Result<(), String>> {
        let image = load(&args.folder.join(&frame.image))?;
        let lens = scaled(&frame.intrinsics, 1.0 + args.focal_error_percent / 100.0);
        let edge = frame.cube_mm * 1e-3;
        let begun = Instant::now();
        let found = find(&image, &lens, edge);
        // The time includes detection, but not reading the file.
        self.times.push(begun.elapsed().as_secs_f64() * 1e3);
        let location = match found {
            Ok(location) => location,
            Err(reason) => return Ok(Err(format!("{reason:#}"))),
        };
        let truth = frame.pose().with_context(|| frame.image.clone())?;
        let centre = Point3::from(location.camera_from_face().translation.vector);
        let nearest = face_nearest(&truth, edge, &centre);
        let far = (centre - nearest).norm();
        // Wrong focal lengths shift the depth in proportion, which is no wrong report.
        if far > ASTRAY + 0.02 * args.focal_error_percent.abs() * nearest.coords.norm() {
            return Ok(Err(format!("wrong by {:.0} mm", far * 1e3)));
        }
        self.face.push(centre, nearest);
        // One face leaves the depth of the cube less certain, so the two cases are counted apart.
        let cube = if location.used.len() > 1 { &mut self.several } else { &mut self.single };
        cube.push(
            location.camera_from_cube.translation.vector.into(),
            truth.translation.vector.into(),
        );
        let error = error_of(&location.camera_from_cube, &truth);
        self.turns.push(error.fixed_rows::<3>(3).norm());
        self.nees.extend(nees_of(&error, &location.covariance));
        Ok(Ok(()))
    }

    /// Returns the mean of the normalised squared errors.
    fn mean_nees(&self) -> f64 {
        self.nees.iter().sum::<f64>() / self.nees.len().max(1) as f64
    }

    /// Returns the error of rotation, r.m.s. (rad).
    fn turn(&self) -> f64 {
        let squares = self.turns.iter().map(|t| t * t).sum::<f64>();
        (squares / self.turns.len().max(1) as f64).sqrt()
    }

    /// Returns the errors as JSON. `frames` is the number of all frames, also of those that are
    /// missed.
    fn json(&self, frames: usize, args: &AccuracyArgs) -> Value {
        let Self { face, several, single, nees, times, misses, .. } = self;
        json!({ "frames": frames, "focal_error_percent": args.focal_error_percent,
            "face_centre": face.json(), "cube_centre_several_faces": several.json(),
            "cube_centre_one_face": single.json(), "rotation_rms_deg": self.turn().to_degrees(),
            "nees_mean": self.mean_nees(), "nees_median": quantile(nees, 0.5),
            "nees_p95": quantile(nees, 0.95), "median_ms": quantile(times, 0.5), "misses": misses })
    }

    /// Returns the errors as a table. `frames` is the number of all frames, also of those that are
    /// missed.
    fn table(&self, frames: usize) -> Result<String> {
        let mut out = String::from(
            "point                                  frames   lateral mm: r.m.s., p95     \
             depth mm: r.m.s., p95\n",
        );
        out += &self.face.line("centre of the dominant face");
        out += &self.several.line("centre of the cube, two or three faces");
        out += &self.single.line("centre of the cube, one face");
        let mean = self.mean_nees();
        writeln!(
            out,
            "rotation {:.2} deg r.m.s.; NEES mean {mean:.1}, median {:.1}, p95 {:.1}; {} of {} \
             frames, median {:.1} ms (with detection)",
            self.turn().to_degrees(),
            quantile(&self.nees, 0.5),
            quantile(&self.nees, 0.95),
            frames - self.misses.len(),
            frames,
            quantile(&self.times, 0.5)
        )?;
        for miss in &self.misses {
            writeln!(out, "  {miss}")?;
        }
        Ok(out)
    }
}

/// Returns the lens with focal lengths that are scaled by a factor.
fn scaled(optics: &Optics, factor: f64) -> Lens {
    let mut lens = optics.lens();
    lens.focal = (lens.focal.0 * factor, lens.focal.1 * factor);
    lens
}

/// Returns the centre of the face of the true cube (edge in m) that is nearest to a point. Points
/// are in the frame of the camera (m).
fn face_nearest(truth: &Pose, edge: f64, to: &Point3<f64>) -> Point3<f64> {
    let half = edge / 2.0;
    let mut best = (f64::INFINITY, *to);
    // The reported face may have any of the 24 names, so the nearest true face counts.
    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
        for sign in [-half, half] {
            let centre = truth * Point3::from(axis * sign);
            if (centre - to).norm() < best.0 {
                best = ((centre - to).norm(), centre);
            }
        }
    }
    best.1
}

/// Returns the error of a pose in the camera's axes: translation (m), then rotation vector (rad). A
/// cube without regard to its colours has 24 equal orientations; the one nearest to the truth
/// counts.
fn error_of(found: &Pose, truth: &Pose) -> Vector6<f64> {
    let relative = found.rotation.inverse() * truth.rotation;
    let named_alike = found.rotation * nearest_of_24(&relative);
    let turn = (named_alike * truth.rotation.inverse()).scaled_axis();
    let shift = found.translation.vector - truth.translation.vector;
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

/// Returns the normalised squared error (NEES), `e^T C^-1 e`; `None` if the covariance is singular.
fn nees_of(error: &Vector6<f64>, covariance: &Matrix6<f64>) -> Option<f64> {
    Some(error.dot(&covariance.cholesky()?.solve(error)))
}
