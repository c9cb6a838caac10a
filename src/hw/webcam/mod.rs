//! A webcam as a camera: a device of V4L2 (Video for Linux).
//!
//! Only `v4l2` calls the operating system, in a program that is built with the feature of this
//! name. All else is tested with a device that plays pictures.
//!
//! - in: a device by path or serial number, the wanted size, exposure and white balance
//! - out: frames with the servo period of their exposure
//!
//! | fault | limit | consequence |
//! |---|---|---|
//! | dark first pictures | `SETTLING`, `FIXED` | dropped when the stream starts |
//! | pictures of before a pause | `STALE` | dropped: the driver keeps the oldest ones |
//! | damaged picture | `MOST_DAMAGED` | the next one is taken |
//! | no picture, device gone | `PATIENCE` | error; the next call opens the device again |
//! | device in use | - | refused with the name of the other program |
//! | node of metadata | - | refused with the node that has pictures |

pub mod device;
mod holder;
pub mod negotiation;
pub mod nodes;
pub mod pixels;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(feature = "v4l2")]
mod v4l2;

use super::camera::{Frame, FrameSource, NoFrame};
use crate::motion::PERIOD;
use device::{Control, Encoding, Format, Opener, PATIENCE, VideoDevice};
use holder::holder;
use image::RgbImage;
use negotiation::{Trouble, Wish, negotiate};
use nodes::Nodes;
use rustix::io::Errno;
use serde::{Deserialize, Deserializer, Serialize, de::Error as _};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Pictures that are dropped at the start while the camera adapts its exposure: half a second.
pub(crate) const SETTLING: usize = 15;
/// Pictures that are dropped after a change of a fixed exposure: it acts on a later picture.
const FIXED: usize = 3;
/// Age from which a waiting picture is dropped for the next one. Sensors refuse pictures that are
/// older than 100 ms.
const STALE: Duration = Duration::from_millis(80);
/// Greatest number of damaged pictures in a row.
const MOST_DAMAGED: usize = 5;
/// Greatest number of waiting buffers: more than a driver gives.
const MOST_WAITING: usize = 32;
/// Unit of [`Control::Exposure`] (ms).
const EXPOSURE_UNIT: f64 = 0.1;

/// Settings of a webcam in a file of devices.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WebcamDevice {
    /// Device: a path, best a link in `/dev/v4l/by-id`, or the serial number of the camera.
    pub device: String,
    /// Encoding of the pictures: "yuyv" or "mjpeg". Without this key the better one is chosen that
    /// the camera has and the bus has room for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub format: Option<Encoding>,
    /// Exposure time (ms). Without this key the camera chooses it.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "exposure")]
    pub exposure_ms: Option<f64>,
    /// Temperature of the light that is shown as white (K). Without this key the camera chooses it.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "white")]
    pub white_balance_k: Option<u32>,
}

impl WebcamDevice {
    /// Returns a device without settings of its own.
    #[must_use]
    pub fn named(device: &str) -> Self {
        let device = device.to_owned();
        Self { device, format: None, exposure_ms: None, white_balance_k: None }
    }

    /// Returns the reason why an exposure time (ms) cannot be set; `None` if it can.
    #[must_use]
    pub fn refuses_exposure(time: f64) -> Option<String> {
        let range = EXPOSURE_UNIT..=10_000.0;
        (!range.contains(&time))
            .then(|| format!("exposure_ms: {time} ms is outside {EXPOSURE_UNIT} to 10000 ms"))
    }

    /// Returns the reason why a white balance (K) cannot be set; `None` if it can.
    #[must_use]
    pub fn refuses_white(kelvin: u32) -> Option<String> {
        (!(1_000..=20_000).contains(&kelvin))
            .then(|| format!("white_balance_k: {kelvin} K is outside 1000 to 20000 K"))
    }
}

