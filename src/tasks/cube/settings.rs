//! The settings of the cube task, and the costs of a plan that follow from them. SI units.
//!
//! The times of a plan's motions follow from the speeds, except for the times below, which were
//! measured in the plant. With them the time that a plan expects is within 3 % of the time that the
//! mission takes (`tests/user/missions.rs`).
//!
//! | part of a grasp | constant | reason |
//! |---|---|---|
//! | both force sensors are zeroed | `BIAS` | the EDP waits until the arm is at rest |
//! | opening jaws come to rest | `OPENED` | a stroke is over when the jaws stand |
//! | contact is detected | `NOTICED` | the touch force must persist for some macrosteps |
//! | the cube is seated in the palm | `SEATING` | pressing lasts until the force settles |
//! | start of the guarded approach | `SHORT` | it varies with the belief; this is the mean |

use crate::cube::Keeper;
use crate::generators::{Selector, grasp, position::Speeds, turn, visual_servo};
use crate::reach::{Fold, MeetingTable, WayFinder};
use crate::spatial::Pose;
use nalgebra::Point3;

use super::plan::terms::{Costs, Depths, Rule, Terms};
use super::strategy::Strategy;

/// The arm that yields while a face is turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CompliantArm {
    /// The arm that does not turn, as in the paper.
    Body,
    /// The arm that turns, as in the sources of 2008.
    Turner,
}

/// Directions that yield in contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ComplianceChoice {
    /// No direction: position control.
    None,
    /// x, y and z, and the turn axis of a turn: the original's choice.
    Tff,
    /// All translations, and the rotations as well.
    TffTilts,
}

/// Geometry of one arm, as calibrated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmBelief {
    /// Pose of the base in the world.
    pub world_from_base: Pose,
    /// Pose of the tool in the flange.
    pub flange_from_tool: Pose,
    /// Pose of the optical frame of the camera in the hand, if there is one.
    pub flange_from_camera: Option<Pose>,
}

/// Settings of the task.
#[derive(Debug, Clone)]
pub struct CubeSettings {
    /// The two arms, track first.
    pub arms: [ArmBelief; 2],
    /// Models that give the distance by which each arm can retract along its tool.
    pub folds: [Fold; 2],
    /// Places where the arms can meet.
    pub meetings: MeetingTable,
    /// Search for the distance by which the arms must separate on paths that are not in the table:
    /// from the place where a cube is taken, back to there, and after a path was refused. `None`
    /// where they always separate by the whole distance.
    pub ways: Option<WayFinder>,
    /// Edge of the cube (m).
    pub edge: f64,
    /// Grip force (N).
    pub grip: f64,
    /// Distance between the pads before the jaws take the cube from a person or a table (m).
    pub opening: f64,
    /// Distance between the pads of jaws that are open beside a cube in the other hand (m).
    pub regrasp_opening: f64,
    /// Least time in which a hand opens to leave its partner or the operator (s).
    pub jaw_leave: f64,
    /// Distance by which a hand retracts from the cube along its approach (m).
    pub back: f64,
    /// Distance short of the seat at which the guarded approach begins (m).
    pub pre_grasp: f64,
    /// Speed of the guarded approach (m/s).
    pub approach_speed: f64,
    /// Contact force that ends an approach (N).
    pub touch: f64,
    /// Force that seats the cube in the palm (N).
    pub press: f64,
    /// Speed of a face turn (rad/s).
    pub turn_speed: f64,
    /// Acceleration at both ends of a turn (rad/s2).
    pub turn_acceleration: f64,
    /// Torque at which a turn stalls (Nm).
    pub turn_torque: f64,
    /// Least mean torque of a turn in which the face does turn (Nm).
    pub turn_least_torque: f64,
    /// Force that counts as the operator's pull (N).
    pub pull: f64,
    /// Fraction of the full speeds in free motion.
    pub speed: f64,
    /// Fraction of the full speeds on lines to and from the operator's hand.
    pub gentle: f64,
    /// Full speeds of both arms.
    pub speeds: Speeds,
    /// Speeds at which jaws close and open, as changes of the distance between the pads (m/s).
    pub jaw_speeds: (f64, f64),
    /// Speed of closing jaws that are not near the cube yet (m/s).
    pub jaw_reach: f64,
    /// The arm that yields in a turn.
    pub compliant_arm: CompliantArm,
    /// Directions that yield.
    pub compliance: ComplianceChoice,
    /// Order for the visual servo; the task fills in its `world_from_base`.
    pub visual: visual_servo::Order,
    /// Rule of holds and turns in a plan.
    pub rule: Rule,
    /// Rule by which the solution is chosen.
    pub strategy: Strategy,
    /// Number of nodes that the solver may visit.
    pub nodes: u64,
    /// Largest number of solutions among which the planner chooses.
    pub candidates: usize,
    /// Declared time of a search node, for the virtual clock (s).
    pub seconds_per_node: f64,
    /// Place where the arms were calibrated against each other, in the world (m).
    pub calibrated_at: Point3<f64>,
    /// The person or table that has the cube before and after the task.
    pub keeper: Keeper,
    /// Distance by which the fingers reach beyond the face under the palm, with one and with two
    /// layers between them (m).
    pub finger_depth: [f64; 2],
    /// Extent of a finger along the tool's x (m).
    pub finger_width: f64,
}

