//! To be written.

pub mod kinematics;
