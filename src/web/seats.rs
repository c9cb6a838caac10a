//! The right to command: one page at a time has it, and the others watch. Every page may press the
//! emergency stop.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::watch;

/// Seats of all pages.
#[derive(Debug)]
pub(super) struct Seats {
    /// Number of the latest seat.
    last: AtomicU64,
    /// Number of the seat that commands.
    holder: watch::Sender<Option<u64>>,
    /// Lock of [`Seat::take`].
    taking: Mutex<()>,
}

impl Default for Seats {
    fn default() -> Self {
        Self { last: AtomicU64::new(0), holder: watch::channel(None).0, taking: Mutex::new(()) }
    }
}

impl Seats {
    /// Returns the seat of a new page, which commands if no other page does.
    pub(super) fn newcomer(self: &Arc<Self>) -> Seat {
        let number = self.last.fetch_add(1, Ordering::Relaxed) + 1;
        let seat = Seat { seats: Arc::clone(self), number };
        if self.holder.borrow().is_none() {
            seat.take();
        }
        seat
    }
}

/// Seat of one page. Dropping it gives up the right to command.
pub(super) struct Seat {
    seats: Arc<Seats>,
    number: u64,
}

impl Seat {
    /// Returns whether this page commands.
    pub(super) fn commands(&self) -> bool {
        *self.seats.holder.borrow() == Some(self.number)
    }

    /// Returns a receiver of the number of the seat that commands; `None` if no seat does.
    pub(super) fn holder(&self) -> watch::Receiver<Option<u64>> {
        self.seats.holder.subscribe()
    }

    /// Takes the right to command from the page that has it.
    pub(super) fn take(&self) {
        // A poisoned lock is harmless, since it guards no data.
        let _one = self.seats.taking.lock().unwrap_or_else(PoisonError::into_inner);
        self.seats.holder.send_if_modified(|holder| {
            let changed = *holder != Some(self.number);
            *holder = Some(self.number);
            changed
        });
    }

    /// Gives up the right to command if this page has it.
    pub(super) fn leave(&self) {
        // Another page may have taken over meanwhile, and keeps the right.
        self.seats.holder.send_if_modified(|holder| {
            let own = *holder == Some(self.number);
            if own {
                *holder = None;
            }
            own
        });
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.leave();
    }
}
