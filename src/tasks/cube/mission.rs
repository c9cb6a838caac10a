//! The kernel of MP for the cube: acquire, identify, plan, turn, hand back or lay down.
//!
//! - in: what became of the last action, the states of both arms
//! - out: the next action for the shell
//! - source: Zieliński et al. (2007), pp. 371-374
//!
//! A queue of jobs is worked off from the front. A job either becomes an action at once, or unfolds into
//! smaller jobs with what is known by then; what an action brought is digested by the job that asked for it.

mod hand_over;
mod recover;
mod sight;
#[cfg(test)]
mod testing;
mod unwind;

use std::collections::VecDeque;
use std::sync::Arc;

use super::belief::Belief;
use super::hold::{Grip, Hand, Hold, Step};
use super::plan::Planner;
use super::plan::explain::Line;
use super::settings::{ComplianceChoice, CompliantArm, CubeSettings, LEAVE_SECONDS};
use super::think::{Conclusion, Doubt, NoAnswer, Thought};
use crate::cube::{Axis, Face, Facelets, Keeper, facelet_at, facelet_place};
use crate::generators::{Behaviour, Outcome, visual_servo};
use crate::motion::{ArmState, Depth, JawCommand, JointPositions};
use crate::operator::{Answer, Net, PlanLine, Question, Reading, Subject};
use crate::reach::Meeting;
use crate::spatial::Pose;
use crate::tasks::{Action, Entry, Event, Finish, Picture, Readings, Task, Turning, Until, View};
use nalgebra::UnitQuaternion;

/// What the kernel is to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// Everything: from the operator's hand, or the table, and back to it, solved.
    Solve,
    /// Take the cube and give it back.
    Acquire,
    /// Both hands hold the cube; turn the face in the track's palm by this angle about its tool's z [rad].
    FaceTurn(f64),
}

/// A piece of work.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Job {
    Phase(&'static str),
    Watch(bool),
    Bias([bool; 2]),
    /// Joint motion; `None` leaves an arm where it is.
    Joints([Option<JointPositions>; 2], f64),
    /// Along the tool's own z, relative to the set pose [m].
    Along(Hand, f64),
    /// Along the tool's axes, relative to the set pose [m].
    Nudge(Hand, [f64; 3]),
    /// The track draws back from the meeting along -y, so that both arms are free to move.
    Apart,
    /// The track comes up to the meeting.
    Together(JointPositions),
    /// Both arms go to a meeting, drawn apart, and then come together.
    Meet {
        newcomer: Hand,
        meeting: Meeting,
        back: bool,
    },
    Open {
        hand: Hand,
        opening: f64,
        stops: Depth,
    },
    /// Lets go of the cube and forgets it.
    LetGo(Hand),
    PreGrasp {
        hand: Hand,
        hold: Hold,
        half_roll: bool,
    },
    Approach {
        hand: Hand,
        hold: Hold,
        half_roll: bool,
    },
    Close {
        hand: Hand,
        hold: Hold,
    },
    Secure {
        hand: Hand,
        hold: Hold,
        half_roll: bool,
    },
    VisualServo {
        tries: u32,
    },
    /// First closing on the cube in the operator's hand.
    Take {
        tries: u32,
    },
    /// Gives way to whatever pulls, for a while.
    Wait(Hand, f64),
    /// A small pull tells whether the operator has let go.
    Release {
        tries: u32,
    },
    /// The track hand draws back with the cube, as far as the arm folds.
    DrawBack(f64),
    Remember,
    Step(Step),
    Look {
        viewer: Hand,
        face: Face,
        tries: u32,
    },
    /// At what was not seen yet, by whoever does not hold the cube.
    Looks,
    /// The sides that can be seen without a grasp are compared with what the turns should have made of them.
    Inspect,
    Check {
        viewer: Hand,
        face: Face,
        tries: u32,
    },
    Reconcile,
    /// All faces are read and planned anew.
    Anew,
    /// Of a mission that goes on, while both hold: which layer is askew?
    Untwist,
    /// A layer that was left askew is brought back into line.
    Unwind {
        turner: Hand,
        tries: u32,
        eased: bool,
    },
    /// The turner gives way about its own z, too, until no torque is left.
    Ease(Hand),
    /// Both hands stand where they are, for so long [s].
    Stand(f64),
    /// About the tool's own z, relative to the set pose [rad].
    Roll(Hand, f64),
    /// The hand is known to have the layer at whose roll it closed.
    Holds {
        hand: Hand,
        hold: Hold,
        half_roll: bool,
    },
    /// The cube goes back with a layer askew.
    GiveUp,
    Plan,
    /// The operator is asked what the eyes cannot decide.
    Ask,
    Turn {
        turner: Hand,
        angle: f64,
        tries: u32,
    },
    /// After a plain turn by an angle that belongs to no plan.
    Report,
    HandBack,
    Present {
        tries: u32,
    },
    /// A small pull tells whether somebody holds a cube that nobody has pulled at.
    Tug {
        tries: u32,
    },
    /// The cube goes to where it is held out to the operator.
    HoldOut,
    /// The same for one that met something on that way.
    Feel,
    /// It goes back to where that way began.
    DrawIn,
    /// Lowers the cube until it stands on the table.
    LayDown,
    Finish {
        achieved: bool,
    },
    /// The arms go on with the way that something was met on.
    GoOn,
    /// The cube is left to the operator: the task has failed.
    Leave,
}

/// What the operator is asked.
#[derive(Debug)]
enum Asked {
    /// The colours of a cube.
    Colours(Doubt),
    /// To see to it that the cube can be seen or taken, for this reason.
    Sight(String),
    /// To see to it that the cube can be inspected, for this reason.
    Inspection(String),
}

/// Whether sensors are believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Trust {
    Believed,
    /// They contradict each other, and are to be zeroed first.
    Doubted,
}

/// The kernel.
#[derive(Debug)]
pub struct Mission {
    settings: CubeSettings,
    goal: Goal,
    belief: Belief,
    queue: VecDeque<Job>,
    /// The job whose action is being carried out.
    pending: Option<Job>,
    meeting: Option<Meeting>,
    apart: bool,
    /// What was seen of the stickers.
    sight: sight::Sight,
    /// Where the track stood when it had taken the cube.
    hand_over: Option<JointPositions>,
    /// How far apart the jaws were when they had closed on the cube [m].
    widths: [Option<f64>; 2],
    /// Where its tool had closed on it, in its base [m].
    taken_at: Option<[f64; 3]>,
    /// By how much less than usual it drew back from there [m].
    short: f64,
    /// Where the palms' stops were put last.
    stops: [Depth; 2],
    /// Where the cube fell, in words.
    fell: Option<String>,
    /// The cube is still where it was given.
    untouched: bool,
    turned: f64,
    /// The cube has been offered to the operator, or stands on the table.
    given_back: bool,
    /// How often all faces were looked at.
    rounds: u32,
    /// Why the cube goes back unsolved.
    failure: Option<String>,
    /// The turn of the plan that is being made.
    turning: Option<crate::cube::Turn>,
    /// Who turns a layer, and how the tool stood to the cube when it was straight.
    straight: Option<(Hand, Face, UnitQuaternion<f64>)>,
    /// Time that the operator has for an answer [s]; `None` when nobody is there to be asked.
    pub patience: Option<f64>,
    /// What is not certain, and the question about it.
    asked: Option<(Asked, Question)>,
    /// The way that the arms were sent last, and how often something was met on it.
    going: ([Option<Behaviour>; 2], u32),
    /// Questions asked so far.
    questions: u64,
    /// The cube as the operator gave it.
    given: Option<Facelets>,
    /// How the cube's colours look, once they were decided.
    palette: Option<recover::Palette>,
    /// Stickers that do not look as they should.
    odd: Vec<(Face, usize)>,
    /// A turn that went as it should in the end, but not at once: the cube is inspected as soon as one hand holds it alone.
    stood_still: Option<crate::cube::Turn>,
    /// Why a side could not be inspected.
    uninspected: Option<String>,
    /// How often the cube was inspected in vain.
    inspections: u32,
    /// How often the cube was read and planned anew.
    recoveries: u32,
    /// How often the jaws that are to open now were strained.
    strained: u32,
    /// The turn that is being made, or being undone.
    begun: Option<unwind::Begun>,
    /// Whether what the force sensors tell is to be followed.
    forces: Trust,
    /// What an earlier run may have held out, until it is known whether somebody has hold of it.
    offered: Option<recover::Offered>,
    /// Where the way to where a cube is held out begins, and ends: `base_from_tool` of the track.
    way_out: Option<(Pose, Pose)>,
    /// For so long a cube is looked for that an earlier run was handing back: nobody knows whether the operator has it [s].
    seeks: Option<f64>,
    /// What an earlier run left, if this one goes on from there.
    resume: Option<Entry>,
    /// The track is not drawn back beyond this [m]; known to a mission that goes on from anywhere.
    least_track: Option<f64>,
    /// What is shown of all this.
    shown: Shown,
    /// Facts for the summary.
    pub log: MissionLog,
}

