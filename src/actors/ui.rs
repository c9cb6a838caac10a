//! UI: the actor that presents the run to the operator and applies the operator's inputs.
//!
//! It makes the snapshots that all user interfaces show (page, terminal), and applies the inputs
//! that they and the keys on stdin send: all of them share one [`Desk`]. Notices arrive by a
//! bounded mailbox, values that change in each period by the [`LatestValues`]. No other actor waits
//! for the UI. It lives on a thread of its own, in wall-clock time: a virtual run neither sees it
//! nor slows down for it. The emergency stop bypasses all actors on its path to the servos
//! ([`crate::emergency_stop`]). The UI writes lines to stderr; stdout stays for machines.
//!
//! - in: inputs of the operator, notices of the other actors, the latest values
//! - out: snapshots, pictures and the stage; the operator's control; answers and orders to MP

use super::control::{Control, Tempo, is_speed};
use super::latest::LatestValues;
use super::notice::Notice;
use super::present::Presenter;
use super::trace::Trace;
use super::tuning::Orders;
use crate::desk::{Desk, Given, Inputs, RunEnd, UiEnd};
use crate::emergency_stop::{StopButton, StopSignal};
use crate::hw::console::{self, Tone};
use crate::operator::parameter::AllBounds;
use crate::operator::{Class, Input, OutcomeView};
use crate::record::recorder::Recorder;
use crate::record::run_hash::RunHash;
use std::borrow::Cow;
use std::io::BufRead;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::MissedTickBehavior;

/// Time between two snapshots.
const REFRESH: Duration = Duration::from_millis(50);
/// Pause between two tries to read keys while the process is in the background.
const BACKGROUND: Duration = Duration::from_millis(200);

/// The parts of a run on which the operator's inputs act.
#[derive(Debug, Clone)]
pub struct OperatorControls {
    /// Start, pause, resume and terminate.
    pub control: Arc<watch::Sender<Control>>,
    /// Answers and orders to MP.
    pub to_task: mpsc::Sender<Input>,
    /// Limit of the speed of simulated time.
    pub tempo: Tempo,
    /// Orders of parameters.
    pub orders: Arc<watch::Sender<Orders>>,
    /// Bounds of the parameters.
    pub bounds: AllBounds,
}

/// The parts of the UI.
pub struct Parts {
    /// Whether it writes nothing to stderr.
    pub quiet: bool,
    /// Whether it reads keys from stdin.
    pub keys: bool,
    /// Whether no other UI gives inputs: then the end of stdin starts the run.
    pub alone: bool,
    /// Parts of the run on which inputs act.
    pub controls: OperatorControls,
    /// The run's end of the desk; `None` without a UI.
    pub desk: Option<RunEnd>,
    /// Maker of the snapshots; `None` without a UI.
    pub presenter: Option<Presenter>,
    /// Latest values; `None` without a UI.
    pub latest: Option<LatestValues>,
    /// Recording of the run.
    pub recorder: Recorder,
    /// Hash of the run, which covers the inputs that were applied.
    pub hash: RunHash,
}

/// The running UI.
#[derive(Debug)]
pub struct Ui {
    /// Trace for the other actors.
    pub trace: Trace,
    /// Handle that presses the emergency stop at the operator's desk.
    pub stop_button: StopButton,
    /// Handle that reads the emergency stop at the operator's desk.
    pub stop_signal: StopSignal,
    thread: std::thread::JoinHandle<()>,
}

impl Ui {
    /// Creates the UI on a thread of its own.
    ///
    /// # Errors
    /// The error of the operating system, if it refuses another thread.
    pub fn spawn(parts: Parts) -> std::io::Result<Self> {
        let (trace, notices) = Trace::new(parts.hash.clone(), parts.recorder, parts.latest);
        let desk = parts.desk.unwrap_or_else(|| Desk::default().run_end());
        if parts.keys {
            listen_to_stdin(desk.ui_end(), parts.alone)?;
        }
        let (stop_button, stop_signal) = (desk.stop_button(), desk.stop_signal());
        // A runtime of its own: that of the run may have a paused clock.
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build()?;
        let Parts { quiet, controls, presenter, hash, .. } = parts;
        let shell = Shell { quiet, controls, desk, presenter, hash };
        let work = move || runtime.block_on(shell.run(notices));
        let thread = std::thread::Builder::new().name("ui".into()).spawn(work)?;
        Ok(Self { trace, stop_button, stop_signal, thread })
    }

