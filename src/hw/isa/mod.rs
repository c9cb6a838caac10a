//! The bridge to arms behind the original's ISA boards. Each arm has one card, whose registers
//! belong to the axis that a pointer selects.
//!
//! - [`registers`]: the card's map, the words of its axes, and the [`Registers`] trait, by which
//!   both are reached
//! - [`IsaPort`]: the bridge over any registers
//! - [`bank`]: emulated cards with a world behind them
//! - `port_io`: the registers of a real card by port instructions, behind the feature `isa`
//! - source: `hi_rydz` in the original's sources of March 2008

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
