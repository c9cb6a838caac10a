//! The tasks other than those of the cube, under virtual time.

use crate::missions::run;
use rubik_robot::record::summary::{Outcome, Summary};

#[test]
fn patrol_goes_its_rounds_without_coordination() {
    let summary = run("patrol.toml", &[]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert_eq!(summary.figures["rounds"], serde_json::json!([3, 3]));
    assert_eq!(summary.collisions, Some(0));
}

/// A push stops one arm. It waits and goes on, and the other one does not notice: its rounds take
/// as long as without the push.
#[test]
fn push_at_one_arm_delays_that_arm_only() {
    let push = "fault=[{name=\"p\",kind=\"push\",arm=\"track\",direction=1,magnitude=60,\
                at_s=2,duration_s=0.3}]";
    let alone = run("patrol.toml", &["patrol.rounds=1"]);
    let pushed = run("patrol.toml", &["patrol.rounds=1", push]);

    for summary in [&alone, &pushed] {
        assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
        assert_eq!(summary.figures["rounds"], serde_json::json!([1, 1]));
    }
    let ended = |summary: &Summary, arm: usize| summary.figures["ended_s"][arm].as_f64().unwrap();
    // The arm waits for a second before it goes on.
    let later = [0, 1].map(|arm| ended(&pushed, arm) - ended(&alone, arm));
    assert!(later[0] > 0.9 && later[1].abs() < 1e-9, "{later:?}");
}
