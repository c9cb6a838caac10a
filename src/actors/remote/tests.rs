//! Tests of both ends of a link, within one process and on the virtual clock.

use super::*;
use crate::actors::clock::Clock;
use crate::actors::control::Control;
use crate::actors::ecp::{self, EcpHandle};
use crate::actors::edp::{self, EdpHandle};
use crate::actors::manner::manner;
use crate::actors::notice::Notice;
use crate::actors::services::Services;
use crate::actors::trace::Trace;
use crate::actors::watchdog::{Watchdog, raised};
use crate::actors::way::BEAT;
use crate::emergency_stop::EmergencyStop;
use crate::error::{Error, NonFatal, System};
use crate::generators::{Behaviour, Outcome};
use crate::hw::driver::{self, Switches};
use crate::motion::{ArmState, MoveRefused, Synchronisation};
use crate::net::{Link, Parcels, pair};
use crate::operator::parameter::{AllBounds, Courses};
use crate::record::recorder::Recorder;
use crate::record::run_hash::RunHash;
use crate::servo::ServoCommand;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

/// Effector of the node.
const POSTUMENT: usize = 1;
/// Number of the run.
const RUN: u64 = 9;
/// Longest time of a beat on its way.
const WAY: Duration = Duration::from_millis(10);

/// Node with an arm whose servo carries out commands at once, and MP's end of the link to it.
struct Rig {
    ecp: EcpHandle,
    edp: EdpHandle,
    /// Clock and watchdog of MP's node.
    clock: Clock,
    watchdog: Watchdog,
    control: watch::Sender<Control>,
    stop: EmergencyStop,
    switches: Arc<Switches>,
    /// The node; its switches, watchdog and stop, and the control that its actors see.
    node: JoinHandle<Left>,
    there: Arc<Switches>,
    there_watchdog: Watchdog,
    there_stop: EmergencyStop,
    there_control: watch::Receiver<Control>,
    home: Home,
    /// Period in which the servo took the last command, by the clock of the node.
    taken: watch::Receiver<u64>,
    /// Sending end of the node, and the notices of MP's node.
    there_sender: Sender<ToHome>,
    notices: mpsc::Receiver<Notice>,
}

/// Waits for what must happen within 30 s of the virtual clock. Without a limit a broken link would
/// hang its test.
async fn soon<T>(awaited: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(30), awaited).await.expect("it happens within 30 s")
}

/// Makes services with a clock that begins now, and the receiver of their notices.
fn services(
    switches: &Arc<Switches>,
    control: watch::Receiver<Control>,
) -> (Services, mpsc::Receiver<Notice>) {
    let clock = Clock::new(tokio::time::Instant::now(), Arc::clone(switches));
    let (trace, notices) = Trace::bare(RunHash::default());
    (Services::bare(clock, control, trace), notices)
}

/// Starts the servo of the node's arm, which publishes a state in each period.
fn servo(clock: &Clock) -> (crate::hw::driver::ServoLink, watch::Receiver<u64>) {
    let (link, mut end) = driver::link();
    let (takes, taken) = watch::channel(0);
    let clock = clock.clone();
    tokio::spawn(async move {
        let mut at = 0;
        for period in 1.. {
            if let Some(ServoCommand::Move { start, .. }) = end.take() {
                takes.send_replace(period);
                at = start;
            }
            let refused = (at > period + 1000).then_some(MoveRefused::Aborted);
            let synchronisation = Synchronisation::Yes;
            end.publish(&ArmState { period, refused, synchronisation, ..ArmState::default() });
            clock.until(period).await;
        }
    });
    (link, taken)
}

