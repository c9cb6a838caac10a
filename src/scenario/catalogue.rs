//! The tasks that a scenario can name: their declarations.
//!
//! A scenario does not know the tasks. It gets their declarations in a [`Catalogue`], each with the
//! section of the task's own keys.
//!
//! - in: declarations
//! - out: the declaration of the task that a scenario names; the keys of all tasks

use super::config::ControllerConfig;
use super::declared::{ChosenSensor, Keys, Properties, SensorDeclaration, TaskSections};
use super::maker::Maker;
use super::section::Reader;
use crate::generators::own::Library;
use crate::kernel::programme::Programmes;
use std::any::Any;
use std::fmt;
use std::sync::Arc;

/// Declaration of a task.
pub trait Declaration: Send + Sync {
    /// Returns the word that names the task in a scenario.
    fn name(&self) -> &'static str;
    /// Returns the name of the section of its keys. Tasks with the same keys may share a section.
    fn section(&self) -> &'static str;
    /// Returns the keys with their defaults.
    fn defaults(&self) -> Box<dyn Keys>;
    /// Returns the properties of the task.
    fn properties(&self) -> Properties;
    /// Checks whether the cell has what the task needs, and whether its keys agree with the rest of
    /// the scenario. It may change keys that the user has not given. Faults go to `reader`.
    fn check(&self, keys: &mut dyn Keys, config: &ControllerConfig, reader: &mut Reader);
    /// Returns the declaration as a value whose type can be found out, for the run that performs
    /// the task.
    fn as_any(&self) -> &dyn Any;
}

/// Declarations of all tasks and sensors that a program knows, and the programmes of its ECPs.
#[derive(Clone, Default)]
pub struct Catalogue {
    tasks: Vec<Arc<dyn Declaration>>,
    /// Sensors beside those of the cube and the wrists.
    pub sensors: Vec<Arc<dyn SensorDeclaration>>,
    /// Programmes that ECPs can carry out.
    pub programmes: Programmes,
    /// Generators that are registered by name.
    pub generators: Library,
    /// Name and version of the program; its tasks are those of the catalogue.
    pub program: Maker,
    /// Whether the scenarios are those of recordings, whose runs write no file.
    pub replays: bool,
}

impl fmt::Debug for Catalogue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.names()).finish()
    }
}

impl Catalogue {
    /// Adds a task; one of the same name is replaced.
    pub fn declare(&mut self, task: Arc<dyn Declaration>) {
        self.tasks.retain(|known| known.name() != task.name());
        self.tasks.push(task);
    }

    /// Returns the task with this name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<&Arc<dyn Declaration>> {
        self.tasks.iter().find(|task| task.name() == name)
    }

    /// Returns the sensor that `[[vsp]]` names by this word.
    #[must_use]
    pub fn sensor(&self, name: &str) -> Option<ChosenSensor> {
        self.sensors.iter().find(|sensor| sensor.name() == name).cloned().map(ChosenSensor::new)
    }

    /// Returns the names of all tasks, in the order of their declaration.
    #[must_use]
    pub fn names(&self) -> Vec<&'static str> {
        self.tasks.iter().map(|task| task.name()).collect()
    }

    /// Returns name, version and tasks of the program.
    #[must_use]
    pub fn maker(&self) -> Maker {
        let tasks = self.names().into_iter().map(str::to_owned).collect();
        Maker { tasks, ..self.program.clone() }
    }

    /// Returns the sections of all tasks and sensors, each once, with the defaults of their keys.
    #[must_use]
    pub(super) fn sections(&self) -> TaskSections {
        let mut sections: Vec<(&'static str, Box<dyn Keys>)> = Vec::new();
        for task in &self.tasks {
            if !sections.iter().any(|(name, _)| *name == task.section()) {
                sections.push((task.section(), task.defaults()));
            }
        }
        for sensor in &self.sensors {
            if !sections.iter().any(|(name, _)| *name == sensor.name()) {
                sections.push((sensor.name(), sensor.defaults()));
            }
        }
        TaskSections(sections)
    }
}

/// Task that a scenario names, and the program that has read the scenario.
#[derive(Clone)]
pub struct ChosenTask(Arc<dyn Declaration>, Maker);

impl ChosenTask {
    /// Makes the choice of this task.
    #[must_use]
    pub(super) fn new(task: Arc<dyn Declaration>, program: Maker) -> Self {
        Self(task, program)
    }

    /// Returns name, version and tasks of the program.
    #[must_use]
    pub fn program(&self) -> &Maker {
        &self.1
    }

    /// Returns the declaration of the task.
    #[must_use]
    pub fn declaration(&self) -> &dyn Declaration {
        self.0.as_ref()
    }
}

impl PartialEq for ChosenTask {
    fn eq(&self, other: &Self) -> bool {
        self.0.name() == other.0.name()
    }
}

impl fmt::Debug for ChosenTask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.0.name())
    }
}
