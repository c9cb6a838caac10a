//! Lens model: a pinhole with radial and tangential distortion, in both directions.
//!
//! - in: focal lengths and principal point (px), coefficients k1, k2, p1, p2, k3
//! - out: the pixel of a point; the direction of a pixel, or `None` where the model has no inverse
//! - source: Brown, "Close-range camera calibration" (1971), with the signs and the order of
//!   `OpenCV`

use crate::cell::Intrinsics;
use nalgebra::{Matrix2, Point3, Vector2};

/// Lens with five coefficients of distortion. The centre of the first pixel is (0, 0).
///
/// ```
/// use nalgebra::Point3;
/// use rubik_robot_vision::Lens;
///
/// let lens = Lens {
///     radial: [-0.12, 0.03, 0.0],
///     tangential: [0.001, -0.0005],
///     ..Lens::pinhole((600.0, 600.0), (319.5, 239.5))
/// };
/// let (x, y) = lens.unproject(lens.project(&Point3::new(0.08, -0.06, 0.4))).ok_or("no inverse")?;
/// assert!((x - 0.2).abs() < 1e-9 && (y + 0.15).abs() < 1e-9);
/// // A barrel lens moves points towards the principal point.
/// assert!(lens.distort((0.3, 0.0)).0 < 0.3);
/// # Ok::<(), &str>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Focal length along x and y (px).
    pub focal: (f64, f64),
    /// Principal point (px).
    pub centre: (f64, f64),
    /// Radial coefficients k1, k2, k3 of r^2, r^4, r^6 in normalised coordinates.
    pub radial: [f64; 3],
    /// Tangential coefficients p1, p2.
    pub tangential: [f64; 2],
}

impl From<&Intrinsics> for Lens {
    /// Makes the lens of a camera, whose intrinsics have only the coefficients k1 and k2.
    fn from(camera: &Intrinsics) -> Self {
        let (k1, k2) = camera.distortion;
        Self {
            focal: camera.focal,
            centre: camera.centre,
            radial: [k1, k2, 0.0],
            tangential: [0.0; 2],
        }
    }
}

impl From<&Lens> for Lens {
    /// Copies the lens, so that a function can take either a lens or intrinsics.
    fn from(lens: &Lens) -> Self {
        *lens
    }
}

/// Greatest number of Newton steps of the inversion. Three to five suffice inside a picture.
const ROUNDS: usize = 20;
/// Greatest error of an inversion, in normalised coordinates: 1e-9 px at a focal length of 1000 px.
const CLOSE: f64 = 1e-12;

impl Lens {
    /// Makes a lens without distortion.
    #[must_use]
    pub fn pinhole(focal: (f64, f64), centre: (f64, f64)) -> Self {
        Self { focal, centre, radial: [0.0; 3], tangential: [0.0; 2] }
    }

