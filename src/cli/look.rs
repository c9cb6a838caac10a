//! `rubik-robot vision` and `rubik-robot picture`: pictures in, and pictures out.

use super::output::Output;
use super::{ScenarioArgs, WRONG, complain, frames, locate, vision};
use crate::cube::{Axis, Facelets};
use crate::hw::plant::render::{Look, Renderer, Setting, picture as overview};
use crate::hw::scene::{Scene, SceneArm, SceneCube};
use crate::scenario::ControllerConfig;
use crate::spatial::Twist;
use crate::vision::paper;
use anyhow::Context;
use clap::{Args, Subcommand};
use std::fmt::Write;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot vision face photo.jpg                        faces, corners, colours
  rubik-robot vision face *.png --json                     one line of JSON a picture
  rubik-robot vision colours measured.json                 54 RGB triples -> the cube's facelets
  rubik-robot vision score ../shared/vision                pictures with a manifest.jsonl of the truth
  rubik-robot vision stages photo.jpg                      regions left by each of the paper's filters
Exit code 1 when a picture shows no face, or colours make no cube.")]
pub(super) struct VisionArgs {
    #[command(subcommand)]
    what: What,
}

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
    /// Decide whole cubes from 54 measured colours each: {"1": [r, g, b], ... "54": [r, g, b]}
    Colours {
        /// Files of measured colours (JSON)
        #[arg(required = true)]
        files: Vec<PathBuf>,
        /// One line of JSON a file
        #[arg(long)]
        json: bool,
    },
    /// Compare with the truth in FOLDER/manifest.jsonl and print what share is found and read right
    Score {
        /// Folder of pictures
        folder: PathBuf,
        /// One object instead of a table
        #[arg(long)]
        json: bool,
    },
    /// Say where the cube is, from pictures and their optics
    Locate(locate::LocateArgs),
    /// Compare poses with the truth of frames that `vision render` wrote
    Accuracy(locate::AccuracyArgs),
    /// Write frames of the plant's renderer with exact truth
    Render(frames::RenderArgs),
    /// Count the regions that each stage of the paper's segmentation leaves
    Stages {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// One line of JSON a picture
        #[arg(long)]
        json: bool,
    },
}

/// Returns the exit code.
pub(super) fn look_at(args: &VisionArgs, output: &mut Output) -> anyhow::Result<u8> {
    let (text, all) = match &args.what {
        What::Face { images, json } => vision::face(images, *json),
        What::Colours { files, json } => vision::colours(files, *json),
        What::Score { folder, json } => match vision::score(folder, *json) {
            Ok(text) => (text, true),
            Err(error) => {
                complain(&format!("{error:#}"));
                return Ok(WRONG);
            }
        },
        What::Stages { images, json } => stages(images, *json),
        What::Locate(args) => locate::locate(args),
        What::Accuracy(args) => locate::accuracy(args)?,
        What::Render(args) => {
            let (text, code) = frames::render(args)?;
            output.text(&text)?;
            return Ok(code);
        }
    };
    output.text(&text)?;
    Ok(u8::from(!all))
}

fn stages(images: &[PathBuf], json: bool) -> (String, bool) {
    let (mut text, mut all) = (String::new(), true);
    for path in images {
        let name = path.display();
        let counted = vision::load(path).map(|image| {
            let (width, height) = image.dimensions();
            let (tiles, counts) = paper::tiles(image.as_raw(), width as usize, height as usize);
            (tiles.len(), counts)
        });
        // Writing to a string cannot fail.
        let _ = match counted {
            Ok((tiles, counts)) if json => {
                let line = serde_json::json!({
                    "image": name.to_string(), "regions": counts.regions, "shaped": counts.shaped,
                    "neighboured": counts.neighboured, "tiles": tiles,
                });
                writeln!(text, "{line}")
            }
            Ok((tiles, counts)) => writeln!(
                text,
                "{name}: {} regions, {} shaped like a tile, {} with neighbours, {tiles} tiles",
                counts.regions, counts.shaped, counts.neighboured
            ),
            Err(error) => {
                all = false;
                let reason = format!("{error:#}");
                let object = serde_json::json!({ "image": name.to_string(), "reason": reason });
                if json { writeln!(text, "{object}") } else { writeln!(text, "{name}: {reason}") }
            }
        };
    }
    (text, all)
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
    let scenario = match args.scenario.load(&[]) {
        Ok(scenario) => scenario,
        Err(faults) => {
            complain(&faults);
            return Ok(WRONG);
        }
    };
    let cell = &scenario.controller.cell;
    let setting = Setting::of(cell);
    let cube = scenario.plant.cube_state.unwrap_or_else(Facelets::solved);
    let scene = before(&scenario.controller, &cube);
    let image = match &args.camera {
        None => overview::cell(&scene, &setting, args.width, args.height),
        Some(name) => {
            let Some(camera) = cell.cameras.iter().find(|c| c.name == *name) else {
                let names: Vec<&str> = cell.cameras.iter().map(|c| c.name.as_str()).collect();
                complain(&format!("--camera {name}: there are {}", names.join(", ")));
                return Ok(WRONG);
            };
            let look = Look { lens_cap: scenario.plant.keys.lens_cap, ..Look::default() };
            Renderer::new(camera.clone(), look, scenario.seed)
                .with_setting(setting)
                .render(&scene, 1.0)
        }
    };
    if let Err(error) = image.save(&args.out).with_context(|| args.out.display().to_string()) {
        complain(&format!("{error:#}"));
        return Ok(WRONG);
    }
    output.line(&format!("{}: {} x {}", args.out.display(), image.width(), image.height()))?;
    Ok(0)
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
        hand: Some(cell.hand.world_from_cube),
    }
}
