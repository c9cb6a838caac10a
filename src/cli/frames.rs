//! `vision render`: renders frames of a cube with the exact truth, to check tools that find poses.
//!
//! - in: a scenario (camera, cube), the number of poses, their spread, a seed
//! - out: a folder of PNG files, `frames.jsonl` (a line for each frame: optics, pose, faces) and
//!   `manifest.jsonl` (a line for each face, as `vision eval` reads it)

use super::arguments::{ScenarioArgs, not_negative, positive};
use super::output::{WRONG, complain, save, save_picture};
use crate::cell::{Camera, Intrinsics, Mount};
use crate::hw::plant::render::{Look, Renderer, Setting, cube_alone};
use crate::hw::text;
use crate::scenario::Scenario;
use crate::spatial::Pose;
use crate::vision::Lens;
use crate::vision::colours::LETTERS;
use crate::vision::homography::{GRID, OUTLINE, distance, smallest_pitch};
use crate::vision::pose::cube_rotations;
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot vision render scenarios/solve.toml --poses 200 --seed 1 -o frames
  rubik-robot vision render scenarios/solve.toml --poses 200 --noise 6 --look studio -o frames
  rubik-robot vision accuracy frames
  rubik-robot vision eval frames/manifest.jsonl

Looks of the frames:
  drawn    random light, stickers and lens for each frame, with sensor mosaic, blur and reflections
  studio   even light and noise, without sensor mosaic, blur and reflections

Files of the folder:
  NNNN.png         a frame, numbered from 0000
  frames.jsonl     a line for each frame: image, width, height, intrinsics (fx fy cx cy k1 k2 p1 p2
                   k3), cube_mm, camera_from_cube, and faces, the visible ones, the dominant one
                   first: face (U R F D L B), camera_from_face, corners of the outline and centres
                   of the tiles ([x, y] in px, clockwise from the top left, in reading order),
                   colours (nine letters W R G Y O B in reading order)
  manifest.jsonl   a line for each visible face, as `vision eval` reads it, with more keys: tier (A
                   the dominant face, B another one, C one with a tile pitch below 14 px), source,
                   id, width, height, corner_centres, min_pitch_px, n_faces, note

Each sticker has a random colour, so most of the cubes cannot exist. Poses are three rows of four
(m). Camera axes: x right, y down, z forward. Cube axes: R = +x, B = +y, U = +z. Face axes: x to the
next column, y to the next row, z into the cube. The line on stdout has the numbers of frames and
faces.
Exit codes: 0 rendered, 2 wrong usage or scenario, 4 a file cannot be written.")]
pub(super) struct RenderArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Number of frames (1 to 100000)
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    poses: u32,
    /// Seed of poses, colours, light and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write the frames to FOLDER, which is created
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
    /// Name of a camera of the scenario
    #[arg(long, default_value = "standalone")]
    camera: String,
    /// Width of the dominant face, which looks most at the camera, if seen
    /// frontally (px)
    #[arg(long, default_value_t = 100.0, value_parser = positive, verbatim_doc_comment)]
    width_px: f64,
    /// Largest tilt of this face against the line of sight (deg)
    #[arg(long, default_value_t = 40.0, value_parser = not_negative)]
    tilt_deg: f64,
    /// Standard deviation of the image noise, in levels of 0 to 255
    /// [default: the scenario's plant.noise.image]
    #[arg(long, verbatim_doc_comment, value_parser = not_negative)]
    noise: Option<f64>,
    /// Look of the frames: drawn or studio
    #[arg(long, value_enum, default_value_t = LookWord::Drawn, hide_possible_values = true)]
    look: LookWord,
}

/// Look of the frames, as a word of the command line.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Clone, Copy, ValueEnum)]
enum LookWord {
    /// Random light, stickers and lens for each frame, with sensor mosaic, blur and reflections
    Drawn,
    /// Even light and noise, without sensor mosaic, blur and reflections
    Studio,
}

/// Optics of a camera (px), with the field names that calibration tools use.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Optics {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default)]
    k1: f64,
    #[serde(default)]
    k2: f64,
    #[serde(default)]
    p1: f64,
    #[serde(default)]
    p2: f64,
    #[serde(default)]
    k3: f64,
}

