//! The program that makes a recording, a journal or a campaign's state, and the tasks that it has.
//!
//! A program of a user's own has another name and other tasks than this crate's. A file of another
//! program, or of a task that this one does not have, is refused by name. A file from before these
//! facts has no maker, and is read if its task is known.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Name, version and tasks of a program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Maker {
    /// Name of the program.
    pub program: String,
    /// Version of the program; that of a user's own differs from that of this crate.
    pub version: String,
    /// Names of its tasks, in the order of their declaration.
    pub tasks: Vec<String>,
}

impl Default for Maker {
    /// Returns the program of this crate, without tasks.
    fn default() -> Self {
        Self {
            program: "rubik-robot".to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            tasks: Vec::new(),
        }
    }
}

impl fmt::Display for Maker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.program, self.version)
    }
}

impl Maker {
    /// Checks that this program can use a file that `maker` made in a run of `task`. `maker` is
    /// `None` for a file that does not name one; `task` is empty if the file names none.
    ///
    /// # Errors
    /// The reason, with the names of both programs and of the task.
    pub fn accepts(&self, maker: Option<&Self>, task: &str) -> Result<(), String> {
        let by =
            maker.map_or_else(|| "recorded".to_owned(), |maker| format!("recorded by {maker}"));
        if !task.is_empty() && !self.tasks.iter().any(|known| known == task) {
            return Err(format!("{by} with task `{task}`, which this program does not have"));
        }
        match maker {
            Some(maker) if maker.program != self.program => {
                Err(format!("{by}, which is another program than this {self}"))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a program with these tasks.
    fn maker(program: &str, tasks: &[&str]) -> Maker {
        let tasks = tasks.iter().map(|&task| task.to_owned()).collect();
        Maker { program: program.to_owned(), version: "0.1.0".to_owned(), tasks }
    }

    #[test]
    fn file_of_other_program_is_refused_by_name() {
        let own = maker("rubik-robot", &["solve", "idle"]);
        let other = maker("own_cell", &["solve", "idle", "wave"]);

        assert_eq!(own.accepts(Some(&own), "solve"), Ok(()));
        assert_eq!(own.accepts(None, "solve"), Ok(()), "an old file");
        assert_eq!(
            own.accepts(Some(&other), "wave").unwrap_err(),
            "recorded by own_cell 0.1.0 with task `wave`, which this program does not have"
        );
        assert_eq!(
            own.accepts(Some(&other), "solve").unwrap_err(),
            "recorded by own_cell 0.1.0, which is another program than this rubik-robot 0.1.0"
        );
        assert_eq!(
            own.accepts(None, "wave").unwrap_err(),
            "recorded with task `wave`, which this program does not have"
        );
    }
}
