//! Emulated ISA cards with a world behind them: registers, commands and interrupts without a bus or
//! a clock.
//!
//! - in, out: those of a [`Port`]; all data in between passes word by word through the registers of
//!   [`Bank`]s
//! - between two interrupts a card takes one word for each axis and loses a second one; it raises
//!   no interrupt before the cause of the last one was cleared
//! - a reading shows the period before, so a servo has one period more of delay than against the
//!   bare world
//! - assumptions that the published sources neither confirm nor exclude: brakes hold while all
//!   pulse widths are 0; an alarm lasts until it is reset; an axis counts as synchronised when the
//!   tracking ends after a zero

use super::registers::{AxisKind, AxisStatus, REVOLUTION, Registers, command, port, width_of};
use super::{IsaArm, IsaPort};
use crate::hw::force::ForceSource;
use crate::hw::note::Notes;
use crate::hw::port::{Port, PortFault};
use crate::motion::{AXES, Depth};
use crate::servo::io::{ArmDrive, ArmReading, JAW};
use crate::spatial::Wrench;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Periods in a row with a current above its limit after which the card raises an over-current.
const TRIPS: u32 = 50;

/// An axis of a card.
#[derive(Debug, Clone, Copy)]
#[allow(clippy::struct_excessive_bools, reason = "each bool is one flag of the hardware")]
pub struct CardAxis {
    /// Kind of the axis.
    pub kind: AxisKind,
    /// Pulse width, -255..=255.
    pub width: i16,
    /// Limit of its current (units).
    pub max_current: u8,
    /// Periods in a row in which the current was above that limit.
    above: u32,
    /// Whether the cabinet's buttons move it.
    pub manual: bool,
    /// Status; its over-current lasts until the alarm is reset.
    pub status: AxisStatus,
    /// Whether the resolver cannot be read.
    pub unreadable: bool,
    /// Counter of the axis in the world (increments).
    position: i64,
    /// Value of `position` at which the card's counter is zero.
    zero: i64,
    /// Motor current (units).
    current: u8,
    /// Whether it tracks its zero.
    tracks: bool,
    /// Whether it has passed the zero that it tracks.
    passed: bool,
    /// Whether it has taken a word since the last interrupt.
    taken: bool,
}

/// The state of a card.
#[derive(Debug, Clone)]
#[allow(clippy::struct_excessive_bools, reason = "each bool is one flag of the hardware")]
pub struct Card {
    /// Axes, the jaw's last.
    pub axes: [CardAxis; AXES + 1],
    /// Divisor of its interrupts.
    pub divisor: u8,
    /// Whether it raises interrupts.
    pub alive: bool,
    /// Periods for which the card's own clock is still stopped.
    pub stalls: u32,
    /// Whether an axis sets its counter to zero by itself at a zero that it tracks.
    pub zeroes_itself: bool,
    /// Binary outputs.
    pub outputs: u16,
    /// Binary inputs.
    pub inputs: u16,
    /// Analog inputs.
    pub analog: [u8; 8],
    /// Commands that were taken, each with the index of its axis.
    pub commands: Vec<(usize, u16)>,
    /// Number of words that were lost because they came too soon after another.
    pub lost: u32,
    wrench: Wrench,
    first_pointer: u8,
    has_track: bool,
    power_axis: usize,
    units_per_ampere: [f64; AXES + 1],
    pointer: u8,
    /// Whether the interrupts were started.
    running: bool,
    /// Parts of the acknowledgement that were read: status, reply.
    cleared: (bool, bool),
    /// Whether an interrupt is pending.
    interrupt: bool,
}

impl Card {
    /// Returns the index of the first axis: 0 with a track, else 1.
    fn first(&self) -> usize {
        usize::from(!self.has_track)
    }

    /// Returns the index of the axis that the card's pointer selects, or `None` if it selects no
    /// axis.
    fn chosen(&self) -> Option<usize> {
        let axis = usize::from(self.pointer.checked_sub(self.first_pointer)?) + self.first();
        (axis <= JAW).then_some(axis)
    }

