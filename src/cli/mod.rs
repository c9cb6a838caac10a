//! The command line: words and units of the workshop in, text or lines of JSON out.
//!
//! Exit codes: 0 done; 1 the task failed or was aborted; 2 usage or scenario; 3 fatal (effector);
//! 4 system; 130 interrupted. Results go to stdout, everything else to stderr.

mod arguments;
mod benchmark;
mod calibrate;
mod campaign;
mod check;
pub mod cubes;
mod doctor;
mod emulate;
mod engine;
pub mod evaluate;
mod faces;
mod film;
mod frames;
pub mod image_file;
mod keys;
mod kinematics;
mod locate;
mod output;
mod picture;
mod plan;
mod progress;
mod record;
mod recover;
mod replay;
mod report;
mod rig;
mod run;
mod schema;
mod shell;
mod solve;
mod stages;
mod tables;
mod ui;
mod urdf;
mod vision;
mod weigh;

use arguments::ScenarioArgs;
use clap::{CommandFactory, Parser, Subcommand};
use output::{Output, Refused, WRONG, complain};
use std::io::IsTerminal as _;
use std::process::ExitCode;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::prelude::*;

const HELP: &str = "\
Try these, in this order:
  rubik-robot run scenarios/solve.toml                    the whole mission
  rubik-robot run scenarios/solve.toml --seed 7           another cube, hand and cell
  rubik-robot run scenarios/face_turn.toml --set control.compliance=none
                                                          the same turn without force control
  rubik-robot run scenarios/solve.toml --json | tail -1   the summary for a program
  rubik-robot campaign scenarios/solve.toml --runs 20     how often it succeeds
  rubik-robot check my.toml                               what is wrong with a scenario
  rubik-robot keys control                                every key, its unit, default and meaning
  echo 0,-1.57,0,1.56,1.57,-1.57 | rubik-robot kinematics fk --arm postument
  rubik-robot vision face photo.jpg                       the faces of a cube in a photograph
  rubik-robot solve --scramble \"R U2 F' L\"               the fewest turns that solve a cube
  rubik-robot tables build                                larger tables, for shorter solutions
  rubik-robot picture scenarios/solve.toml                the cell as cell.png
  rubik-robot doctor                                      whether this machine is fit for real time

Exit codes: 0 done, 1 the task failed or was aborted, 2 usage or scenario, 3 fatal (an effector),
4 system, 130 interrupted. RUST_LOG=rubik_robot=debug shows what the actors do.";

