//! The scenarios of runs: task, cell, controller and plant of each.
//!
//! - in: a TOML file in the units of a workshop, and `KEY=VALUE` options that override parts of it
//! - out: a [`Scenario`] in SI, whose two halves are different types: the [`ControllerConfig`]
//!   holds what the controller may know (its belief), the [`PlantSection`] what only the simulated
//!   plant may read
//! - faults: all of them at once, each with `file:line:column`
//!
//! Each key is declared in one place: see `scenario::section`. The built-in cell is
//! `scenarios/cell.toml`.

pub mod catalogue;
pub mod declared;
pub mod fault;
pub(crate) mod injected;
pub mod keys;
pub(crate) mod lists;
pub mod maker;
pub mod node_keys;
pub(crate) mod objects;
pub mod order_keys;
mod parameters;
pub(crate) mod plant;
pub(crate) mod root;
pub mod section;
pub mod tree;

mod build;
mod check;
mod config;
mod draft;
mod motion;
mod nodes;
mod overrides;
mod profile;
mod whole;

pub use config::{CameraSource, ControllerConfig, EffectorConfig, Owner, PlantSection, VspConfig};
pub use overrides::Override;
pub use whole::Scenario;

use crate::hw::text;
use catalogue::Catalogue;
use fault::{Faults, Source};
use section::{Key, Reader};
use std::path::Path;
use std::rc::Rc;

/// Scenarios in the program, by the names that replace their paths everywhere.
const SHIPPED: [(&str, &str); 2] = [
    ("shipped:solve", include_str!("../../scenarios/solve.toml")),
    ("shipped:table", include_str!("../../scenarios/table.toml")),
];

/// Returns names and texts of the scenarios that are built into the program.
pub fn shipped() -> impl Iterator<Item = (&'static str, &'static str)> {
    SHIPPED.into_iter()
}

/// Returns the text of the scenario at `path`: that of a file, or of a scenario that is built into
/// the program (`shipped:solve`, `shipped:table`).
///
/// # Errors
/// The file cannot be read.
pub fn text(path: &Path) -> Result<String, text::Unread> {
    let shipped = SHIPPED.iter().find(|(name, _)| path.as_os_str() == *name);
    shipped.map_or_else(|| text::read(path, text::SCENARIO), |(_, text)| Ok((*text).to_owned()))
}

/// Reads the scenario at `path`, which is a file or built into the program, with overrides from the
/// command line. Its task is one of `catalogue`.
///
/// # Errors
/// All faults of the file and of the overrides.
pub fn load(
    path: &Path,
    overrides: &[Override],
    catalogue: &Catalogue,
) -> Result<Scenario, Faults> {
    let text = text(path).map_err(|error| {
        let mut faults = Faults::default();
        faults.add(None, error.to_string());
        faults
    })?;
    read(path, &text, overrides, catalogue)
}

/// Reads the text of a scenario, whose task is one of `catalogue`. `path` is its name in faults,
/// and relative paths start in its folder.
///
/// # Errors
/// All faults of the text and of the overrides.
pub fn read(
    path: &Path,
    text: &str,
    overrides: &[Override],
    catalogue: &Catalogue,
) -> Result<Scenario, Faults> {
    let mut reader = Reader {
        everywhere: draft::names(catalogue),
        tasks: catalogue.sections().0.iter().map(|(name, _)| *name).collect(),
        replays: catalogue.replays,
        ..Reader::default()
    };
    let source =
        Rc::new(Source { name: path.display().to_string(), text: text.to_owned(), is_file: true });
    let mut document = tree::parse(&source, &mut reader.faults);
    if !reader.faults.0.is_empty() {
        // The text after a fault of syntax may be read wrongly, and its faults would only confuse.
        return Err(reader.faults.sorted());
    }
    let built_in = draft::built_in(&mut reader);
    // Overrides become part of the document, so they are read and checked like the file.
    overrides::apply(overrides, &mut document, &built_in, &mut reader);
    let draft = draft::draft(&document, &built_in, catalogue, &mut reader);
    match build::scenario(path, draft, catalogue, &mut reader) {
        Some(scenario) if reader.faults.0.is_empty() => {
            let devices_named = overrides.iter().any(|over| over.key == "bridge.devices");
            Ok(Scenario { devices_named, text: text.to_owned(), ..scenario })
        }
        _ => Err(reader.faults.sorted()),
    }
}

