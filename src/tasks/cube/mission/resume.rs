//! A mission goes on where another run was broken off, at whatever moment.
//!
//! The jaws tell what the hands hold, the tools which layer is misaligned, and the cameras what has
//! become of the cube; the other run's journal only says what cannot be seen.
//!
//! - in: the last entry of the journal, both arms as they stand
//! - out: the station at which the mission goes on
//! - source: own work
//!
//! | limit | value | reason |
//! |---|---|---|
//! | [`GONE`] | 0.945 edge | jaws nearer than this hold no cube: less than a held cube's least width, more than closed jaws |
//! | [`STRAIGHT`] | 0.1 rad | a layer that stands off by less is straightened by the jaws that close over it |
//! | [`TAKEN_BACK`], [`SEEKS`] | 3 s, 5 s | a cube is left to whoever takes it back, and then looked for |

use super::actions::Closing;
use super::failure::Failure;
use super::robot::{MOST_CLOSER, MOST_WIDER, MaybeOffered, Robot};
use super::station::Station;
use super::take::{CLEAR, draw_back_with_cube, wait_for_release};
use super::turn_in_progress::TurnInProgress;
use super::{give_back, regrasp, turn};
use crate::cube::{Axis, Face, Keeper, rotations};
use crate::motion::Depth;
use crate::tasks::Entry;
use crate::tasks::cube::hold::{Grip, Hand, Hold};
use nalgebra::{UnitQuaternion, Vector3};

/// Jaws nearer than this share of the edge hold no cube.
const GONE: f64 = 0.945;
/// A layer that stands off by less is straightened by the jaws that close over it (rad).
const STRAIGHT: f64 = 0.1;
/// A way that is not worth a motion (m).
const NEARLY: f64 = 1e-3;
/// How long a cube is left to whoever takes it back, and how long it is looked for then (s).
const TAKEN_BACK: f64 = 3.0;
const SEEKS: f64 = 5.0;

/// Finds out which hands hold the cube, and goes on from there.
pub(super) async fn take_stock(robot: &mut Robot, last: Entry) -> Result<Station, Failure> {
    restore(robot, &last);
    robot.note(format!("the other run was broken off while {}", last.doing));
    let edge = robot.settings.edge;
    let holds = |hand: Hand| {
        let gap = robot.arms[hand.index()].jaw_opening;
        gap > GONE * edge && gap < edge + MOST_WIDER
    };
    match Hand::BOTH.map(holds) {
        [false, false] if last.over || last.handing_back => was_handed_back(robot, last).await,
        [false, false] => take_anew(robot).await,
        [true, true] => both_hold(robot, &last).await,
        [true, false] => one_holds(robot, Hand::Track, &last).await,
        [false, true] => one_holds(robot, Hand::Postument, &last).await,
    }
}

/// Takes over what the other run noted.
fn restore(robot: &mut Robot, last: &Entry) {
    (robot.hand_over, robot.taken_at) = (last.hand_over, last.taken_at);
    robot.retract_shortfall = last.short;
    robot.stops = Hand::BOTH.map(|hand| depth(last, hand));
    let meetings = &robot.settings.meetings;
    let places = meetings.grasps.iter().flatten().map(|m| m.track_back.0[0]);
    let least = places.fold(f64::INFINITY, f64::min) - meetings.separation;
    let track = robot.arms[Hand::Track.index()].desired_joints.0[0];
    // An arm that was on one of the short ways is not as far back as any way needs it.
    let share = if meetings.ways.is_empty() { 0.5 } else { 0.1 };
    robot.apart = track < least + share * meetings.separation;
    robot.least_track = Some(least);
}

/// Returns the hold that a hand most likely has, as deep as was noted.
fn usual(last: &Entry, hand: Hand) -> Hold {
    Hold { palm: Face::D, jaws: Axis::Y, depth: depth(last, hand) }
}

/// Returns how deep a hand holds, as far as that was noted.
fn depth(last: &Entry, hand: Hand) -> Depth {
    last.held[hand.index()].or(last.stops[hand.index()]).unwrap_or(Depth::One)
}

