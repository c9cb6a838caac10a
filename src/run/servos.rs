//! Servos of a run, and the driver that runs them: under virtual time, or by the wall clock.
//!
//! - in: a world behind its port, gains and limits of each effector, the pace of the scenario
//! - out: a link to each servo, the switches of all of them, and the world again after the run

use super::failure::not_created;
use super::gate::Gate;
use super::measured_peaks::MeasuredPeaks;
use super::options::PlantProbe;
use super::simulation::FaultNotices;
use super::witness::Witness;
use super::world::World;
use super::{recording, settings};
use crate::actors::clock::Clock;
use crate::actors::control::Pacer;
use crate::actors::latest::{LatestValues, Seen};
use crate::actors::trace::Trace;
use crate::emergency_stop::StopButton;
use crate::error::{Error, Fatal, System, panic_text};
use crate::hw::driver::{
    self, Core, RecordSink, ServoEnd, ServoLink, ServoRecord, Switches, Timing, Wall, WallEnd,
};
use crate::hw::port::PortFault;
use crate::motion::PERIOD;
use crate::record::last_second::LastSecond;
use crate::record::playback::Playback;
use crate::record::recorder::{Entry, Recorder};
use crate::registry::Judge;
use crate::scenario::keys::{Pace, RealTime};
use crate::scenario::{ControllerConfig, Scenario};
use crate::servo::period::Length;
use crate::servo::{ForceSettings, ServoCommand, ServoConfig};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Number of periods between two traces of the truth.
const TRACES: u64 = 50;

/// Clock of the servos, and its settings.
pub(super) struct Drive<'a> {
    /// Virtual time or the wall clock.
    pub(super) pace: Pace,
    /// Length of a period, and options of the servo's thread under the wall clock.
    pub(super) real_time: &'a RealTime,
    /// Number of periods missed in a row after which the arms brake and trip.
    pub(super) missed_limit: u64,
    /// Whether to refuse to run unless every real-time right is granted.
    pub(super) require_real_time: bool,
}

impl Drive<'_> {
    /// Returns the length of a servo period.
    pub(super) fn length(&self) -> Length {
        Length::of_seconds(self.real_time.period)
    }
}

/// Observer of the plant after each period, outside the controller.
pub(super) struct Observer {
    witness: Arc<Mutex<Witness>>,
    recorder: Recorder,
    events: FaultNotices,
    /// Judge of the task, if it has one.
    judge: SharedJudge,
    length: Length,
    /// Latest values for the UI, if there is one, and index and name of each loose object.
    shown: Option<(LatestValues, Vec<(usize, String)>)>,
}

/// Judge that watches the plant while the run goes on; `None` for a task without one.
pub(super) type SharedJudge = Option<Arc<Mutex<Box<dyn Judge>>>>;

impl Observer {
    /// Creates an observer that shows the plant to `witness`, `recorder`, `events` and `judge`.
    /// `length` is that of a servo period.
    pub(super) fn new(
        witness: Arc<Mutex<Witness>>,
        recorder: Recorder,
        events: FaultNotices,
        judge: SharedJudge,
        length: Length,
    ) -> Self {
        Self { witness, recorder, events, judge, length, shown: None }
    }

    /// Returns the observer that also shows the UI where the loose objects of `scenario` are.
    pub(super) fn showing(self, scenario: &Scenario, latest: Option<&LatestValues>) -> Self {
        let objects = scenario.objects().iter().enumerate();
        let loose = objects.filter(|(_, keys)| !keys.is_fixed());
        let loose: Vec<_> = loose.map(|(i, keys)| (i, keys.name.clone())).collect();
        let shown = latest.filter(|_| !loose.is_empty()).map(|latest| (latest.clone(), loose));
        Self { shown, ..self }
    }

    /// Shows the plant's scene to its cameras, and the plant to recording, event log and witness.
    fn look(&mut self, period: u64, world: &mut World) {
        // Hardware and recordings have no truth to observe.
        let Some(turned) = world.show() else { return };
        let tick = self.length.tick(period);
        if tick.is_multiple_of(recording::SCENES) {
            self.recorder
                .record_some(tick, || world.scene().map(|scene| Entry::Scene(Box::new(scene))));
            self.events.look(tick, world.plant());
            if let Some((latest, loose)) = &self.shown
                && let Some(scene) = world.scene()
            {
                let place = |(i, name): &(usize, String)| {
                    let object = scene.objects.get(*i).copied().flatten()?;
                    Some((name.clone(), object.world_from_object))
                };
                latest.placed(loose.iter().filter_map(place));
            }
        }
        // The run itself takes these locks at its end only, so the servo's thread never waits.
        if let (Some(judge), Some(plant)) = (&self.judge, world.plant()) {
            judge.lock().unwrap_or_else(PoisonError::into_inner).watch(tick, plant);
        }
        self.witness.lock().unwrap_or_else(PoisonError::into_inner).look(tick, turned);
    }
}

