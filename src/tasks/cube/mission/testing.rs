//! Stage for the mission's own tests: settings, a robot, and a shell that answers its actions.

use super::Mission;
use super::assignment::{Assignment, Goal};
use super::robot::{MissionPort, Robot};
use super::shared::{Doing, Shared};
use super::sight::Palette;
use crate::cube::{Axis, Face, Keeper};
use crate::generators::{Behaviour, Outcome, position::Speeds, profile::Profile, visual_servo};
use crate::kernel::procedure::Port;
use crate::kernel::sensor::SensorReadings;
use crate::kernel::{Action, Event, Finish, Forces, Kernel as _, Readings};
use crate::motion::{ArmState, Depth, JointPositions};
use crate::reach::{Fold, Meeting, MeetingTable};
use crate::solver::Tables;
use crate::spatial::Pose;
use crate::tasks::cube::hold::{Hand, Hold};
use crate::tasks::cube::plan::Rule;
use crate::tasks::cube::settings::{ArmBelief, ComplianceChoice, CompliantArm, CubeSettings};
use crate::tasks::cube::strategy::Strategy;
use crate::tasks::cube::think::{Conclusion, Thought};
use crate::vision::sensor::FaceReading;
use nalgebra::{Point3, Vector3};
use std::pin::pin;
use std::sync::LazyLock;
use std::task::{Context, Poll, Waker};

static TABLES: LazyLock<Tables> = LazyLock::new(Tables::build);

/// Returns the settings of a cell whose hands can meet everywhere.
pub(super) fn settings() -> CubeSettings {
    let arm = ArmBelief {
        world_from_base: Pose::identity(),
        flange_from_tool: Pose::identity(),
        flange_from_camera: Some(Pose::identity()),
    };
    let still = JointPositions::default();
    let meeting = Some(Meeting {
        track_from_postument: Pose::identity(),
        track: still,
        postument: still,
        track_back: still,
        postument_back: still,
        track_roll: (-3.2, 3.2),
        postument_roll: (-3.2, 3.2),
        clearance: 0.1,
    });
    CubeSettings {
        arms: [arm; 2],
        folds: [Fold::of_example(), Fold::of_example()],
        meetings: MeetingTable {
            grasps: [meeting; 24],
            views: [[meeting; 3]; 2],
            separation: 0.35,
            ways: Vec::new(),
        },
        ways: None,
        edge: 0.057,
        grip: 60.0,
        opening: 0.09,
        regrasp_opening: 0.09,
        gentle: 0.25,
        jaw_leave: 1.2,
        back: 0.1,
        pre_grasp: 0.03,
        approach_speed: 0.02,
        touch: 3.0,
        press: 10.0,
        turn_speed: 1.0,
        turn_acceleration: 1.0,
        turn_torque: 2.0,
        turn_least_torque: 0.0,
        pull: 10.0,
        speed: 0.5,
        speeds: Speeds {
            joint: [1.0; 7],
            joint_acceleration: [2.0; 7],
            linear: 0.3,
            linear_acceleration: 1.0,
            angular: 1.0,
            angular_acceleration: 2.0,
            profile: Profile { ramp: 5.0 },
        },
        jaw_speeds: (0.05, 0.05),
        jaw_reach: 0.05,
        compliant_arm: CompliantArm::Body,
        compliance: ComplianceChoice::Tff,
        visual: take_order(),
        rule: Rule::Clearance,
        strategy: Strategy::Robot { tables: &TABLES },
        nodes: 1000,
        candidates: 1,
        seconds_per_node: 0.0,
        calibrated_at: Point3::origin(),
        finger_depth: [0.017, 0.036],
        finger_width: 0.012,
        keeper: Keeper::Person,
    }
}

/// Returns the order of the visual servo for taking the cube.
fn take_order() -> visual_servo::Order {
    visual_servo::Order {
        world_from_base: Pose::identity(),
        approach: Vector3::x(),
        jaws: Vector3::y(),
        seat: 0.019,
        vicinity: 0.1,
        frozen: 0.05,
        still: 0.006,
        still_seconds: 0.3,
        retreat: 0.02,
        speed: (0.2, 1.0),
        acceleration: 1.0,
        approach_speed: 0.02,
        touch: 3.0,
        inertia: 20.0,
        overrun: 0.015,
        stale: 0.2,
        patience: 10.0,
        zone: (Pose::identity(), Vector3::repeat(1.0)),
    }
}

