//! Resumption of a mission that another run left unfinished, at any moment.
//!
//! The jaws show which hands hold the cube, the tools show which layer is misaligned, and the
//! cameras read the cube. The other run's journal gives only the facts that no sensor measures.
//!
//! - in: the last entry of the journal, the states of both arms
//! - out: the station at which the mission continues
//! - source: own work
//!
//! | limit | value | reason |
//! |---|---|---|
//! | [`LEAST_HELD`] | 0.945 edge | between closed jaws and the least width of a held cube |
//! | [`STRAIGHT`] | 0.03 rad | above the errors of the bases; with 0.1, 2 of 100 kills failed |
//! | [`TAKE_BACK_SECONDS`] | 3 s | the operator may take the cube that was being handed back |
//! | [`SEEK_SECONDS`] | 5 s | an operator who wants that cube solved holds it out again |
//!
//! | hands that hold | decision |
//! |---|---|
//! | none, the journal says "handing back" | the cube is looked for, then counts as returned |
//! | none, the journal says "over" | the mission is over |
//! | none | the cube is taken again |
//! | one | a possible holder is detected by pulls, then the cube is read |
//! | both | a misaligned layer is turned into line, the turner lets go, the cube is read |

use super::actions::Closing;
use super::entry::Entry;
use super::failure::Failure;
use super::robot::{MOST_CLOSER, MOST_WIDER, MaybeOffered, Robot};
use super::station::Station;
use super::take::{CLEAR, retract_with_cube, wait_for_release};
use super::turn_in_progress::TurnInProgress;
use super::{give_back, regrasp, turn};
use crate::cube::{Axis, Face, Keeper, rotations};
use crate::motion::Depth;
use crate::tasks::cube::hold::{Grip, Hand, Hold};
use nalgebra::{UnitQuaternion, Vector3};

/// Jaw distance below which jaws hold no cube, as a share of the edge.
const LEAST_HELD: f64 = 0.945;
/// Angle of a layer below which it counts as in line (rad).
const STRAIGHT: f64 = 0.03;
/// Distance that is not worth a motion (m).
const NEGLIGIBLE: f64 = 1e-3;
/// Time that the operator has to take the cube, and the time of the search for it after that (s).
const TAKE_BACK_SECONDS: f64 = 3.0;
const SEEK_SECONDS: f64 = 5.0;

/// Determines which hands hold the cube, prepares the mission to continue from there, and returns
/// the station. `last` is the last journal entry of the earlier run.
pub(super) async fn take_stock(robot: &mut Robot, last: Entry) -> Result<Station, Failure> {
    restore(robot, &last);
    robot.note(format!("last journal entry of the earlier run: {doing}", doing = last.doing));
    robot.phase("take stock").await?;
    let edge = robot.settings.edge;
    // A kill may come between a journal entry and its motion, so the jaws decide and not the entry.
    let holds = |hand: Hand| {
        let gap = robot.arms[hand.index()].jaw_opening;
        gap > LEAST_HELD * edge && gap < edge + MOST_WIDER
    };
    match Hand::BOTH.map(holds) {
        [false, false] if last.over || last.handing_back => was_handed_back(robot, last).await,
        [false, false] => {
            robot.note("no hand holds the cube: it is taken again");
            take_again(robot).await
        }
        [true, true] => both_hold(robot, &last).await,
        [true, false] => one_holds(robot, Hand::Track, &last).await,
        [false, true] => one_holds(robot, Hand::Postument, &last).await,
    }
}

/// Takes over the facts in the last journal entry of the earlier run.
fn restore(robot: &mut Robot, last: &Entry) {
    (robot.hand_over, robot.taken_at) = (last.hand_over, last.taken_at);
    robot.retract_shortfall = last.short;
    robot.stops = Hand::BOTH.map(|hand| depth(last, hand));
    let meetings = &robot.settings.meetings;
    // The track coordinate that clears every meeting of the table by the whole separation.
    let places = meetings.grasps.iter().flatten().map(|m| m.track_back.0[0]);
    let least = places.fold(f64::INFINITY, f64::min) - meetings.separation;
    let track = robot.arms[Hand::Track.index()].desired_joints.0[0];
    // On a path with a small separation the track does not retract far enough for any other path,
    // so it counts as apart only near the least coordinate.
    let share = if meetings.ways.is_empty() { 0.5 } else { 0.1 };
    robot.apart = track < least + share * meetings.separation;
    robot.least_track = Some(least);
}

/// Returns the hold that is assumed for a hand, with the depth of the journal. Any palm face will
/// do, since the faces get their names later from the looks.
fn assumed(last: &Entry, hand: Hand) -> Hold {
    Hold { palm: Face::D, jaws: Axis::Y, depth: depth(last, hand) }
}

