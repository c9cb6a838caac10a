//! Entries of a recording: everything that a run records besides its servo records.

use super::sensed::Sensed;
use super::summary::Summary;
use crate::hw::scene::Scene;
use crate::kernel::Picture;
use crate::operator::{Class, Input};
use image::RgbImage;

/// One item that a run hands to the recorder, besides the servo records.
#[derive(Debug, Clone)]
pub enum Entry {
    /// Line of the log: class, name of the actor, text.
    Log(Class, String, String),
    /// Beginning of a phase: its name, and an empty outcome. The last phase is "end"; its outcome
    /// is that of the run.
    Phase(String, String),
    /// Answer of a virtual sensor.
    Sensed(Sensed),
    /// Picture of a camera, by the camera's index in the cell.
    Picture(usize, RgbImage),
    /// Wall-clock time that the reading of one face of the cube took (s).
    FaceTook(f64),
    /// Scene that the plant shows.
    Scene(Box<Scene>),
    /// Input of the operator, as JSON.
    Operator(String),
    /// Belief of the task's kernel about the cube, and its plan.
    Belief(Box<Picture>),
    /// Difference between the periods of a node and those of MP's node, from this period on.
    Offset(i64),
    /// Texts by name, under a common title such as "timing" (of the servo) or "summary".
    Facts(&'static str, Vec<(String, String)>),
}

impl Entry {
    /// Returns the two entries that end a run: the phase "end" with the verdict `word`, and the
    /// summary.
    pub(crate) fn end(word: &str, summary: &Summary) -> [Self; 2] {
        let json = vec![("json".to_owned(), summary.json())];
        [Self::Phase("end".to_owned(), word.to_owned()), Self::Facts("summary", json)]
    }

    /// Returns the entry that records an input of the operator, as JSON.
    #[must_use]
    pub fn input(input: &Input) -> Self {
        Self::Operator(serde_json::to_string(input).unwrap_or_default())
    }
}
