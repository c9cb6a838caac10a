//! The bridge to arms behind serial axis controllers.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | single silent line | [`Rules::misses`] | the rule of the original |
//! | silent lines in the same period | `SEVERAL` | they do not fail at once by themselves |
//! | periods with silent lines | `MOST_TOGETHER` | this machine or an adapter was delayed |
//! | periods in which all lines are dead | `ALL_GONE` | a line that is dead is not late |
//! | exchange | [`SerialPort::PATIENCE`] | 0.5 ms of a period are left for the servo |
//! | start of all axes | `FIRST` | a controller may still be booting |
//!
//! - in: the drives of a period; out: the readings that the controllers answer within the period
//! - All lines are exchanged together. A line that has not answered by the deadline is missed, and
//!   its counter is extrapolated.
//! - A line that must be given up is a fault of the whole bridge, because a cube may join the arms.
//!   Every controller of every arm is then put into its error mode, power off and brakes on, again
//!   in each period until the run ends.
//! - When the bridge ends, every controller is put into its manual mode.

use super::axis::{Answer, Axis, AxisDrive, AxisFault, Rules};
use super::frame::{Mode, Order, Parameter};
use super::line::{Line, Lines};
use crate::hw::force::ForceSource;
use crate::hw::note::{NoteKind, Notes};
use crate::hw::port::{Port, PortFault};
use crate::motion::{AXES, Depth, PERIOD};
use crate::servo::io::{ArmDrive, ArmReading};
use std::time::{Duration, Instant};

/// Longest time for every axis to answer and settle at the start.
const FIRST: Duration = Duration::from_secs(1);
/// Largest number of times that the last order is sent, until all controllers have answered.
const LAST: u32 = 3;

/// An arm's lines and its force sensor.
pub struct SerialArm {
    /// Name of the effector, for messages.
    pub name: String,
    /// Lines of the axes: 0 is the track, 7 the jaw. An axis that does not exist has none.
    pub axes: [Option<Line>; AXES + 1],
    /// Motor current at which each controller stops (A), the jaw's last.
    pub max_currents: [f64; AXES + 1],
    /// Force sensor of the arm.
    pub force: Box<dyn ForceSource>,
}

/// An arm of a running bridge.
struct Arm {
    name: String,
    /// Index in [`Lines`] of each axis's line.
    lines: [Option<usize>; AXES + 1],
    axes: [Axis; AXES + 1],
    /// Motor current at which each controller stops (mA), the jaw's last.
    max_currents: [u16; AXES + 1],
    force: Box<dyn ForceSource>,
}

/// Meaning of a silent line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// The line has time until the start is over.
    Start,
    /// The line is at fault after a few periods.
    Run,
    /// Other lines are silent with it, so it is not at fault unless it is dead.
    Together,
}

/// The bridge to all arms.
pub struct SerialPort {
    arms: Vec<Arm>,
    lines: Lines,
    notes: Notes,
    /// Longest time of an exchange.
    patience: Duration,
    fault: Option<PortFault>,
    begun: bool,
    /// Time at which the last orders were sent.
    asked: Option<Instant>,
    rules: Rules,
    /// Number of periods in a row in which each line has been silent.
    silent: Vec<u32>,
    /// Whether no line answered in the last period.
    all_missed: bool,
}

/// Least number of lines that count as late and not as dead if they are silent in the same period:
/// then this machine, or a device that the lines share, was delayed. Measured: all lines of one arm
/// were silent for 3 periods, and none of the other arm.
const SEVERAL: usize = 3;
/// Number of silent periods in a row of one line that are a fault although others are silent with
/// it, or [`Rules::misses`] if that is more.
const MOST_TOGETHER: u32 = 20;
/// Number of silent periods in a row of one line that are a fault if all silent lines are dead.
const ALL_GONE: u32 = 3;

impl SerialPort {
    /// Longest time of an exchange: 0.5 ms of a period are left for the servo.
    pub const PATIENCE: Duration = Duration::from_micros(1500);