/// Ends a mission whose cube went back, or looks for a cube that may not have been taken.
async fn was_handed_back(robot: &mut Robot, last: Entry) -> Result<Station, Failure> {
    robot.given_back = true;
    robot.failure = last.undone;
    let way = robot.free_way(Hand::Track, robot.settings.back);
    let seeks = !last.over && robot.settings.keeper == Keeper::Person;
    if seeks {
        begin_to_seek(robot);
    }
    robot.phase("take stock").await?;
    if !last.over {
        back_off(robot, way).await?;
    }
    if seeks {
        return seek(robot).await;
    }
    let achieved = robot.failure.is_none();
    give_back::finish(robot, achieved).map(Station::Over)
}

/// Takes a cube anew that no hand holds.
async fn take_anew(robot: &mut Robot) -> Result<Station, Failure> {
    robot.note("no hand holds the cube: it is taken anew");
    robot.forget_hand_over();
    let way = robot.free_way(Hand::Track, robot.settings.back);
    robot.phase("take stock").await?;
    back_off(robot, way).await?;
    robot.move_apart().await?;
    Ok(Station::Take)
}

/// Moves the track hand out of the way (m), before it goes sideways or its force is zeroed: it may
/// have its fingers beside a cube that somebody else has, and press it.
async fn back_off(robot: &mut Robot, way: f64) -> Result<(), Failure> {
    robot.open(Hand::Track, Depth::One).await?;
    robot.along(Hand::Track, -way).await
}

/// Begins to look for a cube that the other run was about to hand back, since no entry says that it
/// was taken.
fn begin_to_seek(robot: &mut Robot) {
    robot.note("the cube was being handed back: it is looked for");
    robot.seeks = Some(SEEKS);
    robot.forget_hand_over();
}

/// Gives the operator time to take the cube, and then takes it where it is held out.
async fn seek(robot: &mut Robot) -> Result<Station, Failure> {
    robot.move_apart().await?;
    robot.stand(TAKEN_BACK).await?;
    Ok(Station::Take)
}

/// Leaves the cube to the person who has it, or holds it and does not let go.
pub(super) async fn leave_to_the_operator(
    robot: &mut Robot,
    why: String,
) -> Result<Station, Failure> {
    robot.note(format!("{why}: whoever it was handed back to has it"));
    robot.given_back = true;
    robot.failure = robot.earlier.as_ref().and_then(|last| last.undone.clone());
    begin_to_seek(robot);
    regrasp::let_go(robot, Hand::Track).await?;
    seek(robot).await
}

/// Goes on with the cube in one hand.
async fn one_holds(robot: &mut Robot, hand: Hand, last: &Entry) -> Result<Station, Failure> {
    robot.note(format!("the {} hand holds the cube", hand.name()));
    let (other, hold) = (hand.other(), usual(last, hand));
    robot.belief.taken(hand, hold, false);
    let left = robot.way_back_left();
    if hand == Hand::Track && robot.settings.keeper == Keeper::Person {
        let is_out = last.hand_over.is_some() && left > Some(NEARLY);
        let gap = robot.arms[Hand::Track.index()].jaw_opening;
        let opening = last.handing_back && gap > robot.settings.edge - MOST_CLOSER;
        robot.maybe_offered = (last.handing_back || is_out).then_some(MaybeOffered { opening });
    }
    let clear = way_to_clear(robot, other);
    robot.phase("take stock").await?;
    // What a sensor reported before this run began is relative to a zero that nobody knows.
    robot.zero_forces([hand == Hand::Track, hand == Hand::Postument]).await?;
    robot.close(hand, hold, Closing::Straight).await?;
    let stops = robot.stops[other.index()];
    robot.open(other, stops).await?;
    if let Some(way) = clear {
        robot.along(other, -way).await?;
    }
    settle(robot, hand, left).await
}

