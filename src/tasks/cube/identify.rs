//! The looks that show all six faces, or the wanted ones, in the least time.
//!
//! - in: the hand that holds the cube and its grip, the views and grasps within reach with the
//!   times between them, the wanted faces, and the faces that stay hidden in some hold
//! - out: steps that begin with the grip of the holding hand and end with one hand holding alone;
//!   each wanted face is looked at once
//! - method: a shortest path (A*) over holder, grip, set of seen faces, and the meeting at which
//!   the hands are. Each unseen face takes at least the time of the shortest path to a view. All
//!   times and meetings are tabulated first, since MP waits for the search: about 15 ms
//!
//! A held cube shows the face opposite the palm and the two that are not under the jaws. The table
//! of meetings says before which of them the camera in the other hand can be brought. If it reaches
//! all three, one hand-over is enough: the second palm on the face opposite the first, its jaws
//! across. A look itself takes some hundredths of a second; the paths to the looks take seconds, so
//! their order counts.

use super::hold::{Grip, Hand, Hold, Step};
use super::plan::{NoPlan, Reach, Stop, Terms, compatible, of_rotations};
use crate::cube::{Face, Rotation24, rotation_index};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Number of grips of a hand.
const GRIPS: usize = Grip::COUNT;
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
    let search = Search::new(wanted, terms, reach);
    // An unwanted face counts as seen from the beginning, so every goal is the full set.
    let seen = (0..6).filter(|&f| !wanted.faces[f]).fold(0, |set, f| set | 1 << f);
    let grip = start.1.number();
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
    /// Number of states.
    const COUNT: usize = 2 * GRIPS * SETS * PLACES;

    /// Returns the index of this state among all.
    fn index(&self) -> usize {
        ((self.hand.index() * GRIPS + self.grip) * SETS + self.seen) * PLACES
            + place_number(self.at)
    }

    /// Returns the state with this index.
    fn with_index(index: usize) -> Self {
        let (rest, place) = (index / PLACES, index % PLACES);
        let (held, seen) = (rest / SETS, rest % SETS);
        let hand = if held < GRIPS { Hand::Track } else { Hand::Postument };
        let at = place.checked_sub(1).and_then(Stop::numbered);
        Self { hand, grip: held % GRIPS, seen, at }
    }
}

