//! Single periods of one arm's servo, on motors that follow their set values to the increment.

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rubik_robot::hw::port::Port;
use rubik_robot::motion::{
    ArmFault, ArmState, Depth, Direction, Frame, JawCommand, Motion, MotorPositions, MoveCommand,
    MoveRefused, PERIOD,
};
use rubik_robot::servo::io::{ArmDrive, ArmReading, Outside};
use rubik_robot::servo::{ArmServo, ForceSettings, ServoCommand, ServoConfig};
use rubik_robot::spatial::{Pose, Wrench};
use std::f64::consts::TAU;

use crate::servo_rig::{Motors, START, config, first_reading};

/// Direction that yields to a force and stands still without one.
const COMPLIANT: Direction = Direction::Guarded { velocity: 0.0, admittance: 0.001, inertia: 20.0 };

/// Arm whose motors are at the set values of the period before.
struct Ideal {
    config: ServoConfig,
    servo: ArmServo,
    reading: ArmReading,
    drive: ArmDrive,
    period: u64,
    /// Spring that pulls the tool towards a rest position, in base axes: stiffness (N/m), position
    /// (m).
    spring: Option<(f64, Vector3<f64>)>,
}

impl Ideal {
    /// Makes an arm that rests at [`START`] and has no command.
    fn new() -> Self {
        let config = config();
        let reading = first_reading();
        let servo = ArmServo::new(config.clone(), &reading);
        Self { config, servo, reading, drive: ArmDrive::OFF, period: 0, spring: None }
    }

    /// Runs a period in which the servo gets this command; returns the state of the arm.
    fn step(&mut self, command: Option<ServoCommand>) -> ArmState {
        self.period += 1;
        let (drive, state) = self.servo.step(self.period, &self.reading, command.as_ref());
        self.drive = drive;
        if drive.enabled {
            self.reading.counts =
                counts(&self.config, &self.config.model.motors(&state.desired_joints));
        }
        if let Some((stiffness, rest)) = self.spring {
            let tool = state.desired_base_from_tool;
            let force = -stiffness * (tool.translation.vector - rest);
            // The force acts on the tool point; the sensor is behind it on the same axis.
            let in_tool = Wrench { force: tool.rotation.inverse() * force, ..Wrench::default() };
            let sensor_from_tool =
                self.config.sensor.flange_from_sensor.inverse() * self.config.flange_from_tool;
            self.reading.wrench_on_sensor = in_tool.moved(&sensor_from_tool);
        }
        state
    }

    /// Runs a period as [`Ideal::step`] does, while the other arm is stopped.
    fn stand_by(&mut self, command: Option<ServoCommand>) -> ArmState {
        let outside = Outside { stands_by: true, ..Outside::default() };
        self.servo.apply_outside(self.period + 1, &outside);
        self.step(command)
    }

    /// Sends a motion of `periods` periods and runs the servo that long. Returns the state of the
    /// arm in each period.
    fn run(&mut self, motion: Motion, periods: u32) -> Vec<ArmState> {
        let first = self.step(Some(go(motion, periods)));
        let mut states = vec![first];
        states.extend((1..periods).map(|_| self.step(None)));
        states
    }
}

/// Returns the encoder counts at these motor positions.
fn counts(config: &ServoConfig, motors: &MotorPositions) -> [i64; 7] {
    std::array::from_fn(|i| (motors.0[i] * config.model.increments[i] / TAU).round() as i64)
}

/// Returns the command of a motion that lasts this number of periods.
fn go(motion: Motion, periods: u32) -> ServoCommand {
    ServoCommand::Move { command: MoveCommand { motion, periods, jaw: None }, start: 0 }
}

/// Returns a motion along the axes of `frame` that holds all directions except those in `changes`.
fn task(frame: Frame, changes: &[(usize, Direction)]) -> Motion {
    let mut directions = [Direction::HOLD; 6];
    for (axis, direction) in changes {
        directions[*axis] = *direction;
    }
    Motion::Task { frame, directions }
}

/// Returns a direction with this velocity (m/s or rad/s), whatever the force.
fn unguarded(velocity: f64) -> Direction {
    Direction::Unguarded { velocity }
}

/// Returns the largest step of any motor between consecutive states (rad).
fn largest_step(config: &ServoConfig, states: &[ArmState]) -> f64 {
    states
        .windows(2)
        .flat_map(|w| {
            let (a, b) = (
                config.model.motors(&w[0].desired_joints).0,
                config.model.motors(&w[1].desired_joints).0,
            );
            (0..7).map(move |i| (b[i] - a[i]).abs())
        })
        .fold(0.0, f64::max)
}

