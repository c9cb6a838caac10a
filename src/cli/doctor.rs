//! `rubik-robot doctor`: what this machine can give a real-time servo, a probe of its jitter, and for each
//! shortfall the line that helps.

use super::output::Output;
use super::{WRONG, complain};
use crate::cell::Arm;
use crate::hw::devices::{
    Devices, EffectorDevices, ForceDevice, NAME_DEVICES, NoDevice, ask_parallel, ask_ports,
};
use crate::hw::driver::{
    Clock, Core, NoRecords, RealTime, Switches, Timing, WallOptions, spawn_wall,
};
use crate::hw::port::{Port, PortFault};
use crate::scenario::keys::BridgeKind;
use crate::scenario::{self, CameraSource, Scenario};
use crate::servo::io::{ArmDrive, ArmReading};
use clap::Args;
use rustix::fs::{Access, access};
use rustix::io::Errno;
use serde_json::json;
use std::fs;
use std::os::unix::fs::FileTypeExt;
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
Exit code 0 when every real-time right is granted and nothing is found for which `run` would refuse the scenario's devices,
1 when not, 2 when the scenario is wrong. No device is opened. The probe never moves an arm.")]
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
    /// `run` refuses the scenario.
    Refused,
    /// Costs punctuality, or is worth knowing.
    Note,
}

impl Weight {
    fn word(self) -> &'static str {
        match self {
            Self::Good => "ok",
            Self::Missing => "MISSING",
            Self::Refused => "REFUSED",
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
    let (missing, refused) = (any(&findings, Weight::Missing), any(&findings, Weight::Refused));
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
        let all = json!({
            "real_time": !missing,
            "refused": refused,
            "findings": findings,
            "probes": probes,
        });
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
        if refused {
            output.line("`run` refuses this scenario for its devices.")?;
        }
    }
    Ok(exit_code(&findings))
}

fn any(findings: &[Finding], weight: Weight) -> bool {
    findings.iter().any(|finding| finding.weight == weight)
}

fn exit_code(findings: &[Finding]) -> u8 {
    u8::from(any(findings, Weight::Missing) || any(findings, Weight::Refused))
}

