//! `rubik-robot completions` and `rubik-robot man`: what a shell and a reader of manuals want.

use super::output::Output;
use super::{Cli, WRONG, complain};
use clap::CommandFactory;

pub(super) fn completions(shell: clap_complete::Shell, output: &mut Output) -> anyhow::Result<u8> {
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "rubik-robot", &mut text);
    output.text(&String::from_utf8_lossy(&text))?;
    Ok(0)
}

pub(super) fn manual(command: Option<&str>, output: &mut Output) -> anyhow::Result<u8> {
    let mut program = Cli::command();
    program.build();
    let title = command.map_or_else(|| "rubik-robot".to_owned(), |c| format!("rubik-robot-{c}"));
    let page = match command {
        None => program,
        Some(name) => {
            let Some(found) = program.find_subcommand(name) else {
                complain(&format!("there is no command `{name}`; see rubik-robot --help"));
                return Ok(WRONG);
            };
            found.clone()
        }
    };
    let mut text = Vec::new();
    clap_mangen::Man::new(page).title(title).render(&mut text)?;
    output.text(&String::from_utf8_lossy(&text))?;
    Ok(0)
}
