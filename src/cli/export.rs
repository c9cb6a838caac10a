//! `rubik-robot export`: writes a recorded run as a table, for spreadsheets and scripts.
//!
//! - in: a recording
//! - out: CSV on stdout: the servo ticks of all arms, or the events of the run

use super::output::{Output, refuse, warn};
use crate::hw::text;
use crate::record::reading::{End, Label, Message, Piece, Reading};
use crate::record::report::{Story, gather};
use crate::record::tick::Tick;
use clap::{Args, ValueEnum};
use std::fmt::Write as _;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Head of the table of servo ticks.
const TICKS: &str = "time_s,arm,period,\
    joint0_m,joint1_rad,joint2_rad,joint3_rad,joint4_rad,joint5_rad,joint6_rad,\
    set0_m,set1_rad,set2_rad,set3_rad,set4_rad,set5_rad,set6_rad,\
    force_x_n,force_y_n,force_z_n,torque_x_nm,torque_y_nm,torque_z_nm,jaw_mm,grip_n";
/// Head of the table of events.
const EVENTS: &str = "time_s,kind,text";

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot export run.mcap > ticks.csv
  rubik-robot export run.mcap --every 20 --from 60 --to 70
  rubik-robot export run.mcap --table events

Columns of ticks: time_s (since the first message), arm, number of the servo period, measured and
set joints (joint 0 is the track), wrench that the tool exerts on its surroundings, in its own
axes, distance between the pads, force of the jaws.
Kinds of events: phase, holder (of the cube), plan (number of steps), operator, message (notes,
warnings and errors).
Exit codes: 0 printed, 2 wrong usage, or the recording cannot be used.")]
pub(super) struct ExportArgs {
    /// Recording of `run --record` (MCAP)
    recording: PathBuf,
    /// Table: ticks (of the servos) or events
    #[arg(long, value_enum, default_value = "ticks", hide_possible_values = true)]
    table: Table,
    /// Least time between two ticks of an arm (ms); 0: all ticks
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    every: f64,
    /// Beginning of the table (s)
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    from: f64,
    /// End of the table (s) [default: the end of the recording]
    #[arg(long, value_name = "S", default_value_t = f64::INFINITY, hide_default_value = true)]
    to: f64,
}

/// Table of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Table {
    Ticks,
    Events,
}

/// Prints a table of the recording; returns the exit code.
pub(super) fn run(args: &ExportArgs, output: &mut Output) -> anyhow::Result<u8> {
    let unread = |why: String| refuse(format!("{}: {why}", args.recording.display()));
    if !(args.every >= 0.0 && args.from >= 0.0 && args.to >= args.from) {
        return Err(refuse("--every, --from and --to: must be times of 0 or more, in order"));
    }
    let file = BufReader::with_capacity(1 << 20, text::open_any(&args.recording).map_err(refuse)?);
    match args.table {
        Table::Events => {
            let story = gather(file).map_err(|why| unread(why.to_string()))?;
            output.line(EVENTS)?;
            report_damage(&args.recording, story.file_end.as_ref());
            let within = |time: &f64| (args.from..=args.to).contains(time);
            for (time, kind, words) in events(&story).into_iter().filter(|(time, ..)| within(time))
            {
                output.line(&format!("{time:.3},{kind},{}", quoted(&words)))?;
            }
        }
        Table::Ticks => {
            let done = ticks(args, file, output)?;
            done.map_err(unread)?;
        }
    }
    Ok(0)
}