/// Returns the depth of a hand's hold by the journal, else one layer.
fn depth(last: &Entry, hand: Hand) -> Depth {
    last.held[hand.index()].or(last.stops[hand.index()]).unwrap_or(Depth::One)
}

/// Ends a mission whose cube was handed back, or looks for a cube that the operator may not have
/// taken.
async fn was_handed_back(robot: &mut Robot, last: Entry) -> Result<Station, Failure> {
    robot.given_back = true;
    robot.failure = last.undone;
    let distance = robot.free_retraction(Hand::Track, robot.settings.back);
    // Empty jaws do not prove that the operator has the cube, unless the other run was over.
    let seeks = !last.over && robot.settings.keeper == Keeper::Person;
    if seeks {
        begin_to_seek(robot);
    }
    if !last.over {
        back_off(robot, distance).await?;
    }
    if seeks {
        return seek(robot).await;
    }
    let achieved = robot.failure.is_none();
    give_back::finish(robot, achieved).map(Station::Over)
}

/// Prepares to take a cube that no hand holds.
async fn take_again(robot: &mut Robot) -> Result<Station, Failure> {
    robot.forget_grasp();
    let distance = robot.free_retraction(Hand::Track, robot.settings.back);
    back_off(robot, distance).await?;
    robot.move_apart().await?;
    // From another place than the last hand-over the arm may not reach the cube. It stays where it
    // is if the way there is not free.
    if let Some(place) = robot.hand_over {
        robot.joints_unless_refused([Some(place), None]).await?;
    }
    // The operator may hold the cube out elsewhere.
    robot.forget_hand_over();
    Ok(Station::Take)
}

/// Returns whether jaws that closed with this result have closed on nothing. Jaws that something
/// presses do not count: their hand must not move.
fn is_empty(closed: &Result<(), Failure>) -> bool {
    matches!(closed, Err(Failure::NotGrasped { empty: true, .. }))
}

/// Takes the cube again that `hand` does not hold, though its jaws were as far apart as a cube. It
/// fell when no mission was there to see it, if the journal says that this hand held it.
async fn fallen_before(robot: &mut Robot, hand: Hand, last: &Entry) -> Result<Station, Failure> {
    robot.belief.released(hand);
    if last.held[hand.index()].is_some() {
        robot.note_fall(hand);
        let (name, next) = (hand.name(), robot.after_fall());
        robot.note(format!("the jaws of the {name} hand are empty, the cube has fallen: {next}"));
    } else {
        robot.note("no hand holds the cube: it is taken again");
    }
    robot.open(hand, Depth::One).await?;
    take_again(robot).await
}

/// Opens the track hand and retracts it by `distance` (m), before it moves sideways or its force is
/// zeroed: its fingers may press a cube that a person holds.
async fn back_off(robot: &mut Robot, distance: f64) -> Result<(), Failure> {
    robot.open(Hand::Track, Depth::One).await?;
    robot.along(Hand::Track, -distance).await
}

/// Begins the search for a cube that the earlier run was handing back, since no journal entry says
/// whether a person took it.
fn begin_to_seek(robot: &mut Robot) {
    robot.note("the cube was being handed back: the camera looks for it");
    robot.seek_time = Some(SEEK_SECONDS);
    // The operator may hold the cube out elsewhere.
    robot.forget_hand_over();
}

/// Gives the operator [`TAKE_BACK_SECONDS`] to take the cube, and returns the station at which the
/// visual servo looks for it.
async fn seek(robot: &mut Robot) -> Result<Station, Failure> {
    robot.move_apart().await?;
    robot.hold_still(TAKE_BACK_SECONDS).await?;
    Ok(Station::Take)
}

/// Leaves the cube to a person who has it, or who does not let go of it.
pub(super) async fn leave_to_the_operator(
    robot: &mut Robot,
    why: String,
) -> Result<Station, Failure> {
    robot.note(format!("{why}: the operator has the cube"));
    robot.given_back = true;
    robot.failure = robot.earlier.as_ref().and_then(|last| last.undone.clone());
    begin_to_seek(robot);
    regrasp::let_go(robot, Hand::Track).await?;
    seek(robot).await
}