/// Reads an exposure time, and refuses one that no camera has.
fn exposure<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    let time = f64::deserialize(from)?;
    WebcamDevice::refuses_exposure(time).map_or(Ok(Some(time)), |why| Err(D::Error::custom(why)))
}

/// Reads a white balance, and refuses one that no camera has.
fn white<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u32>, D::Error> {
    let kelvin = u32::deserialize(from)?;
    WebcamDevice::refuses_white(kelvin).map_or(Ok(Some(kelvin)), |why| Err(D::Error::custom(why)))
}

/// Reason why this program opens no webcam, with what to do.
pub const NO_WEBCAMS: &str = "this program cannot open V4L2 cameras: build it with `cargo build \
                              --release --features v4l2`, which needs libclang";

/// Opens a webcam. `name` is that of the camera in messages.
///
/// # Errors
/// [`NoFrame`] with the reason.
#[cfg(feature = "v4l2")]
pub fn open(
    name: &str,
    settings: &WebcamDevice,
    wish: Wish,
) -> Result<Box<dyn FrameSource>, NoFrame> {
    let opener: Opener = Box::new(v4l2::open);
    Ok(Box::new(Webcam::open(name, settings, wish, (Nodes::default(), opener))?))
}

/// Refuses to open a webcam: without the feature `v4l2` the program cannot.
///
/// # Errors
/// [`NoFrame`] always, with what to do.
#[cfg(not(feature = "v4l2"))]
pub fn open(name: &str, settings: &WebcamDevice, _: Wish) -> Result<Box<dyn FrameSource>, NoFrame> {
    let reason = format!("{}: {NO_WEBCAMS}", settings.device);
    Err(NoFrame { camera: name.to_owned(), reason })
}

/// A webcam.
pub struct Webcam {
    name: String,
    settings: WebcamDevice,
    wish: Wish,
    nodes: Nodes,
    opener: Opener,
    /// Stream of the device; `None` after an error.
    stream: Option<Stream>,
}

/// A device that delivers pictures.
struct Stream {
    path: PathBuf,
    device: Box<dyn VideoDevice>,
    format: Format,
    /// Exposure that is set, in the units of its control; `None` if the camera chooses.
    exposure: Option<i64>,
}

impl Webcam {
    /// Opens a webcam with the list of the machine's nodes and the function that opens one.
    ///
    /// # Errors
    /// [`NoFrame`] with the reason.
    pub fn open(
        name: &str,
        settings: &WebcamDevice,
        wish: Wish,
        (nodes, opener): (Nodes, Opener),
    ) -> Result<Self, NoFrame> {
        let (name, settings) = (name.to_owned(), settings.clone());
        let wish = Wish { only: settings.format.or(wish.only), ..wish };
        let mut this = Self { name, settings, wish, nodes, opener, stream: None };
        this.stream = Some(this.start(1.0).map_err(|why| this.refuse(why))?);
        Ok(this)
    }

    /// Returns the error of this camera with a reason.
    fn refuse(&self, reason: String) -> NoFrame {
        NoFrame { camera: self.name.clone(), reason }
    }

    /// Opens the device, agrees on a format, sets the controls and drops the first pictures.
    fn start(&mut self, exposure: f64) -> Result<Stream, String> {
        let path = self.nodes.find(&self.settings.device)?;
        let fail = |why: io::Error| explain(&path, &why);
        let mut device = (self.opener)(&path).map_err(fail)?;
        if !device.card().map_err(fail)?.has_pictures {
            let other = self.nodes.with_pictures(&path);
            let other = other.map(|other| format!(": its pictures come from {}", other.display()));
            let other = other.unwrap_or_default();
            return Err(format!("{} delivers metadata, no pictures{other}", path.display()));
        }
        let format = negotiate(device.as_mut(), &self.wish).map_err(|why| match why {
            Trouble::System(why) => explain(&path, &why),
            Trouble::Refused(why) => format!("{}: {why}", path.display()),
        })?;
        let time = self.settings.exposure_ms;
        let units = time.map(|time| in_units(time, 1.0));
        let mut stream = Stream { path, device, format, exposure: units };
        // Some cameras forget their controls when a stream starts, so they are set afterwards.
        stream.set_controls(&self.settings)?;
        let fixed = self.settings.exposure_ms.is_some() && self.settings.white_balance_k.is_some();
        stream.skip(if fixed { FIXED } else { SETTLING })?;
        // The camera may refuse its fixed time, but not a multiple of it.
        stream.expose(time, exposure)?;
        Ok(stream)
    }
}

