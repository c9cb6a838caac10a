//! Where two arms can meet: for each relative orientation of the tools, joint positions of both arms.
//!
//! Computed once per cell from the belief, on the EDP side, and handed to MP as data: the tasks themselves
//! know no kinematics.
//!
//! - in: the [`Cell`], [`ReachSettings`]
//! - out: [`MeetingTable`], the same for the same input (seeded search)

mod bodies;
mod example;
mod search;
mod stance;

pub use example::example_cell;

use crate::cell::Cell;
use crate::motion::JointPositions;
use crate::spatial::Pose;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
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

/// What a meeting must offer, and how hard it is searched for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReachSettings {
    /// How far the track draws back along -y between meetings [m].
    pub separation: f64,
    /// How far each arm can draw back along its own tool axis [m].
    pub back: f64,
    /// Distance from a hand's camera to the face that it looks at [m].
    pub view_distance: f64,
    /// By how much the tools can be shifted along each axis, for other depths and corrections [m].
    pub shift: f64,
    /// Least distance between the capsules of the arms [m].
    pub clearance: f64,
    /// Height above the table that wrists and tools keep [m].
    pub above_table: f64,
    /// Random poses that are tried for each meeting, near to and far from those that are already known.
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
            samples: 6000,
            seed: 2007,
        }
    }
}

impl MeetingTable {
    /// Searches the meetings of the track arm (`cell.arms[0]`) and the postument arm (`cell.arms[1]`). A cell
    /// with fewer arms has none.
    #[must_use]
    pub fn compute(cell: &Cell, settings: &ReachSettings) -> Self {
        search::table(cell, settings)
    }

    /// How many grasps and how many views were found.
    #[must_use]
    pub fn found(&self) -> (usize, usize) {
        (self.grasps.iter().flatten().count(), self.views.iter().flatten().flatten().count())
    }
}

/// The 24 rotations of a cube onto itself, in the order of [`MeetingTable::grasps`]: six blocks by the image of
/// z (+x, -x, +y, -y, +z, -z), in each block four by the image of y, in the same order of directions.
#[must_use]
pub fn rotations() -> [UnitQuaternion<f64>; 24] {
    let mut all = [UnitQuaternion::identity(); 24];
    let mut count = 0;
    let directions =
        [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y(), Vector3::z(), -Vector3::z()];
    for z in directions {
        for y in directions.into_iter().filter(|y| y.dot(&z) == 0.0) {
            let matrix = Matrix3::from_columns(&[y.cross(&z), y, z]);
            all[count] =
                UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
            count += 1;
        }
    }
    all
}

/// Index in [`rotations`] of the one nearest to `rotation`.
#[must_use]
pub fn rotation_index(rotation: &UnitQuaternion<f64>) -> usize {
    let likeness = |r: &UnitQuaternion<f64>| r.coords.dot(&rotation.coords).abs();
    let all = rotations();
    (0..24).max_by(|&a, &b| likeness(&all[a]).total_cmp(&likeness(&all[b]))).unwrap_or(0)
}
