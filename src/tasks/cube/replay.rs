//! A plan replayed on a cube of stickers with two hands: the last check before arms move.
//!
//! It shares no rule with the planner. Fingers, palms and layers fill cells of a grid whose step is
//! one cubie:
//!
//! - the cube's own cells are -1..=1 along x, y, z
//! - a finger on a face fills cells at 2 along that face's normal
//! - a palm that touches fills the nine cells at 2 above its face, one with clearance those at 3
//!
//! Two hands may not fill one cell, and a turning layer sweeps the ring of cells around it.

use super::hold::{Grip, Hand, Hands, Hold, Step, hands_after};
use super::plan::terms::Rule;
use crate::cube::{Axis, Face, Facelets, Turn};
use crate::motion::Depth;

/// A cell of the grid: its place along x (to R), y (to B) and z (to U), in cubies from the cube's
/// centre.
type Cell = [i8; 3];

/// A step that must not be done, and the reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
// Users count the steps from 1, as `plan --explain` does.
#[error("step {}: {fault}", .step + 1)]
pub struct Illegal {
    /// Number of the step in the plan, from 0.
    pub step: usize,
    /// Reason why it must not be done.
    pub fault: Fault,
}

/// Reason why a step must not be done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// No hand would hold the cube.
    #[error("the {} hand lets go and no hand holds the cube", .0.name())]
    Dropped(Hand),
    /// The jaws lie along the palm's own axis.
    #[error("the jaws of the {} hand close along its palm's axis", .0.name())]
    Jaws(Hand),
    /// Both hands fill one cell.
    #[error(
        "both hands fill one place: {} along x (to R), {} along y (to B) and {} along z (to U), in \
         cubies from the cube's centre",
        .0[0], .0[1], .0[2]
    )]
    Collision(Cell),
    /// The hand holds nothing, but the step needs its hold.
    #[error("the {} hand holds no cube", .0.name())]
    Empty(Hand),
    /// The hand holds the cube and so cannot look at it.
    #[error("the {} hand holds the cube and cannot look at it", .0.name())]
    Busy(Hand),
    /// The turner's palm is on another face, or it holds more than the layer.
    #[error("the {} hand does not hold exactly the layer that it turns", .0.name())]
    Turner(Hand),
    /// The other hand holds the layer that turns, or does not hold the middle one.
    #[error(
        "the {} hand is in the way of the turning layer or does not hold the middle layer",
        .0.name()
    )]
    Body(Hand),
    /// The turn is the hand's second one in a grasp, and the wrist has room for one.
    #[error("the {} hand turns twice without letting go", .0.name())]
    TurnedTwice(Hand),
    /// The turn is by no quarter or by more than three.
    #[error("a turn by {0} quarter turns instead of 1, 2 or 3")]
    Quarters(u8),
    /// The face is under the palm or the jaws of the hand that holds.
    #[error("face {} is covered by the hand that holds the cube", .0.letter())]
    Covered(Face),
}

/// Carries out steps on a cube of stickers and checks each of them. Returns the cube and the grips
/// of both hands at the end.
///
/// # Errors
/// The first step that must not be done.
pub fn replay(
    start: Facelets,
    hands: Hands,
    steps: &[Step],
    rule: Rule,
) -> Result<(Facelets, Hands), Illegal> {
    let (mut cube, mut hands, mut turned) = (start, hands, [false; 2]);
    for (step, action) in steps.iter().enumerate() {
        check(hands, *action, rule, &mut turned).map_err(|fault| Illegal { step, fault })?;
        hands = hands_after(hands, action);
        if let Step::Turn { turn, .. } = action {
            cube = cube.turned(*turn);
            // The turner's fingers have moved with the layer, and may now meet the body's.
            apart(hands, rule).map_err(|fault| Illegal { step, fault })?;
        }
    }
    Ok((cube, hands))
}

