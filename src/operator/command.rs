//! What the operator may want of a run, and what the controller may ask.

use crate::cube::Facelets;
use serde::{Deserialize, Serialize};

/// A word from the operator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "command", rename_all = "snake_case")]
pub enum Command {
    /// Begins a run that waits for it.
    Start,
    /// Brings all motions to rest within a macrostep's notice; nothing is forgotten.
    Pause,
    /// Goes on from a pause.
    Resume,
    /// Ends the run: the arms come to rest and hold what they hold.
    Terminate,
    /// All arms trip in the next servo period. A software stop, hence no safety function.
    EmergencyStop,
    /// Answers the open question.
    Answer {
        /// [`Question::number`].
        question: u64,
        /// What.
        answer: Answer,
    },
    /// Moves an arm by hand; only while the task is idle.
    Manual {
        /// Index of the effector.
        effector: usize,
        /// How.
        order: Manual,
    },
    /// Limits how fast simulated time may go, in times of real time; 0 for as fast as it computes.
    Speed {
        /// Times real time.
        factor: f64,
    },
    /// Leaves the face of a run that is over, or of a replay.
    Quit,
    /// In a replay: goes to this time [s].
    Seek {
        /// Seconds since the beginning.
        time: f64,
    },
}

impl Command {
    /// Its name, for logs.
    #[must_use]
    pub fn word(&self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Pause => "pause",
            Self::Resume => "resume",
            Self::Terminate => "terminate",
            Self::EmergencyStop => "emergency stop",
            Self::Answer { .. } => "answer",
            Self::Manual { .. } => "manual",
            Self::Speed { .. } => "speed",
            Self::Quit => "quit",
            Self::Seek { .. } => "seek",
        }
    }
}

impl Command {
    /// The command with its arguments, for people.
    #[must_use]
    pub fn words(&self) -> String {
        match self {
            Self::Speed { factor } if *factor > 0.0 => format!("speed {factor} x"),
            Self::Speed { .. } => "speed unlimited".to_owned(),
            Self::Answer { answer: Answer::Declined, .. } => "does not know the answer".to_owned(),
            Self::Answer { answer: Answer::Choice { option }, .. } => {
                format!("answer {}", option.saturating_add(1))
            }
            Self::Answer { answer: Answer::Stickers { stickers }, .. } => {
                format!("the stickers are {stickers}")
            }
            Self::Manual { effector, order } => format!("arm {effector}: {}", order.words()),
            other => other.word().to_owned(),
        }
    }
}

/// What the operator said that counts for the run, as a recording has it: an input of the controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Said {
    /// Begin.
    Start,
    /// Go on.
    Run,
    /// Hold.
    Pause,
    /// End.
    Terminate,
    /// All arms trip.
    EmergencyStop,
    /// An answer.
    Answer {
        /// [`Question::number`].
        question: u64,
        /// What.
        answer: Answer,
    },
    /// An order to an arm.
    Order {
        /// Index of the effector.
        effector: usize,
        /// How.
        order: Manual,
    },
}

impl Said {
    /// For people.
    #[must_use]
    pub fn words(&self) -> String {
        let command = match self.clone() {
            Self::Start => Command::Start,
            Self::Run => Command::Resume,
            Self::Pause => Command::Pause,
            Self::Terminate => Command::Terminate,
            Self::EmergencyStop => Command::EmergencyStop,
            Self::Answer { question, answer } => Command::Answer { question, answer },
            Self::Order { effector, order } => Command::Manual { effector, order },
        };
        command.words()
    }

    /// The words of a recorded text; the text itself where it is of another version.
    #[must_use]
    pub fn told(text: &str) -> String {
        serde_json::from_str::<Self>(text).map_or_else(|_| text.to_owned(), |said| said.words())
    }
}

impl Manual {
    fn words(&self) -> String {
        let turn = |angle: f64| format!("{:+.1} deg", angle.to_degrees());
        let way = |length: f64| format!("{:+.1} mm", length * 1e3);
        match self {
            Self::Synchronise => "synchronise".to_owned(),
            Self::Motor(Step { axis, by }) => format!("motor {axis} by {by:+.1} rad"),
            Self::Joint(Step { axis: 0, by }) => format!("track by {}", way(*by)),
            Self::Joint(Step { axis, by }) => format!("joint {axis} by {}", turn(*by)),
            Self::Tool(Step { axis, by }) if *axis < 3 => {
                format!("along the tool's {} by {}", ["x", "y", "z"][*axis], way(*by))
            }
            Self::Tool(Step { axis, by }) => {
                format!("about the tool's {} by {}", ["x", "y", "z"][*axis % 3], turn(*by))
            }
            Self::Jaw { opening } => format!("jaws to {:.1} mm", opening * 1e3),
            Self::Pose { name } => format!("go to {name}"),
            Self::Bias => "zero the force sensor".to_owned(),
        }
    }
}

