//! Screen of the terminal UI: draws a snapshot of the run and the state of the UI itself.
//!
//! Everything that an operator needs must be visible in 80 columns and 24 rows. Therefore the
//! layout drops borders, digits and messages below [`NARROW`] columns or [`LOW`] rows.

use super::app::{App, Mode, STEPS};
use super::net::place;
use crate::cube::Face;
use crate::hw::text::shortened;
use crate::operator::{Class, ControlView, Snapshot, State, Subject};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style, Stylize};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Borders, Cell, Clear, Gauge, Paragraph, Row, Table, Wrap};
use unicode_width::UnicodeWidthStr as _;

/// Colours of the stickers, 0..=5 = white, red, green, yellow, orange, blue.
const COLOURS: [Color; 6] = [
    Color::Rgb(244, 244, 240),
    Color::Rgb(200, 32, 44),
    Color::Rgb(31, 138, 70),
    Color::Rgb(242, 195, 24),
    Color::Rgb(238, 122, 28),
    Color::Rgb(31, 87, 184),
];
/// Names of the axes of an arm.
const AXES: [&str; 7] = ["track", "joint 1", "joint 2", "joint 3", "joint 4", "joint 5", "joint 6"];
/// Names of the axes of a tool.
const TOOL: [&str; 6] = ["x", "y", "z", "about x", "about y", "about z"];

/// Number of columns below which the terminal is narrow: no borders, fewer digits.
const NARROW: u16 = 120;
/// Number of rows below which the terminal is low: fewer messages.
const LOW: u16 = 30;

/// Draws the whole UI.
pub(super) fn frame(app: &App, frame: &mut Frame<'_>) {
    let s = &*app.snapshot;
    let area = frame.area();
    let narrow = area.width < NARROW;
    let keys = keys_of(app, usize::from(area.width));
    // From top to bottom: heading, progress, arms, middle, messages, keys.
    let rows = [
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Length(s.arms.len() as u16 + if narrow { 1 } else { 3 }),
        Constraint::Min(8),
        Constraint::Length(if area.height < LOW { 3 } else { 8 }),
        Constraint::Length(keys.len() as u16),
    ];
    let [head, bar, arms, middle, messages, foot] = Layout::vertical(rows).areas(area);
    frame.render_widget(heading(app), head);
    let (done, label) = progress(s);
    frame.render_widget(
        Gauge::default().ratio(done.clamp(0.0, 1.0)).label(label).gauge_style(Color::Blue),
        bar,
    );
    frame.render_widget(arm_table(app, narrow), arms);
    // In a narrow terminal the words of the actors get the room of the plan until there is one.
    let stops = s.outcome.is_some() || s.arms.iter().any(|arm| arm.fault.is_some());
    let instructs = stops || s.services.manual;
    let planless = narrow && s.plan.is_empty() && !instructs;
    let plan = if planless { Constraint::Length(11) } else { Constraint::Fill(1) };
    let actors = Constraint::Min(match (narrow, instructs) {
        (false, _) => 48,
        (true, true) => 26,
        (true, false) => 35,
    });
    let columns = [Constraint::Length(25), plan, actors];
    let [net, plan, actors] = Layout::horizontal(columns).areas(middle);
    let colours: Vec<Option<usize>> = (0..54)
        .map(|i| Some(usize::from(s.net.facelets.get(i).copied().flatten()?.colour)))
        .collect();
    frame.render_widget(net_of(&colours, None).block(titled("cube as read")), net);
    // A fault or the end of the run matters more than the plan. An idle task has no plan.
    if stops {
        frame.render_widget(stopped(s), plan);
    } else if s.services.manual {
        frame.render_widget(by_hand(app), plan);
    } else {
        frame.render_widget(plan_of(s, plan), plan);
    }
    frame.render_widget(actors_of(s, narrow, usize::from(actors.width)), actors);
    frame.render_widget(messages_of(s, messages), messages);
    frame.render_widget(Paragraph::new(keys), foot);
    // The question is drawn last, so that it covers everything else.
    if app.snapshot.question.is_some() {
        question(app, frame);
    }
}

/// Returns a block with a title and a line above it, without lines at its sides.
fn titled(title: &str) -> Block<'_> {
    Block::new().borders(Borders::TOP).title(title)
}

