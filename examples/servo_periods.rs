//! One servo period after the other: the pure function of the servo against the simulated plant.
//!
//!     cargo run --release --example servo_periods
//!
//! The arm on the track turns its column by 40 mrad within 0.8 s. In each period of 2 ms the servo
//! gets the number of the period, a reading and at most one command; it returns the drive command
//! and the state of the arm. Neither side knows a clock: the program runs as fast as it computes.

use rubik_robot::hw::plant::{Plant, PlantConfig};
use rubik_robot::hw::port::Port;
use rubik_robot::motion::{Motion, MoveCommand, PERIOD};
use rubik_robot::servo::io::{ArmDrive, ArmReading};
use rubik_robot::servo::{ArmServo, ServoCommand, ServoConfig};
use rubik_robot::tasks;
use std::error::Error;
use std::path::Path;

/// Joint that turns: the column.
const COLUMN: usize = 1;
/// Duration of the motion (servo periods).
const PERIODS: u32 = 400;
/// The built-in cell with one arm.
const CELL: &str = "task = \"idle\"\n[[effector]]\nname = \"track\"\n";

/// The column in one servo period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sample {
    /// Time at the beginning of the period (s).
    pub(crate) time: f64,
    /// Set joint position at the end of the period (rad).
    pub(crate) set: f64,
    /// Measured joint position at its beginning (rad).
    pub(crate) measured: f64,
    /// Pulse width of the motor, -255..=255.
    pub(crate) pwm: i16,
}

fn main() -> Result<(), Box<dyn Error>> {
    println!("   time       set  measured  pulse width");
    for Sample { time, set, measured, pwm } in turn(0.04)?.iter().step_by(25) {
        println!("{time:5.2} s {:5.2} mrad {:4.2} mrad {pwm:12}", set * 1e3, measured * 1e3);
    }
    Ok(())
}

/// Turns the column by `angle` (rad), and then waits for as long as the motion takes. Returns all
/// periods.
pub(crate) fn turn(angle: f64) -> Result<Vec<Sample>, Box<dyn Error>> {
    let config = tasks::read(Path::new("cell"), CELL, &[])?.controller;
    let (arm, effector) = (&config.cell.arms[0], &config.effectors[0]);

    // The brakes hold the arm until the servo has its first reading.
    let mut plant = Plant::new(PlantConfig::new(config.cell.clone()), 2007)?;
    let mut readings = [ArmReading::default()];
    plant.exchange(0, &[ArmDrive::OFF], &mut readings)?;
    let mut servo = ArmServo::new(ServoConfig::new(arm, effector.gains.clone()), &readings[0]);

    let mut target = arm.start;
    target.0[COLUMN] += angle;
    let command = MoveCommand { motion: Motion::Joints(target), periods: PERIODS, jaw: None };
    let mut command = Some(ServoCommand::Move { command, start: 0 });

    let mut samples = Vec::new();
    for period in 1..=u64::from(2 * PERIODS) {
        let (drive, state) = servo.step(period, &readings[0], command.take().as_ref());
        plant.exchange(period, &[drive], &mut readings)?;
        samples.push(Sample {
            time: period as f64 * PERIOD,
            set: state.desired_joints.0[COLUMN],
            measured: state.joints.0[COLUMN],
            pwm: drive.pwm[COLUMN],
        });
    }
    Ok(samples)
}
