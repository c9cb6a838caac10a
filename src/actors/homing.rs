//! Homing under the operator's control: a pause or a terminate stops an arm that is being
//! synchronised.
//!
//! The servo accepts no other command while it homes. So the order to hold ([`Clock::hold`]) stops
//! the homing, as after the loss of an actor. Under this order the servo begins no homing either.
//! The next request continues with the axes that are not synchronised yet.

use super::clock::Clock;
use super::control::Control;
use crate::error::{Error, NonFatal};
use crate::motion::{ArmState, MoveRefused};
use std::pin::pin;
use tokio::sync::watch;

/// Time in which an arm stops (periods of 2 ms). Braking takes about 0.1 s.
const BRAKES: u64 = 75;

/// Message to the operator about an arm whose homing a pause or a terminate has stopped.
pub(crate) const STOPPED_MESSAGE: &str =
    "the homing was stopped: the arm is not synchronised yet, and a resume continues the homing";

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
        // The last axis was synchronised in the moment of the stop.
        Ok(_) => Ok(true),
        // The stop that the operator ordered appears as a refusal.
        Err(Error::NonFatal {
            cause: NonFatal::Refused(MoveRefused::Aborted | MoveRefused::PartnerStopped),
            ..
        }) => Ok(false),
        Err(error) => Err(error),
    }
}
