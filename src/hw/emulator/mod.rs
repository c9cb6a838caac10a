//! The emulator: a world behind the same lines as real arms, in its own process and with its own
//! clock.
//!
//! The world is any [`Port`]: the simulated plant, or the motors of a test. One thread serves all
//! lines. It steps the world every 2 ms of the wall clock, whether orders have come or not, because
//! motors do not wait.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | periods that the thread missed | `CATCHES_UP` are made up for | real axes move on meanwhile |
//! | more missed periods | counted in [`Course`] | the world was at rest meanwhile |
//! | beginning of a period | `AFTER` the arrival of orders | orders then take effect at once |
//!
//! - in: orders on serial lines (pseudo-terminals), requests of force sensors and cameras (sockets)
//! - out: answers, datagrams and frames; the [`Devices`], with which a bridge finds them
//! - A real encoder is read at the moment of the request, so counters are interpolated between two
//!   periods of the world. After a delay of the thread, the last request is answered when the world
//!   has caught up.

mod axis;
mod cameras;
mod faults;
pub mod pty;
mod sensor;
mod wired;

pub use axis::AxisController;
pub use cameras::CameraServer;
pub use faults::{At, LineFaults};
pub use sensor::COUNTS;
pub use wired::Wired;

use super::devices::{Devices, EffectorDevices};
use super::driver::{Clock, PERIOD_NANOS};
use super::port::{Port, PortFault};
use super::serial::MOST;
use super::serial::frame::{ORDER, Status};
use crate::motion::{AXES, Depth, PERIOD};
use crate::servo::io::{ArmDrive, ArmReading, JAW};
use faults::Chance;
use pty::Pty;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use sensor::Sensor;
use std::sync::atomic::{AtomicBool, Ordering};

/// Largest number of missed periods that the world catches up with.
const CATCHES_UP: u64 = 50;

/// Time from the arrival of orders to the world's next period (ns).
const AFTER: i64 = 200_000;

/// Interface of the force sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SensorKind {
    /// A box that streams datagrams.
    #[default]
    NetFt,
    /// A controller on a serial line.
    Controller,
}

/// An arm to emulate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EmulatedArm {
    /// Name of the effector.
    pub name: String,
    /// Whether the arm has an axis 0, the track.
    pub has_track: bool,
}

/// Options of an emulation.
#[derive(Debug, Clone, Default)]
pub struct EmulatorOptions {
    /// Interface of the force sensors.
    pub sensors: SensorKind,
    /// Faults of the lines.
    pub faults: LineFaults,
    /// Seed of the random faults.
    pub seed: u64,
    /// Time after the last order at which the emulation ends by itself (s); with `None` it does not
    /// end by itself.
    pub ends_after: Option<f64>,
    /// Whether the controllers have no watchdog and follow their last order for ever.
    pub no_watchdog: bool,
}

/// Account of an emulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Course {
    /// Number of periods of the world.
    pub periods: u64,
    /// Number of periods of the wall clock that the world did not catch up with.
    pub stalled: u64,
    /// Number of orders to axes.
    pub orders: u64,
}

/// Emulated lines, controllers and force sensor of an arm.
struct Arm {
    name: String,
    /// Far ends of the serial lines; `None` for an axis that does not exist or is unplugged.
    lines: [Option<Pty>; AXES + 1],
    has_track: bool,
    controllers: [AxisController; AXES + 1],
    /// Lines that have received an order since the world's last period, one bit each.
    heard: u8,
    sensor: Sensor,
    /// Whether the force sensor has fallen silent.
    silent: bool,
}

/// A world behind lines.
pub struct Emulator<P> {
    world: P,
    arms: Vec<Arm>,
    drives: Vec<ArmDrive>,
    readings: Vec<ArmReading>,
    chance: Chance,
    /// Time after the last order at which the emulation ends by itself (periods).
    ends_after: Option<u64>,
    course: Course,
    /// Periods of the first and of the last order.
    orders: Option<(u64, u64)>,
}

