//! `rubik-robot keys`: lists the keys of scenarios with unit, default, range and meaning.

use super::catalogue;
use super::output::{Output, refuse};

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
        return Err(refuse(format!("no key contains `{word}`: `rubik-robot keys` lists all keys")));
    }
    Ok(0)
}
