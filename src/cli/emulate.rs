//! `rubik-robot emulate`: emulates the robot of a scenario on serial lines, datagrams and sockets.
//!
//! - in: a scenario, transmission faults to inject
//! - out: a file of devices for `rubik-robot run`; at the end the true events and state of the
//!   simulated plant, as a table or as one line of JSON

use super::arguments::{ScenarioArgs, not_negative};
use super::catalogue;
use super::output::{Output, complain, inform, refuse, warn};
use crate::cell::Arm;
use crate::error::Error;
use crate::hw::emulator::{At, EmulatorOptions, LineFaults, SensorKind};
use crate::hw::text;
use crate::motion::AXES;
use crate::run::emulate::{Emulated, emulate};
use crate::run::exertion;
use crate::scenario::keys::{BridgeKind, Pace};
use crate::scenario::{Override, Scenario};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
#[command(after_help = "\
Start the emulator in one terminal and the run in another:
  rubik-robot emulate scenarios/hardware.toml
  rubik-robot run scenarios/hardware.toml

Examples:
  rubik-robot emulate scenarios/hardware.toml --set task=face_turn  # and the same for run
  rubik-robot emulate scenarios/hardware.toml --missed 0.001 --lost 0.05 --reordered 0.05
  rubik-robot emulate scenarios/hardware.toml --unplug track.3@20   # disconnect a line at 20 s

The emulator simulates the arms, cameras, force sensors and cube (the plant), in real time: all
times are by the wall clock. It prints to stderr how to start the run. It ends 3 s after the last
command of the controller, or by Ctrl-C, and prints what truly happened: forces, slips, the cube at
the end.

Keys of the object of --json:
  task, cube_start, cube_end (54 letters), solved, returned (to the person or the table)
  turned_deg           angle of the turned layer since both arms hold the cube
  peak_force_n, peak_torque_nm    largest contact while both arms hold the cube
  arm_peak_force_n, arm_peak_torque_nm, grasps    largest contact and number of grasps of each arm
  exertion             current_share, heat_share, motor_speed_rad_s, near_person_mm_s,
                       arms_apart_mm, as in `run --json`
  stuck (jams), slips, drops, pops, crushed, collisions, saturations (of force sensors),
  moved_after_stop (arms): numbers
  events               events in the order of time, each [time (s), words]
  time_s, periods      duration, in s and in periods of 2 ms
  stalled_periods      periods without processor time
  orders               commands to axes
Exit codes: 0 ended, 2 wrong usage or scenario, 3 an effector failed, 4 system error.")]
pub(super) struct EmulateArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Seed of the plant and of the transmission faults
    /// [default: that of the scenario]
    #[arg(long, value_name = "N", verbatim_doc_comment)]
    seed: Option<String>,
    /// State of the cube at the start: 54 letters, faces in the order
    /// U R F D L B, each in reading order
    /// [default: the scenario's, or drawn by the seed]
    #[arg(long, value_name = "FACELETS", verbatim_doc_comment)]
    cube: Option<String>,
    /// Write the list of emulated devices to FILE, from which `run` opens
    /// them [default: the scenario's bridge.devices, where `run` finds it]
    #[arg(long, value_name = "FILE", verbatim_doc_comment)]
    devices: Option<PathBuf>,
    /// Force sensors: net-ft (like an ATI Net F/T sensor, over UDP) or
    /// controller (like one with a controller box, over a serial line)
    #[arg(long, value_enum, default_value_t = SensorWord::NetFt, verbatim_doc_comment,
          hide_possible_values = true)]
    sensors: SensorWord,
    /// Share of axis answers that are not sent (0 to 1)
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = not_negative)]
    missed: f64,
    /// Share of axis answers with a wrong bit (0 to 1)
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = not_negative)]
    corrupt: f64,
    /// Share of lost force datagrams (0 to 1; net-ft only)
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = not_negative)]
    lost: f64,
    /// Share of force datagrams that are one late (0 to 1; net-ft only)
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = not_negative)]
    reordered: f64,
    /// Reset the controller of an axis S seconds after the first command,
    /// as in track.3@20: effector track, axis 3 (0: the track); repeatable
    #[arg(long, value_name = "AXIS@S", verbatim_doc_comment)]
    reset: Vec<String>,
    /// Disconnect the serial line of an axis S seconds after the first
    /// command, as in track.3@20; repeatable
    #[arg(long, value_name = "AXIS@S", verbatim_doc_comment)]
    unplug: Vec<String>,
    /// Silence the force sensor of an effector (arm with gripper) S seconds
    /// after the first command, as in track@20; repeatable
    #[arg(long, value_name = "EFFECTOR@S", verbatim_doc_comment)]
    silence: Vec<String>,
    /// Let each axis follow its last command for ever, as without a
    /// watchdog; otherwise it brakes after 50 ms without a command
    #[arg(long, verbatim_doc_comment)]
    no_watchdog: bool,
    /// Continue after the controller has left, until Ctrl-C
    #[arg(long)]
    stay: bool,
    /// End stdout with one line of JSON
    #[arg(long)]
    json: bool,
}

