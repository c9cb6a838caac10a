//! The registers of a real card, by the processor's port instructions, and its interrupt by `/dev/uio`.
#![allow(unsafe_code, reason = "port instructions and the right to use them exist in no safe form")]

use super::registers::{Registers, port};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use std::os::fd::OwnedFd;
use std::time::Duration;

/// A card, or another board with ports.
#[derive(Debug)]
pub struct PortIo {
    /// Added to every port: cards of the same machine lie apart.
    offset: u16,
    /// Tells of interrupts by the number of them; without it the card counts as alive.
    interrupts: Option<OwnedFd>,
}

impl PortIo {
    /// Asks for the card's ports; `uio` is the device of its interrupt, as `/dev/uio0`.
    ///
    /// # Errors
    /// What was denied, for people.
    pub fn open(offset: u16, uio: Option<&str>) -> Result<Self, String> {
        ask(port::COMMAND, offset, 12)?;
        ask(port::AXIS, offset, 1)?;
        let open = |path: &str| {
            rustix::fs::open(path, OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())
                .map_err(|e| format!("{path}: {e}"))
        };
        Ok(Self { offset, interrupts: uio.map(open).transpose()? })
    }

    /// Asks for the ports of another board; its registers are then numbered from 0.
    ///
    /// # Errors
    /// As above.
    pub fn board(base: u16, count: u16) -> Result<Self, String> {
        ask(0, base, count)?;
        Ok(Self { offset: base, interrupts: None })
    }
}

/// Asks for the right to ports; it belongs to this thread and those that it starts.
fn ask(from: u16, offset: u16, count: u16) -> Result<(), String> {
    let from = u64::from(from) + u64::from(offset);
    // SAFETY: asks for a right; no memory is passed.
    if unsafe { libc::ioperm(from, u64::from(count), 1) } == 0 {
        return Ok(());
    }
    let error = std::io::Error::last_os_error();
    Err(format!("ports from {from:#x} (ioperm, needs CAP_SYS_RAWIO): {error}"))
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
        let time = Timespec { tv_sec: 0, tv_nsec: within.subsec_nanos().into() };
        let _ = poll(&mut [PollFd::new(fd, PollFlags::IN)], Some(&time));
        let mut count = [0; 4];
        let came = matches!(rustix::io::read(fd, &mut count), Ok(4));
        if came {
            // A driver of the kernel that masks the interrupt until it was served takes it up again by this; one that
            // does not refuses, which is no matter.
            let _ = rustix::io::write(fd, &1u32.to_ne_bytes());
        }
        came
    }

    fn pause(&mut self) {
        std::thread::sleep(Duration::from_millis(2));
    }
}
