//! Services that every actor of a run gets: time, the operator's control, the trace, and
//! supervision.

use super::clock::Clock;
use super::control::{Control, Tempo};
use super::fault::ActorFault;
use super::trace::Trace;
use super::tuning::Tuning;
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
    /// The operator's parameters, of which each user follows a clone.
    pub tuning: Tuning,
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
            tuning: Tuning::fixed(),
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

    /// Returns the services for an actor on another node: the operator's control and parameters
    /// come by the way to this node.
    pub(crate) fn across(self, way: Option<&Way>) -> Self {
        let Some(way) = way else { return self };
        let control = way.watch(Toward::Node, Carries::Each, self.control);
        let courses = way.watch(Toward::Node, Carries::Each, self.tuning.courses());
        Self { control, tuning: Tuning::new(courses), ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::LinkModel;
    use crate::operator::Parameter;
    use crate::operator::parameter::{AllBounds, Courses};
    use crate::record::run_hash::RunHash;
    use std::time::Duration;

    #[tokio::test(start_paused = true)]
    async fn parameter_order_crosses_the_link() {
        let clock = Clock::new(tokio::time::Instant::now(), Arc::default());
        let (_will, control) = watch::channel(Control::Running);
        let (courses, ordered) = watch::channel(Courses::new(&AllBounds::default()));
        let here = Services {
            tuning: Tuning::new(ordered),
            ..Services::bare(clock, control, Trace::bare(RunHash::default()).0)
        };
        let model = LinkModel { delay: 0.05, jitter: 0.0, loss: 0.0, resend: 0.1 };
        let way = Way::new(model, 1, 0, Arc::default());
        let mut there = here.clone().across(Some(&way)).tuning;
        tokio::time::sleep(Duration::from_millis(1)).await;

        courses.send_modify(|courses| courses.order(Parameter::Exposure, 2.0, 0));

        tokio::time::sleep(Duration::from_millis(45)).await;
        assert_eq!(there.factors(10_000)[Parameter::Exposure], 1.0);
        tokio::time::sleep(Duration::from_millis(10)).await;
        // The order is old, but the factor still begins where it was.
        assert!(there.factors(10_001)[Parameter::Exposure] < 1.002);
        assert_eq!(there.factors(20_000)[Parameter::Exposure], 2.0);
    }
}
