//! A guard over both arms: where they may stand, and which ways they may go.
//!
//! - in: the believed cell, the joints of both arms
//! - out: what would come too near to what
//! - the parts are those of the search for meetings (`bodies`); pairs that meet by design, hands at one cube,
//!   are left out. Meetings keep 20 mm, corrections are smaller than the rest: the guard never speaks in a sound run

use super::bodies::{Bodies, at_the_cube};
use crate::cell::Cell;
use crate::motion::JointPositions;

/// Least distance between the arms, and of a hand from its own arm [m].
const LEAST: f64 = 0.005;
/// Least height of wrist, hand and cube above the table [m].
const ABOVE_TABLE: f64 = 0.02;
/// Places at which a way is looked at.
const STEPS: u32 = 24;

/// Knows the cell as the controller believes it.
#[derive(Debug, Clone)]
pub struct Guard {
    cell: Cell,
}

/// What is too near to what.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Near {
    /// The arms, one to the other.
    #[error("the arms come within {:.0} mm of each other", .0 * 1e3)]
    Arms(f64),
    /// A hand to its own arm.
    #[error("the hand of arm {arm} comes within {:.0} mm of its own links", .distance * 1e3)]
    Own {
        /// Which, in the order of the cell.
        arm: usize,
        /// [m]
        distance: f64,
    },
    /// A hand to the table.
    #[error("the hand of arm {arm} comes within {:.0} mm of the table", .height * 1e3)]
    Table {
        /// Which, in the order of the cell.
        arm: usize,
        /// [m]
        height: f64,
    },
}

impl Guard {
    /// Of a cell with two arms; others have nothing to guard here.
    #[must_use]
    pub fn of(cell: &Cell) -> Option<Self> {
        (cell.arms.len() == 2).then(|| Self { cell: cell.clone() })
    }

    /// Whether both arms may stand so.
    ///
    /// # Errors
    /// What is too near.
    pub fn place(&self, joints: [&JointPositions; 2]) -> Result<(), Near> {
        let bodies = [0, 1].map(|i: usize| Bodies::of(&self.cell, &self.cell.arms[i], joints[i]));
        for (arm, body) in bodies.iter().enumerate() {
            let height = body.lowest() - self.cell.table_height;
            if height < ABOVE_TABLE {
                return Err(Near::Table { arm, height });
            }
            let distance = body.own();
            if distance < LEAST {
                return Err(Near::Own { arm, distance });
            }
        }
        let distance = at_the_cube(&bodies[0], &bodies[1]);
        if distance < LEAST { Err(Near::Arms(distance)) } else { Ok(()) }
    }

    /// Whether both arms may go evenly from one place to another.
    ///
    /// # Errors
    /// What comes too near on the way. Where it is too near at the beginning, whatever does not get nearer is allowed:
    /// so that an operator can move an arm out of a corner.
    pub fn way(&self, from: [&JointPositions; 2], to: [&JointPositions; 2]) -> Result<(), Near> {
        if self.place(from).is_err() {
            return Ok(());
        }
        (1..=STEPS).try_for_each(|step| {
            let part = f64::from(step) / f64::from(STEPS);
            let between = |i: usize| {
                let (a, b) = (&from[i].0, &to[i].0);
                JointPositions(std::array::from_fn(|j| a[j] + part * (b[j] - a[j])))
            };
            self.place([&between(0), &between(1)])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::{MeetingTable, ReachSettings, example_cell};
    use super::*;

    #[test]
    fn every_meeting_is_allowed_and_an_arm_in_the_other_or_in_the_table_is_not() {
        let cell = example_cell();
        let guard = Guard::of(&cell).unwrap();
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let meetings = table.grasps.iter().flatten().chain(table.views.iter().flatten().flatten());
        let mut refused = 0;
        for meeting in meetings {
            assert_eq!(guard.place([&meeting.track, &meeting.postument]), Ok(()));
            let mut low = meeting.postument;
            low.0[2] += 0.9;
            assert!(guard.place([&meeting.track, &low]).is_err());
            let nearer = |by: u32| {
                let mut near = meeting.track;
                near.0[0] += 0.05 * f64::from(by);
                near
            };
            let met = |track: &JointPositions| guard.place([track, &meeting.postument]).is_err();
            let Some(near) = (1..=20).map(nearer).find(met) else { continue };
            refused += 1;

            // The way there is refused where it comes too near, the way out of there is not.
            let ends = [[&meeting.track, &meeting.postument], [&near, &meeting.postument]];
            assert!(guard.way(ends[0], ends[1]).is_err());
            assert_eq!(guard.way(ends[1], ends[0]), Ok(()));
        }
        // Hands that look past each other may go by each other.
        assert!(refused >= 16, "{refused}");
    }
}
