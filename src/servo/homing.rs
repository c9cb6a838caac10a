//! Homing: an arm that was just switched on finds its synchronisation position, axis by axis.
//!
//! An axis moves backwards until its switch is pressed, pauses, leaves the switch slowly forwards,
//! and lets its controller set the counter to zero at the first zero of the encoder. Then the next
//! axis follows. An axis that presses its switch at the start does not move backwards at all. The
//! homing skips axes whose controllers are synchronised already.
//!
//! | fault | threshold | reason |
//! |---|---|---|
//! | switch expected | lower limit switch, or `LONGEST` | the axis has passed its whole range |
//! | switch expected | not pressed after the pause | the axis has run over its switch |
//! | switch held | upper limit switch, or `CAM` | no cam is longer: the switch hangs |
//! | zero expected | counter set while the switch is pressed | whole revolutions off |
//! | zero expected | `TO_ZERO` behind the switch | the encoder has a zero in each revolution |
//!
//! - in: switches and synchronised bits of an [`ArmReading`]
//! - out: the step of one motor in each period, the `synchronise` bits of the drives, or a fault
//! - source: homing in the sources of the original: the lower arm first, ramps of 10 periods,
//!   coarse speed 15 rad/s (tool roll 25, jaw 250), fine speed 3.5 (25, 100), pauses of 250 and 25
//!   periods, two equal readings of a switch

use super::io::{ArmReading, JAW};
use super::period::Length;
use crate::motion::{AXES, ArmFault};
use std::f64::consts::TAU;

/// Order of the axes, as in the original: from the lower arm to the jaw, then the track and the
/// column.
const ORDER: [usize; AXES + 1] = [2, 3, 4, 5, 6, JAW, 0, 1];
/// Periods of 2 ms in which an axis reaches its speed or stops.
const RAMP: f64 = 10.0;
/// Pauses on the switch and after the zero (periods of 2 ms).
const PAUSES: (u32, u32) = (250, 25);
/// Number of equal readings in a row after which the state of a switch counts.
const DEBOUNCE: u32 = 2;
/// Largest distance from the edge of the switch to the zero of the encoder (rad): a revolution and
/// a margin for the ramp.
const TO_ZERO: f64 = 1.25 * TAU;
/// Time in which an axis at its fine speed passes the longest cam (s).
const CAM: f64 = 20.0;
/// Distance longer than the range of any axis; an axis reaches its limit switch long before (rad).
const LONGEST: f64 = 5000.0;

/// Returns the two speeds at which an axis is homed: coarse towards its switch and fine off the
/// switch (rad/s of the motor).
fn speeds(axis: usize) -> (f64, f64) {
    match axis {
        JAW => (-250.0, 100.0),
        6 => (-25.0, 25.0),
        _ => (-15.0, 3.5),
    }
}

/// Phase of the homing of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Backward motion to the switch.
    Coarse,
    /// Pause on the switch, with the number of periods left.
    Pause(u32),
    /// Forward motion off the switch.
    Leave,
    /// Forward motion behind the switch, until the zero of the encoder.
    Zero,
    /// Pause after the zero, with the number of periods left.
    Rest(u32),
}

/// Homing of one arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Homing {
    /// Index in [`ORDER`].
    next: usize,
    has_track: bool,
    phase: Phase,
    /// Speed of the set value (rad/s).
    speed: f64,
    /// Distance of the set value in this phase (rad).
    travelled: f64,
    /// Last reading of the switch, and the number of equal readings in a row.
    switch: (bool, u32),
    /// Length of a period (s), and numbers of periods of a ramp and of the pauses.
    seconds: f64,
    ramp: f64,
    pauses: (u32, u32),
}

/// Action of an arm in one period of its homing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HomingStep {
    /// Axis that is being homed; [`JAW`] is the jaw.
    pub axis: usize,
    /// Step of its set value (rad of the motor).
    pub step: f64,
    /// Bits of [`super::io::ArmDrive::synchronise`].
    pub synchronise: u8,
    /// Whether the axis was synchronised in this period: its counter jumped, and its set value must
    /// follow.
    pub zeroed: bool,
}

/// Readings of the axis that is being homed.
struct Seen {
    axis: usize,
    /// State of its synchronisation switch, once that is known.
    pressed: Option<bool>,
    /// States of its limit switches.
    at_lower: bool,
    at_upper: bool,
    synchronised: bool,
}

impl Homing {
    /// Makes the homing of an arm, before its first step.
    #[must_use]
    pub fn new(has_track: bool, period: Length) -> Self {
        Self {
            seconds: period.seconds(),
            ramp: (RAMP / period.ratio()).max(1.0),
            pauses: (period.count(PAUSES.0), period.count(PAUSES.1)),
            next: 0,
            has_track,
            phase: Phase::Coarse,
            speed: 0.0,
            travelled: 0.0,
            switch: (false, 0),
        }
    }

