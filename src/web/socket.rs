//! WebSocket of one page: the messages to the page, the messages from the page, and its seat (its
//! right to command or to watch).
//!
//! - out, JSON objects with one key each: `stage` at the beginning and at each change; `history`,
//!   the points of the run until now, at the beginning of a run; `timeline`, the spans of time that
//!   have changed, twice a second at most; `snapshot`,
//!   without the plan and the messages; `plan` at each change; `messages`, only those that this
//!   page has not received; `seat` when the right to command changes; `refused` with a reason;
//!   `taken` with the number of a command that the run gets; `clock`, the server's clock (ms), five
//!   times a second; `denied` with a reason, if the token is wrong
//! - in: first `{"token": TOKEN, "page": NAME}`; by the name, which is optional, the page is
//!   recognised after a lost connection; then an [`Input`] as `{"command": NAME, ...}` with its
//!   arguments beside the name, `{"seat": "take"}` and `"leave"`, the answers `"give"` and `"keep"`
//!   to a page that asks for the right to command, and `{"alive": true}`
//! - a command may have a `number`, which its answer repeats, and `sent`, the time of the server's
//!   clock at which it was given (ms): an order to move that is late is refused

use super::guard::Refused;
use super::line::{ASKS, Line};
use super::seats::Seat;
use super::shared::Shared;
use crate::desk::{Given, UiEnd};
use crate::operator::{Input, Message, PlanLine, Snapshot, Stage};
use axum::extract::ws::{self, WebSocket, WebSocketUpgrade};
use axum::extract::{ConnectInfo, State};
use axum::response::Response;
use futures_util::{Sink, SinkExt as _, Stream, StreamExt as _};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::sync::{Arc, LazyLock};
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;

/// Greatest length of a message of a page (bytes). An answer with 54 stickers has 150.
const LONGEST: usize = 4096;
/// Number of answers to commands that may wait to be sent to a page.
const ANSWERS: usize = 16;
/// Number of intervals between two messages with the server's clock. A page that gets no message
/// for longer shows that its data are out of date.
const CLOCK: u32 = 4;
/// Number of intervals between two looks for changes of the timeline.
const TIMELINE: u32 = 10;
/// Time between two snapshots to one page.
const INTERVAL: Duration = Duration::from_millis(50);
/// Time without a message from a page after which the page loses its right to command.
const SILENCE: Duration = Duration::from_secs(15);
/// Time without a message from a page after which the page is disconnected. A hidden page still
/// sends one each minute, although browsers slow down its timers.
const GONE: Duration = Duration::from_secs(300);

/// Beginning of the server's clock.
static BEGUN: LazyLock<std::time::Instant> = LazyLock::new(std::time::Instant::now);

/// Longest name that a page gives itself (bytes).
const NAME: usize = 64;

/// Answers `GET /ws`: the connection becomes a WebSocket.
pub(super) async fn upgrade(
    State(shared): State<Shared>,
    ConnectInfo(line): ConnectInfo<Line>,
    upgrade: WebSocketUpgrade,
) -> Response {
    // The library allocates a frame as soon as its head announces the length, so the length must be
    // limited.
    upgrade
        .max_message_size(LONGEST)
        .max_frame_size(LONGEST)
        .read_buffer_size(2 * LONGEST)
        .on_upgrade(move |socket| serve(socket, shared, line))
}

/// Serves one page until it is gone. The page gets a seat once it has sent the token.
async fn serve(mut socket: WebSocket, shared: Shared, line: Line) {
    // The library answers pings, and each answer restarts the time of an idle connection.
    let hello = tokio::time::timeout(ASKS, hello(&mut socket)).await.ok().flatten();
    let hello = hello.filter(|hello| shared.guard.is_token(&hello.token));
    let Some(hello) = hello else {
        let denied = json!({ "denied": Refused::Token.to_string() }).to_string();
        // A client that does not read this is cut by the limits of `line`.
        let _ = socket.send(ws::Message::text(denied)).await;
        let _ = socket.send(ws::Message::Close(None)).await;
        return;
    };
    if !line.becomes_page(shared.seats.holder()) {
        return;
    }
    let page = hello.page.filter(|page| page.len() <= NAME);
    let seat = shared.seats.newcomer(line.number(), page);
    let (to_page, from_page) = socket.split();
    let from_page = from_page.inspect(|_| line.heard());
    converse(from_page, to_page, &seat, &shared.desk).await;
}

