//! The distance by which an arm can retract along its tool before a joint meets its limit.

use crate::cell::Arm;
use crate::kinematics::ArmModel;
use crate::motion::JointPositions;
use crate::spatial::Pose;

/// Model of an arm by which the distance is computed that its tool can retract.
#[derive(Debug, Clone, PartialEq)]
pub struct Fold {
    model: ArmModel,
    tool_from_flange: Pose,
}

impl Fold {
    /// Distance between the places that are checked (m).
    const STEP: f64 = 0.002;
    /// Distance that stays free before the place where a joint meets its limit (m). The arm may
    /// begin to retract a little beside the commanded place, and the motion must not be refused for
    /// a tenth of a millimetre.
    const SPARE: f64 = 0.004;

    /// Makes this model of an arm of a cell.
    #[must_use]
    pub fn of(arm: &Arm) -> Self {
        Self { model: arm.model.clone(), tool_from_flange: arm.flange_from_tool.inverse() }
    }

    /// Makes this model of the track arm of the example cell.
    #[cfg(test)]
    pub(crate) fn of_example() -> Self {
        Self::of(&super::example_cell().arms[0])
    }

    /// Returns joint positions of the track arm of the example cell from which it can retract by
    /// less than 0.3 m, and its `base_from_tool` there.
    #[cfg(test)]
    pub(crate) fn example_stand() -> (JointPositions, Pose) {
        let arm = &super::example_cell().arms[0];
        let joints = JointPositions([0.0, 0.018, -1.895, 0.55, 1.166, 1.518, 0.091]);
        (joints, arm.model.base_from_flange(&joints) * arm.flange_from_tool)
    }

    /// Returns how far the tool can retract along its own z (m): by `distance`, or as far as leaves
    /// 4 mm before a joint meets its limit, if that is less. The arm is at `joints`, its tool at
    /// `base_from_tool`.
    #[must_use]
    pub fn retractable(
        &self,
        base_from_tool: &Pose,
        joints: &JointPositions,
        distance: f64,
    ) -> f64 {
        let goes = self.limit(base_from_tool, joints, distance + Self::SPARE);
        // The whole distance is returned as it is, so that a caller can compare for equality.
        if goes < distance + Self::SPARE { (goes - Self::SPARE).max(0.0) } else { distance }
    }

    /// Returns how far the tool can retract before a joint meets its limit, `distance` at most (m).
    /// It is checked in steps of 2 mm.
    fn limit(&self, base_from_tool: &Pose, joints: &JointPositions, distance: f64) -> f64 {
        let steps = (distance / Self::STEP).ceil() as u32;
        let (mut near, mut goes) = (*joints, 0.0);
        for step in 1..=steps {
            // The last step may be shorter: it ends exactly at the whole distance.
            let gone = if step == steps { distance } else { Self::STEP * f64::from(step) };
            let tool = base_from_tool * Pose::translation(0.0, 0.0, -gone);
            // Each solution is the nearest to the one before, so that the inverse kinematics stays
            // on the arm's branch.
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
    fn retraction_ends_before_elbow_meets_limit() {
        let arm = &example_cell().arms[0];
        let (joints, tool) = Fold::example_stand();
        let fold = Fold::of(arm);

        let goes = fold.retractable(&tool, &joints, 0.3);

        assert!(goes > 0.02 && goes < 0.3, "{goes}");
        // Checks the joints after a retraction by a distance (m).
        let at = |distance: f64| {
            let flange = tool * Pose::translation(0.0, 0.0, -distance) * fold.tool_from_flange;
            arm.model.inverse(&flange, &joints).and_then(|joints| arm.model.check(&joints))
        };
        // A step of the search and a little more beyond the spare distance, the limit is passed.
        assert!(at(goes + Fold::SPARE).is_ok() && at(goes + Fold::SPARE + 0.003).is_err());
        for distance in [0.006, 0.011, 0.012, 0.5 * goes] {
            assert_eq!(
                fold.retractable(&tool, &joints, distance),
                distance,
                "a shorter retraction is possible in full"
            );
        }
        assert_eq!(fold.retractable(&tool, &joints, 0.0), 0.0);
    }
}
