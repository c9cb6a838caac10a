//! Homing: an arm that was just switched on finds the synchronisation position, one axis after the other.
//!
//! An axis goes backwards until its switch is pressed, stands, leaves the switch slowly forwards, and lets its
//! controller set the counter to zero at the first zero of the encoder; then the next axis. An axis that stands
//! on its switch leaves it at once. Axes whose controllers are synchronised already are passed over.
//!
//! - in: switches and synchronised bits of an [`ArmReading`], measured motor positions
//! - out: the step of one motor in each period, the `synchronise` bits of the drives, or a fault
//! - source: homing in the original's sources: order from the lower arm on, ramps of 10 periods, coarse 15 rad/s
//!   (tool roll 25, jaw 250), fine 3.5 (25, 100), stands of 250 and 25 periods, a switch is read twice

use super::io::{ArmReading, JAW};
use super::period::Length;
use crate::motion::{AXES, ArmFault};
use std::f64::consts::TAU;

/// The order of the original: the lower arm first, then onwards and around.
const ORDER: [usize; AXES + 1] = [2, 3, 4, 5, 6, JAW, 0, 1];
/// Periods of 2 ms in which a speed is reached or given up.
const RAMP: f64 = 10.0;
/// Periods of 2 ms of standing on the switch, and after the zero.
const STANDS: (u32, u32) = (250, 25);
/// Periods that a switch must be read alike.
const DEBOUNCE: u32 = 2;
/// From the switch's edge there must be a zero within this (rad): a revolution and what the ramp
/// takes.
const TO_ZERO: f64 = 1.25 * TAU;
/// No cam is longer than an axis goes in this time at its fine speed (s).
const CAM: f64 = 20.0;
/// No axis has a longer way than this; it ends at its limit switch long before (rad).
const LONGEST: f64 = 5000.0;

/// Coarse and fine speed of an axis (rad/s of the motor).
fn speeds(axis: usize) -> (f64, f64) {
    match axis {
        JAW => (-250.0, 100.0),
        6 => (-25.0, 25.0),
        _ => (-15.0, 3.5),
    }
}

/// What an axis is doing.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Backwards to the switch.
    Coarse,
    /// Stands on the switch for so many periods more.
    Stand(u32),
    /// Forwards off the switch.
    Leave,
    /// Off the switch; the controller waits for its encoder's zero.
    Zero,
    /// Synchronised; stands for so many periods more.
    Rest(u32),
}

/// Homing of one arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Homing {
    /// Place in the order.
    next: usize,
    has_track: bool,
    phase: Phase,
    /// Speed of the set value (rad/s).
    speed: f64,
    /// Way of the set value in this phase (rad).
    travelled: f64,
    /// Periods in which the switch was read the same, and as what.
    switch: (bool, u32),
    /// Length of a period (s); periods of a ramp and of the stands.
    seconds: f64,
    ramp: f64,
    stands: (u32, u32),
}

/// What an arm does in a period of its homing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HomingStep {
    /// The axis whose turn it is; [`JAW`] is the jaw.
    pub axis: usize,
    /// Its set value's step (rad of the motor).
    pub step: f64,
    /// Bits of [`super::io::ArmDrive::synchronise`].
    pub synchronise: u8,
    /// The axis has just been synchronised: its counter jumped, and set values start anew from it.
    pub zeroed: bool,
}

/// What is read of the axis whose turn it is.
struct Seen {
    axis: usize,
    /// Its synchronisation switch, once that is known.
    pressed: Option<bool>,
    /// Its limit switches.
    at_lower: bool,
    at_upper: bool,
    synchronised: bool,
}

impl Homing {
    /// Begins with the first axis.
    #[must_use]
    pub fn new(has_track: bool, period: Length) -> Self {
        Self {
            seconds: period.seconds(),
            ramp: (RAMP / period.ratio()).max(1.0),
            stands: (period.count(STANDS.0), period.count(STANDS.1)),
            next: 0,
            has_track,
            phase: Phase::Coarse,
            speed: 0.0,
            travelled: 0.0,
            switch: (false, 0),
        }
    }

