//! The generator that moves an arm along a curve.
//!
//! - in: an order that makes the curve; the pace of each macrostep
//! - out: set values at the end of each macrostep, the last of them exactly the end of the curve
//!
//! A pause brakes the motion on its path within its own limits, so it takes the time that they
//! require: at full speed that of its acceleration and 0.3 s more.

use super::super::inputs::Inputs;
use super::super::outcome::{Next, Outcome};
use super::super::own::{Forecast, MotionGenerator, Pacing, Place, Places, Site, Touch};
use super::curve::Curve;
use super::law::Law;
use crate::motion::Motion;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::marker::PhantomData;

/// Longest motion (macrosteps), for a forecast: at 16 ms half an hour.
const LONGEST: usize = 112_500;

/// Order of a motion along a curve.
pub trait PathOrder: Serialize + DeserializeOwned + Send + 'static {
    /// Makes the curve, which begins at the set values of the arm.
    ///
    /// # Errors
    /// Reason why the order describes no curve.
    fn curve(self, site: &Site<'_>) -> Result<Box<dyn Curve>, String>;
}

/// Motion along the curve of an order.
pub struct Along<O> {
    curve: Box<dyn Curve>,
    law: Law,
    /// Pace of the last macrostep.
    pace: f64,
    order: PhantomData<fn() -> O>,
}

/// Returns whether a pause, or the end by the superior actor, slows the motion down: the pace
/// falls, or is 0. Its value has no effect.
pub(in super::super) fn pauses(inputs: &Inputs<'_>, last: &mut f64) -> bool {
    let before = std::mem::replace(last, inputs.pace);
    inputs.pace < before || inputs.pace == 0.0
}

impl<O: PathOrder> MotionGenerator for Along<O> {
    type Order = O;

    fn begin(order: O, site: &Site<'_>) -> Result<Self, String> {
        let curve = order.curve(site)?;
        let law = Law::plan(&curve.cells(), site.step() * site.fraction);
        Ok(Self { curve, law, pace: 0.0, order: PhantomData })
    }

    fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        if self.law.is_over() {
            return Next::Done(Outcome::Reached);
        }
        let pauses = pauses(inputs, &mut self.pace);
        Next::go(match advance(self.curve.as_ref(), &mut self.law, pauses) {
            Place::Joints(joints) => Motion::Joints(joints),
            Place::Pose(pose) => Motion::Pose(pose),
        })
    }

    fn forecast(&self) -> Option<Forecast> {
        places(self.curve.as_ref(), self.law.clone())
    }

    fn touch(&self) -> Touch {
        Touch::Free
    }

    fn pacing(&self) -> Pacing {
        Pacing::Clock
    }

    fn rests(&self) -> bool {
        self.law.rests()
    }
}

/// Advances a motion by a macrostep and returns the place at its end.
pub(in super::super) fn advance(curve: &dyn Curve, law: &mut Law, pauses: bool) -> Place {
    let u = law.advance(pauses);
    // The end exactly, without the rounding of the sum of all cells.
    curve.at(if law.is_over() { f64::INFINITY } else { u })
}

/// Returns the course of a motion by this law, which has not begun; `None` if it takes longer than
/// any forecast.
pub(in super::super) fn places(curve: &dyn Curve, mut law: Law) -> Option<Forecast> {
    let mut places = vec![curve.at(0.0)];
    let step = law.step();
    while !law.is_over() {
        if places.len() > LONGEST {
            return None;
        }
        places.push(advance(curve, &mut law, false));
    }
    let seconds = (places.len() - 1) as f64 * step;
    // All places of a curve are of one kind.
    let (mut joints, mut poses) = (Vec::new(), Vec::new());
    for place in places {
        match place {
            Place::Joints(at) => joints.push(at),
            Place::Pose(at) => poses.push(at),
        }
    }
    let places = if joints.is_empty() { Places::Poses(poses) } else { Places::Joints(joints) };
    Some(Forecast { seconds, places })
}
