//! The surroundings of an effector, against which its ECP checks the motions of a programme.
//!
//! - in: the guard of the cell, the states that the EDPs publish, a motion of the programme
//! - out: the motion, with more time if it is too fast; or the obstacle to which it would lead
//! - thresholds: those of [`crate::reach::guard`], by the checks of MP (`actors/ways`)
//!
//! Another arm counts as staying where its EDP reported it last. If it moves, the lookout keeps the
//! arms apart. No plan lets the hands of a programme meet another one, so they stay apart on every
//! path, as the lookout demands while a programme runs.

use crate::actors::lookout::is_known;
use crate::actors::move_instruction::Manner;
use crate::actors::ways::{self, Known};
use crate::cell::{MOST_ARMS, PerArm};
use crate::error::NonFatal;
use crate::generators::Behaviour;
use crate::generators::own::{Forecast, Place};
use crate::motion::ArmState;
use crate::reach::guard::{Guard, PlannedMotion};
use crate::spatial::Pose;
use std::sync::Arc;
use tokio::sync::watch;

/// Largest ratio of a speed to its limit that counts as slow enough; it leaves room for rounding.
const ENOUGH: f64 = 1.0 + 1e-6;

/// Cell and arms around an effector.
#[derive(Debug, Clone)]
pub struct Surroundings {
    /// Effector of the ECP.
    pub effector: usize,
    /// Guard of the cell.
    pub guard: Guard,
    /// States of all arms, as their EDPs publish them.
    pub states: Vec<watch::Receiver<ArmState>>,
}

impl Surroundings {
    /// Checks the course on which the own arm, which is in the state `own`, would come to rest.
    ///
    /// # Errors
    /// The limit of a joint that it would exceed, the obstacle to which it would come too near, or
    /// the speed that is too high near the operator's hand or for a motor.
    pub(super) fn check_onward(&self, course: Forecast, own: &ArmState) -> Result<(), String> {
        let effector = self.effector;
        // The servo checks the limits of an arm that the guard's cell does not have.
        if self.guard.flange_from_tool(effector).is_none() {
            return Ok(());
        }
        self.guard.check_limits(effector, &course).map_err(|why| why.to_string())?;
        let published = |i: usize| self.states.get(i).map(|state| *state.borrow());
        let mut arms: PerArm<Option<ArmState>> =
            std::array::from_fn(|i| published(i).filter(is_known));
        arms[effector] = Some(*own);
        let arms = arms.each_ref().map(Option::as_ref);
        let guard = ways::present(&self.guard, arms).by_hand();
        let from = arms.map(|arm| arm.map(|arm| &arm.desired_joints));
        let begin = match course.at(0.0) {
            Some(Place::Joints(joints)) => joints,
            _ => own.desired_joints,
        };
        let seconds = course.seconds;
        let way = PlannedMotion::Forecast(Arc::new(course));
        let mut ways = [&PlannedMotion::Stays; MOST_ARMS];
        ways[effector] = &way;
        guard.check_paths(from, ways).map_err(|near| near.to_string())?;
        let course = || guard.course(effector, &begin, &way);
        if course().hand_speed_factor(seconds, |share| share) > ENOUGH {
            return Err("it is too fast where the operator's hand may be".to_owned());
        }
        if course().motor_speed_factor(seconds, |share| share) > ENOUGH {
            return Err("it is too fast for a motor".to_owned());
        }
        Ok(())
    }

