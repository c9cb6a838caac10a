//! A renderer of cubes for tests: faces in perspective with lens distortion, noise and, on demand,
//! fingers.
//!
//! It shares no constant with the detector. The simulated plant has its own renderer.

use super::homography::{OUTLINE, Point};
use crate::cell::Intrinsics;
use crate::spatial::Pose;
use image::{Rgb, RgbImage};
use nalgebra::{Point3, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

/// Colours of a common cube's stickers (sRGB, 0..=255): white, red, green, yellow, orange, blue.
pub(crate) const STICKERS: [[f64; 3]; 6] = [
    [232.0, 232.0, 232.0],
    [180.0, 22.0, 40.0],
    [10.0, 150.0, 70.0],
    [240.0, 205.0, 20.0],
    [245.0, 100.0, 20.0],
    [15.0, 70.0, 165.0],
];

/// Scene to render.
pub(crate) struct Drawing {
    pub(crate) camera: Intrinsics,
    /// Edge of the cube (m).
    pub(crate) edge: f64,
    /// Faces: `camera_from_face`, and the numbers of the tiles' colours in [`STICKERS`].
    pub(crate) faces: Vec<(Pose, [u8; 9])>,
    /// Rectangles over a face, as of fingers: index of the face, (x0, y0, x1, y1) in pitches from
    /// its centre, colour.
    pub(crate) bars: Vec<(usize, [f64; 4], [f64; 3])>,
    /// Colour of all that is no cube.
    pub(crate) background: [f64; 3],
    /// Standard deviation of the noise, in levels of 255.
    pub(crate) noise: f64,
    /// Factor by which all colours are multiplied.
    pub(crate) light: f64,
    /// Seed of the noise.
    pub(crate) seed: u64,
}

impl Drawing {
    /// Makes a scene of these faces of a cube of 57 mm in usual light, with noise.
    pub(crate) fn new(camera: Intrinsics, faces: Vec<(Pose, [u8; 9])>) -> Self {
        Self {
            camera,
            edge: 0.057,
            faces,
            bars: Vec::new(),
            background: [96.0, 92.0, 84.0],
            noise: 3.0,
            light: 1.0,
            seed: 1,
        }
    }

    /// Renders the scene as its camera sees it. Near a face each pixel is the mean of 4x4 samples,
    /// elsewhere it is one sample.
    pub(crate) fn render(&self) -> RgbImage {
        let mut random = Pcg64::seed_from_u64(self.seed);
        let noise = Normal::new(0.0, self.noise).unwrap();
        let mut image = RgbImage::new(self.camera.width, self.camera.height);
        let bounds: Vec<[f64; 4]> = self.faces.iter().map(|(f, _)| self.bounds(f)).collect();
        for (x, y, pixel) in image.enumerate_pixels_mut() {
            let (fx, fy) = (f64::from(x), f64::from(y));
            let near = bounds.iter().any(|b| fx > b[0] && fx < b[2] && fy > b[1] && fy < b[3]);
            let mut colour = [0.0; 3];
            let n = if near { 4 } else { 1 };
            for i in 0..n * n {
                let offset = |k: i32| (f64::from(k) + 0.5) / f64::from(n) - 0.5;
                let at = (fx + offset(i % n), fy + offset(i / n));
                let sample = self.sample(at);
                for c in 0..3 {
                    colour[c] += sample[c] / f64::from(n * n);
                }
            }
            *pixel = Rgb(colour
                .map(|c| (c * self.light + noise.sample(&mut random)).clamp(0.0, 255.0) as u8));
        }
        image
    }

    /// Returns the part of the image in which a face can be seen: least x, least y, greatest x and
    /// greatest y (px), with a margin.
    fn bounds(&self, face: &Pose) -> [f64; 4] {
        let mut b = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        for (u, v) in OUTLINE {
            let s = 1.3 * self.edge / 3.0;
            let p = self.camera.project(&(face * Point3::new(u * s, v * s, 0.0)));
            b = [b[0].min(p.0), b[1].min(p.1), b[2].max(p.0), b[3].max(p.1)];
        }
        b
    }

    /// Returns the colour of the nearest surface that is seen at a point of the image (px), without
    /// noise.
    fn sample(&self, at: Point) -> [f64; 3] {
        let (x, y) = self.camera.unproject(at);
        let ray = Vector3::new(x, y, 1.0);
        let mut nearest = (f64::INFINITY, self.background);
        for (index, (face, colours)) in self.faces.iter().enumerate() {
            let normal = face.rotation * Vector3::z();
            let t = face.translation.vector.dot(&normal) / ray.dot(&normal);
            let p = face.inverse() * Point3::from(ray * t);
            let (u, v) = (p.x / self.edge * 3.0, p.y / self.edge * 3.0);
            if t <= 0.0 || t >= nearest.0 || ray.dot(&normal) <= 0.0 {
                continue;
            }
            let bar = self
                .bars
                .iter()
                .find(|(i, b, _)| *i == index && u > b[0] && v > b[1] && u < b[2] && v < b[3]);
            if let Some((_, _, colour)) = bar {
                nearest = (t, *colour);
            } else if u.abs() < 1.5 && v.abs() < 1.5 {
                let (cell_u, cell_v) = (u.round(), v.round());
                let index = ((cell_v + 1.0) * 3.0 + cell_u + 1.0) as usize;
                let inside = (u - cell_u).abs() < 0.43 && (v - cell_v).abs() < 0.43;
                let shade = 0.7 + 0.3 * normal.z;
                let base = if inside { STICKERS[usize::from(colours[index])] } else { [18.0; 3] };
                nearest = (t, base.map(|c| c * shade));
            }
        }
        nearest.1
    }
}
