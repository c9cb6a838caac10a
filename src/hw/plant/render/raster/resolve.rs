//! Colours of a row from its nearest surfaces: runs of one surface, and edges that are mixed from
//! samples of the aperture.

use super::View;
use super::vector::dot;
use crate::hw::plant::render::look::Rgb;
use crate::hw::plant::render::rays::{Rays, Window};
use crate::hw::plant::render::solids::Skin;
use std::ops::Range;

impl View {
    /// Computes the colours of a row where solids may be visible. Calls `put(column, colours)` for
    /// each run of neighbouring pixels; `column` is the first of them. For a run that shows only
    /// the background `colours` is empty, except after a cast of [`super::Extent::All`].
    pub(in crate::hw::plant::render) fn colour_row(
        &mut self,
        rays: &Rays,
        row: usize,
        background: &[Rgb],
        mut put: impl FnMut(usize, &[Rgb]),
    ) {
        let (from, to) = self.spans[row];
        if from >= to {
            return;
        }
        // Taken out, so that `self` can be borrowed while they are filled.
        let mut edges = std::mem::take(&mut self.edges);
        let mut colours = std::mem::take(&mut self.colours);
        self.find_edges(row, rays.width, &mut edges);
        let line = row * rays.width;
        let mut column = from;
        while column < to {
            let marks = &edges[column..to];
            let ids = &self.surface[line + column..line + to];
            let (id, mixed) = (ids[0], marks[0] != 0);
            // A run is of one kind: all on edges, or all inside one surface. The choice of the
            // surface is then made once a run instead of once a pixel.
            let same =
                |(mark, other): &(&u32, &u32)| (**mark != 0) == mixed && (mixed || **other == id);
            let end = column + marks.iter().zip(ids).take_while(same).count();
            let run = line + column..line + end;
            colours.clear();
            if mixed {
                let edge = |column| self.edge(rays, (row, column), background[line + column]);
                colours.extend((column..end).map(edge));
            } else if id == 0 {
                if self.is_whole {
                    colours.extend_from_slice(&background[run]);
                }
            } else {
                self.colour_run(rays, run, id, &mut colours);
            }
            put(column, &colours);
            column = end;
        }
        self.edges = edges;
        self.colours = colours;
    }

    /// Appends to `colours` those of `pixels`, which all show the surface with the number `id`.
    fn colour_run(&self, rays: &Rays, pixels: Range<usize>, id: u32, colours: &mut Vec<Rgb>) {
        let index = id as usize - 1;
        let directions = rays.x[pixels.clone()].iter().zip(&rays.y[pixels.clone()]);
        if let Some(facet) = self.facets.get(index) {
            if let Some(colour) = facet.flat {
                colours.resize(pixels.len(), colour);
            } else {
                colours.extend(directions.map(|(x, y)| self.shade_facet(facet, *x, *y, rays.step)));
            }
        } else {
            let round = &self.rounds[index - self.facets.len()];
            let places = directions.zip(&self.depth[pixels]);
            colours.extend(places.map(|((x, y), near)| self.shade_round(round, *x, *y, *near)));
        }
    }

