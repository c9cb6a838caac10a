//! `rubik-robot tables`: the solver's tables in the user's cache folder.

use super::output::{Output, refuse};
use super::progress::{Bar, megabytes, tell};
use crate::solver;
use crate::solver::table::TableSpec;
use crate::tables::{Observer, Store, Threads, Unusable};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Where tables are.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
pub(super) struct Folder {
    /// Folder of the tables [default: RUBIK_ROBOT_TABLES, else rubik-robot in the XDG cache folder]
    #[arg(long, value_name = "DIR")]
    tables: Option<PathBuf>,
}

impl Folder {
    pub(super) fn store(&self) -> Store {
        self.tables.clone().map_or_else(Store::of_user, Store::new)
    }
}

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
pub(super) struct TablesArgs {
    /// What to do with them
    action: Action,
    /// Which tables [default: all]
    #[arg(value_name = "NAME")]
    names: Vec<String>,
    #[command(flatten)]
    folder: Folder,
    /// Threads to build and check with [default: all of the machine]
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// One line of JSON for each table
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Action {
    /// Make those that are missing or of no use
    Build,
    /// Say which there are, how large and what for
    List,
    /// Sum every file and count its entries by what they say: distances, or distances modulo 3
    Verify,
    /// Remove their files
    Remove,
}

pub(super) fn run(args: &TablesArgs, output: &mut Output) -> anyhow::Result<u8> {
    let all = solver::all_tables();
    let mut chosen: Vec<&TableSpec> = Vec::new();
    for name in &args.names {
        let Some(spec) = all.iter().find(|spec| spec.name == name) else {
            let names: Vec<&str> = all.iter().map(|spec| spec.name).collect();
            return Err(refuse(format!(
                "there is no table `{name}`; there are {}",
                names.join(", ")
            )));
        };
        chosen.push(spec);
    }
    if chosen.is_empty() {
        chosen = all;
    }
    let store = args.folder.store();
    let workers = args.threads.map_or_else(Threads::all, Threads::new);
    let mut failed = false;
    for spec in chosen {
        let state = match args.action {
            Action::Build => build(&store, spec, workers),
            Action::List => match store.open(spec, &workers) {
                Ok(_) => Ok("there".to_owned()),
                Err(Unusable::Absent) => Ok("not built".to_owned()),
                Err(reason) => Err(reason.to_string()),
            },
            Action::Verify => verify(&store, spec, workers),
            Action::Remove => store
                .remove(spec)
                .map(|was| if was { "removed" } else { "was not there" }.to_owned())
                .map_err(|e| e.to_string()),
        };
        failed |= state.is_err();
        let (ok, state) = match state {
            Ok(state) => (true, state),
            Err(state) => (false, state),
        };
        if args.json {
            let path = store.path(spec);
            output.line(&serde_json::json!({
                "name": spec.name, "bytes": spec.bytes, "ok": ok, "state": state, "purpose": spec.purpose, "path": path,
            }).to_string())?;
        } else {
            let size = megabytes(spec.bytes);
            output.line(&format!("{:16} {size:>10}  {state}; {}", spec.name, spec.purpose))?;
        }
        output.flush()?;
    }
    if !args.json && args.action == Action::List {
        output.line(&format!("in {}", store.folder().display()))?;
    }
    Ok(u8::from(failed))
}

fn build(store: &Store, spec: &TableSpec, workers: Threads) -> Result<String, String> {
    let Err(reason) = store.open(spec, &workers) else { return Ok("there already".to_owned()) };
    let bar = Bar::new(spec.name);
    let listener = |spec: &TableSpec, news: crate::tables::News<'_>| tell(spec, &news);
    let observer = Observer { listener: &listener, progress: &|share| bar.show(share) };
    match store.build(spec, &workers, &reason, observer) {
        Ok(_) => {
            bar.end("built");
            Ok("built".to_owned())
        }
        Err((_, error)) => {
            bar.end("not kept");
            Err(format!("built, but cannot be kept in {}: {error}", store.folder().display()))
        }
    }
}

fn verify(store: &Store, spec: &TableSpec, workers: Threads) -> Result<String, String> {
    match store.verify(spec, &workers) {
        Ok(counts) => Ok(format!("sound; entries of each value {counts:?}")),
        Err(Unusable::Absent) => Ok("not built".to_owned()),
        Err(reason) => Err(reason.to_string()),
    }
}
