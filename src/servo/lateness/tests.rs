//! Tests of all four parts together: a servo and its bridge, with the watchdog that judges the
//! result.

use super::*;
use crate::motion::{AXES, ArmFault, MotorPositions};
use crate::servo::io::ArmReading;
use crate::servo::period::Length;
use crate::servo::regulator::{IRP6, ServoGains};
use crate::servo::watch::{Wanted, Watch};
use crate::spatial::Wrench;

/// Bridge without a thread: readings of one arm as they come, and as the servo gets them.
struct Link {
    latest: Readings,
    extrapolator: Extrapolator,
}

impl Default for Link {
    fn default() -> Self {
        let latest = Readings::default();
        Self { latest, extrapolator: Extrapolator::new(latest, 2_000_000) }
    }
}

impl Link {
    /// Replaces the latest readings of the bridge.
    fn write(&mut self, readings: Readings) {
        self.latest = readings;
    }

    /// Returns the reading of the arm as the servo gets it in `period`.
    fn fetch(&mut self, period: u64) -> ArmReading {
        let mut readings = [ArmReading::default()];
        self.extrapolator.read(period, &self.latest, &mut readings);
        assert!(!self.extrapolator.is_lost(), "in period {period}");
        readings[0]
    }
}

/// Returns readings of `period` in which the counter of axis 3 shows `count`. `synchronised` is the
/// bit mask of the synchronised axes.
fn read(period: u64, count: i64, synchronised: u8) -> Readings {
    let mut readings = Readings { period, ..Readings::default() };
    readings.arms[0].counts[3] = count;
    readings.arms[0].synchronised = synchronised;
    readings
}

#[test]
fn missing_encoder_count_is_extrapolated_for_ten_periods() {
    let mut link = Link::default();
    for period in 1..=40 {
        link.write(read(period, 90 * period as i64, u8::MAX));
        let reading = link.fetch(period + 1);
        assert_eq!((reading.extrapolated, reading.no_answer), (0, 0));
        assert!(!reading.wrench_is_old);
    }

    let late: Vec<_> = (42..62).map(|p| link.fetch(p)).collect();

    let steps: Vec<_> = late.windows(2).map(|g| g[1].counts[3] - g[0].counts[3]).collect();
    assert!(steps[..9].iter().all(|step| (80..=90).contains(step)), "{steps:?}");
    assert!(steps[9..].iter().all(|step| *step == 0), "{steps:?}");
    assert!(late.iter().all(|g| g.extrapolated == u8::MAX && g.no_answer == u8::MAX));
    assert!(late.iter().all(|g| g.wrench_is_old), "a wrench counts once");
}

#[test]
fn constantly_late_readings_are_still_checked() {
    let mut link = Link::default();
    for period in 1..=10 {
        link.write(read(period, 90 * period as i64, u8::MAX));
        let reading = link.fetch(period + 2);
        assert_eq!((reading.extrapolated, reading.no_answer), (u8::MAX, 0));
    }
    let mut counts = vec![];
    for period in 11..=60 {
        // Every other period has no new reading, as on a line that is slower than the servo.
        let new = period < 40 || period % 2 == 0;
        if new {
            link.write(read(period, 90 * period as i64, u8::MAX));
        }
        let reading = link.fetch(period + 2);
        let bits = if new { 0 } else { u8::MAX };
        assert_eq!((reading.extrapolated, reading.no_answer), (bits, bits), "{period}");
        counts.push(reading.counts[3]);
    }
    // No step looks like a jump to the watchdogs, not even the last one.
    link.write(read(62, 90 * 62, u8::MAX));
    counts.push(link.fetch(63).counts[3]);
    assert!(counts.windows(2).all(|c| (80..=100).contains(&(c[1] - c[0]))), "{counts:?}");

    // A reading that is late by chance is not judged.
    link.write(read(63, 90 * 63, u8::MAX));
    let reading = link.fetch(65);
    assert_eq!((reading.extrapolated, reading.no_answer), (u8::MAX, 0));
}

