//! The separation of two arms on paths that are not in the table of meetings: between a meeting and
//! the place where the track takes a cube.
//!
//! - in: the believed cell; joint positions of both arms at a meeting, and where they are apart
//! - out: the distance by which the track must retract from the meeting (m), so that the straight
//!   path in joint space between that place and the place apart is free

use super::motors::MOMENTS;
use super::settings::ReachSettings;
use super::way::{clearance, separations};
use crate::cell::Cell;
use crate::motion::JointPositions;
use std::sync::Arc;

/// Search for the least separation of two arms between a meeting and places where they are apart.
#[derive(Debug, Clone)]
pub struct WayFinder {
    cell: Arc<Cell>,
    settings: ReachSettings,
}

impl WayFinder {
    /// Makes a finder for the cell as the controller believes it to be.
    #[must_use]
    pub fn new(cell: Cell, settings: ReachSettings) -> Self {
        Self { cell: Arc::new(cell), settings }
    }

    /// Returns the least distance by which the track must retract from the meeting with the joint
    /// positions `met` (m). From the retracted place the straight path in joint space to the
    /// positions `apart`, and back, keeps the clearance. `newcomer` is the arm whose hand is free:
    /// 0 track, 1 postument.
    ///
    /// Returns `None` if no distance up to [`ReachSettings::separation`] suffices, or if the arms
    /// are nearer than the clearance at the meeting or during the retraction. They are, for
    /// example, where both hands have their fingers beside one cube.
    #[must_use]
    pub fn least_separation(
        &self,
        apart: &[JointPositions; 2],
        met: &[JointPositions; 2],
        newcomer: usize,
    ) -> Option<f64> {
        let drawn_back = |by: f64| {
            let mut joints = *met;
            joints[0].0[0] -= by;
            joints
        };
        let evenly = |to: [JointPositions; 2], part: f64| {
            [0, 1].map(|arm: usize| apart[arm].towards(&to[arm], part))
        };
        let moments = || (0..=MOMENTS).map(|step| f64::from(step) / f64::from(MOMENTS));
        // The retraction itself must be free: the search ends at its first place that is not.
        separations(self.settings.separation)
            .take_while(|by| self.clears(&drawn_back(*by), newcomer))
            .find(|by| {
                let to = drawn_back(*by);
                moments().all(|part| self.clears(&evenly(to, part), newcomer))
            })
    }

    /// Makes a finder for the example cell.
    #[cfg(test)]
    pub(crate) fn of_example() -> Self {
        Self::new(super::example_cell(), ReachSettings::default())
    }

    /// Returns the joint positions of both arms of the example cell at the start of a run, far
    /// apart.
    #[cfg(test)]
    pub(crate) fn example_start() -> [JointPositions; 2] {
        [0, 1].map(|arm: usize| super::example_cell().arms[arm].start)
    }

    /// Returns joint positions of both arms near a meeting of the example cell, and the least
    /// distance (m) by which the track must retract from there. Only then may it go to its start
    /// while the postument stays.
    #[cfg(test)]
    pub(crate) fn example_place(&self) -> ([JointPositions; 2], f64) {
        let table = super::MeetingTable::compute(&self.cell, &self.settings);
        let [track, _] = Self::example_start();
        // The track is moved beyond the meeting in steps of 1 cm, until it must retract.
        let nearer = |met: [JointPositions; 2]| {
            (0..20).map(move |step| {
                let mut met = met;
                met[0].0[0] += 0.01 * f64::from(step);
                met
            })
        };
        let mut places = table.grasps.iter().flatten().flat_map(|m| nearer(m.short_of(1)));
        let found = places.find_map(|met| {
            let by = self.least_separation(&[track, met[1]], &met, 1)?;
            (by > 0.0).then_some((met, by))
        });
        found.unwrap_or_else(|| unreachable!("near some meetings the track must retract"))
    }

    /// Returns whether both arms keep the clearance at these joint positions.
    fn clears(&self, joints: &[JointPositions; 2], newcomer: usize) -> bool {
        clearance(&self.cell, joints, newcomer) >= self.settings.clearance
    }
}

#[cfg(test)]
mod tests {
    use super::super::MeetingTable;
    use super::super::way::FINE;
    use super::*;

    #[test]
    fn least_separation_is_shortest_distance_keeping_clearance() {
        let finder = WayFinder::of_example();
        let (cell, settings) = (&finder.cell, finder.settings);
        let table = MeetingTable::compute(cell, &settings);
        let apart = WayFinder::example_start();
        let mut kept = Vec::new();
        for (i, meeting) in table.grasps.iter().flatten().enumerate() {
            let met = meeting.short_of(i % 2);
            // The least clearance on the path after a retraction by this distance.
            let least = |by: f64, moments: u32| {
                let clearances = (0..=moments).map(|moment| {
                    let mut to = met;
                    to[0].0[0] -= by;
                    let part = f64::from(moment) / f64::from(moments);
                    let joints = [0, 1].map(|arm: usize| apart[arm].towards(&to[arm], part));
                    clearance(cell, &joints, i % 2)
                });
                clearances.fold(f64::INFINITY, f64::min)
            };
            let by = finder.least_separation(&apart, &met, i % 2).unwrap();
            // At more moments than the finder checks, the arms may come 4 mm nearer.
            assert!(least(by, 400) > settings.clearance - 0.004, "{by} m: {meeting:?}");
            if by > 0.0 {
                assert!(least(by - FINE, MOMENTS) < settings.clearance, "{by} m: {meeting:?}");
            }
            kept.push(by);
        }
        assert!(kept.contains(&0.0) && kept.iter().any(|by| *by > 0.0), "{kept:?}");
    }
}
