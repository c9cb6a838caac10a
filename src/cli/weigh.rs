//! `rubik-robot weigh`: measures the weight of a tool, its centre of mass and the bias of the force
//! sensor, in several orientations of the wrist.
//!
//! - in: a scenario, an arm whose hand is empty
//! - out: weight, centre of mass, bias and residuals; the keys to set in the scenario

use super::arguments::{ScenarioArgs, check_devices};
use super::output::{Output, complain, inform, refuse};
use crate::error::Error;
use crate::run::weigh::weigh_tool;
use crate::servo::weigh::Weighed;
use clap::Args;

#[derive(Debug, Args)]
#[command(after_help = "\
The tool is all that the force sensor in the wrist carries: the gripper, which must be empty and
free of contact. The arm turns its wrist by up to 150 deg where it is, and reads the sensor in
several orientations. Progress goes to stderr, the result to stdout; its last lines are keys to
paste into the scenario, below the [[effector]] of this name.

Examples:
  rubik-robot weigh scenarios/idle.toml --arm postument  # in the simulated cell
  rubik-robot weigh scenarios/hardware.toml --arm track  # on hardware, or on `rubik-robot emulate`

Keys of the object of --json:
  arm, orientations (their number)
  weight_n           weight of the tool (N)
  centre_xyz_mm      its centre of mass in the frame of the flange (mm)
  bias               reading of the sensor without a load: three forces (N), three torques (Nm)
  residual_n, residual_nm                    r.m.s. residual of the components of the force (N)
                                             and of the torque (Nm)
  largest_residual_n, largest_residual_nm    largest residual (N, Nm)
Exit codes: 0 measured, 1 the readings do not determine the weight, 2 wrong usage or scenario, 3 an
effector failed, 4 system error.")]
pub(super) struct WeighArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Name of an effector (arm with gripper) of the scenario
    #[arg(long)]
    arm: String,
    /// Print one line of JSON
    #[arg(long)]
    json: bool,
}

/// Measures the tool and prints the result; returns the exit code.
pub(super) fn run(args: &WeighArgs, output: &mut Output) -> anyhow::Result<u8> {
    let scenario = args.scenario.load(&[]).map_err(refuse)?;
    let arms = &scenario.controller.cell.arms;
    let Some(arm) = arms.iter().position(|a| a.name == args.arm) else {
        let names: Vec<&str> = arms.iter().map(|a| a.name.as_str()).collect();
        let names = names.join(" and ");
        return Err(refuse(format!(
            "--arm {}: the scenario has no such arm; it has {names}",
            args.arm
        )));
    };
    check_devices(&scenario)?;
    let progress =
        |index: usize, count: usize| inform(&format!("orientation {} of {count}", index + 1));
    match weigh_tool(&scenario, arm, progress) {
        Ok((weighed, orientations)) => {
            if args.json {
                output.line(&json(&args.arm, &weighed, orientations).to_string())?;
            } else {
                output.text(&table(&args.arm, &weighed, orientations))?;
            }
            Ok(0)
        }
        Err(error) => {
            complain(&error.to_string());
            // A refused measurement is a failure of the task; the other codes are those of a run.
            Ok(match error {
                Error::NonFatal { .. } => 1,
                Error::Fatal { .. } => 3,
                Error::System { .. } => 4,
            })
        }
    }
}

/// Returns the result as JSON.
fn json(arm: &str, w: &Weighed, orientations: usize) -> serde_json::Value {
    serde_json::json!({
        "arm": arm,
        "orientations": orientations,
        "weight_n": w.weight,
        "centre_xyz_mm": w.centre_in_flange.coords.map(|c| c * 1e3).as_slice(),
        "bias": w.bias.directions(),
        "residual_n": w.residual.0,
        "residual_nm": w.residual.1,
        "largest_residual_n": w.largest_residual.0,
        "largest_residual_nm": w.largest_residual.1,
    })
}

/// Returns the result as a table, followed by the keys to set in the scenario.
fn table(arm: &str, w: &Weighed, orientations: usize) -> String {
    let c = w.centre_in_flange.coords * 1e3;
    let b = w.bias.directions();
    format!(
        "weight                 {:.3} N\n\
         centre in the flange   {:.1} {:.1} {:.1} mm\n\
         bias of the sensor     {:.2} {:.2} {:.2} N, {:.3} {:.3} {:.3} Nm\n\
         residual               {:.3} N, {:.4} Nm r.m.s.; {:.3} N, {:.4} Nm at most, over \
         {orientations} orientations\n\n\
         For the scenario, under [[effector]] name = \"{arm}\":\n\
         sensor.weight_n = {:.2}\n\
         sensor.centre_xyz_mm = [{:.1}, {:.1}, {:.1}]\n",
        w.weight,
        c.x,
        c.y,
        c.z,
        b[0],
        b[1],
        b[2],
        b[3],
        b[4],
        b[5],
        w.residual.0,
        w.residual.1,
        w.largest_residual.0,
        w.largest_residual.1,
        w.weight,
        c.x,
        c.y,
        c.z,
    )
}
