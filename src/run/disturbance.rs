//! Faults that are injected outside the plant: at cameras, lines, clocks, actors. The plant says when;
//! the world of a run and the ports carry them out. No kernel sees any of them.
//!
//! - in: [`Disturbance`]s that begin and end, from the world
//! - out: flags and numbers that ports look at ([`InjectedFaults`])

use crate::actors::fault::ActorFault;
use crate::emergency_stop::StopButton;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// An actor that can fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Who {
    /// The coordinator.
    Mp,
    /// The ECP of an arm.
    Ecp(usize),
    /// The EDP of an arm.
    Edp(usize),
    /// The virtual sensor of a camera.
    Vsp(usize),
}

/// A fault; arms and cameras by index, times in seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Disturbance {
    /// The servo misses so many periods in a row.
    Missed(u64),
    /// The clock jumps ahead.
    ClockJump(f64),
    /// A camera is dark.
    Blackout(usize),
    /// A camera is silent.
    Silent(usize),
    /// A camera's pictures come late.
    Late(usize, f64),
    /// A sticker shows another colour.
    Misread(usize, u8),
    /// The next message to an actor comes late.
    LateMessage(Who, f64),
    /// The next message to an actor is lost.
    Lost(Who),
    /// The next message to a servo comes twice.
    Duplicated(usize),
    /// An actor panics.
    Panic(Who),
    /// An actor answers no more.
    Hang(Who),
    /// An actor answers no more, and lets no other one of its runtime get on.
    Spin(Who),
    /// The heart stops beating.
    HeartBeat,
    /// The recorder's device is full.
    DiskFull,
    /// The operator presses the emergency stop.
    EmergencyStop,
    /// The power goes.
    PowerCut,
}

impl Disturbance {
    /// The camera that it befalls.
    pub(super) fn camera(&self) -> Option<usize> {
        match *self {
            Self::Blackout(camera) | Self::Silent(camera) | Self::Late(camera, _) => Some(camera),
            _ => None,
        }
    }
}

/// The faults of a camera.
#[derive(Debug, Default)]
pub(super) struct Blinkers {
    dark: AtomicBool,
    silent: AtomicBool,
    /// (ms)
    late: AtomicU64,
}

impl Blinkers {
    pub(super) fn is_dark(&self) -> bool {
        self.dark.load(Ordering::Acquire)
    }

    pub(super) fn is_silent(&self) -> bool {
        self.silent.load(Ordering::Acquire)
    }

    /// By how much pictures are late (s).
    pub(super) fn late(&self) -> f64 {
        self.late.load(Ordering::Acquire) as f64 * 1e-3
    }
}

/// All flags that the ports look at, by index of arm and camera.
#[derive(Debug, Clone, Default)]
pub(super) struct InjectedFaults {
    pub(super) ecps: [Arc<ActorFault>; 2],
    pub(super) edps: [Arc<ActorFault>; 2],
    pub(super) vsps: Vec<Arc<ActorFault>>,
    pub(super) mp: Arc<ActorFault>,
    pub(super) cameras: Vec<Arc<Blinkers>>,
    /// The heart has stopped.
    pub(super) heart: Arc<AtomicBool>,
    /// The device of the recorder is full.
    pub(super) disk: Arc<AtomicBool>,
    /// The emergency stop of the operator's desk.
    pub(super) emergency: StopButton,
}

impl InjectedFaults {
    /// Of a cell with so many cameras.
    pub(super) fn new(cameras: usize) -> Self {
        Self {
            vsps: (0..cameras).map(|_| Arc::default()).collect(),
            cameras: (0..cameras).map(|_| Arc::default()).collect(),
            ..Self::default()
        }
    }

    fn of(&self, who: Who) -> Option<&Arc<ActorFault>> {
        match who {
            Who::Mp => Some(&self.mp),
            Who::Ecp(arm) => self.ecps.get(arm),
            Who::Edp(arm) => self.edps.get(arm),
            Who::Vsp(camera) => self.vsps.get(camera),
        }
    }

    /// Sets the flags of a disturbance that begins or ends; the world handles its own disturbances.
    pub(super) fn take(&self, what: &Disturbance, begins: bool) {
        let ms = |seconds: f64| if begins { (seconds * 1e3).round() as u64 } else { 0 };
        match *what {
            Disturbance::Blackout(camera) => {
                self.cameras[camera].dark.store(begins, Ordering::Release);
            }
            Disturbance::Silent(camera) => {
                self.cameras[camera].silent.store(begins, Ordering::Release);
            }
            Disturbance::Late(camera, by) => {
                self.cameras[camera].late.store(ms(by), Ordering::Release);
            }
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
            Disturbance::HeartBeat => self.heart.store(begins, Ordering::Release),
            Disturbance::DiskFull => self.disk.store(begins, Ordering::Release),
            // A button that latches: whoever pressed it does not release it.
            Disturbance::EmergencyStop => self.emergency.press(),
            Disturbance::Missed(_)
            | Disturbance::ClockJump(_)
            | Disturbance::Misread(..)
            | Disturbance::PowerCut => {}
        }
    }
}
