//! The virtual driver: one task on a current-thread tokio runtime with paused time.
//!
//! Port and servos are called inline, in a fixed order, so a run is repeatable to the bit and as fast as the
//! machine allows. No thread here: paused time does not see threads.
//!
//! Its grid is the wall driver's: grid points that have passed are skipped and counted, not made up for, and too many of
//! them in a row stop the arms. On paused time they pass only where a port says so.

use super::core::Core;
use crate::hw::port::{HeldUp, Port, PortFault};
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

/// Runs the core until its stop switch is set; returns the number of the last period.
///
/// So many periods missed in a row as `missed_limit` says bring the arms to a stand and stop them.
/// `hook` is called at the end of each period: there the caller publishes what there is to be seen.
///
/// # Errors
/// The port's first fault; it also ends the run, with all drives off from then on.
pub async fn run_virtual<P: Port>(
    core: &mut Core,
    port: &mut P,
    missed_limit: u64,
    mut hook: impl FnMut(u64, &mut P),
) -> Result<u64, PortFault> {
    let start = Instant::now();
    let mut period = 0;
    // Grid points that passed without a period.
    let mut skipped = 0;
    while !core.switches().stop.load(Ordering::Acquire) {
        period += 1;
        let length = core.length().nanos();
        sleep_until(start + Duration::from_nanos((period + skipped) * length)).await;
        core.period(period, port)?;
        hook(period, port);
        let HeldUp { periods, jump } = port.held_up();
        if jump > 0.0 {
            tokio::time::advance(Duration::from_secs_f64(jump)).await;
        }
        let missed = periods + (jump * 1e9) as u64 / length;
        if missed > 0 {
            skipped += missed;
            core.skipped(periods);
            core.switches().punctual.miss(missed, length);
            if missed >= missed_limit {
                core.stop(period, missed);
            }
        }
    }
    Ok(period)
}
