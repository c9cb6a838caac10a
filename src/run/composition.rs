//! Course of a run from the operator's start to the verdict: starts servos and actors, performs the
//! task, brings the arms to rest.
//!
//! - in: the world, the operator's channels, the controller's half of the scenario, MP's assignment
//! - out: [`Done`], all facts from which the summary is made

use super::disturbance::InjectedFaults;
use super::failure::not_created;
use super::gate::Gate;
use super::measured_peaks::MeasuredPeaks;
use super::nodes::Nodes;
use super::operator::OperatorChannels;
use super::options::{PlantProbe, RunOptions};
use super::outcome::{Done, unaccounted};
use super::peers::Peers;
use super::plan::Plan;
use super::plant_hash::plant_hash;
use super::recording;
use super::servos::{
    self, BetweenPeriods, Drive, Links, Observer, Servos, SharedJudge, start_servos,
};
use super::simulation::FaultNotices;
use super::staff::{Staff, home, start_actors, start_drivers, supervise};
use super::task::{Assignment, entry_of, run_task};
use super::witness::Witness;
use super::world::{Sources, World};
use crate::actors::clock::Clock;
use crate::actors::control::{Control, Pacer};
use crate::actors::mp::{Ending, Turning};
use crate::actors::notice::Notice;
use crate::actors::services::Services;
use crate::actors::tuning::Tuning;
use crate::actors::watchdog::Supervision;
use crate::actors::work::Work;
use crate::cube::Facelets;
use crate::error::{Error, NonFatal};
use crate::hw::driver::{Switches, Timing};
use crate::hw::plant::{Verdict, Whereabouts};
use crate::hw::scene::{Scene, SceneArm};
use crate::kernel::Account;
use crate::motion::PERIOD;
use crate::record::last_second::LastSecond;
use crate::record::playback::Playback;
use crate::registry::{Judgement, Logbook, Truth};
use crate::scenario::keys::Pace;
use crate::scenario::{ControllerConfig, Scenario};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;

/// Time after an error in which the arms come to rest, before the drives are switched off (s).
const STAND: f64 = 0.6;

/// Parts of a run beside its world and its task.
pub(super) struct Composition<'a> {
    /// Scenario, with the cell as the controller believes it.
    pub(super) scenario: &'a Scenario,
    /// Options of the run's start.
    pub(super) options: RunOptions,
    /// Channels between the operator and the run.
    pub(super) operator: OperatorChannels,
    /// Recording that is verified.
    pub(super) playback: Option<Playback>,
    /// Keeper of the last second.
    pub(super) last_second: Option<LastSecond>,
    /// Largest forces that the wrists measure.
    pub(super) measured_peaks: MeasuredPeaks,
    /// Flags of the faults that are injected outside the plant.
    pub(super) faults: InjectedFaults,
    /// Probe of the plant, for a judge of the run.
    pub(super) probe: Option<PlantProbe>,
    /// Cameras that could not be calibrated, each with the reason.
    pub(super) uncalibrated: Vec<String>,
}

/// Facts of the plant before the first period.
struct Beginning {
    /// Cube at the beginning; `None` for hardware.
    start: Option<Facelets>,
    /// Distance of the nearest tool from the cube's centre (m).
    clearance: f64,
    /// Whether the cube is falling.
    falls: bool,
    /// Checksum of the limits of speed and force, see [`plant_hash`].
    bounds: u32,
    /// Plant before the first period; `None` for hardware.
    scene: Option<Scene>,
}

impl Beginning {
    /// Reads the facts from the world.
    ///
    /// # Errors
    /// If the plant's cube has a colour that does not exist.
    fn of(world: &World, controller: &ControllerConfig) -> Result<Self, Error> {
        let verdict = world.verdict();
        let falls = verdict.as_ref().is_some_and(|v| v.cube == Whereabouts::Falling);
        let start = verdict
            .map(|verdict| Facelets::try_from(verdict.facelets))
            .transpose()
            .map_err(|e| not_created("plant", &e.to_string()))?;
        let scene = world.scene();
        let clearance = scene.as_ref().map_or(f64::INFINITY, clearance);
        let bounds = world.plant().map_or(0, |plant| plant_hash(plant.bounds(), controller));
        Ok(Self { start, clearance, falls, bounds, scene })
    }