    /// Joins the lines and force sensors of these arms to one bridge. `rules` say when a line is
    /// given up; `notes` receives non-fatal events for the log.
    #[must_use]
    pub fn new(arms: Vec<SerialArm>, rules: Rules, notes: Notes) -> Self {
        let mut lines = Vec::new();
        let arms = arms
            .into_iter()
            .map(|arm| {
                // The lines of all arms are numbered in one list, because they are exchanged
                // together.
                let axes = arm.axes.map(|line| {
                    line.map(|line| {
                        lines.push(line);
                        lines.len() - 1
                    })
                });
                Arm {
                    name: arm.name,
                    lines: axes,
                    axes: std::array::from_fn(|_| Axis::new(rules)),
                    max_currents: arm.max_currents.map(milliamperes),
                    force: arm.force,
                }
            })
            .collect();
        Self {
            arms,
            rules,
            silent: vec![0; lines.len()],
            lines: Lines::new(lines),
            notes,
            patience: Self::PATIENCE,
            fault: None,
            begun: false,
            asked: None,
            all_missed: false,
        }
    }

    /// Returns the reason why the bridge was given up, or `None` while it works.
    #[must_use]
    pub fn fault(&self) -> Option<&PortFault> {
        self.fault.as_ref()
    }

    /// Sends an order to every axis and gathers the answers.
    fn talk(&mut self, drives: &[ArmDrive]) {
        let begun = Instant::now();
        // By the clock and not by the count of periods: motors move on while this thread is
        // delayed.
        let passed = self.asked.map_or(1.0, |last| (begun - last).as_secs_f64() / PERIOD);
        self.asked = Some(begun);
        for (arm, drive) in self.arms.iter_mut().zip(drives) {
            for index in 0..=AXES {
                let Some(line) = arm.lines[index] else { continue };
                arm.axes[index].pass(passed);
                let order = arm.axes[index].order(&axis_drive(drive, index, &arm.max_currents));
                self.lines.send(line, &order.encode());
            }
        }
        // The deadline counts from the first order, so that sending uses up its share of the time.
        self.lines.gather(begun + self.patience);
    }

    /// Decides whether silent lines of this period mean a delay of this machine, and checks the
    /// answers. Returns the fault of the first line that must be given up.
    fn judge(&mut self, period: u64) -> Result<(), PortFault> {
        let all = self.lines.len();
        let (mut missed, mut late) = (0, 0);
        for (line, silent) in self.silent.iter_mut().enumerate() {
            let is_silent = self.lines.answer(line).is_none();
            *silent = if is_silent { *silent + 1 } else { 0 };
            missed += usize::from(is_silent);
            late += usize::from(is_silent && !self.lines.is_dead(line));
        }
        // A single line alone cannot be silent together with others.
        self.all_missed = all > 1 && missed == all;
        if !self.all_missed && late < SEVERAL {
            return self.judge_each(period, Phase::Run);
        }
        // Lines that are dead are not late.
        let most = if late == 0 { ALL_GONE } else { MOST_TOGETHER.max(self.rules.misses) };
        // The longest silence of one line decides, since lines that are late in turn are only slow.
        let longest = self.silent.iter().copied().max().unwrap_or_default();
        if longest >= most {
            return Err(self.silent_together(period, missed, longest));
        }
        for (effector, arm) in self.arms.iter().enumerate() {
            let silent = |line: &Option<usize>| line.is_some_and(|line| self.silent[line] > 0);
            // An arm with several silent lines gives one entry of the log, not one for each axis.
            if arm.lines.iter().filter(|line| silent(line)).count() >= SEVERAL.min(all) {
                self.notes.push(period, effector, NoteKind::MissedTogether);
                continue;
            }
            for axis in (0..=AXES).filter(|&axis| silent(&arm.lines[axis])) {
                self.notes.push(period, effector, NoteKind::Missed { axis });
            }
        }
        // Without any answer there is nothing to judge.
        if self.all_missed { Ok(()) } else { self.judge_each(period, Phase::Together) }
    }

