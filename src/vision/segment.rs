//! Segmentation of a picture into regions that edges enclose, without absolute colours.
//!
//! The picture is smoothed by the kernel 1 2 1 in both directions. The edge strength of a pixel is
//! the range (largest less smallest level) of a channel over the pixel and its four neighbours, in
//! the channel where it is largest. Connected regions whose edge strength is below a threshold are
//! candidates for tiles. Weak grooves between tiles need a low threshold, glare and shadow on a
//! tile need a high one, so callers use several.
//!
//! - in: RGB pixels, thresholds of the edge strength
//! - out: [`Tile`]s: regions that look like a parallelogram
//! - source: run lengths and union-find as in Bruce, Balch, Veloso, "Fast and inexpensive color
//!   image segmentation for interactive robots" (2000); the compactness measure is own work

use super::homography::{Point, apply};
use nalgebra::Matrix3;

/// Region that may be a tile of the cube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tile {
    /// Centroid (px).
    pub centre: (f64, f64),
    /// Second central moments xx, xy, yy (px^2).
    pub moments: [f64; 3],
    /// Number of pixels.
    pub area: f64,
    /// Area divided by that of the parallelogram with the same second moments: 1 for a
    /// parallelogram, 1.047 for an ellipse.
    pub fullness: f64,
}

/// Limits within which a region counts as a tile. No limit depends on the colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TileLimits {
    /// Smallest and largest area (px).
    pub area: (f64, f64),
    /// Least and greatest fullness (see [`Tile::fullness`]).
    pub fullness: (f64, f64),
    /// Greatest ratio of the longer axis of inertia to the shorter one.
    pub elongation: f64,
}

/// Edge strength of the pixels of a picture.
#[derive(Debug, Clone)]
pub(crate) struct Edges {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Edge strength of each pixel, 0..=255, row by row.
    pub strength: Vec<u8>,
}

impl Edges {
    /// Computes the edge strength of interleaved RGB pixels (`3 * width * height` bytes).
    ///
    /// # Panics
    /// If `rgb` has another number of bytes.
    #[must_use]
    pub(crate) fn new(rgb: &[u8], width: usize, height: usize) -> Self {
        assert_eq!(rgb.len(), 3 * width * height, "three bytes per pixel");
        let smooth = smooth(rgb, width, height);
        let row = 3 * width;
        // The border stays at the greatest strength, so that no region reaches it.
        let mut strength = vec![255; width * height];
        if width < 3 || height < 3 {
            return Self { width, height, strength };
        }
        let inner = row - 6;
        let (mut range, mut largest) = (vec![0u8; inner + 2], vec![0u8; inner]);
        for y in 1..height - 1 {
            let at = y * row;
            let up = &smooth[at - row..at];
            let here = &smooth[at..at + row];
            let down = &smooth[at + row..at + 2 * row];
            // The compiler makes vector code of a loop over five byte streams of equal length.
            let (l, c, r) = (&here[..inner], &here[3..3 + inner], &here[6..6 + inner]);
            let (u, d, out) = (&up[3..3 + inner], &down[3..3 + inner], &mut range[..inner]);
            for i in 0..inner {
                let high = l[i].max(c[i]).max(r[i]).max(u[i]).max(d[i]);
                let low = l[i].min(c[i]).min(r[i]).min(u[i]).min(d[i]);
                out[i] = high - low;
            }
            // The largest of three successive bytes is computed from each byte on, since that is
            // vector code. Each third result is that of a pixel; the others mix two pixels and are
            // not used.
            let (first, second, third) = (&range[..inner], &range[1..=inner], &range[2..]);
            for (((largest, a), b), c) in largest.iter_mut().zip(first).zip(second).zip(third) {
                *largest = (*a).max(*b).max(*c);
            }
            let line = &mut strength[y * width + 1..(y + 1) * width - 1];
            for (pixel, channels) in line.iter_mut().zip(largest.chunks_exact(3)) {
                *pixel = channels[0];
            }
        }
        Self { width, height, strength }
    }

