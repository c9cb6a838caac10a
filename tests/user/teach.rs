//! The task `teach`, under virtual time: an arm is led by hand, the way becomes a file, and the
//! file, edited or not, is played back.

use crate::folder::Folder;
use crate::missions::run;
use nalgebra::{Point3, Vector3};
use rubik_robot::record::summary::{Outcome, Summary};
use rubik_robot::run::{RunContext, RunOptions, run_with};
use rubik_robot::scenario::Override;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// A lead that a person ends after one short leg.
const SHORT: &str = "lead=[{arm=\"postument\",points_mm=[[0,0,60]],speed_mm_s=14,force_n=18,\
                     at_s=2}]";

/// Returns the override that names a file in a folder.
fn key(folder: &Folder, file: &str) -> String {
    format!("teach.file={}", folder.file(file))
}

/// Returns a figure of the summary.
fn figure(summary: &Summary, name: &str) -> f64 {
    summary.figures.get(name).and_then(serde_json::Value::as_f64).unwrap_or(f64::NAN)
}

/// Checks that the task is done with a playback error below `most` (mm).
fn plays_back(summary: &Summary, most: f64) {
    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    let (rms, greatest) = (figure(summary, "error_rms_mm"), figure(summary, "error_greatest_mm"));
    assert!(rms < 0.75 * most && rms <= greatest && greatest < most, "{rms} {greatest}");
    assert_eq!(summary.collisions, Some(0));
}

#[test]
fn led_way_is_played_back_by_each_path() {
    for path in ["spline", "line", "circle", "joint_spline"] {
        let summary = run("teach.toml", &[&format!("teach.play={path}")]);

        plays_back(&summary, 3.0);
        assert!(figure(&summary, "led_mm") > 200.0);
        let force = figure(&summary, "lead_force_n");
        assert!((2.0..=18.1).contains(&force), "{force} N");
    }
}

/// Plays the way of a file and returns the least distance of the true tool from a point that the
/// file gives in the base of the arm (m).
fn passes(file: &Path, point: [f64; 3]) -> (Summary, f64) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/teach.toml");
    let file = format!("teach.file={}", file.display());
    let keys = ["teach.mode=play", "teach.play=line", "lead=[]", &file];
    let keys: Vec<Override> = keys.iter().map(|key| Override::parse(key).unwrap()).collect();
    let scenario = rubik_robot::tasks::load(&path, &keys).unwrap();
    let least = Arc::new(Mutex::new(f64::INFINITY));
    let seen = Arc::clone(&least);
    let place = Point3::from(Vector3::from(point) * 1e-3);
    let context = RunContext {
        probe: Some(Box::new(move |_, plant| {
            let arm = plant.cell().arms.iter().position(|arm| arm.name == "postument").unwrap();
            let base = plant.cell().arms[arm].world_from_base;
            let tool = plant.scene().arms[arm].world_from_tool.translation.vector;
            let away = (base * place).coords - tool;
            let mut least = seen.lock().unwrap();
            *least = least.min(away.norm());
        })),
        ..RunContext::default()
    };
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };
    let summary = run_with(&scenario, options, context).unwrap();
    let least = *least.lock().unwrap();
    (summary, least)
}

/// Returns the numbers of the last line that begins with this key.
fn numbers(text: &str, key: &str) -> (String, [f64; 3]) {
    let line = text.lines().rfind(|line| line.starts_with(key)).unwrap();
    let list = line.split_once('[').unwrap().1.trim_end_matches(']');
    let numbers: Vec<f64> = list.split(", ").map(|x| x.parse().unwrap()).collect();
    (line.to_owned(), numbers.try_into().unwrap())
}

/// The last point is moved by hand in the file. The plant's tool then comes to the new place, and
/// the judge judges by it.
#[test]
fn edited_file_changes_the_played_way() {
    let folder = Folder::new("teach-edited");
    let file = folder.0.join("way.toml");
    let taught = run(
        "teach.toml",
        &["teach.mode=teach", "teach.play=line", SHORT, &key(&folder, "way.toml")],
    );
    assert_eq!(taught.outcome, Outcome::Solved, "{}", taught.reason);
    let text = std::fs::read_to_string(&file).unwrap();
    let (line, [x, y, z]) = numbers(&text, "xyz_mm");

    // The arm sags by 3 to 4 mm, so the true tool is as far from the points of the file.
    let (summary, near) = passes(&file, [x, y, z]);
    plays_back(&summary, 5.0);
    assert!(near < 5e-3, "{near}");

    let moved = [x, y + 30.0, z];
    let changed = format!("xyz_mm = [{x}, {}, {z}]", y + 30.0);
    std::fs::write(&file, text.replace(&line, &changed)).unwrap();
    let (summary, near) = passes(&file, moved);
    plays_back(&summary, 5.0);
    assert!(near < 5e-3, "{near}");
    let (_, off) = passes(&file, [x, y, z]);
    assert!(off > 0.02, "{off}: the old point is still played");
}

