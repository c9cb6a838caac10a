//! The task `follow_contour`: one arm follows an unknown contour by force, while the other one
//! picks parts, lays them down elsewhere, and hands the last one over.
//!
//! The cooperation is loose and the coordination sporadic (Zieliński et al. 2007, p. 369): each ECP
//! carries out a programme of its own, and MP only sets the moment at which they meet.
//!
//! | programme | effector | does |
//! |---|---|---|
//! | [`FOLLOW`] | the first | follows the contour, then takes the last part and lays it down |
//! | [`PICK`] | the second | lays the other parts down, then holds the last one out |
//!
//! The part goes from hand to hand: both grip the same bar, one hand beside the other. All
//! messages go through MP, in the order of [`signals`], so that one hand lets go
//! only after the other one holds.
//!
//! - in: the places of contour, parts and hand-over, as the controller believes them
//! - out: the programmes of both arms; signals between them
//! - errors of the cell of some mm are met by guarded moves, jaws that yield, and a search

mod door;
mod follower;
mod keys;
mod master;
mod moves;
mod orders;
mod picker;
mod verdict;

pub use door::FollowContour;
pub use follower::Follower;
pub use keys::Keys;
pub use master::follow_contour;
pub use orders::{FOLLOW, FollowerOrder, Hand, PICK, PickerOrder, Spot, signals};
pub use picker::Picker;
pub use verdict::Done;
