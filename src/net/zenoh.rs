//! Links over a network by zenoh.
//!
//! The nodes find each other by the endpoints of the scenario alone: there is no scouting, so a
//! session never joins another one that happens to be on the network. A file of zenoh's own
//! settings adds certificates and access rules.
//!
//! | lane | congestion | priority | reason |
//! |---|---|---|---|
//! | messages | block | interactive | each one must arrive |
//! | values | drop | real-time | a late beat is worth less than the next one |
//! | pictures | drop | background | a large parcel holds up all others of its priority |
//!
//! Each lane has a thread of its own, so that values do not wait for messages. A full lane of
//! values or pictures drops new ones.
//!
//! - in: endpoints, parcels
//! - out: parcels

use super::link::{End, Lane, Link, Message, Meter, Parcels, Traffic};
use crate::error::panic_text;
use std::fmt;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc;
use tokio::sync::mpsc::UnboundedSender;
use zenoh::Wait as _;
use zenoh::config::Config;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};

/// Number of values that wait on a full link: those of about half a second.
const VALUES: usize = 64;
/// Number of pictures that wait on a full link.
const PICTURES: usize = 2;
/// Greatest size of an attachment that is read (bytes). A longer one counts as none.
const ATTACHMENT: usize = 256;

/// Session of a node with its peers.
///
/// Zenoh refuses to work on a thread of a runtime with one thread, as that of the actors is: all
/// calls have threads of their own.
pub struct Session(Option<zenoh::Session>);

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Session").finish()
    }
}

/// Opens a session that listens at `listen` and connects to `connect`, both endpoints as zenoh
/// writes them, such as `tcp/127.0.0.1:7447`. `settings` is a file of zenoh's own settings.
///
/// # Errors
/// The reason, if the file cannot be read or an endpoint cannot be opened.
pub fn open(listen: &[&str], connect: &[&str], settings: Option<&Path>) -> Result<Session, String> {
    let config = match settings {
        Some(path) => {
            Config::from_file(path).map_err(|why| format!("{}: {why}", path.display()))?
        }
        None => Config::default(),
    };
    let listed = |endpoints: &[&str]| {
        let quoted: Vec<_> = endpoints.iter().map(|endpoint| format!("{endpoint:?}")).collect();
        format!("[{}]", quoted.join(","))
    };
    let given = [
        ("mode", "\"peer\"".to_owned()),
        ("listen/endpoints", listed(listen)),
        ("connect/endpoints", listed(connect)),
    ];
    session(config, given)
}

/// Opens a session with these keys in its settings, and without scouting.
///
/// # Errors
/// The reason, if a key is refused or an endpoint cannot be opened.
fn session<const N: usize>(
    mut config: Config,
    given: [(&str, String); N],
) -> Result<Session, String> {
    let scouting = ["scouting/multicast/enabled", "scouting/gossip/enabled"];
    let scouting = scouting.map(|key| (key, "false".to_owned()));
    for (key, value) in given.into_iter().chain(scouting) {
        config.insert_json5(key, &value).map_err(|why| format!("{key} = {value}: {why}"))?;
    }
    let opened = outside(move || zenoh::open(config).wait())?;
    opened.map(|session| Session(Some(session))).map_err(|why| why.to_string())
}

/// Opens a session as a client of the router at the endpoint `router`.
///
/// # Errors
/// The reason, if the router does not answer.
pub fn open_client(router: &str) -> Result<Session, String> {
    let given = [("mode", "\"client\"".to_owned()), ("connect/endpoints", format!("[{router:?}]"))];
    session(Config::default(), given)
}

/// Sign of life of something that others look for.
#[derive(Debug)]
pub struct Token(Option<zenoh::liveliness::LivelinessToken>);

impl Drop for Token {
    fn drop(&mut self) {
        let token = self.0.take();
        // The session ends soon, and its tokens with it.
        let _ = outside(move || drop(token));
    }
}

