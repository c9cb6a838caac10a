//! Meetings of two arms, the table of all of them, and the ways between them.

use super::settings::ReachSettings;
use super::way::{Ends, Way};
use crate::cell::Cell;
use crate::generators::position::Speeds;
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

impl Meeting {
    /// Returns where both arms stand when the newcomer's hand (0 track, 1 postument) is still short
    /// of the cube.
    #[must_use]
    pub fn short_of(&self, newcomer: usize) -> [JointPositions; 2] {
        match newcomer {
            0 => [self.track_back, self.postument],
            _ => [self.track, self.postument_back],
        }
    }

    /// Whether this is the same meeting: both arms stand in the same place.
    fn is_at(&self, other: &Self) -> bool {
        (self.track, self.postument) == (other.track, other.postument)
    }
}

/// How many places a table has for meetings: 24 grasps, and three views for either holder.
const MEETINGS: usize = 24 + 6;

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
    /// The quickest ways that are free, two from each meeting to each: see [`MeetingTable::way`].
    /// Empty where `separation` is kept on all ways.
    pub ways: Vec<Option<Way>>,
}

impl MeetingTable {
    /// Finds the quickest free way between any two meetings, for arms of these speeds.
    pub fn find_ways(&mut self, cell: &Cell, settings: &ReachSettings, speeds: &Speeds) {
        let numbers = || 0..MEETINGS;
        let pairs = numbers().flat_map(|from| numbers().map(move |to| (from, to)));
        let journeys = pairs.flat_map(|(from, to)| [(from, to, 0), (from, to, 1)]);
        let ways = journeys.map(|(from, to, newcomer)| {
            let (from, to) = (self.place(from, newcomer)?, self.place(to, newcomer)?);
            Way::quickest(cell, settings, speeds, &Ends { from, to, newcomer })
        });
        self.ways = ways.collect();
    }

    /// Returns the quickest free way from one meeting to another whose newcomer is this arm, if
    /// there is one but the usual one: apart by the whole separation, across, and together.
    #[must_use]
    pub fn way(&self, from: &Meeting, to: &Meeting, newcomer: usize) -> Option<&Way> {
        let number = |meeting: &Meeting| {
            self.meetings().position(|known| known.as_ref().is_some_and(|k| k.is_at(meeting)))
        };
        self.way_between(number(from)?, number(to)?, newcomer)
    }

    /// Returns the same for the numbers of two meetings: those of the grasps are their rotations'.
    #[must_use]
    pub fn way_between(&self, from: usize, to: usize, newcomer: usize) -> Option<&Way> {
        self.ways.get((from * MEETINGS + to) * 2 + newcomer)?.as_ref()
    }

    /// Returns where both arms stand before they come nearer at a meeting: a newcomer to a grasp
    /// stands short of the cube, one that only looks does not.
    fn place(&self, number: usize, newcomer: usize) -> Option<[JointPositions; 2]> {
        let meeting = self.meetings().nth(number)?.as_ref()?;
        let looks = number >= self.grasps.len();
        Some(if looks { [meeting.track, meeting.postument] } else { meeting.short_of(newcomer) })
    }

    /// All meetings: the grasps, then the views.
    fn meetings(&self) -> impl Iterator<Item = &Option<Meeting>> {
        self.grasps.iter().chain(self.views.iter().flatten())
    }

    /// How many grasps and how many views were found.
    #[must_use]
    pub fn found(&self) -> (usize, usize) {
        (self.grasps.iter().flatten().count(), self.views.iter().flatten().flatten().count())
    }
}
