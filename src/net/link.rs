//! Link between two nodes on the wall clock.
//!
//! - in: parcels of bytes, each on a lane
//! - out: the same parcels at the other end, in the order of their lane; the number of bytes

use std::fmt::Debug;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::sync::mpsc;

/// Lane of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lane {
    /// Messages: each one arrives.
    Messages,
    /// Values: a link that is full drops them, since newer ones follow.
    Values,
    /// Pictures: they wait for all others, and a link that is full drops them.
    Pictures,
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

/// Bytes of the parcels that an end of a link has sent and received, without those that the network
/// adds to them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Traffic {
    /// Bytes sent.
    pub sent: u64,
    /// Bytes received.
    pub received: u64,
}

/// Counter of an end's traffic. All clones count together.
#[derive(Debug, Clone, Default)]
pub(super) struct Meter(Arc<[AtomicU64; 2]>);

impl Meter {
    /// Counts a parcel that was sent.
    pub(super) fn sent(&self, parcel: &[u8]) {
        self.0[0].fetch_add(parcel.len() as u64, Ordering::Relaxed);
    }

    /// Counts a parcel that was received.
    pub(super) fn received(&self, parcel: &[u8]) {
        self.0[1].fetch_add(parcel.len() as u64, Ordering::Relaxed);
    }

    /// Returns the traffic since the beginning.
    pub(super) fn traffic(&self) -> Traffic {
        let [sent, received] = [0, 1].map(|i: usize| self.0[i].load(Ordering::Relaxed));
        Traffic { sent, received }
    }
}

/// Sending end of a link.
pub trait Link: Debug + Send + Sync {
    /// Sends a parcel. It does not wait for the other end.
    fn send(&self, lane: Lane, parcel: Vec<u8>);

    /// Returns the traffic of this end since its beginning.
    fn traffic(&self) -> Traffic;
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
struct Here {
    to: mpsc::UnboundedSender<(Lane, Vec<u8>)>,
    /// Traffic of this end and of the other one.
    meters: [Meter; 2],
}

impl Link for Here {
    fn send(&self, lane: Lane, parcel: Vec<u8>) {
        self.meters[0].sent(&parcel);
        self.meters[1].received(&parcel);
        // A parcel to an end that is gone is lost, as on a network.
        let _ = self.to.send((lane, parcel));
    }

    fn traffic(&self) -> Traffic {
        self.meters[0].traffic()
    }
}

/// Makes both ends of a link within a process.
#[must_use]
pub fn pair() -> [(Arc<dyn Link>, Parcels); 2] {
    let ((to_second, second), (to_first, first)) =
        (mpsc::unbounded_channel(), mpsc::unbounded_channel());
    let meters = [Meter::default(), Meter::default()];
    let other = [meters[1].clone(), meters[0].clone()];
    [
        (Arc::new(Here { to: to_second, meters }), first),
        (Arc::new(Here { to: to_first, meters: other }), second),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ends_count_the_same_bytes() {
        let [(near, _kept), (far, _also)] = pair();

        near.send(Lane::Messages, vec![0; 10]);
        near.send(Lane::Values, vec![0; 5]);
        far.send(Lane::Pictures, vec![0; 7]);

        assert_eq!(near.traffic(), Traffic { sent: 15, received: 7 });
        assert_eq!(far.traffic(), Traffic { sent: 7, received: 15 });
    }
}
