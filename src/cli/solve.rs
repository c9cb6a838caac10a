//! `rubik-robot solve` and `rubik-robot scramble`: cubes in, turns out.

use super::engine::{Answer, Engine, Limits, Mode, Unsolved, two_phase_tables};
use super::output::{Output, WRONG, complain, next_line, refuse};
use super::tables::Folder;
use crate::cube::{
    Cube, Facelets, ImpossibleCube, ParseFacelets, ParseMoves, Repair, after_moves, format_turns,
    parse_moves,
};
use crate::solver::{Budget, solve};
use crate::tables::{Residence, Threads};
use clap::Args;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, RecvError, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
pub(super) struct SolveArgs {
    /// 54 letters URFDLB, the faces U R F D L B in reading order, each sticker named by its centre; - reads one a line
    #[arg(required_unless_present = "scramble", conflicts_with = "scramble")]
    cube: Option<String>,
    /// Solve what these moves make of a solved cube: U R F D L B, wide as Rw or r, M E S, x y z, each with 2 or '
    #[arg(long, value_name = "MOVES")]
    scramble: Option<String>,
    /// How to search
    #[arg(long, value_enum, default_value_t = Mode::TwoPhase)]
    mode: Mode,
    /// Be content with a solution of so many turns; without a budget, search until there is one or all are searched
    #[arg(long, value_name = "N")]
    max_length: Option<u8>,
    /// Search for so long, and give the best
    #[arg(long, value_name = "N", conflicts_with = "budget_nodes")]
    budget_ms: Option<u64>,
    /// Look at so many states and give the best, the same every time
    #[arg(long, value_name = "N")]
    budget_nodes: Option<u64>,
    /// Threads [default: all of the machine]; with --budget-ms all search for one cube, else each has a cube
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// End there instead of at the solved cube
    #[arg(long, value_name = "FACELETS")]
    to: Option<String>,
    /// One line of JSON for each cube
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    folder: Folder,
}

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
pub(super) struct ScrambleArgs {
    /// The same scramble every time [default: another each time]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// How many, one a line
    #[arg(long, value_name = "N", default_value_t = 1)]
    count: u64,
    /// Print the cubes as facelets instead of moves that make them
    #[arg(long)]
    facelets: bool,
    /// One line of JSON for each: cube, scramble, length, seed
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    folder: Folder,
}

/// Exit code where a possible cube is not solved as it should be.
const UNSOLVED: u8 = 1;

/// Why a cube is not solved.
#[derive(Debug)]
pub(super) enum Refusal {
    Facelets(ParseFacelets),
    Impossible(ImpossibleCube, Option<Repair>),
    Moves(ParseMoves),
    Unsolved(Unsolved),
    /// A cube in another orientation, and how it is named by its centres.
    Turned(ImpossibleCube, Facelets),
}

impl Refusal {
    fn impossible(facelets: &Facelets, reason: ImpossibleCube) -> Self {
        match (reason, facelets.normalised()) {
            (ImpossibleCube::CentreElsewhere { .. }, Ok((named, _))) => Self::Turned(reason, named),
            _ => Self::Impossible(reason, Some(Repair::of(facelets))),
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Facelets(ParseFacelets::Length(_)) => "length",
            Self::Facelets(ParseFacelets::Letter { .. }) => "letter",
            Self::Impossible(reason, _) | Self::Turned(reason, _) => reason.kind(),
            Self::Moves(_) => "moves",
            Self::Unsolved(Unsolved::None(_)) => "no-solution",
            Self::Unsolved(Unsolved::NotFound(_)) => "not-found",
        }
    }

    pub(super) fn message(&self) -> String {
        match self {
            Self::Facelets(reason) => reason.to_string(),
            Self::Impossible(reason, _) => reason.to_string(),
            Self::Moves(reason) => reason.to_string(),
            Self::Unsolved(reason) => reason.to_string(),
            Self::Turned(reason, named) => {
                format!("{reason}; by the colours of its centres it is {named}")
            }
        }
    }

