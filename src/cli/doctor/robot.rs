//! Devices of a scenario's robot: would `run` refuse them?

use super::devices::{asked, may_open};
use super::finding::{Finding, Weight};
use super::fix::{raw_io, trigger};
use crate::cell::Arm;
use crate::hw::devices::{
    Devices, EffectorDevices, ForceDevice, NAME_DEVICES, NoDevice, ask_parallel, ask_ports,
};
use crate::scenario::keys::BridgeKind;
use crate::scenario::{CameraSource, ControllerConfig, Scenario};
use rustix::io::Errno;
use std::fs;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

/// A fact for which `run` refuses the scenario, and the line that helps, if one does.
#[derive(Debug, PartialEq, Eq)]
struct Refusal {
    fact: String,
    fix: Option<String>,
}

impl Refusal {
    /// Refuses a device that may not be opened. A right can be granted; a device that is not there
    /// needs more than a right.
    fn of_device(device: &Path, errno: Errno) -> Self {
        let fix = (errno == Errno::ACCESS).then(trigger);
        Self { fact: format!("{}: {errno}", device.display()), fix }
    }

    /// Refuses ports that are not granted.
    fn of_ports(fact: String) -> Self {
        Self { fact, fix: Some(raw_io()) }
    }
}

/// An error of the file of devices says itself which value is wanted.
impl From<NoDevice> for Refusal {
    fn from(why: NoDevice) -> Self {
        Self { fact: why.to_string(), fix: None }
    }
}

/// Returns what is found of the devices that a scenario's `bridge.devices` names; nothing if no
/// hardware is behind its bridge.
pub(super) fn robot(scenario: &Scenario) -> Vec<Finding> {
    if !scenario.bridge.kind.is_hardware() {
        return Vec::new();
    }
    let path = scenario.bridge.devices_at(&scenario.path);
    let refusals = match Devices::load(&path) {
        Ok(devices) => refusals(&scenario.controller, scenario.bridge.kind, &devices),
        Err(why) => vec![Refusal { fix: Some(NAME_DEVICES.to_owned()), ..why.into() }],
    };
    let name = "bridge.devices";
    if refusals.is_empty() {
        let fact = format!(
            "{}: its values fit, and this user may open the devices that it names",
            path.display()
        );
        return vec![Finding { name, weight: Weight::Good, fact, fix: None }];
    }
    // Facts against which the same line helps stand together.
    let mut findings: Vec<Finding> = Vec::new();
    for Refusal { fact, fix } in refusals {
        match findings.iter_mut().find(|finding| finding.fix == fix) {
            Some(same) => same.fact = format!("{}; {fact}", same.fact),
            None => findings.push(Finding { name, weight: Weight::Refused, fact, fix }),
        }
    }
    findings
}

/// Returns why a run would refuse the scenario's devices: by the run's own rules, and without
/// opening any.
fn refusals(config: &ControllerConfig, bridge: BridgeKind, devices: &Devices) -> Vec<Refusal> {
    let cards = bridge == BridgeKind::Isa;
    let mut refusals = Vec::new();
    for arm in &config.cell.arms {
        let own = match devices.of_effector(&arm.name) {
            Ok(own) => own,
            Err(why) => {
                refusals.push(why.into());
                continue;
            }
        };
        refusals.extend(if cards { of_card(arm, own) } else { of_lines(arm, own) });
        refusals.extend(of_sensor(own));
        // Arm by arm: the first one's error would hide the next one's.
        let grip = devices.check_grip(std::slice::from_ref(arm), config.control.grip, cards);
        refusals.extend(grip.err().map(Refusal::from));
    }
    for (camera, source) in config.cell.cameras.iter().zip(&config.cameras) {
        if *source == CameraSource::Renderer {
            refusals.extend(of_camera(devices, &camera.name));
        }
    }
    refusals
}

