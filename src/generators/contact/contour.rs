//! Contour following: the tool presses on a surface of unknown shape and moves along it.
//!
//! - in: the directions of pressing and of travel in the tool, force, speed, length
//! - out: velocities and forces in base axes; [`Followed`] at the end
//!
//! The motion stays in the plane of both directions. In it the direction of travel is known only
//! from what the tool meets:
//!
//! | case | reaction | reason |
//! |---|---|---|
//! | tool moves | travel turns to the direction of the last `BASE` | friction does not bend it |
//! | force outside the cone of friction | travel turns away from it | a wall ahead stops the tool |
//! | no contact at the beginning | presses only, up to `REACH` | travel needs a surface |
//! | force below `LOST` of the wanted one | travels on for the ordered time | an edge, a gap |
//!
//! The velocity is `speed` along the travel plus admittance times the force error along the normal,
//! so that a travel direction that is wrong by a small angle e costs a force error of e times speed
//! over admittance. Across the plane the tool keeps its place as far as no force displaces it.

use super::super::compliance::Compliance;
use super::super::inputs::Inputs;
use super::super::outcome::{Next, Outcome};
use super::super::own::{MotionGenerator, Pacing, Site, Touch};
use super::guarded::{force_in_base, positive, unit};
use crate::motion::{ArmState, Direction, Frame, Motion};
use nalgebra::{Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Way from which the direction of travel is measured (m).
const BASE: f64 = 0.004;
/// Share by which the direction of travel turns to the measured one, for a way of [`BASE`].
const FOLLOWS: f64 = 1.0;
/// Rate at which travel turns away from a force outside the cone of friction (1/s).
const TURNS_AWAY: f64 = 4.0;
/// Rate at which the tool turns to the normal (1/s).
const ALIGNS: f64 = 3.0;
/// Rate at which the tool returns into its plane (1/s).
const RETURNS: f64 = 2.0;
/// Way without a contact after which the beginning is given up (m).
const REACH: f64 = 0.05;
/// Share of the wanted force above which there is contact at the beginning, and below which it is
/// lost later.
const FOUND: f64 = 0.5;
const LOST: f64 = 0.1;

/// Order to follow a contour.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ContourOrder {
    /// Direction in which the tool presses on the surface, in tool axes at the beginning.
    pub press: Vector3<f64>,
    /// Direction of travel, in tool axes at the beginning; its part at right angles to `press`
    /// counts.
    pub travel: Vector3<f64>,
    /// Force on the surface (N).
    pub force: f64,
    /// Speed along the surface (m/s).
    pub speed: f64,
    /// Length along the surface after which the motion ends (m).
    pub length: f64,
    /// Whether the tool turns so that it presses along the normal.
    pub turns: bool,
    /// Greatest coefficient of friction: a force within its cone does not turn the travel.
    pub friction: f64,
    /// Time without contact after which it is lost (s).
    pub patience: f64,
}

/// Result of following a contour.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Followed {
    /// Length of the way in contact (m).
    pub length: f64,
    /// Whether the contact was lost.
    pub lost: bool,
    /// Root mean square and greatest amount of the normal force's error after the first contact
    /// (N).
    pub error: (f64, f64),
}

/// Following of a contour.
pub struct Contour {
    order: ContourOrder,
    compliance: Compliance,
    step: f64,
    most_turn: f64,
    /// Normal of the plane of motion, and the direction of travel, in base axes.
    across: Vector3<f64>,
    travel: Vector3<f64>,
    /// Direction of pressing in the tool.
    press: Vector3<f64>,
    start: Vector3<f64>,
    /// Positions of the tool on the last [`BASE`] of the way (m).
    track: VecDeque<Vector3<f64>>,
    /// Whether the surface has been found, and the time since the last contact (s).
    found: bool,
    without: f64,
    length: f64,
    /// Sum of the squares of the force error, number of its samples, greatest amount.
    errors: (f64, f64, f64),
}

