//! Six-component sensor in a wrist: contact, weight and inertia of the tool, with bias, drift and
//! noise.
//!
//! - in: the wrench on the tool at the tool point, pose and velocity of the wrist
//! - out: the reading in the sensor's frame, late, in steps, clipped to the range
//! - equations: Newton and Euler for the rigid body beyond the sensor, `F - m a` and `M - (I w)'`
//!   about its centre
//!
//! The acceleration is the mean over the period, the difference of two velocities: a sensor
//! integrates over its sample. The inertia of a cube in the jaws is part of the contact: see
//! `carried`.

use super::config::SensorNoise;
use super::dynamics::Link;
use super::frame::Frame;
use crate::cell::ForceSensor;
use crate::servo::period::Length;
use crate::spatial::Wrench;
use nalgebra::Vector3;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// Contact on the body beyond the sensor, and the motion of this body, in the world, at the end of
/// a period.
pub(super) struct Load<'a> {
    /// Point at which the contact acts (m).
    pub(super) at: &'a Vector3<f64>,
    /// Contact force on the tool (N).
    pub(super) force: &'a Vector3<f64>,
    /// Contact torque on the tool about `at` (Nm).
    pub(super) torque: &'a Vector3<f64>,
    /// Velocity of the centre of mass (m/s).
    pub(super) velocity: Vector3<f64>,
    /// Angular velocity (rad/s).
    pub(super) spin: Vector3<f64>,
}

/// Momentum of the body beyond the sensor, in the world.
#[derive(Debug, Clone, Copy)]
struct Momentum {
    /// Mass times the velocity of the centre (kg m/s).
    linear: Vector3<f64>,
    /// Angular momentum about the centre (kg m2/s).
    angular: Vector3<f64>,
}

/// Number of readings that are kept for a delayed report; the delay is at most one period less.
const LATEST: usize = 128;

/// Sensor in a wrist: its errors, and the rigid body beyond it.
#[derive(Debug, Clone)]
pub(super) struct WristSensor {
    sensor: ForceSensor,
    flange_from_sensor: Frame,
    /// Mass of the body beyond the sensor (kg).
    mass: f64,
    /// Principal moments of that body along the flange's axes (kg m2).
    inertia: Vector3<f64>,
    /// Length of a period (s).
    seconds: f64,
    /// Momentum at the end of the last period; `None` before the first.
    momentum: Option<Momentum>,
    noise: SensorNoise,
    rng: Pcg64,
    /// Present bias of each component (N, Nm).
    bias: [f64; 6],
    /// Drift of the bias in a period (N, Nm).
    drift: [f64; 6],
    /// Last readings, in a ring.
    late: [[f64; 6]; LATEST],
    /// Place of the next reading in the ring.
    next: usize,
    /// Whether a component left the range in the last reading.
    pub(super) saturated: bool,
}

impl WristSensor {
    /// Makes a sensor at rest. The body beyond the sensor is a part of `last`, the arm's last link,
    /// and gets the radii of gyration of that link.
    pub(super) fn new(
        sensor: &ForceSensor,
        last: &Link,
        noise: &SensorNoise,
        period: Length,
        mut rng: Pcg64,
    ) -> Self {
        let mass = sensor.mass();
        let mut normal = |force: f64, torque: f64| -> [f64; 6] {
            std::array::from_fn(|i| {
                let x: f64 = StandardNormal.sample(&mut rng);
                x.clamp(-3.0, 3.0) * if i < 3 { force } else { torque }
            })
        };
        let bias = normal(noise.force_bias, noise.torque_bias);
        // The drift is given for 10 minutes.
        let periods = 600.0 / period.seconds();
        let drift = normal(noise.force_drift / periods, 0.05 * noise.force_drift / periods);
        Self {
            sensor: *sensor,
            flange_from_sensor: Frame::from_pose(&sensor.flange_from_sensor),
            mass,
            inertia: Vector3::from(last.inertia) * (mass / last.mass),
            seconds: period.seconds(),
            momentum: None,
            noise: *noise,
            rng,
            bias,
            drift,
            late: [[f64::NAN; 6]; LATEST],
            next: 0,
            saturated: false,
        }
    }

