//! Model of the cell as links and joints, and its text in URDF (unified robot description format).

mod model;
mod objects;
mod physics;
mod solid;
mod xml;

pub use model::{Drive, Joint, JointKind, Link, Model, Variable};
pub use physics::{Inertial, Strength};
pub use solid::{Shape, Solid};
pub use xml::xml;