/// Returns the distance of two poses: of their places (m), and of their orientations (rad).
fn apart(a: &Pose, b: &Pose) -> (f64, f64) {
    ((a.translation.vector - b.translation.vector).norm(), a.rotation.angle_to(&b.rotation))
}

/// Motions of joints, of motors and to a pose reach their goals in their last period.
#[test]
fn motions_reach_their_goals_in_last_period() {
    let mut arm = Ideal::new();
    let mut goal = START;
    goal.0[1] += 0.1;
    goal.0[0] -= 0.02;

    let states = arm.run(Motion::Joints(goal), 200);
    assert!((states[198].desired_joints.0[1] - goal.0[1]).abs() > 1e-4);
    assert_eq!(states[199].desired_joints, goal);
    assert_eq!(states[199].command_end, 200);

    let (here, there) = (states[199].desired_joints, arm.config.model.motors(&START));
    let here = arm.config.model.motors(&here);
    let by = MotorPositions(std::array::from_fn(|i| there.0[i] - here.0[i]));
    let way = arm.run(Motion::MotorsBy(by), 200);
    let end = way[199];
    let off = |state: &ArmState| {
        let pairs = state.desired_joints.0.into_iter().zip(START.0);
        pairs.map(|(joint, goal)| (joint - goal).abs()).fold(0.0, f64::max)
    };
    assert!(off(&way[198]) > 1e-4 && off(&end) < 1e-12);

    let pose = end.desired_base_from_tool
        * Pose::from_parts(
            Translation3::new(0.02, -0.01, 0.03),
            UnitQuaternion::from_euler_angles(0.1, 0.05, -0.1),
        );
    let way = arm.run(Motion::Pose(pose), 300);
    let (d, _) = apart(&way[298].desired_base_from_tool, &pose);
    assert!(d > 1e-4);
    let (d, a) = apart(&way[299].desired_base_from_tool, &pose);
    assert!(d < 1e-12 && a < 1e-7);
    let reached =
        arm.config.model.base_from_flange(&way[299].desired_joints) * arm.config.flange_from_tool;
    let (d, a) = apart(&reached, &pose);
    assert!(d < 1e-10 && a < 1e-7);
    // The path is a straight line at an even speed, so its point at half the time is the mean of
    // the ends.
    let middle = 0.5 * (end.desired_base_from_tool.translation.vector + pose.translation.vector);
    assert!((way[149].desired_base_from_tool.translation.vector - middle).norm() < 1e-12);
}

#[test]
fn task_motion_follows_the_axes_of_its_frame() {
    let mut arm = Ideal::new();
    let start = arm.step(None).desired_base_from_tool;

    let along_tool = arm.run(task(Frame::Tool, &[(2, unguarded(0.02))]), 500)[499];
    let wanted = start * Pose::translation(0.0, 0.0, 0.02);
    let (d, a) = apart(&along_tool.desired_base_from_tool, &wanted);
    assert!(d < 1e-10 && a < 1e-7, "{d} {a}");

    let along_base = arm.run(task(Frame::Base, &[(2, unguarded(0.02))]), 500)[499];
    let wanted = Translation3::new(0.0, 0.0, 0.02) * along_tool.desired_base_from_tool;
    let (d, a) = apart(&along_base.desired_base_from_tool, &wanted);
    assert!(d < 1e-10 && a < 1e-7, "{d} {a}");
}

#[test]
fn commands_sent_two_periods_early_give_constant_speed() {
    let mut arm = Ideal::new();
    let motion = task(Frame::Base, &[(0, unguarded(0.05))]);
    let mut states = Vec::new();

    for period in 1..=60u64 {
        // Each macrostep has 20 periods and is sent when two periods of the one before are left.
        let command = (period == 1 || period % 20 == 18).then(|| go(motion, 20));
        states.push(arm.step(command));
    }

    for pair in states.windows(2) {
        let moved = pair[1].desired_base_from_tool.translation.x
            - pair[0].desired_base_from_tool.translation.x;
        assert!((moved - 0.05 * PERIOD).abs() < 1e-9, "period {}: {moved}", pair[1].period);
    }
    assert_eq!(states[16].command_end, 20);
    assert_eq!(states[17].command_end, 40, "the end of the command that was accepted last");
}

#[test]
fn new_command_replaces_running_one_at_once() {
    let mut arm = Ideal::new();
    arm.step(Some(go(task(Frame::Base, &[(0, unguarded(0.05))]), 500)));
    for _ in 0..50 {
        arm.step(None);
    }

    let held = arm.step(Some(go(Motion::Hold, 1)));
    let later = arm.step(None);

    assert_eq!(held.desired_base_from_tool, later.desired_base_from_tool);
    assert_eq!(held.command_end, held.period);
}

