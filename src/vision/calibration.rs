//! Calibration of a camera with a cube: an arm shows the cube to the camera, or carries the camera
//! around the cube.
//!
//! One least-squares adjustment estimates all unknowns: the optics, the pose of the camera, the
//! pose of the cube, the cube's edge, and the error of each pose of the arm. A fixed camera sees a
//! cube that the arm moves (extrinsic calibration). A camera in a hand moves around a fixed cube
//! (hand-eye calibration). Only the middles of the grooves between tiles are used, because their
//! places do not depend on the size of the stickers.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | too few views | `LEAST_VIEWS` | a fit to fewer views may agree by chance |
//! | views contradict each other | residual above `WORST` (px) | the model does not describe them |
//! | error of the model of a groove | `FLOOR` (px) | added to the noise of each groove |
//! | groove far from its prediction | 1 px + 2 % of a pitch | the optics are known only roughly |
//! | outlier | Cauchy's weights, scale 2.4 spreads | 95 % efficient under normal noise |
//!
//! - in: [`View`]s with the measured pose of the arm and the grooves; a first guess with its
//!   spreads (standard deviations)
//! - out: [`Calibrated`] with the standard deviation of each number, or [`NotCalibrated`]
//! - source: bundle adjustment, Triggs et al. (2000); `camera_from_cube` is
//!   `camera^-1 * arm * cube` for a fixed camera, `camera^-1 * arm^-1 * cube` for one in a hand

use super::edges::{Kind, Prediction, Probe};
use super::fit::moved;
use super::pose::CubeLocation;
use super::undistort::Lens;
use crate::spatial::Pose;
use image::RgbImage;
use nalgebra::{DMatrix, DVector, Point3, Vector3};

/// Place of a groove of the cube in the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Groove {
    /// Middle of the groove between two tiles, in the cube frame, in edges of the cube: -0.5..=0.5.
    pub point: Point3<f64>,
    /// Unit normal of the groove's image.
    pub normal: (f64, f64),
    /// Measured place of the groove as a coordinate along the normal (px).
    pub measured: f64,
    /// Standard deviation of `measured` (px).
    pub sigma: f64,
}

/// Measurements at one pose of the arm.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Pose of the arm as its encoders report it: `world_from_tool` of the arm that shows the cube,
    /// or `base_from_flange` of the arm that carries the camera.
    pub arm: Pose,
    /// Grooves in the picture.
    pub grooves: Vec<Groove>,
}

/// Kind of calibration, by the part that the arm moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rig {
    /// The camera is fixed and the arm moves the cube.
    Fixed,
    /// The arm moves the camera and the cube is fixed.
    InHand,
}

/// Unknowns of a calibration, as a first guess or as its result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setup {
    /// Optics. Only k1 and k2 of the distortion are estimated.
    pub lens: Lens,
    /// Pose of the camera: `world_from_camera` if it is fixed, else `flange_from_camera`.
    pub camera: Pose,
    /// Pose of the cube: `tool_from_cube` if the camera is fixed, else `base_from_cube`.
    pub cube: Pose,
    /// Edge of the cube (m).
    pub edge: f64,
}

/// Standard deviations of a first guess, and of the arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spreads {
    /// Focal lengths, as a share of their values.
    pub focal: f64,
    /// Principal point (px).
    pub centre: f64,
    /// k1 and k2.
    pub distortion: f64,
    /// Place (m) and orientation (rad) of the camera.
    pub camera: (f64, f64),
    /// Place (m) and orientation (rad) of the cube.
    pub cube: (f64, f64),
    /// Edge of the cube (m).
    pub edge: f64,
    /// Error of each single pose of the arm: place (m) and orientation (rad).
    pub arm: (f64, f64),
    /// Error that all poses of the arm have in common, for each axis: place at the middle of all
    /// poses (m) and orientation (rad). Arms sag, and their bases are not exactly where they are
    /// believed to be. The views cannot distinguish this error from an error of the camera's or the
    /// cube's place.
    pub common: (f64, f64),
}

impl Default for Spreads {
    fn default() -> Self {
        Self {
            focal: 0.02,
            centre: 8.0,
            distortion: 0.05,
            camera: (0.02, 0.03),
            cube: (0.01, 0.05),
            edge: 0.3e-3,
            arm: (0.7e-3, 1.0e-3),
            common: (3.0e-3, 5.0e-3),
        }
    }
}

