//! A controller of a user's own: the whole program `rubik-robot` with a task,
//! a programme, a generator and a sensor of his own.
//!
//! ```sh
//! cargo run --release -p own_cell -- run examples/own_cell/wave.toml
//! ```

mod gap;
mod nod;
mod wave;

use rubik_robot::App;
use std::process::ExitCode;

fn main() -> ExitCode {
    App::new()
        .named(env!("CARGO_PKG_NAME"), env!("CARGO_PKG_VERSION"))
        .task::<wave::Wave>("wave")
        .verdict::<wave::BackAgain>()
        .programme::<wave::WaveAlone>("wave_alone")
        .generator::<nod::Nod>("nod")
        .sensor::<gap::Gap>("gap")
        .simulated::<gap::GapModel>()
        .main()
}
