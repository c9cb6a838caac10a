//! The paper's own segmentation: colour tables, run lengths, union-find, filters in sequence.
//!
//! Each of the three components of a pixel indexes a table of bit masks, one bit a colour range; the bitwise
//! AND of the three is the set of ranges that the pixel lies in, so a colour may have several ranges without
//! repeating the classification. Runs of one colour become regions, and filters remove those that are no
//! tiles. The components are intensity, and red and blue chromaticity against it.
//!
//! Then the heuristics: the centre tile has the most neighbours, the corner tiles the fewest, and the tiles of a
//! face have about the same area. Of several squares the biggest is the cube's; its corner tiles' centroids are
//! the four points of the pose.
//!
//! - in: RGB pixels
//! - out: the regions that each stage left (the paper's figure 4), [`Tile`]s, a [`Square`] or a [`Refusal`]
//! - source: Zieliński et al. (2007), p. 373; Bruce, Balch, Veloso (2000)

use super::Refusal;
use super::homography::{Point, distance, polygon};
use super::segment::{Runs, Tile};
use std::collections::BTreeMap;

/// One range of a colour: lowest and highest level of intensity, of red and of blue chromaticity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColourRange {
    /// Colour 0..=5 = white, red, green, yellow, orange, blue.
    pub colour: u8,
    /// Mean of the channels, 0..=255.
    pub intensity: (u8, u8),
    /// Share of red in the sum of the channels, 0..=255 for 0..=1.
    pub red: (u8, u8),
    /// Share of blue in the sum of the channels.
    pub blue: (u8, u8),
}

const fn range(colour: u8, intensity: (u8, u8), red: (u8, u8), blue: (u8, u8)) -> ColourRange {
    ColourRange { colour, intensity, red, blue }
}

/// Ranges for ordinary light; bright and dim versions of a colour are ranges of their own.
pub const RANGES: [ColourRange; 11] = [
    range(0, (110, 255), (68, 100), (70, 104)),
    range(0, (70, 110), (74, 96), (74, 98)),
    range(1, (25, 85), (173, 255), (0, 60)),
    range(1, (85, 150), (170, 255), (0, 56)),
    range(2, (25, 90), (0, 66), (30, 92)),
    range(2, (90, 200), (0, 74), (24, 84)),
    range(3, (80, 255), (100, 137), (0, 62)),
    range(4, (50, 110), (140, 172), (0, 52)),
    range(4, (110, 220), (138, 168), (0, 62)),
    range(5, (25, 90), (0, 70), (112, 255)),
    range(5, (90, 200), (0, 76), (102, 255)),
];

/// The three tables of bit masks.
#[derive(Debug, Clone)]
pub struct Tables {
    masks: [[u16; 256]; 3],
    colour_of: [u8; 16],
}

impl Tables {
    /// Of at most 16 ranges.
    ///
    /// # Panics
    /// When there are more.
    #[must_use]
    pub fn new(ranges: &[ColourRange]) -> Self {
        assert!(ranges.len() <= 16, "one bit a range");
        let mut masks = [[0u16; 256]; 3];
        let mut colour_of = [0; 16];
        for (bit, range) in ranges.iter().enumerate() {
            colour_of[bit] = range.colour;
            for (mask, (low, high)) in
                masks.iter_mut().zip([range.intensity, range.red, range.blue])
            {
                for entry in &mut mask[usize::from(low)..=usize::from(high)] {
                    *entry |= 1 << bit;
                }
            }
        }
        Self { masks, colour_of }
    }

    /// Colour 0..=5 of a pixel, or 255.
    #[must_use]
    pub fn classify(&self, pixel: [u8; 3]) -> u8 {
        let [r, g, b] = pixel.map(u32::from);
        let sum = r + g + b;
        // 255/sum in fixed point; the +1 keeps black from dividing by zero.
        let scale = (255 << 8) / (sum + 1);
        let set = self.masks[0][(sum / 3) as usize]
            & self.masks[1][((r * scale) >> 8) as usize]
            & self.masks[2][((b * scale) >> 8) as usize];
        if set == 0 { 255 } else { self.colour_of[set.trailing_zeros() as usize] }
    }
}

