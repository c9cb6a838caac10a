//! Serial lines that are served together: all orders go out and all answers come in before one
//! deadline.
//!
//! - The lines are file descriptors that never block. An exchange allocates no memory.
//! - Answers have no number. If an answer that is one period old were taken for a new one, a fast
//!   axis would seem to stop and then to jump. So a late answer is thrown away before the next
//!   order is sent. If it comes even later, the next answer replaces it.

use super::frame::{ORDER, STATUS};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FileType, FlockOperation, Mode, OFlags, Stat, fstat, major, minor, stat};
use rustix::io::{Errno, read, write};
use rustix::termios::{
    ControlModes, OptionalActions, QueueSelector, Termios, ioctl_tiocexcl, ioctl_tiocnxcl, tcflush,
    tcgetattr, tcsetattr,
};
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::time::{Duration, Instant};

/// Speed of the axis controllers' lines (bit/s).
pub const AXIS_BAUD: u32 = 921_600;
/// Largest number of lines that are served together.
pub const MOST: usize = 32;

/// A serial line that never blocks. When it is closed, its former settings return.
#[derive(Debug)]
pub struct Line {
    path: String,
    fd: OwnedFd,
    /// Former settings, if they could be read.
    before: Option<Termios>,
}

impl Line {
    /// Opens a device with 8 data bits, no parity and 1 or 2 stop bits, and throws away waiting
    /// bytes. Other programs cannot open it meanwhile. A path that leads to no serial line is not
    /// opened.
    ///
    /// # Errors
    /// Returns the error of the operating system with the name of the device.
    pub fn open(path: &str, baud: u32, two_stop_bits: bool) -> Result<Self, String> {
        let fail = |what: &str, errno: Errno| format!("{path}: {what}: {errno}");
        let no_line = || format!("{path}: not a serial line: name the device of an axis or sensor");
        let found = stat(path).map_err(|e| fail("open", e))?;
        if !is_line(&found) {
            return Err(no_line());
        }
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let fd = rustix::fs::open(path, flags, Mode::empty()).map_err(|e| fail("open", e))?;
        // The name may have been given to another file meanwhile.
        let opened = fstat(&fd).map_err(|e| fail("open", e))?;
        if (opened.st_rdev, opened.st_mode) != (found.st_rdev, found.st_mode) {
            return Err(no_line());
        }
        // Two programs on one line would drive the axis in turn.
        rustix::fs::flock(&fd, FlockOperation::NonBlockingLockExclusive)
            .map_err(|_| format!("{path}: another program has it open: close that program"))?;
        // A pseudo-terminal would stay claimed after a crash, because the emulator has it open.
        if !is_pseudo(&found) {
            claim(&fd).map_err(|e| fail("not a serial line", e))?;
        }
        let line = Self { path: path.to_owned(), before: tcgetattr(&fd).ok(), fd };
        set_up(&line.fd, baud, two_stop_bits).map_err(|e| fail("not a serial line", e))?;
        tcflush(&line.fd, QueueSelector::IOFlush).map_err(|e| fail("flush", e))?;
        Ok(line)
    }

    /// Returns the name of the device.
    #[must_use]
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Throws away the bytes that have come and returns their number.
    #[must_use]
    pub fn drain(&self) -> usize {
        let mut rest = [0; 64];
        let mut gone = 0;
        // The number of reads is limited: a line that sends without end must not delay the period.
        for _ in 0..8 {
            let Ok(n) = read(&self.fd, &mut rest) else { break };
            gone += n;
            if n < rest.len() {
                break;
            }
        }
        gone
    }

    /// Writes bytes. Returns whether all of them were written.
    #[must_use]
    pub fn write(&self, bytes: &[u8]) -> bool {
        matches!(write(&self.fd, bytes), Ok(n) if n == bytes.len())
    }

    /// Reads the bytes that have come. Returns their number, 0 if there are none, and `None` if the
    /// line is dead.
    pub fn read(&self, into: &mut [u8]) -> Option<usize> {
        match read(&self.fd, into) {
            // Only a pseudo-terminal whose other end was closed reports an end.
            Ok(0) => None,
            Ok(n) => Some(n),
            Err(Errno::AGAIN | Errno::INTR) => Some(0),
            Err(_) => None,
        }
    }
}

