//! What a servo period costs: two arms warm and with caches swept, its inverse kinematics, its force law.

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use nalgebra::{Point3, Translation3, UnitQuaternion};
use rubik_robot::cell::{ForceSensor, Gripper};
use rubik_robot::hw::driver::{Core, NoRecords, Switches, link};
use rubik_robot::hw::port::{Port, PortFault};
use rubik_robot::kinematics::{ArmModel, builtin};
use rubik_robot::motion::{Direction, Frame, JointPositions, Motion, MotorPositions, MoveCommand};
use rubik_robot::servo::io::{ArmDrive, ArmReading};
use rubik_robot::servo::regulator::{IRP6, ServoGains};
use rubik_robot::servo::tff::ForceLaw;
use rubik_robot::servo::{ArmServo, ServoCommand, ServoConfig};
use rubik_robot::spatial::{Pose, Wrench};
use std::f64::consts::TAU;
use std::hint::black_box;
use std::sync::Arc;

const START: JointPositions = JointPositions([0.5, 0.1, -1.55, 0.05, 1.2, 1.6, -0.4]);
const COMPLIANT: Direction = Direction::Guarded { velocity: 0.0, admittance: 0.001, inertia: 20.0 };

/// The profiles are part of the program and parsed by its tests.
fn model(name: &str) -> ArmModel {
    builtin(name).unwrap_or_else(|| unreachable!("a built-in profile"))
}

fn config(name: &str) -> ServoConfig {
    ServoConfig {
        model: model(name),
        flange_from_tool: Pose::translation(0.0, 0.0, 0.25),
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
            flange_from_sensor: Pose::translation(0.0, 0.0, 0.09),
            // Weightless, since the readings below are: the arithmetic is the same.
            weight: 0.0,
            centre_in_flange: Point3::origin(),
            range: [65.0, 65.0, 130.0, 5.0, 5.0, 5.0],
        },
        gains: ServoGains::parse(IRP6).unwrap_or_else(|e| unreachable!("built-in gains: {e}")),
    }
}

fn reading_at(model: &ArmModel, motors: &MotorPositions) -> ArmReading {
    ArmReading {
        counts: std::array::from_fn(|i| (motors.0[i] * model.increments[i] / TAU).round() as i64),
        ..ArmReading::default()
    }
}

/// Both arms in position-force control that never ends, on motors that stand still: the law
/// moves them by less than a tenth of a millimetre.
struct Pair {
    servos: [ArmServo; 2],
    readings: [ArmReading; 2],
    period: u64,
}

impl Pair {
    fn new() -> Self {
        let configs = [config("irp6_track"), config("irp6_postument")];
        let models = configs.clone().map(|c| c.model);
        let readings = [0, 1].map(|i| reading_at(&models[i], &models[i].motors(&START)));
        let mut index = 0;
        let servos = configs.map(|c| {
            index += 1;
            ArmServo::new(c, &readings[index - 1])
        });
        let mut pair = Self { servos, readings, period: 0 };
        let mut directions = [COMPLIANT; 6];
        directions[4] = Direction::HOLD;
        let motion = Motion::Task { frame: Frame::Tool, directions };
        let command = MoveCommand { motion, periods: u32::MAX, jaw: None };
        pair.step(Some(&ServoCommand::Move { command, start: 0 }));
        pair
    }

    fn step(&mut self, command: Option<&ServoCommand>) -> [ArmDrive; 2] {
        self.period += 1;
        [0, 1].map(|i| {
            let (drive, state) = self.servos[i].step(self.period, &self.readings[i], command);
            let stopped = state.refused.is_some() || state.fault.is_some();
            assert!(
                !stopped,
                "the measured arm does not move: {:?} {:?}",
                state.refused, state.fault
            );
            // A force that swings, so that the law has something to do and stays where it is.
            let swing = if self.period % 64 < 32 { 2.0 } else { -2.0 };
            self.readings[i].wrench_on_sensor =
                Wrench::from_directions([swing, 0.0, swing, 0.0, 0.0, 0.0]);
            drive
        })
    }
}

/// Times of single steps, sorted [ns]; `between` runs untimed before each.
fn single_steps(steps: usize, mut between: impl FnMut()) -> Vec<u64> {
    let mut pair = Pair::new();
    let mut times: Vec<u64> = (0..steps)
        .map(|_| {
            between();
            let start = std::time::Instant::now();
            black_box(pair.step(None));
            start.elapsed().as_nanos() as u64
        })
        .collect();
    times.sort_unstable();
    times
}

fn tails(_: &mut Criterion) {
    let share = |times: &[u64], q: f64| times[((times.len() - 1) as f64 * q) as usize] as f64 / 1e3;
    let warm = single_steps(50_000, || {});
    println!(
        "servo_period/two_arms, single steps, warm: p50 {:.2} us, p99.9 {:.2} us",
        share(&warm, 0.5),
        share(&warm, 0.999)
    );
    let mut sweep = vec![0u8; 16 << 20];
    let cold = single_steps(500, || {
        for line in sweep.iter_mut().step_by(64) {
            *line = line.wrapping_add(1);
        }
        black_box(&sweep);
    });
    println!(
        "servo_period/two_arms, single steps, caches swept: p50 {:.2} us, p99 {:.2} us",
        share(&cold, 0.5),
        share(&cold, 0.99)
    );
}

/// A port on which nothing happens.
struct Still;
impl Port for Still {
    fn exchange(
        &mut self,
        _: u64,
        _: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        let model = model("irp6_track");
        readings.fill(reading_at(&model, &model.motors(&START)));
        Ok(())
    }
}
fn period(c: &mut Criterion) {
    let mut group = c.benchmark_group("servo_period");
    let mut pair = Pair::new();
    group.bench_function("two_arms", |b| b.iter(|| pair.step(None)));

    let (_links, ends): (Vec<_>, Vec<_>) = (0..2).map(|_| link()).unzip();
    let configs = vec![config("irp6_track"), config("irp6_track")];
    let core =
        Core::new(configs, ends, Arc::new(Switches::default()), Box::new(NoRecords), &mut Still);
    if let Ok(mut core) = core {
        let mut number = 0;
        group.bench_function("core_with_links_idle", |b| {
            b.iter(|| {
                number += 1;
                core.compute(number).len()
            });
        });
    }
    group.finish();
}

fn parts(c: &mut Criterion) {
    let model = model("irp6_track");
    let mut group = c.benchmark_group("servo_parts");
    let flange = model.base_from_flange(&START);
    let mut near = START;
    near.0[1] += 0.001;
    group.bench_function("forward", |b| b.iter(|| model.base_from_flange(black_box(&START))));
    group.bench_function("inverse", |b| {
        b.iter(|| model.inverse(black_box(&flange), black_box(&near)));
    });
    let wrench = Wrench::from_directions([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]);
    let pose = Pose::from_parts(
        Translation3::new(0.6, 0.1, 1.2),
        UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3),
    );
    group.bench_function("tff", |b| {
        b.iter_batched_ref(
            ForceLaw::default,
            |law| law.step(1, Frame::Tool, black_box(&[COMPLIANT; 6]), &wrench, &pose),
            BatchSize::SmallInput,
        );
    });
    group.finish();
}

#[allow(missing_docs, reason = "made by the macro")]
mod group {
    use super::{Criterion, criterion_group, parts, period, tails};

    criterion_group! {
        name = benches;
        config = Criterion::default()
            .warm_up_time(std::time::Duration::from_millis(500))
            .measurement_time(std::time::Duration::from_secs(2));
        targets = tails, period, parts
    }
}

criterion_main!(group::benches);
