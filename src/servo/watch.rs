//! Watchdogs of the axes: the faults that make a servo stop its arm by itself.
//!
//! | fault | threshold | reason |
//! |---|---|---|
//! | over-current | `STRAIN` for `OVERLOAD`, or its bit | a strained axis never trips by itself |
//! | power stage | its bit in the reading | the motor has no drive |
//! | limit switch | its bit, unless set within `SETTLING` | the axis leaves its range |
//! | encoder jump | `JUMP`, `FASTER`, `LATE` | no motor makes this step between two readings |
//! | frozen encoder | `FROZEN`, `FROZEN_WAY` | the set value moves, and the counter does not |
//! | following error | `following_error`, `following_lag` | the axis does not follow |
//!
//! The watchdog reports a cause before its effect: of several faults it reports the one that is
//! highest in this table. The last three are faults of a counter, and the first axis with one of
//! them is reported. [`super::lateness`] has the rules for readings that are late or missing.

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
    /// Periods since the beginning or the last reset, up to [`Watch::SETTLING`].
    age: u32,
    /// Upper and lower limit switches that axes pressed at the beginning and have not left yet: an
    /// axis may leave its switch.
    held_from_start: (u8, u8),
}

/// Thresholds and constants that all axes share.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rules {
    /// Allowed difference of set and measured motor position at rest (rad), and its increase per
    /// speed (s).
    following_error: f64,
    following_lag: f64,
    /// Length of a period (s).
    seconds: f64,
    /// Share of the remembered speed that is left after a period.
    fade: f64,
    /// Step between two readings that no motor makes in addition to its commanded step (rad).
    jump: f64,
}

/// Set values of an arm against which the watchdogs judge the readings (rad of the motor).
#[derive(Debug, Clone, Copy)]
pub struct Wanted<'a> {
    /// Set values of the last period.
    pub set: &'a MotorPositions,
    /// Steps of the set values in that period.
    pub steps: &'a [f64; AXES],
    /// Distances by which the motors are ahead of the steps that their regulators were given.
    pub backlog: &'a [f64; AXES],
}

impl Watch {
    /// Share of the remembered speed that is left after 2 ms: a time constant of 40 ms.
    const FADE: f64 = 0.95;
    /// Step between two readings that no motor makes in addition to its commanded step (rad).
    const JUMP: f64 = 1.0;
    /// Largest time with strain, less the time without strain (s). The regulator lets no current
    /// rise to the trip, so without this limit an axis that presses on something would do so for
    /// ever.
    const OVERLOAD: f64 = 0.3;
    /// Step of a set value that counts as rounding (rad of the motor).
    const ROUNDING: f64 = 1e-5;
    /// Periods after a reset in which the state of the switches becomes known: serial lines report
    /// a switch after two equal readings.
    const SETTLING: u32 = 5;