    /// Runs one period of the homing. Returns the step of the axis that is being homed, or `None`
    /// when all axes are synchronised.
    ///
    /// # Errors
    /// [`ArmFault::SwitchExpected`], [`ArmFault::SwitchHeld`] or [`ArmFault::ZeroExpected`] if the
    /// axis does not find its switch, does not leave it, or finds no encoder zero behind it.
    pub fn step(&mut self, reading: &ArmReading) -> Result<Option<HomingStep>, ArmFault> {
        // The next axis begins with an unknown switch: readings of another axis do not count.
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
            Phase::Pause(left) => self.pause(left, &seen)?,
            Phase::Leave => self.leave_switch(&seen)?,
            Phase::Zero => self.seek_zero(&seen)?,
            Phase::Rest(left) => {
                // The check above takes the next axis when this is 0.
                self.phase = Phase::Rest(left.saturating_sub(1));
                0.0
            }
        };
        let zeroed = before == Phase::Zero && matches!(self.phase, Phase::Rest(_));
        let (coarse, fine) = speeds(axis);
        // Both speeds use the ramp that takes the larger one to rest in `RAMP` periods.
        let change = coarse.abs().max(fine) / self.ramp;
        self.speed += (goal - self.speed).clamp(-change, change);
        let step = self.speed * self.seconds;
        self.travelled += step;
        // The bit is set before the switch opens, so that the controller takes the first zero
        // behind the switch, even one that is right behind it.
        let synchronise = if matches!(self.phase, Phase::Leave | Phase::Zero) { bit } else { 0 };
        Ok(Some(HomingStep { axis, step, synchronise, zeroed }))
    }

    /// Runs a period of the motion backwards until the switch is pressed. Returns the wanted speed
    /// (rad/s).
    fn seek_switch(&mut self, seen: &Seen) -> Result<f64, ArmFault> {
        match seen.pressed {
            Some(true) => {
                self.enter(Phase::Pause(self.pauses.0));
                Ok(0.0)
            }
            // The state of the switch is not known yet. An axis that presses it must not move any
            // further onto it.
            None if self.travelled == 0.0 => Ok(0.0),
            pressed => {
                // An axis may start on its upper limit switch, so that is no fault. At the lower
                // one the cam may press the synchronisation switch, so its state must be known.
                let at_limit = seen.at_lower && pressed == Some(false);
                if at_limit || self.travelled.abs() > LONGEST {
                    return Err(self.switch_expected(seen));
                }
                Ok(speeds(seen.axis).0)
            }
        }
    }

    /// Runs a period of the pause on the switch, of which `left` periods are left. Returns the
    /// wanted speed (rad/s).
    fn pause(&mut self, left: u32, seen: &Seen) -> Result<f64, ArmFault> {
        if left > 0 {
            self.phase = Phase::Pause(left - 1);
            return Ok(0.0);
        }
        // The axis has run over its switch and would not know on which side it is.
        if seen.pressed != Some(true) {
            return Err(self.switch_expected(seen));
        }
        self.enter(Phase::Leave);
        Ok(speeds(seen.axis).1)
    }

    /// Runs a period of the slow motion forwards off the switch. Returns the wanted speed (rad/s).
    fn leave_switch(&mut self, seen: &Seen) -> Result<f64, ArmFault> {
        let (axis, travelled) = (seen.axis, self.travelled);
        let fine = speeds(axis).1;
        // A zero that the controller took on the switch is whole revolutions off.
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

    /// Runs a period of the motion from the switch to the encoder's zero, where the controller sets
    /// its counter to zero. Returns the wanted speed (rad/s).
    fn seek_zero(&mut self, seen: &Seen) -> Result<f64, ArmFault> {
        let (axis, travelled) = (seen.axis, self.travelled);
        if seen.synchronised {
            self.enter(Phase::Rest(self.pauses.1));
            return Ok(0.0);
        }
        if travelled > TO_ZERO {
            return Err(ArmFault::ZeroExpected { axis, travelled });
        }
        Ok(speeds(axis).1)
    }

    /// Returns the fault of an axis that has not found its switch.
    fn switch_expected(&self, seen: &Seen) -> ArmFault {
        ArmFault::SwitchExpected { axis: seen.axis, travelled: self.travelled.abs() }
    }

    /// Returns the axis to home in this period; `None` if none is left. Skips axes that the arm
    /// does not have and those that are synchronised already.
    fn axis(&mut self, reading: &ArmReading) -> Option<usize> {
        while let Some(&axis) = ORDER.get(self.next) {
            // An axis that has begun stays, although its synchronised bit rises before its pause.
            let begun = self.phase != Phase::Coarse || self.travelled != 0.0;
            let absent = axis == 0 && !self.has_track;
            if begun || !(absent || reading.synchronised & (1 << axis) != 0) {
                return Some(axis);
            }
            self.next += 1;
        }
        None
    }

    /// Begins a phase of the homing of an axis, and measures its distance from here.
    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.travelled = 0.0;
    }

    /// Returns whether the switch is pressed, or `None` until [`DEBOUNCE`] equal readings have come
    /// in a row.
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

    /// Axis that follows its set value exactly, with a switch and an encoder.
    struct Axis {
        /// Position of the motor (rad).
        at: f64,
        /// Positions between which the cam presses the switch (rad).
        cam: (f64, f64),
        has_zero: bool,
        /// Whether the controller takes a zero while the switch is pressed.
        is_early: bool,
        /// Bit mask of the synchronised axes.
        synchronised: u8,
        /// Speed of the set value in each period (rad/s).
        log: Vec<f64>,
    }

    impl Axis {
        /// Makes axis 4 at the position `at` (rad), with a cam from -30 to -3 rad; all other axes
        /// are synchronised.
        fn new(at: f64) -> Self {
            Self {
                at,
                cam: (-30.0, -3.0),
                has_zero: true,
                is_early: false,
                synchronised: !(1 << 4),
                log: Vec::new(),
            }
        }

        /// Runs the homing with this simulated axis until it ends or reports a fault.
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
                let pressed = (self.cam.0..self.cam.1).contains(&self.at);
                if step.synchronise != 0 && zero && (self.is_early || !pressed) {
                    self.synchronised |= step.synchronise;
                }
            }
            panic!("the axis never arrives");
        }
    }

    #[test]
    fn axis_ends_at_encoder_zero_behind_its_switch() {
        for start in [120.0, 70.0, 0.2, -20.0] {
            let mut axis = Axis::new(start);

            axis.home().unwrap();

            assert!((0.0..0.2).contains(&axis.at), "{}", axis.at);
            assert!(axis.log.iter().all(|v| (-15.01..=3.51).contains(v)));
            let change = axis.log.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
            assert!(change < 1.51, "speeds are ramped: {change}");
        }
    }

    #[test]
    fn axis_that_starts_at_lower_limit_moves_forwards() {
        let mut axis = Axis { cam: (-100.0, -3.0), ..Axis::new(-65.0) };

        axis.home().unwrap();

        assert!((0.0..0.2).contains(&axis.at), "{}", axis.at);
        assert!(axis.log.iter().all(|v| *v >= 0.0), "never further down");
    }

    #[test]
    fn homing_accepts_encoder_zero_close_to_switch() {
        let mut axis = Axis { cam: (-30.0, -0.02), ..Axis::new(20.0) };

        axis.home().unwrap();

        assert!((0.0..0.2).contains(&axis.at), "{}", axis.at);
    }

    #[test]
    fn missing_switch_or_encoder_zero_is_a_fault() {
        let mut no_switch = Axis { cam: (0.0, 0.0), ..Axis::new(20.0) };
        assert!(matches!(
            no_switch.home(),
            Err(ArmFault::SwitchExpected { axis: 4, travelled }) if travelled > 79.0
        ));

        // The axis passes this cam within a period, so no two readings show it.
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
            Err(ArmFault::SwitchHeld { axis: 4, travelled }) if (69.0..71.0).contains(&travelled)
        ));
        // The upper limit switch is at 100 rad.
        let mut stuck = Axis { cam: (-50.0, 200.0), ..Axis::new(60.0) };
        assert!(matches!(
            stuck.home(),
            Err(ArmFault::SwitchHeld { axis: 4, travelled }) if (39.0..41.0).contains(&travelled)
        ));
        // A zero at -6 pi, on the switch, is some revolutions off.
        let mut early = Axis { is_early: true, ..Axis::new(-20.0) };
        assert!(matches!(
            early.home(),
            Err(ArmFault::ZeroExpected { axis: 4, travelled }) if travelled < 2.0
        ));
    }

    #[test]
    fn homing_skips_synchronised_axes_and_missing_track() {
        assert_eq!(Homing::new(true, Length::default()).step(&ArmReading::default()), Ok(None));
        let reading = ArmReading { synchronised: !1, ..ArmReading::default() };
        assert_eq!(Homing::new(false, Length::default()).step(&reading), Ok(None));
        let first = Homing::new(true, Length::default()).step(&reading).unwrap().unwrap();
        assert_eq!(first.axis, 0);
    }
}
