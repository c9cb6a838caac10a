//! Actors below MP, created from the bottom up, and their supervision.
//!
//! - in: the links to the servos, the cameras, the controller's section of the scenario
//! - out: EDPs of synchronised arms, VSPs and ECPs, ready for MP

use super::disturbance::InjectedFaults;
use super::failure::not_created;
use super::interrupt::SWITCHES_OFF;
use super::nodes::Nodes;
use super::servos::Servos;
use super::settings;
use super::world::{Cameras, Sources};
use crate::actors::control::permission_soon;
use crate::actors::ecp::Surroundings;
use crate::actors::edp::EdpHandle;
use crate::actors::homing::{self, wait_for_homing};
use crate::actors::lookout::{self, MayMeet};
use crate::actors::manner::manner;
use crate::actors::move_instruction::Manner;
use crate::actors::notice::Notice;
use crate::actors::sensor::{self, SensorHandle};
use crate::actors::services::Services;
use crate::actors::vsp::{self, VspHandle};
use crate::actors::watchdog::{Outside, Watchdog, raised};
use crate::actors::{ecp, edp};
use crate::cell::{Cell, Mount};
use crate::error::{Error, NonFatal};
use crate::generators::Behaviour;
use crate::hw::camera::FrameSource;
use crate::kernel::sensor::SensorKernel;
use crate::kernel::{Effort, Forces};
use crate::motion::{ArmState, PERIOD};
use crate::reach::guard::Guard;
use crate::registry::{SensorEntry, Simulation};
use crate::scenario::declared::ChosenSensor;
use crate::scenario::keys::{Coordination, Pace};
use crate::scenario::lists::VspKind;
use crate::scenario::{ControllerConfig, Owner, VspConfig};
use serde_json::Value;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::watch;

/// Interval of the heartbeat that the servos watch.
const HEARTBEAT: Duration = Duration::from_millis(10);
/// Speed of the motion from the switches to the start (share of the full speed).
const START_SPEED: f64 = 0.5;

/// Starts the supervision of the actors: the heartbeat, and the hold of all arms after a panic. If
/// `stuck` is given, also starts and returns a watch from a thread outside the runtime, which calls
/// `stuck` when an actor blocks all others.
///
/// The blocked run cannot end by itself; `stuck` must end the process. The servo's thread misses
/// the heartbeat and still switches the drives off. It must do so before the process ends: the
/// arms' controllers keep the last drive of a process that is gone.
///
/// # Errors
/// If the system gives no thread for that watch.
pub(super) fn supervise(
    servos: &Servos,
    watchdog: &Watchdog,
    faults: &InjectedFaults,
    pace: Pace,
    stuck: Option<impl FnOnce(Error) + Send + 'static>,
) -> Result<Option<Outside>, Error> {
    let (beats, heart) = (Arc::clone(&servos.switches), Arc::clone(&faults.heart));
    // The heartbeat is a task of the actors' runtime, so it stops if any actor blocks this runtime.
    tokio::spawn(async move {
        loop {
            if !heart.load(Ordering::Acquire) {
                beats.beats.fetch_add(1, Ordering::Relaxed);
            }
            tokio::time::sleep(HEARTBEAT).await;
        }
    });
    // After a panic the arms hold at once. MP listens as well and ends the run.
    let (mut listens, holds) = (watchdog.listen(), Arc::clone(&servos.switches));
    tokio::spawn(async move {
        raised(&mut listens).await;
        holds.hold.store(true, Ordering::Release);
    });
    let stop_button = servos.stop_button.clone();
    let outside = stuck.map(|stuck| {
        watchdog.watched_from_outside(patience_outside(pace), move |error| {
            // The bridge needs a moment to switch the drives off before `stuck` ends the process.
            stop_button.press();
            std::thread::sleep(SWITCHES_OFF);
            stuck(error);
        })
    });
    outside.transpose().map_err(|why| not_created("watch", &why.to_string()))
}

/// Returns the time of the wall clock after which an actor that blocks all others counts as stuck.
/// Real arms hold after 0.1 s without a heartbeat and trip after 1 s. Under virtual time no arm
/// waits, and a busy machine may be slow.
fn patience_outside(pace: Pace) -> Duration {
    Duration::from_secs(if pace == Pace::Virtual { 10 } else { 1 })
}

