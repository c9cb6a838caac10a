//! Cache of the tables of meetings, one for each cell, in the user's cache folder.
//!
//! - in: the believed cell, the settings of the search
//! - out: the table of meetings, equal to the bit whether it was searched now or read
//!
//! A meeting is a pair of joint positions in which both hands can be at one cube. A file names the
//! cell and the build of the program that made it. A file of another cell, another build, or with
//! an error is replaced by a new search. So is a file that another user can have written, since the
//! arms move to the joint positions in it.

use crate::cell::Cell;
use crate::generators::position::Speeds;
use crate::hw::new_file::{self, Sync};
use crate::hw::text;
use crate::reach::{Meeting, MeetingPath, MeetingTable, ReachSettings};
use crate::record::running_program;
use crate::tables::Store;
use serde::{Deserialize, Serialize};
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Prefix of the files' names.
const PREFIX: &str = "meetings-";
/// Largest number of files that are kept.
const MOST: usize = 32;
/// Largest size of a file (bytes): a table with paths has 130,000.
const LARGEST: u64 = 16 << 20;

/// Contents of a file.
#[derive(Serialize, Deserialize)]
struct Kept {
    /// Cell and settings of the search, in full.
    made_of: String,
    /// Build of the program.
    made_by: String,
    // The fields of [`MeetingTable`].
    grasps: [Option<Meeting>; 24],
    views: [[Option<Meeting>; 3]; 2],
    separation: f64,
    ways: Vec<Option<MeetingPath>>,
}

/// Returns the table of the meetings of a cell's arms, from the cache or by a search with
/// `settings`. If `speeds` are given, the table also has the quickest paths between the meetings
/// for arms of these speeds.
#[must_use]
pub(crate) fn of(cell: &Cell, settings: &ReachSettings, speeds: Option<&Speeds>) -> MeetingTable {
    in_folder(Store::for_user().folder(), cell, settings, speeds)
}

/// Returns the table of the meetings like [`of`], with the cache in `folder`.
fn in_folder(
    folder: &Path,
    cell: &Cell,
    settings: &ReachSettings,
    speeds: Option<&Speeds>,
) -> MeetingTable {
    // The complete input of the search as text. Rust writes numbers so that equal text means equal
    // bits.
    let made_of = format!("{cell:?} {settings:?} {speeds:?}");
    let made_by = build_of_this_program();
    let path = path(folder, &made_of);
    let kept = read(&path).filter(|k| k.made_of == made_of && k.made_by == made_by);
    if let Some(kept) = kept {
        return MeetingTable {
            grasps: kept.grasps,
            views: kept.views,
            separation: kept.separation,
            ways: kept.ways,
        };
    }
    // A search of about a second, longer with paths.
    let mut table = MeetingTable::compute(cell, settings);
    if let Some(speeds) = speeds {
        table.find_ways(cell, settings, speeds);
    }
    let kept = Kept {
        made_of,
        made_by,
        grasps: table.grasps,
        views: table.views,
        separation: table.separation,
        ways: table.ways.clone(),
    };
    // Without a cache the next run searches again, which is no error.
    if let Err(error) = keep(&path, &kept) {
        tracing::info!(
            "the table of the arms' meetings cannot be saved to {}: {error}; the next run searches \
             them again",
            path.display()
        );
    }
    table
}

/// Reads a file. Returns `None` if it is absent, larger than [`LARGEST`] or damaged, or if another
/// user can have written it.
fn read(path: &Path) -> Option<Kept> {
    let (file, text) = text::open_text(path, LARGEST).ok()?;
    // The open file is checked, because another file may take its path in between.
    if !new_file::is_trusted(&file.metadata().ok()?) {
        tracing::warn!("{}: another user can write it, so it is not used", path.display());
        return None;
    }
    let (sum, body) = text.split_once('\n')?;
    (sum == checksum(body)).then(|| serde_json::from_str(body).ok()).flatten()
}

/// Returns a file's text: the checksum of the table, then the table.
fn sealed(kept: &Kept) -> std::io::Result<String> {
    let body = serde_json::to_string(kept)?;
    Ok(format!("{}\n{body}", checksum(&body)))
}

/// Returns the checksum of a table as text. It detects damage; the owner of the file protects it
/// against forgery.
fn checksum(body: &str) -> String {
    format!("{:08x}", crc32fast::hash(body.as_bytes()))
}

/// Returns the path of a cell's table in `folder`. It is named by a hash of `made_of`, cell and
/// settings as text. Two hashes may collide, so the text is also in the file.
fn path(folder: &Path, made_of: &str) -> PathBuf {
    let mut hasher = DefaultHasher::new();
    made_of.hash(&mut hasher);
    folder.join(format!("{PREFIX}{:016x}.json", hasher.finish()))
}

/// Returns version, modification time and size of this program: a program with a changed search
/// must not use old tables.
fn build_of_this_program() -> String {
    let about = || {
        let about = fs::metadata(running_program().ok()?).ok()?;
        let changed = about.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
        Some(format!("{} of {} bytes", changed.as_nanos(), about.len()))
    };
    format!("{} {}", env!("CARGO_PKG_VERSION"), about().unwrap_or_default())
}

