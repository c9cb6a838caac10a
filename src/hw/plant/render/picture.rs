//! An overview of the whole cell from outside, for the README and the operator.
//!
//! - in: a [`Scene`], the [`Setting`]
//! - out: a picture by plain ray tracing, with a broad lamp, light from the sky and smooth edges,
//!   and the cube enlarged in a corner; equal for equal inputs
//! - time: some seconds for a million pixels
//!
//! It shares only the solids with the ray caster of the cameras, so that a test can compare the
//! two. It works in `f64` and intersects each ray with each solid that may be near.

use super::look::{CubeLook, Look, Rgb};
use super::solids::{Plate, Rod, Skin, Solids};
use super::{Scene, Setting};
use crate::hw::scene::SceneObject;
use crate::spatial::{Pose, pose_from_axes};
use image::RgbImage;
use nalgebra::{Point3, Vector3};

/// Eye outside the cell: its pose and its magnification.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    world_from_eye: Pose,
    /// Focal length, as a multiple of the picture's height.
    focal: f64,
}

impl View {
    /// Returns a view from the open side of the cell. The picture contains both arms, table, cube
    /// and hand of the scene. `aspect` is its width over its height.
    #[must_use]
    pub fn of_cell(scene: &Scene, setting: &Setting, aspect: f64) -> Self {
        Self::around(&outline(scene, setting), aspect)
    }

    /// Returns a view from the open side of the cell whose picture contains all of `points`.
    /// `aspect` is the picture's width over its height.
    fn around(points: &[Point3<f64>], aspect: f64) -> Self {
        let first = points.first().copied().unwrap_or_default();
        let (mut low, mut high) = (first, first);
        for p in points {
            low = Point3::from(low.coords.inf(&p.coords));
            high = Point3::from(high.coords.sup(&p.coords));
        }
        let middle = nalgebra::center(&low, &high);
        // Beyond the ball around the points, so that each of them is in front of the eye.
        let eye = middle + open_side() * ((high - low).norm() * 1.25 + 1.0);
        let pose = looking(eye, &-open_side());
        // The aim is the middle of the directions to the points. The focal length is the
        // longest one with which all of them are in the picture.
        let seen = points.iter().map(|p| pose.inverse() * p).map(|p| (p.x / p.z, p.y / p.z));
        let seen: Vec<_> = seen.collect();
        let range = |pick: fn(&(f64, f64)) -> f64| {
            let low = seen.iter().map(pick).fold(f64::MAX, f64::min);
            (low, seen.iter().map(pick).fold(f64::MIN, f64::max))
        };
        let ((x0, x1), (y0, y1)) = (range(|p| p.0), range(|p| p.1));
        let aim = Vector3::new(f64::midpoint(x0, x1), f64::midpoint(y0, y1), 1.0).normalize();
        // Also covers the change of perspective by the new aim, which is a turn of the eye.
        let margin = 1.08;
        Self {
            world_from_eye: looking(eye, &(pose.rotation * aim)),
            focal: (aspect / (margin * (x1 - x0))).min(1.0 / (margin * (y1 - y0))),
        }
    }

    /// Returns a view from the open side of the cell. The picture contains the cube, and the hands
    /// beside it, in all `scenes`. `aspect` is its width over its height.
    #[must_use]
    pub fn of_hands(scenes: &[Scene], aspect: f64) -> Self {
        let points: Vec<_> = scenes.iter().flat_map(hands).collect();
        Self::around(&points, aspect)
    }

    /// Returns a view of the scene's cube from the open side of the cell. The picture is `edges`
    /// cube edges high.
    #[must_use]
    pub fn of_cube(scene: &Scene, edges: f64) -> Self {
        Self::towards_cube(scene, open_side(), edges)
    }

