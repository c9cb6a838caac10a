//! Command line of the program: the one place with units of the workshop (mm, deg, ms).
//!
//! - in: arguments, files, and rows or cubes on stdin
//! - out: text or lines of JSON on stdout; warnings, errors and progress on stderr
//! - exit codes: 0 done; 1 the task failed or was aborted; 2 wrong usage or scenario; 3 an effector
//!   failed; 4 system error; 130 interrupted by a signal

mod arguments;
mod benchmark;
mod calibrate;
mod campaign;
mod campaign_report;
mod catalogue;
mod check;
mod cube_lines;
pub mod cubes;
mod doctor;
mod emulate;
mod engine;
pub mod evaluate;
mod export;
mod faces;
mod film;
mod fit;
mod frames;
mod help;
mod keys;
mod kinematics;
mod live;
mod locate;
mod log;
mod merge;
mod merge_nodes;
mod mix;
mod node;
mod output;
mod parameters;
mod picture;
mod plan;
mod progress;
mod record;
mod recover;
mod reliability;
mod replay;
mod report;
mod rig;
mod ros;
mod run;
mod scenarios;
mod schema;
mod shards;
mod shell;
mod solve;
mod stages;
mod status;
mod stop;
mod tables;
mod ticker;
mod ui;
mod urdf;
mod usage;
mod vision;
mod weigh;

use crate::hw::console;
use crate::hw::image_file;
use crate::scenario::catalogue::Catalogue;
use crate::scenario::maker::Maker;
use arguments::ScenarioArgs;
use clap::{CommandFactory, FromArgMatches as _, Parser, Subcommand};
use output::{Output, Refused, WRONG, complain};
use std::process::ExitCode;

/// End of the program's help.
const HELP: &str = "\
Try these commands, in this order:
  rubik-robot run                                         # the scenarios
  rubik-robot run scenarios/solve.toml                    # the whole mission
  rubik-robot run scenarios/solve.toml --seed 7           # another cube, hand and noise
  rubik-robot run scenarios/face_turn.toml --set control.compliance=none
                                                          # one turn without force control
  rubik-robot run scenarios/solve.toml --json | tail -1   # the summary for a program
  rubik-robot campaign scenarios/solve.toml --runs 20     # the share of missions that succeed
  rubik-robot check scenarios/solve.toml                  # the errors of a scenario
  rubik-robot keys control                                # keys with unit, default and meaning
  echo 0,-1.57,0,1.56,1.57,-1.57 | rubik-robot kinematics fk --arm postument
                                                          # the pose of a hand, from its joints
  rubik-robot vision face photo.jpg                       # the faces of a cube in a photograph
  rubik-robot solve --scramble \"R U2 F' L\"                # turns that solve a cube
  rubik-robot tables build                                # larger tables, for shorter solutions
  rubik-robot picture scenarios/solve.toml                # the cell as cell.png
  rubik-robot doctor                                      # is this machine fit for real time?
  rubik-robot help run                                    # options and examples of a command

A scenario is a file that describes the cell and the task. The plant is the simulated cell. An
effector is an arm with its gripper; the built-in cell has two, track and postument. A cube is 54
letters, nine for each of the faces U R F D L B, in this order and each in reading order: row by row
from the top, each row from the left. A letter names the face whose centre has the colour.
Exit codes: 0 done, 1 the task failed or was aborted, 2 wrong usage or scenario, 3 an effector
failed, 4 system error, 130 interrupted by a signal.
The environment variable RUST_LOG=rubik_robot=debug makes a run log its inner steps to stderr.";

