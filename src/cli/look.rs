//! `rubik-robot vision` and `rubik-robot picture`: pictures in, and pictures out.

use super::output::{Output, clash, save};
use super::{ScenarioArgs, WRONG, complain, cubes, evaluate, frames, locate, rig, stages, vision};
use crate::cube::{Axis, Face, Facelets, Keeper};
use crate::hw::plant::render::{Look, Renderer, Setting, picture as overview};
use crate::hw::scene::{Scene, SceneArm, SceneCube};
use crate::operator::{ArmJoints, ArmView, Snapshot, joints_of};
use crate::scenario::ControllerConfig;
use crate::spatial::Twist;
use clap::{Args, Subcommand};
use image::ImageFormat;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot vision face photo.jpg                        faces, corners, colours
  rubik-robot vision face *.png --json                     one line of JSON a picture
  rubik-robot vision scan u.jpg r.jpg f.jpg d.jpg l.jpg b.jpg
                                                           six pictures -> the cube's facelets
  rubik-robot vision colours measured.json                 54 RGB triples -> the cube's facelets
  rubik-robot vision learn known/*.png --boxes rig.txt > rig.json
  rubik-robot vision rig new.png --boxes rig.txt --table rig.json
  rubik-robot vision locate photo.jpg --fx 600             where the cube is
  rubik-robot vision eval photographs/manifest.jsonl       found right, read right, ms a picture
  rubik-robot vision stages photo.jpg -o stages            the paper's figure 4 of a picture
Exit code 1 when a picture shows no face, or colours make no cube.")]
pub(super) struct VisionArgs {
    #[command(subcommand)]
    what: What,
}

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Subcommand)]
enum What {
    /// Find the faces of a cube in pictures and read their colours
    Face {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// One line of JSON a picture
        #[arg(long)]
        json: bool,
    },
    /// Read a cube from six pictures: U R F D L B, each upright as in the usual net (U over F, D under F)
    Scan {
        /// Picture files (PNG, JPEG) in this order
        #[arg(required = true, num_args = 6, value_names = ["U", "R", "F", "D", "L", "B"])]
        images: Vec<PathBuf>,
        /// One line of JSON
        #[arg(long)]
        json: bool,
    },
    /// Decide whole cubes from 54 measured colours each: {"1": [r, g, b], ... "54": [r, g, b]}
    ///
    /// Squares are numbered face by face in reading order; the faces are U, L, F, R, B, D. The answer is in the
    /// order U, R, F, D, L, B.
    #[command(verbatim_doc_comment)]
    Colours {
        /// Files of measured colours (JSON)
        #[arg(required = true)]
        files: Vec<PathBuf>,
        /// One line of JSON a file
        #[arg(long)]
        json: bool,
    },
    /// Read cubes in a rig whose cameras never move, at known places of the picture
    Rig {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// 54 lines (URFDLB), each with one or more boxes: x y width height
        #[arg(long)]
        boxes: PathBuf,
        /// Colours of this rig, from `vision learn`
        #[arg(long)]
        table: Option<PathBuf>,
        /// One line of JSON a picture
        #[arg(long)]
        json: bool,
    },
    /// Learn the colours of a rig from pictures of cubes of known state; prints the table
    Learn {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// 54 lines (URFDLB), each with one or more boxes: x y width height
        #[arg(long)]
        boxes: PathBuf,
        /// Lines of a picture's file name and its 54 facelets; without it a picture's name is its state
        #[arg(long)]
        states: Option<PathBuf>,
    },
    /// Compare with the truth of a manifest: which share of the faces is found right and read right
    ///
    /// A manifest has a JSON object a line, a face each: image (path from the manifest's folder), face (nine letters
    /// of WYROGB in reading order), all_centres (nine pixels), and optionally tier and source to group by. Found
    /// right: all nine centres within a quarter of the tile pitch.
    #[command(verbatim_doc_comment)]
    Eval {
        /// File of JSON lines
        manifest: PathBuf,
        /// One object instead of a table
        #[arg(long)]
        json: bool,
        /// Name each face that was missed or misread, and each wrong report
        #[arg(long)]
        misses: bool,
    },
    /// Say where the cube is, from pictures and their optics
    Locate(locate::LocateArgs),
    /// Compare poses with the truth of frames that `vision render` wrote
    Accuracy(locate::AccuracyArgs),
    /// Write frames of the plant's renderer with exact truth
    Render(frames::RenderArgs),
    /// Show what each stage of the paper's method leaves of a picture: its regions, and the square they make
    ///
    /// With -o, a picture of each stage (regions, area, boundary, circularity, quadrilaterals, once: of several colour
    /// ranges, neighbours) and one of the result: the paper's square in magenta, the default detector's faces in yellow
    /// with the colours read. With --fx, the pose of the face by its four corner tiles, as the paper takes it.
    #[command(verbatim_doc_comment)]
    Stages(stages::StagesArgs),
}

/// Returns the exit code.
pub(super) fn look_at(args: &VisionArgs, output: &mut Output) -> anyhow::Result<u8> {
    let done = match &args.what {
        What::Face { images, json } => Ok(vision::face(images, *json)),
        What::Scan { images, json } => Ok(cubes::scan(images, *json)),
        What::Colours { files, json } => Ok(cubes::colours(files, *json)),
        What::Rig { images, boxes, table, json } => {
            rig::rig(images, boxes, table.as_deref(), *json)
        }
        What::Learn { images, boxes, states } => {
            rig::learn(images, boxes, states.as_deref()).map(|text| (text, true))
        }
        What::Eval { manifest, json, misses } => {
            evaluate::evaluate(manifest, *json, *misses).map(|text| (text, true))
        }
        What::Stages(args) => stages::stages(args),
        What::Locate(args) => Ok(locate::locate(args)),
        What::Accuracy(args) => locate::accuracy(args),
        What::Render(args) => {
            let (text, code) = frames::render(args)?;
            output.text(&text)?;
            return Ok(code);
        }
    };
    match done {
        Ok((text, all)) => {
            output.text(&text)?;
            Ok(u8::from(!all))
        }
        Err(error) => {
            complain(&format!("{error:#}"));
            Ok(WRONG)
        }
    }
}

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot picture scenarios/solve.toml                          cell.png, from outside
  rubik-robot picture scenarios/solve.toml --camera standalone --out view.png")]
pub(super) struct PictureArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// File to write (PNG or JPEG, by its ending)
    #[arg(long, default_value = "cell.png")]
    out: PathBuf,
    /// What this camera of the scenario sees, instead of the cell from outside
    #[arg(long)]
    camera: Option<String>,
    /// Width of the picture from outside
    #[arg(long, default_value_t = 1280, value_parser = clap::value_parser!(u32).range(16..=4096))]
    width: u32,
    /// Height of the picture from outside
    #[arg(long, default_value_t = 800, value_parser = clap::value_parser!(u32).range(16..=4096))]
    height: u32,
}

/// Writes the cell as it stands before a run: arms at their start, the cube in the hand. Returns the exit code.
pub(super) fn picture(args: &PictureArgs, output: &mut Output) -> anyhow::Result<u8> {
    let format = ImageFormat::from_path(&args.out).ok().filter(ImageFormat::writing_enabled);
    let Some(format) = format else {
        complain(&format!("--out {}: a picture's name ends in .png or .jpg", args.out.display()));
        return Ok(WRONG);
    };
    if let Some(why) =
        clash(&[("the scenario", Some(&args.scenario.scenario))], &[("--out", Some(&args.out))])
    {
        complain(&why);
        return Ok(WRONG);
    }
    let scenario = match args.scenario.load(&[]) {
        Ok(scenario) => scenario,
        Err(faults) => {
            complain(&faults);
            return Ok(WRONG);
        }
    };
    let cell = &scenario.controller.cell;
    let cube = scenario.plant.cube_state.unwrap_or_else(Facelets::solved);
    let scene = before(&scenario.controller, &cube);
    let image = match &args.camera {
        None => outside(&scene, &scenario.controller, (args.width, args.height)),
        Some(name) => {
            let Some(camera) = cell.cameras.iter().find(|c| c.name == *name) else {
                let names: Vec<&str> = cell.cameras.iter().map(|c| c.name.as_str()).collect();
                complain(&format!("--camera {name}: there are {}", names.join(", ")));
                return Ok(WRONG);
            };
            let look = Look { lens_cap: scenario.plant.keys.lens_cap, ..Look::default() };
            Renderer::new(camera.clone(), look, scenario.seed)
                .with_setting(Setting::of(cell))
                .render(&scene, 1.0)
        }
    };
    let mut file = std::io::Cursor::new(Vec::new());
    image.write_to(&mut file, format)?;
    if let Err(error) = save(&args.out, file.get_ref()) {
        complain(&format!("{error:#}"));
        return Ok(WRONG);
    }
    output.line(&format!("{}: {} x {}", args.out.display(), image.width(), image.height()))?;
    Ok(0)
}

/// The cell from outside.
pub(super) fn outside(
    scene: &Scene,
    controller: &ControllerConfig,
    (width, height): (u32, u32),
) -> image::RgbImage {
    overview::cell(scene, &Setting::of(&controller.cell), width, height)
}

/// The scene of a moment, as the operator was shown it: by the controller's belief. `None` where that does not say where
/// the cube is, or how it looks.
pub(super) fn during(snapshot: &Snapshot, controller: &ControllerConfig) -> Option<Scene> {
    let cell = &controller.cell;
    let arm = |view: &ArmView| {
        let ArmJoints { points, flange, tool } = joints_of(&view.frames)?;
        Some(SceneArm {
            points,
            world_from_tool: tool,
            world_from_flange: flange,
            opening: view.opening,
        })
    };
    let arms: Vec<SceneArm> = snapshot.arms.iter().map(arm).collect::<Option<_>>()?;
    let (first, last) = (*arms.first()?, *arms.last()?);
    let facelets: Facelets = snapshot.cube.facelets.parse().ok()?;
    // Clockwise seen from outside is against the axis on its positive side.
    let turned = snapshot.cube.turned.and_then(|turn| {
        let face = *Face::ALL.get(turn.face)?;
        let positive = face.axis().positive_face() == face;
        let (low, high) = if positive { (0.0, -turn.angle) } else { (turn.angle, 0.0) };
        Some((face.axis(), low, high))
    });
    Some(Scene {
        period: 0,
        cube: SceneCube {
            world_from_cube: snapshot.cube.world_from_cube?,
            velocity: Twist::default(),
            edge: cell.cube.edge,
            facelets: *facelets.colours(),
            turned: turned.unwrap_or((Axis::Z, 0.0, 0.0)),
        },
        arms: [first, last],
        arm_count: arms.len().min(2),
        hand: None,
    })
}

/// The scene before a run, by the controller's belief.
fn before(controller: &ControllerConfig, cube: &Facelets) -> Scene {
    let cell = &controller.cell;
    let arms: Vec<SceneArm> = cell
        .arms
        .iter()
        .map(|arm| {
            let world_from_flange = arm.world_from_base * arm.model.base_from_flange(&arm.start);
            SceneArm {
                points: arm.model.points(&arm.start).map(|p| arm.world_from_base * p),
                world_from_tool: world_from_flange * arm.flange_from_tool,
                world_from_flange,
                opening: arm.gripper.opening.1,
            }
        })
        .collect();
    let at = |i: usize| arms[i.min(arms.len() - 1)];
    Scene {
        period: 0,
        cube: SceneCube {
            world_from_cube: cell.hand.world_from_cube,
            velocity: Twist::default(),
            edge: cell.cube.edge,
            facelets: *cube.colours(),
            turned: (Axis::Z, 0.0, 0.0),
        },
        arms: [at(0), at(1)],
        arm_count: arms.len(),
        hand: (cell.keeper == Keeper::Person).then_some(cell.hand.world_from_cube),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operator::{CubeView, LayerTurn, arm_frames};

    #[test]
    fn a_moment_is_drawn_as_its_arms_and_its_cube_stood() {
        let scenario = crate::scenario::read(std::path::Path::new("t.toml"), "", &[]).unwrap();
        let controller = &scenario.controller;
        let cube = Facelets::solved();
        let start = before(controller, &cube);
        let view = |arm: &crate::cell::Arm| ArmView {
            name: arm.name.clone(),
            joints: arm.start.0,
            motors: [0.0; 7],
            frames: arm_frames(arm, &arm.world_from_base, &arm.start),
            opening: arm.gripper.opening.1,
            grip: 0.0,
            wrench: [0.0; 6],
            peak: (0.0, 0.0),
            following: 0.0,
            synchronised: true,
            fault: None,
            remedy: None,
        };
        let mut snapshot = Snapshot {
            arms: controller.cell.arms.iter().map(view).collect(),
            cube: CubeView {
                world_from_cube: Some(start.cube.world_from_cube),
                facelets: cube.to_string(),
                ..CubeView::default()
            },
            ..Snapshot::default()
        };

        let scene = during(&snapshot, controller).unwrap();
        for (now, then) in scene.arms.iter().zip(&start.arms) {
            for (a, b) in now.points.iter().zip(&then.points) {
                assert!((a - b).norm() < 1e-9, "{a} {b}");
            }
            assert!((now.world_from_tool.inverse() * then.world_from_tool).rotation.angle() < 1e-9);
        }
        assert_eq!(scene.cube.facelets, start.cube.facelets);

        let straight = outside(&scene, controller, (48, 36));
        let mut turned = |face: Face| {
            snapshot.cube.turned = Some(LayerTurn { face: face.index(), angle: 0.8 });
            during(&snapshot, controller).unwrap()
        };
        assert_eq!(turned(Face::R).cube.turned, (Axis::X, 0.0, -0.8));
        assert_eq!(turned(Face::F).cube.turned, (Axis::Y, 0.8, 0.0));
        assert_eq!(turned(Face::U).cube.turned, (Axis::Z, 0.0, -0.8));
        let scene = turned(Face::L);
        assert_eq!(scene.cube.turned, (Axis::X, 0.8, 0.0));
        assert!(outside(&scene, controller, (48, 36)) != straight, "a turned layer is seen");

        snapshot.cube.facelets.replace_range(7..8, "-");
        assert!(during(&snapshot, controller).is_none(), "nobody knows how it looks");
    }
}