    /// Makes the watchdogs of an arm at rest whose counters show `counts`. `increments` are the
    /// increments of its encoders per revolution of the motor.
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
            // At 2 ms the literal counts: the default results do not depend on a power's rounding.
            fade: if period == Length::default() {
                Self::FADE
            } else {
                libm::pow(Self::FADE, period.ratio())
            },
            // A longer period has room for a larger step.
            jump: Self::JUMP * period.ratio().max(1.0),
        };
        let axis =
            |i: usize| AxisWatch::new(gains.axes[i].trip_current, increments[i], counts[i], period);
        Self { rules, axes: std::array::from_fn(axis), age: 0, held_from_start: (0, 0) }
    }

    /// Clears the memory: the arm is at rest, and its counters show `counts`.
    pub fn reset(&mut self, counts: [i64; AXES]) {
        for (axis, count) in self.axes.iter_mut().zip(counts) {
            axis.reset(count);
        }
        (self.age, self.held_from_start) = (0, (0, 0));
    }

    /// Registers that the servo missed a number of periods before the next reading.
    pub fn add_missed_periods(&mut self, missed: u64) {
        for axis in &mut self.axes {
            axis.interval.pass(missed as f64);
        }
    }

    /// Takes `count` as the new value of the counter of `axis`, which its controller has set to
    /// zero: the jump of the counter is no motion of the axis.
    pub fn rebase(&mut self, axis: usize, count: i64) {
        self.axes[axis].rebase(count);
    }

    /// Returns the fault that this reading shows; of several faults, the one that is highest in the
    /// table at the head of this module. `measured` are the motor positions of the reading. Axes
    /// before `first_axis` are not judged by their counters and strain.
    pub fn check(
        &mut self,
        reading: &ArmReading,
        measured: &MotorPositions,
        wanted: &Wanted<'_>,
        first_axis: usize,
    ) -> Option<ArmFault> {
        // A later fault replaces an earlier one. So the checks run from the bottom of the table to
        // its top, and the axes from the last to the first.
        let mut fault = None;
        for axis in (first_axis..AXES).rev() {
            let watch = &mut self.axes[axis];
            watch.follow(wanted.steps[axis], &self.rules);
            // Without an answer the current is an old one, and it says nothing about this period.
            if reading.no_answer >> axis & 1 == 0 {
                watch.strain(reading.currents[axis]);
            }
            // An extrapolated counter shows the estimate and not the axis.
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
        // The three faults of the hardware are causes of those of the counters and replace them.
        let first = |bits: u8| (bits != 0).then(|| bits.trailing_zeros() as usize);
        if let Some(axis) = first(self.hit(reading, wanted.steps)) {
            // The bits include the jaw, whose motor is not among the measured ones.
            let motor = measured.0.get(axis).copied().unwrap_or_default();
            fault = Some(ArmFault::LimitSwitch { axis, motor });
        }
        if let Some(axis) = first(reading.power_faults) {
            fault = Some(ArmFault::PowerStage { axis });
        }
        let strained =
            |axis: &AxisWatch| f64::from(axis.strained) * self.rules.seconds > Self::OVERLOAD;
        if let Some(axis) = first(reading.over_currents).or(self.axes.iter().position(strained)) {
            fault = Some(ArmFault::OverCurrent { axis, amperes: reading.currents[axis] });
        }
        fault
    }

    /// Returns a bit mask of the axes that have run onto a limit switch, or move further onto a
    /// switch that they pressed at the start.
    fn hit(&mut self, reading: &ArmReading, steps: &[f64; AXES]) -> u8 {
        let (upper, lower) = (reading.upper_limits, reading.lower_limits);
        if self.age < Self::SETTLING {
            self.age += 1;
            self.held_from_start = (self.held_from_start.0 | upper, self.held_from_start.1 | lower);
        }
        let going =
            |is: fn(f64) -> bool| (0..AXES).fold(0, |bits, i| bits | u8::from(is(steps[i])) << i);
        let (up, down) =
            (going(|step| step > Self::ROUNDING), going(|step| step < -Self::ROUNDING));
        // A switch that the axis has left counts as any other. One that it moves further onto is
        // a fault at once, so its permission ends as well.
        self.held_from_start =
            (self.held_from_start.0 & upper & !up, self.held_from_start.1 & lower & !down);
        upper & !self.held_from_start.0 | lower & !self.held_from_start.1
    }
}

/// Watchdog of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct AxisWatch {
    /// Recent speed of the set value (rad/s). The highest of a while counts, so that the thresholds
    /// stay wide during a sudden stop.
    speed: f64,
    /// Periods for which the remembered speed does not fall off yet.
    holds: u32,
    /// Periods in a row in which the axis should have moved and its counter did not.
    frozen: u32,
    /// Distance of the set value since the counter last changed (rad).
    wanted: f64,
    /// Increments of the encoder per revolution of the motor.
    increments: f64,
    last_count: i64,
    /// Current at which its power stage trips (A), and the number of periods with strain less those
    /// without.
    trip: f64,
    strained: u32,
    /// Time since the counter was last read.
    interval: Interval,
    /// Following error that the gaps explain.
    allowance: Allowance,
}

/// Values of one axis in one period that its watchdog judges (rad of the motor).
struct Seen {
    count: i64,
    /// Step of the set value.
    step: f64,
    /// Set value less measured value.
    error: f64,
    /// Distance by which the motor is ahead of the steps that its regulator was given.
    backlog: f64,
}

