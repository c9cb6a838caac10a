//! Lateness of the servo's thread on this machine, with both arms in position-force control.
//!
//! The bench runs rounds of one second: the thread that only sleeps, as `cyclictest` does; the
//! thread that spins before each period; and `cyclictest` itself, if rt-tests is installed. Each of
//! these runs on the machine as it is, and under a load that the bench generates. The kinds of
//! round alternate, so that a passing disturbance affects all of them, and ratios are medians over
//! the rounds.
//!
//! The bench needs no rights; it prints those that it does not get. It has no limits that could
//! fail, because on a virtual machine the host causes the tails.
//!
//! - `-- --json`: one line for a program
//! - `-- --rounds=N`: number of rounds (5)

use hdrhistogram::Histogram;
use rubik_robot::hw::driver::{
    Core, NoRecords, PERIOD_NANOS, RealTime, Switches, WallOptions, link, spawn_wall,
};
use std::fs;
use std::hint::black_box;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

mod rig;

/// Length of a round.
const SECOND: Duration = Duration::from_secs(1);

/// All rounds of one kind, with what they have measured (ns).
struct Kind {
    name: &'static str,
    /// Whether the rounds run under the bench's own load.
    loaded: bool,
    what: What,
    late: Histogram<u64>,
    jitter: Histogram<u64>,
    /// Duration of the work of a period: to read, to compute, to hand the drives over to the bridge
    /// and to wake the bridge (ns).
    work: Histogram<u64>,
    /// 99th percentile of the lateness in each round (us).
    p99: Vec<f64>,
    /// Number of missed periods in all rounds.
    missed: u64,
}

/// Program whose lateness a round measures.
#[derive(Clone, Copy, PartialEq)]
enum What {
    /// The servo's thread, with the time that it spins before each period (ns).
    Servo(u64),
    /// The program `cyclictest` of the package rt-tests.
    Cyclictest,
}

impl Kind {
    /// Makes a kind of round without results.
    fn new(name: &'static str, loaded: bool, what: What) -> Self {
        let [late, jitter, work] = std::array::from_fn(|_| rig::histogram());
        Self { name, loaded, what, late, jitter, work, p99: Vec::new(), missed: 0 }
    }

    /// Runs one round and adds its results.
    fn round(&mut self) {
        let load = self.loaded.then(Load::start);
        let mut late = rig::histogram();
        match self.what {
            What::Servo(spin) => {
                self.missed += servo(spin, [&mut late, &mut self.jitter, &mut self.work]);
            }
            What::Cyclictest => cyclictest(&mut late),
        }
        drop(load);
        if !late.is_empty() {
            self.p99.push(rig::us(&late, 0.99));
            let _ = self.late.add(&late);
        }
    }

    /// Returns a quantile of the lateness in all rounds (us), 0.5 for the median; `None` if no
    /// round has a result.
    fn share(&self, share: f64) -> Option<f64> {
        (!self.late.is_empty()).then(|| rig::us(&self.late, share))
    }
}

