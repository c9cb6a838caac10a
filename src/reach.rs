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
    /// Interval within which the track's last joint can roll from here, relative [rad], contains 0.
    pub track_roll: (f64, f64),
    /// The same of the postument arm [rad].
    pub postument_roll: (f64, f64),
    /// Least distance between the arms' capsules [m].
    pub clearance: f64,
}

