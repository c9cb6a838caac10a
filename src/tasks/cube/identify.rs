//! The looks that show all six faces, or the wanted ones, with as few hand-overs as the reach
//! allows.
//!
//! - in: the hand that holds the cube and its grip, the views and grasps within reach, the wanted
//!   faces, and the faces that stay hidden in some hold
//! - out: steps that begin with the one hand's grip and end with one hand holding alone; each
//!   wanted face is looked at once
//! - method: a shortest path over holder, grip and set of seen faces
//!
//! A held cube shows the face opposite the palm and the two that are not under the jaws. The table
//! of meetings says before which of them the camera in the other hand can be brought. If it reaches
//! all three, one hand-over is enough: the second palm on the face opposite the first, its jaws
//! across.

use super::hold::{Grip, Hand, Hold, Step};
use super::plan::{Depths, NoPlan, Reach, Rule, Terms, compatible};
use crate::cube::{Face, Rotation24};
use crate::motion::Depth;

/// Number of grips of a hand: 24 over one layer, then 24 over two.
const GRIPS: usize = 48;
/// Number of pairs of hand and grip.
const STATES: usize = 2 * GRIPS;
/// Number of sets of seen faces.
const SETS: usize = 64;

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

/// Finds the cheapest steps that show all wanted faces, from a start in which one hand holds the
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
    let grips: Vec<Grip> = Grip::all(Depth::One).chain(Grip::all(Depth::Two)).collect();
    let seen = |hand: Hand, grip: Grip| {
        views(hand, grip, wanted, reach).fold(0, |s, f| s | 1 << f.index())
    };
    // An unwanted face counts as seen from the beginning, so every goal is the full set.
    let known = (0..6).filter(|&f| !wanted.faces[f]).fold(0, |s, f| s | 1 << f);
    let number = |(hand, grip): (Hand, Grip)| {
        let deep = if grip.hold.depth == Depth::Two { 24 } else { 0 };
        hand.index() * GRIPS + deep + grip.rotation().index()
    };
    let mut best = vec![f64::INFINITY; STATES * SETS];
    let mut from: Vec<Option<usize>> = vec![None; STATES * SETS];
    let mut settled = vec![false; STATES * SETS];
    let first = number(start) * SETS + (known | seen(start.0, start.1));
    best[first] = 0.0;
    // Dijkstra's algorithm over 96 * 64 states. A scan for the cheapest is quick enough here: one
    // search a reading, unlike the thousands of the planner.
    loop {
        let open = (0..best.len()).filter(|&n| !settled[n] && best[n].is_finite());
        let Some(at) = open.min_by(|&a, &b| best[a].total_cmp(&best[b])) else {
            return Err(NoPlan::Unseen);
        };
        if at % SETS == SETS - 1 {
            // The full set: all looks are made on the path to it.
            return Ok(written(at, &from, &grips, wanted, reach));
        }
        settled[at] = true;
        let hand = if at / SETS < GRIPS { Hand::Track } else { Hand::Postument };
        let held = grips[at / SETS % GRIPS];
        for &grip in choices(&grips, terms.depths) {
            if !can_meet((hand, held), grip, terms.rule, reach) {
                continue;
            }
            let next = (hand.other(), grip);
            let after = number(next) * SETS + ((at % SETS) | seen(next.0, next.1));
            // The path to the meeting is left out: it differs by a second or two between meetings,
            // and the planner's state for it is not worth its size here.
            let cost = best[at] + terms.costs.grasp + terms.costs.leave;
            if cost < best[after] - 1e-9 {
                (best[after], from[after]) = (cost, Some(at));
            }
        }
    }
}

/// Returns the first part of `grips`, which has those of the allowed depths.
fn choices(grips: &[Grip], depths: Depths) -> &[Grip] {
    if depths == Depths::One { &grips[..24] } else { grips }
}

/// Returns whether the free hand can grasp the cube in the grip `newcomer` while the other hand
/// holds it.
fn can_meet((hand, held): (Hand, Grip), newcomer: Grip, rule: Rule, reach: &impl Reach) -> bool {
    let (track, postument) = if hand == Hand::Track { (held, newcomer) } else { (newcomer, held) };
    compatible(held.hold, newcomer.hold, rule)
        && reach.grasp(track.rotation().quaternion(), postument.rotation().quaternion()).is_some()
}

/// Iterates over the wanted faces of a held cube that the other hand's camera can see.
fn views(
    holder: Hand,
    grip: Grip,
    wanted: &Wanted,
    reach: &impl Reach,
) -> impl Iterator<Item = Face> {
    let rotation: Rotation24 = grip.rotation();
    // The order of the sides in the table of meetings: +z, +x, -x of the holder's tool.
    [Face::U, Face::R, Face::L]
        .into_iter()
        .enumerate()
        .filter(move |(side, _)| reach.view(holder, *side))
        .map(move |(_, side)| rotation.face(side))
        .filter(move |&face| {
            wanted.faces[face.index()] && !wanted.hidden.contains(&(holder, grip.hold, face))
        })
}

/// Returns the steps that lead to the state `end`. `from` has the state before each state.
fn written(
    end: usize,
    from: &[Option<usize>],
    grips: &[Grip],
    wanted: &Wanted,
    reach: &impl Reach,
) -> Vec<Step> {
    let mut nodes = vec![end];
    while let Some(before) = nodes.last().and_then(|&n| from[n]) {
        nodes.push(before);
    }
    let (mut steps, mut seen) = (Vec::new(), Vec::new());
    // A face that several holds of the path show is looked at in the first of them.
    for (i, &node) in nodes.iter().rev().enumerate() {
        let hand = if node / SETS < GRIPS { Hand::Track } else { Hand::Postument };
        let grip = grips[node / SETS % GRIPS];
        if i > 0 {
            steps.push(Step::Grasp { hand, hold: grip.hold, half_roll: grip.half_roll });
            steps.push(Step::Leave { hand: hand.other() });
        }
        for face in views(hand, grip, wanted, reach) {
            if !seen.contains(&face) {
                seen.push(face);
                steps.push(Step::Look { viewer: hand.other(), face });
            }
        }
    }
    steps
}

#[cfg(test)]
mod tests {
    use super::super::plan::{ArmsAt, Everywhere, RollLimits};
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
