//! The door of the cube tasks: what a scenario must have for them, and how their kernel is made.
//!
//! - in: the controller's half of a scenario, the meetings of the arms, what the journal says
//! - out: faults of the scenario; the kernel with its settings, tables of the solver and start

use super::hold::{Hand, Hold};
use super::keys;
use super::mission::{Assignment, Entry, Goal, Mission};
use super::plan::Rule;
use super::settings::{ArmBelief, ComplianceChoice, CompliantArm, CubeSettings};
use super::strategy::{Exact, Strategy};
use crate::actors::manner::manner;
use crate::cell::{Cell, Gripper, Mount};
use crate::cube::{Axis, Face, Keeper};
use crate::generators::visual_servo;
use crate::motion::Depth;
use crate::reach::{Fold, Meeting, MeetingTable, ReachSettings, WayFinder, meeting_place};
use crate::registry::{Earlier, Setup, Task};
use crate::scenario::declared::Properties;
use crate::scenario::lists::VspKind;
use crate::scenario::section::Reader;
use crate::scenario::{self, ControllerConfig};
use crate::solver::table::TableSpec;
use crate::solver::tables::Bytes;
use crate::solver::{Tables, korf, optimal};
use crate::spatial::Pose;
use crate::tables::{News, Observer, Residence, Store, Threads};
use std::f64::consts::PI;
use std::sync::LazyLock;

/// Time that the operator has for an answer (s).
const PATIENCE: f64 = 120.0;

/// Task `solve`: the robot takes the cube, reads it, solves it and gives it back.
#[derive(Debug)]
pub struct Solve;

/// Task `acquire`: the robot takes the cube and gives it back.
#[derive(Debug)]
pub struct Acquire;

/// Properties of the tasks of the cube, which both hands hold.
const PLAIN: Properties = Properties { most_effectors: 2, ..Properties::PLAIN };

/// Task `face_turn`: both arms hold the cube and turn one layer.
#[derive(Debug)]
pub struct FaceTurn;

/// Name of the section of the planner's keys.
const PLANNER: &str = "planner";

impl Task for Solve {
    type Keys = keys::Planner;
    type Kernel = Mission;
    const SECTION: Option<&'static str> = Some(PLANNER);
    const PROPERTIES: Properties =
        Properties { hands_over: true, resumes: true, walks: true, ..PLAIN };

    fn check(keys: &mut keys::Planner, config: &ControllerConfig, reader: &mut Reader) {
        two_arms("solve", config, reader);
        sees_cube("solve", config, reader);
        // With one effector the fault above says enough.
        if count(config, VspKind::Face) < 2 && config.cell.arms.len() > 1 {
            let reason =
                "task \"solve\" needs a [[vsp]] with kind = \"face\" for the camera in each hand";
            reader.fault(list(config), reason);
        }
        palms(keys, config, reader);
    }

    fn kernel(setup: Setup<'_, Self>) -> Result<Mission, String> {
        mission(setup, Goal::Solve)
    }
}

impl Task for Acquire {
    type Keys = keys::Planner;
    type Kernel = Mission;
    const SECTION: Option<&'static str> = Some(PLANNER);
    const PROPERTIES: Properties = Properties { hands_over: true, ..PLAIN };

    fn check(keys: &mut keys::Planner, config: &ControllerConfig, reader: &mut Reader) {
        two_arms("acquire", config, reader);
        sees_cube("acquire", config, reader);
        palms(keys, config, reader);
    }

    fn kernel(setup: Setup<'_, Self>) -> Result<Mission, String> {
        mission(setup, Goal::Acquire)
    }
}

impl Task for FaceTurn {
    type Keys = keys::FaceTurn;
    type Kernel = Mission;

    const PROPERTIES: Properties = PLAIN;

    fn check(keys: &mut keys::FaceTurn, config: &ControllerConfig, reader: &mut Reader) {
        two_arms("face_turn", config, reader);
        if keys.angle.abs() < 1_f64.to_radians() {
            let reason = "`face_turn.angle_deg`: a turn must be at least 1 deg";
            reader.fault("face_turn.angle_deg", reason);
        }
    }

