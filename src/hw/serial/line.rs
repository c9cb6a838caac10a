//! Serial lines, all of them served at once: each order goes out, each answer comes in, before one deadline.
//!
//! - the lines are file descriptors that never block; nothing is allocated in an exchange
//! - an answer that came too late is thrown away before the next order goes out, or, where it comes even later, gives
//!   way to the one behind it: answers have no number, and one that is a period old taken for a new one would make an
//!   axis at speed seem to stand and then to jump

use super::frame::{ORDER, STATUS};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, Mode, OFlags};
use rustix::io::{Errno, read, write};
use rustix::termios::{
    ControlModes, OptionalActions, QueueSelector, Termios, tcflush, tcgetattr, tcsetattr,
};
use std::os::fd::{AsFd, OwnedFd};
use std::time::{Duration, Instant};

/// Bits a second of the axis controllers' lines.
pub const AXIS_BAUD: u32 = 921_600;
/// The most lines that are served at once.
pub const MOST: usize = 32;

/// A serial line that never blocks. When it is closed it is set as it was before.
#[derive(Debug)]
pub struct Line {
    path: String,
    fd: OwnedFd,
    /// How it was set, where that could be read.
    before: Option<Termios>,
}

impl Line {
    /// Opens a device with 8 data bits, no parity and 1 or 2 stop bits, and throws away what has come.
    ///
    /// # Errors
    /// What the operating system says, with the device's name.
    pub fn open(path: &str, baud: u32, two_stop_bits: bool) -> Result<Self, String> {
        let fail = |what: &str, errno: Errno| format!("{path}: {what}: {errno}");
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let fd = rustix::fs::open(path, flags, Mode::empty()).map_err(|e| fail("open", e))?;
        // Two programs on one line would drive the axis in turn.
        rustix::fs::flock(&fd, FlockOperation::NonBlockingLockExclusive)
            .map_err(|_| format!("{path}: another program has it open"))?;
        let line = Self { path: path.to_owned(), before: tcgetattr(&fd).ok(), fd };
        set_up(&line.fd, baud, two_stop_bits).map_err(|e| fail("not a serial line", e))?;
        tcflush(&line.fd, QueueSelector::IOFlush).map_err(|e| fail("flush", e))?;
        Ok(line)
    }

    /// The device's name.
    #[must_use]
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Throws away what has come, and says how many bytes that was.
    #[must_use]
    pub fn drain(&self) -> usize {
        let mut rest = [0; 64];
        let mut gone = 0;
        // Bounded: a line that never stops talking must not hold up the period.
        for _ in 0..8 {
            let Ok(n) = read(&self.fd, &mut rest) else { break };
            gone += n;
            if n < rest.len() {
                break;
            }
        }
        gone
    }

    /// Writes all bytes, or says that it could not.
    #[must_use]
    pub fn write(&self, bytes: &[u8]) -> bool {
        matches!(write(&self.fd, bytes), Ok(n) if n == bytes.len())
    }

    /// Reads what is there; 0 when nothing is, `None` when the line is dead.
    pub fn read(&self, into: &mut [u8]) -> Option<usize> {
        match read(&self.fd, into) {
            // A line never comes to its end, unless it is a pseudo-terminal whose other side is gone.
            Ok(0) => None,
            Ok(n) => Some(n),
            Err(Errno::AGAIN | Errno::INTR) => Some(0),
            Err(_) => None,
        }
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            // The last orders go out at the speed that they were written for: they take 0.4 ms. To wait until they are
            // gone might take for ever. A line that is gone has no settings.
            std::thread::sleep(Duration::from_millis(5));
            let _ = tcsetattr(&self.fd, OptionalActions::Now, before);
        }
    }
}

/// Raw bytes, this speed, no flow control.
pub(crate) fn set_up(fd: impl AsFd, baud: u32, two_stop_bits: bool) -> Result<(), Errno> {
    let mut modes = tcgetattr(&fd)?;
    modes.make_raw();
    modes.control_modes.remove(ControlModes::CRTSCTS | ControlModes::PARENB);
    modes.control_modes.set(ControlModes::CSTOPB, two_stop_bits);
    modes.control_modes.insert(ControlModes::CREAD | ControlModes::CLOCAL | ControlModes::CS8);
    modes.set_speed(baud)?;
    tcsetattr(&fd, OptionalActions::Now, &modes)
}

/// Lines of axis controllers with what is under way on each.
#[derive(Debug)]
pub struct Lines {
    lines: Vec<Line>,
    answers: Vec<Partial>,
}

