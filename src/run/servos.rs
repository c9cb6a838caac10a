//! The servos of a run and the driver of time that runs them: virtual, or by the wall clock.
//!
//! - in: a world behind its port, gains and limits of each effector, which clock drives the run
//! - out: a link to each servo, the switches of all of them, and after the run the world again

use super::failure::not_created;
use super::gate::Gate;
use super::options::PlantProbe;
use super::simulation::PlantEventLog;
use super::witness::Witness;
use super::world::World;
use super::{recording, settings};
use crate::actors::clock::Clock;
use crate::actors::control::Pacer;
use crate::actors::latest::Seen;
use crate::actors::trace::Trace;
use crate::emergency_stop::StopButton;
use crate::error::{Error, Fatal};
use crate::hw::driver::{
    self, Core, RecordSink, ServoEnd, ServoLink, ServoRecord, Switches, Timing, Wall, WallEnd,
};
use crate::hw::port::PortFault;
use crate::motion::PERIOD;
use crate::record::playback::Playback;
use crate::record::recorder::{Entry, Recorder};
use crate::record::run_hash::RunHash;
use crate::scenario::ControllerConfig;
use crate::scenario::keys::{Pace, RealTime};
use crate::servo::period::Length;
use crate::servo::{ForceSettings, ServoCommand, ServoConfig};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Periods between two traces of the truth.
const TRACES: u64 = 50;

/// Which clock drives the servos, and how.
pub(super) struct Drive<'a> {
    /// Virtual or real time.
    pub(super) pace: Pace,
    /// Length of a period, and how the servo's thread runs under the wall clock.
    pub(super) real_time: &'a RealTime,
    /// Periods missed in a row after which the arms are brought to a stand and stop.
    pub(super) missed_limit: u64,
    /// Refuses to run unless every real-time right is granted.
    pub(super) require_real_time: bool,
}

impl Drive<'_> {
    /// Returns the length of a period.
    pub(super) fn length(&self) -> Length {
        Length::of_seconds(self.real_time.period)
    }
}

/// What looks at the plant after each period, beside the controller.
pub(super) struct Observer {
    witness: Arc<Mutex<Witness>>,
    recorder: Recorder,
    events: PlantEventLog,
    length: Length,
}

impl Observer {
    pub(super) fn new(
        witness: Arc<Mutex<Witness>>,
        recorder: Recorder,
        events: PlantEventLog,
        length: Length,
    ) -> Self {
        Self { witness, recorder, events, length }
    }

    /// Shows the plant to its cameras, and to recording, event log and witness.
    fn look(&mut self, period: u64, world: &mut World) {
        let Some(turned) = world.show() else { return };
        let tick = self.length.tick(period);
        if tick.is_multiple_of(recording::SCENES) {
            self.recorder
                .note_some(tick, || world.scene().map(|scene| Entry::Scene(Box::new(scene))));
            self.events.look(tick, world.plant());
        }
        // The run takes this lock at its end only.
        self.witness.lock().unwrap_or_else(PoisonError::into_inner).look(tick, turned);
    }
}

/// What happens between two periods of a virtual run.
pub(super) struct BetweenPeriods {
    /// Looks at the plant.
    pub(super) observer: Observer,
    /// Judges the run.
    pub(super) probe: Option<PlantProbe>,
    /// Lets the operator's input into the run; `None` by the wall clock, where it comes directly.
    pub(super) gate: Option<Gate>,
    /// Holds virtual time back: while the operator pauses, the cell goes on in real time, not as
    /// fast as it computes. A verification waits for nobody.
    pub(super) pacer: Option<Pacer>,
}

impl BetweenPeriods {
    fn pass(&mut self, period: u64, world: &mut World) {
        if period.is_multiple_of(TRACES)
            && tracing::enabled!(target: "rubik_robot::truth", tracing::Level::TRACE)
        {
            world.trace(period);
        }
        self.observer.look(period, world);
        if let (Some(probe), Some(plant)) = (&mut self.probe, world.plant()) {
            probe(period, plant);
        }
        let tick = self.observer.length.tick(period);
        if let Some(gate) = &mut self.gate {
            gate.pass(tick);
        }
        if let Some(pacer) = &mut self.pacer {
            pacer.hold(tick as f64 * PERIOD);
        }
    }
}

/// The links to the servos of a run, before and after these run.
pub(super) struct Links {
    configs: Vec<ServoConfig>,
    edp_ends: Vec<ServoLink>,
    servo_ends: Vec<ServoEnd>,
}

impl Links {
    /// Creates a link for each arm, and sends what its servo must know before the first period.
    ///
    /// # Errors
    /// If a servo's mailbox is full.
    pub(super) fn create(config: &ControllerConfig, length: Length) -> Result<Self, Error> {
        let configs: Vec<_> = config
            .cell
            .arms
            .iter()
            .zip(&config.effectors)
            .map(|(arm, effector)| ServoConfig {
                period: length,
                ..ServoConfig::new(arm, effector.gains.clone())
            })
            .collect();
        let (mut links, ends): (Vec<ServoLink>, Vec<_>) =
            configs.iter().map(|_| driver::link_at(length)).unzip();
        let spoilt = ForceSettings {
            sign: f64::from(config.control.force_sign),
            delay_periods: config.control.force_delay_periods,
        };
        for link in &mut links {
            if spoilt != ForceSettings::default() {
                link.send(ServoCommand::ForceSettings(spoilt))
                    .map_err(|e| not_created("servo", &e.to_string()))?;
            }
        }
        Ok(Self { configs, edp_ends: links, servo_ends: ends })
    }
}