    fn kernel(setup: Setup<'_, Self>) -> Result<Mission, String> {
        let meetings = setup.meetings.as_ref().ok_or("a face turn needs two arms")?;
        // For a half turn the angle may have the other sense, in which the wrist has room.
        let (start, angle) = face_turn_start(meetings, setup.keys.angle)?;
        let held = Some((Hand::Postument, start.body, start.half_roll));
        let assignment = Assignment { held, ..assignment(&setup, Goal::FaceTurn(angle)) };
        Ok(Mission::new(settings_of(setup)?, assignment))
    }
}

/// Makes the kernel for this goal.
fn mission<T: Task<Kernel = Mission>>(setup: Setup<'_, T>, goal: Goal) -> Result<Mission, String> {
    let assignment = assignment(&setup, goal);
    Ok(Mission::new(settings_of(setup)?, assignment))
}

/// Returns the assignment for this goal. A mission that continues another run first looks at jaws
/// and cameras; the journal's last entry tells it what these cannot show.
fn assignment<T: Task<Kernel = Mission>>(setup: &Setup<'_, T>, goal: Goal) -> Assignment {
    // Without a limit of time the kernel asks no questions: no operator could answer.
    let patience = setup.has_operator.then_some(PATIENCE);
    let assignment = Assignment { patience, ..Assignment::new(goal) };
    match &setup.earlier {
        Earlier::None => assignment,
        Earlier::NotBegun => assignment.resumed(None),
        Earlier::Last(entry) => assignment.resumed(Some(Entry::clone(entry))),
    }
}

/// Returns the settings of the kernel.
fn settings_of<T: Task>(setup: Setup<'_, T>) -> Result<CubeSettings, String> {
    let reach = ReachSettings::default();
    let settings = setup.meetings.and_then(|table| cube_settings(setup.config, table, &reach));
    settings.ok_or_else(|| "the cube task needs two effectors".to_owned())
}

/// Checks that there are two effectors, and that the one on the track comes first.
fn two_arms(task: &str, config: &ControllerConfig, reader: &mut Reader) {
    match &config.cell.arms[..] {
        [_] => {
            let reason = format!(
                "`task`: \"{task}\" needs two effectors, the one on the track first, but there \
                 is only one"
            );
            let advice = "task = \"idle\" accepts any number of effectors";
            reader.fault_with_help("task", reason, advice);
        }
        [first, second] if !first.model.has_track => {
            let reason = format!(
                "`task`: \"{task}\" needs the effector on the track first in the list: \"{}\" \
                 before \"{}\"",
                second.name, first.name
            );
            reader.fault(&format!("effector.{}", first.name), reason);
        }
        _ => {}
    }
}

/// Checks that a fixed camera finds the cube.
fn sees_cube(task: &str, config: &ControllerConfig, reader: &mut Reader) {
    if count(config, VspKind::Cube) == 0 {
        let reason =
            format!("task \"{task}\" needs a [[vsp]] with kind = \"cube\" and a fixed camera");
        reader.fault(list(config), reason);
    }
}

/// Returns the number of virtual sensors of this kind.
fn count(config: &ControllerConfig, kind: VspKind) -> usize {
    config.vsps.iter().filter(|vsp| vsp.kind == kind).count()
}

/// Returns the key for a fault of the list of sensors. A scenario without any sensor has no list at
/// which the fault could be.
fn list(config: &ControllerConfig) -> &'static str {
    if config.vsps.is_empty() { "task" } else { "vsp" }
}

/// Checks that the rule of the planner agrees with the palms, if the user has given it.
fn palms(keys: &keys::Planner, config: &ControllerConfig, reader: &mut Reader) {
    let Some(presses) = config.effectors.iter().position(|effector| !effector.palm_clearance)
    else {
        return;
    };
    if keys.rule == keys::Rule::Clearance && reader.is_given("planner.rule") {
        let reason = format!(
            "`planner.rule`: \"clearance\" needs palms that keep a distance from the cube, but \
             effector.{}.gripper.palm_clearance is false",
            config.cell.arms[presses].name
        );
        reader.fault("planner.rule", reason);
    }
}

