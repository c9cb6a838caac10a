//! Belief of a task's kernel about the cube in a recording: as JSON for replays, and as fields of a
//! message for other tools.

use super::cdr::Writer;
use crate::operator::{Net, PlanLine};
use crate::spatial::Pose;
use crate::tasks::{Picture, Turning};
use nalgebra::UnitQuaternion;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// State of the cube at one moment; an unknown field is empty. Colours are 54 letters URFDLB.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct CubeKnown {
    /// Colours as the cameras read them.
    pub identified: String,
    /// Confidence of each colour, 0 to 1.
    pub confidences: Vec<f64>,
    /// Colours that follow from the turns that were carried out.
    pub believed: String,
    /// Colours in the plant.
    pub truth: String,
    /// Names of the effectors that hold the cube.
    pub holders: Vec<String>,
}

/// Form of a [`Picture`] in the file. Its field names are part of the format.
#[derive(Debug, Serialize, Deserialize)]
struct Wire {
    world_from_base: [Option<Pose>; 2],
    tool_from_cube: [Option<Pose>; 2],
    facelets: Option<crate::cube::Facelets>,
    turning: Option<(usize, usize, UnitQuaternion<f64>)>,
    net: Net,
    plan: Vec<PlanLine>,
    step: Option<usize>,
    #[serde(default)]
    handed_back: bool,
}

/// Returns the belief as JSON.
#[must_use]
pub(crate) fn json(picture: &Picture) -> String {
    let wire = Wire {
        world_from_base: picture.world_from_base,
        tool_from_cube: picture.tool_from_cube,
        facelets: picture.facelets,
        turning: picture.turning.map(|t| (t.effector, t.face as usize, t.cube_from_tool)),
        net: picture.net.clone(),
        plan: picture.plan.as_ref().clone(),
        step: picture.step,
        handed_back: picture.handed_back,
    };
    serde_json::to_string(&wire).unwrap_or_default()
}

/// Reads a belief from JSON; `None` if the text is none.
#[must_use]
pub(crate) fn read(text: &str) -> Option<Picture> {
    let wire: Wire = serde_json::from_str(text).ok()?;
    // A face number out of range drops the turn, not the whole belief.
    let turning = wire.turning.and_then(|(effector, face, cube_from_tool)| {
        let face = *crate::cube::Face::ALL.get(face)?;
        Some(Turning { effector, face, cube_from_tool })
    });
    Some(Picture {
        world_from_base: wire.world_from_base,
        tool_from_cube: wire.tool_from_cube,
        facelets: wire.facelets,
        turning,
        net: wire.net,
        plan: Arc::new(wire.plan),
        step: wire.step,
        handed_back: wire.handed_back,
    })
}

/// Returns colours 0..=5 as letters URFDLB, unknown ones as `?`.
pub(crate) fn letters(colours: impl Iterator<Item = Option<u8>>) -> String {
    colours
        .map(|c| c.and_then(|c| b"URFDLB".get(usize::from(c))).map_or('?', |l| char::from(*l)))
        .collect()
}

/// Returns the state of the cube as the kernel believes it. `truth` is left empty.
#[must_use]
pub(crate) fn known(picture: &Picture, arms: &[String]) -> CubeKnown {
    let readings = &picture.net.facelets;
    let holders = arms.iter().zip(&picture.tool_from_cube).filter(|(_, held)| held.is_some());
    CubeKnown {
        identified: letters(readings.iter().map(|r| r.map(|r| r.colour))),
        confidences: readings.iter().map(|r| r.map_or(0.0, |r| r.confidence)).collect(),
        believed: picture.facelets.map_or_else(String::new, |f| f.to_string()),
        truth: String::new(),
        holders: holders.map(|(name, _)| name.clone()).collect(),
    }
}

/// Writes the plan as `rubik_robot_msgs/Plan` at `stamp` (ns).
pub(crate) fn write_plan(picture: &Picture, stamp: u64, to: &mut Writer) {
    let steps: Vec<_> = picture.plan.iter().map(|line| line.what.clone()).collect();
    let reasons: Vec<_> = picture.plan.iter().map(|line| line.why.clone()).collect();
    to.time(stamp);
    to.string_sequence(&steps);
    to.string_sequence(&reasons);
    to.f64_sequence(&picture.plan.iter().map(|line| line.seconds).collect::<Vec<_>>());
}