    /// Returns a view of the cube from the direction `away`, a unit vector from the cube to the
    /// eye. The picture is `edges` cube edges high.
    fn towards_cube(scene: &Scene, away: Vector3<f64>, edges: f64) -> Self {
        let cube = Point3::from(scene.cube.world_from_cube.translation.vector);
        // Far away in edges of the cube, so that its perspective is weak.
        let distance = 12.0 * scene.cube.edge;
        Self {
            world_from_eye: looking(cube + away * distance, &-away),
            focal: distance / (edges * scene.cube.edge),
        }
    }

    /// Returns the unit vector, in the world, of the ray through the point (x right, y down) of a
    /// picture. The point counts from the picture's middle, in picture heights.
    fn ray(&self, x: f64, y: f64) -> Vector3<f64> {
        self.world_from_eye.rotation * Vector3::new(x, y, self.focal).normalize()
    }

    /// Returns the place of the eye in the world.
    fn eye(&self) -> Point3<f64> {
        Point3::from(self.world_from_eye.translation.vector)
    }
}

/// Returns the unit vector from the cell to its open side: towards the operator (+x), the track arm
/// (-y) and up.
fn open_side() -> Vector3<f64> {
    Vector3::new(0.86, -0.42, 0.34).normalize()
}

/// Returns the pose of an eye that looks along `aim`, with the horizon level.
fn looking(eye: Point3<f64>, aim: &Vector3<f64>) -> Pose {
    // Straight up or down there is no horizon, so any direction to the right will do.
    let x = aim.cross(&Vector3::z()).try_normalize(1e-9).unwrap_or_else(Vector3::x);
    pose_from_axes(x, aim.cross(&x), *aim, eye)
}

/// Returns the points of a scene that a picture of the whole cell must contain.
fn outline(scene: &Scene, setting: &Setting) -> Vec<Point3<f64>> {
    let (half_x, half_y) = (setting.table_size.0 / 2.0, setting.table_size.1 / 2.0);
    let corner = |y: f64, z: f64| Point3::new(setting.table.x + half_x, setting.table.y + y, z);
    // The side of the table that faces the eye; the other side is between it and the arms.
    let mut points = vec![
        Point3::from(scene.cube.world_from_cube.translation.vector),
        corner(-half_y, setting.table.z),
        corner(half_y, setting.table.z),
        corner(-half_y, 0.0),
        corner(half_y, 0.0),
    ];
    for arm in &scene.arms[..scene.arm_count.min(scene.arms.len())] {
        // Links and foot are wider than the lines between these points.
        points.extend(arm.points);
        points.push(arm.points[0] + Vector3::new(0.25, 0.2, 0.0));
        points.push(arm.points[0] + Vector3::new(0.25, -0.2, 0.0));
        points.push(arm.points[2] + Vector3::z() * 0.12);
    }
    for camera in &setting.cameras {
        let camera = Point3::from(camera.translation.vector);
        points.extend([camera, Point3::new(camera.x + 0.2, camera.y, 0.0)]);
    }
    let object = |object: &SceneObject| Point3::from(object.world_from_object.translation.vector);
    points.extend(scene.objects.iter().flatten().map(object));
    points.extend(scene.hand.map(|hand| hand * Point3::new(0.35, 0.0, 0.0)));
    points
}

/// Distance from the cube up to which a wrist is part of a view of the hands (m).
const BESIDE: f64 = 0.9;

/// Returns the points of a scene that a picture of its hands must contain.
fn hands(scene: &Scene) -> Vec<Point3<f64>> {
    let cube = Point3::from(scene.cube.world_from_cube.translation.vector);
    let arms = scene.arms[..scene.arm_count.min(scene.arms.len())].iter();
    let wrists = arms.filter_map(|arm| arm.points.last().copied());
    let near = wrists.filter(|wrist| (wrist - cube).norm() < BESIDE);
    // Some room around the cube for fingers and the person's hand.
    let around = [-0.2, 0.2].map(|by| [Vector3::x() * by, Vector3::y() * by, Vector3::z() * by]);
    near.chain(around.into_iter().flatten().map(|by| cube + by)).collect()
}