/// A robot with two arms that takes, reads, solves and returns a Rubik's cube, in a simulated cell
#[derive(Debug, Parser)]
#[command(name = "rubik-robot", version, after_help = HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Subcommand)]
enum Command {
    /// Run a scenario and print its summary
    Run(run::RunArgs),
    /// Run a scenario with many seeds and report how often it succeeds
    Campaign(campaign::CampaignArgs),
    /// Measure accuracy and speed in a series of trials and write a report in Markdown
    Benchmark(benchmark::BenchmarkArgs),
    /// Emulate the robot of a scenario on serial lines, datagrams and sockets
    Emulate(emulate::EmulateArgs),
    /// Run the actors of another node of a scenario, at the order of the node that has MP
    Node(node::NodeArgs),
    /// Measure the weight of a tool, its centre of mass and the bias of the force sensor
    Weigh(weigh::WeighArgs),
    /// Check a scenario without running it and list its errors
    #[command(after_help = "\
Examples:
  rubik-robot check scenarios/solve.toml
  rubik-robot check scenarios/solve.toml --set control.grip_n=5
  rubik-robot check scenarios/solve.toml --set 'effector.track.tool_xyz_mm=[0,0,260]'

A valid scenario gets one line: task, coordination, effectors, numbers of cameras and sensors, seed.
Otherwise the first ten errors go to stderr, those of the file with its line and column, and the
number of the others. Devices of hardware are not examined: `rubik-robot doctor` does that.
Exit codes: 0 the scenario is valid, 2 it has an error or cannot be read.")]
    Check(ScenarioArgs),
    /// List the keys of scenarios with unit, default, range and meaning
    #[command(after_help = "\
Examples:
  rubik-robot keys                 # all keys
  rubik-robot keys plant.errors    # the keys of a section
  rubik-robot keys grip            # the keys with a word in their name

Each key has two lines: its name and default; its meaning, and in parentheses type and range. The
name ends with the unit, if there is one: grip_n (N), edge_mm (mm), period_ms (ms).
Exit codes: 0 listed, 2 no key has the word in its name.")]
    Keys {
        /// Part of a key's name, in lower case [default: all keys]
        word: Option<String>,
        /// Print a chapter in Markdown
        #[arg(long)]
        markdown: bool,
    },
    /// List the parameters that the operator may change while a run of a scenario goes on
    #[command(after_help = "\
Examples:
  rubik-robot parameters scenarios/solve.toml
  rubik-robot parameters scenarios/solve.toml --set control.profile=workshop

Each parameter has two lines: its name and its value at the beginning of a run; its meaning, and in
parentheses the scenario's key of this value, the bounds of an order, and the greatest rate at which
the value changes. The bounds are narrower where the scenario's checks require it.
Exit codes: 0 listed, 2 the scenario has an error or cannot be read.")]
    Parameters(ScenarioArgs),
    /// Compute the kinematics of an arm for rows of numbers on stdin
    #[command(after_help = "\
Rows are CSV; angles are in rad, lengths in m. Joint positions are q1 to q6, and for an arm on a
track its position d0 (m) before them. Each row gets one line of JSON; empty rows and those that
begin with # get none.
  fk      row: joint positions
          keys: base_from_flange, base_from_tool (poses of flange and tool in the frame of the
          base, each the upper three rows of a 4 x 4 matrix), limits
  ik      row: the 12 numbers of the pose base_from_tool, row by row, then the current joint
          positions
          keys: joints (joint positions near the current ones), limits
  motors  row: joint positions
          keys: motors (motor positions in rad, in the order of the joints), limits
limits lists the limits of joints and motors that the answer exceeds, in words. The only key of the
answer to a wrong row, or to a pose out of reach, is error.

Examples:
  echo 0,-1.57,0,1.56,1.57,-1.57 | rubik-robot kinematics fk --arm postument
  echo 0.2,0,-1.57,0,1.56,1.57,-1.57 | rubik-robot kinematics motors --arm track
  rubik-robot kinematics ik --arm postument < rows.csv

Exit codes: 0 all rows are answered, some perhaps by an error, 2 wrong usage or scenario.")]
    Kinematics(kinematics::KinematicsArgs),
    /// Solve cubes in few face turns, or in the fewest
    #[command(after_help = "\
Examples:
  rubik-robot solve --scramble \"R U2 M' y Fw\"
  rubik-robot solve DRLUUBFBRBLURRLRUBLRDDFDLFUFUFFDBRDUBRUFLLFDDBFLUBLRBD
  rubik-robot solve --mode first --json - < cubes.txt
  rubik-robot solve --max-length 20 --scramble \"R U R' U'\"
  rubik-robot solve --budget-ms 1000 --threads 2 --scramble \"R U F2 D' L B\"
  rubik-robot scramble --count 5 --facelets | rubik-robot solve -

Modes of the search:
  first      first solution of the two-phase search
  two-phase  shortest solution of the two-phase search within the budget
  korf       proven shortest solution, by Korf's pattern databases: slow from 17 turns on
  optimal    proven shortest solution, by one large table
  robot      solution that takes the two arms the least time, among many of the two-phase search

A cube is answered by the turns of its solution, their number (a half turn counts one), and the
states searched; a cube of stdin by a line of turns and (number), in the order of the cubes. A cube
without an answer gets the reason, and the smallest repair if it cannot exist.

Keys of an answer with --json: cube (54 letters), solution (turns), length (their number), optimal
(proven to be a shortest solution), nodes (states searched), time_s (by the wall clock); without a
solution: cube (as given), error (kind, message, where, and repair if there is one).
Exit codes, the largest of all cubes: 0 solved, 1 no solution was found within the limits, 2 wrong
usage, or a cube was refused.")]
    Solve(solve::SolveArgs),
    /// Plan the grasps and turns of both arms for a cube
    #[command(after_help = "\
Examples:
  rubik-robot plan --explain DRLUUBFBRBLURRLRUBLRDDFDLFUFUFFDBRDUBRUFLLFDDBFLUBLRBD
  rubik-robot plan DRLUUBFBRBLURRLRUBLRDDFDLFUFUFFDBRDUBRUFLLFDDBFLUBLRBD --rule strict --json
  rubik-robot scramble --seed 7 --facelets | xargs rubik-robot plan --explain

The plan is for the reach, speeds and grippers of the cell. A grasp closes the jaws of a hand (a
gripper) on the cube; a hand-over is a grasp that no turn follows. Rules of the planner:
  original   rule of the original robot (2007): two grasps for each turn, four if the face is
             opposite to that of the turn before
  strict     palms touch the cube: only hands on opposite faces can turn a layer
  clearance  palms keep a distance from the cube: hands on adjacent faces can turn a layer as well

The command prints turns, grasps, hand-overs and expected robot time of the plan and, for
comparison, of the shortest solution by the rule original; then the turns of the plan.

Keys of the object of --json:
  cube, rule, solution (turns), turns, grasps, hand_overs (numbers), robot_time_s (expected)
  steps        what the hands do, why, and seconds (expected), for each step
  identification_hand_overs   hand-overs that reading the faces takes before the plan
  time_s       computing time by the wall clock (s)
  baseline     solution, turns, grasps, hand_overs, robot_time_s of the comparison; or error
  error        for a cube that is refused: kind, message, where, repair, as with `solve --json`
Exit codes: 0 planned, 1 there is no plan (nothing on stdout), 2 wrong usage or scenario, or the
cube was refused.")]
    Plan(plan::PlanArgs),
    /// Draw random cubes, all equally likely, and print the turns that produce them
    #[command(after_help = "\
Examples:
  rubik-robot scramble
  rubik-robot scramble --seed 7 --json
  rubik-robot scramble --count 1000 --seed 1 --facelets > cubes.txt

Without --facelets a line has the turns that make the cube from a solved one, as in R U2 F'.
Keys of a line of --json: cube (54 letters), scramble (turns), length (their number), seed.
Exit codes: 0 printed, 2 wrong usage.")]
    Scramble(solve::ScrambleArgs),
    /// Build, list, verify and remove the tables of the solver
    #[command(after_help = "\
Examples:
  rubik-robot tables build            # all tables
  rubik-robot tables list
  rubik-robot tables verify
  rubik-robot tables remove phase1-large
  RUBIK_ROBOT_TABLES=/data/tables rubik-robot tables build

`rubik-robot solve` builds the tables that its mode needs by itself, except phase1-large and
phase2-large: only `tables build` builds these. They make two-phase search faster.
A line has the name of a table, its size, its state and its purpose.
Keys of a line of --json: name, bytes (size), ok (whether the action succeeded), state, purpose,
path (file of the table).
Exit codes: 0 done, 1 the action failed for a table, 2 wrong usage.")]
    Tables(tables::TablesArgs),
    /// Find cubes in pictures, read their colours, and measure the accuracy
    Vision(vision::VisionArgs),
    /// Check whether this machine can run a real-time servo, and print what to change
    Doctor(doctor::DoctorArgs),
    /// Calibrate the cameras of a scenario in the simulated cell
    Calibrate(calibrate::CalibrateArgs),
    /// Replay a recording, or verify that the controller reproduces it
    Replay(replay::ReplayArgs),
    /// Write a report of a recorded run as an HTML page
    Report(report::ReportArgs),
    /// Print the servo ticks or the events of a recording as CSV
    Export(export::ExportArgs),
    /// Make an animated GIF of a recorded mission
    Film(film::FilmArgs),
    /// Repair a recording that was cut off or damaged
    Recover(recover::RecoverArgs),
    /// Make one recording of those of all nodes of a run on several hosts
    Merge(merge_nodes::MergeArgs),
    /// Print the cell, or one arm, as URDF (the robot description of ROS)
    Urdf(urdf::UrdfArgs),
    /// Print the JSON schema of scenarios, for editors
    #[command(after_help = "\
Examples:
  rubik-robot schema > scenario.schema.json
  rubik-robot schema | less

An editor with a TOML language server (taplo, Even Better TOML) checks and completes the keys of a
scenario whose first line is
  #:schema ./scenario.schema.json
Exit code: 0.")]
    Schema,
    /// Print a script with which a shell completes commands and options
    #[command(after_help = "\
Examples:
  rubik-robot completions bash > ~/.local/share/bash-completion/completions/rubik-robot
  rubik-robot completions fish > ~/.config/fish/completions/rubik-robot.fish

Exit codes: 0 printed, 2 wrong usage.")]
    Completions {
        /// Name of the shell
        shell: clap_complete::Shell,
    },
    /// Print the manual page of the program, or of a command
    #[command(after_help = "\
Examples:
  rubik-robot man > rubik-robot.1
  rubik-robot man run | man -l -

The page is text for troff. That of a command with subcommands lists these.
Exit codes: 0 printed, 2 there is no such command.")]
    Man {
        /// Name of a command, not of a subcommand [default: the program]
        command: Option<String>,
    },
    /// Draw the cell of a scenario, or the view of one of its cameras
    Picture(picture::PictureArgs),
}

