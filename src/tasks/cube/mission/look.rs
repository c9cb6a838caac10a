//! Look at one face by the camera in a hand.
//!
//! A covered sticker is looked at from beside, and is never guessed. No hand grasps a cube that
//! lies tilted in the other hand: a finger that came over a corner pressed with 108 N.
//!
//! - in: the face, the hand that looks, readings at several exposures
//! - out: the light of the stickers in [`super::sight`]; a hidden face or a tilted cube as a
//!   failure
//! - source: Zieliński et al. (2007), pp. 372-373; heuristics: own work
//!
//! | limit | value | reason |
//! |---|---|---|
//! | [`LOOK_TRIES`] | 6 | looks at one face in one grasp before it counts as hidden there |
//! | [`TILTED`] | 12 deg | missions without a fault see at most 2 deg, a lost grip 17 to 37 deg |
//! | [`TILTED_LOOKS`] | 2 | one wrong pose must not end a mission that reads the face later |
//! | [`TILTED_LOOKS`] without a readable look | 1 | no later look contradicts its pose |

use super::failure::Failure;
use super::regrasp::{self, Coming};
use super::robot::Robot;
use crate::cube::{Face, Keeper};
use crate::operator::Reading;
use crate::tasks::cube::hold::Hand;
use crate::vision::sensor::FaceReading;

/// Looks at one face in one grasp before it counts as hidden there.
pub(super) const LOOK_TRIES: u32 = 6;
/// Angle from the believed attitude of the cube from which on it lies tilted in the hand (rad).
const TILTED: f64 = 0.21;
/// Number of looks at one face that see the cube tilted before the mission believes them.
const TILTED_LOOKS: u32 = 2;
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
    // Outward normal of the face in the holder's tool frame, which gives the side.
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
        .ok_or_else(|| format!("the cell has no pose for a look at face {}", face.letter()))?;

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
    let mut tilts = Tilts::default();
    for tries in 1.. {
        let exposure = exposure(robot, tries);
        let reading = robot.look(viewer, face, exposure).await?;
        let reading = tilts.judge(robot, viewer, face, reading)?;
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
                tilts.decide(robot, viewer.other())?;
                let why = format!("face {} cannot be read: {reason}", face.letter());
                return Err(Failure::Hidden { face, why });
            }
        }
    }
    Ok(())
}

/// Looks at one face that see the cube tilted in the hand.
#[derive(Debug, Default)]
pub(super) struct Tilts {
    count: u32,
    /// Tilt that the last of them saw, in words.
    why: String,
}

impl Tilts {
    /// Returns the reading of a look; the reason not to use it if it sees the cube tilted.
    ///
    /// # Errors
    /// The failure of a tilted cube after [`TILTED_LOOKS`] looks that see it so.
    pub(super) fn judge(
        &mut self,
        robot: &Robot,
        viewer: Hand,
        face: Face,
        reading: Result<FaceReading, String>,
    ) -> Result<Result<FaceReading, String>, Failure> {
        let tilt = reading.as_ref().map_or(0.0, |seen| tilt_seen(robot, viewer, face, seen));
        if tilt <= TILTED {
            return Ok(reading);
        }
        self.count += 1;
        self.why = format!("the cube is tilted by {:.0} deg", tilt.to_degrees());
        if self.count >= TILTED_LOOKS {
            self.decide(robot, viewer.other())?;
        }
        Ok(Err(self.why.clone()))
    }

    /// Checks that no look has seen the cube tilted in `holder`, after the last look.
    ///
    /// # Errors
    /// The failure of a tilted cube if one has: no later look contradicts its pose.
    pub(super) fn decide(&self, robot: &Robot, holder: Hand) -> Result<(), Failure> {
        if self.count == 0 { Ok(()) } else { Err(tilted_in(robot, holder, &self.why)) }
    }
}

/// Returns the angle (rad) between the believed attitude of a face and the seen one.
fn tilt_seen(robot: &Robot, viewer: Hand, face: Face, seen: &FaceReading) -> f64 {
    let believed = robot.belief.face_in_camera(viewer, face, &robot.arms);
    believed.map_or(0.0, |believed| believed.rotation.angle_to(&seen.camera_from_face.rotation))
}

/// Returns the failure of a cube that lies tilted in `holder`, for the reason `why`. Only the track
/// can give it back, and only to a person: on the table it would meet an edge first. Otherwise a
/// person must take it out.
fn tilted_in(robot: &Robot, holder: Hand, why: &str) -> Failure {
    let why = format!("{why} in the {} hand, and no other hand can grasp it", holder.name());
    match (holder, robot.settings.keeper) {
        (Hand::Track, Keeper::Person) => Failure::GiveBack(why),
        _ => Failure::Final(format!("{why}: a person must take it out")),
    }
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
