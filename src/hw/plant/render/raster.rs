//! Ray caster: finds the surface that each pixel's ray meets first, and its brightness there.
//!
//! Three linear functions of the ray's direction decide whether a ray meets a plate: the reciprocal
//! depth `w`, and the plate's coordinates times `w` (the inverse homography of the plate). So
//! visibility needs no division. For a rod the root of a quadratic equation decides.
//!
//! The aperture of a pixel is the pixel widened by the defocus. Edges between surfaces are resolved
//! by 4x4 or 2x2 samples that are spread over the aperture. Edges of stickers are resolved by their
//! signed distance over the same aperture, which costs one sample and is exact for straight edges
//! along rows and columns of the picture.
//!
//! - in: the rays of a camera, [`Solids`] and `camera_from_world`, a [`Look`]
//! - out: per touched pixel a linear colour, 1 = full scale before exposure

#![allow(clippy::inline_always, reason = "these functions are in the inner loops")]
#![allow(clippy::needless_bitwise_bool, reason = "branches would prevent vector instructions")]

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

/// Surfaces that a camera sees, and the one that is in front at each pixel.
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
    /// Largest reciprocal depth at each pixel (1/m), that of the nearest surface.
    depth: Vec<f32>,
    /// Number of the nearest surface at each pixel: 0 for none, then the facets, then the rounds.
    surface: Vec<u32>,
    /// Touched pixels of each row, from the first to before the second.
    spans: Vec<(usize, usize)>,
    /// Whether the last cast was of [`Extent::All`].
    is_whole: bool,
    /// Marks of one row: not 0 where a pixel lies beside another surface.
    edges: Vec<u32>,
    /// Colours of a run of neighbours; a field so that rows share its memory.
    colours: Vec<Rgb>,
}

/// A camera at its place: the rays of its pixels, its pose, and the look of the scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Eye<'a> {
    pub(super) rays: &'a Rays,
    pub(super) camera_from_world: &'a Pose,
    pub(super) look: &'a Look,
}

