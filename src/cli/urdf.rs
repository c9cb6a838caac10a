//! `rubik-robot urdf`: the cell, or one arm, as URDF.

use super::output::{Output, refuse};
use crate::record::urdf::{Model, xml};
use crate::scenario;
use clap::Args;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot urdf > cell.urdf                    both arms, cameras, table
  rubik-robot urdf --arm track > track.urdf       one arm on its own base
  rubik-robot urdf --scenario my.toml
Links, axes and limits are those that the controller computes with; shapes are boxes and cylinders.")]
pub(super) struct UrdfArgs {
    /// Effector: track or postument in the built-in cell
    #[arg(long)]
    arm: Option<String>,
    /// Take the cell from this scenario instead of the built-in one
    #[arg(long)]
    scenario: Option<PathBuf>,
}

pub(super) fn run(args: &UrdfArgs, output: &mut Output) -> anyhow::Result<u8> {
    let loaded = match &args.scenario {
        Some(path) => scenario::load(path, &[]),
        None => scenario::read(Path::new("built-in"), "", &[]),
    };
    let scenario = loaded.map_err(refuse)?;
    let cell = &scenario.controller.cell;
    let arm = match &args.arm {
        None => None,
        Some(name) => {
            let index = cell.arms.iter().position(|arm| arm.name == *name);
            if index.is_none() {
                let names: Vec<_> = cell.arms.iter().map(|arm| arm.name.as_str()).collect();
                return Err(refuse(format!(
                    "--arm: there is no `{name}`; there are {}",
                    names.join(", ")
                )));
            }
            index
        }
    };
    output.text(&xml(&Model::of(cell, arm, false)))?;
    Ok(0)
}
