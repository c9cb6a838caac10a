//! The quickest path from one meeting to another. The track retracts only as far as it must and
//! advances again (two strokes), while all joints move from one meeting to the other (the motion
//! across).
//!
//! - in: the believed cell, joint positions at both ends of the path, the arms' speeds
//! - out: a [`MeetingPath`]: the share of its time that each of these motions has, and its time
//! - method: candidates are ordered by a lower bound of their time, and the cheapest tests come
//!   first; the first candidate that is timed in full and free of collisions is the quickest
//!
//! | choice | constant | reason |
//! |---|---|---|
//! | step of the separations from 0 to the usual one | `FINE` | 0.10 m suffices on average |
//! | overlap of a stroke with the motion across | `OVERLAPS` | the arms must be apart in between |
//! | longer ramps | `RAMPS` | with short ramps the joints' acceleration bounds the speed |
//! | order of the checked moments, in long steps | `STRIDE` | a blocked path is found soon |
//! | moments checked before a path is timed | `GLANCES` | timing takes longer than a few checks |
//! | factor of the bound | `MISSED` | motions are timed at moments, which may miss the peak |

use super::bodies::{Bodies, newcomer_apart};
use super::motors::{MOMENTS, MOTORS, farthest_turn};
use super::settings::ReachSettings;
use crate::cell::Cell;
use crate::generators::legs::{Leg, Legs};
use crate::generators::position::Speeds;
use crate::generators::profile::Profile;
use crate::motion::{JointPositions, ROLL};
use serde::{Deserialize, Serialize};

/// Joint positions of both arms at the beginning and at the end of a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ends {
    pub(super) from: [JointPositions; 2],
    pub(super) to: [JointPositions; 2],
    /// The arm whose hand is free: 0 track, 1 postument.
    pub(super) newcomer: usize,
}

/// Path of both arms from one meeting to another. The track retracts and advances again while all
/// joints move across. The three motions overlap as far as the arms stay clear of each other.
/// Durations and times are shares of the whole time, except [`MeetingPath::seconds`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MeetingPath {
    /// Distance by which the track retracts (m).
    pub separation: f64,
    /// Duration of the retraction, and of the advance.
    pub stroke: f64,
    /// Beginning of the motion across. It ends as long before the end of the whole time.
    pub across: f64,
    /// Duration in which a motion reaches its full speed.
    pub ramp: f64,
    /// Least time of the path within the limits of joints and motors, without rolls of the wrists
    /// (s).
    pub seconds: f64,
}

/// Step from one separation that is tried to the next (m).
pub(super) const FINE: f64 = 0.02;
/// Overlaps of a stroke with the motion across, as shares of the shorter one of the stroke and half
/// of the motion across.
const OVERLAPS: [f64; 5] = [1.0, 0.75, 0.5, 0.25, 0.0];
/// Factors by which ramps are longer than usual. With the usual ramp the acceleration of the joints
/// may bound their speed.
const RAMPS: [f64; 3] = [1.0, 1.5, 2.2];
/// Step from one checked moment to the next. It has no common divisor with the 61 moments, so all
/// are visited.
const STRIDE: u32 = 23;
/// Least share of the greatest speed or acceleration of a motion that shows at the moments at which
/// it is timed. With this factor the bound of a path is never above the time that is found later.
const MISSED: f64 = 0.85;

/// Iterates over the distances by which the track may retract between two meetings: 0, then in
/// steps of 2 cm up to `most` (m).
pub(super) fn separations(most: f64) -> impl Iterator<Item = f64> {
    (0..).map(|step| f64::from(step) * FINE).take_while(move |by| *by < most + 0.5 * FINE)
}

/// Returns the least distance between the arms, and of each hand from its own arm, at these joint
/// positions (m). The hand of `newcomer` (0 track, 1 postument) is free, and the other hand holds
/// the cube.
pub(super) fn clearance(cell: &Cell, joints: &[JointPositions; 2], newcomer: usize) -> f64 {
    let [track, postument] =
        [0, 1].map(|arm: usize| Bodies::of(cell, &cell.arms[arm], &joints[arm]));
    let apart = newcomer_apart(newcomer, &track, &postument);
    track.own().min(postument.own()).min(apart)
}

