//! Light of the cube's stickers, as the cameras in the hands have seen it.
//!
//! A sticker is stored as light and not as the level of one picture, so that looks at several
//! exposures are decided together.
//!
//! - in: readings of faces, each at its exposure
//! - out: the light of 54 stickers, and the appearance of each colour on this cube
//! - source: own work

use crate::cube::Face;
use crate::tasks::cube::hold::{Hand, Hold};
use crate::tasks::cube::identify::Wanted;
use crate::vision::colours::{CLIPPED, to_level, to_linear};

/// Red, green and blue of each colour on this cube, by face (0..=255 each).
pub(super) type Palette = [[f64; 3]; 6];

/// Usual appearance of a colour that was never seen on this cube, since the operator has given it.
const USUAL: Palette = [
    [225.0, 225.0, 220.0],
    [180.0, 30.0, 35.0],
    [20.0, 150.0, 60.0],
    [220.0, 210.0, 40.0],
    [230.0, 110.0, 30.0],
    [20.0, 60.0, 160.0],
];

/// Returns the mean red, green and blue of each colour on this cube, from the stickers `seen` and
/// their decided `colours`; usual values for a colour that was not seen.
pub(super) fn palette(seen: &[Option<[f64; 3]>; 54], colours: &[u8; 54]) -> Palette {
    let (mut sums, mut counts) = ([[0.0; 3]; 6], [0_u32; 6]);
    for (rgb, &colour) in seen.iter().zip(colours) {
        let Some(rgb) = rgb else { continue };
        let colour = usize::from(colour);
        for (sum, value) in sums[colour].iter_mut().zip(rgb) {
            *sum += value;
        }
        counts[colour] += 1;
    }
    std::array::from_fn(|c| match counts[c] {
        0 => USUAL[c],
        count => sums[c].map(|sum| sum / f64::from(count)),
    })
}

/// Stickers that were seen, and the faces that are still wanted.
#[derive(Debug, Clone)]
pub(super) struct Sight {
    /// Stickers by facelet of the cube frame at acquisition.
    stickers: [Option<Sticker>; 54],
    /// Faces that the looks must show, and holds in which they are hidden.
    wanted: Wanted,
}

/// Light of a sticker.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sticker {
    /// Linear light; 1 is full scale at the nominal exposure.
    light: [f64; 3],
    /// Exposure at which a channel was clipped, so that the true light is more.
    clipped_at: Option<f64>,
}

impl Default for Sight {
    fn default() -> Self {
        Self { stickers: [None; 54], wanted: Wanted::default() }
    }
}

impl Sight {
    /// Stores the levels (0..=255) at which a camera saw a sticker at `exposure`. Clipped levels
    /// are a lower bound: the first ones are stored only if the exposure is at most the nominal
    /// one, and they give way to unclipped levels and to those of a shorter exposure.
    pub(super) fn see(&mut self, facelet: usize, levels: [f64; 3], exposure: f64) {
        let light = levels.map(|v| to_linear(v) / exposure);
        let clipped_at = levels.iter().any(|&v| v >= CLIPPED).then_some(exposure);
        let known = self.stickers[facelet].map(|s| s.clipped_at);
        let counts = match (clipped_at, known) {
            (None, _) => true,
            // A long exposure clips light below full scale, and would give too low a value.
            (Some(_), None) => exposure <= 1.0,
            // The shorter of two clipped exposures gives the higher lower bound of the light.
            (Some(now), Some(before)) => before.is_some_and(|before| now <= before),
        };
        if counts {
            self.stickers[facelet] = Some(Sticker { light, clipped_at });
        }
    }

    /// Returns the facelets that were not seen.
    pub(super) fn missing(&self) -> Vec<usize> {
        (0..54).filter(|&i| self.stickers[i].is_none()).collect()
    }

    /// Returns the levels of all stickers, 0..=255, in one picture whose exposure does not clip the
    /// brightest channel.
    pub(super) fn levels(&self) -> [Option<[f64; 3]>; 54] {
        let all = self.stickers.iter().flatten().flat_map(|s| s.light);
        let brightest = all.fold(1.0, f64::max);
        self.stickers.map(|s| s.map(|s| s.light.map(|v| to_level(v / brightest))))
    }

    /// Forgets the holds in which faces were hidden, since faces and holds have other names now.
    pub(super) fn rename(&mut self) {
        self.wanted.hidden.clear();
    }

    /// Forgets the stickers of the marked faces.
    pub(super) fn forget(&mut self, faces: [bool; 6]) {
        for facelet in (0..54).filter(|facelet| faces[facelet / 9]) {
            self.stickers[facelet] = None;
        }
    }

    /// Returns the faces that the looks must show, since they were not seen wholly, and the holds
    /// in which they are hidden.
    pub(super) fn wanted(&mut self) -> &Wanted {
        self.wanted.faces = [false; 6];
        for facelet in self.missing() {
            self.wanted.faces[facelet / 9] = true;
        }
        &self.wanted
    }

    /// Stores that a face is hidden while `hand` has the cube in `hold`, and returns the number of
    /// such entries.
    pub(super) fn hide(&mut self, hand: Hand, hold: Hold, face: Face) -> usize {
        self.wanted.hidden.push((hand, hold, face));
        self.wanted.hidden.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sticker_level_does_not_depend_on_exposure() {
        let light = [0.5, 0.2, 0.05];
        for exposure in [0.6, 1.0, 1.6] {
            let mut sight = Sight::default();
            sight.see(7, light.map(|v| to_level(v * exposure)), exposure);

            let seen = sight.levels()[7].unwrap();

            for (seen, light) in seen.iter().zip(light) {
                assert!((to_linear(*seen) - light).abs() < 1e-9, "{exposure}: {seen}");
            }
        }
    }

    #[test]
    fn unclipped_level_replaces_clipped_one() {
        let mut sight = Sight::default();
        let light = |sight: &Sight| sight.stickers[0].map(|s| s.light[0]);

        sight.see(0, [255.0, 100.0, 100.0], 1.6);
        assert_eq!(light(&sight), None);

        sight.see(0, [255.0, 100.0, 100.0], 1.0);
        assert_eq!(light(&sight), Some(1.0));

        sight.see(0, [255.0, 140.0, 140.0], 1.6);
        assert_eq!(light(&sight), Some(1.0));

        sight.see(0, [240.0, 80.0, 80.0], 0.6);
        let seen = light(&sight).unwrap();
        assert!(seen > 1.4, "{seen}");

        sight.see(0, [255.0, 100.0, 100.0], 1.0);
        assert_eq!(light(&sight), Some(seen));
        // The light exceeds full scale at the nominal exposure, but the decision sees no clipping.
        assert!(sight.levels()[0].unwrap().iter().all(|v| (0.0..=255.0).contains(v)));
    }
}
