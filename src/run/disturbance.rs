//! Faults that are injected outside the plant: into cameras, sensors, messages, clock, actors, and
//! files.
//!
//! The plant decides when these faults begin and end. Cameras, sensors and actors read flags; the
//! world of a run carries out the other faults. The kernel of a task sees none of this.
//!
//! - in: [`Disturbance`]s that begin and end, from the world
//! - out: flags and numbers that cameras, actors and recorder read ([`InjectedFaults`])

use crate::actors::fault::ActorFault;
use crate::cell::PerArm;
use crate::emergency_stop::StopButton;
use crate::hw::storage::{Storage, StorageFault};
use crate::registry::{DeviceFault, DeviceFaults};
use crate::scenario::ControllerConfig;
use crate::scenario::injected::FaultFile;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Actor into which a fault can be injected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Actor {
    /// Coordinator.
    Mp,
    /// ECP of an arm.
    Ecp(usize),
    /// EDP of an arm.
    Edp(usize),
    /// VSP of a camera.
    Vsp(usize),
}

/// Injected fault. Arms and cameras are given by index, times in seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Disturbance {
    /// The servo misses this number of periods in a row.
    Missed(u64),
    /// The clock jumps ahead by this time (s).
    ClockJump(f64),
    /// A camera is dark.
    Blackout(usize),
    /// A camera delivers no pictures.
    Silent(usize),
    /// A camera's pictures come late by this time (s).
    Late(usize, f64),
    /// The device of a user's own sensor fails, given by the index of its VSP.
    Sensor(usize, DeviceFault),
    /// A sticker (0 to 53) shows another colour to all cameras.
    Misread(usize, u8),
    /// The next message to an actor comes late by this time (s).
    LateMessage(Actor, f64),
    /// The next message to an actor is lost.
    Lost(Actor),
    /// The next message to the servo of an arm comes twice.
    Duplicated(usize),
    /// An actor panics.
    Panic(Actor),
    /// An actor no longer answers.
    Hang(Actor),
    /// An actor loops without waiting and blocks all actors of its runtime.
    Spin(Actor),
    /// The heartbeat of the actors stops.
    HeartBeat,
    /// The node with this index dies.
    NodeDies(usize),
    /// The storage of a file fails.
    Storage(FaultFile, StorageFault),
    /// The operator presses the emergency stop.
    EmergencyStop,
    /// The power of the cell and its computer fails.
    PowerCut,
}

impl Disturbance {
    /// Returns the camera that the disturbance affects; `None` if it affects no camera or all of
    /// them.
    pub(super) fn camera(&self) -> Option<usize> {
        match *self {
            Self::Blackout(camera) | Self::Silent(camera) | Self::Late(camera, _) => Some(camera),
            _ => None,
        }
    }
}

/// Flags of a camera's faults.
#[derive(Debug, Default)]
pub(super) struct CameraFaults {
    /// Whether the pictures are black.
    dark: AtomicBool,
    /// Whether no pictures come.
    silent: AtomicBool,
    /// Delay of the pictures (ms).
    late: AtomicU64,
}

impl CameraFaults {
    /// Returns whether the camera's pictures are black.
    pub(super) fn is_dark(&self) -> bool {
        self.dark.load(Ordering::Acquire)
    }

    /// Returns whether the camera delivers no pictures.
    pub(super) fn is_silent(&self) -> bool {
        self.silent.load(Ordering::Acquire)
    }

    /// Returns the delay of the camera's pictures (s).
    pub(super) fn late(&self) -> f64 {
        self.late.load(Ordering::Acquire) as f64 * 1e-3
    }
}

/// Flags of all injected faults, by index of arm and camera.
#[derive(Debug, Clone, Default)]
pub(super) struct InjectedFaults {
    /// Faults of the ECP of each arm.
    pub(super) ecps: PerArm<Arc<ActorFault>>,
    /// Faults of the EDP of each arm.
    pub(super) edps: PerArm<Arc<ActorFault>>,
    /// Faults of the VSP of each camera.
    pub(super) vsps: Vec<Arc<ActorFault>>,
    /// Faults of MP.
    pub(super) mp: Arc<ActorFault>,
    /// Faults of each camera.
    pub(super) cameras: Vec<Arc<CameraFaults>>,
    /// Faults of the device of each VSP with a user's own sensor; unused for other VSPs.
    pub(super) sensors: Vec<Arc<DeviceFaults>>,
    /// Whether the heartbeat of the actors has stopped.
    pub(super) heart: Arc<AtomicBool>,
    /// Whether each node is dead.
    pub(super) nodes: Vec<Arc<AtomicBool>>,
    /// Storage of the recording.
    pub(super) recording: Storage,
    /// Storage of the journal.
    pub(super) journal: Storage,
    /// Storage of the world's state.
    pub(super) world: Storage,
    /// Button of the operator's emergency stop.
    pub(super) emergency: StopButton,
}