impl MeetingPath {
    /// Returns the quickest candidate path between two meetings on which the arms keep the
    /// clearance; `None` if there is none.
    pub(super) fn quickest(
        cell: &Cell,
        settings: &ReachSettings,
        speeds: &Speeds,
        ends: &Ends,
    ) -> Option<Self> {
        let Ends { from, mut to, newcomer } = *ends;
        // The roll moves no part of an arm that could meet another; its time is added later.
        for arm in 0..2 {
            to[arm].0[ROLL] = from[arm].0[ROLL];
        }
        let ends = Ends { from, to, newcomer };
        let mut check = FreeCheck::new(cell, settings, speeds, &ends);
        // Sorted by time, the quickest last: `pop` takes it. A time is a lower bound until the path
        // is timed in full.
        let mut ways = Vec::new();
        // Among equally quick paths the first in `order` wins, as in a search that times all.
        let rank = |&(way, timed, order): &(Self, Timed, usize)| (way.seconds, timed, order);
        let insert = |ways: &mut Vec<_>, new| {
            let place = ways.partition_point(|other| rank(other) > rank(&new));
            ways.insert(place, new);
        };
        for (order, mut way) in Self::all(settings, speeds, &from, &to).enumerate() {
            way.seconds = way.bound(speeds, &ends);
            insert(&mut ways, (way, Timed::Bound, order));
        }
        // Each step finds the time of the quickest candidate by the next, more costly method. Its
        // time can only grow, so it is inserted again at its new place.
        while let Some((mut way, timed, order)) = ways.pop() {
            let timed = match timed {
                Timed::Bound if check.finds_blocked(&way, GLANCES) => continue,
                Timed::Bound => {
                    way.seconds = way.least_seconds(speeds, &from, &to);
                    Timed::Joints
                }
                Timed::Joints => {
                    way.seconds = way.seconds.max(way.motor_seconds(cell, speeds, &ends));
                    Timed::Motors
                }
                Timed::Motors if check.finds_blocked(&way, usize::MAX) => continue,
                Timed::Motors => return Some(way),
            };
            insert(&mut ways, (way, timed, order));
        }
        None
    }

    /// Returns a lower bound of the time of this path (s), from each joint's motion across and the
    /// stroke of the track, taken alone.
    fn bound(&self, speeds: &Speeds, Ends { from, to, .. }: &Ends) -> f64 {
        let profile = Profile { ramp: self.ramp };
        let least = |distance: f64, axis: usize, window: f64| {
            let (speed, acceleration) = (speeds.joint[axis], speeds.joint_acceleration[axis]);
            // If the path took 1 s, the motion would need these multiples of its limits. In a time
            // T speeds fall with 1/T and accelerations with 1/T^2, so the multiple of the speed and
            // the root of that of the acceleration are the times (s) that keep the limits.
            let by_speed = profile.fraction(distance, speed, f64::INFINITY, window);
            by_speed.max(profile.fraction(distance, f64::INFINITY, acceleration, window).sqrt())
        };
        let stroke =
            if self.separation > 0.0 { least(self.separation, 0, self.stroke) } else { 0.0 };
        let across = (0..2).flat_map(|arm| (1..ROLL).map(move |axis| (arm, axis)));
        let across = across.map(|(arm, axis): (usize, usize)| {
            least(to[arm].0[axis] - from[arm].0[axis], axis, 1.0 - 2.0 * self.across)
        });
        across.fold(stroke, f64::max) * MISSED
    }

    /// Returns the least time in which the motors of both arms can follow this path (s).
    fn motor_seconds(&self, cell: &Cell, speeds: &Speeds, Ends { from, to, .. }: &Ends) -> f64 {
        let legs = self.legs(speeds, from, to);
        let seconds = |arm: usize| {
            let model = &cell.arms[arm].model;
            let turn = farthest_turn(model, &from[arm], |part| legs[arm].at(&from[arm], part));
            turn * f64::from(MOMENTS) / (MOTORS * model.motor_speed_limit)
        };
        seconds(0).max(seconds(1))
    }

