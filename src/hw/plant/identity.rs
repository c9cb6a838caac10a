//! Which plants a kept state goes with.

use super::config::{MotorDynamics, PlantConfig};
use crate::motion::JointPositions;
use serde::{Deserialize, Serialize};
use std::fmt::Debug;

/// What a plant is made of, whatever became of it: a state goes with any plant of the same
/// identity.
///
/// How a run begins is not in it, since the state tells; nor are faults and the period's length,
/// which may be others when a run goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    seed: u64,
    /// CRC-32 over the true cell.
    cell: u32,
    /// CRC-32 over the rest: drives, cube, pads, sensors, the operator's hand.
    mechanics: u32,
}

impl Identity {
    /// Returns the identity of a plant that is to be made.
    #[must_use]
    pub fn of(config: &PlantConfig, seed: u64) -> Self {
        // All fields are named, so that a new one needs a decision here, and in `bounds`.
        let PlantConfig {
            cell,
            arms,
            cube,
            jaws,
            noise,
            hand,
            start: _,
            start_grip: _,
            facelets: _,
            synchronised: _,
            faults: _,
            period: _,
            substeps,
        } = config;
        let mut cell = cell.clone();
        for arm in &mut cell.arms {
            arm.start = JointPositions::default();
        }
        // All digits of each number, in the order of the fields.
        let sum = |what: &dyn Debug| crc32fast::hash(format!("{what:?}").as_bytes());
        let mechanics = sum(&(arms, cube, jaws, noise, hand, substeps));
        Self { seed, cell: sum(&cell), mechanics }
    }

    /// Returns a CRC-32 over what bounds a run's speed and force: drives with what trips them and
    /// their friction, pads, ranges of the sensors, the step of time. Not what a campaign varies:
    /// cube, noise, errors of the cell, the operator's hand.
    #[must_use]
    pub fn bounds(config: &PlantConfig) -> u32 {
        let PlantConfig { cell, arms, jaws, substeps, .. } = config;
        let ranges: Vec<_> = cell.arms.iter().map(|arm| arm.sensor.range).collect();
        let heats = MotorDynamics::HEATS;
        crc32fast::hash(format!("{arms:?} {jaws:?} {substeps:?} {ranges:?} {heats}").as_bytes())
    }

    /// Returns why a plant of this identity cannot go on with a state of `other`.
    pub(super) fn differs(&self, other: &Self) -> Option<String> {
        if self.seed != other.seed {
            return Some(format!("its seed is {}, not {}", other.seed, self.seed));
        }
        if self.cell != other.cell {
            return Some("it was made in another cell, or with other plant.errors".to_owned());
        }
        let same = self.mechanics == other.mechanics;
        (!same).then(|| "it was made with other plant keys".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{cell, quiet};
    use super::*;

    #[test]
    fn bounds_change_with_a_trip_and_nothing_drawn() {
        let plain = quiet(cell());
        let mut drawn = plain.clone();
        drawn.cell.arms[0].world_from_base.translation.x += 0.001;
        drawn.noise.force += 0.1;
        let mut strict = plain.clone();
        strict.arms[0].motors[1].trip_current *= 0.9;

        assert_eq!(Identity::bounds(&plain), Identity::bounds(&drawn));
        assert_ne!(Identity::bounds(&plain), Identity::bounds(&strict));
    }
}
