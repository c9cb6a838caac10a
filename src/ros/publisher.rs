//! Publisher of a feed to ROS 2, in a thread of its own.

use super::joints::AllJoints;
use super::names::{Names, attachment};
use crate::net::{self, RosPlace, Session, Token, Topic};
use crate::record::feed::{Feed, Sample};
use crate::record::schema::Kind;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::sync::broadcast::error::TryRecvError;

/// Time between two looks for new messages.
const PAUSE: Duration = Duration::from_millis(2);
/// Time after which a topic that holds for the whole run is sent again.
const AGAIN: Duration = Duration::from_secs(1);

/// Publisher of a feed, which ends when it is dropped.
#[derive(Debug)]
pub struct Publisher {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Publisher {
    /// Publishes a feed in the domain and over the router of a place.
    ///
    /// # Errors
    /// The reason, if the router does not answer or this build has no network.
    pub fn start(feed: Feed, place: &RosPlace) -> Result<Self, String> {
        let ends = Arc::new(AtomicBool::new(false));
        let (opened, result) = mpsc::channel();
        let (RosPlace { router, domain }, over) = (place.clone(), Arc::clone(&ends));
        let thread = std::thread::Builder::new().name("ros".to_owned()).spawn(move || {
            let session = net::open_client(&router).and_then(|session| {
                Outlet::new(session, domain).map_err(|why| format!("{router}: {why}"))
            });
            match session {
                Ok(outlet) => {
                    let _ = opened.send(Ok(()));
                    outlet.publish(&feed, &over);
                }
                Err(why) => drop(opened.send(Err(why))),
            }
        });
        let thread = thread.map_err(|why| why.to_string())?;
        result.recv().map_err(|_| "the thread of the topics has ended".to_owned())??;
        Ok(Self { ends, thread: Some(thread) })
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Session with the publishers of all topics so far.
struct Outlet {
    names: Names,
    joints: AllJoints,
    topics: BTreeMap<u32, Published>,
    session: Session,
    _node: Token,
}

/// Publisher of a topic.
struct Published {
    topic: Topic,
    kind: Kind,
    /// Number of messages so far.
    count: u64,
    latest: Option<Arc<Sample>>,
    name: String,
    _token: Token,
}

impl Outlet {
    /// Makes the node over a session.
    ///
    /// # Errors
    /// If the session has ended.
    fn new(session: Session, domain: u32) -> Result<Self, String> {
        let names = Names { domain, session: session.identity()? };
        let node = session.token(names.node())?;
        let (joints, topics) = (AllJoints::default(), BTreeMap::new());
        Ok(Self { names, joints, topics, session, _node: node })
    }

    /// Publishes a feed until `over` is set.
    fn publish(mut self, feed: &Feed, over: &AtomicBool) {
        let (topics, mut news) = feed.subscribe();
        for topic in topics {
            self.send(feed, &topic.latest);
        }
        let mut again = Instant::now() + AGAIN;
        loop {
            // The last messages of the run are sent before the end.
            let ends = over.load(Ordering::Acquire);
            loop {
                match news.try_recv() {
                    Ok(sample) => self.send(feed, &sample),
                    Err(TryRecvError::Lagged(_)) => {}
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Closed) => return,
                }
            }
            if ends {
                return;
            }
            if Instant::now() >= again {
                again = Instant::now() + AGAIN;
                self.repeat();
            }
            std::thread::sleep(PAUSE);
        }
    }

    /// Sends a message, as the first one of its topic after its publisher is declared.
    fn send(&mut self, feed: &Feed, sample: &Arc<Sample>) {
        if !self.topics.contains_key(&sample.topic) {
            let Some(topic) = feed.topic(sample.topic) else { return };
            match self.declare(&topic.name, topic.number, topic.kind) {
                Ok(published) => drop(self.topics.insert(topic.number, published)),
                Err(why) => {
                    tracing::warn!("the topic {} is not published: {why}", topic.name);
                    return;
                }
            }
        }
        if let Some(published) = self.topics.get_mut(&sample.topic) {
            if published.kind == Kind::JointState {
                let data = self.joints.merged(&sample.data, sample.time);
                published.put(&data, &self.names);
            } else {
                published.put(&sample.data, &self.names);
            }
            published.latest = Some(Arc::clone(sample));
        }
    }

    /// Declares the publisher of a topic.
    ///
    /// # Errors
    /// If the session has ended.
    fn declare(&self, name: &str, number: u32, kind: Kind) -> Result<Published, String> {
        let token = self.session.token(self.names.publisher(number, name, kind))?;
        let topic = self.session.topic(self.names.data(name, kind))?;
        Ok(Published { topic, kind, count: 0, latest: None, name: name.to_owned(), _token: token })
    }

    /// Sends the topics again that hold for the whole run.
    fn repeat(&mut self) {
        for published in self.topics.values_mut() {
            if let Some(latest) = published.latest.clone().filter(|_| published.holds()) {
                published.put(&latest.data, &self.names);
            }
        }
    }
}

impl Published {
    /// Returns whether the latest message of the topic holds for the whole run.
    fn holds(&self) -> bool {
        let holds = ["/robot_description", "/tf_static"].contains(&self.name.as_str());
        holds || self.kind == Kind::CameraInfo
    }

    /// Sends a message.
    fn put(&mut self, data: &[u8], names: &Names) {
        self.count += 1;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let attached = attachment(self.count, now.as_nanos() as u64, identity(names, &self.name));
        if let Err(why) = self.topic.put(data, &attached) {
            tracing::warn!("a message of {} was not published: {why}", self.name);
        }
    }
}

/// Returns the identity of the publisher of a topic.
fn identity(names: &Names, topic: &str) -> [u8; 16] {
    let hash = crc32fast::hash(format!("{} {topic}", names.session).as_bytes());
    let mut bytes = [0; 16];
    let session = names.session.as_bytes();
    let taken = session.len().min(12);
    bytes[..taken].copy_from_slice(&session[..taken]);
    bytes[12..].copy_from_slice(&hash.to_le_bytes());
    bytes
}
