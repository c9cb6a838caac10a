//! The traits of a user's own sensor: the kernel of its VSP, and the model of its device in the
//! simulated plant.
//!
//! - in: keys of the scenario; measurements of the device; the true scene, for the model alone
//! - out: readings, which the kernels of MP and ECPs get
//!
//! The kernel cannot see the plant: in simulation its device is replaced by the model, on hardware
//! by the real one, and both give it the same type of measurement.

use super::device::{Device, DeviceFaults, FaultyDevice};
use crate::hw::scene::Scene;
use crate::kernel::sensor::SensorKernel;
use crate::motion::ArmState;
use crate::scenario::ControllerConfig;
use crate::scenario::declared::{Keys, SensorDeclaration};
use crate::scenario::section::Section;
use serde::Serialize;
use serde_json::Value;
use std::any::{Any, TypeId};
use std::fmt::{self, Debug};
use std::sync::Arc;

/// Kernel of a VSP: it makes readings of the measurements of a device.
pub trait Sensor: Send + Sized + 'static {
    /// Keys of the sensor, which the macro [`section!`](crate::section) declares. Their section in
    /// a scenario has the registered name of the sensor.
    type Keys: Section + Clone + Debug + Send + Sync + 'static;
    /// Result of the device; `()` for a sensor that needs the states of the arms alone.
    type Measurement: Clone + Send + 'static;
    /// Reading for the kernels of MP and ECPs; plain data.
    type Reading: Serialize;

    /// Makes the kernel.
    ///
    /// # Errors
    /// The reason why these keys allow no sensor.
    fn new(keys: &Self::Keys) -> Result<Self, String>;

    /// Makes the kernel for a cell: by default as [`Sensor::new`], which knows the keys alone.
    ///
    /// # Errors
    /// As [`Sensor::new`].
    fn in_cell(keys: &Self::Keys, config: &ControllerConfig) -> Result<Self, String> {
        let _ = config;
        Self::new(keys)
    }

    /// Opens the real device for a cell: by default as [`Sensor::device`].
    ///
    /// # Errors
    /// As [`Sensor::device`].
    fn device_in_cell(
        keys: &Self::Keys,
        config: &ControllerConfig,
    ) -> Result<Box<dyn Device<Self::Measurement>>, String> {
        let _ = config;
        Self::device(keys)
    }

    /// Opens the real device. A simulated run with a model does not call this.
    ///
    /// # Errors
    /// The reason why the device cannot be opened.
    fn device(keys: &Self::Keys) -> Result<Box<dyn Device<Self::Measurement>>, String>;

    /// Makes a reading. `arms` are the latest states of the effectors, in the scenario's order.
    ///
    /// # Errors
    /// The reason why this measurement gives no reading.
    fn reading(
        &mut self,
        measured: Self::Measurement,
        arms: &[ArmState],
    ) -> Result<Self::Reading, String>;
}

/// Model of a device in the simulated plant.
pub trait DeviceModel: Send + Sized + 'static {
    /// Sensor whose device it models.
    type Sensor: Sensor;

    /// Makes the model. `seed` is that of the scenario, from which all its errors follow.
    fn new(keys: &<Self::Sensor as Sensor>::Keys, seed: u64) -> Self;

    /// Measures in the true scene.
    ///
    /// # Errors
    /// The reason why there is no measurement.
    fn measure(&mut self, scene: &Scene) -> Result<<Self::Sensor as Sensor>::Measurement, String>;
}

/// Latest true scene of the simulated plant, for the model of a device.
pub type Scenes = triple_buffer::Output<Scene>;

/// Parts of the simulated plant that a sensor gets.
pub struct Simulation {
    /// Seed of the model's errors.
    pub seed: u64,
    /// True scene for the model of the device.
    pub scenes: Scenes,
    /// Flags of the faults that the scenario injects into the device; `None` without any.
    pub faults: Option<Arc<DeviceFaults>>,
}

/// Device that a model simulates.
struct Simulated<D> {
    model: D,
    scenes: Scenes,
}

impl<D: DeviceModel> Device<<D::Sensor as Sensor>::Measurement> for Simulated<D> {
    fn measure(&mut self, _: u64) -> Result<<D::Sensor as Sensor>::Measurement, String> {
        self.model.measure(self.scenes.read())
    }
}

/// Kernel of a sensor with its device.
struct Fitted<S: Sensor> {
    sensor: S,
    device: Box<dyn Device<S::Measurement>>,
}

