//! The segmentation of the paper (Zieliński et al. 2007): colour tables, run lengths, union-find
//! and filters in sequence.
//!
//! Each of the three components of a pixel indexes a table of bit masks with one bit per colour
//! range. The bitwise AND of the three masks is the set of ranges that the pixel lies in, so a
//! colour may have several ranges at the cost of one classification. Runs of one range become
//! regions.
//!
//! The components are the intensity and two components of chroma relative to it: red against green,
//! and blue. In these components the six colours are boxes, which are the same in bright and in dim
//! light. The gap between two tiles of one colour is not known by its own level, but only by how
//! much darker it is than the tiles, so there are several bands of intensity, which overlap.
//!
//! Filters then remove the regions that are no tiles, in this order:
//!
//! | filter | limit (default) | reason |
//! |---|---|---|
//! | `area` | 20 px to 1/9 of the picture | no specks; nine tiles must fit in |
//! | `boundary` | at most 1.8 of a square's | no ragged or branching regions |
//! | `circularity` | at least 0.5 | no bars; a square has 0.785 |
//! | `quadrilaterals` | 0.8 of the hull filled | no rings |
//! | `quadrilaterals` | 0.75 of the hull in four corners | no discs, which have 0.64 |
//! | `once` | one region at a place | the ranges of a colour overlap |
//! | `neighbours` | at least 2 of similar size | a corner tile has three |
//!
//! Heuristics find the face among the remaining regions. The centre tile has the most neighbours,
//! the corner tiles have the fewest, and all tiles have about the same area. The largest such
//! square of nine tiles is the face, and its pose follows from the centroids of its four corner
//! tiles. The square is right in 160 of 200 drawn frames.
//!
//! - in: RGB pixels
//! - out: the regions that each stage left (the paper's figure 4), `Tile`s, a [`Square`] or a
//!   [`Refusal`]
//! - source: Zieliński et al. (2007), p. 373; Bruce, Balch, Veloso (2000)

use super::homography::{GRID, OUTLINE, Point, apply, distance, polygon, square_to};
use super::patch::reduced;
use super::segment::{Runs, Tile, smooth};
use super::{FaceSighting, Rect, Refusal};
use image::RgbImage;

/// Range of a colour: lowest and highest value of intensity, of red against green, and of blue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColourRange {
    /// Colour 0..=5 = white, red, green, yellow, orange, blue.
    pub colour: u8,
    /// Mean of the channels, 0..=255.
    pub intensity: (u8, u8),
    /// Red less green over the sum of the channels, 1..=255 for -1..=1; 128 is neutral.
    pub red: (u8, u8),
    /// Share of blue in the sum of the channels, 0..=255 for 0..=1; a third (85) is neutral.
    pub blue: (u8, u8),
}

/// Least and greatest value of a component.
type Interval = (u8, u8);

/// Chroma of the six colours as boxes of red against green, and of blue. The boxes meet and
/// overlap, so that a tile between two of them is a region in at least one.
const CHROMA: [(u8, Interval, Interval); 7] = [
    (0, (115, 142), (64, 110)),
    (1, (182, 255), (0, 110)),
    (1, (158, 182), (40, 110)),
    (2, (0, 118), (0, 112)),
    (3, (112, 152), (0, 64)),
    (4, (150, 190), (0, 52)),
    (5, (0, 150), (104, 255)),
];

/// Bands of intensity, each a factor of 2.5 wide. A tile with shade and noise fits into one band,
/// and a gap with less than half of its tiles' intensity is outside. Pixels below all bands have no
/// colour.
const BANDS: [(u8, u8); 5] = [(18, 45), (28, 70), (45, 112), (70, 175), (110, 255)];

/// Ranges of every colour in every band. White has no range in the darkest two bands, where the
/// grey of the cube's body and of shadows lies.
pub const RANGES: [ColourRange; RANGE_COUNT] = {
    let mut ranges =
        [ColourRange { colour: 0, intensity: (0, 0), red: (0, 0), blue: (0, 0) }; RANGE_COUNT];
    let (mut c, mut n) = (0, 0);
    while c < CHROMA.len() {
        let (colour, red, blue) = CHROMA[c];
        let mut band = if colour == 0 { 2 } else { 0 };
        while band < BANDS.len() {
            ranges[n] = ColourRange { colour, intensity: BANDS[band], red, blue };
            n += 1;
            band += 1;
        }
        c += 1;
    }
    ranges
};
/// Number of ranges: white has two bands fewer than the other colours.
const RANGE_COUNT: usize = CHROMA.len() * BANDS.len() - 2;