impl<P: Port> Emulator<P> {
    /// Opens the emulated serial lines and force sensors of these arms. `world` is the plant that
    /// moves behind them: the simulated one, at rest, or the motors of a test.
    ///
    /// # Errors
    /// Returns the error of the operating system or the fault of the plant.
    pub fn open(
        mut world: P,
        arms: &[EmulatedArm],
        options: EmulatorOptions,
    ) -> std::io::Result<Self> {
        let mut readings = vec![ArmReading::default(); arms.len()];
        let drives = vec![ArmDrive::OFF; arms.len()];
        world
            .exchange(0, &drives, &mut readings)
            .map_err(|fault| std::io::Error::other(fault.to_string()))?;
        let arms =
            arms.iter().map(|arm| Arm::open(arm, &options)).collect::<std::io::Result<Vec<_>>>()?;
        let mut this = Self {
            world,
            arms,
            drives,
            readings,
            chance: Chance::new(options.faults, options.seed),
            ends_after: options.ends_after.map(|s| (s / PERIOD) as u64),
            course: Course::default(),
            orders: None,
        };
        // The first orders are answered before the first period of the world.
        this.latch();
        Ok(this)
    }

    /// Returns the emulated lines and force sensors as the content of a devices file. It lists no
    /// cameras: their owner adds them.
    #[must_use]
    pub fn devices(&self) -> Devices {
        let effector = self
            .arms
            .iter()
            .map(|arm| EffectorDevices {
                name: arm.name.clone(),
                axes: arm
                    .lines
                    .iter()
                    .map(|line| line.as_ref().map_or(String::new(), |pty| pty.path().to_owned()))
                    .collect(),
                force: arm.sensor.device(),
                ..EffectorDevices::default()
            })
            .collect();
        Devices { emulated: true, effector, camera: Vec::new() }
    }

    /// Returns the plant behind the lines.
    #[must_use]
    pub fn world(&self) -> &P {
        &self.world
    }

    /// Answers orders and advances the plant every 2 ms until `stop` is set, or until
    /// [`EmulatorOptions::ends_after`] has passed since the last order. It calls `hook` after each
    /// period and returns the numbers of periods and orders.
    ///
    /// # Errors
    /// The fault of the plant.
    pub fn run(
        &mut self,
        stop: &AtomicBool,
        mut hook: impl FnMut(u64, &mut P),
    ) -> Result<Course, PortFault> {
        let mut next = Clock.now() + PERIOD_NANOS;
        while !stop.load(Ordering::Acquire) {
            let heard = self.serve_until(next);
            self.course.periods += 1;
            self.fail();
            self.period()?;
            hook(self.course.periods, &mut self.world);
            // Orders that came to all lines show where the bridge's periods lie.
            let shift = heard.map_or(0, |at| shift(at, next));
            next = next.saturating_add_signed(shift) + PERIOD_NANOS;
            let behind = Clock.now().saturating_sub(next) / PERIOD_NANOS;
            // Up to the limit the loop catches up by itself: the next period is already due.
            if behind > CATCHES_UP {
                self.course.stalled += behind;
                next += behind * PERIOD_NANOS;
            }
            // An emulator that has not had an order yet waits for its bridge without limit.
            let gone = |(_, last): (u64, u64)| {
                self.ends_after.is_some_and(|after| self.course.periods > last + after)
            };
            if self.orders.is_some_and(gone) {
                break;
            }
        }
        Ok(self.course)
    }

    /// Answers orders until `next`, the beginning of the plant's next period (ns). Returns the time
    /// at which the last of all lines received its order (ns), or `None` if some line received
    /// none.
    fn serve_until(&mut self, next: u64) -> Option<u64> {
        let last = next - PERIOD_NANOS;
        let mut complete = None;
        for arm in &mut self.arms {
            arm.heard = 0;
        }
        loop {
            let left = next.saturating_sub(Clock.now());
            self.wait(left);
            let now = Clock.now();
            let share = now.saturating_sub(last) as f64 / PERIOD_NANOS as f64;
            // Past the end of the period no counter is known yet, so the share stops at 1.
            self.serve(share.min(1.0), share >= 2.0);
            if complete.is_none() && self.arms.iter().all(Arm::has_heard) {
                complete = Some(now);
            }
            // Orders that came while this thread was delayed are served once before it returns.
            if left == 0 {
                return complete;
            }
        }
    }

    /// Answers at most one order of each line of all arms, when `share` (0..=1) of the plant's
    /// period has passed.
    ///
    /// If the plant is `behind` the clock, the last order of each line waits. Most likely it came
    /// when this thread was resumed, and it asks for the state of that time.
    fn serve(&mut self, share: f64, behind: bool) {
        let mut heard = 0;
        let wanted = if behind { 2 * ORDER } else { 0 };
        for arm in &mut self.arms {
            heard += arm.serve(&mut self.chance, share, wanted);
        }
        if heard > 0 {
            self.course.orders += heard;
            // Faults are due at a time after the first order, the end at a time after the last one.
            let first = self.orders.map_or(self.course.periods, |(first, _)| first);
            self.orders = Some((first, self.course.periods));
        }
    }

