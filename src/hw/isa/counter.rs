//! The position of an axis from its card's counter, also during synchronisation.
//!
//! - in: the card's count and status once a period, and the commands that were sent to the axis
//! - out: a count that is zero at the synchronisation position. It jumps at the zero itself and
//!   nowhere else
//!
//! The published sources leave open whether a card sets its counter to zero by itself at the zero
//! that it tracks, and how long it takes to obey `RESET_POSITION`. The code works in all cases: it
//! finds from the count itself whether the card's counter was set to zero.

use super::registers::{AxisKind, AxisStatus, REVOLUTION};

/// Periods within which a card confirms that it counts from the zero that was just found.
const CONFIRMS: u32 = 50;

/// Knowledge about the zero of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Zero {
    /// State as the card reports it, before the first synchronisation of this run. A resolver's
    /// card reports none, so after a start its axis has no zero.
    Card,
    /// No zero.
    None,
    /// Search for the next zero.
    Awaited,
    /// Zero that was found this number of periods ago, and that the card has not confirmed yet.
    Found(u32),
    /// Zero that the card has confirmed.
    Confirmed,
}

/// The counter of an axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Counter {
    kind: AxisKind,
    /// Count that the servo reads.
    count: i64,
    /// Count of the card at which `count` is zero.
    origin: i64,
    /// Step of the last period.
    step: i64,
    zero: Zero,
    /// Whether the card has shown the zero while the resolver could not be read.
    passed: bool,
    /// Whether the card was ordered to set its counter to zero and has not done so yet.
    resets: bool,
}

impl Counter {
    /// Makes the counter of an axis of this kind, before the first reading of the card.
    pub(super) fn new(kind: AxisKind) -> Self {
        let zero = Zero::Card;
        Self { kind, count: 0, origin: 0, step: 0, zero, passed: false, resets: false }
    }

    /// Processes a period's reading of the card: its count, `None` if a resolver could not be read,
    /// and its status. Returns whether the search for the zero ends with this reading.
    pub(super) fn take(&mut self, card: Option<i64>, status: AxisStatus) -> bool {
        self.confirm(status.synchronised);
        // Each revolution has a zero. The one that counts is the first one off the switch.
        self.passed |= self.zero == Zero::Awaited && status.zero && !status.sync_switch;
        let Some(card) = card else { return false };
        if self.passed {
            self.passed = false;
            self.found(card);
            return true;
        }
        if self.resets {
            // The count that a counter without a reset would show now. A counter that is nearer to
            // zero than to this count has been reset.
            let expected = self.count + self.step;
            if card.abs() < (card - self.origin - expected).abs() {
                self.resets = false;
                self.origin = match self.kind {
                    // The angle within a revolution is absolute: a reset changes whole revolutions
                    // only.
                    AxisKind::Resolver => {
                        let revolutions = (card - expected) as f64 / REVOLUTION as f64;
                        REVOLUTION * revolutions.round() as i64
                    }
                    AxisKind::Encoder { .. } => card - expected,
                };
            }
        }
        let count = card - self.origin;
        (self.step, self.count) = (count - self.count, count);
        false
    }

    /// Sets the axis's zero to the zero of the encoder or resolver that was found at the card's
    /// count `card`.
    fn found(&mut self, card: i64) {
        self.origin = match self.kind {
            // The zero of a resolver is at the angle 0, which is up to half a revolution away.
            AxisKind::Resolver => {
                let half = REVOLUTION / 2;
                card - ((card + half).rem_euclid(REVOLUTION) - half)
            }
            // A count nearer to zero than to the last one: the card has set its counter to zero by
            // itself.
            AxisKind::Encoder { .. } if card.abs() < (card - self.origin - self.count).abs() => 0,
            AxisKind::Encoder { .. } => card,
        };
        self.count = card - self.origin;
        self.zero = Zero::Found(0);
    }

    /// Updates the state of the zero by whether the card reports the axis as `synchronised`.
    fn confirm(&mut self, synchronised: bool) {
        self.zero = match self.zero {
            // The card of a resolver has no bit that confirms a zero.
            Zero::Found(_) | Zero::Confirmed if self.kind == AxisKind::Resolver => return,
            Zero::Found(_) if synchronised => Zero::Confirmed,
            // The card confirms only after the end of its tracking, some periods later.
            Zero::Found(periods) if periods < CONFIRMS => Zero::Found(periods + 1),
            // The card has not confirmed the zero in time, or has lost a confirmed one.
            Zero::Found(_) => Zero::None,
            Zero::Confirmed if !synchronised => Zero::None,
            zero => zero,
        };
    }

    /// Returns whether the card's counter has another origin than the counter that the servo reads.
    pub(super) fn is_off(&self) -> bool {
        self.origin != 0
    }

    /// Forgets the zero, because the axis is about to be synchronised again.
    pub(super) fn forget(&mut self) {
        self.zero = Zero::None;
    }

    /// Begins the search for the zero: the card was ordered to track it.
    pub(super) fn await_zero(&mut self) {
        (self.zero, self.passed) = (Zero::Awaited, false);
    }

    /// Ends the search for the zero: the card was ordered to stop tracking it.
    pub(super) fn stop_waiting(&mut self) {
        if self.zero == Zero::Awaited {
            self.zero = Zero::None;
        }
        self.passed = false;
    }

    /// Expects a jump of the card's counter, which was ordered to become zero.
    pub(super) fn was_reset(&mut self) {
        self.resets = true;
    }

    /// Returns the count that the servo reads (increments).
    pub(super) fn count(&self) -> i64 {
        self.count
    }

    /// Returns whether this run has found the zero of the axis and the card has not lost it since.
    pub(super) fn is_found(&self) -> bool {
        matches!(self.zero, Zero::Found(_) | Zero::Confirmed)
    }

    /// Returns whether the axis has a zero: one that this run has found, or before the first
    /// synchronisation of this run one that the card reports in `status`.
    pub(super) fn is_synchronised(&self, status: AxisStatus) -> bool {
        match self.zero {
            Zero::Card => self.kind != AxisKind::Resolver && status.synchronised,
            _ => self.is_found(),
        }
    }
}
