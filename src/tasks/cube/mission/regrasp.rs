//! Meetings of the two hands: a hand comes to the partner's cube, grasps it, or lets go of it.
//!
//! - in: a grip, the table of meetings, the holds of both hands
//! - out: the cube in the other hand, or in both

use super::actions::Closing;
use super::failure::Failure;
use super::robot::Robot;
use super::take::retract;
use crate::cube::rotation_index;
use crate::motion::JointPositions;
use crate::reach::Meeting;
use crate::tasks::cube::hold::{Grip, Hand};

/// Purpose of the newcomer to a meeting, the hand without the cube.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Coming {
    /// Look at the cube: the newcomer moves to its place at once.
    ToLook,
    /// Grasp of the cube: the newcomer stops short, and approaches from there.
    ToGrasp,
}

/// Brings both hands to a meeting: in one motion if a path is known and free, else by three
/// motions: apart, to their joint positions, and together. A newcomer that is `coming` to grasp
/// stops short of the cube.
pub(super) async fn meet(
    robot: &mut Robot,
    newcomer: Hand,
    meeting: Meeting,
    coming: Coming,
) -> Result<(), Failure> {
    robot.check_hold()?;
    let [track, postument] = match coming {
        Coming::ToLook => [meeting.track, meeting.postument],
        Coming::ToGrasp => meeting.short_of(newcomer.index()),
    };
    let meetings = &robot.settings.meetings;
    // The table's paths begin at a meeting, so hands that are apart cannot use them.
    let quick = robot.meeting.filter(|_| !robot.apart);
    let quick = quick.and_then(|last| meetings.way(&last, &meeting, newcomer.index()).copied());
    robot.meeting = Some(meeting);
    if let Some(way) = quick
        && robot.move_across(&way, [track, postument]).await?
    {
        return Ok(());
    }
    robot.move_apart().await?;
    let here = Hand::BOTH.map(|hand| robot.arms[hand.index()].desired_joints);
    let apart_by = |by: f64| {
        let mut apart = track;
        apart.0[0] -= by;
        [Some(apart), Some(postument)]
    };
    let separation = match robot.least_separation(&here, &[track, postument], newcomer) {
        // The whole separation of 0.35 m is seldom needed: less saves 3.3 s in a mission.
        Some(by) if robot.joints_unless_refused(apart_by(by)).await? => by,
        _ => {
            let usual = robot.settings.meetings.separation;
            robot.joints(apart_by(usual)).await?;
            usual
        }
    };
    robot.move_together(track, separation).await
}

/// Brings the track to the place of hand-over, from a meeting or from anywhere. The postument's
/// hand is free, and the postument does not move.
pub(super) async fn return_to(robot: &mut Robot, place: JointPositions) -> Result<(), Failure> {
    let met = Hand::BOTH.map(|hand| robot.arms[hand.index()].desired_joints);
    let (were_apart, goes) = (robot.apart, [Some(place), None]);
    // A track that counts as apart retracts as well: after a cube was lost on a path with a small
    // separation, the hands may be near.
    if let Some(by) = robot.least_separation(&[place, met[1]], &met, Hand::Postument) {
        robot.separate(by).await?;
        if robot.joints_unless_refused(goes).await? {
            return Ok(());
        }
        // The track retracts by the rest of the whole separation before the path is tried again.
        if !were_apart {
            robot.separate(robot.settings.meetings.separation - by).await?;
        }
    } else {
        robot.move_apart().await?;
    }
    robot.joints(goes).await
}

/// Opens a hand that holds the cube, and retracts that hand.
pub(super) async fn let_go(robot: &mut Robot, hand: Hand) -> Result<(), Failure> {
    robot.check_hold()?;
    // Stops that came forward now would push the cube out of both hands.
    let stops = robot.stops[hand.index()];
    robot.belief.released(hand);
    robot.open(hand, stops).await?;
    let back = robot.settings.back;
    // The table has only meetings at which both arms can retract. At the place of hand-over the
    // track retracts as far as its joints allow.
    if robot.given_back && hand == Hand::Track {
        retract(robot, back).await
    } else {
        robot.along(hand, -back).await
    }
}

/// Makes a hand let go of the cube if it holds the cube, so that it is free for its next step.
pub(super) async fn free(robot: &mut Robot, hand: Hand) -> Result<(), Failure> {
    if robot.belief.held[hand.index()].is_some() { let_go(robot, hand).await } else { Ok(()) }
}

/// Grasps the cube that the partner holds: brings both hands to their meeting, then approaches,
/// closes the jaws and secures the grip.
pub(super) async fn grasp(robot: &mut Robot, hand: Hand, grip: Grip) -> Result<(), Failure> {
    let held = robot.belief.held[hand.other().index()];
    let held = held.ok_or("no other hand holds the cube")?;
    let edge = robot.settings.edge;
    let partner = held.hold.cube_from_tool(held.half_roll, edge).rotation;
    let own = grip.hold.cube_from_tool(grip.half_roll, edge).rotation;
    let (track, postument) = if hand == Hand::Track { (own, partner) } else { (partner, own) };
    let meeting = robot.settings.meetings.grasps[rotation_index(&(track.inverse() * postument))]
        .ok_or("the arms cannot meet in this pair of holds")?;

    free(robot, hand).await?;
    meet(robot, hand, meeting, Coming::ToGrasp).await?;
    // The palm's stops cannot come forward against a cube, so they are set before the hand is near.
    // To open jaws again that are already open would cost 16 s in a mission.
    if !robot.is_open(hand, grip.hold.depth) {
        robot.open(hand, grip.hold.depth).await?;
    }
    robot.zero_forces([true, true]).await?;
    close_on(robot, hand, grip).await?;
    robot.secure(hand, grip).await
}

/// Approaches the partner's cube with an open hand, and closes the jaws on it.
pub(super) async fn close_on(robot: &mut Robot, hand: Hand, grip: Grip) -> Result<(), Failure> {
    robot.pre_grasp(hand, grip).await?;
    robot.approach(hand, grip).await?;
    robot.close(hand, grip.hold, Closing::Straight).await
}