    /// Checks the answer of each line by itself; `phase` says what a silent line means. Returns the
    /// fault of the first line that must be given up.
    fn judge_each(&mut self, period: u64, phase: Phase) -> Result<(), PortFault> {
        let mut first: Option<(usize, usize, AxisFault)> = None;
        let mut others = 0;
        for (effector, arm) in self.arms.iter_mut().enumerate() {
            for index in 0..=AXES {
                let Some(line) = arm.lines[index] else { continue };
                let is_silent = self.lines.answer(line).is_none();
                // A silent line among several is not judged, unless it is dead.
                if phase == Phase::Together && is_silent && !self.lines.is_dead(line) {
                    continue;
                }
                // While an earlier answer is due, the counter decides to which order this one
                // belongs.
                let late = self.lines.may_be_late(line)
                    && self.lines.answer(line).is_some_and(|bytes| arm.axes[index].is_late(bytes));
                let became = if late {
                    self.lines.mark_late(line);
                    Ok(arm.axes[index].ignore_late())
                } else {
                    arm.axes[index].take(self.lines.answer(line))
                };
                let what = match became {
                    Ok(Answer::Taken) => continue,
                    // A controller that is still booting is silent and takes no parameter.
                    Ok(Answer::Missed(_)) | Err(AxisFault::Silent(_) | AxisFault::Untaken(_))
                        if phase == Phase::Start =>
                    {
                        continue;
                    }
                    Ok(Answer::Missed(_)) => NoteKind::Missed { axis: index },
                    Ok(Answer::Late) => NoteKind::Late { axis: index },
                    Ok(Answer::Impossible(_)) => NoteKind::Impossible { axis: index },
                    Err(fault) => {
                        // All lines are judged before the fault is returned, so that it can count
                        // the others.
                        others += u32::from(first.is_some());
                        first.get_or_insert((effector, index, fault));
                        continue;
                    }
                };
                self.notes.push(period, effector, what);
            }
        }
        let Some((effector, index, fault)) = first else { return Ok(()) };
        let more = match others {
            0 => String::new(),
            1 => "; another line failed with it".to_owned(),
            n => format!("; {n} other lines failed with it"),
        };
        let (at, line) = (period as f64 * PERIOD, self.line_of(effector, index));
        let reason = format!("{line}: {fault}, in period {period} ({at:.3} s){more}");
        Err(PortFault { effector, reason })
    }

    /// Returns the name of a line for messages: its arm, axis (`index`) and device.
    fn line_of(&self, effector: usize, index: usize) -> String {
        let arm = &self.arms[effector];
        let path = arm.lines[index].map_or("", |line| self.lines.path(line));
        let axis = if index == AXES { "jaw".to_owned() } else { format!("axis {index}") };
        format!("{}, {axis} ({path})", arm.name)
    }

    /// Returns the fault of the `missed` lines that are silent at the same time, one of them for
    /// `longest` periods.
    fn silent_together(&self, period: u64, missed: usize, longest: u32) -> PortFault {
        let at = period as f64 * PERIOD;
        let end = format!("no answer for {longest} periods, in period {period} ({at:.3} s)");
        // No line is the cause if all are silent, so the message names the range of devices.
        if self.all_missed {
            let names: Vec<&str> = self.arms.iter().map(|arm| arm.name.as_str()).collect();
            let (first, last) = (self.lines.path(0), self.lines.path(self.lines.len() - 1));
            let reason = format!("{}, all axes ({first} to {last}): {end}", names.join(" and "));
            return PortFault { effector: 0, reason };
        }
        let (effector, axis) = (0..self.arms.len())
            .flat_map(|arm| (0..=AXES).map(move |axis| (arm, axis)))
            .find(|&(arm, axis)| {
                self.arms[arm].lines[axis].is_some_and(|line| self.silent[line] == longest)
            })
            .unwrap_or_default();
        let (line, others) = (self.line_of(effector, axis), missed.saturating_sub(1));
        PortFault {
            effector,
            reason: format!("{line}: {end}; {others} other lines are silent as well"),
        }
    }

    /// Puts every controller into a mode without waiting for the answers.
    fn order_all(&mut self, mode: Mode) {
        let order = Order::Set(Parameter::Mode(mode)).encode();
        for line in 0..self.lines.len() {
            self.lines.send(line, &order);
        }
    }

