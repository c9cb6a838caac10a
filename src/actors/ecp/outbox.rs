//! The way of a programme's messages to MP.

use crate::kernel::Message;
use tokio::sync::mpsc;

/// Way of a programme's messages to MP.
#[derive(Debug, Clone)]
pub struct Outbox {
    /// Effector of the programme.
    pub effector: usize,
    /// Mailbox of MP.
    pub mailbox: mpsc::UnboundedSender<Message>,
}

impl Outbox {
    /// Sends a message. An MP that is gone ends the programme by its closed mailbox.
    pub(super) fn send(&self, message: Message) {
        let _ = self.mailbox.send(message);
    }
}
