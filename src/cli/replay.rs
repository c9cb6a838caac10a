//! `rubik-robot replay`: shows a recording, or verifies that the controller repeats it.
//!
//! - in: a recording
//! - out: the run in the page, in the terminal or as lines; with `--verify` the result of the
//!   comparison, as a line of text or of JSON
//! - exit code: see the help below

use super::catalogue;
use super::output::{Output, inform, refuse, warn};
use super::ui::{Ui, UiArgs, UiKind};
use crate::actors::control::is_speed;
use crate::desk::Desk;
use crate::hw::text;
use crate::record::reading::{Label, Piece, Reading};
use crate::run::show::Show;
use crate::run::signalled;
use crate::run::verify::{self, Verified};
use crate::scenario::maker::Maker;
use crate::scenario::{Override, Scenario};
use clap::Args;
use std::io::BufReader;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot replay run.mcap             # in the page, with pause, speed and seek
  rubik-robot replay run.mcap --ui tui    # in the terminal
  rubik-robot replay run.mcap --speed 10
  rubik-robot replay run.mcap --verify

--verify runs the whole controller again on the recorded inputs: readings of the hardware (encoders,
currents, switches), answers of the virtual sensors, inputs of the operator. Each motion command and
each command to a drive must be equal, to the bit. After a run on the wall clock only the servos run
again, with the recorded commands, missed periods and stops as inputs: the time at which a command
reached its servo depended on threads. The command reports if a part could not be compared: a
recording that is cut off, damaged or has gaps, or an injected fault of an actor or of the clock.
Without --verify and without a UI the phases and messages are printed to stderr at once, with their
simulated times (s).

Keys of the object of --json:
  same               whether all that was compared is equal
  compared           number of equal servo ticks (one of one arm in a period of 2 ms)
  not_compared       number of other ticks; at least 1 if the comparison ended early
  whole_controller   whether all actors ran again; otherwise the servos only
  first_difference   period, who (the actor), field, recorded, now; or null
  ended              reason why the comparison ended before the run, or null
  cut                why the file is cut off or damaged, or null
Exit codes: 0 everything that was compared is equal, or the recording was shown; 1 a value differs;
2 wrong usage, the recording cannot be used (for example that of a resumed run) or nothing was
compared; 4 system error.")]
pub(super) struct ReplayArgs {
    /// Recording of `run --record` (MCAP)
    recording: PathBuf,
    /// Run the controller again and compare it with the recording
    #[arg(long)]
    verify: bool,
    /// Verify a recording of another version of the program as well
    #[arg(long)]
    force: bool,
    /// Print the result of --verify as one line of JSON
    #[arg(long)]
    json: bool,
    /// Speed of the replay as a multiple of real time, 0.01 or more;
    /// 0: no limit
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, verbatim_doc_comment)]
    speed: f64,
    #[command(flatten)]
    ui: UiArgs,
}

/// Shows or verifies a recording; returns the exit code.
pub(super) fn run(args: &ReplayArgs, output: &mut Output) -> anyhow::Result<u8> {
    args.ui.check().map_err(refuse)?;
    let (label, scenario) = load(&args.recording).map_err(refuse)?;
    if !args.verify {
        return show(args, &scenario);
    }
    // A resumed run began from the files of --journal and --world, which have changed since.
    if label.fact("resumed") == "true" {
        return Err(refuse(format!(
            "{}: a resumed run cannot be verified: its start is in the files of --journal and \
             --world, not in the recording",
            args.recording.display()
        )));
    }
    fits(&label, args.force).map_err(refuse)?;
    let attended = label.fact("attended") == "true";
    let verified = verify::verify(&args.recording, &scenario, attended)
        .map_err(|why| refuse(format!("{}: {why}", args.recording.display())))?;
    // A part that could not be compared is reported, but it is no difference.
    let same = verified.divergence.is_none();
    if args.json {
        output.line(&json(&verified))?;
    } else {
        output.line(&verified.to_string())?;
    }
    Ok(u8::from(!same))
}

/// Shows a recording in a UI; without one, prints its phases and messages at once. Returns the exit
/// code.
fn show(args: &ReplayArgs, scenario: &Scenario) -> anyhow::Result<u8> {
    if !is_speed(args.speed) {
        return Err(refuse(
            "--speed: must be a factor of 0.01 or more, or 0 for as fast as possible",
        ));
    }
    let show = read(&args.recording, scenario).map_err(refuse)?;
    let desk = Desk::default();
    let ui = match args.ui.kind(args.json) {
        UiKind::None => Ui::None,
        kind => args.ui.open(kind, desk.ui_end()).map_err(|error| refuse(format!("{error:#}")))?,
    };
    // Without a UI all messages are printed at once, as a log of the run.
    if matches!(ui, Ui::None) {
        for (time, words) in show.log_lines() {
            inform(&format!("{time:9.2} s  {words}"));
        }
        inform(&show.ending());
        return Ok(0);
    }
    let stop = signalled()?;
    show.run(&desk.run_end(), args.speed, true, &stop);
    // A key, the page or a signal has ended the replay, so the UI does not stay.
    ui.leave()?;
    Ok(0)
}

