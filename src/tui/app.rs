//! State of the terminal UI, and the input that each key makes. Nothing here uses a terminal.
//!
//! - in: snapshots of the run, keys
//! - out: inputs of the operator; the state that `draw` renders

use super::net;
use crate::cube::{Face, Facelets};
use crate::motion::AXES;
use crate::operator::{
    Answer, ControlView, Input, Manual, Question, Snapshot, Stage, Step, Subject,
};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use std::sync::Arc;

/// Time by which an arrow key seeks in a replay (s). The page keys seek six times as far.
const SEEK: f64 = 10.0;

/// Coordinates in which an arm is moved by hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Mode {
    /// Joints.
    #[default]
    Joint,
    /// Axes of the tool.
    Tool,
    /// Motors, which need no synchronisation.
    Motor,
}

/// State of the terminal UI.
#[derive(Debug, Default)]
pub(super) struct App {
    pub(super) stage: Arc<Stage>,
    pub(super) snapshot: Arc<Snapshot>,
    /// Whether a terminate waits for its confirmation.
    pub(super) sure: bool,
    /// Whether Ctrl-C was pressed. A second Ctrl-C leaves the UI even if the run has not ended.
    interrupted: bool,
    /// Remark to the operator, until the next key.
    pub(super) note: String,
    /// Index of the arm that is moved by hand.
    pub(super) arm: usize,
    /// Coordinates in which that arm is moved.
    pub(super) mode: Mode,
    /// Axis that is moved, in these coordinates.
    pub(super) axis: usize,
    /// Index of the step in [`STEPS`].
    pub(super) size: usize,
    /// Answer to the open question about stickers: number of the question, colours as the operator
    /// has corrected them, index of the sticker under the cursor.
    pub(super) answer: Option<(u64, Vec<Option<Face>>, usize)>,
}

/// Sizes of the steps by which arms are moved by hand: length (m), angle (rad), angle of a motor
/// (rad).
pub(super) const STEPS: [(f64, f64, f64); 3] =
    [(0.0005, 0.003_5, 0.5), (0.002, 0.0175, 2.0), (0.01, 0.0873, 20.0)];

impl App {
    /// Stores a new snapshot, and prepares the answer to a new question about stickers.
    pub(super) fn take(&mut self, snapshot: Arc<Snapshot>) {
        let stickers = snapshot.question.as_ref().and_then(|question| match &question.subject {
            Subject::Stickers { read, doubtful } => Some((question.number, read, doubtful)),
            Subject::Choice { .. } => None,
        });
        match (stickers, &self.answer) {
            (None, _) => self.answer = None,
            // A snapshot with the same question must not undo the operator's corrections.
            (Some((number, ..)), Some((own, ..))) if *own == number => {}
            (Some((number, read, doubtful)), _) => {
                let mut colours: Vec<_> = read.chars().map(Face::from_letter).collect();
                colours.resize(54, None);
                self.answer = Some((number, colours, doubtful.first().copied().unwrap_or(0)));
            }
        }
        self.snapshot = snapshot;
    }

