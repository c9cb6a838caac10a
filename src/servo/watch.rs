//! Watchdogs of the axes: what makes a servo stop its arm by itself.
//!
//! | fault | found when |
//! |---|---|
//! | over-current | a power stage says so, or more than half of what trips it flows for 0.3 s longer than not |
//! | power stage | it says so |
//! | limit switch | an axis runs onto it, or goes on into one on which it stood at the start |
//! | encoder jump | a counter shows a step that no motor makes in the time that may lie between two readings |
//! | frozen encoder | a counter stands although the set value goes on |
//! | following error | motor and set value are too far apart, at this speed and after this gap |
//!
//! A cause is reported before its effect: of several faults the one that stands higher in this
//! table. Of the last three, which are those of a counter, the fault of the first axis is reported.
//! Readings that are late or missing are judged by the rules of [`super::lateness`].

use super::io::ArmReading;
use super::lateness::{Allowance, Interval};
use super::period::Length;
use super::regulator::ServoGains;
use crate::motion::{AXES, ArmFault, MotorPositions};

/// Watchdogs of all axes of an arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Watch {
    rules: Rules,
    axes: [AxisWatch; AXES],
    /// Periods since the beginning or the last reset, up to [`Watch::SETTLES`].
    age: u32,
    /// Limit switches, upper and lower, on which axes stood then: they may leave them.
    stood_on: (u8, u8),
}

/// What is the same for all axes.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rules {
    /// Allowed difference of set and measured motor position at rest (rad), and more of it per
    /// speed (s).
    following_error: f64,
    following_lag: f64,
    /// Length of a period (s).
    seconds: f64,
    /// Share of the remembered speed that is left after a period.
    fade: f64,
    /// What no motor gains between two readings over the speed that it was told (rad).
    jump: f64,
}

/// What an axis was told, as far as it is judged by it (rad of the motor).
#[derive(Debug, Clone, Copy)]
pub struct Wanted<'a> {
    /// Set values of the last period.
    pub set: &'a MotorPositions,
    /// How far they went in it.
    pub steps: &'a [f64; AXES],
    /// How far the motors are ahead of the steps that their regulators were given.
    pub backlog: &'a [f64; AXES],
}

impl Watch {
    /// Share of the remembered speed that is left after 2 ms: about 40 ms in all.
    const FADE: f64 = 0.95;
    /// What no motor gains between two readings over the speed that it was told (rad).
    const JUMP: f64 = 1.0;
    /// For how much longer than not an axis may be strained (s): its regulator lets no current rise
    /// to what trips, so that an axis that presses on something would do so for ever.
    const BEARS: f64 = 0.3;
    /// A step of a set value that is rounding (rad of the motor).
    const STANDS: f64 = 1e-5;
    /// Periods after a reset in which switches come to be known: lines tell of them after they have read them twice.
    const SETTLES: u32 = 5;

    /// Makes the watchdogs of an arm at rest whose counters show `counts`; `increments` are those
    /// of its encoders in a revolution of the motor.
    #[must_use]
    pub fn new(
        gains: &ServoGains,
        increments: &[f64; AXES],
        counts: [i64; AXES],
        period: Length,
    ) -> Self {
        let rules = Rules {
            following_error: gains.following_error,
            following_lag: gains.following_lag,
            seconds: period.seconds(),
            fade: if period == Length::default() {
                Self::FADE
            } else {
                libm::pow(Self::FADE, period.ratio())
            },
            jump: Self::JUMP * period.ratio().max(1.0),
        };
        let axis =
            |i: usize| AxisWatch::new(gains.axes[i].trip_current, increments[i], counts[i], period);
        Self { rules, axes: std::array::from_fn(axis), age: 0, stood_on: (0, 0) }
    }

    /// Forgets the past.
    pub fn reset(&mut self, counts: [i64; AXES]) {
        for (axis, count) in self.axes.iter_mut().zip(counts) {
            axis.reset(count);
        }
        (self.age, self.stood_on) = (0, (0, 0));
    }

    /// Notes that periods were missed before the next reading.
    pub fn skipped(&mut self, missed: u64) {
        for axis in &mut self.axes {
            axis.interval.pass(missed as f64);
        }
    }

    /// Notes that a counter was set to zero: its jump is not a motion of the axis.
    pub fn rebase(&mut self, axis: usize, count: i64) {
        self.axes[axis].rebase(count);
    }

