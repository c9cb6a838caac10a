//! Ratchet for counts that may only fall. The file `counts.txt` beside this one has a line
//! `NAME = COUNT` for each.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Lock of the file against other tests of the same binary.
static FILE: Mutex<()> = Mutex::new(());

/// Checks that a count is not larger than the one that `counts.txt` has for `name`.
///
/// A larger count fails. A smaller count prints a request to lower the number in the file, and
/// fails if it is smaller by more than a tenth. `RATCHET=write` writes the new number.
pub(crate) fn holds(name: &str, count: usize) {
    let _guard = FILE.lock().unwrap_or_else(PoisonError::into_inner);
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/ratchet/counts.txt");
    let text = std::fs::read_to_string(&file).unwrap();
    let known = |line: &&str| line.split_once(" = ").is_some_and(|(key, _)| key == name);
    let line = text.lines().find(known).unwrap_or_else(|| panic!("no line for `{name}`"));
    let most: usize = line.rsplit(' ').next().unwrap().parse().unwrap();
    assert!(count <= most, "{name}: {count}, {most} is the most: --nocapture lists them");
    if count < most {
        let shown = file.display();
        eprintln!("{name}: {count}, {most} before. Lower the number in {shown} to {count}.");
        if std::env::var_os("RATCHET").is_some_and(|word| word == "write") {
            std::fs::write(file, text.replace(line, &format!("{name} = {count}"))).unwrap();
        } else {
            assert!(10 * count >= 9 * most, "{name}: {count}, {most} before: run RATCHET=write");
        }
    }
}