    /// Handles a key. Returns the input to the run that it makes; `None` if it only changes the
    /// state of the UI.
    pub(super) fn key(&mut self, key: KeyEvent) -> Option<Input> {
        self.note.clear();
        let replay = self.snapshot.services.seek_ms;
        let ended = self.snapshot.control == ControlView::Ended;
        // In raw mode Ctrl-C is a key, and no signal ends the program.
        if key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL) {
            let leaves =
                ended || replay.is_some() || std::mem::replace(&mut self.interrupted, true);
            return Some(if leaves { Input::Quit } else { Input::Terminate });
        }
        if let Some(length) = replay {
            return self.replay(key.code, length as f64 * 1e-3);
        }
        // The stop comes before any question or confirmation, and its keys have no other meaning.
        if !ended && matches!(key.code, KeyCode::F(12) | KeyCode::Char('e' | 'E')) {
            self.sure = false;
            return Some(Input::EmergencyStop);
        }
        // Any key but `y` withdraws the terminate.
        if std::mem::take(&mut self.sure) {
            return matches!(key.code, KeyCode::Char('y')).then_some(Input::Terminate);
        }
        if let Some(question) = self.snapshot.question.clone() {
            return self.reply(key.code, &question);
        }
        // A run that has ended accepts no input but Quit.
        match key.code {
            KeyCode::Char('q') if ended => Some(Input::Quit),
            _ if ended => None,
            KeyCode::Char('s') | KeyCode::Enter => Some(Input::Start),
            KeyCode::Char('p') => Some(Input::Pause),
            KeyCode::Char('r') => Some(Input::Resume),
            KeyCode::Char('t' | 'q') => {
                self.sure = true;
                None
            }
            KeyCode::Char('<') => Some(self.speed(-1)),
            KeyCode::Char('>') => Some(self.speed(1)),
            code if self.snapshot.services.manual => self.by_hand(code),
            _ => None,
        }
    }

    /// Returns the input of a key in a replay that lasts `length` (s); `None` if the key has none.
    /// A replay has no arms to stop, and the operator may leave it at any time.
    fn replay(&self, code: KeyCode, length: f64) -> Option<Input> {
        let now = self.snapshot.time;
        let to = |time: f64| Some(Input::Seek { time: time.clamp(0.0, length) });
        match code {
            KeyCode::Char('q' | 't') | KeyCode::Esc => Some(Input::Quit),
            KeyCode::Char(' ') if self.snapshot.control == ControlView::Paused => {
                Some(Input::Resume)
            }
            KeyCode::Char('p' | ' ') => Some(Input::Pause),
            KeyCode::Char('r' | 's') | KeyCode::Enter => Some(Input::Resume),
            KeyCode::Char('<') => Some(self.speed(-1)),
            KeyCode::Char('>') => Some(self.speed(1)),
            KeyCode::Left => to(now - SEEK),
            KeyCode::Right => to(now + SEEK),
            KeyCode::PageUp => to(now - 6.0 * SEEK),
            KeyCode::PageDown => to(now + 6.0 * SEEK),
            KeyCode::Home => to(0.0),
            KeyCode::End => to(length),
            _ => None,
        }
    }

    /// Returns the input that sets the next lower (`change` = -1) or higher (1) limit of the
    /// simulation speed.
    fn speed(&self, change: isize) -> Input {
        // Multiples of real time. 0 means no limit, so it is the last.
        const FACTORS: [f64; 7] = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 0.0];
        let now = self.snapshot.speed;
        // Another UI may have set a limit that is not in the list.
        let at = FACTORS.iter().position(|&f| f == now || (now > 0.0 && f >= now)).unwrap_or(6);
        let next = at.saturating_add_signed(change).min(FACTORS.len() - 1);
        Input::Speed { factor: FACTORS[next] }
    }

    /// Handles a key while a question is open. Returns the answer if the key completes it.
    fn reply(&mut self, code: KeyCode, question: &Question) -> Option<Input> {
        let number = question.number;
        let declined = Input::Answer { question: number, answer: Answer::Declined };
        if code == KeyCode::Esc {
            return Some(declined);
        }
        match &question.subject {
            Subject::Choice { options } => {
                let KeyCode::Char(digit) = code else { return None };
                let option = digit.to_digit(10)?.checked_sub(1)? as usize;
                (option < options.len()).then_some(Input::Answer {
                    question: number,
                    answer: Answer::Choice { option },
                })
            }
            Subject::Stickers { .. } => {
                let (_, colours, at) = self.answer.as_mut()?;
                match code {
                    // Enter sends the stickers only if each colour has nine. The task makes further
                    // checks.
                    KeyCode::Enter => {
                        let all: Option<Vec<Face>> = colours.iter().copied().collect();
                        let all: [Face; 54] = all?.try_into().ok()?;
                        let nine = |face: Face| all.iter().filter(|&&c| c == face).count() == 9;
                        if !Face::ALL.into_iter().all(nine) {
                            "there must be nine stickers of each colour".clone_into(&mut self.note);
                            return None;
                        }
                        let answer = Answer::Stickers { stickers: Facelets::from_faces(all) };
                        return Some(Input::Answer { question: number, answer });
                    }
                    // A letter of a colour paints the sticker; any other letter changes nothing.
                    KeyCode::Char(letter) => {
                        let colour = "wrgyob".find(letter.to_ascii_lowercase());
                        colours[*at] = colour.map(|c| Face::ALL[c]).or(colours[*at]);
                    }
                    other => *at = net::neighbour(*at, other),
                }
                None
            }
        }
    }

    /// Handles a key while arms can be moved by hand. Returns the order that it gives to the chosen
    /// arm; `None` if the key chooses the arm, the mode, the axis or the step instead.
    fn by_hand(&mut self, code: KeyCode) -> Option<Input> {
        let stage = Arc::clone(&self.stage);
        match code {
            KeyCode::Tab => self.arm = (self.arm + 1) % stage.arms.len().max(1),
            KeyCode::Char('m') => {
                self.mode = match self.mode {
                    Mode::Joint => Mode::Tool,
                    Mode::Tool => Mode::Motor,
                    Mode::Motor => Mode::Joint,
                };
                self.axis = 0;
            }
            KeyCode::Up => self.axis = self.axis.saturating_sub(1),
            KeyCode::Down => self.axis += 1,
            KeyCode::Char('+') => self.size = (self.size + 1).min(STEPS.len() - 1),
            KeyCode::Char('-') => self.size = self.size.saturating_sub(1),
            _ => {}
        }
        // The axis is limited after each key, since the arm or the mode may have changed.
        let arm = stage.arms.get(self.arm)?;
        let axes = self.axes();
        self.axis = self.axis.clamp(axes.start, axes.end - 1);
        let order = match code {
            KeyCode::Left => self.jog(-1.0),
            KeyCode::Right => self.jog(1.0),
            KeyCode::Char('y') => Manual::Synchronise,
            KeyCode::Char('b') => Manual::Bias,
            // The jaws stay short of both ends of their range.
            KeyCode::Char('o') => Manual::Jaw { opening: arm.opening.1 - 0.003 },
            KeyCode::Char('c') => Manual::Jaw { opening: arm.opening.0 + 0.001 },
            KeyCode::Char(digit) => {
                let index = (digit.to_digit(10)? as usize).checked_sub(1)?;
                Manual::Pose { name: arm.poses.get(index)?.clone() }
            }
            _ => return None,
        };
        Some(Input::Manual { effector: self.arm, order })
    }

    /// Returns the axes of the chosen arm that can be chosen in the present mode. Joint and motor 0
    /// are those of the track, so an arm without a track does not have them.
    pub(super) fn axes(&self) -> std::ops::Range<usize> {
        let has_track = self.stage.arms.get(self.arm).is_some_and(|arm| arm.has_track);
        match self.mode {
            Mode::Tool => 0..6,
            Mode::Joint | Mode::Motor => usize::from(!has_track)..AXES,
        }
    }

    /// Returns the order to move the chosen axis by one step of the chosen size. `sign` is 1 or -1.
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

    /// Returns a UI with two arms, of which only the second has a track.
    fn app(snapshot: Snapshot) -> App {
        let mut app = App::default();
        let arm =
            ArmStage { opening: (0.04, 0.09), poses: vec!["front".into()], ..ArmStage::default() };
        let track = ArmStage { has_track: true, ..arm.clone() };
        app.stage = Arc::new(Stage { arms: vec![arm, track], ..Stage::default() });
        app.take(Arc::new(snapshot));
        app
    }

    /// Returns a question about the stickers of a solved cube, in which sticker 20 is doubtful.
    fn stickers() -> Question {
        Question {
            number: 3,
            text: String::new(),
            otherwise: String::new(),
            seconds: 60.0,
            until: 60.0,
            subject: Subject::Stickers { read: Facelets::solved().to_string(), doubtful: vec![20] },
        }
    }

    /// Presses a key; returns the input that it makes.
    fn press(app: &mut App, code: KeyCode) -> Option<Input> {
        app.key(KeyEvent::from(code))
    }

    #[test]
    fn keys_become_inputs_and_terminate_needs_confirmation() {
        let mut app = app(Snapshot { control: ControlView::Running, ..Snapshot::default() });

        assert_eq!(press(&mut app, KeyCode::Char('p')), Some(Input::Pause));
        assert_eq!(press(&mut app, KeyCode::Char('r')), Some(Input::Resume));
        assert_eq!(press(&mut app, KeyCode::Char('e')), Some(Input::EmergencyStop));
        assert_eq!(press(&mut app, KeyCode::Char('t')), None);
        assert_eq!(press(&mut app, KeyCode::Char('n')), None);
        assert_eq!(press(&mut app, KeyCode::Char('t')), None);
        assert_eq!(press(&mut app, KeyCode::Char('y')), Some(Input::Terminate));
    }

    #[test]
    fn emergency_stop_key_works_during_question_or_confirmation() {
        for key in [KeyCode::Char('e'), KeyCode::F(12)] {
            let mut asked = app(Snapshot { question: Some(stickers()), ..Snapshot::default() });
            assert_eq!(press(&mut asked, key), Some(Input::EmergencyStop));

            let mut sure = app(Snapshot { control: ControlView::Running, ..Snapshot::default() });
            assert_eq!(press(&mut sure, KeyCode::Char('t')), None);
            assert_eq!(press(&mut sure, key), Some(Input::EmergencyStop));
            assert_eq!(press(&mut sure, KeyCode::Char('y')), None, "no confirmation is open");
        }
    }

    #[test]
    fn first_ctrl_c_terminates_and_second_leaves() {
        let interrupt = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        let mut app = app(Snapshot { control: ControlView::Running, ..Snapshot::default() });

        assert_eq!(app.key(interrupt), Some(Input::Terminate));
        assert_eq!(app.key(interrupt), Some(Input::Quit));
    }

    /// Keys seek in a replay that runs or has ended, and leave it at any time.
    #[test]
    fn keys_seek_and_leave_replay() {
        let services = Services { seek_ms: Some(200_000), ..Services::default() };
        let at = |time, control| Snapshot { time, control, services, ..Snapshot::default() };
        let seek = |time| Some(Input::Seek { time });

        let mut running = app(at(42.0, ControlView::Running));
        assert_eq!(press(&mut running, KeyCode::Left), seek(32.0));
        assert_eq!(press(&mut running, KeyCode::Right), seek(52.0));
        assert_eq!(press(&mut running, KeyCode::PageUp), seek(0.0), "the beginning");
        assert_eq!(press(&mut running, KeyCode::PageDown), seek(102.0));
        assert_eq!(press(&mut running, KeyCode::End), seek(200.0));
        assert_eq!(press(&mut app(at(72.0, ControlView::Running)), KeyCode::PageUp), seek(12.0));
        assert_eq!(press(&mut running, KeyCode::Char('e')), None, "a replay has no emergency stop");
        assert_eq!(press(&mut running, KeyCode::Char('q')), Some(Input::Quit));
        let interrupt = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(running.key(interrupt), Some(Input::Quit));

        let mut ended = app(at(200.0, ControlView::Ended));
        assert_eq!(press(&mut ended, KeyCode::Right), seek(200.0));
        assert_eq!(press(&mut ended, KeyCode::Left), seek(190.0));
        assert_eq!(press(&mut ended, KeyCode::Home), seek(0.0));
    }

    /// The cursor begins at the doubtful sticker F3, from which four steps to the right lead to B1.
    #[test]
    fn keys_edit_answer_and_decline_sticker_question() {
        let mut colours = *Facelets::solved().colours();
        (colours[20], colours[45]) = (5, 2);
        let corrected = Facelets::from_faces(colours.map(|c| Face::ALL[usize::from(c)]));
        let mut app = app(Snapshot { question: Some(stickers()), ..Snapshot::default() });

        assert_eq!(press(&mut app, KeyCode::Char('b')), None);
        assert_eq!(press(&mut app, KeyCode::Enter), None, "ten blue ones");
        assert!(app.note.contains("nine"));
        for key in [KeyCode::Right; 4].into_iter().chain([KeyCode::Char('x'), KeyCode::Char('G')]) {
            assert_eq!(press(&mut app, key), None);
        }
        let Some(Input::Answer { question: 3, answer }) = press(&mut app, KeyCode::Enter) else {
            panic!("no answer")
        };
        assert_eq!(answer, Answer::Stickers { stickers: corrected });
        let declined = Input::Answer { question: 3, answer: Answer::Declined };
        assert_eq!(press(&mut app, KeyCode::Esc), Some(declined));
    }

    #[test]
    fn keys_move_arms_only_while_task_is_idle() {
        let services = Services { manual: true, ..Services::default() };
        let running = Snapshot { control: ControlView::Running, ..Snapshot::default() };
        let ended = Snapshot { control: ControlView::Ended, services, ..Snapshot::default() };
        let question = Some(stickers());
        let asked = Snapshot { question, services, ..running.clone() };
        let orders = [
            (KeyCode::Char('y'), Manual::Synchronise),
            (KeyCode::Char('b'), Manual::Bias),
            // The jaws stay 3 mm and 1 mm short of the ends of their range.
            (KeyCode::Char('o'), Manual::Jaw { opening: 0.09 - 0.003 }),
            (KeyCode::Char('c'), Manual::Jaw { opening: 0.04 + 0.001 }),
            (KeyCode::Char('1'), Manual::Pose { name: "front".into() }),
            (KeyCode::Right, Manual::Joint(Step { axis: 1, by: 0.003_5 })),
            (KeyCode::Left, Manual::Joint(Step { axis: 1, by: -0.003_5 })),
        ];
        for (key, order) in orders {
            let mut idle = app(Snapshot { services, ..running.clone() });
            assert_eq!(press(&mut idle, key), Some(Input::Manual { effector: 0, order }));
            assert_eq!(press(&mut idle, KeyCode::Char('2')), None, "there is no second pose");
            for other in [&running, &ended, &asked] {
                assert_eq!(press(&mut app(other.clone()), key), None, "{key:?}");
            }
        }
    }

    #[test]
    fn keys_choose_arm_coordinates_axis_and_step() {
        let services = Services { manual: true, ..Services::default() };
        let control = ControlView::Running;
        let mut app = app(Snapshot { control, services, ..Snapshot::default() });
        let mut moves = |keys: &[KeyCode]| {
            for key in keys {
                assert_eq!(press(&mut app, *key), None, "{key:?}");
            }
            press(&mut app, KeyCode::Right)
        };
        let second = |order| Some(Input::Manual { effector: 1, order });
        let (mode, more, less) = (KeyCode::Char('m'), KeyCode::Char('+'), KeyCode::Char('-'));

        let track = Manual::Joint(Step { axis: 0, by: 0.002 });
        assert_eq!(moves(&[KeyCode::Tab, KeyCode::Up, more]), second(track));
        // The middle step of a joint is 1 deg.
        let joint = Manual::Joint(Step { axis: 2, by: 0.0175 });
        assert_eq!(moves(&[KeyCode::Down, KeyCode::Down]), second(joint));
        // Another mode begins at its first axis. There are three sizes of steps.
        let along = Manual::Tool(Step { axis: 0, by: 0.01 });
        assert_eq!(moves(&[mode, more, more]), second(along));
        let about = Manual::Tool(Step { axis: 5, by: 0.0873 });
        assert_eq!(moves(&[KeyCode::Down; 9]), second(about));
        let motor = Manual::Motor(Step { axis: 0, by: 2.0 });
        assert_eq!(moves(&[mode, less]), second(motor));
        let last = Manual::Motor(Step { axis: 6, by: 0.5 });
        assert_eq!(moves(&[[KeyCode::Down; 9].as_slice(), &[less, less]].concat()), second(last));
    }

    #[test]
    fn keys_move_only_axes_the_arm_has() {
        let services = Services { manual: true, ..Services::default() };
        let control = ControlView::Running;
        let mut app = app(Snapshot { control, services, ..Snapshot::default() });
        let axis = |command| match command {
            Some(Input::Manual { order: Manual::Joint(s) | Manual::Motor(s), effector }) => {
                (effector, s.axis)
            }
            other => panic!("{other:?}"),
        };

        // The first arm has no track, so axis 0 is never chosen for it: not at first, not after a
        // change of mode, and not after axis 0 of the other arm was chosen.
        assert_eq!(axis(press(&mut app, KeyCode::Right)), (0, 1));
        press(&mut app, KeyCode::Char('m'));
        press(&mut app, KeyCode::Char('m'));
        assert_eq!(axis(press(&mut app, KeyCode::Right)), (0, 1));
        press(&mut app, KeyCode::Tab);
        press(&mut app, KeyCode::Up);
        assert_eq!(axis(press(&mut app, KeyCode::Right)), (1, 0), "the second arm has a track");
        press(&mut app, KeyCode::Tab);
        assert_eq!(axis(press(&mut app, KeyCode::Left)), (0, 1));
    }
}
