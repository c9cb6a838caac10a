//! What goes into a recording, by topic:
//!
//! | topic | type | when |
//! |---|---|---|
//! | `/ARM/servo` | `rubik_robot_msgs/ServoTick` | each servo period: all that was read and commanded |
//! | `/joint_states`, `/ARM/wrench` | `sensor_msgs/JointState`, `geometry_msgs/WrenchStamped` | each 16 ms |
//! | `/tf`, `/ARM/tool` | `tf2_msgs/TFMessage`, `geometry_msgs/PoseStamped` | each 40 ms, every link |
//! | `/tf_static`, `/robot_description` | `tf2_msgs/TFMessage`, `std_msgs/String` | once |
//! | `/CAMERA/image`, `/CAMERA/info` | `sensor_msgs/CompressedImage`, `CameraInfo` | each look at a face; tracking each 200 ms |
//! | `/sensed`, `/cube/seen` | `rubik_robot_msgs/Sensed`, `geometry_msgs/PoseStamped` | each time that a sensor delivers |
//! | `/phase`, `/cube`, `/plan`, `/operator` | `rubik_robot_msgs/...` | when it changes |
//! | `/belief` | `std_msgs/String`, JSON | when it changes: what the operator's page shows of the kernel |
//! | `/rosout` | `rcl_interfaces/Log` | every message to the operator |
//!
//! Metadata `rubik_robot` holds version, build, seed, task; `options` what overruled the scenario;
//! `summary`, `timing`, `vision` (how long it took) and `recording` (messages in it, and how many
//! were lost) come at the end; `calibration` has the cameras where the controller believed others
//! than the scenario's. The scenario is attached as `scenario.toml`.

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
use crate::motion::{JointPositions, PERIOD};
use crate::servo::period::Length;
use crate::tasks::Picture;
use std::collections::BTreeMap;
use std::io::{Seek, Write};

/// Servo periods of 2 ms between two joint states.
const STATES: u64 = 8;
/// Between two sets of transforms.
const FRAMES: u64 = 20;
/// Quality of pictures, of 100.
const JPEG: u8 = 85;

/// What a recording is of.
#[derive(Debug, Clone)]
pub struct About {
    /// The controller's belief: arms and cameras.
    pub cell: Cell,
    /// Text of the scenario.
    pub scenario: String,
    /// What overruled it: option, key, value.
    pub options: Vec<(String, String, String)>,
    /// Version, seed, task and so on.
    pub facts: BTreeMap<String, String>,
    /// When period 0 begins (ns): 0 on the virtual clock, since 1970 on the wall's.
    pub start: u64,
    /// Length of a servo period.
    pub length: Length,
}

/// Where what comes is written.
pub struct Sheet {
    about: About,
    model: Model,
    pen: Pen,
    joints: Vec<JointPositions>,
    openings: Vec<f64>,
    arms: Vec<ArmTopics>,
    cameras: Vec<CameraTopics>,
    /// Names of the arms.
    names: Vec<String>,
    belief: Option<Picture>,
    truth: String,
    cube: belief::CubeKnown,
    /// How long it took to read faces (s).
    faces: Vec<f64>,
    /// Memory that is used again: positions of joints, a picture's file.
    positions: Vec<f64>,
    jpeg: Vec<u8>,
}

/// Writes messages, and counts them.
struct Pen {
    buffer: Vec<u8>,
    messages: u64,
}

struct ArmTopics {
    servo: String,
    wrench: String,
    tool: String,
    frame: String,
    /// Its joints that move: names, and where they stand in the model.
    joints: Vec<String>,
    moving: Vec<usize>,
}

struct CameraTopics {
    image: String,
    info: String,
    frame: String,
}

type Done = Result<(), Unwritten>;

impl Sheet {
    /// For a run.
    #[must_use]
    pub fn new(about: About) -> Self {
        let cell = &about.cell;
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

    /// Messages written so far.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.pen.messages
    }

    /// How many messages a servo record comes to.
    #[must_use]
    pub(crate) fn messages_of(&self, record: &ServoRecord) -> u64 {
        let period = self.about.length.tick(record.period);
        let each = |every: u64| 2 * u64::from(period.is_multiple_of(every));
        1 + each(STATES) + each(FRAMES)
    }

