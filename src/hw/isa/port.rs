//! The bridge to arms behind ISA cards.
//!
//! - in: the drives of a period; out: what the cards show in the same period
//! - on any hard error of an axis all motors of its arm are stopped in the same period, before the servo knows of it
//! - the card's interrupt is its sign of life: 10 ms without one are passed over, 20 ms are told, 30 ms are a fault

use super::registers::{
    AxisKind, AxisStatus, HARDWARE_ERROR, Registers, command, counter, error_word, port,
    pulse_word, resolver,
};
use crate::hw::force::ForceSource;
use crate::hw::note::{Notes, What};
use crate::hw::port::{Port, PortFault};
use crate::motion::{AXES, Depth, PERIOD};
use crate::servo::io::{ArmDrive, ArmReading, JAW};

/// Periods without an interrupt that make one miss: the original's 10 ms.
const MISS: u32 = 5;
/// Misses after which the arm is given up.
const LOST: u32 = 3;
/// Counts of a resolver's revolution.
const REVOLUTION: i64 = 682;

/// An arm's card and its force sensor.
pub struct IsaArm<R> {
    /// Name of the effector, for messages.
    pub name: String,
    /// The card.
    pub registers: R,
    /// Pointer of its first axis: 0xc0 of the track's card, 0xc1 of the postument's.
    pub first_pointer: u8,
    /// Whether it has an axis 0; without one the first pointer is axis 1's.
    pub has_track: bool,
    /// How each axis is read; the jaw's last.
    pub kinds: [AxisKind; AXES + 1],
    /// Units of current per ampere, the jaw's last.
    pub units_per_ampere: [f64; AXES + 1],
    /// Limits of the motor currents of axes 0..=6 [A].
    pub max_currents: [Option<f64>; AXES],
    /// Its force sensor.
    pub force: Box<dyn ForceSource>,
}

/// A resolver's revolutions, or an encoder's counter, as one number from the zero of synchronisation.
#[derive(Debug, Clone, Copy, Default)]
struct Counter {
    count: i64,
    angle: Option<i64>,
    synchronised: bool,
    synchronising: bool,
}

struct Arm<R> {
    parts: IsaArm<R>,
    counters: [Counter; AXES + 1],
    enabled: bool,
    jaw_limit: u8,
    /// Periods since the last interrupt.
    quiet: u32,
}

/// All arms.
pub struct IsaPort<R: Registers> {
    arms: Vec<Arm<R>>,
    notes: Notes,
}

impl<R: Registers> IsaPort<R> {
    /// Sets the cards up: current limits, no motion by hand, interrupts every 2 ms.
    #[must_use]
    pub fn new(arms: Vec<IsaArm<R>>, notes: Notes) -> Self {
        let arms = arms
            .into_iter()
            .map(|parts| {
                let counters = [Counter::default(); AXES + 1];
                let mut arm = Arm { parts, counters, enabled: false, jaw_limit: 0, quiet: 0 };
                arm.set_up();
                arm
            })
            .collect();
        Self { arms, notes }
    }
}

impl<R: Registers> Arm<R> {
    fn set_up(&mut self) {
        for axis in self.first()..=JAW {
            self.choose(axis);
            if axis < AXES
                && let Some(limit) = self.parts.max_currents[axis]
            {
                let units = self.units(axis, limit);
                self.tell(command::SET_MAX_CURRENT | u16::from(units));
            }
            self.tell(command::PROHIBIT_MANUAL);
            self.tell(command::STOP_MOTOR);
        }
        self.parts.registers.write8(port::AXIS, port::INTERRUPTS);
        self.tell(command::SET_INTERRUPT_DIVISOR | 8);
        self.tell(command::START_INTERRUPTS);
    }

    fn first(&self) -> usize {
        usize::from(!self.parts.has_track)
    }

    fn units(&self, axis: usize, amperes: f64) -> u8 {
        (amperes * self.parts.units_per_ampere[axis]).round().clamp(0.0, 255.0) as u8
    }

    fn choose(&mut self, axis: usize) {
        let pointer = self.parts.first_pointer + (axis - self.first()) as u8;
        self.parts.registers.write8(port::AXIS, pointer);
    }

    fn tell(&mut self, word: u16) {
        self.parts.registers.write16(port::COMMAND, word);
    }

