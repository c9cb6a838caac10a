//! The verdict on a task, by the truth of the plant, and by the files that the task wrote.
//!
//! - in: the keys of the task; the facts of the plant at the beginning and at the end
//! - out: how the plant begins; whether the task is done, in words and figures

use super::task::Task;
use crate::cube::Facelets;
use crate::hw::plant::{self, Plant};
use crate::hw::scene::Scene;
use crate::kernel::Document;
use crate::reach::{Meeting, MeetingTable};
use crate::scenario::ControllerConfig;
use crate::spatial::Pose;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;

/// Judge of a task in one run. It sees the plant, and of the controller nothing but the result that
/// the task has reported.
pub trait Verdict: Default + Send + 'static {
    /// The task.
    type Task: Task;
    /// Time that the world needs after a success before it can be judged (s), such as that of a
    /// person who withdraws a hand.
    const SETTLES: f64 = 0.0;

    /// Returns how the plant begins, if not as the scenario says.
    ///
    /// # Errors
    /// The reason why the cell allows no such beginning.
    fn beginning(
        keys: &<Self::Task as Task>::Keys,
        config: &ControllerConfig,
        meetings: Option<&MeetingTable>,
    ) -> Result<Option<Beginning>, String> {
        let _ = (keys, config, meetings);
        Ok(None)
    }

    /// Looks at the plant after a servo period. `tick` is the time in periods of 2 ms.
    fn watch(&mut self, tick: u64, plant: &Plant) {
        let _ = (tick, plant);
    }

    /// Judges the plant at the end of the run.
    fn judge(&self, keys: &<Self::Task as Task>::Keys, truth: &Truth) -> Judgement;
}

/// Beginning of a plant in which a hand holds the cube.
#[derive(Debug, Clone)]
pub struct Beginning {
    /// Joint positions of both arms: the second one holds the cube at this meeting, the first one
    /// is retracted from it.
    pub meeting: Meeting,
    /// Pose of the cube in the second hand.
    pub tool_from_cube: Pose,
}

/// Facts of a plant at the end of a run.
#[derive(Debug, Clone)]
pub struct Truth {
    /// Cube at the beginning.
    pub start: Facelets,
    /// Distance of the nearest tool from the cube's centre at the beginning (m).
    pub clearance: f64,
    /// Checksum of the plant's limits of speed and force.
    pub bounds: u32,
    /// Whether the cube was falling at the beginning, as in the saved plant of a run that ended in
    /// a power cut.
    pub falls_at_start: bool,
    /// State and history of the plant.
    pub verdict: plant::Verdict,
    /// Number of jammed turns.
    pub jams: u32,
    /// Figures that the task has reported, by name: what it claims. A judge of a measurement
    /// compares them with the plant.
    pub reported: BTreeMap<String, Value>,
    /// Text files that the task has made. They are its result, as the plant's state is.
    pub documents: Vec<Document>,
    /// Plant before the first period.
    pub scene_at_start: Scene,
    /// Plant at the end.
    pub scene_at_end: Scene,
}

impl Truth {
    /// Returns the colours of the plant's cube at the end.
    #[must_use]
    pub fn end(&self) -> Facelets {
        Facelets::try_from(self.verdict.facelets).unwrap_or(self.start)
    }

    /// Returns the pose of each tool in the world at the beginning and at the end, in the
    /// scenario's order.
    #[must_use]
    pub fn tools(&self) -> Vec<(Pose, Pose)> {
        let tools = |scene: &Scene| -> Vec<Pose> {
            scene.arms.iter().take(scene.arm_count).map(|arm| arm.world_from_tool).collect()
        };
        tools(&self.scene_at_start).into_iter().zip(tools(&self.scene_at_end)).collect()
    }
}

/// Judgement on a task.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Judgement {
    /// Whether the task is done.
    pub right: bool,
    /// State of the plant, in words.
    pub words: String,
    /// Figures for the summary, by name.
    pub figures: BTreeMap<String, Value>,
}

impl Judgement {
    /// Makes a judgement without figures. `words` say what the plant shows.
    #[must_use]
    pub fn new(right: bool, words: impl Into<String>) -> Self {
        Self { right, words: words.into(), figures: BTreeMap::new() }
    }

    /// Returns the judgement with one more figure, which must have a form in JSON.
    #[must_use]
    pub fn with(mut self, name: &str, figure: impl Serialize) -> Self {
        let figure = serde_json::to_value(figure).unwrap_or_default();
        self.figures.insert(name.to_owned(), figure);
        self
    }
}
