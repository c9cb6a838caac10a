//! Quantities of the cell that a workshop would measure: arms, grippers, sensors, cameras, cube and
//! hand-over place.
//!
//! Each type serves twice. The scenario's values are the controller's *belief*, and the simulated
//! plant draws its own *truth* around them. The controller and the plant share nothing else.

use crate::cube::Keeper;
use crate::kinematics::ArmModel;
use crate::motion::JointPositions;
use crate::spatial::{GRAVITY, Pose};
use nalgebra::{Point3, Vector3};

/// Size of the table top along x and y (m). Its centre is below the zone of the hand-over.
pub const TABLE_TOP: (f64, f64) = (0.7, 1.2);

/// Most arms of a cell.
pub const MOST_ARMS: usize = 4;

/// One value for each arm that a cell may have. Those of arms that a cell does not have are unused.
pub type PerArm<T> = [T; MOST_ARMS];

/// Everything that is built into the cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Effectors in the order of the scenario. The cube task needs the track arm first and the
    /// postument second.
    pub arms: Vec<Arm>,
    /// All cameras.
    pub cameras: Vec<Camera>,
    /// The cube.
    pub cube: CubeSpec,
    /// Height of the table top, with the tray, above the floor (m).
    pub table_height: f64,
    /// Zone in which the cube is handed over: at the operator's hand, or on the table.
    pub hand: HandZone,
    /// Keeper of the cube: a person or the table.
    pub keeper: Keeper,
}

impl Cell {
    /// Returns two unit vectors in the world frame: the direction in which a gripper approaches the
    /// cube to take it from its keeper, and the line along which the jaws then close.
    ///
    /// The robot is on the -x side of a person. Its jaws close from above and below, so that the
    /// side towards the stand-alone camera stays free. The arm reaches a cube on the table from
    /// above, so that no finger comes near the table top. The jaws then close along x, so that they
    /// do not hide the cube from a camera that looks along y.
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
    /// Joint positions at the start of a run (m, rad).
    pub start: JointPositions,
}

impl Arm {
    /// Checks whether the jaws open to `width` (m), the room that `what` needs.
    ///
    /// # Errors
    /// Both widths in words.
    pub fn opens_for(&self, what: &str, width: f64) -> Result<(), String> {
        let (_, most) = self.gripper.opening;
        if width <= most {
            return Ok(());
        }
        let (name, width, most) = (&self.name, width * 1e3, most * 1e3);
        Err(format!("the jaws of {name} open to {most:.0} mm, and {what} needs {width:.0} mm"))
    }
}

/// Electric two-finger gripper whose palm keeps a distance from the cube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gripper {
    /// Extent of a finger along the tool's x (m).
    pub finger_width: f64,
    /// Extent of a finger along the tool's y, outwards from the pad (m).
    pub finger_thickness: f64,
    /// Distance by which the finger tips reach beyond the tool point along z (m).
    pub finger_tip: f64,
    /// Distance of the palm plate behind the tool point along -z (m).
    pub palm: f64,
    /// Half the side of the square palm plate (m).
    pub palm_half_width: f64,
    /// Smallest and largest distance between the pads (m).
    pub opening: (f64, f64),
    /// Coefficients c0, c1, c2 of the opening s = c0 + c1 m + c2 m^2 (m) at the angle m of the jaw
    /// motor (rad).
    pub opening_of_motor: [f64; 3],
    /// Zero error of the jaw, which is added to the opening; 0 in the belief (m).
    pub opening_offset: f64,
    /// Encoder increments per revolution of the jaw motor.
    pub increments: f64,
    /// Current of the jaw motor per grip force (A/N).
    pub amperes_per_newton: f64,
}

impl Gripper {
    /// Distance of the cube's palm-side face behind the tool point, with the stops at one layer
    /// (m).
    pub const FACE_BEHIND_TOOL_ONE: f64 = 0.0095;
    /// Distance of the cube's palm-side face behind the tool point, with the stops at two layers
    /// (m).
    pub const FACE_BEHIND_TOOL_TWO: f64 = 0.0285;
}