/// Class of each pixel, 0..=5 or 255.
#[must_use]
pub fn classify(rgb: &[u8], tables: &Tables) -> Vec<u8> {
    rgb.chunks_exact(3).map(|p| tables.classify([p[0], p[1], p[2]])).collect()
}

/// A connected region of one colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// Colour 0..=5 = white, red, green, yellow, orange, blue.
    pub colour: u8,
    /// Its runs: row, first column, one after the last column.
    pub runs: Vec<(usize, usize, usize)>,
    /// Number of pixels.
    pub area: f64,
    /// Length of its boundary along the pixels' sides [px].
    pub boundary: f64,
    /// Centroid [px].
    pub centre: Point,
    /// Second central moments xx, xy, yy [px^2].
    pub moments: [f64; 3],
}

impl Region {
    fn new(colour: u8, runs: Vec<(usize, usize, usize)>) -> Self {
        let (mut n, mut x, mut y, mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for &(row, start, end) in &runs {
            let (a, b, row) = (start as f64, end as f64, row as f64);
            let length = b - a;
            let sum = length * (a + b - 1.0) / 2.0;
            n += length;
            x += sum;
            y += length * row;
            // The sum of squares from its mean and its spread.
            xx += sum * sum / length + length * (length * length - 1.0) / 12.0;
            xy += sum * row;
            yy += length * row * row;
        }
        let (x, y) = (x / n, y / n);
        let moments = [xx / n - x * x + 1.0 / 12.0, xy / n - x * y, yy / n - y * y + 1.0 / 12.0];
        let boundary = boundary(&runs);
        Self { colour, runs, area: n, boundary, centre: (x, y), moments }
    }

    /// 4 pi area over the squared boundary: 1 for a circle, 0.785 for a square. A boundary along pixels' sides is
    /// longer than the true one by up to 4/pi, whence the factor.
    #[must_use]
    pub fn circularity(&self) -> f64 {
        let smooth = self.boundary * std::f64::consts::FRAC_PI_4;
        (4.0 * std::f64::consts::PI * self.area / (smooth * smooth)).min(2.0)
    }

    /// Share of the convex hull that the region fills, and share of the hull that the best quadrilateral in it
    /// fills (1 and 1 for a parallelogram; a circle has 0.64 of its quadrilateral).
    #[must_use]
    pub fn convexity(&self) -> (f64, f64) {
        let hull = hull(&self.runs);
        let area = area_of(&hull);
        if area <= 0.0 {
            return (0.0, 0.0);
        }
        ((self.area / area).min(1.0), quadrilateral(&hull) / area)
    }

    fn tile(&self) -> Tile {
        let [xx, xy, yy] = self.moments;
        let fullness = self.area / (12.0 * (xx * yy - xy * xy).max(1e-9).sqrt());
        Tile { centre: self.centre, moments: self.moments, area: self.area, fullness }
    }

    /// Side of a square of the same area [px].
    fn side(&self) -> f64 {
        self.area.sqrt()
    }
}

/// Length of the boundary: the sides of pixels whose neighbour is not in the region.
fn boundary(runs: &[(usize, usize, usize)]) -> f64 {
    let mut rows: BTreeMap<usize, Vec<(usize, usize)>> = BTreeMap::new();
    for &(row, start, end) in runs {
        rows.entry(row).or_default().push((start, end));
    }
    let covered = |row: Option<&Vec<(usize, usize)>>, start: usize, end: usize| -> usize {
        row.map_or(0, |others| {
            others.iter().map(|o| o.1.min(end).saturating_sub(o.0.max(start))).sum()
        })
    };
    let mut length = 0;
    for (row, own) in &rows {
        let (above, below) = (row.checked_sub(1).and_then(|r| rows.get(&r)), rows.get(&(row + 1)));
        for &(start, end) in own {
            length += 2 + 2 * (end - start);
            length -= covered(above, start, end) + covered(below, start, end);
        }
    }
    length as f64
}

/// Convex hull of the pixels' corners, clockwise on the screen (Andrew 1979).
fn hull(runs: &[(usize, usize, usize)]) -> Vec<Point> {
    let mut points: Vec<Point> = Vec::with_capacity(4 * runs.len());
    for &(row, start, end) in runs {
        let (top, left, right) = (row as f64 - 0.5, start as f64 - 0.5, end as f64 - 0.5);
        points.extend([(left, top), (right, top), (left, top + 1.0), (right, top + 1.0)]);
    }
    points.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    points.dedup();
    let half = |points: &mut dyn Iterator<Item = Point>| {
        let mut chain: Vec<Point> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..]
                && (b.0 - a.0) * (p.1 - a.1) - (b.1 - a.1) * (p.0 - a.0) <= 0.0
            {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut chain = half(&mut points.iter().copied());
    chain.extend(half(&mut points.iter().rev().copied()));
    chain
}

fn area_of(corners: &[Point]) -> f64 {
    let n = corners.len();
    (0..n)
        .map(|i| {
            let (a, b) = (corners[i], corners[(i + 1) % n]);
            (a.0 * b.1 - b.0 * a.1) / 2.0
        })
        .sum::<f64>()
        .abs()
}

/// Area of the largest quadrilateral with its corners on a hull: for each diagonal the farthest corners.
fn quadrilateral(hull: &[Point]) -> f64 {
    // A hull of hundreds of corners is thinned: neighbours on it are a pixel apart.
    let step = hull.len().div_ceil(48).max(1);
    let hull: Vec<Point> = hull.iter().copied().step_by(step).collect();
    let mut best: f64 = 0.0;
    for (i, a) in hull.iter().enumerate() {
        for b in &hull[i + 1..] {
            let offset = |p: &Point| (b.0 - a.0) * (p.1 - a.1) - (b.1 - a.1) * (p.0 - a.0);
            let high = hull.iter().map(offset).fold(0.0, f64::max);
            let low = hull.iter().map(offset).fold(0.0, f64::min);
            best = best.max((high - low) / 2.0);
        }
    }
    best
}

/// Limits of the filters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filters {
    /// Least area [px] and greatest share of the picture.
    pub area: (f64, f64),
    /// Least and greatest boundary [px].
    pub boundary: (f64, f64),
    /// Least circularity.
    pub circularity: f64,
    /// Least shares of [`Region::convexity`].
    pub convexity: (f64, f64),
    /// Least number of regions of like size within two and a half sides.
    pub neighbours: usize,
}

impl Default for Filters {
    fn default() -> Self {
        Self {
            area: (20.0, 1.0 / 9.0),
            boundary: (16.0, 4000.0),
            circularity: 0.5,
            convexity: (0.8, 0.75),
            neighbours: 2,
        }
    }
}

/// What one stage left.
#[derive(Debug, Clone, PartialEq)]
pub struct Stage {
    /// One word.
    pub name: &'static str,
    /// Indices of the regions that are left.
    pub left: Vec<usize>,
}

/// The regions of a picture, and what each filter in sequence left of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Stages {
    /// All regions of one colour.
    pub regions: Vec<Region>,
    /// The stages in their order; the first one left all.
    pub stages: Vec<Stage>,
}

