//! `rubik-robot solve` and `rubik-robot scramble`: solve cubes, and draw random ones.
//!
//! - in: a cube or a scramble; or cubes on stdin; or a seed
//! - out: turns, as text or as a line of JSON for each cube, in the order of the cubes
//! - exit code of `solve`: 1 if a cube has no solution within the limits, 2 if a cube is refused

use super::cube_lines::cubes;
use super::engine::{Answer, Engine, Found, Limits, Mode, Unsolved, two_phase_tables};
use super::output::{Output, WRONG, complain, inform, refuse};
use super::progress::Waiting;
use super::tables::Folder;
use crate::cube::{
    Cube, Facelets, ImpossibleCube, ParseFacelets, ParseMoves, Repair, after_moves, format_turns,
    parse_moves,
};
use crate::solver::{Budget, solve};
use crate::tables::{Residence, Threads, cores};
use clap::Args;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, RecvError, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
pub(super) struct SolveArgs {
    /// Cube: 54 letters, faces in the order U R F D L B, each in reading order; - for
    /// stdin, with a cube in a line, in six lines of 9, or in a net (3 lines of 3, 3 of
    /// 12 with L F R B, 3 of 3); blanks do not count; letters may also be colours
    /// (w r o y g b): each stands for the face whose centre has it
    #[arg(required_unless_present = "scramble", conflicts_with = "scramble", verbatim_doc_comment)]
    cube: Option<String>,
    /// Cube as the moves that make it from a solved one: turns of faces
    /// (U R F D L B), of two layers (Rw or r), of slices (M E S) and of the
    /// whole cube (x y z), each also with 2 or '
    #[arg(long, value_name = "MOVES", verbatim_doc_comment)]
    scramble: Option<String>,
    /// Mode of the search (below): first, two-phase, korf, optimal or robot
    #[arg(long, value_enum, default_value_t = Mode::TwoPhase, hide_possible_values = true)]
    mode: Mode,
    /// Stop at the first solution of at most N turns (not with robot); if none is
    /// found, a longer one counts with first or two-phase and a budget
    #[arg(long, value_name = "N", verbatim_doc_comment)]
    max_length: Option<u8>,
    /// Time limit for a cube by the wall clock (ms); the best solution until then
    /// counts [default: none]
    #[arg(long, value_name = "N", conflicts_with = "budget_nodes", verbatim_doc_comment)]
    budget_ms: Option<u64>,
    /// Greatest number of states to search; the result is the same each time
    /// [default: 500000 with two-phase and robot, unless another limit is given;
    /// otherwise none]
    #[arg(long, value_name = "N", verbatim_doc_comment)]
    budget_nodes: Option<u64>,
    /// Number of threads: each solves a cube of its own, but all search for one
    /// cube with korf, optimal, and two-phase with --budget-ms
    /// [default: number of cores that this process may use]
    #[arg(long, value_name = "N", verbatim_doc_comment,
          value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// Goal instead of the solved cube: 54 letters, as those of the cube
    #[arg(long, value_name = "FACELETS")]
    to: Option<String>,
    /// Print one line of JSON for each cube
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    folder: Folder,
}

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
pub(super) struct ScrambleArgs {
    /// Seed of the first cube; the next cubes have the next seeds [default: a random one]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Number of cubes; each gets a line of output
    #[arg(long, value_name = "N", default_value_t = 1)]
    count: u64,
    /// Print the cubes as 54 letters instead of turns that make them
    #[arg(long)]
    facelets: bool,
    /// Print one line of JSON for each cube
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    folder: Folder,
}

/// Most cubes of stdin whose refusal is told.
const MOST_TOLD: u64 = 10;

/// Exit code if a possible cube has no solution within the limits.
const UNSOLVED: u8 = 1;

/// Reason why a cube is not solved.
#[derive(Debug)]
pub(super) enum Refusal {
    /// Text that is no list of 54 facelets.
    Facelets(ParseFacelets),
    /// Facelets that no real cube can have; and their smallest repair.
    Impossible(ImpossibleCube, Option<Repair>),
    /// Text that is no list of moves.
    Moves(ParseMoves),
    /// Search without a solution.
    Unsolved(Unsolved),
    /// Possible cube that is held in another orientation: a centre does not have the letter of its
    /// face; and the facelets as named by the centres.
    Turned(ImpossibleCube, Facelets),
}

