//! Missions that are killed and resumed. The two processes share only the file with the plant's
//! state and the journal.

use crate::program::program;
use std::io::BufRead as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Returns the command of a run whose plant keeps its state in the file `world`.
fn run(scenario: &[&str], world: &Path) -> Command {
    let mut command = program();
    command.arg("run").args(scenario).args(["--json", "--world"]).arg(world);
    command
}

/// Returns the default path of the journal of a run whose plant is in the file `world`.
fn journal(world: &Path) -> PathBuf {
    beside(world, "journal")
}

/// Starts a mission and kills its process as soon as its journal has `times` entries of the action
/// `doing`.
fn killed_after(scenario: &[&str], world: &Path, doing: &str, times: usize) {
    let mut child =
        run(scenario, world).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let begun = Instant::now();
    loop {
        let entries = std::fs::read_to_string(journal(world)).unwrap_or_default();
        if entries.matches(&format!("\"{doing}\"")).count() >= times {
            break;
        }
        assert!(child.try_wait().unwrap().is_none(), "the mission was over before it was killed");
        assert!(begun.elapsed() < Duration::from_secs(300));
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

/// Resumes a run, which must succeed, and returns its summary.
fn resumed(scenario: &[&str], world: &Path) -> serde_json::Value {
    let out = run(scenario, world).arg("--resume").output().unwrap();
    let printed = String::from_utf8(out.stdout).unwrap();
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{stderr}\n{printed}");
    serde_json::from_str(printed.lines().last().unwrap()).unwrap()
}

/// Reads the state of the plant that a run has saved in the file `world`.
fn kept(world: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(world).unwrap()).unwrap()
}

/// Removes all files that belong to the plant's state in the file `world`.
fn remove(world: &Path) {
    for file in [world, &journal(world), &beside(world, "lock"), &beside(world, "new")] {
        let _ = std::fs::remove_file(file);
    }
}

/// Returns the path of the file beside `world` whose name has this further ending.
fn beside(world: &Path, end: &str) -> PathBuf {
    PathBuf::from(format!("{}.{end}", world.display()))
}

/// Runs a command to its end and returns its exit code and the text on stderr.
fn ended(run: &mut Command) -> (i32, String) {
    let out = run.output().unwrap();
    (out.status.code().unwrap(), String::from_utf8_lossy(&out.stderr).into_owned())
}

/// Starts a run and waits until its plant has saved a first state in the file `world`. Returns the
/// process.
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

/// Kills a process and waits for its end.
fn killed(mut child: Child) {
    child.kill().unwrap();
    child.wait().unwrap();
}

/// Returns the path of a temporary file for the test of this name.
fn place(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("rubik-robot-resume-{}-{name}.json", std::process::id()))
}

#[test]
fn mission_killed_during_turns_resumes_and_solves() {
    let world = place("killed");
    let scenario = ["scenarios/solve.toml"];
    killed_after(&scenario, &world, "turning", 5);

    // While no process runs, a person turns a layer by a quarter. The axis is not the one of the
    // interrupted turn.
    let mut state = kept(&world);
    let turning = state["split"]["axis"].as_u64();
    let axis = (0..3).find(|&axis| Some(axis) != turning).unwrap() as usize;
    let angle = state["angles"][axis][1].as_f64().unwrap();
    state["angles"][axis][1] = (angle + std::f64::consts::FRAC_PI_2).into();
    std::fs::write(&world, serde_json::to_vec(&state).unwrap()).unwrap();

    let summary = resumed(&scenario, &world);

    assert_eq!(summary["outcome"], "solved", "{summary}");
    // The resumed mission read the cube before it planned, and read the plant's cube correctly.
    assert_eq!(summary["cube_start"], summary["identified"], "{summary}");
    // A further resume has nothing to do.
    let again = resumed(&scenario, &world);
    assert_eq!((&again["outcome"], &again["turns"]), (&"solved".into(), &0.into()), "{again}");
    remove(&world);
}

