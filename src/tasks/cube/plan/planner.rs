//! The planner of a cell: it solves the cube and plans the regrasps in one step.
//!
//! - in: a cube, the hand that holds it, the solver's tables, the effort of the search
//! - out: the plan of least time over all solutions that the search found
//!
//! The shortest solution is seldom the quickest for two hands. The planner therefore tries every
//! solution that the two-phase search finds, up to three turns longer than the shortest. A try ends
//! as soon as it costs more than the best plan before it.

use super::super::hold::{Grip, Hand, Hold, Step, hands_after};
use super::super::identify::{self, Wanted};
use super::super::settings::CubeSettings;
use super::terms::{Rule, Terms};
use super::travel::{Reachable, Stop};
use super::{NoPlan, Plan};
use crate::cube::{Axis, Cube, Face, Turn};
use crate::motion::Depth;
use crate::solver::{self, Budget, Tables};

/// The reach of the two arms of a cell, and the terms of their plans.
#[derive(Debug, Clone)]
pub struct Planner {
    reach: Reachable,
    terms: Terms,
}

/// Effort of the search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Nodes that the two-phase search may visit.
    pub nodes: u64,
    /// Largest number of solutions that are tried.
    pub candidates: usize,
}

/// Returns the track hand, and the grip in which it takes the cube from the operator.
#[must_use]
pub fn taken() -> (Hand, Grip) {
    let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
    (Hand::Track, Grip { hold, half_roll: false })
}

impl Planner {
    /// Makes a planner from the settings of the task.
    #[must_use]
    pub fn new(settings: &CubeSettings) -> Self {
        Self {
            reach: Reachable::new(settings.meetings.clone(), &settings.speeds),
            terms: settings.terms(),
        }
    }

    /// Returns this planner for plans that begin with the hands at a meeting; `None` if they are at
    /// none.
    #[must_use]
    pub fn starting_at(self, meeting: Option<Stop>) -> Self {
        Self { reach: self.reach.starting_at(meeting), ..self }
    }

    /// Returns a planner for the same arms and costs that plans by another rule, with the depths
    /// that are usual for that rule.
    #[must_use]
    pub fn by_rule(&self, rule: Rule) -> Self {
        let Terms { finish_depths, costs, .. } = self.terms;
        let terms = Terms { finish_depths, costs, ..Terms::of(rule) };
        Self { terms, ..self.clone() }
    }

    /// Returns the rule by which this planner plans.
    #[must_use]
    pub fn rule(&self) -> Rule {
        self.terms.rule
    }

    /// Returns the steps that show all six faces, and the hand that holds the cube after them with
    /// its grip. Faces have the names that they have at the start.
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

    /// Returns the steps that show the wanted faces to the cameras in the hands. `start` is the
    /// hand that holds the cube alone, with its grip.
    ///
    /// # Errors
    /// When not all of them can be shown.
    pub fn looks_at(&self, start: (Hand, Grip), wanted: &Wanted) -> Result<Vec<Step>, NoPlan> {
        identify::looks(start, wanted, &self.terms, &self.reach)
    }

    /// Returns the plan of least time for `cube`, over the solutions that the two-phase search
    /// finds with this effort. `start` is the hand that holds the cube alone, with its grip.
    ///
    /// # Errors
    /// When no sequence of grasps within reach carries out any of the solutions.
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

    /// Returns the plan of least time over these solutions of one cube. `start` is the hand that
    /// holds the cube alone, with its grip.
    ///
    /// # Errors
    /// When no sequence of grasps within reach carries out any of the solutions.
    pub fn of(&self, candidates: &[Vec<Turn>], start: (Hand, Grip)) -> Result<Plan, NoPlan> {
        super::plan(candidates, start, &self.terms, &self.reach)
    }
}
