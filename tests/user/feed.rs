//! Feed of a run for other programs, as they read it: a WebSocket of the page's server.

use crate::program::program;
use futures_util::{SinkExt as _, StreamExt as _};
use serde_json::{Value, json};
use std::io::{BufRead as _, BufReader};
use std::process::{Child, Stdio};
use std::time::Duration;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

/// Longest wait for a message; a busy machine is slow.
const PATIENCE: Duration = Duration::from_secs(60);
/// Name of the protocol.
const PROTOCOL: &str = "foxglove.websocket.v1";

/// Run with a page that nobody opens.
struct Run {
    process: Child,
    /// Address of the feed, as the program prints it.
    feed: String,
}

impl Run {
    fn begin() -> Self {
        let mut command = program();
        command.args(["run", "scenarios/idle.toml", "--ui", "web", "--listen", "127.0.0.1:0"]);
        command.args(["--set", "idle.time_s=600"]);
        let mut process = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(process.stderr.take().unwrap()).lines();
        let feed = lines
            .map_while(Result::ok)
            .find_map(|line| Some(line.split_once("for Foxglove or Lichtblick: ")?.1.to_owned()));
        Self { process, feed: feed.unwrap() }
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

type Socket = WebSocketStream<MaybeTlsStream<tokio::net::TcpStream>>;

/// Connects to the feed as a page of another server does, which a person gave the address.
async fn connect(url: &str) -> Result<Socket, Error> {
    let mut request = url.into_client_request().unwrap();
    let headers = request.headers_mut();
    headers.insert("sec-websocket-protocol", PROTOCOL.parse().unwrap());
    headers.insert("origin", "https://app.foxglove.dev".parse().unwrap());
    let (socket, response) = connect_async(request).await?;
    assert_eq!(response.headers()["sec-websocket-protocol"], PROTOCOL);
    Ok(socket)
}

/// Reads messages until `wanted` returns a value for one, and returns that value.
async fn until<T>(socket: &mut Socket, mut wanted: impl FnMut(&Message) -> Option<T>) -> T {
    let reads = async {
        loop {
            let message = socket.next().await.unwrap().unwrap();
            if let Some(found) = wanted(&message) {
                return found;
            }
        }
    };
    tokio::time::timeout(PATIENCE, reads).await.unwrap()
}

/// Returns the operation of a message, as `op` names it.
fn operation(message: &Message, op: &str) -> Option<Value> {
    let value: Value = serde_json::from_str(message.to_text().ok()?).ok()?;
    (value["op"] == op).then_some(value)
}

/// Waits until a topic is advertised, and returns its channel.
async fn channel(socket: &mut Socket, topic: &str) -> Value {
    until(socket, |message| {
        let channels = operation(message, "advertise")?["channels"].take();
        channels.as_array()?.iter().find(|channel| channel["topic"] == topic).cloned()
    })
    .await
}

/// Subscribes to a channel with the number `id`, and returns the next data: time (ns) and fields.
async fn data(socket: &mut Socket, id: u32, channel: &Value) -> (u64, Vec<u8>) {
    let wanted = json!({ "id": id, "channelId": channel["id"] });
    let subscribe = json!({ "op": "subscribe", "subscriptions": [wanted] });
    socket.send(Message::text(subscribe.to_string())).await.unwrap();
    next(socket, id).await
}

/// Returns the next data of a subscription: time (ns) and fields.
async fn next(socket: &mut Socket, id: u32) -> (u64, Vec<u8>) {
    until(socket, |message| {
        let Message::Binary(bytes) = message else { return None };
        let (head, fields) = bytes.split_at(13);
        let of = u32::from_le_bytes(head[1..5].try_into().unwrap());
        let time = u64::from_le_bytes(head[5..].try_into().unwrap());
        (head[0] == 1 && of == id).then(|| (time, fields.to_vec()))
    })
    .await
}

#[tokio::test]
async fn subscriber_gets_late_and_new_messages() {
    let run = Run::begin();
    let mut socket = connect(&run.feed).await.unwrap();
    let info = until(&mut socket, |message| operation(message, "serverInfo")).await;
    assert!(info["name"].as_str().unwrap().starts_with("rubik-robot"), "{info}");

    // The description was sent once, before anybody listened.
    let robot = channel(&mut socket, "/robot_description").await;
    assert_eq!((&robot["encoding"], &robot["schemaEncoding"]), (&json!("cdr"), &json!("ros2msg")));
    let (_, text) = data(&mut socket, 1, &robot).await;
    assert!(String::from_utf8_lossy(&text).contains("<robot"));

    let mut again = connect(&run.feed).await.unwrap();
    let servo = channel(&mut again, "/postument/servo").await;
    assert_eq!(servo["schemaName"], "rubik_robot_msgs/msg/ServoTick");
    let mut last = data(&mut again, 7, &servo).await.0;
    for _ in 0..20 {
        let (time, _) = next(&mut again, 7).await;
        assert!(time > last, "{time} {last}");
        last = time;
    }
}

/// The run of a client that asks for nonsense goes on, and so does its feed.
#[tokio::test]
async fn nonsense_is_answered_and_harms_nothing() {
    let run = Run::begin();
    let mut socket = connect(&run.feed).await.unwrap();
    let servo = channel(&mut socket, "/postument/servo").await;
    for text in [
        "{",
        r#"{"op": "subscribe", "subscriptions": [{"id": 3, "channelId": 4000000000}]}"#,
        r#"{"op": "unsubscribe", "subscriptionIds": [99]}"#,
        r#"{"op": "setParameters", "parameters": []}"#,
    ] {
        socket.send(Message::text(text)).await.unwrap();
    }
    for reason in ["cannot be read", "there is no channel 4000000000"] {
        let told = until(&mut socket, |message| operation(message, "status")).await;
        assert!(told["message"].as_str().unwrap().contains(reason), "{told}");
    }

    data(&mut socket, 1, &servo).await;
}

#[tokio::test]
async fn feed_needs_the_token() {
    let run = Run::begin();
    let (address, token) = run.feed.split_once("token=").unwrap();
    let other: String = token.chars().rev().collect();
    for url in [
        address.trim_end_matches('?').to_owned(),
        format!("{address}token={other}"),
        format!("{address}token={token}&x=1"),
        format!("{address}x=1&token={token}"),
    ] {
        let Err(Error::Http(refused)) = connect(&url).await else { panic!("{url} was admitted") };
        assert_eq!(refused.status(), 403, "{url}");
    }
}
