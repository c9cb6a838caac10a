//! From a scenario's controller section to what the shells and kernels are made of.

use super::move_instruction::Manner;
use super::supervisor::RunOptions;
use crate::cell::{Cell, Mount};
use crate::cube::{Axis, Face};
use crate::generators::{Compliance, position::Speeds, visual_servo};
use crate::hw::driver::WallOptions;
use crate::motion::{AXES, Depth};
use crate::reach::{Meeting, MeetingTable};
use crate::scenario::{ControllerConfig, Scenario, keys};
use crate::spatial::Pose;
use crate::tasks::cube::hold::Hold;
use crate::tasks::cube::mission::Goal;
use crate::tasks::cube::plan::Rule;
use crate::tasks::cube::settings::{ArmBelief, ComplianceChoice, CompliantArm, CubeSettings};
use crate::vision::Method;
use nalgebra::{Point3, Vector3};
use std::f64::consts::PI;

/// How the generators of all effectors behave.
pub(super) fn manner(config: &ControllerConfig) -> Manner {
    let c = &config.control;
    let mut joint = [c.joint_speed; AXES];
    let mut joint_acceleration = [c.joint_acceleration; AXES];
    joint[0] = c.track_speed;
    joint_acceleration[0] = c.track_acceleration;
    joint[6] = joint[6].min(c.roll_speed);
    Manner {
        compliance: Compliance {
            linear_admittance: c.linear_admittance,
            linear_inertia: c.linear_inertia,
            angular_admittance: c.angular_admittance,
            angular_inertia: c.angular_inertia,
            macrostep: c.macrostep_periods,
            jaw_close_speed: c.jaw_close_speed,
            jaw_open_speed: c.jaw_open_speed,
            force_limit: c.force_limit,
            torque_limit: c.torque_limit,
        },
        speeds: Speeds {
            joint,
            joint_acceleration,
            linear: c.linear_speed,
            linear_acceleration: c.linear_acceleration,
            angular: c.angular_speed,
            angular_acceleration: 2.0 * c.angular_speed,
        },
    }
}

/// What is known of an arm, the track first.
fn arm_belief(cell: &Cell, index: usize) -> Option<ArmBelief> {
    let arm = cell.arms.get(index)?;
    let flange_from_camera = cell.cameras.iter().find_map(|camera| match camera.mount {
        Mount::Flange { arm, flange_from_camera } if arm == index => Some(flange_from_camera),
        Mount::Flange { .. } | Mount::World { .. } => None,
    });
    Some(ArmBelief {
        world_from_base: arm.world_from_base,
        flange_from_tool: arm.flange_from_tool,
        flange_from_camera,
    })
}

/// Settings of the cube task; `None` without two arms.
pub(super) fn cube_settings(
    config: &ControllerConfig,
    meetings: MeetingTable,
    back: f64,
) -> Option<CubeSettings> {
    let calibrated_at = meeting_place(&config.cell, &meetings);
    let c = &config.control;
    let v = &config.visual_servo;
    let arm = config.cell.arms.first()?;
    Some(CubeSettings {
        arms: [arm_belief(&config.cell, 0)?, arm_belief(&config.cell, 1)?],
        meetings,
        edge: config.cell.cube.edge,
        grip: c.grip,
        opening: (arm.gripper.opening.1 - 0.003).min(config.cell.cube.edge + 0.031),
        back,
        pre_grasp: 0.012,
        approach_speed: c.approach_speed,
        touch: c.approach_force,
        press: 2.0 * c.approach_force,
        turn_speed: c.turn_speed,
        turn_torque: c.turn_torque,
        turn_least_torque: c.turn_least_torque,
        pull: c.approach_force,
        speed: 1.0,
        speeds: manner(config).speeds,
        jaw_speeds: (c.jaw_close_speed, c.jaw_open_speed),
        compliant_arm: match c.compliant_arm {
            keys::CompliantArm::Body => CompliantArm::Body,
            keys::CompliantArm::Turner => CompliantArm::Turner,
        },
        compliance: match c.compliance {
            keys::Compliance::None => ComplianceChoice::None,
            keys::Compliance::Tff => ComplianceChoice::Tff,
            keys::Compliance::TffTilts => ComplianceChoice::TffTilts,
        },
        visual: visual_servo::Order {
            world_from_base: Pose::identity(),
            // The robot stands on the -x side of the operator; the jaws close above and below the cube, so that
            // the side towards the stand-alone camera stays free.
            approach: Vector3::x(),
            jaws: Vector3::z(),
            seat: 0.0,
            vicinity: v.stand_off,
            frozen: 0.04,
            still_speed: v.still / v.still_time,
            still_seconds: v.still_time,
            retreat: v.withdraw,
            speed: (v.linear_speed, v.angular_speed),
            acceleration: c.linear_acceleration,
            approach_speed: 2.0 * c.approach_speed,
            // A hand gives way: at 300 N/m the arm would push it 13 mm before 4 N are felt.
            touch: 0.5 * c.approach_force,
            stale: v.pose_age,
            patience: v.patience,
        },
        rule: match config.planner.rule {
            keys::Rule::Clearance => Rule::Clearance,
            keys::Rule::Strict => Rule::Strict,
            keys::Rule::Original => Rule::Original,
        },
        nodes: config.planner.node_budget,
        candidates: config.planner.candidates as usize,
        seconds_per_node: config.planner.node_cost,
        calibrated_at,
    })
}