impl Optics {
    /// Returns the optics of a camera of a scenario.
    fn of(camera: &Intrinsics) -> Self {
        let ((fx, fy), (cx, cy), (k1, k2)) = (camera.focal, camera.centre, camera.distortion);
        Self { fx, fy, cx, cy, k1, k2, p1: 0.0, p2: 0.0, k3: 0.0 }
    }

    /// Returns the lens with these optics.
    pub(super) fn lens(&self) -> Lens {
        Lens {
            focal: (self.fx, self.fy),
            centre: (self.cx, self.cy),
            radial: [self.k1, self.k2, self.k3],
            tangential: [self.p1, self.p2],
        }
    }
}

/// Returns the path of the file in a folder that has the truth of all frames.
fn frames_of(folder: &Path) -> PathBuf {
    folder.join("frames.jsonl")
}

/// Upper three rows of the homogeneous matrix of a pose (m).
type Rows = [[f64; 4]; 3];

/// Returns a pose as the upper three rows of its homogeneous matrix (m).
pub(super) fn rows(pose: &Pose) -> Rows {
    let m = pose.to_homogeneous();
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

/// Truth of a visible face in a frame: a JSON object of `frames.jsonl`.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct FaceTruth {
    face: String,
    camera_from_face: Rows,
    corners: [(f64, f64); 4],
    centres: [(f64, f64); 9],
    colours: String,
}

/// Truth of a frame: a line of `frames.jsonl`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct FrameTruth {
    pub(super) image: String,
    width: u32,
    height: u32,
    pub(super) intrinsics: Optics,
    pub(super) cube_mm: f64,
    camera_from_cube: Rows,
    #[serde(default)]
    faces: Vec<FaceTruth>,
}

impl FrameTruth {
    /// Reads the truth of all frames in a folder.
    ///
    /// # Errors
    /// Unreadable file, or a wrong line.
    pub(super) fn read_all(folder: &Path) -> Result<Vec<Self>> {
        let path = frames_of(folder);
        let text = text::read(&path, text::LIST)?;
        let lines = text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty());
        lines
            .map(|(number, line)| {
                serde_json::from_str(line)
                    .with_context(|| format!("{}:{}", path.display(), number + 1))
            })
            .collect()
    }

    /// Returns `camera_from_cube`.
    ///
    /// # Errors
    /// Rows that are no rotation.
    pub(super) fn pose(&self) -> Result<Pose> {
        let r = &self.camera_from_cube;
        let matrix = Matrix3::from_fn(|i, j| r[i][j]);
        // Numbers with six decimals pass; a reflection does not.
        if (matrix.transpose() * matrix - Matrix3::identity()).amax() > 1e-5
            || matrix.determinant() < 0.0
        {
            bail!("camera_from_cube is not a rigid motion");
        }
        Ok(Isometry3::from_parts(
            Translation3::new(r[0][3], r[1][3], r[2][3]),
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix)),
        ))
    }
}

