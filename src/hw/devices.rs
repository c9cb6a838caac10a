//! The file of devices: which serial lines, cards, sensors and sockets belong to the effectors and
//! cameras of a cell.
//!
//! The file belongs to a machine, not to a scenario: `rubik-robot emulate` writes one, a workshop
//! writes its own.
//!
//! - in: the file (TOML)
//! - out: the open bridge, a [`SerialPort`] or a port of [`IsaArm`]s, with its force sensors; the
//!   devices of the cameras

use super::camera_device::{CameraDevice, CameraLine};
use super::force::{ForceSource, FtController, NetFt, NoSensor, Words};
use super::isa::IsaArm;
use super::isa::registers::{AxisKind, REVOLUTION};
use super::new_file::{self, Foreign};
use super::note::Notes;
use super::port::Port;
use super::serial::axis::Rules;
use super::serial::{AXIS_BAUD, Line, SerialArm, SerialPort};
use super::text::Unread;
use crate::cell::Arm;
use crate::motion::AXES;
use serde::de::{Deserializer, Error as _};
use serde::{Deserialize, Serialize};
use std::ffi::OsString;
use std::fs::{File, TryLockError};
use std::io::Error;
use std::net::SocketAddr;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use toml::Spanned;

/// Returns the default path of the devices file, which an emulator writes and a bridge reads. The
/// file lies in `$XDG_RUNTIME_DIR`, or in the folder for temporary files if that variable names no
/// folder.
#[must_use]
pub fn default_path() -> PathBuf {
    place(std::env::var_os("XDG_RUNTIME_DIR"), std::env::temp_dir())
}

/// Returns the default path from `own`, the value of `XDG_RUNTIME_DIR`, and from `temporary`, the
/// folder for temporary files.
fn place(own: Option<OsString>, temporary: PathBuf) -> PathBuf {
    // The specification of XDG_RUNTIME_DIR ignores relative paths.
    let own = own.map(PathBuf::from).filter(|own| own.is_absolute() && own.is_dir());
    own.unwrap_or(temporary).join("rubik-robot-devices.toml")
}

/// Advice for a user whose devices file cannot be used.
pub const NAME_DEVICES: &str = "start `rubik-robot emulate`, or name your devices there";

/// Greatest size of a devices file (bytes).
const LARGEST: u64 = 1 << 20;

/// All devices of a machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Devices {
    /// Whether an emulator provides the devices. The emulator holds a lock on the file while it
    /// runs; after its end the names of its lines may belong to other programs.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub emulated: bool,
    /// Devices of each effector.
    #[serde(default)]
    pub effector: Vec<EffectorDevices>,
    /// Device of each camera.
    #[serde(default)]
    pub camera: Vec<CameraDevice>,
}

/// The devices of an effector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EffectorDevices {
    /// Name of the effector in the scenario.
    pub name: String,
    /// Serial lines of the axes: the track, q1 to q6, the jaw; "" for an axis without a line. Used
    /// if bridge.kind = "serial".
    pub axes: Vec<String>,
    /// Force sensor: `net_ft:ADDRESS:PORT`, `ft_controller:DEVICE`, or "none".
    pub force: String,
    /// Scale of the forces of a Net F/T box, from its configuration page (1/N).
    #[serde(deserialize_with = "scale")]
    pub counts_per_newton: f64,
    /// Scale of the torques of a Net F/T box, from its configuration page (1/Nm).
    #[serde(deserialize_with = "scale")]
    pub counts_per_newton_metre: f64,
    /// First I/O port of the parallel interface (PCI-1751) that carries the readings of an
    /// `ft_controller`, as `lspci -v` prints it. Without this key the readings come by the serial
    /// line.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ft_parallel: Option<u16>,
    /// Motor currents of axes 0..=6 and the jaw above which their controllers stop (A). The first
    /// may be 0 for an arm without a track. An empty list means the limits of the original robot's
    /// serial controllers or ISA cards.
    #[serde(deserialize_with = "currents")]
    pub max_currents: Vec<f64>,
    /// ISA card of the effector. Used if bridge.kind = "isa".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub isa: Option<IsaDevice>,
}

/// An ISA card.
///
/// A missing pointer, divisor or current has the value of the original robot's card for an arm with
/// or without a track. The other known differences between the original's two cards must be given:
/// see `resolvers`, `sync_active_high`, `power_axis`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IsaDevice {
    /// Offset of every port of the card.
    pub offset: u16,
    /// Pointer of the first axis: 0xc0 of the track's card, 0xc1 of the postument's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first_pointer: Option<u8>,
    /// Divisor that makes interrupts come every 2 ms: 4 of the track's card, 8 of the postument's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub divisor: Option<u8>,
    /// Axes with resolvers instead of encoders: in 2008 axes 0 to 5 of the track. The arm's profile
    /// must have 682 increments for each.
    pub resolvers: Vec<usize>,
    /// Axes whose synchronisation switch is active high at its encoder card: in the 2008 sources
    /// axes 1 to 5 of the postument.
    pub sync_active_high: Vec<usize>,
    /// Axis whose status shows the power of all axes. The default is 6; in the 2008 sources it is 2
    /// for the postument.
    pub power_axis: usize,
    /// Units of motor current per ampere (1/A), the jaw's last.
    pub units_per_ampere: Vec<f64>,
    /// Device of the card's interrupt, for example `/dev/uio0`. Without it the card has no
    /// watchdog.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uio: Option<String>,
}

