//! The operator's control of a run: start, pause, resume and terminate, as one `watch` whose latest
//! value counts; and the speed of simulated time.

use crate::operator::Input;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// The state in which the operator wants the run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Control {
    /// The run waits for its start.
    Waiting,
    /// The run proceeds.
    Running,
    /// The arms hold where they are.
    Paused,
    /// The run ends.
    Terminated,
}

impl Control {
    /// Returns the input of the operator that brings a run into this state; `None` for `Waiting`,
    /// in which a run begins.
    #[must_use]
    pub fn input(self) -> Option<Input> {
        match self {
            Self::Waiting => None,
            Self::Running => Some(Input::Resume),
            Self::Paused => Some(Input::Pause),
            Self::Terminated => Some(Input::Terminate),
        }
    }
}

/// Error of a wait for the operator: the run was terminated, or no operator is left.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Terminated;

/// Waits while the run is paused or has not been started; returns at once while it proceeds.
///
/// # Errors
/// [`Terminated`] when the operator terminates the run, or when no sender is left.
pub async fn permission(control: &mut watch::Receiver<Control>) -> Result<(), Terminated> {
    loop {
        match *control.borrow_and_update() {
            Control::Running => return Ok(()),
            Control::Terminated => return Err(Terminated),
            Control::Waiting | Control::Paused => {}
        }
        // No sender can resume the run any more.
        if control.changed().await.is_err() {
            return Err(Terminated);
        }
    }
}

/// Time between two checks of the arms by an actor that waits for the operator: a stop or a fault
/// must not wait for a person.
pub(crate) const LOOK: Duration = Duration::from_millis(20);

/// Waits as [`permission`] does, but for 20 ms at most. Returns `None` if the run is still paused
/// then, so that the caller can check the arms for faults.
pub async fn permission_soon(
    control: &mut watch::Receiver<Control>,
) -> Option<Result<(), Terminated>> {
    tokio::time::timeout(LOOK, permission(control)).await.ok()
}

/// Reason for which simulated time must not pass faster than real time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Attended {
    /// No reason: simulated time may pass as fast as the set speed allows.
    #[default]
    No,
    /// The operator moves an arm by hand. If the operator has set a speed, that speed counts
    /// instead of real time.
    ByHand,
    /// A question is open, and the operator has only its time limit to answer.
    Asked,
}

/// Lowest speed of simulated time, as a multiple of real time. At a lower speed the [`Pacer`] would
/// sleep for hours.
pub const SLOWEST: f64 = 0.01;

/// Returns whether `factor` is a valid limit of the speed of simulated time, as a multiple of real
/// time: 0, which stands for no limit, or at least [`SLOWEST`].
#[must_use]
pub fn is_speed(factor: f64) -> bool {
    factor == 0.0 || factor.is_finite() && factor >= SLOWEST
}

/// Limit of the speed of simulated time. A spectator can slow a run down with it; the events of the
/// run stay the same.
#[derive(Debug, Clone, Default)]
pub struct Tempo(Arc<TempoState>);

/// State that all clones of a [`Tempo`] share.
#[derive(Debug, Default)]
struct TempoState {
    /// Bits of the limit, as a multiple of real time; 0 for none.
    limit: AtomicU64,
    /// [`Attended`] as a number.
    attended: AtomicU8,
    /// Time for which the run was held back on purpose (ns).
    held_back: AtomicU64,
}

impl Tempo {
    /// Sets the largest speed of simulated time to `factor`, a multiple of real time. A positive
    /// factor below [`SLOWEST`] is raised to it; 0, a negative or a not finite one means no limit.
    pub fn set(&self, factor: f64) {
        let factor = if factor.is_finite() && factor > 0.0 { factor.max(SLOWEST) } else { 0.0 };
        self.0.limit.store(factor.to_bits(), Ordering::Relaxed);
    }

    /// Returns the largest speed of simulated time, as a multiple of real time; 0 for no limit.
    #[must_use]
    pub fn limit(&self) -> f64 {
        f64::from_bits(self.0.limit.load(Ordering::Relaxed))
    }

    /// Reports that the run has waited for a person, or was slowed down on purpose, for the time
    /// `waited`. [`Tempo::working_time`] leaves this time out.
    pub fn held_back(&self, waited: Duration) {
        // `as_nanos` is 128 bits wide; 64 bits are 584 years.
        let nanos = u64::try_from(waited.as_nanos()).unwrap_or(u64::MAX);
        self.0.held_back.fetch_add(nanos, Ordering::Relaxed);
    }

