//! The tasks: kernels of MP, one folder a task. Pure: event -> next action.
//!
//! A task imports neither `hw` nor `kinematics`: poses, wrenches and reach come to it as data. The same kernel
//! serves both coordination schemes, because what it orders are behaviours; who runs their generators (MP at each
//! macrostep, or the ECPs on their own) is the shells' business.

pub mod cube;
pub mod idle;
pub mod panel;
pub mod procedure;

use crate::cube::{Face, Facelets};
use crate::generators::{Behaviour, Outcome};
use crate::motion::{ArmState, Depth, JointPositions};
use crate::operator::{Answer, Manual, Net, PlanLine, Question};
use crate::spatial::Pose;
use crate::vision::sensor::FaceReading;
use nalgebra::UnitQuaternion;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A kernel of MP.
pub trait Task: Send {
    /// Long work that the kernel wants done beside the motions; plain data in ...
    type Thought: std::fmt::Debug + Clone + Send + 'static;
    /// ... and out.
    type Conclusion: std::fmt::Debug + Send + 'static;

    /// The next action after an event.
    fn next(
        &mut self,
        event: Event<Self::Conclusion>,
        readings: &Readings<'_>,
    ) -> Action<Self::Thought>;

    /// What the operator should be told since the last call: where and why something was tried again.
    fn notes(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// What the kernel believes now, for whoever shows it; nothing depends on whether it is asked.
    fn picture(&self) -> Option<Picture> {
        None
    }

    /// What must be durable before the action that was just asked for is carried out, so that another run can go on.
    fn entry(&self) -> Option<Entry> {
        None
    }

    /// Does the long work. A pure function of its argument.
    fn think(thought: Self::Thought) -> (Self::Conclusion, Effort);
}

/// What a run must know that goes on where another was broken off; by default that nothing has been done yet.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Entry {
    /// What is about to be done, in words.
    pub doing: String,
    /// How deep each hand reaches over the cube that it holds, as believed.
    pub held: [Option<Depth>; 2],
    /// Where the track stood when it had taken the cube from the operator, or from the table.
    pub hand_over: Option<JointPositions>,
    /// Where the track's tool closed on the cube as it was given, in its base (m).
    pub taken_at: Option<[f64; 3]>,
    /// By how much less than usual the track drew back from there, since the arm folds no farther
    /// (m).
    #[serde(default)]
    pub short: f64,
    /// Where the stops of each palm were put last: how deep a hand reaches whose hold is not believed yet.
    #[serde(default)]
    pub stops: [Option<Depth>; 2],
    /// The operator has been offered the cube, or it is being laid down.
    pub handing_back: bool,
    /// Why it goes back unsolved, if it does.
    #[serde(default)]
    pub undone: Option<String>,
    /// Nothing is left to be done.
    pub over: bool,
}

/// What MP knows of the cell when a kernel decides.
#[derive(Debug, Clone, Copy)]
pub struct Readings<'a> {
    /// The effectors' present states, in the scenario's order.
    pub arms: &'a [ArmState],
    /// The wrists' forces as their VSP aggregates them; zeros when the scenario has none.
    pub forces: Forces,
}

/// Wrist forces of both effectors, as the VSP of the forces aggregates them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Forces {
    /// One entry an effector.
    pub arms: [Felt; 2],
}

/// What one wrist feels, as norms at the tool.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Felt {
    /// Force now (N).
    pub force: f64,
    /// Torque now (Nm).
    pub torque: f64,
    /// Largest force since the start (N).
    pub peak_force: f64,
    /// Largest torque since the start (Nm).
    pub peak_torque: f64,
}

/// What a kernel believes of the cube, and what it is about to do.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Picture {
    /// Where the effectors' bases are believed to be, where that has been learnt.
    pub world_from_base: [Option<Pose>; 2],
    /// The cube in each hand that holds it.
    pub tool_from_cube: [Option<Pose>; 2],
    /// The operator has been given the cube back.
    pub handed_back: bool,
    /// How the cube looks, as far as it has been read and turned.
    pub facelets: Option<Facelets>,
    /// The layer that is being turned.
    pub turning: Option<Turning>,
    /// The cube as it was read.
    pub net: Net,
    /// The plan.
    pub plan: Arc<Vec<PlanLine>>,
    /// The plan's step that is being carried out.
    pub step: Option<usize>,
}

/// A layer that goes along with a hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turning {
    /// The effector that turns it.
    pub effector: usize,
    /// The layer's face.
    pub face: Face,
    /// How the tool stood to the cube when the layer was straight.
    pub cube_from_tool: UnitQuaternion<f64>,
}

/// How a camera in a hand looks at one face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Where the face is expected: origin in its centre, x along columns, y along rows of reading order.
    pub camera_from_face: Pose,
    /// Exposure, as a multiple of the camera's nominal one.
    pub exposure: f64,
}

/// How much work a thought was, for the virtual clock (s); declared by the kernel, never measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort(pub f64);

/// What a kernel asks its shell to do.
#[derive(Debug, Clone, PartialEq)]
pub enum Action<T> {
    /// A new phase of the task begins; nothing moves for it.
    Phase(&'static str),
    /// Effectors carry out behaviours, starting together.
    Behave {
        /// One entry an effector; `None` leaves it as it is.
        orders: [Option<Behaviour>; 2],
        /// Whose end ends the step; the other is then ended from above.
        until: Until,
    },
    /// The force sensors of these effectors are set to zero where they are.
    Bias([bool; 2]),
    /// The stand-alone camera's sensor begins or ends to watch for the cube.
    Watch(bool),
    /// The camera in an effector's hand looks at one face.
    Look {
        /// Effector that owns the camera.
        effector: usize,
        /// How.
        view: View,
    },
    /// Long work.
    Think(T),
    /// The operator is asked something.
    Ask(Question),
    /// The operator's next order to an arm is waited for, while all arms hold their places.
    Await,
    /// An order of the operator that no behaviour carries out: motors, synchronising.
    Manual {
        /// To whom.
        effector: usize,
        /// What.
        order: Manual,
    },
    /// The task is over.
    Finish(Finish),
    /// The kernel waits for something that it never asked for, a defect of the task.
    Defect(String),
}

/// Which effectors must come to the end of their behaviours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Until {
    /// All that have an order.
    All,
    /// This one.
    Effector(usize),
}

/// What the shell tells its kernel.
#[derive(Debug)]
pub enum Event<C> {
    /// The run begins.
    Start,
    /// The last action needs no answer, and is carried out.
    Done,
    /// Behaviours ended.
    Behaved([Option<Outcome>; 2]),
    /// A face was read, or why not.
    Looked(Result<FaceReading, String>),
    /// The long work is done.
    Thought(C),
    /// The operator has answered; `None` when no answer came in time.
    Answered(Option<Answer>),
    /// The operator wants this of an effector.
    Ordered(usize, Manual),
    /// An effector or sensor could not do what was asked; the text says which and why.
    Trouble(String),
}

/// The end of a task, as the controller sees it. Whether the cube is solved is for the plant to say.
#[derive(Debug, Clone, PartialEq)]
pub struct Finish {
    /// The controller believes that it did what was asked.
    pub achieved: bool,
    /// In words.
    pub reason: String,
}