    /// Shows the outcome of the run and waits until the UI has ended.
    pub fn over(self, outcome: OutcomeView) {
        self.trace.tell_last(Notice::Over(outcome));
        // The panic of that thread has been printed already.
        let _ = self.thread.join();
    }
}

/// The state of the UI's loop.
struct Shell {
    quiet: bool,
    controls: OperatorControls,
    desk: RunEnd,
    presenter: Option<Presenter>,
    hash: RunHash,
}

impl Shell {
    /// Serves inputs, notices and snapshots until the run is over.
    async fn run(mut self, mut notices: mpsc::Receiver<Notice>) {
        let mut inputs = self.desk.take_inputs();
        let mut refresh = tokio::time::interval(REFRESH);
        // Snapshots that are missed are out of date: none is made up for.
        refresh.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                // Inputs come first: a flood of notices must not delay a pause.
                biased;
                Some(given) = next(&mut inputs) => self.obey(&given),
                notice = notices.recv() => {
                    // The last clone of the trace is gone: the run ended without an outcome.
                    let Some(notice) = notice else { break };
                    self.present(&notice);
                    if matches!(notice, Notice::Over(_)) {
                        break;
                    }
                }
                _ = refresh.tick(), if self.presenter.is_some() => self.publish(),
            }
        }
        // The UIs show the outcome, which came after the last regular snapshot.
        self.publish();
    }

    /// Applies an input and shows the result to the operator.
    fn obey(&mut self, given: &Given) {
        let input = &given.input;
        let done = match given.refusal() {
            Some(why) => Err(why.into()),
            None => apply(input, &self.controls),
        };
        if done == Ok(true) {
            // An input without an effect must not change the hash of the run.
            self.hash.message("operator", "ui", input);
        }
        if let Some(presenter) = &mut self.presenter {
            presenter.obeyed(input, &done.map(drop));
        }
    }

    /// Prints a notice and takes it into the next snapshot.
    fn present(&mut self, notice: &Notice) {
        if !self.quiet {
            print(notice);
        }
        if let Some(presenter) = &mut self.presenter {
            presenter.notice(notice);
        }
    }

    /// Publishes a snapshot if there is a presenter.
    fn publish(&mut self) {
        let Some(presenter) = &mut self.presenter else { return };
        let control = *self.controls.control.borrow();
        presenter.publish(&self.desk, control, self.controls.tempo.limit());
    }
}

/// Waits for the operator's next input; forever if another receiver has taken the inputs.
async fn next(inputs: &mut Option<Inputs>) -> Option<Given> {
    match inputs {
        Some(inputs) => inputs.recv().await,
        // `None` would end the loop of the UI at once.
        None => std::future::pending().await,
    }
}

/// Writes a notice to the log and to stderr.
fn print(notice: &Notice) {
    // In the log the notice appears among the lines of its time.
    match notice {
        Notice::Phase(_, name) => tracing::info!(phase = %name, "phase"),
        Notice::Note(_, text) | Notice::Warning(_, text) => tracing::info!("{text}"),
        Notice::Error(_, error) => tracing::debug!("{error}"),
        Notice::Elsewhere(_, _, who, text) => tracing::info!("{who}: {text}"),
        Notice::Over(_) => return,
    }
    match notice {
        Notice::Phase(t, name) => console::timed(Tone::Plain, &format!("{t:9.2} s  {name}")),
        Notice::Note(_, text) => console::timed(Tone::Plain, &format!("       note: {text}")),
        Notice::Warning(_, text) => console::timed(Tone::Warning, &format!("       note: {text}")),
        Notice::Elsewhere(t, class, who, text) => {
            let (tone, mark) = match class {
                Class::Info => (Tone::Plain, "note:"),
                Class::Warning => (Tone::Warning, "note:"),
                Class::NonFatal | Class::Fatal | Class::System => (Tone::Error, "!"),
            };
            console::timed(tone, &format!("{t:9.2} s  {mark} {who}: {text}"));
        }
        // A camera or a bridge may have sent the reason.
        Notice::Error(t, error) => console::timed(Tone::Error, &format!("{t:9.2} s  ! {error}")),
        Notice::Over(_) => {}
    }
}

