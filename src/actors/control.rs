//! What the operator wants of the run: start, pause, resume, terminate. One `watch`, latest value wins.

use tokio::sync::watch;

/// The operator's will.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Control {
    /// Not started yet.
    Waiting,
    /// Go on.
    Running,
    /// Hold where it is.
    Paused,
    /// End.
    Terminated,
}

/// The run was terminated by the operator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Terminated;

/// Waits while the run is paused; at once otherwise.
///
/// # Errors
/// [`Terminated`].
pub async fn permission(control: &mut watch::Receiver<Control>) -> Result<(), Terminated> {
    loop {
        match *control.borrow_and_update() {
            Control::Running => return Ok(()),
            Control::Terminated => return Err(Terminated),
            Control::Waiting | Control::Paused => {}
        }
        if control.changed().await.is_err() {
            return Err(Terminated);
        }
    }
}

/// How often whoever waits for permission looks at its arms: a stop or a fault must not wait for the operator.
const LOOK: std::time::Duration = std::time::Duration::from_millis(20);

/// Waits as [`permission`] does, but not for long: `None` when it is time to look at the arms.
pub async fn permission_soon(
    control: &mut watch::Receiver<Control>,
) -> Option<Result<(), Terminated>> {
    tokio::time::timeout(LOOK, permission(control)).await.ok()
}