    /// What every axis shows.
    fn read(&mut self, reading: &mut ArmReading) -> [AxisStatus; AXES + 1] {
        *reading =
            ArmReading { wrench_on_sensor: reading.wrench_on_sensor, ..ArmReading::default() };
        let mut statuses = [AxisStatus::default(); AXES + 1];
        for (axis, slot) in statuses.iter_mut().enumerate().skip(self.first()) {
            self.choose(axis);
            let kind = self.parts.kinds[axis];
            let word = self.parts.registers.read16(port::COMMAND);
            let status = AxisStatus::decode(word, kind);
            let low = self.parts.registers.read16(port::POSITION_LOW);
            let high = self.parts.registers.read16(port::POSITION_HIGH);
            let reply = self.parts.registers.read16(port::OUTPUTS);
            let counted = &mut self.counters[axis];
            match kind {
                AxisKind::Resolver => counted.turn(resolver(low)),
                AxisKind::Encoder => {
                    counted.count = i64::from(counter(low, high));
                    counted.synchronised = status.synchronised;
                }
            }
            let units = match kind {
                AxisKind::Resolver => word & 0xff,
                AxisKind::Encoder => reply >> 8,
            };
            let was_synchronising = counted.synchronising;
            if was_synchronising && status.zero {
                if kind == AxisKind::Resolver {
                    (counted.count, counted.synchronised) = (0, true);
                }
                counted.synchronising = false;
                self.tell(command::RESET_POSITION);
                self.tell(command::FINISH_SYNCHRO);
            }
            let counted = self.counters[axis];
            let bit = |is: bool| u8::from(is) << axis;
            reading.currents[axis] = f64::from(units) / self.parts.units_per_ampere[axis];
            reading.limit_switches |= bit(status.upper || status.lower);
            reading.over_currents |= bit(status.over_current);
            reading.sync_switches |= bit(status.sync_switch);
            reading.encoder_zeros |= bit(status.zero);
            reading.synchronised &= !bit(!counted.synchronised);
            match reading.counts.get_mut(axis) {
                Some(slot) => *slot = counted.count,
                None => reading.jaw_count = counted.count,
            }
            *slot = status;
        }
        // The last encoder axis of the arm proper tells of the power of all.
        let teller = AXES - 1;
        if self.parts.kinds[teller] == AxisKind::Encoder && !statuses[teller].power {
            reading.power_faults = u8::MAX;
        }
        statuses
    }

    /// What every axis is told.
    fn write(&mut self, drive: &ArmDrive, stopped: bool) {
        for axis in self.first()..=JAW {
            self.choose(axis);
            let asked = drive.synchronise >> axis & 1 == 1;
            let counted = &mut self.counters[axis];
            if asked && !counted.synchronising && !counted.synchronised {
                counted.synchronising = true;
                self.tell(command::START_SYNCHRO);
            } else if !asked && counted.synchronising {
                counted.synchronising = false;
                self.tell(command::FINISH_SYNCHRO);
            }
            if drive.enabled && !self.enabled {
                self.tell(command::RESET_ALARM);
            }
            if axis == JAW {
                let limit = self.units(JAW, drive.jaw_current_limit);
                if limit != self.jaw_limit {
                    self.jaw_limit = limit;
                    self.tell(command::SET_MAX_CURRENT | u16::from(limit));
                }
            }
            let width = if axis == JAW { drive.jaw_pwm } else { drive.pwm[axis] };
            let on = drive.enabled && !stopped;
            self.tell(pulse_word(if on { width } else { 0 }));
        }
        self.parts.registers.write8(port::AXIS, port::IO_PACKET);
        let outputs = u16::from(drive.stops == Depth::Two);
        self.parts.registers.write16(port::OUTPUTS, outputs);
        self.enabled = drive.enabled;
    }

