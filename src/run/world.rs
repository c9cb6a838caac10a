//! World of a run: its port, its frame sources, and the truth where it is known.
//!
//! | world | readings | pictures | truth |
//! |---|---|---|---|
//! | simulated plant, with or without serial lines | the plant | rendered, or image files | known |
//! | hardware behind a bridge | the bridge | sockets, or image files | unknown |
//! | recording that is verified | as recorded | none: the sensors' results are recorded | unknown |
//!
//! Disturbances that the plant times but does not have itself (missed periods, misread stickers, a
//! power cut) are carried out here.

use super::disturbance::{CameraFaults, Disturbance, InjectedFaults};
use super::failure::not_created;
use super::world_file::Kept;
use crate::actors::control::Control;
use crate::cell::Arm;
use crate::error::Error;
use crate::hw::camera::{Frame, FrameSource, NoFrame};
use crate::hw::devices::{Devices, NAME_DEVICES, NoDevice};
use crate::hw::emulator::Wired;
use crate::hw::folder::FolderCamera;
use crate::hw::note::{Note, Notes, notes};
use crate::hw::plant::render::PlantCamera;
use crate::hw::plant::{Plant, Verdict};
use crate::hw::port::{Delay, Port, PortFault};
use crate::hw::scene::Scene;
use crate::hw::serial::axis::Rules;
use crate::motion::PERIOD;
use crate::record::playback::Playback;
use crate::registry::Simulation;
use crate::ros::RosCamera;
use crate::scenario::keys::BridgeKind;
use crate::scenario::{CameraSource, ControllerConfig, Scenario, VspConfig};
use crate::servo::io::{ArmDrive, ArmReading};
use rustix::process::Signal;
use std::collections::VecDeque;
use std::sync::Arc;
use tokio::sync::watch;

/// World of a run.
pub(super) struct World {
    kind: Kind,
    /// Control of the run, which is terminated when the bridge fails.
    control: Arc<watch::Sender<Control>>,
    /// File in which the plant keeps its state.
    kept: Option<Kept>,
    /// Disturbances outside the plant, by the index that the plant reports.
    disturbances: Vec<Disturbance>,
    /// Flags of the disturbances, which ports and actors read.
    faults: InjectedFaults,
    /// Stickers that show another colour to the cameras, with that colour.
    misread: Vec<(usize, u8)>,
    /// Number of periods by which the plant is ahead of the servo, which has missed them.
    ahead: u64,
    /// Delay of the servo since the last period.
    delay: Delay,
}

/// Kind of a world.
enum Kind {
    Plant { plant: Plants, scenes: Vec<triple_buffer::Input<Scene>> },
    Bridge(Box<dyn Port>),
    Recording(Playback),
}

/// Plant that is called directly (`Bare`), or over the serial protocol (`Wired`).
enum Plants {
    Bare(Box<Plant>),
    Wired(Box<Wired<Plant>>),
}

impl Plants {
    /// Returns the plant, behind the serial protocol too.
    fn plant(&self) -> &Plant {
        match self {
            Self::Bare(plant) => plant,
            Self::Wired(wired) => wired.world(),
        }
    }

    /// Returns the plant like [`Plants::plant`], for calls that change it.
    fn plant_mut(&mut self) -> &mut Plant {
        match self {
            Self::Bare(plant) => plant,
            Self::Wired(wired) => wired.world_mut(),
        }
    }

