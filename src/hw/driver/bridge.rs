//! The bridge thread: it owns the port, so that the servo thread never waits for a device.
//!
//! Drives go over by a ring, the latest readings come back by a triple buffer. The exchange of period k takes
//! place within that period, so its readings are there for period k + 1, just as on the virtual driver.
//! The hook after each exchange (scenes, the witness) costs this thread's time, never the servo's.

use super::realtime::RealTime;
use crate::hw::port::{Port, PortFault};
use crate::motion::AXES;
use crate::servo::io::{ArmDrive, ArmReading};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, Thread};
use std::time::{Duration, Instant};

/// The most effectors that cross a bridge: what crosses has a fixed size.
const MOST: usize = 4;

/// Time without drives after which the arms are switched off: the servo is stuck.
const SILENCE: Duration = Duration::from_millis(200);

/// Time without drives after which controllers may have stopped by themselves.
const STALL: Duration = Duration::from_millis(40);

/// Time after a stall in which it may be the cause of a fault: lines believe a controller's error mode the second time.
const LATELY: Duration = Duration::from_millis(40);

#[derive(Debug, Clone, Copy)]
struct Drives {
    period: u64,
    drives: [ArmDrive; MOST],
}

impl Drives {
    /// These in place of `earlier` ones that nobody carried out; what may not be left out of those stays.
    fn instead_of(mut self, earlier: &Self) -> Self {
        for (drive, earlier) in self.drives.iter_mut().zip(&earlier.drives) {
            drive.enabled &= earlier.enabled;
            drive.synchronise |= earlier.synchronise;
        }
        self
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Readings {
    period: u64,
    readings: [ArmReading; MOST],
}

/// The running bridge thread.
#[derive(Debug)]
pub struct Bridge<P> {
    thread: Option<JoinHandle<(P, Option<PortFault>)>>,
    /// The run is over: nobody insists any more.
    over: Arc<AtomicBool>,
}

/// The servo's side of the bridge: it never waits.
#[derive(Debug)]
pub struct BridgePort {
    drives: rtrb::Producer<Drives>,
    readings: triple_buffer::Output<Readings>,
    broken: Arc<AtomicBool>,
    bridge: Thread,
    /// Periods in which no new reading was there.
    late: u64,
    late_in_a_row: u64,
    /// New readings in a row that all were late, by a few periods only.
    steadily_late: u64,
    /// Periods since readings were last there to be judged.
    unjudged: u64,
    /// New readings of which it is not known in how many periods their steps were made, and how many more of these, which were
    /// missed, it may have been.
    unsure: u32,
    missed: u64,
    /// The latest readings, and how far each counter goes in a period, the jaw's last.
    seen: Readings,
    steps: [[i64; AXES + 1]; MOST],
    length: u64,
}

impl<P: Port + 'static> Bridge<P> {
    /// Starts the thread under `SCHED_FIFO` at `priority`, if it may. `first` are the readings of period 0,
    /// `length` that of a period [ns]; `hook` is called after each exchange.
    ///
    /// # Errors
    /// What the operating system says.
    ///
    /// # Panics
    /// For more than four effectors.
    pub fn spawn(
        mut port: P,
        first: &[ArmReading],
        priority: i32,
        length: u64,
        mut hook: impl FnMut(u64, &mut P) + Send + 'static,
    ) -> std::io::Result<(Self, BridgePort)> {
        assert!(first.len() <= MOST, "at most {MOST} effectors");
        let arms = first.len();
        let mut start = Readings::default();
        start.readings[..arms].copy_from_slice(first);
        let (drives, mut incoming) = rtrb::RingBuffer::<Drives>::new(64);
        let (mut outgoing, readings) = triple_buffer::triple_buffer(&start);
        let broken = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&broken);
        let over = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&over);
        let give_up = move |mut port: P, fault: PortFault| {
            flag.store(true, Ordering::Release);
            while !ends.load(Ordering::Acquire) {
                port.insist();
                std::thread::park_timeout(Duration::from_nanos(length));
            }
            (port, Some(fault))
        };
        let work = move || {
            // What is denied here was denied to the servo too, which reports it.
            let _rights = RealTime::acquire(priority, None);
            let mut latest = start;
            // No order has gone out before the first one: the arms are not driven while the servo gets its rights.
            let (mut heard, mut driven) = (Instant::now(), None::<Instant>);
            let mut stall: Option<(Instant, Duration)> = None;
            loop {
                let Ok(mut next) = incoming.pop() else {
                    let gone = incoming.is_abandoned();
                    if gone || heard.elapsed() > SILENCE {
                        let gap = driven.map_or(Duration::ZERO, |at| at.elapsed());
                        // Nobody drives the arms any more: brakes on.
                        let drives = [ArmDrive::OFF; MOST];
                        let readings = &mut latest.readings[..arms];
                        let off = port.exchange(latest.period + 1, &drives[..arms], readings);
                        match off {
                            Err(mut fault) => {
                                fault.reason += &stalled(gap);
                                return give_up(port, fault);
                            }
                            Ok(()) if gone => return (port, None),
                            Ok(()) => driven = Some(Instant::now()),
                        }
                        heard = Instant::now();
                    }
                    std::thread::park_timeout(Duration::from_millis(10));
                    continue;
                };
                let now = Instant::now();
                let gap = driven.map_or(Duration::ZERO, |at| now - at);
                (heard, driven) = (now, Some(now));
                if gap > STALL {
                    stall = Some((now, gap));
                }
                while !port.each_counts()
                    && let Ok(newer) = incoming.pop()
                {
                    next = newer.instead_of(&next);
                }
                let Drives { period, drives } = next;
                let readings = &mut latest.readings[..arms];
                if let Err(mut fault) = port.exchange(period, &drives[..arms], readings) {
                    let lately = stall.filter(|(since, _)| since.elapsed() < LATELY);
                    fault.reason += &stalled(lately.map_or(Duration::ZERO, |(_, gap)| gap));
                    return give_up(port, fault);
                }
                latest.period = period;
                outgoing.write(latest);
                hook(period, &mut port);
            }
        };
        let thread = std::thread::Builder::new().name("bridge".into()).spawn(work)?;
        let bridge = thread.thread().clone();
        let port = BridgePort::new(drives, readings, broken, bridge, start, length);
        Ok((Self { thread: Some(thread), over }, port))
    }
}