/// EDPs of the effectors, and the guard that watches their states.
pub(super) struct Drivers {
    /// EDPs as the node of MP sees them.
    edps: Vec<EdpHandle>,
    /// EDPs as actors of their own nodes see them.
    beside: Vec<EdpHandle>,
    /// Indices of the arms that must be synchronised before the task.
    unsynchronised: Vec<usize>,
    /// Guard against collisions.
    guard: Guard,
    /// Word of MP for the lookout: the pairs of arms whose hands may meet.
    may_meet: MayMeet,
}

/// Actors below MP. EDPs and VSPs end when this is dropped, after the run has wound down: a camera
/// still looks while the arms come to rest.
pub(super) struct Staff {
    edps: Vec<EdpHandle>,
    /// ECP of each effector.
    pub(super) ecps: Vec<ecp::EcpHandle>,
    /// VSPs of the scenario.
    pub(super) sensors: Sensors,
    /// Parameters of the generators of each effector.
    pub(super) manners: Vec<Manner>,
    /// Guard against collisions.
    pub(super) guard: Guard,
    /// Word of MP for the lookout: the pairs of arms whose hands may meet.
    pub(super) may_meet: MayMeet,
    /// Nodes beside that of MP.
    pub(super) nodes: Nodes,
}

impl Drivers {
    /// Returns the EDPs as the node of MP sees them.
    pub(super) fn edps(&self) -> &[EdpHandle] {
        &self.edps
    }
}

impl Staff {
    /// Returns the latest states of all arms by their EDPs.
    pub(super) fn arms(&self) -> Vec<ArmState> {
        self.states().iter().map(|state| *state.borrow()).collect()
    }

    /// Returns the states of all arms as their EDPs publish them.
    pub(super) fn states(&self) -> Vec<watch::Receiver<ArmState>> {
        self.edps.iter().map(EdpHandle::watch).collect()
    }
}

/// Starts an EDP for each servo, and the guard against collisions. If the operator moves the arms
/// (`by_hand`), [`home`] synchronises none of them, since the operator decides when.
pub(super) fn start_drivers(
    config: &ControllerConfig,
    servos: &mut Servos,
    services: &Services,
    (faults, nodes): (&InjectedFaults, &Nodes),
    by_hand: bool,
) -> Drivers {
    // Each arm has one link, which its EDP owns from now on.
    let mut links = std::mem::take(&mut servos.links);
    let arms = config.cell.arms.iter().enumerate();
    let beside: Vec<_> = arms
        .filter_map(|(i, arm)| {
            if let Some(home) = nodes.home_of(i) {
                let patience = services.supervision.patience;
                return Some(home.edp(i, &arm.name, patience, &services.clock));
            }
            let link = links.remove(&i)?;
            let periods = u64::from(config.network.lead(i));
            let lead = (periods > 0).then(|| edp::Lead { periods, model: arm.model.clone() });
            let services = services.under(faults.edps.get(i)).across(nodes.of_edp(i));
            Some(edp::spawn_early(&arm.name, link, lead, &services))
        })
        .collect();
    let edps: Vec<_> = beside.iter().enumerate().map(|(i, edp)| nodes.home(i, edp)).collect();
    let guard = Guard::of(&config.cell, config.control.hand_speed);
    let guard = if by_hand { guard.by_hand() } else { guard };
    let may_meet = MayMeet::default();
    // The lookout checks both arms' states every 20 ms and stops them before they touch.
    let watching = lookout::run_lookout(
        guard.clone(),
        nodes.watched(&edps),
        servos.stop_button.clone(),
        may_meet.clone(),
        services.clone(),
    );
    services.supervision.watchdog.spawn("guard", watching);
    // When arms are moved by hand, the operator decides when each arm is synchronised.
    let is_synchronised =
        |i: usize| nodes.is_synchronised(i).or(servos.synchronised.get(&i).copied());
    let unsynchronised =
        (0..edps.len()).filter(|&i| is_synchronised(i) != Some(true) && !by_hand).collect();
    Drivers { edps, beside, unsynchronised, guard, may_meet }
}

