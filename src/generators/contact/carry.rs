//! Carrying: a motion along a path that yields in some directions, for arms that hold one rigid
//! body.
//!
//! - in: the path of the body, the pose of the body in the tool, the directions that yield
//! - out: velocities along the path; those of the yielding directions give way to forces
//!
//! Each arm gets the same path of the body, in its own base. The time law depends on the path and
//! on the full speeds alone, so arms with equal speeds are at the same place of the path at each
//! moment. One of them holds all directions and leads, the others yield, so that an error e of a
//! grip costs no lasting force: it fades with the admittance. A difference d of the velocities
//! costs the force d over admittance. A force beyond the ordered bound ends the motion of both, and
//! so does a jaw that has closed below the ordered width: it has lost the body.

use super::super::compliance::{Compliance, Selector};
use super::super::inputs::Inputs;
use super::super::outcome::{Next, Outcome};
use super::super::own::{Forecast, MotionGenerator, Pacing, Place, Places, Site, Touch};
use super::super::paths::{Cell, Curve, Law, PathOrder, advance, pauses, places};
use super::guarded::positive;
use crate::motion::{ArmState, Direction, Frame, Motion};
use crate::spatial::{Pose, Wrench, is_rigid};
use nalgebra::Vector3;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Number of macrosteps in which a direction that does not yield returns to the path.
const RETURNS: f64 = 8.0;

/// Order to carry a body along a path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(bound = "O: Serialize + DeserializeOwned")]
pub struct CarryOrder<O> {
    /// Path of the body: its poses are `base_from_body`.
    pub path: O,
    /// `tool_from_body`; the identity if the path is one of the tool.
    pub tool_from_body: Pose,
    /// Greatest distance of any arm's tool from the origin of the body (m), the same for all arms:
    /// the speeds of the tools keep the limits with it.
    pub lever: f64,
    /// Directions of the tool frame that yield; none for the arm that leads.
    pub yields: Selector,
    /// Greatest force and torque of the tool (N, Nm). At one beyond, the motion ends with
    /// [`Outcome::OverForce`].
    pub bound: (f64, f64),
    /// Width of the jaws that hold the body, at least (m). At a narrower jaw the motion ends with
    /// [`Outcome::Lost`].
    pub least_width: f64,
}

/// Motion along a path with yielding directions.
pub struct Carry<O> {
    curve: Box<dyn Curve>,
    law: Law,
    pace: f64,
    body_from_tool: Pose,
    compliance: Compliance,
    step: f64,
    yields: Selector,
    bound: (f64, f64),
    least_width: f64,
    /// Poses of the tool on the path at the ends of the present macrostep and of the one before.
    at: Pose,
    before: Pose,
    order: std::marker::PhantomData<fn() -> O>,
}

impl<O: PathOrder> MotionGenerator for Carry<O> {
    type Order = CarryOrder<O>;

    fn begin(order: CarryOrder<O>, site: &Site<'_>) -> Result<Self, String> {
        let CarryOrder { path, tool_from_body, lever, yields, bound, least_width } = order;
        if !(is_rigid(&tool_from_body) && lever >= 0.0 && lever.is_finite()) {
            return Err("the body is at no finite place in the tool".to_owned());
        }
        positive("the bound of the force", bound.0)?;
        positive("the bound of the torque", bound.1)?;
        positive("the least width", least_width)?;
        let at = site.arm.desired_base_from_tool;
        // The path begins at the body.
        let arm = ArmState { desired_base_from_tool: at * tool_from_body, ..*site.arm };
        let curve = path.curve(&Site { arm: &arm, ..*site })?;
        if matches!(curve.at(0.0), Place::Joints(_)) {
            return Err("a body needs a path of poses".to_owned());
        }
        let cells: Vec<Cell> = curve.cells().iter().map(|cell| levered(cell, lever)).collect();
        let law = Law::plan(&cells, site.step() * site.fraction);
        Ok(Self {
            curve,
            law,
            pace: 0.0,
            body_from_tool: tool_from_body.inverse(),
            compliance: site.compliance,
            step: site.step(),
            yields,
            bound,
            least_width,
            at,
            before: at,
            order: std::marker::PhantomData,
        })
    }

    fn tune(&mut self, compliance: &Compliance) {
        self.compliance = *compliance;
    }

    fn touch(&self) -> Touch {
        Touch::Contact
    }

    fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        if inputs.arm.jaw_opening < self.least_width {
            return Next::Done(Outcome::Lost(inputs.arm.jaw_opening));
        }
        let Wrench { force, torque } = inputs.arm.wrench_in_tool;
        for (first, vector, most) in [(0, force, self.bound.0), (3, torque, self.bound.1)] {
            if vector.norm() > most {
                return Next::Done(Outcome::OverForce(first + vector.iamax(), vector.norm()));
            }
        }
        if self.law.is_over() {
            return Next::Done(Outcome::Reached);
        }
        let pauses = pauses(inputs, &mut self.pace);
        let Place::Pose(body) = advance(self.curve.as_ref(), &mut self.law, pauses) else {
            return Next::go(Motion::Hold);
        };
        let next = body * self.body_from_tool;
        let motion = self.towards(&next, inputs.arm);
        (self.before, self.at) = (self.at, next);
        Next::go(motion)
    }

    fn forecast(&self) -> Option<Forecast> {
        let forecast = places(self.curve.as_ref(), self.law.clone())?;
        let Places::Poses(bodies) = forecast.places else { return None };
        let tools = bodies.iter().map(|body| body * self.body_from_tool).collect();
        Some(Forecast { places: Places::Poses(tools), ..forecast })
    }

    fn pacing(&self) -> Pacing {
        Pacing::Clock
    }

    fn rests(&self) -> bool {
        self.law.rests()
    }
}

impl<O> Carry<O> {
    /// Returns the motion of the next macrostep: from the pose on the path at its beginning to
    /// `next` at its end. Directions that do not yield also return to the path.
    fn towards(&self, next: &Pose, arm: &ArmState) -> Motion {
        let tool_from_base = arm.desired_base_from_tool.rotation.inverse();
        let seconds = self.step;
        let moves = (next.translation.vector - self.at.translation.vector) / seconds;
        let turns = (next.rotation * self.at.rotation.inverse()).scaled_axis() / seconds;
        // The state is two periods older than the end of the present macrostep.
        let share = 1.0 - 2.0 / f64::from(self.compliance.macrostep.max(2));
        let wanted = Pose::from_parts(
            self.before.translation.vector.lerp(&self.at.translation.vector, share).into(),
            self.before.rotation.nlerp(&self.at.rotation, share),
        );
        let is = &arm.desired_base_from_tool;
        let off = wanted.translation.vector - is.translation.vector;
        let twisted = (wanted.rotation * is.rotation.inverse()).scaled_axis();
        let [moves, turns, off, twisted] =
            [moves, turns, off, twisted].map(|v: Vector3<f64>| tool_from_base * v);
        let directions = std::array::from_fn(|i| {
            let (velocity, error) =
                if i < 3 { (moves[i], off[i]) } else { (turns[i - 3], twisted[i - 3]) };
            match self.compliance.contact(i, 0.0) {
                Direction::Contact { admittance, inertia, .. } if self.yields[i] => {
                    Direction::Guarded { velocity, admittance, inertia }
                }
                _ => Direction::Unguarded { velocity: velocity + error / (RETURNS * seconds) },
            }
        });
        Motion::Task { frame: Frame::Tool, directions }
    }
}

/// Returns a cell of a body's path with the demands of a tool at this distance from its origin (m).
///
/// The tool is at `p + r` with r turned by the body, so that `r' = w x r`, `r'' = w' x r + w x r'`
/// and so on, with the angular velocity w.
fn levered(cell: &Cell, lever: f64) -> Cell {
    let mut cell = cell.clone();
    if let [linear, turn] = cell.demands.as_mut_slice() {
        let [w, dw, ddw] = turn.derivatives;
        linear.derivatives[0] += lever * w;
        linear.derivatives[1] += lever * (dw + w * w);
        linear.derivatives[2] += lever * (ddw + 3.0 * w * dw + w.powi(3));
    }
    cell
}

#[cfg(test)]
mod tests {
    use super::super::super::paths::Polyline;
    use super::super::super::testing::{compliance, speeds};
    use super::super::testing::Arm;
    use super::*;
    use nalgebra::UnitQuaternion;

    /// Stiffness of the body between both hands (N/m).
    const STIFF: f64 = 2e4;

