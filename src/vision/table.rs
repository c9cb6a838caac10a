//! A colour table of a rig that never moves, learned from cubes of known state.
//!
//! In a rig each face has its own light and its own reflections, always the same ones; so each face has its own
//! mean of each colour, drawn towards that colour's mean over all faces as long as few samples are known.
//!
//! - in: mean RGB of 54 facelets with their true colours, several times
//! - out: [`ColourTable`]; with it, 54 mean colours -> [`Decision`]
//! - source: own work; shrinkage of means after Stein (1956)

use super::colours::{lab, to_linear};
use super::whole::{Decision, Undecided, bent, conclude};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// What each colour looks like on each face of a rig.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ColourTable {
    /// Mean L*a*b* by face of the rig and by colour, both 0..=5 = URFDLB.
    means: [[[f64; 3]; 6]; 6],
    /// Covariance that all of them have in common, row by row.
    covariance: [[f64; 3]; 3],
    /// How many cubes it was learned from.
    pub cubes: usize,
}

/// A cube whose state is known: mean RGB of each facelet, 0..=255, and its colour, 0..=5 = URFDLB.
pub type KnownCube = ([[f64; 3]; 54], [u8; 54]);

/// Samples' worth of belief that a colour looks on one face as it does on all.
const SHARED: f64 = 2.0;

/// Samples' worth of belief in a standard deviation of [`SPREAD`] units.
const SPREAD_PRIOR: f64 = 18.0;
const SPREAD: f64 = 5.0;

/// No table.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unlearned {
    /// A colour was never seen.
    #[error("colour {0} is on none of the cubes")]
    Unseen(char),
    /// The covariance cannot be inverted, or the table has values that are no numbers.
    #[error("the table has no usable spread")]
    NoSpread,
}

fn point(rgb: &[f64; 3]) -> Vector3<f64> {
    Vector3::from(lab(rgb.map(to_linear)))
}

impl ColourTable {
    /// Learns from cubes of known state.
    ///
    /// # Errors
    /// [`Unlearned::Unseen`] when a colour does not occur.
    pub fn learn(cubes: &[KnownCube]) -> Result<Self, Unlearned> {
        let samples: Vec<(usize, usize, Vector3<f64>)> = cubes
            .iter()
            .flat_map(|(rgb, truth)| {
                (0..54).map(move |i| (i / 9, usize::from(truth[i]), point(&rgb[i])))
            })
            .collect();
        let sum = |keep: &dyn Fn(usize, usize) -> bool| {
            samples
                .iter()
                .filter(|(face, colour, _)| keep(*face, *colour))
                .fold((0.0, Vector3::zeros()), |(n, s), (_, _, p)| (n + 1.0, s + p))
        };
        let mut means = [[[0.0; 3]; 6]; 6];
        for colour in 0..6 {
            let (n, total) = sum(&|_, c| c == colour);
            if n == 0.0 {
                return Err(Unlearned::Unseen(super::colours::face_letter(colour)));
            }
            let shared = total / n;
            for (face, row) in means.iter_mut().enumerate() {
                let (n, total) = sum(&|f, c| f == face && c == colour);
                row[colour] = ((total + shared * SHARED) / (n + SHARED)).into();
            }
        }
        let mut scatter = Matrix3::identity() * (SPREAD_PRIOR * SPREAD * SPREAD);
        for (face, colour, p) in &samples {
            let d = p - Vector3::from(means[*face][*colour]);
            scatter += d * d.transpose();
        }
        let covariance = scatter / (SPREAD_PRIOR + samples.len() as f64);
        Ok(Self { means, covariance: covariance.transpose().into(), cubes: cubes.len() })
    }

    /// Decides the 54 facelets of a cube in the rig.
    ///
    /// # Errors
    /// [`Undecided`] as for a cube without a table.
    pub fn decide(&self, rgb: &[[f64; 3]; 54]) -> Result<Decision, Undecided> {
        if let Some(i) = rgb.iter().position(|c| c.iter().any(|v| !v.is_finite())) {
            return Err(Undecided::NotANumber(i));
        }
        let precision = self.precision().unwrap_or_else(|_| Matrix3::identity());
        let costs = std::array::from_fn(|i| {
            std::array::from_fn(|c| {
                let d = point(&rgb[i]) - Vector3::from(self.means[i / 9][c]);
                bent(d.dot(&(precision * d)))
            })
        });
        conclude(rgb, &costs)
    }

    /// Whether the table can be used: for one that was read from a file.
    ///
    /// # Errors
    /// [`Unlearned::NoSpread`].
    pub fn check(&self) -> Result<(), Unlearned> {
        let finite = self.means.iter().flatten().flatten().all(|v| v.is_finite());
        if finite { self.precision().map(|_| ()) } else { Err(Unlearned::NoSpread) }
    }

    fn precision(&self) -> Result<Matrix3<f64>, Unlearned> {
        Matrix3::from(self.covariance)
            .cholesky()
            .map(|factor| factor.inverse())
            .ok_or(Unlearned::NoSpread)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::{Cube, Facelets};

    /// Stickers under a rig's light: each face has its own haze, and lightens some colours into others.
    fn measured(state: &[u8; 54], noise: u64) -> [[f64; 3]; 54] {
        const STICKERS: [[f64; 3]; 6] = [
            [220.0, 220.0, 220.0],
            [160.0, 20.0, 30.0],
            [20.0, 130.0, 60.0],
            [210.0, 190.0, 30.0],
            [200.0, 70.0, 20.0],
            [20.0, 50.0, 130.0],
        ];
        std::array::from_fn(|i| {
            let haze = [0.0, 90.0, 20.0, 60.0, 110.0, 30.0][i / 9];
            let wobble = ((i as u64 * 7919 + noise * 104_729) % 13) as f64 - 6.0;
            STICKERS[usize::from(state[i])].map(|v| v + haze * (1.0 - v / 255.0) + wobble)
        })
    }

    fn state(seed: u64) -> [u8; 54] {
        *Facelets::from(&Cube::scrambled(seed)).colours()
    }

    #[test]
    fn a_table_learned_from_four_cubes_reads_others() {
        let known: Vec<KnownCube> = (0..4).map(|k| (measured(&state(k), k), state(k))).collect();

        let table = ColourTable::learn(&known).unwrap();

        table.check().unwrap();
        for k in 10..30 {
            assert_eq!(table.decide(&measured(&state(k), k)).unwrap().facelets, state(k));
        }
    }

    #[test]
    fn a_colour_that_was_never_seen_is_named() {
        let mut known = (measured(&state(1), 1), state(1));
        known.1.iter_mut().filter(|c| **c == 2).for_each(|c| *c = 1);

        assert_eq!(ColourTable::learn(&[known]), Err(Unlearned::Unseen('F')));
    }
}
