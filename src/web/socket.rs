//! One page's WebSocket: what goes out, what comes in, and who commands.
//!
//! Out, JSON objects with one key each: `stage` at first and whenever it changes; `snapshot`, without the plan and the messages; `plan` when it
//! changes; `messages`, only those that this page has not had; `seat` when the right to command changes; `refused` with
//! a reason. In: [`Command`]s, and `{"seat":"take"}` or `{"seat":"leave"}`.

use super::Shared;
use super::line::Line;
use crate::desk::Desk;
use crate::operator::{Command, Message, PlanLine, Snapshot, Stage};
use axum::extract::ws::{self, WebSocket, WebSocketUpgrade};
use axum::extract::{ConnectInfo, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use futures_util::{Sink, SinkExt as _, Stream, StreamExt as _};
use serde::Deserialize;
use serde_json::json;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;

/// The longest message that a page may send: an answer with 54 stickers has 150 bytes.
const LONGEST: usize = 4096;
/// Refusals that a page may have ahead of it.
const REFUSALS: usize = 16;
/// Time between two snapshots to one page.
const INTERVAL: Duration = Duration::from_millis(50);
/// A page that says nothing for this long loses its right to command.
const SILENCE: Duration = Duration::from_secs(15);
/// One that says nothing for this long makes room: a page that is only hidden says a word each minute at least.
const GONE: Duration = Duration::from_secs(300);

/// Who commands. One page at a time; the others watch.
#[derive(Debug)]
pub(super) struct Seats {
    last: AtomicU64,
    holder: watch::Sender<Option<u64>>,
    taking: Mutex<()>,
}

impl Default for Seats {
    fn default() -> Self {
        Self { last: AtomicU64::new(0), holder: watch::channel(None).0, taking: Mutex::new(()) }
    }
}

impl Seats {
    pub(super) fn newcomer(self: &Arc<Self>) -> Seat {
        let number = self.last.fetch_add(1, Ordering::Relaxed) + 1;
        let seat = Seat { seats: Arc::clone(self), number };
        // Whoever comes first commands.
        if self.holder.borrow().is_none() {
            seat.take();
        }
        seat
    }
}

/// A page's place; it is free again when the page is gone.
pub(super) struct Seat {
    seats: Arc<Seats>,
    number: u64,
}

impl Seat {
    fn commands(&self) -> bool {
        *self.seats.holder.borrow() == Some(self.number)
    }

    fn take(&self) {
        let _one = self.seats.taking.lock().unwrap_or_else(PoisonError::into_inner);
        self.seats.holder.send_if_modified(|holder| {
            let changed = *holder != Some(self.number);
            *holder = Some(self.number);
            changed
        });
    }

    fn leave(&self) {
        self.seats.holder.send_if_modified(|holder| {
            let own = *holder == Some(self.number);
            if own {
                *holder = None;
            }
            own
        });
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.leave();
    }
}

/// `GET /ws`.
pub(super) async fn upgrade(
    State(shared): State<Shared>,
    ConnectInfo(line): ConnectInfo<Line>,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !line.becomes_page() {
        return (StatusCode::SERVICE_UNAVAILABLE, "there are too many pages\n").into_response();
    }
    // Room for a frame is made when its head has come, whatever follows.
    upgrade
        .max_message_size(LONGEST)
        .max_frame_size(LONGEST)
        .read_buffer_size(2 * LONGEST)
        .on_upgrade(move |socket| serve(socket, shared))
}

async fn serve(socket: WebSocket, shared: Shared) {
    let (news, words) = socket.split();
    converse(words, news, &shared.seats.newcomer(), &shared.desk).await;
}

/// Both sides of a page, until one has come to its end.
async fn converse<E>(
    words: impl Stream<Item = Result<ws::Message, E>> + Unpin,
    news: impl Sink<ws::Message> + Unpin,
    seat: &Seat,
    desk: &Desk,
) {
    let (refusals, refused) = mpsc::channel(REFUSALS);
    let heard = watch::channel(Instant::now()).0;
    // Side by side: whoever takes nothing of the news is heeded all the same, for what is said may be the emergency stop.
    tokio::select! {
        () = listen(words, seat, desk, &heard, &refusals) => {}
        () = tell(news, seat, desk, &heard, refused) => {}
    }
}

/// Obeys what a page says, until it is gone.
async fn listen<E>(
    mut words: impl Stream<Item = Result<ws::Message, E>> + Unpin,
    seat: &Seat,
    desk: &Desk,
    heard: &watch::Sender<Instant>,
    refusals: &mpsc::Sender<String>,
) {
    while let Some(Ok(word)) = words.next().await {
        heard.send_replace(Instant::now());
        match word {
            ws::Message::Text(text) => {
                if let Some(why) = heed(text.as_str(), seat, desk) {
                    // Who takes no answers gets none.
                    let _ = refusals.try_send(why);
                }
            }
            ws::Message::Close(_) => return,
            ws::Message::Binary(_) | ws::Message::Ping(_) | ws::Message::Pong(_) => {}
        }
    }
}

/// Tells a page what is new, until it is gone or silent for too long.
async fn tell(
    mut news: impl Sink<ws::Message> + Unpin,
    seat: &Seat,
    desk: &Desk,
    heard: &watch::Sender<Instant>,
    mut refused: mpsc::Receiver<String>,
) {
    let mut holder = seat.seats.holder.subscribe();
    let mut sent = Sent::default();
    let mut due = tokio::time::interval(INTERVAL);
    due.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    holder.mark_changed();
    loop {
        let out = tokio::select! {
            biased;
            Some(why) = refused.recv() => vec![json!({ "refused": why }).to_string()],
            changed = holder.changed() => {
                if changed.is_err() {
                    return;
                }
                let taken = holder.borrow_and_update().is_some();
                let own = seat.commands();
                vec![json!({ "seat": { "own": own, "taken": taken } }).to_string()]
            }
            _ = due.tick() => {
                let silent = heard.borrow().elapsed();
                if silent > GONE {
                    return;
                }
                if silent > SILENCE {
                    // Pages say a word every few seconds: this one is gone, or asleep.
                    seat.leave();
                }
                sent.news(desk)
            }
        };
        for text in out {
            if news.send(ws::Message::text(text)).await.is_err() {
                return;
            }
        }
    }
}

/// What a page may say.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Said {
    Command(Command),
    Seat {
        seat: SeatWord,
    },
    /// A sign of life.
    Alive {
        #[serde(rename = "alive")]
        _alive: bool,
    },
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum SeatWord {
    Take,
    Leave,
}

/// Obeys what a page says; returns why not.
pub(super) fn heed(text: &str, seat: &Seat, desk: &Desk) -> Option<String> {
    let said: Said = match serde_json::from_str(text) {
        Ok(said) => said,
        Err(_) => return Some("that is no command".to_owned()),
    };
    match said {
        Said::Alive { .. } => None,
        Said::Seat { seat: SeatWord::Take } => {
            seat.take();
            None
        }
        Said::Seat { seat: SeatWord::Leave } => {
            seat.leave();
            None
        }
        // Whoever sees danger may stop.
        Said::Command(command) if command == Command::EmergencyStop || seat.commands() => {
            let word = command.word();
            (!desk.command(command)).then(|| format!("{word}: the robot does not listen"))
        }
        Said::Command(command) => {
            Some(format!("{}: another page commands; take over first", command.word()))
        }
    }
}

/// What this page has had.
#[derive(Default)]
struct Sent {
    stage: Option<Arc<Stage>>,
    snapshot: Option<Arc<Snapshot>>,
    message: u64,
    plan: Option<Arc<Vec<PlanLine>>>,
}

impl Sent {
    /// What it has not had.
    fn news(&mut self, desk: &Desk) -> Vec<String> {
        let mut out = Vec::new();
        let stage = desk.stage.borrow().clone();
        if self.stage.as_ref().is_none_or(|had| !Arc::ptr_eq(had, &stage)) {
            out.push(json!({ "stage": *stage }).to_string());
            self.stage = Some(stage);
        }
        // What was published last is sent even when whoever published it is gone.
        let snapshot = desk.snapshots.borrow().clone();
        if self.snapshot.as_ref().is_some_and(|had| Arc::ptr_eq(had, &snapshot)) {
            return out;
        }
        self.snapshot = Some(Arc::clone(&snapshot));
        if self.plan.as_ref().is_none_or(|plan| !Arc::ptr_eq(plan, &snapshot.plan)) {
            self.plan = Some(Arc::clone(&snapshot.plan));
            out.push(json!({ "plan": *snapshot.plan }).to_string());
        }
        let last = snapshot.messages.last().map_or(0, |m| m.number);
        if last < self.message {
            // Another run, or a replay that went back.
            self.message = 0;
        }
        let fresh: Vec<&Message> =
            snapshot.messages.iter().filter(|m| m.number > self.message).collect();
        if !fresh.is_empty() || last != self.message {
            out.push(json!({ "messages": fresh }).to_string());
        }
        self.message = last;
        let rest =
            Snapshot { plan: Arc::default(), messages: Arc::default(), ..(*snapshot).clone() };
        // A snapshot has no keys that JSON cannot have.
        if let Ok(text) = serde_json::to_string(&rest) {
            out.push(format!("{{\"snapshot\":{text}}}"));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::desk::desk;
    use futures_util::stream;
    use std::convert::Infallible;
    use std::pin::Pin;
    use std::task::{Context, Poll};

    /// A page that takes nothing of what it is told.
    struct TakesNothing;

    impl Sink<ws::Message> for TakesNothing {
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
    fn a_page_that_takes_nothing_can_stop_the_robot() {
        let (desk, behind) = desk();
        let seat = Arc::new(Seats::default()).newcomer();
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
            let page = converse(Box::pin(words), TakesNothing, &seat, &desk);
            let person = async {
                // The first snapshot waits by then.
                tokio::time::sleep(4 * INTERVAL).await;
                said.send(ws::Message::text(r#"{"command":"emergency_stop"}"#)).await.unwrap();
                tokio::time::sleep(INTERVAL).await;
            };
            tokio::select! {
                () = page => panic!("the page is gone"),
                () = person => {}
            }
        });
        assert!(behind.emergency.load(Ordering::Acquire));
    }
}
