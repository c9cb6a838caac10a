//! Weighing of a tool: an arm turns its wrist through orientations, and
//! [`servo::weigh`](crate::servo::weigh) computes weight, centre of mass and the sensor's bias from
//! the readings.
//!
//! Servo periods and exchanges run in this thread, by the wall clock or as fast as they compute. No
//! actor runs, and nothing else moves.
//!
//! - in: a scenario, the index of an arm whose hand is empty
//! - out: [`Weighed`], and the number of orientations

use super::disturbance::InjectedFaults;
use super::failure::not_created;
use super::interrupt::{ending_signals, ignore_others};
use super::plan::Plan;
use super::world::World;
use crate::actors::control::Control;
use crate::error::{Error, Fatal, NonFatal};
use crate::hw::driver::{
    self, Clock, Core, NoRecords, PERIOD_NANOS, RealTime, ServoLink, Switches,
};
use crate::kinematics::ArmModel;
use crate::motion::{ArmState, JointPositions, Motion, MoveCommand, MoveRefused, PERIOD};
use crate::scenario::Scenario;
use crate::scenario::keys::Pace;
use crate::servo::weigh::{Mean, Sample, Weighed, weigh};
use crate::servo::{ArmServo, ServoCommand, ServoConfig};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::sync::watch;

/// Longest wait for the fault of an arm that brakes after missed periods (s). The driver trips it
/// after 0.2 s.
const BRAKING_LIMIT: f64 = 0.5;
/// Mean speed of the fastest joint (rad/s).
const SPEED: f64 = 0.3;
/// Duration of each command of a motion (periods of 2 ms).
const STEP: u32 = 20;
/// Time at rest before the readings are taken (s).
const SETTLING_TIME: f64 = 0.8;
/// Time of the readings of one orientation, if the sensor gives one in each period (s).
const SAMPLING_TIME: f64 = 0.6;
/// Factor by which the readings of a slow sensor may take longer.
const PATIENCE: u32 = 5;
/// Distance of the joints from their limits (rad).
const MARGIN: f64 = 0.05;
/// Orientations of the wrist, as offsets from the start: pitch q4, roll q5, tool's roll q6 (deg).
const OFFSETS: [[f64; 3]; 12] = [
    [0.0, 0.0, 0.0],
    [0.0, 0.0, 80.0],
    [0.0, 0.0, 150.0],
    [0.0, 0.0, -80.0],
    [35.0, 0.0, -80.0],
    [35.0, 0.0, 0.0],
    [35.0, 40.0, 80.0],
    [0.0, 40.0, 80.0],
    [-35.0, 40.0, 0.0],
    [-35.0, 0.0, -80.0],
    [-35.0, -40.0, 80.0],
    [0.0, -40.0, 0.0],
];

/// Weighs the tool of an arm by the force sensor of its wrist, in several orientations. `progress`
/// is called before each orientation with its index and their number. Returns the result with the
/// number of orientations.
///
/// # Errors
/// If the hardware fails; a non-fatal error if the readings do not determine the weight.
pub(crate) fn weigh_tool(
    scenario: &Scenario,
    arm: usize,
    mut progress: impl FnMut(usize, usize),
) -> Result<(Weighed, usize), Error> {
    let scenario = &scenario.at_usual_period();
    let control = Arc::new(watch::channel(Control::Running).0);
    if scenario.controller.network.is_real {
        let actor = "supervisor".to_owned();
        let why = "weigh the tools of each host with a scenario without [[node]]".to_owned();
        let cause = NonFatal::Arguments(why);
        return Err(Error::NonFatal { actor, place: "weigh".into(), cause });
    }
    let world = if scenario.bridge.kind.is_hardware() {
        World::of_hardware(scenario, None, &control)?.0
    } else {
        let faults = InjectedFaults::new(&scenario.controller);
        World::of_plant(scenario, Plan::of(scenario)?.plant(scenario)?, &control, &faults)?.0
    };
    let config = &scenario.controller;
    let configs: Vec<_> = config
        .cell
        .arms
        .iter()
        .zip(&config.effectors)
        .map(|(arm, effector)| ServoConfig::new(arm, effector.gains.clone()))
        .collect();
    // A signal is obeyed between two periods; the process must not die while drives are on.
    let interrupted = Arc::new(AtomicBool::new(false));
    ignore_others();
    for signal in ending_signals() {
        signal_hook::flag::register(signal, Arc::clone(&interrupted))
            .map_err(|e| not_created("interrupt", &e.to_string()))?;
    }
    let timing = (scenario.pace, scenario.missed_limit());
    let mut scale = Scale::new(configs, world, timing, interrupted)?;
    scale.synchronise(arm)?;
    let model = &config.cell.arms[arm].model;
    let start = scale.state(arm).joints;
    // Orientations that the motors do not allow are left out.
    let stops: Vec<_> = OFFSETS.iter().filter_map(|offset| stop(model, &start, offset)).collect();
    let mut samples = Vec::with_capacity(stops.len());
    for (index, joints) in stops.iter().enumerate() {
        progress(index, stops.len());
        scale.go(arm, joints)?;
        samples.push(scale.listen(arm, model)?);
    }
    scale.go(arm, &start)?;
    let weighed = weigh(&samples, &config.cell.arms[arm].sensor.flange_from_sensor);
    let weighed = weighed.map_err(|why| Error::NonFatal {
        actor: "weigh".into(),
        place: "weigh".into(),
        cause: NonFatal::NoReading(why.to_string()),
    })?;
    Ok((weighed, samples.len()))
}

