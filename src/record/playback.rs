//! A recording as the controller's world: its readings come out of the port again, its sensors
//! deliver again, its operator commands again; and what the controller makes of them is held
//! against what was recorded.
//!
//! - in: a recording
//! - out: a [`Port`], the sensors' answers, and the first [`Divergence`]

use super::reading::{End, Label, Message, Piece, Reading, Unreadable, open};
use super::sensed::{Found, Sensed};
use super::tick::{Difference, Tick};
use crate::hw::driver::{RecordSink, ServoRecord};
use crate::hw::port::{HeldUp, Port, PortFault};
use crate::motion::PERIOD;
use crate::servo::io::{ArmDrive, ArmReading};
use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// Where a run parts from its recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Divergence {
    /// Servo period.
    pub period: u64,
    /// Name of the effector or of the sensor.
    pub who: String,
    /// What differs.
    pub what: Difference,
}

impl std::fmt::Display for Divergence {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Difference { field, recorded, now } = &self.what;
        write!(f, "period {}, {}, {field}: recorded {recorded}, now {now}", self.period, self.who)
    }
}

/// What a recording has for a look.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Played {
    /// What the sensor delivered.
    Answer(Result<Found, String>),
    /// The recording holds no further look of this sensor.
    Nothing,
}

/// A recording being played back; clones play the same one.
#[derive(Clone)]
pub struct Playback(Arc<Mutex<State>>);

struct State {
    arms: Vec<String>,
    stream: Reading<std::io::BufReader<std::fs::File>>,
    /// Ticks that were read and not compared yet.
    ahead: VecDeque<Tick>,
    sensed: Vec<Sensed>,
    operator: VecDeque<(u64, String)>,
    /// The first injected fault that its inputs do not hold: period of 2 ms, and what.
    injected: Option<(u64, String)>,
    compared: u64,
    last: u64,
    divergence: Option<Divergence>,
    /// The port has given the last readings.
    over: bool,
}

impl Playback {
    /// Opens a recording. Its sensors and its operator are read at once, its ticks as they come.
    ///
    /// # Errors
    /// [`Unreadable`].
    pub fn open(path: &Path, arms: Vec<String>) -> Result<(Self, Label), Unreadable> {
        let mut label = Label::default();
        let (mut sensed, mut operator, mut injected) = (Vec::new(), VecDeque::new(), None);
        for piece in open(path)? {
            label.take(&piece);
            let Piece::Message(Message { channel, data, .. }) = piece else { continue };
            let broken = |why| Unreadable::Message { topic: channel.topic.clone(), why };
            match channel.topic.as_str() {
                "/sensed" => sensed.push(Sensed::read(&data).map_err(broken)?),
                "/operator" => operator.push_back(operator_word(&data).map_err(broken)?),
                "/rosout" if injected.is_none() => {
                    injected = not_an_input(&data).map_err(broken)?;
                }
                _ => {}
            }
        }
        let file = std::fs::File::open(path)?;
        let state = State {
            arms,
            stream: Reading::new(std::io::BufReader::with_capacity(1 << 20, file)),
            ahead: VecDeque::new(),
            sensed,
            operator,
            injected,
            compared: 0,
            last: 0,
            divergence: None,
            over: false,
        };
        Ok((Self(Arc::new(Mutex::new(state))), label))
    }

    /// What a sensor delivered when it was asked to look at `period`, and how it was asked.
    #[must_use]
    pub(crate) fn sensed(&self, sensor: &str, period: u64, asked: &str) -> Played {
        let state = &mut *self.state();
        let Some(at) = state.sensed.iter().position(|s| s.sensor == sensor) else {
            return Played::Nothing;
        };
        let answer = state.sensed.remove(at);
        if answer.period != period || answer.asked != asked {
            let recorded = format!("period {}, {}", answer.period, answer.asked);
            state.part(period, sensor, look(recorded, period, asked));
        }
        Played::Answer(answer.found)
    }

    /// A look that the recording does not hold has come to be delivered. Whoever only begins one as
    /// the run ends sees nothing any more.
    pub(crate) fn unheard(&self, sensor: &str, period: u64, asked: &str) {
        self.state().part(period, sensor, look("nothing".to_owned(), period, asked));
    }

    /// What the operator wanted until this period of 2 ms, one by one.
    #[must_use]
    pub fn operator(&self, period: u64) -> Option<String> {
        let mut state = self.state();
        if state.operator.front().is_some_and(|(at, _)| *at <= period) {
            return state.operator.pop_front().map(|(_, command)| command);
        }
        None
    }

    /// The first difference, if there is one, and how many ticks were compared.
    #[must_use]
    pub fn verdict(&self) -> (Option<Divergence>, u64) {
        let state = self.state();
        (state.divergence.clone(), state.compared)
    }

    /// The first injected fault that befalls an actor or the clock, none of which the inputs hold:
    /// the period of 2 ms in which it was noted, and what it is.
    #[must_use]
    pub fn injected(&self) -> Option<(u64, String)> {
        self.state().injected.clone()
    }