    /// Returns the first fault of this reading. Counters and strain of axes before `first_axis`
    /// are not judged.
    pub fn check(
        &mut self,
        reading: &ArmReading,
        measured: &MotorPositions,
        wanted: &Wanted<'_>,
        first_axis: usize,
    ) -> Option<ArmFault> {
        let mut fault = None;
        for axis in (first_axis..AXES).rev() {
            let watch = &mut self.axes[axis];
            watch.follow(wanted.steps[axis], &self.rules);
            if reading.no_answer >> axis & 1 == 0 {
                watch.strain(reading.currents[axis]);
            }
            // A counter that was not read is not judged.
            if reading.extrapolated >> axis & 1 == 1 {
                continue;
            }
            let seen = Seen {
                count: reading.counts[axis],
                step: wanted.steps[axis],
                error: wanted.set.0[axis] - measured.0[axis],
                backlog: wanted.backlog[axis],
            };
            fault = watch.judge(axis, &seen, &self.rules).or(fault);
        }
        let first = |bits: u8| (bits != 0).then(|| bits.trailing_zeros() as usize);
        if let Some(axis) = first(self.hit(reading, wanted.steps)) {
            let motor = measured.0.get(axis).copied().unwrap_or_default();
            fault = Some(ArmFault::LimitSwitch { axis, motor });
        }
        if let Some(axis) = first(reading.power_faults) {
            fault = Some(ArmFault::PowerStage { axis });
        }
        let strained =
            |axis: &AxisWatch| f64::from(axis.strained) * self.rules.seconds > Self::BEARS;
        if let Some(axis) = first(reading.over_currents).or(self.axes.iter().position(strained)) {
            fault = Some(ArmFault::OverCurrent { axis, amperes: reading.currents[axis] });
        }
        fault
    }

    /// Returns the bits of the axes that have run onto a limit switch, or go on into one on which
    /// they stood.
    fn hit(&mut self, reading: &ArmReading, steps: &[f64; AXES]) -> u8 {
        let (upper, lower) = (reading.upper_limits, reading.lower_limits);
        if self.age < Self::SETTLES {
            self.age += 1;
            self.stood_on = (self.stood_on.0 | upper, self.stood_on.1 | lower);
        }
        let going =
            |is: fn(f64) -> bool| (0..AXES).fold(0, |bits, i| bits | u8::from(is(steps[i])) << i);
        let (up, down) = (going(|step| step > Self::STANDS), going(|step| step < -Self::STANDS));
        // Once left, a switch is like any other.
        self.stood_on = (self.stood_on.0 & upper & !up, self.stood_on.1 & lower & !down);
        upper & !self.stood_on.0 | lower & !self.stood_on.1
    }
}

/// The watchdog of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct AxisWatch {
    /// Recent speed of the set value (rad/s): the highest of a while, so that a sudden stop is
    /// allowed for.
    speed: f64,
    /// Periods for which that speed does not fall off yet.
    holds: u32,
    /// Periods in a row in which the axis should have moved and its counter did not.
    frozen: u32,
    /// How far the set value has gone since the counter last changed (rad).
    wanted: f64,
    /// Increments of the encoder in a revolution of the motor.
    increments: f64,
    last_count: i64,
    /// Current that its power stage stops at (A), and for how many periods more than not the axis
    /// was strained.
    trip: f64,
    strained: u32,
    /// Time since the counter was last read.
    interval: Interval,
    /// What the following error may be after gaps.
    allowance: Allowance,
}

/// What is judged of one axis in one period; lengths in (rad of the motor).
struct Seen {
    count: i64,
    /// How far the set value went.
    step: f64,
    /// Set value less measured value.
    error: f64,
    /// How far the motor is ahead of the steps that its regulator was given.
    backlog: f64,
}

impl AxisWatch {
    /// A set value faster than this must show in the encoder (rad/s).
    const MUST_MOVE: f64 = 15.0;
    /// Periods after which a counter that does not move is taken for frozen.
    const FROZEN: u32 = 8;
    /// The same of a slow axis: the set value has gone this far meanwhile (rad); regulators and
    /// friction explain less.
    const WANTED: f64 = 1.0;
    /// Share of the remembered speed from which on an axis is as fast as before.
    const AS_FAST: f64 = 0.9;
    /// Time in which regulators bring an axis to where it is to stand (s): the wrist's roll,
    /// stopped from the speed of a turn, goes 3.4 rad of its motor beyond its set value.
    const STANDING: f64 = 0.6;
    /// How much faster than told a motor may be, and by how much time two readings may be further
    /// apart than told (s).
    const FASTER: f64 = 1.3;
    const OFF: f64 = 0.002;
    /// Share of the current that trips a power stage from which on an axis is strained.
    const STRAIN: f64 = 0.5;