/// Returns the joint positions of one orientation: the start with `offset` (deg) added to joints 4
/// to 6, clamped to their limits; `None` if the limits of the motors do not allow it.
fn stop(model: &ArmModel, start: &JointPositions, offset: &[f64; 3]) -> Option<JointPositions> {
    let mut joints = *start;
    for (joint, by) in (4..).zip(offset) {
        let (low, high) = model.joint_limits[joint];
        joints.0[joint] = (start.0[joint] + by.to_radians()).clamp(low + MARGIN, high - MARGIN);
    }
    model.check(&joints).is_ok().then_some(joints)
}

/// Servos of all arms over their world, without actors.
struct Scale {
    core: Core,
    world: World,
    links: Vec<ServoLink>,
    period: u64,
    /// Time of the next period by the wall clock (ns); `None` under virtual time.
    next: Option<u64>,
    /// Number of periods missed in a row from which on the arms are stopped.
    missed_limit: u64,
    /// Whether a signal arrived. The weighing ends then, and the bridge switches the drives off as
    /// it is dropped.
    interrupted: Arc<AtomicBool>,
    _rights: Option<RealTime>,
}

impl Scale {
    /// Creates the servos of all arms and performs their first period. `missed_limit` is the number
    /// of periods missed in a row from which on the arms are stopped.
    ///
    /// # Errors
    /// If the port fails, or a signal arrived.
    fn new(
        configs: Vec<ServoConfig>,
        mut world: World,
        (pace, missed_limit): (Pace, u64),
        interrupted: Arc<AtomicBool>,
    ) -> Result<Self, Error> {
        let (links, ends): (Vec<_>, Vec<_>) = configs.iter().map(|_| driver::link()).unzip();
        let switches = Arc::new(Switches::default());
        let wall = pace == Pace::RealTime;
        let rights = wall.then(|| RealTime::acquire(80, None));
        let core = Core::new(configs, ends, switches, Box::new(NoRecords), &mut world)
            .map_err(|e| not_created("servo", &e.to_string()))?;
        // The first period gives each arm a state.
        let next = wall.then(|| Clock.now() + PERIOD_NANOS);
        let period = 0;
        let mut this =
            Self { core, world, links, period, next, missed_limit, interrupted, _rights: rights };
        this.step()?;
        Ok(this)
    }

    /// Returns the state of an arm after the last period.
    fn state(&mut self, arm: usize) -> ArmState {
        *self.links[arm].state()
    }

    /// Performs one servo period of all arms; under the wall clock waits for its time first.
    ///
    /// # Errors
    /// If a signal arrived or the bridge failed.
    fn step(&mut self) -> Result<(), Error> {
        if let Some(next) = &mut self.next {
            Clock.wait_until(*next, 0);
            *next += PERIOD_NANOS;
            // As in the driver of a run: missed periods are skipped, and too many of them stop the
            // arms.
            let missed = driver::pass(next, PERIOD_NANOS, Clock.now());
            if missed > 0 {
                self.core.add_missed_periods(missed);
            }
            if missed >= self.missed_limit {
                self.core.stop(self.period, missed);
            }
        }
        if self.interrupted.load(Ordering::Acquire) {
            return Err(refuse(MoveRefused::Aborted));
        }
        self.period += 1;
        self.core
            .period(self.period, &mut self.world)
            .map_err(|fault| fatal(Fatal::Bridge(fault.to_string())))
    }

    /// Returns the state of an arm, if the arm may move.
    ///
    /// # Errors
    /// Fatal if the arm has a fault, non-fatal if its last command was refused.
    fn check(&mut self, arm: usize) -> Result<ArmState, Error> {
        let mut state = self.state(arm);
        // After missed periods the arm brakes first and gets its fault later. The fault is the
        // reason to report, not the refused command.
        let mut left = (BRAKING_LIMIT / PERIOD) as u32;
        while matches!(state.refused, Some(MoveRefused::Stopping { .. }))
            && state.fault.is_none()
            && left > 0
        {
            self.step()?;
            (state, left) = (self.state(arm), left - 1);
        }
        if let Some(fault) = state.fault {
            return Err(fatal(Fatal::Arm(fault)));
        }
        match state.refused {
            None => Ok(state),
            Some(refused) => Err(refuse(refused)),
        }
    }

