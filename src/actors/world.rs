//! What a run needs of its world: a port, frame sources, and whatever can be known of the truth.
//!
//! Two kinds of world: the simulated plant in this process, and hardware behind a bridge, of which nobody here knows
//! the truth.

use super::control::Control;
use super::supervisor::not_created;
use crate::cell::Cell;
use crate::error::Error;
use crate::hw::camera::{Frame, FrameSource, NoFrame};
use crate::hw::devices::{Devices, NoDevice};
use crate::hw::emulator::Wired;
use crate::hw::folder::FolderCamera;
use crate::hw::note::{Note, Notes, notes};
use crate::hw::plant::render::PlantCamera;
use crate::hw::plant::{Plant, Verdict};
use crate::hw::port::{Port, PortFault};
use crate::hw::scene::Scene;
use crate::hw::serial::axis::Rules;
use crate::hw::socket_camera::SocketCamera;
use crate::motion::PERIOD;
use crate::record::playback::Playback;
use crate::scenario::keys::BridgeKind;
use crate::scenario::{CameraSource, ControllerConfig, Scenario};
use crate::servo::io::{ArmDrive, ArmReading};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::sync::watch;

/// A run's world.
pub(super) struct World {
    kind: Kind,
    /// Told to end the run when the port fails.
    control: Arc<watch::Sender<Control>>,
    /// Where the plant keeps its state, and its seed.
    kept: Option<(PathBuf, u64)>,
}

/// A plant keeps its state so often [servo periods].
const KEPT_EVERY: u64 = 50;

enum Kind {
    Plant { plant: Plants, scenes: Vec<triple_buffer::Input<Scene>> },
    Bridge(Box<dyn Port>),
    Recording(Playback),
}

/// The plant as it is, or behind the serial protocol.
enum Plants {
    Bare(Box<Plant>),
    Wired(Box<Wired<Plant>>),
}

impl Plants {
    fn plant(&self) -> &Plant {
        match self {
            Self::Bare(plant) => plant,
            Self::Wired(wired) => wired.world(),
        }
    }
}

/// A camera that is not there.
struct Nothing;

impl FrameSource for Nothing {
    fn grab(&mut self, _: u64, _: f64) -> Result<Frame, NoFrame> {
        Err(NoFrame { camera: "recording".into(), reason: "its sensor delivers itself".into() })
    }
}

/// A frame source for each camera of the cell.
pub(super) type Cameras = Vec<Option<Box<dyn FrameSource>>>;

/// What a bridge notices on the way.
pub(super) type Noted = Option<rtrb::Consumer<Note>>;

impl World {
    /// The plant in this process.
    pub(super) fn of_plant(
        scenario: &Scenario,
        plant: Plant,
        control: &Arc<watch::Sender<Control>>,
    ) -> Result<(Self, Cameras), Error> {
        let mut scenes = Vec::new();
        let cameras = cameras(&scenario.controller, |index| {
            let (input, output) = triple_buffer::triple_buffer(&plant.scene());
            scenes.push(input);
            let renderer = super::plant::renderer(scenario, &plant, index)
                .ok_or_else(|| not_created("camera", "the plant has no such camera"))?;
            Ok(Box::new(PlantCamera::new(renderer, output)))
        })?;
        let plant = match scenario.bridge.kind {
            BridgeKind::Wire => Plants::Wired(Box::new(super::plant::wired(scenario, plant))),
            _ => Plants::Bare(Box::new(plant)),
        };
        let kind = Kind::Plant { plant, scenes };
        Ok((Self { kind, control: Arc::clone(control), kept: None }, cameras))
    }

    /// The hardware that the scenario's file of devices names.
    pub(super) fn of_hardware(
        scenario: &Scenario,
        control: &Arc<watch::Sender<Control>>,
    ) -> Result<(Self, Cameras, Noted), Error> {
        let bridge = &scenario.bridge;
        let path = bridge.devices_at(&scenario.path);
        let failed = |why: NoDevice| not_created("bridge", &why.to_string());
        let devices = Devices::load(&path).map_err(|why| {
            let help = "start `rubik-robot emulate`, or name your devices there";
            not_created("bridge", &format!("{why}; {help}"))
        })?;
        let config = &scenario.controller;
        let (to, noted) = notes();
        let rules = Rules { misses: bridge.missed_answers, ..Rules::default() };
        let port = port(bridge.kind, &devices, &config.cell, rules, to).map_err(failed)?;
        let cameras = cameras(config, |index| {
            let name = &config.cell.cameras[index].name;
            let device = devices.of_camera(name).map_err(failed)?;
            let camera = SocketCamera::connect(name, &device.socket)
                .map_err(|e| not_created("camera", &e.to_string()))?;
            Ok(Box::new(camera))
        })?;
        Ok((
            Self { kind: Kind::Bridge(port), control: Arc::clone(control), kept: None },
            cameras,
            Some(noted),
        ))
    }

    /// What a recording says: its readings come back, its cameras show nothing, since its sensors deliver themselves.
    pub(super) fn of_recording(
        scenario: &Scenario,
        playback: Playback,
        control: &Arc<watch::Sender<Control>>,
    ) -> (Self, Cameras) {
        let nothing = |_: &CameraSource| Some(Box::new(Nothing) as Box<dyn FrameSource>);
        let cameras = scenario.controller.cameras.iter().map(nothing).collect();
        (
            Self { kind: Kind::Recording(playback), control: Arc::clone(control), kept: None },
            cameras,
        )
    }

