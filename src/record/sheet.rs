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
//! Metadata `rubik_robot` holds version, build, seed, task; `options` what overruled the scenario, `summary` and `timing`
//! come at the end. The scenario is attached as `scenario.toml`.

use super::belief;
use super::cdr::Writer;
use super::file::{File, Unwritten};
use super::recorder::Entry;
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
    /// When period 0 begins [ns]: 0 on the virtual clock, since 1970 on the wall's.
    pub start: u64,
    /// Length of a servo period.
    pub length: Length,
}

/// Where what comes is written.
pub struct Sheet {
    about: About,
    model: Model,
    buffer: Vec<u8>,
    messages: u64,
    joints: Vec<JointPositions>,
    openings: Vec<f64>,
    topics: Vec<ArmTopics>,
    belief: Option<Picture>,
    truth: String,
    cube: super::recorder::CubeKnown,
}

struct ArmTopics {
    servo: String,
    wrench: String,
    tool: String,
    frame: String,
    joints: Vec<(String, urdf::JointKind)>,
}

type Done = Result<(), Unwritten>;

impl Sheet {
    /// For a run.
    #[must_use]
    pub fn new(about: About) -> Self {
        let cell = &about.cell;
        let model = Model::of(cell, None, true);
        let topics = cell.arms.iter().enumerate().map(|(index, arm)| {
            let own = |joint: &&urdf::Joint| joint.kind.drive().is_some_and(|d| d.by.0 == index);
            let joints = model.joints.iter().filter(own).map(|j| (j.name.clone(), j.kind));
            ArmTopics {
                servo: format!("/{}/servo", arm.name),
                wrench: format!("/{}/wrench", arm.name),
                tool: format!("/{}/tool", arm.name),
                frame: format!("{}_tool", arm.name),
                joints: joints.collect(),
            }
        });
        Self {
            topics: topics.collect(),
            joints: cell.arms.iter().map(|arm| arm.start).collect(),
            openings: vec![0.0; cell.arms.len()],
            buffer: Vec::with_capacity(1024),
            messages: 0,
            belief: None,
            truth: String::new(),
            cube: super::recorder::CubeKnown::default(),
            model,
            about,
        }
    }

