//! Arms that were just switched on, on the simulated plant: what they refuse, and how they find out where they are.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test")]

use rubik_robot::hw::driver::{Core, NoRecords, ServoLink, Switches, link};
use rubik_robot::hw::plant::{Plant, PlantConfig};
use rubik_robot::kinematics::ArmModel;
use rubik_robot::motion::{
    ArmFault, ArmState, Depth, JawCommand, JointPositions, Motion, MotorPositions, MoveCommand,
    MoveRefused, Synchronisation,
};
use rubik_robot::scenario;
use rubik_robot::servo::{ServoCommand, ServoConfig};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;

struct Rig {
    core: Core,
    links: Vec<ServoLink>,
    plant: Plant,
    period: u64,
    switches: Arc<Switches>,
}

impl Rig {
    /// The built-in cell; `synchronised` for each arm.
    fn new(synchronised: [bool; 2]) -> Self {
        let controller = scenario::read(Path::new("test"), "", &[]).unwrap().controller;
        let mut config = PlantConfig::new(controller.cell.clone());
        config.synchronised = synchronised;
        let mut plant = Plant::new(config, 1).unwrap();
        let configs = controller
            .cell
            .arms
            .iter()
            .zip(&controller.effectors)
            .map(|(arm, e)| ServoConfig::new(arm, e.gains.clone()))
            .collect();
        let (links, ends) = (0..2).map(|_| link()).unzip();
        let switches = Arc::new(Switches::default());
        let core = Core::new(configs, ends, Arc::clone(&switches), Box::new(NoRecords), &mut plant)
            .unwrap();
        Self { core, links, plant, period: 0, switches }
    }

    fn tick(&mut self, periods: u64) {
        for _ in 0..periods {
            self.period += 1;
            self.core.period(self.period, &mut self.plant).unwrap();
        }
    }

    fn state(&mut self, arm: usize) -> ArmState {
        *self.links[arm].state()
    }

    fn go(&mut self, arm: usize, motion: Motion, periods: u32) -> ArmState {
        let command = MoveCommand { motion, periods, jaw: None };
        self.links[arm].send(ServoCommand::Move { command, start: 0 }).unwrap();
        self.tick(u64::from(periods) + 1);
        self.state(arm)
    }

    /// Motor positions by the plant's truth.
    fn true_motors(&self, arm: usize) -> MotorPositions {
        let cell = self.plant.cell();
        let pose = self.plant.scene().arms[arm].world_from_flange;
        let base_from_flange = cell.arms[arm].world_from_base.inverse() * pose;
        let model: &ArmModel = &cell.arms[arm].model;
        let near = model.joints(&MotorPositions::default()).unwrap();
        let near = JointPositions({
            let mut q = near.0;
            // The inverse kinematics leave the track where it is told to be.
            q[0] = 0.0;
            q
        });
        model.motors(&model.inverse(&base_from_flange, &near).unwrap())
    }
}

