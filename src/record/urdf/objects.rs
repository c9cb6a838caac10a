//! Rigid objects of a simulated cell as links of its model.
//!
//! - in: the keys of the objects
//! - out: a link for each, with mass and inertia of an even body: fixed to the world, or floating
//!   at its place at the start
//! - a surface is the box up to the middle of its contour: URDF has no curved solid

use super::model::{JointKind, Model};
use super::physics::Inertial;
use super::solid::{Shape, Solid};
use crate::scenario::objects::{ObjectKeys, ObjectKind};
use crate::spatial::Pose;

/// Colour of the objects: red, green, blue, each 0 to 1.
const PAINT: [f64; 3] = [0.45, 0.50, 0.56];

impl Model {
    /// Returns the model with these objects.
    #[must_use]
    pub fn with_objects(mut self, objects: &[ObjectKeys]) -> Self {
        for keys in objects {
            let [x, y, z] = keys.size;
            let shape = match keys.shape {
                ObjectKind::Cylinder => Shape::Cylinder(0.5 * x, z),
                ObjectKind::Box | ObjectKind::Bar | ObjectKind::Surface => Shape::Box([x, y, z]),
            };
            let surface = keys.shape == ObjectKind::Surface;
            let up = if surface { 0.5 * z } else { 0.0 };
            let link_from_solid = Pose::translation(0.0, 0.0, up);
            let solid = Solid { link_from_solid, shape, colour: PAINT };
            let volume = Inertial::of_solid(&solid, 1.0).mass;
            let inertial = Inertial::of_solid(&solid, keys.mass / volume);
            let name = keys.link();
            self.link(&name, vec![solid]);
            self.weigh(&name, inertial);
            let kind = if keys.is_fixed() { JointKind::Fixed } else { JointKind::Floating };
            self.joint("world", &name, keys.pose(), kind);
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::super::xml;
    use super::*;
    use std::path::Path;

    #[test]
    fn objects_are_links_with_mass_and_inertia() {
        let text = "[[object]]\nname = \"bar\"\nshape = \"bar\"\nsize_mm = [400, 57, 30]\n\
                    mass_kg = 1.2\nxyz_mm = [900, 1000, 1500]\n[[object]]\nname = \"can\"\n\
                    shape = \"cylinder\"\nfixed = true\nxyz_mm = [900, 1000, 1500]\n";
        let scenario = crate::tasks::read(Path::new("t.toml"), text, &[]).unwrap();
        let model = Model::of(&scenario.controller.cell, None, false);

        let model = model.with_objects(&scenario.plant.objects);

        let text = xml(&model);
        let robot = urdf_rs::read_from_string(&text).unwrap();
        let bar = robot.links.iter().find(|link| link.name == "object_bar").unwrap();
        assert!((bar.inertial.mass.value - 1.2).abs() < 1e-12);
        let about_z = 1.2 / 12.0 * (0.4 * 0.4 + 0.057 * 0.057);
        assert!((bar.inertial.inertia.izz - about_z).abs() < 1e-9, "{text}");
        let kind = |name: &str| {
            let joint = robot.joints.iter().find(|joint| joint.child.link == name).unwrap();
            format!("{:?}", joint.joint_type)
        };
        assert_eq!(kind("object_bar"), "Floating");
        assert_eq!(kind("object_can"), "Fixed");
    }
}
