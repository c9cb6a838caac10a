//! The bridge to arms behind ISA cards.
//!
//! - in: the drives of a period; out: what the cards show in the same period
//! - an axis takes one word an interrupt: a command goes out in place of a pulse width, one a period
//! - on any hard error of an axis, and without power, all motors of its arm are stopped in the same period, before the
//!   servo knows of it
//! - the card's interrupt is its sign of life: 10 ms without one are passed over, 20 ms are told, 30 ms are a fault
//! - when the bridge ends, motion by hand is allowed again

use super::counter::Counter;
use super::registers::{
    AxisKind, AxisStatus, HARDWARE_ERROR, LIMITS, Registers, command, counter, error_word, port,
    pulse_word, resolver,
};
use crate::hw::force::ForceSource;
use crate::hw::note::{Notes, What};
use crate::hw::port::{Port, PortFault};
use crate::motion::{AXES, Depth, PERIOD};
use crate::servo::io::{ArmDrive, ArmReading, JAW};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// How long an exchange waits for the card's next period: together with the last one's rest it is always near.
const WAIT: Duration = Duration::from_millis(1);
/// How long the first one does.
const FIRST: Duration = Duration::from_millis(100);
/// Periods without an interrupt that make one miss: the original's 10 ms.
const MISS: u32 = 5;
/// Misses after which the arm is given up.
const LOST: u32 = 3;
/// Pauses between the interrupts' divisor and their start: the original's 10 ms.
const SETTLES: u32 = 5;

/// An arm's card and its force sensor.
pub struct IsaArm<R> {
    /// Name of the effector, for messages.
    pub name: String,
    /// The card.
    pub registers: R,
    /// Pointer of its first axis: 0xc0 of the track's card, 0xc1 of the postument's.
    pub first_pointer: u8,
    /// Divisor that makes its interrupts come every 2 ms.
    pub divisor: u8,
    /// Whether it has an axis 0; without one the first pointer is axis 1's.
    pub has_track: bool,
    /// How each axis is read; the jaw's last.
    pub kinds: [AxisKind; AXES + 1],
    /// Axis that tells of the power of all; it must have an encoder, or nothing is told.
    pub power_axis: usize,
    /// Units of current per ampere, the jaw's last.
    pub units_per_ampere: [f64; AXES + 1],
    /// Limits of the motor currents in those units, the jaw's last.
    pub max_currents: [u8; AXES + 1],
    /// Its force sensor.
    pub force: Box<dyn ForceSource>,
}

impl IsaArm<()> {
    /// The same, behind these registers.
    pub fn with<R>(self, registers: R) -> IsaArm<R> {
        IsaArm {
            name: self.name,
            registers,
            first_pointer: self.first_pointer,
            divisor: self.divisor,
            has_track: self.has_track,
            kinds: self.kinds,
            power_axis: self.power_axis,
            units_per_ampere: self.units_per_ampere,
            max_currents: self.max_currents,
            force: self.force,
        }
    }
}

struct Axis {
    counter: Counter,
    /// What it is still to be told.
    commands: VecDeque<u16>,
    /// Pulse width that it was told last.
    width: i16,
    /// It was asked to synchronise in the last period.
    asked: bool,
}

struct Arm<R> {
    parts: IsaArm<R>,
    axes: [Axis; AXES + 1],
    enabled: bool,
    /// What the axes show does not let any motor go on.
    hard: bool,
    /// What they show, as in the aggregated error word, and what of it was there when the drives were switched on: an axis
    /// that stands on its limit switch must be able to leave it, and the servo sees that it does not go on.
    errors: u64,
    spared: u64,
    /// The last reading, for when the card has not come to its next one.
    last: ArmReading,
    outputs: Option<u16>,
    /// Whether the card awaits its words.
    ready: bool,
    /// Periods since the last interrupt.
    quiet: u32,
}

/// All arms.
pub struct IsaPort<R: Registers> {
    arms: Vec<Arm<R>>,
    begun: bool,
    notes: Notes,
}