fn examine(scenario: Option<&Scenario>, priority: i32) -> Vec<Finding> {
    let mut findings = rights(priority);
    findings.extend(kernel());
    findings.extend(devices());
    findings.extend(scenario.into_iter().flat_map(robot));
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
fn may_open(device: &Path) -> Result<(), Errno> {
    access(device, Access::READ_OK | Access::WRITE_OK)
}

fn lines(devices: &Path, names: &[String]) -> Finding {
    let name = "serial lines";
    let denied: Vec<Errno> =
        names.iter().filter_map(|name| may_open(&devices.join(name)).err()).collect();
    match (names.len(), denied.len()) {
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
        (all, count) => Finding {
            name,
            weight: Weight::Note,
            fact: format!("{count} of {all} may not be opened"),
            fix: denied.contains(&Errno::ACCESS).then(trigger),
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
            fix: Some(raw_io()),
        };
    }
    match asked(ask_ports, 0) {
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
    if !cfg!(feature = "isa") {
        return "cargo build --release --features isa   (for bridge.kind = \"isa\")".to_owned();
    }
    let program = std::env::current_exe().unwrap_or_default();
    format!("sudo setcap cap_sys_rawio+ep {}   (for bridge.kind = \"isa\")", program.display())
}

/// Asks for ports in a thread that ends right away: the right belongs to a thread.
fn asked(ask: fn(u16) -> Result<(), String>, ports: u16) -> Result<(), String> {
    std::thread::spawn(move || ask(ports))
        .join()
        .unwrap_or_else(|_| Err("the thread that asked for ports panicked".to_owned()))
}

/// What `run` refuses, and the line that helps, if one does.
#[derive(Debug, PartialEq, Eq)]
struct Refusal {
    fact: String,
    fix: Option<String>,
}

impl Refusal {
    /// A device that may not be opened. Rights can be granted; what is not there no right brings.
    fn of_device(device: &Path, errno: Errno) -> Self {
        let fix = (errno == Errno::ACCESS).then(trigger);
        Self { fact: format!("{}: {errno}", device.display()), fix }
    }

    fn of_ports(fact: String) -> Self {
        Self { fact, fix: Some(raw_io()) }
    }
}

/// What is wrong in the file says itself what is wanted there.
impl From<NoDevice> for Refusal {
    fn from(why: NoDevice) -> Self {
        Self { fact: why.to_string(), fix: None }
    }
}

/// What a scenario's `bridge.devices` names; nothing where no hardware is behind its bridge.
fn robot(scenario: &Scenario) -> Vec<Finding> {
    if !scenario.bridge.kind.is_hardware() {
        return Vec::new();
    }
    let path = scenario.bridge.devices_at(&scenario.path);
    let refusals = match Devices::load(&path) {
        Ok(devices) => refusals(scenario, &devices),
        Err(why) => vec![Refusal { fix: Some(NAME_DEVICES.to_owned()), ..why.into() }],
    };
    let name = "bridge.devices";
    if refusals.is_empty() {
        let fact = format!(
            "{}: its values fit, and this user may open the devices that it names",
            path.display()
        );
        return vec![Finding { name, weight: Weight::Good, fact, fix: None }];
    }
    // All that the same line helps against stands together.
    let mut findings: Vec<Finding> = Vec::new();
    for Refusal { fact, fix } in refusals {
        match findings.iter_mut().find(|finding| finding.fix == fix) {
            Some(same) => same.fact = format!("{}; {fact}", same.fact),
            None => findings.push(Finding { name, weight: Weight::Refused, fact, fix }),
        }
    }
    findings
}

/// What a run would refuse of a scenario's devices: by its own rules, and without opening any.
fn refusals(scenario: &Scenario, devices: &Devices) -> Vec<Refusal> {
    let config = &scenario.controller;
    let cards = scenario.bridge.kind == BridgeKind::Isa;
    let mut refusals = Vec::new();
    for arm in &config.cell.arms {
        let own = match devices.of_effector(&arm.name) {
            Ok(own) => own,
            Err(why) => {
                refusals.push(why.into());
                continue;
            }
        };
        refusals.extend(if cards { of_card(arm, own) } else { of_lines(arm, own) });
        refusals.extend(of_sensor(own));
        // Arm by arm: the first one's error would hide the next one's.
        let grip = devices.check_grip(std::slice::from_ref(arm), config.control.grip, cards);
        refusals.extend(grip.err().map(Refusal::from));
    }
    for (camera, source) in config.cell.cameras.iter().zip(&config.cameras) {
        if *source == CameraSource::Renderer {
            refusals.extend(of_camera(devices, &camera.name));
        }
    }
    refusals
}

fn of_path(path: &str) -> Option<Refusal> {
    let path = Path::new(path);
    if let Err(errno) = may_open(path) {
        return Some(Refusal::of_device(path, errno));
    }
    let is_device = fs::metadata(path).is_ok_and(|it| it.file_type().is_char_device());
    (!is_device).then(|| Refusal { fact: format!("{}: no device", path.display()), fix: None })
}

fn of_lines(arm: &Arm, devices: &EffectorDevices) -> Vec<Refusal> {
    let refusal = |path: Result<&str, NoDevice>| match path {
        Ok(path) => of_path(path),
        Err(why) => Some(why.into()),
    };
    devices.paths(arm.model.has_track).filter_map(|(_, path)| refusal(path)).collect()
}

fn of_card(arm: &Arm, devices: &EffectorDevices) -> Vec<Refusal> {
    let Some(card) = &devices.isa else {
        return vec![NoDevice(format!("effector \"{}\": no card is named", arm.name)).into()];
    };
    let ports = asked(ask_ports, card.offset).err().map(Refusal::of_ports);
    ports.into_iter().chain(card.uio.as_deref().and_then(of_path)).collect()
}

fn of_sensor(devices: &EffectorDevices) -> Vec<Refusal> {
    match devices.force_device() {
        Ok(ForceDevice::None | ForceDevice::NetFt(_)) => Vec::new(),
        Ok(ForceDevice::Controller(path)) => {
            let words = devices.ft_parallel.and_then(|base| asked(ask_parallel, base).err());
            of_path(path).into_iter().chain(words.map(Refusal::of_ports)).collect()
        }
        Err(why) => vec![why.into()],
    }
}

fn of_camera(devices: &Devices, name: &str) -> Option<Refusal> {
    match devices.of_camera(name) {
        // Whoever listens there made the socket, and alone grants rights to it: no rule of devices does.
        Ok(camera) => may_open(&camera.socket)
            .err()
            .map(|errno| Refusal { fix: None, ..Refusal::of_device(&camera.socket, errno) }),
        Err(why) => Some(why.into()),
    }
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
    use crate::hw::devices::{CameraDevice, IsaDevice};
    use crate::hw::emulator::pty::Pty;
    use crate::motion::AXES;
    use crate::tables::testing::Folder;

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

    const IDLE: &str = "task = \"idle\"\npace = \"real-time\"\ncamera = []\nvsp = []\n[bridge]\nkind = \"serial\"\n\
                        devices = \"devices.toml\"\n[[effector]]\nname = \"postument\"\n";

    /// A line by a name in a folder; the same one where it is asked for again.
    fn line(folder: &Folder, name: &str) -> String {
        let path = folder.0.join(name);
        if !path.exists() {
            let far = Pty::open().unwrap();
            std::os::unix::fs::symlink(far.path(), &path).unwrap();
            // It stays for as long as the test program.
            std::mem::forget(far);
        }
        path.display().to_string()
    }

    /// An arm without a track whose lines are in a folder.
    fn postument(folder: &Folder) -> EffectorDevices {
        let line = |i: usize| line(folder, &format!("line{i}"));
        let axes = std::iter::once(String::new()).chain((1..=AXES).map(line)).collect();
        EffectorDevices { name: "postument".into(), axes, ..EffectorDevices::default() }
    }

    /// What is found of the robot of a scenario with this text, in a folder with its file of devices: how grave, what,
    /// and what helps.
    fn look(folder: &Folder, text: &str) -> Vec<(Weight, String, Option<String>)> {
        let found = robot(&scenario::read(&folder.0.join("t.toml"), text, &[]).unwrap());
        found.into_iter().map(|f| (f.weight, f.fact, f.fix)).collect()
    }

    /// The one thing that is found there.
    fn one(folder: &Folder, text: &str) -> (Weight, String, Option<String>) {
        let [one] = <[_; 1]>::try_from(look(folder, text)).unwrap();
        one
    }

    /// The one thing that is found of these devices.
    fn look_at(folder: &Folder, text: &str, devices: &Devices) -> (Weight, String, Option<String>) {
        folder.write("devices.toml", &devices.text().unwrap());
        one(folder, text)
    }

    fn with(effector: EffectorDevices) -> Devices {
        Devices { effector: vec![effector], ..Devices::default() }
    }

    #[test]
    fn the_devices_of_a_scenarios_robot_are_looked_for() {
        let folder = Folder::new("doctor-robot");

        let (weight, fact, fix) = look_at(&folder, IDLE, &with(postument(&folder)));
        assert!(weight == Weight::Good && fact.contains("devices.toml"), "{fact}");
        assert_eq!(fix, None);
        fs::remove_file(folder.0.join("line3")).unwrap();
        let (weight, fact, fix) = one(&folder, IDLE);
        assert!(weight == Weight::Refused && fact.contains("line3: No such file"), "{fact}");
        assert!(!fact.contains("line2"), "{fact}");
        assert_eq!(fix, None, "no right brings a line that is not there");
        folder.write("line3", "");
        let (weight, fact, fix) = one(&folder, IDLE);
        assert!(weight == Weight::Refused && fact.contains("line3: no device"), "{fact}");
        assert_eq!(fix, None);
        let (weight, fact, fix) = one(&folder, &IDLE.replace("devices.toml", "nosuch.toml"));
        assert!(weight == Weight::Refused && fact.contains("nosuch.toml: No such file"), "{fact}");
        assert_eq!(fix.as_deref(), Some(NAME_DEVICES));
        assert!(look(&folder, &IDLE.replace("serial", "plant")).is_empty());
    }

    #[test]
    fn what_helps_is_told_where_it_helps() {
        let folder = Folder::new("doctor-advice");
        let mut twice = postument(&folder);
        twice.axes[4] = twice.axes[3].clone();
        let ended = Devices { emulated: true, ..with(postument(&folder)) };

        for devices in [with(twice), ended] {
            let (weight, fact, fix) = look_at(&folder, IDLE, &devices);
            assert_eq!((weight, fix.as_deref()), (Weight::Refused, Some(NAME_DEVICES)), "{fact}");
        }
        let line = Path::new("/dev/ttyUSB0");
        let fix = |errno| Refusal::of_device(line, errno).fix;
        assert!(fix(Errno::ACCESS).is_some_and(|fix| fix.contains("usermod")));
        assert_eq!([fix(Errno::NOENT), fix(Errno::IO)], [None, None]);
        let wanted = if cfg!(feature = "isa") { "setcap" } else { "cargo build" };
        assert!(raw_io().contains(wanted) && ports().fix.is_none_or(|fix| fix == raw_io()));
    }

    #[test]
    fn who_names_a_scenario_learns_by_the_exit_code_that_it_cannot_run() {
        let found = |weight| Finding { name: "", weight, fact: String::new(), fix: None };
        let code = |weights: &[Weight]| {
            exit_code(&weights.iter().map(|weight| found(*weight)).collect::<Vec<_>>())
        };

        assert_eq!(code(&[Weight::Good, Weight::Note]), 0);
        assert_eq!(code(&[Weight::Missing, Weight::Good]), 1);
        assert_eq!(code(&[Weight::Good, Weight::Refused]), 1);
    }

    #[test]
    fn values_that_a_run_refuses_are_told() {
        let folder = Folder::new("doctor-values");
        let track = IDLE.replace("postument", "track");
        let there = format!("ft_controller:{}", line(&folder, "sensor"));
        let nowhere = there.replace("sensor", "nosensor");
        let sensor = |force: &str| EffectorDevices { force: force.into(), ..postument(&folder) };
        let currents = |axis: usize, amperes: f64| {
            let mut max_currents = vec![1.0; AXES + 1];
            max_currents[axis] = amperes;
            EffectorDevices { max_currents, ..postument(&folder) }
        };
        let of_track = |devices: EffectorDevices| {
            let mut axes = devices.axes.clone();
            axes[0] = line(&folder, "line0");
            EffectorDevices { name: "track".into(), axes, ..devices }
        };
        let mut without = postument(&folder);
        without.axes[2].clear();

        for (text, devices, wanted) in [
            (IDLE, sensor("bogus"), "wanted net_ft:ADDRESS:PORT"),
            (IDLE, sensor("net_ft:somewhere"), "wanted an address and a port"),
            (IDLE, sensor(&nowhere), "nosensor: No such file"),
            (IDLE, currents(AXES, 0.01), "a grip of 40 N takes"),
            (track.as_str(), of_track(currents(0, 0.0)), "the track does not move with 0 A"),
            (IDLE, without, "axis 2 has no line"),
            (IDLE, of_track(postument(&folder)), "no [[effector]] \"postument\""),
        ] {
            let (weight, fact, fix) = look_at(&folder, text, &with(devices));
            assert!(weight == Weight::Refused && fact.contains(wanted), "{wanted}: {fact}");
            assert_eq!(fix, None, "{wanted}");
        }
        for (text, devices) in [
            (IDLE, sensor("net_ft:127.0.0.1:49152")),
            (IDLE, sensor(&there)),
            (IDLE, currents(0, 0.0)),
            (track.as_str(), of_track(currents(0, 1.0))),
        ] {
            let (weight, fact, _) = look_at(&folder, text, &with(devices));
            assert!(weight == Weight::Good, "{fact}");
        }
    }

    #[test]
    fn a_card_is_asked_for_and_held_against_its_arm() {
        let folder = Folder::new("doctor-card");
        let text = IDLE.replace("serial", "isa");
        let found = |card: Option<IsaDevice>, max_currents: &[f64]| {
            let max_currents = max_currents.to_vec();
            let own = EffectorDevices { isa: card, max_currents, ..postument(&folder) };
            folder.write("devices.toml", &with(own).text().unwrap());
            look(&folder, &text)
        };
        let told =
            |found: &[(Weight, String, Option<String>)], wanted: &str, fix: Option<String>| {
                let refused = |f: &&(Weight, String, Option<String>)| {
                    f.0 == Weight::Refused && f.1.contains(wanted) && f.2 == fix
                };
                assert!(found.iter().find(refused).is_some(), "{wanted}: {found:?}");
            };
        let enough = [0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5];

        told(&found(None, &enough), "effector \"postument\": no card is named", None);
        let named = found(Some(IsaDevice::default()), &enough);
        match asked(ask_ports, 0) {
            Ok(()) => assert_eq!(named[0].0, Weight::Good, "{named:?}"),
            Err(why) => told(&named, &why, Some(raw_io())),
        }
        assert_eq!(named.len(), 1, "{named:?}");
        let uio = folder.0.join("nouio").display().to_string();
        let alone = found(Some(IsaDevice { uio: Some(uio), ..IsaDevice::default() }), &enough);
        told(&alone, "nouio: No such file", None);
        let powerless = found(Some(IsaDevice { power_axis: 8, ..IsaDevice::default() }), &enough);
        told(&powerless, "power_axis: there is no axis 8", None);
        let weak = found(Some(IsaDevice::default()), &[0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.05]);
        told(&weak, "a grip of 40 N takes 72 mA", None);
    }

    #[test]
    fn a_camera_of_the_robot_is_looked_for() {
        let folder = Folder::new("doctor-camera");
        let text = IDLE.replace("camera = []\n", "") + "[[camera]]\nname = \"standalone\"\n";
        let camera = |name: &str, socket: &str| Devices {
            camera: vec![CameraDevice { name: name.into(), socket: folder.0.join(socket) }],
            ..with(postument(&folder))
        };

        let (weight, fact, _) = look_at(&folder, &text, &camera("standalone", "nosocket"));
        assert!(weight == Weight::Refused && fact.contains("nosocket: No such file"), "{fact}");
        let (weight, fact, _) = look_at(&folder, &text, &camera("other", "line1"));
        assert!(
            weight == Weight::Refused && fact.contains("no [[camera]] \"standalone\""),
            "{fact}"
        );
        let (weight, fact, _) = look_at(&folder, &text, &camera("standalone", "line1"));
        assert!(weight == Weight::Good, "{fact}");
    }

    #[test]
    fn a_probe_counts_its_periods() {
        let timing = probe(0, 85, 0.2).unwrap();

        let all = timing.missed + timing.wake_up.len();
        assert!((50..=200).contains(&all), "{all}");
    }
}
