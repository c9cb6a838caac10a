//! Keys of the lists `[[effector]]`, `[[camera]]` and `[[vsp]]`.
//!
//! Without a list of its own a scenario has the built-in cell's (`scenarios/cell.toml`). An element
//! that bears the name of a built-in one starts from its values; others start from the defaults
//! here. Built-in cameras and VSPs whose effector or camera the scenario leaves out are left out,
//! too.

use super::section::{section, words};

/// Names of the lists of a scenario.
pub(super) const LISTS: [&str; 4] = ["effector", "camera", "vsp", "fault"];

words! {
    /// What a camera is fixed to.
    pub(crate) MountKind {
        /// Stands in the cell.
        World = "world",
        /// Sits in the gripper of an effector.
        Flange = "flange",
    }
}

words! {
    /// What a VSP makes of its sensor.
    pub VspKind {
        /// Pose of the cube in an image.
        Cube = "cube",
        /// Colours of the face in an image.
        Face = "face",
        /// The wrist forces of all effectors.
        Force = "force",
    }
}

section! {
    /// An arm with its gripper and wrist sensor.
    pub(crate) Effector {
        /// Name; the cube task wants the track arm first, the postument second.
        name: String = String::new();
        /// Geometry, transmissions and limits: a built-in profile, or a path from the scenario's
        /// folder.
        profile: String = "irp6_postument".to_owned();
        /// Regulators of the axes: `irp6_servo`, or a path from the scenario's folder.
        servo_profile: String = "irp6_servo".to_owned();
        /// Base on the floor below the shoulder, in the world (track: at d0 = 0).
        base_xyz [mm]: [f64; 3] = [0.0; 3], -20000.0..=20000.0;
        /// Roll, pitch, yaw of the base.
        base_rpy [deg]: [f64; 3] = [0.0; 3], -180.0..=180.0;
        /// Tool point between the pads, in the flange frame.
        tool_xyz [mm]: [f64; 3] = [0.0, 0.0, 250.0], -1000.0..=1000.0;
        /// Roll, pitch, yaw of the tool frame.
        tool_rpy [deg]: [f64; 3] = [0.0; 3], -180.0..=180.0;
        /// Track position when the run begins.
        start_d0 [mm]: f64 = 0.0, -200.0..=2000.0;
        /// Joints q1..q6 when the run begins; the default stands before the hand-over place.
        start_joints [deg]: [f64; 6] = [0.0, -101.07, 29.03, 72.04, 90.0, 0.0], -600.0..=600.0;
        /// Whether its controllers know where the arm is when the run begins; an arm that does not
        /// is synchronised first: axis by axis to its switch and the encoder's zero.
        start_synchronised: bool = true;
    } with {
        /// Gripper.
        gripper: GripperKeys,
        /// Wrist sensor.
        sensor: SensorKeys,
    }
}

section! {
    /// An electric two-finger gripper.
    pub(crate) GripperKeys {
        /// Whether the palm stands off the cube, so that a layer turns freely under it.
        palm_clearance: bool = true;
        /// Finger along the tool's x.
        finger_width [mm]: f64 = 12.0, 1.0..=60.0;
        /// Finger along the tool's y, outwards from the pad.
        finger_thickness [mm]: f64 = 10.0, 1.0..=60.0;
        /// How far the finger tips reach beyond the tool point.
        finger_tip [mm]: f64 = 7.5, 0.0..=60.0;
        /// Palm plate behind the tool point.
        palm [mm]: f64 = 42.5, 1.0..=200.0;
        /// Half the side of the square palm plate.
        palm_half_width [mm]: f64 = 35.0, 1.0..=200.0;
        /// Smallest distance between the pads.
        opening_min [mm]: f64 = 53.0, 0.0..=300.0;
        /// Largest distance between the pads.
        opening_max [mm]: f64 = 91.0, 0.0..=300.0;
        /// Opening c0 + c1 m + c2 m2 of the jaw motor's angle m in rad.
        opening_of_motor [mm]: [f64; 3] = [74.0, -0.014_519_100_74, -2.8313e-6], -1000.0..=1000.0;
        /// Encoder increments a revolution of the jaw motor.
        increments: f64 = 128.0, 1.0..=1e6;
        /// Motor current that holds one newton of grip.
        current [ma_n]: f64 = 1.8, 0.01..=100.0;
    }
}