impl<P> Bridge<P> {
    /// Waits for the thread, which ends when the servo's side is dropped or the port fails; returns the port
    /// and its fault. `None` when the thread panicked.
    #[must_use]
    pub fn join(mut self) -> Option<(P, Option<PortFault>)> {
        self.end()?.join().ok()
    }

    fn end(&mut self) -> Option<JoinHandle<(P, Option<PortFault>)>> {
        self.over.store(true, Ordering::Release);
        let thread = self.thread.take()?;
        thread.thread().unpark();
        Some(thread)
    }
}

impl<P> Drop for Bridge<P> {
    fn drop(&mut self) {
        self.end();
    }
}

impl BridgePort {
    /// Time without a new reading after which the bridge counts as lost [ns]. The original's 10 ms would
    /// trip wherever an ordinary user's threads wait for a busy processor.
    const LOST: u64 = 100_000_000;

    /// Periods for which a counter is taken to go on as before while readings are late. An axis that stands still
    /// for a period and then goes twice as far would make its regulator brake fully in between, which trips a power
    /// stage at speed.
    const GOES_ON: u64 = 10;
    /// Periods by which readings may be late where a bridge is late steadily: what is carried on farther is off by more than
    /// watch-dogs allow for.
    const CLOSE: u64 = 3;
    /// Steps over which their mean is taken, about: what was read late and then early tells nothing of the speed.
    const STEPS: i64 = 3;
    /// New readings after missed periods that may show what the axes went in these: one that was not fetched yet, one of an
    /// exchange that had begun, and the one behind it.
    const UNSURE: u32 = 3;

