//! `rubik-robot picture`: draws the cell of a scenario, or the view of a camera.
//!
//! - in: a scenario; or a snapshot of a recorded run, for `report` and `film`
//! - out: a PNG or JPEG file; or the scene of the snapshot

use super::arguments::ScenarioArgs;
use super::output::{Output, clash, refuse, save};
use crate::cell::{MOST_ARMS, Mount};
use crate::cube::{Axis, Face, Facelets, Keeper};
use crate::hw::plant::render::{Look, Renderer, Setting, picture as overview};
use crate::hw::scene::{MOST_OBJECTS, Scene, SceneArm, SceneCube};
use crate::operator::{ArmJoints, ArmView, Snapshot, joints_of};
use crate::run::objects_before;
use crate::scenario::ControllerConfig;
use crate::spatial::{Pose, Twist};
use clap::Args;
use image::ImageFormat;
use nalgebra::{Point3, Vector3};
use serde_json::json;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot picture scenarios/solve.toml  # cell.png: the cell from outside
  rubik-robot picture scenarios/solve.toml --camera standalone --out view.png
  rubik-robot picture scenarios/solve.toml --frames | tail -n +2 > frames.jsonl

The picture shows the cell before a run: the arms at their start, and the cube in its place. The
view of a camera has the size of the camera's pictures. The line on stdout has name and size (px).
With --frames a line of JSON follows for each frame: name, and places in the picture (px: column,
row) of its origin and of the ends of its axes x, y, z, which are 150 mm long.
Exit codes: 0 drawn, 2 wrong usage or scenario, or the file cannot be written.")]
pub(super) struct PictureArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Write the picture to FILE, as PNG or JPEG by its ending
    #[arg(long, value_name = "FILE", default_value = "cell.png")]
    out: PathBuf,
    /// Name of a camera: draw its view instead of the cell from outside
    #[arg(long)]
    camera: Option<String>,
    /// Print the places of all frames in the view from outside
    #[arg(long, conflicts_with = "camera")]
    frames: bool,
    /// Width of the view from outside (px, 16 to 4096)
    #[arg(long, default_value_t = 1280, value_parser = clap::value_parser!(u32).range(16..=4096))]
    width: u32,
    /// Height of the view from outside (px, 16 to 4096)
    #[arg(long, default_value_t = 800, value_parser = clap::value_parser!(u32).range(16..=4096))]
    height: u32,
}

/// Draws the cell before a run and writes the file; returns the exit code.
pub(super) fn picture(args: &PictureArgs, output: &mut Output) -> anyhow::Result<u8> {
    let format = ImageFormat::from_path(&args.out).ok().filter(ImageFormat::writing_enabled);
    let Some(format) = format else {
        return Err(refuse(format!(
            "--out {}: name a file that ends in .png or .jpg",
            args.out.display()
        )));
    };
    clash(&[("the scenario", Some(&args.scenario.scenario))], &[("--out", Some(&args.out))])?;
    let scenario = args.scenario.load(&[]).map_err(refuse)?;
    let cell = &scenario.controller.cell;
    let cube = scenario.plant.cube_state.unwrap_or_else(Facelets::solved);
    let objects = objects_before(&scenario).map_err(refuse)?;
    let scene = Scene { objects, ..before(&scenario.controller, &cube) };
    let image = match &args.camera {
        None => outside(&scene, &scenario.controller, (args.width, args.height)),
        Some(name) => {
            let Some(camera) = cell.cameras.iter().find(|c| c.name == *name) else {
                let names: Vec<&str> = cell.cameras.iter().map(|c| c.name.as_str()).collect();
                let names = names.join(", ");
                return Err(refuse(format!(
                    "--camera {name}: the scenario has no such camera; it has {names}"
                )));
            };
            let look = Look { lens_cap: scenario.plant.keys.lens_cap, ..Look::default() };
            Renderer::new(camera.clone(), look, scenario.seed)
                .with_setting(Setting::of(cell))
                .render(&scene, 1.0)
        }
    };
    let mut file = std::io::Cursor::new(Vec::new());
    image.write_to(&mut file, format)?;
    save(&args.out, file.get_ref()).map_err(|error| refuse(format!("{error:#}")))?;
    output.line(&format!("{}: {} x {}", args.out.display(), image.width(), image.height()))?;
    if args.frames {
        let size = (args.width, args.height);
        for (name, pose) in frames(&scene, &scenario.controller) {
            let ends = [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()];
            let points = ends.map(|axis| pose * Point3::from(axis * AXIS));
            let places = overview::places_in_cell(&scene, &Setting::of(cell), size, &points);
            let axes = &places[1..];
            output.line(&json!({"name": name, "origin": places[0], "axes": axes}).to_string())?;
        }
    }
    Ok(0)
}

