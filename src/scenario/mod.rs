//! Scenarios: what a run is to do, in which cell, with which controller, against which plant.
//!
//! - in: a TOML file in the workshop's units, and `KEY=VALUE` options that overrule parts of it
//! - out: a [`Scenario`] in SI, whose two halves are different types: the [`ControllerConfig`]
//!   holds what the controller may know (its belief), the [`PlantSection`] what only the simulated
//!   plant may read
//! - faults: all of them at once, each with `file:line:column`
//!
//! A key is declared in one place: see `scenario::section`. The built-in cell is `scenarios/cell.toml`.

pub(crate) mod fault;
pub(crate) mod injected;
pub mod keys;
pub(crate) mod lists;
pub(crate) mod plant;
pub(crate) mod root;
pub(crate) mod section;
pub(crate) mod tree;

mod build;
mod check;
mod config;
mod draft;
mod motion;
mod overrides;
mod profile;

pub use config::{
    CameraSource, ControllerConfig, EffectorConfig, Owner, PlantSection, Scenario, VspConfig,
};
pub use overrides::Override;

use crate::hw::text;
use fault::{Faults, Source};
use section::{Key, Reader};
use std::path::Path;
use std::rc::Rc;

/// Scenarios that the program brings along, by the names that stand for their paths anywhere.
const SHIPPED: [(&str, &str); 2] = [
    ("shipped:solve", include_str!("../../scenarios/solve.toml")),
    ("shipped:table", include_str!("../../scenarios/table.toml")),
];

/// Returns the text of a scenario: of a file, or of one that the program brings along
/// (`shipped:solve`, `shipped:table`).
///
/// # Errors
/// What the operating system says to a file.
pub fn text(path: &Path) -> std::io::Result<String> {
    let shipped = SHIPPED.iter().find(|(name, _)| path.as_os_str() == *name);
    shipped.map_or_else(|| text::read(path, text::SCENARIO), |(_, text)| Ok((*text).to_owned()))
}

/// Reads a scenario file, or one that the program brings along.
///
/// # Errors
/// All faults of the file and of the overrides.
pub fn load(path: &Path, overrides: &[Override]) -> Result<Scenario, Faults> {
    let text = text(path).map_err(|error| {
        let mut faults = Faults::default();
        let reason = match error.kind() {
            std::io::ErrorKind::NotFound => "there is no such file".to_owned(),
            std::io::ErrorKind::InvalidData => "not text in UTF-8".to_owned(),
            std::io::ErrorKind::IsADirectory => "a folder, not a scenario file".to_owned(),
            _ => error.to_string(),
        };
        faults.add(None, format!("{}: {reason}", path.display()));
        faults
    })?;
    read(path, &text, overrides)
}

/// Reads a scenario's text; `path` names it in faults, and its folder is where relative paths
/// start.
///
/// # Errors
/// All faults of the text and of the overrides.
pub fn read(path: &Path, text: &str, overrides: &[Override]) -> Result<Scenario, Faults> {
    let mut reader = Reader::default();
    let source =
        Rc::new(Source { name: path.display().to_string(), text: text.to_owned(), is_file: true });
    let mut document = tree::parse(&source, &mut reader.faults);
    if !reader.faults.0.is_empty() {
        // The text behind a fault of syntax cannot be trusted: its faults would be noise.
        return Err(reader.faults.sorted());
    }
    let built_in = draft::built_in(&mut reader);
    overrides::apply(overrides, &mut document, &built_in, &mut reader);
    let draft = draft::draft(&document, &built_in, &mut reader);
    match build::scenario(path, draft, &mut reader) {
        Some(scenario) if reader.faults.0.is_empty() => Ok(scenario),
        _ => Err(reader.faults.sorted()),
    }
}

/// Returns every key with its default.
#[must_use]
pub(crate) fn all_keys() -> Vec<Key> {
    let mut reader = Reader::default();
    let built_in = draft::built_in(&mut reader);
    draft::draft(&built_in, &built_in, &mut reader).keys()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faults(text: &str, overrides: &[Override]) -> String {
        match read(Path::new("t.toml"), text, overrides) {
            Ok(_) => String::new(),
            Err(faults) => faults.to_string(),
        }
    }

    #[test]
    fn every_fault_is_told_with_its_place() {
        let text = "taks = \"solve\"\n[cube]\nedge = 57\nmass_g = \"heavy\"\n[control]\n\
                    grip_n = 1000\ncompliance = \"tf\"\n[planner]\nrule = \"best\"\n";

        let told = faults(text, &[]);

        for wanted in [
            "t.toml:1:1: unknown key `taks`",
            "did you mean `task`?",
            "t.toml:3:1: unknown key `edge` in [cube]",
            "did you mean `edge_mm`?",
            "t.toml:4:10: `cube.mass_g`: wanted a number, found \"heavy\"",
            "t.toml:6:10: `control.grip_n`: 1000 is outside 1..100",
            "did you mean \"tff\"?",
            "t.toml:9:8: `planner.rule`: \"best\" is none of its words",
        ] {
            assert!(told.contains(wanted), "no `{wanted}` in:\n{told}");
        }
    }

    #[test]
    fn an_override_reaches_into_a_built_in_list_and_is_checked_like_the_file() {
        let good = Override::parse("effector.track.tool_xyz_mm=[0, 0, 260]").unwrap();
        let scenario = read(Path::new("t.toml"), "", &[good]).unwrap();
        let tool = scenario.controller.cell.arms[0].flange_from_tool;
        assert!((tool.translation.z - 0.26).abs() < 1e-12);
        assert_eq!(scenario.controller.cell.arms.len(), 2);

        let bad = Override::parse("effector.1.gripper.palm=10").unwrap();
        let told = faults("", &[bad]);
        assert!(told.contains("--set effector.1.gripper.palm: unknown key `palm`"), "{told}");
        assert!(told.contains("did you mean `palm_mm`?"), "{told}");
    }

    #[test]
    fn a_list_of_its_own_replaces_the_built_in_one() {
        let text = "task = \"idle\"\ncamera = []\nvsp = []\n[[effector]]\nname = \"track\"\nstart_d0_mm = 100\n";

        let scenario = read(Path::new("t.toml"), text, &[]).unwrap();

        assert_eq!(scenario.controller.cell.arms.len(), 1);
        assert!(scenario.controller.cell.arms[0].model.has_track);
        assert!(scenario.controller.vsps.is_empty());
    }

    #[test]
    fn what_hangs_on_a_missing_effector_is_left_out() {
        let text = "task = \"idle\"\n[[effector]]\nname = \"postument\"\n";

        let scenario = read(Path::new("t.toml"), text, &[]).unwrap();

        let cameras: Vec<&str> =
            scenario.controller.cell.cameras.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(cameras, ["standalone", "postument_hand"]);
        let vsps: Vec<&str> = scenario.controller.vsps.iter().map(|v| v.name.as_str()).collect();
        assert_eq!(vsps, ["gs2", "mpf"]);
    }
}