/// Tables that give the colour ranges of a pixel: a bit mask for each level of each component.
#[derive(Debug, Clone)]
pub struct Tables {
    /// Set of ranges, one bit each, for each level of each component.
    masks: [[u64; 256]; 3],
    /// Colour 0..=5 of each range, or 255.
    colour_of: [u8; 64],
}

impl Tables {
    /// Builds the tables by which a pixel is classified, from at most 64 colour ranges.
    ///
    /// # Panics
    /// If there are more than 64 ranges.
    #[must_use]
    pub fn new(ranges: &[ColourRange]) -> Self {
        assert!(ranges.len() <= 64, "one bit per range");
        let mut masks = [[0; 256]; 3];
        let mut colour_of = [255; 64];
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

    /// Returns the set of colour ranges in which a pixel (red, green, blue) lies, one bit each.
    #[must_use]
    pub fn ranges(&self, [r, g, b]: [u8; 3]) -> u64 {
        let (r, g, b) = (u32::from(r), u32::from(g), u32::from(b));
        let sum = r + g + b;
        // A division for each pixel would dominate the time, so its inverse is in a table. The
        // product is at most 127 * 2 * 255 * 2^16, which still fits into 32 bits.
        let scale = SCALES[sum as usize];
        let red = (127 * (sum + r - g) * scale / 255) >> 16;
        self.masks[0][(sum / 3) as usize]
            & self.masks[1][(red as usize + 1).min(255)]
            & self.masks[2][((b * scale) >> 16) as usize]
    }

    /// Returns the colour 0..=5 of the first range in which a pixel (red, green, blue) lies, or 255
    /// if there is none.
    #[must_use]
    pub fn classify(&self, pixel: [u8; 3]) -> u8 {
        match self.ranges(pixel) {
            0 => 255,
            set => self.colour_of[set.trailing_zeros() as usize],
        }
    }
}

/// Quotient of 255 and each sum of three channels, in units of 2^-16; 0 for the sum 0.
const SCALES: [u32; 766] = {
    let mut scales = [0; 766];
    let mut sum = 1;
    while sum < scales.len() {
        scales[sum] = (255 << 16) / sum as u32;
        sum += 1;
    }
    scales
};

/// Connected region of one colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// Colour 0..=5 = white, red, green, yellow, orange, blue.
    pub colour: u8,
    /// Runs of the region: row, first column, one after the last column.
    pub runs: Vec<(usize, usize, usize)>,
    /// Number of pixels.
    pub area: f64,
    /// Length of the boundary along the sides of pixels (px).
    pub boundary: f64,
    /// Centroid (px).
    pub centre: Point,
    /// Second central moments xx, xy, yy (px^2).
    pub moments: [f64; 3],
}

