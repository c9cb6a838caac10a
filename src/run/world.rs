//! What a run needs of its world: a port, frame sources, and whatever can be known of the truth.
//!
//! Two kinds of world: the simulated plant in this process, and hardware behind a bridge, of which nobody here knows
//! the truth.

use super::disturbance::{Blinkers, Disturbance, InjectedFaults};
use super::failure::not_created;
use super::world_file::Kept;
use crate::actors::control::Control;
use crate::cell::Cell;
use crate::error::Error;
use crate::hw::camera::{Frame, FrameSource, NoFrame};
use crate::hw::devices::{Devices, NAME_DEVICES, NoDevice};
use crate::hw::emulator::Wired;
use crate::hw::folder::FolderCamera;
use crate::hw::note::{Note, Notes, notes};
use crate::hw::plant::render::PlantCamera;
use crate::hw::plant::{Plant, Verdict};
use crate::hw::port::{HeldUp, Port, PortFault};
use crate::hw::scene::Scene;
use crate::hw::serial::axis::Rules;
use crate::hw::socket_camera::SocketCamera;
use crate::motion::PERIOD;
use crate::record::playback::Playback;
use crate::scenario::keys::BridgeKind;
use crate::scenario::{CameraSource, ControllerConfig, Scenario};
use crate::servo::io::{ArmDrive, ArmReading};
use rustix::process::Signal;
use std::collections::VecDeque;
use std::sync::Arc;
use tokio::sync::watch;

