//! How a hand holds the cube, and the steps of a two-handed plan.
//!
//! A hold is a palm face, a jaw axis across it and a depth. The tool's z points from the palm into the cube,
//! its y along the jaw axis; a gripper looks the same after half a roll, so each hold has two tool frames.

use crate::cube::{Axis, Face, Rotation24, Turn};
use crate::motion::Depth;
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::{Point3, UnitQuaternion};
use serde::{Deserialize, Serialize};

/// Which arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Hand {
    /// The arm on the track (effector 0).
    Track,
    /// The arm on the postument (effector 1).
    Postument,
}

impl Hand {
    /// Both hands, in the order of the effectors.
    pub const BOTH: [Self; 2] = [Self::Track, Self::Postument];

    /// Returns the name for messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Track => "track",
            Self::Postument => "postument",
        }
    }

    /// The partner.
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Self::Track => Self::Postument,
            Self::Postument => Self::Track,
        }
    }

    /// Position in lists of effectors.
    #[must_use]
    pub fn index(self) -> usize {
        self as usize
    }
}

/// A grasp of the cube; `jaws` is never the palm's axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Hold {
    /// Face under the palm.
    pub palm: Face,
    /// Axis across which the fingers press.
    pub jaws: Axis,
    /// Layers between the fingers.
    pub depth: Depth,
}

impl Hold {
    /// `cube_from_tool` of this hold; `half_roll` picks the second of the two equivalent tool
    /// frames. `edge` is the cube's edge (m). The tool point lies on the palm's axis, in the outer
    /// layer's centre plane (one layer) or in the middle layer's (two).
    #[must_use]
    pub fn cube_from_tool(self, half_roll: bool, edge: f64) -> Pose {
        let z = -self.palm.normal();
        let y = if half_roll { -self.jaws.unit() } else { self.jaws.unit() };
        let out = match self.depth {
            Depth::One => edge / 3.0,
            Depth::Two => 0.0,
        };
        pose_from_axes(y.cross(&z), y, z, Point3::from(self.palm.normal() * out))
    }

    /// The rotation of [`Hold::cube_from_tool`].
    #[must_use]
    pub fn rotation(self, half_roll: bool) -> Rotation24 {
        Rotation24::nearest(&self.cube_from_tool(half_roll, 1.0).rotation)
    }

    /// The hold, and whether half a roll, of a tool that stands like this in the cube frame.
    #[must_use]
    pub fn from_rotation(cube_from_tool: Rotation24, depth: Depth) -> (Self, bool) {
        let (along, across) = (cube_from_tool.face(Face::U), cube_from_tool.face(Face::B));
        let jaws = across.axis();
        (Self { palm: along.opposite(), jaws, depth }, across != jaws.positive_face())
    }

    /// The same from any rotation near one of the 24.
    #[must_use]
    pub fn from_tool_rotation(cube_from_tool: &UnitQuaternion<f64>, depth: Depth) -> (Self, bool) {
        Self::from_rotation(Rotation24::nearest(cube_from_tool), depth)
    }

    /// The hold after this hand turned the layer under its palm: the tool rolls along with the layer, which
    /// clockwise from outside is positive about its own z, since that points into the cube.
    #[must_use]
    pub fn after_turn(self, half_roll: bool, quarters: u8) -> (Self, bool) {
        let quarter = Rotation24::quarter(Face::D);
        let rotation = (0..quarters).fold(self.rotation(half_roll), |r, _| r.after(quarter));
        Self::from_rotation(rotation, self.depth)
    }

    /// The same hold in another cube frame: `rotation` carries the old frame's directions into the new one's, as
    /// [`Facelets::normalised`](crate::cube::Facelets::normalised) tells it.
    #[must_use]
    pub fn renamed(self, half_roll: bool, rotation: Rotation24) -> (Self, bool) {
        Self::from_rotation(rotation.after(self.rotation(half_roll)), self.depth)
    }
}

/// A hold with the choice of its tool frame: how one hand holds the cube now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Grip {
    /// How.
    pub hold: Hold,
    /// Which of the two equivalent tool frames.
    pub half_roll: bool,
}

impl Grip {
    /// All 24 of a depth.
    pub fn all(depth: Depth) -> impl Iterator<Item = Self> {
        Rotation24::all().map(move |r| Self::from_rotation(r, depth))
    }

