//! Progress of long work on stderr.
//!
//! - a [`Bar`], if the share of the work that is done is known: a live line on a terminal,
//!   otherwise a line every 5 s
//! - a [`Waiting`], if it is not known: a live line with the time, on a terminal only

use super::output::{inform, warn};
use crate::hw::console;
use crate::solver::table::TableSpec;
use crate::tables::News;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Width of the bar (characters).
const WIDTH: usize = 30;
/// Least time between two drawings: five a second can be read.
pub(super) const REDRAW: Duration = Duration::from_millis(200);
/// Time after which a person wonders whether the program still works.
const LONG: Duration = Duration::from_secs(1);

/// Progress bar of one piece of work.
pub(super) struct Bar {
    title: String,
    /// Whether stderr is a terminal with a live line.
    terminal: bool,
    begun: Instant,
    /// Time without a bar, for work that is mostly short.
    hidden: Duration,
    /// Time of the last drawing, and share of the work in it.
    drawn: Mutex<(Instant, f64)>,
}

impl Bar {
    /// Makes a bar that is not drawn yet.
    pub(super) fn new(title: &str) -> Self {
        let now = Instant::now();
        let terminal = console::has_live_line();
        let hidden = Duration::ZERO;
        Self {
            title: title.to_owned(),
            terminal,
            begun: now,
            hidden,
            drawn: Mutex::new((now, 0.0)),
        }
    }

    /// Makes a bar that appears when the work has taken [`LONG`].
    pub(super) fn of_long_work(title: &str) -> Self {
        let mut bar = Self::new(title);
        bar.hidden = LONG;
        bar
    }

    /// Shows the share of the work that is done, 0..=1.
    pub(super) fn show(&self, share: f64) {
        self.show_with(share, "");
    }

    /// Shows the share of the work that is done (0..=1), followed by `words`.
    pub(super) fn show_with(&self, share: f64, words: &str) {
        let mut drawn = self.drawn.lock().unwrap_or_else(PoisonError::into_inner);
        if self.terminal {
            // Threads report in any order: the bar never shrinks.
            let early = self.begun.elapsed() < self.hidden;
            if early || drawn.0.elapsed() < REDRAW || share < drawn.1 {
                return;
            }
            let filled = (share * WIDTH as f64) as usize;
            let (done, rest) = ("#".repeat(filled), " ".repeat(WIDTH - filled.min(WIDTH)));
            console::show(&format!("{} [{done}{rest}] {:3.0} %{words}", self.title, share * 100.0));
            *drawn = (Instant::now(), share);
        } else if drawn.0.elapsed() > Duration::from_secs(5) && share < 1.0 {
            // In a file each line stays, so there are few of them, and none at the end.
            inform(&format!("{}: {:.0} %{words}", self.title, share * 100.0));
            *drawn = (Instant::now(), share);
        }
    }

    /// Replaces the bar by a line with the result and the time.
    pub(super) fn end(&self, result: &str) {
        self.clear();
        inform(&format!("{}: {result} in {:.1} s", self.title, self.begun.elapsed().as_secs_f64()));
    }

    /// Erases the bar.
    pub(super) fn clear(&self) {
        if self.terminal {
            console::show("");
        }
    }
}

impl Drop for Bar {
    /// Erases the bar of work that ended early.
    fn drop(&mut self) {
        self.clear();
    }
}

/// Thread that draws the live line of the console five times a second. Dropping it erases the line.
#[derive(Debug)]
pub(super) struct Drawing {
    /// Dropping the sender ends the thread.
    leave: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Drawing {
    /// Begins to draw what `text` returns, for the first time after `first`. Work goes on without
    /// the line if there is no thread for it.
    pub(super) fn start(
        first: Duration,
        mut text: impl FnMut() -> String + Send + 'static,
    ) -> Self {
        let (leave, left) = channel();
        let work = move || {
            let mut pause = first;
            while left.recv_timeout(pause) == Err(RecvTimeoutError::Timeout) {
                console::show(&text());
                pause = REDRAW;
            }
            console::show("");
        };
        let thread = std::thread::Builder::new().name("live line".into()).spawn(work).ok();
        Self { leave: Some(leave), thread }
    }
}

impl Drop for Drawing {
    fn drop(&mut self) {
        self.leave = None;
        // A thread that panicked has no line to erase.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// Live line about work whose end is unknown: its words and the time that it has taken. The line
/// appears after [`LONG`] and goes when this value is dropped.
pub(super) struct Waiting {
    /// Words of the line.
    words: Arc<Mutex<String>>,
    _drawing: Option<Drawing>,
}

impl Waiting {
    /// Begins the work. Without a live line, or a thread, nothing is shown.
    pub(super) fn begin(words: &str) -> Self {
        let words = Arc::new(Mutex::new(words.to_owned()));
        let (shown, begun) = (Arc::clone(&words), Instant::now());
        let text = move || {
            let words = shown.lock().unwrap_or_else(PoisonError::into_inner).clone();
            format!("{words}, {:.0} s", begun.elapsed().as_secs_f64())
        };
        let drawing = console::has_live_line().then(|| Drawing::start(LONG, text));
        Self { words, _drawing: drawing }
    }

    /// Replaces the words of the line.
    pub(super) fn say(&self, words: &str) {
        words.clone_into(&mut self.words.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

/// Prints to stderr what a store of tables reports about a table: that it builds the table, waits
/// for it, or cannot keep it.
pub(super) fn print_news(spec: &TableSpec, news: &News<'_>) {
    let size = megabytes(spec.bytes);
    match news {
        News::Building(reason) => {
            inform(&format!("table {} ({size}): {reason}: building it", spec.name));
        }
        News::Waiting => {
            inform(&format!("table {}: waiting for a process that builds it", spec.name));
        }
        News::NotKept(error) => warn(&format!(
            "table {}: cannot be kept ({error}): used from memory, built again next time; name a \
             folder that can be written with --tables or RUBIK_ROBOT_TABLES",
            spec.name
        )),
    }
}

/// Formats a size in megabytes.
pub(super) fn megabytes(bytes: usize) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}