/// A run's world.
pub(super) struct World {
    kind: Kind,
    /// Told to end the run when the port fails.
    control: Arc<watch::Sender<Control>>,
    /// Where the plant keeps its state.
    kept: Option<Kept>,
    /// What is made to go wrong beside the plant, and where that shows.
    disturbances: Vec<Disturbance>,
    faults: InjectedFaults,
    /// Stickers that show another colour to the cameras.
    misread: Vec<(usize, u8)>,
    /// Periods that the servo has missed: the plant is so far ahead of its numbers.
    ahead: u64,
    held_up: HeldUp,
}

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

    fn plant_mut(&mut self) -> &mut Plant {
        match self {
            Self::Bare(plant) => plant,
            Self::Wired(wired) => wired.world_mut(),
        }
    }

    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        match self {
            Self::Bare(plant) => plant.exchange(period, drives, readings),
            Self::Wired(wired) => wired.exchange(period, drives, readings),
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

/// A camera of which something goes wrong.
struct Blinkered {
    source: Box<dyn FrameSource>,
    name: String,
    blinkers: Arc<Blinkers>,
    /// Pictures that have not come yet, oldest first.
    under_way: VecDeque<Frame>,
}

impl FrameSource for Blinkered {
    fn grab(&mut self, period: u64, exposure: f64) -> Result<Frame, NoFrame> {
        if self.blinkers.is_silent() {
            return Err(NoFrame { camera: self.name.clone(), reason: "no picture comes".into() });
        }
        let mut frame = self.source.grab(period, exposure)?;
        if self.blinkers.is_dark() {
            frame.image.fill(0);
        }
        let late = (self.blinkers.late() / PERIOD).round() as u64;
        if late == 0 {
            self.under_way.clear();
            return Ok(frame);
        }
        self.under_way.push_back(frame);
        // The newest that has come; it is the newest until another one comes.
        while self.under_way.get(1).is_some_and(|next| next.period + late <= period) {
            self.under_way.pop_front();
        }
        let first = self.under_way.front().filter(|frame| frame.period + late <= period);
        first.cloned().ok_or_else(|| NoFrame {
            camera: self.name.clone(),
            reason: "its picture has not come yet".into(),
        })
    }
}

/// A frame source for each camera of the cell.
pub(super) type Cameras = Vec<Option<Box<dyn FrameSource>>>;

/// What a bridge notices on the way.
pub(super) type Noted = Option<rtrb::Consumer<Note>>;

impl World {
    fn around(kind: Kind, control: &Arc<watch::Sender<Control>>) -> Self {
        Self {
            kind,
            control: Arc::clone(control),
            disturbances: Vec::new(),
            faults: InjectedFaults::default(),
            misread: Vec::new(),
            ahead: 0,
            held_up: HeldUp::default(),
            kept: None,
        }
    }

    /// The plant in this process.
    pub(super) fn of_plant(
        scenario: &Scenario,
        plant: Plant,
        control: &Arc<watch::Sender<Control>>,
        faults: &InjectedFaults,
    ) -> Result<(Self, Cameras), Error> {
        let disturbances = super::simulation::faults(scenario).1;
        let mut scenes = Vec::new();
        let cameras = cameras(&scenario.controller, |index| {
            let (input, output) = triple_buffer::triple_buffer(&plant.scene());
            scenes.push(input);
            let renderer = super::simulation::renderer(scenario, &plant, index)
                .ok_or_else(|| not_created("camera", "the plant has no such camera"))?;
            let source: Box<dyn FrameSource> = Box::new(PlantCamera::new(renderer, output));
            if !disturbances.iter().any(|d| d.camera() == Some(index)) {
                return Ok(source);
            }
            Ok(Box::new(Blinkered {
                source,
                name: scenario.controller.cell.cameras[index].name.clone(),
                blinkers: Arc::clone(&faults.cameras[index]),
                under_way: VecDeque::new(),
            }))
        })?;
        let plant = match scenario.bridge.kind {
            BridgeKind::Wire => Plants::Wired(Box::new(super::simulation::wired(scenario, plant))),
            _ => Plants::Bare(Box::new(plant)),
        };
        let kind = Kind::Plant { plant, scenes };
        let world = Self { disturbances, faults: faults.clone(), ..Self::around(kind, control) };
        Ok((world, cameras))
    }

    /// The hardware that the scenario's file of devices names.
    pub(super) fn of_hardware(
        scenario: &Scenario,
        control: &Arc<watch::Sender<Control>>,
    ) -> Result<(Self, Cameras, Noted), Error> {
        let bridge = &scenario.bridge;
        let path = bridge.devices_at(&scenario.path);
        let failed = |why: NoDevice| not_created("bridge", &why.to_string());
        let devices = Devices::load(&path)
            .map_err(|why| not_created("bridge", &format!("{why}; {NAME_DEVICES}")))?;
        let config = &scenario.controller;
        let cards = bridge.kind == BridgeKind::Isa;
        devices.check_grip(&config.cell.arms, config.control.grip, cards).map_err(failed)?;
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
        Ok((Self::around(Kind::Bridge(port), control), cameras, Some(noted)))
    }

    /// What a recording says: its readings come back, its cameras show nothing, since its sensors deliver themselves.
    pub(super) fn of_recording(
        cameras: usize,
        playback: Playback,
        control: &Arc<watch::Sender<Control>>,
    ) -> (Self, Cameras, Noted) {
        let nothing = |_| Some(Box::new(Nothing) as Box<dyn FrameSource>);
        let cameras = (0..cameras).map(nothing).collect();
        (Self::around(Kind::Recording(playback), control), cameras, None)
    }

    /// A plant that keeps its state in a file, from now on and every tenth of a second.
    ///
    /// # Errors
    /// When it cannot.
    pub(super) fn keeping(mut self, kept: Option<Kept>) -> Result<Self, Error> {
        if let (Some(kept), Some(plant)) = (&kept, self.plant()) {
            kept.begin(plant)?;
        }
        self.kept = kept;
        Ok(self)
    }

    /// What there is to be seen, where that is known.
    pub(super) fn scene(&self) -> Option<Scene> {
        match &self.kind {
            Kind::Plant { plant, .. } => Some(plant.plant().scene()),
            Kind::Bridge(_) | Kind::Recording(_) => None,
        }
    }

    /// The plant, for whoever judges the run.
    pub(super) fn plant(&self) -> Option<&Plant> {
        match &self.kind {
            Kind::Plant { plant, .. } => Some(plant.plant()),
            Kind::Bridge(_) | Kind::Recording(_) => None,
        }
    }

    /// After an exchange: shows the cameras what there is to be seen, and tells the angle of the layer that turns,
    /// where that is known.
    pub(super) fn show(&mut self) -> Option<f64> {
        let Kind::Plant { plant, scenes } = &mut self.kind else { return None };
        let plant = plant.plant();
        let mut scene = plant.scene();
        for (sticker, colour) in &self.misread {
            scene.cube.facelets[*sticker] = *colour;
        }
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
            Kind::Plant { plant, .. } => plant.exchange(period + self.ahead, drives, readings),
            Kind::Bridge(port) => port.exchange(period, drives, readings),
            Kind::Recording(playback) => playback.exchange(period, drives, readings),
        };
        if let (Some(kept), Kind::Plant { plant, .. }) = (&mut self.kept, &self.kind) {
            kept.after(period, plant.plant());
        }
        if let (Err(fault), Kind::Bridge(_)) = (&done, &self.kind) {
            // The operator learns it now; the task would only learn it when it asks an arm for something. From a thread of its
            // own: a terminal that takes nothing must not keep this one from insisting that the drives go off.
            let lost = format!(
                "bridge lost: {fault}; every controller was told to switch off, and nobody knows whether those that do not answer did"
            );
            let teller = std::thread::Builder::new().name("lost".to_owned());
            let _ = teller.spawn(move || tracing::error!("{lost}"));
            self.control.send_replace(Control::Terminated);
        }
        done?;
        self.disturb(period, drives, readings)
    }

    fn each_counts(&self) -> bool {
        match &self.kind {
            Kind::Bridge(port) => port.each_counts(),
            Kind::Plant { .. } | Kind::Recording(_) => true,
        }
    }

    fn insist(&mut self) {
        if let Kind::Bridge(port) = &mut self.kind {
            port.insist();
        }
    }

    fn held_up(&mut self) -> HeldUp {
        match &mut self.kind {
            Kind::Recording(playback) => playback.held_up(),
            Kind::Plant { .. } | Kind::Bridge(_) => std::mem::take(&mut self.held_up),
        }
    }
}

