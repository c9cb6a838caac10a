//! A camera that is a folder of image files, in the order of their names.
//!
//! - in: a folder with PNG or JPEG files
//! - out: one frame for each call; after the last file [`NoFrame`]

use super::camera::{Frame, FrameSource, NoFrame};
use std::path::{Path, PathBuf};

/// Frames from files.
#[derive(Debug)]
pub struct FolderCamera {
    name: String,
    files: std::vec::IntoIter<PathBuf>,
}

impl FolderCamera {
    /// Lists the files of the folder without reading them.
    ///
    /// # Errors
    /// [`NoFrame`] if the folder cannot be read or holds no PNG or JPEG file.
    pub fn open(name: &str, folder: &Path) -> Result<Self, NoFrame> {
        let refuse = |reason: String| NoFrame { camera: name.to_owned(), reason };
        let entries =
            std::fs::read_dir(folder).map_err(|e| refuse(format!("{}: {e}", folder.display())))?;
        let mut files: Vec<PathBuf> = entries
            .filter_map(|entry| Some(entry.ok()?.path()))
            .filter(|path| {
                let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
                ["png", "jpg", "jpeg"].contains(&extension.to_ascii_lowercase().as_str())
            })
            .collect();
        // The order in which the file system lists a folder is arbitrary.
        files.sort();
        if files.is_empty() {
            return Err(refuse(format!("{} holds no PNG or JPEG file", folder.display())));
        }
        Ok(Self { name: name.to_owned(), files: files.into_iter() })
    }
}

impl FrameSource for FolderCamera {
    fn grab(&mut self, period: u64, _exposure: f64) -> Result<Frame, NoFrame> {
        let refuse = |reason: String| NoFrame { camera: self.name.clone(), reason };
        let Some(file) = self.files.next() else {
            return Err(refuse("the folder has no more files".into()));
        };
        let image = image::open(&file).map_err(|e| refuse(format!("{}: {e}", file.display())))?;
        Ok(Frame { period, image: image.to_rgb8() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folder_delivers_files_by_name_then_ends() {
        let folder =
            std::env::temp_dir().join(format!("rubik-robot-folder-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for (name, level) in [("b.png", 20), ("a.png", 10), ("note.txt", 0)] {
            let path = folder.join(name);
            if level == 0 {
                std::fs::write(path, "no image").unwrap();
            } else {
                image::RgbImage::from_pixel(4, 4, image::Rgb([level, 0, 0])).save(path).unwrap();
            }
        }

        let mut camera = FolderCamera::open("files", &folder).unwrap();
        let levels: Vec<u8> =
            (0..2).map(|p| camera.grab(p, 1.0).unwrap().image[(0, 0)].0[0]).collect();
        assert_eq!(levels, [10, 20]);
        assert!(camera.grab(3, 1.0).unwrap_err().reason.contains("no more files"));

        std::fs::remove_dir_all(&folder).unwrap();
        assert!(FolderCamera::open("files", &folder).is_err());
    }
}
