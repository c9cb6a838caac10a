//! `rubik-robot doctor`: what this machine can give a real-time servo, a probe of its jitter, and for each
//! shortfall the line that helps.

use super::output::Output;
use super::{WRONG, complain};
use crate::cell::Arm;
use crate::hw::devices::{Devices, EffectorDevices, ask_ports};
use crate::hw::driver::{
    Clock, Core, NoRecords, RealTime, Switches, Timing, WallOptions, spawn_wall,
};
use crate::hw::port::{Port, PortFault};
use crate::motion::AXES;
use crate::scenario::keys::BridgeKind;
use crate::scenario::{self, CameraSource, Scenario};
use crate::servo::io::{ArmDrive, ArmReading};
use clap::Args;
use rustix::fs::{Access, access};
use serde_json::json;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot doctor
  rubik-robot doctor my.toml              and its priority, and the devices of its robot
  rubik-robot doctor --seconds 60         a longer probe
  rubik-robot doctor --json | tail -1
Exit code 0 when every real-time right is granted, 1 when one is not. The probe never moves an arm.")]
pub(super) struct DoctorArgs {
    /// Scenario whose priority is asked for and whose devices are looked for
    scenario: Option<PathBuf>,
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
    let scenario = match args.scenario.as_deref().map(|path| scenario::load(path, &[])).transpose()
    {
        Ok(scenario) => scenario,
        Err(faults) => {
            complain(&faults.to_string());
            return Ok(WRONG);
        }
    };
    let priority =
        scenario.as_ref().map_or(WallOptions::default().priority, |s| s.real_time.priority);
    let findings = examine(scenario.as_ref(), priority);
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
        .map(|(name, spin)| (name, probe(spin, priority, seconds)));
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

fn examine(scenario: Option<&Scenario>, priority: i32) -> Vec<Finding> {
    let mut findings = rights(priority);
    findings.extend(kernel());
    findings.extend(devices());
    findings.extend(scenario.and_then(robot));
    findings
}

/// The highest priority that `packaging/` grants.
const GRANTED: i32 = 85;

/// Makes this user one of the group to which everything of `packaging/` is granted.
const MEMBER: &str =
    "sudo groupadd -f rubik-robot && sudo usermod -aG rubik-robot $USER   (then log in anew)";
/// Lets that group have the devices.
const RULES: &str = "sudo cp packaging/udev/60-rubik-robot.rules /etc/udev/rules.d/ && sudo udevadm control --reload";

/// The rights that the servo's thread asks for, by asking for them.
fn rights(priority: i32) -> Vec<Finding> {
    let limits = fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let limit = |name: &str| -> String {
        let line = limits.lines().find(|line| line.starts_with(name)).unwrap_or_default();
        line[name.len().min(line.len())..].split_whitespace().next().unwrap_or("?").to_owned()
    };
    // Rights belong to a thread: one that ends right away.
    let denied = std::thread::spawn(move || RealTime::acquire(priority, None).warnings)
        .join()
        .unwrap_or_default();
    let refusal = |what: &str| denied.iter().find(|warning| warning.contains(what)).cloned();
    let limits_file =
        format!("sudo cp packaging/limits.d/rubik-robot.conf /etc/security/limits.d/ && {MEMBER}");
    let lower = if priority > GRANTED {
        format!("set real_time.priority to {GRANTED}, the most that packaging/ grants; then ")
    } else {
        String::new()
    };
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
            &format!("{lower}{limits_file}"),
        ),
        one(
            "memory lock",
            "mlockall",
            format!("mlockall granted (RLIMIT_MEMLOCK {})", limit("Max locked memory")),
            &limits_file,
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
    let names = serial_lines(Path::new("/dev"), Path::new("/sys/class/tty"));
    let mut findings = vec![lines(Path::new("/dev"), &names), ports()];
    findings.extend(slow_adapters(&names));
    findings
}

/// Names of the serial lines in a folder of devices, `classes` being the kernel's account of them.
fn serial_lines(devices: &Path, classes: &Path) -> Vec<String> {
    // The kernel has more names for a PC's own ports than the PC has ports.
    let is_there = |name: &String| {
        let kind = fs::read_to_string(classes.join(name).join("type")).unwrap_or_default();
        !name.starts_with("ttyS") || kind.trim() != "0"
    };
    let mut names: Vec<String> = fs::read_dir(devices)
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| ["ttyUSB", "ttyACM", "ttyM", "ttyS"].iter().any(|p| name.starts_with(p)))
        .filter(is_there)
        .collect();
    names.sort();
    names
}

