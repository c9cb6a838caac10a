//! One 2 ms period of one arm: the order of its parts, and the cases in which an arm stops.
//!
//! | cause | threshold | reaction |
//! |---|---|---|
//! | fault of a watchdog, emergency stop | - | drives off and brakes on until a reset |
//! | motion that is refused on its path | - | the set values stop at once |
//! | order to brake, from outside | `FADE` | the speed of the set values fades out |
//! | motion that ends or is replaced at speed | `SUDDEN` | the speed of the set values fades out |
//! | stopped partner, under force control | `YIELD_NANOS` | the arm yields to forces, then holds |
//! | stopped partner, any other motion | `FADE` | as an order to brake |
//! | missed periods and an order to brake | `Gap::GivenUp` | set values restart from readings |
//!
//! Set values fade out because those that stop dead trip the power stages.

use super::homing::{Homing, HomingStep};
use super::io::{ArmDrive, ArmReading, JAW, Outside};
use super::jaw::Jaw;
use super::lateness::StepFilter;
use super::path::{Chain, Path, SetValues, check_end};
use super::regulator::Regulator;
use super::tff::{ForceFeedback, ForceLaw, depends_on_force};
use super::watch::{Wanted, Watch};
use super::wrench::WristForce;
use super::{ForceSettings, ServoCommand, ServoConfig};
use crate::motion::{
    AXES, ArmFault, ArmState, JointPositions, Motion, MotorPositions, MoveCommand, MoveRefused,
    Synchronisation,
};
use crate::spatial::{Pose, Wrench, is_rigid};
use std::f64::consts::TAU;

/// Servo of one arm with its memory.
///
/// ```
/// use rubik_robot::servo::io::ArmReading;
/// use rubik_robot::servo::{ArmServo, ServoConfig};
/// use rubik_robot::tasks;
/// use std::path::Path;
///
/// let config = tasks::read(Path::new("cell"), "task = \"idle\"\n", &[])?.controller;
/// let (arm, effector) = (&config.cell.arms[0], &config.effectors[0]);
/// let motors = arm.model.motors(&arm.start).0;
/// let count = |axis: usize| motors[axis] * arm.model.increments[axis] / std::f64::consts::TAU;
/// let reading = ArmReading {
///     counts: std::array::from_fn(|axis| count(axis).round() as i64),
///     ..ArmReading::default()
/// };
///
/// let mut servo = ArmServo::new(ServoConfig::new(arm, effector.gains.clone()), &reading);
/// let (drive, state) = servo.step(1, &reading, None);
///
/// // An arm at rest without a command keeps its place: drives on, no pulses, no fault.
/// assert!(drive.enabled && drive.pwm == [0; 7]);
/// assert_eq!((state.fault, state.refused), (None, None));
/// assert!((state.joints.0[2] - arm.start.0[2]).abs() < 1e-3);
/// # Ok::<(), rubik_robot::scenario::fault::Faults>(())
/// ```
#[derive(Debug, Clone)]
pub struct ArmServo {
    config: ServoConfig,
    flange_from_tool: Pose,
    set: SetValues,
    /// Steps of the set motor positions in the last period (rad).
    steps: [f64; AXES],
    regulators: [Regulator; AXES],
    step_filters: [StepFilter; AXES],
    last_counts: [i64; AXES],
    last_joints: JointPositions,
    jaw: Jaw,
    wrist: WristForce,
    seen_wrench: SeenWrench,
    law: ForceLaw,
    watch: Watch,
    running: Option<Path>,
    /// Command that begins later, with its first period.
    waiting: Option<(MoveCommand, u64)>,
    /// Last period of the last command.
    command_end: u64,
    /// Reason why the last command was refused or aborted.
    refused: Option<MoveRefused>,
    fault: Option<ArmFault>,
    synchronised: bool,
    homing: Option<Homing>,
    /// Action of the homing in this period.
    homing_step: Option<HomingStep>,
    /// Steps of the motors that fade out after a motion was aborted (rad).
    braking: Option<[f64; AXES]>,
    /// Share of these steps that is left after a period.
    fade: f64,
    /// Whether another arm is stopped.
    stands_by: bool,
    /// Why the servo stops both arms, while they slow down to a fault.
    stopping: Option<MoveRefused>,
    gap: Gap,
}

