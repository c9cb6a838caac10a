//! The operator's UI of a run or a replay: the page, the terminal UI, or none.
//!
//! - in: `--ui`, `--listen`, `--host`; the UI's end of a [`desk`](crate::desk)
//! - out: an open UI, which the command closes or leaves to its operator at the end

use super::output::{complain, inform, warn};
use crate::desk::{RunEnd, UiEnd};
use crate::operator::Input;
use crate::run::signalled;
use crate::tui;
use crate::web::Server;
use crate::web::guard::HostName;
use anyhow::{Context, anyhow, bail};
use clap::{Args, ValueEnum};
use std::io::{ErrorKind, IsTerminal};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// First port of the page without `--listen`.
const PORT: u16 = 8780;
/// Number of ports that are tried, from [`PORT`] on: other runs may use the first ones.
const PORTS: u16 = 10;

/// Name of the loopback address.
const LOCALHOST: &str = "localhost";

/// Options of the commands that show a run.
#[derive(Debug, Clone, Args)]
pub(super) struct UiArgs {
    /// Operator's UI: web (a page in the browser), tui (a text UI in this
    /// terminal, also over ssh) or none (lines of text on stderr)
    /// [default: web at a terminal, otherwise none]
    #[arg(long, value_enum, value_name = "UI", verbatim_doc_comment, hide_possible_values = true)]
    pub(super) ui: Option<UiKind>,
    /// Address of the page: ADDRESS:PORT, an address (also localhost), or a port
    /// [default: 127.0.0.1 and the first free port from 8780 to 8789]
    #[arg(long, value_name = "ADDR", verbatim_doc_comment)]
    pub(super) listen: Option<String>,
    /// Name by which browsers reach the page through a proxy: NAME or NAME:PORT;
    /// repeatable; an ssh tunnel to a loopback name needs none
    #[arg(long, value_name = "NAME", verbatim_doc_comment)]
    pub(super) host: Vec<HostName>,
}

/// Kind of UI, as a word of the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum UiKind {
    /// Page in the browser
    Web,
    /// Text UI in this terminal, also over ssh
    Tui,
    /// Messages as lines of text on stderr
    None,
}

impl UiArgs {
    /// Returns the kind of UI that the options ask for.
    pub(super) fn kind(&self, json: bool) -> UiKind {
        // Without a terminal no person watches: a script gets no page unless it asks for one.
        let person = std::io::stdin().is_terminal() && std::io::stdout().is_terminal();
        match self.ui {
            Some(word) => word,
            None if self.listen.is_some() || !self.host.is_empty() || (person && !json) => {
                UiKind::Web
            }
            None => UiKind::None,
        }
    }

    /// Checks that the options of the page are given only with a page.
    pub(super) fn check(&self) -> Result<(), String> {
        let given = self.listen.as_ref().map(|_| "--listen");
        let Some(option) = given.or((!self.host.is_empty()).then_some("--host")) else {
            return Ok(());
        };
        let word = match self.ui {
            Some(UiKind::None) => "none",
            Some(UiKind::Tui) => "tui",
            Some(UiKind::Web) | None => return Ok(()),
        };
        Err(format!("{option}: --ui {word} has no page: use --ui web, or leave {option} out"))
    }

    /// Opens a UI at a desk and prints the address of the page. If the page cannot be served and no
    /// option asks for it, the run has no UI.
    pub(super) fn open(&self, kind: UiKind, desk: UiEnd) -> anyhow::Result<Ui> {
        match kind {
            UiKind::None => Ok(Ui::None),
            UiKind::Tui => Ok(Ui::Tui(Terminal::open(desk).context("--ui tui: the terminal")?)),
            UiKind::Web => {
                let served = self.serve(&desk);
                let server = match served {
                    // A page that no option asks for may be missing; the run is more important.
                    Err(error)
                        if self.ui.is_none() && self.listen.is_none() && self.host.is_empty() =>
                    {
                        warn(&format!("the run has no operator's page: {error:#}"));
                        return Ok(Ui::None);
                    }
                    other => other?,
                };
                inform(&format!("the operator's page: {}", server.url));
                inform(&format!("for Foxglove or Lichtblick: {}", server.feed_url));
                for url in &server.proxy_urls {
                    inform(&format!("through a proxy for TLS: {url}"));
                }
                Ok(Ui::Web(server))
            }
        }
    }