    fn new(
        drives: rtrb::Producer<Drives>,
        readings: triple_buffer::Output<Readings>,
        broken: Arc<AtomicBool>,
        bridge: Thread,
        start: Readings,
        length: u64,
    ) -> Self {
        Self {
            drives,
            readings,
            broken,
            bridge,
            late: 0,
            late_in_a_row: 0,
            steadily_late: 0,
            unjudged: 0,
            unsure: 0,
            missed: 0,
            seen: start,
            steps: [[0; AXES + 1]; MOST],
            length,
        }
    }

    /// So many periods were missed before the next one. Readings are numbered by periods, and these have no numbers.
    pub fn skipped(&mut self, missed: u64) {
        self.unjudged += missed;
        self.missed = self.missed.max(missed);
        self.unsure = Self::UNSURE;
        // The first ones may be off. Judged they are again soon: points may be missed again and again.
        self.steadily_late = self.steadily_late.min(Self::GOES_ON - u64::from(Self::UNSURE));
    }

    /// At the beginning of period `period`: copies the latest readings, those of the period before; late ones are
    /// carried on by the counters' last steps.
    ///
    /// # Errors
    /// The bridge has failed or been silent for 0.1 s.
    pub fn fetch(&mut self, period: u64, readings: &mut [ArmReading]) -> Result<(), BridgeLost> {
        let mut latest = *self.readings.read();
        let fresh = latest.period + 1 == period;
        let new = latest.period > self.seen.period;
        if new {
            self.learn(&mut latest);
        }
        readings.copy_from_slice(&self.seen.readings[..readings.len()]);
        // A bridge that is always a period behind is late, but not silent.
        self.late_in_a_row = if new || fresh { 0 } else { self.late_in_a_row + 1 };
        let late_by = period.saturating_sub(self.seen.period + 1);
        let late = late_by > 0;
        self.steadily_late =
            if late && late_by <= Self::CLOSE { self.steadily_late + u64::from(new) } else { 0 };
        // After ones that were read in time it is carried on for a while and judged when it is read again. Where all of them
        // are late, or have been late for long, they are what there is to judge: watch-dogs that looked away would do so for
        // ever.
        self.unjudged += 1;
        let waits = self.unjudged * self.length <= Self::LOST;
        let judged = !late || new && (self.steadily_late > Self::GOES_ON || !waits);
        if judged {
            self.unjudged = 0;
        }
        let behind = late_by.min(Self::GOES_ON) as i64;
        for (reading, steps) in readings.iter_mut().zip(&self.steps) {
            for (count, step) in reading.counts.iter_mut().zip(steps) {
                *count += behind * step;
            }
            reading.jaw_count += behind * steps[AXES];
            if !judged {
                reading.guessed = u8::MAX;
            }
            // One that is always a period behind has news in each, and they are carried on.
            if !new {
                reading.unheard = u8::MAX;
                // Once is once: neither a mean nor a zero is made of what was told before.
                reading.wrench_is_old = true;
            }
        }
        self.late += u64::from(!fresh);
        if self.broken.load(Ordering::Acquire) || self.late_in_a_row * self.length > Self::LOST {
            return Err(BridgeLost { periods: self.late_in_a_row });
        }
        Ok(())
    }