/// Synchronises each arm whose position is unknown.
///
/// # Errors
/// If an arm cannot be synchronised, or the operator terminates the run. If the run `resumes`
/// another one, an arm of unknown position is an error: homing moves axes to their switches and
/// opens the jaws, which may hold the cube.
pub(super) async fn home(
    drivers: &Drivers,
    cell: &Cell,
    services: &Services,
    resumes: bool,
) -> Result<(), Error> {
    if let Some(&i) = drivers.unsynchronised.first().filter(|_| resumes) {
        let (actor, effector) = ("supervisor".to_owned(), cell.arms[i].name.clone());
        let cause = NonFatal::Lost { effector };
        return Err(Error::NonFatal { actor, place: "resume".into(), cause });
    }
    // One arm at a time. A panic of any actor ends the wait for the arm.
    for &i in &drivers.unsynchronised {
        let now = services.clock.period() as f64 * PERIOD;
        services.trace.tell(Notice::Phase(now, format!("synchronise {}", cell.arms[i].name)));
        tokio::select! {
            biased;
            error = services.supervision.watchdog.raised() => Err(error),
            done = home_arm(&drivers.edps[i], services) => done,
        }?;
    }
    Ok(())
}

/// Synchronises an arm. The operator may pause its homing, and may terminate the run meanwhile.
///
/// # Errors
/// If the arm fails, or the operator terminates the run.
async fn home_arm(edp: &EdpHandle, services: &Services) -> Result<(), Error> {
    let (mut control, clock) = (services.control.clone(), &services.clock);
    loop {
        match permission_soon(&mut control).await {
            Some(Ok(())) => {}
            Some(Err(_)) => {
                let cause = NonFatal::Terminated;
                let actor = "supervisor".into();
                return Err(Error::NonFatal { actor, place: "synchronise".into(), cause });
            }
            // While the operator pauses, the state is requested, because it reports a fault of the
            // arm.
            None => {
                edp.state().await?;
                continue;
            }
        }
        if wait_for_homing(edp.synchronise(), &mut control, clock).await? {
            return Ok(());
        }
        // The operator interrupted the homing. It is requested again when the operator resumes.
        let now = clock.period() as f64 * PERIOD;
        services.trace.tell(Notice::Note(now, homing::STOPPED_MESSAGE.to_owned()));
    }
}

/// Starts VSPs and ECPs, and moves the arms that were synchronised to their start.
///
/// # Errors
/// If a VSP has no camera of its own, or an arm does not reach its start.
pub(super) async fn start_actors(
    config: &ControllerConfig,
    drivers: Drivers,
    sources: Sources,
    services: &Services,
    (faults, nodes): (&InjectedFaults, Nodes),
) -> Result<Staff, Error> {
    let Drivers { edps, beside, unsynchronised, guard, may_meet } = drivers;
    let sensors = start_sensors(config, &edps, sources, services, (faults, &nodes))?;
    let manners: Vec<_> =
        (0..config.cell.arms.len()).map(|effector| manner(config, effector)).collect();
    let ecps: Vec<_> = config
        .cell
        .arms
        .iter()
        .enumerate()
        .map(|(index, arm)| {
            if let Some(home) = nodes.home_of(index) {
                let (clock, lag) = (services.clock.clone(), config.network.lag());
                let patience = services.supervision.patience;
                let macrostep = manners[index].compliance.macrostep;
                let silence = ecp::silence(macrostep, lag, patience) + patience;
                return home.ecp(index, &arm.name, silence, (clock, lag));
            }
            let way = nodes.of_ecp(index);
            let parts = ecp::Parts {
                // An ECP on another node is beside its EDP.
                edp: if way.is_some() { &beside } else { &edps }[index].clone(),
                tracker: sensors.tracker_of(Owner::Ecp(index)),
                hand_camera: sensors.hand_camera_of(Owner::Ecp(index), index),
                lag: config.network.lag(),
                sensors: sensors.own_of(Owner::Ecp(index)),
                manner: manners[index].clone(),
                programmes: config.programmes.clone(),
                surroundings: Some(Surroundings {
                    effector: index,
                    guard: guard.clone(),
                    states: nodes.states_seen_by(index, &edps, &beside),
                }),
                services: services.under(faults.ecps.get(index)).across(way),
            };
            let ecp = ecp::spawn(&arm.name, parts);
            way.map_or_else(|| ecp.clone(), |way| ecp.clone().across(way))
        })
        .collect();
    // Homing leaves each axis near its switch. The task begins at the scenario's start.
    for &i in &unsynchronised {
        let target = config.cell.arms[i].start;
        let start = Behaviour::Joints { target, speed: START_SPEED, seconds: 0.0 };
        tokio::select! {
            biased;
            error = services.supervision.watchdog.raised() => Err(error),
            done = ecps[i].behave(start) => done,
        }?;
    }
    Ok(Staff { edps, ecps, sensors, manners, guard, may_meet, nodes })
}

