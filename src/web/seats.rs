//! The right to command the robot: one page at a time has it, and the others watch. Every page may
//! press the emergency stop. The seat of a page is its place among those that command or watch.
//!
//! | event | rule |
//! |---|---|
//! | a page opens or asks, and no page commands | it commands |
//! | a page asks, and another one commands | the other page is asked, and consents or refuses |
//! | ... and neither answers nor commands for [`ANSWER`] | the page that asks commands |
//! | the connection of the page that commands ends | its seat is kept for [`RETURN`] |
//! | the page that commands gives up the right | the page that asks commands, or else no page |

use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;

/// Time within which the page that commands answers another page that asks for the right.
pub(super) const ANSWER: Duration = Duration::from_secs(10);
/// Time for which the right to command is kept for a page whose connection has ended.
pub(super) const RETURN: Duration = Duration::from_secs(10);

/// Seats of all pages.
#[derive(Debug)]
pub(super) struct Seats(watch::Sender<Command>);

/// The page that commands, and the one that asks for the right to command.
#[derive(Debug, Clone, Default)]
pub(super) struct Command {
    holder: Option<Holder>,
    request: Option<Request>,
}

/// Page that commands.
#[derive(Debug, Clone)]
struct Holder {
    /// Number of its connection.
    number: u64,
    /// Name that the page has given itself, by which it is recognised after a lost connection.
    page: Option<String>,
    /// Time at which the right becomes free; `None` while the connection lasts.
    kept_until: Option<Instant>,
}

/// Page that asks for the right to command.
#[derive(Debug, Clone)]
struct Request {
    /// Number of its connection.
    number: u64,
    /// Name that the page has given itself.
    page: Option<String>,
    /// Time at which this page gets the right if it has not been refused.
    until: Instant,
}

impl Default for Seats {
    fn default() -> Self {
        Self(watch::channel(Command::default()).0)
    }
}

impl Seats {
    /// Returns the seat of a new page. The page commands if no other page does, or if the right is
    /// kept for a page of this name. `number` is that of its connection; `page` is the name that it
    /// has given itself.
    pub(super) fn newcomer(self: &Arc<Self>, number: u64, page: Option<String>) -> Seat {
        let seat = Seat { seats: Arc::clone(self), number, page };
        seat.change(|command| {
            let returns = command.holder.as_ref().is_some_and(|holder| {
                holder.kept_until.is_some() && holder.page.is_some() && holder.page == seat.page
            });
            if !returns && command.holder.is_some() {
                return false;
            }
            command.holder = Some(seat.holder());
            true
        });
        seat
    }

    /// Returns the number of the connection of the page that commands; `None` if none does.
    pub(super) fn holder(&self) -> Option<u64> {
        self.0.borrow().holder.as_ref().map(|holder| holder.number)
    }
}

/// Right to command, as one page shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub(super) struct SeatView {
    /// Whether this page commands.
    own: bool,
    /// Whether any page commands.
    taken: bool,
    /// Page that asks for the right to command.
    request: Option<Asks>,
}

/// A page that asks for the right to command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
enum Asks {
    /// This page.
    Own,
    /// Another page.
    Other,
}

/// Seat of one page. When it is dropped, the request of this page ends. If the page commands and
/// has a name, its right is kept for [`RETURN`]; without a name the right passes on.
pub(super) struct Seat {
    seats: Arc<Seats>,
    number: u64,
    page: Option<String>,
}

impl Seat {
    /// Returns whether this page commands.
    pub(super) fn commands(&self) -> bool {
        self.seats.holder() == Some(self.number)
    }

    /// Returns a receiver of all changes of the right to command.
    pub(super) fn changes(&self) -> watch::Receiver<Command> {
        self.seats.0.subscribe()
    }

    /// Returns the right to command as this page shows it.
    pub(super) fn view(&self) -> SeatView {
        let command = self.seats.0.borrow();
        let asks = |request: &Request| {
            if request.number == self.number { Asks::Own } else { Asks::Other }
        };
        SeatView {
            own: command.holder.as_ref().is_some_and(|holder| holder.number == self.number),
            taken: command.holder.is_some(),
            request: command.request.as_ref().map(asks),
        }
    }

