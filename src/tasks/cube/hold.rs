//! The grasps of the cube by one hand, and the steps of a two-handed plan.
//!
//! A [`Hold`] is a palm face, a jaw axis across it and a depth. The tool's z points from the palm
//! into the cube, its y along the jaw axis. A gripper looks the same after half a roll, so each
//! hold has two tool frames; a [`Grip`] is a hold with one of them.

use crate::cube::{Axis, Face, Rotation24, Turn};
use crate::motion::Depth;
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::{Point3, UnitQuaternion};
use serde::{Deserialize, Serialize};

/// One of the two arms, with its hand.
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

    /// Returns the name of the hand for messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Track => "track",
            Self::Postument => "postument",
        }
    }

    /// Returns the other hand of the robot.
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Self::Track => Self::Postument,
            Self::Postument => Self::Track,
        }
    }

    /// Returns the index of the hand's arm in lists of effectors.
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
    /// Returns `cube_from_tool` of this hold. `half_roll` picks the second of the two equivalent
    /// tool frames; `edge` is the cube's edge (m). The tool point lies on the palm's axis, in the
    /// centre plane of the outer layer (one layer) or of the middle layer (two).
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

    /// Returns the rotation of [`Hold::cube_from_tool`].
    #[must_use]
    pub fn rotation(self, half_roll: bool) -> Rotation24 {
        // The edge does not matter for a rotation.
        Rotation24::nearest(&self.cube_from_tool(half_roll, 1.0).rotation)
    }

    /// Returns the hold of a tool with this rotation in the cube frame, and whether its frame is
    /// the second of the two equivalent tool frames of the hold.
    #[must_use]
    pub fn from_rotation(cube_from_tool: Rotation24, depth: Depth) -> (Self, bool) {
        // A rotation maps U (+z) to where the tool's z points, and B (+y) to where its y points.
        let (along, across) = (cube_from_tool.face(Face::U), cube_from_tool.face(Face::B));
        let jaws = across.axis();
        (Self { palm: along.opposite(), jaws, depth }, across != jaws.positive_face())
    }

    /// Returns what [`Hold::from_rotation`] returns for the nearest of the 24 rotations of a cube.
    #[must_use]
    pub fn from_tool_rotation(cube_from_tool: &UnitQuaternion<f64>, depth: Depth) -> (Self, bool) {
        Self::from_rotation(Rotation24::nearest(cube_from_tool), depth)
    }

    /// Returns the hold after this hand has turned the layer under its palm by `quarters`
    /// clockwise, and whether its tool frame is then the second one. The tool rolls together with
    /// the layer. Clockwise, seen from outside, is positive about the tool's z, which points into
    /// the cube.
    #[must_use]
    pub fn after_turn(self, half_roll: bool, quarters: u8) -> (Self, bool) {
        // D is the face whose outward normal is -z: its clockwise quarter is positive about +z.
        let quarter = Rotation24::quarter(Face::D);
        let rotation = (0..quarters).fold(self.rotation(half_roll), |r, _| r.after(quarter));
        Self::from_rotation(rotation, self.depth)
    }

    /// Returns this hold in another cube frame; `rotation` carries the old frame's directions to
    /// the new one's, as [`Facelets::normalised`](crate::cube::Facelets::normalised) returns it.
    #[must_use]
    pub fn renamed(self, half_roll: bool, rotation: Rotation24) -> (Self, bool) {
        Self::from_rotation(rotation.after(self.rotation(half_roll)), self.depth)
    }
}

/// A hold with one of its two tool frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Grip {
    /// The hold.
    pub hold: Hold,
    /// Whether the tool frame is the second of the two equivalent ones.
    pub half_roll: bool,
}

impl Grip {
    /// Number of grips: 24 over one layer and 24 over two.
    pub const COUNT: usize = 2 * Self::OF_DEPTH;
    /// Number of grips of one depth.
    pub const OF_DEPTH: usize = 24;

    /// Iterates over all grips in the order of their numbers.
    pub fn every() -> impl Iterator<Item = Self> {
        Self::all(Depth::One).chain(Self::all(Depth::Two))
    }