    /// Returns the edge strength that noise and texture alone cause: the 15th percentile over the
    /// picture.
    #[must_use]
    pub(crate) fn floor(&self) -> u8 {
        // One pixel in twenty is exact enough for a percentile.
        let mut counts = [0u32; 256];
        let mut total = 0;
        for y in (1..self.height.saturating_sub(1)).step_by(4) {
            for value in
                self.strength[y * self.width + 1..(y + 1) * self.width - 1].iter().step_by(5)
            {
                counts[usize::from(*value)] += 1;
                total += 1;
            }
        }
        percentile(&counts, total, 0.15)
    }

    /// Finds the 4-connected regions whose edge strength is below `threshold`. Returns those that
    /// look like tiles, and the number of all regions.
    #[must_use]
    pub(crate) fn tiles(&self, threshold: u8, limits: &TileLimits) -> (Vec<Tile>, usize) {
        let mut runs = Runs::default();
        for (y, line) in self.strength.chunks_exact(self.width.max(1)).enumerate() {
            runs.begin_row();
            runs_below(line, threshold, |start, end| runs.push(start, end, y));
        }
        runs.tiles(limits)
    }

    /// Returns whether edges of at least the strength `threshold` run along all four sides of a
    /// cell of a lattice. `g` is the centre of the cell in pitches from that of the middle cell
    /// (x along the columns, y along the rows), and `h` maps such places to pixels.
    pub(super) fn bound(&self, h: &Matrix3<f64>, g: Point, threshold: u8) -> bool {
        let strength = |p: Point| {
            let (x, y) = apply(h, p);
            let (x, y) = (x.round(), y.round());
            if x < 0.0 || y < 0.0 || x >= self.width as f64 || y >= self.height as f64 {
                return 0;
            }
            self.strength[y as usize * self.width + x as usize]
        };
        // Each side is crossed by five lines, which run outwards from 0.36 to 0.60 of a pitch. One
        // of the five need not meet an edge, since an edge may have a scratch or a gap.
        [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)].into_iter().all(|(nx, ny)| {
            let marked = (-2..=2)
                .filter(|k| {
                    let along = 0.14 * f64::from(*k);
                    (0..7).any(|j| {
                        let out = 0.36 + 0.04 * f64::from(j);
                        let p = (g.0 + nx * out - ny * along, g.1 + ny * out + nx * along);
                        strength(p) >= threshold
                    })
                })
                .count();
            marked >= 4
        })
    }
}

/// Calls `run` with the start and the end (exclusive) of each longest stretch of values below
/// `threshold` in a line of pixels, from left to right.
fn runs_below(line: &[u8], threshold: u8, mut run: impl FnMut(usize, usize)) {
    let mut start = 0;
    let mut inside = 0u64;
    for (block, values) in line.chunks(64).enumerate() {
        // `mask` has one bit per value, set if the value is below the threshold. The comparison is
        // vector code, and a multiplication gathers eight flags in the highest byte of its product.
        let mut below = [0u8; 64];
        for (flag, value) in below.iter_mut().zip(values) {
            *flag = u8::from(*value < threshold);
        }
        let mut mask = 0u64;
        for (k, eight) in below.as_chunks::<8>().0.iter().enumerate() {
            let gathered = u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
            mask |= gathered << (8 * k);
        }
        // A bit differs from the one before it where a run begins or ends. `inside` carries the
        // last bit over to the next block.
        let mut changes = mask ^ (mask << 1 | inside);
        inside = mask >> 63;
        while changes != 0 {
            let bit = changes.trailing_zeros() as usize;
            changes &= changes - 1;
            let at = 64 * block + bit;
            if mask >> bit & 1 == 1 {
                start = at;
            } else {
                run(start, at);
            }
        }
    }
    if inside == 1 {
        run(start, line.len());
    }
}

