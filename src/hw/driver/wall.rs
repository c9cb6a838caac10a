//! The wall driver: a real-time thread on a grid of periods, beside the bridge thread that owns the port.
//!
//! The grid is absolute: a late period does not shift the next. Periods are numbered without gaps: when grid
//! points were missed, the arms held their last set values meanwhile, so motions go on without a jump; the
//! missed points are counted apart. After too many in a row the arms are brought to a stand and stop.
//!
//! Once it runs, the thread makes no system call but the sleep and the wake-up of the bridge, allocates
//! nothing, and takes no lock: `tests/realtime.rs` holds it to that.

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
    /// Length of the last part of each wait that is spun away (ns); 0 to sleep all of it.
    pub spin: u64,
    /// Priority of the servo thread under `SCHED_FIFO`, 6..=99; the bridge has 5 less.
    pub priority: i32,
    /// The core that the servo thread stays on; `None` leaves it to the scheduler.
    pub core: Option<usize>,
    /// Periods missed in a row that stop the arms.
    pub missed_limit: u64,
    /// Do not start at all unless every real-time right is granted.
    pub require_real_time: bool,
}

impl Default for WallOptions {
    fn default() -> Self {
        Self { spin: 100_000, priority: 85, core: None, missed_limit: 50, require_real_time: false }
    }
}

/// A running wall driver. Where it is dropped both threads are stopped and waited for: no way out leaves drives on.
#[derive(Debug)]
pub struct Wall<P> {
    threads: Option<(JoinHandle<Timing>, Bridge<P>)>,
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
    let length = core.length().nanos();
    let (bridge, mut side) =
        Bridge::spawn(port, core.readings(), options.priority - 5, length, hook)?;
    let (tell, told) = mpsc::channel();
    let servo = std::thread::Builder::new().name("servo".into()).spawn(move || {
        let mut rights = RealTime::acquire(options.priority, options.core);
        let denied = options.require_real_time && !rights.warnings.is_empty();
        let _ = tell.send((denied, std::mem::take(&mut rights.warnings)));
        if denied { Timing::default() } else { run(&mut core, &mut side, &options) }
    })?;
    match told.recv() {
        Ok((false, warnings)) => Ok(Wall { threads: Some((servo, bridge)), switches, warnings }),
        Ok((true, warnings)) => {
            Err(io::Error::new(io::ErrorKind::PermissionDenied, warnings.join("; ")))
        }
        Err(_) => Err(io::Error::other("the servo thread ended before it began")),
    }
}

impl<P> Wall<P> {
    /// Whether the servo has ended by itself: the bridge was lost.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.threads.as_ref().is_none_or(|(servo, _)| servo.is_finished())
    }

    /// Stops both threads and waits for them.
    #[must_use]
    pub fn stop(mut self) -> WallEnd<P> {
        self.end().unwrap_or(WallEnd { port: None, fault: None, timing: Timing::default() })
    }

    fn end(&mut self) -> Option<WallEnd<P>> {
        let (servo, bridge) = self.threads.take()?;
        self.switches.stop.store(true, Ordering::Release);
        // A panic of a thread was reported by its own message; what it measured is lost.
        let timing = servo.join().unwrap_or_default();
        let (port, fault) = match bridge.join() {
            Some((port, fault)) => (Some(port), fault),
            None => (None, None),
        };
        Some(WallEnd { port, fault, timing })
    }
}

impl<P> Drop for Wall<P> {
    fn drop(&mut self) {
        self.end();
    }
}

/// Goes on along the grid of so long periods until `next` lies ahead of `now`, all in (ns); how
/// many points that passes over.
pub(crate) fn pass(next: &mut u64, length: u64, now: u64) -> u64 {
    let missed = if now < *next { 0 } else { (now - *next) / length + 1 };
    *next += missed * length;
    missed
}

/// The real-time loop.
fn run(core: &mut Core, port: &mut BridgePort, options: &WallOptions) -> Timing {
    let clock = Clock;
    let length = core.length().nanos();
    let spin = options.spin.min(length / 2);
    let mut timing = Timing::default();
    let mut next = clock.now() + length;
    let mut period = 0;
    // When the last period began, if it was the grid point before.
    let mut last: Option<u64> = None;
    // Grid points that passed since then.
    let mut missed = 0;
    while !core.switches().stop.load(Ordering::Acquire) {
        clock.wait_until(next, spin);
        let begun = clock.now();
        let late = begun.saturating_sub(next);
        timing.wake_up.record(late);
        if let Some(last) = last {
            timing.jitter.record((begun - last).abs_diff(length));
        }
        next += length;
        let passed = pass(&mut next, length, begun);
        last = (passed == 0).then_some(begun);
        missed += passed;
        // Before the readings are fetched: what an exchange that had begun has read shows all that the axes went meanwhile.
        if missed > 0 {
            timing.miss(missed);
            core.skipped(missed);
            port.skipped(missed);
            core.switches().punctual.miss(missed, length);
            if missed >= options.missed_limit {
                core.stop(period, missed);
            }
        }
        period += 1;
        let lost = port.fetch(period, core.readings_mut());
        if let Err(lost) = lost {
            core.trip(ArmFault::BridgeSilent { periods: lost.periods });
        }
        port.send(period, core.compute(period));
        let done = clock.now();
        timing.work.record(done - begun);
        core.switches().punctual.note(late, done - begun);
        missed = pass(&mut next, length, done);
        if missed > 0 {
            last = None;
        }
        if lost.is_err() {
            break;
        }
    }
    timing.miss(missed);
    timing.late_readings = port.late();
    timing
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_point_that_is_reached_is_missed_and_one_to_come_is_not() {
        for (now, missed) in [(0, 0), (999, 0), (1000, 1), (2999, 1), (3000, 2), (21_500, 11)] {
            let mut next = 1000;
            assert_eq!(pass(&mut next, 2000, now), missed, "at {now}");
            assert_eq!(next, 1000 + missed * 2000);
            assert!(next > now);
        }
    }
}