/// Kind of the emulated force sensors, as a word of the command line.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum SensorWord {
    /// Like an ATI Net F/T sensor: over UDP datagrams
    NetFt,
    /// Like a force sensor with a controller box: over a serial line
    Controller,
}

/// Time without a command of the controller after which the emulator ends (s).
const LEAVES: f64 = 3.0;

/// Emulates the cell until the controller has left, and prints what happened in it; returns the
/// exit code.
pub(super) fn run(args: &EmulateArgs, output: &mut Output) -> anyhow::Result<u8> {
    let mut more = Vec::new();
    if let Some(seed) = &args.seed {
        more.push(Override::option("--seed", "seed", seed));
    }
    if let Some(cube) = &args.cube {
        more.push(Override::option("--cube", "cube.state", cube));
    }
    let scenario = args.scenario.load(&more).map_err(refuse)?;
    let faults = faults(args, &scenario.controller.cell.arms).map_err(refuse)?;
    // The faults of the lines are drawn from the seed of the scenario: they repeat with the plant.
    let options = options(args, faults, scenario.seed);
    let devices =
        args.devices.clone().unwrap_or_else(|| scenario.bridge.devices_at(&scenario.path));
    // This is called once the devices exist: it tells the user how to start the run.
    let announce = |places: &crate::hw::devices::Devices, warnings: &[String]| {
        for warning in warnings {
            warn(&format!("not real time: {warning}; see `rubik-robot doctor`"));
        }
        // The fixed arm has no track: the path of that axis is empty.
        let lines: usize =
            places.effector.iter().map(|e| e.axes.iter().filter(|a| !a.is_empty()).count()).sum();
        inform(&format!(
            "{lines} axes, {} force sensors and {} cameras are ready: {}",
            places.effector.len(),
            places.camera.len(),
            devices.display()
        ));
        if !scenario.bridge.kind.is_hardware() {
            warn(
                "this scenario simulates its own plant, and its run connects to nothing: set \
                 bridge.kind = \"serial\" for the run, as below",
            );
        }
        inform(&format!("start the run in another terminal: {}", run_line(args, &scenario)));
    };
    match emulate(&scenario, options, &devices, announce) {
        Ok(done) => {
            if args.json {
                output.line(&json(&done, scenario.controller.cell.arms.len()).to_string())?;
            } else {
                output.text(&table(&done))?;
            }
            Ok(0)
        }
        Err(error) => {
            complain(&error.to_string());
            // As a run: an effector's error is fatal, any other is one of the system.
            Ok(if matches!(error, Error::Fatal { .. }) { 3 } else { 4 })
        }
    }
}

/// Returns the command that starts the run of the emulated robot: the options of this emulator that
/// the run needs as well, and those without which the run would not connect to it.
fn run_line(args: &EmulateArgs, scenario: &Scenario) -> String {
    let path = scenario.path.display().to_string();
    let mut words =
        vec![format!("{} run", catalogue::program().program), text::quoted(&path).into_owned()];
    let mut set = |option: &str| words.push(format!("--set {}", text::quoted(option)));
    args.scenario.set.iter().for_each(|option| set(option));
    // The last of two options for one key counts, so these come after the user's own.
    if scenario.bridge.kind != BridgeKind::Serial {
        set("bridge.kind=serial");
        if scenario.pace != Pace::RealTime {
            set("pace=real-time");
        }
        // Hardware accepts no other profile.
        set("control.profile=workshop");
    }
    if let Some(devices) = &args.devices {
        // The key is relative to the scenario's folder, the option to the working directory.
        let devices = std::path::absolute(devices).unwrap_or_else(|_| devices.clone());
        set(&format!("bridge.devices={}", devices.display()));
    }
    words.join(" ")
}

