//! The bridge to arms behind ISA cards.
//!
//! - in: the drives of a period
//! - out: the readings of the cards in the same period
//! - an axis takes one word for each interrupt, so a period sends it either one waiting command or
//!   its pulse width
//! - the end of the bridge enables the cabinet's buttons again
//!
//! | fault | threshold | reaction |
//! |---|---|---|
//! | an axis shows an error, or power is off | one period | all motors of the arm stop at once |
//! | the card raises no interrupt | below 2 x [`MISS`] (20 ms) | none |
//! | the card raises no interrupt | 2 x [`MISS`] (20 ms) | a note |
//! | the card raises no interrupt | [`LOST`] x [`MISS`] (30 ms) | a fault, all arms stop |
//!
//! The stop at an error or loss of power takes place in the period in which the card shows it,
//! before the servo knows of it.

use super::counter::Counter;
use super::registers::{
    AxisKind, AxisStatus, HARDWARE_ERROR, LIMITS, Registers, command, counter, error_word, port,
    pulse_word, resolver,
};
use crate::hw::force::ForceSource;
use crate::hw::note::{NoteKind, Notes};
use crate::hw::port::{Port, PortFault};
use crate::motion::{AXES, Depth, PERIOD};
use crate::servo::io::{ArmDrive, ArmReading, JAW};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Longest wait of an exchange for the card's next period. The rest of the period has passed since
/// the last exchange, so the interrupt is near.
const WAIT: Duration = Duration::from_millis(1);
/// Longest wait of the first exchange.
const FIRST: Duration = Duration::from_millis(100);
/// Periods without an interrupt that make one miss: 10 ms, as in the original.
const MISS: u32 = 5;
/// Misses after which the card counts as lost.
const LOST: u32 = 3;
/// Pauses between the divisor of the interrupts and their start: 10 ms, as in the original.
const SETTLES: u32 = 5;

/// An arm's card and its force sensor.
pub struct IsaArm<R> {
    /// Name of the effector, for messages.
    pub name: String,
    /// Registers of the card.
    pub registers: R,
    /// Pointer of its first axis: 0xc0 of the track's card, 0xc1 of the postument's.
    pub first_pointer: u8,
    /// Divisor of its interrupts for a period of 2 ms.
    pub divisor: u8,
    /// Whether it has an axis 0; without one the first pointer is that of axis 1.
    pub has_track: bool,
    /// Kind of each axis, the jaw's last.
    pub kinds: [AxisKind; AXES + 1],
    /// Axis whose status shows the power of all. It must have an encoder, or a loss of power is not
    /// detected.
    pub power_axis: usize,
    /// Units of current per ampere (1/A), the jaw's last.
    pub units_per_ampere: [f64; AXES + 1],
    /// Limits of the motor currents (units), the jaw's last.
    pub max_currents: [u8; AXES + 1],
    /// Force sensor.
    pub force: Box<dyn ForceSource>,
}

impl IsaArm<()> {
    /// Returns the arm with the `registers` by which its card is reached.
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

/// An axis of a card.
struct Axis {
    counter: Counter,
    /// Commands that are still to be sent.
    commands: VecDeque<u16>,
    /// Pulse width that was sent last.
    width: i16,
    /// Whether the drive asked for its synchronisation in the last period.
    asked: bool,
}

/// An arm's card, with the state of its set-up, errors and words.
struct Arm<R> {
    parts: IsaArm<R>,
    axes: [Axis; AXES + 1],
    enabled: bool,
    /// Whether an error of an axis, or the loss of power, keeps all motors off.
    hard: bool,
    /// Errors of the axes, as in the aggregated error word.
    errors: u64,
    /// Limit switches that were hit when the drives were switched on, and have been since. They
    /// stop no motor, because an axis must be able to leave its limit switch. The servo keeps the
    /// axis from moving further onto the switch.
    spared: u64,
    /// Last reading, for a period in which the card has no new one.
    last: ArmReading,
    /// Binary outputs that were sent last.
    outputs: Option<u16>,
    /// Whether the card waits for its words.
    ready: bool,
    /// Periods since the last interrupt.
    quiet: u32,
}

/// The bridge to all arms.
pub struct IsaPort<R: Registers> {
    arms: Vec<Arm<R>>,
    begun: bool,
    notes: Notes,
}

impl<R: Registers> IsaPort<R> {
    /// Sets the cards up: interrupts every 2 ms, limits of the currents, the cabinet's buttons
    /// disabled. It takes about 30 ms for each card.
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
    /// Sets the card up with the commands of the original robot's program, in their order.
    fn set_up(&mut self) {
        // An interrupt whose cause was not cleared by an earlier program blocks all further ones.
        self.acknowledge();
        self.send(command::SET_INTERRUPT_DIVISOR | u16::from(self.parts.divisor));
        for _ in 0..SETTLES {
            self.parts.registers.pause();
        }
        self.send(command::START_INTERRUPTS);
        self.parts.registers.pause();
        self.send_all(|_| command::RESET_MANUAL);
        self.send_all(|_| command::PROHIBIT_MANUAL);
        let limits = self.parts.max_currents;
        self.send_all(|axis| command::SET_MAX_CURRENT | u16::from(limits[axis]));
        self.send_all(|_| command::MICROCONTROLLER_MODE);
        self.send_all(|_| command::STOP_MOTOR);
        self.send_all(|_| command::RESET_MANUAL);
        self.send_all(|_| command::RESET_ALARM);
        // A synchronised axis keeps its counter: the arm need not be synchronised after each start
        // of the program.
        let mut known = [false; AXES + 1];
        for (axis, known) in known.iter_mut().enumerate().skip(self.first()) {
            self.choose(axis);
            *known = self.status(axis).synchronised;
        }
        // An axis that is not synchronised counts from its present position. A synchronised one
        // gets a word without effect.
        self.send_all(
            |axis| {
                if known[axis] { command::STOP_MOTOR } else { command::RESET_POSITION }
            },
        );
    }

