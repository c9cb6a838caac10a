//! The bridge to arms behind serial axis controllers.
//!
//! - in: the drives of a period; out: the readings that the controllers give in answer, within the period
//! - all lines are served at once; what has not answered by the deadline is missed, and reads as it did before
//! - lines do not fail in the same period by themselves: where several are silent at once, what they all hang on is late,
//!   and is waited for longer than one of them
//! - a line that must be given up is a fault of the whole bridge: every controller of every arm is put into its error
//!   mode, power off and brakes on, since a cube may join the arms, and told so in every period until the run ends
//! - when the bridge ends, every controller is put into its manual mode

use super::axis::{Answer, Axis, AxisDrive, AxisFault, Rules};
use super::frame::{Mode, Order, Parameter};
use super::line::{Line, Lines};
use crate::hw::force::ForceSource;
use crate::hw::note::{Notes, What};
use crate::hw::port::{Port, PortFault};
use crate::motion::{AXES, Depth, PERIOD};
use crate::servo::io::{ArmDrive, ArmReading};
use std::time::{Duration, Instant};

/// Time for every axis to answer and settle at the start.
const FIRST: Duration = Duration::from_secs(1);
/// Times that the last order is sent until all have answered.
const LAST: u32 = 3;
/// An arm's lines and its force sensor.
pub struct SerialArm {
    /// Name of the effector, for messages.
    pub name: String,
    /// Its axes with their lines: 0 the track, 1..=6, 7 the jaw; an axis that is not there has none.
    pub axes: [Option<Line>; AXES + 1],
    /// Motor current at which each controller stops (A), the jaw's last.
    pub max_currents: [f64; AXES + 1],
    /// Its force sensor.
    pub force: Box<dyn ForceSource>,
}

struct Arm {
    name: String,
    /// Line of each axis.
    lines: [Option<usize>; AXES + 1],
    axes: [Axis; AXES + 1],
    max_currents: [u16; AXES + 1],
    force: Box<dyn ForceSource>,
}

/// What silence means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// A line that has not answered yet has time until the start is over.
    Start,
    /// It is a fault after a few periods.
    Run,
    /// It says nothing of a line that is still there: others are silent with it.
    Together,
}

/// All arms.
pub struct SerialPort {
    arms: Vec<Arm>,
    lines: Lines,
    notes: Notes,
    /// How long an exchange may last.
    patience: Duration,
    fault: Option<PortFault>,
    begun: bool,
    /// When the last orders went out.
    asked: Option<Instant>,
    rules: Rules,
    /// For how many periods in a row each line has been silent.
    silent: Vec<u32>,
    /// No line at all answered in the last one.
    all_missed: bool,
}

/// So many lines that are silent in the same period are late rather than dead: this machine was kept from running, or
/// whatever they hang on was (measured: all lines of one arm for 3 periods, those of the other one not for one).
const SEVERAL: usize = 3;
/// So many such periods in a row of one of them are a fault, or as many as of a line alone, where those are more.
const MOST_TOGETHER: u32 = 20;
/// The same of lines that are all gone.
const ALL_GONE: u32 = 3;

impl SerialPort {
    /// Time that an exchange may take: 0.5 ms of a period are left for the servo.
    pub const PATIENCE: Duration = Duration::from_micros(1500);