/// Distance between jaws that hold the cube (m).
pub(super) const WIDTH: f64 = 0.057;
/// Distance between jaws that have closed farther than on a cube (m).
pub(super) const EMPTY: f64 = 0.053;
/// Actions before a procedure counts as endless.
const MOST_ACTIONS: usize = 2000;

/// Appearance of the stickers of a cube.
pub(super) const PALETTE: Palette = [
    [220.0, 220.0, 215.0],
    [180.0, 30.0, 35.0],
    [20.0, 150.0, 60.0],
    [220.0, 210.0, 40.0],
    [230.0, 110.0, 30.0],
    [20.0, 60.0, 160.0],
];

/// Makes a reading of a face with these colours, at the brightness `gain`.
pub(super) fn reading(colours: [u8; 9], gain: f64) -> FaceReading {
    FaceReading {
        rgb: colours.map(|c| PALETTE[usize::from(c)].map(|v| gain * v + 3.0)),
        colours,
        confidences: [1.0; 9],
        camera_from_face: Pose::identity(),
        residual_px: 0.1,
        confidence: 1.0,
        occluded: [false; 9],
    }
}

/// Makes a reading of a face of the solved cube.
pub(super) fn one_colour(face: Face) -> FaceReading {
    reading([face as u8; 9], 1.0)
}

/// Returns the hold in which the track takes the cube.
pub(super) fn taken() -> Hold {
    Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One }
}

/// Robot with its port. Its procedures are played without a mission around them.
pub(super) struct Stage {
    pub(super) robot: Robot,
    pub(super) port: MissionPort,
}

/// Shell that answers an action, and may move the arms.
pub(super) type Shell<'a> =
    dyn FnMut(&Action<Thought>, &mut [ArmState; 2]) -> Event<Conclusion> + 'a;

impl Stage {
    /// Makes a stage for a mission that solves, with empty hands and without an operator.
    pub(super) fn new(settings: CubeSettings) -> Self {
        Self::with(settings, Assignment::new(Goal::Solve))
    }

    /// Makes a stage for a mission with this assignment. All jaws are open.
    pub(super) fn with(settings: CubeSettings, assignment: Assignment) -> Self {
        let port = Port::new(Shared::default());
        let mut robot = Robot::new(port.clone(), settings, assignment);
        robot.arms = [ArmState { jaw_opening: 0.09, ..ArmState::default() }; 2];
        Self { robot, port }
    }

    /// Makes a stage for a mission that solves, with the cube in the track hand.
    pub(super) fn holding(settings: CubeSettings) -> Self {
        let mut stage = Self::new(settings);
        stage.robot.hold(Hand::Track);
        stage
    }

    /// Plays a procedure to its end, and returns its result and its actions.
    pub(super) fn play<R>(
        &mut self,
        procedure: impl AsyncFnOnce(&mut Robot) -> R,
        shell: &mut Shell<'_>,
    ) -> (R, Vec<Action<Thought>>) {
        let arms = self.robot.arms;
        self.port.state(|shared| shared.arms = arms);
        let mut procedure = pin!(procedure(&mut self.robot));
        let mut actions = Vec::new();
        for _ in 0..MOST_ACTIONS {
            if let Poll::Ready(end) =
                procedure.as_mut().poll(&mut Context::from_waker(Waker::noop()))
            {
                return (end, actions);
            }
            let (id, action) = self.port.take_posted().expect("no action is requested");
            let mut arms = self.port.state(|shared| shared.arms);
            let event = shell(&action, &mut arms);
            self.port.state(|shared| shared.arms = arms);
            self.port.deliver(id, event);
            actions.push(action);
        }
        panic!("the procedure never ends: {:?}", words(&actions));
    }

    /// Returns the notes that were not read yet.
    pub(super) fn notes(&mut self) -> Vec<String> {
        self.robot.publish(Doing::Nothing);
        self.port.state(|shared| std::mem::take(&mut shared.notes))
    }
}

impl Robot {
    /// Gives a hand the cube, in the hold in which the track takes it.
    pub(super) fn hold(&mut self, hand: Hand) {
        self.belief.taken(hand, taken(), false);
        (self.widths[hand.index()], self.untouched) = (Some(WIDTH), false);
        self.arms[hand.index()].jaw_opening = WIDTH;
    }
}

