//! The keys of the task `patrol`.

use crate::scenario::section::section;

section! {
    /// Task `patrol`.
    pub Keys {
        /// Number of rounds of each arm.
        rounds: u32 = 3, 1.0..=1000.0;
        /// Angle by which the stops lie to both sides of the start.
        angle [deg]: f64 = 10.0, 3.0..=20.0;
    }
}
