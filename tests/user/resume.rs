//! A mission that is killed, and goes on: the plant's state in a file is all that the two processes share, beside the
//! journal.

use crate::program::program;
use std::io::BufRead as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A run of a scenario whose plant keeps its state in a file.
fn run(scenario: &[&str], world: &Path) -> Command {
    let mut command = program();
    command.arg("run").args(scenario).args(["--json", "--world"]).arg(world);
    command
}

fn journal(world: &Path) -> PathBuf {
    beside(world, "journal")
}

/// Kills a mission when its journal has so many entries of what it is doing.
fn killed_after(scenario: &[&str], world: &Path, doing: &str, times: usize) {
    let mut child =
        run(scenario, world).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let begun = Instant::now();
    loop {
        let noted = std::fs::read_to_string(journal(world)).unwrap_or_default();
        if noted.matches(&format!("\"{doing}\"")).count() >= times {
            break;
        }
        assert!(child.try_wait().unwrap().is_none(), "the mission was over before it was killed");
        assert!(begun.elapsed() < Duration::from_secs(300));
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

fn resumed(scenario: &[&str], world: &Path) -> serde_json::Value {
    let out = run(scenario, world).arg("--resume").output().unwrap();
    let printed = String::from_utf8(out.stdout).unwrap();
    let told = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{told}\n{printed}");
    serde_json::from_str(printed.lines().last().unwrap()).unwrap()
}

/// What a plant has kept.
fn kept(world: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(world).unwrap()).unwrap()
}

fn remove(world: &Path) {
    for file in [world, &journal(world), &beside(world, "lock"), &beside(world, "new")] {
        let _ = std::fs::remove_file(file);
    }
}

fn beside(world: &Path, end: &str) -> PathBuf {
    PathBuf::from(format!("{}.{end}", world.display()))
}

/// The exit code of a run that has ended, and what it told the operator.
fn ended(run: &mut Command) -> (i32, String) {
    let out = run.output().unwrap();
    (out.status.code().unwrap(), String::from_utf8_lossy(&out.stderr).into_owned())
}

/// A run that begins, and goes on until it is killed.
fn begun(run: &mut Command, world: &Path) -> Child {
    let mut child = run.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let since = Instant::now();
    while !world.exists() {
        assert!(child.try_wait().unwrap().is_none(), "it was over before it began");
        assert!(since.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(5));
    }
    child
}

fn killed(mut child: Child) {
    child.kill().unwrap();
    child.wait().unwrap();
}

fn place(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("rubik-robot-resume-{}-{name}.json", std::process::id()))
}

#[test]
fn a_mission_killed_amid_its_turns_is_resumed_to_a_solved_cube() {
    let world = place("killed");
    let scenario = ["scenarios/solve.toml"];
    killed_after(&scenario, &world, "turning", 5);

    // Behind everybody's back a layer that nobody holds askew is turned by a quarter.
    let mut state = kept(&world);
    let turning = state["split"]["axis"].as_u64();
    let axis = (0..3).find(|&axis| Some(axis) != turning).unwrap() as usize;
    let angle = state["angles"][axis][1].as_f64().unwrap();
    state["angles"][axis][1] = (angle + std::f64::consts::FRAC_PI_2).into();
    std::fs::write(&world, serde_json::to_vec(&state).unwrap()).unwrap();

    let summary = resumed(&scenario, &world);

    assert_eq!(summary["outcome"], "solved", "{summary}");
    // What it turned was planned after looking: what it saw is what the plant had.
    assert_eq!(summary["cube_start"], summary["identified"], "{summary}");
    // And now there is nothing left to do.
    let again = resumed(&scenario, &world);
    assert_eq!((&again["outcome"], &again["turns"]), (&"solved".into(), &0.into()), "{again}");
    remove(&world);
}

