//! Nodes of video devices: which file in `/dev` a name stands for.
//!
//! The number in `/dev/video0` may change with each start and each plugging, so a camera is better
//! named by its serial number or by a link in `/dev/v4l/by-id`.
//!
//! - in: a path, or the serial number of a camera
//! - out: the path of its node; or the reason why there is none, with the nodes that exist

use std::fs;
use std::path::{Path, PathBuf};

/// Folder in which the kernel lists its video devices.
const LIST: &str = "/sys/class/video4linux";

/// The kernel's list of video devices.
#[derive(Debug, Clone)]
pub struct Nodes {
    list: PathBuf,
}

impl Default for Nodes {
    /// Returns the list of this machine.
    fn default() -> Self {
        Self { list: LIST.into() }
    }
}

/// One node of a device.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Node {
    /// Name in `/dev`.
    file: String,
    /// Name of the camera.
    card: String,
    /// Index among the nodes of the camera. The first one has the pictures of a webcam.
    index: u32,
    /// Folder of the camera's interface, which its nodes share.
    interface: PathBuf,
    /// Serial number; empty for a camera without one.
    serial: String,
}

impl Node {
    /// Returns the path of the node.
    fn path(&self) -> PathBuf {
        Path::new("/dev").join(&self.file)
    }
}

impl Nodes {
    /// Returns the list in another folder.
    #[cfg(test)]
    pub(crate) fn of(list: &Path) -> Self {
        Self { list: list.to_owned() }
    }

    /// Returns the path of the node that `device` names: a path, or the serial number of a camera.
    ///
    /// # Errors
    /// The reason why there is no such node or more than one, with the nodes that exist.
    pub fn find(&self, device: &str) -> Result<PathBuf, String> {
        if device.contains('/') {
            // The link is resolved each time, since it leads to another node after a replugging.
            return fs::canonicalize(device)
                .map_err(|why| format!("{device}: {}; {}", text(&why), self.known()));
        }
        let with_serial = |node: &Node| node.serial == device && node.index == 0;
        let found: Vec<Node> = self.all().into_iter().filter(with_serial).collect();
        match &found[..] {
            [one] => Ok(one.path()),
            [] => Err(format!("no camera has the serial number {device}; {}", self.known())),
            [first, second, ..] => Err(format!(
                "{} and {} have the serial number {device}: name the camera by a link in \
                 /dev/v4l/by-path",
                first.path().display(),
                second.path().display()
            )),
        }
    }

    /// Returns the node with the pictures of the camera to which the node `path` belongs; `None` if
    /// it is not known, or `path` itself.
    #[must_use]
    pub fn with_pictures(&self, path: &Path) -> Option<PathBuf> {
        let all = self.all();
        let own = all.iter().find(|node| node.path() == path)?;
        let same = |node: &&Node| node.interface == own.interface && node.index == 0;
        all.iter().find(same).map(Node::path).filter(|other| other != path)
    }

    /// Returns the nodes that may have pictures, for a message.
    fn known(&self) -> String {
        let all = self.all();
        let shown: Vec<String> = all
            .iter()
            .filter(|node| node.index == 0)
            .map(|node| {
                let serial = match node.serial.as_str() {
                    "" => String::new(),
                    serial => format!(", serial number {serial}"),
                };
                format!("{} ({}{serial})", node.path().display(), node.card)
            })
            .collect();
        if shown.is_empty() {
            "this machine has no video device".to_owned()
        } else {
            format!("there is {}", shown.join(", "))
        }
    }

    /// Reads the list, in the order of the nodes' numbers.
    fn all(&self) -> Vec<Node> {
        let Ok(entries) = fs::read_dir(&self.list) else { return Vec::new() };
        let mut nodes: Vec<Node> = entries.filter_map(|e| node(&e.ok()?.path())).collect();
        // The order in which the system lists a folder is arbitrary: video10 comes after video9.
        nodes.sort_by_key(|node| (node.file.len(), node.file.clone()));
        nodes
    }
}

