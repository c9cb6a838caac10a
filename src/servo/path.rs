//! The course of a macrostep: set values of each of its periods, linearly between start and end.

use super::tff::{FALLS, ForceFeedback, TaskMotion, heeds_force};
use crate::kinematics::ArmModel;
use crate::motion::{AXES, Direction, JointPositions, Motion, MotorPositions, MoveRefused};
use crate::spatial::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};

/// The kinematic chain from an arm's base to its tool.
#[derive(Debug, Clone, Copy)]
pub struct Chain<'a> {
    /// Geometry, transmissions and limits.
    pub model: &'a ArmModel,
    /// The tool on the flange.
    pub flange_from_tool: &'a Pose,
}

/// Set values of one period; the three agree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SetValues {
    /// Motor shafts.
    pub motors: MotorPositions,
    /// Joints.
    pub joints: JointPositions,
    /// `base_from_tool`.
    pub base_from_tool: Pose,
}

impl SetValues {
    /// Returns the set values of joint positions.
    #[must_use]
    pub fn of_joints(chain: Chain<'_>, joints: JointPositions) -> Self {
        Self {
            motors: chain.model.motors(&joints),
            joints,
            base_from_tool: chain.model.base_from_flange(&joints) * chain.flange_from_tool,
        }
    }

    /// Returns the set values of motor positions.
    #[must_use]
    pub fn of_motors(chain: Chain<'_>, motors: MotorPositions) -> Self {
        let joints = chain.model.joints_unchecked(&motors);
        let base_from_tool = chain.model.base_from_flange(&joints) * chain.flange_from_tool;
        Self { motors, joints, base_from_tool }
    }

    /// Returns these with other motor positions, whatever they mean: if the motor positions have no
    /// joints, the present joints stay.
    #[must_use]
    pub fn moved_to(&self, chain: Chain<'_>, motors: MotorPositions) -> Self {
        let next = Self::of_motors(chain, motors);
        if next.joints.0.iter().all(|q| q.is_finite()) { next } else { Self { motors, ..*self } }
    }

    /// Returns the set values of a pose, by the solution nearest to `near`.
    ///
    /// # Errors
    /// As [`ArmModel::inverse`].
    pub fn of_pose(
        chain: Chain<'_>,
        base_from_tool: Pose,
        near: &JointPositions,
    ) -> Result<Self, MoveRefused> {
        let Chain { model, flange_from_tool } = chain;
        let joints = model.inverse(&(base_from_tool * flange_from_tool.inverse()), near)?;
        Ok(Self { motors: model.motors(&joints), joints, base_from_tool })
    }

    /// Returns the set values of a task motion's pose, near the last ones.
    fn of_task(
        chain: Chain<'_>,
        mut base_from_tool: Pose,
        last: &Self,
    ) -> Result<Self, MoveRefused> {
        // Rounding would make the rotation drift from unit length over a long contact.
        base_from_tool.rotation.renormalize();
        Self::of_pose(chain, base_from_tool, &last.joints)
    }

    /// Returns the speed of the fastest motor, as a share of its limit, coming from `last` in a
    /// period of `seconds`.
    fn haste(&self, model: &ArmModel, last: &Self, seconds: f64) -> f64 {
        let moved = self.motors.0.iter().zip(&last.motors.0).map(|(to, from)| (to - from).abs());
        moved.fold(0.0, f64::max) / (seconds * model.motor_speed_limit)
    }

    /// Whether the drives may be asked for these, coming from `last` in a period of `seconds`.
    ///
    /// # Errors
    /// The first limit that is exceeded, or a number that is none.
    pub fn check(&self, model: &ArmModel, last: &Self, seconds: f64) -> Result<(), MoveRefused> {
        model.check_joints(&self.joints)?;
        model.check_motors(&self.motors)?;
        self.check_speed(model, last, seconds)
    }

    /// Whether the drives can follow, coming from `last` in a period of `seconds`: the check of an arm that is not synchronised.
    ///
    /// # Errors
    /// The first motor that would be too fast, or a number that is none.
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
            if !rate.is_finite() {
                return Err(MoveRefused::NotANumber);
            }
        }
        Ok(())
    }
}

/// Position-force control goes no faster than this share of what a motor does; the regulators need
/// the rest.
pub const GOVERNED: f64 = 0.975;
/// A step that wants more than this many times that speed is refused, not slowed down, and so is a
/// motion that wants too much for so many periods: no motor does what was ordered, or the arm is
/// near a singularity.
const MOST_GOVERNED: f64 = 1.5;
const GOVERNED_PERIODS: u32 = 250;

/// A macrostep under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Path {
    kind: Kind,
    begin: u64,
    /// Last period.
    pub end: u64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Hold,
    Motors {
        from: MotorPositions,
        to: MotorPositions,
    },
    /// The same for an arm that may not know its joints.
    MotorsBy {
        from: MotorPositions,
        to: MotorPositions,
    },
    Joints {
        from: JointPositions,
        to: JointPositions,
    },
    Pose {
        from: Pose,
        to: Pose,
        rotation: Vector3<f64>,
    },
    Task(TaskMotion),
}

impl Path {
    /// The course from `from` in periods `begin..=end`.
    #[must_use]
    pub fn new(motion: &Motion, from: &SetValues, begin: u64, end: u64) -> Self {
        let kind = match *motion {
            Motion::Hold => Kind::Hold,
            Motion::Motors(to) => Kind::Motors { from: from.motors, to },
            Motion::MotorsBy(by) => {
                Kind::MotorsBy { from: from.motors, to: sum(&from.motors, &by) }
            }
            Motion::Joints(to) => Kind::Joints { from: from.joints, to },
            Motion::Pose(to) => straight(from.base_from_tool, to),
            Motion::Task { frame, directions } => Kind::Task(TaskMotion { frame, directions }),
        };
        Self { kind, begin, end }
    }

