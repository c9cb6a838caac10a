//! The wrist force: from what the sensor feels to what the tool exerts on its surroundings.
//!
//! - in: the wrench on the sensor, the orientation of the flange, the believed weight beyond the sensor
//! - out: the wrench of the tool on its surroundings, about the tool point, in tool axes
//! - source: force transformation and bias of the original's sources; mean of two samples

use crate::cell::ForceSensor;
use crate::motion::ArmFault;
use crate::spatial::{Pose, Wrench};
use nalgebra::{Point3, Vector3};

/// A wrist sensor with its filter, its zero and what hangs on it.
#[derive(Debug, Clone, PartialEq)]
pub struct WristForce {
    sensor: ForceSensor,
    /// Load in the gripper: weight [N] and centre in the flange frame [m].
    payload: (f64, Point3<f64>),
    /// Zero of the sensor, in its frame.
    bias: Wrench,
    /// The last sample, weight removed, for the mean of two.
    last: Option<Wrench>,
    /// Sum and count of the samples of a new zero.
    biasing: Option<(Wrench, u32)>,
}

impl WristForce {
    /// Samples in a zero.
    pub const BIAS_SAMPLES: u32 = 10;

    /// With zero bias and nothing in the gripper.
    #[must_use]
    pub fn new(sensor: ForceSensor) -> Self {
        Self {
            sensor,
            payload: (0.0, Point3::origin()),
            bias: Wrench::default(),
            last: None,
            biasing: None,
        }
    }

    /// What the tool exerts on its surroundings: mean of this and the last sample less weight and zero,
    /// moved to the tool point and negated. Not finite while the sensor is silent.
    pub fn read(
        &mut self,
        wrench_on_sensor: &Wrench,
        base_from_flange: &Pose,
        flange_from_tool: &Pose,
    ) -> Wrench {
        let sample = *wrench_on_sensor - self.weight_on_sensor(base_from_flange);
        if sample.is_finite() {
            self.count_towards_bias(&sample);
        }
        let last = self.last.unwrap_or(sample);
        self.last = sample.is_finite().then_some(sample);
        let mean = Wrench {
            force: 0.5 * (sample.force + last.force),
            torque: 0.5 * (sample.torque + last.torque),
        };
        let tool_from_sensor = flange_from_tool.inverse() * self.sensor.flange_from_sensor;
        -(mean - self.bias).moved(&tool_from_sensor)
    }

    /// Starts a new zero from the next [`WristForce::BIAS_SAMPLES`] samples.
    pub fn start_bias(&mut self) {
        self.biasing = Some((Wrench::default(), 0));
    }

    /// What hangs in the gripper: weight [N] and centre in the flange frame [m].
    pub fn set_payload(&mut self, weight: f64, centre: Point3<f64>) {
        self.payload = (weight, centre);
        // The last sample was taken with the old belief.
        self.last = None;
    }

    /// What makes this reading unfit for force control.
    #[must_use]
    pub fn fault(&self, wrench_on_sensor: &Wrench) -> Option<ArmFault> {
        let components = wrench_on_sensor.directions();
        (0..6)
            // Not below also catches what is not a number.
            .find(|&i| !(components[i].abs() < self.sensor.range[i]))
            .map(|direction| ArmFault::ForceSensor { direction, reading: components[direction] })
    }

    /// Weight of the tool and of the payload, as the sensor feels it.
    fn weight_on_sensor(&self, base_from_flange: &Pose) -> Wrench {
        let down = base_from_flange.rotation.inverse() * -Vector3::z();
        let hanging = |weight: f64, centre: &Point3<f64>| {
            let force = weight * down;
            Wrench { force, torque: centre.coords.cross(&force) }
        };
        let in_flange = hanging(self.sensor.weight, &self.sensor.centre_in_flange)
            + hanging(self.payload.0, &self.payload.1);
        in_flange.moved(&self.sensor.flange_from_sensor.inverse())
    }

    fn count_towards_bias(&mut self, sample: &Wrench) {
        let Some((sum, count)) = self.biasing else { return };
        let (sum, count) = (sum + *sample, count + 1);
        self.biasing = Some((sum, count));
        if count == Self::BIAS_SAMPLES {
            let share = 1.0 / f64::from(count);
            self.bias = Wrench { force: share * sum.force, torque: share * sum.torque };
            self.biasing = None;
        }
    }
}
