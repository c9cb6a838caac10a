//! Entries of a recording: everything that a run brings beside its servo records.

use super::sensed::Sensed;
use crate::hw::scene::Scene;
use crate::operator::{Class, Input};
use crate::tasks::Picture;
use image::RgbImage;

/// A piece of a run beside its servo records.
#[derive(Debug, Clone)]
pub enum Entry {
    /// A line for the log: class, source, text.
    Log(Class, String, String),
    /// A phase begins; at last "end" and what the run came to.
    Phase(String, String),
    /// A virtual sensor has delivered.
    Sensed(Sensed),
    /// A camera's picture.
    Picture(usize, RgbImage),
    /// The time that reading a face took by the wall clock (s).
    FaceTook(f64),
    /// The scene that the plant shows.
    Scene(Box<Scene>),
    /// An input of the operator, as JSON.
    Operator(String),
    /// The belief of the kernel about the cube, and its plan.
    Belief(Box<Picture>),
    /// Named texts: how punctual the servo was, the summary.
    Facts(&'static str, Vec<(String, String)>),
}

impl Entry {
    /// Returns the entry of an input of the operator.
    #[must_use]
    pub fn input(input: &Input) -> Self {
        Self::Operator(serde_json::to_string(input).unwrap_or_default())
    }
}
