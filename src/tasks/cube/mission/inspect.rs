//! Inspection of the cube: the free hand's camera compares two sides with the expected colours, the
//! one opposite the palm and one beside the jaws.
//!
//! A wrong angle of any single layer shows on one of these sides: turns about the palm's axis on
//! either side beside the jaws, all other turns on the side opposite the palm. A side that cannot
//! be seen is replaced by the other one beside the jaws. A cube that could not be inspected never
//! counts as done. It is inspected once more, then the operator is asked, and without an answer it
//! goes back with the reason.
//!
//! - in: readings of two or three sides, the cube as the turns should have left it
//! - out: `Ok`, or the failure that has the cube read again or given back
//! - source: own work
//!
//! | limit | value | reason |
//! |---|---|---|
//! | [`CLEARLY`] | 0.6 | another colour is clearly nearer below this share of its own distance |
//! | [`ODD_STICKERS`] | 2 | a turn changes three stickers on a side, a reflection changes one |
//! | [`ROW_SEEN`] | 2 of 3 | a turn changes all three stickers of a row at the rim |
//! | [`CHECK_TRIES`] | 3 | looks at a side, each from another place |
//! | [`INSPECTIONS`], [`REPEAT_AFTER`] | 2, 5 s | an obstacle before a camera may leave meanwhile |

use super::failure::Failure;
use super::look::{NUDGES, Tilts, exposure};
use super::questions;
use super::regrasp::{self, Coming};
use super::robot::Robot;
use super::sight::Palette;
use crate::cube::Face;
use crate::reach::Meeting;
use crate::tasks::cube::hold::Hand;
use crate::vision::sensor::FaceReading;
use nalgebra::Vector3;

/// Looks at one side before it counts as uninspected.
const CHECK_TRIES: u32 = 3;
/// Inspections before the operator is asked, or the cube goes back as it is.
const INSPECTIONS: u32 = 2;
/// Time between inspections, in which an obstacle in front of a camera may leave (s).
const REPEAT_AFTER: f64 = 5.0;
/// Time of a path between looks that is not in the table (s).
const UNKNOWN_SECONDS: f64 = 10.0;
/// Stickers of a row at the rim of a side that must be seen.
const ROW_SEEN: usize = 2;
/// The rows at the rim of a side, in reading order.
const ROWS: [[usize; 3]; 4] = [[0, 1, 2], [6, 7, 8], [0, 3, 6], [2, 5, 8]];
/// Share of the distance to a sticker's own colour below which another colour is clearly nearer.
const CLEARLY: f64 = 0.6;
/// Unexpected stickers from which on the cube is read again.
const ODD_STICKERS: usize = 2;

/// Result of the looks at the sides.
#[derive(Debug, Default)]
struct Inspection {
    /// Stickers with another colour than the turns should have left.
    unexpected: Vec<(Face, usize)>,
    /// Reason for which no look could show the turns about the palm's axis, or all other turns.
    uninspected: Option<String>,
}

/// Which turns a side of the cube shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shows {
    /// Turns about any axis but the palm's: the side opposite the palm.
    TurnsAcross,
    /// Turns about the palm's axis: a side beside the jaws.
    TurnsAlong,
}

/// A side that the free hand's camera can see.
#[derive(Debug, Clone, Copy)]
struct Side {
    face: Face,
    shows: Shows,
    meeting: Meeting,
}

