//! The checks before a motion begins: whether its path is free in the believed cell, and how fast
//! it may be near the operator's hand. MP makes them for its own orders, an ECP for those of its
//! programme.
//!
//! - in: the guard, the synchronised arms, the orders
//! - out: the obstacle that is too near, the path that leaves the reach of its arm, or whether the
//!   hands are to keep apart; slower orders
//! - thresholds of places and speeds: those of [`crate::reach::guard`]

use super::move_instruction::Manner;
use crate::cell::{MOST_ARMS, PerArm};
use crate::error::NonFatal;
use crate::generators::Behaviour;
use crate::generators::legs::{Leg, Legs};
use crate::generators::own::Forecast;
use crate::generators::profile::Profile;
use crate::motion::{ArmState, JointPositions, MoveRefused};
use crate::reach::guard::{Guard, Near, PlannedMotion};
use crate::reach::pairs::Pairs;
use crate::spatial::Pose;
use std::sync::Arc;

/// Most rounds in which [`slow_enough`] gives a motion more time. A longer motion also has longer
/// ramps until they reach their full length, so within a ramp the speed near the hand falls only
/// with the cube root of the time. A speed three times too large needs about twenty rounds then;
/// most motions need two.
const ROUNDS: u32 = 40;
/// Largest ratio of a speed to its limit that counts as slow enough; it leaves room for rounding.
const ENOUGH: f64 = 1.0 + 1e-9;

/// State of the guarded arms as the checks need it.
#[derive(Clone, Copy, Default)]
pub(super) struct Known<'a> {
    /// States of the synchronised arms.
    pub(super) arms: PerArm<Option<&'a ArmState>>,
    /// Tool frame of each arm that is in force (`flange_from_tool`), where a task has changed it.
    pub(super) tools: PerArm<Option<Pose>>,
    /// Parameters of the generators of the arms that have an order.
    pub(super) manners: PerArm<Option<&'a Manner>>,
}

/// Courses that registered generators of the arms have declared; `None` without one.
pub(super) type Forecasts = PerArm<Option<Arc<Forecast>>>;

/// Returns a guard with the present openings of the jaws, from which it concludes which hands hold
/// a cube.
pub(super) fn present(guard: &Guard, arms: PerArm<Option<&ArmState>>) -> Guard {
    let mut guard = guard.clone();
    guard.holding(arms.map(|arm| arm.map(|arm| arm.jaw_opening)));
    guard
}

/// Returns the course that the registered generator of an order declares for an arm in the state
/// `arm`; `None` for any other order, or without a course.
///
/// # Errors
/// If the generator is unknown or refuses its order, or the order has a speed outside of 0 to 1.
pub(super) fn forecast(
    order: &Behaviour,
    manner: &Manner,
    arm: &ArmState,
) -> Result<Option<Arc<Forecast>>, NonFatal> {
    check_speed(order)?;
    let Behaviour::Own(own) = order else { return Ok(None) };
    let forecast = manner.library.forecast(own, &manner.site(arm)).map_err(NonFatal::Arguments)?;
    Ok(forecast.map(Arc::new))
}

/// Checks the share of the full speed that a free motion asks for: with 0 it would never end.
///
/// # Errors
/// The share, if it is not above 0 and at most 1.
fn check_speed(order: &Behaviour) -> Result<(), NonFatal> {
    match order {
        Behaviour::Joints { speed, .. } | Behaviour::Line { speed, .. }
            if !(*speed > 0.0 && *speed <= 1.0) =>
        {
            let why = format!(
                "the speed is {speed}; it must be above 0 and at most 1, a share of the full one"
            );
            Err(NonFatal::Arguments(why))
        }
        _ => Ok(()),
    }
}

/// Reason why ordered motions must not begin.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(super) enum Inadmissible {
    /// An obstacle, or the other arm.
    #[error(transparent)]
    Near(#[from] Near),
    /// A line or a declared course that the arm cannot follow to its end.
    #[error("the {arm} arm cannot follow its path{to} beyond {:.0} %: {why}", .share * 100.0)]
    BeyondReach {
        /// Name of the arm.
        arm: String,
        /// Target of a line, as " to x 400, y 0, z 760 mm of its base"; empty for other paths.
        to: String,
        /// Share of the path that the arm can follow, 0..=1.
        share: f64,
        /// Limit that ends the path.
        why: MoveRefused,
    },
}

