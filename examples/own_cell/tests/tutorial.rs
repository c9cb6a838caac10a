//! The tutorial in `docs/` shows the code of this example, and its commands work.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

use std::path::{Path, PathBuf};
use std::process::Command;

/// Returns the folder of the example.
fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_path_buf()
}

/// Returns the text of the tutorial.
fn tutorial() -> String {
    std::fs::read_to_string(folder().join("../../docs/tutorial.md")).unwrap()
}

/// Returns the blocks of code: language, name of the file in the comment before, text.
fn blocks(text: &str) -> Vec<(String, Option<String>, String)> {
    let (mut found, mut file, mut open) = (Vec::new(), None, None);
    for line in text.lines() {
        match (&mut open, line.strip_prefix("```")) {
            (None, Some(language)) => open = Some((language.to_owned(), String::new())),
            (Some(_), Some(_)) => {
                let (language, body): (String, String) = open.take().unwrap();
                found.push((language, file.take(), body));
            }
            (Some((_, body)), None) => {
                body.push_str(line);
                body.push('\n');
            }
            (None, None) => {
                let name = line.strip_prefix("<!-- ").and_then(|name| name.strip_suffix(" -->"));
                file = name.map(str::to_owned).or(file);
            }
        }
    }
    found
}

#[test]
fn blocks_of_tutorial_are_lines_of_the_example() {
    let blocks = blocks(&tutorial());
    let code: Vec<_> = blocks.iter().filter(|(language, ..)| language != "sh").collect();

    assert!(code.len() >= 10, "{} blocks", code.len());
    for (_, file, body) in code {
        let name = file.as_ref().unwrap_or_else(|| panic!("a block names no file: {body}"));
        let source = std::fs::read_to_string(folder().join(name)).unwrap();
        assert!(source.contains(body.trim_end()), "{name} does not contain:\n{body}");
    }
}

/// The page about orders and readings names each method of `Robot`, and each behaviour.
#[test]
fn page_of_tasks_names_each_order() {
    let read = |path: &str| std::fs::read_to_string(folder().join("../..").join(path)).unwrap();
    let (page, robot) = (read("docs/task.md"), read("src/kernel/robot.rs"));
    let behaviours = read("src/generators/behaviour.rs");
    let (_, list) = behaviours.split_once("pub enum Behaviour {").unwrap();
    let (list, _) = list.split_once("\n}").unwrap();
    let variants = list.lines().filter(|l| l.starts_with("    ") && !l.starts_with("     "));
    let names = |line: &str| line.trim().split([' ', '(', '<', ',']).next().unwrap().to_owned();
    let variants = variants.map(names).filter(|name| name.starts_with(char::is_uppercase));
    let methods = robot.lines().filter_map(|line| {
        let line = line.strip_prefix("    pub ")?;
        let line = line.strip_prefix("async ").unwrap_or(line).strip_prefix("fn ")?;
        Some(names(line))
    });
    // `kernel` makes the task; it is in the tutorial.
    let wanted: Vec<_> = variants.chain(methods).filter(|name| name != "kernel").collect();

    assert!(wanted.len() > 30, "{wanted:?}");
    for name in wanted {
        let said = [format!("`{name}"), format!("`robot.{name}")];
        assert!(said.iter().any(|words| page.contains(words)), "docs/task.md lacks `{name}`");
    }
}

/// The tutorial ends with the number of lines of its parts, as `scripts/lines` counts them.
#[test]
fn table_of_tutorial_counts_its_code() {
    let script = folder().join("../../scripts/lines");
    let output = Command::new(script).output().unwrap();

    let table = String::from_utf8(output.stdout).unwrap();
    assert_eq!(table.lines().count(), 6, "{table}");
    assert!(tutorial().ends_with(&table), "the tutorial does not end with:\n{table}");
}

/// Each command of the tutorial ends as the tutorial says: with exit code 0, or the code in its
/// comment.
#[test]
fn commands_of_tutorial_work() {
    let place = std::env::temp_dir().join(format!("own_cell_tutorial_{}", std::process::id()));
    std::fs::create_dir_all(&place).unwrap();
    std::fs::copy(folder().join("wave.toml"), place.join("wave.toml")).unwrap();
    let blocks = blocks(&tutorial());
    let shell = blocks.iter().filter(|(language, ..)| language == "sh");
    let lines: Vec<&str> = shell.flat_map(|(_, _, body)| body.lines()).collect();

    assert!(lines.len() >= 8, "{} commands", lines.len());
    for line in lines {
        let arguments = line.strip_prefix("own_cell ").unwrap();
        let program = env!("CARGO_BIN_EXE_own_cell");
        let output = Command::new("sh")
            .args(["-c", &format!("'{program}' {arguments}")])
            .current_dir(&place)
            .output()
            .unwrap();
        let wanted = if line.contains("# exit code 2") { 2 } else { 0 };
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(wanted), "{line}: {told}");
    }
    std::fs::remove_dir_all(place).unwrap();
}