impl<R: Registers> IsaPort<R> {
    /// Sets the cards up: interrupts every 2 ms, current limits, no motion by hand. Takes about 30 ms a card.
    #[must_use]
    pub fn new(arms: Vec<IsaArm<R>>, notes: Notes) -> Self {
        let arms = arms
            .into_iter()
            .map(|parts| {
                let mut arm = Arm {
                    axes: parts.kinds.map(|kind| Axis {
                        counter: Counter::new(kind),
                        commands: VecDeque::with_capacity(8),
                        width: 0,
                        asked: false,
                    }),
                    enabled: false,
                    hard: false,
                    errors: 0,
                    spared: 0,
                    last: ArmReading::default(),
                    outputs: None,
                    ready: false,
                    quiet: 0,
                    parts,
                };
                arm.set_up();
                arm
            })
            .collect();
        Self { arms, begun: false, notes }
    }
}

impl<R: Registers> Arm<R> {
    /// The original's order.
    fn set_up(&mut self) {
        self.acknowledge();
        self.tell(command::SET_INTERRUPT_DIVISOR | u16::from(self.parts.divisor));
        for _ in 0..SETTLES {
            self.parts.registers.pause();
        }
        self.tell(command::START_INTERRUPTS);
        self.parts.registers.pause();
        self.tell_all(|_| command::RESET_MANUAL);
        self.tell_all(|_| command::PROHIBIT_MANUAL);
        let limits = self.parts.max_currents;
        self.tell_all(|axis| command::SET_MAX_CURRENT | u16::from(limits[axis]));
        self.tell_all(|_| command::MICROCONTROLLER_MODE);
        self.tell_all(|_| command::STOP_MOTOR);
        self.tell_all(|_| command::RESET_MANUAL);
        self.tell_all(|_| command::RESET_ALARM);
        let mut known = [false; AXES + 1];
        for (axis, known) in known.iter_mut().enumerate().skip(self.first()) {
            self.choose(axis);
            *known = self.status(axis).synchronised;
        }
        // What does not know where it is counts from here.
        self.tell_all(
            |axis| {
                if known[axis] { command::STOP_MOTOR } else { command::RESET_POSITION }
            },
        );
    }

    /// Power off, and the cabinet's buttons serve again. What was told just before may keep the first word from being
    /// taken, hence the second.
    fn end(&mut self) {
        for word in [
            command::STOP_MOTOR,
            command::MICROCONTROLLER_MODE,
            command::STOP_MOTOR,
            command::RESET_MANUAL,
            command::RESET_ALARM,
            command::ALLOW_MANUAL,
        ] {
            self.tell_all(|_| word);
        }
    }

    fn first(&self) -> usize {
        usize::from(!self.parts.has_track)
    }

    fn choose(&mut self, axis: usize) {
        let pointer = self.parts.first_pointer + (axis - self.first()) as u8;
        self.parts.registers.write8(port::AXIS, pointer);
    }

    fn tell(&mut self, word: u16) {
        self.parts.registers.write16(port::COMMAND, word);
    }

    /// Tells every axis a word, and gives it the time to take it.
    fn tell_all(&mut self, word: impl Fn(usize) -> u16) {
        for axis in self.first()..=JAW {
            self.choose(axis);
            self.tell(word(axis));
        }
        self.parts.registers.pause();
        self.acknowledge();
    }

    /// Clears the cause of the interrupt: else no further one comes. The generator stays chosen.
    fn acknowledge(&mut self) {
        self.parts.registers.write8(port::AXIS, port::INTERRUPTS);
        self.parts.registers.read16(port::COMMAND);
        self.parts.registers.read16(port::OUTPUTS);
    }

    /// Status of the chosen axis, which is this one.
    fn status(&mut self, axis: usize) -> AxisStatus {
        AxisStatus::decode(self.parts.registers.read16(port::COMMAND), self.parts.kinds[axis])
    }