    /// How fast each counter goes, by the readings that have come.
    fn learn(&mut self, latest: &mut Readings) {
        // What nobody fetched in time may have begun when nothing came.
        let numbers = latest.period - self.seen.period;
        let periods = numbers.max(self.late_in_a_row + 1) as i64;
        if self.unsure == 0 {
            self.missed = 0;
        }
        self.unsure = self.unsure.saturating_sub(1);
        let most = periods + self.missed as i64;
        let pairs = latest.readings.iter_mut().zip(&self.seen.readings);
        for (steps, (now, before)) in self.steps.iter_mut().zip(pairs) {
            // One that came between two fetches is not lost.
            if now.wrench_on_sensor.is_finite() && now.wrench_on_sensor != before.wrench_on_sensor {
                now.wrench_is_old = false;
            }
            let zeroed = now.synchronised & !before.synchronised;
            for (i, mean) in steps.iter_mut().enumerate() {
                if zeroed & (1 << i) != 0 {
                    // The counter was set, the axis has gone nowhere.
                    *mean = 0;
                    continue;
                }
                let gone = counter(now, i) - counter(before, i);
                // Where missed periods may have been a part of it, what agrees with the mean of before changes nothing.
                let (fast, slow) = (gone / periods, gone / most);
                let step = (*mean).clamp(fast.min(slow), fast.max(slow));
                let change = step - *mean;
                // By one at least: a counter that stands has no mean of two that is left over.
                *mean +=
                    if change / Self::STEPS == 0 { change.signum() } else { change / Self::STEPS };
            }
        }
        self.seen = *latest;
    }

    /// Hands over the drives of period `period`; what the bridge has no room for is left out.
    pub fn send(&mut self, period: u64, drives: &[ArmDrive]) {
        let mut all = Drives { period, drives: [ArmDrive::OFF; MOST] };
        all.drives[..drives.len()].copy_from_slice(drives);
        let _ = self.drives.push(all);
        self.bridge.unpark();
    }

    /// Periods in which no new reading was there.
    #[must_use]
    pub fn late(&self) -> u64 {
        self.late
    }
}

/// What a fault is to be judged by where nothing was ordered for long before it: controllers stop by themselves then.
fn stalled(gap: Duration) -> String {
    if gap > STALL {
        format!("; before that this machine sent nothing for {} ms", gap.as_millis())
    } else {
        String::new()
    }
}

/// Counter of an axis, the jaw's last.
fn counter(reading: &ArmReading, axis: usize) -> i64 {
    reading.counts.get(axis).copied().unwrap_or(reading.jaw_count)
}

/// The bridge does not answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no reading from the bridge for {periods} periods")]
pub struct BridgeLost {
    /// How long.
    pub periods: u64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{ArmFault, MotorPositions};
    use crate::servo::period::Length;
    use crate::servo::regulator::{IRP6, ServoGains};
    use crate::servo::watch::{Wanted, Watch};
    use crate::spatial::Wrench;
    use std::sync::Mutex;

    /// The servo's side alone, and where a bridge would put its readings.
    fn port() -> (triple_buffer::Input<Readings>, BridgePort) {
        let (drives, _) = rtrb::RingBuffer::<Drives>::new(64);
        let start = Readings::default();
        let (outgoing, readings) = triple_buffer::triple_buffer(&start);
        let bridge = std::thread::current();
        let port = BridgePort::new(drives, readings, Arc::default(), bridge, start, 2_000_000);
        (outgoing, port)
    }

    fn read(period: u64, count: i64, synchronised: u8) -> Readings {
        let mut readings = Readings { period, ..Readings::default() };
        readings.readings[0].counts[3] = count;
        readings.readings[0].synchronised = synchronised;
        readings
    }

    fn fetched(port: &mut BridgePort, period: u64) -> Result<ArmReading, BridgeLost> {
        let mut readings = [ArmReading::default()];
        port.fetch(period, &mut readings).map(|()| readings[0])
    }

    #[test]
    fn a_counter_that_is_read_late_goes_on_for_ten_periods_and_is_said_to_be_guessed() {
        let (mut bridge, mut servo) = port();
        for period in 1..=40 {
            bridge.write(read(period, 90 * period as i64, u8::MAX));
            let reading = fetched(&mut servo, period + 1).unwrap();
            assert_eq!((reading.guessed, reading.unheard), (0, 0));
            assert!(!reading.wrench_is_old);
        }

        let guesses: Vec<_> = (42..62).map(|p| fetched(&mut servo, p).unwrap()).collect();

        let steps: Vec<_> = guesses.windows(2).map(|g| g[1].counts[3] - g[0].counts[3]).collect();
        assert!(steps[..9].iter().all(|step| (80..=90).contains(step)), "{steps:?}");
        assert!(steps[9..].iter().all(|step| *step == 0), "{steps:?}");
        assert!(guesses.iter().all(|g| g.guessed == u8::MAX && g.unheard == u8::MAX));
        assert!(guesses.iter().all(|g| g.wrench_is_old), "what was told once is no new sample");
    }