impl Stages {
    /// Runs the method on interleaved RGB pixels.
    #[must_use]
    pub fn run(rgb: &[u8], width: usize, height: usize, filters: &Filters) -> Self {
        let regions = regions(rgb, width, height);
        let most = filters.area.1 * (width * height) as f64;
        let mut stages = vec![Stage { name: "regions", left: (0..regions.len()).collect() }];
        let mut filter = |name, keep: &dyn Fn(&[usize], usize) -> bool| {
            let before = stages.last().map(|s| s.left.clone()).unwrap_or_default();
            let left = before.iter().copied().filter(|&i| keep(&before, i)).collect();
            stages.push(Stage { name, left });
        };
        filter("area", &|_, i| (filters.area.0..=most).contains(&regions[i].area));
        filter("boundary", &|_, i| {
            (filters.boundary.0..=filters.boundary.1).contains(&regions[i].boundary)
        });
        filter("circularity", &|_, i| regions[i].circularity() >= filters.circularity);
        filter("quadrilaterals", &|_, i| {
            let (full, four) = regions[i].convexity();
            full >= filters.convexity.0 && four >= filters.convexity.1
        });
        let near = std::cell::OnceCell::new();
        filter("neighbours", &|all, i| {
            let near: &Near = near.get_or_init(|| Near::new(&regions, all));
            near.of(i).count() >= filters.neighbours
        });
        drop(near);
        Self { regions, stages }
    }

