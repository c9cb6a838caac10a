//! UI: presents what happens and takes the operator's start, pause, resume and terminate.
//!
//! At this stage a terminal face: keys on stdin, a line each, or automatic start. The emergency stop goes past all
//! actors to the servos; it is no safety function. Lines go to stderr, so that
//! stdout stays for machines.

use super::control::Control;
use crate::error::Error;
use crate::hw::driver::Switches;
use std::io::{BufRead, Write};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use tokio::sync::{mpsc, watch};

/// Notices that may wait; more would mean that the terminal hangs, and then they are dropped and counted.
const MAILBOX: usize = 64;

/// What the other actors tell the operator.
#[derive(Debug, Clone, PartialEq)]
pub enum Notice {
    /// A phase of the task begins at this simulated or real time [s].
    Phase(f64, String),
    /// Something worth knowing.
    Note(f64, String),
    /// An error, with its class, actor and place.
    Error(f64, Error),
}

/// The far end of the UI's mailbox.
#[derive(Debug, Clone)]
pub struct UiHandle {
    mailbox: mpsc::Sender<Notice>,
}

impl UiHandle {
    /// Tells the operator; never waits.
    pub fn tell(&self, notice: Notice) {
        if self.mailbox.try_send(notice).is_err() {
            tracing::warn!("the operator's terminal does not keep up: a notice was dropped");
        }
    }
}

/// The mailbox alone: whoever takes the receiver is the operator's face.
#[must_use]
pub fn mailbox() -> (UiHandle, mpsc::Receiver<Notice>) {
    let (mailbox, notices) = mpsc::channel(MAILBOX);
    (UiHandle { mailbox }, notices)
}

/// What the operator's keys act on.
#[derive(Debug, Clone)]
pub struct Keys {
    /// Start, pause, resume, terminate.
    pub control: Arc<watch::Sender<Control>>,
    /// The emergency stop.
    pub switches: Arc<Switches>,
}

/// Creates the UI. `quiet` writes nothing; `keys` listens on stdin.
#[must_use]
pub fn spawn(quiet: bool, keys: Option<Keys>) -> UiHandle {
    let (handle, mut notices) = mailbox();
    if let Some(keys) = keys {
        let mut err = std::io::stderr().lock();
        let _ = writeln!(
            err,
            "keys: s start, p pause, r resume, t terminate, e emergency stop; Enter after each"
        );
        // A thread of its own: stdin cannot be awaited under paused time.
        std::thread::spawn(move || obey(std::io::stdin().lock(), &keys));
    }
    tokio::spawn(async move {
        while let Some(notice) = notices.recv().await {
            match &notice {
                Notice::Phase(_, name) => tracing::info!(phase = %name, "phase"),
                Notice::Note(_, text) => tracing::info!("{text}"),
                Notice::Error(_, error) => tracing::error!("{error}"),
            }
            if !quiet {
                let mut err = std::io::stderr().lock();
                // A closed stderr leaves nobody to tell.
                let _ = match &notice {
                    Notice::Phase(t, name) => writeln!(err, "{t:9.2} s  {name}"),
                    Notice::Note(_, text) => writeln!(err, "       note: {text}"),
                    Notice::Error(t, error) => writeln!(err, "{t:9.2} s  ! {error}"),
                };
            }
        }
    });
    handle
}

/// Obeys the operator's words, a line each, until they end.
fn obey(words: impl BufRead, keys: &Keys) {
    let control = &keys.control;
    for line in words.lines().map_while(Result::ok) {
        let next = match line.trim() {
            "s" | "start" | "r" | "resume" | "" => Control::Running,
            "p" | "pause" => Control::Paused,
            "t" | "terminate" | "q" => Control::Terminated,
            "e" | "stop" => {
                keys.switches.emergency.store(true, Ordering::Release);
                continue;
            }
            other => {
                let _ = writeln!(std::io::stderr(), "'{other}' is none of s, p, r, t, e");
                continue;
            }
        };
        if *control.borrow() == Control::Terminated {
            return;
        }
        control.send_replace(next);
    }
    // The end of input never makes the run wait.
    control.send_if_modified(|now| {
        let waits = matches!(now, Control::Waiting | Control::Paused);
        if waits {
            *now = Control::Running;
        }
        waits
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the operator's words come to.
    fn after(words: &str) -> Control {
        let (control, _will) = watch::channel(Control::Waiting);
        let keys = Keys { control: Arc::new(control), switches: Arc::default() };
        obey(words.as_bytes(), &keys);
        assert_eq!(keys.switches.emergency.load(Ordering::Acquire), words.contains("e\n"));
        *keys.control.borrow()
    }

    #[test]
    fn the_emergency_stop_reaches_the_servos_at_once() {
        assert_eq!(after("s\ne\n"), Control::Running);
    }

    #[test]
    fn the_end_of_input_makes_nobody_wait() {
        assert_eq!(after(""), Control::Running);
        assert_eq!(after("s\np\n"), Control::Running);
        assert_eq!(after("what\n"), Control::Running);
    }

    #[test]
    fn who_terminates_does_not_come_back() {
        assert_eq!(after("s\nt\n"), Control::Terminated);
        assert_eq!(after("t\nr\n"), Control::Terminated);
    }
}
