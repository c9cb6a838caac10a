//! Model of a link that repeats lost messages and keeps their order, as TCP does.
//!
//! - in: the time at which a message is sent, the parameters, the seed
//! - out: the time at which it arrives
//! - a lost message is sent again after a fixed time; the messages behind it wait for it
//! - a value that a newer one replaces is not sent again

use rand::Rng as _;
use rand_pcg::Pcg64;

/// Most times that a message is sent again; the last time it arrives.
const MOST_REPEATS: u32 = 50;

/// Parameters of a link between two nodes, the same in both directions.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LinkModel {
    /// Shortest time of a message on its way (s).
    pub delay: f64,
    /// Greatest addition to that time, which is drawn for each message (s).
    pub jitter: f64,
    /// Share of the messages that are lost on their way, 0 to less than 1.
    pub loss: f64,
    /// Time after which a lost message is sent again (s).
    pub resend: f64,
}

impl LinkModel {
    /// Returns the longest time of a message that is lost at most this number of times (s).
    #[must_use]
    pub fn longest(&self, losses: u32) -> f64 {
        let repeats = if self.loss > 0.0 { f64::from(losses) * self.resend } else { 0.0 };
        self.delay + self.jitter + repeats
    }
}

/// One direction of a link.
///
/// ```
/// use rubik_robot::net::{Direction, LinkModel};
///
/// let link = LinkModel { delay: 0.005, jitter: 0.002, loss: 0.1, resend: 0.05 };
/// let mut to_node = Direction::new(link, 1, 0);
/// let arrivals: Vec<f64> = (0..1000).map(|i| to_node.message(0.01 * f64::from(i))).collect();
/// // A lost message is sent again and delays those behind it: none overtakes another.
/// assert!(arrivals.windows(2).all(|pair| pair[0] <= pair[1]));
/// assert!(arrivals.iter().enumerate().any(|(i, at)| at - 0.01 * i as f64 > 0.05));
/// ```
#[derive(Debug)]
pub struct Direction {
    model: LinkModel,
    random: Pcg64,
    /// Arrival of the last message (s).
    last: f64,
    /// Arrival of the last value (s).
    last_value: f64,
}

impl Direction {
    /// Makes a direction; `seed` and `stream` draw its delays and losses.
    #[must_use]
    pub fn new(model: LinkModel, seed: u64, stream: u64) -> Self {
        let random = Pcg64::new(u128::from(seed), u128::from(stream));
        Self { model, random, last: 0.0, last_value: 0.0 }
    }

    /// Returns the arrival of a message that is sent at `now` (s): not before that of any message
    /// sent earlier.
    pub fn message(&mut self, now: f64) -> f64 {
        let mut repeats = 0;
        while self.is_lost() && repeats < MOST_REPEATS {
            repeats += 1;
        }
        let way = self.way() + f64::from(repeats) * self.model.resend;
        self.last = self.last.max(now + way);
        self.last
    }

    /// Returns the arrival of a value that is sent at `now` (s), or `None` if it is lost. It
    /// arrives not before any value sent earlier, but does not wait for messages, nor they for it.
    pub fn value(&mut self, now: f64) -> Option<f64> {
        let lost = self.is_lost();
        let arrival = self.last_value.max(now + self.way());
        if lost {
            return None;
        }
        self.last_value = arrival;
        Some(arrival)
    }

    /// Draws whether a message is lost.
    fn is_lost(&mut self) -> bool {
        self.model.loss > 0.0 && self.random.random::<f64>() < self.model.loss
    }

    /// Draws the time of a message on its way (s).
    fn way(&mut self) -> f64 {
        self.model.delay + self.model.jitter * self.random.random::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODEL: LinkModel = LinkModel { delay: 0.01, jitter: 0.02, loss: 0.1, resend: 0.05 };

    /// 20000 messages and values, one each millisecond: none overtakes another of its kind. A tenth
    /// of the messages is lost once, and those behind them wait.
    #[test]
    fn messages_keep_their_order_and_arrive() {
        let mut link = Direction::new(MODEL, 7, 1);
        let (mut last, mut last_value, mut late) = (0.0, 0.0, 0);
        for i in 0..20_000 {
            let now = f64::from(i) * 1e-3;
            let arrival = link.message(now);
            assert!(arrival >= last && arrival >= now + MODEL.delay, "{i}");
            assert!(arrival < now + 1.0, "{i}: the queue grows without a bound");
            last = arrival;
            late += u32::from(arrival > now + MODEL.longest(0));
            if let Some(value) = link.value(now) {
                assert!(value >= last_value && value <= now + MODEL.longest(0), "{i}");
                last_value = value;
            }
        }
        assert!(late > 2_000, "{late} messages are lost or behind a lost one");
    }

    #[test]
    fn share_of_lost_values_is_the_loss() {
        let mut link = Direction::new(MODEL, 7, 1);
        let arrived = (0..20_000).filter_map(|i| link.value(f64::from(i))).count();

        let lost = 1.0 - arrived as f64 / 20_000.0;
        assert!((lost - MODEL.loss).abs() < 0.01, "{lost}");
    }

    #[test]
    fn link_of_one_seed_repeats() {
        let run = |seed| {
            let mut link = Direction::new(MODEL, seed, 3);
            (0..100).map(|i| link.message(f64::from(i))).collect::<Vec<_>>()
        };

        assert_eq!(run(5), run(5));
        assert_ne!(run(5), run(6));
    }

    #[test]
    fn link_without_loss_repeats_nothing() {
        let model = LinkModel { loss: 0.0, ..MODEL };
        assert_eq!(model.longest(3), 0.03);
        assert!((MODEL.longest(2) - 0.13).abs() < 1e-12);
        let mut link = Direction::new(model, 1, 1);
        assert!((0..1000).all(|_| link.value(0.0).is_some()));
    }
}