#[test]
fn a_mission_killed_while_it_lays_the_cube_down_lifts_it_and_lays_it_down_solved() {
    let world = place("lowered");
    let after_r = "UUFUUFUUFRRRRRRRRRFFDFFDFFDDDBDDBDDBLLLLLLLLLUBBUBBUBB";
    let scenario = ["scenarios/table.toml", "--cube", after_r];
    // It takes a twentieth of a second, and this process may be kept from running for longer.
    let lowering = (0..5).any(|_| {
        killed_after(&scenario, &world, "laying it down", 1);
        let state = kept(&world);
        let held = state["state"] == "Held" && state["grasps"][0]["hold"] == "Closed";
        if !held {
            remove(&world);
        }
        held
    });
    assert!(lowering, "it was never killed in time");

    let summary = resumed(&scenario, &world);

    assert_eq!(summary["outcome"], "solved", "{summary}");
    assert_eq!(summary["reason"], "the cube is as wanted and on the table");
    let solved = "UUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB";
    assert_eq!((&summary["cube_end"], &summary["turns"]), (&solved.into(), &0.into()), "{summary}");
    for count in ["drops", "slips", "collisions"] {
        assert_eq!(summary[count], 0, "{count}: {summary}");
    }
    remove(&world);
}

#[test]
fn what_cannot_be_resumed_is_refused_with_the_reason() {
    let refused = |more: &[&str]| {
        let out = program()
            .args(["run", "scenarios/solve.toml", "--json", "--resume"])
            .args(more)
            .output()
            .unwrap();
        (out.status.code().unwrap(), String::from_utf8_lossy(&out.stderr).into_owned())
    };
    let world = place("refused");
    let at = world.display().to_string();

    let (code, told) = refused(&[]);
    assert!(code == 2 && told.contains("--journal"), "{told}");
    std::fs::write(&world, "{}").unwrap();
    let (code, told) = refused(&["--world", &at]);
    assert!(code == 4 && told.contains("not the state of a plant"), "{code} {told}");
    std::fs::write(&world, "{\"version\": 2, \"grasps\": []}").unwrap();
    let (code, told) = refused(&["--world", &at]);
    assert!(code == 4 && told.contains("of a plant of version 2, this program reads"), "{told}");
    remove(&world);
}

#[test]
fn a_file_that_another_has_written_is_left_as_it_is() {
    let run = |world: &Path, journal: &Path, resume: bool| {
        let mut run = program();
        let scenario = if resume { "scenarios/solve.toml" } else { "scenarios/face_turn.toml" };
        run.args(["run", scenario, "--json", "--world"]).arg(world);
        run.arg("--journal").arg(journal).args(resume.then_some("--resume"));
        let out = run.output().unwrap();
        (out.status.code().unwrap(), String::from_utf8_lossy(&out.stderr).into_owned())
    };
    let (world, notes) = (place("world"), place("journal"));
    let unfinished = r#"{"doing":"turning","held":["One",null],"handing_back":false,"over":false}"#;
    let cases = [
        ("a thesis", "", false, "not the state of a plant"),
        ("", "notes", false, "line 1"),
        ("", unfinished, false, "broken off while turning: go on with --resume"),
        ("", unfinished, true, "the journal tells of a run that was broken off"),
    ];

    for (kept, noted, resume, told) in cases {
        for (path, text) in [(&world, kept), (&notes, noted)] {
            if !text.is_empty() {
                std::fs::write(path, format!("{text}\n")).unwrap();
            }
        }
        let (code, err) = run(&world, &notes, resume);
        assert!(code == 4 && err.contains(told), "{told}: {code} {err}");
        for (path, text) in [(&world, kept), (&notes, noted)] {
            if !text.is_empty() {
                assert_eq!(std::fs::read_to_string(path).unwrap().trim(), text, "{told}");
            }
            let _ = std::fs::remove_file(path);
        }
    }

    // Nor what a power cut has left of the first entry: nothing had begun.
    std::fs::write(&notes, &unfinished[..30]).unwrap();
    // What a run has left that has ended is no loss.
    for _ in 0..2 {
        let (code, err) = run(&world, &notes, false);
        assert_eq!(code, 0, "{err}");
    }
    remove(&world);
    let file = std::fs::File::options().append(true).open(&notes).unwrap();
    file.lock().unwrap();
    let (code, err) = run(&world, &notes, false);
    assert!(code == 4 && err.contains("another run is writing it"), "{code} {err}");
    std::fs::remove_file(&notes).unwrap();
    remove(&world);
    let folder = std::env::temp_dir();
    let (code, err) = run(&folder, &notes, false);
    assert!(code == 4 && err.contains("not a file"), "{code} {err}");
}