/// The cube as read, and the plan.
#[derive(Debug, Default)]
struct Shown {
    net: Net,
    plan: Arc<Vec<PlanLine>>,
    step: Option<usize>,
    /// Named by the centres' colours, after what was turned.
    facelets: Option<Facelets>,
}

/// What the controller did, as it believes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MissionLog {
    /// Colours read, letters URFDLB by the centres' colours.
    pub identified: Option<String>,
    /// First plan's face turns.
    pub solution: Vec<crate::cube::Turn>,
    /// Turns that were carried out.
    pub executed: Vec<crate::cube::Turn>,
    /// Jaw closings on the cube between identification and hand-back.
    pub grasps: u32,
    /// How often the cube was read and planned anew after something had gone wrong.
    pub recoveries: u32,
    /// How often the jaws felt that the cube had fallen.
    pub drops: u32,
    /// The plan's steps in words.
    pub plan: Vec<Line>,
    /// Notes for the operator that were not told yet.
    pub notes: Vec<String>,
}

const ARMS_APART: [Option<JointPositions>; 2] = [None, None];
/// Time in which a hand that gives way about its own z is rid of a torque [s].
const EASE: f64 = 0.6;
/// Share of the way that a hand draws back after which nobody else's fingers are where it was.
const CLEAR: f64 = 2.0 / 3.0;
/// How often jaws that are strained try to open.
const MOST_STRAINED: u32 = 6;
/// Retries of a stalled turn.
const TURN_TRIES: u32 = 2;
/// Steps between looks at one face, in the viewer's tool axes [m].
const NUDGES: [[f64; 3]; 5] = [
    [0.0, 0.0, 0.012],
    [0.0, 0.014, -0.024],
    [0.0, -0.028, 0.0],
    [0.014, 0.014, 0.0],
    [-0.028, 0.0, 0.0],
];
const TAKE_TRIES: u32 = 3;
/// Letters of a reason that the journal keeps.
const MOST_NOTED: usize = 500;
/// Between two small pulls that ask whether the operator has let go [s], how far they go [m], and how many there are.
const RELEASE_WAIT: f64 = 1.2;
const RELEASE_WAY: f64 = 0.02;
const RELEASE_TRIES: u32 = 20;
/// How often the cube is held out.
const PRESENTED: u32 = 2;
/// Least width of a cube between the jaws, as a share of its edge. A cube of 57 mm under the grip reads 56.5 mm, a millimetre
/// less where the jaws' zero is wrong by one, and jaws of the IRp-6 that met nothing are told to close to 53 mm: each by
/// 0.3 mm rms.
const LEAST_WIDTH: f64 = 0.948;
/// By so much a cube that is given may be wider than its edge [m]: with a layer that stands askew by 7 deg.
const MORE: f64 = 0.006;

impl Mission {
    /// A kernel that begins with nothing held (`Solve`, `Acquire`), or with the cube in the postument's hand
    /// as `start` says (`FaceTurn`).
    #[must_use]
    pub fn new(settings: CubeSettings, goal: Goal, start: Option<(Hand, Hold, bool)>) -> Self {
        let mut belief = Belief::new(settings.arms, settings.edge, settings.calibrated_at);
        if let Some((hand, hold, half_roll)) = start {
            belief.taken(hand, hold, half_roll);
        }
        Self {
            settings,
            goal,
            belief,
            fell: None,
            untouched: goal == Goal::Solve || goal == Goal::Acquire,
            queue: VecDeque::new(),
            pending: None,
            meeting: None,
            apart: true,
            sight: sight::Sight::default(),
            hand_over: None,
            widths: [None; 2],
            taken_at: None,
            short: 0.0,
            stops: [Depth::One; 2],
            turned: 0.0,
            given_back: false,
            rounds: 1,
            failure: None,
            turning: None,
            straight: None,
            patience: None,
            asked: None,
            going: ([None; 2], 0),
            questions: 0,
            given: None,
            palette: None,
            odd: Vec::new(),
            stood_still: None,
            uninspected: None,
            inspections: 0,
            recoveries: 0,
            strained: 0,
            begun: None,
            forces: Trust::Believed,
            offered: None,
            way_out: None,
            seeks: None,
            resume: None,
            least_track: None,
            shown: Shown::default(),
            log: MissionLog::default(),
        }
    }

    fn push_front(&mut self, jobs: &[Job]) {
        for job in jobs.iter().rev() {
            self.queue.push_front(*job);
        }
    }

    /// The cube is taken from the operator's hand, or from the table.
    fn take(&mut self) {
        self.queue.extend([
            Job::Phase("acquire"),
            Job::Open { hand: Hand::Track, opening: self.settings.opening, stops: Depth::One },
            Job::Watch(true),
            Job::Bias([true, true]),
            Job::VisualServo { tries: 1 },
            Job::Take { tries: 1 },
        ]);
        self.draw_back_with(self.settings.back);
        self.queue.extend([Job::Phase("identify"), Job::Looks]);
    }

    /// The jaws have closed on the cube: the operator lets go, and the hand draws back with it. A table lets go by itself.
    fn draw_back_with(&mut self, back: f64) {
        if self.settings.keeper == Keeper::Person {
            self.queue.extend([Job::Wait(Hand::Track, RELEASE_WAIT), Job::Release { tries: 1 }]);
        }
        self.queue.extend([Job::Watch(false), Job::DrawBack(back), Job::Remember]);
    }

    fn begin(&mut self, arms: &[ArmState]) {
        if let Some(last) = self.resume.clone() {
            return self.survey(&last, arms);
        }
        match self.goal {
            Goal::Solve => self.take(),
            Goal::Acquire => {
                self.take();
                // As far as the cube is in the hand, and back.
                self.queue.truncate(self.queue.len() - 2);
                self.queue.extend([Job::HandBack, Job::Finish { achieved: true }]);
            }
            Goal::FaceTurn(angle) => {
                let Some(held) = self.belief.held[Hand::Postument.index()] else { return };
                let hold = Hold { palm: held.hold.palm.opposite(), depth: Depth::One, ..held.hold };
                self.apart = false;
                self.queue.extend([
                    Job::Phase("grasp"),
                    Job::Close { hand: Hand::Postument, hold: held.hold },
                    Job::Open {
                        hand: Hand::Track,
                        opening: self.settings.opening,
                        stops: Depth::One,
                    },
                    Job::Bias([true, true]),
                    Job::PreGrasp { hand: Hand::Track, hold, half_roll: false },
                    Job::Approach { hand: Hand::Track, hold, half_roll: false },
                    Job::Close { hand: Hand::Track, hold },
                    Job::Secure { hand: Hand::Track, hold, half_roll: false },
                    Job::Phase("turn"),
                    Job::Turn { turner: Hand::Track, angle, tries: 1 },
                    Job::Phase("release"),
                    Job::LetGo(Hand::Track),
                    Job::Report,
                ]);
            }
        }
    }

    /// How far an arm draws back, of so long a way of which so much must be: where it does not fold that far, all of the way
    /// is tried, and the arm says what stops it.
    fn folds(&mut self, hand: Hand, way: f64, least: f64, arms: &[ArmState]) -> f64 {
        let goes = self.free_way(hand, way, arms);
        if goes >= way || goes < least {
            return way;
        }
        let (short, all) = (goes * 1e3, way * 1e3);
        self.log.notes.push(format!(
            "the {} arm folds no farther: drawn back by {short:.0} of {all:.0} mm",
            name(hand)
        ));
        goes
    }

