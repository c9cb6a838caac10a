//! `rubik-robot keys`: lists the keys of scenarios with unit, default, range and meaning.

use super::catalogue;
use super::output::{Output, refuse};
use crate::scenario::fault::nearest;
use crate::scenario::section::Key;

/// Lists the keys whose name contains `word`; returns the exit code.
pub(super) fn run(word: Option<&str>, output: &mut Output) -> anyhow::Result<u8> {
    let keys = catalogue::all_keys();
    let mut found = false;
    for key in keys.iter().filter(|k| word.is_none_or(|w| k.path.contains(w))) {
        found = true;
        // A range without an upper end only says that the number is not negative.
        let range = key
            .range
            .as_ref()
            .filter(|r| r.end().is_finite())
            .map_or_else(String::new, |range| format!(", {}..{}", range.start(), range.end()));
        output.line(&format!("{} = {}", key.path, key.default))?;
        output.line(&format!("    {} ({}{range})", key.meaning, key.kind))?;
    }
    if !found {
        let word = word.unwrap_or_default();
        return Err(refuse(format!(
            "no key contains `{word}`: {}`rubik-robot keys` lists all keys",
            meant(word, &keys)
        )));
    }
    Ok(0)
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
    fn misspelled_key_gets_the_nearest_name() {
        let keys = catalogue::all_keys();

        assert_eq!(meant("complaince", &keys), "did you mean `compliance`? ");
        assert_eq!(meant("nosuchword", &keys), "");
    }
}
