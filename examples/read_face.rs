//! Reads a cube in a picture: nine colours with their confidences, and the pose.
//!
//!     cargo run --release --example read_face
//!
//! The renderer of the simulated plant draws what the stand-alone camera sees: noise, reflections
//! and a blurred lens included. `rubik-robot vision face PICTURE` reads the pictures of other
//! cameras.

use rubik_robot::cube::{Cube, Facelets};
use rubik_robot::hw::plant::render::{Look, Renderer, Setting};
use rubik_robot::hw::plant::{Plant, PlantConfig};
use rubik_robot::spatial::Pose;
use rubik_robot::tasks;
use rubik_robot::vision::colours::LETTERS;
use rubik_robot::vision::{CubeLocation, DetectorSettings, detect, locate_cube};
use std::error::Error;
use std::path::Path;

/// Result of the reading, with the truth beside it.
#[derive(Debug)]
pub(crate) struct Seen {
    /// Cube that was found.
    pub(crate) location: CubeLocation,
    /// True pose of the cube, with U upwards.
    pub(crate) camera_from_cube: Pose,
    /// True stickers of the cube.
    pub(crate) facelets: Facelets,
}

fn main() -> Result<(), Box<dyn Error>> {
    let Seen { location, camera_from_cube, facelets } = look(2007)?;
    for (number, face) in location.faces.iter().enumerate() {
        println!("face {}, {:.0} px wide:", number + 1, face.width_px());
        for row in 0..3 {
            for tile in 3 * row..3 * row + 3 {
                let (colour, sure) = (usize::from(face.colours[tile]), face.confidences[tile]);
                print!("  {} {:3.0} %", LETTERS[colour], sure * 100.0);
            }
            println!();
        }
    }
    for (name, pose) in [("found", location.camera_from_cube), ("true", camera_from_cube)] {
        let at = pose.translation.vector * 1e3;
        println!("{name:>5} centre: x {:5.1}, y {:5.1}, z {:5.1} mm", at.x, at.y, at.z);
    }
    println!(" true stickers: {facelets}");
    Ok(())
}

/// Draws a cube that is scrambled by `seed` at the place of the hand-over, and finds it.
pub(crate) fn look(seed: u64) -> Result<Seen, Box<dyn Error>> {
    let cell = tasks::read(Path::new("cell"), "task = \"idle\"\n", &[])?.controller.cell;
    let camera = cell.cameras.iter().find(|camera| camera.name == "standalone");
    let camera = camera.ok_or("the cell has no stand-alone camera")?.clone();

    let facelets = Facelets::from(&Cube::scrambled(seed));
    let mut scene = Plant::new(PlantConfig::new(cell.clone()), seed)?.scene();
    scene.cube.facelets = *facelets.colours();
    scene.cube.world_from_cube = cell.hand.world_from_cube;
    let mut renderer =
        Renderer::new(camera.clone(), Look::default(), seed).with_setting(Setting::of(&cell));
    let world_from_camera = renderer.world_from_camera(&scene).ok_or("the camera has no place")?;
    let picture = renderer.render(&scene, 1.0);

    let faces = detect(&picture, None, &DetectorSettings::default())?;
    let location = locate_cube(&faces, &camera.intrinsics, cell.cube.edge, None);
    let camera_from_cube = world_from_camera.inverse() * cell.hand.world_from_cube;
    Ok(Seen { location: location.ok_or("no pose fits the face")?, camera_from_cube, facelets })
}
