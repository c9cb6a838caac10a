//! Meetings of two arms, the table of all of them, and the paths between them.

use super::settings::ReachSettings;
use super::way::{Ends, MeetingPath};
use crate::cell::Cell;
use crate::generators::position::Speeds;
use crate::motion::JointPositions;
use crate::spatial::Pose;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// Joint positions of both arms in which the tools have a wanted pose relative to each other.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Meeting {
    /// Nominal pose of the postument's tool in the track's tool frame.
    pub track_from_postument: Pose,
    /// Joint positions of the track arm; its d0 leaves room to retract by the separation.
    pub track: JointPositions,
    /// Joint positions of the postument arm.
    pub postument: JointPositions,
    /// Joint positions of the track arm when its tool is retracted along its own axis; the
    /// postument is at the meeting.
    pub track_back: JointPositions,
    /// Joint positions of the postument arm when its tool is retracted along its own axis; the
    /// track is at the meeting.
    pub postument_back: JointPositions,
    /// Lowest and highest angle by which the track arm's last joint can roll from the meeting
    /// (rad); 0 lies between them.
    pub track_roll: (f64, f64),
    /// Lowest and highest angle by which the postument arm's last joint can roll (rad).
    pub postument_roll: (f64, f64),
    /// Least distance between the arms (m) at the meeting, while a hand retracts from it, and while
    /// the track separates; 0.1 if it is larger.
    pub clearance: f64,
}

impl Meeting {
    /// Returns the joint positions of both arms when the hand of the arm `newcomer` (0 track, 1
    /// postument) is retracted from the cube and the other arm is at the meeting.
    #[must_use]
    pub fn short_of(&self, newcomer: usize) -> [JointPositions; 2] {
        match newcomer {
            0 => [self.track_back, self.postument],
            _ => [self.track, self.postument_back],
        }
    }

    /// Returns whether both arms have the same joint positions at this meeting and at `other`.
    fn is_at(&self, other: &Self) -> bool {
        (self.track, self.postument) == (other.track, other.postument)
    }
}

/// Number of places for meetings in a table: 24 grasps, and three views for either holder.
const MEETINGS: usize = 24 + 6;

/// All meetings of a cell.
///
/// ```
/// use rubik_robot::cube::{Rotation24, rotations};
/// use rubik_robot::reach::{MeetingTable, ReachSettings};
/// use rubik_robot::tasks;
/// use std::path::Path;
///
/// let cell = tasks::read(Path::new("cell"), "task = \"idle\"\n", &[])?.controller.cell;
/// let table = MeetingTable::compute(&cell, &ReachSettings::default());
///
/// // Both palms on one face of the cube are impossible: the rotations that keep the approach.
/// assert!(table.grasps[Rotation24::IDENTITY.index()].is_none());
/// for (rotation, grasp) in rotations().iter().zip(&table.grasps) {
///     let Some(grasp) = grasp else { continue };
///     assert!(grasp.track_from_postument.rotation.angle_to(rotation) < 1e-9);
///     assert_eq!(cell.arms[0].model.check(&grasp.track), Ok(()));
///     assert!(grasp.clearance >= ReachSettings::default().clearance);
/// }
/// # Ok::<(), rubik_robot::scenario::fault::Faults>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct MeetingTable {
    /// Meetings in which both hands hold the cube. The index stands for the rotation of the
    /// postument's tool in the track's tool frame: one of the 24 rotations of a cube onto itself,
    /// in the order of [`rotations`](super::rotations). `None` where the grippers would collide, or
    /// where no joint positions were found. Grippers collide if both palms are on one face, or if
    /// palms are on adjacent faces and each hand has a finger under the other's palm.
    pub grasps: [Option<Meeting>; 24],
    /// Meetings in which the camera on the other hand looks at a face of the held cube, as
    /// `[holder][side]`. `holder` is the arm with the cube (0 track, 1 postument); `side` is the
    /// face's outward normal in the holder's tool frame: 0 is +z (opposite the palm), 1 is +x, 2 is
    /// -x.
    pub views: [[Option<Meeting>; 3]; 2],
    /// Distance by which the track retracts along -y between meetings, so that both arms move
    /// freely (m).
    pub separation: f64,
    /// Quickest free paths, two from each meeting to each: see [`MeetingTable::way_between`]. Empty
    /// before [`MeetingTable::find_ways`]: then all paths are the usual ones, with the whole
    /// `separation`.
    pub ways: Vec<Option<MeetingPath>>,
}

