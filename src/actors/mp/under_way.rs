//! The list of the programmes that MP has started.

use crate::actors::ecp::Report;
use tokio::sync::mpsc;

/// Programmes under way, and the mailbox of their messages.
pub(super) struct Programmes {
    /// Sending end, of which each programme gets a clone.
    pub(super) to_mp: mpsc::UnboundedSender<Report>,
    /// Mailbox of their messages.
    pub(super) messages: mpsc::UnboundedReceiver<Report>,
    /// Effectors that carry out a programme.
    pub(super) running: Vec<usize>,
    /// Effectors that have ever carried out a programme. Their faults are not MP's.
    pub(super) own: Vec<usize>,
}

impl Programmes {
    /// Makes the list without programmes.
    pub(super) fn new() -> Self {
        let (to_mp, messages) = mpsc::unbounded_channel();
        Self { to_mp, messages, running: Vec::new(), own: Vec::new() }
    }

    /// Returns the first of these effectors that carries out a programme; `None` if there is none.
    pub(super) fn busy(&self, mut effectors: impl Iterator<Item = usize>) -> Option<usize> {
        effectors.find(|effector| self.running.contains(effector))
    }
}
