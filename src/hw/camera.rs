//! Cameras: where frames come from.

use image::RgbImage;

/// One exposure.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Servo period of the middle of the exposure.
    pub period: u64,
    /// Pixels, 8 bits a channel.
    pub image: RgbImage,
}

/// A source of frames: the renderer, a folder of files, later a real camera.
pub trait FrameSource: Send {
    /// The frame at servo period `period`; `exposure` scales the nominal exposure time.
    ///
    /// # Errors
    /// [`NoFrame`] with the reason.
    fn grab(&mut self, period: u64, exposure: f64) -> Result<Frame, NoFrame>;
}

/// There is no frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("camera {camera}: {reason}")]
pub struct NoFrame {
    /// Which camera.
    pub camera: String,
    /// Why.
    pub reason: String,
}
