//! The file of a table: a head of 4096 bytes, then the table.
//!
//! | bytes | content |
//! |---|---|
//! | 0..8 | `RRtable` and a line feed |
//! | 8..12 | 0x0a0b0c0d in the byte order of the writer, as all numbers |
//! | 12..16 | version of this format |
//! | 16..20 | version of the table |
//! | 20..24 | CRC-32 of the table |
//! | 24..32 | size of the table (bytes) |
//! | 32..36 | CRC-32 of the head, with these four bytes as 0 |
//! | 64..128 | name of the table, padded with 0 |

use crate::hw::new_file::{self, Sync};
use crate::hw::text;
use crate::solver::table::{TableSpec, Workers};
use crate::solver::tables::Bytes;
use crc32fast::Hasher;
use memmap2::{Advice, Mmap, MmapMut};
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Size of the head: one page, so that the table begins on a page (bytes).
const HEAD: usize = 4096;
const MAGIC: &[u8; 8] = b"RRtable\n";
const MARK: u32 = 0x0a0b_0c0d;
const FORMAT: u32 = 1;
/// Size of the piece that one task reads or sums (bytes).
const PIECE: usize = 16 << 20;

/// Age from which on any later change of a file changes its time as well.
const SETTLED: Duration = Duration::from_secs(1);

/// Reason why the file of a table is unusable.
#[derive(Debug, thiserror::Error)]
pub enum Unusable {
    /// No file.
    #[error("not built yet")]
    Absent,
    /// Error of the operating system.
    #[error("the table's file cannot be read: {0}")]
    Unreadable(#[from] io::Error),
    /// Wrong size of the file.
    #[error("the table's file has {found} bytes instead of {wanted}")]
    Size {
        /// Size of the file (bytes).
        found: u64,
        /// Size that it should have (bytes).
        wanted: u64,
    },
    /// File of another program.
    #[error("the table's file was not written by rubik-robot")]
    Foreign,
    /// File of a machine with the other byte order.
    #[error("the table's file was written on a machine of the other byte order")]
    ByteOrder,
    /// File of another version of the program.
    #[error("the table's file has version {found} instead of {wanted}")]
    Version {
        /// Version of the file.
        found: u32,
        /// Version that it should have.
        wanted: u32,
    },
    /// Head whose checksum, name or size is wrong.
    #[error("the table's file has a damaged head")]
    Head,
    /// Bytes that differ from those that were written.
    #[error("the table's file is damaged: the checksum is {found:08x} instead of {wanted:08x}")]
    Checksum {
        /// Checksum of the bytes.
        found: u32,
        /// Checksum that the head has.
        wanted: u32,
    },
    /// Bytes as they were written, but with wrong counts.
    #[error("the table's file has wrong contents: {0}")]
    Miscounted(String),
}

/// Location of the bytes of a table while they are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Residence {
    /// Mapped file: available at once and shared by all processes.
    #[default]
    Mapped,
    /// Copy in memory with large pages, which few systems have for files. It takes a second for 1.4
    /// GiB and makes a search, which reads at random, a quarter faster.
    Copied,
}

/// A mapped file; its bytes are those after the head.
#[derive(Debug)]
struct Mapped(Mmap);

impl AsRef<[u8]> for Mapped {
    fn as_ref(&self) -> &[u8] {
        &self.0[HEAD..]
    }
}

/// A copied table.
#[derive(Debug)]
struct Copied(MmapMut);

impl AsRef<[u8]> for Copied {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

/// Opens the file of a table and checks its size, its head and the checksum of the table. Returns
/// the table, mapped or copied into memory.
pub(super) fn open(
    path: &Path,
    spec: &TableSpec,
    residence: Residence,
    workers: &dyn Workers,
) -> Result<Bytes, Unusable> {
    let mut file = text::open(path).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => Unusable::Absent,
        _ => Unusable::Unreadable(error),
    })?;
    // The cheap checks first, size and head, because a mapping of a short file faults when it is
    // read.
    let found = file.metadata()?.len();
    let wanted = (HEAD + spec.bytes) as u64;
    if found != wanted {
        return Err(Unusable::Size { found, wanted });
    }
    let mut head = [0; HEAD];
    file.read_exact(&mut head)?;
    let checksum = check_head(&head, spec)?;
    let bytes: Bytes = match residence {
        Residence::Mapped => Arc::new(Mapped(map(&file)?)),
        Residence::Copied => Arc::new(Copied(copy(&file, spec.bytes, workers)?)),
    };
    // An equal note says that this very file had the right checksum before.
    let note = note(&file, checksum)?;
    let noted = text::open_text(&note_path(path), HEAD as u64);
    if noted.ok().is_none_or(|(_, text)| text != note) {
        let found = sum((*bytes).as_ref(), workers);
        if found != checksum {
            return Err(Unusable::Checksum { found, wanted: checksum });
        }
        // A file whose note cannot be written is summed again next time. So is a very young file:
        // the clock of the file system ticks every few milliseconds, so a change in the same tick
        // would leave the time as it is.
        let age = file.metadata()?.modified()?.elapsed().unwrap_or_default();
        if age > SETTLED {
            let _ = new_file::replace(&note_path(path), ".tmp", note.as_bytes(), Sync::No);
        }
    }
    Ok(bytes)
}

