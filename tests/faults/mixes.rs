//! Tests of the mixes of faults that `campaign --mix` has found, `scenarios/mixes/*.toml`: none of
//! them breaks a rule for mixes any more.

use crate::program::program;
use rubik_robot::campaign::mix::Broken;
use rubik_robot::record::summary::Summary;
use std::path::Path;

#[test]
fn found_mixes_break_no_rule() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/mixes");
    let mut files: Vec<_> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(!files.is_empty());

    for file in files {
        let out =
            program().arg("run").arg(&file).args(["--json", "--ui", "none"]).output().unwrap();

        let told = String::from_utf8_lossy(&out.stdout);
        let summary: Summary = serde_json::from_str(told.lines().last().unwrap()).unwrap();
        let broken = Broken::of_summary(&summary);
        assert_eq!(broken, None, "{}: {}", file.display(), summary.reason);
    }
}
