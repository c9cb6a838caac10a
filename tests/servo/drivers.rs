//! The two drivers of time around the same core, on a port of ideal first-order motors.

use rubik_robot::emergency_stop::EmergencyStop;
use rubik_robot::hw::driver::{
    Clock, Core, NoRecords, RecordSink, ServoLink, ServoRecord, Switches, Time, WallOptions, link,
    run_virtual, spawn_wall, spawn_wall_on,
};
use rubik_robot::hw::port::{Port, PortFault};
use rubik_robot::motion::{
    ArmFault, Direction, Frame, JointPositions, Motion, MoveCommand, MoveRefused,
};
use rubik_robot::servo::io::{ArmDrive, ArmReading};
use rubik_robot::servo::{ArmServo, ServoCommand};
use std::hash::{DefaultHasher, Hasher};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::servo_rig::{Motors, START, config};

/// Sink that hashes all records.
struct Hash(Arc<Mutex<DefaultHasher>>);

impl RecordSink for Hash {
    fn record(&mut self, record: &ServoRecord) {
        record.feed(&mut |bytes| self.0.lock().unwrap().write(bytes));
    }
}

/// Makes the servos of two arms on `port`, with the handles to command them and their switches.
fn core(port: &mut Motors, records: Box<dyn RecordSink>) -> (Core, Vec<ServoLink>, Arc<Switches>) {
    let switches = Arc::new(Switches::default());
    let (core, links) = core_with(Arc::clone(&switches), port, records);
    (core, links, switches)
}

/// Makes the servos of two arms as [`core`] does, with these switches.
fn core_with(
    switches: Arc<Switches>,
    port: &mut Motors,
    records: Box<dyn RecordSink>,
) -> (Core, Vec<ServoLink>) {
    let (links, ends) = (0..2).map(|_| link()).unzip();
    let core = Core::new(vec![config(), config()], ends, switches, records, port).unwrap();
    (core, links)
}

/// Returns the command of a motion that lasts this number of periods.
fn go(motion: Motion, periods: u32) -> ServoCommand {
    ServoCommand::Move { command: MoveCommand { motion, periods, jaw: None }, start: 0 }
}

/// Returns the motion to the start, with joint 1 moved by `angle` (rad).
fn swing(angle: f64) -> Motion {
    let mut goal = START;
    goal.0[1] += angle;
    Motion::Joints(goal)
}

/// Returns a motion of the tool along x of the base at 0.03 m/s.
fn slide() -> Motion {
    let mut directions = [Direction::HOLD; 6];
    directions[0] = Direction::Unguarded { velocity: 0.03 };
    Motion::Task { frame: Frame::Base, directions }
}

/// Runs two servos under virtual time with a stream of macrosteps, as an EDP sends them. Returns a
/// hash of all servo records and the joint positions at the end.
fn virtual_run() -> (u64, JointPositions) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .unwrap();
    let hash = Arc::new(Mutex::new(DefaultHasher::new()));
    let mut port = Motors::new(2);
    let (mut core, mut links, switches) = core(&mut port, Box::new(Hash(Arc::clone(&hash))));
    let joints = runtime.block_on(async {
        let mut edp = links.remove(0);
        let edp = async {
            for _ in 0..20 {
                let ticket = edp.send(go(slide(), 25)).unwrap();
                while !edp.is_done(ticket, ArmServo::EARLY) {
                    tokio::time::sleep(Duration::from_millis(2)).await;
                }
                assert_eq!((edp.state().refused, edp.state().fault), (None, None));
            }
            let ticket = edp.send(go(swing(0.0), 300)).unwrap();
            while !edp.is_done(ticket, 0) {
                tokio::time::sleep(Duration::from_millis(2)).await;
            }
            tokio::time::sleep(Duration::from_millis(300)).await;
            switches.stop.store(true, Ordering::Release);
            edp.state().joints
        };
        let mut last = 0;
        let servo = run_virtual(&mut core, &mut port, u64::MAX, |period, _| {
            assert_eq!(period, last + 1);
            last = period;
        });
        let (joints, periods) = tokio::join!(biased; edp, servo);
        assert!(periods.unwrap() > 20 * 25 + 300);
        joints
    });
    (hash.lock().unwrap().finish(), joints)
}