/// An order of the operator to one arm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "order", rename_all = "snake_case")]
pub enum Manual {
    /// Finds the synchronisation position, axis by axis.
    Synchronise,
    /// Moves one motor by an angle [rad]; the one motion of an arm that is not synchronised.
    Motor(Step),
    /// Moves one joint: axis 0 by a length [m], 1..=6 by an angle [rad].
    Joint(Step),
    /// Moves along (0, 1, 2) or about (3, 4, 5) an axis of the tool [m, rad].
    Tool(Step),
    /// Brings the pads to this distance [m].
    Jaw {
        /// Distance between the pads.
        opening: f64,
    },
    /// Goes to one of [`ArmStage::poses`](super::ArmStage::poses).
    Pose {
        /// Its name.
        name: String,
    },
    /// Sets the force sensor to zero as it is loaded now.
    Bias,
}

/// One axis, and how far.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Which.
    pub axis: usize,
    /// By how much.
    pub by: f64,
}

/// What the controller wants to know. It goes on by itself when no answer comes in time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Question {
    /// Which question of this run, from 1.
    pub number: u64,
    /// For people.
    pub text: String,
    /// What happens without an answer.
    pub otherwise: String,
    /// Time for an answer [s].
    pub seconds: f64,
    /// Time of the run at which that is over [s]; set by whoever asks it, 0 before.
    #[serde(default)]
    pub until: f64,
    /// What kind of answer is wanted.
    pub subject: Subject,
}

/// The kinds of questions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "subject", rename_all = "snake_case")]
pub enum Subject {
    /// One of some possibilities.
    Choice {
        /// The possibilities.
        options: Vec<String>,
    },
    /// The colours of the cube's stickers, as far as they were read.
    Stickers {
        /// As read: 54 letters in the order URFDLB, `-` where nothing was read; colours are those of [`Facelets`].
        read: String,
        /// Facelets that the controller is not sure of.
        doubtful: Vec<usize>,
    },
}

/// An answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "answer", rename_all = "snake_case")]
pub enum Answer {
    /// Index of the possibility.
    Choice {
        /// From 0.
        option: usize,
    },
    /// All stickers.
    Stickers {
        /// As they are.
        stickers: Facelets,
    },
    /// The operator does not know.
    Declined,
}

impl Answer {
    /// Whether it answers such a question.
    #[must_use]
    pub fn fits(&self, subject: &Subject) -> bool {
        match (self, subject) {
            (Self::Declined, _) | (Self::Stickers { .. }, Subject::Stickers { .. }) => true,
            (Self::Choice { option }, Subject::Choice { options }) => *option < options.len(),
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_read_as_a_page_writes_them() {
        let read = |text: &str| serde_json::from_str::<Command>(text);

        assert_eq!(read(r#"{"command":"pause"}"#).unwrap(), Command::Pause);
        let jog =
            r#"{"command":"manual","effector":1,"order":{"order":"joint","axis":2,"by":0.1}}"#;
        let order = Manual::Joint(Step { axis: 2, by: 0.1 });
        assert_eq!(read(jog).unwrap(), Command::Manual { effector: 1, order });
        assert!(read(r#"{"command":"format_disk"}"#).is_err());
        assert!(
            read(
                r#"{"command":"answer","question":1,"answer":{"answer":"stickers","stickers":"U"}}"#
            )
            .is_err()
        );
    }

    #[test]
    fn what_was_said_is_told_in_words() {
        for (text, words) in [
            (r#""pause""#, "pause"),
            (r#""start""#, "start"),
            (r#""run""#, "resume"),
            (
                r#"{"order":{"effector":0,"order":{"order":"pose","name":"front"}}}"#,
                "arm 0: go to front",
            ),
            (
                r#"{"answer":{"question":1,"answer":{"answer":"declined"}}}"#,
                "does not know the answer",
            ),
            ("of another version", "of another version"),
        ] {
            assert_eq!(Said::told(text), words);
        }
    }

    #[test]
    fn an_answer_must_fit_its_question() {
        let choice = Subject::Choice { options: vec!["yes".into(), "no".into()] };

        assert!(Answer::Choice { option: 1 }.fits(&choice));
        assert!(!Answer::Choice { option: 2 }.fits(&choice));
        assert!(!Answer::Stickers { stickers: Facelets::solved() }.fits(&choice));
        assert!(Answer::Declined.fits(&choice));
    }
}