/// Length of an axis of `--frames` (m).
const AXIS: f64 = 0.15;

/// Returns the frames of a scene, each with its name and its pose in the world.
fn frames(scene: &Scene, controller: &ControllerConfig) -> Vec<(String, Pose)> {
    let cell = &controller.cell;
    let mut frames = vec![("world".to_owned(), Pose::identity())];
    for (arm, now) in cell.arms.iter().zip(&scene.arms) {
        frames.push((format!("base of {}", arm.name), arm.world_from_base));
        frames.push((format!("flange of {}", arm.name), now.world_from_flange));
        frames.push((format!("tool of {}", arm.name), now.world_from_tool));
    }
    for camera in &cell.cameras {
        if let Mount::World { world_from_camera } = camera.mount {
            frames.push((format!("camera {}", camera.name), world_from_camera));
        }
    }
    frames.push(("cube".to_owned(), scene.cube.world_from_cube));
    frames
}

/// Draws the cell from outside, in a picture of this width and height (px).
pub(super) fn outside(
    scene: &Scene,
    controller: &ControllerConfig,
    (width, height): (u32, u32),
) -> image::RgbImage {
    overview::cell(scene, &Setting::of(&controller.cell), width, height)
}

/// Returns the scene of a snapshot, as the controller believed it to be. Returns `None` if the
/// controller did not know the pose or the colours of the cube.
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
    let last = arms.len().checked_sub(1)?;
    let facelets: Facelets = snapshot.cube.facelets.parse().ok()?;
    // A turn is clockwise seen from outside, which is a negative angle about a positive axis.
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
        // The entries beyond `arm_count` repeat the last arm.
        arms: std::array::from_fn(|i| arms[i.min(last)]),
        arm_count: arms.len().min(MOST_ARMS),
        hand: None,
        // The controller's recording has no objects of the plant.
        objects: [None; MOST_OBJECTS],
    })
}

/// Returns the scene before a run: the arms at their start, and the cube with these facelets at its
/// place in the person's hand or on the table.
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
    // The entries beyond `arm_count` repeat the last arm.
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
        arms: std::array::from_fn(at),
        arm_count: arms.len(),
        hand: (cell.keeper == Keeper::Person).then_some(cell.hand.world_from_cube),
        objects: [None; MOST_OBJECTS],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operator::{CubeView, LayerTurn, arm_frames};

    /// The cube's frame is at the cube: its pixel has one of the cube's colours, and a cube
    /// elsewhere leaves the pixel to the background.
    #[test]
    fn frame_of_cube_is_where_it_is_drawn() {
        let scenario = crate::tasks::read(std::path::Path::new("t.toml"), "", &[]).unwrap();
        let controller = &scenario.controller;
        let scene = before(controller, &Facelets::solved());
        let size = (480, 300);
        let (name, pose) = frames(&scene, controller).pop().unwrap();
        let centre = Point3::from(pose.translation.vector);
        let setting = Setting::of(&controller.cell);

        let places = overview::places_in_cell(&scene, &setting, size, &[centre]);

        let mut away = scene;
        away.cube.world_from_cube.translation.vector.z -= 0.1;
        let (column, row) = places[0];
        let at =
            |scene: &Scene| *outside(scene, controller, size).get_pixel(column as u32, row as u32);
        assert!(at(&scene) != at(&away), "{name} at {column:.0}, {row:.0}");
    }

    #[test]
    fn picture_shows_objects_of_the_scenario() {
        let read = |text: &str| crate::tasks::read(std::path::Path::new("t.toml"), text, &[]);
        let text = "[[object]]\nname = \"box\"\nsize_mm = [60, 40, 40]\nmass_kg = 0.2\n\
                    xyz_mm = [900, 500, 720]\n";
        let scenario = read(text).unwrap();
        let cube = Facelets::solved();
        let without = before(&scenario.controller, &cube);

        let with = Scene { objects: objects_before(&scenario).unwrap(), ..without };

        let draw = |scene: &Scene| outside(scene, &scenario.controller, (96, 72));
        assert!(draw(&with) != draw(&without), "the box is drawn");
    }

    #[test]
    fn scene_shows_arms_and_cube_of_snapshot() {
        let scenario = crate::tasks::read(std::path::Path::new("t.toml"), "", &[]).unwrap();
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
        assert!(outside(&scene, controller, (48, 36)) != straight, "a turned layer is visible");

        snapshot.cube.facelets.replace_range(7..8, "-");
        assert!(during(&snapshot, controller).is_none(), "one colour is unknown");
    }
}