    /// Exchanges orders with power off until the counter of every axis is known.
    ///
    /// Unknown readings must not look like a robot that is at zero and was never synchronised.
    ///
    /// # Errors
    /// Returns the lines that have not answered within a second.
    fn begin(&mut self) -> Result<(), PortFault> {
        let off = vec![ArmDrive::OFF; self.arms.len()];
        let begun = Instant::now();
        while begun.elapsed() < FIRST {
            let turn = Instant::now();
            self.talk(&off);
            self.judge_each(0, Phase::Start)?;
            if self.unsettled().is_empty() {
                return Ok(());
            }
            // The controllers get their orders at the usual rate.
            std::thread::sleep(Duration::from_secs_f64(PERIOD).saturating_sub(turn.elapsed()));
        }
        let silent = self.unsettled();
        let effector = silent[0].0;
        let lines: Vec<_> =
            silent.into_iter().map(|(effector, index)| self.line_of(effector, index)).collect();
        let reason = format!("{}: the axis controller has not answered for 1 s", lines.join("; "));
        Err(PortFault { effector, reason })
    }

    /// Returns effector and axis of each line whose counter is not known yet.
    fn unsettled(&self) -> Vec<(usize, usize)> {
        let axes = (0..self.arms.len()).flat_map(|arm| (0..=AXES).map(move |axis| (arm, axis)));
        axes.filter(|&(arm, axis)| {
            let arm = &self.arms[arm];
            arm.lines[axis].is_some() && !arm.axes[axis].has_settled()
        })
        .collect()
    }
}

/// Converts a current to mA, rounded and limited to 16 bits.
fn milliamperes(amperes: f64) -> u16 {
    (amperes * 1e3).round().clamp(0.0, 65_535.0) as u16
}

/// Returns the part of an arm's drive for the axis `index` (0 is the track, 7 the jaw), with its
/// limit of the motor current (mA).
pub(crate) fn axis_drive(
    drive: &ArmDrive,
    index: usize,
    max_currents: &[u16; AXES + 1],
) -> AxisDrive {
    let enabled = drive.enabled;
    let synchronise = drive.synchronise >> index & 1 == 1;
    let max_current = Some(max_currents[index]);
    // The jaw has a pulse width of its own, and its controller moves the palm's stops as well.
    let (width, outputs) = if index == AXES {
        (drive.jaw_pwm, u8::from(drive.stops == Depth::Two))
    } else {
        (drive.pwm[index], 0)
    };
    AxisDrive { enabled, width, outputs, max_current, synchronise }
}

impl Port for SerialPort {
    /// Sends an order to each axis and gathers the answers, and reads the force sensors. The first
    /// call waits until all controllers have answered. After a fault each call returns that fault.
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        // A bridge that was given up stays so until the run ends.
        if let Some(fault) = &self.fault {
            return Err(fault.clone());
        }
        let done = if self.begun {
            self.talk(drives);
            self.judge(period)
        } else {
            self.begun = true;
            self.begin()
        };
        if let Err(fault) = done {
            self.order_all(Mode::Error);
            // `repeat_stop` repeats the order in each period, in case a controller missed it.
            self.fault = Some(fault.clone());
            return Err(fault);
        }
        for (effector, (arm, reading)) in self.arms.iter_mut().zip(readings).enumerate() {
            write_reading(&arm.axes, arm.lines[0].is_some(), reading);
            // If no line answers, this machine was delayed, so the silence of the sensor does not
            // count. The last wrench is held.
            if self.all_missed {
                reading.wrench_is_old = true;
                continue;
            }
            let (wrench, new) = arm.force.read(period, effector, &mut self.notes);
            (reading.wrench_on_sensor, reading.wrench_is_old) = (wrench, !new);
        }
        Ok(())
    }

    fn needs_each_period(&self) -> bool {
        false
    }

    /// Puts every controller into its error mode again, if the bridge was given up.
    fn repeat_stop(&mut self) {
        if self.fault.is_some() {
            self.order_all(Mode::Error);
        }
    }
}

