//! Messages between MP's node and another node.
//!
//! Actors are named by their indices in the scenario, which both nodes have read.

use super::line::Carried;
use crate::actors::control::Control;
use crate::actors::ecp::Report;
use crate::actors::latest::Found;
use crate::actors::move_instruction::Ending;
use crate::error::Error;
use crate::generators::{Behaviour, Outcome, Sensing, Target};
use crate::kernel::{Adjustment, Programme, Signal, View};
use crate::motion::ArmState;
use crate::net::Lane;
use crate::operator::Class;
use crate::operator::parameter::Courses;
use crate::vision::sensor::FaceReading;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::fmt;

/// Facts by which two nodes see that they belong together.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Introduction {
    /// Number of the run, drawn by MP's node.
    pub(crate) run: u64,
    /// Name, version and tasks of the program.
    pub(crate) program: String,
    /// Checksum of the scenario as it was read, with its overrides.
    pub(crate) scenario: u64,
}

/// Message to a node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum ToNode {
    /// Asks the node to take part in a run. It is repeated until the node answers.
    Join(Introduction),
    /// Asks an actor, which answers under the same number.
    Ask {
        /// Number of the request.
        number: u64,
        /// The request.
        ask: Ask,
    },
    /// Tells an actor something that has no answer.
    Tell(Tell),
    /// Ends the node's part of the run.
    Leave,
    /// Sign of life of MP's node.
    Beat(HomeBeat),
    /// State of an arm on another node.
    State(usize, ArmState),
}

/// Request to an actor of a node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum Ask {
    /// To the ECP of an effector.
    Ecp(usize, EcpAsk),
    /// To the EDP of an effector.
    Edp(usize, EdpAsk),
    /// To the VSP with an index: reads a face.
    Look(usize, View),
}

/// Request to an ECP.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum EcpAsk {
    /// Carries out a behaviour, which begins in a period of MP's node or later.
    Behave(Behaviour, u64),
    /// Sets the force sensor to zero.
    Bias,
    /// Homes the arm.
    Synchronise,
    /// Adjusts the arm at rest.
    Adjust(Adjustment),
    /// Returns the state of the arm.
    State,
    /// Reads a face by the camera in the hand.
    Look(View),
    /// Begins a programme.
    Start(Programme),
}

/// Request to an EDP, whose ECP is on the same node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum EdpAsk {
    /// Homes the arm.
    Synchronise,
    /// Returns the state of the arm.
    State,
}

/// Message to an actor of a node, without an answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum Tell {
    /// Ends the behaviour of an ECP.
    End(usize, Ending),
    /// Switches the tracking by an ECP's camera.
    Watch(usize, bool),
    /// Signal to the programme of an ECP.
    Signal(usize, Signal),
    /// Switches the tracking of a VSP.
    Track(usize, bool),
    /// Sets how a VSP looks for the cube.
    Sense(usize, Sensing),
    /// The operator's control of the run.
    Control(Control),
    /// The operator's parameters, in periods of MP's node.
    Parameters(Courses),
}

/// Sign of life of MP's node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct HomeBeat {
    /// Number of the beat.
    pub(crate) number: u64,
    /// Period of MP's node at the sending; `None` before its servos run.
    pub(crate) period: Option<u64>,
    /// Number of the node's last beat, and the time since its arrival (us).
    pub(crate) echo: Option<(u64, u64)>,
    /// Whether the emergency stop is pressed.
    pub(crate) pressed: bool,
    /// Whether the arms of the node are to stand by.
    pub(crate) stands_by: bool,
    /// Whether someone watches the run, or records it: pictures are wanted.
    pub(crate) watched: bool,
}

/// Message to MP's node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum ToHome {
    /// Answer to a [`ToNode::Join`]: whether each effector of the node is synchronised.
    Joined {
        /// Number of the run.
        run: u64,
        /// Index of an effector, and whether its arm is synchronised.
        arms: Vec<(usize, bool)>,
    },
    /// Answer to a [`ToNode::Join`]: the reason why the node does not take part.
    Refused {
        /// Number of the run.
        run: u64,
        /// Reason.
        why: String,
    },
    /// Answer of an actor.
    Answer {
        /// Number of the request.
        number: u64,
        /// The answer.
        answer: Answer,
    },
    /// Message of the programme of an effector to MP.
    Report(usize, Report),
    /// System error of the node.
    Failed(Error),
    /// End of the node's part of the run: its drives are off.
    Ended,
    /// Sign of life of the node.
    Beat(NodeBeat),
    /// State of an arm of the node.
    State(usize, ArmState),
    /// Pose of the cube by the VSP with an index.
    Target(usize, Option<Target>),
    /// Message of an actor to the operator.
    Notice {
        /// Class.
        class: Class,
        /// Name of the actor.
        who: String,
        /// Text.
        text: String,
    },
    /// Picture of a camera.
    Picture(Shown),
}

