//! Files that this program writes: a new file beside the one that it replaces, and files that one
//! process alone may write.
//!
//! - in: a path, which may be in a folder where other users create files too
//! - out: an open, locked file that no link or pipe stands for
//!
//! | fault | reaction |
//! |---|---|
//! | a link, a pipe or a folder has the name | refused, neither followed nor opened |
//! | a file of another user has the name | refused |
//! | another process writes the file | refused: its lock is on it |
//! | a killed process has left the file | removed and created again |
//! | the sync or the rename fails | error; the older file stays as it is |
//! | a new file's name is taken while it is written | error; the other file stays as it is |

use rustix::fs::{Access, CWD, RenameFlags, access, renameat_with};
use rustix::io::Errno;
use rustix::process::geteuid;
use std::ffi::OsString;
use std::fs::{self, File, Metadata, TryLockError};
use std::io::{self, ErrorKind, Write as _};
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

/// Flags of each file that is opened for writing. A link is not followed, the open of a pipe does
/// not wait for its reader, and a terminal does not become the one that controls this process.
const WARY: i32 = libc::O_NOFOLLOW | libc::O_NONBLOCK | libc::O_NOCTTY;
/// Rights of a new file: for its user alone.
const PRIVATE: u32 = 0o600;
/// Largest number of links that [`resolve`] follows.
const MOST_LINKS: usize = 8;
/// Number of tries to create a file, in case another process takes and frees its name meanwhile.
const TRIES: usize = 5;

/// Returns the path with an ending, such as `.part`, behind its name.
#[must_use]
pub fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(ending);
    name.into()
}

/// Makes an error about the file at `path`.
fn refuse(path: &Path, kind: ErrorKind, why: &str) -> io::Error {
    io::Error::new(kind, format!("{}: {why}", path.display()))
}

/// Returns the error of a file that another process is writing.
fn busy(path: &Path) -> io::Error {
    refuse(path, ErrorKind::ResourceBusy, "another run is writing it: name another file")
}

/// Locks `file` for this process alone. Returns `false` if another process holds the lock. On a
/// file system without locks, logs a warning with `path` and returns `true`.
#[must_use]
pub fn lock_for_writing(file: &File, path: &Path) -> bool {
    match file.try_lock() {
        Ok(()) => true,
        Err(TryLockError::WouldBlock) => false,
        Err(TryLockError::Error(why)) => {
            let path = path.display();
            tracing::warn!("{path}: cannot be locked ({why}): let no other run write it");
            true
        }
    }
}

/// Creates a new file that this user alone can read, and locks it. The lock ends when the file is
/// closed; a rename keeps it.
///
/// # Errors
/// Error of the operating system; [`ErrorKind::ResourceBusy`] if another process is writing the
/// file; [`ErrorKind::AlreadyExists`] if a link, a pipe, a folder, a device or another user's file
/// has the name.
pub fn create(path: &Path) -> io::Result<File> {
    for _ in 0..TRIES {
        let mut new = File::options();
        let new = new.read(true).write(true).create_new(true).mode(PRIVATE).custom_flags(WARY);
        match new.open(path) {
            // Before the lock another process may have removed the file, which looked like one
            // that a killed process left.
            Ok(file) if lock_for_writing(&file, path) && is_at(&file, path)? => return Ok(file),
            Ok(_) => {}
            Err(why) if why.kind() == ErrorKind::AlreadyExists => remove_left(path)?,
            Err(why) => return Err(why),
        }
    }
    Err(busy(path))
}

/// Removes a file that a killed process of this user has left at `path`. A file that is locked, or
/// that may be something else, stays and is an error.
fn remove_left(path: &Path) -> io::Result<()> {
    let gone = |why: &io::Error| why.kind() == ErrorKind::NotFound;
    let found = match path.symlink_metadata() {
        Err(why) if gone(&why) => return Ok(()),
        found => found?,
    };
    let in_the_way = |what: &str| {
        let why = format!("{what} has this name: remove it, or name another file");
        refuse(path, ErrorKind::AlreadyExists, &why)
    };
    if !found.is_file() {
        return Err(in_the_way(kind_of(&found)));
    }
    if found.uid() != geteuid().as_raw() {
        return Err(in_the_way("a file of another user"));
    }
    let left = match File::options().read(true).custom_flags(WARY).open(path) {
        Err(why) if gone(&why) => return Ok(()),
        left => left?,
    };
    if !lock_for_writing(&left, path) {
        return Err(busy(path));
    }
    // The lock is held while the name is removed: no other process takes this file for its own.
    if is_at(&left, path)? {
        fs::remove_file(path)?;
    }
    Ok(())
}