#[test]
fn command_with_start_period_begins_in_it() {
    let mut arm = Ideal::new();
    let still = arm.step(None);
    let command =
        MoveCommand { motion: task(Frame::Base, &[(0, unguarded(0.05))]), periods: 10, jaw: None };
    let mut states = vec![arm.step(Some(ServoCommand::Move { command, start: 30 }))];

    states.extend((0..50).map(|_| arm.step(None)));

    for state in &states {
        let moved =
            state.desired_base_from_tool.translation.x - still.desired_base_from_tool.translation.x;
        let periods = state.period.saturating_sub(29).min(10) as f64;
        assert!((moved - periods * 0.05 * PERIOD).abs() < 1e-9, "period {}", state.period);
        assert_eq!(state.command_end, 39);
    }
}

#[test]
fn position_and_force_motion_switch_without_jump() {
    let mut arm = Ideal::new();
    let rest = arm.step(None).desired_base_from_tool.translation.vector;
    arm.spring = Some((2e3, rest));
    let mut states = arm.run(task(Frame::Base, &[(0, COMPLIANT), (1, unguarded(0.01))]), 150);
    let ahead = states[149].desired_base_from_tool * Pose::translation(0.0, 0.0, 0.002);
    states.extend(arm.run(Motion::Pose(ahead), 100));
    states.extend(arm.run(task(Frame::Tool, &[(2, COMPLIANT)]), 150));
    let joints = states[399].desired_joints;
    states.extend(arm.run(Motion::Joints(joints), 10));
    states.extend(arm.run(task(Frame::Base, &[(1, unguarded(-0.01))]), 50));

    assert!(states.iter().all(|s| s.refused.is_none() && s.fault.is_none()));
    // The motions above stay below 20 mm/s. With 4 rad of a joint per metre and a gear of 158 no
    // motor exceeds 13 rad/s, which is 0.025 rad in a period.
    assert!(largest_step(&arm.config, &states) < 0.06, "{}", largest_step(&arm.config, &states));
}

#[test]
fn tool_change_affects_only_later_motions() {
    let mut arm = Ideal::new();
    let before = arm.step(None);
    let longer = Pose::from_parts(
        Translation3::new(0.01, 0.0, 0.30),
        UnitQuaternion::from_euler_angles(0.2, 0.0, 0.0),
    );

    let after = arm.step(Some(ServoCommand::SetTool(longer)));
    assert!((0..7).all(|i| (after.desired_joints.0[i] - before.desired_joints.0[i]).abs() < 1e-12));
    let flange = before.desired_base_from_tool * arm.config.flange_from_tool.inverse();
    let (d, a) = apart(&after.desired_base_from_tool, &(flange * longer));
    assert!(d < 1e-10 && a < 1e-7);

    // A rotation about x of the new tool leaves the new tool point in its place.
    let turned = arm.run(task(Frame::Tool, &[(3, unguarded(0.2))]), 200)[199];
    let (d, a) = apart(&turned.desired_base_from_tool, &after.desired_base_from_tool);
    assert!(d < 1e-12 && (a - 0.08).abs() < 1e-9, "{d} {a}");

    // The rotation ended at speed, so a hold brings the arm to rest first.
    let stands = arm.run(Motion::Hold, 250)[249];
    let broken = arm.step(Some(ServoCommand::SetTool(Pose::translation(f64::NAN, 0.0, 0.0))));
    assert_eq!(broken.refused, Some(MoveRefused::NotANumber));
    assert_eq!(broken.desired_base_from_tool, stands.desired_base_from_tool);
}

#[test]
fn tool_change_in_motion_causes_no_jump() {
    let mut arm = Ideal::new();
    let goal = arm.step(None).desired_base_from_tool * Pose::translation(0.05, 0.0, 0.0);
    let mut states = vec![arm.step(Some(go(Motion::Pose(goal), 400)))];
    states.extend((0..199).map(|_| arm.step(None)));
    let longer = Pose::translation(0.0, 0.0, 0.26);
    states.push(arm.step(Some(ServoCommand::SetTool(longer))));
    states.extend((0..200).map(|_| arm.step(None)));

    assert!(largest_step(&arm.config, &states) < 0.1);
    let (d, _) = apart(&states[400].desired_base_from_tool, &goal);
    assert!(d < 1e-9, "{d}");
}

