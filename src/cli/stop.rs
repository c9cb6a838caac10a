//! Flag by which a signal stops a command that performs many runs.

use crate::run;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Exit code of a command that a signal stopped.
pub(super) const INTERRUPTED: u8 = 130;

/// Returns a flag that the first ending signal (Ctrl-C, say) sets. A second one ends the process at
/// once, with the exit code [`INTERRUPTED`].
///
/// # Errors
/// A handler cannot be installed.
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