impl Region {
    /// Makes a region of its runs (row, first column, one after the last column, sorted by row) and
    /// computes its area, boundary, centroid and moments.
    fn new(colour: u8, runs: Vec<(usize, usize, usize)>) -> Self {
        let (mut n, mut x, mut y, mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for &(row, start, end) in &runs {
            let (a, b, row) = (start as f64, end as f64, row as f64);
            let length = b - a;
            let sum = length * (a + b - 1.0) / 2.0;
            n += length;
            x += sum;
            y += length * row;
            // The sum of the squares of a..b, from their mean and their spread without a loop.
            xx += sum * sum / length + length * (length * length - 1.0) / 12.0;
            xy += sum * row;
            yy += length * row * row;
        }
        let (x, y) = (x / n, y / n);
        // A pixel is a square of side 1, not a point, and adds its own second moment of 1/12.
        let moments = [xx / n - x * x + 1.0 / 12.0, xy / n - x * y, yy / n - y * y + 1.0 / 12.0];
        let boundary = boundary(&runs);
        Self { colour, runs, area: n, boundary, centre: (x, y), moments }
    }

    /// Returns the circularity: 4 pi times the area, divided by the square of the boundary. It is
    /// about 1 for a circle and at least 0.785 for a square, and 2 at most.
    ///
    /// A boundary along the sides of pixels is longer than the true one: by the factor 4/pi for a
    /// circle. It is therefore multiplied by pi/4 first.
    #[must_use]
    pub fn circularity(&self) -> f64 {
        let smooth = self.boundary * std::f64::consts::FRAC_PI_4;
        (4.0 * std::f64::consts::PI * self.area / (smooth * smooth)).min(2.0)
    }

    /// Returns two shares of the area of the region's convex hull, 0..=1: that of the region, and
    /// that of the largest quadrilateral in the hull. They are 1 and 1 for a parallelogram, 1 and
    /// 0.64 for a circle.
    #[must_use]
    pub fn convexity(&self) -> (f64, f64) {
        let hull = hull(&self.runs);
        let area = area_of(&hull);
        if area <= 0.0 {
            return (0.0, 0.0);
        }
        ((self.area / area).min(1.0), quadrilateral(&hull) / area)
    }

    /// Returns the region as a candidate for a tile.
    fn tile(&self) -> Tile {
        let [xx, xy, yy] = self.moments;
        let fullness = self.area / (12.0 * (xx * yy - xy * xy).max(1e-9).sqrt());
        Tile { centre: self.centre, moments: self.moments, area: self.area, fullness }
    }

    /// Returns the side of a square of the same area (px).
    fn side(&self) -> f64 {
        self.area.sqrt()
    }
}

/// Computes the length of a region's boundary (px): the number of sides of its pixels beyond which
/// the neighbour is not in the region. Each run is a row, its first column and one after its last
/// column; the runs must be sorted by row, then by column.
fn boundary(runs: &[(usize, usize, usize)]) -> f64 {
    let mut length = 0;
    let mut above = 0;
    for (i, &(row, start, end)) in runs.iter().enumerate() {
        // The whole outline of each run is added. The part that it shares with a run of the row
        // above is inside the region, so it is subtracted again for both of them.
        length += 2 + 2 * (end - start);
        let passed = |r: &(usize, usize, usize)| r.0 + 1 < row || (r.0 + 1 == row && r.2 <= start);
        while above < i && passed(&runs[above]) {
            above += 1;
        }
        for over in runs[above..i].iter().take_while(|r| r.0 + 1 == row && r.1 < end) {
            length -= 2 * (over.2.min(end) - over.1.max(start));
        }
    }
    length as f64
}

/// Computes the convex hull of the corners of a region's pixels, clockwise on the screen, by the
/// method of Andrew (1979).
fn hull(runs: &[(usize, usize, usize)]) -> Vec<Point> {
    let mut points: Vec<Point> = Vec::with_capacity(4 * runs.len());
    for &(row, start, end) in runs {
        let (top, left, right) = (row as f64 - 0.5, start as f64 - 0.5, end as f64 - 0.5);
        points.extend([(left, top), (right, top), (left, top + 1.0), (right, top + 1.0)]);
    }
    points.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    points.dedup();
    // One half of the hull. A corner at which the chain does not turn clockwise is inside the hull
    // and is removed.
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
        // The last corner is the first one of the other half.
        chain.pop();
        chain
    };
    let mut chain = half(&mut points.iter().copied());
    chain.extend(half(&mut points.iter().rev().copied()));
    chain
}

/// Computes the area of a polygon (px^2).
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

/// Computes the area of the largest quadrilateral with its corners on a hull (px^2). For each
/// diagonal it takes the farthest corner on either side.
fn quadrilateral(hull: &[Point]) -> f64 {
    // The time grows with the third power of the number of corners. Neighbours on a hull of
    // hundreds of corners are about a pixel apart, so it is thinned.
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

/// Limits of the filters: see the table in the header of this module.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filters {
    /// Least area (px), and greatest area as a share of the picture.
    pub area: (f64, f64),
    /// Greatest boundary, divided by that of a square of the same area.
    pub boundary: f64,
    /// Least value of [`Region::circularity`].
    pub circularity: f64,
    /// Least shares that [`Region::convexity`] returns.
    pub convexity: (f64, f64),
    /// Least number of regions of similar size within two and a half sides of a region.
    pub neighbours: usize,
}

