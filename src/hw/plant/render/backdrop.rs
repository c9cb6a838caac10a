//! Background of the cameras: floor, walls and ceiling of a room, with red, orange and yellow
//! shapes on the walls.
//!
//! - in: a ray in the world
//! - out: linear colour, lit
//!
//! The shapes have colours of the cube, so that the detector meets regions that are not stickers.

use super::look::{Look, Rgb};
use super::solids::Setting;
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

/// Room around the cell.
#[derive(Debug, Clone)]
pub(super) struct Backdrop {
    /// Corners with the lowest and the highest coordinates, in the world (m).
    low: Point3<f64>,
    high: Point3<f64>,
    shapes: Vec<Shape>,
    /// Factors of red, green and blue by which the light and the white balance colour the picture.
    cast: Rgb,
    /// Irradiance on the sides of the room.
    light: f32,
}

/// Flat rectangle or ellipse on a wall.
#[derive(Debug, Clone)]
struct Shape {
    /// Number of the wall: 0 low x, 1 high x, 2 low y, 3 high y.
    wall: usize,
    /// Centre along the wall and up (m).
    centre: (f64, f64),
    /// Half the size along the wall and up (m).
    half: (f64, f64),
    /// Whether the shape is an ellipse.
    round: bool,
    paint: Rgb,
}

impl Backdrop {
    /// Makes the room of a setting, with the shapes and the light of a look.
    pub(super) fn new(setting: &Setting, look: &Look) -> Self {
        // "wall" in ASCII: the shapes must not repeat the numbers of another use of the seed.
        let mut rng = Pcg64::seed_from_u64(look.distractor_seed ^ 0x7761_6c6c);
        let (low, high) = setting.room;
        let paints: [Rgb; 3] = [[0.50, 0.03, 0.03], [0.80, 0.20, 0.02], [0.75, 0.58, 0.03]];
        let shapes = (0..look.distractors)
            .map(|k| {
                let wall = rng.random_range(0..4);
                let along = if wall < 2 { (low.y, high.y) } else { (low.x, high.x) };
                let half = rng.random_range(0.05..0.22);
                Shape {
                    wall,
                    centre: (rng.random_range(along.0..along.1), rng.random_range(0.5..1.9)),
                    half: (half, half * rng.random_range(0.5..1.4)),
                    round: rng.random_bool(0.3),
                    paint: paints[k % 3].map(|c| c * rng.random_range(0.8..1.2)),
                }
            })
            .collect();
        // The room is shaded by its sides, not by the angle to the lamp, so a share of the lamp
        // counts for all of them.
        let light = look.light.ambient + 0.35 * look.light.key;
        Self { low, high, shapes, cast: look.light.cast(), light }
    }

    /// Returns the colour where a ray from `eye` meets the room.
    pub(super) fn colour(&self, eye: &Point3<f64>, ray: &Vector3<f64>) -> Rgb {
        // From inside a box, a ray leaves through the nearest of the three planes it moves towards.
        let mut t = f64::MAX;
        let mut side = 0;
        for axis in 0..3 {
            let (bound, index) = if ray[axis] > 0.0 {
                (self.high[axis], 2 * axis + 1)
            } else {
                (self.low[axis], 2 * axis)
            };
            let hit = (bound - eye[axis]) / ray[axis];
            if hit > 0.0 && hit < t {
                (t, side) = (hit, index);
            }
        }
        // Bounded for an eye outside the room, whose ray may meet no plane.
        let p = eye + ray * t.min(1e3);
        let (paint, shade) = match side {
            // Each side is lit a little differently, so that the corners of the room are edges.
            4 => (floor(&p), 0.75),
            5 => ([0.70, 0.70, 0.68], 0.9),
            wall => (self.wall(wall, &p), [0.95, 0.90, 1.0, 0.85][wall]),
        };
        std::array::from_fn(|c| paint[c] * shade * self.light * self.cast[c])
    }

    /// Returns the paint at a point of a wall (0 low x, 1 high x, 2 low y, 3 high y): that of a
    /// coloured shape, or of one of three stripes.
    fn wall(&self, wall: usize, p: &Point3<f64>) -> Rgb {
        let along = if wall < 2 { p.y } else { p.x };
        for shape in self.shapes.iter().filter(|s| s.wall == wall) {
            let (u, v) =
                ((along - shape.centre.0) / shape.half.0, (p.z - shape.centre.1) / shape.half.1);
            let inside =
                if shape.round { u * u + v * v < 1.0 } else { u.abs() < 1.0 && v.abs() < 1.0 };
            if inside {
                return shape.paint;
            }
        }
        if p.z < 0.12 {
            [0.18, 0.18, 0.19]
        } else if p.z < 1.1 {
            [0.36, 0.40, 0.40]
        } else {
            [0.56, 0.57, 0.54]
        }
    }
}

/// Returns the paint of the floor: tiles of 0.5 m with seams.
fn floor(p: &Point3<f64>) -> Rgb {
    let tile = |x: f64| (x / 0.5).rem_euclid(1.0);
    let seam = tile(p.x).min(tile(p.y)) < 0.012;
    if seam { [0.16, 0.16, 0.15] } else { [0.27, 0.27, 0.26] }
}