/// Renders the frames and writes them with their truth to the output folder. Returns the text for
/// stdout and the exit code.
pub(super) fn render(args: &RenderArgs) -> Result<(String, u8)> {
    let scenario = match args.scenario.load(&[]) {
        Ok(scenario) => scenario,
        Err(faults) => {
            complain(&faults);
            return Ok((String::new(), WRONG));
        }
    };
    let cameras = &scenario.controller.cell.cameras;
    let Some(camera) = cameras.iter().find(|c| c.name == args.camera) else {
        let names: Vec<&str> = cameras.iter().map(|c| c.name.as_str()).collect();
        complain(&format!(
            "--camera {}: the scenario has no such camera; it has {}",
            args.camera,
            names.join(", ")
        ));
        return Ok((String::new(), WRONG));
    };
    let edge = scenario.controller.cell.cube.edge;
    let distance = edge * camera.intrinsics.focal.0 / args.width_px;
    if distance < 0.05 {
        complain(&format!(
            "--width-px {}: the cube is nearer than 50 mm to the camera: give a smaller width",
            args.width_px
        ));
        return Ok((String::new(), WRONG));
    }
    std::fs::create_dir_all(&args.output).with_context(|| args.output.display().to_string())?;
    let mut random = Pcg64::seed_from_u64(args.seed);
    let (mut frames, mut manifest, mut visible) = (String::new(), String::new(), 0);
    // One random sequence draws all poses: a seed and a number of poses repeat the folder.
    for number in 0..args.poses {
        let image = format!("{number:04}.png");
        let Some(camera_from_cube) = draw_pose(&mut random, camera, edge, distance, args.tilt_deg)
        else {
            complain("--width-px: the cube does not fit into the picture: give a smaller width");
            return Ok((String::new(), WRONG));
        };
        // Each sticker has a random colour, so most cubes are impossible: only poses are checked.
        let facelets: [u8; 54] = std::array::from_fn(|_| random.random_range(0..6));
        let shot = Shot { camera, camera_from_cube, edge, facelets };
        save_picture(&args.output.join(&image), &picture(args, &scenario, number, &shot))?;
        let truth = shot.truth(image);
        visible += truth.faces.len();
        manifest += &manifest_lines(&truth);
        frames += &serde_json::to_string(&truth)?;
        frames.push('\n');
    }
    for (path, text) in
        [(frames_of(&args.output), frames), (args.output.join("manifest.jsonl"), manifest)]
    {
        save(&path, text.as_bytes())?;
    }
    let summary = format!(
        "{}: {} frames of camera {}, {visible} faces, truth in frames.jsonl and manifest.jsonl\n",
        args.output.display(),
        args.poses,
        args.camera
    );
    Ok((summary, 0))
}

/// Returns a random pose (`camera_from_cube`) of a cube that is completely in the picture, or
/// `None` if no pose fits. The centre of its dominant face is at `distance` (m) from the camera,
/// and the face is tilted by at most `tilt_deg` from the line of sight. `edge` is the cube's edge
/// (m).
fn draw_pose(
    random: &mut Pcg64,
    camera: &Camera,
    edge: f64,
    distance: f64,
    tilt_deg: f64,
) -> Option<Pose> {
    let lens = Lens::from(&camera.intrinsics);
    let (width, height) = (f64::from(camera.intrinsics.width), f64::from(camera.intrinsics.height));
    for _ in 0..1000 {
        let pixel = (random.random_range(0.0..width), random.random_range(0.0..height));
        let tilt = random.random_range(0.0..=1.0) * tilt_deg.to_radians();
        let way: f64 = random.random_range(0.0..std::f64::consts::TAU);
        let roll: f64 = random.random_range(0.0..std::f64::consts::TAU);
        let named = random.random_range(0..24);
        let Some((x, y)) = lens.unproject(pixel) else { continue };
        let sight = Vector3::new(x, y, 1.0).normalize();
        // The face first looks along the line of sight, then is tilted about a random axis across
        // it and rolled about its normal.
        let towards = UnitQuaternion::rotation_between(&Vector3::z(), &sight)
            .unwrap_or_else(UnitQuaternion::identity);
        let lean = UnitQuaternion::from_scaled_axis(Vector3::new(way.cos(), way.sin(), 0.0) * tilt);
        let rolled = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
        let rotation = towards * lean * rolled;
        let centre = sight * distance + rotation * Vector3::z() * (edge / 2.0);
        let named = cube_rotations().nth(named).unwrap_or_else(UnitQuaternion::identity);
        let pose = Pose::from_parts(centre.into(), rotation * named);
        // A margin of 3 px keeps the whole outline in the picture.
        let inside = (0..8).all(|i| {
            let half = |bit: usize| if i & bit == 0 { -edge / 2.0 } else { edge / 2.0 };
            let corner = pose * Point3::new(half(1), half(2), half(4));
            let (x, y) = lens.project(&corner);
            corner.z > 0.03 && x > 3.0 && y > 3.0 && x < width - 4.0 && y < height - 4.0
        });
        if inside {
            return Some(pose);
        }
    }
    None
}

/// A cube in front of a camera.
struct Shot<'a> {
    camera: &'a Camera,
    camera_from_cube: Pose,
    /// Length of the cube's edge (m).
    edge: f64,
    facelets: [u8; 54],
}

