//! The checks that need more than one key: whether keys agree with each other.
//!
//! - in: a [`Draft`], each of whose keys is in its own range, and the parts built from it
//! - out: faults, at the key that has to change
//!
//! | check | refused | reason |
//! |---|---|---|
//! | [`bridge`] | hardware under virtual time | hardware has a clock of its own |
//! | [`task`] | a word that names no task | there is nothing to do |
//! | [`coordination`] | a scheme that the task cannot use | nobody would order the arms |
//! | [`owners`] | readings of the cube that miss the first ECP | it runs the visual servo |
//! | [`periods`] | a macrostep of less than 2 periods | an EDP answers 2 periods before its end |
//! | [`hand_force`] | a limit below the force of an approach | each approach would be aborted |

use super::catalogue::{Catalogue, ChosenTask, Declaration};
use super::config::{Owner, VspConfig};
use super::draft::Draft;
use super::fault::nearest;
use super::injected;
use super::keys::{self, Control, Coordination, HandKeys, Pace};
use super::lists::{GripperKeys, VspKind};
use super::root::Root;
use super::section::Reader;
use super::{nodes, objects};
use crate::cell::{Arm, MOST_ARMS};
use crate::cube::Keeper;
use crate::servo::period::Length;
use std::sync::Arc;

/// Checks that hardware runs in real time, and that `bridge.devices`, if given, is not empty.
pub(super) fn bridge(root: &Root, reader: &mut Reader) {
    let kind = root.bridge.kind;
    if kind.is_hardware() && root.pace == Pace::Virtual {
        let reason = format!("`bridge.kind`: \"{}\" runs in real time only", kind.word());
        reader.fault_with_help(
            "bridge.kind",
            reason,
            "set pace = \"real-time\", or give --pace real-time",
        );
    }
    if root.bridge.devices.as_ref().is_some_and(|file| file.trim().is_empty()) {
        let reason = "`bridge.devices`: the file name is empty";
        let advice = "omit the key to use the file that `rubik-robot emulate` writes";
        reader.fault_with_help("bridge.devices", reason, advice);
    }
}

/// Checks the names of all effectors, cameras and VSPs, and that there are 1 to [`MOST_ARMS`]
/// effectors.
pub(super) fn effectors(draft: &Draft, reader: &mut Reader) {
    names("effector", draft.effectors.iter().map(|e| e.name.as_str()), reader);
    names("camera", draft.cameras.iter().map(|c| c.name.as_str()), reader);
    names("vsp", draft.vsps.iter().map(|v| v.name.as_str()), reader);
    names("node", draft.nodes.iter().map(|(_, n)| n.name.as_str()), reader);
    names("order", draft.orders.iter().map(|(_, o)| o.name.as_str()), reader);
    if draft.effectors.is_empty() {
        reader.fault("effector", "a scenario needs at least one [[effector]]");
    } else if draft.effectors.len() > MOST_ARMS {
        let count = draft.effectors.len();
        let reason = format!("there are {count} effectors, but at most {MOST_ARMS} can be driven");
        reader.fault(&format!("effector.{MOST_ARMS}"), reason);
    }
}

/// Checks that each name in a list is given, is not reserved, and differs from the others.
fn names<'a>(list: &str, names: impl Iterator<Item = &'a str>, reader: &mut Reader) {
    let mut seen: Vec<&str> = Vec::new();
    for (index, name) in names.enumerate() {
        if name.is_empty() {
            let path = format!("{list}.{index}");
            let reason = format!("element {index} of [[{list}]] (counted from 0) has no name");
            reader.fault(&path, reason);
        // These names have other meanings: the owner MP, a dotted key and an index.
        } else if name == "mp" || name.contains('.') || name.parse::<f64>().is_ok() {
            let reason = format!(
                "\"{name}\" cannot be the name of an element of [[{list}]]: \"mp\", numbers and \
                 names with a dot are reserved"
            );
            reader.fault(&format!("{list}.{name}.name"), reason);
        } else if seen.contains(&name) {
            let reason = format!("[[{list}]] has two elements named \"{name}\"");
            reader.fault(&format!("{list}.{name}.name"), reason);
        }
        seen.push(name);
    }
}

