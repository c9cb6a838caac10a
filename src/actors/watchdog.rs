//! The watchdog of a run's actors: it detects a panic at once, and within 0.1 s an actor that stays
//! at one work item, even an idle one that no other actor waits for.
//!
//! - in: actors' futures, and their heartbeats
//! - out: the system error of the first one that panics or is silent

use super::fault::ActorFault;
use crate::error::{Error, System};
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
    /// Reports its panic.
    pub(crate) watchdog: Watchdog,
    /// The fault that is injected into it.
    pub(crate) fault: Arc<ActorFault>,
    /// How long an answer may take beyond what it waits for itself.
    pub(crate) patience: Duration,
}

impl Supervision {
    /// Under the wall clock: the actor that is asked may itself wait half a second for a servo.
    const PATIENCE: Duration = Duration::from_millis(600);
    /// On the virtual clock, where no actor is late.
    const VIRTUAL: Duration = Duration::from_millis(100);

    /// Returns the supervision of a new run, without faults.
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

/// The last part of each wait for an answer.
const LAST: Duration = Duration::from_millis(50);

/// The answer, or silence: nothing within `limit`.
pub(crate) async fn answer_of<T>(
    who: &str,
    place: &'static str,
    limit: Option<Duration>,
    mut answer: oneshot::Receiver<Result<T, Error>>,
) -> Result<T, Error> {
    let error = |cause| Error::System { actor: who.to_owned(), place, cause };
    let answer = match limit {
        None => answer.await,
        Some(limit) => {
            // A clock that jumps must not make anybody silent: the last part of the wait begins anew.
            let last = LAST.min(limit);
            match tokio::time::timeout(limit.saturating_sub(last), &mut answer).await {
                Ok(answer) => answer,
                Err(_) => tokio::time::timeout(last, answer).await.map_err(|_| {
                    error(System::Silent { who: who.to_owned(), seconds: limit.as_secs_f64() })
                })?,
            }
        }
    };
    answer.map_err(|_| error(System::Closed(who.to_owned())))?
}

/// Whether an actor gets on: odd while it is at its own work, even while it waits for others, who have limits of their own.
#[derive(Debug, Clone, Default)]
pub(crate) struct Heartbeat(Arc<AtomicU64>);

impl Heartbeat {
    /// It begins a piece of its own work.
    pub(crate) fn works(&self) {
        self.0.fetch_or(1, Ordering::Relaxed);
    }

