//! Where the controller believes the cube to be: in which hand, how held, and how far off the nominal hold.
//!
//! - in: arm states, what contact and sight tell
//! - out: poses of the cube in the hands, a slowly corrected place of the postument's base
//!
//! Contact is the better witness: closed pads centre the cube across the jaws and align it with them, the stops
//! of the palm fix its depth. What they leave open (along the finger's width, and the tilt about the jaw axis)
//! comes from the partner's pose through the kinematics, or from the camera in the other hand.

use super::hold::{Hand, Hold};
use super::settings::ArmBelief;
use crate::cube::{Face, Rotation24};
use crate::motion::ArmState;
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::{Point3, UnitQuaternion, Vector3};

/// A hold of the cube by one hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Held {
    /// As planned.
    pub hold: Hold,
    /// Which of the two equivalent tool frames.
    pub half_roll: bool,
    /// As measured.
    pub tool_from_cube: Pose,
}

/// The controller's picture of arms and cube.
#[derive(Debug, Clone)]
pub struct Belief {
    /// The two arms; the place of the postument's base is corrected in the course of the task.
    pub arms: [ArmBelief; 2],
    /// Who holds the cube, and how.
    pub held: [Option<Held>; 2],
    edge: f64,
    learning: f64,
}

impl Belief {
    /// Nothing is held.
    #[must_use]
    pub fn new(arms: [ArmBelief; 2], edge: f64, learning: f64) -> Self {
        Self { arms, held: [None, None], edge, learning }
    }

    /// The nominal pose of the cube in a tool.
    #[must_use]
    pub fn nominal(&self, hold: Hold, half_roll: bool) -> Pose {
        hold.cube_from_tool(half_roll, self.edge).inverse()
    }

    /// `world_from_tool` as set (not as measured: set values are free of the servo's lag).
    #[must_use]
    pub fn world_from_tool(&self, hand: Hand, arms: &[ArmState]) -> Pose {
        self.arms[hand.index()].world_from_base * arms[hand.index()].desired_base_from_tool
    }

    /// `world_from_cube` by the given holder.
    #[must_use]
    pub fn world_from_cube(&self, holder: Hand, arms: &[ArmState]) -> Option<Pose> {
        let held = self.held[holder.index()]?;
        Some(self.world_from_tool(holder, arms) * held.tool_from_cube)
    }

    /// `base_from_tool` at which `hand` has the cube in `hold`, the partner holding it now.
    #[must_use]
    pub fn grasp_pose(
        &self,
        hand: Hand,
        hold: Hold,
        half_roll: bool,
        arms: &[ArmState],
    ) -> Option<Pose> {
        let world_from_cube = self.world_from_cube(hand.other(), arms)?;
        let world_from_tool = world_from_cube * hold.cube_from_tool(half_roll, self.edge);
        Some(self.arms[hand.index()].world_from_base.inverse() * world_from_tool)
    }

    /// `camera_from_face` of a face of the held cube in the camera of `viewer`.
    #[must_use]
    pub fn face_in_camera(&self, viewer: Hand, face: Face, arms: &[ArmState]) -> Option<Pose> {
        let world_from_cube = self.world_from_cube(viewer.other(), arms)?;
        let world_from_camera = self.world_from_camera(viewer, arms)?;
        Some(world_from_camera.inverse() * world_from_cube * self.cube_from_face(face))
    }

    fn world_from_camera(&self, viewer: Hand, arms: &[ArmState]) -> Option<Pose> {
        let arm = &self.arms[viewer.index()];
        let tool_from_camera = arm.flange_from_tool.inverse() * arm.flange_from_camera?;
        Some(self.world_from_tool(viewer, arms) * tool_from_camera)
    }

    /// Frame of a face: origin in its centre, x along columns, y along rows, z into the cube.
    #[must_use]
    pub fn cube_from_face(&self, face: Face) -> Pose {
        let (x, y) = face.reading_axes();
        pose_from_axes(x, y, x.cross(&y), Point3::from(face.normal() * self.edge / 2.0))
    }

