//! The one door for long work: vision, solver, planner, and what waits for a disk.
//!
//! On the wall driver it runs on the blocking pool; on the virtual driver inline, and its result is delivered
//! after a declared cost, never after measured time, so that runs repeat to the bit.

use crate::scenario::keys::Pace;
use crate::tasks::Effort;
use std::time::Duration;

/// The door.
#[derive(Debug, Clone, Copy)]
pub struct Work(pub Pace);

impl Work {
    /// Does the work and returns its result.
    pub async fn run<T: Send + 'static>(
        self,
        work: impl FnOnce() -> (T, Effort) + Send + 'static,
    ) -> Option<T> {
        match self.0 {
            Pace::Virtual => {
                let (result, Effort(seconds)) = work();
                tokio::time::sleep(Duration::from_secs_f64(seconds)).await;
                Some(result)
            }
            Pace::RealTime => tokio::task::spawn_blocking(move || work().0).await.ok(),
        }
    }

    /// Does what takes no time of a virtual run and may take long by the wall clock: what waits for a disk. Other actors and
    /// the heart beat get on meanwhile.
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
