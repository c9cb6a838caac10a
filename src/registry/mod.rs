//! The door by which a task enters the program: its keys, its kernel, its verdict.
//!
//! - in: types that implement [`Task`] and [`Verdict`], from this crate or another one
//! - out: a [`Registry`], and from it the [`Catalogue`] with which scenarios are read
//!
//! The kernel of a task knows the controller's half of a scenario alone. A verdict knows the plant,
//! and the files that the task wrote. So a task can neither see the truth nor judge itself.

mod device;
mod entry;
mod sensor;
mod task;
mod verdict;

pub use device::{Device, DeviceFault, DeviceFaults, NoDevice};
pub use entry::{Judge, Logbook, Registered, TaskEntry};
pub use sensor::{DeviceModel, Scenes, Sensor, SensorEntry, Simulation};
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hw::scene::Scene;
    use crate::motion::ArmState;

    crate::section! {
        /// Keys of the sensors of the test.
        Keys {
            /// Unused.
            size [mm]: f64 = 1.0, 0.0..=2.0;
        }
    }

    /// Sensor whose type has a number.
    struct Numbered<const N: usize>;

    impl<const N: usize> Sensor for Numbered<N> {
        type Keys = Keys;
        type Measurement = ();
        type Reading = ();

        fn new(_: &Keys) -> Result<Self, String> {
            Ok(Self)
        }

        fn device(_: &Keys) -> Result<Box<dyn Device<()>>, String> {
            Ok(Box::new(NoDevice))
        }

        fn reading(&mut self, (): (), _: &[ArmState]) -> Result<(), String> {
            Ok(())
        }
    }

    /// Model of the device of the first sensor.
    struct Model;

    impl DeviceModel for Model {
        type Sensor = Numbered<1>;

        fn new(_: &Keys, _: u64) -> Self {
            Self
        }

        fn measure(&mut self, _: &Scene) -> Result<(), String> {
            Ok(())
        }
    }

    #[test]
    fn model_belongs_to_sensor_of_its_type() {
        let registry =
            Registry::default().sensor::<Numbered<1>>("one").sensor::<Numbered<2>>("two");
        let registry = registry.simulated::<Model>();

        let texts: Vec<String> = registry.sensors.iter().map(|s| format!("{s:?}")).collect();
        assert!(texts[0].contains("simulated: true"), "{texts:?}");
        assert!(texts[1].contains("simulated: false"), "{texts:?}");
    }
}