    /// Carries out a command word: to the card itself, or to the axis that the pointer selects.
    fn command(&mut self, word: u16) {
        match word & 0xff00 {
            command::SET_INTERRUPT_DIVISOR => self.divisor = word as u8,
            command::START_INTERRUPTS => self.running = true,
            _ => {
                if let Some(axis) = self.chosen() {
                    self.obey(axis, word);
                }
            }
        }
    }

    /// Carries out a command word to the axis `index`. A second word before the next interrupt is
    /// lost.
    fn obey(&mut self, index: usize, word: u16) {
        let axis = &mut self.axes[index];
        if std::mem::replace(&mut axis.taken, true) {
            self.lost += 1;
            return;
        }
        if let Some(width) = width_of(word) {
            axis.width = width;
            return;
        }
        // The list serves tests. The bound keeps a long run from filling the memory.
        if self.commands.len() < 1 << 16 {
            self.commands.push((index, word));
        }
        match word {
            command::RESET_POSITION => axis.reset(),
            command::RESET_ALARM => axis.status.over_current = false,
            command::PROHIBIT_MANUAL => axis.manual = false,
            command::ALLOW_MANUAL => axis.manual = true,
            command::START_SYNCHRO => {
                (axis.tracks, axis.passed, axis.status.synchronised) = (true, false, false);
            }
            command::FINISH_SYNCHRO => {
                let found = axis.tracks && axis.passed && axis.kind != AxisKind::Resolver;
                axis.status.synchronised |= found;
                axis.tracks = false;
            }
            _ if word & 0xff00 == command::SET_MAX_CURRENT => axis.max_current = word as u8,
            // Other words have no effect on the emulated world, for example `RESET_MANUAL`.
            _ => {}
        }
    }

    /// Advances the card by 2 ms, unless its clock is stopped.
    fn tick(&mut self) {
        if self.stalls > 0 {
            self.stalls -= 1;
            return;
        }
        for axis in &mut self.axes {
            axis.taken = false;
        }
        if self.alive && self.running && self.cleared == (true, true) {
            (self.interrupt, self.cleared) = (true, (false, false));
        }
    }

    /// Converts the pulse widths and outputs of the card to a motor drive of the plant.
    fn drive(&self) -> ArmDrive {
        let jaw = &self.axes[JAW];
        ArmDrive {
            // A card has no switch for the brakes: see the assumptions of the module.
            enabled: self.axes.iter().any(|axis| axis.width != 0),
            pwm: std::array::from_fn(|i| self.axes[i].width),
            jaw_pwm: jaw.width,
            stops: if self.outputs & 1 == 1 { Depth::Two } else { Depth::One },
            // The card finds the zeros by itself, so the world must not.
            synchronise: 0,
        }
    }

    /// Copies the readings of the plant into the registers.
    fn latch(&mut self, reading: &ArmReading) {
        self.wrench = reading.wrench_on_sensor;
        for (i, axis) in self.axes.iter_mut().enumerate() {
            let bit = |bits: u8| bits >> i & 1 == 1;
            axis.position = if i == JAW { reading.jaw_count } else { reading.counts[i] };
            let units = reading.currents[i].abs() * self.units_per_ampere[i];
            axis.current = units.round().clamp(0.0, 255.0) as u8;
            // A current above the limit for up to `TRIPS` periods (0.1 s) is a peak, no alarm.
            axis.above = if axis.current > axis.max_current { axis.above + 1 } else { 0 };
            axis.status = AxisStatus {
                zero: bit(reading.encoder_zeros),
                over_current: axis.status.over_current
                    || axis.above > TRIPS
                    || bit(reading.over_currents),
                sync_switch: bit(reading.sync_switches),
                upper: bit(reading.upper_limits),
                lower: bit(reading.lower_limits),
                synchronised: axis.status.synchronised,
                power: i == self.power_axis && !bit(reading.power_faults),
            };
            // The zero that counts is the first one off the switch, as in the port's counter.
            if axis.tracks && axis.status.zero && !axis.status.sync_switch && !axis.passed {
                axis.passed = true;
                if self.zeroes_itself {
                    axis.reset();
                }
            }
        }
    }
}