#[test]
fn first_reading_after_silence_is_not_checked() {
    for late in [0, 1] {
        for stall in [4, 11, 20, 40] {
            for left in [1, 2, 15] {
                let mut link = Link::default();
                for period in 1..=40 {
                    link.write(read(period, 90 * period as i64, u8::MAX));
                    link.fetch(period + 1 + late);
                }
                let from = 42 + late;
                for period in from..from + stall {
                    link.fetch(period);
                }
                // The bridge has caught up except for some periods.
                let period = from + stall - 1 - left.min(stall - 2);
                link.write(read(period, 90 * period as i64, u8::MAX));
                let reading = link.fetch(from + stall);
                let case = format!("{late} before, {stall} periods, {left} left");
                assert_eq!((reading.extrapolated, reading.no_answer), (u8::MAX, 0), "{case}");
            }
        }
    }
}

/// Servo and bridge with exchanges that take time, on a machine that sometimes stalls; times in
/// periods.
struct Machine<E> {
    /// Length of an exchange, by the period in which it begins, and the share of it at which
    /// counters are read.
    exchange: E,
    sampled: f64,
    /// Stalls of both threads: time of the first one, length, time from one to the next.
    stalls: (f64, f64, f64),
    /// Speed of a motor (rad/s); the time from which it differs from the speed of the set value,
    /// and the speed from then on.
    speed: f64,
    runaway: (f64, f64),
}

impl<E: Fn(u64) -> f64> Machine<E> {
    const INCREMENTS: f64 = 4000.0;
    const PERIODS: u64 = 600;

    /// Returns the angle by which the motor has turned at `time`, in periods (rad).
    fn motor(&self, time: f64) -> f64 {
        let (from, speed) = self.runaway;
        (self.speed * time.min(from) + speed * (time - from).max(0.0)) * 0.002
    }

    /// Runs the simulation. Returns the first fault of a watchdog with its time, and the longest
    /// time in which the watchdogs judged no reading (periods).
    fn run(&self) -> (Option<(f64, ArmFault)>, f64) {
        let mut link = Link::default();
        let gains = ServoGains::parse(IRP6).unwrap();
        let mut watch = Watch::new(&gains, &[Self::INCREMENTS; AXES], [0; AXES], Length::default());
        let radian = Self::INCREMENTS / std::f64::consts::TAU;
        let (first, lasts, every) = self.stalls;
        let frozen = |begun: f64, end: f64| {
            let stall = first + every * ((begun - first) / every).ceil().max(0.0);
            if begun <= stall && stall < end { end + lasts } else { end }
        };
        // The present exchange: its number, when its counters are read, when it ends.
        let mut going: Option<(u64, f64, f64)> = None;
        let (mut next, mut last, mut set) = (1.0, 0.0, 0.0);
        let (mut judged, mut unjudged) = (0.0, 0.0_f64);
        for period in 1..=Self::PERIODS {
            let now = frozen(last, next);
            last = now;
            let begin = |number: u64, at: f64| {
                let takes = (self.exchange)(number);
                (number, frozen(at, at + self.sampled * takes), frozen(at, at + takes))
            };
            while let Some((number, sampled, end)) = going.filter(|(.., end)| *end <= now) {
                let count = (self.motor(sampled) * radian).floor() as i64;
                link.write(read(number, count, u8::MAX));
                // The bridge begins its next exchange with the newest order of that time.
                going = (number + 1 < period).then(|| begin(period - 1, end));
            }
            next += 1.0;
            let missed = if now < next { 0.0 } else { (now - next).floor() + 1.0 };
            if missed > 0.0 {
                next += missed;
                link.extrapolator.add_missed_periods(missed as u64);
                watch.add_missed_periods(missed as u64);
            }
            let reading = link.fetch(period);
            if reading.extrapolated == 0 {
                judged = now;
            }
            unjudged = unjudged.max(now - judged);
            let set_step = if now <= self.runaway.0 { self.speed * 0.002 } else { 0.0 };
            let (mut measured, mut wanted) = (MotorPositions::default(), MotorPositions::default());
            let (mut steps, mut backlog) = ([0.0; AXES], [0.0; AXES]);
            measured.0[3] = reading.counts[3] as f64 / radian;
            // The distance of the missed periods is in the backlog.
            let behind = now.min(self.runaway.0).floor() - period as f64;
            (backlog[3], steps[3]) = (behind.max(0.0) * self.speed * 0.002, set_step);
            wanted.0[3] = set;
            set += set_step;
            let wanted = Wanted { set: &wanted, steps: &steps, backlog: &backlog };
            let fault = watch.check(&reading, &measured, &wanted, 1);
            if let Some(fault) = fault {
                return (Some((now, fault)), unjudged);
            }
            if going.is_none() {
                going = Some(begin(period, now));
            }
        }
        (None, unjudged)
    }
}

