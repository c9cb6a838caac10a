//! The cell as numbers that a workshop would measure: arms, grippers, sensors, cameras, cube, hand-over place.
//!
//! One type serves twice: the scenario's values are the controller's *belief*; the simulated plant draws
//! its own *truth* around them. Nothing else is shared between the two.

use crate::cube::Keeper;
use crate::kinematics::ArmModel;
use crate::motion::JointPositions;
use crate::spatial::{GRAVITY, Pose};
use nalgebra::{Point3, Vector3};

/// Everything that is built into the cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Effectors in the scenario's order; the cube task wants the track arm first, the postument second.
    pub arms: Vec<Arm>,
    /// All cameras.
    pub cameras: Vec<Camera>,
    /// The cube.
    pub cube: CubeSpec,
    /// Height of the table top, with the tray, above the floor (m).
    pub table_height: f64,
    /// Where the cube is given and taken back: by the operator's hand, or lying on the table.
    pub hand: HandZone,
    /// Which of the two.
    pub keeper: Keeper,
}

impl Cell {
    /// How a hand takes the cube from its keeper, in the world: the direction of its approach, and the jaws' line.
    ///
    /// The robot stands on the -x side of a person; its jaws close above and below, so that the side towards the
    /// stand-alone camera stays free. A table is reached into from above, where no finger comes near its top; the jaws
    /// close along x, so that they do not stand between the cube and a camera that looks along y.
    #[must_use]
    pub fn taking(&self) -> (Vector3<f64>, Vector3<f64>) {
        match self.keeper {
            Keeper::Person => (Vector3::x(), Vector3::z()),
            Keeper::Table => (-Vector3::z(), Vector3::x()),
        }
    }
}

/// One arm with its gripper and wrist sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Arm {
    /// Name of the effector in the scenario: "track", "postument".
    pub name: String,
    /// Geometry, transmissions and limits.
    pub model: ArmModel,
    /// Base frame: on the floor below the shoulder (for the track arm at d0 = 0), z up.
    pub world_from_base: Pose,
    /// Tool point between the pads; z is the approach direction, the jaws move along y.
    pub flange_from_tool: Pose,
    /// Gripper.
    pub gripper: Gripper,
    /// Wrist sensor.
    pub sensor: ForceSensor,
    /// Where the arm stands when the run begins.
    pub start: JointPositions,
}

/// An electric two-finger gripper whose palm stands off the cube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gripper {
    /// Extent of a finger along the tool's x (m).
    pub finger_width: f64,
    /// Extent of a finger along the tool's y, outwards from the pad (m).
    pub finger_thickness: f64,
    /// How far the finger tips reach beyond the tool point along z (m).
    pub finger_tip: f64,
    /// Distance of the palm plate behind the tool point along -z (m).
    pub palm: f64,
    /// Half the side of the square palm plate (m).
    pub palm_half_width: f64,
    /// Smallest and largest distance between the pads (m).
    pub opening: (f64, f64),
    /// Opening s (m) = c0 + c1 m + c2 m^2 of the jaw motor's angle m (rad).
    pub opening_of_motor: [f64; 3],
    /// Zero error of the jaw: added to the opening (m) (0 in the belief).
    pub opening_offset: f64,
    /// Encoder increments per revolution of the jaw motor.
    pub increments: f64,
    /// Current that holds a grip force: A per N.
    pub amperes_per_newton: f64,
}

impl Gripper {
    /// Distance of a cube's palm-side face behind the tool point when the stops are at one layer (m).
    pub const FACE_BEHIND_TOOL_ONE: f64 = 0.0095;
    /// The same with the stops at two layers (m).
    pub const FACE_BEHIND_TOOL_TWO: f64 = 0.0285;
}

/// A six-component sensor in the wrist and what hangs on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceSensor {
    /// Where the sensor measures.
    pub flange_from_sensor: Pose,
    /// Weight of all that hangs beyond the sensor (N).
    pub weight: f64,
    /// Its centre of mass in the flange frame (m).
    pub centre_in_flange: Point3<f64>,
    /// Largest force along x, y, z and torque about x, y, z (N, Nm).
    pub range: [f64; 6],
}