/// How the stand-alone camera's sensor finds the cube.
pub(super) fn method(config: &ControllerConfig) -> Method {
    match config.vision.detector {
        keys::Detector::Lattice => Method::Edges,
        keys::Detector::Paper => Method::Paper2007,
    }
}

/// Where the hands meet on the average: a workshop lets them meet there to find where the bases stand to each other.
pub(super) fn meeting_place(cell: &Cell, table: &MeetingTable) -> Point3<f64> {
    let Some(arm) = cell.arms.first() else { return Point3::origin() };
    let places: Vec<Vector3<f64>> = table
        .grasps
        .iter()
        .flatten()
        .map(|m| {
            let flange = arm.world_from_base * arm.model.base_from_flange(&m.track);
            (flange * arm.flange_from_tool).translation.vector
        })
        .collect();
    Point3::from(places.iter().sum::<Vector3<f64>>() / places.len().max(1) as f64)
}

/// How the servo's thread runs.
pub(super) fn wall(scenario: &Scenario, options: RunOptions) -> WallOptions {
    let keys = &scenario.real_time;
    WallOptions {
        spin: (keys.spin * 1e9).round() as u64,
        priority: keys.priority,
        core: keys.core.map(|core| core as usize),
        missed_limit: u64::from(keys.missed_limit),
        require_real_time: options.require_real_time,
        ..WallOptions::default()
    }
}

/// What the cube's kernel is to do; `None` when the task is another one. A face turn by `angle` [rad] is positive
/// clockwise seen from outside, which is positive about the tool's z.
pub(super) fn goal(config: &ControllerConfig, angle: f64) -> Option<Goal> {
    Some(match config.task {
        keys::Task::Solve => Goal::Solve,
        keys::Task::Acquire => Goal::Acquire,
        keys::Task::FaceTurn => Goal::FaceTurn(angle),
        keys::Task::Idle => return None,
    })
}

/// How a face turn begins: the postument's hand holds two layers, the track's is drawn back from the opposite face.
pub(super) struct FaceTurnStart {
    /// The postument's hold.
    pub(super) body: Hold,
    /// Which tool frame the postument has.
    pub(super) half_roll: bool,
    /// Where both arms stand.
    pub(super) meeting: Meeting,
}

/// Where the wrist's room ends before its limits [rad].
const ROLL_MARGIN: f64 = 0.12;

/// How a face turn begins whose `angle` the track's wrist has room for, about its tool's z; a half turn may go either
/// way.
///
/// # Errors
/// Why there is none, for people.
pub(super) fn face_turn_start(
    table: &MeetingTable,
    angle: f64,
) -> Result<(FaceTurnStart, f64), String> {
    let body = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::Two };
    let turner = Hold { palm: Face::U, jaws: Axis::Y, depth: Depth::One };
    let track = turner.cube_from_tool(false, 0.0).rotation;
    let mut rooms = Vec::new();
    for half_roll in [false, true] {
        let postument = body.cube_from_tool(half_roll, 0.0).rotation;
        let index = crate::cube::rotation_index(&(track.inverse() * postument));
        let Some(meeting) = table.grasps[index] else { continue };
        let room = (meeting.track_roll.0 + ROLL_MARGIN, meeting.track_roll.1 - ROLL_MARGIN);
        let same = (angle.abs() - PI).abs() < 1e-9;
        for asked in [angle, if same { -angle } else { angle }] {
            if (room.0..=room.1).contains(&asked) {
                return Ok((FaceTurnStart { body, half_roll, meeting }, asked));
            }
        }
        rooms.push(format!("{:.0}..{:.0} deg", room.0.to_degrees(), room.1.to_degrees()));
    }
    if rooms.is_empty() {
        return Err("the cell has no place where both hands can hold the cube".to_owned());
    }
    Err(format!(
        "face_turn.angle_deg = {:.0}: where the hands meet, the track's wrist can turn by {}",
        angle.to_degrees(),
        rooms.join(" or ")
    ))
}
