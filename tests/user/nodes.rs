//! Runs whose actors are on two nodes, over the model of a link.

use crate::missions::run;
use crate::program::program;
use crate::recording::recorded;
use rubik_robot::record::summary::{Outcome, Summary};

/// Delay and losses of a slow link.
const SLOW: [&str; 2] = ["link.delay_ms=50", "link.loss=0.01"];
/// The postument's ECP and EDP on another node.
const ARM: &str = "node=[{name=\"b\",actors=[\"edp postument\",\"ecp postument\",\"vsp gs2\"]}]";

fn over_slow_link(scenario: &str, more: &[&str]) -> Summary {
    run(scenario, &[&SLOW, more].concat())
}

#[test]
fn mission_over_slow_link_solves_cube() {
    let summary = over_slow_link("two_nodes.toml", &[]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert_eq!((summary.drops, summary.collisions), (Some(0), Some(0)));
}

/// MP and the programme of a remote ECP exchange signals over the link.
#[test]
fn programmes_run_on_two_nodes() {
    let summary = over_slow_link("follow_contour.toml", &[ARM]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
}

#[test]
fn run_over_link_repeats_by_its_seed() {
    let run = |more: &[&str]| over_slow_link("patrol.toml", &[&[ARM, "seed=5"], more].concat());
    let first = run(&[]).servo_hash;

    assert_eq!(run(&[]).servo_hash, first);
    assert_ne!(run(&["link.delay_ms=51"]).servo_hash, first, "the link has an effect");
}

/// The link delays the inputs of actors; a verification delays them in the same way.
#[test]
fn recording_over_link_is_verified_whole() {
    let keys: Vec<_> = SLOW.iter().chain([&ARM]).flat_map(|key| ["--set", *key]).collect();
    let (file, _) = recorded("over-link.mcap", "scenarios/patrol.toml", &keys);

    let verified = program().args(["replay", "--verify"]).arg(&file).output().unwrap();

    let told = String::from_utf8_lossy(&verified.stdout);
    assert!(told.contains("the same: the whole controller"), "{told}");
    assert_eq!(verified.status.code(), Some(0));
    std::fs::remove_file(file).unwrap();
}
