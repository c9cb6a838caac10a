//! Rays of a camera's pixels, and rectangles of pixels that may see a given solid.
//!
//! - in: [`Intrinsics`]
//! - out: directions with the distortion undone; windows around polygons and rods

use crate::cell::Intrinsics;
use nalgebra::Point3;

/// Directions of the rays of all pixels, with z = 1 and without distortion.
#[derive(Debug, Clone)]
pub(super) struct Rays {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) x: Vec<f32>,
    pub(super) y: Vec<f32>,
    /// Step of one pixel in x and y near the optical axis.
    pub(super) step: (f32, f32),
    intrinsics: Intrinsics,
    /// Extent of the directions: low and high x, low and high y.
    extent: [f64; 4],
}

impl Rays {
    /// Computes the rays of all pixels of a camera.
    pub(super) fn new(intrinsics: &Intrinsics) -> Self {
        let (width, height) = (intrinsics.width as usize, intrinsics.height as usize);
        let (mut x, mut y) = (vec![0.0; width * height], vec![0.0; width * height]);
        let mut extent = [f64::MAX, f64::MIN, f64::MAX, f64::MIN];
        for row in 0..height {
            for column in 0..width {
                let (dx, dy) = intrinsics.unproject((column as f64, row as f64));
                let [x0, x1, y0, y1] = extent;
                extent = [x0.min(dx), x1.max(dx), y0.min(dy), y1.max(dy)];
                x[row * width + column] = dx as f32;
                y[row * width + column] = dy as f32;
            }
        }
        let step = ((1.0 / intrinsics.focal.0) as f32, (1.0 / intrinsics.focal.1) as f32);
        Self { width, height, x, y, step, intrinsics: *intrinsics, extent }
    }

    /// Returns the pixels that may see directions (x/z, y/z) from `low` to `high`, with a margin of
    /// two pixels, or `None` if these directions are outside the picture.
    pub(super) fn window(&self, low: (f64, f64), high: (f64, f64)) -> Option<Window> {
        let [x0, x1, y0, y1] = self.extent;
        if high.0 < x0 || low.0 > x1 || high.1 < y0 || low.1 > y1 {
            return None;
        }
        // Clipped before it is projected: far outside the picture the polynomial of the distortion
        // turns back, and would project the corners into the picture.
        let (x0, x1) = (low.0.max(x0), high.0.min(x1));
        let (y0, y1) = (low.1.max(y0), high.1.min(y1));
        let (xm, ym) = (f64::midpoint(x0, x1), f64::midpoint(y0, y1));
        // The distortion bends the rectangle's sides, so their middles count as well as corners.
        let (mut left, mut right) = (f64::MAX, f64::MIN);
        let (mut top, mut bottom) = (f64::MAX, f64::MIN);
        for (x, y) in
            [(x0, y0), (xm, y0), (x1, y0), (x0, ym), (x1, ym), (x0, y1), (xm, y1), (x1, y1)]
        {
            let (px, py) = self.intrinsics.project(&Point3::new(x, y, 1.0));
            (left, right) = (left.min(px), right.max(px));
            (top, bottom) = (top.min(py), bottom.max(py));
        }
        let clip = |low: f64, high: f64, size: usize| {
            let (low, high) = (low.floor() - 2.0, high.ceil() + 3.0);
            (low.clamp(0.0, size as f64) as usize, high.clamp(0.0, size as f64) as usize)
        };
        let ((x0, x1), (y0, y1)) = (clip(left, right, self.width), clip(top, bottom, self.height));
        (x0 < x1 && y0 < y1).then_some(Window { x0, x1, y0, y1 })
    }
}

