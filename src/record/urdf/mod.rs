//! The cell as links and joints, and as URDF.

mod model;
mod xml;

pub use model::{Drive, Joint, JointKind, Link, Model, Shape, Solid, Variable};
pub use xml::xml;
