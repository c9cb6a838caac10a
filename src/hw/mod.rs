//! Hardware: the ports to the arms, the drivers that call the servo in each period of wall or
//! virtual time, the cameras, and the simulated plant behind the same port.
//!
//! No file here names an actor or a task.

pub mod camera;
pub mod camera_device;
pub mod console;
pub mod devices;
pub mod driver;
pub mod emulator;
pub mod folder;
pub mod force;
pub mod image_file;
pub mod isa;
pub(crate) mod jpeg;
pub mod new_file;
pub mod note;
pub mod plant;
pub mod port;
pub mod scene;
pub mod serial;
pub mod socket_camera;
pub mod storage;
pub mod text;
pub mod webcam;
