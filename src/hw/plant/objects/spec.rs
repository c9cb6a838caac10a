//! Parameters of the rigid objects of a cell, of probes at the tools, and of persons who lead a
//! tool by hand.
//!
//! All SI. They belong to the plant: a controller may know an object only by its own sensors, or by
//! the keys of its task.

use crate::spatial::Pose;
use nalgebra::{Point3, Vector3};

/// Rigid object.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectConfig {
    /// Name.
    pub name: String,
    /// Shape.
    pub shape: ObjectShape,
    /// Sizes along the object's axes (m). A cylinder has its axis along z and its diameter along x
    /// and y. A surface has its contour along x, its width along y, and the height of the contour's
    /// middle above the base along z.
    pub size: Vector3<f64>,
    /// Mass (kg).
    pub mass: f64,
    /// Coefficient of friction with pads, fingers, probes and the table.
    pub friction: f64,
    /// Stiffness of the contact with a finger tip, a probe or the table (N/m). Between pads the
    /// object is rigid: the pads yield.
    pub stiffness: f64,
    /// Pose of the object's centre at the start. The centre of a surface is in the middle of its
    /// base.
    pub world_from_object: Pose,
    /// Whether the object is fixed to the cell.
    pub fixed: bool,
}

/// Shape of an object.
#[derive(Debug, Clone, PartialEq)]
pub enum ObjectShape {
    /// Box; a bar is a long one.
    Box,
    /// Cylinder.
    Cylinder,
    /// Fixed body with a curved upper side.
    Surface(Profile),
}

/// Curve of the upper side of a surface, the same across its width.
#[derive(Debug, Clone, PartialEq)]
pub enum Profile {
    /// Smooth random curve, drawn from the seed of the run.
    Drawn {
        /// Greatest height above and depth below the middle (m).
        amplitude: f64,
        /// Typical length of a wave (m).
        wavelength: f64,
    },
    /// Smooth curve through points: place along the contour, and height above the middle (m). The
    /// places rise.
    Points(Vec<[f64; 2]>),
}

/// Ball at the end of a thin pin on a tool, which can touch fixed objects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Probe {
    /// Centre of the ball in the tool frame (m).
    pub centre: Point3<f64>,
    /// Radius of the ball (m).
    pub radius: f64,
}

/// Person who takes a tool by hand and pulls it along a way through a spring.
#[derive(Debug, Clone, PartialEq)]
pub struct LeadConfig {
    /// Index of the arm.
    pub arm: usize,
    /// Points of the way, in axes of the world (m).
    pub points: Vec<[f64; 3]>,
    /// Whether the points count from the place of the tool at which the person takes it; otherwise
    /// from the origin of the world.
    pub relative: bool,
    /// Mean speed between two points (m/s).
    pub speed: f64,
    /// Rest at each point (s).
    pub rest: f64,
    /// Stiffness of the person's hold (N/m).
    pub stiffness: f64,
    /// Damping of the person's hold (Ns/m).
    pub damping: f64,
    /// Greatest force of the person (N).
    pub most_force: f64,
    /// Time at which the person takes the tool (s).
    pub begins: f64,
}