    /// Distorts the normalised coordinates (x/z, y/z) of a point in the camera frame.
    #[must_use]
    pub fn distort(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let ([k1, k2, k3], [p1, p2]) = (self.radial, self.tangential);
        let r2 = x * x + y * y;
        let scale = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        (
            x * scale + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * scale + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }

    /// Computes the Jacobian of [`Lens::distort`] at normalised coordinates (x, y).
    fn slope(&self, (x, y): (f64, f64)) -> Matrix2<f64> {
        let ([k1, k2, k3], [p1, p2]) = (self.radial, self.tangential);
        let r2 = x * x + y * y;
        let scale = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        // Twice the derivative of the scale by r^2, since r^2 has the derivatives 2 x and 2 y.
        let bend = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3));
        // The derivatives of x by y and of y by x are equal.
        let cross = bend * x * y + 2.0 * p1 * x + 2.0 * p2 * y;
        Matrix2::new(
            scale + bend * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
            cross,
            cross,
            scale + bend * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
        )
    }

    /// Computes the normalised coordinates that [`Lens::distort`] maps to `wanted`. Returns `None`
    /// where the model folds back and has no inverse.
    #[must_use]
    pub fn undistort(&self, wanted: (f64, f64)) -> Option<(f64, f64)> {
        // Newton's method is used, since the usual fixed-point iteration converges slowly at the
        // border of a wide picture and does not detect where the model folds back.
        let (mut x, mut y) = wanted;
        for _ in 0..ROUNDS {
            let (dx, dy) = self.distort((x, y));
            let error = Vector2::new(dx - wanted.0, dy - wanted.1);
            let slope = self.slope((x, y));
            // From the centre up to the fold both eigenvalues of the Jacobian are positive. Beyond
            // the fold, points farther out have images farther in.
            if slope.determinant() <= 1e-6 || slope.trace() <= 0.0 {
                return None;
            }
            if error.norm() < CLOSE {
                return Some((x, y));
            }
            let step = slope.try_inverse()? * error;
            (x, y) = (x - step.x, y - step.y);
            if !(x.is_finite() && y.is_finite()) {
                return None;
            }
        }
        None
    }

    /// Projects a point of the camera frame (m, z > 0) to its pixel.
    #[must_use]
    pub fn project(&self, point: &Point3<f64>) -> (f64, f64) {
        let (x, y) = self.distort((point.x / point.z, point.y / point.z));
        (self.focal.0 * x + self.centre.0, self.focal.1 * y + self.centre.1)
    }

    /// Computes the normalised, undistorted direction (x/z, y/z) of a pixel. Returns `None` where
    /// the model has no inverse.
    #[must_use]
    pub fn unproject(&self, pixel: (f64, f64)) -> Option<(f64, f64)> {
        self.undistort((
            (pixel.0 - self.centre.0) / self.focal.0,
            (pixel.1 - self.centre.1) / self.focal.1,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns a lens for pictures of 640 x 480 px with this distortion.
    fn lens(radial: [f64; 3], tangential: [f64; 2]) -> Lens {
        Lens { focal: (600.0, 610.0), centre: (321.0, 238.0), radial, tangential }
    }

    proptest! {
        #[test]
        fn unproject_inverts_project(
            x in -0.6..0.6f64, y in -0.5..0.5f64, k1 in -0.35..0.35f64, k2 in -0.1..0.1f64,
            k3 in -0.02..0.02f64, p1 in -0.005..0.005f64, p2 in -0.005..0.005f64,
        ) {
            let lens = lens([k1, k2, k3], [p1, p2]);
            let pixel = lens.project(&Point3::new(x, y, 1.0));

            let (u, v) = lens.unproject(pixel).expect("the model has an inverse here");

            prop_assert!((u - x).abs() < 1e-10 && (v - y).abs() < 1e-10);
        }
    }

    #[test]
    fn lens_projects_like_intrinsics_it_was_converted_from() {
        let camera = Intrinsics {
            width: 640,
            height: 480,
            focal: (600.0, 600.0),
            centre: (319.5, 239.5),
            distortion: (-0.12, 0.03),
        };
        let point = Point3::new(0.3, -0.2, 0.9);

        let (a, b) = (Lens::from(&camera).project(&point), camera.project(&point));

        assert!((a.0 - b.0).abs() < 1e-12 && (a.1 - b.1).abs() < 1e-12);
    }

    #[test]
    fn distortion_coefficients_have_order_of_opencv() {
        // Computed by hand: x = 0.5, y = 0.25, r2 = 0.3125.
        let lens =
            Lens { focal: (1.0, 1.0), centre: (0.0, 0.0), ..lens([0.1, 0.2, 0.3], [0.01, 0.02]) };

        let (x, y) = lens.project(&Point3::new(0.5, 0.25, 1.0));

        let scale = 1.0 + 0.1 * 0.3125 + 0.2 * 0.097_656_25 + 0.3 * 0.030_517_578_125;
        assert!((x - (0.5 * scale + 2.0 * 0.01 * 0.125 + 0.02 * (0.3125 + 0.5))).abs() < 1e-12);
        assert!((y - (0.25 * scale + 0.01 * (0.3125 + 0.125) + 2.0 * 0.02 * 0.125)).abs() < 1e-12);
    }

    #[test]
    fn undistort_refuses_points_beyond_maximal_distorted_radius() {
        let strong = lens([-0.5, 0.0, 0.0], [0.0; 2]);

        // r (1 - r^2 / 2) is 0.544 at most.
        assert_eq!(strong.undistort((0.6, 0.0)), None);
        assert!(strong.undistort((0.5, 0.0)).is_some());
    }
}
