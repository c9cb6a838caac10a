//! `rubik-robot replay`: a recording's inputs to the same controller, and whether it does the same again.

use super::output::Output;
use super::{WRONG, complain, record};
use crate::actors::verify::{self, Verified};
use crate::record::reading::{Label, Piece, open};
use crate::scenario::{self, Override, Scenario};
use clap::Args;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  rubik-robot replay run.mcap --verify
On the virtual clock the whole controller runs again on the recorded readings of the port, answers of the sensors and
words of the operator; each order and each drive of each servo period must come out the same, to the bit. Of a run under
the wall clock the servos run again, on the recorded readings and orders: when an actor's order reached its servo
depended on threads, so the orders themselves are inputs there.
Exit code 0 when all is the same, 1 when something differs, 2 when the recording cannot be used.")]
pub(super) struct ReplayArgs {
    /// The recording
    recording: PathBuf,
    /// Compare what the controller does with what it did
    #[arg(long)]
    verify: bool,
    /// Verify the recording of another version, too
    #[arg(long)]
    force: bool,
    /// Say it as one line of JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ReplayArgs, output: &mut Output) -> anyhow::Result<u8> {
    if !args.verify {
        complain("replay without --verify is not there yet");
        return Ok(WRONG);
    }
    let (label, scenario) = match load(&args.recording) {
        Ok(loaded) => loaded,
        Err(why) => {
            complain(&why);
            return Ok(WRONG);
        }
    };
    if let Err(why) = fits(&label, args.force) {
        complain(&why);
        return Ok(WRONG);
    }
    let verified =
        match verify::verify(&args.recording, &scenario, label.fact("attended") == "true") {
            Ok(verified) => verified,
            Err(why) => {
                complain(&format!("{}: {why}", args.recording.display()));
                return Ok(WRONG);
            }
        };
    let same = verified.divergence.is_none();
    if args.json {
        output.line(&json(&verified))?;
    } else {
        output.line(&verified.to_string())?;
    }
    Ok(u8::from(!same))
}

fn json(verified: &Verified) -> String {
    let first = verified.divergence.as_ref().map(|d| {
        serde_json::json!({
            "period": d.period,
            "who": d.who,
            "field": d.what.field,
            "recorded": d.what.recorded,
            "now": d.what.now,
        })
    });
    serde_json::json!({
        "same": verified.divergence.is_none(),
        "compared": verified.compared,
        "not_compared": verified.rest,
        "whole_controller": verified.whole_controller,
        "first_difference": first,
    })
    .to_string()
}

/// A recording's label, and the scenario that it is of.
pub(super) fn load(path: &Path) -> Result<(Label, Scenario), String> {
    let mut label = Label::default();
    let reading = open(path).map_err(|e| format!("{}: {e}", path.display()))?;
    for piece in reading {
        label.take(&piece);
        // All that is needed stands at the beginning.
        if !label.scenario.is_empty() && matches!(piece, Piece::Message(_)) {
            break;
        }
    }
    if label.fact("version").is_empty() || label.scenario.is_empty() {
        let path = path.display();
        return Err(format!(
            "{path}: not a recording of this program, or cut off before its scenario"
        ));
    }
    let options = label.options().into_iter();
    let overrides: Vec<_> =
        options.map(|(option, key, value)| Override { option, key, value }).collect();
    let origin = Path::new(label.fact("scenario"));
    let scenario = scenario::read(origin, &label.scenario, &overrides).map_err(|faults| {
        format!("{}: its scenario is not right here:\n{faults}", path.display())
    })?;
    Ok((label, scenario))
}

/// Whether this program can be held against such a recording.
fn fits(label: &Label, force: bool) -> Result<(), String> {
    let (theirs, ours) = (label.fact("version"), env!("CARGO_PKG_VERSION"));
    if theirs != ours {
        let what = format!("the recording is of version {theirs}, this is {ours}");
        if !force {
            return Err(format!("{what}: another controller need not do the same; --force tries"));
        }
        complain(&what);
    } else if label.fact("build") != record::build() {
        complain(
            "the recording is of another build of this version: a difference may come from that",
        );
    }
    Ok(())
}