/// Missed periods before the present one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Gap {
    /// No missed periods.
    None,
    /// Missed periods just before this one.
    Passed,
    /// Missed periods, and the motion that continued in them is aborted. The set values restart
    /// from the measured ones in this period and in this number of further ones, because the first
    /// readings may be from before the gap.
    GivenUp(u8),
}

/// Measured values of a period.
struct Measured {
    motors: MotorPositions,
    joints: JointPositions,
    base_from_flange: Pose,
    /// Wrench that the tool exerts on its surroundings, in tool axes.
    wrench: Wrench,
}

impl ArmServo {
    /// Number of periods of 2 ms at the end of a macrostep in which a new macrostep does not
    /// replace the running one, but follows it.
    pub const EARLY: u64 = 2;
    /// Share of a speed that is left after 2 ms of braking: 1.5 % is left after 0.1 s.
    const FADE: f64 = 0.92;
    /// Time for which an arm whose partner is stopped yields before it holds (ns). The forces
    /// between the arms fall off, and a zero that is slightly wrong does not carry the arm away.
    const YIELD_NANOS: u64 = 500_000_000;
    /// Speed above which a motor must not stop dead (rad/s). Motions that reach their goal end at
    /// lower speeds.
    const SUDDEN: f64 = 20.0;
    /// Step of a motor that counts as rest (rad).
    const REST: f64 = 1e-5;

    /// Makes the servo of an arm at rest. The position that the first reading shows becomes the set
    /// value.
    #[must_use]
    pub fn new(config: ServoConfig, first: &ArmReading) -> Self {
        let chain = Chain { model: &config.model, flange_from_tool: &config.flange_from_tool };
        let set = SetValues::of_joints(chain, JointPositions::default());
        // An arm that is not synchronised may show counts without joints; then the joints stay 0.
        let set = set.moved_to(chain, motors_at(&config, first));
        Self {
            flange_from_tool: config.flange_from_tool,
            set,
            steps: [0.0; AXES],
            regulators: config
                .gains
                .axes
                .map(|g| Regulator::new(g.for_period(config.period), config.gains.pwm_limit))
                .map(|r| r.slowed(config.gains.pwm_slew * config.period.ratio())),
            step_filters: config.model.increments.map(|i| StepFilter::new(i, config.period)),
            last_counts: first.counts,
            last_joints: set.joints,
            jaw: Jaw::new(config.gripper, &config.gains, first.jaw_count, config.period),
            wrist: WristForce::new(config.sensor),
            seen_wrench: SeenWrench::default(),
            law: ForceLaw::new(config.period),
            watch: Watch::new(&config.gains, &config.model.increments, first.counts, config.period),
            running: None,
            waiting: None,
            command_end: 0,
            refused: None,
            fault: None,
            synchronised: is_synchronised(&config, first),
            homing: None,
            homing_step: None,
            braking: None,
            fade: libm::pow(Self::FADE, config.period.ratio()),
            stands_by: false,
            stopping: None,
            gap: Gap::None,
            config,
        }
    }

