//! The faults that a scenario injects into one actor. No kernel sees them: the loop of the actor
//! checks for them at the points at which they may occur.
//!
//! | fault | effect | detected by |
//! |---|---|---|
//! | panic | the actor's task ends | the watchdog, at once |
//! | hang | the actor stays at its work item | the watchdog, within 0.1 s |
//! | spin | the actor blocks the whole runtime | the watch from outside the runtime |
//! | late message | the answer comes late | the time limit of the actor that asked |
//! | lost message | the channel of the answer closes | the actor that asked |
//! | doubled message | a command reaches the servo twice | the command's number |

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

/// The faults that are injected into one actor.
#[derive(Debug, Default)]
pub(crate) struct ActorFault {
    /// Whether the actor panics.
    pub(crate) panics: AtomicBool,
    /// Whether the actor waits forever.
    pub(crate) hangs: AtomicBool,
    /// Whether the actor blocks the thread of the runtime.
    pub(crate) spins: AtomicBool,
    /// Delay of the next message (ms).
    pub(crate) late: AtomicU64,
    /// Whether the next message is lost.
    pub(crate) lost: AtomicBool,
    /// Whether the next message to the servo comes twice: 1 if it does.
    pub(crate) twice: AtomicU32,
}

impl ActorFault {
    /// Applies the injected faults at the point at which an actor is about to handle a message: a
    /// panic, a hang, a spin, or a delay of the message.
    ///
    /// # Panics
    /// If a panic is injected.
    pub(crate) async fn before_message(&self) {
        self.occur().await;
        // The swap clears the delay, so that the fault delays one message only.
        let late = self.late.swap(0, Ordering::AcqRel);
        if late > 0 {
            tokio::time::sleep(std::time::Duration::from_millis(late)).await;
        }
    }

    /// Applies an injected panic, hang or spin at this point of an actor's work. Returns at once if
    /// none is injected.
    ///
    /// # Panics
    /// If a panic is injected.
    pub(crate) async fn occur(&self) {
        assert!(!self.panics.load(Ordering::Acquire), "a panic was injected");
        if self.hangs.load(Ordering::Acquire) {
            std::future::pending::<()>().await;
        }
        // A sleep of the thread, not of the task: no other actor of the runtime can run meanwhile.
        while self.spins.load(Ordering::Acquire) {
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
    }

    /// Returns whether the message that has just arrived must be dropped as lost. Clears the fault,
    /// so that it hits one message only.
    pub(crate) fn is_lost(&self) -> bool {
        self.lost.swap(false, Ordering::AcqRel)
    }

    /// Returns whether the next command must reach the servo twice. Clears the fault, so that it
    /// hits one command only.
    pub(crate) fn is_doubled(&self) -> bool {
        self.twice.swap(0, Ordering::AcqRel) > 0
    }
}
