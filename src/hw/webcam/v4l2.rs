//! A webcam's device by the crate `v4l`: the thin layer between [`VideoDevice`] and the kernel.
//!
//! The crate panics at answers of a driver that it does not know. Such a panic becomes an error
//! here, because a strange camera must not end a run.

use super::PATIENCE;
use super::device::{Buffer, Card, Control, Format, FourCc, Offer, Size, Sizes, VideoDevice};
use rustix::time::{ClockId, clock_gettime};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::Duration;
use v4l::buffer::{Flags, Metadata, Type};
use v4l::capability::Flags as Capabilities;
use v4l::control;
use v4l::format::{Colorspace, FourCC, Quantization};
use v4l::framesize::FrameSizeEnum;
use v4l::io::mmap::Stream;
use v4l::io::traits::CaptureStream;
use v4l::video::Capture;

/// Buffers that the driver fills in turn.
const BUFFERS: u32 = 4;
/// Longest wait for the first picture of a stream. Some cameras need a second; the worker that
/// waits for a picture has 3 s in all.
const FIRST: Duration = Duration::from_millis(1500);

/// An open device, with its stream while one runs.
struct V4l2 {
    // Fields are dropped in this order: the stream returns its buffers before the device closes.
    stream: Option<Stream<'static>>,
    device: v4l::Device,
}

/// Opens the device at `path`.
///
/// # Errors
/// The error of the operating system.
pub(super) fn open(path: &Path) -> io::Result<Box<dyn VideoDevice>> {
    let device = guarded(|| v4l::Device::with_path(path))?;
    Ok(Box::new(V4l2 { stream: None, device }))
}

/// Calls the crate and turns its panic into an error.
fn guarded<T>(call: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
    catch_unwind(AssertUnwindSafe(call))
        .unwrap_or_else(|_| Err(io::Error::other("an answer of the driver is not understood")))
}

/// Returns the number of a control, as the kernel's `v4l2-controls.h` has it.
fn number(control: Control) -> u32 {
    match control {
        Control::AutomaticWhite => 0x0098_090C,
        Control::White => 0x0098_091A,
        Control::ExposureMode => 0x009A_0901,
        Control::Exposure => 0x009A_0902,
    }
}

/// Returns the sizes of a format; none if the driver lists none.
fn sizes(device: &v4l::Device, code: FourCC) -> Vec<Sizes> {
    let found = device.enum_framesizes(code).unwrap_or_default();
    let size = |size: FrameSizeEnum| match size {
        FrameSizeEnum::Discrete(one) => Sizes::One((one.width, one.height)),
        FrameSizeEnum::Stepwise(steps) => Sizes::Steps {
            least: (steps.min_width, steps.min_height),
            most: (steps.max_width, steps.max_height),
            step: (steps.step_width, steps.step_height),
        },
    };
    found.into_iter().map(|one| size(one.size)).collect()
}

/// Returns the time since the exposure of a buffer; `None` if its time is not that of the monotonic
/// clock.
fn age(metadata: &Metadata) -> Option<Duration> {
    if (metadata.flags & Flags::TIMESTAMP_MASK) != Flags::TIMESTAMP_MONOTONIC {
        return None;
    }
    let now = clock_gettime(ClockId::Monotonic);
    let now = Duration::new(now.tv_sec as u64, now.tv_nsec as u32);
    Some(now.saturating_sub(Duration::from(metadata.timestamp)))
}

/// Copies the filled part of a buffer.
fn copied((bytes, metadata): (&[u8], &Metadata)) -> Buffer {
    let used = bytes.len().min(metadata.bytesused as usize);
    Buffer {
        bytes: bytes[..used].to_vec(),
        damaged: metadata.flags.contains(Flags::ERROR),
        age: age(metadata),
    }
}

impl VideoDevice for V4l2 {
    fn card(&self) -> io::Result<Card> {
        let found = guarded(|| self.device.query_caps())?;
        let wanted = Capabilities::VIDEO_CAPTURE | Capabilities::STREAMING;
        Ok(Card { name: found.card, has_pictures: found.capabilities.contains(wanted) })
    }

