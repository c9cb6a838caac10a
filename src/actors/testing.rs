//! Parts of the tests of path checks: orders and places in the example cell.

use crate::generators::Behaviour;
use crate::motion::JointPositions;
use crate::reach::{Meeting, MeetingTable, ReachSettings, example_cell};

/// Returns a joint motion to `target` at full speed.
pub(super) fn to(target: JointPositions) -> Behaviour {
    Behaviour::Joints { target, speed: 1.0, seconds: 0.0 }
}

/// Returns the first meeting of the hands in the table, and a function that returns the track arm's
/// joint positions for a distance along its track from that meeting (m).
pub(super) fn meeting() -> (Meeting, impl Fn(f64) -> JointPositions) {
    let table = MeetingTable::compute(&example_cell(), &ReachSettings::default());
    let meeting = table.grasps.into_iter().flatten().next().unwrap();
    let along = move |by: f64| {
        let mut track = meeting.track;
        track.0[0] += by;
        track
    };
    (meeting, along)
}