/// Returns the keys of solver and planner, with a rule that agrees with the palms.
#[must_use]
pub fn planner_keys(config: &ControllerConfig) -> keys::Planner {
    let mut keys = config.sections.get::<keys::Planner>(PLANNER).cloned().unwrap_or_default();
    let presses = config.effectors.iter().any(|effector| !effector.palm_clearance);
    if keys.rule == keys::Rule::Clearance && presses {
        keys.rule = keys::Rule::Strict;
    }
    keys
}

/// Returns the geometry of an arm as the controller believes it: base, tool, camera in the hand.
/// `index` 0 is the arm on the track. `None` if the cell has no arm with this index.
fn arm_belief(cell: &Cell, index: usize) -> Option<ArmBelief> {
    let arm = cell.arms.get(index)?;
    let flange_from_camera = cell.cameras.iter().find_map(|camera| match camera.mount {
        Mount::Flange { arm, flange_from_camera } if arm == index => Some(flange_from_camera),
        Mount::Flange { .. } | Mount::World { .. } => None,
    });
    Some(ArmBelief {
        world_from_base: arm.world_from_base,
        flange_from_tool: arm.flange_from_tool,
        flange_from_camera,
    })
}

/// Opening of the jaws beyond the cube's edge, before they take it from a person or a table (m).
const TAKING_ROOM: f64 = 0.031;

/// Returns the settings of the cube task; `None` if the cell does not have two arms.
#[must_use]
pub fn cube_settings(
    config: &ControllerConfig,
    meetings: MeetingTable,
    reach: &ReachSettings,
) -> Option<CubeSettings> {
    let calibrated_at = meeting_place(&config.cell, &meetings);
    let c = &config.control;
    let arm = config.cell.arms.first()?;
    let keeper = config.cell.keeper;
    let planner = planner_keys(config);
    Some(CubeSettings {
        arms: [arm_belief(&config.cell, 0)?, arm_belief(&config.cell, 1)?],
        folds: [Fold::of(arm), Fold::of(config.cell.arms.get(1)?)],
        meetings,
        ways: config.uses_shortest_paths().then(|| WayFinder::new(config.cell.clone(), *reach)),
        edge: config.cell.cube.edge,
        grip: c.grip,
        opening: (arm.gripper.opening.1 - 0.003).min(config.cell.cube.edge + TAKING_ROOM),
        regrasp_opening: (arm.gripper.opening.1 - 0.003).min(config.cell.cube.edge + c.jaw_room),
        jaw_leave: c.jaw_leave,
        back: reach.back,
        pre_grasp: c.pre_grasp,
        approach_speed: c.approach_speed,
        touch: c.approach_force,
        // Seating causes the peak force of a mission: 9 to 10 N at 8 N commanded.
        press: 2.0 * c.approach_force,
        turn_speed: c.turn_speed,
        turn_acceleration: c.turn_acceleration,
        turn_torque: c.turn_torque,
        turn_least_torque: c.turn_least_torque,
        pull: c.approach_force,
        speed: 1.0,
        // As a share of the speed of straight lines: only these lead to the operator's hand.
        gentle: (c.hand_line_speed / c.linear_speed).min(1.0),
        speeds: manner(config, 0).speeds,
        jaw_speeds: (c.jaw_close_speed, c.jaw_open_speed),
        jaw_reach: c.jaw_reach_speed,
        // First with one layer of the cube between the fingers, then with two.
        finger_depth: [Gripper::FACE_BEHIND_TOOL_ONE, Gripper::FACE_BEHIND_TOOL_TWO]
            .map(|behind| behind + arm.gripper.finger_tip),
        finger_width: arm.gripper.finger_width,
        compliant_arm: match c.compliant_arm {
            scenario::keys::CompliantArm::Body => CompliantArm::Body,
            scenario::keys::CompliantArm::Turner => CompliantArm::Turner,
        },
        compliance: match c.compliance {
            scenario::keys::Compliance::None => ComplianceChoice::None,
            scenario::keys::Compliance::Tff => ComplianceChoice::Tff,
            scenario::keys::Compliance::TffTilts => ComplianceChoice::TffTilts,
        },
        visual: visual_order(config),
        rule: match planner.rule {
            keys::Rule::Clearance => Rule::Clearance,
            keys::Rule::Strict => Rule::Strict,
            keys::Rule::Original => Rule::Original,
        },
        strategy: strategy(&planner),
        nodes: planner.node_budget,
        candidates: planner.candidates as usize,
        seconds_per_node: planner.node_cost,
        calibrated_at,
        keeper,
    })
}

