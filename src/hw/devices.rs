//! Where the hardware is: the devices behind the effectors and cameras of a cell, as a file tells them.
//!
//! The file belongs to a machine, not to a scenario: `rubik-robot emulate` writes one, a workshop writes its own.

use super::force::{ForceSource, FtController, NetFt, NoSensor};
use super::note::Notes;
use super::port::Port;
use super::serial::axis::Rules;
use super::serial::{AXIS_BAUD, Line, SerialArm, SerialPort};
use crate::cell::Arm;
use crate::motion::AXES;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// All devices.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Devices {
    /// By effector.
    #[serde(default)]
    pub effector: Vec<EffectorDevices>,
    /// By camera.
    #[serde(default)]
    pub camera: Vec<CameraDevice>,
}

/// The devices of an effector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EffectorDevices {
    /// Its name in the scenario.
    pub name: String,
    /// Serial lines of the axes: the track, q1 to q6, the jaw; "" where there is none. For bridge.kind = "serial".
    pub axes: Vec<String>,
    /// `net_ft:ADDRESS:PORT`, `ft_controller:DEVICE`, or "none".
    pub force: String,
    /// Scale of a Net F/T box, from its configuration page [1/N].
    pub counts_per_newton: f64,
    /// As above [1/Nm].
    pub counts_per_newton_metre: f64,
    /// Limits of the motor currents of axes 0..=6 [A]; none are set where they are left out.
    pub max_currents: Vec<f64>,
    /// Its ISA card. For bridge.kind = "isa".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub isa: Option<IsaDevice>,
}

/// An ISA card.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IsaDevice {
    /// Added to every port of the card.
    pub offset: u16,
    /// Pointer of the first axis: 0xc0 of the track's card, 0xc1 of the postument's.
    pub first_pointer: u8,
    /// Axes with resolvers instead of encoders.
    pub resolvers: Vec<usize>,
    /// Units of motor current per ampere, the jaw's last.
    pub units_per_ampere: Vec<f64>,
    /// Device of the card's interrupt, as `/dev/uio0`; without one the card is not watched.
    pub uio: Option<String>,
}

impl Default for IsaDevice {
    fn default() -> Self {
        // 13.7 units an ampere, and 25.3 per 100 mA of the jaw: notes of the 2008 sources.
        let units_per_ampere = vec![13.7, 13.7, 13.7, 13.7, 13.7, 13.7, 13.7, 253.0];
        Self { offset: 0, first_pointer: 0xc1, resolvers: Vec::new(), units_per_ampere, uio: None }
    }
}

impl Default for EffectorDevices {
    fn default() -> Self {
        Self {
            name: String::new(),
            axes: Vec::new(),
            force: "none".to_owned(),
            counts_per_newton: 1e6,
            counts_per_newton_metre: 1e6,
            max_currents: Vec::new(),
            isa: None,
        }
    }
}

/// The device of a camera.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraDevice {
    /// Its name in the scenario.
    pub name: String,
    /// Local socket that gives frames: see [`super::socket_camera`].
    pub socket: PathBuf,
}

/// A device is not there, or not what the file says.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NoDevice(pub String);

impl Devices {
    /// Reads a file.
    ///
    /// # Errors
    /// What is wrong with it, and where.
    pub fn load(path: &Path) -> Result<Self, NoDevice> {
        let fail = |why: &str| NoDevice(format!("{}: {why}", path.display()));
        let text = std::fs::read_to_string(path).map_err(|e| fail(&e.to_string()))?;
        toml::from_str(&text).map_err(|error| {
            let line = error.span().map_or(1, |s| text[..s.start].matches('\n').count() + 1);
            NoDevice(format!("{}:{line}: {}", path.display(), error.message()))
        })
    }

    /// As a file.
    ///
    /// # Errors
    /// [`NoDevice`] when it cannot be written down: never, for devices with names of text.
    pub fn text(&self) -> Result<String, NoDevice> {
        toml::to_string(self).map_err(|e| NoDevice(e.to_string()))
    }

    /// The devices of an effector.
    ///
    /// # Errors
    /// There are none.
    pub fn of_effector(&self, name: &str) -> Result<&EffectorDevices, NoDevice> {
        let found = self.effector.iter().find(|e| e.name == name);
        found.ok_or_else(|| NoDevice(format!("the devices have no [[effector]] \"{name}\"")))
    }

    /// The device of a camera.
    ///
    /// # Errors
    /// There is none.
    pub fn of_camera(&self, name: &str) -> Result<&CameraDevice, NoDevice> {
        let found = self.camera.iter().find(|c| c.name == name);
        found.ok_or_else(|| NoDevice(format!("the devices have no [[camera]] \"{name}\"")))
    }