/// Returns a picture of the cell: both arms, track, table and tray, cube, hand and the fixed
/// cameras. Its lower right corner shows the cube, enlarged.
#[must_use]
pub fn cell(scene: &Scene, setting: &Setting, width: u32, height: u32) -> RgbImage {
    let world = World::new(scene, setting, &Look::default());
    let aspect = f64::from(width) / f64::from(height);
    let view = View::of_cell(scene, setting, aspect);
    let side = (height.min(width) * 3 / 10).max(1);
    let (left, top) = (width - side - side / 20, height - side - side / 20);
    let cube = Point3::from(scene.cube.world_from_cube.translation.vector);
    // The inset looks from the same side, so that it shows the faces of the large picture.
    let inset = View::towards_cube(scene, (view.eye() - cube).normalize(), 4.0);
    RgbImage::from_fn(width, height, |column, row| {
        let (dx, dy) = (i64::from(column) - i64::from(left), i64::from(row) - i64::from(top));
        let within = |margin: i64| {
            let range = -margin..i64::from(side) + margin;
            range.contains(&dx) && range.contains(&dy)
        };
        if within(0) {
            world.pixel(&inset, (dx as u32, dy as u32), (side, side))
        } else if within(2) {
            image::Rgb([70, 70, 74])
        } else {
            world.pixel(&view, (column, row), (width, height))
        }
    })
}

/// Returns the places in the picture of [`cell`] (px: column, row) at which points of the world
/// appear, also those that something hides.
#[must_use]
pub fn places_in_cell(
    scene: &Scene,
    setting: &Setting,
    (width, height): (u32, u32),
    points: &[Point3<f64>],
) -> Vec<(f64, f64)> {
    let (width, height) = (f64::from(width), f64::from(height));
    let view = View::of_cell(scene, setting, width / height);
    let place = |point: &Point3<f64>| {
        let seen = view.world_from_eye.inverse() * point;
        let along = |value: f64| value / seen.z * view.focal * height;
        (width / 2.0 + along(seen.x), height / 2.0 + along(seen.y))
    };
    points.iter().map(place).collect()
}

/// Returns a picture of a scene from a view. The light's noise depends on the pixel alone, so parts
/// that do not change are equal to the bit in two pictures from one view.
#[must_use]
pub fn seen(scene: &Scene, setting: &Setting, view: &View, size: (u32, u32)) -> RgbImage {
    let world = World::new(scene, setting, &Look::default());
    RgbImage::from_fn(size.0, size.1, |column, row| world.pixel(view, (column, row), size))
}

/// Number of samples along each side of a pixel.
const GRID: u32 = 4;

/// Converts a linear brightness (1 = white) to 8 bits, with a soft shoulder for highlights.
fn coded(linear: f64) -> u8 {
    // Above 0.6 the curve approaches 1 with a continuous slope, so highlights keep their shape.
    let soft = if linear < 0.6 { linear } else { 1.0 - 0.4 * libm::exp((0.6 - linear) / 0.4) };
    (255.0 * libm::pow(soft.max(0.0), 1.0 / 2.2)).round() as u8
}

/// Point where a ray meets a surface.
struct Hit {
    /// Distance along the ray (m).
    t: f64,
    normal: Vector3<f64>,
    paint: Rgb,
    gloss: f32,
}

/// Solids in groups, with a ball around each group and each solid. Most rays miss the ball, which
/// is quicker to check than the solids.
struct World {
    groups: Vec<(Ball, Vec<(Ball, Solid)>)>,
    cube: CubeLook,
    lamp: Vector3<f64>,
}

/// Convex body.
enum Solid {
    Box(Vec<Plate>),
    Rod { rod: Rod, axis: Vector3<f64>, length: f64 },
}