/// Returns the largest linear and angular speed of the visual servo (m/s, rad/s). Beside a person
/// no part of the hand exceeds `control.hand_speed`.
fn following(config: &ControllerConfig) -> (f64, f64) {
    /// Distance of the farthest part of a hand or its cube from the tool about which it turns (m).
    const REACH: f64 = 0.15;
    let v = &config.visual_servo;
    let fastest = v.linear_speed + REACH * v.angular_speed;
    // Translation and rotation slow down in the same ratio.
    let share = match config.cell.keeper {
        Keeper::Person => (config.control.hand_speed / fastest).min(1.0),
        Keeper::Table => 1.0,
    };
    (share * v.linear_speed, share * v.angular_speed)
}

/// Time for which a lying cube must be seen at rest before it is taken (s).
const LYING_STILL_TIME: f64 = 0.24;

/// Margin around the zone of the operator's hand, for its sway and the camera's error (m).
const MARGIN: f64 = 0.03;

/// Returns the parameters with which the visual servo follows the cube and takes it.
fn visual_order(config: &ControllerConfig) -> visual_servo::Order {
    let (c, v) = (&config.control, &config.visual_servo);
    let (approach, jaws) = config.cell.taking();
    let (approach_speed, touch) = c.visual_approach();
    let keeper = config.cell.keeper;
    visual_servo::Order {
        // The task fills in the arm's base and the seat when it orders the behaviour.
        world_from_base: Pose::identity(),
        approach,
        jaws,
        seat: 0.0,
        vicinity: v.stand_off,
        frozen: 0.04,
        still: v.still,
        // A cube on a table does not move: a few pictures suffice for its pose to settle.
        still_seconds: match keeper {
            Keeper::Person => v.still_time,
            Keeper::Table => v.still_time.min(LYING_STILL_TIME),
        },
        retreat: v.withdraw,
        speed: following(config),
        acceleration: match keeper {
            Keeper::Person => c.hand_acceleration,
            Keeper::Table => c.linear_acceleration,
        },
        approach_speed,
        touch,
        inertia: v.inertia,
        // A lying cube leaves little room between the fingers at the seat and the table.
        overrun: match keeper {
            Keeper::Person => 0.015,
            Keeper::Table => 0.006,
        },
        stale: v.pose_age,
        patience: v.patience,
        zone: (config.cell.hand.world_from_cube, config.cell.hand.half_extent.add_scalar(MARGIN)),
    }
}

/// Pruning tables of the two-phase search, built once and kept in the user's folder: each process
/// of a campaign would otherwise compute them again, in about a second.
static TWO_PHASE: LazyLock<Tables> = LazyLock::new(|| Tables::with(&Tables::DEFAULT.map(kept)));

/// Returns a pruning table of the solver from the file in the user's folder; if there is none,
/// builds the table and saves it there.
fn kept(spec: &TableSpec) -> Bytes {
    let report = |spec: &TableSpec, news: News<'_>| match news {
        News::Building(_) => {
            tracing::warn!(
                "the solver's table {} is being built, which later runs use again",
                spec.name
            );
        }
        News::Waiting => {
            tracing::warn!(
                "the solver's table {} is being built by another process: waiting for it",
                spec.name
            );
        }
        News::NotKept(e) => {
            tracing::warn!("the solver's table {} cannot be saved: {e}", spec.name);
        }
    };
    let observer = Observer { listener: &report, progress: &|_| () };
    store().obtain(spec, &Threads::all(), observer)
}