    /// Iterates over all candidate paths, beginning with those without a retraction of the track.
    fn all(
        settings: &ReachSettings,
        speeds: &Speeds,
        from: &[JointPositions; 2],
        to: &[JointPositions; 2],
    ) -> impl Iterator<Item = Self> {
        let across = from.iter().zip(to).map(|(from, to)| speeds.joints_seconds(from, to, 1.0));
        // The two ends may be equal. At least 0.1 s, so that no share of the whole is divided by 0.
        let across = across.fold(0.0, f64::max).max(0.1);
        let (speeds, most) = (*speeds, settings.separation);
        separations(most).flat_map(move |separation| {
            let mut drawn_back = JointPositions::default();
            drawn_back.0[0] = separation;
            let stroke = speeds.joints_seconds(&JointPositions::default(), &drawn_back, 1.0);
            OVERLAPS.into_iter().flat_map(move |overlap| {
                let at_once = overlap * stroke.min(0.5 * across);
                // Each stroke, at the beginning and at the end, adds the part of it that does not
                // overlap.
                let seconds = across + 2.0 * (stroke - at_once);
                RAMPS.map(|longer| Self {
                    separation,
                    stroke: stroke / seconds,
                    across: (stroke - at_once) / seconds,
                    ramp: longer * speeds.profile.ramp / seconds,
                    seconds,
                })
            })
        })
    }

    /// Returns the legs of both arms from the joint positions `from` to those of `to`. Windows and
    /// ramps are shares of the whole time.
    #[must_use]
    pub fn legs(
        &self,
        speeds: &Speeds,
        from: &[JointPositions; 2],
        to: &[JointPositions; 2],
    ) -> [Legs; 2] {
        let rolls = [0, 1].map(|arm: usize| to[arm].0[ROLL] - from[arm].0[ROLL]);
        // The roll has the whole time, so its ramp is the usual one, as a share of it.
        let roll = Profile { ramp: speeds.profile.ramp / self.seconds_with_rolls(speeds, rolls) };
        // The windows of retraction, motion across and advance. Both arms have the same ones, so
        // that they move evenly.
        let windows =
            [(0.0, self.stroke), (self.across, 1.0 - self.across), (1.0 - self.stroke, 1.0)];
        [0, 1].map(|arm: usize| {
            let drawn_back = |mut joints: JointPositions| {
                joints.0[0] -= if arm == 0 { self.separation } else { 0.0 };
                joints
            };
            let ends = [drawn_back(from[arm]), drawn_back(to[arm]), to[arm]];
            let leg = |i: usize| Leg { to: ends[i], window: windows[i] };
            Legs { legs: [0, 1, 2].map(leg), profile: Profile { ramp: self.ramp }, roll }
        })
    }

    /// Returns the time of the path (s) if the wrists also roll by these angles (rad).
    #[must_use]
    pub fn seconds_with_rolls(&self, speeds: &Speeds, rolls: [f64; 2]) -> f64 {
        let (speed, acceleration) = (speeds.joint[ROLL], speeds.joint_acceleration[ROLL]);
        let seconds = |roll: f64| speeds.profile.seconds(roll, speed, acceleration);
        rolls.into_iter().map(seconds).fold(self.seconds, f64::max)
    }

    /// Returns the least time in which the joints of both arms can follow this path at these speeds
    /// (s). The limits of the motors are left out.
    #[must_use]
    pub fn least_seconds(
        &self,
        speeds: &Speeds,
        from: &[JointPositions; 2],
        to: &[JointPositions; 2],
    ) -> f64 {
        let legs = self.legs(speeds, from, to);
        (0..2).map(|arm| speeds.legs_seconds(&from[arm], &legs[arm])).fold(0.0, f64::max)
    }
}

/// Method by which the time of a path was found, in the order of effort.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
enum Timed {
    /// Lower bound of each motion alone.
    Bound,
    /// Time that the joints need together; the motors may take longer.
    Joints,
    /// Time that joints and motors need: the time of the path.
    Motors,
}

/// Number of moments at which the clearance of a path is checked before the path is timed.
const GLANCES: usize = 3;

