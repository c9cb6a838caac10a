//! Time of a period on the virtual driver without the plant: the driver alone, and with both arms.

use rubik_robot::hw::driver::{Core, NoRecords, Switches, link, run_virtual};
use rubik_robot::hw::port::{Port, PortFault};
use rubik_robot::servo::ServoConfig;
use rubik_robot::servo::io::{ArmDrive, ArmReading};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

mod rig;

/// Number of servo periods in a run.
const PERIODS: u64 = 100_000;

/// Measures and prints the time of a period without arms and with two arms.
fn main() {
    if !rig::is_selected("virtual") {
        return;
    }
    let alone = best(|| periods(Vec::new(), Nothing));
    let both = best(|| periods(rig::configs(), rig::Still::new()));
    if rig::json() {
        println!("{}", rig::object(&[("driver_us", Some(alone)), ("two_arms_us", Some(both))]));
        return;
    }
    println!("virtual: a period without plant, us, best of 5 runs of {PERIODS} periods");
    println!("  driver alone                     {alone:6.3}");
    println!("  with two arms in force control   {both:6.3}");
}

/// Port without arms.
struct Nothing;

impl Port for Nothing {
    fn exchange(&mut self, _: u64, _: &[ArmDrive], _: &mut [ArmReading]) -> Result<(), PortFault> {
        Ok(())
    }
}

/// Calls `run` five times and returns the least of the times that it returns, because other work on
/// the machine only adds time.
fn best(mut run: impl FnMut() -> f64) -> f64 {
    (0..5).map(|_| run()).fold(f64::INFINITY, f64::min)
}

/// Runs 100 000 servo periods under virtual time and returns the mean time of a period (us).
/// `configs` has one entry for each arm of `port`.
fn periods(configs: Vec<ServoConfig>, mut port: impl Port) -> f64 {
    let (mut links, ends): (Vec<_>, Vec<_>) = configs.iter().map(|_| link()).unzip();
    let switches = Arc::new(Switches::default());
    let mut core = Core::new(configs, ends, Arc::clone(&switches), Box::new(NoRecords), &mut port)
        .unwrap_or_else(|e| unreachable!("this port never fails: {e}"));
    for link in &mut links {
        let _ = link.send(rig::yielding());
    }
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .unwrap_or_else(|e| unreachable!("a runtime without threads or devices: {e}"));
    let begun = Instant::now();
    let done = runtime.block_on(run_virtual(&mut core, &mut port, u64::MAX, |period, _| {
        if period == PERIODS {
            switches.stop.store(true, Ordering::Release);
        }
    }));
    assert_eq!(done.ok(), Some(PERIODS));
    begun.elapsed().as_secs_f64() * 1e6 / PERIODS as f64
}
