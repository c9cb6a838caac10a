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
//!
//! ```
//! use rubik_robot_vocabulary::cube::{Cube, Facelets, parse_turns};
//! use rubik_robot_vocabulary::spatial::Pose;
//!
//! // After R the right columns of U, F, D and B have exchanged their colours.
//! let cube = Cube::SOLVED.apply_all(&parse_turns("R")?);
//! let stickers = Facelets::from(&cube).to_string();
//! assert_eq!(stickers, "UUFUUFUUFRRRRRRRRRFFDFFDFFDDDBDDBDDBLLLLLLLLLUBBUBBUBB");
//!
//! // A pose is named `to_from`, so that equal names meet. Lengths are in metres.
//! let world_from_base = Pose::translation(0.0, 2.11, 0.0);
//! let base_from_tool = Pose::translation(0.8, 0.0, 1.1);
//! let world_from_tool = world_from_base * base_from_tool;
//! assert_eq!(world_from_tool.translation.vector.as_slice(), [0.8, 2.11, 1.1]);
//! # Ok::<(), rubik_robot_vocabulary::cube::ParseTurns>(())
//! ```

pub mod cell;
pub mod cube;
pub mod kinematics;
pub mod motion;
pub mod spatial;
