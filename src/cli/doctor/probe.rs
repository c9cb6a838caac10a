//! Measurement of the jitter of a servo thread on this machine.
//!
//! - in: spin time, priority, duration
//! - out: lateness of each period (2 ms) of a servo thread that drives no arm

use crate::hw::driver::{Core, NoRecords, Switches, Timing, WallOptions, spawn_wall};
use crate::hw::port::{Port, PortFault};
use crate::servo::io::{ArmDrive, ArmReading};
use serde_json::json;
use std::sync::Arc;
use std::time::Duration;

/// Hardware port without arms.
struct Nothing;

impl Port for Nothing {
    fn exchange(&mut self, _: u64, _: &[ArmDrive], _: &mut [ArmReading]) -> Result<(), PortFault> {
        Ok(())
    }
}

/// Runs a servo thread without arms for `seconds`, with a real-time `priority` (`SCHED_FIFO`), and
/// returns the lateness of its periods. The thread sleeps until each period, but spins for the last
/// `spin` ns. Returns `None` if the thread cannot be started.
pub(super) fn probe(spin: u64, priority: i32, seconds: f64) -> Option<Timing> {
    let switches = Arc::new(Switches::default());
    // A core without arms has the thread of a run, and nothing to compute.
    let core =
        Core::new(Vec::new(), Vec::new(), switches, Box::new(NoRecords), &mut Nothing).ok()?;
    // The probe must measure late periods and not end because of them.
    let options = WallOptions { spin, priority, missed_limit: u64::MAX, ..WallOptions::default() };
    let wall = spawn_wall(core, Nothing, |_, _| {}, options).ok()?;
    // The thread runs by itself; this one only waits.
    std::thread::sleep(Duration::from_secs_f64(seconds));
    Some(wall.stop().timing)
}

/// Returns a jitter measurement as a line of text.
pub(super) fn words(timing: &Timing) -> String {
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

/// Returns a jitter measurement as JSON.
pub(super) fn describe(name: &str, timing: Option<&Timing>) -> serde_json::Value {
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
    use std::time::Instant;

    #[test]
    fn timing_probe_counts_missed_and_met_periods() {
        let begun = Instant::now();

        let timing = probe(0, 85, 0.2).unwrap();

        // One period takes 2 ms; on a busy machine the thread begins late, or the probe ends late.
        let most = begun.elapsed().as_millis() as u64 / 2 + 1;
        let all = timing.missed + timing.wake_up.len();
        assert!((70..=most).contains(&all), "{all} periods, at most {most}");
    }
}