/// Time in which both force sensors are zeroed before a grasp (s).
const BIAS: f64 = 0.13;
/// Time in which opening jaws come to rest (s).
const OPENED: f64 = 0.09;
/// Time from a contact to its detection (s).
const NOTICED: f64 = 0.1;
/// Time in which the cube is seated in the palm (s).
const SEATING: f64 = 0.6;
/// Distance from the cube at which a guarded approach begins, as the mean of 300 grasps (m).
const SHORT: f64 = 0.0055;

impl CubeSettings {
    /// Returns the terms of the plan: the rule, and the times that motions take at the set speeds.
    #[must_use]
    pub fn terms(&self) -> Terms {
        let finish_depths = match self.keeper {
            // Fingers over two layers reach too far down to lay the cube on a table.
            Keeper::Person => Depths::Both,
            Keeper::Table => Depths::One,
        };
        Terms { costs: self.costs(), finish_depths, ..Terms::of(self.rule) }
    }

    /// Computes the times that the motions of a plan take at the set speeds (s).
    fn costs(&self) -> Costs {
        // The cost of a grasp runs from letting go to a secured hold. The path between two meetings
        // is not in it: `Reach::travel` adds it, since it depends on both meetings.
        let line = |way: f64| self.speeds.line_seconds(way, 0.0, self.speed);
        let stroke = self.regrasp_opening - self.edge;
        let open = (stroke / self.jaw_speeds.1 + OPENED).max(self.jaw_leave);
        let close = grasp::closing_seconds(stroke, self.jaw_speeds.0, self.jaw_reach);
        // The mission starts the approach farther away where its belief is uncertain, so the
        // setting alone would be too short.
        let short = self.pre_grasp.max(SHORT);
        let approach = short / self.approach_speed + NOTICED;
        let leave = open + line(self.back);
        let come = BIAS + line(self.back - short) + approach + close + SEATING;
        let turn = |angle| turn::seconds(angle, self.turn_speed, self.turn_acceleration);
        Costs {
            grasp: leave + come,
            quarter: turn(std::f64::consts::FRAC_PI_2),
            half: turn(std::f64::consts::PI),
            leave,
        }
    }

    /// Returns the directions that yield in a grasp.
    #[must_use]
    pub fn grasp_selector(&self) -> Selector {
        match self.compliance {
            ComplianceChoice::None => [false; 6],
            ComplianceChoice::Tff => [true, true, true, false, false, false],
            ComplianceChoice::TffTilts => [true; 6],
        }
    }

    /// Returns the directions in which the compliant arm yields during a turn, which is about
    /// `axis` of its tool (0 x, 1 y, 2 z).
    #[must_use]
    pub fn turn_selector(&self, axis: usize) -> Selector {
        match self.compliance {
            // No direction yields: position control.
            ComplianceChoice::None => [false; 6],
            ComplianceChoice::Tff => [true, true, true, false, false, false],
            ComplianceChoice::TffTilts => {
                // All directions but the rotation that is the turn itself.
                let mut selector = [true; 6];
                selector[3 + axis] = false;
                selector
            }
        }
    }
}