/// Smooths interleaved RGB pixels by the kernel 1 2 1 (divided by 4) in both directions. Beyond the
/// border of the picture its outermost pixels are repeated.
pub(super) fn smooth(rgb: &[u8], width: usize, height: usize) -> Vec<u8> {
    let row = 3 * width;
    let mut out = vec![0u8; rgb.len()];
    if width < 3 || height < 3 {
        out.copy_from_slice(rgb);
        return out;
    }
    let horizontal = |y: usize, line: &mut [u16]| {
        let source = &rgb[y * row..(y + 1) * row];
        let inner = row - 6;
        let (l, c, r) = (&source[..inner], &source[3..3 + inner], &source[6..6 + inner]);
        let target = &mut line[3..3 + inner];
        for i in 0..inner {
            target[i] = u16::from(l[i]) + 2 * u16::from(c[i]) + u16::from(r[i]);
        }
        for i in 0..3 {
            line[i] = 4 * u16::from(source[i]);
            line[row - 3 + i] = 4 * u16::from(source[row - 3 + i]);
        }
    };
    // The kernel is separable: each row is smoothed horizontally once, and `a`, `b` and `c` are the
    // results for the row above, this row and the row below.
    let (mut a, mut b, mut c) = (vec![0u16; row], vec![0u16; row], vec![0u16; row]);
    horizontal(0, &mut b);
    a.copy_from_slice(&b);
    for y in 0..height {
        horizontal((y + 1).min(height - 1), &mut c);
        let target = &mut out[y * row..(y + 1) * row];
        for (((t, a), b), c) in target.iter_mut().zip(&a).zip(&b).zip(&c) {
            *t = ((a + 2 * b + c + 8) >> 4) as u8;
        }
        std::mem::swap(&mut a, &mut b);
        std::mem::swap(&mut b, &mut c);
    }
    out
}

/// Returns the lowest level at or below which more than the share `p` of `total` values lies.
/// `counts` is the number of values at each level.
#[must_use]
pub(super) fn percentile(counts: &[u32; 256], total: u32, p: f64) -> u8 {
    let wanted = (f64::from(total) * p) as u32;
    let mut sum = 0;
    for (level, count) in counts.iter().enumerate() {
        sum += count;
        if sum > wanted {
            return level as u8;
        }
    }
    255
}

/// Runs of pixels in a picture with a union-find forest over them: the method of Zieliński et al.
/// (2007) and of the program `CMVision`. The runs of a tree are a connected region.
#[derive(Debug, Default)]
pub(super) struct Runs {
    /// Runs row by row, from left to right.
    all: Vec<Run>,
    /// Index of the first run of the row above.
    above: usize,
    /// Index of the first run of this row.
    current: usize,
    /// Index of the next run of the row above that may touch a run of this row.
    cursor: usize,
}

/// Pixels side by side: row, first column, one after the last column.
pub(super) type Stretch = (usize, usize, usize);

/// Run of pixels with its place in the union-find forest.
#[derive(Debug, Clone, Copy)]
struct Run {
    /// First column.
    start: u32,
    /// One after the last column.
    end: u32,
    /// Row.
    y: u32,
    /// Index of the parent run, or its own index at a root.
    parent: u32,
}

/// Sums over the pixels of a region: their number, and the sums of x, y and their products.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    n: u64,
    x: u64,
    y: u64,
    xx: u64,
    xy: u64,
    yy: u64,
}

impl Runs {
    /// Starts the next row, to which the runs that are pushed from now on belong.
    pub(super) fn begin_row(&mut self) {
        self.above = self.current;
        self.current = self.all.len();
        self.cursor = self.above;
    }

