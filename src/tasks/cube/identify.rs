//! The looks that show all six faces, or the wanted ones, in the least time.
//!
//! - in: the hand that holds the cube and its grip, the views and grasps within reach with the
//!   times between them, the wanted faces, and the faces that stay hidden in some hold
//! - out: steps that begin with the one hand's grip and end with one hand holding alone; each
//!   wanted face is looked at once
//! - method: a shortest path (Dijkstra) over holder, grip, set of seen faces, and the meeting at
//!   which the hands are
//!
//! A held cube shows the face opposite the palm and the two that are not under the jaws. The table
//! of meetings says before which of them the camera in the other hand can be brought. If it reaches
//! all three, one hand-over is enough: the second palm on the face opposite the first, its jaws
//! across. A look itself takes some hundredths of a second; the paths to the looks take seconds, so
//! their order counts.

use super::hold::{Grip, Hand, Hold, Step};
use super::plan::{Depths, NoPlan, Reach, Stop, Terms, compatible};
use crate::cube::{Face, Rotation24, rotation_index};
use crate::motion::Depth;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Number of grips of a hand: 24 over one layer, then 24 over two.
const GRIPS: usize = 48;
/// Number of sets of seen faces; the last one has all faces.
const SETS: usize = 64;
const ALL: usize = SETS - 1;
/// Number of places of the hands: the meetings, and an unknown one.
const PLACES: usize = Stop::COUNT + 1;

/// Faces that looks have to show.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wanted {
    /// Wanted faces, in the order URFDLB.
    pub faces: [bool; 6],
    /// Faces that cannot be read while a hand has the cube in this hold.
    pub hidden: Vec<(Hand, Hold, Face)>,
}

impl Default for Wanted {
    /// Returns a request for all six faces, none of which is known to be hidden.
    fn default() -> Self {
        Self { faces: [true; 6], hidden: Vec::new() }
    }
}

/// Finds the quickest steps that show all wanted faces, from a start in which one hand holds the
/// cube alone. A [`Step::Look`] comes only while its viewer holds nothing; after a hand-over the
/// former holder leaves first.
///
/// # Errors
/// When no sequence of grasps within reach shows all faces that are wanted.
pub fn looks(
    start: (Hand, Grip),
    wanted: &Wanted,
    terms: &Terms,
    reach: &impl Reach,
) -> Result<Vec<Step>, NoPlan> {
    let search = Search {
        grips: Grip::all(Depth::One).chain(Grip::all(Depth::Two)).collect(),
        wanted,
        terms,
        reach,
    };
    // An unwanted face counts as seen from the beginning, so every goal is the full set.
    let seen = (0..6).filter(|&f| !wanted.faces[f]).fold(0, |set, f| set | 1 << f);
    let grip = grip_number(start.1);
    search.quickest(State { hand: start.0, grip, seen, at: None }).ok_or(NoPlan::Unseen)
}

/// State of a reading: one hand holds the cube.
#[derive(Debug, Clone, Copy)]
struct State {
    hand: Hand,
    /// Number of its grip, 0..[`GRIPS`].
    grip: usize,
    /// Set of the faces that were seen or are not wanted: bit n for face n.
    seen: usize,
    /// Meeting at which the hands are; `None` at the start.
    at: Option<Stop>,
}

impl State {
    /// Returns the index of this state among all.
    fn index(&self) -> usize {
        let place = self.at.map_or(0, |at| 1 + at.number());
        ((self.hand.index() * GRIPS + self.grip) * SETS + self.seen) * PLACES + place
    }
}

/// The quickest path to a state.
#[derive(Debug, Clone, Copy)]
struct Best {
    /// Time of the path (s).
    seconds: f64,
    /// The state before, and the step from there; `None` at the start.
    from: Option<(usize, Move)>,
}

/// Step from one state to the next.
#[derive(Debug, Clone, Copy)]
enum Move {
    Look(Face),
    /// The other hand grasps the cube in this grip, and the former holder leaves.
    HandOver(Hand, Grip),
}

/// Returns the number of a grip: that of its rotation, and 24 more if it is over two layers.
fn grip_number(grip: Grip) -> usize {
    grip.rotation().index() + if grip.hold.depth == Depth::Two { 24 } else { 0 }
}

/// Data of one search.
struct Search<'a, R: Reach> {
    /// Grips by their numbers.
    grips: Vec<Grip>,
    wanted: &'a Wanted,
    terms: &'a Terms,
    reach: &'a R,
}