    /// Sends a command to an arm and performs periods until it is done.
    ///
    /// # Errors
    /// The errors of [`Self::check`] and [`Self::step`].
    fn run(&mut self, arm: usize, command: ServoCommand) -> Result<(), Error> {
        let ticket =
            self.links[arm].send(command).map_err(|e| not_created("servo", &e.to_string()))?;
        while !self.links[arm].is_done(ticket, ArmServo::EARLY) {
            self.step()?;
            self.check(arm)?;
        }
        Ok(())
    }

    /// Synchronises an arm unless it is synchronised already.
    ///
    /// # Errors
    /// The errors of [`Self::run`].
    fn synchronise(&mut self, arm: usize) -> Result<(), Error> {
        let known = |core: &Core| core.synchronised().nth(arm).unwrap_or(false);
        if known(&self.core) {
            return Ok(());
        }
        self.run(arm, ServoCommand::Synchronise)?;
        while !known(&self.core) {
            self.step()?;
            self.check(arm)?;
        }
        Ok(())
    }

    /// Moves an arm to joint positions in short commands, slowly at both ends.
    ///
    /// # Errors
    /// The errors of [`Self::run`].
    fn go(&mut self, arm: usize, joints: &JointPositions) -> Result<(), Error> {
        let from = self.state(arm).desired_joints.0;
        // Half a cosine over time: the largest speed is pi / 2 times the mean.
        let way = joints.0.iter().zip(from).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let steps = ((way / SPEED / PERIOD) as u32 / STEP).max(5);
        for step in 1..=steps {
            let share =
                0.5 - 0.5 * (std::f64::consts::PI * f64::from(step) / f64::from(steps)).cos();
            let at = std::array::from_fn(|i| from[i] + share * (joints.0[i] - from[i]));
            let command = MoveCommand {
                motion: Motion::Joints(JointPositions(at)),
                periods: STEP,
                jaw: None,
            };
            self.run(arm, ServoCommand::Move { command, start: 0 })?;
        }
        Ok(())
    }

    /// Lets an arm come to rest and returns the mean of its force sensor's readings, with the
    /// orientation of its flange.
    ///
    /// # Errors
    /// If the sensor gives too few readings; the errors of [`Self::check`] and [`Self::step`].
    fn listen(&mut self, arm: usize, model: &ArmModel) -> Result<Sample, Error> {
        for _ in 0..(SETTLING_TIME / PERIOD) as u32 {
            self.step()?;
        }
        let count = (SAMPLING_TIME / PERIOD) as u32;
        // The mean leaves out repeated readings, so a slow sensor needs more periods.
        let mut mean = Mean::default();
        for _ in 0..PATIENCE * count {
            self.step()?;
            mean.add(&self.core.readings()[arm]);
            if mean.taken() == count {
                break;
            }
        }
        if mean.taken() < count {
            let (taken, of) = (mean.taken(), PATIENCE * count);
            let silent = format!("the force sensor gave {taken} readings in {of} periods");
            let cause = NonFatal::NoReading(silent);
            return Err(Error::NonFatal { actor: "weigh".into(), place: "listen".into(), cause });
        }
        let joints = self.check(arm)?.joints;
        Ok(Sample {
            base_from_flange: model.base_from_flange(&joints).rotation,
            wrench_on_sensor: mean.wrench(),
        })
    }
}

/// Returns the fatal error of a weighing.
fn fatal(cause: Fatal) -> Error {
    Error::Fatal { actor: "weigh".into(), place: "servo".into(), cause, last: None }
}

/// Returns the non-fatal error of a weighing whose arm refused a command.
fn refuse(refused: MoveRefused) -> Error {
    Error::NonFatal {
        actor: "weigh".into(),
        place: "move".into(),
        cause: NonFatal::Refused(refused),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use std::path::Path;

    #[test]
    fn weigh_tool_finds_true_weight_and_centre() {
        // The length of a run's periods has no part in it.
        let text = "task = \"idle\"\nseed = 5\n[real_time]\nperiod_ms = 1\n";
        let scenario = crate::tasks::read(Path::new("weigh.toml"), text, &[]).unwrap();
        let truth = Plan::of(&scenario).unwrap().plant(&scenario).unwrap();

        for arm in 0..2 {
            let sensor = truth.cell().arms[arm].sensor;
            let believed = scenario.controller.cell.arms[arm].sensor;
            assert!((sensor.weight - believed.weight).abs() > 0.02, "an easy case: {sensor:?}");

            let (found, orientations) = weigh_tool(&scenario, arm, |_, _| {}).unwrap();

            assert!(orientations >= 8, "{orientations}");
            assert!((found.weight - sensor.weight).abs() < 0.02, "{found:?} {sensor:?}");
            let off = (found.centre_in_flange - sensor.centre_in_flange).norm();
            assert!(off < 1e-3, "{off}: {found:?} {sensor:?}");
            // The plant's base is tilted by up to 1 deg against the belief: 0.2 N of 11 N are not
            // explained by any weight.
            assert!(found.largest_residual.0 < 0.3, "{found:?}");
        }
    }
}
