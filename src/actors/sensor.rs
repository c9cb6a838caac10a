//! The VSP of a user's own sensor: an actor that measures at regular times.
//!
//! - in: the kernel of the VSP with its device; the states of the arms
//! - out: the latest [`SensorReading`]
//!
//! | fault of the device | reaction |
//! |---|---|
//! | no measurement | the reading is the reason; it is reported once, and so is its end |
//! | panic, or no answer for `LIMIT` | system error, which ends the run |

use super::notice::Notice;
use super::services::Services;
use super::trace;
use super::watchdog::Supervision;
use crate::error::{Error, NonFatal};
use crate::kernel::Effort;
use crate::kernel::sensor::{SensorKernel, SensorReading, SensorReadings};
use crate::motion::{ArmState, PERIOD};
use crate::record::playback::Played;
use crate::record::sensed::Found;
use serde_json::Value;
use std::time::Duration;
use tokio::sync::watch;
use tracing::Instrument as _;

/// Longest time of one measurement by the wall clock.
const LIMIT: Duration = Duration::from_secs(1);
/// Number of measurements in a row that may be missing before a reading is too old.
const MISSED: u64 = 3;

/// The parts of the VSP.
pub struct Parts {
    /// Kernel with its device.
    pub kernel: Box<dyn SensorKernel>,
    /// Servo periods between two measurements.
    pub periods: u64,
    /// States of the arms, in the scenario's order.
    pub states: Vec<watch::Receiver<ArmState>>,
    /// The services of the run.
    pub services: Services,
}

/// The receiving end of a VSP's readings. The VSP ends when the last clone is dropped.
#[derive(Debug, Clone)]
pub struct SensorHandle {
    name: String,
    latest: watch::Receiver<Option<SensorReading>>,
}

/// Returns the latest readings of these VSPs.
#[must_use]
pub fn readings(handles: &[SensorHandle]) -> SensorReadings {
    let latest = |handle: &SensorHandle| (handle.name.clone(), handle.latest.borrow().clone());
    SensorReadings(handles.iter().map(latest).collect())
}

/// The actor.
struct Vsp {
    name: String,
    /// Kernel with its device; `None` while a worker has it, and after that worker panicked.
    kernel: Option<Box<dyn SensorKernel>>,
    states: Vec<watch::Receiver<ArmState>>,
    periods: u64,
    services: Services,
    /// Whether the absence of readings has been reported.
    reported: bool,
    latest: watch::Sender<Option<SensorReading>>,
}

/// Starts the VSP called `name`, and returns the receiving end of its readings.
#[must_use]
pub(crate) fn spawn(name: &str, parts: Parts) -> SensorHandle {
    let Parts { kernel, periods, states, services } = parts;
    let (latest, readings) = watch::channel(None);
    let Supervision { watchdog, .. } = services.supervision.clone();
    let actor = format!("vsp {name}");
    let vsp = Vsp {
        name: actor.clone(),
        kernel: Some(kernel),
        states,
        periods: periods.max(1),
        services,
        reported: false,
        latest,
    };
    let span = tracing::info_span!("vsp", name = actor);
    watchdog.spawn(&actor, vsp.run().instrument(span));
    SensorHandle { name: name.to_owned(), latest: readings }
}

impl Vsp {
    /// Measures at regular times, as long as there is a receiver of the readings.
    async fn run(mut self) {
        let Supervision { watchdog, fault, .. } = self.services.supervision.clone();
        let heartbeat = watchdog.heartbeat(&self.name);
        let mut next = self.services.clock.period();
        while !self.latest.is_closed() {
            // The next point of the grid: a slow measurement is not made up for.
            while next <= self.services.clock.period() {
                next += self.periods;
            }
            self.services.clock.until(next).await;
            heartbeat.works();
            fault.occur().await;
            let value = heartbeat.away(self.measure(next)).await;
            heartbeat.waits();
            let Ok(value) = value.map_err(|error| watchdog.raise(error)) else { return };
            self.publish(next, value);
        }
    }

