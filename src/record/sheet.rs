//! Contents of a recording: converts servo records and entries into messages on topics.
//!
//! | topic | type | written |
//! |---|---|---|
//! | `/ARM/servo` | `rubik_robot_msgs/ServoTick` | each servo period, all inputs and outputs |
//! | `/joint_states` | `sensor_msgs/JointState` | each 16 ms for each arm |
//! | `/ARM/wrench` | `geometry_msgs/WrenchStamped` | each 16 ms |
//! | `/tf` | `tf2_msgs/TFMessage` | each 40 ms, all moving links; true cube and loose objects |
//! | `/ARM/tool` | `geometry_msgs/PoseStamped` | each 40 ms |
//! | `/tf_static` | `tf2_msgs/TFMessage` | once |
//! | `/robot_description` | `std_msgs/String` | once |
//! | `/CAMERA/info` | `sensor_msgs/CameraInfo` | once |
//! | `/CAMERA/image` | `sensor_msgs/CompressedImage` | each look at a face; tracking each 200 ms |
//! | `/sensed` | `rubik_robot_msgs/Sensed` | each answer of a sensor |
//! | `/cube/seen` | `geometry_msgs/PoseStamped` | each cube that a sensor found |
//! | `/phase`, `/cube`, `/plan`, `/operator` | `rubik_robot_msgs/...` | each change |
//! | `/belief` | `std_msgs/String`, JSON | each change of the belief that the page shows |
//! | `/rosout` | `rcl_interfaces/Log` | each message to the operator |
//! | `/offset` | `rubik_robot_msgs/Offset` | each change, on a node beside that of MP |
//!
//! | metadata | contents | written |
//! |---|---|---|
//! | `rubik_robot` | program, version, build, tasks, seed, task | at the beginning |
//! | `options` | options that override the scenario | at the beginning |
//! | `calibration` | cameras, if the run was calibrated | after the calibration |
//! | `node` | node, run and scenario, for a run on several hosts | after joining |
//! | `summary`, `timing` | results of the run, timing of the servo | at the end |
//! | `vision` | time that reading a face took | at the end |
//! | `recording` | numbers of written and lost messages | at the end |
//!
//! The scenario is attached as `scenario.toml`.

use super::belief;
use super::cdr::Writer;
use super::entry::Entry;
use super::file::{File, Unwritten};
use super::schema::Kind;
use super::sensed::Found;
use super::urdf::{self, Model};
use super::{standard, tick};
use crate::cell::Cell;
use crate::hw::driver::ServoRecord;
use crate::hw::scene::Scene;
use crate::kernel::Picture;
use crate::motion::{JointPositions, PERIOD};
use crate::servo::period::Length;
use std::collections::BTreeMap;
use std::io::{Seek, Write};

/// Time between two joint states (periods of 2 ms).
const STATES: u64 = 8;
/// Time between two sets of transforms (periods of 2 ms).
const FRAMES: u64 = 20;
/// Topic of the difference between the periods of a node and those of MP's node.
pub(super) const OFFSET: &str = "/offset";
/// Quality of pictures, 0 to 100.
const JPEG: u8 = 85;

/// Description of the run that is recorded.
#[derive(Debug, Clone)]
pub struct RunInfo {
    /// Cell as the controller believes it: arms and cameras.
    pub cell: Cell,
    /// Text of the scenario.
    pub scenario: String,
    /// Options that override the scenario: option, key, value.
    pub options: Vec<(String, String, String)>,
    /// Facts by name: version, seed, task and others.
    pub facts: BTreeMap<String, String>,
    /// Loose objects of the simulated cell: index in a scene, and name of the link.
    pub objects: Vec<(usize, String)>,
    /// Time at which period 0 begins (ns): 0 on the virtual clock, Unix time on the wall clock.
    pub start: u64,
    /// Length of a servo period.
    pub length: Length,
}

/// Converter of servo records and entries into messages of a file.
pub struct MessageWriter {
    about: RunInfo,
    /// Links and joints of the cell, for transforms and names.
    model: Model,
    pen: Pen,
    /// Latest joint positions of each arm.
    joints: Vec<JointPositions>,
    /// Latest opening of each arm's jaws (m).
    openings: Vec<f64>,
    arms: Vec<ArmTopics>,
    cameras: Vec<CameraTopics>,
    /// Names of the arms.
    names: Vec<String>,
    /// Latest belief that was written.
    belief: Option<Picture>,
    /// Latest colours of the plant's cube.
    truth: String,
    /// State of the cube that was written last.
    cube: belief::CubeKnown,
    /// Times that reading faces took (s).
    faces: Vec<f64>,
    /// Reused memory for positions of joints.
    positions: Vec<f64>,
    /// Reused memory for the file of a picture.
    jpeg: Vec<u8>,
}

