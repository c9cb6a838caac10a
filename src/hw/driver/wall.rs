//! The wall driver: a real-time thread that runs the servo on a grid of periods of the wall clock.
//! The bridge thread beside it owns the port.
//!
//! The grid is absolute: a late period does not shift the next one. Periods are numbered without
//! gaps, and missed grid points are counted apart. The arms hold their last set values in them, so
//! a motion continues without a jump. Too many missed points in a row brake and trip the arms. The
//! time of a suspend of the computer counts as missed points, although its clock stands still.
//!
//! In its loop the thread allocates nothing and takes no lock. Its only system calls are the sleep
//! and the wake-up of the bridge. `tests/realtime.rs` checks all three.

use super::bridge::{Bridge, BridgePort};
use super::core::{Core, Switches};
use super::realtime::{Clock, RealTime};
use super::stats::Timing;
use super::suspend::{Suspends, Time};
use crate::error::panic_text;
use crate::hw::port::{Port, PortFault};
use crate::motion::ArmFault;
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc;
use std::thread::JoinHandle;

/// Options of the wall driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WallOptions {
    /// Length of the last part of each wait, in which the thread spins (ns); 0 for sleep alone.
    pub spin: u64,
    /// Priority of the servo thread under `SCHED_FIFO`, 6..=99; the bridge has 5 less.
    pub priority: i32,
    /// Processor core of the servo thread; `None` leaves the choice to the scheduler.
    pub core: Option<usize>,
    /// Number of periods missed in a row that stops the arms.
    pub missed_limit: u64,
    /// Whether the driver refuses to start if any real-time right is denied.
    pub require_real_time: bool,
}

impl Default for WallOptions {
    fn default() -> Self {
        Self { spin: 100_000, priority: 85, core: None, missed_limit: 50, require_real_time: false }
    }
}

/// A running wall driver. Its drop stops both threads and waits for them, so no exit leaves the
/// drives on.
#[derive(Debug)]
pub struct Wall<P> {
    threads: Option<(JoinHandle<Timing>, Bridge<P>)>,
    switches: Arc<Switches>,
    /// Real-time rights that were denied.
    pub warnings: Vec<String>,
}

/// Result of a wall driver that has ended.
#[derive(Debug)]
pub struct WallEnd<P> {
    /// The port; `None` if the bridge thread panicked.
    pub port: Option<P>,
    /// Fault of the port, if it failed.
    pub fault: Option<PortFault>,
    /// Punctuality of the servo.
    pub timing: Timing,
    /// Name of the first thread that panicked, with the text of its panic.
    pub panic: Option<(&'static str, String)>,
}

/// Starts the servo thread and the bridge thread. The bridge thread owns `port` and calls `hook`
/// after each exchange.
///
/// # Errors
/// The error of the operating system if a thread cannot be started.
/// [`io::ErrorKind::PermissionDenied`] with all denied rights if real time is required.
pub fn spawn_wall<P: Port + 'static>(
    core: Core,
    port: P,
    hook: impl FnMut(u64, &mut P) + Send + 'static,
    options: WallOptions,
) -> io::Result<Wall<P>> {
    spawn_wall_on(Clock, core, port, hook, options)
}

/// Starts both threads like [`spawn_wall`]; the servo runs on the given clocks.
///
/// # Errors
/// As [`spawn_wall`].
pub fn spawn_wall_on<P: Port + 'static>(
    clock: impl Time + Send + 'static,
    mut core: Core,
    port: P,
    hook: impl FnMut(u64, &mut P) + Send + 'static,
    options: WallOptions,
) -> io::Result<Wall<P>> {
    let switches = Arc::clone(core.switches());
    let length = core.length().nanos();
    let (bridge, mut side) =
        Bridge::spawn(port, core.readings(), options.priority - 5, length, hook)?;
    let (report, reported) = mpsc::channel();
    let servo = std::thread::Builder::new().name("servo".into()).spawn(move || {
        // The thread asks for its own rights: the scheduler grants them to the calling thread.
        let mut rights = RealTime::acquire(options.priority, options.core);
        let denied = options.require_real_time && !rights.warnings.is_empty();
        let _ = report.send((denied, std::mem::take(&mut rights.warnings)));
        if denied { Timing::default() } else { run(&clock, &mut core, &mut side, &options) }
    })?;
    match reported.recv() {
        Ok((false, warnings)) => Ok(Wall { threads: Some((servo, bridge)), switches, warnings }),
        Ok((true, warnings)) => {
            Err(io::Error::new(io::ErrorKind::PermissionDenied, warnings.join("; ")))
        }
        Err(_) => Err(io::Error::other("the servo thread ended before its first period")),
    }
}

