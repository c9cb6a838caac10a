//! The registers of a real card by the processor's port instructions, and its interrupt by
//! `/dev/uio`.
#![allow(unsafe_code, reason = "no safe call exists for I/O port instructions and `ioperm`")]

use super::registers::{Registers, port};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use std::os::fd::OwnedFd;
use std::time::Duration;

/// The ports of a card or of another board.
#[derive(Debug)]
pub struct PortIo {
    /// Offset of every port, which differs between the cards of a machine.
    offset: u16,
    /// Device of the interrupt; each read returns the number of interrupts. Without it the card
    /// counts as alive.
    interrupts: Option<OwnedFd>,
}

impl PortIo {
    /// Asks the operating system for access to the card's I/O ports. `uio` is the device of its
    /// interrupt, for example `/dev/uio0`.
    ///
    /// # Errors
    /// A text for the operator that names the denied ports, or the device that cannot be opened.
    pub fn open(offset: u16, uio: Option<&str>) -> Result<Self, String> {
        ask(port::COMMAND, offset, 12)?;
        ask(port::AXIS, offset, 1)?;
        let open = |path: &str| {
            let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
            rustix::fs::open(path, flags, Mode::empty()).map_err(|e| format!("{path}: {e}"))
        };
        Ok(Self { offset, interrupts: uio.map(open).transpose()? })
    }

    /// Asks the operating system for access to the `count` I/O ports of another board, the first of
    /// which is `base`. Its registers are then numbered from 0.
    ///
    /// # Errors
    /// A text that names the denied ports.
    pub fn board(base: u16, count: u16) -> Result<Self, String> {
        ask(0, base, count)?;
        Ok(Self { offset: base, interrupts: None })
    }
}

/// Asks the operating system for access to `count` I/O ports from `from + offset` on. The calling
/// thread gets the access, and so do the threads that it starts later.
fn ask(from: u16, offset: u16, count: u16) -> Result<(), String> {
    let from = u64::from(from) + u64::from(offset);
    // SAFETY: asks for a right; no memory is passed.
    if unsafe { libc::ioperm(from, u64::from(count), 1) } == 0 {
        return Ok(());
    }
    let error = std::io::Error::last_os_error();
    Err(format!("no access to I/O ports from {from:#x} (ioperm, needs CAP_SYS_RAWIO): {error}"))
}

impl Registers for PortIo {
    fn read8(&mut self, at: u16) -> u8 {
        let value: u8;
        // SAFETY: the port is one of those asked for; the instruction touches no memory.
        unsafe {
            std::arch::asm!("in al, dx", in("dx") at + self.offset, out("al") value,
                options(nomem, nostack, preserves_flags));
        }
        value
    }

    fn write8(&mut self, at: u16, value: u8) {
        // SAFETY: the port is one of those asked for; the instruction touches no memory.
        unsafe {
            std::arch::asm!("out dx, al", in("dx") at + self.offset, in("al") value,
                options(nomem, nostack, preserves_flags));
        }
    }

    fn write16(&mut self, at: u16, value: u16) {
        // SAFETY: as above.
        unsafe {
            std::arch::asm!("out dx, ax", in("dx") at + self.offset, in("ax") value,
                options(nomem, nostack, preserves_flags));
        }
    }

    fn read16(&mut self, at: u16) -> u16 {
        let value: u16;
        // SAFETY: as above.
        unsafe {
            std::arch::asm!("in ax, dx", in("dx") at + self.offset, out("ax") value,
                options(nomem, nostack, preserves_flags));
        }
        value
    }

    fn interrupted(&mut self, within: Duration) -> bool {
        let Some(fd) = &self.interrupts else { return true };
        // The wait is always below a second, so the whole of it is in the nanoseconds.
        let time = Timespec { tv_sec: 0, tv_nsec: within.subsec_nanos().into() };
        let _ = poll(&mut [PollFd::new(fd, PollFlags::IN)], Some(&time));
        let mut count = [0; 4];
        let came = matches!(rustix::io::read(fd, &mut count), Ok(4));
        if came {
            // Some kernel drivers mask the interrupt until this write enables it again. The others
            // refuse the write, which does no harm.
            let _ = rustix::io::write(fd, &1u32.to_ne_bytes());
        }
        came
    }

    fn pause(&mut self) {
        std::thread::sleep(Duration::from_millis(2));
    }
}