/// Result of a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibrated {
    /// Estimated values.
    pub setup: Setup,
    /// Standard deviations in the order of the unknowns: fx, fy, cx, cy (px), k1, k2, the camera's
    /// place (m) and orientation (rad) for each axis, the cube's place (m) and orientation (rad)
    /// for each axis, the edge (m). They hold for places relative to the poses that the arm's
    /// encoders report.
    pub deviations: [f64; GLOBALS],
    /// Standard deviations of the camera's true place (m) and orientation (rad) in the world or on
    /// the flange, for each axis. They include the error that all poses of the arm have in common.
    pub true_deviations: [f64; 6],
    /// Root mean square of the residuals without outliers (px).
    pub residual_px: f64,
    /// Root mean square of the estimated errors of the arm's poses: place (m), orientation (rad).
    pub arm: (f64, f64),
    /// Number of grooves that were used, without outliers.
    pub grooves: usize,
}

/// Reason why a calibration fails.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NotCalibrated {
    /// There are fewer than [`LEAST_VIEWS`] views.
    #[error("{views} usable views are too few: at least {} are needed", LEAST_VIEWS)]
    TooFewViews {
        /// Number of views.
        views: usize,
    },
    /// The views do not determine all unknowns.
    #[error("the views do not determine the camera: its equations have no finite solution")]
    Undetermined,
    /// The model does not describe the measurements.
    #[error("the residual is {residual_px:.1} px: the views contradict each other")]
    Contradiction {
        /// Root mean square of the residuals (px).
        residual_px: f64,
    },
}

/// Number of unknowns that all views share.
pub const GLOBALS: usize = 19;
/// Number of unknowns of a single view: the error of the arm's pose.
const LOCALS: usize = 6;
/// Fewest views of a calibration. A fit to fewer views may agree by chance.
pub const LEAST_VIEWS: usize = 6;
/// Standard deviation of the errors of a groove's model, beside the noise (px).
const FLOOR: f64 = 0.06;
/// Greatest residual of a calibration that is accepted (px).
const WORST: f64 = 2.0;
/// Steps of the numerical derivatives with respect to the shared unknowns, in their order and
/// units.
const STEPS: [f64; GLOBALS] = [
    1e-4, 1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-7, 1e-7, 1e-7, 1e-7, 1e-7, 1e-7, 1e-7, 1e-7, 1e-7, 1e-7,
    1e-7, 1e-7, 1e-8,
];

/// Measures the grooves between neighbouring tiles of a cube that was located in an image. Returns
/// them in the frame of the cube as the arm holds it, whose rough pose is `camera_from_held`.
///
/// The axes of `location` may be any of the 24 orientations of the cube, so `camera_from_held`
/// decides between them. `edge` is the edge of the cube (m).
#[must_use]
pub fn grooves_in(
    image: &RgbImage,
    lens: &Lens,
    edge: f64,
    location: &CubeLocation,
    camera_from_held: &Pose,
) -> Vec<Groove> {
    let pitch = edge / 3.0;
    let probe = Probe::new(image, lens, pitch);
    let relative = camera_from_held.rotation.inverse() * location.camera_from_cube.rotation;
    let held_from_cube = super::pose::nearest_of_24(&relative);
    let share = location.faces.first().map_or(0.86, |f| f.sticker.clamp(0.6, 0.97));
    let mut crossings = Vec::new();
    for (face, cube_from_face) in location.used.iter().enumerate() {
        let camera_from_face = &(location.camera_from_cube * cube_from_face);
        let prediction = Prediction { face, camera_from_face, share, tolerance: 0.08 };
        probe.measure(&prediction, None, &mut crossings);
    }
    let mut grooves = Vec::new();
    // The middle between two tiles does not depend on the size of the stickers or on blur, as the
    // other kinds of crossings do.
    for crossing in crossings.iter().filter(|c| c.kind == Kind::Middle) {
        let face = &location.used[crossing.face];
        let at = face * Point3::new(crossing.side.0 * pitch, crossing.side.1 * pitch, 0.0);
        let seen = lens.project(&(location.camera_from_cube * at));
        let apart = crossing.measured - seen.0 * crossing.normal.0 - seen.1 * crossing.normal.1;
        // The optics are not known exactly yet, so the pose fits only roughly. A crossing that is
        // farther off does not belong to a groove.
        if apart.abs() < 1.0 + 0.02 * crossing.scale {
            grooves.push(Groove {
                point: held_from_cube * Point3::from(at.coords / edge),
                normal: crossing.normal,
                measured: crossing.measured,
                sigma: crossing.sigma,
            });
        }
    }
    grooves
}

