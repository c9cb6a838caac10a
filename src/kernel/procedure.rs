//! A task that is written as a procedure: an `async fn` that is resumed with each event.
//!
//! The kernel of a task stays pure and synchronous outside: [`Procedure::resume`] takes an event
//! and returns the next action. Inside it is straight-line Rust, and the compiler writes the state
//! machine. No runtime is involved: the future is polled by hand with a waker that does nothing.
//!
//! - in: the event that answers an action, stored behind the [`Port`]
//! - out: the action at whose `.await` the procedure stopped, or the task's end
//!
//! Rules:
//!
//! - A port holds any number of outstanding requests. Each has an id, under which the shell
//!   delivers its answer. The shell carries out one action at a time, in the order in which they
//!   were posted.
//! - Futures are joined in a fixed order ([`both`]), so that a run is repeatable to the bit.
//! - A procedure that waits although nothing is outstanding is a defect of the task. It ends the
//!   task with [`Action::Defect`] and never hangs.
//! - The procedure borrows nothing from outside. All that page, journal or summary show lies behind
//!   the port, since terminating a run drops the procedure together with its locals.

use super::{
    Account, Action, Event, Finish, JournalEntry, Kernel, Picture, Readings, Remark, Thought,
};
use crate::motion::ArmState;
use std::collections::{BTreeMap, VecDeque};
use std::future::{Future, poll_fn};
use std::pin::{Pin, pin};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};

/// Number of a request, unique within its port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct RequestId(u64);

/// The data that a procedure shares with its shell: requests, answers, and a state `S` that both
/// may see. `T` is the input of the kernel's long work, `C` its result.
#[derive(Debug)]
pub struct Port<T, C, S>(Arc<Mutex<Inner<T, C, S>>>);

/// Data of a [`Port`], behind its lock.
#[derive(Debug)]
struct Inner<T, C, S> {
    /// Number of the latest request.
    last_id: u64,
    /// Requests that the shell has not taken yet.
    posted: VecDeque<(RequestId, Action<T>)>,
    /// Requests that the procedure still waits for, each with its answer once that has arrived.
    awaited: BTreeMap<RequestId, Option<Event<C>>>,
    /// State that procedure and shell both see.
    state: S,
}

impl<T, C, S> Clone for Port<T, C, S> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T, C, S> Port<T, C, S> {
    /// Makes a port with this shared state and without requests.
    #[must_use]
    pub fn new(state: S) -> Self {
        let (posted, awaited) = (VecDeque::new(), BTreeMap::new());
        Self(Arc::new(Mutex::new(Inner { last_id: 0, posted, awaited, state })))
    }

    /// Locks the shared data, even if another holder of the lock has panicked.
    fn lock(&self) -> MutexGuard<'_, Inner<T, C, S>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Passes the shared state to `look`, which may read or change it but must not use the port:
    /// the lock is not reentrant.
    pub fn state<R>(&self, look: impl FnOnce(&mut S) -> R) -> R {
        look(&mut self.lock().state)
    }

    /// Makes a request, which is posted when it is first polled. Its output is the event that the
    /// shell delivers for it.
    #[must_use]
    pub fn request(&self, action: Action<T>) -> Request<T, C, S> {
        Request { port: self.clone(), state: RequestState::New(Some(action)) }
    }

    /// Posts a request and returns its id.
    fn post(&self, action: Action<T>) -> RequestId {
        let mut shared = self.lock();
        shared.last_id += 1;
        let id = RequestId(shared.last_id);
        shared.posted.push_back((id, action));
        shared.awaited.insert(id, None);
        id
    }

    /// Takes the oldest request that was posted and not taken yet.
    #[must_use]
    pub fn take_posted(&self) -> Option<(RequestId, Action<T>)> {
        self.lock().posted.pop_front()
    }

    /// Delivers the answer to a request. Drops an answer that the procedure no longer waits for.
    pub fn deliver(&self, id: RequestId, event: Event<C>) {
        if let Some(answer) = self.lock().awaited.get_mut(&id) {
            *answer = Some(event);
        }
    }

    /// Returns whether the procedure waits for a request that has no answer yet.
    fn is_waiting(&self) -> bool {
        self.lock().awaited.values().any(Option::is_none)
    }
}

/// A request of a procedure. Dropping it withdraws the request, or drops its answer.
#[derive(Debug)]
pub struct Request<T, C, S> {
    port: Port<T, C, S>,
    state: RequestState<T>,
}

/// Progress of a [`Request`].
#[derive(Debug)]
enum RequestState<T> {
    /// Not polled yet.
    New(Option<Action<T>>),
    /// Handed to the shell, under this id.
    Posted(RequestId),
}

impl<T: Unpin, C, S> Future for Request<T, C, S> {
    type Output = Event<C>;

