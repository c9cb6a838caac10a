//! State of the mission: its knowledge about cube and arms, and its requests to the shell.
//!
//! - in: the states of both arms and the event that ends an action, by the port
//! - out: actions; a [`Failure`] if the shell does not answer an action as expected
//!
//! Before each action the jaws are compared with the cube that they hold ([`Robot::check_hold`]).
//! So a lost cube interrupts every procedure at its next action.
//!
//! | limit | value | reason |
//! |---|---|---|
//! | [`LEAST_WIDTH`] | 0.948 edge | a clenched cube reads 56.5 mm, closed jaws 53 mm (0.3 mm rms) |
//! | [`MOST_WIDER`] | 6 mm | a layer that is misaligned by 7 deg makes the cube wider by this |
//! | [`MOST_CLOSER`] | 1.2 mm | the rubber of the pads gives by a fifth of it |
//!
//! A wrong zero of the jaws makes a clenched cube read 1 mm less.

use super::assignment::{Assignment, Goal};
use super::entry::Entry;
use super::failure::{Failure, Orders, Outcomes, alone};
use super::shared::{Doing, MissionLog, Shared, Shown};
use super::sight::{Palette, Sight};
use super::turn_in_progress::TurnInProgress;
use crate::cube::{Face, Facelets, Keeper, Turn};
use crate::generators::Behaviour;
use crate::kernel::procedure::Port;
use crate::kernel::{Action, Event, Finish, Picture, Turning, Until, View};
use crate::motion::{ArmState, Depth, JointPositions};
use crate::operator::{Answer, Net, Question};
use crate::reach::Meeting;
use crate::tasks::cube::belief::Belief;
use crate::tasks::cube::hold::{Grip, Hand};
use crate::tasks::cube::settings::CubeSettings;
use crate::tasks::cube::think::{Conclusion, Thought};
use crate::vision::sensor::FaceReading;
use nalgebra::UnitQuaternion;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The port of the mission's procedure.
pub(super) type MissionPort = Port<Thought, Conclusion, Shared>;

/// Number of times that the cube is read again before the mission gives up.
pub(super) const MOST_RECOVERIES: u32 = 3;
/// Largest number of letters of a reason in the journal.
const MOST_LETTERS: usize = 500;
/// Greatest error of the position of a cube that no grasp has measured yet (m).
pub(super) const UNSURE: f64 = 0.012;
/// Least width of a cube between the jaws, as a share of its edge.
pub(super) const LEAST_WIDTH: f64 = 0.948;
/// Greatest width of a given cube beyond its edge (m).
pub(super) const MOST_WIDER: f64 = 0.006;
/// Decrease of the jaw distance since the grasp from which on the cube counts as lost (m).
pub(super) const MOST_CLOSER: f64 = 0.0012;

/// Whether the force sensors are believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trust {
    Believed,
    /// The sensors contradict each other, and must be zeroed first.
    Doubted,
}

/// A cube that an earlier run may have held out to a person.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct MaybeOffered {
    /// Whether the jaws may have begun to open, judged by their distance.
    pub(super) opening: bool,
}

