//! Homing on the simulated plant: commands that an arm refuses before it is synchronised, and the
//! search of each axis for its zero.

use rubik_robot::emergency_stop::EmergencyStop;
use rubik_robot::hw::driver::{Core, NoRecords, ServoLink, Switches, link_at};
use rubik_robot::hw::plant::{Plant, PlantConfig};
use rubik_robot::kinematics::ArmModel;
use rubik_robot::motion::{
    ArmFault, ArmState, Depth, Direction, Frame, JawCommand, JointPositions, Motion,
    MotorPositions, MoveCommand, MoveRefused, Synchronisation,
};
use rubik_robot::servo::period::Length;
use rubik_robot::servo::{ServoCommand, ServoConfig};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Both arms of the built-in cell with their servos, on the simulated plant.
struct Rig {
    core: Core,
    links: Vec<ServoLink>,
    plant: Plant,
    period: u64,
    switches: Arc<Switches>,
    stop: EmergencyStop,
}

impl Rig {
    /// Makes a rig with the built-in cell. `synchronised` says for each arm whether it begins
    /// synchronised.
    fn new(synchronised: [bool; 2]) -> Self {
        Self::at(synchronised, Length::default())
    }

    /// Makes a rig as [`Rig::new`] does, with periods of this length.
    fn at(synchronised: [bool; 2], length: Length) -> Self {
        let controller = rubik_robot::tasks::read(Path::new("test"), "", &[]).unwrap().controller;
        let mut config = PlantConfig::new(controller.cell.clone());
        config.synchronised[..2].copy_from_slice(&synchronised);
        config.period = length;
        let mut plant = Plant::new(config, 1).unwrap();
        let configs = controller
            .cell
            .arms
            .iter()
            .zip(&controller.effectors)
            .map(|(arm, e)| ServoConfig {
                period: length,
                ..ServoConfig::new(arm, e.gains.clone())
            })
            .collect();
        let (links, ends) = (0..2).map(|_| link_at(length)).unzip();
        let stop = EmergencyStop::default();
        let switches = Arc::new(Switches::new(stop.signal()));
        let core = Core::new(configs, ends, Arc::clone(&switches), Box::new(NoRecords), &mut plant)
            .unwrap();
        Self { core, links, plant, period: 0, switches, stop }
    }

    /// Runs a number of servo periods.
    fn tick(&mut self, periods: u64) {
        for _ in 0..periods {
            self.period += 1;
            self.core.period(self.period, &mut self.plant).unwrap();
        }
    }

    /// Returns the last state of an arm.
    fn state(&mut self, arm: usize) -> ArmState {
        *self.links[arm].state()
    }

    /// Moves an arm for this number of periods; returns its state after them.
    fn go(&mut self, arm: usize, motion: Motion, periods: u32) -> ArmState {
        let command = MoveCommand { motion, periods, jaw: None };
        self.links[arm].send(ServoCommand::Move { command, start: 0 }).unwrap();
        self.tick(u64::from(periods) + 1);
        self.state(arm)
    }

    /// Returns the motor positions of an arm that follow from the true pose of its flange in the
    /// plant.
    fn true_motors(&self, arm: usize) -> MotorPositions {
        let cell = self.plant.cell();
        let pose = self.plant.scene().arms[arm].world_from_flange;
        let base_from_flange = cell.arms[arm].world_from_base.inverse() * pose;
        let model: &ArmModel = &cell.arms[arm].model;
        let near = model.joints(&MotorPositions::default()).unwrap();
        let near = JointPositions({
            let mut q = near.0;
            // The inverse kinematics keep the track position that they get, and the comparison
            // leaves axis 0 out.
            q[0] = 0.0;
            q
        });
        model.motors(&model.inverse(&base_from_flange, &near).unwrap())
    }
}