impl<S: Sensor> SensorKernel for Fitted<S> {
    fn measure(&mut self, period: u64, arms: &[ArmState]) -> Result<Value, String> {
        let measured = self.device.measure(period)?;
        let reading = self.sensor.reading(measured, arms)?;
        serde_json::to_value(reading).map_err(|why| why.to_string())
    }
}

/// Makes the kernel of a sensor with a device that may have injected faults.
fn fitted<S: Sensor>(
    (keys, config): (&S::Keys, &ControllerConfig),
    device: Box<dyn Device<S::Measurement>>,
    faults: Option<Arc<DeviceFaults>>,
) -> Result<Box<dyn SensorKernel>, String> {
    let device = match faults {
        Some(faults) => Box::new(FaultyDevice::new(device, faults)),
        None => device,
    };
    Ok(Box::new(Fitted::<S> { sensor: S::in_cell(keys, config)?, device }))
}

/// Makes the kernel of a sensor with its real device, into which faults may be injected.
type MakeReal = fn(
    &SensorEntry,
    &ControllerConfig,
    Option<Arc<DeviceFaults>>,
) -> Result<Box<dyn SensorKernel>, String>;
/// Makes the kernel of a sensor with the model of its device.
type MakeSimulated =
    fn(&SensorEntry, &ControllerConfig, Simulation) -> Result<Box<dyn SensorKernel>, String>;

/// A registered sensor with its type erased.
#[derive(Clone)]
pub struct SensorEntry {
    name: &'static str,
    /// Type of the sensor.
    of: TypeId,
    defaults: fn() -> Box<dyn Keys>,
    real: MakeReal,
    simulated: Option<MakeSimulated>,
}

impl fmt::Debug for SensorEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let simulated = self.simulated.is_some();
        let mut entry = f.debug_struct("SensorEntry");
        entry.field("name", &self.name).field("simulated", &simulated).finish_non_exhaustive()
    }
}

impl SensorEntry {
    /// Makes the entry of a sensor that scenarios call `name`, without a model of its device.
    pub(super) fn of<S: Sensor>(name: &'static str) -> Self {
        Self {
            name,
            of: TypeId::of::<S>(),
            defaults: || Box::new(S::Keys::default()),
            real: |entry, config, faults| {
                let keys = entry.keys::<S>(config);
                fitted::<S>((&keys, config), S::device_in_cell(&keys, config)?, faults)
            },
            simulated: None,
        }
    }

    /// Returns whether this is the sensor `S`.
    pub(super) fn is<S: Sensor>(&self) -> bool {
        self.of == TypeId::of::<S>()
    }

    /// Gives the sensor a model of its device.
    pub(super) fn simulated_by<D: DeviceModel>(&mut self) {
        self.simulated = Some(|entry, config, Simulation { seed, scenes, faults }| {
            let keys = entry.keys::<D::Sensor>(config);
            let device = Simulated { model: D::new(&keys, seed), scenes };
            fitted::<D::Sensor>((&keys, config), Box::new(device), faults)
        });
    }

    /// Returns the entry of a declared sensor; `None` if no registry made the declaration.
    #[must_use]
    pub fn of_declaration(declaration: &dyn SensorDeclaration) -> Option<&Self> {
        declaration.as_any().downcast_ref()
    }

    /// Returns the keys of this sensor in a scenario, or else the defaults.
    fn keys<S: Sensor>(&self, config: &ControllerConfig) -> S::Keys {
        config.sections.get::<S::Keys>(self.name).cloned().unwrap_or_default()
    }

    /// Makes the kernel with its device: the model, if there is one and the run is a `simulation`;
    /// or else the real device.
    ///
    /// # Errors
    /// The reason why the sensor or its device cannot be made.
    pub fn kernel(
        &self,
        config: &ControllerConfig,
        simulation: Option<Simulation>,
    ) -> Result<Box<dyn SensorKernel>, String> {
        match (self.simulated, simulation) {
            (Some(make), Some(simulation)) => make(self, config, simulation),
            (_, simulation) => (self.real)(self, config, simulation.and_then(|s| s.faults)),
        }
    }
}

impl SensorDeclaration for SensorEntry {
    fn name(&self) -> &'static str {
        self.name
    }

    fn defaults(&self) -> Box<dyn Keys> {
        (self.defaults)()
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