/// VSPs, each with the actor that owns it.
#[derive(Default)]
pub(super) struct Sensors {
    trackers: Vec<(Owner, VspHandle)>,
    hand_cameras: Vec<(Owner, usize, VspHandle)>,
    own: Vec<(Owner, SensorHandle)>,
    /// Forces of both wrists, if a VSP aggregates them.
    pub(super) forces: Option<watch::Receiver<Forces>>,
}

/// Starts the VSPs that the scenario lists.
///
/// # Errors
/// If two VSPs have the same camera, or a VSP has none.
fn start_sensors(
    config: &ControllerConfig,
    edps: &[EdpHandle],
    mut sources: Sources,
    services: &Services,
    (faults, nodes): (&InjectedFaults, &Nodes),
) -> Result<Sensors, Error> {
    let mut sensors = Sensors::default();
    for (index, wanted) in config.vsps.iter().enumerate() {
        // Under continuous coordination the ECPs only transmit: all readings go to MP.
        let owner =
            if config.coordination == Coordination::Continuous { Owner::Mp } else { wanted.owner };
        match (wanted.kind, wanted.camera) {
            // Forces come with the arms' states: this VSP has no device of its own.
            (VspKind::Force, _) => {
                let states = edps.iter().map(EdpHandle::watch).collect();
                sensors.forces = Some(vsp::spawn_forces(services, states, periods(wanted.period)));
            }
            (VspKind::Own, _) => {
                let model = sources.models.get_mut(index).and_then(Option::take);
                let parts = sensor::Parts {
                    kernel: own_kernel(config, wanted, model, services)?,
                    periods: periods(wanted.period),
                    states: edps.iter().map(EdpHandle::watch).collect(),
                    services: services.under(None),
                };
                sensors.own.push((owner, sensor::spawn(&wanted.name, parts)));
            }
            (kind, Some(camera)) => {
                let carrier = config.cell.cameras[camera].mount.arm();
                if let Some(home) = nodes.home_of_vsp(index) {
                    // An ECP on that node has the VSP beside it.
                    if !matches!(owner, Owner::Ecp(i) if nodes.home_of(i).is_some()) {
                        sensors.add(kind, owner, carrier, home.vsp(index, &wanted.name));
                    }
                    continue;
                }
                let services = services.under(faults.vsps.get(camera)).across(nodes.of_vsp(index));
                let vsp = camera_vsp(config, wanted, &mut sources.cameras, &services)?;
                // An ECP on another node has its VSPs beside it.
                let is_beside = matches!(owner, Owner::Ecp(i) if nodes.of_ecp(i).is_some());
                let vsp = match nodes.of_vsp(index) {
                    Some(way) if !is_beside => vsp.across(way),
                    _ => vsp,
                };
                sensors.add(kind, owner, carrier, vsp);
            }
            (_, None) => return Err(not_created(&wanted.name, "it has no camera")),
        }
    }
    Ok(sensors)
}

/// Starts the VSP of a camera, whose source it takes from `cameras`.
///
/// # Errors
/// If the VSP has no camera of its own.
pub(super) fn camera_vsp(
    config: &ControllerConfig,
    wanted: &VspConfig,
    cameras: &mut Cameras,
    services: &Services,
) -> Result<VspHandle, Error> {
    let camera = wanted.camera.ok_or_else(|| not_created(&wanted.name, "it has no camera"))?;
    // A frame source has one reader.
    let source = cameras[camera]
        .take()
        .ok_or_else(|| not_created(&wanted.name, "its camera belongs to another VSP"))?;
    let parts = sensor_parts(config, wanted, (camera, source), services.clone());
    Ok(vsp::spawn(&wanted.name, parts))
}

