//! Witness of jams: compares commanded turns with the plant. It belongs to neither the plant nor
//! the controller, and neither sees it.
//!
//! - in: whether a turn is commanded and unfinished, from MP; the layer's true angle, from the
//!   plant
//! - out: the number of jams, for the summary
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | a layer does not move | `STILL` in `TIME` | a turn of 25 deg/s takes 0.04 s for 1 deg |
//! | the operator pauses | - | no motion is commanded meanwhile |

use crate::actors::control::Control;
use crate::actors::mp::Turning;
use crate::motion::PERIOD;
use tokio::sync::watch;

/// Largest motion of a layer that counts as none (rad).
const STILL: f64 = 1.0 / 180.0 * std::f64::consts::PI;
/// Time without motion after which a layer under a commanded turn is jammed (s).
const TIME: f64 = 3.0;

/// Counter of jams.
#[derive(Debug)]
pub(super) struct Witness {
    turning: Turning,
    /// Control of the operator; a paused run commands no motion.
    control: watch::Receiver<Control>,
    /// Angle of the layer (rad) and the period at which it last moved; `None` while no turn is
    /// commanded.
    moved: Option<(f64, u64)>,
    /// Whether the present jam is counted.
    reported: bool,
    /// Number of jams.
    pub(super) jams: u32,
}

impl Witness {
    /// Creates a counter of jams. `turning` is MP's flag of a commanded turn; `control` tells
    /// whether the operator pauses.
    #[must_use]
    pub(super) fn new(turning: Turning, control: watch::Receiver<Control>) -> Self {
        Self { turning, control, moved: None, reported: false, jams: 0 }
    }

    /// Compares the flag of a commanded turn with the plant in a period of 2 ms, and counts a jam
    /// if the layer stands still; `angle` is the true angle of the turning layer (rad).
    pub(super) fn look(&mut self, period: u64, angle: f64) {
        let commanded = self.turning.is_commanded() && *self.control.borrow() == Control::Running;
        if !commanded {
            (self.moved, self.reported) = (None, false);
            return;
        }
        // The first period of a commanded turn: its angle is where the layer begins.
        let (last, since) = *self.moved.get_or_insert((angle, period));
        if (angle - last).abs() > STILL {
            // A layer that moves again ends its jam: the next one counts separately.
            (self.moved, self.reported) = (Some((angle, period)), false);
        } else if !self.reported && (period - since) as f64 * PERIOD > TIME {
            self.jams += 1;
            self.reported = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A layer that rests without a commanded turn, or while the operator pauses, is no jam.
    #[test]
    fn layer_stuck_in_turn_counts_as_one_jam() {
        let turning = Turning::default();
        let (control, will) = watch::channel(Control::Running);
        let mut witness = Witness::new(turning.clone(), will);
        let mut period = 0;
        // Turns the layer at `speed` (rad/s) for `seconds` (s).
        let mut run = |seconds: f64, speed: f64, witness: &mut Witness| {
            for i in 0..(seconds / PERIOD) as u64 {
                period += 1;
                witness.look(period, speed * i as f64 * PERIOD);
            }
        };
        run(10.0, 0.0, &mut witness);
        assert_eq!(witness.jams, 0, "no motion was commanded");
        turning.set(true);
        run(4.0, 0.4, &mut witness);
        assert_eq!(witness.jams, 0, "the layer turned");
        run(8.0, 0.001, &mut witness);
        assert_eq!(witness.jams, 1, "once for each time");
        turning.set(false);
        run(5.0, 0.0, &mut witness);
        turning.set(true);
        run(5.0, 0.0, &mut witness);
        assert_eq!(witness.jams, 2);
        turning.set(false);
        run(0.1, 0.0, &mut witness);
        turning.set(true);
        control.send_replace(Control::Paused);
        run(5.0, 0.0, &mut witness);
        assert_eq!(witness.jams, 2, "the operator paused");
    }
}
