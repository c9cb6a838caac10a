//! Way of messages between two nodes: the model of a link on the actors' clock.
//!
//! - in: a message, at the node that sends it
//! - out: the same message at the other node, once the link has carried it
//! - a way that is cut carries nothing, in neither direction, not even what is under way
//!
//! Actors of one node need no way: their mailboxes are the link.

use crate::net::{Direction, LinkModel};
use std::future::Future;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::Instant;

/// Time between two beats, the signs of life that cross a way.
pub(crate) const BEAT: Duration = Duration::from_millis(20);
/// Number of losses of one message for which limits of time leave room.
const LOSSES: u32 = 3;

/// Way between the node of MP and another node.
#[derive(Debug, Clone)]
pub struct Way(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    /// Zero of the link's times.
    begun: Instant,
    model: LinkModel,
    /// From the node of MP, and back to it.
    out: Mutex<Direction>,
    back: Mutex<Direction>,
    /// Whether the other node, and its link, are dead.
    cut: Arc<AtomicBool>,
}

/// Direction on a way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Toward {
    /// From the node of MP to the other one.
    Node,
    /// From the other node to that of MP.
    Home,
}

/// Values of a watched place that a way carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carries {
    /// The newest one: a lost value is sent again only if no newer one follows soon.
    Newest,
    /// Each one, as an order.
    Each,
}

/// Sends a request, whose answer comes by a channel, to an actor's mailbox: at once, or by the way
/// to the actor's node. Returns the channel of the answer; `None` if the actor has ended.
pub(crate) async fn send<R: Send + 'static, T: Send + 'static>(
    way: Option<&Way>,
    mailbox: &mpsc::Sender<R>,
    (request, answer): (R, oneshot::Receiver<T>),
) -> Option<oneshot::Receiver<T>> {
    let Some(way) = way else {
        return mailbox.send(request).await.ok().map(|()| answer);
    };
    let mailbox = mailbox.clone();
    Some(way.request(async move {
        mailbox.send(request).await.ok()?;
        answer.await.ok()
    }))
}

impl Way {
    /// Makes the way to the node with this index; the `seed` draws delays and losses. The way is
    /// cut once `cut` is true.
    #[must_use]
    pub fn new(model: LinkModel, seed: u64, index: usize, cut: Arc<AtomicBool>) -> Self {
        let stream = 2 * index as u64;
        let direction = |side| Mutex::new(Direction::new(model, seed, stream + side));
        let (out, back) = (direction(0), direction(1));
        Self(Arc::new(Inner { begun: Instant::now(), model, out, back, cut }))
    }

    /// Returns the longest time of a request and its answer, for limits of time.
    #[must_use]
    pub fn longest_trip(&self) -> Duration {
        Duration::from_secs_f64(2.0 * self.0.model.longest(LOSSES))
    }

    /// Returns the longest time of a value on its way.
    #[must_use]
    pub fn longest_value(&self) -> Duration {
        Duration::from_secs_f64(self.0.model.longest(0))
    }

    /// Returns the number of values in a row of which practically always one arrives.
    #[must_use]
    pub fn values_for_one(&self) -> u32 {
        /// Share of rows of values that may be lost as a whole.
        const LOST: f64 = 1e-9;
        let loss = self.0.model.loss;
        if loss > 0.0 { (LOST.ln() / loss.ln()).ceil() as u32 } else { 1 }
    }