/// Whether a device may be opened. It is not: a line that is opened raises its DTR, which resets some controllers.
fn may_open(device: &Path) -> Result<(), String> {
    access(device, Access::READ_OK | Access::WRITE_OK)
        .map_err(|e| format!("{}: {e}", device.display()))
}

fn lines(devices: &Path, names: &[String]) -> Finding {
    let name = "serial lines";
    let denied = names.iter().filter(|name| may_open(&devices.join(name)).is_err()).count();
    match (names.len(), denied) {
        (0, _) => Finding {
            name,
            weight: Weight::Note,
            fact: "none: bridge.kind = \"serial\" needs one an axis".to_owned(),
            fix: None,
        },
        (all, 0) => Finding {
            name,
            weight: Weight::Good,
            fact: format!("{all} to be opened: {}", names.join(" ")),
            fix: None,
        },
        (all, denied) => Finding {
            name,
            weight: Weight::Note,
            fact: format!("{denied} of {all} may not be opened"),
            fix: Some(trigger()),
        },
    }
}

/// Lets the group have the devices that are there already.
fn trigger() -> String {
    format!("{RULES} && sudo udevadm trigger && {MEMBER}")
}

/// The ports of an ISA card where the original had it.
fn ports() -> Finding {
    let name = "ISA ports";
    if !cfg!(feature = "isa") {
        return Finding {
            name,
            weight: Weight::Note,
            fact: "this program was built without port instructions".to_owned(),
            fix: Some(
                "cargo build --release --features isa   (for bridge.kind = \"isa\")".to_owned(),
            ),
        };
    }
    match asked(0) {
        Ok(()) => Finding {
            name,
            weight: Weight::Good,
            fact: "port instructions are granted".to_owned(),
            fix: None,
        },
        Err(fact) => Finding { name, weight: Weight::Note, fact, fix: Some(raw_io()) },
    }
}

/// Lets this program have ports.
fn raw_io() -> String {
    let program = std::env::current_exe().unwrap_or_default();
    format!("sudo setcap cap_sys_rawio+ep {}   (for bridge.kind = \"isa\")", program.display())
}

/// Asks for a card's ports in a thread that ends right away: the right belongs to a thread.
fn asked(offset: u16) -> Result<(), String> {
    std::thread::spawn(move || ask_ports(offset))
        .join()
        .unwrap_or_else(|_| Err("the thread that asked for ports panicked".to_owned()))
}

/// What a scenario's `bridge.devices` names; nothing where no hardware is behind its bridge.
fn robot(scenario: &Scenario) -> Option<Finding> {
    let kind = scenario.bridge.kind;
    if !kind.is_hardware() {
        return None;
    }
    let path = scenario.bridge.devices_at(&scenario.path);
    let wrong = match Devices::load(&path) {
        Ok(devices) => out_of_reach(scenario, &devices),
        Err(why) => vec![why.to_string()],
    };
    let name = "bridge.devices";
    Some(if wrong.is_empty() {
        let fact = format!("{}: everything can be opened", path.display());
        Finding { name, weight: Weight::Good, fact, fix: None }
    } else {
        let fix = if kind == BridgeKind::Isa { raw_io() } else { trigger() };
        Finding { name, weight: Weight::Note, fact: wrong.join("; "), fix: Some(fix) }
    })
}