impl AxisWatch {
    /// Speed of a set value that must show in the encoder (rad/s).
    const MUST_MOVE: f64 = 15.0;
    /// Periods at that speed after which a counter that does not move counts as frozen.
    const FROZEN: u32 = 8;
    /// Distance of a slow set value after which a counter that does not move counts as frozen
    /// (rad). Regulator and friction explain less.
    const FROZEN_WAY: f64 = 1.0;
    /// Share of the remembered speed above which the axis counts as equally fast.
    const AS_FAST: f64 = 0.9;
    /// Time in which the regulator brings an axis to rest at its set value (s). The wrist's roll,
    /// stopped from the speed of a turn, overshoots by 3.4 rad of its motor.
    const COMES_TO_REST: f64 = 0.6;
    /// Factor of the commanded speed that a motor may reach, and the time by which two readings may
    /// be further apart than they seem (s).
    const FASTER: f64 = 1.3;
    const LATE: f64 = 0.002;
    /// Share of the trip current above which an axis counts as strained.
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

    /// Clears the memory: the axis is at rest, and its counter shows `count`.
    fn reset(&mut self, count: i64) {
        self.rebase(count);
        (self.speed, self.strained) = (0.0, 0);
        self.interval = Interval::default();
        self.allowance.reset();
    }

    /// Takes `count` as the last value of the counter, without a check of its change.
    fn rebase(&mut self, count: i64) {
        self.last_count = count;
        self.frozen = 0;
        self.wanted = 0.0;
    }

    /// Adds one period in which the set value moved by `step` (rad): updates the recent speed, and
    /// the distance of the set value since the counter last changed.
    fn follow(&mut self, step: f64, rules: &Rules) {
        let speed = step.abs() / rules.seconds;
        // An axis overshoots after its set value has stopped, so the speed stays in memory for a
        // while. A speed of nearly the same size starts this time again.
        if speed >= Self::AS_FAST * self.speed {
            self.speed = self.speed.max(speed);
            self.holds = (Self::COMES_TO_REST / rules.seconds) as u32;
        } else if self.holds > 0 {
            self.holds -= 1;
        } else {
            self.speed = (self.speed * rules.fade).max(speed);
        }
        self.wanted += step;
        self.interval.pass(1.0);
    }

    /// Increases the count of strained periods if `current` (A) strains the axis, else decreases
    /// it.
    fn strain(&mut self, current: f64) {
        // The count falls and is not reset, so a current that wavers about the threshold counts.
        let strains = current.abs() > Self::STRAIN * self.trip;
        self.strained = if strains { self.strained + 1 } else { self.strained.saturating_sub(1) };
    }

