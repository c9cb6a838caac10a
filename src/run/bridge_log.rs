//! Log of a bridge's notes: lost answers, retries, late readings.

use super::failure::not_created;
use crate::cell::Cell;
use crate::error::Error;
use crate::hw::note::{Digest, Note};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// Thread that summarises the notes of a bridge and logs them, once a second and at the end.
pub(super) struct BridgeLog {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl BridgeLog {
    /// Starts the thread that logs the `notes` of a bridge. The effectors in them get the names of
    /// the arms of `cell`.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub(super) fn start(mut notes: rtrb::Consumer<Note>, cell: &Cell) -> Result<Self, Error> {
        let effectors = cell.arms.iter().map(|arm| arm.name.clone()).collect();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::Builder::new().name("bridge log".into()).spawn(move || {
            let mut digest = Digest::new(effectors);
            let mut last = false;
            while !last {
                // The flag is read before the notes, so that the last digest misses none of them.
                last = stopped.load(Ordering::Acquire);
                for sentence in digest.sentences(&mut notes, last) {
                    tracing::warn!("{sentence}");
                }
                std::thread::park_timeout(Duration::from_secs(u64::from(!last)));
            }
        });
        let thread = thread.map_err(|why| not_created("bridge log", &why.to_string()))?;
        Ok(Self { stop, thread: Some(thread) })
    }
}

impl Drop for BridgeLog {
    /// Lets the thread log its last notes, and waits for its end.
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // A panic of the thread has been reported by its own message.
            let _ = thread.join();
        }
    }
}