    /// The regions that passed every filter.
    #[must_use]
    pub fn last(&self) -> &[usize] {
        self.stages.last().map_or(&[], |s| &s.left)
    }

    /// The biggest square of nine regions.
    ///
    /// # Errors
    /// [`Refusal::NoLattice`] when there is none, [`Refusal::TooSmall`] when it is outside the work-space.
    pub fn square(&self) -> Result<Square, Refusal> {
        let left = self.last();
        let mut order: Vec<usize> = left.to_vec();
        let near = Near::new(&self.regions, left);
        order.sort_by_cached_key(|&i| (std::cmp::Reverse(near.of(i).count()), i));
        let width = |s: &Square| {
            (0..4).map(|i| distance(s.corners[i], s.corners[(i + 1) % 4])).fold(0.0, f64::max) * 1.5
        };
        let best = order
            .iter()
            .filter_map(|&centre| self.around(centre, &near))
            .max_by(|a, b| a.area().total_cmp(&b.area()))
            .ok_or(Refusal::NoLattice { tiles: left.len() })?;
        let width_px = width(&best);
        if width_px < LEAST_WIDTH { Err(Refusal::TooSmall { width_px }) } else { Ok(best) }
    }

    /// The square with a region in its centre: eight others around it of about the same area; those with the
    /// fewest neighbours among the nine are its corners.
    fn around(&self, centre: usize, near: &Near) -> Option<Square> {
        let me = &self.regions[centre];
        let mut others: Vec<usize> = near
            .of(centre)
            .filter(|&j| (0.5..2.0).contains(&(self.regions[j].area / me.area)))
            .collect();
        others.sort_unstable();
        let from = |i: usize, j: usize| distance(self.regions[i].centre, self.regions[j].centre);
        others.sort_by(|&a, &b| from(centre, a).total_cmp(&from(centre, b)));
        others.truncate(8);
        if others.len() < 8 {
            return None;
        }
        let nine: Vec<usize> = others.iter().copied().chain([centre]).collect();
        let reach = 1.3 * from(centre, others[3]);
        let beside = |i: usize| nine.iter().filter(|&&j| j != i && from(i, j) < reach).count();
        // Corner tiles have two tiles beside them, the middles of the sides three, the centre four.
        others.sort_by(|&a, &b| {
            beside(a).cmp(&beside(b)).then(from(centre, b).total_cmp(&from(centre, a)))
        });
        let mut corners: Vec<Point> = others[..4].iter().map(|&i| self.regions[i].centre).collect();
        let angle = |p: &Point| (p.1 - me.centre.1).atan2(p.0 - me.centre.0);
        corners.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
        let corners: [Point; 4] = corners.try_into().ok()?;
        // The diagonals meet in the centre tile, and the sides are alike.
        let middle = polygon(&corners).1;
        let sides: [f64; 4] = std::array::from_fn(|i| distance(corners[i], corners[(i + 1) % 4]));
        let (short, long) = (
            sides.iter().copied().fold(f64::INFINITY, f64::min),
            sides.iter().copied().fold(0.0, f64::max),
        );
        let meets = distance(middle, me.centre) < 0.1 * long;
        (meets && long < 2.2 * short).then_some(Square { corners, tiles: nine })
    }
}

