//! The library of generators: a name leads to a generator.
//!
//! - in: generators under their names
//! - out: the generator of an [`OwnOrder`], or the reason why there is none

use super::forecast::Forecast;
use super::order::OwnOrder;
use super::running::Running;
use super::traits::{MotionGenerator, Site};
use serde::Deserialize as _;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

/// Makes the generator of an order.
type Make = fn(&Value, &Site<'_>) -> Result<Running, String>;

/// Generators that are registered, by name.
#[derive(Clone, Default)]
pub struct Library(Arc<BTreeMap<&'static str, Make>>);

impl PartialEq for Library {
    fn eq(&self, other: &Self) -> bool {
        self.0.keys().eq(other.0.keys())
    }
}

impl fmt::Debug for Library {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.0.keys()).finish()
    }
}

impl Library {
    /// Returns the library with the generator `G` under this name; one of the same name is
    /// replaced.
    #[must_use]
    pub fn with<G: MotionGenerator>(mut self, name: &'static str) -> Self {
        let make: Make = |order, site| {
            let order = G::Order::deserialize(order).map_err(|why| format!("its order: {why}"))?;
            Ok(Running::new(G::begin(order, site)?, site))
        };
        Arc::make_mut(&mut self.0).insert(name, make);
        self
    }

    /// Returns the names of all generators, in alphabetical order.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.0.keys().copied()
    }

    /// Makes the generator of an order, for an arm at rest.
    ///
    /// # Errors
    /// If no generator has this name, its order cannot be read, or it refuses the order.
    pub fn begin(&self, order: &OwnOrder, site: &Site<'_>) -> Result<Running, String> {
        let OwnOrder { generator: name, order, fraction } = order;
        let make = self.0.get(name.as_str()).ok_or_else(|| {
            let known: Vec<&str> = self.names().collect();
            format!("there is no generator `{name}`; known: {}", known.join(", "))
        })?;
        let of = |why: String| format!("generator `{name}`: {why}");
        if !(*fraction > 0.0 && *fraction <= 1.0) {
            return Err(of(format!("a fraction of {fraction} of its speed is outside 0..=1")));
        }
        make(order, &Site { fraction: *fraction, ..*site }).map_err(of)
    }

    /// Returns the course of an order's motion, if its generator knows it beforehand.
    ///
    /// # Errors
    /// As [`Library::begin`], or if the declared course cannot be used.
    pub fn forecast(&self, order: &OwnOrder, site: &Site<'_>) -> Result<Option<Forecast>, String> {
        let forecast = self.begin(order, site)?.forecast();
        forecast.map_err(|why| format!("generator `{}`: {why}", order.generator))
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::outcome::{Next, Outcome};
    use super::super::super::testing::{compliance, speeds};
    use super::super::super::{Behaviour, Inputs};
    use super::super::Touch;
    use super::*;
    use crate::motion::{ArmState, Direction, Motion};

    /// Generator that moves along x of the tool at the ordered speed (m/s), refuses one above 1,
    /// and ends after two macrosteps.
    struct Along(f64, u32);

    impl MotionGenerator for Along {
        type Order = f64;

        fn begin(order: f64, _: &Site<'_>) -> Result<Self, String> {
            if order > 1.0 { Err(format!("{order} m/s is too fast")) } else { Ok(Self(order, 0)) }
        }

        fn next(&mut self, _: &Inputs<'_>) -> Next {
            self.1 += 1;
            if self.1 > 2 {
                return Next::Done(Outcome::own(&("moved", self.1)));
            }
            let mut directions = [Direction::HOLD; 6];
            directions[0] = Direction::Unguarded { velocity: self.0 };
            Next::go(Motion::Task { frame: crate::motion::Frame::Tool, directions })
        }
    }

    /// Begins an order at a site of the tests.
    fn begin(order: &OwnOrder) -> Result<Running, String> {
        let arm = ArmState::default();
        let site = Site { compliance: compliance(), speeds: speeds(), arm: &arm, fraction: 1.0 };
        Library::default().with::<Along>("along").begin(order, &site)
    }

    /// Returns the order for a speed (m/s).
    fn order(speed: f64) -> OwnOrder {
        match Along::behaviour("along", &speed) {
            Ok(Behaviour::Own(order)) => order,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn unknown_name_and_refused_order_are_reported() {
        let refusal = |order: OwnOrder| begin(&order).err().unwrap_or_default();

        assert_eq!(refusal(order(0.5)), "");
        let unknown = OwnOrder { generator: "across".to_owned(), ..order(0.5) };
        assert_eq!(refusal(unknown), "there is no generator `across`; known: along");
        assert_eq!(refusal(order(2.0)), "generator `along`: 2 m/s is too fast");
        let wrong = refusal(OwnOrder { order: Value::from("fast"), ..order(0.5) });
        assert!(wrong.starts_with("generator `along`: its order: "), "{wrong}");
        for fraction in [0.0, f64::NAN, 1.5] {
            let wrong = refusal(OwnOrder { fraction, ..order(0.5) });
            assert!(wrong.contains("outside 0..=1"), "{wrong}");
        }
    }

    #[test]
    fn pace_and_fraction_slow_velocities_down() {
        let mut along = begin(&OwnOrder { fraction: 0.5, ..order(0.8) }).unwrap();
        assert_eq!(along.touch(), Touch::Free, "a generator that says nothing about contact");
        let arm = ArmState::default();
        let mut next = |pace| {
            along.next(&Inputs { arm: &arm, target: None, reading: None, period: 0, pace }).0
        };
        let velocity = |next: &Next| match next {
            Next::Go(command) => match command.motion {
                Motion::Task { directions: [Direction::Unguarded { velocity }, ..], .. } => {
                    assert_eq!(command.periods, compliance().macrostep);
                    velocity
                }
                _ => f64::NAN,
            },
            Next::Done(_) => f64::NAN,
        };

        assert_eq!(velocity(&next(1.0)), 0.4);
        assert_eq!(velocity(&next(0.25)), 0.1);
        let Next::Done(outcome) = next(1.0) else { panic!("it ends") };
        assert_eq!(outcome.result::<(String, u32)>(), Some(("moved".to_owned(), 3)));
    }
}