/// Writes the latest state of an arm's axes into a reading, and leaves the wrench in it unchanged.
pub(crate) fn write_reading(axes: &[Axis; AXES + 1], has_track: bool, reading: &mut ArmReading) {
    *reading = ArmReading { wrench_on_sensor: reading.wrench_on_sensor, ..ArmReading::default() };
    for (index, axis) in axes.iter().enumerate().skip(usize::from(!has_track)) {
        let bit = |is: bool| u8::from(is) << index;
        reading.currents[index] = axis.current();
        reading.over_currents |= bit(axis.over_current());
        reading.power_faults |= bit(axis.stage_fault());
        reading.sync_switches |= bit(axis.sync_switch());
        reading.encoder_zeros |= bit(axis.sync_zero());
        // The default is synchronised, so that a track that does not exist counts as synchronised.
        reading.synchronised &= !bit(!axis.synchronised());
        let (upper, lower) = axis.at_limits();
        reading.upper_limits |= bit(upper);
        reading.lower_limits |= bit(lower);
        reading.extrapolated |= bit(axis.is_extrapolated());
        // Lines have no other estimate: an axis is extrapolated only if its order was not answered.
        reading.no_answer = reading.extrapolated;
        if index == AXES {
            reading.jaw_count = axis.count();
        } else {
            reading.counts[index] = axis.count();
        }
    }
}

impl Drop for SerialPort {
    /// Puts every controller into its manual mode, or into its error mode after a fault.
    fn drop(&mut self) {
        let mode = if self.fault.is_none() { Mode::Manual } else { Mode::Error };
        // No order comes after this one, and a controller may keep the last width that it received.
        for _ in 0..LAST {
            self.order_all(mode);
            self.lines.gather(Instant::now() + self.patience);
            if (0..self.lines.len()).all(|line| self.lines.answer(line).is_some()) {
                break;
            }
        }
    }
}

impl std::fmt::Debug for SerialPort {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SerialPort").field("lines", &self.lines.len()).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hw::emulator::AxisController;
    use crate::hw::emulator::pty::Pty;
    use crate::hw::force::NoSensor;
    use crate::hw::serial::AXIS_BAUD;
    use crate::hw::serial::frame::{ORDER, STATUS};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::thread::JoinHandle;

    /// Makes an arm of one axis whose controller boots after a while. Earlier orders are lost.
    fn booting(after: Duration, stop: &Arc<AtomicBool>) -> (SerialArm, JoinHandle<Pty>) {
        let far = Pty::open().unwrap();
        let mut axes = [const { None }; AXES + 1];
        axes[1] = Some(Line::open(far.path(), AXIS_BAUD, true).unwrap());
        let stop = Arc::clone(stop);
        let thread = std::thread::spawn(move || {
            std::thread::sleep(after);
            let mut bytes = [0; ORDER];
            while far.read(&mut bytes) > 0 {}
            let mut controller = AxisController::default();
            while !stop.load(Ordering::Acquire) {
                let length = far.read(&mut bytes);
                for byte in &bytes[..length] {
                    if let Some(answer) = controller.receive(*byte, 1.0) {
                        assert!(far.write(&answer.encode()));
                    }
                }
                std::thread::sleep(Duration::from_micros(200));
            }
            far
        });
        let (name, force) = ("arm".to_owned(), Box::new(NoSensor));
        (SerialArm { name, axes, max_currents: [1.0; AXES + 1], force }, thread)
    }

    /// The start waits for the last controller, of any arm.
    #[test]
    fn start_waits_for_the_slowest_axis_controller() {
        let stop = Arc::new(AtomicBool::new(false));
        let (begun, late) = (Instant::now(), Duration::from_millis(300));
        let (arms, threads): (Vec<_>, Vec<_>) = [Duration::ZERO, Duration::ZERO, late]
            .map(|after| booting(after, &stop))
            .into_iter()
            .unzip();
        let mut port = SerialPort::new(arms, Rules::default(), Notes::none());
        // Other tests run at the same time and may delay this one.
        port.patience = Duration::from_millis(20);

        let done = port.exchange(0, &[ArmDrive::OFF; 3], &mut [ArmReading::default(); 3]);

        assert_eq!(done, Ok(()));
        assert!(begun.elapsed() >= late, "{:?}", begun.elapsed());
        drop(port);
        stop.store(true, Ordering::Release);
        for thread in threads {
            thread.join().unwrap();
        }
    }

