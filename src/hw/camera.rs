//! Cameras: the trait of the sources of frames.

use image::RgbImage;

/// One picture of a camera, with its time.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Servo period of the middle of the exposure.
    pub period: u64,
    /// Pixels, 8 bits a channel.
    pub image: RgbImage,
}

/// A source of frames: the renderer, a folder of files, or a camera behind a socket.
pub trait FrameSource: Send {
    /// Returns the frame at servo period `period`; `exposure` scales the nominal exposure time.
    ///
    /// # Errors
    /// [`NoFrame`] with the reason.
    fn grab(&mut self, period: u64, exposure: f64) -> Result<Frame, NoFrame>;
}

/// Error of a camera that has no frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("camera {camera}: {reason}")]
pub struct NoFrame {
    /// Name of the camera.
    pub camera: String,
    /// Reason.
    pub reason: String,
}