impl FrameSource for Webcam {
    /// Returns the newest picture. The exposure is scaled only if its time is fixed by the
    /// settings. After an error the next call opens the device again.
    fn grab(&mut self, period: u64, exposure: f64) -> Result<Frame, NoFrame> {
        let asked = Instant::now();
        // A device that was lost may be back, perhaps as another node.
        let stream = match self.stream.take() {
            Some(stream) => Ok(stream),
            None => self.start(exposure),
        };
        let mut stream = stream.map_err(|why| self.refuse(why))?;
        // The worker that waits for a picture has 3 s in all.
        if asked.elapsed() > PATIENCE {
            self.stream = Some(stream);
            return Err(self.refuse("it was opened again".to_owned()));
        }
        let time = self.settings.exposure_ms;
        let taken = stream.expose(time, exposure).and_then(|()| stream.newest());
        let (image, age) = taken.map_err(|why| self.refuse(why))?;
        self.stream = Some(stream);
        // The exposure may be earlier or later than the request.
        let since = asked.elapsed().as_secs_f64() - age.unwrap_or_default().as_secs_f64();
        let period = period.saturating_add_signed((since / PERIOD).round() as i64);
        Ok(Frame { period, image })
    }
}

impl Stream {
    /// Returns the text of an error of this device.
    fn explain(&self, why: &io::Error) -> String {
        explain(&self.path, why)
    }

    /// Sets exposure and white balance, or hands them to the camera.
    fn set_controls(&mut self, settings: &WebcamDevice) -> Result<(), String> {
        match settings.exposure_ms {
            Some(time) => {
                self.fix(Control::ExposureMode, 1, "exposure_ms")?;
                self.fix(Control::Exposure, in_units(time, 1.0), "exposure_ms")?;
            }
            // Another program may have left the camera with a fixed exposure: 3 is by aperture
            // priority, the only automatic mode of webcams. A camera without it stays as it is.
            None => drop(self.device.set_control(Control::ExposureMode, 3)),
        }
        if let Some(kelvin) = settings.white_balance_k {
            self.fix(Control::AutomaticWhite, 0, "white_balance_k")?;
            self.fix(Control::White, i64::from(kelvin), "white_balance_k")?;
        } else {
            drop(self.device.set_control(Control::AutomaticWhite, 1));
        }
        Ok(())
    }

    /// Sets a control, and checks that the camera takes the value. `key` is that of the setting.
    fn fix(&mut self, control: Control, value: i64, key: &str) -> Result<(), String> {
        let path = self.path.display();
        match self.device.set_control(control, value) {
            Ok(set) if set == value => Ok(()),
            Ok(set) => {
                let shown = |value: i64| match control {
                    Control::Exposure => format!("{:.1} ms", value as f64 * EXPOSURE_UNIT),
                    Control::White => format!("{value} K"),
                    Control::ExposureMode | Control::AutomaticWhite => format!("mode {value}"),
                };
                let (set, value) = (shown(set), shown(value));
                Err(format!("{path}: {key}: the camera takes {set} instead of {value}"))
            }
            Err(why) if why.raw_os_error() == Some(Errno::NODEV.raw_os_error()) => {
                Err(self.explain(&why))
            }
            Err(why) => {
                Err(format!("{path}: {key}: the camera cannot fix it ({why}): leave the key out"))
            }
        }
    }