/// Returns the store of a run's tables, which copies each of them into memory. A mapped file that
/// another process truncates ends this one by SIGBUS, and arms may be moving. The tables of a run
/// have some tens of MiB, with the paper's rule 317 MB; only those that no run uses are so large
/// that they must be mapped.
fn store() -> Store {
    Store::for_user().with(Residence::Copied)
}

/// Returns the rule by which one of several solutions is chosen, with its pruning tables. The
/// paper's rule needs tables of its own, which take 10 to 20 s to build at its first use.
fn strategy(planner: &keys::Planner) -> Strategy {
    let tables = &TWO_PHASE;
    match planner.strategy {
        keys::Strategy::Robot => Strategy::Robot { tables },
        keys::Strategy::Paper => Strategy::Paper {
            tables,
            exact: match planner.exact {
                // Always the small table, though a larger one is quicker: the turns and the
                // declared time must not depend on which tables are on the disk.
                keys::Exact::Table => Exact::Table(kept(&optimal::TABLES[0])),
                keys::Exact::Korf => Exact::Korf {
                    tables: korf::TABLES.each_ref().map(kept),
                    nodes: planner.korf_node_budget,
                },
            },
        },
    }
}

/// Start of a face turn: the postument's hand holds two layers, the track's hand is retracted from
/// the opposite face.
#[derive(Debug)]
pub struct FaceTurnStart {
    /// Hold of the postument's hand.
    pub body: Hold,
    /// Whether the postument has the second of the two equivalent tool frames of its hold.
    pub half_roll: bool,
    /// Joint positions of both arms.
    pub meeting: Meeting,
}

/// Distance of a turn's end from the limits of the wrist (rad).
const ROLL_MARGIN: f64 = 0.12;