/// Renders a frame. The seed of `args` and the frame's `number` determine its look and its noise.
fn picture(
    args: &RenderArgs,
    scenario: &Scenario,
    number: u32,
    shot: &Shot<'_>,
) -> image::RgbImage {
    let Shot { camera, camera_from_cube, edge, facelets } = shot;
    // The constant spreads the seeds, so that two renderings with neighbouring seeds share no look.
    let seed = args.seed.wrapping_mul(0x9e37_79b9).wrapping_add(u64::from(number));
    let keys = &scenario.plant.keys;
    let mut look = match args.look {
        LookWord::Drawn => Look::draw(seed),
        LookWord::Studio => Look::studio(),
    };
    look.sensor.read_noise = args.noise.unwrap_or(keys.noise.image);
    // One kind of noise is left, so that `--noise` is its standard deviation.
    look.sensor.shot_noise = 0.0;
    look.light.ambient *= keys.light.level as f32;
    look.light.key *= keys.light.level as f32;
    let world_from_camera = match camera.mount {
        Mount::World { world_from_camera } => world_from_camera,
        // A camera in a hand has no arm here, so it gets a fixed place.
        Mount::Flange { .. } => Pose::from_parts(
            Translation3::new(0.0, 0.0, 1.2),
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2),
        ),
    };
    let camera = Camera { mount: Mount::World { world_from_camera }, ..(*camera).clone() };
    let scene = cube_alone(world_from_camera * camera_from_cube, *edge, *facelets);
    Renderer::new(camera, look, seed)
        .with_setting(Setting::of(&scenario.controller.cell))
        .render(&scene, 1.0)
}

/// A direction of the cube frame.
pub(super) type Direction = [f64; 3];

