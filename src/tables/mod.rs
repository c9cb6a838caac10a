//! Store of the solver's pruning tables in files: built once, opened by every later run.
//!
//! - in: [`TableSpec`]s, a folder, [`Threads`] that build a table
//! - out: the bytes of a table: memory-mapped from its file, or copied into large pages; if the
//!   folder cannot be written, the table as it was built in memory
//!
//! The store writes a file beside its final path and renames it, so the file is complete or absent.
//! A lock keeps two processes from building one table at once. The head of the file has the name,
//! the version and the checksums of the table.
//!
//! Computing the checksums of all tables, 1.4 GiB, at each start would take half a second. A note
//! beside a file therefore records its inode, size and times of change when its checksum was right.
//! The store computes the checksum again only if the file differs from the note. A program that
//! writes to the file changes its time, which the store detects. Only [`Store::verify`] detects
//! errors of the disk itself.

mod file;
#[cfg(test)]
pub(crate) mod testing;
mod threads;

pub use file::{Residence, Unusable};
pub use threads::{Threads, cores};

use crate::hw::new_file;
use crate::solver::table::{Progress, TableSpec, Workers};
use crate::solver::tables::Bytes;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Folder of tables.
#[derive(Debug, Clone)]
pub struct Store {
    folder: PathBuf,
    residence: Residence,
}

/// Report of a store while it builds a table.
#[derive(Debug)]
pub enum News<'a> {
    /// Start of a build, with the reason: the file is absent or unusable.
    Building(&'a Unusable),
    /// Wait for another process that has locked the table, mostly to build it.
    Waiting,
    /// End of a build whose table could not be written to a file, with the reason. The table is
    /// used from memory.
    NotKept(io::Error),
}

/// Listeners of the build of a table.
#[derive(Clone, Copy)]
pub struct Observer<'a> {
    /// Listener of the reports.
    pub listener: Listener<'a>,
    /// Listener that receives the share of the work that is done.
    pub progress: Progress<'a>,
}

