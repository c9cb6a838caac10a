//! Inputs of a generator, and its orders to the visual sensor.

use crate::motion::ArmState;
use crate::spatial::Pose;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Inputs of a generator at a macrostep.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// State of the arm two periods before the macrostep ends.
    pub arm: &'a ArmState,
    /// Latest pose of the cube from the stand-alone camera, if any.
    pub target: Option<&'a Target>,
    /// Reading of the sensor that the generator has named, or the reason why there is none; `None`
    /// for a generator that names none, and without coordination by the ECPs.
    pub reading: Option<Result<&'a Value, &'a str>>,
    /// Number of the present servo period.
    pub period: u64,
    /// Factor of the speed at which the generator may move on, 0..=1. It is below 1 while a pause
    /// brings the arm to rest, and until a resumed arm has its full speed again.
    pub pace: f64,
}

/// Pose of the cube as the visual sensor measured it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// `world_from_cube`. Its axes are along the edges, up to the symmetry of the cube.
    pub world_from_cube: Pose,
    /// Speed of the centre (m/s).
    pub speed: f64,
    /// Servo period of the exposure.
    pub period: u64,
}

/// Configuration that a generator returns to its VSP: how the visual sensor is to look.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sensing {
    /// Part of the picture that is searched.
    pub window: Window,
    /// Reaction to a window without a cube.
    pub mode: Mode,
    /// Exposure, as a multiple of the nominal one of the camera.
    pub exposure: f64,
}

/// Part of the picture that is searched first.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Window {
    /// The whole picture.
    Whole,
    /// The place where the sensor expects the cube from its earlier pictures, or without such an
    /// expectation the surroundings of `centre`.
    Around {
        /// Centre of the cube in the world (m).
        centre: Vector3<f64>,
        /// Largest distance of the cube from `centre` (m).
        reach: f64,
    },
}

/// Reaction to a window without a cube.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// The whole picture is searched as well.
    Seek,
    /// The search ends: a false cube elsewhere would be worse than none.
    Track,
}

impl Sensing {
    /// Search of the whole picture at the nominal exposure.
    pub const SEEK: Self = Self { window: Window::Whole, mode: Mode::Seek, exposure: 1.0 };
}