/// Checks one step. `turned` says which hands have turned a layer since the last grasp, and is
/// updated.
fn check(hands: Hands, step: Step, rule: Rule, turned: &mut [bool; 2]) -> Result<(), Fault> {
    match step {
        Step::Grasp { hand, hold, .. } => {
            // A hand that grasps lets go first, so the other hand must hold the cube meanwhile.
            if hands[hand.other().index()].is_none() {
                return Err(Fault::Dropped(hand));
            }
            if hold.palm.axis() == hold.jaws {
                return Err(Fault::Jaws(hand));
            }
            // A new grasp begins at a new meeting, from which both wrists have room again.
            *turned = [false; 2];
            apart(hands_after(hands, &step), rule)
        }
        Step::Leave { hand } => {
            hands[hand.index()].ok_or(Fault::Empty(hand))?;
            match hands[hand.other().index()] {
                Some(_) => Ok(()),
                None => Err(Fault::Dropped(hand)),
            }
        }
        // The gripper's own parts cover the face under the palm and the two under the jaws.
        Step::Look { viewer, face } => {
            if hands[viewer.index()].is_some() {
                return Err(Fault::Busy(viewer));
            }
            let holder = viewer.other();
            let grip = hands[holder.index()].ok_or(Fault::Empty(holder))?;
            let hidden = face == grip.hold.palm || face.axis() == grip.hold.jaws;
            if hidden { Err(Fault::Covered(face)) } else { Ok(()) }
        }
        Step::Turn { turner, turn } => turns(hands, turner, turn, rule, turned),
    }
}

/// Checks a turn: the turner holds only the layer that turns, the other hand holds the middle
/// layer, and no part of that hand is in the ring that the layer sweeps.
fn turns(
    hands: Hands,
    turner: Hand,
    turn: Turn,
    rule: Rule,
    turned: &mut [bool; 2],
) -> Result<(), Fault> {
    if !(1..=3).contains(&turn.quarters) {
        return Err(Fault::Quarters(turn.quarters));
    }
    // Height of a cell along the turning face's normal: 1 is the layer, 0 the middle layer.
    let layer = |cell: &Cell| {
        cell.iter().zip(turn.face.normal().iter()).map(|(&c, n)| c * *n as i8).sum::<i8>()
    };
    let own = hands[turner.index()].ok_or(Fault::Empty(turner))?.hold;
    if own.palm != turn.face || fingers(own).iter().any(|c| layer(c) < 1) {
        return Err(Fault::Turner(turner));
    }
    if std::mem::replace(&mut turned[turner.index()], true) {
        return Err(Fault::TurnedTwice(turner));
    }
    let body = turner.other();
    let other = hands[body.index()].ok_or(Fault::Empty(body))?.hold;
    // A palm at 3 is outside the ring that the layer's corners sweep.
    let around = |c: &Cell| c.iter().all(|k| k.abs() <= 2);
    let mut filled = fingers(other).into_iter().chain(palm(other, own, rule));
    let in_the_way = filled.any(|c| layer(&c) >= 1 && around(&c));
    // A body hand on the far layer alone would leave the middle one free to turn along.
    let holds_middle = fingers(other).iter().any(|c| layer(c) == 0);
    if in_the_way || !holds_middle { Err(Fault::Body(body)) } else { Ok(()) }
}

/// Checks that no grid cell is filled by both hands.
fn apart(hands: Hands, rule: Rule) -> Result<(), Fault> {
    let [Some(Grip { hold: a, .. }), Some(Grip { hold: b, .. })] = hands else { return Ok(()) };
    let of_a = [fingers(a), palm(a, b, rule)].concat();
    let of_b = [fingers(b), palm(b, a, rule)].concat();
    match of_a.into_iter().find(|c| of_b.contains(c)) {
        Some(cell) => Err(Fault::Collision(cell)),
        None => Ok(()),
    }
}

/// Returns the grid cells that both fingers fill, from the height of the palm down to the innermost
/// layer that they hold.
fn fingers(hold: Hold) -> Vec<Cell> {
    let reach: &[i8] = match hold.depth {
        Depth::One => &[2, 1],
        Depth::Two => &[2, 1, 0],
    };
    let mut cells = Vec::with_capacity(6);
    for side in [2, -2] {
        for along in reach {
            let mut cell = [0; 3];
            cell[hold.palm.axis() as usize] = sign(hold.palm) * along;
            cell[hold.jaws as usize] = side;
            cells.push(cell);
        }
    }
    cells
}

