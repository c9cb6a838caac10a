//! Inputs of a generator, and its orders to the visual sensor.

use crate::motion::ArmState;
use crate::spatial::Pose;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// What a generator may look at.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// State of the arm two periods before the macrostep ends.
    pub arm: &'a ArmState,
    /// Latest pose of the cube from the stand-alone camera, if any.
    pub target: Option<&'a Target>,
    /// Number of the present servo period.
    pub period: u64,
    /// Share of its speed at which the generator may go on, 0..=1: below 1 while a pause brings the
    /// arm to rest.
    pub pace: f64,
}

/// The cube as the visual sensor saw it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// `world_from_cube`; its axes are along the edges, up to the cube's own symmetry.
    pub world_from_cube: Pose,
    /// Speed of the centre (m/s).
    pub speed: f64,
    /// Servo period of the exposure.
    pub period: u64,
}

/// How a visual sensor is to look: the configuration that a generator returns to its VSP.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sensing {
    /// Which part of the picture is searched.
    pub window: Window,
    /// What happens when nothing is found there.
    pub mode: Mode,
    /// Exposure, as a multiple of the camera's nominal one.
    pub exposure: f64,
}

/// Which part of the picture is searched first.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Window {
    /// All of it.
    Whole,
    /// Where the sensor's own track expects the cube, or else around this place.
    Around {
        /// Centre of the cube in the world (m).
        centre: Vector3<f64>,
        /// How far from there it may be (m).
        reach: f64,
    },
}

/// What happens when the window shows nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// The whole picture is searched as well.
    Seek,
    /// Nothing: a false cube elsewhere would be worse than none.
    Track,
}

impl Sensing {
    /// Everywhere, at the nominal exposure.
    pub const SEEK: Self = Self { window: Window::Whole, mode: Mode::Seek, exposure: 1.0 };
}
