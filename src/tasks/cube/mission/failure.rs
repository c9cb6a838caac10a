//! Why a procedure of the mission could not go on.
//!
//! A failure travels by `?` to the place that can mend it: [`super::realign`] catches what fails
//! while a layer is brought back into line, [`super::read`] a hidden face, [`super::mend`]
//! everything else.

use super::shared::Doing;
use crate::cube::Face;
use crate::generators::{Behaviour, Outcome};
use crate::tasks::Event;
use crate::tasks::cube::hold::Hand;
use std::fmt::Debug;

/// Behaviours of both hands; `None` leaves a hand as it is.
pub(super) type Orders = [Option<Behaviour>; 2];
/// How the behaviours ended.
pub(super) type Outcomes = [Option<Outcome>; 2];

/// Orders a behaviour of one hand.
pub(super) fn alone(hand: Hand, behaviour: Behaviour) -> Orders {
    let mut orders = [None, None];
    orders[hand.index()] = Some(behaviour);
    orders
}

/// Why a procedure stopped.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Failure {
    /// The mission ends where it stands, for this reason.
    Final(String),
    /// The jaws of this hand have closed farther than on a cube.
    Lost(Hand),
    /// This hand did not get hold of the cube that its partner holds.
    NotGrasped { hand: Hand, why: String },
    /// A hand that gave way was pressed beyond its limits all the same.
    Strained(String),
    /// A face cannot be read in the grasp in which the cube is held.
    Hidden { face: Face, why: String },
    /// A turn of the plan did not go through; the layer may be misaligned.
    TurnFailed { turner: Hand },
    /// The cube is read and planned anew, after this hand has let go.
    ReadAnew { release: Option<Hand> },
    /// The cube goes back as it is, after this hand has let go; the reason is known already.
    GiveUp { release: Option<Hand> },
    /// The cube goes back as it is, for this reason.
    GiveBack(String),
    /// The cube cannot be taken, or is not let go: it stays with the operator, for this reason.
    Left(String),
    /// A cube that an earlier run was handing back is in somebody's hand.
    WithOperator(String),
    /// A cube that an earlier run was handing back is not held out again.
    NotHeldOut,
}

impl Failure {
    /// Reports an event that does not answer the action, a defect of the shell.
    pub(super) fn unexpected<C: Debug>(event: &Event<C>) -> Self {
        Self::Final(format!("the shell answered with {event:?}"))
    }
}

/// A reason alone ends the mission where it stands: what `?` makes of a text.
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

/// An outcome that ends the partner's behaviour, too.
#[derive(Debug)]
pub(super) struct Alarm {
    /// The hand that reported it.
    pub(super) hand: Hand,
    pub(super) outcome: Outcome,
    /// The alarm, the hand and what it was doing, in words.
    pub(super) why: String,
}

/// Returns the first alarm among outcomes, in the order of the hands.
pub(super) fn alarm(outcomes: &Outcomes, doing: Doing) -> Option<Alarm> {
    let of = |hand: Hand| Some((hand, outcomes[hand.index()].filter(Outcome::alarms)?));
    let (hand, outcome) = Hand::BOTH.into_iter().find_map(of)?;
    let why = format!("{outcome}, at the {} hand while {}", hand.name(), doing.word());
    Some(Alarm { hand, outcome, why })
}