    /// Whether the card gives signs of life.
    ///
    /// # Errors
    /// Not any more.
    fn watch(&mut self, period: u64, effector: usize, notes: &mut Notes) -> Result<(), PortFault> {
        if self.parts.registers.interrupted() {
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

impl Counter {
    /// Takes the angle within a revolution; a bad reading leaves it as it was.
    fn turn(&mut self, angle: Option<u16>) {
        let Some(angle) = angle.map(i64::from) else { return };
        if let Some(before) = self.angle {
            let half = REVOLUTION / 2;
            self.count += (angle - before + half).rem_euclid(REVOLUTION) - half;
        }
        self.angle = Some(angle);
    }
}

impl<R: Registers> Port for IsaPort<R> {
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        let mut lost = Ok(());
        for (effector, (arm, (drive, reading))) in
            self.arms.iter_mut().zip(drives.iter().zip(readings)).enumerate()
        {
            let statuses = arm.read(reading);
            let hard = error_word(statuses) & HARDWARE_ERROR != 0;
            // A switch that is being left again must not stop the motor that leaves it: the servo decides, once it
            // has switched the drives on anew.
            arm.write(drive, hard && arm.enabled);
            reading.wrench_on_sensor = arm.parts.force.read(period, effector, &mut self.notes);
            lost = lost.and(arm.watch(period, effector, &mut self.notes));
        }
        if lost.is_err() {
            self.stop();
        }
        lost
    }
}

impl<R: Registers> IsaPort<R> {
    /// Power off.
    fn stop(&mut self) {
        for arm in &mut self.arms {
            arm.write(&ArmDrive::OFF, true);
        }
    }
}

impl<R: Registers> Drop for IsaPort<R> {
    fn drop(&mut self) {
        self.stop();
    }
}

impl<R: Registers> std::fmt::Debug for IsaPort<R> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("IsaPort").field("arms", &self.arms.len()).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::super::registers::width_of;
    use super::*;
    use crate::hw::force::NoSensor;
    use crate::hw::note::notes;
    use std::sync::{Arc, Mutex};

    /// A card: each exchange that is over moves its axes by a hundredth of the pulse width.
    #[derive(Default)]
    struct Card {
        chosen: u8,
        counts: [i64; 8],
        widths: [i16; 8],
        statuses: [AxisStatus; 8],
        resolvers: bool,
        currents: [u16; 8],
        outputs: u16,
        told: Vec<(u8, u16)>,
        alive: bool,
    }

    #[derive(Clone, Default)]
    struct Bank(Arc<Mutex<Card>>);

    impl Bank {
        fn card(&self) -> std::sync::MutexGuard<'_, Card> {
            self.0.lock().unwrap()
        }

        fn kind(&self) -> AxisKind {
            if self.card().resolvers { AxisKind::Resolver } else { AxisKind::Encoder }
        }
    }

    impl Registers for Bank {
        fn write8(&mut self, at: u16, value: u8) {
            assert_eq!(at, port::AXIS);
            self.card().chosen = value;
        }

        fn write16(&mut self, at: u16, value: u16) {
            let mut card = self.card();
            let chosen = card.chosen;
            match (at, chosen) {
                (port::OUTPUTS, port::IO_PACKET) => card.outputs = value,
                (port::COMMAND, 0xc1..=0xc7) => match width_of(value) {
                    Some(width) => card.widths[usize::from(chosen - 0xc0)] = width,
                    None => card.told.push((chosen - 0xc0, value)),
                },
                (port::COMMAND, port::INTERRUPTS) => {}
                _ => panic!("nothing is there: {at:#x} at {chosen:#x}"),
            }
        }

        fn read16(&mut self, at: u16) -> u16 {
            let kind = self.kind();
            let card = self.card();
            let axis = usize::from(card.chosen - 0xc0);
            match (at, kind) {
                (port::COMMAND, AxisKind::Encoder) => card.statuses[axis].encode(kind),
                (port::COMMAND, AxisKind::Resolver) => {
                    card.statuses[axis].encode(kind) | card.currents[axis]
                }
                (port::POSITION_LOW, AxisKind::Resolver) => {
                    !(card.counts[axis].rem_euclid(REVOLUTION) as u16)
                }
                (port::POSITION_LOW, AxisKind::Encoder) => !(card.counts[axis] as u16),
                (port::POSITION_HIGH, _) => !((card.counts[axis] >> 16) as u16),
                (port::OUTPUTS, _) => card.currents[axis] << 8,
                _ => panic!("nothing is there: {at:#x}"),
            }
        }

        fn interrupted(&mut self) -> bool {
            let mut card = self.card();
            for i in 0..8 {
                card.counts[i] += i64::from(card.widths[i]) / 10;
            }
            card.alive
        }
    }

