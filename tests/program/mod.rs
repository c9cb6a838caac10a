//! The command of the program that the tests run.

use std::process::{Command, Stdio};

/// Returns the program's command, in the project's folder and with an empty stdin.
pub(crate) fn program() -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_rubik-robot"));
    program.current_dir(env!("CARGO_MANIFEST_DIR")).stdin(Stdio::null());
    // Recordings of last seconds, and runs with a page, do not go to the user's folder.
    program.env("XDG_STATE_HOME", env!("CARGO_TARGET_TMPDIR"));
    program
}