/// Prepares the mission to continue with the cube in `hand`, and returns the station. `last` is the
/// last journal entry of the earlier run.
async fn one_holds(robot: &mut Robot, hand: Hand, last: &Entry) -> Result<Station, Failure> {
    robot.note(format!("the {} hand holds the cube", hand.name()));
    let (other, hold) = (hand.other(), assumed(last, hand));
    robot.belief.found(hand, hold, false);
    let left = robot.way_back_left();
    if hand == Hand::Track && robot.settings.keeper == Keeper::Person {
        // The journal says "handing back" only once the cube is out, so its position counts too.
        let is_out = last.hand_over.is_some() && left > Some(NEGLIGIBLE);
        let gap = robot.arms[Hand::Track.index()].jaw_opening;
        // At this distance the jaws may have begun to open when the other run ended.
        let opening = last.handing_back && gap > robot.settings.edge - MOST_CLOSER;
        robot.maybe_offered = (last.handing_back || is_out).then_some(MaybeOffered { opening });
    }
    let clear = way_to_clear(robot, other);
    // The other run's zero is unknown, and the hand must not yield to a force of that zero.
    robot.zero_forces([hand == Hand::Track, hand == Hand::Postument]).await?;
    let closed = robot.close(hand, hold, Closing::Straight).await;
    // A cube that may have been held out was perhaps pulled out of the jaws, and did not fall.
    if robot.maybe_offered.is_none() && is_empty(&closed) {
        return fallen_before(robot, hand, last).await;
    }
    closed?;
    let stops = robot.stops[other.index()];
    robot.open(other, stops).await?;
    if let Some(way) = clear {
        robot.along(other, -way).await?;
    }
    retreat(robot, hand, left).await
}

/// Returns the distance by which an empty hand, whose fingers may be beside the cube, must still
/// retract (m); `None` if the hand is clear. A joint limit may be near behind that distance.
fn way_to_clear(robot: &mut Robot, hand: Hand) -> Option<f64> {
    let (edge, back) = (robot.settings.edge, robot.settings.back);
    let place = robot.belief.centre_in_tool(hand, &robot.arms)?;
    if place.norm() >= 3.0 * edge {
        return None;
    }
    // The distance already retracted from a hold of one layer. From two layers it is longer, so the
    // rest is enough for both. The whole retraction again ended at a joint limit in 7 of 200 killed
    // runs.
    let gone = place.z - edge / 3.0;
    let left = (back - gone).clamp(0.0, back);
    (left >= NEGLIGIBLE).then(|| robot.retraction(hand, left, CLEAR * back - gone))
}

/// Brings the cube clear of the place of hand-over. `left` is the rest of the retraction (m);
/// `None` if it is unknown.
async fn retreat(robot: &mut Robot, holder: Hand, left: Option<f64>) -> Result<Station, Failure> {
    match (robot.hand_over, holder, robot.settings.keeper) {
        // The other run had not retracted yet: the operator may still hold the cube.
        (None, Hand::Track, _) => {
            let way = left.unwrap_or(robot.way_back());
            retract_with_cube(robot, way).await?;
        }
        // The cube may be held out: pulls must find no holder before it moves.
        (Some(place), _, _) if robot.maybe_offered.is_some() => {
            wait_for_release(robot).await?;
            if left > Some(NEGLIGIBLE) {
                robot.joints([Some(place), None]).await?;
            }
            // A person may have held the cube at the zero before.
            robot.zero_forces([true, false]).await?;
        }
        // The cube may lie on the table or just above it, so it moves up before it moves sideways.
        (_, Hand::Track, Keeper::Table) => {
            if let Some(left) = left.filter(|left| *left > 0.0) {
                robot.along(holder, -left).await?;
            }
        }
        // The cube is clear already.
        _ => {}
    }
    Ok(Station::Read { phase: "identify" })
}

/// Prepares the mission to continue with the cube in both hands, perhaps in the middle of a turn,
/// and returns the station.
async fn both_hold(robot: &mut Robot, last: &Entry) -> Result<Station, Failure> {
    robot.note("both hands hold the cube");
    robot.apart = false;
    for hand in Hand::BOTH {
        let closed = robot.close(hand, assumed(last, hand), Closing::Straight).await;
        // These jaws were on their way when the other run ended.
        if is_empty(&closed) {
            return one_holds(robot, hand.other(), last).await;
        }
        closed?;
    }
    robot.check_hold()?;
    let Misaligned { turner, by, grip } = find_misaligned(robot, last);
    let body = turner.other();
    robot.belief.found(body, assumed(last, body), false);
    robot.belief.found(turner, grip.hold, grip.half_roll);
    let left = robot.way_back_left();
    // The jaws of the next grasp straighten an angle that is not seen here.
    if by.abs() > STRAIGHT {
        let degrees = by.to_degrees();
        let name = turner.name();
        robot.note(format!("a layer is misaligned: the {name} hand turns it by {degrees:.0} deg"));
        let roll = robot.arms[turner.index()].desired_joints.0[6] + by;
        robot.turn_in_progress = Some(TurnInProgress::new(turner, grip, roll, by.signum()));
        turn::turn_through(robot, turner, by).await?;
    }
    regrasp::let_go(robot, turner).await?;
    retreat(robot, body, left).await
}