/// Estimates the optics and the pose of the camera, the pose and the edge of the cube, and the
/// error of each pose of the arm, from at least [`LEAST_VIEWS`] views.
///
/// `guess` is a first guess of these unknowns, and `spreads` are its standard deviations.
///
/// # Errors
/// [`NotCalibrated`] with the reason: too few views, views that do not determine all unknowns, or
/// views that contradict each other.
pub fn calibrate(
    rig: Rig,
    views: &[View],
    guess: &Setup,
    spreads: &Spreads,
) -> Result<Calibrated, NotCalibrated> {
    if views.len() < LEAST_VIEWS {
        return Err(NotCalibrated::TooFewViews { views: views.len() });
    }
    let size = GLOBALS + LOCALS * views.len();
    let problem = Problem { rig, views, guess };
    let widths = widths(guess, spreads, size);
    let mut at = DVector::zeros(size);
    let (mut cost, mut residuals) = problem.cost(&at, &widths, 1.0);
    let mut damping = 1e-4;
    // Levenberg-Marquardt on the normal equations. Thirty views have 199 unknowns, so that a dense
    // Cholesky factor is fast enough.
    let mut spread = spread_of(&residuals);
    let mut normal = DMatrix::zeros(size, size);
    for round in 0..40 {
        // The scale of the robust weights is that of the residuals for six rounds. Then it is
        // fixed, because costs at different scales cannot be compared.
        if round < 6 {
            spread = spread_of(&residuals);
            cost = problem.cost(&at, &widths, spread).0;
        }
        let gradient = problem.linearise(&at, &widths, spread, &mut normal);
        let mut gained = 0.0;
        for _ in 0..8 {
            let mut damped = normal.clone();
            for k in 0..size {
                damped[(k, k)] *= 1.0 + damping;
            }
            // The first guess, which counts as a measurement, makes the matrix positive definite.
            // A failure therefore means that a value in it is not finite.
            let factor = damped.cholesky().ok_or(NotCalibrated::Undetermined)?;
            let candidate = &at + factor.solve(&gradient);
            let (next, next_residuals) = problem.cost(&candidate, &widths, spread);
            if next < cost {
                gained = (cost - next) / cost;
                (at, cost, residuals) = (candidate, next, next_residuals);
                damping = (damping * 0.1_f64).max(1e-9);
                break;
            }
            damping *= 10.0;
        }
        if round >= 6 && gained < 1e-6 {
            break;
        }
    }
    let inverse = normal.cholesky().ok_or(NotCalibrated::Undetermined)?.inverse();
    problem.result(&Adjusted { unknowns: at, residuals, covariance: inverse, spread }, spreads)
}

/// Returns the standard deviations of all `size` unknowns before the fit: those of the first guess
/// for the unknowns that all views share, then six for the error of the arm's pose in each view.
fn widths(guess: &Setup, spreads: &Spreads, size: usize) -> DVector<f64> {
    let mut widths = DVector::zeros(size);
    let s = spreads;
    let pose = |(place, turn): (f64, f64)| [place, place, place, turn, turn, turn];
    let focal = (guess.lens.focal.0 * s.focal, guess.lens.focal.1 * s.focal);
    let optics = [focal.0, focal.1, s.centre, s.centre, s.distortion, s.distortion];
    let all = optics.into_iter().chain(pose(s.camera)).chain(pose(s.cube)).chain([s.edge]);
    // The six unknowns of each view follow, as many times as there are views.
    for (width, value) in widths.iter_mut().zip(all.chain(pose(s.arm).into_iter().cycle())) {
        *width = value;
    }
    widths
}

/// Computes the robust standard deviation of normalised residuals, or 1 if it is smaller.
fn spread_of(residuals: &[f64]) -> f64 {
    // The median of the sizes of normal errors is 1 / 1.4826 of their standard deviation. Up to
    // half of the residuals may be outliers.
    let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.get(sizes.len() / 2).map_or(1.0, |median| (1.4826 * median).max(1.0))
}

