//! Limits of the page's connections: their number, and the time for which one may be idle.
//!
//! Each connection has a file descriptor. The world's file and the recording need some as well, and
//! so does the operator who wants to press the emergency stop.
//!
//! | case | limit | consequence |
//! |---|---|---|
//! | all connections | [`MOST`] | a new one displaces the one that has been idle for longest |
//! | ... from other machines | [`FOREIGN`] | the operator at this machine always finds a place |
//! | pages with a WebSocket | [`PAGES`] | further pages are refused; pages are never displaced |
//! | ... from other machines | [`FOREIGN_PAGES`] | as above |
//! | no request | [`ASKS`] | cut, except for pages: there may be no news for long |
//! | answer is not read | [`TAKES`] | cut |
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

/// Greatest number of connections at one time. A browser has six, and the WebSocket of its page.
const MOST: usize = 64;
/// Greatest number of connections from other machines.
const FOREIGN: usize = 40;
/// Greatest number of pages with a WebSocket.
const PAGES: usize = 32;
/// Greatest number of pages from other machines.
const FOREIGN_PAGES: usize = 24;
/// Time within which the head of a request must arrive, and the next request after an answer.
const ASKS: Duration = Duration::from_secs(5);
/// Time within which a part of an answer must be read.
const TAKES: Duration = Duration::from_secs(10);

/// State of one connection.
#[derive(Debug)]
struct Known {
    number: u64,
    foreign: bool,
    /// Time of the last write to it, or of its admission.
    idle_since: Instant,
    /// Whether it has become the WebSocket of a page.
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

    /// Admits connection `number`, which comes from another machine if it is `foreign`. If there
    /// are too many, cuts the one that has been idle for longest among those that may be cut;
    /// returns `None` if there is none. The returned receiver ends when this connection is cut.
    fn admit(
        self: &Arc<Self>,
        number: u64,
        foreign: bool,
    ) -> Option<(Line, oneshot::Receiver<()>)> {
        let mut all = self.all();
        let strangers = all.iter().filter(|known| known.foreign).count();
        let crowded = foreign && strangers >= FOREIGN;
        if crowded || all.len() >= MOST {
            // A connection from another machine cannot displace one of this machine.
            let may_go = |known: &&Known| !known.page && (known.foreign || !foreign);
            let longest = all.iter().filter(may_go).min_by_key(|k| k.idle_since)?.number;
            all.retain(|known| known.number != longest);
        }
        let (cut, is_cut) = oneshot::channel();
        let idle_since = Instant::now();
        all.push(Known { number, foreign, idle_since, page: false, _cut: cut });
        let line = Line { lines: Arc::clone(self), number, page: Arc::default() };
        Some((line, is_cut))
    }
}

/// One connection, as a request on it sees it.
#[derive(Debug, Clone)]
pub(super) struct Line {
    lines: Arc<Lines>,
    number: u64,
    page: Arc<AtomicBool>,
}

impl Line {
    /// Makes the connection a page's WebSocket, which may be silent. Returns `false` if there are
    /// too many pages.
    pub(super) fn becomes_page(&self) -> bool {
        let mut all = self.lines.all();
        let pages = all.iter().filter(|known| known.page).count();
        let strangers = all.iter().filter(|known| known.page && known.foreign).count();
        // A new connection may have displaced this one meanwhile.
        let Some(own) = all.iter_mut().find(|known| known.number == self.number) else {
            return false;
        };
        if pages >= PAGES || (own.foreign && strangers >= FOREIGN_PAGES) {
            return false;
        }
        own.page = true;
        self.page.store(true, Ordering::Relaxed);
        true
    }