impl InjectedFaults {
    /// Creates the flags of all injected faults, none of them set, for the parts of a cell.
    pub(super) fn new(config: &ControllerConfig) -> Self {
        let cameras = config.cell.cameras.len();
        Self {
            nodes: config.network.nodes.iter().map(|_| Arc::default()).collect(),
            vsps: (0..cameras).map(|_| Arc::default()).collect(),
            cameras: (0..cameras).map(|_| Arc::default()).collect(),
            sensors: config.vsps.iter().map(|_| Arc::default()).collect(),
            ..Self::default()
        }
    }

    /// Returns the flags of an actor; `None` if the cell has no such actor.
    fn of(&self, who: Actor) -> Option<&Arc<ActorFault>> {
        match who {
            Actor::Mp => Some(&self.mp),
            Actor::Ecp(arm) => self.ecps.get(arm),
            Actor::Edp(arm) => self.edps.get(arm),
            Actor::Vsp(camera) => self.vsps.get(camera),
        }
    }

    /// Sets the flags of a disturbance that begins or ends. Missed periods, a clock jump, a misread
    /// sticker and a power cut have no flag: the world simulates them.
    pub(super) fn take(&self, what: &Disturbance, begins: bool) {
        let ms = |seconds: f64| if begins { (seconds * 1e3).round() as u64 } else { 0 };
        match *what {
            // Cameras: the frame source reads the flag at each picture.
            Disturbance::Blackout(camera) => {
                self.cameras[camera].dark.store(begins, Ordering::Release);
            }
            Disturbance::Silent(camera) => {
                self.cameras[camera].silent.store(begins, Ordering::Release);
            }
            Disturbance::Late(camera, by) => {
                self.cameras[camera].late.store(ms(by), Ordering::Release);
            }
            // Sensors: the device reads the flag at each measurement.
            Disturbance::Sensor(vsp, fault) => self.sensors[vsp].set(fault, begins),
            // Actors: the mailbox reads the flag before the next message. A cell with one arm has
            // no second ECP to disturb.
            Disturbance::LateMessage(who, by) => {
                if let Some(fault) = self.of(who) {
                    fault.late.store(ms(by), Ordering::Release);
                }
            }
            Disturbance::Lost(who) => {
                if let Some(fault) = self.of(who) {
                    fault.lost.store(begins, Ordering::Release);
                }
            }
            Disturbance::Duplicated(arm) => {
                self.edps[arm].twice.store(u32::from(begins), Ordering::Release);
            }
            Disturbance::Panic(who) => {
                if let Some(fault) = self.of(who) {
                    fault.panics.store(begins, Ordering::Release);
                }
            }
            Disturbance::Hang(who) => {
                if let Some(fault) = self.of(who) {
                    fault.hangs.store(begins, Ordering::Release);
                }
            }
            Disturbance::Spin(who) => {
                if let Some(fault) = self.of(who) {
                    fault.spins.store(begins, Ordering::Release);
                }
            }
            // Parts of the run as a whole.
            Disturbance::HeartBeat => self.heart.store(begins, Ordering::Release),
            // A node that returns during a run is refused, so its way stays cut.
            Disturbance::NodeDies(node) => {
                if let Some(dead) = self.nodes.get(node).filter(|_| begins) {
                    dead.store(true, Ordering::Release);
                }
            }
            Disturbance::Storage(file, fault) => {
                let storage = match file {
                    FaultFile::Recording => &self.recording,
                    FaultFile::Journal => &self.journal,
                    FaultFile::World => &self.world,
                };
                storage.set(begins.then_some(fault));
            }
            // The button latches, so the end of the fault does not release it.
            Disturbance::EmergencyStop => self.emergency.press(),
            // The world carries these out itself.
            Disturbance::Missed(_)
            | Disturbance::ClockJump(_)
            | Disturbance::Misread(..)
            | Disturbance::PowerCut => {}
        }
    }
}
