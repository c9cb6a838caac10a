//! Meetings of two arms, the table of all of them, and the paths between them.

use super::settings::ReachSettings;
use super::way::{Ends, MeetingPath};
use crate::cell::Cell;
use crate::generators::position::Speeds;
use crate::motion::JointPositions;
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};

/// Joint positions of both arms in which the tools have a wanted pose relative to each other.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Meeting {
    /// `track_from_postument`: the nominal pose of the postument's tool in the track's tool frame.
    pub track_from_postument: Pose,
    /// Joint positions of the track arm; d0 leaves room to retract by the separation.
    pub track: JointPositions,
    /// Joint positions of the postument arm.
    pub postument: JointPositions,
    /// Joint positions of the track arm retracted along its own tool; its partner is at the
    /// meeting.
    pub track_back: JointPositions,
    /// Joint positions of the postument arm retracted along its own tool.
    pub postument_back: JointPositions,
    /// Range in which the track's last joint can roll from here, relative (rad); it contains 0.
    pub track_roll: (f64, f64),
    /// Range in which the postument's last joint can roll (rad).
    pub postument_roll: (f64, f64),
    /// Least distance between the arms' capsules, here and while either hand retracts and the track
    /// separates, at most 0.1 (m).
    pub clearance: f64,
}

impl Meeting {
    /// Returns the joint positions of both arms when the hand of `newcomer` (0 track, 1 postument)
    /// is retracted from the cube and its partner is at the meeting.
    #[must_use]
    pub fn short_of(&self, newcomer: usize) -> [JointPositions; 2] {
        match newcomer {
            0 => [self.track_back, self.postument],
            _ => [self.track, self.postument_back],
        }
    }

    /// Returns whether `other` has the same joint positions of both arms.
    fn is_at(&self, other: &Self) -> bool {
        (self.track, self.postument) == (other.track, other.postument)
    }
}

/// Number of meetings in a table: 24 grasps, and three views for either holder.
const MEETINGS: usize = 24 + 6;

/// All meetings of a cell.
#[derive(Debug, Clone, PartialEq)]
pub struct MeetingTable {
    /// Meetings in which both hands hold the cube, by the rotation of the postument's tool in the
    /// track's tool frame: one of the 24 rotations of a cube onto itself, in the order of
    /// [`rotations`](super::rotations). `None` where the grippers would collide, or where no pose
    /// of both arms was found. Grippers collide with both palms on one face, and with adjacent
    /// palms if each hand has a finger on the face under the other's palm.
    pub grasps: [Option<Meeting>; 24],
    /// Meetings in which the camera in the other hand looks at a face of the held cube:
    /// `[holder][side]`, where `side` is the face's outward normal in the holder's tool frame: 0 is
    /// +z (opposite the palm), 1 is +x, 2 is -x.
    pub views: [[Option<Meeting>; 3]; 2],
    /// Distance by which the track retracts along -y between meetings, so that both arms move
    /// freely (m).
    pub separation: f64,
    /// Quickest free paths, two from each meeting to each: see [`MeetingTable::way`]. Empty where
    /// `separation` is kept on all paths.
    pub ways: Vec<Option<MeetingPath>>,
}

impl MeetingTable {
    /// Computes the quickest free path between any two meetings for arms of these speeds, and
    /// stores it in the table.
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

    /// Returns the quickest free path between two meetings on which `newcomer` (0 track, 1
    /// postument) is the arm whose hand is free. `None` means that only the usual path is left: the
    /// track retracts by the whole separation, both arms move across, and the track advances.
    #[must_use]
    pub fn way(&self, from: &Meeting, to: &Meeting, newcomer: usize) -> Option<&MeetingPath> {
        self.way_between(self.number(from)?, self.number(to)?, newcomer)
    }

    /// Returns the number of a meeting in the table: 0..24 is a grasp, by the number of its
    /// rotation, and 24..30 a view, in the order of `views`. `None` if the table lacks it.
    #[must_use]
    pub fn number(&self, meeting: &Meeting) -> Option<usize> {
        self.meetings().position(|known| known.as_ref().is_some_and(|known| known.is_at(meeting)))
    }

    /// Returns the path of [`MeetingTable::way`] between the meetings with two numbers: see
    /// [`MeetingTable::number`].
    #[must_use]
    pub fn way_between(&self, from: usize, to: usize, newcomer: usize) -> Option<&MeetingPath> {
        self.ways.get((from * MEETINGS + to) * 2 + newcomer)?.as_ref()
    }

    /// Returns the joint positions of both arms where a path to or from the meeting with this
    /// number ends: a newcomer to a grasp is still retracted from the cube, one that only looks is
    /// at the meeting itself.
    #[must_use]
    pub fn place(&self, number: usize, newcomer: usize) -> Option<[JointPositions; 2]> {
        let meeting = self.meetings().nth(number)?.as_ref()?;
        let looks = number >= self.grasps.len();
        Some(if looks { [meeting.track, meeting.postument] } else { meeting.short_of(newcomer) })
    }

    /// Iterates over all meetings: the grasps, then the views.
    fn meetings(&self) -> impl Iterator<Item = &Option<Meeting>> {
        self.grasps.iter().chain(self.views.iter().flatten())
    }

    /// Returns the number of grasps and of views that were found.
    #[must_use]
    pub fn found(&self) -> (usize, usize) {
        (self.grasps.iter().flatten().count(), self.views.iter().flatten().flatten().count())
    }
}
