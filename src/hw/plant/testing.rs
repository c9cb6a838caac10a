//! Cell, meeting of both arms and small servo for the plant's own tests.

use super::config::{PlantConfig, SensorNoise, Start};
use super::{CubeMechanics, Jaws, Plant, sagging};
use crate::arms::builtin;
use crate::cell::{Arm, Cell, CubeSpec, ForceSensor, Gripper, HandZone};
use crate::hw::port::Port;
use crate::motion::{AXES, Depth, JointPositions, MotorPositions, PERIOD};
use crate::servo::io::{ArmDrive, ArmReading};
use crate::spatial::Pose;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Edge of the tests' cube (m).
pub(super) const EDGE: f64 = 0.057;

/// Returns the gripper of both arms.
fn gripper() -> Gripper {
    Gripper {
        finger_width: 0.012,
        finger_thickness: 0.010,
        finger_tip: 0.0075,
        palm: 0.0425,
        palm_half_width: 0.035,
        opening: (0.053, 0.091),
        opening_of_motor: [0.074, -1.451910074e-5, -2.8313e-9],
        opening_offset: 0.0,
        increments: 128.0,
        amperes_per_newton: 0.0018,
    }
}

/// Returns the arm on the track, or else the one on the fixed post (`postument`), at 2.11 m.
fn arm(track: bool) -> Arm {
    let (name, y) = if track { ("irp6_track", 0.0) } else { ("irp6_postument", 2.11) };
    Arm {
        name: name.to_owned(),
        model: builtin(name).unwrap(),
        world_from_base: Pose::translation(0.0, y, 0.0),
        flange_from_tool: Pose::translation(0.0, 0.0, 0.25),
        gripper: gripper(),
        sensor: ForceSensor {
            flange_from_sensor: Pose::translation(0.0, 0.0, 0.09),
            weight: 10.8,
            centre_in_flange: Point3::new(0.004, 0.0, 0.156),
            range: [65.0, 65.0, 130.0, 5.0, 5.0, 5.0],
        },
        start: JointPositions([0.0, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]),
    }
}

/// Returns a cell in which both arms are in the front position of the robot of 2007 and face each
/// other, with level tools that meet at one cube. The track's fingers reach over two layers, those
/// of the postument over the opposite outer layer, with their jaws at right angles. The postument's
/// base is placed so that the tools meet.
pub(in crate::hw) fn cell() -> Cell {
    let mut cell = Cell {
        arms: vec![arm(true), arm(false)],
        cameras: Vec::new(),
        cube: CubeSpec { edge: EDGE, mass: 0.1 },
        table_height: 0.6,
        hand: HandZone {
            world_from_cube: Pose::translation(0.75, 0.3, 1.3),
            half_extent: Vector3::repeat(0.05),
        },
        keeper: crate::cube::Keeper::Person,
    };
    cell.arms[0].start =
        JointPositions([0.5, 0.0, -FRAC_PI_2, 0.0, FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2]);
    cell.arms[1].start = JointPositions([0.0, 0.0, -FRAC_PI_2, 0.0, FRAC_PI_2, FRAC_PI_2, 0.0]);
    let cube = world_from_tool(&cell.arms[0]).translation.vector;
    let postument = &mut cell.arms[1];
    let half_turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI);
    postument.world_from_base = Pose::from_parts(Translation3::identity(), half_turn);
    let miss = cube + Vector3::x() * (EDGE / 3.0) - world_from_tool(postument).translation.vector;
    postument.world_from_base.translation.vector = miss;
    // The hands meet as they are, sag included.
    let dynamics = quiet(cell.clone()).arms;
    let [first, second] = [0, 1].map(|i| {
        let arm = &cell.arms[i];
        sagging(arm, &dynamics[i], &arm.start) * world_from_tool(arm).inverse()
    });
    cell.arms[1].world_from_base = first * second.inverse() * cell.arms[1].world_from_base;
    cell
}

/// Returns the pose of an arm's tool in the world at its start position.
pub(super) fn world_from_tool(arm: &Arm) -> Pose {
    arm.world_from_base * arm.model.base_from_flange(&arm.start) * arm.flange_from_tool
}

/// Returns the pose, in the track's tool frame, of a cube whose axes are parallel to the world's.
pub(super) fn tool_from_cube() -> Pose {
    let tool = world_from_tool(&cell().arms[0]);
    Pose::from_parts(Translation3::identity(), tool.rotation.inverse())
}

/// Returns the configuration of a plant without noise and without play in the gears.
pub(super) fn quiet(cell: Cell) -> PlantConfig {
    let mut config = PlantConfig { noise: SensorNoise::none(), ..PlantConfig::new(cell) };
    for arm in &mut config.arms {
        arm.play = [0.0; AXES];
    }
    config
}

