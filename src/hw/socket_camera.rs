//! A camera behind a local socket, which answers each request with one frame.
//!
//! - out: a request of 16 bytes, little-endian: the servo period of the request (u64) and the
//!   exposure (f64)
//! - in: a header of 24 bytes, little-endian: the frame's period by the camera's own clock (u64),
//!   width and height (u32), number of bytes that follow (u64). The pixels follow, 3 bytes each,
//!   row by row. A refusal has the width 0, and its reason follows as text
//! - the camera counts its own periods, so the difference between the two clocks is estimated from
//!   requests and frames. A frame is never older than its request, so the request that was answered
//!   fastest shows the difference best

use super::camera::{Frame, FrameSource, NoFrame};
use image::RgbImage;
use std::collections::VecDeque;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Bytes of a request.
pub const REQUEST: usize = 16;
/// Bytes before the pixels.
pub const HEADER: usize = 24;
/// Longest wait for the socket in one read or write.
const PATIENCE: Duration = Duration::from_secs(1);
/// Greatest size of a frame (bytes). A wrong header must not make this program allocate more.
const LARGEST: usize = 64 << 20;

/// Encodes a request for a frame at servo period `period`; `exposure` scales the nominal exposure
/// time.
#[must_use]
pub fn encode_request(period: u64, exposure: f64) -> [u8; REQUEST] {
    let mut bytes = [0; REQUEST];
    bytes[..8].copy_from_slice(&period.to_le_bytes());
    bytes[8..].copy_from_slice(&exposure.to_le_bytes());
    bytes
}

/// Decodes the period and the exposure of a request.
#[must_use]
pub fn decode_request(bytes: &[u8; REQUEST]) -> (u64, f64) {
    let [a, b] = [0, 8].map(|at| <[u8; 8]>::try_from(&bytes[at..at + 8]).unwrap_or_default());
    (u64::from_le_bytes(a), f64::from_le_bytes(b))
}

/// Header before the pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    /// Period of the exposure by the camera's clock.
    pub period: u64,
    /// Width (pixels); 0 for a refusal.
    pub width: u32,
    /// Height (pixels).
    pub height: u32,
    /// Length of the pixels, or of the reason of a refusal (bytes).
    pub length: u64,
}

impl Header {
    /// Encodes the header for the socket.
    #[must_use]
    pub fn encode(&self) -> [u8; HEADER] {
        let mut bytes = [0; HEADER];
        bytes[..8].copy_from_slice(&self.period.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.width.to_le_bytes());
        bytes[12..16].copy_from_slice(&self.height.to_le_bytes());
        bytes[16..].copy_from_slice(&self.length.to_le_bytes());
        bytes
    }

    /// Decodes a header.
    #[must_use]
    pub fn decode(bytes: &[u8; HEADER]) -> Self {
        let eight = |at: usize| <[u8; 8]>::try_from(&bytes[at..at + 8]).unwrap_or_default();
        let four = |at: usize| <[u8; 4]>::try_from(&bytes[at..at + 4]).unwrap_or_default();
        Self {
            period: u64::from_le_bytes(eight(0)),
            width: u32::from_le_bytes(four(8)),
            height: u32::from_le_bytes(four(12)),
            length: u64::from_le_bytes(eight(16)),
        }
    }
}

/// Estimate of the difference between the servo's clock and the camera's (periods), from recent
/// frames.
#[derive(Debug, Clone, Default)]
struct Offset(VecDeque<i64>);

impl Offset {
    /// Number of recent frames that count. Older ones are dropped because the servo's clock falls
    /// behind the camera's with each period that the servo misses.
    const FRAMES: usize = 50;

    /// Converts `stamp`, the period of a frame by the camera's clock, to a servo period, and takes
    /// the frame into the estimate. The frame was requested in servo period `asked`.
    fn ours(&mut self, asked: u64, stamp: u64) -> u64 {
        // A camera may send any number as its period, so the difference wraps.
        let seen = (asked as i64).wrapping_sub(stamp as i64);
        if self.0.len() == Self::FRAMES {
            self.0.pop_front();
        }
        self.0.push_back(seen);
        // Each difference is too small by the delay of its frame, so the largest is the best one.
        let best = self.0.iter().copied().max().unwrap_or(seen);
        (stamp as i64).wrapping_add(best).max(0) as u64
    }
}

/// A camera behind a socket.
#[derive(Debug)]
pub struct SocketCamera {
    name: String,
    path: PathBuf,
    stream: Option<UnixStream>,
    offset: Offset,
}

impl SocketCamera {
    /// Connects to the camera's socket.
    ///
    /// # Errors
    /// [`NoFrame`] if no program listens at `path`.
    pub fn connect(name: &str, path: &Path) -> Result<Self, NoFrame> {
        let mut this = Self {
            name: name.to_owned(),
            path: path.to_owned(),
            stream: None,
            offset: Offset::default(),
        };
        this.stream = Some(this.open()?);
        Ok(this)
    }

    /// Returns the error of this camera with a reason.
    fn refuse(&self, reason: String) -> NoFrame {
        NoFrame { camera: self.name.clone(), reason }
    }

