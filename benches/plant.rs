//! Time of a period of the whole simulated cell: with both arms at rest, and with both hands on the
//! cube while one of them turns a layer.

use hdrhistogram::Histogram;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rubik_robot::cell::{Arm, Cell, CubeSpec, HandZone};
use rubik_robot::hw::driver::{Core, NoRecords, ServoLink, Switches, link};
use rubik_robot::hw::plant::{Plant, PlantConfig, Start};
use rubik_robot::hw::port::{Port, PortFault};
use rubik_robot::motion::{
    Depth, Direction, Frame, JawCommand, JointPositions, Motion, MoveCommand,
};
use rubik_robot::servo::io::{ArmDrive, ArmReading};
use rubik_robot::servo::{ServoCommand, ServoConfig};
use rubik_robot::spatial::Pose;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;
use std::time::Instant;

mod rig;

/// Edge of the cube (m).
const EDGE: f64 = 0.057;

/// Measures and prints the time of a period of the cell at rest and while a layer turns.
fn main() {
    if !rig::is_selected("plant") {
        return;
    }
    let rest = best(|| {
        let mut cell = Rig::new(Start::Hand);
        cell.run(200);
        cell.measure(2000)
    });
    let turning = best(|| {
        let mut cell = Rig::holding();
        let times = cell.measure(1500);
        assert!(cell.timed.plant.turned().abs() > 0.3, "the layer turns");
        times
    });
    let lines = [("arms at rest", &rest), ("both hold the cube, one turns", &turning)];
    if rig::json() {
        let fields = [
            ("rest_p50_us", Some(rig::us(&rest, 0.5))),
            ("turning_p50_us", Some(rig::us(&turning, 0.5))),
            ("turning_p99_us", Some(rig::us(&turning, 0.99))),
        ];
        println!("{}", rig::object(&fields));
        return;
    }
    println!("plant: a period of the whole cell, us, best of 3 runs");
    for (name, times) in lines {
        println!(
            "  {name:32} p50 {:6.2}  p99 {:6.2}  mean {:6.2}",
            rig::us(times, 0.5),
            rig::us(times, 0.99),
            times.mean() / 1000.0
        );
    }
}

/// Calls `run` three times and returns the histogram with the least median, because other work on
/// the machine only adds time.
fn best(mut run: impl FnMut() -> Histogram<u64>) -> Histogram<u64> {
    let mut runs: Vec<_> = (0..3).map(|_| run()).collect();
    runs.sort_by_key(|times| times.value_at_quantile(0.5));
    runs.swap_remove(0)
}

/// Port that measures the time of each exchange with the plant.
struct Timed {
    plant: Plant,
    times: Histogram<u64>,
}

impl Port for Timed {
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        let begun = Instant::now();
        let done = self.plant.exchange(period, drives, readings);
        self.times.saturating_record(begun.elapsed().as_nanos() as u64);
        done
    }
}

/// Both arms with their servos, opposite each other.
struct Rig {
    core: Core,
    links: Vec<ServoLink>,
    timed: Timed,
    period: u64,
}

impl Rig {
    /// Makes a rig whose plant begins with the cube at the place `start`, without any command yet.
    fn new(start: Start) -> Self {
        let cell = cell();
        let gains = rig::configs()[0].gains.clone();
        let configs: Vec<_> =
            cell.arms.iter().map(|arm| ServoConfig::new(arm, gains.clone())).collect();
        let config = PlantConfig { start, ..PlantConfig::new(cell) };
        let plant = Plant::new(config, 1).unwrap_or_else(|e| unreachable!("two arms: {e}"));
        let mut timed = Timed { plant, times: rig::histogram() };
        let (links, ends) = (0..2).map(|_| link()).unzip();
        let switches = Arc::new(Switches::default());
        let core = Core::new(configs, ends, switches, Box::new(NoRecords), &mut timed)
            .unwrap_or_else(|e| unreachable!("two arms: {e}"));
        Self { core, links, timed, period: 0 }
    }

