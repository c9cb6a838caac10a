//! How punctual the servo thread is on this machine: the wake-up histogram of the wall driver's own loop.
//!
//! Bare `cargo bench` runs this first. It needs no rights, says which it did not get, and takes about ten
//! seconds: without the final spin as `cyclictest` would measure, and with it as the robot runs. If rt-tests is
//! installed, `cyclictest` is run in between for comparison. Nothing here can fail: on a shared virtual
//! machine the tails come from below the guest.

use hdrhistogram::Histogram;
use rubik_robot::hw::driver::{Clock, PERIOD_NANOS, RealTime};
use std::process::Command;

const PRIORITY: i32 = 85;

/// What one round measured.
struct Round {
    name: String,
    late: Histogram<u64>,
    missed: u64,
}

fn main() {
    // A filter meant for another bench, as in `cargo bench -- servo_period`.
    let filters: Vec<String> =
        std::env::args().skip(1).filter(|arg| !arg.starts_with('-')).collect();
    if !filters.is_empty() && !filters.iter().any(|f| "servo_jitter".contains(f.as_str())) {
        return;
    }
    println!("servo_jitter: lateness of a 2 ms loop, us");
    let thread = std::thread::spawn(|| {
        let rights = RealTime::acquire(PRIORITY);
        let mut rounds = Vec::new();
        for _ in 0..2 {
            rounds.push(measure("absolute sleep", 0, 1000));
            rounds.push(measure("absolute sleep, last 100 us spun", 100_000, 1000));
        }
        (merge(rounds), rights.warnings.clone())
    });
    let Ok((rounds, warnings)) = thread.join() else { return };
    println!("{:34} {:>8} {:>8} {:>8} {:>9} {:>7}", "", "p50", "p99", "p99.9", "max", "missed");
    for round in &rounds {
        print(round);
    }
    match cyclictest() {
        Some(round) => print(&round),
        None => {
            println!(
                "not compared: cyclictest is not installed (package rt-tests) or lacks rights"
            );
        }
    }
    for warning in &warnings {
        println!("not granted: {warning}");
    }
    for fact in kernel() {
        println!("this machine: {fact}");
    }
    println!();
    for round in &rounds {
        draw(round);
    }
}

fn measure(name: &str, spin: u64, periods: u64) -> Round {
    let clock = Clock;
    let mut late = empty();
    let mut missed = 0;
    let mut next = clock.now() + PERIOD_NANOS;
    for _ in 0..periods {
        clock.wait_until(next, spin);
        let now = clock.now();
        late.saturating_record(now.saturating_sub(next));
        next += PERIOD_NANOS;
        let skipped = now.saturating_sub(next).div_ceil(PERIOD_NANOS);
        missed += skipped;
        next += skipped * PERIOD_NANOS;
    }
    Round { name: name.to_owned(), late, missed }
}

/// Adds up the rounds of one name; they were interleaved so that a passing load hits all alike.
fn merge(rounds: Vec<Round>) -> Vec<Round> {
    let mut merged: Vec<Round> = Vec::new();
    for round in rounds {
        match merged.iter_mut().find(|m| m.name == round.name) {
            Some(m) => {
                let _ = m.late.add(&round.late);
                m.missed += round.missed;
            }
            None => merged.push(round),
        }
    }
    merged
}

fn empty() -> Histogram<u64> {
    Histogram::new_with_bounds(1, 1_000_000_000, 3).unwrap_or_else(|_| unreachable!("fixed bounds"))
}

fn us(nanos: u64) -> f64 {
    nanos as f64 / 1000.0
}

fn print(round: &Round) {
    let q = |q| us(round.late.value_at_quantile(q));
    println!(
        "{:34} {:8.1} {:8.1} {:8.1} {:9.1} {:7}",
        round.name,
        q(0.5),
        q(0.99),
        q(0.999),
        us(round.late.max()),
        round.missed
    );
}

fn draw(round: &Round) {
    println!("{}", round.name);
    let mut from = 0;
    for edge in [100, 300, 1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000, u64::MAX] {
        let to = edge.min(round.late.high());
        let count = round.late.count_between(from, to.saturating_sub(1).max(from));
        let share = count as f64 / round.late.len().max(1) as f64;
        if count > 0 {
            let bar = "#".repeat((share * 50.0).ceil() as usize);
            println!("  < {:>9.1} us {count:6}  {bar}", us(to));
        }
        from = to;
    }
}

/// The same period, priority and number of loops.
fn cyclictest() -> Option<Round> {
    let out = Command::new("cyclictest")
        .args(["-q", "-m", "-n", "-t1", "-p85", "-i2000", "-l1000", "-h20000"])
        .output()
        .ok()?;
    let text = String::from_utf8_lossy(&out.stdout);
    let mut late = empty();
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let mut numbers = line.split_whitespace().map(str::parse::<u64>);
        if let (Some(Ok(micros)), Some(Ok(count))) = (numbers.next(), numbers.next()) {
            late.saturating_record_n(micros * 1000, count);
        }
    }
    (!late.is_empty()).then(|| Round { name: "cyclictest".to_owned(), late, missed: 0 })
}

fn kernel() -> Vec<String> {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default().trim().to_owned();
    let real_time = read("/sys/kernel/realtime") == "1";
    let isolated = read("/sys/devices/system/cpu/isolated");
    let cores = std::thread::available_parallelism().map_or(0, std::num::NonZero::get);
    vec![
        format!("{cores} cores, kernel {}", read("/proc/sys/kernel/osrelease")),
        format!("PREEMPT_RT: {}", if real_time { "yes" } else { "no" }),
        format!("isolated cores: {}", if isolated.is_empty() { "none" } else { &isolated }),
    ]
}