/// Ball that contains a body or a group.
#[derive(Clone, Copy)]
struct Ball {
    centre: Point3<f64>,
    radius: f64,
}

impl Ball {
    /// Makes a ball that contains all of `balls`.
    fn around(balls: &[Ball]) -> Self {
        let sum = balls.iter().fold(Vector3::zeros(), |sum, ball| sum + ball.centre.coords);
        let centre = Point3::from(sum / balls.len().max(1) as f64);
        let reach = |ball: &Ball| (ball.centre - centre).norm() + ball.radius;
        Self { centre, radius: balls.iter().map(reach).fold(0.0, f64::max) }
    }

    /// Checks whether a ray of unit length may meet the ball before `limit` (m).
    fn may_meet(&self, from: &Point3<f64>, ray: &Vector3<f64>, limit: f64) -> bool {
        let to = self.centre - from;
        let along = to.dot(ray);
        let off = to.norm_squared() - along * along;
        // The line passes the centre within the radius, and the ball overlaps 0..limit along it.
        off < self.radius * self.radius && along > -self.radius && along - self.radius < limit
    }
}

/// Returns a ball around all solids, and each box and rod with its own ball.
fn group(solids: &Solids) -> (Ball, Vec<(Ball, Solid)>) {
    // A box is six plates in a row; a turned cube is three boxes.
    let boxes = solids.plates.chunks(6).map(|plates| {
        let corners = plates.iter().flat_map(Plate::corners);
        let balls: Vec<_> = corners.map(|centre| Ball { centre, radius: 0.0 }).collect();
        (Ball::around(&balls), Solid::Box(plates.to_vec()))
    });
    let rods = solids.rods.iter().map(|rod| {
        let ends = [rod.a, rod.b].map(|centre| Ball { centre, radius: rod.radius });
        let length = (rod.b - rod.a).norm();
        let axis = (rod.b - rod.a) / length.max(1e-9);
        (Ball::around(&ends), Solid::Rod { rod: *rod, axis, length })
    });
    let items: Vec<_> = boxes.chain(rods).collect();
    let balls: Vec<_> = items.iter().map(|item| item.0).collect();
    (Ball::around(&balls), items)
}

impl World {
    /// Collects the solids of a scene, a group for each body.
    fn new(scene: &Scene, setting: &Setting, look: &Look) -> Self {
        let mut groups = Vec::new();
        let mut add = |fill: &dyn Fn(&mut Solids)| {
            let mut solids = Solids::default();
            fill(&mut solids);
            groups.push(group(&solids));
        };
        add(&|s| s.add_cube(&scene.cube, &look.cube));
        add(&|s| s.add_furniture(setting));
        for (arm, gripper) in scene.arms.iter().zip(&setting.grippers).take(scene.arm_count) {
            add(&|s| s.add_gripper(arm, gripper));
            add(&|s| s.add_links(arm, gripper, look.arm));
        }
        if scene.arm_count > 0 {
            add(&|s| s.add_track(&scene.arms[0]));
        }
        for (index, object) in scene.objects.iter().enumerate() {
            if let Some(object) = object {
                add(&|s| s.add_object(object, index));
            }
        }
        if let Some(hand) = scene.hand {
            add(&|s| s.add_hand(&hand, &look.hand, scene.cube.edge));
        }
        for camera in &setting.cameras {
            add(&|s| s.add_camera_stand(camera));
        }
        let lamp = Vector3::new(0.55, -0.45, 1.0).normalize();
        Self { groups, cube: look.cube.clone(), lamp }
    }

