//! `rubik-robot urdf`: prints the cell, or one arm, as URDF.
//!
//! - in: a scenario, or the built-in cell
//! - out: URDF on stdout

use super::catalogue;
use super::output::{Output, refuse};
use super::scenarios;
use crate::record::urdf::{Model, xml};
use clap::Args;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot urdf > cell.urdf                       # both arms, cameras, table, objects
  rubik-robot urdf --arm track > track.urdf          # one arm on its base
  rubik-robot urdf --scenario scenarios/table.toml

Links, axes and ranges are those of the controller. Masses, inertias, efforts and speeds are those
of the simulated arms. Shapes are boxes and cylinders. Units are those of URDF: m, kg, rad, s, N.
Exit codes: 0 printed, 2 wrong usage or scenario.")]
pub(super) struct UrdfArgs {
    /// Print only the effector (arm with gripper) with this name; the built-in cell
    /// has track and postument [default: the whole cell]
    #[arg(long, verbatim_doc_comment)]
    arm: Option<String>,
    /// Scenario file (TOML) with the cell [default: the built-in cell]
    #[arg(long, value_name = "FILE", value_parser = scenarios::parser())]
    scenario: Option<PathBuf>,
}

/// Prints the model; returns the exit code.
pub(super) fn run(args: &UrdfArgs, output: &mut Output) -> anyhow::Result<u8> {
    let loaded = match &args.scenario {
        Some(path) => catalogue::load(path, &[]),
        None => catalogue::read(Path::new("built-in"), "", &[]),
    };
    let scenario = loaded.map_err(refuse)?;
    let cell = &scenario.controller.cell;
    let arm = match &args.arm {
        None => None,
        Some(name) => {
            let index = cell.arms.iter().position(|arm| arm.name == *name);
            if index.is_none() {
                let names: Vec<_> = cell.arms.iter().map(|arm| arm.name.as_str()).collect();
                let names = names.join(" and ");
                return Err(refuse(format!(
                    "--arm {name}: the scenario has no such arm; it has {names}"
                )));
            }
            index
        }
    };
    let mut model = Model::of(cell, arm, false);
    if arm.is_none() {
        model = model.with_objects(&scenario.plant.objects);
    }
    output.text(&xml(&model))?;
    Ok(0)
}
