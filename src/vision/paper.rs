//! The paper's own segmentation: colour tables, run lengths, union-find, filters in sequence.
//!
//! Each of the three components of a pixel indexes a table of bit masks, one bit a colour range; the bitwise
//! AND of the three is the set of ranges that the pixel lies in, so a colour may have several ranges without
//! repeating the classification. Runs of one colour become regions, and filters remove those that are no
//! tiles. The components are intensity, and red and blue chromaticity against it.
//!
//! - in: RGB pixels
//! - out: [`Tile`]s and the region count after each stage (the paper's figure 4)
//! - source: Zieliński et al. (2007), p. 373; Bruce, Balch, Veloso (2000)

use super::segment::{Runs, Tile, TileLimits};

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

/// How many regions each stage left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StageCounts {
    /// Regions of one colour.
    pub regions: usize,
    /// Of these, those with the area, compactness and elongation of a tile.
    pub shaped: usize,
    /// Of these, those with at least two neighbours of like size.
    pub neighboured: usize,
}

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

/// Tile candidates by colour, and what each stage left.
#[must_use]
pub fn tiles(rgb: &[u8], width: usize, height: usize) -> (Vec<Tile>, StageCounts) {
    let classes = classify(rgb, &Tables::new(&RANGES));
    let limits = TileLimits {
        area: (20.0, (width * height) as f64 / 9.0),
        fullness: (0.72, 1.1),
        elongation: 4.5,
    };
    let mut counts = StageCounts::default();
    let mut tiles = Vec::new();
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
        let (more, regions) = runs.tiles(&limits);
        counts.regions += regions;
        tiles.extend(more);
    }
    counts.shaped = tiles.len();
    let tiles = with_neighbours(&tiles);
    counts.neighboured = tiles.len();
    (tiles, counts)
}

/// Drops secluded regions: fewer than two others of like size within two and a half sides.
fn with_neighbours(tiles: &[Tile]) -> Vec<Tile> {
    tiles
        .iter()
        .filter(|t| {
            let reach = 2.5 * (12.0 * (t.moments[0] + t.moments[2]) / 2.0).sqrt();
            tiles
                .iter()
                .filter(|o| {
                    let d = (o.centre.0 - t.centre.0).hypot(o.centre.1 - t.centre.1);
                    d > 0.0 && d < reach && (0.4..2.5).contains(&(o.area / t.area))
                })
                .count()
                >= 2
        })
        .copied()
        .collect()
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
}