    /// Returns the number of this grip, less than [`Grip::COUNT`]: that of its rotation, and 24
    /// more over two layers.
    #[must_use]
    pub fn number(self) -> usize {
        let deep = self.hold.depth == Depth::Two;
        self.rotation().index() + if deep { Self::OF_DEPTH } else { 0 }
    }

    /// Iterates over all 24 grips of a depth.
    pub fn all(depth: Depth) -> impl Iterator<Item = Self> {
        Rotation24::all().map(move |r| Self::from_rotation(r, depth))
    }

    /// Returns the grip of a tool with this rotation in the cube frame.
    #[must_use]
    pub fn from_rotation(cube_from_tool: Rotation24, depth: Depth) -> Self {
        let (hold, half_roll) = Hold::from_rotation(cube_from_tool, depth);
        Self { hold, half_roll }
    }

    /// Returns the tool's rotation in the cube frame.
    #[must_use]
    pub fn rotation(self) -> Rotation24 {
        self.hold.rotation(self.half_roll)
    }

    /// Returns the grip after this hand has turned the layer under its palm by `quarters`
    /// clockwise.
    #[must_use]
    pub fn after_turn(self, quarters: u8) -> Self {
        let (hold, half_roll) = self.hold.after_turn(self.half_roll, quarters);
        Self { hold, half_roll }
    }

    /// Returns this grip in another cube frame: see [`Hold::renamed`].
    #[must_use]
    pub fn renamed(self, rotation: Rotation24) -> Self {
        let (hold, half_roll) = self.hold.renamed(self.half_roll, rotation);
        Self { hold, half_roll }
    }
}

/// Grips of both hands, by [`Hand::index`]; `None` for a hand that holds nothing.
pub type Hands = [Option<Grip>; 2];

/// Returns the grips of both hands after a step. It does not check whether the step is allowed.
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
    /// `hand` lets go if it holds, moves to `hold` and closes; the other hand holds meanwhile.
    Grasp {
        /// The hand that grasps.
        hand: Hand,
        /// Its hold afterwards.
        hold: Hold,
        /// Which of the two equivalent tool frames: see [`Hold::cube_from_tool`].
        half_roll: bool,
    },
    /// The camera in the hand of `viewer`, which holds nothing, looks at `face` of the cube in the
    /// other hand.
    Look {
        /// The hand with the camera.
        viewer: Hand,
        /// The face to be read.
        face: Face,
    },
    /// `hand` opens and leaves; the other holds alone.
    Leave {
        /// The hand that opens.
        hand: Hand,
    },
    /// `turner`, whose palm is on `turn.face` with one layer, turns that face; the other hand holds
    /// the body.
    Turn {
        /// The hand that turns.
        turner: Hand,
        /// The turn.
        turn: Turn,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grips_and_their_rotations_convert_both_ways() {
        for depth in [Depth::One, Depth::Two] {
            for grip in Grip::all(depth) {
                assert_ne!(grip.hold.palm.axis(), grip.hold.jaws);
                assert_eq!(Grip::from_rotation(grip.rotation(), depth), grip);
            }
        }
    }

    /// A finger on the right side of the cube moves to the front when the upper layer turns
    /// clockwise.
    #[test]
    fn tool_rolls_with_the_turning_layer() {
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
    fn cube_rotation_maps_palm_and_jaws_of_grip() {
        let tool = |grip: Grip| grip.hold.cube_from_tool(grip.half_roll, 0.057).rotation;
        for rotation in Rotation24::all() {
            for grip in Grip::all(Depth::Two) {
                let renamed = grip.renamed(rotation);

                assert_eq!(renamed.hold.palm, rotation.face(grip.hold.palm));
                assert_eq!(renamed.hold.jaws, rotation.axis(grip.hold.jaws));
                assert_eq!(renamed.hold.depth, Depth::Two);
                // The tool's frame is the same one of the two that a hold has.
                assert!(tool(renamed).angle_to(&(rotation.quaternion() * tool(grip))) < 1e-9);
            }
        }
    }
}