impl Default for IsaDevice {
    /// Returns a card with the original's settings for its arm, encoders only and no interrupt.
    fn default() -> Self {
        Self {
            offset: 0,
            first_pointer: None,
            divisor: None,
            resolvers: Vec::new(),
            sync_active_high: Vec::new(),
            power_axis: AXES - 1,
            units_per_ampere: Vec::new(),
            uio: None,
        }
    }
}

/// Settings of one of the original robot's two ISA cards.
struct Original {
    first_pointer: u8,
    divisor: u8,
    /// Limits of the currents (units), the jaw's last.
    max_currents: [u8; AXES + 1],
    /// Units of current per ampere of the jaw (1/A). The original gives 25.3 and 34.7 per 100 mA.
    jaw_units: f64,
}

/// Units of current per ampere (1/A). It is known for the tool roll and assumed for the other axes.
const UNITS_PER_AMPERE: f64 = 13.7;

impl Original {
    const TRACK: Self = Self {
        first_pointer: 0xc0,
        divisor: 4,
        max_currents: [0x30, 0x30, 0x30, 0x30, 0x30, 0x30, 0x10, 0x27],
        jaw_units: 253.0,
    };
    const POSTUMENT: Self = Self {
        first_pointer: 0xc1,
        divisor: 8,
        max_currents: [0, 0xff, 0xff, 0xff, 0xff, 0xff, 0x10, 0x20],
        jaw_units: 347.0,
    };
}

impl IsaDevice {
    /// Combines this card's settings with the original's defaults to an [`IsaArm`], still without
    /// registers and force sensor. `max_currents` are those of [`EffectorDevices::max_currents`]
    /// (A).
    ///
    /// # Errors
    /// The first setting that does not fit the arm or the card.
    pub fn arm(&self, arm: &Arm, max_currents: &[f64]) -> Result<IsaArm<()>, String> {
        let has_track = arm.model.has_track;
        let original = if has_track { Original::TRACK } else { Original::POSTUMENT };
        // The jaw has a scale of its own on each of the original's cards.
        let mut units_per_ampere = [UNITS_PER_AMPERE; AXES + 1];
        units_per_ampere[AXES] = original.jaw_units;
        if !self.units_per_ampere.is_empty() {
            let units = self.units_per_ampere.as_slice();
            units_per_ampere =
                units.try_into().map_err(|_| "units_per_ampere needs 8 numbers".to_owned())?;
        }
        if !units_per_ampere.iter().all(|units| units.is_finite() && *units > 0.0) {
            return Err("units_per_ampere needs numbers above 0".to_owned());
        }
        // A resolver always counts 682 a revolution. A profile with another number would turn the
        // axis by a wrong angle.
        for axis in &self.resolvers {
            let increments = arm.model.increments.get(*axis).copied();
            let Some(increments) = increments else {
                return Err(format!("resolvers: there is no axis {axis}"));
            };
            if increments != REVOLUTION as f64 {
                return Err(format!(
                    "resolvers: axis {axis} has {increments} increments per revolution in the \
                     arm's profile; a resolver has {REVOLUTION}"
                ));
            }
        }
        // The card of an arm without a track has no axis 0.
        let first = usize::from(!has_track);
        if !(first..=AXES).contains(&self.power_axis) {
            return Err(format!("power_axis: there is no axis {}", self.power_axis));
        }
        let mut limits = original.max_currents;
        for (axis, amperes) in max_currents.iter().enumerate().take(AXES + 1).skip(first) {
            // The command has one byte for the limit, and a limit of 0 trips at any current.
            let units = (amperes * units_per_ampere[axis]).round();
            if !(1.0..=255.0).contains(&units) {
                return Err(format!(
                    "max_currents: axis {axis}: {amperes} A are {units} units of the card, \
                     which takes 1 to 255"
                ));
            }
            limits[axis] = units as u8;
        }
        Ok(IsaArm {
            name: arm.name.clone(),
            registers: (),
            first_pointer: self.first_pointer.unwrap_or(original.first_pointer),
            divisor: self.divisor.unwrap_or(original.divisor),
            has_track,
            kinds: std::array::from_fn(|i| {
                if self.resolvers.contains(&i) {
                    AxisKind::Resolver
                } else {
                    AxisKind::Encoder { sync_high: self.sync_active_high.contains(&i) }
                }
            }),
            power_axis: self.power_axis,
            units_per_ampere,
            max_currents: limits,
            force: Box::new(NoSensor),
        })
    }
}

impl Default for EffectorDevices {
    /// Returns an effector without devices; the scales are the default of ATI's boxes.
    fn default() -> Self {
        Self {
            name: String::new(),
            axes: Vec::new(),
            force: "none".to_owned(),
            counts_per_newton: 1e6,
            counts_per_newton_metre: 1e6,
            ft_parallel: None,
            max_currents: Vec::new(),
            isa: None,
        }
    }
}

/// A force sensor, as named by [`EffectorDevices::force`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ForceDevice<'a> {
    /// No sensor.
    None,
    /// Net F/T box at this address.
    NetFt(SocketAddr),
    /// Controller on this serial line.
    Controller(&'a str),
}

/// Error of a device that is missing or cannot be used, or of a wrong devices file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NoDevice(pub String);