    /// `hand` has closed and secured its hold while the partner, if any, went on holding.
    ///
    /// Returns the distance between where the kinematics had expected the cube and where contact shows it [m].
    pub fn secured(&mut self, hand: Hand, hold: Hold, half_roll: bool, arms: &[ArmState]) -> f64 {
        let nominal = self.nominal(hold, half_roll);
        let Some(world_from_cube) = self.world_from_cube(hand.other(), arms) else {
            self.held[hand.index()] = Some(Held { hold, half_roll, tool_from_cube: nominal });
            return 0.0;
        };
        let world_from_tool = self.world_from_tool(hand, arms);
        let expected = world_from_tool.inverse() * world_from_cube;
        // In tool axes: only the rest along x and about y is left to the kinematics.
        let off = nominal.inverse() * expected;
        let in_tool = nominal.rotation * off.rotation.scaled_axis();
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, in_tool.y, 0.0));
        let mut place = nominal.translation.vector;
        place.x += expected.translation.x - nominal.translation.x;
        let tool_from_cube = Pose::from_parts(place.into(), tilt * nominal.rotation);

        let miss = tool_from_cube.translation.vector - expected.translation.vector;
        let correction = world_from_tool.rotation * (miss * self.learning);
        // Where contact and kinematics disagree, part of the blame goes to the base's place. The cube in the
        // tool lies `miss` further than thought: the newcomer's tool is that much further back, or the
        // partner's cube that much further on.
        let base = &mut self.arms[Hand::Postument.index()].world_from_base;
        let shift = if hand == Hand::Postument { -correction } else { correction };
        base.translation.vector += shift;
        self.held[hand.index()] = Some(Held { hold, half_roll, tool_from_cube });
        miss.norm()
    }

    /// `hand` has opened.
    pub fn released(&mut self, hand: Hand) {
        self.held[hand.index()] = None;
    }

    /// `hand` has turned the face in its palm by an angle about its tool's z: the tool now stands otherwise to
    /// the body of the cube.
    pub fn turned(&mut self, hand: Hand, hold: Hold, half_roll: bool) {
        if let Some(held) = self.held[hand.index()] {
            // The offset stays what it was in the tool; only the nominal part is another.
            let offset = held.tool_from_cube * self.nominal(held.hold, held.half_roll).inverse();
            let tool_from_cube = offset * self.nominal(hold, half_roll);
            self.held[hand.index()] = Some(Held { hold, half_roll, tool_from_cube });
        }
    }

    /// The camera of `viewer` has seen `face` at `camera_from_face`: the place across the line of sight and the
    /// roll about it are taken over, the depth and the tilts are not (they are ten times less certain).
    pub fn seen(&mut self, viewer: Hand, face: Face, camera_from_face: &Pose, arms: &[ArmState]) {
        let holder = viewer.other();
        let (Some(expected), Some(held), Some(world_from_camera)) = (
            self.face_in_camera(viewer, face, arms),
            self.held[holder.index()],
            self.world_from_camera(viewer, arms),
        ) else {
            return;
        };
        // At the expected depth, so that an error of the focal length does not leak into the place.
        let scale = expected.translation.z / camera_from_face.translation.z;
        let mut shift = camera_from_face.translation.vector * scale - expected.translation.vector;
        shift.z = 0.0;
        let turn = (camera_from_face.rotation * expected.rotation.inverse()).scaled_axis();
        let roll = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, turn.z));
        let corrected = Pose::from_parts(
            (expected.translation.vector + shift).into(),
            roll * expected.rotation,
        );
        let world_from_cube = world_from_camera * corrected * self.cube_from_face(face).inverse();
        let tool_from_cube = self.world_from_tool(holder, arms).inverse() * world_from_cube;
        self.held[holder.index()] = Some(Held { tool_from_cube, ..held });
    }

    /// Renames the faces after the cube's colours are known; `rotation` carries old directions to new ones.
    pub fn renamed(&mut self, rotation: Rotation24) {
        for held in self.held.iter_mut().flatten() {
            let (hold, half_roll) = held.hold.renamed(held.half_roll, rotation);
            let old_from_new =
                Pose::from_parts(Vector3::zeros().into(), rotation.quaternion().inverse());
            *held = Held { hold, half_roll, tool_from_cube: held.tool_from_cube * old_from_new };
        }
    }
}