/// Publisher of a topic.
#[derive(Debug)]
pub struct Topic(Publisher<'static>);

impl Topic {
    /// Publishes data with an attachment. A full network drops it.
    ///
    /// # Errors
    /// If the session has ended.
    pub fn put(&self, data: &[u8], attachment: &[u8]) -> Result<(), String> {
        let put = self.0.put(data.to_vec()).attachment(attachment.to_vec());
        put.wait().map_err(|why| why.to_string())
    }
}

/// Subscription of keys, which ends when it is dropped.
pub struct Subscription(Option<Subscriber<()>>);

impl fmt::Debug for Subscription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Subscription").finish()
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        let subscriber = self.0.take();
        // The session ends soon: a subscriber that cannot be withdrawn is left to it.
        let _ = outside(move || drop(subscriber));
    }
}

/// Does `work` on a thread of its own, and waits for it.
///
/// # Errors
/// If the system gives no thread, or the work panicked.
fn outside<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, String> {
    let thread = std::thread::Builder::new().name("network".to_owned()).spawn(work);
    let thread = thread.map_err(|why| why.to_string())?;
    thread.join().map_err(|why| panic_text(&*why))
}

impl Drop for Session {
    fn drop(&mut self) {
        let session = self.0.take();
        // The process ends soon: a session that cannot be closed is left to it.
        let _ = outside(move || drop(session));
    }
}

/// Link over a session.
struct Carrier {
    messages: mpsc::Sender<Vec<u8>>,
    values: mpsc::SyncSender<Vec<u8>>,
    pictures: mpsc::SyncSender<Vec<u8>>,
    meter: Meter,
}

impl fmt::Debug for Carrier {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Carrier").finish_non_exhaustive()
    }
}

impl Link for Carrier {
    fn send(&self, lane: Lane, parcel: Vec<u8>) {
        match lane {
            // The threads end only with these senders.
            Lane::Messages => drop(self.messages.send(parcel)),
            Lane::Values => drop(self.values.try_send(parcel)),
            Lane::Pictures => drop(self.pictures.try_send(parcel)),
        }
    }

    fn traffic(&self) -> Traffic {
        self.meter.traffic()
    }
}

impl Session {
    /// Returns the session itself.
    ///
    /// # Errors
    /// If it has ended.
    fn open(&self) -> Result<&zenoh::Session, String> {
        self.0.as_ref().ok_or_else(|| "the session has ended".to_owned())
    }

    /// Returns the identity of the session.
    ///
    /// # Errors
    /// If the session has ended.
    pub fn identity(&self) -> Result<String, String> {
        Ok(self.open()?.zid().to_string())
    }

    /// Declares a token, by which others see that something lives.
    ///
    /// # Errors
    /// If the session has ended, or the key has a wrong form.
    pub fn token(&self, key: String) -> Result<Token, String> {
        let session = self.open()?.clone();
        let declared = outside(move || session.liveliness().declare_token(key).wait())?;
        declared.map(|token| Token(Some(token))).map_err(|why| why.to_string())
    }

    /// Declares the publisher of a topic.
    ///
    /// # Errors
    /// If the session has ended, or the key has a wrong form.
    pub fn topic(&self, key: String) -> Result<Topic, String> {
        let declared = self.open()?.declare_publisher(key);
        let declared = declared.congestion_control(CongestionControl::Drop).wait();
        declared.map(Topic).map_err(|why| why.to_string())
    }

    /// Subscribes to all keys that match `keys`. `take` gets each message of at most `largest`
    /// bytes, and `None` for the data of a larger one. It must not wait.
    ///
    /// # Errors
    /// If the session has ended, or the expression has a wrong form.
    pub fn subscribe(
        &self,
        keys: String,
        largest: usize,
        take: impl Fn(Message) + Send + Sync + 'static,
    ) -> Result<Subscription, String> {
        let session = self.open()?.clone();
        let receive = move |sample: zenoh::sample::Sample| {
            let payload = sample.payload();
            let data = (payload.len() <= largest).then(|| payload.to_bytes().into_owned());
            let attachment = sample.attachment().filter(|bytes| bytes.len() <= ATTACHMENT);
            let attachment = attachment.map(|bytes| bytes.to_bytes().into_owned());
            let key = sample.key_expr().as_str().to_owned();
            take(Message { key, data, attachment: attachment.unwrap_or_default() });
        };
        let declared = outside(move || session.declare_subscriber(keys).callback(receive).wait())?;
        declared.map(|subscriber| Subscription(Some(subscriber))).map_err(|why| why.to_string())
    }

