//! What is behind everything: floor, walls and ceiling of a room, with things of awkward colours on them.
//!
//! - in: a ray in the world
//! - out: linear colour, lit

use super::look::{Look, Rgb};
use super::solids::Setting;
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

/// The room.
#[derive(Debug, Clone)]
pub(super) struct Backdrop {
    low: Point3<f64>,
    high: Point3<f64>,
    shapes: Vec<Shape>,
    cast: Rgb,
    light: f32,
}

/// Something flat on a wall.
#[derive(Debug, Clone)]
struct Shape {
    /// 0 x low, 1 x high, 2 y low, 3 y high.
    wall: usize,
    /// Along the wall and up (m).
    centre: (f64, f64),
    half: (f64, f64),
    round: bool,
    paint: Rgb,
}

impl Backdrop {
    pub(super) fn new(setting: &Setting, look: &Look) -> Self {
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
        let light = look.light.ambient + 0.35 * look.light.key;
        Self { low, high, shapes, cast: look.light.cast(), light }
    }

    /// Colour where a ray from `eye` meets the room.
    pub(super) fn colour(&self, eye: &Point3<f64>, ray: &Vector3<f64>) -> Rgb {
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
        let p = eye + ray * t.min(1e3);
        let (paint, shade) = match side {
            4 => (floor(&p), 0.75),
            5 => ([0.70, 0.70, 0.68], 0.9),
            wall => (self.wall(wall, &p), [0.95, 0.90, 1.0, 0.85][wall]),
        };
        std::array::from_fn(|c| paint[c] * shade * self.light * self.cast[c])
    }

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

fn floor(p: &Point3<f64>) -> Rgb {
    let tile = |x: f64| (x / 0.5).rem_euclid(1.0);
    let seam = tile(p.x).min(tile(p.y)) < 0.012;
    if seam { [0.16, 0.16, 0.15] } else { [0.27, 0.27, 0.26] }
}
