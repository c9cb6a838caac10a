//! The keys of the lists `[[effector]]`, `[[camera]]` and `[[vsp]]`.
//!
//! A scenario without a list of its own has the list of the built-in cell (`scenarios/cell.toml`).
//! An element with the name of a built-in one starts from its values; the others start from the
//! defaults here. Built-in cameras and VSPs are dropped if the scenario lacks their effector or
//! camera.

use super::section::{section, words};

/// Names of the lists of a scenario.
pub(super) const LISTS: [&str; 9] =
    ["effector", "camera", "vsp", "fault", "object", "probe", "lead", "node", "order"];

words! {
    /// Place to which a camera is fixed.
    pub(crate) MountKind {
        /// Fixed in the cell.
        World = "world",
        /// Fixed to the gripper of an effector.
        Flange = "flange",
    }
}

/// Result that a VSP makes of its sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VspKind {
    /// Pose of the cube in an image.
    Cube,
    /// Colours of the face in an image.
    Face,
    /// Wrist forces of all effectors.
    Force,
    /// Reading of a user's own sensor.
    Own,
}

impl VspKind {
    /// Word of each kind that does not depend on the program.
    pub(super) const WORDS: [(&'static str, Self); 3] =
        [("cube", Self::Cube), ("face", Self::Face), ("force", Self::Force)];
}

section! {
    /// Arm with its gripper and wrist sensor.
    pub(crate) Effector {
        /// Name; the cube task needs the track arm first and the postument second.
        name: String = String::new();
        /// Geometry, transmissions and limits: a built-in profile, or a path relative to the
        /// scenario's folder.
        profile: String = "irp6_postument".to_owned();
        /// Regulators of the axes: `irp6_servo`, or a path relative to the scenario's folder.
        servo_profile: String = "irp6_servo".to_owned();
        /// Base frame on the floor below the shoulder, in the world (track: at d0 = 0).
        base_xyz [mm]: [f64; 3] = [0.0; 3], -20000.0..=20000.0;
        /// Roll, pitch and yaw of the base.
        base_rpy [deg]: [f64; 3] = [0.0; 3], -180.0..=180.0;
        /// Tool point between the pads, in the flange frame.
        tool_xyz [mm]: [f64; 3] = [0.0, 0.0, 250.0], -1000.0..=1000.0;
        /// Roll, pitch and yaw of the tool frame.
        tool_rpy [deg]: [f64; 3] = [0.0; 3], -180.0..=180.0;
        /// Position of the track at the start of the run.
        start_d0 [mm]: f64 = 0.0, -200.0..=2000.0;
        /// Joints q1..q6 at the start of the run; by default the tool is before the hand-over
        /// place.
        start_joints [deg]: [f64; 6] = [0.0, -101.07, 29.03, 72.04, 90.0, 0.0], -600.0..=600.0;
        /// Whether the controllers know the position of the arm at the start of the run; otherwise
        /// each axis is synchronised first, at its switch and the zero of its encoder.
        start_synchronised: bool = true;
        /// Names of the binary inputs of its parallel interface, the lowest bit first, at most 16;
        /// a task addresses an input by its name.
        inputs: Vec<String> = Vec::new();
    } with {
        /// Gripper.
        gripper: GripperKeys,
        /// Wrist sensor.
        sensor: SensorKeys,
    }
}

section! {
    /// Electric two-finger gripper.
    pub(crate) GripperKeys {
        /// Whether the palm keeps a distance from the cube, so that a layer turns freely under it.
        palm_clearance: bool = true;
        /// Width of a finger along x of the tool.
        finger_width [mm]: f64 = 12.0, 1.0..=60.0;
        /// Thickness of a finger along y of the tool, outwards from the pad.
        finger_thickness [mm]: f64 = 10.0, 1.0..=60.0;
        /// Distance by which the finger tips reach beyond the tool point.
        finger_tip [mm]: f64 = 7.5, 0.0..=60.0;
        // 42.5 mm leaves 14 mm to the face of a cube that is held at two layers. The corners of a
        // turning layer sweep 11.8 mm beyond the face, those of a finger 13.1 mm.
        /// Distance of the palm plate behind the tool point.
        palm [mm]: f64 = 42.5, 1.0..=200.0;
        /// Half the side of the square palm plate.
        palm_half_width [mm]: f64 = 35.0, 1.0..=200.0;
        /// Smallest distance between the pads.
        opening_min [mm]: f64 = 53.0, 0.0..=300.0;
        /// Largest distance between the pads.
        opening_max [mm]: f64 = 91.0, 0.0..=300.0;
        /// Coefficients of the opening c0 + c1 m + c2 m2 at the angle m (rad) of the jaw motor.
        opening_of_motor [mm]: [f64; 3] = [74.0, -0.014_519_100_74, -2.8313e-6], -1000.0..=1000.0;
        /// Encoder increments per revolution of the jaw motor.
        increments: f64 = 128.0, 1.0..=1e6;
        /// Motor current per newton of grip force.
        current [ma_n]: f64 = 1.8, 0.01..=100.0;
    }
}

section! {
    /// Six-component force sensor in the wrist, and the load beyond it.
    pub(crate) SensorKeys {
        /// Position of the sensor in the flange frame.
        xyz [mm]: [f64; 3] = [0.0, 0.0, 90.0], -500.0..=500.0;
        /// Roll, pitch and yaw of the sensor.
        rpy [deg]: [f64; 3] = [0.0; 3], -180.0..=180.0;
        // Weight and centre are those of the postument's gripper in the sources of 2012.
        /// Weight of everything beyond the sensor.
        weight [n]: f64 = 10.8, 0.0..=100.0;
        /// Centre of mass of that load in the flange frame.
        centre_xyz [mm]: [f64; 3] = [4.0, 0.0, 156.0], -500.0..=500.0;
        // The sources of 2012 drop readings beyond these limits.
        /// Largest force along x, y, z.
        range [n]: [f64; 3] = [65.0, 65.0, 130.0], 0.1..=10000.0;
        /// Largest torque about x, y, z.
        torque_range as range [nm]: [f64; 3] = [5.0; 3], 0.01..=1000.0;
    }
}

section! {
    /// Camera.
    pub(crate) CameraKeys {
        /// Name of the camera.
        name: String = String::new();
        /// Source of the images: "renderer", which on hardware is the device; "ros", a topic of ROS
        /// 2; or a folder of image files relative to the scenario's folder.
        source: String = "renderer".to_owned();
        /// Topic of the images with source = "ros" [default: `/NAME/image_raw`]: messages
        /// `sensor_msgs/Image` (rgb8, bgr8, mono8) or `CompressedImage` (JPEG, PNG).
        topic: Option<String> = None;
        /// Place to which the camera is fixed: the world, or the flange of an effector.
        mount: MountKind = MountKind::World;
        /// Effector that carries the camera, with mount = "flange".
        effector: Option<String> = None;
        /// Position in the world or in the flange frame.
        xyz [mm]: [f64; 3] = [0.0; 3], -20000.0..=20000.0;
        /// Roll, pitch and yaw of the optical frame: z forward, x right, y down.
        rpy [deg]: Option<[f64; 3]> = None, -180.0..=180.0;
        /// Point at which the camera looks, instead of `rpy_deg`; the image is upright for z up.
        look_at [mm]: Option<[f64; 3]> = None, -20000.0..=20000.0;
        /// Number of pixels in a row.
        width [px]: u32 = 640, 16.0..=4096.0;
        /// Number of rows.
        height [px]: u32 = 480, 16.0..=4096.0;
        /// Focal length along x and y.
        focal [px]: [f64; 2] = [600.0, 600.0], 10.0..=100_000.0;
        /// Principal point; the centre of the first pixel is (0, 0).
        centre [px]: [f64; 2] = [319.5, 239.5], 0.0..=4096.0;
        /// Coefficients k1, k2 of the radial distortion.
        distortion: [f64; 2] = [0.0, 0.0], -1.0..=1.0;
        // With 30 views the arm misses the cube by 1.0 mm r.m.s., without a calibration by 3.8 mm,
        // mostly by the sag of the arm.
        /// Number of views in which the arm shows the cube to this camera before a simulated
        /// hand-over, to calibrate it; with 0 the controller believes the numbers above.
        calibrate_views: u32 = 0, 0.0..=200.0;
    }
}

section! {
    /// Virtual sensor process.
    pub(crate) Vsp {
        /// Name; mpc, gs1, gs2 and mpf are those of figure 3 of the paper.
        name: String = String::new();
        /// Result that the VSP makes of its sensor: "cube", its pose; "face", its colours; "force",
        /// those of all wrists; or the reading of a sensor that the program adds, by its name.
        kind: String = "cube".to_owned();
        /// Camera of the VSP, with kind = "cube" or "face".
        camera: Option<String> = None;
        /// Receiver of the readings: "mp", or an effector (its ECP).
        owner: String = "mp".to_owned();
        /// Time between two readings.
        period [ms]: f64 = 40.0, 2.0..=10000.0;
    }
}

impl Effector {
    /// Returns the dotted name of the effector: `effector.NAME`.
    pub(super) fn path(&self) -> String {
        format!("effector.{}", self.name)
    }
}

impl CameraKeys {
    /// Returns the dotted name of the camera: `camera.NAME`.
    pub(super) fn path(&self) -> String {
        format!("camera.{}", self.name)
    }
}

impl Vsp {
    /// Returns the dotted name of the VSP: `vsp.NAME`.
    pub(super) fn path(&self) -> String {
        format!("vsp.{}", self.name)
    }
}
