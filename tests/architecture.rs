//! Tests of the layers in `src/`: no `use` depends on a higher layer, no modules or files form a
//! circle, and pure code names nothing impure.
//!
//! The layers are those of the table in `src/lib.rs`. The member crates are folders of `src/` and
//! are read as modules of one crate. The checks leave out comments, strings and `#[cfg(test)]`
//! items, because tests may use everything.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

#[path = "architecture/circles.rs"]
mod circles;
mod ratchet;
mod source;

use source::{File, as_one_crate, expand, tokens, without_comments_and_strings, without_tests};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Modules from the top down. A module may use those of lower layers, and those of its own layer
/// without a cycle.
///
/// `scenario` is below `run` and `actors`, which take their configuration from it as data.
const LAYERS: &[&[&str]] = &[
    &["app"],
    &["cli"],
    &["campaign"],
    &["run"],
    &["tasks"],
    &["registry"],
    &["actors", "web", "tui", "ros"],
    &["record", "scenario", "tables", "desk"],
    &["hw", "net"],
    &["emergency_stop"],
    &["kernel"],
    &["generators", "vision", "solver", "reach", "servo"],
    &["cell", "kinematics", "arms", "motion", "cube", "spatial", "operator", "error"],
];

/// Module of the first pure layer: from it down there are no threads, clocks, files or logs.
const LINE: &str = "kernel";

/// Module above the line that is pure all the same, except for the files in [`OUTSIDE`]: the
/// kernels of the tasks.
const KERNELS: &str = "tasks";

/// Ends of the names of files that belong to no kernel: they know scenarios, the cell and files, or
/// judge the plant.
const OUTSIDE: &[&str] = &["tasks/mod.rs", "door.rs", "keys.rs", "verdict.rs"];

/// Paths that pure code must not name.
const IMPURE: &[&str] = &[
    "tokio",
    "tracing",
    "std::thread",
    "std::time",
    "std::fs",
    "std::io",
    "std::net",
    "std::process",
    "std::env",
    // Randomness is an argument: a generator with a seed, never that of the system.
    "rand::rng",
    "rand::random",
    "rand::thread_rng",
];

/// The only file of the shells that may pass on the plant's half of a scenario.
const MAY_NAME_THE_PLANT: &[&str] = &["run/simulation.rs"];

/// The only files above `hw`, beside the verdicts of tasks, that may use the plant: they make it,
/// judge by it, draw it, or describe it to other programs.
const MAY_USE_THE_PLANT: &[&str] = &[
    "run/simulation.rs",
    "run/options.rs",
    "run/outcome.rs",
    "run/plan.rs",
    "run/calibrate.rs",
    "run/composition.rs",
    "run/emulate.rs",
    "run/world_file.rs",
    "run/world.rs",
    "cli/film.rs",
    "record/urdf/physics.rs",
    "cli/picture.rs",
    "cli/frames.rs",
    "registry/verdict.rs",
    "registry/entry.rs",
];