    /// Computes one period from its number, the reading at its beginning and at most one command.
    /// Returns the drive commands of this period, and the state at its beginning with the set
    /// values of its end.
    pub fn step(
        &mut self,
        period: u64,
        reading: &ArmReading,
        command: Option<&ServoCommand>,
    ) -> (ArmDrive, ArmState) {
        let measured = self.measure(reading);
        let missing = self.wrist.missing_samples();
        if missing > 0 {
            // A sensor that is slower than the servo needs longer for its zero, and the command
            // that asked for it must not end before.
            self.command_end = self.command_end.max(period + u64::from(missing));
        }
        // The axes kept moving in the gap while the set values did not. A wrist roll that was
        // braked in mid-turn was 3.5 rad of its motor off its set value, which was a following
        // error half a second later.
        if matches!(self.gap, Gap::GivenUp(_)) && self.fault.is_none() {
            self.set = self.set.moved_to(self.chain(), measured.motors);
            self.step_filters.iter_mut().for_each(StepFilter::clear);
        }
        if let Some(command) = command {
            self.accept(period, reading, command);
        }
        self.home(period, reading, &measured);
        self.begin_waiting(period);
        // The watchdogs compare the reading with the set values of the last period, so they come
        // before the set values move on.
        self.watch(period, reading, &measured);
        let before = self.set.motors;
        let wrench = self.seen_wrench.next(measured.wrench);
        if self.fault.is_none() {
            self.advance(period, &wrench);
            self.jaw.advance(period);
        }
        self.steps = std::array::from_fn(|i| self.set.motors.0[i] - before.0[i]);
        // An arm with a fault must not ask a controller for an encoder zero.
        self.homing_step = self.homing_step.filter(|_| self.fault.is_none());
        let (drive, state) = (self.drive(reading), self.state(period, reading, &measured));
        debug_assert!(is_rigid(&state.base_from_tool), "measured pose is not rigid: {state:?}");
        debug_assert!(is_rigid(&state.desired_base_from_tool), "set pose is not rigid: {state:?}");
        debug_assert!(
            drive.pwm.iter().all(|width| width.abs() <= 255),
            "a pulse width is above 255: {drive:?}"
        );
        (drive, state)
    }

    /// Applies the inputs from outside the arm: missed periods, an order to brake, a fault, a
    /// stopped partner. The call comes before [`ArmServo::step`] of the same period.
    pub fn apply_outside(&mut self, period: u64, outside: &Outside) {
        // The gap comes first: an order to brake depends on whether periods were missed.
        if outside.skipped > 0 {
            self.add_missed_periods(outside.skipped);
        }
        // A silence of the actors is no stop: a command shows that it ends.
        self.stopping = outside.brake.filter(|why| matches!(why, MoveRefused::Stopping { .. }));
        if let Some(why) = outside.brake {
            self.brake(period, why);
        }
        if let Some(fault) = outside.trip {
            self.trip(period, fault);
        }
        self.stand_by(period, outside.stands_by);
    }

    /// Stops the arm until [`ServoCommand::Reset`]: drives off, brakes on. If the arm has a fault
    /// already, this earlier fault stays.
    fn trip(&mut self, period: u64, fault: ArmFault) {
        self.fault.get_or_insert(fault);
        self.hold(period);
    }

    /// Brings the arm to rest within about 0.1 s, because set values that stop dead trip the power
    /// stages. The state reports `why` as the reason for which the motion was aborted.
    fn brake(&mut self, period: u64, why: MoveRefused) {
        // An arm without a motion has no command to refuse.
        if self.running.is_none() && self.waiting.is_none() && self.homing.is_none() {
            return;
        }
        self.hold(period);
        self.braking = Some(self.steps);
        // Without a gap the set values still match the axes, and only their speed fades out.
        if self.gap == Gap::Passed {
            self.gap = Gap::GivenUp(2);
        }
        self.refused = Some(why);
    }

    /// Makes the arm stand by as long as `stopped` is true: another arm is stopped by a fault, or
    /// an actor is gone. At the beginning an arm under force control yields for half a second,
    /// without a velocity of its own, and then holds; any other arm brakes. Until `stopped` is
    /// false the arm refuses motions and homing.
    fn stand_by(&mut self, period: u64, stopped: bool) {
        let begins = stopped && !self.stands_by;
        self.stands_by = stopped;
        if !begins || self.fault.is_some() {
            return;
        }
        // Both arms may hold the cube: a stiff stop would leave the force between them as it is.
        let yields = self.running.as_ref().and_then(Path::directions).is_some_and(depends_on_force);
        if yields && let Some(mut path) = self.running {
            path.yield_until(period + Self::YIELD_NANOS / self.config.period.nanos());
            self.hold(period);
            self.running = Some(path);
        } else {
            self.brake(period, MoveRefused::PartnerStopped);
        }
        self.refused = Some(MoveRefused::PartnerStopped);
    }