/// Returns what is left of the way back for an empty hand that may have its fingers beside the
/// cube (m): a limit of the arm may be near behind that.
fn way_to_clear(robot: &mut Robot, hand: Hand) -> Option<f64> {
    let (edge, back) = (robot.settings.edge, robot.settings.back);
    let place = robot.belief.centre_in_tool(hand, &robot.arms)?;
    if place.norm() >= 3.0 * edge {
        return None;
    }
    // Where it would have had one layer, the lesser way of the two.
    let gone = place.z - edge / 3.0;
    let left = (back - gone).clamp(0.0, back);
    (left >= NEARLY).then(|| robot.folds(hand, left, CLEAR * back - gone))
}

/// Brings the cube clear of the place of hand-over, with `left` of the way back to go (m). Without a
/// place to hand it back, the operator may still have hold of it.
async fn settle(robot: &mut Robot, holder: Hand, left: Option<f64>) -> Result<Station, Failure> {
    match (robot.hand_over, holder, robot.settings.keeper) {
        (None, Hand::Track, _) => {
            let way = left.unwrap_or(robot.way_back());
            draw_back_with_cube(robot, way).await?;
        }
        (Some(place), _, _) if robot.maybe_offered.is_some() => {
            wait_for_release(robot).await?;
            if left > Some(NEARLY) {
                robot.joints([Some(place), None]).await?;
            }
            // It was zeroed where somebody may have had hold of it.
            robot.zero_forces([true, false]).await?;
        }
        // It may stand on the table, or just above: not along it, but up from there.
        (_, Hand::Track, Keeper::Table) => {
            if let Some(left) = left.filter(|left| *left > 0.0) {
                robot.along(holder, -left).await?;
            }
        }
        _ => {}
    }
    Ok(Station::Read { phase: "identify" })
}

/// Goes on with the cube in both hands, perhaps in the middle of a turn.
async fn both_hold(robot: &mut Robot, last: &Entry) -> Result<Station, Failure> {
    robot.note("both hands hold the cube");
    robot.apart = false;
    robot.phase("take stock").await?;
    for hand in Hand::BOTH {
        robot.close(hand, usual(last, hand), Closing::Straight).await?;
    }
    robot.check_hold()?;
    let Misaligned { turner, by, grip } = find_misaligned(robot, last);
    let body = turner.other();
    robot.belief.taken(body, usual(last, body), false);
    robot.belief.taken(turner, grip.hold, grip.half_roll);
    let left = robot.way_back_left();
    if by.abs() > STRAIGHT {
        let degrees = by.to_degrees();
        let name = turner.name();
        robot.note(format!("a layer stands askew: the {name} hand turns it by {degrees:.0} deg"));
        let roll = robot.arms[turner.index()].desired_joints.0[6] + by;
        robot.turn_in_progress = Some(TurnInProgress::new(turner, grip, roll, by.signum()));
        turn::turn_through(robot, turner, by).await?;
    }
    regrasp::let_go(robot, turner).await?;
    settle(robot, body, left).await
}

/// A layer that may be misaligned between both hands.
#[derive(Debug)]
struct Misaligned {
    /// The hand that has the layer.
    turner: Hand,
    /// By how much more about its own z the layer is in line (rad).
    by: f64,
    /// Its grip then, as seen from the usual hold of its partner.
    grip: Grip,
}

/// Finds out by how the tools stand to each other which layer is misaligned.
fn find_misaligned(robot: &Robot, last: &Entry) -> Misaligned {
    let tool = |hand: Hand| {
        robot.belief.world_from_base(hand).rotation
            * robot.arms[hand.index()].desired_base_from_tool.rotation
    };
    let (track, postument) = (tool(Hand::Track), tool(Hand::Postument));
    let (turner, by) = misaligned(&track, &postument);
    let (own, other) = if turner == Hand::Track { (track, postument) } else { (postument, track) };
    let straight = own * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), by);
    let body = usual(last, turner.other()).cube_from_tool(false, robot.settings.edge).rotation;
    let cube_from_turner = body * other.inverse() * straight;
    let (hold, half_roll) = Hold::from_tool_rotation(&cube_from_turner, depth(last, turner));
    Misaligned { turner, by, grip: Grip { hold, half_roll } }
}