/// Inspects the cube in the hand that holds it alone, and fails if it is not as expected. With
/// `turns_remain` the plan continues after this inspection.
pub(super) async fn inspect(robot: &mut Robot, turns_remain: bool) -> Result<(), Failure> {
    let mut inspections = 0;
    loop {
        let Inspection { unexpected, uninspected } = look_at_sides(robot).await?;
        robot.check_hold()?;
        if unexpected.len() >= ODD_STICKERS {
            return Err(not_as_turned(robot, &unexpected));
        }
        let Some(why) = uninspected else { break };
        // The inspection at the end of the plan covers this side again.
        if turns_remain {
            robot.note(format!("{why}: the inspection is repeated before the cube goes back"));
            break;
        }
        inspections += 1;
        if inspections < INSPECTIONS {
            robot.note(format!("{why}: the cube is inspected again"));
            robot.hold_still(REPEAT_AFTER).await?;
        } else {
            // The operator wants another look, so the inspection has its repetition again.
            questions::ask_for_inspection(robot, why).await?;
            inspections = 0;
        }
    }
    if turns_remain { robot.phase("solve").await } else { Ok(()) }
}

/// Returns the failure for a cube whose stickers `unexpected` (face, number 1..=9) have other
/// colours than the turns should have left.
fn not_as_turned(robot: &mut Robot, unexpected: &[(Face, usize)]) -> Failure {
    let names: Vec<String> =
        unexpected.iter().map(|(face, i)| format!("{}{i}", face.letter())).collect();
    let why =
        format!("stickers {} do not have the colours expected after the turns", names.join(", "));
    if !robot.may_recover() {
        return Failure::GiveBack(why);
    }
    robot.note(format!("{why}: the cube is read again"));
    Failure::ReadAgain { release: None }
}

/// Looks at the sides that the camera in the free hand can see without another grasp, until every
/// layer's angle was seen.
async fn look_at_sides(robot: &mut Robot) -> Result<Inspection, Failure> {
    let viewer = robot.holder()?.other();
    let mut left = sides(robot)?;
    let mut inspection = Inspection::default();
    robot.phase("inspect").await?;
    let (mut missing, mut hidden) = (vec![Shows::TurnsAcross, Shows::TurnsAlong], Vec::new());
    while let Some(next) = quickest(robot, viewer, &left, &missing) {
        let side = left.remove(next);
        regrasp::meet(robot, viewer, side.meeting, Coming::ToLook).await?;
        match check_side(robot, viewer, side.face).await? {
            Ok(unexpected) => {
                inspection.unexpected.extend(unexpected);
                missing.retain(|shows| *shows != side.shows);
            }
            Err(why) => hidden.push((side.shows, why)),
        }
    }
    if let Some(turns) = missing.first() {
        let why = hidden.into_iter().find(|(shows, _)| shows == turns).map(|(_, why)| why);
        let none = || "the cube could not be inspected: the cell has no pose for the looks".into();
        inspection.uninspected = Some(why.unwrap_or_else(none));
    }
    Ok(inspection)
}

/// Returns the sides of the held cube that the free hand's camera can see.
fn sides(robot: &Robot) -> Result<Vec<Side>, Failure> {
    let holder = robot.holder()?;
    let held = robot.belief.held[holder.index()].ok_or("no hand holds the cube")?;
    let rotation = held.hold.cube_from_tool(held.half_roll, robot.settings.edge).rotation;
    let normals = [
        (Vector3::z(), Shows::TurnsAcross),
        (Vector3::x(), Shows::TurnsAlong),
        (-Vector3::x(), Shows::TurnsAlong),
    ];
    let views = robot.settings.meetings.views[holder.index()];
    let sides = normals.into_iter().zip(views).filter_map(|((normal, shows), meeting)| {
        // Normals of faces differ by right angles, so only one face passes.
        let normal = rotation * normal;
        let face = Face::ALL.into_iter().find(|f| f.normal().dot(&normal) > 0.9);
        face.zip(meeting).map(|(face, meeting)| Side { face, shows, meeting })
    });
    Ok(sides.collect())
}

