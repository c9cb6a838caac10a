//! Feed of a run: the messages of a recording for readers that watch while the run goes on.
//!
//! - in: messages, as the recorder writes them, with topic, type and time
//! - out: the topics with their latest messages; each message for all subscribers
//! - a subscriber that is slow misses the oldest messages; no run waits for it
//!
//! The feed outlives a run, as the operator's desk does: its topics keep their numbers.

use super::schema::Kind;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::broadcast;

/// Number of messages that wait for a subscriber: about two seconds of a run with two arms.
const WAITING: usize = 4096;

/// Message of a topic.
#[derive(Debug, PartialEq, Eq)]
pub struct Sample {
    /// Number of its topic.
    pub topic: u32,
    /// Time of the message (ns).
    pub time: u64,
    /// Fields of the message, in the encoding CDR.
    pub data: Vec<u8>,
}

/// Topic of a feed.
#[derive(Debug, Clone)]
pub struct Topic {
    /// Number of the topic, from 1.
    pub number: u32,
    /// Name of the topic.
    pub name: String,
    /// Type of its messages.
    pub kind: Kind,
    /// Its latest message.
    pub latest: Arc<Sample>,
}

/// Feed of a run. A clone is another end of the same feed.
#[derive(Debug, Clone)]
pub struct Feed(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    topics: Mutex<BTreeMap<String, Topic>>,
    samples: broadcast::Sender<Arc<Sample>>,
}

impl Default for Feed {
    /// Makes a feed without topics.
    fn default() -> Self {
        let samples = broadcast::channel(WAITING).0;
        Self(Arc::new(Inner { topics: Mutex::default(), samples }))
    }
}

impl Feed {
    /// Sends a message to all subscribers and keeps it as the latest of its topic.
    pub(super) fn send(&self, name: &str, kind: Kind, time: u64, data: &[u8]) {
        let mut topics = self.lock();
        let number = match topics.get(name) {
            Some(topic) => topic.number,
            None => topics.len() as u32 + 1,
        };
        let sample = Arc::new(Sample { topic: number, time, data: data.to_vec() });
        if let Some(topic) = topics.get_mut(name) {
            topic.latest = Arc::clone(&sample);
        } else {
            let (name, latest) = (name.to_owned(), Arc::clone(&sample));
            topics.insert(name.clone(), Topic { number, name, kind, latest });
        }
        // Sent under the lock: a new subscriber gets this message once, as the latest or as news.
        let _ = self.0.samples.send(sample);
    }

    /// Checks whether anybody reads the feed.
    #[must_use]
    pub(super) fn is_read(&self) -> bool {
        self.0.samples.receiver_count() > 0
    }

    /// Subscribes to the feed. Returns the topics so far and the messages from now on.
    #[must_use]
    pub fn subscribe(&self) -> (Vec<Topic>, broadcast::Receiver<Arc<Sample>>) {
        let topics = self.lock();
        (topics.values().cloned().collect(), self.0.samples.subscribe())
    }

    /// Returns the topic with this number.
    #[must_use]
    pub fn topic(&self, number: u32) -> Option<Topic> {
        self.lock().values().find(|topic| topic.number == number).cloned()
    }

    /// Returns the topics; a panic of another thread leaves them usable.
    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Topic>> {
        self.0.topics.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_subscriber_gets_latest_message_once() {
        let feed = Feed::default();
        feed.send("/tf", Kind::Transforms, 1, &[1]);
        feed.send("/phase", Kind::TaskPhase, 2, &[2]);
        feed.send("/tf", Kind::Transforms, 3, &[3]);

        let (topics, mut news) = feed.subscribe();
        feed.send("/phase", Kind::TaskPhase, 4, &[4]);

        let known: Vec<_> =
            topics.iter().map(|t| (t.name.as_str(), t.number, t.latest.time)).collect();
        assert_eq!(known, [("/phase", 2, 2), ("/tf", 1, 3)]);
        assert_eq!(*news.try_recv().unwrap(), Sample { topic: 2, time: 4, data: vec![4] });
        assert!(news.try_recv().is_err());
    }

    /// The recorder sends while a subscriber reads nothing.
    #[test]
    fn slow_subscriber_misses_oldest_messages() {
        let feed = Feed::default();
        let (_, mut news) = feed.subscribe();
        for time in 0..WAITING as u64 + 10 {
            feed.send("/tf", Kind::Transforms, time, &[]);
        }

        let missed = news.try_recv().unwrap_err();
        assert_eq!(missed, broadcast::error::TryRecvError::Lagged(10));
        assert_eq!(news.try_recv().unwrap().time, 10);
        assert!(feed.is_read());
        drop(news);
        assert!(!feed.is_read());
    }
}