    #[test]
    fn line_silent_after_the_start_is_a_fault() {
        let stops = [false; 2].map(|stops| Arc::new(AtomicBool::new(stops)));
        let (arms, mut threads): (Vec<_>, Vec<_>) =
            stops.iter().map(|stop| booting(Duration::ZERO, stop)).unzip();
        let mut port = SerialPort::new(arms, Rules::default(), Notes::none());
        port.patience = Duration::from_millis(20);
        let mut readings = [ArmReading::default(); 2];
        port.exchange(0, &[ArmDrive::OFF; 2], &mut readings).unwrap();

        stops[1].store(true, Ordering::Release);
        threads.remove(1).join().unwrap();
        let fault = (1..10)
            .find_map(|period| port.exchange(period, &[ArmDrive::OFF; 2], &mut readings).err());

        assert!(fault.is_some_and(|fault| fault.reason.contains("no answer for 3 periods")));
        drop(port);
        stops[0].store(true, Ordering::Release);
        threads.remove(0).join().unwrap();
    }

    /// Many lines are silent in each period, but none of them for long.
    #[test]
    fn lines_silent_in_alternate_periods_cause_no_fault() {
        let mut port = SerialPort::new(Vec::new(), Rules::default(), Notes::none());
        let far: Vec<Pty> = (0..2 * SEVERAL).map(|_| Pty::open().unwrap()).collect();
        let lines = far.iter().map(|far| Line::open(far.path(), AXIS_BAUD, true).unwrap());
        port.lines = Lines::new(lines.collect());
        port.silent = vec![0; far.len()];

        for period in 0..3 * u64::from(MOST_TOGETHER) {
            for (line, far) in far.iter().enumerate() {
                port.lines.send(line, &[0; ORDER]);
                if (line < SEVERAL) == (period % 2 == 0) {
                    // The answer to an earlier order comes as well.
                    assert!(far.write(&[0; 2 * STATUS]));
                }
            }
            port.lines.gather(Instant::now() + Duration::from_millis(5));
            assert_eq!(port.judge(period), Ok(()), "{period}");
        }
    }

    /// When several lines fall silent together, the port reads the other lines and reports a fault
    /// only after 20 periods.
    #[test]
    fn port_tolerates_several_silent_lines_for_20_periods() {
        const ARMS: usize = SEVERAL + 1;
        let stops = [false; ARMS].map(|stops| Arc::new(AtomicBool::new(stops)));
        let (arms, threads): (Vec<_>, Vec<_>) =
            stops.iter().map(|stop| booting(Duration::ZERO, stop)).unzip();
        let mut port = SerialPort::new(arms, Rules::default(), Notes::none());
        port.patience = Duration::from_millis(20);
        let (drives, mut readings) = ([ArmDrive::OFF; ARMS], [ArmReading::default(); ARMS]);
        port.exchange(0, &drives, &mut readings).unwrap();

        for stop in &stops[1..] {
            stop.store(true, Ordering::Release);
        }
        let mut threads = threads.into_iter();
        let answers = threads.next().unwrap();
        let _still_there: Vec<Pty> = threads.map(|thread| thread.join().unwrap()).collect();
        let most = u64::from(MOST_TOGETHER);
        let mut read = 0;
        for period in 1..most {
            assert_eq!(port.exchange(period, &drives, &mut readings), Ok(()), "{period}");
            let silent = |reading: &ArmReading| reading.extrapolated & reading.no_answer == 1 << 1;
            assert!(readings[1..].iter().all(silent));
            read += u64::from(readings[0].extrapolated == 0);
        }
        assert!(read > most / 2, "other programs may take some periods");
        port.patience = Duration::from_millis(500);
        let fault = port.exchange(most, &drives, &mut readings).unwrap_err();

        assert!(fault.reason.contains("no answer for 20 periods"), "{fault}");
        assert!(fault.reason.contains("2 other lines are silent as well"), "{fault}");
        assert_eq!(fault.effector, 1);
        drop(port);
        stops[0].store(true, Ordering::Release);
        answers.join().unwrap();
    }
}