#[test]
fn impossible_commands_are_refused_and_arm_holds() {
    let mut arm = Ideal::new();
    let start = arm.step(None);
    let mut too_far = START;
    too_far.0[4] = 2.5;
    let mut fast = START;
    fast.0[1] += 1.0;
    let mut no_number = START;
    no_number.0[3] = f64::NAN;
    let nan = Direction::Guarded { velocity: 0.0, admittance: f64::NAN, inertia: 0.0 };

    for (motion, periods, why) in [
        (Motion::Joints(too_far), 1000, "joint 4"),
        (Motion::Joints(fast), 100, "faster"),
        (Motion::Joints(no_number), 100, "not a finite number"),
        (Motion::Pose(Pose::translation(3.0, 0.0, 1.0)), 1000, "out of reach"),
        (task(Frame::Base, &[(0, nan)]), 1000, "not a finite number"),
        (task(Frame::Base, &[(0, unguarded(f64::INFINITY))]), 1000, "not a finite number"),
    ] {
        let refused = arm.step(Some(go(motion, periods)));
        let text = refused.refused.map(|r| r.to_string()).unwrap_or_default();
        assert!(text.contains(why), "{motion:?}: {text}");
        assert_eq!(refused.desired_joints, start.desired_joints, "{why}");
        assert!(refused.command_end <= refused.period, "{why}");
        assert_eq!(arm.step(None).desired_joints, start.desired_joints, "{why}");
    }
    let fine = arm.step(Some(go(Motion::Hold, 3)));
    assert_eq!(fine.refused, None, "a new command clears the old refusal");
}

#[test]
fn motion_leaving_joint_range_stops_inside_it() {
    let mut arm = Ideal::new();

    // Along x of the base the arm runs out of its range.
    let states = arm.run(task(Frame::Base, &[(0, unguarded(0.15))]), 4000);

    let broken =
        states.iter().position(|s| s.refused.is_some()).expect("the motion reaches a limit");
    assert!(broken > 100);
    let (at, end) = (&states[broken], &states[3999]);
    assert_eq!(at.desired_joints, end.desired_joints);
    assert_eq!(at.refused, end.refused);
    assert!(at.command_end <= at.period);
    assert!(arm.config.model.check(&end.desired_joints).is_ok());
    assert!(end.fault.is_none());
}

/// A hold brings motors of more than 60 rad/s to rest within 0.2 s, without a jump of speed.
#[test]
fn hold_stops_fast_motion_smoothly() {
    let mut arm = Ideal::new();
    let model = arm.config.model.clone();
    let mut states = arm.run(task(Frame::Base, &[(5, unguarded(0.8))]), 200);
    let motors = |state: &ArmState| model.motors(&state.desired_joints).0;
    let speed = |a: &ArmState, b: &ArmState| {
        let pairs = motors(a).into_iter().zip(motors(b));
        pairs.map(|(a, b)| (b - a).abs() / PERIOD).fold(0.0, f64::max)
    };
    let fast = speed(&states[198], &states[199]);
    assert!(fast > 60.0, "{fast} rad/s");

    states.push(arm.step(Some(go(Motion::Hold, 500))));
    states.extend((0..100).map(|_| arm.step(None)));

    let end = &states[states.len() - 2..];
    let changes = states[198..].windows(3).map(|w| speed(&w[0], &w[1]) - speed(&w[1], &w[2]));
    assert!(changes.fold(0.0, f64::max) < 0.15 * fast, "the arm was stopped abruptly");
    assert!(speed(&end[0], &end[1]) < 0.1, "the arm continues");
    assert!(states.iter().all(|state| state.fault.is_none() && state.refused.is_none()));
}

/// If the other arm has stopped, the servo drops the commanded velocity of a guarded motion. The
/// motors slow down as gently as a wrist that turns a layer can.
#[test]
fn arm_slows_gently_when_its_partner_stops() {
    let mut arm = Ideal::new();
    let config = arm.config.clone();
    let speed = |pair: &[ArmState]| largest_step(&config, pair) / PERIOD;
    let turn = Direction::Guarded { velocity: 0.8, admittance: 0.3, inertia: 0.1 };
    // The partner stops in the middle of the motion.
    let mut states = vec![arm.step(Some(go(task(Frame::Tool, &[(5, turn)]), 400)))];
    states.extend((1..200).map(|_| arm.step(None)));
    let fast = speed(&states[198..]);
    assert!(fast > 60.0, "{fast} rad/s");

    states.extend((0..200).map(|_| arm.stand_by(None)));

    let changes = states[198..].windows(3).map(|w| speed(&w[..2]) - speed(&w[1..]));
    let deceleration = changes.fold(0.0, f64::max) / PERIOD;
    // 12.5 1/s is the rate of a time constant of 80 ms; one of 35 ms has 28.
    assert!(deceleration < 13.0 * fast, "{deceleration} rad/s2 from {fast} rad/s");
    assert!(speed(&states[states.len() - 2..]) < 0.02 * fast, "the arm continues");
}