    /// Aborts the running and the waiting motion and keeps the present set values.
    fn hold(&mut self, period: u64) {
        self.running = None;
        self.waiting = None;
        self.homing = None;
        self.braking = None;
        self.jaw.hold();
        // The aborted command ends now; its client must not wait for the planned end.
        self.command_end = self.command_end.min(period);
    }

    /// Returns whether the arm is synchronised, so that its counters give its position.
    #[must_use]
    pub fn is_synchronised(&self) -> bool {
        self.synchronised
    }

    /// Registers that the servo missed `missed` periods just before the next one.
    fn add_missed_periods(&mut self, missed: u64) {
        self.gap = Gap::Passed;
        self.watch.add_missed_periods(missed);
        self.jaw.add_missed_periods(missed);
    }

    /// Returns the fault that has stopped the arm; `None` for an arm without a fault.
    #[must_use]
    pub fn fault(&self) -> Option<ArmFault> {
        self.fault
    }

    /// Converts a reading to motor positions, joints, pose and wrench of the tool. If the counts
    /// belong to no joints, the joints of the last period stay.
    fn measure(&mut self, reading: &ArmReading) -> Measured {
        let motors = motors_at(&self.config, reading);
        let joints = self.config.model.joints_unchecked(&motors);
        // Far outside its limits a screw has no joint angle. The last joints keep the state finite,
        // and the watchdogs stop the arm.
        if joints.0.iter().all(|q| q.is_finite()) {
            self.last_joints = joints;
        }
        let joints = self.last_joints;
        let base_from_flange = self.config.model.base_from_flange(&joints);
        let wrench = self.wrist.read(
            (&reading.wrench_on_sensor, !reading.wrench_is_old),
            &base_from_flange,
            &self.flange_from_tool,
        );
        Measured { motors, joints, base_from_flange, wrench }
    }

    /// Carries out a command that takes effect at once, or prepares the motion or homing that it
    /// orders. The state reports a refusal as `refused`.
    fn accept(&mut self, period: u64, reading: &ArmReading, command: &ServoCommand) {
        match *command {
            ServoCommand::Move { command, start } => self.accept_move(period, command, start),
            ServoCommand::SetTool(flange_from_tool) => self.set_tool(period, flange_from_tool),
            ServoCommand::Bias => {
                // The command ends with its samples, if the sensor is as fast as the servo.
                self.wrist.start_bias();
                let end = period + u64::from(WristForce::BIAS_SAMPLES);
                self.command_end = self.command_end.max(end);
            }
            ServoCommand::Payload { weight, centre } => {
                // A NaN here would make every later wrench NaN.
                if weight.is_finite() && centre.coords.iter().all(|c| c.is_finite()) {
                    self.wrist.set_payload(weight, centre);
                } else {
                    self.refused = Some(MoveRefused::NotANumber);
                }
            }
            ServoCommand::ForceSettings(settings) => self.seen_wrench.settings = settings,
            ServoCommand::Reset => self.reset(reading),
            // Homing is a motion, and an arm that stops refuses motions.
            ServoCommand::Synchronise if self.forbidden().is_some() => {
                self.refused = self.forbidden();
            }
            ServoCommand::Synchronise => {
                if self.fault.is_none() && !self.synchronised {
                    self.hold(period);
                    self.refused = None;
                    self.homing =
                        Some(Homing::new(self.config.model.has_track, self.config.period));
                }
            }
        }
    }

    /// Returns why the arm may not begin a motion now: the servo stops both arms, or the other arm
    /// is stopped. `None` if it may.
    fn forbidden(&self) -> Option<MoveRefused> {
        self.stopping.or(self.stands_by.then_some(MoveRefused::PartnerStopped))
    }

