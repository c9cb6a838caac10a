//! The wrist force: from the wrench that the sensor measures to the one that the tool exerts.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | saturated or silent sensor | `ForceSensor::range`, NaN | the reading is unfit for control |
//! | new zero | `BIAS_SAMPLES` | their mean; a saturated or repeated reading is no sample |
//! | new zero from a silent sensor | `PATIENCE` | the old zero stays, and the command ends |
//!
//! - in: the wrench on the sensor, the orientation of the flange, the believed weight beyond the
//!   sensor
//! - out: the wrench of the tool on its surroundings, about the tool point, in tool axes
//! - source: force transformation and bias of the original's sources; mean of two samples

use crate::cell::ForceSensor;
use crate::motion::ArmFault;
use crate::spatial::{Pose, Wrench};
use nalgebra::{Point3, Vector3};

/// Wrist sensor with its filter, its zero and its load.
#[derive(Debug, Clone, PartialEq)]
pub struct WristForce {
    sensor: ForceSensor,
    /// Load in the gripper: weight (N) and centre in the flange frame (m).
    payload: (f64, Point3<f64>),
    /// Zero of the sensor, in its frame.
    bias: Wrench,
    /// The last two samples, weight removed, the newest first, for their mean.
    last: [Option<Wrench>; 2],
    /// Sum and count of the samples of a new zero.
    biasing: Option<(Wrench, u32)>,
    /// Periods since the new zero was begun.
    biasing_for: u32,
    /// Whether the sensor has ever given a number.
    heard: bool,
}

impl WristForce {
    /// Number of samples in a zero.
    pub const BIAS_SAMPLES: u32 = 10;
    /// Number of periods in which these samples must come.
    const PATIENCE: u32 = 100;

    /// Makes a wrist sensor with zero bias and without a load in the gripper.
    #[must_use]
    pub fn new(sensor: ForceSensor) -> Self {
        Self {
            sensor,
            payload: (0.0, Point3::origin()),
            bias: Wrench::default(),
            last: [None; 2],
            biasing: None,
            biasing_for: 0,
            heard: false,
        }
    }

    /// Returns the wrench that the tool exerts on its surroundings, about the tool point, in tool
    /// axes (N, Nm). It is the mean of the sensor's last two samples, less the weight of tool and
    /// load and less the zero, negated. It is not finite while the sensor is silent. A reading that
    /// is not new is no sample.
    pub fn read(
        &mut self,
        (wrench_on_sensor, is_new): (&Wrench, bool),
        base_from_flange: &Pose,
        flange_from_tool: &Pose,
    ) -> Wrench {
        let mut sample = *wrench_on_sensor - self.weight_on_sensor(base_from_flange);
        self.biasing_for = self.biasing_for.saturating_add(1);
        self.heard |= sample.is_finite();
        if is_new || !sample.is_finite() {
            // A saturated sample would spoil the zero of all later readings.
            if self.fault(wrench_on_sensor).is_none() {
                self.count_towards_bias(&sample);
            }
            // A silent sample leaves a hole, so that no mean spans the silence.
            self.last = [sample.is_finite().then_some(sample), self.last[0]];
        } else {
            // The sensor is slower than the servo: the mean of its last two samples stays.
            sample = self.last[0].unwrap_or(sample);
        }
        let last = self.last[1].unwrap_or(sample);
        let mean = Wrench {
            force: 0.5 * (sample.force + last.force),
            torque: 0.5 * (sample.torque + last.torque),
        };
        // The sensor measures the wrench on itself; the tool exerts the opposite one.
        let tool_from_sensor = flange_from_tool.inverse() * self.sensor.flange_from_sensor;
        -(mean - self.bias).moved(&tool_from_sensor)
    }

    /// Starts to measure a new zero of the sensor, the mean of the next
    /// [`WristForce::BIAS_SAMPLES`] samples.
    pub fn start_bias(&mut self) {
        self.biasing = Some((Wrench::default(), 0));
        self.biasing_for = 0;
    }

    /// Returns the number of samples that the new zero still needs; 0 if no zero is being measured.
    /// If the samples do not come within 100 periods, the measurement ends and the old zero stays.
    #[must_use]
    pub fn missing_samples(&mut self) -> u32 {
        if self.biasing_for > Self::PATIENCE {
            self.biasing = None;
        }
        self.biasing.map_or(0, |(_, count)| Self::BIAS_SAMPLES - count)
    }

    /// Sets the load in the gripper: weight (N) and centre of mass in the flange frame (m).
    pub fn set_payload(&mut self, weight: f64, centre: Point3<f64>) {
        self.payload = (weight, centre);
        // The weight of the old load was removed from the last samples.
        self.last = [None; 2];
    }