/// Result of the fit: the minimum of the cost.
struct Adjusted {
    /// Unknowns, as differences from the guess.
    unknowns: DVector<f64>,
    /// Normalised residuals of all grooves.
    residuals: Vec<f64>,
    /// Covariance of the unknowns for residuals with a spread of 1. It must be multiplied by the
    /// square of `spread`.
    covariance: DMatrix<f64>,
    /// Robust standard deviation of the residuals.
    spread: f64,
}

/// Least-squares problem of a calibration.
struct Problem<'a> {
    rig: Rig,
    views: &'a [View],
    guess: &'a Setup,
}

impl Problem<'_> {
    /// Returns the setup that differs from the first guess by `x`, the differences of the unknowns
    /// that all views share.
    fn setup(&self, x: &[f64]) -> Setup {
        let part = |from: usize| std::array::from_fn(|k| x[from + k]);
        let mut setup = *self.guess;
        setup.lens.focal.0 += x[0];
        setup.lens.focal.1 += x[1];
        setup.lens.centre.0 += x[2];
        setup.lens.centre.1 += x[3];
        setup.lens.radial[0] += x[4];
        setup.lens.radial[1] += x[5];
        setup.camera = moved(&setup.camera, part(6));
        setup.cube = moved(&setup.cube, part(12));
        setup.edge += x[18];
        setup
    }

    /// Appends the residual of each groove of a view to `out`: its measured place minus the one
    /// that `setup` predicts (px), divided by its standard deviation. `off` is the error of the
    /// arm's pose in this view (m, rad).
    fn residuals(&self, setup: &Setup, view: &View, off: [f64; LOCALS], out: &mut Vec<f64>) {
        let arm = moved(&view.arm, off);
        let motion = match self.rig {
            Rig::Fixed => arm,
            Rig::InHand => arm.inverse(),
        };
        let camera_from_cube = setup.camera.inverse() * motion * setup.cube;
        out.extend(view.grooves.iter().map(|g| {
            // A trial step may put the cube behind the camera. The bound keeps its image finite.
            let p = camera_from_cube * Point3::from(g.point.coords * setup.edge);
            let (x, y) = setup.lens.project(&Point3::new(p.x, p.y, p.z.max(1e-3)));
            (g.measured - x * g.normal.0 - y * g.normal.1) / g.sigma.hypot(FLOOR)
        }));
    }

    /// Returns the error of the arm's pose in a view (m, rad), which are six of the unknowns `x`.
    fn off(x: &DVector<f64>, view: usize) -> [f64; LOCALS] {
        std::array::from_fn(|k| x[GLOBALS + LOCALS * view + k])
    }

    /// Computes the cost of the unknowns `x`: Cauchy's cost of all grooves, plus the squares of the
    /// differences from the first guess in units of their standard deviations (`widths`). Returns
    /// the cost and the residuals. `spread` is the robust standard deviation of the residuals.
    fn cost(&self, x: &DVector<f64>, widths: &DVector<f64>, spread: f64) -> (f64, Vec<f64>) {
        let setup = self.setup(x.as_slice());
        let mut residuals = Vec::new();
        for (i, view) in self.views.iter().enumerate() {
            self.residuals(&setup, view, Self::off(x, i), &mut residuals);
        }
        let scale = (2.4 * spread).powi(2);
        let robust: f64 = residuals.iter().map(|r| scale * (r * r / scale).ln_1p()).sum();
        // Residuals are in units of their assumed deviations, which are `spread` times too small.
        // The weight of the first guess is therefore multiplied by the square of `spread`.
        let belief: f64 =
            x.iter().zip(widths).map(|(x, w)| (x / w).powi(2)).sum::<f64>() * spread * spread;
        (robust + belief, residuals)
    }

    /// Linearises the residuals at `x`. Fills the normal matrix and returns the right-hand side of
    /// the normal equations, whose solution is the next Gauss-Newton step.
    fn linearise(
        &self,
        x: &DVector<f64>,
        widths: &DVector<f64>,
        spread: f64,
        normal: &mut DMatrix<f64>,
    ) -> DVector<f64> {
        normal.fill(0.0);
        let mut right = DVector::zeros(x.len());
        // The first guess counts as a measurement of each unknown. It determines the unknowns that
        // the views do not determine.
        for k in 0..x.len() {
            let weight = (spread / widths[k]).powi(2);
            normal[(k, k)] = weight;
            right[k] = -x[k] * weight;
        }
        let setup = self.setup(x.as_slice());
        // A step of a shared unknown changes the setup in the same way for all views, so each
        // changed setup is computed once.
        let ahead: Vec<Setup> = (0..GLOBALS)
            .map(|k| {
                let mut x = x.as_slice()[..GLOBALS].to_vec();
                x[k] += STEPS[k];
                self.setup(&x)
            })
            .collect();
        let (mut here, mut there) = (Vec::new(), Vec::new());
        for (i, view) in self.views.iter().enumerate() {
            let off = Self::off(x, i);
            here.clear();
            self.residuals(&setup, view, off, &mut here);
            // The residuals of a view depend on the shared unknowns and on its own six only, so its
            // rows of the Jacobian have 25 columns instead of all.
            let mut rows = DMatrix::<f64>::zeros(here.len(), GLOBALS + LOCALS);
            for k in 0..GLOBALS + LOCALS {
                there.clear();
                let step = if k < GLOBALS {
                    self.residuals(&ahead[k], view, off, &mut there);
                    STEPS[k]
                } else {
                    let mut off = off;
                    off[k - GLOBALS] += 1e-7;
                    self.residuals(&setup, view, off, &mut there);
                    1e-7
                };
                for (j, (a, b)) in there.iter().zip(&here).enumerate() {
                    rows[(j, k)] = (b - a) / step;
                }
            }
            let place = |k: usize| if k < GLOBALS { k } else { LOCALS * i + k };
            for (j, residual) in here.iter().enumerate() {
                // Cauchy's weight: a groove with a residual of 2.4 spreads counts half.
                let weight = 1.0 / (1.0 + (residual / (2.4 * spread)).powi(2));
                for a in 0..GLOBALS + LOCALS {
                    let scaled = weight * rows[(j, a)];
                    right[place(a)] += scaled * residual;
                    for b in 0..GLOBALS + LOCALS {
                        normal[(place(a), place(b))] += scaled * rows[(j, b)];
                    }
                }
            }
        }
        right
    }

    /// Converts the minimum of the cost to the calibration that is reported.
    ///
    /// # Errors
    /// [`NotCalibrated::Contradiction`] if the residuals are too large.
    fn result(&self, adjusted: &Adjusted, spreads: &Spreads) -> Result<Calibrated, NotCalibrated> {
        let Adjusted { unknowns: x, residuals, covariance, spread } = adjusted;
        // The reported residual is in pixels and without outliers, which have little weight in the
        // fit.
        let sigmas = self.views.iter().flat_map(|v| v.grooves.iter().map(|g| g.sigma.hypot(FLOOR)));
        let fitting: Vec<f64> = residuals
            .iter()
            .zip(sigmas)
            .filter(|(r, _)| r.abs() < 4.0 * spread)
            .map(|(r, s)| (r * s).powi(2))
            .collect();
        let residual_px = (fitting.iter().sum::<f64>() / fitting.len().max(1) as f64).sqrt();
        if residual_px.is_nan() || residual_px > WORST {
            return Err(NotCalibrated::Contradiction { residual_px });
        }
        // The errors of the arm's poses are unknowns of the fit: three of place, three of rotation.
        let views = self.views.len();
        let rms = |from: usize| {
            let sum: f64 = (0..views)
                .flat_map(|i| (0..3).map(move |k| x[GLOBALS + LOCALS * i + from + k].powi(2)))
                .sum();
            (sum / (3 * views) as f64).sqrt()
        };
        let setup = self.setup(x.as_slice());
        let deviations: [f64; GLOBALS] =
            std::array::from_fn(|k| spread * covariance[(k, k)].max(0.0).sqrt());
        let common = self.common(&setup, spreads.common);
        Ok(Calibrated {
            setup,
            deviations,
            true_deviations: std::array::from_fn(|k| deviations[6 + k].hypot(common[k])),
            residual_px,
            arm: (rms(0), rms(3)),
            grooves: fitting.len(),
        })
    }

    /// Computes the standard deviations of the camera's place (m) and orientation (rad), for each
    /// axis, that follow from an error of all poses of the arm in common. Its standard deviations
    /// are `place` (m) and `turn` (rad).
    ///
    /// If all poses of the hand that shows the cube are turned, the estimate of a fixed camera
    /// turns with them about the middle of their places. With a camera in a hand the result is 0,
    /// because the estimated place of the cube absorbs the error.
    fn common(&self, setup: &Setup, (place, turn): (f64, f64)) -> [f64; 6] {
        if self.rig == Rig::InHand {
            return [0.0; 6];
        }
        let middle =
            self.views.iter().map(|view| view.arm.translation.vector).sum::<Vector3<f64>>()
                / self.views.len() as f64;
        let lever = setup.camera.translation.vector - middle;
        std::array::from_fn(|k| {
            if k >= 3 {
                return turn;
            }
            // A turn moves the camera along an axis only by the part of the lever at right angles
            // to that axis.
            let across = (lever.norm_squared() - lever[k] * lever[k]).max(0.0).sqrt();
            place.hypot(turn * across)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};
    use rand::{Rng, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64;

    /// Returns the true values of the unknowns in these tests.
    fn truth() -> Setup {
        Setup {
            lens: Lens {
                focal: (1153.0, 1153.0),
                centre: (321.0, 238.0),
                radial: [-0.06, 0.01, 0.0],
                tangential: [0.0; 2],
            },
            camera: Pose::identity(),
            cube: Pose::from_parts(
                Translation3::new(0.001, -0.002, 0.003),
                UnitQuaternion::from_scaled_axis(Vector3::new(0.01, 0.02, -0.01)),
            ),
            edge: 0.0571,
        }
    }

    /// Returns `count` views of the grooves on the visible faces of a cube, 0.35 m to 0.75 m from
    /// the camera, with 0.05 px of noise. `arm` is the standard deviation of the error of the
    /// arm's poses (m, rad).
    fn views(rig: Rig, truth: &Setup, arm: (f64, f64), count: usize, seed: u64) -> Vec<View> {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut views = Vec::new();
        while views.len() < count {
            let mut within = |size: f64| random.random_range(-size..size);
            let place = Vector3::new(within(0.12), within(0.09), 0.55 + within(0.2));
            let turn = Vector3::new(0.6 + within(0.4), 0.6 + within(0.4), within(1.5));
            let camera_from_cube =
                Pose::from_parts(place.into(), UnitQuaternion::from_scaled_axis(turn));
            let motion = truth.camera * camera_from_cube * truth.cube.inverse();
            let real = match rig {
                Rig::Fixed => motion,
                Rig::InHand => motion.inverse(),
            };
            let mut normal = |size: f64| -> f64 {
                let x: f64 = StandardNormal.sample(&mut random);
                x * size
            };
            let off = [arm.0, arm.0, arm.0, arm.1, arm.1, arm.1].map(&mut normal);
            let mut grooves = Vec::new();
            for face in 0..6 {
                let (axis, sign) = (face / 2, if face % 2 == 0 { -0.5 } else { 0.5 });
                let mut outward = Vector3::zeros();
                outward[axis] = sign;
                let centre = camera_from_cube * Point3::from(outward * truth.edge);
                if (camera_from_cube.rotation * outward).dot(&centre.coords) > -0.1 * centre.z {
                    continue;
                }
                for (u, v) in [(-1.0, 0.5), (0.0, 0.5), (1.0, -0.5), (0.5, 0.0), (-0.5, 1.0)] {
                    let mut point = Point3::from(outward);
                    point[(axis + 1) % 3] = u / 3.0;
                    point[(axis + 2) % 3] = v / 3.0;
                    let p = camera_from_cube * Point3::from(point.coords * truth.edge);
                    let (x, y) = truth.lens.project(&p);
                    let angle = normal(3.0);
                    let n = (angle.cos(), angle.sin());
                    let measured = x * n.0 + y * n.1 + normal(0.05);
                    grooves.push(Groove { point, normal: n, measured, sigma: 0.05 });
                }
            }
            if grooves.len() >= 10 {
                views.push(View { arm: moved(&real, off), grooves });
            }
        }
        views
    }

    /// Returns a first guess with usual errors: some millimetres and mrad of the camera and the
    /// cube, 0.1 mm of the edge, and a lens without distortion.
    fn guess(truth: &Setup) -> Setup {
        let mut guess = *truth;
        guess.lens.focal = (1150.0, 1150.0);
        guess.lens.centre = (319.5, 239.5);
        guess.lens.radial = [0.0; 3];
        guess.camera = moved(&guess.camera, [0.004, -0.003, 0.002, 0.004, -0.003, 0.005]);
        guess.cube = Pose::identity();
        guess.edge = 0.057;
        guess
    }

    #[test]
    fn calibration_recovers_parameters_of_fixed_and_hand_cameras() {
        for rig in [Rig::Fixed, Rig::InHand] {
            let mut truth = truth();
            truth.camera = Pose::from_parts(
                Translation3::new(0.3, -0.2, 0.4),
                UnitQuaternion::from_scaled_axis(Vector3::new(0.4, -0.9, 0.3)),
            );
            let views = views(rig, &truth, (0.0, 0.0), 25, 3);
            let spreads = Spreads { arm: (2e-5, 5e-5), ..Spreads::default() };

            let found = calibrate(rig, &views, &guess(&truth), &spreads).unwrap();

            let setup = &found.setup;
            for (found, truth, most) in [
                (setup.lens.focal.0, truth.lens.focal.0, 0.5),
                (setup.lens.focal.1, truth.lens.focal.1, 0.5),
                (setup.lens.centre.0, truth.lens.centre.0, 0.3),
                (setup.lens.centre.1, truth.lens.centre.1, 0.3),
                (setup.lens.radial[0], truth.lens.radial[0], 0.01),
                (setup.edge, truth.edge, 1e-5),
            ] {
                assert!((found - truth).abs() < most, "{rig:?}: {found} instead of {truth}");
            }
            for (found, truth, most) in
                [(setup.camera, truth.camera, 3e-4), (setup.cube, truth.cube, 5e-5)]
            {
                let off = truth.inverse() * found;
                assert!(off.translation.vector.norm() < most, "{rig:?}: {off}");
                assert!(off.rotation.angle() < 5e-4, "{rig:?}: {off}");
            }
            assert!(found.residual_px < 0.1, "{} px", found.residual_px);
        }
    }

    /// With an inexact arm the focal length is less exact. The reported standard deviation is as
    /// large as this error.
    #[test]
    fn reported_deviation_matches_focal_error_with_inexact_arm() {
        let truth = truth();
        let mut squares = Vec::new();
        for seed in 0..6 {
            let views = views(Rig::Fixed, &truth, (0.4e-3, 0.7e-3), 30, seed);

            let found = calibrate(Rig::Fixed, &views, &guess(&truth), &Spreads::default()).unwrap();

            let error = found.setup.lens.focal.0 - truth.lens.focal.0;
            assert!((error / truth.lens.focal.0).abs() < 4e-3, "{error} px");
            squares.push((error / found.deviations[0]).powi(2));
        }
        // The expected value of these squares is 1.
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        assert!((0.25..2.0).contains(&mean), "{squares:?}");
    }

    /// If the hand sags, the error of a fixed camera's place is far beyond the reported deviations.
    /// The reported true deviations include the sag.
    #[test]
    fn true_deviations_of_fixed_camera_include_arm_sag() {
        let truth = truth();
        for seed in 0..4 {
            let mut views = views(Rig::Fixed, &truth, (0.3e-3, 0.5e-3), 25, seed);
            // The encoders report the hand 4.6 mm higher than it is.
            for view in &mut views {
                view.arm.translation.z += 4.6e-3;
            }

            let found = calibrate(Rig::Fixed, &views, &guess(&truth), &Spreads::default()).unwrap();

            let error = found.setup.camera.translation.vector - truth.camera.translation.vector;
            // The deviations 6 to 8 are those of the camera's place.
            let reported = found.deviations[6].max(found.deviations[8]);
            assert!(error.norm() > 3.0 * reported, "{error} m");
            for k in 0..3 {
                assert!(
                    error[k].abs() < 3.0 * found.true_deviations[k],
                    "{error} {:?}",
                    found.true_deviations
                );
            }
            assert!(found.true_deviations[0] < 0.01, "{:?}", found.true_deviations);
        }
    }

    #[test]
    fn too_few_views_are_refused() {
        let truth = truth();
        let views = views(Rig::Fixed, &truth, (0.0, 0.0), 6, 1);
        let by = |views: &[View]| calibrate(Rig::Fixed, views, &truth, &Spreads::default());

        assert_eq!(by(&views[..5]), Err(NotCalibrated::TooFewViews { views: 5 }));
        assert!(by(&views).is_ok());
    }
}
