//! The operator's UI: the page, the terminal, or none.

use super::output::complain;
use crate::desk::{RunEnd, UiEnd};
use crate::operator::Input;
use crate::run::SIGNALS;
use crate::tui;
use crate::web::Server;
use anyhow::{Context, anyhow};
use clap::{Args, ValueEnum};
use std::io::{IsTerminal, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Where the page is, unless told otherwise.
const PORT: u16 = 8780;
/// How many ports are tried while the first ones are taken, by other runs perhaps.
const PORTS: u16 = 10;

/// The options of each command that shows a run.
#[derive(Debug, Clone, Args)]
pub(super) struct UiArgs {
    /// The operator's UI; the page when a person sits at the terminal
    #[arg(long, value_enum, value_name = "UI")]
    pub(super) ui: Option<UiKind>,
    /// Where the page listens: ADDRESS:PORT, an address, or a port; beyond 127.0.0.1 a token is needed
    #[arg(long, value_name = "ADDR")]
    pub(super) listen: Option<String>,
}

/// A kind of UI.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum UiKind {
    /// A page in the browser
    Web,
    /// This terminal, for ssh
    Tui,
    /// Lines on stderr
    None,
}

impl UiArgs {
    /// Returns the kind that the options mean.
    pub(super) fn kind(&self, json: bool) -> UiKind {
        let person = std::io::stdin().is_terminal() && std::io::stdout().is_terminal();
        match self.ui {
            Some(word) => word,
            None if self.listen.is_some() || (person && !json) => UiKind::Web,
            None => UiKind::None,
        }
    }

    /// Opens a UI at a desk and reports where the page is. A page that no option asked for is left
    /// out when no port is free.
    pub(super) fn open(&self, kind: UiKind, desk: UiEnd) -> anyhow::Result<Ui> {
        match kind {
            UiKind::None => Ok(Ui::None),
            UiKind::Tui => Ok(Ui::Tui(Terminal::open(desk).context("--ui tui: the terminal")?)),
            UiKind::Web => {
                let served = self.serve(&desk);
                let server = match served {
                    Err(error) if self.ui.is_none() && self.listen.is_none() => {
                        complain(&format!("no page: {error:#}"));
                        return Ok(Ui::None);
                    }
                    other => other?,
                };
                complain(&format!("the operator's page: {}", server.url));
                Ok(Ui::Web(server))
            }
        }
    }

    fn serve(&self, desk: &UiEnd) -> anyhow::Result<Server> {
        if let Some(text) = &self.listen {
            let address = address(text).ok_or_else(|| {
                anyhow!("--listen {text}: neither ADDRESS:PORT nor an address nor a port")
            })?;
            return Server::start(desk.clone(), address)
                .with_context(|| format!("the page cannot listen on {address}"));
        }
        let mut last = None;
        for port in PORT..PORT + PORTS {
            match Server::start(desk.clone(), SocketAddr::from((Ipv4Addr::LOCALHOST, port))) {
                Ok(server) => return Ok(server),
                Err(error) => last = Some(error),
            }
        }
        Err(last.map_or_else(|| anyhow!("no port"), anyhow::Error::from))
            .with_context(|| format!("ports {PORT} to {} are taken", PORT + PORTS - 1))
    }
}

fn address(text: &str) -> Option<SocketAddr> {
    let port_of = |text: &str| text.trim_start_matches(':').parse::<u16>().ok();
    text.parse().ok().or_else(|| {
        let ip = text.parse::<IpAddr>().ok().map(|ip| SocketAddr::from((ip, PORT)));
        ip.or_else(|| port_of(text).map(|port| SocketAddr::from((Ipv4Addr::LOCALHOST, port))))
    })
}

/// An open UI.
#[derive(Debug)]
pub(super) enum Ui {
    /// Lines on stderr, or nothing.
    None,
    /// The page.
    Web(Server),
    /// The terminal.
    Tui(Terminal),
}

impl Ui {
    /// Returns whether the UI is in this terminal.
    pub(super) fn has_terminal(&self) -> bool {
        matches!(self, Self::Tui(_))
    }

