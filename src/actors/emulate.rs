//! The emulator's shell: a scenario's plant behind lines and sockets, until the controller leaves.
//!
//! It alone knows the truth of such a run: the cube at the beginning and at the end, forces, slips.

use super::supervisor::{Plan, not_created};
use crate::cube::Facelets;
use crate::error::{Error, Fatal};
use crate::hw::devices::{CameraDevice, Devices};
use crate::hw::driver::RealTime;
use crate::hw::emulator::{CameraServer, Course, EmulatedArm, Emulator, EmulatorOptions};
use crate::hw::plant::render::PlantCamera;
use crate::hw::plant::{Plant, Verdict};
use crate::motion::PERIOD;
use crate::scenario::{Scenario, keys};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Priority of its thread: as high as `packaging/` grants, since a robot never waits for its controller.
const PRIORITY: i32 = 85;

/// What an emulation came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Emulated {
    /// What was asked of the controller.
    pub task: keys::Task,
    /// The cube at the beginning.
    pub start: Facelets,
    /// The cube at the end.
    pub end: Facelets,
    /// What happened.
    pub verdict: Verdict,
    /// How it went.
    pub course: Course,
    /// Its time [s].
    pub time: f64,
}

/// A folder for sockets that goes away with the emulator.
struct Sockets(PathBuf);

impl Sockets {
    fn new() -> std::io::Result<Self> {
        let path =
            std::env::temp_dir().join(format!("rubik-robot-emulator-{}", std::process::id()));
        // Nobody else may drive the robot, emulated or not.
        std::fs::DirBuilder::new().mode(0o700).create(&path)?;
        Ok(Self(path))
    }
}

impl Drop for Sockets {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A file of devices that goes away with them.
struct DeviceFile(PathBuf);

impl DeviceFile {
    /// Appears at once and whole.
    fn write(path: &Path, devices: &Devices) -> Result<Self, String> {
        let text = devices.text().map_err(|e| e.to_string())?;
        let text = format!(
            "# Devices of a running `rubik-robot emulate`; they go away with it.\n\n{text}"
        );
        let new = path.with_extension(format!("new-{}", std::process::id()));
        std::fs::write(&new, text)
            .and_then(|()| std::fs::rename(&new, path))
            .map_err(|e| format!("{}: {e}", path.display()))?;
        Ok(Self(path.to_owned()))
    }
}

impl Drop for DeviceFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Emulates a scenario's cell until its controller has left, or a signal comes. `devices` is the file that tells a
/// bridge where everything is; `announce` is called when all is open, with the rights that were denied.
///
/// # Errors
/// What could not be opened; what the plant says.
pub fn emulate(
    scenario: &Scenario,
    options: EmulatorOptions,
    devices: &Path,
    announce: impl FnOnce(&Devices, &[String]),
) -> Result<Emulated, Error> {
    let failed = |why: String| not_created("emulator", &why);
    let io = |e: std::io::Error| failed(e.to_string());
    let plant = Plan::of(scenario)?.plant(scenario)?;
    let facelets = |plant: &Plant| {
        Facelets::try_from(plant.verdict().facelets).map_err(|e| failed(e.to_string()))
    };
    let start = facelets(&plant)?;
    let arms: Vec<_> = scenario
        .controller
        .cell
        .arms
        .iter()
        .map(|arm| EmulatedArm { name: arm.name.clone(), has_track: arm.model.has_track })
        .collect();

    let sockets = Sockets::new().map_err(io)?;
    let (mut scenes, mut servers, mut cameras) = (Vec::new(), Vec::new(), Vec::new());
    for (index, camera) in scenario.controller.cell.cameras.iter().enumerate() {
        let (input, output) = triple_buffer::triple_buffer(&plant.scene());
        let renderer = super::plant::renderer(scenario, &plant, index)
            .ok_or_else(|| failed(format!("the plant has no camera \"{}\"", camera.name)))?;
        let socket = sockets.0.join(format!("{}.sock", camera.name));
        let source = Box::new(PlantCamera::new(renderer, output));
        servers.push(CameraServer::start(&socket, source).map_err(io)?);
        scenes.push(input);
        cameras.push(CameraDevice { name: camera.name.clone(), socket });
    }
    let mut emulator = Emulator::open(plant, &arms, options).map_err(io)?;
    let places = Devices { camera: cameras, ..emulator.devices() };
    let _file = DeviceFile::write(devices, &places).map_err(failed)?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in super::interrupt::heard() {
        signal_hook::flag::register(signal, Arc::clone(&stop)).map_err(io)?;
    }

    // The cameras' threads were started before: they keep an ordinary priority.
    let rights = RealTime::acquire(PRIORITY, None);
    announce(&places, &rights.warnings);
    let course = emulator
        .run(&stop, |_, plant| {
            let scene = plant.scene();
            for input in &mut scenes {
                input.write(scene);
            }
        })
        .map_err(|fault| Error::Fatal {
            actor: "emulator".into(),
            place: "plant",
            cause: Fatal::Bridge(fault.to_string()),
            last: None,
        })?;
    let plant = emulator.world();
    Ok(Emulated {
        task: scenario.controller.task,
        start,
        end: facelets(plant)?,
        verdict: plant.verdict(),
        course,
        time: course.periods as f64 * PERIOD,
    })
}