/// An arm under force control whose partner stops yields to forces for half a second, then it
/// holds. It refuses motions as long as the partner is stopped.
#[test]
fn stopped_partner_makes_arm_yield_then_refuse_motions() {
    let mut arm = Ideal::new();
    let config = arm.config.clone();
    let yields = Direction::Guarded { velocity: 0.0, admittance: 0.3, inertia: 0.1 };
    let turn = task(Frame::Tool, &[(5, yields)]);
    arm.run(turn, 10);
    arm.step(Some(go(turn, 2000)));
    arm.reading.wrench_on_sensor = Wrench::from_directions([0.0, 0.0, 0.0, 0.0, 0.0, 0.2]);

    let states: Vec<_> = (0..300).map(|_| arm.stand_by(None)).collect();

    // The yielding lasts for 250 periods. The torque of 0.2 Nm turns the tool by 0.06 rad/s.
    let roll = |state: &ArmState| state.desired_joints.0[6];
    let turned = (roll(&states[249]) - roll(&states[200])).abs();
    assert!((turned - 49.0 * PERIOD * 0.06).abs() < 2e-4, "{turned} rad");
    assert_eq!(largest_step(&config, &states[252..]), 0.0, "the arm holds");
    let refused = Some(MoveRefused::PartnerStopped);
    assert!(states.iter().all(|state| state.refused == refused && state.fault.is_none()));

    let ordered = arm.stand_by(Some(go(turn, 100)));
    assert_eq!((ordered.refused, arm.stand_by(None).refused), (refused, refused));
    arm.servo.apply_outside(arm.period + 1, &Outside::default());
    assert_eq!(arm.step(Some(go(turn, 100))).refused, None, "the partner is back");
    assert!(roll(&arm.step(None)) != roll(&states[299]));
}

#[test]
fn too_fast_task_motion_is_refused() {
    let mut arm = Ideal::new();

    let states = arm.run(task(Frame::Tool, &[(5, unguarded(1.2))]), 100);

    assert!(matches!(states[0].refused, Some(MoveRefused::TooFast { .. })), "{:?}", states[0]);
    assert_eq!(states[0].desired_joints, states[99].desired_joints);
}

/// The governor slows a guarded motion down until its fastest motor is at 0.975 of the speed limit.
/// After half a second at that speed the servo refuses the motion.
#[test]
fn governor_keeps_guarded_motion_below_motor_speed_limit() {
    let limit = config().model.motor_speed_limit;
    let guarded = |velocity| Direction::Guarded { velocity, admittance: 0.3, inertia: 0.1 };
    let fastest = |velocity| {
        let mut arm = Ideal::new();
        let states = arm.run(task(Frame::Tool, &[(5, guarded(velocity))]), 200);
        let refused = states.iter().any(|state| state.refused.is_some());
        let fastest = largest_step(&arm.config, &states[100..]) / PERIOD;
        let slows = arm.run(task(Frame::Tool, &[(5, guarded(0.0))]), 100);
        (fastest / limit, refused, largest_step(&arm.config, &slows[50..]) / PERIOD / limit)
    };

    let (slow, refused, _) = fastest(0.6);
    assert!(slow > 0.6 && slow < 0.8 && !refused, "{slow}");
    let (most, refused, left) = fastest(1.0);
    assert!(most > 0.97 && most < 0.98 && !refused, "{most} of a motor's limit");
    // The momentum of the law is the governed speed, not the commanded one.
    let lag = 0.3 * 0.1;
    let expected = most * (lag / (lag + PERIOD)).powi(52);
    assert!((left / expected - 1.0).abs() < 0.02, "{left} is left, not {expected}");
    let mut arm = Ideal::new();
    let states = arm.run(task(Frame::Tool, &[(5, guarded(1.0))]), 400);
    let first = states.iter().position(|state| state.refused.is_some());
    assert!(
        first.is_some_and(|period| (250..320).contains(&period)),
        "{first:?}: the arm continues"
    );
    let at_once = Direction::Guarded { velocity: 1.5, admittance: 0.3, inertia: 0.0 };
    let refused = Ideal::new().run(task(Frame::Tool, &[(5, at_once)]), 10)[0].refused;
    assert!(matches!(refused, Some(MoveRefused::TooFast { .. })), "{refused:?}");
}