/// What of a scenario's devices cannot be used.
fn out_of_reach(scenario: &Scenario, devices: &Devices) -> Vec<String> {
    let config = &scenario.controller;
    let mut wrong = Vec::new();
    for arm in &config.cell.arms {
        match devices.of_effector(&arm.name) {
            Ok(own) if scenario.bridge.kind == BridgeKind::Isa => wrong.extend(of_card(arm, own)),
            Ok(own) => wrong.extend(of_lines(arm, own)),
            Err(why) => wrong.push(why.to_string()),
        }
    }
    for (camera, source) in config.cell.cameras.iter().zip(&config.cameras) {
        if *source == CameraSource::Renderer {
            let socket = devices.of_camera(&camera.name).map_err(|why| why.to_string());
            wrong.extend(socket.and_then(|camera| may_open(&camera.socket)).err());
        }
    }
    wrong
}

fn of_lines(arm: &Arm, devices: &EffectorDevices) -> Vec<String> {
    let axes = usize::from(!arm.model.has_track)..=AXES;
    axes.filter_map(|axis| match devices.axes.get(axis).map_or("", String::as_str) {
        "" => Some(format!("effector \"{}\": axis {axis} has no line", arm.name)),
        path => may_open(Path::new(path)).err(),
    })
    .chain(of_sensor(devices))
    .collect()
}

fn of_card(arm: &Arm, devices: &EffectorDevices) -> Vec<String> {
    let Some(card) = &devices.isa else {
        return vec![format!("effector \"{}\": no card is named", arm.name)];
    };
    let uio = card.uio.as_ref().and_then(|uio| may_open(Path::new(uio)).err());
    asked(card.offset).err().into_iter().chain(uio).chain(of_sensor(devices)).collect()
}

