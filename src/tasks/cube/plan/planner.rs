//! The planner of a cell: solver and regrasps together.
//!
//! - in: a cube, who holds it, the solver's tables, how much may be searched
//! - out: the plan of least time over all solutions that were found on the way
//!
//! The shortest solution is seldom the one that two hands make in the least time, so every solution that the two-phase
//! search meets, up to three turns longer than the shortest, is tried for its grasps; a try ends as soon as it costs more
//! than the best plan so far.

use super::super::hold::{Grip, Hand, Hold, Step, hands_after};
use super::super::identify::{self, Wanted};
use super::super::settings::CubeSettings;
use super::terms::{Rule, Terms};
use super::travel::Reachable;
use super::{NoPlan, Plan};
use crate::cube::{Axis, Cube, Face, Turn};
use crate::motion::Depth;
use crate::solver::{self, Budget, Tables};

/// What two arms of a cell may do with a cube, and what it costs them.
#[derive(Debug, Clone)]
pub struct Planner {
    reach: Reachable,
    terms: Terms,
}

/// How much is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Nodes of the two-phase search.
    pub nodes: u64,
    /// Solutions that are tried.
    pub candidates: usize,
}

/// The hold in which the track arm takes the cube from the operator.
#[must_use]
pub fn taken() -> (Hand, Grip) {
    let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
    (Hand::Track, Grip { hold, half_roll: false })
}

impl Planner {
    /// Of the cell and the manners that the task was told.
    #[must_use]
    pub fn new(settings: &CubeSettings) -> Self {
        Self {
            reach: Reachable::new(settings.meetings.clone(), &settings.speeds),
            terms: settings.terms(),
        }
    }

    /// The same arms by another rule.
    #[must_use]
    pub fn by_rule(&self, rule: Rule) -> Self {
        let Terms { finish_depths, costs, .. } = self.terms;
        let terms = Terms { finish_depths, costs, ..Terms::of(rule) };
        Self { terms, ..self.clone() }
    }

    /// The rule.
    #[must_use]
    pub fn rule(&self) -> Rule {
        self.terms.rule
    }

    /// The looks at all six faces, and who holds the cube after them, in the frame of the start.
    ///
    /// # Errors
    /// When not all faces can be shown.
    pub fn looks(&self, start: (Hand, Grip)) -> Result<(Vec<Step>, (Hand, Grip)), NoPlan> {
        let steps = self.looks_at(start, &Wanted::default())?;
        let mut hands = [None; 2];
        hands[start.0.index()] = Some(start.1);
        let hands = steps.iter().fold(hands, hands_after);
        let holder = [Hand::Track, Hand::Postument]
            .into_iter()
            .find_map(|hand| hands[hand.index()].map(|grip| (hand, grip)));
        Ok((steps, holder.unwrap_or(start)))
    }

    /// The looks at the faces that are wanted.
    ///
    /// # Errors
    /// When not all of them can be shown.
    pub fn looks_at(&self, start: (Hand, Grip), wanted: &Wanted) -> Result<Vec<Step>, NoPlan> {
        identify::looks(start, wanted, &self.terms, &self.reach)
    }

    /// The plan of least time over the solutions that the search meets.
    ///
    /// # Errors
    /// When the reach allows none.
    pub fn best(
        &self,
        cube: &Cube,
        start: (Hand, Grip),
        tables: &Tables,
        effort: Effort,
    ) -> Result<Plan, NoPlan> {
        let budget = Budget { nodes: effort.nodes, max_length: 0 };
        let list = solver::candidates(cube, tables, &budget, effort.candidates);
        self.of(&list, start)
    }

    /// The plan of least time over given solutions.
    ///
    /// # Errors
    /// When the reach allows none.
    pub fn of(&self, candidates: &[Vec<Turn>], start: (Hand, Grip)) -> Result<Plan, NoPlan> {
        super::plan(candidates, start, &self.terms, &self.reach)
    }
}