    fn offers(&self) -> io::Result<Vec<Offer>> {
        guarded(|| {
            let offer = |code: FourCC| Offer { code: code.repr, sizes: sizes(&self.device, code) };
            Ok(self.device.enum_formats()?.into_iter().map(|f| offer(f.fourcc)).collect())
        })
    }

    fn set_format(&mut self, code: FourCc, (width, height): Size) -> io::Result<Format> {
        self.stop();
        let wanted = v4l::Format::new(width, height, FourCC::new(&code));
        let given = guarded(|| self.device.set_format(&wanted))?;
        // Without a word of the driver the range follows from the colour space.
        let full_range = match given.quantization {
            Quantization::FullRange => true,
            Quantization::LimitedRange => false,
            Quantization::Default => matches!(given.colorspace, Colorspace::JPEG),
        };
        Ok(Format {
            code: given.fourcc.repr,
            size: (given.width, given.height),
            stride: given.stride as usize,
            full_range,
        })
    }

    fn set_control(&mut self, control: Control, value: i64) -> io::Result<i64> {
        let id = number(control);
        guarded(|| {
            let value = match control {
                Control::AutomaticWhite => control::Value::Boolean(value != 0),
                _ => control::Value::Integer(value),
            };
            self.device.set_control(control::Control { id, value })?;
            match self.device.control(id)?.value {
                control::Value::Integer(set) => Ok(set),
                control::Value::Boolean(set) => Ok(i64::from(set)),
                _ => Err(io::Error::other("the control has no number")),
            }
        })
    }

    fn start(&mut self) -> io::Result<()> {
        self.stop();
        let mut stream =
            guarded(|| Stream::with_buffers(&self.device, Type::VideoCapture, BUFFERS))?;
        stream.set_timeout(FIRST);
        // The first call starts the stream, and only then the bus refuses.
        let started = guarded(|| stream.next().map(drop));
        self.stream = Some(stream);
        if started.is_err() {
            self.stop();
        }
        started
    }

    fn next(&mut self, wait: Duration) -> io::Result<Option<Buffer>> {
        let Some(stream) = &mut self.stream else { return Err(io::Error::other("no stream")) };
        // The crate's own wait leaves the stream unusable when its time is over.
        let wait = i32::try_from(wait.as_millis()).unwrap_or(i32::MAX);
        if stream.handle().poll(libc::POLLIN, wait)? == 0 {
            return Ok(None);
        }
        stream.set_timeout(PATIENCE);
        guarded(|| stream.next().map(|filled| Some(copied(filled))))
    }
}

impl V4l2 {
    /// Ends the stream, if one runs.
    fn stop(&mut self) {
        let stream = self.stream.take();
        // A stream panics when its device does not end it. There is nothing left to do then.
        drop(guarded(|| {
            drop(stream);
            Ok(())
        }));
    }
}

impl Drop for V4l2 {
    fn drop(&mut self) {
        self.stop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use v4l::timestamp::Timestamp;

    /// The kernel answers as for any device that is no camera.
    #[test]
    fn device_that_is_no_camera_is_refused() {
        let device = open(Path::new("/dev/null")).unwrap();

        assert_eq!(device.card().unwrap_err().raw_os_error(), Some(25));
        assert_eq!(open(Path::new("/dev/nosuch")).err().unwrap().raw_os_error(), Some(2));
    }

    #[test]
    fn buffer_has_used_bytes_and_age() {
        let now = clock_gettime(ClockId::Monotonic);
        let mut metadata = Metadata {
            bytesused: 2,
            flags: Flags::TIMESTAMP_MONOTONIC | Flags::ERROR,
            timestamp: Timestamp::new(now.tv_sec - 2, 0),
            ..Metadata::default()
        };

        let buffer = copied((&[1, 2, 3], &metadata));
        assert_eq!((&buffer.bytes[..], buffer.damaged), (&[1, 2][..], true));
        assert!((2..4).contains(&buffer.age.as_secs()), "{:?}", buffer.age);
        metadata.flags = Flags::TIMESTAMP_COPY;
        assert_eq!(copied((&[], &metadata)).age, Duration::ZERO);
    }
}
