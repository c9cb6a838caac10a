//! A plan in words: each step with its time, the holds meanwhile, and the reason for each new
//! grasp.
//!
//! - in: the episodes of the cheapest plan, the terms and the reach that they were found with
//! - out: the steps, and for each a [`Line`] for people
//!
//! The reason of a grasp is the first rule that forbids the next turn with the present grips: palm,
//! wrist that has rolled already, depth of the turner, fingers of the body hand, fingers of both
//! hands after the turn, room of the wrist.

use super::super::hold::{Grip, Hand, Hands, Hold, Step, hands_after};
use super::search::Episode;
use super::terms::{Costs, Terms, compatible, turnable};
use super::travel::Reach;
use crate::cube::{Turn, format_turns};
use crate::motion::Depth;
use serde::Serialize;
use std::f64::consts::{FRAC_PI_2, PI};

/// A step of a plan in words.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Line {
    /// The action, and the holds meanwhile.
    pub what: String,
    /// Reason for the step.
    pub why: String,
    /// Planned duration (s).
    pub seconds: f64,
}

/// A plan as steps and lines.
pub(super) struct Written {
    /// The face turns in the order in which they are made.
    pub(super) turns: Vec<Turn>,
    /// Steps of the hands.
    pub(super) steps: Vec<Step>,
    /// Description of each step.
    pub(super) lines: Vec<Line>,
}

/// Writes the episodes of a plan as steps, each with a line of text for people.
pub(super) fn written(
    start: (Hand, Grip),
    episodes: &[Episode],
    terms: &Terms,
    reach: &impl Reach,
) -> Written {
    let mut writer = Writer::new(start, episodes, terms, reach);
    for episode in episodes {
        writer.grasp(episode);
        for (turner, turn) in episode.turns.iter().flatten() {
            writer.turn(*turner, *turn);
        }
        writer.holder = episode.stays.0;
    }
    if episodes.is_empty() {
        writer.lines.push(Line {
            what: format!("{} holds the cube", start.0.name()),
            why: "there is nothing to do".to_owned(),
            seconds: 0.0,
        });
    } else {
        writer.leave();
    }
    let Writer { turns, steps, lines, .. } = writer;
    Written { turns, steps, lines }
}

/// A plan that is being written, with the grips of the hands after the last step.
struct Writer<'a, R> {
    terms: &'a Terms,
    reach: &'a R,
    start: (Hand, Grip),
    turns: Vec<Turn>,
    /// Turns that are written already.
    made: usize,
    hands: Hands,
    /// Grips at the last meeting, from which the wrists' ranges count.
    met: Hands,
    /// Whether each hand has turned since that meeting.
    rolled: [bool; 2],
    /// The hand that keeps the cube until the next grasp.
    holder: Hand,
    steps: Vec<Step>,
    lines: Vec<Line>,
}

impl<'a, R: Reach> Writer<'a, R> {
    /// Makes a writer that has written no step yet. `start` is the hand that holds the cube, with
    /// its grip.
    fn new(start: (Hand, Grip), episodes: &[Episode], terms: &'a Terms, reach: &'a R) -> Self {
        let turns = episodes.iter().flat_map(|e| e.turns.iter().flatten()).map(|(_, turn)| *turn);
        let mut hands: Hands = [None; 2];
        hands[start.0.index()] = Some(start.1);
        Self {
            terms,
            reach,
            start,
            turns: turns.collect(),
            made: 0,
            hands,
            met: hands,
            rolled: [false; 2],
            holder: start.0,
            steps: Vec::new(),
            lines: Vec::new(),
        }
    }

    /// Adds the step and the line of the grasp with which an episode begins.
    fn grasp(&mut self, episode: &Episode) {
        let (hand, grip) = episode.newcomer;
        let partner = self.hands[self.holder.index()].unwrap_or(self.start.1);
        let why = match self.turns.get(self.made) {
            Some(next) => self.needed(*next, episode),
            None => format!("{} must hold the cube at the end", episode.stays.0.name()),
        };
        let costs = &self.terms.costs;
        // The episode's time includes its turns, which have lines of their own.
        let turning = episode.turns.iter().flatten().map(|(_, turn)| seconds_of(*turn, costs));
        let (own, other) = (described(grip.hold), described(partner.hold));
        self.lines.push(Line {
            what: format!("{} takes {own} while {} holds {other}", hand.name(), self.holder.name()),
            why,
            seconds: episode.seconds - turning.sum::<f64>(),
        });
        self.steps.push(Step::Grasp { hand, hold: grip.hold, half_roll: grip.half_roll });
        // The hand that does not stay has let go before it grasps again.
        self.hands[self.holder.index()] = Some(partner);
        self.hands[hand.index()] = Some(grip);
        self.met = self.hands;
        self.rolled = [false; 2];
    }