    /// Takes the right to command if no page has it, and otherwise asks the page that has it.
    /// Returns the reason if this page is refused because another page already asks.
    pub(super) fn take(&self) -> Option<&'static str> {
        let mut refused = None;
        self.change(|command| {
            match (&command.holder, &command.request) {
                (None, _) => command.holder = Some(self.holder()),
                (Some(holder), _) if holder.number == self.number => return false,
                (_, Some(request)) if request.number == self.number => return false,
                (_, Some(_)) => {
                    refused = Some("another page already asks for the command: try again later");
                    return false;
                }
                (Some(_), None) => {
                    let until = Instant::now() + ANSWER;
                    let page = self.page.clone();
                    command.request = Some(Request { number: self.number, page, until });
                }
            }
            true
        });
        refused
    }

    /// Answers the page that asks for the right to command: passes the right on if this page
    /// `consents`, else ends the request. Does nothing if this page does not command.
    pub(super) fn answer(&self, consents: bool) {
        self.change(|command| {
            let asked = command.request.is_some() && command.is_held_by(self.number);
            if asked && consents {
                command.pass_on();
            } else if asked {
                command.request = None;
            }
            asked
        });
    }

    /// Restarts the time [`ANSWER`] for the answer to a request, because this page has commanded.
    pub(super) fn has_commanded(&self) {
        self.change(|command| {
            let held = command.is_held_by(self.number);
            if let Some(request) = command.request.as_mut().filter(|_| held) {
                request.until = Instant::now() + ANSWER;
            }
            // The pages do not show this time, so they need no news.
            false
        });
    }

    /// Gives up the right to command if this page has it. A page that asks gets the right.
    pub(super) fn leave(&self) {
        self.change(|command| {
            let own = command.is_held_by(self.number);
            if own {
                command.pass_on();
            }
            own
        });
    }

    /// Passes on or frees the right to command when its time has come.
    pub(super) fn look_at_clock(&self) {
        self.change(|_| false);
    }

    /// Returns this page as the one that commands.
    fn holder(&self) -> Holder {
        Holder { number: self.number, page: self.page.clone(), kept_until: None }
    }

    /// Changes the state in one step, after passing on or freeing a right whose time has come.
    /// `change` returns whether the pages must be told.
    fn change(&self, change: impl FnOnce(&mut Command) -> bool) {
        self.seats.0.send_if_modified(|command| {
            let late = command.expires(Instant::now());
            change(command) || late
        });
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.change(|command| {
            let asked = command.request.as_ref().is_some_and(|r| r.number == self.number);
            if asked {
                command.request = None;
            }
            let Some(holder) = command.holder.as_mut().filter(|h| h.number == self.number) else {
                return asked;
            };
            if holder.page.is_some() {
                // The right is kept, so that the operator's page gets it back when it reconnects,
                // and no stranger's page does.
                holder.kept_until = Some(Instant::now() + RETURN);
                return asked;
            }
            command.pass_on();
            true
        });
    }
}

impl Command {
    /// Checks whether the page with this number of a connection commands.
    fn is_held_by(&self, number: u64) -> bool {
        self.holder.as_ref().is_some_and(|holder| holder.number == number)
    }

    /// Gives the right to command to the page that asks for it, or to none.
    fn pass_on(&mut self) {
        self.holder = self.request.take().map(|request| {
            let Request { number, page, .. } = request;
            Holder { number, page, kept_until: None }
        });
    }

