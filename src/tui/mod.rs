//! The operator's UI in a terminal, for work over ssh.
//!
//! It shows the same snapshots as the page and sends the same inputs. `app` keeps the state of the
//! UI and turns keys into inputs; it is pure. `draw` renders this state, and [`show`] connects both
//! with a terminal.

mod app;
mod draw;
mod net;

use crate::desk::UiEnd;
use crate::hw::console::{self, Tone};
use crate::operator::{ControlView, Input};
use app::App;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyEvent, KeyEventKind};
use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Longest time between two redraws. Ten redraws in a second are enough for a terminal.
const LOOK: Duration = Duration::from_millis(100);

/// Shows the UI of a desk in a terminal until `leave` is set or the operator leaves. The operator
/// can leave when the run is over, or when no run accepts inputs any more.
///
/// # Errors
/// Error of the operating system if the terminal cannot be read or written.
pub fn show(mut screen: Screen, desk: &UiEnd, leave: &AtomicBool) -> std::io::Result<()> {
    let mut app = App::default();
    while !leave.load(Ordering::Acquire) {
        app.stage = desk.stage.borrow().clone();
        app.take(desk.snapshots.borrow().clone());
        screen.0.draw(|frame| draw::frame(&app, frame))?;
        let Some(key) = next_key()? else { continue };
        let Some(input) = app.key(key) else { continue };
        let leaves = input == Input::Quit;
        if !desk.send(input) {
            "the run accepts no commands; Ctrl-C again leaves".clone_into(&mut app.note);
        }
        if leaves {
            break;
        }
    }
    // The terminal is restored first: a message on the UI's screen would vanish with that screen.
    drop(screen);
    let last = desk.snapshots.borrow();
    if last.control != ControlView::Ended && last.services.seek_ms.is_none() {
        let words = "the run continues without a UI until it ends; Ctrl-C ends it";
        console::line(Tone::Plain, words);
    }
    Ok(())
}

/// The terminal while it belongs to the UI. Dropping it restores the terminal.
#[derive(Debug)]
pub struct Screen(DefaultTerminal);

impl Screen {
    /// Takes control of the terminal of this program.
    ///
    /// # Errors
    /// Stdout is no terminal, or the terminal cannot be initialised.
    pub fn open() -> std::io::Result<Self> {
        if !std::io::stdout().is_terminal() {
            return Err(std::io::Error::other("the standard output is no terminal"));
        }
        // A failed initialisation may have changed the terminal already.
        let screen = ratatui::try_init();
        if screen.is_err() {
            let _ = ratatui::try_restore();
        } else {
            console::hold();
        }
        screen.map(Self)
    }
}

/// Restores the terminal. A program that is ended from outside, which does not drop its [`Screen`],
/// calls this function.
pub fn restore_terminal() {
    let _ = ratatui::try_restore();
    console::release();
}

impl Drop for Screen {
    fn drop(&mut self) {
        ratatui::restore();
        console::release();
    }
}

/// Returns the next key that is pressed within [`LOOK`]; `None` if there is none.
fn next_key() -> std::io::Result<Option<KeyEvent>> {
    if !event::poll(LOOK)? {
        return Ok(None);
    }
    Ok(match event::read()? {
        // Some terminals report the release of a key as well, which would repeat its input.
        Event::Key(key) if key.kind != KeyEventKind::Release => Some(key),
        _ => None,
    })
}
