//! How a hand holds the cube, and the steps of a two-handed plan.
//!
//! A hold is a palm face, a jaw axis across it and a depth. The tool's z points from the palm into the cube,
//! its y along the jaw axis; a gripper looks the same after half a roll, so each hold has two tool frames.

use crate::cube::{Axis, Face, Turn};
use crate::motion::Depth;
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::Point3;
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
    /// `cube_from_tool` of this hold; `half_roll` picks the second of the two equivalent tool frames.
    /// `edge` is the cube's edge [m]. The tool point lies on the palm's axis, in the outer layer's centre
    /// plane (one layer) or in the middle layer's (two).
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
