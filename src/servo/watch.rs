//! Watch-dogs of the axes: what makes a servo stop its arm by itself.

use super::io::ArmReading;
use super::period::Length;
use super::regulator::ServoGains;
use super::span::Span;
use super::stride::Stride;
use crate::motion::{AXES, ArmFault, MotorPositions};

/// Following error and frozen encoders of all axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Watch {
    following_error: f64,
    following_lag: f64,
    /// Recent speed of the set value [rad/s]: the highest of a while, so that a sudden stop is forgiven.
    speed: [f64; AXES],
    /// Periods in a row in which the axis should have moved and its counter did not.
    frozen: [u32; AXES],
    /// How far the set value has gone since the counter last changed [rad].
    wanted: [f64; AXES],
    last_counts: [i64; AXES],
    /// Length of a period [s], and what follows from it.
    seconds: f64,
    fade: f64,
    jump: f64,
    /// Periods for which the remembered speed does not fall off yet.
    holds: [u32; AXES],
    /// Currents that power stages stop at [A], and for how many periods more than not each axis was strained.
    trips: [f64; AXES],
    strained: [u32; AXES],
    /// Since the counter was last read.
    spans: [Span; AXES],
    /// What a motor can have gone in gaps and may still be owed [rad], and how much of it is paid between two readings.
    excused: [f64; AXES],
    pay: f64,
    /// Periods since the beginning or the last reset, up to [`Watch::SETTLES`].
    age: u32,
    /// Limit switches, upper and lower, on which axes stood then: they may leave them.
    stood_on: (u8, u8),
}

/// What an axis was told, as far as it is judged by it [rad of the motor].
#[derive(Debug, Clone, Copy)]
pub struct Wanted<'a> {
    /// Set values of the last period.
    pub set: &'a MotorPositions,
    /// How far they went in it.
    pub steps: &'a [f64; AXES],
    /// How far the motors are ahead of the steps that their regulators were told.
    pub owed: &'a [f64; AXES],
}

impl Watch {
    /// Share of the remembered speed that is left after 2 ms: about 40 ms in all.
    const FADE: f64 = 0.95;
    /// A set value faster than this must show in the encoder [rad/s].
    const MUST_MOVE: f64 = 15.0;
    /// Periods after which a counter that does not move is taken for frozen.
    const FROZEN: u32 = 8;
    /// The same of a slow axis: the set value has gone this far meanwhile [rad]; regulators and friction explain less.
    const WANTED: f64 = 1.0;
    /// Share of the remembered speed from which on an axis is as fast as before.
    const AS_FAST: f64 = 0.9;
    /// Time in which regulators bring an axis to where it is to stand [s]: the wrist's roll, stopped from the speed of a
    /// turn, goes 3.4 rad of its motor beyond its set value.
    const STANDING: f64 = 0.6;
    /// What no motor gains between two readings over the speed that it was told [rad].
    const JUMP: f64 = 1.0;
    /// How much faster than told a motor may be, and by how much time two readings may be further apart than told [s].
    const FASTER: f64 = 1.3;
    const OFF: f64 = 0.002;
    /// Share of the current that trips a power stage from which on an axis is strained, and for how much longer than not it
    /// may be [s]: its regulator lets no current rise to what trips, so that an axis that presses on something would do so for ever.
    const STRAIN: f64 = 0.5;
    const BEARS: f64 = 0.3;
    /// A step of a set value that is rounding [rad of the motor].
    const STANDS: f64 = 1e-5;
    /// Periods after a reset in which switches come to be known: lines tell of them after they have read them twice.
    const SETTLES: u32 = 5;

    /// At rest.
    #[must_use]
    pub fn new(gains: &ServoGains, counts: [i64; AXES], period: Length) -> Self {
        Self {
            following_error: gains.following_error,
            following_lag: gains.following_lag,
            speed: [0.0; AXES],
            frozen: [0; AXES],
            wanted: [0.0; AXES],
            trips: gains.axes.map(|axis| axis.trip_current),
            strained: [0; AXES],
            last_counts: counts,
            seconds: period.seconds(),
            fade: if period == Length::default() {
                Self::FADE
            } else {
                libm::pow(Self::FADE, period.ratio())
            },
            jump: Self::JUMP * period.ratio().max(1.0),
            holds: [0; AXES],
            spans: [Span::default(); AXES],
            excused: [0.0; AXES],
            pay: Stride::PAY * period.ratio(),
            age: 0,
            stood_on: (0, 0),
        }
    }

