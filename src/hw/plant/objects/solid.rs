//! Shape of an object as solid: its corners on a table, and the ball of a tip that meets it.
//!
//! - in: the parameters of an object
//! - out: points that can lie on a table, sizes between pads, depth and normal of a ball
//! - a lying cylinder rests on a prism of [`SIDES`] sides, and pads grip it like a box

use super::super::frame::{Frame, nearest_alignment, rotation_vector};
use super::contour::Contour;
use super::spec::{ObjectConfig, ObjectShape};
use crate::hw::scene::{HEIGHTS, SceneShape};
use nalgebra::{Matrix3, Vector3};
use rand_pcg::Pcg64;

/// Number of points on each rim of a cylinder.
const SIDES: u32 = 16;
/// Longest distance between two points of an edge that can lie on a support (m).
const SPACING: f64 = 0.02;
/// Most points of an edge.
const MOST_POINTS: f64 = 64.0;
/// Depth from which on a ball is beside or below a surface, not on it (m).
const DEEPEST: f64 = 0.02;

/// Shape of an object, in its own frame.
#[derive(Debug, Clone)]
pub(super) enum Solid {
    /// Box with these half sizes (m).
    Box(Vector3<f64>),
    /// Cylinder about z with its radius and half its length (m).
    Cylinder(f64, f64),
    /// Curved upper side, half its width along y, and the height of its middle (m).
    Surface(Contour, f64, f64),
}

/// Ball that overlaps a solid, in the frame of the solid.
#[derive(Debug, Clone, Copy)]
pub(super) struct Meeting {
    /// Depth (m).
    pub(super) depth: f64,
    /// Direction in which the solid pushes the ball.
    pub(super) normal: Vector3<f64>,
    /// Point of the solid (m).
    pub(super) at: Vector3<f64>,
}

impl Solid {
    /// Makes the shape of an object; `random` draws the contour of a surface.
    pub(super) fn new(spec: &ObjectConfig, random: &mut Pcg64) -> Self {
        let half = spec.size * 0.5;
        match &spec.shape {
            ObjectShape::Box => Self::Box(half),
            ObjectShape::Cylinder => Self::Cylinder(half.x, half.z),
            ObjectShape::Surface(profile) => {
                Self::Surface(Contour::new(profile, spec.size.x, random), half.y, spec.size.z)
            }
        }
    }

    /// Returns the shape as the cameras see it.
    pub(super) fn shape(&self) -> SceneShape {
        match self {
            Self::Box(half) => SceneShape::Box((*half).into()),
            Self::Cylinder(radius, half) => SceneShape::Cylinder { radius: *radius, half: *half },
            Self::Surface(contour, width, height) => {
                let long = contour.half();
                let place = |i: usize| long * (2.0 * i as f64 / (HEIGHTS - 1) as f64 - 1.0);
                SceneShape::Surface {
                    half: [long, *width],
                    heights: std::array::from_fn(|i| height + contour.at(place(i)).0),
                }
            }
        }
    }