    #[test]
    fn a_bridge_that_is_always_a_period_behind_is_heard_in_each_and_soon_judged_by_what_it_reads() {
        let (mut bridge, mut servo) = port();
        for period in 1..=10 {
            bridge.write(read(period, 90 * period as i64, u8::MAX));
            let reading = fetched(&mut servo, period + 2).unwrap();
            assert_eq!((reading.guessed, reading.unheard), (u8::MAX, 0));
        }
        let mut counts = vec![];
        for period in 11..=60 {
            // Two periods at a time, as of a line that is slower than the servo: every other one brings nothing.
            let new = period < 40 || period % 2 == 0;
            if new {
                bridge.write(read(period, 90 * period as i64, u8::MAX));
            }
            let reading = fetched(&mut servo, period + 2).unwrap();
            let bits = if new { 0 } else { u8::MAX };
            assert_eq!((reading.guessed, reading.unheard), (bits, bits), "{period}");
            counts.push(reading.counts[3]);
        }
        // Not a step that watch-dogs would take for a jump, at its end neither.
        bridge.write(read(62, 90 * 62, u8::MAX));
        counts.push(fetched(&mut servo, 63).unwrap().counts[3]);
        assert!(counts.windows(2).all(|c| (80..=100).contains(&(c[1] - c[0]))), "{counts:?}");

        // What is late by chance is not judged.
        bridge.write(read(63, 90 * 63, u8::MAX));
        let reading = fetched(&mut servo, 65).unwrap();
        assert_eq!((reading.guessed, reading.unheard), (u8::MAX, 0));
    }

    #[test]
    fn the_first_reading_after_a_silence_is_not_judged_however_late_the_ones_before_it_were() {
        for late in [0, 1] {
            for stall in [4, 11, 20, 40] {
                for left in [1, 2, 15] {
                    let (mut bridge, mut servo) = port();
                    for period in 1..=40 {
                        bridge.write(read(period, 90 * period as i64, u8::MAX));
                        fetched(&mut servo, period + 1 + late).unwrap();
                    }
                    let from = 42 + late;
                    for period in from..from + stall {
                        fetched(&mut servo, period).unwrap();
                    }
                    // Caught up with but for some.
                    let period = from + stall - 1 - left.min(stall - 2);
                    bridge.write(read(period, 90 * period as i64, u8::MAX));
                    let reading = fetched(&mut servo, from + stall).unwrap();
                    let case = format!("{late} before, {stall} periods, {left} left");
                    assert_eq!((reading.guessed, reading.unheard), (u8::MAX, 0), "{case}");
                }
            }
        }
    }

    /// A servo and a bridge whose exchanges take their time, with a machine that stands still; times in periods.
    struct Machine<E> {
        /// How long an exchange takes, by the period in which it begins, and at which share of that time counters are read.
        exchange: E,
        sampled: f64,
        /// When both threads stand still, for how long, and how often: every so many periods.
        stands: (f64, f64, f64),
        /// Speed of a motor [rad/s], and from when on it is another one than its set value's.
        speed: f64,
        runaway: (f64, f64),
    }

    impl<E: Fn(u64) -> f64> Machine<E> {
        const INCREMENTS: f64 = 4000.0;
        const PERIODS: u64 = 600;

        /// How far the motor has gone [rad].
        fn motor(&self, time: f64) -> f64 {
            let (from, speed) = self.runaway;
            (self.speed * time.min(from) + speed * (time - from).max(0.0)) * 0.002
        }

