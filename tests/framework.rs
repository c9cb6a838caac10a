//! Tests of the framework without the cube: actors around a plant, with a task of a few lines.
//!
//! The first test shows that a new task needs no code of the project except its own kernel.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

use nalgebra::{Point3, Vector3};
use rubik_robot::actors::clock::Clock;
use rubik_robot::actors::control::Control;
use rubik_robot::actors::ecp::{EcpHandle, Outbox, Report, Surroundings};
use rubik_robot::actors::edp::EdpHandle;
use rubik_robot::actors::manner;
use rubik_robot::actors::move_instruction::{Manner, example_manner};
use rubik_robot::actors::mp::{Coordination, Ending, Mp, Parts};
use rubik_robot::actors::notice::Notice;
use rubik_robot::actors::services::Services;
use rubik_robot::actors::trace::Trace;
use rubik_robot::actors::work::Work;
use rubik_robot::actors::{ecp, edp};
use rubik_robot::cell::Arm;
use rubik_robot::emergency_stop::{EmergencyStop, StopButton};
use rubik_robot::error::{Error, Fatal, NonFatal};
use rubik_robot::generators::contact::{Guarded, GuardedOrder};
use rubik_robot::generators::own::{Clock as MotionClock, MotionGenerator, OwnOrder, Pacing, Site};
use rubik_robot::generators::paths::{Along, Line};
use rubik_robot::generators::{Behaviour, Inputs, Next, Outcome};
use rubik_robot::hw::driver::{self, Core, ServoLink, Switches};
use rubik_robot::hw::plant::fault::{Fault, What, When};
use rubik_robot::hw::plant::{Plant, PlantConfig};
use rubik_robot::hw::scene::Scene;
use rubik_robot::kernel::programme::{EcpTask, Programmes};
use rubik_robot::kernel::robot::{Hindrance, Robot, RobotKernel};
use rubik_robot::kernel::{
    Action, Adjustment, ConclusionOf, Event, Finish, Forces, Input, Kernel, Message, Programme,
    Progress, Readings, Signal, Until, WristLoad,
};
use rubik_robot::motion::{
    ArmFault, ArmState, Direction, Frame, JointPositions, Motion, MoveCommand, MoveRefused,
};
use rubik_robot::reach::guard::Guard;
use rubik_robot::record::journal::{Durable, Journal};
use rubik_robot::record::run_hash::RunHash;
use rubik_robot::scenario::keys::Pace;
use rubik_robot::servo::ServoConfig;
use rubik_robot::spatial::Pose;
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::{mpsc, watch};

/// Task that moves the joints of the first effector by these distances (m, rad), at half of the
/// full speed.
struct Shift(JointPositions);

impl Kernel for Shift {
    type Thought = ();
    type Entry = Progress;

    fn next(&mut self, event: Event<()>, readings: &Readings<'_>) -> Action<()> {
        let arms = readings.arms;
        match event {
            Event::Start => {
                let at = arms[0].desired_joints;
                let target = JointPositions(std::array::from_fn(|i| at.0[i] + self.0.0[i]));
                let order = Behaviour::Joints { target, speed: 0.5, seconds: 0.0 };
                Action::Behave { orders: vec![Some(order)], until: Until::All }
            }
            Event::Behaved(outcomes) => Action::Finish(Finish {
                achieved: outcomes == [Some(Outcome::Reached)],
                reason: Outcome::words(outcomes[0].as_ref()),
            }),
            Event::Trouble(reason) => Action::Finish(Finish { achieved: false, reason }),
            other => Action::Finish(Finish { achieved: false, reason: format!("{other:?}") }),
        }
    }
}

/// One effector without sensors, with its actors and its plant.
struct Rig {
    mp: Mp,
    edp: EdpHandle,
    control: watch::Sender<Control>,
    notices: mpsc::Receiver<Notice>,
    stop: StopButton,
    scene: Arc<Mutex<Scene>>,
    world_from_base: Pose,
}

/// Scenario of the track arm alone, without a camera.
const ONE_ARM: &str = "task = \"idle\"\ncamera = []\nvsp = []\n[[effector]]\nname = \"track\"\n";

/// Makes a rig without a journal.
fn rig(coordination: Coordination) -> Rig {
    rig_with_journal(coordination, |_| None)
}

/// Makes a rig whose MP keeps the journal that `journal` returns. The closure gets the scene of the
/// plant, so that a test can observe the arm at each write.
fn rig_with_journal(
    coordination: Coordination,
    journal: impl FnOnce(&Arc<Mutex<Scene>>) -> Option<Journal>,
) -> Rig {
    rig_of(coordination, journal, Vec::new(), None)
}

/// Makes a rig with a journal as in [`rig_with_journal`], faults of its plant, and the forces that
/// a VSP publishes.
fn rig_of(
    coordination: Coordination,
    journal: impl FnOnce(&Arc<Mutex<Scene>>) -> Option<Journal>,
    faults: Vec<Fault>,
    forces: Option<watch::Receiver<Forces>>,
) -> Rig {
    let hash = RunHash::default();
    let stop = EmergencyStop::default();
    let switches = Arc::new(Switches::new(stop.signal()));
    let (arm, link, scene) = start_faulty_arm(&switches, &hash, faults);
    let clock = Clock::new(tokio::time::Instant::now(), Arc::clone(&switches));

    let (control, will) = watch::channel(Control::Running);
    let (trace, notices) = Trace::bare(hash);
    let services = Services::bare(clock, will, trace);
    let (edp, ecp) = actors_of(&arm.name, link, &services);
    let parts = Parts::bare(vec![ecp], vec![manner()], services);
    let mp = Mp::new(Parts { coordination, journal: journal(&scene), forces, ..parts });
    Rig {
        mp,
        edp,
        control,
        notices,
        stop: stop.button(),
        scene,
        world_from_base: arm.world_from_base,
    }
}

/// Starts the plant and the servo of the arm of [`ONE_ARM`]. Returns the arm, the link to its servo
/// and the scene of the plant.
fn start_arm(switches: &Arc<Switches>, hash: &RunHash) -> (Arm, ServoLink, Arc<Mutex<Scene>>) {
    start_faulty_arm(switches, hash, Vec::new())
}

