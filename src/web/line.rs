//! Limits of the connections to the page's server: their number, and the time for which one may be
//! idle.
//!
//! Each connection takes a file descriptor. Some must stay free for the world's file, for the
//! recording, and for the operator who wants to press the emergency stop.
//!
//! | case | limit | consequence |
//! |---|---|---|
//! | all connections | [`MOST`] | a new one displaces the one that has been idle for longest |
//! | ... from this machine, or from others | [`SIDE`] | as above; the other side finds a place |
//! | pages with a WebSocket | [`PAGES`] | a new one displaces the one that was silent for longest |
//! | ... from this machine, or from others | [`SIDE_PAGES`] | as above |
//! | connection without a request | [`ASKS`] | cut, except for pages, which may be silent |
//! | client that does not read an answer | [`TAKES`] | cut |
//!
//! A connection counts as a page once its WebSocket has sent the token. The page that commands is
//! never displaced. A connection from another machine displaces no connection of this machine. This
//! machine is one side, all others are the other side.
//!
//! - in: connections as the system accepts them
//! - out: the connections that are admitted

use axum::extract::connect_info::Connected;
use axum::serve::{IncomingStream, Listener};
use std::future::Future as _;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;
use tokio::time::{Instant, Sleep, sleep};

/// Greatest number of connections at one time. A browser opens up to six, and a WebSocket for each
/// page.
const MOST: usize = 64;
/// Greatest number of connections from this machine, and of those from other machines.
const SIDE: usize = 40;
/// Greatest number of pages with a WebSocket.
const PAGES: usize = 32;
/// Greatest number of pages from this machine, and of those from other machines.
const SIDE_PAGES: usize = 24;
/// Time within which a request must arrive after the connection begins or after an answer.
pub(super) const ASKS: Duration = Duration::from_secs(5);
/// Time within which a part of an answer must be read.
const TAKES: Duration = Duration::from_secs(10);

/// State of one connection.
#[derive(Debug)]
struct Known {
    number: u64,
    /// Whether it comes from another machine.
    foreign: bool,
    /// Time of its admission or of the last write to it; for a page, of the last message from it.
    idle_since: Instant,
    /// Whether it is the WebSocket of a page.
    page: bool,
    /// Sender whose drop cuts the connection.
    _cut: oneshot::Sender<()>,
}

/// All connections of a server.
#[derive(Debug, Default)]
struct Lines(Mutex<Vec<Known>>);

impl Lines {
    /// Returns all connections, locked.
    fn all(&self) -> MutexGuard<'_, Vec<Known>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Admits the connection with the number `number`, which comes from another machine if
    /// `foreign` is true. If there are too many connections, cuts the one that has been idle for
    /// longest among those that may be cut; returns `None` if no connection may be cut. The
    /// returned receiver ends when the admitted connection is cut.
    fn admit(
        self: &Arc<Self>,
        number: u64,
        foreign: bool,
    ) -> Option<(Line, oneshot::Receiver<()>)> {
        let mut all = self.all();
        make_room(&mut all, foreign, (MOST, SIDE), |_| true, |known| !known.page)?;
        let (cut, is_cut) = oneshot::channel();
        let idle_since = Instant::now();
        all.push(Known { number, foreign, idle_since, page: false, _cut: cut });
        let line = Line { lines: Arc::clone(self), number, page: Arc::default() };
        Some((line, is_cut))
    }
}

/// Makes room for one more connection of this side (`foreign` for other machines). Only connections
/// that are `counted` have the limits `most`: for both sides together, and for one side. If a limit
/// is reached, cuts the connection that has been idle for longest among those that `may_go`;
/// returns `None` if no connection may be cut.
fn make_room(
    all: &mut Vec<Known>,
    foreign: bool,
    most: (usize, usize),
    counted: impl Fn(&Known) -> bool,
    may_go: impl Fn(&Known) -> bool,
) -> Option<()> {
    let kind = |known: &&Known| counted(known);
    let side = all.iter().filter(kind).filter(|known| known.foreign == foreign).count();
    let crowded = side >= most.1;
    if crowded || all.iter().filter(kind).count() >= most.0 {
        // A full side makes room itself. Otherwise the sides together are full, and either may make
        // room; but a connection from another machine cannot displace one of this machine.
        let here = |known: &&Known| known.foreign == foreign || (!crowded && known.foreign);
        let going = all.iter().filter(kind).filter(here).filter(|known| may_go(known));
        let longest = going.min_by_key(|known| known.idle_since)?.number;
        all.retain(|known| known.number != longest);
    }
    Some(())
}