#[test]
fn contact_motion_reaches_wanted_force_on_spring() {
    let mut arm = Ideal::new();
    let rest = arm.step(None).desired_base_from_tool.translation.vector;
    arm.spring = Some((3e4, rest));
    let press = Direction::Contact { wanted: 8.0, admittance: 0.001, inertia: 20.0 };

    let end = arm.run(task(Frame::Base, &[(1, press)]), 2000)[1999];

    let pressed = end.desired_base_from_tool.rotation * end.wrench_in_tool.force;
    assert!((pressed.y - 8.0).abs() < 0.1, "{pressed}");
    assert!(((end.desired_base_from_tool.translation.vector - rest).y - 8.0 / 3e4).abs() < 1e-5);
}

/// A wrong sign or a delay of the force that the law gets lets the force grow to the limit of the
/// sensor. The reported wrench depends on neither.
#[test]
fn flipped_or_delayed_force_feedback_causes_sensor_fault() {
    for (settings, limit) in [
        (ForceSettings { sign: -1.0, delay_periods: 0 }, true),
        (ForceSettings { sign: 1.0, delay_periods: 30 }, true),
        (ForceSettings { sign: 1.0, delay_periods: 0 }, false),
    ] {
        let mut arm = Ideal::new();
        let rest = arm.step(Some(ServoCommand::ForceSettings(settings))).desired_base_from_tool;
        arm.spring = Some((3e4, rest.translation.vector + Vector3::new(0.0, 1e-4, 0.0)));

        let states = arm.run(task(Frame::Base, &[(1, COMPLIANT)]), 3000);

        let tripped = states.iter().any(|s| matches!(s.fault, Some(ArmFault::ForceSensor { .. })));
        assert_eq!(tripped, limit, "{settings:?}");
        let felt = states[2].desired_base_from_tool.rotation * states[2].wrench_in_tool.force;
        assert!((felt.y + 3.0).abs() < 0.3, "the surroundings pull towards +y: {felt}");
    }
}

/// A force sensor without readings stops a motion to a joint position or pose, but neither a motion
/// of motors nor a hold. A saturated sensor stops none: the actor that commands the motion judges
/// the force.
#[test]
fn silent_force_sensor_stops_joint_and_pose_motions() {
    let with = |newtons: f64, motion: fn(&ArmState) -> Motion| {
        let mut arm = Ideal::new();
        let begun = arm.step(None);
        arm.step(Some(go(motion(&begun), 10)));
        arm.reading.wrench_on_sensor = Wrench::from_directions([newtons; 6]);
        let fault = arm.step(None).fault;
        (fault.is_some(), arm.drive.enabled)
    };
    let joints = |now: &ArmState| {
        let mut to = now.desired_joints;
        to.0[1] += 0.01;
        Motion::Joints(to)
    };
    let pose = |now: &ArmState| {
        Motion::Pose(now.desired_base_from_tool * Pose::translation(0.0, 0.0, 0.01))
    };
    let motors = |_: &ArmState| Motion::MotorsBy(MotorPositions([0.5; 7]));

    for (motion, silent) in [
        (joints as fn(&ArmState) -> Motion, true),
        (pose, true),
        (motors, false),
        (|_| Motion::Hold, false),
    ] {
        assert_eq!(with(f64::NAN, motion), (silent, !silent));
        assert_eq!(
            with(200.0, motion),
            (false, true),
            "the moving generator judges a measured force"
        );
    }

    // A sensor that has not given a reading yet is a fault only for a motion under force control.
    let mut arm = Ideal::new();
    arm.reading.wrench_on_sensor = Wrench::from_directions([f64::NAN; 6]);
    let begun = arm.step(None);
    let moved = arm.run(joints(&begun), 10)[9];
    assert_eq!((moved.fault, arm.drive.enabled), (None, true));
}

/// A motion with set velocities alone continues without readings of the force sensor.
#[test]
fn silent_force_sensor_stops_force_control_at_once() {
    let silent = Wrench::from_directions([f64::NAN; 6]);
    let mut arm = Ideal::new();
    arm.reading.wrench_on_sensor = silent;
    let moved = arm.run(task(Frame::Base, &[(1, unguarded(0.01))]), 100)[99];
    assert_eq!((moved.fault, moved.refused), (None, None));

    let stopped = arm.step(Some(go(task(Frame::Base, &[(1, COMPLIANT)]), 100)));

    assert!(matches!(stopped.fault, Some(ArmFault::ForceSensor { .. })));
    assert_eq!(stopped.desired_joints, moved.desired_joints);
    assert!(!arm.drive.enabled);
    assert_eq!(arm.drive.pwm, [0; 7]);
}

