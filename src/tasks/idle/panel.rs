//! The kernel of MP while the operator moves the arms by hand.
//!
//! - in: the operator's orders, one at a time
//! - out: the behaviour that carries one out, or the order itself where no behaviour does; the
//!   kernel never finishes by itself
//! - source: the operator's panel of the original (synchronise; moves in motors, joints and tool
//!   axes; named poses); base and world axes as on a pendant

use crate::generators::{Behaviour, Outcome};
use crate::kernel::procedure::{Port, Procedure, Shared};
use crate::kernel::{Action, Event, Finish, Progress, Readings, Remark, Until};
use crate::motion::{AXES, ArmState, Depth, JawCommand, JointPositions};
use crate::operator::{Manual, Step};
use crate::spatial::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use std::ops::Range;

/// Limits and named poses of an arm that the operator moves by hand.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmLimits {
    /// Whether the arm has an axis 0, the track.
    pub has_track: bool,
    /// Named poses to which the operator can send the arm.
    pub poses: Vec<(String, JointPositions)>,
    /// Pose of the base in the world.
    pub world_from_base: Pose,
    /// Smallest and largest distance between the pads (m).
    pub opening: (f64, f64),
    /// Force with which the jaws close (N).
    pub grip: f64,
}

impl ArmLimits {
    /// Returns the valid numbers of an axis of this arm, joint or motor.
    fn axes(&self) -> Range<usize> {
        usize::from(!self.has_track)..AXES
    }
}

/// Kernel of MP for an operator who moves the arms by hand.
pub type Panel = Procedure<(), (), Board>;

/// State behind the port.
#[derive(Debug, Default)]
pub struct Board {
    /// States of the arms at the last event.
    arms: Vec<ArmState>,
    /// Notes that the shell has not taken yet.
    notes: Vec<Remark>,
}

impl Shared for Board {
    type Entry = Progress;

    fn see(&mut self, readings: &Readings<'_>) {
        self.arms.clear();
        self.arms.extend_from_slice(readings.arms);
    }

    fn take_notes(&mut self) -> Vec<Remark> {
        std::mem::take(&mut self.notes)
    }
}

/// Share of the full speed in motions by hand.
const SPEED: f64 = 0.25;
/// Least time of a motion of the jaws (s).
const JAW_SECONDS: f64 = 0.6;
/// Largest step of one order: of axis 0 or of the tool along an axis (m), of a rotary joint or of
/// the tool about an axis (rad), of a motor (rad).
const FARTHEST: (f64, f64, f64) = (0.2, 0.6, 60.0);

/// Makes the kernel with which the operator moves these arms by hand.
#[must_use]
pub fn panel(arms: Vec<ArmLimits>) -> Panel {
    let port = Port::new(Board::default());
    Procedure::new(port.clone(), by_hand(port, arms))
}

/// Carries out the operator's orders, one after the other, for ever.
async fn by_hand(port: Port<(), (), Board>, limits: Vec<ArmLimits>) -> Finish {
    port.request(Action::Phase("by hand")).await;
    loop {
        // MP itself reports trouble to the operator, so an event other than an order needs no note.
        let Event::Ordered(effector, order) = port.request(Action::Await).await else { continue };
        let note = match port.state(|shared| action(&limits, effector, order, &shared.arms)) {
            Ok(action) => match port.request(action).await {
                Event::Behaved(outcomes) => {
                    // A behaviour that ended as ordered needs no note either.
                    outcomes.into_iter().flatten().find(Outcome::alarms).map(|met| met.to_string())
                }
                _ => None,
            },
            Err(why) => Some(format!("not done: {why}")),
        };
        port.state(|shared| shared.notes.extend(note.map(Remark::Deviation)));
    }
}

