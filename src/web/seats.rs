//! The right to command: one page at a time has it, and the others watch. Every page may press the
//! emergency stop.
//!
//! | event | rule |
//! |---|---|
//! | a page opens or asks, and no page commands | it commands |
//! | a page asks, and another one commands | that one is asked, and consents or refuses |
//! | ... and neither answers nor commands for [`ANSWER`] | the page that asks commands |
//! | the connection of the page that commands ends | its seat is kept for [`RETURN`] |
//! | the page that commands gives up the right | the page that asks commands, else none |

use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;

/// Time within which the page that commands answers another page that asks for the right.
pub(super) const ANSWER: Duration = Duration::from_secs(10);
/// Time within which a page whose connection has ended finds its right to command kept.
pub(super) const RETURN: Duration = Duration::from_secs(10);

/// Seats of all pages.
#[derive(Debug)]
pub(super) struct Seats(watch::Sender<Command>);

/// The page that commands, and the one that asks for it.
#[derive(Debug, Clone, Default)]
pub(super) struct Command {
    holder: Option<Holder>,
    request: Option<Request>,
}

#[derive(Debug, Clone)]
struct Holder {
    number: u64,
    /// Name that the page has given itself. It recognises the page after a lost connection.
    page: Option<String>,
    /// Time at which the seat is free, after the connection has ended.
    kept_until: Option<Instant>,
}

#[derive(Debug, Clone)]
struct Request {
    number: u64,
    page: Option<String>,
    /// Time at which the page that asks commands if it is not refused.
    until: Instant,
}

impl Default for Seats {
    fn default() -> Self {
        Self(watch::channel(Command::default()).0)
    }
}

impl Seats {
    /// Returns the seat of a new page, which commands if no other page does, or if the right is
    /// kept for it. `number` is that of its connection; `page` is the name that it has given
    /// itself.
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

    /// Returns the number of the connection of the page that commands.
    pub(super) fn holder(&self) -> Option<u64> {
        self.0.borrow().holder.as_ref().map(|holder| holder.number)
    }
}

/// A seat as its page shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub(super) struct SeatView {
    /// Whether this page commands.
    own: bool,
    /// Whether a page commands.
    taken: bool,
    /// The page that asks for the right to command.
    request: Option<Asks>,
}

/// A page that asks for the right to command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
enum Asks {
    Own,
    Other,
}

/// Seat of one page. A drop of it ends the request of this page, and keeps its right to command for
/// [`RETURN`] if the page has a name.
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

    /// Returns a receiver of all changes.
    pub(super) fn changes(&self) -> watch::Receiver<Command> {
        self.seats.0.subscribe()
    }

    /// Returns the seat as this page shows it.
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
    /// Returns the reason if this page must wait for the answer to another one.
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

    /// Answers the page that asks for the right to command, if this page has it.
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

    /// Restarts the time of [`ANSWER`], because this page has commanded.
    pub(super) fn has_commanded(&self) {
        self.change(|command| {
            let held = command.is_held_by(self.number);
            if let Some(request) = command.request.as_mut().filter(|_| held) {
                request.until = Instant::now() + ANSWER;
            }
            // No page shows the time.
            false
        });
    }

    /// Gives up the right to command if this page has it.
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

    fn holder(&self) -> Holder {
        Holder { number: self.number, page: self.page.clone(), kept_until: None }
    }

    /// Changes the state at one go; `change` returns whether the pages must show it.
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
                // The page of the operator may return before a stranger's opens.
                holder.kept_until = Some(Instant::now() + RETURN);
                return asked;
            }
            command.pass_on();
            true
        });
    }
}

impl Command {
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

    /// Passes on or frees the right when its time has come. Returns whether it has.
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

    const STEP: Duration = Duration::from_millis(1);

    fn two() -> (Arc<Seats>, Seat, Seat) {
        let seats = Arc::<Seats>::default();
        let holder = seats.newcomer(1, Some("a".into()));
        let other = seats.newcomer(2, Some("b".into()));
        (seats, holder, other)
    }

    #[tokio::test(start_paused = true)]
    async fn stranger_takes_seat_only_with_consent() {
        let (seats, holder, other) = two();
        assert!(holder.commands() && !other.commands());

        assert_eq!(other.take(), None);
        assert!(holder.commands(), "the holder is asked");
        assert_eq!(holder.view().request, Some(Asks::Other));
        assert_eq!(other.view().request, Some(Asks::Own));
        other.answer(true);
        assert!(holder.commands(), "only the holder answers");
        holder.answer(false);
        advance(2 * ANSWER).await;
        other.look_at_clock();
        assert!(holder.commands() && holder.view().request.is_none(), "it was refused");

        assert_eq!(other.take(), None);
        assert!(seats.newcomer(3, None).take().is_some(), "one page asks at a time");
        holder.answer(true);
        assert!(other.commands() && !holder.commands());
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
        advance(ANSWER).await;
        other.look_at_clock();

        assert!(other.commands() && !holder.commands());
    }

    /// A reload of the page, or a lost connection: a stranger who waits for it gets nothing.
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
