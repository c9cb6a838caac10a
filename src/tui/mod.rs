//! The operator's terminal face, for ssh: the same snapshot and commands as the page.
//!
//! `App` is pure (keys in, commands out, a frame drawn from the latest snapshot); [`show`] gives it a terminal.

mod draw;

use crate::cube::{Face, Facelets};
use crate::desk::Desk;
use crate::operator::{
    Answer, Command, ControlView, Manual, Question, Snapshot, Stage, Step, Subject,
};
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use std::sync::Arc;
use std::time::Duration;

/// Time between two looks at keys and snapshots: ten pictures a second are enough for a terminal.
const LOOK: Duration = Duration::from_millis(100);

/// Shows a desk in this terminal until the operator leaves it, which is possible when the run is over.
///
/// # Errors
/// What the terminal says.
pub fn show(desk: &Desk) -> std::io::Result<()> {
    let mut terminal = ratatui::try_init()?;
    let mut app = App::default();
    let shown = loop {
        app.stage = desk.stage.borrow().clone();
        app.take(desk.snapshots.borrow().clone());
        if let Err(error) = terminal.draw(|frame| draw::frame(&app, frame)) {
            break Err(error);
        }
        match next_key() {
            Err(error) => break Err(error),
            Ok(None) => {}
            Ok(Some(key)) => {
                let command = app.key(key);
                if command == Some(Command::Quit) {
                    break Ok(());
                }
                if command.is_some_and(|command| !desk.command(command)) {
                    "the robot does not listen".clone_into(&mut app.note);
                }
            }
        }
    };
    ratatui::restore();
    shown
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

/// How an arm is moved by hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Mode {
    #[default]
    Joint,
    Tool,
    Motor,
}

/// What the face knows beside the snapshot.
#[derive(Debug, Default)]
struct App {
    stage: Arc<Stage>,
    snapshot: Arc<Snapshot>,
    /// A terminate waits for its confirmation.
    sure: bool,
    note: String,
    /// By hand: arm, mode, axis, size of a step.
    arm: usize,
    mode: Mode,
    axis: usize,
    size: usize,
    /// The stickers of the open question as corrected, and the one under the cursor.
    answer: Option<(u64, Vec<Option<Face>>, usize)>,
}

/// Steps by hand: lengths [m], angles [rad], motor angles [rad].
const STEPS: [(f64, f64, f64); 3] =
    [(0.0005, 0.003_5, 0.5), (0.002, 0.0175, 2.0), (0.01, 0.0873, 20.0)];

impl App {
    fn take(&mut self, snapshot: Arc<Snapshot>) {
        let stickers = snapshot.question.as_ref().and_then(|question| match &question.subject {
            Subject::Stickers { read, doubtful } => Some((question.number, read, doubtful)),
            Subject::Choice { .. } => None,
        });
        match (stickers, &self.answer) {
            (None, _) => self.answer = None,
            (Some((number, ..)), Some((own, ..))) if *own == number => {}
            (Some((number, read, doubtful)), _) => {
                let mut colours: Vec<_> = read.chars().map(Face::from_letter).collect();
                colours.resize(54, None);
                self.answer = Some((number, colours, doubtful.first().copied().unwrap_or(0)));
            }
        }
        self.snapshot = snapshot;
    }

