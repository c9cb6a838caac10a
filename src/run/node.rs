//! A node beside that of MP, as a process on the wall clock: its servos, and its EDPs, ECPs and
//! VSPs, at the order of MP's node.
//!
//! - in: a scenario, the name of the node; messages of MP's node over the network
//! - out: [`NodeEnd`], once MP's node has ended the run or is silent

use super::bridge_log::BridgeLog;
use super::failure::not_created;
use super::interrupt::{Interrupt, SWITCHES_OFF};
use super::measured_peaks::MeasuredPeaks;
use super::peers::identity;
use super::recording;
use super::servos::{self, BetweenPeriods, Drive, Links, Observer, Servos, start_servos};
use super::simulation::FaultNotices;
use super::staff::camera_vsp;
use super::witness::Witness;
use super::world::{Sources, World};
use crate::actors::clock::Clock;
use crate::actors::control::{Control, Tempo};
use crate::actors::ecp::{self, Surroundings};
use crate::actors::edp;
use crate::actors::latest::LatestValues;
use crate::actors::manner::manner;
use crate::actors::mp::Turning;
use crate::actors::remote::{
    Host, Introduction, Left, Offset, Receiver, Sender, ToHome, ToNode, send_notices, send_pictures,
};
use crate::actors::services::Services;
use crate::actors::trace::Trace;
use crate::actors::tuning::Tuning;
use crate::actors::vsp::VspHandle;
use crate::actors::watchdog::{Outside, Supervision, Watchdog};
use crate::actors::work::Work;
use crate::emergency_stop::EmergencyStop;
use crate::error::{Error, System};
use crate::hw::driver::{Switches, Timing};
use crate::motion::ArmState;
use crate::net::{self, End, Traffic};
use crate::operator::parameter::Courses;
use crate::reach::guard::Guard;
use crate::record::recorder::Recorder;
use crate::record::run_hash::RunHash;
use crate::scenario::node_keys::NodeConfig;
use crate::scenario::{ControllerConfig, Owner, Scenario};
use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::watch;

/// Time in which arms come to rest after the end of the link, before the drives are switched off.
const STAND: Duration = Duration::from_millis(600);

/// Time of the wall clock after which an actor that blocks all others counts as stuck.
const STUCK: Duration = Duration::from_secs(1);
/// Exit code of a process with a system error.
const SYSTEM: i32 = 4;
/// Time in which a last message leaves before the session ends.
const SENT: Duration = Duration::from_millis(100);

/// Surroundings of a node's process.
pub(crate) struct NodeContext {
    /// Recorder of the node's part of the run.
    pub(crate) recorder: Recorder,
    /// Whether to refuse to run unless every real-time right is granted.
    pub(crate) require_real_time: bool,
}

/// End of a node's part of a run.
#[derive(Debug)]
pub(crate) struct NodeEnd {
    /// Error that ended it; `None` if MP's node ended the run.
    pub(crate) error: Option<Error>,
    /// Hash of the servo records of the node.
    pub(crate) servo_hash: String,
    /// Time from the beginning of the servo (s).
    pub(crate) seconds: f64,
    /// Punctuality of the servo, in lines for the operator.
    pub(crate) timing: String,
    /// Bytes sent to MP's node and received from it.
    pub(crate) traffic: Traffic,
}

/// Waits for MP's node and serves it for one run. `announce` is called with each line for the
/// operator.
///
/// # Errors
/// If the node cannot listen, or its devices cannot be opened. Errors of the run are in
/// [`NodeEnd`].
pub(crate) fn host(
    scenario: &Scenario,
    name: &str,
    context: NodeContext,
    announce: impl Fn(&str),
) -> Result<NodeEnd, Error> {
    let config = &scenario.controller;
    let failed = |why: String| not_created("node", &why);
    let node = config.network.nodes.iter().find(|node| node.name == name);
    let node = node.ok_or_else(|| failed(format!("the scenario has no node \"{name}\"")))?;
    let settings = config.network.settings.as_deref();
    let session = net::open(&[&node.endpoint], &[], settings).map_err(failed)?;
    let (link, parcels) = session.link(name, End::Node).map_err(failed)?;
    // The number of the run comes with the request to join.
    let (sender, receiver) = (Sender::new(link, 0), Receiver::new(parcels));
    announce(&format!("node {name} waits for MP's node at {}", node.endpoint));
    let runtime = super::runtime(scenario.pace, true)?;
    let end = runtime.block_on(async {
        let parts = Parts { scenario, node, sender, receiver, context };
        parts.serve(&announce).await
    });
    super::shut_down(runtime);
    end
}