/// Applies an input to the run. Returns whether it changed anything, or the reason for a refusal.
///
/// A start of a running run changes nothing and is not recorded, since the end of stdin gives one
/// at any time.
fn apply(input: &Input, controls: &OperatorControls) -> Result<bool, Cow<'static, str>> {
    let set = |to| {
        controls.control.send_if_modified(|control| {
            let changes = *control != to;
            *control = to;
            changes
        })
    };
    let to_task = |refusal: &'static str| match controls.to_task.try_send(input.clone()) {
        Ok(()) => Ok(true),
        Err(_) => Err(refusal.into()),
    };
    let now = *controls.control.borrow();
    match (input, now) {
        // A start, which a bare Enter gives, must not move an arm that was paused.
        (Input::Start, Control::Paused) => Err("the run has begun: resume it".into()),
        // A terminate is final.
        (Input::Start | Input::Resume | Input::Pause, Control::Terminated) => {
            Err("the run is terminated".into())
        }
        (Input::Start | Input::Resume, _) => Ok(set(Control::Running)),
        (Input::Pause | Input::Manual { .. }, Control::Waiting) => {
            Err("the run has not begun: start it first".into())
        }
        (Input::Pause, _) => Ok(set(Control::Paused)),
        (Input::Terminate, _) => Ok(set(Control::Terminated)),
        // The desk has pressed the button before it sent this input. A run that waits for its start
        // begins stopped, so that its arms report the stop.
        (Input::EmergencyStop, Control::Waiting) => {
            set(Control::Running);
            Ok(true)
        }
        (Input::EmergencyStop, _) => Ok(true),
        (Input::Answer { .. }, _) => to_task("no question waits for an answer"),
        // A queued order would move an arm unexpectedly, as soon as the run is resumed.
        (Input::Manual { .. }, Control::Paused) => Err("the run is paused: resume it first".into()),
        (Input::Manual { .. }, _) => to_task("the arms are busy"),
        (Input::Speed { factor }, _) if is_speed(*factor) => {
            controls.tempo.set(*factor);
            Ok(true)
        }
        (Input::Speed { .. }, _) => {
            Err("the least speed is 0.01 times real time; 0 is unlimited".into())
        }
        (Input::Parameter { .. }, Control::Terminated) => Err("the run is terminated".into()),
        // Several orders before the start would be one input.
        (Input::Parameter { .. }, Control::Waiting) => Err("the run has not started".into()),
        (Input::Parameter { parameter, value }, _) => {
            controls.bounds[*parameter].check(*value).map_err(|why| why.to_string())?;
            controls.orders.send_modify(|orders| orders.order(*parameter, *value));
            Ok(true)
        }
        // These are inputs of a replay.
        (Input::Quit | Input::Seek { .. }, _) => Err("a run cannot do this, only a replay".into()),
        (Input::Again { .. } | Input::GoOn | Input::Replay | Input::Report, _) => {
            Err("the run is not over".into())
        }
    }
}

/// Starts a thread that reads keys from stdin. It ends with the process, since a read from stdin
/// cannot be cancelled. `alone` means that there is no other UI.
///
/// # Errors
/// The error of the operating system, if it refuses another thread.
fn listen_to_stdin(desk: UiEnd, alone: bool) -> std::io::Result<()> {
    let keys = "keys: s start, p pause, r resume, t terminate, e emergency stop; Enter after each";
    console::line(Tone::Plain, keys);
    let work = move || listen(std::io::stdin().lock(), &desk, alone);
    std::thread::Builder::new().name("keys".into()).spawn(work)?;
    Ok(())
}

