//! Weighing of the tool: weight, centre of mass and bias of the sensor from several orientations.
//!
//! The model is `f = b_f + W d`, with d the direction of gravity in the sensor's frame, and
//! `t = b_t + c x W d`. No force but the weight may act: the gripper is empty, and the tool touches
//! nothing.
//!
//! - in: orientations of the flange against an upright base, and the wrench on the sensor in each,
//!   at rest
//! - out: the least-squares solution of the model, and its residuals

use super::io::ArmReading;
use crate::spatial::{Pose, Wrench};
use nalgebra::{Matrix3, Matrix4, Matrix6, Point3, UnitQuaternion, Vector3, Vector4, Vector6};

/// The wrench in one orientation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Orientation of the flange, `base_from_flange`.
    pub base_from_flange: UnitQuaternion<f64>,
    /// Mean of the readings: the wrench on the sensor, in its frame (N, Nm).
    pub wrench_on_sensor: Wrench,
}

/// Mean of the wrenches of a sensor. Repeated readings and those without numbers do not count.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mean {
    sum: Wrench,
    taken: u32,
}

impl Mean {
    /// Adds the wrench of a reading if it is new and finite.
    pub fn add(&mut self, reading: &ArmReading) {
        let wrench = reading.wrench_on_sensor;
        if wrench.is_finite() && !reading.wrench_is_old {
            (self.sum, self.taken) = (self.sum + wrench, self.taken + 1);
        }
    }

    /// Returns the number of readings in the mean.
    #[must_use]
    pub fn taken(&self) -> u32 {
        self.taken
    }

    /// Returns the mean, which is NaN without any reading (N, Nm).
    #[must_use]
    pub fn wrench(&self) -> Wrench {
        let share = 1.0 / f64::from(self.taken);
        Wrench { force: share * self.sum.force, torque: share * self.sum.torque }
    }
}

/// Load of the sensor, and its zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weighed {
    /// Weight (N).
    pub weight: f64,
    /// Centre of mass in the flange frame (m).
    pub centre_in_flange: Point3<f64>,
    /// Reading of the sensor without a load (N, Nm).
    pub bias: Wrench,
    /// Root mean square of the residuals of a component of the force (N) and of the torque (Nm).
    pub residual: (f64, f64),
    /// Largest residual of a component of the force (N) and of the torque (Nm).
    pub largest_residual: (f64, f64),
}

/// Reason why the samples do not determine the weight.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CannotWeigh {
    /// Too few orientations.
    #[error("the tool was weighed in {0} orientations: at least 4 are needed")]
    TooFew(usize),
    /// Orientations that are too similar.
    #[error(
        "the orientations are too similar: in the axes of the sensor the direction of gravity, a \
         unit vector, varies by {turned:.3}, but at least {LEAST} is needed"
    )]
    TooMuchAlike {
        /// Root mean square of the deviations of gravity's direction from its mean, along the axis
        /// with the second largest deviations.
        turned: f64,
    },
    /// A silent sensor.
    #[error("the force sensor gave no reading in orientation {0}, counted from 0")]
    Silent(usize),
}

/// Smallest variation of gravity's direction, along the axis with the second largest variation.
const LEAST: f64 = 0.1;