/// Returns the configuration of a quiet plant in which the track arm holds the cube at the start.
pub(super) fn held(jaws: Jaws, cube: CubeMechanics) -> PlantConfig {
    PlantConfig {
        start: Start::Held { arm: 0, tool_from_cube: tool_from_cube() },
        jaws,
        cube,
        ..quiet(cell())
    }
}

/// Servo of a plant in tests. Each axis has a simplified incremental regulator of the robot of
/// 2007, with terms of speed, position and a slow integral.
pub(super) struct TestServo {
    /// Target counts of the axes, per arm.
    pub(super) target: Vec<[f64; AXES]>,
    /// Wanted opening (m) and grip (N) of each jaw.
    pub(super) jaws: Vec<(f64, f64)>,
    pub(super) stops: [Depth; 2],
    /// Counts of the last period.
    last: Vec<[f64; AXES]>,
    last_target: Vec<[f64; AXES]>,
    /// Sums of the position errors (counts).
    slow: Vec<[f64; AXES]>,
    /// Set value of the opening (m) and last count of each jaw.
    jaw_state: Vec<(f64, f64)>,
    drives: Vec<ArmDrive>,
    pub(super) readings: Vec<ArmReading>,
    pub(super) plant: Plant,
}

impl TestServo {
    /// Makes a servo that holds the arms and jaws of the plant where they are, with a grip of 30 N.
    pub(super) fn new(mut plant: Plant) -> Self {
        let count = plant.cell().arms.len();
        let mut readings = vec![ArmReading::default(); count];
        for (i, reading) in readings.iter_mut().enumerate() {
            plant.arms[i].read(&ArmDrive::OFF, reading);
        }
        let positions: Vec<[f64; AXES]> =
            readings.iter().map(|r| r.counts.map(|c| c as f64)).collect();
        let jaws = (0..count).map(|i| (plant.jaws[i].opening(), 30.0)).collect();
        Self {
            target: positions.clone(),
            jaws,
            stops: [Depth::Two, Depth::One],
            last: positions.clone(),
            last_target: positions.clone(),
            slow: vec![[0.0; AXES]; count],
            jaw_state: (0..count).map(|i| (plant.jaws[i].opening(), 0.0)).collect(),
            drives: vec![ArmDrive::OFF; count],
            readings,
            plant,
        }
    }

    /// Sets the target joint positions of an arm.
    pub(super) fn aim(&mut self, arm: usize, joints: &JointPositions) {
        let model = &self.plant.cell().arms[arm].model;
        let motors = model.motors(joints).0;
        self.target[arm] = std::array::from_fn(|j| motors[j] * model.increments[j] / TAU);
    }

    /// Returns the target joint positions of an arm.
    pub(super) fn joints(&self, arm: usize) -> JointPositions {
        let model = &self.plant.cell().arms[arm].model;
        let m = std::array::from_fn(|j| self.target[arm][j] * TAU / model.increments[j]);
        model.joints(&MotorPositions(m)).unwrap()
    }

    /// Drives arms and jaws from the last readings for one servo period of the plant.
    pub(super) fn tick(&mut self) {
        for i in 0..self.target.len() {
            let drive = &mut self.drives[i];
            drive.enabled = true;
            drive.stops = self.stops[i];
            for j in 0..AXES {
                let y = self.readings[i].counts[j] as f64;
                let wanted = self.target[i][j] - self.last_target[i][j];
                let speed = wanted - (y - self.last[i][j]);
                let error = self.target[i][j] - y;
                self.slow[i][j] += error;
                let u = 2.65 * speed + 0.15 * error + 0.0018 * self.slow[i][j];
                drive.pwm[j] = u.clamp(-190.0, 190.0) as i16;
                self.last[i][j] = y;
                self.last_target[i][j] = self.target[i][j];
            }
            let (opening, force) = self.jaws[i];
            let gripper = &self.plant.cell().arms[i].gripper;
            // The set value moves to the wanted opening at 20 mm/s.
            let (set, last_count) = &mut self.jaw_state[i];
            *set += (opening - *set).clamp(-0.02 * PERIOD, 0.02 * PERIOD);
            let count = self.readings[i].jaw_count as f64;
            let speed = count - std::mem::replace(last_count, count);
            let counter = count * TAU / gripper.increments;
            let [c0, c1, c2] = gripper.opening_of_motor;
            let is = c0 + counter * (c1 + c2 * counter);
            let (current, allowed) =
                (self.readings[i].currents[AXES], force * gripper.amperes_per_newton);
            let last = f64::from(drive.jaw_pwm);
            let (down, up) =
                (last - 130.0 * (allowed + current), last + 130.0 * (allowed - current));
            drive.jaw_pwm =
                (2.5e5 * (is - *set) - 2.4 * speed).clamp(-190.0, 190.0).max(down).min(up).round()
                    as i16;
        }
        let period = self.plant.period;
        self.plant.exchange(period, &self.drives, &mut self.readings).unwrap();
    }

    /// Runs the servo for this time (s).
    pub(super) fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds / PERIOD) as usize {
            self.tick();
        }
    }
}