    /// Returns the colour of the pixel (column, row) in a picture of (width, height) px, the mean
    /// of several samples.
    fn pixel(
        &self,
        view: &View,
        (column, row): (u32, u32),
        (width, height): (u32, u32),
    ) -> image::Rgb<u8> {
        let (eye, high) = (view.eye(), f64::from(height));
        let mut sum = [0.0_f64; 3];
        for k in 0..GRID * GRID {
            let x = (f64::from(k % GRID) + 0.5) / f64::from(GRID) - 0.5;
            let y = (f64::from(k / GRID) + 0.5) / f64::from(GRID) - 0.5;
            let x = (f64::from(column) + x - f64::from(width) / 2.0) / high;
            let y = (f64::from(row) + y - high / 2.0) / high;
            let colour = self.colour(&eye, &view.ray(x, y), k, Dice::new(column, row, k));
            for c in 0..3 {
                sum[c] += colour[c] / f64::from(GRID * GRID);
            }
        }
        image::Rgb(sum.map(coded))
    }

    /// Returns the linear colour that a ray of unit length from `eye` meets. `sample` is the index
    /// of the sample in its pixel, `dice` gives its random numbers.
    fn colour(
        &self,
        eye: &Point3<f64>,
        ray: &Vector3<f64>,
        sample: u32,
        mut dice: Dice,
    ) -> [f64; 3] {
        let Some(hit) = self.nearest(eye, ray) else { return sky(ray) };
        // Off the surface, so that the rays from here do not meet the surface itself.
        let p = eye + ray * hit.t + hit.normal * 1e-6;
        // A random point of a broad lamp: the mean of the samples is a soft shadow.
        let towards = (self.lamp + dice.ball() * 0.12).normalize();
        let facing = hit.normal.dot(&towards).max(0.0);
        let lit = if facing > 0.0 && !self.blocked(&p, &towards, 10.0) { facing } else { 0.0 };
        // A direction of the hemisphere, distributed by the cosine of its angle: the normal plus a
        // point of the unit sphere. An obstacle within 0.9 m takes most of the sky's light.
        let up = (hit.normal * 1.0001 + dice.sphere(sample)).normalize();
        let open = if self.blocked(&p, &up, 0.9) { 0.16 } else { 1.0 };
        let sky_light = (0.62 + 0.38 * up.z) * open;
        let mirrored = ray - hit.normal * (2.0 * ray.dot(&hit.normal));
        let shine = if lit > 0.0 {
            0.5 * f64::from(hit.gloss) * libm::pow(mirrored.dot(&self.lamp).max(0.0), 40.0)
        } else {
            0.0
        };
        let colour: [f64; 3] = std::array::from_fn(|c| {
            let tint = [1.0, 0.97, 0.92][c] * 0.85 * lit + [0.46, 0.48, 0.51][c] * sky_light;
            f64::from(hit.paint[c]) * tint + shine
        });
        // The floor has no border, so it fades into the sky with the distance.
        let fade = if p.z < 1e-4 { ((p - eye).norm() / 16.0).powi(3).min(1.0) } else { 0.0 };
        let far = sky(ray);
        std::array::from_fn(|c| colour[c] * (1.0 - fade) + far[c] * fade)
    }