/// Finds the hold and the joint positions from which the track's wrist can turn by `angle` (rad)
/// about its tool's z. Returns them with the angle: a half turn may have the other sense.
///
/// # Errors
/// A message with the reason, if there is none.
pub fn face_turn_start(table: &MeetingTable, angle: f64) -> Result<(FaceTurnStart, f64), String> {
    let body = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::Two };
    let turner = Hold { palm: Face::U, jaws: Axis::Y, depth: Depth::One };
    let track = turner.cube_from_tool(false, 0.0).rotation;
    // A hold has two equivalent tool frames, half a turn of the roll apart. Each needs another
    // meeting, in which the track's wrist has another range left.
    let mut rooms = Vec::new();
    for half_roll in [false, true] {
        let postument = body.cube_from_tool(half_roll, 0.0).rotation;
        let index = crate::cube::rotation_index(&(track.inverse() * postument));
        let Some(meeting) = table.grasps[index] else { continue };
        let room = (meeting.track_roll.0 + ROLL_MARGIN, meeting.track_roll.1 - ROLL_MARGIN);
        let same = (angle.abs() - PI).abs() < 1e-9;
        // Half a turn has the same result in both senses.
        for asked in [angle, if same { -angle } else { angle }] {
            if (room.0..=room.1).contains(&asked) {
                return Ok((FaceTurnStart { body, half_roll, meeting }, asked));
            }
        }
        rooms.push(format!("{:.0}..{:.0} deg", room.0.to_degrees(), room.1.to_degrees()));
    }
    if rooms.is_empty() {
        return Err("the cell has no place where both hands can hold the cube".to_owned());
    }
    Err(format!(
        "face_turn.angle_deg = {:.0}: where the hands meet, the track's wrist can turn by {}",
        angle.to_degrees(),
        rooms.join(" or ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::Facelets;
    use crate::generators::{Behaviour, Outcome};
    use crate::kernel::sensor::SensorReadings;
    use crate::kernel::{Action, Event, Finish, Forces, Kernel, Readings, Thought as _};
    use crate::motion::ArmState;
    use crate::operator::{Answer, Question, Subject};
    use crate::tasks::read;
    use crate::vision::sensor::FaceReading;

    /// Returns the controller's part of a scenario with these keys.
    fn controller(text: &str) -> ControllerConfig {
        read(std::path::Path::new("t.toml"), text, &[]).unwrap().controller
    }

    #[test]
    fn visual_servo_is_gentle_near_a_person_only() {
        let keys = "[control]\nhand_acceleration_mm_s2 = 200\nlinear_acceleration_mm_s2 = 900\n";
        let person = visual_order(&controller(keys));
        let table = visual_order(&controller(&format!("{keys}[hand]\nkeeper = \"table\"\n")));

        assert_eq!((person.acceleration, table.acceleration), (0.2, 0.9));
    }

    /// Performs a mission without a plant: each motion succeeds, and a look at a face gives what
    /// `look` returns for its `camera_from_face`. Returns the phases, the messages to the operator,
    /// the number of looks, and the end of the mission.
    fn perform(
        look: impl Fn(&Pose) -> Result<FaceReading, String>,
    ) -> (Vec<&'static str>, Vec<String>, usize, Finish) {
        perform_with(look, None, |_| None)
    }

    /// Performs a mission like [`perform`], with an operator who has `patience` (s) for each
    /// question and answers it by `answer`.
    fn perform_with(
        look: impl Fn(&Pose) -> Result<FaceReading, String>,
        patience: Option<f64>,
        mut answer: impl FnMut(Question) -> Option<Answer>,
    ) -> (Vec<&'static str>, Vec<String>, usize, Finish) {
        let text = "[planner]\nnode_budget = 1000\ncandidates = 1\n";
        let scenario = read(std::path::Path::new("t.toml"), text, &[]).unwrap();
        let reach = ReachSettings::default();
        let meetings = MeetingTable::compute(&scenario.controller.cell, &reach);
        let settings = cube_settings(&scenario.controller, meetings, &reach).unwrap();
        let assignment = Assignment { patience, ..Assignment::new(Goal::Solve) };
        let mut mission = Mission::new(settings, assignment);
        let arms = [ArmState { jaw_opening: 0.057, ..ArmState::default() }; 2];
        let readings = Readings {
            arms: &arms,
            forces: &Forces::default(),
            sensors: &SensorReadings::default(),
        };
        let (mut phases, mut notes, mut looks, mut event) = (vec![], vec![], 0, Event::Start);
        for _ in 0..2000 {
            let action = mission.next(event, &readings);
            notes.extend(mission.notes().iter().map(|note| note.text().to_owned()));
            event = match action {
                Action::Finish(finish) => return (phases, notes, looks, finish),
                Action::Phase(name) => {
                    phases.push(name);
                    Event::Done
                }
                Action::Behave { orders, .. } => {
                    let ended = orders.iter().map(|order| order.as_ref().map(ends_well));
                    Event::Behaved(ended.collect())
                }
                Action::Look { view, .. } => {
                    looks += 1;
                    Event::Looked(look(&view.camera_from_face))
                }
                Action::Think(thought) => Event::Thought(thought.think().0),
                Action::Bias(_) | Action::Watch(_) => Event::Done,
                Action::Ask(question) => Event::Answered(answer(question)),
                other => panic!("a mission takes no orders and starts no programmes: {other:?}"),
            };
        }
        panic!("the mission never ends: {phases:?} {notes:?}");
    }

    /// Returns the outcome of a behaviour that succeeds.
    fn ends_well(order: &Behaviour) -> Outcome {
        match order {
            Behaviour::Joints { .. }
            | Behaviour::Legs { .. }
            | Behaviour::Line { .. }
            | Behaviour::Jaw { .. }
            | Behaviour::Own(_) => Outcome::Reached,
            Behaviour::Approach { .. } | Behaviour::VisualServo(_) => Outcome::Touched(0.0),
            Behaviour::Withdraw { .. } => Outcome::NotTouched,
            Behaviour::Grasp { .. } => Outcome::Grasped(0.057),
            Behaviour::Secure { .. } => Outcome::Secured,
            Behaviour::Turn { angle, .. } => Outcome::Turned(*angle),
            Behaviour::Comply { .. } => Outcome::Ended,
            Behaviour::Present { .. } => Outcome::Pulled,
        }
    }

    #[test]
    fn unreadable_face_returns_cube_with_reason() {
        let (phases, _, looks, finish) = perform(|_| Err("glare".to_owned()));

        assert_eq!(
            looks,
            3 * 6,
            "six looks (`LOOK_TRIES`) in each of three grasps (`MOST_HIDDEN`)"
        );
        assert!(!finish.achieved);
        assert!(finish.reason.contains("cannot be read: glare"), "{}", finish.reason);
        assert!(finish.reason.ends_with("handed back as it is"), "{}", finish.reason);
        assert_eq!(phases.last(), Some(&"hand back"));
    }

    /// The operator fills in the stickers that no camera reads. An answer that is not a possible
    /// cube is followed by a second question.
    #[test]
    fn operator_is_asked_again_after_impossible_answer() {
        let mut asked = Vec::new();
        let glare = |_: &Pose| Err("glare".to_owned());
        let mut twisted = *Facelets::solved().colours();
        // The colours of U9 and F3, two stickers of one corner, are exchanged.
        twisted[8] = 2;
        twisted[20] = 0;
        let answers = |question: Question| {
            // The inspection after the turns cannot see the cube either; its question gets no
            // answer.
            let Subject::Stickers { read, doubtful } = &question.subject else { return None };
            asked.push((question.number, read.clone(), doubtful.len(), question.text.clone()));
            let colours = if asked.len() == 1 { twisted } else { *Facelets::solved().colours() };
            Some(Answer::Stickers { stickers: Facelets::try_from(colours).unwrap() })
        };
        let (phases, _, _, finish) = perform_with(glare, Some(60.0), answers);

        assert_eq!(asked.len(), 2, "{asked:?}");
        assert_eq!((asked[0].0, asked[0].2), (1, 54));
        assert_eq!(asked[0].1, "-".repeat(54));
        assert!(asked[1].3.contains("cannot exist"), "{asked:?}");
        assert!(phases.contains(&"solve"), "{phases:?}");
        assert!(
            !finish.achieved && finish.reason.contains("inspected: glare"),
            "{}",
            finish.reason
        );
    }

    #[test]
    fn cube_is_returned_if_operator_does_not_answer() {
        let (phases, notes, _, finish) =
            perform_with(|_| Err("glare".to_owned()), Some(60.0), |_| None);

        assert!(!finish.achieved);
        assert!(finish.reason.contains("cannot be read"), "{}", finish.reason);
        assert!(finish.reason.ends_with("handed back as it is"), "{}", finish.reason);
        assert_eq!(phases.last(), Some(&"hand back"));
        assert!(!phases.contains(&"solve"), "{phases:?}");
        assert!(notes.iter().any(|n| n.contains("the operator is asked")), "{notes:?}");
    }

    #[test]
    fn impossible_cube_is_read_twice_then_returned() {
        let grey = |camera_from_face: &Pose| {
            Ok(FaceReading {
                camera_from_face: *camera_from_face,
                rgb: [[90.0, 90.0, 90.0]; 9],
                occluded: [false; 9],
                colours: [0; 9],
                confidences: [1.0; 9],
                residual_px: 0.1,
                confidence: 1.0,
            })
        };
        let (phases, notes, looks, finish) = perform(grey);

        assert_eq!(looks, 12, "two rounds of six faces");
        assert!(notes.iter().any(|n| n.contains("looked at again")), "{notes:?}");
        assert!(!finish.achieved && finish.reason.contains("handed back"), "{}", finish.reason);
        assert_eq!(phases.iter().filter(|p| **p == "identify again").count(), 1);
    }

    /// Another process may truncate a mapped file, which would end this one while arms move.
    #[test]
    fn tables_of_a_run_are_copied_into_memory() {
        assert_eq!(store().residence(), Residence::Copied);
    }
}