impl MeetingTable {
    /// Computes the quickest free paths between all pairs of meetings for arms of these speeds, and
    /// stores them in the table.
    pub fn find_ways(&mut self, cell: &Cell, settings: &ReachSettings, speeds: &Speeds) {
        let numbers = || 0..MEETINGS;
        // Two paths for each pair of meetings: the hand of either arm may be the free one.
        let pairs = numbers().flat_map(|from| numbers().map(move |to| (from, to)));
        let journeys = pairs.flat_map(|(from, to)| [(from, to, 0), (from, to, 1)]);
        let ways = journeys.map(|(from, to, newcomer)| {
            let (from, to) = (self.place(from, newcomer)?, self.place(to, newcomer)?);
            MeetingPath::quickest(cell, settings, speeds, &Ends { from, to, newcomer })
        });
        self.ways = ways.collect();
    }

    /// Returns the quickest free path between two meetings if `newcomer` (0 track, 1 postument) is
    /// the arm whose hand is free. `None` means that only the usual path is left: the track
    /// retracts by the whole separation, both arms move across, and the track advances.
    #[must_use]
    pub fn way(&self, from: &Meeting, to: &Meeting, newcomer: usize) -> Option<&MeetingPath> {
        self.way_between(self.number(from)?, self.number(to)?, newcomer)
    }

    /// Returns the number of a meeting in the table: 0..24 for a grasp, its index in `grasps`, and
    /// 24..30 for a view, in the order of `views`. `None` if the table does not have the meeting.
    #[must_use]
    pub fn number(&self, meeting: &Meeting) -> Option<usize> {
        self.meetings().position(|known| known.as_ref().is_some_and(|known| known.is_at(meeting)))
    }

    /// Returns the same path as [`MeetingTable::way`], for meetings given by their numbers: see
    /// [`MeetingTable::number`].
    #[must_use]
    pub fn way_between(&self, from: usize, to: usize, newcomer: usize) -> Option<&MeetingPath> {
        self.ways.get((from * MEETINGS + to) * 2 + newcomer)?.as_ref()
    }

    /// Returns the joint positions of both arms at the end of a path to the meeting with this
    /// number, or at the beginning of a path from it. At a grasp the arm `newcomer` is still
    /// retracted from the cube; at a view both arms are at the meeting itself. `None` if the table
    /// has no meeting with this number.
    #[must_use]
    pub fn place(&self, number: usize, newcomer: usize) -> Option<[JointPositions; 2]> {
        let meeting = self.meetings().nth(number)?.as_ref()?;
        let looks = number >= self.grasps.len();
        Some(if looks { [meeting.track, meeting.postument] } else { meeting.short_of(newcomer) })
    }

    /// Iterates over all places for meetings in the order of their numbers: the grasps, then the
    /// views.
    fn meetings(&self) -> impl Iterator<Item = &Option<Meeting>> {
        self.grasps.iter().chain(self.views.iter().flatten())
    }

    /// Returns the number of grasps and the number of views in the table.
    #[must_use]
    pub fn found(&self) -> (usize, usize) {
        (self.grasps.iter().flatten().count(), self.views.iter().flatten().flatten().count())
    }
}
/// Returns the mean place of the hands over all meetings, in the world. A workshop lets the hands
/// meet there to find the pose of one base to the other.
#[must_use]
pub fn meeting_place(cell: &Cell, table: &MeetingTable) -> Point3<f64> {
    let Some(arm) = cell.arms.first() else { return Point3::origin() };
    let places: Vec<Vector3<f64>> = table
        .grasps
        .iter()
        .flatten()
        .map(|m| {
            let flange = arm.world_from_base * arm.model.base_from_flange(&m.track);
            (flange * arm.flange_from_tool).translation.vector
        })
        .collect();
    Point3::from(places.iter().sum::<Vector3<f64>>() / places.len().max(1) as f64)
}