    /// Finds the nearest surface that a ray of unit length meets, the floor included.
    fn nearest(&self, from: &Point3<f64>, ray: &Vector3<f64>) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        // Each hit lowers the limit, so that balls behind it are passed over.
        let mut limit = f64::MAX;
        for (ball, items) in &self.groups {
            if !ball.may_meet(from, ray, limit) {
                continue;
            }
            for (ball, solid) in items {
                if !ball.may_meet(from, ray, limit) {
                    continue;
                }
                match solid {
                    Solid::Box(plates) => {
                        for plate in plates {
                            if let Some((t, u, v)) = meet_plate(plate, from, ray, limit) {
                                limit = t;
                                let (paint, gloss) = self.surface(plate, u, v);
                                best = Some(Hit { t, normal: plate.normal, paint, gloss });
                            }
                        }
                    }
                    Solid::Rod { rod, axis, length } => {
                        if let Some((t, normal)) = meet_rod((rod, axis, *length), from, ray, limit)
                        {
                            limit = t;
                            best = Some(Hit { t, normal, paint: rod.paint, gloss: rod.gloss });
                        }
                    }
                }
            }
        }
        let t = -from.z / ray.z;
        if t > 0.0 && t < limit {
            let p = from + ray * t;
            // Tiles of 0.5 m with seams of 1 cm.
            let seam = |x: f64| ((x / 0.5).rem_euclid(1.0) - 0.5).abs() > 0.49;
            let paint = if seam(p.x) || seam(p.y) { [0.40; 3] } else { [0.50, 0.50, 0.49] };
            best = Some(Hit { t, normal: Vector3::z(), paint, gloss: 0.0 });
        }
        best
    }

    /// Checks whether a solid lies on a ray of unit length, less than `reach` (m) from its start.
    fn blocked(&self, from: &Point3<f64>, ray: &Vector3<f64>, reach: f64) -> bool {
        self.groups.iter().filter(|(ball, _)| ball.may_meet(from, ray, reach)).any(|(_, items)| {
            items.iter().filter(|(ball, _)| ball.may_meet(from, ray, reach)).any(|(_, s)| match s {
                Solid::Box(plates) => {
                    plates.iter().any(|plate| meet_plate(plate, from, ray, reach).is_some())
                }
                Solid::Rod { rod, axis, length } => {
                    meet_rod((rod, axis, *length), from, ray, reach).is_some()
                }
            })
        })
    }

    /// Returns the paint and the gloss of a plate at the plate coordinates (u, v).
    fn surface(&self, plate: &Plate, u: f64, v: f64) -> (Rgb, f32) {
        match &plate.skin {
            Skin::Plain(paint, gloss) => (*paint, *gloss),
            Skin::Stickers(colours, pitch) => {
                let (u, v) = (u / pitch, v / pitch);
                let (column, row) = (u.round().clamp(-1.0, 1.0), v.round().clamp(-1.0, 1.0));
                let half = self.cube.sticker / 2.0;
                let corner = self.cube.corner * self.cube.sticker;
                // A point is on the sticker if it is within a corner's radius of the square that
                // remains when the rounded border is taken away.
                let beyond = |w: f64| (w.abs() - half + corner).max(0.0);
                let (du, dv) = (beyond(u - column), beyond(v - row));
                if du * du + dv * dv > corner * corner {
                    (self.cube.body, 0.3)
                } else {
                    let cell = (row as i32 + 1) * 3 + column as i32 + 1;
                    (self.cube.stickers[colours[cell as usize] as usize], self.cube.gloss)
                }
            }
        }
    }
}

/// Returns the colour of the sky, which is brighter higher up.
fn sky(ray: &Vector3<f64>) -> [f64; 3] {
    let up = (ray.z * 1.6 + 0.45).clamp(0.0, 1.0);
    let (low, high) = ([0.60, 0.62, 0.64], [0.80, 0.84, 0.90]);
    std::array::from_fn(|c| low[c] + up * (high[c] - low[c]))
}

/// Returns where a ray meets the front of a plate before `limit` (m): its distance and the plate
/// coordinates, or `None`.
fn meet_plate(
    plate: &Plate,
    from: &Point3<f64>,
    ray: &Vector3<f64>,
    limit: f64,
) -> Option<(f64, f64, f64)> {
    let against = plate.normal.dot(ray);
    if against >= 0.0 {
        return None;
    }
    let t = plate.normal.dot(&(plate.origin - from)) / against;
    if t <= 0.0 || t >= limit {
        return None;
    }
    let p = from + ray * t - plate.origin;
    let (u, v) = (p.dot(&plate.u), p.dot(&plate.v));
    let [u0, u1, v0, v1] = plate.bounds;
    (u >= u0 && u <= u1 && v >= v0 && v <= v1).then_some((t, u, v))
}