    /// What every axis shows.
    fn read(&mut self, reading: &mut ArmReading) {
        self.acknowledge();
        *reading = ArmReading::default();
        let mut statuses = [AxisStatus::default(); AXES + 1];
        for (axis, slot) in statuses.iter_mut().enumerate().skip(self.first()) {
            self.choose(axis);
            let kind = self.parts.kinds[axis];
            let registers = &mut self.parts.registers;
            let word = registers.read16(port::COMMAND);
            let reply = registers.read16(port::OUTPUTS);
            let low = registers.read16(port::POSITION_LOW);
            let high = registers.read16(port::POSITION_HIGH);
            let status = AxisStatus::decode(word, kind);
            let (position, units) = match kind {
                AxisKind::Resolver => (resolver(low, high), word & 0xff),
                AxisKind::Encoder { .. } => (Some(i64::from(counter(low, high))), reply >> 8),
            };
            let Axis { counter, commands, width, .. } = &mut self.axes[axis];
            if counter.take(position, status) {
                commands.push_back(command::FINISH_SYNCHRO);
                if counter.is_off() {
                    commands.push_back(command::RESET_POSITION);
                }
                // Of encoder axes, without a reason in the sources: some do not move otherwise.
                if kind != AxisKind::Resolver {
                    commands.push_back(command::MICROCONTROLLER_MODE);
                }
            }
            let bit = |is: bool| u8::from(is) << axis;
            // Its magnitude; it flows as it is driven.
            let amperes = f64::from(units) / self.parts.units_per_ampere[axis];
            reading.currents[axis] = if *width < 0 { -amperes } else { amperes };
            reading.upper_limits |= bit(status.upper);
            reading.lower_limits |= bit(status.lower);
            reading.over_currents |= bit(status.over_current);
            reading.sync_switches |= bit(status.sync_switch);
            reading.encoder_zeros |= bit(status.zero);
            reading.synchronised &= !bit(!counter.is_synchronised(status));
            match reading.counts.get_mut(axis) {
                Some(slot) => *slot = counter.count(),
                None => reading.jaw_count = counter.count(),
            }
            *slot = status;
        }
        self.read_inputs(reading);
        let teller = self.parts.power_axis;
        let off =
            matches!(self.parts.kinds[teller], AxisKind::Encoder { .. }) && !statuses[teller].power;
        if off {
            reading.power_faults = u8::MAX;
        }
        let errors = error_word(statuses) & HARDWARE_ERROR;
        self.spared &= errors;
        self.hard = off || errors & !self.spared != 0;
        self.errors = errors;
    }

    fn read_inputs(&mut self, reading: &mut ArmReading) {
        let registers = &mut self.parts.registers;
        registers.write8(port::AXIS, port::IO_PACKET);
        reading.inputs = registers.read16(port::INPUTS);
        for (pair, at) in
            reading.analog_inputs.chunks_exact_mut(2).zip((port::COMMAND..).step_by(2))
        {
            pair.copy_from_slice(&registers.read16(at).to_le_bytes());
        }
    }

    /// What every axis is told.
    fn write(&mut self, drive: &ArmDrive) {
        let switched = drive.enabled != self.enabled;
        if switched && drive.enabled {
            self.spared = self.errors & LIMITS;
        }
        // Stopping waits for no command.
        let stops = self.enabled && (self.hard || !drive.enabled);
        for axis in self.first()..=JAW {
            self.queue(axis, drive, switched);
            self.choose(axis);
            let waiting = if stops { None } else { self.axes[axis].commands.pop_front() };
            if let Some(word) = waiting {
                let counter = &mut self.axes[axis].counter;
                match word {
                    command::START_SYNCHRO => counter.await_zero(),
                    command::FINISH_SYNCHRO => counter.stop_waiting(),
                    command::RESET_POSITION => counter.was_reset(),
                    _ => {}
                }
                self.tell(word);
            } else {
                let width = if axis == JAW { drive.jaw_pwm } else { drive.pwm[axis] };
                let width = if drive.enabled && !stops { width } else { 0 };
                self.axes[axis].width = width;
                self.tell(pulse_word(width));
            }
        }
        let outputs = u16::from(drive.stops == Depth::Two);
        if self.outputs != Some(outputs) {
            self.outputs = Some(outputs);
            self.parts.registers.write8(port::AXIS, port::IO_PACKET);
            self.parts.registers.write16(port::OUTPUTS, outputs);
        }
        self.enabled = drive.enabled;
    }

