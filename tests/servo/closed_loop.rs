//! Servo and plant together: tracking, watchdogs and force control of the closed chain.

use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use rubik_robot::arms::builtin;
use rubik_robot::cell::{Arm, Cell, CubeSpec, Gripper, HandZone};
use rubik_robot::hw::driver::{Core, NoRecords, ServoLink, Switches, link};
use rubik_robot::hw::plant::{Jaws, Plant, PlantConfig, SensorNoise, Start};
use rubik_robot::motion::{
    ArmState, Depth, Direction, Frame, JawCommand, JointPositions, Motion, MoveCommand,
};
use rubik_robot::scenario::keys::Control;
use rubik_robot::servo::regulator::{IRP6, ServoGains};
use rubik_robot::servo::tff::{MOST_SELF_EXCITATION, Mechanics, self_excitation};
use rubik_robot::servo::{ServoCommand, ServoConfig};
use rubik_robot::spatial::Pose;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

/// Edge of the cube (m).
const EDGE: f64 = 0.057;

/// Returns a cell whose arms face each other, with level tools that meet at a cube in the track
/// arm's gripper.
fn cell() -> Cell {
    let arm = |name: &str, start: [f64; 7]| {
        let config = crate::servo_rig::config();
        Arm {
            name: name.to_owned(),
            model: builtin(name).unwrap(),
            world_from_base: Pose::identity(),
            flange_from_tool: config.flange_from_tool,
            gripper: Gripper {
                finger_width: 0.012,
                finger_tip: 0.0075,
                palm: 0.0425,
                amperes_per_newton: 0.0018,
                ..config.gripper
            },
            sensor: rubik_robot::cell::ForceSensor {
                weight: 10.8,
                centre_in_flange: Point3::new(0.0, 0.0, 0.156),
                ..config.sensor
            },
            start: JointPositions(start),
        }
    };
    let q = FRAC_PI_2;
    let mut cell = Cell {
        arms: vec![
            arm("irp6_track", [0.5, 0.0, -q, 0.0, q, q, -q]),
            arm("irp6_postument", [0.0, 0.0, -q, 0.0, q, q, 0.0]),
        ],
        cameras: Vec::new(),
        cube: CubeSpec { edge: EDGE, mass: 0.1 },
        table_height: 0.6,
        hand: HandZone {
            world_from_cube: Pose::translation(0.75, 0.3, 1.3),
            half_extent: Vector3::repeat(0.05),
        },
        keeper: rubik_robot::cube::Keeper::Person,
    };
    let meeting =
        world_from_tool(&cell.arms[0]).translation.vector + Vector3::x() * (2.0 * EDGE / 3.0);
    let about = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI);
    let postument = &mut cell.arms[1];
    postument.world_from_base = Pose::from_parts(Translation3::identity(), about);
    let miss = meeting - world_from_tool(postument).translation.vector;
    postument.world_from_base.translation.vector = miss;
    cell
}

/// Returns the pose of an arm's tool in the world when its joints are at `arm.start`.
fn world_from_tool(arm: &Arm) -> Pose {
    arm.world_from_base * arm.model.base_from_flange(&arm.start) * arm.flange_from_tool
}

/// Both arms of [`cell`] with their servos, on the simulated plant.
struct Closed {
    core: Core,
    links: Vec<ServoLink>,
    plant: Plant,
    period: u64,
}

impl Closed {
    /// Makes a rig whose plant begins with the cube at the place `start`.
    fn new(start: Start, jaws: Jaws, noise: SensorNoise) -> Self {
        let cell = cell();
        let gains = ServoGains::parse(IRP6).unwrap();
        let configs = cell.arms.iter().map(|arm| ServoConfig::new(arm, gains.clone())).collect();
        let config = PlantConfig { start, jaws, noise, ..PlantConfig::new(cell) };
        let mut plant = Plant::new(config, 1).unwrap();
        let (links, ends) = (0..2).map(|_| link()).unzip();
        let switches = Arc::new(Switches::default());
        let core = Core::new(configs, ends, switches, Box::new(NoRecords), &mut plant).unwrap();
        Self { core, links, plant, period: 0 }
    }

