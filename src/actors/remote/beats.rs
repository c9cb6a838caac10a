//! Beats of one end of a link, and how late they come back.
//!
//! A beat that arrives shows that the other node lives. Only a beat that comes back in time shows
//! that messages do not pile up on their way.

use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// Number of the last beats whose times are kept: those of 2 s.
const KEPT: usize = 100;

/// Beats that one end has sent, and the last one of the other end.
#[derive(Debug, Default)]
pub(super) struct Beats {
    /// Number of the last beat that was sent.
    number: u64,
    sent: VecDeque<(u64, Instant)>,
    /// Number of the last beat that arrived, and the time of its arrival.
    arrived: Option<(u64, Instant)>,
}

impl Beats {
    /// Returns the number of the next beat, which is sent now.
    pub(super) fn next(&mut self) -> u64 {
        self.number += 1;
        if self.sent.len() == KEPT {
            self.sent.pop_front();
        }
        self.sent.push_back((self.number, Instant::now()));
        self.number
    }

    /// Records the arrival of a beat of the other end.
    pub(super) fn arrived(&mut self, number: u64) {
        self.arrived = Some((number, Instant::now()));
    }

    /// Returns the number of the other end's last beat and the time since its arrival (us).
    pub(super) fn echo(&self) -> Option<(u64, u64)> {
        self.arrived.map(|(number, at)| (number, at.elapsed().as_micros() as u64))
    }

    /// Returns the time that an own beat and its echo were on their way. The other end has held the
    /// echo for `held` (us). A beat that is no longer known is older than all others.
    pub(super) fn trip(&self, (number, held): (u64, u64)) -> Duration {
        let sent = self.sent.iter().find(|(sent, _)| *sent == number);
        sent.map_or(Duration::MAX, |(_, at)| {
            at.elapsed().saturating_sub(Duration::from_micros(held))
        })
    }
}