/// Check whether the arms keep the clearance on paths between two meetings. It begins with the
/// moments at which other paths were blocked.
struct FreeCheck<'a> {
    cell: &'a Cell,
    settings: &'a ReachSettings,
    speeds: &'a Speeds,
    ends: &'a Ends,
    /// All moments of a path, each as a number in 0..=[`MOMENTS`]. Those at which a path was
    /// blocked come first, the latest of them foremost.
    moments: Vec<u32>,
}

impl<'a> FreeCheck<'a> {
    /// Makes a check for paths between the joint positions of `ends`.
    fn new(
        cell: &'a Cell,
        settings: &'a ReachSettings,
        speeds: &'a Speeds,
        ends: &'a Ends,
    ) -> Self {
        // In long steps: neighbouring moments are blocked together, so a blocked path is found
        // soon.
        let moments = (0..=MOMENTS).map(|step| step * STRIDE % (MOMENTS + 1)).collect();
        Self { cell, settings, speeds, ends, moments }
    }

    /// Returns whether the arms are nearer than the clearance at one of the first `count` moments
    /// of the list. The first blocked moment moves to the front of the list.
    fn finds_blocked(&mut self, way: &MeetingPath, count: usize) -> bool {
        let legs = way.legs(self.speeds, &self.ends.from, &self.ends.to);
        let looks = self.moments.iter().take(count);
        let blocking = looks.copied().position(|moment| !self.is_free_at(&legs, moment));
        if let Some(place) = blocking {
            // Neighbouring candidates are mostly blocked at the same moment.
            self.moments[..=place].rotate_right(1);
        }
        blocking.is_some()
    }

    /// Returns whether the arms keep the clearance at a moment (0..=[`MOMENTS`]) of a path.
    fn is_free_at(&self, legs: &[Legs; 2], moment: u32) -> bool {
        let part = f64::from(moment) / f64::from(MOMENTS);
        let joints = [0, 1].map(|arm: usize| legs[arm].at(&self.ends.from[arm], part));
        clearance(self.cell, &joints, self.ends.newcomer) >= self.settings.clearance
    }
}

#[cfg(test)]
mod tests {
    use super::super::{MeetingTable, example_cell};
    use super::*;

    /// Returns the speeds that these tests assume for the arms.
    fn speeds() -> Speeds {
        Speeds {
            joint: [0.15, 2.6, 2.6, 2.6, 2.6, 2.6, 0.8],
            joint_acceleration: [0.8, 7.0, 7.0, 7.0, 7.0, 7.0, 7.0],
            linear: 0.3,
            linear_acceleration: 1.0,
            angular: 1.0,
            angular_acceleration: 2.0,
            profile: Profile { ramp: 0.35 },
        }
    }

    #[test]
    fn path_time_is_never_below_its_bound() {
        let (cell, settings, speeds) = (example_cell(), ReachSettings::default(), speeds());
        let table = MeetingTable::compute(&cell, &settings);
        let grasps: Vec<_> = table.grasps.iter().flatten().collect();
        let (mut ways, mut nearest) = (0, 0.0_f64);
        for (a, b) in grasps.iter().zip(&grasps[1..]) {
            let ends = Ends { from: a.short_of(0), to: b.short_of(0), newcomer: 0 };
            for way in MeetingPath::all(&settings, &speeds, &ends.from, &ends.to) {
                let least = way
                    .least_seconds(&speeds, &ends.from, &ends.to)
                    .max(way.motor_seconds(&cell, &speeds, &ends));
                let bound = way.bound(&speeds, &ends);
                assert!(bound <= least, "{bound}, {least} s: {way:?}");
                (ways, nearest) = (ways + 1, nearest.max(bound / least));
            }
        }
        assert!(ways > 1000 && nearest > 0.8, "bounds reach {nearest} of the time in {ways} paths");
    }