    /// Connects to the socket and sets its timeouts.
    fn open(&self) -> Result<UnixStream, NoFrame> {
        let refuse = |e: std::io::Error| self.refuse(format!("{}: {e}", self.path.display()));
        let stream = UnixStream::connect(&self.path).map_err(refuse)?;
        stream.set_read_timeout(Some(PATIENCE)).map_err(refuse)?;
        stream.set_write_timeout(Some(PATIENCE)).map_err(refuse)?;
        Ok(stream)
    }

    /// Requests one frame; returns its header and the bytes that follow it.
    fn fetch(
        stream: &mut UnixStream,
        period: u64,
        exposure: f64,
    ) -> std::io::Result<(Header, Vec<u8>)> {
        stream.write_all(&encode_request(period, exposure))?;
        let mut header = [0; HEADER];
        stream.read_exact(&mut header)?;
        let header = Header::decode(&header);
        if header.length > LARGEST as u64 {
            let length = header.length;
            let error = format!("a frame of {length} bytes exceeds the limit of {LARGEST} bytes");
            return Err(std::io::Error::other(error));
        }
        let mut bytes = vec![0; header.length as usize];
        stream.read_exact(&mut bytes)?;
        Ok((header, bytes))
    }
}

impl FrameSource for SocketCamera {
    /// Requests a frame and waits for it. After an error the next call connects again.
    fn grab(&mut self, period: u64, exposure: f64) -> Result<Frame, NoFrame> {
        // A camera that was lost before is connected again.
        let mut stream = match self.stream.take() {
            Some(stream) => stream,
            None => self.open()?,
        };
        // An error closes the stream: bytes that still arrive would be taken for the next frame.
        let (header, bytes) = Self::fetch(&mut stream, period, exposure)
            .map_err(|e| self.refuse(format!("{}: {e}", self.path.display())))?;
        self.stream = Some(stream);
        if header.width == 0 {
            return Err(self.refuse(String::from_utf8_lossy(&bytes).into_owned()));
        }
        let image = RgbImage::from_raw(header.width, header.height, bytes)
            .ok_or_else(|| self.refuse("the frame has less data than its header states".into()))?;
        Ok(Frame { period: self.offset.ours(period, header.period), image })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hw::emulator::CameraServer;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn decoded_headers_and_requests_equal_encoded(
            period in any::<u64>(), size in any::<[u32; 2]>(), length in any::<u64>(),
            exposure in any::<f64>()
        ) {
            let header = Header { period, width: size[0], height: size[1], length };
            prop_assert_eq!(Header::decode(&header.encode()), header);
            let (stamp, light) = decode_request(&encode_request(period, exposure));
            prop_assert_eq!((stamp, light.to_bits()), (period, exposure.to_bits()));
        }
    }

    #[test]
    fn fastest_answer_sets_clock_offset() {
        let mut offset = Offset::default();

        // The camera's clock is 1000 behind; answers take 9, 2 and 5 periods.
        assert_eq!(offset.ours(5000, 4009), 5000);
        assert_eq!(offset.ours(5020, 4022), 5020);
        assert_eq!(offset.ours(5040, 4045), 5043, "two periods of delay remain");
    }

    #[test]
    fn clock_offset_survives_extreme_camera_time_stamps() {
        let mut offset = Offset::default();
        for stamp in [0, 1 << 63, u64::MAX, (1 << 63) - 1, 7] {
            offset.ours(5000, stamp);
            offset.ours(u64::MAX, stamp);
        }
    }

    /// Source of frames whose red level is the exposure.
    struct Stub;

    impl FrameSource for Stub {
        fn grab(&mut self, _: u64, exposure: f64) -> Result<Frame, NoFrame> {
            if exposure > 1.0 {
                return Err(NoFrame { camera: "stub".into(), reason: "too bright".into() });
            }
            let level = (exposure * 200.0) as u8;
            let image = RgbImage::from_pixel(5, 3, image::Rgb([level, 1, 2]));
            Ok(Frame { period: 77, image })
        }
    }

    #[test]
    fn socket_camera_reports_frames_refusals_and_lost_connection() {
        let path = std::env::temp_dir().join(format!("rubik-camera-{}", std::process::id()));
        let server = CameraServer::start(&path, Box::new(Stub)).unwrap();
        let mut camera = SocketCamera::connect("standalone", &path).unwrap();

        let frame = camera.grab(1000, 0.5).unwrap();
        assert_eq!((frame.period, frame.image.dimensions()), (1000, (5, 3)));
        assert_eq!(frame.image.get_pixel(4, 2).0, [100, 1, 2]);
        assert_eq!(camera.grab(1001, 2.0).unwrap_err().reason, "camera stub: too bright");
        assert!(camera.grab(1002, 0.1).is_ok());

        drop(server);
        assert!(camera.grab(1003, 0.5).is_err());
        let gone = camera.grab(1004, 0.5).unwrap_err();
        assert!(gone.to_string().starts_with("camera standalone: "), "{gone}");
    }
}
