//! The emulator's shell: a scenario's plant behind lines and sockets, until the controller leaves.
//!
//! It alone knows the truth of such a run: the cube at the beginning and at the end, forces, slips.

use super::failure::not_created;
use super::plan::Plan;
use crate::cube::Facelets;
use crate::error::{Error, Fatal};
use crate::hw::devices::{self, CameraDevice, Devices};
use crate::hw::driver::RealTime;
use crate::hw::emulator::{CameraServer, Course, EmulatedArm, Emulator, EmulatorOptions};
use crate::hw::plant::render::PlantCamera;
use crate::hw::plant::{Plant, Verdict};
use crate::hw::scene::Scene;
use crate::motion::PERIOD;
use crate::scenario::{Scenario, keys};
use std::fs::File;
use std::io::{ErrorKind, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Priority of its thread: as high as `packaging/` grants, since a robot never waits for its controller.
const PRIORITY: i32 = 85;

/// What an emulation came to.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Emulated {
    /// What was asked of the controller.
    pub(crate) task: keys::Task,
    /// The cube at the beginning.
    pub(crate) start: Facelets,
    /// The cube at the end.
    pub(crate) end: Facelets,
    /// What happened.
    pub(crate) verdict: Verdict,
    /// The same in its order: time (s), whether it is an accident, and in words.
    pub(crate) told: Vec<(f64, bool, String)>,
    /// How it went.
    pub(crate) course: Course,
    /// Its time (s).
    pub(crate) time: f64,
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

/// A file of devices that goes away with them. It is locked until then: after `kill -9` it is left behind, and its lines'
/// names become others'.
struct DeviceFile {
    path: PathBuf,
    file: File,
}

impl DeviceFile {
    /// Appears at once and whole.
    fn write(path: &Path, devices: &Devices) -> Result<Self, String> {
        let text = devices.text().map_err(|e| e.to_string())?;
        let text = format!(
            "# Devices of a running `rubik-robot emulate`; they go away with it.\n\n{text}"
        );
        let fail = |why: &str| format!("{}: {why}", path.display());
        may_be_replaced(path).map_err(|why| fail(&why))?;
        let new = path.with_extension(format!("new-{}", std::process::id()));
        // An emulator of the same number, which was killed, may have left one.
        let _ = std::fs::remove_file(&new);
        locked(&new, &text)
            .and_then(|file| std::fs::rename(&new, path).map(|()| file))
            .map(|file| Self { path: path.to_owned(), file })
            .map_err(|e| {
                let _ = std::fs::remove_file(&new);
                fail(&e.to_string())
            })
    }

    /// Whether its name is still its own.
    fn is_there(&self) -> std::io::Result<bool> {
        let (at, own) = (std::fs::symlink_metadata(&self.path)?, self.file.metadata()?);
        Ok((at.dev(), at.ino()) == (own.dev(), own.ino()))
    }
}

impl Drop for DeviceFile {
    fn drop(&mut self) {
        if self.is_there().unwrap_or(false) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// A new file with this text, which nobody else may read, and which is locked before it has any. In a folder that
/// others may write to, too, a name can be theirs: nothing that is there already is opened.
fn locked(path: &Path, text: &str) -> std::io::Result<File> {
    let mut file = File::options().write(true).create_new(true).mode(0o600).open(path)?;
    file.try_lock().map_err(std::io::Error::from)?;
    file.write_all(text.as_bytes())?;
    Ok(file)
}

/// Whether what stands there, if anything does, is this user's and nobody needs it; or why not.
fn may_be_replaced(path: &Path) -> Result<(), String> {
    let there = match std::fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error.to_string()),
        Ok(there) => there,
    };
    if !there.is_file() {
        return Err("not a regular file, and not replaced".to_owned());
    }
    if there.uid() != rustix::process::geteuid().as_raw() {
        return Err("another user's file, and not replaced".to_owned());
    }
    let (file, text) = devices::read(path).map_err(|e| e.to_string())?;
    if !text.lines().any(|line| line == "emulated = true") {
        return Err(
            "no emulator's file, and not replaced; name another one by --devices".to_owned()
        );
    }
    // Whatever else stands there: it may be of another build.
    if devices::is_held(&file).map_err(|e| e.to_string())? {
        return Err(
            "another emulator is running behind it; name another file by --devices".to_owned()
        );
    }
    Ok(())
}

/// The cameras of the plant behind sockets, as long as this lives.
struct Cameras {
    scenes: Vec<triple_buffer::Input<Scene>>,
    devices: Vec<CameraDevice>,
    _servers: Vec<CameraServer>,
    _sockets: Sockets,
}

impl Cameras {
    /// Starts a server for each camera of the cell.
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
            devices.push(CameraDevice { name: camera.name.clone(), socket });
        }
        Ok(Self { scenes, devices, _servers: servers, _sockets: sockets })
    }
}

