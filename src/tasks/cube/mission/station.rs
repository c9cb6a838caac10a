//! Stations of a mission, the states between two procedures.

use crate::kernel::Finish;

/// State of a mission between two procedures. A resumed mission enters at a station, or at a turn
/// that fails while it takes stock.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Station {
    /// Acquisition: the track is before the place of hand-over, and the cube is taken next.
    Take,
    /// Reading: one hand holds the cube alone, and its faces are unknown.
    Read {
        /// Name of the phase that begins.
        phase: &'static str,
    },
    /// Return of the cube in the state that the task wants.
    Return,
    /// Return of the cube as it is, for this reason.
    Unsolved(String),
    /// End of the mission.
    Over(Finish),
}
