//! The watchdog of a run's actors: it detects a panic at once, and within 0.1 s an actor that stays
//! at one work item, even one that no other actor waits for.
//!
//! - in: actors' futures, and their heartbeats
//! - out: the system error of the first actor that panics or is silent
//!
//! | fault | threshold | reason |
//! |---|---|---|
//! | panic | - | the task of an actor returns the panic of its future |
//! | busy with one work item | `SILENCE` in `SAMPLES` samples | detected within 0.1 s |
//! | no answer to a request | `patience` of [`Supervision`] | the actor may wait for a servo |
//! | all actors blocked | `patience` of the outside watch | no task of the runtime can detect it |
//! | long work of a virtual run | `INLINE` patiences | it blocks all actors and may take long |

use super::fault::ActorFault;
use crate::error::{Error, System, panic_text};
use crate::scenario::keys::Pace;
use std::any::Any;
use std::future::Future;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::sync::{oneshot, watch};

/// The supervision under which an actor runs.
#[derive(Debug, Clone)]
pub(crate) struct Supervision {
    /// Watchdog that reports the actor's panic and silence.
    pub(crate) watchdog: Watchdog,
    /// Fault that is injected into the actor.
    pub(crate) fault: Arc<ActorFault>,
    /// Longest time of an answer beyond the time that the request itself takes.
    pub(crate) patience: Duration,
}

impl Supervision {
    /// Patience under the wall clock: the asked actor may itself wait half a second for a servo.
    const PATIENCE: Duration = Duration::from_millis(600);
    /// Patience under virtual time, where no actor is late.
    const VIRTUAL: Duration = Duration::from_millis(100);

    /// Returns the supervision of a new run, without injected faults. Answers may take longer under
    /// the wall clock than under virtual time.
    pub(crate) fn of(pace: Pace) -> Self {
        let patience = if pace == Pace::Virtual { Self::VIRTUAL } else { Self::PATIENCE };
        Self { watchdog: Watchdog::default(), fault: Arc::default(), patience }
    }
}

impl Default for Supervision {
    fn default() -> Self {
        Self::of(Pace::RealTime)
    }
}

/// Length of the last part of each wait for an answer, see [`within`].
const LAST: Duration = Duration::from_millis(50);

/// Awaits `future` for at most `limit`; returns `None` if it takes longer. A jump of the clock ends
/// the first part of the wait at once although the other side is in order. The `last` part starts
/// after the jump and gives it time to answer.
pub(crate) async fn within<T>(
    limit: Duration,
    last: Duration,
    future: impl Future<Output = T>,
) -> Option<T> {
    let mut future = std::pin::pin!(future);
    let last = last.min(limit);
    match tokio::time::timeout(limit.saturating_sub(last), &mut future).await {
        Ok(result) => Some(result),
        Err(_) => tokio::time::timeout(last, future).await.ok(),
    }
}

/// Waits for the answer of the actor `who` to a request, at most for `limit`, or without a limit if
/// it is `None`. `place` names the request in an error.
///
/// # Errors
/// System when the actor is silent for longer or its mailbox is closed; otherwise the answer's own.
pub(crate) async fn answer_of<T>(
    who: &str,
    place: &'static str,
    limit: Option<Duration>,
    answer: oneshot::Receiver<Result<T, Error>>,
) -> Result<T, Error> {
    let error = |cause| Error::System { actor: who.to_owned(), place: place.into(), cause };
    let answer = match limit {
        None => answer.await,
        Some(limit) => within(limit, LAST, answer).await.ok_or_else(|| {
            error(System::Silent { who: who.to_owned(), seconds: limit.as_secs_f64() })
        })?,
    };
    answer.map_err(|_| error(System::Closed(who.to_owned())))?
}

/// The heartbeat of an actor: a counter that rises with each work item. It is odd while the actor
/// is busy and even while it waits for others, which have limits of their own.
#[derive(Debug, Clone, Default)]
pub(crate) struct Heartbeat(Arc<AtomicU64>);

impl Heartbeat {
    /// Records that the actor begins a work item.
    pub(crate) fn works(&self) {
        // A second call within one item changes nothing: the item is still the same.
        self.0.fetch_or(1, Ordering::Relaxed);
    }