impl<R: Reach> Search<'_, R> {
    /// Returns the steps of the quickest path from `start` to a state in which all faces were seen.
    fn quickest(&self, start: State) -> Option<Vec<Step>> {
        let none = Best { seconds: f64::INFINITY, from: None };
        let mut best = vec![none; 2 * GRIPS * SETS * PLACES];
        best[start.index()].seconds = 0.0;
        // A positive number and its bits, read as an integer, have the same order.
        let mut open = BinaryHeap::from([Reverse((0.0_f64.to_bits(), start.index()))]);
        let mut states = vec![None; best.len()];
        states[start.index()] = Some(start);
        while let Some(Reverse((bits, index))) = open.pop() {
            let (seconds, state) = (f64::from_bits(bits), states[index]?);
            if seconds > best[index].seconds {
                continue;
            }
            if state.seen == ALL {
                return Some(written(index, &best, &states));
            }
            self.expand(state, |next, step, cost| {
                let (to, seconds) = (next.index(), seconds + cost);
                // Times that differ by rounding alone keep the earlier path.
                if seconds < best[to].seconds - 1e-9 {
                    best[to] = Best { seconds, from: Some((index, step)) };
                    states[to] = Some(next);
                    open.push(Reverse((seconds.to_bits(), to)));
                }
            });
        }
        None
    }

    /// Calls `reached` for each look and each hand-over that is possible in a state: with the state
    /// after it, the step, and its time (s).
    fn expand(&self, state: State, mut reached: impl FnMut(State, Move, f64)) {
        let (viewer, held) = (state.hand.other(), self.grips[state.grip]);
        for (side, face) in self.views(state.hand, held) {
            let bit = 1 << face.index();
            if state.seen & bit == 0 {
                let at = Stop::view(state.hand, side);
                let next = State { seen: state.seen | bit, at: Some(at), ..state };
                reached(next, Move::Look(face), self.reach.path(state.at, at, viewer));
            }
        }
        let count = if self.terms.depths == Depths::One { 24 } else { GRIPS };
        for (number, &grip) in self.grips.iter().enumerate().take(count) {
            if let Some(at) = self.meeting((state.hand, held), grip) {
                let next = State { hand: viewer, grip: number, at: Some(at), ..state };
                let seconds = self.reach.path(state.at, at, viewer) + self.terms.costs.grasp;
                reached(next, Move::HandOver(viewer, grip), seconds);
            }
        }
    }

    /// Returns the meeting at which the free hand can grasp the cube in the grip `newcomer` while
    /// the other hand holds it; `None` if it cannot.
    fn meeting(&self, (hand, held): (Hand, Grip), newcomer: Grip) -> Option<Stop> {
        let (track, postument) =
            if hand == Hand::Track { (held, newcomer) } else { (newcomer, held) };
        let (track, postument) = (track.rotation().quaternion(), postument.rotation().quaternion());
        let meets = compatible(held.hold, newcomer.hold, self.terms.rule)
            && self.reach.grasp(track, postument).is_some();
        meets.then(|| Stop::grasp(rotation_index(&(track.inverse() * postument)) as u8))
    }

    /// Iterates over the wanted faces of a held cube that the other hand's camera can see, each
    /// with its side: +z, +x or -x of the holder's tool, in the order of the table of meetings.
    fn views(&self, holder: Hand, grip: Grip) -> impl Iterator<Item = (usize, Face)> {
        let rotation: Rotation24 = grip.rotation();
        let sides = [Face::U, Face::R, Face::L].into_iter().enumerate();
        sides
            .filter(move |(side, _)| self.reach.view(holder, *side))
            .map(move |(side, normal)| (side, rotation.face(normal)))
            .filter(move |&(_, face)| {
                self.wanted.faces[face.index()]
                    && !self.wanted.hidden.contains(&(holder, grip.hold, face))
            })
    }
}

/// Returns the steps that lead to the state with the index `end`.
fn written(end: usize, best: &[Best], states: &[Option<State>]) -> Vec<Step> {
    let (mut moves, mut at) = (Vec::new(), end);
    while let Some((before, step)) = best[at].from {
        moves.push((before, step));
        at = before;
    }
    let mut steps = Vec::new();
    for (before, step) in moves.into_iter().rev() {
        let Some(State { hand: holder, .. }) = states[before] else { continue };
        match step {
            Move::Look(face) => steps.push(Step::Look { viewer: holder.other(), face }),
            Move::HandOver(hand, grip) => {
                let Grip { hold, half_roll } = grip;
                steps.push(Step::Grasp { hand, hold, half_roll });
                steps.push(Step::Leave { hand: holder });
            }
        }
    }
    steps
}

#[cfg(test)]
mod tests {
    use super::super::plan::{ArmsAt, Everywhere, RollLimits, Rule};
    use super::super::replay::replay;
    use super::*;
    use crate::cube::{Axis, Facelets};
    use nalgebra::UnitQuaternion;

    /// A cell whose cameras can be brought before one side only of what each hand holds.
    struct OneSide(usize);

    impl Reach for OneSide {
        fn grasp(&self, a: UnitQuaternion<f64>, b: UnitQuaternion<f64>) -> Option<RollLimits> {
            Everywhere.grasp(a, b)
        }
        fn view(&self, _: Hand, side: usize) -> bool {
            side == self.0
        }
        fn travel(&self, from: Option<ArmsAt>, newcomer: Hand, meeting: u8) -> f64 {
            Everywhere.travel(from, newcomer, meeting)
        }
        fn path(&self, from: Option<Stop>, to: Stop, newcomer: Hand) -> f64 {
            Everywhere.path(from, to, newcomer)
        }
    }

