//! Data of a report, gathered from a recording in one pass.

use crate::operator::{Class, Input};
use crate::record::cdr::{Malformed, Reader};
use crate::record::reading::{End, Label, Message, Piece, Reading, Unreadable};
use crate::record::sensed::{Found, Sensed};
use crate::record::standard;
use crate::record::summary::Summary;
use crate::record::tick::Tick;
use nalgebra::Point3;
use std::io::{Read, Seek};

/// Length of a bin of a curve (s).
pub(super) const BIN: f64 = 0.02;
/// Index of the last bin of a curve: a day. Later times in a recording go into this bin, so that no
/// file makes the curves take unbounded memory.
const LONGEST: usize = 24 * 3600 * 50;
/// Smallest time between two pictures of one camera in the report (s).
const APART: f64 = 1.0;

/// Data of a report. Times count from the first message of the recording.
#[derive(Debug, Default)]
pub struct Story {
    /// Metadata and scenario of the recording.
    pub label: Label,
    /// Summary of the run; `None` if the recording ends before the run does.
    pub summary: Option<Summary>,
    /// Phases: beginning (s), name. The last one is "end".
    pub phases: Vec<(f64, String)>,
    /// Holders of the cube at each change: time (s), names of the effectors.
    pub holders: Vec<(f64, Vec<String>)>,
    /// Curves of each effector.
    pub arms: Vec<ArmStory>,
    /// Pictures of the cameras.
    pub shots: Vec<Shot>,
    /// Drawings made from the recording: time (s), description, JPEG.
    pub drawn: Vec<(f64, String, Vec<u8>)>,
    /// Cubes that the stand-alone camera found: time (s), measured centre (m).
    pub seen: Vec<(f64, Point3<f64>)>,
    /// Looks at a face of the cube: time (s), sensor, and the reason if the face was not read.
    pub faces: Vec<(f64, String, Option<String>)>,
    /// Times at which the tracking camera was asked (periods of 2 ms).
    pub looks: Vec<u64>,
    /// True positions of the cube: time (s), centre (m).
    pub cube: Vec<(f64, Point3<f64>)>,
    /// Plans: time at which each was made (s), steps.
    pub plans: Vec<(f64, Vec<Step>)>,
    /// Colours of the cube as letters: as read, as believed, in the plant. Empty if unknown.
    pub letters: [String; 3],
    /// Messages that are warnings or errors: time (s), class, name of the actor, text.
    pub messages: Vec<(f64, Class, String, String)>,
    /// Inputs of the operator: time (s), description.
    pub operator: Vec<(f64, String)>,
    /// Time of the last message (s).
    pub end: f64,
    /// How the file ends.
    pub file_end: Option<End>,
    /// Number of messages in the recording.
    pub count: u64,
}

/// Step of a plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Action.
    pub what: String,
    /// Reason.
    pub why: String,
    /// Planned time (s).
    pub seconds: f64,
}

/// Picture of a camera.
#[derive(Debug, Clone)]
pub struct Shot {
    /// Time (s).
    pub time: f64,
    /// Name of the camera.
    pub camera: String,
    /// Picture as a JPEG file.
    pub jpeg: Vec<u8>,
}

/// Curves of an effector: the largest value in each bin of 20 ms.
#[derive(Debug, Default)]
pub struct ArmStory {
    /// Name.
    pub name: String,
    /// Norm of the force at the tool (N).
    pub force: Vec<f32>,
    /// Norm of the torque at the tool (Nm).
    pub torque: Vec<f32>,
    /// Force of the jaws (N).
    pub grip: Vec<f32>,
    /// Largest following error of the rotary joints: distance from the set value (rad).
    pub following: Vec<f32>,
    /// Number of servo periods in the recording.
    pub ticks: u64,
    /// Number of servo periods before the last one that are not in the recording.
    pub missing: u64,
    /// Last servo period in the recording.
    pub(super) last: u64,
}

/// Gathers the data of a report from a recording.
///
/// # Errors
/// [`Unreadable`] if the file is no recording of this program, has no message that a report uses,
/// or has a message that does not fit its type.
pub fn gather<R: Read + Seek>(from: R) -> Result<Story, Unreadable> {
    let mut story = Story::default();
    let mut reading = Reading::seekable(from);
    let (mut start, mut used) = (None, false);
    for piece in reading.by_ref() {
        story.label.take(&piece);
        let Piece::Message(message) = piece else { continue };
        // The metadata with the names of the arms comes before the first message.
        if story.arms.is_empty() {
            let names = story.label.fact("arms").split_whitespace();
            story.arms =
                names.map(|n| ArmStory { name: n.to_owned(), ..ArmStory::default() }).collect();
        }
        story.count += 1;
        // In a run on the wall clock, times count from 1970.
        let start = *start.get_or_insert(message.time);
        let time = message.time.saturating_sub(start) as f64 * 1e-9;
        story.end = story.end.max(time);
        used |= story
            .take(time, &message)
            .map_err(|why| Unreadable::Message { topic: message.channel.topic.clone(), why })?;
    }
    // An MCAP file of another program lacks the version of this one.
    if story.label.fact("version").is_empty() {
        return Err(Unreadable::Missing("not a recording of this program".to_owned()));
    }
    if !used {
        let flaw = reading.end().and_then(End::flaw);
        let why = flaw.map_or_else(|| "there is none".to_owned(), |end| format!("it is {end}"));
        return Err(Unreadable::Missing(format!("no message of a run can be read: {why}")));
    }
    story.summary = serde_json::from_str(story.label.of("summary", "json")).ok();
    story.file_end = reading.end().cloned();
    Ok(story)
}