impl Rays {
    /// Returns the columns of a picture row that may see a rod, `from..to`, or `None` without any.
    /// `ends` has for either end of the rod the extent of its directions: low and high x/z, then
    /// low and high y/z. Without `ends` the result is the columns of `window`.
    pub(super) fn columns_of(
        &self,
        ends: Option<[[f64; 4]; 2]>,
        row: usize,
        window: Window,
    ) -> Option<(usize, usize)> {
        // A rod's image is the convex hull of the images of its end spheres, so it lies in the hull
        // of their two rectangles. For a slanted rod this is far smaller than its window.
        let Some([a, b]) = ends else { return Some((window.x0, window.x1)) };
        // With distortion the pixels of a row have different y: these are sampled at three columns.
        let line = row * self.width;
        let y = [window.x0, usize::midpoint(window.x0, window.x1), window.x1 - 1]
            .map(|column| f64::from(self.y[line + column]));
        let margin = f64::from(self.step.1);
        let low = y[0].min(y[1]).min(y[2]) - margin;
        let high = y[0].max(y[1]).max(y[2]) + margin;
        // Shares s of the path from a to b at which the rectangle overlaps low..high. Its low side
        // must be below `high`, its high side above `low`: two linear inequalities in s.
        let (mut from, mut to) = (0.0_f64, 1.0_f64);
        for (at_a, at_b) in [(high - a[2], high - b[2]), (a[3] - low, b[3] - low)] {
            if at_a < 0.0 && at_b < 0.0 {
                return None;
            }
            let zero = at_a / (at_a - at_b);
            if at_a < 0.0 {
                from = from.max(zero);
            } else if at_b < 0.0 {
                to = to.min(zero);
            }
        }
        if from > to {
            return None;
        }
        let at = |k: usize, s: f64| a[k] + s * (b[k] - a[k]);
        let (x0, x1) = (at(0, from).min(at(0, to)), at(1, from).max(at(1, to)));
        let pixel = |x: f64, y: f64| self.intrinsics.project(&Point3::new(x, y, 1.0)).0;
        let [e0, e1, ..] = self.extent;
        let (x0, x1) = (x0.clamp(e0, e1), x1.clamp(e0, e1));
        let left = pixel(x0, low).min(pixel(x0, high)).floor() - 2.0;
        let right = pixel(x1, low).max(pixel(x1, high)).ceil() + 3.0;
        let clip = |x: f64| (x.max(0.0) as usize).clamp(window.x0, window.x1);
        let (left, right) = (clip(left), clip(right));
        (left < right).then_some((left, right))
    }
}

/// Rectangle of pixels `[x0, x1) x [y0, y1)`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    pub(super) x0: usize,
    pub(super) x1: usize,
    pub(super) y0: usize,
    pub(super) y1: usize,
}

impl Window {
    /// Returns the intersection with `other`, or `None` if it is empty. `None` as `other` is no
    /// limit.
    pub(super) fn within(self, other: Option<Self>) -> Option<Self> {
        let Some(other) = other else { return Some(self) };
        let (x0, x1) = (self.x0.max(other.x0), self.x1.min(other.x1));
        let (y0, y1) = (self.y0.max(other.y0), self.y1.min(other.y1));
        (x0 < x1 && y0 < y1).then_some(Self { x0, x1, y0, y1 })
    }

    /// Returns the rectangle without its outermost pixels, except those on the picture's border.
    pub(super) fn inner(self, rays: &Rays) -> Self {
        Self {
            x0: if self.x0 == 0 { 0 } else { self.x0 + 1 },
            x1: if self.x1 == rays.width { self.x1 } else { self.x1 - 1 },
            y0: if self.y0 == 0 { 0 } else { self.y0 + 1 },
            y1: if self.y1 == rays.height { self.y1 } else { self.y1 - 1 },
        }
    }

    /// Returns the rectangle's range of columns and its range of rows.
    pub(super) fn ranges(self) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
        (self.x0..self.x1, self.y0..self.y1)
    }

    /// Returns the smallest rectangle that contains this one and `other`.
    pub(super) fn hull(self, other: Option<Self>) -> Self {
        let Some(other) = other else { return self };
        Self {
            x0: self.x0.min(other.x0),
            x1: self.x1.max(other.x1),
            y0: self.y0.min(other.y0),
            y1: self.y1.max(other.y1),
        }
    }
}

/// Smallest depth that is drawn (m).
pub(super) const NEAR: f64 = 0.01;

/// Returns the pixels that may see a polygon with these four corners in the camera frame (m),
/// clipped at the depth [`NEAR`], or `None` outside the picture.
pub(super) fn window_of_polygon(corners: &[Point3<f64>; 4], rays: &Rays) -> Option<Window> {
    let (mut low, mut high) = ((f64::MAX, f64::MAX), (f64::MIN, f64::MIN));
    let mut take = |p: &Point3<f64>| {
        let (x, y) = (p.x / p.z, p.y / p.z);
        low = (low.0.min(x), low.1.min(y));
        high = (high.0.max(x), high.1.max(y));
    };
    for (k, a) in corners.iter().enumerate() {
        let b = &corners[(k + 1) % 4];
        if a.z > NEAR {
            take(a);
        }
        // A side that crosses the clipping plane is visible up to the crossing.
        if (a.z > NEAR) != (b.z > NEAR) {
            take(&(a + (b - a) * ((NEAR - a.z) / (b.z - a.z))));
        }
    }
    rays.window(low, high)
}

/// Returns the smallest and the largest direction x/z at which the eye sees a sphere of radius `r`
/// whose centre is at (x, z) in front of the eye (z > r).
pub(super) fn sphere_extent(x: f64, z: f64, r: f64) -> (f64, f64) {
    // Slopes k of the tangents from the eye in the x-z plane: (x - k z)^2 = r^2 (1 + k^2).
    let (d2, root) = (z * z - r * r, libm::sqrt(x * x + z * z - r * r));
    ((x * z - r * root) / d2, (x * z + r * root) / d2)
}
