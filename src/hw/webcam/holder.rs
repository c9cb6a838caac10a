//! The program that holds a device open.
//!
//! - in: the path of a device
//! - out: name and number of the first process that has it open, as far as this user may look

use std::fs;
use std::path::Path;

/// Folder in which the kernel lists the processes.
const PROCESSES: &str = "/proc";

/// Returns name and number of another process than this one that has `path` open; `None` if no
/// process is found. The processes of other users can only be seen by root.
pub(super) fn holder(path: &Path) -> Option<(String, u32)> {
    let own = std::process::id();
    let numbers = fs::read_dir(PROCESSES).ok()?.filter_map(|entry| {
        entry.ok()?.file_name().to_str()?.parse::<u32>().ok().filter(|number| *number != own)
    });
    numbers.into_iter().find(|number| holds(*number, path)).map(|number| {
        let name = fs::read_to_string(format!("{PROCESSES}/{number}/comm")).unwrap_or_default();
        (name.trim().to_owned(), number)
    })
}

/// Returns whether the process `number` has `path` open.
fn holds(number: u32, path: &Path) -> bool {
    let files = fs::read_dir(format!("{PROCESSES}/{number}/fd")).into_iter().flatten();
    files.flatten().any(|file| fs::read_link(file.path()).is_ok_and(|target| target == path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::testing::Folder;
    use std::process::{Command, Stdio};

    #[test]
    fn process_with_open_file_is_named() {
        let folder = Folder::new("holder");
        let path = folder.write("video0", "");
        assert_eq!(holder(&path), None);
        let file = fs::File::open(&path).unwrap();
        assert_eq!(holder(&path), None, "this process does not count");

        let mut child = Command::new("sleep").arg("60").stdin(Stdio::from(file)).spawn().unwrap();
        let found = holder(&path);
        child.kill().unwrap();
        child.wait().unwrap();

        // Before its exec the child has the name of the test.
        assert_eq!(found.map(|(_, number)| number), Some(child.id()));
    }
}