    /// How much of a way back an arm folds [m].
    fn free_way(&self, hand: Hand, way: f64, arms: &[ArmState]) -> f64 {
        let (fold, arm) = (&self.settings.folds[hand.index()], &arms[hand.index()]);
        fold.way(&arm.desired_base_from_tool, &arm.desired_joints, way)
    }

    /// How far the track arm draws back. Nearer than two thirds of the usual way to where it took the cube, that is still in the
    /// operator's hand; fingers that have let go are clear of it after an edge.
    fn track_folds(&mut self, way: f64, arms: &[ArmState]) -> f64 {
        let holds = self.belief.held[Hand::Track.index()].is_some();
        let least = if self.given_back && !holds {
            self.settings.edge
        } else {
            let gone = self.gone(arms).filter(|_| holds).unwrap_or(0.0);
            CLEAR * self.settings.back - gone
        };
        self.folds(Hand::Track, way, least, arms)
    }

    /// How far the track draws back with the cube from where it closed on it, as far as its arm folds [m].
    fn way_back(&self) -> f64 {
        self.settings.back - self.short
    }

    /// How far the track's tool is from where it closed on the cube [m].
    fn gone(&self, arms: &[ArmState]) -> Option<f64> {
        let from = nalgebra::Vector3::from(self.taken_at?);
        Some((nalgebra::Vector3::from(place(arms)) - from).norm())
    }

    /// Where the cube is, as the controller believes.
    #[must_use]
    pub fn whereabouts(&self) -> String {
        match self.belief.held.map(|held| held.is_some()) {
            [true, true] => "both hands hold the cube".to_owned(),
            [true, false] => "the track hand holds the cube".to_owned(),
            [false, true] => "the postument hand holds the cube".to_owned(),
            [false, false] if self.fell.is_some() => self.fell.clone().unwrap_or_default(),
            [false, false] if self.given_back || self.untouched => match self.settings.keeper {
                Keeper::Person => "the operator has the cube".to_owned(),
                Keeper::Table => "the cube lies on the table".to_owned(),
            },
            [false, false] => {
                "no hand of the robot holds the cube, and where it is is not known".to_owned()
            }
        }
    }

    fn fail(&mut self, reason: impl Into<String>) -> Action<Thought> {
        self.queue.clear();
        self.pending = None;
        let mut reason = reason.into();
        // Why it all began.
        if let Some(failure) = &self.failure {
            reason = format!("{failure}; {reason}");
        }
        // Whoever comes to help must know where it is.
        if self.fell.is_some() || self.belief.held.iter().any(Option::is_some) {
            reason = format!("{reason}; {}", self.whereabouts());
        }
        Action::Finish(Finish { achieved: false, reason })
    }

    /// Digests what became of the pending job. `Err` is the reason why the task cannot go on.
    fn digest(&mut self, event: Event<Conclusion>, arms: &[ArmState]) -> Result<(), String> {
        let pending = self.pending.take();
        match (pending, event) {
            (_, Event::Start) => {
                self.begin(arms);
                Ok(())
            }
            (_, Event::Trouble(reason)) => Err(reason),
            (Some(Job::Check { viewer, face, tries }), Event::Looked(reading)) => {
                self.checked(viewer, face, tries, reading, arms);
                Ok(())
            }
            (Some(Job::Look { viewer, face, tries }), Event::Looked(reading)) => {
                self.looked(viewer, face, tries, reading, arms)
            }
            (Some(Job::Plan), Event::Thought(conclusion)) => self.planned(conclusion),
            (Some(Job::Ask), Event::Answered(answer)) => self.answered(answer.as_ref()),
            (Some(job), Event::Behaved(outcomes)) => self.behaved(job, outcomes, arms),
            _ => Ok(()),
        }
    }

