//! Decisions about signals. A process that drives arms must not die of a signal, nor be stopped by
//! one that its terminal sends: the arms' controllers would keep the last drive.
//!
//! | signal | cause | decision |
//! |---|---|---|
//! | INT, TERM, QUIT, ALRM | Ctrl-C, `kill`, `timeout` | ends the run; again: ends at once |
//! | HUP | the terminal closes | ends the run, however often it comes |
//! | XCPU | limit of processor time, each second | ends the run, however often it comes |
//! | XFSZ | limit of a file's size | ignored: the write fails, which is reported |
//! | TTIN, TTOU | terminal, while in the background | ignored: keys wait for the foreground |
//! | USR1, USR2, IO (POLL), VTALRM, PROF | other programs, by mistake | ignored: no function here |
//! | KILL, STOP, TSTP | `kill -9`, Ctrl-Z | none: cannot be caught, or the operator wants it |
//!
//! The first signal acts as the operator's terminate, so that the run ends at its next macrostep
//! and still makes its summary.
//!
//! A thread waits for the signals, outside the runtime and its paused time. A second signal presses
//! the emergency stop and ends the process, in case the run cannot obey the first one.

use crate::actors::control::Control;
use crate::emergency_stop::StopButton;
use signal_hook::consts::{
    SIGALRM, SIGHUP, SIGINT, SIGIO, SIGPROF, SIGQUIT, SIGTERM, SIGTTIN, SIGTTOU, SIGUSR1, SIGUSR2,
    SIGVTALRM, SIGXCPU, SIGXFSZ,
};
use signal_hook::iterator::{Handle, Signals};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::watch;

/// Signals that end a run. A process that drives arms must not die of any of them.
pub(crate) const SIGNALS: [i32; 6] = [SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGALRM, SIGXCPU];
/// Signals that come several times without a person who sends them.
const REPEATED: [i32; 2] = [SIGHUP, SIGXCPU];
/// Signals that a run ignores.
const IGNORED: [i32; 8] = [SIGXFSZ, SIGTTIN, SIGTTOU, SIGUSR1, SIGUSR2, SIGIO, SIGVTALRM, SIGPROF];
/// Time in which the bridge switches the drives off.
pub(super) const SWITCHES_OFF: Duration = Duration::from_millis(300);
/// Exit code of an interrupted process.
const INTERRUPTED: i32 = 130;

/// Returns the signals that end a run: [`SIGNALS`], without SIGHUP if the program was started with
/// that one ignored, as `nohup` does.
#[must_use]
pub(crate) fn ending_signals() -> Vec<i32> {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    // A mask in hexadecimal, with bit n - 1 for signal n.
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    let is_ignored = |signal: i32| ignored >> (signal - 1) & 1 == 1;
    SIGNALS.into_iter().filter(|&signal| signal != SIGHUP || !is_ignored(signal)).collect()
}

/// Returns a flag that each of [`SIGNALS`] sets from now on.
///
/// # Errors
/// The error of the system, if it takes no handler.
pub(crate) fn signalled() -> std::io::Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    for signal in SIGNALS {
        signal_hook::flag::register(signal, Arc::clone(&flag))?;
    }
    Ok(flag)
}

/// Makes the process ignore the signals that have no meaning for a run. A handler that does nothing
/// would not suffice: the system would repeat the read that SIGTTIN interrupts again and again.
#[allow(unsafe_code, reason = "no safe function sets a signal to be ignored")]
pub(super) fn ignore_others() {
    for signal in IGNORED {
        // SAFETY: the signals exist, and no code runs when one comes.
        unsafe { libc::signal(signal, libc::SIG_IGN) };
    }
}

/// Listener for signals, which ends when it is dropped.
#[derive(Debug)]
pub(super) struct Interrupt {
    came: Arc<AtomicBool>,
    handle: Handle,
}

impl Interrupt {
    /// Starts a listener. It terminates the run by `control` at the first signal; at a second one
    /// it presses the emergency stop and ends the process.
    ///
    /// # Errors
    /// If the signals cannot be registered, or the system gives no thread.
    pub(super) fn listen(
        control: Arc<watch::Sender<Control>>,
        stop: StopButton,
    ) -> std::io::Result<Self> {
        let mut signals = Signals::new(ending_signals())?;
        let handle = signals.handle();
        let came = Arc::new(AtomicBool::new(false));
        let noted = Arc::clone(&came);
        ignore_others();
        std::thread::Builder::new().name("signals".into()).spawn(move || {
            for signal in signals.forever() {
                let again = noted.swap(true, Ordering::SeqCst);
                if again && !REPEATED.contains(&signal) {
                    stop.press();
                    std::thread::sleep(SWITCHES_OFF);
                    signal_hook::low_level::exit(INTERRUPTED);
                }
                control.send_replace(Control::Terminated);
            }
        })?;
        Ok(Self { came, handle })
    }

    /// Returns whether a signal arrived.
    pub(super) fn came(&self) -> bool {
        self.came.load(Ordering::SeqCst)
    }
}

impl Drop for Interrupt {
    /// Ends the thread that waits for signals.
    fn drop(&mut self) {
        self.handle.close();
    }
}