    /// Takes one period; returns `None` when all axes are synchronised.
    ///
    /// # Errors
    /// [`ArmFault::SwitchExpected`], [`ArmFault::SwitchHeld`], [`ArmFault::ZeroExpected`].
    pub fn step(&mut self, reading: &ArmReading) -> Result<Option<HomingStep>, ArmFault> {
        if self.phase == Phase::Rest(0) {
            self.next += 1;
            self.switch = (false, 0);
            self.enter(Phase::Coarse);
        }
        let Some(axis) = self.axis(reading) else { return Ok(None) };
        let bit = 1u8 << axis;
        let seen = Seen {
            axis,
            pressed: self.read_switch(reading.sync_switches & bit != 0),
            at_lower: reading.lower_limits & bit != 0,
            at_upper: reading.upper_limits & bit != 0,
            synchronised: reading.synchronised & bit != 0,
        };
        let before = self.phase;
        let goal = match before {
            Phase::Coarse => self.seek_switch(&seen)?,
            Phase::Stand(left) => self.stand(left, &seen)?,
            Phase::Leave => self.leave_switch(&seen)?,
            Phase::Zero => self.seek_zero(&seen)?,
            Phase::Rest(left) => {
                // The next axis's turn comes before it is 0.
                self.phase = Phase::Rest(left.saturating_sub(1));
                0.0
            }
        };
        let zeroed = before == Phase::Zero && matches!(self.phase, Phase::Rest(_));
        let (coarse, fine) = speeds(axis);
        let change = coarse.abs().max(fine) / self.ramp;
        self.speed += (goal - self.speed).clamp(-change, change);
        let step = self.speed * self.seconds;
        self.travelled += step;
        // Set before the switch lets go: the controller takes the first zero behind it, however
        // near that lies.
        let synchronise = if matches!(self.phase, Phase::Leave | Phase::Zero) { bit } else { 0 };
        Ok(Some(HomingStep { axis, step, synchronise, zeroed }))
    }

    /// Goes backwards until the switch is pressed; returns the speed that is wanted.
    fn seek_switch(&mut self, seen: &Seen) -> Result<f64, ArmFault> {
        match seen.pressed {
            Some(true) => {
                self.enter(Phase::Stand(self.stands.0));
                Ok(0.0)
            }
            // It is not known yet whether the axis stands on the switch; if it does, it must not go
            // further on.
            None if self.travelled == 0.0 => Ok(0.0),
            pressed => {
                // It may have been left standing on its upper one; on the lower one, or behind it,
                // may be the cam.
                let at_limit = seen.at_lower && pressed == Some(false);
                if at_limit || self.travelled.abs() > LONGEST {
                    return Err(self.switch_expected(seen));
                }
                Ok(speeds(seen.axis).0)
            }
        }
    }

    /// Stands on the switch.
    fn stand(&mut self, left: u32, seen: &Seen) -> Result<f64, ArmFault> {
        if left > 0 {
            self.phase = Phase::Stand(left - 1);
            return Ok(0.0);
        }
        // A switch that was run over is no place to begin from.
        if seen.pressed != Some(true) {
            return Err(self.switch_expected(seen));
        }
        self.enter(Phase::Leave);
        Ok(speeds(seen.axis).1)
    }

    /// Goes forwards off the switch.
    fn leave_switch(&mut self, seen: &Seen) -> Result<f64, ArmFault> {
        let (axis, travelled) = (seen.axis, self.travelled);
        let fine = speeds(axis).1;
        // A controller that took a zero on the switch would be whole revolutions off.
        if seen.synchronised && seen.pressed == Some(true) {
            return Err(ArmFault::ZeroExpected { axis, travelled });
        }
        if seen.pressed == Some(false) {
            self.enter(Phase::Zero);
        } else if travelled > CAM * fine || seen.at_upper {
            return Err(ArmFault::SwitchHeld { axis, travelled });
        }
        Ok(fine)
    }

    /// Goes on until the controller has set its counter to zero.
    fn seek_zero(&mut self, seen: &Seen) -> Result<f64, ArmFault> {
        let (axis, travelled) = (seen.axis, self.travelled);
        if seen.synchronised {
            self.enter(Phase::Rest(self.stands.1));
            return Ok(0.0);
        }
        if travelled > TO_ZERO {
            return Err(ArmFault::ZeroExpected { axis, travelled });
        }
        Ok(speeds(axis).1)
    }

    fn switch_expected(&self, seen: &Seen) -> ArmFault {
        ArmFault::SwitchExpected { axis: seen.axis, travelled: self.travelled.abs() }
    }

    /// The axis whose turn it is; passes over those that need none.
    fn axis(&mut self, reading: &ArmReading) -> Option<usize> {
        while let Some(&axis) = ORDER.get(self.next) {
            let begun = self.phase != Phase::Coarse || self.travelled != 0.0;
            let absent = axis == 0 && !self.has_track;
            if begun || !(absent || reading.synchronised & (1 << axis) != 0) {
                return Some(axis);
            }
            self.next += 1;
        }
        None
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.travelled = 0.0;
    }