fn of_sensor(devices: &EffectorDevices) -> Option<String> {
    may_open(Path::new(devices.force.strip_prefix("ft_controller:")?)).err()
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
fn probe(spin: u64, priority: i32, seconds: f64) -> Option<Timing> {
    let switches = Arc::new(Switches::default());
    let core =
        Core::new(Vec::new(), Vec::new(), switches, Box::new(NoRecords), &mut Nothing).ok()?;
    let options = WallOptions { spin, priority, missed_limit: u64::MAX, ..WallOptions::default() };
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

    /// A folder of its own.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("rubik-{name}-{}", std::process::id()));
            fs::create_dir_all(&path).unwrap();
            Self(path)
        }

        fn write(&self, name: &str, text: &str) -> PathBuf {
            let path = self.0.join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, text).unwrap();
            path
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    fn of<'f>(findings: &'f [Finding], name: &str) -> &'f Finding {
        findings.iter().find(|f| f.name == name).unwrap()
    }

    #[test]
    fn what_is_missing_comes_with_the_line_that_helps() {
        for finding in examine(None, 85) {
            assert!(!finding.fact.is_empty(), "{}", finding.name);
            assert!(finding.weight != Weight::Missing || finding.fix.is_some(), "{}", finding.name);
        }
    }

    #[test]
    fn a_priority_is_granted_where_a_thread_really_has_it() {
        const PRIORITY: i32 = 42;

        let found = rights(PRIORITY);
        let stat = std::thread::spawn(|| {
            let _rights = RealTime::acquire(PRIORITY, None);
            fs::read_to_string("/proc/thread-self/stat").unwrap()
        })
        .join()
        .unwrap();

        // Fields 40 and 41 of the line: priority and policy, of which 1 is first in, first out. The third one follows
        // the name in its brackets.
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
        let is_granted = fields[37] == PRIORITY.to_string() && fields[38] == "1";
        let scheduling = of(&found, "scheduling");
        assert_eq!(scheduling.weight == Weight::Good, is_granted, "{}: {stat}", scheduling.fact);
        assert!(scheduling.fact.contains("42"), "{}", scheduling.fact);
    }

    #[test]
    fn memory_is_locked_only_where_nothing_limits_it() {
        let found = rights(42);
        let lock = of(&found, "memory lock");

        let most = rustix::process::getrlimit(rustix::process::Resource::Memlock).current;
        let status = fs::read_to_string("/proc/self/status").unwrap();
        let line = |name: &str| status.lines().find_map(|l| l.strip_prefix(name)).unwrap().trim();
        let may_lock = u64::from_str_radix(line("CapEff:"), 16).unwrap() >> 14 & 1 == 1;
        if lock.weight == Weight::Good {
            assert!(most.is_none() || may_lock, "{most:?}");
            assert_ne!(line("VmLck:"), "0 kB");
            let limit = most.map_or("unlimited".to_owned(), |bytes| bytes.to_string());
            assert!(lock.fact.contains(&limit), "{}, but {limit}", lock.fact);
        } else {
            assert!(lock.fact.contains("mlockall"), "{}", lock.fact);
        }
    }

    #[test]
    fn the_kernel_is_as_it_says_itself() {
        let found = kernel();
        let said = |argument| {
            let out = std::process::Command::new("uname").arg(argument).output().unwrap();
            String::from_utf8(out.stdout).unwrap().trim().to_owned()
        };

        let flag = fs::read_to_string("/sys/kernel/realtime").is_ok_and(|t| t.trim() == "1");
        let is_real_time = flag || said("-v").contains("PREEMPT_RT");
        let preempts = of(&found, "PREEMPT_RT");
        assert_eq!(preempts.weight == Weight::Good, is_real_time, "{}", preempts.fact);
        assert!(preempts.fact.contains(&said("-r")), "{}", preempts.fact);
    }

    #[test]
    fn the_names_of_ports_that_a_pc_does_not_have_are_left_out() {
        let folder = Folder::new("doctor-lines");
        for (name, kind) in
            [("ttyS0", "4\n"), ("ttyS1", "0\n"), ("ttyUSB0", "0\n"), ("tty3", "4\n")]
        {
            folder.write(&format!("dev/{name}"), "");
            folder.write(&format!("class/{name}/type"), kind);
        }
        let devices = folder.0.join("dev");

        let names = serial_lines(&devices, &folder.0.join("class"));

        assert_eq!(names, ["ttyS0", "ttyUSB0"]);
        assert_eq!(lines(&devices, &names).fact, "2 to be opened: ttyS0 ttyUSB0");
        fs::remove_file(devices.join("ttyS0")).unwrap();
        assert_eq!(lines(&devices, &names).fact, "1 of 2 may not be opened");
    }

    #[test]
    fn the_devices_of_a_scenarios_robot_are_looked_for() {
        let folder = Folder::new("doctor-robot");
        let mut axes = vec![String::new()];
        axes.extend(
            (1..=AXES).map(|i| folder.write(&format!("line{i}"), "").display().to_string()),
        );
        let own = EffectorDevices { name: "postument".into(), axes, ..EffectorDevices::default() };
        let devices = Devices { effector: vec![own], ..Devices::default() };
        folder.write("devices.toml", &devices.text().unwrap());
        let text = "task = \"idle\"\npace = \"real-time\"\ncamera = []\nvsp = []\n[bridge]\nkind = \"serial\"\n\
                    devices = \"devices.toml\"\n[[effector]]\nname = \"postument\"\n";
        let look = |text: &str| {
            robot(&scenario::read(&folder.0.join("t.toml"), text, &[]).unwrap())
                .map(|found| (found.weight, found.fact))
        };

        let (weight, fact) = look(text).unwrap();
        assert!(weight == Weight::Good && fact.contains("devices.toml"), "{fact}");
        fs::remove_file(folder.0.join("line3")).unwrap();
        let (weight, fact) = look(text).unwrap();
        assert!(weight == Weight::Note && fact.contains("line3: No such file"), "{fact}");
        assert!(!fact.contains("line2"), "{fact}");
        let (_, fact) = look(&text.replace("devices.toml", "nosuch.toml")).unwrap();
        assert!(fact.contains("nosuch.toml: No such file"), "{fact}");
        assert_eq!(look(&text.replace("serial", "plant")), None);
    }

    #[test]
    fn a_probe_counts_its_periods() {
        let timing = probe(0, 85, 0.2).unwrap();

        let all = timing.missed + timing.wake_up.len();
        assert!((50..=200).contains(&all), "{all}");
    }
}