impl Devices {
    /// Reads a devices file (TOML) that only this user or root can have written. In a folder for
    /// temporary files any user can put a file of this name, and the file says which devices are
    /// opened, and which of their sensors and limits the controller believes.
    ///
    /// # Errors
    /// The error of the system, that other users can have written the file, the first mistake in it
    /// with its line number, or that the emulator that wrote it has ended.
    pub fn load(path: &Path) -> Result<Self, NoDevice> {
        Self::load_if(path, |file| {
            let found = file.metadata()?;
            let (owner, own) = (found.uid(), rustix::process::geteuid().as_raw());
            distrust(owner, found.mode(), own).map_or(Ok(()), |why| Err(Error::other(why)))
        })
    }

    /// Reads a devices file (TOML) that the user has named on the command line.
    ///
    /// # Errors
    /// As for [`Self::load`], except that any user may have written the file.
    pub fn load_named(path: &Path) -> Result<Self, NoDevice> {
        Self::load_if(path, |_| Ok(()))
    }

    /// Reads a devices file (TOML) if `check` accepts the open file. The file of an emulator that
    /// has ended is refused.
    fn load_if(
        path: &Path,
        check: impl FnOnce(&File) -> std::io::Result<()>,
    ) -> Result<Self, NoDevice> {
        let fail = |why: &str| NoDevice(format!("{}: {why}", path.display()));
        let (file, text) =
            read(path).map_err(|why| NoDevice(Unread::new(path, why).to_string()))?;
        // The open file is checked, because its name may lead to another one meanwhile.
        check(&file).map_err(|e| fail(&e.to_string()))?;
        let devices = parse(&text).map_err(|(at, why)| {
            let line = text[..at].matches('\n').count() + 1;
            NoDevice(format!("{}:{line}: {why}", path.display()))
        })?;
        if !devices.emulated {
            return Ok(devices);
        }
        // The file of an emulator that was killed remains; its lock does not.
        if is_held(&file).map_err(|e| fail(&e.to_string()))? {
            Ok(devices)
        } else {
            Err(fail("the emulator that wrote it has ended"))
        }
    }

    /// Returns the text of a devices file (TOML) that lists these devices.
    ///
    /// # Errors
    /// [`NoDevice`] if TOML cannot express the devices, which does not happen with paths in UTF-8.
    pub fn text(&self) -> Result<String, NoDevice> {
        toml::to_string(self).map_err(|e| NoDevice(e.to_string()))
    }

    /// Returns the devices of an effector.
    ///
    /// # Errors
    /// [`NoDevice`] if the file has no entry for this effector.
    pub fn of_effector(&self, name: &str) -> Result<&EffectorDevices, NoDevice> {
        let found = self.effector.iter().find(|e| e.name == name);
        found.ok_or_else(|| NoDevice(format!("the devices file has no [[effector]] \"{name}\"")))
    }

    /// Checks that each arm's jaw controller allows the motor current that the grip force `grip`
    /// (N) takes. The current limit is that of the arm's ISA card if `cards` is set, else that of
    /// its serial controller.
    ///
    /// # Errors
    /// [`NoDevice`] for the first arm whose controller would stop its jaw, or whose devices are
    /// missing or wrong.
    pub fn check_grip(&self, arms: &[Arm], grip: f64, cards: bool) -> Result<(), NoDevice> {
        for arm in arms {
            let devices = self.of_effector(&arm.name)?;
            // A card rounds the limit to its units, so its own number counts, not the file's.
            let limit = if cards {
                let card = devices.isa.clone().unwrap_or_default();
                let fail = |why| NoDevice(format!("effector \"{}\", isa: {why}", arm.name));
                let card = card.arm(arm, &devices.max_currents).map_err(fail)?;
                f64::from(card.max_currents[AXES]) / card.units_per_ampere[AXES]
            } else {
                devices.limits(arm.model.has_track)?[AXES]
            };
            let needs = grip * arm.gripper.amperes_per_newton;
            if needs > limit {
                return Err(NoDevice(format!(
                    "effector \"{}\": a grip of {grip:.0} N takes {:.0} mA, \
                     and the jaw's controller stops above {:.0} mA: \
                     lower control.grip_n, or raise the last of its max_currents",
                    arm.name,
                    needs * 1e3,
                    limit * 1e3
                )));
            }
        }
        Ok(())
    }

    /// Returns the device of a camera.
    ///
    /// # Errors
    /// [`NoDevice`] if the file has no entry for this camera.
    pub fn of_camera(&self, name: &str) -> Result<&CameraDevice, NoDevice> {
        let found = self.camera.iter().find(|c| c.name == name);
        found.ok_or_else(|| NoDevice(format!("the devices file has no [[camera]] \"{name}\"")))
    }

    /// Returns whether the file names several webcams, which may share a bus.
    #[must_use]
    pub fn has_several_webcams(&self) -> bool {
        let is_webcam = |camera: &&CameraDevice| matches!(camera.line, CameraLine::V4l2(_));
        self.camera.iter().filter(is_webcam).count() > 1
    }

