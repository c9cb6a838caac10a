//! One table's file: a head of 4096 bytes, then the table.
//!
//! | bytes | what |
//! |---|---|
//! | 0..8 | `RRtable` and a line feed |
//! | 8..12 | 0x0a0b0c0d in the byte order of the writer, as all numbers are |
//! | 12..16 | version of this format |
//! | 16..20 | version of the table |
//! | 20..24 | CRC-32 of the table |
//! | 24..32 | bytes of the table |
//! | 32..36 | CRC-32 of the head, these four taken as 0 |
//! | 64..128 | name of the table, filled up with 0 |

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

/// A page: the table behind it begins on one, too.
const HEAD: usize = 4096;
const MAGIC: &[u8; 8] = b"RRtable\n";
const MARK: u32 = 0x0a0b_0c0d;
const FORMAT: u32 = 1;
/// Bytes that one task sums.
const PIECE: usize = 16 << 20;

/// A file this old has a time of change that later changes will differ from.
const SETTLED: Duration = Duration::from_secs(1);

/// Why a table's file is of no use.
#[derive(Debug, thiserror::Error)]
pub enum Unusable {
    /// There is none.
    #[error("not built yet")]
    Absent,
    /// It cannot be read.
    #[error("cannot be read: {0}")]
    Unreadable(#[from] io::Error),
    /// Too long or too short.
    #[error("{found} bytes instead of {wanted}")]
    Size {
        /// What it has.
        found: u64,
        /// What it should have.
        wanted: u64,
    },
    /// Not ours.
    #[error("no table of rubik-robot")]
    Foreign,
    /// From a machine whose numbers begin at the other end.
    #[error("written on a machine of the other byte order")]
    ByteOrder,
    /// Of another version of the program.
    #[error("of version {found} instead of {wanted}")]
    Version {
        /// What it has.
        found: u32,
        /// What it should have.
        wanted: u32,
    },
    /// The head does not agree with itself or with the name.
    #[error("head is damaged")]
    Head,
    /// The bytes are not those that were written.
    #[error("damaged: its checksum is {found:08x} instead of {wanted:08x}")]
    Checksum {
        /// What it has.
        found: u32,
        /// What it should have.
        wanted: u32,
    },
    /// The bytes are those that were written, and wrong.
    #[error("wrong: {0}")]
    Miscounted(String),
}

/// Where the bytes of a table lie while they are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Residence {
    /// In the file itself, mapped: there at once, shared by all processes.
    #[default]
    Mapped,
    /// Copied into memory of large pages, as few systems have them for files. Costs a second for 1.4 GiB, and makes a
    /// search that reads here and there a quarter faster.
    Copied,
}

/// A table behind its head.
#[derive(Debug)]
struct Mapped(Mmap);

impl AsRef<[u8]> for Mapped {
    fn as_ref(&self) -> &[u8] {
        &self.0[HEAD..]
    }
}

/// A table that was copied.
#[derive(Debug)]
struct Copied(MmapMut);

impl AsRef<[u8]> for Copied {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

/// Gets a file that is sound.
pub(super) fn open(
    path: &Path,
    spec: &TableSpec,
    residence: Residence,
    workers: &dyn Workers,
) -> Result<Bytes, Unusable> {
    let mut file = File::open(path).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => Unusable::Absent,
        _ => Unusable::Unreadable(error),
    })?;
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
    let note = note(&file, checksum)?;
    if fs::read_to_string(note_path(path)).ok().as_deref() != Some(&note) {
        let found = sum((*bytes).as_ref(), workers);
        if found != checksum {
            return Err(Unusable::Checksum { found, wanted: checksum });
        }
        // Where it cannot be noted, it is summed again next time. So is a file that is so young that the clock of
        // files, which ticks every few milliseconds, might not tell a later change from this one.
        let age = file.metadata()?.modified()?.elapsed().unwrap_or_default();
        if age > SETTLED {
            let _ = fs::write(note_path(path), note);
        }
    }
    Ok(bytes)
}

#[allow(
    unsafe_code,
    reason = "a file can change under its mapping; ours are only ever replaced whole, by renaming"
)]
fn map(file: &File) -> io::Result<Mmap> {
    let mapped = unsafe { Mmap::map(file)? };
    // Both are wishes: a kernel that does not know them leaves the table as it is.
    let _ = mapped.advise(Advice::Random);
    #[cfg(target_os = "linux")]
    let _ = mapped.advise(Advice::HugePage);
    Ok(mapped)
}

/// The table of a file in memory of large pages, where there are such; pieces are read side by side.
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

/// Writes a table beside its place, then renames it.
pub(super) fn write(
    path: &Path,
    spec: &TableSpec,
    table: &[u8],
    workers: &dyn Workers,
) -> io::Result<()> {
    remove_rests(path);
    let beside = beside(path, &format!("{}.tmp", std::process::id()));
    let written = File::create(&beside).and_then(|mut file| {
        file.write_all(&head(spec, sum(table, workers)))?;
        file.write_all(table)?;
        file.sync_all()?;
        fs::rename(&beside, path)
    });
    if written.is_err() {
        let _ = fs::remove_file(&beside);
    }
    written
}

/// Makes the next [`open`] sum the whole file.
pub(super) fn forget(path: &Path) {
    let _ = fs::remove_file(note_path(path));
}

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

/// The checksum of the table behind this head.
fn check_head(found: &[u8; HEAD], spec: &TableSpec) -> Result<u32, Unusable> {
    let number =
        |at: usize| u32::from_ne_bytes([found[at], found[at + 1], found[at + 2], found[at + 3]]);
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

/// CRC-32, pieces side by side.
fn sum(bytes: &[u8], workers: &dyn Workers) -> u32 {
    let pieces: Vec<&[u8]> = bytes.chunks(PIECE).collect();
    let sums = Mutex::new(vec![Hasher::new(); pieces.len()]);
    workers.run(pieces.len(), &|i| {
        let mut hasher = Hasher::new();
        hasher.update(pieces[i]);
        sums.lock().unwrap_or_else(PoisonError::into_inner)[i] = hasher;
    });
    let sums = sums.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut whole = Hasher::new();
    for piece in &sums {
        whole.combine(piece);
    }
    whole.finalize()
}

/// What tells this file, as it is now, from any other.
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

fn beside(path: &Path, extension: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(extension);
    name.into()
}

/// Removes what processes left that died while they wrote. Whoever holds the lock is the only one who writes.
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
