//! The generator of a behaviour: from the order to the set values of each macrostep.
//!
//! - in: a [`Behaviour`], the site where it is carried out; at each macrostep the [`Inputs`]
//! - out: the command of the next macrostep, or how the behaviour ended

use super::behaviour::Behaviour;
use super::compliance::Compliance;
use super::inputs::{Inputs, Sensing};
use super::outcome::{Next, Outcome};
use super::own::{Forecast, Library, Running, Site, Touch};
use super::pace::slowed;
use super::{comply, grasp, position, secure, swing, turn, visual_servo};
use crate::motion::{Motion, MoveRefused};
use crate::operator::parameter::Factors;
use crate::spatial::is_rigid;

/// Generator of a behaviour, with its memory.
#[derive(Debug)]
pub struct Generator {
    kind: Kind,
    swing: swing::Swing,
    /// Compliance of the scenario.
    compliance: Compliance,
}

/// The generator of one kind of motion.
#[derive(Debug)]
enum Kind {
    Position(position::Position),
    Grasp(grasp::Grasp),
    Secure(secure::Secure),
    Turn(turn::Turn),
    Comply(comply::Comply),
    VisualServo(visual_servo::VisualServo),
    Own(Running),
}

impl Kind {
    /// Makes the generator that carries out a behaviour at this site.
    ///
    /// # Errors
    /// Refusal by a generator of the `library`: see [`Library::begin`].
    fn of(behaviour: &Behaviour, site: &Site<'_>, library: &Library) -> Result<Self, String> {
        let Site { compliance, speeds, .. } = site;
        Ok(match *behaviour {
            Behaviour::Joints { target, speed, seconds } => Self::Position(
                position::Position::joints(target, (speed, seconds), speeds, compliance.macrostep),
            ),
            Behaviour::Legs { legs, seconds } => Self::Position(position::Position::legs(
                legs,
                seconds,
                speeds,
                compliance.macrostep,
            )),
            Behaviour::Line { target, speed } => Self::Position(position::Position::line(
                target,
                speed,
                speeds,
                compliance.macrostep,
            )),
            Behaviour::Jaw { jaw, seconds, selector, strained } => {
                Self::Grasp(grasp::Grasp::jaw_only(jaw, seconds, selector, strained, *compliance))
            }
            Behaviour::Approach { speed, distance, force, selector } => Self::Secure(
                secure::Secure::approach(speed, distance, force, selector, *compliance),
            ),
            Behaviour::Withdraw { speed, distance, force, selector } => Self::Secure(
                secure::Secure::withdraw(speed, distance, force, selector, *compliance),
            ),
            Behaviour::Grasp { force, least_width, selector, stops } => {
                Self::Grasp(grasp::Grasp::new(force, least_width, selector, stops, *compliance))
            }
            Behaviour::Secure { press, force, selector, stops } => {
                Self::Secure(secure::Secure::press(press, force, selector, stops, *compliance))
            }
            Behaviour::Turn {
                angle,
                speed,
                acceleration,
                torque,
                least_torque,
                selector,
                stiff,
            } => {
                let order = turn::Order {
                    angle,
                    speed,
                    acceleration,
                    torque,
                    least_torque,
                    selector,
                    stiff,
                };
                Self::Turn(turn::Turn::new(order, *compliance))
            }
            Behaviour::Comply { selector } => {
                Self::Comply(comply::Comply::until_ended(selector, *compliance))
            }
            Behaviour::Present { pull, selector, seconds } => {
                Self::Comply(comply::Comply::until_pulled(pull, selector, seconds, *compliance))
            }
            Behaviour::VisualServo(order) => {
                Self::VisualServo(visual_servo::VisualServo::new(order, *compliance))
            }
            Behaviour::Own(ref order) => Self::Own(library.begin(order, site)?),
        })
    }
}

impl Generator {
    /// Makes the generator that carries out a behaviour at this site.
    ///
    /// # Errors
    /// If the behaviour is one of a generator in the `library`, and the library has no generator of
    /// this name, or the generator refuses the order.
    pub fn begin(
        behaviour: &Behaviour,
        site: &Site<'_>,
        library: &Library,
    ) -> Result<Self, String> {
        let kind = Kind::of(behaviour, site, library)?;
        Ok(Self { kind, swing: swing::Swing::default(), compliance: site.compliance })
    }