    /// Opens the serial lines and force sensors of these arms and joins them to one bridge. `rules`
    /// say when a line is given up; `notes` receives non-fatal events for the log.
    ///
    /// # Errors
    /// The first device that cannot be opened.
    pub fn serial(&self, arms: &[Arm], rules: Rules, notes: Notes) -> Result<SerialPort, NoDevice> {
        let arms = arms
            .iter()
            .map(|arm| {
                let devices = self.of_effector(&arm.name)?;
                Ok(SerialArm {
                    name: arm.name.clone(),
                    axes: devices.lines(arm.model.has_track)?,
                    max_currents: devices.limits(arm.model.has_track)?,
                    force: devices.sensor(arm.sensor.range)?,
                })
            })
            .collect::<Result<Vec<_>, NoDevice>>()?;
        Ok(SerialPort::new(arms, rules, notes))
    }

    /// Opens the ISA cards and force sensors of these arms and joins them to one bridge. `notes`
    /// receives non-fatal events for the log.
    ///
    /// # Errors
    /// The first card or sensor that cannot be used.
    #[cfg(feature = "isa")]
    pub fn isa(&self, arms: &[Arm], notes: Notes) -> Result<Box<dyn Port>, NoDevice> {
        use super::isa::{IsaPort, PortIo};
        let arms = arms
            .iter()
            .map(|arm| {
                let devices = self.of_effector(&arm.name)?;
                let fail = |why: &str| NoDevice(format!("effector \"{}\", isa: {why}", arm.name));
                let card = devices.isa.as_ref().ok_or_else(|| fail("no card is named"))?;
                let parts = card.arm(arm, &devices.max_currents).map_err(|e| fail(&e))?;
                let registers =
                    PortIo::open(card.offset, card.uio.as_deref()).map_err(|e| fail(&e))?;
                let force = devices.sensor(arm.sensor.range)?;
                Ok(IsaArm { force, ..parts.with(registers) })
            })
            .collect::<Result<Vec<_>, NoDevice>>()?;
        Ok(Box::new(IsaPort::new(arms, notes)))
    }

    /// Refuses to open a bridge to ISA cards: without the feature `isa` there are no port
    /// instructions.
    ///
    /// # Errors
    /// [`NoDevice`] always.
    #[cfg(not(feature = "isa"))]
    pub fn isa(&self, _: &[Arm], _: Notes) -> Result<Box<dyn Port>, NoDevice> {
        Err(NoDevice(NO_PORTS.to_owned()))
    }
}

/// Returns the reason why the user `own` must not trust a file of the user `owner` with the
/// permissions `mode`, with what to do; `None` if the file can be trusted.
fn distrust(owner: u32, mode: u32, own: u32) -> Option<&'static str> {
    Some(match new_file::foreign(owner, mode, own)? {
        Foreign::Owner => {
            "it belongs to another user, who may have written anything: name it by \
             `--set bridge.devices=FILE` if you trust it"
        }
        Foreign::Rights => {
            "other users may write it: run `chmod go-w FILE`, or name it by \
             `--set bridge.devices=FILE`"
        }
    })
}

/// Opens a devices file and returns it with its text. Only a regular file is accepted: reading a
/// device may never end, and reading a pipe may wait for ever.
pub(crate) fn read(path: &Path) -> std::io::Result<(File, String)> {
    super::text::open_text(path, LARGEST)
}

/// Returns whether the emulator that wrote a devices file still runs: it then holds a lock on the
/// file.
pub(crate) fn is_held(file: &File) -> std::io::Result<bool> {
    match file.try_lock_shared() {
        Err(TryLockError::WouldBlock) => Ok(true),
        Ok(()) => Ok(false),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Parses the text of a devices file; returns the devices, or the first mistake with its position
/// in the text (bytes).
fn parse(text: &str) -> Result<Devices, (usize, String)> {
    let wrong = |error: toml::de::Error| {
        (error.span().map_or(0, |span| span.start), error.message().to_owned())
    };
    if let Some(line) = super::text::deep_line(text) {
        let start = text.split_inclusive('\n').take(line - 1).map(str::len).sum();
        return Err((start, format!("a key has more than {} parts", super::text::MOST_PARTS)));
    }
    let devices = toml::from_str(text).map_err(wrong)?;
    // A second pass finds the positions of the names, which `Devices` does not keep.
    let lines: Lines = toml::from_str(text).map_err(wrong)?;
    lines.twice().map_or(Ok(devices), Err)
}

/// Names of serial lines and webcams with their positions in a file.
#[derive(Deserialize)]
struct Lines {
    #[serde(default)]
    effector: Vec<LinesOfEffector>,
    #[serde(default)]
    camera: Vec<LineOfCamera>,
}

/// Webcam of a camera.
#[derive(Deserialize)]
struct LineOfCamera {
    v4l2: Option<NameOfWebcam>,
}

/// Name of a webcam with its position.
#[derive(Deserialize)]
struct NameOfWebcam {
    device: Spanned<String>,
}

/// Names of an effector's serial lines, and of its force sensor, with their positions.
#[derive(Deserialize)]
struct LinesOfEffector {
    #[serde(default)]
    axes: Vec<Spanned<String>>,
    force: Option<Spanned<String>>,
}

impl Lines {
    /// Returns the first serial line that two axes or sensors name, or the first webcam of two
    /// cameras, as the position of the second name in the file (bytes) and a message. Two axes on
    /// one line would be driven in turn.
    fn twice(&self) -> Option<(usize, String)> {
        let mut seen: Vec<PathBuf> = Vec::new();
        let lines = self.effector.iter().flat_map(|e| e.axes.iter().chain(&e.force));
        let webcams = self.camera.iter().filter_map(|c| c.v4l2.as_ref().map(|w| &w.device));
        for line in lines.chain(webcams) {
            let name = line.get_ref().strip_prefix("ft_controller:").unwrap_or(line.get_ref());
            if name.is_empty() || name == "none" {
                continue;
            }
            // Two paths may lead to one device.
            let device = std::fs::canonicalize(name).unwrap_or_else(|_| name.into());
            if seen.contains(&device) {
                return Some((line.span().start, format!("{name} is named twice")));
            }
            seen.push(device);
        }
        None
    }
}

/// Reads a scale, and refuses one that is not a number above 0.
fn scale<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    let scale = f64::deserialize(from)?;
    if scale.is_finite() && scale > 0.0 {
        Ok(scale)
    } else {
        Err(D::Error::custom(format!("a scale must be a number above 0, not {scale}")))
    }
}

/// Limits that controllers accept (A): a command has 16 bits for the milliamperes.
const CURRENTS: std::ops::RangeInclusive<f64> = 0.001..=65.5;

/// Reads `max_currents`: an empty list, or one limit for each of eight motors, each within
/// [`CURRENTS`]. The first may be 0.
fn currents<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
    let currents = Vec::<f64>::deserialize(from)?;
    if !currents.is_empty() && currents.len() != AXES + 1 {
        let count = currents.len();
        return Err(D::Error::custom(format!(
            "max_currents: expected {} numbers, for axes 0 to 6 and the jaw, found {count}",
            AXES + 1
        )));
    }
    for (axis, amperes) in currents.iter().enumerate() {
        // Whether the arm has a track is not known here; `limits` refuses a track with 0 A.
        let unused = axis == 0 && *amperes == 0.0;
        if !unused && !CURRENTS.contains(amperes) {
            return Err(D::Error::custom(format!(
                "max_currents: axis {axis}: {amperes} A is outside {}..{} A",
                CURRENTS.start(),
                CURRENTS.end()
            )));
        }
    }
    Ok(currents)
}