/// Returns the progress of a run, 0..=1, and its label: by time in a replay, otherwise by steps of
/// the plan.
fn progress(s: &Snapshot) -> (f64, String) {
    if let Some(length) = s.services.seek_ms {
        let length = length as f64 * 1e-3;
        return (s.time / length.max(1e-3), format!("{:.1} of {length:.1} s", s.time));
    }
    let all = s.plan.len();
    let done = s.step.map_or(0.0, |step| (step + 1) as f64 / all.max(1) as f64);
    let label = match s.step {
        Some(step) => format!("step {} of {all}", (step + 1).min(all)),
        None => "no plan yet".to_owned(),
    };
    (done, label)
}

/// Returns the top line of the screen: state, reason or phase, time, speed, holder of the cube,
/// title.
fn heading(app: &App) -> Line<'_> {
    let s = &*app.snapshot;
    let fault = s.arms.iter().any(|arm| arm.fault.is_some());
    // The outcome comes first: after a fault has ended a run, the verdict says more than "fault".
    let (word, colour) = match (s.control, &s.outcome) {
        (_, Some(outcome)) if outcome.good => (outcome.verdict.as_str(), Color::Green),
        (_, Some(outcome)) => (outcome.verdict.as_str(), Color::Red),
        _ if fault => ("fault", Color::Red),
        (ControlView::Waiting, _) => ("waits for start", Color::Yellow),
        (ControlView::Running, _) => ("running", Color::Blue),
        (ControlView::Paused, _) => ("paused", Color::Yellow),
        (ControlView::Terminated | ControlView::Ended, _) => ("ending", Color::Yellow),
    };
    let why = s.outcome.as_ref().map_or(s.phase.as_str(), |outcome| outcome.reason.as_str());
    // The arms hold their places after the end, so the clock runs on. The heading shows the time at
    // which the work was done.
    let time = s.outcome.as_ref().and_then(|outcome| outcome.time).unwrap_or(s.time);
    Line::from(vec![
        Span::styled(format!(" {word} "), Style::new().bg(colour).fg(Color::White).bold()),
        Span::raw(format!(" {why}   ")),
        Span::styled(format!("{time:.1} s"), Modifier::BOLD),
        Span::raw(format!("  {:.1} x   cube: {}   ", s.factor, s.cube.with)),
        Span::raw(app.stage.title.clone()).dim(),
    ])
}

/// Returns the table of the arms: joints, jaws, forces and following error of the tool.
fn arm_table(app: &App, narrow: bool) -> Table<'_> {
    let rows = app.snapshot.arms.iter().enumerate().map(|(i, arm)| {
        let has_track = app.stage.arms.get(i).is_none_or(|stage| stage.has_track);
        let track = if has_track { format!("{:.3} m", arm.joints[0]) } else { "-".to_owned() };
        // At 80 columns there is room for whole degrees only.
        let digits = usize::from(!narrow);
        let joints: Vec<String> =
            arm.joints[1..].iter().map(|q| format!("{:.digits$}", q.to_degrees())).collect();
        let force = |d: &[f64]| d.iter().map(|c| c * c).sum::<f64>().sqrt();
        let row = Row::new(vec![
            Cell::from(arm.name.clone()).bold(),
            Cell::from(track),
            Cell::from(joints.join(" ")),
            Cell::from(format!("{:.1} mm", arm.opening * 1e3)),
            Cell::from(format!("{:.1} N", force(&arm.wrench[..3]))),
            Cell::from(format!("{:.2} Nm", force(&arm.wrench[3..]))),
            Cell::from(format!("{:.2} mm", arm.following * 1e3)),
        ]);
        if arm.fault.is_some() { row.red() } else { row }
    });
    let names = ["arm", "track", "joints [deg]", "jaws", "force", "torque", "follows"];
    let widths = if narrow { [10, 8, 29, 7, 6, 7, 7] } else { [12, 9, 44, 9, 9, 9, 9] };
    let table = Table::new(rows, widths).header(Row::new(names).dim());
    if narrow { table } else { table.block(Block::bordered()) }
}