#[test]
fn arms_synchronise_one_axis_after_the_other_and_end_at_the_true_zero() {
    let mut rig = Rig::new([false, false]);
    rig.tick(10);
    assert_eq!(rig.state(0).synchronisation, Synchronisation::No);

    for link in &mut rig.links {
        link.send(ServoCommand::Synchronise).unwrap();
    }
    let mut order: [Vec<u8>; 2] = Default::default();
    for _ in 0..120_000 {
        rig.tick(1);
        for (arm, order) in order.iter_mut().enumerate() {
            let state = rig.state(arm);
            assert_eq!(state.fault, None, "{order:?}");
            if let Synchronisation::Under { axis } = state.synchronisation
                && order.last() != Some(&axis)
            {
                order.push(axis);
            }
        }
        if (0..2).all(|arm| rig.state(arm).synchronisation == Synchronisation::Yes) {
            break;
        }
    }

    assert_eq!(order, [vec![2, 3, 4, 5, 6, 7, 0, 1], vec![2, 3, 4, 5, 6, 7, 1]]);
    rig.tick(100);
    for arm in 0..2 {
        let state = rig.state(arm);
        assert_eq!(state.synchronisation, Synchronisation::Yes);
        // All axes stand just behind their zeros: the pose of synchronisation, 3.5 rad/s for a few periods on.
        assert!(state.motors.0.iter().all(|m| (-0.1..1.0).contains(m)), "{:?}", state.motors);
        let truth = rig.true_motors(arm);
        for axis in 1..7 {
            // The joints' springs lie between shaft and flange: 0.9 rad of the shaft under the upper arm's
            // weight. A wrong zero would be a revolution off.
            let error = state.motors.0[axis] - truth.0[axis];
            assert!(error.abs() < 1.5, "arm {arm}, axis {axis}: {error}");
        }
    }

    let mut goal = rig.state(1).joints;
    goal.0[1] += 0.1;
    let moved = rig.go(1, Motion::Joints(goal), 1000);
    assert_eq!((moved.fault, moved.refused), (None, None));
    assert!((moved.joints.0[1] - goal.0[1]).abs() < 2e-3);
}

#[test]
fn before_that_only_relative_motor_moves_are_taken() {
    let mut rig = Rig::new([true, false]);
    rig.tick(10);
    let before = rig.state(1);
    assert!(before.motors.0.iter().all(|m| m.abs() < 0.1), "counters begin at zero");

    for motion in [Motion::Joints(before.joints), Motion::Pose(before.base_from_tool)] {
        assert_eq!(rig.go(1, motion, 100).refused, Some(MoveRefused::NotSynchronised));
    }
    let jaw = JawCommand { opening: 0.08, force_limit: 10.0, stops: Depth::One };
    let command = MoveCommand { motion: Motion::Hold, periods: 10, jaw: Some(jaw) };
    rig.links[1].send(ServoCommand::Move { command, start: 0 }).unwrap();
    rig.tick(11);
    assert_eq!(rig.state(1).refused, Some(MoveRefused::NotSynchronised));

    let mut by = MotorPositions::default();
    by.0[4] = -20.0;
    let moved = rig.go(1, Motion::MotorsBy(by), 500);
    assert_eq!((moved.fault, moved.refused), (None, None));
    assert!((moved.motors.0[4] + 20.0).abs() < 0.3, "{:?}", moved.motors);
    by.0[4] = -200.0;
    let refused = rig.go(1, Motion::MotorsBy(by), 50).refused;
    assert!(matches!(refused, Some(MoveRefused::TooFast { axis: 4, .. })), "{refused:?}");

    // Its partner is synchronised and takes anything.
    let goal = rig.state(0).joints;
    assert_eq!(rig.go(0, Motion::Joints(goal), 100).refused, None);
}

#[test]
fn an_emergency_stop_ends_homing_and_a_second_one_goes_on_where_it_was() {
    let mut rig = Rig::new([true, false]);
    rig.links[1].send(ServoCommand::Synchronise).unwrap();
    rig.tick(15_000);
    let Synchronisation::Under { axis } = rig.state(1).synchronisation else {
        panic!("{:?}", rig.state(1).synchronisation)
    };
    assert_ne!(axis, 2, "the first axis is done");

    rig.switches.emergency.store(true, Ordering::Release);
    rig.tick(10);
    assert_eq!(rig.state(1).fault, Some(ArmFault::EmergencyStop));
    assert_eq!(rig.state(1).synchronisation, Synchronisation::No);
    rig.switches.emergency.store(false, Ordering::Release);
    rig.links[1].send(ServoCommand::Reset).unwrap();
    rig.links[1].send(ServoCommand::Synchronise).unwrap();
    rig.tick(3);

    let Synchronisation::Under { axis: now } = rig.state(1).synchronisation else {
        panic!("{:?}", rig.state(1).synchronisation)
    };
    assert_eq!(now, axis);
}
