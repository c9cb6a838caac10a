//! Playback of a recording to a controller: the controller gets the recorded inputs again, and its
//! outputs are compared with the recorded ones.
//!
//! - in: a recording
//! - out: a [`Port`] with the recorded readings, the answers of the sensors and the inputs of the
//!   operator; the first [`Divergence`], if there is one
//!
//! A look is a request to a virtual sensor.

use super::reading::{End, Label, Message, Piece, Reading, Unreadable, open};
use super::sensed::{Found, Sensed};
use super::tick::{Difference, Tick};
use crate::hw::driver::{RecordSink, ServoRecord};
use crate::hw::port::{Delay, Port, PortFault};
use crate::motion::PERIOD;
use crate::servo::io::{ArmDrive, ArmReading};
use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// First difference of a repeated run from its recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Divergence {
    /// Number of the servo period; for a look, of the period of 2 ms.
    pub period: u64,
    /// Name of the effector or of the sensor.
    pub who: String,
    /// Field that differs, with its recorded and its present value.
    pub what: Difference,
}

impl std::fmt::Display for Divergence {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Difference { field, recorded, now } = &self.what;
        write!(f, "period {}, {}, {field}: recorded {recorded}, now {now}", self.period, self.who)
    }
}

/// Recorded answer to a request to a sensor.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Played {
    /// Answer of the sensor.
    Answer(Result<Found, String>),
    /// No answer: the recording has no further answer of this sensor.
    Nothing,
}

/// Recording that is being played back. All clones share one position in it.
#[derive(Clone)]
pub struct Playback(Arc<Mutex<State>>);

/// Position in the recording, and the result of the comparison.
struct State {
    /// Names of the arms.
    arms: Vec<String>,
    /// Rest of the recording, from which the ticks are read.
    stream: Reading<std::io::BufReader<std::fs::File>>,
    /// Ticks that were read and not compared yet.
    ahead: VecDeque<Tick>,
    /// Answers of the sensors that have not been delivered yet.
    sensed: Vec<Sensed>,
    /// Inputs of the operator that have not been delivered yet, with their periods of 2 ms.
    operator: VecDeque<(u64, String)>,
    /// First injected fault that is no input of the controller: period of 2 ms, description.
    injected: Option<(u64, String)>,
    /// Number of ticks that were equal.
    compared: u64,
    /// Last servo period that was equal.
    last: u64,
    divergence: Option<Divergence>,
    /// Whether the port has delivered the last readings.
    over: bool,
}