    /// Checks that a motion of the own arm brings it to no obstacle, and gives the motion more time
    /// if it is too fast. The arm is in the state `own.0`, and `own.1` is the tool frame in force
    /// if a task has changed it.
    ///
    /// # Errors
    /// The obstacle to which the arm would come too near, the limit that it would meet, a speed
    /// outside of 0 to 1, or the reason why a registered generator refuses the order.
    pub(super) fn admit(
        &self,
        order: &mut Behaviour,
        manner: &Manner,
        own: (&ArmState, Option<Pose>),
    ) -> Result<(), NonFatal> {
        let (effector, (arm, tool)) = (self.effector, own);
        let forecast = ways::forecast(order, manner, arm)?;
        // The guard's cell may not have the arm.
        if self.guard.flange_from_tool(effector).is_none() {
            return Ok(());
        }
        let published: Vec<ArmState> = self.states.iter().map(|state| *state.borrow()).collect();
        let mut known = Known {
            arms: std::array::from_fn(|i| published.get(i).filter(|arm| is_known(arm))),
            ..Known::default()
        };
        known.arms[effector] = Some(arm).filter(|arm| is_known(arm));
        (known.tools[effector], known.manners[effector]) = (tool, Some(manner));
        let mut orders: PerArm<Option<Behaviour>> = [const { None }; MOST_ARMS];
        let mut forecasts = [const { None }; MOST_ARMS];
        (orders[effector], forecasts[effector]) = (Some(order.clone()), forecast);
        let guard = ways::present(&self.guard, known.arms).by_hand();
        ways::admit(&guard, known, &mut orders, &forecasts)
            .map_err(|why| NonFatal::Arguments(why.to_string()))?;
        if let Some(admitted) = orders[effector].take() {
            *order = admitted;
        }
        Ok(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::*;
    use crate::actors::move_instruction::example_manner;
    use crate::actors::testing::{meeting, to};
    use crate::generators::own::{MotionGenerator as _, Places};
    use crate::generators::paths::{Along, JointPolyline};
    use crate::motion::{JointPositions, Synchronisation};
    use crate::reach::example_cell;

    /// Returns the state of a synchronised arm that stands at these joint positions.
    fn standing(joints: JointPositions) -> ArmState {
        let arm = &example_cell().arms[0];
        let tool = arm.model.base_from_flange(&joints) * arm.flange_from_tool;
        let (period, desired_base_from_tool) = (1, tool);
        ArmState { desired_joints: joints, desired_base_from_tool, period, ..ArmState::default() }
    }

    /// Passes an order of the track arm, which stands at `from` with the tool frame `tool`, to the
    /// checks beside an arm in the state `other`. Returns the order that may begin.
    fn admitted(
        order: Behaviour,
        (from, tool): (JointPositions, Option<Pose>),
        other: ArmState,
    ) -> Result<Behaviour, String> {
        let arm = standing(from);
        let states = vec![watch::channel(arm).1, watch::channel(other).1];
        let guard = Guard::of(&example_cell(), 0.25);
        let mut order = order;
        Surroundings { effector: 0, guard, states }
            .admit(&mut order, &manner(), (&arm, tool))
            .map_err(|why| why.to_string())?;
        Ok(order)
    }

    /// Returns parameters of generators whose full speed along the track is too fast near the
    /// operator.
    fn manner() -> Manner {
        let mut manner = example_manner();
        (manner.speeds.joint[0], manner.speeds.joint_acceleration[0]) = (0.5, 1.0);
        manner
    }

    #[test]
    fn programme_keeps_off_known_arm() {
        let (meeting, along) = meeting();
        let other = standing(meeting.postument);
        let lost = ArmState { synchronisation: Synchronisation::No, ..other };
        let through = |other| admitted(to(along(0.3)), (along(-0.3), None), other);

        let refused = through(other).unwrap_err();
        assert!(refused.contains("mm of each other"), "{refused}");
        assert!(through(lost).is_ok(), "its place is unknown");
        assert!(admitted(to(along(-0.4)), (along(-0.3), None), other).is_ok());
        // MP may let the hands meet, because its plan moves both.
        let meets = admitted(to(meeting.track), (meeting.track_back, None), other).unwrap_err();
        assert!(meets.contains("the hands come within"), "{meets}");
        let order = JointPolyline { through: vec![along(0.3)], blend: 0.2, speed: 1.0 };
        let declared = Along::behaviour("joint_polyline", &order).unwrap();
        assert!(admitted(declared, (along(-0.3), None), other).is_err());
    }

    #[test]
    fn path_of_programme_is_that_of_changed_tool() {
        let (meeting, along) = meeting();
        let (at, other) = (along(-0.4), standing(meeting.postument));
        let cell = example_cell();
        let stands = standing(at).desired_base_from_tool;
        let base_from_world = cell.arms[0].world_from_base.inverse();
        let lower = |by: f64| {
            let world_from_tool = cell.arms[0].world_from_base * stands;
            let mut low = world_from_tool;
            low.translation.vector.z -= by;
            Behaviour::Line { target: base_from_world * low, speed: 1.0 }
        };

        let refused = admitted(lower(0.6), (at, None), other).unwrap_err();
        assert!(refused.contains("cannot follow its path to x "), "{refused}");
        // The point 0.6 m above the tool goes down by 0.05 m, and so does the tool.
        assert!(admitted(lower(0.05), (at, None), other).is_ok());
        let up = stands.inverse() * base_from_world * Pose::translation(0.0, 0.0, 0.6);
        let tool_from_point = Pose::from_parts(
            (up * cell.arms[0].world_from_base * stands).translation,
            nalgebra::UnitQuaternion::identity(),
        );
        let raised = cell.arms[0].flange_from_tool * tool_from_point;
        let Behaviour::Line { target, speed } = lower(0.05) else { panic!() };
        let of_point = Behaviour::Line { target: target * tool_from_point, speed };
        assert!(admitted(of_point.clone(), (at, Some(raised)), other).is_ok());
        let Behaviour::Line { target, speed } = lower(0.6) else { panic!() };
        let deep = Behaviour::Line { target: target * tool_from_point, speed };
        assert!(admitted(deep, (at, Some(raised)), other).is_err());
    }

    /// The tool goes up by 3 m: the arm would stop at a limit, where a task has no more use for it.
    #[test]
    fn line_out_of_reach_does_not_begin() {
        let (meeting, along) = meeting();
        let (at, other) = (along(-0.4), standing(meeting.postument));
        let stands = standing(at).desired_base_from_tool;
        let up = |by: f64| {
            let target = Pose::translation(0.0, 0.0, by) * stands;
            admitted(Behaviour::Line { target, speed: 1.0 }, (at, None), other)
        };

        let refused = up(3.0).unwrap_err();
        assert!(refused.starts_with("the track arm cannot follow its path to x "), "{refused}");
        assert!(refused.contains(" %: "), "{refused}");
        let Behaviour::Line { target, .. } = up(0.02).unwrap() else { panic!() };
        assert_eq!(target, Pose::translation(0.0, 0.0, 0.02) * stands);
    }

    #[test]
    fn fast_motion_near_operator_gets_more_time() {
        let (meeting, _) = meeting();
        let other = standing(meeting.postument);
        let past = |d0: f64| JointPositions([d0, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]);
        let passes = |speed| {
            let order = Behaviour::Joints { target: past(0.4), speed, seconds: 0.0 };
            admitted(order, (past(0.2), None), other).unwrap()
        };

        let lasts = |order: &Behaviour| manner().seconds(order, &standing(past(0.2)));
        let (fast, full) = (passes(1.0), lasts(&to(past(0.4))));
        assert!(lasts(&fast) > 1.2 * full, "{fast:?}, {full} s at full speed");
        // A motion that is slow enough stays as it was ordered.
        let slow = Behaviour::Joints { target: past(0.4), speed: 0.1, seconds: 0.0 };
        assert_eq!(passes(0.1), slow);
    }
    /// The course to rest of an arm that follows targets: into the other arm, beyond a limit, and
    /// past the operator's hand.
    #[test]
    fn onward_course_keeps_off_obstacles_and_limits() {
        let (meeting, along) = meeting();
        let other = standing(meeting.postument);
        let checked = |from: JointPositions, to: JointPositions, seconds: f64| {
            let arm = standing(from);
            let states = vec![watch::channel(arm).1, watch::channel(other).1];
            let guard = Guard::of(&example_cell(), 0.25);
            let course = Forecast { seconds, places: Places::Joints(vec![from, to]) };
            Surroundings { effector: 0, guard, states }.check_onward(course, &arm)
        };

        assert_eq!(checked(along(-0.3), along(-0.4), 1.0), Ok(()));
        let near = checked(along(-0.3), along(0.0), 1.0).unwrap_err();
        assert!(near.contains("mm of each other"), "{near}");
        let mut far = along(-0.3);
        far.0[2] = 0.0;
        let beyond = checked(along(-0.3), far, 1.0).unwrap_err();
        assert!(beyond.contains("joint 2"), "{beyond}");
        let fast = checked(along(-0.3), along(-0.4), 0.02).unwrap_err();
        assert!(fast.contains("too fast for a motor"), "{fast}");
        let past = |d0: f64| JointPositions([d0, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]);
        let fast = checked(past(0.2), past(0.4), 0.6).unwrap_err();
        assert!(fast.contains("where the operator's hand may be"), "{fast}");
    }
}