#[test]
fn no_module_uses_higher_layer_or_forbidden_path() {
    let files = as_one_crate(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"));
    assert!(files.len() > 20, "only {} files were found", files.len());

    let found = violations(&files);

    assert!(found.is_empty(), "\n{}\n", found.join("\n"));
}

/// Files that depend on each other in a circle cannot be read one after the other, so the number of
/// files in circles may only fall. `CIRCLES_OF=FOLDER` counts the circles of another source tree
/// and checks nothing.
#[test]
fn dependency_circles_do_not_grow() {
    let other = std::env::var_os("CIRCLES_OF");
    let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let files = as_one_crate(other.as_ref().map_or(&here, Path::new));

    let circles = circles::circles(&files);

    for circle in &circles {
        println!("{} files depend on each other: {}", circle.len(), circle.join(", "));
    }
    let count = circles.iter().map(Vec::len).sum();
    println!("circles: {}, files in them: {count}", circles.len());
    if other.is_none() {
        ratchet::holds("files in circles", count);
    }
}

/// Returns the number of a module's layer, from the top; `None` for a module in no layer.
fn layer(module: &str) -> Option<usize> {
    LAYERS.iter().position(|l| l.contains(&module))
}

/// Returns all violations of the rules for layers, purity and the plant, as `file: reason`.
fn violations(files: &[File]) -> Vec<String> {
    let mut found = Vec::new();
    let mut arrows: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (file, text) in files {
        if matches!(file.as_str(), "lib.rs" | "main.rs") {
            continue;
        }
        let code = without_tests(&without_comments_and_strings(text));
        let module = file.split(['/', '.']).next().unwrap();
        let Some(from) = layer(module) else {
            found.push(format!("{file}: module `{module}` is in no layer"));
            continue;
        };
        for path in paths(&code, file) {
            let wrong = match path.first().map(String::as_str) {
                Some("crate") => plant_arrow(file, module, &path)
                    .or_else(|| kernel_arrow(file, &path))
                    .or_else(|| geometry_arrow(file, module, &path))
                    .or_else(|| crate_arrow(module, from, &path, &mut arrows)),
                _ => foreign(file, module, from, &path),
            };
            found.extend(wrong.map(|reason| format!("{file}: {reason}")));
        }
        let secret = ["PlantSection", "PlantKeys", ".plant"].iter().find(|s| names(&code, s));
        if let (Some(secret), "run" | "actors" | "record") = (secret, module)
            && !MAY_NAME_THE_PLANT.contains(&file.as_str())
        {
            found.push(format!("{file}: names `{secret}`, which only the plant may read"));
        }
    }
    for cycle in cycles(&arrows) {
        found.push(format!("cycle of modules: {cycle}"));
    }
    found.sort();
    found.dedup();
    found
}

/// Checks whether `path`, which the code of `file` names, leads into the simulated plant. Returns
/// the reason if the file must not use the plant.
fn plant_arrow(file: &str, module: &str, path: &[String]) -> Option<String> {
    let plant = path.iter().skip(1).take(2).eq(["hw", "plant"]);
    let judges = module == KERNELS && file.ends_with("/verdict.rs");
    let allowed =
        judges || matches!(module, "hw" | "scenario") || MAY_USE_THE_PLANT.contains(&file);
    (plant && !allowed)
        .then(|| format!("`{}`: only for code that makes or judges the plant", path.join("::")))
}

/// Checks whether `path`, which `file` names, leads to geometry that a kernel or a generator must
/// get as data; returns the reason if it does.
fn geometry_arrow(file: &str, module: &str, path: &[String]) -> Option<String> {
    if !(module == "generators" || is_kernel(file)) {
        return None;
    }
    let (target, shown) = (path.get(1)?, path.join("::"));
    if matches!(target.as_str(), "kinematics" | "arms" | "cell") {
        return Some(format!("`{shown}`: `{module}` takes geometry as data, not from `{target}`"));
    }
    let computes = target == "reach"
        && !path.get(2).map_or("", String::as_str).starts_with(char::is_uppercase);
    computes.then(|| format!("`{shown}`: `{module}` may take the types of reach, not compute it"))
}

/// Returns whether a file belongs to the kernel of a task.
fn is_kernel(file: &str) -> bool {
    file.starts_with(&format!("{KERNELS}/")) && !OUTSIDE.iter().any(|end| file.ends_with(end))
}

/// Checks a `path` into this crate that the kernel of a task names; returns the reason if the
/// kernel must not use it.
fn kernel_arrow(file: &str, path: &[String]) -> Option<String> {
    let target = path.get(1)?;
    let above = layer(target)? < layer(LINE).unwrap() && target != KERNELS;
    (is_kernel(file) && above).then(|| format!("`{}`: a kernel is below the line", path.join("::")))
}

/// Adds the dependency of `module` on the module to which `path` leads to `arrows`; returns the
/// reason if a rule forbids it. `from` is the layer of `module`, counted from the top.
fn crate_arrow(
    module: &str,
    from: usize,
    path: &[String],
    arrows: &mut BTreeMap<String, BTreeSet<String>>,
) -> Option<String> {
    let target = path.get(1)?;
    let shown = path.join("::");
    if target == module {
        return None;
    }
    let Some(to) = layer(target) else {
        return Some(format!("`{shown}` is in no layer"));
    };
    arrows.entry(module.to_owned()).or_default().insert(target.clone());
    if to < from {
        return Some(format!("`{shown}` points up from `{module}`"));
    }
    None
}

/// Checks a `path` into the standard library or another crate; returns the reason if a rule forbids
/// it in this file of `module`. `from` is the layer of `module`, counted from the top.
fn foreign(file: &str, module: &str, from: usize, path: &[String]) -> Option<String> {
    let shown = path.join("::");
    if path[0] == "anyhow" && module != "cli" {
        return Some(format!("`{shown}`: anyhow is for main and cli"));
    }
    let pure = from >= layer(LINE).unwrap() || is_kernel(file);
    let impure = IMPURE.iter().any(|i| shown == **i || shown.starts_with(&format!("{i}::")));
    (pure && impure).then(|| format!("`{shown}` below the line"))
}

/// Returns whether `word` occurs in the code, other than as the beginning of a longer name or as
/// the name of a called function.
fn names(code: &str, word: &str) -> bool {
    code.match_indices(word).any(|(at, _)| {
        let after = code[at + word.len()..].chars().next();
        !after.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == '(')
    })
}