    /// Passes on or frees the right if a request was not answered in time, or if the page for which
    /// the right was kept has not returned. Returns whether that is so.
    fn expires(&mut self, now: Instant) -> bool {
        let unanswered = self.request.as_ref().is_some_and(|request| now >= request.until);
        let kept = self.holder.as_ref().and_then(|holder| holder.kept_until);
        let expired = unanswered || kept.is_some_and(|until| now >= until);
        if expired {
            self.pass_on();
        }
        expired
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::advance;

    /// Time by which a deadline is missed.
    const STEP: Duration = Duration::from_millis(1);

    /// Returns seats with a page "a", which commands, and a page "b", which watches.
    fn two() -> (Arc<Seats>, Seat, Seat) {
        let seats = Arc::<Seats>::default();
        let holder = seats.newcomer(1, Some("a".into()));
        let other = seats.newcomer(2, Some("b".into()));
        (seats, holder, other)
    }

    #[tokio::test(start_paused = true)]
    async fn stranger_takes_seat_only_with_consent() {
        let (seats, holder, other) = two();
        let third = seats.newcomer(3, None);
        let has = |own| SeatView { own, taken: true, request: None };
        // Before a request there is nothing to answer, and a stranger has nothing to give up.
        assert_eq!(holder.take(), None);
        holder.answer(true);
        other.leave();
        assert_eq!(
            (holder.view(), other.view(), third.view()),
            (has(true), has(false), has(false))
        );

        assert_eq!(other.take(), None);
        // Only the holder answers, and one page asks at a time.
        for stranger in [&other, &third] {
            stranger.answer(true);
            stranger.answer(false);
            stranger.leave();
        }
        assert!(third.take().is_some() && other.take().is_none());
        assert_eq!(holder.view(), SeatView { request: Some(Asks::Other), ..has(true) });
        assert_eq!(other.view(), SeatView { request: Some(Asks::Own), ..has(false) });
        assert_eq!(third.view(), SeatView { request: Some(Asks::Other), ..has(false) });
        holder.answer(false);
        advance(2 * ANSWER).await;
        other.look_at_clock();
        assert!(holder.commands() && holder.view().request.is_none(), "it was refused");

        assert_eq!(other.take(), None);
        holder.answer(true);
        assert_eq!(
            (holder.view(), other.view(), third.view()),
            (has(false), has(true), has(false))
        );
    }

    #[tokio::test(start_paused = true)]
    async fn seat_passes_on_when_holder_never_answers() {
        let (_seats, holder, other) = two();
        assert_eq!(other.take(), None);

        // A holder who works is not interrupted.
        for _ in 0..5 {
            advance(ANSWER.saturating_sub(STEP)).await;
            other.look_at_clock();
            assert!(holder.commands());
            holder.has_commanded();
        }
        // Only the commands of the holder restart the time.
        advance(ANSWER / 2).await;
        other.has_commanded();
        advance(ANSWER / 2).await;
        other.look_at_clock();

        assert!(other.commands() && !holder.commands());
    }

    /// After a reload of the page or a lost connection the page gets its right back. Until then no
    /// other page gets it.
    #[tokio::test(start_paused = true)]
    async fn seat_is_kept_for_returning_page() {
        let (seats, holder, other) = two();

        drop(holder);
        advance(RETURN.saturating_sub(STEP)).await;
        let third = seats.newcomer(3, Some("c".into()));
        let nameless = seats.newcomer(4, None);
        assert!(!third.commands() && !nameless.commands());
        let back = seats.newcomer(5, Some("a".into()));
        assert!(back.commands());
        // A second tab with the same name takes nothing from a page that is there.
        assert!(!seats.newcomer(6, Some("a".into())).commands() && back.commands());

        drop(back);
        advance(RETURN).await;
        other.look_at_clock();
        assert!(!other.view().taken);
        assert_eq!(other.take(), None);
        assert!(other.commands());
    }

    #[tokio::test(start_paused = true)]
    async fn seat_without_page_name_is_free_at_once() {
        let seats = Arc::<Seats>::default();
        let (first, second) = (seats.newcomer(1, None), seats.newcomer(2, None));

        drop(first);

        assert!(!second.view().taken);
        assert!(seats.newcomer(3, None).commands());
    }

    #[tokio::test(start_paused = true)]
    async fn request_of_lost_page_is_dropped() {
        let (_seats, holder, other) = two();
        assert_eq!(other.take(), None);

        drop(other);
        advance(2 * ANSWER).await;
        holder.look_at_clock();

        assert!(holder.commands() && holder.view().request.is_none());
        holder.leave();
        assert!(!holder.view().taken);
    }
}