/// Returns the index of the side to look at next, so that all `missing` turns are seen soonest.
/// `None` if no side shows any of them.
fn quickest(robot: &Robot, viewer: Hand, sides: &[Side], missing: &[Shows]) -> Option<usize> {
    let meetings = &robot.settings.meetings;
    // A path that is not in the table counts as a long one.
    let seconds = |from: Option<&Meeting>, to: &Meeting| {
        let way = from.and_then(|from| meetings.way(from, to, viewer.index()));
        way.map_or(UNKNOWN_SECONDS, |way| way.seconds)
    };
    let total = |first: &Side| {
        let others =
            sides.iter().filter(|side| side.shows != first.shows && missing.contains(&side.shows));
        let next = others.map(|side| seconds(Some(&first.meeting), &side.meeting));
        let next = next.fold(f64::INFINITY, f64::min);
        let first = seconds(robot.meeting.as_ref(), &first.meeting);
        // No other side is needed, or none is left.
        if next.is_finite() { first + next } else { first }
    };
    let shows = sides.iter().enumerate().filter(|(_, side)| missing.contains(&side.shows));
    let times = shows.map(|(number, side)| (number, total(side)));
    times.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(number, _)| number)
}

/// Compares one side with its expected colours. Returns its unexpected stickers, 1..=9, or the
/// reason why it could not be inspected. Each retry looks from another place.
async fn check_side(
    robot: &mut Robot,
    viewer: Hand,
    face: Face,
) -> Result<Result<Vec<(Face, usize)>, String>, Failure> {
    let letter = face.letter();
    let (mut tries, mut tilts) = (1, Tilts::default());
    loop {
        let exposure = exposure(robot, tries);
        let reading = robot.look(viewer, face, exposure).await?;
        let reading = tilts.judge(robot, viewer, face, reading)?;
        match reading.and_then(|reading| compare(robot, face, reading)) {
            Ok((reading, unexpected)) => {
                // The pose of the face is also a measurement of the cube in the hand.
                robot.belief.seen(viewer, face, &reading.camera_from_face, &robot.arms);
                return Ok(Ok(unexpected.into_iter().map(|i| (face, i)).collect()));
            }
            Err(reason) if tries < CHECK_TRIES => {
                robot.note(format!("face {letter} could not be inspected ({reason}), try {tries}"));
                robot.nudge(viewer, NUDGES[tries as usize - 1]).await?;
                tries += 1;
            }
            // The other sides are inspected all the same: with two odd stickers there the cube is
            // read again at once.
            Err(reason) => {
                tilts.decide(robot, viewer.other())?;
                return Ok(Err(format!("face {letter} could not be inspected: {reason}")));
            }
        }
    }
}

/// Returns the reading of a side and its stickers with unexpected colours, 1..=9, or the reason why
/// the reading cannot be compared.
fn compare(
    robot: &Robot,
    face: Face,
    reading: FaceReading,
) -> Result<(FaceReading, Vec<usize>), String> {
    // A covered row could hide a misaligned layer, and the side would count as inspected.
    if let Some(why) = reason_hidden(&reading) {
        return Err(why);
    }
    let known = robot.palette.zip(robot.shown.facelets);
    let (palette, facelets) = known.ok_or("the colours of the cube are unknown")?;
    let expected = std::array::from_fn(|i| facelets.colours()[face as usize * 9 + i]);
    let unexpected = unexpected_stickers(&reading, &expected, &palette);
    Ok((reading, unexpected))
}

/// Returns the reason why a reading does not show the angle of each layer, if a row at the rim has
/// fewer than [`ROW_SEEN`] uncovered stickers.
fn reason_hidden(reading: &FaceReading) -> Option<String> {
    let seen = |row: &[usize; 3]| row.iter().filter(|&&i| !reading.occluded[i]).count();
    if ROWS.iter().all(|row| seen(row) >= ROW_SEEN) {
        return None;
    }
    let covered = (0..9).filter(|&i| reading.occluded[i]);
    let covered: Vec<String> = covered.map(|i| (i + 1).to_string()).collect();
    Some(format!("stickers {} are covered", covered.join(", ")))
}

