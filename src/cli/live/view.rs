//! One moment of a reading, as terminal and page show it.

use crate::vision::FaceSighting;
use image::RgbImage;

/// One picture, for terminal and page.
pub(super) struct View<'a> {
    /// Time since the start (s).
    pub(super) time: f64,
    /// The picture; after a loss of the camera the last one.
    pub(super) image: &'a RgbImage,
    /// Its face, if it has one.
    pub(super) face: Option<&'a FaceSighting>,
    /// Faces that were taken.
    pub(super) taken: &'a [FaceSighting],
    /// Content of the picture.
    pub(super) words: &'a str,
    /// Face that the operator is to show next.
    pub(super) wanted: &'a str,
    /// Line that stays, if the picture adds one.
    pub(super) line: Option<&'a str>,
}