    /// Starts the server of the page at the address of `--listen`, otherwise at the first free one
    /// of [`PORTS`] ports.
    fn serve(&self, desk: &UiEnd) -> anyhow::Result<Server> {
        if let Some(text) = &self.listen {
            let address = address(text).ok_or_else(|| {
                anyhow!(
                    "--listen {text}: must be ADDRESS:PORT, an address or a port, as in \
                     127.0.0.1:8780, [::1], localhost:8780 or 8780"
                )
            })?;
            return Server::start_behind(desk.clone(), address, self.host.clone())
                .map_err(|error| listen_error(address, &error));
        }
        // Each run on this machine has a page of its own, so the first ports may be in use.
        for port in PORT..PORT + PORTS {
            let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
            match Server::start_behind(desk.clone(), address, self.host.clone()) {
                Err(error) if error.kind() == ErrorKind::AddrInUse => {}
                other => return other.map_err(|error| listen_error(address, &error)),
            }
        }
        let last = PORT + PORTS - 1;
        bail!("ports {PORT} to {last} are in use: name another one with --listen")
    }
}

/// Returns the error of a page that cannot listen on an address, with what to do.
fn listen_error(address: SocketAddr, error: &std::io::Error) -> anyhow::Error {
    let port = address.port();
    let why = match error.kind() {
        ErrorKind::AddrInUse => format!(
            "port {port} is in use, perhaps by another run of this program (`ss -ltnp sport = \
             :{port}` names the process): without --listen the page takes a free port, \
             {PORT} or the next ones"
        ),
        ErrorKind::AddrNotAvailable => {
            "this machine has no such address: `ip address` lists them".to_owned()
        }
        ErrorKind::PermissionDenied => {
            format!("port {port} needs a special right: name a port from 1024 on")
        }
        _ => error.to_string(),
    };
    anyhow!("the page cannot listen on {address}: {why}")
}

/// Parses the value of `--listen`. A port alone stands for this port of the loopback address, an
/// address alone for its port [`PORT`]. Returns `None` for any other text.
fn address(text: &str) -> Option<SocketAddr> {
    let port = |text: &str| text.parse::<u16>().ok();
    // `localhost` is resolved here, so the printed address has the number.
    let named = text.get(..LOCALHOST.len()).is_some_and(|n| n.eq_ignore_ascii_case(LOCALHOST));
    if named {
        let rest = &text[LOCALHOST.len()..];
        let port = if rest.is_empty() { Some(PORT) } else { rest.strip_prefix(':').and_then(port) };
        return port.map(|port| SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
    }
    text.parse().ok().or_else(|| {
        // An address without a port. One of IPv6 may be in brackets, as it must be before a port.
        let bare = text.strip_prefix('[').and_then(|text| text.strip_suffix(']'));
        let six = bare.and_then(|text| text.parse::<Ipv6Addr>().ok()).map(IpAddr::V6);
        let ip = six.or_else(|| text.parse().ok()).map(|ip| SocketAddr::from((ip, PORT)));
        ip.or_else(|| {
            let port = port(text.strip_prefix(':').unwrap_or(text));
            port.map(|port| SocketAddr::from((Ipv4Addr::LOCALHOST, port)))
        })
    })
}

/// An open UI.
#[derive(Debug)]
pub(super) enum Ui {
    /// No page and no panels: messages are lines on stderr.
    None,
    /// Page in the browser.
    Web(Server),
    /// Text UI in this terminal.
    Tui(Terminal),
}

impl Ui {
    /// Returns whether the UI is a page, which a server sends to browsers.
    pub(super) fn has_page(&self) -> bool {
        matches!(self, Self::Web(..))
    }

    /// Returns whether the UI is in this terminal.
    pub(super) fn has_terminal(&self) -> bool {
        matches!(self, Self::Tui(_))
    }

    /// Closes the UI at once.
    ///
    /// # Errors
    /// The terminal UI failed while it was shown.
    pub(super) fn leave(self) -> anyhow::Result<()> {
        match self {
            Self::None | Self::Web(_) => Ok(()),
            Self::Tui(terminal) => {
                terminal.leave.store(true, Ordering::Release);
                terminal.wait()
            }
        }
    }

    /// Waits after a run for what the operator chooses on the page; without a page the choice is to
    /// leave.
    ///
    /// # Errors
    /// No handler of signals can be installed.
    pub(super) fn choice(&self, run_end: &RunEnd) -> anyhow::Result<Input> {
        match self {
            Self::Web(_) => wait(run_end),
            Self::None | Self::Tui(_) => Ok(Input::Quit),
        }
    }

    /// Tells where the page stays after a run, if there is one.
    pub(super) fn tell_place(&self) {
        if let Self::Web(server) = self {
            inform(&format!(
                "the page stays at {} until Ctrl-C, or until its operator ends it",
                server.url
            ));
        }
    }

    /// Keeps the UI open after a run until the operator leaves: by the page's button, by Ctrl-C, or
    /// in the terminal UI by the key `q`.
    ///
    /// # Errors
    /// The terminal UI failed while it was shown, or no handler of signals can be installed.
    pub(super) fn linger(self, run_end: &RunEnd) -> anyhow::Result<()> {
        match self {
            Self::None => Ok(()),
            Self::Tui(terminal) => terminal.wait(),
            Self::Web(_) => {
                self.tell_place();
                // Only the button that ends the program has a meaning without a run.
                while wait(run_end)? != Input::Quit {}
                Ok(())
            }
        }
    }
}

/// Handle of the thread of the terminal UI. The thread restores the terminal when it ends: by a
/// key, by a signal that ends the program, or when this handle is dropped.
#[derive(Debug)]
pub(super) struct Terminal {
    /// Set to make the thread end.
    leave: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<std::io::Result<()>>>,
}

impl Terminal {
    /// Switches the terminal to the UI's screen and starts the thread that shows the UI of `desk`.
    fn open(desk: UiEnd) -> std::io::Result<Self> {
        let screen = tui::Screen::open()?;
        // A signal must end the UI as well, or the terminal would stay in raw mode.
        let leave = signalled()?;
        let leaves = Arc::clone(&leave);
        let thread = std::thread::Builder::new().name("tui".into()).spawn(move || {
            let shown = tui::show(screen, &desk, &leaves);
            if let Err(error) = &shown {
                // The UI is gone. A replay ends; a run continues until a signal ends it.
                complain(&format!("the terminal UI failed: {error}: SIGTERM stops the run"));
                let _ = desk.send(Input::Quit);
            }
            shown
        })?;
        Ok(Self { leave, thread: Some(thread) })
    }

    /// Waits until the terminal UI has ended, and returns its error.
    fn wait(mut self) -> anyhow::Result<()> {
        match self.left() {
            Some(Ok(shown)) => Ok(shown.context("the terminal UI")?),
            Some(Err(_)) => Err(anyhow!("the thread of the terminal UI panicked")),
            None => Ok(()),
        }
    }

    /// Waits for the terminal's thread and returns its result. A thread that is told to leave and
    /// does not end within a second is abandoned, because its terminal is gone and never answers;
    /// then the result is `None`.
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
        // The panic hook has already reported a panic of the thread.
        let _ = self.left();
    }
}