/// A disk has no room for the third entry or the fourth.
#[test]
fn a_journal_that_cannot_be_written_is_told_and_marked_and_the_run_goes_on() {
    let notes = place("full-notes");
    // Who ignores the signal is told by the system instead.
    let limited = "trap '' XFSZ; ulimit -f 1; exec \"$0\" \"$@\"";
    let mut child = Command::new("sh")
        .args(["-c", limited, env!("CARGO_BIN_EXE_rubik-robot")])
        .args(["run", "scenarios/solve.toml", "--json", "--journal"])
        .arg(&notes)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();

    let mut told = String::new();
    let lines = std::io::BufReader::new(child.stderr.take().unwrap()).lines();
    for line in lines.map_while(Result::ok) {
        told.push_str(&line);
        told.push('\n');
        // Then it goes on, to its next phase.
        let warned = told.find("the journal cannot be written");
        if warned.is_some_and(|at| told[at..].lines().skip(1).any(|line| line.contains(" s  "))) {
            break;
        }
    }
    killed(child);

    let why = format!("{}: the journal cannot be written: File too large", notes.display());
    assert!(told.contains(&why), "{told}");
    assert!(told.contains("the run goes on, and cannot be resumed"), "{told}");
    assert!(told.lines().last().unwrap().contains(" s  "), "it goes on: {told}");
    // Its last entry would pass for the truth.
    let (world, kept) = (place("full"), std::fs::read_to_string(&notes).unwrap());
    assert!(!kept.contains("doing"), "{kept}");
    let again = |more: &[&str]| {
        let short = ["scenarios/face_turn.toml"];
        let scenario = if more.is_empty() { &short } else { &["scenarios/solve.toml"] };
        ended(run(scenario, &world).arg("--journal").arg(&notes).args(more))
    };
    let (code, told) = again(&["--resume"]);
    assert!(code == 4 && told.contains("could not be written to the end of its run"), "{told}");
    assert_eq!(std::fs::read_to_string(&notes).unwrap(), kept, "left as it is");
    let (code, told) = again(&[]);
    assert_eq!(code, 0, "another run may begin: {told}");
    std::fs::remove_file(notes).unwrap();
    remove(&world);
}

#[test]
fn the_world_of_another_scenario_is_not_taken_up() {
    let solve = ["scenarios/solve.toml"];
    let world = place("other");
    let refused = |more: &[&str]| {
        let (code, told) = ended(run(&solve, &world).arg("--resume").args(more));
        assert_eq!(code, 4, "{told}");
        told
    };

    // The same seed, but the cube is in a hand, and the bases stand otherwise.
    let (code, told) = ended(&mut run(&["scenarios/face_turn.toml"], &world));
    assert_eq!(code, 0, "{told}");
    let told = refused(&[]);
    assert!(told.contains("it was made in another cell"), "{told}");

    remove(&world);
    killed(begun(&mut run(&solve, &world), &world));
    let before = std::fs::read(&world).unwrap();
    let told = refused(&["--set", "cube.edge_mm=56"]);
    assert!(told.contains("it was made in another cell"), "{told}");
    let told = refused(&["--set", "plant.cube_kind=dry"]);
    assert!(told.contains("it was made with other plant keys"), "{told}");
    assert!(std::fs::read(&world).unwrap() == before, "a refused run has changed it");

    // Another controller may go on in the same plant.
    let other = [solve[0], "--resume", "--set", "control.grip_n=29"];
    killed_after(&other, &world, "turning", 1);
    remove(&world);
}