impl Default for Filters {
    fn default() -> Self {
        Self {
            area: (20.0, 1.0 / 9.0),
            boundary: 1.8,
            circularity: 0.5,
            convexity: (0.8, 0.75),
            neighbours: 2,
        }
    }
}

/// Result of one stage: the search for regions, or one filter.
#[derive(Debug, Clone, PartialEq)]
pub struct Stage {
    /// Name of the stage, one word.
    pub name: &'static str,
    /// Number of regions that the stage left.
    pub count: usize,
    /// Indices of these regions in [`Stages::regions`]. Regions below the least area are only
    /// counted, in the first stage.
    pub left: Vec<usize>,
}

/// Regions of a picture, and which of them each filter in sequence left.
#[derive(Debug, Clone, PartialEq)]
pub struct Stages {
    /// Factor by which the picture was scaled down in both directions before the search. Regions
    /// are in pixels of the smaller picture.
    pub step: usize,
    /// Regions of the least area or more, each of one colour range.
    pub regions: Vec<Region>,
    /// Stages in their order. The first one is the search itself, with all regions.
    pub stages: Vec<Stage>,
}

/// Greatest number of pixels at which a picture is searched. Larger pictures are reduced first,
/// which bounds time and memory.
const MOST_PIXELS: usize = 2_100_000;

impl Stages {
    /// Finds the regions of each colour range in interleaved RGB pixels and applies the filters to
    /// them, one after another.
    #[must_use]
    pub fn run(rgb: &[u8], width: usize, height: usize, filters: &Filters) -> Self {
        let step = step_of(width, height);
        if step > 1 {
            let whole = Rect { x: 0, y: 0, width: width as u32, height: height as u32 };
            let small = reduced(rgb, width, whole, step);
            return Self::run_whole(&small, width / step, height / step, step, filters);
        }
        Self::run_whole(rgb, width, height, 1, filters)
    }

    /// Finds and filters the regions in interleaved RGB pixels at their present size. `step` is the
    /// factor by which the picture has been scaled down already.
    fn run_whole(rgb: &[u8], width: usize, height: usize, step: usize, filters: &Filters) -> Self {
        // The least area is applied here already: in a textured picture specks would take most of
        // the memory.
        let (regions, count) = regions(rgb, width, height, filters.area.0);
        let most = filters.area.1 * (width * height) as f64;
        let mut stages = vec![Stage { name: "regions", count, left: (0..regions.len()).collect() }];
        let mut filter = |name, keep: &mut dyn FnMut(&[usize], usize) -> bool| {
            let before = stages.last().map(|s| s.left.clone()).unwrap_or_default();
            let left: Vec<usize> = before.iter().copied().filter(|&i| keep(&before, i)).collect();
            stages.push(Stage { name, count: left.len(), left });
        };
        filter("area", &mut |_, i| regions[i].area <= most);
        filter("boundary", &mut |_, i| {
            regions[i].boundary <= filters.boundary * 4.0 * regions[i].side()
        });
        filter("circularity", &mut |_, i| regions[i].circularity() >= filters.circularity);
        filter("quadrilaterals", &mut |_, i| {
            let (full, four) = regions[i].convexity();
            full >= filters.convexity.0 && four >= filters.convexity.1
        });
        // A tile is a region in each range that overlaps its colour. Which of these regions stays
        // depends on all that the stage before left, so it is computed once, on the first call.
        let once = std::cell::OnceCell::new();
        filter("once", &mut |all, i| {
            let once: &Vec<bool> = once.get_or_init(|| each_once(&regions, all));
            once[i]
        });
        let near = std::cell::OnceCell::new();
        filter("neighbours", &mut |all, i| {
            let near: &Near = near.get_or_init(|| Near::new(&regions, all));
            near.of(i).count() >= filters.neighbours
        });
        // `near` borrows the regions, which move into the result.
        drop(near);
        Self { step, regions, stages }
    }

    /// Returns the indices of the regions that passed every filter.
    #[must_use]
    pub fn last(&self) -> &[usize] {
        self.stages.last().map_or(&[], |s| &s.left)
    }

