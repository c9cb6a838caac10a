//! Values for the tests of generators.

use super::compliance::Compliance;

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