/// Knowledge of the mission, and its methods to act.
#[derive(Debug)]
pub(super) struct Robot {
    port: MissionPort,
    pub(super) settings: CubeSettings,
    pub(super) goal: Goal,
    /// States of both arms at the last event.
    pub(super) arms: [ArmState; 2],
    pub(super) belief: Belief,
    /// Present or last meeting of the hands.
    pub(super) meeting: Option<Meeting>,
    /// Whether the track is retracted from the meeting by as much as the next path needs, or is on
    /// its way there.
    pub(super) apart: bool,
    /// Stickers as the cameras saw them.
    pub(super) sight: Sight,
    /// Number of the present round of looks at the faces, from 1.
    pub(super) rounds: u32,
    /// Colours that the operator gave.
    pub(super) given: Option<Facelets>,
    /// Appearance of the cube's colours, once they were decided.
    pub(super) palette: Option<Palette>,
    /// Joint positions of the track after it had taken the cube and retracted.
    pub(super) hand_over: Option<JointPositions>,
    /// Position of the track's tool when it closed on the cube, in the track's base (m).
    pub(super) taken_at: Option<[f64; 3]>,
    /// Part of the usual retraction from `taken_at` that the track's joints did not allow (m).
    pub(super) retract_shortfall: f64,
    /// Distance between the pads of each hand when they had closed on the cube (m).
    pub(super) widths: [Option<f64>; 2],
    /// Last position of the stops of each palm.
    pub(super) stops: [Depth; 2],
    /// Place where the cube fell, in words.
    pub(super) drop_site: Option<String>,
    /// Whether the cube is still in the place where it was given.
    pub(super) untouched: bool,
    /// Whether the cube was offered to the operator, or is on the table.
    pub(super) given_back: bool,
    /// Reason for which the cube goes back unsolved.
    pub(super) failure: Option<String>,
    /// Turn of the plan that is in progress.
    pub(super) turning: Option<Turn>,
    /// Turning hand, its layer's face, and the rotation of `cube_from_tool` with the layer in line.
    pub(super) straight: Option<(Hand, Face, UnitQuaternion<f64>)>,
    /// Record of the turn that is in progress, or whose layer is realigned.
    pub(super) turn_in_progress: Option<TurnInProgress>,
    /// Turn that stalled on its way. The cube is inspected as soon as one hand holds it alone.
    pub(super) stalled: Option<Turn>,
    /// Number of times that the cube was read and planned again.
    pub(super) recoveries: u32,
    /// Contacts on the present path.
    pub(super) contacts: u32,
    /// Error of the cube's position in the last grasps, along the hand's z (m).
    pub(super) miss: f64,
    pub(super) trust: Trust,
    /// Time that the operator has for an answer (s); `None` without an operator.
    pub(super) patience: Option<f64>,
    /// Number of questions to the operator.
    pub(super) questions: u64,
    /// Cube that an earlier run may have held out, until pulls show whether a person holds it.
    pub(super) maybe_offered: Option<MaybeOffered>,
    /// Time of the search for a cube that an earlier run was handing back (s); `None` without such
    /// a search.
    pub(super) seek_time: Option<f64>,
    /// Last journal entry of an earlier run that this one resumes.
    pub(super) earlier: Option<Entry>,
    /// Least coordinate of the track in a retraction (m), for a resumed mission.
    pub(super) least_track: Option<f64>,
    /// Cube and plan as the operator sees them.
    pub(super) shown: Shown,
    pub(super) log: MissionLog,
    /// Notes for the operator that are not published yet.
    notes: Vec<String>,
}

impl Robot {
    /// Makes the robot of a mission that begins with this assignment.
    pub(super) fn new(port: MissionPort, settings: CubeSettings, assignment: Assignment) -> Self {
        let Assignment { goal, held, patience, earlier } = assignment;
        let mut belief = Belief::new(settings.arms, settings.edge, settings.calibrated_at);
        if let Some((hand, hold, half_roll)) = held {
            belief.taken(hand, hold, half_roll);
        }
        // The cube of a resumed mission, or of a single turn, may have been moved before.
        let drops = earlier.as_ref().map_or(0, |last| last.drops);
        let fresh = earlier.is_none() && (goal == Goal::Solve || goal == Goal::Acquire);
        Self {
            port,
            settings,
            goal,
            arms: [ArmState::default(); 2],
            belief,
            meeting: None,
            apart: true,
            sight: Sight::default(),
            rounds: 1,
            given: None,
            palette: None,
            hand_over: None,
            taken_at: None,
            retract_shortfall: 0.0,
            widths: [None; 2],
            stops: [Depth::One; 2],
            drop_site: None,
            untouched: fresh,
            given_back: false,
            failure: None,
            turning: None,
            straight: None,
            turn_in_progress: None,
            stalled: None,
            recoveries: 0,
            contacts: 0,
            miss: if fresh { 0.0 } else { UNSURE },
            trust: Trust::Believed,
            patience,
            questions: 0,
            maybe_offered: None,
            seek_time: None,
            earlier,
            least_track: None,
            shown: Shown::default(),
            log: MissionLog { drops, ..MissionLog::default() },
            notes: Vec::new(),
        }
    }

    /// Takes over the states that the shell delivered with the last event.
    pub(super) fn read_arms(&mut self) {
        self.arms = self.port.state(|shared| shared.arms);
    }

    /// Stores a note for the operator, which is published with the next action.
    pub(super) fn note(&mut self, text: impl Into<String>) {
        self.notes.push(text.into());
    }

    /// Publishes the state that page, journal and summary show at the beginning of the action
    /// `doing`.
    pub(super) fn publish(&mut self, doing: Doing) {
        let (entry, picture) = (self.entry(doing), self.picture(doing));
        let (whereabouts, log) = (self.whereabouts(), self.log.clone());
        let least_openings = Hand::BOTH.map(|hand| self.least_opening(hand));
        let notes = std::mem::take(&mut self.notes);
        self.port.state(|shared| {
            (shared.entry, shared.picture) = (entry, Some(picture));
            (shared.whereabouts, shared.log) = (whereabouts, log);
            shared.least_openings = least_openings;
            shared.notes.extend(notes);
        });
    }