/// The first message of a page.
#[derive(Debug, Deserialize)]
struct Hello {
    token: String,
    page: Option<String>,
}

/// Returns the first message of a page; `None` if the message is anything but a [`Hello`], or if
/// the page is gone.
async fn hello(socket: &mut WebSocket) -> Option<Hello> {
    loop {
        match socket.recv().await?.ok()? {
            ws::Message::Text(text) => return serde_json::from_str(text.as_str()).ok(),
            ws::Message::Ping(_) | ws::Message::Pong(_) => {}
            ws::Message::Binary(_) | ws::Message::Close(_) => return None,
        }
    }
}

/// Receives messages from a page and sends news to it at the same time, until one direction ends.
async fn converse<E>(
    from_page: impl Stream<Item = Result<ws::Message, E>> + Unpin,
    to_page: impl Sink<ws::Message> + Unpin,
    seat: &Seat,
    desk: &UiEnd,
) {
    let (answers, answered) = mpsc::channel(ANSWERS);
    let heard = watch::channel(Instant::now()).0;
    // The directions run concurrently: a page that reads nothing must be obeyed, too, because it
    // may press the emergency stop.
    tokio::select! {
        () = listen(from_page, seat, desk, &heard, &answers) => {}
        () = tell(to_page, seat, desk, &heard, answered) => {}
    }
}

/// Obeys the messages of a page until the page is gone. Stores the time of each message in `heard`,
/// and sends the answer to each command to `answers`.
async fn listen<E>(
    mut from_page: impl Stream<Item = Result<ws::Message, E>> + Unpin,
    seat: &Seat,
    desk: &UiEnd,
    heard: &watch::Sender<Instant>,
    answers: &mpsc::Sender<String>,
) {
    while let Some(Ok(word)) = from_page.next().await {
        heard.send_replace(Instant::now());
        match word {
            ws::Message::Text(text) => {
                if let Some(answer) = answer(text.as_str(), seat, desk) {
                    // If a page does not read its answers, further ones are dropped.
                    let _ = answers.try_send(answer);
                }
            }
            ws::Message::Close(_) => return,
            ws::Message::Binary(_) | ws::Message::Ping(_) | ws::Message::Pong(_) => {}
        }
    }
}

/// Sends answers, the right to command, the clock and snapshots to a page, until it is gone or has
/// sent nothing for too long. `heard` has the time of its last message.
async fn tell(
    mut to_page: impl Sink<ws::Message> + Unpin,
    seat: &Seat,
    desk: &UiEnd,
    heard: &watch::Sender<Instant>,
    mut answered: mpsc::Receiver<String>,
) {
    let mut changes = seat.changes();
    let mut sent = Sent::default();
    let mut ticks = 0;
    // After a slow write the next snapshot is due a whole interval later: no backlog builds up.
    let mut due = tokio::time::interval(INTERVAL);
    due.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    changes.mark_changed();
    loop {
        let out = tokio::select! {
            biased;
            Some(answer) = answered.recv() => vec![answer],
            changed = changes.changed() => {
                if changed.is_err() {
                    return;
                }
                changes.mark_unchanged();
                vec![json!({ "seat": seat.view() }).to_string()]
            }
            _ = due.tick() => {
                let silent = heard.borrow().elapsed();
                if silent > GONE {
                    return;
                }
                if silent > SILENCE {
                    // Pages send a heartbeat every few seconds, so this one is gone or asleep.
                    seat.leave();
                }
                seat.look_at_clock();
                let mut news = sent.news(desk);
                if u32::is_multiple_of(ticks, CLOCK) {
                    news.push(json!({ "clock": BEGUN.elapsed().as_millis() as u64 }).to_string());
                }
                ticks = ticks.wrapping_add(1);
                news
            }
        };
        for text in out {
            if to_page.send(ws::Message::text(text)).await.is_err() {
                return;
            }
        }
    }
}

