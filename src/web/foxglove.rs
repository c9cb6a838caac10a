//! WebSocket for programs that show data of robots, such as Foxglove and Lichtblick: the messages
//! of a recording while the run goes on. It takes no commands.
//!
//! - out: `serverInfo`; `advertise` for each topic, before its first message; binary messages of
//!   the topics to which the client has subscribed, the latest one of a topic at once
//! - in: `subscribe` and `unsubscribe`; all other operations are ignored
//! - a client that is slow misses messages; no run waits for it
//! - source: protocol `foxglove.websocket.v1`

use super::line::Line;
use super::shared::Shared;
use crate::record::feed::{Feed, Sample, Topic};
use axum::extract::ws::{self, WebSocket, WebSocketUpgrade};
use axum::extract::{ConnectInfo, State};
use axum::response::Response;
use serde::Deserialize;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use tokio::sync::broadcast::error::RecvError;

/// Names of the protocol: that of its specification, and that of newer clients, which differs only
/// in operations that this server does not offer.
const PROTOCOLS: [&str; 2] = ["foxglove.websocket.v1", "foxglove.sdk.v1"];
/// Greatest length of a message of a client (bytes): subscriptions to some hundred topics.
const LONGEST: usize = 64 * 1024;
/// First byte of a binary message with data of a topic.
const MESSAGE_DATA: u8 = 1;

/// Answers `GET /foxglove`: the connection becomes a WebSocket. The guard has checked its token.
pub(super) async fn upgrade(
    State(shared): State<Shared>,
    ConnectInfo(line): ConnectInfo<Line>,
    upgrade: WebSocketUpgrade,
) -> Response {
    upgrade.protocols(PROTOCOLS).max_message_size(LONGEST).max_frame_size(LONGEST).on_upgrade(
        move |socket| async move {
            if line.becomes_page(shared.seats.holder()) {
                serve(socket, &shared.desk.feed, &line).await;
            }
        },
    )
}

/// Operation that a client asks for.
#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Operation {
    Subscribe {
        subscriptions: Vec<Wanted>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

/// Subscription to a topic. The client chooses its number.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Wanted {
    id: u32,
    channel_id: u32,
}

/// State of a client.
#[derive(Debug, Default)]
struct Client {
    /// Topics of which the client knows.
    advertised: BTreeSet<u32>,
    /// Topic of each subscription.
    subscriptions: BTreeMap<u32, u32>,
}

/// Serves one client until it is gone.
async fn serve(mut socket: WebSocket, feed: &Feed, line: &Line) {
    let (topics, mut news) = feed.subscribe();
    let mut client = Client::default();
    for message in [server_info(), client.advertise(&topics)] {
        if socket.send(message).await.is_err() {
            return;
        }
    }
    loop {
        let answers = tokio::select! {
            asked = socket.recv() => match asked {
                Some(Ok(message)) => {
                    line.heard();
                    client.obey(&message, feed)
                }
                _ => return,
            },
            sample = news.recv() => match sample {
                Ok(sample) => client.pass_on(&sample, feed),
                // The client is slow: it goes on with the oldest message that waits.
                Err(RecvError::Lagged(_)) => continue,
                Err(RecvError::Closed) => return,
            },
        };
        for answer in answers {
            if socket.send(answer).await.is_err() {
                return;
            }
        }
    }
}

impl Client {
    /// Returns the message that tells the client of topics.
    fn advertise(&mut self, topics: &[Topic]) -> ws::Message {
        self.advertised.extend(topics.iter().map(|topic| topic.number));
        let channels: Vec<_> = topics
            .iter()
            .map(|topic| {
                json!({
                    "id": topic.number,
                    "topic": topic.name,
                    "encoding": "cdr",
                    "schemaName": topic.kind.name(),
                    "schema": topic.kind.schema(),
                    "schemaEncoding": "ros2msg",
                })
            })
            .collect();
        ws::Message::text(json!({ "op": "advertise", "channels": channels }).to_string())
    }

    /// Carries out an operation of the client and returns the answers.
    fn obey(&mut self, message: &ws::Message, feed: &Feed) -> Vec<ws::Message> {
        let ws::Message::Text(text) = message else { return Vec::new() };
        match serde_json::from_str(text.as_str()) {
            Ok(Operation::Subscribe { subscriptions }) => {
                let mut latest = Vec::new();
                for Wanted { id, channel_id } in subscriptions {
                    let Some(topic) = feed.topic(channel_id) else {
                        latest.push(status(&format!("there is no channel {channel_id}")));
                        continue;
                    };
                    self.subscriptions.insert(id, channel_id);
                    latest.push(data(id, &topic.latest));
                }
                latest
            }
            Ok(Operation::Unsubscribe { subscription_ids }) => {
                for id in subscription_ids {
                    self.subscriptions.remove(&id);
                }
                Vec::new()
            }
            Ok(Operation::Other) => Vec::new(),
            Err(why) => vec![status(&format!("the message cannot be read: {why}"))],
        }
    }

    /// Returns the messages with which a sample goes to the client.
    fn pass_on(&mut self, sample: &Sample, feed: &Feed) -> Vec<ws::Message> {
        let mut messages = Vec::new();
        if !self.advertised.contains(&sample.topic)
            && let Some(topic) = feed.topic(sample.topic)
        {
            messages.push(self.advertise(&[topic]));
        }
        let subscribed = self.subscriptions.iter().filter(|(_, topic)| **topic == sample.topic);
        messages.extend(subscribed.map(|(id, _)| data(*id, sample)));
        messages
    }
}

/// Returns the first message to a client.
fn server_info() -> ws::Message {
    let info = json!({
        "op": "serverInfo",
        "name": concat!("rubik-robot ", env!("CARGO_PKG_VERSION")),
        "capabilities": [],
        "supportedEncodings": ["cdr"],
    });
    ws::Message::text(info.to_string())
}

/// Returns a message about an error of the client.
fn status(text: &str) -> ws::Message {
    /// Level of an error in this protocol.
    const ERROR: u8 = 2;
    ws::Message::text(json!({ "op": "status", "level": ERROR, "message": text }).to_string())
}

/// Returns the binary message of a sample for a subscription: its number, the time (ns), the data.
fn data(subscription: u32, sample: &Sample) -> ws::Message {
    let mut bytes = Vec::with_capacity(13 + sample.data.len());
    bytes.push(MESSAGE_DATA);
    bytes.extend(subscription.to_le_bytes());
    bytes.extend(sample.time.to_le_bytes());
    bytes.extend(&sample.data);
    ws::Message::Binary(bytes.into())
}
