//! Time for which the operator paused the task.

use crate::actors::control::Control;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::Instant;

/// Watch on the pauses of a task, which ends when it is dropped.
pub(super) struct Pauses {
    count: Arc<Mutex<Count>>,
    watch: JoinHandle<()>,
}

/// Pauses until now.
#[derive(Default)]
struct Count {
    /// Length of all pauses that are over.
    over: Duration,
    /// Beginning of the pause that is not over.
    since: Option<Instant>,
}

impl Pauses {
    /// Watches the operator's control from now on.
    pub(super) fn watch(mut control: watch::Receiver<Control>) -> Self {
        let count = Arc::new(Mutex::new(Count::default()));
        let own = Arc::clone(&count);
        let watch = tokio::spawn(async move {
            loop {
                let paused = *control.borrow_and_update() == Control::Paused;
                own.lock().unwrap_or_else(PoisonError::into_inner).set(paused);
                if control.changed().await.is_err() {
                    return;
                }
            }
        });
        Self { count, watch }
    }

    /// Returns the length of all pauses until now (s), in the time of the run.
    pub(super) fn seconds(&self) -> f64 {
        let count = self.count.lock().unwrap_or_else(PoisonError::into_inner);
        let open = count.since.map_or(Duration::ZERO, |since| since.elapsed());
        (count.over + open).as_secs_f64()
    }
}

impl Drop for Pauses {
    fn drop(&mut self) {
        self.watch.abort();
    }
}

impl Count {
    /// Begins a pause, or ends it.
    fn set(&mut self, paused: bool) {
        match self.since {
            None if paused => self.since = Some(Instant::now()),
            Some(since) if !paused => {
                self.over += since.elapsed();
                self.since = None;
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn pauses_add_up_with_one_still_open() {
        let (control, seen) = watch::channel(Control::Running);
        let pauses = Pauses::watch(seen);
        // Each state lasts one second.
        for state in [Control::Paused, Control::Running, Control::Paused] {
            tokio::time::sleep(Duration::from_secs(1)).await;
            control.send_replace(state);
        }
        tokio::time::sleep(Duration::from_secs(1)).await;

        assert!((pauses.seconds() - 2.0).abs() < 0.01, "{}", pauses.seconds());
    }
}
