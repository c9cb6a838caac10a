//! Synchronising an arm as the operator wills: a pause and a terminate bring it to a stand. The servo takes no other order
//! while it homes, so it is told as it is of an actor that is gone: to hold. Asked again, it goes on with the axes that are
//! not synchronised yet.

use super::clock::Clock;
use super::control::Control;
use crate::error::{Error, NonFatal};
use crate::motion::{ArmState, MoveRefused};
use std::pin::pin;
use tokio::sync::watch;

/// Periods of 2 ms in which an arm comes to a stand, and whoever waits for it learns that it does not home any more.
const BRAKES: u64 = 75;
/// Periods in which the servo learns that it need not hold any more.
const LIFTS: u64 = 2;

/// What the operator is told of an arm that was brought to a stand.
pub(super) const STANDS: &str = "the arm stands and is not synchronised yet";

/// Waits for an arm that synchronises; `false` when the operator's will brought it to a stand before it was done.
///
/// # Errors
/// What the arm's driver says.
pub(super) async fn homed(
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
    let done = loop {
        let end = clock.period() + BRAKES;
        clock.hold(true);
        let done = tokio::select! {
            biased;
            done = &mut synchronises => Some(done),
            () = clock.until(end) => None,
        };
        clock.until(end).await;
        clock.hold(false);
        // An order that was still on its way to the servo has slipped through: held again, it is braked.
        clock.until(end + LIFTS).await;
        if let Some(done) = done {
            break done;
        }
    };
    match done {
        Ok(_) => Ok(true),
        Err(Error::NonFatal { cause: NonFatal::Refused(MoveRefused::BrokenOff), .. }) => Ok(false),
        Err(error) => Err(error),
    }
}
