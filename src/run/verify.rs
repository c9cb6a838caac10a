//! Verification of a recording: the same inputs to the same controller must give the same outputs,
//! to the bit.
//!
//! | recorded under | runs again | recorded inputs | compared outputs |
//! |---|---|---|---|
//! | virtual time | all actors and servos | readings, sensors, operator | orders, drives, states |
//! | the wall clock | the servos | readings, orders, missed periods, stops | drives, states |
//!
//! Under the wall clock threads decided when an order arrived, so orders are inputs there. A fault
//! that was injected into an actor or the clock is not recorded as an input: under virtual time the
//! periods after it are not judged.
//!
//! - in: a recording and its scenario
//! - out: [`Verified`]: the number of equal servo ticks, and the first difference

use super::failure::not_created;
use super::recording::SCENES;
use super::{RunContext, RunOptions, run_with};
use crate::error::Error;
use crate::hw::driver::ServoRecord;
use crate::record::playback::{Divergence, Playback};
use crate::record::reading::Unreadable;
use crate::record::tick::{Difference, Tick};
use crate::scenario::Scenario;
use crate::scenario::keys::Pace;
use crate::servo::period::Length;
use crate::servo::{ArmServo, ServoConfig};
use std::path::Path;

/// Result of a verification.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Verified {
    /// Number of servo ticks that are equal.
    pub(crate) compared: u64,
    /// Number of ticks of the recording that were not compared. It is at least 1 if the comparison
    /// ended early.
    pub(crate) not_compared: u64,
    /// First difference.
    pub(crate) divergence: Option<Divergence>,
    /// Whether all actors ran again; otherwise the servos only.
    pub(crate) whole_controller: bool,
    /// Reason why the comparison ended before the run did, if it did.
    pub(crate) ended: Option<String>,
    /// Flaw of the file if it is cut off or damaged, with the reason.
    pub(crate) cut: Option<String>,
}

impl std::fmt::Display for Verified {
    /// Writes the result as one line for the user.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let what = if self.whole_controller { "the whole controller" } else { "the servos" };
        match &self.divergence {
            None => write!(f, "the same: {what}, {} servo ticks, to the bit", self.compared)?,
            Some(first) => {
                write!(f, "differs after {} servo ticks of {what}: {first}", self.compared)?;
            }
        }
        if let Some(why) = &self.ended {
            write!(f, "; {why}")?;
        }
        if self.not_compared > 0 && self.divergence.is_none() {
            write!(f, "; {} later servo ticks were not compared", self.not_compared)?;
        }
        match &self.cut {
            Some(how) => write!(f, "; the recording is {how}"),
            None => Ok(()),
        }
    }
}