    /// Adds the run of the columns `start..end` in row `y`, and joins it with the runs of the row
    /// above that it touches. The runs of a row must come from left to right.
    pub(super) fn push(&mut self, start: usize, end: usize, y: usize) {
        let me = self.all.len() as u32;
        let mut run = Run { start: start as u32, end: end as u32, y: y as u32, parent: me };
        // The cursor never moves back, so the time of a row is linear in its runs. It stays at the
        // last run that touches, since that one may touch the next run as well.
        while self.cursor < self.current && self.all[self.cursor].end <= run.start {
            self.cursor += 1;
        }
        let mut i = self.cursor;
        while i < self.current && self.all[i].start < run.end {
            let root = self.root(i as u32);
            if run.parent == me {
                run.parent = root;
            } else {
                // The run joins two regions. The earlier root becomes the root of both, so that the
                // regions are numbered in the order of their first rows.
                let mine = self.root(run.parent);
                let (low, high) = (mine.min(root), mine.max(root));
                self.all[high as usize].parent = low;
                run.parent = low;
            }
            i += 1;
        }
        self.all.push(run);
    }

    /// Returns the root of the tree to which run `i` belongs. Halves the path to the root, so that
    /// later calls are quicker.
    fn root(&mut self, mut i: u32) -> u32 {
        while self.all[i as usize].parent != i {
            let grand = self.all[self.all[i as usize].parent as usize].parent;
            self.all[i as usize].parent = grand;
            i = grand;
        }
        i
    }

    /// Returns the runs of each region of `least` pixels or more, row by row, and the number of all
    /// regions.
    pub(super) fn regions(mut self, least: usize) -> (Vec<Vec<Stretch>>, usize) {
        let mut areas = vec![0u32; self.all.len()];
        for i in 0..self.all.len() {
            let root = self.root(i as u32) as usize;
            areas[root] += self.all[i].end - self.all[i].start;
        }
        let count = areas.iter().filter(|&&area| area > 0).count();
        // From here on the entry of a root is the number of its region. Small regions are only
        // counted: a textured picture has very many of them.
        let mut regions = 0;
        for area in &mut areas {
            let small = (*area as usize) < least.max(1);
            *area = if small { u32::MAX } else { regions };
            regions += u32::from(!small);
        }
        let mut members = vec![Vec::new(); regions as usize];
        for i in 0..self.all.len() {
            let number = areas[self.root(i as u32) as usize];
            let run = self.all[i];
            if number != u32::MAX {
                let run = (run.y as usize, run.start as usize, run.end as usize);
                members[number as usize].push(run);
            }
        }
        (members, count)
    }

    /// Returns the regions that look like tiles, and the number of all regions.
    pub(super) fn tiles(mut self, limits: &TileLimits) -> (Vec<Tile>, usize) {
        // Roots are numbered as they appear, so that the table of sums has one entry per region.
        let mut slot = vec![u32::MAX; self.all.len()];
        let mut sums: Vec<Sums> = Vec::new();
        for i in 0..self.all.len() {
            let root = self.root(i as u32) as usize;
            if slot[root] == u32::MAX {
                slot[root] = sums.len() as u32;
                sums.push(Sums::default());
            }
            let Run { start, end, y, .. } = self.all[i];
            let (a, b, y) = (u64::from(start), u64::from(end), u64::from(y));
            let n = b - a;
            let x = n * (a + b - 1) / 2;
            // The sum of the squares of a..b is a difference of two pyramidal numbers. Sums of
            // integers are exact.
            let pyramid = |k: u64| if k == 0 { 0 } else { (k - 1) * k * (2 * k - 1) / 6 };
            let s = &mut sums[slot[root] as usize];
            s.n += n;
            s.x += x;
            s.y += n * y;
            s.xx += pyramid(b) - pyramid(a);
            s.xy += x * y;
            s.yy += n * y * y;
        }
        let regions = sums.len();
        (sums.iter().filter_map(|s| s.tile(limits)).collect(), regions)
    }
}

