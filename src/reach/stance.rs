//! Stances: the joint positions that bring the tool of one arm to a pose with room to work.
//!
//! - in: a [`Demand`] and the tool's pose in the world
//! - out: the two cheapest [`Stance`]s; the cost of a stance is the time of the motion to it from
//!   reference joint positions, plus penalties
//!
//! | a stance is refused if | threshold |
//! |---|---|
//! | the wrist is near its singularity | `WRIST` |
//! | a joint is near its limit at the meeting | `MARGIN` |
//! | a joint is near its limit, retracted or shifted | `SMALL_MARGIN` |
//! | a motor is near its limit, by its share of the range | `MOTOR_MARGIN` |
//! | a quarter turn of a layer, either way, leaves too little roll | `ROLL_MARGIN` |
//! | a joint moves far while the arm retracts | `BACK_MOST` |
//!
//! | a stance is penalised if | by at most |
//! |---|---|
//! | a joint is within 0.15 (m or rad) of its limit | 2 s |
//! | the sine of q5 is below 0.5 | 2 s |
//! | the wrist has no room for a half turn of a layer | 4 s |

use super::settings::ReachSettings;
use crate::cell::Arm;
use crate::motion::JointPositions;
use crate::spatial::Pose;
use nalgebra::{Translation3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Least sine of q5, in absolute value. Nearer to the wrist's singularity small corrections need
/// large motions.
const WRIST: f64 = 0.25;
/// Least distance of the joints from their limits at the meeting itself (m or rad).
const MARGIN: f64 = 0.04;
/// Least distance of the joints from their limits after a shift or a retraction (m or rad).
const SMALL_MARGIN: f64 = 0.01;
/// Least distance of the motors from their limits, as a share of their range.
const MOTOR_MARGIN: f64 = 0.01;
/// Roll that must be left to the limit after a quarter or half turn of a layer (rad).
const ROLL_MARGIN: f64 = 0.15;
/// Farthest motion of one joint while the arm retracts (rad).
const BACK_MOST: f64 = 0.9;
/// Joint speeds by which motions are timed (m/s or rad/s): half of the greatest speeds of the
/// original robot's drives.
const SPEEDS: [f64; 7] = [0.08, 0.8, 0.8, 0.8, 1.0, 1.6, 0.43];

/// Joint positions that bring the tool to the wanted pose, and those of the retraction from there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stance {
    pub(super) joints: JointPositions,
    /// Joint positions when the hand has retracted by half of [`ReachSettings::back`].
    pub(super) half_back: JointPositions,
    /// Joint positions when the hand has retracted by all of it, along the tool's axis.
    pub(super) back: JointPositions,
    /// Lowest and highest angle by which the last joint can roll from here (rad).
    pub(super) roll: (f64, f64),
    /// Time of the motion from the reference, plus penalties for narrow margins (s).
    pub(super) cost: f64,
}

/// Demand on the roll of a wrist.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Roll {
    /// The wrist must be able to turn a layer of the cube from here.
    Needed,
    /// The wrist need not roll.
    Free,
}

/// Demand on a stance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Demand<'a> {
    pub(super) arm: &'a Arm,
    /// Travel of the track, d0 (m).
    pub(super) track: f64,
    pub(super) roll: Roll,
    /// Joint positions from which the motion to the stance is timed.
    pub(super) reference: &'a JointPositions,
    /// Upper bound of the stance's cost (s).
    pub(super) limit: f64,
    pub(super) settings: &'a ReachSettings,
}

/// Returns the two cheapest stances that bring the tool to `world_from_tool` and meet the demand,
/// the cheapest first.
pub(super) fn stances(demand: &Demand<'_>, world_from_tool: &Pose) -> Stances {
    let arm = demand.arm;
    let base_from_flange =
        arm.world_from_base.inverse() * world_from_tool * arm.flange_from_tool.inverse();
    let mut found = Stances::default();
    for joints in arm.model.branches(&base_from_flange, demand.track).as_slice() {
        if let Some(stance) = stance(demand, &base_from_flange, joints) {
            found.push(stance);
        }
    }
    found
}

/// The two cheapest stances, the cheapest first; `None` where fewer were found.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Stances(pub(super) [Option<Stance>; 2]);

impl Stances {
    /// Keeps `stance` if it is one of the two cheapest so far.
    fn push(&mut self, stance: Stance) {
        let cheaper = |slot: &Option<Stance>| slot.is_none_or(|s| stance.cost < s.cost);
        if cheaper(&self.0[0]) {
            self.0[1] = self.0[0].replace(stance);
        } else if cheaper(&self.0[1]) {
            self.0[1] = Some(stance);
        }
    }

    /// Iterates over the stances that were found, the cheapest first.
    pub(super) fn iter(&self) -> impl Iterator<Item = Stance> {
        self.0.into_iter().flatten()
    }
}