    /// Forgets the past.
    pub fn reset(&mut self, counts: [i64; AXES]) {
        self.speed = [0.0; AXES];
        self.frozen = [0; AXES];
        self.wanted = [0.0; AXES];
        self.strained = [0; AXES];
        self.last_counts = counts;
        self.spans = [Span::default(); AXES];
        self.excused = [0.0; AXES];
        (self.age, self.stood_on) = (0, (0, 0));
    }

    /// So many periods were missed before the next reading.
    pub fn skipped(&mut self, missed: u64) {
        for span in &mut self.spans {
            span.pass(missed as f64);
        }
    }

    /// A counter was set to zero: its jump is none of the axis.
    pub fn rebase(&mut self, axis: usize, count: i64) {
        self.last_counts[axis] = count;
        self.frozen[axis] = 0;
        self.wanted[axis] = 0.0;
    }

    /// The first fault of this reading.
    pub fn check(
        &mut self,
        reading: &ArmReading,
        measured: &MotorPositions,
        wanted: &Wanted<'_>,
        first_axis: usize,
        increments: &[f64; AXES],
    ) -> Option<ArmFault> {
        let Wanted { set, steps, owed } = wanted;
        let mut fault = None;
        for axis in (first_axis..AXES).rev() {
            let speed = steps[axis].abs() / self.seconds;
            if speed >= Self::AS_FAST * self.speed[axis] {
                self.speed[axis] = self.speed[axis].max(speed);
                self.holds[axis] = (Self::STANDING / self.seconds) as u32;
            } else if self.holds[axis] > 0 {
                self.holds[axis] -= 1;
            } else {
                self.speed[axis] = (self.speed[axis] * self.fade).max(speed);
            }
            self.wanted[axis] += steps[axis];
            self.spans[axis].pass(1.0);
            if reading.unheard >> axis & 1 == 0 {
                let strains = reading.currents[axis].abs() > Self::STRAIN * self.trips[axis];
                self.strained[axis] = if strains {
                    self.strained[axis] + 1
                } else {
                    self.strained[axis].saturating_sub(1)
                };
            }
            // What was not read is not judged.
            if reading.guessed >> axis & 1 == 1 {
                continue;
            }
            let moved = reading.counts[axis] - self.last_counts[axis];
            self.last_counts[axis] = reading.counts[axis];
            let still = moved == 0 && speed > Self::MUST_MOVE;
            self.frozen[axis] = if still { self.frozen[axis] + 1 } else { 0 };
            if moved != 0 {
                self.wanted[axis] = 0.0;
            }
            let by = moved as f64 * std::f64::consts::TAU / increments[axis];
            let fast = Self::FASTER * self.speed[axis];
            let within = |periods: f64| self.jump + fast * (periods * self.seconds + Self::OFF);
            let span = &mut self.spans[axis];
            let (since, possible) = (span.since().max(1.0), within(span.room()));
            let gap = (since - 1.0) * self.seconds;
            let doubt = gap + span.older() * self.seconds;
            // A reading that shows half of what a gap hid, or what no period explains, is one of now.
            let shows = gap > 0.0 && by.abs() > 0.5 * gap * self.speed[axis];
            span.read(shows || by.abs() > within(1.0));
            // How far a motor went on while nobody was there is no error and is worked off: by what it can have gone while it
            // is not known, and by the side on which it is as soon as that is known. Gaps that follow each other excuse what
            // is owed by all of them, but beyond it no more than the last of them hides.
            let excused = (self.excused[axis] - self.pay).max(0.0) + fast * gap;
            self.excused[axis] = excused;
            let error = set.0[axis] - measured.0[axis];
            let left = error + owed[axis].max(-excused).min(excused);
            let allowed = self.following_error
                + self.following_lag * self.speed[axis]
                + excused.min(fast * doubt);
            // An axis that is where it is to be follows, whatever is owed to its regulator.
            let off = |error: f64| !(-allowed..=allowed).contains(&error);
            let wanted = self.wanted[axis];
            // Not within also catches what is not a number. The cause is told before its effect.
            if by.abs() > possible {
                fault = Some(ArmFault::EncoderJump { axis, by });
            } else if self.frozen[axis] > Self::FROZEN || wanted.abs() > Self::WANTED + fast * gap {
                fault = Some(ArmFault::EncoderFrozen { axis, wanted });
            } else if off(error) && off(left) {
                fault = Some(ArmFault::Following { axis, error });
            }
        }
        let first = |bits: u8| (bits != 0).then(|| bits.trailing_zeros() as usize);
        if let Some(axis) = first(self.hit(reading, steps)) {
            let motor = measured.0.get(axis).copied().unwrap_or_default();
            fault = Some(ArmFault::LimitSwitch { axis, motor });
        }
        if let Some(axis) = first(reading.power_faults) {
            fault = Some(ArmFault::PowerStage { axis });
        }
        let strained = self
            .strained
            .iter()
            .position(|&periods| f64::from(periods) * self.seconds > Self::BEARS);
        if let Some(axis) = first(reading.over_currents).or(strained) {
            fault = Some(ArmFault::OverCurrent { axis, amperes: reading.currents[axis] });
        }
        fault
    }

