//! The path of a macrostep: set values of each of its periods, linear between start and end.
//!
//! Position-force control has a governor. A turn commands more than its speed against the
//! resistance of a layer, so without a governor a motor would reach its limit.
//!
//! | case | threshold | reaction and reason |
//! |---|---|---|
//! | motor speed in force control | [`GOVERNED_SPEED_SHARE`] | all directions are shortened |
//! | speed far above that | `MOST_GOVERNED` | refusal: the arm is near a singularity |
//! | governor acts for long | `GOVERNED_PERIODS` | refusal: no motor can do the commanded motion |
//! | speed of a motor in any motion | `motor_speed_limit` | refusal |
//!
//! - in: a motion, the set values of the last period, the wrench for position-force control
//! - out: the set values of the period, or the limit that they would exceed

use super::tff::{ForceFeedback, TaskMotion, depends_on_force};
use crate::kinematics::ArmModel;
use crate::motion::{AXES, Direction, JointPositions, Motion, MotorPositions, MoveRefused};
use crate::spatial::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};

/// Time in which an arm that yields loses all but 1/e of its own speed (s). The roll of a wrist
/// that turns a layer, 200 rad/s of its motor, decelerates by 2500 rad/s2 then. In half of that
/// time the motor was 8.2 rad beyond its set value, which was a following error.
const YIELD_FALLS: f64 = 0.08;

/// Kinematic chain from the base of an arm to its tool.
#[derive(Debug, Clone, Copy)]
pub struct Chain<'a> {
    /// Geometry, transmissions and limits.
    pub model: &'a ArmModel,
    /// Pose of the tool on the flange.
    pub flange_from_tool: &'a Pose,
}

/// Set values of one period; the three parts agree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SetValues {
    /// Positions of the motor shafts.
    pub motors: MotorPositions,
    /// Positions of the joints.
    pub joints: JointPositions,
    /// Pose of the tool, `base_from_tool`.
    pub base_from_tool: Pose,
}

impl SetValues {
    /// Returns the set values (motors, joints and pose of the tool) that belong to joint positions.
    #[must_use]
    pub fn of_joints(chain: Chain<'_>, joints: JointPositions) -> Self {
        Self {
            motors: chain.model.motors(&joints),
            joints,
            base_from_tool: chain.model.base_from_flange(&joints) * chain.flange_from_tool,
        }
    }

    /// Returns the set values (motors, joints and pose of the tool) that belong to motor positions.
    /// It does not check limits.
    #[must_use]
    pub fn of_motors(chain: Chain<'_>, motors: MotorPositions) -> Self {
        let joints = chain.model.joints_unchecked(&motors);
        let base_from_tool = chain.model.base_from_flange(&joints) * chain.flange_from_tool;
        Self { motors, joints, base_from_tool }
    }

    /// Returns the set values that belong to the motor positions `motors`. If no joint positions
    /// belong to these, the joints and the pose stay as they are.
    #[must_use]
    pub fn moved_to(&self, chain: Chain<'_>, motors: MotorPositions) -> Self {
        let next = Self::of_motors(chain, motors);
        if next.joints.0.iter().all(|q| q.is_finite()) { next } else { Self { motors, ..*self } }
    }

    /// Returns the set values (motors, joints and pose) that reach a pose of the tool, with the
    /// joint positions nearest to `near`.
    ///
    /// # Errors
    /// The errors of [`ArmModel::inverse`].
    pub fn of_pose(
        chain: Chain<'_>,
        base_from_tool: Pose,
        near: &JointPositions,
    ) -> Result<Self, MoveRefused> {
        let Chain { model, flange_from_tool } = chain;
        let joints = model.inverse(&(base_from_tool * flange_from_tool.inverse()), near)?;
        Ok(Self { motors: model.motors(&joints), joints, base_from_tool })
    }

    /// Returns the set values that reach the pose which position-force control commands, with the
    /// joint positions nearest to the `last` ones.
    fn of_task(
        chain: Chain<'_>,
        mut base_from_tool: Pose,
        last: &Self,
    ) -> Result<Self, MoveRefused> {
        // Rounding would make the rotation drift from unit length over a long contact.
        base_from_tool.rotation.renormalize();
        Self::of_pose(chain, base_from_tool, &last.joints)
    }

    /// Returns the speed of the fastest motor as a share of its limit, if the set values change
    /// from `last` to these in `seconds`.
    fn speed_share(&self, model: &ArmModel, last: &Self, seconds: f64) -> f64 {
        let moved = self.motors.0.iter().zip(&last.motors.0).map(|(to, from)| (to - from).abs());
        moved.fold(0.0, f64::max) / (seconds * model.motor_speed_limit)
    }

    /// Checks that these set values keep the limits of joints and motors, and that the change from
    /// `last` to them in `seconds` keeps those of speeds.
    ///
    /// # Errors
    /// The first limit that is exceeded, or a value that is not a number.
    pub fn check(&self, model: &ArmModel, last: &Self, seconds: f64) -> Result<(), MoveRefused> {
        model.check_joints(&self.joints)?;
        model.check_motors(&self.motors)?;
        self.check_speed(model, last, seconds)
    }