    /// Stops all motors and enables the cabinet's buttons. It sends the stop twice, because a word
    /// of the last exchange may keep the card from taking the first one.
    fn end(&mut self) {
        for word in [
            command::STOP_MOTOR,
            command::MICROCONTROLLER_MODE,
            command::STOP_MOTOR,
            command::RESET_MANUAL,
            command::RESET_ALARM,
            command::ALLOW_MANUAL,
        ] {
            self.send_all(|_| word);
        }
    }

    /// Returns the index of the first axis: 0 with a track, else 1.
    fn first(&self) -> usize {
        usize::from(!self.parts.has_track)
    }

    /// Sets the pointer to `axis`, to which the following words then belong.
    fn choose(&mut self, axis: usize) {
        let pointer = self.parts.first_pointer + (axis - self.first()) as u8;
        self.parts.registers.write8(port::AXIS, pointer);
    }

    /// Writes a command word to the card, for the axis that the pointer selects.
    fn send(&mut self, word: u16) {
        self.parts.registers.write16(port::COMMAND, word);
    }

    /// Sends a word to each axis and waits until the card has taken it.
    fn send_all(&mut self, word: impl Fn(usize) -> u16) {
        for axis in self.first()..=JAW {
            self.choose(axis);
            self.send(word(axis));
        }
        self.parts.registers.pause();
        self.acknowledge();
    }

    /// Clears the cause of the interrupt, without which no further one comes. The pointer then
    /// selects the interrupt generator.
    fn acknowledge(&mut self) {
        self.parts.registers.write8(port::AXIS, port::INTERRUPTS);
        self.parts.registers.read16(port::COMMAND);
        self.parts.registers.read16(port::OUTPUTS);
    }

    /// Reads the status of `axis`, which the pointer must select already.
    fn status(&mut self, axis: usize) -> AxisStatus {
        AxisStatus::decode(self.parts.registers.read16(port::COMMAND), self.parts.kinds[axis])
    }

    /// Reads all axes and the inputs of the card into `reading`, and acknowledges its interrupt.
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
            // At the reading that shows the zero, the card is ordered to end its tracking.
            if counter.take(position, status) {
                commands.push_back(command::FINISH_SYNCHRO);
                if counter.is_off() {
                    commands.push_back(command::RESET_POSITION);
                }
                // The original sends this to encoder axes, without a reason in its sources: some
                // do not move otherwise.
                if kind != AxisKind::Resolver {
                    commands.push_back(command::MICROCONTROLLER_MODE);
                }
            }
            let bit = |is: bool| u8::from(is) << axis;
            // The card measures the magnitude; the sign is that of the pulse width.
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
        // A resolver axis has no bit of power, so it must not look like a loss of it.
        let power_axis = self.parts.power_axis;
        let off = matches!(self.parts.kinds[power_axis], AxisKind::Encoder { .. })
            && !statuses[power_axis].power;
        if off {
            reading.power_faults = u8::MAX;
        }
        let errors = error_word(statuses) & HARDWARE_ERROR;
        // A switch that an axis has left stops the motors when it is hit again.
        self.spared &= errors;
        self.hard = off || errors & !self.spared != 0;
        self.errors = errors;
    }

    /// Reads the binary and analog inputs of the card into `reading`.
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

