//! One servo period as pure functions: readings and a command in, drives and a state out.

pub mod io;