/// Returns the stickers of a face, 1..=9, that clearly have another colour than expected.
fn unexpected_stickers(reading: &FaceReading, expected: &[u8; 9], palette: &Palette) -> Vec<usize> {
    let norm = |rgb: &[f64; 3]| Vector3::from(*rgb).norm();
    // No turn moves the centre, so its known colour gives the brightness of the face.
    let centre = norm(&palette[usize::from(expected[4])]);
    let gain = norm(&reading.rgb[4]) / centre.max(1.0);
    let far = |i: usize, colour: usize| {
        (Vector3::from(reading.rgb[i]) - gain * Vector3::from(palette[colour])).norm()
    };
    let odd = |&i: &usize| {
        let own = usize::from(expected[i]);
        let other = (0..6).filter(|&c| c != own).map(|c| far(i, c)).fold(f64::INFINITY, f64::min);
        !reading.occluded[i] && other < CLEARLY * far(i, own)
    };
    (0..9).filter(odd).map(|i| i + 1).collect()
}

#[cfg(test)]
mod tests {
    use super::super::testing::{
        PALETTE, Stage, count, goes_well, one_colour, order, reading, settings, words,
    };
    use super::super::{sight, steps};
    use super::*;
    use crate::cube::{Axis, Facelets, Turn};
    use crate::generators::{Behaviour, Outcome};
    use crate::kernel::{Action, Event, View};
    use crate::motion::{Depth, JointPositions};
    use crate::operator::Answer;
    use crate::reach::MeetingPath;
    use crate::tasks::cube::hold::{Hold, Step};

    #[test]
    fn sides_are_inspected_in_the_quickest_order() {
        let mut stage = stage(None);
        let at = |track: f64| {
            let meeting = stage.robot.settings.meetings.grasps[0].unwrap();
            Meeting { track: JointPositions([track; 7]), ..meeting }
        };
        let [here, across, along, other] = [0.0, 0.1, 0.2, 0.3].map(at);
        let side = |shows, meeting| Side { face: Face::U, shows, meeting };
        let sides = [
            side(Shows::TurnsAcross, across),
            side(Shows::TurnsAlong, along),
            side(Shows::TurnsAlong, other),
        ];
        let table = &mut stage.robot.settings.meetings;
        table.grasps[0] = Some(here);
        table.views[0] = [Some(across), Some(along), Some(other)];
        stage.robot.meeting = Some(here);
        let both = [Shows::TurnsAcross, Shows::TurnsAlong];
        let next = |stage: &Stage, sides: &[Side], missing: &[Shows]| {
            quickest(&stage.robot, Hand::Track, sides, missing)
        };
        assert_eq!(next(&stage, &sides, &both), Some(0), "no path is known");

        // The table has a path between any two of 30 meetings, for each of the two newcomers. The
        // views have the numbers 24 to 26.
        let mut ways = |back: f64| {
            let way = |seconds| {
                let (separation, stroke, across, ramp) = (0.1, 0.3, 0.1, 0.1);
                Some(MeetingPath { separation, stroke, across, ramp, seconds })
            };
            let seconds = |i: usize| match (i / 2 / 30, i / 2 % 30) {
                (0, 24) => 3.0,
                (0, 25) => 1.0,
                (25, 24) => back,
                _ => 2.0,
            };
            stage.robot.settings.meetings.ways =
                (0..30 * 30 * 2).map(|i| way(seconds(i))).collect();
            next(&stage, &sides, &both)
        };
        assert_eq!(ways(2.0), Some(1));
        assert_eq!(ways(9.0), Some(2), "the quickest first path leads to a slow second one");
        assert_eq!(next(&stage, &sides, &[Shows::TurnsAcross]), Some(0));
        assert_eq!(next(&stage, &sides, &[]), None);
    }

    /// Letters of the solved cube.
    const SOLVED: &str = "UUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB";

    /// Makes a stage after all turns: each side has one colour, and the track holds the cube.
    fn stage(patience: Option<f64>) -> Stage {
        let mut stage = Stage::holding(settings());
        stage.robot.palette = Some(PALETTE);
        stage.robot.shown.facelets = SOLVED.parse().ok();
        stage.robot.patience = patience;
        stage
    }