    /// Finds the face in the picture: the largest square of nine among the regions that passed
    /// every filter.
    ///
    /// # Errors
    /// [`Refusal::NoLattice`] if there is no such square, [`Refusal::TooSmall`] if the face is so
    /// narrow that the cube is outside the workspace.
    pub fn square(&self) -> Result<Square, Refusal> {
        self.square_from(LEAST_WIDTH)
    }

    /// Finds the face in the picture as [`Stages::square`] does, from a width of `least` on (px).
    ///
    /// # Errors
    /// [`Refusal::NoLattice`] if there is no such square, [`Refusal::TooSmall`] if it is narrower.
    pub fn square_from(&self, least: f64) -> Result<Square, Refusal> {
        let left = self.last();
        let mut order: Vec<usize> = left.to_vec();
        let near = Near::new(&self.regions, left);
        order.sort_by_cached_key(|&i| (std::cmp::Reverse(near.of(i).count()), i));
        // Centroids of corner tiles are two pitches apart, and the face is three pitches wide.
        let width = |s: &Square| {
            (0..4).map(|i| distance(s.corners[i], s.corners[(i + 1) % 4])).fold(0.0, f64::max) * 1.5
        };
        let best = order
            .iter()
            .filter_map(|&centre| self.around(centre, &near))
            .max_by(|a, b| a.area().total_cmp(&b.area()))
            .ok_or(Refusal::NoLattice { tiles: left.len() })?;
        let width_px = width(&best);
        if width_px < least { Err(Refusal::TooSmall { width_px }) } else { Ok(best) }
    }

    /// Finds the square of nine regions around the region `centre`: this one and the nearest eight
    /// of about the same area. The four with the fewest neighbours among the nine are the corner
    /// tiles. Returns `None` if the nine do not form a square.
    fn around(&self, centre: usize, near: &Near) -> Option<Square> {
        let me = &self.regions[centre];
        let metric = Metric::of(me);
        // Distances are measured on the face, in sides of its centre tile. In the picture an
        // oblique face may have corner tiles nearer than the middles of its sides.
        let from =
            |i: usize, j: usize| metric.distance(self.regions[i].centre, self.regions[j].centre);
        let mut others: Vec<usize> = near
            .of(centre)
            .filter(|&j| {
                (0.5..2.0).contains(&(self.regions[j].area / me.area))
                    && (0.8..2.5).contains(&from(centre, j))
            })
            .collect();
        others.sort_unstable();
        others.sort_by(|&a, &b| from(centre, a).total_cmp(&from(centre, b)));
        others.truncate(8);
        if others.len() < 8 {
            return None;
        }
        let nine: Vec<usize> = others.iter().copied().chain([centre]).collect();
        // The four nearest tiles are a pitch away, the corner tiles 1.41 pitches.
        let reach = 1.3 * from(centre, others[3]);
        let beside = |i: usize| nine.iter().filter(|&&j| j != i && from(i, j) < reach).count();
        // Corner tiles have two tiles beside them, those in the middle of a side three, the centre
        // four. Among tiles with equally many the farthest from the centre count as corners.
        others.sort_by(|&a, &b| {
            beside(a).cmp(&beside(b)).then(from(centre, b).total_cmp(&from(centre, a)))
        });
        let mut corners: Vec<Point> = others[..4].iter().map(|&i| self.regions[i].centre).collect();
        let angle = |p: &Point| (p.1 - me.centre.1).atan2(p.0 - me.centre.0);
        corners.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
        let corners: [Point; 4] = corners.try_into().ok()?;
        // The four corners predict all nine places. A tile must be at each of them, and the sides
        // may differ only by perspective. This rejects rows of tiles that are no square.
        let places = places(&corners)?;
        let sides: [f64; 4] = std::array::from_fn(|i| distance(corners[i], corners[(i + 1) % 4]));
        let (short, long) = (
            sides.iter().copied().fold(f64::INFINITY, f64::min),
            sides.iter().copied().fold(0.0, f64::max),
        );
        let lies = |place: &Point| {
            nine.iter().any(|&i| distance(self.regions[i].centre, *place) < 0.1 * short)
        };
        (polygon(&corners).0 > 0.0 && places.iter().all(lies) && long < 2.2 * short).then(|| {
            // The centroids of the corner tiles enclose an area of 2x2 cells, so the face of 3x3 is
            // 9/4 as large.
            let share = nine.iter().map(|&i| self.regions[i].area).sum::<f64>()
                / (2.25 * polygon(&corners).0);
            let step = self.step as f64;
            let whole = |p: Point| ((p.0 + 0.5) * step - 0.5, (p.1 + 0.5) * step - 0.5);
            Square { corners: corners.map(whole), tiles: nine, sticker: share.sqrt().min(1.0) }
        })
    }
}