/// Checks that the smallest opening of a gripper is below its largest. `path` is the dotted name of
/// its effector.
pub(super) fn opening(gripper: &GripperKeys, path: &str, reader: &mut Reader) {
    let (min, max) = (gripper.opening_min, gripper.opening_max);
    if min >= max {
        let reason = format!(
            "`{path}.gripper`: opening_min_mm {} is not below opening_max_mm {}",
            min * 1e3,
            max * 1e3
        );
        reader.fault(&format!("{path}.gripper.opening_min_mm"), reason);
    }
}

/// Returns the task with this name; adds a fault if there is none.
pub(super) fn task(name: &str, catalogue: &Catalogue, reader: &mut Reader) -> Option<ChosenTask> {
    let found = catalogue.find(name);
    let found = found.map(|task| ChosenTask::new(Arc::clone(task), catalogue.maker()));
    if found.is_none() {
        let words = catalogue.names();
        let quoted: Vec<String> = words.iter().map(|word| format!("\"{word}\"")).collect();
        let help = match nearest(name, &words) {
            Some(word) => format!("did you mean \"{word}\"?"),
            None => format!("possible: {}", quoted.join(" | ")),
        };
        let reason = format!("`task`: \"{name}\" is not a possible value");
        reader.fault_with_help("task", reason, help);
    }
    found
}

/// Checks that the cell has as many effectors as the task needs, and no more than it drives.
/// `given` is their number.
pub(super) fn effectors_of(task: &dyn Declaration, given: usize, reader: &mut Reader) {
    let needed = task.properties().effectors;
    let name = task.name();
    if given < needed {
        let reason = format!("`task`: \"{name}\" needs {needed} effectors, but there are {given}");
        reader.fault("task", reason);
    }
    let most = task.properties().most_effectors;
    if given > most {
        let reason = format!("`task`: \"{name}\" drives {most} effectors, but there are {given}");
        reader.fault("task", reason);
    }
}

/// Checks that the task can be done under the scheme of coordination.
pub(super) fn coordination(task: &dyn Declaration, given: Coordination, reader: &mut Reader) {
    let possible = task.properties().coordination;
    if !possible.contains(&given) {
        let words: Vec<_> = possible.iter().map(|c| format!("\"{}\"", c.word())).collect();
        let reason = format!(
            "`coordination`: the task \"{}\" needs {}, not \"{}\"",
            task.name(),
            words.join(" or "),
            given.word()
        );
        reader.fault("coordination", reason);
    }
}

/// Checks that under sporadic coordination the readings of the sensor that finds the cube go to the
/// ECP of the first effector, which runs the visual servo.
pub(super) fn owners(draft: &Draft, vsps: &[Option<VspConfig>], reader: &mut Reader) {
    if draft.root.coordination != Coordination::Sporadic {
        return;
    }
    let first = draft.effectors.first().map_or("the first effector", |e| e.name.as_str());
    let elsewhere = |v: &&VspConfig| v.kind == VspKind::Cube && v.owner != Owner::Ecp(0);
    for vsp in vsps.iter().flatten().filter(elsewhere) {
        let at = format!("vsp.{}.owner", vsp.name);
        let reason = format!(
            "`{at}`: under sporadic coordination {first} tracks the cube, \
             so the owner must be \"{first}\""
        );
        reader.fault(&at, reason);
    }
}

/// Checks that the sign of the forces is not 0.
pub(super) fn force_sign(control: &Control, reader: &mut Reader) {
    if control.force_sign == 0 {
        reader.fault("control.force_sign", "`control.force_sign`: must be 1 or -1, not 0");
    }
}

/// Checks the length of a servo period: it is 2 ms on hardware, and a macrostep has a whole number
/// of periods, at least two.
pub(super) fn periods(root: &Root, reader: &mut Reader) {
    let length = Length::of_seconds(root.real_time.period);
    // The ports to hardware count their watchdogs in periods of 2 ms, and the emulator steps by 2
    // ms.
    if root.bridge.kind.is_hardware() && length != Length::default() {
        let reason = format!(
            "`real_time.period_ms`: the hardware of bridge.kind = \"{}\" has a period of 2 ms, \
             not of {} ms",
            root.bridge.kind.word(),
            length.seconds() * 1e3
        );
        let advice = "set it to 2; only the simulated plant supports other periods";
        reader.fault_with_help("real_time.period_ms", reason, advice);
    }
    // `macrostep_periods` counts the 2 ms of the original, in nanoseconds here, so that the
    // division is exact. An EDP answers two periods before the end of a macrostep.
    let macrostep = u64::from(root.control.macrostep_periods) * 2_000_000;
    if macrostep % length.nanos() != 0 || macrostep < 2 * length.nanos() {
        let reason = format!(
            "`real_time.period_ms`: a macrostep of {} ms must be a whole number of periods of \
             {} ms, at least two",
            macrostep as f64 * 1e-6,
            length.seconds() * 1e3
        );
        let advice = "change control.macrostep_periods (of 2 ms) as well";
        reader.fault_with_help("real_time.period_ms", reason, advice);
    }
}