impl Sums {
    /// Returns the region as a tile, or `None` if it is outside the limits.
    fn tile(&self, limits: &TileLimits) -> Option<Tile> {
        let n = self.n as f64;
        if n < limits.area.0 || n > limits.area.1 {
            return None;
        }
        let (x, y) = (self.x as f64 / n, self.y as f64 / n);
        // A pixel is a square of side 1, not a point, and adds its own second moment of 1/12.
        let xx = self.xx as f64 / n - x * x + 1.0 / 12.0;
        let yy = self.yy as f64 / n - y * y + 1.0 / 12.0;
        let xy = self.xy as f64 / n - x * y;
        // A parallelogram with these moments has the area 12 sqrt(det).
        let det = xx * yy - xy * xy;
        let fullness = n / (12.0 * det.max(1e-9).sqrt());
        if fullness < limits.fullness.0 || fullness > limits.fullness.1 {
            return None;
        }
        // The lengths of the axes of inertia are the square roots of the moments' eigenvalues.
        let half = f64::midpoint(xx, yy);
        let root = (half * half - det).max(0.0).sqrt();
        let elongation = ((half + root) / (half - root).max(1e-9)).sqrt();
        (elongation <= limits.elongation).then_some(Tile {
            centre: (x, y),
            moments: [xx, xy, yy],
            area: n,
            fullness,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Limits of the tiles in these pictures (px).
    const LIMITS: TileLimits =
        TileLimits { area: (12.0, 5000.0), fullness: (0.8, 1.08), elongation: 4.0 };

    /// Returns RGB pixels, 80 x 60, that are bright where `inside` is true and dark elsewhere.
    fn picture(inside: impl Fn(f64, f64) -> bool) -> Vec<u8> {
        let mut rgb = Vec::new();
        for y in 0..60 {
            for x in 0..80 {
                let level = if inside(f64::from(x), f64::from(y)) { 200 } else { 20 };
                rgb.extend_from_slice(&[level, 30, 40]);
            }
        }
        rgb
    }

    #[test]
    fn square_becomes_one_tile_with_exact_centre() {
        let rgb = picture(|x, y| (20.0..40.0).contains(&x) && (15.0..35.0).contains(&y));

        let (tiles, regions) = Edges::new(&rgb, 80, 60).tiles(20, &LIMITS);

        assert_eq!((tiles.len(), regions), (1, 2));
        assert_eq!(tiles[0].centre, (29.5, 24.5));
        assert!((tiles[0].fullness - 1.0).abs() < 0.02, "{}", tiles[0].fullness);
    }

    #[test]
    fn cross_shaped_region_is_no_tile() {
        let rgb = picture(|x, y| {
            let (dx, dy) = ((x - 40.0).abs(), (y - 30.0).abs());
            dx < 25.0 && dy < 25.0 && (dx < 7.0 || dy < 7.0)
        });

        assert!(Edges::new(&rgb, 80, 60).tiles(20, &LIMITS).0.is_empty());
    }

    #[test]
    fn runs_below_threshold_equal_those_of_plain_scan() {
        let values: Vec<u8> =
            (0..333u32).map(|i| ((i * i * 2654) >> 7) as u8 / (1 + (i / 100) as u8)).collect();
        for length in [0, 1, 63, 64, 65, 128, 200, 333] {
            let mut plain = Vec::new();
            for (i, _) in values[..length].iter().enumerate().filter(|(_, v)| **v < 90) {
                match plain.last_mut() {
                    Some((_, end)) if *end == i => *end = i + 1,
                    _ => plain.push((i, i + 1)),
                }
            }
            let mut runs = Vec::new();

            runs_below(&values[..length], 90, |start, end| runs.push((start, end)));

            assert_eq!(runs, plain, "{length}");
        }
    }

    #[test]
    fn u_shaped_area_is_one_region() {
        let mut runs = Runs::default();
        for y in 0..4 {
            runs.begin_row();
            if y < 3 {
                runs.push(0, 2, y);
                runs.push(4, 6, y);
            } else {
                runs.push(0, 6, y);
            }
        }

        assert_eq!(runs.tiles(&LIMITS).1, 1);
    }
}
