//! Verification of a recording: the same inputs to the same controller must give the same outputs, to the bit.
//!
//! - virtual clock: MP, ECPs, EDPs, VSPs and servos run again; inputs are the port's readings, the sensors' answers and
//!   the operator's words, outputs are orders, drives and states of each servo period; a fault that was injected into an
//!   actor or the clock is no such input, so that what comes after it is not judged
//! - wall clock: the servos run again; the orders, and what came from outside (missed periods, stops), are inputs, since
//!   threads decided when they came

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

/// What came of a verification.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Verified {
    /// Servo ticks that are the same.
    pub(crate) compared: u64,
    /// Ticks of the recording that the run did not come to.
    pub(crate) rest: u64,
    /// Where they part.
    pub(crate) divergence: Option<Divergence>,
    /// All actors ran again, or the servos only.
    pub(crate) whole_controller: bool,
    /// Why the comparison ended before the run did, if so.
    pub(crate) ended: Option<String>,
    /// How the recording itself ends before the run did, and why, if so.
    pub(crate) cut: Option<String>,
}

impl std::fmt::Display for Verified {
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
        if self.rest > 0 && self.divergence.is_none() {
            write!(f, "; {} ticks behind that were not compared", self.rest)?;
        }
        match &self.cut {
            Some(how) => write!(f, "; the recording is {how}"),
            None => Ok(()),
        }
    }
}

/// Why nothing can be compared.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Unverified {
    /// The recording.
    #[error(transparent)]
    Recording(#[from] Unreadable),
    /// The run.
    #[error(transparent)]
    Run(#[from] Error),
    /// There is nothing in it to be compared.
    #[error("nothing was compared: {0}")]
    Nothing(String),
}

/// Verifies a recording of `scenario`; `attended`: an operator was there.
///
/// # Errors
/// [`Unverified`].
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
    // Known only now that it was read to its end.
    verified.cut = playback.cut();
    if verified.compared == 0 && verified.divergence.is_none() {
        let whys = [verified.cut.map(|how| format!("the recording is {how}")), verified.ended];
        let why = whys.into_iter().flatten().next();
        let why = why.unwrap_or_else(|| "the recording holds no whole servo period".to_owned());
        return Err(Unverified::Nothing(why));
    }
    Ok(verified)
}

/// The whole controller, on the virtual clock.
fn controller(playback: &Playback, scenario: &Scenario, attended: bool) -> Verified {
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };
    let around =
        RunContext { playback: Some((playback.clone(), attended)), ..RunContext::default() };
    let summary = run_with(scenario, options, around);
    let (mut divergence, compared) = playback.verdict();
    let (last, rest) = (playback.last_period(), playback.rest());
    if divergence.is_none() && rest > 0 {
        let what = Difference {
            field: "end".to_owned(),
            recorded: "the run goes on".to_owned(),
            now: "the run ends".to_owned(),
        };
        divergence = Some(Divergence { period: last, who: "mp".to_owned(), what });
    }
    let length = Length::of_seconds(scenario.real_time.period);
    if let (Some(first), Some((noted, what))) = (&divergence, playback.injected())
        && length.tick(first.period) + SCENES >= noted
    {
        let ended = format!(
            "from period {} on it cannot be held against its recording: `{what}`, which was injected, is no recorded input",
            first.period
        );
        let rest = rest + 1;
        return Verified {
            compared,
            rest,
            whole_controller: true,
            ended: Some(ended),
            ..Verified::default()
        };
    }
    let ended = match summary {
        // Where the recording is cut off there is nothing to be read, which is no news.
        Err(error) if divergence.is_none() && playback.cut().is_none() => Some(error.to_string()),
        _ => None,
    };
    Verified { compared, rest, divergence, whole_controller: true, ended, cut: None }
}

/// The servos alone, fed with recorded readings and orders.
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
        if recorded.period != *last + 1 {
            let (from, to) = (*last + 1, recorded.period.saturating_sub(1));
            verified.ended = Some(format!(
                "periods {from} to {to} of {who} are not in the recording, and what comes after them depends on them"
            ));
            verified.rest = 1;
            break;
        }
        *last = recorded.period;
        let outside = recorded.outside().map_err(|text| not_created("servo", &text))?;
        let order = recorded.order().map_err(|text| not_created("servo", &text))?;
        // The servo is created from readings that were taken before the first period; they are the same, but for the
        // force sensor's noise, which counts for nothing before the first order.
        let servo = servo.get_or_insert_with(|| ArmServo::new(config.clone(), &recorded.reading));
        servo.heed(recorded.period, &outside);
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
        let now = Tick::of(&record);
        if let Some(what) = recorded.difference(&now) {
            let divergence = Divergence { period: recorded.period, who: who.clone(), what };
            verified.divergence = Some(divergence);
            break;
        }
        verified.compared += 1;
    }
    verified.rest += playback.rest();
    Ok(verified)
}
