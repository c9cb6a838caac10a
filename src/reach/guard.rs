//! A guard over both arms: where they may stand, which ways they may go, and how fast near the operator's hand.
//!
//! - in: the believed cell, the joints of both arms, the ways that are asked for
//! - out: what would come too near to what; how much too fast a way is for the operator and for the
//!   motors
//! - the parts are those of the search for meetings (`bodies`). Fingers and cubes meet by design where both hands are at one
//!   cube: they are left out of what begins or ends there, and looked at in everything else. Meetings keep 20 mm,
//!   corrections are smaller than the rest: the guard never speaks in a sound run
//! - a person's hand: the arm that has no business there stays out of its zone whole, the other one with all but its hand

use super::bodies::{Bodies, at_the_cube, hands};
use super::motors::{MOMENTS, MOTORS, farthest_turn};
use crate::cell::Cell;
use crate::cube::Keeper;
use crate::generators::legs::Legs;
use crate::motion::JointPositions;
use crate::spatial::Pose;
use nalgebra::Point3;
use std::sync::Arc;

/// Least distance between the arms, and of a hand from its own arm (m).
const LEAST: f64 = 0.005;
/// Least height of upper arm, wrist, hand and cube above the table (m).
const ABOVE_TABLE: f64 = 0.005;
/// Least distance from the box in which the operator's hand may be of what has no business there
/// (m).
const OFF_ZONE: f64 = 0.005;
/// The arm that takes the cube out of the operator's hand, and gives it back.
const TAKER: usize = 0;
/// Jaws that hold a cube are as wide as it, give or take this much (m): a grasp that is askew, and
/// a calibration that is off.
const AS_A_CUBE: f64 = 0.006;
/// Places at which a way is looked at.
const STEPS: u32 = 24;
/// So near to where the operator's hand may be, an arm is slow (m).
const NEAR: f64 = 0.18;
/// By how much two bodies that are too near may come nearer (m): on a way that is asked for, and on
/// one that is watched. A hand that is turned out of a corner may dip first.
const ON_A_WAY: f64 = 1e-4;
const WATCHED: f64 = 2e-3;

/// Knows the cell as the controller believes it.
#[derive(Debug, Clone)]
pub struct Guard {
    /// Shared by its copies: one is made for each order.
    cell: Arc<Cell>,
    /// Largest speed near the operator's hand (m/s); nobody's hand is at a table.
    hand_speed: Option<f64>,
    /// The hands have no cube at which they are to meet.
    never_meet: bool,
    /// Which hands may hold a cube.
    hold: [bool; 2],
}

/// How far everything that is guarded is off what it must not meet (m); nothing of an arm that is
/// not there, or of which nobody knows how it stands.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Room {
    table: [Option<f64>; 2],
    own: [Option<f64>; 2],
    zone: [Option<f64>; 2],
    arms: Option<f64>,
    hands: Option<f64>,
}

impl Room {
    fn all(&self) -> [Option<f64>; 8] {
        let Self { table, own, zone, arms, hands } = *self;
        [table[0], table[1], own[0], own[1], zone[0], zone[1], arms, hands]
    }

    /// Of hands that meet as they are to: how fingers and cubes stand to each other does not count.
    #[must_use]
    pub fn meeting(self) -> Self {
        Self { hands: None, ..self }
    }

    /// Whether the hands are apart, as far as both are known.
    fn apart(&self) -> bool {
        self.hands.is_some_and(|hands| hands >= LEAST)
    }

    /// What must be kept from here on: what was once far enough stays so.
    #[must_use]
    pub fn or_more(&self, before: &Self) -> Self {
        let more = |now: Option<f64>, before: Option<f64>| {
            now.map(|now| before.map_or(now, |before| before.max(now)))
        };
        let both = |now: [Option<f64>; 2], before: [Option<f64>; 2]| {
            [more(now[0], before[0]), more(now[1], before[1])]
        };
        Self {
            table: both(self.table, before.table),
            own: both(self.own, before.own),
            zone: both(self.zone, before.zone),
            arms: more(self.arms, before.arms),
            hands: more(self.hands, before.hands),
        }
    }
}