/// Returns the command line of this process: its helps name the program that [`main`] was given.
fn command() -> clap::Command {
    let Maker { program, version, .. } = catalogue::program();
    help::named(help::with_groups(Cli::command()), &program, &version)
}

/// Runs the command of the arguments, with the tasks in `catalogue`, and returns its exit code.
#[must_use]
pub fn main(catalogue: Catalogue) -> ExitCode {
    catalogue::set(catalogue);
    console::speak_as(&catalogue::program().program);
    let parsed = command().try_get_matches();
    let parsed = parsed.and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(message) => return usage::answer(message, &command()),
    };
    log::start(std::env::var("RUST_LOG").ok().as_deref());
    let mut output = Output::stdout();
    let done = match cli.command {
        Command::Run(args) => run::run(&args, &mut output),
        Command::Campaign(args) => campaign::run(&args, &mut output),
        Command::Benchmark(args) => benchmark::run(&args, &mut output),
        Command::Emulate(args) => emulate::run(&args, &mut output),
        Command::Node(args) => node::run(&args, &mut output),
        Command::Weigh(args) => weigh::run(&args, &mut output),
        Command::Check(args) => check::run(&args, &mut output),
        Command::Keys { word, markdown } => keys::run(word.as_deref(), markdown, &mut output),
        Command::Parameters(args) => parameters::run(&args, &mut output),
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
        Command::Export(args) => export::run(&args, &mut output),
        Command::Film(args) => film::run(&args, &mut output),
        Command::Recover(args) => recover::run(&args),
        Command::Merge(args) => merge_nodes::run(&args),
        Command::Urdf(args) => urdf::run(&args, &mut output),
        Command::Schema => schema::run(&mut output),
        Command::Completions { shell } => shell::completions(shell, &mut command(), &mut output),
        Command::Man { command: name } => shell::manual(name.as_deref(), command(), &mut output),
    };
    // A refused call has an exit code of its own; any other error is one of the system.
    let code = done.or_else(|error| {
        error.downcast::<Refused>().map(|why| {
            complain(&why.to_string());
            WRONG
        })
    });
    // Results that cannot be written are an error, also of a command that succeeded.
    let code = code.and_then(|code| output.flush().map(|()| code));
    match code {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            complain(&format!("{error:#}"));
            ExitCode::from(4)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clap_accepts_the_command_line_definition() {
        Cli::command().debug_assert();
    }
}