impl<P> Wall<P> {
    /// Returns whether the servo thread has ended, for example because the bridge was lost.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.threads.as_ref().is_none_or(|(servo, _)| servo.is_finished())
    }

    /// Stops the servo thread and the bridge thread, waits for them and returns their results.
    #[must_use]
    pub fn stop(mut self) -> WallEnd<P> {
        self.end().unwrap_or(WallEnd {
            port: None,
            fault: None,
            timing: Timing::default(),
            panic: None,
        })
    }

    /// Stops both threads, waits for them and returns their results; `None` if they were stopped
    /// before.
    fn end(&mut self) -> Option<WallEnd<P>> {
        let (servo, bridge) = self.threads.take()?;
        self.switches.stop.store(true, Ordering::Release);
        // The servo first: its end drops the bridge's channel, by which the bridge switches the
        // drives off and ends. The measurements of a thread that panicked are lost.
        let (timing, servo_panic) = match servo.join() {
            Ok(timing) => (timing, None),
            Err(why) => (Timing::default(), Some(("the servo's thread", panic_text(&*why)))),
        };
        let (port, fault, bridge_panic) = match bridge.join() {
            Ok((port, fault)) => (Some(port), fault, None),
            Err(why) => (None, None, Some(("the bridge's thread", why))),
        };
        Some(WallEnd { port, fault, timing, panic: servo_panic.or(bridge_panic) })
    }
}

impl<P> Drop for Wall<P> {
    fn drop(&mut self) {
        self.end();
    }
}

/// Advances `next` by whole periods of this `length` until it lies after `now` (all in ns). Returns
/// the number of grid points that it skips; a point equal to `now` counts as skipped.
pub(crate) fn pass(next: &mut u64, length: u64, now: u64) -> u64 {
    let missed = if now < *next { 0 } else { (now - *next) / length + 1 };
    *next += missed * length;
    missed
}

/// Runs the real-time loop until the stop switch is set or the bridge is lost.
fn run(clock: &impl Time, core: &mut Core, port: &mut BridgePort, options: &WallOptions) -> Timing {
    let length = core.length().nanos();
    // At most half a period is spun away, or a short period would keep the core busy all the time.
    let spin = options.spin.min(length / 2);
    let mut timing = Timing::default();
    let mut next = clock.now() + length;
    let mut period = 0;
    // Time at which the last period began; `None` if periods were missed since then.
    let mut last: Option<u64> = None;
    // Grid points that passed since the last period.
    let mut missed = 0;
    let mut suspends = Suspends::default();
    while !core.switches().stop.load(Ordering::Acquire) {
        clock.wait_until(next, spin);
        let begun = clock.now();
        let late = begun.saturating_sub(next);
        timing.wake_up.record(late);
        if let Some(last) = last {
            timing.jitter.record((begun - last).abs_diff(length));
        }
        next += length;
        // This period began so late that further grid points have passed already.
        let passed = pass(&mut next, length, begun);
        last = (passed == 0).then_some(begun);
        // While the computer is suspended the grid stands still, but the arms are not driven.
        missed += passed + suspends.asleep(clock) / length;
        // The gap is reported before the readings are fetched: an exchange that was under way in
        // the gap may already show all of the motion in it, which looks like an encoder jump.
        if missed > 0 {
            timing.miss(missed);
            core.add_missed_periods(missed);
            port.add_missed_periods(missed);
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
        // The drives of a lost bridge are sent as well: they switch the drives off.
        port.send(period, core.compute(period));
        let done = clock.now();
        timing.work.record(done - begun);
        core.switches().punctual.note(late, done - begun);
        // Work that took longer than a period: the next period reports these points.
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
    fn period_start_equal_to_now_counts_as_missed() {
        // Periods of 2000 ns, of which the next one starts at 1000 ns.
        for (now, missed) in [(0, 0), (999, 0), (1000, 1), (2999, 1), (3000, 2), (21_500, 11)] {
            let mut next = 1000;
            assert_eq!(pass(&mut next, 2000, now), missed, "at {now}");
            assert_eq!(next, 1000 + missed * 2000);
            assert!(next > now);
        }
    }
}