    /// Performs a period of the plant as [`Port::exchange`] does.
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

/// Camera of a recording. It has no frames, since the results of its sensor are recorded.
struct RecordedCamera;

impl FrameSource for RecordedCamera {
    fn grab(&mut self, _: u64, _: f64) -> Result<Frame, NoFrame> {
        let reason = "the results of its sensor are recorded, but no pictures".into();
        Err(NoFrame { camera: "recording".into(), reason })
    }
}

/// Camera with injected faults.
struct FaultyCamera {
    source: Box<dyn FrameSource>,
    name: String,
    faults: Arc<CameraFaults>,
    /// Delayed pictures, oldest first. The first one may have arrived already.
    under_way: VecDeque<Frame>,
}

impl FrameSource for FaultyCamera {
    /// Takes a picture and applies the camera's present faults: none, black or late pictures.
    fn grab(&mut self, period: u64, exposure: f64) -> Result<Frame, NoFrame> {
        if self.faults.is_silent() {
            return Err(NoFrame { camera: self.name.clone(), reason: "no picture comes".into() });
        }
        let mut frame = self.source.grab(period, exposure)?;
        if self.faults.is_dark() {
            frame.image.fill(0);
        }
        // The newest picture whose delay has passed is delivered until the next one arrives.
        let late = (self.faults.late() / PERIOD).round() as u64;
        if late == 0 {
            self.under_way.clear();
            return Ok(frame);
        }
        self.under_way.push_back(frame);
        while self.under_way.get(1).is_some_and(|next| next.period + late <= period) {
            self.under_way.pop_front();
        }
        let first = self.under_way.front().filter(|frame| frame.period + late <= period);
        first.cloned().ok_or_else(|| NoFrame {
            camera: self.name.clone(),
            reason: "its picture has not arrived yet".into(),
        })
    }
}

/// Frame source of each camera of the cell; `None` once a sensor has taken it.
pub(super) type Cameras = Vec<Option<Box<dyn FrameSource>>>;

/// Sources of all that the VSPs measure.
pub(super) struct Sources {
    /// Frame sources.
    pub(super) cameras: Cameras,
    /// Parts of the plant that each VSP with a user's own sensor gets, in the scenario's order.
    /// `None` for a VSP of another kind, and for all without a plant.
    pub(super) models: Vec<Option<Simulation>>,
}

impl From<Cameras> for Sources {
    fn from(cameras: Cameras) -> Self {
        Self { cameras, models: Vec::new() }
    }
}

/// Notes of a bridge about lost and late answers; `None` for other worlds.
pub(super) type BridgeNotes = Option<rtrb::Consumer<Note>>;

impl World {
    /// Makes a world of this kind without files and disturbances.
    fn of_kind(kind: Kind, control: &Arc<watch::Sender<Control>>) -> Self {
        Self {
            kind,
            control: Arc::clone(control),
            disturbances: Vec::new(),
            faults: InjectedFaults::default(),
            misread: Vec::new(),
            ahead: 0,
            delay: Delay::default(),
            kept: None,
        }
    }

    /// Creates the world of a plant that is simulated in this process.
    ///
    /// # Errors
    /// If a camera cannot be created.
    pub(super) fn of_plant(
        scenario: &Scenario,
        plant: Plant,
        control: &Arc<watch::Sender<Control>>,
        faults: &InjectedFaults,
    ) -> Result<(Self, Sources), Error> {
        let disturbances = super::simulation::faults(scenario).1;
        let mut scenes = Vec::new();
        let cameras = cameras(&scenario.controller, None, |index| {
            // The camera renders when its sensor asks, from the last scene that was written.
            let (input, output) = triple_buffer::triple_buffer(&plant.scene());
            scenes.push(input);
            let renderer = super::simulation::renderer(scenario, &plant, index)
                .ok_or_else(|| not_created("camera", "the plant does not have this camera"))?;
            // Only a camera that a scenario's fault names is wrapped.
            let source: Box<dyn FrameSource> = Box::new(PlantCamera::new(renderer, output));
            if !disturbances.iter().any(|d| d.camera() == Some(index)) {
                return Ok(source);
            }
            Ok(Box::new(FaultyCamera {
                source,
                name: scenario.controller.cell.cameras[index].name.clone(),
                faults: Arc::clone(&faults.cameras[index]),
                under_way: VecDeque::new(),
            }))
        })?;
        // The models of other devices see the scene in the same way.
        let sensors = &faults.sensors;
        let mut model = |(index, vsp): (usize, &VspConfig)| {
            vsp.own.as_ref().map(|_| {
                let (input, scenes_of_model) = triple_buffer::triple_buffer(&plant.scene());
                scenes.push(input);
                let is_named =
                    |d: &Disturbance| matches!(d, Disturbance::Sensor(named, _) if *named == index);
                let faults = disturbances.iter().any(is_named);
                let faults = faults.then(|| Arc::clone(&sensors[index]));
                Simulation { seed: scenario.seed, scenes: scenes_of_model, faults }
            })
        };
        let models = scenario.controller.vsps.iter().enumerate().map(&mut model).collect();
        let plant = match scenario.bridge.kind {
            BridgeKind::Wire => Plants::Wired(Box::new(super::simulation::wired(scenario, plant))),
            _ => Plants::Bare(Box::new(plant)),
        };
        let kind = Kind::Plant { plant, scenes };
        let world = Self { disturbances, faults: faults.clone(), ..Self::of_kind(kind, control) };
        Ok((world, Sources { cameras, models }))
    }

