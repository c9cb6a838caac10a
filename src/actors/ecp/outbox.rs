//! The way of a programme's messages to MP.

use crate::kernel::Message;
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};
use tokio::sync::mpsc;

/// Message of a programme, with what MP must know of its effector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Message for the kernel of MP.
    pub message: Message,
    /// Tool frame in force (`flange_from_tool`), where MP or a programme has changed it.
    pub tool: Option<Pose>,
}

/// Way of a programme's messages to MP.
#[derive(Debug, Clone)]
pub struct Outbox {
    /// Effector of the programme.
    pub effector: usize,
    /// Mailbox of MP.
    pub mailbox: mpsc::UnboundedSender<Report>,
}

impl Outbox {
    /// Sends a message, with the tool frame in force. An MP that is gone ends the programme by its
    /// closed mailbox.
    pub(super) fn send(&self, message: Message, tool: Option<Pose>) {
        let _ = self.mailbox.send(Report { message, tool });
    }
}
