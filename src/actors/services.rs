//! Services that every actor of a run is given: time, the operator's will, the trace, and
//! supervision.

use super::clock::Clock;
use super::control::{Control, Tempo};
use super::fault::ActorFault;
use super::trace::Trace;
use super::watchdog::Supervision;
use super::work::Work;
use crate::record::playback::Playback;
use crate::scenario::keys::Pace;
use std::sync::Arc;
use tokio::sync::watch;

/// The services of a run; a clone is the same ones.
#[derive(Clone)]
pub struct Services {
    /// Servo periods and time.
    pub clock: Clock,
    /// The door for long work.
    pub work: Work,
    /// The operator's will.
    pub control: watch::Receiver<Control>,
    /// How fast simulated time may go; MP says when it waits for the operator.
    pub tempo: Tempo,
    /// Where messages, notices and pictures are written.
    pub trace: Trace,
    /// The recording that is verified, which delivers in place of cameras.
    pub playback: Option<Playback>,
    /// Reports panics and silence of actors, and injects faults into them.
    pub(crate) supervision: Supervision,
}

impl Services {
    /// Returns services under virtual time, without a recording and without faults.
    #[must_use]
    pub fn bare(clock: Clock, control: watch::Receiver<Control>, trace: Trace) -> Self {
        Self {
            clock,
            work: Work(Pace::Virtual),
            control,
            tempo: Tempo::default(),
            trace,
            playback: None,
            supervision: Supervision::default(),
        }
    }

    /// Returns the services of an actor into which `fault` may be injected.
    pub(crate) fn under(&self, fault: Option<&Arc<ActorFault>>) -> Self {
        let mut services = self.clone();
        services.supervision.fault = fault.cloned().unwrap_or_default();
        services
    }
}