impl ForceSensor {
    /// Returns the mass of all that hangs beyond the sensor (kg).
    #[must_use]
    pub fn mass(&self) -> f64 {
        self.weight / GRAVITY
    }
}

/// Where a camera is fixed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mount {
    /// Stands in the cell.
    World {
        /// Optical frame: z forward, x right, y down.
        world_from_camera: Pose,
    },
    /// Sits in the gripper of an arm.
    Flange {
        /// Index of the arm.
        arm: usize,
        /// Optical frame in the flange frame.
        flange_from_camera: Pose,
    },
}

/// Pinhole with two radial coefficients; the first pixel's centre is (0, 0).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Focal length along x and y (px).
    pub focal: (f64, f64),
    /// Principal point (px).
    pub centre: (f64, f64),
    /// Radial distortion k1, k2: `x_d = x (1 + k1 r^2 + k2 r^4)` in normalised coordinates.
    pub distortion: (f64, f64),
}

impl Intrinsics {
    /// Pixel of a point in the camera frame (z > 0), with distortion.
    #[must_use]
    pub fn project(&self, point: &Point3<f64>) -> (f64, f64) {
        let (x, y) = (point.x / point.z, point.y / point.z);
        let r2 = x * x + y * y;
        let scale = 1.0 + self.distortion.0 * r2 + self.distortion.1 * r2 * r2;
        (self.focal.0 * x * scale + self.centre.0, self.focal.1 * y * scale + self.centre.1)
    }

    /// Normalised, undistorted direction (x/z, y/z) of a pixel.
    #[must_use]
    pub fn unproject(&self, pixel: (f64, f64)) -> (f64, f64) {
        let xd = (pixel.0 - self.centre.0) / self.focal.0;
        let yd = (pixel.1 - self.centre.1) / self.focal.1;
        let (mut x, mut y) = (xd, yd);
        // Fixed-point inversion: converges to below 1e-9 in 8 rounds for |k1 r^2| < 0.15.
        for _ in 0..8 {
            let r2 = x * x + y * y;
            let scale = 1.0 + self.distortion.0 * r2 + self.distortion.1 * r2 * r2;
            x = xd / scale;
            y = yd / scale;
        }
        (x, y)
    }
}

/// A camera of the cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Name in the scenario: `standalone`, `track_hand`, `postument_hand`.
    pub name: String,
    /// Where.
    pub mount: Mount,
    /// Optics.
    pub intrinsics: Intrinsics,
}

/// The cube as an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CubeSpec {
    /// Length of an edge of the whole cube (m).
    pub edge: f64,
    /// Mass (kg).
    pub mass: f64,
}

/// Where the cube is handed over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandZone {
    /// Pose of the cube when it is held still, or lies there: cube axes x right (R), y away (B), z up (U).
    pub world_from_cube: Pose,
    /// Half extents of the box in which it may be (m).
    pub half_extent: Vector3<f64>,
}

impl HandZone {
    /// How far a point in the box's frame is off the box; 0 in it (m).
    #[must_use]
    pub fn off(&self, at: &Point3<f64>) -> f64 {
        (at.coords.abs() - self.half_extent).map(|x| x.max(0.0)).norm()
    }

    /// The same of the nearest point between two (m).
    #[must_use]
    pub fn off_segment(&self, a: &Point3<f64>, b: &Point3<f64>) -> f64 {
        // The box is convex: along a line the distance falls, then rises.
        let at = |t: f64| self.off(&(a + (b - a) * t));
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..40 {
            let third = (high - low) / 3.0;
            if at(low + third) <= at(high - third) {
                high -= third;
            } else {
                low += third;
            }
        }
        at(0.5 * (low + high)).min(at(0.0)).min(at(1.0))
    }
}
