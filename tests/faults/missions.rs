//! Tests of faults in whole missions, `scenarios/faults/solve_*.toml`: the mission recovers and
//! solves the cube.
//!
//! Each test begins in a world just before its fault. One mission per seed, with a cube a few turns
//! from solved, loses its power when the first layer begins to turn. Every fault of that seed
//! resumes from a copy of this world, so a hundred seeds take little time: `FAULT_SEEDS=100 cargo
//! test --release --test faults missions::`. The verdict in the summary is that of the plant.

use crate::program::program;
use crate::seeds::{Seed, each_seed, profile};
use rubik_robot::campaign::benchmark::{scramble, scrambled};
use rubik_robot::record::summary::{Outcome, Summary};
use std::collections::BTreeMap;
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::{Arc, Mutex, OnceLock};

/// Number of moves that scramble a cube: enough for a fault, the recovery and a few turns after it.
const MOVES: u64 = 4;

/// Worlds just before their faults, and the cubes in them, by seed.
static WORLDS: Mutex<BTreeMap<u64, Arc<OnceLock<Before>>>> = Mutex::new(BTreeMap::new());

/// World in which a layer begins to turn, and the cube in it.
struct Before {
    world: PathBuf,
    cube: String,
}

impl Seed {
    /// Runs a scenario with this cube, whose plant saves its state in the file `world`; `more` are
    /// further arguments.
    fn run(self, scenario: &str, cube: &str, world: &Path, more: &[&str]) -> Output {
        program()
            .arg("run")
            .arg(format!("scenarios/{scenario}.toml"))
            .args(["--json", "--ui", "none", "--seed", &self.0.to_string(), "--cube", cube])
            .arg("--world")
            .arg(world)
            .args(profile().iter().flat_map(|profile| ["--set", profile]))
            .args(more)
            .output()
            .unwrap()
    }

    /// Returns the path of a file for the state of this seed's plant; `name` tells the files of one
    /// seed apart.
    fn place(self, name: &str) -> PathBuf {
        let file = format!("rubik-robot-{}-{}-{name}.json", std::process::id(), self.0);
        Path::new(env!("CARGO_TARGET_TMPDIR")).join(file)
    }

    /// Returns the saved state of the plant just before the first layer turns, where all faults
    /// begin. The first call for a seed runs a mission until its power is cut there.
    fn before(self) -> Arc<OnceLock<Before>> {
        let before = Arc::clone(WORLDS.lock().unwrap().entry(self.0).or_default());
        before.get_or_init(|| {
            let cube = scrambled(&scramble(MOVES, self.0)).to_string();
            let world = self.place("before");
            let out = self.run("faults/solve_power_cut", &cube, &world, &[]);
            let told = String::from_utf8_lossy(&out.stderr);
            assert_eq!(out.status.signal(), Some(9), "{told}");
            Before { world, cube }
        });
        before
    }

    /// Resumes the mission from the state just before the faults, with the fault of the scenario
    /// `solve_{fault}`. Checks that it solves the cube and returns its summary.
    fn with(self, fault: &str) -> Summary {
        self.resumed(&format!("faults/solve_{fault}"))
    }