/// Reason why this program cannot reach an ISA card or a PCI-1751 board, with what to do.
#[cfg(not(feature = "isa"))]
const NO_PORTS: &str =
    "this program cannot access I/O ports: build it with `cargo build --release --features isa`";

impl EffectorDevices {
    /// Returns the motor currents above which the serial controllers stop their motors (A), the
    /// jaw's last.
    ///
    /// # Errors
    /// [`NoDevice`] if the arm has a track and the limit of axis 0 is 0 A.
    fn limits(&self, has_track: bool) -> Result<[f64; AXES + 1], NoDevice> {
        /// Limits of both of the original's arms (A).
        const ORIGINAL: [f64; AXES + 1] = [25.0, 15.0, 18.0, 10.0, 10.0, 10.0, 10.0, 0.2];
        if has_track && self.max_currents.first() == Some(&0.0) {
            let name = &self.name;
            return Err(NoDevice(format!(
                "effector \"{name}\": max_currents: the limit of axis 0, the track, is 0 A, so it \
                 cannot move: set a larger one"
            )));
        }
        let limit = |axis: usize| self.max_currents.get(axis).copied().unwrap_or(ORIGINAL[axis]);
        Ok(std::array::from_fn(limit))
    }

    /// Returns the indices of the axes that the arm drives, each with the device path of its serial
    /// line, or with an error if the file names no line for it.
    pub fn paths(&self, has_track: bool) -> impl Iterator<Item = (usize, Result<&str, NoDevice>)> {
        (usize::from(!has_track)..=AXES).map(move |axis| {
            let path = self.axes.get(axis).map(String::as_str).filter(|path| !path.is_empty());
            let path = path.ok_or_else(|| {
                NoDevice(format!(
                    "effector \"{}\": axis {axis} has no line; `axes` names {} devices: \
                     the track's (or \"\"), q1 to q6, the jaw's",
                    self.name,
                    AXES + 1
                ))
            });
            (axis, path)
        })
    }

    /// Opens the serial lines of the axes that the arm drives.
    fn lines(&self, has_track: bool) -> Result<[Option<Line>; AXES + 1], NoDevice> {
        let mut lines = [const { None }; AXES + 1];
        for (axis, path) in self.paths(has_track) {
            let open = |e| NoDevice(format!("effector \"{}\", axis {axis}: {e}", self.name));
            lines[axis] = Some(Line::open(path?, AXIS_BAUD, true).map_err(open)?);
        }
        Ok(lines)
    }

