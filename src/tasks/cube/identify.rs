//! The looks that show all six faces, or those that are wanted, with as few hand-overs as the reach allows.
//!
//! - in: who holds the cube and how, which views and grasps are within reach, which faces were seen, and which stay
//!   hidden in which hold
//! - out: steps that begin with the one hand's grip and end with one hand holding alone, every face looked at once
//!
//! A held cube shows the face opposite the palm and the two that are not under the jaws; which of them the camera
//! in the other hand can be brought before is data. Without limits one hand-over is enough: the second palm on the
//! face opposite the first, its jaws across.

use super::hold::{Grip, Hand, Hold, Step};
use super::plan::{Depths, NoPlan, Reach, Rule, Terms, compatible};
use crate::cube::{Face, Rotation24};
use crate::motion::Depth;

/// Grips of one layer, then of two.
const GRIPS: usize = 48;
/// Hand and grip.
const STATES: usize = 2 * GRIPS;
/// Sets of faces.
const SETS: usize = 64;

/// What looks are to show.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wanted {
    /// Faces, in the order URFDLB.
    pub faces: [bool; 6],
    /// Faces that cannot be read while a hand holds the cube so.
    pub hidden: Vec<(Hand, Hold, Face)>,
}

impl Default for Wanted {
    /// All, and nothing is hidden.
    fn default() -> Self {
        Self { faces: [true; 6], hidden: Vec::new() }
    }
}

/// The cheapest looks from a start in which one hand holds the cube alone. Every [`Step::Look`] stands where its
/// viewer holds nothing; after a hand-over the former holder leaves first.
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
    loop {
        let open = (0..best.len()).filter(|&n| !settled[n] && best[n].is_finite());
        let Some(at) = open.min_by(|&a, &b| best[a].total_cmp(&best[b])) else {
            return Err(NoPlan::Unseen);
        };
        if at % SETS == SETS - 1 {
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
            // The way to the meeting differs by a second or two: not worth a state of its own here.
            let cost = best[at] + terms.costs.grasp + terms.costs.leave;
            if cost < best[after] - 1e-9 {
                (best[after], from[after]) = (cost, Some(at));
            }
        }
    }
}

fn choices(grips: &[Grip], depths: Depths) -> &[Grip] {
    if depths == Depths::One { &grips[..24] } else { grips }
}

fn can_meet((hand, held): (Hand, Grip), newcomer: Grip, rule: Rule, reach: &impl Reach) -> bool {
    let (track, postument) = if hand == Hand::Track { (held, newcomer) } else { (newcomer, held) };
    compatible(held.hold, newcomer.hold, rule)
        && reach.grasp(track.rotation().quaternion(), postument.rotation().quaternion()).is_some()
}

/// The faces of a held cube that are wanted and that the other hand's camera can see.
fn views(
    holder: Hand,
    grip: Grip,
    wanted: &Wanted,
    reach: &impl Reach,
) -> impl Iterator<Item = Face> {
    let rotation: Rotation24 = grip.rotation();
    // The sides of the table of meetings: +z, +x, -x of the holder's tool.
    [Face::U, Face::R, Face::L]
        .into_iter()
        .enumerate()
        .filter(move |(side, _)| reach.view(holder, *side))
        .map(move |(_, side)| rotation.face(side))
        .filter(move |&face| {
            wanted.faces[face.index()] && !wanted.hidden.contains(&(holder, grip.hold, face))
        })
}

/// The steps that lead to a node.
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
    use super::super::plan::{Everywhere, RollLimits, Stand};
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
        fn travel(&self, from: Option<Stand>, newcomer: Hand, meeting: u8) -> f64 {
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

    #[test]
    fn one_hand_over_shows_all_faces_where_the_cameras_reach_three_sides() {
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
    fn with_a_single_side_each_face_needs_its_own_hold() {
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
    fn without_a_view_there_is_no_way() {
        let blind = OneSide(7);

        let answer =
            looks(start(Depth::One), &Wanted::default(), &Terms::of(Rule::Clearance), &blind);

        assert_eq!(answer, Err(NoPlan::Unseen));
    }

    #[test]
    fn a_face_that_stays_hidden_in_a_hold_is_shown_in_another() {
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
    fn nothing_is_looked_at_when_nothing_is_wanted() {
        let wanted = Wanted { faces: [false; 6], hidden: Vec::new() };

        let steps =
            looks(start(Depth::One), &wanted, &Terms::of(Rule::Strict), &Everywhere).unwrap();

        assert_eq!(steps, []);
    }
}