/// Six-component force sensor in the wrist, and the load beyond it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceSensor {
    /// Frame in which the sensor measures.
    pub flange_from_sensor: Pose,
    /// Weight of everything beyond the sensor (N).
    pub weight: f64,
    /// Centre of mass of that load in the flange frame (m).
    pub centre_in_flange: Point3<f64>,
    /// Largest force along x, y, z and torque about x, y, z (N, Nm).
    pub range: [f64; 6],
}

impl ForceSensor {
    /// Returns the mass of everything beyond the sensor (kg).
    ///
    /// ```
    /// use nalgebra::Point3;
    /// use rubik_robot_vocabulary::cell::ForceSensor;
    /// use rubik_robot_vocabulary::spatial::Pose;
    ///
    /// let sensor = ForceSensor {
    ///     flange_from_sensor: Pose::translation(0.0, 0.0, 0.09),
    ///     weight: 19.62,
    ///     centre_in_flange: Point3::new(0.0, 0.0, 0.13),
    ///     range: [65.0, 65.0, 130.0, 5.0, 5.0, 5.0],
    /// };
    /// assert_eq!(sensor.mass(), 2.0);
    /// ```
    #[must_use]
    pub fn mass(&self) -> f64 {
        self.weight / GRAVITY
    }
}

/// Place to which a camera is fixed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mount {
    /// Fixed in the cell.
    World {
        /// Optical frame: z forward, x right, y down.
        world_from_camera: Pose,
    },
    /// Fixed to the gripper of an arm.
    Flange {
        /// Index of the arm.
        arm: usize,
        /// Optical frame in the flange frame.
        flange_from_camera: Pose,
    },
}

impl Mount {
    /// Returns the index of the arm that carries the camera; `None` for one fixed in the cell.
    #[must_use]
    pub fn arm(&self) -> Option<usize> {
        match self {
            Self::World { .. } => None,
            Self::Flange { arm, .. } => Some(*arm),
        }
    }
}

/// Pinhole camera with two coefficients of radial distortion. The image coordinates (0, 0) are the
/// centre of the first pixel, not its corner.
///
/// ```
/// use nalgebra::Point3;
/// use rubik_robot_vocabulary::cell::Intrinsics;
///
/// let camera = Intrinsics {
///     width: 640,
///     height: 480,
///     focal: (1150.0, 1150.0),
///     centre: (319.5, 239.5),
///     distortion: (-0.1, 0.02),
/// };
/// // A point on the optical axis is at the principal point, whatever its distance.
/// assert_eq!(camera.project(&Point3::new(0.0, 0.0, 0.61)), camera.centre);
/// // A face of 57 mm at 0.61 m is about 107 px wide.
/// let edge = |x: f64| camera.project(&Point3::new(x, 0.0, 0.61)).0;
/// assert!((edge(0.0285) - edge(-0.0285) - 107.0).abs() < 1.0);
/// // The direction of a pixel is the inverse.
/// let (x, y) = camera.unproject(camera.project(&Point3::new(0.1, -0.05, 0.5)));
/// assert!((x - 0.2).abs() < 1e-9 && (y + 0.1).abs() < 1e-9);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Number of pixels in a row.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Focal length along x and y (px).
    pub focal: (f64, f64),
    /// Principal point (px).
    pub centre: (f64, f64),
    /// Coefficients k1, k2 of the radial distortion: `x_d = x (1 + k1 r^2 + k2 r^4)` in normalised
    /// coordinates.
    pub distortion: (f64, f64),
}

impl Intrinsics {
    /// Computes the image coordinates (px), with distortion, of a point in the camera frame (m,
    /// z > 0).
    #[must_use]
    pub fn project(&self, point: &Point3<f64>) -> (f64, f64) {
        let (x, y) = (point.x / point.z, point.y / point.z);
        let r2 = x * x + y * y;
        let scale = 1.0 + self.distortion.0 * r2 + self.distortion.1 * r2 * r2;
        (self.focal.0 * x * scale + self.centre.0, self.focal.1 * y * scale + self.centre.1)
    }