    /// Times every path in full, then returns the quickest one that is free.
    fn plain_quickest(cell: &Cell, settings: &ReachSettings, ends: &Ends) -> Option<MeetingPath> {
        let (speeds, mut ends) = (speeds(), *ends);
        for arm in 0..2 {
            ends.to[arm].0[ROLL] = ends.from[arm].0[ROLL];
        }
        let mut ways: Vec<MeetingPath> =
            MeetingPath::all(settings, &speeds, &ends.from, &ends.to).collect();
        for way in &mut ways {
            let by_joints = way.least_seconds(&speeds, &ends.from, &ends.to);
            way.seconds = by_joints.max(way.motor_seconds(cell, &speeds, &ends));
        }
        ways.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
        ways.into_iter().find(|way| {
            let looks = FreeCheck::new(cell, settings, &speeds, &ends);
            let legs = way.legs(&speeds, &ends.from, &ends.to);
            (0..=MOMENTS).all(|moment| looks.is_free_at(&legs, moment))
        })
    }

    #[test]
    fn quickest_path_equals_result_of_full_search() {
        let (cell, settings) = (example_cell(), ReachSettings::default());
        let table = MeetingTable::compute(&cell, &settings);
        let grasps: Vec<_> = table.grasps.iter().flatten().collect();
        for (i, (a, b)) in grasps.iter().zip(&grasps[1..]).enumerate() {
            let newcomer = i % 2;
            let ends = Ends { from: a.short_of(newcomer), to: b.short_of(newcomer), newcomer };

            let found = MeetingPath::quickest(&cell, &settings, &speeds(), &ends);

            assert_eq!(found, plain_quickest(&cell, &settings, &ends), "{i}");
        }
    }

    #[test]
    fn quickest_path_keeps_clearance_and_motor_limits() {
        let (cell, settings, speeds) = (example_cell(), ReachSettings::default(), speeds());
        let table = MeetingTable::compute(&cell, &settings);
        let grasps: Vec<_> = table.grasps.iter().flatten().collect();
        let (mut found, mut saved) = (0, 0.0);
        for (i, (a, b)) in grasps.iter().zip(&grasps[1..]).enumerate() {
            let newcomer = i % 2;
            let ends = Ends { from: a.short_of(newcomer), to: b.short_of(newcomer), newcomer };
            let Some(way) = MeetingPath::quickest(&cell, &settings, &speeds, &ends) else {
                continue;
            };
            found += 1;
            let Ends { from, to, .. } = ends;
            let legs = way.legs(&speeds, &from, &to);
            let rolls = [0, 1].map(|arm: usize| to[arm].0[ROLL] - from[arm].0[ROLL]);
            let seconds = way.seconds_with_rolls(&speeds, rolls);
            // Checked at more moments than the search does.
            let mut last = [0, 1].map(|arm: usize| cell.arms[arm].model.motors(&from[arm]));
            for moment in 1..=400 {
                let part = f64::from(moment) / 400.0;
                let joints = [0, 1].map(|arm: usize| legs[arm].at(&from[arm], part));
                let bodies =
                    [0, 1].map(|arm: usize| Bodies::of(&cell, &cell.arms[arm], &joints[arm]));
                let least = newcomer_apart(newcomer, &bodies[0], &bodies[1]);
                // Between those moments the arms may come 4 mm nearer.
                assert!(least > settings.clearance - 0.004, "{least} at {part}: {way:?}");
                for arm in 0..2 {
                    let model = &cell.arms[arm].model;
                    let here = model.motors(&joints[arm]);
                    for (axis, (now, before)) in here.0.iter().zip(last[arm].0).enumerate() {
                        let speed = (now - before).abs() * 400.0 / seconds;
                        assert!(speed < model.motor_speed_limit, "{axis}: {speed} at {part}");
                    }
                    last[arm] = here;
                }
            }
            assert_eq!([0, 1].map(|arm: usize| *legs[arm].end()), to);
            let across = (0..2).map(|arm| speeds.joints_seconds(&from[arm], &to[arm], 1.0));
            let mut back = JointPositions::default();
            back.0[0] = settings.separation;
            let stroke = speeds.joints_seconds(&JointPositions::default(), &back, 1.0);
            saved += across.fold(0.0, f64::max) + 2.0 * stroke - seconds;
        }
        assert!(found >= 10, "{found}");
        assert!(saved / f64::from(found) > 2.0, "mean of {saved} s over {found} paths");
    }
}
