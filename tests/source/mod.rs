//! Reader of Rust files as text: finds the files, and separates code from comments and tests.

#![allow(dead_code, reason = "each test that includes this uses a part of it")]

use std::path::Path;

/// File of the crate: path below `src/` and text.
pub(crate) type File = (String, String);

/// Adds path and text of all Rust files below a folder to `into`, in alphabetical order. The paths
/// are relative to the folder, with `prefix` before them.
pub(crate) fn collect(folder: &Path, prefix: &str, into: &mut Vec<File>) {
    let mut entries: Vec<_> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        let name = format!("{prefix}{}", path.file_name().unwrap().to_str().unwrap());
        if path.is_dir() {
            collect(&path, &format!("{name}/"), into);
        } else if path.extension().is_some_and(|e| e == "rs") {
            into.push((name, std::fs::read_to_string(&path).unwrap()));
        }
    }
}

/// Member crate whose modules the other crates name as if they were their own.
const VOCABULARY: &str = "vocabulary";

/// Modules of [`VOCABULARY`].
const WORDS: &[&str] = &["cell", "cube", "kinematics", "motion", "spatial"];

/// The other member crates: folders of `src/`.
const MEMBERS: &[&str] = &["solver", "vision"];

/// Reads all files of the root crate and of its member crates, which lie in folders of `src`, as if
/// they were modules of one crate.
pub(crate) fn as_one_crate(src: &Path) -> Vec<File> {
    let mut files = Vec::new();
    collect(src, "", &mut files);
    files.retain(|(file, _)| file != "vocabulary/lib.rs");
    files.into_iter().map(from_root).collect()
}

/// Rewrites a file of a member crate as if it were a module of the root crate: its name, and the
/// paths in its `use` declarations and code.
pub(crate) fn from_root((file, text): File) -> File {
    let mut text = text.replace("rubik_robot_vocabulary", "crate");
    for member in MEMBERS {
        text = text.replace(&format!("rubik_robot_{member}"), &format!("crate::{member}"));
    }
    let (folder, rest) = file.split_once('/').unwrap_or(("", &file));
    if folder == VOCABULARY {
        return (rest.to_owned(), text);
    }
    if !MEMBERS.contains(&folder) {
        return (file, text);
    }
    let mut pieces = text.split("crate::");
    let mut whole = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let word = piece.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap();
        let below = if WORDS.contains(&word) { "" } else { &format!("{folder}::") };
        whole.extend(["crate::", below, piece]);
    }
    (format!("{folder}/{}", if rest == "lib.rs" { "mod.rs" } else { rest }), whole)
}

/// Reads the path or group of paths that begins at token `i`, as `a::b::{c, d::e}`. Adds each path
/// to `found` with `prefix` before it, here `a::b::c` and `a::b::d::e`, and moves `i` behind it.
pub(crate) fn expand(
    tokens: &[String],
    i: &mut usize,
    prefix: &mut Vec<String>,
    found: &mut Vec<Vec<String>>,
) {
    let before = prefix.len();
    loop {
        match tokens.get(*i).map(String::as_str) {
            Some("{") => {
                *i += 1;
                while tokens.get(*i).is_some_and(|t| t != "}") {
                    let start = *i;
                    expand(tokens, i, prefix, found);
                    while tokens.get(*i).is_some_and(|t| t != "," && t != "}") {
                        *i += 1;
                    }
                    if tokens.get(*i).is_some_and(|t| t == ",") {
                        *i += 1;
                    }
                    assert!(*i > start, "a group of `use` that cannot be read");
                }
                *i += 1;
                break;
            }
            Some(word)
                if word == "*" || word.starts_with(|c: char| c.is_alphabetic() || c == '_') =>
            {
                prefix.push(word.to_owned());
                *i += 1;
                if tokens.get(*i).is_some_and(|t| t == "::") {
                    *i += 1;
                    continue;
                }
                found.push(prefix.clone());
                break;
            }
            _ => {
                found.push(prefix.clone());
                break;
            }
        }
    }
    prefix.truncate(before);
}

/// Splits code into words, `::` and single characters.
pub(crate) fn tokens(code: &str) -> Vec<String> {
    let mut all = Vec::new();
    let mut chars = code.chars().peekable();
    while let Some(c) = chars.next() {
        if c.is_alphanumeric() || c == '_' {
            let mut word = c.to_string();
            while let Some(n) = chars.next_if(|n| n.is_alphanumeric() || *n == '_') {
                word.push(n);
            }
            all.push(word);
        } else if c == ':' && chars.next_if_eq(&':').is_some() {
            all.push("::".to_owned());
        } else if !c.is_whitespace() {
            all.push(c.to_string());
        }
    }
    all
}

/// Returns the text with blanks in place of comments, strings and character literals. The number of
/// each line stays the same.
pub(crate) fn without_comments_and_strings(text: &str) -> String {
    let c: Vec<char> = text.chars().collect();
    let mut out = String::with_capacity(text.len());
    let mut i = 0;
    while i < c.len() {
        let two = (c[i], c.get(i + 1).copied().unwrap_or(' '));
        let start = i;
        match two {
            ('/', '/') => {
                while i < c.len() && c[i] != '\n' {
                    i += 1;
                }
            }
            ('/', '*') => {
                let mut depth = 0;
                loop {
                    match (c.get(i), c.get(i + 1)) {
                        (Some('/'), Some('*')) => {
                            depth += 1;
                            i += 2;
                        }
                        (Some('*'), Some('/')) => {
                            depth -= 1;
                            i += 2;
                        }
                        (None, _) => break,
                        _ => i += 1,
                    }
                    if depth == 0 {
                        break;
                    }
                }
            }
            ('r', '"' | '#') if start == 0 || !c[start - 1].is_alphanumeric() => {
                let hashes = c[i + 1..].iter().take_while(|x| **x == '#').count();
                if c.get(i + 1 + hashes) == Some(&'"') {
                    i += 2 + hashes;
                    while i < c.len()
                        && !(c[i] == '"'
                            && c[i + 1..].iter().take_while(|x| **x == '#').count() >= hashes)
                    {
                        i += 1;
                    }
                    i += 1 + hashes;
                } else {
                    i += 1;
                    out.push('r');
                    continue;
                }
            }
            ('"', _) => {
                i += 1;
                while i < c.len() && c[i] != '"' {
                    i += if c[i] == '\\' { 2 } else { 1 };
                }
                i += 1;
            }
            // This is a character and no lifetime: '{', '\n', '\u{1F}'.
            ('\'', '\\') => {
                i += 3;
                while i < c.len() && c[i] != '\'' {
                    i += 1;
                }
                i += 1;
            }
            ('\'', _) if c.get(i + 2) == Some(&'\'') => i += 3,
            _ => {
                out.push(c[i]);
                i += 1;
                continue;
            }
        }
        let end = i.min(c.len());
        out.extend(c[start..end].iter().map(|x| if *x == '\n' { '\n' } else { ' ' }));
    }
    out
}

/// Returns the code without the items after `#[cfg(test)]`.
pub(crate) fn without_tests(code: &str) -> String {
    let mut out = String::new();
    let mut rest = code;
    while let Some(at) = rest.find("#[cfg(test)]") {
        out.push_str(&rest[..at]);
        let item = &rest[at..];
        let mut depth = 0;
        let mut end = item.len();
        for (i, c) in item.char_indices() {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                _ => {}
            }
            if depth == 0 && matches!(c, '}' | ';') {
                end = i + 1;
                break;
            }
        }
        rest = &item[end..];
    }
    out.push_str(rest);
    out
}
