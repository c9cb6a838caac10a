//! Tests of the mixes of faults that `campaign --mix` has found, `scenarios/mixes/*.toml`: none of
//! them breaks a rule for mixes any more. A mission that a power cut ends is resumed, as in a
//! campaign.

use crate::missions::beside;
use crate::program::program;
use rubik_robot::campaign::mix::Broken;
use rubik_robot::record::summary::Summary;
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::Output;

#[test]
fn found_mixes_break_no_rule() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/mixes");
    let mut files: Vec<_> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(!files.is_empty());

    for file in files {
        let out = run(&file);

        let told = String::from_utf8_lossy(&out.stdout);
        let summary: Summary = serde_json::from_str(told.lines().last().unwrap()).unwrap();
        let broken = Broken::of_summary(&summary);
        assert_eq!(broken, None, "{}: {}", file.display(), summary.reason);
    }
}

/// Runs a mix. If its power cut ends the process, resumes the mission without power cuts.
fn run(mix: &Path) -> Output {
    let options = ["--json", "--ui", "none"];
    let text = std::fs::read_to_string(mix).unwrap();
    let mut keys: toml::Table = toml::from_str(&text).unwrap();
    let faults = keys["fault"].as_array_mut().unwrap();
    let all = faults.len();
    faults.retain(|fault| fault["kind"].as_str() != Some("power_cut"));
    if faults.len() == all {
        return program().arg("run").arg(mix).args(options).output().unwrap();
    }
    let name = mix.file_stem().unwrap().to_string_lossy();
    let name = format!("mix-{}-{name}", std::process::id());
    let world = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let calm = PathBuf::from(format!("{}.toml", world.display()));
    std::fs::write(&calm, toml::to_string(&keys).unwrap()).unwrap();
    let cut = program().arg("run").arg(mix).args(options).arg("--world").arg(&world).output();
    assert_eq!(cut.unwrap().status.signal(), Some(9), "the power cut ends the process");

    let mut resumed = program();
    resumed.arg("run").arg(&calm).args(options).arg("--world").arg(&world).arg("--resume");
    let out = resumed.output().unwrap();
    for file in [beside(&world, "journal"), beside(&world, "lock"), calm, world] {
        let _ = std::fs::remove_file(file);
    }
    out
}