/// Checks that the ordered motions bring no arm too near an obstacle and stay within its reach, and
/// gives more time to those that are too fast. Returns the pairs whose hands may meet during the
/// motions.
///
/// # Errors
/// The reason why the motions must not begin. The orders stay as they were then.
pub(super) fn admit(
    guard: &Guard,
    known: Known<'_>,
    orders: &mut [Option<Behaviour>],
    forecasts: &Forecasts,
) -> Result<Pairs, Inadmissible> {
    check_reach(guard, known, orders, forecasts)?;
    let joined = check_paths(guard, known, orders, forecasts)?;
    slow_down(guard, known, orders, forecasts);
    Ok(joined)
}

/// Checks that the arms can follow their ordered lines and declared courses to the end.
///
/// # Errors
/// The arm that cannot, and the limit.
fn check_reach(
    guard: &Guard,
    known: Known<'_>,
    orders: &[Option<Behaviour>],
    forecasts: &Forecasts,
) -> Result<(), Inadmissible> {
    let ways = paths_of(guard, known, orders, forecasts, path);
    for (i, order) in orders.iter().enumerate().take(MOST_ARMS) {
        // Other motions end where they touch something, or wherever else their reach ends.
        let whole = matches!(order, Some(Behaviour::Line { .. } | Behaviour::Own(_)));
        let Some((name, arm)) = guard.name(i).zip(known.arms[i]).filter(|_| whole) else {
            continue;
        };
        let course = guard.course(i, &arm.desired_joints, &ways[i]);
        if let Some((share, why)) = course.beyond_reach() {
            let (arm, to) = (name.to_owned(), order.as_ref().map_or_else(String::new, target));
            return Err(Inadmissible::BeyondReach { arm, to, share, why });
        }
    }
    Ok(())
}

/// Returns the target of a line in words; empty for another order.
fn target(order: &Behaviour) -> String {
    let Behaviour::Line { target, .. } = order else { return String::new() };
    let [x, y, z] = target.translation.vector.map(|place| place * 1e3).into();
    format!(" to x {x:.0}, y {y:.0}, z {z:.0} mm of its base")
}

/// Checks that the ordered motions bring no arm too near an obstacle. Returns the pairs whose
/// hands may meet during the motions.
///
/// # Errors
/// The obstacle to which an arm would come too near.
fn check_paths(
    guard: &Guard,
    known: Known<'_>,
    orders: &[Option<Behaviour>],
    forecasts: &Forecasts,
) -> Result<Pairs, Near> {
    let from = known.arms.map(|arm| arm.map(|arm| &arm.desired_joints));
    let ways = paths_of(guard, known, orders, forecasts, path);
    guard.check_paths(from, ways.each_ref())?;
    // An approach may lead to the other hand: it counts here, though its path is not checked.
    let led = paths_of(guard, known, orders, forecasts, longest_path);
    Ok(guard.may_meet(from, led.each_ref()))
}

/// Gives more time to ordered motions that are too fast near the operator's hand or for a motor.
/// The times of all arms get the same factor, since their paths are free only if all arms have
/// done the same share of them at each moment. A visual servo keeps its own speed, because its path
/// is unknown beforehand.
fn slow_down(
    guard: &Guard,
    known: Known<'_>,
    orders: &mut [Option<Behaviour>],
    forecasts: &Forecasts,
) {
    slow_ends(guard, known, orders);
    let ways = paths_of(guard, known, orders, forecasts, path);
    let Known { arms: known, manners, .. } = known;
    // A duration of 0 marks a behaviour without a known path, which is left as it is.
    let lasts: PerArm<f64> = std::array::from_fn(|i| match (orders.get(i), manners[i], known[i]) {
        (Some(Some(order)), Some(manner), Some(arm)) => {
            forecasts[i].as_ref().map_or_else(|| manner.seconds(order, arm), |f| f.seconds)
        }
        _ => 0.0,
    });
    let slower = slow_enough(1.0, |slower| {
        let too_fast = |i: usize| {
            let (seconds, profile) = (slower * lasts[i], manners[i]?.speeds.profile);
            // The windows of legs are shares of the time, so legs keep their shape when they get
            // more of it, and so does a forecast. The profile of other motions depends on the
            // duration.
            let timed = matches!(orders[i], Some(Behaviour::Legs { .. } | Behaviour::Own(_)));
            let share = |part| if timed { part } else { profile.share(part, seconds) };
            let course = || Some(guard.course(i, &known[i]?.desired_joints, &ways[i]));
            Some(
                course()?
                    .hand_speed_factor(seconds, share)
                    .max(course()?.motor_speed_factor(seconds, share)),
            )
        };
        (0..MOST_ARMS).filter(|&i| lasts[i] > 0.0).filter_map(too_fast).fold(1.0, f64::max)
    });
    // Orders that are slow enough stay as they were, to the bit.
    if slower <= 1.0 {
        return;
    }
    for (i, order) in orders.iter_mut().take(MOST_ARMS).enumerate().filter(|(i, _)| lasts[*i] > 0.0)
    {
        if let Some(Behaviour::Own(own)) = order {
            own.fraction /= slower;
        } else if let (Some(order), Some(manner), Some(arm)) = (order, manners[i], known[i]) {
            manner.set_duration(order, arm, slower * lasts[i]);
        }
    }
}