/// Checks the injected faults: the keys of each, that its arm has its axis, that no two have the
/// same name, and that the arms are simulated.
pub(super) fn faults(draft: &Draft, arms: &[Option<Arm>], reader: &mut Reader) {
    let Draft { effectors, cameras, vsps, .. } = draft;
    let parts = injected::Parts { effectors, cameras, vsps };
    for (index, (path, keys)) in draft.faults.iter().enumerate() {
        injected::check(keys, path, parts, reader);
        nodes::check_fault(keys, path, &draft.nodes, reader);
        // An arm without a track has no axis 0.
        let named = |arm: &&Arm| Some(&arm.name) == keys.arm.as_ref();
        if keys.axis == Some(0)
            && let Some(arm) = arms.iter().flatten().find(named).filter(|arm| !arm.model.has_track)
        {
            let reason = format!("`{path}.axis`: the {} has no axis 0 (the track)", arm.name);
            reader.fault(&format!("{path}.axis"), reason);
        }
        if draft.root.bridge.kind.is_hardware() {
            reader.fault(path, format!("`{path}`: faults cannot be injected into hardware"));
        }
        if draft.faults[..index].iter().any(|(other, _)| other == path) {
            reader.fault(path, format!("[[fault]] has two elements named `{path}`"));
        }
    }
}

/// Checks the objects of the simulated cell, with probes and leads.
pub(super) fn objects(draft: &Draft, reader: &mut Reader) {
    let lists = &draft.objects;
    names("object", lists.objects.iter().map(|(_, o)| o.name.as_str()), reader);
    let root = &draft.root;
    let hardware = root.bridge.kind.is_hardware();
    objects::check(lists, &draft.effectors, root.cell.table_height, hardware, reader);
}

/// Checks that a cube on the table lies on a face: it cannot lie on an edge.
pub(super) fn cube_on_table(hand: &HandKeys, reader: &mut Reader) {
    let [roll, pitch, _] = hand.cube_rpy;
    if hand.keeper == keys::Keeper::Table && (roll, pitch) != (0.0, 0.0) {
        let (roll, pitch) = (roll.to_degrees(), pitch.to_degrees());
        let reason = format!(
            "`hand.cube_rpy_deg`: a cube on a table can turn about the vertical only: roll and \
             pitch must be 0, not {roll:.2} and {pitch:.2} deg"
        );
        let advice = "plant.table.any_face = true allows any face of the cube to be at the bottom";
        reader.fault_with_help("hand.cube_rpy_deg", reason, advice);
    }
}

