//! `rubik-robot completions` and `rubik-robot man`: completions for a shell, and manual pages.

use super::output::{Output, refuse};
use crate::scenario::fault::nearest;

/// Prints the script with which a shell completes the words of `program`; returns the exit code.
pub(super) fn completions(
    shell: clap_complete::Shell,
    program: &mut clap::Command,
    output: &mut Output,
) -> anyhow::Result<u8> {
    let mut text = Vec::new();
    let name = program.get_name().to_owned();
    clap_complete::generate(shell, program, name, &mut text);
    output.text(&String::from_utf8_lossy(&text))?;
    Ok(0)
}

/// Prints the manual page of `command`, or of `program` if it is `None`; returns the exit code.
pub(super) fn manual(
    command: Option<&str>,
    mut program: clap::Command,
    output: &mut Output,
) -> anyhow::Result<u8> {
    // Only a built command has its usage line and its options `--help` and `--version`.
    program.build();
    // The page of a command has the name that `man` expects: rubik-robot-run.
    let own = program.get_name().to_owned();
    let title = command.map_or_else(|| own.clone(), |c| format!("{own}-{c}"));
    let page = match command {
        None => program,
        Some(name) => {
            let Some(found) = program.find_subcommand(name) else {
                let names: Vec<&str> =
                    program.get_subcommands().map(clap::Command::get_name).collect();
                let near = nearest(name, &names);
                let near = near.map(|near| format!("did you mean `{near}`? ")).unwrap_or_default();
                return Err(refuse(format!(
                    "there is no command `{name}`: {near}`{own} --help` lists the commands"
                )));
            };
            found.clone()
        }
    };
    let mut text = Vec::new();
    clap_mangen::Man::new(page).title(title).render(&mut text)?;
    output.text(&String::from_utf8_lossy(&text))?;
    Ok(0)
}