/// Computes weight and centre of mass of the tool and the bias of the force sensor from wrenches
/// that the sensor measured in several orientations.
///
/// # Errors
/// [`CannotWeigh`] if the samples do not determine them.
pub fn weigh(samples: &[Sample], flange_from_sensor: &Pose) -> Result<Weighed, CannotWeigh> {
    if samples.len() < 4 {
        return Err(CannotWeigh::TooFew(samples.len()));
    }
    if let Some(silent) = samples.iter().position(|s| !s.wrench_on_sensor.is_finite()) {
        return Err(CannotWeigh::Silent(silent));
    }
    let down = |sample: &Sample| {
        (sample.base_from_flange * flange_from_sensor.rotation).inverse() * -Vector3::z()
    };
    check_spread(&samples.iter().map(down).collect::<Vec<_>>())?;

    // The forces come first: they give W, and with W the torques are linear in their unknowns as
    // well. The normal equations have four unknowns, W and b_f.
    let mut normal = Matrix4::<f64>::zeros();
    let mut right = Vector4::zeros();
    for sample in samples {
        let (d, f) = (down(sample), sample.wrench_on_sensor.force);
        for axis in 0..3 {
            let mut row = Vector4::new(d[axis], 0.0, 0.0, 0.0);
            row[axis + 1] = 1.0;
            normal += row * row.transpose();
            right += row * f[axis];
        }
    }
    let alike = CannotWeigh::TooMuchAlike { turned: 0.0 };
    let force = normal.cholesky().ok_or(alike)?.solve(&right);
    let weight = force[0];
    let bias_force = Vector3::new(force[1], force[2], force[3]);

    // The torques have six unknowns, c and b_t; c x w = -[w]x c.
    let mut normal = Matrix6::<f64>::zeros();
    let mut right = Vector6::zeros();
    for sample in samples {
        let cross = -(weight * down(sample)).cross_matrix();
        for axis in 0..3 {
            let mut row = Vector6::zeros();
            row.fixed_rows_mut::<3>(0).copy_from(&cross.row(axis).transpose());
            row[axis + 3] = 1.0;
            normal += row * row.transpose();
            right += row * sample.wrench_on_sensor.torque[axis];
        }
    }
    let torque = normal.cholesky().ok_or(alike)?.solve(&right);
    let centre = Vector3::new(torque[0], torque[1], torque[2]);
    let bias_torque = Vector3::new(torque[3], torque[4], torque[5]);

    // The residuals show effects outside the model, for example a contact.
    let mut squares = (0.0, 0.0);
    let mut largest = (0.0_f64, 0.0_f64);
    for sample in samples {
        let pull = weight * down(sample);
        let off = sample.wrench_on_sensor.force - bias_force - pull;
        let twist = sample.wrench_on_sensor.torque - bias_torque - centre.cross(&pull);
        squares = (squares.0 + off.norm_squared(), squares.1 + twist.norm_squared());
        largest = (largest.0.max(off.amax()), largest.1.max(twist.amax()));
    }
    let components = 3.0 * samples.len() as f64;
    Ok(Weighed {
        weight,
        centre_in_flange: flange_from_sensor * Point3::from(centre),
        bias: Wrench { force: bias_force, torque: bias_torque },
        residual: ((squares.0 / components).sqrt(), (squares.1 / components).sqrt()),
        largest_residual: largest,
    })
}