    fn start(depth: Depth) -> (Hand, Grip) {
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth };
        (Hand::Track, Grip { hold, half_roll: false })
    }

    fn hand_overs(steps: &[Step]) -> usize {
        steps.iter().filter(|s| matches!(s, Step::Grasp { .. })).count()
    }

    fn shown(steps: &[Step]) -> Vec<Face> {
        let mut faces: Vec<Face> = steps
            .iter()
            .filter_map(|s| if let Step::Look { face, .. } = s { Some(*face) } else { None })
            .collect();
        faces.sort_unstable();
        faces
    }

    /// Here the cameras can be brought before all three sides that a held cube shows.
    #[test]
    fn one_regrasp_shows_all_faces() {
        for (rule, depth) in [(Rule::Strict, Depth::Two), (Rule::Clearance, Depth::One)] {
            let steps =
                looks(start(depth), &Wanted::default(), &Terms::of(rule), &Everywhere).unwrap();

            assert_eq!(hand_overs(&steps), 1);
            assert_eq!(shown(&steps), Face::ALL);
            let mut hands = [None; 2];
            hands[0] = Some(start(depth).1);
            replay(Facelets::solved(), hands, &steps, rule).unwrap();
        }
    }

    #[test]
    fn camera_limited_to_one_side_needs_five_regrasps() {
        for side in 0..3 {
            let reach = OneSide(side);

            let steps =
                looks(start(Depth::One), &Wanted::default(), &Terms::of(Rule::Clearance), &reach)
                    .unwrap();

            assert!(hand_overs(&steps) >= 5);
            assert_eq!(shown(&steps), Face::ALL);
        }
    }

    /// Arms whose path between two views takes longer the farther the views' sides are apart.
    struct InOrder;

    impl Reach for InOrder {
        fn grasp(&self, a: UnitQuaternion<f64>, b: UnitQuaternion<f64>) -> Option<RollLimits> {
            Everywhere.grasp(a, b)
        }
        fn view(&self, holder: Hand, _: usize) -> bool {
            holder == Hand::Track
        }
        fn travel(&self, from: Option<ArmsAt>, newcomer: Hand, meeting: u8) -> f64 {
            Everywhere.travel(from, newcomer, meeting)
        }
        fn path(&self, from: Option<Stop>, to: Stop, _: Hand) -> f64 {
            // The sides 0, 1 and 2 in the quickest order 2, 0, 1.
            let place = |stop: Stop| [1.0, 5.0, 0.0][stop.number() % 3];
            from.map_or(place(to), |from| (place(from) - place(to)).abs() + 0.1)
        }
    }

    #[test]
    fn looks_follow_the_quickest_order() {
        let (hand, grip) = start(Depth::One);
        let sides = [Face::L, Face::U, Face::R].map(|side| grip.rotation().face(side));
        let mut faces = [false; 6];
        for face in sides {
            faces[face.index()] = true;
        }
        let wanted = Wanted { faces, hidden: Vec::new() };

        let steps = looks((hand, grip), &wanted, &Terms::of(Rule::Clearance), &InOrder).unwrap();

        assert_eq!(steps, sides.map(|face| Step::Look { viewer: hand.other(), face }));
    }

    #[test]
    fn planner_reports_unseen_faces_of_blind_cameras() {
        let blind = OneSide(7);

        let answer =
            looks(start(Depth::One), &Wanted::default(), &Terms::of(Rule::Clearance), &blind);

        assert_eq!(answer, Err(NoPlan::Unseen));
    }

    #[test]
    fn hidden_face_is_shown_in_another_hold() {
        let (hand, grip) = start(Depth::One);
        let terms = Terms::of(Rule::Clearance);
        for hidden in [Face::U, Face::R, Face::L] {
            let mut faces = [false; 6];
            faces[hidden.index()] = true;
            let mut wanted = Wanted { faces, hidden: Vec::new() };
            let direct = looks((hand, grip), &wanted, &terms, &Everywhere).unwrap();
            assert_eq!(direct, [Step::Look { viewer: hand.other(), face: hidden }]);

            wanted.hidden.push((hand, grip.hold, hidden));
            let steps = looks((hand, grip), &wanted, &terms, &Everywhere).unwrap();

            assert_eq!(hand_overs(&steps), 1);
            assert_eq!(shown(&steps), [hidden]);
        }
    }

    #[test]
    fn plan_without_wanted_faces_is_empty() {
        let wanted = Wanted { faces: [false; 6], hidden: Vec::new() };

        let steps =
            looks(start(Depth::One), &wanted, &Terms::of(Rule::Strict), &Everywhere).unwrap();

        assert_eq!(steps, []);
    }
}
