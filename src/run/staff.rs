//! The actors of a run, created from the bottom up, and their supervision.
//!
//! - in: the links to the servos, the cameras, the controller's section of the scenario
//! - out: EDPs that are synchronised, VSPs and ECPs, ready for MP

use super::disturbance::InjectedFaults;
use super::failure::not_created;
use super::interrupt::SWITCHES_OFF;
use super::servos::Servos;
use super::settings;
use super::world::Cameras;
use crate::actors::control::permission_soon;
use crate::actors::edp::EdpHandle;
use crate::actors::homing::{self, homed};
use crate::actors::lookout::{self, Apart};
use crate::actors::move_instruction::Manner;
use crate::actors::notice::Notice;
use crate::actors::services::Services;
use crate::actors::vsp::{self, VspHandle};
use crate::actors::watchdog::{Outside, Watchdog, raised};
use crate::actors::{ecp, edp};
use crate::cell::{Cell, Mount};
use crate::error::{Error, NonFatal};
use crate::generators::Behaviour;
use crate::hw::camera::FrameSource;
use crate::motion::PERIOD;
use crate::reach::guard::Guard;
use crate::scenario::keys::{Coordination, Pace};
use crate::scenario::lists::VspKind;
use crate::scenario::{ControllerConfig, Owner, VspConfig};
use crate::tasks::{Effort, Forces};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::watch;

/// Interval of the heartbeat that the servos watch.
const HEARTBEAT: Duration = Duration::from_millis(10);
/// Speed at which an arm goes from its switches to its start (share of the largest).
const START_SPEED: f64 = 0.5;

/// Starts what watches over the actors: the heartbeat, and the hold of all arms after a panic.
/// Returns the watch from a thread outside of the runtime, if `stuck` is to be called.
///
/// An actor that blocks the runtime blocks the run: the caller of the run must end it. The servo's
/// thread, which misses the heartbeat, still switches the drives off; the controllers keep the last
/// drive of a process that is gone.
pub(super) fn supervise(
    servos: &Servos,
    watchdog: &Watchdog,
    faults: &InjectedFaults,
    pace: Pace,
    stuck: Option<fn(Error)>,
) -> Option<Outside> {
    let (beats, heart) = (Arc::clone(&servos.switches), Arc::clone(&faults.heart));
    tokio::spawn(async move {
        loop {
            if !heart.load(Ordering::Acquire) {
                beats.beats.fetch_add(1, Ordering::Relaxed);
            }
            tokio::time::sleep(HEARTBEAT).await;
        }
    });
    // After a panic the arms hold at once; MP learns of it, too, and ends the run.
    let (mut listens, holds) = (watchdog.listen(), Arc::clone(&servos.switches));
    tokio::spawn(async move {
        raised(&mut listens).await;
        holds.hold.store(true, Ordering::Release);
    });
    let stop_button = servos.stop_button.clone();
    stuck.map(|stuck| {
        watchdog.watched_from_outside(patience_outside(pace), move |error| {
            stop_button.press();
            std::thread::sleep(SWITCHES_OFF);
            stuck(error);
        })
    })
}

/// Returns the time, by the wall clock, after which an actor that blocks all others counts as stuck.
/// Arms hold after 0.1 s without a heartbeat, and stop after 1 s. No arm waits for virtual time,
/// where a busy machine may take long.
fn patience_outside(pace: Pace) -> Duration {
    Duration::from_secs(if pace == Pace::Virtual { 10 } else { 1 })
}

/// The drivers of the effectors, and the guard that watches their states.
pub(super) struct Drivers {
    edps: Vec<EdpHandle>,
    /// The arms that are to be synchronised before the task, by index.
    blind: Vec<usize>,
    guard: Guard,
    apart: Apart,
}

/// The actors below MP. EDPs and VSPs end with this: they live until the run has wound down.
pub(super) struct Staff {
    _edps: Vec<EdpHandle>,
    pub(super) ecps: Vec<ecp::EcpHandle>,
    pub(super) sensors: Sensors,
    pub(super) manners: Vec<Manner>,
    pub(super) guard: Guard,
    pub(super) apart: Apart,
}