impl World {
    /// Carries out what the plant says begins and ends now.
    fn disturb(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        let Kind::Plant { plant, .. } = &mut self.kind else { return Ok(()) };
        let (mut missed, mut power_cut) = (0, false);
        for upset in plant.plant_mut().upsets() {
            let Some(what) = self.disturbances.get(upset.which) else { continue };
            tracing::debug!(target: "rubik_robot::truth", ?what, upset.begins, "disturbance");
            self.faults.take(what, upset.begins);
            match (*what, upset.begins) {
                (Disturbance::Missed(periods), true) => missed += periods,
                (Disturbance::ClockJump(seconds), true) => self.held_up.jump += seconds,
                (Disturbance::PowerCut, true) => power_cut = true,
                (Disturbance::Misread(sticker, colour), true) => {
                    self.misread.push((sticker, colour));
                }
                (Disturbance::Misread(sticker, _), false) => {
                    self.misread.retain(|(which, _)| *which != sticker);
                }
                _ => {}
            }
        }
        if power_cut {
            cut(self.kept.as_ref(), plant.plant());
        }
        // The last drives hold while the servo does not run.
        for _ in 0..missed {
            self.ahead += 1;
            plant.exchange(period + self.ahead, drives, readings)?;
        }
        self.held_up.periods += missed;
        Ok(())
    }
}

/// The power goes: the cell stays as it is in this period, and this process is no more.
fn cut(kept: Option<&Kept>, plant: &Plant) -> ! {
    if let Some(kept) = kept {
        // Where it cannot be kept a real cell would stand there all the same: the state of a moment ago will do.
        let _ = kept.begin(plant);
    }
    let killed = rustix::process::kill_process(rustix::process::getpid(), Signal::KILL);
    unreachable!("nobody outlives this: {killed:?}");
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
