//! Checks of the devices of a scenario's robot: would `run` refuse them?
//!
//! - in: a scenario, and the file of devices that it names
//! - out: a finding for each reason, by the rules of `run`; no device is opened

use super::devices::{asked, may_open};
use super::finding::{Finding, Weight};
use super::fix::{raw_io, trigger};
use crate::cell::Arm;
use crate::hw::camera_device::{CameraDevice, CameraLine};
use crate::hw::devices::{
    Devices, EffectorDevices, ForceDevice, NAME_DEVICES, NoDevice, ask_parallel, ask_ports,
};
use crate::hw::serial::leads_to_line;
use crate::hw::webcam::nodes::Nodes;
use crate::hw::webcam::{NO_WEBCAMS, WebcamDevice};
use crate::scenario::keys::BridgeKind;
use crate::scenario::{CameraSource, ControllerConfig, Scenario};
use rustix::io::Errno;
use std::fs;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

/// Reason why `run` refuses the scenario, and the command or setting that helps, if there is one.
#[derive(Debug, PartialEq, Eq)]
struct Refusal {
    fact: String,
    fix: Option<String>,
}

impl Refusal {
    /// Makes the refusal of a device that cannot be opened. A command can grant a right, but it
    /// cannot connect a missing device.
    fn of_device(device: &Path, errno: Errno) -> Self {
        let fix = (errno == Errno::ACCESS).then(trigger);
        Self { fact: format!("{}: {errno}", device.display()), fix }
    }

    /// Makes the refusal of I/O ports to which the kernel denies access.
    fn of_ports(fact: String) -> Self {
        Self { fact, fix: Some(raw_io()) }
    }
}

/// Refusal of a wrong entry in the file of devices. Its text names the value that is needed, so
/// there is no command.
impl From<NoDevice> for Refusal {
    fn from(why: NoDevice) -> Self {
        Self { fact: why.to_string(), fix: None }
    }
}

/// Returns the findings about the devices in the file `bridge.devices` of a scenario; none for a
/// bridge without hardware.
pub(super) fn robot(scenario: &Scenario) -> Vec<Finding> {
    if !scenario.bridge.kind.is_hardware() {
        return Vec::new();
    }
    // The path of the file is relative to the scenario.
    let (path, devices) = scenario.load_devices();
    let refusals = match devices {
        Ok(devices) => refusals(&scenario.controller, scenario.bridge.kind, &devices),
        Err(why) => vec![Refusal { fix: Some(NAME_DEVICES.to_owned()), ..why.into() }],
    };
    let name = "bridge.devices";
    if refusals.is_empty() {
        let fact =
            format!("{}: its values are valid, and this user may open its devices", path.display());
        return vec![Finding { name, weight: Weight::Good, fact, fix: None }];
    }
    // Reasons with the same remedy become one finding.
    let mut findings: Vec<Finding> = Vec::new();
    for Refusal { fact, fix } in refusals {
        match findings.iter_mut().find(|finding| finding.fix == fix) {
            Some(same) => same.fact = format!("{}; {fact}", same.fact),
            None => findings.push(Finding { name, weight: Weight::Refused, fact, fix }),
        }
    }
    findings
}

/// Returns the reasons why `run` would refuse the devices, by the rules of `run`. Opens no device.
/// Devices of nodes on other hosts are in the files of those hosts.
fn refusals(config: &ControllerConfig, bridge: BridgeKind, devices: &Devices) -> Vec<Refusal> {
    let cards = bridge == BridgeKind::Isa;
    let mut refusals = Vec::new();
    let here = config.network.servos_of(None, config.cell.arms.len());
    for arm in here.into_iter().map(|arm| &config.cell.arms[arm]) {
        let own = match devices.of_effector(&arm.name) {
            Ok(own) => own,
            Err(why) => {
                refusals.push(why.into());
                continue;
            }
        };
        refusals.extend(if cards { of_card(arm, own) } else { of_lines(arm, own) });
        refusals.extend(of_sensor(own));
        // The check stops at its first error, so each arm is checked by itself.
        let grip = devices.check_grip(std::slice::from_ref(arm), config.control.grip, cards);
        refusals.extend(grip.err().map(Refusal::from));
    }
    for (index, (camera, source)) in config.cell.cameras.iter().zip(&config.cameras).enumerate() {
        let vsp = config.vsps.iter().position(|vsp| vsp.camera == Some(index));
        if vsp.is_some_and(|vsp| !config.network.has_vsp(None, vsp)) {
            continue;
        }
        // A camera whose pictures come from a folder has no socket.
        if *source == CameraSource::Renderer {
            refusals.extend(of_camera(devices, &camera.name));
        }
    }
    refusals
}

