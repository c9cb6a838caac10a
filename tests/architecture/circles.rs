//! Finder of circles between files, which are files whose paths in the code lead to each other.
//!
//! - in: the files of the crate, by path and text
//! - out: an arrow for each path that leads to an item of another file; the groups of files in
//!   which every file leads to every other one
//!
//! A re-export is no arrow of its own: a path through it leads to the file that declares the item.
//! So a parent that only declares and re-exports its children is in no circle with them.

use crate::source::{File, expand, tokens, without_comments_and_strings, without_tests};
use std::collections::{BTreeMap, BTreeSet};

type Path = Vec<String>;

/// Arrows between files: file -> files that its code names.
pub(crate) type Arrows = BTreeMap<String, BTreeSet<String>>;

/// Names of a file: those that it declares, and those that stand for an item of another file.
#[derive(Default)]
struct Module {
    file: String,
    tokens: Vec<String>,
    /// Items and child modules that it declares.
    declared: BTreeSet<String>,
    /// Names that `use` brings in, with their paths from the crate's root.
    imported: BTreeMap<String, Path>,
    /// Modules of which `use` brings in everything.
    globs: Vec<Path>,
    /// Paths of a `use` whose name the code beside it does not mention: re-exports.
    passed_on: BTreeSet<Path>,
}

/// Returns the groups of files that depend on each other: in a group each file depends, directly or
/// through others, on every other one. Groups and files are in alphabetical order.
pub(crate) fn circles(files: &[File]) -> Vec<Vec<String>> {
    let arrows = arrows(files);
    let reached: BTreeMap<&String, BTreeSet<String>> =
        arrows.keys().map(|file| (file, reach(file, &arrows))).collect();
    let mut found = BTreeSet::new();
    for (file, there) in &reached {
        let back = |other: &&String| reached.get(other).is_some_and(|r| r.contains(*file));
        let circle: Vec<String> = there.iter().filter(back).cloned().collect();
        if circle.len() > 1 {
            found.insert(circle);
        }
    }
    found.into_iter().collect()
}

/// Returns every file on which the file `from` depends, directly or through other files.
fn reach(from: &str, arrows: &Arrows) -> BTreeSet<String> {
    let (mut seen, mut next) = (BTreeSet::new(), vec![from.to_owned()]);
    while let Some(file) = next.pop() {
        for other in arrows.get(&file).into_iter().flatten() {
            if seen.insert(other.clone()) {
                next.push(other.clone());
            }
        }
    }
    seen
}

/// Returns, for each file, the files that its code names. Leaves out the files of tests.
pub(crate) fn arrows(files: &[File]) -> Arrows {
    let modules = modules(files);
    let mut arrows = Arrows::new();
    for (here, module) in &modules {
        let leads_to = arrows.entry(module.file.clone()).or_default();
        for path in mentions(here, module) {
            let target = resolve(&path, &modules, 0);
            leads_to.extend(target.filter(|file| *file != module.file));
        }
    }
    arrows
}

/// Reads the names that each file declares and uses, by the path of its module. Leaves out the
/// files that a parent declares only for tests.
fn modules(files: &[File]) -> BTreeMap<Path, Module> {
    let mut modules = BTreeMap::new();
    let mut tests = BTreeSet::new();
    for (file, text) in files {
        let here = module_path(file);
        let bare = without_comments_and_strings(text);
        tests.extend(test_modules(&bare).into_iter().map(|name| child(&here, &name)));
        modules.insert(here.clone(), read(&here, file, &without_tests(&bare)));
    }
    modules.retain(|path, _| !tests.iter().any(|test| path.starts_with(test)));
    modules
}

/// Returns the path of a file's module: `a/b.rs` and `a/b/mod.rs` are `a::b`.
fn module_path(file: &str) -> Path {
    let name = file.trim_end_matches(".rs").trim_end_matches("/mod");
    let path = name.split('/').map(str::to_owned).collect();
    if matches!(name, "lib" | "main" | "mod") { Vec::new() } else { path }
}

/// Returns the path of the child module `name` of the module `here`.
fn child(here: &[String], name: &str) -> Path {
    here.iter().cloned().chain([name.to_owned()]).collect()
}

/// Returns the names of the child modules that a file declares as `#[cfg(test)] mod NAME;`.
fn test_modules(code: &str) -> Vec<String> {
    let behind = code.split("#[cfg(test)]").skip(1);
    let item = behind.filter_map(|rest| rest.split_once(';').map(|(item, _)| tokens(item)));
    item.filter(|t| !t.iter().any(|t| t == "{"))
        .filter_map(|t| t.iter().position(|t| t == "mod").and_then(|at| t.get(at + 1).cloned()))
        .collect()
}