    /// Judges a counter that was read in this period. Returns the fault of the axis, if any; of
    /// several faults, the one that causes the others.
    fn judge(&mut self, axis: usize, seen: &Seen, rules: &Rules) -> Option<ArmFault> {
        let moved = seen.count - self.last_count;
        self.last_count = seen.count;
        // An encoder is frozen if its counter rests at a speed that must show. At a speed too low
        // for that, the distance of the set value since the last change decides.
        let still = moved == 0 && seen.step.abs() / rules.seconds > Self::MUST_MOVE;
        self.frozen = if still { self.frozen + 1 } else { 0 };
        if moved != 0 {
            self.wanted = 0.0;
        }
        let by = moved as f64 * std::f64::consts::TAU / self.increments;
        // A motor can make a step of its recent speed, with a margin, over the longest time that
        // may lie between the two readings.
        let fast = Self::FASTER * self.speed;
        let within = |periods: f64| rules.jump + fast * (periods * rules.seconds + Self::LATE);
        let interval = &mut self.interval;
        let (since, possible) = (interval.since().max(1.0), within(interval.longest()));
        let gap = (since - 1.0) * rules.seconds;
        let doubt = gap + interval.older() * rules.seconds;
        // A reading that shows half of the step that a gap hid, or a step too large for one period,
        // was taken after the gap. Later readings are then as new as they seem.
        let shows = gap > 0.0 && by.abs() > 0.5 * gap * self.speed;
        interval.read(shows || by.abs() > within(1.0));
        // The motor kept moving during a gap while its set value did not. So the error may be as
        // large as the backlog, and while the age of the reading is in doubt the limit is wider.
        let allowance = self.allowance.read(fast * gap);
        let left = seen.error + self.allowance.of(seen.backlog);
        let allowed =
            rules.following_error + rules.following_lag * self.speed + allowance.min(fast * doubt);
        // The negated `contains` is also true for NaN.
        let off = |error: f64| !(-allowed..=allowed).contains(&error);
        let wanted = self.wanted;
        // An axis at its set value follows, even if answers that fail in every other period leave a
        // backlog in its regulator. So both errors must be too large.
        if by.abs() > possible {
            Some(ArmFault::EncoderJump { axis, by })
        } else if self.frozen > Self::FROZEN || wanted.abs() > Self::FROZEN_WAY + fast * gap {
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

    /// Increments of the encoder per revolution, and the speed of the motor (increments per
    /// period): 157 rad/s.
    const INCREMENTS: f64 = 4000.0;
    const SPEED: i64 = 200;

    /// Returns watchdogs of an arm at rest whose counters show zero.
    fn watch(gains: &ServoGains) -> Watch {
        Watch::new(gains, &[INCREMENTS; AXES], [0; AXES], Length::default())
    }

    /// Axis 3 of an arm, whose set value moves at [`SPEED`], with the watchdogs of the arm.
    #[derive(Clone)]
    struct Axis {
        watch: Watch,
        /// Set value (increments).
        set: i64,
    }

    impl Axis {
        /// Makes an axis that has followed its set value for a while without lag.
        fn running() -> Self {
            let gains = ServoGains::parse(IRP6).unwrap();
            let mut axis = Self { watch: watch(&gains), set: 0 };
            for _ in 0..50 {
                assert_eq!(axis.shows(axis.set + SPEED, 1), None);
            }
            axis
        }

        /// Lets the watchdogs check a reading of `count` that comes `periods` after the last one.
        fn shows(&mut self, count: i64, periods: i64) -> Option<ArmFault> {
            let radian = INCREMENTS / std::f64::consts::TAU;
            self.watch.add_missed_periods(periods as u64 - 1);
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

    /// Returns the number of periods after which a current of `amperes` stops an axis at rest;
    /// `None` if never. Every tenth reading is missing, or shows the current `tenth`.
    fn periods_of_strain(amperes: f64, tenth: Option<f64>) -> Option<u32> {
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
                // Strain begins at half of the trip current of 15 A.
                Some(ArmFault::OverCurrent { axis: 1, amperes }) => amperes.abs() > 7.5,
                other => panic!("{other:?}"),
            }
        })
    }

    #[test]
    fn strained_axis_stops_before_power_stage_trips() {
        for amperes in [8.0, -8.0] {
            // 0.3 s of strain are 150 periods. A tenth reading that is missing counts neither way,
            // and one without strain counts against it.
            assert_eq!(periods_of_strain(amperes, Some(amperes)), Some(150));
            assert_eq!(periods_of_strain(amperes, None).map(|periods| periods / 10), Some(16));
            assert_eq!(periods_of_strain(amperes, Some(0.0)).map(|periods| periods / 10), Some(18));
        }
        assert_eq!(periods_of_strain(7.0, Some(32.7)), None, "15 A trip its power stage");
    }

    #[test]
    fn watchdog_accepts_old_reading_after_missed_periods() {
        let mut axis = Axis::running();

        let before = axis.set;
        assert_eq!(axis.shows(before, 30), None);
        assert_eq!(axis.shows(axis.set + SPEED, 1), None);
    }

    #[test]
    fn watchdog_accepts_readings_that_catch_up_after_gap() {
        let mut axis = Axis::running();

        let before = axis.set;
        assert_eq!(axis.shows(before, 30), None);
        assert_eq!(axis.shows(before + SPEED, 1), None);
        assert_eq!(axis.shows(axis.set + SPEED, 1), None);
    }

    #[test]
    fn second_large_step_after_gap_is_a_fault() {
        for first in [0, 30] {
            let mut axis = Axis::running();
            // The first reading was taken before the gap or after it.
            assert_eq!(axis.shows(axis.set + first * SPEED, 30), None);
            assert_eq!(axis.shows(axis.set + SPEED, 1), None);

            let fault = axis.shows(axis.set + SPEED + 15 * SPEED, 1);
            assert!(matches!(fault, Some(ArmFault::EncoderJump { axis: 3, .. })), "{first}");
        }
    }

    #[test]
    fn encoder_jump_without_missed_periods_is_a_fault() {
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
