//! A plan in words: each step with its time, who holds what, and why a new grasp is needed.

use super::super::hold::{Grip, Hand, Hands, Hold, Step, hands_after};
use super::search::Episode;
use super::travel::Reach;
use super::{Costs, Plan, Terms, turnable};
use crate::cube::{Turn, format_turns};
use crate::motion::Depth;
use serde::Serialize;
use std::f64::consts::{FRAC_PI_2, PI};

/// A step for people.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Line {
    /// What is done, and who holds what meanwhile.
    pub what: String,
    /// Why it is needed.
    pub why: String,
    /// How long it takes, as planned [s].
    pub seconds: f64,
}

/// The episodes as steps, a line for each.
pub(super) fn written(
    start: (Hand, Grip),
    episodes: &[Episode],
    cost: f64,
    terms: &Terms,
    reach: &impl Reach,
) -> Plan {
    let turns: Vec<Turn> =
        episodes.iter().flat_map(|e| e.turns.iter().flatten()).map(|(_, turn)| *turn).collect();
    let mut hands: Hands = [None; 2];
    hands[start.0.index()] = Some(start.1);
    let (mut steps, mut lines) = (Vec::new(), Vec::new());
    let (mut rolled, mut holder, mut made) = ([false; 2], start.0, 0);
    for episode in episodes {
        let (hand, grip) = episode.newcomer;
        let partner = hands[holder.index()].unwrap_or(start.1);
        let why = match turns.get(made) {
            Some(next) => needed(hands, rolled, *next, episode, terms, reach),
            None => format!("{} is to hold the cube in the end", name(episode.stays.0)),
        };
        let turning = episode.turns.iter().flatten().map(|(_, t)| seconds_of(*t, &terms.costs));
        lines.push(Line {
            what: format!(
                "{} takes {} while {} holds {}",
                name(hand),
                described(grip.hold),
                name(holder),
                described(partner.hold)
            ),
            why,
            seconds: episode.seconds - turning.sum::<f64>(),
        });
        steps.push(Step::Grasp { hand, hold: grip.hold, half_roll: grip.half_roll });
        // The hand that does not stay has let go before it grasps again.
        hands[holder.index()] = Some(partner);
        hands[hand.index()] = Some(grip);
        rolled = [false; 2];
        for (turner, turn) in episode.turns.iter().flatten() {
            let step = Step::Turn { turner: *turner, turn: *turn };
            let body = turner.other();
            let held = hands[body.index()].map_or_else(String::new, |g| described(g.hold));
            lines.push(Line {
                what: format!(
                    "{} turns {} while {} holds {held}",
                    name(*turner),
                    format_turns(&[*turn]),
                    name(body)
                ),
                why: format!("turn {} of {}", made + 1, turns.len()),
                seconds: seconds_of(*turn, &terms.costs),
            });
            hands = hands_after(hands, &step);
            rolled[turner.index()] = true;
            steps.push(step);
            made += 1;
        }
        holder = episode.stays.0;
    }
    if episodes.is_empty() {
        lines.push(Line {
            what: format!("{} holds the cube", name(start.0)),
            why: "there is nothing to do".to_owned(),
            seconds: 0.0,
        });
    } else {
        let hand = holder.other();
        steps.push(Step::Leave { hand });
        lines.push(Line {
            what: format!("{} leaves", name(hand)),
            why: format!("{} keeps the cube", name(holder)),
            seconds: terms.costs.leave,
        });
    }
    Plan { turns, steps, grasps: episodes.len(), cost, lines }
}

fn seconds_of(turn: Turn, costs: &Costs) -> f64 {
    if turn.quarters == 2 { costs.half } else { costs.quarter }
}

/// Why the next turn cannot be made as the hands hold, and what the new grasp is for.
fn needed(
    hands: Hands,
    rolled: [bool; 2],
    next: Turn,
    episode: &Episode,
    terms: &Terms,
    reach: &impl Reach,
) -> String {
    let turn = format_turns(&[next]);
    let obstacle = obstacle(hands, rolled, next, terms, reach)
        .unwrap_or_else(|| "both hands could make it, but this way takes less time".to_owned());
    let purpose = match episode.turns[0] {
        Some((turner, _)) if turner == episode.newcomer.0 => String::new(),
        Some(_) => ", and now the body is held for it".to_owned(),
        None => format!(": a hand-over, so that {} can let go", name(episode.newcomer.0.other())),
    };
    format!("{turn} is next: {obstacle}{purpose}")
}

/// What is in the way of a turn.
fn obstacle(
    hands: Hands,
    rolled: [bool; 2],
    turn: Turn,
    terms: &Terms,
    reach: &impl Reach,
) -> Option<String> {
    let face = turn.face.letter();
    let [Some(track), Some(postument)] = hands else {
        return Some("one hand alone holds the cube".to_owned());
    };
    let Some(turner) = [Hand::Track, Hand::Postument]
        .into_iter()
        .find(|h| hands[h.index()].is_some_and(|g| g.hold.palm == turn.face))
    else {
        return Some(format!("no palm is on {face}"));
    };
    let (own, body) = if turner == Hand::Track { (track, postument) } else { (postument, track) };
    let (turner_name, body_name) = (name(turner), name(turner.other()));
    if rolled[turner.index()] {
        return Some(format!(
            "{turner_name}'s palm is on {face}, but its wrist has rolled already"
        ));
    }
    if own.hold.depth == Depth::Two {
        return Some(format!("{turner_name} reaches over two layers"));
    }
    if !turnable(own.hold, body.hold, terms.rule) {
        return Some(format!("{body_name}'s fingers are not on the middle layer of that axis"));
    }
    let limits = reach.grasp(track.rotation().quaternion(), postument.rotation().quaternion())?;
    let (low, high) = if turner == Hand::Track { limits.track } else { limits.postument };
    let angle = match turn.quarters {
        1 => FRAC_PI_2,
        3 => -FRAC_PI_2,
        _ if high > -low => PI,
        _ => -PI,
    };
    (!(low..=high).contains(&angle))
        .then(|| format!("{turner_name}'s wrist has no room for it where the hands meet"))
}

pub(super) fn name(hand: Hand) -> &'static str {
    match hand {
        Hand::Track => "track",
        Hand::Postument => "postument",
    }
}

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
