//! `rubik-robot keys`: lists the keys of scenarios with unit, default, range and meaning.

use super::catalogue;
use super::output::{Output, refuse};
use crate::scenario::fault::nearest;
use crate::scenario::section::Key;
use std::fmt::Write as _;

/// Beginning of the chapter of the book.
const HEAD: &str = "\
# Keys

After this chapter you can find what a scenario can set: each key with its default, its meaning, its
type and its range. A name ends with the unit, if there is one. [Scenarios](scenarios.md) explains
how a scenario is written. `rubik-robot keys --markdown > docs/keys.md` writes this page.
";

/// Lists the keys whose name contains `word`, as lines for a terminal or as a chapter of the book;
/// returns the exit code.
pub(super) fn run(word: Option<&str>, markdown: bool, output: &mut Output) -> anyhow::Result<u8> {
    let keys = catalogue::all_keys();
    let chosen: Vec<&Key> =
        keys.iter().filter(|key| word.is_none_or(|word| key.path.contains(word))).collect();
    if chosen.is_empty() {
        let word = word.unwrap_or_default();
        return Err(refuse(format!(
            "no key contains `{word}`: {}`{} keys` lists all keys",
            meant(word, &keys),
            catalogue::program().program
        )));
    }
    if markdown {
        output.text(&chapter(&chosen))?;
        return Ok(0);
    }
    for key in chosen {
        output.line(&format!("{} = {}", key.path, key.default))?;
        output.line(&format!("    {} ({})", key.meaning, kind(key)))?;
    }
    Ok(0)
}

/// Returns type and range of a key in words.
fn kind(key: &Key) -> String {
    // A range without an upper end only says that the number is not negative.
    let range = key.range.as_ref().filter(|range| range.end().is_finite());
    let range = range.map(|range| format!(", {}..{}", range.start(), range.end()));
    format!("{}{}", key.kind, range.unwrap_or_default())
}

/// Returns the chapter of the book that lists `keys`, with a heading for each section.
fn chapter(keys: &[&Key]) -> String {
    let mut text = HEAD.to_owned();
    let mut section = None;
    for key in keys {
        let (of, _) = key.path.split_once('.').unwrap_or(("", ""));
        if section != Some(of) {
            section = Some(of);
            // Writing to a string cannot fail.
            let _ = write!(text, "\n## {}\n\n", if of.is_empty() { "Whole run" } else { of });
        }
        // Markdown takes a text in angle brackets for an element of HTML.
        let meaning = key.meaning.replace('<', "&lt;");
        let _ = writeln!(text, "- `{} = {}`: {meaning} ({})", key.path, key.default, kind(key));
    }
    text
}

/// Returns the question whether a similar part of a key's name was meant; empty if there is none.
fn meant(word: &str, keys: &[Key]) -> String {
    let parts: Vec<&str> = keys.iter().flat_map(|key| key.path.split('.')).collect();
    nearest(word, &parts).map(|part| format!("did you mean `{part}`? ")).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chapter_of_book_lists_the_keys() {
        let keys = catalogue::all_keys();
        let all: Vec<&Key> = keys.iter().collect();

        let written = include_str!("../../docs/keys.md");

        // After another key: `rubik-robot keys --markdown > docs/keys.md`.
        assert!(chapter(&all) == written, "docs/keys.md is not that of this build");
    }

    #[test]
    fn misspelled_key_gets_the_nearest_name() {
        let keys = catalogue::all_keys();

        assert_eq!(meant("complaince", &keys), "did you mean `compliance`? ");
        assert_eq!(meant("nosuchword", &keys), "");
    }
}
