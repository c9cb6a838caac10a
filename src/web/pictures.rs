//! Files of the cameras' pictures for the page. A picture is encoded once, however many pages ask
//! for it.
//!
//! - in: a raw picture, or a file
//! - out: a JPEG or PNG file

use crate::desk::{Picture, Pixels};
use axum::body::Bytes;
use image::codecs::jpeg::JpegEncoder;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Quality of the JPEG pictures, 0 to 100.
const QUALITY: u8 = 82;

/// Latest picture of one camera that a page asked for, and its file; the file is `None` if the
/// picture cannot be encoded.
type Latest = Arc<tokio::sync::Mutex<Option<(Arc<Picture>, Option<Bytes>)>>>;

/// Files of the latest pictures of all cameras.
#[derive(Debug, Default)]
pub(super) struct Files {
    cameras: Mutex<BTreeMap<usize, Latest>>,
    /// Number of times that a picture was encoded.
    #[cfg(test)]
    encoded: std::sync::atomic::AtomicUsize,
}

impl Files {
    /// Returns the file of a picture of a camera, or `None` if the picture cannot be encoded.
    pub(super) async fn file_of(&self, camera: usize, picture: Arc<Picture>) -> Option<Bytes> {
        let latest = {
            let mut all = self.cameras.lock().unwrap_or_else(PoisonError::into_inner);
            Arc::clone(all.entry(camera).or_default())
        };
        // Requests for a picture that is being encoded wait here for its file.
        let mut latest = latest.lock().await;
        if let Some((_, file)) = latest.as_ref().filter(|(had, _)| Arc::ptr_eq(had, &picture)) {
            return file.clone();
        }
        #[cfg(test)]
        self.encoded.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let source = Arc::clone(&picture);
        // The encoder takes milliseconds. It has another thread, since this one must take an
        // emergency stop meanwhile.
        let file = tokio::task::spawn_blocking(move || encode(&source)).await.ok().flatten();
        *latest = Some((picture, file.clone()));
        file
    }
}

/// Returns the file of a picture, or `None` if it cannot be encoded.
fn encode(picture: &Picture) -> Option<Bytes> {
    match &picture.pixels {
        Pixels::Raw(image) => {
            let mut file = Vec::new();
            let encoder = JpegEncoder::new_with_quality(&mut file, QUALITY);
            image.write_with_encoder(encoder).ok().map(|()| file.into())
        }
        Pixels::File(file) => Some(Bytes::copy_from_slice(file)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;
    use std::sync::atomic::Ordering;

    /// Many pages ask for a picture at the same time, and one asks again later.
    #[tokio::test]
    async fn each_picture_is_encoded_once() {
        let picture =
            |frame| Arc::new(Picture { frame, pixels: Pixels::Raw(RgbImage::new(64, 48)) });
        let files = Arc::<Files>::default();
        let first = picture(1);

        let mut asked = tokio::task::JoinSet::new();
        for _ in 0..20 {
            let (files, picture) = (Arc::clone(&files), Arc::clone(&first));
            asked.spawn(async move { files.file_of(0, picture).await });
        }
        let got = asked.join_all().await;
        let again = files.file_of(0, Arc::clone(&first)).await;

        assert!(got.iter().all(|file| file.as_ref().is_some_and(|f| f.starts_with(b"\xff\xd8"))));
        assert_eq!(again, got[0]);
        assert_eq!(files.encoded.load(Ordering::Relaxed), 1);
        // A picture of another run may have the same number.
        assert!(files.file_of(0, picture(1)).await.is_some());
        assert!(files.file_of(1, first).await.is_some());
        assert_eq!(files.encoded.load(Ordering::Relaxed), 3);
    }
}
