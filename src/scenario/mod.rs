//! Scenarios: what a run is to do, in which cell, with which controller, against which plant.
//!
//! - in: a TOML file in the workshop's units, and `KEY=VALUE` options that overrule parts of it
//! - out: a [`Scenario`] in SI, whose two halves are different types: the [`ControllerConfig`] holds what
//!   the controller may know (its belief), the [`PlantSection`] what only the simulated plant may read
//! - faults: all of them at once, each with `file:line:column`
//!
//! A key is declared in one place: see [`section`]. The built-in cell is `scenarios/cell.toml`.

pub mod fault;
pub mod injected;
pub mod keys;
pub mod lists;
pub mod plant;
pub mod section;
pub mod tree;

mod check;

use crate::cell::Cell;
use crate::cube::{Cube, Facelets};
use crate::hw::text;
use crate::servo::regulator::ServoGains;
use fault::{Faults, Source};
use injected::FaultKeys;
use keys::{
    Bridge, CellKeys, Control, Coordination, CubeKeys, FaceTurn, HandKeys, Idle, Pace, Planner,
    RealTime, Servo, Task, VisionKeys, VisualServo,
};
use lists::{CameraKeys, Effector, VspKind};
use plant::PlantKeys;
use section::{Key, Reader, Section};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use tree::{Node, Value};

/// The built-in cell, which every scenario starts from.
const CELL: &str = include_str!("../../scenarios/cell.toml");

/// Scenarios that the program brings along, by the names that stand for their paths anywhere.
const SHIPPED: [(&str, &str); 2] = [
    ("shipped:solve", include_str!("../../scenarios/solve.toml")),
    ("shipped:table", include_str!("../../scenarios/table.toml")),
];

/// A scenario that was found right.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Where it was read from, as the user wrote it.
    pub path: PathBuf,
    /// Seed of everything random in the plant.
    pub seed: u64,
    /// Which clock drives the run.
    pub pace: Pace,
    /// How the servo's thread runs under the wall clock.
    pub real_time: RealTime,
    /// What is behind the hardware port.
    pub bridge: Bridge,
    /// What the controller may know.
    pub controller: ControllerConfig,
    /// What only the simulated plant may read.
    pub plant: PlantSection,
}

impl Scenario {
    /// Periods missed in a row after which the arms are brought to a stand and stop.
    #[must_use]
    pub fn missed_limit(&self) -> u64 {
        let usual = if self.bridge.kind.is_hardware() { 20 } else { 50 };
        u64::from(self.real_time.missed_limit.unwrap_or(usual))
    }
}

/// What the controller may know: its task, its gains, and its belief of the cell.
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerConfig {
    /// What to do.
    pub task: Task,
    /// Who makes the set values.
    pub coordination: Coordination,
    /// Belief: arms, cameras, cube, table, hand-over place.
    pub cell: Cell,
    /// Per effector of `cell.arms`: what the cell's geometry does not hold.
    pub effectors: Vec<EffectorConfig>,
    /// Per camera of `cell.cameras`: where its frames come from.
    pub cameras: Vec<CameraSource>,
    /// Per camera of `cell.cameras`: views of the calibration before a simulated hand-over; 0 for none.
    pub calibrate_views: Vec<u32>,
    /// Virtual sensors.
    pub vsps: Vec<VspConfig>,
    /// Gains, speeds, limits.
    pub control: Control,
    /// Generator that follows the cube.
    pub visual_servo: VisualServo,
    /// Vision.
    pub vision: VisionKeys,
    /// Solver and regrasp planner; `rule` agrees with the grippers.
    pub planner: Planner,
    /// What `task = "face_turn"` does.
    pub face_turn: FaceTurn,
    /// What `task = "idle"` does.
    pub idle: Idle,
}

/// What an effector has beside its geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectorConfig {
    /// Whether the palm stands off the cube.
    pub palm_clearance: bool,
    /// Regulators and watch-dogs of its axes.
    pub gains: ServoGains,
}

/// Where a camera's frames come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CameraSource {
    /// The simulated plant.
    Renderer,
    /// Image files, in the order of their names.
    Folder(PathBuf),
}