    /// Sets the exposure to `scale` times the fixed `time` (ms). Without a fixed time the camera
    /// chooses.
    fn expose(&mut self, time: Option<f64>, scale: f64) -> Result<(), String> {
        let units = time.map(|time| in_units(time, scale));
        let Some(set) = units.filter(|_| units != self.exposure) else { return Ok(()) };
        // A camera that cannot expose for as long takes its longest time, and says so here.
        self.device.set_control(Control::Exposure, set).map_err(|why| self.explain(&why))?;
        self.exposure = units;
        self.skip(FIXED)
    }

    /// Drops the next `count` pictures.
    fn skip(&mut self, count: usize) -> Result<(), String> {
        let begun = Instant::now();
        for _ in 0..count {
            // A camera that is slow in dim light has had time to settle.
            if begun.elapsed() > PATIENCE {
                break;
            }
            self.device.next(PATIENCE).map_err(|why| self.explain(&why))?;
        }
        Ok(())
    }

    /// Returns the newest picture and the time since its exposure, if the driver tells it.
    fn newest(&mut self) -> Result<(RgbImage, Option<Duration>), String> {
        let (mut damage, begun) = (String::new(), Instant::now());
        for _ in 0..MOST_DAMAGED {
            if begun.elapsed() > PATIENCE {
                break;
            }
            let buffer = self.newest_buffer()?;
            if buffer.damaged {
                "the driver marks the picture as damaged".clone_into(&mut damage);
                continue;
            }
            match pixels::picture(&buffer.bytes, &self.format) {
                Ok(image) => return Ok((image, buffer.age)),
                Err(why) => damage = why,
            }
        }
        let path = self.path.display();
        Err(format!("{path}: all pictures are damaged: {damage}"))
    }

    /// Returns the newest buffer: of those that wait if it is fresh, otherwise the next one.
    fn newest_buffer(&mut self) -> Result<device::Buffer, String> {
        let mut newest = None;
        for _ in 0..MOST_WAITING {
            let waiting = self.device.next(Duration::ZERO).map_err(|why| self.explain(&why))?;
            let Some(buffer) = waiting else { break };
            newest = Some(buffer);
        }
        // The driver fills its few buffers and then waits: after a pause all of them are old.
        if let Some(fresh) = newest.filter(|buffer| buffer.age.is_some_and(|age| age < STALE)) {
            return Ok(fresh);
        }
        let next = self.device.next(PATIENCE).map_err(|why| self.explain(&why))?;
        next.ok_or_else(|| self.explain(&io::ErrorKind::TimedOut.into()))
    }
}

/// Returns an exposure time in the units of [`Control::Exposure`]: `time` (ms) times `scale`.
fn in_units(time: f64, scale: f64) -> i64 {
    ((time * scale / EXPOSURE_UNIT).round() as i64).max(1)
}

/// Returns the text of an error of the device at `path`, with what to do.
fn explain(path: &Path, why: &io::Error) -> String {
    let reason = match why.raw_os_error().map(Errno::from_raw_os_error) {
        Some(Errno::NODEV | Errno::NXIO | Errno::NOENT) => {
            "the camera is gone: plug it in again, or check its cable and hub".to_owned()
        }
        Some(Errno::BUSY) => match holder(path) {
            Some((program, number)) => format!("{program} (process {number}) uses the camera"),
            None => "another program uses the camera".to_owned(),
        },
        Some(Errno::ACCESS | Errno::PERM) => {
            "this user may not open it: `sudo usermod -aG video $USER`, then log in again"
                .to_owned()
        }
        Some(Errno::NOTTY) => "not a video device".to_owned(),
        _ if why.kind() == io::ErrorKind::TimedOut => {
            "no picture in time: check cable and hub".to_owned()
        }
        _ => why.to_string(),
    };
    format!("{}: {reason}", path.display())
}

#[cfg(test)]
mod tests;