/// Pixels that a cast covers.
#[derive(Debug, Clone, Copy)]
pub(super) enum Extent<'a> {
    /// All pixels, in front of an infinitely distant background.
    All,
    /// Pixels that see a solid, in front of a background with these reciprocal depths (1/m), or an
    /// infinitely distant one with `None`.
    Before(Option<&'a [f32]>),
    /// Pixels of a rectangle that see a solid, in front of a background as in [`Extent::Before`].
    Inside(Window, Option<&'a [f32]>),
}

impl View {
    /// Makes an empty view of a camera with these rays.
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

    /// Finds the nearest of the solids' surfaces at each pixel of `extent`.
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
            // Edges look at the neighbours of a pixel, which the outermost pixels lack. The margin
            // of the window covers them, so nothing has changed there.
            let inner = clip.inner(rays);
            for (row, span) in self.spans.iter_mut().enumerate() {
                let inside = (inner.y0..inner.y1).contains(&row);
                *span = if inside { (span.0.max(inner.x0), span.1.min(inner.x1)) } else { (1, 0) };
            }
        }
    }

    /// Collects the surfaces that the camera sees inside `clip`, each with the rectangle of pixels
    /// that may show it. `None` is the whole picture.
    fn collect(&mut self, eye: Eye<'_>, solids: &Solids, clip: Option<Window>) {
        self.facets.clear();
        self.rounds.clear();
        self.windows.clear();
        // The windows are in the order of the surfaces' numbers: facets, then rounds.
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

    /// Resets the pixels that the next cast may touch to the background, whose reciprocal depths
    /// are `behind` (1/m), or 0 without them.
    fn clear_rows(&mut self, rays: &Rays, behind: Option<&[f32]>) {
        for row in 0..rays.height {
            // Edges also look at the rows above and below, one pixel beyond the span of each.
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

    /// Returns the pixels that may see a difference between two lists of the same solids, in the
    /// same order, or `None` if there is no difference.
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
                // Not by `facet`: a plate that shows its back in one list is also a difference.
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

    /// Returns the columns of a row in which a solid may be visible, `from..to`; they are none if
    /// `from >= to`.
    pub(super) fn span(&self, row: usize) -> (usize, usize) {
        self.spans[row]
    }

    /// Returns the reciprocal depth of each pixel (1/m), 0 where it sees no solid. Pixels outside
    /// the spans keep the values of earlier casts.
    pub(super) fn depth(&self) -> &[f32] {
        &self.depth
    }

    /// Extends the spans of the rows of a window by its columns. A window has a margin of two
    /// pixels, and half of the widest aperture is 1.5 pixels, so an aperture outside the spans sees
    /// no solid.
    fn touch(&mut self, window: Window) {
        for span in &mut self.spans[window.y0..window.y1] {
            *span = (span.0.min(window.x0), span.1.max(window.x1));
        }
    }

    /// Returns a plate as the camera sees it, and the rectangle of pixels that may show it, or
    /// `None` if the plate shows its back or is outside the picture.
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
        // On the plate's plane `normal . p = distance`, so the ray r = (x, y, 1) meets it at the
        // depth 1 / (w . r). There u . (p - origin) = (u . r) / (w . r) - u . origin, which becomes
        // linear in r when multiplied by w . r; the same is true of v.
        let w = normal / distance;
        let (u, v) = (rotation * plate.u, rotation * plate.v);
        let lamp = &self.lamp;
        let facing = normal.dot(&lamp.towards);
        // A mirrored ray meets the lamp at the angle at which the ray meets the mirrored lamp, and
        // the mirrored lamp is the same for the whole plate.
        let mirror =
            if facing > 0.0 { lamp.towards - normal * (2.0 * facing) } else { Vector3::zeros() };
        // Stickers have got the colour of the light once for all faces, in `set_light`.
        let skin = match plate.skin {
            Skin::Plain(rgb, gloss) => {
                Skin::Plain(std::array::from_fn(|c| rgb[c] * lamp.cast[c]), gloss)
            }
            stickers @ Skin::Stickers(..) => stickers,
        };
        let ambient = lamp.sky(normal.dot(&lamp.up) as f32);
        let key = lamp.key * facing.max(0.0) as f32;
        // Without a highlight and without the edge of a shadow, one paint has one colour all over.
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

    /// Returns a rod as the camera sees it, and the rectangle of pixels that may show it, or `None`
    /// if the rod is outside the picture or contains the camera.
    fn round(&self, rod: &Rod, eye: Eye<'_>) -> Option<(Round, Window)> {
        let Eye { rays, camera_from_world, .. } = eye;
        let (a, b) = (camera_from_world * rod.a, camera_from_world * rod.b);
        let r = rod.radius;
        let length = (b - a).norm();
        let along = (b - a).try_normalize(1e-9).unwrap_or_else(Vector3::x);
        let start = -along.dot(&a.coords);
        let nearest = a + along * start.clamp(0.0, length);
        if nearest.coords.norm() <= r + 1e-6 {
            // From inside the rod the ray enters it behind the camera.
            return None;
        }
        let before = |p: &Point3<f64>| p.z > r + NEAR;
        // Spheres that reach the camera's plane have no bounded extent in the picture.
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
            // A rod that reaches the camera's plane is too rare to be worth clipping.
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

    /// Stores number and depth of the facet `index` at those pixels of a window where it is nearer
    /// than all surfaces before it.
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
                // `&` and selects instead of branches let the compiler use vector instructions. A
                // plane behind the camera has a negative `near`, which is never above the depth.
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

    /// Stores number and depth of the rod `index` at those pixels of a window where it is nearer
    /// than all surfaces before it.
    fn cast_round(&mut self, index: usize, window: Window, rays: &Rays) {
        // A copy, because the compiler must otherwise assume that the loop's stores change it.
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

/// A plate as the camera sees it, in linear functions of the ray (x, y, 1).
#[derive(Debug, Clone)]
struct Facet {
    /// Reciprocal depth (1/m).
    w: V3,
    /// Plate coordinates times the reciprocal depth.
    u: V3,
    v: V3,
    bounds: [f32; 4],
    skin: Skin,
    /// Irradiance from all around.
    ambient: f32,
    /// Irradiance from the lamp, without shadow.
    key: f32,
    /// Direction of the mirrored lamp; its product with a ray of unit length is the cosine of the
    /// angle between them.
    mirror: V3,
    /// Colour of the whole plate, if it has only one.
    flat: Option<Rgb>,
}

/// A rod as the camera sees it; `along` is the unit vector from a to b (m).
#[derive(Debug, Clone, Copy)]
struct Round {
    a: V3,
    b: V3,
    along: V3,
    length: f32,
    per_radius: f32,
    /// Place of the camera along the axis, from a: `-along . a` (m).
    start: f32,
    /// Constant term of the equation of the cylinder: `a . a - (along . a)^2 - r^2` (m2).
    body: f32,
    /// Constant terms of the equations of the end spheres: `a . a - r^2`, `b . b - r^2` (m2).
    ends: (f32, f32),
    /// Products of a and of `along` with the direction of the lamp.
    lamp: (f32, f32),
    /// Products of a and of `along` with the upward direction.
    sky: (f32, f32),
    paint: Rgb,
    gloss: f32,
    /// Extents of the directions to both end spheres: low and high x, low and high y; `None` near
    /// the camera's plane.
    ends_extent: Option<[[f64; 4]; 2]>,
}

impl Round {
    /// Returns the reciprocal depth at which the ray (x, y, 1) enters the rod, or 0 if it does not.
    /// The function has no branches, so that the compiler turns a row into vector instructions.
    #[inline(always)]
    fn meet(&self, x: f32, y: f32) -> f32 {
        // `ba` is the unit axis, `rd` the ray, `oa` the vector from a to the camera. The ray enters
        // the infinite cylinder at the smaller root of a t^2 + 2 b t + body = 0.
        let bard = dot(&self.along, x, y);
        let rdoa = -dot(&self.a, x, y);
        let rdrd = x * x + (y * y + 1.0);
        let a = rdrd - bard * bard;
        let b = rdoa - self.start * bard;
        let h = b * b - a * self.body;
        let ahead = -b - h.max(0.0).sqrt();
        let along = self.start + bard * ahead / a;
        // Before a, or beyond b, the ray may enter the sphere at that end:
        // rdrd t^2 + 2 end_b t + end_c = 0.
        let beyond = along > 0.0;
        let end_b = if beyond { -dot(&self.b, x, y) } else { rdoa };
        let end_c = if beyond { self.ends.1 } else { self.ends.0 };
        let end_h = end_b * end_b - rdrd * end_c;
        let end_ahead = -end_b - end_h.max(0.0).sqrt();
        // `between` is positive where the cylinder is met between the ends.
        let between = if beyond { self.length - along } else { along };
        // The reciprocal depth 1 / t is a / ahead on the cylinder, rdrd / end_ahead on a sphere.
        let over = if between > 0.0 { a } else { rdrd };
        let under = if between > 0.0 { ahead } else { end_ahead };
        let end_h = if between > 0.0 { h } else { end_h };
        // A ray that misses the cylinder misses the spheres inside it, so no discriminant may be
        // negative. The last line turns NaN and roots behind the camera into 0.
        let worse = if h < end_h { h } else { end_h };
        let near = if worse >= 0.0 { over / under } else { 0.0 };
        if near > 0.0 { near } else { 0.0 }
    }
}
