//! Where two arms can meet: for each relative orientation of the tools, joint positions of both arms.
//!
//! Computed once per cell from the belief, on the EDP side, and handed to MP as data: the tasks themselves
//! know no kinematics.

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
    /// Interval within which the track's last joint can roll from here, relative [rad], contains 0.
    pub track_roll: (f64, f64),
    /// The same of the postument arm [rad].
    pub postument_roll: (f64, f64),
    /// Least distance between the arms' capsules [m].
    pub clearance: f64,
}

/// All meetings of a cell.
#[derive(Debug, Clone, PartialEq)]
pub struct MeetingTable {
    /// Both hold the cube: by the rotation of the postument's tool in the track's tool frame, one of the
    /// 24 rotations of a cube onto itself; `None` where no pose of both arms was found.
    pub grasps: [Option<Meeting>; 24],
    /// The camera in the other hand looks at a face of the held cube: `[holder][side]`, where `side` is
    /// the face's outward normal in the holder's tool frame: 0 is +z (opposite the palm), 1 is +x, 2 is -x.
    pub views: [[Option<Meeting>; 3]; 2],
    /// How far the track draws back along -y between meetings, so that both arms move freely [m].
    pub separation: f64,
}