    /// Returns the journal entry that must be on disk before an action, if it needs one. Only a
    /// mission that solves can be resumed.
    pub(super) fn entry(&self, doing: Doing) -> Option<Entry> {
        let noted = self.goal == Goal::Solve && doing.needs_entry();
        noted.then(|| Entry {
            doing: doing.word().to_owned(),
            held: self.belief.held.map(|held| held.map(|held| held.hold.depth)),
            hand_over: self.hand_over,
            taken_at: self.taken_at,
            short: self.retract_shortfall,
            stops: self.stops.map(Some),
            handing_back: self.given_back,
            undone: self.failure.as_ref().map(|why| why.chars().take(MOST_LETTERS).collect()),
            drops: self.log.drops,
            over: doing == Doing::Over,
        })
    }

    /// Returns the belief about cube and arms during an action.
    pub(super) fn picture(&self, doing: Doing) -> Picture {
        // `straight` stays set between the motions of a turn, but the page shows only a moving
        // layer.
        let turning = self.straight.filter(|_| doing == Doing::Turning);
        Picture {
            world_from_base: Hand::BOTH.map(|hand| Some(self.belief.world_from_base(hand))),
            tool_from_cube: Hand::BOTH.map(|hand| self.belief.tool_from_cube(hand)),
            handed_back: self.given_back,
            facelets: self.shown.facelets,
            turning: turning.map(|(hand, face, cube_from_tool)| Turning {
                effector: hand.index(),
                face,
                cube_from_tool,
            }),
            net: self.shown.net_in_place(),
            plan: Arc::clone(&self.shown.plan),
            step: self.shown.step.and_then(|step| step.checked_sub(1)),
            facts: BTreeMap::new(),
        }
    }

    /// Checks that no hand has lost the cube, publishes the state, has the shell carry out an
    /// action, and returns the event that answers it.
    ///
    /// # Errors
    ///
    /// [`Failure::Lost`] before the action; [`Failure::Final`] if the shell reports trouble.
    async fn act(
        &mut self,
        action: Action<Thought>,
        doing: Doing,
    ) -> Result<Event<Conclusion>, Failure> {
        self.check_hold()?;
        self.publish(doing);
        let event = self.port.request(action).await;
        self.read_arms();
        match event {
            Event::Trouble(reason) => Err(Failure::Final(reason)),
            event => Ok(event),
        }
    }

    /// Begins a phase of the mission.
    pub(super) async fn phase(&mut self, name: &'static str) -> Result<(), Failure> {
        self.act(Action::Phase(name), Doing::Nothing).await.map(drop)
    }

    /// Starts or ends the stand-alone camera's watch for the cube.
    pub(super) async fn watch(&mut self, on: bool) -> Result<(), Failure> {
        self.act(Action::Watch(on), Doing::Nothing).await.map(drop)
    }

    /// Zeroes the force sensors of the marked hands. Zeroing both at once ends a doubt about their
    /// readings.
    pub(super) async fn zero_forces(&mut self, which: [bool; 2]) -> Result<(), Failure> {
        // A lost cube prevents the zeroing, so the doubt must last: the hold is checked before the
        // doubt ends.
        self.check_hold()?;
        if which == [true; 2] {
            self.trust = Trust::Believed;
        }
        self.act(Action::Bias(which.into()), Doing::Nothing).await.map(drop)
    }

    /// Requests the long computation that decides the colours, solves the cube and plans the steps,
    /// and returns its conclusion.
    pub(super) async fn think(&mut self, thought: Thought) -> Result<Conclusion, Failure> {
        match self.act(Action::Think(thought), Doing::Nothing).await? {
            Event::Thought(conclusion) => Ok(conclusion),
            other => Err(Failure::unexpected(&other)),
        }
    }

    /// Asks the operator, and returns the answer, or `None` if none came in time.
    pub(super) async fn ask(&mut self, question: Question) -> Result<Option<Answer>, Failure> {
        match self.act(Action::Ask(question), Doing::Nothing).await? {
            Event::Answered(answer) => Ok(answer),
            other => Err(Failure::unexpected(&other)),
        }
    }

