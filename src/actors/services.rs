//! Services that every actor of a run gets: time, the operator's control, the trace, and
//! supervision.

use super::clock::Clock;
use super::control::{Control, Tempo};
use super::fault::ActorFault;
use super::trace::Trace;
use super::watchdog::Supervision;
use super::way::{Carries, Toward, Way};
use super::work::Work;
use crate::record::playback::Playback;
use crate::scenario::keys::Pace;
use std::sync::Arc;
use tokio::sync::watch;

/// The services of a run. A clone shares them.
#[derive(Clone)]
pub struct Services {
    /// Clock of servo periods.
    pub clock: Clock,
    /// Door for long work.
    pub work: Work,
    /// The operator's control of the run.
    pub control: watch::Receiver<Control>,
    /// Limit of the speed of simulated time; MP reports when it waits for the operator.
    pub tempo: Tempo,
    /// Trace of messages, notices and pictures.
    pub trace: Trace,
    /// Recording that this run repeats for a verification: its results of vision replace those of
    /// the cameras. `None` in any other run.
    pub playback: Option<Playback>,
    /// Watchdog of the actors, and faults that are injected into them.
    pub(crate) supervision: Supervision,
}

impl Services {
    /// Returns services under virtual time, without a recording and without faults.
    #[must_use]
    pub fn bare(clock: Clock, control: watch::Receiver<Control>, trace: Trace) -> Self {
        let supervision = Supervision::default();
        Self {
            clock,
            work: Work::new(Pace::Virtual, &supervision.watchdog),
            control,
            tempo: Tempo::default(),
            trace,
            playback: None,
            supervision,
        }
    }

    /// Returns these services for one actor. `fault` holds the faults that the scenario injects
    /// into this actor; `None` if there are none.
    pub(crate) fn under(&self, fault: Option<&Arc<ActorFault>>) -> Self {
        let mut services = self.clone();
        services.supervision.fault = fault.cloned().unwrap_or_default();
        services
    }

    /// Returns the services for an actor on another node: the operator's control comes by the way
    /// to this node.
    pub(crate) fn across(self, way: Option<&Way>) -> Self {
        let Some(way) = way else { return self };
        let control = way.watch(Toward::Node, Carries::Each, self.control);
        Self { control, ..self }
    }
}
