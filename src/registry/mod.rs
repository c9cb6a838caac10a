//! The door by which a task enters the program: its keys, its kernel, its verdict.
//!
//! - in: types that implement [`Task`] and [`Verdict`], from this crate or another one
//! - out: a [`Registry`], and from it the [`Catalogue`] with which scenarios are read
//!
//! The kernel of a task knows the controller's half of a scenario alone. A verdict knows the plant
//! alone. So a task can neither see the truth nor judge itself.

mod entry;
mod sensor;
mod task;
mod verdict;

pub use entry::{Judge, Logbook, Registered, TaskEntry};
pub use sensor::{Device, DeviceModel, NoDevice, Scenes, Sensor, SensorEntry};
pub use task::{Earlier, EntryOf, Setup, Task};
pub use verdict::{Beginning, Judgement, Truth, Verdict};

use crate::generators::built_in;
use crate::generators::own::{Library, MotionGenerator};
use crate::kernel::programme::{EcpTask, Programmes};
use crate::scenario::catalogue::{Catalogue, Declaration as _};
use crate::scenario::declared::SensorDeclaration;
use std::sync::Arc;

/// Tasks of a program, in the order in which they are named to a user.
#[derive(Debug, Clone)]
pub struct Registry {
    tasks: Vec<TaskEntry>,
    sensors: Vec<SensorEntry>,
    programmes: Programmes,
    generators: Library,
}

impl Default for Registry {
    /// Returns the registry without tasks, with the generators of this crate.
    fn default() -> Self {
        let (tasks, programmes) = (Vec::new(), Programmes::default());
        Self { tasks, sensors: Vec::new(), programmes, generators: built_in::library() }
    }
}

impl Registry {
    /// Returns the registry with one more task, which scenarios call `name`; a task of the same
    /// name is replaced.
    #[must_use]
    pub fn task<T: Task>(mut self, name: &'static str) -> Self {
        self.tasks.retain(|task| task.name() != name);
        self.tasks.push(TaskEntry::of::<T>(name));
        self
    }

    /// Returns the registry with a judge of the task that was added last. Without one the task is
    /// believed.
    #[must_use]
    pub fn verdict<V: Verdict>(mut self) -> Self {
        if let Some(task) = self.tasks.last_mut() {
            task.judged_by::<V>();
        }
        self
    }

    /// Returns the registry with one more sensor, which `[[vsp]]` of a scenario names by
    /// `kind = "name"`; a sensor of the same name is replaced.
    #[must_use]
    pub fn sensor<S: Sensor>(mut self, name: &'static str) -> Self {
        self.sensors.retain(|sensor| SensorDeclaration::name(sensor) != name);
        self.sensors.push(SensorEntry::of::<S>(name));
        self
    }

    /// Returns the registry with a model of the device of a sensor that was added before. Without
    /// one a simulated run uses the real device.
    #[must_use]
    pub fn simulated<D: DeviceModel>(mut self) -> Self {
        let modelled = |sensor: &&mut SensorEntry| sensor.is::<D::Sensor>();
        self.sensors.iter_mut().filter(modelled).for_each(SensorEntry::simulated_by::<D>);
        self
    }

    /// Returns the registry with one more programme of an ECP, which kernels of MP start by `name`.
    #[must_use]
    pub fn programme<P: EcpTask>(mut self, name: &'static str) -> Self {
        self.programmes.register::<P>(name);
        self
    }

    /// Returns the registry with one more motion generator, which tasks order by `name`; one of the
    /// same name is replaced.
    #[must_use]
    pub fn generator<G: MotionGenerator>(mut self, name: &'static str) -> Self {
        self.generators = self.generators.with::<G>(name);
        self
    }

    /// Returns the declarations with which scenarios are read.
    #[must_use]
    pub fn catalogue(&self) -> Catalogue {
        let mut catalogue = Catalogue::default();
        catalogue.programmes = self.programmes.clone();
        catalogue.generators = self.generators.clone();
        for task in &self.tasks {
            catalogue.declare(Arc::new(task.clone()));
        }
        for sensor in &self.sensors {
            catalogue.sensors.push(Arc::new(sensor.clone()));
        }
        catalogue
    }
}
