//! Where a mission stands between two procedures.

use crate::tasks::Finish;

/// Where a mission stands between two procedures. A resumed one enters at a station, or at a turn
/// that fails while it takes stock.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Station {
    /// The track stands before the place of hand-over, and the cube is to be taken.
    Take,
    /// One hand holds the cube alone, and nothing is known of its faces.
    Read {
        /// Name of the phase that begins.
        phase: &'static str,
    },
    /// The cube goes back as the task wants it.
    Return,
    /// The cube goes back as it is, for this reason.
    Unsolved(String),
    /// The mission is over.
    Over(Finish),
}
