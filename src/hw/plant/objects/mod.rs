//! Rigid objects in the cell beside the cube: boxes, cylinders, bars and surfaces, and persons who
//! lead a tool by hand.
//!
//! - in: the tools with their jaws, once a substep
//! - out: the load of all objects on each tool, and the true state of each object
//! - a gripper holds one body at a time: the cube or one object. Objects do not meet each other,
//!   except that a loose one may lie on the level top of a fixed one; forearms pass through them
//! - a cell without objects does not come here, so that its runs keep their bits

mod body;
mod contour;
mod fixed;
mod lead;
mod solid;
pub(super) mod spec;
#[cfg(test)]
mod tests;
mod tip;
mod tool;
pub(super) mod truth;

pub(super) use body::SavedObject;
pub(super) use lead::SavedLead;
pub(super) use tool::{Load, Tool};

use self::body::Body;
use self::fixed::Tips;
use self::lead::Lead;
use self::solid::Solid;
use self::spec::{LeadConfig, ObjectConfig, Probe};
use self::tip::Ground;
use self::truth::{ObjectState, ObjectTruth};
use super::frame::Frame;
use super::rest::Support;
use crate::cell::{MOST_ARMS, PerArm};
use crate::hw::scene::{MOST_OBJECTS, SceneObject};
use nalgebra::Vector3;
use rand_pcg::Pcg64;

/// All objects of a cell.
#[derive(Debug, Clone, Default)]
pub(super) struct Objects {
    bodies: Vec<(Body, Tips)>,
    leads: Vec<Lead>,
    probes: PerArm<Option<Probe>>,
    /// Load on each tool in the last substep.
    loads: Option<PerArm<Load>>,
    /// Force and torque of the objects on the tool of each arm in the last substep, without those
    /// of persons (N, Nm).
    contacts: PerArm<(f64, f64)>,
}

impl Objects {
    /// Makes the objects at their start poses, over a table of this height (m). `random` makes the
    /// generator of the object with a given number.
    pub(super) fn new(
        (specs, leads): (&[ObjectConfig], &[LeadConfig]),
        probes: PerArm<Option<Probe>>,
        table: f64,
        mut random: impl FnMut(u64) -> Pcg64,
    ) -> Self {
        let solids: Vec<Solid> =
            specs.iter().zip(0..).map(|(spec, i)| Solid::new(spec, &mut random(i))).collect();
        let top = |(spec, solid): (&ObjectConfig, &Solid)| {
            let (top, half) = solid.top(&Frame::from_pose(&spec.world_from_object))?;
            spec.fixed.then_some(Support { top, half })
        };
        let supports: Vec<Support> = specs.iter().zip(&solids).filter_map(top).collect();
        let bodies = specs.iter().zip(solids).map(|(spec, solid)| {
            let tips = Tips::new(&solid);
            (Body::new(spec, solid, table, supports.clone()), tips)
        });
        Self {
            bodies: bodies.collect(),
            leads: leads.iter().map(Lead::new).collect(),
            probes,
            loads: None,
            contacts: [(0.0, 0.0); MOST_ARMS],
        }
    }

    /// Checks whether there is neither an object nor a person who leads a tool.
    pub(super) fn is_empty(&self) -> bool {
        self.bodies.is_empty() && self.leads.is_empty()
    }

    /// Returns the load on the tool of an arm in the last substep, if there is any object.
    pub(super) fn load(&self, arm: usize) -> Option<&Load> {
        self.loads.as_ref()?.get(arm)
    }

    /// Returns force and torque of the objects on the tool of an arm in the last substep (N, Nm).
    pub(super) fn contact(&self, arm: usize) -> (f64, f64) {
        self.contacts[arm]
    }

    /// Checks whether the gripper of an arm is closed on an object.
    pub(super) fn holds(&self, arm: usize) -> bool {
        self.bodies.iter().any(|(body, _)| body.is_in(arm))
    }