    /// Looks at a face from the present position of the viewer's camera. The inner error is the
    /// reason for which the face was not read.
    pub(super) async fn look(
        &mut self,
        viewer: Hand,
        face: Face,
        exposure: f64,
    ) -> Result<Result<FaceReading, String>, Failure> {
        let camera_from_face =
            self.belief.face_in_camera(viewer, face, &self.arms).ok_or_else(|| {
                format!("the {} hand has no camera, or the other one no cube", viewer.name())
            })?;
        #[cfg(test)]
        self.port.state(|shared| shared.looking = Some((face, self.belief.held)));
        let view = View { camera_from_face, exposure };
        let look = Action::Look { effector: viewer.index(), view };
        match self.act(look, Doing::Nothing).await? {
            Event::Looked(reading) => Ok(reading),
            other => Err(Failure::unexpected(&other)),
        }
    }

    /// Requests behaviours, and returns their outcomes, alarms included. `until` names the
    /// behaviours that must end before the shell ends the others.
    pub(super) async fn behave(
        &mut self,
        orders: Orders,
        until: Until,
        doing: Doing,
    ) -> Result<Outcomes, Failure> {
        match self.act(Action::Behave { orders: orders.into(), until }, doing).await? {
            // The shell answers each order, and there are two.
            Event::Behaved(outcomes) => outcomes
                .try_into()
                .map_err(|other| Failure::unexpected(&Event::<()>::Behaved(other))),
            other => Err(Failure::unexpected(&other)),
        }
    }

    /// Requests a behaviour of one hand, while the other one stays as it is.
    pub(super) async fn behave_alone(
        &mut self,
        hand: Hand,
        behaviour: Behaviour,
        doing: Doing,
    ) -> Result<Outcomes, Failure> {
        self.behave(alone(hand, behaviour), Until::Effector(hand.index()), doing).await
    }

    /// Returns whether the cube may be read and planned once more.
    pub(super) fn may_recover(&self) -> bool {
        self.goal == Goal::Solve && self.recoveries < MOST_RECOVERIES
    }

    /// Forgets the colours and the plan, and counts a recovery.
    pub(super) fn forget_cube(&mut self) {
        self.recoveries += 1;
        self.log.recoveries += 1;
        // The failure may have moved the cube in the hand.
        self.miss = UNSURE;
        self.sight = Sight::default();
        (self.given, self.given_back) = (None, false);
        self.maybe_offered = None;
        self.rounds = 1;
        // A cube on its way back unsolved may still be solved.
        self.failure = None;
        self.stalled = None;
        (self.turning, self.straight, self.turn_in_progress) = (None, None, None);
        self.shown.net = Net::default();
    }

    /// Forgets the place of hand-over, and the place where the cube was grasped.
    pub(super) fn forget_hand_over(&mut self) {
        self.hand_over = None;
        self.forget_grasp();
    }

    /// Forgets the place where the cube was grasped.
    pub(super) fn forget_grasp(&mut self) {
        (self.taken_at, self.retract_shortfall) = (None, 0.0);
    }

    /// Ends the mission without a further motion, and returns its end with the reason. The reason
    /// includes the place of the cube, for the person who comes to help.
    pub(super) fn failed(&mut self, why: String) -> Finish {
        self.publish(Doing::Nothing);
        // The first failure names the cause, and `why` a consequence.
        let mut reason = match &self.failure {
            Some(failure) => format!("{failure}; {why}"),
            None => why,
        };
        if self.drop_site.is_some() || self.belief.held.iter().any(Option::is_some) {
            reason = format!("{reason}; {}", self.whereabouts());
        }
        Finish { achieved: false, reason }
    }

    /// Returns the turner, the face of its layer, and the rotation `cube_from_tool` of its present
    /// hold, in which the layer is in line.
    pub(super) fn straight_now(&self, turner: Hand) -> Option<(Hand, Face, UnitQuaternion<f64>)> {
        let held = self.belief.held[turner.index()]?;
        let cube_from_tool = held.hold.cube_from_tool(held.half_roll, self.settings.edge);
        Some((turner, held.hold.palm, cube_from_tool.rotation))
    }

    /// Checks that no hand has lost the cube: its jaws would have closed farther than on the cube.
    ///
    /// # Errors
    ///
    /// [`Failure::Lost`] with the hand.
    pub(super) fn check_hold(&self) -> Result<(), Failure> {
        let lost = |hand: &Hand| {
            let opening = self.arms[hand.index()].jaw_opening;
            self.least_opening(*hand).is_some_and(|least| opening < least)
        };
        Hand::BOTH.into_iter().find(lost).map_or(Ok(()), |hand| Err(Failure::Lost(hand)))
    }