    /// Sleeps until a line or a sensor receives bytes, at most for `nanos` (ns).
    fn wait(&self, nanos: u64) {
        let Some(some) = self.arms.first() else { return };
        // The array has a fixed size, and its unused entries repeat a sensor without being polled.
        let mut count = 0;
        let mut fds: [PollFd<'_>; MOST] =
            std::array::from_fn(|_| PollFd::new(&some.sensor, PollFlags::IN));
        for arm in &self.arms {
            for line in arm.lines.iter().flatten() {
                fds[count] = PollFd::new(line, PollFlags::IN);
                count += 1;
            }
            fds[count] = PollFd::new(&arm.sensor, PollFlags::IN);
            count += 1;
        }
        let time = Timespec { tv_sec: 0, tv_nsec: nanos.min(999_999_999) as i64 };
        // An interruption only ends the wait early.
        let _ = poll(&mut fds[..count], Some(&time));
    }

    /// Applies the faults that are due: resets controllers, unplugs lines and silences sensors.
    fn fail(&mut self) {
        let Some((first, _)) = self.orders else { return };
        let now = self.course.periods - first;
        let faults = &mut self.chance.faults;
        let arms = &mut self.arms;
        for at in faults::due(&mut faults.resets, now) {
            arms[at.effector].controllers[at.axis].reset();
        }
        for at in faults::due(&mut faults.unplugged, now) {
            arms[at.effector].lines[at.axis] = None;
        }
        for at in faults::due(&mut faults.silenced, now) {
            arms[at.effector].silent = true;
        }
    }

    /// Computes a period of the plant, under the motor drives that result from the orders to the
    /// controllers.
    fn period(&mut self) -> Result<(), PortFault> {
        for (arm, drive) in self.arms.iter().zip(&mut self.drives) {
            *drive = self::drive(&arm.controllers, arm.has_track);
        }
        self.world.exchange(self.course.periods, &self.drives, &mut self.readings)?;
        self.latch();
        Ok(())
    }

    /// Passes the readings of the plant to the emulated controllers and sensors.
    fn latch(&mut self) {
        for (arm, reading) in self.arms.iter_mut().zip(&self.readings) {
            for axis in 0..=AXES {
                arm.controllers[axis].latch(status(reading, axis));
            }
            arm.sensor.latch(&reading.wrench_on_sensor, arm.silent, &mut self.chance);
        }
    }
}

impl<P> std::fmt::Debug for Emulator<P> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Emulator").field("course", &self.course).finish_non_exhaustive()
    }
}

impl Arm {
    /// Opens the pseudo-terminals and the force sensor of an arm.
    fn open(arm: &EmulatedArm, options: &EmulatorOptions) -> std::io::Result<Self> {
        let mut lines = [const { None }; AXES + 1];
        for (axis, line) in lines.iter_mut().enumerate() {
            if axis > 0 || arm.has_track {
                *line = Some(Pty::open()?);
            }
        }
        Ok(Self {
            name: arm.name.clone(),
            has_track: arm.has_track,
            lines,
            controllers: std::array::from_fn(|_| {
                if options.no_watchdog {
                    AxisController::without_watchdog()
                } else {
                    AxisController::default()
                }
            }),
            heard: 0,
            sensor: match options.sensors {
                SensorKind::NetFt => Sensor::net()?,
                SensorKind::Controller => Sensor::controller()?,
            },
            silent: false,
        })
    }

    /// Returns whether every line has received an order since the plant's last period.
    fn has_heard(&self) -> bool {
        (0..=AXES).all(|axis| self.lines[axis].is_none() || self.heard >> axis & 1 == 1)
    }