/// The run reaches its goal, and all its repetitions have the same records.
#[test]
fn virtual_run_repeats_to_the_bit() {
    let (first, joints) = virtual_run();

    for i in 0..7 {
        assert!((joints.0[i] - START.0[i]).abs() < 2e-3, "{i}: {joints:?}");
    }
    assert_ne!(first, DefaultHasher::new().finish(), "there are records");
    for _ in 0..3 {
        assert_eq!(virtual_run().0, first);
    }
}

/// The arms slow down smoothly, and the drives switch off 0.2 s after the stop. A command that
/// arrives in this time is refused.
#[test]
fn servo_refuses_commands_while_it_stops_the_arms() {
    let mut port = Motors::new(2);
    let (mut core, mut links, _) = core(&mut port, Box::new(NoRecords));
    links[0].send(go(swing(0.3), 500)).unwrap();
    for period in 1..=100 {
        core.period(period, &mut port).unwrap();
    }
    core.stop(100, 20);
    for link in &mut links {
        link.send(go(swing(0.3), 400)).unwrap();
    }

    let mut ways = Vec::new();
    for period in 101..=250 {
        let before = links[0].state().desired_joints.0[1];
        core.period(period, &mut port).unwrap();
        ways.push((links[0].state().desired_joints.0[1] - before).abs());
        assert_eq!(port.enabled, [period < 200; 2], "{period}");
        for link in &mut links {
            let state = link.state();
            let fault = (period >= 200).then_some(ArmFault::Missed { periods: 20 });
            assert_eq!(state.fault, fault, "{period}");
            if (103..200).contains(&period) {
                let told = state.refused;
                assert_eq!(told, Some(MoveRefused::Stopping { periods: 20 }), "{period}");
            }
        }
    }
    // The speed falls to 0.92 of itself in each period. The arm is at rest before the drives are
    // off.
    let full = 0.3 / 500.0;
    assert!(ways[1] > 0.8 * full && ways[10] < 0.6 * full, "{:?}", &ways[..20]);
    assert!(ways[60..].iter().all(|way| *way < 1e-5), "{:?}", &ways[60..]);
    let moved = links[1].state().desired_joints.0[1] - START.0[1];
    assert!(moved.abs() < 1e-4, "an arm at rest begins no motion: {moved}");
}

/// The drives switch off in the next period. An arm moves again after the button is released and
/// the arm itself is reset.
#[test]
fn emergency_stop_switches_drives_off_until_arm_reset() {
    let mut port = Motors::new(2);
    let stop = EmergencyStop::default();
    let switches = Arc::new(Switches::new(stop.signal()));
    let (mut core, mut links) = core_with(switches, &mut port, Box::new(NoRecords));
    links[0].send(go(swing(0.3), 500)).unwrap();
    for period in 1..=100 {
        core.period(period, &mut port).unwrap();
    }
    assert!(port.enabled[0] && port.enabled[1]);

    stop.button().press();
    core.period(101, &mut port).unwrap();

    assert_eq!(port.enabled, [false, false]);
    links[0].send(ServoCommand::Reset).unwrap();
    core.period(102, &mut port).unwrap();
    assert_eq!(port.enabled, [false, false], "the button is still pressed");
    assert_eq!(links[0].state().fault, Some(ArmFault::EmergencyStop));

    stop.release();
    links[0].send(ServoCommand::Reset).unwrap();
    for period in 103..=110 {
        core.period(period, &mut port).unwrap();
    }
    assert_eq!(port.enabled, [true, false]);
    assert_eq!(links[0].state().fault, None);
}

