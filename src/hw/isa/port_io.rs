//! The registers of a real card, by the processor's port instructions, and its interrupt by `/dev/uio`.
#![allow(unsafe_code, reason = "port instructions and the right to use them exist in no safe form")]

use super::registers::{Registers, port};
use rustix::fs::{Mode, OFlags};
use std::os::fd::OwnedFd;

/// A card.
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
        for (from, count) in [(port::COMMAND + offset, 12), (port::AXIS + offset, 1)] {
            // SAFETY: asks for a right; no memory is passed.
            let denied = unsafe { libc::ioperm(u64::from(from), count, 1) } != 0;
            if denied {
                let error = std::io::Error::last_os_error();
                return Err(format!("ports from {from:#x} (ioperm, needs CAP_SYS_RAWIO): {error}"));
            }
        }
        let open = |path: &str| {
            rustix::fs::open(
                path,
                OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC,
                Mode::empty(),
            )
            .map_err(|e| format!("{path}: {e}"))
        };
        Ok(Self { offset, interrupts: uio.map(open).transpose()? })
    }
}

impl Registers for PortIo {
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

    fn interrupted(&mut self) -> bool {
        let mut count = [0; 4];
        self.interrupts.as_ref().is_none_or(|fd| matches!(rustix::io::read(fd, &mut count), Ok(4)))
    }
}
