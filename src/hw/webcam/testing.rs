//! A video device for tests, which plays given pictures.

use super::device::{
    Buffer, Card, Control, Encoding, Format, FourCc, Offer, Opener, Size, Sizes, VideoDevice,
};
use image::{ImageFormat, RgbImage};
use rustix::io::Errno;
use std::collections::VecDeque;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Event of a stream: a picture with its age, damaged bytes, a pause, or an error.
#[derive(Debug, Clone)]
pub(crate) enum Event {
    /// A picture and its age (ms).
    Picture(RgbImage, u64),
    /// A picture that the driver marks as damaged.
    Damaged(RgbImage),
    /// Bytes that are no picture, without a mark.
    Noise,
    /// No buffer within the wait.
    Nothing,
    /// An error of the operating system.
    Error(i32),
}

/// State of the device that all openings share.
#[derive(Debug, Default)]
pub(crate) struct Played {
    /// Events that follow.
    pub(crate) events: VecDeque<Event>,
    /// Controls that were set, with their values.
    pub(crate) controls: Vec<(Control, i64)>,
    /// Paths that were opened.
    pub(crate) opened: Vec<PathBuf>,
    /// Error of the next openings; 0 for none.
    pub(crate) refuses: i32,
    /// Buffers that were dropped while the stream started.
    pub(crate) started: usize,
}

/// A video device with what a test needs.
#[derive(Debug, Clone)]
pub(crate) struct Fake {
    /// Formats that it offers.
    pub(crate) offers: Vec<Offer>,
    /// Size that it gives instead of any other.
    pub(crate) gives: Option<Size>,
    /// Bytes of a picture for which the bus has room.
    pub(crate) room: u32,
    /// Whether another program uses it.
    pub(crate) busy: bool,
    /// Whether it delivers metadata only.
    pub(crate) no_pictures: bool,
    /// Bytes that follow the pixels of each line.
    pub(crate) padding: usize,
    /// Greatest value of a control; larger ones are reduced to it.
    pub(crate) most: i64,
    /// Shared state.
    pub(crate) played: Arc<Mutex<Played>>,
    /// Format of the stream.
    pub(crate) format: Format,
}

/// Makes an offer of a format with these sizes.
pub(crate) fn offer(code: FourCc, sizes: &[Size]) -> Offer {
    Offer { code, sizes: sizes.iter().copied().map(Sizes::One).collect() }
}

impl Fake {
    /// Makes a device with these offers and no pictures yet.
    pub(crate) fn with(offers: Vec<Offer>) -> Self {
        Self {
            offers,
            gives: None,
            room: u32::MAX,
            busy: false,
            no_pictures: false,
            padding: 0,
            most: i64::MAX,
            played: Arc::default(),
            format: Format { code: *b"YUYV", size: (0, 0), stride: 0, full_range: true },
        }
    }

    /// Makes a device of one size in one encoding, which plays these events.
    pub(crate) fn playing(encoding: Encoding, size: Size, events: Vec<Event>) -> Self {
        let this = Self::with(vec![offer(encoding.code(), &[size])]);
        this.played.lock().unwrap().events = events.into();
        this
    }

    /// Returns a function that opens this device at any path.
    pub(crate) fn opener(&self) -> Opener {
        let this = self.clone();
        Box::new(move |path| {
            let mut played = this.played.lock().unwrap();
            played.opened.push(path.to_owned());
            match played.refuses {
                0 => Ok(Box::new(this.clone()) as Box<dyn VideoDevice>),
                error => Err(io::Error::from_raw_os_error(error)),
            }
        })
    }

    /// Returns the bytes of a picture in the present format.
    fn encode(&self, picture: &RgbImage) -> Vec<u8> {
        if Encoding::of(self.format.code) == Some(Encoding::Yuyv) {
            return yuyv_of(picture, self.format.stride, self.format.full_range);
        }
        let mut file = io::Cursor::new(Vec::new());
        picture.write_to(&mut file, ImageFormat::Jpeg).unwrap();
        file.into_inner()
    }
}

impl VideoDevice for Fake {
    fn card(&self) -> io::Result<Card> {
        Ok(Card { name: "HD Webcam".into(), has_pictures: !self.no_pictures })
    }

    fn offers(&self) -> io::Result<Vec<Offer>> {
        Ok(self.offers.clone())
    }

    fn set_format(&mut self, code: FourCc, size: Size) -> io::Result<Format> {
        if self.busy {
            return Err(Errno::BUSY.into());
        }
        let size = self.gives.unwrap_or(size);
        let stride = 4 * (size.0 as usize).div_ceil(2) + self.padding;
        self.format = Format { code, size, stride, full_range: true };
        Ok(self.format)
    }

    fn set_control(&mut self, control: Control, value: i64) -> io::Result<i64> {
        if self.most == 0 {
            return Err(Errno::INVAL.into());
        }
        self.played.lock().unwrap().controls.push((control, value));
        Ok(value.min(self.most))
    }

    fn start(&mut self) -> io::Result<()> {
        let pixels = self.format.size.0 * self.format.size.1;
        let bytes = if self.format.code == *b"YUYV" { 2 * pixels } else { pixels / 5 };
        self.played.lock().unwrap().started += 1;
        if bytes > self.room { Err(Errno::NOSPC.into()) } else { Ok(()) }
    }

    fn next(&mut self, _: Duration) -> io::Result<Option<Buffer>> {
        let event = self.played.lock().unwrap().events.pop_front();
        let buffer = |bytes, damaged, age| {
            Ok(Some(Buffer { bytes, damaged, age: Some(Duration::from_millis(age)) }))
        };
        match event {
            None | Some(Event::Nothing) => Ok(None),
            Some(Event::Picture(picture, age)) => buffer(self.encode(&picture), false, age),
            Some(Event::Damaged(picture)) => buffer(self.encode(&picture), true, 0),
            Some(Event::Noise) => buffer(vec![0xFF, 0xD8, 1, 2], false, 0),
            Some(Event::Error(error)) => Err(io::Error::from_raw_os_error(error)),
        }
    }
}

/// Converts a picture to YUYV with `stride` bytes a line, which may be padded.
pub(crate) fn yuyv_of(picture: &RgbImage, stride: usize, full_range: bool) -> Vec<u8> {
    let (offset, bright, colour) =
        if full_range { (0.0, 1.0, 1.0) } else { (16.0, 219.0 / 255.0, 224.0 / 255.0) };
    let level = |value: f64| value.round().clamp(0.0, 255.0) as u8;
    let mut bytes = Vec::new();
    for y in 0..picture.height() {
        let start = bytes.len();
        for x in (0..picture.width()).step_by(2) {
            // [brightness, U, V] of both pixels; the last column may stand alone.
            let of = |x: u32| {
                let [r, g, b] = picture[(x.min(picture.width() - 1), y)].0.map(f64::from);
                let luma = 0.299 * r + 0.587 * g + 0.114 * b;
                [luma, (b - luma) / 1.772, (r - luma) / 1.402]
            };
            let (one, two) = (of(x), of(x + 1));
            let mean = |c: usize| level(128.0 + colour * f64::midpoint(one[c], two[c]));
            let luma = |v: f64| level(offset + bright * v);
            bytes.extend([luma(one[0]), mean(1), luma(two[0]), mean(2)]);
        }
        // Padding has any content.
        bytes.resize(start + stride, 77);
    }
    bytes
}
