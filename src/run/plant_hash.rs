//! Hash of everything that limits how fast a simulated task can be done. It stands beside the time
//! of a run, and shows whether two times were measured under the same limits.
//!
//! | part | parameters |
//! |---|---|
//! | plant | model, motors, pads, layers of the cube, sensors, the operator's times, periods |
//! | drives | pulse widths and their slew |
//! | tools and cube | weight and centre of each tool, mass of the cube |
//! | person | size of the zone |
//! | declared times | localisation, reading of a face, node of the solver |
//!
//! The speeds that the controller chooses are no part of it: they are what a comparison measures.

use crate::scenario::ControllerConfig;
use crate::tasks::cube::door::planner_keys;

/// Returns a CRC-32 over `plant`, the checksum of the plant's own limits, and over the limits that
/// the controller's half of the scenario declares.
pub(super) fn plant_hash(plant: u32, controller: &ControllerConfig) -> u32 {
    let drives: Vec<_> = controller
        .effectors
        .iter()
        .map(|effector| (effector.gains.pwm_limit, effector.gains.pwm_slew))
        .collect();
    let (vision, node) = (&controller.vision, planner_keys(controller).node_cost);
    // The plant's own tools have errors that campaigns draw, so the believed ones count.
    let cell = &controller.cell;
    let tools: Vec<_> =
        cell.arms.iter().map(|arm| (arm.sensor.weight, arm.sensor.centre_in_flange)).collect();
    // The believed edge is left out: the calibration measures it anew in each run.
    let limits = (plant, drives, vision.localisation, vision.face, node);
    let limits = (limits, tools, cell.cube.mass, cell.hand.half_extent);
    crc32fast::hash(format!("{limits:?}").as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tasks::read;
    use std::path::Path;

    #[test]
    fn plant_hash_changes_with_each_declared_limit() {
        let controller =
            read(Path::new("t.toml"), "", &[]).map(|scenario| scenario.controller).unwrap();
        let plain = plant_hash(7, &controller);
        let changes: [fn(&mut ControllerConfig); 8] = [
            |c| c.effectors[0].gains.pwm_limit *= 1.1,
            |c| c.effectors[1].gains.pwm_slew *= 1.1,
            |c| c.vision.localisation = 0.0,
            |c| c.vision.face = 0.0,
            |c| c.cell.arms[0].sensor.weight = 0.01,
            |c| c.cell.arms[1].sensor.centre_in_flange.z += 0.01,
            |c| c.cell.cube.mass = 0.02,
            |c| c.cell.hand.half_extent.x = 0.0,
        ];

        for (number, change) in changes.iter().enumerate() {
            let mut other = controller.clone();
            change(&mut other);
            assert_ne!(plant_hash(7, &other), plain, "change {number}");
        }
        let swift = read(Path::new("t.toml"), "[planner]\nnode_cost_us = 0\n", &[]).unwrap();
        assert_ne!(plant_hash(7, &swift.controller), plain, "the declared time of a node");
        let mut faster = controller.clone();
        faster.control.turn_speed *= 0.5;
        assert_eq!(plant_hash(7, &faster), plain, "a chosen speed is no limit");
        let mut calibrated = controller.clone();
        calibrated.cell.cube.edge += 1e-4;
        assert_eq!(plant_hash(7, &calibrated), plain, "a calibration changes no limit");
        assert_ne!(plant_hash(8, &controller), plain);
    }
}