/// Parts of a node that waits for its run.
struct Parts<'a> {
    scenario: &'a Scenario,
    node: &'a NodeConfig,
    sender: Sender<ToHome>,
    receiver: Receiver<ToNode>,
    context: NodeContext,
}

impl Parts<'_> {
    /// Waits until MP's node asks this node to join, and serves it to the end of the run.
    ///
    /// # Errors
    /// If the node's devices cannot be opened.
    async fn serve(mut self, announce: &impl Fn(&str)) -> Result<NodeEnd, Error> {
        let (stop, control) = (EmergencyStop::default(), watch::channel(Control::Waiting).0);
        let control = Arc::new(control);
        let signals = Interrupt::listen(Arc::clone(&control), stop.button());
        let interrupt = signals.map_err(|why| not_created("interrupt", &why.to_string()))?;
        let introduction = tokio::select! {
            introduction = self.joined() => introduction?,
            () = terminated(control.subscribe()) => {
                let error = Error::NonFatal {
                    actor: "node".into(),
                    place: "join".into(),
                    cause: crate::error::NonFatal::Interrupted,
                };
                return Err(error);
            }
        };
        let run = introduction.run;
        self.context.recorder.record(0, || recording::node(&self.node.name, &introduction));
        self.sender = self.sender.of_run(run);
        let begun = self.begin(run, &stop, &control);
        let begun = begun.inspect_err(|error| {
            self.sender.send(&ToHome::Refused { run, why: error.to_string() });
        })?;
        announce("joined: the servo runs");
        let Begun { host, servos, trace, clock, watchdog, _log } = begun;
        let signals = tokio::spawn(interrupted(control.subscribe(), watchdog.clone()));
        let outside = watched(&watchdog, &servos)
            .inspect_err(|_| servos.switches.stop.store(true, Ordering::Release))?;
        let left = host.serve(self.receiver.of_run(run)).await;
        drop(outside);
        signals.abort();
        drop(interrupt);
        let switches = Arc::clone(&servos.switches);
        if left != Left::Over {
            switches.hold.store(true, Ordering::Release);
            tokio::time::sleep(STAND).await;
        }
        let seconds = clock.period() as f64 * crate::motion::PERIOD;
        switches.stop.store(true, Ordering::Release);
        let mut timing = String::new();
        let (recorder, period) = (self.context.recorder.clone(), clock.period());
        let stopped = servos
            .stopped(|measured: &Timing| {
                recorder.record(period, || recording::timing(measured));
                timing = measured.to_string();
            })
            .await?;
        self.sender.send(&ToHome::Ended);
        tokio::time::sleep(SENT).await;
        let alone = |why: String| {
            let who = "MP's node".to_owned();
            let cause = System::Link { who, why };
            Error::System { actor: "node".into(), place: "link".into(), cause }
        };
        let error = match left {
            Left::Over => None,
            Left::Alone(why) => Some(alone(why)),
            Left::Failed(error) => Some(error),
        };
        let (servo_hash, traffic) = (trace.hash().servo_hash(), self.sender.traffic());
        Ok(NodeEnd { error: stopped.fault.or(error), servo_hash, seconds, timing, traffic })
    }

    /// Waits for a request to join that this node accepts.
    ///
    /// # Errors
    /// If the link ends.
    async fn joined(&mut self) -> Result<Introduction, Error> {
        let (program, scenario) = identity(self.scenario);
        let ended = || not_created("node", "the link has ended");
        loop {
            let message = self.receiver.recv().await.ok_or_else(ended)?;
            let Ok(ToNode::Join(introduction)) = message else {
                // A run goes on in which this node has no part, or another program uses the keys.
                continue;
            };
            let refused = |why: String| {
                self.sender.send(&ToHome::Refused { run: introduction.run, why });
            };
            if introduction.program != program {
                refused(format!("it is {program}, not {}", introduction.program));
            } else if introduction.scenario != scenario {
                refused("it has read another scenario, or other overrides".to_owned());
            } else {
                return Ok(introduction);
            }
        }
    }

    /// Opens the devices of the node, and starts its servos and actors.
    ///
    /// # Errors
    /// The first part that cannot be created.
    fn begin(
        &self,
        run: u64,
        stop: &EmergencyStop,
        control: &Arc<watch::Sender<Control>>,
    ) -> Result<Begun, Error> {
        let scenario = self.scenario;
        let name = Some(self.node.name.as_str());
        let (world, sources, notes) = World::of_hardware(scenario, name, control)?;
        let log = notes.map(|notes| BridgeLog::start(notes, &scenario.controller.cell));
        let log = log.transpose()?;
        // The pictures among the latest values go to MP's node.
        let latest = LatestValues::default();
        let recorder = self.context.recorder.clone();
        let (trace, notices) = Trace::new(RunHash::default(), recorder, Some(latest.clone()));
        send_notices(notices, self.sender.clone());
        let switches = Arc::new(Switches::new(stop.signal()));
        let clock = Clock::new(tokio::time::Instant::now(), Arc::clone(&switches));
        let mut servos = self.start_servos(world, (&trace, &clock, switches), stop, control)?;
        let supervision = Supervision::of(scenario.pace);
        let (told, orders) = watch::channel(Control::Running);
        let (ordered, courses) = watch::channel(Courses::new(&scenario.controller.bounds));
        let services = Services {
            clock: clock.clone(),
            work: Work::new(scenario.pace, &supervision.watchdog),
            control: orders,
            tuning: Tuning::new(courses),
            tempo: Tempo::default(),
            trace: trace.clone(),
            playback: None,
            supervision,
        };
        let watchdog = services.supervision.watchdog.clone();
        let orders = (told, ordered);
        let host = self.actors((run, &mut servos), sources, &services, (orders, stop))?;
        let (offset, watched) = (host.offset.clone(), Arc::clone(&host.watched));
        send_pictures(latest, self.sender.clone(), offset, watched)
            .map_err(|why| not_created("pictures", &why.to_string()))?;
        Ok(Begun { host, servos, trace, clock, watchdog, _log: log })
    }

    /// Starts the servos of the node in `world`.
    ///
    /// # Errors
    /// If a servo or its driver cannot be created.
    fn start_servos(
        &self,
        world: World,
        (trace, clock, switches): (&Trace, &Clock, Arc<Switches>),
        stop: &EmergencyStop,
        control: &Arc<watch::Sender<Control>>,
    ) -> Result<Servos, Error> {
        let scenario = self.scenario;
        let config = &scenario.controller;
        let drive = Drive {
            pace: scenario.pace,
            real_time: &scenario.real_time,
            missed_limit: scenario.missed_limit(),
            require_real_time: self.context.require_real_time,
        };
        let length = drive.length();
        let here = config.network.servos_of(Some(&self.node.name), config.cell.arms.len());
        let recorder = trace.recorder().clone();
        let witness = Witness::new(Turning::default(), control.subscribe());
        let events = FaultNotices::new(scenario, trace.clone());
        let observer = Observer::new(Arc::new(Mutex::new(witness)), recorder, events, None, length);
        let parts = servos::Parts {
            links: Links::create(config, here, length)?,
            switches,
            clock: clock.clone(),
            stop_button: stop.button(),
            trace: trace.clone(),
            playback: None,
            last_second: None,
            measured_peaks: MeasuredPeaks::default(),
            between: BetweenPeriods { observer, probe: None, gate: None, pacer: None },
        };
        start_servos(&drive, world, parts)
    }

    /// Starts the actors of the node over its servos.
    ///
    /// # Errors
    /// If a VSP has no camera.
    fn actors(
        &self,
        (run, servos): (u64, &mut Servos),
        mut sources: Sources,
        services: &Services,
        ((control, courses), stop): (Orders, &EmergencyStop),
    ) -> Result<Host, Error> {
        let config = &self.scenario.controller;
        let arms = &config.cell.arms;
        let links = std::mem::take(&mut servos.links);
        let edps: BTreeMap<_, _> = links
            .into_iter()
            .map(|(i, link)| (i, edp::spawn(&arms[i].name, link, services)))
            .collect();
        let vsps = self.vsps(&mut sources, services)?;
        let (others, states): (BTreeMap<_, _>, Vec<_>) = self.states(&edps);
        let guard = Guard::of(&config.cell, config.control.hand_speed);
        let mut ecps = BTreeMap::new();
        for &index in &self.node.ecps {
            let parts = ecp::Parts {
                edp: edps[&index].clone(),
                tracker: vsp_of(config, &vsps, Owner::Ecp(index), None),
                hand_camera: vsp_of(config, &vsps, Owner::Ecp(index), Some(index)),
                lag: config.network.lag(),
                sensors: Vec::new(),
                manner: manner(config, index),
                programmes: config.programmes.clone(),
                surroundings: Some(Surroundings {
                    effector: index,
                    guard: guard.clone(),
                    states: states.clone(),
                }),
                services: services.clone(),
            };
            ecps.insert(index, ecp::spawn(&arms[index].name, parts));
        }
        Ok(Host {
            run,
            arms: servos.synchronised.iter().map(|(arm, is)| (*arm, *is)).collect(),
            sender: self.sender.clone(),
            edps,
            ecps,
            vsps,
            states: others,
            control,
            courses,
            offset: Offset::default(),
            recorder: self.context.recorder.clone(),
            watched: Arc::default(),
            clock: services.clock.clone(),
            switches: Arc::clone(&servos.switches),
            stop_button: stop.button(),
            watchdog: services.supervision.watchdog.clone(),
            way: Duration::from_secs_f64(config.network.link.longest(1)),
        })
    }

    /// Starts the VSPs of the node.
    ///
    /// # Errors
    /// If a VSP has no camera.
    fn vsps(
        &self,
        sources: &mut Sources,
        services: &Services,
    ) -> Result<BTreeMap<usize, VspHandle>, Error> {
        let config = &self.scenario.controller;
        let started = self.node.vsps.iter().map(|&index| {
            let wanted = &config.vsps[index];
            camera_vsp(config, wanted, &mut sources.cameras, services).map(|vsp| (index, vsp))
        });
        started.collect()
    }

    /// Returns the places for the states of the arms of other nodes, and the states of all arms as
    /// the ECPs of this node see them.
    fn states(
        &self,
        edps: &BTreeMap<usize, edp::EdpHandle>,
    ) -> (BTreeMap<usize, watch::Sender<ArmState>>, Vec<watch::Receiver<ArmState>>) {
        let (mut others, mut seen) = (BTreeMap::new(), Vec::new());
        for index in 0..self.scenario.controller.cell.arms.len() {
            if let Some(edp) = edps.get(&index) {
                seen.push(edp.watch());
            } else {
                let (place, state) = watch::channel(ArmState::default());
                others.insert(index, place);
                seen.push(state);
            }
        }
        (others, seen)
    }
}