/// Handle of one connection, which the requests on it get.
#[derive(Debug, Clone)]
pub(super) struct Line {
    lines: Arc<Lines>,
    number: u64,
    /// Whether the connection is the WebSocket of a page.
    page: Arc<AtomicBool>,
}

impl Line {
    /// Returns the number of the connection, which no other connection of the server ever has.
    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// Makes the connection that of a page, which may be silent. If there are too many pages, cuts
    /// the page that has been silent for longest, but never the connection with the number
    /// `holder`. Returns `false` if this connection has been displaced, or if no page may be cut.
    pub(super) fn becomes_page(&self, holder: Option<u64>) -> bool {
        let mut all = self.lines.all();
        let Some(foreign) = self.known(&all).map(|known| known.foreign) else { return false };
        let may_go = |known: &Known| Some(known.number) != holder;
        if make_room(&mut all, foreign, (PAGES, SIDE_PAGES), |known| known.page, may_go).is_none() {
            return false;
        }
        if let Some(own) = all.iter_mut().find(|known| known.number == self.number) {
            own.page = true;
            own.idle_since = Instant::now();
        }
        self.page.store(true, Ordering::Relaxed);
        true
    }

    /// Restarts the time of silence after a message of the page.
    pub(super) fn heard(&self) {
        if let Some(known) = self.lines.all().iter_mut().find(|k| k.number == self.number) {
            known.idle_since = Instant::now();
        }
    }

    /// Returns the state of this connection, or `None` if it has been displaced.
    fn known<'a>(&self, all: &'a [Known]) -> Option<&'a Known> {
        all.iter().find(|known| known.number == self.number)
    }

    /// Restarts the idle time after a write to the connection, except for a page, which gets news
    /// without asking.
    fn answered(&self) {
        if !self.page.load(Ordering::Relaxed) {
            self.heard();
        }
    }
}

impl Connected<IncomingStream<'_, Door>> for Line {
    fn connect_info(stream: IncomingStream<'_, Door>) -> Self {
        stream.io().line.clone()
    }
}

/// Listener of the server, which admits connections.
#[derive(Debug)]
pub(super) struct Door {
    listener: TcpListener,
    lines: Arc<Lines>,
    /// Number of the last connection.
    last: u64,
}

impl Door {
    /// Makes a door to this listener, without connections.
    pub(super) fn new(listener: TcpListener) -> Self {
        Self { listener, lines: Arc::default(), last: 0 }
    }
}