/// Listener of the reports about a table.
pub type Listener<'a> = &'a dyn Fn(&TableSpec, News<'_>);

impl Store {
    /// Makes the store of a folder, which need not exist yet. Its tables are mapped.
    #[must_use]
    pub fn new(folder: PathBuf) -> Self {
        Self { folder, residence: Residence::Mapped }
    }

    /// Returns this store with its tables mapped from files or copied into memory, as `residence`
    /// says.
    #[must_use]
    pub fn with(self, residence: Residence) -> Self {
        Self { residence, ..self }
    }

    /// Makes the store of the user's folder of tables: `RUBIK_ROBOT_TABLES`, else `rubik-robot` in
    /// `XDG_CACHE_HOME`, else in `~/.cache`, else in the system's folder for temporary files.
    #[must_use]
    pub fn for_user() -> Self {
        let set = |name: &str| {
            std::env::var_os(name).map(PathBuf::from).filter(|path| !path.as_os_str().is_empty())
        };
        // By the XDG base directory specification relative paths are ignored.
        let cache = || set("XDG_CACHE_HOME").filter(|path| path.is_absolute());
        let home = || set("HOME").map(|home| home.join(".cache"));
        let folder = set("RUBIK_ROBOT_TABLES").unwrap_or_else(|| {
            cache().or_else(home).unwrap_or_else(std::env::temp_dir).join("rubik-robot")
        });
        Self::new(folder)
    }

    /// Returns where the bytes of the tables are while they are used.
    #[must_use]
    pub fn residence(&self) -> Residence {
        self.residence
    }

    /// Returns the folder of the table files.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the path of the file of a table.
    #[must_use]
    pub fn path(&self, spec: &TableSpec) -> PathBuf {
        self.folder.join(format!("{}.table", spec.name))
    }

    /// Opens a table whose file is present and undamaged.
    ///
    /// # Errors
    /// The reason why the file is unusable.
    pub fn open(&self, spec: &TableSpec, workers: &dyn Workers) -> Result<Bytes, Unusable> {
        file::open(&self.path(spec), spec, self.residence, workers)
    }

    /// Opens a table. If its file is absent or unusable, builds the table and writes the file. If
    /// the file cannot be written, reports that and returns the table in memory.
    pub(crate) fn obtain(
        &self,
        spec: &TableSpec,
        workers: &dyn Workers,
        observer: Observer<'_>,
    ) -> Bytes {
        match self.open(spec, workers) {
            Ok(bytes) => bytes,
            Err(reason) => match self.build(spec, workers, &reason, observer) {
                Ok(bytes) => bytes,
                // A read-only or full disk costs a build at each start, but never the run.
                Err((bytes, error)) => {
                    (observer.listener)(spec, News::NotKept(error));
                    bytes
                }
            },
        }
    }

    /// Builds a table, writes its file and opens it, unless another process has done so in the
    /// meantime. `reason` says why the present file is unusable; the listener receives it.
    ///
    /// # Errors
    /// The table in memory, and the reason why its file could not be written.
    pub fn build(
        &self,
        spec: &TableSpec,
        workers: &dyn Workers,
        reason: &Unusable,
        observer: Observer<'_>,
    ) -> Result<Bytes, (Bytes, io::Error)> {
        let Observer { listener, progress } = observer;
        let in_memory = || {
            listener(spec, News::Building(reason));
            Arc::new((spec.build)(workers, progress))
        };
        // Held until the function returns; the system releases it if the process dies.
        let _lock = match self.lock(spec, listener) {
            Ok(lock) => lock,
            Err(error) => return Err((in_memory(), error)),
        };
        // Another process may have built the table while this one waited for the lock.
        if let Ok(bytes) = self.open(spec, workers) {
            return Ok(bytes);
        }
        let table = in_memory();
        let kept = file::write(&self.path(spec), spec, &table, workers)
            .and_then(|()| self.open(spec, workers).map_err(io::Error::other));
        kept.map_err(|error| (table as Bytes, error))
    }

    /// Checks a table's file without regard to its note: computes the checksum, then checks the
    /// entries of the table. Returns the number of entries at each distance from the goal.
    ///
    /// # Errors
    /// The reason why the file is unusable, which may be a wrong number of entries.
    pub fn verify(&self, spec: &TableSpec, workers: &dyn Workers) -> Result<Vec<u64>, Unusable> {
        let path = self.path(spec);
        file::forget(&path);
        let bytes = file::open(&path, spec, Residence::Mapped, workers)?;
        (spec.verify)((*bytes).as_ref(), workers).map_err(Unusable::Miscounted)
    }

    /// Removes the file of a table with its note and temporary files. Waits while another process
    /// builds the table. Returns whether there was a file of the table.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn remove(&self, spec: &TableSpec) -> io::Result<bool> {
        let path = self.path(spec);
        if !self.folder.is_dir() {
            return Ok(false);
        }
        // The lock file stays: if it were removed, a process that waits for it and one that creates
        // a new file could both hold a lock.
        let _lock = self.lock(spec, &|_, _| ())?;
        file::forget(&path);
        file::remove_rests(&path);
        match fs::remove_file(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
            other => other.map(|()| true),
        }
    }

    /// Returns the path of the file that is locked while a table is built or removed.
    fn lock_path(&self, spec: &TableSpec) -> PathBuf {
        self.folder.join(format!("{}.lock", spec.name))
    }

    /// Locks a table against other processes and returns the locked file. Reports to `listener` if
    /// it has to wait for another process.
    fn lock(&self, spec: &TableSpec, listener: Listener<'_>) -> io::Result<File> {
        fs::create_dir_all(&self.folder)?;
        let lock = new_file::open_or_create(&self.lock_path(spec))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                listener(spec, News::Waiting);
                lock.lock()?;
            }
            Err(TryLockError::Error(error)) => return Err(error),
        }
        Ok(lock)
    }
}

#[cfg(test)]
mod tests {
    use super::testing::{Folder, make_pipe};
    use super::*;
    use crate::solver::table::InTurn;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Number of times that the table of `SPEC` was built.
    static BUILT: AtomicUsize = AtomicUsize::new(0);