    /// What a key asks for.
    fn key(&mut self, key: KeyEvent) -> Option<Command> {
        self.note.clear();
        if key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL) {
            let over = self.snapshot.control == ControlView::Ended;
            return Some(if over { Command::Quit } else { Command::Terminate });
        }
        if key.code == KeyCode::F(12) {
            return Some(Command::EmergencyStop);
        }
        if std::mem::take(&mut self.sure) {
            return matches!(key.code, KeyCode::Char('y')).then_some(Command::Terminate);
        }
        if let Some(question) = self.snapshot.question.clone() {
            return self.reply(key.code, &question);
        }
        let ended = self.snapshot.control == ControlView::Ended;
        match key.code {
            KeyCode::Char('q') if ended => Some(Command::Quit),
            _ if ended => None,
            KeyCode::Char('s') | KeyCode::Enter => Some(Command::Start),
            KeyCode::Char('p') => Some(Command::Pause),
            KeyCode::Char('r') => Some(Command::Resume),
            KeyCode::Char('t' | 'q') => {
                self.sure = true;
                None
            }
            KeyCode::Char('e') => Some(Command::EmergencyStop),
            KeyCode::Char('<') => Some(self.speed(-1)),
            KeyCode::Char('>') => Some(self.speed(1)),
            code if self.snapshot.services.manual => self.by_hand(code),
            _ => None,
        }
    }

    /// The next slower or faster limit of time's speed.
    fn speed(&self, way: isize) -> Command {
        const FACTORS: [f64; 7] = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 0.0];
        let now = self.snapshot.speed;
        let at = FACTORS.iter().position(|&f| f == now || (now > 0.0 && f >= now)).unwrap_or(6);
        let next = at.saturating_add_signed(way).min(FACTORS.len() - 1);
        Command::Speed { factor: FACTORS[next] }
    }

    fn reply(&mut self, code: KeyCode, question: &Question) -> Option<Command> {
        let number = question.number;
        let declined = Command::Answer { question: number, answer: Answer::Declined };
        if code == KeyCode::Esc {
            return Some(declined);
        }
        match &question.subject {
            Subject::Choice { options } => {
                let KeyCode::Char(digit) = code else { return None };
                let option = digit.to_digit(10)?.checked_sub(1)? as usize;
                (option < options.len()).then_some(Command::Answer {
                    question: number,
                    answer: Answer::Choice { option },
                })
            }
            Subject::Stickers { .. } => {
                let (_, colours, at) = self.answer.as_mut()?;
                match code {
                    KeyCode::Enter => {
                        let all: Option<Vec<Face>> = colours.iter().copied().collect();
                        let all: [Face; 54] = all?.try_into().ok()?;
                        let nine = |face: Face| all.iter().filter(|&&c| c == face).count() == 9;
                        if !Face::ALL.into_iter().all(nine) {
                            "there must be nine stickers of each colour".clone_into(&mut self.note);
                            return None;
                        }
                        let answer = Answer::Stickers { stickers: Facelets::from_faces(all) };
                        return Some(Command::Answer { question: number, answer });
                    }
                    KeyCode::Char(letter) => {
                        let colour = "wrgyob".find(letter.to_ascii_lowercase());
                        colours[*at] = colour.map(|c| Face::ALL[c]).or(colours[*at]);
                    }
                    other => *at = draw::neighbour(*at, other),
                }
                None
            }
        }
    }

    fn by_hand(&mut self, code: KeyCode) -> Option<Command> {
        let stage = Arc::clone(&self.stage);
        let arm = stage.arms.get(self.arm)?;
        let axes = if self.mode == Mode::Tool { 6 } else { 7 };
        let first = usize::from(self.mode != Mode::Tool && !arm.has_track);
        let order = match code {
            KeyCode::Tab => {
                self.arm = (self.arm + 1) % stage.arms.len();
                None
            }
            KeyCode::Char('m') => {
                self.mode = match self.mode {
                    Mode::Joint => Mode::Tool,
                    Mode::Tool => Mode::Motor,
                    Mode::Motor => Mode::Joint,
                };
                self.axis = 0;
                None
            }
            KeyCode::Up => {
                self.axis = self.axis.saturating_sub(1);
                None
            }
            KeyCode::Down => {
                self.axis += 1;
                None
            }
            KeyCode::Char('+') => {
                self.size = (self.size + 1).min(STEPS.len() - 1);
                None
            }
            KeyCode::Char('-') => {
                self.size = self.size.saturating_sub(1);
                None
            }
            KeyCode::Left => Some(self.jog(-1.0)),
            KeyCode::Right => Some(self.jog(1.0)),
            KeyCode::Char('y') => Some(Manual::Synchronise),
            KeyCode::Char('b') => Some(Manual::Bias),
            KeyCode::Char('o') => Some(Manual::Jaw { opening: arm.opening.1 - 0.003 }),
            KeyCode::Char('c') => Some(Manual::Jaw { opening: arm.opening.0 + 0.001 }),
            KeyCode::Char(digit) => {
                let pose =
                    digit.to_digit(10).and_then(|d| arm.poses.get((d as usize).wrapping_sub(1)));
                pose.map(|name| Manual::Pose { name: name.clone() })
            }
            _ => None,
        };
        self.axis = self.axis.clamp(first, axes - 1);
        order.map(|order| Command::Manual { effector: self.arm, order })
    }

    fn jog(&self, sign: f64) -> Manual {
        let (length, angle, motor) = STEPS[self.size];
        let axis = self.axis;
        match self.mode {
            Mode::Motor => Manual::Motor(Step { axis, by: sign * motor }),
            Mode::Joint => {
                Manual::Joint(Step { axis, by: sign * if axis == 0 { length } else { angle } })
            }
            Mode::Tool => {
                Manual::Tool(Step { axis, by: sign * if axis < 3 { length } else { angle } })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operator::{ArmStage, Services};

    fn app(snapshot: Snapshot) -> App {
        let mut app = App::default();
        let arm =
            ArmStage { opening: (0.04, 0.09), poses: vec!["front".into()], ..ArmStage::default() };
        app.stage = Arc::new(Stage { arms: vec![arm.clone(), arm], ..Stage::default() });
        app.take(Arc::new(snapshot));
        app
    }

    fn press(app: &mut App, code: KeyCode) -> Option<Command> {
        app.key(KeyEvent::from(code))
    }

    #[test]
    fn keys_are_the_commands_and_a_terminate_is_confirmed() {
        let mut app = app(Snapshot { control: ControlView::Running, ..Snapshot::default() });

        assert_eq!(press(&mut app, KeyCode::Char('p')), Some(Command::Pause));
        assert_eq!(press(&mut app, KeyCode::Char('r')), Some(Command::Resume));
        assert_eq!(press(&mut app, KeyCode::Char('e')), Some(Command::EmergencyStop));
        assert_eq!(press(&mut app, KeyCode::Char('t')), None);
        assert_eq!(press(&mut app, KeyCode::Char('n')), None);
        assert_eq!(press(&mut app, KeyCode::Char('t')), None);
        assert_eq!(press(&mut app, KeyCode::Char('y')), Some(Command::Terminate));
    }

    #[test]
    fn stickers_are_corrected_with_cursor_and_letters() {
        let read = Facelets::solved();
        let subject = Subject::Stickers { read: read.to_string(), doubtful: vec![20] };
        let question = Question {
            number: 3,
            text: String::new(),
            otherwise: String::new(),
            seconds: 60.0,
            subject,
        };
        let mut app = app(Snapshot { question: Some(question), ..Snapshot::default() });

        assert_eq!(press(&mut app, KeyCode::Char('b')), None);
        assert_eq!(press(&mut app, KeyCode::Enter), None, "ten blue ones");
        assert!(app.note.contains("nine"));
        assert_eq!(press(&mut app, KeyCode::Char('g')), None);
        let Some(Command::Answer { question: 3, answer }) = press(&mut app, KeyCode::Enter) else {
            panic!("no answer")
        };
        assert_eq!(answer, Answer::Stickers { stickers: read });
        let declined = Command::Answer { question: 3, answer: Answer::Declined };
        assert_eq!(press(&mut app, KeyCode::Esc), Some(declined));
    }

    #[test]
    fn arms_are_moved_by_hand_only_when_the_task_is_idle() {
        let services = Services { manual: true, ..Services::default() };
        let running = Snapshot { control: ControlView::Running, ..Snapshot::default() };
        let mut busy = app(running.clone());
        assert_eq!(press(&mut busy, KeyCode::Right), None);

        let mut idle = app(Snapshot { services, ..running });
        press(&mut idle, KeyCode::Tab);
        press(&mut idle, KeyCode::Down);
        press(&mut idle, KeyCode::Char('+'));
        let order = Manual::Joint(Step { axis: 2, by: 0.0175 });
        let wanted = Some(Command::Manual { effector: 1, order });
        assert_eq!(press(&mut idle, KeyCode::Right), wanted);
        let pose = Manual::Pose { name: "front".into() };
        let wanted = Some(Command::Manual { effector: 1, order: pose });
        assert_eq!(press(&mut idle, KeyCode::Char('1')), wanted);
    }
}