    /// How long vision took, for the end.
    #[must_use]
    pub fn vision(&mut self) -> BTreeMap<String, String> {
        self.faces.sort_by(f64::total_cmp);
        let Some(median) = self.faces.get(self.faces.len() / 2) else { return BTreeMap::new() };
        let facts =
            [("faces", self.faces.len().to_string()), ("face_median_s", median.to_string())];
        facts.map(|(name, value)| (name.to_owned(), value)).into()
    }

    /// In which period of 2 ms a servo period is.
    #[must_use]
    pub(crate) fn tick_of(&self, period: u64) -> u64 {
        self.about.length.tick(period)
    }

    /// What stands at the beginning.
    ///
    /// # Errors
    /// What the device says, here and below.
    pub fn begin<W: Write + Seek>(&mut self, file: &mut File<W>) -> Done {
        file.metadata("rubik_robot", &self.about.facts)?;
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
        // A file that is cut off soon says at least whose it is.
        file.flush()
    }

    /// One servo record.
    ///
    /// # Errors
    /// What the device says.
    pub fn tick<W: Write + Seek>(&mut self, record: &ServoRecord, file: &mut File<W>) -> Done {
        let arm = usize::from(record.arm);
        let Some(topics) = self.arms.get(arm) else { return Ok(()) };
        let time = self.about.start + record.period * self.about.length.nanos();
        self.pen.put(file, (&topics.servo, Kind::ServoTick), time, |to| {
            tick::write(record, time, to);
        })?;
        self.joints[arm] = record.state.joints;
        self.openings[arm] = record.state.jaw_opening;
        let period = self.about.length.tick(record.period);
        if period.is_multiple_of(STATES) {
            self.states(arm, time, record, file)?;
        }
        if period.is_multiple_of(FRAMES) {
            self.frames(arm, time, record, file)?;
        }
        Ok(())
    }

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
            urdf::Variable::HalfOpening => 0.5 * record.state.jaw_opening,
        }));
        self.pen.put(file, ("/joint_states", Kind::JointState), time, |to| {
            standard::joint_state(to, time, &topics.joints, &self.positions);
        })?;
        self.pen.put(file, (&topics.wrench, Kind::Wrench), time, |to| {
            standard::wrench(to, time, &topics.frame, &record.state.wrench_in_tool);
        })
    }

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

    /// Anything else, at the beginning of a period of 2 ms.
    ///
    /// # Errors
    /// What the device says.
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
                let Ok(Found::Cube { world_from_cube, .. }) = &sensed.found else { return Ok(()) };
                pen.put(file, ("/cube/seen", Kind::Pose), time, |to| {
                    standard::pose(to, time, "world", world_from_cube);
                })
            }
            Entry::Picture(camera, image) => {
                let Some(topics) = self.cameras.get(*camera) else { return Ok(()) };
                self.jpeg.clear();
                let encoder =
                    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut self.jpeg, JPEG);
                if image.write_with_encoder(encoder).is_err() {
                    return Ok(());
                }
                pen.put(file, (&topics.image, Kind::Picture), time, |to| {
                    standard::picture(to, time, &topics.frame, &self.jpeg);
                })
            }
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
            Entry::Facts(name, facts) => file.metadata(name, &facts.iter().cloned().collect()),
        }
    }

    /// The cube where it is in the plant, and its colours when they change.
    fn scene<W: Write + Seek>(&mut self, time: u64, scene: &Scene, file: &mut File<W>) -> Done {
        let place = [("world", "cube", scene.cube.world_from_cube)];
        self.pen.put(file, ("/tf", Kind::Transforms), time, |to| {
            standard::transforms(to, time, place.into_iter());
        })?;
        let truth = belief::letters(scene.cube.facelets.iter().map(|c| Some(*c)));
        if truth == self.truth {
            return Ok(());
        }
        self.truth = truth;
        self.known(time, file)
    }

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
        let mut known = belief::known(now, &self.names);
        known.truth.clone_from(&self.truth);
        if known == self.cube {
            return Ok(());
        }
        self.cube = known;
        self.known(time, file)
    }

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
    /// Writes the message that `fill` makes to a topic of this kind.
    fn put<W: Write + Seek>(
        &mut self,
        file: &mut File<W>,
        (topic, kind): (&str, Kind),
        time: u64,
        fill: impl FnOnce(&mut Writer),
    ) -> Done {
        let mut writer = Writer::new(std::mem::take(&mut self.buffer));
        fill(&mut writer);
        self.buffer = writer.bytes();
        file.message(topic, kind, time, &self.buffer)?;
        self.messages += 1;
        Ok(())
    }
}