/// Runs the rounds of all kinds and prints the results, as text or as one line of JSON.
fn main() {
    if !rig::is_selected("servo_jitter") {
        return;
    }
    let rounds = std::env::args()
        .find_map(|arg| arg.strip_prefix("--rounds=").and_then(|n| n.parse().ok()))
        .unwrap_or(5);
    let spin = WallOptions::default().spin;
    let mut kinds: Vec<Kind> = [false, true]
        .into_iter()
        .flat_map(|loaded| {
            [
                Kind::new("sleep", loaded, What::Servo(0)),
                Kind::new("sleep, last 100 us spun", loaded, What::Servo(spin)),
                Kind::new("cyclictest", loaded, What::Cyclictest),
            ]
        })
        .collect();
    for _ in 0..rounds {
        for kind in &mut kinds {
            kind.round();
        }
    }
    let [quiet, spun, theirs, loaded, loaded_spun, loaded_theirs] = &kinds[..] else { return };
    if rig::json() {
        let fields = [
            ("p50_us", quiet.share(0.5)),
            ("p99_us", quiet.share(0.99)),
            ("p999_us", quiet.share(0.999)),
            ("max_us", quiet.share(1.0)),
            ("missed", Some(quiet.missed as f64)),
            ("work_p50_us", Some(rig::us(&quiet.work, 0.5))),
            ("work_p99_us", Some(rig::us(&quiet.work, 0.99))),
            ("jitter_p99_us", Some(rig::us(&quiet.jitter, 0.99))),
            ("spin_p50_us", spun.share(0.5)),
            ("spin_p99_us", spun.share(0.99)),
            ("spin_missed", Some(spun.missed as f64)),
            ("cyclictest_p99_us", theirs.share(0.99)),
            ("p99_ratio_to_cyclictest", ratio(quiet, theirs)),
            ("loaded_p99_us", loaded.share(0.99)),
            ("loaded_spin_p99_us", loaded_spun.share(0.99)),
            ("loaded_missed", Some(loaded.missed as f64)),
            ("loaded_cyclictest_p99_us", loaded_theirs.share(0.99)),
            ("loaded_p99_ratio_to_cyclictest", ratio(loaded, loaded_theirs)),
        ];
        println!("{}", rig::object(&fields));
        return;
    }
    println!("servo_jitter: lateness of the servo's thread, 2 ms, {rounds} rounds of 1 s each, us");
    println!("{:36} {:>8} {:>8} {:>8} {:>9} {:>7}", "", "p50", "p99", "p99.9", "max", "missed");
    for kind in kinds.iter().filter(|kind| !kind.late.is_empty()) {
        println!(
            "{:36} {:8.1} {:8.1} {:8.1} {:9.1} {:>7}",
            name(kind),
            rig::us(&kind.late, 0.5),
            rig::us(&kind.late, 0.99),
            rig::us(&kind.late, 0.999),
            rig::us(&kind.late, 1.0),
            if kind.what == What::Cyclictest { "-".to_owned() } else { kind.missed.to_string() },
        );
    }
    for (ours, theirs) in [(quiet, theirs), (spun, theirs), (loaded, loaded_theirs)] {
        if let Some(ratio) = ratio(ours, theirs) {
            println!("p99 of \"{}\" to cyclictest's, median of rounds: {ratio:.2}", name(ours));
        }
    }
    println!(
        "work of a period of two arms, with the hand-over to the bridge: p50 {:.1}, p99 {:.1}, \
         p99.9 {:.1} us",
        rig::us(&quiet.work, 0.5),
        rig::us(&quiet.work, 0.99),
        rig::us(&quiet.work, 0.999)
    );
    for kind in [quiet, spun] {
        println!(
            "\n{}: lateness, and jitter of the period (p99 {:.1} us)",
            name(kind),
            rig::us(&kind.jitter, 0.99)
        );
        draw(&kind.late);
    }
    println!();
    if theirs.late.is_empty() {
        println!("not compared: cyclictest is not installed (package rt-tests) or lacks rights");
    }
    // A thread of its own asks for the rights, so that this thread keeps its ordinary priority.
    let rights =
        std::thread::spawn(|| RealTime::acquire(WallOptions::default().priority, None).warnings);
    for warning in rights.join().unwrap_or_default() {
        println!("not granted: {warning}");
    }
    for fact in kernel() {
        println!("this machine: {fact}");
    }
}

/// Returns the name of a kind of round for the output.
fn name(kind: &Kind) -> String {
    format!("{}{}", kind.name, if kind.loaded { ", loaded" } else { "" })
}

/// Returns by what factor the lateness of `ours` exceeds that of `theirs`: the median, over the
/// rounds, of the ratio of their 99th percentiles. Returns `None` if either has no rounds.
fn ratio(ours: &Kind, theirs: &Kind) -> Option<f64> {
    let mut ratios: Vec<f64> =
        ours.p99.iter().zip(&theirs.p99).map(|(a, b)| a / b.max(1.0)).collect();
    ratios.sort_by(f64::total_cmp);
    ratios.get(ratios.len() / 2).copied()
}