/// Writer that counts its messages and reuses its buffer.
struct Pen {
    buffer: Vec<u8>,
    messages: u64,
}

/// Topics of an arm and frame of its tool.
struct ArmTopics {
    servo: String,
    wrench: String,
    tool: String,
    /// Frame of the tool.
    frame: String,
    /// Names of the joints that move.
    joints: Vec<String>,
    /// Indices of these joints in the model.
    moving: Vec<usize>,
}

/// Topics of a camera and its optical frame.
struct CameraTopics {
    image: String,
    info: String,
    frame: String,
}

/// Result of writing to the file.
type Done = Result<(), Unwritten>;

impl MessageWriter {
    /// Makes the converter that turns a run's servo records and events into messages of the
    /// recording.
    #[must_use]
    pub fn new(about: RunInfo) -> Self {
        let cell = &about.cell;
        // One model gives both `/robot_description` and the transforms, so that their names and
        // frames agree.
        let model = Model::of(cell, None, true);
        let arms = cell.arms.iter().enumerate().map(|(index, arm)| {
            let own = |joint: &urdf::Joint| joint.kind.drive().is_some_and(|d| d.by.0 == index);
            let moving: Vec<_> =
                (0..model.joints.len()).filter(|&i| own(&model.joints[i])).collect();
            ArmTopics {
                servo: format!("/{}/servo", arm.name),
                wrench: format!("/{}/wrench", arm.name),
                tool: format!("/{}/tool", arm.name),
                frame: format!("{}_tool", arm.name),
                joints: moving.iter().map(|&i| model.joints[i].name.clone()).collect(),
                moving,
            }
        });
        let cameras = cell.cameras.iter().map(|camera| CameraTopics {
            image: format!("/{}/image", camera.name),
            info: format!("/{}/info", camera.name),
            frame: format!("{}_optical", camera.name),
        });
        Self {
            arms: arms.collect(),
            cameras: cameras.collect(),
            names: cell.arms.iter().map(|arm| arm.name.clone()).collect(),
            joints: cell.arms.iter().map(|arm| arm.start).collect(),
            openings: vec![0.0; cell.arms.len()],
            pen: Pen { buffer: Vec::with_capacity(1024), messages: 0 },
            belief: None,
            truth: String::new(),
            cube: belief::CubeKnown::default(),
            faces: Vec::new(),
            positions: Vec::new(),
            jpeg: Vec::new(),
            model,
            about,
        }
    }

