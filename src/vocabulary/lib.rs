//! The vocabulary of the robot: the types of the field that solver, vision and controller share.
//!
//! | module | its types |
//! |---|---|
//! | [`cube`] | faces, facelets, pieces, turns, legal states, repairs |
//! | [`spatial`] | poses, twists, wrenches |
//! | [`motion`] | commands to an arm and the states that it reports |
//! | [`kinematics`] | motor <-> joint <-> pose of an IRp-6 |
//! | [`cell`] | arms, grippers, sensors, cameras and the place of hand-over, as numbers |
//!
//! Everything here is pure: no thread, clock, file, log or source of randomness.

pub mod cell;
pub mod cube;
pub mod kinematics;
pub mod motion;
pub mod spatial;