    /// A plant that keeps its state in a file, from now on and every tenth of a second.
    pub(super) fn keeping(mut self, path: Option<&Path>, seed: u64) -> Self {
        self.kept = path.map(|path| (path.to_owned(), seed));
        self.keep();
        self
    }

    fn keep(&mut self) {
        let (Some((path, seed)), Kind::Plant { plant, .. }) = (&self.kept, &self.kind) else {
            return;
        };
        if let Err(why) = plant.plant().saved(*seed).write(path) {
            tracing::error!("{}: the plant cannot keep its state: {why}", path.display());
            self.kept = None;
        }
    }

    /// What there is to be seen, where that is known.
    pub(super) fn scene(&self) -> Option<Scene> {
        match &self.kind {
            Kind::Plant { plant, .. } => Some(plant.plant().scene()),
            Kind::Bridge(_) | Kind::Recording(_) => None,
        }
    }

    /// After an exchange: shows the cameras what there is to be seen, and tells the angle of the layer that turns,
    /// where that is known.
    pub(super) fn show(&mut self) -> Option<f64> {
        let Kind::Plant { plant, scenes } = &mut self.kind else { return None };
        let plant = plant.plant();
        let scene = plant.scene();
        for input in scenes {
            input.write(scene);
        }
        Some(plant.turned())
    }

    /// What really happened, where that is known.
    pub(super) fn verdict(&self) -> Option<Verdict> {
        match &self.kind {
            Kind::Plant { plant, .. } => Some(plant.plant().verdict()),
            Kind::Bridge(_) | Kind::Recording(_) => None,
        }
    }

    /// The truth for whoever debugs a controller: `RUST_LOG=rubik_robot::truth=trace`.
    pub(super) fn trace(&self, period: u64) {
        let Kind::Plant { plant, .. } = &self.kind else { return };
        let plant = plant.plant();
        let scene = plant.scene();
        let verdict = plant.verdict();
        let cube = scene.cube.world_from_cube;
        let in_tool = |arm: usize| {
            let tool_from_cube = scene.arms[arm].world_from_tool.inverse() * cube;
            let mm = tool_from_cube.translation.vector * 1e3;
            format!("{:.2} {:.2} {:.2} gap {:.2}", mm.x, mm.y, mm.z, scene.arms[arm].opening * 1e3)
        };
        let angles = verdict.layer_angles.map(f64::to_degrees);
        tracing::trace!(
            target: "rubik_robot::truth",
            "{:.1} s: track {}; postument {}; {:?} layers {:.1} {:.1} deg; {:?}; force {:.1} {:.1}",
            period as f64 * PERIOD,
            in_tool(0),
            in_tool(1),
            verdict.turning,
            angles[0],
            angles[1],
            verdict.cube,
            verdict.arm_peak_force[0],
            verdict.arm_peak_force[1],
        );
    }
}

impl Port for World {
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        let done = match &mut self.kind {
            Kind::Plant { plant: Plants::Bare(plant), .. } => {
                plant.exchange(period, drives, readings)
            }
            Kind::Plant { plant: Plants::Wired(wired), .. } => {
                wired.exchange(period, drives, readings)
            }
            Kind::Bridge(port) => port.exchange(period, drives, readings),
            Kind::Recording(playback) => playback.exchange(period, drives, readings),
        };
        if self.kept.is_some() && period.is_multiple_of(KEPT_EVERY) {
            self.keep();
        }
        if let (Err(fault), Kind::Bridge(_)) = (&done, &self.kind) {
            // The operator learns it now; the task would only learn it when it asks an arm for something.
            tracing::error!("bridge lost: {fault}; power is off, brakes are on");
            self.control.send_replace(Control::Terminated);
        }
        done
    }
}

/// A source for each camera: image files, or what the world has.
fn cameras(
    config: &ControllerConfig,
    mut of_world: impl FnMut(usize) -> Result<Box<dyn FrameSource>, Error>,
) -> Result<Cameras, Error> {
    let source = |(index, source): (usize, &CameraSource)| match source {
        CameraSource::Renderer => of_world(index).map(Some),
        CameraSource::Folder(folder) => {
            FolderCamera::open(&config.cell.cameras[index].name, folder)
                .map(|camera| Some(Box::new(camera) as Box<dyn FrameSource>))
                .map_err(|e| not_created("camera", &e.to_string()))
        }
    };
    config.cameras.iter().enumerate().map(source).collect()
}

fn port(
    kind: BridgeKind,
    devices: &Devices,
    cell: &Cell,
    rules: Rules,
    notes: Notes,
) -> Result<Box<dyn Port>, NoDevice> {
    match kind {
        BridgeKind::Isa => devices.isa(&cell.arms, notes),
        BridgeKind::Serial | BridgeKind::Plant | BridgeKind::Wire => {
            devices.serial(&cell.arms, rules, notes).map(|port| Box::new(port) as Box<dyn Port>)
        }
    }
}
