//! SIGINT and SIGTERM as the operator's terminate: the run ends at its next macrostep and still sums up.
//!
//! A thread waits for the signals; the runtime's paused time knows nothing of it. A second signal ends the process
//! at once, in case the first one cannot be obeyed.

use super::control::Control;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::{Handle, Signals};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::sync::watch;

/// Exit code of a process that was interrupted.
const INTERRUPTED: i32 = 130;

/// Listens as long as it lives.
#[derive(Debug)]
pub(super) struct Interrupt {
    came: Arc<AtomicBool>,
    handle: Handle,
}

impl Interrupt {
    /// Terminates the run by `control` when a signal comes.
    pub(super) fn listen(control: Arc<watch::Sender<Control>>) -> std::io::Result<Self> {
        let mut signals = Signals::new([SIGINT, SIGTERM])?;
        let handle = signals.handle();
        let came = Arc::new(AtomicBool::new(false));
        let noted = Arc::clone(&came);
        std::thread::spawn(move || {
            for _ in signals.forever() {
                if noted.swap(true, Ordering::SeqCst) {
                    signal_hook::low_level::exit(INTERRUPTED);
                }
                control.send_replace(Control::Terminated);
            }
        });
        Ok(Self { came, handle })
    }

    /// Whether a signal came.
    pub(super) fn came(&self) -> bool {
        self.came.load(Ordering::SeqCst)
    }
}

impl Drop for Interrupt {
    fn drop(&mut self) {
        self.handle.close();
    }
}
