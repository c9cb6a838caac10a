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

#![allow(clippy::inline_always, reason = "the inner loops are these functions")]
#![allow(clippy::needless_bitwise_bool, reason = "branches keep the loops from becoming vectors")]

mod lamp;
mod resolve;
mod shade;
mod vector;

use super::look::{Look, Rgb};
use super::rays::{NEAR, Rays, Window, sphere_extent, window_of_polygon};
use super::solids::{Plate, Rod, Skin, Solids};
use crate::spatial::Pose;
use lamp::Lamp;
use nalgebra::{Point3, Vector3};
use vector::{V3, dot, v3};

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
    /// Side of the aperture (px).
    aperture: f32,
    /// Nearest reciprocal depth and surface (0 none, then facets, then rounds) of each pixel.
    depth: Vec<f32>,
    surface: Vec<u32>,
    /// Touched pixels of each row.
    spans: Vec<(usize, usize)>,
    /// Whether the last cast was of [`Extent::All`].
    is_whole: bool,
    /// Of one row: not 0 where a pixel lies beside another surface.
    edges: Vec<u32>,
    /// Colours of a run of neighbours.
    colours: Vec<Rgb>,
}

/// A camera at its place: the rays of its pixels, its pose, and how things look to it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Eye<'a> {
    pub(super) rays: &'a Rays,
    pub(super) camera_from_world: &'a Pose,
    pub(super) look: &'a Look,
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
            is_whole: false,
            edges: Vec::new(),
            colours: Vec::new(),
        }
    }

    /// Finds the nearest surface of each pixel.
    pub(super) fn look_at(&mut self, eye: Eye<'_>, solids: &Solids, extent: Extent<'_>) {
        let rays = eye.rays;
        let (clip, behind) = match extent {
            Extent::All => (None, None),
            Extent::Before(behind) => (None, behind),
            Extent::Inside(clip, behind) => (Some(clip), behind),
        };
        self.set_light(eye.camera_from_world, eye.look);
        self.is_whole = matches!(extent, Extent::All);
        self.spans.fill(if self.is_whole { (0, rays.width) } else { (usize::MAX, 0) });
        self.collect(eye, solids, clip);
        self.clear_rows(rays, behind);
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

    /// Collects the surfaces that the camera sees inside `clip`, and their windows.
    fn collect(&mut self, eye: Eye<'_>, solids: &Solids, clip: Option<Window>) {
        self.facets.clear();
        self.rounds.clear();
        self.windows.clear();
        for plate in &solids.plates {
            if let Some((facet, window)) = self.facet(plate, eye) {
                let Some(window) = window.within(clip) else { continue };
                self.facets.push(facet);
                self.touch(window);
                self.windows.push(window);
            }
        }
        for rod in &solids.rods {
            if let Some((round, window)) = self.round(rod, eye) {
                let Some(window) = window.within(clip) else { continue };
                self.rounds.push(round);
                self.touch(window);
                self.windows.push(window);
            }
        }
    }

    /// Puts the pixels that will be touched back to what is behind them.
    fn clear_rows(&mut self, rays: &Rays, behind: Option<&[f32]>) {
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
    }

    /// Returns the pixels that may see what differs between two lists of the same solids; `None`
    /// when nothing does.
    pub(super) fn changed(
        &mut self,
        eye: Eye<'_>,
        before: &Solids,
        after: &Solids,
    ) -> Option<Window> {
        let Eye { rays, camera_from_world, look } = eye;
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
                    let seen = self.round(rod, eye);
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

    /// Windows have margins of two pixels, so all that an aperture may see of a solid is inside.
    fn touch(&mut self, window: Window) {
        for span in &mut self.spans[window.y0..window.y1] {
            *span = (span.0.min(window.x0), span.1.max(window.x1));
        }
    }

    /// Returns a plate as the camera sees it, and its window; `None` if it shows its back or is
    /// outside the picture.
    fn facet(&self, plate: &Plate, eye: Eye<'_>) -> Option<(Facet, Window)> {
        let Eye { rays, camera_from_world, .. } = eye;
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

    /// Returns a rod as the camera sees it, and its window; `None` if it is outside the picture or
    /// the camera is inside it.
    fn round(&self, rod: &Rod, eye: Eye<'_>) -> Option<(Round, Window)> {
        let Eye { rays, camera_from_world, .. } = eye;
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
            let Some((x0, x1)) = rays.columns_of(round.ends_extent, row, window) else { continue };
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