    fn arm(resolvers: bool) -> (Bank, IsaPort<Bank>, rtrb::Consumer<crate::hw::note::Note>) {
        let bank = Bank::default();
        {
            let mut card = bank.card();
            card.alive = true;
            card.resolvers = resolvers;
            for status in &mut card.statuses {
                (status.synchronised, status.power) = (!resolvers, !resolvers);
            }
        }
        let parts = IsaArm {
            name: "postument".to_owned(),
            registers: bank.clone(),
            first_pointer: 0xc1,
            has_track: false,
            kinds: [if resolvers { AxisKind::Resolver } else { AxisKind::Encoder }; AXES + 1],
            units_per_ampere: [13.7; AXES + 1],
            max_currents: [Some(10.0); AXES],
            force: Box::new(NoSensor),
        };
        let (to, from) = notes();
        (bank, IsaPort::new(vec![parts], to), from)
    }

    fn on(pwm: i16) -> ArmDrive {
        ArmDrive {
            enabled: true,
            pwm: [pwm; AXES],
            jaw_pwm: -pwm,
            stops: Depth::Two,
            ..ArmDrive::OFF
        }
    }

    fn go(port: &mut IsaPort<Bank>, periods: u64, drive: ArmDrive) -> ArmReading {
        let mut readings = [ArmReading::default()];
        for period in 0..periods {
            port.exchange(period, &[drive], &mut readings).unwrap();
        }
        readings[0]
    }

    #[test]
    fn pulse_widths_move_counters_of_encoders_both_ways() {
        let (bank, mut port, _) = arm(false);
        bank.card().currents = [27; 8];

        let reading = go(&mut port, 101, on(200));

        assert_eq!(reading.counts[1..], [2000; 6], "axis 1 is the first pointer's");
        assert_eq!(reading.jaw_count, -2000);
        assert!((reading.currents[3] - 27.0 / 13.7).abs() < 1e-12);
        assert_eq!(reading.synchronised, u8::MAX);
        assert_eq!(bank.card().outputs, 1, "the palm's stops");
        assert!(bank.card().told.contains(&(1, command::SET_MAX_CURRENT | 0x89)));
    }

    #[test]
    fn resolvers_are_counted_over_their_revolutions() {
        let (_bank, mut port, _) = arm(true);

        assert_eq!(go(&mut port, 101, on(250)).counts[2], 2500);
        assert_eq!(go(&mut port, 301, on(-250)).counts[2], 2500 + 25 - 7500);
    }

    #[test]
    fn a_hard_error_stops_every_motor_in_its_period() {
        let (bank, mut port, _) = arm(false);
        go(&mut port, 10, on(100));
        bank.card().statuses[4].over_current = true;

        let reading = go(&mut port, 1, on(100));

        assert_eq!(reading.over_currents, 1 << 4);
        assert_eq!(bank.card().widths, [0; 8]);
    }

    #[test]
    fn an_axis_is_synchronised_at_its_zero() {
        let (bank, mut port, _) = arm(true);
        go(&mut port, 10, on(100));
        let homing = ArmDrive { synchronise: 1 << 2, ..on(100) };
        assert_eq!(go(&mut port, 5, homing).synchronised & 1 << 2, 0);
        assert!(bank.card().told.contains(&(2, command::START_SYNCHRO)));
        bank.card().statuses[2].zero = true;

        let reading = go(&mut port, 1, homing);

        assert_eq!((reading.counts[2], reading.synchronised & 1 << 2), (0, 1 << 2));
        assert!(bank.card().told.contains(&(2, command::RESET_POSITION)));
    }

    #[test]
    fn a_card_without_interrupts_is_told_after_20_ms_and_given_up_after_30() {
        let (bank, mut port, mut told) = arm(false);
        go(&mut port, 10, on(100));
        bank.card().alive = false;
        let mut readings = [ArmReading::default()];
        let mut ended = None;

        for period in 10..100 {
            if let Err(fault) = port.exchange(period, &[on(100)], &mut readings) {
                ended = Some((period, fault.reason));
                break;
            }
        }

        let (period, reason) = ended.unwrap();
        assert_eq!(period, 10 + 14);
        assert!(reason.contains("postument") && reason.contains("30 ms"), "{reason}");
        assert_eq!(told.pop().unwrap().what, What::NoInterrupt);
        assert_eq!(bank.card().widths, [0; 8]);
    }

    #[test]
    fn lost_power_is_told_of_every_axis() {
        let (bank, mut port, _) = arm(false);
        bank.card().statuses[6].power = false;

        assert_eq!(go(&mut port, 1, on(0)).power_faults, u8::MAX);
    }
}
