//! In how many periods the step between two readings of a counter may have come about.
//!
//! - in: periods that pass, missed ones too; readings, when they come
//! - out: the room for the next step; by how much the last reading may be older than it seems
//! - after a gap it is not known at which of its ends the first reading was taken: a device, or a line's answer, may have
//!   stood still with this machine. It shows next to no step, and the one behind it all of the gap's

/// Readings after a gap that may still be as old as the gap.
const FEW: u32 = 4;
/// A gap is this much longer than the period between readings that follow each other, or more. Shorter ones are those of
/// single answers that were missed: what stood still there was not the machine, and what shows in them is believed.
const GAP: f64 = 2.5;

/// Time between the readings of one counter [periods].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Span {
    since: f64,
    older: f64,
    doubts: u32,
}

impl Span {
    /// So much time has passed [periods].
    pub fn pass(&mut self, periods: f64) {
        self.since += periods;
    }

    /// Time since the last reading, if that was as new as it seemed [periods].
    #[must_use]
    pub fn since(&self) -> f64 {
        self.since
    }

    /// By how much the last reading may be older than it seemed [periods].
    #[must_use]
    pub fn older(&self) -> f64 {
        self.older
    }

    /// The most time in which the step to a reading of now can have been made, one period at least [periods].
    #[must_use]
    pub fn room(&self) -> f64 {
        self.since.max(1.0) + self.older
    }

    /// The counter was read. Where the reading `shows` what a gap hid, later ones are as new as they seem.
    pub fn read(&mut self, shows: bool) {
        let gap = self.since - 1.0;
        if shows {
            (self.older, self.doubts) = (0.0, 0);
        } else if gap > GAP {
            (self.older, self.doubts) = (self.older.max(gap), FEW);
        } else {
            self.doubts = self.doubts.saturating_sub(1);
            if self.doubts == 0 {
                self.older = 0.0;
            }
        }
        self.since = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_that_follow_each_other_are_a_period_apart() {
        let mut span = Span::default();
        for _ in 0..3 {
            span.pass(1.0);
            assert_eq!((span.since(), span.room(), span.older()), (1.0, 1.0, 0.0));
            span.read(false);
        }
    }

    #[test]
    fn what_a_gap_hid_may_show_in_one_of_the_next_few_readings() {
        let mut span = Span::default();
        span.pass(8.0);
        assert_eq!(span.room(), 8.0);
        span.read(false);

        let rooms: Vec<_> = (0..6)
            .map(|_| {
                span.pass(1.0);
                let room = span.room();
                span.read(false);
                room
            })
            .collect();

        assert_eq!(rooms, [8.0, 8.0, 8.0, 8.0, 1.0, 1.0]);
    }

    #[test]
    fn once_it_has_shown_nothing_is_left() {
        let mut span = Span::default();
        span.pass(8.0);
        span.read(true);
        span.pass(1.0);

        assert_eq!((span.room(), span.older()), (1.0, 0.0));
    }

    #[test]
    fn a_shorter_gap_soon_after_does_not_make_a_longer_one_forgotten() {
        let mut span = Span::default();
        span.pass(8.0);
        span.read(false);
        span.pass(5.0);
        span.read(false);

        assert_eq!(span.older(), 7.0);
    }
}