    /// Records that the actor waits for others.
    pub(crate) fn waits(&self) {
        if self.at_work().is_some() {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Awaits `other`, the work of another actor, during which this actor counts as waiting.
    /// Begins the next work item afterwards.
    pub(crate) async fn away<T>(&self, other: impl Future<Output = T>) -> T {
        self.waits();
        let answer = other.await;
        self.works();
        answer
    }

    /// Returns the number of the work item under way; `None` while the actor waits.
    fn at_work(&self) -> Option<u64> {
        Some(self.0.load(Ordering::Relaxed)).filter(|beats| beats % 2 == 1)
    }
}

/// Longest time of a work item. It is less than the 0.1 s within which a fault must be detected,
/// since an actor that hangs while it waits becomes busy only at the next macrostep.
const SILENCE: Duration = Duration::from_millis(80);
/// Samples of the heartbeats within [`SILENCE`]. Samples count, not time: on a machine that is
/// suspended no sample is taken, so no actor becomes silent.
const SAMPLES: u32 = 8;

/// Number of patiences of the outside watch after which long work that runs inline counts as hung.
/// This work takes longer than any work item of an actor, and a busy machine may be slow.
const INLINE: u32 = 6;

/// Long work that runs inline, on the thread of all actors: at most one at a time.
#[derive(Debug, Default)]
struct Inline {
    who: Mutex<String>,
    beats: Heartbeat,
}

/// A handle on the watchdog of a run.
#[derive(Debug, Clone)]
pub(crate) struct Watchdog {
    /// First error that was raised.
    first: Arc<watch::Sender<Option<Error>>>,
    /// Name and heartbeat of each actor.
    heartbeats: Arc<Mutex<Vec<(String, Heartbeat)>>>,
    /// Long work that blocks all actors.
    inline: Arc<Inline>,
}

impl Default for Watchdog {
    fn default() -> Self {
        Self {
            first: Arc::new(watch::channel(None).0),
            heartbeats: Arc::default(),
            inline: Arc::default(),
        }
    }
}

/// A watch from a thread outside the runtime, which ends when this value is dropped.
#[derive(Debug)]
pub(crate) struct Outside(Arc<AtomicBool>);

impl Drop for Outside {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

/// The last sample of each heartbeat, with the number of equal samples in a row.
#[derive(Debug, Default)]
struct Samples(Vec<(Option<u64>, u32)>);

impl Samples {
    /// Samples every heartbeat; returns the first actor seen busy with one work item `most` times
    /// in a row.
    fn silent(&mut self, heartbeats: &[(String, Heartbeat)], most: u32) -> Option<String> {
        // Actors may have been created since the last sample.
        self.0.resize(heartbeats.len(), (None, 0));
        for ((name, heartbeat), (was, same)) in heartbeats.iter().zip(&mut self.0) {
            let is = heartbeat.at_work();
            *same = if is.is_some() && is == *was { *same + 1 } else { 0 };
            *was = is;
            if *same + 1 >= most {
                return Some(name.clone());
            }
        }
        None
    }
}

/// Makes the error for the actor `who`, which has been busy with one work item for `time`.
fn silent(who: String, time: Duration) -> Error {
    let cause = System::Silent { who, seconds: time.as_secs_f64() };
    Error::System { actor: "supervisor".into(), place: "watch".into(), cause }
}

/// Makes the error for a node without a sign of life for `time`.
pub(crate) fn silent_node(node: String, time: Duration) -> Error {
    silent(node, time)
}

impl Watchdog {
    /// Runs an actor as a task and reports its panic.
    pub(crate) fn spawn(&self, name: &str, actor: impl Future<Output = ()> + Send + 'static) {
        let (watchdog, name) = (self.clone(), name.to_owned());
        tokio::spawn(async move {
            if let Err(why) = Caught(Box::pin(actor)).await {
                watchdog.raise(panicked(&name, &*why));
            }
        });
    }

    /// Creates the heartbeat of a new actor and watches it from now on.
    pub(crate) fn heartbeat(&self, name: &str) -> Heartbeat {
        let heartbeat = Heartbeat::default();
        self.heartbeats().push((name.to_owned(), heartbeat.clone()));
        heartbeat
    }

    /// Does `work` of the worker `who` on this thread; the watch from outside reports it if it does
    /// not end. `work` must not panic.
    pub(crate) fn watch_inline<T>(&self, who: &str, work: impl FnOnce() -> T) -> T {
        who.clone_into(&mut self.inline.who.lock().unwrap_or_else(PoisonError::into_inner));
        self.inline.beats.works();
        let result = work();
        self.inline.beats.waits();
        result
    }

    /// Returns the name and the heartbeat of the work that runs inline.
    fn inline(&self) -> [(String, Heartbeat); 1] {
        let who = self.inline.who.lock().unwrap_or_else(PoisonError::into_inner).clone();
        [(who, self.inline.beats.clone())]
    }

    /// Locks the heartbeats. A panic under the lock leaves the list intact, so it stays usable.
    fn heartbeats(&self) -> MutexGuard<'_, Vec<(String, Heartbeat)>> {
        self.heartbeats.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until an error has been raised or an actor is silent, and returns that error.
    pub(crate) async fn raised(&self) -> Error {
        let mut listens = self.listen();
        tokio::select! {
            // An error that was raised before comes first, in the same order in every virtual run.
            biased;
            error = raised(&mut listens) => error,
            error = self.silence() => error,
        }
    }

    /// Waits until an actor has been at one work item for [`SILENCE`]. Raises this error and
    /// returns it.
    async fn silence(&self) -> Error {
        let mut samples = Samples::default();
        loop {
            tokio::time::sleep(SILENCE / SAMPLES).await;
            if let Some(who) = samples.silent(&self.heartbeats(), SAMPLES) {
                let error = silent(who, SILENCE);
                self.raise(error.clone());
                return error;
            }
        }
    }

    /// Watches the actors from a thread of its own until the returned value is dropped. An actor
    /// that loops without waiting blocks the runtime, and with it the watchdog's own task. Calls
    /// `report` once, for the first actor that stays at one work item for `patience`, or for long
    /// work that runs inline for [`INLINE`] times as long.
    ///
    /// # Errors
    /// The error of the operating system, if it refuses another thread.
    pub(crate) fn watched_from_outside(
        &self,
        patience: Duration,
        report: impl FnOnce(Error) + Send + 'static,
    ) -> std::io::Result<Outside> {
        let (watchdog, ends) = (self.clone(), Arc::new(AtomicBool::new(false)));
        let over = Arc::clone(&ends);
        let (pause, mut samples) = (SILENCE / SAMPLES, Samples::default());
        let most = (patience.as_secs_f64() / pause.as_secs_f64()).ceil() as u32;
        let mut works = Samples::default();
        std::thread::Builder::new().name("watch".into()).spawn(move || {
            // Once an error has been raised, the run ends by itself.
            while !over.load(Ordering::Acquire) && watchdog.first.borrow().is_none() {
                std::thread::sleep(pause);
                let actor = samples.silent(&watchdog.heartbeats(), most);
                let work = works.silent(&watchdog.inline(), most * INLINE);
                let found = actor.map(|who| silent(who, patience));
                let found = found.or_else(|| Some(silent(work?, patience * INLINE)));
                // The run may have ended during the sleep.
                if let Some(error) = found.filter(|_| !over.load(Ordering::Acquire)) {
                    return report(error);
                }
            }
        })?;
        Ok(Outside(ends))
    }

    /// Reports an error that ends the run. Only the first error counts: later ones follow from it.
    pub(crate) fn raise(&self, error: Error) {
        self.first.send_if_modified(|first| {
            let is_first = first.is_none();
            first.get_or_insert(error);
            is_first
        });
    }

    /// Returns a receiver of the first error.
    pub(crate) fn listen(&self) -> watch::Receiver<Option<Error>> {
        self.first.subscribe()
    }
}

/// Waits for the first error of a watchdog; forever if the watchdog is gone.
pub(crate) async fn raised(listens: &mut watch::Receiver<Option<Error>>) -> Error {
    if let Ok(error) = listens.wait_for(Option::is_some).await
        && let Some(error) = error.clone()
    {
        return error;
    }
    std::future::pending().await
}

/// Returns the error of a panic, with the text of the panic.
pub(crate) fn panicked(name: &str, why: &(dyn Any + Send)) -> Error {
    let cause = System::Panicked { who: name.to_owned(), why: panic_text(why) };
    Error::System { actor: "supervisor".into(), place: "supervise".into(), cause }
}

/// A future whose panic is its output.
pub(crate) struct Caught<F>(pub(crate) Pin<Box<F>>);

impl<F: Future> Future for Caught<F> {
    type Output = Result<F::Output, Box<dyn Any + Send>>;

    /// Polls the inner future, and returns its panic as an error.
    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        // The future may be inconsistent after a panic: it is dropped and never polled again.
        match catch_unwind(AssertUnwindSafe(|| self.0.as_mut().poll(context))) {
            Ok(poll) => poll.map(Ok),
            Err(why) => Poll::Ready(Err(why)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn first_panic_is_reported_with_its_reason() {
        let watchdog = Watchdog::default();
        let mut listens = watchdog.listen();
        watchdog.spawn("edp a", async {});
        watchdog.spawn("edp b", async { panic!("on purpose {}", 1) });
        watchdog.spawn("edp c", async { panic!("later") });

        let error = raised(&mut listens).await.to_string();

        assert_eq!(error, "edp b panicked: on purpose 1 (system, supervisor, supervise)");
    }

    /// An actor that stays at one work item is silent. One that waits is not, nor is one that
    /// finishes each item in time.
    #[tokio::test(start_paused = true)]
    async fn actor_stuck_on_one_work_item_is_reported() {
        let watchdog = Watchdog::default();
        let [waits, works, hangs] =
            ["edp a", "ecp b", "vsp c"].map(|name| watchdog.heartbeat(name));
        waits.works();
        waits.waits();
        let quiet = tokio::time::timeout(Duration::from_secs(1), async {
            tokio::join!(watchdog.silence(), async {
                loop {
                    works.works();
                    tokio::time::sleep(Duration::from_millis(60)).await;
                    works.waits();
                }
            })
        });
        assert!(quiet.await.is_err(), "no actor was silent");

        // Under a paused clock an actor is silent after 80 ms, which the message rounds.
        works.waits();
        hangs.works();
        let begun = tokio::time::Instant::now();
        let error = watchdog.raised().await.to_string();
        assert!(begun.elapsed() <= Duration::from_millis(90), "{:?}", begun.elapsed());
        assert_eq!(error, "no answer from vsp c in 0.1 s (system, supervisor, watch)");
    }

    #[test]
    fn watchdog_thread_reports_a_hanging_actor() {
        let watchdog = Watchdog::default();
        let (waits, hangs) = (watchdog.heartbeat("edp a"), watchdog.heartbeat("mp"));
        let (to, reports) = std::sync::mpsc::channel();
        let report = |to: &std::sync::mpsc::Sender<Error>| {
            let to = to.clone();
            move |error| to.send(error).unwrap()
        };
        waits.works();
        waits.waits();
        let outside =
            watchdog.watched_from_outside(Duration::from_millis(300), report(&to)).unwrap();
        for _ in 0..40 {
            hangs.works();
            std::thread::sleep(Duration::from_millis(15));
            hangs.waits();
        }
        assert!(reports.try_recv().is_err(), "it made progress");
        drop(outside);

        let _outside =
            watchdog.watched_from_outside(Duration::from_millis(300), report(&to)).unwrap();
        hangs.works();
        let begun = std::time::Instant::now();
        let error = reports.recv_timeout(Duration::from_secs(30)).unwrap().to_string();
        // The first sample is up to 10 ms after the beginning.
        let lasted = begun.elapsed().as_millis();
        assert!((280..2500).contains(&lasted), "{lasted} ms");
        assert_eq!(error, "no answer from mp in 0.3 s (system, supervisor, watch)");
    }

    /// Under virtual time the actor that asked for the work counts as waiting, so the heartbeats of
    /// the actors do not show that the work hangs.
    #[test]
    fn watchdog_thread_reports_hanging_inline_work() {
        let watchdog = Watchdog::default();
        let (to, reports) = std::sync::mpsc::channel();
        let report = move |error| to.send(error).unwrap();
        let _outside = watchdog.watched_from_outside(Duration::from_millis(50), report).unwrap();

        assert_eq!(watchdog.watch_inline("the planner", || 7), 7);
        let begun = std::time::Instant::now();
        let error = watchdog.watch_inline("the image worker", || {
            reports.recv_timeout(Duration::from_secs(30)).unwrap().to_string()
        });

        let silent = "no answer from the image worker in 0.3 s (system, supervisor, watch)";
        assert_eq!(error, silent);
        let lasted = begun.elapsed().as_millis();
        assert!((280..2500).contains(&lasted), "{lasted} ms");
    }
}