/// A layer that may be misaligned between both hands.
#[derive(Debug)]
struct Misaligned {
    /// Hand that holds the layer.
    turner: Hand,
    /// Angle about the turner's own z that brings the layer into line (rad).
    by: f64,
    /// Grip of the turner after that, relative to the assumed hold of its partner.
    grip: Grip,
}

/// Finds the misaligned layer from the orientations of both tools.
fn find_misaligned(robot: &Robot, last: &Entry) -> Misaligned {
    let tool = |hand: Hand| {
        robot.belief.world_from_base(hand).rotation
            * robot.arms[hand.index()].desired_base_from_tool.rotation
    };
    let (track, postument) = (tool(Hand::Track), tool(Hand::Postument));
    let (turner, by) = misaligned(&track, &postument);
    let (own, other) = if turner == Hand::Track { (track, postument) } else { (postument, track) };
    // The partner's hold is assumed, and the tools' orientations give the turner's hold from it.
    let straight = own * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), by);
    let body = assumed(last, turner.other()).cube_from_tool(false, robot.settings.edge).rotation;
    let cube_from_turner = body * other.inverse() * straight;
    let (hold, half_roll) = Hold::from_tool_rotation(&cube_from_turner, depth(last, turner));
    Misaligned { turner, by, grip: Grip { hold, half_roll } }
}