    /// Returns the facts of the plant at the end of a run: these from its beginning, the plant's
    /// verdict and scene at the end, the number of jams, and figures and files of the task; `None`
    /// for hardware.
    fn truth(self, end: Option<(Verdict, Scene)>, jams: u32, account: Account) -> Option<Truth> {
        let Account { figures: reported, documents, .. } = account;
        let Self { start, clearance, falls: falls_at_start, bounds, scene } = self;
        let (verdict, scene_at_end) = end?;
        let (start, scene_at_start) = (start?, scene?);
        Some(Truth {
            start,
            clearance,
            bounds,
            falls_at_start,
            verdict,
            jams,
            reported,
            documents,
            scene_at_start,
            scene_at_end,
        })
    }
}

/// Returns the distance of the nearest tool from the cube's centre (m).
fn clearance(scene: &Scene) -> f64 {
    let cube = scene.cube.world_from_cube.translation.vector;
    let arms = scene.arms.iter().take(scene.arm_count);
    let distance = |arm: &SceneArm| (arm.world_from_tool.translation.vector - cube).norm();
    arms.map(distance).fold(f64::INFINITY, f64::min)
}

/// Witness of jams, and MP's flag of a commanded turn, which it compares with the plant.
struct Jams {
    turning: Turning,
    witness: Arc<Mutex<Witness>>,
}

/// Returns the judgement of a judge on the plant.
fn judged(
    judge: &SharedJudge,
    scenario: &Scenario,
    truth: &Truth,
) -> Result<Option<Judgement>, Error> {
    let Some(judge) = judge else { return Ok(None) };
    let judge = judge.lock().unwrap_or_else(PoisonError::into_inner);
    Ok(Some(judge.judge(entry_of(scenario)?, &scenario.controller, truth)))
}

impl Jams {
    /// Creates the counter of jams. `control` tells it whether the operator pauses.
    fn watched(control: watch::Receiver<Control>) -> Self {
        let turning = Turning::default();
        let witness = Arc::new(Mutex::new(Witness::new(turning.clone(), control)));
        Self { turning, witness }
    }

    /// Returns the number of jams so far.
    fn count(&self) -> u32 {
        self.witness.lock().unwrap_or_else(PoisonError::into_inner).jams
    }
}

