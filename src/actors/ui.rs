//! UI: presents what happens and takes the operator's commands.
//!
//! It owns the snapshot that every face shows, and obeys what they command: page, terminal and the keys on stdin sit at
//! the same [`Desk`]. Notices come by a bounded mailbox, what changes quickly by the [`Board`]; nobody waits for it.
//! It lives on a thread of its own, in wall-clock time: a virtual run neither sees it nor slows down for it. The
//! emergency stop goes past all actors to the servos; it is no safety function. Lines go to stderr, so that stdout
//! stays for machines.

use super::board::Board;
use super::control::{Control, Tempo, Word, is_speed};
use super::notice::{Notice, UiHandle, mailbox};
use super::present::Presenter;
use crate::desk::{Behind, Desk, desk};
use crate::operator::{Command, OutcomeView};
use crate::record::recorder::Recorder;
use crate::record::run_hash::RunHash;
use std::io::{BufRead, Write};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch};

/// Time between two snapshots.
const REFRESH: Duration = Duration::from_millis(50);

/// What the operator's commands act on.
#[derive(Debug, Clone)]
pub struct Helm {
    /// Start, pause, resume, terminate.
    pub control: Arc<watch::Sender<Control>>,
    /// Answers and orders to MP.
    pub words: mpsc::Sender<Word>,
    /// How fast simulated time may go.
    pub tempo: Tempo,
}

/// How the UI is created.
pub struct Parts {
    /// Writes nothing to stderr.
    pub quiet: bool,
    /// Listens to keys on stdin.
    pub keys: bool,
    /// What commands act on.
    pub helm: Helm,
    /// The end at which faces listen; `None` when there are none.
    pub behind: Option<Behind>,
    /// Makes the snapshots, when there are faces.
    pub presenter: Option<Presenter>,
    /// Where the latest values stand, when there are faces.
    pub board: Option<Board>,
    /// What keeps the run.
    pub recorder: Recorder,
    /// Where commands that were obeyed are noted.
    pub tape: RunHash,
}

/// The running UI.
#[derive(Debug)]
pub struct Ui {
    /// For the other actors.
    pub handle: UiHandle,
    /// The flag of the emergency stop, for the servos.
    pub emergency: Arc<std::sync::atomic::AtomicBool>,
    thread: std::thread::JoinHandle<()>,
}

impl Ui {
    /// Creates the UI.
    ///
    /// # Errors
    /// What the operating system says to another thread.
    pub fn spawn(parts: Parts) -> std::io::Result<Self> {
        let (mut handle, mut notices) = mailbox();
        handle.board.clone_from(&parts.board);
        handle.recorder.clone_from(&parts.recorder);
        let behind = parts.behind.unwrap_or_else(|| desk().1);
        let keys = parts.keys.then(|| behind.desk());
        if let Some(desk) = keys {
            let mut err = std::io::stderr().lock();
            let _ = writeln!(
                err,
                "keys: s start, p pause, r resume, t terminate, e emergency stop; Enter after each"
            );
            // stdin cannot be awaited: a thread waits for it, and ends with the process.
            let alone = parts.presenter.is_none();
            std::thread::spawn(move || listen(std::io::stdin().lock(), &desk, alone));
        }
        let emergency = Arc::clone(&behind.emergency);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build()?;
        let (quiet, helm, tape) = (parts.quiet, parts.helm, parts.tape);
        let mut presenter = parts.presenter;
        let work = move || {
            runtime.block_on(async move {
                let mut commands = behind.take_commands();
                let mut refresh = tokio::time::interval(REFRESH);
                refresh.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
                loop {
                    tokio::select! {
                        biased;
                        Some(command) = next(&mut commands) => {
                            let done = obey(&command, &helm);
                            if done == Ok(true) {
                                tape.message("operator", "ui", &command);
                            }
                            if let Some(presenter) = &mut presenter {
                                presenter.commanded(&command, done.map(drop));
                            }
                        }
                        notice = notices.recv() => {
                            let Some(notice) = notice else { break };
                            if !quiet {
                                print(&notice);
                            }
                            if let Some(presenter) = &mut presenter {
                                presenter.notice(&notice);
                            }
                            if matches!(notice, Notice::Over(_)) {
                                break;
                            }
                        }
                        _ = refresh.tick(), if presenter.is_some() => {
                            if let Some(presenter) = &mut presenter {
                                presenter.publish(&behind, *helm.control.borrow(), helm.tempo.limit());
                            }
                        }
                    }
                }
                if let Some(presenter) = &mut presenter {
                    presenter.publish(&behind, *helm.control.borrow(), helm.tempo.limit());
                }
                if let Some(commands) = commands {
                    behind.return_commands(commands);
                }
            });
        };
        let thread = std::thread::Builder::new().name("ui".into()).spawn(work)?;
        Ok(Self { handle, emergency, thread })
    }

