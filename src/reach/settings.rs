//! The settings of the search for meetings.

/// Demands on meetings, and the effort of the search for them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReachSettings {
    /// Distance by which the track retracts along -y between meetings (m).
    pub separation: f64,
    /// Distance by which each arm can retract along its own tool axis (m).
    pub back: f64,
    /// Distance from a hand's camera to the face that it looks at (m).
    pub view_distance: f64,
    /// Distance by which the tools can be shifted along each axis, for other depths and corrections
    /// (m).
    pub shift: f64,
    /// Least distance between the capsules of the arms (m).
    pub clearance: f64,
    /// Least height of wrists and tools above the table (m).
    pub above_table: f64,
    /// Number of random poses that are tried for each meeting, near to and far from the known ones.
    pub samples: u32,
    /// Seed of the search.
    pub seed: u64,
}

impl Default for ReachSettings {
    fn default() -> Self {
        Self {
            separation: 0.35,
            back: 0.12,
            view_distance: 0.20,
            shift: 0.025,
            clearance: 0.02,
            above_table: 0.15,
            samples: 3000,
            seed: 2007,
        }
    }
}