    /// Makes the watchdog of an axis at rest.
    fn new(trip: f64, increments: f64, count: i64, period: Length) -> Self {
        Self {
            speed: 0.0,
            holds: 0,
            frozen: 0,
            wanted: 0.0,
            increments,
            last_count: count,
            trip,
            strained: 0,
            interval: Interval::default(),
            allowance: Allowance::new(period),
        }
    }

    /// Forgets the past.
    fn reset(&mut self, count: i64) {
        self.rebase(count);
        (self.speed, self.strained) = (0.0, 0);
        self.interval = Interval::default();
        self.allowance.reset();
    }

    /// Takes the counter's present value for the last one.
    fn rebase(&mut self, count: i64) {
        self.last_count = count;
        self.frozen = 0;
        self.wanted = 0.0;
    }

    /// Follows the set value by one period: its recent speed, and how far it has gone.
    fn follow(&mut self, step: f64, rules: &Rules) {
        let speed = step.abs() / rules.seconds;
        if speed >= Self::AS_FAST * self.speed {
            self.speed = self.speed.max(speed);
            self.holds = (Self::STANDING / rules.seconds) as u32;
        } else if self.holds > 0 {
            self.holds -= 1;
        } else {
            self.speed = (self.speed * rules.fade).max(speed);
        }
        self.wanted += step;
        self.interval.pass(1.0);
    }

    /// Counts the periods in which the axis is strained, less those in which it is not.
    fn strain(&mut self, current: f64) {
        let strains = current.abs() > Self::STRAIN * self.trip;
        self.strained = if strains { self.strained + 1 } else { self.strained.saturating_sub(1) };
    }

