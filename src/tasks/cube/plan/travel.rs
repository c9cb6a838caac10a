//! The reach of the planner: where the arms can meet, and how long they take between meetings.
//!
//! - in: the cell's table of meetings, the arms' full speeds
//! - out: for each pair of grips the range in which both wrists can roll there ([`Reach::grasp`]);
//!   seconds from meeting to meeting ([`Reach::travel`])
//!
//! Between two meetings the track retracts, both arms move to their new places together, and the
//! track advances again: see the mission's `regrasp`. The wrists start from where the last turns
//! have left them.

use super::super::hold::{Grip, Hand};
use crate::cube::{Rotation24, rotation_index};
use crate::generators::position::Speeds;
use crate::motion::{JointPositions, ROLL};
use crate::reach::MeetingTable;
use nalgebra::UnitQuaternion;
use std::f64::consts::{FRAC_PI_2, PI};

/// Ranges in which both tools can roll about their own axes where the arms meet, relative (rad);
/// both contain 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RollLimits {
    /// Range of the track arm (rad).
    pub track: (f64, f64),
    /// Range of the postument arm (rad).
    pub postument: (f64, f64),
}

/// Configuration of both arms at the end of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ArmsAt {
    /// Number of the meeting: the index of the rotation of the postument's tool in the track's.
    pub meeting: u8,
    /// Rolls of the wrists since then, in quarter turns -2..=2, the track's first.
    pub rolled: [i8; 2],
}

/// Number of a meeting in the [`MeetingTable`]: 24 grasps, then the views.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stop(u8);

impl Stop {
    /// Number of meetings.
    pub const COUNT: usize = GRASPS + 2 * SIDES;

    /// Returns the grasp with this number: the index of the rotation of the postument's tool in the
    /// track's.
    #[must_use]
    pub fn grasp(rotation: u8) -> Self {
        Self(rotation)
    }

    /// Returns the view of a side (0 +z, 1 +x, 2 -x of the holder's tool) of the cube that `holder`
    /// holds.
    #[must_use]
    pub fn view(holder: Hand, side: usize) -> Self {
        Self((GRASPS + holder.index() * SIDES + side) as u8)
    }

    /// Returns the meeting with this number in the table, if there is one.
    #[must_use]
    pub fn numbered(number: usize) -> Option<Self> {
        (number < Self::COUNT).then_some(Self(number as u8))
    }

    /// Returns whether the meeting is a view, and no grasp.
    #[must_use]
    pub fn is_view(self) -> bool {
        self.number() >= GRASPS
    }

    /// Returns the number of the meeting, less than [`Stop::COUNT`].
    #[must_use]
    pub fn number(self) -> usize {
        usize::from(self.0)
    }
}

/// Number of grasps in a table, and of views of the cube in one hand.
const GRASPS: usize = 24;
const SIDES: usize = 3;

/// The places where the arms can meet, and the times between them.
pub trait Reach {
    /// Returns the ranges in which both wrists can roll when both hands hold the cube with these
    /// rotations `cube_from_tool`; `None` where they cannot hold it so.
    fn grasp(
        &self,
        track: UnitQuaternion<f64>,
        postument: UnitQuaternion<f64>,
    ) -> Option<RollLimits>;

    /// Returns whether the camera of the other hand can be brought before a side of a cube that
    /// `holder` holds. The side is the face's outward normal in the holder's tool frame: 0 is +z, 1
    /// is +x, 2 is -x.
    fn view(&self, holder: Hand, side: usize) -> bool;

    /// Returns the time of the path to the grasp number `meeting` (s). It begins at `from`, with
    /// `newcomer` retracted from the cube, and ends where `newcomer` is before the cube again.
    /// `None` stands for the start of the plan.
    fn travel(&self, from: Option<ArmsAt>, newcomer: Hand, meeting: u8) -> f64;

    /// Returns the time of the path from one meeting to another (s) with the wrists where the
    /// meetings have them. `newcomer` is the free hand. `None` stands for the start of the plan.
    fn path(&self, from: Option<Stop>, to: Stop, newcomer: Hand) -> f64;

    /// Returns a lower bound of the time of all paths (s).
    fn least_travel(&self) -> f64 {
        0.0
    }
}

/// Returns a value for each pair of grips, `[track grip * Grip::COUNT + postument grip]`, that
/// depends on the rotations of both tools in the cube alone. Grips of both depths share it: 576
/// inquiries instead of 2304.
pub fn of_rotations<T: Copy>(
    value: impl Fn(&UnitQuaternion<f64>, &UnitQuaternion<f64>) -> Option<T>,
) -> Vec<Option<T>> {
    let tools: Vec<_> = Rotation24::all().map(Rotation24::quaternion).collect();
    let pairs = tools.iter().flat_map(|a| tools.iter().map(move |b| (a, b)));
    let by_rotation: Vec<Option<T>> = pairs.map(|(a, b)| value(a, b)).collect();
    // Grips of both depths are numbered by their rotation modulo 24.
    let shared = |pair: usize| {
        let [track, postument] = [pair / Grip::COUNT, pair % Grip::COUNT].map(|g| g % tools.len());
        by_rotation[track * tools.len() + postument]
    };
    (0..Grip::COUNT * Grip::COUNT).map(shared).collect()
}