/// Returns the kind of a file that is not a regular file, in words for a message.
fn kind_of(found: &Metadata) -> &'static str {
    let kind = found.file_type();
    if kind.is_symlink() {
        "a symbolic link"
    } else if kind.is_dir() {
        "a folder"
    } else if kind.is_fifo() {
        "a pipe"
    } else {
        "a device"
    }
}

/// Returns whether `path` is a name of this open file. A link to the file does not count.
///
/// # Errors
/// Error of the operating system.
pub(crate) fn is_at(file: &File, path: &Path) -> io::Result<bool> {
    let own = file.metadata()?;
    match path.symlink_metadata() {
        Ok(at) => Ok((at.dev(), at.ino()) == (own.dev(), own.ino())),
        Err(why) if why.kind() == ErrorKind::NotFound => Ok(false),
        Err(why) => Err(why),
    }
}

/// Returns whether only this user, or root, can have written the file with this metadata.
#[must_use]
pub fn is_trusted(found: &Metadata) -> bool {
    foreign(found.uid(), found.mode(), geteuid().as_raw()).is_none()
}

/// Reason why another user can have written a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Foreign {
    /// The file belongs to another user, not root.
    Owner,
    /// The file's group, which may have other members, or all users may write it.
    Rights,
}

/// Returns the reason why another user than `own` or root can have written a file of the user
/// `owner` with the permissions `mode`; `None` if no other user can.
pub(super) fn foreign(owner: u32, mode: u32, own: u32) -> Option<Foreign> {
    if owner != own && owner != 0 {
        return Some(Foreign::Owner);
    }
    (mode & 0o022 != 0).then_some(Foreign::Rights)
}

/// Returns the path of the file to which the links of `path` lead; it need not exist. Only links of
/// this user and of root are followed.
///
/// # Errors
/// Error of the operating system; a link of another user; a circle of links.
pub fn resolve(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..MOST_LINKS {
        match path.symlink_metadata() {
            Ok(found) if found.is_symlink() => {
                if found.uid() != 0 && found.uid() != geteuid().as_raw() {
                    let why = "a symbolic link of another user: name the file itself";
                    return Err(refuse(&path, ErrorKind::PermissionDenied, why));
                }
                let to = fs::read_link(&path)?;
                path = path.parent().unwrap_or(Path::new("")).join(to);
            }
            Err(why) if why.kind() != ErrorKind::NotFound => return Err(why),
            _ => return Ok(path),
        }
    }
    Err(refuse(&path, ErrorKind::Other, "too many symbolic links"))
}

/// Checks that the file at `path` may be replaced, and returns its metadata; `None` if there is no
/// file. A file that is write-protected, or that another process writes, must not be replaced,
/// although a rename needs rights on the folder only.
///
/// # Errors
/// Error of the operating system; [`ErrorKind::ResourceBusy`] if another process is writing it.
pub fn replaceable(path: &Path) -> io::Result<Option<Metadata>> {
    let there = match File::options().write(true).custom_flags(WARY).open(path) {
        Err(why) if why.kind() == ErrorKind::NotFound => return Ok(None),
        there => there?,
    };
    // A shared lock, so that two checks do not refuse each other.
    if matches!(there.try_lock_shared(), Err(TryLockError::WouldBlock)) {
        return Err(busy(path));
    }
    there.metadata().map(Some)
}

/// Opens a device or a pipe for writing, without waiting for the reader of a pipe.
///
/// # Errors
/// Error of the operating system; no program reads the pipe.
pub fn open_device(path: &Path) -> io::Result<File> {
    // Names such as /dev/stdout are links, so this open follows links.
    let flags = libc::O_NONBLOCK | libc::O_NOCTTY;
    let mut options = File::options();
    // Truncation is for /dev/stdout, which may be a file.
    options.write(true).truncate(true).custom_flags(flags);
    let file = options.open(path).map_err(|why| {
        let no_reader = why.raw_os_error() == Some(libc::ENXIO);
        if no_reader { refuse(path, ErrorKind::Other, "no program reads this pipe") } else { why }
    })?;
    // From here on a full pipe makes the writer wait, as usual.
    let flags = rustix::fs::fcntl_getfl(&file)?;
    rustix::fs::fcntl_setfl(&file, flags - rustix::fs::OFlags::NONBLOCK)?;
    Ok(file)
}

