//! The ray caster: which surface each pixel's ray meets first, and how bright it is there.
//!
//! A plate is met where three linear functions of the ray's direction say so: the reciprocal depth `w` and the
//! plate's coordinates times `w` (its inverse homography), so no division is needed for visibility. A rod is met
//! where a quadratic has a root. Edges between surfaces are resolved by 4x4 or 2x2 samples spread over the
//! pixel's aperture (the pixel widened by the defocus); edges of stickers by their signed distance over the same
//! aperture, which is exact for straight edges and costs one sample.
//!
//! - in: the rays of a camera, [`Solids`] and `camera_from_world`, a [`Look`]
//! - out: per touched pixel a linear colour, 1 = full scale before exposure

use super::look::{Look, Rgb};
use super::solids::{Plate, Rod, Skin, Solids};
use crate::cell::Intrinsics;
use crate::spatial::Pose;
use nalgebra::{Point3, Vector3};

/// Directions of all pixels' rays, z = 1, distortion undone.
#[derive(Debug, Clone)]
pub(super) struct Rays {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) x: Vec<f32>,
    pub(super) y: Vec<f32>,
    /// A pixel's step in x and y near the axis.
    pub(super) step: (f32, f32),
    intrinsics: Intrinsics,
    /// Extent of the directions: low and high x, low and high y.
    extent: [f64; 4],
}

impl Rays {
    /// Of a camera.
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