/// Answer of an actor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum Answer {
    /// State of the arm.
    State(Result<ArmState, Error>),
    /// Outcome of a behaviour, and state of the arm at its end.
    Behaved(Result<(Outcome, ArmState), Error>),
    /// Face of the cube.
    Face(Result<FaceReading, Error>),
    /// Beginning of a programme.
    Begun(Result<(), Error>),
}

/// Picture of a camera of a node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Shown {
    /// Index of the camera.
    pub(super) camera: usize,
    /// Period of the exposure, of MP's node.
    pub(super) period: u64,
    /// Result of vision.
    pub(super) found: Found,
    /// The picture.
    pub(super) file: JpegFile,
}

/// File of a picture.
#[derive(Clone, PartialEq)]
pub(super) struct JpegFile(pub(super) Vec<u8>);

impl fmt::Debug for JpegFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} bytes", self.0.len())
    }
}

impl Serialize for JpegFile {
    /// Writes the bytes at once: as a list of numbers they would take half as much again.
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_bytes(&self.0)
    }
}

impl<'de> Deserialize<'de> for JpegFile {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Bytes;
        impl de::Visitor<'_> for Bytes {
            type Value = JpegFile;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the bytes of a picture")
            }
            fn visit_bytes<E: de::Error>(self, bytes: &[u8]) -> Result<JpegFile, E> {
                Ok(JpegFile(bytes.to_vec()))
            }
        }
        from.deserialize_bytes(Bytes)
    }
}

/// Sign of life of a node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct NodeBeat {
    /// Number of the beat.
    pub(crate) number: u64,
    /// Number of the last beat of MP's node, and the time since its arrival (us).
    pub(crate) echo: Option<(u64, u64)>,
    /// Whether the node knows the difference of the periods.
    pub(crate) mapped: bool,
    /// Signs of life of the ECP of each effector of the node.
    pub(crate) alive: Vec<(usize, u64)>,
    /// Whether a fault has stopped an arm of the node.
    pub(crate) stopped: bool,
    /// Whether the emergency stop is pressed.
    pub(crate) pressed: bool,
}

impl Carried for ToNode {
    fn lane(&self) -> Lane {
        match self {
            Self::Ask { .. } | Self::Tell(_) | Self::Leave => Lane::Messages,
            Self::Join(_) | Self::Beat(_) | Self::State(..) => Lane::Values,
        }
    }

    fn joins(&self) -> bool {
        matches!(self, Self::Join(_))
    }
}

impl Carried for ToHome {
    fn lane(&self) -> Lane {
        match self {
            Self::Answer { .. }
            | Self::Report(..)
            | Self::Failed(_)
            | Self::Ended
            | Self::Notice { .. } => Lane::Messages,
            Self::Picture(_) => Lane::Pictures,
            Self::Joined { .. }
            | Self::Refused { .. }
            | Self::Beat(_)
            | Self::State(..)
            | Self::Target(..) => Lane::Values,
        }
    }

    fn joins(&self) -> bool {
        matches!(self, Self::Joined { .. } | Self::Refused { .. })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::{Fatal, NonFatal};
    use crate::motion::ArmFault;
    use crate::net::pair;

    /// A message arrives as it was sent, also numbers that JSON has no form for.
    #[tokio::test]
    async fn messages_arrive_to_the_bit() {
        let [(there, _), (_, parcels)] = pair();
        let sender = super::super::Sender::new(there, 5);
        let mut receiver = super::super::Receiver::new(parcels).of_run(5);
        let mut state = ArmState { period: 77, ..ArmState::default() };
        state.wrench_in_tool.force.x = f64::INFINITY;
        state.jaw_opening = 0.1 + 0.2;
        state.fault = Some(ArmFault::EncoderJump { axis: 3, by: 3.0 });
        let error = Error::Fatal {
            actor: "edp track".into(),
            place: "execute".into(),
            cause: Fatal::Arm(ArmFault::EmergencyStop),
            last: Some(Box::new(state)),
        };
        let signal = serde_json::json!({"name": "x", "value": {"a": [1, null, -2.5]}});
        let signal: Signal = serde_json::from_value(signal).unwrap();
        let refused = Error::NonFatal {
            actor: "vsp gs2".into(),
            place: "look".into(),
            cause: NonFatal::NoReading("dark".into()),
        };
        let report =
            Report { message: crate::kernel::Message::Signal { effector: 1, signal }, tool: None };
        let sent = [
            ToHome::State(1, state),
            ToHome::Answer { number: 3, answer: Answer::State(Err(error)) },
            ToHome::Answer { number: 4, answer: Answer::Face(Err(refused)) },
            ToHome::Report(1, report),
        ];

        for message in &sent {
            sender.send(message);
        }

        for message in sent {
            assert_eq!(receiver.recv().await, Some(Ok(message)));
        }
    }
}