/// Who gets a VSP's readings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Owner {
    /// MP.
    Mp,
    /// The ECP of the effector with this index.
    Ecp(usize),
}

/// A virtual sensor process.
#[derive(Debug, Clone, PartialEq)]
pub struct VspConfig {
    /// Name.
    pub name: String,
    /// What it makes of its sensor.
    pub kind: VspKind,
    /// Index of its camera; `None` for forces.
    pub camera: Option<usize>,
    /// Who gets its readings.
    pub owner: Owner,
    /// Time between two readings [s].
    pub period: f64,
}

impl Scenario {
    /// The cube at the beginning, which the plant starts from: the given one, or the seed's.
    #[must_use]
    pub fn cube(&self) -> Facelets {
        match &self.plant.cube_state {
            Some(facelets) => *facelets,
            None => Facelets::from(&Cube::scrambled(self.seed)),
        }
    }
}

/// What only the simulated plant may read.
#[derive(Debug, Clone, PartialEq)]
pub struct PlantSection {
    /// The cube's state, a possible one; `None` is drawn from the seed.
    pub cube_state: Option<Facelets>,
    /// Per effector: whether its controllers are synchronised when the run begins.
    pub synchronised: Vec<bool>,
    /// Keys under `plant`.
    pub keys: PlantKeys,
    /// What is made to go wrong.
    pub faults: Vec<FaultKeys>,
}

/// `KEY=VALUE` of the command line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Override {
    /// How faults name it: `--set cube.edge_mm`.
    pub option: String,
    /// Dotted key.
    pub key: String,
    /// A value of TOML; a bare word counts as a string.
    pub value: String,
}

impl Override {
    /// From the text behind `--set`.
    ///
    /// # Errors
    /// A message when there is no `=`.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (key, value) = text.split_once('=').ok_or_else(|| {
            format!("`{text}` has no `=`; write KEY=VALUE, as in control.grip_n=30")
        })?;
        let key = key.trim().to_owned();
        Ok(Self { option: format!("--set {key}"), key, value: value.trim().to_owned() })
    }

    /// An option of its own that stands for a key, as `--seed` for `seed`.
    #[must_use]
    pub fn option(option: &str, key: &str, value: &str) -> Self {
        Self { option: option.to_owned(), key: key.to_owned(), value: value.to_owned() }
    }
}

section::section! {
    /// The keys of a whole scenario, without its lists.
    Root {
        /// What to do.
        task: Task = Task::Solve;
        /// Who makes the set values of the arms.
        coordination: Coordination = Coordination::Sporadic;
        /// Seed of everything random in the plant.
        seed: u64 = 1;
        /// Which clock drives the run.
        pace: Pace = Pace::Virtual;
    } with {
        /// What is behind the hardware port.
        bridge: Bridge,
        /// The cell.
        cell: CellKeys,
        /// The cube.
        cube: CubeKeys,
        /// Hand-over place.
        hand: HandKeys,
        /// Gains, speeds, limits.
        control: Control,
        /// Following the cube.
        visual_servo: VisualServo,
        /// Vision.
        vision: VisionKeys,
        /// Solver and planner.
        planner: Planner,
        /// Turning one layer.
        face_turn: FaceTurn,
        /// An idle run.
        idle: Idle,
        /// Regulators of the axes.
        servo: Servo,
        /// The servo's thread.
        real_time: RealTime,
        /// What only the simulated plant may read.
        plant: PlantKeys,
    }
}

/// The lists of a scenario.
const LISTS: [&str; 4] = ["effector", "camera", "vsp", "fault"];

/// Keys in SI, before they are checked against each other.
#[derive(Debug, Clone, Default)]
struct Draft {
    root: Root,
    effectors: Vec<Effector>,
    cameras: Vec<CameraKeys>,
    vsps: Vec<lists::Vsp>,
    faults: Vec<(String, FaultKeys)>,
}

/// The text of a scenario: of a file, or of one that the program brings along (`shipped:solve`, `shipped:table`).
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

