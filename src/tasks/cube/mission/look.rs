//! Look at one face by the camera in a hand.
//!
//! A covered sticker is looked at from beside, and is never guessed.
//!
//! - in: the face, the hand that looks, readings at several exposures
//! - out: the light of the stickers in [`super::sight`]; a hidden face as a failure
//! - source: Zieliński et al. (2007), pp. 372-373; heuristics: own work
//!
//! | limit | value | reason |
//! |---|---|---|
//! | [`LOOK_TRIES`] | 6 | looks at one face in one grasp before it counts as hidden there |

use super::failure::Failure;
use super::regrasp::{self, Coming};
use super::robot::Robot;
use crate::cube::Face;
use crate::operator::Reading;
use crate::tasks::cube::hold::Hand;
use crate::vision::sensor::FaceReading;

/// Looks at one face in one grasp before it counts as hidden there.
pub(super) const LOOK_TRIES: u32 = 6;
/// Exposures of the looks at one face, as multiples of the nominal one: glare and shadow each hide
/// stickers at one of them.
const EXPOSURES: [f64; 3] = [1.0, 0.6, 1.6];
/// Steps between looks at one face, in the viewer's tool axes (m): nearer, then to each side.
pub(super) const NUDGES: [[f64; 3]; 5] = [
    [0.0, 0.0, 0.012],
    [0.0, 0.014, -0.024],
    [0.0, -0.028, 0.0],
    [0.014, 0.014, 0.0],
    [-0.028, 0.0, 0.0],
];

/// Brings the viewer's camera before a face of the cube in the other hand, and reads the face.
pub(super) async fn show(robot: &mut Robot, viewer: Hand, face: Face) -> Result<(), Failure> {
    let holder = viewer.other();
    let held =
        robot.belief.held[holder.index()].ok_or("the partner of the viewing hand holds no cube")?;
    // The side of the holder's tool that the face is on.
    let in_tool = held.hold.cube_from_tool(held.half_roll, robot.settings.edge).rotation.inverse()
        * face.normal();
    let side = match in_tool {
        n if n.z > 0.9 => 0,
        n if n.x > 0.9 => 1,
        n if n.x < -0.9 => 2,
        // The planner orders no look at these faces.
        _ => {
            return Err(format!("face {} is under a jaw or the palm", face.letter()).into());
        }
    };
    let meeting = robot.settings.meetings.views[holder.index()][side]
        .ok_or("the cell has no pose for this look")?;

    regrasp::free(robot, viewer).await?;
    regrasp::meet(robot, viewer, meeting, Coming::ToLook).await?;
    if robot.rounds > 1 {
        // The second round looks from nearer and at another exposure: from the first place a look
        // would show the same reflections.
        robot.nudge(viewer, NUDGES[0]).await?;
    }
    read_face(robot, viewer, face).await
}

/// Looks at a face up to [`LOOK_TRIES`] times, each time from another place: reflections and
/// sampling differ, and an obstacle covers other stickers.
async fn read_face(robot: &mut Robot, viewer: Hand, face: Face) -> Result<(), Failure> {
    for tries in 1.. {
        let exposure = exposure(robot, tries);
        let reading = robot.look(viewer, face, exposure).await?;
        match reading.and_then(|reading| keep(robot, face, exposure, reading)) {
            Ok(reading) => {
                // The pose of the face is also a measurement of the cube in the hand.
                robot.belief.seen(viewer, face, &reading.camera_from_face, &robot.arms);
                break;
            }
            Err(reason) if tries < LOOK_TRIES => {
                let letter = face.letter();
                robot.note(format!("face {letter} was not read ({reason}), try {tries}"));
                robot.nudge(viewer, NUDGES[(tries as usize - 1) % NUDGES.len()]).await?;
            }
            Err(reason) => {
                let why = format!("face {} cannot be read: {reason}", face.letter());
                return Err(Failure::Hidden { face, why });
            }
        }
    }
    Ok(())
}

/// Returns the exposure of try number `tries`, from 1, to read a face, as a multiple of the
/// camera's nominal exposure.
pub(super) fn exposure(robot: &Robot, tries: u32) -> f64 {
    EXPOSURES[(tries + robot.rounds - 2) as usize % EXPOSURES.len()]
}

/// Stores the stickers that a reading shows, seen at `exposure`. Refuses the reading while a
/// sticker of the face was never seen, since a covered sticker is never guessed.
fn keep(
    robot: &mut Robot,
    face: Face,
    exposure: f64,
    reading: FaceReading,
) -> Result<FaceReading, String> {
    let first = face.index() * 9;
    robot.shown.net.facelets.resize(54, None);
    for i in (0..9).filter(|&i| !reading.occluded[i]) {
        robot.sight.see(first + i, reading.rgb[i], exposure);
        let (colour, confidence) = (reading.colours[i], reading.confidences[i]);
        robot.shown.net.facelets[first + i] = Some(Reading { colour, confidence });
    }
    let missing = robot.sight.missing().into_iter().filter(|i| i / 9 == face.index());
    let missing: Vec<String> = missing.map(|i| (i % 9 + 1).to_string()).collect();
    if missing.is_empty() {
        Ok(reading)
    } else {
        Err(format!("stickers {} are covered", missing.join(", ")))
    }
}
