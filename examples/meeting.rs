//! Where two arms can meet: joint positions of both arms in which both hands hold one cube.
//!
//!     cargo run --release --example meeting
//!
//! The search tries all 24 rotations of one hand to the other. It takes about a second; a run keeps
//! its table in a file.

use rubik_robot::cell::{Arm, Cell};
use rubik_robot::motion::JointPositions;
use rubik_robot::reach::{Meeting, MeetingTable, ReachSettings};
use rubik_robot::spatial::Pose;
use rubik_robot::tasks;
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let (cell, table) = search()?;
    let (grasps, views) = table.found();
    println!("{grasps} grasps and {views} views are possible; the first two grasps:");
    for (rotation, meeting) in found(&table).take(2) {
        println!("\nhands in rotation {rotation} of 24:");
        for (arm, joints) in cell.arms.iter().zip([meeting.track, meeting.postument]) {
            let [d0, angles @ ..] = joints.0;
            let angles = angles.map(|q| format!("{:7.1}", q.to_degrees())).concat();
            println!("  {:9} d0 {:5.0} mm, q1..q6{angles} deg", arm.name, d0 * 1e3);
        }
        println!("  tool points {:.1} mm apart", tool_distance(&cell, meeting) * 1e3);
        println!("  bodies of the arms at least {:.0} mm apart", meeting.clearance * 1e3);
    }
    Ok(())
}

/// Searches the meetings of the built-in cell.
pub(crate) fn search() -> Result<(Cell, MeetingTable), Box<dyn Error>> {
    let cell = tasks::read(Path::new("cell"), "task = \"idle\"\n", &[])?.controller.cell;
    let table = MeetingTable::compute(&cell, &ReachSettings::default());
    Ok((cell, table))
}

/// Iterates over the grasps that were found, each with the index of its rotation.
pub(crate) fn found(table: &MeetingTable) -> impl Iterator<Item = (usize, &Meeting)> {
    let grasps = table.grasps.iter().enumerate();
    grasps.filter_map(|(rotation, grasp)| Some((rotation, grasp.as_ref()?)))
}

/// Returns the distance of the two tool points at a meeting (m), by the forward kinematics.
pub(crate) fn tool_distance(cell: &Cell, meeting: &Meeting) -> f64 {
    let track = world_from_tool(&cell.arms[0], &meeting.track);
    let postument = world_from_tool(&cell.arms[1], &meeting.postument);
    (track.translation.vector - postument.translation.vector).norm()
}

/// Returns the pose of an arm's tool in the world at these joint positions.
pub(crate) fn world_from_tool(arm: &Arm, joints: &JointPositions) -> Pose {
    arm.world_from_base * arm.model.base_from_flange(joints) * arm.flange_from_tool
}