impl CardAxis {
    /// Sets the counter of the axis to zero. The counter of a resolver keeps its angle within a
    /// revolution.
    fn reset(&mut self) {
        self.zero = match self.kind {
            // The angle within a revolution is absolute: only whole revolutions become zero.
            AxisKind::Resolver => self.position - self.position.rem_euclid(REVOLUTION),
            AxisKind::Encoder { .. } => self.position,
        };
    }

    /// Returns the low and the high word of the axis's counter; the registers show them inverted.
    fn words(&self) -> (u16, u16) {
        let count = self.position - self.zero;
        match self.kind {
            // The mark of a bad reading.
            AxisKind::Resolver if self.unreadable => (0x0800, 0),
            AxisKind::Resolver => {
                (count.rem_euclid(REVOLUTION) as u16, count.div_euclid(REVOLUTION) as u16)
            }
            AxisKind::Encoder { .. } => (count as u16, (count >> 16) as u16),
        }
    }
}

/// The registers of an emulated card. Clones share the card.
#[derive(Debug, Clone)]
pub struct Bank(Arc<Mutex<Card>>);

impl Bank {
    /// Makes an emulated card with the axes and pointers of `arm`, before its set-up.
    #[must_use]
    pub fn of(arm: &IsaArm<()>) -> Self {
        let axis = |kind| CardAxis {
            kind,
            width: 0,
            max_current: 0,
            above: 0,
            manual: true,
            status: AxisStatus::default(),
            unreadable: false,
            position: 0,
            zero: 0,
            current: 0,
            tracks: false,
            passed: false,
            taken: false,
        };
        Self(Arc::new(Mutex::new(Card {
            axes: arm.kinds.map(axis),
            divisor: 0,
            alive: true,
            stalls: 0,
            zeroes_itself: false,
            outputs: 0,
            inputs: 0,
            analog: [0; 8],
            commands: Vec::new(),
            lost: 0,
            wrench: Wrench::default(),
            first_pointer: arm.first_pointer,
            has_track: arm.has_track,
            power_axis: arm.power_axis,
            units_per_ampere: arm.units_per_ampere,
            pointer: 0,
            running: false,
            cleared: (false, false),
            interrupt: false,
        })))
    }

    /// Locks and returns the card.
    pub fn card(&self) -> MutexGuard<'_, Card> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Registers for Bank {
    fn read8(&mut self, _: u16) -> u8 {
        // No register of a card is read by bytes. A bus on which no device answers reads as ones.
        0xff
    }

    /// Sets the pointer; a write to any other port has no effect.
    fn write8(&mut self, at: u16, value: u8) {
        if at == port::AXIS {
            self.card().pointer = value;
        }
    }

    /// Writes the binary outputs or a command word; a write to any other port has no effect.
    fn write16(&mut self, at: u16, value: u16) {
        let mut card = self.card();
        match (at, card.pointer) {
            (port::OUTPUTS, port::IO_PACKET) => card.outputs = value,
            (port::COMMAND, _) => card.command(value),
            _ => {}
        }
    }

    /// Reads a register of the axis, or the inputs, that the pointer selects; all ones if the card
    /// has no such register.
    fn read16(&mut self, at: u16) -> u16 {
        let mut card = self.card();
        // The acknowledgement of an interrupt is the read of both registers. The pointer 0xc0 also
        // selects axis 0 of a track's card, so these reads also return that axis.
        if card.pointer == port::INTERRUPTS {
            card.cleared.0 |= at == port::COMMAND;
            card.cleared.1 |= at == port::OUTPUTS;
        }
        if card.pointer == port::IO_PACKET {
            let analog = |pair: usize| {
                u16::from_le_bytes([card.analog[2 * pair], card.analog[2 * pair + 1]])
            };
            return match at {
                port::INPUTS => card.inputs,
                port::COMMAND | port::OUTPUTS | port::POSITION_LOW | port::POSITION_HIGH => {
                    analog(usize::from(at - port::COMMAND) / 2)
                }
                _ => u16::MAX,
            };
        }
        let Some(axis) = card.chosen().map(|index| card.axes[index]) else { return u16::MAX };
        let (low, high) = axis.words();
        // A resolver axis has its current in the status, an encoder axis in the reply.
        let current = u16::from(axis.current);
        match (at, axis.kind) {
            (port::COMMAND, AxisKind::Resolver) => axis.status.encode(axis.kind) | current,
            (port::COMMAND, _) => axis.status.encode(axis.kind),
            (port::OUTPUTS, _) => current << 8,
            (port::POSITION_LOW, _) => !low,
            (port::POSITION_HIGH, _) => !high,
            _ => u16::MAX,
        }
    }