/// The first cut comes while the cube falls. At the second one the track is far from the place of
/// hand-over.
#[test]
fn cube_that_fell_around_power_cut_is_solved() {
    let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/mixes/falls_in_power_cut.toml");
    for (name, cut) in [("seen-by-nobody", 95.23), ("on-the-way", 96.0)] {
        let world = place(name);
        let drop = "{ name = \"a\", kind = \"drop\", arm = \"postument\", at_s = 95.18 }";
        let power = format!("{{ name = \"b\", kind = \"power_cut\", at_s = {cut} }}");
        let power = format!("fault=[{drop}, {power}]");
        assert!(!run(&[scenario, "--set", &power], &world).output().unwrap().status.success());

        let end = resumed(&[scenario, "--set", "fault=[]"], &world);

        assert_eq!((&end["outcome"], &end["drops"]), (&"solved".into(), &1.into()), "{end}");
        assert_eq!(end["drops_noticed"], 1, "{name}: {end}");
        remove(&world);
    }
}

/// The kill comes after the turns, while the hand lowers the solved cube. The resumed mission lifts
/// the cube, makes no turn and lays it down.
#[test]
fn mission_killed_while_lowering_the_cube_resumes() {
    let world = place("lowered");
    let after_r = "UUFUUFUUFRRRRRRRRRFFDFFDFFDDDBDDBDDBLLLLLLLLLUBBUBBUBB";
    let scenario = ["scenarios/table.toml", "--cube", after_r];
    // The lowering takes 0.05 s. On a busy machine the kill may come later, so there are five
    // tries.
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
    assert_eq!(summary["reason"], "the cube is in the required state and on the table");
    let solved = "UUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB";
    assert_eq!((&summary["cube_end"], &summary["turns"]), (&solved.into(), &0.into()), "{summary}");
    for count in ["drops", "slips", "collisions"] {
        assert_eq!(summary[count], 0, "{count}: {summary}");
    }
    remove(&world);
}

#[test]
fn resume_refuses_missing_or_unreadable_plant_state() {
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

    let (code, stderr) = refused(&[]);
    assert!(code == 2 && stderr.contains("--journal"), "{stderr}");
    std::fs::write(&world, "{}").unwrap();
    let (code, stderr) = refused(&["--world", &at]);
    assert!(code == 4 && stderr.contains("not the state of a plant"), "{code} {stderr}");
    std::fs::write(&world, "{\"version\": 2, \"grasps\": []}").unwrap();
    let (code, stderr) = refused(&["--world", &at]);
    assert!(
        code == 4 && stderr.contains("plant state of version 2; this program reads"),
        "{stderr}"
    );
    remove(&world);
}

/// A file of another kind, the journal of an interrupted run, and a file that another run is
/// writing: each is refused with its reason and stays unchanged.
#[test]
fn run_refuses_invalid_unfinished_or_locked_journal() {
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
        ("", unfinished, true, "the journal records an interrupted run"),
    ];

    for (kept, entry, resume, reason) in cases {
        for (path, text) in [(&world, kept), (&notes, entry)] {
            if !text.is_empty() {
                std::fs::write(path, format!("{text}\n")).unwrap();
            }
        }
        let (code, stderr) = run(&world, &notes, resume);
        assert!(code == 4 && stderr.contains(reason), "{reason}: {code} {stderr}");
        for (path, text) in [(&world, kept), (&notes, entry)] {
            if !text.is_empty() {
                assert_eq!(std::fs::read_to_string(path).unwrap().trim(), text, "{reason}");
            }
            let _ = std::fs::remove_file(path);
        }
    }

    // A torn first entry, as after a power cut, does not stop a run: no motion had begun.
    std::fs::write(&notes, &unfinished[..30]).unwrap();
    // Neither do the files of a finished run stop the next one.
    for _ in 0..2 {
        let (code, stderr) = run(&world, &notes, false);
        assert_eq!(code, 0, "{stderr}");
    }
    remove(&world);
    let file = std::fs::File::options().append(true).open(&notes).unwrap();
    file.lock().unwrap();
    let (code, stderr) = run(&world, &notes, false);
    assert!(code == 4 && stderr.contains("another run is writing this journal"), "{code} {stderr}");
    std::fs::remove_file(&notes).unwrap();
    remove(&world);
    let folder = std::env::temp_dir();
    let (code, stderr) = run(&folder, &notes, false);
    assert!(code == 4 && stderr.contains("not a file"), "{code} {stderr}");
}