/// Returns the net of the cube. For each facelet `colours` has the index of its colour, 0..=5, or
/// `None` if it was not read; `at` is the index of the facelet under the cursor.
fn net_of(colours: &[Option<usize>], at: Option<usize>) -> Paragraph<'static> {
    // Two letters make a tile nearly square.
    let mut grid = vec![vec![Span::raw("  "); 12]; 9];
    for (index, colour) in colours.iter().enumerate() {
        let (column, row) = place(index);
        let background = colour.map_or(Color::DarkGray, |c| COLOURS[c.min(5)]);
        let mark = match (at == Some(index), colour) {
            (true, _) => "[]",
            (false, None) => "??",
            (false, Some(_)) => "  ",
        };
        grid[row][column] = Span::styled(mark, Style::new().bg(background).fg(Color::Black).bold());
    }
    Paragraph::new(grid.into_iter().map(Line::from).collect::<Vec<_>>())
}

/// Returns the plan in the panel `area`, scrolled to its current step. The words of the current
/// step take as many rows as they need; those of the others end with an ellipsis.
fn plan_of(s: &Snapshot, area: Rect) -> Paragraph<'_> {
    let shown = usize::from(area.height.saturating_sub(1)).max(1);
    // One column separates the plan from the next panel.
    let width = usize::from(area.width.saturating_sub(1));
    // The current step is a third from the top: the next steps need more room than the past ones.
    let first = s.step.map_or(0, |step| step.saturating_sub(shown / 3));
    let lines = s.plan.iter().enumerate().skip(first).take(shown).flat_map(|(i, line)| {
        let text = format!("{:3}  {}", i + 1, line.what);
        let short = || shortened(&text, width).into_owned();
        match s.step {
            Some(step) if i == step => {
                let style = Style::new().bg(Color::Blue).white();
                wrapped(&text, width).into_iter().map(|row| Line::styled(row, style)).collect()
            }
            Some(step) if i < step => vec![Line::from(short()).dim()],
            _ => vec![Line::from(short())],
        }
    });
    Paragraph::new(lines.collect::<Vec<_>>()).block(titled("plan"))
}

/// Breaks the text of a step between words into rows of at most `width` columns. The rows after the
/// first one are indented like its words.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    const INDENT: &str = "     ";
    let words = text.get(INDENT.len()..).unwrap_or_default();
    let mut rows = vec![text.get(..INDENT.len()).unwrap_or(text).to_owned()];
    for (number, word) in words.split_whitespace().enumerate() {
        let Some(row) = rows.last_mut() else { break };
        let blank = usize::from(number > 0 && *row != INDENT);
        if number > 0 && row.width() + blank + word.width() > width {
            rows.push(format!("{INDENT}{word}"));
        } else {
            row.push_str(&" "[..blank]);
            row.push_str(word);
        }
    }
    // A word that is wider than the panel has no end.
    rows.iter().map(|row| shortened(row, width).into_owned()).collect()
}

/// Returns the end of the run, the arms that have stopped with their faults and remedies, and the
/// figures of the run.
fn stopped(s: &Snapshot) -> Paragraph<'_> {
    let mut lines = Vec::new();
    if let Some(outcome) = &s.outcome {
        lines.push(Line::from(format!("{}: {}", outcome.verdict, outcome.reason)).bold());
    }
    for (arm, fault) in s.arms.iter().filter_map(|arm| Some((arm, arm.fault.as_ref()?))) {
        lines.push(Line::from(format!("{} stopped: {fault}.", arm.name)).red().bold());
        lines.extend(arm.remedy.as_deref().map(Line::from));
    }
    for (name, value) in s.outcome.iter().flat_map(|outcome| &outcome.figures) {
        if !value.is_empty() {
            lines.push(Line::from(format!("{name}: {value}")).dim());
        }
    }
    let title = if s.outcome.is_some() { "the end" } else { "fault" };
    Paragraph::new(lines).wrap(Wrap { trim: true }).block(titled(title))
}

