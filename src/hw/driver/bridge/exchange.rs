//! The loop of the bridge thread: one exchange with the port for each period's drives.
//!
//! - in: drives, by a ring; only the newest are carried out, unless the port
//!   [needs each period](Port::needs_each_period)
//! - out: readings, by a triple buffer; the port and its fault when the loop ends
//!
//! | event | threshold | reaction |
//! |---|---|---|
//! | the servo is silent | [`SILENCE`] | drives off, again after each further silence |
//! | the servo's side is dropped | - | drives off, the loop ends |
//! | the port fails | first fault | it repeats its stop in each period until the run is over |
//! | a fault follows a gap in the orders | [`STALL`], [`LATELY`] | the fault's text names the gap |

use super::drives::Drives;
use crate::hw::port::{Port, PortFault};
use crate::servo::io::ArmDrive;
use crate::servo::lateness::{MOST_ARMS, Readings};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time without drive commands after which the arms are switched off, because the servo is stuck.
pub(super) const SILENCE: Duration = Duration::from_millis(200);

/// Time without drive commands after which serial controllers may have stopped by themselves.
pub(super) const STALL: Duration = Duration::from_millis(40);

/// Time after a stall in which the stall may be the cause of a fault. It is not zero, because a
/// serial line believes a controller's error mode only when a second answer reports it.
const LATELY: Duration = Duration::from_millis(40);

/// Longest sleep while no drive commands come.
const NAP: Duration = Duration::from_millis(10);

/// State of the bridge thread.
pub(super) struct Exchange<P, H> {
    pub(super) port: P,
    /// Called after each exchange.
    pub(super) hook: H,
    /// Number of effectors.
    pub(super) arms: usize,
    /// Length of a period (ns).
    pub(super) length: u64,
    /// Drive commands from the servo.
    pub(super) incoming: rtrb::Consumer<Drives>,
    /// Readings for the servo.
    pub(super) outgoing: triple_buffer::Input<Readings>,
    /// The latest readings.
    pub(super) latest: Readings,
    /// Set when the port has failed.
    pub(super) broken: Arc<AtomicBool>,
    /// Set by the owner when the run is over.
    pub(super) over: Arc<AtomicBool>,
}

/// Times of the last drive commands, by which silences and stalls are detected.
struct Times {
    /// Time of the last drive commands from the servo, or of the last switch-off in its place.
    heard: Instant,
    /// Time of the last drive commands to the port. `None` before the first order: the arms are not
    /// driven while the servo thread acquires its real-time rights.
    driven: Option<Instant>,
    /// End and duration of the last stall.
    stall: Option<(Instant, Duration)>,
}

impl Times {
    /// Returns the time since the last drive commands to the port.
    fn gap(&self, now: Instant) -> Duration {
        self.driven.map_or(Duration::ZERO, |at| now - at)
    }
}

/// Whether the loop of the bridge thread goes on; the fault of the port, if the loop ends with one.
type Flow = ControlFlow<Option<PortFault>>;

impl<P: Port, H: FnMut(u64, &mut P)> Exchange<P, H> {
    /// Exchanges drive commands and readings with the port until the servo's side is dropped or the
    /// port fails; returns the port, and its fault if it failed.
    pub(super) fn run(mut self) -> (P, Option<PortFault>) {
        let mut times = Times { heard: Instant::now(), driven: None, stall: None };
        loop {
            let flow = match self.incoming.pop() {
                Ok(next) => self.carry_out(next, &mut times),
                Err(_) => self.wait(&mut times),
            };
            match flow {
                Flow::Continue(()) => {}
                Flow::Break(None) => return (self.port, None),
                Flow::Break(Some(fault)) => return self.give_up(fault),
            }
        }
    }

    /// Sends `next` to the port, or newer drive commands if the port needs only the newest ones.
    /// Sends the port's readings to the servo. Returns whether the loop goes on.
    fn carry_out(&mut self, mut next: Drives, times: &mut Times) -> Flow {
        let now = Instant::now();
        let gap = times.gap(now);
        (times.heard, times.driven) = (now, Some(now));
        if gap > STALL {
            times.stall = Some((now, gap));
        }
        // Drives that waited while this thread was kept from running are old. Motors get the newest
        // only; the simulated plant gets each, or its time would lag.
        while !self.port.needs_each_period()
            && let Ok(newer) = self.incoming.pop()
        {
            next = newer.instead_of(&next);
        }
        let Drives { period, drives } = next;
        if let Err(mut fault) = self.exchange(period, &drives) {
            let lately = times.stall.filter(|(since, _)| since.elapsed() < LATELY);
            fault.reason += &after_stall(lately.map_or(Duration::ZERO, |(_, gap)| gap));
            return Flow::Break(Some(fault));
        }
        self.latest.period = period;
        self.outgoing.write(self.latest);
        (self.hook)(period, &mut self.port);
        Flow::Continue(())
    }

    /// Waits briefly for drive commands; switches the arms off if the servo is gone or silent for
    /// too long. Returns whether the loop goes on.
    fn wait(&mut self, times: &mut Times) -> Flow {
        let gone = self.incoming.is_abandoned();
        if gone || times.heard.elapsed() > SILENCE {
            let gap = times.gap(Instant::now());
            // The servo no longer drives the arms, so their brakes close.
            match self.exchange(self.latest.period + 1, &[ArmDrive::OFF; MOST_ARMS]) {
                Err(mut fault) => {
                    fault.reason += &after_stall(gap);
                    return Flow::Break(Some(fault));
                }
                Ok(()) if gone => return Flow::Break(None),
                Ok(()) => times.driven = Some(Instant::now()),
            }
            times.heard = Instant::now();
        }
        // `BridgePort::send` unparks this thread at once. The timeout is for a servo that is gone
        // or silent.
        std::thread::park_timeout(NAP);
        Flow::Continue(())
    }

    /// Exchanges the drive commands of the arms that exist with the port; stores their readings.
    fn exchange(&mut self, period: u64, drives: &[ArmDrive; MOST_ARMS]) -> Result<(), PortFault> {
        let readings = &mut self.latest.arms[..self.arms];
        self.port.exchange(period, &drives[..self.arms], readings)
    }

    /// Reports to the servo that the port has failed, and repeats the port's stop in each period
    /// until the run is over. Returns the port and `fault`.
    fn give_up(mut self, fault: PortFault) -> (P, Option<PortFault>) {
        self.broken.store(true, Ordering::Release);
        while !self.over.load(Ordering::Acquire) {
            self.port.repeat_stop();
            std::thread::park_timeout(Duration::from_nanos(self.length));
        }
        (self.port, Some(fault))
    }
}

/// Returns a text to append to the reason of a fault: the time `gap` without drive commands before
/// it, if controllers may have stopped by themselves in that time, else "".
fn after_stall(gap: Duration) -> String {
    if gap > STALL {
        format!("; before that this machine sent nothing for {} ms", gap.as_millis())
    } else {
        String::new()
    }
}