    /// Judges a counter that was read.
    fn judge(&mut self, axis: usize, seen: &Seen, rules: &Rules) -> Option<ArmFault> {
        let moved = seen.count - self.last_count;
        self.last_count = seen.count;
        let still = moved == 0 && seen.step.abs() / rules.seconds > Self::MUST_MOVE;
        self.frozen = if still { self.frozen + 1 } else { 0 };
        if moved != 0 {
            self.wanted = 0.0;
        }
        let by = moved as f64 * std::f64::consts::TAU / self.increments;
        let fast = Self::FASTER * self.speed;
        let within = |periods: f64| rules.jump + fast * (periods * rules.seconds + Self::OFF);
        let interval = &mut self.interval;
        let (since, possible) = (interval.since().max(1.0), within(interval.longest()));
        let gap = (since - 1.0) * rules.seconds;
        let doubt = gap + interval.older() * rules.seconds;
        // A reading that shows half of what a gap hid, or what no period explains, is one of now.
        let shows = gap > 0.0 && by.abs() > 0.5 * gap * self.speed;
        interval.read(shows || by.abs() > within(1.0));
        let allowance = self.allowance.read(fast * gap);
        let left = seen.error + self.allowance.of(seen.backlog);
        let allowed =
            rules.following_error + rules.following_lag * self.speed + allowance.min(fast * doubt);
        // An axis that is where it is to be follows, whatever the backlog of its regulator.
        let off = |error: f64| !(-allowed..=allowed).contains(&error);
        let wanted = self.wanted;
        // Not within also catches what is not a number. The cause is reported before its effect.
        if by.abs() > possible {
            Some(ArmFault::EncoderJump { axis, by })
        } else if self.frozen > Self::FROZEN || wanted.abs() > Self::WANTED + fast * gap {
            Some(ArmFault::EncoderFrozen { axis, wanted })
        } else if off(seen.error) && off(left) {
            Some(ArmFault::Following { axis, error: seen.error })
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::servo::regulator::IRP6;

    /// Increments of the encoder a revolution, and speed of the motor [increments a period]: 157 rad/s.
    const INCREMENTS: f64 = 4000.0;
    const SPEED: i64 = 200;

    /// Returns watchdogs of an arm at rest whose counters show zero.
    fn watch(gains: &ServoGains) -> Watch {
        Watch::new(gains, &[INCREMENTS; AXES], [0; AXES], Length::default())
    }

    #[derive(Clone)]
    struct Axis {
        watch: Watch,
        set: i64,
    }

    impl Axis {
        /// Makes an axis that has followed its set value for a while, without lag.
        fn running() -> Self {
            let gains = ServoGains::parse(IRP6).unwrap();
            let mut axis = Self { watch: watch(&gains), set: 0 };
            for _ in 0..50 {
                assert_eq!(axis.shows(axis.set + SPEED, 1), None);
            }
            axis
        }

        /// Checks the next reading, which comes after `periods`.
        fn shows(&mut self, count: i64, periods: i64) -> Option<ArmFault> {
            let radian = INCREMENTS / std::f64::consts::TAU;
            self.watch.skipped(periods as u64 - 1);
            self.set += periods * SPEED;
            let mut reading = ArmReading::default();
            let (mut measured, mut set) = (MotorPositions::default(), MotorPositions::default());
            let mut steps = [0.0; AXES];
            reading.counts[3] = count;
            measured.0[3] = count as f64 / radian;
            set.0[3] = self.set as f64 / radian;
            steps[3] = SPEED as f64 / radian;
            let wanted = Wanted { set: &set, steps: &steps, backlog: &[0.0; AXES] };
            self.watch.check(&reading, &measured, &wanted, 1)
        }
    }

    /// Returns the number of periods for which a standing axis bears this current. Every tenth
    /// reading is missing, or shows the current `tenth`.
    fn bears(amperes: f64, tenth: Option<f64>) -> Option<u32> {
        let gains = ServoGains::parse(IRP6).unwrap();
        let mut watch = watch(&gains);
        let still = MotorPositions::default();
        let wanted = Wanted { set: &still, steps: &[0.0; AXES], backlog: &[0.0; AXES] };
        (0..2000).find(|period| {
            let mut reading = ArmReading::default();
            reading.currents[1] = amperes;
            if period % 10 == 9 {
                reading.currents[1] = tenth.unwrap_or_default();
                reading.no_answer = u8::from(tenth.is_none()) << 1;
            }
            match watch.check(&reading, &still, &wanted, 0) {
                None => false,
                Some(ArmFault::OverCurrent { axis: 1, amperes }) => amperes.abs() > 7.5,
                other => panic!("{other:?}"),
            }
        })
    }

    #[test]
    fn strained_axis_stops_before_its_power_stage() {
        for amperes in [8.0, -8.0] {
            assert_eq!(bears(amperes, Some(amperes)), Some(150));
            assert_eq!(bears(amperes, None).map(|periods| periods / 10), Some(16));
            assert_eq!(bears(amperes, Some(0.0)).map(|periods| periods / 10), Some(18));
        }
        assert_eq!(bears(7.0, Some(32.7)), None, "15 A trip its power stage");
    }

    #[test]
    fn reading_after_missed_periods_may_be_old() {
        let mut axis = Axis::running();

        let before = axis.set;
        assert_eq!(axis.shows(before, 30), None);
        assert_eq!(axis.shows(axis.set + SPEED, 1), None);
    }

    #[test]
    fn device_that_catches_up_is_no_fault() {
        let mut axis = Axis::running();

        let before = axis.set;
        assert_eq!(axis.shows(before, 30), None);
        assert_eq!(axis.shows(before + SPEED, 1), None);
        assert_eq!(axis.shows(axis.set + SPEED, 1), None);
    }

    #[test]
    fn step_of_a_gap_shows_once() {
        for first in [0, 30] {
            let mut axis = Axis::running();
            // The first reading is of before the gap, or of now.
            assert_eq!(axis.shows(axis.set + first * SPEED, 30), None);
            assert_eq!(axis.shows(axis.set + SPEED, 1), None);

            let fault = axis.shows(axis.set + SPEED + 15 * SPEED, 1);
            assert!(matches!(fault, Some(ArmFault::EncoderJump { axis: 3, .. })), "{first}");
        }
    }

    #[test]
    fn jump_without_a_gap_is_a_fault() {
        let mut axis = Axis::running();
        let jumps = |axis: &mut Axis| axis.shows(axis.set + SPEED + 2000, 1);

        assert!(matches!(jumps(&mut axis.clone()), Some(ArmFault::EncoderJump { axis: 3, .. })));
        assert_eq!(axis.shows(axis.set + 30 * SPEED, 30), None);
        for _ in 0..10 {
            assert_eq!(axis.shows(axis.set + SPEED, 1), None);
        }
        assert!(matches!(jumps(&mut axis), Some(ArmFault::EncoderJump { axis: 3, .. })));
    }
}