/// Work between two periods of a virtual run.
pub(super) struct BetweenPeriods {
    /// Observer of the plant.
    pub(super) observer: Observer,
    /// Probe of the plant, for a judge of the run.
    pub(super) probe: Option<PlantProbe>,
    /// Gate for the operator's input; `None` under the wall clock, where it reaches the run
    /// directly.
    pub(super) gate: Option<Gate>,
    /// Limit of virtual time: while the operator pauses, the cell continues in real time and not as
    /// fast as it computes. `None` for a verification.
    pub(super) pacer: Option<Pacer>,
}

impl BetweenPeriods {
    /// Performs what is due after a period: observers and probe look at the plant, the gate passes
    /// inputs, the pacer holds virtual time back.
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
        // Inputs and time count in periods of 2 ms, also where a servo period is longer or shorter.
        let tick = self.observer.length.tick(period);
        if let Some(gate) = &mut self.gate {
            gate.pass(tick);
        }
        if let Some(pacer) = &mut self.pacer {
            pacer.hold(tick as f64 * PERIOD);
        }
    }
}

/// Links to the servos of a run, before the servos are started.
pub(super) struct Links {
    /// Indices of the effectors.
    effectors: Vec<usize>,
    configs: Vec<ServoConfig>,
    edp_ends: Vec<ServoLink>,
    servo_ends: Vec<ServoEnd>,
}

impl Links {
    /// Creates a link for each of these effectors, and sends the settings that its servo needs
    /// before the first period.
    ///
    /// # Errors
    /// If a servo's mailbox is full.
    pub(super) fn create(
        config: &ControllerConfig,
        effectors: Vec<usize>,
        length: Length,
    ) -> Result<Self, Error> {
        let servo = |&effector: &usize| {
            let (arm, gains) = (&config.cell.arms[effector], &config.effectors[effector].gains);
            ServoConfig { period: length, ..ServoConfig::new(arm, gains.clone()) }
        };
        let configs: Vec<_> = effectors.iter().map(servo).collect();
        let (mut links, ends): (Vec<ServoLink>, Vec<_>) =
            configs.iter().map(|_| driver::link_at(length)).unzip();
        // Only a scenario that spoils the force control on purpose, for an experiment, has settings
        // of its own.
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
        Ok(Self { effectors, configs, edp_ends: links, servo_ends: ends })
    }
}

/// Parts of which the servos are started.
pub(super) struct Parts {
    /// Links to the servos.
    pub(super) links: Links,
    /// Stops, holds and heartbeats of all servos.
    pub(super) switches: Arc<Switches>,
    /// Clock of the actors, which begins with the servos.
    pub(super) clock: Clock,
    /// Button of the emergency stop that the servos read.
    pub(super) stop_button: StopButton,
    /// Receiver of the servo records: hash, recording, latest values.
    pub(super) trace: Trace,
    /// Recording that is verified.
    pub(super) playback: Option<Playback>,
    /// Keeper of the last second.
    pub(super) last_second: Option<LastSecond>,
    /// Largest forces that the wrists measure.
    pub(super) measured_peaks: MeasuredPeaks,
    /// Work between two periods.
    pub(super) between: BetweenPeriods,
}

/// Running servos.
pub(super) struct Servos {
    /// EDPs' ends of the links, by effector.
    pub(super) links: BTreeMap<usize, ServoLink>,
    /// Whether the arm of each effector is synchronised from the beginning.
    pub(super) synchronised: BTreeMap<usize, bool>,
    /// Stops, holds and heartbeats of all servos.
    pub(super) switches: Arc<Switches>,
    /// Clock of the actors, in servo periods.
    pub(super) clock: Clock,
    /// Button of the emergency stop that the servos read.
    pub(super) stop_button: StopButton,
    driver: Driver,
}

/// Driver that runs the servos.
enum Driver {
    Virtual(tokio::task::JoinHandle<(World, Result<u64, PortFault>)>),
    Wall(Wall<World>, JoinHandle<()>),
}

/// State of the servos at the end of a run.
pub(super) struct Stopped {
    /// World as the run leaves it.
    pub(super) world: World,
    /// Fault of the bridge, if one ended the run.
    pub(super) fault: Option<Error>,
}

