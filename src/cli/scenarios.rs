//! Scenarios by name: the list of those at hand, and the file that a name stands for.
//!
//! - in: the word of the command line, the folder `scenarios` of the working directory
//! - out: the path of the scenario; a list with the first sentence of each; the nearest name

use super::output::inform;
use crate::hw::text::shortened;
use crate::scenario;
use crate::scenario::fault::nearest;
use clap::builder::{OsStringValueParser, TypedValueParser};
use std::ffi::OsString;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Folder of the project's scenarios.
const FOLDER: &str = "scenarios";
/// Beginning of the names of scenarios that are built into the program.
const SHIPPED: &str = "shipped:";
/// Number of columns of the list.
const COLUMNS: usize = 80;

/// Returns the parser of an argument that is a scenario: a path, or a name as in `run solve`.
pub(super) fn parser() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().map(|word: OsString| {
        let path = PathBuf::from(word);
        let Some(found) = named(&path, Path::new(FOLDER)) else { return path };
        inform(&format!("scenario {}: {}", path.display(), found.display()));
        found
    })
}

/// Returns the scenario that a bare name stands for: the file of `folder`, otherwise the built-in
/// one. Returns `None` for a path, and for a name without a scenario.
fn named(name: &Path, folder: &Path) -> Option<PathBuf> {
    if name.exists() || name.components().count() != 1 {
        return None;
    }
    let stem = name.to_str()?.trim_end_matches(".toml");
    let file = folder.join(format!("{stem}.toml"));
    if file.is_file() {
        return Some(file);
    }
    let shipped = format!("{SHIPPED}{stem}");
    scenario::shipped().any(|(name, _)| name == shipped).then(|| PathBuf::from(shipped))
}

/// Returns advice about a scenario that does not exist: the nearest name, and how to list all.
pub(super) fn advice(path: &Path) -> String {
    const LIST: &str = "`rubik-robot run` alone lists the scenarios";
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let all: Vec<String> = files(folder.unwrap_or(Path::new(FOLDER)))
        .chain(files(Path::new(FOLDER)))
        .filter_map(|file| Some(file.file_stem()?.to_str()?.to_owned()))
        .chain(scenario::shipped().map(|(name, _)| name.trim_start_matches(SHIPPED).to_owned()))
        .collect();
    let all: Vec<&str> = all.iter().map(String::as_str).collect();
    match nearest(name.trim_start_matches(SHIPPED), &all) {
        Some(name) => format!("did you mean `{name}`? {LIST}"),
        None => LIST.to_owned(),
    }
}

/// Returns the list of scenarios: name and first sentence of each, and how to run one.
pub(super) fn list() -> String {
    let row = |text: &mut String, name: &str, scenario: &str| {
        // Writing to a string cannot fail.
        let _ =
            writeln!(text, "{}", shortened(&format!("  {name:15} {}", head(scenario)), COLUMNS));
    };
    let mut text = "Scenarios in the program:\n".to_owned();
    for (name, scenario) in scenario::shipped() {
        row(&mut text, name, scenario);
    }
    let files: Vec<PathBuf> = files(Path::new(FOLDER)).collect();
    if !files.is_empty() {
        let _ = writeln!(text, "Scenarios in the folder {FOLDER}:");
    }
    for file in &files {
        let name = file.file_stem().unwrap_or_default().to_string_lossy();
        row(&mut text, &name, &scenario::text(file).unwrap_or_default());
    }
    text + "Run one by its name or by its path: `rubik-robot run solve`\n"
}

/// Returns the scenarios in a folder, sorted by name.
fn files(folder: &Path) -> impl Iterator<Item = PathBuf> {
    let files = std::fs::read_dir(folder).into_iter().flatten();
    let files = files.filter_map(|file| Some(file.ok()?.path()));
    let mut files: Vec<_> = files.filter(|f| f.extension().is_some_and(|e| e == "toml")).collect();
    files.sort();
    files.into_iter()
}

/// Returns the first sentence of the comment with which a scenario begins.
fn head(scenario: &str) -> String {
    let lines = scenario.lines().map_while(|line| line.strip_prefix('#'));
    let comment = lines.map(str::trim).collect::<Vec<_>>().join(" ");
    let end = comment.find(". ").unwrap_or(comment.trim_end_matches('.').len());
    comment[..end].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bare_name_means_file_before_built_in_scenario() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(FOLDER);
        let nowhere = Path::new("/nowhere");
        let found = |name: &str, folder: &Path| named(Path::new(name), folder);

        assert_eq!(found("solve", &folder), Some(folder.join("solve.toml")));
        assert_eq!(found("idle.toml", &folder), Some(folder.join("idle.toml")));
        assert_eq!(found("solve", nowhere), Some(PathBuf::from("shipped:solve")));
        for none in ["idle", "./solve", "/solve", "shipped:solve", "src"] {
            assert_eq!(found(none, nowhere), None, "{none}");
        }
    }

    #[test]
    fn head_is_first_sentence_of_the_comment() {
        let text = "# The hand-over only: the arm\n# grasps. The hand withdraws.\n\ntask = 1\n";

        assert_eq!(head(text), "The hand-over only: the arm grasps");
        assert_eq!(head("# One sentence.\n"), "One sentence");
        assert_eq!(head("task = 1\n"), "");
    }
}