    /// Stores a move until its first period: `start`, or a later one if the move follows the
    /// running motion. Refuses the move if it is [`forbidden`](Self::forbidden), or if it needs a
    /// synchronised arm and this one is not.
    fn accept_move(&mut self, period: u64, command: MoveCommand, start: u64) {
        if self.fault.is_some() {
            return;
        }
        self.refused = self.forbidden();
        if self.refused.is_some() {
            return;
        }
        // An arm that does not know its position may hold, or turn its motors by an amount. A jaw
        // command is an opening, so it needs the position.
        let blind = matches!(command.motion, Motion::Hold | Motion::MotorsBy(_));
        if self.homing.is_some() || !(self.synchronised || blind && command.jaw.is_none()) {
            self.refused = Some(MoveRefused::NotSynchronised);
            return;
        }
        self.braking = None;
        // The EDP reports the end of a macrostep two periods before it. A command that comes in
        // these periods continues the motion without a pause; an earlier one replaces the motion.
        let follows =
            self.running.is_some_and(|path| path.end <= period + self.config.period.early());
        let after = if follows { self.running.map_or(0, |path| path.end + 1) } else { 0 };
        let begin = start.max(period).max(after);
        self.waiting = Some((command, begin));
        // The client of this command must not mistake the end of the running one for its own.
        self.command_end = begin + u64::from(command.periods.max(1)) - 1;
    }

    /// Replaces the pose of the tool on the flange; refuses one that is not finite.
    fn set_tool(&mut self, period: u64, flange_from_tool: Pose) {
        let finite = flange_from_tool.translation.vector.iter().all(|c| c.is_finite())
            && flange_from_tool.rotation.coords.iter().all(|c| c.is_finite());
        if !finite {
            self.refused = Some(MoveRefused::NotANumber);
            return;
        }
        // The arm does not move: the same motor positions give another pose of the tool, and a
        // straight line continues from that pose.
        self.flange_from_tool = flange_from_tool;
        self.set = self.set.moved_to(self.chain(), self.set.motors);
        if let Some(path) = &mut self.running {
            path.retarget(self.set.base_from_tool, period);
        }
    }

    /// Ends a fault: the measured positions become the set values, and the memories of regulators,
    /// filters and watchdogs are cleared.
    fn reset(&mut self, reading: &ArmReading) {
        let motors = motors_at(&self.config, reading);
        self.set = self.set.moved_to(self.chain(), motors);
        self.steps = [0.0; AXES];
        self.synchronised = is_synchronised(&self.config, reading);
        self.regulators.iter_mut().for_each(Regulator::reset);
        self.step_filters.iter_mut().for_each(StepFilter::reset);
        self.last_counts = reading.counts;
        self.watch.reset(reading.counts);
        // The jaw keeps its set value and its regulator, so that it does not drop the cube.
        self.law = ForceLaw::new(self.config.period);
        self.running = None;
        self.waiting = None;
        self.homing = None;
        self.braking = None;
        self.refused = None;
        self.fault = None;
    }

    /// Trips the arm if an axis has lost its synchronisation, and runs one period of the homing if
    /// one is under way. The call comes before any use of the counters.
    fn home(&mut self, period: u64, reading: &ArmReading, measured: &Measured) {
        self.homing_step = None;
        if self.synchronised && self.fault.is_none() {
            // Its counter no longer gives the position of the axis.
            let lost = required(&self.config) & !reading.synchronised;
            if lost != 0 {
                self.synchronised = false;
                let axis = lost.trailing_zeros() as usize;
                self.trip(period, ArmFault::SynchronisationLost { axis });
            }
        }
        let Some(homing) = &mut self.homing else { return };
        match homing.step(reading) {
            Ok(Some(step)) => {
                if step.zeroed {
                    self.rebase(step.axis, reading, measured);
                }
                self.homing_step = Some(step);
            }
            Ok(None) => {
                self.homing = None;
                self.synchronised = true;
                // The joints have a meaning only now.
                self.set = self.set.moved_to(self.chain(), self.set.motors);
                self.jaw.rebase(reading.jaw_count);
            }
            Err(fault) => self.trip(period, fault),
        }
    }