/// Returns the panel for motions by hand: arm, axes, poses.
fn by_hand(app: &App) -> Paragraph<'_> {
    let name = app.stage.arms.get(app.arm).map_or("", |arm| arm.name.as_str());
    let (length, angle, motor) = STEPS[app.size];
    let (mode, axes, step): (&str, &[&str], String) = match app.mode {
        Mode::Joint => {
            ("joints", &AXES, format!("{} mm, {:.1} deg", length * 1e3, angle.to_degrees()))
        }
        Mode::Tool => {
            ("tool axes", &TOOL, format!("{} mm, {:.1} deg", length * 1e3, angle.to_degrees()))
        }
        Mode::Motor => ("motors", &AXES, format!("{motor} rad")),
    };
    let mut lines = vec![Line::from(format!("{name}: {mode}, step {step}")).bold()];
    lines.extend(app.axes().map(|i| {
        let text = format!(" {}", axes[i]);
        if i == app.axis { Line::from(text).reversed() } else { Line::from(text) }
    }));
    let poses = app.stage.arms.get(app.arm).map(|arm| arm.poses.as_slice()).unwrap_or_default();
    let poses: Vec<String> =
        poses.iter().enumerate().map(|(i, name)| format!("{} {name}", i + 1)).collect();
    lines.push(Line::from(format!("go to: {}", poses.join(", "))));
    Paragraph::new(lines).wrap(Wrap { trim: false }).block(titled("by hand"))
}

/// Returns the actors with their states.
fn actors_of(s: &Snapshot, narrow: bool, width: usize) -> Paragraph<'_> {
    // The name of an actor and a blank take 15 columns, the name of a state 11.
    let fit = |words: &str, used: usize| shortened(words, width.saturating_sub(used)).into_owned();
    let line = |actor: &crate::operator::ActorView| {
        let (word, colour) = match actor.state {
            State::Absent => ("not there", Color::DarkGray),
            State::NotSynchronised => ("not sync.", Color::Yellow),
            State::Idle => ("idle", Color::Gray),
            State::Running => ("running", Color::Blue),
            State::Held => ("held", Color::Green),
            State::Fault => ("fault", Color::Red),
        };
        if !narrow {
            return Line::from(vec![
                Span::raw(format!("{:<14} ", actor.name)),
                Span::styled(format!("{word:<11}"), colour),
                Span::raw(fit(&actor.words, 26)).dim(),
            ]);
        }
        // If there is room for one of them only, the actor's words replace the name of its state;
        // the colour still shows the state.
        let words = if actor.words.is_empty() { word } else { actor.words.as_str() };
        Line::from(vec![
            Span::raw(format!("{:<14} ", actor.name)),
            Span::styled(fit(words, 15), colour),
        ])
    };
    Paragraph::new(s.actors.iter().map(line).collect::<Vec<_>>()).block(titled("actors"))
}

/// Returns the latest messages that fit into the panel `area`.
fn messages_of(s: &Snapshot, area: Rect) -> Paragraph<'_> {
    let shown = usize::from(area.height.saturating_sub(1));
    let first = s.messages.len().saturating_sub(shown);
    let line = |m: &crate::operator::Message| {
        let style = match m.class {
            Class::Info => Style::new(),
            Class::Warning => Style::new().yellow(),
            Class::NonFatal | Class::Fatal | Class::System => Style::new().red(),
        };
        let text = format!("{:8.2} s  {:<14} {}", m.time, m.source, m.text);
        Line::styled(shortened(&text, usize::from(area.width)).into_owned(), style)
    };
    Paragraph::new(s.messages[first..].iter().map(line).collect::<Vec<_>>())
        .block(titled("messages"))
}

/// Returns the help for the keys that work now, broken into lines of at most `width` columns.
fn keys_of(app: &App, width: usize) -> Vec<Line<'_>> {
    const STOP: (&str, &str) = ("e F12", "emergency stop (no safety function)");
    let s = &*app.snapshot;
    // A remark replaces the help until the next key.
    if !app.note.is_empty() {
        return vec![Line::from(app.note.as_str()).yellow()];
    }
    if app.sure {
        let asked = "terminate: all arms come to rest and hold what they hold?";
        let mut lines = vec![Line::from(asked).yellow()];
        lines.extend(help(&[("y", "terminate"), ("n", "continue"), STOP], width));
        return lines;
    }
    if s.services.seek_ms.is_some() {
        let keys = [
            ("p", "pause"),
            ("r", "continue"),
            ("< >", "speed"),
            ("Left Right", "10 s"),
            ("PgUp PgDn", "1 min"),
            ("Home", "to the beginning"),
            ("q", "leave"),
        ];
        return help(&keys, width);
    }
    let by_hand = [
        ("arrows", "move"),
        ("m", "mode"),
        ("+ -", "step"),
        ("Tab", "arm"),
        ("1-9", "go to"),
        ("y", "synchronise"),
        ("o c", "jaws"),
        ("b", "zero the sensor"),
    ];
    let run = [("p", "pause"), ("r", "resume"), ("t", "terminate"), ("< >", "speed"), STOP];
    // An open question takes all keys but the stop and Ctrl-C.
    match s.control {
        ControlView::Ended => help(&[("q", "leave")], width),
        _ if s.question.is_some() => help(&[STOP, ("Ctrl-C", "terminate")], width),
        ControlView::Waiting => help(&[("s", "start"), ("t", "terminate"), STOP], width),
        _ if s.services.manual => help(&[by_hand.as_slice(), &run].concat(), width),
        _ => help(&run, width),
    }
}