/// Refuses a path that cannot be opened, or that is no device.
fn of_path(path: &str) -> Option<Refusal> {
    let path = Path::new(path);
    if let Err(errno) = may_open(path) {
        return Some(Refusal::of_device(path, errno));
    }
    let is_device = fs::metadata(path).is_ok_and(|it| it.file_type().is_char_device());
    (!is_device).then(|| Refusal { fact: format!("{}: no device", path.display()), fix: None })
}

/// Refuses the lines of an arm's axes.
fn of_lines(arm: &Arm, devices: &EffectorDevices) -> Vec<Refusal> {
    let refusal = |path: Result<&str, NoDevice>| match path {
        Ok(path) => of_path(path),
        Err(why) => Some(why.into()),
    };
    devices.paths(arm.model.has_track).filter_map(|(_, path)| refusal(path)).collect()
}

/// Refuses the card of an arm.
fn of_card(arm: &Arm, devices: &EffectorDevices) -> Vec<Refusal> {
    let Some(card) = &devices.isa else {
        return vec![NoDevice(format!("effector \"{}\": no card is named", arm.name)).into()];
    };
    let ports = asked(ask_ports, card.offset).err().map(Refusal::of_ports);
    ports.into_iter().chain(card.uio.as_deref().and_then(of_path)).collect()
}

/// Refuses the force sensor of an arm.
fn of_sensor(devices: &EffectorDevices) -> Vec<Refusal> {
    match devices.force_device() {
        Ok(ForceDevice::None | ForceDevice::NetFt(_)) => Vec::new(),
        Ok(ForceDevice::Controller(path)) => {
            let words = devices.ft_parallel.and_then(|base| asked(ask_parallel, base).err());
            of_path(path).into_iter().chain(words.map(Refusal::of_ports)).collect()
        }
        Err(why) => vec![why.into()],
    }
}

