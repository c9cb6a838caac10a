//! Arms behind serial axis controllers: one line an axis, all of them exchanged in every servo period.
//!
//! - [`frame`]: orders and answers as bytes
//! - [`axis`]: what to send to an axis, and what of its answers to believe
//! - [`line`](Line): the lines themselves
//! - [`SerialPort`]: the whole bridge: axes, jaws and force sensors of all arms

pub mod axis;
pub mod frame;
mod line;
mod port;

pub(crate) use line::set_up;
pub use line::{AXIS_BAUD, Line, Lines, MOST};
pub use port::{SerialArm, SerialPort};
pub(crate) use port::{axis_drive, hand_over};