/// The parts of the servos.
pub(super) struct Parts {
    /// The links to them.
    pub(super) links: Links,
    /// Stops, holds and heartbeats of all servos.
    pub(super) switches: Arc<Switches>,
    /// Begins with them.
    pub(super) clock: Clock,
    /// Presses their emergency stop.
    pub(super) stop_button: StopButton,
    /// Where their records go: hash, recording, latest values.
    pub(super) trace: Trace,
    /// The recording that is verified.
    pub(super) playback: Option<Playback>,
    /// What happens between two periods.
    pub(super) between: BetweenPeriods,
}

/// The running servos.
pub(super) struct Servos {
    /// The EDPs' ends.
    pub(super) links: Vec<ServoLink>,
    /// The arms that know where they are from the beginning.
    pub(super) synchronised: Vec<bool>,
    /// Stops, holds and heartbeats of all servos.
    pub(super) switches: Arc<Switches>,
    /// Their periods.
    pub(super) clock: Clock,
    /// Presses their emergency stop.
    pub(super) stop_button: StopButton,
    driver: Driver,
}

/// The driver of time that runs the servos.
enum Driver {
    Virtual(tokio::task::JoinHandle<(World, Result<u64, PortFault>)>),
    Wall(Wall<World>, JoinHandle<()>),
}

/// The servos at the end of a run.
pub(super) struct Stopped {
    /// The world as the run leaves it.
    pub(super) world: World,
    /// The fault of the bridge that ended the run, if one did.
    pub(super) fault: Option<Error>,
}

/// Starts the servos over `world` with the driver of the scenario's pace.
///
/// # Errors
/// If the port fails at once, or the threads of the wall clock cannot be created.
pub(super) fn start_servos(
    drive: &Drive<'_>,
    mut world: World,
    parts: Parts,
) -> Result<Servos, Error> {
    let Parts {
        links: Links { configs, edp_ends: links, servo_ends: ends },
        switches,
        clock,
        stop_button,
        trace,
        playback,
        between,
    } = parts;
    let (recorder, latest) = (trace.recorder(), trace.latest().cloned());
    let seen = Seen { to: trace.hash().clone(), latest: latest.clone() };
    let new_core = |sink, world: &mut World| {
        Core::new(configs, ends, Arc::clone(&switches), sink, world)
            .map_err(|e| not_created("servo", &e.to_string()))
    };
    let (synchronised, driver);
    match drive.pace {
        Pace::Virtual => {
            let sink = recording::kept(Box::new(seen), recorder);
            let core = new_core(recording::with_playback(sink, playback), &mut world)?;
            synchronised = core.synchronised().collect();
            driver = run_virtual(core, world, drive.missed_limit, between);
        }
        Pace::RealTime => {
            // Half a second of records: the writer may be late, the servo never waits for it.
            let (ring, written) = rtrb::RingBuffer::<ServoRecord>::new(512 * links.len().max(1));
            let core = new_core(recording::kept(Box::new(ring), recorder), &mut world)?;
            synchronised = core.synchronised().collect();
            if let Some(latest) = &latest {
                latest.lock().punctual = Some((Arc::clone(&switches), drive.real_time.period));
            }
            let writer = write_records(written, seen);
            let mut observer = between.observer;
            let look = move |period: u64, world: &mut World| observer.look(period, world);
            let options =
                settings::wall(drive.real_time, drive.missed_limit, drive.require_real_time);
            let wall = driver::spawn_wall(core, world, look, options)
                .map_err(|e| not_created("servo thread", &e.to_string()))?;
            clock.begins();
            for warning in &wall.warnings {
                tracing::warn!("not real time: {warning}; `rubik-robot doctor` says what helps");
            }
            driver = Driver::Wall(wall, writer);
        }
    }
    Ok(Servos { links, synchronised, switches, clock, stop_button, driver })
}

/// Runs the servos as a task on paused time.
fn run_virtual(
    mut core: Core,
    mut world: World,
    limit: u64,
    mut between: BetweenPeriods,
) -> Driver {
    Driver::Virtual(tokio::spawn(async move {
        let pass = |period, world: &mut World| between.pass(period, world);
        let result = driver::run_virtual(&mut core, &mut world, limit, pass).await;
        (world, result)
    }))
}

/// Hashes and shows the records of a wall driver, on a thread of its own.
fn write_records(
    mut written: rtrb::Consumer<ServoRecord>,
    mut sink: Seen<RunHash>,
) -> JoinHandle<()> {
    std::thread::spawn(move || {
        while !written.is_abandoned() || !written.is_empty() {
            while let Ok(record) = written.pop() {
                sink.record(&record);
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    })
}

impl Servos {
    /// Waits until the driver has stopped; the switches must have told it to. `report` is called
    /// with the timing of a wall driver.
    ///
    /// # Errors
    /// If the task or a thread of the driver died.
    pub(super) async fn stopped(self, report: impl FnOnce(&Timing)) -> Result<Stopped, Error> {
        let bridge = |fault: PortFault| {
            let cause = Fatal::Bridge(fault.to_string());
            Error::Fatal { actor: "supervisor".into(), place: "servo", cause, last: None }
        };
        match self.driver {
            Driver::Virtual(servo) => {
                let (world, result) =
                    servo.await.map_err(|e| not_created("servo", &e.to_string()))?;
                Ok(Stopped { world, fault: result.err().map(bridge) })
            }
            Driver::Wall(wall, writer) => {
                let WallEnd { port, fault, timing } = wall.stop();
                report(&timing);
                tokio::task::yield_now().await;
                let _ = writer.join();
                let world = port.ok_or_else(|| not_created("bridge", "its thread died"))?;
                Ok(Stopped { world, fault: fault.map(bridge) })
            }
        }
    }
}