    /// Shows how the run ended, and ends.
    pub fn over(self, outcome: OutcomeView) {
        // With the mailbox full the terminal hangs; the end then comes with the last handle.
        let over = Notice::Over(outcome);
        super::notice::note(&self.handle.recorder, &over);
        let _ = self.handle.mailbox.blocking_send(over);
        drop(self.handle);
        // A panic has told of itself.
        let _ = self.thread.join();
    }
}

async fn next(commands: &mut Option<mpsc::Receiver<Command>>) -> Option<Command> {
    match commands {
        Some(commands) => commands.recv().await,
        None => std::future::pending().await,
    }
}

fn print(notice: &Notice) {
    // Whoever reads the log sees it in its place; it is told once all the same.
    match notice {
        Notice::Phase(_, name) => tracing::info!(phase = %name, "phase"),
        Notice::Note(_, text) | Notice::Warning(_, text) => tracing::info!("{text}"),
        Notice::Error(_, error) => tracing::debug!("{error}"),
        Notice::Over(_) => return,
    }
    let mut err = std::io::stderr().lock();
    // A closed stderr leaves nobody to tell.
    let _ = match notice {
        Notice::Phase(t, name) => writeln!(err, "{t:9.2} s  {name}"),
        Notice::Note(_, text) | Notice::Warning(_, text) => {
            writeln!(err, "       note: {text}")
        }
        Notice::Error(t, error) => writeln!(err, "{t:9.2} s  ! {error}"),
        Notice::Over(_) => Ok(()),
    };
}

/// Obeys a command: whether that changed anything; `Err` says why not. A start of what runs is nothing, and not noted:
/// the end of input says one at whatever time it comes.
fn obey(command: &Command, helm: &Helm) -> Result<bool, &'static str> {
    let control = &helm.control;
    let now = *control.borrow();
    let turn = |to| {
        control.send_if_modified(|control| {
            let changes = *control != to;
            *control = to;
            changes
        })
    };
    let over = || if now == Control::Terminated { Err("the run is over") } else { Ok(()) };
    match command {
        // A start moves no arm that was paused.
        Command::Start if now == Control::Paused => return Err("the run has begun: resume it"),
        Command::Start | Command::Resume => {
            over()?;
            return Ok(turn(Control::Running));
        }
        Command::Pause => {
            over()?;
            if now == Control::Waiting {
                return Err("the run has not begun");
            }
            return Ok(turn(Control::Paused));
        }
        Command::Terminate => return Ok(turn(Control::Terminated)),
        // The flag was set on the way here. A run that waits for its start begins stopped: so its arms tell of it.
        Command::EmergencyStop => {
            if now == Control::Waiting {
                turn(Control::Running);
            }
        }
        Command::Answer { question, answer } => {
            let word = Word::Answer(*question, answer.clone());
            helm.words.try_send(word).map_err(|_| "nobody waits for an answer")?;
        }
        // A word that waited would be carried out at once when the run goes on, when nobody expects it any more.
        Command::Manual { .. } if now == Control::Paused => {
            return Err("the run is paused: resume it first");
        }
        Command::Manual { .. } if now == Control::Waiting => return Err("the run has not begun"),
        Command::Manual { effector, order } => {
            let word = Word::Order(*effector, order.clone());
            helm.words.try_send(word).map_err(|_| "the arms are busy")?;
        }
        Command::Speed { factor } if !is_speed(*factor) => {
            return Err("0.01 times real time is the slowest, 0 is as fast as it computes");
        }
        Command::Speed { factor } => helm.tempo.set(*factor),
        Command::Quit | Command::Seek { .. } => return Err("not while a run is on"),
    }
    Ok(true)
}

