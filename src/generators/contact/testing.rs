//! An arm without inertia that follows the law of the servo against a surface, for tests.

use super::super::inputs::Inputs;
use super::super::outcome::{Next, Outcome};
use super::super::own::{MotionGenerator, Site};
use super::super::testing::{compliance, speeds};
use crate::motion::{ArmState, Direction, Frame, Motion};
use crate::servo::tff::{ForceLaw, TaskMotion};
use crate::spatial::{Pose, Wrench};
use nalgebra::Vector3;

/// Arm whose tool is always at its set pose.
pub(super) struct Arm {
    pub(super) pose: Pose,
    law: ForceLaw,
    period: u64,
}

impl Arm {
    /// Makes an arm at a pose.
    pub(super) fn at(pose: Pose) -> Self {
        Self { pose, law: ForceLaw::default(), period: 1 }
    }

    /// Returns the state of the arm under this force of the tool on its surroundings, in base axes
    /// (N).
    pub(super) fn state(&self, force: Vector3<f64>) -> ArmState {
        let wrench_in_tool =
            Wrench { force: self.pose.rotation.inverse() * force, torque: Vector3::zeros() };
        ArmState {
            period: self.period,
            base_from_tool: self.pose,
            desired_base_from_tool: self.pose,
            wrench_in_tool,
            ..ArmState::default()
        }
    }

    /// Moves the arm on by one period under this force.
    pub(super) fn period(&mut self, motion: &Motion, force: Vector3<f64>) {
        self.period += 1;
        let hold = (Frame::Tool, [Direction::HOLD; 6]);
        let (frame, directions) = match motion {
            Motion::Task { frame, directions } => (*frame, *directions),
            Motion::Hold => hold,
            other => panic!("not a task motion: {other:?}"),
        };
        let wrench = self.state(force).wrench_in_tool;
        let task = TaskMotion { frame, directions };
        self.pose = self.law.step(self.period, &task, &wrench, &self.pose);
    }
}

/// Runs a generator on an arm until it ends, at most for `seconds`. `force` gives the force of the
/// tool on its surroundings in base axes (N), from the position of the tool, its velocity (m/s) and
/// the time (s). `look` gets the state at each macrostep. Returns the outcome and the arm then.
pub(super) fn run<G: MotionGenerator>(
    order: G::Order,
    start: Pose,
    seconds: f64,
    force: impl Fn(Vector3<f64>, Vector3<f64>, f64) -> Vector3<f64>,
    mut look: impl FnMut(&ArmState),
) -> Result<(Option<Outcome>, Arm), String> {
    let mut arm = Arm::at(start);
    let mut state = arm.state(Vector3::zeros());
    let site = Site { compliance: compliance(), speeds: speeds(), arm: &state, fraction: 1.0 };
    let mut generator = G::begin(order, &site)?;
    let (mut last, mut now) = (start.translation.vector, 0.0);
    while now < seconds {
        let inputs =
            Inputs { arm: &state, target: None, reading: None, period: state.period, pace: 1.0 };
        let command = match generator.next(&inputs) {
            Next::Go(command) => command,
            Next::Done(outcome) => return Ok((Some(outcome), arm)),
        };
        // The state comes two periods before the end of the macrostep.
        for period in 0..8 {
            let at = arm.pose.translation.vector;
            let push = force(at, (at - last) / 0.002, now);
            last = at;
            if period == 6 {
                state = arm.state(push);
            }
            arm.period(&command.motion, push);
            now += 0.002;
        }
        look(&state);
    }
    Ok((None, arm))
}