    /// Shifts the set value of an axis as far as its counter jumped when its controller set it to
    /// zero, so that the difference of set and measured value stays. The axis after the last motor
    /// is the jaw.
    fn rebase(&mut self, axis: usize, reading: &ArmReading, measured: &Measured) {
        if axis == JAW {
            self.jaw.rebase(reading.jaw_count);
            return;
        }
        let increments = self.config.model.increments[axis];
        let lead = self.set.motors.0[axis] - self.last_counts[axis] as f64 * TAU / increments;
        self.set.motors.0[axis] = measured.motors.0[axis] + lead;
        self.last_counts[axis] = reading.counts[axis];
        self.watch.rebase(axis, reading.counts[axis]);
    }

    /// Begins the waiting command if its first period has come. Refuses the command if its end
    /// exceeds a limit of the arm or of the jaw.
    fn begin_waiting(&mut self, period: u64) {
        let Some((command, begin)) = self.waiting else { return };
        if begin > period {
            return;
        }
        self.waiting = None;
        // Arm and jaw are checked before either of them starts, so a refused command moves neither.
        let periods = u64::from(command.periods.max(1));
        let end = period + periods - 1;
        let seconds = periods as f64 * self.config.period.seconds();
        let allowed = check_end(&command.motion, seconds, &self.set, self.chain())
            .and_then(|()| command.jaw.map_or(Ok(()), |jaw| self.jaw.check(&jaw, seconds)));
        if let Err(refused) = allowed {
            self.refuse(period, refused);
            return;
        }
        self.running = Some(Path::new(&command.motion, &self.set, period, end));
        self.command_end = end;
        // A hold may replace a fast motion.
        if matches!(command.motion, Motion::Hold) {
            self.brake_if_fast();
        }
        if let Some(jaw) = &command.jaw {
            self.jaw.start(jaw, period, end);
        }
    }

    /// Begins to brake if a set value moved so fast in the last period that a dead stop would trip
    /// a power stage. The caller is about to let the set values stop.
    fn brake_if_fast(&mut self) {
        let fast = Self::SUDDEN * self.config.period.seconds();
        let already = self.homing_step.is_some() || self.braking.is_some();
        if !already && self.steps.iter().any(|step| step.abs() > fast) {
            self.braking = Some(self.steps);
        }
    }

    /// Aborts the motion, because its command or its next set values are refused.
    fn refuse(&mut self, period: u64, refused: MoveRefused) {
        self.hold(period);
        self.refused = Some(refused);
    }

    /// Checks the reading with all watchdogs, and trips the arm on the first fault.
    fn watch(&mut self, period: u64, reading: &ArmReading, measured: &Measured) {
        if self.fault.is_some() {
            return;
        }
        let first = self.first_axis();
        let increments = &self.config.model.increments;
        let backlog = std::array::from_fn(|i| self.step_filters[i].backlog() * TAU / increments[i]);
        let wanted = Wanted { set: &self.set.motors, steps: &self.steps, backlog: &backlog };
        let axes = self.watch.check(reading, &measured.motors, &wanted, first);
        let by_force =
            self.running.as_ref().and_then(Path::directions).is_some_and(depends_on_force);
        // Only the force shows contact on a path to a place, for instance with a person's hand, and
        // a comparison with NaN is never true. Under force control a saturated sensor counts too.
        let goes = self.running.as_ref().is_some_and(Path::may_meet_obstacle);
        let unfit = by_force || (goes && self.wrist.fell_silent(&reading.wrench_on_sensor));
        let force = if unfit { self.wrist.fault(&reading.wrench_on_sensor) } else { None };
        // Before the arm is synchronised, the jaw's counter may jump to its zero.
        let jaw = self.jaw.watch(reading).filter(|_| self.synchronised);
        if let Some(fault) = axes.or(force).or(jaw) {
            self.trip(period, fault);
        }
    }