    /// Opens an end of the link to the node `name`, and returns it with the parcels that arrive.
    ///
    /// # Errors
    /// The reason, if the session has ended or the system gives no thread.
    pub fn link(&self, name: &str, end: End) -> Result<(Arc<dyn Link>, Parcels), String> {
        let session = self.0.clone().ok_or("the session has ended")?;
        let (arrive, arriving) = tokio::sync::mpsc::unbounded_channel();
        let meter = Meter::default();
        let declare = {
            let (name, meter) = (name.to_owned(), meter.clone());
            move || Ends::declare(&session, &name, end, (&arrive, &meter))
        };
        let ends = outside(declare)?.map_err(|why| why.to_string())?;
        let Ends { publishers: [messages, values, pictures], receivers } = ends;
        let carried = |parcels, publisher| {
            let meter = meter.clone();
            move || carry(&parcels, &publisher, &meter)
        };
        let (to_messages, sent) = mpsc::channel();
        // A full link makes this thread wait, never an actor.
        spawn(format!("messages {name}"), carried(sent, messages))?;
        let (to_pictures, sent) = mpsc::sync_channel(PICTURES);
        spawn(format!("pictures {name}"), carried(sent, pictures))?;
        let (to_values, sent) = mpsc::sync_channel(VALUES);
        let work = carried(sent, values);
        spawn(format!("values {name}"), move || {
            work();
            // The receivers end with the link.
            drop(receivers);
        })?;
        let (messages, values, pictures) = (to_messages, to_values, to_pictures);
        Ok((Arc::new(Carrier { messages, values, pictures, meter }), arriving))
    }
}

/// Publishers and subscribers of one end of a link.
struct Ends {
    /// Publishers of the lanes, in the order of [`LANES`].
    publishers: [Publisher<'static>; 3],
    receivers: Vec<Subscriber<()>>,
}

/// Lanes, each with its word in keys, its congestion control and its priority. The messages are
/// first: a peer that knows of the other lanes knows of the messages.
const LANES: [(Lane, &str, CongestionControl, Priority); 3] = [
    (Lane::Messages, "messages", CongestionControl::Block, Priority::InteractiveHigh),
    (Lane::Values, "values", CongestionControl::Drop, Priority::RealTime),
    (Lane::Pictures, "pictures", CongestionControl::Drop, Priority::Background),
];

impl Ends {
    /// Declares them; `arrive` takes the parcels that arrive, and `meter` counts them.
    fn declare(
        session: &zenoh::Session,
        name: &str,
        end: End,
        (arrive, meter): (&UnboundedSender<(Lane, Vec<u8>)>, &Meter),
    ) -> Result<Self, zenoh::Error> {
        let key = |end: End, lane: &str| format!("rubik-robot/{name}/{}/{lane}", end.word());
        let mut receivers = Vec::new();
        for (lane, word, ..) in LANES {
            let (arrive, meter) = (arrive.clone(), meter.clone());
            let receive = move |sample: zenoh::sample::Sample| {
                let parcel = sample.payload().to_bytes().into_owned();
                meter.received(&parcel);
                let _ = arrive.send((lane, parcel));
            };
            let subscriber = session.declare_subscriber(key(end.other(), word));
            receivers.push(subscriber.callback(receive).wait()?);
        }
        let publisher = |i: usize| {
            let (lane, word, congestion, priority) = LANES[i];
            let publisher = session.declare_publisher(key(end, word));
            // A picture may wait until a batch is full.
            let express = lane != Lane::Pictures;
            publisher.congestion_control(congestion).priority(priority).express(express).wait()
        };
        Ok(Self { publishers: [publisher(0)?, publisher(1)?, publisher(2)?], receivers })
    }
}

/// Starts a thread of a link.
///
/// # Errors
/// If the system gives no thread.
fn spawn(name: String, work: impl FnOnce() + Send + 'static) -> Result<(), String> {
    let thread = std::thread::Builder::new().name(name).spawn(work);
    thread.map(drop).map_err(|why| why.to_string())
}

/// Publishes parcels until their sender ends, and counts them.
fn carry(parcels: &mpsc::Receiver<Vec<u8>>, publisher: &Publisher<'static>, meter: &Meter) {
    while let Ok(parcel) = parcels.recv() {
        meter.sent(&parcel);
        if let Err(why) = publisher.put(parcel).wait() {
            tracing::error!("a parcel to another node was not sent: {why}");
        }
    }
}
