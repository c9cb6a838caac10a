//! The operator's control of a run: start, pause, resume, terminate, as one `watch` of which the
//! latest value wins; and the speed of simulated time.

use crate::operator::Input;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// The state in which the operator wants the run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Control {
    /// Not started yet.
    Waiting,
    /// Go on.
    Running,
    /// Hold where it is.
    Paused,
    /// End.
    Terminated,
}

impl Control {
    /// Returns the input that leads to this state; `None` for the first one.
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

/// The run was terminated by the operator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Terminated;

/// Waits while the run is paused; at once otherwise.
///
/// # Errors
/// [`Terminated`].
pub async fn permission(control: &mut watch::Receiver<Control>) -> Result<(), Terminated> {
    loop {
        match *control.borrow_and_update() {
            Control::Running => return Ok(()),
            Control::Terminated => return Err(Terminated),
            Control::Waiting | Control::Paused => {}
        }
        if control.changed().await.is_err() {
            return Err(Terminated);
        }
    }
}

/// How often whoever waits for permission looks at its arms: a stop or a fault must not wait for the operator.
pub(crate) const LOOK: Duration = Duration::from_millis(20);

/// Waits as [`permission`] does, but not for long: `None` when it is time to look at the arms.
pub async fn permission_soon(
    control: &mut watch::Receiver<Control>,
) -> Option<Result<(), Terminated>> {
    tokio::time::timeout(LOOK, permission(control)).await.ok()
}

/// Why time goes as it does for people.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Attended {
    /// It does not.
    #[default]
    No,
    /// The operator moves an arm by hand: as fast as he wants to see it, if he has said so.
    ByHand,
    /// The operator is asked something, and has so many seconds.
    Asked,
}

/// The slowest that simulated time may go (times of real time).
pub const SLOWEST: f64 = 0.01;

/// Whether simulated time may go so fast: 0 for as fast as it computes.
#[must_use]
pub fn is_speed(factor: f64) -> bool {
    factor == 0.0 || factor.is_finite() && factor >= SLOWEST
}

/// How fast simulated time may go. A spectator can slow it down; the events in it stay the same.
#[derive(Debug, Clone, Default)]
pub struct Tempo(Arc<TempoState>);

#[derive(Debug, Default)]
struct TempoState {
    /// Bits of the limit, in times of real time; 0 for none.
    limit: AtomicU64,
    /// The operator is being waited for; [`Attended`] as a number.
    attended: AtomicU8,
    /// For so long the run was held back on purpose (ns).
    held_back: AtomicU64,
}

impl Tempo {
    /// Limits it, in times of real time; 0 for as fast as it computes, and not below [`SLOWEST`].
    pub fn set(&self, factor: f64) {
        let factor = if factor.is_finite() && factor > 0.0 { factor.max(SLOWEST) } else { 0.0 };
        self.0.limit.store(factor.to_bits(), Ordering::Relaxed);
    }

    /// The limit; 0 for none.
    #[must_use]
    pub fn limit(&self) -> f64 {
        f64::from_bits(self.0.limit.load(Ordering::Relaxed))
    }

    /// The run has waited for somebody for so long.
    pub fn held_back(&self, waited: Duration) {
        let nanos = u64::try_from(waited.as_nanos()).unwrap_or(u64::MAX);
        self.0.held_back.fetch_add(nanos, Ordering::Relaxed);
    }

    /// Now, by a clock that stood still while the run waited for its start or time was held back.
    #[must_use]
    pub fn worked(&self) -> Instant {
        let (now, waited) = (Instant::now(), self.0.held_back.load(Ordering::Relaxed));
        now.checked_sub(Duration::from_nanos(waited)).unwrap_or(now)
    }

    /// MP's word for it: the operator is being waited for, and meanwhile time goes as it does for people.
    pub fn attend(&self, attended: Attended) {
        self.0.attended.store(attended as u8, Ordering::Relaxed);
    }
}

/// Holds simulated time back.
#[derive(Debug)]
pub struct Pacer {
    tempo: Tempo,
    control: watch::Receiver<Control>,
    /// Limit, and since when and which time it has been so.
    since: Option<(f64, Instant, f64)>,
}

impl Pacer {
    /// Time by which a run must be ahead before it sleeps (s): a shorter sleep is not worth it.
    const AHEAD: f64 = 0.002;

    /// Listens to the operator.
    #[must_use]
    pub fn new(tempo: Tempo, control: watch::Receiver<Control>) -> Self {
        Self { tempo, control, since: None }
    }

    /// Called when simulated time has come to `time` (s): sleeps when that is too early.
    pub fn hold(&mut self, time: f64) {
        let attended = self.tempo.0.attended.load(Ordering::Relaxed);
        let asked = attended == Attended::Asked as u8;
        let limit = match self.tempo.limit() {
            _ if asked || *self.control.borrow() == Control::Paused => 1.0,
            0.0 if attended == Attended::ByHand as u8 => 1.0,
            limit => limit,
        };
        if limit == 0.0 {
            self.since = None;
            return;
        }
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
            // It does not keep up: what was lost is not made up for.
            self.since = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_is_held_back_to_the_limit_and_not_without_one() {
        let (_control, will) = watch::channel(Control::Running);
        let tempo = Tempo::default();
        let mut pacer = Pacer::new(tempo.clone(), will);
        let run = |pacer: &mut Pacer, from: f64, seconds: f64| {
            let begun = Instant::now();
            for i in 0..=(seconds / 0.002) as u32 {
                pacer.hold(from + f64::from(i) * 0.002);
            }
            begun.elapsed().as_secs_f64()
        };

        assert!(run(&mut pacer, 0.0, 100.0) < 1.0);
        tempo.set(10.0);
        let worked = tempo.worked();
        let took = run(&mut pacer, 100.0, 1.0);
        assert!((0.09..0.5).contains(&took), "{took}");
        let worked = (tempo.worked() - worked).as_secs_f64();
        assert!(worked < took - 0.08, "{worked} of {took}: what it slept is no work");
        tempo.set(0.0);
        for (attended, from) in [(Attended::Asked, 101.0), (Attended::ByHand, 101.1)] {
            tempo.attend(attended);
            let took = run(&mut pacer, from, 0.1);
            assert!((0.09..0.5).contains(&took), "{took}");
        }
        tempo.set(100.0);
        assert!(run(&mut pacer, 101.2, 0.1) < 0.09, "by hand as fast as the operator wants");
        tempo.attend(Attended::Asked);
        assert!(run(&mut pacer, 101.3, 0.1) > 0.09, "a question leaves time to answer");
    }
}