    /// Checks that the change from `last` to these set values in `seconds` keeps the speed limits
    /// of the motors. An arm that is not synchronised has no other limits.
    ///
    /// # Errors
    /// The first motor that would be too fast, or a value that is not a number.
    pub fn check_speed(
        &self,
        model: &ArmModel,
        last: &Self,
        seconds: f64,
    ) -> Result<(), MoveRefused> {
        for axis in 0..AXES {
            let rate = (self.motors.0[axis] - last.motors.0[axis]) / seconds;
            let limit = model.motor_speed_limit;
            if rate.abs() > limit {
                return Err(MoveRefused::TooFast { axis, rate, limit });
            }
            // The comparison above is false for NaN.
            if !rate.is_finite() {
                return Err(MoveRefused::NotANumber);
            }
        }
        Ok(())
    }
}

/// Share of a motor's speed limit to which position-force control is bounded; the regulators need
/// the rest.
pub const GOVERNED_SPEED_SHARE: f64 = 0.975;
/// Multiple of that speed from which a step is refused and no longer shortened: the arm is near a
/// singularity.
const MOST_GOVERNED: f64 = 1.5;
/// Number of periods in a row with shortened steps after which the motion is refused: no motor can
/// do what is commanded.
const GOVERNED_PERIODS: u32 = 250;

/// A running macrostep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Path {
    kind: Kind,
    begin: u64,
    /// Last period.
    pub end: u64,
}

/// Course of the set values, from the start to the end of the path.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Hold,
    /// Line in motor space, for an arm that may not know its joints.
    MotorsBy {
        from: MotorPositions,
        to: MotorPositions,
    },
    Joints {
        from: JointPositions,
        to: JointPositions,
    },
    /// Straight line of the tool point (`base_from_tool`), with a rotation about a fixed axis.
    Pose {
        from: Pose,
        to: Pose,
        /// Axis of the rotation in tool axes, times its angle (rad).
        rotation: Vector3<f64>,
    },
    Task(TaskMotion),
}

impl Path {
    /// Makes the path of `motion` from the set values `from` in the periods `begin..=end`.
    #[must_use]
    pub fn new(motion: &Motion, from: &SetValues, begin: u64, end: u64) -> Self {
        let kind = match *motion {
            Motion::Hold => Kind::Hold,
            Motion::MotorsBy(by) => {
                Kind::MotorsBy { from: from.motors, to: sum(&from.motors, &by) }
            }
            Motion::Joints(to) => Kind::Joints { from: from.joints, to },
            Motion::Pose(to) => straight(from.base_from_tool, to),
            Motion::Task { frame, directions } => Kind::Task(TaskMotion { frame, directions }),
        };
        Self { kind, begin, end }
    }

    /// Returns whether the path leads to given positions or a given pose, so that the arm may meet
    /// an obstacle. Motions that turn the motors by given angles do not count: they free arms, and
    /// move arms that do not know their position.
    #[must_use]
    pub fn may_meet_obstacle(&self) -> bool {
        matches!(self.kind, Kind::Joints { .. } | Kind::Pose { .. })
    }

    /// Returns the set values of a period; `last` are those of the period before.
    ///
    /// # Errors
    /// The reason why the pose or the motor positions cannot be reached.
    pub fn at(
        &self,
        period: u64,
        last: &SetValues,
        chain: Chain<'_>,
        feedback: ForceFeedback<'_>,
    ) -> Result<SetValues, MoveRefused> {
        debug_assert!(
            (self.begin..=self.end).contains(&period),
            "period {period} is outside the path {self:?}"
        );
        let share = (period + 1 - self.begin) as f64 / (self.end + 1 - self.begin) as f64;
        let mix = |a: &[f64; AXES], b: &[f64; AXES]| {
            // The last period takes the goal itself: the sum may differ from it by rounding.
            std::array::from_fn(|i| if share < 1.0 { a[i] + share * (b[i] - a[i]) } else { b[i] })
        };
        match &self.kind {
            Kind::Hold => Ok(*last),
            Kind::MotorsBy { from, to } => {
                // Without synchronisation the motor limits have no meaning here; the servo checks
                // them in each period if the arm is synchronised.
                let motors = MotorPositions(mix(&from.0, &to.0));
                Ok(last.moved_to(chain, motors))
            }
            Kind::Joints { from, to } => {
                let joints = JointPositions(mix(&from.0, &to.0));
                Ok(SetValues::of_joints(chain, joints))
            }
            Kind::Pose { from, to, rotation } => {
                // The tool point moves on a straight line, and the tool turns about one fixed axis.
                let (a, b) = (from.translation.vector, to.translation.vector);
                let pose = Pose::from_parts(
                    Translation3::from(a + share * (b - a)),
                    from.rotation * UnitQuaternion::from_scaled_axis(share * rotation),
                );
                SetValues::of_pose(chain, pose, &last.joints)
            }
            Kind::Task(task) => {
                let ForceFeedback { law, wrench } = feedback;
                let from = &last.base_from_tool;
                let to = SetValues::of_task(chain, law.step(period, task, wrench, from), last)?;
                // A turn commands up to a sixth more than its speed against the resistance of a
                // layer, and this may exceed a motor's limit. A motion under force control has no
                // place to reach at a certain time, so the governor may slow it down.
                let haste = to.speed_share(chain.model, last, law.seconds()) / GOVERNED_SPEED_SHARE;
                let governed =
                    depends_on_force(&task.directions) && (1.0..MOST_GOVERNED).contains(&haste);
                // All directions are shortened alike, so the direction of the step stays. After
                // half a second the full step reaches the check of the speeds, which refuses it
                // above the limit.
                if law.count_shortened(governed) <= GOVERNED_PERIODS && governed {
                    SetValues::of_task(chain, law.shorten(1.0 / haste, from), last)
                } else {
                    Ok(to)
                }
            }
        }
    }

