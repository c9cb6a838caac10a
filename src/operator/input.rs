//! Inputs of the operator to a run.
//!
//! The page, the terminal, the keys on stdin, the recording, and the actor that obeys the inputs
//! share one type.

use super::{Answer, Parameter};
use serde::{Deserialize, Serialize};

/// An input of the operator.
///
/// Its JSON form is that of a recording: the name alone, or the name with the arguments, as in
/// `{"seek":{"time":1.0}}`. A page writes `{"command":"seek","time":1.0}` instead; where its name
/// of an input differs from that in a recording, the page's name is the `alias`.
///
/// ```
/// use rubik_robot::operator::Input;
///
/// let seek: Input = serde_json::from_str(r#"{"seek":{"time":1.5}}"#)?;
/// assert_eq!(seek, Input::Seek { time: 1.5 });
/// assert_eq!(serde_json::to_string(&Input::EmergencyStop)?, r#""emergency_stop""#);
/// // A pause moves no arm; the end of the pause does.
/// assert!(!Input::Pause.moves() && Input::Resume.moves());
/// # Ok::<(), serde_json::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Input {
    /// Starts a run that waits for its start.
    Start,
    /// Brings all motions to rest along their paths; the task keeps its place.
    Pause,
    /// Continues after a pause.
    #[serde(rename = "run", alias = "resume")]
    Resume,
    /// Ends the run: the arms come to rest and keep what they hold.
    Terminate,
    /// Trips all arms in the next servo period. It is a software stop, hence no safety function.
    EmergencyStop,
    /// Answers the open question.
    Answer {
        /// Number of the question: [`Question::number`](super::Question::number).
        question: u64,
        /// The answer itself.
        answer: Answer,
    },
    /// Moves an arm by hand. It is allowed only while the task is idle.
    #[serde(rename = "order", alias = "manual")]
    Manual {
        /// Index of the effector.
        effector: usize,
        /// The motion or other action.
        order: Manual,
    },
    /// Limits the speed of simulated time.
    Speed {
        /// Limit as a multiple of real time; 0 for no limit.
        factor: f64,
    },
    /// Orders a value of a parameter, toward which the parameter moves with its bounded rate.
    Parameter {
        /// The parameter.
        parameter: Parameter,
        /// Ordered value, in the unit of the parameter.
        value: f64,
    },
    /// Leaves the UI of a run that is over, or of a replay.
    Quit,
    /// Runs the scenario of a run that is over again.
    Again {
        /// Seed of the plant.
        seed: u64,
    },
    /// Continues a run that is over from its journal.
    GoOn,
    /// Shows the recording of a run that is over.
    Replay,
    /// Writes a report of a run that is over.
    Report,
    /// Jumps to a time of a replay.
    Seek {
        /// Time since the beginning (s).
        time: f64,
    },
}

impl Input {
    /// Returns the name of the input, for logs.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Pause => "pause",
            Self::Resume => "resume",
            Self::Terminate => "terminate",
            Self::EmergencyStop => "emergency stop",
            Self::Answer { .. } => "answer",
            Self::Manual { .. } => "manual",
            Self::Speed { .. } => "speed",
            Self::Parameter { .. } => "parameter",
            Self::Quit => "quit",
            Self::Again { .. } => "again",
            Self::GoOn => "go on",
            Self::Replay => "replay",
            Self::Report => "report",
            Self::Seek { .. } => "seek",
        }
    }

    /// Checks whether the input lets an arm begin to move.
    #[must_use]
    pub fn moves(&self) -> bool {
        matches!(self, Self::Start | Self::Resume | Self::Manual { .. })
    }

    /// Returns the name of the input with its arguments, for people.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::Speed { factor } if *factor > 0.0 => format!("speed {factor} x"),
            Self::Speed { .. } => "speed unlimited".to_owned(),
            Self::Answer { answer: Answer::Declined, .. } => "does not know the answer".to_owned(),
            // People count from 1. A recorded number may be any, so the addition saturates.
            Self::Answer { answer: Answer::Choice { option }, .. } => {
                format!("answer {}", option.saturating_add(1))
            }
            Self::Answer { answer: Answer::Stickers { stickers }, .. } => {
                format!("the stickers are {stickers}")
            }
            Self::Parameter { parameter, value } => {
                format!("parameter {} to {value}", parameter.declaration().name)
            }
            Self::Manual { effector, order } => format!("arm {effector}: {}", order.describe()),
            other => other.name().to_owned(),
        }
    }

    /// Describes an input that a recording holds as JSON; returns `text` itself if it is no input
    /// of this version of the program.
    #[must_use]
    pub fn describe_recorded(text: &str) -> String {
        serde_json::from_str::<Self>(text).map_or_else(|_| text.to_owned(), |i| i.describe())
    }
}