/// Reason why nothing can be compared.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Unverified {
    /// The recording is unreadable.
    #[error(transparent)]
    Recording(#[from] Unreadable),
    /// The servos cannot be created.
    #[error(transparent)]
    Run(#[from] Error),
    /// The recording holds nothing to compare.
    #[error("nothing was compared: {0}")]
    Nothing(String),
}

/// Verifies a recording of `scenario`: the same inputs must give the same outputs. `attended` is
/// whether an operator could be asked in the recorded run.
///
/// # Errors
/// [`Unverified`] if the recording is unreadable or nothing of it could be compared.
pub(crate) fn verify(
    path: &Path,
    scenario: &Scenario,
    attended: bool,
) -> Result<Verified, Unverified> {
    let arms = scenario.controller.cell.arms.iter().map(|arm| arm.name.clone()).collect();
    let (playback, _) = Playback::open(path, arms)?;
    let mut verified = match scenario.pace {
        Pace::RealTime => servos(&playback, scenario)?,
        Pace::Virtual => controller(&playback, scenario, attended),
    };
    // A flaw of the file is known after its last byte only.
    verified.cut = playback.cut();
    if verified.compared == 0 && verified.divergence.is_none() {
        let whys = [verified.cut.map(|how| format!("the recording is {how}")), verified.ended];
        let why = whys.into_iter().flatten().next();
        let why = why.unwrap_or_else(|| "the recording has no complete servo period".to_owned());
        return Err(Unverified::Nothing(why));
    }
    Ok(verified)
}

/// Runs the whole controller again under virtual time with the recorded inputs, and compares its
/// outputs with the recorded ones.
fn controller(playback: &Playback, scenario: &Scenario, attended: bool) -> Verified {
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };
    let around =
        RunContext { playback: Some((playback.clone(), attended)), ..RunContext::default() };
    let summary = run_with(scenario, options, around);
    // The recording's own port compared each tick while the run went on.
    let (mut divergence, compared) = playback.verdict();
    let (last, not_compared) = (playback.last_period(), playback.rest());
    // A run that ends earlier than the recorded one differs as well.
    if divergence.is_none() && not_compared > 0 {
        let what = Difference {
            field: "end".to_owned(),
            recorded: "the run continues".to_owned(),
            now: "the run ends".to_owned(),
        };
        divergence = Some(Divergence { period: last, who: "mp".to_owned(), what });
    }
    // A difference after an injected fault proves nothing. Begun faults are recorded every `SCENES`
    // periods, so the fault may have begun that much earlier.
    let length = Length::of_seconds(scenario.real_time.period);
    if let (Some(first), Some((noted, what))) = (&divergence, playback.injected())
        && length.tick(first.period) + SCENES >= noted
    {
        let ended = format!(
            "from period {} on the run cannot be compared with its recording: the injected \
             `{what}` is not a recorded input",
            first.period
        );
        let not_compared = not_compared + 1;
        return Verified {
            compared,
            not_compared,
            whole_controller: true,
            ended: Some(ended),
            ..Verified::default()
        };
    }
    let ended = match summary {
        // The end of a cut recording stops the run with an error that `cut` already reports.
        Err(error) if divergence.is_none() && playback.cut().is_none() => Some(error.to_string()),
        _ => None,
    };
    Verified { compared, not_compared, divergence, whole_controller: true, ended, cut: None }
}

/// Runs the servos alone with the recorded readings and orders, and compares their outputs with the
/// recorded ones.
///
/// # Errors
/// If the recording does not fit its scenario, or an order in it is malformed.
fn servos(playback: &Playback, scenario: &Scenario) -> Result<Verified, Error> {
    let config = &scenario.controller;
    let length = Length::of_seconds(scenario.real_time.period);
    let configs = config.cell.arms.iter().zip(&config.effectors).map(|(arm, effector)| {
        ServoConfig { period: length, ..ServoConfig::new(arm, effector.gains.clone()) }
    });
    let mut servos: Vec<(ServoConfig, Option<ArmServo>, u64)> =
        configs.map(|c| (c, None, 0)).collect();
    let mut verified = Verified::default();
    while let Some(recorded) = playback.tick() {
        let index = usize::from(recorded.arm);
        let Some((config, servo, last)) = servos.get_mut(index) else {
            return Err(not_created("servo", "the recording has more arms than its scenario"));
        };
        let who = &scenario.controller.cell.arms[index].name;
        // A servo has memory: after a gap in the recording its state is unknown.
        if recorded.period != *last + 1 {
            let (from, to) = (*last + 1, recorded.period.saturating_sub(1));
            verified.ended = Some(format!(
                "periods {from} to {to} of {who} are not in the recording, and later periods \
                 depend on them"
            ));
            verified.not_compared = 1;
            break;
        }
        *last = recorded.period;
        let outside = recorded.outside().map_err(|text| not_created("servo", &text))?;
        let order = recorded.order().map_err(|text| not_created("servo", &text))?;
        // The run created each servo from a reading before the first period, which is not recorded.
        // The first recorded reading differs from it only in the noise of the force sensor, which
        // has no effect before the first order.
        let servo = servo.get_or_insert_with(|| ArmServo::new(config.clone(), &recorded.reading));
        servo.apply_outside(recorded.period, &outside);
        let (drive, state) = servo.step(recorded.period, &recorded.reading, order.as_ref());
        let record = ServoRecord {
            period: recorded.period,
            arm: recorded.arm,
            reading: recorded.reading,
            outside,
            command: order,
            drive,
            state,
        };
        // Both records are compared in the form of the recording. A checksum in it covers the
        // values that a tick omits.
        let now = Tick::of(&record);
        if let Some(what) = recorded.difference(&now) {
            let divergence = Divergence { period: recorded.period, who: who.clone(), what };
            verified.divergence = Some(divergence);
            break;
        }
        verified.compared += 1;
    }
    verified.not_compared += playback.rest();
    Ok(verified)
}
