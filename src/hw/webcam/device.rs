//! A video device, as far as a camera of this program uses it.
//!
//! The trait stands between this program and the operating system, so that tests need no device.
//!
//! - in: formats, sizes and controls that are wanted
//! - out: what the device has and gives: its formats, and buffers with their age

use std::fmt;
use std::io;
use std::path::Path;
use std::time::Duration;

/// Longest wait for a picture. In dim light a webcam takes 5 pictures a second or fewer.
pub const PATIENCE: Duration = Duration::from_secs(1);

/// Code of a pixel format: four characters.
pub type FourCc = [u8; 4];

/// Size of a picture: columns and rows (px).
pub type Size = (u32, u32);

/// Pixel format that this program reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Encoding {
    /// Two bytes a pixel, uncompressed; two neighbours share their colour.
    Yuyv,
    /// A JPEG picture, which may leave out the standard Huffman tables.
    Mjpeg,
}

impl Encoding {
    /// All encodings.
    pub const ALL: [Self; 2] = [Self::Yuyv, Self::Mjpeg];

    /// Returns the code of the format.
    #[must_use]
    pub fn code(self) -> FourCc {
        match self {
            Self::Yuyv => *b"YUYV",
            Self::Mjpeg => *b"MJPG",
        }
    }

    /// Returns the encoding with a code; `None` for a format that this program does not read.
    #[must_use]
    pub fn of(code: FourCc) -> Option<Self> {
        Self::ALL.into_iter().find(|encoding| encoding.code() == code)
    }
}

impl fmt::Display for Encoding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&name_of(self.code()))
    }
}

/// Returns the code of a format as text, in which other characters than those of ASCII are dots.
#[must_use]
pub fn name_of(code: FourCc) -> String {
    code.iter().map(|&b| if b.is_ascii_graphic() { char::from(b) } else { '.' }).collect()
}

/// Sizes that a device has in one format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sizes {
    /// One size.
    One(Size),
    /// Sizes from the least to the greatest, at equal steps.
    Steps {
        /// Least size.
        least: Size,
        /// Greatest size.
        most: Size,
        /// Steps of width and height.
        step: Size,
    },
}

impl Sizes {
    /// Returns the size of these that is nearest to `wanted`.
    #[must_use]
    pub fn nearest(&self, wanted: Size) -> Size {
        match *self {
            Self::One(size) => size,
            Self::Steps { least, most, step } => {
                let near = |wanted: u32, least: u32, most: u32, step: u32| {
                    let inside = wanted.clamp(least, most.max(least));
                    inside - (inside - least) % step.max(1)
                };
                (near(wanted.0, least.0, most.0, step.0), near(wanted.1, least.1, most.1, step.1))
            }
        }
    }
}

impl fmt::Display for Sizes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::One((width, height)) => write!(f, "{width}x{height}"),
            Self::Steps { least, most, .. } => {
                write!(f, "{}x{} to {}x{}", least.0, least.1, most.0, most.1)
            }
        }
    }
}

/// A format that a device offers, with its sizes. Some drivers list no sizes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Offer {
    /// Code of the format.
    pub code: FourCc,
    /// Its sizes.
    pub sizes: Vec<Sizes>,
}

/// The format in which a device delivers pictures. A driver may give another one than was asked
/// for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Format {
    /// Code of the pixel format.
    pub code: FourCc,
    /// Size of a picture.
    pub size: Size,
    /// Bytes of a line, which may be longer than its pixels; 0 if the driver does not say.
    pub stride: usize,
    /// Whether the levels of `YUYV` are 0 to 255, not 16 to 235.
    pub full_range: bool,
}

/// Identity of a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Card {
    /// Name of the camera.
    pub name: String,
    /// Whether the device delivers pictures. A webcam has a second device for metadata.
    pub has_pictures: bool,
}

/// Control of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Control {
    /// Choice of the exposure: 1 is by hand.
    ExposureMode,
    /// Exposure time (0.1 ms).
    Exposure,
    /// Whether the camera chooses the white balance: 0 or 1.
    AutomaticWhite,
    /// Temperature of white light (K).
    White,
}

/// A buffer that a device has filled.
#[derive(Debug, Clone, PartialEq)]
pub struct Buffer {
    /// Bytes of the picture.
    pub bytes: Vec<u8>,
    /// Whether the driver marks the bytes as damaged.
    pub damaged: bool,
    /// Time since the exposure; `None` if the driver does not say.
    pub age: Option<Duration>,
}

/// An open video device. Dropping it closes the device.
pub trait VideoDevice: Send {
    /// Returns the identity of the device.
    ///
    /// # Errors
    /// The error of the operating system, here and in the other functions.
    fn card(&self) -> io::Result<Card>;

    /// Returns the formats that the device offers.
    ///
    /// # Errors
    /// See [`Self::card`].
    fn offers(&self) -> io::Result<Vec<Offer>>;

    /// Asks for a format while no stream runs; returns the one that the device gives instead.
    ///
    /// # Errors
    /// See [`Self::card`].
    fn set_format(&mut self, code: FourCc, size: Size) -> io::Result<Format>;

    /// Sets a control; returns the value that the device reports afterwards.
    ///
    /// # Errors
    /// See [`Self::card`].
    fn set_control(&mut self, control: Control, value: i64) -> io::Result<i64>;

    /// Starts the stream and waits for its first buffer, which is dropped.
    ///
    /// # Errors
    /// See [`Self::card`]. After an error no stream runs.
    fn start(&mut self) -> io::Result<()>;

    /// Returns the oldest filled buffer; `None` if no buffer is filled within `wait`.
    ///
    /// # Errors
    /// See [`Self::card`].
    fn next(&mut self, wait: Duration) -> io::Result<Option<Buffer>>;
}

/// Function that opens the device at a path.
pub type Opener = Box<dyn FnMut(&Path) -> io::Result<Box<dyn VideoDevice>> + Send>;
