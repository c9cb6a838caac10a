//! Reading of the six faces by the cameras in the hands, until the cube is decided and planned.
//!
//! A face that stays hidden is looked at in another grasp. After a doubt about stickers only their
//! faces are looked at again.
//!
//! - in: the looks that the planner finds; the conclusion of the long work
//! - out: the steps of the plan
//! - source: Zieliński et al. (2007), pp. 372-373; heuristics: own work
//!
//! | limit | value | reason |
//! |---|---|---|
//! | [`LOOK_ROUNDS`] | 2 | rounds of looks, the second at another exposure |
//! | [`MOST_HIDDEN`] | 3 | faces hidden in a grasp, from which on no other grasp is tried |

use super::failure::Failure;
use super::robot::Robot;
use super::steps::carry_out_step;
use super::{questions, sight};
use crate::cube::{Face, facelet_place};
use crate::tasks::cube::hold::Step;
use crate::tasks::cube::plan::{Planner, Stop};
use crate::tasks::cube::think::{Answer, Conclusion, Doubt, NoAnswer, Thought};

/// Rounds of looks, the second at another exposure.
const LOOK_ROUNDS: u32 = 2;
/// Number of times that a face was hidden in a grasp from which on no other grasp is tried.
const MOST_HIDDEN: usize = 3;

/// Reads the cube in the hand that holds it, and returns the steps of the plan.
pub(super) async fn read_and_plan(robot: &mut Robot) -> Result<Vec<Step>, Failure> {
    robot.check_hold()?;
    let steps = missing_looks(robot)?;
    show_all(robot, steps).await?;
    robot.phase("plan").await?;
    loop {
        // Stickers that no look has shown are asked for, and never guessed.
        if let Some(doubt) = unreadable(robot) {
            questions::ask_for_colours(robot, doubt).await?;
            continue;
        }
        let thought = thought(robot)?;
        match robot.think(thought).await? {
            Conclusion(Ok(answer)) => return Ok(decide(robot, answer)),
            // The colours are clear, so that neither a look nor the operator would help.
            Conclusion(Err(NoAnswer::Unplanned(why))) => return Err(Failure::GiveBack(why)),
            // A second round of looks comes first, then the operator is asked.
            Conclusion(Err(NoAnswer::Unread(doubt))) => match looks_again(robot, &doubt) {
                Some(steps) => {
                    robot.phase("identify again").await?;
                    show_all(robot, steps).await?;
                    robot.phase("plan").await?;
                }
                None => questions::ask_for_colours(robot, *doubt).await?,
            },
        }
    }
}

/// Returns the looks that show the stickers not seen yet.
fn missing_looks(robot: &mut Robot) -> Result<Vec<Step>, String> {
    let start = robot.held_alone()?;
    let planner = Planner::new(&robot.settings).starting_at(place(robot));
    planner.looks_at(start, robot.sight.wanted()).map_err(|e| e.to_string())
}

/// Returns the meeting at which the hands are; `None` if they are apart or have not met yet.
fn place(robot: &Robot) -> Option<Stop> {
    let meeting = robot.meeting.filter(|_| !robot.apart)?;
    robot.settings.meetings.number(&meeting).and_then(Stop::numbered)
}

/// Carries out looks. After a face that stays hidden the looks are planned again, with other grasps
/// for that face.
async fn show_all(robot: &mut Robot, mut steps: Vec<Step>) -> Result<(), Failure> {
    let mut next = 0;
    while let Some(step) = steps.get(next) {
        next += 1;
        match carry_out_step(robot, *step, false).await {
            Err(Failure::Hidden { face, why }) => {
                if let Some(others) = other_looks(robot, face, why)? {
                    (steps, next) = (others, 0);
                }
            }
            shown => shown?,
        }
    }
    Ok(())
}

/// Returns looks at a face in other grasps, since it is hidden in the present one for the reason
/// `why`. If there are none, the face stays unread, and the operator is asked about it later.
fn other_looks(robot: &mut Robot, face: Face, why: String) -> Result<Option<Vec<Step>>, Failure> {
    let (holder, grip) = robot.held_alone()?;
    if robot.sight.hide(holder, grip.hold, face) < MOST_HIDDEN
        && let Ok(steps) = missing_looks(robot)
    {
        robot.note(format!("{why}: the cube is regrasped"));
        return Ok(Some(steps));
    }
    if robot.patience.is_none() {
        return Err(Failure::GiveBack(why));
    }
    robot.note(why);
    Ok(None)
}

