//! Injected faults of the device on which a file is stored.
//!
//! - in: the [`StorageFault`] that the device has at present; the bytes of each write
//! - out: the write, as a device with this fault carries it out
//!
//! | fault | bytes on the device | result |
//! |---|---|---|
//! | none | all | that of the device |
//! | [`StorageFault::Full`] | none | no storage space |
//! | [`StorageFault::Broken`] | none | input/output error |
//! | [`StorageFault::Torn`] | the first half | input/output error |
//! | [`StorageFault::Lost`] | none | success |

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

/// Fault of a storage device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum StorageFault {
    /// The device has no space left.
    Full = 1,
    /// Writes fail.
    Broken,
    /// Writes fail halfway: the first half of the bytes is on the device.
    Torn,
    /// Writes are reported as successful, but leave no byte on the device.
    Lost,
}

/// Storage of one file, with the fault that it has at present. Clones share the fault, so that the
/// injector can set it while the writer of the file works.
#[derive(Debug, Clone, Default)]
pub struct Storage(Arc<AtomicU8>);

impl Storage {
    /// Sets the present fault; `None` repairs the device.
    pub fn set(&self, fault: Option<StorageFault>) {
        self.0.store(fault.map_or(0, |fault| fault as u8), Ordering::Release);
    }

    /// Returns the present fault.
    #[must_use]
    pub fn fault(&self) -> Option<StorageFault> {
        use StorageFault as F;
        let faults = [F::Full, F::Broken, F::Torn, F::Lost];
        let present = self.0.load(Ordering::Acquire);
        faults.into_iter().find(|&fault| fault as u8 == present)
    }

    /// Writes `bytes` by `write`, as the device with its present fault does.
    ///
    /// # Errors
    /// Error of `write`, or of the fault.
    pub fn write<E: From<io::Error>>(
        &self,
        bytes: &[u8],
        write: impl FnOnce(&[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        // The number of the error, so that messages have the words of the operating system.
        let broken = || E::from(io::Error::from_raw_os_error(libc::EIO));
        match self.fault() {
            None => write(bytes),
            Some(StorageFault::Full) => Err(io::Error::from_raw_os_error(libc::ENOSPC).into()),
            Some(StorageFault::Broken) => Err(broken()),
            Some(StorageFault::Torn) => write(&bytes[..bytes.len() / 2]).and(Err(broken())),
            Some(StorageFault::Lost) => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_leaves_its_bytes_and_result() {
        let (storage, injector) = {
            let storage = Storage::default();
            (storage.clone(), storage)
        };
        let full = Some(libc::ENOSPC);
        let cases = [
            (None, &b"abcd"[..], Ok(())),
            (Some(StorageFault::Full), b"", Err(full)),
            (Some(StorageFault::Broken), b"", Err(Some(libc::EIO))),
            (Some(StorageFault::Torn), b"ab", Err(Some(libc::EIO))),
            (Some(StorageFault::Lost), b"", Ok(())),
            (None, b"abcd", Ok(())),
        ];
        for (fault, left, result) in cases {
            injector.set(fault);
            let mut device = Vec::new();
            let written = storage.write(b"abcd", |bytes| {
                device.extend_from_slice(bytes);
                Ok::<_, io::Error>(())
            });
            assert_eq!(written.map_err(|why| why.raw_os_error()), result, "{fault:?}");
            assert_eq!((device.as_slice(), storage.fault()), (left, fault));
        }
    }
}
