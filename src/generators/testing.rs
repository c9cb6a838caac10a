//! Values for the tests of generators.

use super::compliance::Compliance;
use super::position::Speeds;
use super::profile::Profile;

/// Returns the compliance of an arm in tests.
pub(super) fn compliance() -> Compliance {
    Compliance {
        jaw_reach_speed: 0.012,
        jaw_close_speed: 0.012,
        jaw_open_speed: 0.03,
        linear_admittance: 0.001,
        linear_inertia: 20.0,
        angular_admittance: 0.05,
        angular_inertia: 0.5,
        macrostep: 8,
        force_limit: 40.0,
        torque_limit: 5.0,
    }
}

/// Returns the full speeds of an arm in tests.
pub(super) fn speeds() -> Speeds {
    Speeds {
        joint: [0.15, 0.75, 0.75, 0.75, 0.75, 0.75, 0.75],
        joint_acceleration: [0.3, 1.4, 1.4, 1.4, 1.4, 1.4, 1.4],
        linear: 0.15,
        linear_acceleration: 0.3,
        angular: 0.7,
        angular_acceleration: 1.4,
        profile: Profile { ramp: 5.0 },
    }
}
