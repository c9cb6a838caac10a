//! Model of the cell as links and joints, and its URDF text.

mod model;
mod xml;

pub use model::{Drive, Joint, JointKind, Link, Model, Shape, Solid, Variable};
pub use xml::xml;
