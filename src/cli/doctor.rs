//! `rubik-robot doctor`: what this machine can give a real-time servo, a probe of its jitter, and for each
//! shortfall the line that helps.

use super::output::Output;
use crate::hw::driver::{
    Clock, Core, NoRecords, RealTime, Switches, Timing, WallOptions, spawn_wall,
};
use crate::hw::port::{Port, PortFault};
use crate::servo::io::{ArmDrive, ArmReading};
use clap::Args;
use serde_json::json;
use std::fs;
use std::sync::Arc;
use std::time::Duration;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot doctor
  rubik-robot doctor --seconds 60         a longer probe
  rubik-robot doctor --json | tail -1
Exit code 0 when every real-time right is granted, 1 when one is not. The probe never moves an arm.")]
pub(super) struct DoctorArgs {
    /// Length of each of the two jitter probes
    #[arg(long, value_name = "S", default_value_t = 2.0)]
    seconds: f64,
    /// One line of JSON for a program
    #[arg(long)]
    json: bool,
}

/// What was found about one thing.
struct Finding {
    name: &'static str,
    weight: Weight,
    fact: String,
    /// The line that helps.
    fix: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Weight {
    /// As it should be.
    Good,
    /// A right that `--require-rt` wants is missing.
    Missing,
    /// Costs punctuality, or is worth knowing.
    Note,
}

impl Weight {
    fn word(self) -> &'static str {
        match self {
            Self::Good => "ok",
            Self::Missing => "MISSING",
            Self::Note => "note",
        }
    }
}

/// Returns the exit code.
pub(super) fn run(args: &DoctorArgs, output: &mut Output) -> anyhow::Result<u8> {
    let findings = examine();
    let missing = findings.iter().any(|f| f.weight == Weight::Missing);
    let seconds = args.seconds.clamp(0.1, 3600.0);
    if !args.json {
        for f in &findings {
            output.line(&format!("{:8} {:22} {}", f.weight.word(), f.name, f.fact))?;
            if let Some(fix) = &f.fix {
                output.line(&format!("{:31} -> {fix}", ""))?;
            }
        }
        output.line(&format!("\njitter of the servo's own thread, 2 ms, {seconds} s each:"))?;
        output.flush()?;
    }
    let probes = [("sleep", 0), ("sleep and spin", WallOptions::default().spin)]
        .map(|(name, spin)| (name, probe(spin, seconds)));
    if args.json {
        let probes: Vec<_> = probes.iter().map(|(name, t)| describe(name, t.as_ref())).collect();
        let findings: Vec<_> = findings
            .iter()
            .map(
                |f| json!({"name": f.name, "state": f.weight.word(), "fact": f.fact, "fix": f.fix}),
            )
            .collect();
        let all = json!({"real_time": !missing, "findings": findings, "probes": probes});
        output.line(&all.to_string())?;
    } else {
        for (name, timing) in &probes {
            output.line(&match timing {
                Some(timing) => format!("  {name:15} {}", words(timing)),
                None => format!("  {name:15} the thread could not be started"),
            })?;
        }
        let last = if missing {
            "\nNot real time: `run --pace real-time` works and warns, `--require-rt` refuses."
        } else {
            "\nEvery real-time right is granted."
        };
        output.line(last)?;
    }
    Ok(u8::from(missing))
}

fn examine() -> Vec<Finding> {
    let mut findings = rights();
    findings.extend(kernel());
    findings.extend(devices());
    findings
}

/// Makes this user one of the group to which everything of `packaging/` is granted.
const MEMBER: &str =
    "sudo groupadd -f rubik-robot && sudo usermod -aG rubik-robot $USER   (then log in anew)";
/// Lets that group have the devices.
const RULES: &str = "sudo cp packaging/udev/60-rubik-robot.rules /etc/udev/rules.d/ && sudo udevadm control --reload";