/// Returns every key that a scenario can have, those of the tasks in `catalogue` too, with its
/// default.
#[must_use]
pub(crate) fn all_keys(catalogue: &Catalogue) -> Vec<Key> {
    let mut reader = Reader::default();
    let built_in = draft::built_in(&mut reader);
    // Every key has its default if the document is the built-in cell itself.
    let mut keys = draft::draft(&built_in, &built_in, catalogue, &mut reader).keys();
    // The words that name a task depend on the catalogue.
    let quoted: Vec<String> = catalogue.names().iter().map(|word| format!("\"{word}\"")).collect();
    if let Some(task) = keys.iter_mut().find(|key| key.path == "task") {
        task.kind = quoted.join(" | ");
    }
    keys
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tasks::read;

    /// Returns the faults of a scenario with this text and overrides; empty if there are none.
    fn faults(text: &str, overrides: &[Override]) -> String {
        match read(Path::new("t.toml"), text, overrides) {
            Ok(_) => String::new(),
            Err(faults) => faults.to_string(),
        }
    }

    #[test]
    fn every_error_has_line_and_column() {
        let text = "taks = \"solve\"\n[cube]\nedge = 57\nmass_g = \"heavy\"\n[control]\n\
                    grip_n = 1000\ncompliance = \"tf\"\n[planner]\nrule = \"best\"\n";

        let message = faults(text, &[]);

        for wanted in [
            "t.toml:1:1: unknown key `taks`",
            "did you mean `task`?",
            "t.toml:3:1: unknown key `edge` in [cube]",
            "did you mean `edge_mm`?",
            "t.toml:4:10: `cube.mass_g`: expected a number, found \"heavy\"",
            "t.toml:6:10: `control.grip_n`: 1000 is outside 1..100",
            "did you mean \"tff\"?",
            "t.toml:9:8: `planner.rule`: \"best\" is not a possible value",
        ] {
            assert!(message.contains(wanted), "no `{wanted}` in:\n{message}");
        }
    }

    /// A key in the wrong section, also by an option, is named with the section that has it.
    #[test]
    fn key_in_wrong_section_is_found() {
        let option = [Override::parse("grip_n=30").unwrap()];
        let control = "did you mean `control.grip_n`? it belongs to [control]";

        for (text, options, wanted) in [
            ("time_s = 5\n", &[][..], "did you mean `idle.time_s`? it belongs to [idle]"),
            ("[idle]\ngrip_n = 30\n", &[], control),
            ("[idle]\ngrip_nn = 30\n", &[], control),
            ("", &option, control),
            ("[idle]\ntask = \"idle\"\n", &[], "`task`? it belongs before the first section"),
            ("[idle.control]\ngrip_n = 3\n", &[], "`control`? it is a section of its own"),
            ("tool_xyz_mm = [0, 0, 1]\n", &[], "it belongs to an element of [[effector]]"),
            // The name is right elsewhere, and here it is misspelt.
            ("[cube]\nedge = 57\n", &[], "did you mean `edge_mm`?"),
        ] {
            let message = faults(text, options);

            assert!(message.contains(wanted), "no `{wanted}` in:\n{message}");
        }
    }

    #[test]
    fn override_changes_effector_and_reports_unknown_key() {
        let good = Override::parse("effector.track.tool_xyz_mm=[0, 0, 260]").unwrap();
        let scenario = read(Path::new("t.toml"), "", &[good]).unwrap();
        let tool = scenario.controller.cell.arms[0].flange_from_tool;
        assert!((tool.translation.z - 0.26).abs() < 1e-12);
        assert_eq!(scenario.controller.cell.arms.len(), 2);

        let bad = Override::parse("effector.1.gripper.palm=10").unwrap();
        let message = faults("", &[bad]);
        assert!(message.contains("--set effector.1.gripper.palm: unknown key `palm`"), "{message}");
        assert!(message.contains("did you mean `palm_mm`?"), "{message}");
    }

    #[test]
    fn list_of_scenario_replaces_built_in_list() {
        let text = "task = \"idle\"\ncamera = []\nvsp = []\n\
                    [[effector]]\nname = \"track\"\nstart_d0_mm = 100\n";

        let scenario = read(Path::new("t.toml"), text, &[]).unwrap();

        assert_eq!(scenario.controller.cell.arms.len(), 1);
        assert!(scenario.controller.cell.arms[0].model.has_track);
        assert!(scenario.controller.vsps.is_empty());
    }

    #[test]
    fn cameras_and_sensors_of_absent_effector_are_dropped() {
        let text = "task = \"idle\"\n[[effector]]\nname = \"postument\"\n";

        let scenario = read(Path::new("t.toml"), text, &[]).unwrap();

        let cameras: Vec<&str> =
            scenario.controller.cell.cameras.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(cameras, ["standalone", "postument_hand"]);
        let vsps: Vec<&str> = scenario.controller.vsps.iter().map(|v| v.name.as_str()).collect();
        assert_eq!(vsps, ["gs2", "mpf"]);
    }

    /// A file with very many faults is refused at once: the message names only the first faults,
    /// since the search for the line of each takes time.
    #[test]
    fn file_with_thousands_of_faults_gives_short_message() {
        let cameras = "[[camera]]\n".repeat(50_000);
        let message = faults(&format!("task = \"idle\"\n{cameras}"), &[]);
        assert!(message.contains("`camera` has 50000 elements, more than 100"), "{message}");

        let unknown = (0..50_000).map(|i| format!("k{i} = 1")).collect::<Vec<_>>().join("\n");
        for text in ["x = ]\n".repeat(100_000), "= 1\n".repeat(100_000), unknown] {
            let message = faults(&text, &[]);
            assert!(message.contains(" more: is this a scenario?"), "{}", &message[..1000]);
            assert!(message.lines().count() < 50);
        }
        let long = faults(&format!("{} = 1\n", "k".repeat(900_000)), &[]);
        assert!(long.contains("unknown key"));
    }
}
