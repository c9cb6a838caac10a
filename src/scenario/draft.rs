//! The draft of a scenario: its keys in SI, over those of the built-in cell, before the keys are
//! checked against each other.

use super::catalogue::Catalogue;
use super::declared::TaskSections;
use super::fault::{Source, nearest};
use super::injected::FaultKeys;
use super::lists::{CameraKeys, Effector, LISTS, Vsp};
use super::node_keys::NodeKeys;
use super::objects::{LeadKeys, ObjectKeys, ObjectLists, ProbeKeys};
use super::order_keys::OrderKeys;
use super::root::Root;
use super::section::{Key, Reader, Section};
use super::tree::{self, Node, Value};
use std::rc::Rc;

/// Built-in cell, from which every scenario starts.
const CELL: &str = include_str!("../../scenarios/cell.toml");

/// Most elements of a list: a cell has two arms and a few cameras.
const MOST_ELEMENTS: usize = 100;

/// Keys in SI, before they are checked against each other.
#[derive(Debug, Clone, Default)]
pub(super) struct Draft {
    pub(super) root: Root,
    pub(super) effectors: Vec<Effector>,
    pub(super) cameras: Vec<CameraKeys>,
    pub(super) vsps: Vec<Vsp>,
    /// Keys of the tasks.
    pub(super) sections: TaskSections,
    /// Injected faults, each with its dotted name.
    pub(super) faults: Vec<(String, FaultKeys)>,
    /// Objects of the simulated cell.
    pub(super) objects: ObjectLists,
    /// Nodes beside that of MP, each with its dotted name.
    pub(super) nodes: Vec<(String, NodeKeys)>,
    /// Orders of parameters, each with its dotted name.
    pub(super) orders: Vec<(String, OrderKeys)>,
}

impl Draft {
    /// Returns every key, with its value in this draft as its default.
    pub(super) fn keys(&self) -> Vec<Key> {
        let mut keys = Vec::new();
        self.root.keys("", &mut keys);
        keys.extend(self.sections.listed());
        for effector in &self.effectors {
            effector.keys(&effector.path(), &mut keys);
        }
        for camera in &self.cameras {
            camera.keys(&camera.path(), &mut keys);
        }
        for vsp in &self.vsps {
            vsp.keys(&vsp.path(), &mut keys);
        }
        // The list of faults is empty by default, so one element represents its keys.
        FaultKeys { name: "NAME".to_owned(), ..FaultKeys::default() }.keys("fault.NAME", &mut keys);
        object_keys(&mut keys);
        single_keys(&mut keys);
        keys
    }
}

/// Appends the keys of the lists of objects, whose only element is called `NAME`: by default they
/// are empty.
fn object_keys(into: &mut Vec<Key>) {
    let name = || "NAME".to_owned();
    ObjectKeys { name: name(), ..ObjectKeys::default() }.keys("object.NAME", into);
    ProbeKeys { name: name(), ..ProbeKeys::default() }.keys("probe.NAME", into);
    LeadKeys { name: name(), ..LeadKeys::default() }.keys("lead.NAME", into);
}

/// Appends the keys of a node and of an order, which are called `NAME`: by default there are none.
fn single_keys(into: &mut Vec<Key>) {
    NodeKeys { name: "NAME".to_owned(), ..NodeKeys::default() }.keys("node.NAME", into);
    OrderKeys { name: "NAME".to_owned(), ..OrderKeys::default() }.keys("order.NAME", into);
}

/// Returns the dotted names of all keys, those of the tasks in `catalogue` too; an element of a
/// list is called `NAME`.
pub(super) fn names(catalogue: &Catalogue) -> Vec<String> {
    let mut keys = catalogue.sections().listed();
    Root::default().keys("", &mut keys);
    Effector::default().keys("effector.NAME", &mut keys);
    CameraKeys::default().keys("camera.NAME", &mut keys);
    Vsp::default().keys("vsp.NAME", &mut keys);
    FaultKeys::default().keys("fault.NAME", &mut keys);
    object_keys(&mut keys);
    single_keys(&mut keys);
    keys.into_iter().map(|key| key.path).collect()
}