/// The most answers of one line that are kept apart: the last order's and late ones before it. What stood still for as
/// long as a bridge waits (20 periods) says it all at once, and only the last of it is of now.
const MOST_DUE: usize = 24;

/// Answers as far as they have come.
#[derive(Debug, Clone)]
struct Partial {
    bytes: [u8; MOST_DUE * STATUS],
    length: usize,
    dead: bool,
    /// How many may come: one, and those that earlier orders were not given.
    due: usize,
    /// The last one that came is known to be an earlier order's.
    late: bool,
}

impl Partial {
    /// Nothing is due.
    const NONE: Self =
        Self { bytes: [0; MOST_DUE * STATUS], length: 0, dead: false, due: 0, late: false };

    /// An order has gone out, or could not; so many answers are due now.
    fn begin(&mut self, due: usize, dead: bool) {
        (self.length, self.late) = (0, false);
        (self.due, self.dead) = (due, dead);
    }

    /// Whole answers.
    fn received(&self) -> usize {
        self.length / STATUS
    }

    /// Whether nothing more is to be expected.
    fn is_done(&self) -> bool {
        self.dead || self.received() == self.due
    }

    /// The last answer that is complete.
    fn answer(&self) -> Option<&[u8; STATUS]> {
        let last = self.received().checked_sub(1).filter(|_| !self.late)?;
        self.bytes[last * STATUS..].first_chunk()
    }

    /// How many are still to come, after `gone` bytes were thrown away.
    fn outstanding(&self, gone: usize) -> usize {
        if self.dead || (self.received() > 0 && !self.late) {
            return 0;
        }
        self.due.saturating_sub((self.length + gone) / STATUS)
    }
}

impl Lines {
    /// # Panics
    /// For more than [`MOST`] lines.
    #[must_use]
    pub fn new(lines: Vec<Line>) -> Self {
        assert!(lines.len() <= MOST, "at most {MOST} lines");
        let answers = vec![Partial::NONE; lines.len()];
        Self { lines, answers }
    }

    /// Name of a line's device.
    #[must_use]
    pub fn path(&self, line: usize) -> &str {
        self.lines[line].path()
    }

    /// Number of lines.
    #[must_use]
    pub fn len(&self) -> usize {
        self.lines.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }

    /// Sends an order; what an earlier one left behind is thrown away.
    pub fn send(&mut self, line: usize, order: &[u8; ORDER]) {
        let gone = self.lines[line].drain();
        let due = (self.answers[line].outstanding(gone) + 1).min(MOST_DUE);
        let dead = !self.lines[line].write(order);
        self.answers[line].begin(due, dead);
    }

    /// Waits until every line has answered, and no longer than the deadline. Where an answer is owed from before, the
    /// first one to come may be that, and another one is waited for: a lost answer costs that once.
    pub fn gather(&mut self, deadline: Instant) {
        // What came while this thread was kept from running counts: hence one look after the deadline.
        while !self.answers.iter().all(Partial::is_done) {
            let left = deadline.saturating_duration_since(Instant::now());
            self.wait(left);
            self.read();
            if left.is_zero() {
                return;
            }
        }
    }

    /// Whether a line's answer may be the one to the order before.
    #[must_use]
    pub fn is_doubtful(&self, line: usize) -> bool {
        self.answers[line].received() < self.answers[line].due
    }

    /// The line's answer was that of an earlier order: this order's is still to come.
    pub fn owe(&mut self, line: usize) {
        self.answers[line].late = true;
    }

    /// Whether a line is gone: nothing will ever come from it again.
    #[must_use]
    pub fn is_dead(&self, line: usize) -> bool {
        self.answers[line].dead
    }

    /// The answer of a line, if it is complete.
    #[must_use]
    pub fn answer(&self, line: usize) -> Option<&[u8; STATUS]> {
        self.answers[line].answer()
    }