    /// Creates the world of the hardware of a node, which the scenario's file of devices names:
    /// of MP's node if `node` is `None`.
    ///
    /// # Errors
    /// If a device is missing or cannot be opened, or a jaw's controller would stop at the
    /// scenario's grip.
    pub(super) fn of_hardware(
        scenario: &Scenario,
        node: Option<&str>,
        control: &Arc<watch::Sender<Control>>,
    ) -> Result<(Self, Sources, BridgeNotes), Error> {
        let bridge = &scenario.bridge;
        let failed = |why: NoDevice| not_created("bridge", &why.to_string());
        let devices = scenario
            .load_devices()
            .1
            .map_err(|why| not_created("bridge", &format!("{why}; {NAME_DEVICES}")))?;
        let config = &scenario.controller;
        // A jaw whose controller stops at the ordered grip would drop the cube: refused before any
        // line is open.
        let cards = bridge.kind == BridgeKind::Isa;
        let here = config.network.servos_of(node, config.cell.arms.len());
        let arms: Vec<_> = here.iter().map(|&arm| config.cell.arms[arm].clone()).collect();
        devices.check_grip(&arms, config.control.grip, cards).map_err(failed)?;
        let (to, noted) = notes();
        let rules = Rules { misses: bridge.missed_answers, ..Rules::default() };
        let port = port(bridge.kind, &devices, &arms, rules, to).map_err(failed)?;
        let cameras = cameras(config, node, |index| {
            let camera = &config.cell.cameras[index];
            let device = devices.of_camera(&camera.name).map_err(failed)?;
            let size = (camera.intrinsics.width, camera.intrinsics.height);
            device
                .open(size, devices.has_several_webcams())
                .map_err(|e| not_created("camera", &e.to_string()))
        })?;
        Ok((Self::of_kind(Kind::Bridge(port), control), cameras.into(), Some(noted)))
    }

    /// Creates the world of a recording that is verified. The port returns the recorded readings.
    /// The cameras have no frames, since the results of the sensors are recorded.
    pub(super) fn of_recording(
        cameras: usize,
        playback: Playback,
        control: &Arc<watch::Sender<Control>>,
    ) -> (Self, Sources, BridgeNotes) {
        let nothing = |_| Some(Box::new(RecordedCamera) as Box<dyn FrameSource>);
        let cameras: Cameras = (0..cameras).map(nothing).collect();
        (Self::of_kind(Kind::Recording(playback), control), cameras.into(), None)
    }

    /// Makes the plant keep its state in a file, every tenth of a second.
    pub(super) fn keeping(mut self, kept: Option<Kept>) -> Self {
        self.kept = kept;
        self
    }

    /// Writes the plant's first state to its file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(super) fn begin_keeping(&self, kept: &Kept) -> Result<(), Error> {
        self.plant().map_or(Ok(()), |plant| kept.begin(plant))
    }

