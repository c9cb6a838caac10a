//! Homing under the operator's control: a pause or a terminate stops an arm that is being
//! synchronised.
//!
//! The servo accepts no other command while it homes. So it is stopped as after the loss of an
//! actor: by the order to hold, under which it also begins no homing. The next request continues
//! with the axes that are not synchronised yet.

use super::clock::Clock;
use super::control::Control;
use crate::error::{Error, NonFatal};
use crate::motion::{ArmState, MoveRefused};
use std::pin::pin;
use tokio::sync::watch;

/// Time in which an arm stops (periods of 2 ms). Braking takes about 0.1 s.
const BRAKES: u64 = 75;

/// Message to the operator about an arm that was stopped.
pub(crate) const STOPPED_MESSAGE: &str = "the arm is stopped and not synchronised";

/// Waits until an arm is synchronised and returns `true`. If the operator pauses or terminates the
/// run before that, stops the arm and returns `false`. `synchronises` is the request under way.
///
/// # Errors
/// The errors of the arm's EDP.
pub(crate) async fn wait_for_homing(
    synchronises: impl Future<Output = Result<ArmState, Error>>,
    control: &mut watch::Receiver<Control>,
    clock: &Clock,
) -> Result<bool, Error> {
    let mut synchronises = pin!(synchronises);
    tokio::select! {
        biased;
        done = &mut synchronises => return done.map(|_| true),
        // Only a change of the control stops the arm. If its sender is gone, none can come.
        Ok(_) = control.wait_for(|will| *will != Control::Running) => {}
    }
    let end = clock.period() + BRAKES;
    clock.hold(true);
    // The EDP answers once the homing is broken off, which may be before the arm is at rest.
    let done = synchronises.await;
    clock.until(end).await;
    clock.hold(false);
    match done {
        // The last axis was done in the same moment.
        Ok(_) => Ok(true),
        // The refusal is the stop that was asked for.
        Err(Error::NonFatal {
            cause: NonFatal::Refused(MoveRefused::Aborted | MoveRefused::PartnerStopped),
            ..
        }) => Ok(false),
        Err(error) => Err(error),
    }
}