/// A message of a page.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum PageMessage {
    Input(PageInput),
    Seat {
        seat: SeatRequest,
    },
    /// Heartbeat.
    Alive {
        #[serde(rename = "alive")]
        _alive: bool,
    },
}

/// Message of a page about the right to command.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum SeatRequest {
    /// The page takes the right, or asks for it.
    Take,
    /// The page gives up its right.
    Leave,
    /// The page consents to the request of another page.
    Give,
    /// The page refuses the request of another page.
    Keep,
}

/// An [`Input`] as a page writes it: its name, with its arguments beside it.
#[derive(Debug, Deserialize)]
#[serde(try_from = "NameBesideArguments")]
struct PageInput {
    input: Input,
    /// Number that the page gives to the command.
    number: Option<u64>,
    /// Time of the server's clock at which the command was given (ms).
    sent: Option<u64>,
}

impl PageInput {
    /// Returns the input with its time.
    fn given(self) -> Given {
        let at = self.sent.and_then(|sent| BEGUN.checked_add(Duration::from_millis(sent)));
        match at {
            Some(at) => Given::at(self.input, at),
            None => Given::untimed(self.input),
        }
    }
}

/// JSON object of an input: `command` is its name, the other keys are its arguments.
#[derive(Debug, Deserialize)]
struct NameBesideArguments {
    command: String,
    number: Option<u64>,
    sent: Option<u64>,
    #[serde(flatten)]
    arguments: Map<String, Value>,
}

impl TryFrom<NameBesideArguments> for PageInput {
    type Error = serde_json::Error;

    fn try_from(message: NameBesideArguments) -> serde_json::Result<Self> {
        let NameBesideArguments { command, number, sent, arguments } = message;
        // Serde reads a variant without fields from its name, and one with fields from an object.
        let alone = serde_json::from_value(Value::from(command.as_str()));
        let input = alone.or_else(|_| serde_json::from_value(json!({ command: arguments })))?;
        Ok(Self { input, number, sent })
    }
}

/// Returns the reason why a message of a page cannot be read.
fn unreadable(text: &str) -> String {
    // The variants of a message hide the reason of the one that was meant.
    match serde_json::from_str::<NameBesideArguments>(text) {
        Ok(message) if message.command == "parameter" => {
            let why = PageInput::try_from(message).err();
            why.map_or_else(String::new, |why| format!("parameter: {why}"))
        }
        _ => "the message is not a command".to_owned(),
    }
}

/// Returns the reason why an order of a parameter is refused under this stage.
fn unordered(input: &Input, stage: &Stage) -> Option<String> {
    let Input::Parameter { parameter, value } = input else { return None };
    let declared = stage.parameters.iter().find(|stage| stage.parameter == *parameter)?;
    let why = declared.bounds.check(*value).err()?;
    Some(format!("parameter {}: {why}", parameter.declaration().name))
}

/// Obeys a message of a page. Returns the answer to it as a JSON text to send; `None` if it needs
/// none.
fn answer(text: &str, seat: &Seat, desk: &UiEnd) -> Option<String> {
    let message = serde_json::from_str(text);
    let number = match &message {
        Ok(PageMessage::Input(input)) => input.number,
        _ => None,
    };
    let refused = match message {
        Ok(message) => obey_message(message, seat, desk),
        Err(_) => Some(unreadable(text)),
    };
    match (refused, number) {
        (Some(why), number) => Some(json!({ "refused": why, "number": number }).to_string()),
        (None, Some(number)) => Some(json!({ "taken": number }).to_string()),
        (None, None) => None,
    }
}

/// Obeys a message of a page. Returns the reason if it is refused.
pub(super) fn obey(text: &str, seat: &Seat, desk: &UiEnd) -> Option<String> {
    match serde_json::from_str(text) {
        Ok(message) => obey_message(message, seat, desk),
        Err(_) => Some(unreadable(text)),
    }
}