    /// Opens the serial bridge to these arms.
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
                    max_currents: std::array::from_fn(|i| devices.max_currents.get(i).copied()),
                    force: devices.sensor(arm.sensor.range)?,
                })
            })
            .collect::<Result<Vec<_>, NoDevice>>()?;
        Ok(SerialPort::new(arms, rules, notes))
    }

    /// Opens the bridge to these arms' ISA cards.
    ///
    /// # Errors
    /// The first card that cannot be used.
    #[cfg(feature = "isa")]
    pub fn isa(&self, arms: &[Arm], notes: Notes) -> Result<Box<dyn Port>, NoDevice> {
        use super::isa::registers::AxisKind;
        use super::isa::{IsaArm, IsaPort, PortIo};
        let arms = arms
            .iter()
            .map(|arm| {
                let devices = self.of_effector(&arm.name)?;
                let fail = |why: &str| NoDevice(format!("effector \"{}\", isa: {why}", arm.name));
                let card = devices.isa.as_ref().ok_or_else(|| fail("no card is named"))?;
                let units: Result<[f64; AXES + 1], _> = card.units_per_ampere.as_slice().try_into();
                Ok(IsaArm {
                    name: arm.name.clone(),
                    registers: PortIo::open(card.offset, card.uio.as_deref())
                        .map_err(|e| fail(&e))?,
                    first_pointer: card.first_pointer,
                    has_track: arm.model.has_track,
                    kinds: std::array::from_fn(|i| {
                        if card.resolvers.contains(&i) {
                            AxisKind::Resolver
                        } else {
                            AxisKind::Encoder
                        }
                    }),
                    units_per_ampere: units
                        .map_err(|_| fail("units_per_ampere wants 8 numbers"))?,
                    max_currents: std::array::from_fn(|i| devices.max_currents.get(i).copied()),
                    force: devices.sensor(arm.sensor.range)?,
                })
            })
            .collect::<Result<Vec<_>, NoDevice>>()?;
        Ok(Box::new(IsaPort::new(arms, notes)))
    }

    /// Refuses: without the feature `isa` there are no ports.
    ///
    /// # Errors
    /// Always.
    #[cfg(not(feature = "isa"))]
    pub fn isa(&self, _: &[Arm], _: Notes) -> Result<Box<dyn Port>, NoDevice> {
        let how = "this program was built without port instructions: cargo build --release --features isa";
        Err(NoDevice(how.to_owned()))
    }
}

impl EffectorDevices {
    fn lines(&self, has_track: bool) -> Result<[Option<Line>; AXES + 1], NoDevice> {
        let mut lines = [const { None }; AXES + 1];
        for (axis, slot) in lines.iter_mut().enumerate() {
            let path = self.axes.get(axis).map_or("", String::as_str);
            let wanted = axis > 0 || has_track;
            if wanted && path.is_empty() {
                let name = &self.name;
                return Err(NoDevice(format!(
                    "effector \"{name}\": axis {axis} has no line; `axes` names {} devices: the track's (or \"\"), \
                     q1 to q6, the jaw's",
                    AXES + 1
                )));
            }
            if wanted {
                let open = |e| NoDevice(format!("effector \"{}\", axis {axis}: {e}", self.name));
                *slot = Some(Line::open(path, AXIS_BAUD, true).map_err(open)?);
            }
        }
        Ok(lines)
    }

    /// Opens the force sensor, whose readings are to lie in `range` [N, Nm].
    ///
    /// # Errors
    /// It is not there.
    pub fn sensor(&self, range: [f64; 6]) -> Result<Box<dyn ForceSource>, NoDevice> {
        let fail = |why: String| {
            NoDevice(format!("effector \"{}\", force = \"{}\": {why}", self.name, self.force))
        };
        if self.force == "none" {
            return Ok(Box::new(NoSensor));
        }
        match self.force.split_once(':') {
            Some(("net_ft", address)) => {
                let address = address.parse().map_err(|_| {
                    fail("wanted an address and a port, as in 192.168.1.1:49152".into())
                })?;
                let (newton, metre) = (self.counts_per_newton, self.counts_per_newton_metre);
                let sensor = NetFt::connect(address, newton, metre, range);
                Ok(Box::new(sensor.map_err(|e| fail(e.to_string()))?))
            }
            Some(("ft_controller", path)) => {
                Ok(Box::new(FtController::open(path, None, range).map_err(fail)?))
            }
            _ => Err(fail("wanted net_ft:ADDRESS:PORT, ft_controller:DEVICE or none".into())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_comes_back_and_its_faults_have_a_line() {
        let devices = Devices {
            effector: vec![EffectorDevices {
                name: "track".into(),
                axes: vec!["/dev/ttyMI0".into(), String::new()],
                force: "net_ft:192.168.1.1:49152".into(),
                ..EffectorDevices::default()
            }],
            camera: vec![CameraDevice { name: "standalone".into(), socket: "/tmp/s".into() }],
        };
        let text = devices.text().unwrap();
        let path = std::env::temp_dir().join(format!("rubik-devices-{}.toml", std::process::id()));

        std::fs::write(&path, &text).unwrap();
        assert_eq!(Devices::load(&path), Ok(devices));
        std::fs::write(&path, format!("{text}\nspeed = 3\n")).unwrap();
        let wrong = Devices::load(&path).unwrap_err().to_string();
        std::fs::remove_file(&path).unwrap();
        assert!(wrong.contains("unknown field `speed`") && wrong.contains(".toml:"), "{wrong}");
        assert!(Devices::load(&path).unwrap_err().to_string().contains("No such file"));
    }

    #[test]
    fn a_sensor_that_is_none_is_refused_with_what_is_wanted() {
        let refused = |force: &str| {
            let devices = EffectorDevices { force: force.into(), ..EffectorDevices::default() };
            devices.sensor([1.0; 6]).err().map(|e| e.to_string()).unwrap_or_default()
        };

        assert!(refused("ati").contains("wanted net_ft:"));
        assert!(refused("net_ft:somewhere").contains("49152"));
        assert!(refused("ft_controller:/dev/nosuch").contains("/dev/nosuch"));
        assert_eq!(refused("none"), "");
    }
}
