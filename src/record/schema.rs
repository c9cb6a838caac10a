//! Message types of a recording as `ros2msg` text: each definition with those of the types in it.
//!
//! - out: name and schema of each [`Kind`]
//! - source: the packages `std_msgs`, `sensor_msgs`, `geometry_msgs`, `tf2_msgs` and
//!   `rcl_interfaces` of ROS 2. The types of `rubik_robot_msgs` are defined here

/// Type of a message.
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
    /// Inputs and outputs of one arm's servo in one servo period.
    ServoTick,
    /// Colours of the cube (as read, as believed, and the true ones) and its holders.
    CubeState,
    /// Beginning of a phase of the task.
    TaskPhase,
    /// Plan of the task: steps, reasons, planned times.
    Plan,
    /// Answer of a virtual sensor (VSP).
    Sensed,
    /// Input of the operator.
    Operator,
    /// Difference between the periods of a node and those of MP's node.
    Offset,
}

impl Kind {
    /// All types.
    pub const ALL: [Self; 15] = [
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
        Self::Offset,
    ];

    /// Returns the ROS name of the message type: `package/msg/Type`.
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
            Self::Offset => "rubik_robot_msgs/msg/Offset",
        }
    }

    /// Returns the ROS definition of the message type, followed by those of all types in it.
    #[must_use]
    pub fn schema(self) -> String {
        // A reader knows only the types in the schema, so each schema lists all types that it uses,
        // also indirectly.
        let (own, parts): (&str, &[Part]) = match self {
            Self::Text => ("string data\n", &[]),
            Self::JointState => (
                "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n\
                 float64[] effort\n",
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
                "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\n\
                 float64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\n\
                 uint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n",
                &[HEADER, TIME, REGION],
            ),
            Self::Log => (
                "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n\
                 builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\n\
                 string file\nstring function\nuint32 line\n",
                &[TIME],
            ),
            // The types of this program. The comments in them are part of each recording.
            Self::ServoTick => (SERVO_TICK, &[TIME]),
            Self::CubeState => (CUBE_STATE, &[TIME]),
            Self::TaskPhase => (
                "# A phase of the task begins; the outcome is empty until the last, \"end\".\n\
                 builtin_interfaces/Time stamp\nstring name\nstring outcome\n",
                &[TIME],
            ),
            Self::Plan => (
                "# Steps of both hands, the reason and the planned time of each \
                 (s).\nbuiltin_interfaces/Time stamp\nstring[] steps\nstring[] reasons\nfloat64[] \
                 seconds\n",
                &[TIME],
            ),
            Self::Sensed => (SENSED, &[TIME]),
            Self::Operator => (
                "# Input of the operator, as JSON, and the period of 2 ms in which the controller \
                 received it.\nbuiltin_interfaces/Time stamp\nuint64 period\nstring command\n",
                &[TIME],
            ),
            Self::Offset => (OFFSET, &[TIME]),
        };
        // The format separates definitions by a line of 80 equal signs.
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

/// Name and definition of a type that is part of others.
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

/// Definition of `ServoTick`. In a mask, bit i stands for axis i, and bit 7 for the jaw. Axis 0 is
/// the track (m); axes 1 to 6 are rotary (rad).
const SERVO_TICK: &str = "\
# One arm in one servo period: all inputs and all outputs, to the bit.
builtin_interfaces/Time stamp
uint64 period
uint8 arm
# Readings: encoder counters, motor currents with the jaw's last (A), masks of the axes (bit 7 is
# the jaw's), the raw wrench of the sensor (fx fy fz N, tx ty tz Nm).
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
# Axes whose counters are extrapolated, since no reading was valid.
uint8 guessed
# Axes without an answer since the last period.
uint8 unheard
float64[6] wrench_on_sensor
# The sensor sent no new wrench since the last period.
bool wrench_is_old
# Events before the period, as JSON: missed grid points, a stop and its reason; empty without an \
event.
string outside
# Command of the EDP in this period, as JSON; empty without a command.
string command
# Orders to the drives.
bool enabled
int16[7] pwm
int16 jaw_pwm
uint8 stops
uint8 synchronise
# State after the period: measured and set joints (axis 0 is the track in m, others rad), the \
wrench that the tool
# exerts, in its own axes, the jaw's opening (m) and force (N), the refusal and the fault.
float64[7] joints
float64[7] desired_joints
float64[6] wrench_in_tool
float64 jaw_opening
float64 jaw_force
string refused
string fault
# Checksum of all fields and of the poses that follow from them.
uint64 check
";

const CUBE_STATE: &str = "\
# State of the cube: 54 letters URFDLB by faces, each in reading order, or empty if unknown.
builtin_interfaces/Time stamp
# Reading of the gripper cameras: colours, ? where unknown; confidence of each, 0..1.
string identified
float64[] confidences
# State after the executed turns, as the controller believes.
string believed
# State in the plant; empty on hardware.
string truth
# Effectors that hold the cube.
string[] holders
";

const OFFSET: &str = "\
# From this period of 2 ms on, a period of MP's node is one of this node plus the offset.
builtin_interfaces/Time stamp
uint64 period
int64 offset
";

const SENSED: &str = "\
# Result of a virtual sensor, to the bit: an input of the controller.
builtin_interfaces/Time stamp
# Period of 2 ms in which the sensor was asked.
uint64 period
string sensor
# Request to the sensor, as JSON or text.
string asked
# Reason why there is no result; empty with a result.
string refusal
# kind 0: pose x y z qx qy qz qw, speed, period of the exposure; kind 1: a face, 63 numbers (rgb, \
colours, confidences, pose, residual px, confidence, occluded); kind 2: none.
uint8 kind
float64[] values
# Reading of a user's own sensor (kind 2), as JSON.
string reading
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schema_defines_all_types_that_it_names() {
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