/// Reads the folder of one node; `None` if it is not the folder of a video device.
fn node(folder: &Path) -> Option<Node> {
    let file = folder.file_name()?.to_str()?.to_owned();
    let line = |path: PathBuf| {
        fs::read_to_string(path).map(|text| text.trim().to_owned()).unwrap_or_default()
    };
    let interface = fs::canonicalize(folder.join("device")).unwrap_or_default();
    // The serial number belongs to the USB device, one level above its interface.
    let serial = interface.parent().map(|usb| line(usb.join("serial"))).unwrap_or_default();
    file.starts_with("video").then(|| Node {
        card: line(folder.join("name")),
        index: line(folder.join("index")).parse().unwrap_or(0),
        file,
        interface,
        serial,
    })
}

/// Returns the reason of an error as a short text.
fn text(why: &std::io::Error) -> String {
    crate::hw::text::reason(why).into_owned()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    pub(crate) use crate::tables::testing::Folder;

    /// Adds a node to a list like that of the kernel. `camera` is the folder of its USB device.
    pub(crate) fn add(folder: &Folder, file: &str, camera: &str, serial: &str) {
        let index = usize::from(!file.ends_with(['0', '2', '4', '6', '8']));
        let node = folder.0.join("class").join(file);
        let usb = folder.0.join(camera);
        fs::create_dir_all(&node).unwrap();
        fs::create_dir_all(usb.join("1.0")).unwrap();
        fs::write(usb.join("serial"), format!("{serial}\n")).unwrap();
        fs::write(node.join("name"), "HD Webcam\n").unwrap();
        fs::write(node.join("index"), format!("{index}\n")).unwrap();
        std::os::unix::fs::symlink(usb.join("1.0"), node.join("device")).unwrap();
    }

    /// Returns the list of a folder.
    pub(crate) fn nodes(folder: &Folder) -> Nodes {
        Nodes::of(&folder.0.join("class"))
    }

    #[test]
    fn serial_number_leads_to_node_with_pictures() {
        let folder = Folder::new("nodes");
        for (file, camera, serial) in [
            ("video0", "usb1", "A1"),
            ("video1", "usb1", "A1"),
            ("video10", "usb2", "B2"),
            ("video11", "usb2", "B2"),
        ] {
            add(&folder, file, camera, serial);
        }
        let nodes = nodes(&folder);

        assert_eq!(nodes.find("A1"), Ok("/dev/video0".into()));
        assert_eq!(nodes.find("B2"), Ok("/dev/video10".into()));
        let why = nodes.find("C3").unwrap_err();
        assert!(why.starts_with("no camera has the serial number C3; there is /dev/video0"));
        assert!(why.contains("/dev/video10 (HD Webcam, serial number B2)"), "{why}");
        assert!(!why.contains("video1 "), "a node of metadata is no choice: {why}");
        assert_eq!(nodes.with_pictures(Path::new("/dev/video11")), Some("/dev/video10".into()));
        assert_eq!(nodes.with_pictures(Path::new("/dev/video10")), None);
    }

    #[test]
    fn serial_number_of_two_cameras_is_refused() {
        let folder = Folder::new("nodes-twice");
        add(&folder, "video0", "usb1", "0001");
        add(&folder, "video2", "usb2", "0001");

        let why = nodes(&folder).find("0001").unwrap_err();

        assert!(why.starts_with("/dev/video0 and /dev/video2 have"), "{why}");
        assert!(why.contains("by-path"), "{why}");
    }

    #[test]
    fn missing_path_lists_devices_that_exist() {
        let folder = Folder::new("nodes-path");
        let why = nodes(&folder).find("/dev/nosuch").unwrap_err();
        assert_eq!(why, "/dev/nosuch: there is no such file; this machine has no video device");
        add(&folder, "video4", "usb1", "");
        let link = folder.0.join("by-id");
        std::os::unix::fs::symlink("/dev/null", &link).unwrap();

        let why = nodes(&folder).find("/dev/nosuch").unwrap_err();

        assert!(why.ends_with("there is /dev/video4 (HD Webcam)"), "{why}");
        assert_eq!(nodes(&folder).find(link.to_str().unwrap()), Ok("/dev/null".into()));
    }
}
