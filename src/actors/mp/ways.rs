//! The checks of MP before a motion begins: whether its way is free as far as the believed cell
//! tells, and how fast it may be beside the operator's hand.
//!
//! - in: the guard, the arms that know where they are, the orders
//! - out: the obstacle that is too near, or whether the hands are to keep apart; slower orders

use crate::actors::move_instruction::Manner;
use crate::generators::Behaviour;
use crate::generators::legs::{Leg, Legs};
use crate::generators::profile::Profile;
use crate::motion::{ArmState, JointPositions};
use crate::reach::guard::{Guard, Near, PlannedMotion};
use crate::spatial::Pose;

/// Most times that a way is given more time. A longer motion has longer ramps until they are full
/// ones, so that the speed where the hand is may fall by less than the time grew.
const ROUNDS: u32 = 4;
/// A way that is too fast by less is slow enough.
const ENOUGH: f64 = 1.0 + 1e-9;

/// Checks the ways of both arms; returns whether the hands are to keep apart meanwhile.
///
/// # Errors
/// The obstacle to which an arm would come too near.
pub(super) fn check(
    guard: &Guard,
    known: [Option<&ArmState>; 2],
    orders: &[Option<Behaviour>; 2],
) -> Result<bool, Near> {
    let from = known.map(|arm| arm.map(|arm| &arm.desired_joints));
    let ways = ways_of(known, orders, way);
    guard.ways(from, ways.each_ref())?;
    let led = ways_of(known, orders, way_at_most);
    Ok(guard.keep_apart(from, led.each_ref()))
}

/// Gives more time to ways that are too fast beside the operator's hand or for a motor, to both
/// arms as much, since they are free when both go evenly. The visual servo has its own speed, and
/// its way is not known before.
pub(super) fn slow_down(
    guard: &Guard,
    known: [Option<&ArmState>; 2],
    manners: &[Manner],
    orders: &mut [Option<Behaviour>; 2],
) {
    slow_ends(guard, known, manners, orders);
    let ways = ways_of(known, orders, way);
    let lasts: [f64; 2] = std::array::from_fn(|i| match (&orders[i], manners.get(i), known[i]) {
        (Some(order), Some(manner), Some(arm)) => manner.seconds(order, arm),
        _ => 0.0,
    });
    let mut slower = 1.0;
    for _ in 0..ROUNDS {
        let haste = (0..2)
            .filter(|&i| lasts[i] > 0.0)
            .filter_map(|i| {
                let (seconds, profile) = (slower * lasts[i], manners.get(i)?.speeds.profile);
                let legs = matches!(orders[i], Some(Behaviour::Legs { .. }));
                let share = |part| if legs { part } else { profile.share(part, seconds) };
                let course = || Some(guard.course(i, &known[i]?.desired_joints, &ways[i]));
                Some(course()?.haste(seconds, share).max(course()?.rush(seconds, share)))
            })
            .fold(1.0, f64::max);
        if haste <= ENOUGH {
            break;
        }
        slower *= haste;
    }
    if slower <= 1.0 {
        return;
    }
    for (i, order) in orders.iter_mut().enumerate().filter(|(i, _)| lasts[*i] > 0.0) {
        if let (Some(order), Some(manner), Some(arm)) = (order, manners.get(i), known[i]) {
            manner.last(order, arm, slower * lasts[i]);
        }
    }
}