        /// The first fault of a watch-dog and when it comes, and the longest time in which nothing is judged.
        fn runs(&self) -> (Option<(f64, ArmFault)>, f64) {
            let (mut bridge, mut servo) = port();
            let gains = ServoGains::parse(IRP6).unwrap();
            let mut watch = Watch::new(&gains, [0; AXES], Length::default());
            let radian = Self::INCREMENTS / std::f64::consts::TAU;
            let (first, stands, every) = self.stands;
            let frozen = |begun: f64, end: f64| {
                let stand = first + every * ((begun - first) / every).ceil().max(0.0);
                if begun <= stand && stand < end { end + stands } else { end }
            };
            // The exchange that goes on: its number, when its counters are read, when it ends.
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
                    bridge.write(read(number, count, u8::MAX));
                    // It goes on with the newest order that was there then.
                    going = (number + 1 < period).then(|| begin(period - 1, end));
                }
                next += 1.0;
                let missed = if now < next { 0.0 } else { (now - next).floor() + 1.0 };
                if missed > 0.0 {
                    next += missed;
                    servo.skipped(missed as u64);
                    watch.skipped(missed as u64);
                }
                let reading = fetched(&mut servo, period).unwrap();
                if reading.guessed == 0 {
                    judged = now;
                }
                unjudged = unjudged.max(now - judged);
                let told = if now <= self.runaway.0 { self.speed * 0.002 } else { 0.0 };
                let (mut measured, mut wanted) =
                    (MotorPositions::default(), MotorPositions::default());
                let (mut steps, mut owed) = ([0.0; AXES], [0.0; AXES]);
                measured.0[3] = reading.counts[3] as f64 / radian;
                // What was gone in missed periods is owed.
                let behind = now.min(self.runaway.0).floor() - period as f64;
                (owed[3], steps[3]) = (behind.max(0.0) * self.speed * 0.002, told);
                wanted.0[3] = set;
                set += told;
                let wanted = Wanted { set: &wanted, steps: &steps, owed: &owed };
                let fault = watch.check(&reading, &measured, &wanted, 1, &[Self::INCREMENTS; AXES]);
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

    /// Lengths of exchanges, and of a long one among them [periods].
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

    /// How long the machine stands still, and how often [periods].
    const STALLS: [(f64, f64); 6] =
        [(0.0, 1e9), (1.5, 1e9), (4.5, 1e9), (9.5, 1e9), (18.5, 1e9), (1.5, 9.25)];

