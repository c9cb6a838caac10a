//! The names (white, red and so on) of six classes of facelets that were sorted without names.
//!
//! - in: linear RGB of 54 facelets, and the class of each facelet
//! - out: the colour of each class, 0..=5 = white, red, green, yellow, orange, blue
//! - source: own work

use super::assignment::assign;
use super::classes::median;
use super::colours::{Light, Seen, fit_light, prototype_distances};
use super::likeliest::CENTRES;
use crate::cube::{Facelets, Rotation24};
use std::sync::LazyLock;

/// Colours of the six faces of a cube of the common scheme, in each of its 24 orientations.
static SCHEMES: LazyLock<Vec<[u8; 6]>> = LazyLock::new(|| {
    let solved = Facelets::solved();
    Rotation24::all().map(|r| CENTRES.map(|c| solved.rotated(r).colours()[c])).collect()
});

/// Difference of cost (in squared distances) by which another colour scheme must be better than the
/// common one. Cubes of other schemes are rare, and a bad light must not look like one.
const UNCOMMON: f64 = 15.0;

/// Returns the colour 0..=5 of each of the six classes. The colours are those of the common scheme,
/// in the orientation of the cube and under the light with which the classes look most like their
/// colours. Another scheme is taken only if it fits far better.
///
/// `linear` is the linear RGB of each facelet, and `class` its class, 0..=5.
pub(super) fn name(linear: &[[f64; 3]; 54], class: &[u8; 54]) -> [u8; 6] {
    // The colour of a class is the median of its facelets, which a single reflection hardly moves.
    let means: [[f64; 3]; 6] = std::array::from_fn(|class_| {
        std::array::from_fn(|c| {
            let members = (0..54).filter(|&i| usize::from(class[i]) == class_);
            median(members.map(|i| linear[i][c]).collect())
        })
    });
    let price = |d: &[[f64; 6]], names: &[u8; 6]| -> f64 {
        d.iter().zip(names).map(|(d, &n)| d[usize::from(n)]).sum()
    };
    let common = |d: &[[f64; 6]]| {
        SCHEMES
            .iter()
            .map(|s| (price(d, s), *s))
            .fold((f64::INFINITY, [0; 6]), |best, next| if next.0 < best.0 { next } else { best })
    };
    let seen = means.map(Seen::whole);
    let (light, cost) = fit_light(&seen, |d| common(d).0);
    let under = |light: Light| means.map(|m| prototype_distances(light.undo(m)));
    // Costs are never negative, so no other scheme can be better by `UNCOMMON`. For most cubes this
    // saves the second fit.
    if cost < UNCOMMON {
        return common(&under(light)).1;
    }
    // Any other scheme has each name once, at any of the six faces.
    let any = |d: &[[f64; 6]]| -> [u8; 6] {
        let columns = assign(&d.iter().flatten().copied().collect::<Vec<_>>(), 6);
        std::array::from_fn(|i| columns[i] as u8)
    };
    let (other_light, other_cost) = fit_light(&seen, |d| price(d, &any(d)));
    if cost - other_cost > UNCOMMON { any(&under(other_light)) } else { common(&under(light)).1 }
}
