//! The tasks other than those of the cube, under virtual time.

use crate::missions::run;
use crate::program::program;
use nalgebra::Vector3;
use rubik_robot::desk::Desk;
use rubik_robot::record::summary::{Outcome, Summary};
use rubik_robot::run::{RunContext, RunOptions, run_with};
use rubik_robot::scenario::Override;
use std::path::Path;
use std::sync::{Arc, Mutex};

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

/// Returns the faults of a shipped scenario with the override `set`.
fn refused(name: &str, set: &str) -> String {
    refused_all(name, &[set.to_owned()])
}

/// Returns the faults of a shipped scenario with these overrides.
fn refused_all(name: &str, sets: &[String]) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios").join(name);
    let sets: Vec<_> = sets.iter().map(|set| Override::parse(set).unwrap()).collect();
    rubik_robot::tasks::load(&path, &sets).unwrap_err().to_string()
}

/// Returns a figure of a run.
fn figure(summary: &Summary, name: &str) -> f64 {
    summary.figures[name].as_f64().unwrap()
}

/// The same bar on the same way with the same errors of the cell: only the yielding partner keeps
/// the bound on the internal force.
#[test]
fn yielding_partner_carries_bar_within_bound() {
    let yielding = run("carry_bar.toml", &["seed=5"]);
    let stiff = run("carry_bar.toml", &["seed=5", "carry_bar.partner=stiff"]);

    assert_eq!(yielding.outcome, Outcome::Solved, "{}", yielding.reason);
    assert!(figure(&yielding, "internal_p99_n") < 5.0, "{:?}", yielding.figures);
    assert!(figure(&yielding, "placed_off_mm") < 5.0, "{:?}", yielding.figures);
    assert_eq!(stiff.outcome, Outcome::Failed, "{}", stiff.reason);
    assert!(figure(&stiff, "internal_p99_n") > 15.0, "{:?}", stiff.figures);
}

/// A push stops both hands at a low limit. They yield, and then carry the bar on to its place.
#[test]
fn push_at_carrier_delays_but_loses_no_bar() {
    let push = "fault=[{name=\"p\",kind=\"push\",arm=\"postument\",direction=1,magnitude=20,\
                at_s=7,duration_s=0.12}]";

    let summary = run("carry_bar.toml", &["carry_bar.stop_force_n=15", push]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert!(figure(&summary, "stops") >= 1.0, "{:?}", summary.figures);
    assert!(figure(&summary, "placed_off_mm") < 5.0, "{:?}", summary.figures);
}

/// MP carries out the orders of two arms of three, and the third arm has a programme of its own.
/// However long its rounds last, and whatever stops it, the carriers do not notice.
#[test]
fn two_arms_carry_while_third_goes_rounds() {
    let push = "fault=[{name=\"p\",kind=\"push\",arm=\"third\",direction=1,magnitude=60,at_s=4,\
                duration_s=0.3}]";
    let alone = run("three_arms.toml", &["carry_bar.rounds=1"]);
    let beside = run("three_arms.toml", &[]);
    let pushed = run("three_arms.toml", &[push]);

    for (summary, rounds) in [(&alone, 1), (&beside, 4), (&pushed, 4)] {
        assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
        assert_eq!(summary.figures["rounds"], serde_json::json!([rounds]));
        assert_eq!(summary.figures["carried_s"], alone.figures["carried_s"]);
        assert_eq!(summary.figures["wrist_peak_n"], alone.figures["wrist_peak_n"]);
        assert_eq!(summary.collisions, Some(0));
    }
    let ended = |summary: &Summary| summary.figures["ended_s"][0].as_f64().unwrap();
    assert!(ended(&beside) > 15.0, "the third arm moves while the others carry");
    assert!(ended(&pushed) > ended(&beside) + 0.9, "the third arm waits after the push");
}

/// A fault of the third arm stops all arms, and the reason names it.
#[test]
fn fault_of_third_arm_stops_carriers() {
    let freeze = "fault=[{name=\"f\",kind=\"encoder_freeze\",arm=\"third\",axis=1,at_s=4.3}]";

    let summary = run("three_arms.toml", &[freeze]);

    assert_eq!(summary.outcome, Outcome::Failed, "{}", summary.reason);
    assert!(summary.reason.contains("effector 2"), "{}", summary.reason);
    assert!(summary.reason.contains("the encoder does not move"), "{}", summary.reason);
    assert_eq!(figure(&summary, "falls"), 0.0, "{:?}", summary.figures);
}

#[test]
fn three_arms_are_refused_by_tasks_of_two() {
    for task in ["solve", "acquire", "face_turn"] {
        let sets = [format!("task={task}"), "coordination=sporadic".to_owned()];
        let faults = refused_all("three_arms.toml", &sets);
        let fault = format!("\"{task}\" drives 2 effectors, but there are 3");
        assert!(faults.contains(&fault), "{task}: {faults}");
    }
    let faults = refused("carry_bar.toml", "carry_bar.rounds=1");
    assert!(faults.contains("there is no third [[effector]]"), "{faults}");
    let arm = |i| format!("[[effector]]\nname = \"arm{i}\"\nprofile = \"irp6_track\"\n");
    let five = (0..5).map(arm).collect::<Vec<_>>().concat();
    let faults = rubik_robot::tasks::read(Path::new("five.toml"), &five, &[]).unwrap_err();
    assert!(faults.to_string().contains("at most 4 can be driven"), "{faults}");
}

#[test]
fn check_refuses_arms_in_each_other() {
    let mut call = program();
    call.args(["check", "scenarios/three_arms.toml"]);
    call.args(["--set", "effector.third.base_xyz_mm=[0,2110,0]"]);
    call.args(["--set", "effector.third.base_rpy_deg=[0,0,0]"]);
    let out = call.current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();

    let told = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(2), "{told}");
    assert!(told.contains("the arms postument and third are"), "{told}");
}