    /// Computes the undistorted direction (x/z, y/z), in the camera frame, of the image coordinates
    /// `pixel` (px).
    #[must_use]
    pub fn unproject(&self, pixel: (f64, f64)) -> (f64, f64) {
        let xd = (pixel.0 - self.centre.0) / self.focal.0;
        let yd = (pixel.1 - self.centre.1) / self.focal.1;
        let (mut x, mut y) = (xd, yd);
        // The distortion has no closed inverse. The fixed-point iteration converges to below 1e-9
        // in 8 rounds for |k1 r^2| < 0.15.
        for _ in 0..8 {
            let r2 = x * x + y * y;
            let scale = 1.0 + self.distortion.0 * r2 + self.distortion.1 * r2 * r2;
            x = xd / scale;
            y = yd / scale;
        }
        (x, y)
    }
}

/// Camera of the cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Name in the scenario: `standalone`, `track_hand`, `postument_hand`.
    pub name: String,
    /// Place to which the camera is fixed.
    pub mount: Mount,
    /// Optics.
    pub intrinsics: Intrinsics,
}

/// Size and mass of the cube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CubeSpec {
    /// Length of an edge of the whole cube (m).
    pub edge: f64,
    /// Mass (kg).
    pub mass: f64,
}

/// Zone in which the cube is handed over.
///
/// ```
/// use nalgebra::{Point3, Vector3};
/// use rubik_robot_vocabulary::cell::HandZone;
/// use rubik_robot_vocabulary::spatial::Pose;
///
/// let zone = HandZone {
///     world_from_cube: Pose::translation(0.85, 0.4, 1.25),
///     half_extent: Vector3::new(0.05, 0.05, 0.05),
/// };
/// // Distances count from the box, in its own frame.
/// assert_eq!(zone.distance(&Point3::new(0.04, 0.0, 0.0)), 0.0);
/// assert!((zone.distance(&Point3::new(0.15, 0.0, 0.0)) - 0.1).abs() < 1e-12);
/// // A segment that passes through the box meets it.
/// let (a, b) = (Point3::new(-1.0, 0.0, 0.0), Point3::new(1.0, 0.0, 0.0));
/// assert_eq!(zone.distance_to_segment(&a, &b), 0.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandZone {
    /// Pose of the cube when the person holds it still, or when it lies on the table. Cube axes: x
    /// right (R), y away (B), z up (U).
    pub world_from_cube: Pose,
    /// Half extents of the box in which the cube may be (m).
    pub half_extent: Vector3<f64>,
}

impl HandZone {
    /// Returns the distance of a point from the box (m); 0 inside it. `at` is in the frame of the
    /// box.
    #[must_use]
    pub fn distance(&self, at: &Point3<f64>) -> f64 {
        (at.coords.abs() - self.half_extent).map(|x| x.max(0.0)).norm()
    }

    /// Returns the distance between the box and the segment from `a` to `b` (m); 0 if they meet.
    /// Both ends are in the frame of the box.
    #[must_use]
    pub fn distance_to_segment(&self, a: &Point3<f64>, b: &Point3<f64>) -> f64 {
        // The box is convex, so along the segment the distance falls and then rises: a ternary
        // search finds the minimum. 40 rounds shrink the interval to 1e-7 of the segment.
        let at = |t: f64| self.distance(&(a + (b - a) * t));
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..40 {
            let third = (high - low) / 3.0;
            if at(low + third) <= at(high - third) {
                high -= third;
            } else {
                low += third;
            }
        }
        // The search only approaches the ends, so a minimum at an end is evaluated exactly.
        at(0.5 * (low + high)).min(at(0.0)).min(at(1.0))
    }
}