    /// Joins arms to one bridge; `rules` are those of every line.
    #[must_use]
    pub fn new(arms: Vec<SerialArm>, rules: Rules, notes: Notes) -> Self {
        let mut lines = Vec::new();
        let arms = arms
            .into_iter()
            .map(|arm| {
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

    /// Why the bridge was given up.
    #[must_use]
    pub fn fault(&self) -> Option<&PortFault> {
        self.fault.as_ref()
    }

    /// Sends an order for every axis and gathers the answers.
    fn talk(&mut self, drives: &[ArmDrive]) {
        let begun = Instant::now();
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
        self.lines.gather(begun + self.patience);
    }

    /// Judges the answers; returns the first line that must be given up.
    fn judge(&mut self, period: u64) -> Result<(), PortFault> {
        let all = self.lines.len();
        let (mut missed, mut late) = (0, 0);
        for (line, silent) in self.silent.iter_mut().enumerate() {
            let is_silent = self.lines.answer(line).is_none();
            *silent = if is_silent { *silent + 1 } else { 0 };
            missed += usize::from(is_silent);
            late += usize::from(is_silent && !self.lines.is_dead(line));
        }
        self.all_missed = all > 1 && missed == all;
        if !self.all_missed && late < SEVERAL {
            return self.judge_each(period, Phase::Run);
        }
        // Lines that are gone are not late.
        let most = if late == 0 { ALL_GONE } else { MOST_TOGETHER.max(self.rules.misses) };
        let longest = self.silent.iter().copied().max().unwrap_or_default();
        if longest >= most {
            return Err(self.silent_together(period, missed, longest));
        }
        for (effector, arm) in self.arms.iter().enumerate() {
            let silent = |line: &Option<usize>| line.is_some_and(|line| self.silent[line] > 0);
            if arm.lines.iter().filter(|line| silent(line)).count() >= SEVERAL.min(all) {
                self.notes.tell(period, effector, What::MissedTogether);
                continue;
            }
            for axis in (0..=AXES).filter(|&axis| silent(&arm.lines[axis])) {
                self.notes.tell(period, effector, What::Missed { axis });
            }
        }
        if self.all_missed { Ok(()) } else { self.judge_each(period, Phase::Together) }
    }

    fn judge_each(&mut self, period: u64, phase: Phase) -> Result<(), PortFault> {
        let mut first: Option<(usize, usize, AxisFault)> = None;
        let mut others = 0;
        for (effector, arm) in self.arms.iter_mut().enumerate() {
            for index in 0..=AXES {
                let Some(line) = arm.lines[index] else { continue };
                let is_silent = self.lines.answer(line).is_none();
                if phase == Phase::Together && is_silent && !self.lines.is_dead(line) {
                    continue;
                }
                let late = self.lines.is_doubtful(line)
                    && self.lines.answer(line).is_some_and(|told| arm.axes[index].is_late(told));
                let became = if late {
                    self.lines.owe(line);
                    Ok(arm.axes[index].overlook())
                } else {
                    arm.axes[index].take(self.lines.answer(line))
                };
                let what = match became {
                    Ok(Answer::Taken) => continue,
                    // A controller that is still booting is silent and takes nothing.
                    Ok(Answer::Missed(_)) | Err(AxisFault::Silent(_) | AxisFault::Untaken(_))
                        if phase == Phase::Start =>
                    {
                        continue;
                    }
                    Ok(Answer::Missed(_)) => What::Missed { axis: index },
                    Ok(Answer::Late) => What::Late { axis: index },
                    Ok(Answer::Impossible(_)) => What::Impossible { axis: index },
                    Err(fault) => {
                        others += u32::from(first.is_some());
                        first.get_or_insert((effector, index, fault));
                        continue;
                    }
                };
                self.notes.tell(period, effector, what);
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

    /// Effector, axis and device of a line, for people.
    fn line_of(&self, effector: usize, index: usize) -> String {
        let arm = &self.arms[effector];
        let path = arm.lines[index].map_or("", |line| self.lines.path(line));
        let axis = if index == AXES { "jaw".to_owned() } else { format!("axis {index}") };
        format!("{}, {axis} ({path})", arm.name)
    }

    /// Why lines that are silent together must be given up: one of them has been for the `longest`.
    fn silent_together(&self, period: u64, missed: usize, longest: u32) -> PortFault {
        let at = period as f64 * PERIOD;
        let end = format!("no answer for {longest} periods, in period {period} ({at:.3} s)");
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
            reason: format!("{line}: {end}; {others} other lines are silent, too"),
        }
    }

    /// Puts every controller into a mode; none is waited for.
    fn tell_all(&mut self, mode: Mode) {
        let order = Order::Set(Parameter::Mode(mode)).encode();
        for line in 0..self.lines.len() {
            self.lines.send(line, &order);
        }
    }

    /// Exchanges until every axis has settled, power off. What is not known then must not be taken for a robot that
    /// stands at zero and was never synchronised.
    ///
    /// # Errors
    /// The lines that have not answered within a second.
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
            std::thread::sleep(Duration::from_secs_f64(PERIOD).saturating_sub(turn.elapsed()));
        }
        let silent = self.unsettled();
        let effector = silent[0].0;
        let lines: Vec<_> =
            silent.into_iter().map(|(effector, index)| self.line_of(effector, index)).collect();
        let reason = format!("{}: no answer within 1 s of the start", lines.join("; "));
        Err(PortFault { effector, reason })
    }

    /// Axes that have not shown yet where they stand: effector and axis.
    fn unsettled(&self) -> Vec<(usize, usize)> {
        let axes = (0..self.arms.len()).flat_map(|arm| (0..=AXES).map(move |axis| (arm, axis)));
        axes.filter(|&(arm, axis)| {
            let arm = &self.arms[arm];
            arm.lines[axis].is_some() && !arm.axes[axis].has_settled()
        })
        .collect()
    }
}

fn milliamperes(amperes: f64) -> u16 {
    (amperes * 1e3).round().clamp(0.0, 65_535.0) as u16
}

/// What a drive means to one axis.
pub(crate) fn axis_drive(
    drive: &ArmDrive,
    index: usize,
    max_currents: &[u16; AXES + 1],
) -> AxisDrive {
    let enabled = drive.enabled;
    let synchronise = drive.synchronise >> index & 1 == 1;
    let max_current = Some(max_currents[index]);
    let (width, outputs) = if index == AXES {
        (drive.jaw_pwm, u8::from(drive.stops == Depth::Two))
    } else {
        (drive.pwm[index], 0)
    };
    AxisDrive { enabled, width, outputs, max_current, synchronise }
}

impl Port for SerialPort {
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
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
            self.tell_all(Mode::Error);
            self.fault = Some(fault.clone());
            return Err(fault);
        }
        for (effector, (arm, reading)) in self.arms.iter_mut().zip(readings).enumerate() {
            hand_over(&arm.axes, arm.lines[0].is_some(), reading);
            // Where nothing at all gets through, its silence is not the sensor's: the last wrench holds meanwhile.
            if self.all_missed {
                reading.wrench_is_old = true;
                continue;
            }
            let (wrench, new) = arm.force.read(period, effector, &mut self.notes);
            (reading.wrench_on_sensor, reading.wrench_is_old) = (wrench, !new);
        }
        Ok(())
    }

    fn each_counts(&self) -> bool {
        false
    }

    fn insist(&mut self) {
        if self.fault.is_some() {
            self.tell_all(Mode::Error);
        }
    }
}

/// What the axes of an arm showed last, as the servo reads it; the wrench stays.
pub(crate) fn hand_over(axes: &[Axis; AXES + 1], has_track: bool, reading: &mut ArmReading) {
    *reading = ArmReading { wrench_on_sensor: reading.wrench_on_sensor, ..ArmReading::default() };
    for (index, axis) in axes.iter().enumerate().skip(usize::from(!has_track)) {
        let bit = |is: bool| u8::from(is) << index;
        reading.currents[index] = axis.current();
        reading.over_currents |= bit(axis.over_current());
        reading.power_faults |= bit(axis.stage_fault());
        reading.sync_switches |= bit(axis.sync_switch());
        reading.encoder_zeros |= bit(axis.sync_zero());
        reading.synchronised &= !bit(!axis.synchronised());
        let (upper, lower) = axis.at_limits();
        reading.upper_limits |= bit(upper);
        reading.lower_limits |= bit(lower);
        reading.extrapolated |= bit(axis.is_extrapolated());
        reading.no_answer = reading.extrapolated;
        if index == AXES {
            reading.jaw_count = axis.count();
        } else {
            reading.counts[index] = axis.count();
        }
    }
}

impl Drop for SerialPort {
    fn drop(&mut self) {
        let mode = if self.fault.is_none() { Mode::Manual } else { Mode::Error };
        // Nothing comes after this, and a controller may keep the last width that it was told.
        for _ in 0..LAST {
            self.tell_all(mode);
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

    /// An arm of one axis, whose controller boots after a while: what it was told before is lost.
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
                    if let Some(answer) = controller.hear(*byte, 1.0) {
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

    #[test]
    fn a_controller_that_boots_later_than_the_others_is_waited_for_whatever_arm_it_is_of() {
        let stop = Arc::new(AtomicBool::new(false));
        let (begun, late) = (Instant::now(), Duration::from_millis(300));
        let (arms, threads): (Vec<_>, Vec<_>) = [Duration::ZERO, Duration::ZERO, late]
            .map(|after| booting(after, &stop))
            .into_iter()
            .unzip();
        let mut port = SerialPort::new(arms, Rules::default(), Notes::none());
        // These tests share the processor with others.
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
    fn once_it_has_begun_a_line_that_falls_silent_is_a_fault() {
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

    #[test]
    fn lines_that_are_late_in_turn_are_not_given_up() {
        let mut port = SerialPort::new(Vec::new(), Rules::default(), Notes::none());
        let far: Vec<Pty> = (0..2 * SEVERAL).map(|_| Pty::open().unwrap()).collect();
        let lines = far.iter().map(|far| Line::open(far.path(), AXIS_BAUD, true).unwrap());
        port.lines = Lines::new(lines.collect());
        port.silent = vec![0; far.len()];

        for period in 0..3 * u64::from(MOST_TOGETHER) {
            for (line, far) in far.iter().enumerate() {
                port.lines.send(line, &[0; ORDER]);
                if (line < SEVERAL) == (period % 2 == 0) {
                    // What is owed from before comes, too.
                    assert!(far.write(&[0; 2 * STATUS]));
                }
            }
            port.lines.gather(Instant::now() + Duration::from_millis(5));
            assert_eq!(port.judge(period), Ok(()), "{period}");
        }
    }

    #[test]
    fn lines_that_fall_silent_together_are_waited_for_while_the_others_are_read() {
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
        assert!(read > most / 2, "this processor may be another's for some of them");
        port.patience = Duration::from_millis(500);
        let fault = port.exchange(most, &drives, &mut readings).unwrap_err();

        assert!(fault.reason.contains("no answer for 20 periods"), "{fault}");
        assert!(fault.reason.contains("2 other lines are silent, too"), "{fault}");
        assert_eq!(fault.effector, 1);
        drop(port);
        stops[0].store(true, Ordering::Release);
        answers.join().unwrap();
    }
}