    /// Returns the centre of mass of the body beyond the sensor, in the world (m).
    pub(super) fn centre(&self, world_from_flange: &Frame) -> Vector3<f64> {
        world_from_flange.point(&self.sensor.centre_in_flange.coords)
    }

    /// Returns the wrench that the sensor reports in this period, in its own frame: the contact
    /// `load`, weight and inertia, with bias, noise, rounding and delay.
    pub(super) fn read(&mut self, world_from_flange: &Frame, load: &Load<'_>) -> Wrench {
        let world_from_sensor = world_from_flange.times(&self.flange_from_sensor);
        let (inertial, inertial_moment) = self.inertial(world_from_flange, load);
        // Inertia acts at the centre of mass, as the weight does.
        let weight = Vector3::new(0.0, 0.0, -self.sensor.weight) + inertial;
        let total = load.force + weight;
        // Both forces have levers about the sensor's origin.
        let moment = load.torque
            + (load.at - world_from_sensor.p).cross(load.force)
            + (self.centre(world_from_flange) - world_from_sensor.p).cross(&weight)
            + inertial_moment;
        let f = world_from_sensor.r.tr_mul(&total);
        let m = world_from_sensor.r.tr_mul(&moment);
        let truth = [f.x, f.y, f.z, m.x, m.y, m.z];
        self.saturated = false;
        let mut reading = [0.0; 6];
        for i in 0..6 {
            let n = &self.noise;
            // Noise comes before the steps and the end of the range, as in a converter.
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
        // Before the run the sensor had the same reading: no late reading is without a value.
        if self.late[0][0].is_nan() {
            self.late = [reading; LATEST];
        }
        self.late[self.next] = reading;
        let delay = self.noise.delay_periods.min(LATEST - 1);
        let told = self.late[(self.next + LATEST - delay) % LATEST];
        self.next = (self.next + 1) % LATEST;
        Wrench::from_directions(told)
    }

    /// Returns the inertial force (N) of the body beyond the sensor and the inertial torque about
    /// its centre of mass (Nm), in the world: the momentum that the body lost in this period,
    /// divided by the period.
    fn inertial(
        &mut self,
        world_from_flange: &Frame,
        load: &Load<'_>,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let r = &world_from_flange.r;
        let momentum = Momentum {
            linear: load.velocity * self.mass,
            angular: r * self.inertia.component_mul(&r.tr_mul(&load.spin)),
        };
        let last = self.momentum.replace(momentum).unwrap_or(momentum);
        (
            (last.linear - momentum.linear) / self.seconds,
            (last.angular - momentum.angular) / self.seconds,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hw::plant::dynamics::LINKS;
    use crate::motion::{AXES, PERIOD};
    use crate::spatial::GRAVITY;
    use nalgebra::Point3;

    #[test]
    fn sensor_under_constant_acceleration_reads_inertial_force() {
        let sensor = ForceSensor {
            flange_from_sensor: crate::spatial::Pose::translation(0.0, 0.0, 0.09),
            weight: GRAVITY,
            centre_in_flange: Point3::new(0.0, 0.0, 0.156),
            range: [65.0, 65.0, 130.0, 5.0, 5.0, 5.0],
        };
        let (last, none) = (&LINKS[AXES - 1], &SensorNoise::none());
        let mut felt = WristSensor::new(&sensor, last, none, Length::default(), Pcg64::new(1, 1));
        let still = Vector3::zeros();
        let mut reading = Wrench::default();

        for period in 0..3 {
            let since = f64::from(period) * PERIOD;
            reading = felt.read(
                &Frame::IDENTITY,
                &Load {
                    at: &still,
                    force: &still,
                    torque: &still,
                    velocity: Vector3::x() * 2.0 * since,
                    spin: Vector3::z() * 3.0 * since,
                },
            );
        }

        // 1 kg at 2 m/s2, 66 mm beyond the sensor; 3 rad/s2 about the axis of 6 g m2 a 2.5 kg.
        assert!((reading.force - Vector3::new(-2.0, 0.0, -GRAVITY)).norm() < 1e-9);
        assert!((reading.torque - Vector3::new(0.0, -0.132, -0.0072)).norm() < 1e-9);
    }
}