impl Drop for Line {
    /// Restores the former settings of the line and opens it to other programs.
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            // The last orders must leave at the speed for which they were written, which takes 0.4
            // ms. Waiting until the line is empty might take for ever.
            std::thread::sleep(Duration::from_millis(5));
            // A line that is dead has no settings, so an error is ignored.
            let _ = tcsetattr(&self.fd, OptionalActions::Now, before);
        }
        let _ = release(&self.fd);
    }
}

/// Returns whether a path leads to a serial line. It is not opened, because the opening of another
/// device may have effects: a watchdog starts, a tape rewinds.
///
/// # Errors
/// The error of the operating system.
pub(crate) fn leads_to_line(path: &Path) -> Result<bool, Errno> {
    stat(path).map(|found| is_line(&found))
}

/// Returns whether a file with this metadata is a serial line or a pseudo-terminal.
fn is_line(found: &Stat) -> bool {
    if FileType::from_raw_mode(found.st_mode) != FileType::CharacterDevice {
        return false;
    }
    let kernel = Path::new("/sys/dev/char");
    let number = format!("{}:{}", major(found.st_rdev), minor(found.st_rdev));
    let class = std::fs::read_link(kernel.join(number).join("subsystem"));
    // Without the kernel's folder only the settings of the open line can tell.
    let is_tty = class.map_or_else(|_| !kernel.exists(), |class| class.ends_with("tty"));
    is_pseudo(found) || is_tty
}

/// Returns whether a character device is the near end of a pseudo-terminal, which the kernel's
/// folder of devices does not list. The numbers are those of the kernel's `devices.txt`.
fn is_pseudo(found: &Stat) -> bool {
    (136..=143).contains(&major(found.st_rdev))
}

/// Closes a serial line to programs that ignore its lock, such as a modem manager, until it is
/// released or closed.
fn claim(fd: impl AsFd) -> Result<(), Errno> {
    ioctl_tiocexcl(fd)
}

/// Opens a claimed serial line to other programs again.
fn release(fd: impl AsFd) -> Result<(), Errno> {
    ioctl_tiocnxcl(fd)
}

/// Sets a serial line to raw bytes at `baud` (bit/s), without parity and flow control.
pub(crate) fn set_up(fd: impl AsFd, baud: u32, two_stop_bits: bool) -> Result<(), Errno> {
    let mut modes = tcgetattr(&fd)?;
    modes.make_raw();
    modes.control_modes.remove(ControlModes::CRTSCTS | ControlModes::PARENB);
    modes.control_modes.set(ControlModes::CSTOPB, two_stop_bits);
    modes.control_modes.insert(ControlModes::CREAD | ControlModes::CLOCAL | ControlModes::CS8);
    modes.set_speed(baud)?;
    tcsetattr(&fd, OptionalActions::Now, &modes)
}

/// Lines of axis controllers, with the answers that are being received.
#[derive(Debug)]
pub struct Lines {
    lines: Vec<Line>,
    answers: Vec<Partial>,
}

/// Largest number of answers of one line that are kept apart: the last order's and the late ones
/// before it. A device that was stopped for as long as a bridge waits (20 periods) sends all
/// answers at once, and only the last one is up to date.
const MOST_DUE: usize = 24;

/// Answers of a line, as far as they have come.
#[derive(Debug, Clone)]
struct Partial {
    bytes: [u8; MOST_DUE * STATUS],
    length: usize,
    dead: bool,
    /// Number of answers that may come: one, and those of earlier orders that were not answered.
    due: usize,
    /// Whether the last answer that came belongs to an earlier order.
    late: bool,
}

impl Partial {
    /// State before the first order.
    const NONE: Self =
        Self { bytes: [0; MOST_DUE * STATUS], length: 0, dead: false, due: 0, late: false };

    /// Starts to receive after an order. `due` answers may come; the line is `dead` if the order
    /// could not be written.
    fn begin(&mut self, due: usize, dead: bool) {
        (self.length, self.late) = (0, false);
        (self.due, self.dead) = (due, dead);
    }

    /// Returns the number of complete answers.
    fn received(&self) -> usize {
        self.length / STATUS
    }

    /// Returns whether no more bytes are expected.
    fn is_done(&self) -> bool {
        self.dead || self.received() == self.due
    }

    /// Returns the last complete answer, unless it is late.
    fn answer(&self) -> Option<&[u8; STATUS]> {
        let last = self.received().checked_sub(1).filter(|_| !self.late)?;
        self.bytes[last * STATUS..].first_chunk()
    }

