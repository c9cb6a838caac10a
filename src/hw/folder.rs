//! A camera that is a folder of image files, in the order of their names.
//!
//! - in: a folder with PNG or JPEG files
//! - out: one frame for each call; after the last file [`NoFrame`]

use super::camera::{Frame, FrameSource, NoFrame};
use super::image_file::load_frame;
use super::text::Unread;
use std::path::{Path, PathBuf};

/// A camera whose frames are the image files of a folder.
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
            std::fs::read_dir(folder).map_err(|e| refuse(Unread::new(folder, e).to_string()))?;
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
    /// Reads the next file of the folder as the frame of `period`; the exposure has no effect.
    fn grab(&mut self, period: u64, _exposure: f64) -> Result<Frame, NoFrame> {
        let refuse = |reason: String| NoFrame { camera: self.name.clone(), reason };
        let Some(file) = self.files.next() else {
            return Err(refuse("the folder has no more files".into()));
        };
        let image = load_frame(&file).map_err(|why| refuse(why.to_string()))?;
        Ok(Frame { period, image })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::testing::{Folder, make_pipe};

    /// A damaged file and a pipe cost one frame each, not the run.
    #[test]
    fn unreadable_file_costs_only_its_own_frame() {
        let folder = Folder::new("folder-bad");
        let palette = include_bytes!("../../tests/corpus/image/palette-of-four-bytes.png");
        std::fs::write(folder.0.join("a.png"), palette).unwrap();
        make_pipe(&folder.0.join("b.png"));
        image::RgbImage::new(4, 4).save(folder.0.join("c.png")).unwrap();

        let mut camera = FolderCamera::open("files", &folder.0).unwrap();

        let why = camera.grab(0, 1.0).unwrap_err().reason;
        assert!(why.ends_with("its palette ends within a colour"), "{why}");
        let why = camera.grab(1, 1.0).unwrap_err().reason;
        assert!(why.ends_with("b.png: not a regular file"), "{why}");
        assert!(camera.grab(2, 1.0).is_ok());
    }

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
