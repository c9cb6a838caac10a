//! A fault that is injected into one actor. No kernel sees it: the actor's loop asks for it at the
//! points at which it may occur.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

/// The faults that are injected into one actor.
#[derive(Debug, Default)]
pub(crate) struct ActorFault {
    pub(crate) panics: AtomicBool,
    pub(crate) hangs: AtomicBool,
    pub(crate) spins: AtomicBool,
    /// (ms)
    pub(crate) late: AtomicU64,
    pub(crate) lost: AtomicBool,
    pub(crate) twice: AtomicU32,
}

impl ActorFault {
    /// Panics, hangs or waits before an actor handles the message that has come.
    ///
    /// # Panics
    /// If a panic is injected.
    pub(crate) async fn before_message(&self) {
        self.occur().await;
        let late = self.late.swap(0, Ordering::AcqRel);
        if late > 0 {
            tokio::time::sleep(std::time::Duration::from_millis(late)).await;
        }
    }

    /// Panics, hangs or spins amid the work of an actor.
    ///
    /// # Panics
    /// If a panic is injected.
    pub(crate) async fn occur(&self) {
        assert!(!self.panics.load(Ordering::Acquire), "a panic was injected");
        if self.hangs.load(Ordering::Acquire) {
            std::future::pending::<()>().await;
        }
        while self.spins.load(Ordering::Acquire) {
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
    }

    /// Returns whether the message that has come is lost.
    pub(crate) fn is_lost(&self) -> bool {
        self.lost.swap(false, Ordering::AcqRel)
    }

    /// Returns whether the next message to the servo is to come twice.
    pub(crate) fn is_doubled(&self) -> bool {
        self.twice.swap(0, Ordering::AcqRel) > 0
    }
}