/// Starts the node's end over a link.
fn host(
    (link, parcels): (Arc<dyn Link>, Parcels),
) -> (
    JoinHandle<Left>,
    Arc<Switches>,
    EmergencyStop,
    Watchdog,
    watch::Receiver<Control>,
    watch::Receiver<u64>,
) {
    let stop = EmergencyStop::default();
    let switches = Arc::new(Switches::new(stop.signal()));
    let (told, control) = watch::channel(Control::Waiting);
    let (ordered, _) = watch::channel(Courses::new(&AllBounds::default()));
    let (services, _) = services(&switches, control.clone());
    let (link_to_servo, taken) = servo(&services.clock);
    let config = super::example_config();
    let edp = edp::spawn("postument", link_to_servo, &services);
    let parts = ecp::Parts {
        edp: edp.clone(),
        tracker: None,
        hand_camera: None,
        lag: 0,
        sensors: Vec::new(),
        manner: manner(&config, POSTUMENT),
        programmes: config.programmes.clone(),
        surroundings: None,
        services: services.clone(),
    };
    let watchdog = services.supervision.watchdog.clone();
    let host = Host {
        run: RUN,
        arms: vec![(POSTUMENT, true)],
        sender: Sender::new(link, RUN),
        edps: [(POSTUMENT, edp)].into(),
        ecps: [(POSTUMENT, ecp::spawn("postument", parts))].into(),
        vsps: [].into(),
        states: [(0, watch::channel(ArmState::default()).0)].into(),
        control: told,
        courses: ordered,
        offset: Offset::default(),
        recorder: Recorder::default(),
        watched: Arc::default(),
        clock: services.clock.clone(),
        switches: Arc::clone(&switches),
        stop_button: stop.button(),
        watchdog: watchdog.clone(),
        way: WAY,
    };
    let node = tokio::spawn(host.serve(Receiver::new(parcels).of_run(RUN)));
    (node, switches, stop, watchdog, control, taken)
}

/// Starts MP's end, and a second later the node, so that their periods differ by 500.
async fn rig() -> Rig {
    rig_over(pair()).await
}

/// Makes a rig over both ends of a link.
async fn rig_over([near, far]: [(Arc<dyn Link>, Parcels); 2]) -> Rig {
    let (control, orders) = watch::channel(Control::Running);
    let stop = EmergencyStop::default();
    let switches = Arc::new(Switches::new(stop.signal()));
    let (services, notices) = services(&switches, orders);
    tokio::time::sleep(Duration::from_secs(1)).await;
    let there_sender = Sender::new(Arc::clone(&far.0), RUN);
    let (node, there, there_stop, there_watchdog, there_control, taken) = host(far);
    let home = Home::new("b", Sender::new(near.0, RUN), 2 * WAY, WAY);
    let mut receiver = Receiver::new(near.1).of_run(RUN);
    let introduction = Introduction { run: RUN, program: "p".into(), scenario: 3 };
    let joined = home.join(&mut receiver, &introduction, Duration::from_secs(1)).await;
    assert_eq!(joined, Ok(vec![(POSTUMENT, true)]));
    let patience = services.supervision.patience;
    let edp = home.edp(POSTUMENT, "postument", patience, &services.clock);
    let ecp = home.ecp(POSTUMENT, "postument", patience, (services.clock.clone(), 20));
    let (clock, watchdog) = (services.clock.clone(), services.supervision.watchdog.clone());
    home.keep_alive();
    // Other nodes join meanwhile.
    tokio::time::sleep(2 * GONE).await;
    let watch = Watch {
        services,
        switches: Arc::clone(&switches),
        stop_button: stop.button(),
        states: vec![],
        stopped: Arc::default(),
        cameras: [].into(),
    };
    soon(home.start(receiver, watch)).await.unwrap();
    tokio::time::sleep(Duration::from_millis(200)).await;
    Rig {
        ecp,
        edp,
        clock,
        watchdog,
        control,
        stop,
        switches,
        node,
        there,
        there_watchdog,
        there_stop,
        there_control,
        home,
        taken,
        there_sender,
        notices,
    }
}

#[tokio::test(start_paused = true)]
async fn requests_cross_and_periods_are_those_of_home() {
    let Rig { ecp, edp, clock, taken, .. } = rig().await;

    for state in [ecp.state().await.unwrap(), edp.state().await.unwrap()] {
        assert!(clock.period().abs_diff(state.period) <= 2, "{}: {}", clock.period(), state.period);
    }
    assert!(clock.period().abs_diff(edp.watch().borrow().period) <= 2);
    // The motion begins 20 periods after its order; the node is 500 periods behind.
    let ordered = clock.period();
    let target = ArmState::default().joints;
    let behaviour = Behaviour::Joints { target, speed: 1.0, seconds: 0.1 };
    let (outcome, state) = soon(ecp.behave(behaviour)).await.unwrap();
    assert!(matches!(outcome, Outcome::Reached | Outcome::Ended), "{outcome:?}");
    assert!(state.period > ordered);
    assert!(*taken.borrow() + 500 >= ordered, "{} for {ordered}", *taken.borrow());
}