/// Makes the kernel of a user's own sensor with its device, or with the `model` of it.
///
/// # Errors
/// If the sensor or its device cannot be made.
fn own_kernel(
    config: &ControllerConfig,
    wanted: &VspConfig,
    model: Option<Simulation>,
    services: &Services,
) -> Result<Box<dyn SensorKernel>, Error> {
    let refused = |why: String| not_created(&wanted.name, &why);
    // A verification takes the recorded readings and needs no device.
    if services.playback.is_some() {
        return Ok(Box::new(Recorded));
    }
    let declaration = wanted.own.as_ref().map(ChosenSensor::declaration);
    let entry = declaration.and_then(SensorEntry::of_declaration);
    let entry = entry.ok_or_else(|| refused("no registry knows this sensor".to_owned()))?;
    entry.kernel(config, model).map_err(refused)
}

/// Kernel of a sensor whose readings are recorded.
struct Recorded;

impl SensorKernel for Recorded {
    fn measure(&mut self, _: u64, _: &[ArmState]) -> Result<Value, String> {
        Err("its readings are recorded".to_owned())
    }
}

/// Returns the parts of which the VSP of a camera is made: `wanted` are its settings, `source`
/// gives its frames.
fn sensor_parts(
    config: &ControllerConfig,
    wanted: &VspConfig,
    (camera, source): (usize, Box<dyn FrameSource>),
    services: Services,
) -> vsp::Parts {
    let believed = &config.cell.cameras[camera];
    vsp::Parts {
        source,
        intrinsics: believed.intrinsics,
        // Only a camera at a fixed place locates the cube in the world. One in a hand reads faces.
        world_from_camera: match believed.mount {
            Mount::World { world_from_camera } => Some(world_from_camera),
            Mount::Flange { .. } => None,
        },
        edge: config.cell.cube.edge,
        method: settings::method(config),
        pose_by: settings::pose_by(config),
        localisation: Effort(config.vision.localisation),
        face: Effort(config.vision.face),
        frame_periods: periods(wanted.period),
        camera,
        exposure: config.vision.exposure,
        services,
    }
}

/// Converts a time (s) to a number of periods of 2 ms, at least one.
fn periods(seconds: f64) -> u64 {
    (seconds / PERIOD).round().max(1.0) as u64
}

impl Sensors {
    /// Adds a VSP by its kind. `owner` is the actor that uses it, `carrier` the arm that carries
    /// its camera.
    fn add(&mut self, kind: VspKind, owner: Owner, carrier: Option<usize>, handle: VspHandle) {
        match (kind, carrier) {
            (VspKind::Cube, _) => self.trackers.push((owner, handle)),
            (VspKind::Face, Some(arm)) => self.hand_cameras.push((owner, arm, handle)),
            // A task finds the sensor of a face by the arm that carries its camera, so a sensor
            // whose camera no arm carries is never asked.
            (VspKind::Face | VspKind::Force | VspKind::Own, _) => {}
        }
    }

    /// Returns the VSPs of a user's own sensors that an actor owns.
    pub(super) fn own_of(&self, owner: Owner) -> Vec<SensorHandle> {
        let own = self.own.iter().filter(|(o, _)| *o == owner);
        own.map(|(_, handle)| handle.clone()).collect()
    }

    /// Returns the VSP of the stand-alone camera that an actor owns.
    pub(super) fn tracker_of(&self, owner: Owner) -> Option<VspHandle> {
        self.trackers.iter().find(|(o, _)| *o == owner).map(|(_, handle)| handle.clone())
    }

    /// Returns the VSP that an actor owns and whose camera is in the hand of `arm`.
    pub(super) fn hand_camera_of(&self, owner: Owner, arm: usize) -> Option<VspHandle> {
        self.hand_cameras
            .iter()
            .find(|(o, a, _)| *o == owner && *a == arm)
            .map(|(_, _, handle)| handle.clone())
    }
}