    /// Returns the opening below which the jaws of a hand have lost the cube (m), since their grip
    /// closes them as soon as it is gone. Returns `None` for a hand that does not hold the cube, or
    /// whose opening at its grasp is unknown.
    fn least_opening(&self, hand: Hand) -> Option<f64> {
        self.belief.held[hand.index()].as_ref()?;
        self.widths[hand.index()].map(|width| width - MOST_CLOSER)
    }

    /// Returns the hand that holds the cube, the track if both do.
    pub(super) fn holder(&self) -> Result<Hand, String> {
        let holds = |hand: &Hand| self.belief.held[hand.index()].is_some();
        Hand::BOTH.into_iter().find(holds).ok_or_else(|| "no hand holds the cube".to_owned())
    }

    /// Returns the hand that holds the cube, with its grip.
    pub(super) fn held_alone(&self) -> Result<(Hand, Grip), String> {
        let holder = self.holder()?;
        let held = self.belief.held[holder.index()].ok_or("no hand holds the cube")?;
        Ok((holder, Grip { hold: held.hold, half_roll: held.half_roll }))
    }

    /// Counts a fall from a hand, and keeps the place where the cube lies.
    pub(super) fn note_fall(&mut self, hand: Hand) {
        self.log.drops += 1;
        let tool = self.belief.world_from_base(hand) * self.arms[hand.index()].base_from_tool;
        let [x, y, _] = tool.translation.vector.map(|place| place * 1e3).into();
        self.drop_site = Some(format!(
            "it fell from the {} hand and lies below the last position of that hand, x {x:.0} mm, \
             y {y:.0} mm in the world frame",
            hand.name()
        ));
    }

    /// Returns how the robot gets a cube that has fallen, for messages.
    pub(super) fn after_fall(&self) -> &'static str {
        match self.settings.keeper {
            Keeper::Person => "pick it up and hold it out again, please",
            Keeper::Table => "the camera looks for it on the table",
        }
    }

    /// Returns the verb phrase for the return of the cube, for messages.
    pub(super) fn goes_back(&self) -> &'static str {
        match self.settings.keeper {
            Keeper::Person => "is handed back",
            Keeper::Table => "is laid on the table again",
        }
    }

    /// Returns the place of the cube, as the mission believes, in words.
    pub(super) fn whereabouts(&self) -> String {
        match self.belief.held.map(|held| held.is_some()) {
            [true, true] => "both hands hold the cube".to_owned(),
            [true, false] => "the track hand holds the cube".to_owned(),
            [false, true] => "the postument hand holds the cube".to_owned(),
            [false, false] => match (&self.drop_site, self.settings.keeper) {
                (Some(site), _) => site.clone(),
                (None, _) if !self.given_back && !self.untouched => {
                    "no hand of the robot holds the cube, and its place is unknown".to_owned()
                }
                (None, Keeper::Person) => "the operator has the cube".to_owned(),
                (None, Keeper::Table) => "the cube lies on the table".to_owned(),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Stage, settings};
    use super::*;

    #[test]
    fn journal_entry_holds_state_needed_to_resume() {
        let mut stage = Stage::holding(settings());
        let robot = &mut stage.robot;
        (robot.given_back, robot.retract_shortfall, robot.log.drops) = (true, 0.02, 3);
        (robot.taken_at, robot.stops) = (Some([0.5, 0.1, 0.7]), [Depth::Two, Depth::One]);
        robot.hand_over = Some(JointPositions([0.3; 7]));
        robot.failure = Some("a layer is misaligned".to_owned());

        let entry = robot.entry(Doing::Turning).unwrap();
        assert!(!entry.over && entry.handing_back && entry.doing == "turning", "{entry:?}");
        assert_eq!(entry.held, [Some(Depth::One), None]);
        assert_eq!(entry.hand_over, Some(JointPositions([0.3; 7])));
        assert_eq!((entry.taken_at, entry.short), (Some([0.5, 0.1, 0.7]), 0.02));
        assert_eq!(entry.drops, 3);
        assert_eq!(entry.stops, [Some(Depth::Two), Some(Depth::One)]);
        assert_eq!(entry.undone.as_deref(), Some("a layer is misaligned"));
        assert!(robot.entry(Doing::Over).is_some_and(|entry| entry.over));
    }

    #[test]
    fn only_solving_mission_has_journal_entries() {
        let mut stage = Stage::holding(settings());
        for goal in [Goal::Acquire, Goal::FaceTurn(1.0)] {
            stage.robot.goal = goal;
            assert_eq!(stage.robot.entry(Doing::Turning), None);
        }
    }
}