impl MotionGenerator for Contour {
    type Order = ContourOrder;

    fn begin(order: ContourOrder, site: &Site<'_>) -> Result<Self, String> {
        for (name, value) in [
            ("the force", order.force),
            ("the length", order.length),
            ("the patience", order.patience),
        ] {
            positive(name, value)?;
        }
        let full = site.speeds.linear;
        if positive("the speed", order.speed)? > full {
            return Err(format!("{} m/s is faster than the full speed, {full} m/s", order.speed));
        }
        if order.force >= site.compliance.force_limit {
            return Err(format!("{} N reaches the force limit of the arm", order.force));
        }
        if !(order.friction >= 0.0 && order.friction.is_finite()) {
            return Err(format!("a friction of {} is below 0", order.friction));
        }
        let press = unit("the press", &order.press)?;
        let travel = order.travel - press * press.dot(&order.travel);
        let travel = unit("the travel at right angles to the press", &travel)?;
        let pose = site.arm.desired_base_from_tool;
        Ok(Self {
            order,
            compliance: site.compliance,
            step: site.step(),
            most_turn: site.speeds.angular,
            // Travel x across = press, so the surface is on the side of the pressing.
            across: pose.rotation * press.cross(&travel),
            travel: pose.rotation * travel,
            press,
            start: pose.translation.vector,
            track: VecDeque::new(),
            found: false,
            without: 0.0,
            length: 0.0,
            errors: (0.0, 0.0, 0.0),
        })
    }

    fn tune(&mut self, compliance: &Compliance) {
        self.compliance = *compliance;
    }

    fn touch(&self) -> Touch {
        Touch::Contact
    }

    fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        let arm = inputs.arm;
        if let Some(excess) = self.compliance.excess(arm) {
            return Next::Done(excess);
        }
        let normal = self.normal();
        let force = force_in_base(arm);
        let pressed = force.dot(&normal);
        self.found |= pressed > FOUND * self.order.force;
        if !self.found {
            let away = (arm.base_from_tool.translation.vector - self.start).dot(&normal);
            if away > REACH {
                return Next::Done(Outcome::NotTouched);
            }
            return Next::go(self.command(arm, &normal, 0.0, inputs.pace));
        }
        self.measure(arm, pressed, inputs.pace);
        self.turn_away(&force, pressed, inputs.pace);
        let lost = self.without > self.order.patience;
        if lost || self.length >= self.order.length {
            return Next::Done(Outcome::own(&self.followed(lost)));
        }
        let normal = self.normal();
        Next::go(self.command(arm, &normal, self.order.speed, inputs.pace))
    }

    fn pacing(&self) -> Pacing {
        // Only the travel slows down in a pause: the force must not depend on it.
        Pacing::Clock
    }
}

impl Contour {
    /// Returns the direction in which the tool is to press, in base axes.
    fn normal(&self) -> Vector3<f64> {
        self.travel.cross(&self.across)
    }

    /// Measures the way of the last macrostep and turns the travel to its direction; counts the
    /// error of the force `pressed` (N).
    fn measure(&mut self, arm: &ArmState, pressed: f64, pace: f64) {
        let at = arm.base_from_tool.translation.vector;
        let flat = |v: Vector3<f64>| v - self.across * self.across.dot(&v);
        let moved = self.track.back().map_or(0.0, |last| flat(at - last).dot(&self.travel));
        let touches = pressed > LOST * self.order.force;
        self.without = if touches { 0.0 } else { self.without + pace * self.step };
        if touches {
            self.length += moved.max(0.0);
            let error = pressed - self.order.force;
            let (squares, samples, most) = self.errors;
            self.errors = (squares + error * error, samples + 1.0, most.max(error.abs()));
        }
        self.track.push_back(at);
        while self.track.len() > 2 && self.track.get(1).is_some_and(|p| flat(at - p).norm() >= BASE)
        {
            self.track.pop_front();
        }
        let base = self.track.front().map_or_else(Vector3::zeros, |first| flat(at - first));
        if base.norm() > 0.5 * BASE {
            let angle = self.angle_to(&base);
            self.rotate(angle * (FOLLOWS * moved.abs() / BASE).min(1.0));
        }
    }

