//! Drives on their way from the servo to the bridge's thread.

use crate::servo::io::ArmDrive;
use crate::servo::lateness::MOST_ARMS;

/// Drive commands of all arms for one period.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drives {
    pub(super) period: u64,
    pub(super) drives: [ArmDrive; MOST_ARMS],
}

impl Drives {
    /// Merges `earlier` drive commands, which were not carried out, into these and returns the
    /// result: an order to switch off and an order to synchronise must not get lost.
    pub(super) fn instead_of(mut self, earlier: &Self) -> Self {
        for (drive, earlier) in self.drives.iter_mut().zip(&earlier.drives) {
            drive.enabled &= earlier.enabled;
            drive.synchronise |= earlier.synchronise;
        }
        self
    }
}
