//! Kernel of MP for the cube: acquires, reads, plans, turns, inspects, and hands back or lays down.
//!
//! The mission is a procedure ([`crate::kernel::procedure`]): `mission` is its outermost loop, and
//! each file below has one part of it, in the order of its actions.
//!
//! - in: the event that ends an action, the states of both arms
//! - out: the next action for the shell
//! - source: Zieliński et al. (2007), pp. 371-374
//!
//! | file | part |
//! |---|---|
//! | `take` | acquisition of the cube from the operator, or from the table |
//! | `read` | reading of the six faces, decision and plan |
//! | `steps`, `regrasp`, `look`, `turn` | steps of the plan |
//! | `inspect` | inspection of the cube after the turns |
//! | `give_back` | return of the cube |
//! | `recover`, `realign` | decisions after a failure; realignment of a layer |
//! | `resume` | resumption of an earlier run |
//! | `robot`, `actions` | state of the mission; its motions |
//! | `shared`, `sight` | state that others read; stickers that the cameras saw |
//! | `questions`, `failure` | questions to the operator; reasons to stop a procedure |
//! | `assignment`, `station`, `turn_in_progress` | goal, progress of the mission and of a turn |
//!
//! A file uses only files after it in this order: `mod`, `recover`, `resume`, `realign`,
//! `give_back`, `read`, `steps`, the parts of a step with `take` and `questions`, `actions`,
//! `robot`, the types.

mod actions;
mod assignment;
mod entry;
mod failure;
mod give_back;
mod inspect;
mod look;
mod questions;
mod read;
mod realign;
mod recover;
mod regrasp;
mod resume;
mod robot;
mod shared;
mod sight;
mod station;
mod steps;
mod take;
#[cfg(test)]
mod testing;
mod turn;
mod turn_in_progress;

use super::hold::Hand;
use super::settings::CubeSettings;
use super::think::{Conclusion, Thought};
use crate::kernel::procedure::{Port, Procedure};
use crate::kernel::{Account, Action, Event, Finish, Kernel, Picture, Readings, Remark};
use crate::motion::ArmState;
pub use assignment::{Assignment, Goal};
pub use entry::Entry;
use failure::Failure;
use robot::Robot;
pub use shared::MissionLog;
use shared::{Doing, Shared};
use station::Station;

/// Kernel of the cube task.
#[derive(Debug)]
pub struct Mission {
    procedure: Procedure<Thought, Conclusion, Shared>,
}

impl Mission {
    /// Makes a kernel that begins at the first event.
    #[must_use]
    pub fn new(settings: CubeSettings, assignment: Assignment) -> Self {
        let port = Port::new(Shared::default());
        let mut robot = Robot::new(port.clone(), settings, assignment);
        // A page may ask for the place of the cube before the first event.
        robot.publish(Doing::Nothing);
        Self { procedure: Procedure::new(port, mission(robot)) }
    }

    /// Returns the place of the cube, as the controller believes, in words.
    #[must_use]
    pub fn whereabouts(&self) -> String {
        self.procedure.port().state(|shared| shared.whereabouts.clone())
    }

    /// Corrects the account after an error has ended the run. `openings` are those of the jaws of
    /// both hands (m) once the arms are at rest. A hand whose jaws have closed farther than on the
    /// cube has lost it. Other jaws may have stopped with the arms, and prove nothing.
    fn correct(&mut self, openings: [f64; 2]) {
        self.procedure.port().state(|shared| {
            let lost = |hand: &Hand| {
                let least = shared.least_openings[hand.index()];
                least.is_some_and(|least| openings[hand.index()] < least)
            };
            let holders = Hand::BOTH.iter().filter(|h| shared.least_openings[h.index()].is_some());
            let (losers, left): (Vec<Hand>, Vec<Hand>) = holders.copied().partition(lost);
            let slipped = losers.iter().map(|hand| {
                format!("the cube has slipped out of the {} hand after the error", hand.name())
            });
            let slipped = slipped.collect::<Vec<_>>().join(", ");
            shared.whereabouts = match (losers.is_empty(), left.first()) {
                (true, _) => format!("as the controller believed then, {}", shared.whereabouts),
                (false, Some(other)) => format!("{slipped}; the {} hand had it too", other.name()),
                (false, None) => {
                    shared.log.drops += 1;
                    format!("{slipped}, and has fallen")
                }
            };
        });
    }

    /// Returns the facts of the mission for the summary of the run.
    #[must_use]
    pub fn log(&self) -> MissionLog {
        self.procedure.port().state(|shared| shared.log.clone())
    }
}