    /// Parses the name of the force sensor, without opening the device.
    ///
    /// # Errors
    /// [`NoDevice`] if `force` names no sensor of a known kind.
    pub fn force_device(&self) -> Result<ForceDevice<'_>, NoDevice> {
        if self.force == "none" {
            return Ok(ForceDevice::None);
        }
        match self.force.split_once(':') {
            Some(("net_ft", address)) => address.parse().map(ForceDevice::NetFt).map_err(|_| {
                self.no_sensor("expected an address and a port, as in 192.168.1.1:49152")
            }),
            Some(("ft_controller", path)) => Ok(ForceDevice::Controller(path)),
            _ => Err(self.no_sensor("expected net_ft:ADDRESS:PORT, ft_controller:DEVICE or none")),
        }
    }

    /// Opens the force sensor; `range` is the largest force and torque that it can measure in each
    /// direction (N, Nm).
    ///
    /// # Errors
    /// [`NoDevice`] if `force` names no sensor of a known kind, or the sensor cannot be opened.
    pub fn sensor(&self, range: [f64; 6]) -> Result<Box<dyn ForceSource>, NoDevice> {
        match self.force_device()? {
            ForceDevice::None => Ok(Box::new(NoSensor)),
            ForceDevice::NetFt(address) => {
                let (newton, metre) = (self.counts_per_newton, self.counts_per_newton_metre);
                let sensor = NetFt::connect(address, newton, metre, range);
                Ok(Box::new(sensor.map_err(|e| self.no_sensor(&e.to_string()))?))
            }
            ForceDevice::Controller(path) => {
                let fail = |why: String| self.no_sensor(&why);
                let words = self.ft_parallel.map(words).transpose().map_err(fail)?;
                Ok(Box::new(FtController::open(path, words, range).map_err(fail)?))
            }
        }
    }

    /// Returns the error of this effector's force sensor, with a reason.
    fn no_sensor(&self, why: &str) -> NoDevice {
        NoDevice(format!("effector \"{}\", force = \"{}\": {why}", self.name, self.force))
    }
}

/// Asks the operating system for access to the I/O ports of the ISA card at `offset`. The calling
/// thread gets the access, and so do the threads that it starts later.
///
/// # Errors
/// A text that names the ports to which access was denied.
#[cfg(feature = "isa")]
pub fn ask_ports(offset: u16) -> Result<(), String> {
    super::isa::PortIo::open(offset, None).map(drop)
}

/// Refuses access to I/O ports: without the feature `isa` there are no port instructions.
///
/// # Errors
/// The reason, always.
#[cfg(not(feature = "isa"))]
pub fn ask_ports(_: u16) -> Result<(), String> {
    Err(NO_PORTS.to_owned())
}

/// Asks the operating system for access to the I/O ports of the parallel interface whose first port
/// is `base`, like [`ask_ports`], and writes nothing to them.
///
/// # Errors
/// A text that names the ports to which access was denied.
pub fn ask_parallel(base: u16) -> Result<(), String> {
    parallel(base).map(drop)
}

/// Asks for access to the I/O ports of the parallel interface whose first port is `base`, without
/// writing to them.
#[cfg(feature = "isa")]
fn parallel(base: u16) -> Result<super::isa::PortIo, String> {
    use super::force::Pci1751;
    super::isa::PortIo::board(base, Pci1751::<super::isa::PortIo>::PORTS)
}

/// Refuses access to the parallel interface: without the feature `isa` there are no port
/// instructions.
#[cfg(not(feature = "isa"))]
fn parallel(_: u16) -> Result<std::convert::Infallible, String> {
    Err(format!("ft_parallel: {NO_PORTS}"))
}

/// Opens the parallel interface whose first I/O port is `base`, and sets it up.
#[cfg(feature = "isa")]
fn words(base: u16) -> Result<Box<dyn Words>, String> {
    Ok(Box::new(super::force::Pci1751::new(parallel(base)?)))
}