/// Opens the regular file at `path` for appending, or creates it. A link to a file is refused. The
/// caller locks the file.
///
/// # Errors
/// Error of the operating system; something else than a regular file is at `path`.
pub fn open_or_create(path: &Path) -> io::Result<File> {
    let mut options = File::options();
    options.read(true).append(true).create(true).mode(PRIVATE).custom_flags(WARY);
    let file = options.open(path).map_err(|why| match path.symlink_metadata() {
        // The system's error does not say that a link or a pipe is in the way.
        Ok(found) if !found.is_file() => {
            let why = format!("{} has this name: name another file", kind_of(&found));
            refuse(path, ErrorKind::AlreadyExists, &why)
        }
        _ => why,
    })?;
    let found = file.metadata()?;
    if found.is_file() {
        return Ok(file);
    }
    let why = format!("{} has this name: name another file", kind_of(&found));
    Err(refuse(path, ErrorKind::AlreadyExists, &why))
}

/// Opens an existing file for overwriting in place, without following a link.
///
/// # Errors
/// Error of the operating system.
pub fn overwrite(path: &Path) -> io::Result<File> {
    File::options().write(true).custom_flags(WARY).open(path)
}

/// Parts of a written file that survive a power cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sync {
    /// None: the writer does not wait for the disk.
    No,
    /// The content: the name may still be that of the older file.
    Content,
    /// Content and name.
    All,
}

/// Gives the file at `beside` the name `path`. With `synced` the name survives a power cut; the
/// caller has synced the content.
///
/// # Errors
/// Error of the operating system; the file is still at `beside` then.
pub fn rename(beside: &Path, path: &Path, synced: bool) -> io::Result<()> {
    fs::rename(beside, path)?;
    if synced { keep_name(path) } else { Ok(()) }
}

/// Writes `bytes` to a new file, whose name is `path` with `ending`, and then renames it to `path`.
///
/// # Errors
/// Error of the operating system, and those of [`create`]; the older file is still there then.
pub fn replace(path: &Path, ending: &str, bytes: &[u8], sync: Sync) -> io::Result<()> {
    replace_with(path, ending, sync, |file| file.write_all(bytes)).map(drop)
}

/// Writes a file as [`replace`] does, with the content that `write` writes; returns the open file.
///
/// # Errors
/// Those of [`replace`] and of `write`; the older file is still there then.
pub fn replace_with(
    path: &Path,
    ending: &str,
    sync: Sync,
    write: impl FnOnce(&mut File) -> io::Result<()>,
) -> io::Result<File> {
    let new = beside(path, ending);
    let mut file = create(&new)?;
    let written = write(&mut file)
        .and_then(|()| if sync == Sync::No { Ok(()) } else { file.sync_data() })
        .and_then(|()| rename(&new, path, sync == Sync::All));
    match written {
        Ok(()) => Ok(file),
        Err(why) => {
            // A part of a file is of no use.
            let _ = fs::remove_file(&new);
            Err(why)
        }
    }
}

/// Writes a file that must not exist yet: the content goes to a file whose name is `path` with
/// `ending`, is synced, and then gets the name `path`. A kill or a full disk leaves no part of the
/// content under `path`, and a file that another process creates at `path` meanwhile stays.
///
/// # Errors
/// Error of the operating system, and those of [`create`] and of `write`;
/// [`ErrorKind::AlreadyExists`] if `path` is taken.
pub fn write_new(
    path: &Path,
    ending: &str,
    write: impl FnOnce(&mut File) -> io::Result<()>,
) -> io::Result<()> {
    if path.symlink_metadata().is_ok() {
        return Err(refuse(path, ErrorKind::AlreadyExists, "a file has this name"));
    }
    let new = beside(path, ending);
    let mut file = create(&new)?;
    let written =
        write(&mut file).and_then(|()| file.sync_data()).and_then(|()| rename_to_free(&new, path));
    if written.is_err() {
        let _ = fs::remove_file(&new);
    }
    written.and_then(|()| keep_name(path))
}

/// Gives the file at `beside` the name `path`, which no file may have.
fn rename_to_free(beside: &Path, path: &Path) -> io::Result<()> {
    match renameat_with(CWD, beside, CWD, path, RenameFlags::NOREPLACE) {
        // Some file systems replace whenever they rename. A second name never replaces.
        Err(Errno::INVAL | Errno::NOSYS | Errno::OPNOTSUPP) => {
            fs::hard_link(beside, path)?;
            fs::remove_file(beside)
        }
        renamed => renamed.map_err(io::Error::from),
    }
}