impl Refusal {
    /// Makes the refusal of facelets that are no valid cube: [`Refusal::Turned`] if only the
    /// centres are named otherwise, else [`Refusal::Impossible`] with the repair.
    fn impossible(facelets: &Facelets, reason: ImpossibleCube) -> Self {
        match (reason, facelets.normalised()) {
            // A cube in another orientation is possible: it only needs other letters.
            (ImpossibleCube::CentreElsewhere { .. }, Ok((named, _))) => Self::Turned(reason, named),
            _ => Self::Impossible(reason, Some(Repair::of(facelets))),
        }
    }

    /// Returns the reason as one word for programs.
    fn kind(&self) -> &'static str {
        match self {
            Self::Facelets(ParseFacelets::Length(_)) => "length",
            Self::Facelets(ParseFacelets::Letter { .. }) => "letter",
            Self::Facelets(ParseFacelets::Layout(_)) => "layout",
            Self::Facelets(ParseFacelets::Colours) => "colours",
            Self::Impossible(reason, _) | Self::Turned(reason, _) => reason.kind(),
            Self::Moves(_) => "moves",
            Self::Unsolved(Unsolved::None(_)) => "no-solution",
            Self::Unsolved(Unsolved::NotFound(_)) => "not-found",
        }
    }

    /// Returns the reason for people.
    pub(super) fn message(&self) -> String {
        match self {
            Self::Facelets(reason) => reason.to_string(),
            Self::Impossible(reason, _) => reason.to_string(),
            Self::Moves(reason) => reason.to_string(),
            Self::Unsolved(reason) => reason.to_string(),
            Self::Turned(reason, named) => {
                format!("{reason}: named by the colours of its centres it is {named}")
            }
        }
    }

    /// Returns the pieces, stickers or moves that are wrong.
    fn places(&self) -> Vec<String> {
        match self {
            Self::Facelets(ParseFacelets::Letter { place, .. }) => vec![place.to_string()],
            Self::Impossible(reason, _) | Self::Turned(reason, _) => reason.places(),
            Self::Moves(reason) => vec![reason.token.clone()],
            Self::Facelets(_) | Self::Unsolved(_) => Vec::new(),
        }
    }

    /// Returns the exit code: [`UNSOLVED`] if the search found no solution, [`WRONG`] if the input
    /// is wrong.
    fn code(&self) -> u8 {
        if matches!(self, Self::Unsolved(_)) { UNSOLVED } else { WRONG }
    }

    /// Returns the smallest repair of an impossible cube.
    pub(super) fn repair(&self) -> Option<&Repair> {
        match self {
            Self::Impossible(_, repair) => repair.as_ref(),
            _ => None,
        }
    }

    /// Returns the refusal of a cube as JSON.
    pub(super) fn json(&self, cube: &str) -> Value {
        let mut error =
            json!({"kind": self.kind(), "message": self.message(), "where": self.places()});
        if let Some(repair) = self.repair() {
            error["repair"] = Value::from(repair.to_string());
        }
        json!({"cube": cube, "error": error})
    }
}

/// Parses a cube. Also returns its facelets, with which the answers name the cube.
pub(super) fn read(text: &str) -> Result<(Cube, Facelets), Refusal> {
    let facelets: Facelets = text.parse().map_err(Refusal::Facelets)?;
    let cube = Cube::try_from(facelets).map_err(|e| Refusal::impossible(&facelets, e))?;
    Ok((cube, facelets))
}

/// Returns advice if `text` is a list of moves instead of a cube: the call that solves the cube
/// that they make.
pub(super) fn scramble_of(text: &str) -> Option<String> {
    let moves = parse_moves(text).ok().filter(|moves| !moves.is_empty())?;
    let (these, make) =
        if moves.len() == 1 { ("is a move", "it makes") } else { ("are moves", "they make") };
    let text = text.trim();
    Some(format!(
        "  `{text}` {these}, not a cube; to solve the cube that {make}:\n\
         \x20 rubik-robot solve --scramble \"{text}\""
    ))
}

/// Returns the cube that moves make of a solved one. Moves may also turn the centres; each colour
/// is named by the face on whose centre it is after the moves.
fn scrambled(text: &str) -> Result<(Cube, Facelets), Refusal> {
    let moves = parse_moves(text).map_err(Refusal::Moves)?;
    // Turns of the whole cube move the centres, so the letters are named by their new places.
    let named = after_moves(&Facelets::solved(), &moves).named_by_position();
    let facelets = named.map_err(|e| Refusal::Impossible(e, None))?;
    let cube = Cube::try_from(facelets).map_err(|e| Refusal::impossible(&facelets, e))?;
    Ok((cube, facelets))
}