/// The rights that the servo's thread asks for, by asking for them.
fn rights() -> Vec<Finding> {
    let limits = fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let limit = |name: &str| -> String {
        let line = limits.lines().find(|line| line.starts_with(name)).unwrap_or_default();
        line[name.len().min(line.len())..].split_whitespace().next().unwrap_or("?").to_owned()
    };
    let priority = WallOptions::default().priority;
    // Rights belong to a thread: one that ends right away.
    let denied = std::thread::spawn(move || RealTime::acquire(priority, None).warnings)
        .join()
        .unwrap_or_default();
    let refusal = |what: &str| denied.iter().find(|warning| warning.contains(what)).cloned();
    let limits_file =
        &format!("sudo cp packaging/limits.d/rubik-robot.conf /etc/security/limits.d/ && {MEMBER}");
    let one = |name, what: &str, good: String, fix: &str| match refusal(what) {
        None => Finding { name, weight: Weight::Good, fact: good, fix: None },
        Some(fact) => Finding { name, weight: Weight::Missing, fact, fix: Some(fix.to_owned()) },
    };
    vec![
        one(
            "scheduling",
            "SCHED_FIFO",
            format!(
                "SCHED_FIFO {priority} granted (RLIMIT_RTPRIO {})",
                limit("Max realtime priority")
            ),
            limits_file,
        ),
        one(
            "memory lock",
            "mlockall",
            format!("mlockall granted (RLIMIT_MEMLOCK {})", limit("Max locked memory")),
            limits_file,
        ),
        one(
            "wake-up latency",
            "cpu_dma_latency",
            "/dev/cpu_dma_latency can be held at 0".to_owned(),
            &format!("{RULES} && sudo udevadm trigger /dev/cpu_dma_latency && {MEMBER}"),
        ),
    ]
}

fn kernel() -> Vec<Finding> {
    let read = |path: &str| fs::read_to_string(path).unwrap_or_default().trim().to_owned();
    let note = |name, good: bool, fact: String, fix: Option<&str>| Finding {
        name,
        weight: if good { Weight::Good } else { Weight::Note },
        fact,
        fix: fix.filter(|_| !good).map(str::to_owned),
    };
    let release = read("/proc/sys/kernel/osrelease");
    let preempts =
        read("/sys/kernel/realtime") == "1" || read("/proc/version").contains("PREEMPT_RT");
    let budget = read("/proc/sys/kernel/sched_rt_runtime_us");
    let resolution = Clock.resolution();
    let cores = std::thread::available_parallelism().map_or(0, std::num::NonZero::get);
    let isolated = read("/sys/devices/system/cpu/isolated");
    let governors: Vec<String> = (0..cores)
        .map(|cpu| read(&format!("/sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor")))
        .filter(|governor| !governor.is_empty())
        .collect();
    let performs = governors.iter().all(|governor| governor == "performance");
    let is_virtual = read("/proc/cpuinfo").contains(" hypervisor");
    vec![
        note(
            "PREEMPT_RT",
            preempts,
            format!("kernel {release}, {}", if preempts { "PREEMPT_RT" } else { "not PREEMPT_RT" }),
            Some("sudo apt-get install linux-image-rt-amd64   (Debian; then boot it)"),
        ),
        note(
            "real-time budget",
            budget == "-1" || budget == "950000",
            match budget.as_str() {
                "-1" => "real-time threads are never throttled".to_owned(),
                budget => format!(
                    "real-time threads have {budget} us of each second; the servo needs 4 %"
                ),
            },
            Some("sudo sysctl kernel.sched_rt_runtime_us=950000"),
        ),
        note(
            "timer",
            resolution <= 1000,
            format!("the monotonic clock resolves {resolution} ns"),
            Some("boot with highres=on"),
        ),
        note(
            "governor",
            performs,
            match governors.first() {
                None => "no frequency scaling to be seen".to_owned(),
                Some(first) if performs => format!("{first} on all cores"),
                Some(_) => format!("{} on {cores} cores", governors.join(", ")),
            },
            Some("sudo cpupower frequency-set -g performance"),
        ),
        note(
            "isolated cores",
            !isolated.is_empty(),
            match isolated.as_str() {
                "" => format!("none of {cores}"),
                isolated => format!("{isolated} of {cores}: set real_time.core to one of them"),
            },
            Some("boot with isolcpus=1 nohz_full=1 rcu_nocbs=1, then --set real_time.core=1"),
        ),
        note(
            "hypervisor",
            !is_virtual,
            if is_virtual {
                "a virtual machine: gaps of milliseconds come from below it".to_owned()
            } else {
                "none to be seen".to_owned()
            },
            None,
        ),
    ]
}