    /// Pixels `[x0, x1) x [y0, y1)` that may see points whose directions lie in a rectangle.
    fn window(&self, low: (f64, f64), high: (f64, f64)) -> Option<Window> {
        let [x0, x1, y0, y1] = self.extent;
        if high.0 < x0 || low.0 > x1 || high.1 < y0 || low.1 > y1 {
            return None;
        }
        let (x0, x1) = (low.0.max(x0), high.0.min(x1));
        let (y0, y1) = (low.1.max(y0), high.1.min(y1));
        let (xm, ym) = (f64::midpoint(x0, x1), f64::midpoint(y0, y1));
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
    /// Columns of a row that may see a rod: the hull of the two ends' extents.
    fn columns_of(&self, round: &Round, row: usize, window: Window) -> Option<(usize, usize)> {
        let Some([a, b]) = round.ends_extent else { return Some((window.x0, window.x1)) };
        let line = row * self.width;
        let y = [window.x0, usize::midpoint(window.x0, window.x1), window.x1 - 1]
            .map(|column| f64::from(self.y[line + column]));
        let margin = f64::from(self.step.1);
        let low = y[0].min(y[1]).min(y[2]) - margin;
        let high = y[0].max(y[1]).max(y[2]) + margin;
        // Shares s of the way from a to b whose extent meets low..high: two linear inequalities.
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

/// Which pixels a cast is about.
#[derive(Debug, Clone, Copy)]
pub(super) enum Extent<'a> {
    /// All, before nothing.
    All,
    /// Those that see a solid, before what is there already (its reciprocal depths).
    Before(Option<&'a [f32]>),
    /// The same inside a rectangle.
    Inside(Window, Option<&'a [f32]>),
}

/// A rectangle of pixels, without x1 and y1.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    x0: usize,
    x1: usize,
    y0: usize,
    y1: usize,
}

impl Window {
    /// The common part with another.
    fn within(self, other: Option<Self>) -> Option<Self> {
        let Some(other) = other else { return Some(self) };
        let (x0, x1) = (self.x0.max(other.x0), self.x1.min(other.x1));
        let (y0, y1) = (self.y0.max(other.y0), self.y1.min(other.y1));
        (x0 < x1 && y0 < y1).then_some(Self { x0, x1, y0, y1 })
    }

    /// Without the outermost pixels, except at the picture's border.
    pub(super) fn inner(self, rays: &Rays) -> Self {
        Self {
            x0: if self.x0 == 0 { 0 } else { self.x0 + 1 },
            x1: if self.x1 == rays.width { self.x1 } else { self.x1 - 1 },
            y0: if self.y0 == 0 { 0 } else { self.y0 + 1 },
            y1: if self.y1 == rays.height { self.y1 } else { self.y1 - 1 },
        }
    }

    /// Columns and rows.
    pub(super) fn ranges(self) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
        (self.x0..self.x1, self.y0..self.y1)
    }

    /// The rectangle around both.
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

type V3 = [f32; 3];

fn v3(v: Vector3<f64>) -> V3 {
    [v.x as f32, v.y as f32, v.z as f32]
}

#[inline(always)]
fn dot(a: &V3, x: f32, y: f32) -> f32 {
    a[0] * x + (a[1] * y + a[2])
}

/// A plate as seen by the camera.
#[derive(Debug, Clone)]
struct Facet {
    w: V3,
    u: V3,
    v: V3,
    bounds: [f32; 4],
    skin: Skin,
    /// Irradiance from all around and from the lamp.
    ambient: f32,
    key: f32,
    /// The mirrored lamp: the cosine of its angle to a ray is the product with the ray.
    mirror: V3,
    /// The colour, where it is the same all over.
    flat: Option<Rgb>,
}

/// A rod as seen by the camera; `along` is the unit vector from a to b.
#[derive(Debug, Clone, Copy)]
struct Round {
    a: V3,
    b: V3,
    along: V3,
    length: f32,
    per_radius: f32,
    /// -along . a; a . a - (along . a)^2 - r^2; |a|^2 - r^2; |b|^2 - r^2.
    start: f32,
    body: f32,
    ends: (f32, f32),
    /// Products of a and of along with the direction of the lamp, and with upwards.
    lamp: (f32, f32),
    sky: (f32, f32),
    paint: Rgb,
    gloss: f32,
    /// Directions of the two ends: low and high x, low and high y; `None` near the camera's plane.
    ends_extent: Option<[[f64; 4]; 2]>,
}

impl Round {
    /// Reciprocal depth where the ray (x, y, 1) enters, or 0. Without branches, so that rows become vectors.
    #[inline(always)]
    fn meet(&self, x: f32, y: f32) -> f32 {
        let bard = dot(&self.along, x, y);
        let rdoa = -dot(&self.a, x, y);
        let rdrd = x * x + (y * y + 1.0);
        let a = rdrd - bard * bard;
        let b = rdoa - self.start * bard;
        let h = b * b - a * self.body;
        let ahead = -b - h.max(0.0).sqrt();
        let along = self.start + bard * ahead / a;
        let beyond = along > 0.0;
        let end_b = if beyond { -dot(&self.b, x, y) } else { rdoa };
        let end_c = if beyond { self.ends.1 } else { self.ends.0 };
        let end_h = end_b * end_b - rdrd * end_c;
        let end_ahead = -end_b - end_h.max(0.0).sqrt();
        // Positive between the ends.
        let between = if beyond { self.length - along } else { along };
        let over = if between > 0.0 { a } else { rdrd };
        let under = if between > 0.0 { ahead } else { end_ahead };
        let end_h = if between > 0.0 { h } else { end_h };
        let worse = if h < end_h { h } else { end_h };
        let near = if worse >= 0.0 { over / under } else { 0.0 };
        if near > 0.0 { near } else { 0.0 }
    }
}

/// The light in the camera frame.
#[derive(Debug, Clone)]
struct Lamp {
    towards: Vector3<f64>,
    up: Vector3<f64>,
    towards_f32: V3,
    up_f32: V3,
    ambient: f32,
    key: f32,
    cast: Rgb,
    /// Shadow: plane's normal and offset over the softness, and depth.
    shadow: Option<(V3, f32, f32)>,
}

/// Surfaces seen by a camera, and who is in front at each pixel.
#[derive(Debug, Clone)]
pub(super) struct View {
    facets: Vec<Facet>,
    rounds: Vec<Round>,
    windows: Vec<Window>,
    lamp: Lamp,
    stickers: [Rgb; 6],
    body: Rgb,
    gloss: f32,
    /// Half a sticker and its corner radius as shares of a cubie's side.
    sticker: (f32, f32),
    /// Side of the aperture [px].
    aperture: f32,
    /// Nearest reciprocal depth and surface (0 none, then facets, then rounds) of each pixel.
    depth: Vec<f32>,
    surface: Vec<u32>,
    /// Touched pixels of each row.
    spans: Vec<(usize, usize)>,
    /// Of one row: not 0 where a pixel lies beside another surface.
    edges: Vec<u32>,
}

impl View {
    /// For rays of this number.
    pub(super) fn new(rays: &Rays) -> Self {
        let pixels = rays.width * rays.height;
        Self {
            facets: Vec::new(),
            rounds: Vec::new(),
            windows: Vec::new(),
            lamp: Lamp {
                towards: Vector3::z(),
                up: Vector3::z(),
                towards_f32: [0.0, 0.0, 1.0],
                up_f32: [0.0, 0.0, 1.0],
                ambient: 1.0,
                key: 0.0,
                cast: [1.0; 3],
                shadow: None,
            },
            stickers: [[0.0; 3]; 6],
            body: [0.0; 3],
            gloss: 0.0,
            sticker: (0.4, 0.05),
            aperture: 1.0,
            depth: vec![0.0; pixels],
            surface: vec![0; pixels],
            spans: vec![(usize::MAX, 0); rays.height],
            edges: Vec::new(),
        }
    }

    /// Finds who is in front.
    pub(super) fn look_at(
        &mut self,
        rays: &Rays,
        solids: &Solids,
        camera_from_world: &Pose,
        look: &Look,
        extent: Extent<'_>,
    ) {
        let (clip, behind) = match extent {
            Extent::All => (None, None),
            Extent::Before(behind) => (None, behind),
            Extent::Inside(clip, behind) => (Some(clip), behind),
        };
        self.set_light(camera_from_world, look);
        self.facets.clear();
        self.rounds.clear();
        self.windows.clear();
        let all = matches!(extent, Extent::All);
        self.spans.fill(if all { (0, rays.width) } else { (usize::MAX, 0) });
        for plate in &solids.plates {
            if let Some((facet, window)) = self.facet(plate, camera_from_world, rays) {
                let Some(window) = window.within(clip) else { continue };
                self.facets.push(facet);
                self.touch(window);
                self.windows.push(window);
            }
        }
        for rod in &solids.rods {
            if let Some((round, window)) = self.round(rod, camera_from_world, rays) {
                let Some(window) = window.within(clip) else { continue };
                self.rounds.push(round);
                self.touch(window);
                self.windows.push(window);
            }
        }
        for row in 0..rays.height {
            // As wide as the spans of the neighbour rows, which edges look at.
            let beside = &self.spans[row.max(1) - 1..(row + 2).min(rays.height)];
            let from = beside.iter().map(|span| span.0).min().unwrap_or(0);
            let to = beside.iter().map(|span| span.1).max().unwrap_or(0);
            if from >= to {
                continue;
            }
            let (from, to) = (from.max(1) - 1, (to + 1).min(rays.width));
            let (from, to) = (row * rays.width + from, row * rays.width + to);
            self.surface[from..to].fill(0);
            match behind {
                Some(behind) => self.depth[from..to].copy_from_slice(&behind[from..to]),
                None => self.depth[from..to].fill(0.0),
            }
        }
        for index in 0..self.facets.len() {
            self.cast_facet(index, self.windows[index], rays);
        }
        for index in 0..self.rounds.len() {
            self.cast_round(index, self.windows[self.facets.len() + index], rays);
        }
        if let Some(clip) = clip {
            // The outermost pixels lack neighbours; nothing has changed there.
            let inner = clip.inner(rays);
            for (row, span) in self.spans.iter_mut().enumerate() {
                let inside = (inner.y0..inner.y1).contains(&row);
                *span = if inside { (span.0.max(inner.x0), span.1.min(inner.x1)) } else { (1, 0) };
            }
        }
    }

    /// The pixels that may see what differs between two lists of the same solids; `None` when nothing does.
    pub(super) fn changed(
        &mut self,
        rays: &Rays,
        before: &Solids,
        after: &Solids,
        camera_from_world: &Pose,
        look: &Look,
    ) -> Option<Window> {
        self.set_light(camera_from_world, look);
        let mut changed = None;
        for (a, b) in before.plates.iter().zip(&after.plates) {
            if a.corners() != b.corners() {
                for plate in [a, b] {
                    let corners = plate.corners().map(|p| camera_from_world * p);
                    changed =
                        window_of_polygon(&corners, rays).map(|w| w.hull(changed)).or(changed);
                }
            }
        }
        for (a, b) in before.rods.iter().zip(&after.rods) {
            if (a.a, a.b) != (b.a, b.b) {
                for rod in [a, b] {
                    let seen = self.round(rod, camera_from_world, rays);
                    changed = seen.map(|(_, w)| w.hull(changed)).or(changed);
                }
            }
        }
        changed
    }

    /// Touched pixels of a row, `from..to`; empty when `from >= to`.
    pub(super) fn span(&self, row: usize) -> (usize, usize) {
        self.spans[row]
    }

    /// Reciprocal depth of a pixel, 0 where nothing is.
    pub(super) fn depth(&self) -> &[f32] {
        &self.depth
    }

    fn set_light(&mut self, camera_from_world: &Pose, look: &Look) {
        let rotation = &camera_from_world.rotation;
        let light = &look.light;
        let towards = light.key_direction.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        self.lamp = Lamp {
            towards_f32: v3(rotation * towards),
            up_f32: v3(rotation * Vector3::z()),
            towards: rotation * towards,
            up: rotation * Vector3::z(),
            ambient: light.ambient,
            key: light.key,
            cast: light.cast(),
            shadow: light.shadow.as_ref().map(|s| {
                let normal = rotation * s.normal.try_normalize(1e-9).unwrap_or_else(Vector3::x)
                    / s.softness.max(1e-6);
                let offset = normal.dot(&(camera_from_world * s.point).coords);
                (v3(normal), offset as f32, s.depth)
            }),
        };
        let cast = |rgb: Rgb| std::array::from_fn(|c| rgb[c] * self.lamp.cast[c]);
        self.stickers = look.cube.stickers.map(cast);
        self.body = cast(look.cube.body);
        self.gloss = look.cube.gloss;
        let half = look.cube.sticker as f32 / 2.0;
        self.sticker = (half, (look.cube.corner as f32 * 2.0 * half).min(half));
        self.aperture = aperture(look.lens.defocus);
    }

    /// Windows have margins of two pixels, so all that an aperture may see of a solid is inside.
    fn touch(&mut self, window: Window) {
        for span in &mut self.spans[window.y0..window.y1] {
            *span = (span.0.min(window.x0), span.1.max(window.x1));
        }
    }

    fn facet(
        &self,
        plate: &Plate,
        camera_from_world: &Pose,
        rays: &Rays,
    ) -> Option<(Facet, Window)> {
        let rotation = &camera_from_world.rotation;
        let normal = rotation * plate.normal;
        let origin = (camera_from_world * plate.origin).coords;
        let distance = normal.dot(&origin);
        if distance > -1e-6 {
            return None;
        }
        let corners = plate.corners().map(|p| camera_from_world * p);
        let window = window_of_polygon(&corners, rays)?;
        let w = normal / distance;
        let (u, v) = (rotation * plate.u, rotation * plate.v);
        let lamp = &self.lamp;
        let facing = normal.dot(&lamp.towards);
        let mirror =
            if facing > 0.0 { lamp.towards - normal * (2.0 * facing) } else { Vector3::zeros() };
        let skin = match plate.skin {
            Skin::Plain(rgb, gloss) => {
                Skin::Plain(std::array::from_fn(|c| rgb[c] * lamp.cast[c]), gloss)
            }
            stickers @ Skin::Stickers(..) => stickers,
        };
        let ambient = lamp.sky(normal.dot(&lamp.up) as f32);
        let key = lamp.key * facing.max(0.0) as f32;
        let flat = match skin {
            Skin::Plain(rgb, gloss) if (gloss == 0.0 || key == 0.0) && lamp.shadow.is_none() => {
                Some(rgb.map(|c| c * (ambient + key)))
            }
            _ => None,
        };
        let facet = Facet {
            flat,
            w: v3(w),
            u: v3(u - w * u.dot(&origin)),
            v: v3(v - w * v.dot(&origin)),
            bounds: plate.bounds.map(|b| b as f32),
            skin,
            ambient,
            key,
            mirror: v3(mirror),
        };
        Some((facet, window))
    }

    fn round(&self, rod: &Rod, camera_from_world: &Pose, rays: &Rays) -> Option<(Round, Window)> {
        let (a, b) = (camera_from_world * rod.a, camera_from_world * rod.b);
        let r = rod.radius;
        let length = (b - a).norm();
        let along = (b - a).try_normalize(1e-9).unwrap_or_else(Vector3::x);
        let start = -along.dot(&a.coords);
        let nearest = a + along * start.clamp(0.0, length);
        if nearest.coords.norm() <= r + 1e-6 {
            // The camera is inside.
            return None;
        }
        let before = |p: &Point3<f64>| p.z > r + NEAR;
        let ends_extent = (before(&a) && before(&b)).then(|| {
            [a, b].map(|p| {
                let ((x0, x1), (y0, y1)) = (sphere_extent(p.x, p.z, r), sphere_extent(p.y, p.z, r));
                [x0, x1, y0, y1]
            })
        });
        let window = if let Some([a, b]) = ends_extent {
            rays.window((a[0].min(b[0]), a[2].min(b[2])), (a[1].max(b[1]), a[3].max(b[3])))?
        } else if a.z < -r && b.z < -r {
            return None;
        } else {
            // Reaches the camera's plane: rare, so no effort.
            Window { x0: 0, x1: rays.width, y0: 0, y1: rays.height }
        };
        let round = Round {
            a: v3(a.coords),
            b: v3(b.coords),
            along: v3(along),
            length: length as f32,
            per_radius: (1.0 / r) as f32,
            start: start as f32,
            body: (a.coords.norm_squared() - start * start - r * r) as f32,
            ends: (
                (a.coords.norm_squared() - r * r) as f32,
                (b.coords.norm_squared() - r * r) as f32,
            ),
            lamp: (a.coords.dot(&self.lamp.towards) as f32, along.dot(&self.lamp.towards) as f32),
            sky: (a.coords.dot(&self.lamp.up) as f32, along.dot(&self.lamp.up) as f32),
            ends_extent,
            paint: rod.paint,
            gloss: rod.gloss,
        };
        Some((round, window))
    }

    fn cast_facet(&mut self, index: usize, window: Window, rays: &Rays) {
        let facet = &self.facets[index];
        let id = index as u32 + 1;
        let (w, u, v, [u0, u1, v0, v1]) = (facet.w, facet.u, facet.v, facet.bounds);
        for row in window.y0..window.y1 {
            let range = row * rays.width + window.x0..row * rays.width + window.x1;
            let directions = rays.x[range.clone()].iter().zip(&rays.y[range.clone()]);
            let pixels = self.depth[range.clone()].iter_mut().zip(&mut self.surface[range]);
            for ((x, y), (depth, surface)) in directions.zip(pixels) {
                let (x, y) = (*x, *y);
                let near = dot(&w, x, y);
                let (du, dv) = (dot(&u, x, y), dot(&v, x, y));
                let seen = (near > *depth)
                    & (du >= u0 * near)
                    & (du <= u1 * near)
                    & (dv >= v0 * near)
                    & (dv <= v1 * near);
                *depth = if seen { near } else { *depth };
                *surface = if seen { id } else { *surface };
            }
        }
    }

    fn cast_round(&mut self, index: usize, window: Window, rays: &Rays) {
        // A copy, so that the loop's stores cannot be taken for changes of it.
        let round = self.rounds[index];
        let id = (self.facets.len() + index) as u32 + 1;
        for row in window.y0..window.y1 {
            let Some((x0, x1)) = rays.columns_of(&round, row, window) else { continue };
            let range = row * rays.width + x0..row * rays.width + x1;
            let directions = rays.x[range.clone()].iter().zip(&rays.y[range.clone()]);
            let pixels = self.depth[range.clone()].iter_mut().zip(&mut self.surface[range]);
            for ((x, y), (depth, surface)) in directions.zip(pixels) {
                let near = round.meet(*x, *y);
                let seen = near > *depth;
                *depth = if seen { near } else { *depth };
                *surface = if seen { id } else { *surface };
            }
        }
    }

    /// Colours a touched row: `put(column, colour)` for each pixel that differs from the background, and,
    /// if `all`, for the background too.
    pub(super) fn colour_row(
        &mut self,
        rays: &Rays,
        row: usize,
        background: &[Rgb],
        all: bool,
        mut put: impl FnMut(usize, Rgb),
    ) {
        let (from, to) = self.spans[row];
        let width = rays.width;
        let line = row * width;
        if from >= to {
            return;
        }
        let mut edges = std::mem::take(&mut self.edges);
        self.find_edges(row, width, &mut edges);
        let mut column = from;
        while column < to {
            let pixel = line + column;
            if edges[column] != 0 {
                let around = Window {
                    x0: column.max(1) - 1,
                    x1: (column + 2).min(width),
                    y0: row.max(1) - 1,
                    y1: (row + 2).min(rays.height),
                };
                put(column, self.edge(rays, pixel, around, background[pixel]));
                column += 1;
                continue;
            }
            let id = self.surface[pixel];
            let run =
                (column..to).take_while(|c| edges[*c] == 0 && self.surface[line + c] == id).count();
            let columns = column..column + run;
            column += run;
            let index = (id as usize).wrapping_sub(1);
            if id == 0 {
                if all {
                    columns.for_each(|c| put(c, background[line + c]));
                }
            } else if let Some(facet) = self.facets.get(index) {
                if let Some(colour) = facet.flat {
                    columns.for_each(|c| put(c, colour));
                } else {
                    for c in columns {
                        let (x, y) = (rays.x[line + c], rays.y[line + c]);
                        put(c, self.shade_facet(facet, x, y, rays.step));
                    }
                }
            } else {
                let round = &self.rounds[index - self.facets.len()];
                for c in columns {
                    let pixel = line + c;
                    put(
                        c,
                        self.shade_round(round, rays.x[pixel], rays.y[pixel], self.depth[pixel]),
                    );
                }
            }
        }
        self.edges = edges;
    }

    /// Marks the pixels of a row's span some of whose eight neighbours show another surface.
    fn find_edges(&self, row: usize, width: usize, edges: &mut Vec<u32>) {
        let (from, to) = self.spans[row];
        edges.resize(width, 0);
        let (left, right) = (from.max(1), to.min(width - 1));
        let height = self.spans.len();
        let own = &self.surface[row * width..(row + 1) * width];
        edges[from] = 0;
        edges[to - 1] = 0;
        let mut first = true;
        for beside in row.max(1) - 1..(row + 2).min(height) {
            let other = &self.surface[beside * width..(beside + 1) * width];
            let neighbours = own[left..right]
                .iter()
                .zip(&other[left - 1..right - 1])
                .zip(other[left..right].iter().zip(&other[left + 1..=right]));
            for (edge, ((id, a), (b, c))) in edges[left..right].iter_mut().zip(neighbours) {
                let differs = (a ^ id) | (b ^ id) | (c ^ id);
                *edge = if first { differs } else { *edge | differs };
            }
            first = false;
        }
    }

    /// Mixes the surfaces of a neighbourhood by the share of the aperture that each covers.
    fn edge(&self, rays: &Rays, pixel: usize, around: Window, background: Rgb) -> Rgb {
        let mut ids = [0_u32; MAX_SURFACES];
        let mut at = [pixel; MAX_SURFACES];
        let mut count = 1;
        let mut far = 0.0_f32;
        for row in around.y0..around.y1 {
            for column in around.x0..around.x1 {
                let near = row * rays.width + column;
                let id = self.surface[near];
                if id == 0 && near == pixel {
                    far = self.depth[near];
                }
                if let Some(k) = ids[..count].iter().position(|known| *known == id) {
                    if near == pixel {
                        at[k] = near;
                    }
                } else if count < MAX_SURFACES {
                    ids[count] = id;
                    at[count] = near;
                    count += 1;
                }
            }
        }
        if count == 1 {
            return background;
        }
        let around = Neighbours { ids: &ids[..count], at: &at[..count], far };
        let (x, y) = (rays.x[pixel], rays.y[pixel]);
        let step = (rays.step.0 * self.aperture, rays.step.1 * self.aperture);
        if !ids[1..count].iter().any(|id| self.is_sticker_face(*id)) {
            let who = self.winners(&around, [x, y], step, &SAMPLES_4);
            return self.mix(rays, pixel, &around, &who, background);
        }
        // Most pixels beside an edge have it outside their aperture: the corners tell.
        let corners = self.winners(&around, [x, y], step, &SAMPLES_CORNERS);
        if corners.iter().all(|who| *who == corners[0]) {
            return self.mix(rays, pixel, &around, &corners[..1], background);
        }
        let who = self.winners(&around, [x, y], step, &SAMPLES_16);
        self.mix(rays, pixel, &around, &who, background)
    }

    /// Mean colour of the samples' winners.
    #[inline(always)]
    fn mix(
        &self,
        rays: &Rays,
        pixel: usize,
        around: &Neighbours<'_>,
        winners: &[u32],
        background: Rgb,
    ) -> Rgb {
        let mut weights = [0_u32; MAX_SURFACES];
        for winner in winners {
            weights[*winner as usize] += 1;
        }
        let mut colour = [0.0; 3];
        for (k, id) in around.ids.iter().enumerate() {
            if weights[k] > 0 {
                let index = (*id as usize).wrapping_sub(1);
                let own = if k == 0 {
                    background
                } else if let Some(facet) = self.facets.get(index) {
                    let (x, y) = (rays.x[pixel], rays.y[pixel]);
                    facet.flat.unwrap_or_else(|| self.shade_facet(facet, x, y, rays.step))
                } else {
                    let round = &self.rounds[index - self.facets.len()];
                    let at = around.at[k];
                    self.shade_round(round, rays.x[at], rays.y[at], self.depth[at])
                };
                for c in 0..3 {
                    colour[c] += weights[k] as f32 * own[c];
                }
            }
        }
        let share = 1.0 / winners.len() as f32;
        colour.map(|c| c * share)
    }

    /// Which of the neighbours' surfaces each sample of an aperture meets first.
    #[inline(always)]
    fn winners<const N: usize>(
        &self,
        around: &Neighbours<'_>,
        [x, y]: [f32; 2],
        step: (f32, f32),
        samples: &[[f32; N]; 2],
    ) -> [u32; N] {
        let dx: [f32; N] = std::array::from_fn(|k| x + step.0 * samples[0][k]);
        let dy: [f32; N] = std::array::from_fn(|k| y + step.1 * samples[1][k]);
        let mut best = [around.far; N];
        let mut who = [0_u32; N];
        for (mark, id) in around.ids.iter().enumerate().skip(1) {
            let index = *id as usize - 1;
            let mut near = [0.0_f32; N];
            if let Some(facet) = self.facets.get(index) {
                let (w, u, v, [u0, u1, v0, v1]) = (facet.w, facet.u, facet.v, facet.bounds);
                for k in 0..N {
                    let depth = dot(&w, dx[k], dy[k]);
                    let (du, dv) = (dot(&u, dx[k], dy[k]), dot(&v, dx[k], dy[k]));
                    let inside = (du >= u0 * depth)
                        & (du <= u1 * depth)
                        & (dv >= v0 * depth)
                        & (dv <= v1 * depth);
                    near[k] = if inside { depth } else { 0.0 };
                }
            } else {
                let round = self.rounds[index - self.facets.len()];
                for k in 0..N {
                    near[k] = round.meet(dx[k], dy[k]);
                }
            }
            for k in 0..N {
                let seen = near[k] > best[k];
                best[k] = if seen { near[k] } else { best[k] };
                who[k] = if seen { mark as u32 } else { who[k] };
            }
        }
        who
    }

    fn is_sticker_face(&self, id: u32) -> bool {
        let index = (id as usize).wrapping_sub(1);
        self.facets.get(index).is_some_and(|f| matches!(f.skin, Skin::Stickers(..)))
    }

    #[inline(always)]
    fn shade_facet(&self, facet: &Facet, x: f32, y: f32, step: (f32, f32)) -> Rgb {
        let near = dot(&facet.w, x, y);
        let t = 1.0 / near;
        let lit = self.lamp.lit(x, y, t);
        let (albedo, gloss) = match &facet.skin {
            Skin::Plain(rgb, gloss) => (*rgb, *gloss),
            Skin::Stickers(colours, pitch) => {
                (self.stickers_at(facet, colours, *pitch as f32, x, y, t, step), self.gloss)
            }
        };
        let light = facet.ambient + facet.key * lit;
        let shine = gloss * lit * self.lamp.key * highlight(&facet.mirror, x, y);
        std::array::from_fn(|c| albedo[c] * light + shine * self.lamp.cast[c])
    }

    /// Colour of stickers and body around the point that a ray meets, averaged over the aperture.
    #[allow(clippy::too_many_arguments, reason = "the shader's locals, in registers")]
    #[inline(always)]
    fn stickers_at(
        &self,
        facet: &Facet,
        colours: &[u8; 9],
        pitch: f32,
        x: f32,
        y: f32,
        t: f32,
        step: (f32, f32),
    ) -> Rgb {
        let (u, v) = (dot(&facet.u, x, y) * t, dot(&facet.v, x, y) * t);
        let per = 1.0 / pitch;
        let (u, v) = (u * per, v * per);
        // Cell -1, 0, 1, and the place in it, -0.5..0.5.
        let cell = |w: f32| f32::from(i8::from(w > 0.5) - i8::from(w < -0.5));
        let (column, row) = (cell(u), cell(v));
        let (du, dv) = (u - column, v - row);
        let (half, corner) = self.sticker;
        let colour = |column: f32, row: f32| {
            let cell = (row as i32 + 1) * 3 + column as i32 + 1;
            self.stickers[colours[cell as usize] as usize]
        };
        let core = half - corner;
        let (distance, _, _) = rounded(du, dv, core, corner);
        // Size of the aperture on the face, in cells: the gradient of (u, v) over the image.
        let (gu, gv) = (per * t * self.aperture * step.0, per * t * self.aperture * step.1);
        let ux = (facet.u[0] - u * pitch * facet.w[0]) * gu;
        let uy = (facet.u[1] - u * pitch * facet.w[1]) * gv;
        let vx = (facet.v[0] - v * pitch * facet.w[0]) * gu;
        let vy = (facet.v[1] - v * pitch * facet.w[1]) * gv;
        let most = (ux * ux + uy * uy + vx * vx + vy * vy).sqrt() * 0.5;
        if distance < -most {
            return colour(column, row);
        }
        let cover = |du: f32, dv: f32| {
            let (distance, nu, nv) = rounded(du, dv, core, corner);
            let (gx, gy) = (nu * ux + nv * vx, nu * uy + nv * vy);
            let wide = (gx * gx + gy * gy).sqrt().max(1e-9);
            (0.5 - distance / wide).clamp(0.0, 1.0)
        };
        let mut rgb = [0.0; 3];
        let mut rest = 1.0_f32;
        let mut add = |column: f32, row: f32| {
            if column.abs() <= 1.0 && row.abs() <= 1.0 {
                let share = cover(u - column, v - row).min(rest);
                if share > 0.0 {
                    let c = colour(column, row);
                    for k in 0..3 {
                        rgb[k] += share * c[k];
                    }
                    rest -= share;
                }
            }
        };
        add(column, row);
        add(column + if du > 0.0 { 1.0 } else { -1.0 }, row);
        add(column, row + if dv > 0.0 { 1.0 } else { -1.0 });
        std::array::from_fn(|c| rgb[c] + rest * self.body[c])
    }

    /// The normal n is (p - a - s along) / r; its products are formed without n itself.
    #[inline(always)]
    fn shade_round(&self, round: &Round, x: f32, y: f32, near: f32) -> Rgb {
        let lamp = &self.lamp;
        let t = 1.0 / near;
        let (along, ahead) = (dot(&round.along, x, y), dot(&lamp.towards_f32, x, y));
        let s = (round.start + t * along).clamp(0.0, round.length);
        let per = round.per_radius;
        let facing = (t * ahead - round.lamp.0 - s * round.lamp.1) * per;
        let up = (t * dot(&lamp.up_f32, x, y) - round.sky.0 - s * round.sky.1) * per;
        let lit = lamp.lit(x, y, t);
        let light = lamp.sky(up) + lamp.key * facing.max(0.0) * lit;
        let mut shine = 0.0;
        if facing > 0.0 && round.gloss > 0.0 {
            let square = x * x + (y * y + 1.0);
            let inward = (t * square - dot(&round.a, x, y) - s * along) * per;
            let mirrored = ahead - 2.0 * inward * facing;
            shine = round.gloss * lit * lamp.key * power(mirrored, square);
        }
        std::array::from_fn(|c| (round.paint[c] * light + shine) * lamp.cast[c])
    }
}

/// Surfaces that one pixel's neighbourhood can tell apart.
const MAX_SURFACES: usize = 8;

/// The surfaces around a pixel; the first is the background, with its reciprocal depth.
struct Neighbours<'a> {
    ids: &'a [u32],
    /// A pixel where each can be seen.
    at: &'a [usize],
    far: f32,
}

/// Places of samples in the aperture: columns and rows.
const SAMPLES_16: [[f32; 16]; 2] = {
    let mut samples = [[0.0; 16]; 2];
    let mut k = 0;
    while k < 16 {
        samples[0][k] = (k % 4) as f32 * 0.25 - 0.375;
        samples[1][k] = (k / 4) as f32 * 0.25 - 0.375;
        k += 1;
    }
    samples
};
const SAMPLES_4: [[f32; 4]; 2] = [[-0.25, 0.25, -0.25, 0.25], [-0.25, -0.25, 0.25, 0.25]];
const SAMPLES_CORNERS: [[f32; 4]; 2] =
    [[-0.375, 0.375, -0.375, 0.375], [-0.375, -0.375, 0.375, 0.375]];

impl Lamp {
    /// Light from all around on a surface whose normal has this upward part.
    fn sky(&self, up: f32) -> f32 {
        self.ambient * if self.key > 0.0 { 0.82 + 0.18 * up } else { 1.0 }
    }

    /// Share of the lamp's light that reaches the point t (x, y, 1).
    #[inline(always)]
    fn lit(&self, x: f32, y: f32, t: f32) -> f32 {
        match &self.shadow {
            None => 1.0,
            Some((normal, offset, depth)) => {
                1.0 - depth * (0.5 + dot(normal, x, y) * t - offset).clamp(0.0, 1.0)
            }
        }
    }
}

/// The 32nd power of the cosine between a ray and the mirrored lamp.
#[inline(always)]
fn highlight(mirror: &V3, x: f32, y: f32) -> f32 {
    power(dot(mirror, x, y), x * x + y * y + 1.0)
}

/// The 32nd power of `along` over the root of `square`.
#[inline(always)]
fn power(along: f32, square: f32) -> f32 {
    let along = along.max(0.0);
    if along * along < 0.6 * square {
        return 0.0;
    }
    let square = along * along / square;
    let p4 = square * square;
    let p8 = p4 * p4;
    let p16 = p8 * p8;
    p16 * p16
}

/// Signed distance to a square with round corners and its gradient; `core` is half the side without corners.
#[inline(always)]
fn rounded(u: f32, v: f32, core: f32, corner: f32) -> (f32, f32, f32) {
    let (qu, qv) = (u.abs() - core, v.abs() - core);
    if qu > 0.0 && qv > 0.0 {
        let length = (qu * qu + qv * qv).sqrt();
        (length - corner, qu.copysign(u) / length, qv.copysign(v) / length)
    } else if qu > qv {
        (qu - corner, 1.0_f32.copysign(u), 0.0)
    } else {
        (qv - corner, 0.0, 1.0_f32.copysign(v))
    }
}

/// Side of the square whose variance is that of a pixel blurred by `defocus` [px].
fn aperture(defocus: f64) -> f32 {
    libm::sqrt(1.0 + 12.0 * defocus.clamp(0.0, 0.8).powi(2)) as f32
}

/// Least depth that is drawn [m].
const NEAR: f64 = 0.01;

fn window_of_polygon(corners: &[Point3<f64>; 4], rays: &Rays) -> Option<Window> {
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
        if (a.z > NEAR) != (b.z > NEAR) {
            take(&(a + (b - a) * ((NEAR - a.z) / (b.z - a.z))));
        }
    }
    rays.window(low, high)
}

/// Extent of a sphere's directions x/z: tangents from the eye in the x-z plane.
fn sphere_extent(x: f64, z: f64, r: f64) -> (f64, f64) {
    let (d2, root) = (z * z - r * r, libm::sqrt(x * x + z * z - r * r));
    ((x * z - r * root) / d2, (x * z + r * root) / d2)
}