impl Listener for Door {
    type Io = Stream;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Stream, SocketAddr) {
        loop {
            let (stream, address) = Listener::accept(&mut self.listener).await;
            self.last += 1;
            // A connection that is not admitted is dropped, and thereby closed.
            let foreign = !address.ip().to_canonical().is_loopback();
            if let Some((line, cut)) = self.lines.admit(self.last, foreign) {
                let idle = Box::pin(sleep(ASKS));
                return (
                    Stream { bytes: stream, line, cut: Some(cut), idle, stuck: None },
                    address,
                );
            }
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// Byte stream of a connection, which ends when the connection is cut.
#[derive(Debug)]
pub(super) struct Stream {
    bytes: TcpStream,
    line: Line,
    /// Receiver that ends when the connection is cut; `None` after that.
    cut: Option<oneshot::Receiver<()>>,
    /// Timer for the next request ([`ASKS`]).
    idle: Pin<Box<Sleep>>,
    /// Timer for the client to read ([`TAKES`]); `None` unless a write waits.
    stuck: Option<Pin<Box<Sleep>>>,
}

impl Stream {
    /// Returns whether the connection has been cut. Registers the task to be woken by a cut.
    fn is_cut(&mut self, context: &mut Context<'_>) -> bool {
        // A receiver that is ready must not be polled again.
        let cut = self.cut.as_mut().is_none_or(|cut| Pin::new(cut).poll(context).is_ready());
        if cut {
            self.cut = None;
        }
        cut
    }

    /// Passes on the result of a write. A write that waits for [`TAKES`], or on a connection that
    /// is cut, fails with a timeout.
    fn written<T>(
        &mut self,
        context: &mut Context<'_>,
        written: Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        if written.is_ready() {
            self.stuck = None;
            self.idle.as_mut().reset(Instant::now() + ASKS);
            self.line.answered();
            return written;
        }
        // Both are polled, so that each of them wakes this task.
        let cut = self.is_cut(context);
        let stuck = self.stuck.get_or_insert_with(|| Box::pin(sleep(TAKES)));
        if cut || stuck.as_mut().poll(context).is_ready() {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        Poll::Pending
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        self.line.lines.all().retain(|known| known.number != self.line.number);
    }
}

impl AsyncRead for Stream {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        into: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        let page = this.line.page.load(Ordering::Relaxed);
        let idle = !page && this.idle.as_mut().poll(context).is_ready();
        if idle || this.is_cut(context) {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        Pin::new(&mut this.bytes).poll_read(context, into)
    }
}

impl AsyncWrite for Stream {
    fn poll_write(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        let written = Pin::new(&mut this.bytes).poll_write(context, bytes);
        this.written(context, written)
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        let written = Pin::new(&mut this.bytes).poll_write_vectored(context, bytes);
        this.written(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.bytes.is_write_vectored()
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().bytes).poll_flush(context)
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().bytes).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    use tokio::time::{advance, timeout};

    /// Returns a server's door, a connection through it, and the client's end of it.
    async fn connected() -> (Door, Stream, TcpStream) {
        let mut door = Door::new(TcpListener::bind("127.0.0.1:0").await.unwrap());
        let address = door.local_addr().unwrap();
        let (came, (stream, _)) = tokio::join!(TcpStream::connect(address), door.accept());
        (door, stream, came.unwrap())
    }

    #[tokio::test(start_paused = true)]
    async fn idle_connection_is_closed_unless_websocket_of_page() {
        let (_door, mut stream, _came) = connected().await;
        assert!(timeout(4 * ASKS / 5, stream.read_u8()).await.is_err(), "a request may still come");
        let read = timeout(ASKS / 5 + Duration::from_secs(1), stream.read_u8()).await.unwrap();
        assert_eq!(read.unwrap_err().kind(), io::ErrorKind::TimedOut);

        // An answer restarts the time.
        let (_door, mut stream, _came) = connected().await;
        advance(4 * ASKS / 5).await;
        stream.write_all(b"answer").await.unwrap();
        assert!(timeout(4 * ASKS / 5, stream.read_u8()).await.is_err());

        let (_door, mut stream, _came) = connected().await;
        assert!(stream.line.becomes_page(None));
        assert!(timeout(10 * ASKS, stream.read_u8()).await.is_err(), "a quiet page keeps its line");
    }

    #[tokio::test(start_paused = true)]
    async fn connection_that_reads_nothing_is_closed() {
        let (_door, mut stream, _came) = connected().await;
        let much = vec![0; 64 << 20];
        let begun = Instant::now();

        let written = timeout(100 * TAKES, stream.write_all(&much)).await.unwrap();

        assert_eq!(written.unwrap_err().kind(), io::ErrorKind::TimedOut);
        assert!((TAKES..2 * TAKES).contains(&begun.elapsed()), "{:?}", begun.elapsed());
    }

    /// A displaced connection is cut at once, and a closed one no longer counts.
    #[tokio::test(start_paused = true)]
    async fn displaced_or_closed_connection_frees_its_slot() {
        let (door, mut stream, _came) = connected().await;
        let others: Vec<_> = (100..100 + MOST as u64).map(|n| door.lines.admit(n, false)).collect();
        assert!(others.iter().all(Option::is_some));
        let read = timeout(Duration::from_millis(1), stream.read_u8()).await.unwrap();
        assert_eq!(read.unwrap_err().kind(), io::ErrorKind::TimedOut);

        let (door, stream, _came) = connected().await;
        assert_eq!(door.lines.all().len(), 1);
        drop(stream);
        assert!(door.lines.all().is_empty());
    }

    #[tokio::test(start_paused = true)]
    async fn least_recently_answered_connection_is_displaced_first() {
        let lines = Arc::new(Lines::default());
        let mut held = Vec::new();
        for number in 0..SIDE as u64 {
            held.push(lines.admit(number, false).unwrap().0);
            advance(Duration::from_millis(1)).await;
        }
        held[0].answered();

        lines.admit(100, false).unwrap();

        let stays = |number: u64| lines.all().iter().any(|known| known.number == number);
        assert!(stays(0) && !stays(1));
    }

    /// Opens connections with these numbers, 1 ms apart, and makes each of them a page.
    async fn pages(
        lines: &Arc<Lines>,
        numbers: std::ops::Range<u64>,
        foreign: bool,
    ) -> Vec<(Line, oneshot::Receiver<()>)> {
        let mut held = Vec::new();
        for number in numbers {
            let (line, cut) = lines.admit(number, foreign).unwrap();
            assert!(line.becomes_page(None));
            advance(Duration::from_millis(1)).await;
            held.push((line, cut));
        }
        held
    }

    #[tokio::test(start_paused = true)]
    async fn pages_may_not_occupy_all_connections() {
        let lines = Arc::new(Lines::default());
        let held = pages(&lines, 0..100, false).await;

        assert_eq!(lines.all().iter().filter(|known| known.page).count(), SIDE_PAGES);
        assert_eq!(held.len(), 100);
        assert!(lines.admit(100, false).is_some());
        assert!(lines.admit(101, true).unwrap().0.becomes_page(None));
    }

    /// The operator's page is the oldest one, and has not sent a message since it opened.
    #[tokio::test(start_paused = true)]
    async fn most_silent_page_without_seat_is_displaced() {
        let lines = Arc::new(Lines::default());
        let mut held = pages(&lines, 0..SIDE_PAGES as u64, false).await;
        held[1].0.heard();
        // News that a page gets do not count as a message from it.
        held[2].0.answered();
        let is_cut = |cut: &mut oneshot::Receiver<()>| {
            cut.try_recv().is_err_and(|e| e == oneshot::error::TryRecvError::Closed)
        };

        let (line, _cut) = lines.admit(100, false).unwrap();
        assert!(line.becomes_page(Some(0)));

        let cut: Vec<usize> = (0..held.len()).filter(|&i| is_cut(&mut held[i].1)).collect();
        assert_eq!(cut, [2]);
    }

    #[tokio::test(start_paused = true)]
    async fn displaced_page_is_cut_at_once() {
        let (door, mut stream, _came) = connected().await;
        assert!(stream.line.becomes_page(None));
        advance(Duration::from_millis(1)).await;

        let _held = pages(&door.lines, 100..100 + SIDE_PAGES as u64, false).await;

        for _ in 0..2 {
            let read = timeout(Duration::from_millis(1), stream.read_u8()).await.unwrap();
            assert_eq!(read.unwrap_err().kind(), io::ErrorKind::TimedOut);
        }
        assert!(!stream.line.becomes_page(None));
    }

    /// However many connections and pages one side opens, an operator of the other side finds a
    /// place (this machine is one side, all others are the other).
    #[tokio::test(start_paused = true)]
    async fn either_side_leaves_places_to_other_side() {
        for foreign in [true, false] {
            let lines = Arc::new(Lines::default());
            let _pages = pages(&lines, 0..100, foreign).await;
            let mut held: Vec<_> = (100..300).map_while(|n| lines.admit(n, foreign)).collect();
            assert_eq!((held.len(), lines.all().len()), (200, SIDE));
            assert_eq!(lines.all().iter().filter(|known| known.page).count(), SIDE_PAGES);
            let first = held[0].1.try_recv();
            assert!(first.is_err_and(|e| e == oneshot::error::TryRecvError::Closed));

            let (line, _cut) = lines.admit(400, !foreign).unwrap();
            assert!(line.becomes_page(None));

            assert!(!held[0].0.becomes_page(None), "the oldest line made room");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn other_machines_displace_no_connection_of_this_one() {
        let lines = Arc::new(Lines::default());
        let _pages = pages(&lines, 0..SIDE_PAGES as u64, false).await;
        let _own: Vec<_> = (100..200).map_while(|n| lines.admit(n, false)).collect();

        let theirs: Vec<_> = (200..300).map_while(|n| lines.admit(n, true)).collect();

        assert_eq!((theirs.len(), lines.all().len()), (100, MOST));
        assert_eq!(lines.all().iter().filter(|known| !known.foreign).count(), SIDE);
    }

    #[tokio::test(start_paused = true)]
    async fn this_machine_displaces_connections_of_others() {
        let lines = Arc::new(Lines::default());
        let _theirs: Vec<_> = (0..SIDE as u64).map_while(|n| lines.admit(n, true)).collect();
        advance(Duration::from_millis(1)).await;
        let own = (100..).take(MOST - SIDE);
        let _own: Vec<_> = own.map_while(|n| lines.admit(n, false)).collect();

        let _held = lines.admit(300, false).unwrap();

        let foreign = lines.all().iter().filter(|known| known.foreign).count();
        assert_eq!((lines.all().len(), foreign), (MOST, SIDE - 1));
    }
}