/// Emulates a scenario's cell until its controller has left, or a signal comes. `devices` is the file that tells a
/// bridge where everything is; `announce` is called when all is open, with the rights that were denied.
///
/// # Errors
/// What could not be opened; what the plant says.
pub(crate) fn emulate(
    scenario: &Scenario,
    options: EmulatorOptions,
    devices: &Path,
    announce: impl FnOnce(&Devices, &[String]),
) -> Result<Emulated, Error> {
    let failed = |why: String| not_created("emulator", &why);
    let io = |e: std::io::Error| failed(e.to_string());
    let plant = Plan::of(&scenario.controller)?.plant(scenario)?;
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

    let mut cameras = Cameras::start(scenario, &plant)?;
    let mut emulator = Emulator::open(plant, &arms, options).map_err(io)?;
    let places = Devices { camera: cameras.devices.clone(), ..emulator.devices() };
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
            for input in &mut cameras.scenes {
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
    let verdict = plant.verdict();
    let names: Vec<&str> = arms.iter().map(|arm| arm.name.as_str()).collect();
    Ok(Emulated {
        task: scenario.controller.task,
        start,
        end: facelets(plant)?,
        told: verdict.told(&names, PERIOD).collect(),
        verdict,
        course,
        time: course.periods as f64 * PERIOD,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::testing::Folder;

    fn emulated() -> Devices {
        Devices { emulated: true, ..Devices::default() }
    }

    #[test]
    fn a_file_holds_while_its_emulator_lives_and_no_longer() {
        let folder = Folder::new("emulate-lives");
        let path = folder.0.join("devices.toml");

        let file = DeviceFile::write(&path, &emulated()).unwrap();
        assert_eq!(Devices::load(&path), Ok(emulated()));
        let second = DeviceFile::write(&path, &emulated()).err().unwrap_or_default();
        assert!(second.contains("another emulator is running"), "{second}");
        // Killed: the file stays, its lock does not.
        let left = std::fs::read_to_string(&path).unwrap();
        drop(file);
        assert!(!path.exists());
        std::fs::write(&path, left).unwrap();

        let told = Devices::load(&path).unwrap_err().to_string();
        assert!(told.ends_with("the emulator that wrote it has ended"), "{told}");
        assert!(DeviceFile::write(&path, &emulated()).is_ok());
    }

    #[test]
    fn a_running_emulators_file_is_not_replaced_though_it_says_what_nobody_here_knows() {
        let folder = Folder::new("emulate-build");
        let path = folder.0.join("devices.toml");
        let file = locked(&path, "emulated = true\nof_a_later_build = 1\n").unwrap();

        let told = DeviceFile::write(&path, &emulated()).err().unwrap_or_default();
        assert!(told.contains("another emulator is running"), "{told}");
        drop(file);
        assert!(DeviceFile::write(&path, &emulated()).is_ok());
    }

    #[test]
    fn nothing_is_written_through_a_link_nor_over_a_robots_file_nor_taken_from_a_successor() {
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
        assert!(told.contains("no emulator's file"), "{told}");
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
