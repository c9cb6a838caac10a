//! Synchronising an arm as the operator wills: a pause and a terminate bring it to a stand. The servo takes no other order
//! while it homes, so it is told as it is of an actor that is gone: to hold, and then begins no homing. Asked again, it
//! goes on with the axes that are not synchronised yet.

use super::clock::Clock;
use super::control::Control;
use crate::error::{Error, NonFatal};
use crate::motion::{ArmState, MoveRefused};
use std::pin::pin;
use tokio::sync::watch;

/// Periods of 2 ms in which an arm comes to a stand.
const BRAKES: u64 = 75;

/// What the operator is told of an arm that was brought to a stand.
pub(crate) const STANDS: &str = "the arm stands and is not synchronised yet";

/// Waits for an arm that synchronises; `false` when the operator's will brought it to a stand before it was done.
///
/// # Errors
/// What the arm's driver says.
pub(crate) async fn homed(
    synchronises: impl Future<Output = Result<ArmState, Error>>,
    control: &mut watch::Receiver<Control>,
    clock: &Clock,
) -> Result<bool, Error> {
    let mut synchronises = pin!(synchronises);
    tokio::select! {
        biased;
        done = &mut synchronises => return done.map(|_| true),
        // Whoever can change it no more wants nothing else.
        Ok(_) = control.wait_for(|will| *will != Control::Running) => {}
    }
    let end = clock.period() + BRAKES;
    clock.hold(true);
    let done = synchronises.await;
    clock.until(end).await;
    clock.hold(false);
    match done {
        Ok(_) => Ok(true),
        Err(Error::NonFatal {
            cause: NonFatal::Refused(MoveRefused::BrokenOff | MoveRefused::HeldBack),
            ..
        }) => Ok(false),
        Err(error) => Err(error),
    }
}