    /// Messages written so far.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// In which period of 2 ms a servo period is.
    #[must_use]
    pub fn tick_of(&self, period: u64) -> u64 {
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
        self.put(file, "/robot_description", Kind::Text, start, |to| {
            standard::text(to, &description);
        })?;
        let model = self.model.clone();
        let fixed: Vec<_> = model.fixed().collect();
        self.put(file, "/tf_static", Kind::Transforms, start, |to| {
            standard::transforms(to, start, &fixed);
        })?;
        for camera in self.about.cell.cameras.clone() {
            let (topic, frame) =
                (format!("/{}/info", camera.name), format!("{}_optical", camera.name));
            self.put(file, &topic, Kind::CameraInfo, start, |to| {
                standard::camera_info(to, start, &frame, &camera.intrinsics);
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
        if arm >= self.topics.len() {
            return Ok(());
        }
        let time = self.about.start + record.period * self.about.length.nanos();
        let topic = std::mem::take(&mut self.topics[arm].servo);
        let done =
            self.put(file, &topic, Kind::ServoTick, time, |to| tick::write(record, time, to));
        self.topics[arm].servo = topic;
        done?;
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
        let topics = &self.topics[arm];
        let names: Vec<String> = topics.joints.iter().map(|(name, _)| name.clone()).collect();
        let positions: Vec<f64> = topics
            .joints
            .iter()
            .filter_map(|(_, kind)| {
                Some(match kind.drive()?.by.1 {
                    urdf::Variable::Joint(index) => record.state.joints.0[index],
                    urdf::Variable::HalfOpening => 0.5 * record.state.jaw_opening,
                })
            })
            .collect();
        let (topic, frame) = (topics.wrench.clone(), topics.frame.clone());
        self.put(file, "/joint_states", Kind::JointState, time, |to| {
            standard::joint_state(to, time, &names, &positions);
        })?;
        self.put(file, &topic, Kind::Wrench, time, |to| {
            standard::wrench(to, time, &frame, &record.state.wrench_in_tool);
        })
    }

    fn frames<W: Write + Seek>(
        &mut self,
        arm: usize,
        time: u64,
        record: &ServoRecord,
        file: &mut File<W>,
    ) -> Done {
        let model = std::mem::replace(
            &mut self.model,
            Model { name: String::new(), links: vec![], joints: vec![] },
        );
        let (joints, openings) = (self.joints.clone(), self.openings.clone());
        let own = format!("{}_", self.about.cell.arms[arm].name);
        let moving: Vec<_> = model
            .moving(&joints, &openings)
            .filter(|(_, child, _)| child.starts_with(&own))
            .collect();
        let done = self.put(file, "/tf", Kind::Transforms, time, |to| {
            standard::transforms(to, time, &moving);
        });
        drop(moving);
        self.model = model;
        done?;
        let world_from_tool =
            self.about.cell.arms[arm].world_from_base * record.state.base_from_tool;
        let topic = self.topics[arm].tool.clone();
        self.put(file, &topic, Kind::Pose, time, |to| {
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
        match entry {
            Entry::Log(level, name, text) => self.put(file, "/rosout", Kind::Log, time, |to| {
                standard::log(to, time, *level, name, text);
            }),
            Entry::Phase(name, outcome) => self.put(file, "/phase", Kind::TaskPhase, time, |to| {
                to.time(time);
                to.string(name);
                to.string(outcome);
            }),
            Entry::Sensed(sensed) => {
                self.put(file, "/sensed", Kind::Sensed, time, |to| sensed.write(time, to))?;
                let Ok(Found::Cube { world_from_cube, .. }) = &sensed.found else { return Ok(()) };
                self.put(file, "/cube/seen", Kind::Pose, time, |to| {
                    standard::pose(to, time, "world", world_from_cube);
                })
            }
            Entry::Picture(camera, image) => {
                let Some(camera) = self.about.cell.cameras.get(*camera) else { return Ok(()) };
                let (topic, frame) =
                    (format!("/{}/image", camera.name), format!("{}_optical", camera.name));
                let mut jpeg = Vec::with_capacity(64 * 1024);
                let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, JPEG);
                if image.write_with_encoder(encoder).is_err() {
                    return Ok(());
                }
                self.put(file, &topic, Kind::Picture, time, |to| {
                    standard::picture(to, time, &frame, &jpeg);
                })
            }
            Entry::Scene(scene) => self.scene(time, scene, file),
            Entry::Operator(command) => self.put(file, "/operator", Kind::Operator, time, |to| {
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
        self.put(file, "/tf", Kind::Transforms, time, |to| {
            standard::transforms(to, time, &place);
        })?;
        let truth = belief::letters(scene.cube.facelets.iter().map(|c| Some(*c)));
        if truth == self.truth {
            return Ok(());
        }
        self.truth = truth;
        self.known(time, file)
    }

    fn belief<W: Write + Seek>(&mut self, time: u64, now: &Picture, file: &mut File<W>) -> Done {
        let before = self.belief.replace(now.clone());
        if before.as_ref() == Some(now) {
            return Ok(());
        }
        let text = belief::json(now);
        self.put(file, "/belief", Kind::Text, time, |to| standard::text(to, &text))?;
        if before.is_none_or(|before| before.plan != now.plan) && !now.plan.is_empty() {
            self.put(file, "/plan", Kind::Plan, time, |to| belief::write_plan(now, time, to))?;
        }
        let names: Vec<_> = self.about.cell.arms.iter().map(|arm| arm.name.clone()).collect();
        let mut known = belief::known(now, &names);
        known.truth.clone_from(&self.truth);
        if known == self.cube {
            return Ok(());
        }
        self.cube = known;
        self.known(time, file)
    }

    fn known<W: Write + Seek>(&mut self, time: u64, file: &mut File<W>) -> Done {
        self.cube.truth.clone_from(&self.truth);
        let known = self.cube.clone();
        self.put(file, "/cube", Kind::CubeState, time, |to| {
            to.time(time);
            to.string(&known.identified);
            to.f64_sequence(&known.confidences);
            to.string(&known.believed);
            to.string(&known.truth);
            to.string_sequence(&known.holders);
        })
    }

    fn put<W: Write + Seek>(
        &mut self,
        file: &mut File<W>,
        topic: &str,
        kind: Kind,
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