    /// Sends one word to each axis, and the outputs if they have changed.
    fn write(&mut self, drive: &ArmDrive) {
        let switched = drive.enabled != self.enabled;
        if switched && drive.enabled {
            self.spared = self.errors & LIMITS;
        }
        // A stop is sent before any waiting command.
        let stops = self.enabled && (self.hard || !drive.enabled);
        for axis in self.first()..=JAW {
            self.queue(axis, drive, switched);
            self.choose(axis);
            // An axis takes one word in a period: a waiting command delays the pulse width.
            let waiting = if stops { None } else { self.axes[axis].commands.pop_front() };
            if let Some(word) = waiting {
                let counter = &mut self.axes[axis].counter;
                match word {
                    command::START_SYNCHRO => counter.await_zero(),
                    command::FINISH_SYNCHRO => counter.stop_waiting(),
                    command::RESET_POSITION => counter.was_reset(),
                    _ => {}
                }
                self.send(word);
            } else {
                let width = if axis == JAW { drive.jaw_pwm } else { drive.pwm[axis] };
                let width = if drive.enabled && !stops { width } else { 0 };
                self.axes[axis].width = width;
                self.send(pulse_word(width));
            }
        }
        // The palm's stops belong to a binary output, which keeps its state: only a change is sent.
        let outputs = u16::from(drive.stops == Depth::Two);
        if self.outputs != Some(outputs) {
            self.outputs = Some(outputs);
            self.parts.registers.write8(port::AXIS, port::IO_PACKET);
            self.parts.registers.write16(port::OUTPUTS, outputs);
        }
        self.enabled = drive.enabled;
    }

    /// Queues the commands to an axis that `drive` requires: to reset its alarm if the power was
    /// `switched`, and to begin or end the search for its zero.
    fn queue(&mut self, axis: usize, drive: &ArmDrive, switched: bool) {
        let slot = &mut self.axes[axis];
        // The card keeps an alarm until it is reset. Without this the servo could not begin again
        // after the cause is gone; a cause that lasts raises the alarm again.
        if switched {
            slot.commands.push_back(command::RESET_ALARM);
        }
        let asked = drive.synchronise >> axis & 1 == 1;
        if asked && !slot.asked {
            slot.counter.forget();
            slot.commands.push_back(command::START_SYNCHRO);
        } else if !asked && slot.asked && !slot.counter.is_found() {
            // The homing was broken off before the zero.
            slot.commands.push_back(command::FINISH_SYNCHRO);
        }
        slot.asked = asked;
    }

    /// Counts the periods without an interrupt of the card; `came` tells whether one came in this
    /// period. After 20 ms without one it adds a note.
    ///
    /// # Errors
    /// [`PortFault`] after 30 ms without one.
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
        // The first miss passes without a note, the second gives one, the third is the fault,
        // as in the original.
        if self.quiet == 2 * MISS {
            notes.push(period, effector, NoteKind::NoInterrupt);
        }
        if self.quiet < LOST * MISS {
            return Ok(());
        }
        let at = period as f64 * PERIOD;
        let reason = format!(
            "{}: no interrupt from the card for {} ms, in period {period} ({at:.3} s): \
             check the cabinet",
            self.parts.name,
            2 * self.quiet
        );
        Err(PortFault { effector, reason })
    }
}

impl<R: Registers> Port for IsaPort<R> {
    fn needs_each_period(&self) -> bool {
        false
    }

    /// Writes drives that are switched off to the cards of all arms.
    fn repeat_stop(&mut self) {
        for arm in &mut self.arms {
            arm.write(&ArmDrive::OFF);
        }
    }

    /// Waits for the interrupt of each card and reads the card, then writes the drives. A card
    /// without an interrupt gives its last reading and gets no words.
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        let (mut lost, begun) = (Ok(()), Instant::now());
        for (effector, (arm, reading)) in self.arms.iter_mut().zip(readings).enumerate() {
            // The card has a clock of its own: it loses a second word within one of its periods,
            // and the two words of a counter belong together only within one. So each exchange
            // waits for the interrupt. All arms share one limit of the wait.
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
            // The servo must not take a repeated reading for axes that stopped dead.
            let missing = if came { 0 } else { u8::MAX };
            *reading = ArmReading { extrapolated: missing, no_answer: missing, ..arm.last };
            let (wrench, new) = arm.parts.force.read(period, effector, &mut self.notes);
            (reading.wrench_on_sensor, reading.wrench_is_old) = (wrench, !new);
            lost = lost.and(arm.watch(came, period, effector, &mut self.notes));
        }
        self.begun = true;
        for (arm, drive) in self.arms.iter_mut().zip(drives) {
            // Both hands may hold one cube, so the fault of one card stops all arms.
            if lost.is_err() {
                arm.write(&ArmDrive::OFF);
            // A card that has not raised its interrupt keeps its last pulse widths.
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
