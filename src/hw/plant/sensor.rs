//! The six-component sensor in a wrist, as it reports: weight of the tool, contact, bias, drift, noise.
//!
//! - in: the wrench on the tool at the tool point, the wrist's orientation
//! - out: the reading in the sensor's frame, late, in steps, clipped to the range

use super::config::SensorNoise;
use super::frame::Frame;
use crate::cell::ForceSensor;
use crate::servo::period::Length;
use crate::spatial::Wrench;
use nalgebra::Vector3;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// Longest delay that is kept (periods).
const LATEST: usize = 128;

#[derive(Debug, Clone)]
pub(super) struct WristSensor {
    sensor: ForceSensor,
    flange_from_sensor: Frame,
    noise: SensorNoise,
    rng: Pcg64,
    bias: [f64; 6],
    /// Per period.
    drift: [f64; 6],
    late: [[f64; 6]; LATEST],
    next: usize,
    /// Components that left the range in the last reading.
    pub(super) saturated: bool,
}

impl WristSensor {
    pub(super) fn new(
        sensor: &ForceSensor,
        noise: &SensorNoise,
        period: Length,
        mut rng: Pcg64,
    ) -> Self {
        let mut normal = |force: f64, torque: f64| -> [f64; 6] {
            std::array::from_fn(|i| {
                let x: f64 = StandardNormal.sample(&mut rng);
                x.clamp(-3.0, 3.0) * if i < 3 { force } else { torque }
            })
        };
        let bias = normal(noise.force_bias, noise.torque_bias);
        let periods = 600.0 / period.seconds();
        let drift = normal(noise.force_drift / periods, 0.05 * noise.force_drift / periods);
        Self {
            sensor: *sensor,
            flange_from_sensor: Frame::from_pose(&sensor.flange_from_sensor),
            noise: *noise,
            rng,
            bias,
            drift,
            late: [[f64::NAN; 6]; LATEST],
            next: 0,
            saturated: false,
        }
    }

    /// The reading of this period. `force` and `torque` act on the tool at `at`, in the world.
    pub(super) fn read(
        &mut self,
        world_from_flange: &Frame,
        at: &Vector3<f64>,
        force: &Vector3<f64>,
        torque: &Vector3<f64>,
    ) -> Wrench {
        let world_from_sensor = world_from_flange.times(&self.flange_from_sensor);
        let weight = Vector3::new(0.0, 0.0, -self.sensor.weight);
        let centre = world_from_flange.point(&self.sensor.centre_in_flange.coords);
        let total = force + weight;
        let moment = torque
            + (at - world_from_sensor.p).cross(force)
            + (centre - world_from_sensor.p).cross(&weight);
        let f = world_from_sensor.r.tr_mul(&total);
        let m = world_from_sensor.r.tr_mul(&moment);
        let truth = [f.x, f.y, f.z, m.x, m.y, m.z];
        self.saturated = false;
        let mut reading = [0.0; 6];
        for i in 0..6 {
            let n = &self.noise;
            let (sigma, quantum) =
                if i < 3 { (n.force, n.force_quantum) } else { (n.torque, n.torque_quantum) };
            self.bias[i] += self.drift[i];
            let x: f64 = StandardNormal.sample(&mut self.rng);
            let mut value = truth[i] + self.bias[i] + sigma * x;
            if quantum > 0.0 {
                value = (value / quantum).round() * quantum;
            }
            let range = self.sensor.range[i];
            self.saturated |= value.abs() > range;
            reading[i] = value.clamp(-range, range);
        }
        if self.late[0][0].is_nan() {
            self.late = [reading; LATEST];
        }
        self.late[self.next] = reading;
        let delay = self.noise.delay_periods.min(LATEST - 1);
        let told = self.late[(self.next + LATEST - delay) % LATEST];
        self.next = (self.next + 1) % LATEST;
        Wrench::from_directions(told)
    }
}
