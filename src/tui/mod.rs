//! The operator's UI in a terminal, for ssh: the same snapshot and inputs as the page.
//!
//! `App` is pure (keys in, inputs out), `draw` makes a picture of it; [`show`] gives both a
//! terminal.

mod app;
mod draw;
mod net;

use crate::desk::UiEnd;
use crate::operator::{ControlView, Input};
use app::App;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyEvent, KeyEventKind};
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Time between two looks at keys and snapshots: ten pictures a second are enough for a terminal.
const LOOK: Duration = Duration::from_millis(100);

/// Shows a desk in a terminal until `leave` is set, or until the operator leaves it, which is
/// possible when the run is over or no run takes inputs any more.
///
/// # Errors
/// The terminal's.
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
            "the robot does not listen; Ctrl-C again leaves".clone_into(&mut app.note);
        }
        if leaves {
            break;
        }
    }
    drop(screen);
    let last = desk.snapshots.borrow();
    if last.control != ControlView::Ended && last.services.seek_ms.is_none() {
        // A closed stderr has no reader.
        let _ = writeln!(
            std::io::stderr(),
            "the run goes on without a UI until it ends; Ctrl-C ends it"
        );
    }
    Ok(())
}

/// The terminal while it belongs to the UI: given back however that ends.
#[derive(Debug)]
pub struct Screen(DefaultTerminal);

impl Screen {
    /// Takes the terminal at which this program is.
    ///
    /// # Errors
    /// When there is none, or what it says.
    pub fn open() -> std::io::Result<Self> {
        if !std::io::stdout().is_terminal() {
            return Err(std::io::Error::other("stdout is none"));
        }
        // A half-initialised terminal is put back.
        let screen = ratatui::try_init();
        if screen.is_err() {
            let _ = ratatui::try_restore();
        }
        screen.map(Self)
    }
}

/// Puts the terminal back as it was when the program is ended from elsewhere.
pub fn put_back() {
    let _ = ratatui::try_restore();
}

impl Drop for Screen {
    fn drop(&mut self) {
        ratatui::restore();
    }
}

fn next_key() -> std::io::Result<Option<KeyEvent>> {
    if !event::poll(LOOK)? {
        return Ok(None);
    }
    Ok(match event::read()? {
        Event::Key(key) if key.kind != KeyEventKind::Release => Some(key),
        _ => None,
    })
}
