//! Largest forces and torques that the wrist sensors measured in any servo period of a run. The
//! VSP of the forces looks less often, so a short contact can pass between two of its looks.

use crate::hw::driver::{RecordSink, ServoRecord};
use std::sync::{Arc, Mutex, PoisonError};

/// Largest norms of force (N) and torque (Nm) at the tool of each arm. A clone has the same ones.
#[derive(Debug, Clone, Default)]
pub(super) struct MeasuredPeaks(Arc<Mutex<Vec<(f64, f64)>>>);

impl MeasuredPeaks {
    /// Returns the largest force (N) and torque (Nm) of an arm; zeros without a record of it.
    pub(super) fn peak(&self, arm: usize) -> (f64, f64) {
        let peaks = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        peaks.get(arm).copied().unwrap_or_default()
    }
}

impl RecordSink for MeasuredPeaks {
    fn record(&mut self, record: &ServoRecord) {
        let mut peaks = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let arm = usize::from(record.arm);
        if peaks.len() <= arm {
            peaks.resize(arm + 1, (0.0, 0.0));
        }
        let wrench = &record.state.wrench_in_tool;
        let (force, torque) = peaks[arm];
        // `max` ignores a reading that is no number.
        peaks[arm] = (force.max(wrench.force.norm()), torque.max(wrench.torque.norm()));
    }
}