/// Obeys a message of a page that could be read. Returns the reason if it is refused.
fn obey_message(message: PageMessage, seat: &Seat, desk: &UiEnd) -> Option<String> {
    match message {
        PageMessage::Alive { .. } => None,
        PageMessage::Seat { seat: request } => match request {
            SeatRequest::Take => seat.take().map(str::to_owned),
            SeatRequest::Leave => {
                seat.leave();
                None
            }
            SeatRequest::Give | SeatRequest::Keep => {
                seat.answer(matches!(request, SeatRequest::Give));
                None
            }
        },
        PageMessage::Input(page) => {
            let given = page.given();
            let name = given.input.name();
            let refused = |why: &str| Some(format!("{name}: {why}"));
            // Each page may stop the arms. Any other input needs the right to command.
            if given.input != Input::EmergencyStop && !seat.commands() {
                return refused("another page commands; take over first");
            }
            seat.has_commanded();
            if let Some(why) = given.refusal() {
                return refused(&why);
            }
            if let Some(why) = unordered(&given.input, &desk.stage.borrow()) {
                return Some(why);
            }
            if desk.give(given) { None } else { refused("the run accepts no commands") }
        }
    }
}

/// Latest stage, snapshot, message, plan and history that were sent to a page.
#[derive(Default)]
struct Sent {
    stage: Option<Arc<Stage>>,
    /// Number of the last change of the history.
    changes: u64,
    /// Number of calls of [`Self::news`].
    ticks: u32,
    snapshot: Option<Arc<Snapshot>>,
    /// Latest message to the operator.
    message: Option<Message>,
    plan: Option<Arc<Vec<PlanLine>>>,
}

impl Sent {
    /// Returns stage, plan, messages and snapshot that have changed since the last call, as JSON
    /// texts to send.
    fn news(&mut self, desk: &UiEnd) -> Vec<String> {
        let mut out = Vec::new();
        let stage = desk.stage.borrow().clone();
        if self.stage.as_ref().is_none_or(|had| !Arc::ptr_eq(had, &stage)) {
            out.push(json!({ "stage": *stage }).to_string());
            let history = desk.history(
                |history| json!({ "points": history.points(), "whole": history.is_whole() }),
            );
            out.push(json!({ "history": history }).to_string());
            self.changes = 0;
            self.stage = Some(stage);
        }
        if self.ticks.is_multiple_of(TIMELINE) {
            out.extend(self.timeline(desk));
        }
        self.ticks = self.ticks.wrapping_add(1);
        // The last snapshot is sent even if the run that published it is gone.
        let snapshot = desk.snapshots.borrow().clone();
        if self.snapshot.as_ref().is_some_and(|had| Arc::ptr_eq(had, &snapshot)) {
            return out;
        }
        self.snapshot = Some(Arc::clone(&snapshot));
        if self.plan.as_ref().is_none_or(|plan| !Arc::ptr_eq(plan, &snapshot.plan)) {
            self.plan = Some(Arc::clone(&snapshot.plan));
            out.push(json!({ "plan": *snapshot.plan }).to_string());
        }
        out.extend(self.messages(&snapshot.messages));
        let rest =
            Snapshot { plan: Arc::default(), messages: Arc::default(), ..(*snapshot).clone() };
        // The serialisation cannot fail: a snapshot has no maps, whose keys might be no strings.
        if let Ok(text) = serde_json::to_string(&rest) {
            out.push(format!("{{\"snapshot\":{text}}}"));
        }
        out
    }

    /// Returns the spans of the history that have changed since the last call, as a JSON text to
    /// send; `None` if there are none.
    fn timeline(&mut self, desk: &UiEnd) -> Option<String> {
        desk.history(|history| {
            let since = std::mem::replace(&mut self.changes, history.changes());
            // Fewer changes than before belong to another run, whose stage is not here yet.
            let since = since.min(history.changes());
            let spans: Vec<_> = history.spans_since(since).collect();
            (!spans.is_empty()).then(|| json!({ "timeline": spans }).to_string())
        })
    }