/// Checks that the directions of gravity in the frame of the sensor vary along two axes.
fn check_spread(down: &[Vector3<f64>]) -> Result<(), CannotWeigh> {
    let count = down.len() as f64;
    let mean: Vector3<f64> = down.iter().sum::<Vector3<f64>>() / count;
    let spread: Matrix3<f64> =
        down.iter().map(|d| (d - mean) * (d - mean).transpose()).sum::<Matrix3<f64>>() / count;
    // If they varied along one axis only, the component of the centre along this axis could not be
    // separated from the bias of the torque. So the second largest variance counts.
    let mut values: [f64; 3] = spread.symmetric_eigenvalues().into();
    values.sort_by(f64::total_cmp);
    let turned = values[1].max(0.0).sqrt();
    if turned < LEAST { Err(CannotWeigh::TooMuchAlike { turned }) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::ForceSensor;
    use crate::servo::wrench::WristForce;
    use nalgebra::Translation3;
    use proptest::prelude::*;

    /// Returns the pose of a sensor 90 mm beyond the flange, turned by -90 deg about z.
    fn flange_from_sensor() -> Pose {
        Pose::from_parts(
            Translation3::new(0.0, 0.0, 0.09),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -1.571),
        )
    }

    /// Returns the reading of a sensor in the orientation `at` with this tool and bias. It is
    /// computed from gravity in the frame of the base, unlike in the code under test.
    fn taken(at: &UnitQuaternion<f64>, weight: f64, centre: Point3<f64>, bias: &Wrench) -> Sample {
        let base_from_sensor = at * flange_from_sensor().rotation;
        let arm = at * (centre.coords - flange_from_sensor().translation.vector);
        let pull = Vector3::new(0.0, 0.0, -weight);
        let wrench = Wrench { force: pull, torque: arm.cross(&pull) };
        let wrench_on_sensor = wrench.rotated(&base_from_sensor.inverse()) + *bias;
        Sample { base_from_flange: *at, wrench_on_sensor }
    }

    /// Returns the orientations with these angles of roll, pitch and yaw (rad).
    fn orientations(angles: &[[f64; 3]]) -> Vec<UnitQuaternion<f64>> {
        angles.iter().map(|a| UnitQuaternion::from_euler_angles(a[0], a[1], a[2])).collect()
    }

    #[test]
    fn mean_takes_only_new_finite_readings() {
        let reading = |newtons: f64, wrench_is_old| ArmReading {
            wrench_on_sensor: Wrench { force: Vector3::repeat(newtons), ..Wrench::default() },
            wrench_is_old,
            ..ArmReading::default()
        };
        let mut mean = Mean::default();
        for reading in [
            reading(1.0, false),
            reading(1.0, true),
            reading(f64::NAN, false),
            reading(4.0, false),
            reading(4.0, true),
        ] {
            mean.add(&reading);
        }

        assert_eq!(mean.taken(), 2);
        assert_eq!(mean.wrench().force, Vector3::repeat(2.5));
    }

    proptest! {
        #[test]
        fn weighing_finds_tool_weight_centre_and_sensor_bias(
            weight in 1.0..30.0f64,
            centre in prop::array::uniform3(-0.2..0.2f64),
            bias in prop::array::uniform6(-3.0..3.0f64),
            angles in prop::collection::vec(prop::array::uniform3(-1.5..1.5f64), 8..14),
        ) {
            let (centre, bias) = (Point3::from(centre), Wrench::from_directions(bias));
            let at = orientations(&angles);
            let samples: Vec<_> = at.iter().map(|at| taken(at, weight, centre, &bias)).collect();

            // No eight orientations that are drawn at random are too similar.
            let found = weigh(&samples, &flange_from_sensor()).unwrap();

            prop_assert!((found.weight - weight).abs() < 1e-6);
            prop_assert!((found.centre_in_flange - centre).norm() < 1e-6);
            let off = found.bias - bias;
            prop_assert!(off.directions().iter().all(|c| c.abs() < 1e-6), "{off:?}");
            prop_assert!(found.largest_residual.0 < 1e-6 && found.largest_residual.1 < 1e-6);
            // The compensation of the servo agrees with the result: no force is left.
            let mut wrist = WristForce::new(ForceSensor {
                flange_from_sensor: flange_from_sensor(),
                weight: found.weight,
                centre_in_flange: found.centre_in_flange,
                range: [200.0; 6],
            });
            let flange = Pose::from_parts(Translation3::identity(), at[0]);
            let rest = wrist.read(
                (&(samples[0].wrench_on_sensor - found.bias), true), &flange, &Pose::identity()
            );
            prop_assert!(rest.directions().iter().all(|c| c.abs() < 1e-6));
        }
    }

    #[test]
    fn sensor_noise_shows_in_residual_of_weighing() {
        let at = orientations(&[
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [-1.0, 0.2, 0.0],
            [0.0, 1.0, 0.3],
            [0.4, -1.0, 0.0],
            [1.5, 0.7, 0.0],
        ]);
        let noise = [0.3, -0.3, 0.3, -0.3, 0.3, -0.3];
        let samples: Vec<_> = at
            .iter()
            .zip(noise)
            .map(|(at, noise)| {
                let mut sample = taken(at, 10.0, Point3::new(0.0, 0.0, 0.15), &Wrench::default());
                sample.wrench_on_sensor.force.x += noise;
                sample
            })
            .collect();

        let found = weigh(&samples, &flange_from_sensor()).unwrap();

        assert!((found.weight - 10.0).abs() < 0.3, "{found:?}");
        // The noise is 0.3 N in one of three components. The fit takes a part of it.
        let whole = 0.3 / 3.0_f64.sqrt();
        let (mean, largest) = (found.residual.0, found.largest_residual.0);
        assert!(mean > 0.8 * whole && mean <= whole, "{mean} of {whole}");
        assert!(largest > mean && largest < 0.6, "{largest}");
        assert!(found.residual.1 < 1e-2 && found.largest_residual.1 < 2e-2, "{found:?}");
    }

    #[test]
    fn weighing_in_similar_orientations_is_refused() {
        let level = orientations(&[[0.0; 3], [0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [0.02, 0.0, 0.0]]);
        let tool = |at| taken(at, 10.0, Point3::new(0.0, 0.0, 0.15), &Wrench::default());
        let samples: Vec<_> = level.iter().map(tool).collect();

        let alike = weigh(&samples, &flange_from_sensor());

        assert!(matches!(alike, Err(CannotWeigh::TooMuchAlike { turned }) if turned < 0.02));
        assert_eq!(weigh(&samples[..3], &flange_from_sensor()), Err(CannotWeigh::TooFew(3)));
        let mut silent = samples;
        silent[2].wrench_on_sensor.force.x = f64::NAN;
        assert_eq!(weigh(&silent, &flange_from_sensor()), Err(CannotWeigh::Silent(2)));
    }
}