/// Refuses a camera.
fn of_camera(devices: &Devices, name: &str) -> Option<Refusal> {
    match devices.of_camera(name) {
        // The process that listens there made the socket and grants the rights to it: no udev rule
        // does.
        Ok(camera) => may_open(&camera.socket)
            .err()
            .map(|errno| Refusal { fix: None, ..Refusal::of_device(&camera.socket, errno) }),
        Err(why) => Some(why.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::devices::ports;
    use super::*;
    use crate::hw::devices::{CameraDevice, IsaDevice};
    use crate::hw::emulator::pty::Pty;
    use crate::motion::AXES;
    use crate::scenario;
    use crate::tables::testing::Folder;

    const IDLE: &str = "task = \"idle\"\npace = \"real-time\"\ncamera = []\nvsp = []\n[bridge]\nkind = \"serial\"\n\
                        devices = \"devices.toml\"\n[[effector]]\nname = \"postument\"\n";

    /// A line by a name in a folder; the same one where it is asked for again.
    fn line(folder: &Folder, name: &str) -> String {
        let path = folder.0.join(name);
        if !path.exists() {
            let far = Pty::open().unwrap();
            std::os::unix::fs::symlink(far.path(), &path).unwrap();
            // It stays for as long as the test program.
            std::mem::forget(far);
        }
        path.display().to_string()
    }

    /// An arm without a track whose lines are in a folder.
    fn postument(folder: &Folder) -> EffectorDevices {
        let line = |i: usize| line(folder, &format!("line{i}"));
        let axes = std::iter::once(String::new()).chain((1..=AXES).map(line)).collect();
        EffectorDevices { name: "postument".into(), axes, ..EffectorDevices::default() }
    }

    /// What is found of the robot of a scenario with this text, in a folder with its file of
    /// devices: how grave, what, and what helps.
    fn look(folder: &Folder, text: &str) -> Vec<(Weight, String, Option<String>)> {
        let found = robot(&scenario::read(&folder.0.join("t.toml"), text, &[]).unwrap());
        found.into_iter().map(|f| (f.weight, f.fact, f.fix)).collect()
    }

    /// The one thing that is found there.
    fn one(folder: &Folder, text: &str) -> (Weight, String, Option<String>) {
        let [one] = <[_; 1]>::try_from(look(folder, text)).unwrap();
        one
    }

    /// The one thing that is found of these devices.
    fn look_at(folder: &Folder, text: &str, devices: &Devices) -> (Weight, String, Option<String>) {
        folder.write("devices.toml", &devices.text().unwrap());
        one(folder, text)
    }

    fn with(effector: EffectorDevices) -> Devices {
        Devices { effector: vec![effector], ..Devices::default() }
    }

    #[test]
    fn the_devices_of_a_scenarios_robot_are_looked_for() {
        let folder = Folder::new("doctor-robot");

        let (weight, fact, fix) = look_at(&folder, IDLE, &with(postument(&folder)));
        assert!(weight == Weight::Good && fact.contains("devices.toml"), "{fact}");
        assert_eq!(fix, None);
        fs::remove_file(folder.0.join("line3")).unwrap();
        let (weight, fact, fix) = one(&folder, IDLE);
        assert!(weight == Weight::Refused && fact.contains("line3: No such file"), "{fact}");
        assert!(!fact.contains("line2"), "{fact}");
        assert_eq!(fix, None, "no right brings a line that is not there");
        folder.write("line3", "");
        let (weight, fact, fix) = one(&folder, IDLE);
        assert!(weight == Weight::Refused && fact.contains("line3: no device"), "{fact}");
        assert_eq!(fix, None);
        let (weight, fact, fix) = one(&folder, &IDLE.replace("devices.toml", "nosuch.toml"));
        assert!(weight == Weight::Refused && fact.contains("nosuch.toml: No such file"), "{fact}");
        assert_eq!(fix.as_deref(), Some(NAME_DEVICES));
        assert!(look(&folder, &IDLE.replace("serial", "plant")).is_empty());
    }

    #[test]
    fn what_helps_is_told_where_it_helps() {
        let folder = Folder::new("doctor-advice");
        let mut twice = postument(&folder);
        twice.axes[4] = twice.axes[3].clone();
        let ended = Devices { emulated: true, ..with(postument(&folder)) };

        for devices in [with(twice), ended] {
            let (weight, fact, fix) = look_at(&folder, IDLE, &devices);
            assert_eq!((weight, fix.as_deref()), (Weight::Refused, Some(NAME_DEVICES)), "{fact}");
        }
        let line = Path::new("/dev/ttyUSB0");
        let fix = |errno| Refusal::of_device(line, errno).fix;
        assert!(fix(Errno::ACCESS).is_some_and(|fix| fix.contains("usermod")));
        assert_eq!([fix(Errno::NOENT), fix(Errno::IO)], [None, None]);
        let wanted = if cfg!(feature = "isa") { "setcap" } else { "cargo build" };
        assert!(raw_io().contains(wanted) && ports().fix.is_none_or(|fix| fix == raw_io()));
    }

    #[test]
    fn values_that_a_run_refuses_are_told() {
        let folder = Folder::new("doctor-values");
        let track = IDLE.replace("postument", "track");
        let there = format!("ft_controller:{}", line(&folder, "sensor"));
        let nowhere = there.replace("sensor", "nosensor");
        let sensor = |force: &str| EffectorDevices { force: force.into(), ..postument(&folder) };
        let currents = |axis: usize, amperes: f64| {
            let mut max_currents = vec![1.0; AXES + 1];
            max_currents[axis] = amperes;
            EffectorDevices { max_currents, ..postument(&folder) }
        };
        let of_track = |devices: EffectorDevices| {
            let mut axes = devices.axes.clone();
            axes[0] = line(&folder, "line0");
            EffectorDevices { name: "track".into(), axes, ..devices }
        };
        let mut without = postument(&folder);
        without.axes[2].clear();

        for (text, devices, wanted) in [
            (IDLE, sensor("bogus"), "wanted net_ft:ADDRESS:PORT"),
            (IDLE, sensor("net_ft:somewhere"), "wanted an address and a port"),
            (IDLE, sensor(&nowhere), "nosensor: No such file"),
            (IDLE, currents(AXES, 0.01), "a grip of 40 N takes"),
            (track.as_str(), of_track(currents(0, 0.0)), "the track does not move with 0 A"),
            (IDLE, without, "axis 2 has no line"),
            (IDLE, of_track(postument(&folder)), "no [[effector]] \"postument\""),
        ] {
            let (weight, fact, fix) = look_at(&folder, text, &with(devices));
            assert!(weight == Weight::Refused && fact.contains(wanted), "{wanted}: {fact}");
            assert_eq!(fix, None, "{wanted}");
        }
        for (text, devices) in [
            (IDLE, sensor("net_ft:127.0.0.1:49152")),
            (IDLE, sensor(&there)),
            (IDLE, currents(0, 0.0)),
            (track.as_str(), of_track(currents(0, 1.0))),
        ] {
            let (weight, fact, _) = look_at(&folder, text, &with(devices));
            assert!(weight == Weight::Good, "{fact}");
        }
    }

    #[test]
    fn a_card_is_asked_for_and_held_against_its_arm() {
        let folder = Folder::new("doctor-card");
        let text = IDLE.replace("serial", "isa");
        let found = |card: Option<IsaDevice>, max_currents: &[f64]| {
            let max_currents = max_currents.to_vec();
            let own = EffectorDevices { isa: card, max_currents, ..postument(&folder) };
            folder.write("devices.toml", &with(own).text().unwrap());
            look(&folder, &text)
        };
        let told =
            |found: &[(Weight, String, Option<String>)], wanted: &str, fix: Option<String>| {
                let refused = |f: &&(Weight, String, Option<String>)| {
                    f.0 == Weight::Refused && f.1.contains(wanted) && f.2 == fix
                };
                assert!(found.iter().find(refused).is_some(), "{wanted}: {found:?}");
            };
        let enough = [0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5];

        told(&found(None, &enough), "effector \"postument\": no card is named", None);
        let named = found(Some(IsaDevice::default()), &enough);
        match asked(ask_ports, 0) {
            Ok(()) => assert_eq!(named[0].0, Weight::Good, "{named:?}"),
            Err(why) => told(&named, &why, Some(raw_io())),
        }
        assert_eq!(named.len(), 1, "{named:?}");
        let uio = folder.0.join("nouio").display().to_string();
        let alone = found(Some(IsaDevice { uio: Some(uio), ..IsaDevice::default() }), &enough);
        told(&alone, "nouio: No such file", None);
        let powerless = found(Some(IsaDevice { power_axis: 8, ..IsaDevice::default() }), &enough);
        told(&powerless, "power_axis: there is no axis 8", None);
        let weak = found(Some(IsaDevice::default()), &[0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.05]);
        told(&weak, "a grip of 40 N takes 72 mA", None);
    }

    #[test]
    fn a_camera_of_the_robot_is_looked_for() {
        let folder = Folder::new("doctor-camera");
        let text = IDLE.replace("camera = []\n", "") + "[[camera]]\nname = \"standalone\"\n";
        let camera = |name: &str, socket: &str| Devices {
            camera: vec![CameraDevice { name: name.into(), socket: folder.0.join(socket) }],
            ..with(postument(&folder))
        };

        let (weight, fact, _) = look_at(&folder, &text, &camera("standalone", "nosocket"));
        assert!(weight == Weight::Refused && fact.contains("nosocket: No such file"), "{fact}");
        let (weight, fact, _) = look_at(&folder, &text, &camera("other", "line1"));
        assert!(
            weight == Weight::Refused && fact.contains("no [[camera]] \"standalone\""),
            "{fact}"
        );
        let (weight, fact, _) = look_at(&folder, &text, &camera("standalone", "line1"));
        assert!(weight == Weight::Good, "{fact}");
    }
}