/// Returns lines with keys and their meanings, as many in each line as fit into `width` columns.
fn help(keys: &[(&'static str, &'static str)], width: usize) -> Vec<Line<'static>> {
    let mut lines = vec![Line::default()];
    for (key, words) in keys {
        let long = key.len() + words.len() + 1;
        if lines.last().is_some_and(|line| line.width() > 0 && line.width() + 2 + long > width) {
            lines.push(Line::default());
        }
        let Some(line) = lines.last_mut() else { break };
        if line.width() > 0 {
            line.push_span("  ");
        }
        line.push_span(Span::from(*key).bold());
        line.push_span(Span::from(format!(" {words}")).dim());
    }
    lines
}

/// Draws the open question in a box over the rest of the screen; does nothing if there is none.
fn question(app: &App, frame: &mut Frame<'_>) {
    let Some(question) = &app.snapshot.question else { return };
    let area = frame.area();
    // The last line stays visible, because it shows the key of the emergency stop.
    let (width, height) = (area.width.min(70), area.height.saturating_sub(1).min(19));
    let at = Rect {
        x: area.x + (area.width - width) / 2,
        y: area.y + (area.height - 1).saturating_sub(height) / 2,
        width,
        height,
    };
    frame.render_widget(Clear, at);
    let block = Block::bordered().title("the robot asks").yellow();
    let inner = block.inner(at);
    frame.render_widget(block, at);
    let rows = [Constraint::Length(4), Constraint::Min(9), Constraint::Length(3)];
    let [text, body, foot] = Layout::vertical(rows).areas(inner);
    frame.render_widget(Paragraph::new(question.text.as_str()).wrap(Wrap { trim: true }), text);
    let keys = match (&question.subject, &app.answer) {
        (Subject::Choice { options }, _) => {
            let lines =
                options.iter().enumerate().map(|(i, o)| Line::from(format!("{} {o}", i + 1)));
            frame.render_widget(Paragraph::new(lines.collect::<Vec<_>>()), body);
            "a digit answers"
        }
        (Subject::Stickers { .. }, Some((_, colours, cursor))) => {
            let colours: Vec<_> = colours.iter().map(|c| c.map(Face::index)).collect();
            frame.render_widget(net_of(&colours, Some(*cursor)), body);
            "arrows, W R G Y O B paint, Enter sends, Esc declines"
        }
        (Subject::Stickers { .. }, None) => "",
    };
    let note = if app.note.is_empty() { keys } else { app.note.as_str() };
    let left = (question.until - app.snapshot.time).max(0.0);
    let foot_text = format!("{note}\n{left:.0} s left; {}", question.otherwise);
    frame.render_widget(Paragraph::new(foot_text).wrap(Wrap { trim: true }), foot);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operator::{
        ActorView, ArmStage, ArmView, Message, OutcomeView, PlanLine, Question, Reading, Stage,
    };
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use std::sync::Arc;

    /// Returns the text of a screen of this size (columns, rows) that shows a snapshot.
    fn drawn(snapshot: Snapshot, (width, height): (u16, u16)) -> String {
        let mut app = App::default();
        app.take(Arc::new(snapshot));
        shown(&app, (width, height))
    }

    /// Returns the text of a screen of this size (columns, rows).
    fn shown(app: &App, (width, height): (u16, u16)) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|f| frame(app, f)).unwrap();
        let buffer = terminal.backend().buffer();
        let rows = buffer.content().chunks(usize::from(width));
        rows.map(|row| row.iter().map(ratatui::buffer::Cell::symbol).collect::<String>() + "\n")
            .collect()
    }

    /// Returns a snapshot of a run with one arm in step 31 of its plan.
    fn snapshot() -> Snapshot {
        let line =
            |n: usize| PlanLine { what: format!("turn {n}"), why: String::new(), seconds: 1.0 };
        let arm = ArmView {
            name: "track".into(),
            joints: [0.5, 0.0, -1.57, 0.0, 1.5, 1.5, 0.0],
            motors: [0.0; 7],
            frames: vec![],
            opening: 0.057,
            grip: 30.0,
            wrench: [3.0, 4.0, 0.0, 0.0, 0.0, 1.0],
            peak: (9.0, 2.0),
            following: 0.0004,
            synchronised: true,
            fault: None,
            remedy: None,
        };
        let message = Message {
            number: 1,
            time: 12.5,
            class: Class::NonFatal,
            source: "edp track".into(),
            text: "pose out of reach".into(),
        };
        Snapshot {
            time: 12.5,
            control: ControlView::Running,
            phase: "solve".into(),
            arms: vec![arm],
            plan: Arc::new((1..40).map(line).collect()),
            step: Some(30),
            actors: vec![ActorView { name: "mp".into(), state: State::Running, words: "x".into() }],
            messages: Arc::new(vec![message]),
            ..Snapshot::default()
        }
    }

    #[test]
    fn running_screen_shows_forces_messages_and_plan_step() {
        let text = drawn(snapshot(), (120, 36));

        let heading = text.lines().next().unwrap();
        assert!(heading.starts_with(" running  solve   12.5 s "), "{heading}");
        for words in
            ["turn 31", "step 31 of 39", "5.0 N", "1.00 Nm", "57.0 mm", "pose out of reach"]
        {
            assert!(text.contains(words), "no `{words}` in\n{text}");
        }
        assert!(!text.contains("turn 1 "), "the plan is scrolled to its step");
    }

    #[test]
    fn small_terminal_is_drawn_without_panic() {
        for size in [(40, 12), (10, 3), (1, 1)] {
            drawn(snapshot(), size);
        }
    }

    /// Returns a terminal UI that shows two arms and all actors of a cell.
    fn whole() -> App {
        let mut s = snapshot();
        let names = ["ui", "mp", "ecp track", "ecp postument", "edp track", "edp postument"];
        let vsps = ["vsp mpc", "vsp mpf", "vsp gs1", "vsp gs2"];
        let actor = |name: &str| ActorView {
            name: name.to_owned(),
            state: State::NotSynchronised,
            words: if name.starts_with("edp") { "synchronised, moves" } else { "" }.into(),
        };
        s.actors = names.iter().chain(&vsps).map(|name| actor(name)).collect();
        let second = ArmView { name: "postument".into(), joints: [-3.0; 7], ..s.arms[0].clone() };
        s.arms.push(second);
        s.net.facelets = vec![None; 54];
        let mut app = App::default();
        let poses = ["start", "front", "synchronisation"].map(String::from).to_vec();
        let arm = ArmStage { name: "track".into(), has_track: true, poses, ..ArmStage::default() };
        app.stage = Arc::new(Stage { arms: vec![arm.clone(), arm], ..Stage::default() });
        app.take(Arc::new(s));
        app
    }

    #[test]
    fn terminal_of_80_by_24_shows_every_panel() {
        let mut app = whole();
        let text = shown(&app, (80, 24));
        for words in [
            "turn 31",
            "vsp gs2        not sync.",
            "edp track      synchronised, moves",
            "edp postument  synchronised, moves",
            "-172 -172 -172 -172 -172 -172",
            "0.40 mm",
            "pose out of reach",
            "t terminate",
            "e F12 emergency stop (no safety function)",
        ] {
            assert!(text.contains(words), "no `{words}` in\n{text}");
        }
        let mut early = (*app.snapshot).clone();
        early.plan = Arc::default();
        early.step = None;
        early.actors[0].words = "first position: 12 mm and 3 deg off".into();
        let text_before = drawn(early, (80, 24));
        let line = format!("{:<14} first position: 12 mm", "ui");
        for words in [line.as_str(), "no plan yet"] {
            assert!(text_before.contains(words), "no `{words}` in\n{text_before}");
        }
        let net = text.lines().filter(|line| line.contains("??")).count();
        assert_eq!(net, 9, "every row of the net\n{text}");

        let mut s = (*app.snapshot).clone();
        s.services.manual = true;
        app.take(Arc::new(s));
        let text = shown(&app, (80, 24));
        for words in ["joint 6", "synchronisation", "b zero the sensor", "Tab arm", "e F12"] {
            assert!(text.contains(words), "no `{words}` in\n{text}");
        }
    }

    /// The longest words of a plan in the two usual sizes of a terminal.
    #[test]
    fn plan_lines_stay_within_their_panel() {
        let long = "track turns R' by a quarter, postument holds the cube at its face L until then";
        for (size, is_cut) in [((80, 24), true), ((200, 50), false)] {
            let mut app = whole();
            let mut s = (*app.snapshot).clone();
            let line = PlanLine { what: long.into(), why: String::new(), seconds: 1.0 };
            s.plan = Arc::new(vec![line; 40]);
            app.take(Arc::new(s));

            let text = shown(&app, size);

            let heading = text.lines().find(|row| row.contains("cube as read")).unwrap();
            let column = |title| heading.split_once(title).unwrap().0.chars().count();
            let (begin, columns) = (column("plan"), column("actors") - column("plan"));
            let panel: Vec<String> = text
                .lines()
                .skip_while(|row| !row.contains("cube as read"))
                .skip(1)
                .take_while(|row| !row.contains("messages"))
                .map(|row| row.chars().skip(begin).take(columns).collect())
                .collect();
            assert!(panel.len() > 8, "{text}");
            // The last column is empty, and so is the one before the actors.
            assert!(panel.iter().all(|row| row.ends_with(' ')), "{panel:?}\n{text}");
            let words: Vec<&str> = panel.iter().flat_map(|row| row.split_whitespace()).collect();
            let all = long.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(words.join(" ").contains(&all), "the current step is whole\n{text}");
            assert_eq!(panel.iter().any(|row| row.contains('…')), is_cut, "{text}");
        }
    }

    #[test]
    fn long_step_is_wrapped_between_words() {
        let rows = wrapped(" 31  track turns R' slowly", 16);
        assert_eq!(rows, [" 31  track turns", "     R' slowly"]);
        assert_eq!(wrapped("  1  abcdefghijklmnop", 10), ["  1  abcd…"]);
    }

    #[test]
    fn ended_run_shows_verdict_reason_and_time() {
        let outcome = OutcomeView {
            verdict: "failed".into(),
            good: false,
            reason: "jam at face R".into(),
            time: Some(11.5),
            figures: vec![],
        };
        let text = drawn(
            Snapshot { outcome: Some(outcome), control: ControlView::Ended, ..snapshot() },
            (120, 30),
        );

        assert!(
            text.contains("failed")
                && text.contains("jam at face R")
                && text.contains("q leave")
                && text.contains(" 11.5 s")
        );
    }

    #[test]
    fn stopped_arm_is_shown_with_remedy() {
        let mut faulty = snapshot();
        faulty.arms[0].fault = Some("emergency stop".into());
        faulty.arms[0].remedy =
            Some(crate::operator::remedy(&crate::motion::ArmFault::EmergencyStop).to_owned());

        let text = drawn(faulty, (120, 36));

        assert!(text.contains("track stopped: emergency stop."), "{text}");
        assert!(text.contains("start a new run"), "{text}");
    }

    #[test]
    fn sticker_question_shows_text_cursor_keys_and_time() {
        let read = crate::cube::Facelets::solved().to_string();
        let question = Question {
            number: 1,
            text: "stickers F5 are not certain".into(),
            otherwise: "else it goes back".into(),
            seconds: 60.0,
            until: 40.5,
            subject: Subject::Stickers { read, doubtful: vec![22] },
        };
        let mut asked = Snapshot { question: Some(question), ..snapshot() };
        asked.net.facelets = vec![Some(Reading { colour: 2, confidence: 0.9 }); 54];

        let text = drawn(asked, (100, 40));

        for words in ["F5", "[]", "Esc declines", "28 s left", "e F12 emergency stop"] {
            assert!(text.contains(words), "no `{words}` in\n{text}");
        }
    }
}
