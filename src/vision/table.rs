//! A colour table of a rig (cameras and lights that never move), learned from cubes of known state.
//!
//! In a rig the reflections are always at the same places. Each facelet therefore has its own mean
//! shift from its colour, and its own spread. While there are few samples, priors keep the shifts
//! near 0 and the spreads near that of all facelets.
//!
//! - in: mean RGB of 54 facelets with their true colours, several times
//! - out: [`ColourTable`]; with it, 54 mean colours -> [`Decision`]
//! - source: own work; shrinkage of means after Stein (1956)

use super::classes::{Expected, coordinates};
use super::whole::{Decision, Undecided, decide_cube, decide_expected};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Appearance of the six colours at each facelet in a rig.
///
/// ```
/// use rubik_robot_vision::table::{ColourTable, Unlearned};
///
/// assert_eq!(ColourTable::learn(&[]), Err(Unlearned::Unseen('U')));
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ColourTable {
    /// Mean place of each colour, 0..=5 = URFDLB, in the colour space (weighted lightness, a\*,
    /// b\*).
    means: [[f64; 3]; 6],
    /// Mean shift of each facelet from its colour, in the order URFDLB.
    shifts: Vec<[f64; 3]>,
    /// Variance of each facelet, relative to that of all facelets.
    variances: Vec<f64>,
    /// Covariance that all facelets share, row by row.
    covariance: [[f64; 3]; 3],
    /// Number of cubes that the table was learned from.
    pub cubes: usize,
}

/// A cube whose state is known: mean RGB of each facelet, 0..=255, and its colour, 0..=5 = URFDLB.
pub type KnownCube = ([[f64; 3]; 54], [u8; 54]);

/// Weight of the prior that a facelet is not shifted, in samples.
const UNSHIFTED: f64 = 2.0;
/// Weight of the prior that the spread of a facelet is that of all facelets, in samples.
const COMMON: f64 = 6.0;

/// Weight of the prior of the spread of all facelets, in samples.
const SPREAD_PRIOR: f64 = 18.0;
/// Expected standard deviation of all facelets, in units of the colour space.
const SPREAD: f64 = 5.0;

/// Reason why there is no usable table.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unlearned {
    /// None of the cubes has the colour of this face.
    #[error("no table can be learned: no cube has a sticker of the colour of face {0}")]
    Unseen(char),
    /// The covariance cannot be inverted, or a value of the table is not finite or missing.
    #[error("the colour table is not usable: a value is not finite, or a spread is not positive")]
    NoSpread,
}

impl ColourTable {
    /// Learns how the colours look at each facelet of a rig, from cubes of known state in that rig.
    ///
    /// # Errors
    /// [`Unlearned::Unseen`] if no cube has a facelet of some colour.
    pub fn learn(cubes: &[KnownCube]) -> Result<Self, Unlearned> {
        let samples: Vec<(usize, usize, Vector3<f64>)> = cubes
            .iter()
            .flat_map(|(rgb, truth)| {
                let points = coordinates(rgb);
                (0..54).map(move |i| (i, usize::from(truth[i]), points[i]))
            })
            .collect();
        let each = cubes.len() as f64;
        let mut means = [Vector3::zeros(); 6];
        let mut shifts = [Vector3::zeros(); 54];
        // Means depend on the shifts and the shifts on the means, so both are estimated
        // alternately.
        for _ in 0..10 {
            for (colour, mean) in means.iter_mut().enumerate() {
                let own = samples.iter().filter(|(_, c, _)| *c == colour);
                let (n, sum) = own.fold((0.0, Vector3::zeros()), |(n, sum), (i, _, p)| {
                    (n + 1.0, sum + (p - shifts[*i]))
                });
                if n == 0.0 {
                    return Err(Unlearned::Unseen(super::colours::face_letter(colour)));
                }
                *mean = sum / n;
            }
            let mut sums = [Vector3::zeros(); 54];
            for (i, colour, p) in &samples {
                sums[*i] += p - means[*colour];
            }
            // The prior counts like UNSHIFTED samples without a shift (shrinkage).
            shifts = sums.map(|sum| sum / (each + UNSHIFTED));
        }
        let mut scatter = Matrix3::identity() * (SPREAD_PRIOR * SPREAD * SPREAD);
        let mut squares = [0.0; 54];
        for (i, colour, p) in &samples {
            let d = p - means[*colour] - shifts[*i];
            scatter += d * d.transpose();
            squares[*i] += d.norm_squared();
        }
        let covariance: Matrix3<f64> = scatter / (SPREAD_PRIOR + samples.len() as f64);
        // A facelet has too few samples for a covariance of its own, so only the size of its
        // covariance, relative to that of all facelets, is learned.
        let variances = squares
            .map(|sum| (sum + COMMON * covariance.trace()) / (each + COMMON) / covariance.trace());
        Ok(Self {
            means: means.map(Into::into),
            shifts: shifts.map(Into::into).to_vec(),
            variances: variances.to_vec(),
            covariance: covariance.transpose().into(),
            cubes: cubes.len(),
        })
    }

