//! The door of the task `follow_contour`: from places in the world to the joints of both arms.
//!
//! - in: keys, the believed cell
//! - out: the orders of both programmes
//! - hands point down, their jaws close along x of the world

use super::keys::Keys;
use super::master::follow_contour;
use super::orders::{FollowerOrder, Hand, PickerOrder, Spot};
use crate::cell::{Arm, Gripper};
use crate::generators::contact::ContourOrder;
use crate::kernel::robot::RobotKernel;
use crate::motion::JointPositions;
use crate::registry::{Setup, Task};
use crate::scenario::ControllerConfig;
use crate::scenario::declared::Properties;
use crate::scenario::keys::Coordination;
use crate::scenario::section::Reader;
use crate::spatial::Pose;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Height above a place from which a hand comes down, and to which it lifts a part (m).
const ABOVE: f64 = 0.07;
/// Distance by which a part may be narrower than it should be (m).
const NARROWER: f64 = 0.003;
/// Room that open jaws leave to the end of their stroke (m).
const STROKE: f64 = 0.001;
/// Opening of the jaws beyond the width of a part (m).
const ROOM: f64 = 0.01;
/// Farthest place of the track at which the arms keep apart (m).
const FARTHEST: f64 = 1.0;
/// Time without contact after which the contour is lost (s).
const LOST: f64 = 0.5;

/// Task `follow_contour`: one arm follows a contour, the other one picks parts and passes one on.
#[derive(Debug)]
pub struct FollowContour;

impl Task for FollowContour {
    type Keys = Keys;
    type Kernel = RobotKernel;
    const PROPERTIES: Properties = Properties {
        effectors: 2,
        most_effectors: 2,
        coordination: &[Coordination::Sporadic],
        ..Properties::PLAIN
    };

    fn check(keys: &mut Keys, _: &ControllerConfig, reader: &mut Reader) {
        let (parts, goals) = (keys.parts_xyz.len(), keys.goals_xyz.len());
        if parts == 0 || parts != goals {
            let why = format!("`follow_contour.goals_xyz_mm`: {goals} places for {parts} parts");
            reader.fault("follow_contour.goals_xyz_mm", why);
        }
    }

    fn kernel(setup: Setup<'_, Self>) -> Result<RobotKernel, String> {
        let (keys, config) = (setup.keys, setup.config);
        let [follower, picker] = config.cell.arms.as_slice() else {
            return Err("two arms are needed".to_owned());
        };
        for arm in [follower, picker] {
            arm.opens_for("a part", keys.part_size[1] + ROOM + STROKE)?;
        }
        let grip = config.control.grip;
        let orders = Orders { keys, grip };
        Ok(follow_contour(orders.follower(follower)?, orders.picker(picker)?))
    }
}

/// Makes the orders.
struct Orders<'a> {
    keys: &'a Keys,
    /// Grip force (N).
    grip: f64,
}

impl Orders<'_> {
    /// Returns the order of the arm that follows the contour.
    fn follower(&self, arm: &Arm) -> Result<FollowerOrder, String> {
        let keys = self.keys;
        // x of the tool is y of the world.
        let [x, y, z] = keys.probe_xyz;
        let ball = Vector3::new(y, x, -z);
        let begin = Vector3::from(keys.contour_xyz) - ball;
        let contour = ContourOrder {
            press: Vector3::z(),
            travel: Vector3::x(),
            force: keys.force,
            speed: keys.speed,
            length: keys.length,
            turns: false,
            friction: keys.friction,
            patience: LOST,
        };
        let last = keys.goals_xyz.last().ok_or("no part is to be handed over")?;
        Ok(FollowerOrder {
            begin: spot(arm, begin, 0.0)?,
            contour,
            take: spot(arm, self.at(keys.handover_xyz, -0.5), ABOVE)?,
            goal: spot(arm, self.at(*last, -0.5), ABOVE)?,
            hand: self.hand(arm),
        })
    }

    /// Returns the order of the arm that picks parts.
    fn picker(&self, arm: &Arm) -> Result<PickerOrder, String> {
        let keys = self.keys;
        let pairs: Vec<_> = keys.parts_xyz.iter().zip(&keys.goals_xyz).collect();
        let ((last, _), others) = pairs.split_last().ok_or("no part is to be handed over")?;
        let pair = |(from, to): &(&[f64; 3], &[f64; 3])| -> Result<(Spot, Spot), String> {
            Ok((spot(arm, self.at(**from, 0.0), ABOVE)?, spot(arm, self.at(**to, 0.0), ABOVE)?))
        };
        Ok(PickerOrder {
            parts: others.iter().map(pair).collect::<Result<_, _>>()?,
            last: spot(arm, self.at(**last, 0.5), ABOVE)?,
            present: spot(arm, self.at(keys.handover_xyz, 0.5), 0.0)?,
            hand: self.hand(arm),
        })
    }

    /// Returns the tool point of a hand whose palm lies on a part with this centre (m). `side` is
    /// its place along the part, as a share of the distance between both hands.
    fn at(&self, centre: [f64; 3], side: f64) -> Vector3<f64> {
        let height = 0.5 * self.keys.part_size[2] - Gripper::FACE_BEHIND_TOOL_ONE;
        Vector3::from(centre) + Vector3::new(0.0, side * self.keys.apart, height)
    }

    /// Returns the hand of an arm.
    fn hand(&self, arm: &Arm) -> Hand {
        let least = self.keys.part_size[1] - NARROWER;
        let open = arm.gripper.opening.1 - STROKE;
        Hand { open, least, grip: self.grip, pace: self.keys.pace }
    }
}

/// Returns the spot of an arm at a point of its tool in the world (m), reached from a height above
/// it (m).
fn spot(arm: &Arm, point: Vector3<f64>, height: f64) -> Result<Spot, String> {
    // Columns: x along y of the world, y along x, z down.
    let down = Matrix3::from_columns(&[Vector3::y(), Vector3::x(), -Vector3::z()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(down));
    let at = Translation3::from(point + Vector3::z() * height);
    let above = arm.world_from_base.inverse() * Pose::from_parts(at, rotation);
    let joints = joints(arm, &above)
        .ok_or_else(|| format!("{} cannot reach {:.3?} m", arm.name, point.as_slice()))?;
    Ok(Spot { joints, above, down: height })
}

/// Returns the joints of an arm at a pose of its tool in its base, with the least tool roll.
fn joints(arm: &Arm, base_from_tool: &Pose) -> Option<JointPositions> {
    let flange = base_from_tool * arm.flange_from_tool.inverse();
    let track = if arm.model.has_track { flange.translation.y.clamp(0.0, FARTHEST) } else { 0.0 };
    let found = arm.model.branches(&flange, track);
    let good = found.as_slice().iter().filter(|joints| arm.model.check(joints).is_ok());
    let roll = |joints: &JointPositions| joints.0[6].abs();
    good.min_by(|a, b| roll(a).total_cmp(&roll(b))).copied()
}