    /// The switch, once it was read the same often enough.
    fn read_switch(&mut self, pressed: bool) -> Option<bool> {
        let (last, times) = self.switch;
        self.switch = (pressed, if last == pressed { (times + 1).min(DEBOUNCE) } else { 1 });
        (self.switch.1 >= DEBOUNCE).then_some(pressed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::PERIOD;

    /// An axis that follows its set value exactly, with a switch and an encoder.
    struct Axis {
        at: f64,
        /// Pressed between these (rad).
        cam: (f64, f64),
        has_zero: bool,
        synchronised: u8,
        log: Vec<f64>,
    }

    impl Axis {
        fn new(at: f64) -> Self {
            Self {
                at,
                cam: (-30.0, -3.0),
                has_zero: true,
                synchronised: !(1 << 4),
                log: Vec::new(),
            }
        }

        /// Homes it alone.
        fn home(&mut self) -> Result<(), ArmFault> {
            let mut homing = Homing::new(true, Length::default());
            for _ in 0..100_000 {
                let reading = ArmReading {
                    sync_switches: u8::from((self.cam.0..self.cam.1).contains(&self.at)) << 4,
                    lower_limits: u8::from(self.at < -60.0) << 4,
                    upper_limits: u8::from(self.at >= 100.0) << 4,
                    synchronised: self.synchronised,
                    ..ArmReading::default()
                };
                let Some(step) = homing.step(&reading)? else { return Ok(()) };
                assert_eq!(step.axis, 4);
                let before = (self.at / TAU).floor();
                self.at += step.step;
                self.log.push(step.step / PERIOD);
                let zero = self.has_zero && (self.at / TAU).floor() != before;
                if step.synchronise != 0 && zero && !(self.cam.0..self.cam.1).contains(&self.at) {
                    self.synchronised |= step.synchronise;
                }
            }
            panic!("it never ends");
        }
    }

    #[test]
    fn an_axis_ends_just_behind_the_zero_that_follows_the_switch() {
        for start in [120.0, 70.0, 0.2, -20.0] {
            let mut axis = Axis::new(start);

            axis.home().unwrap();

            assert!((0.0..0.2).contains(&axis.at), "{}", axis.at);
            assert!(axis.log.iter().all(|v| (-15.01..=3.51).contains(v)));
            let jerk = axis.log.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
            assert!(jerk < 1.51, "speeds are ramped: {jerk}");
        }
    }

    #[test]
    fn an_axis_that_stands_on_its_cam_at_its_lower_limit_leaves_both() {
        let mut axis = Axis { cam: (-100.0, -3.0), ..Axis::new(-65.0) };

        axis.home().unwrap();

        assert!((0.0..0.2).contains(&axis.at), "{}", axis.at);
        assert!(axis.log.iter().all(|v| *v >= 0.0), "never further down");
    }

    #[test]
    fn a_zero_right_behind_the_switch_is_the_one() {
        let mut axis = Axis { cam: (-30.0, -0.02), ..Axis::new(20.0) };

        axis.home().unwrap();

        assert!((0.0..0.2).contains(&axis.at), "{}", axis.at);
    }

    #[test]
    fn what_does_not_come_is_a_fault() {
        let mut no_switch = Axis { cam: (0.0, 0.0), ..Axis::new(20.0) };
        assert!(matches!(
            no_switch.home(),
            Err(ArmFault::SwitchExpected { axis: 4, travelled }) if travelled > 79.0
        ));

        // A cam that is passed between two readings is none.
        let mut run_over = Axis { cam: (-3.02, -3.0), ..Axis::new(20.0) };
        let ended = run_over.home();
        assert!(
            matches!(ended, Err(ArmFault::SwitchExpected { axis: 4, .. })),
            "{ended:?} {}",
            run_over.at
        );

        let mut no_zero = Axis { has_zero: false, ..Axis::new(20.0) };
        assert!(matches!(no_zero.home(), Err(ArmFault::ZeroExpected { axis: 4, .. })));

        let mut stuck = Axis { cam: (-50.0, 200.0), ..Axis::new(20.0) };
        assert!(matches!(
            stuck.home(),
            Err(ArmFault::SwitchHeld { axis: 4, travelled }) if travelled < 71.0
        ));
    }

    #[test]
    fn a_synchronised_arm_has_nothing_to_do_and_a_missing_track_is_passed_over() {
        assert_eq!(Homing::new(true, Length::default()).step(&ArmReading::default()), Ok(None));
        let reading = ArmReading { synchronised: !1, ..ArmReading::default() };
        assert_eq!(Homing::new(false, Length::default()).step(&reading), Ok(None));
        let first = Homing::new(true, Length::default()).step(&reading).unwrap().unwrap();
        assert_eq!(first.axis, 0);
    }
}