    fn behaved(
        &mut self,
        job: Job,
        outcomes: [Option<Outcome>; 2],
        arms: &[ArmState],
    ) -> Result<(), String> {
        for (hand, outcome) in [Hand::Track, Hand::Postument].into_iter().zip(outcomes) {
            if let Some(alarm) = outcome.filter(Outcome::alarms) {
                let why = format!("{alarm}, at the {} hand while {}", name(hand), doing(&job));
                return match job {
                    Job::Turn { turner, tries, .. } if tries != u32::MAX => {
                        self.turn_failed(turner, &why)
                    }
                    // At the operator's hand: below.
                    Job::VisualServo { .. }
                    | Job::Take { .. }
                    | Job::Release { .. }
                    | Job::Tug { .. }
                    | Job::Feel => break,
                    // Jaws that open next relieve it.
                    Job::Wait(..) if matches!(self.queue.front(), Some(Job::Open { .. })) => Ok(()),
                    // Whoever still holds the cube is given so many tries.
                    Job::Wait(..)
                        if matches!(self.queue.front(), Some(Job::Release { .. } | Job::Feel)) =>
                    {
                        Ok(())
                    }
                    // Who takes hold of a cube that is drawn back to be held out once more is to have it.
                    Job::Along(_, way)
                        if way < 0.0
                            && self.given_back
                            && self.queue.iter().any(|job| matches!(job, Job::Present { .. })) =>
                    {
                        self.somebody_has_hold(&why);
                        Ok(())
                    }
                    Job::DrawIn if self.meets(job) => {
                        self.log.notes.push(format!("{why}: it gives way"));
                        self.feel(&[Job::DrawIn]);
                        Ok(())
                    }
                    Job::HoldOut if self.meets(job) => {
                        self.log.notes.push(format!("{why}: it goes no farther"));
                        self.feel(&[Job::DrawIn, Job::HoldOut]);
                        Ok(())
                    }
                    Job::Joints(..)
                    | Job::Along(..)
                    | Job::Nudge(..)
                    | Job::Roll(..)
                    | Job::PreGrasp { .. }
                    | Job::Apart
                    | Job::Together(_)
                    | Job::GoOn
                    | Job::Wait(..)
                        if self.meets(job) =>
                    {
                        self.give_way(hand, job, &why);
                        Ok(())
                    }
                    Job::Turn { .. } | Job::Wait(..) | Job::Ease(_) if self.unwinds() => {
                        if let (Job::Turn { angle, .. }, Outcome::ForcedApart(_)) = (job, alarm) {
                            self.slipped_back(angle);
                        }
                        self.log.notes.push(why);
                        self.try_again();
                        Ok(())
                    }
                    Job::Approach { hand, .. }
                    | Job::Close { hand, .. }
                    | Job::Secure { hand, .. } => self.not_grasped(hand, &why),
                    // Nobody else is there who could strain it.
                    Job::Present { .. } if matches!(alarm, Outcome::OverForce(..)) => {
                        self.log.notes.push(format!("{why}: the jaws let go"));
                        Ok(())
                    }
                    // Jaws that open relieve what is strained: once more, after it has given way for a while.
                    Job::Open { hand, .. } if self.strained < MOST_STRAINED => {
                        self.strained += 1;
                        self.log.notes.push(format!("{why}: once more"));
                        self.push_front(&[Job::Wait(hand, 0.3), job]);
                        Ok(())
                    }
                    _ => Err(why),
                };
            }
        }
        let of = |hand: Hand| outcomes[hand.index()];
        match job {
            Job::Open { .. } => {
                self.strained = 0;
                Ok(())
            }
            Job::Joints(..)
            | Job::Along(..)
            | Job::Nudge(..)
            | Job::Roll(..)
            | Job::PreGrasp { .. }
            | Job::Apart
            | Job::Together(_)
            | Job::HoldOut
            | Job::GoOn => {
                self.going.1 = 0;
                Ok(())
            }
            Job::Feel => match of(Hand::Track) {
                Some(Outcome::NotTouched) => {
                    let again = "nobody has hold of it: it is drawn back and held out once more";
                    self.log.notes.push(again.to_owned());
                    Ok(())
                }
                Some(Outcome::Touched(_)) => {
                    self.somebody_has_hold("somebody has hold of it");
                    Ok(())
                }
                Some(Outcome::OverForce(..)) if self.meets(job) => {
                    self.feel(&[]);
                    Ok(())
                }
                other => Err(format!(
                    "something is in the way of the cube that is handed back: {}",
                    Outcome::words(other)
                )),
            },
            Job::VisualServo { tries } => match of(Hand::Track) {
                Some(Outcome::Touched(_)) => {
                    if self.seeks.take().is_some() {
                        self.held_out_again();
                    }
                    Ok(())
                }
                // Who has it and shows it does not hold it out.
                Some(Outcome::LostSight(_) | Outcome::OutOfZone(_) | Outcome::TimedOut(_))
                    if self.seeks.is_some() =>
                {
                    self.not_held_out();
                    Ok(())
                }
                Some(Outcome::LostSight(seconds)) => self.unseen(format!(
                    "no cube in sight of the stand-alone camera for {seconds:.1} s"
                )),
                Some(Outcome::OutOfZone(seconds)) => self.unseen(match self.settings.keeper {
                    Keeper::Person => format!(
                        "no cube in reach: it was seen, but outside the place of hand-over for {seconds:.1} s"
                    ),
                    Keeper::Table => format!(
                        "no cube in reach: it was seen, but not on the part of the table where it is to lie, for {seconds:.1} s"
                    ),
                }),
                Some(ended @ (Outcome::NotTouched | Outcome::OverForce(..)))
                    if tries < TAKE_TRIES =>
                {
                    let why = match ended {
                        Outcome::NotTouched => "the cube was not where it was seen".to_owned(),
                        met => format!("{met}, while approaching: the hand draws back"),
                    };
                    self.log.notes.push(format!("{why}, try {tries}"));
                    self.push_front(&[
                        Job::DrawBack(self.settings.back),
                        // The force may have been zeroed while something pushed.
                        Job::Bias([true, false]),
                        Job::VisualServo { tries: tries + 1 },
                    ]);
                    Ok(())
                }
                other => {
                    self.leave(format!("the cube could not be approached: {}", Outcome::words(other)));
                    Ok(())
                }
            },
            Job::Take { tries } => match of(Hand::Track) {
                // Wider than a cube is one with somebody's finger beside it.
                Some(Outcome::Grasped(width))
                    if width > LEAST_WIDTH * self.settings.edge
                        && width < self.settings.edge + MORE =>
                {
                    let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
                    self.belief.taken(Hand::Track, hold, false);
                    self.widths[Hand::Track.index()] = Some(width);
                    (self.taken_at, self.short) = (Some(place(arms)), 0.0);
                    (self.untouched, self.fell) = (false, None);
                    Ok(())
                }
                other if tries < TAKE_TRIES => {
                    self.log.notes.push(format!(
                        "the jaws did not hold the cube ({}), try {tries}",
                        Outcome::words(other)
                    ));
                    self.push_front(&[
                        Job::Open {
                            hand: Hand::Track,
                            opening: self.settings.opening,
                            stops: Depth::One,
                        },
                        Job::DrawBack(self.settings.back),
                        Job::Bias([true, false]),
                        Job::VisualServo { tries: 1 },
                        Job::Take { tries: tries + 1 },
                    ]);
                    Ok(())
                }
                other => {
                    self.leave(format!("the jaws do not hold the cube: {}", Outcome::words(other)));
                    Ok(())
                }
            },
            Job::Release { tries } => match of(Hand::Track) {
                Some(Outcome::NotTouched) => {
                    self.offered = None;
                    // What was zeroed in the operator's hand is zeroed again out of it.
                    if tries > RELEASE_TRIES {
                        self.push_front(&[Job::Bias([true, false])]);
                    }
                    Ok(())
                }
                Some(Outcome::Touched(_) | Outcome::OverForce(..)) if tries < RELEASE_TRIES => {
                    if tries == 1 {
                        self.log.notes.push("the operator still holds the cube".to_owned());
                    }
                    self.push_front(&[
                        Job::Wait(Hand::Track, RELEASE_WAIT),
                        Job::Release { tries: tries + 1 },
                    ]);
                    Ok(())
                }
                // Somebody who holds it pulls at it again, a sensor that lies does not.
                Some(Outcome::Touched(_) | Outcome::OverForce(..)) if tries == RELEASE_TRIES => {
                    self.push_front(&[
                        Job::Bias([true, false]),
                        Job::Release { tries: tries + 1 },
                    ]);
                    Ok(())
                }
                Some(Outcome::Touched(_) | Outcome::OverForce(..)) if self.offered.is_some() => {
                    self.left_to_whoever_has_it("somebody holds the cube");
                    Ok(())
                }
                Some(Outcome::Touched(_)) => {
                    self.leave("the operator does not let go of the cube".to_owned());
                    Ok(())
                }
                other => {
                    self.leave(format!("the cube could not be taken away: {}", Outcome::words(other)));
                    Ok(())
                }
            },
            Job::Approach { hand, .. } => match of(hand) {
                Some(Outcome::Touched(_) | Outcome::Reached) => Ok(()),
                other => {
                    let why = format!(
                        "the {} hand did not find the cube where the partner holds it: {}",
                        name(hand),
                        Outcome::words(other)
                    );
                    self.not_grasped(hand, &why)
                }
            },
            Job::Close { hand, .. } => match of(hand) {
                Some(Outcome::Grasped(width)) if width > LEAST_WIDTH * self.settings.edge => {
                    self.log.grasps += 1;
                    // A layer that is taken anew may still stand askew, and is not wider for that.
                    let known = self.widths[hand.index()].filter(|_| self.unwinds());
                    self.widths[hand.index()] =
                        Some(known.map_or(width, |known| known.min(width)));
                    Ok(())
                }
                // Jaws that were opening when the other run ended looked like jaws on a cube.
                Some(Outcome::Empty(_))
                    if hand == Hand::Track
                        && self.offered.is_some_and(|offered| offered.opening) =>
                {
                    self.left_to_whoever_has_it("the jaws close on nothing");
                    Ok(())
                }
                other => {
                    let why = format!(
                        "the {} hand's jaws do not hold the cube: {}",
                        name(hand),
                        Outcome::words(other)
                    );
                    self.not_grasped(hand, &why)
                }
            },
            Job::Secure { hand, hold, half_roll } => {
                let miss = self.belief.secured(hand, hold, half_roll, arms);
                if miss > 0.004 {
                    self.log.notes.push(format!(
                        "the {} hand found the cube {:.1} mm from where it was expected",
                        name(hand),
                        miss * 1e3
                    ));
                }
                Ok(())
            }
            Job::Turn { turner, angle, tries } => self.turn_ended(turner, angle, tries, of(turner)),
            Job::Tug { tries } => {
                let nobody = of(Hand::Track) == Some(Outcome::NotTouched);
                if nobody && tries >= PRESENTED {
                    return Err("the cube was not taken back: nobody pulls at it".to_owned());
                }
                if nobody {
                    let again = "nobody holds it: it is drawn back and held out once more";
                    self.log.notes.push(again.to_owned());
                    // Who has not seen it leave may not see that it is there again.
                    let goes = self.free_way(Hand::Track, 2.0 * self.settings.back, arms);
                    self.push_front(&[
                        Job::Along(Hand::Track, -goes),
                        Job::HoldOut,
                        Job::Bias([true, false]),
                        Job::Present { tries: tries + 1 },
                    ]);
                } else {
                    self.log.notes.push("somebody holds it: the jaws let go".to_owned());
                }
                Ok(())
            }
            Job::LayDown => match of(Hand::Track) {
                Some(Outcome::Touched(_)) => Ok(()),
                other => Err(format!(
                    "the cube could not be laid down, no table was felt: {}",
                    Outcome::words(other)
                )),
            },
            Job::Present { tries } => match of(Hand::Track) {
                Some(Outcome::Pulled) => Ok(()),
                Some(Outcome::TimedOut(seconds)) => {
                    self.log.notes.push(format!("nobody took the cube for {seconds:.0} s"));
                    // What is felt from here on is the tug.
                    self.push_front(&[Job::Bias([true, false]), Job::Tug { tries }]);
                    Ok(())
                }
                other => Err(format!("the cube was not taken back: {}", Outcome::words(other))),
            },
            _ => Ok(()),
        }
    }

