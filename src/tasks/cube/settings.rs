//! What the cube task must be told about the cell and its manners. SI units.

use crate::cube::Keeper;
use crate::generators::{Selector, grasp, position::Speeds, turn, visual_servo};
use crate::reach::{Fold, MeetingTable, WayFinder};
use crate::spatial::Pose;
use nalgebra::Point3;

use super::plan::terms::{Costs, Depths, Rule, Terms};
use super::strategy::Strategy;

/// Which arm yields while a face is turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CompliantArm {
    /// The one that does not turn: the paper.
    Body,
    /// The one that turns: the 2008 sources.
    Turner,
}

/// Which directions yield in contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ComplianceChoice {
    /// None: position control.
    None,
    /// x, y, z (and the turn axis): the original's choice.
    Tff,
    /// The tilts too.
    TffTilts,
}

/// What is known of one arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmBelief {
    /// Base in the world.
    pub world_from_base: Pose,
    /// Tool in the flange.
    pub flange_from_tool: Pose,
    /// Optical frame of the camera in the hand, if there is one.
    pub flange_from_camera: Option<Pose>,
}

/// Settings of the task.
#[derive(Debug, Clone)]
pub struct CubeSettings {
    /// The two arms, track first.
    pub arms: [ArmBelief; 2],
    /// How far they can draw back.
    pub folds: [Fold; 2],
    /// Where they can meet.
    pub meetings: MeetingTable,
    /// Finds how far the arms must go apart on ways that the table has not: from where a cube is
    /// taken, back to there, and after a way was refused. `None` where they always go apart by the
    /// whole separation.
    pub ways: Option<WayFinder>,
    /// Edge of the cube (m).
    pub edge: f64,
    /// Grip force (N).
    pub grip: f64,
    /// Distance of the pads of jaws that are to take the cube from a person or a table (m).
    pub opening: f64,
    /// Distance of the pads of jaws that are open beside a cube in the other hand (m).
    pub regrasp_opening: f64,
    /// Time in which a hand opens to leave its partner or the operator, at least (s).
    pub jaw_leave: f64,
    /// How far a hand draws back from the cube along its approach (m).
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
    /// Torque at which a turn stands still (Nm).
    pub turn_torque: f64,
    /// Least mean torque of a face that turns (Nm).
    pub turn_least_torque: f64,
    /// Force that counts as the operator's pull (N).
    pub pull: f64,
    /// Fraction of the full speeds in free motion.
    pub speed: f64,
    /// Fraction of the full speeds on lines to and from the operator's hand.
    pub gentle: f64,
    /// Those full speeds.
    pub speeds: Speeds,
    /// Speed of closing and of opening jaws, distance of the pads (m/s).
    pub jaw_speeds: (f64, f64),
    /// Speed of closing jaws that are not near the cube yet (m/s).
    pub jaw_reach: f64,
    /// Which arm yields in a turn.
    pub compliant_arm: CompliantArm,
    /// Which directions yield.
    pub compliance: ComplianceChoice,
    /// The visual servo's order; `world_from_base` is filled in.
    pub visual: visual_servo::Order,
    /// Rule of the regrasp plan.
    pub rule: Rule,
    /// Which solution is carried out.
    pub strategy: Strategy,
    /// Nodes that the solver may visit.
    pub nodes: u64,
    /// Solutions among which the regrasps choose.
    pub candidates: usize,
    /// Declared time of a search node, for the virtual clock (s).
    pub seconds_per_node: f64,
    /// Where the arms were calibrated against each other, in the world.
    pub calibrated_at: Point3<f64>,
    /// From whom the cube is taken, and to whom it goes back.
    pub keeper: Keeper,
    /// How deep the fingers reach beyond the face under the palm, with one and with two layers
    /// between them (m).
    pub finger_depth: [f64; 2],
    /// Extent of a finger along the tool's x (m).
    pub finger_width: f64,
}

/// Times that a grasp takes beyond its ways, as measured in the plant (s): both sensors are zeroed,
/// opening jaws come to rest, contact is noticed, the cube is seated.
const BIAS: f64 = 0.13;
const OPENED: f64 = 0.17;
const NOTICED: f64 = 0.1;
const SEATING: f64 = 0.58;
/// A guarded approach begins so far before a cube, on average of 300 grasps (m).
const SHORT: f64 = 0.0055;

impl CubeSettings {
    /// The terms of the plan: the rule, and what motions cost with these speeds.
    #[must_use]
    pub fn terms(&self) -> Terms {
        let finish_depths = match self.keeper {
            Keeper::Person => Depths::Both,
            Keeper::Table => Depths::One,
        };
        Terms { costs: self.costs(), finish_depths, ..Terms::of(self.rule) }
    }

    /// What motions cost.
    fn costs(&self) -> Costs {
        let line = |way: f64| self.speeds.line_seconds(way, 0.0, self.speed);
        let stroke = self.regrasp_opening - self.edge;
        let open = (stroke / self.jaw_speeds.1).max(self.jaw_leave) + OPENED;
        let close = grasp::closing_seconds(stroke, self.jaw_speeds.0, self.jaw_reach);
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
            look: 5.0,
        }
    }

    /// Directions that yield in a grasp.
    #[must_use]
    pub fn grasp_selector(&self) -> Selector {
        match self.compliance {
            ComplianceChoice::None => [false; 6],
            ComplianceChoice::Tff => [true, true, true, false, false, false],
            ComplianceChoice::TffTilts => [true; 6],
        }
    }

    /// Directions that yield in a turn about the given axis of the yielding tool (0 x, 1 y, 2 z).
    #[must_use]
    pub fn turn_selector(&self, axis: usize) -> Selector {
        match self.compliance {
            ComplianceChoice::None => [false; 6],
            ComplianceChoice::Tff => [true, true, true, false, false, false],
            ComplianceChoice::TffTilts => {
                let mut selector = [true; 6];
                selector[3 + axis] = false;
                selector
            }
        }
    }
}