/// Returns why a path is not a device that this user may open; `None` if it is.
fn of_path(path: &str) -> Option<Refusal> {
    let path = Path::new(path);
    if let Err(errno) = may_open(path) {
        return Some(Refusal::of_device(path, errno));
    }
    let is_device = fs::metadata(path).is_ok_and(|it| it.file_type().is_char_device());
    (!is_device).then(|| Refusal { fact: format!("{}: not a device", path.display()), fix: None })
}

/// Returns why a path is not a serial line that this user may open; `None` if it is.
fn of_line(path: &str) -> Option<Refusal> {
    of_path(path).or_else(|| {
        let is_line = leads_to_line(Path::new(path)) == Ok(true);
        (!is_line).then(|| Refusal { fact: format!("{path}: not a serial line"), fix: None })
    })
}

/// Returns the refusals of the serial lines of an arm's axes.
fn of_lines(arm: &Arm, devices: &EffectorDevices) -> Vec<Refusal> {
    let refusal = |path: Result<&str, NoDevice>| match path {
        Ok(path) => of_line(path),
        Err(why) => Some(why.into()),
    };
    devices.paths(arm.model.has_track).filter_map(|(_, path)| refusal(path)).collect()
}

/// Returns the refusals of an arm's ISA card: none is named, its I/O ports are not granted, or its
/// UIO device cannot be opened.
fn of_card(arm: &Arm, devices: &EffectorDevices) -> Vec<Refusal> {
    let Some(card) = &devices.isa else {
        return vec![NoDevice(format!("effector \"{}\": no card is named", arm.name)).into()];
    };
    // A card needs its I/O ports, and its device of UIO (user-space I/O) only if one is named.
    let ports = asked(ask_ports, card.offset).err().map(Refusal::of_ports);
    ports.into_iter().chain(card.uio.as_deref().and_then(of_path)).collect()
}

/// Returns the refusals of an arm's force sensor. One on the network (`net_ft`) has no device.
fn of_sensor(devices: &EffectorDevices) -> Vec<Refusal> {
    match devices.force_device() {
        Ok(ForceDevice::None | ForceDevice::NetFt(_)) => Vec::new(),
        Ok(ForceDevice::Controller(path)) => {
            let words = devices.ft_parallel.and_then(|base| asked(ask_parallel, base).err());
            of_line(path).into_iter().chain(words.map(Refusal::of_ports)).collect()
        }
        Err(why) => vec![why.into()],
    }
}

/// Returns why the socket of a camera cannot be used; `None` if it can.
fn of_camera(devices: &Devices, name: &str) -> Option<Refusal> {
    match devices.of_camera(name) {
        Ok(CameraDevice { line: CameraLine::Socket(socket), .. }) => {
            // The process that made the socket grants the rights to it. A rule of udev cannot.
            may_open(socket)
                .err()
                .map(|errno| Refusal { fix: None, ..Refusal::of_device(socket, errno) })
        }
        Ok(CameraDevice { line: CameraLine::V4l2(webcam), .. }) => of_webcam(name, webcam),
        Err(why) => Some(why.into()),
    }
}

/// Returns why a webcam cannot be used; `None` if it can, as far as this shows without opening it.
fn of_webcam(name: &str, webcam: &WebcamDevice) -> Option<Refusal> {
    let refusal =
        |fact: &str, fix| Some(Refusal { fact: format!("camera \"{name}\": {fact}"), fix });
    if !cfg!(feature = "v4l2") {
        return refusal(&format!("{}: {NO_WEBCAMS}", webcam.device), None);
    }
    let path = match Nodes::default().find(&webcam.device) {
        Ok(path) => path,
        Err(why) => return refusal(&why, None),
    };
    let errno = may_open(&path).err()?;
    // The devices of cameras belong to the group `video` of the system.
    let fix = (errno == Errno::ACCESS).then(|| "sudo usermod -aG video $USER".to_owned());
    refusal(&format!("{}: {errno}", path.display()), fix)
}

