//! Shading: the colour of a surface where a ray meets it, from lamp, sky, mirrored lamp, shadow
//! edge and stickers.

use super::lamp::Lamp;
use super::vector::{V3, dot, v3};
use super::{Facet, Round, View};
use crate::hw::plant::render::look::{Look, Rgb};
use crate::hw::plant::render::solids::Skin;
use crate::spatial::Pose;
use nalgebra::Vector3;

/// A ray (x, y, 1) that meets a surface at `t` (x, y, 1); `step` is the distance of the neighbour
/// rays in x and y.
struct Ray {
    x: f32,
    y: f32,
    t: f32,
    step: (f32, f32),
}

impl View {
    /// Sets the light, in the camera frame, and the look of the cube under it.
    pub(super) fn set_light(&mut self, camera_from_world: &Pose, look: &Look) {
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
                // Distances from the edge are then in widths of the transition.
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
        // The corner is given as a share of the sticker's side, and is kept as a share of a cubie's
        // side. Beyond half a sticker it would not be a corner.
        let half = look.cube.sticker as f32 / 2.0;
        self.sticker = (half, (look.cube.corner as f32 * 2.0 * half).min(half));
        self.aperture = aperture(look.lens.defocus);
    }

    /// Returns the colour of a facet where the ray (x, y, 1) meets it. `step` is the distance to
    /// the rays of the neighbouring pixels in x and y.
    #[inline(always)]
    pub(super) fn shade_facet(&self, facet: &Facet, x: f32, y: f32, step: (f32, f32)) -> Rgb {
        let near = dot(&facet.w, x, y);
        let t = 1.0 / near;
        let lit = self.lamp.lit(x, y, t);
        let (albedo, gloss) = match &facet.skin {
            Skin::Plain(rgb, gloss) => (*rgb, *gloss),
            Skin::Stickers(colours, pitch) => {
                let ray = Ray { x, y, t, step };
                (self.stickers_at(facet, colours, *pitch as f32, &ray), self.gloss)
            }
        };
        // A highlight has the colour of the lamp, not that of the paint.
        let light = facet.ambient + facet.key * lit;
        let shine = gloss * lit * self.lamp.key * highlight(&facet.mirror, x, y);
        std::array::from_fn(|c| albedo[c] * light + shine * self.lamp.cast[c])
    }

    /// Returns the colour of the cube's face where a ray meets it: stickers and plastic, averaged
    /// over the aperture. `pitch` is the side of a cubie (m).
    #[inline(always)]
    fn stickers_at(&self, facet: &Facet, colours: &[u8; 9], pitch: f32, ray: &Ray) -> Rgb {
        let Ray { x, y, t, step } = *ray;
        let (u, v) = (dot(&facet.u, x, y) * t, dot(&facet.v, x, y) * t);
        let per = 1.0 / pitch;
        let (u, v) = (u * per, v * per);
        // Cell -1, 0 or 1, and the place in it, -0.5..0.5 or more beyond the face's border.
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
        // Extent of the aperture on the face, in cells: the gradient of (u, v) over the image. With
        // u = (U . r) / (W . r) the gradient is (U - u W) / (W . r), and likewise for v.
        let (gu, gv) = (per * t * self.aperture * step.0, per * t * self.aperture * step.1);
        let ux = (facet.u[0] - u * pitch * facet.w[0]) * gu;
        let uy = (facet.u[1] - u * pitch * facet.w[1]) * gv;
        let vx = (facet.v[0] - v * pitch * facet.w[0]) * gu;
        let vy = (facet.v[1] - v * pitch * facet.w[1]) * gv;
        // The Frobenius norm bounds the reach of the aperture in any direction. A sticker whose
        // edge is farther away fills the aperture; this is the usual case.
        let most = (ux * ux + uy * uy + vx * vx + vy * vy).sqrt() * 0.5;
        if distance < -most {
            return colour(column, row);
        }
        // Share of the aperture that a sticker covers: a linear ramp, as wide as the aperture is
        // across the sticker's edge.
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
        // An aperture may also reach the nearest sticker beside this one and the nearest above or
        // below. The diagonal one is farther away and is neglected. The rest shows the body.
        add(column, row);
        add(column + if du > 0.0 { 1.0 } else { -1.0 }, row);
        add(column, row + if dv > 0.0 { 1.0 } else { -1.0 });
        std::array::from_fn(|c| rgb[c] + rest * self.body[c])
    }

    /// Returns the colour of a rod where the ray (x, y, 1) meets it, at the point p with the
    /// reciprocal depth `near`. The normal there is n = (p - a - s along) / r, where a + s along is
    /// the nearest point of the axis; its products are computed without n itself.
    #[inline(always)]
    pub(super) fn shade_round(&self, round: &Round, x: f32, y: f32, near: f32) -> Rgb {
        let lamp = &self.lamp;
        let t = 1.0 / near;
        let (along, ahead) = (dot(&round.along, x, y), dot(&lamp.towards_f32, x, y));
        // Clamped to the ends, s gives the normal of the end spheres as well.
        let s = (round.start + t * along).clamp(0.0, round.length);
        let per = round.per_radius;
        let facing = (t * ahead - round.lamp.0 - s * round.lamp.1) * per;
        let up = (t * dot(&lamp.up_f32, x, y) - round.sky.0 - s * round.sky.1) * per;
        let lit = lamp.lit(x, y, t);
        let light = lamp.sky(up) + lamp.key * facing.max(0.0) * lit;
        let mut shine = 0.0;
        if facing > 0.0 && round.gloss > 0.0 {
            let square = x * x + (y * y + 1.0);
            // `inward` is n . ray; the mirrored ray is ray - 2 (n . ray) n.
            let inward = (t * square - dot(&round.a, x, y) - s * along) * per;
            let mirrored = ahead - 2.0 * inward * facing;
            shine = round.gloss * lit * lamp.key * power(mirrored, square);
        }
        std::array::from_fn(|c| (round.paint[c] * light + shine) * lamp.cast[c])
    }
}

/// Returns the 32nd power of the cosine between the ray (x, y, 1) and the mirrored lamp.
#[inline(always)]
fn highlight(mirror: &V3, x: f32, y: f32) -> f32 {
    power(dot(mirror, x, y), x * x + y * y + 1.0)
}

/// Returns `(along / sqrt(square))^32`, or 0 if this is not visible or `along` is negative.
#[inline(always)]
fn power(along: f32, square: f32) -> f32 {
    let along = along.max(0.0);
    // 0.6^16 is 0.0003 of the lamp, which is not visible. Most rays end here, before the division.
    if along * along < 0.6 * square {
        return 0.0;
    }
    let square = along * along / square;
    let p4 = square * square;
    let p8 = p4 * p4;
    let p16 = p8 * p8;
    p16 * p16
}

/// Returns the signed distance of the point (u, v) to a square with round corners, negative inside,
/// and its gradient. `core` is half of a side without the corners, `corner` their radius.
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

/// Returns the side (px) of a square with the same variance as a pixel blurred by `defocus` (px).
fn aperture(defocus: f64) -> f32 {
    // A square of side s has the variance s^2 / 12 along each axis.
    libm::sqrt(1.0 + 12.0 * defocus.clamp(0.0, 0.8).powi(2)) as f32
}
