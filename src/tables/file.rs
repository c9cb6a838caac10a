//! The file of a pruning table: a head of 4096 bytes, then the table.
//!
//! | bytes | content |
//! |---|---|
//! | 0..8 | `RRtable` and a line feed |
//! | 8..12 | 0x0a0b0c0d, like all numbers in the byte order of the writing machine |
//! | 12..16 | version of this format |
//! | 16..20 | version of the table |
//! | 20..24 | CRC-32 of the table |
//! | 24..32 | size of the table (bytes) |
//! | 32..36 | CRC-32 of the head, computed with 0 in these four bytes |
//! | 64..128 | name of the table, padded with 0 |
//! | others | 0 |

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
/// First bytes of every file of a table.
const MAGIC: &[u8; 8] = b"RRtable\n";
/// Number that shows the byte order of the machine that wrote the file.
const MARK: u32 = 0x0a0b_0c0d;
/// Version of the format of the file.
const FORMAT: u32 = 1;
/// Size of the piece that one task copies or computes the checksum of (bytes).
const PIECE: usize = 16 << 20;

/// Age of a file from which on any change of its bytes also changes its time of modification.
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
    /// File of another version of the format or of the table.
    #[error("the table's file has version {found} instead of {wanted}")]
    Version {
        /// Version of the file.
        found: u32,
        /// Version that it should have.
        wanted: u32,
    },
    /// Head with a wrong checksum, name or size of the table.
    #[error("the table's file has a damaged head")]
    Head,
    /// Table whose bytes differ from those that were written.
    #[error("the table's file is damaged: the checksum is {found:08x} instead of {wanted:08x}")]
    Checksum {
        /// Checksum of the bytes in the file.
        found: u32,
        /// Checksum in the head.
        wanted: u32,
    },
    /// Table whose checksum is right, but whose entries are not, as their counts show.
    #[error("the table's file has wrong contents: {0}")]
    Miscounted(String),
}

/// Location of the bytes of a table while they are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Residence {
    /// Mapped file: available at once and shared by all processes.
    #[default]
    Mapped,
    /// Copy in memory with large pages, which few systems have for mapped files. Copying takes a
    /// second for 1.4 GiB and makes a search, which reads at random, a quarter faster.
    Copied,
}

/// A mapped file, which gives the bytes after its head.
#[derive(Debug)]
struct Mapped(Mmap);

impl AsRef<[u8]> for Mapped {
    fn as_ref(&self) -> &[u8] {
        &self.0[HEAD..]
    }
}

/// A table that was copied into memory.
#[derive(Debug)]
struct Copied(MmapMut);

impl AsRef<[u8]> for Copied {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

/// Opens the file of a table and checks its size, its head and the checksum of the table, unless a
/// note says that this checksum was right before. Returns the bytes of the table, mapped or copied
/// into memory.
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
    // Size and head come first: a mapping of a short file would end the process by a signal when it
    // is read.
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
    // If the note beside the file equals this one, the file is unchanged since its checksum was
    // right.
    let note = note(&file, checksum)?;
    let noted = text::open_text(&note_path(path), HEAD as u64);
    if noted.ok().is_none_or(|(_, text)| text != note) {
        let found = sum((*bytes).as_ref(), workers);
        if found != checksum {
            return Err(Unusable::Checksum { found, wanted: checksum });
        }
        // If the note cannot be written, the checksum is computed again next time. A very young
        // file gets no note: the clock of the file system ticks every few milliseconds, and a
        // change in the same tick would not show in the time.
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
    // Two hints to the kernel, which may ignore them: no read-ahead, and large pages.
    let _ = mapped.advise(Advice::Random);
    #[cfg(target_os = "linux")]
    let _ = mapped.advise(Advice::HugePage);
    Ok(mapped)
}

/// Copies the table in a file (`bytes` after the head) into memory, with large pages where the
/// system has them. Workers read pieces of it in parallel.
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

/// Writes a table with its head to a temporary file in the folder of `path`, then renames that file
/// to `path`.
pub(super) fn write(
    path: &Path,
    spec: &TableSpec,
    table: &[u8],
    workers: &dyn Workers,
) -> io::Result<()> {
    // A crash must not leave an incomplete file at `path`: the data are on disk before the rename.
    // Both paths are in one folder, so the rename is atomic.
    remove_rests(path);
    let written = new_file::replace_with(path, ".tmp", Sync::All, |file| {
        file.write_all(&head(spec, sum(table, workers)))?;
        file.write_all(table)
    });
    written.map(drop)
}

/// Removes the note that the checksum of a table's file was right, so that the next [`open`]
/// computes it again.
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
    // Each check relies on those before it, so the first that fails gives the exact reason.
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

/// Computes the CRC-32 of the bytes. Workers compute those of pieces in parallel.
fn sum(bytes: &[u8], workers: &dyn Workers) -> u32 {
    let pieces: Vec<&[u8]> = bytes.chunks(PIECE).collect();
    let sums = Mutex::new(vec![Hasher::new(); pieces.len()]);
    workers.run(pieces.len(), &|i| {
        let mut hasher = Hasher::new();
        hasher.update(pieces[i]);
        sums.lock().unwrap_or_else(PoisonError::into_inner)[i] = hasher;
    });
    // In the order of the pieces, their checksums combine into that of all bytes.
    let sums = sums.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut whole = Hasher::new();
    for piece in &sums {
        whole.combine(piece);
    }
    whole.finalize()
}

/// Returns the note for a file with the right checksum: its device, inode, size, times of change
/// and checksum. The file has changed if it differs from an earlier note.
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

/// Returns the path of the note beside the file of a table.
fn note_path(path: &Path) -> PathBuf {
    path.with_extension("sound")
}

/// Removes the temporary files of processes that died while they wrote the file at `path`. The
/// caller holds the lock of the table, so no other process is writing now.
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
