//! Failures that stop a procedure of the mission.
//!
//! A failure travels by `?` to the place that handles it: [`super::realign`] catches failures of a
//! realignment, [`super::read`] a hidden face, [`super::recover`] all others.

use super::shared::Doing;
use crate::cube::Face;
use crate::generators::{Behaviour, Outcome};
use crate::kernel::Event;
use crate::tasks::cube::hold::Hand;
use std::fmt::Debug;

/// Behaviours of both hands; `None` leaves a hand as it is.
pub(super) type Orders = [Option<Behaviour>; 2];
/// Outcomes of the behaviours of both hands.
pub(super) type Outcomes = [Option<Outcome>; 2];

/// Makes orders for one hand alone.
pub(super) fn alone(hand: Hand, behaviour: Behaviour) -> Orders {
    let mut orders = [None, None];
    orders[hand.index()] = Some(behaviour);
    orders
}

/// Reason for which a procedure stopped.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Failure {
    /// End of the mission without a further motion, for this reason.
    Final(String),
    /// Loss of the cube: the jaws of this hand have closed farther than on a cube.
    Lost(Hand),
    /// Failed grasp of this hand; its partner holds the cube. `empty` is whether the jaws closed on
    /// nothing; otherwise they did not close.
    NotGrasped { hand: Hand, why: String, empty: bool },
    /// Overload of a hand although it yielded.
    Strained(String),
    /// Face that cannot be read in the present grasp.
    Hidden { face: Face, why: String },
    /// Failed turn of the plan; the layer may be misaligned.
    TurnFailed { turner: Hand },
    /// Need to read and plan again, after this hand has let go.
    ReadAgain { release: Option<Hand> },
    /// Return of the cube as it is, after this hand has let go; the reason is stored already.
    GiveUp { release: Option<Hand> },
    /// Return of the cube as it is, for this reason.
    GiveBack(String),
    /// Cube that stays with the operator for this reason: the robot cannot take it, or the operator
    /// does not let go.
    Left(String),
    /// Cube that an earlier run was handing back, and that a person holds, for this reason.
    WithOperator(String),
    /// Cube that an earlier run was handing back, and that no person holds out again.
    NotHeldOut,
}

impl Failure {
    /// Returns the failure for an event that does not answer the action, which is a defect of the
    /// shell.
    pub(super) fn unexpected<C: Debug>(event: &Event<C>) -> Self {
        Self::Final(format!("the shell answered an action with another event: {event:?}"))
    }
}

/// Conversion by `?`: a reason without a kind ends the mission.
impl From<String> for Failure {
    fn from(why: String) -> Self {
        Self::Final(why)
    }
}

impl From<&str> for Failure {
    fn from(why: &str) -> Self {
        Self::Final(why.to_owned())
    }
}

/// Outcome that also ends the partner's behaviour.
#[derive(Debug)]
pub(super) struct Alarm {
    /// Hand that reported it.
    pub(super) hand: Hand,
    pub(super) outcome: Outcome,
    /// Outcome, hand and action in words.
    pub(super) why: String,
}

/// Returns the first alarm among outcomes, in the order of the hands. Its message names the action
/// `doing`. See [`Outcome::alarms`].
pub(super) fn alarm(outcomes: &Outcomes, doing: Doing) -> Option<Alarm> {
    let of = |hand: Hand| {
        Some((hand, outcomes[hand.index()].as_ref().filter(|outcome| outcome.alarms())?))
    };
    let (hand, outcome) = Hand::BOTH.into_iter().find_map(of)?;
    let outcome = outcome.clone();
    let why = format!("{outcome}, at the {} hand while {}", hand.name(), doing.word());
    Some(Alarm { hand, outcome, why })
}
