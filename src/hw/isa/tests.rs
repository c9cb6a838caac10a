//! The port over emulated cards: against simple motors, and against the simulated plant.

use super::bank::Carded;
use super::registers::{AxisKind, command};
use crate::hw::devices::IsaDevice;
use crate::hw::driver::{Core, NoRecords, ServoLink, Switches, link};
use crate::hw::note::{Note, What, notes};
use crate::hw::plant::testing::cell;
use crate::hw::plant::{Plant, PlantConfig};
use crate::hw::port::{Port, PortFault};
use crate::motion::{Depth, Motion, MoveCommand, Synchronisation};
use crate::servo::io::{ArmDrive, ArmReading, JAW};
use crate::servo::regulator::{IRP6, ServoGains};
use crate::servo::{ServoCommand, ServoConfig};
use std::sync::Arc;

/// Motors that move by a tenth of their pulse width in a period, and pass zeros on their way.
struct Motors {
    counts: [i64; 8],
    revolution: i64,
    /// What they show besides.
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

struct Rig {
    cards: Carded<Motors>,
    told: rtrb::Consumer<Note>,
    period: u64,
}

impl Rig {
    /// The postument's arm, its motors somewhere.
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

    fn exchange(&mut self, drive: ArmDrive) -> Result<ArmReading, PortFault> {
        let mut readings = [ArmReading::default()];
        self.cards.exchange(self.period, &[drive], &mut readings)?;
        self.period += 1;
        assert_eq!(self.cards.bank(0).card().lost, 0, "a word came too soon after another");
        Ok(readings[0])
    }

    fn go(&mut self, periods: u64, drive: ArmDrive) -> ArmReading {
        (0..periods).map(|_| self.exchange(drive).unwrap()).last().unwrap()
    }

    fn shows(&mut self) -> &mut ArmReading {
        &mut self.cards.world_mut().shows
    }

    fn widths(&self) -> [i16; 7] {
        let card = self.cards.bank(0).card();
        std::array::from_fn(|i| card.axes[i + 1].width)
    }

