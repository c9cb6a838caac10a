//! The virtual driver: one task on a current-thread tokio runtime with paused time.
//!
//! Port and servos are called inline, in a fixed order, so a run is repeatable to the bit and as fast as the
//! machine allows. No thread here: paused time does not see threads.

use super::core::Core;
use crate::hw::port::{Port, PortFault};
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

/// Runs the core until its stop switch is set; returns the number of the last period.
///
/// `hook` is called at the end of each period: there the caller publishes what there is to be seen.
///
/// # Errors
/// The port's first fault; it also ends the run, with all drives off from then on.
pub async fn run_virtual<P: Port>(
    core: &mut Core,
    port: &mut P,
    mut hook: impl FnMut(u64, &mut P),
) -> Result<u64, PortFault> {
    let start = Instant::now();
    let mut period = 0;
    while !core.switches().stop.load(Ordering::Acquire) {
        period += 1;
        sleep_until(start + Duration::from_nanos(period * core.length().nanos())).await;
        core.period(period, port)?;
        hook(period, port);
    }
    Ok(period)
}
