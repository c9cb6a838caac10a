//! The parameters of an effector's generators, from the controller's half of a scenario.

use super::move_instruction::{Manner, NearHand};
use crate::cube::Keeper;
use crate::generators::{Compliance, position::Speeds, profile::Profile};
use crate::motion::AXES;
use crate::scenario::ControllerConfig;

/// Returns the parameters of an effector's generators.
#[must_use]
pub fn manner(config: &ControllerConfig, effector: usize) -> Manner {
    let c = &config.control;
    let zone = &config.cell.hand;
    // At a table no person's hand is in the zone, so no force limit is needed there.
    let hand = config
        .cell
        .arms
        .get(effector)
        .filter(|_| config.cell.keeper == Keeper::Person)
        .map(|arm| (arm.world_from_base.inverse() * zone.world_from_cube, zone.half_extent))
        .map(|zone| NearHand { zone, force: c.hand_force });
    // A joint whose motor is slower than the wanted speed moves at the speed of its motor. The
    // speeds of coupled joints depend on the posture: the guard slows their paths down.
    let mut joint = config.cell.arms.get(effector).map_or([c.joint_speed; AXES], |arm| {
        std::array::from_fn(|axis| c.joint_speed.min(arm.model.uncoupled_speed(axis)))
    });
    let mut joint_acceleration = [c.joint_acceleration; AXES];
    // Joint 0 is the track (m/s). Joint 6 is the tool's roll, whose gear allows half of the speed
    // of the other joints.
    joint[0] = c.track_speed;
    joint_acceleration[0] = c.track_acceleration;
    joint[6] = joint[6].min(c.roll_speed);
    Manner {
        compliance: Compliance {
            linear_admittance: c.linear_admittance,
            linear_inertia: c.linear_inertia,
            angular_admittance: c.angular_admittance,
            angular_inertia: c.angular_inertia,
            macrostep: config.macrostep(effector),
            jaw_close_speed: c.jaw_close_speed,
            jaw_reach_speed: c.jaw_reach_speed,
            jaw_open_speed: c.jaw_open_speed,
            force_limit: c.force_limit,
            torque_limit: c.torque_limit,
        },
        speeds: Speeds {
            joint,
            joint_acceleration,
            linear: c.linear_speed,
            linear_acceleration: c.linear_acceleration,
            angular: c.angular_speed,
            // No key: full rotation speed after half a second.
            angular_acceleration: 2.0 * c.angular_speed,
            profile: Profile { ramp: c.ramp },
        },
        free_speed: c.free_speed,
        hand,
        library: config.generators.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the controller's part of a scenario with these keys.
    fn controller(text: &str) -> ControllerConfig {
        crate::tasks::read(std::path::Path::new("t.toml"), text, &[]).unwrap().controller
    }

    /// The coupled joints keep the wanted speed, because their limits depend on the posture.
    #[test]
    fn waist_speed_is_limited_by_its_motor() {
        let controller = controller("[control]\njoint_speed_deg_s = 150\n");
        let speeds = manner(&controller, 0).speeds.joint.map(|speed| speed.to_degrees().round());
        assert_eq!(speeds[1..6], [91.0, 150.0, 150.0, 150.0, 150.0]);
    }
}