/// A cube whose face is narrower is outside the work-space (Zieliński et al. 2007, p. 373) [px].
const LEAST_WIDTH: f64 = 100.0;

/// A face by the paper's heuristics.
#[derive(Debug, Clone, PartialEq)]
pub struct Square {
    /// Centroids of the corner tiles, clockwise on the screen from the top left [px].
    pub corners: [Point; 4],
    /// Its nine regions, the centre last.
    pub tiles: Vec<usize>,
}

impl Square {
    fn area(&self) -> f64 {
        area_of(&self.corners)
    }
}

/// All regions of one colour.
fn regions(rgb: &[u8], width: usize, height: usize) -> Vec<Region> {
    let classes = classify(rgb, &Tables::new(&RANGES));
    let mut all = Vec::new();
    for colour in 0..6 {
        let mut runs = Runs::default();
        for y in 0..height {
            let line = &classes[y * width..(y + 1) * width];
            runs.begin_row();
            let mut x = 0;
            while x < width {
                let Some(first) = line[x..].iter().position(|&c| c == colour) else { break };
                let start = x + first;
                let length = line[start..].iter().position(|&c| c != colour);
                let end = length.map_or(width, |n| start + n);
                runs.push(start, end, y);
                x = end;
            }
        }
        let (labelled, count) = runs.labelled();
        let mut members: Vec<Vec<(usize, usize, usize)>> = vec![Vec::new(); count];
        for (region, row, start, end) in labelled {
            members[region].push((row, start, end));
        }
        all.extend(members.into_iter().map(|runs| Region::new(colour, runs)));
    }
    all
}

/// Regions that are found by place: a cloth has tens of thousands of them.
struct Near<'a> {
    regions: &'a [Region],
    /// Columns of the centres, with the regions' indices, from left to right.
    columns: Vec<(f64, usize)>,
}

impl<'a> Near<'a> {
    fn new(regions: &'a [Region], among: &[usize]) -> Self {
        let mut columns: Vec<(f64, usize)> =
            among.iter().map(|&i| (regions[i].centre.0, i)).collect();
        columns.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        Self { regions, columns }
    }

    /// Regions of about the same size within two and a half sides.
    fn of(&self, i: usize) -> impl Iterator<Item = usize> {
        let me = &self.regions[i];
        let reach = 2.5 * me.side();
        let first = self.columns.partition_point(|c| c.0 < me.centre.0 - reach);
        self.columns[first..]
            .iter()
            .take_while(move |c| c.0 <= me.centre.0 + reach)
            .map(|c| c.1)
            .filter(move |&j| {
                let other = &self.regions[j];
                j != i
                    && distance(other.centre, me.centre) < reach
                    && (0.4..2.5).contains(&(other.area / me.area))
            })
    }
}