/// Checks that the contact force that ends an approach is below the force limit near a person.
/// Otherwise that limit would abort each approach.
pub(super) fn hand_force(control: &Control, keeper: Keeper, reader: &mut Reader) {
    let (most, touch) = (control.hand_force, control.approach_force);
    // A table has no person near it, so `hand_force` does not act there.
    if keeper == Keeper::Person && most <= touch {
        let reason = format!(
            "`control.hand_force_n`: {most} N would abort every approach, which ends at \
             {touch} N (`control.approach_force_n`)"
        );
        reader.fault("control.hand_force_n", reason);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Override;
    use crate::tasks::read;
    use std::path::Path;

    /// Returns the faults of a scenario with this text and overrides; empty if there are none.
    fn faults(text: &str, overrides: &[Override]) -> String {
        match read(Path::new("t.toml"), text, overrides) {
            Ok(_) => String::new(),
            Err(faults) => faults.to_string(),
        }
    }

    #[test]
    fn missing_effector_and_wrong_camera_mount_are_refused() {
        let one = "camera = []\nvsp = []\n[[effector]]\nname = \"track\"\n";
        assert!(faults(one, &[]).contains("\"solve\" needs two effectors"), "{}", faults(one, &[]));
        assert_eq!(faults(&format!("task = \"idle\"\n{one}"), &[]), "");

        let in_hand = faults("[[vsp]]\nname = \"mpc\"\ncamera = \"track_hand\"\n", &[]);
        assert!(in_hand.contains("is mounted on a flange"), "{in_hand}");
        let alone = faults("[[vsp]]\nname = \"gs1\"\ncamera = \"standalone\"\n", &[]);
        assert!(alone.contains("is a fixed camera"), "{alone}");
        let nameless = faults("[[vsp]]\nkind = \"cube\"\n", &[]);
        assert!(nameless.contains("has no name") && !nameless.contains("`vsp.`"), "{nameless}");

        let swapped = "[[effector]]\nname = \"postument\"\n[[effector]]\nname = \"track\"\n";
        let swapped = faults(swapped, &[]);
        assert!(swapped.contains("needs the effector on the track first"), "{swapped}");
        assert!(swapped.contains("t.toml:"), "{swapped}");

        let over = Override::parse("effector.0.name=left").unwrap();
        assert!(faults("", &[over]).contains("cannot rename"));
    }

    #[test]
    fn listed_names_are_unique_and_not_reserved() {
        let camera = |name: &str| format!("[[camera]]\nname = \"{name}\"\n");
        let twice = faults(&format!("{0}{0}", camera("standalone")), &[]);
        assert!(twice.contains("[[camera]] has two elements named \"standalone\""), "{twice}");
        for reserved in ["mp", "a.b", "7", "1e3"] {
            let message = faults(&camera(reserved), &[]);
            let wanted = format!("\"{reserved}\" cannot be the name of an element of [[camera]]");
            assert!(message.contains(&wanted), "{message}");
        }
        let fault = "[[fault]]\nname = \"a\"\nkind = \"drop\"\narm = \"track\"\nat_s = 1\n";
        assert_eq!(faults(fault, &[]), "");
        let twice = faults(&format!("{fault}{fault}"), &[]);
        assert!(twice.contains("[[fault]] has two elements named `fault.a`"), "{twice}");
    }

    #[test]
    fn sporadic_tracking_belongs_to_first_effector() {
        let owner = |owner: &str, coordination: &str| {
            let over = Override::parse(&format!("vsp.mpc.owner={owner}")).unwrap();
            faults(&format!("coordination = \"{coordination}\"\n"), &[over])
        };

        assert_eq!(owner("track", "sporadic"), "");
        assert_eq!(owner("mp", "continuous"), "");
        for other in ["mp", "postument"] {
            let message = owner(other, "sporadic");
            assert!(message.contains("so the owner must be \"track\""), "{message}");
        }
    }

    #[test]
    fn task_refuses_coordination_that_it_cannot_use() {
        for task in ["solve", "idle"] {
            let message = faults(&format!("task = \"{task}\"\ncoordination = \"absent\"\n"), &[]);
            let wanted = format!("the task \"{task}\" needs \"sporadic\" or \"continuous\"");
            assert!(message.contains("t.toml:2:16: `coordination`"), "{message}");
            assert!(message.contains(&wanted), "{message}");
            assert_eq!(
                faults(&format!("task = \"{task}\"\ncoordination = \"sporadic\"\n"), &[]),
                ""
            );
        }
    }

    #[test]
    fn force_sign_of_zero_is_refused() {
        let sign = |sign: i32| faults(&format!("[control]\nforce_sign = {sign}\n"), &[]);

        assert!(sign(0).contains("must be 1 or -1, not 0"), "{}", sign(0));
        assert_eq!([sign(1), sign(-1)], ["", ""]);
    }

    #[test]
    fn macrostep_has_at_least_two_whole_periods() {
        let message = |macrostep: u32, period: &str| {
            let text = format!(
                "[control]\nmacrostep_periods = {macrostep}\n[real_time]\nperiod_ms = {period}\n"
            );
            faults(&text, &[])
        };

        assert_eq!([message(8, "1"), message(2, "2")], ["", ""]);
        // Periods of 4 ms are refused for another reason.
        assert!(!message(8, "4").contains("at least two"), "{}", message(8, "4"));
        for (macrostep, period, found) in
            [(8, "3", "macrostep of 16 ms"), (1, "2", "macrostep of 2 ms")]
        {
            let message = message(macrostep, period);
            assert!(message.contains(found) && message.contains("at least two"), "{message}");
        }
    }

    #[test]
    fn fault_of_missing_axis_or_hardware_is_refused() {
        let freeze = |arm: &str, axis: usize| {
            format!(
                "[[fault]]\nname = \"f\"\nkind = \"encoder_freeze\"\narm = \"{arm}\"\n\
                 axis = {axis}\nat_s = 1\n"
            )
        };

        assert_eq!(faults(&freeze("track", 0), &[]), "");
        assert_eq!(faults(&freeze("postument", 1), &[]), "");
        let trackless = faults(&freeze("postument", 0), &[]);
        assert!(trackless.contains("the postument has no axis 0"), "{trackless}");
        let serial = "pace = \"real-time\"\n[bridge]\nkind = \"serial\"\n";
        let real = faults(&format!("{serial}{}", freeze("track", 0)), &[]);
        assert!(real.contains("faults cannot be injected into hardware"), "{real}");
    }

    #[test]
    fn hardware_under_virtual_clock_is_refused_with_advice() {
        let message = faults("[bridge]\nkind = \"serial\"\n", &[]);

        assert!(
            message.contains("t.toml:2:8: `bridge.kind`: \"serial\" runs in real time only"),
            "{message}"
        );
        assert!(message.contains("--pace real-time"), "{message}");
    }

    #[test]
    fn empty_device_file_name_is_refused() {
        let message = faults("[bridge]\ndevices = \"\"\n", &[]);
        assert!(
            message.contains("t.toml:2:11: `bridge.devices`: the file name is empty"),
            "{message}"
        );

        let at = |text: &str| {
            read(Path::new("cell/t.toml"), text, &[])
                .unwrap()
                .bridge
                .devices_at(Path::new("cell/t.toml"))
        };
        assert_eq!(at("[bridge]\ndevices = \"robot.toml\"\n"), Path::new("cell/robot.toml"));
        assert_eq!(at(""), crate::hw::devices::default_path());
    }

    #[test]
    fn hardware_stops_after_fewer_missed_periods_than_simulation() {
        let limit = |text: &str| read(Path::new("t.toml"), text, &[]).unwrap().missed_limit();
        let serial = "pace = \"real-time\"\n[bridge]\nkind = \"serial\"\n";

        assert_eq!(limit(""), 50);
        assert_eq!(limit(serial), 20);
        assert_eq!(limit(&format!("{serial}[real_time]\nmissed_limit = 7\n")), 7);
    }

    #[test]
    fn hand_force_limit_below_approach_force_is_refused() {
        let text = "[control]\nhand_force_n = 3\n";
        let message = faults(text, &[]);
        assert!(message.contains("hand_force_n") && message.contains("ends at 4 N"), "{message}");
        let at = |force: f64| faults(&format!("[control]\nhand_force_n = {force}\n"), &[]);
        assert!(at(4.0).contains("4 N would abort every approach"), "{}", at(4.0));
        assert_eq!(at(4.1), "");
        assert_eq!(faults(&format!("{text}[hand]\nkeeper = \"table\"\n"), &[]), "");
    }

    #[test]
    fn hardware_refuses_periods_other_than_2_ms() {
        let message = |kind: &str, period: &str| {
            let text = format!(
                "pace = \"real-time\"\n[bridge]\nkind = \"{kind}\"\n\
                 [real_time]\nperiod_ms = {period}\n"
            );
            faults(&text, &[])
        };

        for kind in ["serial", "isa"] {
            let message = message(kind, "1");
            let wanted = format!(
                "t.toml:5:13: `real_time.period_ms`: \
                 the hardware of bridge.kind = \"{kind}\""
            );
            assert!(message.contains(&wanted) && message.contains("not of 1 ms"), "{message}");
        }
        assert_eq!(message("serial", "2"), "");
        assert_eq!(message("isa", "2.0"), "");
        assert_eq!(message("plant", "1"), "");
    }

    #[test]
    fn cube_on_table_must_not_be_tilted() {
        let message = |keeper: &str, rpy: &str| {
            let text = format!("[hand]\nkeeper = \"{keeper}\"\ncube_rpy_deg = {rpy}\n");
            faults(&text, &[])
        };

        for (rpy, found) in
            [("[10, 0, 0]", "not 10.00 and 0.00 deg"), ("[0, -90, 20]", "not 0.00 and -90.00 deg")]
        {
            let message = message("table", rpy);
            let wanted = "t.toml:3:16: `hand.cube_rpy_deg`: \
                          a cube on a table can turn about the vertical only";
            assert!(message.contains(wanted) && message.contains(found), "{message}");
        }
        assert_eq!(message("table", "[0, 0, 30]"), "");
        assert_eq!(message("person", "[10, -90, 30]"), "");
    }
}