/// Runs the servo's real-time thread for one second, with the options of an ordinary run except
/// that the thread spins for the last `spin` ns before each period. Adds the lateness of each
/// wake-up, the jitter of the period and the computing time to the histograms; returns the number
/// of missed periods.
fn servo(spin: u64, [late, jitter, work]: [&mut Histogram<u64>; 3]) -> u64 {
    let (mut links, ends): (Vec<_>, Vec<_>) = (0..2).map(|_| link()).unzip();
    let mut port = rig::Still::new();
    let switches = Arc::new(Switches::default());
    let core = Core::new(rig::configs(), ends, switches, Box::new(NoRecords), &mut port);
    let Ok(core) = core else { return 0 };
    for link in &mut links {
        let _ = link.send(rig::yielding());
    }
    let options = WallOptions { spin, missed_limit: u64::MAX, ..WallOptions::default() };
    let Ok(wall) = spawn_wall(core, port, |_, _| {}, options) else { return 0 };
    std::thread::sleep(SECOND);
    let timing = wall.stop().timing;
    let pairs = [(&timing.wake_up, late), (&timing.jitter, jitter), (&timing.work, work)];
    for (from, to) in pairs {
        for (nanos, count) in from.classes() {
            to.saturating_record_n(nanos, count);
        }
    }
    timing.missed
}

/// Runs `cyclictest` for one second, with the period and priority of the servo, and adds the
/// lateness of its wake-ups to `late`. `cyclictest` holds `/dev/cpu_dma_latency` at 0, as the servo
/// does. Without `cyclictest` on the machine `late` stays empty.
fn cyclictest(late: &mut Histogram<u64>) {
    let loops = SECOND.as_nanos() as u64 / PERIOD_NANOS;
    let done = Command::new("cyclictest")
        .args(["-q", "-m", "-t1", "-p85", "-i2000", "-h20000", &format!("-l{loops}")])
        .output();
    let Ok(out) = done else { return };
    let text = String::from_utf8_lossy(&out.stdout);
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let mut numbers = line.split_whitespace().map(str::parse::<u64>);
        if let (Some(Ok(micros)), Some(Ok(count))) = (numbers.next(), numbers.next()) {
            late.saturating_record_n(micros * 1000, count);
        }
    }
}

/// Load of one ordinary thread per core, which computes, sweeps memory and calls the system.
struct Load {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Load {
    /// Starts the threads. They end when the value is dropped.
    fn start() -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let threads = (0..cores)
            .map(|_| {
                let stop = Arc::clone(&stop);
                std::thread::spawn(move || {
                    let mut memory = vec![0u8; 4 << 20];
                    while !stop.load(Ordering::Relaxed) {
                        for byte in memory.iter_mut().step_by(64) {
                            *byte = byte.wrapping_mul(3).wrapping_add(1);
                        }
                        black_box(fs::read("/proc/self/stat").map(|text| text.len()).ok());
                    }
                })
            })
            .collect();
        Self { stop, threads }
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Prints a histogram of lateness as one bar for each half decade, from below 0.1 us up.
fn draw(late: &Histogram<u64>) {
    let mut from = 0;
    for edge in [100, 300, 1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000, u64::MAX] {
        let to = edge.min(late.high());
        let count = late.count_between(from, to.saturating_sub(1).max(from));
        let share = count as f64 / late.len().max(1) as f64;
        if count > 0 {
            let bar = "#".repeat((share * 50.0).ceil() as usize);
            println!("  < {:>9.1} us {count:6}  {bar}", to as f64 / 1000.0);
        }
        from = to;
    }
}

/// Returns facts about the machine that explain how late its threads wake up: number of cores,
/// kernel version, whether it is a real-time kernel, isolated cores and load.
fn kernel() -> Vec<String> {
    let read = |path: &str| fs::read_to_string(path).unwrap_or_default().trim().to_owned();
    let real_time = read("/sys/kernel/realtime") == "1";
    let isolated = read("/sys/devices/system/cpu/isolated");
    let cores = std::thread::available_parallelism().map_or(0, std::num::NonZero::get);
    let load = read("/proc/loadavg");
    vec![
        format!("{cores} cores, kernel {}", read("/proc/sys/kernel/osrelease")),
        format!("PREEMPT_RT: {}", if real_time { "yes" } else { "no" }),
        format!("isolated cores: {}", if isolated.is_empty() { "none" } else { &isolated }),
        format!("load at the end: {}", load.split_whitespace().next().unwrap_or("?")),
    ]
}