/// Gives more time to the beginning and the end alone of motions of joints that begin or end beside
/// the operator's hand: the way stays the same, and so does the share of it that both arms have
/// gone.
fn slow_ends(
    guard: &Guard,
    known: [Option<&ArmState>; 2],
    manners: &[Manner],
    orders: &mut [Option<Behaviour>; 2],
) {
    let moves: Vec<JointsMove<'_>> = (0..2)
        .filter_map(|arm| match orders[arm]? {
            Behaviour::Joints { target, speed, seconds } => {
                let (from, manner) = (&known[arm]?.desired_joints, manners.get(arm)?);
                Some(JointsMove { arm, from, target, speed, seconds, manner })
            }
            _ => None,
        })
        .collect();
    let others = orders.iter().flatten().count() > moves.len();
    let Some(first) = moves.first().filter(|_| !others) else { return };
    let profile = first.manner.speeds.profile;
    let all =
        |begin: f64, end: f64| moves.iter().map(|m| m.seconds(begin, end)).fold(0.0, f64::max);
    let haste = |begin: f64, end: f64, seconds: f64| {
        let of = |m: &JointsMove<'_>| {
            let way = PlannedMotion::Joints(m.at(end));
            guard
                .course(m.arm, &m.at(begin), &way)
                .haste(seconds, |part| profile.share(part, seconds))
        };
        moves.iter().map(of).fold(0.0, f64::max)
    };
    let whole = all(0.0, 1.0);
    if haste(0.0, 1.0, whole) <= ENOUGH || moves.iter().any(|m| m.seconds > 1.01 * whole) {
        return;
    }
    let (until, from) = moves.iter().fold((0.0_f64, 1.0_f64), |(until, from), m| {
        let way = PlannedMotion::Joints(m.target);
        let (begin, end) = guard.course(m.arm, m.from, &way).near_ends();
        (until.max(begin), from.min(end))
    });
    if until >= from {
        return;
    }
    // Each end is slow enough by itself, and then as a part of the whole.
    let slow = |begin: f64, end: f64| {
        let mut seconds = all(begin, end);
        for _ in 0..ROUNDS {
            seconds *= haste(begin, end, seconds).max(1.0);
        }
        if begin < end { seconds } else { 0.0 }
    };
    let lasts = [slow(0.0, until), all(until, from), slow(from, 1.0)];
    let at_once = |a: f64, b: f64| 0.5 * profile.ramp.min(0.5 * a).min(0.5 * b);
    let overlaps = [at_once(lasts[0], lasts[1]), at_once(lasts[1], lasts[2])];
    let total = lasts.iter().sum::<f64>() - overlaps[0] - overlaps[1];
    if total >= whole * haste(0.0, 1.0, whole) {
        return;
    }
    let begins = [0.0, lasts[0] - overlaps[0], total - lasts[2]].map(|begin| begin / total);
    let ends = [until, from, 1.0];
    for m in &moves {
        let leg = |i: usize| Leg {
            to: if i == 2 { m.target } else { m.at(ends[i]) },
            window: (begins[i], (begins[i] + lasts[i] / total).min(1.0)),
        };
        let profile = Profile { ramp: profile.ramp / total };
        let legs = Legs { legs: [0, 1, 2].map(leg), profile, roll: profile };
        orders[m.arm] = Some(Behaviour::Legs { legs, seconds: total });
    }
}

/// A motion of joints that is ordered.
struct JointsMove<'a> {
    arm: usize,
    from: &'a JointPositions,
    target: JointPositions,
    speed: f64,
    seconds: f64,
    manner: &'a Manner,
}

impl JointsMove<'_> {
    /// Returns where the arm is after a share of its way.
    fn at(&self, share: f64) -> JointPositions {
        self.from.towards(&self.target, share)
    }

    /// Returns how long the way from one share to another takes by itself (s).
    fn seconds(&self, begin: f64, end: f64) -> f64 {
        self.manner.speeds.joints_seconds(&self.at(begin), &self.at(end), self.speed)
    }
}

fn ways_of(
    known: [Option<&ArmState>; 2],
    orders: &[Option<Behaviour>; 2],
    way: impl Fn(Option<&Behaviour>, &ArmState) -> PlannedMotion,
) -> [PlannedMotion; 2] {
    [0, 1].map(|i: usize| known[i].map_or(PlannedMotion::Stays, |arm| way(orders[i].as_ref(), arm)))
}

/// Returns how a behaviour moves an arm, as far as that is known before. An approach ends where it
/// touches its target, the table among others, and slowly.
fn way(order: Option<&Behaviour>, arm: &ArmState) -> PlannedMotion {
    match order {
        Some(Behaviour::Joints { target, .. }) => PlannedMotion::Joints(*target),
        Some(Behaviour::Legs { legs, .. }) => PlannedMotion::Legs(*legs),
        Some(Behaviour::Line { target, .. }) => PlannedMotion::Line(*target),
        Some(Behaviour::Withdraw { distance, .. }) => {
            PlannedMotion::Line(arm.desired_base_from_tool * Pose::translation(0.0, 0.0, -distance))
        }
        _ => PlannedMotion::Stays,
    }
}

/// Returns the same with an approach as far as it may go: whether it leads to the other hand.
fn way_at_most(order: Option<&Behaviour>, arm: &ArmState) -> PlannedMotion {
    match order {
        Some(Behaviour::Approach { distance, .. }) => {
            PlannedMotion::Line(arm.desired_base_from_tool * Pose::translation(0.0, 0.0, *distance))
        }
        order => way(order, arm),
    }
}