/// Prints the table of servo ticks. The inner error says why the recording cannot be used.
fn ticks(
    args: &ExportArgs,
    file: BufReader<File>,
    output: &mut Output,
) -> anyhow::Result<Result<(), String>> {
    let mut label = Label::default();
    let mut names: Vec<String> = Vec::new();
    // Time of the next tick of each arm that belongs into the table (s).
    let mut due: Vec<f64> = Vec::new();
    // Start of the recording (ns), and length of a servo period (s).
    let (mut start, mut period) = (None, 0.0);
    let mut reading = Reading::seekable(file);
    for piece in reading.by_ref() {
        label.take(&piece);
        let Piece::Message(Message { channel, time, data }) = piece else { continue };
        let time = time.saturating_sub(*start.get_or_insert(time)) as f64 * 1e-9;
        if !channel.topic.ends_with("/servo") || time < args.from {
            continue;
        }
        if time > args.to {
            break;
        }
        if names.is_empty() {
            names = label.fact("arms").split_whitespace().map(str::to_owned).collect();
            due = vec![args.from; names.len()];
            period = label.fact("period_ns").parse().unwrap_or(0.0) * 1e-9;
            output.line(TICKS)?;
        }
        let tick = match Tick::read(&data) {
            Ok(tick) => tick,
            Err(why) => return Ok(Err(format!("{}: {why}", channel.topic))),
        };
        let arm = usize::from(tick.arm);
        let (Some(name), Some(next)) = (names.get(arm), due.get_mut(arm)) else { continue };
        // Half a period of grace, since times are multiples of a period up to rounding.
        if time + 0.5 * period < *next {
            continue;
        }
        *next = time + args.every * 1e-3;
        output.line(&row(time, name, &tick))?;
    }
    if names.is_empty() {
        return Ok(Err("the recording has no servo ticks in this time".to_owned()));
    }
    report_damage(&args.recording, reading.end());
    Ok(Ok(()))
}

/// Warns that a table covers only the part of a damaged recording that can be read.
fn report_damage(recording: &Path, end: Option<&End>) {
    if let Some(flaw) = end.and_then(End::flaw) {
        let path = recording.display();
        warn(&format!("{path}: {flaw}; the table covers the part that could be read"));
    }
}

/// Returns the row of a servo tick.
fn row(time: f64, arm: &str, tick: &Tick) -> String {
    let mut row = format!("{time:.3},{},{}", quoted(arm), tick.period);
    let wrench = tick.wrench_in_tool.force.iter().chain(tick.wrench_in_tool.torque.iter());
    let jaws = [tick.jaw_opening * 1e3, tick.jaw_force];
    let joints = tick.joints.iter().chain(&tick.desired_joints);
    for value in joints {
        // Writing to a string cannot fail.
        let _ = write!(row, ",{value:.6}");
    }
    for value in wrench.chain(&jaws) {
        let _ = write!(row, ",{value:.4}");
    }
    row
}

/// Returns the events of a run in the order of their times: time (s), kind, text.
fn events(story: &Story) -> Vec<(f64, &'static str, String)> {
    let holder = |names: &Vec<String>| match names.as_slice() {
        [] => "no hand".to_owned(),
        names => names.join(" and "),
    };
    let phases = story.phases.iter().map(|(time, name)| (*time, "phase", name.clone()));
    let holders = story.holders.iter().map(|(time, names)| (*time, "holder", holder(names)));
    let plans = story.plans.iter().map(|(time, steps)| (*time, "plan", steps.len().to_string()));
    let operator = story.operator.iter().map(|(time, what)| (*time, "operator", what.clone()));
    let messages = story
        .messages
        .iter()
        .map(|(time, class, who, what)| (*time, "message", format!("{class:?} {who}: {what}")));
    let mut all: Vec<_> =
        phases.chain(holders).chain(plans).chain(operator).chain(messages).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all
}

/// Returns a text as a field of CSV: in quotation marks if it needs them (RFC 4180).
fn quoted(text: &str) -> String {
    if !text.contains([',', '"', '\n', '\r']) {
        return text.to_owned();
    }
    format!("\"{}\"", text.replace('"', "\"\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_with_marks_are_quoted() {
        assert_eq!(quoted("track"), "track");
        assert_eq!(quoted("a, \"b\"\nc"), "\"a, \"\"b\"\"\nc\"");
    }

    #[test]
    fn events_are_in_order_of_time() {
        let story = Story {
            phases: vec![(0.0, "acquire".into()), (9.0, "end".into())],
            holders: vec![(3.0, vec!["track".into()]), (4.0, Vec::new())],
            ..Story::default()
        };

        let texts: Vec<_> = events(&story).into_iter().map(|(_, _, words)| words).collect();

        assert_eq!(texts, ["acquire", "track", "no hand", "end"]);
    }
}
