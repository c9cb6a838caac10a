//! Belief of a task's kernel (the part that chooses the next action) about the cube, as a recording
//! holds it: as JSON for replays, and as fields of messages for other tools.

use super::cdr::Writer;
use crate::kernel::{Picture, Turning};
use crate::operator::{Net, PlanLine};
use crate::spatial::Pose;
use nalgebra::UnitQuaternion;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::Arc;

/// State of the cube at one moment; an unknown field is empty. Colours are 54 letters out of
/// URFDLB, `?` for an unknown one.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct CubeKnown {
    /// Colours as the cameras read them.
    pub identified: String,
    /// Confidence of each colour, 0 to 1.
    pub confidences: Vec<f64>,
    /// Colours as the controller believes them after the turns that were carried out.
    pub believed: String,
    /// Colours in the plant.
    pub truth: String,
    /// Names of the effectors that hold the cube.
    pub holders: Vec<String>,
}

/// [`Picture`] as JSON in the file. The names of its fields are part of the file format.
#[derive(Debug, Serialize, Deserialize)]
struct Wire {
    world_from_base: [Option<Pose>; 2],
    tool_from_cube: [Option<Pose>; 2],
    facelets: Option<crate::cube::Facelets>,
    /// Turn that is under way: effector, number of the face, `cube_from_tool`.
    turning: Option<(usize, usize, UnitQuaternion<f64>)>,
    net: Net,
    plan: Vec<PlanLine>,
    step: Option<usize>,
    #[serde(default)]
    handed_back: bool,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    facts: BTreeMap<String, Value>,
}

/// Returns a kernel's belief about the cube, and its plan, as JSON.
#[must_use]
pub(crate) fn json(belief: &Picture) -> String {
    let wire = Wire {
        world_from_base: belief.world_from_base,
        tool_from_cube: belief.tool_from_cube,
        facelets: belief.facelets,
        turning: belief.turning.map(|t| (t.effector, t.face as usize, t.cube_from_tool)),
        net: belief.net.clone(),
        plan: belief.plan.as_ref().clone(),
        step: belief.step,
        handed_back: belief.handed_back,
        facts: belief.facts.clone(),
    };
    serde_json::to_string(&wire).unwrap_or_default()
}

/// Parses the JSON that [`json`] writes; `None` if `text` is anything else.
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
        facts: wire.facts,
    })
}

/// Returns colours 0 to 5 as letters URFDLB, one after the other; an unknown colour is `?`.
pub(crate) fn letters(colours: impl Iterator<Item = Option<u8>>) -> String {
    colours
        .map(|c| c.and_then(|c| b"URFDLB".get(usize::from(c))).map_or('?', |l| char::from(*l)))
        .collect()
}

/// Returns the state of the cube as a kernel believes it; `arms` are the names of the effectors.
/// The field `truth` stays empty, since only the plant knows it.
#[must_use]
pub(crate) fn known(belief: &Picture, arms: &[String]) -> CubeKnown {
    let readings = &belief.net.facelets;
    let holders = arms.iter().zip(&belief.tool_from_cube).filter(|(_, held)| held.is_some());
    CubeKnown {
        identified: letters(readings.iter().map(|r| r.map(|r| r.colour))),
        confidences: readings.iter().map(|r| r.map_or(0.0, |r| r.confidence)).collect(),
        believed: belief.facelets.map_or_else(String::new, |f| f.to_string()),
        truth: String::new(),
        holders: holders.map(|(name, _)| name.clone()).collect(),
    }
}

/// Writes the plan in `belief` as a message `rubik_robot_msgs/Plan` with the time stamp `stamp`
/// (ns).
pub(crate) fn write_plan(belief: &Picture, stamp: u64, to: &mut Writer) {
    let steps: Vec<_> = belief.plan.iter().map(|line| line.what.clone()).collect();
    let reasons: Vec<_> = belief.plan.iter().map(|line| line.why.clone()).collect();
    to.time(stamp);
    to.string_sequence(&steps);
    to.string_sequence(&reasons);
    to.f64_sequence(&belief.plan.iter().map(|line| line.seconds).collect::<Vec<_>>());
}