/// Returns the options of the emulator.
fn options(args: &EmulateArgs, faults: LineFaults, seed: u64) -> EmulatorOptions {
    EmulatorOptions {
        sensors: match args.sensors {
            SensorWord::NetFt => SensorKind::NetFt,
            SensorWord::Controller => SensorKind::Controller,
        },
        faults,
        seed,
        // Without `--stay` the emulator ends by itself, as scripts and tests need.
        ends_after: (!args.stay).then_some(LEAVES),
        no_watchdog: args.no_watchdog,
    }
}

/// Returns the transmission faults that the options ask for, or a message about the first wrong
/// option.
fn faults(args: &EmulateArgs, arms: &[Arm]) -> Result<LineFaults, String> {
    // clap checks only that the shares are numbers, not their range.
    for (option, share) in [
        ("missed", args.missed),
        ("corrupt", args.corrupt),
        ("lost", args.lost),
        ("reordered", args.reordered),
    ] {
        if !(0.0..=1.0).contains(&share) {
            return Err(format!("--{option} {share}: must be a share from 0 to 1"));
        }
    }
    let all = |option: &str, texts: &[String], with_axis: bool| {
        texts
            .iter()
            .map(|text| {
                at(text, arms, with_axis).map_err(|why| format!("--{option} {text}: {why}"))
            })
            .collect::<Result<Vec<At>, String>>()
    };
    Ok(LineFaults {
        missed: args.missed,
        corrupt: args.corrupt,
        lost: args.lost,
        reordered: args.reordered,
        resets: all("reset", &args.reset, true)?,
        unplugged: all("unplug", &args.unplug, true)?,
        silenced: all("silence", &args.silence, false)?,
        ..LineFaults::default()
    })
}

/// Parses effector, axis and time (s) of a fault: `track.3@20`, or `track@20` unless `with_axis`,
/// which gives axis 0. Returns a message if the text is wrong or the scenario has no such effector.
fn at(text: &str, arms: &[Arm], with_axis: bool) -> Result<At, String> {
    let example = if with_axis { "track.3@20" } else { "track@20" };
    let wrong = || format!("must be like {example}");
    let (place, time) = text.split_once('@').ok_or_else(wrong)?;
    let time: f64 = time.parse().map_err(|_| wrong())?;
    if !(0.0..f64::INFINITY).contains(&time) {
        return Err("the time must be a number of seconds, 0 or more".to_owned());
    }
    // A force sensor belongs to an effector, so its place has no axis.
    let (name, axis) = if with_axis {
        let (name, axis) = place.split_once('.').ok_or_else(wrong)?;
        (name, axis.parse().ok().filter(|axis| *axis <= AXES).ok_or_else(wrong)?)
    } else {
        (place, 0)
    };
    let effector = arms
        .iter()
        .position(|arm| arm.name == name)
        .ok_or_else(|| format!("the scenario has no effector \"{name}\""))?;
    Ok(At { effector, axis, time })
}

/// Returns the result as JSON; `arms` is the number of arms in the cell.
fn json(done: &Emulated, arms: usize) -> serde_json::Value {
    let v = &done.verdict;
    serde_json::json!({
        "task": done.task,
        "cube_start": done.start.to_string(),
        "cube_end": done.end.to_string(),
        "solved": done.end.is_solved(),
        "returned": v.is_back(),
        "turned_deg": v.turned.to_degrees(),
        "peak_force_n": v.peak_force,
        "peak_torque_nm": v.peak_torque,
        "arm_peak_force_n": v.arm_peak_force[..arms],
        "arm_peak_torque_nm": v.arm_peak_torque[..arms],
        "exertion": exertion(&v.exertion),
        "grasps": v.grasps[..arms],
        "stuck": v.counts.stuck,
        "slips": v.counts.slips,
        "drops": v.counts.drops,
        "pops": v.counts.pops,
        "crushed": v.counts.crushed,
        "collisions": v.counts.collisions,
        "saturations": v.counts.saturations,
        "moved_after_stop": v.counts.violations.moved_after_stop,
        "events": done.events.iter().map(|(time, _, words)| (time, words)).collect::<Vec<_>>(),
        "time_s": done.time,
        "periods": done.course.periods,
        "stalled_periods": done.course.stalled,
        "orders": done.course.orders,
    })
}