/// Tile candidates by colour.
#[must_use]
pub fn tiles(rgb: &[u8], width: usize, height: usize) -> Vec<Tile> {
    let stages = Stages::run(rgb, width, height, &Filters::default());
    stages.last().iter().map(|&i| stages.regions[i].tile()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_colours_fall_into_their_classes() {
        let tables = Tables::new(&RANGES);

        let classes = [
            [220, 220, 225],
            [170, 25, 30],
            [20, 140, 60],
            [230, 200, 30],
            [235, 100, 25],
            [15, 60, 150],
            [15, 15, 15],
        ]
        .map(|p| tables.classify(p));

        assert_eq!(classes, [0, 1, 2, 3, 4, 5, 255]);
    }

    #[test]
    fn a_colour_has_several_ranges_in_one_classification() {
        let tables = Tables::new(&RANGES);

        assert_eq!(tables.classify([60, 8, 10]), 1);
        assert_eq!(tables.classify([255, 60, 55]), 1);
    }

    /// A square face of nine tiles with this pitch, seen at right angles, and a secluded tile.
    fn picture(pitch: usize) -> (Vec<u8>, usize, usize) {
        const SHADES: [[u8; 3]; 6] = [
            [220, 220, 225],
            [170, 25, 30],
            [20, 140, 60],
            [230, 200, 30],
            [235, 100, 25],
            [15, 60, 150],
        ];
        let (width, height) = (7 * pitch, 5 * pitch);
        let mut rgb = vec![10; 3 * width * height];
        let mut paint = |left: usize, top: usize, shade: [u8; 3]| {
            for y in top..top + pitch * 4 / 5 {
                for x in left..left + pitch * 4 / 5 {
                    rgb[3 * (y * width + x)..][..3].copy_from_slice(&shade);
                }
            }
        };
        for i in 0..9 {
            paint(
                pitch / 2 + i % 3 * pitch,
                pitch / 2 + i / 3 * pitch,
                SHADES[(i * 5 + i / 3) % 6],
            );
        }
        paint(6 * pitch, 4 * pitch, SHADES[3]);
        (rgb, width, height)
    }

    #[test]
    fn the_filters_leave_the_nine_tiles_and_the_heuristics_find_their_square() {
        let (rgb, width, height) = picture(40);

        let stages = Stages::run(&rgb, width, height, &Filters::default());
        let square = stages.square().unwrap();

        let counts: Vec<usize> = stages.stages.iter().map(|s| s.left.len()).collect();
        assert_eq!((counts[0], counts[5]), (10, 9), "{counts:?}");
        assert!(counts.is_sorted_by(|a, b| a >= b));
        assert_eq!(
            square.corners.map(|c| (c.0.round(), c.1.round())),
            [(36.0, 36.0), (116.0, 36.0), (116.0, 116.0), (36.0, 116.0)]
        );
    }

    #[test]
    fn a_small_cube_is_outside_the_work_space() {
        let (rgb, width, height) = picture(20);

        let square = Stages::run(&rgb, width, height, &Filters::default()).square();

        assert!(
            matches!(square, Err(Refusal::TooSmall { width_px }) if (width_px - 60.0).abs() < 1.0),
            "{square:?}"
        );
    }

    #[test]
    fn shapes_are_told_apart() {
        let region = |inside: &dyn Fn(f64, f64) -> bool| {
            let mut runs = Vec::new();
            for y in 0..60 {
                let row: Vec<usize> =
                    (0..60).filter(|&x| inside(x as f64 - 29.5, y as f64 - 29.5)).collect();
                if let (Some(first), Some(last)) = (row.first(), row.last()) {
                    runs.push((y, *first, last + 1));
                }
            }
            Region::new(0, runs)
        };
        let square = region(&|x, y| x.abs() < 20.0 && y.abs() < 20.0);
        let circle = region(&|x, y| x.hypot(y) < 20.0);
        let bar = region(&|x, y| x.abs() < 28.0 && y.abs() < 3.0);

        assert_eq!((square.area, square.boundary, square.centre), (1600.0, 160.0, (29.5, 29.5)));
        assert!((square.convexity().1 - 1.0).abs() < 1e-9);
        assert!(
            (circle.convexity().1 - 2.0 / std::f64::consts::PI).abs() < 0.06,
            "{:?}",
            circle.convexity()
        );
        assert!(
            bar.circularity() < 0.5 && square.circularity() > 0.7 && circle.circularity() > 0.9
        );
    }
}