/// Returns the picture that the method searches, which is scaled down if it is large, and the
/// colour of each of its pixels: 0..=5, or 255 for none.
#[must_use]
pub fn classes(image: &RgbImage) -> (RgbImage, Vec<u8>) {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let step = step_of(width, height);
    let whole = Rect { x: 0, y: 0, width: image.width(), height: image.height() };
    let small = reduced(image.as_raw(), width, whole, step);
    let (width, height) = (width / step, height / step);
    let tables = Tables::new(&RANGES);
    let smooth = smooth(&small, width, height);
    let classes = smooth.as_chunks::<3>().0.iter().map(|pixel| tables.classify(*pixel)).collect();
    let small = RgbImage::from_raw(width as u32, height as u32, small).unwrap_or_default();
    (small, classes)
}

/// Returns the factor by which a picture is scaled down in both directions, so that at most
/// [`MOST_PIXELS`] are left.
fn step_of(width: usize, height: usize) -> usize {
    (1..=width.max(height).max(1))
        .find(|step| (width / step) * (height / step) <= MOST_PIXELS)
        .unwrap_or(1)
}

/// Metric in which a region that looks like a parallelogram is a unit square.
struct Metric {
    /// Inverse of the lower Cholesky factor of the region's moments, divided by the root of 12,
    /// since a unit square has moments of 1/12. The elements are given by rows, without the zero.
    inverse: (f64, f64, f64),
}

impl Metric {
    /// Makes the metric from the second moments of a region.
    fn of(region: &Region) -> Self {
        let [xx, xy, yy] = region.moments;
        let (a, unit) = (xx.sqrt(), 12f64.sqrt());
        let b = xy / a;
        let c = (yy - b * b).max(1e-9).sqrt();
        Self { inverse: (1.0 / (a * unit), -b / (a * c * unit), 1.0 / (c * unit)) }
    }

    /// Returns the distance between two points of the picture, in sides of the region.
    fn distance(&self, p: Point, q: Point) -> f64 {
        let (dx, dy) = (q.0 - p.0, q.1 - p.1);
        let (a, b, c) = self.inverse;
        (a * dx).hypot(b * dx + c * dy)
    }
}

/// Least width of a face (px). A cube with a narrower face is outside the workspace of the arms
/// (Zieliński et al. 2007, p. 373).
const LEAST_WIDTH: f64 = 100.0;

/// Face that the paper's heuristics find.
#[derive(Debug, Clone, PartialEq)]
pub struct Square {
    /// Centroids of the corner tiles in the picture, clockwise on the screen from the top left
    /// (px).
    pub corners: [Point; 4],
    /// Indices of its nine regions in [`Stages::regions`], the centre last.
    pub tiles: Vec<usize>,
    /// Side of a tile as a share of the pitch, 0..=1.
    pub sticker: f64,
}

impl Square {
    /// Returns the area between the centroids of the corner tiles (px^2).
    fn area(&self) -> f64 {
        area_of(&self.corners)
    }

    /// Returns the square as a face, so that its pose can be computed from four points as in the
    /// paper. Only the corner tiles count as seen, and the centres of the others follow from them.
    /// All colours and confidences are 0. Returns `None` if the corners are degenerate (three of
    /// them on a line).
    #[must_use]
    pub fn face(&self) -> Option<FaceSighting> {
        let unit = square_to(&self.corners)?;
        Some(FaceSighting {
            corners: OUTLINE.map(|(x, y)| apply(&unit, (0.5 * (x + 1.0), 0.5 * (y + 1.0)))),
            centres: places(&self.corners)?,
            seen: GRID.map(|(x, y)| x * y != 0.0),
            sticker: self.sticker,
            rgb: [[0.0; 3]; 9],
            colours: [0; 9],
            confidences: [0.0; 9],
            confidence: 0.0,
        })
    }
}