    /// Ticks that the recording holds beyond what the run came to.
    #[must_use]
    pub fn rest(&self) -> u64 {
        let mut state = self.state();
        let mut rest = state.ahead.len() as u64;
        state.ahead.clear();
        while state.next_tick().is_some() {
            rest += 1;
        }
        rest
    }

    /// The last period that was compared.
    #[must_use]
    pub fn last_period(&self) -> u64 {
        self.state().last
    }

    /// How the recording ends in the middle, and why, if it does; known at its end.
    #[must_use]
    pub fn cut(&self) -> Option<String> {
        let state = self.state();
        let flaw = state.stream.end().and_then(End::flaw)?;
        Some(format!("{flaw:#}"))
    }

    /// The next tick, to be fed elsewhere.
    #[must_use]
    pub fn tick(&self) -> Option<Tick> {
        let mut state = self.state();
        state.ahead.pop_front().or_else(|| state.next_tick())
    }

    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn operator_word(data: &[u8]) -> Result<(u64, String), super::cdr::Malformed> {
    let mut from = super::cdr::Reader::new(data)?;
    from.time()?;
    Ok((from.u64()?, from.string()?.to_owned()))
}

/// Kinds of faults that reach a run past its port, its sensors and its operator.
const PAST_INPUTS: [&str; 5] =
    ["actor panic", "actor hang", "heart beat loss", "late message", "clock jump"];

/// An injected fault of one of these kinds, and when, of a line of the log.
fn not_an_input(data: &[u8]) -> Result<Option<(u64, String)>, super::cdr::Malformed> {
    let mut from = super::cdr::Reader::new(data)?;
    let time = from.time()?;
    from.u8()?;
    let (who, text) = (from.string()?, from.string()?);
    let what = text.strip_prefix("injected fault: ").filter(|_| who == "plant");
    let what = what.filter(|what| PAST_INPUTS.iter().any(|kind| what.starts_with(kind)));
    Ok(what.map(|what| ((time as f64 * 1e-9 / PERIOD).round() as u64, what.to_owned())))
}

/// Returns the difference of a look: the recorded one, and the one that was asked for now.
fn look(recorded: String, period: u64, asked: &str) -> Difference {
    Difference { field: "look".to_owned(), recorded, now: format!("period {period}, {asked}") }
}

impl State {
    fn next_tick(&mut self) -> Option<Tick> {
        self.stream.by_ref().find_map(|piece| match piece {
            Piece::Message(message) if message.channel.topic.ends_with("/servo") => {
                Tick::read(&message.data).ok()
            }
            _ => None,
        })
    }

    /// Keeps the first difference of the run.
    fn part(&mut self, period: u64, who: &str, what: Difference) {
        self.divergence.get_or_insert_with(|| Divergence { period, who: who.to_owned(), what });
    }
}

impl Port for Playback {
    fn exchange(
        &mut self,
        period: u64,
        _: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        let state = &mut *self.state();
        let ends = |reason: &str| PortFault { effector: 0, reason: reason.to_owned() };
        if state.divergence.is_some() {
            return Err(ends("it differs from its recording"));
        }
        if state.over {
            return Err(ends("the recording ends here"));
        }
        // What is read at the end of a period is what the next one begins with.
        while state.ahead.len() < readings.len() {
            let Some(tick) = state.next_tick() else {
                // The run's last readings are used by no period; of a file that is cut off, a part
                // of the arms.
                state.ahead.clear();
                state.over = true;
                return Ok(());
            };
            state.ahead.push_back(tick);
        }
        for (index, (reading, tick)) in readings.iter_mut().zip(&state.ahead).enumerate() {
            if tick.period != period + 1 || usize::from(tick.arm) != index {
                return Err(ends(&format!("period {} is not in the recording", period + 1)));
            }
            *reading = tick.reading;
        }
        Ok(())
    }

    /// What the servo missed before the next period, it misses again.
    fn held_up(&mut self) -> HeldUp {
        let state = self.state();
        let next = state.ahead.front().and_then(|tick| tick.outside().ok());
        HeldUp { periods: next.map_or(0, |outside| outside.skipped), jump: 0.0 }
    }
}

/// Holds each record of the run against the recording's.
impl RecordSink for Playback {
    fn record(&mut self, record: &ServoRecord) {
        let state = &mut *self.state();
        if state.divergence.is_some() {
            return;
        }
        let who = state.arms.get(usize::from(record.arm)).cloned().unwrap_or_default();
        let Some(recorded) = state.ahead.pop_front() else {
            if !state.over {
                let (recorded, now) = ("nothing".to_owned(), "a period".to_owned());
                let what = Difference { field: "period".to_owned(), recorded, now };
                state.part(record.period, &who, what);
            }
            return;
        };
        if let Some(what) = recorded.difference(&Tick::of(record)) {
            state.divergence = Some(Divergence { period: record.period, who, what });
        } else {
            state.compared += 1;
            state.last = record.period;
        }
    }
}