/// Answer to a cube. The text goes to stdout; without `--json` a refusal goes to stderr.
struct Line {
    text: String,
    /// Exit code: 0 if the cube is solved.
    code: u8,
}

/// Engine that solves the cubes, with the options that shape the answers.
struct Desk {
    engine: Engine,
    /// State that the turns lead to, instead of the solved cube.
    goal: Cube,
    json: bool,
    mode: Mode,
}

impl Desk {
    /// Answers a cube: one of a stream, or the one of the command line if `alone`. `given` is the
    /// text of the cube, which a refusal repeats in JSON. `found` gets what the search has found.
    fn answer(
        &self,
        given: &str,
        cube: Result<(Cube, Facelets), Refusal>,
        alone: bool,
        found: Found<'_>,
    ) -> Line {
        let solved = cube.and_then(|(cube, facelets)| {
            // Turns that lead from the cube to the goal are those that solve this product.
            let seen = self.goal.inverse().then(&cube);
            self.engine.solve(&seen, found).map(|a| (facelets, a)).map_err(Refusal::Unsolved)
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
                    let repair = refusal.repair().map(|r| format!("; smallest repair: {r}"));
                    format!("{}{}", refusal.message(), repair.unwrap_or_default())
                };
                Line { text, code: refusal.code() }
            }
        }
    }

    /// Returns an answer for a person: the turns, their number, whether they are proven to be the
    /// shortest, and the states and time of the search.
    fn explained(&self, answer: &Answer) -> String {
        if answer.turns.is_empty() {
            return "no turn is needed: the cube is at its goal".to_owned();
        }
        let count = answer.turns.len();
        let turns = if count == 1 { "1 turn".to_owned() } else { format!("{count} turns") };
        let proof = match (answer.optimal, self.mode) {
            (true, _) => "proven to be the shortest",
            (false, Mode::Robot) => "the fastest for two arms, not the shortest",
            (false, _) => "not proven to be the shortest",
        };
        format!(
            "{}\n{turns} of faces, half turns count one; {proof}\n\
             {} states searched in {:.3} s with {}",
            format_turns(&answer.turns),
            answer.nodes,
            answer.time.as_secs_f64(),
            self.engine.with,
        )
    }
}

/// Returns an answer as a line of JSON.
fn json_line(facelets: &Facelets, answer: &Answer) -> String {
    // Written by hand, to keep the order of the fields.
    format!(
        "{{\"cube\":\"{facelets}\",\"solution\":\"{}\",\"length\":{},\"optimal\":{},\"nodes\":{},\
         \"time_s\":{:.6}}}",
        format_turns(&answer.turns),
        answer.turns.len(),
        answer.optimal,
        answer.nodes,
        answer.time.as_secs_f64(),
    )
}

/// Solves the cube of the arguments, or those on stdin; returns the exit code.
pub(super) fn run(args: &SolveArgs, output: &mut Output) -> anyhow::Result<u8> {
    let threads = args.threads.map_or_else(cores, usize::from);
    let goal = args
        .to
        .as_deref()
        .map(read)
        .transpose()
        .map_err(|refusal| refuse(format!("--to: {}", refusal.message())))?;
    let goal = goal.map_or(Cube::SOLVED, |(cube, _)| cube);
    if args.mode == Mode::Robot && args.max_length.is_some() {
        return Err(refuse(
            "--max-length has no effect on --mode robot, which minimises time: leave it out",
        ));
    }
    let limits = Limits {
        max_length: args.max_length,
        time: args.budget_ms.map(Duration::from_millis),
        nodes: args.budget_nodes,
    };
    // The name `-` means stdin, as in other programs.
    let stream = args.cube.as_deref() == Some("-");
    // A cube that is refused should not wait for tables.
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
    // A copy of the tables takes a second, and makes a long search a quarter faster.
    let long = stream
        || matches!(args.mode, Mode::Korf | Mode::Optimal)
        || args.budget_ms.is_some_and(|ms| ms > 2000);
    let residence = if long { Residence::Copied } else { Residence::Mapped };
    let engine = Engine::new(args.mode, limits, threads, &args.folder.store().with(residence));
    let desk = Desk { engine, goal, json: args.json, mode: args.mode };
    let Some((given, cube)) = alone else {
        // A mode in which all threads search for one cube takes one cube at a time.
        let workers = if desk.engine.shares_cubes() { 1 } else { threads };
        return answer_stream(&Arc::new(desk), workers, output);
    };
    let waiting = Waiting::begin("searching");
    let line = desk.answer(given, cube, true, &|found| waiting.say(&format!("searching: {found}")));
    drop(waiting);
    if line.code != 0 && !args.json {
        complain(&line.text);
    } else {
        output.line(&line.text)?;
    }
    Ok(line.code)
}