/// Rewrites the tokens of a file as if it had no inline modules. A path in an inline module becomes
/// the path that the file itself would write: in `mod a { use super::B; }` the name `super` stands
/// for the file.
fn flat(all: &[String]) -> Vec<String> {
    let mut flat: Vec<String> = Vec::new();
    // Depths of braces at which the inline modules begin.
    let (mut inline, mut depth) = (Vec::new(), 0);
    let mut i = 0;
    while i < all.len() {
        match all[i].as_str() {
            "{" => {
                if i > 1 && all[i - 2] == "mod" {
                    inline.push(depth);
                }
                depth += 1;
            }
            "}" => {
                depth -= 1;
                inline.pop_if(|began| *began == depth);
            }
            // The path of `pub(in path)` is no arrow.
            "in" if i > 0 && all[i - 1] == "(" => {
                i += all[i..].iter().position(|t| t == ")").unwrap_or(0);
                continue;
            }
            "super" if all.get(i + 1).is_some_and(|next| next == "::") => {
                let run = all[i..].chunks(2).take_while(|pair| *pair == ["super", "::"]).count();
                let beyond = run.saturating_sub(inline.len());
                let word = if beyond == 0 { "self" } else { "super" };
                for _ in 0..beyond.max(1) {
                    flat.extend([word.to_owned(), "::".to_owned()]);
                }
                i += 2 * run;
                continue;
            }
            _ => {}
        }
        flat.push(all[i].clone());
        i += 1;
    }
    flat
}

/// Reads the names that a file declares, imports and re-exports. `here` is the path of its module,
/// `code` its text without comments, strings and tests.
fn read(here: &[String], file: &str, code: &str) -> Module {
    let mut module =
        Module { file: file.to_owned(), tokens: flat(&tokens(code)), ..Module::default() };
    let all = module.tokens.clone();
    let (mut uses, mut names) = (Vec::new(), Vec::new());
    let mut outside: BTreeMap<&str, usize> = BTreeMap::new();
    let mut i = 0;
    while i < all.len() {
        let next = all.get(i + 1).cloned().unwrap_or_default();
        match all[i].as_str() {
            "use" => {
                let public = i > 0 && matches!(all[i - 1].as_str(), "pub" | ")");
                i += 1;
                let mut paths = Vec::new();
                let end = i + all[i..].iter().position(|t| t == ";").unwrap_or(0);
                expand(&all[i..end], &mut 0, &mut Vec::new(), &mut paths);
                let renamed = all[i..end].windows(3).filter(|w| w[1] == "as");
                for (old, new) in renamed.map(|w| (&w[0], &w[2])) {
                    let of = paths.iter().find(|path| path.last() == Some(old));
                    names.extend(of.map(|path| (new.clone(), path.clone())));
                }
                uses.extend(paths.into_iter().map(|path| (path, public)));
                i = end;
            }
            // The name of a module does not mention an item with the same name.
            "mod" => {
                module.declared.insert(next);
                i += 2;
            }
            "fn" | "struct" | "enum" | "trait" | "type" | "const" | "static" | "union" => {
                module.declared.insert(next);
                i += 1;
            }
            word => {
                *outside.entry(word).or_default() += 1;
                i += 1;
            }
        }
    }
    for (path, public) in uses {
        let Some(path) = absolute(here, &module, &path) else { continue };
        let mut path = path;
        let Some(name) = path.last().cloned() else { continue };
        match name.as_str() {
            "*" => {
                path.pop();
                module.globs.push(path);
            }
            "self" => {
                path.pop();
                module.imported.extend(path.last().cloned().map(|name| (name, path.clone())));
            }
            _ => {
                // A name that the rest of the file mentions is an arrow of this file.
                if public && !outside.contains_key(name.as_str()) {
                    module.passed_on.insert(path.clone());
                }
                module.imported.insert(name, path);
            }
        }
    }
    for (name, path) in names {
        let path = absolute(here, &module, &path);
        module.imported.extend(path.map(|path| (name, path)));
    }
    module
}