/// Writes a table to a temporary file and renames it to `path`, so that no process reads half of
/// it. Also removes the oldest tables if there are too many.
///
/// # Errors
/// If the folder or the file cannot be written.
fn keep(path: &Path, kept: &Kept) -> std::io::Result<()> {
    fs::create_dir_all(path.parent().unwrap_or(Path::new(".")))?;
    new_file::replace(path, ".part", sealed(kept)?.as_bytes(), Sync::No)?;
    forget_oldest(path);
    Ok(())
}

/// Removes the oldest tables in the folder of `path` beyond [`MOST`], so that those of unused cells
/// do not pile up.
fn forget_oldest(path: &Path) {
    let Some(Ok(entries)) = path.parent().map(fs::read_dir) else { return };
    let mut kept: Vec<_> = entries
        .filter_map(Result::ok)
        .filter(|e| {
            let name = e.file_name();
            let name = name.to_string_lossy();
            name.starts_with(PREFIX) && name.ends_with(".json")
        })
        .filter_map(|e| Some((e.metadata().ok()?.modified().ok()?, e.path())))
        .collect();
    kept.sort();
    for (_, old) in kept.iter().rev().skip(MOST) {
        // Another process may have removed it already.
        let _ = fs::remove_file(old);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reach::example_cell;
    use crate::tables::testing::Folder;

    /// A folder with the saved table of the example cell.
    struct Saved {
        folder: Folder,
        settings: ReachSettings,
        file: PathBuf,
        text: String,
        /// The table from the search that has saved it.
        table: MeetingTable,
    }

    impl Saved {
        /// Searches the table and saves it in a folder whose name contains `name`.
        fn new(name: &str) -> Self {
            let folder = Folder::new(name);
            let (cell, settings) =
                (example_cell(), ReachSettings { samples: 150, ..Default::default() });
            let table = in_folder(&folder.0, &cell, &settings, None);
            let file = path(&folder.0, &format!("{cell:?} {settings:?} None"));
            let text = fs::read_to_string(&file).unwrap();
            Self { folder, settings, file, text, table }
        }

        /// Returns the table of the same cell once more.
        fn again(&self) -> MeetingTable {
            in_folder(&self.folder.0, &example_cell(), &self.settings, None)
        }

        /// Returns the saved table with another separation, which only a table that is read can
        /// have, and with the text `to` in place of `from`.
        fn forged(&self, from: &str, to: &str) -> String {
            let body = self.text.split_once('\n').unwrap().1;
            let other = body.replace("\"separation\":0.35", "\"separation\":0.36");
            let forged = other.replace(from, to);
            assert!(other != body && (from.is_empty() || forged != other), "{from}");
            forged
        }

        /// Writes a table in place of the saved one, with its checksum.
        fn write(&self, body: &str) {
            fs::write(&self.file, format!("{}\n{body}", checksum(body))).unwrap();
        }
    }

    #[test]
    fn cached_meeting_table_equals_newly_searched_table() {
        let saved = Saved::new("meetings");
        let searched = MeetingTable::compute(&example_cell(), &saved.settings);
        assert!(searched.found().0 > 0);
        assert_eq!(saved.table, searched);
        assert_eq!(saved.again(), searched);

        saved.write(&saved.forged("\"ways\":[]", "\"ways\":[null]"));

        let read = MeetingTable { separation: 0.36, ways: vec![None], ..searched };
        assert_eq!(saved.again(), read, "the table is read, not searched");
    }

    /// A table of another build, of another cell or with an error leads to a new search, and so
    /// does one that another user can have written.
    #[test]
    fn unfit_meeting_table_is_searched_anew() {
        use std::os::unix::fs::PermissionsExt as _;
        let saved = Saved::new("meetings-unfit");
        let forged = saved.forged("", "");
        let spoilt = forged.replacen("0.36", "0.37", 1);
        let half = &forged[..forged.len() / 2];

        for (body, mode) in [
            (&saved.forged("\"made_by\":\"", "\"made_by\":\"1"), 0o600),
            (&saved.forged("samples: 150", "samples: 151"), 0o600),
            (&half.to_owned(), 0o600),
            (&forged, 0o666),
            (&forged, 0o620),
        ] {
            saved.write(body);
            fs::set_permissions(&saved.file, fs::Permissions::from_mode(mode)).unwrap();
            assert_eq!(saved.again(), saved.table, "{mode:o} {body}");
            let mode = fs::metadata(&saved.file).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600, "replaced by a private file");
            assert_eq!(fs::read_to_string(&saved.file).unwrap(), saved.text);
        }
        fs::write(&saved.file, format!("{}\n{spoilt}", checksum(&forged))).unwrap();
        assert_eq!(saved.again(), saved.table, "the checksum is wrong");
        saved.write(&forged);
        let other = ReachSettings { samples: 151, ..saved.settings };
        let other = in_folder(&saved.folder.0, &example_cell(), &other, None);
        assert_eq!(other.separation, 0.35, "the table of other settings");
    }
}