/// The first advice is to resume: to remove the journal would give up the saved world as well.
#[test]
fn new_run_beside_interrupted_journal_exits_2() {
    let (world, notes) = (place("world-beside"), place("journal-beside"));
    let unfinished = r#"{"doing":"turning","held":["One",null],"handing_back":false,"over":false}"#;
    std::fs::write(&notes, format!("{unfinished}\n")).unwrap();
    for with_world in [true, false] {
        let mut run = program();
        run.args(["run", "scenarios/solve.toml", "--json", "--journal"]).arg(&notes);
        if with_world {
            run.arg("--world").arg(&world);
        }
        let out = run.output().unwrap();

        let told = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(2), "{told}");
        let begin = "--journal: an earlier run was interrupted while turning, and its journal ";
        assert!(told.starts_with(begin), "{told}");
        let (resume, new) = (told.find("--resume"), told.find("To start a new run"));
        assert!(resume.is_some() && resume < new, "{told}");
        let wanted = if with_world { "replaces the saved plant" } else { "--world of that run" };
        assert!(told.contains(wanted) && !told.contains("could not be created"), "{told}");
        assert_eq!(std::fs::read_to_string(&notes).unwrap().trim(), unfinished);
        assert!(!world.exists(), "a refused run writes nothing");
    }
    std::fs::remove_file(&notes).unwrap();
}

/// `ulimit -f 1` simulates a disk that is full at the third or fourth entry. The run warns, marks
/// the journal as incomplete and continues. A resume from this journal is refused.
#[test]
fn run_continues_when_the_journal_cannot_be_written() {
    let notes = place("full-notes");
    // With SIGXFSZ ignored, a write beyond the limit fails with EFBIG instead of ending the
    // process.
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

    let mut stderr = String::new();
    let lines = std::io::BufReader::new(child.stderr.take().unwrap()).lines();
    for line in lines.map_while(Result::ok) {
        stderr.push_str(&line);
        stderr.push('\n');
        // Read on until the run prints its next phase after the warning.
        let warned = stderr.find("the journal cannot be written");
        if warned.is_some_and(|at| stderr[at..].lines().skip(1).any(|line| line.contains(" s  "))) {
            break;
        }
    }
    killed(child);

    let why = format!("{}: the journal cannot be written: File too large", notes.display());
    assert!(stderr.contains(&why), "{stderr}");
    assert!(stderr.contains("the run continues and cannot be resumed"), "{stderr}");
    assert!(stderr.lines().last().unwrap().contains(" s  "), "the run continues: {stderr}");
    // A remaining last entry would pass for the present state of the cell.
    let (world, kept) = (place("full"), std::fs::read_to_string(&notes).unwrap());
    assert!(!kept.contains("doing"), "{kept}");
    let again = |more: &[&str]| {
        let short = ["scenarios/face_turn.toml"];
        let scenario = if more.is_empty() { &short } else { &["scenarios/solve.toml"] };
        ended(run(scenario, &world).arg("--journal").arg(&notes).args(more))
    };
    let (code, stderr) = again(&["--resume"]);
    assert!(code == 4 && stderr.contains("because its run could not write to it"), "{stderr}");
    assert_eq!(std::fs::read_to_string(&notes).unwrap(), kept, "left as it is");
    let (code, stderr) = again(&[]);
    assert_eq!(code, 0, "another run may begin: {stderr}");
    std::fs::remove_file(notes).unwrap();
    remove(&world);
}

