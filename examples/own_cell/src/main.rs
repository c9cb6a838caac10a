//! A controller of a user's own: the whole program `rubik-robot` and one more task, `wave`.
//!
//! ```sh
//! cargo run --release -p own_cell -- run examples/own_cell/wave.toml
//! ```

mod wave;

use rubik_robot::App;
use std::process::ExitCode;

fn main() -> ExitCode {
    App::new()
        .task::<wave::Wave>("wave")
        .verdict::<wave::BackAgain>()
        .programme::<wave::WaveAlone>("wave_alone")
        .main()
}