    /// Returns the present time of a clock that stops while the run waits for its start or is
    /// slowed down. The difference of two such times is the time that the run has worked.
    #[must_use]
    pub fn working_time(&self) -> Instant {
        let (now, waited) = (Instant::now(), self.0.held_back.load(Ordering::Relaxed));
        // An instant cannot lie before the beginning of its clock, which may be the boot.
        now.checked_sub(Duration::from_nanos(waited)).unwrap_or(now)
    }

    /// Sets the reason for which simulated time must not pass faster than real time from now on;
    /// [`Attended::No`] if it may. MP sets it while it waits for an answer or an order of the
    /// operator.
    pub fn attend(&self, attended: Attended) {
        self.0.attended.store(attended as u8, Ordering::Relaxed);
    }
}

/// A limiter that slows simulated time down to the speed limit of a [`Tempo`].
#[derive(Debug)]
pub struct Pacer {
    tempo: Tempo,
    control: watch::Receiver<Control>,
    /// Present limit (multiple of real time), with the moment and the simulated time (s) since
    /// which it counts; `None` without a limit.
    since: Option<(f64, Instant, f64)>,
}

impl Pacer {
    /// Time by which a run must be ahead before it sleeps (s): a shorter sleep is not worth it.
    const AHEAD: f64 = 0.002;

    /// Returns a pacer that keeps the limit of `tempo`. While the operator pauses the run, the
    /// limit is real time.
    #[must_use]
    pub fn new(tempo: Tempo, control: watch::Receiver<Control>) -> Self {
        Self { tempo, control, since: None }
    }

    /// Sleeps if simulated time reaches `time` (s) earlier than the limit allows.
    pub fn hold(&mut self, time: f64) {
        let attended = self.tempo.0.attended.load(Ordering::Relaxed);
        let asked = attended == Attended::Asked as u8;
        let limit = match self.tempo.limit() {
            // Periods go on while a person thinks about a question or a pause: in real time.
            _ if asked || *self.control.borrow() == Control::Paused => 1.0,
            // The operator watches an arm that is moved by hand, unless a speed was set.
            0.0 if attended == Attended::ByHand as u8 => 1.0,
            limit => limit,
        };
        if limit == 0.0 {
            self.since = None;
            return;
        }
        // Another limit counts from now: the time before passed under the old one.
        let (_, begun, from) = match self.since {
            Some(since) if since.0 == limit => since,
            _ => *self.since.insert((limit, Instant::now(), time)),
        };
        let ahead = (time - from) / limit - begun.elapsed().as_secs_f64();
        if ahead > Self::AHEAD {
            let sleeps = Instant::now();
            std::thread::sleep(Duration::from_secs_f64(ahead));
            self.tempo.held_back(sleeps.elapsed());
        } else if ahead < -0.2 {
            // The run computes slower than the limit. It must not race afterwards to catch up.
            self.since = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pacer_keeps_simulated_time_at_speed_limit() {
        let (control, will) = watch::channel(Control::Running);
        let tempo = Tempo::default();
        let mut pacer = Pacer::new(tempo.clone(), will);
        // Lets `seconds` of simulated time pass from the time `from` on (s); returns the real time
        // that this takes (s).
        let run = |pacer: &mut Pacer, from: f64, seconds: f64| {
            let begun = Instant::now();
            for i in 0..=(seconds / 0.002) as u32 {
                pacer.hold(from + f64::from(i) * 0.002);
            }
            begun.elapsed().as_secs_f64()
        };

        assert!(run(&mut pacer, 0.0, 100.0) < 1.0, "no limit");
        // At ten times real time a second takes 0.1 s, and at least 0.09 s after rounding.
        tempo.set(10.0);
        let worked = tempo.working_time();
        let took = run(&mut pacer, 100.0, 1.0);
        assert!((0.09..0.5).contains(&took), "{took}");
        let worked = (tempo.working_time() - worked).as_secs_f64();
        assert!(worked < took - 0.08, "{worked} of {took}: sleep does not count as work");
        // Without a limit 0.1 s take as long, because a person attends or pauses the run.
        tempo.set(0.0);
        let watched = [
            (Attended::Asked, Control::Running),
            (Attended::ByHand, Control::Running),
            (Attended::No, Control::Paused),
        ];
        for ((attended, state), from) in watched.into_iter().zip([101.0, 101.1, 101.2]) {
            tempo.attend(attended);
            control.send_replace(state);
            let took = run(&mut pacer, from, 0.1);
            assert!((0.09..0.5).contains(&took), "{attended:?}, {state:?}: {took}");
        }
        control.send_replace(Control::Running);
        tempo.attend(Attended::ByHand);
        tempo.set(100.0);
        assert!(run(&mut pacer, 101.3, 0.1) < 0.09, "motion by hand follows the set speed");
        tempo.attend(Attended::Asked);
        assert!(run(&mut pacer, 101.4, 0.1) > 0.09, "a question leaves time to answer");
    }
}
