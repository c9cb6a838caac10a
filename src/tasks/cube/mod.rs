//! The Rubik's cube task of Zieliński et al. (2007).
//!
//! - [`mission`] is the kernel of MP; [`belief`] estimates where the cube and the arms' bases are
//! - [`plan`] and [`identify`] turn solutions and looks into steps of two hands ([`hold`]), which
//!   [`replay`] checks
//! - [`think`] is the long work: colours to cube to plan
//! - [`door`] makes the kernel from a scenario, whose [`keys`] it reads; [`verdict`] judges the
//!   plant

pub mod belief;
pub mod door;
pub mod hold;
pub mod identify;
pub mod keys;
pub mod mission;
pub mod plan;
pub mod replay;
pub mod settings;
pub mod strategy;
pub mod think;
pub mod verdict;