    fn interrupted(&mut self, _: Duration) -> bool {
        std::mem::take(&mut self.card().interrupt)
    }

    fn pause(&mut self) {
        self.card().tick();
    }
}

/// The force sensor of a card's world.
struct WorldSensor(Bank);

impl ForceSource for WorldSensor {
    fn read(&mut self, _: u64, _: usize, _: &mut Notes) -> (Wrench, bool) {
        (self.0.card().wrench, true)
    }
}

/// A port with emulated cards before a world: the simulated plant, or the motors of a test.
pub struct Carded<P> {
    port: IsaPort<Bank>,
    world: P,
    banks: Vec<Bank>,
    drives: Vec<ArmDrive>,
    readings: Vec<ArmReading>,
}

impl<P: Port> Carded<P> {
    /// Puts an emulated card for each arm before `world`, a plant at rest, and sets the cards up.
    /// An axis that the plant reports as synchronised is also synchronised in its card, unless it
    /// has a resolver.
    ///
    /// # Errors
    /// The fault of the plant.
    pub fn new(mut world: P, arms: Vec<IsaArm<()>>, notes: Notes) -> Result<Self, PortFault> {
        let drives = vec![ArmDrive::OFF; arms.len()];
        let mut readings = vec![ArmReading::default(); arms.len()];
        world.exchange(0, &drives, &mut readings)?;
        let banks: Vec<Bank> = arms.iter().map(Bank::of).collect();
        for (bank, reading) in banks.iter().zip(&readings) {
            let mut card = bank.card();
            for (i, axis) in card.axes.iter_mut().enumerate() {
                axis.status.synchronised =
                    axis.kind != AxisKind::Resolver && reading.synchronised >> i & 1 == 1;
            }
            card.latch(reading);
        }
        let arms = arms
            .into_iter()
            .zip(&banks)
            .map(|(arm, bank)| IsaArm {
                force: Box::new(WorldSensor(bank.clone())),
                ..arm.with(bank.clone())
            })
            .collect();
        Ok(Self { port: IsaPort::new(arms, notes), world, banks, drives, readings })
    }

    /// Returns the registers of the emulated card of the arm with this index.
    pub fn bank(&self, arm: usize) -> &Bank {
        &self.banks[arm]
    }

    /// Returns the plant behind the cards.
    pub fn world(&self) -> &P {
        &self.world
    }

    /// Returns the plant behind the cards, to change it.
    pub fn world_mut(&mut self) -> &mut P {
        &mut self.world
    }
}

impl<P: Port> Port for Carded<P> {
    /// Exchanges drives and readings with the cards, then computes a period of the world under the
    /// drives that the cards have taken. The readings show the world before that period.
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        // The cards show the world's last period. The world then moves by the words that the cards
        // have taken in this exchange.
        self.port.exchange(period, drives, readings)?;
        for (bank, drive) in self.banks.iter().zip(&mut self.drives) {
            *drive = bank.card().drive();
        }
        self.world.exchange(period, &self.drives, &mut self.readings)?;
        for (bank, reading) in self.banks.iter().zip(&self.readings) {
            let mut card = bank.card();
            card.tick();
            card.latch(reading);
        }
        Ok(())
    }
}

impl<P> std::fmt::Debug for Carded<P> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Carded").field("arms", &self.banks.len()).finish_non_exhaustive()
    }
}