#[test]
fn axis_on_limit_switch_may_only_leave() {
    const ON: u8 = 1 << 3;
    let by = |radians: f64| {
        let mut motors = [0.0; 7];
        motors[3] = radians;
        Motion::MotorsBy(MotorPositions(motors))
    };
    let is_hit = |states: &[ArmState]| {
        let fault = states.last().unwrap().fault;
        assert!(matches!(fault, None | Some(ArmFault::LimitSwitch { axis: 3, .. })), "{fault:?}");
        fault.is_some()
    };
    // Limit switch that is active from the second reading on, and the motion that leaves it (rad).
    // The opposite motion moves further onto it.
    for (mark, off) in [
        (ArmReading { upper_limits: ON, ..first_reading() }, -2.0),
        (ArmReading { lower_limits: ON, ..first_reading() }, 2.0),
    ] {
        let mut arm = Ideal::new();
        arm.step(None);
        (arm.reading.upper_limits, arm.reading.lower_limits) =
            (mark.upper_limits, mark.lower_limits);
        assert!(!is_hit(&arm.run(Motion::Hold, 100)));
        assert!(is_hit(&arm.run(by(-off), 100)), "motion towards the switch");
        arm.step(Some(ServoCommand::Reset));
        assert!(!is_hit(&arm.run(by(off), 100)), "motion away from the switch");

        (arm.reading.upper_limits, arm.reading.lower_limits) = (0, 0);
        assert!(!is_hit(&arm.run(by(off), 100)));
        (arm.reading.upper_limits, arm.reading.lower_limits) =
            (mark.upper_limits, mark.lower_limits);
        assert!(
            is_hit(&arm.run(Motion::Hold, 10)),
            "after the motor has left the switch, it is a limit again"
        );
    }
}

#[test]
fn faults_switch_the_drives_off_until_reset() {
    type Corrupt = fn(&mut ArmReading);

    let upper = |r: &mut ArmReading| r.upper_limits = 1 << 3;
    let lower = |r: &mut ArmReading| r.lower_limits = 1 << 2;
    let stage = |r: &mut ArmReading| r.power_faults = 1 << 4;
    let current = |r: &mut ArmReading| {
        r.over_currents = 1 << 5;
        r.currents[5] = 11.0;
    };
    let jump = |r: &mut ArmReading| r.counts[2] += 1200;
    let corrupt: [(Corrupt, &str); 5] = [
        (upper, "axis 3: limit switch"),
        (lower, "axis 2: limit switch"),
        (stage, "axis 4: the power stage"),
        (current, "axis 5: over-current, 11.0 A"),
        (jump, "axis 2: the encoder jumped"),
    ];
    // The fault leaves the stops of the palm where the command has put them.
    let jaw = JawCommand { opening: 0.074, force_limit: 20.0, stops: Depth::Two };
    let motion = task(Frame::Base, &[(0, unguarded(0.05))]);
    let command = MoveCommand { motion, periods: 500, jaw: Some(jaw) };
    let deep = ServoCommand::Move { command, start: 0 };
    for (corrupt, why) in corrupt {
        let mut arm = Ideal::new();
        (0..10).for_each(|_| assert_eq!(arm.step(None).fault, None));
        arm.step(Some(deep));
        assert!(arm.drive.enabled);
        corrupt(&mut arm.reading);

        let fault = arm.step(None);
        assert!(fault.fault.unwrap().to_string().contains(why), "{fault:?}");
        assert_eq!(arm.drive, ArmDrive { stops: Depth::Two, ..ArmDrive::OFF }, "{why}");

        arm.reading = ArmReading { counts: arm.reading.counts, ..ArmReading::default() };
        let ignored = arm.step(Some(go(task(Frame::Base, &[(0, unguarded(0.05))]), 500)));
        assert_eq!(ignored.fault, fault.fault);
        assert_eq!(ignored.desired_joints, fault.desired_joints);
        assert!(!arm.drive.enabled, "{why}");

        let again = arm.step(Some(ServoCommand::Reset));
        assert_eq!(again.fault, None);
        assert!(arm.drive.enabled);
        let (d, _) = apart(&again.desired_base_from_tool, &again.base_from_tool);
        assert!(d < 1e-12, "set values equal measured values");
    }
}