    /// Returns the true scene before the cameras; `None` without a plant.
    pub(super) fn scene(&self) -> Option<Scene> {
        match &self.kind {
            Kind::Plant { plant, .. } => Some(plant.plant().scene()),
            Kind::Bridge(_) | Kind::Recording(_) => None,
        }
    }

    /// Returns the plant, for a judge of the run.
    pub(super) fn plant(&self) -> Option<&Plant> {
        match &self.kind {
            Kind::Plant { plant, .. } => Some(plant.plant()),
            Kind::Bridge(_) | Kind::Recording(_) => None,
        }
    }

    /// Shows the scene of this period to the plant's cameras. Returns the true angle of the turning
    /// layer (rad); `None` without a plant.
    pub(super) fn show(&mut self) -> Option<f64> {
        let Kind::Plant { plant, scenes } = &mut self.kind else { return None };
        let plant = plant.plant();
        let mut scene = plant.scene();
        // A misread sticker is misread by every camera; the plant's own cube is not changed.
        for (sticker, colour) in &self.misread {
            scene.cube.facelets[*sticker] = *colour;
        }
        for input in scenes {
            input.write(scene);
        }
        Some(plant.turned())
    }

    /// Returns the plant's verdict; `None` without a plant.
    pub(super) fn verdict(&self) -> Option<Verdict> {
        match &self.kind {
            Kind::Plant { plant, .. } => Some(plant.plant().verdict()),
            Kind::Bridge(_) | Kind::Recording(_) => None,
        }
    }

    /// Logs the true state of plant and cube, to debug a controller with
    /// `RUST_LOG=rubik_robot::truth=trace`.
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
    /// Performs a period of the world, saves the plant's state if it is due, and carries out the
    /// disturbances of this period.
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        // In missed periods the plant's time continues, but the servo's numbers have no gaps.
        let done = match &mut self.kind {
            Kind::Plant { plant, .. } => plant.exchange(period + self.ahead, drives, readings),
            Kind::Bridge(port) => port.exchange(period, drives, readings),
            Kind::Recording(playback) => playback.exchange(period, drives, readings),
        };
        if let (Some(kept), Kind::Plant { plant, .. }) = (&mut self.kept, &self.kind) {
            kept.after(period, plant.plant());
        }
        if let (Err(fault), Kind::Bridge(_)) = (&done, &self.kind) {
            // The operator is informed at once; the task would notice the fault only at its next
            // request to an arm. The message has a thread of its own: a blocked terminal must not
            // keep this thread from switching the drives off again and again (`repeat_stop`).
            let lost = format!(
                "bridge lost: {fault}; every controller was ordered to switch off, but those that \
                 do not answer may still be on"
            );
            let teller = std::thread::Builder::new().name("lost".to_owned());
            let _ = teller.spawn(move || tracing::error!("{lost}"));
            self.control.send_replace(Control::Terminated);
        }
        done?;
        self.disturb(period, drives, readings)
    }

    fn needs_each_period(&self) -> bool {
        match &self.kind {
            Kind::Bridge(port) => port.needs_each_period(),
            Kind::Plant { .. } | Kind::Recording(_) => true,
        }
    }

    fn repeat_stop(&mut self) {
        if let Kind::Bridge(port) = &mut self.kind {
            port.repeat_stop();
        }
    }

    fn delay(&mut self) -> Delay {
        match &mut self.kind {
            Kind::Recording(playback) => playback.delay(),
            Kind::Plant { .. } | Kind::Bridge(_) => std::mem::take(&mut self.delay),
        }
    }
}