    /// Advances the set values of the arm by one period: along the path of the running motion, by a
    /// step of the homing, or by fading steps while the arm brakes. A path that leads beyond a
    /// limit is refused there.
    fn advance(&mut self, period: u64, wrench: &Wrench) {
        if self.running.is_none() {
            // No command continues a motion that may have ended at speed.
            self.brake_if_fast();
        }
        // Homing and braking move motors and not poses: the joints may have no meaning yet.
        if self.homing_step.is_some() || self.braking.is_some() {
            self.advance_motors();
            return;
        }
        let Some(path) = self.running else { return };
        // `chain()` would borrow all of `self`, and the law is borrowed mutably beside it.
        let chain = Chain { model: &self.config.model, flange_from_tool: &self.flange_from_tool };
        let feedback = ForceFeedback { law: &mut self.law, wrench };
        let next = path
            .at(period, &self.set, chain, feedback)
            .and_then(|next| self.check(&next).map(|()| next));
        match next {
            Ok(next) => {
                self.set = next;
                if period >= path.end {
                    self.running = None;
                }
            }
            Err(refused) => self.refuse(period, refused),
        }
    }

    /// Advances the set positions of the motors by a step of the homing, or by the fading steps of
    /// an aborted motion. Neither follows a path.
    fn advance_motors(&mut self) {
        let mut motors = self.set.motors;
        if let Some(step) = self.homing_step {
            match motors.0.get_mut(step.axis) {
                Some(motor) => *motor += step.step,
                // The axis after the last motor is the jaw.
                None => self.jaw.turn(step.step),
            }
        }
        let fade = self.fade;
        if let Some(steps) = &mut self.braking {
            for (motor, step) in motors.0.iter_mut().zip(steps.iter_mut()) {
                *step *= fade;
                *motor += *step;
            }
            if steps.iter().all(|step| step.abs() < Self::REST) {
                self.braking = None;
            }
        }
        let next = self.set.moved_to(self.chain(), motors);
        if self.check(&next).is_ok() {
            self.set = next;
        } else {
            // A limit ends the fading; there is no command left that could be refused.
            self.braking = None;
        }
    }

    /// Checks that the next set values keep the limits of joints, motors and speeds. For an arm
    /// that is not synchronised it checks the speeds only: the other limits have no meaning.
    fn check(&self, next: &SetValues) -> Result<(), MoveRefused> {
        let (model, seconds) = (&self.config.model, self.config.period.seconds());
        if self.synchronised {
            next.check(model, &self.set, seconds)
        } else {
            next.check_speed(model, &self.set, seconds)
        }
    }

    /// Returns the drive commands of this period: the pulse widths of the regulators, or drives
    /// that are off for an arm with a fault.
    fn drive(&mut self, reading: &ArmReading) -> ArmDrive {
        let mut drive = ArmDrive { enabled: self.fault.is_none(), ..ArmDrive::OFF };
        // `OFF` alone would move the palm's stops to their first position.
        drive.stops = self.jaw.stops();
        drive.synchronise = self.homing_step.map_or(0, |step| step.synchronise);
        if self.fault.is_some() {
            // The axes may move while the drives are off; that is no step of a later period.
            self.last_counts = reading.counts;
            self.jaw.off(reading);
            return drive;
        }
        for axis in self.first_axis()..AXES {
            let wanted = self.steps[axis] * self.config.model.increments[axis] / TAU;
            let moved = (reading.counts[axis] - self.last_counts[axis]) as f64;
            // The filter replaces steps that no motor makes, since the regulator would answer them
            // with a pulse that trips a power stage.
            let measured = self.step_filters[axis].filter(moved, self.regulators[axis].drive());
            let current = (reading.no_answer >> axis & 1 == 0).then_some(reading.currents[axis]);
            drive.pwm[axis] = self.regulators[axis].step(wanted, measured, current);
        }
        self.last_counts = reading.counts;
        // The first readings may be from before the gap, so the restart repeats while the arm
        // brakes.
        self.gap = match self.gap {
            Gap::GivenUp(left @ 1..) if self.braking.is_some() => Gap::GivenUp(left - 1),
            _ => Gap::None,
        };
        self.jaw.drive(reading, &mut drive);
        drive
    }

