//! `rubik-robot emulate`: the cell of a scenario behind serial lines and sockets, as a robot would stand there.

use super::arguments::ScenarioArgs;
use super::output::{Output, complain, refuse};
use crate::cell::Arm;
use crate::error::Error;
use crate::hw::emulator::{At, EmulatorOptions, LineFaults, SensorKind};
use crate::motion::AXES;
use crate::run::emulate::{Emulated, emulate};
use crate::run::exertion;
use crate::scenario::Override;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
#[command(after_help = "\
In one terminal:   rubik-robot emulate scenarios/hardware.toml
in another:        rubik-robot run scenarios/hardware.toml
Examples:
  rubik-robot emulate scenarios/hardware.toml --set task=face_turn      (and the same for run)
  rubik-robot emulate scenarios/hardware.toml --missed 0.001 --corrupt 0.0001 --lost 0.05 --reordered 0.05
  rubik-robot emulate scenarios/hardware.toml --unplug track.3@20       pulls a line out after 20 s
It ends 3 s after the controller's last word, or by Ctrl-C, and then prints what really happened.")]
pub(super) struct EmulateArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Seed of everything random in the plant and on the lines
    #[arg(long, value_name = "N")]
    seed: Option<String>,
    /// The cube's state: 54 letters URFDLB, each face in reading order
    #[arg(long, value_name = "FACELETS")]
    cube: Option<String>,
    /// File that tells `run` where everything is; default: the scenario's bridge.devices, or where `run` looks
    /// without one
    #[arg(long, value_name = "FILE")]
    devices: Option<PathBuf>,
    /// Interface of the force sensors
    #[arg(long, value_enum, default_value_t = SensorWord::NetFt)]
    sensors: SensorWord,
    /// Share of the axes' answers that never come
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    missed: f64,
    /// Share of the axes' answers with a wrong bit
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    corrupt: f64,
    /// Share of the force datagrams that are lost
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    lost: f64,
    /// Share of the force datagrams that come after their successor
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    reordered: f64,
    /// Reset an axis controller at a time since the first order, as in track.3@20; repeatable
    #[arg(long, value_name = "EFFECTOR.AXIS@S")]
    reset: Vec<String>,
    /// Pull a line out; repeatable
    #[arg(long, value_name = "EFFECTOR.AXIS@S")]
    unplug: Vec<String>,
    /// Silence a force sensor; repeatable
    #[arg(long, value_name = "EFFECTOR@S")]
    silence: Vec<String>,
    /// Axis controllers that follow their last order for ever, instead of braking after 50 ms without one: what an arm
    /// does after a controller was killed that no watchdog looks after
    #[arg(long)]
    no_watchdog: bool,
    /// Go on after the controller has left, until Ctrl-C
    #[arg(long)]
    stay: bool,
    /// End stdout with one line of JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum SensorWord {
    /// ATI Net F/T: datagrams
    NetFt,
    /// The stand-alone controller: a serial line
    Controller,
}

/// Seconds after the last order until it ends.
const LEAVES: f64 = 3.0;

/// Returns the exit code.
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
    let options = options(args, faults, scenario.seed);
    let devices =
        args.devices.clone().unwrap_or_else(|| scenario.bridge.devices_at(&scenario.path));
    let announce = |places: &crate::hw::devices::Devices, warnings: &[String]| {
        for warning in warnings {
            complain(&format!("not real time: {warning}"));
        }
        let lines: usize =
            places.effector.iter().map(|e| e.axes.iter().filter(|a| !a.is_empty()).count()).sum();
        complain(&format!(
            "{lines} axes, {} force sensors and {} cameras are there: {}",
            places.effector.len(),
            places.camera.len(),
            devices.display()
        ));
        complain(&format!("now, elsewhere: rubik-robot run {}", scenario.path.display()));
    };
    match emulate(&scenario, options, &devices, announce) {
        Ok(done) => {
            if args.json {
                output.line(&json(&done).to_string())?;
            } else {
                output.text(&table(&done))?;
            }
            Ok(0)
        }
        Err(error) => {
            complain(&error.to_string());
            Ok(if matches!(error, Error::Fatal { .. }) { 3 } else { 4 })
        }
    }
}

fn options(args: &EmulateArgs, faults: LineFaults, seed: u64) -> EmulatorOptions {
    EmulatorOptions {
        sensors: match args.sensors {
            SensorWord::NetFt => SensorKind::NetFt,
            SensorWord::Controller => SensorKind::Controller,
        },
        faults,
        seed,
        leaves_after: (!args.stay).then_some(LEAVES),
        no_watchdog: args.no_watchdog,
    }
}