    #[test]
    fn late_exchanges_and_stalls_are_no_fault_of_an_axis_and_do_not_hide_it_for_long() {
        for (usual, long) in LENGTHS {
            for sampled in [0.05, 0.5, 0.95] {
                for speed in [60.0, 150.0, 250.0] {
                    for (stands, every) in STALLS {
                        for phase in 0..8 {
                            let machine = Machine {
                                exchange: |number| if number % 37 == 0 { long } else { usual },
                                sampled,
                                stands: (120.0 + f64::from(phase) / 8.0, stands, every),
                                speed,
                                runaway: (f64::INFINITY, 0.0),
                            };
                            let (fault, unjudged) = machine.runs();
                            let case = format!(
                                "{usual} or {long}, read at {sampled}, {speed} rad/s, {stands} of stall every {every}, phase {phase}"
                            );
                            assert_eq!(fault, None, "{case}");
                            assert!(
                                unjudged <= 65.0 + stands,
                                "{unjudged} periods unjudged: {case}"
                            );
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn an_axis_that_runs_away_is_found_however_late_exchanges_are() {
        for (usual, long) in LENGTHS {
            for (runaway, (stands, every)) in
                [60.0, 240.0].into_iter().flat_map(|runaway| STALLS.map(|stall| (runaway, stall)))
            {
                let from = 250.0;
                let machine = Machine {
                    exchange: |number| if number % 37 == 0 { long } else { usual },
                    sampled: 0.5,
                    stands: (120.0, stands, every),
                    speed: 100.0,
                    runaway: (from, runaway),
                };
                let (fault, _) = machine.runs();
                let case = format!(
                    "{usual} or {long}, {stands} of stall every {every}, {runaway} rad/s: {fault:?}"
                );
                let (found, _) = fault.expect(&case);
                let gone = runaway * 0.002 * (found - from);
                // Where it is judged every tenth of a second only, it may have gone on for two of these as it was told.
                let unjudged = if usual > 2.0 { 26.0 + 51.0 * 0.002 * runaway } else { 0.0 };
                assert!(found > from && gone < 16.0 + unjudged, "{gone} rad: {case}");
            }
        }
    }

    #[test]
    fn a_wrench_that_comes_between_two_fetches_is_not_lost() {
        let (mut bridge, mut servo) = port();
        let told = |period, newtons, wrench_is_old| {
            let mut readings = read(period, 0, 0);
            readings.readings[0].wrench_on_sensor =
                Wrench::from_directions([newtons, 0.0, 0.0, 0.0, 0.0, 0.0]);
            readings.readings[0].wrench_is_old = wrench_is_old;
            readings
        };
        bridge.write(told(1, 1.0, false));
        assert!(!fetched(&mut servo, 2).unwrap().wrench_is_old);
        bridge.write(told(2, 2.0, false));
        bridge.write(told(3, 2.0, true));
        assert!(!fetched(&mut servo, 4).unwrap().wrench_is_old);
        bridge.write(told(4, 2.0, true));
        assert!(fetched(&mut servo, 5).unwrap().wrench_is_old);
    }

    #[test]
    fn a_counter_that_stands_is_carried_on_nowhere() {
        let (mut bridge, mut servo) = port();
        for period in 1..=60 {
            bridge.write(read(period, 90 * period.min(30) as i64, u8::MAX));
            fetched(&mut servo, period + 2).unwrap();
        }
        assert_eq!(fetched(&mut servo, 66).unwrap().counts[3], 90 * 30);
    }

    #[test]
    fn a_counter_that_is_set_at_its_zero_has_gone_nowhere() {
        let (mut bridge, mut servo) = port();
        for period in 1..=20 {
            bridge.write(read(period, 50_000, 0));
            fetched(&mut servo, period + 1).unwrap();
        }
        bridge.write(read(21, 12, 1 << 3));
        assert_eq!(fetched(&mut servo, 22).unwrap().counts[3], 12);

        assert_eq!(fetched(&mut servo, 23).unwrap().counts[3], 12);
    }

    #[test]
    fn a_bridge_is_lost_after_a_tenth_of_a_second_without_readings_and_not_for_being_a_period_behind()
     {
        let (mut bridge, mut servo) = port();
        for period in 1..=200 {
            bridge.write(read(period, 0, 0));
            fetched(&mut servo, period + 2).unwrap();
        }
        assert_eq!(servo.late(), 200);

        let lost = (203..400).find(|period| fetched(&mut servo, *period).is_err());

        assert_eq!(lost, Some(203 + 50));
    }

    /// Answers until it is told to stop for the second time, as a line does whose controller has stopped by itself.
    #[derive(Default)]
    struct Stopped(u32);

    impl Port for Stopped {
        fn exchange(
            &mut self,
            _: u64,
            drives: &[ArmDrive],
            _: &mut [ArmReading],
        ) -> Result<(), PortFault> {
            self.0 += u32::from(!drives[0].enabled);
            let reason = "in its error mode".to_owned();
            if self.0 < 2 { Ok(()) } else { Err(PortFault { effector: 0, reason }) }
        }
    }

    #[test]
    fn a_fault_after_a_stall_of_this_machine_is_said_to_come_after_it() {
        let first = [ArmReading::default()];
        let (bridge, mut servo) =
            Bridge::spawn(Stopped::default(), &first, 6, 2_000_000, |_, _| ()).unwrap();
        servo.send(1, &[ArmDrive { enabled: true, ..ArmDrive::OFF }]);

        let fault = bridge.join().unwrap().1.unwrap();

        assert!(fault.reason.contains("error mode; before that this machine sent nothing for"));
    }

    #[test]
    fn so_is_one_of_the_first_order_after_it_and_one_without_a_stall_is_not() {
        let first = [ArmReading::default()];
        let fails_after = |pause: Duration| {
            let heard = Arc::new(AtomicBool::new(false));
            let hears = Arc::clone(&heard);
            let hook = move |_, _: &mut Stopped| hears.store(true, Ordering::Release);
            let (bridge, mut servo) =
                Bridge::spawn(Stopped::default(), &first, 6, 2_000_000, hook).unwrap();
            let begun = Instant::now();
            servo.send(1, &[ArmDrive { enabled: true, ..ArmDrive::OFF }]);
            while !heard.load(Ordering::Acquire) {
                assert!(begun.elapsed() < Duration::from_secs(30), "it never hears");
                std::thread::sleep(Duration::from_millis(1));
            }
            std::thread::sleep(pause);
            servo.send(2, &[ArmDrive::OFF]);
            servo.send(3, &[ArmDrive::OFF]);
            let reason = bridge.join().unwrap().1.unwrap().reason;
            (reason.contains("sent nothing for"), begun.elapsed())
        };

        assert!(fails_after(STALL + Duration::from_millis(20)).0);
        let (said, lasted) = fails_after(Duration::from_millis(5));
        assert!(!said || lasted > STALL, "after {lasted:?}");
    }

    #[test]
    fn an_order_to_switch_off_that_was_overtaken_stays() {
        let on = ArmDrive { enabled: true, ..ArmDrive::OFF };
        let zero = ArmDrive { synchronise: 1 << 2, ..on };
        let of = |drive| Drives { period: 1, drives: [drive; MOST] };

        assert!(!of(on).instead_of(&of(ArmDrive::OFF)).drives[0].enabled);
        assert!(!of(ArmDrive::OFF).instead_of(&of(on)).drives[0].enabled);
        assert_eq!(of(on).instead_of(&of(zero)).drives[3].synchronise, 1 << 2);
    }

    /// When it was told to drive or to stop.
    #[derive(Clone, Default)]
    struct Told(Arc<Mutex<Vec<(Instant, bool)>>>);

    impl Port for Told {
        fn exchange(
            &mut self,
            _: u64,
            drives: &[ArmDrive],
            _: &mut [ArmReading],
        ) -> Result<(), PortFault> {
            self.0.lock().unwrap().push((Instant::now(), drives[0].enabled));
            Ok(())
        }
    }

    #[test]
    fn drives_go_off_when_the_servo_says_nothing_for_a_fifth_of_a_second_and_when_it_is_gone() {
        let told = Told::default();
        let first = [ArmReading::default()];
        let (bridge, mut servo) =
            Bridge::spawn(told.clone(), &first, 6, 2_000_000, |_, _| ()).unwrap();
        let on = ArmDrive { enabled: true, ..ArmDrive::OFF };
        let off = |count: usize| {
            let begun = Instant::now();
            loop {
                let told = told.0.lock().unwrap();
                // A slow start may be a silence, too.
                let driven = told.iter().skip_while(|(_, on)| !on);
                let offs: Vec<_> = driven.filter(|(_, on)| !on).map(|(at, _)| *at).collect();
                if offs.len() >= count {
                    return offs[count - 1];
                }
                drop(told);
                assert!(begun.elapsed() < Duration::from_secs(30), "it is never told to stop");
                std::thread::sleep(Duration::from_millis(5));
            }
        };

        let silent_since = Instant::now();
        servo.send(1, &[on]);
        assert!(off(1) - silent_since >= SILENCE);

        servo.send(2, &[on]);
        drop(servo);
        off(2);
        assert!(bridge.join().unwrap().1.is_none());
        assert!(told.0.lock().unwrap().last().is_some_and(|(_, on)| !on));
    }
}