    /// Sends a request, which `handle` handles at the other node. The answer comes by the returned
    /// channel, which closes without one if `handle` returns `None`. The request stays under way if
    /// the caller gives up.
    pub fn request<T: Send + 'static>(
        &self,
        handle: impl Future<Output = Option<T>> + Send + 'static,
    ) -> oneshot::Receiver<T> {
        let (reply, answer) = oneshot::channel();
        let way = self.clone();
        // Stamped now, so that requests arrive in the order in which they are sent.
        let arrival = self.arrival(Toward::Node);
        tokio::spawn(async move {
            way.until(arrival).await;
            let result = handle.await;
            let arrival = way.arrival(Toward::Home);
            way.until(arrival).await;
            if let Some(result) = result {
                let _ = reply.send(result);
            }
        });
        answer
    }

    /// Sends an order, which `handle` handles at the other node. It has no answer.
    pub fn order(&self, handle: impl Future<Output = ()> + Send + 'static) {
        let way = self.clone();
        let arrival = self.arrival(Toward::Node);
        tokio::spawn(async move {
            way.until(arrival).await;
            handle.await;
        });
    }

    /// Returns the sending end of a queue whose messages the way carries from the other node to
    /// `home`.
    #[must_use]
    pub fn queue_home<T: Send + 'static>(
        &self,
        home: mpsc::UnboundedSender<T>,
    ) -> mpsc::UnboundedSender<T> {
        let (there, mut sent) = mpsc::unbounded_channel::<(Instant, T)>();
        let (queue, mut messages) = mpsc::unbounded_channel();
        let (stamps, way) = (self.clone(), self.clone());
        // A message that waits for a lost one must not be stamped later for that.
        tokio::spawn(async move {
            while let Some(message) = messages.recv().await {
                let _ = there.send((stamps.arrival(Toward::Home), message));
            }
        });
        tokio::spawn(async move {
            while let Some((arrival, message)) = sent.recv().await {
                way.until(arrival).await;
                let _ = home.send(message);
            }
        });
        queue
    }

    /// Returns the sending end of a place whose values the way carries to `there`.
    #[must_use]
    pub fn set<T: Clone + Send + Sync + 'static>(
        &self,
        there: &Arc<watch::Sender<T>>,
    ) -> Arc<watch::Sender<T>> {
        let (here, values) = watch::channel(there.borrow().clone());
        let (mut arrive, there) =
            (self.watch(Toward::Node, Carries::Each, values), Arc::clone(there));
        tokio::spawn(async move {
            while arrive.changed().await.is_ok() {
                there.send_replace(arrive.borrow_and_update().clone());
            }
        });
        Arc::new(here)
    }

    /// Returns the latest value of `source` as the other end of the way sees it.
    #[must_use]
    pub fn watch<T: Clone + Send + Sync + 'static>(
        &self,
        toward: Toward,
        carries: Carries,
        mut source: watch::Receiver<T>,
    ) -> watch::Receiver<T> {
        let (target, seen) = watch::channel(source.borrow_and_update().clone());
        let (queue, mut due) = mpsc::unbounded_channel::<(Instant, T)>();
        let way = self.clone();
        tokio::spawn(async move {
            let again = Duration::from_secs_f64(way.0.model.resend);
            let mut lost = false;
            loop {
                let wait = if lost { again } else { Duration::MAX };
                if let Ok(Err(_)) = tokio::time::timeout(wait, source.changed()).await {
                    break;
                }
                let value = source.borrow_and_update().clone();
                let arrival = match carries {
                    Carries::Newest => way.value(toward),
                    Carries::Each => Some(way.arrival(toward)),
                };
                lost = arrival.is_none();
                if let Some(arrival) = arrival
                    && queue.send((arrival, value)).is_err()
                {
                    break;
                }
            }
        });
        let way = self.clone();
        tokio::spawn(async move {
            while let Some((arrival, value)) = due.recv().await {
                way.until(arrival).await;
                target.send_replace(value);
                if target.is_closed() {
                    break;
                }
            }
        });
        seen
    }

    /// Waits until `arrival`; for ever if the way is cut by then.
    async fn until(&self, arrival: Instant) {
        tokio::time::sleep_until(arrival).await;
        if self.0.cut.load(Ordering::Acquire) {
            std::future::pending::<()>().await;
        }
    }

    /// Returns the arrival of a message that is sent now.
    fn arrival(&self, toward: Toward) -> Instant {
        self.draw(toward, Direction::message)
    }

    /// Returns the arrival of a value that is sent now, or `None` if it is lost.
    fn value(&self, toward: Toward) -> Option<Instant> {
        let at = self.draw_with(toward, Direction::value);
        at.map(|at| self.0.begun + Duration::from_secs_f64(at))
    }

    /// Draws a time of one direction and returns it on the clock.
    fn draw(&self, toward: Toward, draw: impl FnOnce(&mut Direction, f64) -> f64) -> Instant {
        self.0.begun + Duration::from_secs_f64(self.draw_with(toward, draw))
    }

    /// Draws from one direction at the present time.
    fn draw_with<T>(&self, toward: Toward, draw: impl FnOnce(&mut Direction, f64) -> T) -> T {
        let direction = match toward {
            Toward::Node => &self.0.out,
            Toward::Home => &self.0.back,
        };
        let now = self.0.begun.elapsed().as_secs_f64();
        draw(&mut direction.lock().unwrap_or_else(PoisonError::into_inner), now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODEL: LinkModel = LinkModel { delay: 0.01, jitter: 0.005, loss: 0.2, resend: 0.03 };

    fn way() -> (Way, Arc<AtomicBool>) {
        let cut = Arc::default();
        (Way::new(MODEL, 3, 0, Arc::clone(&cut)), cut)
    }

    /// Requests arrive in the order in which they are sent, lost ones too, and each answer takes
    /// two ways.
    #[tokio::test(start_paused = true)]
    async fn requests_keep_order_and_take_two_ways() {
        let (way, _) = way();
        let (there, mut arrived) = mpsc::unbounded_channel();
        let begun = Instant::now();
        let answers: Vec<_> = (0..50)
            .map(|i| {
                let there = there.clone();
                way.request(async move { there.send(i).ok().map(|()| i) })
            })
            .collect();

        for (i, answer) in answers.into_iter().enumerate() {
            assert_eq!(answer.await, Ok(i));
            assert!(begun.elapsed() >= Duration::from_secs_f64(2.0 * MODEL.delay));
        }
        for i in 0..50 {
            assert_eq!(arrived.recv().await, Some(i));
        }
    }

    /// Orders and the messages of a queue take one way each, and keep their order.
    #[tokio::test(start_paused = true)]
    async fn orders_and_messages_take_one_way() {
        let (way, _) = way();
        let (home, mut arrived) = mpsc::unbounded_channel();
        let (queue, begun) = (way.queue_home(home.clone()), Instant::now());
        for i in 0..50 {
            queue.send((true, i)).unwrap();
            let home = home.clone();
            way.order(async move { home.send((false, i)).unwrap() });
        }

        let mut next = [0, 0];
        for _ in 0..100 {
            let (queued, i) = arrived.recv().await.unwrap();
            assert!(begun.elapsed() >= Duration::from_secs_f64(MODEL.delay));
            assert_eq!(i, std::mem::replace(&mut next[usize::from(queued)], i + 1));
        }
        assert_eq!(next, [50, 50]);
    }

    #[tokio::test(start_paused = true)]
    async fn cut_way_carries_nothing_more() {
        let (way, cut) = way();
        let (values, source) = watch::channel(0);
        let mut seen = way.watch(Toward::Home, Carries::Each, source);
        values.send_replace(1);
        seen.changed().await.unwrap();
        // This answer is under way when the node dies.
        let answer = way.request(async { Some(()) });
        cut.store(true, Ordering::Release);
        values.send_replace(2);

        let wait = Duration::from_secs(10);
        assert!(tokio::time::timeout(wait, answer).await.is_err());
        assert!(tokio::time::timeout(wait, seen.changed()).await.is_err());
        assert_eq!(*seen.borrow(), 1);
    }

    /// A lost value is sent again if no newer one follows: in the end the newest one is there.
    #[tokio::test(start_paused = true)]
    async fn last_value_arrives_although_values_are_lost() {
        let (way, _) = way();
        let (values, source) = watch::channel(0);
        let seen = way.watch(Toward::Home, Carries::Newest, source);
        for i in 1..=500 {
            values.send_replace(i);
            // Faster than the jitter of the link.
            tokio::time::sleep(Duration::from_millis(1)).await;
            if i % 50 == 0 {
                tokio::time::sleep(Duration::from_secs(1)).await;
                assert_eq!(*seen.borrow(), i);
            }
        }
    }

    /// The newest value comes through although some are lost; each order comes through.
    #[tokio::test(start_paused = true)]
    async fn orders_arrive_and_values_may_be_lost() {
        let (way, _) = way();
        let orders = Arc::new(watch::channel(0).0);
        let mut ordered = orders.subscribe();
        let here = way.set(&orders);
        let (values, source) = watch::channel(0);
        let seen = way.watch(Toward::Home, Carries::Newest, source);
        let mut newest = Vec::new();
        for i in 1..=100 {
            here.send_replace(i);
            values.send_replace(i);
            tokio::time::sleep(Duration::from_millis(20)).await;
            newest.push(*seen.borrow() == i);
            tokio::time::sleep(Duration::from_millis(400)).await;
            assert_eq!(*ordered.borrow_and_update(), i);
            assert_eq!(*seen.borrow(), i, "a lost value is sent again");
        }

        let share = newest.iter().filter(|arrived| **arrived).count();
        assert!((60..95).contains(&share), "{share} of 100, a fifth is lost");
    }
}
