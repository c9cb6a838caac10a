//! Emulation of a cell: a scenario's plant behind serial lines and sockets, in a process of its
//! own.
//!
//! The controller is another process, which finds the lines by the file of devices. Only the
//! emulator knows the truth of that run: the cube at the beginning and at the end, forces, slips.
//!
//! - in: a scenario, options of the lines, the name of the file of devices
//! - out: [`Emulated`], the plant's verdict, once the controller has disconnected

use super::failure::not_created;
use super::plan::Plan;
use crate::cube::Facelets;
use crate::error::{Error, Fatal};
use crate::hw::camera_device::{CameraDevice, CameraLine};
use crate::hw::devices::{self, Devices};
use crate::hw::driver::RealTime;
use crate::hw::emulator::{CameraServer, Course, EmulatedArm, Emulator, EmulatorOptions};
use crate::hw::new_file::{self, Sync};
use crate::hw::plant::render::PlantCamera;
use crate::hw::plant::{Plant, Verdict};
use crate::hw::scene::Scene;
use crate::motion::PERIOD;
use crate::scenario::Scenario;
use std::fs::File;
use std::io::{ErrorKind, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Real-time priority of the emulator's thread: the highest that `packaging/` grants, since a robot
/// never waits for its controller.
const PRIORITY: i32 = 85;

/// Result of an emulation.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Emulated {
    /// Task of the scenario.
    pub(crate) task: &'static str,
    /// The cube at the beginning.
    pub(crate) start: Facelets,
    /// The cube at the end.
    pub(crate) end: Facelets,
    /// Verdict of the plant.
    pub(crate) verdict: Verdict,
    /// Events of the verdict in the order of time: time (s), whether it is an accident, words.
    pub(crate) events: Vec<(f64, bool, String)>,
    /// Numbers of periods, of stalled periods and of orders.
    pub(crate) course: Course,
    /// Duration by the plant's time (s).
    pub(crate) time: f64,
}

/// Folder for the cameras' sockets, which is removed with the emulator.
struct Sockets(PathBuf);

impl Sockets {
    /// Creates the folder, which only this user may enter.
    ///
    /// # Errors
    /// If the system refuses it, or a folder of this name exists.
    fn new() -> std::io::Result<Self> {
        let path =
            std::env::temp_dir().join(format!("rubik-robot-emulator-{}", std::process::id()));
        // No other user may reach the robot, emulated or not. `create` fails if the name exists.
        std::fs::DirBuilder::new().mode(0o700).create(&path)?;
        Ok(Self(path))
    }
}