/// Returns which hand turns a layer, and by how much more about its own z the layer is in line
/// (rad): of the 24 ways in which two straight tools stand to each other the nearest, over a roll of
/// one of them.
fn misaligned(track: &UnitQuaternion<f64>, postument: &UnitQuaternion<f64>) -> (Hand, f64) {
    let mut best = (f64::INFINITY, Hand::Track, 0.0);
    for (hand, own, other) in [(Hand::Track, track, postument), (Hand::Postument, postument, track)]
    {
        for straight in rotations() {
            // own * roll = other * straight
            let off = own.inverse() * other * straight;
            let roll = 2.0 * libm::atan2(off.k, off.w);
            let roll = roll - (roll / std::f64::consts::TAU).round() * std::f64::consts::TAU;
            let rest = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -roll) * off;
            // A small roll with a small rest; the rest weighs more, since only rolls are real.
            let cost = 10.0 * rest.angle() + roll.abs();
            if cost < best.0 {
                best = (cost, hand, roll);
            }
        }
    }
    (best.1, best.2)
}

#[cfg(test)]
mod tests {
    use super::super::assignment::{Assignment, Goal};
    use super::super::testing::{
        Stage, WIDTH, goes_well, order, play_mission, settings, track, words,
    };
    use super::super::{Mission, mend};
    use super::*;
    use crate::generators::{Behaviour, Outcome};
    use crate::motion::{ArmState, JointPositions};
    use crate::reach::Fold;
    use crate::spatial::Pose;
    use crate::tasks::cube::settings::CubeSettings;
    use crate::tasks::cube::think::Thought;
    use crate::tasks::{Action, Event, Finish, Forces, Readings, Task};

    /// Notes of a run that had taken the cube there, and lowered it again.
    fn lowering() -> Entry {
        Entry {
            doing: "laying it down".to_owned(),
            held: [Some(Depth::Two), None],
            hand_over: Some(JointPositions([0.3; 7])),
            taken_at: Some([0.5, 0.1, 0.7]),
            handing_back: true,
            ..Entry::default()
        }
    }

    /// A robot that goes on from an entry, with empty hands.
    fn stage(settings: CubeSettings, last: &Entry) -> Stage {
        let assignment = Assignment::new(Goal::Solve).resumed(Some(last.clone()));
        Stage::with(settings, assignment)
    }

    fn takes_stock(
        stage: &mut Stage,
        last: &Entry,
    ) -> (Result<Station, Failure>, Vec<Action<Thought>>) {
        let last = last.clone();
        stage.play(async |robot| take_stock(robot, last).await, &mut goes_well)
    }

    /// Goes on from an entry with the cube in the track hand, `above` where it was taken (m).
    fn goes_on(keeper: Keeper, last: &Entry, above: f64) -> (Stage, Vec<Action<Thought>>) {
        let mut stage = stage(CubeSettings { keeper, ..settings() }, last);
        stage.robot.arms[0].jaw_opening = WIDTH;
        stage.robot.arms[0].desired_base_from_tool = Pose::translation(0.5, 0.1, 0.7 + above);
        let (end, actions) = takes_stock(&mut stage, last);
        assert_eq!(end, Ok(Station::Read { phase: "identify" }));
        (stage, actions)
    }

    /// Returns how far the track moves along its z, in turn (m).
    fn ways(stage: &Stage, actions: &[Action<Thought>]) -> Vec<f64> {
        let from = stage.robot.arms[0].desired_base_from_tool;
        let way = |action: &Action<Thought>| match action {
            Action::Behave { orders: [Some(Behaviour::Line { target, .. }), _], .. } => {
                Some((from.inverse() * target).translation.z)
            }
            _ => None,
        };
        actions.iter().filter_map(way).collect()
    }

    fn position(words: &[&str], word: &str) -> Option<usize> {
        words.iter().position(|w| *w == word)
    }

