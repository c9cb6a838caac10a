//! Stop of a command that performs many runs, by a signal.

use crate::run;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Exit code of a command that a signal stopped.
pub(super) const INTERRUPTED: u8 = 130;

/// Returns a flag that a signal sets. A second signal ends the process.
pub(super) fn stop_flag() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in run::ending_signals() {
        // The conditional shutdown comes first, so that the first signal only sets the flag.
        let again = Arc::clone(&stop);
        signal_hook::flag::register_conditional_shutdown(signal, i32::from(INTERRUPTED), again)?;
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(stop)
}