/// Starts plant and servo like [`start_arm`], with these faults of the plant.
fn start_faulty_arm(
    switches: &Arc<Switches>,
    hash: &RunHash,
    faults: Vec<Fault>,
) -> (Arm, ServoLink, Arc<Mutex<Scene>>) {
    let scenario = rubik_robot::tasks::read(Path::new("one_arm.toml"), ONE_ARM, &[]).unwrap();
    let config = scenario.controller;
    assert!(config.vsps.is_empty() && config.cell.arms.len() == 1);
    let arm = config.cell.arms[0].clone();
    let world = PlantConfig { faults, ..PlantConfig::new(config.cell) };
    let mut plant = Plant::new(world, 1).unwrap();
    let (link, end) = driver::link();
    let servo = ServoConfig::new(&arm, config.effectors[0].gains.clone());
    let records = Box::new(hash.clone());
    let mut core =
        Core::new(vec![servo], vec![end], Arc::clone(switches), records, &mut plant).unwrap();
    let scene = Arc::new(Mutex::new(plant.scene()));
    let seen = Arc::clone(&scene);
    tokio::spawn(async move {
        let publish = |_, plant: &mut Plant| *seen.lock().unwrap() = plant.scene();
        driver::run_virtual(&mut core, &mut plant, u64::MAX, publish).await
    });
    (arm, link, scene)
}

/// Starts the EDP and the ECP of an effector with this name.
fn actors_of(name: &str, link: ServoLink, services: &Services) -> (EdpHandle, EcpHandle) {
    let edp = edp::spawn(name, link, services);
    let ecp = ecp::spawn(name, ecp_parts(&edp, services));
    (edp, ecp)
}

/// Returns the parts of an ECP without sensors and without a cell.
fn ecp_parts(edp: &EdpHandle, services: &Services) -> ecp::Parts {
    ecp::Parts {
        edp: edp.clone(),
        tracker: None,
        hand_camera: None,
        sensors: Vec::new(),
        programmes: programmes(),
        manner: manner(),
        lag: 0,
        surroundings: None,
        services: services.clone(),
    }
}

/// Makes an MP with three effectors, each with a plant of its own. Returns it with their EDPs.
fn three_arms(coordination: Coordination) -> (Mp, Vec<EdpHandle>) {
    let hash = RunHash::default();
    let arms: Vec<_> = (0..3)
        .map(|_| {
            let switches = Arc::new(Switches::new(EmergencyStop::default().signal()));
            let (_, link, _) = start_arm(&switches, &hash);
            (switches, link)
        })
        .collect();
    let clock = Clock::new(tokio::time::Instant::now(), Arc::clone(&arms[0].0));
    let services = Services::bare(clock, watch::channel(Control::Running).1, Trace::bare(hash).0);
    let actors = arms.into_iter().enumerate();
    let (edps, ecps): (Vec<_>, _) =
        actors.map(|(i, (_, link))| actors_of(&format!("arm {i}"), link, &services)).unzip();
    let parts = Parts::bare(ecps, vec![manner(); 3], services);
    (Mp::new(Parts { coordination, ..parts }), edps)
}

/// Programme that moves its arm by a share of [`SHIFT`], tells MP, waits for its signal "again" and
/// moves as far once more.
struct Twice;

impl EcpTask for Twice {
    type Order = f64;
    type Kernel = RobotKernel;

    fn kernel(share: f64) -> RobotKernel {
        Robot::kernel(move |robot| async move {
            robot.behave(0, by(&robot, share)).await?;
            robot.signal(0, Signal::new("moved")).await?;
            let told = robot.receive(20.0).await?;
            let again = Message::Signal { effector: 0, signal: Signal::new("again") };
            if told != Some(again) {
                return Err(Hindrance(format!("told {told:?}")));
            }
            robot.behave(0, by(&robot, share)).await?;
            Ok("moved twice".to_owned())
        })
    }
}

/// Returns the order that moves the joints of the first arm of `robot` by a share of [`SHIFT`].
fn by(robot: &Robot, share: f64) -> Behaviour {
    let at = robot.arms()[0].desired_joints;
    let target = JointPositions(std::array::from_fn(|i| at.0[i] + share * SHIFT.0[i]));
    Behaviour::Joints { target, speed: 0.5, seconds: 0.0 }
}

/// Returns the programmes of these tests.
fn programmes() -> Programmes {
    let mut programmes = Programmes::default();
    programmes.register::<Twice>("twice");
    programmes.register::<Refits>("refits");
    programmes.register::<Plunges>("plunges");
    programmes
}

/// Returns the order to begin the programme "twice".
fn twice(share: f64) -> Programme {
    Twice::programme("twice", &share).unwrap()
}

/// Distances of the task: column and wrist, about a second of motion (rad; m on the track).
const SHIFT: JointPositions = JointPositions([0.05, 0.2, 0.0, 0.0, 0.0, 0.1, -0.3]);

impl Rig {
    /// Returns the pose of the tool in the plant.
    fn world_from_tool(&self) -> Pose {
        self.scene.lock().unwrap().arms[0].world_from_tool
    }

    /// Lets the arm hold its pose for this number of periods; returns its state after them.
    async fn hold(&self, periods: u32) -> ArmState {
        self.edp.execute(MoveCommand { motion: Motion::Hold, periods, jaw: None }).await.unwrap()
    }
}

/// Lets this time pass (s).
async fn seconds(seconds: f64) {
    tokio::time::sleep(Duration::from_secs_f64(seconds)).await;
}

/// Returns the largest difference of any joint (m or rad).
fn furthest(a: &JointPositions, b: &JointPositions) -> f64 {
    a.0.iter().zip(b.0).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Runs a task that moves one arm by [`SHIFT`]. Returns the ending of the run, and the set joint
/// positions before and after it.
async fn whole_run(coordination: Coordination) -> (Ending, JointPositions, JointPositions) {
    let rig = rig(coordination);
    let from = rig.edp.state().await.unwrap().desired_joints;
    let ending = rig.mp.run(&mut Shift(SHIFT)).await;
    // The EDP answers two periods before the end of the motion.
    seconds(0.01).await;
    let to = rig.edp.state().await.unwrap();
    assert!(furthest(&to.joints, &to.desired_joints) < 0.02, "the arm follows its set values");
    (ending, from, to.desired_joints)
}

/// One effector without sensors runs a task that handles no cube, under both schemes of
/// coordination.
#[tokio::test(start_paused = true)]
async fn one_arm_runs_task_under_both_coordination_schemes() {
    for coordination in [Coordination::Sporadic, Coordination::Continuous] {
        let (ending, from, to) = whole_run(coordination).await;

        assert_eq!(ending.error, None);
        assert!(ending.finish.unwrap().achieved);
        let wanted = JointPositions(std::array::from_fn(|i| from.0[i] + SHIFT.0[i]));
        assert!(furthest(&to, &wanted) < 1e-9, "{to:?} {wanted:?} {from:?}");
    }
}

/// Generator of a user: turns the last joint by the ordered angle (rad) in a second and returns it.
struct Nudge(f64, JointPositions, MotionClock);

impl MotionGenerator for Nudge {
    type Order = f64;

    fn begin(by: f64, site: &Site<'_>) -> Result<Self, String> {
        if by.abs() > 0.5 {
            return Err(format!("{by} rad are too far"));
        }
        Ok(Self(by, site.arm.desired_joints, MotionClock::new(site)))
    }

    fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        if self.2.time() >= 1.0 {
            return Next::Done(Outcome::own(&self.0));
        }
        let part = self.2.advance(inputs).min(1.0);
        let mut at = self.1;
        at.0[6] += self.0 * part * part * (3.0 - 2.0 * part);
        Next::go(Motion::Joints(at))
    }

    fn pacing(&self) -> Pacing {
        Pacing::Clock
    }
}

