//! Verification of a recording: the same inputs to the same controller must give the same outputs, to the bit.
//!
//! - virtual clock: MP, ECPs, EDPs, VSPs and servos run again; inputs are the port's readings, the sensors' answers and
//!   the operator's words, outputs are orders, drives and states of each servo period
//! - wall clock: the servos run again; the orders are inputs, since threads decided when they came

use super::supervisor::{Around, RunOptions, not_created, run_with};
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
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verified {
    /// Servo ticks that are the same.
    pub compared: u64,
    /// Ticks of the recording that the run did not come to.
    pub rest: u64,
    /// Where they part.
    pub divergence: Option<Divergence>,
    /// All actors ran again, or the servos only.
    pub whole_controller: bool,
    /// Why the comparison ended before the recording, if it did.
    pub ended: Option<String>,
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
        match &self.ended {
            Some(why) => write!(f, "; {why}"),
            None => Ok(()),
        }
    }
}

/// Why nothing can be compared.
#[derive(Debug, thiserror::Error)]
pub enum Unverified {
    /// The recording.
    #[error(transparent)]
    Recording(#[from] Unreadable),
    /// The run.
    #[error(transparent)]
    Run(#[from] Error),
}

/// Verifies a recording of `scenario`; `attended`: an operator was there.
///
/// # Errors
/// [`Unverified`].
pub fn verify(path: &Path, scenario: &Scenario, attended: bool) -> Result<Verified, Unverified> {
    let arms = scenario.controller.cell.arms.iter().map(|arm| arm.name.clone()).collect();
    let (playback, _) = Playback::open(path, arms)?;
    if scenario.pace == Pace::RealTime {
        return Ok(servos(&playback, scenario)?);
    }
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };
    let around = Around { playback: Some((playback.clone(), attended)), ..Around::default() };
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
    let cut = playback.is_cut() && divergence.is_none();
    let ended = match summary {
        _ if cut => Some("the recording is cut off there".to_owned()),
        Err(error) if divergence.is_none() => Some(error.to_string()),
        _ => None,
    };
    Ok(Verified { compared, rest, divergence, whole_controller: true, ended })
}

/// The servos alone, fed with recorded readings and orders.
fn servos(playback: &Playback, scenario: &Scenario) -> Result<Verified, Error> {
    let config = &scenario.controller;
    let length = Length::of_seconds(scenario.real_time.period);
    let configs = config.cell.arms.iter().zip(&config.effectors).map(|(arm, effector)| {
        ServoConfig { period: length, ..ServoConfig::new(arm, effector.gains.clone()) }
    });
    let mut servos: Vec<(ServoConfig, Option<ArmServo>)> = configs.map(|c| (c, None)).collect();
    let mut verified =
        Verified { compared: 0, rest: 0, divergence: None, whole_controller: false, ended: None };
    while let Some(recorded) = playback.tick() {
        let index = usize::from(recorded.arm);
        let Some((config, servo)) = servos.get_mut(index) else {
            return Err(not_created("servo", "the recording has more arms than its scenario"));
        };
        let order = recorded.order().map_err(|text| not_created("servo", &text))?;
        // The servo is created from readings that were taken before the first period; they are the same, but for the
        // force sensor's noise, which counts for nothing before the first order.
        let servo = servo.get_or_insert_with(|| ArmServo::new(config.clone(), &recorded.reading));
        let (drive, state) = servo.step(recorded.period, &recorded.reading, order.as_ref());
        let record = ServoRecord {
            period: recorded.period,
            arm: recorded.arm,
            reading: recorded.reading,
            command: order,
            drive,
            state,
        };
        let now = Tick::of(&record);
        if let Some(what) = recorded.difference(&now) {
            if now.fault.is_empty() && !recorded.fault.is_empty() {
                verified.ended = Some(format!(
                    "from period {} on the arms were stopped from outside ({})",
                    recorded.period, recorded.fault
                ));
            } else {
                let who = scenario.controller.cell.arms[index].name.clone();
                verified.divergence = Some(Divergence { period: recorded.period, who, what });
            }
            break;
        }
        verified.compared += 1;
    }
    verified.rest = playback.rest();
    Ok(verified)
}