impl Composition<'_> {
    /// Performs the run, from the operator's start to the verdict. `plan` is the geometry with
    /// which the task begins, `logbook` the journal.
    ///
    /// # Errors
    /// If a part cannot be created, or an arm cannot be synchronised. Errors of the task are in
    /// [`Done`].
    pub(super) async fn perform(
        mut self,
        (world, sources): (World, Sources),
        plan: Plan,
        logbook: Logbook,
    ) -> Result<Done, Error> {
        // Read before the servos start, because their driver takes the world.
        let beginning = Beginning::of(&world, &self.scenario.controller)?;
        self.operator.started(self.options.wait).await?;
        // Before the servos: without all nodes no drive is switched on.
        let peers = self.peers().await?;
        if let Some(introduction) = &peers.introduction {
            self.operator.trace.recorder().record(0, || recording::node("", introduction));
        }
        let judge = entry_of(self.scenario)?.judge().map(|judge| Arc::new(Mutex::new(judge)));
        let (mut servos, jams) = self.start_servos(world, judge.clone())?;
        let services = self.services(servos.clock.clone());
        let pace = self.scenario.pace;
        // A blocked run makes no summary of its own, so its caller gets one without figures.
        let stuck = self.options.stuck.map(|stuck| {
            let scenario = self.scenario.clone();
            move |error: Error| {
                let summary = unaccounted(&scenario, &error);
                stuck(error, summary);
            }
        });
        let watchdog = &services.supervision.watchdog;
        let outside = supervise(&servos, watchdog, &self.faults, pace, stuck)
            .inspect_err(|_| servos.switches.stop.store(true, Ordering::Release))?;
        let to_task = self.operator.to_task.take();
        let turning = jams.turning.clone();
        // The staff must know both before MP exists: in neither case does it synchronise the arms.
        let properties = self.scenario.controller.task.properties;
        let by_hand = properties.by_hand && to_task.is_some();
        let resumes = logbook.is_broken_off();
        let meetings = plan.meetings;
        let assignment = Assignment { meetings, logbook, to_task, turning };
        let mut staff = self
            .staff(&mut servos, sources, (&services, peers), (by_hand, resumes))
            .await
            .inspect_err(|_| servos.switches.stop.store(true, Ordering::Release))?;
        let scenario = self.scenario;
        let mut performed =
            run_task(scenario, &mut staff, assignment, &services, &self.faults).await?;
        // An actor that has panicked stays marked as busy. The outside watch ends with the task, so
        // that it does not take that actor for a stuck one.
        drop(outside);
        let end = self.wind_down(servos, &staff.nodes, &mut performed.ending).await?;
        // The kernel gets no event after an error, but a cube may fall while the arms come to rest.
        if performed.ending.error.is_some() {
            performed.kernel.look_back(&staff.arms());
        }
        let truth = beginning.truth(end, jams.count(), performed.kernel.account());
        let hash = self.operator.trace.hash();
        let judgement = truth.as_ref().map(|truth| judged(&judge, scenario, truth));
        let judgement = judgement.transpose()?.flatten();
        Ok(Done {
            judgement,
            performed,
            truth,
            by_hand,
            hash: hash.hash(),
            servo_hash: hash.servo_hash(),
            uncalibrated: self.uncalibrated,
            links: staff.nodes.links(),
            measured_peaks: self.measured_peaks,
        })
    }

    /// Waits until all other nodes on the wall clock have joined the run.
    ///
    /// # Errors
    /// If one does not join, or the operator terminates the run before.
    async fn peers(&self) -> Result<Peers, Error> {
        let mut control = self.operator.control.subscribe();
        tokio::select! {
            biased;
            peers = Peers::join(self.scenario) => peers,
            Ok(_) = control.wait_for(|control| *control == Control::Terminated) => {
                let actor = "supervisor".to_owned();
                let cause = NonFatal::Terminated;
                Err(Error::NonFatal { actor, place: "join".into(), cause })
            }
        }
    }

    /// Puts a gate between operator and run, so that inputs pass between two periods only. Returns
    /// the gate, which the servos' driver opens after each period; `None` under the wall clock,
    /// which has no gate.
    fn close_gate(&mut self) -> Option<Gate> {
        (self.scenario.pace == Pace::Virtual)
            .then(|| self.operator.close_gate(self.playback.as_ref()))
    }

    /// Starts the servos in `world`, with the observers of the plant, of which `judge` is one.
    /// Returns the servos and the counter of jams.
    ///
    /// # Errors
    /// If a servo or its driver cannot be created.
    fn start_servos(&mut self, world: World, judge: SharedJudge) -> Result<(Servos, Jams), Error> {
        // The gate replaces the operator's channels: all parts below get those behind it.
        let gate = self.close_gate();
        let (scenario, operator) = (self.scenario, &mut self.operator);
        let switches = Arc::new(Switches::new(operator.stop_signal.clone()));
        let clock = Clock::new(tokio::time::Instant::now(), Arc::clone(&switches));
        let jams = Jams::watched(operator.control.subscribe());
        let drive = Drive {
            pace: scenario.pace,
            real_time: &scenario.real_time,
            missed_limit: scenario.missed_limit(),
            require_real_time: self.options.require_real_time,
        };
        let length = drive.length();
        let config = &scenario.controller;
        let here = config.network.servos_of(None, config.cell.arms.len());
        let links = Links::create(config, here, length)?;
        let trace = operator.trace.clone();
        let recorder = trace.recorder();
        let events = FaultNotices::new(scenario, trace.clone());
        let between = BetweenPeriods {
            observer: Observer::new(
                Arc::clone(&jams.witness),
                recorder.clone(),
                events,
                judge,
                length,
            )
            .showing(scenario, trace.latest()),
            probe: self.probe.take(),
            gate,
            // A verification has no person to watch it and runs at full speed.
            pacer: self
                .playback
                .is_none()
                .then(|| Pacer::new(operator.tempo.clone(), operator.control.subscribe())),
        };
        // Under virtual time the gate records the inputs.
        if scenario.pace == Pace::RealTime {
            operator.follow_orders(&clock);
            if recorder.is_on() {
                operator.record_inputs(&clock);
            }
        }
        let (stop_button, playback) = (operator.stop_button.clone(), self.playback.clone());
        let parts = servos::Parts {
            links,
            switches,
            clock,
            stop_button,
            trace,
            playback,
            last_second: self.last_second.clone(),
            measured_peaks: self.measured_peaks.clone(),
            between,
        };
        Ok((start_servos(&drive, world, parts)?, jams))
    }

    /// Returns what all actors share, such as `clock`, the operator's control, trace and
    /// supervision.
    fn services(&self, clock: Clock) -> Services {
        let pace = self.scenario.pace;
        let supervision = Supervision::of(pace);
        Services {
            clock,
            work: Work::new(pace, &supervision.watchdog),
            control: self.operator.control.subscribe(),
            tuning: Tuning::new(self.operator.tuner.courses.subscribe()),
            tempo: self.operator.tempo.clone(),
            trace: self.operator.trace.clone(),
            playback: self.playback.clone(),
            supervision,
        }
    }

    /// Starts all actors below MP and synchronises the arms. `by_hand` is whether the operator
    /// moves the arms, `resumes` whether the run continues an interrupted one; in both cases the
    /// arms are not synchronised here.
    ///
    /// # Errors
    /// The errors of [`home`] and [`start_actors`].
    async fn staff(
        &self,
        servos: &mut Servos,
        sources: Sources,
        (services, peers): (&Services, Peers),
        (by_hand, resumes): (bool, bool),
    ) -> Result<Staff, Error> {
        let config = &self.scenario.controller;
        let mut nodes = Nodes::start(config, self.scenario.seed, &self.faults, services, peers);
        let beside = (&self.faults, &nodes);
        let drivers = start_drivers(config, servos, services, beside, by_hand);
        nodes.begin(config, drivers.edps(), servos, services).await?;
        home(&drivers, &config.cell, services, resumes).await?;
        start_actors(config, drivers, sources, services, (&self.faults, nodes)).await
    }

    /// Brings the arms to rest, stops the servos, and returns the plant's verdict and scene; `None`
    /// without a plant. A fault of the bridge replaces the error in `ending`.
    ///
    /// # Errors
    /// If the driver of the servos died.
    async fn wind_down(
        &self,
        servos: Servos,
        nodes: &Nodes,
        ending: &mut Ending,
    ) -> Result<Option<(Verdict, Scene)>, Error> {
        let switches = Arc::clone(&servos.switches);
        if matches!(ending.error, Some(Error::System { .. })) {
            // An actor is broken: the remaining ones must not move the arms any more.
            switches.hold.store(true, Ordering::Release);
        }
        if ending.error.is_some() {
            // Drives must not go off under a moving arm: an interrupted motion comes to rest first.
            tokio::time::sleep(Duration::from_secs_f64(STAND)).await;
        }
        let settles = entry_of(self.scenario)?.settles();
        if ending.finish.as_ref().is_some_and(|f| f.achieved) && settles > 0.0 {
            tokio::time::sleep(Duration::from_secs_f64(settles)).await;
        }
        switches.stop.store(true, Ordering::Release);
        nodes.leave().await;
        let (trace, end) = (&self.operator.trace, ending.end);
        // The wall driver has a timing: histograms for the recording, lines for the operator.
        let report = |timing: &Timing| {
            trace.recorder().record((end / PERIOD) as u64, || recording::timing(timing));
            for line in timing.to_string().lines() {
                trace.tell(Notice::Note(end, format!("servo: {line}")));
            }
        };
        let stopped = servos.stopped(report).await?;
        let facts = stopped.world.verdict().zip(stopped.world.scene());
        let verdict = facts.as_ref().map(|(verdict, _)| verdict);
        tracing::debug!(?verdict, "world at the end");
        // Under virtual time periods are missed by injected faults only.
        let (_, _, missed) = switches.punctual.take();
        if missed > 0 && self.scenario.pace == Pace::Virtual {
            let text =
                format!("servo: {missed} periods missed; the last set values held meanwhile");
            trace.tell(Notice::Warning(end, text));
        }
        // A fault of the bridge is the cause of any error that the task reports.
        ending.error = stopped.fault.or(ending.error.take());
        Ok(facts)
    }
}