/// Returns the doubt about stickers that were never seen, if an operator can be asked about them.
fn unreadable(robot: &Robot) -> Option<Doubt> {
    let missing = robot.sight.missing();
    if robot.given.is_some() || robot.patience.is_none() || missing.is_empty() {
        return None;
    }
    let names: Vec<String> = missing.iter().map(|&i| facelet_place(i).to_string()).collect();
    let reason = format!("stickers {} cannot be read", names.join(", "));
    Some(Doubt { reason, read: None, doubtful: missing, possible: false })
}

/// Returns the input of the long computation that decides the colours, solves the cube and plans
/// the steps.
fn thought(robot: &Robot) -> Result<Thought, String> {
    let mut rgb = [[0.0; 3]; 54];
    for (i, seen) in robot.sight.levels().into_iter().enumerate() {
        // The colours that the operator gave need no measurement: black fills the gaps.
        let given = robot.given.map(|_| [0.0; 3]);
        let unseen = || format!("sticker {} was never seen", facelet_place(i));
        rgb[i] = seen.or(given).ok_or_else(unseen)?;
    }
    let s = &robot.settings;
    Ok(Thought {
        rgb,
        given: robot.given,
        start: robot.held_alone()?,
        strategy: s.strategy.clone(),
        planner: Planner::new(s).starting_at(place(robot)),
        nodes: s.nodes,
        candidates: s.candidates,
        seconds_per_node: s.seconds_per_node,
    })
}

/// Stores the decided colours and the plan, and returns the steps of the plan.
fn decide(robot: &mut Robot, answer: Answer) -> Vec<Step> {
    robot.shown.decide(&answer);
    if let Some(remark) = &answer.remark {
        robot.note(remark.clone());
    }
    let levels = robot.sight.levels();
    robot.palette = Some(sight::palette(&levels, answer.read.colours()));
    // The summary shows the first reading and the first plan.
    if robot.log.identified.is_none() {
        robot.log.identified = Some(answer.identified);
        robot.log.solution = answer.turns;
        robot.log.expected = Some(answer.expected);
        robot.log.rule.clone_from(&answer.remark);
        robot.log.plan = answer.lines;
        robot.log.grasps = 0;
    }
    // From here on the cube frame is named by the colours of the centres, not by the first grasp.
    robot.belief.renamed(answer.rotation);
    robot.sight.rename();
    answer.steps
}

/// Forgets the stickers of the faces in doubt and returns the looks at these faces; `None` after
/// the last round, or if no looks are possible.
fn looks_again(robot: &mut Robot, doubt: &Doubt) -> Option<Vec<Step>> {
    if robot.rounds >= LOOK_ROUNDS {
        return None;
    }
    // A doubt that names no sticker concerns all faces.
    let mut again = [doubt.doubtful.is_empty(); 6];
    doubt.doubtful.iter().for_each(|facelet| again[facelet / 9] = true);
    let before = robot.sight.clone();
    robot.sight.forget(again);
    let Ok(steps) = missing_looks(robot) else {
        // The stickers of the first round are still the best for the question to the operator.
        robot.sight = before;
        return None;
    };
    let faces: String =
        Face::ALL.iter().filter(|face| again[face.index()]).map(|face| face.letter()).collect();
    robot.note(format!("{doubt}: faces {faces} are looked at again", doubt = doubt.reason));
    robot.rounds += 1;
    Some(steps)
}

#[cfg(test)]
mod tests {
    use super::super::look::{LOOK_TRIES, NUDGES};
    use super::super::testing::{Stage, goes_well, order, settings};
    use super::*;
    use crate::generators::Behaviour;
    use crate::kernel::{Action, Event};
    use crate::spatial::Pose;
    use crate::tasks::cube::hold::{Hand, Hold};
    use crate::vision::sensor::FaceReading;
    use nalgebra::{UnitQuaternion, Vector3};