    /// Answers at most one order of each line of this arm, when `share` (0..=1) of the plant's
    /// period has passed; `chance` may spoil the answers. Lines on which fewer than `wanted` bytes
    /// wait are skipped. Returns the number of orders.
    fn serve(&mut self, chance: &mut Chance, share: f64, wanted: usize) -> u64 {
        let mut orders = 0;
        let mut bytes = [0; ORDER];
        for (axis, line) in self.lines.iter().enumerate() {
            let Some(line) = line else { continue };
            if wanted > 0 && line.waiting() < wanted {
                continue;
            }
            let controller = &mut self.controllers[axis];
            // One order at a time, so that the last one can wait if the world is behind.
            let length = line.read(&mut bytes);
            for byte in &bytes[..length] {
                let Some(answer) = controller.receive(*byte, share) else { continue };
                orders += 1;
                self.heard |= 1 << axis;
                let arrived = chance.answer(answer.encode());
                if arrived.is_some_and(|bytes| !line.write(&bytes)) {
                    tracing::debug!(arm = %self.name, "no program reads {}", line.path());
                }
            }
        }
        self.sensor.listen(self.silent);
        orders
    }
}

/// Returns the time to add to the length of the plant's present period (ns), so that its periods
/// come to begin soon after orders arrive. The last orders arrived at `at`, and the present period
/// began at `begun` (ns).
///
/// An order then takes effect at once, and an order that is a little late misses no period. The
/// shift is small, because a single order may be very late.
fn shift(at: u64, begun: u64) -> i64 {
    let (period, wanted) = (PERIOD_NANOS as i64, at as i64 + AFTER);
    // Only the phase matters, so the difference is taken to the nearest period.
    let behind = (wanted - begun as i64 + period / 2).rem_euclid(period) - period / 2;
    // A low-pass over 16 periods, limited to 25 us per period.
    (behind / 16).clamp(-AFTER / 8, AFTER / 8)
}

/// Returns the motor drive that results from the orders to an arm's controllers. One power relay
/// serves the whole arm: it is on if all controllers are.
fn drive(controllers: &[AxisController; AXES + 1], has_track: bool) -> ArmDrive {
    let jaw = &controllers[JAW];
    ArmDrive {
        enabled: controllers[usize::from(!has_track)..].iter().all(AxisController::is_on),
        pwm: std::array::from_fn(|i| controllers[i].width()),
        jaw_pwm: jaw.width(),
        // The lowest output of the jaw's controller moves the palm's stops.
        stops: if jaw.outputs() & 1 == 1 { Depth::Two } else { Depth::One },
        synchronise: (0..=AXES)
            .fold(0, |bits, i| bits | u8::from(controllers[i].synchronises()) << i),
    }
}