    /// Table of 100,000 bytes with a check of each byte.
    static SPEC: TableSpec = TableSpec {
        name: "tests-count",
        version: 3,
        bytes: 100_000,
        purpose: "tests",
        build: |_, _| {
            BUILT.fetch_add(1, Ordering::SeqCst);
            (0..100_000_u32).map(|i| (i * 7 % 251) as u8).collect()
        },
        verify: |bytes, _| {
            let right = bytes.iter().enumerate().all(|(i, &b)| b == (i * 7 % 251) as u8);
            if right { Ok(vec![bytes.len() as u64]) } else { Err("wrong".to_owned()) }
        },
    };

    /// Returns a new folder for this test, and a store inside it whose own folder does not exist
    /// yet.
    fn place(name: &str) -> (Folder, Store) {
        let folder = Folder::new(&format!("store-{name}"));
        let store = Store::new(folder.0.join("tables"));
        (folder, store)
    }

    /// Opens a table, or builds it, without reports.
    fn obtain(store: &Store, spec: &TableSpec) -> Bytes {
        let observer = Observer { listener: &|_, _| (), progress: &|_| () };
        store.obtain(spec, &InTurn, observer)
    }

    /// Returns whether the bytes are those of the table of `SPEC`.
    fn right(bytes: &Bytes) -> bool {
        (SPEC.verify)((**bytes).as_ref(), &InTurn).is_ok()
    }

    #[test]
    fn store_finds_table_after_build() {
        let (_folder, store) = place("once");
        assert!(matches!(store.open(&SPEC, &InTurn), Err(Unusable::Absent)));

        assert!(right(&obtain(&store, &SPEC)));
        assert!(right(&store.open(&SPEC, &InTurn).unwrap()));

        let copied = Store::new(store.folder().to_owned()).with(Residence::Copied);
        assert!(right(&copied.open(&SPEC, &InTurn).unwrap()));
        assert_eq!(store.verify(&SPEC, &InTurn).unwrap(), [100_000]);
        assert!(store.remove(&SPEC).unwrap());
        assert!(!store.remove(&SPEC).unwrap());
        assert!(matches!(store.open(&SPEC, &InTurn), Err(Unusable::Absent)));
    }

    #[test]
    fn remove_deletes_temporary_files_but_not_lock() {
        let (_folder, store) = place("remove");
        obtain(&store, &SPEC);
        let rest = PathBuf::from(format!("{}.1234.tmp", store.path(&SPEC).display()));
        fs::write(&rest, "torn").unwrap();
        let other = store.folder().join("another.table.1234.tmp");
        fs::write(&other, "of another table").unwrap();

        assert!(store.remove(&SPEC).unwrap());

        assert!(!store.path(&SPEC).exists() && !rest.exists() && other.exists());
        assert!(store.lock_path(&SPEC).exists(), "two builders could hold a lock each");
    }

    #[test]
    fn remove_waits_for_builder() {
        let (_folder, store) = place("hands");
        obtain(&store, &SPEC);
        let lock = store.lock(&SPEC, &|_, _| ()).unwrap();
        std::thread::scope(|scope| {
            let remover = scope.spawn(|| store.remove(&SPEC));
            std::thread::sleep(std::time::Duration::from_millis(50));
            assert!(!remover.is_finished() && store.path(&SPEC).exists());
            drop(lock);
            assert!(remover.join().unwrap().unwrap());
        });
        assert!(!store.path(&SPEC).exists());
    }

    /// Reading a mapped table would end the process by a signal here.
    #[test]
    fn copied_table_survives_truncation_of_its_file() {
        let (_folder, store) = place("truncated");
        obtain(&store, &SPEC);
        let copied = store.with(Residence::Copied);
        let table = copied.open(&SPEC, &InTurn).unwrap();

        File::options().write(true).open(copied.path(&SPEC)).unwrap().set_len(0).unwrap();

        assert!(right(&table));
    }

    /// Another user may have put links or pipes into the folder in place of the store's files. The
    /// store neither waits for a pipe nor writes to the file that a link names.
    #[test]
    fn store_refuses_planted_links_and_pipes() {
        let (folder, store) = place("planted");
        fs::create_dir_all(store.folder()).unwrap();
        let victim = folder.write("victim", "precious");
        make_pipe(&store.path(&SPEC));
        assert!(matches!(store.open(&SPEC, &InTurn), Err(Unusable::Unreadable(_))));
        for end in ["lock", "table.tmp"] {
            let planted = store.folder().join(format!("{}.{end}", SPEC.name));
            let _ = fs::remove_file(&planted);
            std::os::unix::fs::symlink(&victim, &planted).unwrap();

            assert!(right(&obtain(&store, &SPEC)));

            assert_eq!(fs::read(&victim).unwrap(), b"precious", "{end}");
            let _ = fs::remove_file(&planted);
        }
    }