    /// Returns the reading with its pose, which is relative to the believed one of the face, in the
    /// camera.
    fn placed(view: &View, mut reading: FaceReading) -> FaceReading {
        reading.camera_from_face = view.camera_from_face * reading.camera_from_face;
        reading
    }

    /// Inspects the cube. `look` gets the number of earlier looks and the face, and returns the
    /// reading, as [`placed`] takes it. Returns the result, the number of looks and the number of
    /// questions.
    fn inspects(
        stage: &mut Stage,
        mut answers: Vec<Option<Answer>>,
        look: impl Fn(usize, Face) -> Result<FaceReading, String>,
    ) -> (Result<(), Failure>, usize, usize) {
        let (port, mut looks) = (stage.port.clone(), 0);
        let inspects = async |robot: &mut Robot| inspect(robot, false).await;
        let (end, actions) = stage.play(inspects, &mut |action, arms| match action {
            Action::Look { view, .. } => {
                let (face, _) = port.state(|shared| shared.looking).unwrap();
                looks += 1;
                Event::Looked(look(looks - 1, face).map(|reading| placed(view, reading)))
            }
            Action::Ask(question) => {
                assert!(question.text.contains("could not be inspected"), "{}", question.text);
                Event::Answered(answers.pop().flatten())
            }
            _ => goes_well(action, arms),
        });
        (end, looks, count(&actions, "ask"))
    }

    #[test]
    fn tilted_cube_ends_inspection_with_giving_it_back() {
        let tilted = |_, face| {
            let tilt = nalgebra::Translation3::identity()
                * nalgebra::UnitQuaternion::from_euler_angles(0.35, 0.0, 0.0);
            Ok(FaceReading { camera_from_face: tilt, ..one_colour(face) })
        };

        let (end, looks, _) = inspects(&mut stage(None), vec![], tilted);

        let Err(Failure::GiveBack(why)) = end else { panic!("{end:?}") };
        assert!(why.contains("tilted by 20 deg in the track hand") && looks == 2, "{why}");
    }

    /// Returns the failure of a look without light.
    fn dark() -> Result<FaceReading, String> {
        Err("the picture is black".to_owned())
    }

    #[test]
    fn uninspectable_cube_is_returned_with_the_reason() {
        let covered = |face: Face| Ok(FaceReading { occluded: [true; 9], ..one_colour(face) });
        for black in [true, false] {
            let look = |_, face| if black { dark() } else { covered(face) };

            let (end, ..) = inspects(&mut stage(None), vec![], look);

            let Err(Failure::GiveBack(why)) = end else { panic!("{end:?}") };
            let reason =
                if black { ": the picture is black" } else { "1, 2, 3, 4, 5, 6, 7, 8, 9 are" };
            assert!(why.contains("could not be inspected") && why.contains(reason), "{why}");
        }
        // One side that cannot be inspected is enough.
        let look = |_, face| if face == Face::U { dark() } else { Ok(one_colour(face)) };
        let (end, ..) = inspects(&mut stage(None), vec![], look);
        let Err(Failure::GiveBack(why)) = end else { panic!("{end:?}") };
        assert!(why.starts_with("face U could not"), "{why}");
    }

    #[test]
    fn too_few_views_fail_the_inspection() {
        let meeting = settings().meetings.views[0][0];
        for (views, enough) in [
            ([meeting; 3], true),
            // One of the two sides beside the jaws is enough.
            ([meeting, None, meeting], true),
            ([meeting, meeting, None], true),
            ([meeting, None, None], false),
            ([None, meeting, meeting], false),
        ] {
            let mut stage = stage(None);
            stage.robot.settings.meetings.views = [views; 2];

            let (end, ..) = inspects(&mut stage, vec![], |_, face| Ok(one_colour(face)));

            assert_eq!(end.is_ok(), enough, "{end:?}");
            assert_eq!(format!("{end:?}").contains("no pose for the looks"), !enough, "{end:?}");
        }
    }