    /// It waits for somebody.
    pub(crate) fn waits(&self) {
        if self.at_work().is_some() {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Waits for somebody, and goes on.
    pub(crate) async fn away<T>(&self, other: impl Future<Output = T>) -> T {
        self.waits();
        let answer = other.await;
        self.works();
        answer
    }

    /// The piece of its own work that it is at.
    fn at_work(&self) -> Option<u64> {
        Some(self.0.load(Ordering::Relaxed)).filter(|beats| beats % 2 == 1)
    }
}

/// How long a piece of an actor's own work may take. Less than the 0.1 s within which a trouble is to be noticed: an actor that
/// hangs is at no work until the next macrostep asks for some.
const SILENCE: Duration = Duration::from_millis(80);
/// Looks, not time: a machine that stands still makes nobody silent.
const LOOKS: u32 = 8;

/// A handle on the watchdog of a run.
#[derive(Debug, Clone)]
pub(crate) struct Watchdog {
    first: Arc<watch::Sender<Option<Error>>>,
    heartbeats: Arc<Mutex<Vec<(String, Heartbeat)>>>,
}

impl Default for Watchdog {
    fn default() -> Self {
        Self { first: Arc::new(watch::channel(None).0), heartbeats: Arc::default() }
    }
}

/// A watch from outside; it ends with this.
#[derive(Debug)]
pub(crate) struct Outside(Arc<AtomicBool>);

impl Drop for Outside {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

/// The last sample of each heartbeat, and how often it was seen in a row.
#[derive(Debug, Default)]
struct Looks(Vec<(Option<u64>, u32)>);

impl Looks {
    /// Samples every heartbeat; returns the first actor seen busy with one work item `most` times
    /// in a row.
    fn silent(&mut self, heartbeats: &[(String, Heartbeat)], most: u32) -> Option<String> {
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

fn silent(who: String, time: Duration) -> Error {
    let cause = System::Silent { who, seconds: time.as_secs_f64() };
    Error::System { actor: "supervisor".into(), place: "watch", cause }
}

impl Watchdog {
    /// Runs an actor as a task.
    pub(crate) fn spawn(&self, name: &str, actor: impl Future<Output = ()> + Send + 'static) {
        let (watchdog, name) = (self.clone(), name.to_owned());
        tokio::spawn(async move {
            if let Err(why) = Caught(Box::pin(actor)).await {
                watchdog.raise(panicked(&name, &*why));
            }
        });
    }

    /// A new actor's heartbeat.
    pub(crate) fn heartbeat(&self, name: &str) -> Heartbeat {
        let heartbeat = Heartbeat::default();
        self.heartbeats().push((name.to_owned(), heartbeat.clone()));
        heartbeat
    }

    fn heartbeats(&self) -> MutexGuard<'_, Vec<(String, Heartbeat)>> {
        self.heartbeats.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Until somebody panics, is silent, or has stopped the arms.
    pub(crate) async fn raised(&self) -> Error {
        let mut listens = self.listen();
        tokio::select! {
            biased;
            error = raised(&mut listens) => error,
            error = self.silence() => error,
        }
    }

    /// Until somebody has been at one piece of its own work for too long, while the others get on.
    async fn silence(&self) -> Error {
        let mut looks = Looks::default();
        loop {
            tokio::time::sleep(SILENCE / LOOKS).await;
            if let Some(who) = looks.silent(&self.heartbeats(), LOOKS) {
                let error = silent(who, SILENCE);
                self.raise(error.clone());
                return error;
            }
        }
    }

    /// Looks after the actors from a thread of its own, as long as it is kept: one that goes round in circles lets none of
    /// their runtime's watches look. Whoever has been at one piece of its own work for so long is told once.
    pub(crate) fn watched_from_outside(
        &self,
        patience: Duration,
        told: impl FnOnce(Error) + Send + 'static,
    ) -> Outside {
        let (watchdog, ends) = (self.clone(), Arc::new(AtomicBool::new(false)));
        let over = Arc::clone(&ends);
        let (pause, mut looks) = (SILENCE / LOOKS, Looks::default());
        let most = (patience.as_secs_f64() / pause.as_secs_f64()).ceil() as u32;
        std::thread::spawn(move || {
            while !over.load(Ordering::Acquire) && watchdog.first.borrow().is_none() {
                std::thread::sleep(pause);
                let who = looks.silent(&watchdog.heartbeats(), most);
                if let Some(who) = who.filter(|_| !over.load(Ordering::Acquire)) {
                    return told(silent(who, patience));
                }
            }
        });
        Outside(ends)
    }

    /// The first error wins.
    pub(crate) fn raise(&self, error: Error) {
        self.first.send_if_modified(|first| {
            let is_first = first.is_none();
            first.get_or_insert(error);
            is_first
        });
    }

    /// For whoever waits.
    pub(crate) fn listen(&self) -> watch::Receiver<Option<Error>> {
        self.first.subscribe()
    }
}

/// Waits for the watchdog; for ever when it cannot come any more.
pub(crate) async fn raised(listens: &mut watch::Receiver<Option<Error>>) -> Error {
    if let Ok(error) = listens.wait_for(Option::is_some).await
        && let Some(error) = error.clone()
    {
        return error;
    }
    std::future::pending().await
}

/// The error that a panic is.
pub(crate) fn panicked(name: &str, why: &(dyn Any + Send)) -> Error {
    let text = why
        .downcast_ref::<&str>()
        .map(|s| (*s).to_owned())
        .or_else(|| why.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "it did not say why".to_owned());
    let cause = System::Panicked { who: name.to_owned(), why: text };
    Error::System { actor: "supervisor".into(), place: "supervise", cause }
}

/// A future whose panic is its output.
pub(crate) struct Caught<F>(pub(crate) Pin<Box<F>>);

impl<F: Future> Future for Caught<F> {
    type Output = Result<F::Output, Box<dyn Any + Send>>;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        // What panicked is not polled again, and what it left behind is dropped.
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
    async fn a_panic_is_told_with_name_and_reason_and_only_the_first() {
        let watchdog = Watchdog::default();
        let mut listens = watchdog.listen();
        watchdog.spawn("edp a", async {});
        watchdog.spawn("edp b", async { panic!("on purpose {}", 1) });
        watchdog.spawn("edp c", async { panic!("later") });

        let error = raised(&mut listens).await.to_string();

        assert_eq!(error, "system, supervisor, supervise: edp b panicked: on purpose 1");
    }

    #[tokio::test(start_paused = true)]
    async fn who_is_at_one_piece_of_work_for_too_long_is_silent_and_who_waits_or_gets_on_is_not() {
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
        assert!(quiet.await.is_err(), "nobody was silent");

        works.waits();
        hangs.works();
        let begun = tokio::time::Instant::now();
        let error = watchdog.raised().await.to_string();
        assert!(begun.elapsed() <= Duration::from_millis(90), "{:?}", begun.elapsed());
        assert_eq!(error, "system, supervisor, watch: no answer from vsp c in 0.1 s");
    }

    #[test]
    fn who_lets_nobody_else_get_on_is_told_watched_from_outside() {
        let watchdog = Watchdog::default();
        let (waits, hangs) = (watchdog.heartbeat("edp a"), watchdog.heartbeat("mp"));
        let (to, told) = std::sync::mpsc::channel();
        let tell = |to: &std::sync::mpsc::Sender<Error>| {
            let to = to.clone();
            move |error| to.send(error).unwrap()
        };
        waits.works();
        waits.waits();
        let outside = watchdog.watched_from_outside(Duration::from_millis(300), tell(&to));
        for _ in 0..40 {
            hangs.works();
            std::thread::sleep(Duration::from_millis(15));
            hangs.waits();
        }
        assert!(told.try_recv().is_err(), "it got on");
        drop(outside);

        let _outside = watchdog.watched_from_outside(Duration::from_millis(300), tell(&to));
        hangs.works();
        let error = told.recv_timeout(Duration::from_secs(30)).unwrap().to_string();
        assert_eq!(error, "system, supervisor, watch: no answer from mp in 0.3 s");
    }
}