#[tokio::test(start_paused = true)]
async fn request_to_wrong_actor_gets_its_error() {
    let Rig { ecp, .. } = rig().await;
    let view =
        crate::kernel::View { camera_from_face: crate::spatial::Pose::identity(), exposure: 1.0 };

    let error = ecp.look(view).await.unwrap_err();

    let expected = NonFatal::NoReading("no camera in this hand belongs to this ECP".into());
    assert!(matches!(error, Error::NonFatal { cause, .. } if cause == expected));
}

/// A node that dies is noticed after the silence, and a beat of the check.
#[tokio::test(start_paused = true)]
async fn dead_node_is_a_system_error_in_time() {
    let Rig { node, watchdog, ecp, .. } = rig().await;
    let died = tokio::time::Instant::now();
    node.abort();

    let error = soon(watchdog.raised()).await;

    assert!(error.to_string().contains("node b"), "{error}");
    assert!(matches!(error, Error::System { cause: System::Silent { .. }, .. }));
    let limit = SILENT + WAY + 3 * BEAT;
    assert!(died.elapsed() <= limit, "{:?}", died.elapsed());
    // A request to the dead node ends by the patience of its sender.
    assert!(ecp.state().await.is_err());
}

/// Without MP's node the servo gets no heartbeat at once, and the node ends 2 s later.
#[tokio::test(start_paused = true)]
async fn node_without_home_stops_its_heartbeat() {
    let Rig { node, there, home, watchdog, .. } = rig().await;
    let beats = there.beats.load(Ordering::Relaxed);
    tokio::time::sleep(Duration::from_millis(100)).await;
    assert!(there.beats.load(Ordering::Relaxed) >= beats + 4);
    // The link dies with all that sends over it.
    home.silence();
    tokio::time::sleep(2 * BEAT).await;
    let beats = there.beats.load(Ordering::Relaxed);
    let left = soon(node).await.unwrap();

    assert_eq!(there.beats.load(Ordering::Relaxed), beats);
    assert_eq!(left, Left::Alone("no beat of MP's node in 2 s".into()));
    drop(watchdog);
}

#[tokio::test(start_paused = true)]
async fn stop_control_and_hold_cross_within_beats() {
    let Rig { control, stop, there, there_stop, mut there_control, switches, .. } = rig().await;
    assert_eq!(*there_control.borrow_and_update(), Control::Running);

    control.send_replace(Control::Paused);
    stop.button().press();
    tokio::time::sleep(2 * BEAT).await;

    assert_eq!(*there_control.borrow_and_update(), Control::Paused);
    assert!(there_stop.signal().is_pressed());
    assert!(!there.hold.load(Ordering::Acquire));
    for holds in [true, false] {
        switches.hold.store(holds, Ordering::Release);
        tokio::time::sleep(2 * BEAT).await;
        assert_eq!(there.stands_by.load(Ordering::Acquire), holds);
    }
}

/// While an arm of the node is stopped by a fault, the arms of MP's node stand by.
#[tokio::test(start_paused = true)]
async fn stopped_arm_of_node_holds_the_others() {
    let Rig { there, switches, .. } = rig().await;
    assert!(!switches.stands_by.load(Ordering::Acquire));

    // A reset ends the fault.
    for stopped in [true, false] {
        there.stop_for_test(stopped);
        tokio::time::sleep(2 * BEAT).await;
        assert_eq!(switches.stands_by.load(Ordering::Acquire), stopped);
    }
}

/// The operator at MP's node is told what an actor of the node reports, and of a wrong picture.
#[tokio::test(start_paused = true)]
async fn notices_of_node_reach_the_operator() {
    let Rig { mut notices, there_sender, clock, watchdog, home, .. } = rig().await;
    let carried = home.traffic().received;
    // Numbers of the node's own messages would follow: this is the first one.
    let (class, who) = (crate::operator::Class::Warning, "vsp gs1".to_owned());
    there_sender.send(&ToHome::Notice { class, who, text: "dark".into() });
    let file = super::message::JpegFile(vec![1, 2, 3]);
    let found = crate::actors::latest::Found::Nothing(String::new());
    let shown = super::message::Shown { camera: 4, period: 1, found, file };
    there_sender.send(&ToHome::Picture(shown));

    let told = [soon(notices.recv()).await, soon(notices.recv()).await].map(Option::unwrap);

    let [Notice::Elsewhere(at, _, who, text), Notice::Elsewhere(.., why)] = &told else {
        panic!("{told:?}")
    };
    assert_eq!((who.as_str(), text.as_str()), ("vsp gs1 on node b", "dark"));
    assert!((at / crate::motion::PERIOD - clock.period() as f64).abs() <= 2.0, "{at}");
    assert_eq!(why, "a picture was refused: camera 4 is not on this node");
    assert!(watchdog.listen().borrow().is_none());
    assert!(home.traffic().received > carried + 20);
}

