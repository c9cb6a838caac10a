//! Hardware: the ports, the servo's drivers of time, cameras, and the simulated plant behind the same port.
//!
//! Nothing here names an actor or a task.

pub mod camera;
pub mod driver;
pub mod plant;
pub mod port;
pub mod scene;