    #[test]
    fn lowered_cube_is_lifted_before_it_is_read() {
        let back = settings().back;
        for above in [0.0, 0.02] {
            for short in [0.0, 0.01] {
                // The arm did not fold farther than it had.
                let last = Entry { short, ..lowering() };
                let (stage, actions) = goes_on(Keeper::Table, &last, above);

                let [way] = ways(&stage, &actions)[..] else { panic!("{:?}", words(&actions)) };
                assert!((way + (back - short - above)).abs() < 1e-12, "{way}");
                // It is closed upon first, and the place of hand-over is known.
                let words = words(&actions);
                assert!(position(&words, "close") < position(&words, "line"), "{words:?}");
                assert_eq!(stage.robot.hand_over, last.hand_over);
            }
        }
        for above in [1.001 * back, 2.0 * back] {
            let (stage, actions) = goes_on(Keeper::Table, &lowering(), above);
            assert!(ways(&stage, &actions).is_empty(), "{above}");
        }
        // No table is below a cube that a person is given back.
        let (stage, actions) = goes_on(Keeper::Person, &lowering(), 0.02);
        assert!(ways(&stage, &actions).is_empty());
    }

    #[test]
    fn offered_cube_is_pulled_at_before_it_is_drawn_back() {
        let back = settings().back;
        // The entry of a cube on its way out, and of one that had been held out.
        for handing_back in [false, true] {
            let last = Entry { handing_back, ..lowering() };
            let words = words(&goes_on(Keeper::Person, &last, 0.02).1);
            let zeroed = position(&words, "zero");
            let (close, pull) = (position(&words, "close"), position(&words, "pull"));
            let back_at = position(&words, "joints");
            assert!(zeroed.is_some() && zeroed < close && close < pull, "{words:?}");
            assert!(pull < back_at && back_at.is_some(), "{words:?}");

            // Drawn back already, or farther.
            let words = super::super::testing::words(&goes_on(Keeper::Person, &last, 1.5 * back).1);
            assert_eq!(position(&words, "pull").is_some(), handing_back, "{words:?}");
            assert_eq!(position(&words, "joints"), None, "{words:?}");
        }
    }

    #[test]
    fn track_goes_the_rest_of_the_way_back() {
        let back = settings().back;
        let taking = Entry { hand_over: None, handing_back: false, ..lowering() };
        let nowhere = Entry { taken_at: None, ..taking.clone() };
        for keeper in [Keeper::Person, Keeper::Table] {
            for (last, above, left) in
                [(&taking, 0.02, back - 0.02), (&taking, 2.0 * back, 0.0), (&nowhere, 0.02, back)]
            {
                let (stage, actions) = goes_on(keeper, last, above);

                let [way] = ways(&stage, &actions)[..] else { panic!() };
                assert!((way + left).abs() < 1e-12, "{way} {left}");
                assert!(stage.robot.hand_over.is_some(), "the place is remembered");
                let waits = position(&words(&actions), "pull").is_some();
                assert_eq!(waits, keeper == Keeper::Person);
            }
        }
    }

    #[test]
    fn empty_hand_clears_its_partners_cube() {
        let (desired_joints, stand) = Fold::example_stand();
        let goes = settings().folds[1].way(&stand, &desired_joints, 0.3);
        let (back, edge) = (goes / 0.6, settings().edge);
        let way = |gone: f64| {
            let mut stage = stage(CubeSettings { back, ..settings() }, &lowering());
            let cube = stand * Pose::translation(0.0, 0.0, edge / 3.0 + gone);
            stage.robot.arms[0].desired_base_from_tool = cube;
            stage.robot.arms[1].desired_base_from_tool = stand;
            stage.robot.arms[1].desired_joints = desired_joints;
            stage.robot.belief.taken(Hand::Track, usual(&lowering(), Hand::Track), false);
            way_to_clear(&mut stage.robot, Hand::Postument)
        };
        let near = |way: Option<f64>, wanted: f64| way.is_some_and(|w| (w - wanted).abs() < 1e-9);

        assert!(near(way(0.0), back), "the cube stays between its fingers: the arm refuses");
        assert!(near(way(0.1 * back), goes), "far enough in all");
        assert!(near(way(0.5 * back), 0.5 * back));
        assert!(near(way(-0.1 * back), back), "deeper than it ever holds");
        assert_eq!(way(back), None, "it has gone");
        assert_eq!(way(3.0 * edge), None, "far from it");
    }