#[tokio::test(start_paused = true)]
async fn stop_pressed_at_node_stops_home() {
    let Rig { stop, there_stop, .. } = rig().await;

    there_stop.button().press();
    tokio::time::sleep(2 * BEAT).await;

    assert!(stop.signal().is_pressed());
}

/// Link on which each parcel takes a time that can change.
#[derive(Debug)]
struct Slow(Arc<dyn Link>, watch::Receiver<Duration>);

impl Link for Slow {
    fn traffic(&self) -> crate::net::Traffic {
        self.0.traffic()
    }

    fn send(&self, lane: crate::net::Lane, parcel: Vec<u8>) {
        let (link, way) = (Arc::clone(&self.0), *self.1.borrow());
        tokio::spawn(async move {
            tokio::time::sleep(way).await;
            link.send(lane, parcel);
        });
    }
}

/// Each beat is longer on its way than the one before, so that beats arrive without a gap, but in
/// the end half a second late: neither end takes them for signs of life. MP's node sees that long
/// before the other node ends.
#[tokio::test(start_paused = true)]
async fn late_link_stops_both_ends() {
    let (grows, way) = watch::channel(Duration::from_millis(2));
    let ends = pair().map(|(link, parcels)| {
        let slow: Arc<dyn Link> = Arc::new(Slow(link, way.clone()));
        (slow, parcels)
    });
    let Rig { watchdog, there, node, .. } = rig_over(ends).await;
    assert!(watchdog.listen().borrow().is_none());

    let begun = tokio::time::Instant::now();
    tokio::spawn(async move {
        for step in 1..=50 {
            grows.send_replace(Duration::from_millis(2 + 10 * step));
            tokio::time::sleep(BEAT).await;
        }
        // The link goes on as it is.
        std::future::pending::<()>().await;
    });
    let error = soon(watchdog.raised()).await;
    assert!(begun.elapsed() < GONE / 2, "{:?}", begun.elapsed());
    tokio::time::sleep(Duration::from_millis(1200)).await;
    let beats = there.beats.load(Ordering::Relaxed);

    assert!(error.to_string().contains("node b"), "{error}");
    assert_eq!(soon(node).await.unwrap(), Left::Alone("no beat of MP's node in 2 s".into()));
    assert_eq!(there.beats.load(Ordering::Relaxed), beats);
}

#[tokio::test(start_paused = true)]
async fn error_of_node_ends_the_run() {
    let Rig { there_watchdog, watchdog, node, home, .. } = rig().await;
    let cause = System::Panicked { who: "ecp postument".into(), why: "test".into() };
    let error = Error::System { actor: "supervisor".into(), place: "supervise".into(), cause };

    there_watchdog.raise(error.clone());

    let mut listens = watchdog.listen();
    assert_eq!(soon(raised(&mut listens)).await, error);
    home.dismiss();
    assert_eq!(soon(node).await.unwrap(), Left::Failed(error));
}

#[tokio::test(start_paused = true)]
async fn second_run_is_refused_by_busy_node() {
    let [near, far] = pair();
    let (node, ..) = host(far);
    let home = Home::new("b", Sender::new(near.0, 4), 2 * WAY, WAY);
    let mut receiver = Receiver::new(near.1).of_run(4);
    let mut introduction = Introduction { run: 4, program: "p".into(), scenario: 3 };

    let refused = home.join(&mut receiver, &introduction, Duration::from_secs(1)).await;
    introduction.run = RUN;
    let joined = home.join(&mut receiver, &introduction, Duration::from_secs(1)).await;

    assert_eq!(refused, Err("it takes part in another run".into()));
    assert_eq!(joined, Ok(vec![(POSTUMENT, true)]));
    node.abort();
}

#[tokio::test(start_paused = true)]
async fn absent_node_is_refused_after_the_limit() {
    let [near, _far] = pair();
    let home = Home::new("b", Sender::new(near.0, RUN), Duration::ZERO, Duration::ZERO);
    let introduction = Introduction { run: RUN, program: "p".into(), scenario: 3 };

    let (begun, limit) = (tokio::time::Instant::now(), Duration::from_secs(5));
    let absent = home.join(&mut Receiver::new(near.1), &introduction, limit).await;

    assert_eq!(absent, Err("no answer in 5 s".into()));
    assert_eq!(begun.elapsed(), limit);
}
