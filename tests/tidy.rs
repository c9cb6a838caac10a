//! Counts of the violations of the English and size rules (CONTRIBUTING.md). Each count may only
//! fall, see `ratchet/counts.txt`.
//!
//! - sentences in comments that begin with a word of [`HEADLESS`] and so name no subject
//! - lines of more than 100 columns, also in comments: `rustfmt` breaks neither comments nor
//!   strings
//! - names of tests of more than eight words: the story of a test belongs into its doc comment
//! - functions in `src/` of more than 70 lines or 5 arguments (`self` is one), without tests

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

mod ratchet;
mod source;

use source::{File, collect, tokens, without_comments_and_strings, without_tests};
use std::path::Path;

/// First words of a sentence that names no subject.
const HEADLESS: &[&str] = &["Who", "Whoever", "What", "Whatever", "Nobody", "Somebody", "Of"];
/// Most columns of a line.
const COLUMNS: usize = 100;
/// Most words in the name of a test.
const WORDS: usize = 8;
/// Most lines of a function.
const LINES: usize = 70;
/// Most arguments of a function.
const ARGUMENTS: usize = 5;

/// Returns path and text of all Rust files in these folders of the project.
fn files(folders: &[&str]) -> Vec<File> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    for folder in folders {
        collect(&root.join(folder), &format!("{folder}/"), &mut files);
    }
    files
}

/// Prints each place in the project's files that breaks a rule, as `of_file` finds them, and checks
/// that their number does not exceed the one in `counts.txt`.
fn count(rule: &str, of_file: impl Fn(&str) -> Vec<(usize, String)>) {
    count_in(&["src", "tests", "benches", "examples"], rule, of_file);
}

/// Checks the count as [`count`] does, in the files of these folders.
fn count_in(folders: &[&str], rule: &str, of_file: impl Fn(&str) -> Vec<(usize, String)>) {
    let files = files(folders);
    assert!(files.len() > 20, "only {} files were found", files.len());
    let mut count = 0;
    for (file, text) in &files {
        for (line, what) in of_file(text) {
            println!("{file}:{}: {what}", line + 1);
            count += 1;
        }
    }
    ratchet::holds(rule, count);
}

#[test]
fn comment_sentences_name_their_subject() {
    count("headless sentences in comments", headless);
}

#[test]
fn lines_have_at_most_100_columns() {
    count("lines of more than 100 columns", long_lines);
}

#[test]
fn test_names_have_at_most_eight_words() {
    count("test names of more than eight words", long_test_names);
}

#[test]
fn functions_exceed_neither_70_lines_nor_5_arguments() {
    count_in(&["src"], "functions of more than 70 lines or 5 arguments", large_functions);
}

/// Returns the functions with too many lines or arguments, by line. Leaves out the test items.
fn large_functions(text: &str) -> Vec<(usize, String)> {
    let code = without_tests(&without_comments_and_strings(text));
    let word = |c: char| c.is_alphanumeric() || c == '_';
    let mut found = Vec::new();
    for (at, _) in code.match_indices("fn ").filter(|(at, _)| !code[..*at].ends_with(word)) {
        let name = code[at + 3..].split(|c| !word(c)).next().unwrap_or_default();
        let (arguments, lines) = size(&code[at + 3 + name.len()..]).unwrap_or_default();
        if !name.is_empty() && (arguments > ARGUMENTS || lines > LINES) {
            let line = code[..at].matches('\n').count();
            found.push((line, format!("{name}: {lines} lines, {arguments} arguments")));
        }
    }
    found
}

/// Returns the numbers of arguments and lines of a function; `None` if it has no body. `text` is
/// the code that follows the function's name.
fn size(text: &str) -> Option<(usize, usize)> {
    // Open brackets, and open angles up to the end of the arguments.
    let (mut depth, mut angles) = (0, 0);
    let (mut arguments, mut blank, mut listed, mut before) = (0, true, false, ' ');
    for (at, c) in text.char_indices() {
        match c {
            ';' if depth == 0 => return None,
            '(' | '[' | '{' => {
                depth += 1;
                blank = depth == 1 && angles == 0;
            }
            ')' | ']' | '}' => {
                depth -= 1;
                if depth == 0 && c == '}' {
                    return Some((arguments, text[..at].matches('\n').count() + 1));
                }
                if depth == 0 && angles == 0 && !listed {
                    listed = true;
                    arguments += usize::from(!blank);
                }
            }
            ',' if !listed && depth == 1 && angles == 0 => {
                arguments += usize::from(!blank);
                blank = true;
            }
            '<' if !listed => angles += 1,
            '>' if !listed && before != '-' => angles -= 1,
            c => blank &= c.is_whitespace(),
        }
        before = c;
    }
    None
}

