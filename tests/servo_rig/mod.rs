//! Arm and port of simple motors for the tests of the servo. They share no code with the plant.
#![allow(unreachable_pub, clippy::unwrap_used, reason = "a module of test programs")]

use nalgebra::Point3;
use rubik_robot::arms::builtin;
use rubik_robot::cell::{ForceSensor, Gripper};
use rubik_robot::hw::port::{Port, PortFault};
use rubik_robot::motion::{AXES, JointPositions};
use rubik_robot::servo::ServoConfig;
use rubik_robot::servo::io::{ArmDrive, ArmReading};
use rubik_robot::servo::period::Length;
use rubik_robot::servo::regulator::{IRP6, ServoGains};
use rubik_robot::spatial::Pose;
use std::f64::consts::TAU;

/// Start position of the arms of the tests.
pub const START: JointPositions = JointPositions([0.5, 0.1, -1.55, 0.05, 1.2, 1.6, -0.4]);

/// Returns the servo configuration of the track arm with a straight tool of 0.25 m and a weightless
/// force sensor.
pub fn config() -> ServoConfig {
    ServoConfig {
        model: builtin("irp6_track").unwrap(),
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
            weight: 0.0,
            centre_in_flange: Point3::origin(),
            range: [65.0, 65.0, 130.0, 5.0, 5.0, 5.0],
        },
        gains: ServoGains::parse(IRP6).unwrap(),
        period: Length::default(),
    }
}

/// Returns the encoder reading of the arm at [`START`].
#[allow(dead_code, reason = "not every test that shares this file needs it")]
pub fn first_reading() -> ArmReading {
    let model = config().model;
    let motors = model.motors(&START);
    ArmReading {
        counts: std::array::from_fn(|i| (motors.0[i] * model.increments[i] / TAU).round() as i64),
        ..ArmReading::default()
    }
}

/// First-order motors: time constant 40 ms, 330 rad/s at a pulse width of 255.
#[allow(dead_code, reason = "not every test that shares this file runs motors")]
pub struct Motors {
    positions: Vec<[f64; AXES]>,
    speeds: Vec<[f64; AXES]>,
    /// Whether each arm's drives were on in the last period.
    pub enabled: Vec<bool>,
    /// Number of the last exchange.
    pub last_period: u64,
    /// Period from which on the port fails.
    pub fails_at: Option<u64>,
}

#[allow(dead_code, reason = "as above")]
impl Motors {
    /// Makes the motors of `arms` arms, at rest at [`START`].
    pub fn new(arms: usize) -> Self {
        let motors = config().model.motors(&START).0;
        Self {
            positions: vec![motors; arms],
            speeds: vec![[0.0; AXES]; arms],
            enabled: vec![false; arms],
            last_period: 0,
            fails_at: None,
        }
    }
}

impl Port for Motors {
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        if self.fails_at.is_some_and(|at| period >= at) {
            return Err(PortFault { effector: 1, reason: "cable".into() });
        }
        self.last_period = period;
        let increments = config().model.increments;
        for (arm, drive) in drives.iter().enumerate() {
            self.enabled[arm] = drive.enabled;
            for axis in 0..AXES {
                let free = f64::from(drive.pwm[axis]) * 330.0 / 255.0;
                let speed = &mut self.speeds[arm][axis];
                *speed += (free - *speed) * (1.0 - (-0.002f64 / 0.040).exp());
                if !drive.enabled {
                    *speed = 0.0;
                }
                self.positions[arm][axis] += *speed * 0.002;
            }
            let positions = &self.positions[arm];
            readings[arm].counts =
                std::array::from_fn(|i| (positions[i] * increments[i] / TAU).floor() as i64);
        }
        Ok(())
    }
}