    /// Returns the number of answers that are still to come, after `gone` more bytes were thrown
    /// away.
    fn outstanding(&self, gone: usize) -> usize {
        // Answers keep their order. So once an answer has come in time, those that are missing
        // before it are lost and not late.
        if self.dead || (self.received() > 0 && !self.late) {
            return 0;
        }
        self.due.saturating_sub((self.length + gone) / STATUS)
    }
}

impl Lines {
    /// Joins lines that are served together. The other methods name each by its index in `lines`.
    ///
    /// # Panics
    /// Panics for more than [`MOST`] lines.
    #[must_use]
    pub fn new(lines: Vec<Line>) -> Self {
        assert!(lines.len() <= MOST, "at most {MOST} lines");
        let answers = vec![Partial::NONE; lines.len()];
        Self { lines, answers }
    }

    /// Returns the name of a line's device.
    #[must_use]
    pub fn path(&self, line: usize) -> &str {
        self.lines[line].path()
    }

    /// Returns the number of serial lines.
    #[must_use]
    pub fn len(&self) -> usize {
        self.lines.len()
    }

    /// Returns whether there are no lines.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }

    /// Throws away the bytes that have come from a line, which belong to earlier answers, and sends
    /// the order.
    pub fn send(&mut self, line: usize, order: &[u8; ORDER]) {
        let gone = self.lines[line].drain();
        // Bytes that are thrown away here are answers that no longer have to come.
        let due = (self.answers[line].outstanding(gone) + 1).min(MOST_DUE);
        let dead = !self.lines[line].write(order);
        self.answers[line].begin(due, dead);
    }

    /// Waits until every line has answered, at most until the deadline.
    ///
    /// If an earlier answer is still due, the first answer to come may be that one, so a second one
    /// is waited for. A lost answer costs this wait once.
    pub fn gather(&mut self, deadline: Instant) {
        // Bytes that came while this thread was delayed count, so it reads once after the deadline.
        while !self.answers.iter().all(Partial::is_done) {
            let left = deadline.saturating_duration_since(Instant::now());
            self.wait(left);
            self.read();
            if left.is_zero() {
                return;
            }
        }
    }

    /// Returns whether the answer of a line may belong to an earlier order.
    #[must_use]
    pub fn may_be_late(&self, line: usize) -> bool {
        self.answers[line].received() < self.answers[line].due
    }

    /// Marks the answer of a line as that of an earlier order, so that the last order's is still
    /// due.
    pub fn mark_late(&mut self, line: usize) {
        self.answers[line].late = true;
    }

    /// Returns whether a line is dead, so that no answer will ever come from it.
    #[must_use]
    pub fn is_dead(&self, line: usize) -> bool {
        self.answers[line].dead
    }

    /// Returns the answer to a line's last order, if it is complete and was not marked as late.
    #[must_use]
    pub fn answer(&self, line: usize) -> Option<&[u8; STATUS]> {
        self.answers[line].answer()
    }

    /// Sleeps until bytes come from a line that is not done, at most for `time`.
    fn wait(&self, time: Duration) {
        let Some(first) = self.lines.first() else { return };
        // The array has a fixed size, and its unused entries are not polled.
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
        // An interruption ends the wait early, and the loop of the caller waits again.
        let _ = poll(&mut fds[..waiting], Some(&time));
    }

