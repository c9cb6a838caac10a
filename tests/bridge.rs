//! Tests of the bridge over pseudo-terminals as serial lines, with motors behind the emulator.
//!
//! Other processes share the processor with these tests. An axis may therefore miss 40 answers in a
//! row, except in the tests of missed answers.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

mod servo_rig;

use rubik_robot::arms::builtin;
use rubik_robot::cell::Arm;
use rubik_robot::hw::devices::Devices;
use rubik_robot::hw::driver::{self, Core, NoRecords, Switches, WallOptions};
use rubik_robot::hw::emulator::{
    At, Course, EmulatedArm, Emulator, EmulatorOptions, LineFaults, SensorKind,
};
use rubik_robot::hw::note::{Note, NoteKind, Notes, notes};
use rubik_robot::hw::port::{Port, PortFault};
use rubik_robot::hw::serial::SerialPort;
use rubik_robot::hw::serial::axis::Rules;
use rubik_robot::motion::{AXES, Depth, JointPositions, Motion, MoveCommand};
use rubik_robot::servo::ServoCommand;
use rubik_robot::servo::io::{ArmDrive, ArmReading};
use rubik_robot::spatial::{Pose, Wrench};
use servo_rig::{Motors, START, config};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Last drives of the world behind the lines, and a push on its force sensors.
#[derive(Default)]
struct Seen {
    drives: Vec<ArmDrive>,
    /// Force along z of each sensor (N).
    push: f64,
}

/// Motors whose drives a test can read, and whose sensors it can push.
struct World {
    motors: Motors,
    seen: Arc<Mutex<Seen>>,
}

impl Port for World {
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        self.motors.exchange(period, drives, readings)?;
        let mut seen = self.seen.lock().unwrap();
        seen.drives = drives.to_vec();
        for (arm, reading) in readings.iter_mut().enumerate() {
            reading.jaw_count = 100 + arm as i64;
            reading.wrench_on_sensor =
                Wrench::from_directions([0.0, 0.0, seen.push, 0.0, 0.0, 0.0]);
        }
        Ok(())
    }
}

/// A running emulator.
struct Rig {
    devices: Devices,
    seen: Arc<Mutex<Seen>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Course>>,
}

impl Rig {
    /// Starts an emulator of this number of arms.
    fn start(arms: usize, options: EmulatorOptions) -> Self {
        Self::late(arms, options, Some(Duration::ZERO))
    }

    /// Starts an emulator that answers on its lines only after the time `by`; `None` means never.
    fn late(arms: usize, options: EmulatorOptions, by: Option<Duration>) -> Self {
        let seen = Arc::new(Mutex::new(Seen::default()));
        let world = World { motors: Motors::new(arms), seen: Arc::clone(&seen) };
        let emulated: Vec<_> = NAMES[..arms]
            .iter()
            .map(|name| EmulatedArm { name: (*name).to_owned(), has_track: *name == "track" })
            .collect();
        let mut emulator = Emulator::open(world, &emulated, options).unwrap();
        let devices = emulator.devices();
        let stop = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let Some(by) = by else {
                while !ends.load(Ordering::Acquire) {
                    std::thread::sleep(Duration::from_millis(5));
                }
                return Course::default();
            };
            std::thread::sleep(by);
            let _rights = driver::RealTime::acquire(70, None);
            emulator.run(&ends, |_, _| {}).unwrap()
        });
        Self { devices, seen, stop, thread: Some(thread) }
    }

    /// Opens the bridge to the emulator. An axis may miss `misses` answers in a row.
    fn bridge(&self, misses: u32, notes: Notes) -> SerialPort {
        let rules = Rules { misses, ..Rules::default() };
        self.devices.serial(&arms(self.devices.effector.len()), rules, notes).unwrap()
    }

    /// Ends the emulator, and returns its account of the run.
    fn kill(&mut self) -> Course {
        self.stop.store(true, Ordering::Release);
        self.thread.take().unwrap().join().unwrap()
    }
}

/// Names of the arms.
const NAMES: [&str; 2] = ["track", "postument"];

