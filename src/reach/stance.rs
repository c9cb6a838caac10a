//! One arm at one place: which joint positions take its tool there with room to work.

use super::settings::ReachSettings;
use crate::cell::Arm;
use crate::motion::JointPositions;
use crate::spatial::Pose;
use nalgebra::{Translation3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Least |sin q5|: nearer to the wrist's singularity small corrections need large motions.
const WRIST: f64 = 0.25;
/// Distance to the limits at the meeting itself (m or rad).
const MARGIN: f64 = 0.04;
/// Distance to the limits after a shift or a drawing back (m or rad).
const SMALL_MARGIN: f64 = 0.01;
/// Distance of the motors to their limits, as a part of their range.
const MOTOR_MARGIN: f64 = 0.01;
/// What a roll of 90 or 180 deg must leave to the limit (rad).
const ROLL_MARGIN: f64 = 0.15;
/// Farthest that one joint goes while the arm draws back (rad).
const BACK_MOST: f64 = 0.9;
/// Joint speeds by which ways are weighed [m/s or rad/s]: half of what the original's drives allow.
const SPEEDS: [f64; 7] = [0.08, 0.8, 0.8, 0.8, 1.0, 1.6, 0.43];

/// Joint positions that take the tool to the wanted place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stance {
    pub(super) joints: JointPositions,
    /// Half-way drawn back.
    pub(super) half_back: JointPositions,
    /// Drawn back along the tool's own axis.
    pub(super) back: JointPositions,
    /// Room of the last joint, relative (rad).
    pub(super) roll: (f64, f64),
    /// Seconds: the way from the reference, and fines for narrow margins.
    pub(super) cost: f64,
}

/// Whether the wrist has to be able to turn a layer from here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Roll {
    Needed,
    Free,
}

/// What a stance must offer.
#[derive(Debug, Clone, Copy)]
pub(super) struct Demand<'a> {
    pub(super) arm: &'a Arm,
    /// d0 (m).
    pub(super) track: f64,
    pub(super) roll: Roll,
    /// The place from which ways are counted.
    pub(super) reference: &'a JointPositions,
    /// The stance must cost less than this (s).
    pub(super) limit: f64,
    pub(super) settings: &'a ReachSettings,
}

/// Returns the stances of the arm with its tool at `world_from_tool`, cheapest first.
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

/// The two cheapest stances.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Stances(pub(super) [Option<Stance>; 2]);

impl Stances {
    fn push(&mut self, stance: Stance) {
        let cheaper = |slot: &Option<Stance>| slot.is_none_or(|s| stance.cost < s.cost);
        if cheaper(&self.0[0]) {
            self.0[1] = self.0[0].replace(stance);
        } else if cheaper(&self.0[1]) {
            self.0[1] = Some(stance);
        }
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = Stance> {
        self.0.into_iter().flatten()
    }
}

/// Returns the stance at these joints, if it offers enough.
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
    let cost = way(joints, reference) + fine(margin, 0.15) + fine(sine, 0.5);
    if cost >= limit {
        return None;
    }
    let tool = arm.flange_from_tool.rotation * Vector3::z();
    let at = |shift: Vector3<f64>, near: &JointPositions| -> Option<JointPositions> {
        let pose = base_from_flange * Translation3::from(shift);
        let there = arm.model.inverse(&pose, near).ok()?;
        let smooth = libm::sin(there.0[5]) * libm::sin(joints.0[5]) > 0.0;
        (smooth && self::margin(arm, &there) > SMALL_MARGIN).then_some(there)
    };
    let half = at(-0.5 * settings.back * tool, joints)?;
    let back = at(-settings.back * tool, &half)?;
    if back.0.iter().zip(&joints.0).any(|(b, q)| (b - q).abs() > BACK_MOST) {
        return None;
    }
    // The hand draws back with the roll that a turn has left it in.
    let roll = [&half, &back].into_iter().fold(roll, |(low, high), there| {
        let (there_low, there_high) = rolls(arm, there);
        (low.max(there_low), high.min(there_high))
    });
    let halves = |(low, high): (f64, f64)| low <= -half_turn || high >= half_turn;
    if need == Roll::Needed && (roll.0 > -quarter || roll.1 < quarter) {
        return None;
    }
    let cost = cost + if need == Roll::Needed && !halves(roll) { 4.0 } else { 0.0 };
    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
        at(settings.shift * axis, joints)?;
        at(-settings.shift * axis, joints)?;
    }
    Some(Stance { joints: *joints, half_back: half, back, roll, cost })
}

/// Seconds for being nearer than `good` to something bad: up to 2.
fn fine(have: f64, good: f64) -> f64 {
    2.0 * (1.0 - have / good).max(0.0)
}

/// Time from one place to another at [`SPEEDS`], the slowest joint's, and a little of all others'
/// (s).
pub(super) fn way(a: &JointPositions, b: &JointPositions) -> f64 {
    let times = std::array::from_fn::<f64, 7, _>(|i| (a.0[i] - b.0[i]).abs() / SPEEDS[i]);
    let slowest = times.iter().copied().fold(0.0, f64::max);
    slowest + 0.1 * times.iter().sum::<f64>()
}

/// Distance to the nearest limit of a joint but the last (m or rad); negative outside the limits of
/// any joint, or nearer to a motor's limit than its margin.
fn margin(arm: &Arm, joints: &JointPositions) -> f64 {
    let model = &arm.model;
    let first = usize::from(!model.has_track);
    let room = |value: f64, (low, high): (f64, f64)| (value - low).min(high - value);
    let mut least = f64::INFINITY;
    for axis in first..6 {
        least = least.min(room(joints.0[axis], model.joint_limits[axis]));
    }
    if room(joints.0[6], model.joint_limits[6]) < 0.0 || least < 0.0 {
        return -1.0;
    }
    let motors = model.motors(joints);
    for axis in first..7 {
        let limits = model.motor_limits[axis];
        if room(motors.0[axis], limits) < MOTOR_MARGIN * (limits.1 - limits.0) {
            return -1.0;
        }
    }
    least
}

/// How far the last joint can roll either way inside the limits of joint and motor (rad).
fn rolls(arm: &Arm, joints: &JointPositions) -> (f64, f64) {
    let model = &arm.model;
    let (low, high) = model.joint_limits[6];
    let motor = model.motors(joints).0[6];
    let ends = [model.motor_limits[6].0, model.motor_limits[6].1]
        .map(|limit| (limit - motor) / model.gears[6]);
    let (down, up) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
    ((low - joints.0[6]).max(down), (high - joints.0[6]).min(up))
}