/// What is too near to what, or too fast.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Near {
    /// The arms, one to the other.
    #[error("the arms come within {:.0} mm of each other", .0 * 1e3)]
    Arms(f64),
    /// Fingers or a cube to the other hand, which they are not to meet now.
    #[error("the hands come within {:.0} mm of each other", .0 * 1e3)]
    Hands(f64),
    /// An arm, or that part of it which has no business there, to where the operator's hand may be.
    #[error("the {arm} arm comes within {:.0} mm of the operator's zone", .distance * 1e3)]
    Zone {
        /// Its name.
        arm: String,
        /// (m)
        distance: f64,
    },
    /// A hand to its own arm.
    #[error("the hand of the {arm} arm comes within {:.0} mm of its own links", .distance * 1e3)]
    Own {
        /// Its name.
        arm: String,
        /// (m)
        distance: f64,
    },
    /// A hand to the table.
    #[error("the hand of the {arm} arm comes within {:.0} mm of the table", .height * 1e3)]
    Table {
        /// Its name.
        arm: String,
        /// (m)
        height: f64,
    },
    /// A hand is too fast where the operator's may be.
    #[error("the hand of the {arm} arm goes at {:.0} mm/s where the operator's may be", .speed * 1e3)]
    Hasty {
        /// Its name.
        arm: String,
        /// (m/s)
        speed: f64,
    },
}

/// What an arm is asked to do, as far as it moves the arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PlannedMotion {
    /// It stays, or moves by less than the guard keeps free.
    Stays,
    /// All joints evenly to there.
    Joints(JointPositions),
    /// In legs, evenly in their common time.
    Legs(Legs),
    /// The tool straight to `base_from_tool`; d0 stays.
    Line(Pose),
}

impl Guard {
    /// Of a cell, and the largest speed near the operator's hand (m/s).
    #[must_use]
    pub fn of(cell: &Cell, hand_speed: f64) -> Self {
        let hand_speed = (cell.keeper == Keeper::Person).then_some(hand_speed);
        Self { cell: Arc::new(cell.clone()), hand_speed, never_meet: false, hold: [true; 2] }
    }

    /// The same where hands that are apart stay apart: an operator who moves an arm by hand has no plan of meetings.
    #[must_use]
    pub fn by_hand(self) -> Self {
        Self { never_meet: true, ..self }
    }

    /// Looks from now on after cubes in hands whose jaws are open as wide as one, and where nobody
    /// knows how wide they are (m).
    pub fn holding(&mut self, openings: [Option<f64>; 2]) {
        let is_wide = |opening: f64| (opening - self.cell.cube.edge).abs() < AS_A_CUBE;
        self.hold = openings.map(|opening| opening.is_none_or(is_wide));
    }

    fn name(&self, arm: usize) -> String {
        self.cell.arms[arm].name.clone()
    }

    fn bodies(&self, arm: usize, joints: &JointPositions) -> Bodies {
        Bodies::of(&self.cell, &self.cell.arms[arm], joints)
    }

    /// How the arms stand, as far as it is known how.
    #[must_use]
    pub fn room(&self, joints: [Option<&JointPositions>; 2]) -> Room {
        let known = |i: usize| joints[i].filter(|_| i < self.cell.arms.len());
        let bodies = [0, 1].map(|i| known(i).map(|joints| self.bodies(i, joints)));
        let of =
            |measure: &dyn Fn(&Bodies) -> f64| bodies.each_ref().map(|b| b.as_ref().map(measure));
        let both = |measure: &dyn Fn(&Bodies, &Bodies) -> f64| match &bodies {
            [Some(first), Some(second)] => Some(measure(first, second)),
            _ => None,
        };
        let off = |i: usize| {
            let body = bodies[i].as_ref().filter(|_| self.hand_speed.is_some());
            body.map(|body| body.off(&self.cell.hand, i != TAKER))
        };
        Room {
            table: of(&|body| body.lowest() - self.cell.table_height),
            own: of(&Bodies::own),
            zone: [0, 1].map(off),
            arms: both(&at_the_cube),
            hands: both(&|a, b| hands(a, b, self.hold)),
        }
    }