    /// Makes a rig in which arm 0 holds the cube and is compliant in its three translations, while
    /// arm 1 turns the outer layer that it has grasped.
    fn holding() -> Self {
        let tool = world_from_tool(&cell().arms[0]);
        let ahead = Translation3::new(0.0, 0.0, EDGE / 3.0);
        let tool_from_cube = Pose::from_parts(ahead, tool.rotation.inverse());
        let mut rig = Self::new(Start::Held { arm: 0, tool_from_cube });
        // The forces settle before the sensors are zeroed, and the jaws close before a layer is
        // turned.
        rig.jaw(0, 1);
        rig.run(200);
        for link in &mut rig.links {
            let _ = link.send(ServoCommand::Bias);
        }
        rig.run(20);
        rig.jaw(1, 1000);
        rig.run(1200);
        assert!(rig.timed.plant.verdict().both_hold, "both hold the cube");
        let yields = Direction::Guarded { velocity: 0.0, admittance: 1e-3, inertia: 20.0 };
        let hold = Direction::HOLD;
        rig.send(0, [yields, yields, yields, hold, hold, hold]);
        let turn = Direction::Guarded { velocity: 0.43, admittance: 0.05, inertia: 0.5 };
        rig.send(1, [hold, hold, hold, hold, hold, turn]);
        rig.run(300);
        rig
    }

    /// Commands an arm to a position-force motion in the frame of its tool for 20 s.
    fn send(&mut self, arm: usize, directions: [Direction; 6]) {
        let motion = Motion::Task { frame: Frame::Tool, directions };
        let command = MoveCommand { motion, periods: 10_000, jaw: None };
        let _ = self.links[arm].send(ServoCommand::Move { command, start: 0 });
    }

    /// Commands an arm to hold its pose for `periods` periods while its jaw closes on the cube.
    fn jaw(&mut self, arm: usize, periods: u32) {
        let jaw = JawCommand { opening: 0.053, force_limit: 40.0, stops: Depth::One };
        let command = MoveCommand { motion: Motion::Hold, periods, jaw: Some(jaw) };
        let _ = self.links[arm].send(ServoCommand::Move { command, start: 0 });
    }

    /// Runs a number of servo periods of both arms.
    fn run(&mut self, periods: u32) {
        for _ in 0..periods {
            self.period += 1;
            let done = self.core.period(self.period, &mut self.timed);
            assert_eq!(done, Ok(()));
        }
    }

    /// Runs a number of servo periods; returns the times of their exchanges with the plant (ns).
    fn measure(&mut self, periods: u32) -> Histogram<u64> {
        self.timed.times.reset();
        self.run(periods);
        self.timed.times.clone()
    }
}

/// Makes a cell in which the tools of both arms face each other at the arms' start poses. The base
/// of arm 1 is rotated by half a turn and moved until the two tool points are two thirds of the
/// cube's edge apart, so that a cube between them is in both hands.
fn cell() -> Cell {
    let q = FRAC_PI_2;
    let starts = [[0.5, 0.0, -q, 0.0, q, q, -q], [0.0, 0.0, -q, 0.0, q, q, 0.0]];
    let mut arms: Vec<Arm> = rig::configs()
        .into_iter()
        .zip(starts)
        .map(|(config, start)| {
            let mut gripper = config.gripper;
            (gripper.finger_width, gripper.finger_tip, gripper.palm) = (0.012, 0.0075, 0.0425);
            gripper.amperes_per_newton = 0.0018;
            let mut sensor = config.sensor;
            sensor.weight = 10.8;
            Arm {
                name: String::new(),
                model: config.model,
                world_from_base: Pose::identity(),
                flange_from_tool: config.flange_from_tool,
                gripper,
                sensor,
                start: JointPositions(start),
            }
        })
        .collect();
    let meeting = world_from_tool(&arms[0]).translation.vector + Vector3::x() * (2.0 * EDGE / 3.0);
    let half_turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI);
    arms[1].world_from_base = Pose::from_parts(Translation3::identity(), half_turn);
    let miss = meeting - world_from_tool(&arms[1]).translation.vector;
    arms[1].world_from_base.translation.vector = miss;
    Cell {
        arms,
        cameras: Vec::new(),
        cube: CubeSpec { edge: EDGE, mass: 0.1 },
        table_height: 0.6,
        hand: HandZone {
            world_from_cube: Pose::translation(0.75, 0.3, 1.3),
            half_extent: Vector3::repeat(0.05),
        },
        keeper: rubik_robot::cube::Keeper::Person,
    }
}

/// Returns the pose of an arm's tool in the world when the arm's joints are at `arm.start`.
fn world_from_tool(arm: &Arm) -> Pose {
    arm.world_from_base * arm.model.base_from_flange(&arm.start) * arm.flange_from_tool
}
