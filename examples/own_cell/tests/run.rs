//! The example runs as its user would run it.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

/// Runs the program with these arguments.
fn own_cell(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_own_cell")).args(arguments).output().unwrap()
}

/// Runs the scenario of the example with one more option of `--set`; returns its summary.
fn summary(set: &str) -> Value {
    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("wave.toml");
    let output = own_cell(&["run", scenario.to_str().unwrap(), "--json", "--set", set]);
    let text = String::from_utf8(output.stdout).unwrap();
    let last = text.lines().last().unwrap_or_default();
    serde_json::from_str(last).unwrap_or_else(|why| {
        panic!("{why}: {text}{}", String::from_utf8_lossy(&output.stderr));
    })
}

#[test]
fn task_succeeds_under_every_coordination() {
    for coordination in ["sporadic", "continuous", "absent"] {
        let summary = summary(&format!("coordination=\"{coordination}\""));

        assert_eq!(summary["outcome"], "solved", "{summary}");
        assert_eq!(summary["task"], "wave");
        assert!(summary["figures"]["farthest_mm"].as_f64().unwrap() < 2.0, "{summary}");
        let gap = |name: &str| summary["figures"][name].as_f64().unwrap();
        assert!((gap("gap_mm") - gap("true_gap_mm")).abs() < 1.5, "{summary}");
        let waves = &summary["figures"]["waves"];
        assert_eq!(waves.as_u64(), (coordination != "absent").then_some(3), "{summary}");
    }
}

/// A wrist that cannot reach its angle ends the task with the reason, and not with success.
#[test]
fn waves_beyond_wrist_limits_fail_with_reason() {
    let summary = summary("effector.track.start_joints_deg=[0,-90,0,90,90,165]");

    assert_eq!(summary["outcome"], "failed", "{summary}");
    assert_ne!(summary["reason"], "", "{summary}");
}

/// The device tells distances in steps of 0.1 m, so the task reports a wrong one.
#[test]
fn wrong_measurement_does_not_pass_for_right_one() {
    let summary = summary("gap.step_mm=100");

    let figure = |name: &str| summary["figures"][name].as_f64().unwrap();
    assert!((figure("gap_mm") - figure("true_gap_mm")).abs() > 3.0, "{summary}");
    assert_eq!(summary["outcome"], "failed", "{summary}");
}

/// The recorded readings replace the device, so that the verification finds the same run.
#[test]
fn recorded_sensor_verifies_and_missing_reading_fails() {
    let folder = std::env::temp_dir().join(format!("own_cell_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let recording = folder.join("run.mcap");
    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("wave.toml");
    let (scenario, recording) = (scenario.to_str().unwrap(), recording.to_str().unwrap());

    let run = own_cell(&["run", scenario, "--json", "--record", recording]);
    let verified = own_cell(&["replay", recording, "--verify"]);
    let words = String::from_utf8_lossy(&verified.stderr).into_owned();
    let out_of_range = summary("gap.range_mm=100");
    std::fs::remove_dir_all(folder).unwrap();

    assert_eq!(run.status.code(), Some(0));
    assert_eq!(verified.status.code(), Some(0), "{words}");
    let reason = out_of_range["reason"].as_str().unwrap();
    assert!(reason.contains("sensor `gap`") && reason.contains("out of range"), "{reason}");
}

/// A silent or a late device leaves the task without a reading.
#[test]
fn injected_faults_reach_own_sensor() {
    let with = |kind: &str, keys: &str| {
        summary(&format!("fault=[{{ name = \"f\", sensor = \"gap\", kind = \"{kind}\", {keys} }}]"))
    };
    let silent = with("sensor_silent", "at_s = 1");
    let late = with("late_measurements", "magnitude = 60000, at_s = 1");

    for (summary, why) in [(silent, "no measurement comes"), (late, "has not arrived yet")] {
        let reason = summary["reason"].as_str().unwrap();
        assert!(reason.contains("sensor `gap`") && reason.contains(why), "{summary}");
    }
}

#[test]
fn program_speaks_of_itself_by_its_name() {
    let version = own_cell(&["--version"]);
    let help = own_cell(&["help", "run"]);

    let version = String::from_utf8_lossy(&version.stdout).into_owned();
    assert_eq!(version, concat!("own_cell ", env!("CARGO_PKG_VERSION"), "\n"));
    let help = String::from_utf8_lossy(&help.stdout).into_owned();
    assert!(help.contains("own_cell run") && !help.contains("rubik-robot run"), "{help}");
}

#[test]
fn keys_of_task_are_checked_and_listed() {
    let listed = String::from_utf8(own_cell(&["keys", "wave"]).stdout).unwrap();
    assert!(listed.contains("wave.swing_deg = 10"), "{listed}");
    assert!(listed.contains("Angle of the wrist to either side."), "{listed}");
    let faults = String::from_utf8(own_cell(&["keys", "fault"]).stdout).unwrap();
    assert!(faults.contains("sensor_frozen") && faults.contains("fault.NAME.sensor"), "{faults}");

    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("wave.toml");
    for (set, fault) in [
        ("wave.swing_deg=90", "`wave.swing_deg`: 90 is outside 1..45"),
        ("wave.swing=9", "did you mean `swing_deg`?"),
        ("gap.range_mm=9", "`gap.range_mm`: 9 is outside 100..10000"),
        ("vsp.gap.kind=\"gab\"", "did you mean \"gap\"?"),
        (
            "fault=[{ name = \"f\", kind = \"sensor_silent\", sensor = \"gab\", at_s = 1 }]",
            "there is no VSP \"gab\"",
        ),
        ("task=wavy", "did you mean \"wave\"?"),
    ] {
        let output = own_cell(&["check", scenario.to_str().unwrap(), "--set", set]);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{set}");
        assert!(message.contains(fault), "{set}: {message}");
    }
}
