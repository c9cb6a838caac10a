//! The keys of the task `follow_joints` and of its sensor.

use crate::scenario::section::section;

section! {
    /// Task `follow_joints`.
    pub Keys {
        /// Fraction of the full speeds and accelerations with which the arms follow.
        speed: f64 = 0.5, 0.01..=1.0;
        /// Time after which the task ends; 0: the operator ends it.
        seconds [s]: f64 = 0.0, 0.0..=86400.0;
    }
}

section! {
    /// Sensor `joint_commands`: positions of joints from a topic of ROS 2.
    pub SensorKeys {
        /// Topic of the commands: messages `sensor_msgs/JointState`.
        topic: String = "/joint_commands".to_owned();
        /// Age of the last command above which the arms hold.
        stale [ms]: f64 = 500.0, 20.0..=500.0;
        /// Greatest distance of a commanded rotary joint from that of the arm; a command beyond it
        /// is refused as a jump.
        jump [deg]: f64 = 20.0, 0.1..=60.0;
        /// Greatest distance of a commanded track from that of the arm.
        track_jump as jump [mm]: f64 = 100.0, 1.0..=300.0;
    }
}