    /// Returns the place of the centre of the body in a gripper and its half sizes, both along the
    /// tool's axes (m).
    pub(super) fn held(&self, arm: usize, tool: &Frame) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let (body, _) = self.bodies.iter().find(|(body, _)| body.is_in(arm))?;
        Some(body.place_in(tool))
    }

    /// Moves all objects by one substep of `dt` (s), which ends at `t` (s).
    pub(super) fn step(&mut self, tools: &PerArm<Option<Tool<'_>>>, t: f64, dt: f64) {
        let mut loads = [Load::NONE; MOST_ARMS];
        let holds: PerArm<bool> = std::array::from_fn(|i| self.holds(i));
        for (body, tips) in &mut self.bodies {
            // A hand that holds another object does not meet this one.
            let meets = |i: usize| tools[i].as_ref().filter(|_| !holds[i] || body.is_in(i));
            let met = std::array::from_fn(meets);
            if !matches!(body.solid, Solid::Surface(..)) {
                body.step(met, dt);
            }
            for (i, load) in loads.iter_mut().enumerate() {
                let Some(tool) = &tools[i] else { continue };
                body.load_tool(i, &tool.frame, load);
                if body.state == ObjectState::Fixed {
                    let ground = Ground {
                        solid: &body.solid,
                        frame: &body.frame,
                        stiffness: body.spec.stiffness,
                        friction: body.spec.friction,
                    };
                    tips.press(&ground, (i, tool), self.probes[i].as_ref(), load);
                }
            }
            body.touched.most_force = body.touched.most_force.max(tips.most());
        }
        self.contacts = loads.each_ref().map(|load| (load.force.norm(), load.torque.norm()));
        for lead in &mut self.leads {
            let arm = lead.arm();
            if let (Some(Some(tool)), Some(load)) = (tools.get(arm), loads.get_mut(arm)) {
                lead.pull(tool, load, t, dt);
            }
        }
        self.loads = Some(loads);
    }

    /// Ends a servo period of `seconds`: records forces, and computes the inertia of held bodies.
    pub(super) fn end_period(&mut self, tools: &PerArm<Option<Tool<'_>>>, seconds: f64) {
        for (body, tips) in &mut self.bodies {
            body.end_period(tools.each_ref().map(Option::as_ref), seconds);
            if body.state == ObjectState::Fixed {
                tips.end_period(&body.solid, &mut body.touched);
            }
        }
    }

    /// Returns the true state and history of each object.
    pub(super) fn truth(&self) -> impl Iterator<Item = ObjectTruth> {
        self.bodies.iter().map(|(body, _)| body.truth())
    }

    /// Returns the objects as the cameras see them.
    pub(super) fn scene(&self) -> [Option<SceneObject>; MOST_OBJECTS] {
        std::array::from_fn(|i| {
            let (body, _) = self.bodies.get(i)?;
            let world_from_object = body.frame.to_pose();
            Some(SceneObject { world_from_object, shape: body.solid.shape() })
        })
    }

    /// Returns the number of persons who have let go of their tool after the last point.
    pub(super) fn leads_done(&self) -> usize {
        self.leads.iter().filter(|lead| lead.is_done()).count()
    }

    /// Returns the greatest force of each person on a tool (N).
    pub(super) fn lead_forces(&self) -> impl Iterator<Item = f64> {
        self.leads.iter().map(|lead| lead.most)
    }

    /// Returns the states of objects and leads for the plant's file, with `arms` entries in each
    /// list of grips.
    pub(super) fn saved(&self, arms: usize) -> (Vec<SavedObject>, Vec<SavedLead>) {
        let bodies = self.bodies.iter().map(|(body, _)| body.saved(arms)).collect();
        (bodies, self.leads.iter().map(Lead::saved).collect())
    }

    /// Continues from saved states. `tools` are the frames of the tools that exist.
    ///
    /// # Errors
    /// The place in the file and the reason, if these objects cannot be in the states.
    pub(super) fn restore(
        &mut self,
        (bodies, leads): (&[SavedObject], &[SavedLead]),
        tools: PerArm<Option<Frame>>,
    ) -> Result<(), (String, String)> {
        let counts = (bodies.len(), leads.len());
        if counts != (self.bodies.len(), self.leads.len()) {
            let own = (self.bodies.len(), self.leads.len());
            let why = format!("{counts:?} objects and leads; this plant has {own:?}");
            return Err(("objects".to_owned(), why));
        }
        for (i, ((body, _), saved)) in self.bodies.iter_mut().zip(bodies).enumerate() {
            body.check_saved(saved, tools).map_err(|why| (format!("objects[{i}]"), why))?;
            body.restore(saved);
        }
        for (lead, saved) in self.leads.iter_mut().zip(leads) {
            lead.restore(saved);
        }
        Ok(())
    }
}