/// Reads a scenario's text; `path` names it in faults, and its folder is where relative paths start.
///
/// # Errors
/// All faults of the text and of the overrides.
pub fn read(path: &Path, text: &str, overrides: &[Override]) -> Result<Scenario, Faults> {
    let mut reader = Reader::default();
    let source =
        Rc::new(Source { name: path.display().to_string(), text: text.to_owned(), is_file: true });
    let mut document = tree::parse(&source, &mut reader.faults);
    if !reader.faults.0.is_empty() {
        // What stands behind a fault of syntax cannot be trusted: its faults would be noise.
        return Err(reader.faults.sorted());
    }
    let built_in = built_in(&mut reader);
    for over in overrides {
        let name = over.option.clone();
        let source = Rc::new(Source { name, text: over.value.clone(), is_file: false });
        let value = tree::parse_value(&source);
        let parts: Vec<&str> = over.key.split('.').collect();
        if let [list, element, "name"] = parts[..]
            && LISTS.contains(&list)
            && over.value.trim_matches('"') != element
        {
            // What hangs on the old name, and the built-in values that come with it, would be lost silently.
            let reason = format!("`{}`: an option cannot rename an element", over.key);
            reader.faults.add(Some(&value.place), reason);
            continue;
        }
        adopt_list(&mut document, &built_in, &over.key);
        tree::set(&mut document, &over.key, value, &mut reader.faults);
    }

    let draft = draft(&document, &built_in, &mut reader);
    let scenario = check::scenario(path, draft, &mut reader);
    match scenario {
        Some(scenario) if reader.faults.0.is_empty() => Ok(scenario),
        _ => Err(reader.faults.sorted()),
    }
}

/// Every key with its default.
#[must_use]
pub fn all_keys() -> Vec<Key> {
    let mut reader = Reader::default();
    let built_in = built_in(&mut reader);
    let draft = draft(&built_in, &built_in, &mut reader);
    let mut keys = Vec::new();
    draft.root.keys("", &mut keys);
    for effector in &draft.effectors {
        effector.keys(&format!("effector.{}", effector.name), &mut keys);
    }
    for camera in &draft.cameras {
        camera.keys(&format!("camera.{}", camera.name), &mut keys);
    }
    for vsp in &draft.vsps {
        vsp.keys(&format!("vsp.{}", vsp.name), &mut keys);
    }
    FaultKeys { name: "NAME".to_owned(), ..FaultKeys::default() }.keys("fault.NAME", &mut keys);
    keys
}

/// The tree of the built-in cell.
fn built_in(reader: &mut Reader) -> Node {
    let source = Rc::new(Source {
        name: "the built-in cell.toml".to_owned(),
        text: CELL.to_owned(),
        is_file: true,
    });
    tree::parse(&source, &mut reader.faults)
}

/// Makes an override reach into a list that the scenario does not have itself: it gets the names of the
/// built-in elements, whose values they start from.
fn adopt_list(document: &mut Node, built_in: &Node, key: &str) {
    let list = key.split('.').next().unwrap_or_default();
    if !LISTS.contains(&list) || document.get(list).is_some() {
        return;
    }
    let (Some(from), Value::Table(entries)) = (built_in.get(list), &mut document.value) else {
        return;
    };
    let mut node = from.clone();
    if let Value::Array(items) = &mut node.value {
        for item in items {
            if let Value::Table(entries) = &mut item.value {
                entries.retain(|e| e.key == "name");
            }
        }
    }
    let key_place = node.place.clone();
    entries.push(tree::Entry { key: list.to_owned(), key_place, node });
}

