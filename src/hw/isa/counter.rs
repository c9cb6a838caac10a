//! The position of an axis from its card's counter, through synchronisation.
//!
//! - in: the card's count and status once a period, the commands that the axis was told
//! - out: a count that is zero at the synchronisation position, without a jump but at the zero itself
//! - the published sources do not tell whether a card sets its counter to zero by itself at the zero that it tracks,
//!   nor how long it takes to obey `RESET_POSITION`: neither is relied on

use super::registers::{AxisKind, AxisStatus, REVOLUTION};

/// Periods within which a card tells that it counts from the zero that was just found.
const CONFIRMS: u32 = 50;

/// How an axis came to its zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Zero {
    /// As the card says. A resolver's card does not: after a start its axis has none.
    Card,
    /// It has none.
    None,
    /// The next zero is it.
    Awaited,
    /// Found; the card does not say so yet, for so many periods.
    Found(u32),
    /// Found, and the card says so.
    Confirmed,
}

/// A counter.
#[derive(Debug, Clone, Copy)]
pub(super) struct Counter {
    kind: AxisKind,
    /// What is handed out.
    count: i64,
    /// Where the card's counter is when that is zero.
    origin: i64,
    /// How far it went in the last period.
    step: i64,
    zero: Zero,
    /// The card has shown the zero while the resolver could not be read.
    passed: bool,
    /// The card was told to set its counter to zero, and has not done so yet.
    resets: bool,
}

impl Counter {
    pub(super) fn new(kind: AxisKind) -> Self {
        let zero = Zero::Card;
        Self { kind, count: 0, origin: 0, step: 0, zero, passed: false, resets: false }
    }

    /// Takes a period's reading, `None` for a bad one; whether it is the one of the zero.
    pub(super) fn take(&mut self, card: Option<i64>, status: AxisStatus) -> bool {
        self.confirm(status.synchronised);
        // The zero is the first one behind the switch.
        self.passed |= self.zero == Zero::Awaited && status.zero && !status.sync_switch;
        let Some(card) = card else { return false };
        if self.passed {
            self.passed = false;
            self.found(card);
            return true;
        }
        if self.resets {
            let expected = self.count + self.step;
            // The card's counter is nearer to zero than to where it would have gone on.
            if card.abs() < (card - self.origin - expected).abs() {
                self.resets = false;
                self.origin = match self.kind {
                    // An angle within the revolution cannot be set.
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

    fn found(&mut self, card: i64) {
        self.origin = match self.kind {
            AxisKind::Resolver => {
                let half = REVOLUTION / 2;
                card - ((card + half).rem_euclid(REVOLUTION) - half)
            }
            // The card has set its counter to zero by itself.
            AxisKind::Encoder { .. } if card.abs() < (card - self.origin - self.count).abs() => 0,
            AxisKind::Encoder { .. } => card,
        };
        self.count = card - self.origin;
        self.zero = Zero::Found(0);
    }

    fn confirm(&mut self, says: bool) {
        self.zero = match self.zero {
            Zero::Found(_) | Zero::Confirmed if self.kind == AxisKind::Resolver => return,
            Zero::Found(_) if says => Zero::Confirmed,
            Zero::Found(periods) if periods < CONFIRMS => Zero::Found(periods + 1),
            Zero::Found(_) => Zero::None,
            Zero::Confirmed if !says => Zero::None,
            zero => zero,
        };
    }

    /// How the card's counter stands off from the one handed out.
    pub(super) fn is_off(&self) -> bool {
        self.origin != 0
    }

    /// The axis is to be synchronised anew.
    pub(super) fn forget(&mut self) {
        self.zero = Zero::None;
    }

    /// The card was told to track its zero.
    pub(super) fn await_zero(&mut self) {
        (self.zero, self.passed) = (Zero::Awaited, false);
    }

    /// The card was told to track it no more.
    pub(super) fn stop_waiting(&mut self) {
        if self.zero == Zero::Awaited {
            self.zero = Zero::None;
        }
        self.passed = false;
    }

    /// The card was told to set its counter to zero.
    pub(super) fn was_reset(&mut self) {
        self.resets = true;
    }

    pub(super) fn count(&self) -> i64 {
        self.count
    }

    /// Whether its zero was found since the start.
    pub(super) fn is_found(&self) -> bool {
        matches!(self.zero, Zero::Found(_) | Zero::Confirmed)
    }

    pub(super) fn is_synchronised(&self, status: AxisStatus) -> bool {
        match self.zero {
            Zero::Card => self.kind != AxisKind::Resolver && status.synchronised,
            _ => self.is_found(),
        }
    }
}
