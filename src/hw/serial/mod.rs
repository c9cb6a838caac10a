//! Arms behind serial axis controllers, with one line per axis and an exchange on all lines in each
//! servo period.
//!
//! - [`frame`]: orders and answers as bytes
//! - [`axis`]: the order for an axis, and the judgement of its answers
//! - [`line`](Line): the lines themselves
//! - [`SerialPort`]: the whole bridge, with the axes, jaws and force sensors of all arms

pub mod axis;
pub mod frame;
mod line;
mod port;

pub use line::{AXIS_BAUD, Line, Lines, MOST};
pub(crate) use line::{leads_to_line, set_up};
pub use port::{SerialArm, SerialPort};
pub(crate) use port::{axis_drive, write_reading};
