//! The checks of MP before a motion begins: whether its way is free as far as the believed cell
//! tells, and how fast it may be beside the operator's hand.
//!
//! - in: the guard, the arms that know where they are, the orders
//! - out: the obstacle that is too near, or whether the hands are to keep apart; slower orders

use crate::actors::move_instruction::Manner;
use crate::generators::Behaviour;
use crate::motion::ArmState;
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

/// Gives more time to ways that are too fast beside the operator's hand, to both arms as much, since
/// they are free when both go evenly. The visual servo has its own speed, and its way is not known
/// before.
pub(super) fn slow_down(
    guard: &Guard,
    known: [Option<&ArmState>; 2],
    manners: &[Manner],
    orders: &mut [Option<Behaviour>; 2],
) {
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
                let course = guard.course(i, &known[i]?.desired_joints, &ways[i]);
                Some(course.haste(seconds, |part| profile.share(part, seconds)))
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