/// Returns the path from the crate's root for a `path` that stands in the module `here`; `None` for
/// a path that leads to another crate.
fn absolute(here: &[String], module: &Module, path: &[String]) -> Option<Path> {
    let mut base = here.to_vec();
    let mut rest = path;
    match path.first()?.as_str() {
        "crate" => (base, rest) = (Vec::new(), &path[1..]),
        "self" => rest = &path[1..],
        "super" => {
            while rest.first().is_some_and(|word| word == "super") {
                base.pop();
                rest = &rest[1..];
            }
        }
        name if module.declared.contains(name) => {}
        name => {
            base.clone_from(module.imported.get(name)?);
            rest = &path[1..];
        }
    }
    Some(base.into_iter().chain(rest.iter().cloned()).collect())
}

/// Returns every path in a file's code that leads into the crate, written from the crate's root.
fn mentions(here: &[String], module: &Module) -> Vec<Path> {
    let all = &module.tokens;
    let mut found = Vec::new();
    let mut i = 0;
    while i < all.len() {
        let inside = i > 0 && matches!(all[i - 1].as_str(), "::" | ".");
        let leads = all.get(i + 1).is_some_and(|next| next == "::");
        if inside || !leads || !all[i].starts_with(|c: char| c.is_alphabetic()) {
            i += 1;
            continue;
        }
        let mut paths = Vec::new();
        expand(all, &mut i, &mut Vec::new(), &mut paths);
        found.extend(paths.iter().filter_map(|path| absolute(here, module, path)));
    }
    found.retain(|path| !module.passed_on.contains(path));
    // A path to a module alone is no arrow; the paths to its items are.
    found
}

/// Returns the file that declares the item to which `path`, from the crate's root, leads. Follows
/// re-exports, at most eight of them; `depth` counts those followed already.
fn resolve(path: &[String], modules: &BTreeMap<Path, Module>, depth: usize) -> Option<String> {
    let length = (1..=path.len()).rev().find(|&n| modules.contains_key(&path[..n]))?;
    let module = &modules[&path[..length]];
    let item = path.get(length)?;
    if depth > 8 || module.declared.contains(item) {
        return Some(module.file.clone());
    }
    let further = |start: &Path, rest: &[String]| {
        let path: Path = start.iter().chain(rest).cloned().collect();
        resolve(&path, modules, depth + 1)
    };
    if let Some(elsewhere) = module.imported.get(item) {
        return further(elsewhere, &path[length + 1..]);
    }
    let declares = |start: &&Path| {
        let there = modules.get(*start);
        there.is_some_and(|m| m.declared.contains(item) || m.imported.contains_key(item))
    };
    match module.globs.iter().find(declares) {
        Some(elsewhere) => further(elsewhere, &path[length..]),
        None => Some(module.file.clone()),
    }
}

mod finder_tests {
    use super::circles;

    /// Returns the circles in these files, each a path and a text.
    fn found(files: &[(&str, &str)]) -> Vec<Vec<String>> {
        let files = files.iter().map(|(file, text)| ((*file).to_owned(), (*text).to_owned()));
        circles(&files.collect::<Vec<_>>())
    }

    #[test]
    fn search_finds_two_files_using_each_other() {
        let parent = "mod b; pub struct A; fn f() { b::g() }";
        let child = "use super::A; pub fn g() {}";
        assert_eq!(found(&[("a/mod.rs", parent), ("a/b.rs", child)]), [["a/b.rs", "a/mod.rs"]]);
    }

    #[test]
    fn search_finds_circle_through_reexport() {
        let parent = "mod b; mod c; pub use b::B; pub use c::C;";
        let (b, c) = ("use super::C; pub struct B(C);", "use super::B; pub struct C(Vec<B>);");
        let files = [("a/mod.rs", parent), ("a/b.rs", b), ("a/c.rs", c)];
        assert_eq!(found(&files), [["a/b.rs", "a/c.rs"]]);
    }

    #[test]
    fn search_ignores_reexports_and_tests_of_parent() {
        let parent = "mod b; mod c; pub use c::C; #[cfg(test)] mod t;";
        let b = "use super::C; mod inline { use super::B; } pub struct B(C);";
        let c = "pub(in super::super) struct C; #[cfg(test)] mod tests { use super::super::b::B; }";
        let files =
            [("a/mod.rs", parent), ("a/b.rs", b), ("a/c.rs", c), ("a/t.rs", "use super::*;")];
        assert_eq!(found(&files), [[""; 0]; 0]);
    }

    #[test]
    fn search_ignores_function_named_like_its_module() {
        let parent = "mod b; pub use b::b; pub struct A;";
        let child = "use super::A; pub fn b() -> A { A }";
        assert_eq!(found(&[("a/mod.rs", parent), ("a/b.rs", child)]), [[""; 0]; 0]);
    }
}