/// Waits for an input that has a meaning after a run. A signal that ends the program counts as
/// [`Input::Quit`].
fn wait(run_end: &RunEnd) -> anyhow::Result<Input> {
    let signalled = signalled()?;
    let mut inputs = run_end.take_inputs();
    while !signalled.load(Ordering::Acquire) {
        while let Some(input) = inputs.as_mut().and_then(|inputs| inputs.try_recv().ok()) {
            if matches!(
                input,
                Input::Quit | Input::Again { .. } | Input::GoOn | Input::Replay | Input::Report
            ) {
                return Ok(input);
            }
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    Ok(Input::Quit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_options_without_a_page_are_refused() {
        let args = |ui, listen: Option<&str>, host: &[&str]| UiArgs {
            ui,
            listen: listen.map(str::to_owned),
            host: host.iter().map(|name| name.parse().unwrap()).collect(),
        };

        for kind in [UiKind::None, UiKind::Tui] {
            let why = args(Some(kind), Some("8780"), &[]).check().unwrap_err();
            assert!(why.starts_with("--listen: --ui "), "{why}");
            let why = args(Some(kind), None, &["robot.example"]).check().unwrap_err();
            assert!(why.starts_with("--host: --ui "), "{why}");
            assert_eq!(args(Some(kind), None, &[]).check(), Ok(()));
        }
        for kind in [Some(UiKind::Web), None] {
            assert_eq!(args(kind, Some("8780"), &["robot.example"]).check(), Ok(()));
        }
    }

    #[test]
    fn address_accepts_ports_and_addresses() {
        for (text, wanted) in [
            ("127.0.0.1:9000", Some("127.0.0.1:9000")),
            ("0.0.0.0", Some("0.0.0.0:8780")),
            ("9001", Some("127.0.0.1:9001")),
            (":9001", Some("127.0.0.1:9001")),
            ("[::1]:9002", Some("[::1]:9002")),
            ("::1", Some("[::1]:8780")),
            ("[::1]", Some("[::1]:8780")),
            ("localhost", Some("127.0.0.1:8780")),
            ("localhost:9003", Some("127.0.0.1:9003")),
            ("Localhost:9003", Some("127.0.0.1:9003")),
            ("localhost:", None),
            ("localhost.example:9003", None),
            ("[127.0.0.1]", None),
            ("::9001", Some("[::9001]:8780")),
            ("everywhere", None),
        ] {
            assert_eq!(address(text), wanted.map(|w| w.parse().unwrap()), "{text}");
        }
    }
}