impl Story {
    /// Adds the data of a message to the report. Returns `false` for a topic that the report does
    /// not use.
    fn take(&mut self, time: f64, message: &Message) -> Result<bool, Malformed> {
        let topic = message.channel.topic.as_str();
        let data = &message.data;
        match topic {
            "/phase" => {
                let mut from = stamped(data)?;
                self.phases.push((time, from.string()?.to_owned()));
            }
            "/cube" => {
                let mut from = stamped(data)?;
                let identified = from.string()?.to_owned();
                from.f64_sequence()?;
                let (believed, truth) = (from.string()?.to_owned(), from.string()?.to_owned());
                let holders = from.string_sequence()?.into_iter().map(str::to_owned).collect();
                self.letters = [identified, believed, truth];
                // There is also a message when only the colours change.
                if self.holders.last().is_none_or(|(_, before)| *before != holders) {
                    self.holders.push((time, holders));
                }
            }
            "/plan" => {
                let mut from = stamped(data)?;
                let (what, why) = (from.string_sequence()?, from.string_sequence()?);
                let seconds = from.f64_sequence()?;
                let steps = what.iter().zip(&why).zip(&seconds);
                let step = |((what, why), seconds): ((&&str, &&str), &f64)| Step {
                    what: (*what).to_owned(),
                    why: (*why).to_owned(),
                    seconds: *seconds,
                };
                self.plans.push((time, steps.map(step).collect()));
            }
            "/rosout" => {
                let (class, who, what) = standard::read_log(&mut Reader::new(data)?)?;
                // Phases have a topic of their own.
                if class > Class::Info || !what.starts_with("phase: ") {
                    self.messages.push((time, class, who.to_owned(), what.to_owned()));
                }
            }
            "/operator" => {
                let mut from = stamped(data)?;
                from.u64()?;
                self.operator.push((time, Input::describe_recorded(from.string()?)));
            }
            "/sensed" => self.sensed(time, &Sensed::read(data)?),
            "/tf" => self.transforms(time, data)?,
            _ if topic.ends_with("/servo") => self.tick(time, &Tick::read(data)?),
            _ if topic.ends_with("/image") => self.shot(time, topic, data)?,
            _ => return Ok(false),
        }
        Ok(true)
    }

    /// Adds the answer of a sensor at `time` (s). The sensor is the stand-alone camera, which
    /// tracks the cube, or a hand's camera, which reads a face.
    fn sensed(&mut self, time: f64, sensed: &Sensed) {
        let exposed = sensed.period as f64 * 0.002;
        // The text of the request is the `Debug` form of its type: `Sensing` for the tracking
        // camera, a view for a face.
        let tracks = sensed.asked.starts_with("Sensing");
        if tracks {
            self.looks.push(sensed.period);
        } else {
            let why = sensed.found.as_ref().err().cloned();
            self.faces.push((time, sensed.sensor.clone(), why));
        }
        if let Ok(Found::Cube { world_from_cube, .. }) = &sensed.found {
            self.seen.push((exposed, world_from_cube.translation.vector.into()));
        }
    }

    /// Adds a servo tick to the curves of its arm.
    fn tick(&mut self, time: f64, tick: &Tick) {
        let Some(arm) = self.arms.get_mut(usize::from(tick.arm)) else { return };
        arm.ticks += 1;
        // A file may hold any number as a period, so the sums saturate.
        let between = tick.period.saturating_sub(arm.last.saturating_add(1));
        arm.missing = arm.missing.saturating_add(between);
        arm.last = tick.period;
        // Later times than those of any run fall into the last bin.
        let bin = ((time / BIN) as usize).min(LONGEST);
        let most = |curve: &mut Vec<f32>, value: f64| {
            if curve.len() <= bin {
                curve.resize(bin + 1, 0.0);
            }
            curve[bin] = curve[bin].max(value as f32);
        };
        most(&mut arm.force, tick.wrench_in_tool.force.norm());
        most(&mut arm.torque, tick.wrench_in_tool.torque.norm());
        most(&mut arm.grip, tick.jaw_force);
        // Joint 0 is the track. Its error is in m, so it cannot be part of a curve in rad.
        let apart = (1..7).map(|i| (tick.joints[i] - tick.desired_joints[i]).abs());
        most(&mut arm.following, apart.fold(0.0, f64::max));
    }

    /// Adds the true position of the cube if the `/tf` message holds the cube's transform.
    fn transforms(&mut self, time: f64, data: &[u8]) -> Result<(), Malformed> {
        let mut from = Reader::new(data)?;
        // The cube's message has one transform. That of an arm has those of all its links.
        if from.u32()? != 1 {
            return Ok(());
        }
        let (_, _) = from.header()?;
        if from.string()? == "cube" {
            let [x, y, z] = from.f64s()?;
            self.cube.push((time, Point3::new(x, y, z)));
        }
        Ok(())
    }

    /// Adds a picture, unless the last one of its camera is less than [`APART`] older.
    fn shot(&mut self, time: f64, topic: &str, data: &[u8]) -> Result<(), Malformed> {
        let camera = topic.trim_start_matches('/').trim_end_matches("/image").to_owned();
        let last = self.shots.iter().rev().find(|shot| shot.camera == camera);
        if last.is_some_and(|last| time - last.time < APART) {
            return Ok(());
        }
        let mut from = Reader::new(data)?;
        from.header()?;
        from.string()?;
        let jpeg = from.u8_sequence()?.to_vec();
        self.shots.push(Shot { time, camera, jpeg });
        Ok(())
    }
}

/// Returns a reader that begins after the time stamp of a message.
fn stamped(data: &[u8]) -> Result<Reader<'_>, Malformed> {
    let mut from = Reader::new(data)?;
    from.time()?;
    Ok(from)
}
