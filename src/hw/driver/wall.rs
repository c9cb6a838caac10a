//! The wall driver: a real-time thread on a grid of 2 ms, beside the bridge thread that owns the port.
//!
//! The grid is absolute: a late period does not shift the next. Periods are numbered without gaps: when grid
//! points were missed, the arms held their last set values meanwhile, so motions go on without a jump; the
//! missed points are counted apart. After twenty in a row all motions are broken off.

use super::PERIOD_NANOS;
use super::bridge::{Bridge, BridgePort};
use super::core::{Core, Switches};
use super::realtime::{Clock, RealTime};
use super::stats::Timing;
use crate::hw::port::{Port, PortFault};
use crate::motion::ArmFault;
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc;
use std::thread::JoinHandle;

/// How the wall driver runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WallOptions {
    /// Length of the last part of each wait that is spun away [ns]; 0 to sleep all of it.
    pub spin: u64,
    /// Priority of the servo thread under `SCHED_FIFO`, 6..=99; the bridge has 5 less.
    pub priority: i32,
    /// Do not start at all unless every real-time right is granted.
    pub require_real_time: bool,
}

impl Default for WallOptions {
    fn default() -> Self {
        Self { spin: 100_000, priority: 85, require_real_time: false }
    }
}

/// A running wall driver.
#[derive(Debug)]
pub struct Wall<P> {
    servo: JoinHandle<Timing>,
    bridge: Bridge<P>,
    switches: Arc<Switches>,
    /// Real-time rights that were denied.
    pub warnings: Vec<String>,
}

/// What is left of a wall driver.
#[derive(Debug)]
pub struct WallEnd<P> {
    /// The port, unless the bridge thread panicked.
    pub port: Option<P>,
    /// Why the port failed, if it did.
    pub fault: Option<PortFault>,
    /// How punctual the servo was.
    pub timing: Timing,
}

/// Starts both threads; `hook` is called by the bridge thread after each exchange.
///
/// # Errors
/// What the operating system says, and [`io::ErrorKind::PermissionDenied`] with all that was denied when real
/// time is required.
pub fn spawn_wall<P: Port + 'static>(
    mut core: Core,
    port: P,
    hook: impl FnMut(u64, &mut P) + Send + 'static,
    options: WallOptions,
) -> io::Result<Wall<P>> {
    let switches = Arc::clone(core.switches());
    let (bridge, mut side) = Bridge::spawn(port, core.readings(), options.priority - 5, hook)?;
    let (tell, told) = mpsc::channel();
    let servo = std::thread::Builder::new().name("servo".into()).spawn(move || {
        let mut rights = RealTime::acquire(options.priority);
        let denied = options.require_real_time && !rights.warnings.is_empty();
        let _ = tell.send((denied, std::mem::take(&mut rights.warnings)));
        if denied { Timing::default() } else { run(&mut core, &mut side, options.spin) }
    })?;
    match told.recv() {
        Ok((false, warnings)) => Ok(Wall { servo, bridge, switches, warnings }),
        Ok((true, warnings)) => {
            Err(io::Error::new(io::ErrorKind::PermissionDenied, warnings.join("; ")))
        }
        Err(_) => Err(io::Error::other("the servo thread ended before it began")),
    }
}

impl<P: Port + 'static> Wall<P> {
    /// Whether the servo has ended by itself: the bridge was lost.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.servo.is_finished()
    }

    /// Stops both threads and waits for them.
    #[must_use]
    pub fn stop(self) -> WallEnd<P> {
        self.switches.stop.store(true, Ordering::Release);
        // A panic of a thread was reported by its own message; what it measured is lost.
        let timing = self.servo.join().unwrap_or_default();
        let (port, fault) = match self.bridge.join() {
            Some((port, fault)) => (Some(port), fault),
            None => (None, None),
        };
        WallEnd { port, fault, timing }
    }
}

/// Grid points missed in a row that make a controlled stop.
const MANY: u64 = 20;

/// The real-time loop.
fn run(core: &mut Core, port: &mut BridgePort, spin: u64) -> Timing {
    let clock = Clock;
    let mut timing = Timing::default();
    let mut next = clock.now() + PERIOD_NANOS;
    let mut period = 0;
    while !core.switches().stop.load(Ordering::Acquire) {
        clock.wait_until(next, spin);
        let begun = clock.now();
        timing.wake_up.record(begun.saturating_sub(next));
        period += 1;
        let lost = port.fetch(period, core.readings_mut());
        if lost.is_err() {
            core.trip(period, ArmFault::EmergencyStop);
        }
        port.send(period, core.compute(period));
        let done = clock.now();
        timing.work.record(done - begun);
        next += PERIOD_NANOS;
        if done >= next {
            let missed = (done - next) / PERIOD_NANOS + 1;
            timing.missed += missed;
            next += missed * PERIOD_NANOS;
            if missed >= MANY {
                core.hold(period);
            }
        }
        if lost.is_err() {
            break;
        }
    }
    timing.late_readings = port.late();
    timing
}