/// Returns where a ray of unit length meets a rod before `limit` (m): the distance and the outward
/// normal, or `None`. `axis` is the rod's unit vector, `length` that between its ends (m).
fn meet_rod(
    (rod, axis, length): (&Rod, &Vector3<f64>, f64),
    from: &Point3<f64>,
    ray: &Vector3<f64>,
    limit: f64,
) -> Option<(f64, Vector3<f64>)> {
    let start = from - rod.a;
    let (along, slope) = (start.dot(axis), ray.dot(axis));
    // Across the axis the rod is a circle, along the axis a sphere at either end: both are one
    // quadratic equation, of the parts across the axis or of the whole vectors.
    let (off, sideways) = (start - axis * along, ray - axis * slope);
    let entry = |off: &Vector3<f64>, way: &Vector3<f64>| {
        let (a, b) = (way.norm_squared(), off.dot(way));
        let h = b * b - a * (off.norm_squared() - rod.radius * rod.radius);
        (h >= 0.0 && a > 1e-12).then(|| (-b - libm::sqrt(h)) / a)
    };
    let t = entry(&off, &sideways)?;
    // A ray that misses the infinite cylinder misses the spheres inside it.
    let s = along + slope * t;
    let (t, centre) = if s > 0.0 && s < length {
        (t, rod.a + axis * s)
    } else {
        let end = if s <= 0.0 { rod.a } else { rod.b };
        (entry(&(from - end), ray)?, end)
    };
    (t > 0.0 && t < limit).then(|| (t, (from + ray * t - centre) / rod.radius))
}

/// Returns the distance (m) to the first solid that a ray of unit length meets. Checks each solid,
/// without the balls around them.
#[cfg(test)]
pub(super) fn distance(solids: &Solids, from: &Point3<f64>, ray: &Vector3<f64>) -> Option<f64> {
    let (_, items) = group(solids);
    let met = items.iter().flat_map(|(_, solid)| match solid {
        Solid::Box(plates) => {
            plates.iter().filter_map(|p| meet_plate(p, from, ray, f64::MAX)).map(|m| m.0).collect()
        }
        Solid::Rod { rod, axis, length } => meet_rod((rod, axis, *length), from, ray, f64::MAX)
            .map(|m| m.0)
            .into_iter()
            .collect::<Vec<_>>(),
    });
    met.min_by(f64::total_cmp)
}

/// Pseudorandom numbers that depend on the pixel and the sample only.
struct Dice(u64);

impl Dice {
    /// Makes the random numbers of one sample of a pixel; equal arguments give equal numbers.
    fn new(column: u32, row: u32, sample: u32) -> Self {
        Self((u64::from(column) << 40) ^ (u64::from(row) << 16) ^ u64::from(sample))
    }

    /// Draws the next number in 0..1, by the steps of splitmix64.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Returns a random point in the unit ball, by rejection.
    fn ball(&mut self) -> Vector3<f64> {
        // A draw is outside with a probability of 0.48, so 20 of them fail once in three million.
        for _ in 0..20 {
            let v =
                Vector3::new(self.next(), self.next(), self.next()) * 2.0 - Vector3::repeat(1.0);
            if v.norm_squared() < 1.0 {
                return v;
            }
        }
        Vector3::zeros()
    }

    /// Returns a random point on the unit sphere, in the cell of the sphere that belongs to
    /// `sample`. So the samples of a pixel cover the whole sphere.
    fn sphere(&mut self, sample: u32) -> Vector3<f64> {
        let (column, row) = (f64::from(sample % GRID), f64::from(sample / GRID));
        // Cells of equal z and equal angle have equal areas (Archimedes).
        let z = 2.0 * (column + self.next()) / f64::from(GRID) - 1.0;
        let angle = std::f64::consts::TAU * (row + self.next()) / f64::from(GRID);
        let radius = libm::sqrt(1.0 - z * z);
        Vector3::new(radius * libm::cos(angle), radius * libm::sin(angle), z)
    }
}
