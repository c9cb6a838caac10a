//! The witness: holds what was commanded against what the plant did. It belongs to neither side, and neither sees it.
//!
//! - in: whether a turn is commanded and unfinished (MP tells), the layer's true angle (the plant has it)
//! - out: the number of jams, for the summary

use crate::actors::control::Control;
use crate::actors::mp::Turning;
use crate::motion::PERIOD;
use tokio::sync::watch;

/// A layer that moves less than this (rad) ...
const STILL: f64 = 1.0 / 180.0 * std::f64::consts::PI;
/// ... in this time (s), while a turn is commanded, is jammed.
const TIME: f64 = 3.0;

/// Counts jams.
#[derive(Debug)]
pub(super) struct Witness {
    turning: Turning,
    /// While the operator pauses, nothing is commanded.
    control: watch::Receiver<Control>,
    /// The layer's angle and the period when it last moved; `None` between turns.
    moved: Option<(f64, u64)>,
    reported: bool,
    /// Jams so far.
    pub(super) jams: u32,
}

impl Witness {
    /// Listens to MP.
    #[must_use]
    pub(super) fn new(turning: Turning, control: watch::Receiver<Control>) -> Self {
        Self { turning, control, moved: None, reported: false, jams: 0 }
    }

    /// Looks at a period; `angle` is the turning layer's (rad).
    pub(super) fn look(&mut self, period: u64, angle: f64) {
        let commanded = self.turning.is_commanded() && *self.control.borrow() == Control::Running;
        if !commanded {
            (self.moved, self.reported) = (None, false);
            return;
        }
        let (last, since) = *self.moved.get_or_insert((angle, period));
        if (angle - last).abs() > STILL {
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

    #[test]
    fn a_jam_is_a_commanded_layer_that_stands_still_and_counts_once() {
        let turning = Turning::default();
        let (control, will) = watch::channel(Control::Running);
        let mut witness = Witness::new(turning.clone(), will);
        let mut period = 0;
        let mut run = |seconds: f64, speed: f64, witness: &mut Witness| {
            for i in 0..(seconds / PERIOD) as u64 {
                period += 1;
                witness.look(period, speed * i as f64 * PERIOD);
            }
        };
        run(10.0, 0.0, &mut witness);
        assert_eq!(witness.jams, 0, "nothing was commanded");
        turning.tell(true);
        run(4.0, 0.4, &mut witness);
        assert_eq!(witness.jams, 0, "it turned");
        run(8.0, 0.001, &mut witness);
        assert_eq!(witness.jams, 1, "once for each time");
        turning.tell(false);
        run(5.0, 0.0, &mut witness);
        turning.tell(true);
        run(5.0, 0.0, &mut witness);
        assert_eq!(witness.jams, 2);
        turning.tell(false);
        run(0.1, 0.0, &mut witness);
        turning.tell(true);
        control.send_replace(Control::Paused);
        run(5.0, 0.0, &mut witness);
        assert_eq!(witness.jams, 2, "the operator paused");
    }
}