section! {
    /// A six-component force sensor in the wrist and what hangs on it.
    pub(crate) SensorKeys {
        /// Place of the sensor in the flange frame.
        xyz [mm]: [f64; 3] = [0.0, 0.0, 90.0], -500.0..=500.0;
        /// Roll, pitch, yaw of the sensor.
        rpy [deg]: [f64; 3] = [0.0; 3], -180.0..=180.0;
        /// Weight of all that hangs beyond the sensor.
        weight [n]: f64 = 10.8, 0.0..=100.0;
        /// Its centre of mass in the flange frame.
        centre_xyz [mm]: [f64; 3] = [4.0, 0.0, 156.0], -500.0..=500.0;
        /// Largest force along x, y, z.
        range [n]: [f64; 3] = [65.0, 65.0, 130.0], 0.1..=10000.0;
        /// Largest torque about x, y, z.
        torque_range as range [nm]: [f64; 3] = [5.0; 3], 0.01..=1000.0;
    }
}

section! {
    /// A camera.
    pub(crate) CameraKeys {
        /// Name.
        name: String = String::new();
        /// "renderer", or a folder of image files (from the scenario's folder).
        source: String = "renderer".to_owned();
        /// Stands in the cell, or sits in a gripper.
        mount: MountKind = MountKind::World;
        /// The effector that carries it, when mount = "flange".
        effector: Option<String> = None;
        /// Place in the world or in the flange frame.
        xyz [mm]: [f64; 3] = [0.0; 3], -20000.0..=20000.0;
        /// Roll, pitch, yaw of the optical frame: z forward, x right, y down.
        rpy [deg]: Option<[f64; 3]> = None, -180.0..=180.0;
        /// Point that it looks at instead of `rpy_deg`; the image is upright for z up.
        look_at [mm]: Option<[f64; 3]> = None, -20000.0..=20000.0;
        /// Pixels a row.
        width [px]: u32 = 640, 16.0..=4096.0;
        /// Rows.
        height [px]: u32 = 480, 16.0..=4096.0;
        /// Focal length along x and y.
        focal [px]: [f64; 2] = [600.0, 600.0], 10.0..=100_000.0;
        /// Principal point; the first pixel's centre is (0, 0).
        centre [px]: [f64; 2] = [319.5, 239.5], 0.0..=4096.0;
        /// Radial distortion k1, k2.
        distortion: [f64; 2] = [0.0, 0.0], -1.0..=1.0;
        /// Before a simulated hand-over the arm shows the cube to this camera so many times, and
        /// the controller believes what that calibration finds; 0: it believes the numbers above.
        calibrate_views: u32 = 0, 0.0..=200.0;
    }
}

section! {
    /// A virtual sensor process.
    pub(crate) Vsp {
        /// Name; mpc, gs1, gs2 and mpf are those of the paper's figure 3.
        name: String = String::new();
        /// What it makes of its sensor.
        kind: VspKind = VspKind::Cube;
        /// Its camera; none for kind = "force".
        camera: Option<String> = None;
        /// Who gets its readings: "mp", or an effector (its ECP).
        owner: String = "mp".to_owned();
        /// Time between two readings.
        period [ms]: f64 = 40.0, 2.0..=10000.0;
    }
}

impl Effector {
    /// Returns its dotted name.
    pub(super) fn path(&self) -> String {
        format!("effector.{}", self.name)
    }
}

impl CameraKeys {
    /// Returns its dotted name.
    pub(super) fn path(&self) -> String {
        format!("camera.{}", self.name)
    }
}

impl Vsp {
    /// Returns its dotted name.
    pub(super) fn path(&self) -> String {
        format!("vsp.{}", self.name)
    }
}