/// Starts the servos over `world` with the driver of the scenario's pace.
///
/// # Errors
/// If the first exchange of the port fails, or the threads of the wall clock cannot be created.
pub(super) fn start_servos(
    drive: &Drive<'_>,
    mut world: World,
    parts: Parts,
) -> Result<Servos, Error> {
    let Parts {
        links: Links { effectors, configs, edp_ends: links, servo_ends: ends },
        switches,
        clock,
        stop_button,
        trace,
        playback,
        last_second,
        measured_peaks,
        between,
    } = parts;
    let (recorder, latest) = (trace.recorder(), trace.latest().cloned());
    let seen = Seen { to: trace.hash().clone(), latest: latest.clone() };
    let seen = recording::with(recording::with(Box::new(seen), last_second), Some(measured_peaks));
    let new_core = |sink, world: &mut World| {
        Core::new(configs, ends, Arc::clone(&switches), sink, world)
            .map(|core| core.of_effectors(&effectors))
            .map_err(|e| not_created("servo", &e.to_string()))
    };
    let (synchronised, driver);
    match drive.pace {
        // Servos and sinks run in one task: records are hashed, kept and compared at once.
        Pace::Virtual => {
            let sink = recording::with(seen, recorder.ticks());
            let core = new_core(recording::with(sink, playback), &mut world)?;
            synchronised = core.synchronised().collect::<Vec<_>>();
            driver = run_virtual(core, world, drive.missed_limit, between);
        }
        Pace::RealTime => {
            // The ring holds 512 periods, which is 1 s at 2 ms: the writer may be late, and the
            // servo never waits for it.
            let (ring, written) = rtrb::RingBuffer::<ServoRecord>::new(512 * links.len().max(1));
            let core = new_core(recording::with(Box::new(ring), recorder.ticks()), &mut world)?;
            synchronised = core.synchronised().collect();
            if let Some(latest) = &latest {
                latest.lock().punctual = Some((Arc::clone(&switches), drive.real_time.period));
            }
            let writer = write_records(written, seen)?;
            // Neither gate nor pacer: the wall clock cannot be held, and inputs arrive as they
            // come.
            let mut observer = between.observer;
            let look = move |period: u64, world: &mut World| observer.look(period, world);
            let options =
                settings::wall(drive.real_time, drive.missed_limit, drive.require_real_time);
            let wall = driver::spawn_wall(core, world, look, options)
                .map_err(|e| not_created("servo thread", &e.to_string()))?;
            // Periods count from the start of the thread, not from the creation of the clock.
            clock.begins();
            for warning in &wall.warnings {
                tracing::warn!("not real time: {warning}; `rubik-robot doctor` shows the remedies");
            }
            driver = Driver::Wall(wall, writer);
        }
    }
    let links = effectors.iter().copied().zip(links).collect();
    let synchronised = effectors.iter().copied().zip(synchronised).collect();
    Ok(Servos { links, synchronised, switches, clock, stop_button, driver })
}

/// Runs the servos as a task under virtual time. `limit` is the number of periods missed in a row
/// after which the arms brake and trip; `between` is called after each period.
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

/// Hashes the records of a wall driver and updates the latest values, on a thread of its own.
///
/// # Errors
/// If the system gives no thread.
fn write_records(
    mut written: rtrb::Consumer<ServoRecord>,
    mut sink: Box<dyn RecordSink>,
) -> Result<JoinHandle<()>, Error> {
    let thread = std::thread::Builder::new().name("records".into());
    let work = move || {
        // The servo's thread drops its end of the ring as it stops; the records that are left in it
        // are still written.
        while !written.is_abandoned() || !written.is_empty() {
            while let Ok(record) = written.pop() {
                sink.record(&record);
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    thread.spawn(work).map_err(|why| not_created("writer of servo records", &why.to_string()))
}

/// Returns the error of a thread or task of the driver that panicked.
fn died(who: &str, why: String) -> Error {
    let cause = System::Panicked { who: who.to_owned(), why };
    Error::System { actor: "supervisor".into(), place: "servo".into(), cause }
}

impl Servos {
    /// Waits until the driver has stopped, which the run must have requested by [`Switches`]
    /// before. Returns the world and a fault of the bridge. `report` is called with the timing of a
    /// wall driver.
    ///
    /// # Errors
    /// If the task or a thread of the driver died.
    pub(super) async fn stopped(self, report: impl FnOnce(&Timing)) -> Result<Stopped, Error> {
        let bridge = |fault: PortFault| {
            let cause = Fatal::Bridge(fault.to_string());
            Error::Fatal { actor: "supervisor".into(), place: "servo".into(), cause, last: None }
        };
        match self.driver {
            Driver::Virtual(servo) => {
                let (world, result) = servo.await.map_err(|error| {
                    let why = error.try_into_panic().map(|why| panic_text(&*why));
                    died("the servos' task", why.unwrap_or_else(|error| error.to_string()))
                })?;
                Ok(Stopped { world, fault: result.err().map(bridge) })
            }
            Driver::Wall(wall, writer) => {
                let WallEnd { port, fault, timing, panic } = wall.stop();
                report(&timing);
                tokio::task::yield_now().await;
                let written = writer.join().map_err(|why| panic_text(&*why));
                let written = written.err().map(|why| ("the writer of servo records", why));
                // A panic comes first: the bridge reports a dead servo as a silent one.
                let panic = panic.or(written).map(|(who, why)| died(who, why));
                let Some(world) = port else {
                    return Err(panic.unwrap_or_else(|| not_created("bridge", "it was stopped")));
                };
                Ok(Stopped { world, fault: panic.or(fault.map(bridge)) })
            }
        }
    }
}
