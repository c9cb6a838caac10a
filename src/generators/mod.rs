//! Motion generators: transition functions from inputs and memory to the next set values.
//!
//! - in: the state of the arm, the latest target of the visual sensor, the number of the servo
//!   period ([`Inputs`])
//! - out: the command of the next macrostep, or an [`Outcome`] ([`Next`]); a generator that uses
//!   the visual sensor also returns how the sensor must look from now on ([`Sensing`])
//! - source: Zieliński et al. (2007), pp. 370-371 and 374: pure position control, grasping,
//!   securing, turning, and the visual servo
//!
//! MP orders a [`Behaviour`], plain data, from which [`Generator::begin`] makes the generator. The
//! coordination decides where the generator runs: in an ECP (sporadic) or in MP (continuous).
//! Generators of other crates enter by the door in [`own`].

mod behaviour;
pub mod built_in;
mod compliance;
pub mod comply;
pub mod contact;
pub mod follow;
mod generator;
pub mod grasp;
mod inputs;
pub mod legs;
mod outcome;
pub mod own;
mod pace;
pub mod paths;
pub mod position;
pub mod profile;
pub mod secure;
pub mod swing;
#[cfg(test)]
mod testing;
pub mod turn;
pub mod visual_servo;

pub use behaviour::Behaviour;
pub use compliance::{Compliance, FORCED_APART, Selector, guarded_admittance};
pub use generator::Generator;
pub use inputs::{Inputs, Mode, Sensing, Target, Window};
pub use outcome::{Next, Outcome};
