//! The message types of a recording, as `ros2msg` text: a definition, then those that it is made of.
//!
//! - out: for each [`Kind`] its name and its schema
//! - source: fields of the standard packages `std_msgs`, `sensor_msgs`, `geometry_msgs`, `tf2_msgs` and
//!   `rcl_interfaces` of ROS 2; what stands in `rubik_robot_msgs` is ours

/// The types that a recording may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// `std_msgs/String`.
    Text,
    /// `sensor_msgs/JointState`.
    JointState,
    /// `tf2_msgs/TFMessage`.
    Transforms,
    /// `geometry_msgs/WrenchStamped`.
    Wrench,
    /// `geometry_msgs/PoseStamped`.
    Pose,
    /// `sensor_msgs/CompressedImage`.
    Picture,
    /// `sensor_msgs/CameraInfo`.
    CameraInfo,
    /// `rcl_interfaces/Log`.
    Log,
    /// One arm in one servo period.
    ServoTick,
    /// What the robot knows of the cube.
    CubeState,
    /// A phase of the task begins.
    TaskPhase,
    /// What is to be turned.
    Plan,
    /// What a VSP delivered.
    Sensed,
    /// What the operator wanted.
    Operator,
}

impl Kind {
    /// All of them.
    pub const ALL: [Self; 14] = [
        Self::Text,
        Self::JointState,
        Self::Transforms,
        Self::Wrench,
        Self::Pose,
        Self::Picture,
        Self::CameraInfo,
        Self::Log,
        Self::ServoTick,
        Self::CubeState,
        Self::TaskPhase,
        Self::Plan,
        Self::Sensed,
        Self::Operator,
    ];

    /// Name of the type: `package/msg/Type`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Text => "std_msgs/msg/String",
            Self::JointState => "sensor_msgs/msg/JointState",
            Self::Transforms => "tf2_msgs/msg/TFMessage",
            Self::Wrench => "geometry_msgs/msg/WrenchStamped",
            Self::Pose => "geometry_msgs/msg/PoseStamped",
            Self::Picture => "sensor_msgs/msg/CompressedImage",
            Self::CameraInfo => "sensor_msgs/msg/CameraInfo",
            Self::Log => "rcl_interfaces/msg/Log",
            Self::ServoTick => "rubik_robot_msgs/msg/ServoTick",
            Self::CubeState => "rubik_robot_msgs/msg/CubeState",
            Self::TaskPhase => "rubik_robot_msgs/msg/TaskPhase",
            Self::Plan => "rubik_robot_msgs/msg/Plan",
            Self::Sensed => "rubik_robot_msgs/msg/Sensed",
            Self::Operator => "rubik_robot_msgs/msg/Operator",
        }
    }

    /// The definition with all that it is made of.
    #[must_use]
    pub fn schema(self) -> String {
        let (own, parts): (&str, &[Part]) = match self {
            Self::Text => ("string data\n", &[]),
            Self::JointState => (
                "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
                &[HEADER, TIME],
            ),
            Self::Transforms => (
                "geometry_msgs/TransformStamped[] transforms\n",
                &[TRANSFORM_STAMPED, HEADER, TIME, TRANSFORM, VECTOR3, QUATERNION],
            ),
            Self::Wrench => (
                "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n",
                &[HEADER, TIME, WRENCH, VECTOR3],
            ),
            Self::Pose => (
                "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
                &[HEADER, TIME, POSE, POINT, QUATERNION],
            ),
            Self::Picture => {
                ("std_msgs/Header header\nstring format\nuint8[] data\n", &[HEADER, TIME])
            }
            Self::CameraInfo => (
                "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\n\
                 float64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\n\
                 sensor_msgs/RegionOfInterest roi\n",
                &[HEADER, TIME, REGION],
            ),
            Self::Log => (
                "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n\
                 builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\n\
                 uint32 line\n",
                &[TIME],
            ),
            Self::ServoTick => (SERVO_TICK, &[TIME]),
            Self::CubeState => (CUBE_STATE, &[TIME]),
            Self::TaskPhase => (
                "# A phase of the task begins; the outcome is empty until the last, \"end\".\n\
                 builtin_interfaces/Time stamp\nstring name\nstring outcome\n",
                &[TIME],
            ),
            Self::Plan => (
                "# What the two hands are going to do, why, and how long each step takes as planned (s).\n\
                 builtin_interfaces/Time stamp\nstring[] steps\nstring[] reasons\nfloat64[] seconds\n",
                &[TIME],
            ),
            Self::Sensed => (SENSED, &[TIME]),
            Self::Operator => (
                "# What the operator wanted, as JSON, and the servo period in which the controller learnt it.\n\
                 builtin_interfaces/Time stamp\nuint64 period\nstring command\n",
                &[TIME],
            ),
        };
        let mut text = own.to_owned();
        for (name, definition) in parts {
            text.push_str(&"=".repeat(80));
            text.push_str("\nMSG: ");
            text.push_str(name);
            text.push('\n');
            text.push_str(definition);
        }
        text
    }
}

