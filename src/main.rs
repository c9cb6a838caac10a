//! The program `rubik-robot`; `rubik-robot --help` describes its commands.

use std::process::ExitCode;

fn main() -> ExitCode {
    rubik_robot::App::new().main()
}