    fn poll(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Event<C>> {
        let Self { port, state } = self.get_mut();
        match state {
            RequestState::New(action) => {
                // Posting waits for the first poll, so that joined requests are posted in the order
                // of their futures.
                if let Some(action) = action.take() {
                    *state = RequestState::Posted(port.post(action));
                }
                Poll::Pending
            }
            RequestState::Posted(id) => {
                let mut shared = port.lock();
                if shared.awaited.get(id).is_none_or(Option::is_none) {
                    return Poll::Pending;
                }
                // The entry is removed with its answer, so that `is_waiting` counts only requests
                // without one.
                shared.awaited.remove(id).flatten().map_or(Poll::Pending, Poll::Ready)
            }
        }
    }
}

impl<T, C, S> Drop for Request<T, C, S> {
    fn drop(&mut self) {
        if let RequestState::Posted(id) = &self.state {
            let mut shared = self.port.lock();
            shared.awaited.remove(id);
            shared.posted.retain(|(posted, _)| posted != id);
        }
    }
}

/// Waits until two futures are ready, and returns both outputs. It polls `first` before `second`
/// each time.
pub async fn both<A: Future, B: Future>(first: A, second: B) -> (A::Output, B::Output) {
    let (mut first, mut second) = (pin!(first), pin!(second));
    let (mut a, mut b) = (None, None);
    poll_fn(move |context| {
        // A future must not be polled again once it is ready, so its output is kept here.
        if a.is_none()
            && let Poll::Ready(output) = first.as_mut().poll(context)
        {
            a = Some(output);
        }
        if b.is_none()
            && let Poll::Ready(output) = second.as_mut().poll(context)
        {
            b = Some(output);
        }
        match (a.take(), b.take()) {
            (Some(a), Some(b)) => Poll::Ready((a, b)),
            (one, other) => {
                (a, b) = (one, other);
                Poll::Pending
            }
        }
    })
    .await
}

/// A procedure with its port: the kernel of a task.
pub struct Procedure<T, C, S> {
    /// `None` once it has ended.
    future: Option<Pin<Box<dyn Future<Output = Finish> + Send>>>,
    port: Port<T, C, S>,
    /// The request that the shell carries out now.
    current: Option<RequestId>,
    /// The end of the task, once it has ended.
    finish: Option<Finish>,
}

impl<T, C, S> std::fmt::Debug for Procedure<T, C, S> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { current, finish, .. } = self;
        f.debug_struct("Procedure").field("current", current).field("finish", finish).finish()
    }
}

impl<T, C, S> Procedure<T, C, S> {
    /// Makes a procedure that begins at the first event.
    #[must_use]
    pub fn new(
        port: Port<T, C, S>,
        procedure: impl Future<Output = Finish> + Send + 'static,
    ) -> Self {
        Self { future: Some(Box::pin(procedure)), port, current: None, finish: None }
    }

    /// Returns the port, through which the shared state can be read.
    #[must_use]
    pub fn port(&self) -> &Port<T, C, S> {
        &self.port
    }

    /// Delivers the event for the action that was carried out, resumes the procedure and returns
    /// its next action. An ended procedure returns its end again.
    pub fn resume(&mut self, event: Event<C>) -> Action<T> {
        // `Start` comes before any request and answers none.
        if let Some(id) = self.current.take() {
            self.port.deliver(id, event);
        }
        if let Some(future) = &mut self.future
            && let Poll::Ready(finish) =
                future.as_mut().poll(&mut Context::from_waker(Waker::noop()))
        {
            // Dropping the future withdraws the requests that it had left open.
            (self.future, self.finish) = (None, Some(finish));
        }
        if let Some(finish) = &self.finish {
            return Action::Finish(finish.clone());
        }
        if let Some((id, action)) = self.port.take_posted() {
            self.current = Some(id);
            return action;
        }
        debug_assert!(!self.port.is_waiting(), "a request was taken but not answered");
        // The procedure is pending and posted nothing. With one action at a time every request that
        // was taken has its answer by now, so no later event can wake the procedure.
        Action::Defect("the task waits without a request".to_owned())
    }
}

/// State behind a procedure's port, from which its kernel answers the shell.
pub trait Shared: Send + 'static {
    /// Entry in the journal.
    type Entry: JournalEntry;

    /// Stores the state of the cell, before the procedure gets the event of that time.
    fn see(&mut self, readings: &Readings<'_>);

    /// Takes the messages to the operator that are not taken yet.
    fn take_notes(&mut self) -> Vec<Remark> {
        Vec::new()
    }

    /// Returns the present belief for display.
    fn picture(&self) -> Option<Picture> {
        None
    }

    /// Returns the entry that must be in the journal before the present action.
    fn entry(&self) -> Option<Self::Entry> {
        None
    }

    /// Returns the account of the task.
    fn account(&self) -> Account {
        Account::default()
    }

    /// Corrects the account after an error, by the states of the arms at rest.
    fn look_back(&mut self, arms: &[ArmState]) {
        let _ = arms;
    }
}

