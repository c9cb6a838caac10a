//! The emulator: a world behind the same lines as real arms, in its own process, with its own clock.
//!
//! - in: orders on serial lines (pseudo-terminals), requests of force sensors and cameras (sockets)
//! - out: answers, datagrams, frames; and [`Devices`], which tell a bridge where they are
//! - one thread serves all lines and steps the world every 2 ms of the wall clock, whether orders have come or not:
//!   motors do not wait. Where it was kept from running it catches up; what is too much for that is counted
//! - an encoder is read when it is asked: between the world's periods, counters lie between theirs; what was asked last
//!   is answered when the world has caught up
//! - what the world is (the simulated plant, or a test's motors) is none of its business: any [`Port`] will do

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

/// Periods of the world that are made up for where the thread was kept from running.
const CATCHES_UP: u64 = 50;

/// From the arrival of orders to the world's next period (ns).
const AFTER: i64 = 200_000;

/// Which interface the force sensors have.
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
    /// Whether it has an axis 0.
    pub has_track: bool,
}

/// How it emulates.
#[derive(Debug, Clone, Default)]
pub struct EmulatorOptions {
    /// Force sensors.
    pub sensors: SensorKind,
    /// What goes wrong.
    pub faults: LineFaults,
    /// Seed of what goes wrong by chance.
    pub seed: u64,
    /// Ends by itself this long after the last order (s); `None` never.
    pub leaves_after: Option<f64>,
    /// Controllers without a watchdog: they follow their last order for ever.
    pub no_watchdog: bool,
}

/// How an emulation went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Course {
    /// Periods of the world.
    pub periods: u64,
    /// Periods of the wall clock in which it stood still, kept from running for too long.
    pub stalled: u64,
    /// Orders of axes.
    pub orders: u64,
}

struct Arm {
    name: String,
    lines: [Option<Pty>; AXES + 1],
    has_track: bool,
    controllers: [AxisController; AXES + 1],
    /// Lines that have had an order since the world's last period.
    heard: u8,
    sensor: Sensor,
    silent: bool,
}

/// A world behind lines.
pub struct Emulator<P> {
    world: P,
    arms: Vec<Arm>,
    drives: Vec<ArmDrive>,
    readings: Vec<ArmReading>,
    chance: Chance,
    leaves_after: Option<u64>,
    course: Course,
    /// Period of the first and the last order.
    orders: Option<(u64, u64)>,
}

impl<P: Port> Emulator<P> {
    /// Opens lines and sockets in front of a world at rest.
    ///
    /// # Errors
    /// What the operating system or the world says.
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
            leaves_after: options.leaves_after.map(|s| (s / PERIOD) as u64),
            course: Course::default(),
            orders: None,
        };
        this.latch();
        Ok(this)
    }

    /// Where everything is. Cameras are added by whoever serves them.
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

    /// The world.
    #[must_use]
    pub fn world(&self) -> &P {
        &self.world
    }

    /// Emulates until `stop` is set or the controller has left; `hook` is called after each period.
    ///
    /// # Errors
    /// What the world says.
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
            let shift = heard.map_or(0, |at| shift(at, next));
            next = next.saturating_add_signed(shift) + PERIOD_NANOS;
            let behind = Clock.now().saturating_sub(next) / PERIOD_NANOS;
            if behind > CATCHES_UP {
                self.course.stalled += behind;
                next += behind * PERIOD_NANOS;
            }
            let gone = |(_, last): (u64, u64)| {
                self.leaves_after.is_some_and(|after| self.course.periods > last + after)
            };
            if self.orders.is_some_and(gone) {
                break;
            }
        }
        Ok(self.course)
    }

    /// Answers until the next period is due; when every line had had its order, if that was so.
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
            self.serve(share.min(1.0), share >= 2.0);
            if complete.is_none() && self.arms.iter().all(Arm::has_heard) {
                complete = Some(now);
            }
            if left == 0 {
                return complete;
            }
        }
    }

    /// Answers what has come, at most one order a line; `share` of the world's period has passed. A world that is `behind`
    /// keeps the last order of a line for later: that came when this thread was let go on, most likely, and what it asks
    /// for is how things stand now.
    fn serve(&mut self, share: f64, behind: bool) {
        let mut heard = 0;
        let wanted = if behind { 2 * ORDER } else { 0 };
        for arm in &mut self.arms {
            heard += arm.serve(&mut self.chance, share, wanted);
        }
        if heard > 0 {
            self.course.orders += heard;
            let first = self.orders.map_or(self.course.periods, |(first, _)| first);
            self.orders = Some((first, self.course.periods));
        }
    }

    /// Sleeps until something comes.
    fn wait(&self, nanos: u64) {
        let Some(some) = self.arms.first() else { return };
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

    /// What is to go wrong now.
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

    fn period(&mut self) -> Result<(), PortFault> {
        for (arm, drive) in self.arms.iter().zip(&mut self.drives) {
            *drive = self::drive(&arm.controllers, arm.has_track);
        }
        self.world.exchange(self.course.periods, &self.drives, &mut self.readings)?;
        self.latch();
        Ok(())
    }

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

    /// Whether every line has had an order since the world's last period.
    fn has_heard(&self) -> bool {
        (0..=AXES).all(|axis| self.lines[axis].is_none() || self.heard >> axis & 1 == 1)
    }

    /// See [`Emulator::serve`]; returns the number of orders. A line with fewer bytes than wanted is left alone.
    fn serve(&mut self, chance: &mut Chance, share: f64, wanted: usize) -> u64 {
        let mut orders = 0;
        let mut bytes = [0; ORDER];
        for (axis, line) in self.lines.iter().enumerate() {
            let Some(line) = line else { continue };
            if wanted > 0 && line.waiting() < wanted {
                continue;
            }
            let controller = &mut self.controllers[axis];
            let length = line.read(&mut bytes);
            for byte in &bytes[..length] {
                let Some(answer) = controller.hear(*byte, share) else { continue };
                orders += 1;
                self.heard |= 1 << axis;
                let arrived = chance.answer(answer.encode());
                if arrived.is_some_and(|bytes| !line.write(&bytes)) {
                    tracing::debug!(arm = %self.name, "nobody reads {}", line.path());
                }
            }
        }
        self.sensor.listen(self.silent);
        orders
    }
}

