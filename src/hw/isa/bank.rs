//! Emulated cards, and a world behind them: registers, commands and interrupts without a bus or a clock.
//!
//! - in, out: as any [`Port`]; everything between goes word by word through the registers of [`Bank`]s
//! - a card takes one word an axis and interrupt, a further one is lost; it raises no interrupt before the cause of the
//!   last one was cleared
//! - a reading tells the period before: a servo has one period more of delay than against the bare world
//! - assumptions where the published sources are silent: brakes hold while all pulse widths are 0; an alarm lasts until
//!   it is reset; an axis counts as synchronised when tracking ends after a zero

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

/// Periods after which a current above its limit is one too many.
const TRIPS: u32 = 50;

/// An axis of a card.
#[derive(Debug, Clone, Copy)]
#[allow(clippy::struct_excessive_bools, reason = "flags of a card, as the hardware has them")]
pub struct CardAxis {
    /// How it is read.
    pub kind: AxisKind,
    /// Pulse width.
    pub width: i16,
    /// Limit of its current (units).
    pub max_current: u8,
    /// Periods in a row in which the current was above that.
    above: u32,
    /// The cabinet's buttons move it.
    pub manual: bool,
    /// What it shows; the alarm lasts.
    pub status: AxisStatus,
    /// The resolver cannot be read.
    pub unreadable: bool,
    /// Where the world counts.
    position: i64,
    /// Where its own counter was set to zero.
    zero: i64,
    current: u8,
    tracks: bool,
    passed: bool,
    /// It has had its word since the last interrupt.
    taken: bool,
}

/// The state of a card.
#[derive(Debug, Clone)]
#[allow(clippy::struct_excessive_bools, reason = "flags of a card, as the hardware has them")]
pub struct Card {
    /// Its axes; the jaw's is the last.
    pub axes: [CardAxis; AXES + 1],
    /// Divisor of its interrupts.
    pub divisor: u8,
    /// Its interrupts come.
    pub alive: bool,
    /// Periods that the card's own clock still stands.
    pub stalls: u32,
    /// Axes set their counters to zero by themselves when they pass a zero that they track.
    pub zeroes_itself: bool,
    /// Binary outputs.
    pub outputs: u16,
    /// Binary inputs.
    pub inputs: u16,
    /// Analog inputs.
    pub analog: [u8; 8],
    /// Commands that were taken, by axis.
    pub told: Vec<(usize, u16)>,
    /// Words that were lost because they came too soon after another.
    pub lost: u32,
    wrench: Wrench,
    first_pointer: u8,
    has_track: bool,
    power_axis: usize,
    units_per_ampere: [f64; AXES + 1],
    pointer: u8,
    running: bool,
    /// What of the acknowledgement was read: status, reply.
    cleared: (bool, bool),
    interrupt: bool,
}

impl Card {
    fn first(&self) -> usize {
        usize::from(!self.has_track)
    }

    /// The axis at the pointer.
    fn chosen(&self) -> Option<usize> {
        let axis = usize::from(self.pointer.checked_sub(self.first_pointer)?) + self.first();
        (axis <= JAW).then_some(axis)
    }

    fn command(&mut self, word: u16) {
        match word & 0xff00 {
            command::SET_INTERRUPT_DIVISOR => self.divisor = word as u8,
            command::START_INTERRUPTS => self.running = true,
            _ => {
                if let Some(axis) = self.chosen() {
                    self.tell(axis, word);
                }
            }
        }
    }

    fn tell(&mut self, index: usize, word: u16) {
        let axis = &mut self.axes[index];
        if std::mem::replace(&mut axis.taken, true) {
            self.lost += 1;
            return;
        }
        if let Some(width) = width_of(word) {
            axis.width = width;
            return;
        }
        if self.told.len() < 1 << 16 {
            self.told.push((index, word));
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
            _ => {}
        }
    }

    /// 2 ms pass for the card, unless its clock is behind.
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