/// Watches the actors of a node from a thread outside their runtime, and ends the process if one of
/// them blocks all others: no other part could do that.
///
/// # Errors
/// If the system gives no thread.
fn watched(watchdog: &Watchdog, servos: &Servos) -> Result<Outside, Error> {
    let stop = servos.stop_button.clone();
    let outside = watchdog.watched_from_outside(STUCK, move |error| {
        stop.press();
        tracing::error!("{error}: the drives were ordered to switch off, and the node ends");
        std::thread::sleep(SWITCHES_OFF);
        std::process::exit(SYSTEM);
    });
    outside.map_err(|why| not_created("watch", &why.to_string()))
}

/// The operator's control and parameters, as MP's node sends them to the actors of a node.
type Orders = (watch::Sender<Control>, watch::Sender<Courses>);

/// Running parts of a node.
struct Begun {
    host: Host,
    servos: Servos,
    trace: Trace,
    clock: Clock,
    watchdog: Watchdog,
    /// Log of the bridge, which ends with this.
    _log: Option<BridgeLog>,
}

/// Returns the VSP of this node that an actor owns: one whose camera is in the hand of `arm`, or
/// the stand-alone camera's if it is `None`.
fn vsp_of(
    config: &ControllerConfig,
    vsps: &BTreeMap<usize, VspHandle>,
    owner: Owner,
    arm: Option<usize>,
) -> Option<VspHandle> {
    let found = vsps.iter().find(|(index, _)| {
        let vsp = &config.vsps[**index];
        let carrier = vsp.camera.and_then(|camera| config.cell.cameras[camera].mount.arm());
        vsp.owner == owner && carrier == arm
    });
    found.map(|(_, vsp)| vsp.clone())
}

/// Raises an error once a signal has terminated the node, so that MP's node ends the run.
async fn interrupted(control: watch::Receiver<Control>, watchdog: Watchdog) {
    terminated(control).await;
    let who = "node".to_owned();
    let cause = System::Link { who: who.clone(), why: "it was interrupted".into() };
    watchdog.raise(Error::System { actor: who, place: "signal".into(), cause });
}

/// Waits until the run is terminated; for ever if nothing can do that any more.
async fn terminated(mut control: watch::Receiver<Control>) {
    if control.wait_for(|control| *control == Control::Terminated).await.is_err() {
        std::future::pending::<()>().await;
    }
}