/// Listens to the operator's words, a line each, until they end; `alone`: there is no other face.
fn listen(words: impl BufRead, desk: &Desk, alone: bool) {
    for line in words.lines().map_while(Result::ok) {
        let command = match line.trim() {
            "s" | "start" | "r" | "resume" => Command::Resume,
            "" => Command::Start,
            "p" | "pause" => Command::Pause,
            "t" | "terminate" | "q" => Command::Terminate,
            "e" | "stop" => Command::EmergencyStop,
            other => {
                let _ = writeln!(std::io::stderr(), "'{other}' is none of s, p, r, t, e");
                continue;
            }
        };
        let _ = desk.command(command);
    }
    // The end of input never makes a run wait that nobody else could start.
    if alone {
        let _ = desk.command(Command::Resume);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::Ordering;

    /// What the operator's words come to.
    fn after(words: &str) -> (Control, bool) {
        told(words, true)
    }

    fn told(words: &str, alone: bool) -> (Control, bool) {
        let (control, _will) = watch::channel(Control::Waiting);
        let helm =
            Helm { control: Arc::new(control), words: mpsc::channel(1).0, tempo: Tempo::default() };
        let (desk, behind) = desk();
        listen(words.as_bytes(), &desk, alone);
        let mut commands = behind.take_commands().unwrap();
        while let Ok(command) = commands.try_recv() {
            let _ = obey(&command, &helm);
        }
        (*helm.control.borrow(), behind.emergency.load(Ordering::Acquire))
    }

    #[test]
    fn the_emergency_stop_reaches_the_servos_at_once() {
        assert_eq!(after("s\ne\n"), (Control::Running, true));
    }

    #[test]
    fn an_emergency_stop_before_the_start_does_not_wait_for_one() {
        assert_eq!(told("e\n", false), (Control::Running, true));
        assert_eq!(told("p\ne\nt\n", false), (Control::Terminated, true));
    }

    #[test]
    fn a_speed_at_which_time_as_good_as_stands_still_is_refused() {
        let (words, tempo) = (mpsc::channel(1).0, Tempo::default());
        let control = Arc::new(watch::channel(Control::Running).0);
        let helm = Helm { control, words, tempo: tempo.clone() };
        for factor in [1e-300, 1e-6, -1.0, f64::NAN, f64::INFINITY] {
            assert!(obey(&Command::Speed { factor }, &helm).is_err(), "{factor}");
        }
        for factor in [0.0, 0.01, 20.0] {
            obey(&Command::Speed { factor }, &helm).unwrap();
            assert_eq!(tempo.limit(), factor);
        }
    }

    #[test]
    fn the_end_of_input_makes_nobody_wait() {
        assert_eq!(after(""), (Control::Running, false));
        assert_eq!(after("s\np\n"), (Control::Running, false));
        assert_eq!(after("what\n"), (Control::Running, false));
        assert_eq!(told("", false), (Control::Waiting, false), "a page may still start it");
    }

    #[test]
    fn a_bare_enter_starts_but_moves_no_arm_that_was_paused() {
        let (control, _will) = watch::channel(Control::Waiting);
        let helm =
            Helm { control: Arc::new(control), words: mpsc::channel(1).0, tempo: Tempo::default() };

        obey(&Command::Start, &helm).unwrap();
        assert_eq!(*helm.control.borrow(), Control::Running);
        obey(&Command::Pause, &helm).unwrap();
        assert!(obey(&Command::Start, &helm).is_err());
        assert_eq!(*helm.control.borrow(), Control::Paused);
    }

    #[test]
    fn an_order_by_hand_is_refused_during_a_pause_and_does_not_wait_for_its_end() {
        let (words, mut heard) = mpsc::channel(4);
        let (control, _will) = watch::channel(Control::Running);
        let helm = Helm { control: Arc::new(control), words, tempo: Tempo::default() };
        let jog = Command::Manual { effector: 0, order: crate::operator::Manual::Bias };

        for (before, why) in [(Control::Paused, "paused"), (Control::Waiting, "not begun")] {
            helm.control.send_replace(before);
            assert!(obey(&jog, &helm).unwrap_err().contains(why));
        }
        helm.control.send_replace(Control::Running);
        assert!(heard.try_recv().is_err(), "nothing waited");
        obey(&jog, &helm).unwrap();
        assert!(heard.try_recv().is_ok());
    }

    #[test]
    fn who_terminates_does_not_come_back() {
        assert_eq!(after("s\nt\n"), (Control::Terminated, false));
        assert_eq!(after("t\nr\n"), (Control::Terminated, false));
    }
}