#[test]
fn arms_hold_when_heartbeat_stops() {
    let mut port = Motors::new(2);
    let (mut core, mut links, switches) = core(&mut port, Box::new(NoRecords));
    links[0].send(go(swing(0.3), 1000)).unwrap();
    let mut set = Vec::new();

    for period in 1..=400 {
        if period <= 200 {
            switches.beats.fetch_add(1, Ordering::Relaxed);
        }
        core.period(period, &mut port).unwrap();
        set.push(links[0].state().desired_joints.0[1]);
    }

    // The set value after period p is `set[p - 1]`, and the last heartbeat is in period 200.
    let step = |period: usize| set[period - 1] - set[period - 2];
    let full = 0.3 / 1000.0;
    assert!((step(240) - full).abs() < 1e-6, "80 ms of silence are tolerated: {}", step(240));
    assert!(step(242) < 0.95 * full, "the arm brakes after 80 ms: {}", step(242));
    assert!(step(242) > 0.8 * full, "an arm is not stopped dead: {}", step(242));
    assert_eq!(set[390], set[399]);
    assert_eq!(links[0].state().fault, None);
    let ticket = links[0].send(go(swing(0.3), 1000)).unwrap();
    switches.beats.fetch_add(1, Ordering::Relaxed);
    core.period(401, &mut port).unwrap();
    core.period(402, &mut port).unwrap();
    assert!(!links[0].is_done(ticket, 0), "the motion continues when the actors return");
}

#[test]
fn one_second_without_heartbeat_switches_drives_off() {
    let mut port = Motors::new(2);
    let (mut core, mut links, switches) = core(&mut port, Box::new(NoRecords));
    // The last heartbeat is in period 200, and a second is 500 periods.
    let mut cut = None;

    for period in 1..=900 {
        if period <= 200 {
            switches.beats.fetch_add(1, Ordering::Relaxed);
        }
        core.period(period, &mut port).unwrap();
        if period > 1 && !(port.enabled[0] || port.enabled[1]) {
            cut.get_or_insert(period);
        }
    }

    assert!(cut.is_some_and(|cut| (700..=702).contains(&cut)), "{cut:?}");
    for link in &mut links {
        assert!(matches!(link.state().fault, Some(ArmFault::Heartbeat { .. })));
    }
}

#[test]
fn port_failure_ends_virtual_run_with_reason() {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .unwrap();
    let mut port = Motors::new(2);
    port.fails_at = Some(30);
    let (mut core, _links, _) = core(&mut port, Box::new(NoRecords));

    let end = runtime.block_on(run_virtual(&mut core, &mut port, u64::MAX, |_, _| {}));

    assert_eq!(end, Err(PortFault { effector: 1, reason: "cable".into() }));
    assert_eq!(port.last_period, 29);
}

#[test]
fn wall_clock_driver_moves_arm_and_counts_periods() {
    let mut port = Motors::new(2);
    let (core, mut links, _) = core(&mut port, Box::new(NoRecords));
    let options = WallOptions { spin: 0, ..WallOptions::default() };
    let wall = spawn_wall(core, port, |_, _| {}, options).unwrap();
    // Other tests may keep the processor busy and pause the servo until it aborts a motion, so the
    // motion is tried again. The driver need not count a period as missed for that.
    let mut reached = false;
    for _ in 0..20 {
        let ticket = links[1].send(go(swing(0.05), 100)).unwrap();
        while !links[1].is_done(ticket, 0) && !wall.has_ended() {
            std::thread::sleep(Duration::from_millis(10));
        }
        reached = (links[1].state().desired_joints.0[1] - START.0[1] - 0.05).abs() < 1e-12;
        if reached {
            break;
        }
    }
    let end = wall.stop();

    assert!(reached, "{:?}", links[1].state());
    assert_eq!(end.fault, None);
    let periods = end.timing.wake_up.len();
    assert!(periods >= 100);
    // The bridge takes the newest order, and its last exchange switches the drives off.
    let port = end.port.unwrap();
    assert!(port.last_period.abs_diff(periods) <= 1, "{} of {periods}", port.last_period);
    assert_eq!(port.enabled, [false, false]);
    assert!(links[1].is_closed());
}