    /// Returns whether a sensor that has given numbers before gives none now. A sensor that is
    /// still being set up, or a missing one, is a fault only for a motion under force control.
    #[must_use]
    pub fn fell_silent(&self, wrench_on_sensor: &Wrench) -> bool {
        self.heard && !wrench_on_sensor.is_finite()
    }

    /// Returns the fault of a sensor that is silent or saturated, so that its reading is unfit for
    /// force control; `None` for a sound reading.
    #[must_use]
    pub fn fault(&self, wrench_on_sensor: &Wrench) -> Option<ArmFault> {
        let components = wrench_on_sensor.directions();
        // A comparison with NaN is false, so `>= range` alone would accept a silent sensor.
        (0..6)
            .find(|&i| components[i].is_nan() || components[i].abs() >= self.sensor.range[i])
            .map(|direction| ArmFault::ForceSensor { direction, reading: components[direction] })
    }

    /// Returns the wrench that the weights of the tool and of the load exert on the sensor.
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

    /// Adds a sample to the new zero, which takes effect with its last sample.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spatial::Twist;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;

    /// Returns a sensor 90 mm beyond the flange, with a load of 13.18 N.
    fn sensor() -> ForceSensor {
        ForceSensor {
            flange_from_sensor: Pose::from_parts(
                Translation3::new(0.0, 0.0, 0.09),
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -1.571),
            ),
            weight: 13.18,
            centre_in_flange: Point3::new(0.004, 0.0, 0.13),
            range: [65.0, 65.0, 130.0, 5.0, 5.0, 5.0],
        }
    }

    /// Returns the `flange_from_tool` of a tool 250 mm beyond the flange.
    fn tool() -> Pose {
        Pose::translation(0.0, 0.0, 0.25)
    }

    /// Returns a `base_from_flange` with the roll, pitch and yaw `a` (rad).
    fn turned(a: [f64; 3]) -> Pose {
        Pose::from_parts(
            Translation3::new(0.5, -0.2, 1.1),
            UnitQuaternion::from_euler_angles(a[0], a[1], a[2]),
        )
    }

    /// Returns the wrench of a hanging weight on the sensor. The derivation in base axes about the
    /// sensor shares nothing with the code under test.
    fn wrench_of_weight(base_from_flange: &Pose, weight: f64, centre: Point3<f64>) -> Wrench {
        let base_from_sensor = base_from_flange * sensor().flange_from_sensor;
        let arm = (base_from_flange * centre).coords - base_from_sensor.translation.vector;
        let force = Vector3::new(0.0, 0.0, -weight);
        let into = base_from_sensor.rotation.inverse();
        Wrench { force: into * force, torque: into * arm.cross(&force) }
    }

    /// Returns the size of the largest component of a wrench (N or Nm).
    fn largest(wrench: &Wrench) -> f64 {
        wrench.directions().iter().fold(0.0, |m, c| m.max(c.abs()))
    }

    proptest! {
        #[test]
        fn tool_weight_is_compensated_in_any_orientation(
            a in prop::array::uniform3(-3.0..3.0f64)
        ) {
            let (mut wrist, flange) = (WristForce::new(sensor()), turned(a));
            let weight = wrench_of_weight(&flange, sensor().weight, sensor().centre_in_flange);

            prop_assert!(largest(&wrist.read((&weight, true), &flange, &tool())) < 1e-12);
        }

        #[test]
        fn payload_weight_is_compensated_in_any_orientation(
            a in prop::array::uniform3(-3.0..3.0f64)
        ) {
            let (mut wrist, flange) = (WristForce::new(sensor()), turned(a));
            let centre = Point3::new(0.0, 0.01, 0.25);
            wrist.set_payload(0.98, centre);
            let weight = wrench_of_weight(&flange, sensor().weight, sensor().centre_in_flange)
                + wrench_of_weight(&flange, 0.98, centre);

            prop_assert!(largest(&wrist.read((&weight, true), &flange, &tool())) < 1e-12);
        }

        /// The product of wrench and twist is the same at the sensor and at the tool.
        #[test]
        fn wrench_transform_to_tool_preserves_power(
            w in prop::array::uniform6(-20.0..20.0f64), t in prop::array::uniform6(-1.0..1.0f64)
        ) {
            let mut weightless = sensor();
            weightless.weight = 0.0;
            let on_sensor = Wrench::from_directions(w);
            let by_tool =
                WristForce::new(weightless).read((&on_sensor, true), &Pose::identity(), &tool());
            // The velocity of the sensor follows from that of the tool point, since both are rigid.
            let (at_tool, tool_from_sensor) =
                (Twist::from_directions(t), tool().inverse() * sensor().flange_from_sensor);
            let out = tool_from_sensor.translation.vector;
            let at_sensor = Twist {
                linear: at_tool.linear + at_tool.angular.cross(&out),
                angular: at_tool.angular,
            }
            .rotated(&tool_from_sensor.rotation.inverse());

            let power = |w: &Wrench, t: &Twist| w.force.dot(&t.linear) + w.torque.dot(&t.angular);

            prop_assert!((power(&on_sensor, &at_sensor) + power(&by_tool, &at_tool)).abs() < 1e-10);
        }
    }

    #[test]
    fn tool_exerts_the_opposite_of_the_measured_force() {
        let mut wrist = WristForce::new(ForceSensor { weight: 0.0, ..sensor() });
        // A wall ahead of the tool pushes it back along -z.
        let push = Wrench::from_directions([0.0, 0.0, -7.0, 0.0, 0.0, 0.0]);

        let by_tool = wrist.read((&push, true), &Pose::identity(), &tool());

        assert!((by_tool.force - Vector3::new(0.0, 0.0, 7.0)).norm() < 1e-12);
    }

    /// The reported force is the mean of the last two samples. After a silent sample, and at the
    /// beginning, it is a single one.
    #[test]
    fn reported_force_is_mean_of_two_samples() {
        let mut wrist = WristForce::new(ForceSensor { weight: 0.0, ..sensor() });
        let mut z = |force: f64| {
            let sample = Wrench::from_directions([0.0, 0.0, force, 0.0, 0.0, 0.0]);
            wrist.read((&sample, true), &Pose::identity(), &tool()).force.z
        };

        assert_eq!(z(-2.0), 2.0);
        assert_eq!(z(-4.0), 3.0);
        assert!(z(f64::NAN).is_nan());
        assert_eq!(z(-6.0), 6.0);
    }

    #[test]
    fn bias_is_the_mean_of_ten_weightless_samples() {
        let (mut wrist, flange) = (WristForce::new(sensor()), turned([0.3, 0.4, 0.5]));
        let other = turned([-2.0, 0.1, 1.0]);
        let offset = Wrench::from_directions([1.0, -2.0, 3.0, 0.1, 0.2, -0.3]);
        let weight = |flange| wrench_of_weight(flange, sensor().weight, sensor().centre_in_flange);
        wrist.start_bias();

        for sample in 0..10 {
            let noise = Wrench::from_directions([if sample % 2 == 0 { 0.5 } else { -0.5 }; 6]);
            let by_tool = wrist.read((&(weight(&flange) + offset + noise), true), &flange, &tool());
            assert_eq!(largest(&by_tool) > 1.0, sample < 9, "the old zero holds until the tenth");
        }

        // The bias is right in every orientation because it does not contain the weight.
        wrist.read((&(weight(&other) + offset), true), &other, &tool());
        assert!(largest(&wrist.read((&(weight(&other) + offset), true), &other, &tool())) < 1e-12);
    }

    #[test]
    fn saturated_or_silent_force_sensor_is_a_fault() {
        let wrist = WristForce::new(sensor());
        let with = |axis: usize, value: f64| {
            let mut components = [1.0; 6];
            components[axis] = value;
            wrist.fault(&Wrench::from_directions(components))
        };

        assert_eq!(with(2, 129.9), None);
        assert_eq!(with(1, -65.0), Some(ArmFault::ForceSensor { direction: 1, reading: -65.0 }));
        assert!(matches!(with(5, f64::NAN), Some(ArmFault::ForceSensor { direction: 5, .. })));
    }

    #[test]
    fn repeated_or_saturated_force_readings_are_ignored() {
        let weightless = ForceSensor { weight: 0.0, ..sensor() };
        let mut wrist = WristForce::new(weightless);
        let z = |force: f64| Wrench::from_directions([0.0, 0.0, force, 0.0, 0.0, 0.0]);
        let read = |wrist: &mut WristForce, force: f64, new: bool| {
            -wrist.read((&z(force), new), &Pose::identity(), &tool()).force.z
        };

        read(&mut wrist, 2.0, true);
        assert!((read(&mut wrist, 4.0, true) - 3.0).abs() < 1e-12);
        assert!((read(&mut wrist, 4.0, false) - 3.0).abs() < 1e-12, "still the mean of two");

        wrist.start_bias();
        for _ in 0..20 {
            read(&mut wrist, 6.0, true);
            read(&mut wrist, 6.0, false);
            read(&mut wrist, 140.0, true);
            if wrist.missing_samples() == 0 {
                break;
            }
        }
        assert_eq!(wrist.missing_samples(), 0);
        read(&mut wrist, 7.0, true);
        assert!((read(&mut wrist, 7.0, true) - 1.0).abs() < 1e-12, "the zero is 6 N");

        wrist.start_bias();
        for _ in 0..200 {
            read(&mut wrist, 9.0, false);
        }
        assert_eq!(wrist.missing_samples(), 0, "given up");
        assert!((read(&mut wrist, 7.0, true) - 1.0).abs() < 1e-12, "the old zero is kept");
    }
}