    fn places(&self) -> Vec<String> {
        match self {
            Self::Facelets(ParseFacelets::Letter { place, .. }) => vec![place.to_string()],
            Self::Impossible(reason, _) | Self::Turned(reason, _) => reason.places(),
            Self::Moves(reason) => vec![reason.token.clone()],
            Self::Facelets(ParseFacelets::Length(_)) | Self::Unsolved(_) => Vec::new(),
        }
    }

    /// The exit code: a cube that cannot be, or one that is not solved so.
    fn code(&self) -> u8 {
        if matches!(self, Self::Unsolved(_)) { UNSOLVED } else { WRONG }
    }

    pub(super) fn repair(&self) -> Option<&Repair> {
        match self {
            Self::Impossible(_, repair) => repair.as_ref(),
            _ => None,
        }
    }

    pub(super) fn json(&self, cube: &str) -> Value {
        let mut error =
            json!({"kind": self.kind(), "message": self.message(), "where": self.places()});
        if let Some(repair) = self.repair() {
            error["repair"] = Value::from(repair.to_string());
        }
        json!({"cube": cube, "error": error})
    }
}

/// A cube, and the stickers by which it is named in answers.
pub(super) fn read(text: &str) -> Result<(Cube, Facelets), Refusal> {
    let facelets: Facelets = text.parse().map_err(Refusal::Facelets)?;
    let cube = Cube::try_from(facelets).map_err(|e| Refusal::impossible(&facelets, e))?;
    Ok((cube, facelets))
}

/// What moves make of a solved cube, held as it is after them.
fn scrambled(text: &str) -> Result<(Cube, Facelets), Refusal> {
    let moves = parse_moves(text).map_err(Refusal::Moves)?;
    let named = after_moves(&Facelets::solved(), &moves).named_by_position();
    let facelets = named.map_err(|e| Refusal::Impossible(e, None))?;
    let cube = Cube::try_from(facelets).map_err(|e| Refusal::impossible(&facelets, e))?;
    Ok((cube, facelets))
}

/// A line of an answer: text for stdout or, where it has an exit code, for stderr.
struct Line {
    text: String,
    code: u8,
}

/// What answers are made with.
struct Desk {
    engine: Engine,
    goal: Cube,
    json: bool,
    mode: Mode,
}

impl Desk {
    /// Answers one cube of a stream, or of the command line when it is alone.
    fn answer(&self, given: &str, cube: Result<(Cube, Facelets), Refusal>, alone: bool) -> Line {
        let solved = cube.and_then(|(cube, facelets)| {
            // From the cube to the goal are the turns that solve it as seen from the goal.
            let way = self.goal.inverse().then(&cube);
            self.engine.solve(&way).map(|a| (facelets, a)).map_err(Refusal::Unsolved)
        });
        match solved {
            Ok((facelets, answer)) => {
                let text = match (self.json, alone) {
                    (true, _) => json_line(&facelets, &answer),
                    (false, true) => self.explained(&answer),
                    (false, false) => {
                        format!("{} ({})", format_turns(&answer.turns), answer.turns.len())
                    }
                };
                Line { text, code: 0 }
            }
            Err(refusal) => {
                let text = if self.json {
                    refusal.json(given).to_string()
                } else {
                    let repair = refusal.repair().map(|r| format!("; least repair: {r}"));
                    format!("{}{}", refusal.message(), repair.unwrap_or_default())
                };
                Line { text, code: refusal.code() }
            }
        }
    }