    /// Returns the number of messages that were written.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.pen.messages
    }

    /// Returns the number of messages that [`Self::tick`] writes for a servo record.
    #[must_use]
    pub(crate) fn messages_of(&self, record: &ServoRecord) -> u64 {
        let period = self.about.length.tick(record.period);
        // Two messages at each rate: joint state and wrench, transforms and tool.
        let each = |every: u64| 2 * u64::from(period.is_multiple_of(every));
        1 + each(STATES) + each(FRAMES)
    }

    /// Returns the number of faces that were read (`faces`) and the median time that a reading took
    /// (`face_median_s`, s) as texts by name; empty if no face was read.
    #[must_use]
    pub fn vision(&mut self) -> BTreeMap<String, String> {
        self.faces.sort_by(f64::total_cmp);
        let Some(median) = self.faces.get(self.faces.len() / 2) else { return BTreeMap::new() };
        let facts =
            [("faces", self.faces.len().to_string()), ("face_median_s", median.to_string())];
        facts.map(|(name, value)| (name.to_owned(), value)).into()
    }

    /// Converts the number of a servo period, whose length may differ from 2 ms, to the number of
    /// the period of 2 ms in which it begins.
    #[must_use]
    pub(crate) fn tick_of(&self, period: u64) -> u64 {
        self.about.length.tick(period)
    }

    /// Writes the metadata of the run, its scenario, and all messages that are written only once.
    ///
    /// # Errors
    /// Error of the device.
    pub fn begin<W: Write + Seek>(&mut self, file: &mut File<W>) -> Done {
        file.metadata("rubik_robot", &self.about.facts)?;
        // The map sorts its keys as texts, so numbers of three digits keep the order of the
        // options.
        let options = self.about.options.iter().enumerate().map(|(i, option)| {
            let text = serde_json::to_string(option).unwrap_or_default();
            (format!("{i:03}"), text)
        });
        file.metadata("options", &options.collect())?;
        file.attach("scenario.toml", "application/toml", self.about.scenario.as_bytes())?;
        let start = self.about.start;
        let description = urdf::xml(&self.model);
        self.pen.put(file, ("/robot_description", Kind::Text), start, |to| {
            standard::text(to, &description);
        })?;
        let fixed: Vec<_> = self.model.fixed().collect();
        self.pen.put(file, ("/tf_static", Kind::Transforms), start, |to| {
            standard::transforms(to, start, fixed.into_iter());
        })?;
        for (camera, topics) in self.about.cell.cameras.iter().zip(&self.cameras) {
            self.pen.put(file, (&topics.info, Kind::CameraInfo), start, |to| {
                standard::camera_info(to, start, &topics.frame, &camera.intrinsics);
            })?;
        }
        // With the flush, even a file that is soon cut off identifies its run.
        file.flush()
    }

    /// Writes a servo record as a message, and at lower rates the standard ROS messages that follow
    /// from it.
    ///
    /// # Errors
    /// Error of the device.
    pub fn tick<W: Write + Seek>(&mut self, record: &ServoRecord, file: &mut File<W>) -> Done {
        let arm = usize::from(record.arm);
        let Some(topics) = self.arms.get(arm) else { return Ok(()) };
        let time = self.about.start + record.period * self.about.length.nanos();
        self.pen.put(file, (&topics.servo, Kind::ServoTick), time, |to| {
            tick::write(record, time, to);
        })?;
        self.joints[arm] = record.state.joints;
        self.openings[arm] = record.state.jaw_opening;
        // Replays need the servo ticks at the full rate. The messages below are drawn by other
        // tools, for which a lower rate is enough.
        let period = self.about.length.tick(record.period);
        if period.is_multiple_of(STATES) {
            self.states(arm, time, record, file)?;
        }
        if period.is_multiple_of(FRAMES) {
            self.frames(arm, time, record, file)?;
        }
        Ok(())
    }

    /// Writes joint state and wrench of the arm with the index `arm`; `time` is their time stamp
    /// (ns).
    fn states<W: Write + Seek>(
        &mut self,
        arm: usize,
        time: u64,
        record: &ServoRecord,
        file: &mut File<W>,
    ) -> Done {
        let topics = &self.arms[arm];
        let drives = topics.moving.iter().filter_map(|&i| self.model.joints[i].kind.drive());
        self.positions.clear();
        self.positions.extend(drives.map(|drive| match drive.by.1 {
            urdf::Variable::Joint(index) => record.state.joints.0[index],
            // Each of the two fingers moves by half of the opening.
            urdf::Variable::HalfOpening => 0.5 * record.state.jaw_opening,
        }));
        self.pen.put(file, ("/joint_states", Kind::JointState), time, |to| {
            standard::joint_state(to, time, &topics.joints, &self.positions);
        })?;
        self.pen.put(file, (&topics.wrench, Kind::Wrench), time, |to| {
            standard::wrench(to, time, &topics.frame, &record.state.wrench_in_tool);
        })
    }

    /// Writes the transforms of the moving links of the arm with the index `arm`, and the pose of
    /// its tool in the world; `time` is their time stamp (ns).
    fn frames<W: Write + Seek>(
        &mut self,
        arm: usize,
        time: u64,
        record: &ServoRecord,
        file: &mut File<W>,
    ) -> Done {
        let topics = &self.arms[arm];
        let moving = topics.moving.iter().map(|&i| {
            let joint = &self.model.joints[i];
            let pose = joint.place(&self.joints, &self.openings);
            (joint.parent.as_str(), joint.child.as_str(), pose)
        });
        self.pen.put(file, ("/tf", Kind::Transforms), time, |to| {
            standard::transforms(to, time, moving);
        })?;
        let world_from_tool =
            self.about.cell.arms[arm].world_from_base * record.state.base_from_tool;
        self.pen.put(file, (&topics.tool, Kind::Pose), time, |to| {
            standard::pose(to, time, "world", &world_from_tool);
        })
    }

    /// Writes an entry. Its time is the beginning of the period of 2 ms with the number `period`.
    ///
    /// # Errors
    /// Error of the device.
    pub fn entry<W: Write + Seek>(
        &mut self,
        period: u64,
        entry: &Entry,
        file: &mut File<W>,
    ) -> Done {
        let time = self.about.start + (period as f64 * PERIOD * 1e9).round() as u64;
        let pen = &mut self.pen;
        match entry {
            Entry::Log(class, name, text) => pen.put(file, ("/rosout", Kind::Log), time, |to| {
                standard::log(to, time, *class, name, text);
            }),
            Entry::Phase(name, outcome) => pen.put(file, ("/phase", Kind::TaskPhase), time, |to| {
                to.time(time);
                to.string(name);
                to.string(outcome);
            }),
            Entry::Sensed(sensed) => {
                pen.put(file, ("/sensed", Kind::Sensed), time, |to| sensed.write(time, to))?;
                // A found cube is written again in a standard type, which any viewer draws.
                let Ok(Found::Cube { world_from_cube, .. }) = &sensed.found else { return Ok(()) };
                pen.put(file, ("/cube/seen", Kind::Pose), time, |to| {
                    standard::pose(to, time, "world", world_from_cube);
                })
            }
            Entry::Picture(camera, image) => {
                // The encoding takes long: it is left out if nobody gets the picture.
                let Some(topics) = self.cameras.get(*camera).filter(|_| file.is_read()) else {
                    return Ok(());
                };
                self.jpeg.clear();
                // A picture that cannot be encoded is left out without an error: the device has not
                // failed.
                let encoder =
                    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut self.jpeg, JPEG);
                if image.write_with_encoder(encoder).is_err() {
                    return Ok(());
                }
                pen.put(file, (&topics.image, Kind::Picture), time, |to| {
                    standard::picture(to, time, &topics.frame, &self.jpeg);
                })
            }
            // Only the number and the median of these times go into the file, at its end.
            Entry::FaceTook(seconds) => {
                self.faces.push(*seconds);
                Ok(())
            }
            Entry::Scene(scene) => self.scene(time, scene, file),
            Entry::Operator(command) => pen.put(file, ("/operator", Kind::Operator), time, |to| {
                to.time(time);
                to.u64(period);
                to.string(command);
            }),
            Entry::Belief(picture) => self.belief(time, picture, file),
            Entry::Offset(offset) => pen.put(file, (OFFSET, Kind::Offset), time, |to| {
                to.time(time);
                to.u64(period);
                to.i64(*offset);
            }),
            Entry::Facts(name, facts) => file.metadata(name, &facts.iter().cloned().collect()),
        }
    }

    /// Writes the pose of the plant's cube, and the state of the cube if its colours have changed.
    fn scene<W: Write + Seek>(&mut self, time: u64, scene: &Scene, file: &mut File<W>) -> Done {
        let place = [("world", "cube", scene.cube.world_from_cube)];
        self.pen.put(file, ("/tf", Kind::Transforms), time, |to| {
            standard::transforms(to, time, place.into_iter());
        })?;
        let objects = self.about.objects.iter().filter_map(|(i, link)| {
            let object = scene.objects.get(*i).copied().flatten()?;
            Some(("world", link.as_str(), object.world_from_object))
        });
        let objects: Vec<_> = objects.collect();
        if !objects.is_empty() {
            self.pen.put(file, ("/tf", Kind::Transforms), time, |to| {
                standard::transforms(to, time, objects.into_iter());
            })?;
        }
        let truth = belief::letters(scene.cube.facelets.iter().map(|c| Some(*c)));
        if truth == self.truth {
            return Ok(());
        }
        self.truth = truth;
        self.known(time, file)
    }

    /// Writes the belief `now` if it differs from the last one. Writes its plan and the state of
    /// the cube as separate messages if they have changed.
    fn belief<W: Write + Seek>(&mut self, time: u64, now: &Picture, file: &mut File<W>) -> Done {
        if self.belief.as_ref() == Some(now) {
            return Ok(());
        }
        let before = self.belief.replace(now.clone());
        let text = belief::json(now);
        self.pen.put(file, ("/belief", Kind::Text), time, |to| standard::text(to, &text))?;
        if before.is_none_or(|before| before.plan != now.plan) && !now.plan.is_empty() {
            self.pen.put(file, ("/plan", Kind::Plan), time, |to| {
                belief::write_plan(now, time, to);
            })?;
        }
        // A belief can change without the cube, as when the next step of the plan begins.
        let mut known = belief::known(now, &self.names);
        known.truth.clone_from(&self.truth);
        if known == self.cube {
            return Ok(());
        }
        self.cube = known;
        self.known(time, file)
    }

    /// Writes the state of the cube: the belief of the controller, and the true colours of the
    /// plant's cube.
    fn known<W: Write + Seek>(&mut self, time: u64, file: &mut File<W>) -> Done {
        self.cube.truth.clone_from(&self.truth);
        let known = &self.cube;
        self.pen.put(file, ("/cube", Kind::CubeState), time, |to| {
            to.time(time);
            to.string(&known.identified);
            to.f64_sequence(&known.confidences);
            to.string(&known.believed);
            to.string(&known.truth);
            to.string_sequence(&known.holders);
        })
    }
}

impl Pen {
    /// Writes a message of type `kind` to `topic` at `time` (ns). `fill` writes its fields.
    fn put<W: Write + Seek>(
        &mut self,
        file: &mut File<W>,
        (topic, kind): (&str, Kind),
        time: u64,
        fill: impl FnOnce(&mut Writer),
    ) -> Done {
        let mut writer = Writer::new(std::mem::take(&mut self.buffer));
        fill(&mut writer);
        // The next message uses the same memory.
        self.buffer = writer.bytes();
        file.message(topic, kind, time, &self.buffer)?;
        self.messages += 1;
        Ok(())
    }
}