    /// What it makes of its words.
    fn drive(&self) -> ArmDrive {
        let jaw = &self.axes[JAW];
        ArmDrive {
            enabled: self.axes.iter().any(|axis| axis.width != 0),
            pwm: std::array::from_fn(|i| self.axes[i].width),
            jaw_pwm: jaw.width,
            stops: if self.outputs & 1 == 1 { Depth::Two } else { Depth::One },
            // Zeros are the card's own business.
            synchronise: 0,
        }
    }

    /// Takes what the world shows.
    fn latch(&mut self, reading: &ArmReading) {
        self.wrench = reading.wrench_on_sensor;
        for (i, axis) in self.axes.iter_mut().enumerate() {
            let bit = |bits: u8| bits >> i & 1 == 1;
            axis.position = if i == JAW { reading.jaw_count } else { reading.counts[i] };
            let units = reading.currents[i].abs() * self.units_per_ampere[i];
            axis.current = units.round().clamp(0.0, 255.0) as u8;
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
    fn reset(&mut self) {
        self.zero = match self.kind {
            // Its angle stays what it is.
            AxisKind::Resolver => self.position - self.position.rem_euclid(REVOLUTION),
            AxisKind::Encoder { .. } => self.position,
        };
    }

    /// Both words of its counter.
    fn words(&self) -> (u16, u16) {
        let count = self.position - self.zero;
        match self.kind {
            AxisKind::Resolver if self.unreadable => (0x0800, 0),
            AxisKind::Resolver => {
                (count.rem_euclid(REVOLUTION) as u16, count.div_euclid(REVOLUTION) as u16)
            }
            AxisKind::Encoder { .. } => (count as u16, (count >> 16) as u16),
        }
    }
}

/// The registers of a card; clones are the same card.
#[derive(Debug, Clone)]
pub struct Bank(Arc<Mutex<Card>>);

impl Bank {
    /// The card that an arm expects.
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
            told: Vec::new(),
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

    /// The card itself.
    pub fn card(&self) -> MutexGuard<'_, Card> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Registers for Bank {
    fn read8(&mut self, _: u16) -> u8 {
        // No register of a card is read by bytes; a bus without an answer reads so.
        0xff
    }

    fn write8(&mut self, at: u16, value: u8) {
        if at == port::AXIS {
            self.card().pointer = value;
        }
    }

    fn write16(&mut self, at: u16, value: u16) {
        let mut card = self.card();
        match (at, card.pointer) {
            (port::OUTPUTS, port::IO_PACKET) => card.outputs = value,
            (port::COMMAND, _) => card.command(value),
            _ => {}
        }
    }

    fn read16(&mut self, at: u16) -> u16 {
        let mut card = self.card();
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

/// The wrench that a card's world feels.
struct Felt(Bank);

impl ForceSource for Felt {
    fn read(&mut self, _: u64, _: usize, _: &mut Notes) -> (Wrench, bool) {
        (self.0.card().wrench, true)
    }
}

/// A world behind cards.
pub struct Carded<P> {
    port: IsaPort<Bank>,
    world: P,
    banks: Vec<Bank>,
    drives: Vec<ArmDrive>,
    readings: Vec<ArmReading>,
}

impl<P: Port> Carded<P> {
    /// Puts a world at rest behind the cards of its arms, and sets them up. Where the world is synchronised, so are they.
    ///
    /// # Errors
    /// What the world says.
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
                force: Box::new(Felt(bank.clone())),
                ..arm.with(bank.clone())
            })
            .collect();
        Ok(Self { port: IsaPort::new(arms, notes), world, banks, drives, readings })
    }

    /// The card of an arm.
    pub fn bank(&self, arm: usize) -> &Bank {
        &self.banks[arm]
    }

    /// The world.
    pub fn world(&self) -> &P {
        &self.world
    }

    /// The world, for whoever looks after it.
    pub fn world_mut(&mut self) -> &mut P {
        &mut self.world
    }
}

impl<P: Port> Port for Carded<P> {
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
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
