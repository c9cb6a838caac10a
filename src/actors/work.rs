//! The one door for long work: vision, solver, planner, and writes that wait for a disk.
//!
//! Under the wall clock the work runs on the blocking pool. Under virtual time it runs inline, and
//! its result is delivered after a declared cost, never after measured time, so that runs repeat to
//! the bit.

use crate::scenario::keys::Pace;
use crate::tasks::Effort;
use std::time::Duration;

/// The door for long work of a run at this pace.
#[derive(Debug, Clone, Copy)]
pub struct Work(pub Pace);

impl Work {
    /// Does long work and returns its result; `None` if the work panicked on the blocking pool.
    /// Under virtual time the declared effort passes before the result is returned.
    pub async fn run<T: Send + 'static>(
        self,
        work: impl FnOnce() -> (T, Effort) + Send + 'static,
    ) -> Option<T> {
        match self.0 {
            Pace::Virtual => {
                let (result, Effort(seconds)) = work();
                // Other actors and the servo live through the declared time.
                tokio::time::sleep(Duration::from_secs_f64(seconds)).await;
                Some(result)
            }
            // The effort is a figure of virtual time: here the work takes its own.
            Pace::RealTime => tokio::task::spawn_blocking(move || work().0).await.ok(),
        }
    }

    /// Does work that takes no time of a virtual run and may take long by the wall clock, as a wait
    /// for a disk. Returns `None` if the work panicked on the blocking pool. Other actors and the
    /// heartbeat run meanwhile.
    pub async fn wait<T: Send + 'static>(
        self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Option<T> {
        match self.0 {
            Pace::Virtual => Some(work()),
            Pace::RealTime => tokio::task::spawn_blocking(work).await.ok(),
        }
    }
}
