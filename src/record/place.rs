//! Path of a recording while it is written. The recording is in `FILE.part` until it holds a servo
//! period, and is then renamed to `FILE`. So a run that fails before its first servo period leaves
//! an older recording at `FILE` as it is.

use super::reading::{Piece, open};
use crate::hw::new_file;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Final and temporary path of a file that is being written.
#[derive(Debug)]
pub(crate) struct Place {
    /// Final path.
    path: PathBuf,
    /// Temporary path; `None` once the file has its final one. A device and a pipe never have a
    /// temporary path.
    part: Option<PathBuf>,
    /// The file, which stays locked until this handle and the writer's are closed; `None` for a
    /// device.
    file: Option<File>,
}

impl Place {
    /// Creates the file that will be at `path`, at first under its temporary path. Both are locked
    /// against other processes until the file is closed. A device, a pipe and a stream of this
    /// process are opened at `path` itself instead. A pipe that no program reads is an error.
    ///
    /// # Errors
    /// Error of the operating system; also if `path` leads to a file that may not be written or
    /// that another process is writing, or by a link of another user.
    pub(crate) fn create(path: &Path) -> std::io::Result<(File, Self)> {
        let device = |path: &Path| {
            let place = Self { path: path.to_owned(), part: None, file: None };
            Ok((new_file::open_device(path)?, place))
        };
        // The streams of this process are written directly: a rename would only replace their name.
        let streams = ["/dev/fd", "/dev/stdin", "/dev/stdout", "/dev/stderr", "/proc"];
        if streams.iter().any(|stream| path.starts_with(stream)) {
            return device(path);
        }
        // If `path` is a link, its target is replaced, not the link.
        let path = new_file::resolve(path)?;
        if path.symlink_metadata().is_ok_and(|there| !there.is_file()) {
            return device(&path);
        }
        let part = Self::part_of(&path);
        let file = new_file::create(&part)?;
        // The final path is checked after the temporary one is locked: another run may have just
        // renamed its temporary file, and then holds the lock of the final one.
        let checked = new_file::replaceable(&path).and_then(|there| {
            if let Some(there) = there {
                // The new file keeps the permissions of the old one. Some file systems have none,
                // so a failure is no error.
                let _ = file.set_permissions(there.permissions());
            }
            file.try_clone()
        });
        match checked {
            Ok(same) => Ok((file, Self { path, part: Some(part), file: Some(same) })),
            Err(why) => {
                let _ = std::fs::remove_file(&part);
                Err(why)
            }
        }
    }

    /// Returns the temporary path of a file: its path followed by `.part`.
    #[must_use]
    pub(crate) fn part_of(path: &Path) -> PathBuf {
        new_file::beside(path, ".part")
    }

    /// Returns the path at which the file is now.
    #[must_use]
    pub(crate) fn at(&self) -> &Path {
        self.part.as_deref().unwrap_or(&self.path)
    }

    /// Checks whether the file still has its temporary path.
    #[must_use]
    pub(crate) fn is_temporary(&self) -> bool {
        self.part.is_some()
    }

    /// Waits until the content of the file is on the disk; does nothing for a device.
    ///
    /// # Errors
    /// Error of the operating system.
    pub(crate) fn sync(&self) -> std::io::Result<()> {
        self.file.as_ref().map_or(Ok(()), File::sync_data)
    }

    /// Renames the file to its final path and replaces a file that is there.
    ///
    /// # Errors
    /// Error of the operating system; the file still has its temporary path then.
    pub(crate) fn rename_to_final(&mut self) -> std::io::Result<()> {
        if let Some(part) = &self.part {
            new_file::rename(part, &self.path, true)?;
            self.part = None;
        }
        Ok(())
    }

    /// Renames the file to its final path, unless another file with content is there. The file then
    /// stays under its temporary path.
    ///
    /// # Errors
    /// Error of the operating system.
    pub(crate) fn rename_if_free(&mut self) -> std::io::Result<()> {
        let taken = std::fs::metadata(&self.path).is_ok_and(|there| there.len() > 0);
        if taken { Ok(()) } else { self.rename_to_final() }
    }

    /// Removes the file if it still has its temporary path.
    ///
    /// # Errors
    /// Error of the operating system.
    pub(crate) fn discard(self) -> std::io::Result<()> {
        self.part.map_or(Ok(()), std::fs::remove_file)
    }