    #[test]
    fn damaged_table_is_reported_and_rebuilt() {
        let (_folder, store) = place("broken");
        obtain(&store, &SPEC);
        let path = store.path(&SPEC);
        let sound = fs::read(&path).unwrap();
        let with = |at: usize, byte: u8| {
            let mut bytes = sound.clone();
            bytes[at] ^= byte;
            bytes
        };
        let mut foreign = sound.clone();
        foreign[8..12].reverse();
        // The table follows a head of 4096 bytes.
        let body = sound.len() - 100_000;
        for (bytes, reason) in [
            (sound[..sound.len() - 1].to_vec(), "104095 bytes instead of 104096"),
            (sound[..100].to_vec(), "100 bytes instead of 104096"),
            (Vec::new(), "0 bytes instead of 104096"),
            (with(0, 1), "not written by rubik-robot"),
            (foreign, "written on a machine of the other byte order"),
            (with(70, 1), "has a damaged head"),
            (with(body, 1), "damaged: the checksum is"),
            (with(body + 54_321, 0x80), "damaged: the checksum is"),
            (with(sound.len() - 1, 1), "damaged: the checksum is"),
        ] {
            fs::write(&path, bytes).unwrap();

            let message = store.open(&SPEC, &InTurn).err().unwrap().to_string();
            assert!(message.contains(reason), "{message:?} is not {reason:?}");
            assert!(right(&obtain(&store, &SPEC)));
            assert!(store.open(&SPEC, &InTurn).is_ok(), "not repaired: {reason}");
        }
    }

    #[test]
    fn obtain_rebuilds_table_of_other_version() {
        let (_folder, store) = place("version");
        obtain(&store, &TableSpec { version: 2, ..SPEC });

        let reason = store.open(&SPEC, &InTurn).err().unwrap();

        assert!(matches!(reason, Unusable::Version { found: 2, wanted: 3 }), "{reason}");
        assert!(right(&obtain(&store, &SPEC)));
        assert!(store.open(&SPEC, &InTurn).is_ok());
    }

    #[test]
    fn obtain_uses_memory_if_folder_is_unwritable() {
        let folder = Folder::new("store-readonly");
        // A file is in place of the folder, so not even root can create files there.
        let store = Store::new(folder.0.join("file"));
        fs::write(store.folder(), "").unwrap();
        let reports = AtomicUsize::new(0);

        let listener = |_: &TableSpec, news: News<'_>| {
            if matches!(news, News::NotKept(_)) {
                reports.fetch_add(1, Ordering::SeqCst);
            }
        };
        let observer = Observer { listener: &listener, progress: &|_| () };
        let bytes = store.obtain(&SPEC, &InTurn, observer);

        assert!(right(&bytes));
        assert_eq!(reports.into_inner(), 1);
    }

    #[test]
    fn concurrent_requests_build_table_once() {
        static SLOW: TableSpec = TableSpec {
            name: "tests-slow",
            build: |_, _| {
                SLOWLY.fetch_add(1, Ordering::SeqCst);
                std::thread::sleep(std::time::Duration::from_millis(50));
                vec![7; 100_000]
            },
            ..SPEC
        };
        static SLOWLY: AtomicUsize = AtomicUsize::new(0);
        let (_folder, store) = place("together");

        std::thread::scope(|scope| {
            for _ in 0..6 {
                scope.spawn(|| assert!((*obtain(&store, &SLOW)).as_ref().iter().all(|&b| b == 7)));
            }
        });

        assert_eq!(SLOWLY.load(Ordering::SeqCst), 1);
        let left: Vec<_> =
            fs::read_dir(store.folder()).unwrap().map(|e| e.unwrap().path()).collect();
        assert!(left.iter().all(|p| p.extension().unwrap() != "tmp"), "{left:?}");
    }
}