    #[test]
    fn two_unexpected_stickers_require_another_reading() {
        for (covered, reread) in [(0, true), (1, true), (2, false)] {
            // One odd sticker counts as a reflection. Some of the three at the rim may be covered.
            let look = |looks, face: Face| {
                let own = face as u8;
                let other = (own + 1) % 6;
                let mut reading = reading([other, other, other, own, own, own, own, own, own], 1.0);
                if looks > 0 {
                    return Ok(one_colour(face));
                }
                reading.rgb[..covered].copy_from_slice(&one_colour(face).rgb[..covered]);
                reading.occluded[0] = covered > 0;
                Ok(reading)
            };

            let (end, ..) = inspects(&mut stage(None), vec![], look);

            let expected = if reread { Err(Failure::ReadAgain { release: None }) } else { Ok(()) };
            assert_eq!(end, expected, "{covered}");
        }
    }

    #[test]
    fn hidden_cube_is_inspected_once_more() {
        // Three tries at each of three sides; the second inspection needs two looks.
        let look = |looks, face| if looks < 9 { dark() } else { Ok(one_colour(face)) };

        let (end, looks, asked) = inspects(&mut stage(Some(30.0)), vec![], look);

        assert_eq!((end, looks, asked), (Ok(()), 11, 0));
    }

    #[test]
    fn operator_answer_repeats_inspection_of_hidden_cube() {
        // Two inspections in vain need 18 looks, and the one after the answer two.
        let again = || Some(Answer::Choice { option: 0 });
        let look = |looks, face| if looks < 18 { dark() } else { Ok(one_colour(face)) };
        let (end, looks, asked) = inspects(&mut stage(Some(30.0)), vec![again()], look);
        assert_eq!((end, looks, asked), (Ok(()), 20, 1));

        // A second question comes only after as many looks in vain.
        let look = |looks, face| if looks < 27 { dark() } else { Ok(one_colour(face)) };
        let (end, looks, asked) = inspects(&mut stage(Some(30.0)), vec![again()], look);
        assert_eq!((end, looks, asked), (Ok(()), 29, 1));

        for answer in [Some(Answer::Choice { option: 1 }), Some(Answer::Declined), None] {
            let (end, ..) = inspects(&mut stage(Some(30.0)), vec![answer], |_, _| dark());
            let Err(Failure::GiveBack(why)) = end else { panic!("{end:?}") };
            assert!(why.contains("the picture is black"), "{why}");
        }
    }

    #[test]
    fn unturned_row_is_detected_at_any_brightness() {
        for gain in [0.5, 1.0, 1.15] {
            let expected = [4; 9];
            assert!(unexpected_stickers(&reading(expected, gain), &expected, &PALETTE).is_empty());

            let seen = [1, 1, 1, 4, 4, 4, 4, 4, 4];
            assert_eq!(unexpected_stickers(&reading(seen, gain), &expected, &PALETTE), [1, 2, 3]);
        }
    }

    #[test]
    fn covered_stickers_are_not_compared() {
        let mut covered = reading([1, 1, 1, 4, 4, 4, 4, 4, 4], 1.0);
        covered.occluded[..3].fill(true);

        assert!(unexpected_stickers(&covered, &[4; 9], &PALETTE).is_empty());
    }

    #[test]
    fn unseen_colour_gets_default_palette_value() {
        let colours = std::array::from_fn(|i| (i / 9) as u8);
        let seen = std::array::from_fn(|i| (i >= 9).then(|| PALETTE[i / 9]));
        let palette = sight::palette(&seen, &colours);

        assert_eq!(palette[1..], PALETTE[1..]);
        assert!(unexpected_stickers(&reading([0; 9], 1.0), &[0; 9], &palette).is_empty());
        let seen = [0, 0, 0, 3, 3, 3, 3, 3, 3];
        assert_eq!(unexpected_stickers(&reading(seen, 1.0), &[3; 9], &palette), [1, 2, 3]);
    }

