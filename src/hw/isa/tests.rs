//! Tests of the ISA port over emulated cards, with simple motors and with the simulated plant.

use super::bank::Carded;
use super::registers::{AxisKind, command};
use crate::hw::devices::IsaDevice;
use crate::hw::driver::{Core, NoRecords, ServoLink, Switches, link};
use crate::hw::note::{Note, NoteKind, notes};
use crate::hw::plant::testing::cell;
use crate::hw::plant::{Plant, PlantConfig};
use crate::hw::port::{Port, PortFault};
use crate::motion::{Depth, Motion, MoveCommand, Synchronisation};
use crate::servo::io::{ArmDrive, ArmReading, JAW};
use crate::servo::regulator::{IRP6, ServoGains};
use crate::servo::{ServoCommand, ServoConfig};
use std::sync::Arc;

/// Motors that move by a tenth of their pulse width in a period, with a zero in each revolution.
struct Motors {
    counts: [i64; 8],
    revolution: i64,
    /// Reading, apart from counts and zeros.
    shows: ArmReading,
}

impl Port for Motors {
    fn exchange(
        &mut self,
        _: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        let drive = &drives[0];
        readings[0] = self.shows;
        for (axis, count) in self.counts.iter_mut().enumerate() {
            let width = if axis == JAW { drive.jaw_pwm } else { drive.pwm[axis] };
            let turn = count.div_euclid(self.revolution);
            *count += if drive.enabled { i64::from(width) / 10 } else { 0 };
            let passed = count.div_euclid(self.revolution) != turn;
            readings[0].encoder_zeros |= u8::from(passed) << axis;
        }
        readings[0].counts.copy_from_slice(&self.counts[..JAW]);
        readings[0].jaw_count = self.counts[JAW];
        Ok(())
    }
}

/// One arm's motors behind an emulated card, with the notes for the log and the present period.
struct Rig {
    cards: Carded<Motors>,
    told: rtrb::Consumer<Note>,
    period: u64,
}

impl Rig {
    /// Makes the postument's arm behind an emulated card, not synchronised. All axes are of this
    /// kind; axis `power_axis` reports the power of all.
    fn new(kind: AxisKind, power_axis: usize) -> Self {
        let device = IsaDevice { power_axis, ..IsaDevice::default() };
        let mut arm = device.arm(&cell().arms[1], &[]).unwrap();
        arm.kinds = [kind; 8];
        let resolver = kind == AxisKind::Resolver;
        let motors = Motors {
            counts: [300; 8],
            revolution: if resolver { 682 } else { 4000 },
            shows: ArmReading { synchronised: 0, ..ArmReading::default() },
        };
        let (to, told) = notes();
        Self { cards: Carded::new(motors, vec![arm], to).unwrap(), told, period: 0 }
    }

    /// Makes one exchange; returns its reading. Fails the test if a word to the card is lost.
    fn exchange(&mut self, drive: ArmDrive) -> Result<ArmReading, PortFault> {
        let mut readings = [ArmReading::default()];
        self.cards.exchange(self.period, &[drive], &mut readings)?;
        self.period += 1;
        assert_eq!(self.cards.bank(0).card().lost, 0, "a word came too soon after another");
        Ok(readings[0])
    }

    /// Makes the same exchange in a number of periods; returns the last reading.
    fn go(&mut self, periods: u64, drive: ArmDrive) -> ArmReading {
        (0..periods).map(|_| self.exchange(drive).unwrap()).last().unwrap()
    }

    /// Returns the reading of the motors apart from counts and zeros, to change it.
    fn shows(&mut self) -> &mut ArmReading {
        &mut self.cards.world_mut().shows
    }

    /// Returns the pulse widths of axes 1 to 6 and of the jaw that the card has taken.
    fn widths(&self) -> [i16; 7] {
        let card = self.cards.bank(0).card();
        std::array::from_fn(|i| card.axes[i + 1].width)
    }

    /// Returns the commands that an axis has taken, without pulse widths.
    fn told(&self, axis: usize) -> Vec<u16> {
        let card = self.cards.bank(0).card();
        card.commands.iter().filter(|(at, _)| *at == axis).map(|(_, word)| *word).collect()
    }
}

const ENCODER: AxisKind = AxisKind::Encoder { sync_high: false };

/// Returns drive commands with power on: this pulse width for each axis, its opposite for the jaw.
fn on(width: i16) -> ArmDrive {
    ArmDrive { enabled: true, pwm: [width; 7], jaw_pwm: -width, stops: Depth::Two, synchronise: 0 }
}