/// Checks that a new file can be created at `path`: its folder exists, and this user may write it.
///
/// # Errors
/// The reason, with the folder's path.
pub fn check_folder(path: &Path) -> Result<(), String> {
    let folder = folder_of(path);
    let refused = |why: &str| Err(format!("the folder {} {why}", folder.display()));
    match fs::metadata(folder) {
        Err(why) if why.kind() == ErrorKind::NotFound => return refused("does not exist"),
        Err(why) => return refused(&format!("cannot be used: {why}")),
        Ok(found) if !found.is_dir() => return refused("is a file"),
        Ok(_) => {}
    }
    match access(folder, Access::WRITE_OK | Access::EXEC_OK) {
        Ok(()) => Ok(()),
        Err(why) => refused(&format!("cannot be written: {}", io::Error::from(why))),
    }
}

/// Returns the folder of a file.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Syncs the folder of a file, so that the file's name survives a power cut. A sync of the file
/// itself covers only its content, so a new file could be lost.
///
/// # Errors
/// Error of the operating system if the folder does not exist. Other errors are only logged.
pub fn keep_name(path: &Path) -> io::Result<()> {
    let folder = folder_of(path);
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        Err(why) if why.kind() != ErrorKind::NotFound => {
            // Some file systems and folders cannot be synced. The run is then only as safe as
            // without this call, which is no reason to refuse it.
            tracing::warn!(
                "the folder {} cannot be synced: {why}; a power cut may lose a new file in it",
                folder.display()
            );
            Ok(())
        }
        kept => kept,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::testing::{Folder, make_pipe};
    use std::os::unix::fs::PermissionsExt as _;

    /// A link to another file, a pipe without a reader and a folder are in the way of the new file.
    #[test]
    fn planted_links_and_pipes_are_refused() {
        let folder = Folder::new("new-file-planted");
        let victim = folder.write("victim", "precious");
        let [link, fifo, dir] = ["link", "pipe", "folder"].map(|name| folder.0.join(name));
        std::os::unix::fs::symlink(&victim, &link).unwrap();
        make_pipe(&fifo);
        fs::create_dir(&dir).unwrap();

        for (path, what) in [(&link, "a symbolic link"), (&fifo, "a pipe"), (&dir, "a folder")] {
            for tried in [create(path), open_or_create(path)] {
                let why = tried.unwrap_err().to_string();
                assert!(why.contains(what) && why.contains("name another file"), "{why}");
            }
            assert!(replaceable(path).is_err(), "{what}");
        }
        let why = open_device(&fifo).unwrap_err().to_string();
        assert!(why.ends_with("no program reads this pipe"), "{why}");
        assert_eq!(fs::read(&victim).unwrap(), b"precious");
    }

    #[test]
    fn locked_file_is_refused_and_left_file_removed() {
        let folder = Folder::new("new-file-locked");
        let path = folder.0.join("x.part");
        let first = create(&path).unwrap();
        assert_eq!(first.metadata().unwrap().permissions().mode() & 0o777, PRIVATE);

        for tried in [create(&path).map(drop), replaceable(&path).map(drop)] {
            let why = tried.unwrap_err();
            assert_eq!(why.kind(), ErrorKind::ResourceBusy);
            assert!(why.to_string().contains("another run is writing it"), "{why}");
        }
        // The lock goes with the file to its final name.
        let last = folder.0.join("x");
        rename(&path, &last, true).unwrap();
        assert_eq!(replaceable(&last).unwrap_err().kind(), ErrorKind::ResourceBusy);
        drop(first);
        assert!(replaceable(&last).unwrap().is_some());

        // As after a kill: the file exists without its lock, with content of the killed run.
        fs::write(&path, "old").unwrap();
        assert_eq!(create(&path).unwrap().metadata().unwrap().len(), 0);
    }

    #[test]
    fn concurrent_creators_never_share_a_file() {
        let folder = Folder::new("new-file-race");
        let path = folder.0.join("x.part");
        let holders = std::sync::atomic::AtomicUsize::new(0);
        let hold = |file: File| {
            let others = holders.fetch_add(1, std::sync::atomic::Ordering::SeqCst);
            assert_eq!(others, 0, "two writers");
            std::thread::yield_now();
            holders.fetch_sub(1, std::sync::atomic::Ordering::SeqCst);
            drop(file);
        };
        // Each creator goes on until it has had the file 25 times.
        let creates = || (0..).filter_map(|_: u64| create(&path).ok()).map(hold).take(25).count();
        let created = std::thread::scope(|scope| {
            let creators = [0; 4].map(|_| scope.spawn(creates));
            creators.map(|creator| creator.join().unwrap())
        });
        assert_eq!(created, [25; 4]);
    }

    #[test]
    fn failed_replacement_keeps_the_old_file() {
        let folder = Folder::new("new-file-replace");
        let path = folder.write("state", "old");
        replace(&path, ".new", b"new", Sync::All).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        let fails = |file: &mut File| file.write_all(b"half").and(Err(io::Error::other("full")));
        assert!(replace_with(&path, ".new", Sync::No, fails).is_err());
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert!(!beside(&path, ".new").exists());
        // A folder in the place of the file makes the rename fail.
        let taken = folder.0.join("taken");
        fs::create_dir(&taken).unwrap();

        assert!(replace(&taken, ".new", b"new", Sync::No).is_err());

        assert!(taken.is_dir() && !beside(&taken, ".new").exists());
    }

    /// The content is written beside the name. A failure, as on a full disk, and a file that takes
    /// the name meanwhile leave neither a part nor a changed file.
    #[test]
    fn new_file_is_whole_and_replaces_none() {
        let folder = Folder::new("new-file-whole");
        let path = folder.0.join("way.toml");
        let fails = |file: &mut File| {
            file.write_all(b"half")?;
            assert!(!path.exists(), "a kill would leave a part");
            Err(io::Error::from(ErrorKind::StorageFull))
        };
        let why = write_new(&path, ".part", fails).unwrap_err();
        assert_eq!(why.kind(), ErrorKind::StorageFull);
        assert_eq!(fs::read_dir(&folder.0).unwrap().count(), 0);

        let races = |file: &mut File| file.write_all(b"mine").and(fs::write(&path, "other"));
        let why = write_new(&path, ".part", races).unwrap_err();
        assert_eq!(why.kind(), ErrorKind::AlreadyExists, "{why}");
        assert_eq!(fs::read(&path).unwrap(), b"other");
        assert_eq!(fs::read_dir(&folder.0).unwrap().count(), 1);

        let free = folder.0.join("free.toml");
        write_new(&free, ".part", |file| file.write_all(b"mine")).unwrap();
        assert_eq!(fs::read(&free).unwrap(), b"mine");
    }

    #[test]
    fn folder_of_new_file_is_checked() {
        let folder = Folder::new("new-file-folder");
        let file = folder.write("file", "");

        check_folder(&folder.0.join("x")).unwrap();
        check_folder(Path::new("x")).unwrap();
        let missing = check_folder(&folder.0.join("none/x")).unwrap_err();
        assert!(missing.ends_with("none does not exist"), "{missing}");
        assert!(check_folder(&file.join("x")).is_err());
        // Root may write everywhere, but not there.
        let why = check_folder(Path::new("/proc/self/x")).err();
        assert!(geteuid().is_root() || why.is_some_and(|why| why.contains("cannot be written")));
    }

    #[test]
    fn sync_of_name_fails_in_missing_folder() {
        let folder = Folder::new("new-file-name");

        keep_name(&folder.0.join("file")).unwrap();
        keep_name(Path::new("file")).unwrap();
        assert!(keep_name(&folder.0.join("none").join("file")).is_err());
    }

    #[test]
    fn resolve_follows_links_except_of_other_users() {
        let folder = Folder::new("new-file-link");
        let [one, two, target] = ["one", "two", "target"].map(|name| folder.0.join(name));
        std::os::unix::fs::symlink("two", &one).unwrap();
        std::os::unix::fs::symlink(&target, &two).unwrap();

        assert_eq!(resolve(&one).unwrap(), target);
        std::os::unix::fs::symlink(&one, &target).unwrap();
        assert!(resolve(&one).unwrap_err().to_string().contains("too many symbolic links"));
        // Only root can make a link of another user.
        if geteuid().is_root() {
            std::os::unix::fs::lchown(&one, Some(1), None).unwrap();
            let why = resolve(&one).unwrap_err().to_string();
            assert!(why.contains("a symbolic link of another user"), "{why}");
        }
    }
}