/// Returns the state that the controller of this axis reports for this reading of the plant.
fn status(reading: &ArmReading, axis: usize) -> Status {
    let bit = |bits: u8| bits >> axis & 1 == 1;
    let count = if axis == JAW { reading.jaw_count } else { reading.counts[axis] };
    Status {
        upper: bit(reading.upper_limits),
        lower: bit(reading.lower_limits),
        sync_switch: bit(reading.sync_switches),
        sync_zero: bit(reading.encoder_zeros),
        stage_fault: bit(reading.power_faults),
        over_current: bit(reading.over_currents),
        // The controller knows its own mode; see `AxisController::answer`.
        error: false,
        synchronised: bit(reading.synchronised),
        current: (reading.currents[axis] * 1e3).round().clamp(-32768.0, 32767.0) as i16,
        count: count as i32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hw::serial::frame::{Mode, Order, Parameter};
    use crate::hw::serial::{AXIS_BAUD, Line, Lines};
    use std::time::{Duration, Instant};

    /// Simulates 4000 periods of the plant from `begin` on, with orders that arrive `arrival` after
    /// each multiple of 2 ms. Returns how long after the orders its periods begin at the end (all
    /// in ns).
    fn settled(arrival: u64, begin: u64) -> i64 {
        let mut next = begin;
        for k in 0..4000 {
            let at = k * PERIOD_NANOS + arrival;
            next = next.saturating_add_signed(shift(at, next)) + PERIOD_NANOS;
        }
        let off = next as i64 - (4000 * PERIOD_NANOS + arrival) as i64;
        let period = PERIOD_NANOS as i64;
        (off + period / 2).rem_euclid(period) - period / 2
    }

    #[test]
    fn emulator_periods_synchronise_with_incoming_orders() {
        for begin in [0, 300_000, 900_000, 1_700_000] {
            let off = settled(700_000, begin);
            assert!((off - AFTER).abs() < 10_000, "{off} ns after the orders, start at {begin} ns");
        }
    }

    /// Axes that move a hundred increments per period.
    struct Ramp;

    impl Port for Ramp {
        fn exchange(
            &mut self,
            period: u64,
            _: &[ArmDrive],
            readings: &mut [ArmReading],
        ) -> Result<(), PortFault> {
            readings[0].counts = [100 * period as i64; AXES];
            Ok(())
        }
    }

    /// Delays the emulator by 15 periods and then sends an order on a line. Returns how many
    /// periods after the beginning of the delay the plant was in the state that the answer shows;
    /// `None` if this machine itself was delayed by more than the emulator catches up with.
    fn answer_after_delay() -> Option<i64> {
        let arm = EmulatedArm { name: "arm".to_owned(), has_track: false };
        let mut emulator = Emulator::open(Ramp, &[arm], EmulatorOptions::default()).unwrap();
        let path = emulator.devices().effector[0].axes[1].clone();
        let line = Line::open(&path, AXIS_BAUD, true).unwrap();
        let mut lines = Lines::new(vec![line]);
        let order = Order::Pwm { width: 0, outputs: 0, synchronise: false }.encode();
        let stop = AtomicBool::new(false);
        let (mut asked, mut count) = (0, None);

        let course = emulator
            .run(&stop, |period, _| {
                if period == 5 {
                    lines.send(0, &order);
                } else if period == 10 {
                    std::thread::sleep(Duration::from_millis(30));
                    lines.send(0, &order);
                    asked = period;
                } else if period > 10 {
                    lines.gather(Instant::now());
                    count = lines.answer(0).map(|answer| Status::decode(answer).count);
                    stop.store(count.is_some() || period > 1000, Ordering::Release);
                }
            })
            .unwrap();

        (course.stalled == 0).then(|| i64::from(count.unwrap()) / 100 - asked as i64)
    }

    /// The emulator is delayed. A request that arrives at the end of the delay is answered with the
    /// state at the end, not with the state at the beginning.
    #[test]
    fn request_after_emulator_delay_gets_current_state() {
        let periods = (0..20).find_map(|_| answer_after_delay()).unwrap();
        assert!(periods >= 12, "{periods} of 15");
    }

    /// An arm that remembers whether its drives are on.
    #[derive(Default)]
    struct Drives {
        on: bool,
    }

    impl Port for Drives {
        fn exchange(
            &mut self,
            _: u64,
            drives: &[ArmDrive],
            _: &mut [ArmReading],
        ) -> Result<(), PortFault> {
            self.on = drives[0].enabled;
            Ok(())
        }
    }

    /// Returns whether an arm's drives are still on 100 ms after they came on, without an order
    /// meanwhile; `None` if they never came on.
    fn on_after_silence(options: EmulatorOptions) -> Option<bool> {
        let arm = EmulatedArm { name: "arm".to_owned(), has_track: false };
        let mut emulator = Emulator::open(Drives::default(), &[arm], options).unwrap();
        let axes = emulator.devices().effector[0].axes.clone();
        let open = |path: &String| Line::open(path, AXIS_BAUD, true).unwrap();
        let mut lines = Lines::new(axes.iter().skip(1).map(open).collect());
        let order = Order::Set(Parameter::Mode(Mode::Pwm)).encode();
        let stop = AtomicBool::new(false);
        let (mut since, mut still) = (None, None);

        emulator
            .run(&stop, |period, world| {
                if period == 5 {
                    (0..lines.len()).for_each(|line| lines.send(line, &order));
                }
                if world.on {
                    since.get_or_insert(period);
                }
                if since.is_some_and(|since| period == since + 50) {
                    still = Some(world.on);
                }
                stop.store(still.is_some() || period > 1000, Ordering::Release);
            })
            .unwrap();
        still
    }

    #[test]
    fn arm_without_orders_brakes_by_its_watchdog() {
        let no_watchdog = EmulatorOptions { no_watchdog: true, ..EmulatorOptions::default() };

        assert_eq!(on_after_silence(EmulatorOptions::default()), Some(false));
        assert_eq!(on_after_silence(no_watchdog), Some(true));
    }

    #[test]
    fn one_late_order_hardly_shifts_the_periods() {
        let begun = 10 * PERIOD_NANOS;
        let usual = begun - AFTER as u64;

        assert_eq!(shift(usual, begun), 0);
        assert!(shift(usual + 900_000, begun).abs() <= AFTER / 8);
    }
}