    /// Returns the points that can lie on a table (m), and how many of them a level body has below
    /// it.
    pub(super) fn corners(&self) -> (Vec<Vector3<f64>>, f64) {
        match self {
            Self::Box(half) => {
                // Points along the longest edges let a long bar lie on two narrow supports.
                let long = half.imax();
                let count = (2.0 * half[long] / SPACING).ceil().clamp(1.0, MOST_POINTS);
                let mut corners = Vec::new();
                for step in 0..=count as u32 {
                    let share = f64::from(step) / count * 2.0 - 1.0;
                    for (a, b) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
                        let mut corner = Vector3::zeros();
                        corner[long] = share * half[long];
                        corner[(long + 1) % 3] = a * half[(long + 1) % 3];
                        corner[(long + 2) % 3] = b * half[(long + 2) % 3];
                        corners.push(corner);
                    }
                }
                (corners, 2.0 * (count + 1.0))
            }
            Self::Cylinder(radius, half) => {
                let rim = |i: u32| {
                    let angle = std::f64::consts::TAU * f64::from(i) / f64::from(SIDES);
                    let (s, c) = libm::sincos(angle);
                    [-half, *half].map(|z| Vector3::new(radius * c, radius * s, z))
                };
                ((0..SIDES).flat_map(rim).collect(), f64::from(SIDES))
            }
            Self::Surface(..) => (Vec::new(), 1.0),
        }
    }

    /// Returns the half sizes of the box around the solid (m).
    pub(super) fn half(&self) -> Vector3<f64> {
        match self {
            Self::Box(half) => *half,
            Self::Cylinder(radius, half) => Vector3::new(*radius, *radius, *half),
            Self::Surface(contour, width, height) => {
                Vector3::new(contour.half(), *width, 0.5 * height)
            }
        }
    }

    /// Returns the turn about the solid's own axis after which its sides are nearest to a tool's
    /// axes, and its sizes along these (m). `r` is the rotation of `tool_from_body`.
    pub(super) fn between_pads(&self, r: &Matrix3<f64>) -> (Matrix3<f64>, Vector3<f64>) {
        let mut turn = Matrix3::identity();
        if let Self::Cylinder(..) = self {
            // A cylinder has no sides of its own: it turns about its axis at will.
            for _ in 0..2 {
                let now = r * turn;
                let off = rotation_vector(&(now * nearest_alignment(&now).transpose()));
                let about = now.column(2).dot(&off);
                turn *= super::super::frame::about(&Vector3::z(), -about);
            }
        }
        let aligned = nearest_alignment(&(r * turn));
        let size = aligned.map(f64::abs) * self.half() * 2.0;
        (turn, size)
    }

    /// Returns the contact of a ball, whose `centre` (m) is in the solid's frame, or `None` if it
    /// does not touch.
    pub(super) fn meets(&self, centre: &Vector3<f64>, radius: f64) -> Option<Meeting> {
        let (at, normal, distance) = match self {
            Self::Box(half) => nearest_on_box(centre, half),
            Self::Cylinder(around, half) => {
                // In the half plane through the axis a cylinder is a rectangle.
                let out = centre.xy().norm();
                let side = if out > 1e-9 {
                    Vector3::new(centre.x / out, centre.y / out, 0.0)
                } else {
                    Vector3::x()
                };
                let flat = Vector3::new(*around, 1e9, *half);
                let (at, normal, distance) =
                    nearest_on_box(&Vector3::new(out, 0.0, centre.z), &flat);
                let back = |v: &Vector3<f64>| side * v.x + Vector3::z() * v.z;
                (back(&at), back(&normal), distance)
            }
            Self::Surface(contour, width, height) => {
                if centre.y.abs() > *width || centre.x.abs() > contour.half() + radius {
                    return None;
                }
                let s = contour.nearest(centre.x, centre.z - height);
                let (rise, slope) = contour.at(s);
                let at = Vector3::new(s, centre.y, height + rise);
                let up = Vector3::new(-slope, 0.0, 1.0).normalize();
                let out = centre - at;
                let distance = out.norm().copysign(out.dot(&up));
                // At an end of the contour the nearest point is not below the ball.
                let normal = if distance > 1e-9 { out / distance } else { up };
                (at, normal, distance)
            }
        };
        let depth = radius - distance;
        (depth > 0.0 && depth < radius + DEEPEST).then_some(Meeting { depth, normal, at })
    }

    /// Returns the frame and the half sizes of a box's level top, on which other bodies may lie.
    pub(super) fn top(&self, frame: &Frame) -> Option<(Frame, [f64; 2])> {
        let half = match self {
            Self::Surface(..) => return None,
            solid => solid.half(),
        };
        let level = frame.r[(2, 2)] > 1.0 - 1e-9;
        let top = Frame { r: frame.r, p: frame.point(&(Vector3::z() * half.z)) };
        level.then_some((top, [half.x, half.y]))
    }
}

/// Returns the nearest point of a box's surface to `centre`, the normal there, and the distance,
/// which is negative inside (m).
fn nearest_on_box(centre: &Vector3<f64>, half: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>, f64) {
    let near = Vector3::from_fn(|i, _| centre[i].clamp(-half[i], half[i]));
    let out = centre - near;
    let distance = out.norm();
    if distance > 1e-9 {
        return (near, out / distance, distance);
    }
    // Inside, the shortest way out decides.
    let way = Vector3::from_fn(|i, _| half[i] - centre[i].abs());
    let side = way.imin();
    let mut normal = Vector3::zeros();
    normal[side] = 1_f64.copysign(centre[side]);
    let mut at = near;
    at[side] = half[side].copysign(centre[side]);
    (at, normal, -way[side])
}

#[cfg(test)]
mod tests {
    use super::super::spec::Profile;
    use super::*;

    #[test]
    fn ball_meets_each_shape_by_its_overlap() {
        let half = Vector3::new(0.05, 0.03, 0.02);
        let flat = Profile::Points(vec![[-0.1, 0.0], [0.1, 0.0]]);
        let surface = Contour::new(&flat, 0.2, &mut Pcg64::new(1, 1));
        let solids = [
            (Solid::Box(half), Vector3::new(0.01, 0.0, 0.024), Vector3::z()),
            (Solid::Box(half), Vector3::new(0.054, 0.0, 0.0), Vector3::x()),
            (Solid::Cylinder(0.03, 0.02), Vector3::new(0.0, 0.034, 0.0), Vector3::y()),
            (Solid::Surface(surface, 0.05, 0.02), Vector3::new(0.03, 0.01, 0.024), Vector3::z()),
        ];
        for (solid, centre, normal) in solids {
            let meeting = solid.meets(&centre, 0.005).unwrap();

            assert!((meeting.depth - 1e-3).abs() < 1e-12, "{solid:?}: {meeting:?}");
            assert!((meeting.normal - normal).norm() < 1e-9, "{solid:?}: {meeting:?}");
            assert!(solid.meets(&centre, 0.003).is_none());
        }
    }

    #[test]
    fn cylinder_turns_its_sides_to_pads() {
        let solid = Solid::Cylinder(0.02, 0.05);
        for angle in [0.0, 0.3, 1.0, 2.5] {
            let r = super::super::super::frame::about(&Vector3::z(), angle);

            let (turn, size) = solid.between_pads(&r);

            let off = rotation_vector(&(r * turn * nearest_alignment(&(r * turn)).transpose()));
            assert!(off.norm() < 1e-9, "{angle}: {off}");
            assert_eq!(size, Vector3::new(0.04, 0.04, 0.1));
        }
    }
}