    /// Counts the messages of the recording in the file by reading it; `None` if it cannot be read
    /// back.
    #[must_use]
    pub(crate) fn messages(&self) -> Option<u64> {
        // Only a file is read: a pipe or a terminal would wait for input.
        let reading = self.file.as_ref().and_then(|_| open(self.at()).ok());
        let is_message = |piece: &Piece| matches!(piece, Piece::Message(_));
        reading.map(|reading| reading.filter(is_message).count() as u64)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::*;
    use crate::tables::testing::make_pipe;
    use std::io::Write as _;

    /// Also checks links, devices and a recording that is discarded.
    #[test]
    fn old_recording_stays_until_new_one_is_renamed() {
        let folder = std::env::temp_dir().join(format!("rubik-robot-place-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("run.mcap");
        std::fs::write(&path, "old").unwrap();

        let (mut file, mut place) = Place::create(&path).unwrap();
        file.write_all(b"new").unwrap();
        place.rename_if_free().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert!(place.is_temporary() && place.at().ends_with("run.mcap.part"));
        place.rename_to_final().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert!(!place.is_temporary());

        std::fs::remove_file(&path).unwrap();
        let (_, mut place) = Place::create(&path).unwrap();
        place.rename_if_free().unwrap();
        assert!(path.exists() && !place.is_temporary());
        drop(place);
        let (_, place) = Place::create(&path).unwrap();
        place.discard().unwrap();
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1, "the temporary file is removed");
        assert!(!Place::create(Path::new("/dev/null")).unwrap().1.is_temporary());
        assert!(!Place::create(Path::new("/dev/stdout")).unwrap().1.is_temporary());
        let (link, target) = (folder.join("link"), folder.join("target"));
        std::os::unix::fs::symlink(&target, &link).unwrap();
        let (_, mut place) = Place::create(&link).unwrap();
        place.rename_to_final().unwrap();
        assert!(target.exists() && link.is_symlink(), "a link is followed, not replaced");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// A link to an existing file keeps its target, and the new target keeps the old permissions.
    #[test]
    fn file_behind_a_link_keeps_its_permissions() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = std::env::temp_dir().join(format!("rubik-robot-link-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (link, target) = (folder.join("link"), folder.join("target"));
        std::fs::write(&target, "old").unwrap();
        std::fs::set_permissions(&target, std::fs::Permissions::from_mode(0o600)).unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();

        let (mut file, mut place) = Place::create(&link).unwrap();
        assert_eq!(std::fs::read(&target).unwrap(), b"old", "unchanged until then");
        file.write_all(b"new").unwrap();
        place.sync().unwrap();
        place.rename_to_final().unwrap();

        assert!(link.is_symlink());
        assert_eq!(std::fs::read(&target).unwrap(), b"new");
        let rights = std::fs::metadata(&target).unwrap().permissions().mode();
        assert_eq!(rights & 0o777, 0o600, "the permissions of the old file stay");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// The second recording is refused both before and after the first one is renamed.
    #[test]
    fn second_writer_of_a_file_is_refused() {
        let folder = std::env::temp_dir().join(format!("rubik-robot-two-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("run.mcap");
        let refused = || Place::create(&path).unwrap_err().to_string();

        let (mut file, mut place) = Place::create(&path).unwrap();
        assert!(refused().contains("run.mcap.part: another run is writing it"), "{}", refused());
        file.write_all(b"first").unwrap();
        place.rename_to_final().unwrap();
        assert!(refused().contains("run.mcap: another run is writing it"), "{}", refused());
        drop((file, place));
        assert_eq!(std::fs::read(&path).unwrap(), b"first");
        let names = std::fs::read_dir(&folder).unwrap().count();
        assert_eq!(names, 1, "a refused writer leaves nothing");

        assert!(Place::create(&path).is_ok());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// In a shared folder another user may have put a link or a pipe there first.
    #[test]
    fn planted_temporary_file_is_refused() {
        let folder = std::env::temp_dir().join(format!("rubik-robot-plant-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (path, victim) = (folder.join("run.mcap"), folder.join("victim"));
        std::fs::write(&victim, "precious").unwrap();
        std::os::unix::fs::symlink(&victim, Place::part_of(&path)).unwrap();

        let why = Place::create(&path).unwrap_err().to_string();

        assert!(why.contains("run.mcap.part: a symbolic link has this name"), "{why}");
        assert_eq!(std::fs::read(&victim).unwrap(), b"precious");
        make_pipe(&path);
        let why = Place::create(&path).unwrap_err().to_string();
        assert!(why.contains("no program reads this pipe"), "{why}");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn protected_file_is_not_replaced() {
        // Most kernels protect a running program from every user, root included.
        let program = std::env::current_exe().unwrap();
        if std::fs::OpenOptions::new().write(true).open(&program).is_ok() {
            return;
        }

        let refused = Place::create(&program).map(|(_, place)| place.discard());

        assert_eq!(refused.unwrap_err().kind(), std::io::ErrorKind::ExecutableFileBusy);
        assert!(!Place::part_of(&program).exists());
    }
}
