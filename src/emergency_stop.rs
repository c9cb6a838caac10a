//! The emergency stop: its handles, which press, read or release it, and their holders.
//!
//! A press trips all arms in the next servo period. It is a software stop, hence no safety
//! function. It is a flag that the servo reads first in each period, never a message in a queue, so
//! it works even if all actors are dead. The flag stays set until its owner releases it, and the
//! arms stay stopped until each is reset as well.
//!
//! A stop is made in two places. [`Desk::default`](crate::desk::Desk) makes the operator's. A run
//! under virtual time makes a second one behind its gate (`run/gate.rs`), which passes the
//! operator's inputs on between two periods only. There a press counts from the beginning of a
//! period, so the run can be repeated. Under the wall clock the operator's stop is the only one.
//!
//! | handle | may | holders |
//! |---|---|---|
//! | [`EmergencyStop`] | release, make handles | the desk, between two runs |
//! | | | the gate, which never releases |
//! | [`StopButton`] | press | the operator's UIs: page, terminal, keys |
//! | | | the second signal to the process (`run/interrupt.rs`) |
//! | | | the injected fault `emergency_stop` (`run/disturbance.rs`) |
//! | | | the lookout, which finds arms too near or too fast (`actors/lookout.rs`) |
//! | | | the watchdog outside the runtime, when an actor blocks all others (`run/staff.rs`) |
//! | | | the gate, which forwards a press at the desk |
//! | [`StopSignal`] | read | the servo ([`Switches`](crate::hw::driver::Switches)) |
//! | | | the gate |
//! | | | the recorder |
//!
//! The module has a layer of its own below `hw`: the servo's driver, the desk and the actors all
//! use it, and the pure layers must not share mutable state.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// An emergency stop, with the right to release it. Not `Clone`: a stop has one owner.
///
/// ```
/// use rubik_robot::emergency_stop::EmergencyStop;
///
/// let stop = EmergencyStop::default();
/// let (button, signal) = (stop.button(), stop.signal());
/// button.press();
/// assert!(signal.is_pressed());
/// // Only the owner can release it.
/// stop.release();
/// assert!(!signal.is_pressed());
/// ```
#[derive(Debug, Default)]
pub struct EmergencyStop(Arc<AtomicBool>);

impl EmergencyStop {
    /// Returns a handle that can only press.
    #[must_use]
    pub fn button(&self) -> StopButton {
        StopButton(Arc::clone(&self.0))
    }

    /// Returns a handle that can only read.
    #[must_use]
    pub fn signal(&self) -> StopSignal {
        StopSignal(Arc::clone(&self.0))
    }

    /// Releases the stop. The arms stay stopped until each is reset.
    pub fn release(&self) {
        self.0.store(false, Ordering::Release);
    }
}

/// A handle that can press the stop and nothing else. The default handle belongs to a stop of its
/// own, which nothing reads.
#[derive(Debug, Clone, Default)]
pub struct StopButton(Arc<AtomicBool>);

impl StopButton {
    /// Stops all arms in the next servo period. It never waits.
    pub fn press(&self) {
        self.0.store(true, Ordering::Release);
    }
}

/// A handle that can read the stop and nothing else. The default handle belongs to a stop of its
/// own, which nothing can press.
#[derive(Debug, Clone, Default)]
pub struct StopSignal(Arc<AtomicBool>);

impl StopSignal {
    /// Returns whether the stop is pressed. It never waits.
    #[must_use]
    pub fn is_pressed(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stop_stays_pressed_until_its_owner_releases() {
        let stop = EmergencyStop::default();
        let (button, signal) = (stop.button(), stop.signal());
        assert!(!signal.is_pressed());

        button.press();
        drop(button);
        assert!(signal.is_pressed());

        stop.release();
        assert!(!signal.is_pressed());
    }
}