/// Sends the operator's input that each line names, until the lines end. `alone` means that there
/// is no other UI: then the end of the lines starts the run.
fn listen(lines: impl BufRead, desk: &UiEnd, alone: bool) {
    // A process in the background may not read the terminal: the read fails, since the signal
    // SIGTTIN is ignored. The process may come to the foreground again, so the read is repeated.
    let mut lines = lines.lines();
    let in_background = |why: &std::io::Error| why.raw_os_error() == Some(libc::EIO);
    let next = std::iter::from_fn(|| {
        loop {
            match lines.next()? {
                Err(why) if in_background(&why) => std::thread::sleep(BACKGROUND),
                line => return line.ok(),
            }
        }
    });
    for line in next {
        let input = match line.trim() {
            "s" | "start" | "r" | "resume" => Input::Resume,
            "" => Input::Start,
            "p" | "pause" => Input::Pause,
            "t" | "terminate" | "q" => Input::Terminate,
            "e" | "stop" => Input::EmergencyStop,
            other => {
                let words = format!("unknown key '{other}': use s, p, r, t or e");
                console::line(Tone::Warning, &words);
                continue;
            }
        };
        let _ = desk.send(input);
    }
    // Without keys and without another UI the run would wait forever for its start.
    if alone {
        let _ = desk.send(Input::Resume);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operator::Parameter;
    use crate::operator::parameter::Bounds;

    /// Returns the operator's controls of a run in the state `control`, and the receiver of the
    /// inputs that go to its task.
    fn controls(control: Control) -> (OperatorControls, mpsc::Receiver<Input>) {
        let control = Arc::new(watch::channel(control).0);
        let (to_task, task) = mpsc::channel(4);
        let (orders, bounds) =
            (Arc::new(watch::channel(Orders::default()).0), AllBounds::default());
        (OperatorControls { control, to_task, tempo: Tempo::default(), orders, bounds }, task)
    }

    /// Stdin of a process in the background of its terminal, which comes to the foreground later.
    struct Background(u32);

    impl std::io::Read for Background {
        fn read(&mut self, to: &mut [u8]) -> std::io::Result<usize> {
            self.0 += 1;
            match self.0 {
                1 | 2 => Err(std::io::Error::from_raw_os_error(libc::EIO)),
                3 => {
                    to[..2].copy_from_slice(b"e\n");
                    Ok(2)
                }
                _ => Ok(0),
            }
        }
    }

    #[test]
    fn keys_are_read_after_return_to_the_foreground() {
        let (ui, run) = Desk::default().ends();

        listen(std::io::BufReader::new(Background(0)), &ui, false);

        assert!(run.stop_signal().is_pressed());
    }

    /// Lets a run that waits for its start read `lines` from stdin. Returns its control after them,
    /// and whether the emergency stop is pressed. `alone` means that there is no other UI.
    fn after(lines: &str, alone: bool) -> (Control, bool) {
        let (controls, _task) = controls(Control::Waiting);
        let (ui, run) = Desk::default().ends();
        listen(lines.as_bytes(), &ui, alone);
        let mut inputs = run.take_inputs().unwrap();
        while let Ok(input) = inputs.try_recv() {
            let _ = apply(&input, &controls);
        }
        (*controls.control.borrow(), run.stop_signal().is_pressed())
    }

    #[test]
    fn emergency_stop_line_presses_the_stop_signal() {
        assert_eq!(after("s\ne\n", true), (Control::Running, true));
    }

    #[test]
    fn emergency_stop_works_before_the_run_starts() {
        assert_eq!(after("e\n", false), (Control::Running, true));
        assert_eq!(after("p\ne\nt\n", false), (Control::Terminated, true));
    }

    #[test]
    fn parameter_order_out_of_bounds_is_refused() {
        let (mut controls, _task) = controls(Control::Paused);
        let grip = Parameter::Grip;
        controls.bounds.0[grip as usize] = Bounds { usual: 40.0, least: 30.0, most: 55.0 };
        let order = |value| {
            let before = *controls.orders.borrow();
            let done = apply(&Input::Parameter { parameter: grip, value }, &controls);
            let ordered: Vec<_> = controls.orders.borrow().since(&before).collect();
            (done, ordered)
        };

        let refused = Err("56 is outside 30..55".into());
        assert_eq!(order(56.0), (refused, vec![]));
        let given = vec![Input::Parameter { parameter: grip, value: 50.0 }];
        assert_eq!(order(50.0), (Ok(true), given));
        let refused = Err("the value is not a number".into());
        assert_eq!(order(f64::NAN), (refused, vec![]));
        controls.control.send_replace(Control::Terminated);
        assert_eq!(order(50.0), (Err("the run is terminated".into()), vec![]));
    }

    #[test]
    fn invalid_or_too_slow_speed_factor_is_refused() {
        let (controls, _task) = controls(Control::Running);
        controls.tempo.set(5.0);
        for factor in [1e-300, 0.0099, -1.0, f64::NAN, f64::INFINITY] {
            let why = apply(&Input::Speed { factor }, &controls).unwrap_err();
            assert!(why.contains("least speed is 0.01"), "{factor}: {why}");
            assert_eq!(controls.tempo.limit(), 5.0, "{factor}");
        }
        for factor in [0.0, 0.01, 20.0] {
            apply(&Input::Speed { factor }, &controls).unwrap();
            assert_eq!(controls.tempo.limit(), factor);
        }
    }

    #[test]
    fn end_of_stdin_starts_run_without_web_page() {
        assert_eq!(after("", true), (Control::Running, false));
        assert_eq!(after("s\np\n", true), (Control::Running, false));
        assert_eq!(after("what\n", true), (Control::Running, false));
        assert_eq!(after("", false), (Control::Waiting, false), "a page may still start it");
    }

    #[test]
    fn bare_enter_starts_but_does_not_resume() {
        let (controls, _task) = controls(Control::Waiting);

        apply(&Input::Start, &controls).unwrap();
        assert_eq!(*controls.control.borrow(), Control::Running);
        apply(&Input::Pause, &controls).unwrap();
        assert!(apply(&Input::Start, &controls).is_err());
        assert_eq!(*controls.control.borrow(), Control::Paused);
    }

    #[test]
    fn manual_order_is_refused_in_a_pause() {
        let (controls, mut task) = controls(Control::Running);
        let jog = Input::Manual { effector: 0, order: crate::operator::Manual::Bias };

        for (before, why) in [(Control::Paused, "paused"), (Control::Waiting, "not begun")] {
            controls.control.send_replace(before);
            assert!(apply(&jog, &controls).unwrap_err().contains(why));
        }
        controls.control.send_replace(Control::Running);
        assert!(task.try_recv().is_err(), "no refused order waits");
        apply(&jog, &controls).unwrap();
        assert!(task.try_recv().is_ok());
    }

    /// The keys are start, bare Enter, resume and pause. The end of the lines, without another UI,
    /// is a start as well.
    #[test]
    fn terminated_run_neither_resumes_nor_pauses() {
        for key in ["s", "", "r", "p"] {
            for before in ["t", "s\nt", "s\np\nt"] {
                let told = after(&format!("{before}\n{key}\n"), false);
                assert_eq!(told, (Control::Terminated, false), "{before:?}, then {key:?}");
            }
        }
        assert_eq!(after("t\n", true), (Control::Terminated, false));
        for input in [Input::Start, Input::Resume, Input::Pause] {
            let told = apply(&input, &controls(Control::Terminated).0);
            assert_eq!(told, Err("the run is terminated".into()), "{input:?}");
        }
    }
}