/// How far the world's periods are shifted (ns) so that they begin soon after the orders' arrival,
/// which was at `at` while a period began at `begun`: what is ordered then holds at once, and an
/// order that is a little late misses nothing. Slow, since single orders may be very late.
fn shift(at: u64, begun: u64) -> i64 {
    let (period, wanted) = (PERIOD_NANOS as i64, at as i64 + AFTER);
    let behind = (wanted - begun as i64 + period / 2).rem_euclid(period) - period / 2;
    (behind / 16).clamp(-AFTER / 8, AFTER / 8)
}

/// What an arm's controllers make of their orders. One power relay serves the whole arm: it is on when all are.
fn drive(controllers: &[AxisController; AXES + 1], has_track: bool) -> ArmDrive {
    let jaw = &controllers[JAW];
    ArmDrive {
        enabled: controllers[usize::from(!has_track)..].iter().all(AxisController::is_on),
        pwm: std::array::from_fn(|i| controllers[i].width()),
        jaw_pwm: jaw.width(),
        stops: if jaw.outputs() & 1 == 1 { Depth::Two } else { Depth::One },
        synchronise: (0..=AXES)
            .fold(0, |bits, i| bits | u8::from(controllers[i].synchronises()) << i),
    }
}

/// What an axis of a reading shows.
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

    /// Where the world's periods come to lie beside orders that arrive at `arrival` of each 2 ms
    /// (ns).
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
    fn the_worlds_periods_come_to_begin_soon_after_the_orders() {
        for begin in [0, 300_000, 900_000, 1_700_000] {
            let off = settled(700_000, begin);
            assert!((off - AFTER).abs() < 10_000, "{off} ns after orders, begun at {begin}");
        }
    }

    /// Axes that run on, a hundred increments a period.
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

    /// How many periods after the last one before a standstill of 15 a line's answer is of; `None` where this machine
    /// stood still by itself for longer than the emulator makes up.
    fn answers_of_a_standstill() -> Option<i64> {
        let arm = EmulatedArm { name: "arm".to_owned(), has_track: false };
        let mut emulator = Emulator::open(Ramp, &[arm], EmulatorOptions::default()).unwrap();
        let path = emulator.devices().effector[0].axes[1].clone();
        let line = Line::open(&path, AXIS_BAUD, true).unwrap();
        let mut lines = Lines::new(vec![line]);
        let order = Order::Pwm { width: 0, outputs: 0, synchronise: false }.encode();
        let stop = AtomicBool::new(false);
        let (mut asked, mut told) = (0, None);

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
                    told = lines.answer(0).map(|answer| Status::decode(answer).count);
                    stop.store(told.is_some() || period > 1000, Ordering::Release);
                }
            })
            .unwrap();

        (course.stalled == 0).then(|| i64::from(told.unwrap()) / 100 - asked as i64)
    }

    #[test]
    fn what_is_asked_after_a_standstill_is_answered_with_how_things_stand_then() {
        let periods = (0..20).find_map(|_| answers_of_a_standstill()).unwrap();
        assert!(periods >= 12, "{periods} of 15");
    }

    /// An arm that tells whether its drives are on.
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

    /// Whether an arm's drives are still on 100 ms after they came on, when nothing has been ordered meanwhile; `None`
    /// when they never came on.
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
    fn an_arm_that_nobody_orders_any_more_brakes_unless_it_has_no_watchdog() {
        let no_watchdog = EmulatorOptions { no_watchdog: true, ..EmulatorOptions::default() };

        assert_eq!(on_after_silence(EmulatorOptions::default()), Some(false));
        assert_eq!(on_after_silence(no_watchdog), Some(true));
    }

    #[test]
    fn one_late_order_hardly_moves_them() {
        let begun = 10 * PERIOD_NANOS;
        let usual = begun - AFTER as u64;

        assert_eq!(shift(usual, begun), 0);
        assert!(shift(usual + 900_000, begun).abs() <= AFTER / 8);
    }
}