    /// Turns the travel away from a force outside the cone of friction.
    fn turn_away(&mut self, force: &Vector3<f64>, pressed: f64, pace: f64) {
        let along = force.dot(&self.travel);
        if force.norm() < FOUND * self.order.force {
            return;
        }
        // A force along the travel means a wall ahead: the normal leans forward.
        let lean = libm::atan2(along, pressed);
        let beyond = lean.abs() - libm::atan(self.order.friction);
        if beyond > 0.0 {
            self.rotate(-lean.signum() * beyond * (TURNS_AWAY * pace * self.step).min(1.0));
        }
    }

    /// Returns the angle from the travel to a direction in the plane, positive towards the surface
    /// (rad).
    fn angle_to(&self, direction: &Vector3<f64>) -> f64 {
        libm::atan2(direction.dot(&self.normal()), direction.dot(&self.travel))
    }

    /// Turns the travel by an angle towards the surface (rad).
    fn rotate(&mut self, angle: f64) {
        // Travel turns to the normal about `- across`.
        let by = UnitQuaternion::from_axis_angle(&Unit::new_normalize(-self.across), angle);
        self.travel = (by * self.travel).normalize();
    }

    /// Returns the motion of a macrostep: presses along `normal` and travels at `speed` (m/s).
    fn command(&self, arm: &ArmState, normal: &Vector3<f64>, speed: f64, pace: f64) -> Motion {
        let (admittance, inertia) =
            (self.compliance.linear_admittance, self.compliance.linear_inertia);
        let at = arm.desired_base_from_tool.translation.vector;
        let beside = (at - self.start).dot(&self.across);
        let velocity = self.travel * (speed * pace) - self.across * (RETURNS * beside * pace)
            + normal * (admittance * self.order.force);
        let mut turn = Vector3::zeros();
        if self.order.turns {
            let pressing = arm.desired_base_from_tool.rotation * self.press;
            let axis = pressing.cross(normal);
            let angle = libm::atan2(axis.norm(), pressing.dot(normal));
            let rate = (ALIGNS * angle).min(self.most_turn) * pace;
            turn = axis.try_normalize(1e-9).map_or(turn, |axis| axis * rate);
        }
        let directions = std::array::from_fn(|i| match i {
            0..3 => Direction::Guarded { velocity: velocity[i], admittance, inertia },
            _ => Direction::Unguarded { velocity: turn[i - 3] },
        });
        Motion::Task { frame: Frame::Base, directions }
    }

