//! Finger tips and probes on one fixed object, with the part of its contour that they covered.
//!
//! - in: tools, once a substep
//! - out: the load on each tool, and figures of the contact once a period
//! - finger tips are balls at the ends of the fingers; they touch surfaces only. On boxes and
//!   cylinders the grasp has the contact of the fingers. A probe touches every fixed object

use super::solid::Solid;
use super::spec::Probe;
use super::tip::{Anchor, Ball, Ground, press};
use super::tool::{Load, Tool};
use super::truth::TouchTruth;
use crate::cell::{MOST_ARMS, PerArm};
use nalgebra::Vector3;

/// Balls of a tool: two finger tips and a probe.
const BALLS: usize = 3;

/// Contact of all tools with one fixed object.
#[derive(Debug, Clone)]
pub(super) struct Tips {
    /// Places without strain of each ball's friction, per arm.
    anchors: PerArm<[Anchor; BALLS]>,
    /// Whether each section of the contour was touched.
    covered: Vec<bool>,
    /// Normal force and friction of each arm in the last substep (N).
    force: PerArm<f64>,
    friction: PerArm<f64>,
}

impl Tips {
    /// Makes the contacts of an object that nothing has touched yet.
    pub(super) fn new(solid: &Solid) -> Self {
        let sections = match solid {
            Solid::Surface(contour, ..) => contour.sections.len(),
            _ => 0,
        };
        Self {
            anchors: [[None; BALLS]; MOST_ARMS],
            covered: vec![false; sections],
            force: [0.0; MOST_ARMS],
            friction: [0.0; MOST_ARMS],
        }
    }

    /// Adds to `load` the forces of a fixed object on the tool of an arm, with or without a probe.
    pub(super) fn press(
        &mut self,
        ground: &Ground<'_>,
        (arm, tool): (usize, &Tool<'_>),
        probe: Option<&Probe>,
        load: &mut Load,
    ) {
        (self.force[arm], self.friction[arm]) = (0.0, 0.0);
        let surface = matches!(ground.solid, Solid::Surface(..));
        for (ball, anchor) in balls(tool, probe).into_iter().zip(&mut self.anchors[arm]) {
            let Some((ball, is_probe)) = ball else { continue };
            if !surface && !is_probe {
                continue;
            }
            let Some(press) = press(&ball, ground, anchor) else { continue };
            load.push(&tool.frame, &press.at, &press.force, &press.stiffness);
            self.force[arm] += press.normal;
            self.friction[arm] += press.friction;
            if let Solid::Surface(contour, ..) = ground.solid
                && press.normal > 0.0
            {
                self.covered[contour.section(press.place.x)] = true;
            }
        }
    }

    /// Adds the forces of a period to `truth`.
    pub(super) fn end_period(&self, solid: &Solid, truth: &mut TouchTruth) {
        truth.add(self.force, self.friction);
        if let Solid::Surface(contour, ..) = solid {
            let covered = contour.sections.iter().zip(&self.covered);
            truth.covered = covered.filter(|(_, covered)| **covered).map(|(long, _)| long).sum();
            truth.length = contour.sections.iter().sum();
        }
    }

    /// Returns the greatest normal force of an arm in the last substep (N).
    pub(super) fn most(&self) -> f64 {
        self.force.into_iter().fold(0.0, f64::max)
    }
}

/// Returns the balls of a tool in the world, each with whether it is the probe.
fn balls(tool: &Tool<'_>, probe: Option<&Probe>) -> [Option<(Ball, bool)>; BALLS] {
    let ball = |local: Vector3<f64>, radius: f64| {
        let centre = tool.frame.point(&local);
        Ball { centre, radius, velocity: tool.velocity_at(&centre) }
    };
    let (g, radius) = (tool.gripper, 0.5 * tool.gripper.finger_thickness);
    let tip = |side: f64| {
        let y = side * (0.5 * tool.opening + radius);
        Some((ball(Vector3::new(0.0, y, g.finger_tip - radius), radius), false))
    };
    let probe = probe.map(|probe| (ball(probe.centre.coords, probe.radius), true));
    [tip(1.0), tip(-1.0), probe]
}