impl Playback {
    /// Opens a recording for playback; `arms` are the names of its arms. Answers of sensors and
    /// inputs of the operator are read at once, servo ticks when they are needed. Returns the
    /// recording's metadata as well.
    ///
    /// # Errors
    /// [`Unreadable`] if the file cannot be read, or a message does not fit its type.
    pub fn open(path: &Path, arms: Vec<String>) -> Result<(Self, Label), Unreadable> {
        let mut label = Label::default();
        // The ticks are read one by one in a second pass: the recording of a mission takes 200 MB.
        let (mut sensed, mut operator, mut injected) = (Vec::new(), VecDeque::new(), None);
        // The reading ends at a damaged place: all later outputs depend on inputs that may be lost
        // there.
        for piece in open(path)?.up_to_damage() {
            label.take(&piece);
            let Piece::Message(Message { channel, data, .. }) = piece else { continue };
            let broken = |why| Unreadable::Message { topic: channel.topic.clone(), why };
            match channel.topic.as_str() {
                "/sensed" => sensed.push(Sensed::read(&data).map_err(broken)?),
                "/operator" => operator.push_back(operator_input(&data).map_err(broken)?),
                "/rosout" if injected.is_none() => {
                    injected = unrecorded_fault(&data).map_err(broken)?;
                }
                _ => {}
            }
        }
        let file = std::fs::File::open(path)?;
        let state = State {
            arms,
            stream: Reading::seekable(std::io::BufReader::with_capacity(1 << 20, file))
                .up_to_damage(),
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

    /// Returns the recorded answer to the next request to a sensor. If the request was recorded
    /// with another text than `asked` or in another `period` of 2 ms, that is kept as a divergence.
    #[must_use]
    pub(crate) fn sensed(&self, sensor: &str, period: u64, asked: &str) -> Played {
        let state = &mut *self.state();
        // The answers of one sensor are in the order of its requests.
        let Some(at) = state.sensed.iter().position(|s| s.sensor == sensor) else {
            return Played::Nothing;
        };
        let answer = state.sensed.remove(at);
        if answer.period != period || answer.asked != asked {
            let recorded = format!("period {}, {}", answer.period, answer.asked);
            state.keep_first(period, sensor, look_difference(recorded, period, asked));
        }
        Played::Answer(answer.found)
    }

    /// Keeps as a divergence that this run completed a look of `sensor` in `period` (of 2 ms) with
    /// the text `asked`, which the recording does not contain. A look that the end of a run cuts
    /// off is never recorded, so the caller must not report it here.
    pub(crate) fn report_unrecorded_look(&self, sensor: &str, period: u64, asked: &str) {
        let mut state = self.state();
        // The answer to a look comes some periods after its request: a recording that is cut off in
        // between has the request only, and the run looks on while its arms come to rest.
        if !state.over {
            let difference = look_difference("nothing".to_owned(), period, asked);
            state.keep_first(period, sensor, difference);
        }
    }

    /// Returns the operator's next recorded input (JSON) and removes it, if it was given in this
    /// period of 2 ms or before; otherwise `None`.
    #[must_use]
    pub fn operator(&self, period: u64) -> Option<String> {
        let mut state = self.state();
        if state.operator.front().is_some_and(|(at, _)| *at <= period) {
            return state.operator.pop_front().map(|(_, command)| command);
        }
        None
    }

    /// Returns the first divergence of this run from its recording, if there is one, and the number
    /// of servo ticks before it that were equal.
    #[must_use]
    pub fn verdict(&self) -> (Option<Divergence>, u64) {
        let state = self.state();
        (state.divergence.clone(), state.compared)
    }

    /// Returns the first injected fault of an actor or the clock: the period of 2 ms in which it
    /// was logged (on the virtual clock), and its description. The recorded inputs do not contain
    /// these faults.
    #[must_use]
    pub fn injected(&self) -> Option<(u64, String)> {
        self.state().injected.clone()
    }

    /// Reads to the end of the recording. Returns the number of recorded servo ticks that the run
    /// did not reach.
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

    /// Returns the last servo period in which the run and its recording were equal.
    #[must_use]
    pub fn last_period(&self) -> u64 {
        self.state().last
    }

    /// Returns how the file is cut off or damaged, with the reason in brackets; `None` if it is
    /// whole, or if its ticks have not been read to the end yet.
    #[must_use]
    pub fn cut(&self) -> Option<String> {
        let state = self.state();
        let flaw = state.stream.end().and_then(End::loss)?;
        Some(format!("{flaw:#}"))
    }

    /// Returns the next tick of the recording and removes it from the playback.
    #[must_use]
    pub fn tick(&self) -> Option<Tick> {
        let mut state = self.state();
        state.ahead.pop_front().or_else(|| state.next_tick())
    }

    /// Locks the state, also after a panic of another thread that held it.
    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Decodes a recorded input of the operator: the period of 2 ms in which it was given, and the
/// input as JSON.
fn operator_input(data: &[u8]) -> Result<(u64, String), super::cdr::Malformed> {
    let mut from = super::cdr::Reader::new(data)?;
    from.time()?;
    Ok((from.u64()?, from.string()?.to_owned()))
}

/// Beginnings of the descriptions of injected faults that act on an actor or on the clock, so that
/// no recorded input shows them.
const PAST_INPUTS: [&str; 5] =
    ["actor panic", "actor hang", "heart beat loss", "late message", "clock jump"];

/// Decodes a line of the log. If it reports an injected fault of a kind in [`PAST_INPUTS`], returns
/// the period of 2 ms, counted from time 0 of the virtual clock, and the description of the fault.
fn unrecorded_fault(data: &[u8]) -> Result<Option<(u64, String)>, super::cdr::Malformed> {
    let mut from = super::cdr::Reader::new(data)?;
    let time = from.time()?;
    from.u8()?;
    let (who, text) = (from.string()?, from.string()?);
    let what = text.strip_prefix("injected fault: ").filter(|_| who == "plant");
    let what = what.filter(|what| PAST_INPUTS.iter().any(|kind| what.starts_with(kind)));
    Ok(what.map(|what| ((time as f64 * 1e-9 / PERIOD).round() as u64, what.to_owned())))
}

/// Describes the difference between a recorded look (`recorded`, as text) and the look that this
/// run makes in `period` (of 2 ms) with the text `asked`.
fn look_difference(recorded: String, period: u64, asked: &str) -> Difference {
    Difference { field: "look".to_owned(), recorded, now: format!("period {period}, {asked}") }
}

impl State {
    /// Reads on to the next servo tick of the recording; `None` at its end. A tick that cannot be
    /// decoded is left out, so its period is missing.
    fn next_tick(&mut self) -> Option<Tick> {
        self.stream.by_ref().find_map(|piece| match piece {
            Piece::Message(message) if message.channel.topic.ends_with("/servo") => {
                Tick::read(&message.data).ok()
            }
            _ => None,
        })
    }

    /// Keeps a divergence, unless an earlier one is kept already: the later may follow from it.
    fn keep_first(&mut self, period: u64, who: &str, what: Difference) {
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
        // A playback stops the run by a fault of the port.
        let ends = |reason: &str| PortFault { effector: 0, reason: reason.to_owned() };
        if state.divergence.is_some() {
            return Err(ends("the run differs from its recording"));
        }
        if state.over {
            return Err(ends("the recording ends here"));
        }
        // The readings at the end of a period are the inputs of the next one, so the ticks of
        // `period + 1` have them.
        while state.ahead.len() < readings.len() {
            let Some(tick) = state.next_tick() else {
                // The readings at the end of the last period were never used. In a file that is
                // cut off, ticks of some arms may be missing; those of the other arms are dropped.
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

    /// Returns the number of periods that the recorded servo missed before its next period, so that
    /// this servo misses as many.
    fn delay(&mut self) -> Delay {
        let state = self.state();
        let next = state.ahead.front().and_then(|tick| tick.outside().ok());
        Delay { periods: next.map_or(0, |outside| outside.skipped), jump: 0.0 }
    }
}

/// Each record of the run is compared with the recorded one. After the first difference nothing
/// more is compared.
impl RecordSink for Playback {
    fn record(&mut self, record: &ServoRecord) {
        let state = &mut *self.state();
        if state.divergence.is_some() {
            return;
        }
        let who = state.arms.get(usize::from(record.arm)).cloned().unwrap_or_default();
        let Some(recorded) = state.ahead.pop_front() else {
            // After the last recorded period a run may compute one more. This is no divergence.
            if !state.over {
                let (recorded, now) = ("nothing".to_owned(), "a period".to_owned());
                let what = Difference { field: "period".to_owned(), recorded, now };
                state.keep_first(record.period, &who, what);
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