    /// Sleeps until a line from which something may come has something to say.
    fn wait(&self, time: Duration) {
        let Some(first) = self.lines.first() else { return };
        let mut waiting = 0;
        let mut fds: [PollFd<'_>; MOST] =
            std::array::from_fn(|_| PollFd::new(&first.fd, PollFlags::IN));
        for (line, answer) in self.lines.iter().zip(&self.answers) {
            if !answer.is_done() {
                fds[waiting] = PollFd::new(&line.fd, PollFlags::IN);
                waiting += 1;
            }
        }
        let time = Timespec { tv_sec: 0, tv_nsec: time.as_nanos().min(999_999_999) as i64 };
        // An interruption ends the wait early, which the caller's loop takes care of.
        let _ = poll(&mut fds[..waiting], Some(&time));
    }

    fn read(&mut self) {
        for (line, answer) in self.lines.iter().zip(&mut self.answers) {
            if answer.is_done() {
                continue;
            }
            let room = answer.due * STATUS;
            match line.read(&mut answer.bytes[answer.length..room]) {
                Some(n) => answer.length += n,
                None => answer.dead = true,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hw::emulator::pty::Pty;

    /// A line whose first order was not answered in time, and then has its second.
    fn late() -> (Pty, Lines) {
        let far = Pty::open().unwrap();
        let near = Line::open(far.path(), AXIS_BAUD, true).unwrap();
        let mut lines = Lines::new(vec![near]);
        lines.send(0, &[0; ORDER]);
        lines.gather(Instant::now());
        assert_eq!(lines.answer(0), None);
        lines.send(0, &[0; ORDER]);
        (far, lines)
    }

    fn soon() -> Instant {
        Instant::now() + Duration::from_millis(500)
    }

    #[test]
    fn a_line_is_set_as_before_when_it_is_closed() {
        let far = Pty::open().unwrap();
        let look = || {
            let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
            let fd = rustix::fs::open(far.path(), flags, Mode::empty()).unwrap();
            let modes = tcgetattr(&fd).unwrap();
            (modes.output_speed(), modes.control_modes.contains(ControlModes::CSTOPB))
        };
        assert_eq!(look(), (38_400, false));

        let line = Line::open(far.path(), AXIS_BAUD, true).unwrap();
        assert_eq!(look(), (AXIS_BAUD, true));
        drop(line);

        assert_eq!(look(), (38_400, false));
    }

    #[test]
    fn an_answer_that_comes_after_the_next_order_gives_way_to_the_one_behind_it() {
        let (far, mut lines) = late();

        assert!(far.write(&[1; STATUS]) && far.write(&[2; STATUS]));
        lines.gather(soon());

        assert_eq!(lines.answer(0), Some(&[2; STATUS]));
    }

    #[test]
    fn after_a_lost_answer_the_next_one_counts() {
        let (far, mut lines) = late();

        assert!(far.write(&[2; STATUS]));
        lines.gather(Instant::now() + Duration::from_millis(20));

        assert_eq!(lines.answer(0), Some(&[2; STATUS]));
        assert!(lines.is_doubtful(0));
        // From then on nothing is owed.
        lines.send(0, &[0; ORDER]);
        assert!(far.write(&[3; STATUS]));
        lines.gather(soon());
        assert_eq!(lines.answer(0), Some(&[3; STATUS]));
        assert_eq!(lines.answers[0].due, 1);
    }

    #[test]
    fn however_many_answers_are_late_the_last_one_counts() {
        for orders in [3, 21] {
            let (far, mut lines) = late();
            for _ in 2..orders {
                lines.gather(Instant::now());
                lines.send(0, &[0; ORDER]);
            }

            assert!((1..=orders).all(|i| far.write(&[i; STATUS])));
            lines.gather(soon());

            assert_eq!(lines.answer(0), Some(&[orders; STATUS]));
        }
    }

    #[test]
    fn what_is_known_to_be_late_leaves_its_successor_owed() {
        let (far, mut lines) = late();
        assert!(far.write(&[1; STATUS]));
        lines.gather(Instant::now() + Duration::from_millis(20));

        lines.owe(0);
        lines.send(0, &[0; ORDER]);
        assert!(far.write(&[2; STATUS]) && far.write(&[3; STATUS]));
        lines.gather(soon());

        assert_eq!(lines.answer(0), Some(&[3; STATUS]));
        assert!(!lines.is_doubtful(0));
    }

    #[test]
    fn an_answer_that_came_before_the_next_order_is_thrown_away() {
        let far = Pty::open().unwrap();
        let near = Line::open(far.path(), AXIS_BAUD, true).unwrap();
        let mut lines = Lines::new(vec![near]);
        lines.send(0, &[0; ORDER]);
        lines.gather(Instant::now());
        assert!(far.write(&[1; STATUS]));
        // A pseudo-terminal hands over in its own time.
        lines.wait(Duration::from_secs(5));

        lines.send(0, &[0; ORDER]);
        assert!(far.write(&[2; STATUS]));
        lines.gather(soon());

        assert_eq!(lines.answer(0), Some(&[2; STATUS]));
        assert_eq!(lines.answers[0].due, 1);
    }
}
