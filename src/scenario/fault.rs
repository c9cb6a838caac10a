//! The faults of a scenario: place, reason and advice.
//!
//! - in: places (spans of a text) and reasons, which are collected while the scenario is read
//! - out: text with `file:line:column`, the reason, and the underlined line

use std::fmt;
use std::ops::Range;
use std::rc::Rc;

/// Text from which keys and values come: a file, or the value of one option of the command line.
#[derive(Debug, PartialEq, Eq)]
pub struct Source {
    /// Path of the file as the user wrote it, or the option: `--set cube.edge_mm`.
    pub name: String,
    /// The whole text.
    pub text: String,
    /// Whether it is a file; options have no lines to count.
    pub is_file: bool,
}

/// Place of a key or value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// Text that contains it.
    pub source: Rc<Source>,
    /// Range of bytes in the text.
    pub span: Range<usize>,
}

impl Place {
    /// Returns `file:line:column`, both counted from 1 in characters, or the name of the option.
    #[must_use]
    pub fn label(&self) -> String {
        if !self.source.is_file {
            return self.source.name.clone();
        }
        let (line, column, _) = self.line();
        format!("{}:{line}:{column}", self.source.name)
    }

    /// Returns line and column of the start, and the text of the line.
    fn line(&self) -> (usize, usize, &str) {
        let text = &self.source.text;
        // A span counts bytes, and a slice inside a character would panic.
        let mut start = self.span.start.min(text.len());
        while !text.is_char_boundary(start) {
            start -= 1;
        }
        let before = &text[..start];
        let line_start = before.rfind('\n').map_or(0, |i| i + 1);
        let line_end = text[start..].find('\n').map_or(text.len(), |i| start + i);
        let number = before.matches('\n').count() + 1;
        let column = text[line_start..start].chars().count() + 1;
        (number, column, text[line_start..line_end].trim_end_matches('\r'))
    }
}

/// Fault of a scenario.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// Place; `None` if the scenario has no text for it (a missing section).
    pub place: Option<Place>,
    /// Reason, with the wrong value.
    pub reason: String,
    /// Advice: what was probably meant, or what is possible.
    pub help: Option<String>,
}

impl fmt::Display for Fault {
    /// Writes place and reason, below them the line with carets under the key or value, and then
    /// the advice.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.place {
            None => write!(f, "{}", self.reason)?,
            Some(place) => {
                let (number, column, line) = place.line();
                write!(f, "{}: {}", place.label(), self.reason)?;
                let gutter = if place.source.is_file { number.to_string() } else { String::new() };
                // A tab has one column in the count but several on a screen, so the carets would be
                // shifted.
                let shown = line.replace('\t', " ");
                let rest = shown.chars().count().saturating_sub(column - 1);
                // A span of several lines is underlined in its first line only.
                let length = place.source.text.get(place.span.clone()).map_or(1, |t| {
                    t.lines().next().map_or(1, |first| first.trim_end().chars().count())
                });
                let carets = "^".repeat(length.clamp(1, rest.max(1)));
                write!(f, "\n  {gutter} | {shown}")?;
                write!(f, "\n  {} | {}{carets}", " ".repeat(gutter.len()), " ".repeat(column - 1))?;
            }
        }
        if let Some(help) = &self.help {
            write!(f, "\n  {help}")?;
        }
        Ok(())
    }
}

/// Most faults that are collected, and most that are shown: a person corrects the first ones.
const MOST: usize = 1000;
const MOST_SHOWN: usize = 10;

/// Number of faults above which the text is probably no scenario.
const MANY: usize = 20;

/// Faults of a scenario; never empty if returned as an error.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Faults(pub Vec<Fault>);

impl Faults {
    /// Adds a fault with its reason and its place in the text, if it has one.
    pub fn add(&mut self, place: Option<&Place>, reason: impl Into<String>) {
        self.push(Fault { place: place.cloned(), reason: reason.into(), help: None });
    }

    /// Returns whether no further fault is collected.
    pub(crate) fn is_full(&self) -> bool {
        self.0.len() >= MOST
    }

    /// Adds a fault, or drops it if there are [`MOST`] already.
    fn push(&mut self, fault: Fault) {
        if !self.is_full() {
            self.0.push(fault);
        }
    }

