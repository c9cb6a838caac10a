//! How far an arm can draw back along its tool before a joint meets its limit.

use crate::cell::Arm;
use crate::kinematics::ArmModel;
use crate::motion::JointPositions;
use crate::spatial::Pose;

/// An arm that may draw back.
#[derive(Debug, Clone, PartialEq)]
pub struct Fold {
    model: ArmModel,
    tool_from_flange: Pose,
}

impl Fold {
    /// Distance between the places that are looked at (m).
    const STEP: f64 = 0.002;
    /// Way that stays free before the place where a joint meets its limit (m): the arm sets out
    /// from where the servo has it by then, not from where it was asked, and must not be refused
    /// for a tenth of a millimetre.
    const SPARE: f64 = 0.004;

    /// Of an arm with its tool.
    #[must_use]
    pub fn of(arm: &Arm) -> Self {
        Self { model: arm.model.clone(), tool_from_flange: arm.flange_from_tool.inverse() }
    }

    /// Of the track arm of the example cell.
    #[cfg(test)]
    pub(crate) fn of_example() -> Self {
        Self::of(&super::example_cell().arms[0])
    }

    /// Where that arm folds only a part of 0.3 m: its joints, and its tool in its base.
    #[cfg(test)]
    pub(crate) fn example_stand() -> (JointPositions, Pose) {
        let arm = &super::example_cell().arms[0];
        let joints = JointPositions([0.0, 0.018, -1.895, 0.55, 1.166, 1.518, 0.091]);
        (joints, arm.model.base_from_flange(&joints) * arm.flange_from_tool)
    }

    /// How much of so long a way the tool can go back along its own z and still have 4 mm to the
    /// limit (m); the arm stands at these joint positions, its tool at `base_from_tool`.
    #[must_use]
    pub fn way(&self, base_from_tool: &Pose, joints: &JointPositions, way: f64) -> f64 {
        let goes = self.limit(base_from_tool, joints, way + Self::SPARE);
        // All of it to the last bit, where it is free.
        if goes < way + Self::SPARE { (goes - Self::SPARE).max(0.0) } else { way }
    }

    /// The same up to the limit, in steps of 2 mm.
    fn limit(&self, base_from_tool: &Pose, joints: &JointPositions, way: f64) -> f64 {
        let steps = (way / Self::STEP).ceil() as u32;
        let (mut near, mut goes) = (*joints, 0.0);
        for step in 1..=steps {
            // The last one is the way itself, to the last bit.
            let gone = if step == steps { way } else { Self::STEP * f64::from(step) };
            let tool = base_from_tool * Pose::translation(0.0, 0.0, -gone);
            let found = self.model.inverse(&(tool * self.tool_from_flange), &near);
            let Some(joints) = found.ok().filter(|joints| self.model.check(joints).is_ok()) else {
                break;
            };
            (near, goes) = (joints, gone);
        }
        goes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reach::example_cell;

    #[test]
    fn an_arm_draws_back_until_its_elbow_meets_its_limit_and_no_farther() {
        let arm = &example_cell().arms[0];
        let (joints, tool) = Fold::example_stand();
        let fold = Fold::of(arm);

        let goes = fold.way(&tool, &joints, 0.3);

        assert!(goes > 0.02 && goes < 0.3, "{goes}");
        let at = |way: f64| {
            let flange = tool * Pose::translation(0.0, 0.0, -way) * fold.tool_from_flange;
            arm.model.inverse(&flange, &joints).and_then(|joints| arm.model.check(&joints))
        };
        assert!(at(goes + 0.004).is_ok() && at(goes + 0.004 + 0.003).is_err());
        for way in [0.006, 0.011, 0.012, 0.5 * goes] {
            assert_eq!(fold.way(&tool, &joints, way), way, "all of a shorter way");
        }
        assert_eq!(fold.way(&tool, &joints, 0.0), 0.0);
    }
}