impl World {
    /// Carries out the disturbances that begin or end in this period of the plant. In periods that
    /// the servo misses, the plant continues with the last `drives`.
    ///
    /// # Errors
    /// If the port fails in a missed period.
    fn disturb(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        let Kind::Plant { plant, .. } = &mut self.kind else { return Ok(()) };
        let (mut missed, mut power_cut) = (0, false);
        for fault in plant.plant_mut().outside_faults() {
            let Some(what) = self.disturbances.get(fault.which) else { continue };
            tracing::debug!(target: "rubik_robot::truth", ?what, fault.begins, "disturbance");
            // Disturbances of cameras, messages and actors have flags. The world carries out the
            // others itself.
            self.faults.take(what, fault.begins);
            match (*what, fault.begins) {
                (Disturbance::Missed(periods), true) => missed += periods,
                (Disturbance::ClockJump(seconds), true) => self.delay.jump += seconds,
                (Disturbance::PowerCut, true) => power_cut = true,
                (Disturbance::Misread(sticker, colour), true) => {
                    self.misread.push((sticker, colour));
                }
                (Disturbance::Misread(sticker, _), false) => {
                    self.misread.retain(|(which, _)| *which != sticker);
                }
                // Flags are set above. Missed periods, a clock jump and a power cut have no end.
                _ => {}
            }
        }
        if power_cut {
            cut(self.kept.as_ref(), plant.plant());
        }
        // The plant continues with the last drives while the servo misses its periods.
        for _ in 0..missed {
            self.ahead += 1;
            plant.exchange(period + self.ahead, drives, readings)?;
        }
        self.delay.periods += missed;
        Ok(())
    }
}

/// Simulates a power cut: saves the state of the plant in this period if `kept` has a file, and
/// kills this process without any clean-up.
fn cut(kept: Option<&Kept>, plant: &Plant) -> ! {
    if let Some(kept) = kept {
        // If this state cannot be written, the last written one stays, at most a tenth of a second
        // old.
        let _ = kept.begin(plant);
    }
    let killed = rustix::process::kill_process(rustix::process::getpid(), Signal::KILL);
    unreachable!("the process survived SIGKILL: {killed:?}");
}

/// Opens a frame source for each camera of a node, of MP's node if `node` is `None`: image files if
/// the scenario names a folder, or a topic of ROS 2; otherwise what `of_world` creates for the
/// camera's index.
///
/// # Errors
/// If a folder or a camera cannot be opened.
fn cameras(
    config: &ControllerConfig,
    node: Option<&str>,
    mut of_world: impl FnMut(usize) -> Result<Box<dyn FrameSource>, Error>,
) -> Result<Cameras, Error> {
    // A camera without a VSP is on MP's node, where a missing device is reported.
    let is_here = |camera: usize| {
        let vsp = config.vsps.iter().position(|vsp| vsp.camera == Some(camera));
        vsp.map_or(node.is_none(), |vsp| config.network.has_vsp(node, vsp))
    };
    let source = |(index, source): (usize, &CameraSource)| match source {
        _ if !is_here(index) => Ok(None),
        CameraSource::Renderer => of_world(index).map(Some),
        CameraSource::Folder(folder) => {
            FolderCamera::open(&config.cell.cameras[index].name, folder)
                .map(|camera| Some(Box::new(camera) as Box<dyn FrameSource>))
                .map_err(|e| not_created("camera", &e.to_string()))
        }
        CameraSource::Ros(topic) => {
            let camera = &config.cell.cameras[index];
            let size = (camera.intrinsics.width, camera.intrinsics.height);
            RosCamera::open(&camera.name, &config.ros.place(), topic, Some(size))
                .map(|camera| Some(Box::new(camera) as Box<dyn FrameSource>))
                .map_err(|e| not_created("camera", &e.to_string()))
        }
    };
    config.cameras.iter().enumerate().map(source).collect()
}

/// Opens the port of the hardware: the axis controllers' ISA cards, or their serial lines.
fn port(
    kind: BridgeKind,
    devices: &Devices,
    arms: &[Arm],
    rules: Rules,
    notes: Notes,
) -> Result<Box<dyn Port>, NoDevice> {
    match kind {
        BridgeKind::Isa => devices.isa(arms, notes),
        BridgeKind::Serial | BridgeKind::Plant | BridgeKind::Wire => {
            devices.serial(arms, rules, notes).map(|port| Box::new(port) as Box<dyn Port>)
        }
    }
}
