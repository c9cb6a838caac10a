//! Identity of a plant: the plants that can continue from a saved state.

use super::config::{MotorDynamics, PlantConfig};
use crate::motion::JointPositions;
use serde::{Deserialize, Serialize};
use std::fmt::Debug;

/// Checksums of the parts that make a plant, independent of its history. A saved state fits any
/// plant of the same identity.
///
/// The start of the run is not part of it, since the state replaces it; nor are faults and the
/// period's length, which may differ when a run continues.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    seed: u64,
    /// CRC-32 over the true cell.
    cell: u32,
    /// CRC-32 over the rest: drives, cube, pads, sensors, the operator's hand.
    mechanics: u32,
}

impl Identity {
    /// Returns the identity of a plant with this configuration and seed.
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
        // The start poses belong to the start of a run.
        let mut cell = cell.clone();
        for arm in &mut cell.arms {
            arm.start = JointPositions::default();
        }
        // All digits of each number, in the order of the fields.
        let sum = |what: &dyn Debug| crc32fast::hash(format!("{what:?}").as_bytes());
        let mechanics = sum(&(arms, cube, jaws, noise, hand, substeps));
        Self { seed, cell: sum(&cell), mechanics }
    }

    /// Returns a CRC-32 over the parameters that limit the speed and force of a run: motors with
    /// their trip currents and friction, pads, ranges of the sensors, the time step. A campaign may
    /// vary the other parameters: cube, noise, errors of the cell, the operator's hand.
    #[must_use]
    pub fn bounds(config: &PlantConfig) -> u32 {
        let PlantConfig { cell, arms, jaws, substeps, .. } = config;
        let ranges: Vec<_> = cell.arms.iter().map(|arm| arm.sensor.range).collect();
        let heats = MotorDynamics::HEATS;
        crc32fast::hash(format!("{arms:?} {jaws:?} {substeps:?} {ranges:?} {heats}").as_bytes())
    }

    /// Returns the reason why a plant of this identity cannot continue with a state of `other`.
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
    fn speed_and_force_limits_hash_ignores_campaign_variations() {
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
