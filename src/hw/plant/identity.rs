//! Identity of a plant: a plant continues only from a saved state of the same identity.

use super::config::{HandScript, MotorDynamics, PlantConfig};
use super::objects::spec::Probe;
use crate::cell::MOST_ARMS;
use crate::motion::JointPositions;
use serde::{Deserialize, Serialize};
use std::fmt::Debug;

/// Returns the probes of the arms: always two at least, as before there were cells of more arms.
fn probes_of(config: &PlantConfig) -> &[Option<Probe>] {
    &config.probes[..config.cell.arms.len().clamp(2, MOST_ARMS)]
}

/// Returns a CRC-32 over all digits of each number of `parts`, in the order of the fields.
fn checksum(parts: &dyn Debug) -> u32 {
    crc32fast::hash(format!("{parts:?}").as_bytes())
}

/// Checksums of the parts that make a plant, independent of its history. A saved state fits any
/// plant of the same identity.
///
/// The start of the run is not part of the identity, since the saved state replaces it. Faults and
/// the period's length are not part of it either: they may differ when a run continues.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Seed of the run.
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
            objects,
            probes: _,
            leads,
            period: _,
            substeps,
        } = config;
        // The start poses belong to the start of a run.
        let mut cell = cell.clone();
        for arm in &mut cell.arms {
            arm.start = JointPositions::default();
        }
        let mut mechanics = checksum(&(arms, cube, jaws, noise, hand, substeps));
        // A cell without objects keeps the identity that it had before there were any.
        let probes = probes_of(config);
        if !objects.is_empty() || !leads.is_empty() || probes.iter().any(Option::is_some) {
            mechanics ^= checksum(&(objects, probes, leads));
        }
        Self { seed, cell: checksum(&cell), mechanics }
    }

    /// Number of the model. Each change of its equations that may make a task easier or harder
    /// raises it: times of two models are not comparable.
    const MODEL: u32 = 3;

    /// Returns a CRC-32 over the number of the model and the parameters that decide how fast and
    /// how gently a task can be done: motors with their limits and friction, pads, layers of the
    /// cube, ranges and delay of the force sensors, the operator's times, the period and its
    /// substeps.
    ///
    /// Campaigns draw the other parameters for each run: the errors of the cell, noise, and how the
    /// operator's hand shakes and tilts. They make a run different, but not easier.
    #[must_use]
    pub fn bounds(config: &PlantConfig) -> u32 {
        let PlantConfig { cell, arms, cube, jaws, noise, hand, period, substeps, .. } = config;
        let PlantConfig { objects, leads, .. } = config;
        let HandScript {
            appears,
            arrival,
            start_offset,
            sway: _,
            sway_time: _,
            tremor: _,
            stills,
            place_spread,
            tilt_spread: _,
            any_orientation,
            withdrawals,
            withdrawal,
            stiffness,
            damping,
            release_load,
            release_time,
            return_after,
            picks_up_after,
            return_solved_only,
            pull,
        } = hand;
        let steps = (period, substeps);
        let limits: Vec<_> = cell
            .arms
            .iter()
            .map(|arm| (arm.sensor.range, arm.model.motor_speed_limit, arm.model.motor_limits))
            .collect();
        let operator = (
            (appears, arrival, start_offset, stills, place_spread, any_orientation),
            (withdrawals, withdrawal, stiffness, damping),
            (release_load, release_time, return_after, picks_up_after, return_solved_only, pull),
        );
        let heats = MotorDynamics::HEATS;
        let delay = noise.delay_periods;
        let known =
            checksum(&(Self::MODEL, arms, cube, jaws, steps, limits, heats, delay, operator));
        let probes = probes_of(config);
        if objects.is_empty() && leads.is_empty() && probes.iter().all(Option::is_none) {
            return known;
        }
        known ^ checksum(&(objects, probes, leads))
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
    use super::super::config::{CubeMechanics, Jaws};
    use super::super::testing::{cell, quiet};
    use super::*;

    #[test]
    fn limits_hash_ignores_campaign_variations() {
        let plain = quiet(cell());
        let mut drawn = plain.clone();
        drawn.cell.arms[0].world_from_base.translation.x += 0.001;
        drawn.noise.force += 0.1;
        drawn.hand.sway *= 2.0;

        assert_eq!(Identity::bounds(&plain), Identity::bounds(&drawn));
    }

    #[test]
    fn limits_hash_changes_with_each_limit() {
        let plain = quiet(cell());
        let changes: [fn(&mut PlantConfig); 12] = [
            |c| c.arms[0].motors[1].trip_current *= 1.1,
            |c| c.arms[1].motors[6].coulomb *= 0.9,
            |c| c.cell.arms[0].model.motor_speed_limit *= 1.1,
            |c| c.cell.arms[1].sensor.range[0] *= 2.0,
            |c| c.cube = CubeMechanics::modern(),
            |c| c.jaws = Jaws::stiff(),
            |c| c.noise.delay_periods += 1,
            |c| c.substeps += 1,
            |c| c.hand.appears = 0.1,
            |c| c.hand.arrival = 0.5,
            |c| c.hand.release_time = 0.1,
            |c| c.hand.return_after = 1.0,
        ];
        for (number, change) in changes.iter().enumerate() {
            let mut other = plain.clone();
            change(&mut other);
            assert_ne!(Identity::bounds(&plain), Identity::bounds(&other), "change {number}");
        }
    }
}
