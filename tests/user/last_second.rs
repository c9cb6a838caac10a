//! Recordings of the last second before an error, without `--record`.

use crate::program::program;
use crate::recording::{messages, place};
use rubik_robot::record::reading::{End, open};
use rubik_robot::record::tick::Tick;
use std::path::{Path, PathBuf};

/// Runs a scenario whose user has the folder of states `states`; returns the summary.
fn run(scenario: &str, states: &Path) -> serde_json::Value {
    let out = program()
        .args(["run", scenario, "--json", "--ui", "none"])
        .env("XDG_STATE_HOME", states)
        .output()
        .unwrap();
    let stdout = String::from_utf8(out.stdout).unwrap();
    serde_json::from_str(stdout.lines().last().unwrap()).unwrap()
}

/// Returns an empty folder of states with this name.
fn states(name: &str) -> PathBuf {
    let folder = place(name);
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

#[test]
fn fatal_error_leaves_recording_of_last_second() {
    let states = states("states-fatal");
    let folder = states.join("rubik-robot");
    std::fs::create_dir_all(&folder).unwrap();
    // The clock may be behind that of earlier runs.
    let old: Vec<_> = (9_999_999_999_910_u64..9_999_999_999_935)
        .map(|n| folder.join(format!("last-second-{n}-1.mcap")))
        .collect();
    for path in &old {
        std::fs::write(path, "old").unwrap();
    }

    // One process was killed while it wrote the newest file of all; another one still writes.
    let [part, busy] = ["left", "busy"]
        .map(|name| folder.join(format!("last-second-9999999999999-{name}.mcap.part")));
    std::fs::write(&part, "the beginning").unwrap();
    let writing = std::fs::File::create(&busy).unwrap();
    writing.lock().unwrap();

    let summary = run("scenarios/faults/over_current.toml", &states);

    assert_eq!(summary["ended_by"], "fatal", "{summary}");
    let path = PathBuf::from(summary["last_second"].as_str().unwrap());
    assert_eq!(path.parent(), Some(folder.as_path()));
    // Twenty are left, this one among them.
    assert!(path.exists());
    let kept = old.iter().filter(|path| path.exists()).count();
    assert_eq!((kept, old[24].exists(), old[5].exists()), (19, true, false));
    assert!(!part.exists() && busy.exists());

    let mut reading = open(&path).unwrap();
    let all = messages(reading.by_ref());
    assert_eq!(reading.end(), Some(&End::Whole));
    let ticks: Vec<Tick> = all
        .iter()
        .filter(|message| message.channel.topic.ends_with("/servo"))
        .map(|message| Tick::read(&message.data).unwrap())
        .collect();
    assert_eq!(ticks.len(), 2 * 1000);
    let (first, last) = (ticks.first().unwrap(), ticks.last().unwrap());
    assert_eq!(last.period - first.period, 999);
    let fault = ticks.iter().find(|tick| tick.fault.contains("over-current"));
    let before = fault.map(|tick| tick.period - first.period);
    assert!(before >= Some(500), "a second before the error: {before:?}");
    let page = place("last.html");
    let report = program().arg("report").arg(&path).arg("-o").arg(&page).output().unwrap();
    assert!(report.status.success(), "{report:?}");
}

#[test]
fn successful_run_leaves_no_last_second() {
    let states = states("states-done");

    let summary = run("scenarios/face_turn.toml", &states);

    assert_eq!(summary["outcome"], "solved");
    assert!(summary.get("last_second").is_none() && !states.join("rubik-robot").exists());
}