    /// Commands an arm to a motion of this number of periods.
    fn send(&mut self, arm: usize, motion: Motion, periods: u32) {
        let command = MoveCommand { motion, periods, jaw: None };
        self.links[arm].send(ServoCommand::Move { command, start: 0 }).unwrap();
    }

    /// Commands an arm to hold its pose for `periods` periods while its jaws close to `opening`
    /// (m).
    fn jaw(&mut self, arm: usize, opening: f64, periods: u32) {
        let jaw = JawCommand { opening, force_limit: 40.0, stops: Depth::One };
        let command = MoveCommand { motion: Motion::Hold, periods, jaw: Some(jaw) };
        self.links[arm].send(ServoCommand::Move { command, start: 0 }).unwrap();
    }

    /// Makes a rig in which the two arms strain each other through a cube: arm 0 holds it, arm 1
    /// grips it as well and then moves, without compliance, 2 mm across and 1 mm along its approach
    /// axis.
    fn strained(jaws: Jaws, noise: SensorNoise) -> Self {
        let tool = world_from_tool(&cell().arms[0]);
        let ahead = Translation3::new(0.0, 0.0, EDGE / 3.0);
        let tool_from_cube = Pose::from_parts(ahead, tool.rotation.inverse());
        let mut rig = Self::new(Start::Held { arm: 0, tool_from_cube }, jaws, noise);
        rig.jaw(0, 0.053, 100);
        rig.run(200);
        for arm in 0..2 {
            rig.links[arm].send(ServoCommand::Bias).unwrap();
        }
        rig.run(20);
        rig.jaw(1, 0.053, 1000);
        rig.run(1200);
        assert!(rig.plant.verdict().both_hold);
        let mut slow = [Direction::HOLD; 6];
        slow[0] = Direction::Unguarded { velocity: 0.001 };
        slow[2] = Direction::Unguarded { velocity: 0.0005 };
        rig.send(1, Motion::Task { frame: Frame::Tool, directions: slow }, 1000);
        rig.run(1000);
        rig
    }

    /// Makes `arms` compliant for `periods` periods, along x, y, z with the admittance `along`
    /// (m/(s N)), and about the approach axis with `about` (rad/(s Nm)). Returns the force at arm 1
    /// in each period (N).
    fn relax(&mut self, arms: &[usize], (along, about): (f64, f64), periods: u32) -> Vec<f64> {
        let guarded =
            |admittance, inertia| Direction::Guarded { velocity: 0.0, admittance, inertia };
        let keys = Control::default();
        let linear = guarded(along, keys.linear_inertia);
        let about = guarded(about, keys.angular_inertia);
        let hold = Direction::HOLD;
        let directions = [linear, linear, linear, hold, hold, about];
        for arm in arms {
            self.send(*arm, Motion::Task { frame: Frame::Tool, directions }, periods);
        }
        self.run(periods).iter().map(|s| s[1].wrench_in_tool.force.norm()).collect()
    }

    /// Runs a servo period; returns the states of both arms.
    fn step(&mut self) -> [ArmState; 2] {
        self.period += 1;
        self.core.period(self.period, &mut self.plant).unwrap();
        [*self.links[0].state(), *self.links[1].state()]
    }

    /// Runs a number of servo periods; returns the states of both arms in each.
    fn run(&mut self, periods: u32) -> Vec<[ArmState; 2]> {
        (0..periods).map(|_| self.step()).collect()
    }
}

/// Returns how far each motor of an arm is from its set value (rad).
fn behind(cell: &Cell, arm: usize, state: &ArmState) -> [f64; 7] {
    let set = cell.arms[arm].model.motors(&state.desired_joints).0;
    std::array::from_fn(|i| (set[i] - state.motors.0[i]).abs())
}