    /// Makes the next macrosteps follow the operator's parameters.
    pub fn tune(&mut self, factors: &Factors) {
        let compliance = self.compliance.tuned(factors);
        match &mut self.kind {
            // Position control has no compliance. Its speed follows by the pace.
            Kind::Position(_) => {}
            Kind::Grasp(g) => g.tune(compliance),
            Kind::Secure(g) => g.tune(compliance, factors),
            Kind::Turn(g) => g.tune(compliance, factors),
            Kind::Comply(g) => g.tune(compliance),
            Kind::VisualServo(g) => g.tune(compliance),
            Kind::Own(g) => g.tune(&compliance),
        }
    }

    /// Returns the command of the next macrostep, or how the behaviour ended; and, from a generator
    /// that uses the visual sensor, where in the picture and at which exposure the sensor must look
    /// from now on.
    pub fn next(&mut self, inputs: &Inputs<'_>) -> (Next, Option<Sensing>) {
        debug_assert!(is_rigid(&inputs.arm.desired_base_from_tool), "not rigid: {:?}", inputs.arm);
        debug_assert!((0.0..=1.0).contains(&inputs.pace), "pace: {}", inputs.pace);
        // An oscillation ends any behaviour, before its own limits name another cause.
        if let Some(oscillates) = self.swing.note(inputs) {
            return (Next::Done(oscillates), None);
        }
        let next = match &mut self.kind {
            // Position control computes its set values by its own clock, which it slows down
            // itself.
            Kind::Position(g) => g.next(inputs),
            Kind::Grasp(g) => slowed(g.next(inputs), inputs),
            Kind::Secure(g) => slowed(g.next(inputs), inputs),
            Kind::Turn(g) => slowed(g.next(inputs), inputs),
            Kind::Comply(g) => slowed(g.next(inputs), inputs),
            // The only generator that orders the visual sensor.
            Kind::VisualServo(g) => {
                let (next, sensing) = g.next(inputs);
                return (slowed(next, inputs), Some(sensing));
            }
            // It slows down by itself or is slowed down, as it has declared.
            Kind::Own(g) => {
                let (next, sensing) = g.next(inputs);
                return (self.judged(next), sensing);
            }
        };
        (self.judged(next), None)
    }

    /// Returns this answer, but names an oscillation as its cause where the last peak of one has
    /// exceeded the limit of a force before the oscillation was detected.
    fn judged(&self, next: Next) -> Next {
        if let Next::Done(Outcome::OverForce(direction, _)) = next
            && let Some(oscillates) = self.swing.swinging(direction)
        {
            return Next::Done(oscillates);
        }
        next
    }

    /// Returns whether the generator can continue although its last command was refused for the
    /// reason `why`. Its next call gets this reason in `inputs.arm.refused`.
    #[must_use]
    pub fn tolerates(&self, why: &MoveRefused) -> bool {
        match &self.kind {
            Kind::VisualServo(_) => visual_servo::VisualServo::tolerates(why),
            Kind::Own(g) => g.tolerates(why),
            _ => false,
        }
    }

    /// Returns the name of the sensor whose reading a registered generator needs.
    #[must_use]
    pub fn sensor(&self) -> Option<&str> {
        if let Kind::Own(g) = &self.kind { g.sensor() } else { None }
    }

    /// Returns the course from the set values of the last command to rest, if a registered
    /// generator declares one.
    #[must_use]
    pub fn onward(&self) -> Option<Forecast> {
        if let Kind::Own(g) = &self.kind { g.onward() } else { None }
    }

    /// Takes the last command of a registered generator back, and returns the one that leads to
    /// rest.
    pub fn retreat(&mut self) -> Option<Motion> {
        if let Kind::Own(g) = &mut self.kind { g.retreat() } else { None }
    }

    /// Returns whether the motion is at rest, once the pace is 0.
    #[must_use]
    pub fn rests(&self) -> bool {
        match &self.kind {
            Kind::Own(g) => g.rests(),
            // Their set values stop with the pace.
            _ => true,
        }
    }

    /// Returns what a registered generator expects to touch; `None` for the other behaviours.
    #[must_use]
    pub fn touch(&self) -> Option<Touch> {
        if let Kind::Own(g) = &self.kind { Some(g.touch()) } else { None }
    }
}