/// Devices that a bridge may need. None is needed for the simulated plant.
fn devices() -> Vec<Finding> {
    let named = |prefixes: &[&str]| -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir("/dev")
            .into_iter()
            .flatten()
            .flatten()
            .filter_map(|entry| entry.file_name().into_string().ok())
            .filter(|name| prefixes.iter().any(|prefix| name.starts_with(prefix)))
            .collect();
        names.sort();
        names
    };
    let serial = named(&["ttyUSB", "ttyACM", "ttyM"]);
    let denied: Vec<&String> = serial
        .iter()
        .filter(|name| {
            let path = format!("/dev/{name}");
            let opened = fs::File::options().read(true).write(true).open(path);
            opened.is_err_and(|e| e.kind() == std::io::ErrorKind::PermissionDenied)
        })
        .collect();
    let lines = match (serial.len(), denied.as_slice()) {
        (0, _) => Finding {
            name: "serial lines",
            weight: Weight::Note,
            fact: "none: bridge.kind = \"serial\" needs one an axis".to_owned(),
            fix: None,
        },
        (_, []) => Finding {
            name: "serial lines",
            weight: Weight::Good,
            fact: format!("{} to be opened: {}", serial.len(), serial.join(" ")),
            fix: None,
        },
        (_, denied) => Finding {
            name: "serial lines",
            weight: Weight::Note,
            fact: format!("{} of {} may not be opened", denied.len(), serial.len()),
            fix: Some(format!("{RULES} && sudo udevadm trigger && {MEMBER}")),
        },
    };
    let ports = fs::File::options().read(true).write(true).open("/dev/port").is_ok();
    let isa = Finding {
        name: "ISA ports",
        weight: if ports { Weight::Good } else { Weight::Note },
        fact: if ports { "/dev/port can be opened" } else { "/dev/port cannot be opened" }
            .to_owned(),
        fix: (!ports).then(|| {
            let program = std::env::current_exe().unwrap_or_default();
            format!(
                "sudo setcap cap_sys_rawio+ep {}   (for bridge.kind = \"isa\")",
                program.display()
            )
        }),
    };
    let mut findings = vec![lines, isa];
    findings.extend(slow_adapters(&serial));
    findings
}

/// FTDI adapters that keep answers back: by 16 ms as the driver has them at first.
fn slow_adapters(serial: &[String]) -> Option<Finding> {
    let timer = |name: &&String| {
        let path = format!("/sys/class/tty/{name}/device/latency_timer");
        let text = fs::read_to_string(path).ok()?;
        text.trim().parse::<u32>().ok().filter(|&milliseconds| milliseconds > 1)
    };
    let slow: Vec<&String> = serial.iter().filter(|name| timer(name).is_some()).collect();
    let first = slow.first()?;
    Some(Finding {
        name: "serial adapters",
        weight: Weight::Note,
        fact: format!("{} of them keep answers back for more than 1 ms", slow.len()),
        fix: Some(format!(
            "echo 1 | sudo tee /sys/class/tty/{first}/device/latency_timer   (each; or install packaging/udev)"
        )),
    })
}

/// A port without arms.
struct Nothing;

impl Port for Nothing {
    fn exchange(&mut self, _: u64, _: &[ArmDrive], _: &mut [ArmReading]) -> Result<(), PortFault> {
        Ok(())
    }
}

/// The very thread of a run, without arms.
fn probe(spin: u64, seconds: f64) -> Option<Timing> {
    let switches = Arc::new(Switches::default());
    let core =
        Core::new(Vec::new(), Vec::new(), switches, Box::new(NoRecords), &mut Nothing).ok()?;
    let options = WallOptions { spin, missed_limit: u64::MAX, ..WallOptions::default() };
    let wall = spawn_wall(core, Nothing, |_, _| {}, options).ok()?;
    std::thread::sleep(Duration::from_secs_f64(seconds));
    Some(wall.stop().timing)
}

fn words(timing: &Timing) -> String {
    let us = |q: f64| timing.wake_up.quantile(q) as f64 / 1000.0;
    format!(
        "late by p50 {:.1} us, p99 {:.1} us, p99.9 {:.1} us, max {:.1} us; missed {} of {} periods",
        us(0.5),
        us(0.99),
        us(0.999),
        timing.wake_up.max() as f64 / 1000.0,
        timing.missed,
        timing.missed + timing.wake_up.len(),
    )
}

fn describe(name: &str, timing: Option<&Timing>) -> serde_json::Value {
    let Some(timing) = timing else { return json!({"name": name}) };
    let us = |q: f64| timing.wake_up.quantile(q) as f64 / 1000.0;
    json!({
        "name": name,
        "p50_us": us(0.5),
        "p99_us": us(0.99),
        "p999_us": us(0.999),
        "max_us": timing.wake_up.max() as f64 / 1000.0,
        "missed": timing.missed,
        "periods": timing.wake_up.len(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_comes_with_the_line_that_helps() {
        for finding in examine() {
            assert!(!finding.fact.is_empty(), "{}", finding.name);
            assert!(finding.weight != Weight::Missing || finding.fix.is_some(), "{}", finding.name);
        }
    }

    #[test]
    fn a_probe_counts_its_periods() {
        let timing = probe(0, 0.2).unwrap();

        let all = timing.missed + timing.wake_up.len();
        assert!((50..=200).contains(&all), "{all}");
    }
}