    /// Returns the path of the body: 0.15 m along x, then 0.1 m along y with a turn about z.
    fn path() -> Polyline {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.4);
        let corner = Pose::translation(0.15, 0.0, 0.0);
        let end = Pose::from_parts(Vector3::new(0.15, 0.1, 0.0).into(), turn);
        Polyline { through: vec![corner, end], radius: 0.03, speed: 0.8 }
    }

    /// Has two arms carry a bar as [`carry_until`] does, which neither loses.
    fn carry(yields: Selector, bound: f64) -> ([Option<Outcome>; 2], f64, [Pose; 2]) {
        let (outcomes, most, tools, _) = carry_until(usize::MAX, yields, bound);
        (outcomes, most, tools)
    }

    /// Has two arms carry a bar of 0.4 m along [`path`]; the second yields in `yields`, and its
    /// hand is 1 mm beside its place on the bar. Both bases are in the same place. The first hand
    /// loses the bar before the macrostep `lost`. Returns the outcomes, the greatest force after
    /// the first second (N), the tools at the end, and the number of macrosteps.
    fn carry_until(
        lost: usize,
        yields: Selector,
        bound: f64,
    ) -> ([Option<Outcome>; 2], f64, [Pose; 2], usize) {
        let grips = [-0.2, 0.2].map(|x| Pose::translation(x, 0.0, 0.0));
        let mut arms = grips.map(Arm::at);
        let mut off = grips[1];
        off.translation.vector.y += 0.001;
        let grips = [grips[0], off];
        let held = |arm: ArmState| ArmState { jaw_opening: 0.057, ..arm };
        let mut states = [0, 1].map(|i: usize| held(arms[i].state(Vector3::zeros())));
        let mut carriers =
            [([false; 6], -0.2), (yields, 0.2)].map(|(yields, x): (Selector, f64)| {
                let order = CarryOrder {
                    path: path(),
                    tool_from_body: Pose::translation(-x, 0.0, 0.0),
                    lever: 0.2,
                    yields,
                    bound: (bound, 10.0),
                    least_width: 0.05,
                };
                let arm = &states[usize::from(x > 0.0)];
                let site = Site { compliance: compliance(), speeds: speeds(), arm, fraction: 1.0 };
                Carry::<Polyline>::begin(order, &site).unwrap()
            });
        let (mut outcomes, mut most, mut step) = ([None, None], 0.0_f64, 0);
        while outcomes.iter().all(Option::is_none) {
            if step >= lost {
                states[0].jaw_opening = 0.04;
            }
            let mut motions = [Motion::Hold; 2];
            for i in 0..2 {
                let inputs =
                    Inputs { arm: &states[i], target: None, reading: None, period: 0, pace: 1.0 };
                match carriers[i].next(&inputs) {
                    Next::Go(command) => motions[i] = command.motion,
                    Next::Done(outcome) => outcomes[i] = Some(outcome),
                }
            }
            for period in 0..8 {
                // The place of the second grip on the bar that the first hand holds.
                let there = arms[0].pose * grips[0].inverse() * grips[1];
                let apart = arms[1].pose.translation.vector - there.translation.vector;
                let force = STIFF * apart;
                if period == 6 {
                    states = [arms[0].state(-force), arms[1].state(force)].map(held);
                }
                arms[0].period(&motions[0], -force);
                arms[1].period(&motions[1], force);
                most = if step > 60 { most.max(force.norm()) } else { most };
            }
            step += 1;
        }
        (outcomes, most, arms.map(|arm| arm.pose), step)
    }

    /// The loss ends the motion in the macrostep in which the jaw is narrower, and alarms the
    /// partner.
    #[test]
    fn lost_body_ends_motion_at_once() {
        let (outcomes, .., steps) = carry_until(20, [false; 6], 25.0);

        assert_eq!((outcomes[0].clone(), steps), (Some(Outcome::Lost(0.04)), 21));
        assert!(outcomes[0].as_ref().is_some_and(Outcome::alarms) && outcomes[1].is_none());
    }

    #[test]
    fn yielding_partner_bounds_internal_force() {
        let (outcomes, force, [first, _]) = carry([true, true, true, false, false, false], 25.0);

        assert!(outcomes.contains(&Some(Outcome::Reached)), "{outcomes:?}");
        assert!(force < 5.0, "{force} N");
        // The leading hand ends where the path of the bar has led it.
        let Some(end) = path().through.pop() else { panic!("a path") };
        let wanted = end * Pose::translation(-0.2, 0.0, 0.0);
        let off = (first.translation.vector - wanted.translation.vector).norm();
        assert!(off < 2e-4, "{off} m");
    }

    /// With position control of both, 1 mm costs the stiffness of the bar times 1 mm.
    #[test]
    fn two_stiff_arms_keep_full_internal_force() {
        let (outcomes, force, _) = carry([false; 6], 25.0);
        assert!(outcomes.contains(&Some(Outcome::Reached)), "{outcomes:?}");
        assert!((18.0..25.0).contains(&force), "{force} N");

        let (outcomes, ..) = carry([false; 6], 10.0);
        let over = |o: &Option<Outcome>| matches!(o, Some(Outcome::OverForce(..)));
        assert!(outcomes.iter().any(over), "{outcomes:?}");
    }
}