    /// Whether arms that stood so may stand like this. What is too near already may be led out of there.
    ///
    /// # Errors
    /// What is too near and was not, or has come nearer.
    pub fn may(&self, before: &Room, now: &Room) -> Result<(), Near> {
        self.within(before, now, WATCHED)
    }

    fn within(&self, before: &Room, now: &Room, nearer: f64) -> Result<(), Near> {
        let least = [ABOVE_TABLE, ABOVE_TABLE, LEAST, LEAST, OFF_ZONE, OFF_ZONE, LEAST, LEAST];
        let pairs = before.all().into_iter().zip(now.all()).zip(least);
        let too_near = pairs.enumerate().find_map(|(which, ((before, now), least))| {
            let (before, now) = (before?, now?);
            (now < least.min(before - nearer)).then_some((which, now))
        });
        match too_near {
            None => Ok(()),
            Some((arm @ (0 | 1), height)) => Err(Near::Table { arm: self.name(arm), height }),
            Some((which @ (2 | 3), distance)) => {
                Err(Near::Own { arm: self.name(which - 2), distance })
            }
            Some((which @ (4 | 5), distance)) => {
                Err(Near::Zone { arm: self.name(which - 4), distance })
            }
            Some((6, distance)) => Err(Near::Arms(distance)),
            Some((_, distance)) => Err(Near::Hands(distance)),
        }
    }

    /// Whether arms that stand so may go their ways, all evenly in the same time. Where something is too near at the beginning,
    /// ways on which it comes no nearer are allowed: so that an operator can move an arm out of a corner.
    ///
    /// # Errors
    /// What comes too near on the way.
    pub fn ways(
        &self,
        from: [Option<&JointPositions>; 2],
        ways: [&PlannedMotion; 2],
    ) -> Result<(), Near> {
        let apart = self.keep_apart(from, ways);
        let as_meant = |room: Room| if apart { room } else { room.meeting() };
        let before = as_meant(self.room(from));
        self.places(from, ways).try_for_each(|room| self.within(&before, &as_meant(room), ON_A_WAY))
    }

    /// Whether the hands are not to meet on ways of both arms: they are apart at the beginning and at the end, or have nothing to
    /// meet for.
    #[must_use]
    pub fn keep_apart(
        &self,
        from: [Option<&JointPositions>; 2],
        ways: [&PlannedMotion; 2],
    ) -> bool {
        let begin = self.room(from);
        let ends_apart = || self.places(from, ways).last().is_some_and(|end| end.apart());
        self.never_meet && begin.hands.is_some() || begin.apart() && ends_apart()
    }

    /// How the arms stand on their ways, all evenly in the same time.
    fn places(
        &self,
        from: [Option<&JointPositions>; 2],
        ways: [&PlannedMotion; 2],
    ) -> impl Iterator<Item = Room> {
        let mut at = [0, 1].map(|i: usize| from[i].map(|from| self.course(i, from, ways[i])));
        (1..=STEPS).map(move |step| {
            let part = f64::from(step) / f64::from(STEPS);
            let there = at.each_mut().map(|course| course.as_mut().map(|course| course.at(part)));
            self.room([there[0].as_ref(), there[1].as_ref()])
        })
    }

    /// Returns the course of an arm from where it stands along its way.
    #[must_use]
    pub fn course(&self, arm: usize, from: &JointPositions, way: &PlannedMotion) -> Course<'_> {
        let of = &self.cell.arms[arm];
        let tool = of.model.base_from_flange(from) * of.flange_from_tool;
        Course { guard: self, arm, from: *from, way: *way, last: *from, tool }
    }

    /// Whether an arm that has gone from one place to another in so many seconds was slow enough for where it is.
    ///
    /// # Errors
    /// How fast it went, where it went more than a fifth too fast.
    pub fn pace(
        &self,
        arm: usize,
        from: &JointPositions,
        to: &JointPositions,
        seconds: f64,
    ) -> Result<(), Near> {
        let Some(allowed) = self.hand_speed.filter(|_| seconds > 0.0) else { return Ok(()) };
        match self.near_hand(&self.bodies(arm, from), &self.bodies(arm, to)) {
            Some(way) if way > 1.2 * allowed * seconds => {
                Err(Near::Hasty { arm: self.name(arm), speed: way / seconds })
            }
            _ => Ok(()),
        }
    }

    /// The longest way of a part of a hand, if one is near to where the operator's may be (m).
    fn near_hand(&self, from: &Bodies, to: &Bodies) -> Option<f64> {
        let zone = &self.cell.hand;
        let zone_from_world = zone.world_from_cube.inverse();
        let off = |at: &Point3<f64>| zone.off(&(zone_from_world * at));
        let parts = from.hand().into_iter().zip(to.hand());
        let near = parts.clone().any(|((a, radius), (b, _))| off(&a).min(off(&b)) < radius + NEAR);
        near.then(|| parts.map(|((a, _), (b, _))| (b - a).norm()).fold(0.0, f64::max))
    }
}