/// Accelerates a motor to 240 rad/s and back. At full speed the servo misses `missed` periods, in
/// which the last drive value stays in effect; then the motor is blocked if `blocked` is `true`.
/// Returns the fault of the servo, if any, and the number of periods since the blocking.
fn with_missed_periods(missed: u64, blocked: bool) -> Option<(ArmFault, u64)> {
    let (mut motors, mut drive) = (Motors::new(1), ArmDrive::OFF);
    let mut readings = [ArmReading::default()];
    motors.exchange(0, &[drive], &mut readings).unwrap();
    let mut servo = ArmServo::new(config(), &readings[0]);
    let speeds = (1..=24).chain([24; 50]).chain((1..=24).rev()).map(|tens| 10.0 * f64::from(tens));
    let mut period = 0;
    for (macrostep, speed) in speeds.enumerate() {
        let mut by = MotorPositions::default();
        by.0[0] = 10.0 * PERIOD * speed;
        let mut command = Some(go(Motion::MotorsBy(by), 10));
        for step in 0..10 {
            period += 1;
            if (macrostep, step) == (30, 5) {
                for _ in 0..missed {
                    motors.exchange(period, &[drive], &mut readings).unwrap();
                }
                servo.apply_outside(period, &Outside { skipped: missed, ..Outside::default() });
            }
            drive = servo.step(period, &readings[0], command.take().as_ref()).0;
            if let Some(fault) = servo.fault() {
                return Some((fault, 10 * macrostep as u64 + step - 310));
            }
            let counts = readings[0].counts;
            motors.exchange(period, &[drive], &mut readings).unwrap();
            // The stop yields by an increment in every other period, less than the command asks
            // for.
            if blocked && macrostep >= 31 {
                readings[0].counts[0] = counts[0] + i64::from(step % 2 == 0);
            }
        }
    }
    None
}

/// A motor that really is blocked after the missed periods is still detected.
#[test]
fn missed_periods_cause_no_following_error() {
    for missed in [0, 1, 5, 12, 19] {
        assert_eq!(with_missed_periods(missed, false), None, "{missed} missed");
        let fault = with_missed_periods(missed, true);
        let found =
            matches!(fault, Some((ArmFault::Following { axis: 0, .. }, periods)) if periods < 40);
        assert!(found, "{missed}: {fault:?}");
    }
}

#[test]
fn frozen_encoder_is_found_within_ten_periods() {
    let mut arm = Ideal::new();
    let mut goal = START;
    goal.0[1] += 0.5;
    arm.step(Some(go(Motion::Joints(goal), 500)));
    for _ in 0..100 {
        arm.step(None);
    }
    let frozen = arm.reading.counts[1];

    let mut periods = 0;
    while arm.servo.fault().is_none() {
        arm.reading.counts[1] = frozen;
        arm.step(None);
        periods += 1;
        assert!(periods <= 10);
    }

    assert!(matches!(arm.servo.fault(), Some(ArmFault::EncoderFrozen { axis: 1, .. })));
}

/// At a speed that need not show in each period, the distance of the set value tells a frozen
/// encoder: 1 rad.
#[test]
fn frozen_encoder_of_slow_axis_is_found() {
    let mut arm = Ideal::new();
    let mut by = MotorPositions::default();
    by.0[1] = 20.0;
    // The motor moves by 0.01 rad in each period.
    arm.step(Some(go(Motion::MotorsBy(by), 2000)));
    for _ in 0..100 {
        assert_eq!(arm.step(None).fault, None);
    }
    let frozen = arm.reading.counts[1];

    let mut periods = 0;
    while arm.servo.fault().is_none() && periods < 200 {
        arm.reading.counts[1] = frozen;
        arm.step(None);
        periods += 1;
    }

    let fault = arm.servo.fault();
    assert!(matches!(fault, Some(ArmFault::EncoderFrozen { axis: 1, .. })), "{fault:?}");
    assert!((98..=104).contains(&periods), "{periods} periods");
}

#[test]
fn jaw_opens_on_command_and_bias_zeroes_force() {
    let mut arm = Ideal::new();
    let jaw = JawCommand { opening: 0.080, force_limit: 25.0, stops: Depth::Two };
    let command = MoveCommand { motion: Motion::Hold, periods: 100, jaw: Some(jaw) };
    arm.step(Some(ServoCommand::Move { command, start: 0 }));
    assert_eq!(arm.drive.stops, Depth::Two);
    for _ in 0..20 {
        arm.step(None);
    }
    assert!(arm.drive.jaw_pwm < 0, "opening turns backwards");

    let too_wide = JawCommand { opening: 0.2, ..jaw };
    let command = MoveCommand { motion: Motion::Hold, periods: 100, jaw: Some(too_wide) };
    let refused = arm.step(Some(ServoCommand::Move { command, start: 0 }));
    assert!(matches!(refused.refused, Some(MoveRefused::JointLimit { axis: 7, .. })));

    arm.reading.wrench_on_sensor = Wrench::from_directions([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]);
    let biasing = arm.step(Some(ServoCommand::Bias));
    assert_eq!(biasing.command_end, biasing.period + 10);
    let mut end = biasing;
    for _ in 0..11 {
        end = arm.step(None);
    }
    let left = end.wrench_in_tool;
    assert!(left.force.norm() < 1e-12 && left.torque.norm() < 1e-12, "{left:?}");
}
