//! `rubik-robot replay`: a recording shown again; or its inputs to the same controller, and whether it does the same.

use super::output::{Output, complain, refuse};
use super::record;
use super::ui::{Ui, UiArgs, UiKind};
use crate::actors::control::is_speed;
use crate::desk::Desk;
use crate::record::reading::{Label, Piece, open};
use crate::run::SIGNALS;
use crate::run::show::Show;
use crate::run::verify::{self, Verified};
use crate::scenario::{self, Override, Scenario};
use clap::Args;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot replay run.mcap                  in the page, or --ui tui; pause, speed and seek are there
  rubik-robot replay run.mcap --speed 10
  rubik-robot replay run.mcap --verify
--verify: on the virtual clock the whole controller runs again on the recorded readings of the port, answers of the sensors and
words of the operator; each order and each drive of each servo period must come out the same, to the bit. Of a run under
the wall clock the servos run again, on the recorded readings, orders, missed periods and stops: when an actor's order
reached its servo depended on threads, so the orders themselves are inputs there.
Exit code 0 when all that was compared is the same, and it says when that is not all (a recording that is cut off, is
damaged or has gaps, or a fault of an actor or of the clock that was injected), 1 when something differs, 2 when the recording cannot be
used (that of a resumed run cannot) or nothing was compared.")]
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
    /// How fast it is shown, in times of real time
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    speed: f64,
    #[command(flatten)]
    ui: UiArgs,
}

pub(super) fn run(args: &ReplayArgs, output: &mut Output) -> anyhow::Result<u8> {
    let (label, scenario) = load(&args.recording).map_err(refuse)?;
    if !args.verify {
        return show(args, &scenario);
    }
    if label.fact("resumed") == "true" {
        return Err(refuse(format!(
            "{}: a resumed run cannot be verified: where it began stands in its journal and world, not in the recording",
            args.recording.display()
        )));
    }
    fits(&label, args.force).map_err(refuse)?;
    let attended = label.fact("attended") == "true";
    let verified = verify::verify(&args.recording, &scenario, attended)
        .map_err(|why| refuse(format!("{}: {why}", args.recording.display())))?;
    let same = verified.divergence.is_none();
    if args.json {
        output.line(&json(&verified))?;
    } else {
        output.line(&verified.to_string())?;
    }
    Ok(u8::from(!same))
}

/// Shows a recording in a UI; without one, prints its phases and messages at once.
fn show(args: &ReplayArgs, scenario: &Scenario) -> anyhow::Result<u8> {
    if !is_speed(args.speed) {
        return Err(refuse(
            "--speed: a factor of 0.01 or more such as 5, or 0 for as fast as it goes",
        ));
    }
    let file = BufReader::with_capacity(1 << 20, File::open(&args.recording)?);
    let title = args.recording.display().to_string();
    let show =
        Show::read(file, scenario, &title).map_err(|why| refuse(format!("{title}: {why}")))?;
    let desk = Desk::default();
    let ui = match args.ui.kind(args.json) {
        UiKind::None => Ui::None,
        kind => args.ui.open(kind, desk.ui_end()).map_err(|error| refuse(format!("{error:#}")))?,
    };
    if matches!(ui, Ui::None) {
        for (time, words) in show.told() {
            complain(&format!("{time:9.2} s  {words}"));
        }
        complain(&show.ending());
        return Ok(0);
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in SIGNALS {
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    show.run(&desk.run_end(), args.speed, true, &stop);
    // Whoever ended the show, by a key, on the page or by a signal, is done with it.
    ui.leave()?;
    Ok(0)
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
        "ended": verified.ended,
        "cut": verified.cut,
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
    let scenario = scenario_of(&label, path)?;
    Ok((label, scenario))
}

/// The scenario that a recording with this label is of.
pub(super) fn scenario_of(label: &Label, path: &Path) -> Result<Scenario, String> {
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
    scenario::read(origin, &label.scenario, &overrides)
        .map_err(|faults| format!("{}: its scenario is not right here:\n{faults}", path.display()))
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
