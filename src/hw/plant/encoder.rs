//! Encoder and synchronisation switch of a motor, with the counter of its controller.
//!
//! - in: the true position of the motor, the order to synchronise
//! - out: the counter, the encoder's zero, the switch
//! - the encoder passes a zero once a revolution; the true zero of the motor is one of these. The
//!   switch's cam ends half a revolution below the true zero and reaches down to the end of the
//!   axis, so the switch shows at once on which side of its zero an axis is. The length of the cam
//!   is an assumption: the published sources do not give it.

use std::f64::consts::TAU;

/// Upper end of the switch's cam (rad of the motor).
const EDGE: f64 = -0.5 * TAU;

/// Encoder of a motor, with the counter of its controller.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct Encoder {
    /// Increments per revolution of the motor.
    increments: f64,
    /// True count at which the counter is zero.
    origin: i64,
    /// Whole revolutions at the last reading.
    turn: f64,
    synchronised: bool,
    /// Whether the controller had the order to synchronise in the last period.
    told: bool,
}

/// Report of a controller about its encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Report {
    pub(super) count: i64,
    /// Whether the encoder has passed a zero since the last report.
    pub(super) zero: bool,
    /// Whether the cam presses the switch.
    pub(super) switch: bool,
    pub(super) synchronised: bool,
}

impl Encoder {
    /// Makes an encoder with `increments` per revolution of its motor, which is at `motor` (rad).
    /// Its counter is 0 here, or at motor angle 0 if it is `synchronised` already.
    pub(super) fn new(increments: f64, motor: f64, synchronised: bool) -> Self {
        let origin = if synchronised { 0 } else { count(increments, motor) };
        Self { increments, origin, turn: libm::floor(motor / TAU), synchronised, told: false }
    }

    /// Checks that this saved encoder fits `own`, that of the plant, with the motor at `motor`
    /// (rad).
    pub(super) fn fits(&self, own: &Self, motor: f64) -> bool {
        // The last reading is a period old, so the revolutions may differ; the bound is generous.
        self.increments == own.increments && (self.turn - motor / TAU).abs() < 1e3
    }

    /// Returns what the controller reports of the encoder in this period, with the motor at `motor`
    /// (rad). On the order to `synchronise` the counter becomes 0 at the first encoder zero off the
    /// switch.
    pub(super) fn read(&mut self, motor: f64, synchronise: bool) -> Report {
        let turn = libm::floor(motor / TAU);
        let zero = turn != self.turn;
        // Each new order begins the synchronisation again.
        if synchronise && !self.told {
            self.synchronised = false;
        }
        // The controller waits for the first zero off the switch.
        let switch = motor < EDGE;
        if synchronise && zero && !switch && !self.synchronised {
            // The latch of the counter is exact, however far the motor has moved since the zero.
            self.origin = count(self.increments, turn.max(self.turn) * TAU);
            self.synchronised = true;
        }
        (self.turn, self.told) = (turn, synchronise);
        Report {
            count: count(self.increments, motor) - self.origin,
            zero,
            switch,
            synchronised: self.synchronised,
        }
    }
}

/// Returns the true count at the motor position `motor` (rad).
fn count(increments: f64, motor: f64) -> i64 {
    (motor * increments / TAU).round() as i64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The zero at -2 pi is on the switch, and that at 0 is the first one off it.
    #[test]
    fn encoder_zero_on_the_switch_restarts_no_counter() {
        let mut encoder = Encoder::new(4000.0, -6.5, false);

        let on_switch = encoder.read(-6.0, true);
        let past_switch = encoder.read(-0.02, true);
        let found = encoder.read(0.02, true);

        // 0.5 rad are 318 counts.
        let wanted = Report { count: 318, zero: true, switch: true, synchronised: false };
        assert_eq!(on_switch, wanted);
        assert!(!past_switch.zero && !past_switch.switch && !past_switch.synchronised);
        assert_eq!(found, Report { count: 13, zero: true, switch: false, synchronised: true });
    }

    /// The zero is the same in both directions of the motor.
    #[test]
    fn counter_restarts_at_zero_passed_downwards() {
        let mut encoder = Encoder::new(4000.0, 0.02, false);

        let unasked = encoder.read(-0.01, false);
        encoder.read(0.02, false);
        let found = encoder.read(-0.01, true);

        assert_eq!(unasked, Report { count: -19, zero: true, switch: false, synchronised: false });
        assert_eq!(found, Report { count: -6, zero: true, switch: false, synchronised: true });
    }

    #[test]
    fn counter_restarts_at_first_encoder_zero_past_switch() {
        // 4000 counts a revolution; the motor begins at -5 rad.
        let mut encoder = Encoder::new(4000.0, -5.0, false);
        assert_eq!(
            encoder.read(-5.0, false),
            Report { count: 0, zero: false, switch: true, synchronised: false }
        );

        let leaving = encoder.read(-3.0, false);
        assert!(!leaving.switch && leaving.count == 1273, "2 rad");
        assert!(!encoder.read(-0.01, true).synchronised);
        // The zero is at 0 rad, 12.7 counts back.
        let found = encoder.read(0.02, true);

        assert_eq!(found, Report { count: 13, zero: true, switch: false, synchronised: true });
        assert_eq!(encoder.read(TAU + 0.02, true).count, 4013, "no second restart");
        assert!(
            !Encoder::new(4000.0, 0.0, true).read(1.0, true).synchronised,
            "a new order begins the synchronisation again"
        );
    }
}