/// Parses the TOML text of the built-in cell, from which every scenario starts.
pub(super) fn built_in(reader: &mut Reader) -> Node {
    let source = Rc::new(Source {
        name: "the built-in cell.toml".to_owned(),
        text: CELL.to_owned(),
        is_file: true,
    });
    tree::parse(&source, &mut reader.faults)
}

/// Reads the keys of a document. A key that the document does not set has the value of its profile,
/// or else that of the built-in cell.
pub(super) fn draft(
    document: &Node,
    built_in: &Node,
    catalogue: &Catalogue,
    reader: &mut Reader,
) -> Draft {
    let mut draft = Draft { sections: catalogue.sections(), ..Draft::default() };
    let mut silent = Reader::default();
    // Each later overlay overrides the earlier ones: first the cell, then the profile, then the
    // document.
    let (mut cell_root, _) = split(built_in, &mut silent);
    overlay_sections(&mut draft.sections, &mut cell_root, &mut silent);
    draft.root.overlay(&cell_root, "", &mut silent);
    let (mut root, lists) = split(document, reader);
    overlay_sections(&mut draft.sections, &mut root, reader);
    if let Some(profile) = profile(&draft.root, &root, &mut silent) {
        draft.root.overlay(&profile, "", &mut silent);
    }
    draft.root.overlay(&root, "", reader);
    // The order is that of `LISTS`.
    draft.effectors = list("effector", lists[0].as_ref(), built_in, reader, |e: &Effector| &e.name);
    draft.cameras = list("camera", lists[1].as_ref(), built_in, reader, |c: &CameraKeys| &c.name);
    draft.vsps = list("vsp", lists[2].as_ref(), built_in, reader, |v: &Vsp| &v.name);
    draft.faults = named("fault", lists[3].as_ref(), reader, |f: &FaultKeys| &f.name);
    draft.objects = ObjectLists {
        objects: named("object", lists[4].as_ref(), reader, |o: &ObjectKeys| &o.name),
        probes: named("probe", lists[5].as_ref(), reader, |p: &ProbeKeys| &p.name),
        leads: named("lead", lists[6].as_ref(), reader, |l: &LeadKeys| &l.name),
    };
    draft.nodes = named("node", lists[7].as_ref(), reader, |n: &NodeKeys| &n.name);
    draft.orders = named("order", lists[8].as_ref(), reader, |o: &OrderKeys| &o.name);
    drop_unusable(&mut draft, &lists);
    // A fault of the built-in cell is a fault of the program. It must be visible, not lost with
    // `silent`.
    reader.faults.0.extend(silent.faults.0);
    draft
}

/// Returns the keys of the profile of speeds that a document chooses, or `None` if that profile
/// changes nothing. `cell` has the keys of the built-in cell, which count where the document sets
/// none. Faults of the document are ignored here, since they are found when it is read.
fn profile(cell: &Root, document: &Node, silent: &mut Reader) -> Option<Node> {
    // The choice may depend on `bridge.kind`, so the document must be read once before its profile
    // is known.
    let mut chosen = cell.clone();
    chosen.overlay(document, "", &mut Reader::default());
    let profile = chosen.profile();
    let source = Rc::new(Source {
        name: format!("the built-in profiles/{}.toml", profile.word()),
        text: profile.text().to_owned(),
        is_file: true,
    });
    // The profile "workshop" is the defaults themselves and has no text.
    (!source.text.is_empty()).then(|| tree::parse(&source, &mut silent.faults))
}

/// Moves the sections of tasks from a document into `sections`.
fn overlay_sections(sections: &mut TaskSections, document: &mut Node, reader: &mut Reader) {
    let Value::Table(entries) = &mut document.value else { return };
    entries.retain(|entry| match sections.get_mut(&entry.key) {
        Some(keys) => {
            keys.overlay(&entry.node, &entry.key, reader);
            false
        }
        None => true,
    });
}