    #[test]
    fn empty_hand_backs_off_before_it_zeroes() {
        let (desired_joints, desired_base_from_tool) = Fold::example_stand();
        let settings = CubeSettings { back: 0.3, ..settings() };
        let goes = settings.folds[0].way(&desired_base_from_tool, &desired_joints, 0.3);
        let taking = Entry { held: [None; 2], hand_over: None, handing_back: false, ..lowering() };
        let mut stage = stage(settings, &taking);
        let arm = ArmState { desired_joints, desired_base_from_tool, ..stage.robot.arms[0] };
        stage.robot.arms = [arm; 2];

        let (end, actions) = takes_stock(&mut stage, &taking);

        assert_eq!(end, Ok(Station::Take));
        assert_eq!(words(&actions)[..3], ["take stock", "open", "line"]);
        let [way] = ways(&stage, &actions)[..] else { panic!() };
        assert!((way + goes).abs() < 1e-9 && goes < 0.3, "{way} {goes}");
        assert_eq!(stage.robot.hand_over, None, "nothing is known of the next place");
    }

    #[test]
    fn released_cube_is_left_before_the_end() {
        let ends = |over: bool| {
            let last = Entry { held: [None; 2], over, ..lowering() };
            let mut stage = stage(settings(), &last);
            let (end, actions) = takes_stock(&mut stage, &last);
            (end, words(&actions))
        };

        let (end, words) = ends(false);
        assert_eq!(end, Ok(Station::Take), "it is looked for");
        assert_eq!(words[..3], ["take stock", "open", "line"]);
        let (end, words) = ends(true);
        assert!(matches!(end, Ok(Station::Over(Finish { achieved: true, .. }))), "{end:?}");
        assert_eq!(words, ["take stock"], "it had left the cube");
    }

    /// Plays a mission that goes on from an entry, with the track's jaws `gap` apart (m), whose
    /// behaviours end as told.
    fn played(
        last: Entry,
        gap: f64,
        mut ends: impl FnMut(&Behaviour) -> Option<Outcome>,
    ) -> (Finish, Vec<&'static str>) {
        let assignment = Assignment::new(Goal::Solve).resumed(Some(last));
        let mut mission = Mission::new(settings(), assignment);
        let mut arms = [ArmState { jaw_opening: 0.09, ..ArmState::default() }; 2];
        arms[0].jaw_opening = gap;
        arms[0].desired_base_from_tool = Pose::translation(0.5, 0.1, 0.7);
        let (end, actions) =
            play_mission(&mut mission, arms, &mut |action, arms| match order(action)
                .and_then(&mut ends)
            {
                Some(outcome) => {
                    if let Outcome::Grasped(width) = outcome {
                        arms[0].jaw_opening = width;
                    }
                    track(outcome)
                }
                None => goes_well(action, arms),
            });
        (end, words(&actions))
    }

    /// Plays the end of a hand-back: the jaws end so at first, and then a small pull each time.
    fn offered(gap: f64, closed: Outcome, pulled: Outcome) -> (Finish, Vec<&'static str>) {
        let last = Entry { doing: "handing back".to_owned(), ..lowering() };
        played(last, gap, |order| match order {
            Behaviour::Grasp { .. } => Some(closed),
            Behaviour::Withdraw { .. } => Some(pulled),
            Behaviour::VisualServo(_) => Some(Outcome::LostSight(5.0)),
            _ => None,
        })
    }