/// Maps a file into memory.
#[allow(
    unsafe_code,
    reason = "a mapped file must not change: the store only replaces whole files, by renaming"
)]
fn map(file: &File) -> io::Result<Mmap> {
    let mapped = unsafe { Mmap::map(file)? };
    // Both are hints, and a kernel may ignore them: no read-ahead, and large pages.
    let _ = mapped.advise(Advice::Random);
    #[cfg(target_os = "linux")]
    let _ = mapped.advise(Advice::HugePage);
    Ok(mapped)
}

/// Copies the table of a file into memory, with large pages where the system has them. Workers read
/// its pieces in parallel.
fn copy(file: &File, bytes: usize, workers: &dyn Workers) -> io::Result<MmapMut> {
    let mut memory = MmapMut::map_anon(bytes)?;
    #[cfg(target_os = "linux")]
    let _ = memory.advise(Advice::HugePage);
    let failed = Mutex::new(None);
    let pieces: Vec<Mutex<&mut [u8]>> = memory.chunks_mut(PIECE).map(Mutex::new).collect();
    workers.run(pieces.len(), &|i| {
        let mut piece = pieces[i].lock().unwrap_or_else(PoisonError::into_inner);
        if let Err(error) = file.read_exact_at(&mut piece, (HEAD + i * PIECE) as u64) {
            *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
        }
    });
    drop(pieces);
    match failed.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(error) => Err(error),
        None => Ok(memory),
    }
}

/// Writes a table to a temporary file in the folder of `path`, then renames that file to `path`.
pub(super) fn write(
    path: &Path,
    spec: &TableSpec,
    table: &[u8],
    workers: &dyn Workers,
) -> io::Result<()> {
    // A crash must leave no file that looks complete: sync before the rename. Both paths are in one
    // folder, so the rename is atomic.
    remove_rests(path);
    let written = new_file::replace_with(path, ".tmp", Sync::All, |file| {
        file.write_all(&head(spec, sum(table, workers)))?;
        file.write_all(table)
    });
    written.map(drop)
}

/// Removes the note that the file of a table was sound, so that the next [`open`] computes the
/// checksum of the whole file.
pub(super) fn forget(path: &Path) {
    let _ = fs::remove_file(note_path(path));
}

/// Returns the head of a table's file, with the checksum of the table.
fn head(spec: &TableSpec, checksum: u32) -> [u8; HEAD] {
    let mut head = [0; HEAD];
    head[..8].copy_from_slice(MAGIC);
    head[8..12].copy_from_slice(&MARK.to_ne_bytes());
    head[12..16].copy_from_slice(&FORMAT.to_ne_bytes());
    head[16..20].copy_from_slice(&spec.version.to_ne_bytes());
    head[20..24].copy_from_slice(&checksum.to_ne_bytes());
    head[24..32].copy_from_slice(&(spec.bytes as u64).to_ne_bytes());
    head[64..][..spec.name.len()].copy_from_slice(spec.name.as_bytes());
    let own = crc32fast::hash(&head);
    head[32..36].copy_from_slice(&own.to_ne_bytes());
    head
}

/// Checks the head of a table's file and returns the checksum of the table that it contains.
fn check_head(found: &[u8; HEAD], spec: &TableSpec) -> Result<u32, Unusable> {
    let number =
        |at: usize| u32::from_ne_bytes([found[at], found[at + 1], found[at + 2], found[at + 3]]);
    // In this order, so that the reason is the most specific: each check relies on those before.
    if found[..8] != *MAGIC {
        return Err(Unusable::Foreign);
    }
    if number(8) == MARK.swap_bytes() {
        return Err(Unusable::ByteOrder);
    }
    for (at, wanted) in [(12, FORMAT), (16, spec.version)] {
        if number(at) != wanted {
            return Err(Unusable::Version { found: number(at), wanted });
        }
    }
    let checksum = number(20);
    if *found != head(spec, checksum) {
        return Err(Unusable::Head);
    }
    Ok(checksum)
}

/// Computes the CRC-32 of the bytes; workers sum pieces in parallel.
fn sum(bytes: &[u8], workers: &dyn Workers) -> u32 {
    let pieces: Vec<&[u8]> = bytes.chunks(PIECE).collect();
    let sums = Mutex::new(vec![Hasher::new(); pieces.len()]);
    workers.run(pieces.len(), &|i| {
        let mut hasher = Hasher::new();
        hasher.update(pieces[i]);
        sums.lock().unwrap_or_else(PoisonError::into_inner)[i] = hasher;
    });
    // Sums of consecutive pieces combine into the sum of all, in the order of the pieces.
    let sums = sums.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut whole = Hasher::new();
    for piece in &sums {
        whole.combine(piece);
    }
    whole.finalize()
}

/// Returns a note that identifies this file in its present state, by its inode, size and times, and
/// says which checksum it has.
fn note(file: &File, checksum: u32) -> io::Result<String> {
    let m = file.metadata()?;
    Ok(format!(
        "{} {} {} {}.{:09} {}.{:09} {checksum:08x}\n",
        m.dev(),
        m.ino(),
        m.size(),
        m.mtime(),
        m.mtime_nsec(),
        m.ctime(),
        m.ctime_nsec()
    ))
}

fn note_path(path: &Path) -> PathBuf {
    path.with_extension("sound")
}

/// Removes the temporary files of processes that died while they wrote. The caller holds the lock,
/// so no living process writes.
pub(super) fn remove_rests(path: &Path) {
    let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else { return };
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let other = entry.file_name();
        let (name, other) = (name.to_string_lossy(), other.to_string_lossy());
        if other.starts_with(&*name) && other.ends_with(".tmp") {
            let _ = fs::remove_file(entry.path());
        }
    }
}