    fn told(&self, axis: usize) -> Vec<u16> {
        let card = self.cards.bank(0).card();
        card.told.iter().filter(|(at, _)| *at == axis).map(|(_, word)| *word).collect()
    }
}

const ENCODER: AxisKind = AxisKind::Encoder { sync_high: false };

fn on(width: i16) -> ArmDrive {
    ArmDrive { enabled: true, pwm: [width; 7], jaw_pwm: -width, stops: Depth::Two, synchronise: 0 }
}

#[test]
fn a_card_is_set_up_as_the_original_did_and_left_with_its_buttons_alive() {
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

#[test]
fn pulse_widths_move_counters_both_ways_once_the_alarms_are_reset() {
    let mut rig = Rig::new(ENCODER, 6);
    rig.shows().currents = [2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 1.0, 0.08];
    rig.cards.bank(0).card().inputs = 0x8421;
    rig.cards.bank(0).card().analog = [1, 2, 3, 4, 5, 6, 7, 8];

    let reading = rig.go(101, on(200));

    // One period for the word that resets the alarms, one until a counter is read.
    assert_eq!(reading.counts[1..], [99 * 20; 6], "axis 1 is the first pointer's");
    assert_eq!(reading.jaw_count, -99 * 20);
    assert!((reading.currents[3] - 27.0 / 13.7).abs() < 1e-12);
    assert!((reading.currents[JAW] + 28.0 / 347.0).abs() < 1e-12, "it opens");
    assert_eq!(reading.inputs, 0x8421);
    assert_eq!(reading.analog_inputs, [1, 2, 3, 4, 5, 6, 7, 8]);
    let card = rig.cards.bank(0).card();
    assert_eq!(card.outputs, 1, "the palm's stops");
    assert_eq!(card.axes[JAW].max_current, 0x20);
}

#[test]
fn a_resolver_that_could_not_be_read_has_lost_no_revolution() {
    let mut rig = Rig::new(AxisKind::Resolver, 6);
    // 120 rad/s: 26 counts of 682 a period.
    let before = rig.go(20, on(255)).counts[2];
    rig.cards.bank(0).card().axes[2].unreadable = true;
    assert_eq!(rig.go(50, on(255)).counts[2], before, "the last one holds");
    rig.cards.bank(0).card().axes[2].unreadable = false;

    let after = rig.go(1, on(255)).counts[2];

    assert_eq!(after, before + 51 * 25);
    let back = rig.go(201, on(-255)).counts[2];
    assert_eq!(back, after + 25 - 200 * 25, "below zero too");
}

#[test]
fn a_hard_error_stops_every_motor_in_its_period_and_a_reset_alarm_lets_them_go_on() {
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
fn lost_power_is_told_of_every_axis_and_stops_them() {
    for teller in [6, 2] {
        let mut rig = Rig::new(ENCODER, teller);
        assert_eq!(rig.go(10, on(100)).power_faults, 0);
        rig.shows().power_faults = 1 << teller;
        rig.go(1, on(100));

        assert_eq!(rig.go(1, on(100)).power_faults, u8::MAX);
        assert_eq!(rig.widths(), [0; 7]);
    }
}

#[test]
fn an_axis_is_synchronised_in_the_period_of_its_zero_and_its_count_never_jumps_again() {
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

        // What the card forgets, the arm has lost.
        rig.cards.bank(0).card().axes[2].status.synchronised = false;
        let known = rig.go(2, on(100)).synchronised & 1 << 2 != 0;
        assert_eq!(known, kind == AxisKind::Resolver);
    }
}

#[test]
fn a_homing_that_is_broken_off_leaves_no_axis_waiting_for_its_zero() {
    let mut rig = Rig::new(ENCODER, 6);
    rig.go(10, on(100));
    rig.go(5, ArmDrive { synchronise: 1 << 2, ..on(100) });

    let reading = rig.go(500, on(100));

    assert_eq!(reading.synchronised & 1 << 2, 0);
    assert_eq!(rig.told(2).last(), Some(&command::FINISH_SYNCHRO));
}

#[test]
fn a_card_without_interrupts_is_told_after_20_ms_and_given_up_after_30() {
    let mut rig = Rig::new(ENCODER, 6);
    rig.go(200, on(100));
    rig.cards.bank(0).card().alive = false;
    // The last one came before.
    rig.go(1, on(100));

    rig.go(9, on(100));
    assert!(rig.told.pop().is_err(), "18 ms are passed over");
    rig.go(5, on(100));
    assert_eq!(rig.told.pop().unwrap().what, What::NoInterrupt);
    let fault = rig.exchange(on(100)).unwrap_err();

    assert!(fault.reason.contains("postument") && fault.reason.contains("30 ms"), "{fault}");
    assert_eq!(rig.widths(), [0; 7]);
}

#[test]
fn late_card_loses_no_word_and_marks_its_counters() {
    let mut rig = Rig::new(ENCODER, 6);
    let before = rig.go(20, on(100));
    for _ in 0..20 {
        rig.cards.bank(0).card().stalls = 2;
        // The last period's interrupt, then none.
        let reading = rig.go(3, on(100));
        assert_eq!((reading.extrapolated, reading.no_answer), (u8::MAX, u8::MAX));
        let reading = rig.go(5, on(-100));
        assert_eq!((reading.extrapolated, reading.no_answer), (0, 0));
        assert_eq!(rig.widths()[0], -100);
    }
    assert!(rig.go(1, on(100)).counts[3] < before.counts[3]);
    assert!(rig.told.pop().is_err(), "nobody is told of so little");
}

#[test]
fn a_motor_that_stands_on_its_limit_switch_is_driven_off_it() {
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
fn a_current_that_stays_above_its_limit_is_an_over_current() {
    let mut rig = Rig::new(ENCODER, 6);
    // 0x20 units of 347 an ampere.
    rig.shows().currents[JAW] = 0.091;
    assert_eq!(rig.go(200, on(100)).over_currents, 0);
    rig.shows().currents[JAW] = 0.1;
    assert_eq!(rig.go(200, on(100)).over_currents, 1 << JAW);
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
    fn new(synchronised: [bool; 2]) -> Self {
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

    fn tick(&mut self, periods: u64) -> Result<(), PortFault> {
        for _ in 0..periods {
            self.period += 1;
            self.core.period(self.period, &mut self.cards)?;
        }
        Ok(())
    }
}

#[test]
fn an_arm_behind_its_card_synchronises_moves_and_stops_when_the_card_dies() {
    let mut rig = Whole::new([true, false]);
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
    // The pose of synchronisation: a wrong zero would be a revolution off.
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
    // The truth: base_from_flange of the plant against what the servo believes.
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
    assert_eq!(rig.told.pop().unwrap().what, What::NoInterrupt);
    for arm in 0..2 {
        assert!(rig.cards.bank(arm).card().axes.iter().all(|axis| axis.width == 0));
    }
}