    /// Look at a face in a hold, and whether the camera moved aside or nearer for it.
    #[derive(Debug, Clone, Copy, PartialEq)]
    struct Look {
        face: Face,
        hold: Hold,
        nudged: bool,
    }

    /// Result of a reading.
    #[derive(Debug)]
    struct Read {
        end: Result<Vec<Step>, Failure>,
        /// Looks before each thought, and those after the last thought.
        looks: Vec<Vec<Look>>,
        questions: Vec<String>,
    }

    /// Reads the cube on a stage. `hides` returns which stickers of a face are hidden in a hold.
    /// `doubts` are those of [`sees`].
    fn read(
        stage: &mut Stage,
        doubts: Vec<Doubt>,
        hides: impl Fn(Face, Hold) -> [bool; 9],
    ) -> Read {
        sees(stage, doubts, |face, hold, camera_from_face| {
            let reading = super::super::testing::reading([0; 9], 1.0);
            Ok(FaceReading { camera_from_face, occluded: hides(face, hold), ..reading })
        })
    }

    /// Reads the cube on a stage. `looks_at` returns what a look at a face in a hold sees, with the
    /// believed `camera_from_face`. Each request to compute a plan is answered with the last one of
    /// `doubts`, which is removed, and with the failure to find a plan when none is left.
    fn sees(
        stage: &mut Stage,
        mut doubts: Vec<Doubt>,
        mut looks_at: impl FnMut(Face, Hold, Pose) -> Result<FaceReading, String>,
    ) -> Read {
        let port = stage.port.clone();
        let (mut looks, mut questions, mut nudged) = (vec![Vec::new()], Vec::new(), false);
        let (end, _) =
            stage.play(
                async |robot| read_and_plan(robot).await,
                &mut |action, arms| match action {
                    Action::Look { effector, view } => {
                        let (face, held) = port.state(|shared| shared.looking).unwrap();
                        let hold = held[1 - effector].unwrap().hold;
                        let look = Look { face, hold, nudged: std::mem::take(&mut nudged) };
                        looks.last_mut().unwrap().push(look);
                        Event::Looked(looks_at(face, hold, view.camera_from_face))
                    }
                    Action::Think(_) => {
                        looks.push(Vec::new());
                        Event::Thought(Conclusion(Err(match doubts.pop() {
                            Some(doubt) => NoAnswer::Unread(Box::new(doubt)),
                            None => NoAnswer::Unplanned("thought".to_owned()),
                        })))
                    }
                    Action::Ask(question) => {
                        questions.push(question.text.clone());
                        Event::Answered(None)
                    }
                    action => {
                        if let Some(Behaviour::Line { target, .. }) = order(action) {
                            let by: [f64; 3] = target.translation.vector.into();
                            nudged |= NUDGES.contains(&by);
                        }
                        goes_well(action, arms)
                    }
                },
            );
        Read { end, looks, questions }
    }

    /// Hides sticker 3 of the upper face as long as the palm is on the lower face.
    fn under_a_finger(face: Face, hold: Hold) -> [bool; 9] {
        std::array::from_fn(|i| i == 2 && face == Face::U && hold.palm == Face::D)
    }

    /// Returns the holds in which the upper face was looked at.
    fn upper(looks: &[Look]) -> Vec<Hold> {
        looks.iter().filter(|look| look.face == Face::U).map(|look| look.hold).collect()
    }

    #[test]
    fn covered_sticker_is_read_in_another_grasp() {
        let mut stage = Stage::holding(settings());

        let Read { looks, .. } = read(&mut stage, vec![], under_a_finger);

        assert_eq!(looks.len(), 2, "the planner is asked once");
        assert!(stage.robot.sight.missing().is_empty());
        let upper = upper(&looks[0]);
        // The face is covered in each hold with that palm, and every one of them is tried once.
        let mut covered: Vec<Hold> =
            upper.iter().copied().filter(|hold| hold.palm == Face::D).collect();
        assert_eq!(upper.len(), covered.len() + 1);
        let looks_covered = covered.len();
        covered.dedup();
        assert_eq!(looks_covered, covered.len() * LOOK_TRIES as usize, "{covered:?}");
        // Each of the other faces is looked at once.
        assert_eq!(looks[0].len(), upper.len() + 5, "{looks:?}");
    }