/// Computes the centres of all nine tiles from those of the four corner tiles (px). Returns `None`
/// if the corners are degenerate.
fn places(corners: &[Point; 4]) -> Option<[Point; 9]> {
    let unit = square_to(corners)?;
    Some(GRID.map(|(x, y)| apply(&unit, (0.5 * (x + 1.0), 0.5 * (y + 1.0)))))
}

/// Finds the connected regions of each colour range. Returns those of `least` pixels or more, and
/// the number of all regions.
fn regions(rgb: &[u8], width: usize, height: usize, least: f64) -> (Vec<Region>, usize) {
    let tables = Tables::new(&RANGES);
    // Without smoothing, noise would split a tile whose colour is near the limit of a range.
    let rgb = smooth(rgb, width, height);
    let mut runs: Vec<Runs> = RANGES.iter().map(|_| Runs::default()).collect();
    let mut starts = [0; RANGE_COUNT];
    for (y, line) in rgb.chunks_exact(3 * width.max(1)).enumerate() {
        runs.iter_mut().for_each(Runs::begin_row);
        let mut before = 0;
        // Only bits that change from one pixel to the next begin or end a run, so one pass over the
        // picture serves all ranges. The empty set after the row ends its last runs.
        let sets = line.as_chunks::<3>().0.iter().map(|pixel| tables.ranges(*pixel));
        for (x, set) in sets.chain([0]).enumerate() {
            let mut changes = set ^ before;
            while changes != 0 {
                let bit = changes.trailing_zeros() as usize;
                changes &= changes - 1;
                if set >> bit & 1 == 1 {
                    starts[bit] = x;
                } else {
                    runs[bit].push(starts[bit], x, y);
                }
            }
            before = set;
        }
    }
    // The regions of all ranges are kept, though ranges overlap. The filter `once` selects later.
    let (mut all, mut count) = (Vec::new(), 0);
    for (runs, range) in runs.into_iter().zip(RANGES) {
        let (regions, any) = runs.regions(least as usize);
        all.extend(regions.into_iter().map(|runs| Region::new(range.colour, runs)));
        count += any;
    }
    (all, count)
}

/// Selects one region at each place where regions of several colour ranges lie, out of the indices
/// `among`. A region is preferred if it is large and its shape is near a parallelogram. Returns for
/// each region whether it was selected.
fn each_once(regions: &[Region], among: &[usize]) -> Vec<bool> {
    let worth = |i: usize| {
        regions[i].area.powf(0.3) * (1.0 - 2.0 * (regions[i].tile().fullness - 1.0).abs())
    };
    let mut order = among.to_vec();
    order.sort_by(|&a, &b| worth(b).total_cmp(&worth(a)).then(a.cmp(&b)));
    let near = Near::new(regions, among);
    let mut stays = vec![false; regions.len()];
    for i in order {
        let reach = 0.35 * regions[i].side();
        let apart = |j: usize| distance(regions[i].centre, regions[j].centre);
        stays[i] = !near.of(i).any(|j| stays[j] && apart(j) < reach);
    }
    stays
}

/// Regions sorted by column, so that those near a place are found quickly: a picture of a textured
/// cloth has tens of thousands of regions.
struct Near<'a> {
    regions: &'a [Region],
    /// Columns of the centres, with the regions' indices, from left to right.
    columns: Vec<(f64, usize)>,
}

impl<'a> Near<'a> {
    /// Sorts the regions with the indices `among`.
    fn new(regions: &'a [Region], among: &[usize]) -> Self {
        let mut columns: Vec<(f64, usize)> =
            among.iter().map(|&i| (regions[i].centre.0, i)).collect();
        columns.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        Self { regions, columns }
    }