#[test]
fn taught_file_never_replaces_an_existing_one() {
    let folder = Folder::new("teach-kept");
    let mine = folder.0.join("way.toml");
    std::fs::write(&mine, "mine").unwrap();

    let summary = run("teach.toml", &["teach.mode=teach", SHORT, &key(&folder, "way.toml")]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert_eq!(std::fs::read_to_string(&mine).unwrap(), "mine");
    let second = folder.0.join("way-2.toml");
    assert_eq!(summary.figures["files"], serde_json::json!([second.display().to_string()]));
    assert!(std::fs::read_to_string(second).unwrap().contains("[[point]]"));
}

/// File of a way with a key that does not exist in its third line.
const WRONG: &str =
    "arm = \"postument\"\n[[point]]\nxyz_cm = [0, 0, 1]\n[[point]]\nxyz_cm = [0, 0, 2]\n";

#[test]
fn missing_or_wrong_way_is_refused_before() {
    let folder = Folder::new("teach-wrong");
    let file = folder.0.join("way.toml");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/teach.toml");
    let faults = |keys: &[&str]| {
        let keys: Vec<Override> = keys.iter().map(|key| Override::parse(key).unwrap()).collect();
        rubik_robot::tasks::load(&path, &keys).unwrap_err().to_string()
    };

    let named = key(&folder, "way.toml");
    assert!(faults(&["teach.mode=play"]).contains("`teach.file` is missing"));
    let missing = faults(&["teach.mode=play", &named]);
    assert!(missing.contains(&file.display().to_string()), "{missing}");
    std::fs::write(&file, WRONG).unwrap();
    let wrong = faults(&["teach.mode=play", &named]);
    assert!(wrong.contains("way.toml:3:1: unknown key `xyz_cm`"), "{wrong}");
    assert!(faults(&["teach.arm=left"]).contains("there is no effector \"left\""));
}

/// A lesson whose file cannot be written is refused before the arm is led, with line and reason. A
/// replay writes no file.
#[test]
fn missing_folder_is_refused_before_the_lesson() {
    let folder = Folder::new("teach-folder");
    let text = "task = \"teach\"\n[teach]\nfile = \"none/way.toml\"\n";
    let path = folder.0.join("t.toml");
    let mut catalogue = rubik_robot::tasks::built_in().catalogue();

    let faults = rubik_robot::scenario::read(&path, text, &[], &catalogue).unwrap_err().to_string();

    assert!(faults.contains("t.toml:3:8: `teach.file`: the folder"), "{faults}");
    assert!(faults.contains("none does not exist"), "{faults}");
    catalogue.replays = true;
    assert!(rubik_robot::scenario::read(&path, text, &[], &catalogue).is_ok());
}

/// A push in playback stops the arm. It begins the way again.
#[test]
fn pushed_arm_plays_the_way_again() {
    let alone = run("teach.toml", &[SHORT]);
    plays_back(&alone, 3.0);
    let ended = alone.sim_time_s;
    let at = ended - 0.5 * figure(&alone, "played_s");
    let push = format!(
        "fault=[{{name=\"p\",kind=\"push\",arm=\"postument\",direction=1,magnitude=60,\
         at_s={at},duration_s=0.3}}]"
    );

    let pushed = run("teach.toml", &[SHORT, &push]);

    plays_back(&pushed, 3.0);
    assert_eq!(pushed.figures["tries"], 2, "{:?}", pushed.figures);
    assert!(pushed.sim_time_s > ended + 1.0);
}

#[test]
fn arm_that_no_person_leads_is_reported() {
    let summary = run("teach.toml", &["lead=[]", "teach.patience_s=5"]);

    assert_eq!(summary.outcome, Outcome::Failed);
    assert!(summary.reason.contains("no person led the arm postument"), "{}", summary.reason);
}

#[test]
fn person_who_pulls_too_strongly_ends_guidance() {
    let strong = "lead=[{arm=\"postument\",points_mm=[[0,0,90]],speed_mm_s=60,force_n=24,\
                  stiffness_n_mm=2,at_s=2}]";

    let summary = run("teach.toml", &[strong]);

    assert_eq!(summary.outcome, Outcome::Failed, "{}", summary.reason);
    assert!(summary.reason.starts_with("over-force of 2"), "{}", summary.reason);
}

/// The emergency stop ends the run while the arm is led. Nothing was taught, so no file is written.
#[test]
fn emergency_stop_ends_guidance_without_a_file() {
    let folder = Folder::new("teach-emergency");
    let stop = "fault=[{name=\"e\",kind=\"emergency_stop\",at_s=5}]";

    let summary = run("teach.toml", &[stop, &key(&folder, "way.toml")]);

    assert_eq!(summary.outcome, Outcome::Aborted, "{}", summary.reason);
    assert_eq!(std::fs::read_dir(&folder.0).unwrap().count(), 0);
}