/// Returns the cycles of dependencies between modules, each once, as `a -> b -> a`.
fn cycles(arrows: &BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    fn walk(
        at: &str,
        trail: &mut Vec<String>,
        arrows: &BTreeMap<String, BTreeSet<String>>,
        found: &mut BTreeSet<String>,
    ) {
        if let Some(start) = trail.iter().position(|m| m == at) {
            let mut ring = trail[start..].to_vec();
            let least = ring.iter().enumerate().min_by_key(|(_, m)| (*m).clone()).unwrap().0;
            ring.rotate_left(least);
            ring.push(ring[0].clone());
            found.insert(ring.join(" -> "));
            return;
        }
        trail.push(at.to_owned());
        for next in arrows.get(at).into_iter().flatten() {
            walk(next, trail, arrows, found);
        }
        trail.pop();
    }
    let mut found = BTreeSet::new();
    for module in arrows.keys() {
        walk(module, &mut Vec::new(), arrows, &mut found);
    }
    found.into_iter().collect()
}

/// Returns all paths in the code of `file` that leave its module: those that begin with `crate`,
/// with enough `super`, or with the name of another crate.
fn paths(code: &str, file: &str) -> Vec<Vec<String>> {
    let tokens = tokens(code);
    let depth = file.trim_end_matches("/mod.rs").split('/').count();
    let mut found = Vec::new();
    let mut i = 0;
    while i < tokens.len() {
        let inside = i > 0 && matches!(tokens[i - 1].as_str(), "::" | ".");
        let next = tokens.get(i + 1).map(String::as_str);
        match tokens[i].as_str() {
            "crate" | "std" | "core" | "tokio" | "tracing" | "anyhow" | "rand"
                if !inside && next == Some("::") =>
            {
                expand(&tokens, &mut i, &mut Vec::new(), &mut found);
            }
            // `use tokio;`, `use {std, tracing as t};` and macros by bare name.
            "tokio" | "tracing" | "anyhow" if !inside => {
                found.push(vec![tokens[i].clone()]);
                i += 1;
            }
            "println" | "eprintln" | "print" | "eprint" | "dbg" if next == Some("!") => {
                found.push(vec!["std".into(), "io".into(), format!("{}!", tokens[i])]);
                i += 1;
            }
            "super" if !inside => {
                let mut up = 0;
                while tokens.get(i).is_some_and(|t| t == "super") {
                    up += 1;
                    i += 2;
                }
                if up >= depth {
                    expand(&tokens, &mut i, &mut vec!["crate".into()], &mut found);
                }
            }
            _ => i += 1,
        }
    }
    found
}

#[cfg(test)]
mod checker_tests {
    use super::*;

    /// Returns the violations in a crate of one file with this text, one a line.
    fn one(file: &str, text: &str) -> String {
        violations(&[(file.to_owned(), text.to_owned())]).join("\n")
    }

    #[test]
    fn upward_dependency_is_reported() {
        assert!(one("servo/mod.rs", "use crate::hw::port::Port;").contains("points up"));
        assert!(one("hw/port.rs", "fn f() { crate::actors::run() }").contains("points up"));
        assert!(one("cube/mod.rs", "use crate::{spatial::Pose, cli};").contains("`crate::cli`"));
        assert!(one("hw/sim/a.rs", "use super::super::super::cli::main;").contains("crate::cli"));
        assert!(one("motion.rs", "use super::hw;").contains("crate::hw"));
    }

