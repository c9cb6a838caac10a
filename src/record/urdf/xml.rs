//! Writer of a [`Model`] as URDF text.
//!
//! - source: the URDF specification of ROS (link, joint, inertial, visual, collision, limit);
//!   lengths in m, angles in rad, masses in kg

use super::model::{JointKind, Link, Model};
use super::physics::{Inertial, Strength};
use super::solid::Shape;
use crate::spatial::Pose;
use std::fmt::{self, Write};

/// Least moment or product of inertia that is written (kg m2). A smaller one is a rounding error
/// and becomes 0.
const LEAST: f64 = 1e-12;

/// Returns the model as URDF text.
#[must_use]
pub fn xml(model: &Model) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write(model, &mut text);
    text
}

/// Writes the model as the URDF element `<robot>`: its links, then its joints.
fn write(model: &Model, to: &mut String) -> fmt::Result {
    writeln!(to, "<?xml version=\"1.0\"?>")?;
    writeln!(to, "<robot name=\"{}\">", escaped(&model.name))?;
    for link in &model.links {
        write_link(link, to)?;
    }
    for joint in &model.joints {
        let kind = match joint.kind {
            JointKind::Fixed => "fixed",
            JointKind::Floating => "floating",
            JointKind::Turns(_) => "revolute",
            JointKind::Slides(_) => "prismatic",
        };
        writeln!(to, "  <joint name=\"{}\" type=\"{kind}\">", escaped(&joint.name))?;
        writeln!(to, "    <parent link=\"{}\"/>", escaped(&joint.parent))?;
        writeln!(to, "    <child link=\"{}\"/>", escaped(&joint.child))?;
        writeln!(to, "    {}", origin(&joint.origin))?;
        // Axis and limits belong to joints that move; the format requires limits for them.
        if let Some(drive) = joint.kind.drive() {
            let [x, y, z] = drive.axis;
            let (low, high) = drive.limits;
            let Strength { effort, speed } = drive.strength;
            writeln!(to, "    <axis xyz=\"{x} {y} {z}\"/>")?;
            writeln!(
                to,
                "    <limit lower=\"{low}\" upper=\"{high}\" effort=\"{effort}\" \
                 velocity=\"{speed}\"/>"
            )?;
        }
        writeln!(to, "  </joint>")?;
    }
    writeln!(to, "</robot>")
}

/// Writes a link as the element `<link>`. Each of its solids is both visual and collision geometry.
fn write_link(link: &Link, to: &mut String) -> fmt::Result {
    if link.solids.is_empty() && link.inertial.is_none() {
        return writeln!(to, "  <link name=\"{}\"/>", escaped(&link.name));
    }
    writeln!(to, "  <link name=\"{}\">", escaped(&link.name))?;
    if let Some(inertial) = &link.inertial {
        write_inertial(inertial, to)?;
    }
    for (index, solid) in link.solids.iter().enumerate() {
        let [r, g, b] = solid.colour;
        let place = origin(&solid.link_from_solid);
        let shape = match solid.shape {
            Shape::Box([x, y, z]) => format!("<box size=\"{x} {y} {z}\"/>"),
            Shape::Cylinder(radius, length) => {
                format!("<cylinder radius=\"{radius}\" length=\"{length}\"/>")
            }
        };
        writeln!(to, "    <visual>")?;
        writeln!(to, "      {place}")?;
        writeln!(to, "      <geometry>{shape}</geometry>")?;
        // A viewer shares materials by name, so each solid has a name of its own.
        let name = escaped(&link.name);
        writeln!(
            to,
            "      <material name=\"{name}_{index}\"><color rgba=\"{r} {g} {b} 1\"/></material>"
        )?;
        writeln!(to, "    </visual>")?;
        writeln!(to, "    <collision>")?;
        writeln!(to, "      {place}")?;
        writeln!(to, "      <geometry>{shape}</geometry>")?;
        writeln!(to, "    </collision>")?;
    }
    writeln!(to, "  </link>")
}

/// Writes mass, centre and inertia of a link as the element `<inertial>`.
fn write_inertial(Inertial { mass, centre, inertia }: &Inertial, to: &mut String) -> fmt::Result {
    let moment = |row: usize, column: usize| {
        let moment = inertia[(row, column)];
        if moment.abs() < LEAST { 0.0 } else { moment }
    };
    writeln!(to, "    <inertial>")?;
    writeln!(to, "      {}", origin(&Pose::translation(centre.x, centre.y, centre.z)))?;
    writeln!(to, "      <mass value=\"{mass}\"/>")?;
    writeln!(
        to,
        "      <inertia ixx=\"{}\" ixy=\"{}\" ixz=\"{}\" iyy=\"{}\" iyz=\"{}\" izz=\"{}\"/>",
        moment(0, 0),
        moment(0, 1),
        moment(0, 2),
        moment(1, 1),
        moment(1, 2),
        moment(2, 2)
    )?;
    writeln!(to, "    </inertial>")
}

/// Returns a pose as the URDF element `<origin>`.
fn origin(pose: &Pose) -> String {
    let t = pose.translation.vector;
    // URDF and nalgebra agree: fixed-axis roll, pitch, yaw, that is Rz(yaw) Ry(pitch) Rx(roll).
    let (roll, pitch, yaw) = pose.rotation.euler_angles();
    format!("<origin xyz=\"{} {} {}\" rpy=\"{roll} {pitch} {yaw}\"/>", t.x, t.y, t.z)
}

fn escaped(name: &str) -> String {
    name.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}
