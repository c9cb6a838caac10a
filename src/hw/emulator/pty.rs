//! The far end of a serial line: a pseudo-terminal whose near end a bridge opens by its path.

use crate::hw::serial::set_up;
use rustix::fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::{ioctl_fionread, read, write};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

/// A pseudo-terminal.
#[derive(Debug)]
pub struct Pty {
    master: OwnedFd,
    /// Near end, kept open so that the line does not hang up while no bridge has it open.
    _near: OwnedFd,
    path: String,
}

impl Pty {
    /// Opens a pseudo-terminal.
    ///
    /// # Errors
    /// Returns the error of the operating system.
    pub fn open() -> std::io::Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let path = ptsname(&master, Vec::new())?
            .into_string()
            .map_err(|_| std::io::Error::other("the pseudo-terminal's name is not UTF-8"))?;
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let near = rustix::fs::open(path.as_str(), flags, Mode::empty())?;
        // Raw from the start: in cooked mode the terminal would echo an order as its own answer.
        set_up(&near, 38_400, false)?;
        // One thread serves all lines, so no line may block it.
        fcntl_setfl(&master, fcntl_getfl(&master)? | OFlags::NONBLOCK)?;
        Ok(Self { master, _near: near, path })
    }

    /// Returns the path by which a bridge opens its end of the line.
    #[must_use]
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Returns the number of bytes from the bridge that wait to be read.
    #[must_use]
    pub fn waiting(&self) -> usize {
        ioctl_fionread(&self.master).unwrap_or(0) as usize
    }

    /// Reads the bytes that have come. Returns their number, 0 if there are none.
    #[must_use]
    pub fn read(&self, into: &mut [u8]) -> usize {
        read(&self.master, into).unwrap_or(0)
    }

    /// Writes bytes. Returns whether all of them were written.
    #[must_use]
    pub fn write(&self, bytes: &[u8]) -> bool {
        matches!(write(&self.master, bytes), Ok(n) if n == bytes.len())
    }
}

impl AsFd for Pty {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.master.as_fd()
    }
}