/// Returns the number of a place of the hands, less than [`PLACES`].
fn place_number(at: Option<Stop>) -> usize {
    at.map_or(0, |at| 1 + at.number())
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

/// Data of one search.
struct Search {
    /// Grips by their numbers.
    grips: Vec<Grip>,
    /// Number of grips in which a hand may grasp.
    choices: usize,
    /// Meeting of two grips: `[track grip * GRIPS + postument grip]`; `None` where both hands
    /// cannot hold so.
    meetings: Vec<Option<Stop>>,
    /// Times of paths (s): `[(place * Stop::COUNT + meeting) * 2 + free hand]`, where place 0 is
    /// the start.
    seconds: Vec<f64>,
    /// Visible wanted faces with their sides, `[hand * GRIPS + grip]`: see [`views`].
    views: Vec<Vec<(usize, Face)>>,
    /// Time of a hand-over without its path (s).
    grasp: f64,
    /// Least time of a path to a view (s).
    least: f64,
}

impl Search {
    /// Tabulates the meetings, times and views.
    fn new(wanted: &Wanted, terms: &Terms, reach: &impl Reach) -> Self {
        let grips: Vec<Grip> = Grip::every().collect();
        let mut meetings = of_rotations(|track, postument| {
            reach.grasp(*track, *postument)?;
            Some(Stop::grasp(rotation_index(&(track.inverse() * postument)) as u8))
        });
        for (pair, meeting) in meetings.iter_mut().enumerate() {
            let [track, postument] = [pair / GRIPS, pair % GRIPS].map(|grip| grips[grip].hold);
            *meeting = meeting.filter(|_| compatible(track, postument, terms.rule));
        }
        let hands = [Hand::Track, Hand::Postument];
        let stops = || (0..Stop::COUNT).filter_map(Stop::numbered);
        let (mut seconds, mut least) = (Vec::new(), f64::INFINITY);
        for from in std::iter::once(None).chain(stops().map(Some)) {
            for to in stops() {
                for hand in hands {
                    let path = reach.path(from, to, hand);
                    seconds.push(path);
                    least = if to.is_view() { path.min(least) } else { least };
                }
            }
        }
        Self {
            choices: terms.depths.grips(),
            meetings,
            views: (0..2 * GRIPS)
                .map(|n| views(hands[n / GRIPS], grips[n % GRIPS], wanted, reach))
                .collect(),
            grasp: terms.costs.grasp,
            seconds,
            least,
            grips,
        }
    }

    /// Returns the time of the path between two places of the hands (s). `free` is the hand that
    /// does not hold the cube.
    fn path(&self, from: Option<Stop>, to: Stop, free: Hand) -> f64 {
        let place = place_number(from);
        self.seconds[(place * Stop::COUNT + to.number()) * 2 + free.index()]
    }

    /// Returns a lower bound of the time until all faces were seen (s).
    fn rest(&self, state: &State) -> f64 {
        f64::from((ALL & !state.seen).count_ones()) * self.least
    }

    /// Returns the steps of the quickest path from `start` to a state in which all faces were seen.
    fn quickest(&self, start: State) -> Option<Vec<Step>> {
        let none = Best { seconds: f64::INFINITY, from: None };
        let mut best = vec![none; State::COUNT];
        best[start.index()].seconds = 0.0;
        // A positive number and its bits, read as an integer, have the same order.
        let mut open = BinaryHeap::from([Reverse((self.rest(&start).to_bits(), start.index()))]);
        while let Some(Reverse((bits, index))) = open.pop() {
            let (seconds, state) = (best[index].seconds, State::with_index(index));
            // The state was reached sooner after this entry.
            if f64::from_bits(bits) > seconds + self.rest(&state) {
                continue;
            }
            if state.seen == ALL {
                return Some(written(index, &best));
            }
            self.expand(state, |next, step, cost| {
                let (to, seconds) = (next.index(), seconds + cost);
                // Times that differ by rounding alone keep the earlier path.
                if seconds < best[to].seconds - 1e-9 {
                    best[to] = Best { seconds, from: Some((index, step)) };
                    open.push(Reverse(((seconds + self.rest(&next)).to_bits(), to)));
                }
            });
        }
        None
    }

    /// Calls `reached` for each look and each hand-over that is possible in a state: with the state
    /// after it, the step, and its time (s).
    fn expand(&self, state: State, mut reached: impl FnMut(State, Move, f64)) {
        let viewer = state.hand.other();
        for &(side, face) in &self.views[state.hand.index() * GRIPS + state.grip] {
            let bit = 1 << face.index();
            if state.seen & bit == 0 {
                let at = Stop::view(state.hand, side);
                let next = State { seen: state.seen | bit, at: Some(at), ..state };
                reached(next, Move::Look(face), self.path(state.at, at, viewer));
            }
        }
        for (grip, &newcomer) in self.grips.iter().enumerate().take(self.choices) {
            let (track, postument) =
                if viewer == Hand::Track { (grip, state.grip) } else { (state.grip, grip) };
            if let Some(at) = self.meetings[track * GRIPS + postument] {
                let next = State { hand: viewer, grip, at: Some(at), ..state };
                let seconds = self.path(state.at, at, viewer) + self.grasp;
                reached(next, Move::HandOver(viewer, newcomer), seconds);
            }
        }
    }
}

/// Returns the wanted faces of a held cube that the other hand's camera can see, each with its
/// side: 0 is +z, 1 is +x and 2 is -x of the holder's tool.
fn views(holder: Hand, grip: Grip, wanted: &Wanted, reach: &impl Reach) -> Vec<(usize, Face)> {
    let rotation: Rotation24 = grip.rotation();
    [Face::U, Face::R, Face::L]
        .into_iter()
        .enumerate()
        .filter(|(side, _)| reach.view(holder, *side))
        .map(|(side, normal)| (side, rotation.face(normal)))
        .filter(|&(_, face)| {
            wanted.faces[face.index()] && !wanted.hidden.contains(&(holder, grip.hold, face))
        })
        .collect()
}

/// Returns the steps that lead to the state with the index `end`.
fn written(end: usize, best: &[Best]) -> Vec<Step> {
    let (mut moves, mut at) = (Vec::new(), end);
    while let Some((before, step)) = best[at].from {
        moves.push((before, step));
        at = before;
    }
    let mut steps = Vec::new();
    for (before, step) in moves.into_iter().rev() {
        let holder = State::with_index(before).hand;
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
    use crate::motion::Depth;
    use nalgebra::UnitQuaternion;

    /// A cell whose cameras can be brought before only one side of the cube in a hand.
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

    /// Returns the track hand with its palm on face D, over this number of layers.
    fn start(depth: Depth) -> (Hand, Grip) {
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth };
        (Hand::Track, Grip { hold, half_roll: false })
    }

    /// Returns the number of grasps in a plan.
    fn hand_overs(steps: &[Step]) -> usize {
        steps.iter().filter(|s| matches!(s, Step::Grasp { .. })).count()
    }

    /// Returns the faces at which a plan looks, in the order URFDLB.
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

            assert_eq!(hand_overs(&steps), 5, "side {side}");
            assert_eq!(shown(&steps), Face::ALL);
        }
    }

    /// Arms whose times from stop to stop (s) are given by a function. Cameras can see only a cube
    /// in the track hand.
    struct Timed<F>(F);

    impl<F: Fn(Option<Stop>, Stop) -> f64> Reach for Timed<F> {
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
            self.0(from, to)
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
        // A path takes longer the farther the sides are apart, and 2, 0, 1 is the quickest order.
        let place = |stop: Stop| [1.0_f64, 5.0, 0.0][stop.number() % 3];
        let arms = Timed(|from: Option<Stop>, to: Stop| {
            from.map_or(place(to), |from| (place(from) - place(to)).abs() + 0.1)
        });

        let steps = looks((hand, grip), &wanted, &Terms::of(Rule::Clearance), &arms).unwrap();

        assert_eq!(steps, sides.map(|face| Step::Look { viewer: hand.other(), face }));
    }

    /// A quicker order than the one found would show that the lower bound of the search is too
    /// high.
    #[test]
    fn no_order_of_looks_is_quicker() {
        use rand::{Rng as _, SeedableRng as _};
        let (hand, grip) = start(Depth::One);
        let visible = [Face::U, Face::R, Face::L].map(|side| grip.rotation().face(side));
        let mut faces = [false; 6];
        for face in visible {
            faces[face.index()] = true;
        }
        let wanted = Wanted { faces, hidden: Vec::new() };
        for seed in 0..50 {
            let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
            let times: Vec<f64> =
                (0..PLACES * Stop::COUNT).map(|_| random.random_range(0.5..4.0)).collect();
            let reach = Timed(|from: Option<Stop>, to: Stop| {
                times[from.map_or(0, |from| 1 + from.number()) * Stop::COUNT + to.number()]
            });
            let seconds = |order: [usize; 3]| {
                let stops = order.map(|side| Stop::view(hand, side));
                let from = [None, Some(stops[0]), Some(stops[1])];
                let paths = from.into_iter().zip(stops);
                paths.map(|(from, to)| reach.path(from, to, hand.other())).sum::<f64>()
            };

            let steps = looks((hand, grip), &wanted, &Terms::of(Rule::Clearance), &reach).unwrap();

            let order: Vec<usize> = steps
                .iter()
                .filter_map(|step| match step {
                    Step::Look { face, .. } => visible.iter().position(|seen| seen == face),
                    _ => None,
                })
                .collect();
            let found = seconds(order.try_into().unwrap());
            let all = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
            let least = all.map(seconds).into_iter().fold(f64::INFINITY, f64::min);
            assert!((found - least).abs() < 1e-9, "{seed}: {found} {least}");
        }
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
