//! Meetings of two arms, the table of all of them, and what a meeting must offer.

use crate::motion::JointPositions;
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};

/// Joint positions of both arms in which the tools stand to each other as wanted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Meeting {
    /// `track_from_postument`: the postument's tool in the track's tool frame, as meant.
    pub track_from_postument: Pose,
    /// The track arm there; d0 leaves room to draw back by the separation.
    pub track: JointPositions,
    /// The postument arm there.
    pub postument: JointPositions,
    /// The track arm drawn back along its own tool axis, its partner being at the meeting.
    pub track_back: JointPositions,
    /// The postument arm drawn back along its own tool axis.
    pub postument_back: JointPositions,
    /// Interval within which the track's last joint can roll from here, relative (rad), contains 0.
    pub track_roll: (f64, f64),
    /// The same of the postument arm (rad).
    pub postument_roll: (f64, f64),
    /// Least distance between the arms' capsules, here and while either draws back and the track
    /// separates, at most 0.1 (m).
    pub clearance: f64,
}

/// All meetings of a cell.
#[derive(Debug, Clone, PartialEq)]
pub struct MeetingTable {
    /// Both hold the cube: by the rotation of the postument's tool in the track's tool frame, one
    /// of the 24 rotations of a cube onto itself, in the order of
    /// [`rotations`](super::rotations); `None` where the grippers would collide (one
    /// palm axis and sense; or adjacent palms with a finger of each hand on the face under the
    /// other's palm, which cross) or no pose of both arms was found.
    pub grasps: [Option<Meeting>; 24],
    /// The camera in the other hand looks at a face of the held cube: `[holder][side]`, where
    /// `side` is the face's outward normal in the holder's tool frame: 0 is +z (opposite the palm),
    /// 1 is +x, 2 is -x.
    pub views: [[Option<Meeting>; 3]; 2],
    /// How far the track draws back along -y between meetings, so that both arms move freely (m).
    pub separation: f64,
}

/// What a meeting must offer, and how hard it is searched for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReachSettings {
    /// How far the track draws back along -y between meetings (m).
    pub separation: f64,
    /// How far each arm can draw back along its own tool axis (m).
    pub back: f64,
    /// Distance from a hand's camera to the face that it looks at (m).
    pub view_distance: f64,
    /// By how much the tools can be shifted along each axis, for other depths and corrections (m).
    pub shift: f64,
    /// Least distance between the capsules of the arms (m).
    pub clearance: f64,
    /// Height above the table that wrists and tools keep (m).
    pub above_table: f64,
    /// Random poses that are tried for each meeting, near to and far from those that are already
    /// known.
    pub samples: u32,
    /// Seed of the search.
    pub seed: u64,
}

impl Default for ReachSettings {
    fn default() -> Self {
        Self {
            separation: 0.35,
            back: 0.12,
            view_distance: 0.20,
            shift: 0.025,
            clearance: 0.02,
            above_table: 0.15,
            samples: 3000,
            seed: 2007,
        }
    }
}

impl MeetingTable {
    /// How many grasps and how many views were found.
    #[must_use]
    pub fn found(&self) -> (usize, usize) {
        (self.grasps.iter().flatten().count(), self.views.iter().flatten().flatten().count())
    }
}
