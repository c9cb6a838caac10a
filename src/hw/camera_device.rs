//! The device of a camera in the file of devices: a socket or a webcam.
//!
//! - in: an entry `[[camera]]` of the file
//! - out: the open camera

use super::camera::{FrameSource, NoFrame};
use super::socket_camera::SocketCamera;
use super::webcam::device::Size;
use super::webcam::negotiation::Wish;
use super::webcam::{self, WebcamDevice};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The device of a camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Keys", into = "Keys")]
pub struct CameraDevice {
    /// Name of the camera in the scenario.
    pub name: String,
    /// Way by which its frames come.
    pub line: CameraLine,
}

/// Way by which the frames of a camera come.
#[derive(Debug, Clone, PartialEq)]
pub enum CameraLine {
    /// Local socket: see [`super::socket_camera`].
    Socket(PathBuf),
    /// Device of V4L2: see [`super::webcam`].
    V4l2(WebcamDevice),
}

/// Keys of an entry in the file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    socket: Option<PathBuf>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    v4l2: Option<WebcamDevice>,
}

impl TryFrom<Keys> for CameraDevice {
    type Error = String;

    /// Checks that the entry has one device.
    fn try_from(keys: Keys) -> Result<Self, String> {
        let name = keys.name;
        let line = match (keys.socket, keys.v4l2) {
            (Some(socket), None) => CameraLine::Socket(socket),
            (None, Some(webcam)) => CameraLine::V4l2(webcam),
            (None, None) => {
                return Err(format!("camera \"{name}\" has no device: name a socket or a v4l2"));
            }
            (Some(_), Some(_)) => {
                return Err(format!("camera \"{name}\" has both a socket and a v4l2: keep one"));
            }
        };
        Ok(Self { name, line })
    }
}

impl From<CameraDevice> for Keys {
    fn from(device: CameraDevice) -> Self {
        let (socket, v4l2) = match device.line {
            CameraLine::Socket(socket) => (Some(socket), None),
            CameraLine::V4l2(webcam) => (None, Some(webcam)),
        };
        Self { name: device.name, socket, v4l2 }
    }
}

impl CameraDevice {
    /// Opens the camera, whose optics are known for pictures of this `size`. `shared` says whether
    /// several webcams are in use, which may share a bus.
    ///
    /// # Errors
    /// [`NoFrame`] with the reason.
    pub fn open(&self, size: Size, shared: bool) -> Result<Box<dyn FrameSource>, NoFrame> {
        match &self.line {
            CameraLine::Socket(path) => Ok(Box::new(SocketCamera::connect(&self.name, path)?)),
            CameraLine::V4l2(settings) => {
                let wish = Wish { size, exact: true, shared, only: None };
                webcam::open(&self.name, settings, wish)
            }
        }
    }
}
