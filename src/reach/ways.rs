//! The usual paths between meetings. The track is retracted by the separation, and the newcomer
//! (the arm whose hand is free) along its tool; the other hand has the cube. All joints move evenly
//! from one meeting to the next.

use super::bodies::{Bodies, newcomer_apart};
use super::meeting::Meeting;
use crate::cell::Cell;
use nalgebra::Vector3;

/// Number of steps in which a path is checked. Joints move by up to 4 rad on a path, and wrists by
/// less than 0.1 m in a step.
const STEPS: u32 = 16;

/// Returns the least distance between the arms, and of each hand from its own arm, on the usual
/// path between two meetings, for either hand as the free one (m). `separation` is the distance by
/// which the track is retracted (m). The path back has the same least distance.
pub(super) fn way_clearance(cell: &Cell, separation: f64, a: &Meeting, b: &Meeting) -> f64 {
    let mut least = f64::INFINITY;
    for newcomer in 0..2 {
        let (from, to) = (a.short_of(newcomer), b.short_of(newcomer));
        for step in 0..=STEPS {
            let part = f64::from(step) / f64::from(STEPS);
            let [track, postument] = [0, 1].map(|arm: usize| {
                let joints = from[arm].towards(&to[arm], part);
                Bodies::of(cell, &cell.arms[arm], &joints)
            });
            least = least.min(track.own()).min(postument.own());
            let track = track.moved(cell.arms[0].world_from_base * (-separation * Vector3::y()));
            least = least.min(newcomer_apart(newcomer, &track, &postument));
        }
    }
    least
}