/// Returns the stance at these joint positions, or `None` if it does not meet the demand.
fn stance(demand: &Demand<'_>, base_from_flange: &Pose, joints: &JointPositions) -> Option<Stance> {
    let Demand { arm, roll: need, reference, limit, settings, .. } = *demand;
    let margin = margin(arm, joints);
    let sine = libm::sin(joints.0[5]).abs();
    if margin < MARGIN || sine < WRIST {
        return None;
    }
    let roll = rolls(arm, joints);
    let quarter = FRAC_PI_2 + ROLL_MARGIN;
    if need == Roll::Needed && (roll.0 > -quarter || roll.1 < quarter) {
        return None;
    }
    let half_turn = PI + ROLL_MARGIN;
    // The cheap tests come first: most samples of the search end here.
    let cost = motion_cost(joints, reference) + penalty(margin, 0.15) + penalty(sine, 0.5);
    if cost >= limit {
        return None;
    }
    let tool = arm.flange_from_tool.rotation * Vector3::z();
    let at = |shift: Vector3<f64>, near: &JointPositions| -> Option<JointPositions> {
        let pose = base_from_flange * Translation3::from(shift);
        let there = arm.model.inverse(&pose, near).ok()?;
        // The sine of q5 must keep its sign: through zero the wrist would flip to its other branch.
        let smooth = libm::sin(there.0[5]) * libm::sin(joints.0[5]) > 0.0;
        (smooth && self::margin(arm, &there) > SMALL_MARGIN).then_some(there)
    };
    // The inverse kinematics of the retracted place starts from the half-way one, so that it stays
    // on the branch.
    let half = at(-0.5 * settings.back * tool, joints)?;
    let back = at(-settings.back * tool, &half)?;
    if back.0.iter().zip(&joints.0).any(|(b, q)| (b - q).abs() > BACK_MOST) {
        return None;
    }
    // After a turn of a layer the hand retracts without rolling back, so the roll must also be
    // possible at the retracted places.
    let roll = [&half, &back].into_iter().fold(roll, |(low, high), there| {
        let (there_low, there_high) = rolls(arm, there);
        (low.max(there_low), high.min(there_high))
    });
    let halves = |(low, high): (f64, f64)| low <= -half_turn || high >= half_turn;
    if need == Roll::Needed && (roll.0 > -quarter || roll.1 < quarter) {
        return None;
    }
    let cost = cost + if need == Roll::Needed && !halves(roll) { 4.0 } else { 0.0 };
    // Grasps at other depths, and corrections of the tool's place, must be within reach as well.
    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
        at(settings.shift * axis, joints)?;
        at(-settings.shift * axis, joints)?;
    }
    Some(Stance { joints: *joints, half_back: half, back, roll, cost })
}

/// Returns the penalty (s) for a margin `have` that is less than `good`: 2 s at a margin of zero,
/// less in proportion up to `good`.
fn penalty(have: f64, good: f64) -> f64 {
    2.0 * (1.0 - have / good).max(0.0)
}

/// Returns the cost of the motion from one set of joint positions to another at [`SPEEDS`] (s): the
/// slowest joint's time, plus a tenth of the sum of all joints' times.
pub(super) fn motion_cost(a: &JointPositions, b: &JointPositions) -> f64 {
    let times = std::array::from_fn::<f64, 7, _>(|i| (a.0[i] - b.0[i]).abs() / SPEEDS[i]);
    // The sum decides between motions whose slowest joint takes equally long.
    let slowest = times.iter().copied().fold(0.0, f64::max);
    slowest + 0.1 * times.iter().sum::<f64>()
}

/// Returns the least distance of a joint from its limits (m or rad), the last joint left out.
/// Returns -1 if any joint is outside its limits, or any motor nearer to its own than
/// [`MOTOR_MARGIN`].
fn margin(arm: &Arm, joints: &JointPositions) -> f64 {
    let model = &arm.model;
    // An arm without a track has no axis 0. For the distance of the last joint see `rolls`.
    let first = usize::from(!model.has_track);
    let room = |value: f64, (low, high): (f64, f64)| (value - low).min(high - value);
    let mut least = f64::INFINITY;
    for axis in first..6 {
        least = least.min(room(joints.0[axis], model.joint_limits[axis]));
    }
    if room(joints.0[6], model.joint_limits[6]) < 0.0 || least < 0.0 {
        return -1.0;
    }
    // Motors are checked apart from joints: some are coupled, so their limits cut the joints'
    // ranges.
    let motors = model.motors(joints);
    for axis in first..7 {
        let limits = model.motor_limits[axis];
        if room(motors.0[axis], limits) < MOTOR_MARGIN * (limits.1 - limits.0) {
            return -1.0;
        }
    }
    least
}

/// Returns the lowest and the highest angle by which the last joint can roll from these positions,
/// inside the limits of the joint and of its motor (rad).
fn rolls(arm: &Arm, joints: &JointPositions) -> (f64, f64) {
    let model = &arm.model;
    let (low, high) = model.joint_limits[6];
    let motor = model.motors(joints).0[6];
    let ends = [model.motor_limits[6].0, model.motor_limits[6].1]
        .map(|limit| (limit - motor) / model.gears[6]);
    // A gear may be negative, so the ends are sorted.
    let (down, up) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
    ((low - joints.0[6]).max(down), (high - joints.0[6]).min(up))
}
