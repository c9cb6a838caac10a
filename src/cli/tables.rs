//! `rubik-robot tables`: builds, lists, verifies and removes the tables of the solver.
//!
//! - in: names of tables, the folder that keeps them
//! - out: a line of text or of JSON for each table
//! - exit code: 1 if a table could not be built, cannot be used, or could not be removed

use super::output::{Output, refuse};
use super::progress::{Bar, megabytes, print_news};
use crate::solver;
use crate::solver::table::TableSpec;
use crate::tables::{Observer, Store, Threads, Unusable};
use clap::{Args, Subcommand};
use std::path::PathBuf;

/// Folder of the solver's tables, as an option.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
pub(super) struct Folder {
    /// Folder of the solver's tables [default: $RUBIK_ROBOT_TABLES, or ~/.cache/rubik-robot]
    #[arg(long, value_name = "DIR", global = true)]
    tables: Option<PathBuf>,
}

impl Folder {
    /// Returns the store of the folder, or of the user's folder if none is given.
    pub(super) fn store(&self) -> Store {
        self.tables.clone().map_or_else(Store::for_user, Store::new)
    }
}

#[derive(Debug, Args)]
pub(super) struct TablesArgs {
    #[command(subcommand)]
    action: Action,
    #[command(flatten)]
    folder: Folder,
    /// Number of threads [default: number of cores that this process may use]
    #[arg(long, value_name = "N", global = true)]
    threads: Option<usize>,
    /// Print one line of JSON for each table
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Build the tables that are missing or cannot be used
    #[command(after_help = build_help())]
    Build(Names),
    /// List the tables with size, state and purpose
    #[command(after_help = "\
Examples:
  rubik-robot tables list
  rubik-robot tables list --json

The lines and the keys of --json are those of `rubik-robot tables --help`.
The last line without --json is the folder.
Exit codes: 0 listed, 1 a built table cannot be used, 2 wrong usage.")]
    List(Names),
    /// Verify the checksums of the tables and count their entries by value
    #[command(after_help = "\
Examples:
  rubik-robot tables verify
  rubik-robot tables verify phase2

The state of a sound table has the number of entries of each value, from 0. Entries are distances in
turns; some tables keep them modulo 3, or how each turn changes them.
The lines and the keys of --json are those of `rubik-robot tables --help`.
Exit codes: 0 no table is damaged (one that is not built counts as sound), 1 a table is damaged,
2 wrong usage.")]
    Verify(Names),
    /// Remove the files of the tables
    #[command(after_help = "\
Examples:
  rubik-robot tables remove
  rubik-robot tables remove phase1-large

The lines and the keys of --json are those of `rubik-robot tables --help`.
Exit codes: 0 removed, 1 a file cannot be removed, 2 wrong usage.")]
    Remove(Names),
}

/// Returns the end of the help of `tables build`, with the size of all tables.
fn build_help() -> String {
    let bytes: usize = solver::all_tables().iter().map(|spec| spec.bytes).sum();
    format!(
        "\
Examples:
  rubik-robot tables build                           # all tables: {:.1} GB
  rubik-robot tables build phase1-large phase2-large
  rubik-robot tables build --threads 4

The lines and the keys of --json are those of `rubik-robot tables --help`.
Exit codes: 0 built, 1 a table cannot be written to the folder, 2 wrong usage.",
        bytes as f64 * 1e-9
    )
}

/// Tables of a subcommand.
#[derive(Debug, Args)]
struct Names {
    /// Names of tables, as `tables list` prints them [default: all]
    #[arg(value_name = "NAME")]
    names: Vec<String>,
}

impl Action {
    /// Returns the names of the tables; an empty list means all tables.
    fn names(&self) -> &[String] {
        let (Self::Build(tables)
        | Self::List(tables)
        | Self::Verify(tables)
        | Self::Remove(tables)) = self;
        &tables.names
    }
}

/// Performs the action on the tables; returns the exit code.
pub(super) fn run(args: &TablesArgs, output: &mut Output) -> anyhow::Result<u8> {
    let all = solver::all_tables();
    let mut chosen: Vec<&TableSpec> = Vec::new();
    for name in args.action.names() {
        let Some(spec) = all.iter().find(|spec| spec.name == name) else {
            let names: Vec<&str> = all.iter().map(|spec| spec.name).collect();
            return Err(refuse(format!(
                "there is no table `{name}`: the tables are {}",
                names.join(", ")
            )));
        };
        chosen.push(spec);
    }
    // Without a name the action is for all tables.
    if chosen.is_empty() {
        chosen = all;
    }
    let store = args.folder.store();
    let workers = args.threads.map_or_else(Threads::all, Threads::new);
    let mut failed = false;
    for spec in chosen {
        let state = match &args.action {
            Action::Build(_) => build(&store, spec, workers),
            Action::List(_) => match store.open(spec, &workers) {
                Ok(_) => Ok("built".to_owned()),
                Err(Unusable::Absent) => Ok("not built".to_owned()),
                Err(reason) => Err(reason.to_string()),
            },
            Action::Verify(_) => verify(&store, spec, workers),
            Action::Remove(_) => store
                .remove(spec)
                .map(|was| if was { "removed" } else { "not built" }.to_owned())
                .map_err(|e| e.to_string()),
        };
        // One table that fails does not keep the others from being built or verified.
        failed |= state.is_err();
        let (ok, state) = match state {
            Ok(state) => (true, state),
            Err(state) => (false, state),
        };
        if args.json {
            let path = store.path(spec);
            output.line(
                &serde_json::json!({
                    "name": spec.name, "bytes": spec.bytes, "ok": ok, "state": state,
                    "purpose": spec.purpose, "path": path,
                })
                .to_string(),
            )?;
        } else {
            let size = megabytes(spec.bytes);
            output.line(&format!("{:16} {size:>10}  {state}; {}", spec.name, spec.purpose))?;
        }
        // A table may take minutes: its line appears when it is done.
        output.flush()?;
    }
    if !args.json && matches!(args.action, Action::List(_)) {
        output.line(&format!("folder: {}", store.folder().display()))?;
    }
    Ok(u8::from(failed))
}

/// Builds a table, unless a usable one is there. Returns its state in words, or why it cannot be
/// kept in the folder.
fn build(store: &Store, spec: &TableSpec, workers: Threads) -> Result<String, String> {
    let Err(reason) = store.open(spec, &workers) else { return Ok("was built already".to_owned()) };
    let bar = Bar::new(spec.name);
    let listener = |spec: &TableSpec, news: crate::tables::News<'_>| print_news(spec, &news);
    let observer = Observer { listener: &listener, progress: &|share| bar.show(share) };
    match store.build(spec, &workers, &reason, observer) {
        Ok(_) => {
            bar.end("built");
            Ok("built".to_owned())
        }
        Err((_, error)) => {
            bar.end("built without a file");
            let folder = store.folder().display();
            Err(format!("cannot be kept in {folder}: {error}: name another folder with --tables"))
        }
    }
}

/// Verifies a table. Returns its state in words, or why it cannot be used. A table that is not
/// built is no error.
fn verify(store: &Store, spec: &TableSpec, workers: Threads) -> Result<String, String> {
    match store.verify(spec, &workers) {
        Ok(counts) => Ok(format!("sound; entries of each value {counts:?}")),
        Err(Unusable::Absent) => Ok("not built".to_owned()),
        Err(reason) => Err(reason.to_string()),
    }
}