/// Returns how far each motor of an arm is from its set value at most in these states (rad).
fn worst(cell: &Cell, arm: usize, states: &[[ArmState; 2]]) -> [f64; 7] {
    states.iter().fold([0.0; 7], |w, s| {
        let b = behind(cell, arm, &s[arm]);
        std::array::from_fn(|i| f64::max(w[i], b[i]))
    })
}

/// Returns the largest of these values, or 0 if all are negative.
fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(*v))
}

#[test]
fn arms_at_rest_do_not_move() {
    let cell = cell();
    let mut rig = Closed::new(Start::Hand, Jaws::rubber(), SensorNoise::none());

    let states = rig.run(1000);

    for arm in 0..2 {
        assert!(largest(&worst(&cell, arm, &states)) < 0.01);
        let (state, start) = (&states[999][arm], &cell.arms[arm].start);
        // The set value is the place of the first reading, in whole increments of the encoders.
        let moved = state.desired_joints.0.iter().zip(&start.0).map(|(set, start)| set - start);
        assert!(moved.fold(0.0, |m: f64, by| m.max(by.abs())) < 1e-3, "{state:?}");
        assert_eq!(state.fault, None);
    }
}

#[test]
fn each_axis_follows_smooth_course_and_settles() {
    let cell = cell();
    // Distances from the start pose that stay within the limits (m on the track, else rad).
    for (axis, distance) in
        [(0, -0.03), (1, 0.2), (2, 0.1), (3, 0.1), (4, -0.2), (5, 0.2), (6, 0.1)]
    {
        let mut rig = Closed::new(Start::Hand, Jaws::rubber(), SensorNoise::default());
        rig.run(100);
        let mut way = Vec::new();
        for step in 1..=50 {
            let x = f64::from(step) / 50.0;
            let share = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x);
            for arm in usize::from(axis == 0)..2 {
                // The postument has no axis 0, so the track arm moves alone there.
                let arm = if axis == 0 { 0 } else { arm };
                let mut goal = cell.arms[arm].start;
                goal.0[axis] += share * distance;
                rig.send(arm, Motion::Joints(goal), 10);
            }
            way.extend(rig.run(10));
        }
        let rest = rig.run(500);

        for (arm, last) in rest[499].iter().enumerate() {
            let end = behind(&cell, arm, last);
            assert_eq!((last.refused, last.fault), (None, None), "axis {axis}, arm {arm}");
            if axis > 0 || arm == 0 {
                let set = last.desired_joints.0[axis] - cell.arms[arm].start.0[axis];
                assert!((set - distance).abs() < 1e-9, "axis {axis}, arm {arm}: {set}");
            }
            let worst = worst(&cell, arm, &way);
            println!(
                "axis {axis}, arm {arm}: {:.2} rad behind at most, {:.3} at the end",
                worst[axis], end[axis]
            );
            // The motor of the tool's roll is the fastest one.
            let most = if axis == 6 { 1.5 } else { 0.5 };
            assert!(largest(&worst) < most, "axis {axis}, arm {arm}: {worst:.3?} rad behind");
            assert!(largest(&end) < 0.02, "axis {axis}, arm {arm}: {end:.3?} rad at the end");
        }
    }
}

#[test]
fn step_in_motor_speed_causes_no_fault() {
    // The speed of a motor jumps to 47 rad/s. Above 85 rad/s the regulators demand more current
    // than the power stages of the plant allow, so a generator splits long motions into macrosteps
    // and accelerates them.
    let cell = cell();
    let mut rig = Closed::new(Start::Hand, Jaws::rubber(), SensorNoise::default());
    let mut goal = cell.arms[1].start;
    goal.0[1] += 0.3;
    goal.0[5] += 0.3;
    rig.send(1, Motion::Joints(goal), 500);

    let states = rig.run(1000);

    let last = states[999][1];
    assert_eq!((last.refused, last.fault), (None, None));
    let worst = worst(&cell, 1, &states);
    println!("step of speed: {worst:.2?} rad behind at most");
    assert!(largest(&behind(&cell, 1, &last)) < 0.1);
}