#[test]
fn homing_moves_axes_in_turn_to_true_zero() {
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
        // Each axis stops just past its zero, because it moves on at 3.5 rad/s for a few periods.
        assert!(state.motors.0.iter().all(|m| (-0.1..1.0).contains(m)), "{:?}", state.motors);
        let truth = rig.true_motors(arm);
        for axis in 1..7 {
            // The springs of the joints lie between shaft and flange: the weight of the upper arm
            // is worth 0.9 rad of the shaft. A wrong zero would be off by a revolution.
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
fn arm_before_homing_takes_only_relative_moves() {
    let mut rig = Rig::new([true, false]);
    rig.tick(10);
    let before = rig.state(1);
    assert!(before.motors.0.iter().all(|m| m.abs() < 0.1), "counters begin at zero");

    let directions = [Direction::HOLD; 6];
    for motion in [
        Motion::Joints(before.joints),
        Motion::Pose(before.base_from_tool),
        Motion::Task { frame: Frame::Tool, directions },
    ] {
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

    // Its partner is synchronised and takes a motion to a place.
    let mut goal = rig.state(0).joints;
    goal.0[1] += 0.05;
    rig.go(0, Motion::Joints(goal), 500);
    rig.tick(200);
    let partner = rig.state(0);
    assert_eq!((partner.fault, partner.refused), (None, None));
    assert!((partner.joints.0[1] - goal.0[1]).abs() < 2e-3, "{:?}", partner.joints);
}

#[test]
fn arm_on_hold_refuses_to_begin_homing() {
    let mut rig = Rig::new([true, false]);
    rig.tick(10);
    rig.switches.hold.store(true, Ordering::Release);
    rig.tick(1);
    let before = rig.state(1).motors;

    rig.links[1].send(ServoCommand::Synchronise).unwrap();
    rig.tick(200);

    let state = rig.state(1);
    assert_eq!(state.synchronisation, Synchronisation::No);
    assert_eq!(state.refused, Some(MoveRefused::PartnerStopped));
    assert!(state.motors.0.iter().zip(before.0).all(|(m, b)| (m - b).abs() < 0.05));

    rig.switches.hold.store(false, Ordering::Release);
    rig.links[1].send(ServoCommand::Synchronise).unwrap();
    rig.tick(200);
    assert!(matches!(rig.state(1).synchronisation, Synchronisation::Under { .. }));
}

/// An emergency stop ends homing. The next command begins at the axis that the stop interrupted.
#[test]
fn homing_continues_at_interrupted_axis_after_emergency_stop() {
    let mut rig = Rig::new([true, false]);
    rig.links[1].send(ServoCommand::Synchronise).unwrap();
    rig.tick(15_000);
    let Synchronisation::Under { axis } = rig.state(1).synchronisation else {
        panic!("{:?}", rig.state(1).synchronisation)
    };
    assert_ne!(axis, 2, "the first axis is done");

    rig.stop.button().press();
    rig.tick(10);
    assert_eq!(rig.state(1).fault, Some(ArmFault::EmergencyStop));
    assert_eq!(rig.state(1).synchronisation, Synchronisation::No);
    rig.stop.release();
    // Both arms are reset: an arm does not home while its partner is stopped by a fault.
    for link in &mut rig.links {
        link.send(ServoCommand::Reset).unwrap();
    }
    rig.tick(2);
    rig.links[1].send(ServoCommand::Synchronise).unwrap();
    rig.tick(3);

    let Synchronisation::Under { axis: now } = rig.state(1).synchronisation else {
        panic!("{:?}", rig.state(1).synchronisation)
    };
    assert_eq!(now, axis);
}

/// For each length of the period a motion lasts equally long and ends at the same place.
#[test]
fn servo_period_changes_neither_motion_duration_nor_goal() {
    for milliseconds in [0.5, 1.0, 2.0, 4.0] {
        let length = Length::of_seconds(milliseconds * 1e-3);
        let mut rig = Rig::at([true, true], length);
        rig.tick(length.first_after(100));
        let start = rig.state(1);
        let mut goal = start.desired_joints;
        goal.0[1] += 0.2;
        goal.0[5] += 0.2;
        // Commands as an EDP sends them: macrosteps of 16 ms along a smooth course of 1.6 s, each
        // sent after the answer to the one before.
        let mut behind = 0.0_f64;
        for step in 1..=100 {
            let x = f64::from(step) / 100.0;
            let share = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x);
            let mut way = start.desired_joints;
            for (q, to) in way.0.iter_mut().zip(&goal.0) {
                *q += share * (to - *q);
            }
            let command = MoveCommand { motion: Motion::Joints(way), periods: 8, jaw: None };
            let ticket = rig.links[1].send(ServoCommand::Move { command, start: 0 }).unwrap();
            let early = rig.links[1].early();
            loop {
                rig.tick(1);
                let state = rig.state(1);
                behind = behind.max((state.desired_joints.0[1] - state.joints.0[1]).abs());
                if rig.links[1].is_done(ticket, early) {
                    break;
                }
            }
        }
        let end = rig.state(1);
        assert_eq!((end.fault, end.refused), (None, None), "{milliseconds} ms");
        let lasted = end.command_end - start.period;
        // The course of 1.6 s is 800 periods of 2 ms.
        assert!((799..=810).contains(&lasted), "{milliseconds} ms: {lasted} periods of 2 ms");
        rig.tick(length.first_after(250));
        let rest = rig.state(1);
        println!("{milliseconds} ms: {behind:.4} rad behind on the way");
        assert!(behind < 0.012, "{milliseconds} ms: {behind} rad behind");
        for axis in [1, 5] {
            let error = rest.joints.0[axis] - goal.0[axis];
            assert!(error.abs() < 1e-3, "{milliseconds} ms, axis {axis}: {error}");
        }
        let seen = rig.plant.scene().period;
        assert!(seen.abs_diff(rest.period) <= 2, "frames and states count alike: {seen}");
    }
}