/// A two-handed robot that takes, reads, solves and returns a Rubik's cube, in a simulated cell.
#[derive(Debug, Parser)]
#[command(name = "rubik-robot", version, after_help = HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Subcommand)]
enum Command {
    /// Perform a scenario and print what it came to
    Run(run::RunArgs),
    /// Perform a scenario many times and say how often it succeeds, and how sure that is
    Campaign(campaign::CampaignArgs),
    /// Measure accuracy and speed in trials, and write the protocol
    Benchmark(benchmark::BenchmarkArgs),
    /// Stand in for a robot: the cell of a scenario behind serial lines, datagrams and sockets
    Emulate(emulate::EmulateArgs),
    /// Find the weight of a tool, its centre and the force sensor's bias, from several orientations
    Weigh(weigh::WeighArgs),
    /// Say everything that is wrong with a scenario, without running it
    #[command(after_help = "\
Examples:
  rubik-robot check scenarios/solve.toml
  rubik-robot check scenarios/solve.toml --set control.grip_n=5
Exit code 2 and file:line:column of every fault when something is wrong.")]
    Check(ScenarioArgs),
    /// List the keys of scenarios: unit, default, range, meaning
    #[command(after_help = "\
Examples:
  rubik-robot keys                 all of them
  rubik-robot keys plant.errors    those whose name begins so
  rubik-robot keys grip            those whose name contains a word")]
    Keys {
        /// Part of a key's name
        word: Option<String>,
    },
    /// Answer rows of numbers with the kinematics of an arm
    #[command(after_help = "\
Rows are CSV on stdin, in rad and m; for the track arm d0 comes first. One JSON line answers each row;
a row that cannot be answered gives {\"error\": ...} in its place.
Examples:
  echo 0,-1.57,0,1.56,1.57,-1.57 | rubik-robot kinematics fk --arm postument
  echo 0.2,0,-1.57,0,1.56,1.57,-1.57 | rubik-robot kinematics motors --arm track
  rubik-robot kinematics ik --arm postument < rows.csv
      each row: 12 numbers of base_from_tool by rows (3 x 4), then the current joints")]
    Kinematics(kinematics::KinematicsArgs),
    /// Solve cubes: the fewest turns of faces
    #[command(after_help = "\
Answers come on stdout in the order of the cubes, what is refused says why. Exit code 2 if any cube was refused.
Examples:
  rubik-robot solve --scramble \"R U2 M' y Fw\"
  rubik-robot solve DRLUUBFBRBLURRLRUBLRDDFDLFUFUFFDBRDUBRUFLLFDDBFLUBLRBD
  rubik-robot solve --mode first --json - < cubes.txt
  rubik-robot solve --max-length 20 --scramble \"R U R' U'\"
  rubik-robot solve --budget-ms 1000 --threads 2 CUBE
  rubik-robot scramble --count 5 --facelets | rubik-robot solve -")]
    Solve(solve::SolveArgs),
    /// Plan what two arms do with a cube: who holds, who turns, and why a new grasp is needed
    #[command(after_help = "\
Examples:
  rubik-robot plan --explain FACELETS
      every step with its time and its reason, and the original's rule beside it
  rubik-robot plan FACELETS --rule strict --json
  rubik-robot scramble --seed 7 --facelets | xargs rubik-robot plan --explain
The plan is for the built-in cell, or for --scenario's: its reach, its speeds, its grippers.")]
    Plan(plan::PlanArgs),
    /// Draw cubes uniformly from all there are, and say which turns make them
    #[command(after_help = "\
Examples:
  rubik-robot scramble
  rubik-robot scramble --seed 7 --json
  rubik-robot scramble --count 1000 --seed 1 --facelets > cubes.txt")]
    Scramble(solve::ScrambleArgs),
    /// Make, list, check and remove the solver's tables
    #[command(after_help = "\
Without them `solve` builds what its mode needs when it needs it; the large ones for two-phase only here.
Examples:
  rubik-robot tables build            everything that any mode needs
  rubik-robot tables list
  rubik-robot tables verify
  rubik-robot tables remove phase1-large
  RUBIK_ROBOT_TABLES=/data/tables rubik-robot tables build")]
    Tables(tables::TablesArgs),
    /// Run the vision on pictures and on measured colours
    Vision(vision::VisionArgs),
    /// Say what this machine can give a real-time servo, and what helps where it falls short
    Doctor(doctor::DoctorArgs),
    /// Calibrate the cameras of a scenario in the simulated cell
    Calibrate(calibrate::CalibrateArgs),
    /// Show a recording again, or verify it: do its inputs make the same controller do the same?
    Replay(replay::ReplayArgs),
    /// Make a page of a recording: verdict, figures, curves, pictures, plan
    Report(report::ReportArgs),
    /// Make a moving picture of a recorded mission
    Film(film::FilmArgs),
    /// Make a whole recording of one that was cut off or damaged
    Recover(recover::RecoverArgs),
    /// Write the cell, or one arm, as URDF
    Urdf(urdf::UrdfArgs),
    /// Write the JSON schema of scenarios, for editors
    #[command(after_help = "\
Example:
  rubik-robot schema > scenario.schema.json
An editor with a TOML language server (taplo, Even Better TOML) checks and completes keys with
  #:schema ./scenario.schema.json
in a scenario's first line.")]
    Schema,
    /// Write the completions of a shell
    #[command(after_help = "\
Examples:
  rubik-robot completions bash > ~/.local/share/bash-completion/completions/rubik-robot
  rubik-robot completions fish > ~/.config/fish/completions/rubik-robot.fish")]
    Completions {
        /// Which shell
        shell: clap_complete::Shell,
    },
    /// Write the manual page
    #[command(after_help = "\
Examples:
  rubik-robot man > rubik-robot.1
  rubik-robot man run | man -l -")]
    Man {
        /// Of a command; without one, of the program
        command: Option<String>,
    },
    /// Draw the cell of a scenario, or what one of its cameras sees
    Picture(picture::PictureArgs),
}

/// The program's entry.
#[must_use]
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    log_to_stderr(std::env::var("RUST_LOG").ok().as_deref());
    let mut output = Output::stdout();
    let done = match cli.command {
        Command::Run(args) => run::run(&args, &mut output),
        Command::Campaign(args) => campaign::run(&args, &mut output),
        Command::Benchmark(args) => benchmark::run(&args, &mut output),
        Command::Emulate(args) => emulate::run(&args, &mut output),
        Command::Weigh(args) => weigh::run(&args, &mut output),
        Command::Check(args) => check::run(&args, &mut output),
        Command::Keys { word } => keys::run(word.as_deref(), &mut output),
        Command::Kinematics(args) => kinematics::run(&args, &mut output),
        Command::Solve(args) => solve::run(&args, &mut output),
        Command::Plan(args) => plan::run(&args, &mut output),
        Command::Scramble(args) => solve::scramble(&args, &mut output),
        Command::Tables(args) => tables::run(&args, &mut output),
        Command::Vision(args) => vision::vision(&args, &mut output),
        Command::Doctor(args) => doctor::run(&args, &mut output),
        Command::Calibrate(args) => calibrate::calibrate(&args, &mut output),
        Command::Picture(args) => picture::picture(&args, &mut output),
        Command::Replay(args) => replay::run(&args, &mut output),
        Command::Report(args) => report::run(&args),
        Command::Film(args) => film::run(&args, &mut output),
        Command::Recover(args) => recover::run(&args),
        Command::Urdf(args) => urdf::run(&args, &mut output),
        Command::Schema => schema::run(&mut output),
        Command::Completions { shell } => {
            shell::completions(shell, &mut Cli::command(), &mut output)
        }
        Command::Man { command } => shell::manual(command.as_deref(), Cli::command(), &mut output),
    };
    let code = done.or_else(|error| {
        error.downcast::<Refused>().map(|why| {
            complain(&why.to_string());
            WRONG
        })
    });
    let code = code.and_then(|code| output.flush().map(|()| code));
    match code {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            complain(&format!("{error:#}"));
            ExitCode::from(4)
        }
    }
}