    /// Measures once in this `period` of 2 ms. A verification takes the recorded reading instead.
    async fn measure(&mut self, period: u64) -> Result<Result<Value, String>, Error> {
        if let Some(playback) = &self.services.playback {
            return Ok(match playback.sensed(&self.name, period, "") {
                Played::Answer(Ok(Found::Own(value))) => Ok(value),
                Played::Answer(Err(why)) => Err(why),
                Played::Answer(Ok(_)) | Played::Nothing => {
                    playback.report_unrecorded_look(&self.name, period, "");
                    Err("the recording does not contain this reading".to_owned())
                }
            });
        }
        let Some(mut kernel) = self.kernel.take() else {
            return Ok(Err("its device is gone".to_owned()));
        };
        let arms: Vec<_> = self.states.iter_mut().map(|s| *s.borrow_and_update()).collect();
        let work = self.services.work.run(("the sensor's device", LIMIT), move || {
            let value = kernel.measure(period, &arms);
            ((kernel, value), Effort(0.0))
        });
        match work.await {
            Ok((kernel, value)) => {
                self.kernel = Some(kernel);
                Ok(value)
            }
            Err(cause) => {
                Err(Error::System { actor: self.name.clone(), place: "measure".into(), cause })
            }
        }
    }

    /// Writes a reading to the trace, and publishes it.
    fn publish(&mut self, period: u64, value: Result<Value, String>) {
        let trace = &self.services.trace;
        let look = trace::Look { sensor: &self.name, period, asked: "", exposed: period };
        trace.measured(self.services.clock.period(), &look, &value);
        trace.message(&self.name, "owner", &value);
        let seconds = period as f64 * PERIOD;
        match &value {
            Err(why) if !self.reported => {
                let (actor, cause) = (self.name.clone(), NonFatal::NoReading(why.clone()));
                trace.tell(Notice::Error(
                    seconds,
                    Error::NonFatal { actor, place: "measure".into(), cause },
                ));
            }
            Ok(_) if self.reported => {
                trace.tell(Notice::Note(seconds, format!("{}: readings arrive again", self.name)));
            }
            _ => {}
        }
        self.reported = value.is_err();
        // A device slower than its period is given more time, or none of its readings would count.
        let took = self.services.clock.period().saturating_sub(period);
        let valid = MISSED * self.periods.max(took);
        self.latest.send_replace(Some(SensorReading { period, valid, value }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::actors::clock::Clock;
    use crate::actors::control::Control;
    use crate::actors::trace::Trace;
    use crate::record::run_hash::RunHash;
    use std::sync::Arc;

    /// Kernel that has a reading from its third measurement on.
    struct Third(u32);

    impl SensorKernel for Third {
        fn measure(&mut self, _: u64, _: &[ArmState]) -> Result<Value, String> {
            self.0 += 1;
            if self.0 > 2 { Ok(Value::from(self.0)) } else { Err("dark".to_owned()) }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn readings_come_regularly_and_absence_is_reported_once() {
        let (_will, control) = watch::channel(Control::Running);
        let (trace, mut notices) = Trace::bare(RunHash::default());
        let clock = Clock::new(tokio::time::Instant::now(), Arc::default());
        let services = Services::bare(clock, control, trace);
        let kernel = Box::new(Third(0));
        let handle = spawn("eye", Parts { kernel, periods: 10, states: Vec::new(), services });
        let mut latest = handle.latest.clone();
        let mut found = Vec::new();
        while found.len() < 4 {
            latest.changed().await.unwrap();
            found.push(latest.borrow_and_update().clone().unwrap());
        }

        let periods: Vec<u64> = found.iter().map(|reading| reading.period).collect();
        assert_eq!(periods, [10, 20, 30, 40]);
        assert!(found.iter().all(|reading| reading.valid == 30), "{found:?}");
        assert_eq!(found[1].value, Err("dark".to_owned()));
        assert_eq!(readings(&[handle]).get::<u32>("eye", 40), Ok(4));
        let mut told = Vec::new();
        while let Ok(notice) = notices.try_recv() {
            told.push(matches!(notice, Notice::Error(..)));
        }
        assert_eq!(told, [true, false], "once that there is none, once that they come again");
    }
}