/// Returns the parameters of generators in these tests. [`Nudge`] enters by the registry and the
/// scenario, as in a program of a user.
fn manner() -> Manner {
    let catalogue = rubik_robot::tasks::built_in().generator::<Nudge>("nudge").catalogue();
    let read = rubik_robot::scenario::read(Path::new("one_arm.toml"), ONE_ARM, &[], &catalogue);
    let library = manner::manner(&read.unwrap().controller, 0).library;
    Manner { library, ..example_manner() }
}

/// Task that orders the first arm one motion and ends with its outcome in words.
struct Orders(Behaviour);

impl Kernel for Orders {
    type Thought = ();
    type Entry = Progress;

    fn next(&mut self, event: Event<()>, _: &Readings<'_>) -> Action<()> {
        match event {
            Event::Start => {
                Action::Behave { orders: vec![Some(self.0.clone())], until: Until::All }
            }
            Event::Trouble(reason) => Action::Finish(Finish { achieved: false, reason }),
            other => Action::Finish(Finish { achieved: true, reason: format!("{other:?}") }),
        }
    }
}

/// Runs an order on one arm. Returns the reason with which its task finishes, and by how much the
/// joints have moved (m or rad).
async fn ordered(coordination: Coordination, order: Behaviour) -> (String, JointPositions) {
    let rig = rig(coordination);
    let from = rig.edp.state().await.unwrap().desired_joints;
    let ending = rig.mp.run(&mut Orders(order)).await;
    assert_eq!(ending.error, None);
    seconds(0.01).await;
    let to = rig.edp.state().await.unwrap().desired_joints;
    let moved = JointPositions(std::array::from_fn(|i| to.0[i] - from.0[i]));
    (ending.finish.unwrap().reason, moved)
}

