//! The tasks: kernels of MP and of the ECPs, one folder a task. Pure: event -> next action.
//!
//! A task imports neither `hw` nor `kinematics`: poses, wrenches and reach come to it as data.

pub mod cube;