    /// Bits of the axes that have run onto a limit switch, or go on into one on which they stood.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::servo::regulator::IRP6;

    /// Increments of the encoder a revolution, and speed of the motor [increments a period]: 157 rad/s.
    const INCREMENTS: f64 = 4000.0;
    const SPEED: i64 = 200;

    #[derive(Clone)]
    struct Axis {
        watch: Watch,
        set: i64,
    }

    impl Axis {
        /// One that has followed its set value for a while, without lag.
        fn running() -> Self {
            let gains = ServoGains::parse(IRP6).unwrap();
            let mut axis = Self { watch: Watch::new(&gains, [0; AXES], Length::default()), set: 0 };
            for _ in 0..50 {
                assert_eq!(axis.shows(axis.set + SPEED, 1), None);
            }
            axis
        }

        /// The next reading, after so many periods.
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
            let wanted = Wanted { set: &set, steps: &steps, owed: &[0.0; AXES] };
            self.watch.check(&reading, &measured, &wanted, 1, &[INCREMENTS; AXES])
        }
    }

    /// For how many periods an axis that stands bears this current; every tenth reading does not come, or is another one.
    fn bears(amperes: f64, tenth: Option<f64>) -> Option<u32> {
        let gains = ServoGains::parse(IRP6).unwrap();
        let mut watch = Watch::new(&gains, [0; AXES], Length::default());
        let still = MotorPositions::default();
        let wanted = Wanted { set: &still, steps: &[0.0; AXES], owed: &[0.0; AXES] };
        (0..2000).find(|period| {
            let mut reading = ArmReading::default();
            reading.currents[1] = amperes;
            if period % 10 == 9 {
                reading.currents[1] = tenth.unwrap_or_default();
                reading.unheard = u8::from(tenth.is_none()) << 1;
            }
            match watch.check(&reading, &still, &wanted, 0, &[INCREMENTS; AXES]) {
                None => false,
                Some(ArmFault::OverCurrent { axis: 1, amperes }) => amperes.abs() > 7.5,
                other => panic!("{other:?}"),
            }
        })
    }

    #[test]
    fn an_axis_that_strains_for_long_stops_before_its_power_stage_does() {
        for amperes in [8.0, -8.0] {
            assert_eq!(bears(amperes, Some(amperes)), Some(150));
            assert_eq!(bears(amperes, None).map(|periods| periods / 10), Some(16));
            assert_eq!(bears(amperes, Some(0.0)).map(|periods| periods / 10), Some(18));
        }
        assert_eq!(bears(7.0, Some(32.7)), None, "15 A trip its power stage");
    }

    #[test]
    fn after_missed_periods_a_reading_may_be_of_before_and_the_next_one_of_now() {
        let mut axis = Axis::running();

        let before = axis.set;
        assert_eq!(axis.shows(before, 30), None);
        assert_eq!(axis.shows(axis.set + SPEED, 1), None);
    }

    #[test]
    fn a_device_that_catches_up_may_show_a_little_first() {
        let mut axis = Axis::running();

        let before = axis.set;
        assert_eq!(axis.shows(before, 30), None);
        assert_eq!(axis.shows(before + SPEED, 1), None);
        assert_eq!(axis.shows(axis.set + SPEED, 1), None);
    }

    #[test]
    fn what_a_gap_hid_shows_once() {
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
    fn a_jump_without_missed_periods_or_long_after_them_is_a_fault() {
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