impl Drop for Sockets {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// File of devices, which is removed when the devices are. It is locked as long as they exist:
/// after `kill -9` the file is left behind without its lock, and other programs may reuse the names
/// of its lines.
struct DeviceFile {
    path: PathBuf,
    file: File,
}

impl DeviceFile {
    /// Writes the file of devices at `path` and locks it. It is written under another name first
    /// and renamed, so that it appears complete and locked.
    ///
    /// # Errors
    /// If the file cannot be written, or `path` is a file that must not be replaced.
    fn write(path: &Path, devices: &Devices) -> Result<Self, String> {
        let text = devices.text().map_err(|e| e.to_string())?;
        let text = format!(
            "# Devices of a running `rubik-robot emulate`; they exist while it runs.\n\n{text}"
        );
        let fail = |why: &str| format!("{}: {why}", path.display());
        may_be_replaced(path).map_err(|why| fail(&why))?;
        // The lock belongs to the open file, so it survives the renaming.
        new_file::replace_with(path, ".new", Sync::No, |file| file.write_all(text.as_bytes()))
            .map(|file| Self { path: path.to_owned(), file })
            .map_err(|e| fail(&e.to_string()))
    }
}

impl Drop for DeviceFile {
    fn drop(&mut self) {
        // Another emulator may have replaced the file, which then stays.
        if new_file::is_at(&self.file, &self.path).unwrap_or(false) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Checks that there is no file at `path`, or one that this user's emulator has left behind.
///
/// # Errors
/// The reason why the file must not be replaced.
fn may_be_replaced(path: &Path) -> Result<(), String> {
    // The check does not follow a link, which may lead to any file.
    let there = match std::fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error.to_string()),
        Ok(there) => there,
    };
    if !there.is_file() {
        return Err("not a regular file, so it is not replaced".to_owned());
    }
    if there.uid() != rustix::process::geteuid().as_raw() {
        return Err("another user's file, so it is not replaced".to_owned());
    }
    let (file, text) = devices::read(path).map_err(|e| e.to_string())?;
    if !text.lines().any(|line| line == "emulated = true") {
        return Err(
            "not an emulator's file, so it is not replaced; name another file with --devices"
                .to_owned(),
        );
    }
    // The lock counts, not the rest of the text, which another build may have written.
    if devices::is_held(&file).map_err(|e| e.to_string())? {
        return Err("another emulator is running with this file; name another one with --devices"
            .to_owned());
    }
    Ok(())
}

/// Cameras of the plant behind sockets, which are served as long as this lives.
struct Cameras {
    scenes: Vec<triple_buffer::Input<Scene>>,
    devices: Vec<CameraDevice>,
    _servers: Vec<CameraServer>,
    _sockets: Sockets,
}

impl Cameras {
    /// Starts a server for each camera of the cell.
    ///
    /// # Errors
    /// If a socket cannot be created.
    fn start(scenario: &Scenario, plant: &Plant) -> Result<Self, Error> {
        let failed = |why: String| not_created("emulator", &why);
        let io = |e: std::io::Error| failed(e.to_string());
        let sockets = Sockets::new().map_err(io)?;
        let (mut scenes, mut servers, mut devices) = (Vec::new(), Vec::new(), Vec::new());
        for (index, camera) in scenario.controller.cell.cameras.iter().enumerate() {
            let (input, output) = triple_buffer::triple_buffer(&plant.scene());
            let renderer = super::simulation::renderer(scenario, plant, index)
                .ok_or_else(|| failed(format!("the plant has no camera \"{}\"", camera.name)))?;
            let socket = sockets.0.join(format!("{}.sock", camera.name));
            let source = Box::new(PlantCamera::new(renderer, output));
            servers.push(CameraServer::start(&socket, source).map_err(io)?);
            scenes.push(input);
            let line = CameraLine::Socket(socket);
            devices.push(CameraDevice { name: camera.name.clone(), line });
        }
        Ok(Self { scenes, devices, _servers: servers, _sockets: sockets })
    }
}

/// Emulates a scenario's cell until its controller disconnects or a signal arrives. `devices` is
/// the path of the file that tells the controller's bridge where lines and sockets are. `announce`
/// is called when all of these are open; it gets the devices and the real-time rights that were
/// denied.
///
/// # Errors
/// If a line, socket or file cannot be opened, or the plant fails.
pub(crate) fn emulate(
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

    // The file is written last: a bridge that reads it finds everything open.
    let mut cameras = Cameras::start(scenario, &plant)?;
    let mut emulator = Emulator::open(plant, &arms, options).map_err(io)?;
    let places = Devices { camera: cameras.devices.clone(), ..emulator.devices() };
    let _file = DeviceFile::write(devices, &places).map_err(failed)?;
    let stop = Arc::new(AtomicBool::new(false));
    super::interrupt::ignore_others();
    for signal in super::interrupt::ending_signals() {
        signal_hook::flag::register(signal, Arc::clone(&stop)).map_err(io)?;
    }

    // The cameras' threads exist already and keep an ordinary priority: rendering must not delay
    // the lines.
    let rights = RealTime::acquire(PRIORITY, None);
    announce(&places, &rights.warnings);
    let course = emulator
        .run(&stop, |_, plant| {
            let scene = plant.scene();
            for input in &mut cameras.scenes {
                input.write(scene);
            }
        })
        .map_err(|fault| Error::Fatal {
            actor: "emulator".into(),
            place: "plant".into(),
            cause: Fatal::Bridge(fault.to_string()),
            last: None,
        })?;
    let plant = emulator.world();
    let verdict = plant.verdict();
    let names: Vec<&str> = arms.iter().map(|arm| arm.name.as_str()).collect();
    Ok(Emulated {
        task: scenario.controller.task.word(),
        start,
        end: facelets(plant)?,
        events: verdict.described_events(&names, PERIOD).collect(),
        verdict,
        course,
        time: course.periods as f64 * PERIOD,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::testing::Folder;

    /// Returns the device file of an emulator without devices.
    fn emulated() -> Devices {
        Devices { emulated: true, ..Devices::default() }
    }

    /// The file of a running emulator is valid and not replaced. After `kill -9` it is refused as
    /// stale, and the next emulator replaces it.
    #[test]
    fn device_file_is_valid_only_while_emulator_runs() {
        let folder = Folder::new("emulate-lives");
        let path = folder.0.join("devices.toml");

        let file = DeviceFile::write(&path, &emulated()).unwrap();
        assert_eq!(Devices::load(&path), Ok(emulated()));
        let second = DeviceFile::write(&path, &emulated()).err().unwrap_or_default();
        assert!(second.contains("another emulator is running"), "{second}");
        // As after `kill -9`: the file exists without its lock.
        let left = std::fs::read_to_string(&path).unwrap();
        drop(file);
        assert!(!path.exists());
        std::fs::write(&path, left).unwrap();

        let told = Devices::load(&path).unwrap_err().to_string();
        assert!(told.ends_with("the emulator that wrote it has ended"), "{told}");
        assert!(DeviceFile::write(&path, &emulated()).is_ok());
    }

    /// The file has a key that this build does not know, but its lock shows that it is in use.
    #[test]
    fn device_file_locked_by_another_build_is_kept() {
        let folder = Folder::new("emulate-build");
        let path = folder.0.join("devices.toml");
        let mut file = new_file::create(&path).unwrap();
        file.write_all(b"emulated = true\nof_a_later_build = 1\n").unwrap();

        let told = DeviceFile::write(&path, &emulated()).err().unwrap_or_default();
        assert!(told.contains("another emulator is running"), "{told}");
        drop(file);
        assert!(DeviceFile::write(&path, &emulated()).is_ok());
    }

    /// The emulator writes its file of devices neither through a symbolic link nor over the file of
    /// a real robot. An emulator that ends does not remove the file of its successor.
    #[test]
    fn emulator_keeps_device_files_of_robots_and_successors() {
        let folder = Folder::new("emulate-link");
        let (path, other) = (folder.0.join("devices.toml"), folder.0.join("other"));
        std::fs::write(&other, "other").unwrap();
        std::os::unix::fs::symlink(&other, &path).unwrap();

        let told = DeviceFile::write(&path, &emulated()).err().unwrap_or_default();
        assert!(told.contains("not replaced"), "{told}");
        assert_eq!(std::fs::read_to_string(&other).unwrap(), "other");

        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, "# of a robot\n").unwrap();
        let told = DeviceFile::write(&path, &emulated()).err().unwrap_or_default();
        assert!(told.contains("not an emulator's file"), "{told}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "# of a robot\n");

        std::fs::remove_file(&path).unwrap();
        let file = DeviceFile::write(&path, &emulated()).unwrap();
        std::fs::rename(&other, &path).unwrap();
        drop(file);
        assert!(path.exists());
        let left = std::fs::read_dir(&folder.0).unwrap().count();
        assert_eq!(left, 1, "only the successor is left");
    }
}