    /// Returns the result.
    fn followed(&self, lost: bool) -> Followed {
        let (squares, samples, most) = self.errors;
        let error = (libm::sqrt(squares / samples.max(1.0)), most);
        Followed { length: self.length, lost, error }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::run;
    use super::*;
    use crate::spatial::Pose;

    /// Returns the order to press with 10 N along z and to travel along x at 20 mm/s.
    fn order(length: f64) -> ContourOrder {
        ContourOrder {
            press: Vector3::z(),
            travel: Vector3::x(),
            force: 10.0,
            speed: 0.02,
            length,
            turns: true,
            friction: 0.4,
            patience: 0.3,
        }
    }

    /// Returns the force on a surface of 10 N/mm, with this friction, under a tool that is `depth`
    /// (m) beyond the surface with this normal into it, and moves at `velocity` (m/s).
    fn surface(
        depth: f64,
        normal: Vector3<f64>,
        velocity: Vector3<f64>,
        friction: f64,
    ) -> Vector3<f64> {
        let pressed = (1e4 * depth).max(0.0);
        let slides = velocity - normal * normal.dot(&velocity);
        // Friction drags the surface along; it fades below 1 mm/s.
        normal * pressed + slides / slides.norm().max(1e-3) * (friction * pressed)
    }

    #[test]
    fn contour_follows_round_surface_despite_friction() {
        // A cylinder of 80 mm whose top is at z = 0.01 (z points down), from outside and inside.
        for (radius, friction) in [(0.08, 0.0), (0.08, 0.3), (-0.15, 0.3)] {
            let centre = Vector3::new(0.0, 0.0, 0.01 + radius);
            let normal = move |at: Vector3<f64>| {
                let out = centre - Vector3::new(at.x, 0.0, at.z);
                out.normalize() * radius.signum()
            };
            let wall = |at: Vector3<f64>, velocity, _| {
                let off = (centre - Vector3::new(at.x, 0.0, at.z)).norm();
                let depth = (radius.abs() - off) * radius.signum();
                surface(depth, normal(at), velocity, friction)
            };
            let mut tilts = Vec::new();
            let look = |arm: &ArmState| {
                let pressing = arm.base_from_tool.rotation * Vector3::z();
                tilts.push(pressing.angle(&normal(arm.base_from_tool.translation.vector)));
            };

            let (outcome, arm) =
                run::<Contour>(order(0.1), Pose::identity(), 60.0, wall, look).unwrap();

            let way: Followed = outcome.and_then(|outcome| outcome.result()).unwrap();
            assert!(!way.lost && (0.1..0.101).contains(&way.length), "{way:?}");
            assert!(way.error.0 < 2.0, "{radius} {friction}: {way:?}");
            // An arc of 0.1 m, and the tool has turned with the normal.
            let at = arm.pose.translation.vector;
            let turned = libm::atan2(at.x, radius - (at.z - 0.01)).abs();
            let turned = if radius < 0.0 { libm::asin(at.x / -radius) } else { turned };
            assert!((turned - 0.1 / radius.abs()).abs() < 0.1, "{radius}: {turned} rad");
            let tilt = tilts[tilts.len() - 1];
            assert!(tilt < 0.2, "{radius} {friction}: tilted by {tilt} rad");
            assert!(at.y.abs() < 1e-6, "{at}");
        }
    }

    /// A wall stands across the way 50 mm ahead. The tool turns up along it, without an overload.
    #[test]
    fn contour_turns_up_at_wall_ahead() {
        let wall = |at: Vector3<f64>, velocity, _| {
            surface(at.z - 0.005, Vector3::z(), velocity, 0.2)
                + surface(at.x - 0.05, Vector3::x(), velocity, 0.2)
        };

        let (outcome, arm) =
            run::<Contour>(order(0.1), Pose::identity(), 60.0, wall, |_| {}).unwrap();

        let way: Followed = outcome.clone().and_then(|outcome| outcome.result()).unwrap();
        assert!(!way.lost, "{way:?}");
        let at = arm.pose.translation.vector;
        assert!((at.x - 0.05).abs() < 0.003 && at.z < -0.02, "{outcome:?} {at}");
    }

    #[test]
    fn contour_ends_when_contact_is_lost() {
        // The surface ends after 40 mm, and nothing is behind it for the patience.
        let wall = |at: Vector3<f64>, velocity, _| {
            let depth = if at.x < 0.04 { at.z - 0.005 } else { 0.0 };
            surface(depth, Vector3::z(), velocity, 0.2)
        };
        let (outcome, _) =
            run::<Contour>(order(0.1), Pose::identity(), 60.0, wall, |_| {}).unwrap();
        let way: Followed = outcome.and_then(|outcome| outcome.result()).unwrap();
        assert!(way.lost && (0.038..0.042).contains(&way.length), "{way:?}");

        // Without any surface the tool gives up after 50 mm.
        let none = |_, _, _| Vector3::zeros();
        let (outcome, _) =
            run::<Contour>(order(0.1), Pose::identity(), 60.0, none, |_| {}).unwrap();
        assert_eq!(outcome, Some(Outcome::NotTouched));
    }
}