/// Arms that reach everywhere in the same time and roll by half a turn either way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Everywhere;

/// Time of a path where the arms are unknown (s).
const TYPICAL_SECONDS: f64 = 15.0;

impl Reach for Everywhere {
    fn grasp(&self, _: UnitQuaternion<f64>, _: UnitQuaternion<f64>) -> Option<RollLimits> {
        Some(RollLimits { track: (-PI, PI), postument: (-PI, PI) })
    }

    fn view(&self, _: Hand, _: usize) -> bool {
        true
    }

    fn travel(&self, _: Option<ArmsAt>, _: Hand, _: u8) -> f64 {
        TYPICAL_SECONDS
    }

    fn path(&self, _: Option<Stop>, _: Stop, _: Hand) -> f64 {
        TYPICAL_SECONDS
    }

    fn least_travel(&self) -> f64 {
        TYPICAL_SECONDS
    }
}

/// The reach of a cell, from its table of meetings.
#[derive(Clone)]
pub struct Reachable {
    table: MeetingTable,
    speeds: Speeds,
    /// Results of [`Reach::travel`] by [`slot`] (s).
    seconds: Vec<f32>,
    /// Least of them (s).
    least: f64,
    /// Mean of the known ones, for a path that begins at no meeting (s).
    mean: f64,
    /// Meeting at which the hands are when a plan begins.
    start: Option<Stop>,
}

/// Roll that stays free at both ends of a range (rad). The wrist rolls on by the twist between the
/// grips, and it is not at the nominal meeting where the cube is tilted in a hand. It is less than
/// the margin with which the search for meetings keeps quarter turns (0.15 rad).
const ROLL_MARGIN: f64 = 0.12;

/// Number of rolls that a wrist may have made: -2..=2 quarter turns.
const ROLLED: usize = 5;

/// Returns the index of a path in [`Reachable::seconds`].
fn slot(from: ArmsAt, newcomer: Hand, meeting: u8) -> usize {
    let rolled = from.rolled.map(|q| (q + 2) as usize);
    let from = (usize::from(from.meeting) * ROLLED + rolled[0]) * ROLLED + rolled[1];
    (from * 2 + newcomer.index()) * 24 + usize::from(meeting)
}

/// Prints no times: they follow from the table, and the run's hash covers the text of a thought.
impl std::fmt::Debug for Reachable {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Reachable").field("table", &self.table).finish_non_exhaustive()
    }
}

impl Reachable {
    /// Makes the reach of a cell from its table of meetings, and computes the times of all paths
    /// between its grasps.
    #[must_use]
    pub fn new(table: MeetingTable, speeds: &Speeds) -> Self {
        let mut seconds = vec![TYPICAL_SECONDS as f32; 24 * ROLLED * ROLLED * 2 * 24];
        let (mut sum, mut known) = (0.0, 0_u32);
        for meeting in 0..24 {
            for to in 0..24 {
                for newcomer in [Hand::Track, Hand::Postument] {
                    for rolls in 0..ROLLED * ROLLED {
                        let rolled = [(rolls / ROLLED) as i8 - 2, (rolls % ROLLED) as i8 - 2];
                        let from = ArmsAt { meeting, rolled };
                        let ends = (Stop::grasp(meeting), Stop::grasp(to));
                        if let Some(time) = seconds_between(&table, speeds, ends, rolled, newcomer)
                        {
                            seconds[slot(from, newcomer, to)] = time as f32;
                            (sum, known) = (sum + time, known + 1);
                        }
                    }
                }
            }
        }
        let least = seconds.iter().copied().fold(TYPICAL_SECONDS as f32, f32::min);
        let mean = if known > 0 { sum / f64::from(known) } else { TYPICAL_SECONDS };
        Self { table, speeds: *speeds, seconds, least: f64::from(least), mean, start: None }
    }

    /// Returns the same reach for plans that begin with the hands at this meeting; `None` if they
    /// are at no meeting.
    #[must_use]
    pub fn starting_at(mut self, start: Option<Stop>) -> Self {
        self.start = start;
        let hands = [Hand::Track, Hand::Postument];
        let first = (0..GRASPS as u8)
            .flat_map(|grasp| hands.map(|newcomer| self.path(None, Stop::grasp(grasp), newcomer)));
        // The lower bound holds for the first path as well.
        self.least = first.fold(self.least, f64::min);
        self
    }
}

