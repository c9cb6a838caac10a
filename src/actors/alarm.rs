//! The alarm: who has panicked. An actor runs under it; whoever waits for it learns of a panic at once, even of an actor
//! that nobody is asking anything.
//!
//! - in: actors' futures
//! - out: the system error of the first one that panics

use super::disturbance::Mishap;
use crate::error::{Error, System};
use std::any::Any;
use std::future::Future;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::sync::{oneshot, watch};

/// What a shell is run under.
#[derive(Debug, Clone)]
pub(super) struct Care {
    /// Where its panic is told.
    pub(super) alarm: Alarm,
    /// What befalls it.
    pub(super) mishap: Arc<Mishap>,
    /// How long an answer may take beyond what it waits for itself.
    pub(super) patience: Duration,
}

impl Care {
    /// Under the wall clock: what it asks may itself wait half a second for a servo.
    pub(super) const PATIENCE: Duration = Duration::from_millis(600);
    /// On the virtual clock, where nobody is late.
    pub(super) const VIRTUAL: Duration = Duration::from_millis(100);
}

impl Default for Care {
    fn default() -> Self {
        let (alarm, mishap) = (Alarm::default(), Arc::default());
        Self { alarm, mishap, patience: Self::PATIENCE }
    }
}

/// The last part of each wait for an answer.
const LAST: Duration = Duration::from_millis(50);

/// The answer, or silence: nothing within `limit`.
pub(super) async fn answer_of<T>(
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

/// A handle on the alarm of a run.
#[derive(Debug, Clone)]
pub(super) struct Alarm(Arc<watch::Sender<Option<Error>>>);

impl Default for Alarm {
    fn default() -> Self {
        Self(Arc::new(watch::channel(None).0))
    }
}

impl Alarm {
    /// Runs an actor as a task.
    pub(super) fn spawn(&self, name: &str, actor: impl Future<Output = ()> + Send + 'static) {
        let (alarm, name) = (self.clone(), name.to_owned());
        tokio::spawn(async move {
            if let Err(why) = Caught(Box::pin(actor)).await {
                alarm.raise(panicked(&name, &*why));
            }
        });
    }

    /// The first error wins.
    fn raise(&self, error: Error) {
        self.0.send_if_modified(|first| {
            let is_first = first.is_none();
            first.get_or_insert(error);
            is_first
        });
    }

    /// For whoever waits.
    pub(super) fn listen(&self) -> watch::Receiver<Option<Error>> {
        self.0.subscribe()
    }
}

/// Waits for the alarm; for ever when it cannot come any more.
pub(super) async fn raised(listens: &mut watch::Receiver<Option<Error>>) -> Error {
    if let Ok(error) = listens.wait_for(Option::is_some).await
        && let Some(error) = error.clone()
    {
        return error;
    }
    std::future::pending().await
}

/// The error that a panic is.
pub(super) fn panicked(name: &str, why: &(dyn Any + Send)) -> Error {
    let text = why
        .downcast_ref::<&str>()
        .map(|s| (*s).to_owned())
        .or_else(|| why.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "it did not say why".to_owned());
    let cause = System::Panicked { who: name.to_owned(), why: text };
    Error::System { actor: "supervisor".into(), place: "supervise", cause }
}

/// A future whose panic is its output.
pub(super) struct Caught<F>(pub(super) Pin<Box<F>>);

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
        let alarm = Alarm::default();
        let mut listens = alarm.listen();
        alarm.spawn("edp a", async {});
        alarm.spawn("edp b", async { panic!("on purpose {}", 1) });
        alarm.spawn("edp c", async { panic!("later") });

        let error = raised(&mut listens).await.to_string();

        assert_eq!(error, "system, supervisor, supervise: edp b panicked: on purpose 1");
    }
}
