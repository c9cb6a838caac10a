//! What is made to go wrong outside the plant: at cameras, lines, clocks, actors. The plant tells when; the world of a run
//! and whoever stands at a port carry it out. No kernel and no actor's own code sees any of it.
//!
//! - in: [`Disturbance`]s that begin and end, from the world
//! - out: flags and numbers that ports look at ([`Troubles`])

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

/// Somebody who can fail.
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

/// What goes wrong; arms and cameras by index, times in seconds.
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
    /// Somebody presses the emergency stop.
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

/// What befalls one actor.
#[derive(Debug, Default)]
pub(super) struct Mishap {
    panics: AtomicBool,
    hangs: AtomicBool,
    spins: AtomicBool,
    /// [ms]
    late: AtomicU64,
    lost: AtomicBool,
    twice: AtomicU32,
}

/// What befalls a camera.
#[derive(Debug, Default)]
pub(super) struct Blinkers {
    dark: AtomicBool,
    silent: AtomicBool,
    /// [ms]
    late: AtomicU64,
}

impl Blinkers {
    pub(super) fn is_dark(&self) -> bool {
        self.dark.load(Ordering::Acquire)
    }

    pub(super) fn is_silent(&self) -> bool {
        self.silent.load(Ordering::Acquire)
    }

    /// By how much pictures are late [s].
    pub(super) fn late(&self) -> f64 {
        self.late.load(Ordering::Acquire) as f64 * 1e-3
    }
}

impl Mishap {
    /// At the door of an actor, before it gets the message that has come.
    ///
    /// # Panics
    /// When that is what is to happen.
    pub(super) async fn at_the_door(&self) {
        self.befall().await;
        let late = self.late.swap(0, Ordering::AcqRel);
        if late > 0 {
            tokio::time::sleep(std::time::Duration::from_millis(late)).await;
        }
    }

    /// Amid the work of an actor.
    ///
    /// # Panics
    /// When that is what is to happen.
    pub(super) async fn befall(&self) {
        assert!(!self.panics.load(Ordering::Acquire), "a panic was injected");
        if self.hangs.load(Ordering::Acquire) {
            std::future::pending::<()>().await;
        }
        while self.spins.load(Ordering::Acquire) {
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
    }

    /// Whether the message that has come is lost.
    pub(super) fn is_lost(&self) -> bool {
        self.lost.swap(false, Ordering::AcqRel)
    }

    /// Whether the next message to the servo is to come twice.
    pub(super) fn is_doubled(&self) -> bool {
        self.twice.swap(0, Ordering::AcqRel) > 0
    }
}

/// Everything that ports look at, by index of arm and camera.
#[derive(Debug, Clone, Default)]
pub(super) struct Troubles {
    pub(super) ecps: [Arc<Mishap>; 2],
    pub(super) edps: [Arc<Mishap>; 2],
    pub(super) vsps: Vec<Arc<Mishap>>,
    pub(super) mp: Arc<Mishap>,
    pub(super) cameras: Vec<Arc<Blinkers>>,
    /// The heart has stopped.
    pub(super) heart: Arc<AtomicBool>,
    /// The device of the recorder is full.
    pub(super) disk: Arc<AtomicBool>,
    /// The button that the operator has, too.
    pub(super) emergency: Arc<AtomicBool>,
}

impl Troubles {
    /// Of a cell with so many cameras.
    pub(super) fn new(cameras: usize) -> Self {
        Self {
            vsps: (0..cameras).map(|_| Arc::default()).collect(),
            cameras: (0..cameras).map(|_| Arc::default()).collect(),
            ..Self::default()
        }
    }

    fn of(&self, who: Who) -> Option<&Arc<Mishap>> {
        match who {
            Who::Mp => Some(&self.mp),
            Who::Ecp(arm) => self.ecps.get(arm),
            Who::Edp(arm) => self.edps.get(arm),
            Who::Vsp(camera) => self.vsps.get(camera),
        }
    }

    /// A disturbance begins, or is over; what the world itself does is not here.
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
                if let Some(mishap) = self.of(who) {
                    mishap.late.store(ms(by), Ordering::Release);
                }
            }
            Disturbance::Lost(who) => {
                if let Some(mishap) = self.of(who) {
                    mishap.lost.store(begins, Ordering::Release);
                }
            }
            Disturbance::Duplicated(arm) => {
                self.edps[arm].twice.store(u32::from(begins), Ordering::Release);
            }
            Disturbance::Panic(who) => {
                if let Some(mishap) = self.of(who) {
                    mishap.panics.store(begins, Ordering::Release);
                }
            }
            Disturbance::Hang(who) => {
                if let Some(mishap) = self.of(who) {
                    mishap.hangs.store(begins, Ordering::Release);
                }
            }
            Disturbance::Spin(who) => {
                if let Some(mishap) = self.of(who) {
                    mishap.spins.store(begins, Ordering::Release);
                }
            }
            Disturbance::HeartBeat => self.heart.store(begins, Ordering::Release),
            Disturbance::DiskFull => self.disk.store(begins, Ordering::Release),
            // A button that latches: whoever pressed it does not release it.
            Disturbance::EmergencyStop => self.emergency.store(true, Ordering::Release),
            Disturbance::Missed(_)
            | Disturbance::ClockJump(_)
            | Disturbance::Misread(..)
            | Disturbance::PowerCut => {}
        }
    }
}
