//! Answers to a wrong call, and the printing of helps.
//!
//! - in: a message of clap
//! - out: the message with what was probably meant: a word, a scenario, or a scramble

use super::fit;
use super::output::inform;
use super::scenarios;
use super::solve::scramble_of;
use crate::scenario::fault::nearest;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Command, Error};
use std::process::ExitCode;

/// Prints a message of clap, with advice; returns the exit code. `program` has the commands.
pub(super) fn answer(mut message: Error, program: &Command) -> ExitCode {
    let code = u8::try_from(message.exit_code()).unwrap_or(1);
    if fit::print_help(&message) {
        return ExitCode::from(code);
    }
    suggest(&mut message, program);
    // A closed stream has no reader, which is no error.
    let _ = message.print();
    let words: Vec<String> =
        std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    if let Some(advice) = advice(&message, &words) {
        inform(&format!("\n{advice}"));
    }
    ExitCode::from(code)
}

/// Adds the nearest word to a message about an unknown one. clap compares words by their common
/// beginning, and so suggests nothing for `rnu`.
fn suggest(message: &mut Error, program: &Command) {
    let text = |message: &Error, kind| match message.get(kind) {
        Some(ContextValue::String(text)) => Some(text.clone()),
        _ => None,
    };
    match message.kind() {
        ErrorKind::InvalidSubcommand if message.get(ContextKind::SuggestedSubcommand).is_none() => {
            let Some(wrong) = text(message, ContextKind::InvalidSubcommand) else { return };
            let names: Vec<&str> = program.get_subcommands().map(Command::get_name).collect();
            if let Some(name) = nearest(&wrong, &names) {
                let names = ContextValue::Strings(vec![name.to_owned()]);
                message.insert(ContextKind::SuggestedSubcommand, names);
            }
        }
        ErrorKind::InvalidValue if message.get(ContextKind::SuggestedValue).is_none() => {
            let Some(wrong) = text(message, ContextKind::InvalidValue) else { return };
            let Some(ContextValue::Strings(values)) = message.get(ContextKind::ValidValue) else {
                return;
            };
            let values: Vec<&str> = values.iter().map(String::as_str).collect();
            if let Some(value) = nearest(&wrong, &values) {
                let value = ContextValue::String(value.to_owned());
                message.insert(ContextKind::SuggestedValue, value);
            }
        }
        _ => {}
    }
}

/// Returns advice on a call of these words: the list of scenarios if one is missing, or the call
/// that solves a scramble without quotes.
fn advice(message: &Error, words: &[String]) -> Option<String> {
    match message.kind() {
        ErrorKind::MissingRequiredArgument => {
            let missing = match message.get(ContextKind::InvalidArg)? {
                ContextValue::Strings(missing) => missing.iter().any(|arg| arg == "<SCENARIO>"),
                ContextValue::String(missing) => missing == "<SCENARIO>",
                _ => false,
            };
            missing.then(|| scenarios::list().trim_end().to_owned())
        }
        ErrorKind::UnknownArgument => {
            let (command, moves) = words.split_first()?;
            let moves = moves.iter().map(String::as_str).filter(|word| !word.starts_with('-'));
            scramble_of(&moves.collect::<Vec<_>>().join(" ")).filter(|_| command == "solve")
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Cli;
    use clap::CommandFactory as _;

    /// Returns the text and the advice for a call with these words.
    fn answered(words: &[&str]) -> (String, Option<String>) {
        let program = Cli::command();
        let call = std::iter::once("rubik-robot").chain(words.iter().copied());
        let mut message = program.clone().try_get_matches_from(call).unwrap_err();
        suggest(&mut message, &program);
        let words: Vec<String> = words.iter().map(|&word| word.to_owned()).collect();
        (message.render().to_string(), advice(&message, &words))
    }

    #[test]
    fn unknown_words_get_the_nearest_ones() {
        for (words, wanted) in [
            (&["rnu"][..], "'run'"),
            (&["tabels"], "'tables'"),
            (&["run", "x.toml", "--ui", "wbe"], "'web'"),
            (&["run", "x.toml", "--sede", "3"], "'--seed'"),
        ] {
            let (text, advice) = answered(words);
            assert!(text.contains("tip: ") && text.contains(wanted), "{words:?}: {text}");
            assert_eq!(advice, None, "{words:?}");
        }
    }

    #[test]
    fn missing_scenario_gets_the_list() {
        for command in ["run", "check", "campaign"] {
            let (_, advice) = answered(&[command]);
            assert!(advice.unwrap().contains("shipped:solve "), "{command}");
        }
        assert_eq!(answered(&["vision", "locate"]).1, None);
    }

    #[test]
    fn moves_without_quotes_get_the_scramble_call() {
        let (_, advice) = answered(&["solve", "R", "U", "R'"]);

        assert!(advice.unwrap().contains("solve --scramble \"R U R'\""));
        assert_eq!(answered(&["solve", "R", "Q"]).1, None);
    }
}
