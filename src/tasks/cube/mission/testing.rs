//! Settings for the mission's own tests.

use crate::cube::Keeper;
use crate::generators::{position::Speeds, visual_servo};
use crate::motion::JointPositions;
use crate::reach::{Fold, Meeting, MeetingTable};
use crate::solver::Tables;
use crate::spatial::Pose;
use crate::tasks::cube::plan::Rule;
use crate::tasks::cube::settings::{ArmBelief, ComplianceChoice, CompliantArm, CubeSettings};
use crate::tasks::cube::think::Strategy;
use nalgebra::{Point3, Vector3};
use std::sync::LazyLock;

static TABLES: LazyLock<Tables> = LazyLock::new(Tables::build);

/// A cell whose hands can meet everywhere.
pub(super) fn settings() -> CubeSettings {
    let arm = ArmBelief {
        world_from_base: Pose::identity(),
        flange_from_tool: Pose::identity(),
        flange_from_camera: Some(Pose::identity()),
    };
    let still = JointPositions::default();
    let meeting = Some(Meeting {
        track_from_postument: Pose::identity(),
        track: still,
        postument: still,
        track_back: still,
        postument_back: still,
        track_roll: (-3.2, 3.2),
        postument_roll: (-3.2, 3.2),
        clearance: 0.1,
    });
    CubeSettings {
        arms: [arm; 2],
        folds: [Fold::of_example(), Fold::of_example()],
        meetings: MeetingTable {
            grasps: [meeting; 24],
            views: [[meeting; 3]; 2],
            separation: 0.35,
        },
        edge: 0.057,
        grip: 60.0,
        opening: 0.09,
        back: 0.1,
        pre_grasp: 0.03,
        approach_speed: 0.02,
        touch: 3.0,
        press: 10.0,
        turn_speed: 1.0,
        turn_torque: 2.0,
        turn_least_torque: 0.0,
        pull: 10.0,
        speed: 0.5,
        speeds: Speeds {
            joint: [1.0; 7],
            joint_acceleration: [2.0; 7],
            linear: 0.3,
            linear_acceleration: 1.0,
            angular: 1.0,
            angular_acceleration: 2.0,
        },
        jaw_speeds: (0.05, 0.05),
        compliant_arm: CompliantArm::Body,
        compliance: ComplianceChoice::Tff,
        visual: visual_servo::Order {
            world_from_base: Pose::identity(),
            approach: Vector3::x(),
            jaws: Vector3::y(),
            seat: 0.019,
            vicinity: 0.1,
            frozen: 0.05,
            still: 0.006,
            still_seconds: 0.3,
            retreat: 0.02,
            speed: (0.2, 1.0),
            acceleration: 1.0,
            approach_speed: 0.02,
            touch: 3.0,
            overrun: 0.015,
            stale: 0.2,
            patience: 10.0,
            zone: (Pose::identity(), Vector3::repeat(1.0)),
        },
        rule: Rule::Clearance,
        strategy: Strategy::Robot { tables: &TABLES },
        nodes: 1000,
        candidates: 1,
        seconds_per_node: 0.0,
        calibrated_at: Point3::origin(),
        finger_depth: [0.017, 0.036],
        finger_width: 0.012,
        keeper: Keeper::Person,
    }
}
