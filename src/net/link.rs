//! Link between two nodes on the wall clock.
//!
//! - in: parcels of bytes, each on a lane
//! - out: the same parcels at the other end, in the order of their lane

use std::fmt::Debug;
use std::sync::Arc;
use tokio::sync::mpsc;

/// Lane of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lane {
    /// Messages: each one arrives.
    Messages,
    /// Values: a link that is full drops them, since newer ones follow.
    Values,
}

/// End of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// End of MP's node.
    Home,
    /// End of the other node.
    Node,
}

impl End {
    /// Returns the word of this end's parcels in keys.
    #[cfg_attr(not(feature = "net"), allow(dead_code, reason = "only a network has keys"))]
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Home => "home",
            Self::Node => "node",
        }
    }

    /// Returns the other end.
    #[cfg_attr(not(feature = "net"), allow(dead_code, reason = "only a network has keys"))]
    pub(super) fn other(self) -> Self {
        match self {
            Self::Home => Self::Node,
            Self::Node => Self::Home,
        }
    }
}

/// Sending end of a link.
pub trait Link: Debug + Send + Sync {
    /// Sends a parcel. It does not wait for the other end.
    fn send(&self, lane: Lane, parcel: Vec<u8>);
}

/// Parcels that arrive at an end of a link.
pub type Parcels = mpsc::UnboundedReceiver<(Lane, Vec<u8>)>;

/// Message of a topic to which this program has subscribed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Key under which it was published.
    pub key: String,
    /// Its bytes; `None` if they are more than the subscriber takes.
    pub data: Option<Vec<u8>>,
    /// Bytes that are attached to it; none without an attachment.
    pub attachment: Vec<u8>,
}

/// Link within a process.
#[derive(Debug)]
struct Here(mpsc::UnboundedSender<(Lane, Vec<u8>)>);

impl Link for Here {
    fn send(&self, lane: Lane, parcel: Vec<u8>) {
        // A parcel to an end that is gone is lost, as on a network.
        let _ = self.0.send((lane, parcel));
    }
}

/// Makes both ends of a link within a process.
#[must_use]
pub fn pair() -> [(Arc<dyn Link>, Parcels); 2] {
    let ((to_second, second), (to_first, first)) =
        (mpsc::unbounded_channel(), mpsc::unbounded_channel());
    [(Arc::new(Here(to_second)), first), (Arc::new(Here(to_first)), second)]
}