/// Returns the hand that holds the misaligned layer, and the angle about its own z that brings the
/// layer into line (rad). Among the 24 orientations of two aligned tools it takes the one that a
/// roll of one tool reaches best.
fn misaligned(track: &UnitQuaternion<f64>, postument: &UnitQuaternion<f64>) -> (Hand, f64) {
    let mut best = (f64::INFINITY, Hand::Track, 0.0);
    for (hand, own, other) in [(Hand::Track, track, postument), (Hand::Postument, postument, track)]
    {
        for straight in rotations() {
            // own * roll = other * straight
            let off = own.inverse() * other * straight;
            // The twist of `off` about z (swing-twist decomposition), in -pi..pi.
            let roll = 2.0 * libm::atan2(off.k, off.w);
            let roll = roll - (roll / std::f64::consts::TAU).round() * std::f64::consts::TAU;
            let rest = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -roll) * off;
            // The rest weighs more than the roll: a turn rolls a tool, and only errors tilt it.
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
        EMPTY, Stage, WIDTH, goes_well, order, play_mission, settings, track, words,
    };
    use super::super::{Mission, recover};
    use super::*;
    use crate::generators::{Behaviour, Outcome};
    use crate::kernel::sensor::SensorReadings;
    use crate::kernel::{Action, Event, Finish, Forces, Kernel as _, Readings};
    use crate::motion::{ArmState, JointPositions};
    use crate::reach::Fold;
    use crate::spatial::Pose;
    use crate::tasks::cube::settings::CubeSettings;
    use crate::tasks::cube::think::Thought;

    /// Returns the last journal entry of a run that was laying the cube down.
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

    /// Makes a stage for a mission that resumes from an entry, with empty hands.
    fn stage(settings: CubeSettings, last: &Entry) -> Stage {
        let assignment = Assignment::new(Goal::Solve).resumed(Some(last.clone()));
        Stage::with(settings, assignment)
    }

    /// Takes stock of what an interrupted run left, with all actions successful. Returns the
    /// station and the actions.
    fn takes_stock(
        stage: &mut Stage,
        last: &Entry,
    ) -> (Result<Station, Failure>, Vec<Action<Thought>>) {
        let last = last.clone();
        stage.play(async |robot| take_stock(robot, last).await, &mut goes_well)
    }

    /// Resumes from an entry with the cube in the track hand, `above` the place of the grasp by
    /// this distance (m). Checks that the cube is read next.
    fn goes_on(keeper: Keeper, last: &Entry, above: f64) -> (Stage, Vec<Action<Thought>>) {
        let mut stage = stage(CubeSettings { keeper, ..settings() }, last);
        stage.robot.arms[0].jaw_opening = WIDTH;
        stage.robot.arms[0].desired_base_from_tool = Pose::translation(0.5, 0.1, 0.7 + above);
        let (end, actions) = takes_stock(&mut stage, last);
        assert_eq!(end, Ok(Station::Read { phase: "identify" }));
        (stage, actions)
    }

    /// Returns the distances of the track's motions along its z, in order (m).
    fn ways(stage: &Stage, actions: &[Action<Thought>]) -> Vec<f64> {
        let from = stage.robot.arms[0].desired_base_from_tool;
        let way = |action: &Action<Thought>| {
            let Action::Behave { orders, .. } = action else { return None };
            let Some(Behaviour::Line { target, .. }) = orders[0] else { return None };
            Some((from.inverse() * target).translation.z)
        };
        actions.iter().filter_map(way).collect()
    }

    /// Returns the index of the first action with this word.
    fn position(words: &[&str], word: &str) -> Option<usize> {
        words.iter().position(|w| *w == word)
    }

    #[test]
    fn lowered_cube_is_lifted_before_it_is_read() {
        let back = settings().back;
        for above in [0.0, 0.02] {
            for short in [0.0, 0.01] {
                // The arm could not retract by all of the distance.
                let last = Entry { short, ..lowering() };
                let (stage, actions) = goes_on(Keeper::Table, &last, above);

                let [way] = ways(&stage, &actions)[..] else { panic!("{:?}", words(&actions)) };
                assert!((way + (back - short - above)).abs() < 1e-12, "{way}");
                // The jaws close first, and the place of hand-over is known.
                let words = words(&actions);
                assert!(position(&words, "close") < position(&words, "line"), "{words:?}");
                assert_eq!(stage.robot.hand_over, last.hand_over);
            }
        }
        for above in [1.001 * back, 2.0 * back] {
            let (stage, actions) = goes_on(Keeper::Table, &lowering(), above);
            assert!(ways(&stage, &actions).is_empty(), "{above}");
        }
        // A cube that goes back to a person has no table below it.
        let (stage, actions) = goes_on(Keeper::Person, &lowering(), 0.02);
        assert!(ways(&stage, &actions).is_empty());
    }

    #[test]
    fn resume_pulls_to_detect_person_before_retracting() {
        let back = settings().back;
        // Entries of a cube on its way out, and of a cube that was held out.
        for handing_back in [false, true] {
            let last = Entry { handing_back, ..lowering() };
            let words = words(&goes_on(Keeper::Person, &last, 0.02).1);
            let zeroed = position(&words, "zero");
            let (close, pull) = (position(&words, "close"), position(&words, "pull"));
            let back_at = position(&words, "joints");
            assert!(zeroed.is_some() && zeroed < close && close < pull, "{words:?}");
            assert!(pull < back_at && back_at.is_some(), "{words:?}");

            // The track has already retracted, farther than usual.
            let words = super::super::testing::words(&goes_on(Keeper::Person, &last, 1.5 * back).1);
            assert_eq!(position(&words, "pull").is_some(), handing_back, "{words:?}");
            assert_eq!(position(&words, "joints"), None, "{words:?}");
        }
    }

    #[test]
    fn resumed_track_arm_retracts_by_remaining_distance() {
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
    fn empty_hand_retracts_until_clear_of_partners_cube() {
        let (desired_joints, stand) = Fold::example_stand();
        let goes = settings().folds[1].retractable(&stand, &desired_joints, 0.3);
        // The joints of the arm allow six tenths of the usual retraction, and the cube is so large
        // that the hand is clear of it long before the hand is far from it.
        let back = goes / 0.6;
        let edge = back / 2.0;
        let way_beside = |aside: f64, gone: f64| {
            let mut stage = stage(CubeSettings { edge, back, ..settings() }, &lowering());
            let cube = stand * Pose::translation(aside, 0.0, edge / 3.0 + gone);
            stage.robot.arms[0].desired_base_from_tool = cube;
            stage.robot.arms[1].desired_base_from_tool = stand;
            stage.robot.arms[1].desired_joints = desired_joints;
            stage.robot.belief.taken(Hand::Track, assumed(&lowering(), Hand::Track), false);
            way_to_clear(&mut stage.robot, Hand::Postument)
        };
        let way = |gone: f64| way_beside(0.0, gone);
        let near = |way: Option<f64>, wanted: f64| way.is_some_and(|w| (w - wanted).abs() < 1e-9);

        assert!(near(way(0.0), back), "the cube stays between its fingers: the arm refuses");
        assert!(near(way(0.1 * back), goes), "the whole distance is enough");
        assert!(near(way(0.5 * back), 0.5 * back));
        assert!(near(way(-0.1 * back), back), "deeper than any hold");
        assert!(near(way(back - 0.002), 0.002));
        assert_eq!(way(back), None, "the hand is clear of the cube");
        assert!(near(way_beside(2.9 * edge, 0.0), back), "the cube is near");
        assert_eq!(way_beside(3.0 * edge, 0.0), None, "the cube is far away");
    }

    #[test]
    fn resumed_empty_hand_opens_then_retracts() {
        let (desired_joints, desired_base_from_tool) = Fold::example_stand();
        let settings = CubeSettings { back: 0.3, ..settings() };
        let goes = settings.folds[0].retractable(&desired_base_from_tool, &desired_joints, 0.3);
        let taking = Entry { held: [None; 2], hand_over: None, handing_back: false, ..lowering() };
        let mut stage = stage(settings, &taking);
        let arm = ArmState { desired_joints, desired_base_from_tool, ..stage.robot.arms[0] };
        stage.robot.arms = [arm; 2];

        let (end, actions) = takes_stock(&mut stage, &taking);

        assert_eq!(end, Ok(Station::Take));
        assert_eq!(words(&actions)[..3], ["take stock", "open", "line"]);
        let [way] = ways(&stage, &actions)[..] else { panic!() };
        assert!((way + goes).abs() < 1e-9 && goes < 0.3, "{way} {goes}");
        assert_eq!(stage.robot.hand_over, None, "the next place of hand-over is unknown");
    }

    #[test]
    fn hand_retracts_unless_earlier_mission_was_over() {
        let ends = |over: bool| {
            let last = Entry { held: [None; 2], over, ..lowering() };
            let mut stage = stage(settings(), &last);
            let (end, actions) = takes_stock(&mut stage, &last);
            (end, words(&actions))
        };

        let (end, words) = ends(false);
        assert_eq!(end, Ok(Station::Take), "the camera looks for the cube");
        assert_eq!(words[..3], ["take stock", "open", "line"]);
        let (end, words) = ends(true);
        assert!(matches!(end, Ok(Station::Over(Finish { achieved: true, .. }))), "{end:?}");
        assert_eq!(words, ["take stock"], "the hand had left the cube");
    }

    /// Plays a mission that resumes from an entry, with the track's jaws `gap` apart (m). A
    /// behaviour ends with the outcome that `ends` returns, or with success for `None`. Returns the
    /// end and the words of the actions.
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

    /// Plays a resumed mission that was interrupted in the hand-back, with the track's jaws `gap`
    /// apart (m). The jaws end with the outcome `closed`, and each small pull ends with the outcome
    /// `pulled`.
    fn offered(gap: f64, closed: &Outcome, pulled: &Outcome) -> (Finish, Vec<&'static str>) {
        let last = Entry { doing: "handing back".to_owned(), ..lowering() };
        played(last, gap, |order| match order {
            Behaviour::Grasp { .. } => Some(closed.clone()),
            Behaviour::Withdraw { .. } => Some(pulled.clone()),
            Behaviour::VisualServo(_) => Some(Outcome::LostSight(5.0)),
            _ => None,
        })
    }

    #[test]
    fn person_holding_offered_cube_keeps_it() {
        use super::super::take::RELEASE_TRIES;
        // Whether the jaws opened after they had closed and before the search for the cube.
        let opened = |words: &[&str]| {
            let closed = position(words, "close").unwrap();
            let sought = position(words, "acquire").unwrap_or(words.len());
            let hands = words[closed..sought].iter().filter(|word| **word == "open").count();
            // The empty postument hand opens as well, once the cube is known to be held.
            hands > usize::from(words[closed..sought].contains(&"pull"))
        };

        // Jaws that were opening close without a cube.
        let (end, words) = offered(0.058, &Outcome::Empty(EMPTY), &Outcome::NotTouched);
        assert!(end.achieved && end.reason == give_back::UNSEEN, "{}", end.reason);
        assert!(opened(&words) && position(&words, "pull").is_none(), "{words:?}");
        // Jaws that had closed farther than on a cube have lost it.
        let (end, words) = offered(0.055, &Outcome::Empty(EMPTY), &Outcome::NotTouched);
        assert!(!end.achieved && end.reason.contains("do not hold"), "{}", end.reason);
        assert!(!opened(&words), "{words:?}");
        // Jaws that are pressed while they close do not open.
        let (end, words) = offered(0.057, &Outcome::OverForce(2, 25.0), &Outcome::NotTouched);
        assert!(!end.achieved && !opened(&words), "{}", end.reason);
        // A person holds on to the cube.
        let (end, words) = offered(0.057, &Outcome::Grasped(0.057), &Outcome::Touched(0.001));
        assert!(end.achieved && end.reason == give_back::UNSEEN, "{}", end.reason);
        let pulls = words.iter().filter(|word| **word == "pull").count();
        assert!(opened(&words) && pulls > RELEASE_TRIES as usize, "{pulls}");
    }

    /// The journal says "handing back" only from the offer on. Jaws that hold no cube before that
    /// have lost it.
    #[test]
    fn empty_jaws_before_hand_back_mean_loss() {
        let last = Entry { handing_back: false, ..lowering() };

        let (end, _) = played(last, 0.0565, |order| match order {
            Behaviour::Grasp { .. } => Some(Outcome::Empty(EMPTY)),
            _ => None,
        });

        assert!(!end.achieved && end.reason.contains("do not hold"), "{}", end.reason);
    }

    /// The jaws of one hand, or of both, are as far apart as a cube, but close on nothing. A hand
    /// that held nothing by the journal has lost nothing.
    #[test]
    fn cube_that_fell_before_is_taken_again() {
        let place = JointPositions([0.3; 7]);
        for (gaps, held, drops) in [
            ([0.09, WIDTH], [None, Some(Depth::One)], 1),
            ([WIDTH, WIDTH], [None, Some(Depth::One)], 1),
            ([0.09, WIDTH], [None, None], 0),
        ] {
            let hand_over = Some(place);
            let last = Entry { handing_back: false, hand_over, held, ..lowering() };
            let mut stage = stage(settings(), &last);
            (0..2).for_each(|hand| stage.robot.arms[hand].jaw_opening = gaps[hand]);

            let (end, actions) =
                stage.play(async |robot| take_stock(robot, last).await, &mut |action, arms| {
                    let Action::Behave { orders, .. } = action else {
                        return goes_well(action, arms);
                    };
                    let closes =
                        |order: &Option<Behaviour>| matches!(order, Some(Behaviour::Grasp { .. }));
                    let Some(hand) = orders.iter().position(closes) else {
                        return goes_well(action, arms);
                    };
                    arms[hand].jaw_opening = EMPTY;
                    let mut outcomes = vec![None, None];
                    outcomes[hand] = Some(Outcome::Empty(EMPTY));
                    Event::Behaved(outcomes)
                });

            assert_eq!(end, Ok(Station::Take), "{gaps:?}");
            let (robot, ordered) = (&stage.robot, words(&actions));
            assert_eq!((robot.log.drops, robot.hand_over), (drops, None), "{ordered:?}");
            assert!(robot.belief.held.iter().all(Option::is_none), "{gaps:?}");
            let goes = |action: &Action<Thought>| match action {
                Action::Behave { orders, .. } => {
                    matches!(orders[0], Some(Behaviour::Joints { target, .. }) if target == place)
                }
                _ => false,
            };
            assert!(actions.last().is_some_and(goes), "the track is at the hand-over: {ordered:?}");
        }
    }

    /// Jaws that something presses have closed on nothing that they could name: nothing moves.
    #[test]
    fn pressed_jaws_of_resumed_hand_do_not_move() {
        let last = Entry { handing_back: false, hand_over: None, ..lowering() };

        let (end, words) = played(last, 0.0565, |order| match order {
            Behaviour::Grasp { .. } => Some(Outcome::OverForce(2, 25.0)),
            _ => None,
        });

        assert!(!end.achieved && end.reason.contains("over-force"), "{}", end.reason);
        assert_eq!(position(&words, "joints"), None, "{words:?}");
        assert_eq!(position(&words, "open"), None, "{words:?}");
    }

    /// The plant's file counts the falls of the whole mission.
    #[test]
    fn noticed_falls_of_earlier_run_count() {
        let last = Entry { drops: 2, ..lowering() };

        assert_eq!(stage(settings(), &last).robot.log.drops, 2);
    }

    #[test]
    fn offered_cube_pulled_out_counts_as_taken() {
        let mut stage = stage(settings(), &lowering());
        stage.robot.hold(Hand::Track);
        stage.robot.maybe_offered = Some(MaybeOffered { opening: false });

        let mut failure = Failure::Lost(Hand::Track);
        let end = loop {
            let now = failure.clone();
            let recovers = async |robot: &mut Robot| recover::recover(robot, now).await;
            match stage.play(recovers, &mut goes_well).0 {
                Err(next) => failure = next,
                Ok(station) => break station,
            }
        };

        assert_eq!(end, Station::Take);
        assert_eq!((stage.robot.log.drops, stage.robot.given_back), (0, true));
        assert!(stage.robot.seek_time.is_some() && stage.robot.drop_site.is_none());
    }

    #[test]
    fn mission_fails_if_person_does_not_release_cube() {
        let last = Entry { held: [None; 2], ..lowering() };

        let (end, _) = played(last, 0.09, |order| match order {
            Behaviour::VisualServo(_) | Behaviour::Withdraw { .. } => Some(Outcome::Touched(0.001)),
            _ => None,
        });

        assert!(!end.achieved && end.reason.contains("does not let go"), "{}", end.reason);
    }

    /// Plays a mission whose cube an earlier run was handing back; `undone` is the reason if the
    /// cube was not solved. The visual servo ends with the outcome `ended`. Returns the end, the
    /// words of the actions, and the patience of the visual servo (s).
    fn sought(undone: Option<&str>, ended: &Outcome) -> (Finish, Vec<&'static str>, Option<f64>) {
        let undone = undone.map(str::to_owned);
        let doing = "opening the jaws".to_owned();
        let last = Entry { held: [None; 2], undone, doing, ..lowering() };
        let mut patience = None;
        let (end, words) = played(last, 0.09, |order| match order {
            Behaviour::VisualServo(order) => {
                patience = Some(order.patience);
                Some(ended.clone())
            }
            _ => None,
        });
        (end, words, patience)
    }

    #[test]
    fn cube_of_an_earlier_run_is_looked_for() {
        for nobody in [Outcome::LostSight(5.0), Outcome::OutOfZone(5.0)] {
            let (end, _, patience) = sought(None, &nobody);
            assert!(end.achieved && end.reason.contains("no person has held it out"));
            assert_eq!(patience, Some(SEEK_SECONDS));

            let (end, ..) = sought(Some("face U cannot be read"), &nobody);
            let told = "face U cannot be read; by the journal of the earlier run";
            assert!(!end.achieved && end.reason.starts_with(told), "{}", end.reason);
        }
        // A cube that is held out again is taken and read.
        let (_, words, _) = sought(Some("face U cannot be read"), &Outcome::Touched(3.0));
        assert!(words.contains(&"look"), "{words:?}");
    }

    #[test]
    fn journal_entry_omits_grasp_of_lost_cube() {
        let last = Entry { handing_back: false, short: 0.02, ..lowering() };
        let assignment = Assignment::new(Goal::Solve).resumed(Some(last));
        let mut mission = Mission::new(settings(), assignment);
        let arms = [ArmState { jaw_opening: 0.09, ..ArmState::default() }; 2];
        let readings = Readings {
            arms: &arms,
            forces: &Forces::default(),
            sensors: &SensorReadings::default(),
        };
        let stock = mission.next(Event::Start, &readings);
        assert!(matches!(stock, Action::Phase("take stock")) && mission.entry().is_none());

        mission.next(Event::Done, &readings);

        let noted = mission.entry().unwrap();
        assert_eq!(noted.doing, "opening the jaws");
        // Another run that is resumed on the way needs the place of hand-over.
        let place = lowering().hand_over;
        assert_eq!((noted.hand_over, noted.taken_at, noted.short), (place, None, 0.0));
    }

    #[test]
    fn resumed_mission_reports_cube_place_as_unknown() {
        let begun = Mission::new(settings(), Assignment::new(Goal::Solve));
        assert_eq!(begun.whereabouts(), "the operator has the cube");

        let resumed = Mission::new(settings(), Assignment::new(Goal::Solve).resumed(None));
        assert!(resumed.whereabouts().ends_with("is unknown"), "{}", resumed.whereabouts());
    }

    #[test]
    fn misaligned_layer_is_turned_back_by_its_hand() {
        let across = |r: &UnitQuaternion<f64>| (r * Vector3::z()).z.abs() < 0.1;
        let postument = rotations().into_iter().find(across).unwrap();
        for by in [-0.4, 0.4, 0.09, -0.04, 0.02, -0.02] {
            let last = Entry { doing: "none".to_owned(), ..Entry::default() };
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
            // The jaws straighten a layer with a small angle.
            match turn {
                Some(angle) => assert!(by.abs() > 0.03 && (angle + by).abs() < 1e-9, "{angle}"),
                None => assert!(by.abs() < 0.03, "{by}"),
            }
            assert!(stage.robot.belief.held[0].is_none(), "the turner lets go");
        }
    }

    #[test]
    fn misaligned_layer_angle_follows_from_tool_orientations() {
        let track = UnitQuaternion::from_euler_angles(0.3, -0.7, 1.1);
        for straight in rotations() {
            let postument = track * straight;
            let z = track.inverse() * (postument * Vector3::z());
            if z.z > 0.9 {
                continue; // No grasp has both palms on one face.
            }
            for by in [-0.7, -0.3, 0.2, 0.6] {
                let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), by);

                let (hand, found) = misaligned(&(track * roll), &postument);

                // Palms on opposite faces roll about one axis, so either hand may turn back.
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