/// Moves an arm forward through free space in a guarded direction with this admittance (m/(s N))
/// and virtual mass (kg). Returns the swing of the measured force at the end, peak to peak (N).
fn swing_of_free_motion(admittance: f64, inertia: f64) -> f64 {
    let mut rig = Closed::new(Start::Hand, Jaws::rubber(), SensorNoise::default());
    rig.run(100);
    rig.links[1].send(ServoCommand::Bias).unwrap();
    rig.run(20);
    let mut forward = [Direction::HOLD; 6];
    forward[2] = Direction::Guarded { velocity: 0.02, admittance, inertia };
    rig.send(1, Motion::Task { frame: Frame::Tool, directions: forward }, 1000);
    let forces: Vec<f64> = rig.run(1000).iter().map(|s| s[1].wrench_in_tool.force.z).collect();
    let end = &forces[750..];
    largest(end) + largest(&end.iter().map(|f| -f).collect::<Vec<_>>())
}

/// The tool shakes exactly where its self-excitation exceeds the limit.
#[test]
fn tool_shakes_exactly_when_self_excitation_exceeds_limit() {
    // Approach of the visual servo: 20 mm/s, with an admittance of 5 mm/(s N) stopped by 4 N.
    let arm = Mechanics { tool: 1.1, frequency: 31.0, damping: 0.05, delay: 0.005 };
    for (admittance, inertia) in [(0.01, 0.0), (0.005, 0.0), (0.0025, 0.0), (0.005, 20.0)] {
        let excitation = self_excitation(admittance, inertia, &arm);
        let swing = swing_of_free_motion(admittance, inertia);

        println!("{admittance} m/(s N), {inertia} kg: gain {excitation:.2}, swing {swing:.2} N");
        let shakes = excitation > MOST_SELF_EXCITATION;
        assert_eq!(swing > 3.0, shakes, "{admittance} {inertia}: {excitation} {swing}");
    }
}

/// The force falls below 5 N within 0.3 s and stays below 1 N after 2 s, with the admittances of
/// the keys' defaults.
#[test]
fn default_admittance_relaxes_force_between_gripping_arms() {
    let keys = Control::default();
    let admittance = (keys.linear_admittance, keys.angular_admittance);
    for jaws in [Jaws::rubber(), Jaws::stiff()] {
        for arms in [&[0][..], &[1], &[0, 1]] {
            let mut rig = Closed::strained(jaws, SensorNoise::default());

            let forces = rig.relax(arms, admittance, 2000);

            // The backlash of the gears takes up a part of the 2 mm.
            assert!(forces[0] > 35.0, "strained before: {}", forces[0]);
            let late = forces[100..].iter().position(|f| *f < 5.0);
            assert!(late.is_some_and(|p| p < 50), "arms {arms:?}: {late:?}");
            let calm = largest(&forces[1000..]);
            println!("arms {arms:?}: {:.1} N at first, {calm:.2} N in the end", forces[0]);
            assert!(calm < 1.0, "arms {arms:?}: {calm} N");
            let counts = rig.plant.verdict().counts;
            assert_eq!((counts.slips, counts.pops, counts.drops), (0, 0, 0), "arms {arms:?}");
        }
    }
}

#[test]
fn high_admittance_oscillates_when_two_arms_grip_cube() {
    // The admittance b = 0.005 m/(s N) suits softer contacts. Here the stiffness K = 20-45 kN/m
    // exceeds 1 / (b D) with the delay D of the loop.
    let mut rig = Closed::strained(Jaws::rubber(), SensorNoise::default());

    let forces = rig.relax(&[0, 1], (0.005, 0.1), 2000);

    let swing = largest(&forces[100..]);
    println!("the original's gains in a stiff chain: {swing:.1} N");
    assert!(swing > 30.0, "{swing} N");
}
