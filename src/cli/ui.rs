//! Which face the operator has: the page, the terminal, or none.

use super::output::complain;
use crate::desk::{Behind, Desk};
use crate::operator::Command;
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

/// The options of every command that shows a run.
#[derive(Debug, Clone, Args)]
pub(super) struct FaceArgs {
    /// The operator's face; the page when a person sits at the terminal
    #[arg(long, value_enum, value_name = "FACE")]
    pub(super) ui: Option<FaceWord>,
    /// Where the page listens: ADDRESS:PORT, an address, or a port; beyond 127.0.0.1 a token is needed
    #[arg(long, value_name = "ADDR")]
    pub(super) listen: Option<String>,
}

/// A kind of face.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum FaceWord {
    /// A page in the browser
    Web,
    /// This terminal, for ssh
    Tui,
    /// Lines on stderr
    None,
}

impl FaceArgs {
    /// The face that is meant.
    pub(super) fn word(&self, json: bool) -> FaceWord {
        let person = std::io::stdin().is_terminal() && std::io::stdout().is_terminal();
        match self.ui {
            Some(word) => word,
            None if self.listen.is_some() || (person && !json) => FaceWord::Web,
            None => FaceWord::None,
        }
    }

    /// Opens a face at a desk, and says where the page is. A page that nobody asked for in words is left out when no
    /// port is free.
    pub(super) fn open(&self, word: FaceWord, desk: Desk) -> anyhow::Result<Face> {
        match word {
            FaceWord::None => Ok(Face::None),
            FaceWord::Tui => Ok(Face::Tui(Terminal::open(desk).context("--ui tui: the terminal")?)),
            FaceWord::Web => {
                let served = self.serve(&desk);
                let server = match served {
                    Err(error) if self.ui.is_none() && self.listen.is_none() => {
                        complain(&format!("no page: {error:#}"));
                        return Ok(Face::None);
                    }
                    other => other?,
                };
                complain(&format!("the operator's page: {}", server.url));
                Ok(Face::Web(server))
            }
        }
    }

    fn serve(&self, desk: &Desk) -> anyhow::Result<Server> {
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

/// An open face.
#[derive(Debug)]
pub(super) enum Face {
    /// Lines on stderr, or nothing.
    None,
    /// The page.
    Web(Server),
    /// The terminal.
    Tui(Terminal),
}

impl Face {
    /// Whether the terminal belongs to the face.
    pub(super) fn has_terminal(&self) -> bool {
        matches!(self, Self::Tui(_))
    }

    /// Leaves at once.
    pub(super) fn leave(self) -> anyhow::Result<()> {
        match self {
            Self::None | Self::Web(_) => Ok(()),
            Self::Tui(terminal) => {
                terminal.leave.store(true, Ordering::Release);
                terminal.wait()
            }
        }
    }

    /// Stays up when the run is over, until the operator leaves: by the page's button, by Ctrl-C, or by `q`.
    pub(super) fn linger(self, behind: &Behind) -> anyhow::Result<()> {
        match self {
            Self::None => Ok(()),
            Self::Tui(terminal) => terminal.wait(),
            Self::Web(server) => {
                let mut err = std::io::stderr().lock();
                // Whoever closed stderr needs no word.
                let _ = writeln!(
                    err,
                    "the page stays at {} until Ctrl-C, or until it is closed there",
                    server.url
                );
                drop(err);
                wait(behind)
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
    fn open(desk: Desk) -> std::io::Result<Self> {
        let screen = tui::Screen::open()?;
        let leave = Arc::new(AtomicBool::new(false));
        for signal in SIGNALS {
            signal_hook::flag::register(signal, Arc::clone(&leave))?;
        }
        let leaves = Arc::clone(&leave);
        let thread = std::thread::Builder::new().name("tui".into()).spawn(move || {
            let shown = tui::show(screen, &desk, &leaves);
            if let Err(error) = &shown {
                // Nobody sees any more what goes on. A replay is left; a run goes on, and is told how to end it.
                complain(&format!("the terminal: {error}; a signal ends the run"));
                let _ = desk.command(Command::Quit);
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

    /// What its thread came to. One that is to leave and does not is left behind: its terminal is gone, and never answers.
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

fn wait(behind: &Behind) -> anyhow::Result<()> {
    let signalled = Arc::new(AtomicBool::new(false));
    for signal in SIGNALS {
        signal_hook::flag::register(signal, Arc::clone(&signalled))?;
    }
    let mut commands = behind.take_commands();
    while !signalled.load(Ordering::Acquire) {
        while let Some(command) = commands.as_mut().and_then(|c| c.try_recv().ok()) {
            if command == Command::Quit {
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