    /// Returns the messages of `all` that were not sent yet as a JSON text to send; `None` if there
    /// are none. Returns all of them, or an empty list to clear the page, if they belong to another
    /// run than the latest message that was sent, or if a replay jumped back.
    fn messages(&mut self, all: &[Message]) -> Option<String> {
        let last = all.last();
        let goes_on = self.message.as_ref().is_none_or(|had| {
            let same = all.iter().find(|message| message.number == had.number);
            // A long run drops its first messages, perhaps also the latest one that was sent.
            let dropped = || all.first().is_some_and(|first| first.number > had.number);
            same.map_or_else(dropped, |same| same == had)
        });
        let had = self.message.as_ref().filter(|_| goes_on).map_or(0, |message| message.number);
        let fresh: Vec<&Message> = all.iter().filter(|message| message.number > had).collect();
        self.message = last.cloned();
        (!fresh.is_empty() || !goes_on).then(|| json!({ "messages": fresh }).to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::super::seats::Seats;
    use super::*;
    use crate::desk::Desk;
    use crate::operator::parameter::Bounds;
    use crate::operator::{Class, Manual, Parameter, ParameterStage, Step};
    use futures_util::stream;
    use std::convert::Infallible;
    use std::pin::Pin;
    use std::task::{Context, Poll};

    /// A page that reads nothing.
    struct ReadsNothing;

    impl Sink<ws::Message> for ReadsNothing {
        type Error = Infallible;
        fn poll_ready(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
            Poll::Pending
        }
        fn start_send(self: Pin<&mut Self>, _: ws::Message) -> Result<(), Infallible> {
            Ok(())
        }
        fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
            Poll::Pending
        }
        fn poll_close(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
            Poll::Pending
        }
    }

    #[test]
    fn page_that_reads_nothing_can_stop_the_robot() {
        let (ui, run) = Desk::default().ends();
        let seat = Arc::new(Seats::default()).newcomer(0, None);
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .start_paused(true)
            .build()
            .unwrap();
        runtime.block_on(async {
            let (said, words) = mpsc::channel(1);
            let words = stream::unfold(words, |mut words| async {
                words.recv().await.map(|word| (Ok::<_, Infallible>(word), words))
            });
            let page = converse(Box::pin(words), ReadsNothing, &seat, &ui);
            let person = async {
                // After this time the first snapshot waits to be read.
                tokio::time::sleep(4 * INTERVAL).await;
                said.send(ws::Message::text(r#"{"command":"emergency_stop"}"#)).await.unwrap();
                tokio::time::sleep(INTERVAL).await;
            };
            tokio::select! {
                () = page => panic!("the page has closed"),
                () = person => {}
            }
        });
        assert!(run.stop_signal().is_pressed());
    }

    #[test]
    fn page_messages_become_inputs() {
        let read = |text: &str| match serde_json::from_str(text) {
            Ok(PageMessage::Input(page)) => Some(page.input),
            _ => None,
        };
        let jog =
            r#"{"command":"manual","effector":1,"order":{"order":"joint","axis":2,"by":0.1}}"#;
        let order = Manual::Joint(Step { axis: 2, by: 0.1 });
        assert_eq!(read(jog), Some(Input::Manual { effector: 1, order }));
        for (text, input) in [
            (r#"{"command":"start"}"#, Input::Start),
            (r#"{"command":"pause"}"#, Input::Pause),
            (r#"{"command":"resume"}"#, Input::Resume),
            (r#"{"command":"terminate"}"#, Input::Terminate),
            (r#"{"command":"emergency_stop"}"#, Input::EmergencyStop),
            (r#"{"command":"speed","factor":2}"#, Input::Speed { factor: 2.0 }),
            (r#"{"command":"quit"}"#, Input::Quit),
            (r#"{"command":"seek","time":1.5}"#, Input::Seek { time: 1.5 }),
            // A stop is obeyed even with arguments that it does not have.
            (r#"{"command":"emergency_stop","factor":2}"#, Input::EmergencyStop),
        ] {
            assert_eq!(read(text), Some(input), "{text}");
        }
        for text in [
            r#"{"command":"format_disk"}"#,
            r#"{"command":"speed"}"#,
            r#"{"command":"answer","question":1,"answer":{"answer":"stickers","stickers":"U"}}"#,
            r#""pause""#,
        ] {
            assert_eq!(read(text), None, "{text}");
        }
    }

    /// Refusals of orders of a parameter name the reason; only the page that commands may order.
    #[test]
    fn parameter_orders_are_refused_with_reason() {
        let (ui, run) = Desk::default().ends();
        let grip = ParameterStage {
            parameter: Parameter::Grip,
            unit: "N".into(),
            meaning: String::new(),
            rate: 5.0,
            bounds: Bounds { usual: 40.0, least: 30.0, most: 55.0 },
        };
        run.stage.send_replace(Arc::new(Stage { parameters: vec![grip], ..Stage::default() }));
        let seats = Arc::new(Seats::default());
        let (first, second) = (seats.newcomer(0, None), seats.newcomer(1, None));
        let order = |parameter: &str, value: &str, seat: &Seat| {
            let text =
                format!(r#"{{"command":"parameter","parameter":"{parameter}","value":{value}}}"#);
            obey(&text, seat, &ui)
        };

        for (parameter, value, reason) in [
            ("grip", "45", "parameter: unknown variant `grip`, expected one of `grip_n`"),
            ("grip_n", "\"firm\"", "parameter: invalid type: string \"firm\", expected f64"),
            ("grip_n", "null", "parameter: invalid type: null, expected f64"),
            ("grip_n", "1e999", "the message is not a command"),
            ("grip_n", "55.5", "parameter grip_n: 55.5 is outside 30..55"),
        ] {
            let refused = order(parameter, value, &first).unwrap();
            assert!(refused.starts_with(reason), "{parameter} {value}: {refused}");
        }
        let refused = order("grip_n", "45", &second);
        assert_eq!(refused.as_deref(), Some("parameter: another page commands; take over first"));
        assert_eq!(order("grip_n", "45", &first), None);

        let mut inputs = run.take_inputs().unwrap();
        let given = Input::Parameter { parameter: Parameter::Grip, value: 45.0 };
        assert_eq!(inputs.try_recv(), Ok(given));
        assert!(inputs.try_recv().is_err(), "no other order reaches the run");
    }

    #[test]
    fn late_order_to_move_is_refused() {
        let (ui, run) = Desk::default().ends();
        let seat = Arc::new(Seats::default()).newcomer(0, None);
        let now = BEGUN.elapsed().as_millis() as u64;
        let told = |command: &str, sent: u64| {
            let text = format!(r#"{{"command":"{command}","number":7,"sent":{sent}}}"#);
            answer(&text, &seat, &ui).unwrap()
        };
        std::thread::sleep(Duration::from_millis(600));

        let late = told("resume", now);
        assert!(late.contains("late") && late.contains(r#""number":7"#), "{late}");
        // A stop counts whatever its age, and a clock that is ahead makes nothing late.
        for (command, sent) in [("emergency_stop", now), ("pause", now), ("resume", now + 60_000)] {
            assert_eq!(told(command, sent), r#"{"taken":7}"#, "{command}");
        }
        let mut inputs = run.take_inputs().unwrap();
        let read = std::iter::from_fn(|| inputs.try_recv().ok()).collect::<Vec<_>>();
        assert_eq!(read, [Input::EmergencyStop, Input::Pause, Input::Resume]);
    }

    #[test]
    fn only_new_messages_are_sent_until_another_run() {
        let message = |number: u64, text: &str| Message {
            number,
            time: 0.0,
            class: Class::Info,
            source: "mp".to_owned(),
            text: text.to_owned(),
        };
        let mut sent = Sent::default();
        let mut numbers = |all: &[Message]| {
            let text = sent.messages(all)?;
            let json: Value = serde_json::from_str(&text).unwrap();
            let fresh = json["messages"].as_array().unwrap();
            Some(fresh.iter().map(|m| m["number"].as_u64().unwrap()).collect::<Vec<_>>())
        };

        assert_eq!(numbers(&[]), None);
        assert_eq!(numbers(&[message(1, "a"), message(2, "b")]), Some(vec![1, 2]));
        assert_eq!(numbers(&[message(1, "a"), message(2, "b")]), None);
        assert_eq!(numbers(&[message(2, "b"), message(3, "c")]), Some(vec![3]));
        assert_eq!(numbers(&[message(5, "e")]), Some(vec![5]), "messages may be missing");
        // These are messages of another run, in which the same numbers occur.
        let others: Vec<Message> = (1..=6).map(|number| message(number, "other")).collect();
        assert_eq!(numbers(&others), Some(vec![1, 2, 3, 4, 5, 6]));
        // A replay jumped back to before the first message.
        assert_eq!(numbers(&[]), Some(vec![]));
    }
}