#[tokio::test(start_paused = true)]
async fn registered_generator_runs_under_both_coordination_schemes() {
    for coordination in [Coordination::Sporadic, Coordination::Continuous] {
        let order = Nudge::behaviour("nudge", &0.25).unwrap();
        let (reason, moved) = ordered(coordination, order).await;

        assert_eq!(reason, "Behaved([Some(Own(Number(0.25)))])", "{coordination:?}");
        assert!((moved.0[6] - 0.25).abs() < 1e-9, "{coordination:?}: {moved:?}");

        // A generator of the crate enters by the same door.
        let mut target = rig(coordination).edp.state().await.unwrap().desired_base_from_tool;
        target.translation.vector.z += 0.05;
        let line = Along::<Line>::behaviour("line", &Line { target, speed: 0.5 }).unwrap();
        let (reason, _) = ordered(coordination, line).await;
        assert_eq!(reason, "Behaved([Some(Reached)])", "{coordination:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn unknown_generator_and_refused_order_move_nothing() {
    let unknown = OwnOrder { generator: "nod".into(), order: 0.1.into(), fraction: 1.0 };
    let far = Nudge::behaviour("nudge", &0.7).unwrap();
    let orders = [(Behaviour::Own(unknown), "no generator `nod`; known: "), (far, "too far")];
    for coordination in [Coordination::Sporadic, Coordination::Continuous] {
        for (order, why) in &orders {
            let (reason, moved) = ordered(coordination, order.clone()).await;

            assert!(reason.contains(why), "{coordination:?}: {reason}");
            assert_eq!(furthest(&moved, &JointPositions::default()), 0.0);
        }
    }
}

/// A pause brings a registered generator to rest on its way, and a resume continues it.
#[tokio::test(start_paused = true)]
async fn pause_and_resume_keep_registered_motion() {
    for coordination in [Coordination::Sporadic, Coordination::Continuous] {
        let Rig { mp, edp, control, .. } = rig(coordination);
        let from = edp.state().await.unwrap().desired_joints;
        let mut target = edp.state().await.unwrap().desired_base_from_tool;
        target.translation.vector.z += 0.1;
        let line = Along::<Line>::behaviour("line", &Line { target, speed: 1.0 }).unwrap();
        let mission = tokio::spawn(async move { mp.run(&mut Orders(line)).await });

        seconds(0.6).await;
        control.send(Control::Paused).unwrap();
        seconds(2.0).await;
        let stopped = edp.state().await.unwrap().desired_joints;
        seconds(1.0).await;
        let still = edp.state().await.unwrap().desired_joints;
        control.send(Control::Running).unwrap();
        let ending = mission.await.unwrap();

        assert_eq!(stopped, still, "{coordination:?}");
        assert!(furthest(&from, &stopped) > 0.01, "{coordination:?}");
        assert_eq!(ending.finish.unwrap().reason, "Behaved([Some(Reached)])");
        seconds(0.01).await;
        let end = edp.state().await.unwrap().desired_base_from_tool;
        let off = (end.translation.vector - target.translation.vector).norm();
        assert!(off < 1e-6, "{coordination:?}: {off} m");
    }
}

/// Task that orders the first arm a short motion, the second none and the third a long one, and
/// ends with their outcomes in words.
struct Uneven(Until);

impl Kernel for Uneven {
    type Thought = ();
    type Entry = Progress;

    fn next(&mut self, event: Event<()>, readings: &Readings<'_>) -> Action<()> {
        let by = |arm: usize, share: f64| {
            let at = readings.arms[arm].desired_joints;
            let target = JointPositions(std::array::from_fn(|i| at.0[i] + share * SHIFT.0[i]));
            Some(Behaviour::Joints { target, speed: 0.5, seconds: 0.0 })
        };
        match event {
            Event::Start => {
                Action::Behave { orders: vec![by(0, 0.5), None, by(2, 1.0)], until: self.0 }
            }
            other => Action::Finish(Finish { achieved: true, reason: format!("{other:?}") }),
        }
    }
}

#[tokio::test(start_paused = true)]
async fn three_arms_carry_out_their_own_orders() {
    for coordination in [Coordination::Sporadic, Coordination::Continuous] {
        for (until, outcomes, third) in [
            (Until::All, "Behaved([Some(Reached), None, Some(Reached)])", 1.0..1.0),
            (Until::Effector(0), "Behaved([Some(Reached), None, Some(Ended)])", 0.5..0.99),
        ] {
            let (mp, edps) = three_arms(coordination);
            let mut from = Vec::new();
            for edp in &edps {
                from.push(edp.state().await.unwrap().desired_joints);
            }

            let ending = mp.run(&mut Uneven(until)).await;

            assert_eq!(ending.finish.unwrap().reason, outcomes, "{coordination:?}");
            seconds(0.01).await;
            let mut shares = Vec::new();
            for (edp, from) in edps.iter().zip(&from) {
                let to = edp.state().await.unwrap().desired_joints;
                shares.push((to.0[6] - from.0[6]) / SHIFT.0[6]);
            }
            assert!((shares[0] - 0.5).abs() < 1e-9 && shares[1].abs() < 1e-9, "{shares:?}");
            let near = third.start - 1e-9..third.end + 1e-9;
            assert!(near.contains(&shares[2]), "{coordination:?} {until:?} {shares:?}");
        }
    }
}

/// MP starts a programme on two of three arms, answers their signals and does nothing else. Both
/// run beside each other, and each ends by itself.
#[tokio::test(start_paused = true)]
async fn programmes_exchange_signals_with_dormant_mp() {
    let (mp, edps) = three_arms(Coordination::Sporadic);
    let mut from = Vec::new();
    for edp in &edps {
        from.push(edp.state().await.unwrap().desired_joints);
    }
    let (told, heard) = std::sync::mpsc::channel();
    let mut kernel = Robot::kernel(move |robot| async move {
        robot.start(0, twice(0.2)).await?;
        robot.start(2, twice(0.4)).await?;
        let mut ended = 0;
        while ended < 2 {
            let Some(message) = robot.receive(30.0).await? else {
                return Err(Hindrance("no message came".to_owned()));
            };
            match &message {
                Message::Signal { effector, .. } => {
                    robot.signal(*effector, Signal::new("again")).await?;
                }
                Message::Ended { .. } => ended += 1,
            }
            told.send(message).unwrap();
        }
        Ok("both have ended".to_owned())
    });

    let ending = mp.run(&mut kernel).await;

    assert_eq!(ending.error, None);
    let finish = ending.finish.unwrap();
    assert!(finish.achieved, "{finish:?}");
    let end = Finish { achieved: true, reason: "moved twice".to_owned() };
    let messages: Vec<Message> = heard.try_iter().collect();
    for effector in [0, 2] {
        let signal = Signal::new("moved");
        assert!(messages.contains(&Message::Signal { effector, signal }), "{messages:?}");
        assert!(messages.contains(&Message::Ended { effector, finish: end.clone() }));
    }
    // Both arms have moved before the first programme ended.
    let first_end = messages.iter().position(|m| matches!(m, Message::Ended { .. }));
    assert_eq!((messages.len(), first_end), (4, Some(2)), "{messages:?}");
    seconds(0.01).await;
    for (edp, (from, share)) in edps.iter().zip(from.iter().zip([0.4, 0.0, 0.8])) {
        let to = edp.state().await.unwrap().desired_joints;
        let wanted = JointPositions(std::array::from_fn(|i| from.0[i] + share * SHIFT.0[i]));
        assert!(furthest(&to, &wanted) < 1e-9, "{to:?} {wanted:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn mp_must_not_order_arm_with_programme() {
    let (mp, _edps) = three_arms(Coordination::Sporadic);
    let mut kernel = Robot::kernel(|robot| async move {
        robot.start(1, twice(0.2)).await?;
        let taken = robot.start(1, twice(0.2)).await.unwrap_err();
        let unknown = robot.start(0, Programme { name: "sing".into(), order: 1.into() }).await;
        let idle = robot.signal(0, Signal::new("again")).await.unwrap_err();
        for (refusal, reason) in [
            (taken, "carries out a programme already"),
            (unknown.unwrap_err(), "there is no programme `sing`"),
            (idle, "effector 0 carries out no programme"),
        ] {
            assert!(refusal.0.contains(reason), "{refusal}");
        }
        robot.behave(1, by(&robot, 0.1)).await?;
        Ok("ordered".to_owned())
    });

    let ending = mp.run(&mut kernel).await;

    let Some(Error::Fatal { cause: Fatal::Kernel(why), .. }) = ending.error else {
        panic!("{ending:?}")
    };
    assert!(why.contains("orders effector 1, which carries out a programme"), "{why}");
}

/// A pause holds the arm of a programme, and the end of the run ends the programme.
#[tokio::test(start_paused = true)]
async fn pause_and_terminate_reach_programmes() {
    let Rig { mp, edp, control, .. } = rig(Coordination::Sporadic);
    let mut kernel = Robot::kernel(|robot| async move {
        robot.start(0, twice(1.0)).await?;
        let told = robot.receive(1000.0).await?;
        Err(Hindrance(format!("{told:?}")))
    });
    let run = tokio::spawn(async move { mp.run(&mut kernel).await });
    seconds(0.3).await;
    control.send_replace(Control::Paused);
    seconds(1.0).await;
    let at = edp.state().await.unwrap().desired_joints;
    seconds(1.0).await;
    let still = edp.state().await.unwrap().desired_joints;
    control.send_replace(Control::Running);
    seconds(0.3).await;
    let on = edp.state().await.unwrap().desired_joints;
    control.send_replace(Control::Terminated);
    seconds(1.0).await;
    let over = edp.state().await.unwrap().desired_joints;
    seconds(1.0).await;

    assert!(furthest(&at, &still) < 1e-12, "the pause holds the arm");
    assert!(furthest(&on, &still) > 1e-3, "the arm goes on");
    assert!(furthest(&over, &edp.state().await.unwrap().desired_joints) < 1e-12);
    assert_eq!(run.await.unwrap().finish, None);
}

/// Task that orders a motion of a second arm.
struct Surplus;

impl Kernel for Surplus {
    type Thought = ();
    type Entry = Progress;

    fn next(&mut self, _: Event<()>, _: &Readings<'_>) -> Action<()> {
        let order = Behaviour::Present { pull: 1.0, selector: [false; 6], seconds: 0.1 };
        Action::Behave { orders: vec![None, Some(order)], until: Until::All }
    }
}

#[tokio::test(start_paused = true)]
async fn order_to_missing_effector_is_a_defect() {
    for coordination in [Coordination::Sporadic, Coordination::Continuous] {
        let ending = rig(coordination).mp.run(&mut Surplus).await;

        let Some(Error::Fatal { cause: Fatal::Kernel(why), .. }) = ending.error else {
            panic!("{ending:?}")
        };
        assert!(why.contains("2 orders, for 1"), "{why}");
    }
}

#[tokio::test(start_paused = true)]
async fn actors_end_with_their_last_handle() {
    let rig = rig(Coordination::Sporadic);
    let mut states = rig.edp.watch();
    rig.mp.run(&mut Shift(SHIFT)).await;

    drop(rig.edp);

    // The EDP closes its watch when it ends; until then it may still publish.
    tokio::time::timeout(Duration::from_secs(1), async { while states.changed().await.is_ok() {} })
        .await
        .expect("the EDP does not end");
}

#[tokio::test(start_paused = true)]
async fn pause_stops_arm_and_resume_finishes_motion() {
    let (_, _, wanted) = whole_run(Coordination::Sporadic).await;
    let Rig { mp, edp, control, .. } = rig(Coordination::Sporadic);
    let mission = tokio::spawn(async move { mp.run(&mut Shift(SHIFT)).await });
    seconds(0.6).await;

    control.send_replace(Control::Paused);
    // The arm decelerates within 0.6 s and a macrostep: a sudden stop would trip a power stage.
    seconds(0.6 + 2.0 * 0.016).await;
    let stopped = edp.state().await.unwrap().desired_joints;
    seconds(2.0).await;
    let later = edp.state().await.unwrap();

    assert_eq!(stopped, later.desired_joints);
    assert!(furthest(&later.joints, &stopped) < 0.01);
    assert!(furthest(&stopped, &wanted) > 0.05, "it was in mid-motion");
    assert!(!mission.is_finished());

    control.send_replace(Control::Running);
    let ending = mission.await.unwrap();

    assert!(ending.finish.unwrap().achieved);
    assert!(furthest(&edp.state().await.unwrap().desired_joints, &wanted) < 1e-5);
}

#[tokio::test(start_paused = true)]
async fn operators_terminate_ends_run_without_result_or_error() {
    for coordination in [Coordination::Sporadic, Coordination::Continuous] {
        let Rig { mp, edp, control, mut notices, .. } = rig(coordination);
        let mission = tokio::spawn(async move { mp.run(&mut Shift(SHIFT)).await });
        seconds(0.6).await;

        control.send_replace(Control::Terminated);
        let ending = mission.await.unwrap();

        assert_eq!((ending.finish, ending.error), (None, None));
        assert!(ending.end < 1.3, "ended at {}", ending.end);
        let stopped = edp.state().await.unwrap().desired_joints;
        seconds(1.0).await;
        assert_eq!(edp.state().await.unwrap().desired_joints, stopped);
        assert!(notices.try_recv().is_err(), "a terminate is not an error");
    }
}

/// The report of a refused command has its class, actor and place. The task decides how it
/// continues.
#[tokio::test(start_paused = true)]
async fn operator_sees_refused_command_and_task_continues() {
    let mut rig = rig(Coordination::Sporadic);
    let beyond = JointPositions([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0]);

    let ending = rig.mp.run(&mut Shift(beyond)).await;

    let Some(Notice::Error(time, Error::NonFatal { actor, place, cause })) =
        rig.notices.recv().await
    else {
        panic!("no non-fatal error")
    };
    assert!(time > 0.0);
    assert_eq!((actor.as_str(), place.as_ref()), ("edp track", "execute"));
    let limit = |cause: &NonFatal| {
        matches!(
            cause,
            NonFatal::Refused(MoveRefused::JointLimit { .. } | MoveRefused::MotorLimit { .. })
        )
    };
    assert!(limit(&cause), "{cause}");
    // The kernel received the trouble and finished the run itself.
    let finish = ending.finish.unwrap();
    assert!(!finish.achieved && finish.reason.contains("edp track"), "{}", finish.reason);
    assert_eq!(ending.error, None);
}

/// The operator gets the fatal error of the ending as a notice.
#[tokio::test(start_paused = true)]
async fn failed_effector_ends_run_with_fatal_error() {
    let Rig { mp, edp, stop, mut notices, control: _control, .. } = rig(Coordination::Sporadic);
    let mission = tokio::spawn(async move { mp.run(&mut Shift(SHIFT)).await });
    seconds(0.6).await;

    stop.press();
    let ending = mission.await.unwrap();

    let Some(Error::Fatal { actor, place, cause, last: Some(last) }) = &ending.error else {
        panic!("{ending:?}");
    };
    let cause_of_stop = &Fatal::Arm(ArmFault::EmergencyStop);
    assert_eq!((actor.as_str(), &**place, cause), ("edp track", "execute", cause_of_stop));
    assert!(last.period > 0 && last.fault == Some(ArmFault::EmergencyStop));
    assert_eq!(ending.finish, None);
    assert!(matches!(
        notices.recv().await,
        Some(Notice::Error(_, told)) if Some(&told) == ending.error.as_ref()
    ));
    let told = edp.state().await.unwrap_err().to_string();
    assert!(told.starts_with("emergency stop (fatal, edp track, state, period "), "{told}");
}

/// Moves the arm for one second with a velocity in one of the six directions of a frame. Returns
/// the pose of the tool in the plant before and after.
async fn moved(rig: &Rig, frame: Frame, direction: usize, velocity: f64) -> (Pose, Pose) {
    let before = rig.world_from_tool();
    let mut directions = [Direction::HOLD; 6];
    directions[direction] = Direction::Unguarded { velocity };
    let command =
        MoveCommand { motion: Motion::Task { frame, directions }, periods: 500, jaw: None };
    rig.edp.execute(command).await.unwrap();
    rig.hold(250).await;
    (before, rig.world_from_tool())
}

/// A velocity in the frame of the base moves the tool along the base, one in the frame of the tool
/// along the tool.
#[tokio::test(start_paused = true)]
async fn velocity_moves_tool_along_axes_of_its_frame() {
    let rig = rig(Coordination::Sporadic);
    rig.hold(100).await;
    for direction in 0..3 {
        let unit = nalgebra::Vector3::from_fn(|i, _| if i == direction { 1.0 } else { 0.0 });

        let (before, after) = moved(&rig, Frame::Base, direction, 0.01).await;
        let way = after.translation.vector - before.translation.vector;
        assert!((way - rig.world_from_base * unit * 0.01).norm() < 2e-4, "base {direction}: {way}");

        let (before, after) = moved(&rig, Frame::Tool, direction, -0.01).await;
        let way = after.translation.vector - before.translation.vector;
        assert!((way + before * unit * 0.01).norm() < 2e-4, "tool {direction}: {way}");
    }
    // The two frames differ at this pose; otherwise the test would prove little.
    let z = nalgebra::Vector3::z();
    assert!((rig.world_from_tool() * z - rig.world_from_base * z).norm() > 0.5);
}

#[tokio::test(start_paused = true)]
async fn tool_change_affects_only_later_motions() {
    let rig = rig(Coordination::Sporadic);
    let state = rig.hold(200).await;
    let before = rig.world_from_tool();
    let old = rubik_robot::tasks::read(Path::new("one_arm.toml"), ONE_ARM, &[]).unwrap();
    let old = old.controller.cell.arms[0].flange_from_tool;
    let longer = Pose::translation(0.0, 0.0, 0.1);

    let told = rig.edp.adjust(Adjustment::Tool(old * longer)).await.unwrap();
    seconds(1.0).await;

    let after = rig.world_from_tool();
    assert!((after.translation.vector - before.translation.vector).norm() < 5e-5);
    let reported = state.base_from_tool.inverse() * told.base_from_tool;
    assert!((reported.translation.vector - longer.translation.vector).norm() < 5e-5);

    // A rotation about the new tool's x leaves the new tool point where it is.
    let (before, after) = moved(&rig, Frame::Tool, 3, 0.1).await;
    let point = |pose: Pose| (pose * longer).translation.vector;
    assert!((after.translation.vector - before.translation.vector).norm() > 5e-3);
    assert!((point(after) - point(before)).norm() < 5e-4);
}

/// Returns the order to move the tool 20 mm up, along z of the base.
fn up() -> Behaviour {
    let direction = nalgebra::Vector3::z();
    let (frame, speed, force, distance) = (Frame::Base, 0.02, 10.0, 0.02);
    let order = GuardedOrder { frame, direction, speed, force, distance };
    Guarded::behaviour("guarded", &order).unwrap()
}

/// Changes the tool frame to one 0.1 m farther, moves up in the base, and asks for a tool that is
/// not rigid. Returns in words by how far the tool seemed to move with the frame, and the refusal.
async fn refit(robot: Robot, old: Pose) -> Result<String, Hindrance> {
    let before = robot.arms()[0].base_from_tool;
    robot.set_tool(0, old * Pose::translation(0.0, 0.0, 0.1)).await?;
    let after = robot.arms()[0].base_from_tool;
    let outcome = robot.behave(0, up()).await?;
    let mut bent = old;
    bent.translation.x = f64::INFINITY;
    let refused = robot.set_tool(0, bent).await.unwrap_err();
    robot.set_load(0, 0.93, Point3::new(0.0, 0.0, 0.25)).await?;
    let way = (after.translation.vector - before.translation.vector).norm();
    Ok(format!("{way:.4} m, {outcome:?}, {refused}"))
}

/// Programme that refits its arm as [`refit`] does.
struct Refits;

impl EcpTask for Refits {
    type Order = ();
    type Kernel = RobotKernel;

    fn kernel((): ()) -> RobotKernel {
        Robot::kernel(|robot| refit(robot, flange_from_tool()))
    }
}

/// Returns the tool frame of the arm of [`ONE_ARM`].
fn flange_from_tool() -> Pose {
    let scenario = rubik_robot::tasks::read(Path::new("one_arm.toml"), ONE_ARM, &[]).unwrap();
    scenario.controller.cell.arms[0].flange_from_tool
}

/// A kernel changes the tool frame during operation and moves along the base, by MP under both
/// schemes of coordination and by a programme of the ECP.
#[tokio::test(start_paused = true)]
async fn kernel_changes_tool_and_moves_along_base() {
    for scheme in [Some(Coordination::Sporadic), Some(Coordination::Continuous), None] {
        let rig = rig(scheme.unwrap_or(Coordination::Sporadic));
        rig.hold(200).await;
        let before = rig.world_from_tool();
        let mut kernel = Robot::kernel(move |robot| async move {
            if scheme.is_some() {
                return refit(robot, flange_from_tool()).await;
            }
            robot.start(0, Refits::programme("refits", &()).map_err(Hindrance)?).await?;
            let taken = robot.set_tool(0, flange_from_tool()).await.unwrap_err();
            assert!(taken.0.contains("carries out a programme"), "{taken}");
            match robot.receive(30.0).await? {
                Some(Message::Ended { finish, .. }) => Ok(finish.reason),
                other => Err(Hindrance(format!("{other:?}"))),
            }
        });
        let (scene, world_from_base) = (Arc::clone(&rig.scene), rig.world_from_base);

        let ending = rig.mp.run(&mut kernel).await;
        seconds(0.5).await;

        let finish = ending.finish.unwrap();
        assert!(finish.reason.starts_with("0.1000 m, NotTouched, "), "{scheme:?}: {finish:?}");
        assert!(finish.reason.contains("the new tool frame is not rigid"), "{finish:?}");
        let after = scene.lock().unwrap().arms[0].world_from_tool;
        let way = after.translation.vector - before.translation.vector;
        let wanted = world_from_base * Vector3::new(0.0, 0.0, 0.02);
        assert!((way - wanted).norm() < 6e-4, "{scheme:?}: {way}");
    }
}

/// Programme that moves its tool straight down by 1 m, and then changes its frame.
struct Plunges;

impl EcpTask for Plunges {
    type Order = ();
    type Kernel = RobotKernel;

    fn kernel((): ()) -> RobotKernel {
        Robot::kernel(|robot| async move {
            let mut target = robot.arms()[0].desired_base_from_tool;
            target.translation.vector.z -= 1.0;
            let down = Behaviour::Line { target, speed: 0.5 };
            let refused = robot.behave(0, down).await.unwrap_err();
            robot.set_tool(0, longer()).await?;
            Err(refused)
        })
    }
}

/// Returns the tool frame that [`Plunges`] leaves.
fn longer() -> Pose {
    flange_from_tool() * Pose::translation(0.0, 0.0, 0.1)
}

#[tokio::test(start_paused = true)]
async fn ecp_checks_programme_path_and_reports_tool() {
    let hash = RunHash::default();
    let switches = Arc::new(Switches::new(EmergencyStop::default().signal()));
    let (_, link, _) = start_arm(&switches, &hash);
    let clock = Clock::new(tokio::time::Instant::now(), switches);
    let services = Services::bare(clock, watch::channel(Control::Running).1, Trace::bare(hash).0);
    let edp = edp::spawn("track", link, &services);
    let cell = rubik_robot::tasks::read(Path::new("one_arm.toml"), ONE_ARM, &[]).unwrap();
    let guard = Guard::of(&cell.controller.cell, 0.25);
    let surroundings = Some(Surroundings { effector: 0, guard, states: vec![edp.watch()] });
    let parts = ecp::Parts { surroundings, ..ecp_parts(&edp, &services) };
    let ecp = ecp::spawn("track", parts);
    let before = edp.state().await.unwrap().desired_joints;
    let (mailbox, mut reports) = mpsc::unbounded_channel();

    let programme = Plunges::programme("plunges", &()).unwrap();
    ecp.start(programme, Outbox { effector: 0, mailbox }).await.unwrap();
    let Report { message, tool } = reports.recv().await.unwrap();

    let Message::Ended { finish, .. } = message else { panic!("{message:?}") };
    assert!(finish.reason.contains("ecp track, check a path"), "{finish:?}");
    assert!(finish.reason.contains("the track arm cannot follow its path"), "{finish:?}");
    assert_eq!(tool, Some(longer()));
    let after = edp.state().await.unwrap().desired_joints;
    assert!(furthest(&before, &after) < 1e-12);
}

/// An arm that trips ends its programme. MP resets it, and starts the programme once more.
#[tokio::test(start_paused = true)]
async fn kernel_resets_arm_whose_programme_failed() {
    let what = What::LimitSwitch { arm: 0, axis: 1 };
    let faults = vec![Fault { what, when: When::At(0.5), lasts: 0.5 }];
    let rig = rig_of(Coordination::Sporadic, |_| None, faults, None);
    let mut kernel = Robot::kernel(|robot| async move {
        robot.start(0, twice(0.4)).await?;
        let ended = robot.receive(30.0).await?;
        let Some(Message::Ended { finish, .. }) = ended else {
            return Err(Hindrance(format!("{ended:?}")));
        };
        assert!(finish.reason.contains("limit switch"), "{finish:?}");
        // The switch is pressed until then.
        robot.receive(1.0).await?;
        robot.reset(0).await?;
        robot.start(0, twice(0.1)).await?;
        robot.receive(30.0).await?;
        robot.signal(0, Signal::new("again")).await?;
        match robot.receive(30.0).await? {
            Some(Message::Ended { finish, .. }) => Ok(finish.reason),
            other => Err(Hindrance(format!("{other:?}"))),
        }
    });

    let ending = rig.mp.run(&mut kernel).await;

    assert_eq!(ending.error, None);
    assert_eq!(ending.finish.unwrap().reason, "moved twice");
}

/// An input of the parallel interface is set from 1.0 s to 1.5 s. A kernel waits for both.
#[tokio::test(start_paused = true)]
async fn kernel_waits_for_binary_input() {
    let faults =
        vec![Fault { what: What::Input { arm: 0, bit: 3 }, when: When::At(1.0), lasts: 0.5 }];
    let rig = rig_of(Coordination::Sporadic, |_| None, faults, None);
    let mut kernel = Robot::kernel(|robot| async move {
        let (door, other) = (Input { effector: 0, bit: 3 }, Input { effector: 0, bit: 2 });
        assert_eq!((robot.input(door), robot.input(other)), (Some(false), Some(false)));
        assert!(!robot.wait_input(door, true, 0.3).await?, "too early");
        assert!(robot.wait_input(door, true, 5.0).await?);
        let set = robot.arms()[0].period;
        assert_eq!(robot.input(other), Some(false));
        assert!(robot.wait_input(door, false, 5.0).await?);
        let cleared = robot.arms()[0].period;
        let unknown = robot.wait_input(Input { effector: 7, bit: 0 }, true, 1.0).await;
        assert!(unknown.unwrap_err().0.contains("there is no input"));
        Ok(format!("{set} {cleared}"))
    });

    let ending = rig.mp.run(&mut kernel).await;

    let periods: Vec<u64> =
        ending.finish.unwrap().reason.split(' ').map(|word| word.parse().unwrap()).collect();
    // A kernel looks every 20 ms.
    assert!((500..530).contains(&periods[0]) && (750..780).contains(&periods[1]), "{periods:?}");
}

/// A kernel reads the forces that a VSP aggregates: it goes on once the force has risen.
#[tokio::test(start_paused = true)]
async fn kernel_reads_forces_of_vsp() {
    let of = |force: f64| Forces { arms: vec![WristLoad { force, ..WristLoad::default() }] };
    let (publish, forces) = watch::channel(of(0.0));
    let rig = rig_of(Coordination::Sporadic, |_| None, Vec::new(), Some(forces));
    tokio::spawn(async move {
        seconds(1.0).await;
        publish.send_replace(of(12.5));
        seconds(60.0).await;
    });
    let mut kernel = Robot::kernel(|robot| async move {
        let mut waits = 0;
        while robot.forces().arms[0].force < 10.0 {
            robot.receive(0.1).await?;
            waits += 1;
        }
        Ok(format!("{} N after {waits}", robot.forces().arms[0].force))
    });

    let ending = rig.mp.run(&mut kernel).await;

    let reason = ending.finish.unwrap().reason;
    assert!(["12.5 N after 10", "12.5 N after 11"].contains(&reason.as_str()), "{reason}");
}

/// During a pause no request to the arm is open. The emergency stop nevertheless ends the run, and
/// the operator gets one notice of it.
#[tokio::test(start_paused = true)]
async fn emergency_stop_in_pause_ends_run_at_once() {
    for coordination in [Coordination::Sporadic, Coordination::Continuous] {
        let Rig { mp, control, stop, mut notices, .. } = rig(coordination);
        let mission = tokio::spawn(async move { mp.run(&mut Shift(SHIFT)).await });
        tokio::time::sleep(Duration::from_millis(500)).await;
        control.send_replace(Control::Paused);
        tokio::time::sleep(Duration::from_secs(2)).await;
        stop.press();
        tokio::time::sleep(Duration::from_millis(200)).await;

        assert!(mission.is_finished(), "the stop is not detected before the pause ends");
        let ending = mission.await.unwrap();
        assert!(matches!(ending.error, Some(Error::Fatal { .. })), "{ending:?}");
        let told = std::iter::from_fn(|| notices.try_recv().ok());
        assert_eq!(told.filter(|n| matches!(n, Notice::Error(_, Error::Fatal { .. }))).count(), 1);
    }
}

/// Task with an entry in the journal before each of its actions.
struct Journaled<K>(K);

impl<K: Kernel> Kernel for Journaled<K> {
    type Thought = K::Thought;
    type Entry = Progress;

    fn next(
        &mut self,
        event: Event<ConclusionOf<K>>,
        readings: &Readings<'_>,
    ) -> Action<K::Thought> {
        self.0.next(event, readings)
    }

    fn entry(&self) -> Option<Progress> {
        Some(Progress { doing: "moving".to_owned(), over: false })
    }
}

/// Disk that records the pose of the tool at each write.
#[derive(Debug)]
struct SceneProbe {
    scene: Arc<Mutex<Scene>>,
    seen: Arc<Mutex<Vec<Pose>>>,
}

impl Durable for SceneProbe {
    fn append(&mut self, _: &[u8]) -> io::Result<()> {
        let tool = self.scene.lock().unwrap().arms[0].world_from_tool;
        self.seen.lock().unwrap().push(tool);
        Ok(())
    }
}

#[tokio::test(start_paused = true)]
async fn journal_is_written_before_motion_begins() {
    for coordination in [Coordination::Sporadic, Coordination::Continuous] {
        let seen = Arc::new(Mutex::new(Vec::new()));
        let rig = rig_with_journal(coordination, |scene| {
            let looks = SceneProbe { scene: Arc::clone(scene), seen: Arc::clone(&seen) };
            Some(Journal::kept_by(Path::new("journal"), Box::new(looks)))
        });
        let scene = Arc::clone(&rig.scene);
        let place = || scene.lock().unwrap().arms[0].world_from_tool.translation.vector;
        // The arm sags when the servo begins.
        seconds(0.2).await;
        let before = place();

        let ending = rig.mp.run(&mut Journaled(Shift(SHIFT))).await;

        assert!(ending.finish.unwrap().achieved);
        let after = place();
        let seen = seen.lock().unwrap();
        let off = |tool: &Pose, place: Vector3<f64>| (tool.translation.vector - place).norm();
        // One entry for the motion, one for the end.
        assert_eq!(seen.len(), 2);
        assert!((after - before).norm() > 0.02, "it moves");
        assert!(off(&seen[0], before) < 1e-3, "it had moved by {} m", off(&seen[0], before));
        assert!(off(&seen[1], after) < 1e-3);
    }
}

/// Disk whose writes take a while, and fail at the end if it is full.
#[derive(Debug)]
struct Slow {
    takes: Duration,
    full: bool,
}

impl Durable for Slow {
    fn append(&mut self, _: &[u8]) -> io::Result<()> {
        std::thread::sleep(self.takes);
        if self.full { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
    }
}

/// Task with one phase and no motion.
struct Phase;

impl Kernel for Phase {
    type Thought = ();
    type Entry = Progress;

    fn next(&mut self, event: Event<()>, _: &Readings<'_>) -> Action<()> {
        match event {
            Event::Start => Action::Phase("begins"),
            _ => Action::Finish(Finish { achieved: true, reason: "done".to_owned() }),
        }
    }
}

/// Only the phase that the entry announces waits for a slow disk; the other actors continue. A full
/// disk stops no actor: the operator gets one warning.
#[tokio::test]
async fn slow_or_full_disk_stops_no_other_actor() {
    let takes = Duration::from_secs(1);
    for full in [false, true] {
        let (control, will) = watch::channel(Control::Running);
        let (trace, mut notices) = Trace::bare(RunHash::default());
        let clock = Clock::new(tokio::time::Instant::now(), Arc::new(Switches::default()));
        let mut services = Services::bare(clock, will, trace);
        services.work = Work::at(Pace::RealTime);
        let parts = Parts::bare(vec![], vec![manner()], services);
        let journal = Journal::kept_by(Path::new("/nowhere/j"), Box::new(Slow { takes, full }));
        let mp = Mp::new(Parts { journal: Some(journal), ..parts });
        let longest = Arc::new(Mutex::new(Duration::ZERO));
        let beats = tokio::spawn({
            let longest = Arc::clone(&longest);
            async move {
                let mut last = std::time::Instant::now();
                loop {
                    tokio::time::sleep(Duration::from_millis(10)).await;
                    let now = std::time::Instant::now();
                    let mut longest = longest.lock().unwrap();
                    (*longest, last) = ((*longest).max(now - last), now);
                }
            }
        });
        let begun = std::time::Instant::now();
        let told = tokio::spawn(async move {
            let mut told = Vec::new();
            while let Some(notice) = notices.recv().await {
                told.push((begun.elapsed(), format!("{notice:?}")));
            }
            told
        });

        let ending = mp.run(&mut Journaled(Phase)).await;

        beats.abort();
        drop(control);
        assert!(ending.finish.unwrap().achieved);
        let longest = *longest.lock().unwrap();
        assert!(longest < takes / 2, "no heartbeat for {longest:?}");
        let told = told.await.unwrap();
        let phase = told.iter().find(|(_, text)| text.contains("begins")).unwrap();
        assert!(phase.0 >= takes, "the phase began before its journal entry: {told:?}");
        let warned: Vec<_> = told
            .iter()
            .filter(|(_, text)| text.contains("the journal cannot be written"))
            .collect();
        assert_eq!(warned.len(), usize::from(full), "once: {told:?}");
        for (_, text) in warned {
            for word in ["/nowhere/j: ", "no storage space", "must not be resumed"] {
                assert!(text.contains(word), "{text}");
            }
        }
    }
}