    /// Whether it leads to a place, so that something may be met on the way. Motors that turn by so much do not: they free
    /// arms, and find those that do not know where they are.
    #[must_use]
    pub fn leads_to_a_place(&self) -> bool {
        matches!(self.kind, Kind::Motors { .. } | Kind::Joints { .. } | Kind::Pose { .. })
    }

    /// Returns the set values of a period; the last ones are `last`.
    ///
    /// # Errors
    /// Why there are none: the pose cannot be reached.
    pub fn at(
        &self,
        period: u64,
        last: &SetValues,
        chain: Chain<'_>,
        feedback: ForceFeedback<'_>,
    ) -> Result<SetValues, MoveRefused> {
        debug_assert!((self.begin..=self.end).contains(&period), "{period} is not of {self:?}");
        let share = (period + 1 - self.begin) as f64 / (self.end + 1 - self.begin) as f64;
        let mix = |a: &[f64; AXES], b: &[f64; AXES]| {
            // The end itself, not its neighbour by rounding.
            std::array::from_fn(|i| if share < 1.0 { a[i] + share * (b[i] - a[i]) } else { b[i] })
        };
        match &self.kind {
            Kind::Hold => Ok(*last),
            Kind::Motors { from, to } => {
                let motors = MotorPositions(mix(&from.0, &to.0));
                chain.model.check_motors(&motors)?;
                Ok(SetValues::of_motors(chain, motors))
            }
            Kind::MotorsBy { from, to } => {
                let motors = MotorPositions(mix(&from.0, &to.0));
                Ok(last.moved_to(chain, motors))
            }
            Kind::Joints { from, to } => {
                let joints = JointPositions(mix(&from.0, &to.0));
                Ok(SetValues::of_joints(chain, joints))
            }
            Kind::Pose { from, to, rotation } => {
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
                // A turn orders more than its speed against a layer's resistance, and torques help.
                // Such a motion is due at no place at a certain time, so it may go slower.
                let haste = to.haste(chain.model, last, law.seconds()) / GOVERNED;
                let governed =
                    heeds_force(&task.directions) && (1.0..MOST_GOVERNED).contains(&haste);
                if law.shortened(governed) <= GOVERNED_PERIODS && governed {
                    SetValues::of_task(chain, law.shorten(1.0 / haste, from), last)
                } else {
                    Ok(to)
                }
            }
        }
    }

    /// The directions, when this is position-force control.
    #[must_use]
    pub fn directions(&self) -> Option<&[Direction; 6]> {
        match &self.kind {
            Kind::Task(task) => Some(&task.directions),
            _ => None,
        }
    }

    /// Lets position-force control go on until period `end`, without velocity, towards no force.
    /// Its speed falls off as that of any motion that is broken off: set values that stop dead trip
    /// the power stages.
    pub fn yields(&mut self, end: u64) {
        self.end = end;
        if let Kind::Task(TaskMotion { directions, .. }) = &mut self.kind {
            *directions = directions.map(|direction| {
                let (admittance, inertia) = match direction {
                    // As stiff as makes no difference.
                    Direction::Unguarded { .. } => (1e-9, 0.0),
                    Direction::Guarded { admittance, inertia, .. }
                    | Direction::Contact { admittance, inertia, .. } => (admittance, inertia),
                };
                let inertia = f64::max(inertia, FALLS / admittance.max(1e-9));
                Direction::Contact { wanted: 0.0, admittance, inertia }
            });
        }
    }

    /// Starts a straight line anew from `from` in `period`: the tool's frame has changed under way.
    pub fn retarget(&mut self, from: Pose, period: u64) {
        if let Kind::Pose { to, .. } = self.kind {
            self.kind = straight(from, to);
            self.begin = period.min(self.end);
        }
    }
}

fn sum(a: &MotorPositions, b: &MotorPositions) -> MotorPositions {
    MotorPositions(std::array::from_fn(|i| a.0[i] + b.0[i]))
}

fn straight(from: Pose, to: Pose) -> Kind {
    let rotation = (from.rotation.inverse() * to.rotation).scaled_axis();
    Kind::Pose { from, to, rotation }
}

/// Checks whether a motion can be begun from `from` and ended within `seconds`: its end is checked
/// beforehand, so that a wrong command does not move the arm at all.
///
/// # Errors
/// The first limit that its end exceeds, or the speed that it would need.
pub fn check_end(
    motion: &Motion,
    seconds: f64,
    from: &SetValues,
    chain: Chain<'_>,
) -> Result<(), MoveRefused> {
    let model = chain.model;
    let motors = match motion {
        Motion::Hold => return Ok(()),
        Motion::Motors(to) => {
            let joints = model.joints(to)?;
            model.check_joints(&joints)?;
            *to
        }
        // Whether its end is inside the limits is checked on the way, where the arm knows its place.
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
        // Limits are checked on the way: which solution it ends in depends on the way.
        Motion::Pose(to) => {
            return SetValues::of_pose(chain, *to, &from.joints).map(|_| ());
        }
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
    for axis in 0..AXES {
        let rate = (motors.0[axis] - from.motors.0[axis]) / seconds;
        let limit = model.motor_speed_limit;
        if rate.abs() > limit {
            return Err(MoveRefused::TooFast { axis, rate, limit });
        }
    }
    Ok(())
}