/// An order of the operator to one arm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "order", rename_all = "snake_case")]
pub enum Manual {
    /// Finds the synchronisation position of each axis, one after the other.
    Synchronise,
    /// Moves one motor by an angle (rad). It is the only motion of an arm that is not synchronised.
    Motor(Step),
    /// Moves one joint: axis 0 by a length (m), 1..=6 by an angle (rad).
    Joint(Step),
    /// Moves along (0, 1, 2: m) or about (3, 4, 5: rad) an axis of the tool.
    Tool(Step),
    /// Moves the tool along or about an axis as [`Self::Tool`] does, but one of the arm's base.
    Base(Step),
    /// Moves the tool along or about an axis as [`Self::Tool`] does, but one of the world.
    World(Step),
    /// Moves the pads of the jaws to a distance from each other.
    Jaw {
        /// Distance between the pads (m).
        opening: f64,
    },
    /// Moves the arm to one of [`ArmStage::poses`](super::ArmStage::poses).
    Pose {
        /// Name of the pose.
        name: String,
    },
    /// Zeroes the force sensor under its present load.
    Bias,
}

impl Manual {
    /// Returns the order with its arguments, for people.
    fn describe(&self) -> String {
        // People read millimetres and degrees; the input itself is in SI units.
        let degrees = |angle: f64| format!("{:+.1} deg", angle.to_degrees());
        let millimetres = |length: f64| format!("{:+.1} mm", length * 1e3);
        let cartesian = |frame: &str, Step { axis, by }: Step| {
            let name = ["x", "y", "z"][axis % 3];
            match axis {
                0..3 => format!("along the {frame}'s {name} by {}", millimetres(by)),
                _ => format!("about the {frame}'s {name} by {}", degrees(by)),
            }
        };
        match self {
            Self::Synchronise => "synchronise".to_owned(),
            Self::Motor(Step { axis, by }) => format!("motor {axis} by {by:+.1} rad"),
            // Axis 0 is the track, which moves by a length.
            Self::Joint(Step { axis: 0, by }) => format!("track by {}", millimetres(*by)),
            Self::Joint(Step { axis, by }) => format!("joint {axis} by {}", degrees(*by)),
            Self::Tool(step) => cartesian("tool", *step),
            Self::Base(step) => cartesian("base", *step),
            Self::World(step) => cartesian("world", *step),
            Self::Jaw { opening } => format!("jaws to {:.1} mm", opening * 1e3),
            Self::Pose { name } => format!("go to {name}"),
            Self::Bias => "zero the force sensor".to_owned(),
        }
    }
}

/// Motion of one axis by a length or an angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Index of the axis.
    pub axis: usize,
    /// Length (m) or angle (rad).
    pub by: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_names_of_operator_inputs_are_fixed() {
        for (text, description) in [
            (r#""pause""#, "pause"),
            (r#""start""#, "start"),
            (r#""run""#, "resume"),
            (r#""terminate""#, "terminate"),
            (r#""emergency_stop""#, "emergency stop"),
            (r#""quit""#, "quit"),
            (r#"{"speed":{"factor":0.5}}"#, "speed 0.5 x"),
            (r#"{"speed":{"factor":0.0}}"#, "speed unlimited"),
            (r#"{"seek":{"time":1.5}}"#, "seek"),
            (r#"{"again":{"seed":7}}"#, "again"),
            (r#""go_on""#, "go on"),
            (r#""replay""#, "replay"),
            (r#""report""#, "report"),
            (r#"{"parameter":{"parameter":"grip_n","value":45.5}}"#, "parameter grip_n to 45.5"),
            (
                r#"{"answer":{"question":1,"answer":{"answer":"declined"}}}"#,
                "does not know the answer",
            ),
            (r#"{"answer":{"question":1,"answer":{"answer":"choice","option":1}}}"#, "answer 2"),
        ] {
            let input: Input = serde_json::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&input).unwrap(), text);
            assert_eq!(Input::describe_recorded(text), description);
        }
        assert_eq!(Input::describe_recorded("of another version"), "of another version");
    }

    #[test]
    fn json_names_of_manual_orders_are_fixed() {
        for (order, description) in [
            (r#""synchronise""#, "synchronise"),
            (r#""motor","axis":4,"by":-0.5"#, "motor 4 by -0.5 rad"),
            (r#""joint","axis":0,"by":0.002"#, "track by +2.0 mm"),
            (r#""joint","axis":2,"by":0.25"#, "joint 2 by +14.3 deg"),
            (r#""tool","axis":2,"by":-0.01"#, "along the tool's z by -10.0 mm"),
            (r#""tool","axis":3,"by":0.25"#, "about the tool's x by +14.3 deg"),
            (r#""base","axis":0,"by":0.01"#, "along the base's x by +10.0 mm"),
            (r#""world","axis":5,"by":-0.25"#, "about the world's z by -14.3 deg"),
            (r#""jaw","opening":0.08"#, "jaws to 80.0 mm"),
            (r#""pose","name":"front""#, "go to front"),
            (r#""bias""#, "zero the force sensor"),
        ] {
            let text = format!(r#"{{"order":{{"effector":1,"order":{{"order":{order}}}}}}}"#);
            let input: Input = serde_json::from_str(&text).unwrap();
            assert_eq!(serde_json::to_string(&input).unwrap(), text);
            assert_eq!(Input::describe_recorded(&text), format!("arm 1: {description}"));
        }
    }
}