/// Returns the result as a table.
fn table(done: &Emulated) -> String {
    let v = &done.verdict;
    let c = &v.counts;
    let rows = [
        ("time", format!("{:.1} s, {} commands", done.time, done.course.orders)),
        ("stalled", format!("{} periods of 2 ms without processor time", done.course.stalled)),
        ("peak while both hold", format!("{:.1} N, {:.2} Nm", v.peak_force, v.peak_torque)),
        ("stuck, slips, drops", format!("{}, {}, {}", c.stuck, c.slips, c.drops)),
        ("pops, crushes, bumps", format!("{}, {}, {}", c.pops, c.crushed, c.collisions)),
        ("layer turned by", format!("{:.1} deg", v.turned.to_degrees())),
        ("cube at start", done.start.to_string()),
        ("cube at end", done.end.to_string()),
        (
            "verdict of the plant",
            format!(
                "the cube is {}, {}",
                if done.end.is_solved() { "solved" } else { "not solved" },
                v.place()
            ),
        ),
    ];
    // Accidents follow the table, each with its time.
    let accidents = done.events.iter().filter(|(_, is_accident, _)| *is_accident);
    let accidents = accidents.map(|(time, _, words)| ("", format!("{time:8.1} s: {words}")));
    let rows = rows.into_iter().chain(accidents);
    let lines: Vec<String> = rows.map(|(name, value)| format!("{name:<22} {value}")).collect();
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: EmulateArgs,
    }

    #[test]
    fn command_line_options_reach_the_emulator() {
        let options = |more: &[&str]| {
            let words = ["emulate", "cell.toml"].iter().chain(more);
            super::options(&Line::parse_from(words).args, LineFaults::default(), 7)
        };

        let usual = options(&[]);
        assert!(!usual.no_watchdog && usual.sensors == SensorKind::NetFt && usual.seed == 7);
        assert_eq!(usual.ends_after, Some(LEAVES));
        assert!(options(&["--no-watchdog"]).no_watchdog);
        assert_eq!(options(&["--stay"]).ends_after, None);
        assert_eq!(options(&["--sensors", "controller"]).sensors, SensorKind::Controller);
    }

    /// A user can type the printed line as it is: it repeats the emulator's options and adds those
    /// with which the run connects to the emulated devices.
    #[test]
    fn run_line_repeats_options_and_connects() {
        let line = |text: &str, more: &[&str]| {
            let scenario =
                crate::tasks::read(std::path::Path::new("a cell.toml"), text, &[]).unwrap();
            let words = ["emulate", "a cell.toml"].iter().chain(more);
            run_line(&Line::parse_from(words).args, &scenario)
        };
        let serial = "task = \"solve\"\npace = \"real-time\"\n[bridge]\nkind = \"serial\"\n";
        let plant = "task = \"solve\"\n";

        let more = ["--set", "task=face_turn", "--set", "cube.state=\"U\"", "--devices", "/d d"];
        assert_eq!(line(serial, &[]), "rubik-robot run 'a cell.toml'");
        assert_eq!(
            line(serial, &more),
            "rubik-robot run 'a cell.toml' --set task=face_turn --set 'cube.state=\"U\"' \
             --set 'bridge.devices=/d d'"
        );
        let connects = line(plant, &[]);
        assert_eq!(
            connects,
            "rubik-robot run 'a cell.toml' --set bridge.kind=serial --set pace=real-time \
             --set control.profile=workshop"
        );
        let overrides: Vec<_> = connects
            .split(" --set ")
            .skip(1)
            .map(|option| Override::parse(option).unwrap())
            .collect();
        for text in [plant, include_str!("../../scenarios/solve.toml")] {
            let read = crate::tasks::read(std::path::Path::new("a"), text, &overrides);
            assert!(read.is_ok_and(|scenario| scenario.bridge.kind.is_hardware()), "{text}");
        }
    }

    #[test]
    fn fault_argument_names_arm_axis_and_time() {
        let arms =
            crate::tasks::read(std::path::Path::new("a"), "", &[]).unwrap().controller.cell.arms;

        assert_eq!(at("track.3@20", &arms, true), Ok(At { effector: 0, axis: 3, time: 20.0 }));
        assert_eq!(at("postument.7@0.5", &arms, true), Ok(At { effector: 1, axis: 7, time: 0.5 }));
        assert_eq!(at("track.3@0", &arms, true), Ok(At { effector: 0, axis: 3, time: 0.0 }));
        assert_eq!(at("postument@4", &arms, false), Ok(At { effector: 1, axis: 0, time: 4.0 }));
        for wrong in ["track.8@1", "track@1", "track.3", "left.3@1", "track.3@soon"] {
            assert!(at(wrong, &arms, true).is_err(), "{wrong}");
        }
        for time in ["-1", "NaN", "inf", "1e400"] {
            let why = at(&format!("track.3@{time}"), &arms, true).unwrap_err();
            assert!(why.contains("0 or more"), "{time}: {why}");
        }
    }
}