    /// Returns the laws of the six directions, or `None` if the motion is not position-force
    /// control.
    #[must_use]
    pub fn directions(&self) -> Option<&[Direction; 6]> {
        match &self.kind {
            Kind::Task(task) => Some(&task.directions),
            _ => None,
        }
    }

    /// Continues position-force control until period `end`, without velocity and with zero as the
    /// wanted force. The speed falls off within `YIELD_FALLS`, because set values that stop dead
    /// trip the power stages.
    pub fn yield_until(&mut self, end: u64) {
        self.end = end;
        if let Kind::Task(TaskMotion { directions, .. }) = &mut self.kind {
            *directions = directions.map(|direction| {
                let (admittance, inertia) = match direction {
                    // A direction with 1e-9 m/s for each newton is too stiff to yield noticeably.
                    Direction::Unguarded { .. } => (1e-9, 0.0),
                    Direction::Guarded { admittance, inertia, .. }
                    | Direction::Contact { admittance, inertia, .. } => (admittance, inertia),
                };
                // B M is the time constant of the law.
                let inertia = f64::max(inertia, YIELD_FALLS / admittance.max(1e-9));
                Direction::Contact { wanted: 0.0, admittance, inertia }
            });
        }
    }

    /// Lets a path along a straight line continue from the pose `from` in `period`, because the
    /// tool's frame on the flange has changed during the motion.
    pub fn retarget(&mut self, from: Pose, period: u64) {
        if let Kind::Pose { to, .. } = self.kind {
            self.kind = straight(from, to);
            // At least one period must be left for the line.
            self.begin = period.min(self.end);
        }
    }
}

/// Returns the motor positions `a`, each increased by that of `b` (rad).
fn sum(a: &MotorPositions, b: &MotorPositions) -> MotorPositions {
    MotorPositions(std::array::from_fn(|i| a.0[i] + b.0[i]))
}

/// Returns the path of the tool along a straight line between two poses `base_from_tool`.
fn straight(from: Pose, to: Pose) -> Kind {
    let rotation = (from.rotation.inverse() * to.rotation).scaled_axis();
    Kind::Pose { from, to, rotation }
}

/// Checks whether a motion can begin at `from` and end within `seconds`. The check of the end comes
/// before the motion, so that a wrong command does not move the arm at all.
///
/// # Errors
/// The first limit that the end exceeds, or the speed that the motion would need.
pub fn check_end(
    motion: &Motion,
    seconds: f64,
    from: &SetValues,
    chain: Chain<'_>,
) -> Result<(), MoveRefused> {
    let model = chain.model;
    let motors = match motion {
        Motion::Hold => return Ok(()),
        // The limits are checked in each period, and only if the arm knows its position.
        Motion::MotorsBy(by) => {
            if !by.0.iter().all(|m| m.is_finite()) {
                return Err(MoveRefused::NotANumber);
            }
            sum(&from.motors, by)
        }
        Motion::Joints(to) => {
            model.check(to)?;
            model.motors(to)
        }
        // The limits are checked in each period: the path decides in which solution of the inverse
        // kinematics it ends. Here it is enough that the pose has a solution.
        Motion::Pose(to) => {
            return SetValues::of_pose(chain, *to, &from.joints).map(|_| ());
        }
        // Position-force control has no end; its numbers are all that can be checked.
        Motion::Task { directions, .. } => {
            let finite = directions.iter().all(|d| match *d {
                Direction::Unguarded { velocity } => velocity.is_finite(),
                Direction::Guarded { velocity: goal, admittance, inertia }
                | Direction::Contact { wanted: goal, admittance, inertia } => {
                    goal.is_finite() && admittance.is_finite() && inertia.is_finite()
                }
            });
            return if finite { Ok(()) } else { Err(MoveRefused::NotANumber) };
        }
    };
    // The mean speed is a lower bound of the largest one; each period checks its own speed.
    for axis in 0..AXES {
        let rate = (motors.0[axis] - from.motors.0[axis]) / seconds;
        let limit = model.motor_speed_limit;
        if rate.abs() > limit {
            return Err(MoveRefused::TooFast { axis, rate, limit });
        }
    }
    Ok(())
}