/// Returns a time, at least `seconds`, in which a motion is slow enough, to 1e-6 of its speed.
/// `factor(time)` returns how many times too fast the motion is if it takes `time` (s).
fn slow_enough(seconds: f64, factor: impl Fn(f64) -> f64) -> f64 {
    let mut seconds = seconds;
    for _ in 0..ROUNDS {
        let factor = factor(seconds);
        if factor <= ENOUGH {
            break;
        }
        seconds *= factor;
    }
    seconds
}

/// Slows down only the beginning and the end of joint motions that begin or end near the operator's
/// hand. The path does not change, and both arms have still done the same share of it at each
/// moment. Three overlapping legs replace the motion: slow, at full speed, slow.
fn slow_ends(guard: &Guard, known: Known<'_>, orders: &mut [Option<Behaviour>]) {
    let moves = JointsMove::of(known, orders);
    // If the other arm has an order of another kind, this motion must keep its course: with legs
    // both arms would no longer have done the same share of their paths.
    let others = orders.iter().flatten().count() > moves.len();
    let Some(first) = moves.first().filter(|_| !others) else { return };
    let profile = first.manner.speeds.profile;
    // The time of the slower arm from one share of the paths to another.
    let all =
        |begin: f64, end: f64| moves.iter().map(|m| m.seconds(begin, end)).fold(0.0, f64::max);
    // How many times too fast the faster hand is on that part, if it takes `seconds`.
    let factor = |begin: f64, end: f64, seconds: f64| {
        let of = |m: &JointsMove<'_>| {
            let path = PlannedMotion::Joints(m.at(end));
            guard
                .course(m.arm, &m.at(begin), &path)
                .hand_speed_factor(seconds, |part| profile.share(part, seconds))
        };
        moves.iter().map(of).fold(0.0, f64::max)
    };
    // Slow enough already, or ordered to take more time than it needs: that time must be kept.
    let whole = all(0.0, 1.0);
    if factor(0.0, 1.0, whole) <= ENOUGH || moves.iter().any(|m| m.seconds > 1.01 * whole) {
        return;
    }
    // The share of the path until which, and the one from which on, any hand is near the operator.
    let (until, from) = moves.iter().fold((0.0_f64, 1.0_f64), |(until, from), m| {
        let path = PlannedMotion::Joints(m.target);
        let (begin, end) = guard.course(m.arm, m.from, &path).near_ends();
        (until.max(begin), from.min(end))
    });
    // The hand is near on the whole path, so there is no fast part between the ends.
    if until >= from {
        return;
    }
    // Each end is made slow enough by itself. Then it is slow enough within the whole as well.
    let slow = |begin: f64, end: f64| {
        let seconds = slow_enough(all(begin, end), |seconds| factor(begin, end, seconds));
        if begin < end { seconds } else { 0.0 }
    };
    let lasts = [slow(0.0, until), all(until, from), slow(from, 1.0)];
    // A leg brakes while the next one accelerates: half of the shorter of their ramps overlaps.
    let at_once = |a: f64, b: f64| 0.5 * profile.ramp.min(0.5 * a).min(0.5 * b);
    let overlaps = [at_once(lasts[0], lasts[1]), at_once(lasts[1], lasts[2])];
    let total = lasts.iter().sum::<f64>() - overlaps[0] - overlaps[1];
    // Legs are of no use if the whole motion, slowed down evenly, takes no longer.
    if total >= whole * factor(0.0, 1.0, whole) {
        return;
    }
    // Windows of the legs, as shares of the total time.
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

/// A joint motion of an order.
struct JointsMove<'a> {
    arm: usize,
    from: &'a JointPositions,
    target: JointPositions,
    /// Share of the full speeds.
    speed: f64,
    /// Least duration that the order asks for (s).
    seconds: f64,
    manner: &'a Manner,
}