    /// Resumes the mission from the state just before the faults under `scenario`. Checks that it
    /// solves the cube and returns its summary.
    fn resumed(self, scenario: &str) -> Summary {
        let before = self.before();
        let Before { world, cube } = before.get().unwrap();
        let copy = self.place(&scenario.replace('/', "-"));
        std::fs::copy(world, &copy).unwrap();
        std::fs::copy(beside(world, "journal"), beside(&copy, "journal")).unwrap();
        let out = self.run(scenario, cube, &copy, &["--resume"]);
        for file in [copy.clone(), beside(&copy, "journal"), beside(&copy, "lock")] {
            let _ = std::fs::remove_file(file);
        }
        let (printed, told) =
            (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
        let last = printed.lines().last().unwrap_or_else(|| panic!("{told}"));
        let summary: Summary = serde_json::from_str(last).unwrap();
        assert_eq!(summary.outcome, Outcome::Solved, "{scenario}: {}\n{told}", summary.reason);
        summary
    }
}

/// Returns the path of a file beside that of a world, with the ending `.{end}`.
pub(super) fn beside(world: &Path, end: &str) -> PathBuf {
    PathBuf::from(format!("{}.{end}", world.display()))
}

/// The cube that the resumed mission has identified is the one at its start, so no layer turned
/// before all faces were read.
#[test]
fn mission_after_power_cut_reads_all_faces_first() {
    each_seed(|seed| {
        let summary = seed.resumed("solve");
        assert_eq!(summary.identified, summary.cube_start);
        assert_eq!((summary.recoveries, summary.drops), (0, Some(0)));
        assert!(summary.turns > 0);
    });
}

/// In the plant a layer slips back after its turn. The mission detects that before it hands the
/// cube back, and reads the faces and plans again.
#[test]
fn layer_slipping_back_is_detected_before_returning_cube() {
    each_seed(|seed| {
        let summary = seed.with("turn_undone");
        assert_eq!((summary.recoveries, summary.drops), (1, Some(0)));
    });
}

#[test]
fn dropped_cube_is_taken_again_and_solved() {
    each_seed(|seed| {
        let summary = seed.with("drop");
        assert_eq!((summary.recoveries, summary.drops), (1, Some(1)));
    });
}

/// Checks that the hands realign the layer of a turn that failed in the middle, and solve the cube.
/// The force between the hands stays below `most` (N), which is larger for a push because the push
/// itself exerts 25 N.
fn check_realigned(fault: &str, most: f64) {
    each_seed(|seed| {
        let summary = seed.with(fault);
        assert_eq!((summary.recoveries, summary.drops), (1, Some(0)), "{fault}");
        let peak = summary.peak_force_n.unwrap();
        assert!(peak < most, "{fault}: {peak}");
    });
}

#[test]
fn layer_is_realigned_after_slipping_grip() {
    check_realigned("slip", 20.0);
}

#[test]
fn layer_is_realigned_after_jam() {
    check_realigned("jam", 20.0);
}

#[test]
fn layer_is_realigned_after_push() {
    check_realigned("push", 30.0);
}

#[test]
fn layer_is_realigned_with_biased_force_sensor() {
    check_realigned("bias", 20.0);
}

/// A stale journal would count as true in a run that resumes, so the file is gone.
#[test]
fn mission_with_torn_journal_is_solved_without_it() {
    let cube = scrambled(&scramble(MOVES, 1)).to_string();
    let world = Seed(1).place("torn");

    let out = Seed(1).run("faults/solve_torn_write", &cube, &world, &[]);

    let told = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(0), "{told}");
    let lost = "the journal cannot be written: Input/output error (os error 5)";
    assert!(told.contains(lost) && told.contains("cannot be resumed"), "{told}");
    assert!(!beside(&world, "journal").exists());
    for end in ["", ".lock"] {
        std::fs::remove_file(format!("{}{end}", world.display())).unwrap();
    }
}

#[test]
fn each_mission_fault_has_a_test() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/faults");
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|file| file.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned())
        .filter_map(|name| name.strip_prefix("solve_").map(str::to_owned))
        .collect();
    names.sort();

    // The fault "blind" begins at the time of the inspection of one seed: its test is a user's.
    let own = include_str!("missions.rs").split_once("fn each_mission_fault").unwrap().0;
    let users = include_str!("../user/missions.rs");
    let is_tested = |name: &String| {
        let orders = [format!("with(\"{name}\")"), format!("check_realigned(\"{name}\", ")];
        let scenario = format!("solve_{name}");
        orders.iter().chain([&scenario]).any(|call| own.contains(call)) || users.contains(&scenario)
    };
    assert!(names.len() >= 9, "{names:?}");
    names.retain(|name| !is_tested(name));
    assert_eq!(names, [""; 0], "these faults have no test");
}
