//! Servo and plant together: tracking, watch-dogs and force control of the closed chain.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test")]

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rubik_robot::cell::{Arm, Cell, CubeSpec, Gripper, HandZone};
use rubik_robot::hw::driver::{Core, NoRecords, ServoLink, Switches, link};
use rubik_robot::hw::plant::{Jaws, Plant, PlantConfig, SensorNoise, Start};
use rubik_robot::kinematics::builtin;
use rubik_robot::motion::{
    ArmState, Depth, Direction, Frame, JawCommand, JointPositions, Motion, MoveCommand,
};
use rubik_robot::servo::regulator::{IRP6, ServoGains};
use rubik_robot::servo::{ServoCommand, ServoConfig};
use rubik_robot::spatial::Pose;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

mod servo_rig;

const EDGE: f64 = 0.057;

/// Both arms in front of each other, tools level, meeting at a cube that the track arm holds.
fn cell() -> Cell {
    let arm = |name: &str, start: [f64; 7]| {
        let config = servo_rig::config();
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
            sensor: rubik_robot::cell::ForceSensor { weight: 10.8, ..config.sensor },
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
    };
    let meeting = world_from_tool(&cell.arms[0]).translation.vector + Vector3::x() * (2.0 * EDGE / 3.0);
    let about = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI);
    let postument = &mut cell.arms[1];
    postument.world_from_base = Pose::from_parts(Translation3::identity(), about);
    let miss = meeting - world_from_tool(postument).translation.vector;
    postument.world_from_base.translation.vector = miss;
    cell
}

fn world_from_tool(arm: &Arm) -> Pose {
    arm.world_from_base * arm.model.base_from_flange(&arm.start) * arm.flange_from_tool
}

struct Closed {
    core: Core,
    links: Vec<ServoLink>,
    plant: Plant,
    period: u64,
}

impl Closed {
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

    fn send(&mut self, arm: usize, motion: Motion, periods: u32) {
        let command = MoveCommand { motion, periods, jaw: None };
        self.links[arm].send(ServoCommand::Move { command, start: 0 }).unwrap();
    }

    fn step(&mut self) -> [ArmState; 2] {
        self.period += 1;
        self.core.period(self.period, &mut self.plant).unwrap();
        [*self.links[0].state(), *self.links[1].state()]
    }

    fn run(&mut self, periods: u32) -> Vec<[ArmState; 2]> {
        (0..periods).map(|_| self.step()).collect()
    }
}

fn behind(cell: &Cell, arm: usize, state: &ArmState) -> [f64; 7] {
    let set = cell.arms[arm].model.motors(&state.desired_joints).0;
    std::array::from_fn(|i| (set[i] - state.motors.0[i]).abs())
}

fn worst(cell: &Cell, arm: usize, states: &[[ArmState; 2]]) -> [f64; 7] {
    states.iter().fold([0.0; 7], |w, s| {
        let b = behind(cell, arm, &s[arm]);
        std::array::from_fn(|i| f64::max(w[i], b[i]))
    })
}

#[test]
fn explore() {
    let cell = cell();
    let mut rig = Closed::new(Start::Hand, Jaws::rubber(), SensorNoise::none());
    let states = rig.run(1000);
    for arm in 0..2 {
        println!("rest {arm}: {:.3?} {:?}", worst(&cell, arm, &states), states[999][arm].fault);
        println!("   end: {:.3?}", behind(&cell, arm, &states[999][arm]));
    }
    // Smooth motion of each axis, by macrosteps of 10 periods along a min-jerk course.
    for axis in 0..7 {
        for (amount, seconds) in [(0.1, 1.0), (0.3, 2.0)] {
            let amount = if axis == 0 { amount * 0.1 } else { amount };
            let mut rig = Closed::new(Start::Hand, Jaws::rubber(), SensorNoise::none());
            rig.run(300);
            let steps = (seconds * 500.0 / 10.0) as u32;
            let mut all = Vec::new();
            for step in 1..=steps {
                let x = f64::from(step) / f64::from(steps);
                let s = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x);
                for arm in 0..2 {
                    if arm == 1 && axis == 0 {
                        continue;
                    }
                    let mut goal = cell.arms[arm].start;
                    goal.0[axis] += s * amount;
                    rig.send(arm, Motion::Joints(goal), 10);
                }
                all.extend(rig.run(10));
            }
            let rest = rig.run(500);
            for arm in 0..2 {
                let last = rest[499][arm];
                println!(
                    "axis {axis} by {amount} in {seconds}: arm {arm} worst {:.3} rad, 0.1 s after {:.3}, end {:.3}; {:?} {:?}",
                    worst(&cell, arm, &all)[axis],
                    behind(&cell, arm, &rest[50][arm])[axis],
                    behind(&cell, arm, &last)[axis],
                    last.refused,
                    last.fault
                );
            }
        }
    }
    // A linear joint move, as a single command: a step of speed.
    let mut rig = Closed::new(Start::Hand, Jaws::rubber(), SensorNoise::none());
    rig.run(300);
    let mut goal = cell.arms[1].start;
    for axis in 1..7 {
        goal.0[axis] += 0.2;
    }
    rig.send(1, Motion::Joints(goal), 500);
    let all = rig.run(1000);
    println!(
        "step of speed: {:.3?} {:?} {:?}",
        worst(&cell, 1, &all),
        all[999][1].refused,
        all[999][1].fault
    );
    println!("   end: {:.3?}", behind(&cell, 1, &all[999][1]));
}