    fn turn_ended(
        &mut self,
        turner: Hand,
        angle: f64,
        tries: u32,
        outcome: Option<Outcome>,
    ) -> Result<(), String> {
        match outcome {
            // Only a way back: what follows looks at what has become of the cube.
            ref ended if tries == u32::MAX && Self::turned_back(ended.as_ref()) => {
                self.went_back(matches!(ended, Some(Outcome::Slipped(..))));
                Ok(())
            }
            Some(Outcome::Turned(turned)) => {
                self.turned += turned;
                // A turn in several goes, after a stall, is one turn.
                let over = !matches!(self.queue.front(), Some(Job::Turn { .. }));
                if let Some(turn) = self.turning.take_if(|_| over) {
                    self.shown.facelets = self.shown.facelets.map(|f| f.turned(turn));
                    self.log.executed.push(turn);
                    (self.straight, self.begun) = (None, None);
                }
                Ok(())
            }
            Some(Outcome::Stalled(turned, torque)) if tries <= TURN_TRIES => {
                self.log.notes.push(format!(
                    "the face stood still after {:.0} deg of {:.0} under {torque:.1} Nm: eased back, try {tries}",
                    turned.to_degrees(),
                    angle.to_degrees()
                ));
                self.turned += turned;
                self.stood_still = self.turning.or(self.stood_still);
                let ease = -angle.signum() * 0.09_f64.min(turned.abs());
                self.push_front(&[
                    // A stall on the way back is one more try of the same turn.
                    Job::Turn { turner, angle: ease, tries: tries + 1 },
                    Job::Turn { turner, angle: angle - turned - ease, tries: tries + 1 },
                ]);
                Ok(())
            }
            Some(Outcome::Stalled(turned, torque)) => {
                let degrees = (self.turned + turned).to_degrees();
                let why = format!(
                    "jam: the face stands still after {degrees:.0} deg under {torque:.1} Nm"
                );
                self.turn_failed(turner, &why)
            }
            Some(slipped @ Outcome::Slipped(..)) => self.turn_failed(turner, &slipped.to_string()),
            other => Err(format!("the turn ended otherwise: {}", Outcome::words(other))),
        }
    }

    /// Whoever holds the cube alone.
    fn holder(&self) -> Result<Hand, String> {
        [Hand::Track, Hand::Postument]
            .into_iter()
            .find(|h| self.belief.held[h.index()].is_some())
            .ok_or_else(|| "nobody holds the cube".to_owned())
    }

    /// The same with its grip.
    fn held_alone(&self) -> Result<(Hand, Grip), String> {
        let holder = self.holder()?;
        let held = self.belief.held[holder.index()].ok_or("nobody holds the cube")?;
        Ok((holder, Grip { hold: held.hold, half_roll: held.half_roll }))
    }