/// Prints why a cube is refused; returns the exit code.
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
        if let Some(advice) = scramble_of(given).filter(|_| refusal.kind() != "moves") {
            inform(&advice);
        }
        if let Some(repair) = refusal.repair() {
            complain(&format!("smallest repair: {repair}"));
        }
    }
    Ok(WRONG)
}

/// Answers the cubes of stdin in their order, `workers` at a time; returns the exit code.
///
/// Does not wait for the threads to end: the one that reads stdin may block for ever after the
/// reader of the answers has left.
fn answer_stream(desk: &Arc<Desk>, workers: usize, output: &mut Output) -> anyhow::Result<u8> {
    // Bounded channels keep a fast input from filling the memory.
    let (lines, todo) = sync_channel::<(usize, std::io::Result<String>)>(workers * 4);
    let (answers, done) = sync_channel::<(usize, std::io::Result<Line>)>(workers * 4);
    std::thread::spawn(move || {
        for numbered in cubes(std::io::stdin().lock()).enumerate() {
            // An error of reading is passed on and ends the input.
            let ends = numbered.1.is_err();
            if lines.send(numbered).is_err() || ends {
                return;
            }
        }
    });
    // One receiver is shared: each worker takes the next line.
    let todo = Arc::new(Mutex::new(todo));
    for _ in 0..workers {
        let (desk, todo, answers) = (Arc::clone(desk), Arc::clone(&todo), answers.clone());
        std::thread::spawn(move || {
            loop {
                let next = todo.lock().unwrap_or_else(PoisonError::into_inner).recv();
                let Ok((number, line)) = next else { return };
                let answer = line.map(|line| desk.answer(line.trim(), read(&line), false, &|_| ()));
                if answers.send((number, answer)).is_err() {
                    return;
                }
            }
        });
    }
    // The writer ends when the last worker has dropped its sender.
    drop(answers);
    write_in_order(&done, desk.json, output)
}

/// Writes answers in the order of their numbers, each as soon as all before it are written. Returns
/// the largest of their exit codes.
fn write_in_order(
    done: &Receiver<(usize, std::io::Result<Line>)>,
    json: bool,
    output: &mut Output,
) -> anyhow::Result<u8> {
    let (mut early, mut next, mut code) = (BTreeMap::new(), 0, 0);
    let mut refused = 0_u64;
    loop {
        let arrived = match done.try_recv() {
            // Before a wait the answers are flushed, so that an interactive reader gets them.
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
            // A refusal goes to stderr, where it does not mix with the answers.
            if line.code != 0 && !json {
                refused += 1;
                // A file of other text would give a message for each of its lines.
                if refused <= MOST_TOLD {
                    complain(&format!("cube {next}: {}", line.text));
                }
                // An empty line keeps the numbers of lines equal to those of the cubes.
                output.line("")?;
            } else {
                output.line(&line.text)?;
            }
        }
        if output.is_closed() {
            break;
        }
    }
    if refused > MOST_TOLD {
        let more = refused - MOST_TOLD;
        complain(&format!("and {more} more cubes without an answer: --json gives each reason"));
    }
    Ok(code)
}

/// Draws random cubes and prints them, or the turns that make them; returns the exit code.
pub(super) fn scramble(args: &ScrambleArgs, output: &mut Output) -> anyhow::Result<u8> {
    let now = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    // A seed drawn from the clock is short enough to be typed again.
    let first = args.seed.unwrap_or_else(|| now().as_nanos() as u64 & 0xffff_ffff_ffff);
    // Printing facelets needs no solver.
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
        // The inverse of a solution makes the cube. A scramble need not be short, so the search
        // stops at the first solution of at most 20 turns, which it finds fast.
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