    /// Adds a fault with its reason, its place in the text, and advice to the user (`help`).
    pub fn add_with_help(
        &mut self,
        place: Option<&Place>,
        reason: impl Into<String>,
        help: impl Into<String>,
    ) {
        self.push(Fault { place: place.cloned(), reason: reason.into(), help: Some(help.into()) });
    }

    /// Sorts the faults in the order of the text, and drops repeated ones. Those of the file come
    /// before those of options, and faults without a place come last.
    #[must_use]
    pub fn sorted(mut self) -> Self {
        self.0.sort_by_key(|f| match &f.place {
            None => (2, String::new(), 0),
            Some(p) => (u8::from(!p.source.is_file), p.source.name.clone(), p.span.start),
        });
        // Two checks may find the same fault.
        self.0.dedup();
        self
    }
}

impl fmt::Display for Faults {
    /// Writes the first ten faults, and the number of the others.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, fault) in self.0.iter().take(MOST_SHOWN).enumerate() {
            if i > 0 {
                writeln!(f)?;
            }
            write!(f, "{fault}")?;
        }
        match self.0.len().saturating_sub(MOST_SHOWN) {
            0 => Ok(()),
            // A file of another kind has a fault in most of its lines.
            more if self.0.len() > MANY => {
                let over = if self.is_full() { "more than " } else { "" };
                write!(f, "\nand {over}{more} more: is this a scenario?")
            }
            more => write!(f, "\nand {more} more"),
        }
    }
}

impl std::error::Error for Faults {}

/// Longest word for which a similar one is sought (bytes).
const LONGEST: usize = 100;

/// Returns the word of `known` that the user probably meant by the `wrong` one: a similar word, or
/// the same word with a unit. Returns `None` if there is none.
#[must_use]
pub fn nearest<'a>(wrong: &str, known: &[&'a str]) -> Option<&'a str> {
    // The comparison takes the product of both lengths, and no known word is so long.
    if wrong.len() > LONGEST {
        return None;
    }
    let near = known
        .iter()
        .map(|k| (strsim::damerau_levenshtein(wrong, k), *k))
        .min_by_key(|(distance, _)| *distance)
        // A third of the letters may be wrong, but always one.
        .filter(|(distance, word)| *distance <= 1.max(word.len().max(wrong.len()) / 3))
        .map(|(_, word)| word);
    // `edge` for `edge_mm`: the user forgot the unit, which may be longer than a third of the word.
    let forgotten = known
        .iter()
        .copied()
        .filter(|k| wrong.len() >= 2 && k.starts_with(&format!("{wrong}_")))
        .min_by_key(|k| k.len());
    near.or(forgotten)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenario_error_shows_file_line_column_and_text() {
        let source = Rc::new(Source {
            name: "a.toml".into(),
            text: "[cube]\nedge_cm = 57\n".into(),
            is_file: true,
        });
        let place = Place { source, span: 7..14 };
        let fault =
            Fault { place: Some(place), reason: "unknown key `edge_cm`".into(), help: None };

        let text = fault.to_string();

        assert_eq!(text, "a.toml:2:1: unknown key `edge_cm`\n  2 | edge_cm = 57\n    | ^^^^^^^");
    }

    #[test]
    fn only_first_faults_are_written() {
        let text = |count: usize| {
            let mut faults = Faults::default();
            (0..count).for_each(|number| faults.add(None, format!("fault {number}")));
            faults.to_string()
        };

        assert!(text(10).ends_with("fault 9"), "{}", text(10));
        assert!(text(12).ends_with("fault 9\nand 2 more"), "{}", text(12));
        assert!(text(60).ends_with("and 50 more: is this a scenario?"), "{}", text(60));
        assert!(text(5000).ends_with("and more than 990 more: is this a scenario?"));
    }

    #[test]
    fn nearest_suggests_similar_key_or_key_with_unit() {
        assert_eq!(nearest("edge_cm", &["edge_mm", "mass_g"]), Some("edge_mm"));
        assert_eq!(nearest("edge", &["edge_mm", "mass_g"]), Some("edge_mm"));
        assert_eq!(nearest("velocity", &["edge_mm", "mass_g"]), None);
    }
}
