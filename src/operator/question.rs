//! Questions of the controller to the operator, and the operator's answers.

use crate::cube::Facelets;
use serde::{Deserialize, Serialize};

/// A question of the controller. The task continues by itself if no answer comes in time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Question {
    /// Number of the question in this run, from 1.
    pub number: u64,
    /// Text of the question, for people.
    pub text: String,
    /// Description of the task's action if no answer comes, for people.
    pub otherwise: String,
    /// Time for an answer (s).
    pub seconds: f64,
    /// Time of the run at which the question closes (s). MP sets it when it asks; it is 0 before.
    #[serde(default)]
    pub until: f64,
    /// Kind of answer that is expected.
    pub subject: Subject,
}

/// Kind of a question.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "subject", rename_all = "snake_case")]
pub enum Subject {
    /// A choice between some possibilities.
    Choice {
        /// The possibilities.
        options: Vec<String>,
    },
    /// The colours of the cube's stickers.
    Stickers {
        /// Stickers as they were read: 54 letters in the order URFDLB, `-` where none was read. The
        /// letters are those of [`Facelets`].
        read: String,
        /// Facelets that the controller doubts, by their index.
        doubtful: Vec<usize>,
    },
}

/// An answer to a [`Question`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "answer", rename_all = "snake_case")]
pub enum Answer {
    /// Choice of a possibility.
    Choice {
        /// Index of the possibility, from 0.
        option: usize,
    },
    /// All stickers.
    Stickers {
        /// The stickers as the operator sees them.
        stickers: Facelets,
    },
    /// The operator does not know.
    Declined,
}

impl Answer {
    /// Checks whether the answer fits a question of this subject.
    #[must_use]
    pub fn fits(&self, subject: &Subject) -> bool {
        match (self, subject) {
            // An operator may decline any question. Stickers were checked when they were parsed.
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
    fn answers_must_fit_their_question() {
        let choice = Subject::Choice { options: vec!["yes".into(), "no".into()] };

        let stickers = Subject::Stickers { read: "-".repeat(54), doubtful: vec![] };
        let all = Answer::Stickers { stickers: Facelets::solved() };

        assert!(Answer::Choice { option: 1 }.fits(&choice));
        assert!(!Answer::Choice { option: 2 }.fits(&choice) && !all.fits(&choice));
        assert!(all.fits(&stickers) && !Answer::Choice { option: 0 }.fits(&stickers));
        assert!(Answer::Declined.fits(&choice) && Answer::Declined.fits(&stickers));
    }
}
