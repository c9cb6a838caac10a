//! The names of six classes of facelets that were sorted without names: white, red and so on.
//!
//! - in: linear light of 54 facelets, and the class of each one
//! - out: colour of each class, 0..=5 = white, red, green, yellow, orange, blue
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

/// Least advantage of another scheme over the common one, in squared distances. Cubes of other
/// schemes are rare, and a bad light must not invent one.
const UNCOMMON: f64 = 15.0;

/// Returns the colour 0..=5 of each of the six classes. It is that of the common colour scheme, in
/// the orientation of the cube and under the light in which the classes look most like their
/// colours. Another scheme is taken only if it fits far better.
///
/// `linear` is the light of each facelet, and `class` the class of each facelet.
pub(super) fn name(linear: &[[f64; 3]; 54], class: &[u8; 54]) -> [u8; 6] {
    // Medians, because a glaring facelet must not shift its class.
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
    // Costs are never negative, so no other scheme can be better by enough. This saves most second
    // fits.
    if cost < UNCOMMON {
        return common(&under(light)).1;
    }
    // Any other scheme: each name once, without regard to which faces are opposite.
    let any = |d: &[[f64; 6]]| -> [u8; 6] {
        let columns = assign(&d.iter().flatten().copied().collect::<Vec<_>>(), 6);
        std::array::from_fn(|i| columns[i] as u8)
    };
    let (other_light, other_cost) = fit_light(&seen, |d| price(d, &any(d)));
    if cost - other_cost > UNCOMMON { any(&under(other_light)) } else { common(&under(light)).1 }
}