impl<'a> JointsMove<'a> {
    /// Returns those of the orders that are joint motions of synchronised arms.
    fn of(known: Known<'a>, orders: &[Option<Behaviour>]) -> Vec<Self> {
        let of_arm = |arm: usize| match *orders.get(arm)?.as_ref()? {
            Behaviour::Joints { target, speed, seconds } => {
                let (from, manner) = (&known.arms[arm]?.desired_joints, known.manners[arm]?);
                Some(Self { arm, from, target, speed, seconds, manner })
            }
            _ => None,
        };
        (0..MOST_ARMS).filter_map(of_arm).collect()
    }

    /// Returns the joint positions of the arm after the share `share` of its path, 0 to 1.
    fn at(&self, share: f64) -> JointPositions {
        self.from.towards(&self.target, share)
    }

    /// Returns the time that the arm needs, from rest to rest, for the part of its path between the
    /// shares `begin` and `end` (s).
    fn seconds(&self, begin: f64, end: f64) -> f64 {
        self.manner.speeds.joints_seconds(&self.at(begin), &self.at(end), self.speed)
    }
}

/// Returns the ordered paths of all arms, each as `path` makes it from order and state. An arm
/// that is not synchronised counts as staying where it is.
fn paths_of(
    guard: &Guard,
    known: Known<'_>,
    orders: &[Option<Behaviour>],
    forecasts: &Forecasts,
    path: impl Fn(Option<&Behaviour>, &ArmState) -> PlannedMotion,
) -> PerArm<PlannedMotion> {
    std::array::from_fn(|i| {
        let order = orders.get(i).and_then(Option::as_ref);
        // The guard knows the tool frame of the cell alone, whose body no frame changes.
        let cell = guard.flange_from_tool(i);
        let changed = known.tools[i].zip(cell).map(|(tool, cell)| tool.inverse() * cell);
        let path = match (&forecasts[i], known.arms[i]) {
            (Some(course), Some(_)) => PlannedMotion::Forecast(Arc::clone(course)),
            (_, arm) => arm.map_or(PlannedMotion::Stays, |arm| path(order, arm)),
        };
        match (path, changed) {
            (PlannedMotion::Line(to), Some(tool_from_cell)) => {
                PlannedMotion::Line(to * tool_from_cell)
            }
            (PlannedMotion::Forecast(course), Some(tool_from_cell)) => {
                PlannedMotion::Forecast(Arc::new(course.of_point(&tool_from_cell)))
            }
            (path, _) => path,
        }
    })
}

/// Returns the path on which a behaviour moves an arm, if it is known beforehand. An approach and a
/// guarded motion count as no motion: they end where they touch something, which may be the table.
fn path(order: Option<&Behaviour>, arm: &ArmState) -> PlannedMotion {
    match order {
        Some(Behaviour::Joints { target, .. }) => PlannedMotion::Joints(*target),
        Some(Behaviour::Legs { legs, .. }) => PlannedMotion::Legs(*legs),
        Some(Behaviour::Line { target, .. }) => PlannedMotion::Line(*target),
        // Against the direction of approach, which is z of the tool.
        Some(Behaviour::Withdraw { distance, .. }) => {
            PlannedMotion::Line(arm.desired_base_from_tool * Pose::translation(0.0, 0.0, -distance))
        }
        _ => PlannedMotion::Stays,
    }
}

/// Returns the path of a behaviour as [`path`] does, but for an approach the line over its whole
/// distance.
fn longest_path(order: Option<&Behaviour>, arm: &ArmState) -> PlannedMotion {
    match order {
        Some(Behaviour::Approach { distance, .. }) => {
            PlannedMotion::Line(arm.desired_base_from_tool * Pose::translation(0.0, 0.0, *distance))
        }
        order => path(order, arm),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn free_motion_needs_share_of_full_speed() {
        let (target, seconds) = (JointPositions::default(), 0.0);
        let joints = |speed| check_speed(&Behaviour::Joints { target, speed, seconds });
        let line = |speed| check_speed(&Behaviour::Line { target: Pose::identity(), speed });

        for speed in [0.0, -0.5, 1.001, f64::NAN] {
            assert!(joints(speed).is_err() && line(speed).is_err(), "{speed}");
        }
        for speed in [1e-3, 1.0] {
            assert!(joints(speed).is_ok() && line(speed).is_ok(), "{speed}");
        }
    }

    /// Within a ramp that gets longer with the motion, the speed falls by the cube root of the
    /// time: a motion that is three times too fast needs 27 times its time.
    #[test]
    fn motion_within_its_ramp_becomes_slow_enough() {
        let factor = |seconds: f64| 3.0 / seconds.cbrt();

        let seconds = slow_enough(1.0, factor);

        assert!((1.0..1.000_001).contains(&factor(seconds)), "{seconds}");
        assert_eq!(slow_enough(30.0, factor), 30.0);
    }
}