impl Closed {
    fn jaw(&mut self, arm: usize, opening: f64, periods: u32) {
        let jaw = JawCommand { opening, force_limit: 40.0, stops: Depth::One };
        let command = MoveCommand { motion: Motion::Hold, periods, jaw: Some(jaw) };
        self.links[arm].send(ServoCommand::Move { command, start: 0 }).unwrap();
    }
    /// Arm 0 holds a cube, arm 1 has closed on it too.
    fn joined(jaws: Jaws, noise: SensorNoise) -> Self {
        let cell = cell();
        let tool = world_from_tool(&cell.arms[0]);
        let tool_from_cube = Pose::from_parts(Translation3::new(0.0, 0.0, EDGE / 3.0), tool.rotation.inverse());
        let mut rig = Self::new(Start::Held { arm: 0, tool_from_cube }, jaws, noise);
        rig.jaw(0, 0.053, 1);
        rig.run(200);
        for arm in 0..2 {
            rig.links[arm].send(ServoCommand::Bias).unwrap();
        }
        rig.run(20);
        rig.jaw(1, 0.053, 1000);
        let s = rig.run(1200);
        println!("joined: {:?} jaw {:.4} {:.4} force {:.1} {:.1} wrench {:.2?} {:.2?} fault {:?}", rig.plant.verdict().both_hold, s[1199][0].jaw_opening, s[1199][1].jaw_opening, s[1199][0].jaw_force,s[1199][1].jaw_force,s[1199][0].wrench_in_tool.directions(), s[1199][1].wrench_in_tool.directions(), s[1199].map(|s| s.fault));
        rig
    }
}

fn task(frame: Frame, directions: [Direction; 6]) -> Motion {
    Motion::Task { frame, directions }
}

#[test]
fn explore_force() {
    for (name, jaws) in [("rubber", Jaws::rubber()), ("stiff", Jaws::stiff())] {
        for (b, m) in [(0.001, 20.0), (0.005, 20.0), (0.0005, 20.0), (0.001, 0.0), (0.002, 20.0)] {
            for (arms, tilts) in [(1, true), (1, false), (2, true), (2, false)] {
                let mut rig = Closed::joined(jaws, SensorNoise::default());
                // 2 mm across and 1 mm along, stiffly.
                let mut slow = [Direction::HOLD; 6];
                slow[0] = Direction::Unguarded { velocity: 0.001 };
                slow[2] = Direction::Unguarded { velocity: 0.0005 };
                rig.send(1, task(Frame::Tool, slow), 1000);
                let s = rig.run(1000);
                let stiff = s[999][1].wrench_in_tool.force.norm();
                let linear = Direction::Guarded { velocity: 0.0, admittance: b, inertia: m };
                let angular = Direction::Guarded { velocity: 0.0, admittance: 0.02 * b / 0.001, inertia: 0.5 };
                let angular = if tilts { angular } else { Direction::HOLD };
                let compliant = [linear, linear, linear, angular, angular, angular];
                for arm in 2 - arms..2 {
                    rig.send(arm, task(Frame::Tool, compliant), 5000);
                }
                let s = rig.run(3000);
                let f: Vec<f64> = s.iter().map(|s| s[1].wrench_in_tool.force.norm()).collect();
                let t: Vec<f64> = s.iter().map(|s| s[1].wrench_in_tool.torque.norm()).collect();
                let max = |v: &[f64]| v.iter().fold(0.0, |m: f64, f| m.max(*f));
                let decay = f.iter().position(|f| *f < 0.37 * stiff).unwrap_or(9999);
                println!("{name} b {b} m {m} arms {arms} tilts {tilts}: stiff {stiff:.1} N, decay {} ms, max 1st s {:.1}, last s {:.2} N, {:.3} Nm; {:?} {:?} {:?}", decay * 2, max(&f[..500]), max(&f[2500..]), max(&t[2500..]), s[2999].map(|s| s.fault.map(|f| f.to_string())), s[2999].map(|s| s.refused.map(|f| f.to_string())), rig.plant.verdict().counts);
            }
        }
    }
}

#[test]
fn explore_jaw() {
    let cell = cell();
    let tool = world_from_tool(&cell.arms[0]);
    let tool_from_cube = Pose::from_parts(Translation3::new(0.0, 0.0, EDGE / 3.0), tool.rotation.inverse());
    let mut rig = Closed::new(Start::Held { arm: 0, tool_from_cube }, Jaws::rubber(), SensorNoise::none());
    rig.jaw(0, 0.053, 1);
    for p in 0..60 {
        let s = rig.step();
        if p < 30 || p % 10 == 0 {
            println!("{p}: opening {:.5} force {:.2} {:?} z {:.5}", s[0].jaw_opening, s[0].jaw_force, rig.plant.verdict().cube, rig.plant.verdict().world_from_cube.translation.z);
        }
    }
    println!("{:?}", rig.plant.verdict().events);
}
