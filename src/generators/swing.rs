//! Detection of an oscillation: a component of the wrench that changes its side again and again.
//!
//! A force loop that is late or has too much gain makes an oscillation grow. Its peaks may stay
//! below the force limit for long, and the message of the limit would then name the wrong cause.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | component that counts | `LEAST` | contact pushes to one side, seldom to both |
//! | change of side | within `LONGEST_SWING` | a slower one is a load that comes and goes |
//! | oscillation | `SWINGS` changes in a row | a knock that rings out has fewer |
//!
//! - in: the wrench of each macrostep
//! - out: direction, amplitude and frequency of an oscillation

use super::inputs::Inputs;
use super::outcome::Outcome;
use crate::motion::PERIOD;

/// Smallest excursion that counts, of a force (N) and of a torque (Nm).
const LEAST: [f64; 2] = [5.0, 0.5];
/// Longest time from one side to the other (s).
const LONGEST_SWING: f64 = 0.6;
/// Number of changes of side in a row that are an oscillation.
const SWINGS: u32 = 5;

/// Memory of one arm's wrench, for each direction.
#[derive(Debug, Clone, Copy, Default)]
pub struct Swing([Side; 6]);

/// Recent excursions of one component.
#[derive(Debug, Clone, Copy, Default)]
struct Side {
    /// Side of the last excursion: -1, 1, or 0 before the first one.
    sign: i8,
    /// Largest excursion to either side since the oscillation began (N, Nm).
    amplitude: f64,
    /// Number of changes of side in a row.
    swings: u32,
    /// Periods of the last change of side, and of the first one.
    changed: u64,
    began: u64,
}

impl Side {
    /// Returns [`Outcome::Oscillates`] for a direction, 0..=5, with amplitude (N, Nm) and frequency
    /// (Hz).
    fn outcome(&self, direction: usize) -> Outcome {
        let time = self.changed.saturating_sub(self.began) as f64 * PERIOD;
        // Two changes of side make one period of the oscillation.
        let hertz = f64::from(self.swings) / (2.0 * time.max(PERIOD));
        Outcome::Oscillates(direction, self.amplitude, hertz)
    }
}

impl Swing {
    /// Records the wrench of a macrostep. Returns the oscillation if a component of the wrench has
    /// changed its sign often enough.
    pub fn note(&mut self, inputs: &Inputs<'_>) -> Option<Outcome> {
        let wrench = inputs.arm.wrench_in_tool.directions();
        for (direction, (side, value)) in self.0.iter_mut().zip(wrench).enumerate() {
            if value.abs() < LEAST[direction / 3] {
                continue;
            }
            let sign = if value > 0.0 { 1 } else { -1 };
            let since = inputs.period.saturating_sub(side.changed) as f64 * PERIOD;
            if sign != side.sign {
                // A late change of side is the first one of a new oscillation.
                let goes_on = side.sign != 0 && since < LONGEST_SWING;
                let before =
                    if goes_on { *side } else { Side { began: inputs.period, ..Side::default() } };
                *side = Side {
                    sign,
                    swings: before.swings + u32::from(goes_on),
                    changed: inputs.period,
                    ..before
                };
            } else if since > LONGEST_SWING {
                // The component stays on this side, so the oscillation has come to rest.
                (side.swings, side.amplitude) = (0, 0.0);
            }
            side.amplitude = side.amplitude.max(value.abs());
            if side.swings >= SWINGS {
                return Some(side.outcome(direction));
            }
        }
        None
    }

    /// Returns the oscillation of a direction whose force or torque has just changed its sign, else
    /// `None`. It replaces an over-force in this direction as the cause that is reported: a load
    /// that only grows keeps its sign.
    #[must_use]
    pub fn swinging(&self, direction: usize) -> Option<Outcome> {
        let side = self.0.get(direction)?;
        (side.swings > 0).then(|| side.outcome(direction))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::ArmState;
    use crate::spatial::Wrench;

    /// Applies the force along z (N) that `force` returns for a time (s), over 4 s in macrosteps of
    /// 16 ms. Returns the oscillation that was detected, if any.
    fn run(force: impl Fn(f64) -> f64) -> Option<Outcome> {
        let mut swing = Swing::default();
        (0..250).find_map(|step| {
            let period = step * 8;
            let wrench_in_tool =
                Wrench::from_directions([0.0, 0.0, force(period as f64 * PERIOD), 0.0, 0.0, 0.0]);
            let arm = ArmState { wrench_in_tool, ..ArmState::default() };
            swing.note(&Inputs { arm: &arm, target: None, reading: None, period, pace: 1.0 })
        })
    }

    #[test]
    fn oscillation_is_reported_with_its_frequency() {
        let outcome = run(|t| 16.0 * (2.8 * std::f64::consts::TAU * t).sin());

        let Some(Outcome::Oscillates(2, amplitude, hertz)) = outcome else {
            panic!("{outcome:?}");
        };
        assert!((amplitude - 16.0).abs() < 0.5 && (hertz - 2.8).abs() < 0.3, "{amplitude} {hertz}");
    }

    #[test]
    fn contact_and_slow_loads_are_no_oscillation() {
        assert_eq!(run(|t| if t > 1.0 { 12.0 } else { 0.0 }), None);
        assert_eq!(run(|t| 4.5 * (3.0 * std::f64::consts::TAU * t).sin()), None);
        assert_eq!(run(|t| 15.0 * (0.5 * std::f64::consts::TAU * t).sin()), None);
        // A knock that rings out is no oscillation either.
        assert_eq!(
            run(|t| 20.0 * (-6.0 * t).exp() * (3.0 * std::f64::consts::TAU * t).sin()),
            None
        );
    }
}