    /// Reads the bytes that have come from all lines.
    fn read(&mut self) {
        for (line, answer) in self.lines.iter().zip(&mut self.answers) {
            if answer.is_done() {
                continue;
            }
            // Bytes beyond the answers that are due stay in the line and are thrown away with the
            // next order.
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

    /// Makes a line that did not answer its first order in time, and has received its second one.
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

    /// Returns a deadline that leaves a test enough time for its answers.
    fn soon() -> Instant {
        Instant::now() + Duration::from_millis(500)
    }

    /// The reader of a named pipe (FIFO) sees whether the pipe was ever opened for writing.
    #[test]
    fn path_without_serial_line_is_not_opened() {
        use rustix::fs::{CWD, mknodat};
        let fifo = std::env::temp_dir().join(format!("rubik-line-{}", std::process::id()));
        mknodat(CWD, &fifo, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let reader = rustix::fs::open(&fifo, flags, Mode::empty()).unwrap();
        let folder = std::env::temp_dir();

        for path in [&fifo, Path::new("/dev/null"), Path::new("/dev/zero"), &folder] {
            let why = Line::open(path.to_str().unwrap(), AXIS_BAUD, true).unwrap_err();
            assert!(why.contains("not a serial line: name"), "{why}");
            assert_eq!(leads_to_line(path), Ok(false));
        }

        let mut waits = [PollFd::new(&reader, PollFlags::IN)];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        poll(&mut waits, Some(&now)).unwrap();
        assert!(waits[0].revents().is_empty(), "it was opened: {:?}", waits[0].revents());
        std::fs::remove_file(&fifo).unwrap();
        let far = Pty::open().unwrap();
        assert_eq!(leads_to_line(Path::new(far.path())), Ok(true));
        assert!(leads_to_line(Path::new("/dev/nosuch")).is_err());
    }

    /// Returns whether a terminal is claimed: no other program except root's can open it.
    #[allow(unsafe_code, reason = "no safe call reads the flag")]
    fn is_claimed(fd: &OwnedFd) -> bool {
        use std::os::fd::AsRawFd as _;
        let mut claimed: libc::c_int = 0;
        // SAFETY: the kernel writes one number of this type.
        assert_eq!(unsafe { libc::ioctl(fd.as_raw_fd(), libc::TIOCGEXCL, &raw mut claimed) }, 0);
        claimed != 0
    }

    /// The claim is a flag of the terminal. A line on a pseudo-terminal is not claimed when it is
    /// opened: the emulator keeps the terminal open, so the flag would outlive a killed run.
    #[test]
    fn claimed_line_is_closed_to_others() {
        let far = Pty::open().unwrap();
        let line = Line::open(far.path(), AXIS_BAUD, true).unwrap();
        assert!(!is_claimed(&line.fd));

        claim(&line.fd).unwrap();
        assert!(is_claimed(&line.fd));
        release(&line.fd).unwrap();

        assert!(!is_claimed(&line.fd));
    }

    #[test]
    fn closed_line_has_its_former_settings() {
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

    /// The first of two answers belongs to the first order.
    #[test]
    fn late_answer_is_replaced_by_the_next() {
        let (far, mut lines) = late();

        assert!(far.write(&[1; STATUS]) && far.write(&[2; STATUS]));
        lines.gather(soon());

        assert_eq!(lines.answer(0), Some(&[2; STATUS]));
    }

    #[test]
    fn answer_after_lost_answer_is_accepted() {
        let (far, mut lines) = late();

        assert!(far.write(&[2; STATUS]));
        lines.gather(Instant::now() + Duration::from_millis(20));

        assert_eq!(lines.answer(0), Some(&[2; STATUS]));
        assert!(lines.may_be_late(0));
        // From then on no earlier answer is due.
        lines.send(0, &[0; ORDER]);
        assert!(far.write(&[3; STATUS]));
        lines.gather(soon());
        assert_eq!(lines.answer(0), Some(&[3; STATUS]));
        assert_eq!(lines.answers[0].due, 1);
    }

    /// A device that was stopped answers all orders at once.
    #[test]
    fn last_of_many_late_answers_is_used() {
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

    /// If the one answer that came was late, two are due after the next order.
    #[test]
    fn line_expects_two_answers_after_a_late_one() {
        let (far, mut lines) = late();
        assert!(far.write(&[1; STATUS]));
        lines.gather(Instant::now() + Duration::from_millis(20));

        lines.mark_late(0);
        lines.send(0, &[0; ORDER]);
        assert!(far.write(&[2; STATUS]) && far.write(&[3; STATUS]));
        lines.gather(soon());

        assert_eq!(lines.answer(0), Some(&[3; STATUS]));
        assert!(!lines.may_be_late(0));
    }

    #[test]
    fn late_answer_is_dropped_before_next_order() {
        let far = Pty::open().unwrap();
        let near = Line::open(far.path(), AXIS_BAUD, true).unwrap();
        let mut lines = Lines::new(vec![near]);
        lines.send(0, &[0; ORDER]);
        lines.gather(Instant::now());
        assert!(far.write(&[1; STATUS]));
        // A pseudo-terminal delivers bytes with a delay.
        lines.wait(Duration::from_secs(5));

        lines.send(0, &[0; ORDER]);
        assert!(far.write(&[2; STATUS]));
        lines.gather(soon());

        assert_eq!(lines.answer(0), Some(&[2; STATUS]));
        assert_eq!(lines.answers[0].due, 1);
    }
}