#[test]
fn resume_refuses_plant_state_of_another_scenario() {
    let solve = ["scenarios/solve.toml"];
    let world = place("other");
    let refused = |more: &[&str]| {
        let (code, stderr) = ended(run(&solve, &world).arg("--resume").args(more));
        assert_eq!(code, 4, "{stderr}");
        stderr
    };

    // This scenario has an equal seed, but a gripper holds its cube and its bases have other
    // places.
    let (code, stderr) = ended(&mut run(&["scenarios/face_turn.toml"], &world));
    assert_eq!(code, 0, "{stderr}");
    let stderr = refused(&[]);
    assert!(stderr.contains("it was made in another cell"), "{stderr}");

    remove(&world);
    killed(begun(&mut run(&solve, &world), &world));
    let before = std::fs::read(&world).unwrap();
    let stderr = refused(&["--set", "cube.edge_mm=56"]);
    assert!(stderr.contains("it was made in another cell"), "{stderr}");
    let stderr = refused(&["--set", "plant.cube_kind=dry"]);
    assert!(stderr.contains("it was made with other plant keys"), "{stderr}");
    assert!(std::fs::read(&world).unwrap() == before, "a refused run has changed it");

    // A run with other keys of the controller may resume in the same plant.
    let other = [solve[0], "--resume", "--set", "control.grip_n=29"];
    killed_after(&other, &world, "turning", 1);
    remove(&world);
}

/// A second run must not use the saved plant of a running one. The lock on it ends with the process
/// of the first run, even if that process is killed.
#[test]
fn run_refuses_plant_state_used_by_another_run() {
    let (world, notes) = (place("taken"), place("taken-notes"));
    let idle = ["scenarios/idle.toml", "--set", "idle.time_s=600", "--speed", "1"];
    let short = ["scenarios/idle.toml", "--set", "idle.time_s=0.5"];
    let first = begun(&mut run(&idle, &world), &world);

    let (code, stderr) = ended(run(&short, &world).arg("--journal").arg(&notes));

    assert!(code == 4 && stderr.contains("another run uses this file"), "{code} {stderr}");
    assert!(!notes.exists(), "a run that is refused begins no journal");
    killed(first);
    let (code, stderr) = ended(run(&short, &world).arg("--journal").arg(&notes));
    assert_eq!(code, 0, "{stderr}");
    std::fs::remove_file(notes).unwrap();
    remove(&world);
}

#[test]
fn unwritable_plant_state_is_removed_and_run_continues() {
    let world = place("lost");
    let idle = ["scenarios/idle.toml", "--set", "idle.time_s=6", "--speed", "2"];
    let run = begun(&mut run(&idle, &world), &world);

    // Each state is written to FILE.new first; a folder of that name makes the next write fail.
    let hinders = beside(&world, "new");
    while std::fs::create_dir(&hinders).is_err() {}
    let out = run.wait_with_output().unwrap();

    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{stderr}");
    let lost = format!("{}: the plant's state can no longer be saved: ", world.display());
    let (_, why) = stderr.split_once(&lost).unwrap_or_else(|| panic!("{stderr}"));
    assert!(why.contains("it is removed, and this run cannot be resumed"), "{stderr}");
    assert_eq!(stderr.matches(&lost).count(), 1, "reported once: {stderr}");
    assert!(!world.exists(), "a stale state would count as true");
    std::fs::remove_dir(hinders).unwrap();
    remove(&world);
}

/// The arm `postument` is not synchronised after a restart, and its jaws may hold the cube. The
/// resume ends with the reason; neither arms nor layers move, and the journal stays unchanged.
#[test]
fn resume_does_not_home_unsynchronised_arm_holding_cube() {
    let world = place("unsynchronised");
    let scenario = ["scenarios/solve.toml"];
    killed_after(&scenario, &world, "turning", 2);
    let mut state = kept(&world);
    for encoder in state["arms"][1]["encoders"].as_array_mut().unwrap() {
        encoder["synchronised"] = false.into();
    }
    std::fs::write(&world, serde_json::to_vec(&state).unwrap()).unwrap();
    let entries = std::fs::read_to_string(journal(&world)).unwrap();

    let (code, stderr) = ended(run(&scenario, &world).arg("--resume"));

    assert_eq!(code, 1, "{stderr}");
    assert!(stderr.contains("postument is not synchronised, and its jaws may hold"), "{stderr}");
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
    assert_eq!(std::fs::read_to_string(journal(&world)).unwrap(), entries, "the entries stay");
    remove(&world);
}