/// Reads a list that has no built-in elements, such as that of the injected faults. Returns each
/// element with its dotted name: `fault.NAME`.
fn named<T: Section>(
    list: &str,
    node: Option<&Node>,
    reader: &mut Reader,
    name_of: impl Fn(&T) -> &String,
) -> Vec<(String, T)> {
    let all = elements(list, node, reader, |_| T::default());
    let path = |(i, element): (usize, &T)| {
        // An element without a name has its index instead.
        let name = name_of(element);
        if name.is_empty() { format!("{list}.{i}") } else { format!("{list}.{name}") }
    };
    let paths: Vec<String> = all.iter().enumerate().map(path).collect();
    paths.into_iter().zip(all).collect()
}

/// Drops built-in cameras and sensors if the scenario lacks their effector or camera. `lists` are
/// the lists that the scenario gives itself, in the order of [`LISTS`].
fn drop_unusable(draft: &mut Draft, lists: &[Option<Node>; LISTS.len()]) {
    let effectors: Vec<&String> = draft.effectors.iter().map(|e| &e.name).collect();
    // In a list that the scenario gives itself, a reference to a missing element is a fault
    // instead.
    if lists[1].is_none() {
        draft.cameras.retain(|c| c.effector.as_ref().is_none_or(|e| effectors.contains(&e)));
    }
    if lists[2].is_none() {
        let cameras: Vec<&String> = draft.cameras.iter().map(|c| &c.name).collect();
        draft.vsps.retain(|v| {
            (v.owner == "mp" || effectors.contains(&&v.owner))
                && v.camera.as_ref().is_none_or(|c| cameras.contains(&c))
        });
    }
}

/// Splits a document into its sections and its lists, which are in the order of [`LISTS`].
fn split(document: &Node, reader: &mut Reader) -> (Node, [Option<Node>; LISTS.len()]) {
    let mut rest = document.clone();
    let mut found = [const { None }; LISTS.len()];
    if let Value::Table(entries) = &mut rest.value {
        for (slot, name) in found.iter_mut().zip(LISTS) {
            if let Some(at) = entries.iter().position(|e| e.key == name) {
                *slot = Some(entries.remove(at).node);
            }
        }
        // The section macro does not know the names of the lists, so `[effectors]` and similar
        // words are found here. `cell` is a section.
        entries.retain(|e| match nearest(&e.key, &LISTS) {
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

/// Reads the list `name` of a scenario, or the built-in list if none is `given`. An element with
/// the name of a built-in element starts from its values.
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

/// Reads the elements of the list `name`. `start` returns the values from which an element of a
/// given name starts.
fn elements<T: Section>(
    name: &str,
    node: Option<&Node>,
    reader: &mut Reader,
    start: impl Fn(Option<String>) -> T,
) -> Vec<T> {
    let Some(node) = node else { return Vec::new() };
    let Value::Array(items) = &node.value else {
        let reason = format!("`{name}` must be a list, not {}", node.describe());
        reader.faults.add_with_help(Some(&node.place), reason, format!("write [[{name}]]"));
        return Vec::new();
    };
    if items.len() > MOST_ELEMENTS {
        let count = items.len();
        let reason = format!("`{name}` has {count} elements, more than {MOST_ELEMENTS}");
        reader.faults.add(Some(&node.place), reason);
        return Vec::new();
    }
    let mut all = Vec::new();
    for (index, item) in items.iter().enumerate() {
        let own = tree::name_of(item);
        // The index replaces a missing name, in faults and in overrides.
        let path = format!("{name}.{}", own.clone().unwrap_or_else(|| index.to_string()));
        reader.places.insert(path.clone(), item.place.clone());
        let mut element = start(own);
        element.overlay(item, &path, reader);
        all.push(element);
    }
    all
}