/// Lengths of exchanges, and of a long one among them (periods).
const LENGTHS: [(f64, f64); 9] = [
    (0.6, 0.6),
    (0.6, 3.4),
    (1.1, 1.1),
    (1.2, 3.4),
    (1.3, 1.3),
    (1.9, 2.6),
    (2.0, 2.0),
    (2.5, 2.5),
    (4.6, 9.0),
];

/// Length of a stall of the machine, and the time from one stall to the next (periods).
const STALLS: [(f64, f64); 6] =
    [(0.0, 1e9), (1.5, 1e9), (4.5, 1e9), (9.5, 1e9), (18.5, 1e9), (1.5, 9.25)];

#[test]
fn watchdog_tolerates_late_and_stalled_exchanges() {
    for (usual, long) in LENGTHS {
        for sampled in [0.05, 0.5, 0.95] {
            for speed in [60.0, 150.0, 250.0] {
                for (stands, every) in STALLS {
                    for phase in 0..8 {
                        let machine = Machine {
                            exchange: |number| if number % 37 == 0 { long } else { usual },
                            sampled,
                            stalls: (120.0 + f64::from(phase) / 8.0, stands, every),
                            speed,
                            runaway: (f64::INFINITY, 0.0),
                        };
                        let (fault, unjudged) = machine.run();
                        let case = format!(
                            "{usual} or {long}, read at {sampled}, {speed} rad/s, \
                             {stands} of stall every {every}, phase {phase}"
                        );
                        assert_eq!(fault, None, "{case}");
                        assert!(unjudged <= 65.0 + stands, "{unjudged} periods unjudged: {case}");
                    }
                }
            }
        }
    }
}

#[test]
fn watchdog_detects_runaway_despite_late_exchanges() {
    for (usual, long) in LENGTHS {
        for (runaway, (stands, every)) in
            [60.0, 240.0].into_iter().flat_map(|runaway| STALLS.map(|stall| (runaway, stall)))
        {
            let from = 250.0;
            let machine = Machine {
                exchange: |number| if number % 37 == 0 { long } else { usual },
                sampled: 0.5,
                stalls: (120.0, stands, every),
                speed: 100.0,
                runaway: (from, runaway),
            };
            let (fault, _) = machine.run();
            let case = format!(
                "{usual} or {long}, {stands} of stall every {every}, {runaway} rad/s: {fault:?}"
            );
            let (found, _) = fault.expect(&case);
            let gone = runaway * 0.002 * (found - from);
            // If a reading is judged only every 0.1 s, the motor may have run for twice that time.
            let unjudged = if usual > 2.0 { 26.0 + 51.0 * 0.002 * runaway } else { 0.0 };
            assert!(found > from && gone < 16.0 + unjudged, "{gone} rad: {case}");
        }
    }
}

#[test]
fn wrench_that_arrives_between_fetches_counts_as_new() {
    let mut link = Link::default();
    let with_wrench = |period, newtons, wrench_is_old| {
        let mut readings = read(period, 0, 0);
        readings.arms[0].wrench_on_sensor =
            Wrench::from_directions([newtons, 0.0, 0.0, 0.0, 0.0, 0.0]);
        readings.arms[0].wrench_is_old = wrench_is_old;
        readings
    };
    link.write(with_wrench(1, 1.0, false));
    assert!(!link.fetch(2).wrench_is_old);
    link.write(with_wrench(2, 2.0, false));
    link.write(with_wrench(3, 2.0, true));
    assert!(!link.fetch(4).wrench_is_old);
    link.write(with_wrench(4, 2.0, true));
    assert!(link.fetch(5).wrench_is_old);
}

#[test]
fn counter_at_rest_is_not_extrapolated() {
    let mut link = Link::default();
    for period in 1..=60 {
        link.write(read(period, 90 * period.min(30) as i64, u8::MAX));
        link.fetch(period + 2);
    }
    assert_eq!(link.fetch(66).counts[3], 90 * 30);
}

#[test]
fn zeroed_encoder_count_is_taken_over_unfiltered() {
    let mut link = Link::default();
    for period in 1..=20 {
        link.write(read(period, 50_000, 0));
        link.fetch(period + 1);
    }
    link.write(read(21, 12, 1 << 3));
    assert_eq!(link.fetch(22).counts[3], 12);

    assert_eq!(link.fetch(23).counts[3], 12);
}