    /// What becomes of a cube that goes back.
    fn goes_back(&self) -> &'static str {
        match self.settings.keeper {
            Keeper::Person => "is handed back",
            Keeper::Table => "is laid on the table again",
        }
    }

    /// The task cannot be done: the cube goes back to the operator as it is, with the reason.
    fn give_back(&mut self, reason: String) -> Result<(), String> {
        self.log.notes.push(format!("{reason}: the cube {}", self.goes_back()));
        self.log.grasps = 0;
        let way = Planner::new(&self.settings).of(&[Vec::new()], self.held_alone()?);
        let steps = way.map_err(|e| format!("{reason}; {e}"))?.steps;
        self.failure = Some(reason);
        self.queue.clear();
        self.queue.extend(steps.into_iter().map(Job::Step));
        self.queue.extend([Job::HandBack, Job::Finish { achieved: false }]);
        Ok(())
    }

    fn planned(&mut self, conclusion: Conclusion) -> Result<(), String> {
        let answer = match conclusion.0 {
            Ok(answer) => answer,
            Err(NoAnswer::Unread(doubt)) => return self.doubted(*doubt),
            Err(NoAnswer::Unplanned(reason)) => return self.give_back(reason),
        };
        self.shown.decided(&answer);
        let levels = self.sight.levels();
        self.palette = Some(recover::palette(&levels, answer.read.colours()));
        // What is told of a mission is what it found and planned at first.
        if self.log.identified.is_none() {
            self.log.identified = Some(answer.identified);
            self.log.solution.clone_from(&answer.turns);
            self.log.plan = answer.lines;
            self.log.grasps = 0;
        }
        self.belief.renamed(answer.rotation);
        self.sight.renamed();
        self.queue.push_back(Job::Phase("solve"));
        self.queue.extend(answer.steps.into_iter().map(Job::Step));
        self.queue.extend([Job::Inspect, Job::HandBack, Job::Finish { achieved: true }]);
        Ok(())
    }

    /// Asks the operator, if somebody is there and there is something to start from.
    fn ask(&mut self, doubt: Doubt) -> Result<(), String> {
        let Some(seconds) = self.patience else { return self.give_back(doubt.reason) };
        self.questions += 1;
        let otherwise = format!("without an answer the cube {} as it is", self.goes_back());
        let question = Question {
            number: self.questions,
            text: format!("{}. What are the colours?", doubt.reason),
            otherwise,
            seconds,
            until: 0.0,
            subject: Subject::Stickers {
                read: self.guess(&doubt),
                doubtful: doubt.doubtful.clone(),
            },
        };
        self.log.notes.push(format!("{}: the operator is asked", doubt.reason));
        self.asked = Some((Asked::Colours(doubt), question));
        self.queue.push_front(Job::Ask);
        Ok(())
    }

    /// The colours that the operator starts from.
    fn guess(&self, doubt: &Doubt) -> String {
        let net = |i: usize| self.shown.net.facelets.get(i).copied().flatten();
        // An impossible cube is read by the faces whose centres have the colours: named as the centres look.
        let names: Vec<usize> =
            (0..6).filter_map(|f| net(f * 9 + 4)).map(|r| usize::from(r.colour.min(5))).collect();
        let mut sorted = names.clone();
        sorted.sort_unstable();
        let permuted = sorted == [0, 1, 2, 3, 4, 5] && self.given.is_none();
        let letter = |i: usize| match doubt.read {
            Some(read) if doubt.possible || !permuted => read.colour(i).letter(),
            Some(read) => Face::ALL[names[read.colour(i).index()]].letter(),
            None => net(i).map_or('-', |r| Face::ALL[usize::from(r.colour.min(5))].letter()),
        };
        (0..54).map(letter).collect()
    }

    fn answered(&mut self, answer: Option<&Answer>) -> Result<(), String> {
        match (self.asked.take(), answer) {
            (None, _) => Ok(()),
            (Some((Asked::Colours(_), _)), Some(Answer::Stickers { stickers })) => {
                self.log.notes.push("the operator has given the colours".to_owned());
                self.given = Some(*stickers);
                self.queue.push_front(Job::Plan);
                Ok(())
            }
            (
                Some((Asked::Sight(_), _)),
                Some(Answer::Choice { option: hand_over::LOOK_AGAIN }),
            ) => {
                self.queue.push_front(Job::VisualServo { tries: 1 });
                Ok(())
            }
            (
                Some((Asked::Inspection(_), _)),
                Some(Answer::Choice { option: hand_over::LOOK_AGAIN }),
            ) => {
                self.queue.push_front(Job::Inspect);
                Ok(())
            }
            (Some((asked, _)), _) => {
                // Who did not answer now is not asked again.
                self.patience = None;
                match asked {
                    Asked::Colours(doubt) => self.give_back(doubt.reason),
                    Asked::Sight(why) => Err(why),
                    Asked::Inspection(why) => self.give_back(why),
                }
            }
        }
    }

    /// Turns a job into an action, or into smaller jobs and `None`.
    fn unfold(&mut self, job: Job, arms: &[ArmState]) -> Result<Option<Action<Thought>>, String> {
        let s = &self.settings;
        let action = match job {
            Job::Phase(name) => Action::Phase(name),
            Job::Watch(on) => Action::Watch(on),
            Job::Bias(which) => {
                if which == [true; 2] {
                    self.forces = Trust::Believed;
                }
                Action::Bias(which)
            }
            Job::Joints(targets, speed) => {
                if targets == ARMS_APART {
                    return Ok(None);
                }
                // The ways between meetings are free of collisions when both arms go evenly: the quicker one waits
                // for the other at every point.
                let seconds = targets
                    .iter()
                    .zip(arms)
                    .filter_map(|(t, arm)| t.map(|t| (arm.desired_joints, t)))
                    .map(|(from, to)| s.speeds.joints_seconds(&from, &to, speed))
                    .fold(0.0, f64::max);
                let orders =
                    targets.map(|t| t.map(|target| Behaviour::Joints { target, speed, seconds }));
                Action::Behave { orders, until: Until::All }
            }
            Job::Along(hand, way) => {
                let target =
                    arms[hand.index()].desired_base_from_tool * Pose::translation(0.0, 0.0, way);
                behave(hand, Behaviour::Line { target, speed: s.speed })
            }
            Job::Nudge(hand, [x, y, z]) => {
                let target = arms[hand.index()].desired_base_from_tool * Pose::translation(x, y, z);
                behave(hand, Behaviour::Line { target, speed: s.speed })
            }
            Job::Apart => {
                if self.apart {
                    return Ok(None);
                }
                self.apart = true;
                let mut target = arms[Hand::Track.index()].desired_joints;
                let back = target.0[0] - s.meetings.separation;
                target.0[0] = self.least_track.map_or(back, |least| back.max(least));
                behave(Hand::Track, Behaviour::Joints { target, speed: s.speed, seconds: 0.0 })
            }
            Job::Together(target) => {
                self.apart = false;
                behave(Hand::Track, Behaviour::Joints { target, speed: s.speed, seconds: 0.0 })
            }
            Job::Meet { newcomer, meeting, back } => {
                let track = if newcomer == Hand::Track && back {
                    meeting.track_back
                } else {
                    meeting.track
                };
                let postument = if newcomer == Hand::Postument && back {
                    meeting.postument_back
                } else {
                    meeting.postument
                };
                let mut apart = track;
                apart.0[0] -= s.meetings.separation;
                let speed = s.speed;
                self.meeting = Some(meeting);
                self.push_front(&[
                    Job::Apart,
                    Job::Joints([Some(apart), Some(postument)], speed),
                    Job::Together(track),
                ]);
                return Ok(None);
            }
            Job::Open { hand, opening, stops } => {
                let order = self.open(hand, opening, stops);
                self.stops[hand.index()] = stops;
                behave(hand, order)
            }
            Job::LetGo(hand) => {
                // Stops that came forward now would push the cube out of both hands.
                let stops = self.stops[hand.index()];
                let open = Job::Open { hand, opening: s.opening, stops };
                // Two arms meet where both can draw back; where a person or a table holds the cube, the track's folds as far
                // as it does.
                let back = match (self.given_back, hand) {
                    (true, Hand::Track) => Job::DrawBack(s.back),
                    _ => Job::Along(hand, -s.back),
                };
                self.belief.released(hand);
                self.push_front(&[open, back]);
                return Ok(None);
            }
            Job::PreGrasp { hand, hold, half_roll } => {
                let grasp = self
                    .belief
                    .grasp_pose(hand, hold, half_roll, arms)
                    .ok_or("the partner does not hold the cube")?;
                let target = grasp * Pose::translation(0.0, 0.0, -s.pre_grasp);
                behave(hand, Behaviour::Line { target, speed: s.speed })
            }
            Job::Approach { hand, hold, half_roll } => {
                let order = if s.compliance == ComplianceChoice::None {
                    let target = self
                        .belief
                        .grasp_pose(hand, hold, half_roll, arms)
                        .ok_or("the partner does not hold the cube")?;
                    Behaviour::Line { target, speed: 0.2 * s.speed }
                } else {
                    Behaviour::Approach {
                        speed: s.approach_speed,
                        distance: s.pre_grasp + 0.015,
                        force: s.touch,
                        selector: [false; 6],
                    }
                };
                behave(hand, order)
            }
            Job::Close { hand, hold } => {
                let order = Behaviour::Grasp {
                    force: s.grip,
                    least_width: LEAST_WIDTH * s.edge,
                    selector: s.grasp_selector(),
                    stops: hold.depth,
                };
                self.stops[hand.index()] = hold.depth;
                behave(hand, order)
            }
            Job::Secure { hand, hold, .. } => {
                let order = Behaviour::Secure {
                    press: s.press,
                    force: s.grip,
                    selector: s.grasp_selector(),
                    stops: hold.depth,
                };
                self.stops[hand.index()] = hold.depth;
                behave(hand, order)
            }
            Job::VisualServo { .. } => {
                let order = visual_servo::Order {
                    world_from_base: self.belief.world_from_base(Hand::Track),
                    seat: s.edge / 3.0,
                    patience: self
                        .seeks
                        .map_or(s.visual.patience, |time| time.min(s.visual.patience)),
                    ..s.visual
                };
                behave(Hand::Track, Behaviour::VisualServo(order))
            }
            Job::Take { .. } => {
                let order = Behaviour::Grasp {
                    force: s.grip,
                    least_width: LEAST_WIDTH * s.edge,
                    selector: s.grasp_selector(),
                    stops: Depth::One,
                };
                self.stops[Hand::Track.index()] = Depth::One;
                behave(Hand::Track, order)
            }
            Job::Wait(hand, seconds) => {
                let selector = s.grasp_selector();
                let order = Behaviour::Present { pull: f64::INFINITY, selector, seconds };
                behave(hand, order)
            }
            Job::HoldOut => {
                let way = self.way_back();
                let now = arms[Hand::Track.index()].desired_base_from_tool;
                let (_, out) =
                    *self.way_out.get_or_insert((now, now * Pose::translation(0.0, 0.0, way)));
                behave(Hand::Track, Behaviour::Line { target: out, speed: s.speed })
            }
            Job::DrawIn => {
                let (drawn, _) = self.way_out.ok_or("the cube was not held out")?;
                behave(Hand::Track, Behaviour::Line { target: drawn, speed: s.speed })
            }
            Job::Release { .. } | Job::Tug { .. } | Job::Feel => {
                // What has met something is pressed perhaps, and was zeroed a while ago.
                let share = if matches!(job, Job::Feel) { 1.0 } else { 0.5 };
                let mut selector = s.grasp_selector();
                selector[2] = false;
                let order = Behaviour::Withdraw {
                    speed: s.approach_speed,
                    distance: RELEASE_WAY,
                    force: share * s.pull,
                    selector,
                };
                behave(Hand::Track, order)
            }
            Job::DrawBack(way) => {
                let goes = self.track_folds(way, arms);
                // Without a cube nothing is drawn back from where one was taken. A run that goes on may hold it without
                // knowing where that was.
                if self.belief.held[Hand::Track.index()].is_some() {
                    self.short += way - goes;
                }
                self.push_front(&[Job::Along(Hand::Track, -goes)]);
                return Ok(None);
            }
            Job::Remember => {
                self.hand_over = Some(arms[Hand::Track.index()].desired_joints);
                return Ok(None);
            }
            Job::Step(step) => {
                if self.inspects_at(step) {
                    return Ok(None);
                }
                self.shown.step = self.shown.step.map(|step| step + 1);
                self.unfold_step(step, arms)?;
                return Ok(None);
            }
            Job::Inspect => {
                self.unfold_inspect()?;
                return Ok(None);
            }
            Job::Reconcile => {
                self.reconcile()?;
                return Ok(None);
            }
            Job::Anew => {
                self.anew();
                return Ok(None);
            }
            Job::Untwist => {
                self.untwist(arms);
                return Ok(None);
            }
            Job::Look { viewer, face, tries } | Job::Check { viewer, face, tries } => {
                let camera_from_face = self
                    .belief
                    .face_in_camera(viewer, face, arms)
                    .ok_or("there is no camera in that hand, or no cube in the other")?;
                let exposure = self.exposure(tries);
                let view = View { camera_from_face, exposure };
                Action::Look { effector: viewer.index(), view }
            }
            Job::Looks => {
                let steps = self.looks()?;
                self.looks_then_plan(steps);
                return Ok(None);
            }
            Job::Plan => {
                let missing = self.sight.missing();
                if self.given.is_none() && self.patience.is_some() && !missing.is_empty() {
                    let names: Vec<String> =
                        missing.iter().map(|&i| facelet_place(i).to_string()).collect();
                    let reason = format!("stickers {} cannot be read", names.join(", "));
                    let doubtful = missing;
                    self.ask(Doubt { reason, read: None, doubtful, possible: false })?;
                    return Ok(None);
                }
                self.plan()?
            }
            Job::Ask => match &self.asked {
                Some((_, question)) => Action::Ask(question.clone()),
                None => return Ok(None),
            },
            Job::Unwind { turner, tries, eased } => {
                self.unwind(turner, tries, eased, arms);
                return Ok(None);
            }
            Job::Ease(hand) => {
                let mut selector = s.grasp_selector();
                selector[5] = true;
                let order = Behaviour::Present { pull: f64::INFINITY, selector, seconds: EASE };
                behave(hand, order)
            }
            Job::Stand(seconds) => {
                let stand = |arm: &ArmState| {
                    let (target, speed) = (arm.desired_joints, s.speed);
                    Some(Behaviour::Joints { target, speed, seconds })
                };
                let orders = [stand(&arms[0]), stand(&arms[1])];
                Action::Behave { orders, until: Until::All }
            }
            Job::Roll(hand, angle) => {
                let roll = UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), angle);
                let target = arms[hand.index()].desired_base_from_tool * roll;
                behave(hand, Behaviour::Line { target, speed: s.speed })
            }
            Job::Holds { hand, hold, half_roll } => {
                self.belief.turned(hand, hold, half_roll);
                return Ok(None);
            }
            Job::GiveUp => {
                self.give_up()?;
                return Ok(None);
            }
            Job::Turn { turner, angle, tries } => {
                self.straight = self.straight.or_else(|| self.straight_now(turner));
                // On the way back nothing may slip any more, neither way.
                let most = if tries == u32::MAX { unwind::GENTLE } else { f64::INFINITY };
                self.turn(turner, angle, s.turn_torque.min(most))?
            }
            Job::Report => {
                let achieved = match self.goal {
                    Goal::FaceTurn(angle) => (self.turned - angle).abs() < 0.05,
                    Goal::Solve | Goal::Acquire => true,
                };
                let quarters = (self.turned / std::f64::consts::FRAC_PI_2).round() as i32;
                if let Some(turn) = crate::cube::Turn::new(Face::U, quarters.rem_euclid(4) as u8) {
                    self.log.executed.push(turn);
                }
                Action::Finish(Finish {
                    achieved,
                    reason: format!("the face was turned by {:.1} deg", self.turned.to_degrees()),
                })
            }
            Job::HandBack => {
                self.unfold_hand_back()?;
                return Ok(None);
            }
            Job::LayDown => {
                self.given_back = true;
                // Farther than the table can be: one that is not felt by then is not there.
                let distance = s.pre_grasp + s.edge / 3.0 + 0.01;
                let selector = [false; 6];
                let order = Behaviour::Approach {
                    speed: s.approach_speed,
                    distance,
                    force: s.touch,
                    selector,
                };
                behave(Hand::Track, order)
            }
            Job::Present { .. } => {
                self.given_back = true;
                let selector = s.grasp_selector();
                let order = Behaviour::Present { pull: s.pull, selector, seconds: 20.0 };
                behave(Hand::Track, order)
            }
            Job::GoOn => Action::Behave { orders: self.going.0, until: Until::All },
            Job::Leave => return Err(self.failure.take().unwrap_or_default()),
            Job::Finish { achieved } => {
                let back = match s.keeper {
                    Keeper::Person if self.seeks.is_some() => recover::UNSEEN,
                    Keeper::Person => "the cube was handed back",
                    Keeper::Table => "the cube was laid on the table",
                };
                let reason = match &self.failure {
                    Some(failure) if self.seeks.is_some() => format!("{failure}; {back}"),
                    Some(failure) => format!("{failure}; {back} as it is"),
                    None => back.to_owned(),
                };
                Action::Finish(Finish { achieved, reason })
            }
        };
        Ok(Some(action))
    }

    fn open(&self, hand: Hand, opening: f64, stops: Depth) -> Behaviour {
        // While the partner or the operator holds the cube too, what is strained between the hands gives way before
        // the pads do.
        let chained = self.belief.held[hand.other().index()].is_some() && !self.apart;
        let theirs = self.given_back || self.queue.contains(&Job::Leave);
        Behaviour::Jaw {
            jaw: JawCommand { opening, force_limit: self.settings.grip, stops },
            seconds: LEAVE_SECONDS,
            selector: if (chained || theirs) && self.forces == Trust::Believed {
                self.settings.grasp_selector()
            } else {
                [false; 6]
            },
            // Whoever takes the cube, however hard, is to have it; and what is only believed to strain does not hinder.
            strained: theirs || self.forces == Trust::Doubted,
        }
    }

    fn unfold_step(&mut self, step: Step, arms: &[ArmState]) -> Result<(), String> {
        let held = self.belief.held;
        let holds = |hand: Hand| held[hand.index()];
        match step {
            Step::Leave { hand } => self.push_front(&[Job::LetGo(hand)]),
            Step::Look { viewer, face } => {
                let held =
                    holds(viewer.other()).ok_or("the partner of the viewer holds nothing")?;
                // Which side of the holder's tool the face is on.
                let in_tool =
                    held.hold.cube_from_tool(held.half_roll, self.settings.edge).rotation.inverse()
                        * face.normal();
                let side = if in_tool.z > 0.9 {
                    0
                } else if in_tool.x > 0.9 {
                    1
                } else if in_tool.x < -0.9 {
                    2
                } else {
                    return Err(format!("face {} is under a jaw or the palm", face.letter()));
                };
                let meeting = self.settings.meetings.views[viewer.other().index()][side]
                    .ok_or("the cell has no pose for this look")?;
                let mut jobs = vec![Job::Meet { newcomer: viewer, meeting, back: false }];
                // In doubt: from nearer, beside another exposure.
                jobs.extend((self.rounds > 1).then_some(Job::Nudge(viewer, NUDGES[0])));
                jobs.push(Job::Look { viewer, face, tries: 1 });
                if holds(viewer).is_some() {
                    jobs.insert(0, Job::LetGo(viewer));
                }
                self.push_front(&jobs);
            }
            Step::Grasp { hand, hold, half_roll } => {
                let held = holds(hand.other()).ok_or("nobody would hold the cube meanwhile")?;
                let edge = self.settings.edge;
                let partner = held.hold.cube_from_tool(held.half_roll, edge).rotation;
                let own = hold.cube_from_tool(half_roll, edge).rotation;
                let (track, postument) =
                    if hand == Hand::Track { (own, partner) } else { (partner, own) };
                let index = crate::cube::rotation_index(&(track.inverse() * postument));
                let meeting = self.settings.meetings.grasps[index]
                    .ok_or("the arms cannot meet in this pair of holds")?;
                let mut jobs = vec![
                    Job::Meet { newcomer: hand, meeting, back: true },
                    // The palm's stops stand where the grasp has them before the hand comes near.
                    Job::Open { hand, opening: self.settings.opening, stops: hold.depth },
                    Job::Bias([true, true]),
                    Job::PreGrasp { hand, hold, half_roll },
                    Job::Approach { hand, hold, half_roll },
                    Job::Close { hand, hold },
                    Job::Secure { hand, hold, half_roll },
                ];
                if holds(hand).is_some() {
                    jobs.insert(0, Job::LetGo(hand));
                }
                self.push_front(&jobs);
            }
            Step::Turn { turner, turn } => {
                self.straight = self.straight_now(turner);
                let angle = self.turn_angle(turner, turn.quarters)?;
                self.turning = Some(turn);
                self.turned = 0.0;
                self.push_front(&[Job::Turn { turner, angle, tries: 1 }]);
                let held = holds(turner).ok_or("the turner holds nothing")?;
                let grip = Grip { hold: held.hold, half_roll: held.half_roll };
                let roll = arms[turner.index()].desired_joints.0[6];
                self.begun = Some(unwind::Begun::new(turner, grip, roll, angle.signum()));
                let (hold, half_roll) = held.hold.after_turn(held.half_roll, turn.quarters);
                self.belief.turned(turner, hold, half_roll);
            }
        }
        Ok(())
    }

    /// How the turner's tool stands to the cube while its layer is straight.
    fn straight_now(&self, turner: Hand) -> Option<(Hand, Face, UnitQuaternion<f64>)> {
        let held = self.belief.held[turner.index()]?;
        let cube_from_tool = held.hold.cube_from_tool(held.half_roll, self.settings.edge);
        Some((turner, held.hold.palm, cube_from_tool.rotation))
    }

    /// Roll of the turner's tool for a number of clockwise quarter turns: the tool's z points into the cube, so
    /// clockwise seen from outside is positive about it. A half turn goes where the wrist has room.
    fn turn_angle(&self, turner: Hand, quarters: u8) -> Result<f64, String> {
        let meeting = self.meeting.ok_or("the arms have not met")?;
        let room = match turner {
            Hand::Track => meeting.track_roll,
            Hand::Postument => meeting.postument_roll,
        };
        let quarter = std::f64::consts::FRAC_PI_2;
        Ok(match quarters {
            1 => quarter,
            3 => -quarter,
            _ => half_turn(room),
        })
    }

    /// The turner turns, and stands still at a torque [Nm]; its partner gives way.
    fn turn(&self, turner: Hand, angle: f64, torque: f64) -> Result<Action<Thought>, String> {
        let s = &self.settings;
        let body = turner.other();
        let stiff = s.compliance == ComplianceChoice::None;
        let axis = self.belief.turn_axis(turner).ok_or("a hand is empty in a turn")?;
        let (turner_selector, body_selector) = match s.compliant_arm {
            CompliantArm::Body => ([false; 6], s.turn_selector(axis)),
            CompliantArm::Turner => (s.turn_selector(2), [false; 6]),
        };
        let mut orders = [None, None];
        orders[turner.index()] = Some(Behaviour::Turn {
            angle,
            speed: s.turn_speed,
            torque,
            least_torque: s.turn_least_torque,
            selector: turner_selector,
            stiff,
        });
        orders[body.index()] = Some(Behaviour::Comply { selector: body_selector });
        Ok(Action::Behave { orders, until: Until::Effector(turner.index()) })
    }

    fn plan(&self) -> Result<Action<Thought>, String> {
        let mut rgb = [[0.0; 3]; 54];
        for (i, seen) in self.sight.levels().into_iter().enumerate() {
            let given = self.given.map(|_| [0.0; 3]);
            rgb[i] = seen.or(given).ok_or_else(|| format!("sticker {i} was never seen"))?;
        }
        Ok(Action::Think(Thought {
            rgb,
            given: self.given,
            start: self.held_alone()?,
            strategy: self.settings.strategy.clone(),
            planner: Planner::new(&self.settings),
            nodes: self.settings.nodes,
            candidates: self.settings.candidates,
            seconds_per_node: self.settings.seconds_per_node,
        }))
    }

    fn unfold_hand_back(&mut self) -> Result<(), String> {
        let target = self.hand_over.ok_or("the place of the hand-over is not known")?;
        let s = &self.settings;
        let speed = s.speed;
        let (phase, way, end) = match s.keeper {
            Keeper::Person => ("hand back", Job::HoldOut, Job::Present { tries: 1 }),
            Keeper::Table => {
                let lowers = Job::Along(Hand::Track, self.way_back() - s.pre_grasp);
                ("lay down", lowers, Job::LayDown)
            }
        };
        self.way_out = None;
        self.push_front(&[
            Job::Phase(phase),
            Job::Apart,
            Job::Joints([Some(target), None], speed),
            way,
            Job::Bias([true, false]),
            end,
            Job::LetGo(Hand::Track),
        ]);
        Ok(())
    }
}