/// Letters of the faces, the outward normal and the directions of columns and rows of each in the
/// cube frame.
pub(super) const FACES: [(&str, Direction, Direction, Direction); 6] = [
    ("U", [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]),
    ("R", [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]),
    ("F", [0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
    ("D", [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
    ("L", [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]),
    ("B", [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
];

/// Least cosine between the line of sight and the inward normal of a visible face (about 75 deg).
const VISIBLE: f64 = 0.26;

impl Shot<'_> {
    /// Returns the truth of the picture with this name: its visible faces, the dominant one first.
    fn truth(&self, image: String) -> FrameTruth {
        let optics = Optics::of(&self.camera.intrinsics);
        let lens = optics.lens();
        let mut faces: Vec<(f64, FaceTruth)> =
            (0..FACES.len()).filter_map(|index| self.face(index, &lens)).collect();
        // The dominant face is the one that looks most at the camera.
        faces.sort_by(|a, b| b.0.total_cmp(&a.0));
        FrameTruth {
            image,
            width: self.camera.intrinsics.width,
            height: self.camera.intrinsics.height,
            intrinsics: optics,
            cube_mm: self.edge * 1e3,
            camera_from_cube: rows(&self.camera_from_cube),
            faces: faces.into_iter().map(|(_, face)| face).collect(),
        }
    }

    /// Returns the truth of a face, preceded by the cosine between the line of sight and the face's
    /// inward normal; `None` if the face is not visible. `index` is in the order URFDLB.
    fn face(&self, index: usize, lens: &Lens) -> Option<(f64, FaceTruth)> {
        let (letter, normal, columns, lines) = FACES[index];
        let (normal, x, y) = (Vector3::from(normal), Vector3::from(columns), Vector3::from(lines));
        let centre = Point3::from(normal * (self.edge / 2.0));
        let cube_from_face = crate::spatial::pose_from_axes(x, y, -normal, centre);
        let mut camera_from_face = self.camera_from_cube * cube_from_face;
        let sight = camera_from_face.translation.vector;
        // The cosine between the line of sight and the normal into the cube.
        let facing = (camera_from_face.rotation * Vector3::z()).dot(&sight) / sight.norm();
        if facing < VISIBLE {
            return None;
        }
        let mut colours: [u8; 9] = std::array::from_fn(|i| self.facelets[9 * index + i]);
        let place = |pose: &Pose, (u, v): (f64, f64)| {
            lens.project(&(pose * Point3::new(u * self.edge / 3.0, v * self.edge / 3.0, 0.0)))
        };
        // The reading order is that of the picture: columns lead to the right.
        for _ in 0..4 {
            let (a, b) =
                (place(&camera_from_face, (-1.0, 0.0)), place(&camera_from_face, (1.0, 0.0)));
            if b.0 - a.0 > 0.0 && b.0 - a.0 >= (b.1 - a.1).abs() {
                break;
            }
            let quarter =
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
            camera_from_face.rotation *= quarter;
            let old = colours;
            for row in 0..3 {
                for column in 0..3 {
                    colours[3 * row + column] = old[3 * column + 2 - row];
                }
            }
        }
        let truth = FaceTruth {
            face: letter.to_owned(),
            camera_from_face: rows(&camera_from_face),
            corners: OUTLINE.map(|p| place(&camera_from_face, p)),
            centres: GRID.map(|p| place(&camera_from_face, p)),
            colours: colours.iter().map(|&c| LETTERS[usize::from(c)]).collect(),
        };
        Some((facing, truth))
    }
}

/// Returns a line for each visible face, in the form of a manifest of photographs.
fn manifest_lines(truth: &FrameTruth) -> String {
    let mut lines = String::new();
    for (index, face) in truth.faces.iter().enumerate() {
        let pitch = smallest_pitch(&face.centres);
        // The shorter diagonal says how much a face is foreshortened.
        let narrow = distance(face.corners[0], face.corners[2])
            .min(distance(face.corners[1], face.corners[3]));
        // The corner tiles, clockwise from the upper left one.
        let corners = [0, 2, 8, 6].map(|i| face.centres[i]);
        let line = json!({
            "id": format!("{}#{index}", truth.image), "source": "rendered", "image": truth.image,
            "width": truth.width, "height": truth.height, "face": face.colours,
            "corner_centres": corners, "all_centres": face.centres,
            "tier": if pitch < 14.0 { "C" } else if index == 0 { "A" } else { "B" },
            "note": format!("rendered; shorter diagonal {narrow:.0} px"),
            "min_pitch_px": pitch, "n_faces": truth.faces.len(),
        });
        lines += &line.to_string();
        lines.push('\n');
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cross_product_of_face_axes_points_into_cube() {
        for (letter, normal, columns, rows) in FACES {
            let (x, y) = (Vector3::from(columns), Vector3::from(rows));
            assert_eq!(x.cross(&y), -Vector3::from(normal), "{letter}");
        }
    }

    /// The dominant face has the requested distance, which gives its width, is tilted by at most
    /// the requested angle, and is in the picture.
    #[test]
    fn random_poses_keep_distance_and_fit_the_picture() {
        let camera = Camera {
            name: "c".into(),
            mount: Mount::World { world_from_camera: Pose::identity() },
            intrinsics: Intrinsics {
                width: 640,
                height: 480,
                focal: (600.0, 600.0),
                centre: (319.5, 239.5),
                distortion: (-0.05, 0.0),
            },
        };
        let mut random = Pcg64::seed_from_u64(2);
        let mut most_tilt = 0.0_f64;
        for _ in 0..50 {
            let pose = draw_pose(&mut random, &camera, 0.057, 0.342, 30.0).unwrap();
            let shot =
                Shot { camera: &camera, camera_from_cube: pose, edge: 0.057, facelets: [0; 54] };
            let truth = shot.truth("x".into());

            let face = &truth.faces[0];
            let at = Vector3::from(face.camera_from_face.map(|r| r[3]));
            assert!((at.norm() - 0.342).abs() < 1e-9, "{at}");
            let inwards = Vector3::from(face.camera_from_face.map(|r| r[2]));
            most_tilt = most_tilt.max(inwards.angle(&at).to_degrees());
            assert!(
                face.corners.iter().all(|c| c.0 > 0.0 && c.0 < 639.0 && c.1 > 0.0 && c.1 < 479.0)
            );
            let apart = truth.pose().unwrap().inverse() * pose;
            assert!(apart.translation.vector.norm() < 1e-12 && apart.rotation.angle() < 1e-7);
        }
        assert!((25.0..30.0).contains(&most_tilt), "{most_tilt} deg of 30 deg");
    }
}