    fn explained(&self, answer: &Answer) -> String {
        if answer.turns.is_empty() {
            return "nothing to turn: the cube is already there".to_owned();
        }
        let count = answer.turns.len();
        let turns = if count == 1 { "1 turn".to_owned() } else { format!("{count} turns") };
        let proof = match (answer.optimal, self.mode) {
            (true, _) => "the shortest there is, proven",
            (false, Mode::Robot) => "chosen for two arms, not for its length",
            (false, _) => "not proven to be the shortest",
        };
        format!(
            "{}\n{turns} of faces, half turns count one; {proof}\n{} states looked at in {:.3} s with {}",
            format_turns(&answer.turns),
            answer.nodes,
            answer.time.as_secs_f64(),
            self.engine.with,
        )
    }
}

fn json_line(facelets: &Facelets, answer: &Answer) -> String {
    // By hand, to keep the order of the fields.
    format!(
        "{{\"cube\":\"{facelets}\",\"solution\":\"{}\",\"length\":{},\"optimal\":{},\"nodes\":{},\"time_s\":{:.6}}}",
        format_turns(&answer.turns),
        answer.turns.len(),
        answer.optimal,
        answer.nodes,
        answer.time.as_secs_f64(),
    )
}

pub(super) fn run(args: &SolveArgs, output: &mut Output) -> anyhow::Result<u8> {
    let threads = args
        .threads
        .map_or_else(|| std::thread::available_parallelism().map_or(1, usize::from), usize::from);
    let goal = args
        .to
        .as_deref()
        .map(read)
        .transpose()
        .map_err(|refusal| refuse(format!("--to: {}", refusal.message())))?;
    let goal = goal.map_or(Cube::SOLVED, |(cube, _)| cube);
    if args.mode == Mode::Robot && args.max_length.is_some() {
        return Err(refuse(
            "--max-length has no meaning for --mode robot, which goes by time, not by length",
        ));
    }
    let limits = Limits {
        max_length: args.max_length,
        time: args.budget_ms.map(Duration::from_millis),
        nodes: args.budget_nodes,
    };
    let stream = args.cube.as_deref() == Some("-");
    // What is refused anyhow should not wait for tables.
    let alone = if stream {
        None
    } else {
        let (given, cube) = match (&args.cube, &args.scramble) {
            (Some(text), _) => (text, read(text)),
            (_, Some(text)) => (text, scrambled(text)),
            (None, None) => return Ok(WRONG),
        };
        if let Err(refusal) = &cube {
            return print_refusal(given, refusal, args.json, output);
        }
        Some((given, cube))
    };
    // A copy pays for whoever stays longer.
    let long = stream
        || matches!(args.mode, Mode::Korf | Mode::Optimal)
        || args.budget_ms.is_some_and(|ms| ms > 2000);
    let residence = if long { Residence::Copied } else { Residence::Mapped };
    let engine = Engine::new(args.mode, limits, threads, &args.folder.store().with(residence));
    let desk = Desk { engine, goal, json: args.json, mode: args.mode };
    let Some((given, cube)) = alone else {
        let workers = if desk.engine.shares_cubes() { 1 } else { threads };
        return answer_stream(&Arc::new(desk), workers, output);
    };
    let line = desk.answer(given, cube, true);
    if line.code != 0 && !args.json {
        complain(&line.text);
    } else {
        output.line(&line.text)?;
    }
    Ok(line.code)
}

fn print_refusal(
    given: &str,
    refusal: &Refusal,
    json: bool,
    output: &mut Output,
) -> anyhow::Result<u8> {
    if json {
        output.line(&refusal.json(given).to_string())?;
    } else {
        complain(&refusal.message());
        if let Some(repair) = refusal.repair() {
            complain(&format!("least repair: {repair}"));
        }
    }
    Ok(WRONG)
}

/// Longest line with a cube (bytes): a scramble has hundreds.
const LONGEST: usize = 1 << 16;

