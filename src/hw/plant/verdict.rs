//! What really happened: the plant's account of a run, for summaries and tests, never for the controller.

use crate::cube::{Axis, Face};
use crate::spatial::Pose;

/// Most events that are kept; later ones are only counted.
pub const MOST_EVENTS: usize = 256;

/// The state and the history of the plant.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// Servo periods done.
    pub period: u64,
    /// Stickers URFDLB by position, each named by the centre of its colour, layers at their nearest quarter.
    pub facelets: [u8; 54],
    /// Where the cube is.
    pub cube: Whereabouts,
    /// Middle layer's pose.
    pub world_from_cube: Pose,
    /// The operator has the cube back.
    pub returned: bool,
    /// No person is in the cell: the cube's place is the table.
    pub nobody: bool,
    /// Both arms hold the cube.
    pub both_hold: bool,
    /// The axis that layers turn about, or were turned about last.
    pub turning: Axis,
    /// Angles of the negative and the positive outer layer of that axis against the middle layer [rad], since
    /// the axis became active.
    pub layer_angles: [f64; 2],
    /// Relative rotation of the two grasped parts about that axis since both hold, of the second arm's part
    /// against the first's, right-handed about the cube's axis [rad].
    pub turned: f64,
    /// How often.
    pub counts: Counts,
    /// Jaw closings on the cube, per arm.
    pub grasps: [u32; 2],
    /// Norms of the contact wrench at a tool while both arms hold the cube, grip squeeze excluded [N, Nm].
    pub peak_force: f64,
    /// As above.
    pub peak_torque: f64,
    /// Per arm, whenever it touches the cube [N].
    pub arm_peak_force: [f64; 2],
    /// Per arm, whenever it touches the cube [Nm].
    pub arm_peak_torque: [f64; 2],
    /// What happened, in order; at most [`MOST_EVENTS`].
    pub events: Vec<Event>,
}

/// Numbers of events.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub struct Counts {
    /// A loaded layer stood still for 3 s away from every quarter.
    pub stuck: u32,
    /// A grip slipped by more than 3 deg or 1 mm while its jaws were not opening.
    pub slips: u32,
    /// The cube fell.
    pub drops: u32,
    /// The cube popped: tilt above 3 Nm or a pull above 50 N.
    pub pops: u32,
    /// A squeeze above 150 N.
    pub crushed: u32,
    /// Something touched what it should not.
    pub collisions: u32,
    /// A wrist sensor left its range.
    pub saturations: u32,
}

/// Where the cube is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Whereabouts {
    /// In the operator's hand alone.
    Hand,
    /// In grippers, perhaps with the hand: which arms.
    Arms([bool; 2]),
    /// In the air.
    Falling,
    /// At rest on the table, or the tray there.
    Tray {
        /// Face that lies down, by position in the cube frame.
        down: Face,
        /// It came there by a fall; else it has lain there from the beginning, or was laid down.
        fell: bool,
    },
}

/// What happened when.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event {
    /// Servo period.
    pub period: u64,
    /// What.
    pub what: Incident,
}

/// What may happen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Incident {
    /// Jaws closed on the cube.
    Grasped {
        /// Which arm.
        arm: usize,
    },
    /// Jaws let go of it.
    Released {
        /// Which arm.
        arm: usize,
    },
    /// A loaded layer stood still for 3 s at this angle [rad].
    Stuck {
        /// Axis of the layer.
        axis: Axis,
        /// Distance from the nearest quarter [rad].
        angle: f64,
        /// Torque on it [Nm].
        torque: f64,
    },
    /// A grip slipped: by so much since closing [m, rad].
    Slip {
        /// Which arm.
        arm: usize,
        /// In the plane of the pads [m].
        distance: f64,
        /// [rad]
        angle: f64,
    },
    /// The grasp is lost: it slipped by more than 5 mm or 20 deg.
    GraspLost {
        /// Which arm.
        arm: usize,
    },
    /// The cube fell out of this arm's hand (or the operator's: `None`).
    Drop {
        /// Who had it last.
        arm: Option<usize>,
    },
    /// An arm has laid the cube down and let go of it.
    LaidDown {
        /// Which arm.
        arm: usize,
        /// Face that lies down.
        down: Face,
    },
    /// The cube came to rest after a fall.
    Landed {
        /// Face that lies down.
        down: Face,
    },
    /// The cube popped under this tilt [Nm] and pull [N].
    Pop {
        /// Torque.
        tilt: f64,
        /// Force.
        pull: f64,
    },
    /// Crushed by this squeeze [N].
    Crush {
        /// Which arm.
        arm: usize,
        /// Force.
        squeeze: f64,
    },
    /// Two things met.
    Collision {
        /// One.
        what: Part,
        /// The other.
        with: Part,
        /// How far they overlapped at first [m].
        depth: f64,
    },
    /// A wrist sensor left its range.
    Saturation {
        /// Which arm.
        arm: usize,
    },
    /// The operator let go of the cube, or took it.
    Operator {
        /// Has it now.
        has_cube: bool,
    },
}

/// What can collide.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Finger of an arm.
    Finger(usize),
    /// Palm plate and gripper's body of an arm.
    Palm(usize),
    /// Wrist and hand of an arm.
    Hand(usize),
    /// Forearm of an arm.
    Forearm(usize),
    /// The cube.
    Cube,
    /// Table top.
    Table,
}

impl Verdict {
    /// Whether the cube is where it is to be in the end: with the person, or laid down where no person is.
    #[must_use]
    pub fn is_back(&self) -> bool {
        self.returned || self.nobody && matches!(self.cube, Whereabouts::Tray { fell: false, .. })
    }

    /// The same in words.
    #[must_use]
    pub fn place(&self) -> &'static str {
        match (self.nobody, self.is_back()) {
            (false, true) => "back in the operator's hand",
            (false, false) => "not with the operator",
            (true, true) => "on the table",
            (true, false) => "not laid on the table",
        }
    }

    /// Before anything happened.
    pub(super) fn empty(world_from_cube: &Pose) -> Self {
        Self {
            period: 0,
            facelets: [0; 54],
            cube: Whereabouts::Hand,
            world_from_cube: *world_from_cube,
            returned: false,
            nobody: false,
            both_hold: false,
            turning: Axis::X,
            layer_angles: [0.0; 2],
            turned: 0.0,
            counts: Counts::default(),
            grasps: [0; 2],
            peak_force: 0.0,
            peak_torque: 0.0,
            arm_peak_force: [0.0; 2],
            arm_peak_torque: [0.0; 2],
            events: Vec::with_capacity(MOST_EVENTS),
        }
    }
}
