//! The virtual driver: one task on a current-thread tokio runtime with paused time.
//!
//! It calls the port and the servos inline, in a fixed order. A run is therefore repeatable to the
//! bit and as fast as the machine allows. It starts no thread, because tokio's paused time does not
//! wait for threads.
//!
//! Its grid follows the rules of the wall driver: it skips and counts grid points that have passed,
//! and too many of them in a row stop the arms. On paused time they pass only if a port says so, by
//! [`Delay`].

use super::core::Core;
use crate::hw::port::{Delay, Port, PortFault};
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

/// Runs the servos in virtual time until their stop switch is set; returns the number of the last
/// period.
///
/// `missed_limit` periods missed in a row brake and trip the arms. The driver calls `hook` at the
/// end of each period, where the caller publishes the scene and other results.
///
/// # Errors
/// The first fault of the port, which ends the loop.
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
        // Periods are numbered without gaps, the grid is not: the sum is the number of the grid
        // point.
        sleep_until(start + Duration::from_nanos((period + skipped) * length)).await;
        core.period(period, port)?;
        hook(period, port);
        let Delay { periods, jump } = port.delay();
        // A jump moves the actors' clock only: the arms do not move in it. So the servos count
        // `periods` alone, while the lag behind the clock and the limit of missed periods count
        // the jump as well.
        if jump > 0.0 {
            tokio::time::advance(Duration::from_secs_f64(jump)).await;
        }
        let missed = periods + (jump * 1e9) as u64 / length;
        if missed > 0 {
            skipped += missed;
            core.add_missed_periods(periods);
            core.switches().punctual.miss(missed, length);
            if missed >= missed_limit {
                core.stop(period, missed);
            }
        }
    }
    Ok(period)
}