/// Refuses the parallel interface, like [`parallel`].
#[cfg(not(feature = "isa"))]
fn words(base: u16) -> Result<Box<dyn Words>, String> {
    parallel(base).map(|none| match none {})
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hw::webcam::WebcamDevice;
    use crate::hw::webcam::device::Encoding;

    #[test]
    fn devices_file_round_trips_and_mistake_names_line() {
        let devices = Devices {
            emulated: false,
            effector: vec![EffectorDevices {
                name: "track".into(),
                axes: vec!["/dev/ttyMI0".into(), String::new()],
                force: "net_ft:192.168.1.1:49152".into(),
                ..EffectorDevices::default()
            }],
            camera: vec![
                CameraDevice {
                    name: "standalone".into(),
                    line: CameraLine::Socket("/tmp/s".into()),
                },
                CameraDevice {
                    name: "track_hand".into(),
                    line: CameraLine::V4l2(WebcamDevice {
                        format: Some(Encoding::Mjpeg),
                        exposure_ms: Some(7.5),
                        white_balance_k: Some(4600),
                        ..WebcamDevice::named("/dev/video0")
                    }),
                },
            ],
        };
        let text = devices.text().unwrap();
        let path = std::env::temp_dir().join(format!("rubik-devices-{}.toml", std::process::id()));

        std::fs::write(&path, &text).unwrap();
        assert_eq!(Devices::load(&path), Ok(devices));
        let spoilt = format!("{text}\nspeed = 3\n");
        let line = spoilt.lines().count();
        std::fs::write(&path, spoilt).unwrap();
        let wrong = Devices::load(&path).unwrap_err().to_string();
        std::fs::remove_file(&path).unwrap();
        let place = format!("{}:{line}: ", path.display());
        assert!(wrong.contains("unknown field `speed`") && wrong.contains(&place), "{wrong}");
        assert!(Devices::load(&path).unwrap_err().to_string().contains("no such file"));
    }

    /// Another user may put a file at the default path first. Such a file is read only if the
    /// command line names it.
    #[test]
    fn devices_file_of_others_needs_to_be_named() {
        use std::os::unix::fs::PermissionsExt as _;
        let path = std::env::temp_dir().join(format!("rubik-others-{}.toml", std::process::id()));
        std::fs::write(&path, "").unwrap();
        for (mode, good) in [(0o644, true), (0o600, true), (0o666, false), (0o664, false)] {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            let told = Devices::load(&path).err().map(|e| e.to_string()).unwrap_or_default();
            assert_eq!(told.is_empty(), good, "{mode:o}: {told}");
            assert!(good || told.contains("chmod go-w"), "{told}");
            assert_eq!(Devices::load_named(&path), Ok(Devices::default()), "{mode:o}");
        }
        std::fs::remove_file(&path).unwrap();

        let (own, other) = (1000, 1001);
        assert!(distrust(own, 0o100_644, own).is_none() && distrust(0, 0o644, own).is_none());
        assert!(distrust(other, 0o644, own).is_some_and(|why| why.contains("--set")));
        assert!(distrust(own, 0o644, 0).is_some(), "the file of a user, read by root");
        assert!(distrust(0, 0o666, own).is_some());
    }

    /// Writes `text` into a temporary file, whose name contains `name`, and loads it. Returns the
    /// error; "" if the file is accepted.
    fn refused(name: &str, text: &str) -> String {
        let path = std::env::temp_dir().join(format!("rubik-{name}-{}.toml", std::process::id()));
        std::fs::write(&path, text).unwrap();
        let refused = Devices::load(&path).err().map(|e| e.to_string()).unwrap_or_default();
        std::fs::remove_file(&path).unwrap();
        refused
    }

    #[test]
    fn non_regular_or_too_large_file_is_refused() {
        use rustix::fs::{CWD, FileType, Mode, mknodat};
        let fifo = std::env::temp_dir().join(format!("rubik-fifo-{}.toml", std::process::id()));
        mknodat(CWD, &fifo, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();

        for path in [fifo.clone(), "/dev/zero".into(), std::env::temp_dir()] {
            let error = Devices::load(&path).unwrap_err().to_string();
            let why = if path.is_dir() { "it is a folder" } else { "not a regular file" };
            assert_eq!(error, format!("cannot read {}: {why}", path.display()));
        }
        std::fs::remove_file(&fifo).unwrap();
        let full = "#".repeat(1 << 20);
        assert_eq!(refused("full", &full), "");
        assert!(refused("fuller", &format!("{full}#")).ends_with("larger than 1 MiB"));
    }

    #[test]
    fn impossible_device_values_are_refused_with_line_number() {
        let told =
            |key: &str| refused("values", &format!("[[effector]]\nname = \"track\"\n\n{key}\n"));

        let nine = told("max_currents = [1, 1, 1, 1, 1, 1, 1, 1, 1]");
        assert!(nine.contains(".toml:4: max_currents: expected 8 numbers"), "{nine}");
        for (amperes, good) in [
            ("nan", false),
            ("-5", false),
            ("1e9", false),
            ("inf", false),
            ("0", false),
            ("65.6", false),
            ("65.5", true),
        ] {
            let told = told(&format!("max_currents = [0, 1, 1, {amperes}, 1, 1, 1, 1]"));
            assert_eq!(told.is_empty(), good, "{amperes}: {told}");
            assert!(good || told.contains(".toml:4: max_currents: axis 3: "), "{told}");
        }
        assert!(told("max_currents = [-1, 1, 1, 1, 1, 1, 1, 1]").contains("axis 0: -1 A"));
        for (key, good) in [
            ("counts_per_newton = 0.0", false),
            ("counts_per_newton = nan", false),
            ("counts_per_newton_metre = -1.0", false),
            ("counts_per_newton_metre = inf", false),
            ("counts_per_newton = 1000", true),
            ("max_currents = []", true),
        ] {
            let told = told(key);
            assert_eq!(told.is_empty(), good, "{key}: {told}");
            assert!(good || told.contains(".toml:4: a scale must be a number above 0"), "{told}");
        }
    }

    #[test]
    fn only_arm_with_track_needs_track_current() {
        let mut max_currents = vec![1.0; AXES + 1];
        max_currents[0] = 0.0;
        let devices = EffectorDevices { max_currents, ..EffectorDevices::default() };

        assert!(devices.limits(true).unwrap_err().to_string().contains("axis 0"));
        assert_eq!(devices.limits(false).unwrap()[1..], [1.0; AXES]);
    }

    #[test]
    fn serial_line_named_twice_is_refused() {
        let told = refused(
            "twice",
            "[[effector]]\nname = \"a\"\naxes = [\"\", \"/dev/nosuch1\",\n\"/dev/nosuch2\"]\n\
             force = \"none\"\n\
             [[effector]]\nname = \"b\"\nforce = \"none\"\n\
             axes = [\"\",\n\"/dev/nosuch2\"]\n",
        );
        assert!(told.ends_with(".toml:10: /dev/nosuch2 is named twice"), "{told}");

        let sensor = refused(
            "shared",
            "[[effector]]\naxes = [\"\", \"/dev/./null\"]\nforce = \"ft_controller:/dev/null\"\n",
        );
        assert!(sensor.ends_with(".toml:3: /dev/null is named twice"), "{sensor}");
    }

    #[test]
    fn camera_needs_exactly_one_device() {
        let camera = |keys: &str| refused("camera", &format!("[[camera]]\nname = \"c\"\n{keys}\n"));

        assert_eq!(camera("socket = \"/tmp/s\""), "");
        assert_eq!(camera("v4l2 = { device = \"A1\" }"), "");
        assert!(camera("").contains(".toml:1: camera \"c\" has no device: name a socket"));
        let both = camera("socket = \"/tmp/s\"\nv4l2 = { device = \"A1\" }");
        assert!(both.contains(".toml:1: camera \"c\" has both a socket and a v4l2"), "{both}");
        for (keys, wanted) in [
            ("format = \"h264\"", "unknown variant `h264`"),
            ("exposure_ms = 0.0", "exposure_ms: 0 ms is outside 0.1 to 10000 ms"),
            ("exposure_ms = nan", "exposure_ms: NaN ms is outside"),
            ("white_balance_k = 10", "white_balance_k: 10 K is outside 1000 to 20000 K"),
            ("gain = 3", "unknown field `gain`"),
        ] {
            let told = camera(&format!("[camera.v4l2]\ndevice = \"A1\"\n{keys}"));
            assert!(told.contains(wanted) && told.contains(".toml:"), "{keys}: {told}");
        }
    }

    #[test]
    fn webcam_of_two_cameras_is_refused() {
        let camera = |name: &str, device: &str| {
            format!("[[camera]]\nname = \"{name}\"\n[camera.v4l2]\ndevice = \"{device}\"\n")
        };
        let told = refused("webcams", &(camera("a", "/dev/null") + &camera("b", "/dev/./null")));
        assert!(told.ends_with(".toml:8: /dev/./null is named twice"), "{told}");

        let text = camera("a", "A1") + &camera("b", "B2");
        assert!(parse(&text).unwrap().has_several_webcams());
        assert!(!parse(&camera("a", "A1")).unwrap().has_several_webcams());
    }

    #[test]
    fn default_path_prefers_user_folder() {
        let name = "rubik-robot-devices.toml";
        let (own, temporary) = (std::env::temp_dir(), PathBuf::from("/elsewhere"));

        assert_eq!(place(Some(own.clone().into()), temporary.clone()), own.join(name));
        // The folder "src" is there.
        for none in [None, Some(""), Some("src"), Some("/no/such/folder")] {
            let place = place(none.map(OsString::from), temporary.clone());
            assert_eq!(place, temporary.join(name), "{none:?}");
        }
    }

    #[test]
    fn error_of_unknown_sensor_states_expected_form() {
        let refused = |force: &str| {
            let devices = EffectorDevices { force: force.into(), ..EffectorDevices::default() };
            devices.sensor([1.0; 6]).err().map(|e| e.to_string()).unwrap_or_default()
        };

        assert!(refused("ati").contains("expected net_ft:"));
        assert!(refused("net_ft:somewhere").contains("49152"));
        assert!(refused("ft_controller:/dev/nosuch").contains("/dev/nosuch"));
        assert_eq!(refused("none"), "");
    }

    #[test]
    fn isa_card_defaults_to_original_robots_settings() {
        let scenario = crate::tasks::read(Path::new("t.toml"), "", &[]).unwrap();
        let [track, postument] = &scenario.controller.cell.arms[..] else { panic!("two arms") };
        let card = IsaDevice::default();

        let of_track = card.arm(track, &[]).unwrap();
        assert_eq!((of_track.first_pointer, of_track.divisor), (0xc0, 4));
        assert_eq!(of_track.max_currents, [0x30, 0x30, 0x30, 0x30, 0x30, 0x30, 0x10, 0x27]);
        let beyond = card.arm(postument, &[0.0, 18.7]).err().unwrap_or_default();
        assert!(beyond.contains("axis 1: 18.7 A are 256 units"), "{beyond}");
        assert!(card.arm(track, &[0.0, 2.0]).is_err());
        let of_postument = card.arm(postument, &[0.0, 2.0]).unwrap();
        assert_eq!((of_postument.first_pointer, of_postument.divisor), (0xc1, 8));
        assert_eq!(of_postument.max_currents[1..], [27, 0xff, 0xff, 0xff, 0xff, 0x10, 0x20]);
        assert_eq!(of_postument.kinds[5], AxisKind::Encoder { sync_high: false });

        let of_2008: IsaDevice =
            toml::from_str("divisor = 16\nsync_active_high = [1, 2, 3, 4, 5]\npower_axis = 2")
                .unwrap();
        let of_2008 = of_2008.arm(postument, &[]).unwrap();
        assert_eq!((of_2008.divisor, of_2008.power_axis), (16, 2));
        assert_eq!(of_2008.kinds[5], AxisKind::Encoder { sync_high: true });
        assert_eq!(of_2008.kinds[6], AxisKind::Encoder { sync_high: false });

        let refused = |card: IsaDevice| card.arm(track, &[]).err().unwrap_or_default();
        let resolvers = refused(IsaDevice { resolvers: vec![2], ..IsaDevice::default() });
        assert!(resolvers.contains("axis 2 has 4000") && resolvers.contains("682"), "{resolvers}");
        let units = refused(IsaDevice { units_per_ampere: vec![1.0], ..IsaDevice::default() });
        assert!(units.contains("8 numbers"), "{units}");
        assert!(refused(IsaDevice { power_axis: 8, ..IsaDevice::default() }).contains("axis 8"));
    }
}
