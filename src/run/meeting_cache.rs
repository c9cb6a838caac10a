//! Where the arms can meet, found once for each cell and kept in the user's cache folder.
//!
//! - in: the believed cell, how hard to search
//! - out: the table of meetings; the same to the bit, whether it was searched now or found again
//! - a kept table says of which cell and by which build of the program it was made; any other is made anew

use crate::cell::Cell;
use crate::generators::position::Speeds;
use crate::reach::{Meeting, MeetingTable, ReachSettings, Way};
use crate::record::running_program;
use crate::tables::Store;
use serde::{Deserialize, Serialize};
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Begin of the files' names.
const PREFIX: &str = "meetings-";
/// Tables that are kept.
const MOST: usize = 32;

/// A table as it is kept.
#[derive(Serialize, Deserialize)]
struct Kept {
    made_of: String,
    made_by: String,
    grasps: [Option<Meeting>; 24],
    views: [[Option<Meeting>; 3]; 2],
    separation: f64,
    ways: Vec<Option<Way>>,
}

/// The meetings of a cell; with the quickest ways between them for arms of these speeds.
#[must_use]
pub(crate) fn of(cell: &Cell, settings: &ReachSettings, speeds: Option<&Speeds>) -> MeetingTable {
    in_folder(Store::of_user().folder(), cell, settings, speeds)
}

fn in_folder(
    folder: &Path,
    cell: &Cell,
    settings: &ReachSettings,
    speeds: Option<&Speeds>,
) -> MeetingTable {
    // All that the search reads, in full: numbers are written so that equal text means equal bits.
    let made_of = format!("{cell:?} {settings:?} {speeds:?}");
    let made_by = build_of_this_program();
    let path = path(folder, &made_of);
    let kept = fs::read_to_string(&path).ok().and_then(|t| serde_json::from_str::<Kept>(&t).ok());
    if let Some(kept) = kept.filter(|k| k.made_of == made_of && k.made_by == made_by) {
        return MeetingTable {
            grasps: kept.grasps,
            views: kept.views,
            separation: kept.separation,
            ways: kept.ways,
        };
    }
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
    if let Err(error) = keep(&path, &kept) {
        tracing::info!("the meetings of the cell are not kept: {}: {error}", path.display());
    }
    table
}

fn path(folder: &Path, made_of: &str) -> PathBuf {
    let mut hasher = DefaultHasher::new();
    made_of.hash(&mut hasher);
    folder.join(format!("{PREFIX}{:016x}.json", hasher.finish()))
}

/// A search that was changed must not find the old one's results.
fn build_of_this_program() -> String {
    let about = || {
        let about = fs::metadata(running_program().ok()?).ok()?;
        let changed = about.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
        Some(format!("{} of {} bytes", changed.as_nanos(), about.len()))
    };
    format!("{} {}", env!("CARGO_PKG_VERSION"), about().unwrap_or_default())
}

/// Written beside its place and renamed into it, so that nobody reads half of it.
fn keep(path: &Path, kept: &Kept) -> std::io::Result<()> {
    fs::create_dir_all(path.parent().unwrap_or(Path::new(".")))?;
    let beside = path.with_extension(format!("{}.part", std::process::id()));
    fs::write(&beside, serde_json::to_string(kept)?)?;
    fs::rename(&beside, path).inspect_err(|_| drop(fs::remove_file(&beside)))?;
    forget_oldest(path);
    Ok(())
}

/// Tables of cells that nobody asks for any more would pile up: the newest ones stay.
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
        // Another process may have been faster.
        let _ = fs::remove_file(old);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reach::example_cell;

    #[test]
    fn a_kept_table_is_the_searched_one_to_the_bit_and_a_broken_one_is_made_anew() {
        let folder =
            std::env::temp_dir().join(format!("rubik-robot-meetings-{}", std::process::id()));
        let (cell, settings) =
            (example_cell(), ReachSettings { samples: 150, ..Default::default() });
        let searched = MeetingTable::compute(&cell, &settings);

        let first = in_folder(&folder, &cell, &settings, None);
        let file = path(&folder, &format!("{cell:?} {settings:?} None"));
        let text = fs::read_to_string(&file).unwrap();
        // Only a table that is read, not one that is searched, can have this.
        fs::write(&file, text.replace("\"separation\":0.35", "\"separation\":0.36")).unwrap();
        let found_again = in_folder(&folder, &cell, &settings, None);
        fs::write(&file, &text[..text.len() / 2]).unwrap();
        let after_damage = in_folder(&folder, &cell, &settings, None);
        let other = in_folder(&folder, &cell, &ReachSettings { samples: 151, ..settings }, None);

        assert!(searched.found().0 > 0);
        assert_eq!(first, searched);
        assert_eq!(found_again, MeetingTable { separation: 0.36, ..searched.clone() });
        assert_eq!(after_damage, searched);
        assert_eq!(other.separation, 0.35);
        fs::remove_dir_all(&folder).unwrap();
    }
}