fn faults(args: &EmulateArgs, arms: &[Arm]) -> Result<LineFaults, String> {
    for (option, share) in [
        ("missed", args.missed),
        ("corrupt", args.corrupt),
        ("lost", args.lost),
        ("reordered", args.reordered),
    ] {
        if !(0.0..=1.0).contains(&share) {
            return Err(format!("--{option} {share}: a share is 0..1"));
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

/// `track.3@20`, or without the axis.
fn at(text: &str, arms: &[Arm], with_axis: bool) -> Result<At, String> {
    let example = if with_axis { "track.3@20" } else { "track@20" };
    let wrong = || format!("wanted something like {example}");
    let (place, time) = text.split_once('@').ok_or_else(wrong)?;
    let time: f64 = time.parse().map_err(|_| wrong())?;
    if !(0.0..f64::INFINITY).contains(&time) {
        return Err("a time is a number of seconds, 0 or more".to_owned());
    }
    let (name, axis) = if with_axis {
        let (name, axis) = place.split_once('.').ok_or_else(wrong)?;
        (name, axis.parse().ok().filter(|axis| *axis <= AXES).ok_or_else(wrong)?)
    } else {
        (place, 0)
    };
    let effector = arms
        .iter()
        .position(|arm| arm.name == name)
        .ok_or_else(|| format!("there is no effector \"{name}\""))?;
    Ok(At { effector, axis, time })
}

fn json(done: &Emulated) -> serde_json::Value {
    let v = &done.verdict;
    serde_json::json!({
        "task": done.task.word(),
        "cube_start": done.start.to_string(),
        "cube_end": done.end.to_string(),
        "solved": done.end.is_solved(),
        "returned": v.is_back(),
        "turned_deg": v.turned.to_degrees(),
        "peak_force_n": v.peak_force,
        "peak_torque_nm": v.peak_torque,
        "arm_peak_force_n": v.arm_peak_force,
        "arm_peak_torque_nm": v.arm_peak_torque,
        "exertion": exertion(&v.exertion),
        "grasps": v.grasps,
        "stuck": v.counts.stuck,
        "slips": v.counts.slips,
        "drops": v.counts.drops,
        "pops": v.counts.pops,
        "crushed": v.counts.crushed,
        "collisions": v.counts.collisions,
        "saturations": v.counts.saturations,
        "events": done.told.iter().map(|(time, _, words)| (time, words)).collect::<Vec<_>>(),
        "time_s": done.time,
        "periods": done.course.periods,
        "stalled_periods": done.course.stalled,
        "orders": done.course.orders,
    })
}

fn table(done: &Emulated) -> String {
    let v = &done.verdict;
    let c = &v.counts;
    let rows = [
        ("time", format!("{:.1} s, {} orders", done.time, done.course.orders)),
        (
            "stood still",
            format!("{} periods of 2 ms, for want of the processor", done.course.stalled),
        ),
        ("peak while both hold", format!("{:.1} N, {:.2} Nm", v.peak_force, v.peak_torque)),
        ("stuck, slips, drops", format!("{}, {}, {}", c.stuck, c.slips, c.drops)),
        ("pops, crushes, bumps", format!("{}, {}, {}", c.pops, c.crushed, c.collisions)),
        ("layer turned by", format!("{:.1} deg", v.turned.to_degrees())),
        ("cube at start", done.start.to_string()),
        ("cube at end", done.end.to_string()),
        (
            "in truth",
            format!(
                "the cube is {}, {}",
                if done.end.is_solved() { "solved" } else { "not solved" },
                v.place()
            ),
        ),
    ];
    let accidents = done.told.iter().filter(|(_, is_accident, _)| *is_accident);
    let accidents = accidents.map(|(time, _, words)| ("", format!("{time:8.1} s: {words}")));
    let rows = rows.into_iter().chain(accidents);
    let lines: Vec<String> = rows.map(|(name, value)| format!("{name:<22} {value}")).collect();
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: EmulateArgs,
    }

    #[test]
    fn what_the_command_line_says_of_the_emulator_reaches_it() {
        let options = |more: &[&str]| {
            let words = ["emulate", "cell.toml"].iter().chain(more);
            super::options(&Line::parse_from(words).args, LineFaults::default(), 7)
        };

        let usual = options(&[]);
        assert!(!usual.no_watchdog && usual.sensors == SensorKind::NetFt && usual.seed == 7);
        assert_eq!(usual.leaves_after, Some(LEAVES));
        assert!(options(&["--no-watchdog"]).no_watchdog);
        assert_eq!(options(&["--stay"]).leaves_after, None);
        assert_eq!(options(&["--sensors", "controller"]).sensors, SensorKind::Controller);
    }

    #[test]
    fn places_and_times_of_faults_are_read() {
        let arms = scenario::read(std::path::Path::new("a"), "", &[]).unwrap().controller.cell.arms;

        assert_eq!(at("track.3@20", &arms, true), Ok(At { effector: 0, axis: 3, time: 20.0 }));
        assert_eq!(at("postument.7@0.5", &arms, true), Ok(At { effector: 1, axis: 7, time: 0.5 }));
        assert_eq!(at("track.3@0", &arms, true), Ok(At { effector: 0, axis: 3, time: 0.0 }));
        assert_eq!(at("postument@4", &arms, false), Ok(At { effector: 1, axis: 0, time: 4.0 }));
        for wrong in ["track.8@1", "track@1", "track.3", "left.3@1", "track.3@soon"] {
            assert!(at(wrong, &arms, true).is_err(), "{wrong}");
        }
        for time in ["-1", "NaN", "inf", "1e400"] {
            let told = at(&format!("track.3@{time}"), &arms, true).unwrap_err();
            assert!(told.contains("0 or more"), "{time}: {told}");
        }
    }
}