/// Returns the result of a verification as a line of JSON.
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
        "not_compared": verified.not_compared,
        "whole_controller": verified.whole_controller,
        "first_difference": first,
        "ended": verified.ended,
        "cut": verified.cut,
    })
    .to_string()
}

/// Reads a recording of this scenario to be shown.
///
/// # Errors
/// The reason, with the recording's name.
pub(super) fn read(path: &Path, scenario: &Scenario) -> Result<Show, String> {
    let title = path.display().to_string();
    let file = text::open_any(path).map_err(|why| why.to_string())?;
    let file = BufReader::with_capacity(1 << 20, file);
    Show::read(file, scenario, &title).map_err(|why| format!("{title}: {why}"))
}

/// Reads the label of a recording (version, options and other facts), and its scenario.
pub(super) fn load(path: &Path) -> Result<(Label, Scenario), String> {
    let mut label = Label::default();
    let reading = Reading::seekable(text::open_any(path).map_err(|why| why.to_string())?);
    // The label is spread over the first pieces of the file.
    for piece in reading {
        label.take(&piece);
        // The label is complete before the first message: the rest need not be read.
        if !label.scenario.is_empty() && matches!(piece, Piece::Message(_)) {
            break;
        }
    }
    let scenario = scenario_of(&label, path)?;
    Ok((label, scenario))
}

/// Returns the scenario of the recording at `path`, from its label; otherwise the reason why it has
/// none that is valid in this version.
pub(super) fn scenario_of(label: &Label, path: &Path) -> Result<Scenario, String> {
    if label.fact("version").is_empty() || label.scenario.is_empty() {
        let path = path.display();
        return Err(format!(
            "{path}: not a recording of rubik-robot, or cut off before its scenario"
        ));
    }
    let maker = maker_of(label);
    catalogue::program()
        .accepts(maker.as_ref(), label.fact("task"))
        .map_err(|why| format!("{}: {why}", path.display()))?;
    let options = label.options().into_iter();
    let overrides: Vec<_> =
        options.map(|(option, key, value)| Override { option, key, value }).collect();
    // The files that a scenario names are found from its original path.
    let origin = Path::new(label.fact("scenario"));
    catalogue::read_recorded(origin, &label.scenario, &overrides).map_err(|faults| {
        format!("{}: its scenario is not valid in this version:\n{faults}", path.display())
    })
}

/// Returns the program that has made a recording; `None` for an old one, which does not name it.
fn maker_of(label: &Label) -> Option<Maker> {
    let fact = |name: &str| label.fact(name).to_owned();
    let tasks = label.fact("tasks").split_whitespace().map(str::to_owned).collect();
    (!label.fact("program").is_empty()).then(|| Maker {
        program: fact("program"),
        version: fact("program_version"),
        tasks,
    })
}

/// Checks that the recording is of this version, unless `force`. Warns of another build.
fn fits(label: &Label, force: bool) -> Result<(), String> {
    let (theirs, ours) = (label.fact("version"), env!("CARGO_PKG_VERSION"));
    let (own, maker) = (catalogue::program(), maker_of(label));
    // A program of a user's own has a version beside that of this crate.
    let (theirs, ours) = match &maker {
        Some(maker) if theirs == ours => (maker.version.as_str(), own.version.as_str()),
        _ => (theirs, ours),
    };
    // Another version may differ on purpose, another build of one version only by accident.
    if theirs != ours {
        let what = format!("the recording is of version {theirs}, this is {ours}");
        if !force {
            return Err(format!("{what}: the controllers may differ; --force verifies it anyway"));
        }
        warn(&what);
    } else if label.fact("build") != crate::record::build() {
        warn("the recording is of another build of this version, which may cause differences");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the reason why a recording with these facts is refused; empty if it is read.
    fn refusal(facts: &[(&str, &str)]) -> String {
        let facts = facts.iter().map(|(name, fact)| ((*name).to_owned(), (*fact).to_owned()));
        let metadata = [("rubik_robot".to_owned(), facts.collect())].into();
        let label = Label { metadata, scenario: "task = \"idle\"\n".to_owned() };
        scenario_of(&label, Path::new("run.mcap")).err().unwrap_or_default()
    }

    /// A recording of an older version names no program, and is read if its task is known.
    #[test]
    fn recording_of_other_program_is_refused() {
        let own = [("version", "0.1.0"), ("task", "idle"), ("program", "rubik-robot")];
        let other = [("version", "0.1.0"), ("program", "own_cell"), ("program_version", "0.3.0")];

        assert_eq!(refusal(&own), "");
        assert_eq!(refusal(&own[..2]), "");
        assert_eq!(
            refusal(&[&other[..], &[("task", "wave")]].concat()),
            "run.mcap: recorded by own_cell 0.3.0 with task `wave`, which this program does not \
             have"
        );
        let known = refusal(&[&other[..], &[("task", "idle")]].concat());
        assert!(known.contains("by own_cell 0.3.0, which is another program"), "{known}");
    }
}