#[cfg(test)]
mod tests {
    use super::super::devices::ports;
    use super::*;
    use crate::hw::devices::IsaDevice;
    use crate::hw::emulator::pty::Pty;
    use crate::motion::AXES;
    use crate::scenario::Override;
    use crate::tables::testing::Folder;
    use std::os::unix::fs::PermissionsExt as _;

    const IDLE: &str = "task = \"idle\"\npace = \"real-time\"\ncamera = []\nvsp = []\n\
                        [bridge]\nkind = \"serial\"\n\
                        devices = \"devices.toml\"\n[[effector]]\nname = \"postument\"\n";

    /// Returns the path of a pseudoterminal in a folder. The first call with a name opens it.
    fn line(folder: &Folder, name: &str) -> String {
        let path = folder.0.join(name);
        if !path.exists() {
            let far = Pty::open().unwrap();
            std::os::unix::fs::symlink(far.path(), &path).unwrap();
            // The line must exist until the test program ends.
            std::mem::forget(far);
        }
        path.display().to_string()
    }

    /// Returns the devices of an arm without a track, with its serial lines in a folder.
    fn postument(folder: &Folder) -> EffectorDevices {
        let line = |i: usize| line(folder, &format!("line{i}"));
        let axes = std::iter::once(String::new()).chain((1..=AXES).map(line)).collect();
        EffectorDevices { name: "postument".into(), axes, ..EffectorDevices::default() }
    }

    /// Returns weight, fact and remedy of each finding about the scenario with this text.
    fn look(folder: &Folder, text: &str) -> Vec<(Weight, String, Option<String>)> {
        let found = robot(&crate::tasks::read(&folder.0.join("t.toml"), text, &[]).unwrap());
        found.into_iter().map(|f| (f.weight, f.fact, f.fix)).collect()
    }

    /// Returns weight, fact and remedy of the only finding about the scenario with this text.
    fn one(folder: &Folder, text: &str) -> (Weight, String, Option<String>) {
        let [one] = <[_; 1]>::try_from(look(folder, text)).unwrap();
        one
    }

    /// Writes these devices to the file that the scenario names. Returns weight, fact and remedy of
    /// the only finding.
    fn look_at(folder: &Folder, text: &str, devices: &Devices) -> (Weight, String, Option<String>) {
        folder.write("devices.toml", &devices.text().unwrap());
        one(folder, text)
    }

    fn with(effector: EffectorDevices) -> Devices {
        Devices { effector: vec![effector], ..Devices::default() }
    }