    /// Commands that an axis's drive makes necessary.
    fn queue(&mut self, axis: usize, drive: &ArmDrive, switched: bool) {
        let slot = &mut self.axes[axis];
        // Whatever the servo has stopped for is told to it anew when it lasts; else it could not begin again.
        if switched {
            slot.commands.push_back(command::RESET_ALARM);
        }
        let asked = drive.synchronise >> axis & 1 == 1;
        if asked && !slot.asked {
            slot.counter.forget();
            slot.commands.push_back(command::START_SYNCHRO);
        } else if !asked && slot.asked && !slot.counter.is_found() {
            slot.commands.push_back(command::FINISH_SYNCHRO);
        }
        slot.asked = asked;
    }

    /// Whether the card gives signs of life.
    ///
    /// # Errors
    /// Not any more.
    fn watch(
        &mut self,
        came: bool,
        period: u64,
        effector: usize,
        notes: &mut Notes,
    ) -> Result<(), PortFault> {
        if came {
            self.quiet = 0;
            return Ok(());
        }
        self.quiet += 1;
        if self.quiet == 2 * MISS {
            notes.tell(period, effector, What::NoInterrupt);
        }
        if self.quiet < LOST * MISS {
            return Ok(());
        }
        let at = period as f64 * PERIOD;
        let reason = format!(
            "{}: no interrupt from the card for {} ms, in period {period} ({at:.3} s): check the cabinet",
            self.parts.name,
            2 * self.quiet
        );
        Err(PortFault { effector, reason })
    }
}

impl<R: Registers> Port for IsaPort<R> {
    fn each_counts(&self) -> bool {
        false
    }

    fn insist(&mut self) {
        for arm in &mut self.arms {
            arm.write(&ArmDrive::OFF);
        }
    }

    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        let (mut lost, begun) = (Ok(()), Instant::now());
        for (effector, (arm, reading)) in self.arms.iter_mut().zip(readings).enumerate() {
            // The card goes by its own clock: a second word in one of its periods would be lost for good, and counters
            // are whole only between two of them.
            let patience = if self.begun { WAIT } else { FIRST };
            let came = arm.parts.registers.interrupted(patience.saturating_sub(begun.elapsed()));
            if !(came || self.begun) {
                let name = &arm.parts.name;
                let reason = format!("{name}: no interrupt from the card: check the cabinet");
                return Err(PortFault { effector, reason });
            }
            arm.ready = came;
            if came {
                let mut now = ArmReading::default();
                arm.read(&mut now);
                arm.last = now;
            }
            let missing = if came { 0 } else { u8::MAX };
            *reading = ArmReading { extrapolated: missing, no_answer: missing, ..arm.last };
            let (wrench, new) = arm.parts.force.read(period, effector, &mut self.notes);
            (reading.wrench_on_sensor, reading.wrench_is_old) = (wrench, !new);
            lost = lost.and(arm.watch(came, period, effector, &mut self.notes));
        }
        self.begun = true;
        for (arm, drive) in self.arms.iter_mut().zip(drives) {
            // A cube may join the arms: all stop for one.
            if lost.is_err() {
                arm.write(&ArmDrive::OFF);
            } else if arm.ready {
                arm.write(drive);
            }
        }
        lost
    }
}

impl<R: Registers> Drop for IsaPort<R> {
    fn drop(&mut self) {
        self.arms.iter_mut().for_each(Arm::end);
    }
}

impl<R: Registers> std::fmt::Debug for IsaPort<R> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("IsaPort").field("arms", &self.arms.len()).finish_non_exhaustive()
    }
}