    #[test]
    fn hidden_sticker_is_never_guessed() {
        let always = |face: Face, _: Hold| std::array::from_fn(|i| i == 2 && face == Face::U);

        let Read { end, looks, .. } = read(&mut Stage::holding(settings()), vec![], always);

        let mut holds = upper(&looks[0]);
        assert_eq!(holds.len(), MOST_HIDDEN * LOOK_TRIES as usize);
        holds.dedup();
        assert_eq!(holds.len(), MOST_HIDDEN, "{holds:?}");
        assert!(looks.len() == 1 && matches!(end, Err(Failure::GiveBack(_))), "{end:?}");

        let mut stage = Stage::holding(settings());
        stage.robot.patience = Some(60.0);
        let Read { questions, .. } = read(&mut stage, vec![], always);
        assert!(questions[0].contains("U3 cannot be read"), "{questions:?}");
    }

    #[test]
    fn only_faces_with_doubtful_stickers_are_reread() {
        let doubt = || Doubt {
            reason: "red?".into(),
            read: None,
            doubtful: vec![9, 12, 40],
            possible: true,
        };
        let mut stage = Stage::holding(settings());

        let Read { end, looks, .. } = read(&mut stage, vec![doubt(), doubt()], |_, _| [false; 9]);

        assert_eq!(looks[0].len(), 6);
        assert!(looks[0].iter().all(|look| !look.nudged), "{looks:?}");
        let mut faces: Vec<Face> = looks[1].iter().map(|look| look.face).collect();
        faces.sort_unstable();
        assert_eq!(faces, [Face::R, Face::L]);
        assert!(looks[1].iter().all(|look| look.nudged), "from another place: {looks:?}");
        // The doubt repeats, and there is no operator.
        assert!(looks[2].is_empty(), "{looks:?}");
        assert_eq!(end, Err(Failure::GiveBack("red?".to_owned())));
    }

    /// Reads the cube on a stage where `holder` holds it. The first looks see it upright, turned by
    /// 20 deg about the camera's x axis, or not at all (`None`), as `first` says; the others see it
    /// upright. Returns the end and the number of looks.
    fn read_tilted(holder: Hand, first: &[Option<bool>]) -> (Result<Vec<Step>, Failure>, usize) {
        let mut stage = Stage::holding(settings());
        let held = stage.robot.belief.held[Hand::Track.index()].take();
        stage.robot.belief.held[holder.index()] = held;
        let mut first = first.iter();
        let Read { end, looks, .. } = sees(&mut stage, vec![], |_, _, mut camera_from_face| {
            let tilted = first.next().copied().unwrap_or(Some(false));
            let angle = if tilted.ok_or("no face")? { 20_f64.to_radians() } else { 0.0 };
            let tilt = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle);
            camera_from_face.rotation = tilt * camera_from_face.rotation;
            let reading = super::super::testing::reading([0; 9], 1.0);
            Ok(FaceReading { camera_from_face, ..reading })
        });
        (end, looks.concat().len())
    }

    #[test]
    fn tilted_cube_is_never_grasped_by_other_hand() {
        let (end, looks) = read_tilted(Hand::Track, &[Some(true); 9]);
        let Err(Failure::GiveBack(why)) = end else { panic!("{end:?}") };
        assert!(why.contains("tilted by 20 deg in the track hand"), "{why}");
        assert_eq!(looks, 2, "a single tilted pose is not believed");

        let (end, _) = read_tilted(Hand::Postument, &[Some(true); 9]);
        assert!(matches!(end, Err(Failure::Final(_))), "{end:?}");

        // A second look at the first face, then one at each of the other five.
        let (end, looks) = read_tilted(Hand::Track, &[Some(true)]);
        assert_eq!((end, looks), (Err(Failure::GiveBack("thought".to_owned())), 7));

        // No later look contradicts the tilted pose.
        let (end, looks) = read_tilted(Hand::Track, &[&[Some(true)][..], &[None; 5]].concat());
        let Err(Failure::GiveBack(why)) = end else { panic!("{end:?}") };
        assert!(why.contains("tilted by 20 deg") && looks == LOOK_TRIES as usize, "{why}");
    }
}