/// Returns the nine grid cells that the palm fills. It has clearance to the cube only if the rule
/// says so and both hands reach over one layer.
fn palm(hold: Hold, partner: Hold, rule: Rule) -> Vec<Cell> {
    let stands_off =
        rule == Rule::Clearance && hold.depth == Depth::One && partner.depth == Depth::One;
    let height = if stands_off { 3 } else { 2 };
    let axis = hold.palm.axis() as usize;
    let across: Vec<usize> =
        Axis::ALL.map(|a| a as usize).into_iter().filter(|&a| a != axis).collect();
    let mut cells = Vec::with_capacity(9);
    for i in -1..=1 {
        for j in -1..=1 {
            let mut cell = [0; 3];
            cell[axis] = sign(hold.palm) * height;
            (cell[across[0]], cell[across[1]]) = (i, j);
            cells.push(cell);
        }
    }
    cells
}

/// Returns the sense of the face's outward normal along its axis, 1 or -1.
fn sign(face: Face) -> i8 {
    if face == face.axis().positive_face() { 1 } else { -1 }
}

#[cfg(test)]
mod tests {
    use super::super::plan::{compatible, turnable};
    use super::*;

    /// Returns the first of the two grips of this hold.
    fn grip(palm: Face, jaws: Axis, depth: Depth) -> Grip {
        Grip { hold: Hold { palm, jaws, depth }, half_roll: false }
    }

    /// The rules are stated twice: by axes in the planner, by grid cells in the replay.
    #[test]
    fn replay_allows_same_pairs_of_holds_as_planner() {
        let all: Vec<Grip> = Grip::every().collect();
        let mut legal = 0;
        for rule in [Rule::Strict, Rule::Clearance] {
            for (a, b) in all.iter().flat_map(|a| all.iter().map(move |b| (a, b))) {
                let hands = [Some(*a), Some(*b)];

                let by_cells = a.hold.palm != b.hold.palm && apart(hands, rule).is_ok();
                assert_eq!(by_cells, compatible(a.hold, b.hold, rule), "{a:?} {b:?} {rule:?}");
                legal += usize::from(by_cells);
                if !by_cells {
                    continue;
                }
                let turn = Turn { face: a.hold.palm, quarters: 2 };
                let step = turns(hands, Hand::Track, turn, rule, &mut [false; 2]);
                assert_eq!(step.is_ok(), turnable(a.hold, b.hold, rule), "{a:?} {b:?} {rule:?}");
            }
        }
        assert!(legal > 1000, "{legal}");
    }

    #[test]
    fn replay_refuses_release_by_only_holding_hand() {
        let hands = [Some(grip(Face::D, Axis::Y, Depth::Two)), None];

        let result =
            replay(Facelets::solved(), hands, &[Step::Leave { hand: Hand::Track }], Rule::Strict);

        assert_eq!(result, Err(Illegal { step: 0, fault: Fault::Dropped(Hand::Track) }));
    }

    #[test]
    fn layer_turns_only_with_middle_layer_held() {
        let turn = Step::Turn { turner: Hand::Track, turn: Turn { face: Face::U, quarters: 1 } };
        let turner = grip(Face::U, Axis::X, Depth::One);
        let try_with =
            |body| replay(Facelets::solved(), [Some(turner), Some(body)], &[turn], Rule::Clearance);

        let outer = try_with(grip(Face::D, Axis::Y, Depth::One));
        let middle = try_with(grip(Face::D, Axis::Y, Depth::Two));
        let beside = try_with(grip(Face::F, Axis::X, Depth::One));

        assert_eq!(outer, Err(Illegal { step: 0, fault: Fault::Body(Hand::Postument) }));
        assert!(middle.is_ok() && beside.is_ok());
    }

    #[test]
    fn replay_refuses_look_at_covered_face() {
        let hands = [Some(grip(Face::D, Axis::Y, Depth::One)), None];
        let look = |face| {
            let steps = [Step::Look { viewer: Hand::Postument, face }];
            replay(Facelets::solved(), hands, &steps, Rule::Strict).is_ok()
        };

        let seen: Vec<Face> = Face::ALL.into_iter().filter(|&f| look(f)).collect();

        assert_eq!(seen, [Face::U, Face::R, Face::L]);
    }
}