    /// Of a tool that stands like this in the cube frame.
    #[must_use]
    pub fn from_rotation(cube_from_tool: Rotation24, depth: Depth) -> Self {
        let (hold, half_roll) = Hold::from_rotation(cube_from_tool, depth);
        Self { hold, half_roll }
    }

    /// The tool's rotation in the cube frame.
    #[must_use]
    pub fn rotation(self) -> Rotation24 {
        self.hold.rotation(self.half_roll)
    }

    /// After this hand turned the layer under its palm.
    #[must_use]
    pub fn after_turn(self, quarters: u8) -> Self {
        let (hold, half_roll) = self.hold.after_turn(self.half_roll, quarters);
        Self { hold, half_roll }
    }

    /// In another cube frame: see [`Hold::renamed`].
    #[must_use]
    pub fn renamed(self, rotation: Rotation24) -> Self {
        let (hold, half_roll) = self.hold.renamed(self.half_roll, rotation);
        Self { hold, half_roll }
    }
}

/// What both hands hold, by [`Hand::index`].
pub type Hands = [Option<Grip>; 2];

/// What both hands hold after a step, whether it was allowed or not.
#[must_use]
pub fn hands_after(mut hands: Hands, step: &Step) -> Hands {
    match *step {
        Step::Grasp { hand, hold, half_roll } => {
            hands[hand.index()] = Some(Grip { hold, half_roll });
        }
        Step::Look { .. } => {}
        Step::Leave { hand } => hands[hand.index()] = None,
        Step::Turn { turner, turn } => {
            let grip = &mut hands[turner.index()];
            *grip = grip.map(|g| g.after_turn(turn.quarters));
        }
    }
    hands
}

/// One step of a plan. Between steps at least one hand holds the cube.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Step {
    /// `hand` (letting go first if it holds) comes to `hold` and closes; the other holds meanwhile.
    Grasp {
        /// Who.
        hand: Hand,
        /// How.
        hold: Hold,
        /// Which of the two equivalent tool frames: see [`Hold::cube_from_tool`].
        half_roll: bool,
    },
    /// The camera in the hand of `viewer`, which holds nothing, looks at `face` of the cube in the other hand.
    Look {
        /// Who looks.
        viewer: Hand,
        /// At what.
        face: Face,
    },
    /// `hand` opens and leaves; the other goes on holding alone.
    Leave {
        /// Who.
        hand: Hand,
    },
    /// `turner`, whose palm is on `turn.face` with one layer, turns it; the other hand holds the body.
    Turn {
        /// Who.
        turner: Hand,
        /// What.
        turn: Turn,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_and_holds_belong_together() {
        for depth in [Depth::One, Depth::Two] {
            for grip in Grip::all(depth) {
                assert_ne!(grip.hold.palm.axis(), grip.hold.jaws);
                assert_eq!(Grip::from_rotation(grip.rotation(), depth), grip);
            }
        }
    }

    /// The finger that was on the right goes with the layer to the front side when up turns clockwise.
    #[test]
    fn the_tool_rolls_along_with_the_layer() {
        let grip = Grip {
            hold: Hold { palm: Face::U, jaws: Axis::X, depth: Depth::One },
            half_roll: false,
        };
        let jaw_before = grip.hold.cube_from_tool(false, 0.057).rotation * nalgebra::Vector3::y();

        let after = grip.after_turn(1);

        let jaw_after =
            after.hold.cube_from_tool(after.half_roll, 0.057).rotation * nalgebra::Vector3::y();
        assert!((jaw_before - Face::R.normal()).norm() < 1e-12);
        assert!((jaw_after - Face::F.normal()).norm() < 1e-12);
        assert_eq!(after.after_turn(3), grip);
        assert_eq!(grip.after_turn(2), Grip { half_roll: true, ..grip });
    }

    #[test]
    fn a_hold_in_another_frame_is_on_the_same_stickers() {
        for rotation in Rotation24::all() {
            for grip in Grip::all(Depth::Two) {
                let renamed = grip.renamed(rotation);

                assert_eq!(renamed.hold.palm, rotation.face(grip.hold.palm));
                assert_eq!(renamed.hold.jaws, rotation.axis(grip.hold.jaws));
            }
        }
    }
}