/// Answers each line of stdin in its order, several at once.
///
/// The threads are not waited for: one of them may stand in a read of stdin when nobody wants the answers any more.
fn answer_stream(desk: &Arc<Desk>, workers: usize, output: &mut Output) -> anyhow::Result<u8> {
    let (lines, todo) = sync_channel::<(usize, std::io::Result<String>)>(workers * 4);
    let (answers, done) = sync_channel::<(usize, std::io::Result<Line>)>(workers * 4);
    std::thread::spawn(move || {
        // A line that is no text is refused as any other; those after it are not lost.
        let mut stdin = std::io::stdin().lock();
        let mut line = Vec::new();
        let cubes = std::iter::from_fn(|| {
            let read = next_line(&mut stdin, LONGEST, &mut line).transpose()?;
            // What is longer is no cube, whatever it begins with.
            let cube = || String::from_utf8_lossy(&line).into_owned();
            let long = || format!("a line of more than {LONGEST} bytes");
            Some(read.map(|whole| if whole { cube() } else { long() }))
        });
        let cubes = cubes.filter(|l| l.as_ref().is_ok_and(|l| !l.trim().is_empty()) || l.is_err());
        for numbered in cubes.enumerate() {
            let ends = numbered.1.is_err();
            if lines.send(numbered).is_err() || ends {
                return;
            }
        }
    });
    let todo = Arc::new(Mutex::new(todo));
    for _ in 0..workers {
        let (desk, todo, answers) = (Arc::clone(desk), Arc::clone(&todo), answers.clone());
        std::thread::spawn(move || {
            loop {
                let next = todo.lock().unwrap_or_else(PoisonError::into_inner).recv();
                let Ok((number, line)) = next else { return };
                let answer = line.map(|line| desk.answer(line.trim(), read(&line), false));
                if answers.send((number, answer)).is_err() {
                    return;
                }
            }
        });
    }
    drop(answers);
    write_in_order(&done, desk.json, output)
}

/// Writes answers in the order of their numbers, and each as soon as it can be.
fn write_in_order(
    done: &Receiver<(usize, std::io::Result<Line>)>,
    json: bool,
    output: &mut Output,
) -> anyhow::Result<u8> {
    let (mut early, mut next, mut code) = (BTreeMap::new(), 0, 0);
    loop {
        let arrived = match done.try_recv() {
            Err(TryRecvError::Empty) => {
                output.flush()?;
                done.recv().map_err(|RecvError| TryRecvError::Disconnected)
            }
            other => other,
        };
        let Ok((number, line)) = arrived else { break };
        early.insert(number, line?);
        while let Some(line) = early.remove(&next) {
            next += 1;
            code = code.max(line.code);
            if line.code != 0 && !json {
                complain(&format!("cube {next}: {}", line.text));
                output.line("")?;
            } else {
                output.line(&line.text)?;
            }
        }
        if output.is_closed() {
            break;
        }
    }
    Ok(code)
}

pub(super) fn scramble(args: &ScrambleArgs, output: &mut Output) -> anyhow::Result<u8> {
    let now = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let first = args.seed.unwrap_or_else(|| now().as_nanos() as u64 & 0xffff_ffff_ffff);
    // Facelets alone need no solver.
    let needs_tables = args.json || !args.facelets;
    let tables = needs_tables.then(|| two_phase_tables(&args.folder.store(), Threads::all()).0);
    for seed in first..first.saturating_add(args.count) {
        let cube = Cube::scrambled(seed);
        let facelets = Facelets::from(&cube);
        let Some(tables) = &tables else {
            output.line(&facelets.to_string())?;
            if output.is_closed() {
                break;
            }
            continue;
        };
        // What solves the cube, backwards, makes it.
        let solution = solve(&cube, tables, &Budget { nodes: 20_000, max_length: 20 });
        let turns: Vec<_> = solution.turns.iter().rev().map(|t| t.inverse()).collect();
        let text = format_turns(&turns);
        output.line(&if args.json {
            format!(
                "{{\"cube\":\"{facelets}\",\"scramble\":\"{text}\",\"length\":{},\"seed\":{seed}}}",
                turns.len()
            )
        } else {
            text
        })?;
        if output.is_closed() {
            break;
        }
    }
    Ok(0)
}
