//! The verdicts on the cube tasks, by the plant alone.
//!
//! The plant confirms a solved cube that is back in its place, a cube that was taken and returned,
//! or a face turn within `TURNED_WITHIN` of its angle, without a jam and with less than `EXCESSIVE`
//! force.

use super::door::{Acquire, FaceTurn, Solve, face_turn_start};
use super::keys;
use crate::hw::plant::Verdict as PlantVerdict;
use crate::reach::MeetingTable;
use crate::registry::{Beginning, Judgement, Truth, Verdict};
use crate::scenario::ControllerConfig;

/// Force on the cube from which on it is excessive (N). It is used in the verdict only and limits
/// no motion.
const EXCESSIVE: f64 = 20.0;
/// Largest error of a turn that counts as correct (deg).
const TURNED_WITHIN: f64 = 5.0;
/// Time after a hand-back in which the operator's hand withdraws (s).
const WITHDRAWAL: f64 = 4.0;

/// Judge of the task `solve`.
#[derive(Debug, Default)]
pub struct SolveVerdict;

impl Verdict for SolveVerdict {
    type Task = Solve;
    // The verdict is about the end of the hand-over, after the hand has withdrawn with the cube.
    const SETTLES: f64 = WITHDRAWAL;

    fn judge(&self, _: &keys::Planner, truth: &Truth) -> Judgement {
        let solved = truth.end().is_solved();
        let (right, words) =
            (solved && truth.verdict.is_back(), verdict_words(solved, &truth.verdict));
        Judgement::new(right, words)
    }
}

/// Judge of the task `acquire`.
#[derive(Debug, Default)]
pub struct AcquireVerdict;

impl Verdict for AcquireVerdict {
    type Task = Acquire;

    fn judge(&self, _: &keys::Planner, truth: &Truth) -> Judgement {
        // The take does not change the cube: only its return counts.
        let (right, words) = (truth.verdict.is_back(), verdict_words(true, &truth.verdict));
        Judgement::new(right, words)
    }
}

/// Judge of the task `face_turn`.
#[derive(Debug, Default)]
pub struct FaceTurnVerdict;

impl Verdict for FaceTurnVerdict {
    type Task = FaceTurn;

    fn beginning(
        keys: &keys::FaceTurn,
        config: &ControllerConfig,
        meetings: Option<&MeetingTable>,
    ) -> Result<Option<Beginning>, String> {
        let meetings = meetings.ok_or("a face turn needs two arms")?;
        let (start, _) = face_turn_start(meetings, keys.angle)?;
        let edge = config.cell.cube.edge;
        let tool_from_cube = start.body.cube_from_tool(start.half_roll, edge).inverse();
        Ok(Some(Beginning { meeting: start.meeting, tool_from_cube }))
    }

    fn judge(&self, keys: &keys::FaceTurn, truth: &Truth) -> Judgement {
        // The turner holds the upper layer, so clockwise seen from outside is negative about +z.
        // `turned` is the angle of the body's part against the turner's: positive in the ordered
        // sense.
        let turned = truth.verdict.turned.to_degrees();
        let half = (keys.angle.abs().to_degrees() - 180.0).abs() < 1e-6;
        // Half a turn has the same result in both senses.
        let turned_deg = if half { turned.abs() } else { turned * keys.angle.signum() };
        let (right, words) = turn_verdict(keys.angle, turned_deg, truth);
        Judgement::new(right, words).with("layer_turned_deg", turned_deg)
    }
}

/// Returns whether a face turn ordered by `angle` (rad) was correct in the plant, and a sentence
/// about it.
fn turn_verdict(angle: f64, turned_deg: f64, truth: &Truth) -> (bool, String) {
    let asked = angle.abs().to_degrees();
    let gentle = truth.verdict.peak_force < EXCESSIVE;
    let right = (turned_deg - asked).abs() < TURNED_WITHIN && truth.jams == 0 && gentle;
    let force = if gentle { "" } else { ", with excessive force" };
    // A slip is mentioned, but the angle decides.
    let slip = if truth.verdict.counts.slips > 0 { ", and a grip slipped" } else { "" };
    let jam = if truth.jams > 0 { ", and it jammed" } else { "" };
    let words = format!("the layer was turned by {turned_deg:.1} deg of {asked:.0}");
    (right, format!("{words}{force}{slip}{jam}"))
}

/// Returns in words whether the cube is in the state that the task requires (`solved`), and where
/// it is.
fn verdict_words(solved: bool, verdict: &PlantVerdict) -> String {
    let state = if solved { "the cube is in the required state" } else { "the cube is not solved" };
    format!("{state} and {}", verdict.place())
}