#[test]
fn port_failure_stops_wall_clock_driver_with_reason() {
    let mut port = Motors::new(2);
    port.fails_at = Some(20);
    let (core, mut links, _) = core(&mut port, Box::new(NoRecords));
    let options = WallOptions { spin: 0, ..WallOptions::default() };
    let wall = spawn_wall(core, port, |_, _| {}, options).unwrap();

    for _ in 0..600 {
        if wall.has_ended() {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
    }

    assert!(wall.has_ended());
    for link in &mut links {
        let fault = link.state().fault;
        assert!(matches!(fault, Some(ArmFault::BridgeSilent { .. })), "{fault:?}");
    }
    assert_eq!(wall.stop().fault, Some(PortFault { effector: 1, reason: "cable".into() }));
}

#[test]
fn servo_uses_port_reading_of_the_previous_period() {
    // The port answers with the number of its period. In period k + 1 the servo uses the reading
    // from the end of period k.
    struct Echo;
    impl Port for Echo {
        fn exchange(
            &mut self,
            period: u64,
            _: &[ArmDrive],
            readings: &mut [ArmReading],
        ) -> Result<(), PortFault> {
            readings[0] =
                ArmReading { jaw_count: period as i64, ..crate::servo_rig::first_reading() };
            Ok(())
        }
    }
    struct Check(Arc<AtomicU64>);
    impl RecordSink for Check {
        fn record(&mut self, record: &ServoRecord) {
            assert_eq!(record.reading.jaw_count + 1, record.period as i64);
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }
    let (_link, end) = link();
    let switches = Arc::new(Switches::default());
    let records = Arc::new(AtomicU64::new(0));
    let check = Box::new(Check(Arc::clone(&records)));
    let mut core = Core::new(vec![config()], vec![end], switches, check, &mut Echo).unwrap();

    for period in 1..=100 {
        core.period(period, &mut Echo).unwrap();
    }
    assert_eq!(records.load(Ordering::Relaxed), 100);
}

/// The bridge thread panics in the hook after an exchange, the servo thread in its sink.
#[test]
fn driver_names_the_thread_that_panicked() {
    struct Mad;
    impl RecordSink for Mad {
        fn record(&mut self, _: &ServoRecord) {
            panic!("full");
        }
    }
    let options = WallOptions { spin: 0, ..WallOptions::default() };
    let ended = |sink: Box<dyn RecordSink>, most: u64| {
        let mut port = Motors::new(2);
        let (core, _links, _) = core(&mut port, sink);
        let hook = move |period: u64, _: &mut Motors| assert!(period < most, "on purpose");
        let wall = spawn_wall(core, port, hook, options).unwrap();
        for _ in 0..600 {
            if wall.has_ended() {
                break;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        wall.stop()
    };

    let bridge = ended(Box::new(NoRecords), 10);
    assert_eq!(bridge.panic, Some(("the bridge's thread", "on purpose".to_owned())));
    assert!(bridge.port.is_none());
    let servo = ended(Box::new(Mad), u64::MAX);
    assert_eq!(servo.panic, Some(("the servo's thread", "full".to_owned())));
    assert!(servo.port.is_some());
}

/// Clocks of a computer that is suspended for an hour after a time.
struct Suspended {
    /// Time from which on the suspend lies behind (ns).
    from: u64,
    /// Length of the suspend (ns).
    hour: u64,
}

impl Time for Suspended {
    fn now(&self) -> u64 {
        Clock.now()
    }

    fn boot_time(&self) -> u64 {
        let now = Clock.now();
        if now < self.from { now } else { now + self.hour }
    }

    fn wait_until(&self, nanos: u64, spin: u64) {
        Clock.wait_until(nanos, spin);
    }
}

/// The monotonic clock stands still in a suspend, so no grid point passes.
#[test]
fn suspend_of_the_computer_stops_the_arms() {
    let mut port = Motors::new(2);
    let (core, mut links, _) = core(&mut port, Box::new(NoRecords));
    // Without a limit that other load of this machine could reach.
    let limit = 1_000_000;
    let options = WallOptions { spin: 0, missed_limit: limit, ..WallOptions::default() };
    let clock = Suspended { from: Clock.now() + 100_000_000, hour: 3_600_000_000_000 };
    let wall = spawn_wall_on(clock, core, port, |_, _| {}, options).unwrap();

    let mut fault = None;
    for _ in 0..600 {
        fault = links[0].state().fault;
        if fault.is_some() {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
    }

    // An hour is 1 800 000 periods.
    let Some(ArmFault::Missed { periods }) = fault else { panic!("{fault:?}") };
    assert!((1_799_000..1_900_000).contains(&periods), "{periods}");
    assert!(wall.stop().timing.missed >= periods);
}
