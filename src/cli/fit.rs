//! Text of a help, broken to the width of the terminal.
//!
//! The texts in the code are broken at 100 columns. This module breaks their lines again, and
//! keeps the columns of lists and the examples, which are no prose.

use clap::Error;
use clap::error::ErrorKind;
use std::io::{IsTerminal as _, Write as _, stdout};
use unicode_width::UnicodeWidthStr as _;

/// Columns at which the texts of the help are broken in the code.
const SOURCE: usize = 100;
/// Columns without a terminal.
const USUAL: usize = 80;
/// Deepest indent of the rows of a list.
const DEEPEST: usize = 8;
/// Columns of a list after which no second column begins.
const LAST: usize = 36;

/// Prints a help, broken to the width of the terminal; returns `false` for any other message of
/// clap.
pub(super) fn print_help(message: &Error) -> bool {
    if message.kind() != ErrorKind::DisplayHelp {
        return false;
    }
    let text = message.render();
    let colours = crate::hw::console::colours_results();
    let text = if colours { text.ansi().to_string() } else { text.to_string() };
    // A closed pipe is no error.
    let _ = stdout().write_all(fitted(&text, columns()).as_bytes());
    let _ = stdout().flush();
    true
}

/// Returns the number of columns for a help on stdout.
fn columns() -> usize {
    if !stdout().is_terminal() {
        return USUAL;
    }
    let columns = rustix::termios::tcgetwinsize(stdout()).map_or(0, |size| size.ws_col);
    if columns == 0 { USUAL } else { usize::from(columns).clamp(40, SOURCE) }
}

/// Returns `text` with lines of at most `columns` columns, except for the command lines in it.
fn fitted(text: &str, columns: usize) -> String {
    let mut fitted = String::with_capacity(text.len() + text.len() / 8);
    // Rest of the line before, which continues in the next one.
    let mut rest = String::new();
    let mut lines = text.split('\n').peekable();
    while let Some(source) = lines.next() {
        let line = if rest.is_empty() {
            source.to_owned()
        } else {
            format!("{rest} {}", source.trim_start())
        };
        rest.clear();
        let mut broken = broken(&line, columns);
        // The last piece joins the next line if the writer broke the text there.
        if broken.len() > 1
            && let Some(next) = lines.peek()
            && continues(source, next, hanging(&line))
            && let Some(last) = broken.pop()
        {
            rest = last;
        }
        fitted.push_str(&broken.join("\n"));
        if lines.peek().is_some() {
            fitted.push('\n');
        }
    }
    fitted
}

/// Returns whether `next` continues the sentence of `line`: its indent is that of the text, and it
/// begins in lower case, or its first word had no room in that line.
fn continues(line: &str, next: &str, hanging: usize) -> bool {
    let indent = next.len() - next.trim_start().len();
    let word = next.split_whitespace().next().unwrap_or_default();
    // A word in brackets is a default, which has a line of its own.
    let prose = !word.is_empty() && !word.starts_with('[') && text_start(next).is_none();
    let filled = width(line) + 1 + word.width() > SOURCE;
    // Rows of a list without a second column are apart unless a comma joins them.
    let row = (1..=DEEPEST).contains(&indent);
    let sentence = !line.ends_with(['.', ':']) && !word.starts_with(char::is_uppercase);
    let same = filled || line.ends_with(',') || (sentence && !row);
    let aligned = indent == hanging || (indent > DEEPEST && hanging > DEEPEST);
    prose && same && aligned && !is_command(line) && !is_command(next)
}

/// Returns whether a line has an example of a command.
fn is_command(line: &str) -> bool {
    let indent = line.len() - line.trim_start().len();
    indent == 2 && line.contains("rubik-robot ") && !line.contains("`rubik-robot ")
}