    #[test]
    fn holder_of_an_offered_cube_keeps_it() {
        use super::super::take::RELEASE_TRIES;
        // Opened after they had closed, and before the cube is looked for.
        let opened = |words: &[&str]| {
            let closed = position(words, "close").unwrap();
            let sought = position(words, "acquire").unwrap_or(words.len());
            let hands = words[closed..sought].iter().filter(|word| **word == "open").count();
            // The empty postument hand opens, too, once the cube is known to be held.
            hands > usize::from(words[closed..sought].contains(&"pull"))
        };

        // Jaws that were opening, and close on nothing.
        let (end, words) = offered(0.058, Outcome::Empty(0.053), Outcome::NotTouched);
        assert!(end.achieved && end.reason == give_back::UNSEEN, "{}", end.reason);
        assert!(opened(&words) && position(&words, "pull").is_none(), "{words:?}");
        // Jaws that had closed farther than on a cube have lost it.
        let (end, words) = offered(0.055, Outcome::Empty(0.053), Outcome::NotTouched);
        assert!(!end.achieved && end.reason.contains("do not hold"), "{}", end.reason);
        assert!(!opened(&words), "{words:?}");
        // A cube that is pressed while they close is not let go.
        let (end, words) = offered(0.057, Outcome::OverForce(2, 25.0), Outcome::NotTouched);
        assert!(!end.achieved && !opened(&words), "{}", end.reason);
        // Somebody holds on to it.
        let (end, words) = offered(0.057, Outcome::Grasped(0.057), Outcome::Touched(0.001));
        assert!(end.achieved && end.reason == give_back::UNSEEN, "{}", end.reason);
        let pulls = words.iter().filter(|word| **word == "pull").count();
        assert!(opened(&words) && pulls > RELEASE_TRIES as usize, "{pulls}");
    }

    #[test]
    fn closed_jaws_on_the_way_out_were_not_opening() {
        // The journal does not yet tell this of as handing back.
        let last = Entry { handing_back: false, ..lowering() };

        let (end, _) = played(last, 0.0565, |order| match order {
            Behaviour::Grasp { .. } => Some(Outcome::Empty(0.053)),
            _ => None,
        });

        assert!(!end.achieved && end.reason.contains("do not hold"), "{}", end.reason);
    }

    #[test]
    fn offered_cube_that_is_pulled_out_did_not_fall() {
        let mut stage = stage(settings(), &lowering());
        stage.robot.hold(Hand::Track);
        stage.robot.maybe_offered = Some(MaybeOffered { opening: false });

        let mut failure = Failure::Lost(Hand::Track);
        let end = loop {
            let now = failure.clone();
            let mends = async |robot: &mut Robot| mend::mend(robot, now).await;
            match stage.play(mends, &mut goes_well).0 {
                Err(next) => failure = next,
                Ok(station) => break station,
            }
        };

        assert_eq!(end, Station::Take);
        assert_eq!((stage.robot.log.drops, stage.robot.given_back), (0, true));
        assert!(stage.robot.seeks.is_some() && stage.robot.drop_site.is_none());
    }

    #[test]
    fn retaken_cube_was_not_handed_back() {
        let last = Entry { held: [None; 2], ..lowering() };

        let (end, _) = played(last, 0.09, |order| match order {
            Behaviour::VisualServo(_) | Behaviour::Withdraw { .. } => Some(Outcome::Touched(0.001)),
            _ => None,
        });

        assert!(!end.achieved && end.reason.contains("does not let go"), "{}", end.reason);
    }

    /// Plays a mission whose cube an earlier run was handing back: the visual servo ends so.
    fn sought(undone: Option<&str>, ended: Outcome) -> (Finish, Vec<&'static str>, Option<f64>) {
        let undone = undone.map(str::to_owned);
        let doing = "opening the jaws".to_owned();
        let last = Entry { held: [None; 2], undone, doing, ..lowering() };
        let mut patience = None;
        let (end, words) = played(last, 0.09, |order| match order {
            Behaviour::VisualServo(order) => {
                patience = Some(order.patience);
                Some(ended)
            }
            _ => None,
        });
        (end, words, patience)
    }