#[test]
fn a_world_that_another_run_keeps_is_refused_until_that_run_is_gone_however_it_went() {
    let (world, notes) = (place("taken"), place("taken-notes"));
    let idle = ["scenarios/idle.toml", "--set", "idle.time_s=600", "--speed", "1"];
    let short = ["scenarios/idle.toml", "--set", "idle.time_s=0.5"];
    let first = begun(&mut run(&idle, &world), &world);

    let (code, told) = ended(run(&short, &world).arg("--journal").arg(&notes));

    assert!(code == 4 && told.contains("another run keeps its plant there"), "{code} {told}");
    assert!(!notes.exists(), "a run that is refused begins no journal");
    killed(first);
    let (code, told) = ended(run(&short, &world).arg("--journal").arg(&notes));
    assert_eq!(code, 0, "{told}");
    std::fs::remove_file(notes).unwrap();
    remove(&world);
}

#[test]
fn a_world_that_cannot_be_kept_any_more_is_removed_and_the_run_goes_on() {
    let world = place("lost");
    let idle = ["scenarios/idle.toml", "--set", "idle.time_s=6", "--speed", "2"];
    let run = begun(&mut run(&idle, &world), &world);

    // Where the next state is written first there is no file any more.
    let hinders = beside(&world, "new");
    while std::fs::create_dir(&hinders).is_err() {}
    let out = run.wait_with_output().unwrap();

    let told = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{told}");
    let lost = format!("{}: the plant's state cannot be kept any more: ", world.display());
    let (_, why) = told.split_once(&lost).unwrap_or_else(|| panic!("{told}"));
    assert!(why.contains("it is removed, and this run cannot be resumed"), "{told}");
    assert_eq!(told.matches(&lost).count(), 1, "told once: {told}");
    assert!(!world.exists(), "a state of long ago would pass for the truth");
    std::fs::remove_dir(hinders).unwrap();
    remove(&world);
}

#[test]
fn a_hand_that_may_hold_the_cube_and_lost_its_counters_is_not_driven_to_its_switches() {
    let world = place("unsynchronised");
    let scenario = ["scenarios/solve.toml"];
    killed_after(&scenario, &world, "turning", 2);
    let mut state = kept(&world);
    for encoder in state["arms"][1]["encoders"].as_array_mut().unwrap() {
        encoder["synchronised"] = false.into();
    }
    std::fs::write(&world, serde_json::to_vec(&state).unwrap()).unwrap();
    let noted = std::fs::read_to_string(journal(&world)).unwrap();

    let (code, told) = ended(run(&scenario, &world).arg("--resume"));

    assert_eq!(code, 1, "{told}");
    assert!(told.contains("postument does not know where it is, and its jaws may hold"), "{told}");
    let after = kept(&world);
    assert_eq!(after["state"], state["state"]);
    // A layer between two hands settles when their drives go off.
    for (axis, at) in state["angles"].as_array().unwrap().iter().enumerate() {
        for (layer, at) in at.as_array().unwrap().iter().enumerate() {
            let on = after["angles"][axis][layer].as_f64().unwrap() - at.as_f64().unwrap();
            assert!(on.abs() < 1e-2, "layer {layer} of axis {axis} has turned by {on}");
        }
    }
    for arm in 0..2 {
        for axis in 0..7 {
            let at =
                |state: &serde_json::Value| state["arms"][arm]["joints"][axis].as_f64().unwrap();
            assert!((at(&after) - at(&state)).abs() < 1e-3, "arm {arm}, axis {axis}");
        }
    }
    assert_eq!(std::fs::read_to_string(journal(&world)).unwrap(), noted, "what it knew stays");
    remove(&world);
}