/// Name and definition of a type that others are made of.
type Part = (&'static str, &'static str);

const TIME: Part = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
const HEADER: Part = ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n");
const VECTOR3: Part = ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n");
const POINT: Part = ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n");
const QUATERNION: Part =
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n");
const POSE: Part =
    ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n");
const WRENCH: Part =
    ("geometry_msgs/Wrench", "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n");
const TRANSFORM: Part = (
    "geometry_msgs/Transform",
    "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
);
const TRANSFORM_STAMPED: Part = (
    "geometry_msgs/TransformStamped",
    "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
);
const REGION: Part = (
    "sensor_msgs/RegionOfInterest",
    "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n",
);

/// Bits: bit i is that of axis i, the jaw's is 7. Axis 0 is the track (m), 1..6 rotary (rad).
const SERVO_TICK: &str = "\
# One arm in one servo period: all that was read, all that was commanded, to the bit.
builtin_interfaces/Time stamp
uint64 period
uint8 arm
# Read: encoder counters, motor currents with the jaw's last (A), bits by axis (the jaw's is 7), the raw sensor
# (fx fy fz N, tx ty tz Nm).
int64[7] counts
int64 jaw_count
float64[8] currents
uint8 upper_limits
uint8 lower_limits
uint8 over_currents
uint8 power_faults
uint8 sync_switches
uint8 encoder_zeros
uint8 synchronised
# Axes of which nothing was read that is to be judged: their counters are carried on.
uint8 guessed
# Axes of which nothing new came since the last period.
uint8 unheard
float64[6] wrench_on_sensor
# The sensor has told no newer one since the last period.
bool wrench_is_old
# From outside, before the period: grid points that passed without one, a stop and why, as JSON; empty when nothing.
string outside
# Ordered by the EDP in this period, as JSON; empty when nothing was.
string command
# Told to the drives.
bool enabled
int16[7] pwm
int16 jaw_pwm
uint8 stops
uint8 synchronise
# Known afterwards: measured and set joints (axis 0 is the track in m, others rad), what the tool exerts in its own axes,
# the jaw's opening (m) and force (N), what is wrong.
float64[7] joints
float64[7] desired_joints
float64[6] wrench_in_tool
float64 jaw_opening
float64 jaw_force
string refused
string fault
# Over what was read, ordered, told and known, and the poses that follow from it.
uint64 check
";

const CUBE_STATE: &str = "\
# What is known of the cube: 54 letters URFDLB by faces, each in reading order, or empty.
builtin_interfaces/Time stamp
# Read by the gripper cameras: colours, ? where unknown; how sure each is, 0..1.
string identified
float64[] confidences
# As it is now, by the turns that were carried out.
string believed
# As it is in the plant; empty on hardware.
string truth
# Who holds it.
string[] holders
";

const SENSED: &str = "\
# What a virtual sensor delivered, to the bit: an input of the controller.
builtin_interfaces/Time stamp
# Servo period of the exposure.
uint64 period
string sensor
# How it had been asked to look, as JSON or text.
string asked
# Why there is nothing; empty when there is something.
string refusal
# kind 0: pose x y z qx qy qz qw and speed; kind 1: a face, 63 numbers (rgb, colours, confidences, pose, residual px, confidence, occluded).
uint8 kind
float64[] values
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_that_a_definition_names_is_defined_behind_it() {
        for kind in Kind::ALL {
            let schema = kind.schema();
            let names = schema.lines().filter(|l| !l.starts_with('#') && !l.starts_with("MSG:"));
            for word in names.filter_map(|l| l.split_whitespace().next()) {
                let name = word.split('[').next().unwrap();
                if name.contains('/') {
                    assert!(schema.contains(&format!("MSG: {name}\n")), "{kind:?}: {name}");
                }
            }
        }
    }
}
