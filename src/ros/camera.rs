//! A camera whose pictures come by a topic of ROS 2.
//!
//! - in: messages `sensor_msgs/Image` (rgb8, bgr8, mono8) or `sensor_msgs/CompressedImage` (JPEG,
//!   PNG)
//! - out: frames with the servo period of their exposure
//!
//! The sender stamps its pictures by its own clock, which may differ from ours or be that of a
//! simulation. The difference is estimated as for a camera behind a socket: the picture that was on
//! its way for the shortest time shows it best. Here no picture is exposed after its arrival, so
//! the smallest difference counts, and the shortest way counts as none.
//!
//! | fault | limit | consequence |
//! |---|---|---|
//! | no new picture | [`PATIENCE`] | error; the sensor reports a silent camera |
//! | wrong type, encoding or size, malformed message | - | error with the reason |
//! | picture without a stamp | stamp 0 | its arrival counts |

use super::listener::Listener;
use super::messages::{Picture, kind_of_pictures, picture};
use crate::hw::camera::{Frame, FrameSource, NoFrame};
use crate::motion::PERIOD;
use crate::net::RosPlace;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Longest wait for a new picture.
const PATIENCE: Duration = Duration::from_secs(1);
/// Number of recent pictures from which the difference of the clocks is estimated. Older ones are
/// dropped because the clocks drift.
const PICTURES: usize = 50;

/// Estimate of the difference between the servo's clock and the sender's (periods).
#[derive(Debug, Clone, Default)]
struct Difference(VecDeque<i64>);

impl Difference {
    /// Converts the stamp of a picture (ns of the sender's clock) to a servo period, and takes the
    /// picture into the estimate. It arrived in the servo period `arrived`.
    fn ours(&mut self, arrived: u64, stamp: u64) -> u64 {
        if stamp == 0 {
            return arrived;
        }
        let theirs = (stamp as f64 * 1e-9 / PERIOD) as i64;
        // A sender may give any stamp, so the difference wraps.
        let seen = (arrived as i64).wrapping_sub(theirs);
        if self.0.len() == PICTURES {
            self.0.pop_front();
        }
        self.0.push_back(seen);
        let best = self.0.iter().copied().min().unwrap_or(seen);
        // A clock that was set back must not make a picture newer than its arrival.
        (theirs.wrapping_add(best).max(0) as u64).min(arrived)
    }
}

/// A camera whose pictures come by a topic.
#[derive(Debug)]
pub struct RosCamera {
    name: String,
    listener: Listener,
    /// Size of the pictures (px); any if `None`.
    size: Option<(u32, u32)>,
    /// Number of the last message.
    last: u64,
    /// Whether none came in time after that. A silent sender is not waited for again: the wait
    /// would hold up a simulated run.
    silent: bool,
    difference: Difference,
}

impl RosCamera {
    /// Subscribes to the pictures of a topic. `name` is that of the camera in messages, `size` that
    /// of its pictures (px).
    ///
    /// # Errors
    /// [`NoFrame`] with the reason.
    pub fn open(
        name: &str,
        place: &RosPlace,
        topic: &str,
        size: Option<(u32, u32)>,
    ) -> Result<Self, NoFrame> {
        let refuse = |reason| NoFrame { camera: name.to_owned(), reason };
        let listener = Listener::open(place, topic, kind_of_pictures(topic)).map_err(refuse)?;
        let difference = Difference::default();
        Ok(Self { name: name.to_owned(), listener, size, last: 0, silent: false, difference })
    }

    /// Returns the error of this camera with a reason.
    fn refuse(&self, reason: &str) -> NoFrame {
        let reason = format!("topic {}: {reason}", self.listener.topic());
        NoFrame { camera: self.name.clone(), reason }
    }
}

impl FrameSource for RosCamera {
    /// Waits for a picture that was not taken yet. The exposure is that of the sender.
    fn grab(&mut self, period: u64, _: f64) -> Result<Frame, NoFrame> {
        let asked = Instant::now();
        let patience = if self.silent { Duration::ZERO } else { PATIENCE };
        let arrived = self.listener.next(self.last, patience);
        self.silent = arrived.is_none();
        let arrived = arrived.ok_or_else(|| {
            self.refuse(&format!("no picture for {:.0} s", PATIENCE.as_secs_f64()))
        })?;
        self.last = arrived.number;
        let data = arrived.data.map_err(|why| self.refuse(&why))?;
        let Picture { time, image } =
            picture(&arrived.kind, &data, self.size).map_err(|why| self.refuse(&why))?;
        let before = asked.saturating_duration_since(arrived.at).as_secs_f64();
        let after = arrived.at.saturating_duration_since(asked).as_secs_f64();
        let at = period as f64 + (after - before) / PERIOD;
        Ok(Frame { period: self.difference.ours(at.max(0.0) as u64, time), image })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stamps of a clock of its own, in periods of 2 ms.
    fn stamp(periods: u64) -> u64 {
        periods * 2_000_000
    }

    #[test]
    fn shortest_way_sets_difference_of_clocks() {
        let mut difference = Difference::default();

        // The sender's clock is 1000 ahead; the pictures are on their way for 9, 2 and 5 periods.
        assert_eq!(difference.ours(5009, stamp(6000)), 5009);
        assert_eq!(difference.ours(5022, stamp(6020)), 5022);
        assert_eq!(difference.ours(5045, stamp(6040)), 5042, "two periods of the way remain");
        assert_eq!(difference.ours(5060, 0), 5060, "without a stamp the arrival counts");
    }

    #[test]
    fn any_stamp_gives_no_later_period() {
        let mut difference = Difference::default();
        for time in [1, u64::MAX, 1 << 63, 7, stamp(1 << 40)] {
            for arrived in [0, 5000, u64::MAX >> 1] {
                assert!(difference.ours(arrived, time) <= arrived, "{time}");
            }
        }
    }
}