    /// Closes it at once.
    pub(super) fn leave(self) -> anyhow::Result<()> {
        match self {
            Self::None | Self::Web(_) => Ok(()),
            Self::Tui(terminal) => {
                terminal.leave.store(true, Ordering::Release);
                terminal.wait()
            }
        }
    }

    /// Keeps it up after a run until the operator leaves: by the page's button, by Ctrl-C, or by
    /// `q`.
    pub(super) fn linger(self, run_end: &RunEnd) -> anyhow::Result<()> {
        match self {
            Self::None => Ok(()),
            Self::Tui(terminal) => terminal.wait(),
            Self::Web(server) => {
                let mut err = std::io::stderr().lock();
                // A closed stderr has no reader.
                let _ = writeln!(
                    err,
                    "the page stays at {} until Ctrl-C, or until it is closed there",
                    server.url
                );
                drop(err);
                wait(run_end)
            }
        }
    }
}

/// The terminal's thread. It gives the terminal back when it leaves: by itself, when a signal ends the program, or when
/// this is dropped.
#[derive(Debug)]
pub(super) struct Terminal {
    leave: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<std::io::Result<()>>>,
}

impl Terminal {
    fn open(desk: UiEnd) -> std::io::Result<Self> {
        let screen = tui::Screen::open()?;
        let leave = Arc::new(AtomicBool::new(false));
        for signal in SIGNALS {
            signal_hook::flag::register(signal, Arc::clone(&leave))?;
        }
        let leaves = Arc::clone(&leave);
        let thread = std::thread::Builder::new().name("tui".into()).spawn(move || {
            let shown = tui::show(screen, &desk, &leaves);
            if let Err(error) = &shown {
                // The run is not shown any more. A replay is left; a run goes on until a signal.
                complain(&format!("the terminal: {error}; a signal ends the run"));
                let _ = desk.send(Input::Quit);
            }
            shown
        })?;
        Ok(Self { leave, thread: Some(thread) })
    }

    /// Until it has left.
    fn wait(mut self) -> anyhow::Result<()> {
        match self.left() {
            Some(Ok(shown)) => Ok(shown.context("the terminal")?),
            Some(Err(_)) => Err(anyhow!("the terminal's thread died")),
            None => Ok(()),
        }
    }

    /// Returns the result of its thread. A thread that is to leave and does not within a second is
    /// given up: its terminal is gone and never answers.
    fn left(&mut self) -> Option<std::thread::Result<std::io::Result<()>>> {
        const LOOK: Duration = Duration::from_millis(20);
        let thread = self.thread.take()?;
        let mut patience = 50;
        while !thread.is_finished() && patience > 0 {
            std::thread::sleep(LOOK);
            patience -= u32::from(self.leave.load(Ordering::Acquire));
        }
        thread.is_finished().then(|| thread.join())
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.leave.store(true, Ordering::Release);
        // A panic has told of itself.
        let _ = self.left();
    }
}

fn wait(run_end: &RunEnd) -> anyhow::Result<()> {
    let signalled = Arc::new(AtomicBool::new(false));
    for signal in SIGNALS {
        signal_hook::flag::register(signal, Arc::clone(&signalled))?;
    }
    let mut inputs = run_end.take_inputs();
    while !signalled.load(Ordering::Acquire) {
        while let Some(input) = inputs.as_mut().and_then(|inputs| inputs.try_recv().ok()) {
            if input == Input::Quit {
                return Ok(());
            }
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_taken_as_people_write_them() {
        for (text, wanted) in [
            ("127.0.0.1:9000", Some("127.0.0.1:9000")),
            ("0.0.0.0", Some("0.0.0.0:8780")),
            ("9001", Some("127.0.0.1:9001")),
            (":9001", Some("127.0.0.1:9001")),
            ("[::1]:9002", Some("[::1]:9002")),
            ("everywhere", None),
        ] {
            assert_eq!(address(text), wanted.map(|w| w.parse().unwrap()), "{text}");
        }
    }
}