    #[test]
    fn missing_serial_line_or_devices_file_is_refused() {
        let folder = Folder::new("doctor-robot");

        let (weight, fact, fix) = look_at(&folder, IDLE, &with(postument(&folder)));
        assert!(weight == Weight::Good && fact.contains("devices.toml"), "{fact}");
        assert_eq!(fix, None);
        fs::remove_file(folder.0.join("line3")).unwrap();
        let (weight, fact, fix) = one(&folder, IDLE);
        assert!(weight == Weight::Refused && fact.contains("line3: No such file"), "{fact}");
        assert!(!fact.contains("line2"), "{fact}");
        assert_eq!(fix, None, "a right does not connect a missing line");
        folder.write("line3", "");
        let (weight, fact, fix) = one(&folder, IDLE);
        assert!(weight == Weight::Refused && fact.contains("line3: not a device"), "{fact}");
        assert_eq!(fix, None);
        fs::remove_file(folder.0.join("line3")).unwrap();
        std::os::unix::fs::symlink("/dev/null", folder.0.join("line3")).unwrap();
        let (weight, fact, _) = one(&folder, IDLE);
        assert!(weight == Weight::Refused && fact.contains("line3: not a serial line"), "{fact}");
        // `run` refuses a file of devices that other users may write, and so does `doctor`.
        let file = folder.0.join("devices.toml");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o666)).unwrap();
        let (weight, fact, fix) = one(&folder, IDLE);
        assert!(weight == Weight::Refused && fact.contains("other users may write it"), "{fact}");
        assert_eq!(fix.as_deref(), Some(NAME_DEVICES));
        let named = Override::parse("bridge.devices=devices.toml").unwrap();
        let scenario = crate::tasks::read(&folder.0.join("t.toml"), IDLE, &[named]).unwrap();
        assert!(scenario.load_devices().1.is_ok(), "the command line names it");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o644)).unwrap();
        let (weight, fact, fix) = one(&folder, &IDLE.replace("devices.toml", "nosuch.toml"));
        assert!(
            weight == Weight::Refused && fact.contains("nosuch.toml: there is no such file"),
            "{fact}"
        );
        assert_eq!(fix.as_deref(), Some(NAME_DEVICES));
        assert!(look(&folder, &IDLE.replace("serial", "plant")).is_empty());
    }

    #[test]
    fn fix_is_suggested_for_permission_not_missing_device() {
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
    fn invalid_values_in_devices_file_are_refused() {
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
            (IDLE, sensor("bogus"), "expected net_ft:ADDRESS:PORT"),
            (IDLE, sensor("net_ft:somewhere"), "expected an address and a port"),
            (IDLE, sensor(&nowhere), "nosensor: No such file"),
            (IDLE, currents(AXES, 0.01), "a grip of 40 N takes"),
            (track.as_str(), of_track(currents(0, 0.0)), "so it cannot move"),
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
    fn missing_or_unsuitable_isa_card_is_refused() {
        let folder = Folder::new("doctor-card");
        let text = IDLE.replace("serial", "isa");
        let found = |card: Option<IsaDevice>, max_currents: &[f64]| {
            let max_currents = max_currents.to_vec();
            let own = EffectorDevices { isa: card, max_currents, ..postument(&folder) };
            folder.write("devices.toml", &with(own).text().unwrap());
            look(&folder, &text)
        };
        let assert_found =
            |found: &[(Weight, String, Option<String>)], wanted: &str, fix: Option<String>| {
                let refused = |f: &&(Weight, String, Option<String>)| {
                    f.0 == Weight::Refused && f.1.contains(wanted) && f.2 == fix
                };
                assert!(found.iter().find(refused).is_some(), "{wanted}: {found:?}");
            };
        let enough = [0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5];

        assert_found(&found(None, &enough), "effector \"postument\": no card is named", None);
        let named = found(Some(IsaDevice::default()), &enough);
        match asked(ask_ports, 0) {
            Ok(()) => assert_eq!(named[0].0, Weight::Good, "{named:?}"),
            Err(why) => assert_found(&named, &why, Some(raw_io())),
        }
        assert_eq!(named.len(), 1, "{named:?}");
        let uio = folder.0.join("nouio").display().to_string();
        let alone = found(Some(IsaDevice { uio: Some(uio), ..IsaDevice::default() }), &enough);
        assert_found(&alone, "nouio: No such file", None);
        let powerless = found(Some(IsaDevice { power_axis: 8, ..IsaDevice::default() }), &enough);
        assert_found(&powerless, "power_axis: there is no axis 8", None);
        let weak = found(Some(IsaDevice::default()), &[0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.05]);
        assert_found(&weak, "a grip of 40 N takes 72 mA", None);
    }

    #[test]
    fn camera_without_socket_or_devices_entry_is_refused() {
        let folder = Folder::new("doctor-camera");
        let text = IDLE.replace("camera = []\n", "") + "[[camera]]\nname = \"standalone\"\n";
        let camera = |name: &str, socket: &str| Devices {
            camera: vec![CameraDevice {
                name: name.into(),
                line: CameraLine::Socket(folder.0.join(socket)),
            }],
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

        let mut webcam = camera("standalone", "line1");
        webcam.camera[0].line = CameraLine::V4l2(WebcamDevice::named("/dev/nosuch"));
        let (weight, fact, _) = look_at(&folder, &text, &webcam);
        let wanted = if cfg!(feature = "v4l2") { "no such file" } else { "--features v4l2" };
        assert!(weight == Weight::Refused && fact.contains(wanted), "{fact}");
        assert!(fact.starts_with("camera \"standalone\": /dev/nosuch: "), "{fact}");
    }
}