    /// Marks in `edges` the pixels of a row of which one of the eight neighbours shows another
    /// surface.
    fn find_edges(&self, row: usize, width: usize, edges: &mut Vec<u32>) {
        let (from, to) = self.spans[row];
        edges.resize(width, 0);
        let (left, right) = (from.max(1), to.min(width - 1));
        let height = self.spans.len();
        let own = &self.surface[row * width..(row + 1) * width];
        // The first and the last column of the picture lack neighbours and count as no edge.
        edges[from] = 0;
        edges[to - 1] = 0;
        // Three rows, each shifted by -1, 0, 1: a loop without branches over the columns, in which
        // a number that differs leaves a bit.
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

    /// Returns the colour of a pixel at an edge: the surfaces around it, mixed by the share of the
    /// aperture that each covers.
    fn edge(&self, rays: &Rays, (row, column): (usize, usize), background: Rgb) -> Rgb {
        let pixel = row * rays.width + column;
        let around = Window {
            x0: column.max(1) - 1,
            x1: (column + 2).min(rays.width),
            y0: row.max(1) - 1,
            y1: (row + 2).min(rays.height),
        };
        // The first entry is the background, which every list has. `at` prefers the pixel itself.
        let mut ids = [0_u32; MAX_SURFACES];
        let mut at = [pixel; MAX_SURFACES];
        let mut count = 1;
        let mut far = 0.0_f32;
        let mut open = false;
        for row in around.y0..around.y1 {
            for column in around.x0..around.x1 {
                let near = row * rays.width + column;
                let id = self.surface[near];
                open |= id == 0;
                // The depth of the background is known only where no solid has overwritten it.
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
        // The joint of two rods of one paint is a crease, which needs no samples.
        if !open && self.one_body(&ids[1..count]) {
            return self.shade(rays, pixel, self.surface[pixel]);
        }
        let around = Neighbours { ids: &ids[..count], at: &at[..count], background, far };
        let (x, y) = (rays.x[pixel], rays.y[pixel]);
        let step = (rays.step.0 * self.aperture, rays.step.1 * self.aperture);
        // Edges of the cube get 16 samples, because the detector measures them; others get 4.
        if !ids[1..count].iter().any(|id| self.is_sticker_face(*id)) {
            let who = self.winners(&around, [x, y], step, &SAMPLES_4);
            return self.mix(rays, pixel, &around, &who);
        }
        // The edge lies outside the aperture of most pixels beside it. If the four corner samples
        // agree, they replace all 16.
        let corners = self.winners(&around, [x, y], step, &SAMPLES_CORNERS);
        if corners.iter().all(|who| *who == corners[0]) {
            return self.mix(rays, pixel, &around, &corners[..1]);
        }
        let who = self.winners(&around, [x, y], step, &SAMPLES_16);
        self.mix(rays, pixel, &around, &who)
    }

    /// Checks whether all surfaces with these numbers are rods of one paint.
    fn one_body(&self, ids: &[u32]) -> bool {
        let round = |id: u32| self.rounds.get((id as usize).wrapping_sub(self.facets.len() + 1));
        let Some(first) = round(ids[0]) else { return false };
        ids.iter().all(|id| round(*id).is_some_and(|other| other.paint == first.paint))
    }

    /// Returns the colour of the surface with the number `id` at a pixel that shows it.
    #[inline(always)]
    fn shade(&self, rays: &Rays, pixel: usize, id: u32) -> Rgb {
        let (x, y) = (rays.x[pixel], rays.y[pixel]);
        let index = id as usize - 1;
        if let Some(facet) = self.facets.get(index) {
            facet.flat.unwrap_or_else(|| self.shade_facet(facet, x, y, rays.step))
        } else {
            let round = &self.rounds[index - self.facets.len()];
            self.shade_round(round, x, y, self.depth[pixel])
        }
    }

    /// Returns the mean colour over the samples of an aperture. `winners` is, for each sample, the
    /// index in `around` of the surface that the sample meets.
    #[inline(always)]
    fn mix(&self, rays: &Rays, pixel: usize, around: &Neighbours<'_>, winners: &[u32]) -> Rgb {
        let mut weights = [0_u32; MAX_SURFACES];
        for winner in winners {
            weights[*winner as usize] += 1;
        }
        let mut colour = [0.0; 3];
        for (k, id) in around.ids.iter().enumerate() {
            if weights[k] > 0 {
                let index = (*id as usize).wrapping_sub(1);
                let own = if k == 0 {
                    around.background
                } else if let Some(facet) = self.facets.get(index) {
                    // A plane can be shaded at this pixel even if the pixel shows another surface.
                    let (x, y) = (rays.x[pixel], rays.y[pixel]);
                    facet.flat.unwrap_or_else(|| self.shade_facet(facet, x, y, rays.step))
                } else {
                    // A rod needs its own depth, so a neighbour that shows it is shaded instead.
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

    /// Returns, for each sample of an aperture, the index in `around` of the surface that it meets
    /// first. The aperture has its middle at the direction (x, y) and the sides `step`; `samples`
    /// are the places in it, in sides from the middle.
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
        // Surface by surface over all samples, because N is a constant and the inner loops become
        // vector instructions. A sample that meets no surface keeps 0, the background.
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

    /// Checks whether the surface with the number `id` is a face of the cube.
    fn is_sticker_face(&self, id: u32) -> bool {
        let index = (id as usize).wrapping_sub(1);
        self.facets.get(index).is_some_and(|f| matches!(f.skin, Skin::Stickers(..)))
    }
}

/// Greatest number of surfaces that are distinguished around a pixel, with the background.
const MAX_SURFACES: usize = 8;

/// Surfaces around a pixel; the first is the background, with its colour and reciprocal depth.
struct Neighbours<'a> {
    ids: &'a [u32],
    /// A pixel that shows each surface.
    at: &'a [usize],
    background: Rgb,
    far: f32,
}

/// Places of 4x4 samples in the aperture, in its sides from its middle: columns and rows.
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
/// Places of 2x2 samples.
const SAMPLES_4: [[f32; 4]; 2] = [[-0.25, 0.25, -0.25, 0.25], [-0.25, -0.25, 0.25, 0.25]];
/// Places of the four outermost of [`SAMPLES_16`].
const SAMPLES_CORNERS: [[f32; 4]; 2] =
    [[-0.375, 0.375, -0.375, 0.375], [-0.375, -0.375, 0.375, 0.375]];