    /// Decides the colours of the 54 facelets of a cube in the rig from which the table was
    /// learned. `rgb` is their mean colour, 0..=255.
    ///
    /// # Errors
    /// [`Undecided`] as in [`decide_cube`].
    pub fn decide(&self, rgb: &[[f64; 3]; 54]) -> Result<Decision, Undecided> {
        match self.expected() {
            Ok(expected) => decide_expected(rgb, expected),
            // A table that is not usable has no information, so the cube is decided without it.
            Err(_) => decide_cube(rgb),
        }
    }

    /// Checks whether the table is usable, as must be done for a table that was read from a file.
    ///
    /// # Errors
    /// [`Unlearned::NoSpread`] if the table is not usable.
    pub fn check(&self) -> Result<(), Unlearned> {
        self.expected().map(|_| ())
    }

    /// Converts the table to the prior knowledge from which the colours are decided.
    ///
    /// # Errors
    /// [`Unlearned::NoSpread`] if the covariance cannot be inverted, or a value is not finite or
    /// missing.
    fn expected(&self) -> Result<Expected, Unlearned> {
        let covariance = Matrix3::from(self.covariance);
        let precision = covariance.cholesky().map(|f| f.inverse()).ok_or(Unlearned::NoSpread)?;
        let shifts: [[f64; 3]; 54] =
            self.shifts.as_slice().try_into().map_err(|_| Unlearned::NoSpread)?;
        let variances: [f64; 54] =
            self.variances.as_slice().try_into().map_err(|_| Unlearned::NoSpread)?;
        // A file may contain any values, and a single NaN would spoil the colours of all facelets.
        let numbers = self.means.iter().chain(&shifts).flatten().all(|v| v.is_finite());
        let positive = variances.iter().all(|v| v.is_finite() && *v > 0.0);
        if !numbers || !positive {
            return Err(Unlearned::NoSpread);
        }
        Ok(Expected {
            means: self.means.map(Vector3::from),
            shifts: shifts.map(Vector3::from),
            variances,
            precision,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::{Cube, Facelets};

    /// Returns the colours that a camera in a rig measures: the haze on each face makes some
    /// colours look like others.
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

    /// Returns the facelets of a scrambled cube.
    fn state(seed: u64) -> [u8; 54] {
        *Facelets::from(&Cube::scrambled(seed)).colours()
    }

    #[test]
    fn table_learned_from_four_cubes_reads_others() {
        let known: Vec<KnownCube> = (0..4).map(|k| (measured(&state(k), k), state(k))).collect();

        let table = ColourTable::learn(&known).unwrap();

        table.check().unwrap();
        for k in 10..30 {
            assert_eq!(table.decide(&measured(&state(k), k)).unwrap().facelets, state(k));
        }
    }

    #[test]
    fn learning_without_green_stickers_names_green_face() {
        let mut known = (measured(&state(1), 1), state(1));
        known.1.iter_mut().filter(|c| **c == 2).for_each(|c| *c = 1);

        assert_eq!(ColourTable::learn(&[known]), Err(Unlearned::Unseen('F')));
    }
}
