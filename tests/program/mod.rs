//! The program, as a person starts it.

use std::process::{Command, Stdio};

/// In the project's folder, with nothing to be read at its input.
pub(crate) fn program() -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_rubik-robot"));
    program.current_dir(env!("CARGO_MANIFEST_DIR")).stdin(Stdio::null());
    program
}