/// The card receives the commands of the original's set-up. At the end of the run the cabinet's
/// buttons are enabled.
#[test]
fn card_axes_get_setup_commands_in_fixed_order() {
    let mut rig = Rig::new(ENCODER, 6);
    let bank = rig.cards.bank(0).clone();
    assert_eq!(bank.card().divisor, 8);
    let wanted = |limit: u16| {
        vec![
            command::RESET_MANUAL,
            command::PROHIBIT_MANUAL,
            command::SET_MAX_CURRENT | limit,
            command::MICROCONTROLLER_MODE,
            command::RESET_MANUAL,
            command::RESET_ALARM,
            command::RESET_POSITION,
        ]
    };
    assert_eq!(rig.told(3), wanted(0xff));
    assert_eq!(rig.told(6), wanted(0x10));
    assert_eq!(rig.told(JAW), wanted(0x20));
    assert!(bank.card().axes[1..].iter().all(|axis| !axis.manual));

    rig.go(20, on(100));
    drop(rig);

    let card = bank.card();
    assert!(card.axes[1..].iter().all(|axis| axis.width == 0 && axis.manual));
}

/// Positive and negative pulse widths move the counters in both directions.
#[test]
fn pulse_widths_move_counters_after_alarm_reset() {
    let mut rig = Rig::new(ENCODER, 6);
    rig.shows().currents = [2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 1.0, 0.08];
    rig.cards.bank(0).card().inputs = 0x8421;
    rig.cards.bank(0).card().analog = [1, 2, 3, 4, 5, 6, 7, 8];

    let reading = rig.go(101, on(200));

    // One period for the word that resets the alarms, one until a counter is read.
    assert_eq!(reading.counts[1..], [99 * 20; 6], "axis 1 is the first pointer's");
    assert_eq!(reading.jaw_count, -99 * 20);
    // The card measures in whole units: 13.7 to the ampere for an axis, 347 for the jaw.
    assert!((reading.currents[3] - 27.0 / 13.7).abs() < 1e-12);
    assert!((reading.currents[JAW] + 28.0 / 347.0).abs() < 1e-12, "it opens");
    assert_eq!(reading.inputs, 0x8421);
    assert_eq!(reading.analog_inputs, [1, 2, 3, 4, 5, 6, 7, 8]);
    let card = rig.cards.bank(0).card();
    assert_eq!(card.outputs, 1, "the palm's stops");
    assert_eq!(card.axes[JAW].max_current, 0x20);
}

#[test]
fn unreadable_resolver_loses_no_revolution() {
    let mut rig = Rig::new(AxisKind::Resolver, 6);
    // 25 counts of 682 in a period: 115 rad/s.
    let before = rig.go(20, on(255)).counts[2];
    rig.cards.bank(0).card().axes[2].unreadable = true;
    assert_eq!(rig.go(50, on(255)).counts[2], before, "the last reading stays");
    rig.cards.bank(0).card().axes[2].unreadable = false;

    let after = rig.go(1, on(255)).counts[2];

    assert_eq!(after, before + 51 * 25);
    let back = rig.go(201, on(-255)).counts[2];
    assert_eq!(back, after + 25 - 200 * 25, "below zero too");
}

/// The servo stops the arm and switches it on again, which resets the alarm.
#[test]
fn hard_error_stops_all_motors_until_alarm_reset() {
    let mut rig = Rig::new(ENCODER, 6);
    rig.go(10, on(100));
    rig.shows().over_currents = 1 << 4;
    rig.go(1, on(100));
    assert_eq!(rig.widths()[..6], [100; 6]);
    rig.shows().over_currents = 0;

    let reading = rig.go(1, on(100));

    assert_eq!(reading.over_currents, 1 << 4, "the alarm lasts");
    assert_eq!(rig.widths(), [0; 7]);
    assert_eq!(rig.go(5, on(100)).over_currents, 1 << 4);
    assert_eq!(rig.go(5, ArmDrive::OFF).over_currents, 0, "reset once the servo has stopped");
    rig.go(3, on(100));
    assert_eq!(rig.widths()[..6], [100; 6]);
}

#[test]
fn power_fault_at_one_axis_stops_all_axes() {
    for teller in [6, 2] {
        let mut rig = Rig::new(ENCODER, teller);
        assert_eq!(rig.go(10, on(100)).power_faults, 0);
        rig.shows().power_faults = 1 << teller;
        rig.go(1, on(100));

        assert_eq!(rig.go(1, on(100)).power_faults, u8::MAX);
        assert_eq!(rig.widths(), [0; 7]);
    }
}