    /// Returns the state that the servo publishes: the measured values of the beginning of the
    /// period, and the set values of its end.
    fn state(&self, period: u64, reading: &ArmReading, measured: &Measured) -> ArmState {
        ArmState {
            period,
            motors: measured.motors,
            joints: measured.joints,
            base_from_tool: measured.base_from_flange * self.flange_from_tool,
            desired_joints: self.set.joints,
            desired_base_from_tool: self.set.base_from_tool,
            wrench_in_tool: measured.wrench,
            jaw_opening: self.jaw.opening_at(reading.jaw_count),
            desired_jaw_opening: self.jaw.set_value(),
            jaw_force: self.jaw.force_at(reading.currents[AXES]),
            command_end: self.command_end,
            refused: self.refused,
            fault: self.fault,
            synchronisation: match (self.homing_step, self.synchronised) {
                (Some(step), _) => Synchronisation::Under { axis: step.axis as u8 },
                (None, true) => Synchronisation::Yes,
                (None, false) => Synchronisation::No,
            },
            inputs: reading.inputs,
        }
    }

    /// Returns the kinematic chain from the base to the tool that is set at present.
    fn chain(&self) -> Chain<'_> {
        Chain { model: &self.config.model, flange_from_tool: &self.flange_from_tool }
    }

    /// Returns the index of the first axis that the arm has: 1 without a track, else 0.
    fn first_axis(&self) -> usize {
        usize::from(!self.config.model.has_track)
    }
}

/// The wrench as the force law gets it: late, or with a wrong sign, if a command has set this for a
/// demonstration.
#[derive(Debug, Clone, Copy)]
struct SeenWrench {
    settings: ForceSettings,
    past: [Wrench; SeenWrench::LENGTH],
    now: usize,
}

impl Default for SeenWrench {
    fn default() -> Self {
        Self { settings: ForceSettings::default(), past: [Wrench::default(); Self::LENGTH], now: 0 }
    }
}

impl SeenWrench {
    /// Number of remembered periods: enough for the longest delay.
    const LENGTH: usize = ForceSettings::LONGEST_DELAY as usize + 1;

    /// Stores the measured wrench of this period. Returns the wrench that the force law gets, with
    /// the delay and the sign of the settings.
    fn next(&mut self, wrench: Wrench) -> Wrench {
        self.now = (self.now + 1) % Self::LENGTH;
        self.past[self.now] = wrench;
        let delay = self.settings.delay_periods.min(ForceSettings::LONGEST_DELAY) as usize;
        let seen = self.past[(self.now + Self::LENGTH - delay) % Self::LENGTH];
        Wrench { force: self.settings.sign * seen.force, torque: self.settings.sign * seen.torque }
    }
}

/// Returns a bit mask of the axes that the arm has: bit 0 is the track, bit 7 the jaw.
fn required(config: &ServoConfig) -> u8 {
    if config.model.has_track { u8::MAX } else { !1 }
}

/// Returns whether the reading shows all axes of the arm as synchronised.
fn is_synchronised(config: &ServoConfig, reading: &ArmReading) -> bool {
    required(config) & !reading.synchronised == 0
}

/// Returns the motor positions that the encoder counts show (rad); 0 for a track that the arm does
/// not have.
fn motors_at(config: &ServoConfig, reading: &ArmReading) -> MotorPositions {
    let model = &config.model;
    MotorPositions(std::array::from_fn(|axis| {
        if axis == 0 && !model.has_track {
            0.0
        } else {
            reading.counts[axis] as f64 * TAU / model.increments[axis]
        }
    }))
}
