//! The keys of the task `teach`.

use crate::scenario::section::{section, words};

words! {
    /// Parts of the task.
    pub Mode {
        /// The arm is led, and the way is recorded.
        Teach = "teach",
        /// The way of a file is played back.
        Play = "play",
        /// The arm is led, and the recorded way is played back.
        Both = "both",
    }
}

words! {
    /// Path of the tool through the points of a way.
    pub Play {
        /// Smooth curve of the tool, without a stop.
        Spline = "spline",
        /// Straight line from point to point, with a stop at each.
        Line = "line",
        /// Circular arcs: each leads through one point to the next but one.
        Circle = "circle",
        /// Smooth curve of the joints, without a stop.
        JointSpline = "joint_spline",
    }
}

section! {
    /// Task `teach`.
    pub Keys {
        /// Parts of the task that are done.
        mode: Mode = Mode::Both;
        /// Arm that is led and plays back.
        arm: String = "track".to_owned();
        /// File of the way, relative to the folder of the scenario, or to the working directory if
        /// an option names it. A taught way is not written if this is empty, and never over an
        /// existing file.
        file: String = String::new();
        /// Path through the points.
        play: Play = Play::Spline;
        /// Share of the full speed in playback.
        speed: f64 = 0.2, 0.01..=1.0;
        /// Greatest distance of the recorded way from the path through the chosen points.
        tolerance [mm]: f64 = 1.0, 0.1..=20.0;
        /// Time of rest after which the way is complete.
        still [s]: f64 = 3.0, 0.5..=60.0;
        /// Time for which the arm waits to be led.
        patience [s]: f64 = 60.0, 1.0..=3600.0;
    }
}