/// Reads the keys of the built-in cell and of a document over them.
fn draft(document: &Node, built_in: &Node, reader: &mut Reader) -> Draft {
    let mut draft = Draft::default();
    let mut silent = Reader::default();
    let (cell_root, _) = split(built_in, &mut silent);
    draft.root.overlay(&cell_root, "", &mut silent);
    let (root, lists) = split(document, reader);
    draft.root.overlay(&root, "", reader);
    draft.effectors = list("effector", lists[0].as_ref(), built_in, reader, |e: &Effector| &e.name);
    draft.cameras = list("camera", lists[1].as_ref(), built_in, reader, |c: &CameraKeys| &c.name);
    draft.vsps = list("vsp", lists[2].as_ref(), built_in, reader, |v: &lists::Vsp| &v.name);
    if let Some(node) = lists[3].as_ref() {
        let faults = elements("fault", Some(node), reader, |_| FaultKeys::default());
        let path = |(i, fault): (usize, &FaultKeys)| {
            let name = if fault.name.is_empty() { i.to_string() } else { fault.name.clone() };
            format!("fault.{name}")
        };
        let paths: Vec<String> = faults.iter().enumerate().map(path).collect();
        draft.faults = paths.into_iter().zip(faults).collect();
    }
    // A scenario that leaves an effector or a camera out need not leave out what hangs on it.
    if lists[1].is_none() {
        let names: Vec<&String> = draft.effectors.iter().map(|e| &e.name).collect();
        draft.cameras.retain(|c| c.effector.as_ref().is_none_or(|e| names.contains(&e)));
    }
    if lists[2].is_none() {
        let owners: Vec<&String> = draft.effectors.iter().map(|e| &e.name).collect();
        let cameras: Vec<&String> = draft.cameras.iter().map(|c| &c.name).collect();
        draft.vsps.retain(|v| {
            (v.owner == "mp" || owners.contains(&&v.owner))
                && v.camera.as_ref().is_none_or(|c| cameras.contains(&c))
        });
    }
    // The built-in cell's own faults are ours.
    reader.faults.0.extend(silent.faults.0);
    draft
}

/// Takes the lists out of a document.
fn split(document: &Node, reader: &mut Reader) -> (Node, [Option<Node>; 4]) {
    let mut rest = document.clone();
    let mut found = [const { None }; 4];
    if let Value::Table(entries) = &mut rest.value {
        for (slot, name) in found.iter_mut().zip(LISTS) {
            if let Some(at) = entries.iter().position(|e| e.key == name) {
                *slot = Some(entries.remove(at).node);
            }
        }
        // `[effectors]` and the like: the section macro does not know the lists' names.
        entries.retain(|e| match fault::nearest(&e.key, &LISTS) {
            Some(word) if !matches!(e.key.as_str(), "cell") => {
                let reason = format!("unknown key `{}`", e.key);
                let help = format!("did you mean [[{word}]]?");
                reader.faults.add_with_help(Some(&e.key_place), reason, help);
                false
            }
            _ => true,
        });
    }
    (rest, found)
}

/// Reads one list; each element starts from the built-in element of its name.
fn list<T: Section + Clone>(
    name: &str,
    given: Option<&Node>,
    built_in: &Node,
    reader: &mut Reader,
    name_of: impl Fn(&T) -> &String,
) -> Vec<T> {
    let mut silent = Reader::default();
    let default = elements(name, built_in.get(name), &mut silent, |_| T::default());
    match given {
        None => default,
        Some(node) => elements(name, Some(node), reader, |wanted| {
            let known = default.iter().find(|t| Some(name_of(t)) == wanted.as_ref());
            known.cloned().unwrap_or_default()
        }),
    }
}

fn elements<T: Section>(
    name: &str,
    node: Option<&Node>,
    reader: &mut Reader,
    start: impl Fn(Option<String>) -> T,
) -> Vec<T> {
    let Some(node) = node else { return Vec::new() };
    let Value::Array(items) = &node.value else {
        let reason = format!("`{name}` is a list, not {}", node.describe());
        reader.faults.add_with_help(Some(&node.place), reason, format!("write [[{name}]]"));
        return Vec::new();
    };
    let mut all = Vec::new();
    for (index, item) in items.iter().enumerate() {
        let own = tree::name_of(item);
        let path = format!("{name}.{}", own.clone().unwrap_or_else(|| index.to_string()));
        reader.places.insert(path.clone(), item.place.clone());
        let mut element = start(own);
        element.overlay(item, &path, reader);
        all.push(element);
    }
    all
}