impl Task for Mission {
    type Thought = Thought;
    type Conclusion = Conclusion;

    fn next(&mut self, event: Event<Conclusion>, readings: &Readings<'_>) -> Action<Thought> {
        let arms = readings.arms;
        let began = matches!(event, Event::Start);
        if let Err(reason) = self.digest(event, arms) {
            return self.fail(reason);
        }
        if !began && let Err(reason) = self.look_after(arms) {
            return self.fail(reason);
        }
        while let Some(job) = self.queue.pop_front() {
            match self.unfold(job, arms) {
                Ok(Some(action)) => {
                    if let Action::Behave { orders, .. } = &action
                        && !matches!(job, Job::Wait(..))
                    {
                        self.going.0 = *orders;
                    }
                    self.pending = Some(job);
                    return action;
                }
                Ok(None) => {}
                Err(reason) => return self.fail(reason),
            }
        }
        self.fail("the task has nothing left to do")
    }

    fn notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.log.notes)
    }

    fn picture(&self) -> Option<Picture> {
        let turning = self.straight.filter(|_| matches!(self.pending, Some(Job::Turn { .. })));
        let turning = turning.map(|(hand, face, cube_from_tool)| Turning {
            effector: hand.index(),
            face,
            cube_from_tool,
        });
        Some(Picture {
            world_from_base: [Hand::Track, Hand::Postument]
                .map(|h| Some(self.belief.world_from_base(h))),
            tool_from_cube: [Hand::Track, Hand::Postument].map(|h| self.belief.tool_from_cube(h)),
            handed_back: self.given_back,
            facelets: self.shown.facelets,
            turning,
            net: self.shown.net.clone(),
            plan: Arc::clone(&self.shown.plan),
            step: self.shown.step.and_then(|step| step.checked_sub(1)),
        })
    }

    fn entry(&self) -> Option<Entry> {
        // No other task can go on.
        let job = self.pending.as_ref().filter(|_| self.goal == Goal::Solve)?;
        let over = matches!(job, Job::Finish { .. });
        let changes = matches!(
            job,
            Job::Take { .. }
                | Job::Close { .. }
                | Job::Open { .. }
                | Job::Turn { .. }
                | Job::Present { .. }
                | Job::Tug { .. }
                | Job::LayDown
                | Job::Along(..)
                | Job::HoldOut
                | Job::DrawIn
                | Job::Feel
                // The first that knows where the cube is to go back to.
                | Job::Apart
                | Job::Joints(..)
        );
        (over || changes).then(|| Entry {
            doing: if over { "over" } else { doing(job) }.to_owned(),
            held: self.belief.held.map(|held| held.map(|held| held.hold.depth)),
            hand_over: self.hand_over,
            taken_at: self.taken_at,
            short: self.short,
            stops: self.stops.map(Some),
            handing_back: self.given_back,
            undone: self.failure.as_ref().map(|why| why.chars().take(MOST_NOTED).collect()),
            over,
        })
    }

    fn think(thought: Thought) -> (Conclusion, crate::tasks::Effort) {
        super::think::think(&thought)
    }
}