/// Covers both kinds of axes, each with a card that sets its counter to zero by itself and with one
/// that does not.
#[test]
fn counter_is_zeroed_at_synchronisation_without_later_jump() {
    for (kind, itself) in
        [(ENCODER, false), (ENCODER, true), (AxisKind::Resolver, false), (AxisKind::Resolver, true)]
    {
        let mut rig = Rig::new(kind, 6);
        rig.cards.bank(0).card().zeroes_itself = itself;
        let homing = ArmDrive { synchronise: 1 << 2, ..on(100) };
        rig.go(10, on(100));
        let mut reading = rig.go(1, homing);
        for _ in 0..400 {
            if reading.synchronised & 1 << 2 != 0 {
                break;
            }
            reading = rig.go(1, homing);
        }
        let mut last = reading.counts[2];
        assert!((0..10).contains(&last), "{kind:?} {itself}: {last}");

        for _ in 0..100 {
            let reading = rig.go(1, on(100));
            assert_eq!(reading.synchronised & 1 << 2, 1 << 2, "{kind:?} {itself}");
            assert_eq!(reading.counts[2], last + 10, "{kind:?} {itself}");
            last = reading.counts[2];
        }
        let told = rig.told(2);
        let from = told.iter().position(|word| *word == command::START_SYNCHRO).unwrap();
        let mut wanted = vec![command::START_SYNCHRO, command::FINISH_SYNCHRO];
        wanted.extend((!itself).then_some(command::RESET_POSITION));
        wanted.extend((kind == ENCODER).then_some(command::MICROCONTROLLER_MODE));
        if kind == ENCODER || !itself {
            assert_eq!(told[from..], wanted, "{kind:?} {itself}");
        }
        assert_eq!(rig.cards.bank(0).card().axes[2].status.synchronised, kind == ENCODER);

        // An encoder axis whose card forgets its zero is not synchronised any more.
        rig.cards.bank(0).card().axes[2].status.synchronised = false;
        let known = rig.go(2, on(100)).synchronised & 1 << 2 != 0;
        assert_eq!(known, kind == AxisKind::Resolver);
    }
}

#[test]
fn aborted_homing_ends_search_for_zero() {
    let mut rig = Rig::new(ENCODER, 6);
    rig.go(10, on(100));
    rig.go(5, ArmDrive { synchronise: 1 << 2, ..on(100) });

    let reading = rig.go(500, on(100));

    assert_eq!(reading.synchronised & 1 << 2, 0);
    assert_eq!(rig.told(2).last(), Some(&command::FINISH_SYNCHRO));
}

/// A card without interrupts is reported after 20 ms, and is a fault after 30 ms.
#[test]
fn card_without_interrupts_is_reported_then_a_fault() {
    let mut rig = Rig::new(ENCODER, 6);
    rig.go(200, on(100));
    rig.cards.bank(0).card().alive = false;
    // The interrupt of this period was raised before.
    rig.go(1, on(100));

    rig.go(9, on(100));
    assert!(rig.told.pop().is_err(), "18 ms are not reported");
    rig.go(5, on(100));
    assert_eq!(rig.told.pop().unwrap().what, NoteKind::NoInterrupt);
    let fault = rig.exchange(on(100)).unwrap_err();

    assert!(fault.reason.contains("postument") && fault.reason.contains("30 ms"), "{fault}");
    assert_eq!(rig.widths(), [0; 7]);
}

/// The counters of a late card are marked as extrapolated.
#[test]
fn late_card_loses_no_command() {
    let mut rig = Rig::new(ENCODER, 6);
    let before = rig.go(20, on(100));
    for _ in 0..20 {
        rig.cards.bank(0).card().stalls = 2;
        // The interrupt of the last period, then none for two periods.
        let reading = rig.go(3, on(100));
        assert_eq!((reading.extrapolated, reading.no_answer), (u8::MAX, u8::MAX));
        let reading = rig.go(5, on(-100));
        assert_eq!((reading.extrapolated, reading.no_answer), (0, 0));
        assert_eq!(rig.widths()[0], -100);
    }
    assert!(rig.go(1, on(100)).counts[3] < before.counts[3]);
    assert!(rig.told.pop().is_err(), "a gap of two periods is not reported");
}

#[test]
fn motor_may_leave_limit_switch_hit_at_start() {
    let mut rig = Rig::new(ENCODER, 6);
    rig.shows().lower_limits = 1 << 3;
    rig.go(20, ArmDrive::OFF);
    rig.go(20, on(100));
    assert_eq!(rig.widths()[2], 100);

    rig.shows().lower_limits = 0;
    rig.go(20, on(100));
    rig.shows().lower_limits = 1 << 3;
    rig.go(2, on(100));
    assert_eq!(rig.widths(), [0; 7], "once left, it stops all motors");
}

