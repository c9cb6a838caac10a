//! Subscriber of one topic, which keeps the latest message.
//!
//! - in: a place, the name of a topic
//! - out: the latest message with its age, or the reason why there is none
//!
//! | rule | reason |
//! |---|---|
//! | only the latest message is kept | a slow reader must not collect messages |
//! | a message beyond [`LARGEST`] is dropped with a reason | memory stays bounded |
//! | messages of two publishers at once are refused | two programs must not move one arm |

use super::messages::hash_of;
use super::names::{Attached, Names, of_any_type, type_in};
use crate::net::{self, Message, RosPlace, Session, Subscription, Token, refuses_topic};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Greatest size of a message (bytes): a picture of 16 megapixels with 3 bytes each.
const LARGEST: usize = 64 << 20;
/// Time of silence after which another publisher may take the place of the one before.
const YIELDS: Duration = Duration::from_millis(500);

/// Message that has arrived.
#[derive(Debug, Clone)]
pub struct Arrived {
    /// Type of the message, such as `sensor_msgs/msg/Image`.
    pub kind: String,
    /// Bytes of the message, or the reason why it is refused.
    pub data: Result<Arc<Vec<u8>>, String>,
    /// Number of the message among those that have arrived, from 1.
    pub number: u64,
    /// Time of its arrival.
    pub at: Instant,
}

/// Messages of a topic so far.
#[derive(Debug, Default)]
struct Inbox {
    latest: Option<Arrived>,
    /// Publisher that is heard, with the time of its last message.
    heard: Option<([u8; 16], Instant)>,
    /// Time of the last message of another publisher.
    other: Option<Instant>,
}

impl Inbox {
    /// Takes a message that arrives at the time `at`.
    fn take(&mut self, message: Message, at: Instant) {
        let kind = type_in(&message.key).unwrap_or_default();
        let attached = Attached::read(&message.attachment);
        let data = match (message.data, attached) {
            (None, _) => Err(format!("a message has more than {LARGEST} bytes")),
            (_, None) => Err("a message has no attachment of rmw_zenoh".to_owned()),
            (Some(data), Some(attached)) => {
                self.hear(attached.publisher, at);
                if self.other.is_some_and(|last| is_recent(last, at)) {
                    Err("two programs publish this topic: end one of them".to_owned())
                } else {
                    Ok(Arc::new(data))
                }
            }
        };
        let number = self.latest.as_ref().map_or(0, |latest| latest.number) + 1;
        self.latest = Some(Arrived { kind, data, number, at });
    }

    /// Notes that a message of a publisher has arrived.
    fn hear(&mut self, publisher: [u8; 16], at: Instant) {
        match self.heard {
            Some((heard, last)) if heard != publisher && is_recent(last, at) => {
                self.other = Some(at);
            }
            _ => self.heard = Some((publisher, at)),
        }
    }
}

/// Returns whether the time `last` is recent at the time `at`.
fn is_recent(last: Instant, at: Instant) -> bool {
    at.saturating_duration_since(last) < YIELDS
}

/// Inbox that a thread of the network fills.
type Shared = Arc<(Mutex<Inbox>, Condvar)>;

/// Subscriber of one topic. It ends when it is dropped.
#[derive(Debug)]
pub struct Listener {
    topic: String,
    inbox: Shared,
    // These end before their session.
    _subscription: Subscription,
    _tokens: [Token; 2],
    _session: Session,
}

/// Locks an inbox, even if another holder of the lock has panicked.
fn lock(inbox: &Shared) -> MutexGuard<'_, Inbox> {
    inbox.0.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Listener {
    /// Subscribes to a topic, whose messages should be of the type `kind`: others arrive as well.
    ///
    /// # Errors
    /// The reason, if the name is no topic's, the router does not answer, or this build has no
    /// network.
    pub fn open(place: &RosPlace, topic: &str, kind: &str) -> Result<Self, String> {
        if let Some(why) = refuses_topic(topic) {
            return Err(why);
        }
        let of = |why: String| format!("topic {topic} over {}: {why}", place.router);
        let session = net::open_client(&place.router).map_err(of)?;
        let inbox = Shared::default();
        let filled = Arc::clone(&inbox);
        let take = move |message: Message| {
            lock(&filled).take(message, Instant::now());
            filled.1.notify_all();
        };
        let keys = of_any_type(place.domain, topic);
        let subscription = session.subscribe(keys, LARGEST, take).map_err(of)?;
        // Others see the subscriber by these.
        let names = Names { domain: place.domain, session: session.identity()? };
        let subscriber = names.subscriber(topic, kind, &hash_of(kind));
        let tokens = [session.token(names.node())?, session.token(subscriber)?];
        Ok(Self {
            topic: topic.to_owned(),
            inbox,
            _subscription: subscription,
            _tokens: tokens,
            _session: session,
        })
    }

    /// Returns the name of the topic.
    #[must_use]
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Returns the latest message; `None` before the first one.
    #[must_use]
    pub fn latest(&self) -> Option<Arrived> {
        lock(&self.inbox).latest.clone()
    }

    /// Returns the latest message after the one with the number `after`, for which it waits at
    /// most `patience`; `None` if none comes.
    #[must_use]
    pub fn next(&self, after: u64, patience: Duration) -> Option<Arrived> {
        let is_old =
            |inbox: &mut Inbox| inbox.latest.as_ref().is_none_or(|latest| latest.number <= after);
        let waited = self.inbox.1.wait_timeout_while(lock(&self.inbox), patience, is_old);
        let (inbox, waited) = waited.unwrap_or_else(PoisonError::into_inner);
        inbox.latest.clone().filter(|_| !waited.timed_out())
    }
}

#[cfg(test)]
mod tests {
    use super::super::names::attachment;
    use super::*;

    /// Returns a message of the publisher `from`.
    fn message(from: u8, data: Option<Vec<u8>>) -> Message {
        let key = "0/a/sensor_msgs::msg::dds_::Image_/RIHS01_0".to_owned();
        Message { key, data, attachment: attachment(1, 2, [from; 16]) }
    }

    #[test]
    fn two_publishers_at_once_are_refused() {
        let (mut inbox, begun) = (Inbox::default(), Instant::now());
        let mut taken = |from: u8, after: u64| {
            let at = begun + Duration::from_millis(after);
            inbox.take(message(from, Some(vec![from])), at);
            inbox.latest.clone().unwrap().data
        };

        assert!(taken(1, 0).is_ok());
        assert!(taken(2, 10).unwrap_err().contains("two programs publish"));
        assert!(taken(1, 400).unwrap_err().contains("two programs publish"));
        assert!(taken(1, 511).is_ok(), "the second one is silent for half a second");
        assert!(taken(2, 1000).is_err());
        assert!(taken(2, 1012).is_err(), "its own last message is recent");
        assert!(taken(2, 1600).is_ok(), "the first one is silent, the second takes its place");
        assert!(taken(1, 1610).is_err());
    }

    #[test]
    fn large_and_bare_messages_are_refused() {
        let (mut inbox, now) = (Inbox::default(), Instant::now());

        inbox.take(message(1, None), now);
        let large = inbox.latest.clone().unwrap();
        assert_eq!((large.number, large.kind.as_str()), (1, "sensor_msgs/msg/Image"));
        assert!(large.data.unwrap_err().contains("more than"));
        inbox.take(Message { attachment: vec![0; 12], ..message(1, Some(vec![])) }, now);
        let bare = inbox.latest.clone().unwrap();
        assert_eq!(bare.number, 2);
        assert!(bare.data.unwrap_err().contains("no attachment"));
    }
}
