//! How far long work has come: a bar on a terminal, a line every few seconds elsewhere. All on stderr.

use super::output::complain;
use crate::solver::table::TableSpec;
use crate::tables::News;
use std::io::{IsTerminal, Write};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

const WIDTH: usize = 30;

/// The bar of one piece of work.
pub(super) struct Bar {
    title: String,
    terminal: bool,
    begun: Instant,
    /// When it was last drawn, and which share that showed.
    drawn: Mutex<(Instant, f64)>,
}

impl Bar {
    pub(super) fn new(title: &str) -> Self {
        let now = Instant::now();
        let terminal = std::io::stderr().is_terminal();
        Self { title: title.to_owned(), terminal, begun: now, drawn: Mutex::new((now, 0.0)) }
    }

    /// Shows that this share is done, 0..=1, if it is worth showing.
    pub(super) fn show(&self, share: f64) {
        self.show_with(share, "");
    }

    /// The same with words behind it.
    pub(super) fn show_with(&self, share: f64, words: &str) {
        let mut drawn = self.drawn.lock().unwrap_or_else(PoisonError::into_inner);
        let mut stderr = std::io::stderr();
        if self.terminal {
            if drawn.0.elapsed() < Duration::from_millis(100) || share < drawn.1 {
                return;
            }
            let filled = (share * WIDTH as f64) as usize;
            let (done, rest) = ("#".repeat(filled), " ".repeat(WIDTH - filled.min(WIDTH)));
            let _ = write!(
                stderr,
                "\r\x1b[K{} [{done}{rest}] {:3.0} %{words}",
                self.title,
                share * 100.0
            );
            let _ = stderr.flush();
            *drawn = (Instant::now(), share);
        } else if drawn.0.elapsed() > Duration::from_secs(5) && share < 1.0 {
            let _ = writeln!(stderr, "{}: {:.0} %{words}", self.title, share * 100.0);
            *drawn = (Instant::now(), share);
        }
    }

    /// Says something above it.
    pub(super) fn say(&self, text: &str) {
        let clear = if self.terminal { "\r\x1b[K" } else { "" };
        let _ = writeln!(std::io::stderr(), "{clear}{text}");
    }

    /// Ends it with what it came to.
    pub(super) fn end(&self, result: &str) {
        let clear = if self.terminal { "\r\x1b[K" } else { "" };
        let seconds = self.begun.elapsed().as_secs_f64();
        let _ = writeln!(std::io::stderr(), "{clear}{}: {result} in {seconds:.1} s", self.title);
    }
}

/// Says what a store does, on stderr.
pub(super) fn tell(spec: &TableSpec, news: &News<'_>) {
    let size = megabytes(spec.bytes);
    complain(&match news {
        News::Building(reason) => format!("table {} ({size}): {reason}; building it", spec.name),
        News::Waiting => format!("table {}: another process is building it; waiting", spec.name),
        News::NotKept(error) => {
            format!("table {}: cannot be kept ({error}); used from memory, this once", spec.name)
        }
    });
}

/// A size as people say it.
pub(super) fn megabytes(bytes: usize) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}