    /// Adds the step and the line of a turn.
    fn turn(&mut self, turner: Hand, turn: Turn) {
        let step = Step::Turn { turner, turn };
        let body = turner.other();
        let held = self.hands[body.index()].map_or_else(String::new, |g| described(g.hold));
        let (turner_name, turned) = (turner.name(), format_turns(&[turn]));
        self.lines.push(Line {
            what: format!("{turner_name} turns {turned} while {} holds {held}", body.name()),
            why: format!("turn {} of {}", self.made + 1, self.turns.len()),
            seconds: seconds_of(turn, &self.terms.costs),
        });
        self.hands = hands_after(self.hands, &step);
        self.rolled[turner.index()] = true;
        self.steps.push(step);
        self.made += 1;
    }

    /// Adds the last step and its line: the hand that does not keep the cube leaves.
    fn leave(&mut self) {
        let hand = self.holder.other();
        self.steps.push(Step::Leave { hand });
        self.lines.push(Line {
            what: format!("{} leaves", hand.name()),
            why: format!("{} keeps the cube", self.holder.name()),
            seconds: self.terms.costs.leave,
        });
    }

    /// Returns in words why the turn `next` cannot be made with the present grips, and the purpose
    /// of the new grasp.
    fn needed(&self, next: Turn, episode: &Episode) -> String {
        let turn = format_turns(&[next]);
        let obstacle = self.obstacle(next).unwrap_or_else(|| {
            "the hands could make it as they are, but a regrasp costs less in total".to_owned()
        });
        let purpose = match episode.turns[0] {
            Some((turner, _)) if turner == episode.newcomer.0 => String::new(),
            Some(_) => ", and the new grasp holds the body".to_owned(),
            None => {
                format!(": a hand-over, so that {} can let go", episode.newcomer.0.other().name())
            }
        };
        format!("{turn} is next: {obstacle}{purpose}")
    }

    /// Returns the first rule that forbids a turn with the present grips, if any does.
    // The rules are in the order of the module's documentation, from the plainest on.
    fn obstacle(&self, turn: Turn) -> Option<String> {
        let face = turn.face.letter();
        let [Some(track), Some(postument)] = self.hands else {
            return Some("one hand alone holds the cube".to_owned());
        };
        let has_palm = |h: &Hand| self.hands[h.index()].is_some_and(|g| g.hold.palm == turn.face);
        let Some(turner) = Hand::BOTH.into_iter().find(has_palm) else {
            return Some(format!("no palm is on {face}"));
        };
        let (own, body) =
            if turner == Hand::Track { (track, postument) } else { (postument, track) };
        let (turner_name, body_name) = (turner.name(), turner.other().name());
        if self.rolled[turner.index()] {
            return Some(format!(
                "{turner_name}'s palm is on {face}, but its wrist has rolled already"
            ));
        }
        if own.hold.depth == Depth::Two {
            return Some(format!("{turner_name} holds two layers"));
        }
        if !turnable(own.hold, body.hold, self.terms.rule) {
            return Some(format!("{body_name}'s fingers are not on the middle layer of that axis"));
        }
        let after = own.after_turn(turn.quarters);
        if !compatible(after.hold, body.hold, self.terms.rule) {
            return Some(format!("{turner_name}'s fingers would hit {body_name}'s"));
        }
        self.wrist_room(turner, turn)
    }

    /// Returns the reason against a turn if it would exceed the range of the turner's wrist joint,
    /// from the place where the hands meet.
    fn wrist_room(&self, turner: Hand, turn: Turn) -> Option<String> {
        let [Some(track), Some(postument)] = self.met else { return None };
        let (track, postument) = (track.rotation(), postument.rotation());
        let limits = self.reach.grasp(track.quaternion(), postument.quaternion())?;
        let (low, high) = if turner == Hand::Track { limits.track } else { limits.postument };
        // The sense in which the wrist would roll, as in `rolls_within` of the search.
        let angle = match turn.quarters {
            1 => FRAC_PI_2,
            3 => -FRAC_PI_2,
            _ if high > -low => PI,
            _ => -PI,
        };
        let turner = turner.name();
        (!(low..=high).contains(&angle))
            .then(|| format!("{turner}'s wrist has no range for it where the hands meet"))
    }
}

/// Returns the planned time of a turn (s).
fn seconds_of(turn: Turn, costs: &Costs) -> f64 {
    if turn.quarters == 2 { costs.half } else { costs.quarter }
}

/// Describes a hold, as in "U with jaws L-R, one layer".
fn described(hold: Hold) -> String {
    let positive = hold.jaws.positive_face();
    let layers = if hold.depth == Depth::One { "one layer" } else { "two layers" };
    format!(
        "{} with jaws {}-{}, {layers}",
        hold.palm.letter(),
        positive.opposite().letter(),
        positive.letter()
    )
}