/// Plays a whole mission that begins with these arm states, and returns its end and its actions.
pub(super) fn play_mission(
    mission: &mut Mission,
    mut arms: [ArmState; 2],
    shell: &mut Shell<'_>,
) -> (Finish, Vec<Action<Thought>>) {
    let (mut event, mut actions) = (Event::Start, Vec::new());
    for _ in 0..MOST_ACTIONS {
        let readings = Readings {
            arms: &arms,
            forces: &Forces::default(),
            sensors: &SensorReadings::default(),
        };
        let action = mission.next(event, &readings);
        if let Action::Finish(finish) = action {
            return (finish, actions);
        }
        event = shell(&action, &mut arms);
        actions.push(action);
    }
    panic!("the mission never ends: {:?}", words(&actions));
}

/// Answers an action with success, and sets the jaws to their set opening or to the cube's width.
/// No face can be read.
pub(super) fn goes_well(action: &Action<Thought>, arms: &mut [ArmState; 2]) -> Event<Conclusion> {
    match action {
        Action::Behave { orders, .. } => {
            for (arm, order) in arms.iter_mut().zip(orders) {
                match order {
                    Some(Behaviour::Jaw { jaw, .. }) => arm.jaw_opening = jaw.opening,
                    Some(Behaviour::Grasp { .. }) => arm.jaw_opening = WIDTH,
                    _ => {}
                }
            }
            let ended = orders.iter().map(|order| order.as_ref().map(ends_well));
            Event::Behaved(ended.collect())
        }
        Action::Look { .. } => Event::Looked(Err("no face is in view".to_owned())),
        Action::Ask(_) => Event::Answered(None),
        _ => Event::Done,
    }
}

/// Returns the outcome with which a behaviour succeeds.
fn ends_well(order: &Behaviour) -> Outcome {
    match order {
        Behaviour::Joints { .. }
        | Behaviour::Legs { .. }
        | Behaviour::Line { .. }
        | Behaviour::Jaw { .. }
        | Behaviour::Own(_) => Outcome::Reached,
        Behaviour::Approach { .. } | Behaviour::VisualServo(_) => Outcome::Touched(0.0),
        Behaviour::Withdraw { .. } => Outcome::NotTouched,
        Behaviour::Grasp { .. } => Outcome::Grasped(WIDTH),
        Behaviour::Secure { .. } => Outcome::Secured,
        Behaviour::Turn { angle, .. } => Outcome::Turned(*angle),
        Behaviour::Comply { .. } => Outcome::Ended,
        Behaviour::Present { .. } => Outcome::Pulled,
    }
}

/// Makes the event that a behaviour of the track has ended with this outcome.
pub(super) fn track(outcome: Outcome) -> Event<Conclusion> {
    Event::Behaved(vec![Some(outcome), None])
}

/// Makes the event that a behaviour of the track has ended at an obstacle.
pub(super) fn met() -> Event<Conclusion> {
    track(Outcome::OverForce(2, 31.0))
}

/// Returns the behaviour that an action orders, of the first hand that has one.
pub(super) fn order(action: &Action<Thought>) -> Option<&Behaviour> {
    let Action::Behave { orders, .. } = action else { return None };
    Hand::BOTH.iter().find_map(|hand| orders[hand.index()].as_ref())
}

/// Returns one word for each action.
pub(super) fn words(actions: &[Action<Thought>]) -> Vec<&'static str> {
    let word = |action: &Action<Thought>| match (action, order(action)) {
        (_, Some(Behaviour::Joints { .. })) => "joints",
        (_, Some(Behaviour::Line { .. })) => "line",
        (_, Some(Behaviour::Jaw { .. })) => "open",
        (_, Some(Behaviour::Grasp { .. })) => "close",
        (_, Some(Behaviour::Secure { .. })) => "secure",
        (_, Some(Behaviour::Approach { .. })) => "approach",
        (_, Some(Behaviour::Withdraw { .. })) => "pull",
        (_, Some(Behaviour::Present { pull, .. })) if pull.is_infinite() => "yield",
        (_, Some(Behaviour::Present { .. })) => "present",
        (_, Some(Behaviour::VisualServo(_))) => "servo",
        (_, Some(Behaviour::Turn { .. } | Behaviour::Comply { .. })) => "turn",
        (Action::Phase(name), _) => name,
        (Action::Bias(_), _) => "zero",
        (Action::Watch(_), _) => "watch",
        (Action::Look { .. }, _) => "look",
        (Action::Think(_), _) => "think",
        (Action::Ask(_), _) => "ask",
        _ => "other",
    };
    actions.iter().map(word).collect()
}

/// Returns the number of actions with this word.
pub(super) fn count(actions: &[Action<Thought>], word: &str) -> usize {
    words(actions).into_iter().filter(|w| *w == word).count()
}