#[test]
fn lasting_current_above_limit_is_over_current() {
    let mut rig = Rig::new(ENCODER, 6);
    // The limit is 0x20 units, with 347 units/A: 0.0922 A.
    rig.shows().currents[JAW] = 0.091;
    assert_eq!(rig.go(200, on(100)).over_currents, 0);
    // A peak of 0.1 s, 50 periods, is allowed.
    rig.shows().currents[JAW] = 0.1;
    rig.go(50, on(100));
    rig.shows().currents[JAW] = 0.091;
    assert_eq!(rig.go(20, on(100)).over_currents, 0);
    rig.shows().currents[JAW] = 0.1;
    assert_eq!(rig.go(55, on(100)).over_currents, 1 << JAW);
}

/// Both arms of the built-in cell on the simulated plant, behind their cards.
struct Whole {
    core: Core,
    links: Vec<ServoLink>,
    cards: Carded<Plant>,
    told: rtrb::Consumer<Note>,
    period: u64,
}

impl Whole {
    /// Makes the cell at rest; `synchronised` tells for each arm whether it is synchronised.
    fn new(synchronised: crate::cell::PerArm<bool>) -> Self {
        let cell = cell();
        let config = PlantConfig { synchronised, ..PlantConfig::new(cell.clone()) };
        let plant = Plant::new(config, 1).unwrap();
        let arms = &cell.arms;
        let cards = arms.iter().map(|arm| {
            let device = IsaDevice::default();
            let most = device.arm(arm, &[]).unwrap().units_per_ampere.map(|units| 255.0 / units);
            device.arm(arm, &most).unwrap()
        });
        let (to, told) = notes();
        let mut cards = Carded::new(plant, cards.collect(), to).unwrap();
        let gains = ServoGains::parse(IRP6).unwrap();
        let configs = arms.iter().map(|arm| ServoConfig::new(arm, gains.clone())).collect();
        let (links, ends) = (0..2).map(|_| link()).unzip();
        let switches = Arc::new(Switches::default());
        let core = Core::new(configs, ends, switches, Box::new(NoRecords), &mut cards).unwrap();
        Self { core, links, cards, told, period: 0 }
    }

    /// Runs a number of servo periods, or stops at the first fault of a card.
    fn tick(&mut self, periods: u64) -> Result<(), PortFault> {
        for _ in 0..periods {
            self.period += 1;
            self.core.period(self.period, &mut self.cards)?;
        }
        Ok(())
    }
}

/// The arm synchronises and moves behind its card; then the card fails, and both arms stop.
#[test]
fn arm_synchronises_and_moves_until_its_card_fails() {
    let mut rig = Whole::new([true, false, false, false]);
    rig.tick(10).unwrap();
    assert_eq!(rig.links[0].state().synchronisation, Synchronisation::Yes);
    assert_eq!(rig.links[1].state().synchronisation, Synchronisation::No);

    rig.links[1].send(ServoCommand::Synchronise).unwrap();
    for _ in 0..1200 {
        rig.tick(100).unwrap();
        let state = *rig.links[1].state();
        assert_eq!(state.fault, None, "{:?}", state.synchronisation);
        if state.synchronisation == Synchronisation::Yes {
            break;
        }
    }
    let home = *rig.links[1].state();
    assert_eq!(home.synchronisation, Synchronisation::Yes);
    // The motors are near their synchronisation positions: a wrong zero would be a revolution off.
    assert!(home.motors.0.iter().all(|m| (-0.1..1.0).contains(m)), "{:?}", home.motors);

    let mut goal = home.joints;
    goal.0[1] += 0.1;
    let command = MoveCommand { motion: Motion::Joints(goal), periods: 1000, jaw: None };
    rig.links[1].send(ServoCommand::Move { command, start: 0 }).unwrap();
    rig.tick(1300).unwrap();
    let moved = *rig.links[1].state();
    assert_eq!((moved.fault, moved.refused), (None, None));
    assert!((moved.joints.0[1] - goal.0[1]).abs() < 2e-3, "{:?}", moved.joints);
    assert_eq!(rig.cards.bank(1).card().lost, 0);
    // The plant's true tool against the servo's belief.
    let scene = rig.cards.world().scene();
    let arm = &rig.cards.world().cell().arms[1];
    let true_tool =
        arm.world_from_base.inverse() * scene.arms[1].world_from_flange * arm.flange_from_tool;
    let off = (true_tool.translation.vector - moved.base_from_tool.translation.vector).norm();
    assert!(off < 0.01, "{off} m: springs, no revolution");

    rig.cards.bank(1).card().alive = false;
    let begun = rig.period;
    let fault = rig.tick(100).unwrap_err();
    assert_eq!((fault.effector, rig.period - begun), (1, 16), "{fault}");
    assert_eq!(rig.told.pop().unwrap().what, NoteKind::NoInterrupt);
    for arm in 0..2 {
        assert!(rig.cards.bank(arm).card().axes.iter().all(|axis| axis.width == 0));
    }
}
