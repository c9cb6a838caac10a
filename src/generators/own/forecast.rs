//! The course that a generator declares before it begins.
//!
//! - in: places of the arm at equal times
//! - out: the place after a share of the time

use crate::motion::JointPositions;
use crate::spatial::Pose;

/// Course of a motion that is known beforehand.
#[derive(Debug, Clone, PartialEq)]
pub struct Forecast {
    /// Duration (s).
    pub seconds: f64,
    /// Places after equal parts of this time, from the first one at the beginning to the last one
    /// at the end.
    pub places: Places,
}

/// Places of an arm on its course, at least one.
#[derive(Debug, Clone, PartialEq)]
pub enum Places {
    /// Joint positions (m or rad).
    Joints(Vec<JointPositions>),
    /// `base_from_tool`. The track does not move.
    Poses(Vec<Pose>),
}

/// Place of an arm on its course.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Place {
    /// Joint positions (m or rad).
    Joints(JointPositions),
    /// `base_from_tool`.
    Pose(Pose),
}

impl Forecast {
    /// Returns the reason why the forecast cannot be used; `None` if it can.
    #[must_use]
    pub fn defect(&self) -> Option<String> {
        if !(self.seconds.is_finite() && self.seconds >= 0.0) {
            return Some(format!("the forecast takes {} s", self.seconds));
        }
        let finite = match &self.places {
            Places::Joints(all) => all.iter().all(|at| at.0.iter().all(|q| q.is_finite())),
            Places::Poses(all) => all.iter().all(crate::spatial::is_rigid),
        };
        if self.is_empty() || !finite {
            return Some("the forecast has no place, or one that is not finite".to_owned());
        }
        None
    }

    /// Returns the number of places.
    #[must_use]
    pub fn len(&self) -> usize {
        match &self.places {
            Places::Joints(all) => all.len(),
            Places::Poses(all) => all.len(),
        }
    }

    /// Returns whether the forecast has no place at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the course of another point of the tool, whose frame is `tool_from_point`.
    #[must_use]
    pub fn of_point(&self, tool_from_point: &Pose) -> Self {
        let places = match &self.places {
            Places::Joints(all) => Places::Joints(all.clone()),
            Places::Poses(all) => {
                Places::Poses(all.iter().map(|pose| pose * tool_from_point).collect())
            }
        };
        Self { seconds: self.seconds, places }
    }

    /// Returns the place after the share `part` of the time (0..=1), between two places on a line
    /// from one to the next. Returns `None` for an empty forecast.
    #[must_use]
    pub fn at(&self, part: f64) -> Option<Place> {
        match &self.places {
            Places::Joints(all) => {
                let (from, to, share) = between(all, part)?;
                Some(Place::Joints(from.towards(to, share)))
            }
            Places::Poses(all) => {
                let (from, to, share) = between(all, part)?;
                let turned = from.rotation.try_slerp(&to.rotation, share, 0.0);
                Some(Place::Pose(Pose::from_parts(
                    from.translation.vector.lerp(&to.translation.vector, share).into(),
                    turned.unwrap_or(to.rotation),
                )))
            }
        }
    }
}

/// Returns the neighbours of the share `part` (0..=1) of a list, and the share of the way from one
/// to the other.
fn between<T>(all: &[T], part: f64) -> Option<(&T, &T, f64)> {
    let last = all.len().checked_sub(1)?;
    let at = part.clamp(0.0, 1.0) * last as f64;
    let index = (at.floor() as usize).min(last);
    let next = (index + 1).min(last);
    Some((all.get(index)?, all.get(next)?, at - index as f64))
}
