//! The task `follow_contour`, under virtual time: one arm follows a contour, the other one picks
//! parts and passes one on.

use crate::missions::run;
use rubik_robot::record::summary::{Outcome, Summary};
use serde_json::json;

/// Returns a figure of the verdict that is a number.
fn figure(summary: &Summary, name: &str) -> f64 {
    summary.figures[name].as_f64().unwrap()
}

#[test]
fn contour_is_followed_while_part_is_passed() {
    let summary = run("follow_contour.toml", &[]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert!(figure(&summary, "force_error_n") < 2.0);
    assert!(figure(&summary, "covered_mm") > 220.0);
    assert_eq!(summary.figures["contacts"], json!(1));
    assert_eq!(summary.figures["hand_overs"], json!(1));
    assert_eq!(summary.figures["part_drops"], json!(0));
    assert_eq!(summary.collisions, Some(0));
}

/// A push lifts the tool off the contour. The arm comes down again and follows the rest.
#[test]
fn pushed_arm_comes_back_to_the_contour() {
    let push = "fault=[{name=\"p\",kind=\"push\",arm=\"track\",direction=2,magnitude=-40,\
                at_s=11,duration_s=0.1}]";
    let summary = run("follow_contour.toml", &[push]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert!(summary.figures["contacts"].as_u64().unwrap() > 1);
    assert!(figure(&summary, "covered_mm") > 220.0, "{:?}", summary.figures);
    assert_eq!(summary.figures["hand_overs"], json!(1));
}

/// A part falls out of the hand. The programme notices it by the jaws, and the task fails.
#[test]
fn dropped_part_is_noticed_and_reported() {
    let drop = "fault=[{name=\"d\",kind=\"drop\",arm=\"postument\",at_s=11}]";
    let summary = run("follow_contour.toml", &[drop]);

    assert_ne!(summary.outcome, Outcome::Solved);
    assert!(summary.reason.contains("lost"), "{}", summary.reason);
    assert_eq!(summary.figures["part_drops"], json!(1));
}