/// Logs to stderr what `wanted`, the value of `RUST_LOG`, lets through.
fn log_to_stderr(wanted: Option<&str>) {
    let log = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    tracing_subscriber::registry().with(log.with_filter(log_filter(wanted))).init();
}

/// Returns the filter of `RUST_LOG`: levels, and levels of targets, as in
/// `warn,rubik_robot=debug`. Warnings and errors are logged where there is none or it cannot be
/// read.
///
/// `Targets` is taken instead of `EnvFilter`, which also knows spans and fields: that one brings an
/// engine for regular expressions, a tenth of what all packages cost in a fresh build.
fn log_filter(wanted: Option<&str>) -> Targets {
    let wanted = wanted.filter(|text| !text.trim().is_empty());
    let parsed = wanted.and_then(|text| text.parse().ok());
    parsed.unwrap_or_else(|| Targets::new().with_default(LevelFilter::WARN))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn log_filter_reads_levels_and_targets() {
        let lets_through = |wanted, target, level| log_filter(wanted).would_enable(target, &level);
        let (warn, debug, trace) =
            (tracing::Level::WARN, tracing::Level::DEBUG, tracing::Level::TRACE);

        for none in [None, Some(""), Some("rubik_robot=loud")] {
            assert!(lets_through(none, "rubik_robot::run", warn), "{none:?}");
            assert!(!lets_through(none, "rubik_robot::run", debug), "{none:?}");
        }
        assert!(lets_through(Some("debug"), "tokio", debug));
        let two = Some("warn,rubik_robot::truth=trace");
        assert!(lets_through(two, "rubik_robot::truth", trace));
        assert!(lets_through(two, "rubik_robot::run", warn));
        assert!(!lets_through(two, "rubik_robot::run", debug));
    }
}