    /// Returns the indices of the regions within two and a half sides of region `i` whose area is
    /// 0.4 to 2.5 of its own.
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

/// Returns the regions of interleaved RGB pixels that pass every filter of the paper's method, as
/// tile candidates.
#[must_use]
pub fn tiles(rgb: &[u8], width: usize, height: usize) -> Vec<Tile> {
    let stages = Stages::run(rgb, width, height, &Filters::default());
    stages.last().iter().map(|&i| stages.regions[i].tile()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn six_colours_are_classified_and_black_is_none() {
        let tables = Tables::new(&RANGES);

        // The colours in the order URFDLB, and black.
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
    fn red_is_classified_in_dim_and_bright_light() {
        let tables = Tables::new(&RANGES);

        assert_eq!(tables.classify([60, 8, 10]), 1);
        assert_eq!(tables.classify([255, 60, 55]), 1);
    }

    /// Returns a picture of a square face of nine tiles with this pitch (px), seen at right angles,
    /// and of a single tile far from the face, with its width and height.
    fn picture(pitch: usize) -> (Vec<u8>, usize, usize) {
        /// Shades of the six colours (sRGB), in the order URFDLB.
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
    fn filters_keep_exactly_nine_tiles() {
        let (rgb, width, height) = picture(40);

        let stages = Stages::run(&rgb, width, height, &Filters::default());
        let square = stages.square().unwrap();

        let counts: Vec<usize> = stages.stages.iter().map(|s| s.count).collect();
        assert_eq!(counts[6], 9, "{counts:?}");
        assert!(counts.is_sorted_by(|a, b| a >= b));
        // The middles of the corner tiles: 20 px to the first tile, and half of its 32 px.
        assert_eq!(
            square.corners.map(|c| (c.0.round(), c.1.round())),
            [(36.0, 36.0), (116.0, 36.0), (116.0, 116.0), (36.0, 116.0)]
        );
    }

    #[test]
    fn square_is_found_in_dim_noisy_picture() {
        let (mut rgb, width, height) = picture(40);
        let mut state = 1u32;
        for value in &mut rgb {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = f64::from(state >> 24) / 255.0 - 0.5;
            *value = (f64::from(*value) * 0.4 + 28.0 * noise).clamp(0.0, 255.0) as u8;
        }

        let square = Stages::run(&rgb, width, height, &Filters::default()).square().unwrap();

        let middles = [(36.0, 36.0), (116.0, 36.0), (116.0, 116.0), (36.0, 116.0)];
        let off = square.corners.iter().zip(middles).map(|(a, b)| distance(*a, b));
        assert!(off.fold(0.0, f64::max) < 2.0, "{square:?}");
    }

    /// A large picture is searched at a reduced size, but the corners of the square are in pixels
    /// of the large one.
    #[test]
    fn square_of_reduced_picture_has_original_pixel_coordinates() {
        let (rgb, width, height) = picture(400);

        let stages = Stages::run(&rgb, width, height, &Filters::default());
        let square = stages.square().unwrap();

        // The middle of the first corner tile: 200 px to the tile, and half of its 320 px.
        assert!(stages.step > 1);
        assert!(distance(square.corners[0], (359.5, 359.5)) < 4.0, "{:?}", square.corners);
    }

    #[test]
    fn pose_follows_from_four_corner_tiles() {
        let (rgb, width, height) = picture(40);
        let lens = crate::Lens {
            focal: (600.0, 600.0),
            centre: (76.0, 76.0),
            radial: [0.0; 3],
            tangential: [0.0; 2],
        };
        let square = Stages::run(&rgb, width, height, &Filters::default()).square().unwrap();

        let pose = crate::locate(&square.face().unwrap(), lens, 0.057);

        // The pitch of 19 mm is 40 px wide, so the distance is 19 mm * 600 px / 40 px.
        let place = pose.camera_from_face.translation.vector;
        assert!((place.z - 0.285).abs() < 0.003 && place.xy().norm() < 0.001, "{place}");
    }

    #[test]
    fn narrow_face_is_refused_as_too_small() {
        let (rgb, width, height) = picture(20);

        let square = Stages::run(&rgb, width, height, &Filters::default()).square();

        assert!(
            matches!(square, Err(Refusal::TooSmall { width_px }) if (width_px - 60.0).abs() < 1.0),
            "{square:?}"
        );
    }

    #[test]
    fn convexity_and_circularity_distinguish_square_circle_bar() {
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