/// The jaws do not open as wide as the bar, which only the task's kernel knows.
#[test]
fn check_finds_what_kernel_refuses() {
    for command in ["check", "run"] {
        let mut call = program();
        call.args([command, "scenarios/carry_bar.toml", "--set", "carry_bar.width_mm=80"]);
        let out = call.current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();

        let told = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(2), "{command}: {told}");
        assert!(told.contains("task \"carry_bar\"") && told.contains("the bar"), "{told}");
    }
}

/// A bar that one gripper lets go is no success: the controller stops at once, and the judge, which
/// knows the plant alone, counts the fall.
#[test]
fn dropped_bar_is_no_success() {
    let drop = "fault=[{name=\"d\",kind=\"drop\",arm=\"track\",at_s=8}]";

    let summary = run("carry_bar.toml", &[drop]);

    assert_ne!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert!(
        summary.reason.contains("the hand of arm 0 does not hold the bar"),
        "{}",
        summary.reason
    );
    assert!(summary.sim_time_s < 10.0, "{} s", summary.sim_time_s);
    let lost = figure(&summary, "falls") + figure(&summary, "slips");
    assert!(lost >= 1.0, "{:?}", summary.figures);
}

/// The page shows the bar where the plant has it when it lies at its new place, and the trestle
/// where the scenario has it.
#[test]
fn page_shows_bar_where_plant_has_it() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/carry_bar.toml");
    let scenario = rubik_robot::tasks::load(&path, &[]).unwrap();
    let desk = Desk::default();
    let place = Arc::new(Mutex::new(Vector3::zeros()));
    let truth = Arc::clone(&place);
    let context = RunContext {
        desk: Some(desk.run_end()),
        probe: Some(Box::new(move |_, plant| {
            let bar = plant.objects().find(|object| &*object.name == "bar").unwrap();
            *truth.lock().unwrap() = bar.world_from_object.translation.vector;
        })),
        ..RunContext::default()
    };
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };

    let summary = run_with(&scenario, options, context).unwrap();

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    let ui = desk.ui_end();
    let stage = ui.stage.borrow();
    let fixed: Vec<_> =
        stage.objects.iter().map(|object| (&object.name[..], object.fixed)).collect();
    assert_eq!(fixed, [("bar", false), ("trestle", true)]);
    let shown = ui.snapshots.borrow().objects["bar"].translation.vector;
    let off = (shown - *place.lock().unwrap()).norm();
    assert!(off < 1e-4, "{off} m");
    let moved = (shown - stage.objects[0].pose.translation.vector).norm();
    assert!(moved > 0.1, "{moved} m");
}

#[test]
fn carry_bar_needs_two_arms_and_turns() {
    for (set, fault) in [
        ("carry_bar.turns_deg=[0]", "`carry_bar.turns_deg`: the way has 3 points and 1 turns"),
        ("carry_bar.speed_mm_s=480", "is faster than `control.linear_speed_mm_s`"),
        ("coordination=sporadic", "needs \"continuous\""),
    ] {
        let faults = refused("carry_bar.toml", set);
        assert!(faults.contains(fault), "{set}: {faults}");
    }
    let one =
        "task = \"carry_bar\"\ncoordination = \"continuous\"\n[[effector]]\nname = \"track\"\n";
    let faults = rubik_robot::tasks::read(Path::new("one.toml"), one, &[]).unwrap_err();
    let fault = "`task`: \"carry_bar\" needs 2 effectors, but there are 1";
    assert!(faults.to_string().contains(fault), "{faults}");
}
