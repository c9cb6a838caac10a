//! Progress of long work on stderr: a bar on a terminal, otherwise a line every 5 s.

use super::output::complain;
use crate::hw::text::printable;
use crate::solver::table::TableSpec;
use crate::tables::News;
use std::io::{IsTerminal, Write};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Width of the bar (characters).
const WIDTH: usize = 30;

/// Progress bar of one piece of work.
pub(super) struct Bar {
    title: String,
    /// Whether stderr is a terminal.
    terminal: bool,
    begun: Instant,
    /// Time of the last drawing, and share of the work in it.
    drawn: Mutex<(Instant, f64)>,
}

impl Bar {
    /// Makes a bar that is not drawn yet.
    pub(super) fn new(title: &str) -> Self {
        let now = Instant::now();
        let terminal = std::io::stderr().is_terminal();
        Self { title: title.to_owned(), terminal, begun: now, drawn: Mutex::new((now, 0.0)) }
    }

    /// Shows the share of the work that is done, 0..=1.
    pub(super) fn show(&self, share: f64) {
        self.show_with(share, "");
    }

    /// Shows the share of the work that is done (0..=1), followed by `words`.
    pub(super) fn show_with(&self, share: f64, words: &str) {
        let mut drawn = self.drawn.lock().unwrap_or_else(PoisonError::into_inner);
        let mut stderr = std::io::stderr();
        if self.terminal {
            // Ten drawings a second are enough. Threads report in any order: the bar never shrinks.
            if drawn.0.elapsed() < Duration::from_millis(100) || share < drawn.1 {
                return;
            }
            let filled = (share * WIDTH as f64) as usize;
            let (done, rest) = ("#".repeat(filled), " ".repeat(WIDTH - filled.min(WIDTH)));
            // `\r` and the escape sequence delete the last drawing.
            let _ = write!(
                stderr,
                "\r\x1b[K{} [{done}{rest}] {:3.0} %{words}",
                self.title,
                share * 100.0
            );
            let _ = stderr.flush();
            *drawn = (Instant::now(), share);
        } else if drawn.0.elapsed() > Duration::from_secs(5) && share < 1.0 {
            // In a file each line stays, so there are few of them, and none at the end.
            let _ = writeln!(stderr, "{}: {:.0} %{words}", self.title, share * 100.0);
            *drawn = (Instant::now(), share);
        }
    }

    /// Prints a line above the bar.
    pub(super) fn say(&self, text: &str) {
        let clear = if self.terminal { "\r\x1b[K" } else { "" };
        let _ = writeln!(std::io::stderr(), "{clear}{}", printable(text));
    }

    /// Replaces the bar by a line with the result and the time.
    pub(super) fn end(&self, result: &str) {
        let clear = if self.terminal { "\r\x1b[K" } else { "" };
        let seconds = self.begun.elapsed().as_secs_f64();
        let _ = writeln!(std::io::stderr(), "{clear}{}: {result} in {seconds:.1} s", self.title);
    }
}

/// Prints to stderr what a store of tables reports about a table: that it builds the table, waits
/// for it, or cannot keep it.
pub(super) fn print_news(spec: &TableSpec, news: &News<'_>) {
    let size = megabytes(spec.bytes);
    complain(&match news {
        News::Building(reason) => format!("table {} ({size}): {reason}: building it", spec.name),
        News::Waiting => format!("table {}: waiting for a process that builds it", spec.name),
        News::NotKept(error) => {
            let name = spec.name;
            format!(
                "table {name}: cannot be kept ({error}): used from memory, built again next time; \
                 name a folder that can be written with --tables or RUBIK_ROBOT_TABLES"
            )
        }
    });
}

/// Formats a size in megabytes.
pub(super) fn megabytes(bytes: usize) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}