    #[test]
    fn comments_strings_tests_and_downward_dependencies_are_accepted() {
        let text = "use crate::{spatial::{Pose, Wrench}, motion};\nuse super::io;\n\
                    // use crate::cli;\nconst A: &str = \"crate::hw\"; const B: char = '{';\n\
                    fn f<'a>(x: &'a str) {}\n#[cfg(test)]\nmod tests { use crate::cli; }\n";
        assert_eq!(one("servo/law.rs", text), "");
        assert_eq!(one("scenario/mod.rs", "use std::fs;"), "");
        assert_eq!(one("tasks/cube/plan.rs", "use crate::reach::{Meeting, MeetingTable};"), "");
    }

    #[test]
    fn upward_dependency_of_member_crate_is_reported() {
        let member = |file, text| source::from_root((String::from(file), String::from(text)));
        let judged = |(file, text): (String, String)| one(&file, &text);
        let up = member("vocabulary/cube/mod.rs", "use rubik_robot_solver::Tables;");
        assert!(judged(up).contains("`crate::solver::Tables` points up"));
        for text in ["use crate::cube::Cube;", "use crate::tables::Tables;"] {
            assert_eq!(judged(member("solver/search.rs", text)), "", "{text}");
        }
        let vocabulary = "use rubik_robot_vocabulary::{cell::Cell, cube};";
        assert_eq!(judged(member("vision/lib.rs", vocabulary)), "");
    }

    #[test]
    fn cycle_within_a_layer_is_reported() {
        let files = [
            ("vision/mod.rs".to_owned(), "use crate::solver::A;".to_owned()),
            ("solver/mod.rs".to_owned(), "use crate::vision::B;".to_owned()),
        ];
        assert!(violations(&files).join("\n").contains("solver -> vision -> solver"));
    }

    #[test]
    fn impure_code_in_a_pure_module_is_reported() {
        for text in [
            "use tokio::sync::mpsc;",
            "use std::{fmt, thread};",
            "fn f() { std::time::Instant::now(); }",
            "use std::fs::File;",
            "use std::io::{self, Read};",
            "use std::net::TcpStream;",
            "fn f() { tracing::info!(\"x\"); }",
            "fn f() { println!(\"x\"); }",
            "fn f() { let x: f64 = rand::random(); }",
        ] {
            for file in ["tasks/cube/mod.rs", "servo/mod.rs", "cell.rs"] {
                assert!(one(file, text).contains("below the line"), "{file}: {text}");
            }
            assert_eq!(one("hw/port.rs", text), "", "{text}");
        }
    }

    #[test]
    fn geometry_import_in_tasks_or_generators_is_reported() {
        for module in ["tasks/a/mod.rs", "generators/turn.rs"] {
            for text in [
                "use crate::hw::camera::Frame;",
                "use crate::kinematics::ArmModel;",
                "use crate::cell::Cell;",
                "use crate::reach::search::search;",
                "use crate::reach::meetings;",
            ] {
                assert_ne!(one(module, text), "", "{module}: {text}");
            }
        }
    }

    #[test]
    fn use_of_plant_by_controller_is_reported() {
        let text = "fn f(s: &Scenario) -> f64 { s.plant.keys.grasp_error }";
        assert!(one("actors/mp/mod.rs", text).contains("only the plant may read"));
        assert!(
            one("actors/ecp.rs", "use crate::scenario::PlantSection;").contains("only the plant")
        );
        for text in ["use crate::hw::plant::{Plant, Verdict};", "use crate::{hw::plant, cube};"] {
            assert!(one("actors/mp/mod.rs", text).contains("makes or judges"), "{text}");
            assert_eq!(one("run/world.rs", text), "");
        }
    }

    #[test]
    fn stray_anyhow_and_unlayered_modules_are_reported() {
        assert!(one("hw/port.rs", "fn f() -> anyhow::Result<()> {}").contains("anyhow"));
        assert!(one("misc/mod.rs", "").contains("no layer"));
    }
}