    /// Carries out turns that undo each other, with grasps between them, then inspects the cube.
    /// With `stalls` the first turn takes two motions, and the looks after it show the cube `seen`.
    /// Returns the number of looks, and the result.
    fn turns_twice(stalls: bool, seen: Facelets) -> (usize, Result<(), Failure>) {
        let mut stage = stage(None);
        let robot = &mut stage.robot;
        let hold = |palm: Face| Hold { palm, jaws: Axis::X, depth: Depth::One };
        robot.hold(Hand::Postument);
        robot.belief.taken(Hand::Track, hold(Face::U), false);
        robot.belief.taken(Hand::Postument, hold(Face::F), false);
        (robot.apart, robot.meeting) = (false, settings().meetings.grasps[0]);
        let turn =
            |quarters| Step::Turn { turner: Hand::Track, turn: Turn { face: Face::U, quarters } };
        let hand = Hand::Track;
        let grasp = Step::Grasp { hand, hold: hold(Face::U), half_roll: false };
        // At the second grasp the cube is as expected, for both states before the first grasp.
        let steps = [turn(1), grasp, turn(3), grasp, turn(1), turn(3)];

        let (port, mut looks, mut turns) = (stage.port.clone(), 0, 0);
        let between = if stalls { 2 } else { 0 };
        let goes = async |robot: &mut Robot| {
            steps::carry_out(robot, &steps).await?;
            inspect(robot, false).await
        };
        let (end, _) = stage.play(goes, &mut |action, arms| match (action, order(action)) {
            (Action::Look { view, .. }, _) => {
                looks += 1;
                let (face, _) = port.state(|shared| shared.looking).unwrap();
                let first = 9 * face.index();
                let turned = std::array::from_fn(|i| seen.colours()[first + i]);
                let colours = if looks <= between { turned } else { [face as u8; 9] };
                Event::Looked(Ok(placed(view, reading(colours, 1.0))))
            }
            (_, Some(Behaviour::Turn { .. })) => {
                turns += 1;
                if stalls && turns == 1 {
                    Event::Behaved(vec![Some(Outcome::Stalled(0.5, 2.0)), Some(Outcome::Ended)])
                } else {
                    goes_well(action, arms)
                }
            }
            _ => goes_well(action, arms),
        });
        (looks, end)
    }

    #[test]
    fn cube_is_inspected_after_stalled_turn_before_regrasp() {
        let solved: Facelets = SOLVED.parse().unwrap();
        let after = solved.turned(Turn { face: Face::U, quarters: 1 });

        assert_eq!(turns_twice(false, after), (2, Ok(())));
        assert_eq!(turns_twice(true, after), (4, Ok(())));
        // The layer did not follow the hand, so all faces are read again.
        assert_eq!(turns_twice(true, solved), (2, Err(Failure::ReadAgain { release: None })));
    }

    #[test]
    fn inspection_looks_at_two_sides() {
        let mut stage = Stage::holding(settings());
        stage.robot.palette = Some(PALETTE);
        stage.robot.shown.facelets = SOLVED.parse().ok();
        let port = stage.port.clone();

        let inspects = async |robot: &mut Robot| inspect(robot, true).await;
        let (end, actions) = stage.play(inspects, &mut |action, arms| match action {
            Action::Look { view, .. } => {
                let (face, _) = port.state(|shared| shared.looking).unwrap();
                Event::Looked(Ok(placed(view, one_colour(face))))
            }
            _ => goes_well(action, arms),
        });

        let side = ["joints", "joints", "look"];
        // Both arms are apart at first.
        let again = ["joints", "joints", "joints", "look"];
        let all = [&["inspect"][..], &side, &again, &["solve"]].concat();
        assert_eq!((end, words(&actions)), (Ok(()), all));
    }
}