/// Returns the time of the path between two meetings (s), as [`Reach::travel`] and [`Reach::path`]
/// do. `rolled` are the quarter turns by which the wrists have rolled since the first meeting.
/// `None` if the table lacks one of the meetings.
fn seconds_between(
    table: &MeetingTable,
    speeds: &Speeds,
    (from, to): (Stop, Stop),
    rolled: [i8; 2],
    newcomer: Hand,
) -> Option<f64> {
    let quick = table.way_between(from.number(), to.number(), newcomer.index());
    let place = |stop: Stop, rolled: [i8; 2]| {
        let mut both = table.place(stop.number(), newcomer.index())?;
        for (arm, quarters) in both.iter_mut().zip(rolled) {
            arm.0[ROLL] += f64::from(quarters) * FRAC_PI_2;
        }
        Some(both)
    };
    let (start, end) = (place(from, rolled)?, place(to, [0; 2])?);
    // The table's path is quicker than the usual one, and is known to be free of collisions.
    if let Some(quick) = quick {
        let rolls = [0, 1].map(|arm: usize| end[arm].0[ROLL] - start[arm].0[ROLL]);
        return Some(quick.seconds_with_rolls(speeds, rolls));
    }
    // The usual path: apart by the whole separation, across, and together again.
    let together = start.iter().zip(&end).map(|(a, b)| speeds.joints_seconds(a, b, 1.0));
    let mut apart = JointPositions::default();
    apart.0[0] = table.separation;
    let back_and_up = 2.0 * speeds.joints_seconds(&JointPositions::default(), &apart, 1.0);
    Some(together.fold(0.0, f64::max) + back_and_up)
}

impl Reach for Reachable {
    fn grasp(
        &self,
        track: UnitQuaternion<f64>,
        postument: UnitQuaternion<f64>,
    ) -> Option<RollLimits> {
        let meeting = self.table.grasps[rotation_index(&(track.inverse() * postument))]?;
        let inside = |(low, high): (f64, f64)| (low + ROLL_MARGIN, high - ROLL_MARGIN);
        Some(RollLimits {
            track: inside(meeting.track_roll),
            postument: inside(meeting.postument_roll),
        })
    }

    fn view(&self, holder: Hand, side: usize) -> bool {
        self.table.views[holder.index()].get(side).is_some_and(Option::is_some)
    }

    fn travel(&self, from: Option<ArmsAt>, newcomer: Hand, meeting: u8) -> f64 {
        match from {
            Some(from) => f64::from(self.seconds[slot(from, newcomer, meeting)]),
            None => self.path(None, Stop::grasp(meeting), newcomer),
        }
    }

    fn path(&self, from: Option<Stop>, to: Stop, newcomer: Hand) -> f64 {
        let known = from.or(self.start).and_then(|from| {
            seconds_between(&self.table, &self.speeds, (from, to), [0; 2], newcomer)
        });
        known.unwrap_or(self.mean)
    }

    fn least_travel(&self) -> f64 {
        self.least
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generators::profile::Profile;
    use crate::motion::AXES;
    use crate::reach::Meeting;
    use crate::spatial::Pose;

    /// Returns the reach of a table with one grasp and one view, whose joint positions differ by
    /// `apart` (rad).
    fn reach(apart: f64) -> Reachable {
        let at = |angle: f64| {
            let joints = JointPositions([0.0, angle, 0.0, 0.0, 0.0, 0.0, 0.0]);
            Some(Meeting {
                track_from_postument: Pose::identity(),
                track: joints,
                postument: joints,
                track_back: joints,
                postument_back: joints,
                track_roll: (-PI, PI),
                postument_roll: (-PI, PI),
                clearance: 0.1,
            })
        };
        let mut table = MeetingTable {
            grasps: [None; 24],
            views: [[None; 3]; 2],
            separation: 0.1,
            ways: Vec::new(),
        };
        (table.grasps[5], table.views[0][1]) = (at(0.0), at(apart));
        let speeds = Speeds {
            joint: [1.0; AXES],
            joint_acceleration: [100.0; AXES],
            linear: 1.0,
            linear_acceleration: 1.0,
            angular: 1.0,
            angular_acceleration: 1.0,
            profile: Profile { ramp: 0.1 },
        };
        Reachable::new(table, &speeds)
    }

    #[test]
    fn first_path_begins_where_the_hands_are() {
        let first = |reach: &Reachable| reach.travel(None, Hand::Postument, 5);
        let unknown = first(&reach(1.0));
        let view = Some(Stop::view(Hand::Track, 1));

        let [near, far] = [1.0, 2.0].map(|apart| reach(apart).starting_at(view));

        assert!((first(&far) - first(&near) - 1.0).abs() < 1e-9, "1 rad at 1 rad/s");
        assert!((first(&far) - unknown).abs() > 0.1, "the mean does not depend on the start");
        assert!(first(&near) >= near.least_travel() && near.least_travel() > 0.0);
    }
}