/// Returns the action by which an effector carries out the operator's order, or the reason why the
/// order is refused.
fn action(
    limits: &[ArmLimits],
    effector: usize,
    order: Manual,
    arms: &[ArmState],
) -> Result<Action<()>, String> {
    let (Some(limits), Some(state)) = (limits.get(effector), arms.get(effector)) else {
        return Err(format!("there is no effector {effector}"));
    };
    let behaviour = match order {
        // MP itself synchronises an arm and turns single motors, since behaviours need a
        // synchronised arm.
        Manual::Synchronise => return Ok(Action::Manual { effector, order }),
        Manual::Motor(step) => {
            within(step, (FARTHEST.2, "rad"), limits.axes())?;
            return Ok(Action::Manual { effector, order });
        }
        Manual::Bias => return Ok(Action::Bias((0..arms.len()).map(|i| i == effector).collect())),
        Manual::Joint(step) => {
            let most = if step.axis == 0 { (FARTHEST.0, "m") } else { (FARTHEST.1, "rad") };
            within(step, most, limits.axes())?;
            // The set joints, not the measured ones: several orders in a row must not collect the
            // servo's lag.
            let mut target = state.desired_joints;
            target.0[step.axis] += step.by;
            Behaviour::Joints { target, speed: SPEED, seconds: 0.0 }
        }
        Manual::Tool(step) | Manual::Base(step) | Manual::World(step) => {
            let most = if step.axis < 3 { (FARTHEST.0, "m") } else { (FARTHEST.1, "rad") };
            within(step, most, 0..6)?;
            let from = state.desired_base_from_tool;
            // The axes in which the tool moves, in those of the base.
            let axes = match order {
                Manual::Tool(_) => from.rotation,
                Manual::World(_) => limits.world_from_base.rotation.inverse(),
                _ => UnitQuaternion::identity(),
            };
            Behaviour::Line { target: moved(&from, &axes, step), speed: SPEED }
        }
        Manual::Jaw { opening } => {
            let (low, high) = limits.opening;
            if !(low..=high).contains(&opening) {
                return Err(format!("the jaws open from {:.0} to {:.0} mm", low * 1e3, high * 1e3));
            }
            Behaviour::Jaw {
                jaw: JawCommand { opening, force_limit: limits.grip, stops: Depth::One },
                seconds: JAW_SECONDS,
                selector: [false; 6],
                strained: false,
            }
        }
        Manual::Pose { name } => {
            let pose = limits.poses.iter().find(|(known, _)| *known == name);
            let (_, target) = pose.ok_or_else(|| format!("there is no pose `{name}`"))?;
            Behaviour::Joints { target: *target, speed: SPEED, seconds: 0.0 }
        }
    };
    let orders = (0..arms.len()).map(|i| (i == effector).then(|| behaviour.clone())).collect();
    Ok(Action::Behave { orders, until: Until::Effector(effector) })
}

/// Returns the pose of a tool after a step along (axes 0..=2) or about (3..=5) one of these `axes`
/// (m, rad); the tool point stays where it is in a turn.
fn moved(base_from_tool: &Pose, axes: &UnitQuaternion<f64>, step: Step) -> Pose {
    let mut axis = Vector3::zeros();
    axis[step.axis % 3] = step.by;
    let axis = axes * axis;
    let mut to = *base_from_tool;
    if step.axis < 3 {
        to.translation.vector += axis;
    } else {
        to.rotation = UnitQuaternion::from_scaled_axis(axis) * to.rotation;
    }
    to
}

