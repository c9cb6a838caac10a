//! The keys and properties of tasks, and the sensors of a user's own, as the rest of a scenario
//! knows them.

use super::keys::Coordination;
use super::section::{Key, Reader, Section};
use super::tree::Node;
use crate::cell::MOST_ARMS;
use std::any::Any;
use std::fmt;
use std::sync::Arc;

/// Keys of a task, of any type.
pub trait Keys: fmt::Debug + Send + Sync {
    /// Overwrites the values of the keys that `node` contains; the others keep their values.
    fn overlay(&mut self, node: &Node, path: &str, reader: &mut Reader);
    /// Appends the keys to `into`, with their present values as defaults. `path` is the dotted name
    /// of the section.
    fn keys(&self, path: &str, into: &mut Vec<Key>);
    /// Returns a copy.
    fn copy(&self) -> Box<dyn Keys>;
    /// Returns the keys as a value whose type can be found out.
    fn as_any(&self) -> &dyn Any;
    /// Returns the keys as a value that can be changed once its type is found out.
    fn as_any_mut(&mut self) -> &mut dyn Any;
}

impl<T: Section + Clone + fmt::Debug + Send + Sync + 'static> Keys for T {
    fn overlay(&mut self, node: &Node, path: &str, reader: &mut Reader) {
        Section::overlay(self, node, path, reader);
    }

    fn keys(&self, path: &str, into: &mut Vec<Key>) {
        Section::keys(self, path, into);
    }

    fn copy(&self) -> Box<dyn Keys> {
        Box::new(self.clone())
    }

    fn as_any(&self) -> &dyn Any {
        self
    }

    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
}

/// Declaration of a user's own sensor.
pub trait SensorDeclaration: Send + Sync {
    /// Returns the word that names the sensor in `[[vsp]]`, and its section.
    fn name(&self) -> &'static str;
    /// Returns the keys with their defaults.
    fn defaults(&self) -> Box<dyn Keys>;
    /// Returns the declaration as a value whose type can be found out, for the run that uses the
    /// sensor.
    fn as_any(&self) -> &dyn Any;
}

/// Sensor of a user's own that a scenario names.
#[derive(Clone)]
pub struct ChosenSensor(Arc<dyn SensorDeclaration>);

impl ChosenSensor {
    /// Makes the choice of this sensor.
    #[must_use]
    pub(super) fn new(sensor: Arc<dyn SensorDeclaration>) -> Self {
        Self(sensor)
    }

    /// Returns the declaration of the sensor.
    #[must_use]
    pub fn declaration(&self) -> &dyn SensorDeclaration {
        self.0.as_ref()
    }
}

impl PartialEq for ChosenSensor {
    fn eq(&self, other: &Self) -> bool {
        self.0.name() == other.0.name()
    }
}

impl fmt::Debug for ChosenSensor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.0.name())
    }
}

/// Properties of a task that decide how a run begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools, reason = "properties that do not depend on each other")]
pub struct Properties {
    /// Whether a person, or the table, gives the robot the cube at the place of the hand-over. The
    /// cameras of a simulated cell are calibrated before such a task.
    pub hands_over: bool,
    /// Whether another run can continue the task from its journal.
    pub resumes: bool,
    /// Whether the operator moves the arms by hand, if there is one. The arms are not synchronised
    /// before, and only the operator ends the run.
    pub by_hand: bool,
    /// Whether the arms go from one meeting of the hands to the next, so that the quickest ways
    /// between the meetings are searched before the run.
    pub walks: bool,
    /// Least number of effectors that the task needs. A task may check more of them itself.
    pub effectors: usize,
    /// Greatest number of effectors that the task can do with.
    pub most_effectors: usize,
    /// Schemes of coordination under which the task can be done.
    pub coordination: &'static [Coordination],
}

impl Properties {
    /// Properties of a task without hand-over whose motions MP coordinates.
    pub const PLAIN: Self = Self {
        hands_over: false,
        resumes: false,
        by_hand: false,
        walks: false,
        effectors: 1,
        most_effectors: MOST_ARMS,
        coordination: &[Coordination::Sporadic, Coordination::Continuous],
    };
}

/// Sections of the tasks' keys, by name.
#[derive(Debug, Default)]
pub struct TaskSections(pub(super) Vec<(&'static str, Box<dyn Keys>)>);

impl Clone for TaskSections {
    fn clone(&self) -> Self {
        Self(self.0.iter().map(|(name, keys)| (*name, keys.copy())).collect())
    }
}

impl PartialEq for TaskSections {
    fn eq(&self, other: &Self) -> bool {
        self.listed() == other.listed()
    }
}

impl TaskSections {
    /// Returns the keys of the section with this name, if they are of the type `T`.
    #[must_use]
    pub fn get<T: 'static>(&self, name: &str) -> Option<&T> {
        let (_, keys) = self.0.iter().find(|(section, _)| *section == name)?;
        keys.as_ref().as_any().downcast_ref()
    }

    /// Returns the section with this name, to change it.
    pub(super) fn get_mut(&mut self, name: &str) -> Option<&mut Box<dyn Keys>> {
        self.0.iter_mut().find(|(section, _)| *section == name).map(|(_, keys)| keys)
    }

    /// Returns every key with its present value as its default.
    #[must_use]
    pub(super) fn listed(&self) -> Vec<Key> {
        let mut listed = Vec::new();
        for (name, keys) in &self.0 {
            keys.as_ref().keys(name, &mut listed);
        }
        listed
    }
}

/// Name and properties of the task of a run, for the parts of the controller that must not know
/// more of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TaskLabel {
    /// Word that names the task.
    name: &'static str,
    /// Properties of the task.
    pub properties: Properties,
}

impl TaskLabel {
    /// Makes the label of a task.
    #[must_use]
    pub(super) fn new(name: &'static str, properties: Properties) -> Self {
        Self { name, properties }
    }

    /// Returns the word that names the task in a scenario.
    #[must_use]
    pub fn word(&self) -> &'static str {
        self.name
    }
}