impl Shown {
    /// The whole cube has been decided, and there is a plan: all in the frame of the centres' colours.
    fn decided(&mut self, answer: &super::think::Answer) {
        let (colours, rotation) = (answer.read.colours(), answer.rotation);
        self.net = Net { facelets: vec![None; 54], decided: true };
        for (index, (colour, confidence)) in colours.iter().zip(answer.margins).enumerate() {
            let place = facelet_place(index);
            let to = facelet_at(rotation.cell(place.cell()), rotation.face(place.face));
            self.net.facelets[to] = Some(Reading { colour: *colour, confidence });
        }
        self.facelets = answer.identified.parse().ok();
        let line = |line: &Line| PlanLine {
            what: line.what.clone(),
            why: line.why.clone(),
            seconds: line.seconds,
        };
        self.plan = Arc::new(answer.lines.iter().map(line).collect());
        self.step = Some(0);
    }
}

/// Where the track's tool is set to be, in its base [m].
fn place(arms: &[ArmState]) -> [f64; 3] {
    arms[Hand::Track.index()].desired_base_from_tool.translation.vector.into()
}

/// A half turn goes where the wrist has room.
fn half_turn(room: (f64, f64)) -> f64 {
    if room.1 > -room.0 { std::f64::consts::PI } else { -std::f64::consts::PI }
}

fn behave(hand: Hand, behaviour: Behaviour) -> Action<Thought> {
    let mut orders = [None, None];
    orders[hand.index()] = Some(behaviour);
    Action::Behave { orders, until: Until::Effector(hand.index()) }
}

fn name(hand: Hand) -> &'static str {
    match hand {
        Hand::Track => "track",
        Hand::Postument => "postument",
    }
}

fn doing(job: &Job) -> &'static str {
    match job {
        Job::Turn { .. } => "turning",
        Job::Approach { .. } | Job::VisualServo { .. } => "approaching",
        Job::Close { .. } | Job::Take { .. } => "closing the jaws",
        Job::Secure { .. } => "securing",
        Job::Open { .. } => "opening the jaws",
        Job::Wait(..) | Job::Ease(_) => "giving way",
        Job::Present { .. } | Job::Tug { .. } | Job::Feel => "handing back",
        Job::LayDown => "laying it down",
        _ => "moving",
    }
}
