//! The kernel of MP for the cube: acquire, identify, plan, turn, hand back or lay down.
//!
//! The mission is a procedure ([`crate::tasks::procedure`]): `mission` is its outermost loop, and
//! each file below it says one part in the order in which it happens.
//!
//! - in: the event that ends an action, the states of both arms
//! - out: the next action for the shell
//! - source: Zieliński et al. (2007), pp. 371-374
//!
//! | file | part |
//! |---|---|
//! | `take` | the cube is taken from the operator, or from the table |
//! | `read` | the six faces are read, decided and planned |
//! | `steps`, `regrasp`, `look`, `turn` | the steps of the plan |
//! | `inspect` | what the turns made of the cube is checked |
//! | `give_back` | the cube goes back |
//! | `mend`, `realign` | what becomes of a failure; a layer is brought back into line |
//! | `resume` | an earlier run is gone on with |
//! | `robot`, `actions` | what is known, and each motion |
//! | `shared`, `sight`, `questions`, `failure` | what is shown and noted, seen, asked, and what can fail |
//! | `assignment`, `station`, `turn_in_progress` | what is to be done, and how far it is |
//!
//! A file uses those after it only: `mod`, `mend`, `resume`, `realign`, `give_back`, `read`,
//! `steps`, the parts of a step with `take` and `questions`, `actions`, `robot`, the types.

mod actions;
mod assignment;
mod failure;
mod give_back;
mod inspect;
mod look;
mod mend;
mod questions;
mod read;
mod realign;
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

use super::settings::CubeSettings;
use super::think::{Conclusion, Thought};
use crate::tasks::procedure::{Port, Procedure};
use crate::tasks::{Action, Effort, Entry, Event, Finish, Picture, Readings, Task};
pub use assignment::{Assignment, Goal};
use failure::Failure;
use robot::Robot;
pub use shared::MissionLog;
use shared::{Doing, Shared};
use station::Station;

/// The kernel.
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
        // Where the cube is can be asked before anything happens.
        robot.publish(Doing::Nothing);
        Self { procedure: Procedure::new(port, mission(robot)) }
    }

    /// Returns where the cube is, as the controller believes.
    #[must_use]
    pub fn whereabouts(&self) -> String {
        self.procedure.port().state(|shared| shared.whereabouts.clone())
    }

    /// Returns facts for the summary.
    #[must_use]
    pub fn log(&self) -> MissionLog {
        self.procedure.port().state(|shared| shared.log.clone())
    }
}

/// Carries out the assignment, station by station, and mends what fails where that is possible.
async fn mission(mut robot: Robot) -> Finish {
    robot.read_arms();
    let mut next = begin(&mut robot).await;
    loop {
        next = match next {
            Ok(Station::Take) => take(&mut robot).await,
            Ok(Station::Read { phase }) => read_and_solve(&mut robot, phase).await,
            Ok(Station::Return) => give_back::solved(&mut robot).await.map(Station::Over),
            Ok(Station::Unsolved(why)) => {
                give_back::unsolved(&mut robot, why).await.map(Station::Over)
            }
            Ok(Station::Over(finish)) => return finish,
            Err(failure) => mend::mend(&mut robot, failure).await,
        };
    }
}

/// Returns the first station.
async fn begin(robot: &mut Robot) -> Result<Station, Failure> {
    match (robot.earlier.clone(), robot.goal) {
        (Some(last), _) => resume::take_stock(robot, last).await,
        (None, Goal::Solve | Goal::Acquire) => Ok(Station::Take),
        (None, Goal::FaceTurn(angle)) => turn::turn_face(robot, angle).await.map(Station::Over),
    }
}

/// Takes the cube, to solve it or to give it back at once.
async fn take(robot: &mut Robot) -> Result<Station, Failure> {
    take::acquire(robot).await?;
    let solves = robot.goal == Goal::Solve;
    Ok(if solves { Station::Read { phase: "identify" } } else { Station::Return })
}

/// Reads the cube, carries the plan out, and checks what became of the cube.
async fn read_and_solve(robot: &mut Robot, phase: &'static str) -> Result<Station, Failure> {
    robot.phase(phase).await?;
    let steps = read::read_and_plan(robot).await?;
    robot.phase("solve").await?;
    steps::carry_out(robot, &steps).await?;
    inspect::inspect(robot, false).await?;
    Ok(Station::Return)
}

impl Task for Mission {
    type Thought = Thought;
    type Conclusion = Conclusion;

    fn next(&mut self, event: Event<Conclusion>, readings: &Readings<'_>) -> Action<Thought> {
        self.procedure.port().state(|shared| {
            for (known, arm) in shared.arms.iter_mut().zip(readings.arms) {
                *known = *arm;
            }
        });
        self.procedure.next(event)
    }

    fn notes(&mut self) -> Vec<String> {
        self.procedure.port().state(|shared| std::mem::take(&mut shared.notes))
    }

    fn picture(&self) -> Option<Picture> {
        self.procedure.port().state(|shared| shared.picture.clone())
    }

    fn entry(&self) -> Option<Entry> {
        self.procedure.port().state(|shared| shared.entry.clone())
    }

    fn think(thought: Thought) -> (Conclusion, Effort) {
        super::think::think(&thought)
    }
}
