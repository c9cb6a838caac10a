//! `rubik-robot`: see `rubik-robot --help`.

use std::process::ExitCode;

fn main() -> ExitCode {
    rubik_robot::cli::main()
}
