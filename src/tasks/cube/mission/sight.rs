//! What the cameras in the hands have seen of the cube's stickers.
//!
//! A sticker is kept as light, not as a level of one picture: looks at several exposures are decided
//! together.
//!
//! - in: readings of faces, each at its exposure
//! - out: the light of 54 stickers, and how each colour of this cube looks
//! - source: own work

use crate::cube::Face;
use crate::tasks::cube::hold::{Hand, Hold};
use crate::tasks::cube::identify::Wanted;
use crate::vision::colours::{CLIPPED, to_level, to_linear};

/// Colours as this cube's stickers look, by face (0..=255 each).
pub(super) type Palette = [[f64; 3]; 6];

/// How a sticker looks whose colour was never seen on this cube, since the operator has given it.
const USUAL: Palette = [
    [225.0, 225.0, 220.0],
    [180.0, 30.0, 35.0],
    [20.0, 150.0, 60.0],
    [220.0, 210.0, 40.0],
    [230.0, 110.0, 30.0],
    [20.0, 60.0, 160.0],
];

/// Returns the mean of what was seen of each colour.
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

/// All stickers as far as they were seen, and which of them are wanted.
#[derive(Debug, Clone)]
pub(super) struct Sight {
    /// By facelet of the cube frame at acquisition.
    stickers: [Option<Sticker>; 54],
    /// What is wanted of the looks, and what they are not to be tried in.
    wanted: Wanted,
}

/// What was seen of a sticker.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sticker {
    /// Linear light; 1 is full scale at the nominal exposure.
    light: [f64; 3],
    /// The exposure at which a channel was clipped: there was more light than this.
    clipped_at: Option<f64>,
}

impl Default for Sight {
    fn default() -> Self {
        Self { stickers: [None; 54], wanted: Wanted::default() }
    }
}

impl Sight {
    /// Keeps a sticker's levels, 0..=255, seen at an exposure. A clipped level of a picture that is
    /// exposed for longer than usual says nothing, and one of another picture only as long as no
    /// picture says more.
    pub(super) fn see(&mut self, facelet: usize, levels: [f64; 3], exposure: f64) {
        let light = levels.map(|v| to_linear(v) / exposure);
        let clipped_at = levels.iter().any(|&v| v >= CLIPPED).then_some(exposure);
        let known = self.stickers[facelet].map(|s| s.clipped_at);
        let tells = match (clipped_at, known) {
            (None, _) => true,
            (Some(_), None) => exposure <= 1.0,
            (Some(now), Some(before)) => before.is_some_and(|before| now <= before),
        };
        if tells {
            self.stickers[facelet] = Some(Sticker { light, clipped_at });
        }
    }

    /// Returns the facelets that were not seen.
    pub(super) fn missing(&self) -> Vec<usize> {
        (0..54).filter(|&i| self.stickers[i].is_none()).collect()
    }

    /// Returns levels as one picture of the whole cube would have them, 0..=255, whose brightest
    /// channel is not clipped.
    pub(super) fn levels(&self) -> [Option<[f64; 3]>; 54] {
        let all = self.stickers.iter().flatten().flat_map(|s| s.light);
        let brightest = all.fold(1.0, f64::max);
        self.stickers.map(|s| s.map(|s| s.light.map(|v| to_level(v / brightest))))
    }

    /// Takes note that the cube's faces have other names from now on: holds are no longer those in
    /// which something was hidden.
    pub(super) fn rename(&mut self) {
        self.wanted.hidden.clear();
    }

    /// Forgets the stickers of the faces marked.
    pub(super) fn forget(&mut self, faces: [bool; 6]) {
        for facelet in (0..54).filter(|facelet| faces[facelet / 9]) {
            self.stickers[facelet] = None;
        }
    }

    /// Returns what the looks are to show: the faces that were not seen wholly, in holds in which
    /// they are not hidden.
    pub(super) fn wanted(&mut self) -> &Wanted {
        self.wanted.faces = [false; 6];
        for facelet in self.missing() {
            self.wanted.faces[facelet / 9] = true;
        }
        &self.wanted
    }

    /// Keeps that a face is hidden in a hold; returns how many such pairs are known.
    pub(super) fn hide(&mut self, hand: Hand, hold: Hold, face: Face) -> usize {
        self.wanted.hidden.push((hand, hold, face));
        self.wanted.hidden.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sticker_looks_alike_at_every_exposure() {
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
        // More light than a picture at the nominal exposure can tell, and yet not clipped for the decision.
        assert!(sight.levels()[0].unwrap().iter().all(|v| (0.0..=255.0).contains(v)));
    }
}