    #[test]
    fn cube_of_an_earlier_run_is_looked_for() {
        for nobody in [Outcome::LostSight(5.0), Outcome::OutOfZone(5.0)] {
            let (end, _, patience) = sought(None, nobody);
            assert!(end.achieved && end.reason.contains("nobody has held it out"));
            assert_eq!(patience, Some(SEEKS));

            let (end, ..) = sought(Some("face U cannot be read"), nobody);
            let told = "face U cannot be read; by the other run's journal";
            assert!(!end.achieved && end.reason.starts_with(told), "{}", end.reason);
        }
        // Held out again, it is taken and read.
        let (end, words, _) = sought(Some("face U cannot be read"), Outcome::Touched(3.0));
        assert!(words.contains(&"look"), "{words:?}");
        assert!(!end.reason.starts_with("face U cannot be read; by the other"), "{}", end.reason);
    }

    #[test]
    fn place_of_a_lost_cube_is_not_noted_again() {
        let last = Entry { handing_back: false, short: 0.02, ..lowering() };
        let assignment = Assignment::new(Goal::Solve).resumed(Some(last));
        let mut mission = Mission::new(settings(), assignment);
        let arms = [ArmState { jaw_opening: 0.09, ..ArmState::default() }; 2];
        let readings = Readings { arms: &arms, forces: Forces::default() };
        let stock = mission.next(Event::Start, &readings);
        assert!(matches!(stock, Action::Phase("take stock")) && mission.entry().is_none());

        mission.next(Event::Done, &readings);

        let noted = mission.entry().unwrap();
        assert_eq!(noted.doing, "opening the jaws");
        assert_eq!((noted.hand_over, noted.taken_at, noted.short), (None, None, 0.0));
    }

    #[test]
    fn resumed_mission_does_not_know_where_the_cube_is() {
        let begun = Mission::new(settings(), Assignment::new(Goal::Solve));
        assert_eq!(begun.whereabouts(), "the operator has the cube");

        let resumed = Mission::new(settings(), Assignment::new(Goal::Solve).resumed(None));
        assert!(resumed.whereabouts().ends_with("is not known"), "{}", resumed.whereabouts());
    }

    #[test]
    fn misaligned_layer_is_turned_back_by_its_hand() {
        let across = |r: &UnitQuaternion<f64>| (r * Vector3::z()).z.abs() < 0.1;
        let postument = rotations().into_iter().find(across).unwrap();
        for by in [-0.4, 0.4, 0.02] {
            let last = Entry { doing: "nothing yet".to_owned(), ..Entry::default() };
            let mut stage = stage(settings(), &last);
            let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), by);
            let none = nalgebra::Translation3::identity;
            stage.robot.arms = [roll, postument].map(|rotation| ArmState {
                jaw_opening: WIDTH,
                desired_base_from_tool: Pose::from_parts(none(), rotation),
                ..ArmState::default()
            });

            let (end, actions) = takes_stock(&mut stage, &last);

            assert_eq!(end, Ok(Station::Read { phase: "identify" }));
            let turn = actions.iter().find_map(|action| match order(action) {
                Some(Behaviour::Turn { angle, .. }) => Some(*angle),
                _ => None,
            });
            // The jaws straighten a layer that is off by little.
            match turn {
                Some(angle) => assert!(by.abs() > STRAIGHT && (angle + by).abs() < 1e-9, "{angle}"),
                None => assert!(by.abs() < STRAIGHT, "{by}"),
            }
            assert!(stage.robot.belief.held[0].is_none(), "the turner lets go");
        }
    }

    #[test]
    fn misaligned_layer_is_found_with_its_angle() {
        let track = UnitQuaternion::from_euler_angles(0.3, -0.7, 1.1);
        for straight in rotations() {
            let postument = track * straight;
            let z = track.inverse() * (postument * Vector3::z());
            if z.z > 0.9 {
                continue; // One palm under the other: no such grasp.
            }
            for by in [-0.7, -0.3, 0.2, 0.6] {
                let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), by);

                let (hand, found) = misaligned(&(track * roll), &postument);

                // Palms on opposite sides roll about one axis: either hand may undo it.
                let opposite = z.z < -0.9;
                assert!(opposite || hand == Hand::Track, "{hand:?}");
                assert!((found.abs() - by.abs()).abs() < 1e-6, "{found} {by}");
                if hand == Hand::Track {
                    assert!((found + by).abs() < 1e-6, "{found} {by}");
                }
            }
        }
    }
}