/// Breaks a line between words into lines of at most `columns` columns.
fn broken(line: &str, columns: usize) -> Vec<String> {
    if width(line) <= columns {
        return vec![line.to_owned()];
    }
    let hanging = hanging(line);
    if is_command(line) {
        // A shell needs the command in one line; its comment moves to the next one.
        let Some((command, comment)) = line.rsplit_once("  # ") else {
            return vec![line.to_owned()];
        };
        let column = columns.saturating_sub(comment.width() + 2).min(24);
        return vec![command.trim_end().to_owned(), format!("{}# {comment}", " ".repeat(column))];
    }
    let start = line.len() - line.trim_start().len();
    // Blanks inside of the first column, before the text, stay as they are.
    let first = text_start(line).unwrap_or(start);
    let (mut lines, mut current) = (Vec::new(), line[..first].to_owned());
    let mut empty = true;
    for word in line[first..].split(' ').filter(|word| !word.is_empty()) {
        if !empty && width(&current) + 1 + width(word) > columns {
            lines.push(std::mem::replace(&mut current, " ".repeat(hanging)));
            empty = true;
        }
        if !empty {
            current.push(' ');
        }
        current.push_str(word);
        empty = false;
    }
    lines.push(current);
    lines
}

/// Returns the column in which the text of a line continues: that of the second column of a list,
/// otherwise the indent.
fn hanging(line: &str) -> usize {
    let indent = line.len() - line.trim_start().len();
    text_start(line).map_or(indent, |at| width(&line[..at]))
}

/// Returns the byte at which the second column of a list begins; `None` for a line of prose.
fn text_start(line: &str) -> Option<usize> {
    let indent = line.len() - line.trim_start().len();
    if indent == 0 || indent > DEEPEST {
        return None;
    }
    let gap = indent + line[indent..].find("  ")?;
    let start = gap + (line[gap..].len() - line[gap..].trim_start().len());
    (width(&line[..start]) <= LAST && start < line.len()).then_some(start)
}

/// Returns the number of columns of a line without its escape sequences.
fn width(line: &str) -> usize {
    let mut pieces = line.split('\u{1b}');
    let first = pieces.next().map_or(0, unicode_width::UnicodeWidthStr::width);
    let rest = pieces.map(|piece| piece.split_once('m').map_or(0, |(_, text)| text.width()));
    first + rest.sum::<usize>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prose_is_broken_again_and_keeps_paragraphs() {
        let first = format!("{} end.", ["word"; 18].join(" "));
        let text = format!("{first}\nA longer paragraph.\nExit codes: 0 done.\n");

        let fitted = fitted(&text, 80);

        let wanted = format!(
            "{}\n{} end.\nA longer paragraph.\nExit codes: 0 done.\n",
            ["word"; 16].join(" "),
            ["word"; 2].join(" ")
        );
        assert_eq!(fitted, wanted);
        // A line that was full continues in the next one.
        let full = ["word"; 20].join(" ");
        let text = super::fitted(&format!("{full}\nlonger last.\n"), 80);
        let (head, tail) = (["word"; 16].join(" "), ["word"; 4].join(" "));
        assert_eq!(text, format!("{head}\n{tail} longer last.\n"));
    }

    #[test]
    fn rows_of_a_list_stay_apart() {
        let row = ["word"; 17].join(" ");

        let text = fitted(&format!("  {row}\n  other row\n  {row},\n  same row\n"), 80);

        let lines: Vec<&str> = text.lines().map(str::trim).collect();
        assert!(lines.contains(&"other row"), "{text}");
        assert!(lines.contains(&"word word, same row"), "{text}");
    }

    #[test]
    fn second_column_keeps_its_indent() {
        let text = fitted(&format!("  --mode <MODE>  {}", ["word"; 20].join(" ")), 60);

        let lines: Vec<&str> = text.lines().collect();
        assert!(lines.len() > 1 && lines.iter().all(|line| line.len() <= 60), "{text}");
        assert!(lines[1].starts_with(&format!("{}word", " ".repeat(17))), "{text}");
    }

    #[test]
    fn command_stays_whole_and_comment_moves_down() {
        let command = "  rubik-robot run scenarios/solve.toml --set control.compliance=none";

        let text = fitted(&format!("{command}    # without force control"), 80);

        assert_eq!(text, format!("{command}\n{}# without force control", " ".repeat(24)));
    }
}