/// Starts an EDP over each servo, and the guard.
pub(super) fn start_drivers(
    config: &ControllerConfig,
    servos: &mut Servos,
    services: &Services,
    faults: &InjectedFaults,
    by_hand: bool,
) -> Drivers {
    let links = std::mem::take(&mut servos.links);
    let edps: Vec<_> = config
        .cell
        .arms
        .iter()
        .zip(links)
        .enumerate()
        .map(|(i, (arm, link))| edp::spawn(&arm.name, link, &services.under(faults.edps.get(i))))
        .collect();
    let guard = Guard::of(&config.cell, config.control.hand_speed);
    let guard = if by_hand { guard.by_hand() } else { guard };
    let apart = Apart::default();
    let watching = lookout::watch_over(
        guard.clone(),
        edps.iter().map(EdpHandle::watch).collect(),
        servos.stop_button.clone(),
        apart.clone(),
        services.clone(),
    );
    services.supervision.watchdog.spawn("guard", watching);
    // By hand, the operator decides when an arm is synchronised.
    let blind = (0..edps.len()).filter(|&i| !servos.synchronised[i] && !by_hand).collect();
    Drivers { edps, blind, guard, apart }
}

/// Synchronises each arm that does not know where it is.
///
/// # Errors
/// If an arm cannot be synchronised, or the operator terminates the run. A run that is resumed does
/// not synchronise: homing drives axes to their switches and opens jaws, with whatever they hold.
pub(super) async fn home(
    drivers: &Drivers,
    cell: &Cell,
    services: &Services,
    resumes: bool,
) -> Result<(), Error> {
    if let Some(&i) = drivers.blind.first().filter(|_| resumes) {
        let (actor, effector) = ("supervisor".to_owned(), cell.arms[i].name.clone());
        let cause = NonFatal::Lost { effector };
        return Err(Error::NonFatal { actor, place: "resume", cause });
    }
    for &i in &drivers.blind {
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

/// Synchronises an arm; the operator may pause it, and terminate the run before it is done.
async fn home_arm(edp: &EdpHandle, services: &Services) -> Result<(), Error> {
    let (mut control, clock) = (services.control.clone(), &services.clock);
    loop {
        match permission_soon(&mut control).await {
            Some(Ok(())) => {}
            Some(Err(_)) => {
                let cause = NonFatal::Terminated;
                let actor = "supervisor".into();
                return Err(Error::NonFatal { actor, place: "synchronise", cause });
            }
            // A fault must not wait for the operator.
            None => {
                edp.state().await?;
                continue;
            }
        }
        if homed(edp.synchronise(), &mut control, clock).await? {
            return Ok(());
        }
        let now = clock.period() as f64 * PERIOD;
        services.trace.tell(Notice::Note(now, homing::STANDS.to_owned()));
    }
}

/// Starts VSPs and ECPs, and moves the arms that were synchronised to their start.
///
/// # Errors
/// If a VSP has no camera of its own, or an arm does not come to its start.
pub(super) async fn start_actors(
    config: &ControllerConfig,
    drivers: Drivers,
    cameras: Cameras,
    services: &Services,
    faults: &InjectedFaults,
) -> Result<Staff, Error> {
    let Drivers { edps, blind, guard, apart } = drivers;
    let sensors = start_sensors(config, &edps, cameras, services, faults)?;
    let manners: Vec<_> =
        (0..config.cell.arms.len()).map(|effector| settings::manner(config, effector)).collect();
    let ecps: Vec<_> = config
        .cell
        .arms
        .iter()
        .zip(&edps)
        .enumerate()
        .map(|(index, (arm, edp))| {
            let parts = ecp::Parts {
                edp: edp.clone(),
                tracker: sensors.tracker_of(Owner::Ecp(index)),
                hand_camera: sensors.hand_camera_of(Owner::Ecp(index), index),
                manner: manners[index],
                services: services.under(faults.ecps.get(index)),
            };
            ecp::spawn(&arm.name, parts)
        })
        .collect();
    // Homing leaves an axis at its switch; a task begins where the scenario says.
    for &i in &blind {
        let target = config.cell.arms[i].start;
        let start = Behaviour::Joints { target, speed: START_SPEED, seconds: 0.0 };
        tokio::select! {
            biased;
            error = services.supervision.watchdog.raised() => Err(error),
            done = ecps[i].behave(start) => done,
        }?;
    }
    Ok(Staff { _edps: edps, ecps, sensors, manners, guard, apart })
}

/// The VSPs by owner.
#[derive(Default)]
pub(super) struct Sensors {
    trackers: Vec<(Owner, VspHandle)>,
    hand_cameras: Vec<(Owner, usize, VspHandle)>,
    /// The forces of both wrists, if a VSP aggregates them.
    pub(super) forces: Option<watch::Receiver<Forces>>,
}

/// Starts the VSPs that the scenario lists.
fn start_sensors(
    config: &ControllerConfig,
    edps: &[EdpHandle],
    mut cameras: Cameras,
    services: &Services,
    faults: &InjectedFaults,
) -> Result<Sensors, Error> {
    let mut sensors = Sensors::default();
    for wanted in &config.vsps {
        // Under continuous coordination the ECPs only transmit: all readings go to MP.
        let owner =
            if config.coordination == Coordination::Continuous { Owner::Mp } else { wanted.owner };
        match (wanted.kind, wanted.camera) {
            (VspKind::Force, _) => {
                let states = edps.iter().map(EdpHandle::watch).collect();
                sensors.forces = Some(vsp::spawn_forces(services, states, periods(wanted.period)));
            }
            (kind, Some(camera)) => {
                let source = cameras[camera].take().ok_or_else(|| {
                    not_created(&wanted.name, "its camera belongs to another VSP")
                })?;
                let services = services.under(faults.vsps.get(camera));
                let parts = sensor_parts(config, wanted, (camera, source), services);
                let carrier = match config.cell.cameras[camera].mount {
                    Mount::Flange { arm, .. } => Some(arm),
                    Mount::World { .. } => None,
                };
                sensors.add(kind, owner, carrier, vsp::spawn(&wanted.name, parts));
            }
            (_, None) => return Err(not_created(&wanted.name, "it has no camera")),
        }
    }
    Ok(sensors)
}

/// Returns the parts of the VSP behind a camera.
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
        world_from_camera: match believed.mount {
            Mount::World { world_from_camera } => Some(world_from_camera),
            Mount::Flange { .. } => None,
        },
        edge: config.cell.cube.edge,
        method: settings::method(config),
        localisation: Effort(config.vision.localisation),
        face: Effort(config.vision.face),
        frame_periods: periods(wanted.period),
        camera,
        services,
    }
}

/// Returns a time in servo periods, one at least.
fn periods(seconds: f64) -> u64 {
    (seconds / PERIOD).round().max(1.0) as u64
}

impl Sensors {
    fn add(&mut self, kind: VspKind, owner: Owner, carrier: Option<usize>, handle: VspHandle) {
        match (kind, carrier) {
            (VspKind::Cube, _) => self.trackers.push((owner, handle)),
            (VspKind::Face, Some(arm)) => self.hand_cameras.push((owner, arm, handle)),
            (VspKind::Face | VspKind::Force, _) => {}
        }
    }

    /// Returns the stand-alone camera's sensor of an owner.
    pub(super) fn tracker_of(&self, owner: Owner) -> Option<VspHandle> {
        self.trackers.iter().find(|(o, _)| *o == owner).map(|(_, handle)| handle.clone())
    }

    /// Returns the sensor of an owner whose camera is in the hand of `arm`.
    pub(super) fn hand_camera_of(&self, owner: Owner, arm: usize) -> Option<VspHandle> {
        self.hand_cameras
            .iter()
            .find(|(o, a, _)| *o == owner && *a == arm)
            .map(|(_, _, handle)| handle.clone())
    }
}
