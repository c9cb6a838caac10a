//! Text of `rubik-robot --help`, with the commands in groups.
//!
//! clap has one heading for all subcommands, so this module writes the list itself, from the
//! description that each command gives of itself.

use clap::Command;
use clap::builder::StyledStr;
use std::fmt::Write as _;

/// Name of this crate's program, as the helps are written.
const OWN: &str = "rubik-robot";

/// Headings of the list, each with its commands.
const GROUPS: [(&str, &[&str]); 6] = [
    ("Run", &["run", "check", "keys", "parameters"]),
    ("Measure", &["campaign", "benchmark", "weigh", "doctor"]),
    ("Cube", &["solve", "plan", "scramble", "tables"]),
    ("Vision", &["vision", "calibrate", "picture"]),
    ("Hardware", &["emulate", "node", "kinematics"]),
    (
        "Files",
        &[
            "replay",
            "report",
            "export",
            "film",
            "recover",
            "merge",
            "urdf",
            "schema",
            "completions",
            "man",
        ],
    ),
];

/// Gives `program` a help text that lists its commands in groups. The helps of the commands stay
/// as they are.
pub(super) fn with_groups(program: Command) -> Command {
    let commands = commands(&program);
    let header = program.get_styles().get_header();
    let options = format!("{header}Options:{header:#}");
    // Doubled braces stay single ones in the template: clap replaces the names in them.
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{commands}\
         {options}\n{{options}}{{after-help}}"
    );
    program.help_template(template)
}

/// Gives a command line the name and the version of a program, also in the texts of all helps.
pub(super) fn named(command: Command, program: &str, version: &str) -> Command {
    if program == OWN {
        return command;
    }
    // clap keeps names for the life of the process, which has one command line.
    let name: &'static str = program.to_owned().leak();
    let version: &'static str = version.to_owned().leak();
    with_name(command, name).name(name).version(version)
}

/// Replaces the name of this crate's program in the texts of a command and of its subcommands.
fn with_name(mut command: Command, program: &str) -> Command {
    let own = |text: &StyledStr| renamed(&text.to_string(), program);
    if let Some(text) = command.get_after_help().map(own) {
        command = command.after_help(text);
    }
    if let Some(text) = command.get_about().map(own) {
        command = command.about(text);
    }
    command = command.mut_args(|arg| match arg.get_help().map(own) {
        Some(text) => arg.help(text),
        None => arg,
    });
    command.mut_subcommands(|command| with_name(command, program))
}

/// Replaces the name of this crate's program in a text, except as a part of a path.
fn renamed(text: &str, program: &str) -> String {
    let mut parts = text.split(OWN);
    let mut whole = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        whole += if whole.ends_with('/') { OWN } else { program };
        whole += part;
    }
    whole
}

/// Returns the list of commands: a heading, then a line for each command of the group.
fn commands(program: &Command) -> String {
    let names = GROUPS.iter().flat_map(|(_, names)| names.iter());
    let width = names.map(|name| name.len()).max().unwrap_or_default();
    let header = program.get_styles().get_header();
    let mut text = String::new();
    for (heading, names) in GROUPS {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{header}{heading}:{header:#}");
        for name in names {
            let about = program.find_subcommand(name).and_then(Command::get_about);
            let about = about.map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(text, "  {name:width$}  {about}");
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Cli;
    use clap::CommandFactory as _;

    /// Calls `check` for each command and subcommand, with the words that call it.
    fn for_each(command: &Command, words: &str, check: &mut dyn FnMut(&str, &Command)) {
        for sub in command.get_subcommands() {
            let words = format!("{words} {}", sub.get_name());
            check(&words, sub);
            for_each(sub, &words, check);
        }
    }

    /// Returns the example lines of a command's help.
    fn examples(command: &Command) -> Vec<String> {
        let help = command.get_after_long_help().or_else(|| command.get_after_help());
        let help = help.map(ToString::to_string).unwrap_or_default();
        let is_example =
            |line: &&str| line.starts_with("  rubik-robot ") || line.contains("| rubik-robot ");
        help.lines().filter(is_example).map(str::to_owned).collect()
    }

    /// Returns the words of each call of the program in an example line, as a shell splits them.
    fn calls(line: &str) -> Vec<Vec<String>> {
        let mut calls = vec![vec![String::new()]];
        let mut quote = None;
        for c in line.chars() {
            let call = calls.last_mut().unwrap();
            match (quote, c) {
                (Some(end), _) if c == end => quote = None,
                (None, '\'' | '"') => quote = Some(c),
                // The name after `>` or `<` is no word of the call, nor is a comment.
                (None, '|' | '>' | '<') => calls.push(vec![String::new()]),
                (None, '#') => break,
                (None, ' ') => call.push(String::new()),
                _ => call.last_mut().unwrap().push(c),
            }
        }
        for call in &mut calls {
            call.retain(|word| !word.is_empty());
        }
        calls.retain(|call| call.first().is_some_and(|word| word == "rubik-robot"));
        calls
    }

    #[test]
    fn helps_of_another_program_name_it() {
        let other = named(with_groups(Cli::command()), "own_cell", "3.1.4");

        for_each(&other, "own_cell", &mut |words, command| {
            let help = command.clone().render_long_help().to_string();
            let named = help.replace("/rubik-robot", "/").contains("rubik-robot");
            assert!(!named, "{words}: {help}");
        });
        let help = other.clone().render_long_help().to_string();
        assert!(help.contains("own_cell run") && !help.contains("rubik-robot "), "{help}");
        assert_eq!(other.render_version(), "own_cell 3.1.4\n");
    }

    #[test]
    fn each_command_is_in_one_group() {
        let program = Cli::command();
        let mut grouped: Vec<&str> =
            GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        let mut commands: Vec<&str> = program.get_subcommands().map(Command::get_name).collect();
        grouped.sort_unstable();
        commands.sort_unstable();

        assert_eq!(grouped, commands);
    }

    #[test]
    fn help_shows_each_group_and_description() {
        let help = with_groups(Cli::command()).render_help().to_string();

        for (heading, _) in GROUPS {
            assert!(help.contains(&format!("\n\n{heading}:\n")), "no {heading} in\n{help}");
        }
        for command in Cli::command().get_subcommands() {
            let about = command.get_about().unwrap().to_string();
            let line = help.lines().find(|line| line.ends_with(&format!("  {about}")));
            let name = format!("  {} ", command.get_name());
            assert!(line.is_some_and(|line| line.starts_with(&name)), "no {about} in\n{help}");
        }
        assert!(help.contains("\n\nOptions:\n") && help.contains("--version"), "{help}");
        assert!(help.contains("\n\nTry these") && help.contains("Exit codes"), "{help}");
    }

    #[test]
    fn each_command_has_two_examples() {
        for_each(&Cli::command(), "rubik-robot", &mut |words, command| {
            let count = examples(command).len();
            assert!(count >= 2, "{words} --help has {count} examples");
        });
    }

    /// Parses each example with clap, which also checks the values of its options. No command runs.
    #[test]
    fn examples_are_valid_calls() {
        let mut count = 0;
        for_each(&Cli::command(), "rubik-robot", &mut |_, command| {
            for line in examples(command) {
                let calls = calls(&line);
                assert!(!calls.is_empty(), "{line}");
                for call in calls {
                    let parsed = Cli::command().try_get_matches_from(&call);
                    assert!(parsed.is_ok(), "{line}: {}", parsed.unwrap_err());
                    count += 1;
                }
            }
        });
        assert!(count > 100, "only {count} calls");
    }
}
