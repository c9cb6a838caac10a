//! Where a recording goes: beside its name, as `FILE.part`, until there is a period in it. So a run
//! that does not come to begin takes no older recording's place.

use super::reading::{Piece, open};
use std::ffi::OsString;
use std::fs::{File, OpenOptions};
use std::path::{Path, PathBuf};

/// The place of a file that is being written.
#[derive(Debug)]
pub(crate) struct Place {
    path: PathBuf,
    /// Where it is until then; `None` when it has its name, as a device and a pipe have from the
    /// beginning.
    part: Option<PathBuf>,
    regular: bool,
}

impl Place {
    /// Creates the file.
    ///
    /// # Errors
    /// What the operating system says.
    pub(crate) fn create(path: &Path) -> std::io::Result<(File, Self)> {
        let there = std::fs::metadata(path).ok();
        let regular = there.as_ref().is_none_or(std::fs::Metadata::is_file);
        // Streams of this process and what a link is to bring about are no places of their own.
        let named = !["/dev/fd", "/dev/stdin", "/dev/stdout", "/dev/stderr", "/proc"]
            .iter()
            .any(|stream| path.starts_with(stream))
            && (there.is_some() || path.symlink_metadata().is_err());
        if !regular || !named {
            let place = Self { path: path.to_owned(), part: None, regular };
            return Ok((File::create(path)?, place));
        }
        // What is protected is not replaced, and behind a link the file is.
        if there.is_some() {
            OpenOptions::new().write(true).open(path)?;
        }
        let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let part = Self::part_of(&path);
        let file = File::create(&part)?;
        if let Some(there) = there {
            // Who may read and write it stays so; a file system that knows no rights has none to
            // keep.
            let _ = file.set_permissions(there.permissions());
        }
        Ok((file, Self { path, part: Some(part), regular }))
    }

    /// Where a file of this name is until it is whole.
    #[must_use]
    pub(crate) fn part_of(path: &Path) -> PathBuf {
        let mut part = OsString::from(path);
        part.push(".part");
        PathBuf::from(part)
    }

    /// Where it is.
    #[must_use]
    pub(crate) fn at(&self) -> &Path {
        self.part.as_deref().unwrap_or(&self.path)
    }

    /// Whether it does not have its name yet.
    #[must_use]
    pub(crate) fn waits(&self) -> bool {
        self.part.is_some()
    }

    /// Gives it its name, in the place of what had it.
    ///
    /// # Errors
    /// What the operating system says.
    pub(crate) fn take(&mut self) -> std::io::Result<()> {
        if let Some(part) = &self.part {
            std::fs::rename(part, &self.path)?;
            self.part = None;
        }
        Ok(())
    }

    /// Gives it its name if nothing has it, or an empty file.
    ///
    /// # Errors
    /// What the operating system says.
    pub(crate) fn take_if_free(&mut self) -> std::io::Result<()> {
        let taken = std::fs::metadata(&self.path).is_ok_and(|there| there.len() > 0);
        if taken { Ok(()) } else { self.take() }
    }

    /// Takes it away again, unless it has its name.
    ///
    /// # Errors
    /// What the operating system says.
    pub(crate) fn discard(self) -> std::io::Result<()> {
        self.part.map_or(Ok(()), std::fs::remove_file)
    }

    /// How many messages of a recording are really there; `None` where nothing can be read back.
    #[must_use]
    pub(crate) fn messages(&self) -> Option<u64> {
        let reading = if self.regular { open(self.at()).ok() } else { None };
        let is_message = |piece: &Piece| matches!(piece, Piece::Message(_));
        reading.map(|reading| reading.filter(is_message).count() as u64)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::*;
    use std::io::Write as _;

    #[test]
    fn a_file_stays_until_another_takes_its_place() {
        let folder = std::env::temp_dir().join(format!("rubik-robot-place-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("run.mcap");
        std::fs::write(&path, "old").unwrap();

        let (mut file, mut place) = Place::create(&path).unwrap();
        file.write_all(b"new").unwrap();
        place.take_if_free().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert!(place.waits() && place.at().ends_with("run.mcap.part"));
        place.take().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert!(!place.waits());

        std::fs::remove_file(&path).unwrap();
        let (_, mut place) = Place::create(&path).unwrap();
        place.take_if_free().unwrap();
        assert!(path.exists() && !place.waits());
        let (_, place) = Place::create(&path).unwrap();
        place.discard().unwrap();
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1, "nothing is left lying about");
        assert!(!Place::create(Path::new("/dev/null")).unwrap().1.waits());
        assert!(!Place::create(Path::new("/dev/stdout")).unwrap().1.waits());
        let (link, target) = (folder.join("link"), folder.join("target"));
        std::os::unix::fs::symlink(&target, &link).unwrap();
        assert!(!Place::create(&link).unwrap().1.waits());
        assert!(target.exists() && link.is_symlink(), "a link is followed, not replaced");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_file_behind_a_link_is_replaced_and_may_be_read_by_whom_it_was() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = std::env::temp_dir().join(format!("rubik-robot-link-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (link, target) = (folder.join("link"), folder.join("target"));
        std::fs::write(&target, "old").unwrap();
        std::fs::set_permissions(&target, std::fs::Permissions::from_mode(0o600)).unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();

        let (mut file, mut place) = Place::create(&link).unwrap();
        assert_eq!(std::fs::read(&target).unwrap(), b"old", "it is what it was until then");
        file.write_all(b"new").unwrap();
        place.take().unwrap();

        assert!(link.is_symlink());
        assert_eq!(std::fs::read(&target).unwrap(), b"new");
        let rights = std::fs::metadata(&target).unwrap().permissions().mode();
        assert_eq!(rights & 0o777, 0o600, "others cannot read what was written before either");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_file_that_may_not_be_written_is_not_replaced() {
        // A program that runs is protected even from who may do everything, by most kernels.
        let program = std::env::current_exe().unwrap();
        if std::fs::OpenOptions::new().write(true).open(&program).is_ok() {
            return;
        }

        let refused = Place::create(&program).map(|(_, place)| place.discard());

        assert_eq!(refused.unwrap_err().kind(), std::io::ErrorKind::ExecutableFileBusy);
        assert!(!Place::part_of(&program).exists());
    }
}
