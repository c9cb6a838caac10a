//! The one door for long work: vision, solver, planner, and writes that wait for a disk.
//!
//! Under the wall clock the work runs on the blocking pool. Under virtual time it runs inline, and
//! its result is delivered after a declared cost, never after measured time, so that runs repeat to
//! the bit.
//!
//! | fault of a worker | wall clock | virtual time |
//! |---|---|---|
//! | panic | error with the panic's text | the same |
//! | no result in time | error after the limit of the work | reported by the watch from outside |
//! | no thread for it | error with the reason | - |

use super::watchdog::{Watchdog, within};
use crate::error::{System, panic_text};
use crate::kernel::Effort;
use crate::scenario::keys::Pace;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

/// Longest time of processing one picture by the wall clock.
pub(crate) const IMAGE: Duration = Duration::from_secs(3);
/// Longest time of a search or of a write to a disk by the wall clock. A plan takes a few seconds
/// on a slow machine; a longer limit would only leave the arms waiting.
pub(crate) const SEARCH: Duration = Duration::from_secs(60);
/// Divisor of a limit: this part of the limit is left for a worker after a jump of the clock, for
/// example while the process was stopped, since the worker did nothing during the jump.
const REST: u32 = 3;

/// The door for long work of a run.
#[derive(Debug, Clone)]
pub struct Work {
    pace: Pace,
    watchdog: Watchdog,
}

impl Work {
    /// Creates the door of a run at this pace. `watchdog` detects work that never ends.
    pub(crate) fn new(pace: Pace, watchdog: &Watchdog) -> Self {
        Self { pace, watchdog: watchdog.clone() }
    }

    /// Creates a door at this pace without a watch of work that runs inline.
    #[must_use]
    pub fn at(pace: Pace) -> Self {
        Self::new(pace, &Watchdog::default())
    }

    /// Does long work and returns its result. Under virtual time the declared effort passes before
    /// the result is returned. `who` names the worker, `limit` is the longest time by the wall
    /// clock.
    ///
    /// # Errors
    /// [`System::Panicked`], [`System::Silent`] or [`System::NotCreated`] about the worker.
    pub(crate) async fn run<T: Send + 'static>(
        &self,
        (who, limit): (&str, Duration),
        work: impl FnOnce() -> (T, Effort) + Send + 'static,
    ) -> Result<T, System> {
        match self.pace {
            Pace::Virtual => {
                let (result, Effort(seconds)) = self.inline(who, work)?;
                // Other actors and the servo live through the declared time.
                tokio::time::sleep(Duration::from_secs_f64(seconds)).await;
                Ok(result)
            }
            // The declared effort counts under virtual time only.
            Pace::RealTime => pooled(who, limit, move || work().0).await,
        }
    }

    /// Does work that takes no simulated time but may take long by the wall clock, such as a write
    /// to a disk. Under the wall clock other actors and the heartbeat run meanwhile.
    ///
    /// # Errors
    /// As [`Self::run`].
    pub(crate) async fn wait<T: Send + 'static>(
        &self,
        who: &str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, System> {
        match self.pace {
            Pace::Virtual => self.inline(who, work),
            Pace::RealTime => pooled(who, SEARCH, work).await,
        }
    }

    /// Does work on this thread, which blocks all actors. Returns its result, or the error of its
    /// panic.
    fn inline<T>(&self, who: &str, work: impl FnOnce() -> T) -> Result<T, System> {
        // The panic drops all that the work owned, so nothing half done is left behind.
        let caught = || catch_unwind(AssertUnwindSafe(work));
        self.watchdog.watch_inline(who, caught).map_err(|why| panicked(who, &*why))
    }
}

/// Does work on the blocking pool, for at most `limit`. A worker that is late keeps its thread.
async fn pooled<T: Send + 'static>(
    who: &str,
    limit: Duration,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, System> {
    // The runtime panics if the system gives it no thread.
    let begun = catch_unwind(AssertUnwindSafe(|| tokio::task::spawn_blocking(work)));
    let not_created = |why: &(dyn std::any::Any + Send)| System::NotCreated {
        who: who.to_owned(),
        why: panic_text(why),
    };
    let worker = begun.map_err(|why| not_created(&*why))?;
    match within(limit, limit / REST, worker).await {
        Some(Ok(result)) => Ok(result),
        Some(Err(error)) => Err(match error.try_into_panic() {
            Ok(why) => panicked(who, &*why),
            // The runtime ends and has cancelled the work.
            Err(_) => System::Closed(who.to_owned()),
        }),
        None => Err(System::Silent { who: who.to_owned(), seconds: limit.as_secs_f64() }),
    }
}

/// Returns the error of a worker's panic.
fn panicked(who: &str, why: &(dyn std::any::Any + Send)) -> System {
    System::Panicked { who: who.to_owned(), why: panic_text(why) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn worker_panic_is_named_on_both_clocks() {
        for pace in [Pace::Virtual, Pace::RealTime] {
            let door = Work::at(pace);
            let thinks = || -> ((), Effort) { panic!("on purpose {}", 1) };
            let died = door.run(("the planner", SEARCH), thinks).await;
            assert_eq!(died.unwrap_err().to_string(), "the planner panicked: on purpose 1");
            let died = door.wait("the writer", || -> u8 { panic!("no disk") }).await;
            assert_eq!(died.unwrap_err().to_string(), "the writer panicked: no disk");
            assert_eq!(door.wait("the writer", || 3).await, Ok(3));
        }
    }

    #[tokio::test]
    async fn hanging_worker_is_reported_after_its_limit() {
        let (end, ended) = std::sync::mpsc::channel::<()>();
        let hangs = move || {
            let _ = ended.recv();
            ((), Effort(0.0))
        };
        let limit = Duration::from_millis(60);

        let door = Work::at(Pace::RealTime);
        let begun = std::time::Instant::now();
        let late = door.run(("the image worker", limit), hangs).await;
        let lasted = begun.elapsed();

        // The message rounds the limit of 60 ms.
        let error = late.unwrap_err();
        assert_eq!(error.to_string(), "no answer from the image worker in 0.1 s");
        assert!((limit..Duration::from_secs(1)).contains(&lasted), "{lasted:?}");
        drop(end);
    }
}
