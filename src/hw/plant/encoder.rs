//! Encoder and synchronisation switch of a motor, with the counter of its controller.
//!
//! - in: the true position of the motor, whether its controller is to synchronise
//! - out: the counter, the encoder's zero, the switch
//! - the zero is passed once a revolution; the true zero of the motor is one of them. The switch's cam reaches
//!   from half a revolution before it all the way down: one look tells on which side an axis stands (an
//!   assumption: the published sources do not tell its length)

use std::f64::consts::TAU;

/// Where the cam ends (rad of the motor).
const EDGE: f64 = -0.5 * TAU;

#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct Encoder {
    increments: f64,
    /// True count where the counter is zero.
    origin: i64,
    /// Whole revolutions at the last reading.
    turn: f64,
    synchronised: bool,
    /// Whether the controller was told to synchronise in the last period.
    told: bool,
}

/// What a controller reports of its encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Report {
    pub(super) count: i64,
    pub(super) zero: bool,
    pub(super) switch: bool,
    pub(super) synchronised: bool,
}

impl Encoder {
    /// Of a controller that was just switched on, unless it is `synchronised` already.
    pub(super) fn new(increments: f64, motor: f64, synchronised: bool) -> Self {
        let origin = if synchronised { 0 } else { count(increments, motor) };
        Self { increments, origin, turn: libm::floor(motor / TAU), synchronised, told: false }
    }

    /// Whether what was kept of an encoder can be of this one, whose motor is there.
    pub(super) fn fits(&self, own: &Self, motor: f64) -> bool {
        // A revolution more or less: the last reading is of a period before.
        self.increments == own.increments && (self.turn - motor / TAU).abs() < 1e3
    }

    /// Once a period.
    pub(super) fn read(&mut self, motor: f64, synchronise: bool) -> Report {
        let turn = libm::floor(motor / TAU);
        let zero = turn != self.turn;
        if synchronise && !self.told {
            self.synchronised = false;
        }
        // The controller waits for the first zero behind the switch.
        let switch = motor < EDGE;
        if synchronise && zero && !switch && !self.synchronised {
            // The latch of the counter is exact, however far the motor went since.
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

fn count(increments: f64, motor: f64) -> i64 {
    (motor * increments / TAU).round() as i64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_counter_begins_anywhere_and_is_latched_at_the_zero_behind_the_switch() {
        let mut encoder = Encoder::new(4000.0, -5.0, false);
        assert_eq!(
            encoder.read(-5.0, false),
            Report { count: 0, zero: false, switch: true, synchronised: false }
        );

        let leaving = encoder.read(-3.0, false);
        assert!(!leaving.switch && leaving.count == 1273);
        assert!(!encoder.read(-0.01, true).synchronised);
        let found = encoder.read(0.02, true);

        assert_eq!(found, Report { count: 13, zero: true, switch: false, synchronised: true });
        assert_eq!(encoder.read(TAU + 0.02, true).count, 4013, "only once");
        assert!(!Encoder::new(4000.0, 0.0, true).read(1.0, true).synchronised, "told anew");
    }
}
