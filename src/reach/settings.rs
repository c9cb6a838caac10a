//! The settings of the search for meetings.

/// Demands on meetings, and the effort of the search for them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReachSettings {
    /// Distance by which the arm on the track retracts along -y between meetings (m).
    pub separation: f64,
    /// Distance by which each arm can retract along its own tool axis (m).
    pub back: f64,
    /// Distance from a hand's camera to the face that it looks at (m).
    pub view_distance: f64,
    /// Distance by which each tool can be shifted from a meeting along any of its axes, for grasps
    /// at other depths and for corrections (m).
    pub shift: f64,
    /// Least distance between the arms, which are modelled as capsules (m).
    pub clearance: f64,
    /// Least height above the table of the axes of wrist and gripper, and of the cube's centre (m).
    pub above_table: f64,
    /// Number of random poses that are tried for each meeting in each round of the search.
    pub samples: u32,
    /// Seed of the random numbers of the search.
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