/// Carries out the assignment, station by station, and recovers from failures if possible.
async fn mission(mut robot: Robot) -> Finish {
    robot.read_arms();
    let mut next = begin(&mut robot).await;
    // Recovery from a failure may lead to any station, or to another failure. The loop ends at
    // `Over`.
    loop {
        next = match next {
            Ok(Station::Take) => take(&mut robot).await,
            Ok(Station::Read { phase }) => read_and_solve(&mut robot, phase).await,
            Ok(Station::Return) => give_back::solved(&mut robot).await.map(Station::Over),
            Ok(Station::Unsolved(why)) => {
                give_back::unsolved(&mut robot, why).await.map(Station::Over)
            }
            Ok(Station::Over(finish)) => return finish,
            Err(failure) => recover::recover(&mut robot, failure).await,
        };
    }
}

/// Returns the station at which the mission begins.
async fn begin(robot: &mut Robot) -> Result<Station, Failure> {
    match (robot.earlier.clone(), robot.goal) {
        (Some(last), _) => resume::take_stock(robot, last).await,
        (None, Goal::Solve | Goal::Acquire) => Ok(Station::Take),
        (None, Goal::FaceTurn(angle)) => turn::turn_face(robot, angle).await.map(Station::Over),
    }
}

/// Takes the cube, and returns the next station: the reading of its faces, or its return if the
/// goal is only to acquire it.
async fn take(robot: &mut Robot) -> Result<Station, Failure> {
    take::acquire(robot).await?;
    let solves = robot.goal == Goal::Solve;
    Ok(if solves { Station::Read { phase: "identify" } } else { Station::Return })
}

/// Reads the cube, carries out the plan, and inspects the result. `phase` names the reading.
async fn read_and_solve(robot: &mut Robot, phase: &'static str) -> Result<Station, Failure> {
    robot.phase(phase).await?;
    let steps = read::read_and_plan(robot).await?;
    robot.phase("solve").await?;
    steps::carry_out(robot, &steps).await?;
    inspect::inspect(robot, false).await?;
    Ok(Station::Return)
}

impl Kernel for Mission {
    type Thought = Thought;
    type Entry = Entry;

    fn next(&mut self, event: Event<Conclusion>, readings: &Readings<'_>) -> Action<Thought> {
        self.procedure.port().state(|shared| {
            for (known, arm) in shared.arms.iter_mut().zip(readings.arms) {
                *known = *arm;
            }
        });
        self.procedure.resume(event)
    }

    fn notes(&mut self) -> Vec<Remark> {
        let notes = self.procedure.port().state(|shared| std::mem::take(&mut shared.notes));
        notes.into_iter().map(Remark::Deviation).collect()
    }

    fn picture(&self) -> Option<Picture> {
        self.procedure.port().state(|shared| shared.picture.clone())
    }

    fn entry(&self) -> Option<Entry> {
        self.procedure.port().state(|shared| shared.entry.clone())
    }

    fn account(&self) -> Account {
        let (whereabouts, log) = (self.whereabouts(), self.log());
        Account { whereabouts, figures: log.figures(), ..Account::default() }
    }

    fn look_back(&mut self, arms: &[ArmState]) {
        let opening = |i: usize| arms.get(i).map_or(f64::INFINITY, |arm| arm.jaw_opening);
        self.correct([opening(0), opening(1)]);
    }
}

#[cfg(test)]
mod tests {
    use super::testing::{Stage, settings};
    use super::*;

    /// Returns place and falls of the cube in the account of a mission that an error ended while
    /// the track hand held the cube, its jaws 57 mm open, if they are `opening` open later (m).
    fn after_error(opening: f64) -> (String, u32) {
        let mut mission = Mission::new(settings(), Assignment::new(Goal::Solve));
        let mut stage = Stage::holding(settings());
        stage.robot.publish(Doing::Nothing);
        let published = stage.port.state(std::mem::take);
        mission.procedure.port().state(|shared| *shared = published);

        mission.correct([opening, 0.09]);

        (mission.whereabouts(), mission.log().drops)
    }

    #[test]
    fn jaws_that_closed_after_error_lost_the_cube() {
        // The pads give by 1.2 mm at most.
        let (held, none) = after_error(0.0559);
        let (fallen, one) = after_error(0.0557);

        assert_eq!(held, "as the controller believed then, the track hand holds the cube");
        assert!(fallen.contains("slipped out of the track hand after the error, and has fallen"));
        assert_eq!((none, one), (0, 1));
    }
}
