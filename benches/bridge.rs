//! Time of the exchange with fifteen serial axis controllers and two force sensors, and the rest of
//! the 2 ms period.
//!
//! Pseudo-terminals replace the serial lines. The bench therefore measures the bridge and the
//! kernel, without the 0.22 ms that 18 bytes take at 921600 baud. The emulator answers from a
//! thread of its own. With `-- --json` the last line of the output is JSON.

use rubik_robot::arms::builtin;
use rubik_robot::cell::{Arm, ForceSensor, Gripper};
use rubik_robot::hw::driver::{Clock, Histogram, PERIOD_NANOS, RealTime};
use rubik_robot::hw::emulator::{EmulatedArm, Emulator, EmulatorOptions};
use rubik_robot::hw::note::{NoteKind, notes};
use rubik_robot::hw::port::{Port, PortFault};
use rubik_robot::hw::serial::axis::Rules;
use rubik_robot::motion::JointPositions;
use rubik_robot::servo::io::{ArmDrive, ArmReading};
use rubik_robot::spatial::Pose;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Number of exchanges.
const PERIODS: u64 = 5000;
/// Time that 10 bytes out and 8 in take on a line of 921600 baud with 11 bits a byte (us).
const ON_THE_LINE: f64 = 18.0 * 11.0 / 0.9216;

/// Plant whose arms do not move.
struct Still;

impl Port for Still {
    fn exchange(
        &mut self,
        _: u64,
        _: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        readings.fill(ArmReading::default());
        Ok(())
    }
}

/// Returns an arm with the built-in kinematic model `irp6_{name}`. The emulator needs an arm, but
/// its poses, gripper and sensor do not affect the measured times.
fn arm(name: &str) -> Arm {
    Arm {
        name: name.to_owned(),
        model: builtin(&format!("irp6_{name}"))
            .unwrap_or_else(|| unreachable!("a built-in profile")),
        world_from_base: Pose::identity(),
        flange_from_tool: Pose::identity(),
        gripper: Gripper {
            finger_width: 0.02,
            finger_thickness: 0.01,
            finger_tip: 0.01,
            palm: 0.04,
            palm_half_width: 0.03,
            opening: (0.053, 0.091),
            opening_of_motor: [0.074, -1.451910074e-5, -2.8313e-9],
            opening_offset: 0.0,
            increments: 128.0,
            amperes_per_newton: 0.004,
        },
        sensor: ForceSensor {
            flange_from_sensor: Pose::identity(),
            weight: 0.0,
            centre_in_flange: nalgebra::Point3::origin(),
            range: [65.0, 65.0, 130.0, 5.0, 5.0, 5.0],
        },
        start: JointPositions::default(),
    }
}

/// Exchanges orders and answers with the emulator in each period and prints the times.
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arms = [arm("track"), arm("postument")];
    let emulated: Vec<_> = arms
        .iter()
        .map(|a| EmulatedArm { name: a.name.clone(), has_track: a.model.has_track })
        .collect();
    let mut emulator = Emulator::open(Still, &emulated, EmulatorOptions::default())?;
    let devices = emulator.devices();
    let axes = devices.effector.iter().flat_map(|e| &e.axes).filter(|a| !a.is_empty()).count();
    let stop = Arc::new(AtomicBool::new(false));
    let ends = Arc::clone(&stop);
    // The emulator has a lower priority than the bridge, whose time is measured.
    let server = std::thread::spawn(move || {
        let _rights = RealTime::acquire(70, None);
        emulator.run(&ends, |_, _| {})
    });
    let (to, mut noted) = notes();
    let rules = Rules { misses: 1000, ..Rules::default() };
    let mut port = devices.serial(&arms, rules, to)?;

    let rights = RealTime::acquire(80, None);
    for warning in &rights.warnings {
        println!("not granted: {warning}");
    }
    let drive = ArmDrive { enabled: true, pwm: [100; 7], ..ArmDrive::OFF };
    let mut readings = [ArmReading::default(); 2];
    port.exchange(0, &[ArmDrive::OFF; 2], &mut readings)?;
    let mut times = Histogram::default();
    let (mut missed, mut cut) = (0u64, 0u64);
    let mut next = Clock.now() + PERIOD_NANOS;
    for period in 1..=PERIODS {
        Clock.wait_until(next, 0);
        let begun = Clock.now();
        port.exchange(period, &[drive; 2], &mut readings)?;
        times.record(Clock.now() - begun);
        next = (next + PERIOD_NANOS).max(Clock.now());
        let before = missed;
        // Several answers may be missed in one exchange, which counts once as cut short.
        while let Ok(note) = noted.pop() {
            missed += match note.what {
                NoteKind::Missed { .. } => 1,
                NoteKind::MissedTogether => 7 + u64::from(arms[note.effector].model.has_track),
                _ => 0,
            };
        }
        cut += u64::from(missed > before);
    }
    stop.store(true, Ordering::Release);
    let course = server.join().map_err(|_| "the emulator died")?.map_err(|e| e.to_string())?;

    let us = |q: f64| times.quantile(q) as f64 * 1e-3;
    let (p50, p99, p999) = (us(0.5), us(0.99), us(0.999));
    let margin = 2000.0 - p99 - ON_THE_LINE;
    println!(
        "{PERIODS} exchanges with {axes} axes: p50 {p50:.0}, p99 {p99:.0}, p99.9 {p999:.0}, \
         max {:.0} us",
        times.max() as f64 * 1e-3
    );
    println!("exchanges that were cut short, since an answer had not come: {cut} of {PERIODS}");
    println!(
        "answers missed: at most {missed} of {}; the emulator stood still for {} periods",
        PERIODS * axes as u64,
        course.stalled
    );
    println!("left of 2 ms at p99, with {ON_THE_LINE:.0} us on a real line: {margin:.0} us");
    if std::env::args().any(|a| a == "--json") {
        println!(
            "{{\"axes\":{axes},\"p50_us\":{p50:.1},\"p99_us\":{p99:.1},\"p999_us\":{p999:.1},\
             \"max_us\":{:.1},\"missed_answers\":{missed},\"margin_us\":{margin:.1}}}",
            times.max() as f64 * 1e-3
        );
    }
    Ok(())
}