    /// Restarts the idle time after a write.
    fn answered(&self) {
        if let Some(known) = self.lines.all().iter_mut().find(|k| k.number == self.number) {
            known.idle_since = Instant::now();
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
    last: u64,
}

impl Door {
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
            // A connection without a place is dropped, and thereby closed.
            let foreign = !address.ip().to_canonical().is_loopback();
            if let Some((line, cut)) = self.lines.admit(self.last, foreign) {
                let idle = Box::pin(sleep(ASKS));
                return (Stream { bytes: stream, line, cut, idle, stuck: None }, address);
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
    cut: oneshot::Receiver<()>,
    /// Timer of [`ASKS`].
    idle: Pin<Box<Sleep>>,
    /// Timer of [`TAKES`], while a write waits.
    stuck: Option<Pin<Box<Sleep>>>,
}

impl Stream {
    /// Passes on the result of a write, which may wait for as long as [`TAKES`].
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
        let cut = Pin::new(&mut self.cut).poll(context).is_ready();
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
        // A receiver that is ready must not be polled again. It is not, because the error ends the
        // connection.
        if idle || (!page && Pin::new(&mut this.cut).poll(context).is_ready()) {
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
        let read = timeout(ASKS + Duration::from_secs(1), stream.read_u8()).await.unwrap();
        assert_eq!(read.unwrap_err().kind(), io::ErrorKind::TimedOut);

        // An answer restarts the time.
        let (_door, mut stream, _came) = connected().await;
        advance(4 * ASKS / 5).await;
        stream.write_all(b"answer").await.unwrap();
        assert!(timeout(4 * ASKS / 5, stream.read_u8()).await.is_err());

        let (_door, mut stream, _came) = connected().await;
        assert!(stream.line.becomes_page());
        assert!(timeout(10 * ASKS, stream.read_u8()).await.is_err(), "a quiet page keeps its line");
    }

    #[tokio::test(start_paused = true)]
    async fn connection_that_reads_nothing_is_closed() {
        let (_door, mut stream, _came) = connected().await;
        let much = vec![0; 64 << 20];

        let written = timeout(100 * TAKES, stream.write_all(&much)).await.unwrap();

        assert_eq!(written.unwrap_err().kind(), io::ErrorKind::TimedOut);
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
        for number in 0..MOST as u64 {
            held.push(lines.admit(number, false).unwrap().0);
            advance(Duration::from_millis(1)).await;
        }
        held[0].answered();

        lines.admit(100, false).unwrap();

        let stays = |number: u64| lines.all().iter().any(|known| known.number == number);
        assert!(stays(0) && !stays(1));
    }

    #[tokio::test]
    async fn pages_may_not_occupy_all_connections() {
        let lines = Arc::new(Lines::default());
        let held: Vec<_> = (0..MOST as u64).map_while(|n| lines.admit(n, false)).collect();

        assert_eq!(held.iter().filter(|(line, _)| line.becomes_page()).count(), PAGES);
        assert!(lines.admit(100, false).is_some());
    }

    #[tokio::test]
    async fn longest_idle_connection_is_displaced_before_pages() {
        let lines = Arc::new(Lines::default());
        let mut held: Vec<_> = (0..200).map_while(|n| lines.admit(n, true)).collect();
        assert_eq!((held.len(), lines.all().len()), (200, FOREIGN));
        assert!(held[0].1.try_recv().is_err_and(|e| e == oneshot::error::TryRecvError::Closed));

        let pages = held[200 - FOREIGN..].iter().filter(|(line, _)| line.becomes_page()).count();
        let own: Vec<_> = (200..400).map_while(|n| lines.admit(n, false)).collect();

        assert_eq!((pages, own.len(), lines.all().len()), (FOREIGN_PAGES, 200, MOST));
        assert_eq!(lines.all().iter().filter(|known| known.page).count(), FOREIGN_PAGES);
        // Connections from other machines displace none of this machine, and leave it pages.
        assert_eq!(lines.all().iter().filter(|known| known.foreign).count(), FOREIGN_PAGES);
        assert!(own.last().unwrap().0.becomes_page());
        assert!(!held[0].0.becomes_page(), "the oldest line made room");
        assert!(lines.admit(400, true).is_none());
        assert!(lines.admit(401, false).is_some());
    }
}