/// Returns the first `count` arms, with the gripper and the sensor of the servo's tests.
fn arms(count: usize) -> Vec<Arm> {
    let config = config();
    let arm = |name: &&str| Arm {
        name: (*name).to_owned(),
        model: builtin(if *name == "track" { "irp6_track" } else { "irp6_postument" }).unwrap(),
        world_from_base: Pose::identity(),
        flange_from_tool: config.flange_from_tool,
        gripper: config.gripper,
        sensor: config.sensor,
        start: START,
    };
    NAMES[..count].iter().map(arm).collect()
}

/// Returns drives that are on: this pulse width for each axis, its opposite for the jaw.
fn on(pwm: i16) -> ArmDrive {
    ArmDrive { enabled: true, pwm: [pwm; AXES], jaw_pwm: -pwm, stops: Depth::Two, ..ArmDrive::OFF }
}

/// Exchanges drives and readings with the bridge every 2 ms, from the period `from` on. Returns the
/// period in which `until` accepts the readings, or the period and the fault if the bridge fails.
fn exchange(
    port: &mut SerialPort,
    drives: &[ArmDrive],
    from: u64,
    mut until: impl FnMut(u64, &[ArmReading]) -> bool,
) -> Result<u64, (u64, PortFault)> {
    let mut readings = vec![ArmReading::default(); drives.len()];
    let begun = Instant::now();
    for period in from.. {
        if let Err(fault) = port.exchange(period, drives, &mut readings) {
            return Err((period, fault));
        }
        if until(period, &readings) {
            return Ok(period);
        }
        assert!(begun.elapsed() < Duration::from_secs(20), "nothing happened: {readings:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
    unreachable!()
}

/// A robot that answers late must not look like one whose counters are at zero. A robot that never
/// answers causes a fault that names its lines.
#[test]
fn bridge_waits_for_first_answer_of_robot() {
    let first = |rig: &Rig| {
        let mut port = rig.bridge(3, Notes::none());
        let mut readings = [ArmReading::default(); 2];
        let begun = Instant::now();
        let done = port.exchange(0, &[ArmDrive::OFF; 2], &mut readings);
        (done, readings, begun.elapsed())
    };

    let mut rig = Rig::late(2, EmulatorOptions::default(), Some(Duration::from_millis(80)));
    let (done, readings, took) = first(&rig);
    done.unwrap();
    assert!(took > Duration::from_millis(60), "{took:?}");
    let count = config().model.motors(&START).0[3] * 4000.0 / std::f64::consts::TAU;
    for reading in readings {
        assert!((reading.counts[3] as f64 - count).abs() < 2.0, "{reading:?}");
        assert_eq!(reading.synchronised, u8::MAX);
    }
    rig.kill();

    let mut rig = Rig::late(2, EmulatorOptions::default(), None);
    let (done, ..) = first(&rig);
    let reason = done.unwrap_err().reason;
    for wanted in ["track, axis 0", "postument, jaw", "/dev/pts/", "has not answered for 1 s"] {
        assert!(reason.contains(wanted), "{reason}");
    }
    rig.kill();
}

#[test]
#[ignore = "real time over pseudo-terminals: run by name on a machine with time to spare"]
fn lines_carry_drives_and_readings_of_all_axes() {
    let rig = Rig::start(2, EmulatorOptions::default());
    rig.seen.lock().unwrap().push = -7.5;
    let mut port = rig.bridge(40, Notes::none());
    let first = config().model.motors(&START).0[3];

    // The drives are off at first; then both arms move.
    let mut start = [0; 2];
    exchange(&mut port, &[ArmDrive::OFF; 2], 0, |period, readings| {
        start = [readings[0].counts[3], readings[1].counts[3]];
        period > 10
    })
    .unwrap();
    assert!((start[0] as f64 - first * 4000.0 / std::f64::consts::TAU).abs() < 2.0, "{start:?}");
    exchange(&mut port, &[on(100), on(-50)], 11, |_, readings| {
        let [a, b] = [readings[0].counts[3] - start[0], readings[1].counts[3] - start[1]];
        let wrench = |arm: usize| readings[arm].wrench_on_sensor.force.z;
        a > 500 && b < -250 && wrench(0) == -7.5 && wrench(1) == -7.5
    })
    .unwrap();

    let seen = rig.seen.lock().unwrap();
    assert_eq!(seen.drives[0].pwm, [100; AXES]);
    assert_eq!(seen.drives[1].pwm[1..], [-50; AXES - 1], "the postument has no track");
    assert_eq!(seen.drives[1].jaw_pwm, 50);
    for drive in &seen.drives {
        assert!(drive.enabled && drive.stops == Depth::Two);
    }
}

#[test]
#[ignore = "real time over pseudo-terminals: run by name on a machine with time to spare"]
fn move_over_serial_lines_reaches_its_goal() {
    let rig = Rig::start(
        1,
        EmulatorOptions { sensors: SensorKind::Controller, ..EmulatorOptions::default() },
    );
    let mut port = rig.bridge(40, Notes::none());
    let (mut link, end) = driver::link();
    let switches = Arc::new(Switches::default());
    let core =
        Core::new(vec![config()], vec![end], switches, Box::new(NoRecords), &mut port).unwrap();
    let wall = driver::spawn_wall(core, port, |_, _| {}, WallOptions::default()).unwrap();
    let mut goal = START.0;
    // The motion is slow, so that a world which pauses for some periods does not look like a frozen
    // encoder.
    goal[1] += 0.05;
    goal[6] -= 0.03;
    let motion = Motion::Joints(JointPositions(goal));
    let start = Instant::now();
    while link.state().period == 0 {
        std::thread::sleep(Duration::from_millis(1));
    }

    let ticket = link
        .send(ServoCommand::Move {
            command: MoveCommand { motion, periods: 500, jaw: None },
            start: 0,
        })
        .unwrap();
    while !link.is_done(ticket, 0) {
        assert!(start.elapsed() < Duration::from_secs(20), "{:?}", link.state());
        std::thread::sleep(Duration::from_millis(5));
    }
    std::thread::sleep(Duration::from_millis(300));

    let state = *link.state();
    assert_eq!((state.fault, state.refused), (None, None));
    let off = state.joints.0.iter().zip(goal).map(|(is, wanted)| (is - wanted).abs());
    assert!(off.fold(0.0, f64::max) < 2e-3, "{:?} instead of {goal:?}", state.joints);
    assert!(wall.stop().fault.is_none());
    // The bridge puts the controllers into manual mode when it ends.
    std::thread::sleep(Duration::from_millis(50));
    assert!(!rig.seen.lock().unwrap().drives[0].enabled);
}

/// Runs two arms over lines with injected faults until the bridge reports a fault. Returns the
/// fault, the notes of the bridge, the rig and the bridge. The bridge still exists and the
/// controllers have no watchdog, so that only its orders at the fault can disable the drives.
fn into_a_fault(faults: LineFaults) -> (PortFault, Vec<Note>, Rig, SerialPort) {
    let options = EmulatorOptions { faults, no_watchdog: true, ..EmulatorOptions::default() };
    let rig = Rig::start(2, options);
    let (to, mut from) = notes();
    let mut port = rig.bridge(40, to);
    let (period, fault) = exchange(&mut port, &[on(20), on(20)], 0, |_, _| false).unwrap_err();
    // After a fault the bridge answers each exchange with the same fault.
    let again = port.exchange(period + 1, &[on(20); 2], &mut [ArmReading::default(); 2]);
    assert_eq!(again, Err(fault.clone()));
    let mut told = Vec::new();
    while let Ok(note) = from.pop() {
        told.push(note);
    }
    (fault, told, rig, port)
}

#[test]
#[ignore = "real time over pseudo-terminals: run by name on a machine with time to spare"]
fn unplugged_serial_line_is_reported_and_disables_drives() {
    let faults = LineFaults {
        unplugged: vec![At { effector: 1, axis: 3, time: 0.2 }],
        ..LineFaults::default()
    };

    let (fault, told, rig, _port) = into_a_fault(faults);

    let path = &rig.devices.effector[1].axes[3];
    assert_eq!(fault.effector, 1);
    for wanted in ["postument, axis 3", path, "no answer for 40 periods"] {
        assert!(fault.reason.contains(wanted), "{}", fault.reason);
    }
    let missed = told.iter().filter(|n| n.effector == 1 && n.what == NoteKind::Missed { axis: 3 });
    assert!(missed.count() >= 39);
    std::thread::sleep(Duration::from_millis(50));
    assert!(rig.seen.lock().unwrap().drives.iter().all(|drive| !drive.enabled));
}

#[test]
#[ignore = "real time over pseudo-terminals: run by name on a machine with time to spare"]
fn reset_axis_controller_is_reported_and_disables_drives() {
    let faults = LineFaults {
        resets: vec![At { effector: 0, axis: 5, time: 0.2 }],
        ..LineFaults::default()
    };

    let (fault, _, rig, _port) = into_a_fault(faults);

    assert_eq!(fault.effector, 0);
    assert!(fault.reason.contains("track, axis 5"), "{}", fault.reason);
    assert!(fault.reason.contains("it was reset"), "{}", fault.reason);
    std::thread::sleep(Duration::from_millis(50));
    assert!(rig.seen.lock().unwrap().drives.iter().all(|drive| !drive.enabled));
}

/// The bridge works on with answers that are missed or corrupt, and with datagrams that are lost or
/// reordered.
#[test]
#[ignore = "real time over pseudo-terminals: run by name on a machine with time to spare"]
fn bridge_tolerates_bad_answers_and_datagrams() {
    let faults = LineFaults {
        missed: 0.05,
        corrupt: 0.02,
        lost: 0.2,
        reordered: 0.2,
        ..LineFaults::default()
    };
    let rig = Rig::start(2, EmulatorOptions { faults, ..EmulatorOptions::default() });
    rig.seen.lock().unwrap().push = -7.5;
    let (to, mut from) = notes();
    let mut port = rig.bridge(40, to);

    let mut finite = 0;
    exchange(&mut port, &[on(20), on(20)], 0, |period, readings| {
        finite += u32::from(readings[0].wrench_on_sensor.is_finite());
        period > 400
    })
    .unwrap();

    assert!(finite > 300, "{finite}");
    let mut kinds = [0; 4];
    while let Ok(note) = from.pop() {
        match note.what {
            NoteKind::Missed { .. } => kinds[0] += 1,
            NoteKind::Impossible { .. } => kinds[1] += 1,
            NoteKind::Lost { .. } => kinds[2] += 1,
            NoteKind::Reordered => kinds[3] += 1,
            _ => {}
        }
    }
    assert!(kinds[0] > 100 && kinds[1] > 5 && kinds[2] > 10 && kinds[3] > 10, "{kinds:?}");
}

#[test]
#[ignore = "real time over pseudo-terminals: run by name on a machine with time to spare"]
fn silent_force_sensor_reads_nan_and_is_reported() {
    let faults = LineFaults {
        silenced: vec![At { effector: 1, axis: 0, time: 0.3 }],
        ..LineFaults::default()
    };
    let rig = Rig::start(2, EmulatorOptions { faults, ..EmulatorOptions::default() });
    let (to, mut from) = notes();
    let mut port = rig.bridge(40, to);

    let mut spoke = false;
    exchange(&mut port, &[ArmDrive::OFF; 2], 0, |_, readings| {
        let now = readings[1].wrench_on_sensor.is_finite();
        spoke |= now;
        spoke && !now && readings[0].wrench_on_sensor.is_finite()
    })
    .unwrap();

    let told = std::iter::from_fn(|| from.pop().ok());
    assert!(told.into_iter().any(|n| n.effector == 1 && n.what == NoteKind::ForceSilent));
}

#[test]
#[ignore = "real time over pseudo-terminals: run by name on a machine with time to spare"]
fn bridge_reports_killed_emulator_within_half_a_second() {
    let mut rig = Rig::start(2, EmulatorOptions::default());
    let mut port = rig.bridge(3, Notes::none());
    let mut readings = [ArmReading::default(); 2];
    for period in 0..20 {
        // A busy machine may miss three answers already here; the checks below are the same then.
        if port.exchange(period, &[on(20); 2], &mut readings).is_err() {
            break;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let course = rig.kill();
    assert!(course.orders > 0);

    let begun = Instant::now();
    let fault =
        (20..50).find_map(|period| port.exchange(period, &[on(20); 2], &mut readings).err());

    assert!(begun.elapsed() < Duration::from_millis(500), "{:?}", begun.elapsed());
    let reason = fault.unwrap().reason;
    for wanted in ["track", "postument", "/dev/pts/", "no answer for 3 periods", "period"] {
        assert!(reason.contains(wanted), "{reason}");
    }
}
