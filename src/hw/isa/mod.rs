//! Arms behind the original's ISA boards: one card an arm, whose registers are reached through an axis pointer.
//!
//! - [`registers`]: the card's map, the words of its axes, and the [`Registers`] trait through which all of it goes
//! - [`IsaPort`]: the bridge over any registers
//! - [`bank`]: emulated cards with a world behind them
//! - `port_io`: the registers of a real card by the processor's ports, behind the feature `isa`
//! - source: `hi_rydz` of the original's sources of March 2008

pub mod bank;
mod counter;
mod port;
#[cfg(feature = "isa")]
mod port_io;
pub mod registers;
#[cfg(test)]
mod tests;

pub use port::{IsaArm, IsaPort};
#[cfg(feature = "isa")]
pub use port_io::PortIo;
pub use registers::Registers;