/// The course of an arm along its way.
#[derive(Debug)]
pub struct Course<'a> {
    guard: &'a Guard,
    arm: usize,
    from: JointPositions,
    way: PlannedMotion,
    /// Where it was seen last.
    last: JointPositions,
    /// `base_from_tool` at the beginning.
    tool: Pose,
}

impl Course<'_> {
    /// Returns how many times too fast the arm is where the operator's hand may be, if its way
    /// takes `seconds` and it has gone `share` of the way after a share of that time: 1 or less
    /// where it is slow enough.
    #[must_use]
    pub fn haste(mut self, seconds: f64, share: impl Fn(f64) -> f64) -> f64 {
        let (guard, arm) = (self.guard, self.arm);
        let Some(allowed) = guard.hand_speed else { return 0.0 };
        let step = seconds / f64::from(MOMENTS);
        let mut last = guard.bodies(arm, &self.from);
        (1..=MOMENTS)
            .map(|moment| {
                let here =
                    guard.bodies(arm, &self.at(share(f64::from(moment) / f64::from(MOMENTS))));
                let speed = guard.near_hand(&last, &here).map_or(0.0, |way| way / step);
                last = here;
                speed / allowed
            })
            .fold(0.0, f64::max)
    }

    /// Returns how many times too fast the fastest motor of the arm is, if its way takes `seconds`
    /// and it has gone `share` of the way after a share of that time: 1 or less where all are slow
    /// enough.
    #[must_use]
    pub fn rush(mut self, seconds: f64, share: impl Fn(f64) -> f64) -> f64 {
        let (model, from) = (&self.guard.cell.arms[self.arm].model, self.from);
        let allowed = MOTORS * model.motor_speed_limit * seconds / f64::from(MOMENTS);
        farthest_turn(model, &from, |part| self.at(share(part))) / allowed
    }

    /// Returns the shares of the way until which, and from which on, a part of the hand is near to
    /// where the operator's may be: (0, 1) where it is so at neither end.
    #[must_use]
    pub fn near_ends(mut self) -> (f64, f64) {
        let (guard, arm) = (self.guard, self.arm);
        let share = |moment: u32| f64::from(moment) / f64::from(MOMENTS);
        let near: Vec<bool> = (0..=MOMENTS)
            .map(|moment| {
                let here = guard.bodies(arm, &self.at(share(moment)));
                guard.near_hand(&here, &here).is_some()
            })
            .collect();
        let begin = near.iter().take_while(|near| **near).count() as u32;
        let end = near.iter().rev().take_while(|near| **near).count() as u32;
        // A step more, since nobody looked in between.
        let until = if begin == 0 { 0.0 } else { share(begin.min(MOMENTS)) };
        (until, if end == 0 { 1.0 } else { 1.0 - share(end.min(MOMENTS)) })
    }

    /// Returns the joint positions after a share of the way. Where a line leaves the arm's reach,
    /// the arm stays at the last place within: its servo refuses the rest.
    fn at(&mut self, part: f64) -> JointPositions {
        self.last = match self.way {
            PlannedMotion::Stays => self.from,
            PlannedMotion::Joints(to) => self.from.towards(&to, part),
            PlannedMotion::Legs(legs) => legs.at(&self.from, part),
            PlannedMotion::Line(to) => {
                let arm = &self.guard.cell.arms[self.arm];
                let tool = Pose::from_parts(
                    self.tool.translation.vector.lerp(&to.translation.vector, part).into(),
                    self.tool.rotation.slerp(&to.rotation, part),
                );
                let flange = tool * arm.flange_from_tool.inverse();
                arm.model.inverse(&flange, &self.last).unwrap_or(self.last)
            }
        };
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::super::{MeetingTable, ReachSettings, example_cell};
    use super::*;

    #[test]
    fn every_meeting_is_allowed_and_an_arm_in_the_other_or_in_the_table_is_not() {
        let cell = example_cell();
        let guard = Guard::of(&cell, 0.25);
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let meetings = table.grasps.iter().flatten().chain(table.views.iter().flatten().flatten());
        let (mut refused, mut into, mut on_and_on) = (0, 0, 0);
        for meeting in meetings {
            // The hands are at one cube.
            let room = |stand: [Option<&JointPositions>; 2]| guard.room(stand).meeting();
            let free = room([Some(&meeting.track), Some(&meeting.postument)]);
            assert_eq!(guard.may(&free, &free), Ok(()));
            let mut low = meeting.postument;
            low.0[2] += 0.9;
            let met = |track: &JointPositions, postument: &JointPositions| {
                guard.may(&free, &room([Some(track), Some(postument)])).is_err()
            };
            assert!(met(&meeting.track, &low));
            let nearer = |by: u32| {
                let mut near = meeting.track;
                near.0[0] += 0.05 * f64::from(by);
                near
            };
            let meets = |track: &JointPositions| met(track, &meeting.postument);
            let Some(near) = (1..=20).map(nearer).find(meets) else { continue };
            refused += 1;

            // The way there is refused where it comes too near, the way out of there is not.
            let ends = [&meeting.track, &near].map(|track| [Some(track), Some(&meeting.postument)]);
            let to = |ends: [Option<&JointPositions>; 2]| {
                ends.map(|to| PlannedMotion::Joints(*to.unwrap()))
            };
            assert!(guard.ways(ends[0], to(ends[1]).each_ref()).is_err());
            // Fingers and cubes that are apart on both sides may be too near on a straight way.
            let out = guard.ways(ends[1], to(ends[0]).each_ref());
            assert!(matches!(out, Ok(()) | Err(Near::Hands(_))), "{out:?}");

            // Nor may it go on, or the other hand into the table, only since something is too near already.
            let mut on = near;
            on.0[0] += 0.02;
            let on = [Some(&on), Some(&meeting.postument)];
            let nears = room(on).arms < room(ends[1]).arms;
            let further = guard.ways(ends[1], to(on).each_ref());
            assert!(further.is_err() == nears || matches!(further, Err(Near::Hands(_))));
            assert_eq!(guard.may(&room(ends[1]), &room(on)).is_err(), nears);
            on_and_on += usize::from(nears);
            assert!(
                guard.ways(ends[1], [&PlannedMotion::Stays, &PlannedMotion::Joints(low)]).is_err()
            );
            // Of one arm alone the table and its own links are looked at.
            assert!(
                guard
                    .ways([None, ends[0][1]], [&PlannedMotion::Stays, &PlannedMotion::Joints(low)])
                    .is_err()
            );
            assert_eq!(
                guard.ways([None, ends[0][1]], [&PlannedMotion::Stays, &PlannedMotion::Stays]),
                Ok(())
            );

            // A line is looked at by where it leads, too.
            let track = &cell.arms[0];
            let tool = |joints| track.model.base_from_flange(joints) * track.flange_from_tool;
            let there =
                PlannedMotion::Line(tool(&meeting.track) * Pose::translation(0.0, 0.0, 0.1));
            let back =
                PlannedMotion::Line(tool(&meeting.track) * Pose::translation(0.0, 0.0, -0.05));
            into += usize::from(guard.ways(ends[0], [&there, &PlannedMotion::Stays]).is_err());
            let out = guard.ways(ends[0], [&back, &PlannedMotion::Stays]);
            assert!(matches!(out, Ok(()) | Err(Near::Hands(_))), "{out:?}");
        }
        // Hands that look past each other may go by each other.
        assert!(refused >= 16, "{refused}");
        assert!(into >= refused / 2, "{into} of {refused}");
        assert!(on_and_on >= refused / 2, "{on_and_on} of {refused}");
    }

    #[test]
    fn hands_that_begin_and_end_apart_do_not_meet_in_between_and_those_that_are_to_meet_may() {
        let cell = example_cell();
        let guard = Guard::of(&cell, 0.25);
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let (mut met, mut passed) = (0, 0);
        for meeting in table.grasps.iter().flatten() {
            let along = |by: f64| {
                let mut track = meeting.track;
                track.0[0] += by;
                track
            };
            let stands = |track| [Some(track), Some(&meeting.postument)];
            let (before, behind) = (along(-0.3), along(0.3));
            let (back, to) = (&meeting.track_back, PlannedMotion::Joints(meeting.track));
            assert!(!guard.keep_apart(stands(back), [&to, &PlannedMotion::Stays]));
            assert_eq!(
                guard.ways(stands(back), [&to, &PlannedMotion::Stays]),
                Ok(()),
                "they are to meet"
            );
            met += 1;

            // By hand nobody leads them there.
            if guard.room(stands(back)).apart() {
                let by_hand =
                    guard.clone().by_hand().ways(stands(back), [&to, &PlannedMotion::Stays]);
                assert!(matches!(by_hand, Err(Near::Hands(_))), "{by_hand:?}");
            }

            let past = PlannedMotion::Joints(behind);
            if !guard.keep_apart(stands(&before), [&past, &PlannedMotion::Stays]) {
                continue;
            }
            let way = guard.ways(stands(&before), [&past, &PlannedMotion::Stays]);
            assert!(way.is_err(), "through the other hand");
            passed += usize::from(matches!(way, Err(Near::Hands(_))));
            // So may they not be while they are watched, unless they are to meet.
            let (far, near) = (guard.room(stands(&before)), guard.room(stands(&meeting.track)));
            assert!(matches!(guard.may(&far, &near), Err(Near::Hands(_))));
            assert_eq!(guard.may(&far.meeting(), &near.meeting()), Ok(()));
        }
        assert!(met >= 12 && passed >= 4, "{met} {passed}");
    }

    #[test]
    fn a_hand_may_hold_a_cube_where_its_jaws_are_as_wide_as_one_or_nobody_knows_how_wide() {
        let cell = example_cell();
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let edge = cell.cube.edge;
        let mut told_apart = 0;
        for meeting in table.grasps.iter().flatten() {
            let apart = |openings: [Option<f64>; 2]| {
                let mut guard = Guard::of(&cell, 0.25);
                guard.holding(openings);
                guard.room([Some(&meeting.track_back), Some(&meeting.postument)]).hands.unwrap()
            };
            let (held, empty) = (apart([Some(edge); 2]), apart([Some(0.0); 2]));
            told_apart += usize::from(held < empty);
            // A calibration may be off, a grasp askew.
            for wide in [None, Some(edge - 0.005), Some(edge + 0.005)] {
                assert_eq!(apart([wide; 2]), held, "{wide:?}");
            }
            for wide in [edge - 0.007, edge + 0.007, 0.09] {
                assert_eq!(apart([Some(wide); 2]), empty, "{wide}");
            }
            // The jaws may have opened or closed since they were looked at last.
            let mut guard = Guard::of(&cell, 0.25);
            guard.holding([Some(0.0); 2]);
            guard.holding([None; 2]);
            let room = guard.room([Some(&meeting.track_back), Some(&meeting.postument)]);
            assert_eq!(room.hands, Some(held));
        }
        assert!(told_apart >= 4, "{told_apart}");
    }

    #[test]
    fn who_was_led_out_stays_out_and_who_is_too_near_may_dip_by_a_hair() {
        let guard = Guard::of(&example_cell(), 0.25);
        let above = |height: f64| Room { table: [Some(height), None], ..Room::default() };

        assert_eq!(above(0.05).or_more(&above(0.01)), above(0.05));
        assert_eq!(above(0.01).or_more(&above(0.05)), above(0.05));
        // Of what is not known any more nothing is kept, and what is known for the first time is where it is.
        assert_eq!(Room::default().or_more(&above(0.05)), Room::default());
        assert_eq!(above(0.01).or_more(&Room::default()), above(0.01));

        assert!(guard.may(&above(0.05), &above(0.004)).is_err());
        // Watched, a hand may dip when it is turned out of a corner.
        assert_eq!(guard.may(&above(0.004), &above(0.0025)), Ok(()));
        assert!(guard.may(&above(0.004), &above(0.0015)).is_err());
    }

    #[test]
    fn a_way_that_is_asked_for_leads_no_nearer_to_what_is_too_near() {
        let cell = example_cell();
        let guard = Guard::of(&cell, 0.25);
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let mut low = table.grasps.iter().flatten().next().unwrap().postument;
        low.0[2] += 0.9;
        let height = |joints: &JointPositions| guard.room([None, Some(joints)]).table[1].unwrap();
        assert!(height(&low) < ABOVE_TABLE);
        let lower = |by: u32| {
            let mut lower = low;
            lower.0[2] += 1e-4 * f64::from(by);
            lower
        };

        let by = (1..100).find(|by| height(&low) - height(&lower(*by)) > 1e-3).unwrap();
        let (from, to) = ([None, Some(&low)], lower(by));

        assert!(height(&low) - height(&to) < WATCHED);
        let asked = guard.ways(from, [&PlannedMotion::Stays, &PlannedMotion::Joints(to)]);
        assert!(matches!(asked, Err(Near::Table { .. })), "{asked:?}");
        assert_eq!(guard.may(&guard.room(from), &guard.room([None, Some(&to)])), Ok(()));
        // Nor where only its end is too low.
        let above = table.grasps.iter().flatten().next().unwrap().postument;
        let down =
            guard.ways([None, Some(&above)], [&PlannedMotion::Stays, &PlannedMotion::Joints(low)]);
        assert!(matches!(down, Err(Near::Table { .. })), "{down:?}");
    }

    #[test]
    fn a_line_leads_to_where_its_tool_is_turned_too() {
        let cell = example_cell();
        let guard = Guard::of(&cell, 0.25);
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let arm = &cell.arms[0];
        let tool =
            |joints: &JointPositions| arm.model.base_from_flange(joints) * arm.flange_from_tool;
        let mut led = 0;
        for meeting in table.grasps.iter().flatten() {
            for by in [-0.3, 0.3] {
                let turn =
                    nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), by);
                let to = tool(&meeting.track) * turn;
                let flange = to * arm.flange_from_tool.inverse();
                if arm.model.inverse(&flange, &meeting.track).is_err() {
                    continue;
                }

                let end = guard.course(0, &meeting.track, &PlannedMotion::Line(to)).at(1.0);

                assert!(tool(&end).rotation.angle_to(&to.rotation) < 1e-6);
                led += 1;
            }
        }
        assert!(led >= 8, "{led}");
    }

    #[test]
    fn nothing_but_the_hand_that_takes_the_cube_has_any_business_in_the_operators_zone() {
        let cell = example_cell();
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let meeting = table.grasps.iter().flatten().next().unwrap();
        let stands = [Some(&meeting.track), Some(&meeting.postument)];
        let mut turned = [meeting.track, meeting.postument];
        // Aside by the waist, and back again.
        turned[0].0[1] += 0.6;
        turned[1].0[1] += 0.6;
        let went = |arm: usize, at: Point3<f64>, keeper: Keeper| {
            let mut cell = cell.clone();
            cell.hand.world_from_cube = Pose::translation(at.x, at.y, at.z);
            cell.hand.half_extent = nalgebra::Vector3::repeat(0.03);
            cell.keeper = keeper;
            let guard = Guard::of(&cell, 0.25);
            let mut from = stands;
            from[arm] = Some(&turned[arm]);
            let back = PlannedMotion::Joints(*stands[arm].unwrap());
            let ways = if arm == 0 {
                [&back, &PlannedMotion::Stays]
            } else {
                [&PlannedMotion::Stays, &back]
            };
            let asked = guard.ways(from, ways);
            let watched = guard.may(&guard.room(from).meeting(), &guard.room(stands).meeting());
            assert_eq!(asked.is_err(), watched.is_err(), "{asked:?} {watched:?}");
            asked
        };
        let points = |arm: usize| {
            let of = &cell.arms[arm];
            of.model.points(stands[arm].unwrap()).map(|p| of.world_from_base * p)
        };
        let refused =
            |way: Result<(), Near>| way.is_err_and(|near| near.to_string().contains("zone"));

        let forearm = |arm: usize| nalgebra::center(&points(arm)[2], &points(arm)[3]);
        // Forearm and hand of the arm that has no business there; the forearm of the one that has.
        assert!(refused(went(1, forearm(1), Keeper::Person)));
        assert!(refused(went(1, points(1)[4], Keeper::Person)));
        assert!(refused(went(0, forearm(0), Keeper::Person)));
        assert_eq!(went(0, points(0)[4], Keeper::Person), Ok(()), "its hand takes the cube");
        // Nobody's hand is at a table.
        assert_eq!(went(1, points(1)[4], Keeper::Table), Ok(()));
    }

    #[test]
    fn a_way_is_too_fast_only_near_the_operator_and_only_when_it_is() {
        let cell = example_cell();
        let guard = Guard::of(&cell, 0.25);
        let arm = &cell.arms[0];
        // Before the hand-over place, approaching along +x.
        let rotation =
            nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::y_axis(), 1.571);
        let standing = |x: f64| {
            let centre = cell.hand.world_from_cube.translation.vector;
            let tool = Pose::from_parts((centre - nalgebra::Vector3::x() * x).into(), rotation);
            let flange = arm.world_from_base.inverse() * tool * arm.flange_from_tool.inverse();
            let stance = JointPositions([0.4, 0.0, -1.6, 0.3, 1.3, 1.57, 0.0]);
            (arm.model.inverse(&flange, &stance).unwrap(), arm.world_from_base.inverse() * tool)
        };
        let ((far, _), (near, at)) = (standing(0.25), standing(0.05));
        let even = |u: f64| u;

        // 0.2 m: in 1.2 s slow enough, in 0.6 s not.
        for way in [PlannedMotion::Line(at), PlannedMotion::Joints(near)] {
            let slow = guard.course(0, &far, &way).haste(1.2, even);
            let fast = guard.course(0, &far, &way).haste(0.6, even);
            assert!(slow > 0.5 && slow <= 1.0, "{slow}");
            assert!((fast / slow - 2.0).abs() < 1e-9, "{fast} {slow}");
        }
        assert!(guard.pace(0, &far, &near, 1.2).is_ok());
        let told = guard.pace(0, &far, &near, 0.4).unwrap_err().to_string();
        assert!(told.contains("track arm goes at 5") && told.contains("mm/s"), "{told}");
        // A part is as near as its surface, however far off its middle is.
        let (bodies, mut aside) = (guard.bodies(0, &near), cell.clone());
        let nearest = |cell: &Cell, counts: f64| {
            let zone_from_world = cell.hand.world_from_cube.inverse();
            let off = bodies
                .hand()
                .map(|(at, radius)| cell.hand.off(&(zone_from_world * at)) - counts * radius);
            off.into_iter().fold(f64::INFINITY, f64::min)
        };
        while nearest(&aside, 0.0) < 1.1 * NEAR {
            aside.hand.world_from_cube.translation.vector.z += 0.001;
        }
        assert!(nearest(&aside, 1.0) < 0.9 * NEAR);
        let mut moved = near;
        moved.0[6] += 0.5;
        moved.0[5] += 0.1;
        assert!(Guard::of(&aside, 0.25).pace(0, &near, &moved, 0.01).is_err());
        // As fast where nobody is.
        let mut elsewhere = cell.clone();
        elsewhere.hand.world_from_cube.translation.vector.x += 1.0;
        for cell in [elsewhere, Cell { keeper: Keeper::Table, ..cell.clone() }] {
            let guard = Guard::of(&cell, 0.25);
            let course = guard.course(0, &far, &PlannedMotion::Line(at));
            assert_eq!(course.haste(0.2, even), 0.0);
            assert!(guard.pace(0, &far, &near, 0.1).is_ok());
        }
    }
}