/// Returns the sentences in a file's comments that begin with a word of [`HEADLESS`], each with the
/// number of the last line of its block of comments.
fn headless(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let mut block = String::new();
    // One more line ends the last block.
    for (number, line) in text.lines().chain([""]).enumerate() {
        let comment = line.trim_start().strip_prefix("//");
        let more = comment.map(|c| c.trim_start_matches(['/', '!']).trim());
        if let Some(more) = more.filter(|c| !c.is_empty()) {
            // An item of a list, or a heading, begins a new sentence.
            let apart = if more.starts_with(['-', '#', '|']) { ". " } else { " " };
            block.push_str(apart);
            block.push_str(more.trim_start_matches(['-', '#', '|', ' ']));
        } else {
            let headless = sentences(&block).into_iter().filter(|s| {
                let first = s.split(|c: char| !c.is_alphabetic()).next();
                first.is_some_and(|word| HEADLESS.contains(&word))
            });
            found.extend(headless.map(|s| (number.saturating_sub(1), s.to_owned())));
            block.clear();
        }
    }
    found
}

/// Splits a text after each full stop, question or exclamation mark before a blank.
fn sentences(text: &str) -> Vec<&str> {
    let ends = text.match_indices(['.', '?', '!']).map(|(at, _)| at + 1);
    let ends = ends.filter(|&at| text[at..].starts_with(' ')).chain([text.len()]);
    let mut begin = 0;
    ends.map(|end| {
        let sentence = text[begin..end].trim();
        begin = end;
        sentence
    })
    .collect()
}

/// Returns the lines of more than [`COLUMNS`] characters, each with its number.
fn long_lines(text: &str) -> Vec<(usize, String)> {
    let long = |line: &&str| line.chars().count() > COLUMNS;
    let lines = text.lines().enumerate().filter(|(_, line)| long(line));
    lines.map(|(number, line)| (number, line.trim().to_owned())).collect()
}

/// Returns the names of tests of more than [`WORDS`] words, each with the number of its line.
fn long_test_names(text: &str) -> Vec<(usize, String)> {
    let bare = without_comments_and_strings(text);
    let mut found = Vec::new();
    let mut test = false;
    for (number, line) in bare.lines().enumerate() {
        let line = line.trim_start();
        test |= line.starts_with("#[test]") || line.starts_with("#[tokio::test");
        let words = tokens(line);
        let name = words.iter().position(|t| t == "fn").and_then(|at| words.get(at + 1));
        if let Some(name) = name.filter(|_| std::mem::take(&mut test))
            && name.split('_').count() > WORDS
        {
            found.push((number, name.clone()));
        }
    }
    found
}

#[cfg(test)]
mod counter_tests {
    use super::*;

    #[test]
    fn sentences_without_subject_are_found_in_comments() {
        // Each line by itself: a line of this file that begins with slashes would count.
        let text = [
            "/// Returns it. What is left",
            "/// stays. Of two, one. Often so.",
            "fn f() {}",
            "//! - Whoever asks",
            "//! - the asker: what it asks",
            "// So: Nobody? Who knows",
            "",
        ];
        let found: Vec<String> = headless(&text.join("\n")).into_iter().map(|(_, s)| s).collect();
        assert_eq!(found, ["What is left stays.", "Of two, one.", "Whoever asks.", "Who knows"]);
    }

    #[test]
    fn line_length_is_counted_in_characters_not_bytes() {
        let text = format!("{}\n{}\n", "\u{e4}".repeat(100), "b".repeat(101));
        assert_eq!(long_lines(&text), [(1, "b".repeat(101))]);
    }

    #[test]
    fn large_functions_are_found_by_lines_and_arguments() {
        let six =
            "fn six<F: Fn(u8) -> u8>(&self, a: [u8; 2], b: (u8, u8), c: M<u8, u8>, d: F, e: u8,)";
        let long = "x;\n".repeat(69);
        let text = format!(
            "{six} {{}}\n{six};\nfn five(a: M<u8, u8>, b: u8, c: u8, d: u8, e: u8) {{}}\n\
             fn long() -> [u8; 2] {{\n{long}}}\nfn short() {{\n{}}}\n\
             #[cfg(test)]\nmod tests {{\nfn test() {{\n{long}}}\n}}\n",
            &long[3..]
        );
        let found: Vec<String> = large_functions(&text).into_iter().map(|(_, name)| name).collect();
        assert_eq!(found, ["six: 1 lines, 6 arguments", "long: 71 lines, 0 arguments"]);
    }

    #[test]
    fn only_test_names_over_eight_words_are_found() {
        let text = "#[test]\nfn a_b_c_d_e_f_g_h() {}\nfn a_b_c_d_e_f_g_h_i() {}\n\
                    #[test]\n#[ignore]\nfn a_b_c_d_e_f_g_h_j() {}\n";
        assert_eq!(long_test_names(text), [(5, "a_b_c_d_e_f_g_h_j".to_owned())]);
    }
}