impl<T: Thought + Unpin, S: Shared> Kernel for Procedure<T, T::Conclusion, S> {
    type Thought = T;
    type Entry = S::Entry;

    fn next(&mut self, event: Event<T::Conclusion>, readings: &Readings<'_>) -> Action<T> {
        self.port.state(|shared| shared.see(readings));
        self.resume(event)
    }

    fn notes(&mut self) -> Vec<Remark> {
        self.port.state(Shared::take_notes)
    }

    fn picture(&self) -> Option<Picture> {
        self.port.state(|shared| shared.picture())
    }

    fn entry(&self) -> Option<S::Entry> {
        self.port.state(|shared| shared.entry())
    }

    fn account(&self) -> Account {
        self.port.state(|shared| shared.account())
    }

    fn look_back(&mut self, arms: &[ArmState]) {
        self.port.state(|shared| shared.look_back(arms));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Port whose shared state is a list of names.
    type Bare = Port<(), (), Vec<&'static str>>;

    /// Makes a procedure whose shared state is a list of names.
    fn run<F: Future<Output = Finish> + Send + 'static>(
        procedure: impl FnOnce(Bare) -> F,
    ) -> Procedure<(), (), Vec<&'static str>> {
        let port = Port::new(Vec::new());
        Procedure::new(port.clone(), procedure(port))
    }

    /// Returns the end of a procedure that has achieved its goal.
    fn done() -> Finish {
        Finish { achieved: true, reason: "done".to_owned() }
    }

    #[test]
    fn procedure_returns_one_action_per_event() {
        let mut procedure = run(|port| async move {
            for name in ["a", "b"] {
                port.request(Action::Phase(name)).await;
                port.state(|seen| seen.push(name));
            }
            done()
        });

        assert_eq!(procedure.resume(Event::Start), Action::Phase("a"));
        assert_eq!(procedure.resume(Event::Done), Action::Phase("b"));
        assert_eq!(procedure.resume(Event::Done), Action::Finish(done()));
        assert_eq!(procedure.resume(Event::Done), Action::Finish(done()), "the end is final");
        assert_eq!(procedure.port().state(|seen| seen.clone()), ["a", "b"]);
    }

    #[test]
    fn answers_reach_their_own_requests() {
        let port: Bare = Port::new(Vec::new());
        let (first, second) = (port.request(Action::Watch(true)), port.request(Action::Await));
        let mut joined = pin!(both(first, second));
        let mut context = Context::from_waker(Waker::noop());
        assert!(joined.as_mut().poll(&mut context).is_pending());
        let (a, _) = port.take_posted().unwrap();
        let (b, _) = port.take_posted().unwrap();

        port.deliver(b, Event::Answered(None));
        assert!(joined.as_mut().poll(&mut context).is_pending());
        port.deliver(a, Event::Done);

        let Poll::Ready(answers) = joined.as_mut().poll(&mut context) else { panic!() };
        assert!(matches!(answers, (Event::Done, Event::Answered(None))), "{answers:?}");
    }

    #[test]
    fn joined_requests_are_carried_out_in_order() {
        let mut procedure = run(|port| async move {
            let first = async {
                port.request(Action::Phase("a")).await;
                port.request(Action::Phase("c")).await;
            };
            both(first, port.request(Action::Phase("b"))).await;
            done()
        });

        let phases: Vec<_> = std::iter::repeat_with(|| procedure.resume(Event::Done))
            .take_while(|action| !matches!(action, Action::Finish(_)))
            .collect();

        assert_eq!(phases, ["a", "b", "c"].map(Action::Phase));
    }

    #[test]
    fn procedure_without_open_request_reports_defect() {
        let mut procedure = run(|_| std::future::pending());

        assert!(matches!(procedure.resume(Event::Start), Action::Defect(_)));
    }

    #[test]
    fn answered_request_no_longer_counts_as_open() {
        let mut procedure = run(|port| async move {
            both(port.request(Action::Phase("a")), std::future::pending::<()>()).await;
            done()
        });

        assert_eq!(procedure.resume(Event::Start), Action::Phase("a"));
        assert!(matches!(procedure.resume(Event::Done), Action::Defect(_)));
    }

    #[test]
    fn dropped_request_is_withdrawn() {
        let mut procedure = run(|port| async move {
            {
                let mut given_up = pin!(port.request(Action::Await));
                let polled = given_up.as_mut().poll(&mut Context::from_waker(Waker::noop()));
                assert!(polled.is_pending());
            }
            port.request(Action::Phase("a")).await;
            done()
        });

        assert_eq!(procedure.resume(Event::Start), Action::Phase("a"));
        assert_eq!(procedure.resume(Event::Done), Action::Finish(done()));
    }
}