/// Checks that a step is on one of `axes` and moves by at most `farthest` (in `unit`), else returns
/// the reason for the operator.
fn within(step: Step, (farthest, unit): (f64, &str), axes: Range<usize>) -> Result<(), String> {
    if !axes.contains(&step.axis) {
        return Err(format!("this arm has no axis {}", step.axis));
    }
    if step.by.abs() <= farthest {
        return Ok(());
    }
    Err(format!(
        "a step of {:.2} {unit} exceeds {farthest:.2} {unit}, the limit of one order",
        step.by
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sensor::SensorReadings;
    use crate::kernel::{Forces, Kernel as _};
    use std::f64::consts::FRAC_PI_2;

    /// Set joints of both arms in these tests. Each joint has another position.
    const SET: [f64; AXES] = [0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875];

    /// Makes the kernel for two arms that know the pose `front`. Only the second one has a track.
    fn two_arms() -> Panel {
        let poses = vec![("front".to_owned(), JointPositions([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))];
        let arm = |has_track| {
            let poses = poses.clone();
            // The base is turned by a right angle about z.
            let turn = UnitQuaternion::from_scaled_axis(FRAC_PI_2 * Vector3::z());
            let world_from_base = Pose::from_parts(Vector3::new(1.0, 2.0, 0.0).into(), turn);
            ArmLimits { has_track, poses, world_from_base, opening: (0.04, 0.09), grip: 40.0 }
        };
        panel(vec![arm(false), arm(true)])
    }

    /// Returns the action of the kernel after an order to an effector, and the notes to the
    /// operator. The measured joints of the arms lag behind the set ones.
    fn after(effector: usize, order: Manual) -> (Action<()>, Vec<Remark>) {
        let mut panel = two_arms();
        let joints = JointPositions(SET.map(|set| set - 0.0625));
        let arm = ArmState {
            joints,
            desired_joints: JointPositions(SET),
            desired_base_from_tool: turned(),
            ..ArmState::default()
        };
        let readings = Readings {
            arms: &[arm; 2],
            forces: &Forces::default(),
            sensors: &SensorReadings::default(),
        };
        assert!(matches!(panel.next(Event::Start, &readings), Action::Phase(_)));
        assert_eq!(panel.next(Event::Done, &readings), Action::Await);
        (panel.next(Event::Ordered(effector, order), &readings), panel.notes())
    }

    /// Makes an order for a step of a joint.
    fn joint(axis: usize, by: f64) -> Manual {
        Manual::Joint(Step { axis, by })
    }

    /// Makes an order for a step of the tool.
    fn tool(axis: usize, by: f64) -> Manual {
        Manual::Tool(Step { axis, by })
    }

    /// Makes an order for a step of a motor.
    fn motor(axis: usize, by: f64) -> Manual {
        Manual::Motor(Step { axis, by })
    }

    #[test]
    fn joint_step_changes_target_of_that_joint_only() {
        for (axis, by) in [(1, 0.25), (2, -0.125), (6, 0.5)] {
            let (action, _) = after(0, joint(axis, by));

            let Action::Behave { orders, until: Until::Effector(0) } = action else {
                panic!("{action:?}")
            };
            let [Some(Behaviour::Joints { target, .. }), None] = orders[..] else {
                panic!("{orders:?}")
            };
            let mut expected = SET;
            expected[axis] += by;
            assert_eq!(target.0, expected);
        }
    }

    /// Returns the set pose of the tool in [`after`]: its z lies along the base's x.
    fn turned() -> Pose {
        let turn = UnitQuaternion::from_scaled_axis(FRAC_PI_2 * Vector3::y());
        Pose::from_parts(Vector3::new(0.5, 0.1, 0.9).into(), turn)
    }

    #[test]
    fn tool_moves_along_axes_of_chosen_frame() {
        let target = |order: Manual| -> Pose {
            match after(0, order).0 {
                Action::Behave { orders, .. } => match orders[0] {
                    Some(Behaviour::Line { target, .. }) => target,
                    ref other => panic!("{other:?}"),
                },
                other => panic!("{other:?}"),
            }
        };
        let start = turned();
        for (order, direction) in [
            // The tool's z lies along the base's x.
            (Manual::Tool(Step { axis: 2, by: 0.1 }), Vector3::x()),
            (Manual::Base(Step { axis: 2, by: 0.1 }), Vector3::z()),
            // The world's x lies along the base's -y.
            (Manual::World(Step { axis: 0, by: 0.1 }), -Vector3::y()),
        ] {
            let along = target(order.clone());
            let by: Vector3<f64> = along.translation.vector - start.translation.vector;
            assert!((by - direction * 0.1).norm() < 1e-12, "{order:?}: {by}");
            assert!(along.rotation.angle_to(&start.rotation) < 1e-7, "{order:?}");
        }
        for (order, axis) in [
            (Manual::Tool(Step { axis: 5, by: 0.3 }), Vector3::x()),
            (Manual::Base(Step { axis: 5, by: 0.3 }), Vector3::z()),
            (Manual::World(Step { axis: 3, by: 0.3 }), -Vector3::y()),
        ] {
            let about = target(order.clone());
            let by: Vector3<f64> = (about.rotation * start.rotation.inverse()).scaled_axis();
            assert!((by - axis * 0.3).norm() < 1e-9, "{order:?}: {by}");
            assert_eq!(about.translation, start.translation, "{order:?}: the point stays");
        }
    }

    #[test]
    fn panel_refuses_senseless_orders_with_reason() {
        for (effector, order, reason) in [
            (0, joint(7, 0.1), "this arm has no axis 7"),
            (0, tool(6, 0.1), "this arm has no axis 6"),
            (0, Manual::World(Step { axis: 6, by: 0.1 }), "this arm has no axis 6"),
            (0, Manual::Base(Step { axis: 0, by: 0.21 }), "a step of 0.21 m exceeds 0.20 m"),
            // The first arm has no track.
            (0, motor(0, 2.0), "this arm has no axis 0"),
            (0, joint(0, 0.01), "this arm has no axis 0"),
            (0, joint(1, 0.61), "a step of 0.61 rad exceeds 0.60 rad"),
            (0, joint(6, -0.61), "a step of -0.61 rad exceeds 0.60 rad"),
            (1, joint(0, 0.21), "a step of 0.21 m exceeds 0.20 m"),
            (0, tool(2, -0.21), "a step of -0.21 m exceeds 0.20 m"),
            (0, tool(3, 0.61), "a step of 0.61 rad exceeds 0.60 rad"),
            (0, tool(0, f64::NAN), "a step of NaN m exceeds 0.20 m"),
            (0, motor(1, 60.5), "a step of 60.50 rad exceeds 60.00 rad"),
            (0, Manual::Jaw { opening: 0.0905 }, "the jaws open from 40 to 90 mm"),
            (0, Manual::Jaw { opening: 0.0395 }, "the jaws open from 40 to 90 mm"),
            (0, Manual::Pose { name: "moon".into() }, "there is no pose `moon`"),
            (2, Manual::Synchronise, "there is no effector 2"),
        ] {
            let (action, notes) = after(effector, order.clone());
            assert_eq!(action, Action::Await, "{order:?}");
            let [note] = &notes[..] else { panic!("{order:?}: {notes:?}") };
            assert!(note.text().starts_with(&format!("not done: {reason}")), "{order:?}: {note:?}");
        }
    }

    #[test]
    fn panel_accepts_orders_up_to_their_limits() {
        for (effector, order) in [
            (0, joint(1, 0.6)),
            (0, joint(6, -0.6)),
            (1, joint(0, 0.2)),
            (0, tool(0, -0.2)),
            (0, tool(2, 0.2)),
            (0, tool(3, 0.6)),
            (0, tool(5, -0.6)),
            (0, motor(1, 60.0)),
            (1, motor(0, -60.0)),
            (0, Manual::Jaw { opening: 0.04 }),
            (0, Manual::Jaw { opening: 0.09 }),
            (0, Manual::Pose { name: "front".into() }),
        ] {
            let (action, notes) = after(effector, order.clone());
            let acts = matches!(action, Action::Behave { .. } | Action::Manual { .. });
            assert!(acts && notes.is_empty(), "{order:?}: {action:?} {notes:?}");
        }
    }

    #[test]
    fn panel_forwards_motor_and_synchronise_orders_unchanged() {
        for (effector, order) in [(0, Manual::Synchronise), (1, motor(3, 2.0))] {
            let (action, _) = after(effector, order.clone());
            assert_eq!(action, Action::Manual { effector, order });
        }
    }
}
